"""Texts for the contents of DP-V1 telegrams: services with slot and index, refusals, Abort and its reason, alarms.

For wire logs: whatever the octets are, there is a text. The telegrams themselves are :mod:`dpstack.fdl.describe`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from dpstack.dp.pdu.alarm_blocks import Alarm, alarm_name, parse_block
from dpstack.dp.pdu.diag_blocks import DeviceBlock
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dpv1.pdu.ms2 import Abort, InitiateReq, InitiateRes, ResourceManagerRes
from dpstack.dpv1.pdu.read_write import (
    AlarmAck,
    DataTransport,
    Function,
    Negative,
    ReadReq,
    RecordRes,
    Service,
    WriteRes,
    parse_request,
    parse_response,
)
from dpstack.errors import PduError
from dpstack.fdl import describe
from dpstack.fdl.telegram import SAP_MS1, SAP_MS1_ALARM, SAP_MS2_RM, SAP_SLAVE_DIAG, SSAP_MS2, Telegram
from dpstack.trace import WireEntry
from dpstack.units import ns_to_s

_NEGATIVE: Final = 0x80


def render(log: Iterable[WireEntry], baud: int) -> str:
    """The decoded wire log as :func:`dpstack.fdl.describe.render`, with what is in each telegram."""
    return describe.render(log, baud, inside)


def inside(telegram: Telegram) -> str:
    """A text for the DP-V1 contents of ``telegram``; empty where it has none."""
    request = telegram.is_request
    slave, master = (telegram.dsap, telegram.ssap) if request else (telegram.ssap, telegram.dsap)
    if slave is None or not telegram.data:
        return ""
    if slave == SAP_SLAVE_DIAG:
        return "" if request else _alarms(telegram.data)
    if slave in (SAP_MS1, SAP_MS1_ALARM) or (slave <= SAP_MS2_RM and master == SSAP_MS2):
        return pdu_text(telegram.data, request=request)
    return ""


def pdu_text(octets: bytes, *, request: bool) -> str:
    """A PDU of MS1 or MS2, at least one octet, from a master or from a slave.

    >>> pdu_text(b"\\xde\\x80\\xb0\\x00", request=False)
    'Read refused: invalid index (80 B0 00: class access, code 0)'
    """
    try:
        return _pdu_text(octets, request=request)
    except PduError as error:
        return f"cannot be read ({error})"


def _pdu_text(octets: bytes, *, request: bool) -> str:
    function = octets[0]
    match function:
        case Function.IDLE:
            return Function.IDLE.title
        case Function.ABORT:
            return f"Abort: {Abort.parse(octets).text}"
        case Function.RESOURCE_MANAGER:
            manager = ResourceManagerRes.parse(octets)
            return f"server SAP {manager.server_sap}, send time-out {ns_to_s(manager.send_timeout_ns):g} s"
        case Function.INITIATE if request:
            return f"Initiate, send time-out {ns_to_s(InitiateReq.parse(octets).send_timeout_ns):g} s"
        case Function.INITIATE:
            return f"Initiate, up to {InitiateRes.parse(octets).max_len} octets of data"
        case Function.ALARM_ACK:
            ack = AlarmAck.parse(octets)
            return f"Alarm_Ack of {alarm_name(ack.type)}, slot {ack.slot}, sequence number {ack.sequence}"
        case Function.DATA_TRANSPORT:
            service: Service | RecordRes = DataTransport.parse(octets)
        case _:
            service = parse_request(octets) if request else parse_response(octets)
    match service:
        case Negative():
            return f"{Function(service.function).title} refused: {service.text}"
        case ReadReq():
            return f"{service.title}, up to {service.length}"
        case WriteRes():
            return f"{service.title}, data {service.length}"
    return f"{service.title}, data {len(service.data)}"


def _alarms(octets: bytes) -> str:
    """Alarms and status in a diagnosis. A device related block of a slave without DP-V1 may look like one."""
    diagnosis = Diagnosis.parse(octets)
    blocks = () if diagnosis is None else diagnosis.blocks
    texts = []
    for block in blocks:
        if isinstance(block, DeviceBlock):
            try:
                message = parse_block(block.octets)
            except PduError:
                continue
            number = f", sequence number {message.sequence}" if isinstance(message, Alarm) else ""
            texts.append(message.text + number)
    return "; ".join(texts)
