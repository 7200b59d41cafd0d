"""A [[slave]] table with a GSD file: modules, user parameters, limits. Loaded if a slave has the key ``gsd``."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from typing import Any, Final

from dpstack.api.config.slave_source import Basis, Who
from dpstack.api.gsd_info import read_gsd
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN
from dpstack.dp.pdu.requests import SET_PRM_LEN
from dpstack.dp.slave_params import INTERVAL_UNIT, SlaveParams
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.errors import GsdError
from dpstack.gsd.configuration import Configuration, configure
from dpstack.gsd.model import Device
from dpstack.gsd.prm import MAY_REFUSE, Reading, UserPrm
from dpstack.params import DPV1_STATUS_LEN
from dpstack.text import brief, octets_text
from dpstack.toml.table import Table

_OTHER: Final = {Reading.REFS: Reading.CONST, Reading.CONST: Reading.REFS}
#: most octet numbers in a message about two readings of a file
_SHOWN_OCTETS: Final = 8


def basis_of_gsd(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    configuration, (params, rest) = read_gsd_slave(
        table, given, who, lambda device, own_prm: configure(device, own_prm=own_prm)
    )
    device = configuration.device
    description = slave_description(device, configuration, ident=device.ident or 0, user_prm=len(params.user_prm))
    return params, rest | {"description": description}


def read_gsd_slave(
    table: Table, given: Mapping[str, Any], who: Who, preset: Callable[[Device, bool], Configuration]
) -> tuple[Configuration, Basis]:
    """Read the GSD file (relative to the configuration), plug its modules and set its parameters.

    ``preset(device, own_prm)`` returns the configuration for a table without ``modules``; it may raise GsdError.
    ``own_prm`` as for :func:`~dpstack.gsd.configuration.plug`. Raises ConfigError, one line.
    """
    with table.blaming("gsd"):
        device = read_gsd(given["gsd"], table.folder).device
    own_prm = "user_prm" in given
    with table.blaming("modules" if "modules" in given else "gsd"):
        if "modules" in given:
            configuration = configure(device, given["modules"], own_prm=own_prm)
        else:
            configuration = preset(device, own_prm)
    if own_prm:
        if "parameters" in given:
            table.fail("user_prm", "user_prm beside parameters", "give one of them")
        octets: bytes = given["user_prm"]
        notes, prm_note = _own_notes(configuration, octets), ""
    else:
        with table.blaming("modules" if "modules" in given else "gsd"):
            octets, notes, prm_note = _prm_of_file(table, given, configuration)
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
            prm_note=prm_note,
        )
    if device.ident is None and "ident" not in given:
        table.fail("gsd", f"{given['gsd']} has no Ident_Number", 'add ident = 0x1234, or ident = "ask"')
    rates = frozenset(speed.baud for speed in device.speeds)
    rest = {"device": device, "gsd": given["gsd"], "modules": configuration.modules}
    all_notes = (*configuration.notes, *(note for note in notes if note))
    return configuration, (params, rest | {"notes": all_notes, "baud_rates": rates})


def _prm_of_file(
    table: Table, given: Mapping[str, Any], configuration: Configuration
) -> tuple[bytes, tuple[str, ...], str]:
    """User parameters by the file and the key ``parameters``; remarks, and the note for a slave that refuses them."""
    reading = Reading(given.get("defaults", Reading.REFS))
    parameters = given.get("parameters", {})
    prm, others = configuration.user_prm(reading), configuration.user_prm(_OTHER[reading])
    _set_parameters(table, parameters, prm)
    _set_parameters(table, parameters, others)
    octets, contradiction = prm.octets(), ""
    differing = [contradiction for contradiction in prm.contradictions() if contradiction.matters]
    if differing and "defaults" not in given:
        count = f"{len(differing)} parameters" if len(differing) > 1 else "one parameter"
        contradiction = (
            f"in its GSD file the defaults of {count} contradict the constant octets (the first: "
            f'{differing[0].text}); the defaults are used, defaults = "const" takes the constants'
        )
    notes = (prm.length_note, contradiction)
    return octets, notes, _contradictions_note(reading, octets, others.octets())


def _own_notes(configuration: Configuration, octets: bytes) -> tuple[str, ...]:
    """Remarks about the key ``user_prm``, which replaces what the file makes: lengths of the file that differ."""
    device, said = configuration.device, []
    usual, most = device.user_prm_data_len, device.max_user_prm_data_len
    with contextlib.suppress(GsdError):
        made = len(configuration.user_prm().octets())
        if made and len(octets) not in (made, usual):
            said.append(f"with these modules its GSD file makes {made}")
    if most is not None and len(octets) > most:
        said.append(f"Max_User_Prm_Data_Len is {most}")
    elif most is None and usual is not None and not device.modular and len(octets) != usual:
        said.append(f"User_Prm_Data_Len is {usual}")
    return (f"user_prm has {octets_text(len(octets))}, {', '.join(said)}; {MAY_REFUSE}",) if said else ()


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
            table.fail("parameters", f"parameter {name!r} = {brief(wanted)}", "give a number or a text of its list")
        with table.blaming("parameters"):
            prm.set(name, wanted)
