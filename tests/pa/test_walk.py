"""The walk through a device: the makers' directories and block objects, the conventions of the field, and lies."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pa_kit import block_object, reader, transmitter, words
from property_kit import examples

from dpstack.errors import PduError, SlaveTimeout
from dpstack.pa.directory import MOST_BLOCKS
from dpstack.pa.walk import Layout, walk
from tests.pa.makers_octets import BLOCK_OBJECTS, DIRECTORIES, BlockObject, Directory

Records = dict[tuple[int, int], bytes]
PB, FB, TB = (block_object(kind, 1, 1, 20) for kind in (1, 2, 3))


def walked(records: Records, asked: list[tuple[int, int]] | None = None) -> Layout:
    read: Any = reader(records, asked)
    return asyncio.run(walk(read))


def places(layout: Layout) -> list[tuple[str, int, int]]:
    return [(one.name, one.slot, one.index) for one in layout.blocks]


@pytest.mark.parametrize("directory", DIRECTORIES, ids=lambda one: one.source.device)
def test_the_directories_that_makers_print(directory: Directory) -> None:
    octets = {"PB": PB, "TB": TB, "FB": FB}
    records = {one.at: octets[one.kind] for one in directory.blocks}
    for index, text in directory.records.items():
        # a number of parameters that the page does not print
        records[directory.slot, index] = bytes.fromhex(text.replace("0000", "0030") if index else text)
    found = walked(records)
    assert found.remarks == ()
    assert found.directory == directory.slot
    assert {(one.slot, one.index) for one in found.blocks} == {one.at for one in directory.blocks}
    assert [one.name for one in found.blocks if one.short == "TB"] == ["tb1", "tb2", "tb3", "tb4"]


@pytest.mark.parametrize("printed", BLOCK_OBJECTS, ids=lambda one: f"{one.source.device} {one.name}")
def test_the_block_objects_that_makers_print(printed: BlockObject) -> None:
    octets = bytes.fromhex(printed.octets)
    places = {1: (0, 16), 2: (1, 16), 3: (1, 80)}
    records: Records = {(0, 16): PB, (1, 16): FB, (1, 80): TB, places[printed.block]: octets}
    records[1, 0] = words(0, 1, 1, 6, 1, 3)
    records[1, 1] = words(0x0104, 1, 0x0105, 1, 0x0106, 1, 0x0010, 29, 0x0150, 60, 0x0110, 46)
    block = next(one for one in walked(records).blocks if one.octets == octets)
    found = block.object
    assert (found.object, found.parent_class, found.block_class) == (printed.block, printed.parent, printed.class_)
    assert (found.profile, found.profile_revision) == (
        printed.profile,
        printed.profile_revision[0] << 8 | printed.profile_revision[1],
    )
    assert (found.parameters, block.view_1, found.views) == (printed.parameters, printed.view, printed.views)
    assert block.name.rstrip("1") == printed.name.rstrip("0123456789").lower()
    assert "maker's class 250" not in block.kind.words  # 250: not used


def test_profile_3_in_slots_0_and_1() -> None:
    found = walked(transmitter())
    assert places(found) == [("pb1", 0, 16), ("ai1", 1, 16), ("tb1", 1, 80)]
    assert (found.directory, found.profile, found.remarks) == (1, "3.02", ())
    assert found.blocks[1].view_1 == (1, 0xE0)


def test_profile_2_with_all_in_slot_1() -> None:
    records: Records = {(1, 14): PB, (1, 60): TB, (1, 110): FB, (1, 160): FB}
    records[1, 0] = words(0, 1, 1, 7, 1, 3)
    records[1, 1] = words(0x0104, 1, 0x0105, 1, 0x0106, 2, 0x010E, 29, 0x013C, 40, 0x016E, 40, 0x01A0, 40)
    assert places(walked(records)) == [("pb1", 1, 14), ("ai1", 1, 110), ("ai2", 1, 160), ("tb1", 1, 60)]


def test_a_directory_in_slot_0() -> None:
    records = transmitter()
    for index in (0, 1):
        records[0, index] = records.pop((1, index))
    found = walked(records)
    assert (found.directory, len(found.blocks)) == (0, 3)


def test_numbers_that_start_anew_in_each_record() -> None:
    records: Records = {(0, 16): PB, (1, 80): TB, (1, 16): FB, (2, 16): FB}
    records[1, 0] = words(0, 1, 2, 7, 1, 3)
    records[1, 1] = words(0x0201, 1, 0x0202, 1, 0x0203, 2)
    records[1, 2] = words(0x0010, 29, 0x0150, 60, 0x0110, 46, 0x0210, 46)
    assert places(walked(records)) == [("pb1", 0, 16), ("ai1", 1, 16), ("ai2", 2, 16), ("tb1", 1, 80)]


def test_both_conventions_fit_and_the_block_objects_decide() -> None:
    # entry 4 of record 2 is the first of it, or its fourth: only there blocks of the right kind stand
    entries = [0x0110, 9, 0x0111, 9, 0x0112, 9, 0x0113, 9, 0x0114, 9, 0x0115, 9]
    records: Records = {(1, 19): PB, (1, 20): TB, (1, 21): FB}
    records[1, 0] = words(0, 1, 2, 9, 1, 3)
    records[1, 1] = words(0x0204, 1, 0x0205, 1, 0x0206, 1)
    records[1, 2] = words(*entries)
    assert places(walked(records)) == [("pb1", 1, 19), ("ai1", 1, 21), ("tb1", 1, 20)]


def test_the_device_whose_blocks_are_100_higher() -> None:
    records = {(slot, index + 100 if index > 13 else index): octets for (slot, index), octets in transmitter().items()
               if index + 100 < 256}  # fmt: skip
    assert places(walked(records)) == [("pb1", 0, 116), ("ai1", 1, 116), ("tb1", 1, 180)]


def test_a_header_that_counts_more_records_than_there_are() -> None:
    records = transmitter()
    records[1, 0] = words(0, 1, 3, 30, 1, 3)
    found = walked(records)
    assert len(found.blocks) == 3
    assert found.remarks == ("the directory has fewer entries than it claims: it ends before index 2",)


@pytest.mark.parametrize(("slot", "index"), [(0, 16), (1, 14), (1, 16), (0, 14)])
def test_without_a_directory(slot: int, index: int) -> None:
    records: Records = {(slot, index): block_object(1, 1, 1, 30), (slot, index + 30): FB, (slot, index + 50): TB}
    records[2, 16] = FB
    found = walked(records)
    assert found.directory is None
    assert places(found) == [
        ("pb1", slot, index),
        ("ai1", slot, index + 30),
        ("ai2", 2, 16),
        ("tb1", slot, index + 50),
    ]
    assert found.remarks[0].startswith("no usable directory (slot 1 index 0: the device refuses it (80 B0 00); slot 0")


def test_a_directory_that_points_outside_and_blocks_that_are_there() -> None:
    records = transmitter()
    records[1, 1] = words(0x0104, 1, 0x0105, 1, 0x0109, 9, 0x0010, 29, 0x0150, 60, 0x0110, 46)
    found = walked(records)
    assert "slot 1: the directory points outside itself" in found.remarks[0]
    assert places(found)[:2] == [("pb1", 0, 16), ("ai1", 1, 16)]


def test_a_directory_with_one_wrong_entry() -> None:
    records = transmitter()
    del records[1, 80]
    found = walked(records)
    assert places(found) == [("pb1", 0, 16), ("ai1", 1, 16)]
    assert found.remarks == ("the directory has a TB at slot 1 index 80: none is there",)


def test_a_directory_in_circles() -> None:
    records = transmitter()
    records[1, 0] = words(0, 1, 1, 8, 1, 3)
    records[1, 1] = words(0x0104, 1, 0x0105, 1, 0x0106, 3, 0x0010, 29, 0x0150, 60, 0x0110, 46, 0x0110, 46, 0x0100, 46)
    found = walked(records)
    assert places(found) == [("pb1", 0, 16), ("ai1", 1, 16), ("tb1", 1, 80)]
    assert found.remarks == (
        "the directory has the block at slot 1 index 16 twice",
        "the directory has a FB at slot 1 index 0: none is there",
    )


def test_255_blocks() -> None:
    """As many as a device may have; one that claims them and has none is given up after a few."""
    blocks = [(slot, 16 + number) for slot in range(1, 3) for number in range(127)][: MOST_BLOCKS - 2]
    entries = [0x0104, 1, 0x0105, 1, 0x0106, len(blocks), 0x0010, 9, 0x0011, 9]
    entries += [word for slot, index in blocks for word in (slot << 8 | index, 9)]
    octets = words(*entries)
    records: Records = {(0, 16): PB, (0, 17): TB, **dict.fromkeys(blocks, FB)}
    parts = [octets[at : at + 240] for at in range(0, len(octets), 240)]
    records |= {(1, index): part for index, part in enumerate(parts, 1)}
    records[1, 0] = words(0, 1, len(parts), len(octets) // 4, 1, 3)
    found = walked(records)
    assert len(found.blocks) == MOST_BLOCKS
    assert found.blocks[253].name == "ai253"
    for place in (*blocks, (0, 16), (0, 17)):
        del records[place]
    asked: list[tuple[int, int]] = []
    with pytest.raises(PduError, match="slot 1: its directory names places without a block"):
        walked(records, asked)
    assert len(asked) < 50


async def test_a_silent_device_ends_the_walk() -> None:
    async def read(slot: int, index: int) -> bytes:
        raise SlaveTimeout(9, "slave 9 is silent")

    with pytest.raises(SlaveTimeout):
        await walk(read)


_WORD = st.sampled_from([0, 1, 2, 3, 4, 5, 6, 0x0104, 0x0105, 0x0201, 0x0010, 0x0110, 0x0150, 0x0001, 30, 0xFFFF])
_RECORD = st.lists(_WORD, max_size=60).map(lambda numbers: words(*numbers)) | st.binary(max_size=240)
_BLOCK = st.builds(
    block_object, *(st.sampled_from(one) for one in ([0, 1, 2, 3], [1, 2, 250], [1, 250], [0, 1, 30, 65535]))
)


@examples(150)
@given(st.dictionaries(st.tuples(st.integers(0, 2), st.integers(0, 130)), _RECORD | _BLOCK, max_size=12), st.data())
def test_damaged_records_end_in_blocks_or_one_error(records: Records, data: st.DataObject) -> None:
    if data.draw(st.booleans()):
        records = {**transmitter(), **records}
    asked: list[tuple[int, int]] = []
    blocks = None
    with contextlib.suppress(PduError):
        blocks = walked(records, asked).blocks
    if blocks is not None:
        assert 1 <= len(blocks) <= MOST_BLOCKS
        assert len({one.name for one in blocks}) == len({(one.slot, one.index) for one in blocks}) == len(blocks)
    assert len(asked) < 700


def test_a_reader_that_fails_otherwise_is_not_taken_for_a_refusal() -> None:
    async def read(slot: int, index: int) -> bytes:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        asyncio.run(walk(read))
