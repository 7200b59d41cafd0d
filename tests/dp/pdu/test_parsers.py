"""Every parser of octets from the bus: an object, None or a PduError, with work in proportion to the octets."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

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
from dpstack.errors import ConfigError, PduError
from dpstack.fdl.codec import decode
from dpstack.gsd.identifiers import agree, parse_identifiers
from dpstack.profile.record47.pdu import Request, Response

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
