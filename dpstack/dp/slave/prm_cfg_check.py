"""Checks of Set_Prm and Chk_Cfg at a slave."""

from __future__ import annotations

from typing import NamedTuple

from dpstack.dp.error_origin import DEVICE_CALL
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN
from dpstack.dp.pdu.dpv1_status import FAIL_SAFE, WD_BASE_1MS
from dpstack.dp.pdu.requests import SetPrm
from dpstack.dp.slave.device import DpV0Device
from dpstack.dp.slave_params import WatchdogTime
from dpstack.errors import ConfigError
from dpstack.fdl.telegram import MAX_DATA
from dpstack.gsd.identifiers import agree, io_lengths


class Refusal(NamedTuple):
    """Why a service is refused, with the octet, and whether it is for something the slave does not support."""

    reason: str
    not_supported: bool = False


def judge_prm(device: DpV0Device, prm: SetPrm, *, ask_device: bool) -> Refusal | None:
    """Judge ``prm`` for ``device``; None when it is accepted. Exceptions of ``device.check_prm`` pass through."""
    if not prm.lock and not prm.unlock:
        return None  # only min T_SDR is taken, whatever the ident number (docs/reference/protocol.md#set_prm)
    if prm.ident != device.ident and prm.ident not in device.other_idents:
        return Refusal(f"octets 5-6: ident number 0x{prm.ident:04X}, this device is 0x{device.ident:04X}")
    if prm.unlock:
        return None
    if prm.watchdog is not None and 0 in prm.watchdog:
        return Refusal(f"octet {2 + prm.watchdog.index(0)}: watchdog factor 0 with WD_On")
    if prm.sync and not device.sync_supported:
        return Refusal("octet 1: SYNC is not supported", True)
    if prm.freeze and not device.freeze_supported:
        return Refusal("octet 1: FREEZE is not supported", True)
    if device.fail_safe_required and not _dpv1_status(prm) & FAIL_SAFE:
        return Refusal(
            "octet 8 bit 6: Fail_Safe is not set, this device needs a master that sends empty frames in Clear"
        )
    if not ask_device:
        return None
    with DEVICE_CALL:
        reason = device.check_prm(prm.user_prm)
    return None if reason is None else Refusal(f"octet 8 on: {reason}")


def watchdog_time(device: DpV0Device, prm: SetPrm) -> int:
    """The watchdog time that ``prm`` asks for in ns, 0 when it is off (docs/reference/protocol.md#watchdog)."""
    if prm.watchdog is None:
        return 0
    fine = device.wd_base_1ms and _dpv1_status(prm) & WD_BASE_1MS
    return WatchdogTime(prm.watchdog, 1 if fine else 10).ns


def _dpv1_status(prm: SetPrm) -> int:
    return prm.user_prm[0] if prm.user_prm else 0


def real_cfg(device: DpV0Device, config: bytes) -> bytes:
    """The device's own configuration if ``config`` wants no comparison
    (docs/reference/protocol.md#special-identifiers), else ``config``."""
    if config in device.configs:
        return config
    return next((real for real in device.configs if agree(real, config)), config)


def judge_cfg(device: DpV0Device, config: bytes) -> tuple[int, int] | Refusal:
    """(input octets, output octets) of ``config``, or the refusal. Exceptions of ``device.check_cfg`` pass through."""
    try:
        lengths = io_lengths(config)
    except ConfigError as error:
        return Refusal(str(error))
    if max(lengths) > MAX_DATA:
        return Refusal(f"{lengths[0]} input and {lengths[1]} output octets, {MAX_DATA} each are possible")
    with DEVICE_CALL:
        reason = device.check_cfg(config)
    return lengths if reason is None else Refusal(reason)


def check_device(device: DpV0Device) -> None:
    """Raise ConfigError if ``device`` could never be on a bus."""
    if not 0 <= device.ident <= 0xFFFF:
        raise ConfigError(f"device {device.name}: ident {device.ident:#x} does not fit two octets")
    if not device.configs or any(len(config) > MAX_DATA for config in device.configs):
        raise ConfigError(f"device {device.name}: configs must hold identifier octets (up to {MAX_DATA} each)")
    if not FIXED_LEN <= device.max_diag_len <= MAX_LEN:
        raise ConfigError(f"device {device.name}: max_diag_len {device.max_diag_len} is outside {FIXED_LEN}..{MAX_LEN}")
