"""The description of a drive that its core has by itself, without the facts of its manual."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from dpstack.profile.channel.base import ParamKey
from dpstack.profile.master.core import DriveCore
from dpstack.profile.master.settings import Setting
from dpstack.profile.model.description import (
    Check,
    DescribedMessage,
    DescribedRange,
    DescribedStep,
    DeviceDescription,
    delivered,
    described_parameters,
    described_telegram,
    described_word,
    messages,
    places,
    states_of,
)
from dpstack.profile.model.drive_type import TelegramSpec
from dpstack.profile.model.params import ParamSpec, ParamTable

#: source of a fact that the plugin has from its author
_PLUGIN: Final = "the drive plugin"


def describe_core(
    core: DriveCore, address: int, title: str, telegrams: Mapping[str, TelegramSpec]
) -> DeviceDescription:
    """The drive of ``core`` at the station ``address``; ``title``: maker and type, ``telegrams``: all of the drive."""
    table = core.table
    parameters = core.parameter_table
    in_use = core.telegram
    return DeviceDescription(
        title=title,
        steps=(*_address_step(core, address), *(setting_step(one, parameters) for one in core.all_settings())),
        telegrams=tuple(described_telegram(spec) for spec in ({in_use.name: in_use} | dict(telegrams)).values()),
        telegram=in_use.name,
        outputs=places(in_use, outputs=True, names=(table.control.name, "set point")),
        inputs=places(in_use, outputs=False, names=(table.status.name, *core.inputs[1:])),
        words=(described_word(table.control), described_word(table.status, states_of(table))),
        ranges=(speed_range(core),),
        faults=messages(core.fault_names, "{}", _PLUGIN),
        warnings=messages(core.warning_names, "{}" if core.warning_numbers else "bit {}", _PLUGIN),
        errors=() if parameters is None else _errors(core),
        parameters=() if parameters is None else described_parameters(_listed(core, parameters)),
    )


def _errors(core: DriveCore) -> tuple[DescribedMessage, ...]:
    dialect = core.dialect
    return tuple(
        DescribedMessage(code=dialect.code(number), text=text, source=_PLUGIN)
        for number, text in dialect.errors.items()
    )


def _listed(core: DriveCore, table: ParamTable) -> Iterable[ParamSpec]:
    """The parameters of the table that the plugin lists."""
    listed = {(one.number, one.subindex) for one in core.parameters()}
    return (spec for spec in table if (spec.number, spec.index) in listed)


def setting_step(setting: Setting, parameters: ParamTable | None) -> DescribedStep:
    """A setting that the plugin compares. The setting at delivery stands there if it is a single parameter."""
    found = [_spec(key, parameters) for key in setting.keys]
    return DescribedStep(
        what=setting.wanted,
        why=setting.why or "the plugin relies on it",
        delivered=delivered(found[0]) if len(found) == 1 else "",
        check=Check.REFUSED if setting.refuse else Check.NOTICE,
        source=setting.source or _PLUGIN,
    )


def _spec(key: ParamKey, parameters: ParamTable | None) -> ParamSpec | None:
    if parameters is None:
        return None
    return parameters.named(key.name) if isinstance(key.name, str) else parameters.get(key.name)


def _address_step(core: DriveCore, address: int) -> Iterable[DescribedStep]:
    """The station address, if a parameter holds it."""
    if not core.address_parameter:
        return ()
    spec = None if core.parameter_table is None else core.parameter_table.named(core.address_parameter)
    what = core.address_parameter if spec is None else spec.label
    acts = f"; it takes effect {core.address_acts}" if core.address_acts else ""
    why = f"the master asks for the drive at this station address{acts}"
    return (DescribedStep(what=f"{what} = {address}", why=why, delivered=delivered(spec), source=_PLUGIN),)


def speed_range(core: DriveCore, source: str = _PLUGIN, meaning: str = "the reference") -> DescribedRange:
    """Range and scale of set point and actual speed in Hz; ``meaning`` names what 100 % is in the drive."""
    full, reference, unit = core.scale.encode(1.0), core.reference_hz, "Hz"
    if not reference:
        reference, unit = (core.reference_rpm, "rpm") if core.reference_rpm else (100.0, "%")
    low, high = (part * reference for part in core.scale.limits)
    return DescribedRange(
        name="set point, actual speed",
        range=f"{low:g}..{high:.6g} {unit}",
        wire=f"{full:04X}h = {reference:g} {unit} ({meaning}), two's complement",
        source=source,
    )
