"""A [[slave]] table with a drive, alone or with its maker's GSD file. Loaded if a slave has the key ``drive``."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from dpstack.api.config.slave_source import REFERENCES, Basis, Who, leave_out
from dpstack.devices import finding
from dpstack.dp.slave_params import DriveTelegrams, SlaveParams
from dpstack.gsd.configuration import Configuration, configuration_like
from dpstack.profile import DriveProfile, TelegramSpec
from dpstack.toml.table import Table


def basis_of_drive(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    leave_out(table, "config", "beside drive", "leave config out: it follows from drive and telegram")
    with table.blaming("drive"):
        profile = finding.find(given["drive"], table.folder)
    with table.blaming("telegram"):
        telegram = profile.telegram(given.get("telegram"))
    by_gsd: Basis | None = None
    if "gsd" not in given and profile.gsd_file is not None:
        given = {**given, "gsd": profile.gsd_file}
    if "gsd" in given:
        from dpstack.api.config.gsd_source import read_gsd_slave  # here, as most drives need no GSD file

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
    references = {key: given[key] for key in REFERENCES if key in given}
    options = given.get("options", {}) | references
    simulated = given.get("simulated", {})
    with table.blaming(next(iter(references), "options")):
        core = profile.core(who["name"], telegram.name, options)
    if profile.device_factory is not None or "simulated" in given:
        with table.blaming("simulated"):
            profile.simulated(telegram.name, options, simulated)
    rest = {
        "profile": profile,
        "telegram": telegram.name,
        "options": options,
        "simulated": simulated,
        "baud_rates": frozenset(profile.rates(options)),
    }
    if by_gsd is not None:
        known, rest = by_gsd[0], by_gsd[1] | rest
    else:
        with table.blaming():
            known = SlaveParams(
                **who,
                ident=profile.ident,
                config=telegram.config,
                user_prm=profile.user_prm,
                min_slave_interval_ns=profile.min_slave_interval_ns,
                fail_safe=profile.fail_safe,
                max_tsdr=profile.max_tsdr,
            )
    telegrams = _telegrams(profile, telegram)
    known = dataclasses.replace(
        known,
        safe=core.safe_outputs,
        on_loss=profile.on_loss,
        telegrams=telegrams,
        after_return="safe",  # also if the application makes its outputs octet by octet
    )
    return known, rest


def _telegrams(profile: DriveProfile, configured: TelegramSpec) -> DriveTelegrams:
    """The words for a drive that is set to another telegram than ``configured``."""

    def named(config: bytes) -> str:
        found = profile.telegrams_of(config)
        return found[0].name if len(found) == 1 else ""

    setting = profile.telegram_setting
    if setting is None:
        return DriveTelegrams(configured.name, named, {})
    values = {name: f"{setting.parameter} = {value}" for name, value in setting.values.items()}
    return DriveTelegrams(configured.name, named, values, setting.acts)


def _telegram_for(table: Table, profile: DriveProfile, default: TelegramSpec, chosen: Configuration) -> TelegramSpec:
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
