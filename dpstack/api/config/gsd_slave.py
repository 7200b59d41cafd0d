"""A [[slave]] table that names a GSD file: its modules, parameters and what follows from them.

What the file requires of its master and a configuration turns off is remarked: legal on the wire, and no use to the
device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NoReturn

from dpstack.api.config.table import Table
from dpstack.api.gsd_info import read_gsd
from dpstack.dp.pdu.dpv1_status import ALARM_KEYWORDS, Dpv1
from dpstack.dp.pdu.requests import SET_PRM_LEN
from dpstack.errors import ConfigError, GsdError
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
#: so many octets are named where two readings of a file differ
_SHOWN_OCTETS: Final = 8


@dataclass(frozen=True, slots=True)
class GsdSlave:
    """What a GSD file and the choices in the table give. ``notes``: what was decided and might be overlooked."""

    device: Device
    configuration: Configuration
    user_prm: bytes
    notes: tuple[str, ...]
    #: what helps where the slave refuses ``user_prm``, see :attr:`~dpstack.dp.slave_params.SlaveParams.prm_note`
    prm_note: str = ""

    @property
    def max_tsdr(self) -> Mapping[int, int]:
        """MaxTsdr in bit times by baud rate."""
        return {speed.baud: speed.max_tsdr for speed in self.device.speeds if speed.max_tsdr is not None}

    @property
    def baud_rates(self) -> frozenset[int]:
        """The rates the file declares, in bit/s."""
        return frozenset(speed.baud for speed in self.device.speeds)


def read_gsd_slave(table: Table, path: str, preset: Callable[[Device], Configuration] = configure) -> GsdSlave:
    """Read the file (relative to the configuration) and make the choices. Raises ConfigError, one line.

    ``preset``: what is plugged where the table does not say it; may raise GsdError.
    """
    try:
        file = read_gsd(path, table.folder)
    except ConfigError as error:
        _refuse(table, "gsd", error)
    chosen = "modules" if "modules" in table else "gsd"
    try:
        modules = _modules(table)
        configuration = preset(file.device) if modules is None else configure(file.device, modules)
    except GsdError as error:
        _refuse(table, chosen, error)
    reading = _reading(table)
    try:
        prm = configuration.user_prm(reading)
    except GsdError as error:
        _refuse(table, chosen, error)
    _set_parameters(table, prm)
    octets = _given(table, prm)
    notes = list(configuration.notes)
    differing = [contradiction for contradiction in prm.contradictions() if contradiction.matters]
    if differing and octets is None and reading is Reading.REFS and "defaults" not in table:
        count = f"{len(differing)} parameters" if len(differing) > 1 else "one parameter"
        notes.append(
            f"in its GSD file the defaults of {count} contradict the constant octets (the first: "
            f'{differing[0].text}); the defaults are used, defaults = "const" takes the constants'
        )
    note = _other_reading(table, configuration, reading, prm) if octets is None else ""
    return GsdSlave(file.device, configuration, prm.octets() if octets is None else octets, tuple(notes), note)


def _other_reading(table: Table, configuration: Configuration, reading: Reading, prm: UserPrm) -> str:
    """Where defaults and constants of the file contradict each other: in which octets of Set_Prm, and the way out."""
    other = Reading.CONST if reading is Reading.REFS else Reading.REFS
    others = configuration.user_prm(other)
    _set_parameters(table, others)
    pairs = enumerate(zip(prm.octets(), others.octets(), strict=True), SET_PRM_LEN + 1)
    differing = [str(number) for number, (mine, its) in pairs if mine != its]
    if not differing:
        return ""
    shown = ", ".join(differing[:_SHOWN_OCTETS]) + (" ..." if len(differing) > _SHOWN_OCTETS else "")
    taken = ("defaults", "constants") if other is Reading.CONST else ("constants", "defaults")
    return (
        f"in its GSD file defaults and constants contradict each other (octet{'s' * (len(differing) > 1)} {shown} of "
        f'Set_Prm): the {taken[0]} were sent, defaults = "{other.value}" sends the {taken[1]}, as some devices need it'
    )


def _modules(table: Table) -> list[int | str] | None:
    value = table.raw("modules")
    if value is None:
        return None
    if not isinstance(value, list) or any(isinstance(v, bool) or not isinstance(v, (int, str)) for v in value):
        table.fail("modules", f"modules = {value!r} is no list of names and numbers", 'write modules = ["8 DO", 12]')
    return list(value)


def _reading(table: Table) -> Reading:
    text = table.text("defaults")
    if text is None:
        return Reading.REFS
    try:
        return Reading(text)
    except ValueError:
        table.fail("defaults", f"defaults = {text!r}", 'it is "refs" (defaults of the parameters) or "const"')


def _set_parameters(table: Table, prm: UserPrm) -> None:
    value = table.raw("parameters")
    if value is None:
        return
    if not isinstance(value, Mapping):
        table.fail("parameters", "parameters is no table", 'write parameters = { "Diagnosis" = "on" }')
    for name, wanted in value.items():
        if not isinstance(wanted, (int, str)):
            table.fail("parameters", f"parameter {name!r} = {wanted!r}", "give a number or a text of its list")
        try:
            prm.set(str(name), wanted)
        except GsdError as error:
            _refuse(table, "parameters", error)


def _given(table: Table, prm: UserPrm) -> bytes | None:
    """``user_prm`` in place of what follows from the file."""
    octets = table.octets("user_prm")
    if octets is None:
        return None
    if "parameters" in table:
        table.fail("user_prm", "user_prm beside parameters", "give one of them")
    expected, limit = len(prm.octets()), prm.device.max_user_prm_data_len
    if expected and len(octets) != expected:
        table.fail(
            "user_prm", f"user_prm has {len(octets)} octets", f"with these modules {expected} are wanted; correct it"
        )
    if limit is not None and len(octets) > limit:
        table.fail("user_prm", f"user_prm has {len(octets)} octets", f"Max_User_Prm_Data_Len is {limit}; shorten it")
    return octets


def _refuse(table: Table, key: str, error: ConfigError) -> NoReturn:
    what, _, todo = str(error).partition("; ")
    raise table.error(key, what, todo or "correct it") from None
