"""From modules in slots to the identifier octets of Chk_Cfg, with every limit of the GSD file checked."""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Sequence
from dataclasses import dataclass

from dpstack.errors import ConfigError, GsdError
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.identifiers import MAX_IO, io_lengths
from dpstack.gsd.model import Device, Module, Slot, folded, in_ranges, ranges_text
from dpstack.gsd.prm import Reading, UserPrm

#: the identifier octet of an empty slot
_EMPTY = b"\0"


@dataclass(frozen=True, slots=True)
class Configuration:
    """A checked choice of modules (None: an empty slot). ``inputs``/``outputs``: octets, seen from the master."""

    device: Device
    modules: tuple[Module | None, ...]
    first_slot: int
    config: bytes
    inputs: int
    outputs: int
    notes: tuple[str, ...] = ()

    def user_prm(self, reading: Reading = Reading.REFS) -> UserPrm:
        """Its user parameters. Raises GsdError where they are too long."""
        return UserPrm(self.device, self.modules, reading, self.first_slot)

    def texts(self) -> DiagTexts:
        """The texts of its diagnosis."""
        return DiagTexts(self.device, self.modules)


def first_slot(device: Device) -> int:
    """The number of the first slot: as SlotDefinition or Modul_Offset says, else 1."""
    if device.slots:
        return min(slot.number for slot in device.slots)
    return 1 if device.modul_offset is None else device.modul_offset


def default_modules(device: Device) -> tuple[Module, ...] | None:
    """What is plugged when nothing is said: the only module, the preset ones, the slots' defaults; else None."""
    usable = [module for module in device.modules if module.complete]
    if len(usable) == 1:
        return (usable[0],)
    preset = tuple(module for module in usable if module.preset)
    if preset:
        return preset
    found = [device.module_numbered(slot.default) for slot in device.slots if slot.default is not None]
    if found and len(found) == len(device.slots) and all(found):
        return tuple(module for module in found if module is not None)
    return None


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
    if len({(m.config, m.prm.consts, m.prm.refs, m.prm.length) for m in named}) > 1:
        numbers = ", ".join(str(m.reference) for m in named if m.reference is not None)
        hint = f"give the reference number: {numbers}" if numbers else "the file gives them no numbers: use config"
        raise GsdError(f"{len(named)} modules are called {wanted!r}; {hint}")
    return _usable(named[0])


def _by_digits(device: Device, wanted: str) -> Module:
    """A reference number written as text, or the refusal with the nearest names."""
    if wanted.strip().isdecimal() and len(wanted) < 12:
        numbered = device.module_numbered(int(wanted))
        if numbered is not None:
            return numbered
    by_fold = {folded(m.name): m.name for m in device.modules}
    near = difflib.get_close_matches(folded(wanted), list(by_fold), n=3, cutoff=0.4)
    if not near:
        near = [name for name in by_fold if folded(wanted) in name][:3]
    names = ", ".join(repr(by_fold[n]) for n in near) or ", ".join(repr(n) for n in list(by_fold.values())[:8])
    raise GsdError(
        f"there is no module {wanted!r}; " + (f"nearest are {names}" if names else "the file has no modules")
    )


def _usable(module: Module) -> Module:
    if not module.complete:
        raise GsdError(
            f"module {module.title} of line {module.line} is damaged in the file (dpstack gsd check shows how); "
            f"get a whole copy of it"
        )
    return module


def configure(device: Device, wanted: Sequence[int | str] | None = None) -> Configuration:
    """Plug ``wanted`` (names or reference numbers in slot order, "" for an empty slot; None: what the file presets).

    Raises GsdError (``what; what to do``): unknown modules, too many, too long, not allowed in their slot.
    """
    if wanted is None:
        preset = default_modules(device)
        if preset is None:
            raise GsdError(_no_choice(device))
        modules: tuple[Module | None, ...] = preset
    else:
        modules = tuple(None if name == "" else find_module(device, name) for name in wanted)
    return plug(device, modules)


def _no_choice(device: Device) -> str:
    names = ", ".join(module.title for module in device.modules[:3])
    if not names:
        return "the GSD file has no modules; give ident and config (identifier octets) in its place"
    return f"the device has {len(device.modules)} modules to choose from; name those that are plugged: {names} ..."


def configuration_like(device: Device, config: bytes, lengths: tuple[int, int]) -> Configuration:
    """What is plugged for a telegram: the preset, or one module, with the identifier octets ``config``, or else with
    ``lengths``, (input octets, output octets). Raises GsdError where there is none, or more than one.
    """
    preset = default_modules(device)
    rows = [preset] if preset else []
    rows += [(module,) for module in device.modules if module.complete and (module,) != preset]
    possible: list[Configuration] = []
    for row in rows:
        with contextlib.suppress(GsdError):
            possible.append(plug(device, row))
    fitting = [c for c in possible if c.config == config] or [c for c in possible if (c.inputs, c.outputs) == lengths]
    if len(fitting) == 1:
        return fitting[0]
    wanted = f"{lengths[0]} octets of inputs and {lengths[1]} of outputs"
    if not fitting:
        raise GsdError(f"no single module has {wanted}; name those that are plugged")
    names = " or ".join(" and ".join(m.title for m in c.modules if m is not None) for c in fitting[:8])
    raise GsdError(f"{len(fitting)} modules have {wanted}; name the one that is plugged: {names}")


def plug(device: Device, modules: Sequence[Module | None]) -> Configuration:
    """A configuration of these very modules. Raises GsdError."""
    _check_count(device, modules)
    first = first_slot(device)
    _check_slots(device, modules, first)
    config = b"".join(_EMPTY if module is None else module.config for module in modules)
    if not config:
        raise GsdError("no module with identifier octets is plugged; name at least one")
    if len(config) > MAX_IO:
        raise GsdError(f"{len(config)} identifier octets; a Chk_Cfg carries {MAX_IO}: take out modules")
    try:
        inputs, outputs = io_lengths(config)
    except ConfigError as error:
        raise GsdError(f"{error}; the module that holds it is wrong in the GSD file") from None
    for what, length, limit in (
        ("inputs", inputs, device.max_input_len),
        ("outputs", outputs, device.max_output_len),
        ("inputs and outputs", inputs + outputs, device.max_data_len),
    ):
        # a compact device has no need of these keywords: 0 means nothing there
        if limit is not None and (device.modular or limit) and length > limit:
            raise GsdError(f"{length} octets of {what}, the device has at most {limit}; take out modules")
    return Configuration(device, tuple(modules), first, config, inputs, outputs, _notes(device, modules))


def _check_count(device: Device, modules: Sequence[Module | None]) -> None:
    limit = device.max_module
    if limit and device.modular and len(modules) > limit:
        raise GsdError(f"{len(modules)} modules, the device takes at most {limit} (Max_Module); take out some")


def _check_slots(device: Device, modules: Sequence[Module | None], first: int) -> None:
    slots = {slot.number: slot for slot in device.slots}
    for number, module in enumerate(modules, first):
        slot = slots.get(number)
        if slots and slot is None:
            raise GsdError(f"slot {number} is not in the file's SlotDefinition; slots are {sorted(slots)}")
        if slot is not None and module is not None:
            _check_slot(slot, module)


def _check_slot(slot: Slot, module: Module) -> None:
    if module.reference is None or not in_ranges(module.reference, slot.allowed):
        name = f" ({slot.name})" if slot.name else ""
        raise GsdError(
            f"module {module.title} is not allowed in slot {slot.number}{name}; "
            f"allowed references: {ranges_text(slot.allowed) or 'any'}"
        )


def _notes(device: Device, modules: Sequence[Module | None]) -> tuple[str, ...]:
    if not device.modular and len(modules) > 1:
        return ("the device is no modular station (Modular_Station = 0), but several modules are plugged",)
    return ()
