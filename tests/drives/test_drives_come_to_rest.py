"""A running drive comes to rest on every way out of Operate, and stays at rest when the bus returns to it."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

import pytest
from api_kit import begun, bus_of, cancelled, device_of, running
from drive_bench import PluginBench

from dpstack.devices.finding import find

pytestmark = pytest.mark.virtual_time

Table = Mapping[str, object]
FAN: Table = {"name": "fan", "address": 4, "drive": "fuji-frenic", "telegram": "PPO3", "ident": 0xDD04}
IMO: Table = {"name": "pump", "address": 5, "drive": "imo-hd2", "options": {"baud_index": 5, "set_map": True}}
PUMP: Table = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "PPO3"}


@pytest.mark.parametrize("way", ["clear", "stop"])
@pytest.mark.parametrize(
    ("table", "at_rest"),
    [
        (FAN, "02 31 00 00"),
        (IMO, "00 " * 8 + "41 03 00 00" + " 00" * 20),
        (PUMP, ""),
        ({**PUMP, "options": {"profile": "ls"}}, ""),
        ({**PUMP, "telegram": "VENDOR 2/3"}, ""),
    ],
    ids=["fuji", "imo", "ls", "ls-profile", "ls-vendor"],
)
async def test_a_running_drive_comes_to_rest(table: Table, at_rest: str, way: str) -> None:
    """The safe outputs ramp it down before Clear: PROFIdrive ignores its zeros, CTW bit 10 of a Fuji has it ignore
    them, to an IMO they are no command (docs/reference/drives/fuji.md#control-and-status-word,
    docs/reference/drives/imo-hd2.md#control-and-status-word).
    """
    async with running(table) as (bus, drive):
        device = device_of(bus, drive.address)
        await drive.start()
        drive.speed = 0.5
        await drive.reached()
        await (bus.clear() if way == "clear" else bus.stop())
        await asyncio.sleep(0.15)  # before its watchdog could do it
        await bus.clear()
        for _ in range(40):  # 2 s at most
            if device.motor.frequency == 0:
                break
            await asyncio.sleep(0.05)
        await asyncio.sleep(0.2)
        assert device.motor.frequency == 0
        assert bus.slave(drive.address).inputs.hex(" ").endswith(at_rest)
        await bus.operate()
        await asyncio.sleep(0.5)
        assert device.motor.frequency == 0
        assert bus.slave(drive.address).inputs.hex(" ").endswith(at_rest)
        assert drive.speed == 0.5  # the set point stays, the run command does not


async def test_a_start_nobody_waits_for_any_more_never_comes_true() -> None:
    """Cancelled before the bus operates, the order must not turn the motor once it does."""
    async with bus_of(FAN) as bus:
        fan = bus.drive("fan")
        await bus.ready()
        await cancelled(await begun(fan.start(timeout=60), 0.1))
        await bus.operate()
        fan.speed = 0.5
        await asyncio.sleep(1)
        assert bus.slave("fan").inputs == bytes.fromhex("02 31 00 00")


def test_a_start_cancelled_half_way_takes_its_command_back() -> None:
    """Octets by docs/reference/drives/fuji.md#worked-run: 047F begins the run, 047E ends it."""
    bench = PluginBench(find("fuji-frenic").core("fan", "PPO3", {}), "02 40 00 00")
    start = bench.order("start", timeout_s=60)
    assert bench.see("02 31 00 00", 2) == "04 7F 00 00"
    cancel = bench.order("cancel", order=start)
    assert bench.out() == "04 7E 00 00"
    assert bench.see("02 37 00 00", 5) == "04 7E 00 00"
    assert bench.result(start) is None
    assert bench.result(cancel) == {"type": "result", "token": cancel, "ok": True, "value": 1}
