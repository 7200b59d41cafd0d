"""The data unit of a telegram, field by field: every DP service, DP-V0 and DP-V1, under the standard's names.

The values are those of JSON: numbers, texts, lists, octets as hex digits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from dpstack.dp.pdu.alarm_blocks import Alarm, alarm_name, parse_block
from dpstack.dp.pdu.diag_blocks import Block, ChannelBlock, DeviceBlock, IdentifierBlock, RevisionBlock
from dpstack.dp.pdu.diag_texts import texts_of
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN, Diagnosis
from dpstack.dp.pdu.dpv1_status import (
    ALARM_LIMITS,
    ALARM_MODE,
    ALARMS,
    CHECK_CFG_MODE,
    DPV1_ENABLE,
    FAIL_SAFE,
    ISOM_REQ,
    PRM_CMD,
    PRM_STRUCTURE,
    PUBLISHER_ENABLE,
    WD_BASE_1MS,
)
from dpstack.dp.pdu.prm_blocks import PrmBlock, parse_blocks
from dpstack.dp.pdu.requests import GlobalControl, SetPrm, SetSlaveAdd
from dpstack.dpv1.pdu.ms2 import Abort, Address, InitiateReq, InitiateRes, ResourceManagerRes
from dpstack.dpv1.pdu.read_write import (
    AlarmAck,
    DataTransport,
    Function,
    Negative,
    ReadReq,
    ReadRes,
    parse_request,
    parse_response,
)
from dpstack.errors import PduError
from dpstack.fdl.telegram import (
    SAP_CHK_CFG,
    SAP_GET_CFG,
    SAP_GLOBAL_CONTROL,
    SAP_MS1,
    SAP_MS1_ALARM,
    SAP_MS2_RM,
    SAP_SET_PRM,
    SAP_SET_SLAVE_ADD,
    SAP_SLAVE_DIAG,
    SSAP_MS2,
    Telegram,
)
from dpstack.gsd.dpv1_keywords import ALARM_KEYWORDS
from dpstack.gsd.identifiers import parse_identifiers
from dpstack.params import DPV1_STATUS_LEN
from dpstack.text import printable, readable
from dpstack.units import ns_to_s

Fields = dict[str, object]

#: types of blocks with the links of a subscriber: link table, subscriber table, SINAMICS
_FILTERS: Final = (3, 7, 0xE2)

#: types of blocks with a record of redundancy, isochronous mode, clock
_RECORDS: Final = (2, 4, 8)

#: T_WD = 10 ms x WD_Fact_1 x WD_Fact_2, or 1 ms x ... with WD_Base_1ms
_WD_BASE_MS: Final = 10
_REFUSED: Final = 0x80
#: bits of Control_Command that mean nothing
_RESERVED_CONTROL: Final = 0xC1


def fields_of(telegram: Telegram) -> Fields:
    """The fields of the data unit; empty if it has none, or nobody but the user knows them (Data_Exchange).

    Raises PduError, or ConfigError for identifiers, if the octets are not what their SAP says.
    """
    data = telegram.data
    if not data or (telegram.dsap is None and telegram.ssap is None):
        return _clock_value(data) if telegram.is_clock_value else {}
    request = telegram.is_request
    slave = telegram.dsap if request else telegram.ssap
    if slave is None:
        return {}
    read = (_REQUESTS if request else _ANSWERS).get(slave)
    if read is not None:
        return read(data)
    return dpv1_fields(data, request=request) if is_dpv1(telegram) else {}


def is_dpv1(telegram: Telegram) -> bool:
    """Whether the SAPs are those of MS1 or MS2."""
    slave, master = telegram.dsap, telegram.ssap
    if not telegram.is_request:
        slave, master = master, slave
    if slave is None:
        return False
    return slave in (SAP_MS1, SAP_MS1_ALARM) or (slave <= SAP_MS2_RM and master == SSAP_MS2)


def _groups(mask: int) -> list[int]:
    return [bit + 1 for bit in range(8) if mask >> bit & 1]


def _ident(number: int) -> str:
    return f"0x{number:04x}"


def _set_prm(data: bytes) -> Fields:
    prm = SetPrm.parse(data)
    found: Fields = {
        "Lock_Req": prm.lock,
        "Unlock_Req": prm.unlock,
        "Sync_Req": prm.sync,
        "Freeze_Req": prm.freeze,
        "WD_On": prm.watchdog is not None,
        "WD_Fact_1": data[1],
        "WD_Fact_2": data[2],
        "watchdog_ms": None,
        "min_T_SDR": prm.min_tsdr,
        "Ident_Number": _ident(prm.ident),
        "Group_Ident": _groups(prm.group_mask),
    }
    user = prm.user_prm
    base = _WD_BASE_MS
    if len(user) >= DPV1_STATUS_LEN and user[0] & DPV1_ENABLE:
        base = 1 if user[0] & WD_BASE_1MS else _WD_BASE_MS
        found |= _dpv1_status(user)
    elif user:
        found["User_Prm_Data"] = user.hex()
    if prm.watchdog is not None:
        found["watchdog_ms"] = base * data[1] * data[2]
    return found


def _dpv1_status(user: bytes) -> Fields:
    """DPV1_Status_1 to 3 and what follows them, of a slave whose parameters switch DP-V1 on."""
    first, second, third = user[:DPV1_STATUS_LEN]
    found: Fields = {
        "DPV1_Enable": True,
        "Fail_Safe": bool(first & FAIL_SAFE),
        "Publisher_Enable": bool(first & PUBLISHER_ENABLE),
        "WD_Base_1ms": bool(first & WD_BASE_1MS),
        "Check_Cfg_Mode": bool(second & CHECK_CFG_MODE),
        "Alarms": [ALARM_KEYWORDS[name] for name, mask in ALARMS.items() if second & mask],
        "Alarm_Mode": ALARM_LIMITS[third & ALARM_MODE] or "one of each type",
        "Prm_Structure": bool(third & PRM_STRUCTURE),
        "PrmCmd": bool(third & PRM_CMD),
        "IsoM_Req": bool(third & ISOM_REQ),
    }
    rest = user[DPV1_STATUS_LEN:]
    if third & PRM_STRUCTURE:
        blocks = parse_blocks(rest, first=len(user) - len(rest) + 8)
        found["Blocks"] = [_prm_block(block) for block in blocks]
        _add_checks(found, user)
    elif rest:
        found["User_Prm_Data"] = rest.hex()
    if third & ISOM_REQ and not third & PRM_STRUCTURE:
        _add_checks(found, user)
    return found


def _add_checks(found: Fields, user: bytes) -> None:
    """``demands``: a mode that the slave demands; ``findings``: what is wrong in the blocks."""
    from dpstack.dp.pdu.prm_checks import findings, isochronous_demand  # here, as few slaves have such blocks

    demand = isochronous_demand(user)
    if demand is not None:
        found["demands"] = f"isochronous mode ({demand[0]})"
    if wrong := findings(user):
        found["findings"] = list(wrong)


def _prm_block(block: PrmBlock) -> Fields:
    found: Fields = {
        "type": block.type,
        "slot": block.slot,
        "specifier": block.specifier,
        "data": block.data.hex(),
    }
    if block.type in _RECORDS:
        from dpstack.dp.pdu.prm_checks import block_text  # here, as few slaves have such blocks

        if (content := block.content) is not None:
            found["content"] = content._asdict()
            found["text"] = block_text(block)
    if block.type in _FILTERS:
        from dpstack.dp.pdu.dxb import links_of  # here, as few slaves subscribe

        if links := links_of((block,)):
            found["links"] = [link.text for link in links]
    return found


def _configuration(data: bytes) -> Fields:
    """Chk_Cfg and the answer to Get_Cfg: one entry for each identifier, in the order of the modules."""
    return {
        "Cfg_Data": [
            {
                "identifier": one.octets.hex(),
                "inputs": one.inputs,
                "outputs": one.outputs,
                "consistent": one.input_consistent or one.output_consistent,
                "manufacturer": one.manufacturer.hex(),
            }
            for one in parse_identifiers(data)
        ]
    }


def _global_control(data: bytes) -> Fields:
    control = GlobalControl.parse(data)
    found: Fields = {
        "Clear_Data": control.clear,
        "Unfreeze": control.unfreeze,
        "Freeze": control.freeze,
        "Unsync": control.unsync,
        "Sync": control.sync,
        "Group_Select": _groups(control.group_mask),
    }
    if data[0] & _RESERVED_CONTROL:
        found["reserved"] = f"0x{data[0] & _RESERVED_CONTROL:02x}"
    return found


def _clock_value(data: bytes) -> Fields:
    from dpstack.dp.pdu.clock import ClockValue, time_text  # here, as few buses send the time

    clock = ClockValue.parse(data)
    previous = clock.previous_ns
    return {
        "Clock_Value_Time_Event": time_text(clock.time_ns),
        "Clock_Value_previous_TE": None if previous is None else time_text(previous),
        "CV": clock.correction,
        "ANH": clock.announced_hour,
        "SWT": clock.summer_time,
        "CR_ms": clock.resolution_ms,
        "SYF": not clock.synchronised,
    }


def ident_fields(data: bytes) -> Fields:
    """The four texts of an answer to Request Ident, printable. Raises PduError."""
    from dpstack.fdl.services.identity import Ident  # here, as few stations are asked for it

    ident = Ident.parse(data)
    return {
        "Vendor_Name": printable(ident.vendor),
        "Controller_Type": printable(ident.controller),
        "HW_Release": printable(ident.hardware),
        "SW_Release": printable(ident.software),
    }


def _set_slave_add(data: bytes) -> Fields:
    order = SetSlaveAdd.parse(data)
    return {
        "New_Slave_Add": order.address,
        "Ident_Number": _ident(order.ident),
        "No_Add_Chg": order.no_add_chg,
        "Rem_Slave_Data": order.rem_slave_data.hex(),
    }


def _slave_diag(data: bytes) -> Fields:
    diagnosis = Diagnosis.parse(data)
    if diagnosis is None:
        raise PduError(f"Slave_Diag has {len(data)} octets, {FIXED_LEN}..{MAX_LEN} are possible")
    found: Fields = {
        "flags": list(diagnosis.flags),
        "Master_Add": diagnosis.master,
        "Ident_Number": _ident(diagnosis.ident),
    }
    if diagnosis.ext:
        found["Ext_Diag_Data"] = [_block(block) for block in diagnosis.blocks]
    if diagnosis.ext_finding is not None:
        found["rest"] = diagnosis.ext_rest.hex()
        found["finding"] = diagnosis.ext_finding
    return found


def _block(block: Block) -> Fields:
    """A block of the extended diagnosis. Numbers of modules are those of the wire, from 0; its text counts slots."""
    found = _block_fields(block)
    if "if_dpv1" not in found and (text := "; ".join(texts_of((block,), None, dpv1=False))):
        found["text"] = text
    return found


def _block_fields(block: Block) -> Fields:
    match block:
        case ChannelBlock():
            return {
                "kind": "channel",
                "module": block.identifier,
                "channel": block.channel,
                "error": block.error,
            }
        case IdentifierBlock():
            return {"kind": "identifier", "modules": list(block.modules)}
        case RevisionBlock():
            return {"kind": "revision", "revision": block.revision}
        case DeviceBlock():
            return _device_block(block)
    return {"kind": "unknown", "data": block.octets.hex()}


def _device_block(block: DeviceBlock) -> Fields:
    """Without parameters of DP-V1 the same octets may be the maker's own: ``alarm`` says what they are with them."""
    found: Fields = {"kind": "device", "data": block.data.hex()}
    if characters := readable(block.data):
        found["characters"] = characters
    try:
        message = parse_block(block.octets)
    except PduError:
        return found
    found["if_dpv1"] = {
        "Alarm_Type" if isinstance(message, Alarm) else "Status_Type": message.type,
        "Slot_Number": message.slot,
        "Alarm_Specifier" if isinstance(message, Alarm) else "Status_Specifier": message.specifier,
        "Seq_Nr": message.sequence if isinstance(message, Alarm) else None,
        "Add_Ack": message.add_ack if isinstance(message, Alarm) else None,
        "data": message.data.hex(),
        "text": message.text,
    }
    return found


_REQUESTS: Final[Mapping[int, Callable[[bytes], Fields]]] = {
    SAP_SET_PRM: _set_prm,
    SAP_CHK_CFG: _configuration,
    SAP_GLOBAL_CONTROL: _global_control,
    SAP_SET_SLAVE_ADD: _set_slave_add,
}
_ANSWERS: Final[Mapping[int, Callable[[bytes], Fields]]] = {
    SAP_SLAVE_DIAG: _slave_diag,
    SAP_GET_CFG: _configuration,
}


def dpv1_fields(octets: bytes, *, request: bool) -> Fields:
    """A PDU of MS1 or MS2, at least one octet, from a master (``request``) or from a slave. Raises PduError."""
    function = octets[0]
    name = function & ~_REFUSED
    head: Fields = {"Function_Num": f"0x{function:02x}"}
    if name in Function.__members__.values():
        head["function"] = Function(name).title
    match function:
        case Function.IDLE:
            return head
        case Function.ABORT:
            abort = Abort.parse(octets)
            return head | {
                "Subnet": abort.subnet,
                "Instance": abort.instance,
                "Reason_Code": abort.reason,
                "text": abort.text,
            }
        case Function.RESOURCE_MANAGER:
            manager = ResourceManagerRes.parse(octets)
            return head | {"Server_SAP": manager.server_sap, "Send_Timeout_s": ns_to_s(manager.send_timeout_ns)}
        case Function.INITIATE:
            return head | _initiate(octets, request=request)
        case Function.ALARM_ACK:
            ack = AlarmAck.parse(octets)
            return head | {
                "Slot_Number": ack.slot,
                "Alarm_Type": ack.type,
                "alarm": alarm_name(ack.type),
                "Alarm_Specifier": ack.specifier,
                "Seq_Nr": ack.sequence,
                "Add_Ack": ack.add_ack,
            }
        case Function.DATA_TRANSPORT:
            carried = DataTransport.parse(octets)
            return head | {"Slot_Number": carried.slot, "Index": carried.index, "data": carried.data.hex()}
    if request:
        asked = parse_request(octets)
        what: Fields = {"Length": asked.length} if isinstance(asked, ReadReq) else {"data": asked.data.hex()}
        return head | {"Slot_Number": asked.slot, "Index": asked.index} | what
    answered = parse_response(octets)
    if isinstance(answered, Negative):
        return head | {
            "Error_Decode": answered.decode,
            "Error_Code_1": f"0x{answered.code_1:02x}",
            "Error_Code_2": f"0x{answered.code_2:02x}",
            "text": answered.text,
        }
    got: Fields = {"data": answered.data.hex()} if isinstance(answered, ReadRes) else {"Length": answered.length}
    return head | {"Slot_Number": answered.slot, "Index": answered.index} | got


def _initiate(octets: bytes, *, request: bool) -> Fields:
    initiate = (InitiateReq if request else InitiateRes).parse(octets)
    found: Fields = {
        "Features_Supported": f"0x{initiate.features:04x}",
        "Profile_Features_Supported": f"0x{initiate.profile_features:04x}",
        "Profile_Ident_Number": _ident(initiate.profile_ident),
        "S_Addr": _address(initiate.source),
        "D_Addr": _address(initiate.destination),
    }
    if isinstance(initiate, InitiateReq):
        return {"Send_Timeout_s": ns_to_s(initiate.send_timeout_ns)} | found
    return {"Max_Len_Data_Unit": initiate.max_len} | found


def _address(one: Address) -> Fields:
    return {"API": one.api, "SCL": one.scl, "net": one.net.hex()}
