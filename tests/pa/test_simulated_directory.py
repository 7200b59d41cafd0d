"""Directories of simulated PA devices in every convention, held to the reader and to makers' octets; and their lies."""

from __future__ import annotations

import itertools

import pytest

from dpstack.errors import PduError, RecordRefused, UsageError
from dpstack.pa.blocks import BlockObject
from dpstack.pa.directory import KINDS, Header, Place, next_record, readings
from dpstack.pa.simulated.device import OTHER_LIES, ProcessDevice
from dpstack.pa.simulated.directory_records import LIES, SHIFT, Layout
from dpstack.pa.simulated.kinds import Row, process_device

LAYOUTS = [
    Layout(profile=profile, numbering=numbering, directory_slot=slot, is_shifted=shifted, records=records)
    for profile, numbering, slot, shifted, records in itertools.product(
        (2, 3), ("on", "anew"), (0, 1), (False, True), ("one", "several")
    )
]


def directory(device: ProcessDevice) -> tuple[Header, dict[int, bytes]]:
    slot = device.layout.directory_slot
    header = Header.parse(device.read(slot, 0))
    records: dict[int, bytes] = {}
    while (index := next_record(header, records)) is not None:
        records[index] = device.read(slot, index)
    return header, records


def walked(device: ProcessDevice) -> list[Place]:
    """The places of the first convention whose block objects are of the right kind."""
    for places in readings(*directory(device)):
        try:
            found = [BlockObject.parse(device.read(place.slot, place.index + shift(device))) for place in places]
        except RecordRefused:
            continue
        if [one.object for one in found] == [place.kind for place in places]:
            return list(places)
    raise PduError("no convention fits")


def shift(device: ProcessDevice) -> int:
    return SHIFT if device.layout.is_shifted else 0


@pytest.mark.parametrize("layout", LAYOUTS, ids=repr)
def test_every_convention_leads_to_the_blocks(layout: Layout) -> None:
    for kind in ("pressure", "flow", "positioner"):
        if layout.profile == 2 and layout.is_shifted and kind != "pressure":
            with pytest.raises(UsageError, match="no room"):
                process_device(kind, layout=layout)
            continue
        device = process_device(kind, layout=layout)
        places = walked(device)
        ordered = sorted(device.blocks, key=lambda block: KINDS.index(block.kind))
        assert [(one.slot, one.index + shift(device), one.parameters) for one in places] == [
            (block.slot, block.index, block.count) for block in ordered
        ]


def test_the_places_of_the_profile() -> None:
    """Profile 3: physical block in slot 0, function blocks from index 16 (Micro Motion 2700, table F-3); profile 2: all
    in slot 1, the physical block at index 14."""
    third = process_device("flow")
    assert [(one.slot, one.index) for one in third.blocks] == [(0, 16), (1, 16), (2, 16), (3, 16), (1, 70)]
    second = process_device("flow", layout=Layout(profile=2))
    assert {one.slot for one in second.blocks} == {1}
    assert second.physical.index == 14
    assert BlockObject.parse(second.read(1, 14)).revision == "2.00"


def test_the_octets_of_one_record_are_those_of_the_walkers_of_others() -> None:
    """A directory that three programs of others read (docs/development/foreign.md)."""
    device = process_device("temperature", layout=Layout(records="one"))
    assert device.read(1, 0) == bytes.fromhex("0000 0001 0001 0006 0001 0003")
    assert device.read(1, 1) == bytes.fromhex("0104 0001 0105 0001 0106 0001 0010 0021 0146 0038 0110 0028")


def test_records_like_those_of_an_oxymat() -> None:
    """OXYMAT 6, easymanua.ls, page 56: physical block in record 1, the others each in one more, numbers run on."""
    device = process_device("flow")
    assert device.read(1, 1)[:12].hex(" ", 4) == "01040001 02050001 03060003"
    assert device.read(1, 0)[4:6] == b"\0\3"


def test_255_blocks() -> None:
    device = process_device("255 blocks")
    header, records = directory(device)
    assert (header.entries, len(device.blocks)) == (258, 255)
    assert max(map(len, records.values())) <= 240
    assert len(walked(device)) == 255


@pytest.mark.parametrize("lie", LIES)
def test_directories_that_lie_end_in_an_error(lie: str) -> None:
    with pytest.raises((PduError, RecordRefused)):
        walked(process_device("pressure", lie=lie))


@pytest.mark.parametrize("lie", OTHER_LIES)
def test_other_lies_have_an_honest_directory(lie: str) -> None:
    device = process_device("pressure", lie=lie)
    octets = {
        (block.name, at): read(device, block.slot, block.index + at) for block in device.blocks for at in range(60)
    }
    again = {
        (block.name, at): read(device, block.slot, block.index + at) for block in device.blocks for at in range(60)
    }
    assert (octets != again) is (lie == "changing")
    assert any(b"\x1b" in one for one in octets.values()) is (lie == "control characters")
    assert any(len(one) == 240 for one in octets.values()) is (lie == "long views")
    unit = octets["AI1", 12][8:10] if len(octets["AI1", 12]) > 9 else b""
    assert (unit == b"\x81\x23") is (lie == "maker's unit")


def read(device: ProcessDevice, slot: int, index: int) -> bytes:
    try:
        return device.read(slot, index)
    except RecordRefused:
        return b""


def test_a_lie_that_nobody_knows() -> None:
    with pytest.raises(UsageError, match="no lie 'big'; known: outside, circles"):
        process_device("pressure", lie="big")
    with pytest.raises(UsageError, match="profile = 4: it is 2 or 3"):
        Layout(profile=4)


def test_a_block_at_the_place_of_its_file() -> None:
    device = process_device("pressure", [Row("AI", "pressure", 1, 0, 60), Row("AI", "temperature")])
    assert [(one.name, one.slot, one.index) for one in device.blocks] == [
        ("PB", 0, 16), ("AI1", 1, 60), ("AI2", 2, 16), ("TB1", 1, 101),
    ]  # fmt: skip
    assert len(walked(device)) == 4
