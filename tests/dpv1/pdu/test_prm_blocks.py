"""Structured parameters: the octets of every type, lengths that lie, what a slave makes of them."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from slave_kit import Bench

from dpstack.dp.pdu.prm_blocks import PrmBlock, parse_blocks
from dpstack.dp.pdu.prm_contents import (
    BlockType,
    Content,
    DxbLink,
    DxbSubscription,
    DxbTable,
    Isochronous,
    PrmCmd,
    TimeAr,
)
from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import ConfigError, PduError

SLAVE_TYPE = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True)


@pytest.mark.parametrize(
    ("content", "octets"),
    [
        (PrmCmd(0x12, 0x34, 0x0102), "08 02 05 00 12 34 01 02"),
        (
            DxbTable(1, (DxbLink(4, 8, 2, 6), DxbLink(5, 1, 0, 1))),
            "0D 03 05 00 01 04 08 02 06 05 01 00 01",
        ),
        (  # VPC3+S manual p76: 28 octets; T_BASE_DP 1500 / 12 us, T_DP 8, T_MAPC 2, T_PLL_W 12
            Isochronous(1, 1500, 8, 2, 375, 3, 4, 0x10203, 12, 0),
            "1C 04 05 00 01 00 00 05 DC 00 08 02 00 00 01 77 00 03 00 04 00 01 02 03 00 0C 00 00",
        ),
        (DxbTable(1, (DxbSubscription(4, 8, 2, 3, 1, 6),)), "0B 07 05 00 01 04 08 02 03 01 06"),
        (TimeAr(10, 1, 0x80000000), "0E 08 05 00 00 0A 00 00 00 01 80 00 00 00"),
    ],
)
def test_the_octets_of_every_type(content: Content, octets: str) -> None:
    block = PrmBlock.of(content, 5)
    assert block.octets == bytes.fromhex(octets)
    assert parse_blocks(bytes.fromhex(octets)) == (block,)
    assert block.content == content


def test_types_that_are_octets_only() -> None:
    # ABB FPBA-01 manual p79: length 1B, type 81, slot 0, reserved 0, then 23 octets
    user, maker = parse_blocks(bytes.fromhex("1B 81 00 00") + bytes(range(23)) + bytes.fromhex("06 20 03 08 AA BB"))
    assert user == PrmBlock(BlockType.USER_PRM, 0, bytes(range(23)))
    assert maker == PrmBlock(0x20, 3, b"\xaa\xbb", specifier=8)
    assert user.content is maker.content is None
    assert (user.title, maker.title) == ("type 129 (user_prm)", "type 32")
    assert parse_blocks(b"") == ()
    assert PrmBlock.of(DxbTable(1, ()), kind=BlockType.DXB_LINKS).octets == bytes.fromhex("05 03 00 00 01")


@pytest.mark.parametrize(
    ("octets", "text"),
    [
        ("04 81 00", "octet 11: parameter block 1 has a head of 4 octets, there are 3"),
        ("05 81 00 00", "octet 11: parameter block 1 says it has 5 octets: a block has 4 at least, and 4 are left"),
        ("03 81 00 00", "octet 11: parameter block 1 says it has 3 octets: a block has 4 at least, and 4 are left"),
        ("00 81 00 00", "octet 11: parameter block 1 says it has 0 octets: a block has 4 at least, and 4 are left"),
        (
            "06 81 00 00 01 02 09 20 00 00",
            "octet 17: parameter block 2 says it has 9 octets: a block has 4 at least, and 4 are left",
        ),
        ("07 02 00 00 01 02 03", "parameter block 1: type 2 (prm_cmd) has 4 octets of data, there are 3"),
        ("04 04 00 00", "parameter block 1: type 4 (isochronous) has 24 octets of data, there are 0"),
        ("04 03 00 00", "type 3 (dxb_links) has a version and entries of 4 octets each, there are 0 octets"),
        ("0A 07 00 00 01 02 03 04 05 06", "type 7 (dxb_subscribers) has a version and entries of 6 octets each, there"),
        ("05 08 00 00 01", "parameter block 1: type 8 (time_ar) has 10 octets of data, there are 1"),
        ("04 81 FF 00", "parameter block 1: parameter block of type 129 for slot 255: type and specifier 0..255, slot"),
    ],
)
def test_errors_of_wrong_lengths_name_block_and_octet(octets: str, text: str) -> None:
    with pytest.raises(PduError, match=re.escape(text)):
        parse_blocks(bytes.fromhex(octets), 11)


def test_impossible_blocks() -> None:
    with pytest.raises(ConfigError, match="specifier"):
        PrmBlock(2, 0, b"", 256)
    with pytest.raises(PduError, match="output_hold_time = 65536 does not fit"):
        PrmBlock.of(PrmCmd(output_hold_time=0x10000))
    with pytest.raises(PduError, match="a table without entries: say kind="):
        PrmBlock.of(DxbTable(1, ()))


BLOCKS = st.builds(
    PrmBlock,
    st.sampled_from((0, 5, 6, 0x20, 0x80, 0x81, 0xFF)),
    st.integers(0, 254),
    st.binary(max_size=20),
    st.integers(0, 255),
)


@given(st.lists(BLOCKS, max_size=6))
def test_built_blocks_are_read(blocks: list[PrmBlock]) -> None:
    assert parse_blocks(b"".join(one.octets for one in blocks)) == tuple(blocks)


@given(st.binary(max_size=60))
def test_any_octets_are_blocks_or_an_error(octets: bytes) -> None:
    try:
        found = parse_blocks(octets)
    except PduError:
        return
    assert b"".join(one.octets for one in found) == octets


# --- the slave ----------------------------------------------------------------------------------------------------


def set_prm(slave: DpSlave, user_prm: str) -> tuple[SlaveApp, list[str]]:
    """The slave after a Set_Prm of literal octets; what it told."""
    bench = Bench(slave)
    bench.prm(bytes.fromhex("88 01 0A 0B 12 34 00" + user_prm))
    return bench.app, [event.text for event in bench.app.take_events()]


def rig(seen: list[object], reason: str | None = None, description: SlaveDescription = SLAVE_TYPE) -> DpSlave:
    def judge(blocks: tuple[PrmBlock, ...]) -> str | None:
        seen.append(blocks)
        return reason

    return DpSlave(description, lambda outputs, elapsed: outputs, on_blocks=judge)


def test_a_slave_gets_them_decoded() -> None:
    seen: list[object] = []
    app, _ = set_prm(rig(seen), "80 00 08 05 81 00 00 AA 08 02 00 08 01 00 00 64")
    assert app.state is SlaveAppState.WAIT_CFG
    assert seen == [(PrmBlock(0x81, 0, b"\xaa"), PrmBlock(2, 0, b"\1\0\0\x64", 8))]
    assert PrmBlock(2, 0, b"\1\0\0\x64", 8).content == PrmCmd(1, 0, 100)


def test_without_prm_structure_they_are_octets() -> None:
    seen: list[object] = []
    app, _ = set_prm(rig(seen), "80 00 00 05 81 00")
    assert app.state is SlaveAppState.WAIT_CFG
    assert seen == [()]


@pytest.mark.parametrize(
    ("user_prm", "text"),
    [
        (
            "80 00 08 05 81 00 00",
            "octet 11: parameter block 1 says it has 5 octets: a block has 4 at least, and 4 are left",
        ),
        ("80 00 08 04 81 00 00 07 02 00 00 01 02 03", "octet 15: parameter block 2: type 2 (prm_cmd) has 4 octets"),
    ],
)
def test_wrong_lengths_are_a_prm_fault(user_prm: str, text: str) -> None:
    seen: list[object] = []
    app, told = set_prm(rig(seen), user_prm)
    assert app.state is SlaveAppState.WAIT_PRM
    assert app.diagnosis(0).prm_fault
    assert text in " ".join(told)
    assert seen == []


def test_its_own_judgement_and_a_slave_without_them() -> None:
    seen: list[object] = []
    app, told = set_prm(rig(seen, "slot 0 takes 2 octets"), "80 00 08 05 81 00 00 AA")
    assert app.diagnosis(0).prm_fault
    assert "slot 0 takes 2 octets" in " ".join(told)
    plain = SlaveDescription(ident=0x1234, configs=(b"\x10\x20",), dpv1=True, prm_blocks=False)
    app, told = set_prm(rig([], description=plain), "80 00 08 05 81 00 00 AA")
    assert app.diagnosis(0).prm_fault
    assert "Prm_Structure is set, this device has no structured parameters" in " ".join(told)
    old = SlaveDescription(ident=0x1234, configs=(b"\x10\x20",))  # octet 10 is the maker's there
    assert set_prm(rig([], description=old), "80 00 08 05")[0].state is SlaveAppState.WAIT_CFG
