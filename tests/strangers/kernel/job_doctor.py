"""Drivers as ``dpstack doctor`` sees them beside what the chip was sent, and damaged octets on the line.

``job_doctor CHIP...``: a row ``adapter`` for each chip, and one for the UART of a PC (/dev/ttyS1).
"""

from __future__ import annotations

import fcntl
import os
import struct
import sys
import termios
import time

from vm_lab import Plugged, attempt, dpstack_json, opened, plugged, row, serial_line

from dpstack.errors import DpError
from dpstack.ports import tuning
from dpstack.ports.sysfs import Adapter
from dpstack.ports.tty import TtyPort
from dpstack.units import BAUD_RATES

_TCGETS2, _TCSETS2 = 0x802C542A, 0x402C542B
_TERMIOS2 = struct.Struct("=4IB19s2I")
_COM2 = 0x2F8
#: a rate that every one of the chips makes
_COMMON = 500_000


def settings(fd: int) -> list[object]:
    buffer = bytearray(_TERMIOS2.size)
    fcntl.ioctl(fd, _TCGETS2, buffer, True)
    return list(_TERMIOS2.unpack(buffer))


def set_8e1(fd: int, baud: int, input_flags: int = 0) -> int:
    """Raw 8E1 at ``baud``, without dpstack; returns the rate that reads back."""
    _i, _o, control, _l, line, chars, *_speeds = settings(fd)
    assert isinstance(control, int)
    assert isinstance(chars, bytes)
    control = control & ~(0o010017 | 0o02003600000 | termios.CSIZE) | 0o010000
    control |= termios.CS8 | termios.PARENB | termios.CLOCAL | termios.CREAD
    least = bytearray(chars)
    least[termios.VMIN], least[termios.VTIME] = 1, 0
    fcntl.ioctl(fd, _TCSETS2, _TERMIOS2.pack(input_flags, 0, control, 0, line, bytes(least), baud, baud))
    read_back = settings(fd)[7]
    assert isinstance(read_back, int)
    return read_back


def divisor() -> int:
    """The divisor in the registers of /dev/ttyS1."""
    with open("/dev/port", "r+b", buffering=0) as ports:

        def access(register: int, value: int | None = None) -> int:
            ports.seek(_COM2 + register)
            if value is None:
                return ports.read(1)[0]
            return ports.write(bytes((value,)))

        frame = access(3)
        access(3, frame | 0x80)
        found = access(0) | access(1) << 8
        access(3, frame)
        return found


def port_says(path: str, baud: int) -> dict[str, object]:
    """What dpstack does with the port at this rate: its refusal, or its notices."""
    port = TtyPort(path, baud)
    try:
        port.open_now()
        return {"opens": True, "notices": port.notices}
    except DpError as error:
        return {"opens": False, "refusal": str(error)}
    finally:
        port.close()


def rates(path: str, adapter: Plugged | None) -> list[dict[str, object]]:
    found = []
    for baud in BAUD_RATES:
        if adapter is not None:
            adapter.news()
        with opened(path) as fd:
            read_back = attempt(lambda baud=baud, fd=fd: set_8e1(fd, baud))  # type: ignore[misc]
            if adapter is None:
                made: object = 115_200 / divisor()
            else:
                sent = adapter.news("rate")
                made = sent[-1]["real"] if sent else None
        found.append({"baud": baud, "read_back": read_back, "made": made, **port_says(path, baud)})
    return found


def abilities(fd: int, path: str) -> dict[str, object]:
    """The answers of the ioctls, each tried for what it does, not for its return value."""

    def low_latency() -> bool:
        tuning_buffer = bytearray(128)
        fcntl.ioctl(fd, 0x541E, tuning_buffer, True)
        (flags,) = struct.unpack_from("=I", tuning_buffer, 16)
        struct.pack_into("=I", tuning_buffer, 16, flags | 1 << 13)
        fcntl.ioctl(fd, 0x541F, tuning_buffer, True)
        fcntl.ioctl(fd, 0x541E, tuning_buffer, True)
        return bool(struct.unpack_from("=I", tuning_buffer, 16)[0] & 1 << 13)

    def rs485() -> str:
        words = bytearray(32)
        fcntl.ioctl(fd, 0x542E, words, True)
        fcntl.ioctl(fd, 0x542F, words, True)
        return "set"

    return {
        "serial": attempt(lambda: serial_line(fd)),
        "low_latency": attempt(low_latency),
        "rs485": attempt(rs485),
        "counters": attempt(lambda: bool(tuning.uart_errors(fd) is not None)),
        "latency_ms": Adapter(path).latency_ms(),
    }


def marks(adapter: Plugged) -> dict[str, object]:
    """Octets with and without a parity error as the tty delivers them."""
    with opened(adapter.tty) as fd:
        adapter.say("late", "0")
        set_8e1(fd, _COMMON, termios.IGNBRK | termios.INPCK | termios.PARMRK)
        time.sleep(0.05)
        termios.tcflush(fd, termios.TCIOFLUSH)
        before = attempt(lambda: tuning.uart_errors(fd)["parity"])
        found: dict[str, object] = {}
        for name, command, octets in (
            ("clean", "octets", "100203ff04ec05"),
            ("bad", "bad", "68112233"),
            ("after", "octets", "a1a2"),
            ("bad_late", "bad", "68112233"),
            ("after_late", "octets", "a1a2"),
        ):
            if name == "bad_late":  # an error at the interrupt endpoint comes behind the octets
                adapter.say("late", "50")
            adapter.say(command, octets)
            time.sleep(0.1)
            found[name] = attempt(lambda: os.read(fd, 100).hex())
        after = attempt(lambda: tuning.uart_errors(fd)["parity"])
    counted = after - before if isinstance(after, int) and isinstance(before, int) else after
    return {**found, "counted": counted}


def through_the_port(adapter: Plugged) -> dict[str, object]:
    """What dpstack makes of octets with a parity error, and what it says."""
    port = TtyPort(adapter.tty, _COMMON)
    port.open_now()
    try:
        adapter.say("late", "0")
        time.sleep(0.05)
        port.read_now()
        adapter.say("bad", "68112233")
        time.sleep(0.1)
        return {"delivered": port.read_now().hex(), "says": port.damaged_octets, "notices": port.notices}
    finally:
        port.close()


def drained(adapter: Plugged) -> dict[str, object]:
    """When the driver calls 96 octets at 9.6 kbit/s (110 ms) sent, and when the last one has left (ms)."""
    with opened(adapter.tty) as fd:
        set_8e1(fd, 9_600)
        time.sleep(0.05)
        adapter.news()
        begun = time.monotonic()
        os.write(fd, bytes(range(1, 49)) * 2)

        def waiting() -> int:
            return int(struct.unpack("=i", fcntl.ioctl(fd, termios.TIOCOUTQ, b"\0\0\0\0"))[0])

        while waiting() and time.monotonic() < begun + 2:
            time.sleep(0.001)
        empty = time.monotonic()
        fcntl.ioctl(fd, 0x5409, 1)  # tcdrain
        drained_at = time.monotonic()
        time.sleep(0.3)
        left = [entry["t"] for entry in adapter.news("line")]
    return {
        "queue_empty_ms": round(1e3 * (empty - begun)),
        "drained_ms": round(1e3 * (drained_at - begun)),
        "left_ms": round(1e3 * (max(left) - begun)) if left else None,
    }


def doctor(path: str) -> list[dict[str, str]]:
    return [check for check in dpstack_json("doctor", "--port", path)["checks"] if check["topic"] == path]


def main() -> None:
    for name in sys.argv[1:]:
        with plugged(name) as adapter:
            path, sysfs = adapter.tty, Adapter(adapter.tty)
            with opened(path) as fd:
                can = abilities(fd, path)
            row(
                "adapter",
                chip=name,
                driver=sysfs.driver,
                usb=sysfs.usb,
                rates=rates(path, adapter),
                **can,
                marks=marks(adapter),
                port=through_the_port(adapter),
                drain=drained(adapter),
                doctor=doctor(path),
                listed=next(one for one in dpstack_json("ports")["ports"] if one["path"] == path),
            )
    path = "/dev/ttyS1"
    with opened(path) as fd:
        can = abilities(fd, path)
    of_pc = {"driver": Adapter(path).driver, "usb": None, "rates": rates(path, None), "doctor": doctor(path)}
    row("adapter", chip="uart", **of_pc, **can)


if __name__ == "__main__":
    main()
