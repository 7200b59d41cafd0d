"""Telegrams and wire logs as text, for ``decode``, ``capture`` and failing tests.

The DP services are recognised by their service access points (docs/protocol.md#saps).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from dpstack.fdl.codec import Flaw, decode, parse
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import (
    COUNTED,
    FC_FCB,
    FC_FCV,
    SAP_CHK_CFG,
    SAP_EXT_USER_PRM,
    SAP_GET_CFG,
    SAP_GLOBAL_CONTROL,
    SAP_MS1,
    SAP_MS1_ALARM,
    SAP_MS2_RM,
    SAP_RD_INP,
    SAP_RD_OUTP,
    SAP_SET_PRM,
    SAP_SET_SLAVE_ADD,
    SAP_SLAVE_DIAG,
    SSAP_MASTER_MASTER,
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
from dpstack.units import NS_PER_US, ns_to_bits

_BY_SAP: Final[dict[int, str]] = {
    SAP_MS2_RM: "MS2 resource manager",
    SAP_MS1_ALARM: "MS1 alarm",
    SAP_MS1: "MS1",
    SAP_EXT_USER_PRM: "Ext_User_Prm",
    SSAP_MASTER_MASTER: "master-master",
    SAP_SET_SLAVE_ADD: "Set_Slave_Add",
    SAP_RD_INP: "RD_Inp",
    SAP_RD_OUTP: "RD_Outp",
    SAP_GLOBAL_CONTROL: "Global_Control",
    SAP_GET_CFG: "Get_Cfg",
    SAP_SLAVE_DIAG: "Slave_Diag",
    SAP_SET_PRM: "Set_Prm",
    SAP_CHK_CFG: "Chk_Cfg",
}

_BY_FUNCTION: Final[dict[int, str]] = {
    Req.TIME_EVENT: "Time_Event",
    Req.MSRD: "MSRD",
    Req.FDL_STATUS: "FDL_Status",
    Req.IDENT: "Ident",
    Req.LSAP_STATUS: "LSAP_Status",
}

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

#: describes the content of a telegram in words; empty text for unknown content
Inside = Callable[[Telegram], str]

#: longer transmissions are shown without their middle
SHOWN_OCTETS: Final = 32


def service(telegram: Telegram) -> str:
    """The name of the service a telegram belongs to: ``Set_Prm``, ``Data_Exchange``, ``token``, ``SC`` ...

    A response without SAPs and data can belong to any request: ``acknowledgement``.
    """
    if telegram.kind is Kind.SC:
        return "SC"
    if telegram.kind is Kind.SD4:
        return "token"
    if telegram.is_request:
        named = _BY_FUNCTION.get(telegram.function)
        if named is not None:
            return "Clock_Value" if telegram.fc & 0x80 else named
        return _by_saps(telegram.dsap, telegram.ssap)
    if telegram.dsap is None and telegram.ssap is None and not telegram.data:
        return "acknowledgement"
    return _by_saps(telegram.ssap, telegram.dsap)


def request_name(request: Request) -> str:
    """The name of the service of a request."""
    return _BY_FUNCTION.get(request.function) or _by_saps(request.dsap, request.ssap)


def _by_saps(slave: int | None, master: int | None) -> str:
    """The service between a slave's SAP and a master's."""
    if slave is None:
        return "Data_Exchange" if master is None else f"SAP none/{master}"
    named = _BY_SAP.get(slave)
    if named is None and slave < SAP_MS2_RM and master == SSAP_MS2:
        return f"MS2 connection {slave}"
    return named or f"SAP {slave}"


def _nothing(_: Telegram) -> str:
    return ""


def describe(telegram: Telegram, inside: Inside = _nothing) -> str:
    """A line of text without line end: service, addresses, and the content (``inside`` describes it in words).

    >>> describe(Telegram(Kind.SD2, 3, 2, 0x5D, 61, 62, bytes(7)))
    'Set_Prm request 2 -> 3, 7 octets (SRD high, FCV=1 FCB=0)'
    """
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
        words = inside(telegram)
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
    elif function not in _BY_FUNCTION:
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


def describe_octets(octets: bytes, inside: Inside = _nothing) -> str:
    """The telegram in ``octets`` in words, or the reason why they are no telegram."""
    if not octets:
        return "nothing"
    telegram = decode(octets)
    if telegram is not None:
        return describe(telegram, inside)
    found = parse(octets, 0, len(octets))
    if isinstance(found, Flaw):
        return f"no telegram: {found.value.replace('_', ' ')}"
    return "no telegram: cut off" if found is None else f"{describe(found, inside)}, then other octets"


def render(log: Iterable[WireEntry], baud: int, inside: Inside = _nothing) -> str:
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
        text = describe_octets(entry.octets, inside)
        lines.append(f"{start:>14} {gap:>9}  {entry.sender or '?':<10} {octets:<{width}}  {text}{note}")
        end = entry.end_ns if end is None else max(end, entry.end_ns)
    return "\n".join(lines)


def _hex(octets: bytes) -> str:
    if len(octets) <= SHOWN_OCTETS:
        return octets.hex(" ")
    return f"{octets[: SHOWN_OCTETS - 8].hex(' ')} ... {octets[-4:].hex(' ')} ({len(octets)} octets)"
