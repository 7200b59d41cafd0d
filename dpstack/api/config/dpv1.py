"""The key ``dpv1`` of a [[slave]] table: DP-V1 on or off, what else DPV1_Status says, class 2 connections."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from dpstack.api.config.table import Table
from dpstack.dp.pdu.dpv1_status import ALARM_KEYWORDS, ALARM_LIMITS, ALARMS, DPV1_ENABLE, DPV1_STATUS_LEN, Dpv1
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.pdu.prm_blocks import NAMES, RECORDS, TABLES, Content, DxbTable, PrmBlock
from dpstack.dpv1.pdu.ms2 import LEAST_INITIATE
from dpstack.errors import ConfigError, PduError
from dpstack.gsd.model import Device
from dpstack.units import NS_PER_MS

_KEYS: Final = (
    "check_cfg_mode",
    "prm_cmd",
    "alarms",
    "alarm_mode",
    "extra_alarm_sap",
    "blocks",
    "response_timeout_ms",
)
_BLOCK_KEYS: Final = ("type", "slot", "specifier", "data")
#: of a table of links or subscriptions
_ENTRIES: Final = "entries"


def read_dpv1(table: Table, device: Device | None, user_prm: bytes) -> Dpv1 | None:
    """DP-V1 of the slave with these parameters; None where nothing of it is used. Raises ConfigError.

    Left out it is on where the GSD file says DPV1_Slave and C1_Read_Write_supp, or where DPV1_Enable stands in the
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
        required_alarms=_required(device),
        structured=device.dpv1.prm_block_structure_required,
    )


def _with_keys(base: Dpv1, table: Table, device: Device | None) -> Dpv1:
    table.check_keys(_KEYS)
    timeout = table.integer("response_timeout_ms", 1, 655_350)
    checks = None if device is None else device.dpv1.check_cfg_mode
    return dataclasses.replace(
        base,
        check_cfg_mode=_flag(table, "check_cfg_mode", checks, "Check_Cfg_Mode"),
        prm_cmd=_flag(table, "prm_cmd", None, ""),
        alarms=_alarms(table, device),
        alarm_mode=_alarm_mode(table, device),
        extra_alarm_sap=table.flag("extra_alarm_sap", base.extra_alarm_sap),
        blocks=_blocks(table, device),
        c1_response_timeout_ns=base.c1_response_timeout_ns if timeout is None else timeout * NS_PER_MS,
    )


def _flag(table: Table, key: str, supported: bool | None, keyword: str) -> bool | None:
    if key not in table:
        return None
    wanted = table.flag(key, False)
    if wanted and supported is False:
        table.fail(key, f"{key} = true, but its GSD file says {keyword} = 0", f"leave {key} out")
    return wanted


def _alarms(table: Table, device: Device | None) -> tuple[str, ...] | None:
    given = table.raw("alarms")
    if given is None:
        return None
    kinds = f"it is a list of these: {', '.join(ALARMS)}"
    if not isinstance(given, (list, tuple)):
        table.fail("alarms", f"alarms = {given!r}", kinds)
    for name in given:
        if not isinstance(name, str) or name not in ALARMS:
            table.fail("alarms", f"alarms holds {name!r}, which is none", kinds)
    for name in given:
        if device is not None and ALARM_KEYWORDS[name] not in (*device.dpv1.alarms, *device.dpv1.required):
            problem = f"alarms holds {name}, but its GSD file says {ALARM_KEYWORDS[name]}_supp = 0"
            table.fail("alarms", problem, "leave it out")
    for name in _required(device):
        if name not in given:
            problem = f"alarms lacks {name}, but its GSD file says {ALARM_KEYWORDS[name]}_required = 1"
            table.fail("alarms", problem, "add it, or leave alarms out")
    return tuple(name for name in ALARMS if name in given)


def _required(device: Device | None) -> tuple[str, ...]:
    """Kinds that the device wants to be enabled."""
    return () if device is None else tuple(name for name in ALARMS if ALARM_KEYWORDS[name] in device.dpv1.required)


def _alarm_mode(table: Table, device: Device | None) -> int | None:
    mode = table.integer("alarm_mode", 0, 7, "0: one of each kind at a time, 1..7: 2, 4, 8 ... 32 in all")
    most = 0 if device is None else device.dpv1.alarm_sequence_mode_count
    if mode and device is not None and ALARM_LIMITS[mode] > most:
        problem = f"alarm_mode {mode} is {ALARM_LIMITS[mode]} alarms at a time, its GSD file says "
        table.fail("alarm_mode", f"{problem}Alarm_Sequence_Mode_Count = {most}", "0 is one of each kind at a time")
    return mode


def _blocks(table: Table, device: Device | None) -> tuple[PrmBlock, ...]:
    given = table.raw("blocks")
    if given is None:
        return ()
    if not isinstance(given, (list, tuple)):
        table.fail("blocks", "blocks is no list of tables", 'write [{ type = 0x81, slot = 0, data = "00 01" }]')
    if device is not None and not (device.dpv1.prm_block_structure or device.dpv1.prm_block_structure_required):
        table.fail("blocks", "blocks, but its GSD file says Prm_Block_Structure_supp = 0", "leave blocks out")
    return tuple(_block(table.inner("blocks", number, entry)) for number, entry in enumerate(given, 1))


def _block(table: Table) -> PrmBlock:
    kind = _type(table)
    slot, specifier = table.integer("slot", 0, 254) or 0, table.integer("specifier", 0, 255) or 0
    fields = tuple(_fields(kind))
    table.check_keys((*_BLOCK_KEYS, *fields))
    if "data" in table or not fields:
        for key in fields:
            if key in table:
                table.fail(key, f"{key} beside data", f"leave {key} out, or data")
        octets = table.octets("data") or b""
        try:
            block = PrmBlock(kind, slot, octets, specifier)
            _ = block.content
        except (ConfigError, PduError) as error:
            raise table.error("data", str(error), "correct it") from None
        return block
    content = _content(table, kind)
    try:
        return PrmBlock.of(content, slot, kind=kind, specifier=specifier)
    except (ConfigError, PduError) as error:
        raise table.error(None, str(error), "correct it") from None


def _type(table: Table) -> int:
    given = table.raw("type")
    if isinstance(given, str):
        numbers = {name: number for number, name in NAMES.items()}
        if given not in numbers:
            table.fail("type", f"there is no type {given!r}", f"a number, or one of these: {', '.join(numbers)}")
        return numbers[given]
    kind = table.integer("type", 0, 255)
    if kind is None:
        table.fail(None, "no type", '"user_prm" (0x81), "prm_cmd" (2) ...; its manual knows the others')
    return kind


def _fields(kind: int) -> Iterable[str]:
    """The keys of a block of this type beside ``data``."""
    if kind in TABLES:
        return ("version", _ENTRIES)
    return RECORDS[kind].fields if kind in RECORDS else ()


def _content(table: Table, kind: int) -> Content:
    """What a block of this type consists of."""
    if kind in RECORDS:
        given = {key: table.integer(key, 0) for key in RECORDS[kind].fields if key in table}
        content: Content = RECORDS[kind].record(**given)
        return content
    version = table.integer("version", 0, 255)
    return DxbTable(1 if version is None else version, tuple(_entries(table, kind)))


def _entries(table: Table, kind: int) -> Iterator[Any]:
    given = table.raw(_ENTRIES)
    layout = TABLES[kind]
    example = ", ".join(f"{key} = 0" for key in layout.fields)
    if not isinstance(given, (list, tuple)) or not all(isinstance(one, Mapping) for one in given):
        table.fail(_ENTRIES, f"{_ENTRIES} is no list of tables", f"write [{{ {example} }}]")
    for number, one in enumerate(given, 1):
        entry = table.inner(_ENTRIES, number, one)
        entry.check_keys(layout.fields)
        for key in layout.fields:
            if key not in entry:
                entry.fail(None, f"no {key}", f"write {{ {example} }}")
        yield layout.record(**{key: entry.integer(key, 0, 255) for key in layout.fields})


@dataclass(frozen=True, slots=True)
class Ms2Limits:
    """``supported``: C2_Read_Write_supp. ``response_ns`` (C2_Response_Timeout), ``channels`` (C2_Max_Count_Channels)
    and ``max_initiate_len`` (Max_Initiate_PDU_Length, octets) are 0 where they are not known; ``max_data_len``:
    C2_Max_Data_Len, 1..240."""

    supported: bool = True
    response_ns: int = 0
    max_data_len: int = MAX_RECORD
    channels: int = 0
    max_initiate_len: int = 0

    @classmethod
    def of(cls, device: Device | None) -> Ms2Limits:
        """Of the device's GSD file; without one nothing is known, and it may have them."""
        if device is None:
            return cls()
        dpv1, longest = device.dpv1, device.dpv1.max_initiate_pdu_length
        return cls(
            supported=dpv1.c2_read_write,
            response_ns=dpv1.c2_response_ns,
            max_data_len=min(dpv1.c2_max_data_len or MAX_RECORD, MAX_RECORD),
            channels=dpv1.c2_max_count_channels,
            max_initiate_len=max(LEAST_INITIATE, longest) if longest else 0,
        )
