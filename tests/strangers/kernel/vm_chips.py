"""USB-serial chips for the kernel's drivers: descriptors, requests, rates by formula, status and marks, FIFO.

Facts: data sheets, and what the drivers of Linux ask (ftdi_sio.c, cp210x.c, ch341.c, pl2303.c, cdc-acm.c). A chip knows
nothing of USB/IP and of the line: its :class:`Host` has both.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Sequence
from typing import ClassVar, Final, Protocol

from vm_usbip import FULL_SPEED, HIGH_SPEED

#: an octet, and whether it has a parity or framing error
Character = tuple[int, bool]
_STANDARD: Final = 0x60  # these bits are zero in a standard request
_GET_STATUS, _GET_DESCRIPTOR = 0, 6
_TO_HOST: Final = 0x80
_PARITY: Final = "NOEMS"
#: of a character on the line
BITS: Final = 11


class Host(Protocol):
    """The services that the program around a chip gives it."""

    def now(self) -> float: ...

    def later(self, at: float, call: Callable[[], None]) -> None: ...

    def log(self, event: str, **words: object) -> None: ...

    def feed(self, endpoint: int) -> None: ...

    def send(self, octets: bytes) -> float:
        """Put ``octets`` on the line; returns when the last bit has left."""


class Chip:
    """Common part of all chips."""

    speed: int = FULL_SPEED
    vendor: ClassVar[int]
    product: ClassVar[int]
    release: ClassVar[int]
    usb: ClassVar[int] = 0x0200
    control_size: ClassVar[int] = 64
    device_class: ClassVar[tuple[int, int, int]] = (0, 0, 0)
    interface_class: ClassVar[tuple[int, int, int]] = (0xFF, 0, 0)
    bulk_in: ClassVar[int]
    bulk_out: ClassVar[int]
    events_in: ClassVar[int] = 0
    packet: ClassVar[int] = 64
    #: poll interval of the interrupt endpoint in ms
    interval: ClassVar[int] = 1
    #: octets that it takes before they have left
    fifo: ClassVar[int] = 128
    maker: ClassVar[str] = ""
    name: ClassVar[str] = ""

    def __init__(self, host: Host, serial: str) -> None:
        self.host = host
        self.serial = serial
        self.real = 9600.0
        self.parity = "N"
        self.received: deque[Character] = deque()
        self._events: deque[bytes] = deque()
        self._in_fifo = 0

    # --- descriptors ---

    def _endpoint(self, address: int, kind: int, size: int, interval: int = 0) -> bytes:
        return struct.pack("<4BHB", 7, 5, address, kind, size, interval)

    def interfaces(self) -> tuple[int, bytes]:
        """The number of interfaces, and their descriptors."""
        ends = [
            self._endpoint(self.bulk_out, 2, self.packet),
            self._endpoint(_TO_HOST | self.bulk_in, 2, self.packet),
        ]
        if self.events_in:
            ends.insert(0, self._endpoint(_TO_HOST | self.events_in, 3, 16, self.interval))
        return 1, struct.pack("<9B", 9, 4, 0, 0, len(ends), *self.interface_class, 2) + b"".join(ends)

    def _descriptor(self, kind: int, number: int) -> bytes | None:
        if kind == 1:
            ids = (self.vendor, self.product, self.release)
            return struct.pack("<BBH4B3H4B", 18, 1, self.usb, *self.device_class, self.control_size, *ids, 1, 2, 3, 1)
        if kind == 2:
            count, body = self.interfaces()
            return struct.pack("<BBH5B", 9, 2, 9 + len(body), count, 1, 0, 0xA0, 45) + body
        if kind == 3:
            text = ("", self.maker, self.name, self.serial)[number].encode("utf-16-le") if number else b"\x09\x04"
            return bytes((len(text) + 2, 3)) + text
        return None

    # --- requests ---

    def control(self, setup: bytes, data: bytes) -> bytes | None:
        kind, request, value, index, length = struct.unpack("<BBHHH", setup)
        if kind & _STANDARD:
            return self.request(kind, request, value, index, length, data)
        if request == _GET_DESCRIPTOR:
            return self._descriptor(value >> 8, value & 0xFF)
        return b"\0\0" if request == _GET_STATUS else b""

    def request(self, kind: int, request: int, value: int, index: int, length: int, data: bytes) -> bytes | None:
        return b"\0" * length if kind & _TO_HOST else b""

    def set_rate(self, real: float, how: str) -> None:
        self.real = real
        self.host.log("rate", real=round(real, 1), how=how)

    def set_frame(self, bits: int, parity: str) -> None:
        self.parity = parity
        self.host.log("frame", bits=bits, parity=parity)

    def set_lines(self, dtr: int, rts: int) -> None:
        self.host.log("lines", dtr=dtr, rts=rts)

    def change_lines(self, value: int) -> None:
        """DTR and RTS in bits 0 and 1, where bits 8 and 9 say that they change."""
        changed = {name: value >> bit & 1 for bit, name in enumerate(("dtr", "rts")) if value >> 8 >> bit & 1}
        self.host.log("lines", **changed)

    # --- octets ---

    def out(self, data: bytes, taken: Callable[[], None]) -> None:
        """Octets for the line: the transfer ends when the FIFO has taken all of them."""
        end = self.host.send(data)
        self._in_fifo += len(data)
        self.host.later(end, lambda: self._left(len(data)))
        if self._in_fifo > self.fifo:
            self.host.later(end - self.fifo * BITS / self.real, taken)  # the rest of it fits
        else:
            taken()

    def _left(self, count: int) -> None:
        self._in_fifo -= count

    @property
    def is_empty(self) -> bool:
        """Nothing is left to send."""
        return not self._in_fifo

    def receive(self, characters: Sequence[Character]) -> None:
        self.received.extend(characters)
        self.host.feed(self.bulk_in)

    def data_in(self, endpoint: int, size: int) -> bytes | None:
        if endpoint == self.events_in:
            return self._events.popleft() if self._events else None
        return self.octets_in(size)

    def octets_in(self, size: int) -> bytes | None:
        if not self.received:
            return None
        return bytes(self.received.popleft()[0] for _ in range(min(size, len(self.received))))

    def event(self, octets: bytes, late_s: float = 0.0) -> None:
        """Report ``octets`` at the interrupt endpoint after ``late_s``."""

        def report() -> None:
            self._events.append(octets)
            self.host.feed(self.events_in)

        self.host.later(self.host.now() + late_s, report) if late_s else report()


class Ft232r(Chip):
    """3 MHz by a divisor in eighths; two status octets before each packet, one error bit for all of its octets."""

    vendor, product, release, control_size = 0x0403, 0x6001, 0x0600, 8
    interface_class = (0xFF, 0xFF, 0xFF)
    bulk_in, bulk_out = 1, 2
    maker, name = "FTDI", "FT232R USB UART"
    #: the fourteenth and following bits of a divisor are eighths in this order
    _EIGHTHS: ClassVar = (0, 4, 2, 1, 3, 5, 6, 7)
    _ERROR: ClassVar = 0x04
    _PAYLOAD: ClassVar = 62

    def __init__(self, host: Host, serial: str) -> None:
        super().__init__(host, serial)
        self.latency_ms = 16
        self.event_octet: int | None = None
        #: reports its status at each end of the latency time, as the chip does; costs time of the machine
        self.reports = False
        #: the latency timer cannot be set (a chip that dpstack may not set: old kernels, no rights)
        self.stuck_ms = 0
        self._last_packet = 0.0
        self._timed = False

    def request(self, kind: int, request: int, value: int, index: int, length: int, data: bytes) -> bytes | None:
        if kind & _TO_HOST:
            if request == 0x05:
                return bytes((0x01, 0x60 if self.is_empty else 0))
            return bytes((self.latency_ms,)) if request == 0x0A else b"\0" * length
        if request == 0x00 and value == 1:
            self.received.clear()
        elif request == 0x01:
            self.change_lines(value)
        elif request == 0x03:
            self._divide(value, index)
        elif request == 0x04:
            self.set_frame(value & 0xFF, _PARITY[value >> 8 & 7])
        elif request == 0x06:
            self.event_octet = value & 0xFF if value & 0x100 else None
            self.host.log("event_char", octet=self.event_octet)
        elif request == 0x09:
            self.latency_ms = self.stuck_ms or value
            self.host.log("latency", ms=value)
        return b""

    def _divide(self, value: int, index: int) -> None:
        eighths = self._EIGHTHS[value >> 14 | (index & 1) << 2]
        whole = value & 0x3FFF
        real = {0: 3e6, 1: 2e6}.get(whole, 24e6 / (8 * whole + eighths or 1)) if not eighths or whole > 1 else 0.0
        self.set_rate(real, f"divisor {whole} + {eighths}/8")

    def octets_in(self, size: int) -> bytes | None:
        now, due = self.host.now(), self._last_packet + self.latency_ms / 1000
        wanted = any(octet == self.event_octet for octet, _bad in self.received)
        if len(self.received) < self._PAYLOAD and not wanted and not (now >= due and (self.received or self.reports)):
            if (self.received or self.reports) and not self._timed:
                self._timed = True
                self.host.later(due, self._time_is_up)
            return None
        packets = bytearray()
        while not packets or (self.received and len(packets) + self._PAYLOAD + 2 <= size):
            part = [self.received.popleft() for _ in range(min(self._PAYLOAD, len(self.received)))]
            line = (0x60 if self.is_empty else 0) | (self._ERROR if any(bad for _, bad in part) else 0)
            packets += bytes((0x01, line, *(octet for octet, _bad in part)))
            if len(part) < self._PAYLOAD:
                break
        self._last_packet = now
        return bytes(packets)

    def _time_is_up(self) -> None:
        self._timed = False
        self.host.feed(self.bulk_in)


class Ft232h(Ft232r):
    """12 MHz, too, and packets of 512 octets (62 are used)."""

    product, release, control_size, packet, fifo = 0x6014, 0x0900, 64, 512, 1024
    speed = HIGH_SPEED
    name = "Single RS232-HS"

    def _divide(self, value: int, index: int) -> None:
        if not index >> 9 & 1:
            super()._divide(value, index >> 8)
            return
        whole, eighths = value & 0x3FFF, self._EIGHTHS[value >> 14 | (index >> 8 & 1) << 2]
        self.set_rate(96e6 / (8 * whole + eighths or 8), f"12 MHz by {whole} + {eighths}/8")


class Cp2102n(Chip):
    """24 MHz / n. In event mode an octet with an error is announced at its place."""

    vendor, product, release = 0x10C4, 0xEA60, 0x0100
    bulk_in = bulk_out = 2
    fifo = 512
    maker, name = "Silicon Labs", "CP2102N USB to UART Bridge Controller"
    part: ClassVar[int] = 0x22
    #: a counterfeit answers with one octet where it is asked for two: the driver then leaves the event mode off
    is_genuine: ClassVar[bool] = True
    clock: ClassVar[float] = 24e6

    def __init__(self, host: Host, serial: str) -> None:
        super().__init__(host, serial)
        self.escape: int | None = None

    def request(self, kind: int, request: int, value: int, index: int, length: int, data: bytes) -> bytes | None:
        if kind & _TO_HOST:
            return self._told(request, value, length)
        if request == 0x1E:
            (wish,) = struct.unpack("<I", data)
            self.set_rate(self.made(wish), f"baud {wish}")
        elif request == 0x03:
            self.set_frame(value >> 8, _PARITY[value >> 4 & 7])
        elif request == 0x07:
            self.change_lines(value)
        elif request == 0x13:
            handshake, flow = struct.unpack_from("<2I", data)
            self.set_lines(handshake & 3, flow >> 6 & 3)
        elif request == 0x15:
            self.escape = value or None
        return b""

    def _told(self, request: int, value: int, length: int) -> bytes:
        if request == 0xFF and value == 0x370B:
            return bytes((self.part,)) + (b"\0" * (length - 1) if self.is_genuine else b"")
        if request == 0xFF and value == 0x0010:
            return b"\x01\x00\x08"
        if request == 0x1D:
            return struct.pack("<I", round(self.real))
        if request == 0x04:
            return b"\x00\x08"
        if request == 0x10:
            return struct.pack("<4I3B", 0, 0, 0, self._in_fifo, 0, 0, 0)
        return b"\0" * length

    def made(self, wish: int) -> float:
        return self.clock / max(8, round(self.clock / max(wish, 1)))

    def receive(self, characters: Sequence[Character]) -> None:
        if self.escape is None:
            super().receive(characters)
            return
        stream: list[Character] = []
        for octet, bad in characters:
            if bad:  # line status with the parity bit, and the octet
                stream += [(self.escape, False), (1, False), (0x05, False), (octet, False)]
            elif octet == self.escape:
                stream += [(octet, False), (0, False)]
            else:
                stream.append((octet, False))
        super().receive(stream)


class Cp2102(Cp2102n):
    """A fixed list of rates (AN205); the driver asks for those."""

    name, part, fifo = "CP2102 USB to UART Bridge Controller", 0x02, 640


class Cp2102Clone(Cp2102):
    """A counterfeit without event mode."""

    is_genuine = False


class Ch340(Chip):
    """48 MHz by a prescaler and a divisor; an error is one bit at the interrupt endpoint, which the driver ignores."""

    vendor, product, release, usb, control_size = 0x1A86, 0x7523, 0x0264, 0x0110, 8
    interface_class, packet, fifo = (0xFF, 1, 2), 32, 32
    bulk_in, bulk_out, events_in = 2, 2, 1
    name = "USB Serial"
    _DIVISOR, _FRAME = 0x1312, 0x2518

    def __init__(self, host: Host, serial: str) -> None:
        super().__init__(host, serial)
        self._registers = {0x05: 0, 0x18: 0}

    def request(self, kind: int, request: int, value: int, index: int, length: int, data: bytes) -> bytes | None:
        if kind & _TO_HOST:
            if request == 0x5F:
                return b"\x31\x00"
            if request == 0x95:
                registers = (value & 0xFF, value >> 8)
                if value == 0x0706:
                    return b"\xff\xee"
                return bytes(self._registers.get(one, 0) for one in registers)[:length]
            return b"\0" * length
        if request == 0xA4:
            self.set_lines(~value >> 5 & 1, ~value >> 6 & 1)
        elif request == 0x9A:
            self._registers.update({value & 0xFF: index & 0xFF, value >> 8: index >> 8})
            if value == self._DIVISOR:
                prescaler, factor, divisor = index & 3, index >> 2 & 1, 256 - (index >> 8)
                self.set_rate(48e6 / (1 << 12 - 3 * prescaler - factor) / divisor, f"divisor {index:04x}")
            elif value == self._FRAME:
                parity = "N" if not index & 8 else "E" if index & 0x10 else "O"
                self.set_frame(5 + (index & 3), parity)
        return b""

    def receive(self, characters: Sequence[Character]) -> None:
        if any(bad for _, bad in characters):
            self.event(b"\x08\x44\xbf\xef")
        super().receive(characters)


class CdcCoding(Chip):
    """Line coding as the class of modems has it; PL2303 uses the same requests."""

    def __init__(self, host: Host, serial: str) -> None:
        super().__init__(host, serial)
        self._coding = struct.pack("<I3B", 9600, 0, 0, 8)
        #: the next delays of an error at the interrupt endpoint in s, in turn
        self.late: deque[float] = deque([0.0])

    def late_event(self, octets: bytes) -> None:
        late = self.late[0]
        self.late.rotate(-1)
        self.event(octets, late)

    def request(self, kind: int, request: int, value: int, index: int, length: int, data: bytes) -> bytes | None:
        if (kind, request) == (0xA1, 0x21):
            return self._coding
        if kind & _TO_HOST:
            return b"\0" * length
        if (kind, request) == (0x21, 0x20):
            self._coding = data
            self.set_rate(*self.made(data[:4]))
            self.set_frame(data[6], _PARITY[data[5]])
        elif (kind, request) == (0x21, 0x22):
            self.set_lines(value & 1, value >> 1 & 1)
        return b""

    def made(self, rate: bytes) -> tuple[float, str]:
        """The rate that the chip makes, and how."""
        (wish,) = struct.unpack("<I", rate)
        return float(wish), f"dwDTERate {wish}"


class Pl2303(CdcCoding):
    """HX: rates of a list directly, others as a divisor. An error comes by the interrupt endpoint, which the driver
    applies to the next bulk packet."""

    vendor, product, release, usb = 0x067B, 0x2303, 0x0300, 0x0110
    bulk_in, bulk_out, events_in, fifo = 3, 2, 1, 256
    maker, name = "Prolific Technology Inc.", "USB-Serial Controller"

    def made(self, rate: bytes) -> tuple[float, str]:
        (word,) = struct.unpack("<I", rate)
        if not word >> 31:
            return float(word), f"direct {word}"
        return self.divided(rate), f"divisor {rate.hex()}"

    def divided(self, rate: bytes) -> float:
        return 384e6 / ((rate[1] & 1) << 8 | rate[0] or 1) / (1 << 2 * (rate[1] >> 1))

    def receive(self, characters: Sequence[Character]) -> None:
        if any(bad for _, bad in characters):
            self.late_event(bytes(8) + b"\x20\x00")
        super().receive(characters)


class Pl2303Hxd(Pl2303):
    release = 0x0400


class Pl2303Ta(Pl2303):
    usb, release = 0x0200, 0x0300

    def divided(self, rate: bytes) -> float:
        return 384e6 / ((rate[1] & 7) << 8 | rate[0] or 1) / (1 << (rate[1] >> 4 & 14 | rate[2] & 1))


class CdcAcm(CdcCoding):
    """A microcontroller that says to be a modem (STM32): SERIAL_STATE counts an error, up to bInterval late."""

    vendor, product, release, device_class = 0x0483, 0x5740, 0x0200, (2, 0, 0)
    bulk_in, bulk_out, events_in, interval = 1, 1, 2, 16
    maker, name = "STMicroelectronics", "STM32 Virtual ComPort"

    def interfaces(self) -> tuple[int, bytes]:
        modem = struct.pack("<9B", 9, 4, 0, 0, 1, 2, 2, 1, 0)
        modem += bytes.fromhex("0524001001 0524010001 04240202 0524060001")
        modem += self._endpoint(_TO_HOST | self.events_in, 3, 16, self.interval)
        data = struct.pack("<9B", 9, 4, 1, 0, 2, 10, 0, 0, 0)
        data += self._endpoint(self.bulk_out, 2, 64) + self._endpoint(_TO_HOST | self.bulk_in, 2, 64)
        return 2, modem + data

    def receive(self, characters: Sequence[Character]) -> None:
        super().receive(characters)
        for _ in range(sum(bad for _, bad in characters)):
            self.late_event(bytes.fromhex("a120000000000200 2300"))  # bParity


CHIPS: Final[dict[str, type[Chip]]] = {
    "ft232r": Ft232r,
    "ft232h": Ft232h,
    "cp2102n": Cp2102n,
    "cp2102": Cp2102,
    "cp2102clone": Cp2102Clone,
    "ch340": Ch340,
    "pl2303hx": Pl2303,
    "pl2303hxd": Pl2303Hxd,
    "pl2303ta": Pl2303Ta,
    "cdcacm": CdcAcm,
}
