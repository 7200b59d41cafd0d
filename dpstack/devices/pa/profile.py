"""A device file of a PA device as a profile: configurations by modules or by identifier octets."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any, Final

from dpstack.devices.pa.configurations import layout_of_telegram, modules_named, named, of_config, plugged
from dpstack.devices.pa.layout import fields_of, unit_places
from dpstack.devices.pa.model import CODINGS, PaFile
from dpstack.devices.profiles import facts_of
from dpstack.pa.simulated import KIND, KINDS
from dpstack.profile.drive_profile import DeviceProfile, OptionSpec, UnitPlace
from dpstack.profile.model.drive_type import Options, TelegramFamily
from dpstack.profile.model.jobs import LARGEST

CODING: Final = "coding"
UNITS: Final = "units"
#: options of the simulated device
_SIMULATED: Final[Mapping[str, OptionSpec]] = {
    KIND: OptionSpec(
        default="",
        choices=("", *KINDS),
        text="what it measures or moves; empty: by the blocks and the names in its file",
    ),
    "tag": OptionSpec(default="", text="TAG_DESC of its physical block, up to 32 characters"),
    "profile": OptionSpec(default=3.0, low=2, high=3, text="the profile's layout: 2, all blocks in slot 1, or 3"),
    "numbering": OptionSpec(
        default="on", choices=("on", "anew"), text="entries of its directory: numbered on, or anew in each record"
    ),
    "directory_slot": OptionSpec(default=1.0, low=0, high=1, text="slot of its directory"),
    "shifted": OptionSpec(default=False, text="its blocks stand 100 behind the index in the directory"),
    "records": OptionSpec(
        default="several", choices=("one", "several"), text="entries of its directory: in one record, or in several"
    ),
    "stroke_s": OptionSpec(default=5.0, low=0, high=3600, text="time of a valve from end to end, in seconds"),
    "answer_s": OptionSpec(default=0.0, low=0, high=60, text="time that it takes for each Read or Write, in seconds"),
    "lie": OptionSpec(default="", text="for tests of a reader: how it lies, see simulate.md"),
}
_SAFE: Final = "its safe outputs are zeros, which is bad status: a good one goes out only while a value stands"


def profile_of_pa(file: PaFile) -> DeviceProfile:
    """The device that ``file`` describes."""
    return DeviceProfile(
        **facts_of(file),
        reference_hz=0.0,
        core_factory=partial(_core, file),
        device_factory=partial(_device, file),
        core_options={**_options(file), **file.options},
        device_options={**_options(file), **_SIMULATED, **file.device_options},
        family=TelegramFamily(partial(named, file), partial(of_config, file)),
        settle=partial(_settle, file),
        plug=partial(plugged, file),
        slots=partial(_slots, file),
        pa_parameters=tuple(file.parameters.values()),
        pa_extension={bit + 1: text for bit, text in file.extension.items()},
        by_ident={ident: plugged(file, names).name for ident, names in file.profiles.items()},
        fixed_safe=_SAFE,
        check_word=_check_word,
        units=partial(_units, file),
    )


def _options(file: PaFile) -> dict[str, OptionSpec]:
    text = "coding of the status octets: classic or condensed (FEATURE of the device says which)"
    return {
        CODING: OptionSpec(default=file.coding, text=text, choices=tuple(CODINGS)),
        UNITS: OptionSpec(default=True, text="read the units of its values from its blocks, over acyclic services"),
    }


def _slots(file: PaFile, telegram: str) -> tuple[tuple[str, bytes], ...]:
    return tuple((one.name, one.config) for one in modules_named(file, telegram))


def _check_word(name: str, value: object) -> None:
    if isinstance(value, (int, float)) and abs(value) > LARGEST:
        raise ValueError(f"{name} = {value:g} is more than {LARGEST:g}")


def _core(file: PaFile, *args: Any) -> Any:
    from dpstack.devices.pa.core import PaCore  # here, as a profile is also read without its device

    return PaCore(file, *args)


def _device(file: PaFile, *args: Any) -> Any:
    from dpstack.devices.pa.device import PaDevice  # here, as few devices are simulated

    return PaDevice(file, *args)


#: where a block has the unit of its value, by its kind: relative index, octets, first octet of the unit
_UNIT_PLACES: Final = {"AI": (12, 11, 8), "AO": (11, 11, 8), "TOT": (11, 2, 0)}
#: relative index of OUT_UNIT_TEXT of an AI block
_UNIT_TEXT: Final = 35
#: relative index of ST_REV
_ST_REV: Final = 1


def _units(file: PaFile, telegram: str, options: Mapping[str, object]) -> tuple[UnitPlace, ...]:
    """The records with the units of the named values; none with ``units = false``."""
    found: dict[tuple[int, int], UnitPlace] = {}
    if not options.get(UNITS, True):
        return ()
    for place in unit_places(layout_of_telegram(file, telegram)):
        slot = place.slot
        if slot.block not in _UNIT_PLACES:
            continue
        relative, octets, at = _UNIT_PLACES[slot.block]
        key = slot.block_slot, slot.block_index
        before = found.get(key)
        names = (place.name,) if before is None else (*before.names, place.name)
        text = slot.block_index + _UNIT_TEXT if slot.block == "AI" else None
        record, revision = slot.block_index + relative, slot.block_index + _ST_REV
        found[key] = UnitPlace(names, slot.block_slot, record, octets, at, revision, text)
    return tuple(found.values())


def _settle(
    file: PaFile,
    profile: DeviceProfile,
    telegram: str,
    given: Mapping[str, object],
    octets: bytes,
    values: Mapping[str, int],
) -> tuple[DeviceProfile, dict[str, object], tuple[str, ...]]:
    """The profile with its named values in the coding of its options. Raises ConfigError for wrong options."""
    options: Options = profile.checked_options(given)
    coding = CODINGS[str(options[CODING])]
    settled = dataclasses.replace(profile, fields=lambda name: fields_of(file, layout_of_telegram(file, name), coding))
    return settled, dict(given), ()
