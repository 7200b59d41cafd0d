"""pcapng files: a writer for what was heard on a line, and a reader for files of any program.

Sources: draft-ietf-opsawg-pcapng (blocks, options), the list of link types of tcpdump.org. Times are nanoseconds since
1970-01-01 UTC.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Final, NamedTuple, Protocol

from msgspec import Struct

from dpstack.capture.transmission import Columns, Damage, Transmission
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
#: octets of an option's value
_MOST_OPTION: Final = 0xFFFF
#: sizes of packets: a telegram has 1 to 255 octets
_KEPT_SIZES: Final = 512
#: size of a packet without octets and options
_EMPTY_PACKET: Final = 32
#: packets that :meth:`Reader.batches` keeps, and the size of the largest one: a telegram has 255 octets
_KEPT_PACKETS: Final = 4096
_LARGEST_KEPT: Final = _EMPTY_PACKET + 256
#: octets that are read from a file at once
_PIECE: Final = 1 << 16
_TIMED: Final = (_PACKET, _OLD_PACKET)
_KNOWN: Final = frozenset((_SECTION, _INTERFACE, _SIMPLE_PACKET, *_TIMED))
_DAMAGED: Final = int(sum(Damage))
_NEW = tuple.__new__  # the constructor of a NamedTuple takes twice as long
#: interfaces of one section
_MOST_INTERFACES: Final = 4096
_NANO: Final = 9
_MICRO: Final = 6
#: how a pcap file begins: times in us and in ns, both byte orders
_PCAP: Final = (b"\xa1\xb2\xc3\xd4", b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\x3c\x4d", b"\x4d\x3c\xb2\xa1")


class Interface(Struct, frozen=True):
    """One port of a capture. ``bits_per_s``: 0 if the file does not say; ``unit``: if_tsresol, of its times."""

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
        return Damage(self.flags & _DAMAGED)


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<HH", code, len(value)) + value + bytes(-len(value) % 4)


def _block(kind: int, body: bytes) -> bytes:
    size = struct.pack("<I", len(body) + 12)
    return struct.pack("<I", kind) + size + body + size


def _text(text: str) -> bytes:
    """The value of an option with text: UTF-8, cut to the 65535 octets that an option can have."""
    octets = text.encode(errors="replace")
    return octets if len(octets) <= _MOST_OPTION else octets[:_MOST_OPTION].decode(errors="ignore").encode()


@lru_cache(_KEPT_SIZES)
def _whole_packet(size: int) -> tuple[Callable[..., bytes], int]:
    """For packets of ``size`` octets without options: the function that makes the block, and the block's length."""
    padded = size + -size % 4
    return struct.Struct(f"<IIIIIII{padded}sI").pack, 32 + padded


class Writable(Protocol):
    """A file open for writing octets."""

    def write(self, octets: bytes, /) -> object: ...


class Writer:
    """Writes one section to ``file``, each block with one call of ``write``."""

    def __init__(self, file: Writable, application: str) -> None:
        self._write: Callable[[bytes], object] = file.write
        self._interfaces = 0
        body = struct.pack("<IHHq", _MAGIC, 1, 0, -1) + _option(_APPLICATION, _text(application)) + _option(_END, b"")
        self._write(_block(_SECTION, body))

    def interface(self, name: str, bits_per_s: int, description: str, *, linktype: int = USER0) -> int:
        """Describe a port, or the same port at another rate; returns its number for :meth:`packet`."""
        options = (
            _option(_IF_NAME, _text(name))
            + _option(_IF_DESCRIPTION, _text(description))
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
        if not flags and not comment:  # the usual one, without options
            pack, length = _whole_packet(size)
            self._write(pack(_PACKET, length, interface, t_ns >> 32, t_ns & 0xFFFFFFFF, size, size, octets, length))
            return
        options = _option(_COMMENT, _text(comment)) if comment else b""
        options += _option(_FLAGS, struct.pack("<I", flags)) + _option(_END, b"")
        head = struct.pack("<IIIII", interface, t_ns >> 32, t_ns & 0xFFFFFFFF, size, size)
        self._write(_block(_PACKET, head + octets + bytes(-size % 4) + options))

    def statistics(
        self, interface: int, start_ns: int, end_ns: int, received: int, dropped: int, comment: str = ""
    ) -> None:
        """Counters of the capture of a port up to ``end_ns``: packets received, packets lost in the computer."""
        times = [struct.pack("<II", t >> 32, t & 0xFFFFFFFF) for t in (start_ns, end_ns)]
        options = (
            (_option(_COMMENT, _text(comment)) if comment else b"")
            + _option(_START, times[0])
            + _option(_STOP, times[1])
            + _option(_RECEIVED, struct.pack("<Q", received))
            + _option(_DROPPED, struct.pack("<Q", dropped))
            + _option(_END, b"")
        )
        self._write(_block(_STATISTICS, struct.pack("<I", interface) + times[1] + options))


class Piece(NamedTuple):
    """Whole blocks of a file behind the descriptions of their section and interfaces: by itself a pcapng file.
    ``before``: octets of the file before it, less those of the descriptions."""

    octets: bytes
    before: int


class Readable(Protocol):
    """A file open for reading octets; ``read`` may return fewer than asked for, and none at the end."""

    def read(self, size: int, /) -> bytes: ...


class Reader:
    """Iterates over the packets of a pcapng ``file``, in the file's order, in bounded memory: a block that it keeps,
    and one piece of the file. ``name`` is the file's in messages.

    ``before``: octets of the file before those that are read, for messages.

    The iteration raises CaptureFileError, with the place in the file, if a block cannot be read: the packets before
    it have been delivered. A file that ends within a block, as one whose writer was killed, ends the iteration, and
    ``cut`` says how much was left over.
    """

    def __init__(self, file: Readable, name: str, before: int = 0) -> None:
        self.name = name
        self.cut = ""
        #: a pipe delivers what is there; its ``read`` would wait for all that was asked for
        self._read: Callable[[int], bytes] = getattr(file, "read1", file.read)
        self._held = b""  # a piece of the file
        self._at = 0  # where the block begins in _held
        self._before = before  # octets of the file before _held
        self._kind = 0
        self._interfaces: list[Interface] = []
        self._turn("<")

    def _turn(self, order: str) -> None:
        """Take the byte order of a section, "<" or ">"."""
        self._order = order
        self._one = struct.Struct(order + "I").unpack_from
        self._two = struct.Struct(order + "II").unpack_from
        self._five = struct.Struct(order + "IIIII").unpack_from

    def __iter__(self) -> Iterator[Packet]:
        self._first()
        while size := self._next():
            packet = self._block(size)
            if packet is not None:
                yield packet

    def batches(self) -> Iterator[tuple[Interface, Columns | list[Transmission]]]:
        """The packets as transmissions, each batch with those of one interface that can be had without reading on. One
        with a comment or damage, or without a time, is a list of its own.

        On a bus most packets repeat all but the time of another one: those without options are kept by their octets.
        """
        self._first()
        kept: dict[bytes, bytes] = {}  # octets, by all of the packet after its time
        batch: list[bytes] = []
        times: list[int] = []
        interface, usual, baud, is_ns = Interface(), -1, 0, True
        while True:
            held, at, five = self._held, self._at, self._five
            length = len(held)
            last = length - _EMPTY_PACKET
            goes_on = False
            while at <= last:
                kind, size, number, high, low = five(held, at)
                stop = at + size
                goes_on = kind == _PACKET and number == usual and stop <= length
                if not goes_on:
                    break
                rest = held[at + 20 : stop]
                octets = kept.get(rest)
                if octets is None:
                    octets = self._without_options(rest, size)
                    if octets is None:
                        break
                    if size <= _LARGEST_KEPT:
                        if len(kept) >= _KEPT_PACKETS:
                            kept.clear()
                        kept[rest] = octets
                batch.append(octets)
                times.append(high << 32 | low if is_ns else interface.to_ns(high << 32 | low))
                at = stop
            else:
                goes_on = False
            self._at = at
            if batch and not goes_on:
                yield interface, Columns(baud, batch, times)
                batch, times = [], []
            # a block of another kind, a packet of another interface or with options, or one that is not all there
            packet = None
            try:
                size = self._next()
                if not size:
                    return
                at = self._at
                packet = self._block(size)
            except CaptureFileError:
                if batch:
                    yield interface, Columns(baud, batch, times)
                raise
            if packet is None:  # other interfaces, or another byte order
                kept.clear()
                usual = -1
                continue
            interface = packet.interface
            usual = self._five(self._held, at)[2] if self._kind == _PACKET else -1
            baud, is_ns = interface.bits_per_s, interface.unit == _NANO and not interface.offset_s
            damage = packet.flags & _DAMAGED
            if packet.comments or damage or packet.t_ns is None:
                if batch:
                    yield interface, Columns(baud, batch, times)
                    batch, times = [], []
                yield interface, [Transmission(packet.octets, packet.t_ns, baud, "; ".join(packet.comments), damage)]
            else:
                batch.append(packet.octets)
                times.append(packet.t_ns)

    def pieces(self, size: int) -> Iterator[Piece]:
        """The packets in pieces of about ``size`` octets, for readers in other processes. Not all is checked: another
        reader finds what is wrong in a piece."""
        self._first()
        head, blocks, begin = b"", bytearray(), 0
        while True:
            held, at, two = self._held, self._at, self._two
            last = min(len(held) - _EMPTY_PACKET, at + size - len(blocks))
            while at <= last:
                kind, length = two(held, at)
                if kind != _PACKET or length & 3 or not _EMPTY_PACKET <= length <= len(held) - at:
                    break
                at += length
            if at > self._at and not blocks:
                begin = self._before + self._at
            blocks += held[self._at : at]
            self._at = at
            packets = len(blocks)
            try:
                length = self._next()
                place = self._before + self._at
                if length and (self._kind == _SECTION or self._kind == _INTERFACE):
                    block = self._held[self._at : self._at + length]
                    ends = True
                    self._block(length)
                else:
                    ends = not length or packets >= size or (packets > 0 and place != begin + packets)
                    block = b""
            except CaptureFileError:
                if blocks:
                    yield Piece(head + blocks, begin - len(head))
                raise
            if ends and blocks:
                yield Piece(head + blocks, begin - len(head))
                blocks.clear()
            if not length:
                return
            if block:
                head = block if self._kind == _SECTION else head + block
                if len(head) > _MOST:
                    raise self._wrong(f"more than {_MOST} octets describe interfaces: read it in one process")
                continue
            if not blocks:
                begin = place
            blocks += self._held[self._at : self._at + length]
            self._at += length

    def _block(self, size: int) -> Packet | None:
        """Take the block that is held: its packet; None for one of another kind."""
        begin, stop = self._at + 8, self._at + size - 4
        packet = None
        try:
            if self._kind in _TIMED:
                packet = self._packet(begin, stop)
            elif self._kind == _SIMPLE_PACKET:
                packet = self._simple_packet(self._held[begin:stop])
            elif self._kind == _INTERFACE:
                self._interface(self._held[begin:stop])
            else:
                self._section(self._held[begin:stop])
        except struct.error:
            raise self._wrong("a block is shorter than its fields") from None
        self._at += size
        return packet

    def _without_options(self, rest: bytes, size: int) -> bytes | None:
        """The octets in a packet of ``size``, of which ``rest`` stands after the time; None if it has options, or is
        no whole packet."""
        if size < _EMPTY_PACKET:
            return None
        (kept,) = self._one(rest)
        if size != _EMPTY_PACKET + kept + (-kept & 3) or self._one(rest, size - 24) != (size,):
            return None
        return rest[8 : 8 + kept]

    def _wrong(self, text: str, back: int = 0) -> CaptureFileError:
        return CaptureFileError(f"{self.name}: {text} (at octet {self._before + self._at - back})")

    def _fill(self, size: int) -> int:
        """Hold ``size`` octets from the begin of the block; returns how many there are, fewer at the end of the file
        only."""
        have = len(self._held) - self._at
        if have >= size:
            return have
        held = bytearray(memoryview(self._held)[self._at :])
        while len(held) < size:
            more = self._read(_PIECE)
            if not more:
                break
            held += more
        self._before += self._at
        self._at = 0
        self._held = bytes(held)
        return len(held)

    def _pass(self, size: int) -> int:
        """Pass over ``size`` octets without keeping them; returns how many there were, fewer at the end of the file."""
        left = size
        while left > (have := len(self._held) - self._at):
            left -= have
            self._before += len(self._held)
            self._at = 0
            self._held = self._read(_PIECE) or b""
            if not self._held:
                return size - left
        self._at += left
        return size

    def _first(self) -> None:
        """The head of the first block, which shows what kind of file this is."""
        self._fill(12)
        head = self._held[:4]
        if head == _SECTION.to_bytes(4, "little"):
            return
        if head in _PCAP:
            raise self._wrong("this is a pcap file, not pcapng; convert it: editcap -F pcapng OLD NEW")
        if head[:2] == b"\x1f\x8b":
            raise self._wrong("this file is compressed; unpack it with gunzip")
        raise self._wrong("this is no pcapng file" if head else "the file is empty")

    def _next(self) -> int:
        """The size of the next block whose type is known: all of it is held, its type is in ``_kind``. 0 without one
        any more."""
        size: int
        while True:
            have = len(self._held) - self._at
            if have < 12:
                have = self._fill(12)
                if have < 12:
                    return self._end(have)
            kind, size = self._two(self._held, self._at)
            if kind == _SECTION:
                size = self._turned()
            if size < 12 or size & 3:
                raise self._wrong(
                    f"a block of type {kind} claims {size} octets: lengths are multiples of 4, at least 12"
                )
            if kind not in _KNOWN:
                if not self._passed(kind, size):
                    return 0
                continue
            if size > _MOST:
                raise self._wrong(f"a block of type {kind} claims {size} octets, more than {_MOST}")
            if have < size:
                have = self._fill(size)
                if have < size:
                    return self._end(have)
            (again,) = self._one(self._held, self._at + size - 4)
            if again != size:
                raise self._wrong(f"a block of type {kind} has two lengths, {size} and {again}")
            self._kind = kind
            return size

    def _turned(self) -> int:
        """Take the byte order of the section that begins; returns the size of its block."""
        magic = self._held[self._at + 8 : self._at + 12]
        self._turn("<" if magic == _MAGIC.to_bytes(4, "little") else ">")
        if self._one(magic) != (_MAGIC,):
            raise self._wrong("a section without the magic number of pcapng")
        return int(self._one(self._held, self._at + 4)[0])

    def _passed(self, kind: int, size: int) -> bool:
        """Pass over a block of an unknown type, of any size; False if the file ends within it."""
        passed = self._pass(size - 4)
        if passed == size - 4:
            passed += min(self._fill(4), 4)
        if passed < size:
            self._end(passed)
            return False
        (again,) = self._one(self._held, self._at)
        if again != size:
            raise self._wrong(f"a block of type {kind} has two lengths, {size} and {again}", size - 4)
        self._at += 4
        return True

    def _end(self, left: int) -> int:
        """The file ends within a block, after ``left`` octets of it, or before one."""
        self.cut = f"{left} octets of a last block are not read" if left else ""
        return 0

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
                bits_per_s=self._number(found.get(_IF_SPEED, b"")[:8]),
                description=found.get(_IF_DESCRIPTION, b"").decode(errors="replace"),
                unit=unit[0] if unit else _MICRO,
                offset_s=self._number(found.get(_IF_TSOFFSET, b"")[:8], signed=True),
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

    def _packet(self, begin: int, stop: int) -> Packet:
        """A packet with a time, with the options after its octets up to ``stop``."""
        if stop - begin < 20:
            raise struct.error
        number, high, low, kept, _ = self._five(self._held, begin)
        if self._kind == _OLD_PACKET:  # 16 bits, and a count of drops
            (number,) = struct.unpack_from(self._order + "H", self._held, begin)
        interface = self._of(number)
        ticks = high << 32 | low
        begin += 20
        end = begin + kept
        if end > stop:
            raise self._wrong(f"a packet claims {kept} octets, its block has {stop - begin}")
        flags = 0
        comments: list[str] = []
        options = end + (-kept & 3)
        if options < stop:
            for code, value in self._options(self._held[options:stop]):
                if code == _COMMENT:
                    comments.append(value.decode(errors="replace"))
                elif code == _FLAGS:
                    flags = self._number(value[:4])
        t_ns = ticks if interface.unit == _NANO and not interface.offset_s else interface.to_ns(ticks)
        return _NEW(Packet, (interface, t_ns, self._held[begin:end], flags, tuple(comments)))

    def _simple_packet(self, body: bytes) -> Packet:
        (size,) = struct.unpack_from(self._order + "I", body)
        interface = self._of(0)
        kept = min(size, interface.snap or size)
        if kept > len(body) - 4:
            raise self._wrong(f"a packet claims {kept} octets, its block has {len(body) - 4}")
        return Packet(interface, None, body[4 : 4 + kept])
