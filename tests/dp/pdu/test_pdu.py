"""Set_Prm, Global_Control and Set_Slave_Add, against octets of real bus logs
(docs/reference/protocol.md#known-telegrams) and of manuals."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import construct as cs
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_kit import assert_linear

from dpstack.dp.pdu.alarm_blocks import parse_block
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.prm_blocks import parse_blocks
from dpstack.dp.pdu.requests import GlobalControl, SetPrm, SetSlaveAdd
from dpstack.dpv1.pdu import im
from dpstack.dpv1.pdu.ms2 import Abort, InitiateReq, InitiateRes, ResourceManagerRes
from dpstack.dpv1.pdu.read_write import AlarmAck, DataTransport, parse_request, parse_response
from dpstack.dpv1.slave.resource_manager import parse_transport
from dpstack.errors import ConfigError, DpError, PduError
from dpstack.fdl.codec import decode
from dpstack.gsd.identifiers import MAX_USER_PRM, agree, parse_identifiers
from dpstack.profile.record47.pdu import Request, Response

# pyprofibus#7, data unit of 68 0F 0F 68 82 E3 5D 3D 3E B8 05 01 00 0C DA 01 40 00 00 22 16
LOG_7 = bytes.fromhex("B8 05 01 00 0C DA 01 40 00 00")
LOG_7_VALUES = SetPrm(
    ident=0x0CDA,
    user_prm=b"\x40\0\0",
    lock=True,
    sync=True,
    freeze=True,
    watchdog=(5, 1),
    min_tsdr=0,
    group_mask=1,
)
# Felser's manual, "Telegrammformate": Set Parameters 1 -> 22
FELSER = bytes.fromhex("B8 01 63 0B 05 AA 22")


def test_the_log_of_a_real_bus_both_ways() -> None:
    assert SetPrm.parse(LOG_7) == LOG_7_VALUES
    assert LOG_7_VALUES.build() == LOG_7


def test_the_manual_s_example_both_ways() -> None:
    prm = SetPrm.parse(FELSER)
    assert (prm.watchdog, prm.min_tsdr, prm.ident, prm.group_mask) == ((1, 99), 11, 0x05AA, 0x22)
    assert prm.build() == FELSER


@pytest.mark.parametrize(
    ("prm", "first"),
    [
        (SetPrm(1), 0x80),
        (SetPrm(1, unlock=True), 0xC0),
        (SetPrm(1, lock=False, unlock=True), 0x40),
        (SetPrm(1, lock=False), 0x00),
        (SetPrm(1, sync=True), 0xA0),
        (SetPrm(1, freeze=True), 0x90),
        (SetPrm(1, watchdog=(2, 3)), 0x88),
    ],
)
def test_station_status(prm: SetPrm, first: int) -> None:
    octets = prm.build()
    assert octets[0] == first
    assert octets[1:] == bytes((2, 3) if prm.watchdog else (1, 1)) + b"\x0b\x00\x01\x00"
    assert SetPrm.parse(octets) == prm


def test_reserved_bits_and_zero_factors_are_taken_as_they_come() -> None:
    prm = SetPrm.parse(bytes.fromhex("8F 00 07 0B 12 34 00"))
    assert prm.lock
    assert prm.watchdog == (0, 7)


@pytest.mark.parametrize(
    ("length", "octet"),
    [(0, "octet 1"), (1, "octet 2"), (2, "octet 3"), (3, "octet 4"), (4, "octet 5"), (5, "octet 6"), (6, "octet 7")],
)
def test_too_short_names_the_octet(length: int, octet: str) -> None:
    with pytest.raises(PduError, match=octet):
        SetPrm.parse(LOG_7[:length])


def test_too_long_names_the_octet() -> None:
    assert len(SetPrm.parse(LOG_7[:7] + bytes(237)).user_prm) == 237
    with pytest.raises(PduError, match="octet 244 is the last"):
        SetPrm.parse(LOG_7[:7] + bytes(238))


@pytest.mark.parametrize(
    ("prm", "what"),
    [
        (SetPrm(0x10000), "ident = 65536"),
        (SetPrm(-1), "ident = -1"),
        (SetPrm(1, min_tsdr=256), "min_tsdr = 256"),
        (SetPrm(1, group_mask=256), "group_ident = 256"),
        (SetPrm(1, watchdog=(0, 1)), "watchdog factors"),
        (SetPrm(1, watchdog=(1, 256)), "watchdog factors"),
        (SetPrm(1, user_prm=bytes(MAX_USER_PRM + 1)), "238 octets"),
    ],
)
def test_values_that_do_not_fit_raise_at_once(prm: SetPrm, what: str) -> None:
    with pytest.raises(PduError, match=what) as caught:
        prm.build()
    assert isinstance(caught.value, DpError)
    assert isinstance(caught.value, ValueError)


prms = st.builds(
    SetPrm,
    ident=st.integers(0, 0xFFFF),
    user_prm=st.binary(max_size=237),
    lock=st.booleans(),
    unlock=st.booleans(),
    sync=st.booleans(),
    freeze=st.booleans(),
    watchdog=st.none() | st.tuples(st.integers(1, 255), st.integers(1, 255)),
    min_tsdr=st.integers(0, 255),
    group_mask=st.integers(0, 255),
)


@given(prms)
def test_every_set_prm_comes_back(prm: SetPrm) -> None:
    octets = prm.build()
    assert len(octets) == 7 + len(prm.user_prm)
    assert octets[4:6] == prm.ident.to_bytes(2, "big")
    assert SetPrm.parse(octets) == prm


# --- construct as the oracle ------------------------------------------------------------------------------------------

_SET_PRM: Any = cs.Struct(
    "status"
    / cs.BitStruct(
        "lock" / cs.Flag,
        "unlock" / cs.Flag,
        "sync" / cs.Flag,
        "freeze" / cs.Flag,
        "wd_on" / cs.Flag,
        "reserved" / cs.Padding(3),
    ),
    "watchdog" / cs.Byte[2],
    "min_tsdr" / cs.Byte,
    "ident" / cs.Int16ub,
    "group_mask" / cs.Byte,
    "user_prm" / cs.GreedyBytes,
)
_CONTROL: Any = cs.BitStruct(
    cs.Padding(2),
    "sync" / cs.Flag,
    "unsync" / cs.Flag,
    "freeze" / cs.Flag,
    "unfreeze" / cs.Flag,
    "clear" / cs.Flag,
    cs.Padding(1),
    "group_mask" / cs.Octet,
)


@given(st.binary(min_size=7, max_size=244))
def test_set_prm_as_construct_reads_and_builds_it(octets: bytes) -> None:
    prm, oracle = SetPrm.parse(octets), _SET_PRM.parse(octets)
    status = oracle.status
    assert (prm.lock, prm.unlock, prm.sync, prm.freeze) == (status.lock, status.unlock, status.sync, status.freeze)
    assert prm.watchdog == (tuple(oracle.watchdog) if status.wd_on else None)
    assert (prm.min_tsdr, prm.ident, prm.group_mask) == (oracle.min_tsdr, oracle.ident, oracle.group_mask)
    assert prm.user_prm == oracle.user_prm
    if 0 not in (prm.watchdog or (1, 1)):
        oracle.watchdog = prm.watchdog or (1, 1)  # a watchdog that is off has the smallest factors
        assert prm.build() == _SET_PRM.build(oracle)


@given(st.binary(min_size=2, max_size=2))
def test_global_control_as_construct_reads_and_builds_it(octets: bytes) -> None:
    control, oracle = GlobalControl.parse(octets), _CONTROL.parse(octets)
    assert {name: getattr(control, name) for name in GlobalControl.__struct_fields__} == {
        name: oracle[name] for name in GlobalControl.__struct_fields__
    }
    assert control.build() == _CONTROL.build(oracle)


@given(st.binary(max_size=300))
def test_any_octets_are_read_or_refused(octets: bytes) -> None:
    for pdu in (SetPrm, GlobalControl):
        try:
            pdu.parse(octets)
        except PduError as error:
            finding = str(error)
        else:
            finding = "octets are fine"
        assert "octet" in finding


@pytest.mark.parametrize(
    ("control", "octets"),
    [
        (GlobalControl(), "00 00"),
        (GlobalControl(clear=True), "02 00"),
        (GlobalControl(unfreeze=True), "04 00"),
        (GlobalControl(freeze=True, group_mask=0x80), "08 80"),
        (GlobalControl(unsync=True), "10 00"),
        (GlobalControl(sync=True, group_mask=3), "20 03"),
        (GlobalControl(clear=True, unfreeze=True, freeze=True, unsync=True, sync=True, group_mask=255), "3E FF"),
    ],
)
def test_global_control(control: GlobalControl, octets: str) -> None:
    assert control.build() == bytes.fromhex(octets)
    assert GlobalControl.parse(bytes.fromhex(octets)) == control


def test_global_control_ignores_reserved_bits_and_refuses_other_lengths() -> None:
    assert GlobalControl.parse(b"\xc1\x00") == GlobalControl()
    for octets in (b"", b"\0", b"\0\0\0"):
        with pytest.raises(PduError, match=r"octet [12]"):
            GlobalControl.parse(octets)
    with pytest.raises(PduError, match="group_select = 256"):
        GlobalControl(group_mask=256).build()


# --- Set_Slave_Add (docs/reference/protocol.md#set_slave_add)
# -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("octets", "pdu"),
    [
        ("05 12 34 00", SetSlaveAdd(5, 0x1234)),
        ("7D 06 96 FF", SetSlaveAdd(125, 0x0696, no_add_chg=True)),
        ("00 00 01 00 CA FE", SetSlaveAdd(0, 1, rem_slave_data=b"\xca\xfe")),
    ],
)
def test_set_slave_add_both_ways(octets: str, pdu: SetSlaveAdd) -> None:
    assert pdu.build() == bytes.fromhex(octets)
    assert SetSlaveAdd.parse(bytes.fromhex(octets)) == pdu


def test_any_octet_but_0_is_no_add_chg() -> None:
    assert SetSlaveAdd.parse(bytes.fromhex("05 12 34 01")) == SetSlaveAdd(5, 0x1234, no_add_chg=True)


@pytest.mark.parametrize("length", range(4))
def test_set_slave_add_cut_short(length: int) -> None:
    with pytest.raises(PduError, match=f"Set_Slave_Add ends after {length} octet"):
        SetSlaveAdd.parse(bytes.fromhex("05 12 34 00")[:length])


def test_set_slave_add_that_does_not_fit() -> None:
    assert len(SetSlaveAdd(5, 1, rem_slave_data=bytes(240)).build()) == 244
    with pytest.raises(PduError, match="241 octets for the device, 240 are possible"):
        SetSlaveAdd(5, 1, rem_slave_data=bytes(241)).build()
    for address in (-1, 126):
        with pytest.raises(PduError, match="is no address for a slave, 125 is the highest"):
            SetSlaveAdd(address, 1).build()
    with pytest.raises(PduError, match="ident = 65536"):
        SetSlaveAdd(5, 0x10000).build()


# --- Every parser of octets from the bus: an object, None or a PduError, with work in proportion to the octets ------


PARSERS: dict[str, Callable[[bytes], object]] = {
    "diagnosis": Diagnosis.parse,
    "Set_Prm": SetPrm.parse,
    "Global_Control": GlobalControl.parse,
    "Set_Slave_Add": SetSlaveAdd.parse,
    "Read and Write, asked": parse_request,
    "Read and Write, answered": parse_response,
    "blocks of parameters": parse_blocks,
    "alarms and status": parse_block,
    "Alarm_Ack": AlarmAck.parse,
    "Resource Manager": ResourceManagerRes.parse,
    "Initiate, asked": InitiateReq.parse,
    "Initiate, answered": InitiateRes.parse,
    "Data_Transport": DataTransport.parse,
    "Data_Transport at a slave": parse_transport,
    "Abort": Abort.parse,
    "I&M call": im.parse_call,
    "I&M 0": lambda octets: im.parse_answer(octets, 0),
    "I&M 3": lambda octets: im.parse_answer(octets, 3),
    "record 47, asked": Request.parse,
    "record 47, answered": Response.parse,
    "identifiers": parse_identifiers,
    "identifiers compared": lambda octets: agree(octets, octets + b"\0"),
    "telegrams": decode,
}


@pytest.mark.parametrize("name", PARSERS)
@given(octets=st.binary(max_size=80))
def test_any_octets(name: str, octets: bytes) -> None:
    with contextlib.suppress(PduError, ConfigError):
        PARSERS[name](octets)


@pytest.mark.parametrize("name", PARSERS)
@pytest.mark.parametrize("octet", [0x00, 0x01, 0x04, 0x41, 0x81, 0x95, 0xC0, 0xFF])
def test_twice_the_octets_take_twice_the_steps(name: str, octet: int) -> None:
    def work_of(n: int) -> Callable[[], object]:
        octets = bytes([octet]) * n

        def work() -> None:
            with contextlib.suppress(PduError, ConfigError):
                PARSERS[name](octets)

        return work

    assert_linear(work_of, 120)
