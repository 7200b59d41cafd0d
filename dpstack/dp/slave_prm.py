"""What a slave makes of Set_Prm and Chk_Cfg: the judgement, and the watchdog that comes out of it."""

from __future__ import annotations

from typing import NamedTuple

from dpstack.dp.device import Device
from dpstack.dp.pdu import SetPrm
from dpstack.dp.setup import watchdog_ns
from dpstack.errors import ConfigError
from dpstack.fdl.telegram import MAX_DATA
from dpstack.gsd.identifiers import io_lengths
from dpstack.units import NEVER


class Refusal(NamedTuple):
    """Why a service is refused, with the octet, and whether it is for something the slave does not support."""

    reason: str
    not_supported: bool = False


def judge_prm(device: Device, prm: SetPrm, *, ask_device: bool) -> Refusal | None:
    """Judge ``prm`` for ``device``; None when it is accepted. Exceptions of ``device.check_prm`` pass through."""
    if not prm.lock and not prm.unlock:
        return None  # p734: only min T_SDR is taken, whatever the ident number
    if prm.ident != device.ident:
        return Refusal(f"octets 5-6: ident number 0x{prm.ident:04X}, this device is 0x{device.ident:04X}")
    if prm.unlock:
        return None
    if prm.watchdog is not None and 0 in prm.watchdog:
        return Refusal(f"octet {2 + prm.watchdog.index(0)}: watchdog factor 0 with WD_On")
    if prm.sync and not device.sync_supported:
        return Refusal("octet 1: SYNC is not supported", True)
    if prm.freeze and not device.freeze_supported:
        return Refusal("octet 1: FREEZE is not supported", True)
    reason = device.check_prm(prm.user_prm) if ask_device else None
    return None if reason is None else Refusal(f"octet 8 on: {reason}")


def judge_cfg(device: Device, config: bytes) -> tuple[int, int] | Refusal:
    """(input octets, output octets) of ``config``, or the refusal. Exceptions of ``device.check_cfg`` pass through."""
    try:
        lengths = io_lengths(config)
    except ConfigError as error:
        return Refusal(str(error))
    if max(lengths) > MAX_DATA:
        return Refusal(f"{lengths[0]} input and {lengths[1]} output octets, {MAX_DATA} each are possible")
    reason = device.check_cfg(config)
    return lengths if reason is None else Refusal(reason)


def check_device(device: Device) -> None:
    """Raise ConfigError where ``device`` could never be on a bus."""
    if not 0 <= device.ident <= 0xFFFF:
        raise ConfigError(f"device {device.name}: ident {device.ident:#x} does not fit two octets")
    if not device.configs or any(len(config) > MAX_DATA for config in device.configs):
        raise ConfigError(f"device {device.name}: configs must hold identifier octets (up to {MAX_DATA} each)")


class Watchdog:
    """Response monitoring of the owner. ``heard`` is the time of its last request, ``at`` when to judge (or NEVER).

    The deadline is moved only when it has come: an exchange just notes its time.
    """

    __slots__ = ("at", "heard", "time_ns")

    def __init__(self) -> None:
        self.at = NEVER
        self.heard = 0
        self.time_ns = 0

    def arm(self, factors: tuple[int, int] | None, now: int) -> None:
        """Take the factors of Set_Prm, None = off."""
        self.heard = now
        self.time_ns = 0 if factors is None else watchdog_ns(factors)
        self.at = now + self.time_ns if self.time_ns else NEVER

    def disarm(self) -> None:
        """Nobody to watch."""
        self.time_ns = 0
        self.at = NEVER

    def expired(self, now: int) -> bool:
        """Whether the time is over; otherwise the deadline moves on."""
        if self.at > now:
            return False
        self.at = self.heard + self.time_ns
        return self.at <= now
