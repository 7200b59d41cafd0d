"""LS S100: its plugin and a simulated one on benches, for their tests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drive_bench import ALONE, DeviceBench, PluginBench

from dpstack_drives.ls import DRIVE
from dpstack_drives.ls.simulator import LsDevice

LsBench = DeviceBench[LsDevice]
NONE: Mapping[str, float] = {}
NO_OPTIONS: dict[str, object] = {}
ZERO = "00 00 00 00 00 00 00 00 "
S2 = "02 35 00 00"


def sim(telegram: str = "PPO3", codes: Mapping[str, float] = NONE, **options: object) -> LsBench:
    """``codes``: parameters by code."""
    device = DRIVE.simulated(telegram, options, codes)
    assert isinstance(device, LsDevice)
    return DeviceBench(device, DRIVE.telegram(telegram).config.hex())


def pkw(bench: DeviceBench[Any], order: str) -> str:
    """A fresh order in PPO1."""
    bench.send(ZERO + "00 00 00 00", 10)
    return bench.send(order + " 00 00 00 00", 10)[:23]


def running(bench: LsBench, outputs: str = "04 7F 40 00", inputs: str = "03 37 40 00") -> LsBench:
    bench.send("04 7E 00 00")
    bench.until(outputs, inputs, 3000)
    return bench


def plugin(inputs: str = S2, telegram: str = "PPO3", **options: object) -> PluginBench:
    return PluginBench(DRIVE.core("pump", telegram, {**ALONE, **options}), inputs)
