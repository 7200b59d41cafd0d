"""MS2 of a slave that a user serves: async functions, I&M, what can be looked at, what ends it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any, cast

import pytest
from api_kit import operating
from gsd_kit import FILES, device
from octet_class2 import ABORT, INITIATE, RS, SC, Class2
from octet_wire import PARAMS, Wire
from slave_alarm_kit import OctetMaster, prm
from support import WorldFactory

import dpstack
from dpstack import AlarmError, AlarmType, Im0, RecordRefused, Specifier, StatusType
from dpstack.api.slave_side.slave_server import ServedSlave
from dpstack.api.streams import Waiters
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.errors import BusError, ConfigError, PduError, SlaveTimeout, UsageError
from dpstack.phy.patience import EXACT
from dpstack.slave import DpSlave, ModuleState, SlaveDescription

RIG = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", ms2=2)


class Rig:
    """Slave 8 with functions that wait until they are let go, and a master of class 2."""

    def __init__(self, *, im: bool = False) -> None:
        self.go = asyncio.Event()
        self.at_work = 0
        self.ended: list[str] = []
        self.served = ServedSlave(
            DpSlave(
                RIG,
                lambda outputs, elapsed: outputs,
                on_read=self.read,
                on_write=self.write,
                on_transport=self.transport,
                im=[Im0(order_id="RIG")] if im else (),
            ),
            8,
            False,
            PARAMS,
            EXACT,
            Waiters(),
        )
        self.wire = Wire(self.served.station)
        self.master = Class2(self.wire)

    async def read(self, slot: int, index: int) -> bytes:
        self.at_work += 1
        try:
            await self.go.wait()
        except asyncio.CancelledError:
            self.ended.append(f"{slot}/{index}")
            raise
        if index == 9:
            raise RecordRefused(0xB5, 3)
        return bytes((slot, index))

    async def write(self, slot: int, index: int, data: bytes) -> None:
        self.at_work += 1

    async def transport(self, slot: int, index: int, data: bytes) -> bytes:
        if index == 8:
            return cast(bytes, "text")
        return bytes(241) if index == 9 else data + b"\x99"

    async def turns(self) -> None:
        """Let every task go as far as it can."""
        for _ in range(5):
            await asyncio.sleep(0)


async def fetch(rig: Rig, sap: int, request: str, master: Class2 | None = None) -> str:
    who = master or rig.master
    assert who.ask(sap, request) == SC
    await rig.turns()
    return who.ask(sap)


async def test_functions_serve_both_classes() -> None:
    rig = Rig(im=True)
    sap, second = rig.master.connect(), Class2(rig.wire, 3)
    other = second.connect()
    assert rig.master.ask(sap, "5E 01 02 F0") == SC
    assert second.ask(other, "5E 03 04 F0") == SC
    await rig.turns()
    assert rig.at_work == 2  # side by side
    assert rig.master.ask(sap) == SC
    rig.go.set()
    await rig.turns()
    assert second.ask(other) == "5E 03 04 02 03 04"
    assert rig.master.ask(sap) == "5E 01 02 02 01 02"
    assert await fetch(rig, sap, "5F 01 02 01 55") == "5F 01 02 01"
    assert await fetch(rig, sap, "5E 01 09 F0") == "DE 80 B5 03"
    assert await fetch(rig, sap, "51 01 02 01 55") == "51 01 02 02 55 99"
    assert await fetch(rig, sap, "51 01 08 00") == "D1 80 A1 00"
    assert await fetch(rig, sap, "51 01 09 00") == "D1 80 A1 00"
    assert await fetch(rig, sap, "5F 00 FF 04 08 00 FD E8") == "5F 00 FF 04"
    assert (await fetch(rig, sap, "5E 00 FF F0"))[12:23] == "08 00 FD E8"
    assert [(one.master, one.sap, one.services) for one in rig.served.connections] == [(1, 48, 8), (3, 47, 1)]
    assert rig.served.connections_free == 0
    told = " ".join(event.text for event in rig.served.station.take_events())
    assert "on_transport returned str, what goes back is bytes" in told


@pytest.mark.parametrize("way", ["abort", "silence", "restart", "end"])
async def test_functions_are_cancelled_when_nobody_wants_the_answer(way: str) -> None:
    rig = Rig()
    sap = rig.master.connect()
    assert rig.master.ask(sap, "5E 01 02 F0") == SC
    await rig.turns()
    match way:
        case "abort":
            assert rig.master.ask(sap, ABORT) == SC
        case "silence":
            rig.wire.pass_time(3_000_000_000)
        case "restart":
            rig.served.restart()
        case "end":
            rig.served.switch_off(BusError("over"), rig.wire.now)
    await rig.turns()
    assert rig.ended == ["1/2"]
    assert rig.served.connections == ()
    assert rig.served.connections_free == 2


async def test_a_slave_of_its_description_or_of_its_own_number() -> None:
    def served(ms2: int | None) -> ServedSlave:
        return ServedSlave(DpSlave(RIG, lambda outputs, elapsed: outputs, ms2=ms2), 8, False, PARAMS, EXACT, Waiters())

    assert [served(count).connections_free for count in (None, 0, 5)] == [2, 0, 5]
    master = Class2(Wire(served(0).station))
    assert master.ask(49, INITIATE) == RS
    with pytest.raises(ConfigError, match="0 to 49"):
        served(50)
    with pytest.raises(ConfigError, match="0 to 49"):
        SlaveDescription.simple(1, inputs=1, outputs=1, ms2=50)


async def test_a_slave_refuses_services_that_it_does_not_have(world: WorldFactory) -> None:
    """The master reads why, as one who opens the connection and as one who has it."""
    refused: list[int] = []
    made = world()

    def judge(master: int, wanted: dpstack.slave.InitiateReq) -> None:
        if wanted.profile_ident != 7:
            refused.append(master)
            raise RecordRefused(0xB6)

    slave = DpSlave(RIG, lambda outputs, elapsed: outputs, on_initiate=judge)
    async with (
        dpstack.slave.serve_slave(slave, world=made, address=8) as server,
        dpstack.open_bus(world=made, baud=500_000, address=5, gap=1) as bus,
    ):
        with pytest.raises(dpstack.ServiceRefused, match=r"slave 8 refuses Initiate: .*access denied"):
            await bus.class2.connect(8)
        assert refused == [5]
        connection = await bus.class2.connect(8, profile_ident=7)
        (served,) = server.slave.connections
        server.slave.abort_connection(served.sap, 3)
        await connection.ended()
        assert connection.reason == "the slave aborted it: its user, reason 3"


def test_from_a_gsd_file() -> None:
    whole = device("whole")
    description = slave_description(whole)
    assert (description.ms2, description.ms2_max_len, description.ms2_max_initiate) == (2, 240, 52)
    slave = dpstack.slave.slave_from_gsd(FILES / "whole.gsd", lambda outputs, elapsed: outputs, ["8 DO", "8 DI"])
    assert slave.ms2 == 2


async def test_three_masters_at_once_beside_its_own(world: WorldFactory) -> None:
    """Both ends of ours: connections of two stations and of its class 1 master, MS1 beside them; the cycle goes on."""
    plant = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True, ms2=3)
    told: list[str] = []
    at_work = most = 0

    async def read(slot: int, index: int) -> bytes:
        nonlocal at_work, most
        at_work += 1
        most = max(most, at_work)
        await asyncio.sleep(0.05)
        at_work -= 1
        return bytes((slot, index))

    made = world()

    async def busy(bus: dpstack.Bus, slot: int) -> None:
        async with bus.class2.connect(9) as connection:
            for index in range(5):
                assert await connection.read(slot, index) == bytes((slot, index))

    async def records(bus: dpstack.Bus) -> None:
        for index in range(5):
            assert await bus.slave(9).read(7, index) == bytes((7, index))

    slave = DpSlave(plant, lambda outputs, elapsed: outputs, on_read=read)
    async with (
        dpstack.slave.serve_slave(
            slave, world=made, address=9, on_event=lambda event: told.append(event.text)
        ) as server,
        operating(plant.table(9), world=made, gap=1) as owner,
    ):
        owner.slave(9).outputs = b"\x55"
        async with (
            dpstack.open_bus(world=made, baud=500_000, address=5) as one,
            dpstack.open_bus(world=made, baud=500_000, address=6) as two,
        ):
            await asyncio.gather(busy(owner, 1), busy(one, 2), busy(two, 3), records(owner))
            with pytest.raises(dpstack.ServiceRefused):
                async with (
                    one.class2.connect(9),
                    one.class2.connect(9),
                    two.class2.connect(9),
                    owner.class2.connect(9),
                ):
                    raise AssertionError("there are three connections")
        assert most == 4  # side by side
        found = owner.slave(9)
        assert (found.ready_now, found.retries, found.timeouts, found.inputs) == (True, 0, 0, b"\x55")
        assert server.slave.connections == ()
        assert server.slave.connections_free == 3
        assert server.slave.stats.connections == server.slave.stats.closed == 6
    assert sum("its master aborted it: its user" in text for text in told) == 6


# --- ``await slave.alarm(...)``: over when the master, who knows octets only, has acknowledged it; every error typed


pytestmark = pytest.mark.virtual_time

ALARMING = SlaveDescription.simple(0x0A35, inputs=1, outputs=1, name="rig", dpv1=True, alarms=("process", "diagnostic"))


@contextlib.asynccontextmanager
async def rig(
    description: SlaveDescription = ALARMING, parameters: bytes | None = None
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
            master.start_with(prm(), ALARMING.configs[0], b"\x55")
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
    assert ALARMING.table(8)["dpv1"] == {"alarms": ["process", "diagnostic"], "alarm_mode": 0}
    more = SlaveDescription(ident=1, configs=(b"\x10",), dpv1=True, alarms=("update",), alarm_sequence=9)
    assert more.table(8)["dpv1"] == {"alarms": ["update"], "alarm_mode": 3}
    octets = bytearray(3)
    Dpv1(alarms=("update",), alarm_mode=3).apply(octets)
    assert octets == b"\x80\x04\x03"


def test_alarms_from_a_gsd_file() -> None:
    slave = dpstack.slave.slave_from_gsd("examples/terminal.gsd", lambda outputs, elapsed: outputs, ["8 DO", "8 DI"])
    assert slave.description.alarms == ("process", "diagnostic")
    assert (slave.description.alarm_sequence, slave.description.extra_alarm_sap) == (0, False)
