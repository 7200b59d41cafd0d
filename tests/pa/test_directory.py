"""The directory of a PA device: the makers' octets, the conventions of the field, and directories that lie."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.errors import PduError
from dpstack.pa.blocks import FUNCTION, PHYSICAL, TRANSDUCER
from dpstack.pa.directory import Header, Place, next_record, readings

# OXYMAT 6, manual on easymanua.ls, page 56: numbers run on over the records
OXYMAT_HEADER = bytes.fromhex("0000 0001 0001 000D 0001 0003")
OXYMAT = {
    1: bytes.fromhex("0104 0001 0205 0004 0309 0005 016E 0030"),
    2: bytes.fromhex("0142 0030 0242 0030 0342 0030 0442 0030"),
    3: bytes.fromhex("0110 0030 0210 0030 0310 0030 0410 0030 0510 0030"),
}


def octets(*words: int) -> bytes:
    return struct.pack(f">{len(words)}H", *words)


def places(header: bytes, records: dict[int, bytes]) -> list[list[tuple[int, int, int, int]]]:
    found = readings(Header.parse(header), records)
    return [[(place.kind, place.number, place.slot, place.index) for place in reading] for reading in found]


def test_the_printed_directory_of_an_oxymat() -> None:
    (only,) = places(OXYMAT_HEADER, OXYMAT)
    assert only[0] == (PHYSICAL, 1, 1, 110)
    assert [place for place in only if place[0] == TRANSDUCER] == [(TRANSDUCER, n, n, 0x42) for n in range(1, 5)]
    assert [place for place in only if place[0] == FUNCTION] == [(FUNCTION, n, n, 16) for n in range(1, 6)]


def test_a_header_that_counts_too_few_records() -> None:
    header = Header.parse(OXYMAT_HEADER)
    assert header.records == 1
    read: dict[int, bytes] = {}
    while (index := next_record(header, read)) is not None:
        read[index] = OXYMAT[index]
    assert read == OXYMAT


def test_entries_that_follow_in_the_one_record() -> None:
    record = octets(0x0104, 1, 0x0105, 1, 0x0106, 2, 0x0010, 40, 0x0150, 40, 0x0110, 40, 0x0210, 40)
    (only,) = places(octets(0, 1, 1, 7, 1, 3), {1: record})
    assert only == [(PHYSICAL, 1, 0, 16), (TRANSDUCER, 1, 1, 80), (FUNCTION, 1, 1, 16), (FUNCTION, 2, 2, 16)]


def test_numbers_that_start_anew_in_each_record() -> None:
    records = {1: octets(0x0201, 1, 0x0202, 1, 0x0203, 1), 2: octets(0x0010, 40, 0x0150, 40, 0x0110, 40)}
    (only,) = places(octets(0, 1, 2, 6, 1, 3), records)
    assert [place[2:] for place in only] == [(0, 16), (1, 80), (1, 16)]


def test_numbers_that_count_the_list_in_each_record() -> None:
    records = {
        1: octets(0x0204, 1, 0x0304, 1, 0x0305, 1),
        2: octets(0x0010, 40),
        3: octets(0x0150, 40, 0x0110, 40),
    }
    found = places(octets(0, 1, 3, 6, 1, 3), records)
    assert [(0, 16), (1, 80), (1, 16)] in [[place[2:] for place in reading] for reading in found]


def test_both_conventions_are_offered_when_both_fit() -> None:
    # entry 4 of record 2: run on, or the fourth of that record
    records = {1: octets(0x0204, 1, 0x0205, 1, 0x0206, 1), 2: octets(*[n for at in range(7) for n in (0x0110 + at, 9)])}
    found = places(octets(0, 1, 2, 10, 1, 3), records)
    assert [[place[3] for place in reading] for reading in found] == [[16, 17, 18], [19, 20, 21]]


@pytest.mark.parametrize(
    ("header", "records", "message"),
    [
        (b"\0" * 11, {}, "11 octets, not 12"),
        (octets(0, 1, 0, 7, 1, 3), {}, "0 records"),
        (octets(0, 1, 14, 7, 1, 3), {}, "14 records"),
        (octets(0, 1, 1, 7, 1, 9), {}, "9 kinds of blocks"),
        (octets(0, 1, 1, 60000, 1, 3), {}, "60000 entries"),
        (octets(0, 1, 1, 7, 1, 3), {1: octets(0x0104, 1)}, "1 of 3 entries"),
        (octets(0, 1, 1, 7, 1, 3), {1: octets(0x0104, 200, 0x0105, 100, 0x0106, 1)}, "301 blocks"),
        (octets(0, 1, 1, 7, 1, 3), {1: octets(0x0104, 1, 0x0105, 1, 0x0106, 2)}, "points outside itself"),
        # in circles: the blocks are the list itself
        (octets(0, 1, 1, 6, 1, 3), {1: octets(0x0101, 1, 0x0102, 1, 0x0103, 1)}, "points outside itself"),
    ],
)
def test_directories_that_lie(header: bytes, records: dict[int, bytes], message: str) -> None:
    with pytest.raises(PduError, match=message):
        places(header, records)


@given(st.binary(min_size=12, max_size=12), st.lists(st.binary(max_size=240), max_size=6))
def test_damaged_directories_end_in_places_or_one_error(header: bytes, octets: list[bytes]) -> None:
    found: list[Sequence[Place]] = []
    with contextlib.suppress(PduError):
        found = list(readings(Header.parse(header), dict(enumerate(octets, 1))))
    assert len(found) <= 3
    assert all(len(reading) <= 255 for reading in found)
