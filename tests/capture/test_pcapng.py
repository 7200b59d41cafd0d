"""pcapng files: octet by octet as the specification has them, and files that nobody should have written."""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.capture.pcapng import PROFIBUS_DL, USER0, Interface, Packet, Reader, Writer
from dpstack.capture.transmission import Damage
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


def test_what_is_written_is_what_the_specification_says() -> None:
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
def test_what_is_written_is_read_again(rows: list[tuple[int, int, bytes, int, str]]) -> None:
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
def test_what_is_wrong_is_said_with_its_place(octets: bytes, text: str) -> None:
    with pytest.raises(CaptureFileError, match=rf"^a.pcapng: .*{text}.* \(at octet \d+\)$"):
        _read(octets)


@given(st.data())
def test_no_file_does_anything_else(data: st.DataObject) -> None:
    octets = bytearray(HAND * 2)
    for _ in range(data.draw(st.integers(1, 6))):
        octets[data.draw(st.integers(0, len(octets) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(CaptureFileError):
        assert len(_read(bytes(octets))) <= 2
