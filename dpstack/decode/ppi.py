"""PDUs of an S7-200 in PPI telegrams explained: what a master asks, and what the CPU answers, as fields and in words.

PPI is SRD without SAPs, as Data_Exchange is: a data unit counts as a PDU if its header fits its length, and a station
without parameters or configuration of a DP slave has it. Codes: docs/reference/decisions/ppi.md.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

from dpstack.decode.fields import Fields
from dpstack.errors import PduError
from dpstack.ppi.addresses import AREAS, BIT, BYTE, ELEMENT_LENGTH, WORD
from dpstack.ppi.pdu import (
    ACKNOWLEDGEMENT,
    ANSWER,
    NEGOTIATE,
    READ,
    REQUEST,
    RUN,
    STOP,
    USER_DATA,
    WRITE,
    CpuPdu,
    Item,
    is_clock_order,
    item_error,
    items_of_data,
    parse_clock,
    parse_items,
    parse_pdu,
    pdu_error,
)
from dpstack.text import some_of

_KINDS: Final = {REQUEST: "request", ACKNOWLEDGEMENT: "acknowledgement", ANSWER: "answer", USER_DATA: "user data"}
_FUNCTIONS: Final = {READ: "read", WRITE: "write", RUN: "go to RUN", STOP: "go to STOP", NEGOTIATE: "PDU length"}
_AREAS: Final = {area.code: area for area in AREAS.values()}
_GOOD: Final = 0xFF
_SIZES: Final = {1: "B", 2: "W", 4: "D"}
#: items in the words of one telegram
_SHOWN: Final = 8
#: octets of a value that are shown in words
_MOST_OCTETS: Final = 16
#: a number that a program may have meant as a real is within these
_SMALLEST, _LARGEST = 1e-6, 1e9


def pdu_of(data: bytes) -> CpuPdu | None:
    """The PDU of a data unit; None for other octets."""
    try:
        pdu = parse_pdu(data)
    except PduError:
        return None
    says_something = pdu.parameter or pdu.error or pdu.kind == ACKNOWLEDGEMENT
    return pdu if pdu.kind in _KINDS and not any(data[2:4]) and says_something else None


class PpiTalks:
    """The requests to the CPUs of a bus whose answers are due: an answer has values, its request their addresses."""

    def __init__(self) -> None:
        self._asked: dict[tuple[int, int], CpuPdu] = {}

    def is_asked(self, cpu: int, master: int) -> bool:
        """Whether ``master`` has sent a PDU to the station ``cpu``."""
        return (cpu, master) in self._asked

    def fields(self, pdu: CpuPdu, cpu: int, master: int, *, request: bool) -> Fields:
        """The fields of a PDU; ``text``: its words."""
        asked = None
        if request:
            self._asked[cpu, master] = pdu
        elif (last := self._asked.get((cpu, master))) is not None and last.sequence == pdu.sequence:
            asked = last
        found: Fields = {"PPI_PDU": _KINDS[pdu.kind], "Sequence": pdu.sequence}
        function = pdu.parameter[0] if pdu.parameter and pdu.kind != USER_DATA else None
        if function is not None:
            found["function"] = _FUNCTIONS.get(function, f"0x{function:02x}")
        if pdu.error:
            return found | {"error": pdu_error(pdu.error), "text": f"refused: {pdu_error(pdu.error)}"}
        if pdu.kind == USER_DATA:
            return found | {"text": _user_data(pdu, request=request)}
        explain = _REQUESTS.get(function) if request else _ANSWERS.get(function)
        try:
            more = None if explain is None else explain(pdu, asked)
        except (PduError, struct.error):
            more = {"text": f"{found['function']}, damaged: {pdu.octets.hex(' ')}"}
        if more is None:
            more = {"text": "done" if pdu.kind == ACKNOWLEDGEMENT else f"function {found.get('function', 'unknown')}"}
        return found | more


def _read_asked(pdu: CpuPdu, asked: CpuPdu | None) -> Fields:
    names = [address_text(item) for item in parse_items(pdu.parameter)]
    return {"items": [{"address": name} for name in names], "text": f"read {some_of(names, _SHOWN)}"}


def _write_asked(pdu: CpuPdu, asked: CpuPdu | None) -> Fields:
    items = _valued(parse_items(pdu.parameter), pdu.data, codes=False)
    return {"items": items, "text": f"write {_in_words(items)}"}


def _read_answered(pdu: CpuPdu, asked: CpuPdu | None) -> Fields:
    items = _valued(_asked_items(asked, READ, pdu), pdu.data)
    return {"items": items, "text": _in_words(items)}


def _write_answered(pdu: CpuPdu, asked: CpuPdu | None) -> Fields:
    items = _asked_items(asked, WRITE, pdu)
    if len(items) != len(pdu.data):
        raise PduError(f"{len(pdu.data)} return codes for {len(items)} items")
    found: list[Fields] = []
    for item, code in zip(items, pdu.data, strict=True):
        found.append(_named(item) | ({"done": True} if code == _GOOD else {"error": item_error(code)}))
    return {"items": found, "text": _in_words(found)}


def _length_asked(pdu: CpuPdu, asked: CpuPdu | None) -> Fields:
    return {"PDU_Length": _length(pdu), "text": f"PDUs of up to {_length(pdu)} octets?"}


def _length_answered(pdu: CpuPdu, asked: CpuPdu | None) -> Fields:
    return {"PDU_Length": _length(pdu), "text": f"PDUs of up to {_length(pdu)} octets"}


def _length(pdu: CpuPdu) -> int:
    if len(pdu.parameter) != 8:
        raise PduError(f"a parameter of {len(pdu.parameter)} octets, not 8")
    return int.from_bytes(pdu.parameter[6:], "big")


def _mode(pdu: CpuPdu, asked: CpuPdu | None) -> Fields:
    wanted = (asked or pdu).parameter[0]
    text = _FUNCTIONS.get(wanted, "")
    return {"text": text if pdu.kind == REQUEST else f"{text}: done"}


Explain = Callable[[CpuPdu, CpuPdu | None], Fields]
_REQUESTS: Final[Mapping[int | None, Explain]] = {
    READ: _read_asked,
    WRITE: _write_asked,
    RUN: _mode,
    STOP: _mode,
    NEGOTIATE: _length_asked,
}
_ANSWERS: Final[Mapping[int | None, Explain]] = {
    READ: _read_answered,
    WRITE: _write_answered,
    RUN: _mode,
    STOP: _mode,
    NEGOTIATE: _length_answered,
}


def _user_data(pdu: CpuPdu, *, request: bool) -> str:
    """The clock, or the octets."""
    order = is_clock_order(pdu)
    if order is None:
        return f"parameter {pdu.parameter.hex(' ')}, data {pdu.data.hex(' ') or 'none'}"
    error = int.from_bytes(pdu.parameter[10:12], "big")
    if error:
        return f"clock: refused: {pdu_error(error)}"
    text = "set the clock" if order == "set" else "read the clock"
    if len(pdu.data) >= 14:
        try:
            return f"{text}{' to' if request else ':'} {parse_clock(pdu.data[4:14]):%Y-%m-%d %H:%M:%S.%f}"[:-3]
        except PduError as error_in_it:
            return f"{text}: {error_in_it}"
    return text if request else f"{text}: done"


# --- items ----------------------------------------------------------------------------------------------------------
def address_text(item: Item) -> str:
    """An address as STEP 7-Micro/WIN writes it; the number of octets says whether it is a byte, a word or a double
    word: ``VW100``, ``VB0[16]``, ``M0.3``, ``T37``."""
    area = _AREAS.get(item.area)
    if area is None or item.block != area.block or item.size not in (BIT, BYTE, WORD, item.area):
        where = f"area 0x{item.area:02x}, block {item.block}, bit {item.start}"
        return f"{where}, {item.count} of size 0x{item.size:02x}"
    many = f"[{item.count}]" if item.count != 1 else ""
    if area.name in ELEMENT_LENGTH:
        return f"{area.name}{item.start}{many}"
    at, bit = divmod(item.start, 8)
    if item.size == BIT:
        return f"{area.name}{at}.{bit}{many}"
    if item.size == WORD:
        return f"{area.name}W{at}{many}"
    size = _SIZES.get(item.count)
    return f"{area.name}{size}{at}" if size else f"{area.name}B{at}{many}"


def _named(item: Item | None) -> Fields:
    return {} if item is None else {"address": address_text(item)}


def _asked_items(asked: CpuPdu | None, function: int, pdu: CpuPdu) -> Sequence[Item | None]:
    """The items of the request, as many as the answer says; None if the request was not heard."""
    count = pdu.parameter[1] if len(pdu.parameter) > 1 else 0
    if asked is not None and asked.parameter[:1] == bytes((function,)):
        items = parse_items(asked.parameter)
        if len(items) == count:
            return items
    return [None] * count


def _valued(items: Sequence[Item | None], data: bytes, *, codes: bool = True) -> list[Fields]:
    """Each item with its value. ``codes``: the data are those of an answer, with a return code each."""
    found = []
    for item, (code, octets) in zip(items, items_of_data(data, len(items)), strict=True):
        if codes and code != _GOOD:
            found.append(_named(item) | {"error": item_error(code)})
        else:
            found.append(_named(item) | {"octets": octets.hex()} | _value(item, octets))
    return found


def _value(item: Item | None, octets: bytes) -> Fields:
    """The number in ``octets``, as far as the item says how to read it."""
    if item is None or not octets:
        return {}
    area = _AREAS.get(item.area)
    if item.size == BIT:
        return {"value": bool(octets[0] & 1)}
    if area is not None and (length := ELEMENT_LENGTH.get(area.name)) is not None:
        # an element begins with a status
        values = [int.from_bytes(octets[at + 1 : at + length], "big") for at in range(0, len(octets), length)]
        return {"value": values[0] if len(values) == 1 else values}
    if len(octets) in _SIZES:
        signed = area is not None and area.name in ("AI", "AQ")
        return {"value": int.from_bytes(octets, "big", signed=signed)}
    return {}


def _in_words(items: Sequence[Fields]) -> str:
    return some_of(_item_words(items), _SHOWN)


def _item_words(items: Sequence[Fields]) -> Iterator[str]:
    for number, one in enumerate(items, 1):
        name = str(one.get("address", f"item {number}"))
        if "error" in one:
            yield f"{name} refused: {one['error']}"
        elif "done" in one:
            yield f"{name} written"
        else:
            yield f"{name} = {_value_words(one)}"


def _value_words(one: Fields) -> str:
    octets, value = bytes.fromhex(str(one["octets"])), one.get("value")
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, int):
        return f"{value}{_as_real(octets)}"
    if isinstance(value, list):
        return ", ".join(map(str, value))
    shown = octets[:_MOST_OCTETS].hex(" ")
    return f"{shown} ... ({len(octets)})" if len(octets) > _MOST_OCTETS else shown or "nothing"


def _as_real(octets: bytes) -> str:
    """Four octets may be a real: no telegram says so."""
    if len(octets) != 4:
        return ""
    (real,) = struct.unpack(">f", octets)
    return f" (real {real:g})" if math.isfinite(real) and _SMALLEST <= abs(real) <= _LARGEST else ""
