"""A [[slave]] table with a GSD file: modules, user parameters, limits. Loaded where a slave has the key ``gsd``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from dpstack.api.config.slave_source import Basis, Who
from dpstack.api.config.table import Table
from dpstack.api.gsd_info import read_gsd
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN
from dpstack.dp.pdu.dpv1_status import DPV1_STATUS_LEN
from dpstack.dp.pdu.requests import SET_PRM_LEN
from dpstack.dp.slave_params import INTERVAL_UNIT, SlaveParams
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.gsd.configuration import Configuration, configure
from dpstack.gsd.model import Device
from dpstack.gsd.prm import Reading, UserPrm

_OTHER: Final = {Reading.REFS: Reading.CONST, Reading.CONST: Reading.REFS}
#: most octet numbers in a message about two readings of a file
_SHOWN_OCTETS: Final = 8


def basis_of_gsd(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    configuration, (params, rest) = read_gsd_slave(table, given, who)
    device = configuration.device
    return params, rest | {"description": slave_description(device, configuration, ident=device.ident or 0)}


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
