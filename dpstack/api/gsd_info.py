"""GSD files from disk, and their contents as plain data."""

from __future__ import annotations

import functools
import os
from collections.abc import Mapping
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec.structs import asdict

from dpstack.api.files import AtomicFile, read_file
from dpstack.errors import ConfigError
from dpstack.gsd.check import check
from dpstack.gsd.dpv1_keywords import alarm_kinds
from dpstack.gsd.identifiers import io_lengths
from dpstack.gsd.model import Device, Diagnosis, Diagnostic, GsdFile, Module, Parameter, PrmBlock
from dpstack.gsd.parser import load_gsd, parse_gsd
from dpstack.gsd.prm import Reading, UserPrm, module_octets
from dpstack.gsd.text import MAX_OCTETS
from dpstack.sim import io_station
from dpstack.text import nearest

if TYPE_CHECKING:
    from dpstack.dpv1.slave.description import SlaveDescription


def bundled() -> dict[str, str]:
    """The GSD files that come with dpstack (its own, not the vendors'): name of the device -> ``package:file``
    or an absolute path.

    Those of drive plugins, and that of the simulated I/O station.
    """
    from dpstack.devices import finding  # here, as a GSD file of the user needs no drive

    drives = {name: drive.gsd for name, drive in finding.known().items() if drive.gsd is not None}
    return drives | {io_station.NAME: io_station.GSD}


def read_octets(path: str | Path, folder: Path = Path()) -> bytes:
    """The octets of the file ``path`` in ``folder``, or of a bundled GSD file by the name of its device.

    Raises ConfigError if it cannot be read.
    """
    file = _place(path, folder)
    try:
        return read_file(file, MAX_OCTETS)
    except (OSError, ValueError) as error:
        todo = "give the path of a GSD file"
        if isinstance(error, FileNotFoundError):
            bundled_file = _bundled_file(str(path))
            if bundled_file is not None:
                return bundled_file
            near = nearest(str(path), bundled(), 0.6)
            todo = f"did you mean {near}, or {todo}?" if near else todo
        raise ConfigError(f"{file}: {getattr(error, 'strerror', None) or error}; {todo}") from None


def _place(path: str | Path, folder: Path) -> Path:
    try:
        return folder / Path(path).expanduser()
    except RuntimeError:  # "~name" if no user has this name: it can be the name of a file
        return folder / path


def _bundled_file(device: str) -> bytes | None:
    """The octets of the file of :func:`bundled` for ``device``; None if it has none. No other drive is loaded."""
    place = _place_of(device)
    if place is None or Path(place).is_absolute():
        return None if place is None else Path(place).read_bytes()
    from importlib import resources  # here, as few files are in packages

    package, _, name = place.partition(":")
    return (resources.files(package) / name).read_bytes()


def _place_of(device: str) -> str | None:
    if device == io_station.NAME:
        return io_station.GSD
    from dpstack.devices import finding

    return finding.gsd_of(device)


#: many slaves of a plant have the same file, and a large one takes a second
_parsed: Final = functools.lru_cache(4)(load_gsd)


def read_gsd(path: str | Path, folder: Path = Path()) -> GsdFile:
    """Read a GSD file as :func:`read_octets` does. Raises ConfigError, GsdError if it cannot be used at all."""
    octets = read_octets(path, folder)
    return _parsed(octets, str(_place(path, folder)))


def copy_gsd(drive: str, target: str | Path) -> None:
    """Write the bundled GSD file of ``drive`` to the new file ``target``.

    Raises ConfigError, UsageError if it cannot be written.
    """
    octets = _bundled_file(drive)
    if octets is None:
        raise ConfigError(f"no GSD file was written for {drive!r}; there is one for {', '.join(bundled()) or 'none'}")
    with AtomicFile(target) as file:
        file.keep(octets)


def write_gsd(slave: SlaveDescription, target: str | Path, *, replace: bool = False) -> tuple[str, ...]:
    """Write the GSD file of ``slave`` to the new file ``target``, with ``replace`` over an existing one.

    Returns remarks about what a GSD file cannot say of it. Raises ConfigError for a slave that cannot have a GSD file,
    UsageError if the file cannot be written.
    """
    import dataclasses

    from dpstack.dpv1.slave.description_from_gsd import slave_description  # these here, as most only read GSD files
    from dpstack.dpv1.slave.description_to_gsd import as_gsd_file, gsd_octets

    said, remarks = as_gsd_file(slave)
    octets = gsd_octets(slave)
    read = slave_description(load_gsd(octets, str(target)).device)
    if read != said:
        differing = [one.name for one in dataclasses.fields(said) if getattr(read, one.name) != getattr(said, one.name)]
        raise ConfigError(f"slave {slave.name}: a GSD file would be read with another {differing[0]}; simplify it")
    with AtomicFile(target, (lambda _: True) if replace else None) as file:
        file.keep(octets)
    return remarks


def check_gsd(path: str | Path) -> tuple[Diagnostic, ...]:
    """All diagnostics of a GSD file. Raises ConfigError if it cannot be read."""
    return check(parse_gsd(read_octets(path), str(path)))


#: file endings of GSD files in all languages: .gsd, .gse, .gsg, .gsf, .gsi, .gsp, .gss
ENDINGS: Final = frozenset(f".gs{language}" for language in "degfips")


def gsd_files(folder: Path) -> list[Path]:
    """The GSD files in ``folder`` and the folders in it, by name. Folders that cannot be read, or vanish meanwhile, are
    left out. Raises ConfigError if none exist."""
    if not folder.is_dir():
        raise ConfigError(f"{folder}: this is no folder; give the folder of the plant's GSD files")
    paths = (Path(place, name) for place, _, names in os.walk(folder) for name in names)
    found = sorted(path for path in paths if path.suffix.lower() in ENDINGS and path.is_file())
    if not found:
        raise ConfigError(f"{folder}: no GSD file (.gsd, .gse, .gsg ...) is in this directory; give another one")
    return found


#: keys of :func:`gsd_dict` that are fields of the device
_LIMITS: Final = """
modular max_module max_input_len max_output_len max_data_len max_diag_data_len max_user_prm_data_len min_slave_interval
"""
_NAMES: Final = "vendor model revision gsd_revision hardware_release software_release"


def gsd_dict(file: GsdFile) -> dict[str, object]:
    """The file as JSON shows it (interface of ``dpstack gsd show --json``).

    ``user_prm`` and ``user_prm_const`` are None if the file contradicts itself; a diagnostic says how.
    """
    device = file.device
    return {
        **device_facts(device),
        "parameters": [_parameter(parameter) for parameter in device.parameters.values()],
        "device_parameters": parameter_places(device, device.prm),
        "f_parameters": device.f_parameters,
        "first_slot": device.first_slot,
        "fix_preset_modules": device.fix_preset_modules,
        "presets": [{"name": m.name, "reference": m.reference} for m in device.modules if m.preset],
        "diagnosis": diagnosis_texts(device.diagnosis),
        "diagnosis_types": [{"type": d.type, "diagnosis": diagnosis_texts(d)} for d in device.diag_types],
        "unit_diag_bits": sum(text.kind == "bit" for text in device.diagnosis.texts),
        "slots": [
            {"number": s.number, "name": s.name, "default": s.default, "allowed": [list(pair) for pair in s.allowed]}
            for s in device.slots
        ],
        "modules": [module_dict(file, module) for module in device.modules],
        "encoding": file.encoding,
        "diagnostics": [diagnostic_dict(diagnostic) for diagnostic in check(file)],
    }


def device_facts(device: Device) -> dict[str, object]:
    """The first keys of :func:`gsd_dict`: names, limits, abilities and user parameters of the device."""
    return {
        "ident": None if device.ident is None else f"0x{device.ident:04X}",
        **{name: getattr(device, name) for name in (*_NAMES.split(), *_LIMITS.split())},
        "max_tsdr": {str(speed.baud): speed.max_tsdr for speed in device.speeds},
        "supports": flags_of(device, SUPPORTS),
        "requires": flags_of(device, REQUIRES),
        "alarms": list(alarm_kinds(device.dpv1.alarms)),
        "alarms_required": list(alarm_kinds(device.dpv1.required)),
        "alarm_sequence": device.dpv1.alarm_sequence_mode_count,
        "user_prm": _user_prm(device, Reading.REFS),
        "user_prm_const": _user_prm(device, Reading.CONST),
    }


def _user_prm(device: Device, reading: Reading) -> str | None:
    try:
        return UserPrm(device, reading=reading).octets().hex()
    except ConfigError:  # more octets than the limits: the diagnostics have its text
        return None


def diagnostic_dict(diagnostic: Diagnostic) -> dict[str, object]:
    return asdict(diagnostic) | {"severity": diagnostic.severity.value}


def module_dict(file: GsdFile, module: Module) -> dict[str, object]:
    """One module; ``inputs`` and ``outputs`` in octets, None if its identifier octets contradict themselves."""
    inputs, outputs = module_lengths(module)
    return {
        "name": module.name,
        "reference": module.reference,
        "config": module.config.hex(),
        "inputs": inputs,
        "outputs": outputs,
        "user_prm": module_prm(file, module).hex(),
        "parameters": parameter_places(file.device, module.prm),
        "preset": module.preset,
        "f_parameters": module.f_parameters,
        "info": module.info,
        "diagnosis": diagnosis_texts(module.diagnosis),
        "complete": module.complete,
    }


def parameter_places(device: Device, prm: PrmBlock) -> list[dict[str, object]]:
    """The named parameters of the device or of a module: ``number`` and ``name``, ``offset`` in its octets."""
    return [
        {"number": ref.number, "name": device.parameters[ref.number].name, "offset": ref.offset}
        for ref in prm.refs
        if ref.number in device.parameters
    ]


def diagnosis_texts(diagnosis: Diagnosis) -> list[dict[str, object]]:
    """The texts for a diagnosis, with the names of :class:`~dpstack.gsd.model.DiagText`."""
    return [text._asdict() for text in diagnosis.texts]


def module_lengths(module: Module) -> tuple[int | None, int | None]:
    """(input octets, output octets), None if the identifier octets contradict themselves."""
    try:
        return io_lengths(module.config)
    except ConfigError:
        return None, None


def module_prm(file: GsdFile, module: Module) -> bytes:
    """The module's part of the user parameters with its defaults, in no slot; empty if they fit no Set_Prm."""
    try:
        return module_octets(file.device, module)
    except ConfigError:
        return b""


#: abilities of a device, in words -> flag of the Device
SUPPORTS: Final = {
    "sync": "sync",
    "freeze": "freeze",
    "auto-baud": "auto_baud",
    "set slave address": "set_slave_add",
    "fail-safe": "fail_safe",
    "DP-V1": "dpv1.slave",
    "acyclic class 1": "dpv1.c1_read_write",
    "acyclic class 2": "dpv1.c2_read_write",
    "watchdog base 1 ms": "dpv1.wd_base_1ms",
    "isochronous": "isochronous",
    "publisher": "publisher",
}
#: abilities that a device requires of its master, apart from alarms
REQUIRES: Final = {
    "fail-safe": "dpv1.fail_safe_required",
    "structured parameters": "dpv1.prm_block_structure_required",
    "acyclic class 1": "dpv1.c1_read_write_required",
    "acyclic class 2": "dpv1.c2_read_write_required",
    "isochronous": "isochronous_required",
}


def flags_of(device: Device, names: Mapping[str, str]) -> list[str]:
    """Those of ``names`` (:data:`SUPPORTS`, :data:`REQUIRES`) whose flag is set in the GSD file of ``device``."""
    return [name for name, flag in names.items() if attrgetter(flag)(device)]


def alarms_text(device: Device) -> str | None:
    """The alarms of the device as text; None if it has none."""
    kinds, required = alarm_kinds(device.dpv1.alarms), alarm_kinds(device.dpv1.required)
    if not kinds:
        return None
    most = device.dpv1.alarm_sequence_mode_count
    how = "; one of each at a time" + (f" or {most} in all" if most else "")
    return ", ".join(kinds) + how + (f"; required: {', '.join(required)}" if required else "")


def _parameter(p: Parameter) -> dict[str, object]:
    return {
        "number": p.number,
        "name": p.name,
        "type": p.type.text,
        "default": p.default,
        "allowed": [list(pair) for pair in p.allowed],
        "texts": {str(value): text for value, text in p.texts.items()},
    }
