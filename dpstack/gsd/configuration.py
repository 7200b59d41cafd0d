"""Configuration of a slave: from modules in slots to the identifier octets of Chk_Cfg, within all limits of the GSD."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Final

from msgspec import Struct

from dpstack.errors import ConfigError, GsdError
from dpstack.gsd.check import f_notes
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.identifiers import MAX_IO, io_lengths
from dpstack.gsd.model import Device, Module, folded, in_ranges, ranges_text
from dpstack.gsd.module_readings import read_modules
from dpstack.gsd.prm import Reading, UserPrm, near_names

#: Max_Module and the slot numbers of DP-V1 are one octet; more identifiers do not fit a Chk_Cfg anyway
_MAX_SLOTS: Final = 255
#: the identifier octet of an empty slot
_EMPTY: Final = b"\0"


class Configuration(Struct, frozen=True):
    """A checked row of modules (None: an empty slot). ``inputs``/``outputs``: octets, seen from the master."""

    #: device of the file
    device: Device
    #: modules in slot order; None for an empty slot
    modules: tuple[Module | None, ...]
    #: identifier octets for Chk_Cfg
    config: bytes
    #: octets of the inputs, seen from the master
    inputs: int
    #: octets of the outputs, seen from the master
    outputs: int
    #: remarks for people, one line each
    notes: tuple[str, ...] = ()

    def user_prm(self, reading: Reading = Reading.REFS) -> UserPrm:
        """Raises GsdError if the user parameters are too long."""
        return UserPrm(self.device, self.modules, reading)

    def texts(self) -> DiagTexts:
        return DiagTexts(self.device, self.modules)


def fixed_modules(device: Device) -> tuple[Module, ...]:
    """The modules that every configuration begins with: Preset = 1 in a file with FixPresetModules = 1.

    Raises GsdError if one of them is damaged in the file, and if they are too many for any device.
    """
    found = tuple(module for module in device.modules if is_fixed(device, module))
    if len(found) > _MAX_SLOTS:
        raise GsdError(f"{len(found)} fixed presets, Max_Module is {_MAX_SLOTS} at most; get a whole copy of the file")
    return tuple(_usable(module) for module in found)


def is_fixed(device: Device, module: Module) -> bool:
    """Whether ``module`` is one of the :func:`fixed_modules` of ``device``."""
    return device.fix_preset_modules and module.preset


def default_modules(device: Device) -> tuple[Module, ...] | None:
    """The modules of a configuration without a choice: the only module, the presets, the slots' defaults, all modules
    of a compact station if they fit it together; else None.
    """
    usable = [module for module in device.modules if module.complete]
    if len(usable) == 1:
        return (usable[0],)
    preset = tuple(module for module in usable if module.preset)
    if preset:
        return preset
    # only a row without gaps from the first slot on: the file has no default for a slot that it does not list
    numbered = {module.reference: module for module in reversed(device.modules) if module.reference is not None}
    defaults = {slot.number: slot.default for slot in device.slots}
    numbers = range(device.first_slot, device.first_slot + len(defaults))
    found = [None if (at := defaults.get(n)) is None else numbered.get(at) for n in numbers]
    row = tuple(module for module in found if module is not None)
    if row and len(row) == len(found):
        return row
    return device.modules if is_compact_row(device, device.modules) else None


def is_compact_row(device: Device, modules: Sequence[Module | None]) -> bool:
    """Whether ``modules`` are all modules of the compact station ``device``, and fit it together.

    A compact station has all of its modules (GSD specification, Modular_Station = 0). If they cannot all be there,
    the file lists them to choose from.
    """
    if device.modular or tuple(modules) != device.modules or not all(module.complete for module in device.modules):
        return False
    if device.max_module and len(modules) > device.max_module:
        return False
    config = b"".join(module.config for module in device.modules)
    try:
        return bool(config) and len(config) <= MAX_IO and not _excess(device, *io_lengths(config))
    except ConfigError:
        return False


def _excess(device: Device, inputs: int, outputs: int) -> str:
    """The limit of ``device`` that is exceeded by process data of these lengths; empty if they fit."""
    for what, length, limit in (
        ("inputs", inputs, device.max_input_len),
        ("outputs", outputs, device.max_output_len),
        ("inputs and outputs", inputs + outputs, device.max_data_len),
    ):
        # a compact device does not need these keywords: 0 is no limit there
        if limit is not None and (device.modular or limit) and length > limit:
            return f"{length} octets of {what}, the device has at most {limit}"
    return ""


def find_module(device: Device, wanted: int | str) -> Module:
    """A module by name or reference number. Raises GsdError with the nearest names.

    Modules with equal names need the reference number, unless they are the same in everything that is sent.
    """
    if isinstance(wanted, int):
        found = device.module_numbered(wanted)
        if found is None:
            known = [m.reference for m in device.modules if m.reference is not None]
            near = min(known, key=lambda n: abs(n - wanted), default=None)
            hint = "no module has a number: give its name" if near is None else f"nearest is {near}"
            raise GsdError(f"no module has the reference number {wanted}; {hint}")
        return _usable(found)
    named = device.modules_named(wanted)
    if not named:
        return _usable(_by_digits(device, wanted))
    if len({_sent(m) for m in named}) > 1:
        numbers = ", ".join(str(m.reference) for m in named if m.reference is not None)
        hint = f"give the reference number: {numbers}" if numbers else "the file gives them no numbers: use config"
        raise GsdError(f"{len(named)} modules are called {wanted!r}; {hint}")
    return _usable(named[0])


def _by_digits(device: Device, wanted: str) -> Module:
    """The module of a reference number written as text. Raises GsdError with the nearest names."""
    if wanted.strip().isdecimal() and len(wanted) < 12:
        numbered = device.module_numbered(int(wanted))
        if numbered is not None:
            return numbered
    near = near_names(wanted, (m.name for m in device.modules), 0.4)
    names = ", ".join(map(repr, near or list(dict.fromkeys(m.name for m in device.modules))[:8]))
    raise GsdError(
        f"there is no module {wanted!r}; " + (f"nearest are {names}" if names else "the file has no modules")
    )


def _sent(module: Module) -> tuple[object, ...]:
    """All fields of a module that decide the octets on the wire."""
    return module.config, module.prm.consts, module.prm.refs, module.prm.length


def _usable(module: Module) -> Module:
    if not module.complete:
        raise GsdError(
            f"module {module.title} of line {module.line} is damaged in the file (dpstack gsd check shows how); "
            f"get a whole copy of it"
        )
    return module


def configure(device: Device, wanted: Sequence[int | str] | None = None, *, own_prm: bool = False) -> Configuration:
    """Plug ``wanted`` (names or reference numbers in slot order, "" for an empty slot; None: what the file presets).

    Fixed presets stand first; ``wanted`` begins with all of them, or leaves them out. Raises GsdError (``what; what to
    do``): unknown modules, too many, too long, not allowed in their slot, fixed presets elsewhere.
    """
    modules = default_modules(device) if wanted is None else _named(device, wanted)
    if modules is None:
        raise GsdError(_no_choice(device))
    return plug(device, modules, own_prm=own_prm)


def _named(device: Device, wanted: Sequence[int | str]) -> tuple[Module | None, ...]:
    """The modules with these names. If a fixed preset and another module share a name and everything that is sent,
    the name stands for the preset in front and for the other module elsewhere.
    """
    if len(wanted) > _MAX_SLOTS:
        raise GsdError(f"{len(wanted)} modules are named; no device has more than {_MAX_SLOTS} slots: take out some")
    modules = [None if name == "" else find_module(device, name) for name in wanted]
    fixed = fixed_modules(device)
    row = list(zip(wanted, modules, strict=True))
    leading = len(row) >= len(fixed) and all(
        module is preset or (isinstance(name, str) and module is not None and _twins(module, preset))
        for (name, module), preset in zip(row, fixed, strict=False)
    )
    if leading:
        modules[: len(fixed)] = fixed
    for at, (name, module) in enumerate(row):
        if leading and at < len(fixed):
            continue
        if isinstance(name, str) and module is not None and is_fixed(device, module):
            others = (m for m in device.modules_named(name) if not m.preset and m.complete and _twins(m, module))
            modules[at] = next(others, module)
    return tuple(modules)


def _twins(one: Module, other: Module) -> bool:
    return folded(one.name) == folded(other.name) and _sent(one) == _sent(other)


def _no_choice(device: Device) -> str:
    names = ", ".join(module.title for module in device.modules[:3])
    if not names:
        return "the GSD file has no modules; give ident and config (identifier octets) in its place"
    return f"the device has {len(device.modules)} modules to choose from; name those that are plugged: {names} ..."


def configuration_like(
    device: Device, config: bytes, lengths: tuple[int, int], *, own_prm: bool = False
) -> Configuration:
    """The configuration with the identifier octets ``config``, or else with ``lengths`` (input octets, output octets).

    It is the preset or one module behind the fixed presets. ``own_prm`` as for :func:`plug`. Raises GsdError if
    no such module exists, or more than one.
    """
    preset, fixed = default_modules(device), fixed_modules(device)
    rows = [preset] if preset else []
    others = [module for module in device.modules if module.complete and not is_fixed(device, module)]
    rows += [(*fixed, module) for module in others if (*fixed, module) != preset]
    possible: list[Configuration] = []
    for row in rows:
        with contextlib.suppress(ConfigError):
            octets = b"".join(module.config for module in row)
            if octets == config or io_lengths(octets) == lengths:
                possible.append(plug(device, row, own_prm=own_prm))
    fitting = [c for c in possible if c.config == config] or [c for c in possible if (c.inputs, c.outputs) == lengths]
    if len(fitting) == 1:
        return fitting[0]
    wanted = f"{lengths[0]} octets of inputs and {lengths[1]} of outputs"
    if not fitting:
        raise GsdError(f"no single module has {wanted}; name those that are plugged")
    names = " or ".join(" and ".join(m.title for m in c.modules if m is not None) for c in fitting[:8])
    raise GsdError(f"{len(fitting)} modules have {wanted}; name the one that is plugged: {names}")


def modules_of_config(device: Device, config: bytes) -> tuple[Module | None, ...] | None:
    """The modules whose identifier octets are ``config``, in slot order, None for an empty slot. Modules with the same
    octets cannot be distinguished: the first one in the file counts. None if some octets are those of no module.
    """
    best = read_modules(device, config, most=1)[0][0]
    if best.unknown:
        return None
    return tuple(place.modules[0] if place.modules else None for place in best.places)


def plug(device: Device, modules: Sequence[Module | None], *, own_prm: bool = False) -> Configuration:
    """A configuration of ``modules``; fixed presets are put in front if they are missing. Raises GsdError.

    ``own_prm``: user parameters come from elsewhere, so those of the file need not fit.
    """
    row = _behind_fixed(device, modules)
    _check_count(device, row)
    _check_slots(device, row)
    config = b"".join(_EMPTY if module is None else module.config for module in row)
    if not config:
        raise GsdError("no module with identifier octets is plugged; name at least one")
    if len(config) > MAX_IO:
        raise GsdError(f"{len(config)} identifier octets; a Chk_Cfg carries {MAX_IO}: take out modules")
    try:
        inputs, outputs = io_lengths(config)
    except ConfigError as error:
        raise GsdError(f"{error}; the module that holds it is wrong in the GSD file") from None
    excess = _excess(device, inputs, outputs)
    if excess:
        raise GsdError(f"{excess}; take out modules")
    notes = f_notes(device, row)
    if not device.modular and len(row) > 1 and not is_compact_row(device, row):
        several = "the device is no modular station (Modular_Station = 0), but several modules are plugged"
        notes = (several, *notes)
    found = Configuration(device, row, config, inputs, outputs, notes)
    if not own_prm:
        found.user_prm()  # raises GsdError for parameters that do not fit
    return found


def _behind_fixed(device: Device, modules: Sequence[Module | None]) -> tuple[Module | None, ...]:
    """``modules`` with the fixed presets in front. Raises GsdError for a preset in another place, or twice."""
    fixed = fixed_modules(device)
    rest = tuple(modules)
    if rest[: len(fixed)] == fixed:
        rest = rest[len(fixed) :]
    for module in rest:
        if module is not None and is_fixed(device, module):
            raise GsdError(
                f"module {module.title} is a fixed preset (FixPresetModules = 1) and stands once, in slot "
                f"{device.first_slot + fixed.index(module)}; leave it out, or let the modules begin with all fixed "
                f"presets: {', '.join(preset.title for preset in fixed)}"
            )
    return fixed + rest


def _check_count(device: Device, modules: Sequence[Module | None]) -> None:
    limit = device.max_module
    if limit and device.modular and len(modules) > limit:
        fixed = len(fixed_modules(device))
        among = f" with the {fixed} fixed preset{'s' * (fixed > 1)}" if fixed else ""
        raise GsdError(f"{len(modules)} modules{among}, the device takes at most {limit} (Max_Module); take out some")


def _check_slots(device: Device, modules: Sequence[Module | None]) -> None:
    """Check each module against its slot. A slot that SlotDefinition does not list takes every module."""
    slots = {slot.number: slot for slot in device.slots}
    for number, module in enumerate(modules, device.first_slot):
        slot = slots.get(number)
        if slot is None or module is None or not slot.allowed:
            continue
        if module.reference is None or not in_ranges(module.reference, slot.allowed):
            name = f" ({slot.name})" if slot.name else ""
            raise GsdError(
                f"module {module.title} is not allowed in slot {slot.number}{name}; "
                f"allowed references: {ranges_text(slot.allowed)}"
            )
