"""The base of a [[slave]] table: a known drive, a GSD file, a drive with its maker's GSD file, or octets.

Also the remarks about a function that a GSD file requires of the master and that the configuration switches off: the
bus allows this, but the device may not work.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, TypeAlias, TypedDict

from dpstack.api.config.table import Key, Table, is_integer
from dpstack.api.gsd_info import read_gsd
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN
from dpstack.dp.pdu.dpv1_status import DPV1_STATUS_LEN, Dpv1
from dpstack.dp.pdu.requests import SET_PRM_LEN
from dpstack.dp.slave_params import INTERVAL_UNIT, SlaveParams
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.fdl.telegram import MAX_DATA
from dpstack.gsd.configuration import Configuration, configuration_like, configure
from dpstack.gsd.identifiers import io_lengths
from dpstack.gsd.model import ALARM_KEYWORDS, Device
from dpstack.gsd.prm import Reading, UserPrm
from dpstack.profile import DriveProfile, TelegramSpec, registry

#: the parameters of a slave before its own keys count, and the fields of a SlaveConfig that go with them
Basis: TypeAlias = tuple[SlaveParams, dict[str, Any]]
#: keys that need the key ``gsd``, and keys that need the key ``drive``
_GSD_KEYS: Final = ("modules", "parameters", "defaults")
_REFERENCES: Final = ("reference_hz", "reference_rpm")
_DRIVE_KEYS: Final = ("telegram", *_REFERENCES, "options", "simulated")
_OTHER: Final = {Reading.REFS: Reading.CONST, Reading.CONST: Reading.REFS}
#: most octet numbers in a message about two readings of a file
_SHOWN_OCTETS: Final = 8
_ON: Final = "leave dpv1 out, or say dpv1 = true"


class Who(TypedDict):
    """Address and name of the slave, for messages."""

    address: int
    name: str


def basis_of(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    """The basis of the slave whose keys are ``given`` in ``table``. Raises ConfigError, one line."""
    if "gsd" in given:
        _leave_out(table, "config", "beside gsd", "leave config out, or gsd")
    else:
        for key in _GSD_KEYS:
            _leave_out(table, key, "without gsd", f"name the GSD file, or leave {key} out")
    if "drive" in given:
        return _basis_of_drive(table, given, who)
    for key in _DRIVE_KEYS:
        _leave_out(table, key, "without drive", f"add drive, or leave {key} out")
    return _basis_of_gsd(table, given, who) if "gsd" in given else _basis_of_octets(table, given, who)


def _basis_of_gsd(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    configuration, (params, rest) = read_gsd_slave(table, given, who)
    device = configuration.device
    return params, rest | {"description": slave_description(device, configuration, ident=device.ident or 0)}


def _basis_of_drive(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    _leave_out(table, "config", "beside drive", "leave config out: it follows from drive and telegram")
    with table.blaming("drive"):
        profile = registry.find(given["drive"])
    with table.blaming("telegram"):
        telegram = profile.telegram(given.get("telegram"))
    by_gsd: Basis | None = None
    if "gsd" in given:
        like = telegram.config, _lengths(telegram)
        configuration, by_gsd = read_gsd_slave(table, given, who, lambda device: configuration_like(device, *like))
        telegram = _telegram_for(table, profile, telegram, configuration)
        # the GSD file has priority over the plugin
        profile = profile.described(telegram, by_gsd[0], tuple(sorted(by_gsd[1]["baud_rates"])))
        telegram = profile.telegram(telegram.name)
    references = {key: given[key] for key in _REFERENCES if key in given}
    options = given.get("options", {}) | references
    simulated = given.get("simulated", {})
    with table.blaming(next(iter(references), "options")):
        core = profile.core(who["name"], telegram.name, options)
    with table.blaming("simulated"):
        profile.device(telegram.name, {**profile.shared(options), **simulated})
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
    return dataclasses.replace(known, safe=core.safe_outputs, on_loss=profile.on_loss), rest


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


def _basis_of_octets(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
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


def _lengths(telegram: TelegramSpec) -> tuple[int, int]:
    return telegram.input_octets, telegram.output_octets


def read_gsd_slave(
    table: Table, given: Mapping[str, Any], who: Who, preset: Callable[[Device], Configuration] = configure
) -> tuple[Configuration, Basis]:
    """Read the GSD file (relative to the configuration), plug its modules and set its parameters.

    ``preset`` returns the configuration for a table without ``modules``; it may raise GsdError. Raises ConfigError, one
    line.
    """
    with table.blaming("gsd"):
        device = read_gsd(given["gsd"], table.folder).device
    reading = Reading(given.get("defaults", Reading.REFS))
    with table.blaming("modules" if "modules" in given else "gsd"):
        configuration = configure(device, given["modules"]) if "modules" in given else preset(device)
        prm = configuration.user_prm(reading)
    parameters = given.get("parameters", {})
    _set_parameters(table, parameters, prm)
    octets = _own_user_prm(table, given, prm)
    notes = list(configuration.notes)
    differing = [contradiction for contradiction in prm.contradictions() if contradiction.matters]
    if differing and octets is None and "defaults" not in given:
        count = f"{len(differing)} parameters" if len(differing) > 1 else "one parameter"
        notes.append(
            f"in its GSD file the defaults of {count} contradict the constant octets (the first: "
            f'{differing[0].text}); the defaults are used, defaults = "const" takes the constants'
        )
    note = ""
    if octets is None:
        octets, others = prm.octets(), configuration.user_prm(_OTHER[reading])
        _set_parameters(table, parameters, others)
        note = _contradictions_note(reading, octets, others.octets())
    has_status = device.dpv1.slave and len(octets) >= DPV1_STATUS_LEN
    # a device that requires empty frames in Clear can receive them, too
    fail_safe = device.fail_safe or device.dpv1.fail_safe_required
    longest = device.max_diag_data_len
    with table.blaming():
        params = SlaveParams(
            **who,
            ident=device.ident,
            config=configuration.config,
            user_prm=octets,
            fail_safe=fail_safe,
            fail_safe_told=has_status and fail_safe,
            wd_base_1ms=has_status and device.dpv1.wd_base_1ms,
            min_slave_interval_ns=(device.min_slave_interval or 0) * INTERVAL_UNIT,
            max_tsdr={speed.baud: speed.max_tsdr for speed in device.speeds if speed.max_tsdr is not None},
            max_diag_len=None if longest is None else min(max(FIXED_LEN, longest), MAX_LEN),
            texts=configuration.texts(),
            prm_note=note,
        )
    if device.ident is None and "ident" not in given:
        table.fail("gsd", f"{given['gsd']} has no Ident_Number", 'add ident = 0x1234, or ident = "ask"')
    rates = frozenset(speed.baud for speed in device.speeds)
    rest = {"device": device, "gsd": given["gsd"], "modules": configuration.modules}
    return configuration, (params, rest | {"notes": tuple(notes), "baud_rates": rates})


def _contradictions_note(reading: Reading, octets: bytes, others: bytes) -> str:
    """The text about the octets of Set_Prm in which defaults and constants of the file contradict each other."""
    pairs = enumerate(zip(octets, others, strict=True), SET_PRM_LEN + 1)
    differing = [str(number) for number, (mine, its) in pairs if mine != its]
    if not differing:
        return ""
    shown = ", ".join(differing[:_SHOWN_OCTETS]) + (" ..." if len(differing) > _SHOWN_OCTETS else "")
    taken = ("defaults", "constants") if reading is Reading.REFS else ("constants", "defaults")
    return (
        f"in its GSD file defaults and constants contradict each other (octet{'s' * (len(differing) > 1)} {shown} of "
        f'Set_Prm): the {taken[0]} were sent, defaults = "{_OTHER[reading].value}" sends the {taken[1]}, as some '
        f"devices need it"
    )


def modules_of(table: Table, name: str, _: Key) -> list[int | str]:
    """Reader of ``modules``."""
    value = table.raw(name)
    if not isinstance(value, list) or not all(isinstance(one, str) or is_integer(one) for one in value):
        table.fail(name, f"{name} = {value!r} is no list of names and numbers", 'write modules = ["8 DO", 12]')
    return list(value)


def _set_parameters(table: Table, parameters: Mapping[str, object], prm: UserPrm) -> None:
    for name, wanted in parameters.items():
        if not isinstance(wanted, (int, str)):
            table.fail("parameters", f"parameter {name!r} = {wanted!r}", "give a number or a text of its list")
        with table.blaming("parameters"):
            prm.set(name, wanted)


def _own_user_prm(table: Table, given: Mapping[str, Any], prm: UserPrm) -> bytes | None:
    """``user_prm`` of the table, which replaces the parameters of the file; None: it has none."""
    octets: bytes | None = given.get("user_prm")
    if octets is None:
        return None
    if "parameters" in given:
        table.fail("user_prm", "user_prm beside parameters", "give one of them")
    expected, limit = len(prm.octets()), prm.device.max_user_prm_data_len
    if expected and len(octets) != expected:
        table.fail(
            "user_prm", f"user_prm has {len(octets)} octets", f"with these modules {expected} are wanted; correct it"
        )
    if limit is not None and len(octets) > limit:
        table.fail("user_prm", f"user_prm has {len(octets)} octets", f"Max_User_Prm_Data_Len is {limit}; shorten it")
    return octets


def remarks(device: Device | None, dpv1: Dpv1 | None) -> Iterator[str]:
    """Remarks for people, without the name of the slave. ``dpv1``: the DP-V1 settings in use, None: no DP-V1."""
    if device is None:
        return
    said = device.dpv1
    if said.slave and dpv1 is None:
        if said.c1_read_write_required:
            yield f"dpv1 is off, but its GSD file says C1_Read_Write_required = 1: it counts on Read and Write; {_ON}"
        required = [f"{keyword}_required" for keyword in ALARM_KEYWORDS.values() if keyword in said.required]
        if required:
            yield f"dpv1 is off, but its GSD file says {' = 1, '.join(required)} = 1: it raises no alarms now; {_ON}"
    if dpv1 is not None and dpv1.extra_alarm_sap and not said.extra_alarm_sap:
        yield (
            "extra_alarm_sap = true, but its GSD file does not say Extra_Alarm_SAP_supp = 1: alarms are acknowledged "
            "at SAP 50, which it may not have; leave extra_alarm_sap out"
        )
    if device.isochronous_required:
        yield "its GSD file says Isochron_Mode_required = 1, and dpstack has no isochronous mode: it may not do without"
