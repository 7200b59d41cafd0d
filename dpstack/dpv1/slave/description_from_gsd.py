"""The description of a slave from its GSD file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from dpstack.dp.pdu.alarm_blocks import HEAD, SEQUENCES
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN
from dpstack.dp.pdu.dpv1_status import ALARM_LIMITS
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.slave_params import INTERVAL_UNIT
from dpstack.dpv1.pdu.im import Im, Im0, Im1, Im2, Im3, Im4
from dpstack.dpv1.pdu.ms2 import LEAST_INITIATE
from dpstack.dpv1.slave.description import SlaveDescription, SlaveModule, SlaveParameter
from dpstack.dpv1.slave.resource_manager import MAX_CONNECTIONS
from dpstack.errors import ConfigError
from dpstack.fdl.telegram import MAX_DATA
from dpstack.gsd.configuration import Configuration, fixed_modules, is_fixed, plug
from dpstack.gsd.dpv1_keywords import alarm_kinds
from dpstack.gsd.identifiers import MAX_USER_PRM, io_lengths
from dpstack.gsd.model import Device, Module, PrmBlock
from dpstack.params import DPV1_STATUS_LEN

if TYPE_CHECKING:
    from dpstack.dpv1.slave.dxb_links import DxbSupport

#: the numbers of a release
_NUMBERS: Final = re.compile(r"\d{1,5}")
#: what stands for an empty slot of a modular station
EMPTY_SLOT: Final = SlaveModule("empty slot", b"\0")


def slave_description(
    device: Device,
    chosen: Configuration | None = None,
    *,
    name: str = "",
    ident: int | None = None,
    user_prm: int | None = None,
) -> SlaveDescription:
    """The slave of the type ``device``.

    ``chosen``: what is plugged into it, and nothing else is accepted then, nor user parameters of another length than
    these modules have (blocks may follow if the file has them). None: a compact station accepts any one of its
    modules, a modular one any row of them and of empty slots within its
    limits, behind its fixed presets, both up to Max_User_Prm_Data_Len octets of user parameters; modules that the file
    breaks off in, or whose identifier octets contradict themselves, are left out. ``ident`` if the file has none;
    ``user_prm``: octets of user parameters, if they are not those of the ``chosen`` modules. Raises ConfigError.
    """
    gsd = device.dpv1
    number = device.ident if ident is None else ident
    if number is None:
        raise ConfigError(f"{device.model or 'the GSD file'} has no Ident_Number; give ident")
    compact = not device.modular
    most = device.user_prm_data_len if device.max_user_prm_data_len is None else device.max_user_prm_data_len
    prm = (0 if chosen is None else len(chosen.user_prm().octets())) if user_prm is None else user_prm
    longest = _within(most, MAX_USER_PRM)
    dpv1 = gsd.slave and (prm or longest) >= DPV1_STATUS_LEN
    presets = fixed_modules(device) if chosen is None else ()
    if presets and len(presets) == len(device.modules):
        chosen, presets = plug(device, presets), ()
    configs: tuple[bytes, ...] = () if chosen is None else (chosen.config,)
    modules = _modules(device) if chosen is None else ()
    if compact and modules:  # it accepts any one of them
        configs, modules, presets = tuple(dict.fromkeys(module.config for module in modules)), (), ()
    structured = gsd.prm_block_structure or gsd.prm_block_structure_required
    return SlaveDescription(
        ident=number,
        name=name or device.model or "slave",
        configs=configs,
        modules=modules,
        presets=tuple(_module(device, m) for m in presets if m.config),
        max_modules=1 if compact else device.max_module or MAX_DATA,
        # a compact station has no need of these keywords: they count for a modular one
        max_input_len=_within(None if compact else device.max_input_len, MAX_DATA),
        max_output_len=_within(None if compact else device.max_output_len, MAX_DATA),
        max_data_len=_within(None if compact else device.max_data_len, 2 * MAX_DATA),
        # blocks may follow those of the modules
        user_prm_len=(prm, max(prm, longest) if dpv1 and structured else prm) if prm else (0, longest),
        sync=device.sync,
        freeze=device.freeze,
        fail_safe=device.fail_safe,
        fail_safe_required=gsd.fail_safe_required,
        set_slave_add=device.set_slave_add,
        wd_base_1ms=gsd.wd_base_1ms,
        prm_blocks=gsd.prm_block_structure,
        prm_blocks_required=gsd.prm_block_structure_required,
        ms2=_within(gsd.c2_max_count_channels or 1, MAX_CONNECTIONS) if gsd.c2_read_write else 0,
        ms2_max_len=_within(gsd.c2_max_data_len or None, MAX_RECORD),
        ms2_max_initiate=max(LEAST_INITIATE, _within(gsd.max_initiate_pdu_length or None, MAX_DATA)),
        dpv1=dpv1,
        **(_alarms(device) if dpv1 else {}),
        dxb=_dxb(device) if dpv1 else None,
        max_diag_len=max(FIXED_LEN, _within(device.max_diag_data_len, MAX_LEN)),
        rates={speed.baud: speed.max_tsdr or 0 for speed in device.speeds},
        min_slave_interval_ns=(device.min_slave_interval or 0) * INTERVAL_UNIT,
        vendor=device.vendor,
        revision=device.revision,
        parameters=_parameters(device, device.prm),
        diag_texts=device.diagnosis.texts,
    )


def im_of_gsd(device: Device, modules: Sequence[Module | None]) -> dict[int, tuple[Im, ...]]:
    """I&M of a device by slot, as far as its GSD file says it: I&M0 to 4 of slot 0, the station itself, and I&M0 of
    each of the plugged ``modules``. Empty without Ident_Maintenance_supp.
    """
    if not device.dpv1.ident_maintenance:
        return {}
    hardware = _NUMBERS.findall(device.hardware_release) or ["0"]
    software = [*_NUMBERS.findall(device.software_release), "0", "0", "0"][:3]
    of_device = Im0(
        order_id=_visible(device.order_number or device.model),
        hardware_revision=min(int(hardware[0]), 0xFFFF),
        software_revision="V" + ".".join(str(min(int(part), 0xFF)) for part in software),
    )
    found: dict[int, tuple[Im, ...]] = {
        slot: (replace(of_device, order_id=_visible(module.name)),)
        for slot, module in enumerate(modules, device.first_slot)
        if module is not None
    }
    return found | {0: (of_device, Im1(), Im2(), Im3(), Im4())}


def _visible(text: str) -> str:
    """``text`` as an order number of I&M: 20 ASCII characters."""
    return "".join(letter if " " <= letter <= "~" else "?" for letter in text)[:20]


def _parameters(device: Device, block: PrmBlock) -> tuple[SlaveParameter, ...]:
    """The user parameters by name that ``block``, of the device or a module, refers to."""
    placed = ((ref.offset, device.parameters.get(ref.number)) for ref in block.refs)
    return tuple(
        SlaveParameter(one.name, offset, one.type.text, one.default, one.allowed, one.texts)
        for offset, one in placed
        if one is not None
    )


def _alarms(device: Device) -> dict[str, Any]:
    """Its alarms; an impossible count of alarms at a time becomes 0 (no sequence mode) or the largest possible one.

    Nothing if the file leaves its diagnosis no room for one.
    """
    if _within(device.max_diag_data_len, MAX_LEN) < FIXED_LEN + HEAD:
        return {}
    count = device.dpv1.alarm_sequence_mode_count
    return {
        "alarms": alarm_kinds(device.dpv1.alarms),
        "alarm_sequence": min(count, SEQUENCES) if count >= ALARM_LIMITS[1] else 0,
        "extra_alarm_sap": device.dpv1.extra_alarm_sap,
    }


def _dxb(device: Device) -> DxbSupport | None:
    """Publisher and subscriber, as many links as its diagnosis has room for."""
    if not (device.publisher or device.subscriber):
        return None
    from dpstack.dp.pdu.dxb import MAX_LINKS  # these here, as few devices have it
    from dpstack.dpv1.slave.dxb_links import DxbSupport

    room = max(0, _within(device.max_diag_data_len, MAX_LEN) - FIXED_LEN - HEAD) // 2
    links = min(_within(device.dxb_max_link_count, MAX_LINKS), room) if device.subscriber else 0
    octets = _within(device.dxb_max_data_length, MAX_DATA)
    return DxbSupport(device.publisher, links, octets, device.first_slot)


def _modules(device: Device) -> tuple[SlaveModule, ...]:
    usable = tuple(
        _module(device, m) for m in device.modules if m.complete and _possible(m.config) and not is_fixed(device, m)
    )
    if not usable:
        raise ConfigError(f"{device.model or 'the GSD file'} has no module with identifier octets")
    return (*usable, EMPTY_SLOT) if device.modular else usable


def _module(device: Device, module: Module) -> SlaveModule:
    """The module with its user parameters: the constant octets, and those by name."""
    block = module.prm
    if not block.present:
        return SlaveModule(module.name, module.config)
    reach = max((one.offset + len(one.octets) for one in block.consts), default=0)
    length = reach if block.length is None else block.length
    if max(reach, length) > MAX_USER_PRM:  # no Set_Prm could carry them
        return SlaveModule(module.name, module.config)
    octets = bytearray(length)
    for one in block.consts:
        octets[one.offset : one.offset + len(one.octets)] = one.octets
    return SlaveModule(module.name, module.config, bytes(octets[:length]), _parameters(device, block))


def _possible(config: bytes) -> bool:
    try:
        io_lengths(config)
    except ConfigError:
        return False
    return bool(config)


def _within(value: int | None, most: int) -> int:
    return most if value is None else min(value, most)
