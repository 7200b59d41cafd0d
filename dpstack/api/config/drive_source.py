"""A [[slave]] table with a drive or a device, alone or with its maker's GSD file. Loaded if a slave has such a key."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from msgspec import structs

from dpstack.api.config.slave_source import REFERENCES, Basis, Who, leave_out, need_gsd
from dpstack.devices import finding
from dpstack.dp.slave_params import DriveTelegrams, SlaveParams
from dpstack.errors import GsdError
from dpstack.profile import DriveProfile, TelegramSpec
from dpstack.profile.drive_profile import DeviceProfile
from dpstack.toml.table import Table

if TYPE_CHECKING:
    from dpstack.gsd.configuration import Configuration
    from dpstack.gsd.diag_texts import DiagTexts


def basis_of_profile(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    """The basis of a slave with the key ``drive`` or ``device``. Raises ConfigError."""
    key = "device" if "device" in given else "drive"
    leave_out(table, "config", f"beside {key}", f"leave config out: it follows from {key} and telegram")
    profile: DriveProfile | DeviceProfile
    if key == "device":
        leave_out(table, "drive", "beside device", "leave one of them out")
        for name in REFERENCES:
            leave_out(table, name, "is for drives", f"leave {name} out")
        with table.blaming(key):
            profile = finding.find_device(given[key], table.folder)
    else:
        with table.blaming(key):
            profile = finding.find(given[key], table.folder)
    with table.blaming("telegram"):
        telegram = profile.telegram(given.get("telegram"))
    by_gsd: Basis | None = None
    if "gsd" not in given and profile.gsd_file is not None:
        given = {**given, "gsd": profile.gsd_file}
    if "gsd" not in given and isinstance(profile, DeviceProfile) and profile.plug is not None:
        need_gsd(table, leaving="modules")
        if "modules" in given:
            leave_out(table, "telegram", "beside modules", "leave one of them out")
            with table.blaming("modules"):
                telegram = profile.plug(given["modules"])
        elif "telegram" not in given:
            telegram = profile.telegram(profile.by_ident.get(_ident(given), telegram.name))
    elif "gsd" not in given:
        need_gsd(table)
    if "gsd" in given:
        from dpstack.api.config.gsd_source import read_gsd_slave  # these here, as most drives need no GSD file
        from dpstack.gsd.configuration import configuration_like

        like = telegram.config, _lengths(telegram)
        if "modules" not in given and telegram.name in profile.modules:
            given = {**given, "modules": profile.modules[telegram.name]}
        configuration, by_gsd = read_gsd_slave(
            table, given, who, lambda device, own_prm: configuration_like(device, *like, own_prm=own_prm)
        )
        telegram = _telegram_for(table, profile, telegram, configuration)
        # the GSD file has priority over the plugin
        profile = profile.described(telegram, by_gsd[0], tuple(sorted(by_gsd[1]["baud_rates"])))
        telegram = profile.telegram(telegram.name)
    references = {name: given[name] for name in REFERENCES if name in given}
    options = given.get("options", {}) | references
    remarks: tuple[str, ...] = ()
    if isinstance(profile, DeviceProfile) and profile.settle is not None:
        octets = given.get("user_prm", profile.user_prm if by_gsd is None else by_gsd[0].user_prm)
        values = _values(by_gsd, octets)
        with table.blaming("options"):
            profile, options, remarks = profile.settle(profile, telegram.name, options, octets, values)
    simulated = given.get("simulated", {})
    with table.blaming(next(iter(references), "options")):
        core = profile.core(who["name"], telegram.name, options)
    # a simulated drive that nothing in the file changes has nothing to check: its module is loaded when it is simulated
    changes = by_gsd is not None or profile.shared(options)
    if "simulated" in given or (profile.device_factory is not None and changes):
        with table.blaming("simulated"):
            profile.simulated(telegram.name, options, simulated)
    rest = {
        "profile" if isinstance(profile, DriveProfile) else "device_profile": profile,
        "telegram": telegram.name,
        "options": options,
        "simulated": simulated,
        "baud_rates": frozenset(profile.rates(options)),
    }
    if by_gsd is not None:
        known, rest = by_gsd[0], by_gsd[1] | rest
        remarks = (*rest["notes"], *remarks)
    else:
        with table.blaming():
            known = params_by_profile(profile, who, telegram.config)
    if remarks:
        rest["notes"] = remarks
    if isinstance(profile, DeviceProfile) and profile.slots is not None:
        known = structs.replace(known, texts=_pa_texts(known.texts, profile, profile.slots(telegram.name)))
    if isinstance(profile, DeviceProfile) and (profile.alarms or profile.warnings):
        known = structs.replace(known, texts=_texts(known.texts, profile))
    telegrams = _telegrams(profile, telegram)
    known = structs.replace(
        known,
        safe=core.safe_outputs,
        on_loss=profile.on_loss,
        telegrams=telegrams,
        after_return="safe",  # also if the application makes its outputs octet by octet
    )
    return known, rest


def _ident(given: Mapping[str, Any]) -> int:
    """The ident number of the plant file; -1 without one."""
    ident = given.get("ident")
    found = ident.get("configured", -1) if isinstance(ident, Mapping) else ident
    return found if isinstance(found, int) else -1


def params_by_profile(profile: DriveProfile | DeviceProfile, who: Who, config: bytes) -> SlaveParams:
    """The parameters of a slave with these identifier octets that no GSD file describes. Raises ConfigError."""
    return SlaveParams(
        **who,
        ident=profile.ident,
        config=config,
        user_prm=profile.user_prm,
        min_slave_interval_ns=profile.min_slave_interval_ns,
        fail_safe=profile.fail_safe,
        max_tsdr=profile.max_tsdr,
    )


def _values(by_gsd: Basis | None, octets: bytes) -> dict[str, int]:
    """The user parameters by name, as the GSD file reads them; empty without one, or for octets of another length."""
    if by_gsd is None:
        return {}
    from dpstack.gsd.prm import UserPrm

    rest = by_gsd[1]
    with contextlib.suppress(GsdError):
        fields = UserPrm(rest["device"], rest["modules"]).read(octets)
        return {field.parameter.name: field.value for field in fields}
    return {}


def _texts(known: DiagTexts | None, profile: DeviceProfile) -> DiagTexts:
    """The texts of the GSD file and those of the profile."""
    from dpstack.gsd.diag_texts import DiagTexts
    from dpstack.gsd.model import Device, DiagText

    alarms, warnings = (
        [DiagText("bit", bit, bit, 1, text, "") for bit, text in one.items()]
        for one in (profile.alarms, profile.warnings)
    )
    device, modules = (Device(), ()) if known is None else (known.device, known.modules)
    return DiagTexts(device, modules, alarms, warnings)


def _pa_texts(known: DiagTexts | None, profile: DeviceProfile, slots: Iterable[tuple[str, bytes]]) -> DiagTexts:
    """The texts of the GSD file, without one the modules by names and identifier octets; and those of the profile."""
    from dpstack.gsd.diag_texts import DiagTexts
    from dpstack.gsd.model import Device, Module

    if known is not None:
        return DiagTexts(known.device, known.modules, pa_extension=profile.pa_extension)
    modules = [Module(name=name, config=octets) for name, octets in slots]
    return DiagTexts(Device(), modules, pa_extension=profile.pa_extension)


def _telegrams(profile: DriveProfile | DeviceProfile, configured: TelegramSpec) -> DriveTelegrams:
    """The words for a drive that is set to another telegram than ``configured``."""

    def named(config: bytes) -> str:
        found = profile.telegrams_of(config)
        return found[0].name if len(found) == 1 else ""

    setting = profile.telegram_setting
    if setting is None:
        return DriveTelegrams(configured.name, named, {})
    values = {name: f"{setting.parameter} = {value}" for name, value in setting.values.items()}
    return DriveTelegrams(configured.name, named, values, setting.acts)


def _telegram_for(
    table: Table, profile: DriveProfile | DeviceProfile, default: TelegramSpec, chosen: Configuration
) -> TelegramSpec:
    """The telegram of the ``chosen`` modules: the named one, else the one with their identifier octets or lengths."""
    lengths, octets = (chosen.inputs, chosen.outputs), chosen.config.hex(" ").upper()
    if "telegram" in table or "modules" not in table:
        if _lengths(default) != lengths:
            table.fail(
                "telegram" if "telegram" in table else "gsd",
                f"the modules {octets} have {lengths[0]} octets of inputs and {lengths[1]} of outputs, "
                f"{default.name} has {default.input_octets} and {default.output_octets}",
                "name the modules that it is made of",
            )
        return default
    fitting = profile.telegrams_of(chosen.config) or tuple(
        spec for spec in profile.telegrams.values() if _lengths(spec) == lengths
    )
    if len(fitting) == 1:
        return fitting[0]
    names = " or ".join(spec.name for spec in fitting)
    raise table.error(
        "modules",
        f"the modules {octets} have {lengths[0]} octets of inputs and {lengths[1]} of outputs: "
        + (f"that may be {names}" if names else f"no telegram of {profile.name}"),
        f'add telegram = "{fitting[0].name}"' if fitting else "name the modules of a telegram, or leave drive out",
    )


def _lengths(telegram: TelegramSpec) -> tuple[int, int]:
    return telegram.input_octets, telegram.output_octets
