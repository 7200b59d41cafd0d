"""PDUs of an S7-200 in PPI telegrams explained: what a master asks, and what the CPU answers, as fields and in words.

PPI is SRD without SAPs, as Data_Exchange is: a data unit counts as a PDU if its header fits its length, and a station
without parameters or configuration of a DP slave has it. Codes: docs/reference/decisions/ppi.md.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

from dpstack.decode.fields import Fields
from dpstack.decode.names import CpuNames
from dpstack.dp.field_map import as_json
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

if TYPE_CHECKING:
    from dpstack.dp.process_data import Field
    from dpstack.dp.process_image import Value

_KINDS: Final = {REQUEST: "request", ACKNOWLEDGEMENT: "acknowledgement", ANSWER: "answer", USER_DATA: "user data"}
_FUNCTIONS: Final = {READ: "read", WRITE: "write", RUN: "go to RUN", STOP: "go to STOP", NEGOTIATE: "PDU length"}
_AREAS: Final = {area.code: area for area in AREAS.values()}
_GOOD: Final = 0xFF
_SIZES: Final = {1: "B", 2: "W", 4: "D"}
#: items in the words of one telegram
_SHOWN: Final = 8
#: items whose named values are kept
_KEPT_ITEMS: Final = 1024
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


class _Part(NamedTuple):
    """A named value in an item: its octets from ``begin`` on; ``bit`` of the first, -1 for whole octets."""

    name: str
    begin: int
    bit: int


class ValueNames:
    """Finds the named values of one CPU in the items of its telegrams, also those within octets that are read as
    one."""

    def __init__(self, names: CpuNames) -> None:
        self._values = names.values
        self._kept: dict[Item, tuple[_Part, ...]] = {}  # polls repeat their items

    def parts(self, item: Item) -> tuple[_Part, ...]:
        """The named values that lie in ``item``."""
        if not self._values:
            return ()
        found = self._kept.get(item)
        if found is None:
            if len(self._kept) >= _KEPT_ITEMS:
                self._kept.clear()
            found = self._kept[item] = tuple(self._within(item))
        return found

    def _within(self, item: Item) -> Iterator[_Part]:
        for name, value in self._values.items():
            address = value.address
            if (address.area.code, address.area.block) != (item.area, item.block):
                continue
            if item.size in (BIT, item.area):
                element = ELEMENT_LENGTH.get(address.area.name, 1)
                at = address.start - item.start
                if address.size == item.size and 0 <= at < item.count:
                    yield _Part(name, at * element, -1 if item.size == item.area else 0)
                continue
            octets = item.count * (2 if item.size == WORD else 1)
            at, bit = divmod(address.start - item.start, 8)
            if at >= 0 and at + address.length <= octets and (bit == 0 or address.size == BIT):
                yield _Part(name, at, bit if address.size == BIT else -1)

    def values(self, item: Item, octets: bytes) -> dict[str, tuple[Value, Field]]:
        """The values in the octets of ``item``, with their fields; those whose octets are missing are left out."""
        found = {}
        for name, begin, bit in self.parts(item):
            named = self._values[name]
            own = octets[begin : begin + named.address.length]
            try:
                found[name] = named.read(own if bit < 0 else bytes((own[0] >> bit & 1,))), named.field
            except (PduError, IndexError):  # fewer octets than the request asked for
                continue
        return found


_NAMELESS: Final = ValueNames(CpuNames("", {}))


def alone_fields(data: bytes, *, request: bool) -> Fields:
    """The fields of the PDU in a data unit of which nothing else is known; empty for other octets."""
    pdu = pdu_of(data)
    return {} if pdu is None else PpiTalks().fields(pdu, 0, 0, request=request)


class PpiTalks:
    """The requests to the CPUs of a bus whose answers are due: an answer has values, its request their addresses.
    ``cpus``: names by address."""

    def __init__(self, cpus: Mapping[int, CpuNames] = {}) -> None:
        self._asked: dict[tuple[int, int], CpuPdu] = {}
        self._names = {address: ValueNames(names) for address, names in cpus.items()}

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
            more = None if explain is None else explain(pdu, asked, self._names.get(cpu, _NAMELESS))
        except (PduError, struct.error):
            more = {"text": f"{found['function']}, damaged: {pdu.octets.hex(' ')}"}
        if more is None:
            more = {"text": "done" if pdu.kind == ACKNOWLEDGEMENT else f"function {found.get('function', 'unknown')}"}
        return found | more


def _read_asked(pdu: CpuPdu, asked: CpuPdu | None, names: ValueNames) -> Fields:
    items = [_named(item, names) for item in parse_items(pdu.parameter)]
    return {"items": items, "text": f"read {some_of(map(_label, items), _SHOWN)}"}


def _write_asked(pdu: CpuPdu, asked: CpuPdu | None, names: ValueNames) -> Fields:
    items, texts = _valued(parse_items(pdu.parameter), pdu.data, names, codes=False)
    return {"items": items, "text": f"write {some_of(texts, _SHOWN)}"}


def _read_answered(pdu: CpuPdu, asked: CpuPdu | None, names: ValueNames) -> Fields:
    items, texts = _valued(_asked_items(asked, READ, pdu), pdu.data, names)
    return {"items": items, "text": some_of(texts, _SHOWN)}


def _write_answered(pdu: CpuPdu, asked: CpuPdu | None, names: ValueNames) -> Fields:
    items = _asked_items(asked, WRITE, pdu)
    if len(items) != len(pdu.data):
        raise PduError(f"{len(pdu.data)} return codes for {len(items)} items")
    found: list[Fields] = []
    texts = []
    for number, (item, code) in enumerate(zip(items, pdu.data, strict=True), 1):
        one = _named(item, names)
        if code == _GOOD:
            found.append(one | {"done": True})
            texts.append(f"{_label(one, number)} written")
        else:
            found.append(one | {"error": item_error(code)})
            texts.append(_refused(one, number, code))
    return {"items": found, "text": some_of(texts, _SHOWN)}


def _length_asked(pdu: CpuPdu, asked: CpuPdu | None, names: ValueNames) -> Fields:
    return {"PDU_Length": _length(pdu), "text": f"PDUs of up to {_length(pdu)} octets?"}


def _length_answered(pdu: CpuPdu, asked: CpuPdu | None, names: ValueNames) -> Fields:
    return {"PDU_Length": _length(pdu), "text": f"PDUs of up to {_length(pdu)} octets"}


def _length(pdu: CpuPdu) -> int:
    if len(pdu.parameter) != 8:
        raise PduError(f"a parameter of {len(pdu.parameter)} octets, not 8")
    return int.from_bytes(pdu.parameter[6:], "big")


def _mode(pdu: CpuPdu, asked: CpuPdu | None, names: ValueNames) -> Fields:
    wanted = ((asked and asked.parameter) or pdu.parameter)[0]
    text = _FUNCTIONS.get(wanted, "")
    return {"text": text if pdu.kind == REQUEST else f"{text}: done"}


Explain = Callable[[CpuPdu, CpuPdu | None, ValueNames], Fields]
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


def _named(item: Item | None, names: ValueNames) -> Fields:
    """The address of an item, and the names of the values in it."""
    if item is None:
        return {}
    found = [part.name for part in names.parts(item)]
    return {"address": address_text(item)} | ({"names": found} if found else {})


def _label(one: Fields, number: int = 0) -> str:
    """The item ``number`` of a telegram for people: ``VW100 (level)``."""
    address = str(one.get("address", f"item {number}"))
    names = one.get("names")
    return f"{address} ({some_of(names, _SHOWN)})" if isinstance(names, list) else address


def _refused(one: Fields, number: int, code: int) -> str:
    return f"{_label(one, number)} refused: {item_error(code)}"


def _asked_items(asked: CpuPdu | None, function: int, pdu: CpuPdu) -> Sequence[Item | None]:
    """The items of the request, as many as the answer says; None if the request was not heard."""
    count = pdu.parameter[1] if len(pdu.parameter) > 1 else 0
    if asked is not None and asked.parameter[:1] == bytes((function,)):
        items = parse_items(asked.parameter)
        if len(items) == count:
            return items
    return [None] * count


def _valued(
    items: Sequence[Item | None], data: bytes, names: ValueNames, *, codes: bool = True
) -> tuple[list[Fields], list[str]]:
    """Each item with its value, and in words. ``codes``: the data are those of an answer, with a return code each."""
    found: list[Fields] = []
    texts: list[str] = []
    for number, (item, (code, octets)) in enumerate(zip(items, items_of_data(data, len(items)), strict=True), 1):
        one = _named(item, names)
        if codes and code != _GOOD:
            found.append(one | {"error": item_error(code)})
            texts.append(_refused(one, number, code))
            continue
        value = _value(item, octets)
        named = {} if item is None else names.values(item, octets)
        if named:
            del one["names"]
            one["values"] = as_json({name: read for name, (read, _) in named.items()})
        found.append(one | {"octets": octets.hex()} | value)
        texts.append(f"{_label(one, number)} = {_value_words(octets, value.get('value'))}{_named_words(named)}")
    return found, texts


def _named_words(named: Mapping[str, tuple[Value, Field]]) -> str:
    """The named values behind the plain one: ``; level 25.0 cm``."""
    if not named:
        return ""
    return f" ({some_of((f'{name} = {_scaled_words(*one)}' for name, one in named.items()), _SHOWN)})"


def _scaled_words(value: Value, field: Field) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, bytes):
        return _octets_words(value)
    word = field.words.get(int(value)) if field.words else None
    number = f"{value:g}" if isinstance(value, float) else str(value)
    return (f"{word} ({number})" if word is not None else number) + (f" {field.unit}" if field.unit else "")


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


def _value_words(octets: bytes, value: object) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, int):
        return f"{value}{_as_real(octets)}"
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return _octets_words(octets)


def _octets_words(octets: bytes) -> str:
    shown = octets[:_MOST_OCTETS].hex(" ")
    return f"{shown} ... ({len(octets)})" if len(octets) > _MOST_OCTETS else shown or "nothing"


def _as_real(octets: bytes) -> str:
    """Four octets may be a real: no telegram says so."""
    if len(octets) != 4:
        return ""
    (real,) = struct.unpack(">f", octets)
    return f" (real {real:g})" if math.isfinite(real) and _SMALLEST <= abs(real) <= _LARGEST else ""
