"""Demag's plugin and a simulated Demag on benches, for their tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from drive_bench import ALONE, DeviceBench, PluginBench

from dpstack_drives.demag import DRIVE
from dpstack_drives.demag.simulator import DemagDevice

DemagBench = DeviceBench[DemagDevice]
NONE: Mapping[str, Any] = {}
ZERO = "00 00 00 00 00 00 00 00 "
#: shutdown, switch on, enable operation
START = ("00 06", "00 07", "00 0F")


def device(telegram: str = "PPO1", **presets: Any) -> DemagDevice:
    """Control by the bus (412 = 1) unless ``presets`` say otherwise."""
    found = DRIVE.simulated(telegram, {}, {"412": 1, **presets})
    assert isinstance(found, DemagDevice)
    return found


def sim(telegram: str = "PPO3", presets: Mapping[str, Any] = NONE, **options: Any) -> DemagBench:
    return DeviceBench(device(telegram, **presets, **options), DRIVE.telegram(telegram).config.hex())


def enable(bench: DemagBench, outputs: str = "20 00", *, head: str = "", words: Sequence[str] = START) -> None:
    """The control words of a start one after the other, each in front of ``outputs``."""
    for control in words:
        bench.send(f"{head}{control} {outputs}")


def pkw(bench: DeviceBench[Any], order: str) -> str:
    """One order with its handshake (docs/reference/drives/demag.md#handshake-of-the-parameter-channel) in PPO1; the
    reply's eight octets."""
    assert bench.send(ZERO + "00 00 00 00")[:23] == ZERO.strip()
    return bench.send(order + " 00 00 00 00")[:23]


def plugin(inputs: str, telegram: str = "PPO3", **options: object) -> PluginBench:
    return PluginBench(DRIVE.core("hoist", telegram, {**ALONE, **options}), inputs)


def ppo3(inputs: str = "02 40 00 00", **options: object) -> PluginBench:
    return plugin(inputs, "PPO3", **options)


def ppo1(inputs: str = ZERO + "02 40 00 00", **options: object) -> PluginBench:
    return plugin(inputs, "PPO1", **options)
