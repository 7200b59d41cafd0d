"""LS S100: its plugin and a simulated one on benches, for their tests."""

from __future__ import annotations

from collections.abc import Mapping

from drive_bench import ALONE, DeviceBench, PluginBench, as_mapping

from dpstack_drives.ls import DRIVE

NONE: Mapping[str, float] = {}
NO_OPTIONS: dict[str, object] = {}
ZERO = "00 00 00 00 00 00 00 00 "
S2 = "02 35 00 00"


def sim(telegram: str = "PPO3", codes: Mapping[str, float] = NONE, **options: object) -> DeviceBench:
    """``codes``: parameters by code."""
    return DeviceBench(DRIVE.device(telegram, {**options, **codes}), DRIVE.telegram(telegram).config.hex())


def pkw(bench: DeviceBench, order: str) -> str:
    """A fresh order in PPO1."""
    bench.send(ZERO + "00 00 00 00", 10)
    return bench.send(order + " 00 00 00 00", 10)[:23]


def running(bench: DeviceBench, outputs: str = "04 7F 40 00", inputs: str = "03 37 40 00") -> DeviceBench:
    bench.send("04 7E 00 00")
    bench.until(outputs, inputs, 3000)
    return bench


def plugin(inputs: str = S2, telegram: str = "PPO3", **options: object) -> PluginBench:
    return PluginBench(DRIVE.core("pump", telegram, {**ALONE, **options}), inputs)


def text(bench: PluginBench, token: int) -> str:
    """What an order came to, in words."""
    return str(as_mapping(bench.result(token))["text"])
