"""pcapng files: a writer for what was heard on a line, and a reader for files of any program.

Sources: draft-ietf-opsawg-pcapng (blocks, options), the list of link types of tcpdump.org. Times are nanoseconds since
1970-01-01 UTC.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import BinaryIO, Final, NamedTuple, Protocol

from dpstack.capture.transmission import Damage
from dpstack.errors import CaptureFileError
from dpstack.units import NS_PER_S

#: link types: the first private one, which dissectors of users can be bound to, and PROFIBUS DP as registered
USER0, PROFIBUS_DL = 147, 257

_SECTION, _INTERFACE, _OLD_PACKET, _SIMPLE_PACKET, _STATISTICS, _PACKET = 0x0A0D0D0A, 1, 2, 3, 5, 6
_MAGIC: Final = 0x1A2B3C4D
#: options: end, comment; of a section; of an interface; of a packet; of statistics
_END, _COMMENT = 0, 1
_APPLICATION: Final = 4
_IF_NAME, _IF_DESCRIPTION, _IF_SPEED, _IF_TSRESOL, _IF_TSOFFSET = 2, 3, 8, 9, 14
_FLAGS: Final = 2
_START, _STOP, _RECEIVED, _DROPPED = 2, 3, 4, 5
#: A PROFIBUS telegram has 255 octets at most, a stranger's packet up to 64 KiB; no block that is read needs more.
_MOST: Final = 1 << 20
#: interfaces of one section
_MOST_INTERFACES: Final = 4096
_NANO: Final = 9
_MICRO: Final = 6
_OTHER_FILES: Final[dict[bytes, str]] = {
    b"\xa1\xb2\xc3\xd4": "pcap",
    b"\xd4\xc3\xb2\xa1": "pcap",
    b"\xa1\xb2\x3c\x4d": "pcap",
    b"\x4d\x3c\xb2\xa1": "pcap",
}


@dataclass(frozen=True, slots=True)
class Interface:
    """One port of a capture. ``bits_per_s``: 0 where the file does not say; ``unit``: if_tsresol, of its times."""

    name: str = ""
    linktype: int = USER0
    bits_per_s: int = 0
    description: str = ""
    unit: int = _MICRO
    offset_s: int = 0
    snap: int = 0

    def to_ns(self, ticks: int) -> int:
        """A 64-bit time of this interface in ns since 1970."""
        exponent = self.unit & 0x7F
        ns = ticks * NS_PER_S >> exponent if self.unit & 0x80 else ticks * NS_PER_S // 10**exponent
        return ns + self.offset_s * NS_PER_S


class Packet(NamedTuple):
    """The octets of one transmission. ``t_ns`` is None in a block without a time (Simple Packet Block)."""

    interface: Interface
    t_ns: int | None
    octets: bytes
    flags: int = 0
    comments: tuple[str, ...] = ()

    @property
    def damage(self) -> Damage:
        return Damage(self.flags & sum(Damage))


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<HH", code, len(value)) + value + bytes(-len(value) % 4)


def _block(kind: int, body: bytes) -> bytes:
    size = struct.pack("<I", len(body) + 12)
    return struct.pack("<I", kind) + size + body + size


_HEAD: Final = struct.Struct("<IIIIIII").pack
_TAIL: Final = struct.Struct("<I").pack
_PAD: Final = (b"", b"\0\0\0", b"\0\0", b"\0")


class Writer:
    """Writes one section to ``file``, each block with one call of ``write``."""

    def __init__(self, file: BinaryIO, application: str) -> None:
        self._write: Callable[[bytes], object] = file.write
        self._interfaces = 0
        body = struct.pack("<IHHq", _MAGIC, 1, 0, -1) + _option(_APPLICATION, application.encode()) + _option(_END, b"")
        self._write(_block(_SECTION, body))

    def interface(self, name: str, bits_per_s: int, description: str, *, linktype: int = USER0) -> int:
        """Describe a port, or the same port at another rate; returns its number for :meth:`packet`."""
        options = (
            _option(_IF_NAME, name.encode())
            + _option(_IF_DESCRIPTION, description.encode())
            + _option(_IF_SPEED, struct.pack("<Q", bits_per_s))
            + _option(_IF_TSRESOL, bytes((_NANO,)))
            + _option(_END, b"")
        )
        self._write(_block(_INTERFACE, struct.pack("<HHI", linktype, 0, 0) + options))
        self._interfaces += 1
        return self._interfaces - 1

    def packet(self, interface: int, t_ns: int, octets: bytes, flags: int = 0, comment: str = "") -> None:
        """Octets whose first bit was on the line at ``t_ns`` (ns since 1970)."""
        size = len(octets)
        pad = _PAD[size & 3]
        if not flags and not comment:  # the usual one, without options
            length = 32 + size + len(pad)
            head = _HEAD(_PACKET, length, interface, t_ns >> 32, t_ns & 0xFFFFFFFF, size, size)
            self._write(head + octets + pad + _TAIL(length))
            return
        options = (_option(_COMMENT, comment.encode()) if comment else b"") + _option(_FLAGS, _TAIL(flags))
        body = struct.pack("<IIIII", interface, t_ns >> 32, t_ns & 0xFFFFFFFF, size, size) + octets + pad
        self._write(_block(_PACKET, body + options + _option(_END, b"")))

    def statistics(self, interface: int, start_ns: int, end_ns: int, received: int, dropped: int) -> None:
        """Counters of the capture of a port up to ``end_ns``: packets received, packets lost in the computer."""
        times = [struct.pack("<II", t >> 32, t & 0xFFFFFFFF) for t in (start_ns, end_ns)]
        options = (
            _option(_START, times[0])
            + _option(_STOP, times[1])
            + _option(_RECEIVED, struct.pack("<Q", received))
            + _option(_DROPPED, struct.pack("<Q", dropped))
            + _option(_END, b"")
        )
        self._write(_block(_STATISTICS, struct.pack("<I", interface) + times[1] + options))


class Readable(Protocol):
    """A file open for reading octets; ``read`` may return fewer than asked for, and none at the end."""

    def read(self, size: int, /) -> bytes: ...


class Reader:
    """Iterates over the packets of a pcapng ``file``, in the file's order; reads block by block, in bounded memory.

    ``name`` is the file's in messages. The iteration raises CaptureFileError, with the place in the file, where a block
    cannot be read: the packets before it have been delivered. A file that ends within a block, as one whose writer was
    killed, ends the iteration, and ``cut`` says how much was left over.
    """

    def __init__(self, file: Readable, name: str) -> None:
        self.name = name
        self.cut = ""
        self._file = file
        self._at = 0
        self._held = b""
        self._order = "<"
        self._interfaces: list[Interface] = []

    def __iter__(self) -> Iterator[Packet]:
        read: Mapping[int, Callable[[bytes], Packet | None]] = {
            _SECTION: self._section,
            _INTERFACE: self._interface,
            _PACKET: self._packet,
            _SIMPLE_PACKET: self._simple_packet,
            _OLD_PACKET: self._old_packet,
        }
        self._first()
        while True:
            block = self._next(read)
            if block is None:
                return
            kind, body = block
            if kind in read:
                try:
                    packet = read[kind](body)
                except struct.error:
                    raise self._wrong("a block is shorter than its fields") from None
                if packet is not None:
                    yield packet

    def _wrong(self, text: str) -> CaptureFileError:
        return CaptureFileError(f"{self.name}: {text} (at octet {self._at})")

    def _exactly(self, size: int) -> bytes:
        """Up to ``size`` octets, fewer at the end of the file only; a pipe delivers them in pieces."""
        parts = bytearray()
        while len(parts) < size:
            more = self._file.read(min(size - len(parts), _MOST))
            if not more:
                break
            parts += more
        return bytes(parts)

    def _first(self) -> None:
        """The head of the first block, which tells what kind of file this is; it is read again as a block."""
        self._held = self._exactly(12)
        if self._held[:4] == _SECTION.to_bytes(4, "little"):
            return
        known = _OTHER_FILES.get(self._held[:4])
        if known is not None:
            raise self._wrong(f"this is a {known} file, not pcapng; convert it: editcap -F pcapng OLD NEW")
        if self._held[:2] == b"\x1f\x8b":
            raise self._wrong("this file is compressed; unpack it with gunzip")
        raise self._wrong("this is no pcapng file" if self._held else "the file is empty")

    def _next(self, wanted: Mapping[int, object]) -> tuple[int, bytes] | None:
        """The next block's type and body (empty where it is not ``wanted``); None at the end."""
        head, self._held = self._held + self._exactly(12 - len(self._held)), b""
        if len(head) < 12:
            self.cut = f"{len(head)} octets of a last block are not read" if head else ""
            return None
        if head[:4] == _SECTION.to_bytes(4, "little"):  # the same octets in both orders
            self._order = "<" if head[8:] == _MAGIC.to_bytes(4, "little") else ">"
            if head[8:] != struct.pack(self._order + "I", _MAGIC):
                raise self._wrong("a section without the magic number of pcapng")
        kind, size = struct.unpack(self._order + "II", head[:8])
        if size < 12 or size % 4:
            raise self._wrong(f"a block of type {kind} claims {size} octets: lengths are multiples of 4, at least 12")
        if kind in wanted and size > _MOST:
            raise self._wrong(f"a block of type {kind} claims {size} octets, more than {_MOST}")
        body = head[8:] if size > 12 else b""
        rest = size - 12 if size > 12 else 0
        tail = head[8:] if size == 12 else b""
        read = 12
        while rest:
            part = self._exactly(min(rest, _MOST))
            read += len(part)
            rest -= len(part)
            if kind in wanted:
                body += part
            tail = (tail + part)[-4:]
            if not part:
                self.cut = f"{read} octets of a last block are not read"
                return None
        (again,) = struct.unpack(self._order + "I", tail)
        if again != size:
            raise self._wrong(f"a block of type {kind} has two lengths, {size} and {again}")
        self._at += size
        return kind, body[:-4] if size > 12 else b""

    def _options(self, octets: bytes) -> Iterator[tuple[int, bytes]]:
        at = 0
        while at + 4 <= len(octets):
            code, size = struct.unpack_from(self._order + "HH", octets, at)
            if code == _END:
                return
            if at + 4 + size > len(octets):
                raise self._wrong(f"an option of type {code} claims {size} octets, more than its block has")
            yield code, octets[at + 4 : at + 4 + size]
            at += 4 + size + (-size % 4)

    def _section(self, body: bytes) -> None:
        _, major, _minor = struct.unpack_from(self._order + "IHH", body)
        if major != 1:
            raise self._wrong(f"pcapng version {major} is not known here")
        self._interfaces.clear()

    def _interface(self, body: bytes) -> None:
        if len(self._interfaces) == _MOST_INTERFACES:
            raise self._wrong(f"a section with more than {_MOST_INTERFACES} interfaces")
        linktype, _, snap = struct.unpack_from(self._order + "HHI", body)
        found = dict(self._options(body[8:]))
        unit = found.get(_IF_TSRESOL, b"")
        self._interfaces.append(
            Interface(
                name=found.get(_IF_NAME, b"").decode(errors="replace"),
                linktype=linktype,
                bits_per_s=self._number(found.get(_IF_SPEED, b"")),
                description=found.get(_IF_DESCRIPTION, b"").decode(errors="replace"),
                unit=unit[0] if unit else _MICRO,
                offset_s=self._number(found.get(_IF_TSOFFSET, b""), signed=True),
                snap=snap,
            )
        )

    def _number(self, octets: bytes, *, signed: bool = False) -> int:
        return int.from_bytes(octets, "little" if self._order == "<" else "big", signed=signed)

    def _of(self, number: int) -> Interface:
        if number >= len(self._interfaces):
            raise self._wrong(
                f"a packet of interface {number}, of {len(self._interfaces)} that are described before it"
            )
        return self._interfaces[number]

    def _timed(self, interface: Interface, high: int, low: int, rest: bytes, size: int) -> Packet:
        if size > len(rest):
            raise self._wrong(f"a packet claims {size} octets, its block has {len(rest)}")
        flags = 0
        comments = []
        for code, value in self._options(rest[size + (-size % 4) :]):
            if code == _COMMENT:
                comments.append(value.decode(errors="replace"))
            elif code == _FLAGS:
                flags = self._number(value[:4])
        return Packet(interface, interface.to_ns(high << 32 | low), rest[:size], flags, tuple(comments))

    def _packet(self, body: bytes) -> Packet:
        number, high, low, size, _ = struct.unpack_from(self._order + "IIIII", body)
        return self._timed(self._of(number), high, low, body[20:], size)

    def _old_packet(self, body: bytes) -> Packet:
        number, _, high, low, size, _ = struct.unpack_from(self._order + "HHIIII", body)
        return self._timed(self._of(number), high, low, body[20:], size)

    def _simple_packet(self, body: bytes) -> Packet:
        (size,) = struct.unpack_from(self._order + "I", body)
        interface = self._of(0)
        kept = min(size, interface.snap or size)
        if kept > len(body) - 4:
            raise self._wrong(f"a packet claims {kept} octets, its block has {len(body) - 4}")
        return Packet(interface, None, body[4 : 4 + kept])
