"""The commissioning sheet of a device file: its facts over those that the core has by itself."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import structs

from dpstack.devices.drive_core import DeclaredCore
from dpstack.devices.model import DeviceFile, Messages, Step, Telegram, filled
from dpstack.profile.core_description import speed_range
from dpstack.profile.master.core import DriveCore
from dpstack.profile.model.description import (
    DescribedMessage,
    DescribedPlace,
    DescribedStep,
    DeviceDescription,
    messages,
    places,
)
from dpstack.profile.model.drive_type import Options


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
    counted = [one for one in file.steps if _counts(one, facts)]
    before, behind = ([_step(one, facts) for one in counted if one.first is first] for first in (True, False))
    settings = basic.steps[1:] if core.address_parameter and any(map(_has_address, counted)) else basic.steps
    source, reference = file.source or f"the device file {file.path.name}", file.reference
    described = structs.replace(
        basic,
        manual=source,
        steps=(*before, *settings, *behind),
        ranges=(
            speed_range(core, reference.source or source, reference.meaning or "the reference"),
            *file.ranges,
        ),
        faults=_messages(file.fault, source),
        warnings=_messages(file.warning, source),
        acknowledge=file.acknowledge,
        errors=messages(core.dialect.errors, "{}", file.channel.source or source) if basic.errors else (),
        leds=file.leds,
        missing=file.missing,
    )
    if telegram is None or not isinstance(core, DeclaredCore):
        return described
    return structs.replace(
        described,
        outputs=_places(file, core, telegram, outputs=True),
        inputs=_places(file, core, telegram, outputs=False),
    )


def _places(file: DeviceFile, core: DeclaredCore, telegram: Telegram, *, outputs: bool) -> tuple[DescribedPlace, ...]:
    names = []
    for one in telegram.outputs if outputs else telegram.inputs:
        if isinstance(one, int):
            names.append((f"{one:04X}h", 2))
        else:
            word = file.words[one]
            names.append((core.place_name(one, word.title or one, outputs=outputs), word.octets))
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
