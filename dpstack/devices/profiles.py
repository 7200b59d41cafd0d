"""A device file as a drive profile: all of dpstack uses it as it uses a plugin."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from functools import partial
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from dpstack.devices.model import DeviceFile, FileFacts, Telegram, WordSpec, counts_of
from dpstack.entry_points import EntryPoint, entry_points
from dpstack.errors import ConfigError
from dpstack.profile.drive_profile import DriveProfile, OptionSpec, TelegramSetting
from dpstack.profile.model.drive_type import Options, TelegramFamily, TelegramSpec

if TYPE_CHECKING:
    from dpstack.profile.master.core import DriveCore
    from dpstack.profile.model.description import DeviceDescription
    from dpstack.profile.simulator.device import DriveDevice

#: entry points that a device file may name by its key ``python``
GROUP: Final = "dpstack.devices"
_REFERENCES: Final = {
    "reference_hz": "the frequency that 100 % speed means",
    "reference_rpm": "the speed in rpm that 100 % means",
}


class DevicePython(NamedTuple):
    """Python for a device file, an object at an entry point of the group :data:`GROUP`."""

    #: makes the core of a master, as :class:`FileCore`: a class derived from :class:`DeclaredCore`
    core: Callable[..., DriveCore]
    #: makes the simulated drive, as :class:`FileDevice`; None: that of the base. As ``module:name`` it is loaded when a
    #: drive is simulated
    device: Callable[..., DriveDevice] | str | None = None
    #: facts of the manual beyond those of the file, see :class:`DriveProfile`; as ``module:name`` for a sheet only
    details: Callable[..., DeviceDescription] | str | None = None
    #: telegrams too many for the file
    family: TelegramFamily | None = None


def profile_of(file: DeviceFile) -> DriveProfile:
    """The drive that ``file`` describes. Raises ConfigError if the Python that it names is not installed."""
    if file.python:
        _point(file.python)
    simulate = file.simulate
    options = dict(file.options)
    for name, text in _REFERENCES.items():
        given = getattr(file.reference, name.removeprefix("reference_"))
        if name not in options and (given or not file.python):
            default = 0.0 if isinstance(given, str) else float(given)
            more = f"; 0: {given} of the drive says it" if isinstance(given, str) else ""
            options[name] = OptionSpec(default=default, low=0, high=1_000_000, text=text + more)
    ready = simulate.ready
    if ready is None:
        ready = {one.parameter: one.equals for one in file.settings if isinstance(one.equals, (int, float))}
    chosen = file.telegram_parameter
    numbers = {name: one.number for name, one in file.telegrams.items() if one.number is not None}
    hz, rpm = (one if isinstance(one, (int, float)) else 0.0 for one in (file.reference.hz, file.reference.rpm))
    return DriveProfile(
        **facts_of(file),
        reference_hz=hz,
        reference_rpm=rpm,
        core_factory=partial(_core, file),
        device_factory=partial(_device, file),
        details=partial(_details, file),
        core_options=options,
        device_options=file.device_options,
        ready=ready,
        left_open=simulate.left_open,
        simulated_options=simulate.options,
        rate_setting=file.bus.rate_setting,
        family=TelegramFamily(partial(_named, file), partial(_of_config, file)) if file.python else None,
        telegram_setting=TelegramSetting(chosen, numbers) if chosen else None,
        fields=None if file.python else partial(fields_of, file),
        check_word=None if file.python else partial(_check_word, file),
    )


def facts_of(file: FileFacts) -> dict[str, Any]:
    """The fields of a profile that drives and other devices have from their file."""
    bus = file.bus
    return {
        "name": file.name,
        "title": file.title,
        "ident": bus.ident or 0,
        "ident_made_up": bus.made_up or (bus.ident is None and file.gsd is None),
        "telegrams": {name: one.spec for name, one in file.telegrams.items()},
        "default_telegram": file.default_telegram,
        "user_prm": bus.user_prm,
        "baud_rates": bus.rates or tuple(bus.max_tsdr),
        "max_tsdr": bus.max_tsdr,
        "min_slave_interval_ns": bus.min_slave_interval_us * 1000,
        "fail_safe": bus.fail_safe,
        "on_loss": file.on_loss,
        "notes": tuple(one for one in (*file.notes, file.tried) if one),
        "gsd": (bus.made_gsd and str(file.path.parent / bus.made_gsd)) or None,
        "file": str(file.path),
        "digest": file.digest,
        "gsd_file": None if file.gsd is None else str(file.gsd),
        "modules": {name: one.modules for name, one in file.telegrams.items() if one.modules},
    }


def _core(file: DeviceFile, *args: Any) -> DriveCore:
    if file.python:
        return python_of(file.python).core(file, *args)
    from dpstack.devices.drive_core import FileCore  # here, as a profile is also read without its drive

    return FileCore(file, *args)


def _device(file: DeviceFile, *args: Any) -> DriveDevice:
    own = python_of(file.python).device if file.python else None
    if own is not None:
        made: DriveDevice = _loaded(own)(file, *args)
        return made
    from dpstack.devices.drive_device import FileDevice  # here, as few drives are simulated

    return FileDevice(file, *args)


def _named(file: DeviceFile, name: str) -> TelegramSpec:
    family = python_of(file.python).family
    if family is None:
        raise ConfigError(f"{file.name} has no telegram {name!r}; it has {', '.join(file.telegrams)}")
    return family.named(name)


def _of_config(file: DeviceFile, config: bytes) -> TelegramSpec | None:
    family = python_of(file.python).family
    return None if family is None else family.of_config(config)


def _details(file: DeviceFile, core: DriveCore, basic: DeviceDescription, address: int, options: Options) -> Any:
    from dpstack.devices.description import describe  # here, as only a sheet needs it

    described = describe(file, core, basic, address, options)
    details = python_of(file.python).details if file.python else None
    return described if details is None else _loaded(details)(core, described, address, options)


def _loaded(place: Callable[..., Any] | str) -> Callable[..., Any]:
    return resolve_name(place) if isinstance(place, str) else place


@functools.cache
def _points() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(GROUP)}


def _point(name: str) -> EntryPoint:
    points = _points()
    if name not in points:
        known = ", ".join(sorted(points)) or "none"
        raise ConfigError(
            f"python = {name!r}: no installed package has registered it (group {GROUP}; known: {known}); install it"
        )
    return points[name]


@functools.cache
def python_of(name: str) -> DevicePython:
    """The Python that packages have registered under ``name``. Raises ConfigError."""
    point = _point(name)
    try:
        found = point.load()
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
    """The named values of inputs and outputs in ``telegram``, as a plant file writes them. A file with Python has none:
    its words are those that the Python names."""
    found = file.telegrams[telegram]
    return _fields(file, found, outputs=False), _fields(file, found, outputs=True)


def _fields(file: DeviceFile, telegram: Telegram, *, outputs: bool) -> dict[str, object]:
    found: dict[str, object] = {}
    at = 8 if telegram.spec.channel else 0
    for name in telegram.outputs if outputs else telegram.inputs:
        word = None if isinstance(name, int) else file.words[name]
        if word is not None and word.part not in ("control", "status") and not (outputs and word.part == "setpoint"):
            found[word.name] = field_of_word(word, at)
            for bit, number in () if outputs else word.bits.items():
                found[f"{word.name}_{bit}"] = f"bool@{at + (word.octets * 8 - 1 - number) // 8}.{number % 8}"
        at += 2 if word is None else word.octets
    return found


def field_of_word(word: WordSpec, at: int) -> str | Mapping[str, object]:
    """A word as a named value of the octets from ``at`` on."""
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
