"""pcapng files: octet by octet as the specification has them, and files that nobody should have written."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from itertools import accumulate
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.capture.pcapng import PROFIBUS_DL, USER0, Interface, Packet, Reader, Writer
from dpstack.capture.transmission import Damage, Transmission
from dpstack.errors import CaptureFileError

T = 1_790_000_000_123_456_789
#: written by hand from the specification: section, interface (name pb, 500 kbit/s, ns), one packet E5, in little-endian
HAND = bytes.fromhex(
    "0A0D0D0A 20000000 4D3C2B1A 0100 0000 FFFFFFFFFFFFFFFF 00000000 20000000"
    "01000000 34000000 9300 0000 00000000"
    "0200 0200 70620000 0800 0800 20A1070000000000 0900 0100 09000000 00000000 34000000"
    "06000000 24000000 00000000 01000000 02000000 01000000 01000000 E5000000 24000000"
)


def _read(octets: bytes) -> list[Packet]:
    return list(Reader(io.BytesIO(octets), "a.pcapng"))


def _turned(kind: int, body: bytes) -> bytes:
    """A block in big-endian order."""
    size = struct.pack(">I", len(body) + 12)
    return struct.pack(">I", kind) + size + body + size


def test_a_file_made_by_hand_is_read() -> None:
    packet = Packet(Interface("pb", USER0, 500_000, unit=9), (1 << 32) + 2, b"\xe5")
    assert _read(HAND) == [packet]


def test_blocks_are_written_as_the_specification_says() -> None:
    file = io.BytesIO()
    writer = Writer(file, "")
    writer.interface("pb", 500_000, "")
    writer.packet(0, (1 << 32) + 2, b"\xe5")
    section = bytes.fromhex("0A0D0D0A 24000000 4D3C2B1A 0100 0000 FFFFFFFFFFFFFFFF 0400 0000 00000000 24000000")
    interface = bytes.fromhex(
        "01000000 38000000 9300 0000 00000000 0200 0200 70620000 0300 0000"
        "0800 0800 20A1070000000000 0900 0100 09000000 00000000 38000000"
    )
    assert file.getvalue() == section + interface + HAND[-36:]


@given(
    st.lists(
        st.tuples(
            st.integers(0, 2),
            st.integers(0, (1 << 64) - 1),
            st.binary(max_size=260),
            st.sampled_from([0, Damage.FCS, Damage.TOO_SHORT | Damage.PARITY_OR_FRAMING]),
            st.text(max_size=20),
        )
    )
)
def test_telegrams_that_were_written_are_read_again(rows: list[tuple[int, int, bytes, int, str]]) -> None:
    file = io.BytesIO()
    writer = Writer(file, "dpstack")
    ports = [
        Interface(f"port {n}", linktype, 9_600 * n, "parity even", unit=9)
        for n, linktype in enumerate((USER0, PROFIBUS_DL, USER0))
    ]
    for port in ports:
        writer.interface(port.name, port.bits_per_s, port.description, linktype=port.linktype)
    for row in rows:
        writer.packet(*row)
    writer.statistics(0, T, T + 1, len(rows), 3)
    expected = [Packet(ports[n], t, data, flags, (text,) if text else ()) for n, t, data, flags, text in rows]
    assert _read(file.getvalue()) == expected


def test_another_byte_order_unit_and_offset() -> None:
    section = _turned(0x0A0D0D0A, struct.pack(">IHHq", 0x1A2B3C4D, 1, 2, -1))
    offset = struct.pack(">HHq", 14, 8, -1)
    binary = _turned(1, struct.pack(">HHI", 257, 0, 0) + struct.pack(">HHB3x", 9, 1, 0x80 | 10) + offset)
    packet = _turned(6, struct.pack(">IIIII", 0, 0, 3 * 1024 + 512, 3, 3) + b"\x10\x02\x03\0")
    (found,) = _read(section + binary + packet)
    assert (found.t_ns, found.octets, found.interface.linktype) == (2_500_000_000, b"\x10\x02\x03", 257)


def test_blocks_of_other_programs() -> None:
    unknown = struct.pack("<II", 0x0BAD, 16) + b"\1\2\3\4" + struct.pack("<I", 16)
    empty = struct.pack("<III", 0x0BAE, 12, 12)
    simple = struct.pack("<III", 3, 20, 2) + b"\xe5\xe5\0\0" + struct.pack("<I", 20)
    old = struct.pack("<IIHHIIII", 2, 36, 0, 7, 0, 5, 1, 1) + b"\xe5\0\0\0" + struct.pack("<I", 36)
    found = _read(HAND + unknown + empty + simple + old)
    assert [(p.t_ns, p.octets) for p in found] == [((1 << 32) + 2, b"\xe5"), (None, b"\xe5\xe5"), (5, b"\xe5")]


def test_a_second_section_has_its_own_interfaces() -> None:
    assert len(_read(HAND + HAND)) == 2
    with pytest.raises(CaptureFileError, match="a packet of interface 0, of 0"):
        _read(HAND + HAND[:32] + HAND[-36:])


def test_a_file_that_was_cut_is_read_to_its_last_whole_block() -> None:
    whole = HAND + HAND[-36:]
    for end in range(len(HAND), len(whole) + 1):
        reader = Reader(io.BytesIO(whole[:end]), "a")
        left = 0 if end == len(whole) else end - len(HAND)
        assert len(list(reader)) == 1 + (end == len(whole))
        assert reader.cut == (f"{left} octets of a last block are not read" if left else "")


class _Dribble:
    """A pipe that delivers three octets at a time."""

    def __init__(self, octets: bytes) -> None:
        self._rest: Iterator[bytes] = iter([octets[at : at + 3] for at in range(0, len(octets), 3)])
        self._piece = b""

    def read(self, size: int, /) -> bytes:
        self._piece = self._piece or next(self._rest, b"")
        piece, self._piece = self._piece[:size], self._piece[size:]
        return piece


def test_a_pipe_delivers_in_pieces() -> None:
    assert len(list(Reader(_Dribble(HAND), "-"))) == 1


@pytest.mark.parametrize(
    ("octets", "text"),
    [
        (b"", "the file is empty"),
        (b"[bus]\nport = 1\n", "this is no pcapng file"),
        (bytes.fromhex("D4C3B2A1") + bytes(20), "this is a pcap file, not pcapng; convert it: editcap"),
        (bytes.fromhex("A1B23C4D") + bytes(20), "this is a pcap file"),
        (b"\x1f\x8b" + bytes(20), "unpack it with gunzip"),
        (HAND[:8] + bytes(24), "without the magic number"),
        (HAND[:12] + b"\2" + HAND[13:], "version 2"),
        (HAND[:4] + struct.pack("<I", 33) + HAND[8:], "claims 33 octets: lengths are multiples of 4"),
        (HAND[:32] + struct.pack("<III", 6, 8, 8), "at least 12"),
        (HAND[:32] + struct.pack("<II", 6, 1 << 30) + bytes(12), "claims 1073741824 octets, more than"),
        (HAND[:-4] + struct.pack("<I", 40), "two lengths, 36 and 40"),
        (HAND[:-16] + struct.pack("<II", 9, 9) + HAND[-8:], "a packet claims 9 octets, its block has 4"),
        (HAND[:32] + struct.pack("<IIII", 1, 16, 0, 16), "a block is shorter than its fields"),
        (HAND[:48] + struct.pack("<HH", 2, 900) + HAND[52:], "an option of type 2 claims 900 octets"),
    ],
)
def test_a_wrong_file_is_refused_with_the_place(octets: bytes, text: str) -> None:
    with pytest.raises(CaptureFileError, match=rf"^a.pcapng: .*{text}.* \(at octet \d+\)$"):
        _read(octets)


def _files() -> list[bytes]:
    """Real files: ours with all that it can hold, and one in the other order with old, simple and unknown blocks."""
    file = io.BytesIO()
    writer = Writer(file, "a test")
    ports = [writer.interface(f"port {n}", 9_600, "even parity") for n in range(2)]
    for n in range(6):
        writer.packet(ports[n & 1], T + n, bytes(range(n)), Damage.FCS if n & 2 else 0, "a comment" if n & 1 else "")
        if n == 2:
            writer.statistics(0, T, T + 1, 3, 1)
    section = _turned(0x0A0D0D0A, struct.pack(">IHHq", 0x1A2B3C4D, 1, 0, -1))
    port = _turned(1, struct.pack(">HHI", 147, 0, 0) + struct.pack(">HHQ", 8, 8, 500_000) + bytes(4))
    old = _turned(2, struct.pack(">HHIIII", 0, 0, 7, 5, 3, 3) + b"\xdc\2\2\0")
    others = [_turned(0x0BAD, b"abcd"), _turned(3, struct.pack(">I", 1) + b"\xe5\0\0\0"), _turned(5, bytes(12))]
    return [file.getvalue(), section + port + old + others[0] + others[1] + others[2] + old, HAND * 3]


FILES = _files()


def _block_ends(octets: bytes) -> list[int]:
    order, ends = "<", [0]
    while ends[-1] < len(octets):
        at = ends[-1]
        if octets[at : at + 4] == b"\n\r\r\n":
            order = "<" if octets[at + 8] == 0x4D else ">"
        ends.append(at + int(struct.unpack_from(order + "I", octets, at + 4)[0]))
    return ends


class _Counted:
    """A file that delivers ``size`` octets a call at most, and notes how often and how far it was read."""

    def __init__(self, octets: bytes, size: int = 1 << 30) -> None:
        self._file = io.BytesIO(octets)
        self._size = size
        self.calls = self.octets = 0

    def read(self, size: int, /) -> bytes:
        piece = self._file.read(min(size, self._size))
        self.calls += 1
        self.octets += len(piece)
        return piece


def _outcome(file: _Counted) -> tuple[list[Packet], str]:
    """The packets, and the error or how the file ends."""
    found: list[Packet] = []
    reader = Reader(file, "a")
    try:
        for packet in reader:
            found.append(packet)
            assert len(reader._held) <= (1 << 20) + (1 << 16)
    except CaptureFileError as error:
        return found, str(error)
    return found, reader.cut


def _batched(file: _Counted) -> tuple[list[Transmission], str]:
    """The same in batches, each of one interface."""
    found: list[Transmission] = []
    reader = Reader(file, "a")
    try:
        for interface, batch in reader.batches():
            assert {one.baud for one in batch} == {interface.bits_per_s}
            found += batch
    except CaptureFileError as error:
        return found, str(error)
    return found, reader.cut


def _in_pieces(octets: bytes, size: int) -> tuple[list[Transmission], str]:
    """The same, each piece read by itself."""
    found: list[Transmission] = []
    reader = Reader(io.BytesIO(octets), "a")
    try:
        for piece in reader.pieces(size):
            for _, batch in Reader(io.BytesIO(piece.octets), "a", piece.before).batches():
                found += batch
    except CaptureFileError as error:
        return found, str(error)
    return found, reader.cut


def _transmission(packet: Packet) -> Transmission:
    octets, baud = packet.octets, packet.interface.bits_per_s
    return Transmission(octets, packet.t_ns, baud, "; ".join(packet.comments), packet.damage)


_lengths = st.sampled_from([0, 4, 8, 12, 13, 16, 0x7FFFFFFC, 0xFFFFFFFC, 0xFFFFFFFF])


@st.composite
def _damaged(draw: st.DrawFn) -> tuple[bytes, bytes, int]:
    """A real file, the same with damage, and where the damage begins."""
    whole = draw(st.sampled_from(FILES))
    octets = bytearray(whole)
    at = draw(st.integers(0, len(octets) - 1))
    match draw(st.integers(0, 4)):
        case 0:
            octets[at] ^= draw(st.integers(1, 255))
        case 1:
            del octets[at : at + draw(st.integers(1, 40))]
        case 2:
            octets[at:at] = draw(st.binary(min_size=1, max_size=40))
        case 3:
            del octets[at:]
        case _:
            at -= at % 4
            octets[at : at + 4] = draw(_lengths).to_bytes(4, draw(st.sampled_from(["little", "big"])))
    return whole, bytes(octets), at


@given(_damaged(), st.integers(1, 90))
def test_everything_before_the_damage_is_delivered_and_pieces_make_no_difference(
    case: tuple[bytes, bytes, int], size: int
) -> None:
    whole, octets, at = case
    file = _Counted(octets)
    found, end = _outcome(file)
    assert end.isprintable()
    before = max(one for one in _block_ends(whole) if one <= at)
    safe = _read(whole[:before]) if before else []
    assert found[: len(safe)] == safe
    assert file.calls <= 3
    assert file.octets <= len(octets)
    assert _outcome(_Counted(octets, size)) == (found, end)
    batched = [_transmission(packet) for packet in found], end
    assert _batched(_Counted(octets)) == _batched(_Counted(octets, size)) == batched
    assert _in_pieces(octets, size) == batched


@given(st.binary(max_size=60).map(lambda tail: HAND[:32] + tail) | st.binary(max_size=60))
def test_any_octets_end_with_a_line_or_an_end(octets: bytes) -> None:
    found, end = _outcome(_Counted(octets))
    assert found == []
    assert _batched(_Counted(octets)) == _in_pieces(octets, 1) == ([], end)


class _Endless:
    """A file that begins with ``head`` and never ends. ``calls``: how often it was read."""

    def __init__(self, head: bytes) -> None:
        self._head = head
        self.calls = 0

    def read(self, size: int, /) -> bytes:
        self.calls += 1
        piece, self._head = self._head[:size], self._head[size:]
        return piece or bytes(size)


def test_a_length_that_lies_is_no_reason_to_keep_octets() -> None:
    """Of a known type: refused at once. Of another one: passed over in pieces, the last of which shows the lie."""
    known = _Endless(HAND + struct.pack("<II", 6, 0xFFFFFFFC))
    reader = Reader(known, "a")
    with pytest.raises(CaptureFileError, match="claims 4294967292 octets, more than"):
        assert not list(reader)[1:]
    assert known.calls <= 2
    other = _Endless(HAND + struct.pack("<II", 77, 0x3FFFFFFC))
    reader = Reader(other, "a")
    packets = iter(reader)
    assert next(packets).octets == b"\xe5"
    with pytest.raises(CaptureFileError, match=rf"two lengths, 1073741820 and 0 \(at octet {len(HAND)}\)"):
        next(packets)
    assert other.calls <= (1 << 30 >> 16) + 3
    assert len(reader._held) <= 1 << 16


def test_options_without_end_end_with_their_block() -> None:
    body = struct.pack("<IIIII", 0, 0, 5, 1, 1) + b"\xe5\0\0\0"
    comments = struct.pack("<HH", 1, 0) * 100_000
    size = struct.pack("<I", len(body) + len(comments) + 12)
    (packet,) = _read(HAND[:-36] + struct.pack("<I", 6) + size + body + comments + size)
    assert len(packet.comments) == 100_000
    with pytest.raises(CaptureFileError, match="more than 4096 interfaces"):
        _read(HAND[:32] + HAND[32:84] * 4_097)
    speed = struct.pack("<HH", 8, 0xFFFC) + b"\xff" * 0xFFFC  # of 65532 octets, in place of 8
    size = struct.pack("<I", 20 + len(speed))
    packets = _read(HAND[:32] + struct.pack("<I", 1) + size + HAND[40:48] + speed + size + HAND[-36:])
    assert packets[0].interface.bits_per_s < 1 << 64


def test_each_write_has_whole_blocks_as_a_buffered_file_passes_them_on() -> None:
    """A program that is killed leaves a file that ends with a whole block: no write to the system splits one."""
    written: list[bytes] = []

    class Raw(io.RawIOBase):
        def writable(self) -> bool:
            return True

        def write(self, octets: Any, /) -> int:
            written.append(bytes(octets))
            return len(octets)

    with io.BufferedWriter(Raw(), 1_000) as file:
        writer = Writer(file, "a test")
        port = writer.interface("p", 9_600, "")
        for n in range(500):
            writer.packet(port, T + n, bytes(n % 256), 0, "x" * (n % 7))
    ends = set(_block_ends(b"".join(written)))
    assert len(written) > 20
    assert set(accumulate(map(len, written))) <= ends
