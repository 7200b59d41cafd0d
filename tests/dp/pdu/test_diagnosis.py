"""The diagnosis: octets of real logs, every bit, blocks whose lengths are true or lie."""

from __future__ import annotations

from typing import Any

import construct as cs
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from support import present

from dpstack.dp.pdu.diag_bits import FLAG, FLAGS, SetBy
from dpstack.dp.pdu.diag_blocks import Block, ChannelBlock, DeviceBlock, IdentifierBlock, RevisionBlock, split_blocks
from dpstack.dp.pdu.diag_texts import block_texts, conspicuous_text
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.errors import PduError
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.model import Device, DiagText
from dpstack.gsd.model import Diagnosis as GsdDiagnosis

#: the attribute of each bit that a slave sets
ATTRIBUTES = {
    "station_not_ready": "not_ready",
    "cfg_fault": "cfg_fault",
    "ext_diag": "ext_diag",
    "not_supported": "not_supported",
    "prm_fault": "prm_fault",
    "prm_req": "prm_req",
    "stat_diag": "stat_diag",
    "wd_on": "wd_on",
    "freeze_mode": "freeze",
    "sync_mode": "sync",
    "ext_diag_overflow": "overflow",
}
#: the oracle
SLAVE_DIAG: Any = cs.Struct(
    "status1" / cs.Byte,
    "status2" / cs.Byte,
    "status3" / cs.Byte,
    "master" / cs.Byte,
    "ident" / cs.Int16ub,
    "ext" / cs.GreedyBytes,
)
BY_MASTER = {"station_non_existent", "invalid_slave_response", "master_lock", "not_present", "deactivated"}


def parse(octets: str) -> Diagnosis:
    return present(Diagnosis.parse(bytes.fromhex(octets)))


def test_a_slave_that_waits_for_parameters() -> None:
    """pyprofibus#7."""
    diagnosis = parse("02 05 00 FF 0C DA")
    assert diagnosis.master is None
    assert diagnosis.ident == 0x0CDA
    assert diagnosis.flags == ("station_not_ready", "prm_req")
    assert diagnosis.always_one
    assert diagnosis.build() == bytes.fromhex("02 05 00 FF 0C DA")


def test_a_slave_that_is_ready() -> None:
    """pyprofibus#19: watchdog on, locked to master 2."""
    diagnosis = parse("00 0C 00 02 0A 35")
    assert (diagnosis.master, diagnosis.ident, diagnosis.flags) == (2, 0x0A35, ("wd_on",))
    assert not diagnosis.not_ready
    assert diagnosis.ext == b""
    assert diagnosis.blocks == ()
    assert diagnosis.texts == ("watches its master",)


@given(st.binary(min_size=6, max_size=244))
def test_a_diagnosis_as_construct_reads_and_builds_it(octets: bytes) -> None:
    diagnosis, oracle = Diagnosis.parse(octets), SLAVE_DIAG.parse(octets)
    assert diagnosis is not None
    if oracle.master == 255:
        assert diagnosis.master is None
        diagnosis = replace(diagnosis, master=255)
    assert {name: getattr(diagnosis, name) for name in Diagnosis.__struct_fields__} == {
        name: oracle[name] for name in Diagnosis.__struct_fields__
    }
    assert diagnosis.build() == SLAVE_DIAG.build(oracle)


@pytest.mark.parametrize(("field", "value"), [("status1", 256), ("status2", -1), ("master", 256), ("ident", 0x10000)])
def test_a_value_that_does_not_fit_is_named(field: str, value: int) -> None:
    with pytest.raises(PduError, match=f"Slave_Diag: {field} = {value} does not fit its octets"):
        replace(parse("02 05 00 FF 0C DA"), **{field: value}).build()


@pytest.mark.parametrize("name", FLAG)
def test_every_bit_by_itself(name: str) -> None:
    flag = FLAG[name]
    octets = bytearray(6)
    octets[flag.octet - 1] = flag.mask
    diagnosis = present(Diagnosis.parse(bytes(octets)))
    assert diagnosis.flags == (name,)
    assert [flag.name for flag in diagnosis.findings] == [name]
    assert [of for of, attribute in ATTRIBUTES.items() if getattr(diagnosis, attribute)] == [
        of for of in ATTRIBUTES if of == name
    ]
    assert diagnosis.texts[0].startswith(flag.text)
    assert diagnosis.build() == octets


def test_the_table_holds_every_bit_once() -> None:
    assert {flag.name for flag in FLAGS} == {*ATTRIBUTES, *BY_MASTER}
    assert len({(flag.octet, flag.mask) for flag in FLAGS}) == len(FLAGS)
    covered = [sum(flag.mask for flag in FLAGS if flag.octet == octet) for octet in (1, 2, 3)]
    assert covered == [0xFF, 0xFB, 0x80]  # octet 2 bit 2 is always 1, octet 3 has one bit
    assert {flag.name for flag in FLAGS if flag.set_by is SetBy.MASTER} == BY_MASTER


@pytest.mark.parametrize("length", [0, 1, 5, 245, 300])
def test_octets_of_an_impossible_length_are_no_diagnosis(length: int) -> None:
    assert Diagnosis.parse(bytes(length)) is None


def test_deviations_of_real_slaves_are_tolerated() -> None:
    """docs/reference/protocol.md#always-1-bit: it is 0; the master address is own + 128."""
    assert not parse("00 00 00 02 12 34").always_one
    assert parse("00 08 00 82 12 34").master == 0x82


def test_an_extended_diagnosis_that_is_too_long_is_misuse() -> None:
    assert len(Diagnosis(0, 4, 0, 2, 1, bytes(238)).build()) == 244
    with pytest.raises(PduError, match="239 octets"):
        Diagnosis(0, 4, 0, 2, 1, bytes(239)).build()


def test_all_kinds_of_blocks() -> None:
    """docs/reference/protocol.md#diagnosis-blocks: device, identifier, channel, revision."""
    diagnosis = parse("08 0C 00 02 12 34" + "04 AA BB CC" + "43 05 80" + "82 43 A6" + "C7" + "01")
    assert diagnosis.ext_finding is None
    device, identifier, channel, revision, empty = diagnosis.blocks
    assert isinstance(device, DeviceBlock)
    assert device.data == b"\xaa\xbb\xcc"
    assert isinstance(identifier, IdentifierBlock)
    assert identifier.modules == (0, 2, 15)
    assert isinstance(channel, ChannelBlock)
    assert (channel.identifier, channel.channel, channel.input, channel.output) == (2, 3, True, False)
    assert (channel.size, channel.error) == (5, 6)
    assert channel.text == "slot 3, input channel 3 (word): line break"
    assert isinstance(revision, RevisionBlock)
    assert revision.revision == 7
    assert empty == DeviceBlock(b"\x01")


@pytest.mark.parametrize(
    ("octets", "text"),
    [
        ("80 80 21", "slot 1, output channel 0 (bit): short circuit"),
        ("BF FF F0", "slot 64, in/output channel 63 (reserved): error 16"),
        ("81 00 09", "slot 2, channel 0 (unspecific): error"),
    ],
)
def test_channel_texts(octets: str, text: str) -> None:
    (block,), finding = split_blocks(bytes.fromhex(octets))
    assert finding is None
    assert isinstance(block, ChannelBlock)
    assert block.text == text


@pytest.mark.parametrize(
    ("ext", "blocks", "finding"),
    [
        ("05 01 02", [DeviceBlock(bytes.fromhex("050102"))], "octet 7 announces a block of 5 octets, 3 are left"),
        ("C1 48 01", [RevisionBlock(b"\xc1", 1), IdentifierBlock(b"\x48\x01")], "octet 8 announces a block of 8"),
        ("81 00", [], "octet 7 announces a block of 3 octets, 2 are left"),
        ("00 FF", [], "octet 7 announces a block without any octets, 2 octets left undecoded"),
        ("C1 40", [RevisionBlock(b"\xc1", 1)], "octet 8 announces a block without any octets"),
    ],
)
def test_wrong_lengths_in_the_extended_diagnosis(ext: str, blocks: list[Block], finding: str) -> None:
    found, text = split_blocks(bytes.fromhex(ext))
    assert list(found) == blocks
    assert text is not None
    assert text.startswith(finding)


@given(st.binary(min_size=6, max_size=244))
def test_any_octets(octets: bytes) -> None:
    diagnosis = present(Diagnosis.parse(octets))
    assert diagnosis.build() == octets
    joined = b"".join(block.octets for block in diagnosis.blocks)
    assert octets[6:].startswith(joined)
    assert diagnosis.ext_finding is not None or joined == octets[6:]
    assert len(diagnosis.texts) == len(diagnosis.flags)


FUSE = "08 0C 00 02 12 34 0A 01 46 75 73 65 20 46 31 20"  # a block of 10 octets: 01, "Fuse F1 "


def test_text_of_a_device_is_shown_as_text_in_every_place() -> None:
    said = 'device: "Fuse F1" (01 46 75 73 65 20 46 31 20)'
    assert block_texts(parse(FUSE)) == (said,)
    assert conspicuous_text(parse(FUSE), exchanging=True) == f"ext_diag; {said}"
    alarm = "08 0C 00 02 12 34 0C 01 02 09 70 75 6D 70 20 6F 69 6C"
    assert block_texts(parse(alarm), dpv1=True) == (
        'diagnosis alarm, slot 2, appears, slot disturbed, data "pump oil"',
    )


def test_text_of_a_device_stands_beside_the_texts_of_its_gsd_file() -> None:
    bit = DiagText("bit", 0, 0, 1, "fuse blown", "replace it")
    texts = DiagTexts(Device(diagnosis=GsdDiagnosis((bit,))))
    assert block_texts(parse(FUSE), texts) == (
        "fuse blown (replace it)",
        'device: "Fuse F1" (01 46 75 73 65 20 46 31 20)',
    )
    assert block_texts(parse("08 0C 00 02 12 34 02 01"), texts) == ("fuse blown (replace it)",)


def test_escape_sequences_of_a_device_stay_octets() -> None:
    """A title for the terminal: what a terminal would obey is no character of the text."""
    assert block_texts(parse("08 0C 00 02 12 34 0B 1B 5D 30 3B 6F 77 6E 65 64 07")) == (
        'device: "]0;owned" (1b 5d 30 3b 6f 77 6e 65 64 07)',
    )
