"""Comparison of two devices by their GSD files: the wire first, modules to choose from, texts, parameters, the rest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from enum import Enum
from typing import Final, NamedTuple, TypeVar

from msgspec.structs import replace

from dpstack.errors import ConfigError
from dpstack.gsd.configuration import default_modules
from dpstack.gsd.dpv1_keywords import DpV1
from dpstack.gsd.model import Device, Diagnosis, Module, Parameter, PrmBlock, Raw, folded, ranges_text
from dpstack.gsd.prm import UserPrm, module_octets
from dpstack.gsd.settings import FIELD_KEYWORDS
from dpstack.units import baud_text

_T = TypeVar("_T")

#: fields of Device whose values count on the wire, in the order of their importance
_WIRE: Final = """
max_input_len max_output_len max_data_len max_user_prm_data_len max_diag_data_len modular max_module first_slot
fix_preset_modules min_slave_interval auto_baud sync freeze fail_safe set_slave_add isochronous isochronous_required
publisher subscriber dxb_max_link_count dxb_max_data_length
"""
_REST: Final = """
vendor model revision order_number gsd_revision hardware_release software_release station_type user_prm_data_len
"""
#: fields whose names say too little alone
_TITLES: Final = {
    "slave": "dpv1_slave",
    "required": "alarms_required",
    "publisher": "publisher_supp",
    "subscriber": "subscriber_supp",
}


class Part(Enum):
    """A part of a comparison, in the order of its importance."""

    WIRE = "on the wire"
    MODULES = "modules to choose from"
    DIAGNOSIS = "texts of the diagnosis"
    PARAMETERS = "parameters"
    REST = "the rest"


class Change(NamedTuple):
    """One difference. ``old`` or ``new`` None: only the other file has it."""

    part: Part
    what: str
    old: str | None
    new: str | None

    @property
    def text(self) -> str:
        """One line for people."""
        if self.old is None:
            return f"{self.what}: new, {self.new}"
        return f"{self.what}: gone, {self.old}" if self.new is None else f"{self.what}: {self.old} -> {self.new}"

    def as_dict(self) -> dict[str, object]:
        return {"part": self.part.name.lower(), "what": self.what, "old": self.old, "new": self.new}


def compare_devices(old: Device, new: Device) -> list[Change]:
    """The differences from ``old`` to ``new``, those on the wire first. Comments, line ends and the spelling of
    keywords and numbers in the files make none."""
    found = list(_changes(old, new))
    if not found and replace(old, settings={}) != replace(new, settings={}):
        found.append(Change(Part.REST, "order of modules, texts or parameters", "as in the first", "another one"))
    order = list(Part)
    return sorted(found, key=lambda change: order.index(change.part))


def _changes(old: Device, new: Device) -> Iterator[Change]:
    yield from _facts(Part.WIRE, _identity(old), _identity(new))
    for one, other in _pairs(old.modules, new.modules, lambda one: folded(one.name), lambda one: one.reference):
        yield from _module(old, new, one, other)
    yield from _places("", old, new, old.prm, new.prm)
    yield from _facts(Part.WIRE, _wire(old), _wire(new))
    yield from _facts(Part.MODULES, _slots(old), _slots(new))
    yield from _diagnosis("", old.diagnosis, new.diagnosis)
    for kind in sorted({one.type or 0 for one in (*old.diag_types, *new.diag_types)}):
        types = [next((one for one in device.diag_types if one.type == kind), Diagnosis()) for device in (old, new)]
        yield from _diagnosis(f"UnitDiagType {kind}, ", *types)
    for before, after in _pairs(_values(old), _values(new), lambda one: folded(one.name), lambda one: one.number):
        yield from _parameter(before, after)
    yield from _facts(Part.REST, _of(old, _REST), _of(new, _REST))
    yield from _facts(Part.REST, _others(old), _others(new))


def _facts(part: Part, old: Mapping[str, str | None], new: Mapping[str, str | None]) -> Iterator[Change]:
    """The entries that differ; None: there is no such entry."""
    for what in dict.fromkeys((*old, *new)):
        one, other = old.get(what), new.get(what)
        if one != other:
            yield Change(part, what, one, other)


def _pairs(old: Sequence[_T], new: Sequence[_T], *keys: Callable[[_T], Hashable]) -> list[tuple[_T | None, _T | None]]:
    """The entries of both that belong together by the first of ``keys``, what is left by the next one; a key of None
    pairs nothing. Those without a partner stand with None."""
    left, right = list(old), list(new)
    pairs: list[tuple[_T | None, _T | None]] = []
    for key in keys:
        waiting: dict[Hashable, list[_T]] = {}
        for other in right:
            waiting.setdefault(key(other), []).append(other)
        unpaired = []
        for one in left:
            partners = waiting.get(key(one)) if key(one) is not None else None
            if partners:
                pairs.append((one, partners.pop(0)))
            else:
                unpaired.append(one)
        paired = {id(other) for _, other in pairs}
        left, right = unpaired, [other for other in right if id(other) not in paired]
    return [*pairs, *((one, None) for one in left), *((None, other) for other in right)]


# --- on the wire ------------------------------------------------------------------------------------------------------


def _identity(device: Device) -> dict[str, str | None]:
    return {"ident number": None if device.ident is None else f"0x{device.ident:04X}"}


def _wire(device: Device) -> dict[str, str | None]:
    chosen = default_modules(device)
    config = None if chosen is None else b"".join(module.config for module in chosen)
    dpv1 = " ".join(DpV1.__struct_fields__)
    return {
        "identifier octets without the key modules": None if config is None else config.hex(" "),
        "default user parameters of the device": _user_prm(device),
        **_of(device, _WIRE),
        **{f"{baud_text(speed.baud)}": _max_tsdr(speed.max_tsdr) for speed in device.speeds},
        **_of(device.dpv1, dpv1),
    }


def _max_tsdr(bits: int | None) -> str:
    return "MaxTsdr not said" if bits is None else f"MaxTsdr {bits}"


def _user_prm(device: Device) -> str:
    try:
        return UserPrm(device).octets().hex(" ") or "none"
    except ConfigError as error:
        return f"none ({error})"


def _of(section: object, names: str) -> dict[str, str | None]:
    """Fields by name as text; None for those that say nothing."""
    return {_TITLES.get(name, name): _plain(getattr(section, name)) for name in names.split()}


def _plain(value: object) -> str | None:
    match value:
        case bool():
            return "yes" if value else "no"
        case tuple():
            return ", ".join(map(str, value)) or "none"
        case None | "":
            return None
    return str(value)


def _module(old: Device, new: Device, one: Module | None, other: Module | None) -> Iterator[Change]:
    if one is None or other is None:
        module = one or other
        assert module is not None
        octets = module.config.hex(" ")
        if one is None:
            yield Change(Part.MODULES, f"module {module.title}", None, octets)
        else:
            yield Change(Part.WIRE, f"module {module.title}", octets, None)
        return
    title = f"module {one.name!r}"
    yield from _facts(Part.WIRE, _octets_of(title, old, one), _octets_of(title, new, other))
    yield from _places(f"{title}, ", old, new, one.prm, other.prm)
    yield from _facts(Part.MODULES, _choice(title, one), _choice(title, other))
    yield from _diagnosis(f"{title}, ", one.diagnosis, other.diagnosis)
    yield from _facts(Part.REST, _raw(f"{title}, ", one.raw), _raw(f"{title}, ", other.raw))


def _octets_of(title: str, device: Device, module: Module) -> dict[str, str | None]:
    try:
        prm = module_octets(device, module).hex(" ") or "none"
    except ConfigError as error:
        prm = f"none ({error})"
    return {
        f"{title}, identifier octets": module.config.hex(" "),
        f"{title}, default user parameters": prm,
    }


def _choice(title: str, module: Module) -> dict[str, str | None]:
    return {
        f"{title}, name": " ".join(module.name.split()),
        f"{title}, reference number": _plain(module.reference),
        f"{title}, preset": _plain(module.preset),
        f"{title}, info": _plain(module.info),
        f"{title}, whole in the file": _plain(module.complete),
    }


def _slots(device: Device) -> dict[str, str | None]:
    return {
        f"slot {slot.number}": f"{slot.name!r}, default {_plain(slot.default)}, allowed {ranges_text(slot.allowed)}"
        for slot in device.slots
    }


def _places(owner: str, old: Device, new: Device, one: PrmBlock, other: PrmBlock) -> Iterator[Change]:
    """The named parameters whose octets or bits are others: the same ``parameters`` make other octets."""
    before, after = _placed(old, one), _placed(new, other)
    for what in before:
        if before[what] != after.get(what, before[what]):
            yield Change(Part.WIRE, f"{owner}place of parameter {what}", before[what], after[what])


def _placed(device: Device, prm: PrmBlock) -> dict[str, str]:
    found: dict[str, str] = {}
    for ref in prm.refs:
        parameter = device.parameters.get(ref.number)
        if parameter is not None:
            found.setdefault(repr(parameter.name), f"octet {ref.offset}, {parameter.type.text}")
    return found


# --- for people -------------------------------------------------------------------------------------------------------


def _diagnosis(owner: str, old: Diagnosis, new: Diagnosis) -> Iterator[Change]:
    yield from _facts(Part.DIAGNOSIS, _texts(owner, old), _texts(owner, new))


def _texts(owner: str, diagnosis: Diagnosis) -> dict[str, str | None]:
    found: dict[str, str | None] = {}
    for kind, first, last, value, text, more in diagnosis.texts:
        where = {
            "bit": f"bit {first}",
            "not_bit": f"bit {first} is 0",
            "area": f"bits {first} to {last} = {value}",
            "channel": f"channel error {value}",
        }[kind]
        found[f"{owner}{where}"] = f"{text!r} ({more})" if more else repr(text)
    return found


def _values(device: Device) -> list[Parameter]:
    return list(device.parameters.values())


def _parameter(old: Parameter | None, new: Parameter | None) -> Iterator[Change]:
    known = old or new
    assert known is not None
    title = f"parameter {known.name!r}"
    if old is None or new is None:
        text = f"{known.type.text}, default {known.texts.get(known.default, known.default)}"
        yield Change(Part.PARAMETERS, title, text if new is None else None, None if new is None else text)
        return
    yield from _facts(Part.PARAMETERS, _parameter_facts(title, old), _parameter_facts(title, new))


def _parameter_facts(title: str, one: Parameter) -> dict[str, str | None]:
    return {
        f"{title}, name": one.name,
        f"{title}, type": one.type.text,
        f"{title}, default": str(one.default),
        f"{title}, allowed": ranges_text(one.allowed) or "all of its type",
        **{f"{title}, text of {value}": repr(text) for value, text in one.choices.items()},
        f"{title}, changeable": _plain(one.changeable),
        f"{title}, visible": _plain(one.visible),
    }


def _others(device: Device) -> dict[str, str | None]:
    """Keywords and blocks that dpstack does not use."""
    unused = {word: value for word, value in device.settings.items() if word not in FIELD_KEYWORDS}
    return {**unused, **_raw("", device.raw)}


def _raw(owner: str, statements: Sequence[Raw]) -> dict[str, str | None]:
    """Statements by block and keyword; several with the same ones are numbered."""
    counts: Counter[str] = Counter()
    found: dict[str, str | None] = {}
    for one in statements:
        index = "" if one.index is None else f"({one.index})"
        what = f"{owner}{one.block}{one.block and ' '}{one.keyword}{index}"
        counts[what] += 1
        found[what if counts[what] == 1 else f"{what} no. {counts[what]}"] = one.value or "there"
    return found
