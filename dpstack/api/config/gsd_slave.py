"""Slaves with a GSD file: modules, parameters, Set_Prm and Chk_Cfg.

What the file requires of its master and a configuration turns off is remarked: legal on the wire, and no use to the
device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypedDict

from dpstack.api.config.table import Key, Table
from dpstack.api.gsd_info import read_gsd
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN
from dpstack.dp.pdu.dpv1_status import ALARM_KEYWORDS, DPV1_STATUS_LEN, Dpv1
from dpstack.dp.pdu.requests import SET_PRM_LEN
from dpstack.dp.slave_params import INTERVAL_UNIT, SlaveParams
from dpstack.gsd.configuration import Configuration, configure
from dpstack.gsd.model import Device
from dpstack.gsd.prm import Reading, UserPrm

_ON: Final = "leave dpv1 out, or say dpv1 = true"


def remarks(device: Device | None, dpv1: Dpv1 | None) -> Iterator[str]:
    """Texts for people, without the name of the slave; ``dpv1``: what is used of DP-V1, None: nothing."""
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
    if device.isochronous.required:
        yield "its GSD file says Isochron_Mode_required = 1, and dpstack has no isochronous mode: it may not do without"


#: keys that mean something beside ``gsd`` only
GSD_KEYS: Final = ("modules", "parameters", "defaults")
_OTHER: Final = {Reading.REFS: Reading.CONST, Reading.CONST: Reading.REFS}
#: so many octets are named where two readings of a file differ
_SHOWN_OCTETS: Final = 8


class Who(TypedDict):
    """Address and name of the slave, for messages."""

    address: int
    name: str


@dataclass(frozen=True, slots=True)
class GsdSlave:
    """Parameters by the GSD file and the choices in the table. ``notes``: decisions that might be overlooked."""

    device: Device
    configuration: Configuration
    params: SlaveParams
    notes: tuple[str, ...]

    @property
    def baud_rates(self) -> frozenset[int]:
        """The rates the file declares, in bit/s."""
        return frozenset(speed.baud for speed in self.device.speeds)


def read_gsd_slave(
    table: Table, given: Mapping[str, Any], who: Who, preset: Callable[[Device], Configuration] = configure
) -> GsdSlave:
    """Read the file (relative to the configuration) and make the choices. Raises ConfigError, one line.

    ``preset``: what is plugged where the table does not say it; may raise GsdError.
    """
    with table.blaming("gsd"):
        device = read_gsd(given["gsd"], table.folder).device
    reading: Reading = given.get("defaults", Reading.REFS)
    with table.blaming("modules" if "modules" in given else "gsd"):
        configuration = configure(device, given["modules"]) if "modules" in given else preset(device)
        prm = configuration.user_prm(reading)
    parameters = given.get("parameters", {})
    _set_parameters(table, parameters, prm)
    octets = _given(table, given, prm)
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
        note = _contradicting(reading, octets, others.octets())
    told = device.dpv1.slave and len(octets) >= DPV1_STATUS_LEN
    fail_safe = device.fail_safe or device.dpv1.fail_safe_required  # what needs empty frames in Clear can take them
    longest = device.max_diag_data_len
    with table.blaming():
        params = SlaveParams(
            **who,
            ident=device.ident,
            config=configuration.config,
            user_prm=octets,
            fail_safe=fail_safe,
            fail_safe_told=told and fail_safe,
            wd_base_1ms=told and device.dpv1.wd_base_1ms,
            min_slave_interval_ns=(device.min_slave_interval or 0) * INTERVAL_UNIT,
            max_tsdr={speed.baud: speed.max_tsdr for speed in device.speeds if speed.max_tsdr is not None},
            max_diag_len=None if longest is None else min(max(FIXED_LEN, longest), MAX_LEN),
            texts=configuration.texts(),
            prm_note=note,
        )
    return GsdSlave(device, configuration, params, tuple(notes))


def _contradicting(reading: Reading, octets: bytes, others: bytes) -> str:
    """Where defaults and constants of the file contradict each other: in which octets of Set_Prm, and the way out."""
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


def modules_of(table: Table, name: str, key: Key) -> list[int | str]:
    value = table.raw(name)
    if not isinstance(value, list) or any(isinstance(v, bool) or not isinstance(v, (int, str)) for v in value):
        table.fail(name, f"{name} = {value!r} is no list of names and numbers", 'write modules = ["8 DO", 12]')
    return list(value)


def reading_of(table: Table, name: str, key: Key) -> Reading:
    text = table.text(name)
    try:
        return Reading(text)
    except ValueError:
        table.fail(name, f"{name} = {text!r}", 'it is "refs" (defaults of the parameters) or "const"')


def _set_parameters(table: Table, parameters: Mapping[str, object], prm: UserPrm) -> None:
    for name, wanted in parameters.items():
        if not isinstance(wanted, (int, str)):
            table.fail("parameters", f"parameter {name!r} = {wanted!r}", "give a number or a text of its list")
        with table.blaming("parameters"):
            prm.set(name, wanted)


def _given(table: Table, given: Mapping[str, Any], prm: UserPrm) -> bytes | None:
    """``user_prm`` of the table instead of the parameters of the file."""
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
