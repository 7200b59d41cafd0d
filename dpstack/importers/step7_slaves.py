"""From an exported DP slave to its [[slave]] table, with and without a GSD file.

The export has ident number, identifier octets and user parameters of a slave with a GSD file. Of Siemens' own slaves it
has order numbers and addresses only.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from msgspec import Struct, structs

from dpstack.dp.slot_map import Direction, Slot, map_of_modules
from dpstack.errors import ConfigError, GsdError
from dpstack.gsd.configuration import configure, find_module
from dpstack.gsd.identifiers import MAX_IO, io_lengths
from dpstack.gsd.model import Device, Module
from dpstack.importers.step7_cfg import Remark, Section
from dpstack.importers.step7_layout import OctetsOf, Place, octets_alone, places, section_title
from dpstack.text import runs_of, some_of

_GSD_NAME: Final = re.compile(r"[^\\/]+\.gs[a-z]", re.IGNORECASE)
#: parameters that each F module has, in files of STEP 7 and of GSD files
_F_PARAMETERS: Final = re.compile(r"F_(?:DEST_ADD|WD_TIME|PAR_CRC|PAR_VERSION|SOURCE_ADD)")
#: F modules of S7-300 and ET 200S, in a copy without parameters
_F_ORDERS: Final = re.compile(r"6ES7\s*(?:[13][23]6-|138-4[CF]F|138-4F|138-7F)")
#: names of fields (docs/reference/configuration.md#names-for-process-data)
_NO_NAME: Final = re.compile(r"[^\w -]")
_NO_FIRST: Final = re.compile(r"[\W\d]")
#: octets that one identifier of the special format can have
_MOST_OCTETS: Final = 64
_GROUPS: Final = range(1, 9)
#: DPV1_Enable and Fail_Safe in DPV1_Status_1, the first octet of the user parameters then
_DPV1_FAIL_SAFE: Final = 0xC0
_MOST_GROUPS: Final = 255


class Found(Struct, frozen=True):
    """A GSD file: its name in a configuration, and its device."""

    key: str
    device: Device


class GsdFinder(Protocol):
    """The GSD files that the user has."""

    def named(self, name: str, ident: int | None) -> Sequence[Found]:
        """Those with that file name, then those with that ident number."""

    def with_order(self, number: str) -> Sequence[Found]:
        """Those that name the order number ``number`` in front of their modules."""


@dataclass(slots=True)
class ExportedSlave:
    """The sections of one slave. ``address`` on the bus that is imported."""

    address: int
    head: Section
    slots: list[Section] = field(default_factory=list)


@dataclass(slots=True)
class Variant:
    """One way to write a slave: the keys of its table and the places of its symbols.

    ``source``: for people, where ident number and identifier octets come from.
    """

    keys: dict[str, object]
    source: str
    #: whether its GSD file says that it has F modules
    has_f: bool = False
    #: False: its identifier octets only have the right lengths
    octets_known: bool = True
    #: why only an F-host may be its master; empty without F modules
    f_modules: str = ""
    slots: list[str] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)
    remarks: list[Remark] = field(default_factory=list)


def slave_variants(slave: ExportedSlave, finder: GsdFinder | None) -> tuple[list[Variant], list[Remark]]:
    """The ways to write ``slave``, the best one first, and remarks that all of them share."""
    remarks = list(_of_head(slave))
    variants: list[Variant] = []
    rest = _common_keys(slave, remarks)
    for variant in _variants(slave, finder, remarks):
        variant.f_modules = _f_modules(slave, variant)
        reasons = [variant.f_modules, str(variant.keys.pop("refuse_master", ""))]
        variant.keys |= {**rest, "refuse_master": "; ".join(filter(None, reasons)) or None}
        variants.append(variant)
    return variants, remarks


def _common_keys(slave: ExportedSlave, remarks: list[Remark]) -> dict[str, object]:
    given = slave.head.keys.get("GROUP_IDENT", "0")
    mask = int(given) if given.isascii() and given.isdigit() and len(given) < 4 else 0
    if not 0 <= mask <= _MOST_GROUPS:
        remarks.append(Remark(slave.head.line, f"{section_title(slave.head)}: GROUP_IDENT {given} names no groups"))
        mask = 0
    groups = [group for group in _GROUPS if mask >> (group - 1) & 1]
    return {"groups": groups or None}


def _of_head(slave: ExportedSlave) -> Iterator[Remark]:
    title, line = section_title(slave.head), slave.head.line
    if any(option.split()[0] == "REDUNDANT" for option in slave.head.options):
        yield Remark(line, f"{title}: it has two interfaces, one on each bus of a redundant PLC; this bus has one")
    subs = [section for section in slave.slots if section.place("SUBSLOT") is not None]
    used = [section for section in subs if section.symbols or any(area.octets for area in section.areas)]
    for section in used:
        parts = ", ".join((*_ranges(section), *(symbol.name for symbol in section.symbols)))
        text = f"{section_title(section)}: a SUBSLOT is left out: {parts}"
        if any(area.octets for area in section.areas):
            text += "; names of the slots behind it may have wrong places: compare one with the PLC"
        yield Remark(section.line, text)
    slave.slots = [section for section in slave.slots if section not in subs]
    numbers = [section.places["SLOT"] for section in slave.slots]
    for number in sorted({number for number in numbers if numbers.count(number) > 1}):
        yield Remark(line, f"{title}: slot {number} stands twice; the first one counts")
    first = dict(zip(reversed(numbers), reversed(slave.slots), strict=True))
    slave.slots = [first[number] for number in sorted(first)]


def _variants(slave: ExportedSlave, finder: GsdFinder | None, remarks: list[Remark]) -> Iterator[Variant]:
    head = slave.head
    name = _GSD_NAME.search(head.text(0))
    ident = _number(head.keys.get("PNO_IDENT_NO"))
    of_octets = None
    if name is not None or ident:
        if config := _exported_config(slave, remarks):
            of_octets = _of_octets(slave, ident, config, remarks)
        found = [] if finder is None else finder.named(name[0] if name else head.text(0), ident or None)
        for one in found[:1]:
            try:
                yield _of_gsd(slave, one, ident, None if of_octets is None else bytes.fromhex(config), of_octets)
            except ConfigError as error:
                remarks.append(Remark(head.line, f"{section_title(head)}: {one.key} does not fit: {error}"))
        if finder is not None and not found:
            remarks.append(Remark(head.line, f"{section_title(head)}: no GSD file of that name or ident number"))
        if of_octets is not None:
            yield of_octets
            return
    else:
        yield from _own_by_order(slave, finder, remarks)
    yield _of_lengths(slave)


def _number(text: str | None) -> int:
    return int(text) if text and text.isascii() and text.isdigit() and int(text) <= 0xFFFF else 0


def _exported_config(slave: ExportedSlave, remarks: list[Remark]) -> str:
    """Identifier octets of all slots in hex; empty if the export does not have them. A missing number is an empty
    slot."""
    parts: list[str] = []
    number = None
    for section in slave.slots:
        octets = _octets(section, "SLAVE_CFG_DATA", remarks)
        if octets is None:
            return ""
        place = section.places["SLOT"]
        if number is not None and place - number > MAX_IO:
            text = f"slot {place} behind slot {number}: no slave has so many slots"
            remarks.append(Remark(section.line, f"{section_title(section)}: {text}"))
            return ""
        parts += ["00"] * (0 if number is None else place - number - 1)
        parts.append(octets.hex())
        number = place
    return "".join(parts)


def _octets(section: Section, key: str, remarks: list[Remark]) -> bytes | None:
    """The octets of ``key``: their number in two octets, low octet first, then the octets; None if they are missing or
    the number is wrong."""
    text = section.keys.get(key)
    if not text:
        return None
    try:
        octets = bytes.fromhex(text)
    except ValueError:
        octets = b""
    if len(octets) < 2 or int.from_bytes(octets[:2], "little") != len(octets) - 2:
        remarks.append(Remark(section.line, f"{section_title(section)}: {key} is not its length and so many octets"))
        return None
    return octets[2:]


def _of_octets(slave: ExportedSlave, ident: int, config: str, remarks: list[Remark]) -> Variant:
    prm = _octets(slave.head, "NORMSLAVE_PARAM_DATA", remarks)
    keys: dict[str, object] = {"ident": ident or "ask", "config": bytes.fromhex(config), "user_prm": prm or None}
    if prm and prm[0] & _DPV1_FAIL_SAFE == _DPV1_FAIL_SAFE:
        keys["fail_safe"] = True  # else dpstack takes the bit out
    made = Variant(keys, "ident number, identifier octets and user parameters as in the export; no GSD file")
    numbers = range(slave.slots[0].places["SLOT"], slave.slots[-1].places["SLOT"] + 1)
    by_number = {section.places["SLOT"]: section for section in slave.slots}
    rows = [
        (by_number.get(number), _octets(by_number[number], "SLAVE_CFG_DATA", []) if number in by_number else b"\0")
        for number in numbers
    ]
    _lay_out(made, [(section, section.text(0) if section else "", octets or b"") for section, octets in rows])
    return made


def _of_gsd(slave: ExportedSlave, found: Found, ident: int, config: bytes | None, octets: Variant | None) -> Variant:
    """By the GSD file of the slave. Raises ConfigError if it does not say what the export says."""
    device = found.device
    if ident and device.ident is not None and device.ident != ident:
        raise GsdError(f"its Ident_Number is 0x{device.ident:04X}, the export says 0x{ident:04X}")
    modules = [_module_of(device, section, config is None) for section in slave.slots]
    names = [_entry(device, module) for module in modules]
    made = configure(device, names or None, own_prm=True)
    if config is not None and made.config != config:
        raise GsdError("its modules of these names have other identifier octets than the export")
    prm = None if octets is None else octets.keys["user_prm"]
    with_prm = None
    if prm is not None:
        try:
            with_prm = None if made.user_prm().octets() == prm else prm
        except GsdError:
            with_prm = prm
    keys: dict[str, object] = {
        "gsd": found.key,
        "modules": names or None,
        "ident": None if device.ident else ident or "ask",
        "user_prm": with_prm,
    }
    variant = Variant(keys, f"by {found.key}", _has_f(device, modules))
    if with_prm is not None:
        variant.source += ", user parameters as in the export (others than the defaults of the file)"
    behind = len(made.modules) - len(modules)  # fixed presets that the export does not list
    sections = [None] * behind + list(slave.slots)
    _lay_out(variant, [_row(section, module) for section, module in zip(sections, made.modules, strict=True)])
    return variant


def _has_f(device: Device, modules: Sequence[Module]) -> bool:
    return device.f_parameters or any(module.f_parameters for module in modules)


def _row(section: Section | None, module: Module | None) -> tuple[Section | None, str, bytes]:
    return (section, "", b"\0") if module is None else (section, module.name, module.config)


def _module_of(device: Device, section: Section, by_name_only: bool) -> Module:
    """The module of ``section``: the one with its name and, if the export has them, its identifier octets, else the
    one with its reference number. Raises GsdError."""
    config = None if by_name_only else _octets(section, "SLAVE_CFG_DATA", [])
    for module in device.modules_named(section.text(0)):
        if module.complete and config in (None, module.config):
            return module
    reference = _number(section.keys.get("NORMMODULE_REFERENCE"))
    numbered = device.module_numbered(reference) if reference else None
    if numbered is not None and numbered.complete and config in (None, numbered.config):
        return numbered
    return find_module(device, section.text(0))


def _entry(device: Device, module: Module) -> int | str:
    """The entry of ``modules`` for ``module``: its name if that stands for it alone, else its reference number."""
    try:
        if find_module(device, module.name) == module or module.reference is None:
            return module.name
    except GsdError:
        if module.reference is None:
            raise
    return module.reference


# --- Siemens' own slaves ----------------------------------------------------------------------------------------------


def _own_by_order(slave: ExportedSlave, finder: GsdFinder | None, remarks: list[Remark]) -> Iterator[Variant]:
    head = slave.head
    if finder is None:
        return
    order = head.text(0).rpartition(":")[2].strip()  # PAYLINK:6ES7 153-2BA70
    for one in () if order.startswith("_") else finder.with_order(order):
        try:
            yield _own_of_gsd(slave, one)
        except ConfigError as error:
            remarks.append(Remark(head.line, f"{section_title(head)}: {one.key} does not fit: {error}"))
        else:
            return


def _own_of_gsd(slave: ExportedSlave, found: Found) -> Variant:
    """A slave of Siemens' own with the modules of a GSD file that have its order numbers. Raises ConfigError."""
    device = found.device
    used: list[Section] = []
    modules: list[Module] = []
    alone = {section.line: (ins, outs) for section, ins, outs in octets_alone(slave.slots)}
    for section in slave.slots:
        module = _by_order(device, section, alone.get(section.line, (0, 0)))
        if module is None and any(area.octets for area in section.areas):
            raise GsdError(f"it has no module {section.text(0)} (slot {section.place('SLOT')})")
        if module is not None and section.text(0) != slave.head.text(0):
            used.append(section)
            modules.append(module)
    names = [_entry(device, module) for module in modules]
    made = configure(device, names if names else None)
    fixed = len(made.modules) - len(modules)
    keys: dict[str, object] = {"gsd": found.key, "modules": names or None, "ident": None if device.ident else "ask"}
    variant = Variant(keys, f"by order number: {found.key}", _has_f(device, modules))
    variant.remarks.append(
        Remark(
            slave.head.line,
            f"{section_title(slave.head)}: by its order number {found.key}; STEP 7 may send other octets to its own "
            f"slaves than this file makes: compare Set_Prm and Chk_Cfg of the PLC (dpstack decode)",
        )
    )
    sections = [None] * fixed + used if names else [None] * len(made.modules)
    _lay_out(variant, [_row(section, m) for section, m in zip(sections, made.modules, strict=True)], own=True)
    return variant


def _by_order(device: Device, section: Section, wanted: tuple[int, int]) -> Module | None:
    """The module with the order number of ``section`` and ``wanted`` octets of inputs and outputs; else any with that
    number, unless the octet of another module has the bits of this one."""
    order = bare_order(section.text(0))
    named = [
        module for module in device.modules if module.complete and bare_order(module.name).lstrip("*").startswith(order)
    ]
    if not order or not named:
        return None
    fitting = next((module for module in named if _lengths(module) == wanted), None)
    packed = wanted == (0, 0) and any(area.octets for area in section.areas)
    return fitting if packed else fitting or named[0]


def _lengths(module: Module) -> tuple[int, int]:
    try:
        return io_lengths(module.config)
    except ConfigError:
        return -1, -1


def bare_order(text: str) -> str:
    """An order number without blanks, in capitals."""
    return "".join(text.split()).upper()


def _of_lengths(slave: ExportedSlave) -> Variant:
    """With identifier octets that only have the right lengths: names for listening, nothing to send."""
    rows = [
        (section, " ".join(section.texts), _identifiers(ins, outs) or b"\0")
        for section, ins, outs in octets_alone(slave.slots)
    ]
    config = b"".join(octets for _, _, octets in rows) or b"\0"
    reason = "its identifier octets here have the right lengths only: they are not in the export"
    keys: dict[str, object] = {"ident": "ask", "config": config, "refuse_master": reason}
    source = "lengths by its addresses; ident number and identifier octets are not in the export"
    made = Variant(keys, source, octets_known=False)
    _lay_out(made, rows, own=True)
    return made


def _identifiers(inputs: int, outputs: int) -> bytes:
    """Identifier octets for so many octets, of unknown widths: consistent as a whole."""
    made = b""
    while inputs or outputs:
        outs, ins = min(outputs, _MOST_OCTETS), min(inputs, _MOST_OCTETS)
        lengths = bytes(0x80 | count - 1 for count in (outs, ins) if count)
        made += bytes((0x80 * bool(outs) | 0x40 * bool(ins),)) + lengths
        inputs, outputs = inputs - ins, outputs - outs
    return made


# --- what all share ---------------------------------------------------------------------------------------------------


def _lay_out(variant: Variant, rows: Sequence[tuple[Section | None, str, bytes]], *, own: bool = False) -> None:
    """Give ``variant`` a line for each slot, and the places of the symbols."""
    try:
        slots = map_of_modules(tuple((name, octets) for _, name, octets in rows), 1).slots
    except ConfigError as error:
        line = next((section.line for section, _, _ in rows if section), 0)
        variant.remarks.append(Remark(line, f"its identifier octets cannot be read: {error}"))
        return
    taken: set[str] = set()
    octets_of: OctetsOf = {}
    packed: list[Section] = []
    bits: dict[Direction, set[str]] = {direction: set() for direction in Direction}
    for slot, (section, name, _) in zip(slots, rows, strict=True):
        if section is None:
            variant.slots += [f"fixed: {name}"] if name else []
            continue
        variant.slots.append(_slot_line(section, slot))
        for one in places(section, slot, octets_of, own=own):
            if isinstance(one, Remark):
                variant.remarks.append(one)
                continue
            if one.direction is Direction.OUTPUT and one.spec in bits[one.direction]:
                text = f"{section_title(section)}: output {one.name!r} has the place of another name: left out"
                variant.remarks.append(Remark(one.line, text))
                continue
            bits[one.direction].add(one.spec)
            variant.places.append(structs.replace(one, name=field_name(one.name, taken), symbol=one.name))
        areas = [area for area in section.areas if area.octets]
        if any(area.bit and (area.direction, area.address) in octets_of for area in areas):
            packed.append(section)
        for area in areas:
            if slot.area(area.direction).octets:
                octets_of.setdefault((area.direction, area.address), slot.area(area.direction).at)
    if packed:
        numbers = some_of((str(section.place("SLOT")) for section in packed), 5)
        text = (
            f"slave {packed[0].place('DPADDRESS')}: packed addresses: the bits of slot{'s' * (len(packed) > 1)} "
            f"{numbers} stand in the octet of a slot in front: compare one of these values with the PLC"
        )
        variant.remarks.append(Remark(packed[0].line, text))


def field_name(name: str, taken: set[str]) -> str:
    """A name that a configuration can hold and that is not ``taken`` in the slave, where it is noted."""
    made = _NO_NAME.sub("_", name.strip()) or "_"
    if _NO_FIRST.match(made) and made[0] != "_":
        made = f"_{made}"
    found, number = made, 1
    while found in taken:
        number += 1
        found = f"{made}_{number}"
    taken.add(found)
    return found


def _slot_line(section: Section, slot: Slot) -> str:
    """``slot 7: 75x-430 8DI, 8DE; I 0 to 3; comment``."""
    titles = ", ".join(text for text in (section.text(0), section.firmware, section.text(1)) if text)
    comment = " ".join(section.keys.get("COMMENT", "").split())
    return "; ".join((f"slot {section.place('SLOT')}: {titles}", *_ranges(section), *([comment] if comment else [])))


def _ranges(section: Section) -> list[str]:
    """Its addresses as the program of the PLC has them."""
    return [
        f"{'I' if area.direction is Direction.INPUT else 'Q'} {area.address}"
        + (f".{area.bit}" if area.bit else "")
        + (f" to {area.address + area.octets - 1}" if area.octets > 1 else "")
        for area in section.areas
        if area.octets
    ]


def _f_modules(slave: ExportedSlave, variant: Variant) -> str:
    """The reason why nobody but an F-host may be master of ``slave``; empty without F modules."""
    found = [
        section.place("SLOT")
        for section in (slave.head, *slave.slots)
        if any(map(_F_PARAMETERS.match, (*section.parameters, *section.keys))) or _F_ORDERS.match(section.text(0))
    ]
    if not found and not variant.has_f:
        return ""
    slots = sorted({slot for slot in found if slot is not None})
    runs = ", ".join(str(a) if a == b else f"{a} to {b}" for a, b in runs_of(slots))
    where = f" in slot{'s' * (len(slots) > 1)} {runs}" if slots else ""
    return f"F modules (PROFIsafe){where}: dpstack is no F-host"
