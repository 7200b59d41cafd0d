"""The commissioning sheet of a device file: its facts over those that the core has by itself."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import structs

from dpstack.devices.drive_core import DeclaredCore
from dpstack.devices.maps import MapWay
from dpstack.devices.model import DeviceFile, Messages, Step, Telegram, filled
from dpstack.profile.core_description import speed_range
from dpstack.profile.master.core import DriveCore
from dpstack.profile.master.mapped_core import MappedCore
from dpstack.profile.model.description import (
    DescribedMessage,
    DescribedPlace,
    DescribedStep,
    DeviceDescription,
    messages,
    places,
)
from dpstack.profile.model.drive_type import Options
from dpstack.profile.model.process_data_map import FieldMap

#: the maps of inputs and outputs, with those of a core
Maps = tuple[tuple[MapWay, FieldMap], ...]


def describe(
    file: DeviceFile, core: DriveCore, basic: DeviceDescription, address: int, options: Options
) -> DeviceDescription:
    """The device of ``core`` at the station ``address``."""
    telegram = file.telegrams.get(core.telegram.name)
    facts = dict(options) | {
        "address": address,
        "tens": address // 10,
        "ones": address % 10,
        "telegram": core.telegram.name,
        "number": None if telegram is None else telegram.number,
    }
    if file.bus.rate_setting is not None:
        facts["rate"] = file.bus.rate_setting.rates[int(options[file.bus.rate_setting.option])]
    facts = {name: int(one) if isinstance(one, float) and one.is_integer() else one for name, one in facts.items()}
    counted = [one for one in file.steps if _counts(one, facts)]
    settings = basic.steps[1:] if core.address_parameter and any(map(_has_address, counted)) else basic.steps
    compared = {one.what for one in settings}
    before, behind = (
        [step for one in counted if one.first is first and (step := _step(one, facts)).what not in compared]
        for first in (True, False)
    )
    speeds = telegram is None or any(
        isinstance(word, str) and file.words[word].part == "setpoint" for word in telegram.outputs
    )
    maps = tuple(zip(file.maps or (), core.present_maps() if isinstance(core, MappedCore) else (), strict=False))
    source, reference = file.source or f"the device file {file.path.name}", file.reference
    described = structs.replace(
        basic,
        manual=source,
        steps=(*before, *settings, *behind),
        words=tuple(
            structs.replace(
                word,
                name=file.words[part].title or word.name if word.name == f"{part} word" else word.name,
                codes=file.codes.get(part) or word.codes,
            )
            for word, part in zip(basic.words, ("control", "status"), strict=True)
        ),
        ranges=(
            *((speed_range(core, reference.source or source, reference.meaning or "the reference"),) if speeds else ()),
            *file.ranges,
            *(one for way, own in reversed(maps) for one in way.ranges(own.fields)),
        ),
        faults=_messages(file.fault, source),
        warnings=_messages(file.warning, source),
        acknowledge=file.acknowledge,
        errors=messages(core.dialect.errors, file.channel.sheet, file.channel.source or source) if basic.errors else (),
        leds=file.leds,
        missing=file.missing,
    )
    if not isinstance(core, DeclaredCore) or (telegram is None and not maps):
        return described
    return structs.replace(
        described,
        outputs=_places(file, core, telegram, maps, outputs=True),
        inputs=_places(file, core, telegram, maps, outputs=False),
    )


def _places(
    file: DeviceFile, core: DeclaredCore, telegram: Telegram | None, maps: Maps, *, outputs: bool
) -> tuple[DescribedPlace, ...]:
    """With maps the words without a name are theirs."""
    names = []
    for one in () if telegram is None else telegram.outputs if outputs else telegram.inputs:
        if not isinstance(one, int):
            word = file.words[one]
            names.append((core.place_name(one, word.title or one, outputs=outputs), word.octets))
        elif not maps:
            names.append((f"{one:04X}h", 2))
    if maps:
        way, own = maps[outputs]
        names += way.places(own.fields)
    return places(core.telegram, outputs=outputs, names=names)


def _has_address(step: Step) -> bool:
    return any(f"{{{place}}}" in step.what for place in ("address", "tens", "ones"))


def _counts(step: Step, facts: Mapping[str, object]) -> bool:
    """Whether all of its conditions are true."""
    for name, wanted in step.when.items():
        value = facts[name]
        if isinstance(wanted, list) and len(wanted) == 2 and isinstance(value, (int, float)):
            if not wanted[0] <= value <= wanted[1]:
                return False
        elif value != wanted:
            return False
    return True


def _step(step: Step, facts: Mapping[str, object]) -> DescribedStep:
    what, why, delivered = (filled(one, facts) for one in (step.what, step.why, step.delivered))
    return DescribedStep(what=what, why=why, delivered=delivered, source=step.source)


def _messages(found: Messages, source: str) -> tuple[DescribedMessage, ...]:
    return tuple(
        DescribedMessage(
            code=filled(
                found.sheet,
                {"code": one.code, "number": number, "mask": 1 << (number & 31), "malfunction": one.malfunction or 0},
            ),
            text=one.text,
            remedy=one.remedy,
            source=found.source or source,
        )
        for number, one in found.facts.items()
    )
