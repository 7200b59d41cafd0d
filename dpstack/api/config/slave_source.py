"""The base of a [[slave]] table without drive and GSD file; the keys of the other kinds, and their types.

Also the remarks about a function that a GSD file requires of the master and that the configuration switches off: the
bus allows this, but the device may not work.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypedDict

from dpstack.dp.pdu.dpv1_status import DPV1_ENABLE, ISOM_REQ, PRM_STRUCTURE
from dpstack.dp.slave_params import IsochronousDemand, SlaveParams
from dpstack.fdl.telegram import MAX_DATA
from dpstack.gsd.dpv1_keywords import ALARM_KEYWORDS
from dpstack.gsd.identifiers import io_lengths
from dpstack.params import DPV1_STATUS_LEN
from dpstack.text import brief
from dpstack.toml.table import Key, Table, is_integer

if TYPE_CHECKING:
    from dpstack.gsd.model import Device

#: a reference of a drive
PERCENT: Final = Key(0.001, 1_000_000)
#: the parameters of a slave before its own keys count, and the fields of a SlaveConfig that go with them
Basis: TypeAlias = tuple[SlaveParams, dict[str, Any]]
#: keys that need the key ``gsd``, and keys that need the key ``drive``
GSD_KEYS: Final = ("modules", "parameters", "defaults")
REFERENCES: Final = ("reference_hz", "reference_rpm")
DRIVE_KEYS: Final = ("telegram", *REFERENCES, "options", "simulated")
_ON: Final = "leave dpv1 out, or give dpv1 = true"


class Who(TypedDict):
    """Address and name of the slave, for messages."""

    address: int
    name: str


def basis_of_octets(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    """The basis of a slave with ident and identifier octets. Raises ConfigError."""
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


def leave_out(table: Table, key: str, why: str, todo: str) -> None:
    if key in table:
        table.fail(key, f"{key} {why}", todo)


def need_gsd(table: Table, leaving: str = "") -> None:
    """Raises ConfigError for a key that a GSD file gives its meaning, except ``leaving``."""
    for key in GSD_KEYS:
        if key == leaving:
            continue
        leave_out(table, key, "without gsd", f"name the GSD file, or leave {key} out")


def modules_of(table: Table, name: str, _: Key) -> list[int | str]:
    """Reader of ``modules``."""
    value = table.raw(name)
    if not isinstance(value, list) or not all(isinstance(one, str) or is_integer(one) for one in value):
        table.fail(name, f"{name} = {brief(value)} is no list of names and numbers", 'write modules = ["8 DO", 12]')
    return list(value)


def drives_of(table: Table, name: str, _: Key) -> list[object]:
    """Reader of ``drives``: a list of tables, which are read with the drives."""
    value = table.raw(name)
    if not isinstance(value, list) or not all(isinstance(one, Mapping) and one for one in value):
        todo = 'write drives = [{ name = "axis1", file = "..." }, ...]'
        table.fail(name, f"{name} = {brief(value)} is no list of tables", todo)
    return value


def demand_of(device: Device | None, params: SlaveParams) -> IsochronousDemand | None:
    """Whether the GSD file or the parameters of a slave demand isochronous mode, and with which window; None: neither
    does."""
    octets = params.user_octets(None)
    enabled = len(octets) >= DPV1_STATUS_LEN and octets[0] & DPV1_ENABLE
    if enabled and octets[2] & (PRM_STRUCTURE | ISOM_REQ):
        from dpstack.dp.pdu.prm_checks import isochronous_demand  # here, as few slaves have structured parameters

        found = isochronous_demand(octets)
        if found is not None:
            return IsochronousDemand(*found)
    if device is not None and device.isochronous_required:
        return IsochronousDemand("its GSD file says Isochron_Mode_required = 1")
    return None


def block_remarks(params: SlaveParams) -> Iterator[str]:
    """Remarks about the blocks of redundancy and isochronous mode in Set_Prm."""
    octets = params.user_octets(None)
    if len(octets) >= DPV1_STATUS_LEN and octets[0] & DPV1_ENABLE and octets[2] & (PRM_STRUCTURE | ISOM_REQ):
        from dpstack.dp.pdu.prm_checks import findings  # here, as few slaves have structured parameters

        for line in findings(octets):
            yield f"its Set_Prm: {line}"


def remarks(device: Device | None, params: SlaveParams, *, dpv1_given: bool) -> Iterator[str]:
    """Remarks for people, without the name of the slave. ``dpv1_given``: its table has the key ``dpv1``."""
    if device is None:
        return
    from dpstack.gsd.prm import dpv1_note  # here, as a bus without GSD files needs no reader of them

    said, dpv1 = device.dpv1, params.dpv1
    without_status = "" if dpv1_given else dpv1_note(device, len(params.user_prm))
    if without_status:
        yield without_status
    elif said.slave and dpv1 is None:
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
