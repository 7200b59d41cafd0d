"""Demag's plugin and a simulated Demag on benches, for their tests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drive_bench import ALONE, DeviceBench, PluginBench

from dpstack_drives.demag import DRIVE

NONE: Mapping[str, Any] = {}
ZERO = "00 00 00 00 00 00 00 00 "


def sim(telegram: str = "PPO3", presets: Mapping[str, Any] = NONE, **options: Any) -> DeviceBench:
    return DeviceBench(DRIVE.device(telegram, {"412": 1, **presets, **options}), DRIVE.telegram(telegram).config.hex())


def pkw(bench: DeviceBench, order: str) -> str:
    """One order with its handshake (docs/drives/demag.md#handshake-of-the-parameter-channel) in PPO1; the reply's eight
    octets."""
    assert bench.send(ZERO + "00 00 00 00")[:23] == ZERO.strip()
    return bench.send(order + " 00 00 00 00")[:23]


def plugin(inputs: str, telegram: str = "PPO3", **options: object) -> PluginBench:
    return PluginBench(DRIVE.core("hoist", telegram, {**ALONE, **options}), inputs)


def ppo3(inputs: str = "02 40 00 00", **options: object) -> PluginBench:
    return plugin(inputs, "PPO3", **options)


def ppo1(inputs: str = ZERO + "02 40 00 00", **options: object) -> PluginBench:
    return plugin(inputs, "PPO1", **options)
