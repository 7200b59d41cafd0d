"""The base of a [[slave]] table: known drive, GSD file, a drive with its maker's GSD file, or octets."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final, TypeAlias

from dpstack.api.config.gsd_slave import GsdSlave, Who, read_gsd_slave
from dpstack.api.config.table import Table
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.fdl.telegram import MAX_DATA
from dpstack.gsd.configuration import configuration_like
from dpstack.gsd.identifiers import io_lengths
from dpstack.profile import DriveProfile, TelegramSpec, registry

#: what is known of a slave before its own keys count, and the fields of a SlaveConfig that go with it
Basis: TypeAlias = tuple[SlaveParams, dict[str, Any]]
#: keys that mean something beside ``gsd`` only, and beside ``drive`` only
_GSD_KEYS: Final = ("modules", "parameters", "defaults")
_REFERENCES: Final = ("reference_hz", "reference_rpm")
_DRIVE_KEYS: Final = ("telegram", *_REFERENCES, "options", "simulated")


def basis_of(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    """Of the slave whose keys are ``given`` in ``table``. Raises ConfigError, one line."""
    if "gsd" in given:
        _leave_out(table, "config", "beside gsd", "leave config out, or gsd")
    else:
        for key in _GSD_KEYS:
            _leave_out(table, key, "without gsd", f"name the GSD file, or leave {key} out")
    if "drive" in given:
        return _drive(table, given, who)
    for key in _DRIVE_KEYS:
        _leave_out(table, key, "without drive", f"add drive, or leave {key} out")
    return _gsd(table, given, who) if "gsd" in given else _raw(table, given, who)


def _gsd(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    found = read_gsd_slave(table, given, who)
    _check_ident(table, given, found)
    description = slave_description(found.device, found.configuration, ident=found.device.ident or 0)
    return found.params, _of_gsd(found) | {"baud_rates": found.baud_rates, "description": description}


def _of_gsd(found: GsdSlave) -> dict[str, Any]:
    return {"device": found.device, "notes": found.notes}


def _drive(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    _leave_out(table, "config", "beside drive", "leave config out: it follows from drive and telegram")
    with table.blaming("drive"):
        profile = registry.find(given["drive"])
    with table.blaming("telegram"):
        telegram = profile.telegram(given.get("telegram"))
    found: GsdSlave | None = None
    if "gsd" in given:
        like = telegram.config, _lengths(telegram)
        found = read_gsd_slave(table, given, who, lambda device: configuration_like(device, *like))
        _check_ident(table, given, found)
        telegram = _telegram_for(table, profile, telegram, found)
        # what a GSD file says goes before what the plugin knows
        profile = profile.described(telegram, found.params, tuple(sorted(found.baud_rates)))
        telegram = profile.telegram(telegram.name)
    references = {key: given[key] for key in _REFERENCES if key in given}
    options = given.get("options", {}) | references
    simulated = given.get("simulated", {})
    with table.blaming(next(iter(references), "options")):
        core = profile.core(who["name"], telegram.name, options)
    with table.blaming("simulated"):
        profile.device(telegram.name, {**profile.shared(options), **simulated})
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
    known = dataclasses.replace(
        known if found is None else found.params, safe=core.safe_outputs, on_loss=profile.on_loss
    )
    rest = {
        "profile": profile,
        "telegram": telegram.name,
        "options": options,
        "simulated": simulated,
        "baud_rates": frozenset(profile.rates(options)),
    }
    return known, rest if found is None else rest | _of_gsd(found)


def _telegram_for(table: Table, profile: DriveProfile, default: TelegramSpec, found: GsdSlave) -> TelegramSpec:
    """The telegram that the modules are: the one that is named, else known by the identifier octets or the lengths."""
    chosen = found.configuration
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


def _raw(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    if "config" not in given:
        table.fail(
            None,
            "neither drive nor config",
            'name a drive or a GSD file, or give ident and config (identifier octets, "20 10")',
        )
    config = given["config"]
    with table.blaming("config", "config: "):
        io_lengths(config)
    if not 1 <= len(config) <= MAX_DATA:
        table.fail("config", f"config has {len(config)} octets", f"1..{MAX_DATA} are possible")
    if "ident" not in given:
        table.fail(None, "no ident", 'add ident = 0x1234 (from its GSD file), or ident = "ask"')
    return SlaveParams(**who, ident=None, config=config), {}


def _leave_out(table: Table, key: str, why: str, todo: str) -> None:
    if key in table:
        table.fail(key, f"{key} {why}", todo)


def _check_ident(table: Table, given: Mapping[str, Any], found: GsdSlave) -> None:
    if found.device.ident is None and "ident" not in given:
        table.fail("gsd", f"{given['gsd']} has no Ident_Number", 'add ident = 0x1234, or ident = "ask"')


def _lengths(telegram: TelegramSpec) -> tuple[int, int]:
    return telegram.input_octets, telegram.output_octets
