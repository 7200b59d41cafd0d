"""The table [slave.dpv1]: DPV1_Status, alarms, class 2 connections."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Annotated, Any, Final, TypedDict

from msgspec import structs

from dpstack.dp.pdu.dpv1_status import ALARM_LIMITS, ALARMS, DPV1_ENABLE, Dpv1
from dpstack.dp.pdu.layouts import MAX_RECORD, Layout
from dpstack.dp.pdu.prm_blocks import PrmBlock
from dpstack.dp.pdu.prm_contents import NAMES, RECORDS, TABLES, Content, DxbTable
from dpstack.gsd.dpv1_keywords import ALARM_KEYWORDS, alarm_kinds
from dpstack.params import DPV1_STATUS_LEN
from dpstack.text import brief
from dpstack.toml.table import Gsd, Key, Table, as_given, keys_of
from dpstack.units import NS_PER_MS

if TYPE_CHECKING:
    from dpstack.gsd.model import Device


def _alarms(table: Table, key: str, _: Key) -> tuple[str, ...]:
    given = table.raw(key)
    kinds = f"it is a list of these: {', '.join(ALARMS)}"
    if not isinstance(given, (list, tuple)):
        table.fail(key, f"{key} = {brief(given)}", kinds)
    for name in given:
        if not isinstance(name, str) or name not in ALARMS:
            table.fail(key, f"{key} holds {name!r}, which is unknown", kinds)
    return tuple(name for name in ALARMS if name in given)


def _blocks(table: Table, key: str, _: Key) -> tuple[PrmBlock, ...]:
    given = table.raw(key)
    if not isinstance(given, (list, tuple)):
        table.fail(key, f"{key} is no list of tables", 'write [{ type = 0x81, slot = 0, data = "00 01" }]')
    return tuple(_block(table.inner(key, number, entry)) for number, entry in enumerate(given, 1))


class Dpv1Keys(TypedDict, total=False):
    """The keys of [slave.dpv1], as docs/reference/configuration.md has them.

    alarms: the kinds of alarms that the slave may raise: `pull_plug`, `process`, `diagnostic`, `manufacturer`,
        `status`, `update` ([alarms.md](alarms.md)). Left out: those that its GSD file requires, and those set in
        `user_prm`
    alarm_mode: 0: one alarm of each kind at a time; 1..7: 2, 4, 8, 12, 16, 24, 32 alarms in all (GSD:
        Alarm_Sequence_Mode_Count). Left out: as in `user_prm`
    extra_alarm_sap: the master acknowledges alarms at SAP 50, not 51. Left out: as its GSD file says, else false
    check_cfg_mode: the slave checks the configuration in its own way. Left out: as in `user_prm`
    prm_cmd: the slave takes part in redundancy by PrmCmd. Left out: as in `user_prm`
    response_timeout_ms: the time for an answer of the slave to Read and Write. Left out: C1_Response_Timeout of its GSD
        file
    blocks: structured parameters, see [dp-v1.md](dp-v1.md) (GSD: Prm_Block_Structure_supp). Left out: none
    """

    alarms: Annotated[Sequence[str], Key(read=_alarms)]
    alarm_mode: Annotated[int, Key(0, 7, hint="0: one of each kind at a time, 1..7: 2, 4, 8 ... 32 in all")]
    extra_alarm_sap: bool
    check_cfg_mode: Annotated[bool, Key(gsd=Gsd("Check_Cfg_Mode", attrgetter("dpv1.check_cfg_mode")))]
    prm_cmd: bool
    response_timeout_ms: Annotated[int, Key(1, 655_350)]
    blocks: Annotated[Sequence[Mapping[str, object]], Key(read=_blocks)]


def read_dpv1(table: Table, device: Device | None, user_prm: bytes) -> Dpv1 | None:
    """DP-V1 of the slave with these parameters; None if nothing of it is used. Raises ConfigError.

    Left out it is on if the GSD file says DPV1_Slave and C1_Read_Write_supp, or if DPV1_Enable stands in the
    parameters already.
    """
    given = table.raw("dpv1")
    known = device is not None and device.dpv1.slave
    if given is None:
        reads = device.dpv1.c1_read_write if device is not None and known else device is None
        stands = len(user_prm) >= DPV1_STATUS_LEN and (known or bool(user_prm[0] & DPV1_ENABLE))
        return _of_gsd(device) if reads and stands else None
    if given is False:
        return None
    keys = None if given is True else table.table("dpv1", "a table of its keys, true or false")
    if device is not None and not known:
        table.fail("dpv1", "dpv1 is asked for, but its GSD file says DPV1_Slave = 0", "leave dpv1 out")
    if len(user_prm) < DPV1_STATUS_LEN:
        table.fail(
            "dpv1",
            f"dpv1 needs user parameters that begin with the three DPV1_Status octets, {len(user_prm)} are there",
            'for instance user_prm = "00 00 00"; what is used is set by dpstack',
        )
    base = _of_gsd(device)
    return base if keys is None else _with_keys(base, keys, device)


def _of_gsd(device: Device | None) -> Dpv1:
    if device is None:
        return Dpv1()
    longest = device.dpv1.c1_max_data_len
    return Dpv1(
        c1_response_timeout_ns=device.dpv1.c1_response_ns,
        c1_max_data_len=min(longest, MAX_RECORD) if longest else MAX_RECORD,
        extra_alarm_sap=device.dpv1.extra_alarm_sap,
        required_alarms=alarm_kinds(device.dpv1.required),
        structured=device.dpv1.prm_block_structure_required,
    )


def _with_keys(base: Dpv1, table: Table, device: Device | None) -> Dpv1:
    keys = keys_of(Dpv1Keys)
    given = table.read(keys)
    if device is not None:
        _check_limits(device, table, given)
        table.check_against_gsd(keys, given, device)
    timeout = given.pop("response_timeout_ms", None)
    if timeout is not None:
        given["c1_response_timeout_ns"] = timeout * NS_PER_MS
    return structs.replace(base, **given)


def _check_limits(device: Device, table: Table, given: Mapping[str, Any]) -> None:
    """Raises ConfigError for keys beyond what the GSD file allows."""
    for name in given.get("alarms", ()):
        if ALARM_KEYWORDS[name] not in (*device.dpv1.alarms, *device.dpv1.required):
            problem = f"alarms holds {name}, but its GSD file says {ALARM_KEYWORDS[name]}_supp = 0"
            table.fail("alarms", problem, "leave it out")
    for name in alarm_kinds(device.dpv1.required) if "alarms" in given else ():
        if name not in given["alarms"]:
            problem = f"alarms lacks {name}, but its GSD file says {ALARM_KEYWORDS[name]}_required = 1"
            table.fail("alarms", problem, "add it, or leave alarms out")
    mode, most = given.get("alarm_mode", 0), device.dpv1.alarm_sequence_mode_count
    if mode and ALARM_LIMITS[mode] > most:
        problem = f"alarm_mode {mode} is {ALARM_LIMITS[mode]} alarms at a time, its GSD file says "
        table.fail("alarm_mode", f"{problem}Alarm_Sequence_Mode_Count = {most}", "0 is one of each kind at a time")
    if "blocks" in given and not (device.dpv1.prm_block_structure or device.dpv1.prm_block_structure_required):
        table.fail("blocks", "blocks, but its GSD file says Prm_Block_Structure_supp = 0", "leave blocks out")


def _block(table: Table) -> PrmBlock:
    if table.raw("type") is None:
        table.fail(None, "no type", '"user_prm" (0x81), "prm_cmd" (2) ...; its manual knows the others')
    kind = _type(table, "type", _BLOCK_KEYS["type"])
    record = RECORDS.get(kind)
    keys = _TABLE_KEYS if kind in TABLES else {} if record is None else dict.fromkeys(record.fields, Key(0, kind=int))
    given = table.read(_BLOCK_KEYS | keys)
    slot, specifier = given.get("slot", 0), given.get("specifier", 0)
    if "data" in table or not keys:
        for key in keys:
            if key in table:
                table.fail(key, f"{key} beside data", f"leave {key} out, or data")
        with table.blaming("data"):
            block = PrmBlock(kind, slot, given.get("data", b""), specifier)
            _ = block.content
        return block
    if record is not None:
        content: Content = record.make(**{name: given[name] for name in record.fields if name in given})
    else:
        content = DxbTable(given.get("version", 1), tuple(_entries(table, TABLES[kind])))
    with table.blaming():
        return PrmBlock.of(content, slot, kind=kind, specifier=specifier)


def _type(table: Table, name: str, key: Key) -> int:
    given = table.raw(name)
    if not isinstance(given, str):
        return table.integer(name, key.low, key.high)
    numbers = {text: number for number, text in NAMES.items()}
    if given not in numbers:
        table.fail(name, f"there is no type {brief(given)}", f"a number, or one of these: {', '.join(numbers)}")
    return numbers[given]


_BLOCK_KEYS: Final = {
    "type": Key(0, 255, read=_type),
    "slot": Key(0, 254, kind=int),
    "specifier": Key(0, 255, kind=int),
    "data": Key(kind=bytes),
}
#: of a table of links or subscriptions
_TABLE_KEYS: Final = {"version": Key(0, 255, kind=int), "entries": Key(read=as_given)}


def _entries(table: Table, layout: Layout[Any]) -> Iterator[Any]:
    given = table.raw("entries")
    example = ", ".join(f"{key} = 0" for key in layout.fields)
    if not isinstance(given, (list, tuple)) or not all(isinstance(one, Mapping) for one in given):
        table.fail("entries", "entries is no list of tables", f"write [{{ {example} }}]")
    for number, one in enumerate(given, 1):
        entry = table.inner("entries", number, one)
        values = entry.read(dict.fromkeys(layout.fields, Key(0, 255, kind=int)))
        for key in layout.fields:
            if key not in values:
                entry.fail(None, f"no {key}", f"write {{ {example} }}")
        yield layout.make(**values)
