"""``await slave.alarm(...)``: over when the master, who knows octets only, has acknowledged it; every error typed."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest
from slave_alarm_kit import OctetMaster, prm

import dpstack
from dpstack import AlarmError, AlarmType, Specifier, StatusType
from dpstack.api.slave_side.slave_server import ServedSlave
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave.application import SlaveApp
from dpstack.errors import ConfigError, PduError, SlaveTimeout, UsageError
from dpstack.slave import DpSlave, ModuleState, SlaveDescription

pytestmark = pytest.mark.virtual_time

RIG = SlaveDescription.simple(0x0A35, inputs=1, outputs=1, name="rig", dpv1=True, alarms=("process", "diagnostic"))


@contextlib.asynccontextmanager
async def rig(
    description: SlaveDescription = RIG, parameters: bytes | None = None
) -> AsyncIterator[tuple[ServedSlave, OctetMaster]]:
    """Slave 8 in data exchange with a master of octets."""
    device = DpSlave(description, lambda outputs, elapsed: outputs)
    async with dpstack.slave.serve_slave(device, world=dpstack.World(), address=8) as server:
        app = server.slave.station.responder
        assert isinstance(app, SlaveApp)
        master = OctetMaster(device, app)
        master.start_with(prm() if parameters is None else parameters, device.configs[0], b"\x55")
        yield server.slave, master


async def raised(slave: ServedSlave, *args: Any, **keys: Any) -> asyncio.Task[None]:
    """Under way."""
    task = asyncio.create_task(slave.alarm(*args, **keys))
    await asyncio.sleep(0)
    return task


async def test_it_is_over_when_it_is_acknowledged() -> None:
    async with rig() as (slave, master):
        first = await raised(slave, AlarmType.PROCESS, 3, data=b"\xaa")
        second = await raised(slave, AlarmType.DIAGNOSIS, 3, Specifier.APPEARS, add_ack=True)
        assert master.fetch() == "05 02 03 00 AA"
        assert master.fetch() == "04 01 03 0D"
        await asyncio.sleep(5)
        assert master.ack("03 01 0D") == "5C 03 01 0D"
        await second
        assert not first.done()
        assert master.ack("03 02 00") == "5C 03 02 00"
        await first


async def test_status_messages() -> None:
    async with rig() as (slave, master):
        slave.status(StatusType.MESSAGE, 2, Specifier.DISAPPEARS, b"\x01\x02")
        slave.module_status([ModuleState.OK, ModuleState.MISSING])
        assert master.fetch() == "06 81 02 02 01 02"
        assert master.fetch() == "05 82 00 00 0C"
        assert not master.must_fetch


@pytest.mark.parametrize(
    ("parameters", "kind", "reason"),
    [
        (None, AlarmType.UPDATE, "not supported"),
        (prm(0x40), AlarmType.DIAGNOSIS, "not enabled"),
        (prm()[:7] + b"\0\0\0", AlarmType.PROCESS, "not in data exchange"),
    ],
)
async def test_an_alarm_that_cannot_go_out_raises_at_once(
    parameters: bytes | None, kind: AlarmType, reason: str
) -> None:
    async with rig(parameters=parameters) as (slave, _):
        with pytest.raises(AlarmError, match="slave rig: ") as caught:
            await slave.alarm(kind, 1)
        assert caught.value.reason == reason


async def test_leaving_data_exchange_and_the_end_of_serving() -> None:
    async with rig() as (slave, master):
        for leave in (slave.restart, lambda: master.prm(prm())):
            task = await raised(slave, AlarmType.PROCESS, 3)
            leave()
            with pytest.raises(AlarmError, match=r"slave 8 \(rig\): process alarm, slot 3: data") as caught:
                await task
            assert caught.value.reason == "data exchange ended"
            master.start_with(prm(), RIG.configs[0], b"\x55")
        task = await raised(slave, AlarmType.PROCESS, 3)
    with pytest.raises(AlarmError):
        await task


async def test_a_time_limit_says_where_it_got_stuck() -> None:
    async with rig() as (slave, master):
        with pytest.raises(SlaveTimeout, match="its master has not fetched it"):
            await slave.alarm(AlarmType.PROCESS, 3, timeout=0.5)
        assert not master.must_fetch  # withdrawn
        task = await raised(slave, AlarmType.PROCESS, 3, timeout=0.5)
        master.fetch()
        with pytest.raises(SlaveTimeout, match="sends no Alarm_Ack"):
            await task
        assert master.ack("03 02 08") == "5C 03 02 08"  # late, and right


async def test_cancelled_it_is_withdrawn() -> None:
    async with rig() as (slave, master):
        task = await raised(slave, AlarmType.PROCESS, 3)
        task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()
        assert not master.must_fetch


async def test_misuse() -> None:
    async with rig() as (slave, _):
        for args in ((9, 1), (2, 255), (2, 1, 4), (2, 1, 0, bytes(60))):
            with pytest.raises(PduError):
                await slave.alarm(*args)
        with pytest.raises(PduError):
            slave.status(29)
    async with rig(SlaveDescription.simple(0x0A35, inputs=1, outputs=1)) as (slave, _):
        with pytest.raises(UsageError, match="it has no DP-V1"):
            await slave.alarm(AlarmType.PROCESS, 1)
        with pytest.raises(UsageError, match="it has no DP-V1"):
            slave.status(1)


def test_descriptions() -> None:
    with pytest.raises(ConfigError, match="alarms without dpv1"):
        SlaveDescription.simple(1, inputs=1, outputs=1, alarms=("process",))
    with pytest.raises(ConfigError, match="slave slave: there is no 'fire' alarm"):
        SlaveDescription.simple(1, inputs=1, outputs=1, dpv1=True, alarms=("fire",))
    with pytest.raises(ConfigError, match="no room for an alarm"):
        SlaveDescription(ident=1, configs=(b"\x10",), dpv1=True, alarms=("process",), max_diag_len=9)
    assert RIG.table(8)["dpv1"] == {"alarms": ["process", "diagnostic"], "alarm_mode": 0}
    more = SlaveDescription(ident=1, configs=(b"\x10",), dpv1=True, alarms=("update",), alarm_sequence=9)
    assert more.table(8)["dpv1"] == {"alarms": ["update"], "alarm_mode": 3}
    octets = bytearray(3)
    Dpv1(alarms=("update",), alarm_mode=3).apply(octets)
    assert octets == b"\x80\x04\x03"


def test_from_a_gsd_file() -> None:
    slave = dpstack.slave.slave_from_gsd("examples/terminal.gsd", lambda outputs, elapsed: outputs, ["8 DO", "8 DI"])
    assert slave.description.alarms == ("process", "diagnostic")
    assert (slave.description.alarm_sequence, slave.description.extra_alarm_sap) == (0, False)
