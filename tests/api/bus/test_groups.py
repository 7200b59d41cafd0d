"""Groups, slaves out of service and parameterised anew, auto-clear: the public API in virtual time."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from api_kit import FAN, RAW, begun, bench_of, bus_of, operating
from gsd_kit import FILES
from support import present

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.config.config import parse_config
from dpstack.dp.master.commands import DeactivateSlave, SetMode
from dpstack.dp.master.events import AutoCleared, OperateWaits

pytestmark = pytest.mark.virtual_time

NORTH = RAW | {"name": "north", "address": 5, "groups": [1], "sync": True, "freeze": True}
SOUTH = RAW | {"name": "south", "address": 6, "groups": [1, 2], "sync": True, "freeze": True}


async def test_sync_returns_when_its_last_bit_has_left() -> None:
    async with operating(NORTH, SOUTH) as bus:
        sent = await bus.sync(1)
        assert core_of(bus).runtime.now() >= sent.t_ns
        wire = [tx for tx in present(bus.world).log if tx.octets[9:11] == b"\x20\x01"]
        assert [tx.end_ns for tx in wire] == [sent.t_ns]
        assert bus.slave("north").synced
        bus.slave("north").outputs = b"\x11"
        await asyncio.sleep(0.1)
        assert bus.slave("north").inputs == b"\x00"  # held
        await bus.sync([1, 2], settle=True)
        await asyncio.sleep(0.01)
        assert bus.slave("north").inputs == b"\x11"
        await bus.unsync()
        assert not bus.slave("north").synced
        await bus.freeze(0)
        assert bus.slave("south").frozen
        await bus.unfreeze(0)
        assert not bus.slave("south").frozen


async def test_a_group_is_written_and_read_at_one_moment_and_let_go_in_the_end() -> None:
    async with operating(NORTH, SOUTH, RAW) as bus:
        async with bus.group(1) as group:
            assert [slave.name for slave in group.members] == ["north", "south"]
            await group.write({"north": b"\x01", 6: b"\x02"})
            await asyncio.sleep(0.01)
            assert await group.read() == {"north": b"\x01", "south": b"\x02"}
            picture = await group.exchange({"north": b"\x03"})
            assert picture["south"] == b"\x02"
            assert bus.slave("south").synced
            assert bus.slave("south").frozen
        assert not bus.slave("south").synced
        assert not bus.slave("south").frozen


async def test_nothing_is_half_written() -> None:
    async with operating(NORTH, SOUTH, RAW) as bus:
        group = bus.group(1)
        with pytest.raises(dpstack.UsageError, match=r"slave 6 \(south\): 2 octets of outputs given"):
            await group.write({"north": b"\x01", "south": b"\x02\x03"})
        with pytest.raises(dpstack.UsageError, match=r"slave 9 \(raw\) is not in this group; in it are: north, so"):
            await group.write({"north": b"\x01", "raw": b"\x02"})
        assert bus.slave("north").outputs == b"\x00"
        with pytest.raises(dpstack.UsageError, match=r"slave 9 \(raw\): not parameterised for SYNC"):
            await bus.sync()
        with pytest.raises(dpstack.UsageError, match="no slave is in group 7; groups of this bus: 1, 2"):
            bus.group(7)


async def test_a_global_control_that_cannot_be_sent_says_why_and_does_not_hang() -> None:
    async with bus_of(NORTH, SOUTH) as bus:
        await bus.ready()
        with pytest.raises(dpstack.UsageError, match="in Clear all outputs are zero"):
            await bus.group(1).write({"north": b"\x01"})
        await bus.operate()
        bench_of(bus).power(6, False)
        with pytest.raises(dpstack.SlaveFault, match=r"slave 6 \(south\) is not in data exchange"):
            await bus.group(1).read()
        waiting = await begun(bus.sync(1), 0)
        core_of(bus).command(SetMode(dpstack.Mode.STOP))
        with pytest.raises(dpstack.BusError, match="the master goes to Stop"):
            await waiting
        await asyncio.sleep(0.1)
        with pytest.raises(dpstack.UsageError, match="in Stop"):
            await bus.sync(1)
    with pytest.raises(dpstack.UsageError, match="not open"):
        await bus.sync(1)


async def test_out_of_service_and_back() -> None:
    async with operating(RAW, FAN) as bus:
        raw, fan = bus.slave("raw"), bus.drive("fan")
        await fan.start()
        fan.speed = 0.9
        pending = await begun(fan.reached(5), 0.05)
        await raw.deactivate()
        await fan.slave.deactivate()
        with pytest.raises(dpstack.DriveError):
            await pending
        await asyncio.sleep(0.5)
        assert raw.deactivated
        assert raw.state is dpstack.SlaveState.DEACTIVATED
        assert "deactivated" in present(raw.diagnosis).flags
        assert "is taken out of service by its master" in raw.diagnosis_texts
        await bus.ready(1)  # nobody waits for them
        with pytest.raises(dpstack.UsageError, match=r"slave 9 \(raw\) is out of service: activate\(\) it first"):
            await raw.ready()
        await raw.activate()
        await raw.ready()
        await fan.slave.activate()
        await bus.ready()
        await fan.start()


async def test_parameterised_anew() -> None:
    async with operating(RAW, NORTH) as bus:
        raw = bus.slave("raw")
        raw.outputs = b"\x42"
        await raw.reparameterise(watchdog_ms=500, groups=(3,), sync=True, user_prm=b"\x01\x02")
        assert (raw.watchdog_ms, raw.setup.groups, raw.outputs) == (500, (3,), b"\x42")
        await bus.sync(3, settle=True)
        await asyncio.sleep(0.01)
        assert raw.inputs == b"\x42"
        before = raw.setup
        changes: Any = {"colour": 1}
        with pytest.raises(dpstack.ConfigError, match=r"reparameterise: groups holds 9, outside 1\.\.8; correct"):
            await raw.reparameterise(groups=(9,))
        with pytest.raises(dpstack.ConfigError, match="safe has 1 octets"):
            await raw.reparameterise(config=b"\x21\x11", safe=b"\x00")
        with pytest.raises(dpstack.UsageError, match="'colour' cannot be changed; these can: after_return, c"):
            await raw.reparameterise(**changes)
        assert raw.setup is before
        assert raw.ready_now
        with pytest.raises(dpstack.SlaveFault, match="refuses the configuration"):
            await raw.reparameterise(config=b"\x21\x11")
        await raw.reparameterise(config=b"\x20\x10")


async def test_names_and_the_gsd_file_hold_new_parameters_too() -> None:
    named = {**RAW, "inputs": {"limit": "bool@0.3"}}
    told = {"name": "told", "address": 8, "gsd": str(FILES / "slots.gsd")}

    async with bus_of(named, told) as bus:
        await bus.ready()
        raw, other = bus.slave("raw"), bus.slave("told")
        before = raw.setup, other.setup
        with pytest.raises(dpstack.ConfigError, match=r"slave 9 \(raw\): limit = .* it has no inputs"):
            await raw.reparameterise(config=b"\x20")
        with pytest.raises(
            dpstack.ConfigError, match=r"slave 8 \(told\): reparameterise: sync = true, but its GSD .* = 0;"
        ):
            await other.reparameterise(sync=True)
        assert (raw.setup, other.setup) == before
        assert raw["limit"] is False
        assert raw.ready_now


AUTO = """
[bus]
port = "virtual"
baud = 500000
auto_clear = true
data_control_time_ms = 300
[[slave]]
name = "raw"
address = 9
ident = 0x1234
config = "20 10"
[[slave]]
name = "other"
address = 10
ident = 0x1234
config = "20 10"
ignore_auto_clear = true
"""


async def test_auto_clear_says_who_and_why() -> None:
    config = parse_config(AUTO, "auto.toml")
    assert (config.bus.auto_clear, config.bus.data_control_time_ms) == (True, 300)
    told: list[dpstack.Event] = []
    async with dpstack.open_bus(config, on_event=told.append) as bus:
        await bus.operate()
        assert bus.mode is dpstack.Mode.CLEAR
        assert isinstance(next(e for e in told if isinstance(e, OperateWaits)), OperateWaits)
        await bus.ready()
        await bus.until(lambda: bus.mode is dpstack.Mode.OPERATE, 1)
        bench_of(bus).power(10, False)
        await asyncio.sleep(1)
        assert not [e for e in told if isinstance(e, AutoCleared)]
        bench_of(bus).power(9, False)
        await bus.until(lambda: any(isinstance(e, AutoCleared) for e in told), 2)
        (cleared,) = [e for e in told if isinstance(e, AutoCleared)]
        assert "slave 9 (raw) had no data exchange for 300 ms" in cleared.text


async def test_removed_while_out_of_service() -> None:
    async with bus_of(RAW, NORTH) as bus:
        await bus.ready()
        await bus.slave("raw").deactivate()
        await bus.remove("raw")
        await asyncio.sleep(0.2)
        with pytest.raises(dpstack.UsageError, match="no slave with address 9"):
            core_of(bus).command(DeactivateSlave(9))
        await bus.add_slave(RAW)
        await bus.ready()
