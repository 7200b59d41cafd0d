"""KEB's plugin and a simulated F5 on benches, for their tests."""

from __future__ import annotations

from collections.abc import Mapping

from drive_bench import ALONE, DeviceBench, PluginBench

from dpstack_drives.keb import DRIVE
from dpstack_drives.keb.simulator import KebDevice

KebBench = DeviceBench[KebDevice]
NONE: Mapping[str, object] = {}
#: the parameter channel at rest, and the words of the default map
ZERO = "00 00 00 00 00 00 00 00"
IDLE = " 00 00 00 00"


def device(telegram: str = "PCH+4/4", presets: Mapping[str, object] = NONE) -> KebDevice:
    found = DRIVE.simulated(telegram, {}, presets)
    assert isinstance(found, KebDevice)
    return found


def again(before: KebDevice, telegram: str = "PCH+4/4", presets: Mapping[str, object] = NONE) -> KebDevice:
    """Power off and on."""
    after = device(telegram, presets)
    after.inherit(before)
    return after


def sim(presets: Mapping[str, object] = NONE, telegram: str = "4/4") -> KebBench:
    return DeviceBench(device(telegram, presets), DRIVE.telegram(telegram).config.hex())


def plugin(inputs: str = ZERO + IDLE, telegram: str = "PCH+4/4", **options: object) -> PluginBench:
    return PluginBench(DRIVE.core("hoist", telegram, {**ALONE, **options}), inputs)
