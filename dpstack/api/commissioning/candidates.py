"""Candidates for a slave that a scan has found: known drives and GSD files with its ident number, best first."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from enum import IntEnum
from typing import Final

from dpstack.api.commissioning.live_list import Chosen
from dpstack.api.config.gsd_choice import module_key, slots_of
from dpstack.api.gsd_folder import GsdEntry, GsdFolder
from dpstack.api.gsd_info import module_lengths
from dpstack.devices import finding
from dpstack.dp.master.scanner import Found
from dpstack.dp.slot_map import SlotMap
from dpstack.errors import ConfigError, DpError
from dpstack.fdl.telegram import StationType
from dpstack.gsd.configuration import default_modules, find_module, plug
from dpstack.gsd.identifiers import io_lengths
from dpstack.gsd.model import Device, Module, in_ranges
from dpstack.gsd.module_readings import ModuleReading, read_modules
from dpstack.profile import DriveProfile
from dpstack.text import octets_text

#: readings of identifier octets in an answer
_READINGS: Final = 16


class Fit(IntEnum):
    """How well the slave's identifier octets fit a candidate. The names in lower case are those of the answers."""

    EXACT = 0
    #: the slave did not give its configuration
    UNKNOWN = 1
    PARTLY = 2
    NONE = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """One explanation of a slave. ``keys``: those of its [[slave]] table without name and address; None if the
    candidate leads to no table. ``text``: one sentence about how it fits.
    """

    kind: str
    fit: Fit
    text: str
    gsd: str | None = None
    drive: str | None = None
    telegrams: tuple[str, ...] = ()
    vendor: str = ""
    model: str = ""
    revision: str = ""
    unknown_octets: int = 0
    readings: int = 0
    #: several modules have the same octets, and a person has to choose
    ambiguous: bool = False
    keys: dict[str, object] | None = field(default=None)

    @property
    def rank(self) -> tuple[object, ...]:
        """The smaller, the better: octets first, a table before none, drives before files before bare octets."""
        kinds = ("drive", "gsd", "octets").index(self.kind)
        return kinds == 2, self.fit, self.keys is None, self.unknown_octets, kinds, self.gsd or self.drive or ""

    def as_dict(self) -> dict[str, object]:
        return {**asdict(self), "fit": self.fit.name.lower(), "telegrams": list(self.telegrams)}


def candidates(folder: GsdFolder, ident: int | None, config: bytes | None) -> list[Candidate]:
    """The candidates of a slave with that ident number and those identifier octets (None: not known), best first.

    GSD files that turn out to be unusable are listed in ``folder.bad``.
    """
    found: list[Candidate] = []
    if ident is not None:
        found += (_of_drive(drive, config) for drive in finding.with_ident(ident))
        for entry in folder.with_ident(ident):
            try:
                device = folder.device(entry.key)
            except DpError:
                continue
            found.append(_of_gsd(entry, device, config))
        if config is not None:
            found += _of_octets(ident, config)
    return sorted(found, key=lambda candidate: candidate.rank)


def chosen_slaves(folder: GsdFolder, stations: Iterable[Found]) -> tuple[dict[int, Chosen], list[str]]:
    """For each slave with a drive or a GSD file that fits exactly its keys of [[slave]] by address; and one line about
    each slave without, each with a choice, and each file that cannot be used.
    """
    chosen: dict[int, Chosen] = {}
    notes: list[str] = []
    for found in stations:
        if found.ident is None or found.kind is not StationType.SLAVE:
            continue
        best = next(iter(candidates(folder, found.ident, found.config)), None)
        who = f"slave {found.address} (ident 0x{found.ident:04X})"
        if best is None or best.kind == "octets":
            notes.append(f"{who}: no GSD file in {folder.folder} has its ident number")
        elif best.keys is None or best.fit is not Fit.EXACT:
            notes.append(f"{who}: {best.gsd or best.drive}: {best.text}")
        else:
            chosen[found.address] = Chosen(best.keys, _slots(folder, best))
            if best.ambiguous:
                notes.append(f"{who}: {best.gsd}: {best.text}")
    return chosen, [*notes, *(f"{path}: {reason}" for path, reason in folder.bad)]


def _slots(folder: GsdFolder, candidate: Candidate) -> SlotMap | None:
    """The slots of a candidate with modules."""
    modules = (candidate.keys or {}).get("modules")
    if candidate.gsd is None or not isinstance(modules, list):
        return None
    device = folder.device(candidate.gsd)
    return slots_of(device, [None if key == "" else find_module(device, key) for key in modules])


def _of_drive(drive: DriveProfile, config: bytes | None) -> Candidate:
    if config is None:
        fitting, fit = tuple(drive.telegrams.values()), Fit.UNKNOWN
        text = "the ident number is that of this drive; the slave did not give its telegram"
    else:
        fitting = drive.telegrams_of(config)
        fit = Fit.EXACT if fitting else Fit.NONE
        text = (
            "ident number and identifier octets are those of this drive"
            if fitting
            else "the ident number is that of this drive, the identifier octets are those of none of its telegrams"
        )
    names = tuple(spec.name for spec in fitting)
    keys: dict[str, object] | None = None
    if names:
        chosen = drive.default_telegram if drive.default_telegram in names else names[0]
        keys = {"drive": drive.name, "telegram": chosen}
        if drive.ident_made_up:
            keys["ident"] = drive.ident
    return Candidate(kind="drive", fit=fit, text=text, drive=drive.name, telegrams=names, model=drive.title, keys=keys)


def _of_gsd(entry: GsdEntry, device: Device, config: bytes | None) -> Candidate:
    keys: dict[str, object] | None = None
    unknown = count = 0
    ambiguous = False
    try:
        if config is None:
            fit, modules = Fit.UNKNOWN, default_modules(device)
            text = "the ident number is that of this file; the slave did not give its modules"
            if modules is not None:
                keys = _gsd_keys(entry, device, modules)
        else:
            readings, more = read_modules(device, config, _READINGS)
            best, count = readings[0], len(readings) + more
            unknown = best.unknown
            fit = Fit.EXACT if not unknown else Fit.NONE if unknown == len(config) else Fit.PARTLY
            ambiguous = not unknown and (count > 1 or any(len(place.modules) > 1 for place in best.places))
            text = _text_of(unknown, len(config), ambiguous=ambiguous)
            if not unknown:
                keys = _gsd_keys(entry, device, [place.modules[0] if place.modules else None for place in best.places])
    except ConfigError as error:
        text += f"; but as they stand they make no configuration: {error}"
    return Candidate(
        kind="gsd",
        fit=fit,
        text=text,
        gsd=entry.key,
        vendor=device.vendor,
        model=device.model,
        revision=device.revision,
        unknown_octets=unknown,
        readings=count,
        ambiguous=ambiguous,
        keys=keys,
    )


def _gsd_keys(entry: GsdEntry, device: Device, modules: Sequence[Module | None]) -> dict[str, object]:
    """Raises GsdError if the modules make no configuration, or have no name of their own."""
    row = plug(device, modules).modules
    return {"gsd": entry.key, "modules": [module_key(device, module) for module in row]}


def _text_of(unknown: int, octets: int, *, ambiguous: bool) -> str:
    if unknown:
        return f"{unknown} of {octets_text(octets)} are those of no module of this file"
    if ambiguous:
        return "all identifier octets are those of its modules, but several modules have the same ones: choose"
    return "all identifier octets are those of its modules"


def _of_octets(ident: int, config: bytes) -> Iterator[Candidate]:
    """The way without any description: ident number and identifier octets as they are."""
    text = "ident number and identifier octets as the slave gave them; user parameters are not known"
    try:
        inputs, outputs = io_lengths(config)
        usable = bool(config) and max(inputs, outputs) <= 244
    except ConfigError:
        usable = False
    keys: dict[str, object] | None = {"ident": ident, "config": config.hex(" ").upper()} if usable else None
    yield Candidate(
        kind="octets",
        fit=Fit.EXACT if usable else Fit.NONE,
        text=text if usable else "the identifier octets that the slave gave cannot be a configuration",
        keys=keys,
    )


def module_choice(entry: GsdEntry, device: Device, config: bytes | None) -> dict[str, object]:
    """The modules of a GSD file as plain data, with the readings of ``config``: see :meth:`Commissioning.modules`."""
    readings: tuple[ModuleReading, ...] = ()
    more = False
    if config is not None:
        readings, more = read_modules(device, config, _READINGS)
    numbers = {id(module): number for number, module in enumerate(device.modules)}
    default = None if config is not None else default_modules(device)
    return {
        **entry.as_dict(),
        "revision": device.revision,
        "modular": device.modular,
        "max_module": device.max_module,
        "first_slot": device.first_slot,
        "modules": [_module(device, module) for module in device.modules],
        "slots": [
            {
                "slot": slot.number,
                "name": slot.name,
                "modules": [
                    number
                    for number, module in enumerate(device.modules)
                    if module.reference is not None and in_ranges(module.reference, slot.allowed)
                ],
            }
            for slot in device.slots
            if slot.allowed
        ],
        "default": None if default is None else [numbers[id(module)] for module in default],
        "readings": [
            {
                "unknown_octets": reading.unknown,
                "places": [
                    {
                        "slot": place.slot,
                        "config": place.octets.hex(" ").upper(),
                        "unknown": place.unknown,
                        "modules": [numbers[id(module)] for module in place.modules],
                    }
                    for place in reading.places
                ],
            }
            for reading in readings
        ],
        "more_readings": more,
    }


def _module(device: Device, module: Module) -> dict[str, object]:
    """One module; ``key`` None with the ``reason`` if a configuration cannot name it."""
    reason = None
    key: int | str | None = None
    try:
        key = module_key(device, module)
    except ConfigError as error:
        reason = str(error)
    inputs, outputs = module_lengths(module)
    return {
        "key": key,
        "name": module.name,
        "reference": module.reference,
        "config": module.config.hex(" ").upper(),
        "inputs": inputs,
        "outputs": outputs,
        "fixed": device.fix_preset_modules and module.preset,
        "info": module.info,
        "reason": reason,
    }
