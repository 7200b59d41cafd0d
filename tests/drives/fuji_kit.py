"""Fuji's plugin and a simulated FRENIC on benches, for their tests."""

from __future__ import annotations

from copy import copy
from typing import Any

from drive_bench import ALONE, DeviceBench, PluginBench, S

from dpstack_drives.fuji import DRIVE
from dpstack_drives.fuji.simulator import FujiDevice

FujiBench = DeviceBench[FujiDevice]
ZERO = "00 00 00 00 00 00 00 00 "
S1 = "02 40 00 00"
IDLE = ZERO + S1
#: PPO2: PCV, two words, PCD1 to PCD4
WIDE = " 00 00 00 00 00 00 00 00"


def device(telegram: str = "PPO3", **presets: Any) -> FujiDevice:
    found = DRIVE.simulated(telegram, {}, presets)
    assert isinstance(found, FujiDevice)
    return found


def sim(telegram: str = "PPO3", **presets: Any) -> FujiBench:
    found = device(telegram, **presets)
    return DeviceBench(found, found.own.config.hex())


def running(**presets: Any) -> FujiBench:
    """With 047F, at the set point 4000."""
    bench = sim(**presets)
    bench.send("04 7E 40 00")
    bench.until("04 7F 40 00", "03 37 40 00", 3000)
    return bench


def again(bench: FujiBench, seconds: float = 0.1, **presets: Any) -> FujiBench:
    """Power off and on."""
    after = device("PPO2", **presets)
    after.inherit(bench.device)
    other = copy(bench)
    other.device = after
    other.now += round(seconds * S)
    after.enter(after.own.config, other.now)
    return other


def pkw(bench: FujiBench, order: str) -> str:
    """A fresh order in PPO1 or PPO2."""
    rest = "00 00 00 00" + (WIDE if bench.device.telegram.name == "PPO2" else "")
    bench.send(ZERO + rest, 10)
    return bench.send(f"{order} {rest}", 10)[:23]


def plugin(telegram: str = "PPO3", inputs: str = S1, **options: object) -> PluginBench:
    return PluginBench(DRIVE.core("fan", telegram, {**ALONE, **options}), inputs)
