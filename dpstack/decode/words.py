"""Telegrams and wire logs in words, for people: lines of ``decode``, and the log that a failing test prints.

Any octets have a text. Contents that have words: Global_Control, alarms and status in a diagnosis, every service of
DP-V1.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
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
from dpstack.fdl.codec import Flaw, decode, parse
from dpstack.fdl.service_names import BY_FUNCTION, service
from dpstack.fdl.telegram import (
    COUNTED,
    FC_FCB,
    FC_FCV,
    SAP_MS1,
    SAP_MS1_ALARM,
    SAP_MS2_RM,
    SAP_SLAVE_DIAG,
    SSAP_MS2,
    UNANSWERED,
    Kind,
    Req,
    Resp,
    Telegram,
)
from dpstack.params import BROADCAST
from dpstack.text import octets_text
from dpstack.trace import WireEntry
from dpstack.units import NS_PER_US, ns_to_bits, ns_to_s

_SHORT_NAMES: Final[dict[int, str]] = {
    Req.SDA_LOW: "SDA low",
    Req.SDA_HIGH: "SDA high",
    Req.SDN_LOW: "SDN low",
    Req.SDN_HIGH: "SDN high",
    Req.SRD_LOW: "SRD low",
    Req.SRD_HIGH: "SRD high",
}

#: Global_Control octet 1, in the order of the bits; Operate is the absence of Clear_Data
_CONTROLS: Final = ((0x04, "Unfreeze"), (0x08, "Freeze"), (0x10, "Unsync"), (0x20, "Sync"))

#: number of cached lines: 126 stations with both FCB and both directions have 504
_KEPT_LINES: Final = 1_024
#: a wire log shows so many octets of a transmission in full
SHOWN_OCTETS: Final = 32
#: the texts of :class:`Flaw`
FLAWS: Final = {
    Flaw.BAD_START: "no start octet (10, 68, A2, DC, E5)",
    Flaw.LE_MISMATCH: "LE and LEr differ",
    Flaw.LE_RANGE: "LE outside of 3..249",
    Flaw.BAD_SECOND_SD: "the second start octet is not 68",
    Flaw.BAD_ED: "the end octet is not 16",
    Flaw.BAD_FCS: "wrong check sequence (FCS)",
    Flaw.BAD_ADDRESS: "an address above 127",
    Flaw.BAD_EXTENSION: "address extensions that are not whole",
    Flaw.BAD_FC: "a function code that does not exist",
}


def describe(telegram: Telegram) -> str:
    """A line of text without line end: service, addresses, and the content.

    >>> describe(Telegram(Kind.SD2, 3, 2, 0x5D, 61, 62, bytes(7)))
    'Set_Prm request 2 -> 3, 7 octets (SRD high, FCV=1 FCB=0)'
    """
    kind, da, sa, fc, dsap, ssap, data, dseg, sseg = telegram
    if dsap is ssap is dseg is sseg is None:
        return _line_without_saps(int(kind), da, sa, fc, len(data))
    return _line(telegram)


@lru_cache(_KEPT_LINES)
def _line_without_saps(kind: int, da: int, sa: int, fc: int, size: int) -> str:
    """The line of a telegram whose data has no words, such as Data_Exchange; cached, for a cycle repeats it."""
    return _line(Telegram(Kind(kind), da, sa, fc, data=bytes(size)))


def _line(telegram: Telegram) -> str:
    name = service(telegram)
    if telegram.kind is Kind.SC:
        return "SC"
    way = f"{telegram.sa} -> {'all' if telegram.da == BROADCAST else telegram.da}"
    if telegram.kind is Kind.SD4:
        return f"token {way}" + (" (to itself)" if telegram.sa == telegram.da else "")
    parts = [f"{name} {way}" if _unanswered(telegram) else f"{name} {_side(telegram)}{way}"]
    if name == "Global_Control" and telegram.is_request and len(telegram.data) == 2:
        parts.append(_global_control(telegram.data))
    elif telegram.data:
        words = contents(telegram)
        octets = octets_text(len(telegram.data))
        parts.append(f"{octets}: {words}" if words else octets)
    if telegram.empty_le3:
        parts.append("LE = 3")
    segments = (("DSEG", telegram.dseg), ("SSEG", telegram.sseg))
    parts += [f"{what} {value}" for what, value in segments if value is not None]
    return f"{', '.join(parts)} ({_control(telegram)})"


def _unanswered(telegram: Telegram) -> bool:
    return telegram.is_request and telegram.function in UNANSWERED


def _side(telegram: Telegram) -> str:
    if telegram.is_request:
        return "request "
    return "" if service(telegram) == "acknowledgement" else "answer "


def _control(telegram: Telegram) -> str:
    """The FC octet in words."""
    function = telegram.function
    if not telegram.is_request:
        known = function in Resp.__members__.values()
        return f"{Resp(function).name if known else f'status {function}'}, {telegram.station_type.text}"
    bits = []
    if function in _SHORT_NAMES:
        bits.append(_SHORT_NAMES[function])
    elif function not in BY_FUNCTION:
        bits.append(f"function {function}")
    fcv, fcb = bool(telegram.fc & FC_FCV), bool(telegram.fc & FC_FCB)
    if fcv or fcb or function in COUNTED:
        bits.append(f"FCV={fcv:d} FCB={fcb:d}")
    return ", ".join(bits) or f"FC {telegram.fc:#04x}"


def _global_control(data: bytes) -> str:
    control, groups = data
    words = ["Clear" if control & 0x02 else "Operate"]
    words += [word for mask, word in _CONTROLS if control & mask]
    if control & 0xC1:
        words.append(f"reserved bits {control & 0xC1:#04x}")
    members = ", ".join(str(bit + 1) for bit in range(8) if groups >> bit & 1)
    return f"{' '.join(words)}, {'group ' + members if members else 'all groups'}"


def describe_octets(octets: bytes) -> str:
    """The telegram in ``octets`` in words, or the reason why they are no telegram."""
    telegram = decode(octets)
    return flaw_text(octets) if telegram is None else describe(telegram)


def flaw_text(octets: bytes) -> str:
    """Why ``octets`` are not exactly one telegram."""
    if not octets:
        return "no octets"
    found = parse(octets, 0, len(octets))
    if isinstance(found, Flaw):
        return f"no telegram: {FLAWS[found]}"
    return "no telegram: cut off" if found is None else "a telegram with other octets after it"


def render(log: Iterable[WireEntry], baud: int) -> str:
    """The decoded wire log, a line for each transmission: start in us, gap before it in bit times, sender, octets in
    hex (long ones without their middle), description. A negative gap is an overlap.
    """
    entries = list(log)
    shown = [_hex(entry.octets) for entry in entries]
    width = max((len(octets) for octets in shown), default=0)
    lines = [f"{'start us':>14} {'gap bits':>9}  {'sender':<10} {'octets':<{width}}  telegram"]
    end: int | None = None
    for entry, octets in zip(entries, shown, strict=True):
        gap = "" if end is None else str(ns_to_bits(entry.start_ns - end, baud))
        start = f"{entry.start_ns // NS_PER_US}.{entry.start_ns % NS_PER_US:03}"
        note = f"  [{entry.note}]" if entry.note else ""
        text = describe_octets(entry.octets)
        lines.append(f"{start:>14} {gap:>9}  {entry.sender or '?':<10} {octets:<{width}}  {text}{note}")
        end = entry.end_ns if end is None else max(end, entry.end_ns)
    return "\n".join(lines)


def _hex(octets: bytes) -> str:
    if len(octets) <= SHOWN_OCTETS:
        return octets.hex(" ")
    return f"{octets[: SHOWN_OCTETS - 8].hex(' ')} ... {octets[-4:].hex(' ')} ({len(octets)} octets)"


def contents(telegram: Telegram) -> str:
    """A text for the contents of ``telegram``; empty where it has none."""
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
