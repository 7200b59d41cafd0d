"""Telegrams in words, one line each: their service, addresses and content, the last made of the fields.

Any octets have a text. Contents that have words: Global_Control, alarms and status in a diagnosis, every service of
DP-V1, and what a drive and its parameters say.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, Final

from dpstack.decode.fields import Fields, fields_of, is_dpv1
from dpstack.dpv1.pdu.read_write import Function
from dpstack.errors import ConfigError, PduError
from dpstack.fdl.codec import Flaw, claimed, decode, fcs, parse
from dpstack.fdl.service_names import BY_FUNCTION, service
from dpstack.fdl.telegram import (
    COUNTED,
    FC_FCB,
    FC_FCV,
    SAP_SLAVE_DIAG,
    UNANSWERED,
    Kind,
    Req,
    Resp,
    Telegram,
)
from dpstack.params import BROADCAST
from dpstack.text import octets_text

_SHORT_NAMES: Final[dict[int, str]] = {
    Req.SDA_LOW: "SDA low",
    Req.SDA_HIGH: "SDA high",
    Req.SDN_LOW: "SDN low",
    Req.SDN_HIGH: "SDN high",
    Req.SRD_LOW: "SRD low",
    Req.SRD_HIGH: "SRD high",
}

#: the fields of Global_Control in the order of the bits; Operate is the absence of Clear_Data
_CONTROLS: Final = ("Unfreeze", "Freeze", "Unsync", "Sync")
#: the service of an S7-200, and the first octet of its PDUs
PPI: Final = "PPI"
PDU_OCTET: Final = b"\x32"
#: heads of telegrams whose words are kept
_KEPT_HEADS: Final = 2048

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
    try:
        fields = fields_of(telegram)
    except (PduError, ConfigError) as error:
        return describe_with(telegram, {}, str(error))
    if not fields and telegram.data[:1] == PDU_OCTET and telegram.dsap is telegram.ssap is None:
        from dpstack.decode.ppi import alone_fields  # here, as most buses have no such CPU

        fields = alone_fields(telegram.data, request=telegram.is_request)
    return describe_with(telegram, fields, None, name=PPI if fields and "PPI_PDU" in fields else "")


def describe_with(
    telegram: Telegram, fields: Fields, error: str | None, sender: str = "", receiver: str = "", name: str = ""
) -> str:
    """The same with the ``fields`` of the telegram, or the ``error`` in its data unit; names of stations. ``name``: the
    service if the telegram does not say it itself."""
    front, back = _frame(
        telegram.kind,
        telegram.da,
        telegram.sa,
        telegram.fc,
        telegram.dsap,
        telegram.ssap,
        len(telegram.data),
        telegram.dseg,
        telegram.sseg,
        sender,
        receiver,
        name,
    )
    words = f"cannot be read ({error})" if error is not None else contents_of(telegram, fields) if fields else ""
    if not words:
        return front + back
    return f"{front}{', ' if fields.keys() & _GLOBAL_CONTROL else ': '}{words}{back}"


_GLOBAL_CONTROL: Final = frozenset(("Clear_Data",))


@lru_cache(_KEPT_HEADS)
def _frame(
    kind: Kind,
    da: int,
    sa: int,
    fc: int,
    dsap: int | None,
    ssap: int | None,
    size: int,
    dseg: int | None,
    sseg: int | None,
    sender: str,
    receiver: str,
    name: str,
) -> tuple[str, str]:
    """The words before and behind the content of a telegram with ``size`` octets of data."""
    telegram = Telegram(kind, da, sa, fc, dsap, ssap, bytes(size), dseg, sseg)
    name = name or service(telegram)
    if kind is Kind.SC:
        return "SC", ""
    to = "all" if da == BROADCAST else _called(da, receiver)
    way = f"{_called(sa, sender)} -> {to}"
    if kind is Kind.SD4:
        return f"token {way}" + (" (to itself)" if sa == da else ""), ""
    parts = [f"{name} {way}" if _unanswered(telegram) else f"{name} {_side(telegram)}{way}"]
    if size and not (name == "Global_Control" and telegram.is_request and size == 2):
        parts.append(octets_text(size))
    rest = [""]
    if telegram.empty_le3:
        rest.append("LE = 3")
    segments = (("DSEG", dseg), ("SSEG", sseg))
    rest += [f"{what} {value}" for what, value in segments if value is not None]
    return ", ".join(parts), f"{', '.join(rest)} ({_control(telegram)})"


def _called(address: int, name: str) -> str:
    return f"{address} [{name}]" if name else str(address)


def acknowledged(service_name: str, station: int, master: int, sender: str = "", receiver: str = "") -> str:
    """The words of an SC that answers a request of ``master`` to ``station``."""
    return f"SC {_called(station, sender)} -> {_called(master, receiver)}, acknowledges {service_name}"


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


def describe_octets(octets: bytes) -> str:
    """The telegram in ``octets`` in words, or the reason why they are no telegram."""
    telegram = decode(octets)
    return flaw_text(octets) if telegram is None else describe(telegram)


def flaw_text(octets: bytes) -> str:
    """Why ``octets`` are not exactly one telegram, and which octet shows it, counted from 1."""
    if not octets:
        return "no octets"
    end = len(octets)
    found = parse(octets, 0, end)
    if isinstance(found, Flaw):
        return f"no telegram: {FLAWS[found]}{_place(found, octets)}"
    size = claimed(octets, 0, end)
    if found is None:
        return f"no telegram: cut off after {octets_text(end)} of {size}" if end > 1 else "no telegram: cut off"
    return f"a telegram with other octets after it, from octet {size + 1} on"


def _place(flaw: Flaw, octets: bytes) -> str:
    """The octet that shows the flaw."""
    size = claimed(octets, 0, len(octets))
    match flaw:
        case Flaw.LE_MISMATCH:
            return f": octets 2 and 3 are {octets[1]:02x} and {octets[2]:02x}"
        case Flaw.LE_RANGE:
            return f": octet 2 is {octets[1]:02x}"
        case Flaw.BAD_SECOND_SD:
            return f": octet 4 is {octets[3]:02x}"
        case Flaw.BAD_ED:
            return f": octet {size} is {octets[size - 1]:02x}"
        case Flaw.BAD_FCS:
            first = 4 if octets[0] == Kind.SD2 else 1
            return f": octet {size - 1} is {octets[size - 2]:02x}, the sum is {fcs(octets[first : size - 2]):02x}"
        case Flaw.BAD_START:
            return f": octet 1 is {octets[0]:02x}"
    return ""


# --- contents ---------------------------------------------------------------------------------------------------------
def contents_of(telegram: Telegram, fields: Mapping[str, Any]) -> str:
    """A text for the contents of ``telegram``, which has these ``fields``; empty if it has none."""
    if "Function_Num" in fields and is_dpv1(telegram):
        return _pdu_text(fields, request=telegram.is_request)
    if "PPI_PDU" in fields:
        return str(fields["text"])
    if "Lock_Req" in fields:
        return _set_prm(fields)
    if "Clear_Data" in fields:
        return _global_control(fields)
    if "Clock_Value_Time_Event" in fields:
        from dpstack.dp.pdu.clock import ClockValue  # here, as few buses send the time

        return ClockValue.parse(telegram.data).text
    if "Vendor_Name" in fields:
        from dpstack.fdl.services.identity import Ident  # here, as few stations are asked for it

        return Ident.parse(telegram.data).text
    if not telegram.is_request and telegram.ssap == SAP_SLAVE_DIAG:
        return _diagnosis(fields)
    drive = fields.get("drive")
    return str(drive["text"]) if drive and drive.get("text") else ""


def _set_prm(fields: Mapping[str, Any]) -> str:
    """The blocks of redundancy, isochronous mode and clock, what they demand, and what is wrong in them."""
    words = [block["text"] for block in fields.get("Blocks", ()) if "text" in block]
    if "demands" in fields:
        words.append(f"demands {fields['demands']}")
    return "; ".join((*words, *fields.get("findings", ())))


def _global_control(fields: Mapping[str, Any]) -> str:
    words = ["Clear" if fields["Clear_Data"] else "Operate"]
    words += [word for word in _CONTROLS if fields[word]]
    if "reserved" in fields:
        words.append(f"reserved bits {fields['reserved']}")
    members = ", ".join(map(str, fields["Group_Select"]))
    return f"{' '.join(words)}, {'group ' + members if members else 'all groups'}"


def _diagnosis(fields: Mapping[str, Any]) -> str:
    """The texts of a diagnosis: alarms and status, or those of the GSD file and of the standard. A device related block
    of a slave without DP-V1 may look like an alarm."""
    messages, texts = [], []
    for block in fields.get("Ext_Diag_Data", ()):
        if (message := block.get("if_dpv1")) is not None:
            number = "" if message["Seq_Nr"] is None else f", sequence number {message['Seq_Nr']}"
            messages.append(message["text"] + number)
        elif block.get("text"):
            texts.append(block["text"])
    return "; ".join(messages or fields.get("texts", texts))


def _initiate(fields: Mapping[str, Any], request: bool) -> str:
    if request:
        return f"Initiate, send time-out {fields['Send_Timeout_s']:g} s"
    return f"Initiate, up to {fields['Max_Len_Data_Unit']} octets of data"


def _alarm_ack(fields: Mapping[str, Any], request: bool) -> str:
    return f"Alarm_Ack of {fields['alarm']}, slot {fields['Slot_Number']}, sequence number {fields['Seq_Nr']}"


def _resource_manager(fields: Mapping[str, Any], request: bool) -> str:
    return f"server SAP {fields['Server_SAP']}, send time-out {fields['Send_Timeout_s']:g} s"


#: functions whose words are not those of Read and Write
_FUNCTIONS: Final[Mapping[str, Callable[[Mapping[str, Any], bool], str]]] = {
    Function.IDLE.title: lambda fields, request: Function.IDLE.title,
    Function.ABORT.title: lambda fields, request: f"Abort: {fields['text']}",
    Function.RESOURCE_MANAGER.title: _resource_manager,
    Function.INITIATE.title: _initiate,
    Function.ALARM_ACK.title: _alarm_ack,
}


def _pdu_text(fields: Mapping[str, Any], *, request: bool) -> str:
    function = fields.get("function", "")
    if "Error_Decode" in fields:
        return f"{function} refused: {fields['text']}"
    if (made := _FUNCTIONS.get(function)) is not None:
        return made(fields, request)
    title = f"{function} of slot {fields['Slot_Number']}, index {fields['Index']}"
    if "Length" in fields:
        return f"{title}, {'up to' if request else 'data'} {fields['Length']}"
    record = fields.get("Parameter_Access")
    more = f": {record['text']}" if record else ""
    return f"{title}, data {len(fields['data']) // 2}{more}"
