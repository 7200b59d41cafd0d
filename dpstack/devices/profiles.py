"""A device file as a drive profile: all of dpstack uses it as it uses a plugin."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Final, NamedTuple

from dpstack.devices.drive_core import FileCore, counts_of
from dpstack.devices.drive_device import FileDevice
from dpstack.devices.model import DeviceFile, Telegram, WordSpec
from dpstack.errors import ConfigError
from dpstack.profile.drive_profile import CoreFactory, DeviceFactory, DriveProfile, OptionSpec

#: entry points that a device file may name by its key ``python``
GROUP: Final = "dpstack.devices"
_REFERENCES: Final = {
    "reference_hz": "the frequency that 100 % speed means",
    "reference_rpm": "the speed in rpm that 100 % means",
}


class DevicePython(NamedTuple):
    """Python for a device file, an object at an entry point of the group :data:`GROUP`."""

    #: makes the core of a master: called as a :class:`FileCore` with the file in front
    core: CoreFactory
    #: makes the simulated drive; None: that of the base
    device: DeviceFactory | None = None
    #: ``module:function`` with the facts of the manual, see :class:`DriveProfile`
    details: str | None = None


def profile_of(file: DeviceFile) -> DriveProfile:
    """The drive that ``file`` describes. Raises ConfigError if the Python that it names is not installed."""
    core: CoreFactory = partial(FileCore, file)
    device: DeviceFactory = partial(FileDevice, file)
    details = None
    if file.python:
        own = python_of(file.python)
        core, device, details = own.core, own.device or device, own.details
    bus = file.bus
    options = dict(file.options)
    for name, text in _REFERENCES.items():
        given = getattr(file.reference, name.removeprefix("reference_"))
        if given and name not in options:
            default = 0.0 if isinstance(given, str) else float(given)
            more = f"; 0: {given} of the drive says it" if isinstance(given, str) else ""
            options[name] = OptionSpec(default=default, low=0, high=1_000_000, text=text + more)
    ready = {one.parameter: one.equals for one in file.settings if isinstance(one.equals, (int, float))}
    hz = file.reference.hz
    return DriveProfile(
        name=file.name,
        title=file.title,
        ident=bus.ident or 0,
        ident_made_up=bus.ident is None and file.gsd is None,
        telegrams={name: one.spec for name, one in file.telegrams.items()},
        default_telegram=file.default_telegram,
        user_prm=bus.user_prm,
        baud_rates=bus.rates,
        max_tsdr=bus.max_tsdr,
        min_slave_interval_ns=bus.min_slave_interval_us * 1000,
        fail_safe=bus.fail_safe,
        reference_hz=hz if isinstance(hz, (int, float)) else 0.0,
        on_loss=file.on_loss,
        core_factory=core,
        device_factory=device,
        details=details,
        core_options=options,
        device_options=file.device_options,
        notes=tuple(one for one in (*file.notes, file.tried) if one),
        ready=ready,
        file=str(file.path),
        digest=file.digest,
        gsd_file=None if file.gsd is None else str(file.gsd),
        modules={name: one.modules for name, one in file.telegrams.items() if one.modules},
        fields=partial(fields_of, file),
        check_word=partial(_check_word, file),
    )


def python_of(name: str) -> DevicePython:
    """The Python that packages have registered under ``name``. Raises ConfigError."""
    from importlib import metadata

    points = {point.name: point for point in metadata.entry_points(group=GROUP)}
    if name not in points:
        known = ", ".join(sorted(points)) or "none"
        raise ConfigError(
            f"python = {name!r}: no installed package has registered it (group {GROUP}; known: {known}); install it"
        )
    try:
        found = points[name].load()
    except Exception as error:
        raise ConfigError(
            f"python = {name!r} cannot be loaded: {type(error).__name__}: {error}; repair or uninstall its package"
        ) from None
    if not isinstance(found, DevicePython):
        raise ConfigError(f"python = {name!r} is {type(found).__name__}, not a DevicePython; repair its package")
    return found


def _check_word(file: DeviceFile, name: str, value: object) -> None:
    if isinstance(value, (int, float)):
        counts_of(file.words[name], value)


def fields_of(file: DeviceFile, telegram: str) -> tuple[dict[str, object], dict[str, object]]:
    """The named values of inputs and outputs in ``telegram``, as a plant file writes them."""
    found = file.telegrams.get(telegram)
    if found is None:
        raise ConfigError(f"{file.name} has no telegram {telegram!r}")
    return _fields(file, found, outputs=False), _fields(file, found, outputs=True)


def _fields(file: DeviceFile, telegram: Telegram, *, outputs: bool) -> dict[str, object]:
    found: dict[str, object] = {}
    at = 8 if telegram.spec.channel else 0
    for name in telegram.outputs if outputs else telegram.inputs:
        word = None if isinstance(name, int) else file.words[name]
        if word is not None and word.part not in ("control", "status") and not (outputs and word.part == "setpoint"):
            found[word.name] = _field(word, at)
            for bit, number in () if outputs else word.bits.items():
                found[f"{word.name}_{bit}"] = f"bool@{at + (word.octets * 8 - 1 - number) // 8}.{number % 8}"
        at += 2 if word is None else word.octets
    return found


def _field(word: WordSpec, at: int) -> str | Mapping[str, object]:
    kind = word.type
    if kind in ("n2", "n4"):
        kind = "i16" if kind == "n2" else "i32"
    place = f"{kind}@{at}"
    if not word.full and not word.unit:
        return place
    found: dict[str, object] = {"at": place}
    if word.full:
        found["scale"] = word.step
    if word.shown_unit:
        found["unit"] = word.shown_unit
    return found
