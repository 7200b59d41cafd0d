"""``bus.class2.connect``: connections beside the slave's own master, their ends, and that the slave gets them back."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator
from typing import Any

import pytest
from api_kit import RAW, begun, bus_of
from ms2_kit import Ms2Server, ms2_in, served
from msgspec import structs
from support import instance, present

import dpstack
from dpstack import AcyclicError, Connection, ConnectionEnded, Im0, ServiceRefused, SlaveFault, SlaveTimeout, UsageError
from dpstack.api.bus.events_json import event_json
from dpstack.api.config.config import make_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.dp.acyclic.queue import Acyclic
from dpstack.dpv1.master.alarm_orders import ConnectionOver
from dpstack.dpv1.timeouts import least_send_timeout
from dpstack.errors import BusError
from dpstack.gsd.dpv1_keywords import DpV1
from dpstack.gsd.model import Device
from dpstack.profile.record47 import Address, Values
from dpstack.sim.world import World
from dpstack.trace import Severity

pytestmark = pytest.mark.virtual_time


@contextlib.asynccontextmanager
async def owner(**more: Any) -> AsyncIterator[tuple[dpstack.Bus, Ms2Server]]:
    """The bus of master 2 in data exchange with slave 9."""
    world = World()
    server = ms2_in(world)
    async with bus_of(RAW, world=world, **more) as bus:
        await bus.ready()
        yield bus, server


@contextlib.asynccontextmanager
async def beside(events: list[dpstack.Event] | None = None) -> AsyncIterator[tuple[dpstack.Bus, Ms2Server]]:
    """The bus of station 5, which is nobody's class 1 master, while master 2 exchanges data with slave 9."""
    async with owner(gap=1) as (own, server):
        world = present(own.world)
        await own.operate()
        own.slave(9).outputs = b"\x55"
        config = make_config("virtual", 500_000, 5)
        async with dpstack.open_bus(config, world=world, on_event=None if events is None else events.append) as bus:
            yield bus, server
        await asyncio.sleep(0.05)
        slave = own.slave(9)
        assert (slave.ready_now, slave.retries, slave.timeouts, slave.inputs) == (True, 0, 0, b"\x55")
        assert not server.sessions
        assert sorted(server.free) == [47, 48]
    present(world.referee).check()


async def test_a_connection_without_a_reference_is_closed() -> None:
    """A program may fail before it can close a connection, and the slave has two only."""

    async def read_first(bus: dpstack.Bus) -> None:
        connection = await bus.class2.connect(9)
        assert await connection.read(1, 2) == b"\1\2"

    events: list[dpstack.Event] = []
    async with beside(events) as (bus, _):
        for _ in range(3):  # the slave has two
            await read_first(bus)
            await asyncio.sleep(0.1)
        assert bus.class2.connections == 0
        parameters = (await bus.class2.connect(9)).parameters()  # it stays open while this does
        await asyncio.sleep(0.2)
        assert bus.class2.connections == 1
        del parameters
        await asyncio.sleep(0.1)
        assert bus.class2.connections == 0

    overs = [event.text for event in events if isinstance(event, ConnectionOver)]
    assert len(overs) == 4
    assert all(text.endswith("it was closed here") for text in overs)


async def test_everything_over_one_connection_beside_the_slaves_own_master() -> None:
    events: list[dpstack.Event] = []
    async with beside(events) as (bus, _):
        async with bus.class2.connect(9) as connection:
            assert isinstance(connection, Connection)
            assert (connection.address, connection.server_sap, connection.is_open) == (9, 48, True)
            assert (connection.max_data_len, connection.profile_ident, connection.reason) == (240, 0, None)
            assert connection.send_timeout == 2.0
            assert await connection.read(1, 2) == b"\1\2"
            await connection.write(1, 2, bytes(240))
            assert await connection.transport(3, 4, b"\5\6") == b"\5\6"
            assert await asyncio.gather(*(connection.read(1, n) for n in range(9))) == [bytes((1, n)) for n in range(9)]
            assert await connection.ident() == 0x1234
            await asyncio.sleep(2.5)  # Idle keeps it
            assert await connection.read(1, 2) == b"\1\2"
            assert bus.class2.connections == 1
        assert (connection.is_open, connection.reason, bus.class2.connections) == (False, "it was closed here", 0)
        with pytest.raises(ConnectionEnded, match="is over: it was closed here; open a new one") as caught:
            await connection.read(1, 2)
        assert (caught.value.address, caught.value.abort) == (9, (0, 2, 0))
        await connection.close()
        await connection.ended()

    (over,) = [event for event in events if isinstance(event, ConnectionOver)]
    assert over.severity is Severity.INFO
    assert structs.replace(over, ordered=False).severity is Severity.WARNING
    assert event_json(over, 1.0) == {
        "event": "connection_over",
        "t": 1.0,
        "address": 9,
        "text": "slave 9: class 2 connection (server SAP 48) is over: it was closed here",
    }


async def test_several_connections_to_a_slave_of_this_bus() -> None:
    async with owner() as (bus, server):
        first = await bus.class2.connect("raw")
        second = await bus.class2.connect(bus.slave(9))
        assert (first.name, first.server_sap, second.server_sap) == ("raw", 48, 47)
        with pytest.raises(ServiceRefused, match="2 of them from here") as caught:
            await bus.class2.connect(9)
        assert (caught.value.service, caught.value.status) == ("Initiate", "RS")
        await first.close()
        assert await second.read(3, 4) == b"\3\4"
        third = await bus.class2.connect(9)
        assert third.server_sap == 48
        assert bus.slave(9).ready_now
    # the bus was closed with both of them open
    assert not server.sessions
    assert (second.reason, third.is_open) == ("the bus was closed here", False)


async def test_im() -> None:
    calls: list[bytes] = []

    def serve(pdu: bytes) -> bytes | None:
        if pdu[:1] == b"\x5f" and pdu[2] == 255:
            calls.append(pdu[4:])
            return pdu[:4]
        if pdu[:1] == b"\x5e" and pdu[2] == 255:
            body = (bytes(10) + b"\x00\x2a" + b"V-8".ljust(20) + b"1234".ljust(16)).ljust(64, b"\0")
            return b"\x5e\x00\xff\x44" + calls[-1] + body
        return served(pdu)

    async with beside() as (bus, server):
        server.serve = serve
        async with bus.class2.connect(9) as connection:
            found = instance(await connection.im(), Im0)
            assert (found.manufacturer_id, found.order_id, found.serial_number) == (42, "V-8", "1234")
        assert calls == [b"\x08\x00\xfd\xe8"]


async def test_typed_errors() -> None:
    async with beside() as (bus, server):
        server.serve = lambda pdu: bytes((pdu[0] | 0x80, 0x80, 0xB5, 3))
        async with bus.class2.connect(9, response_timeout=0.3) as connection:
            for call in (connection.read(1, 2), connection.write(1, 2, b""), connection.transport(1, 2)):
                with pytest.raises(AcyclicError, match="state conflict") as caught:
                    await call
                assert (caught.value.code_1, caught.value.code_2, caught.value.slot) == (0xB5, 3, 1)
            assert caught.value.service == "Data_Transport"
            with pytest.raises(UsageError, match="slot 255"):
                await connection.read(255, 0)
            with pytest.raises(UsageError, match="241 octets of data, 240 are possible"):
                await connection.write(0, 0, bytes(241))
            server.serve = lambda pdu: None
            with pytest.raises(SlaveTimeout, match=r"no answer to Read of slot 1, index 2 within 0\.3 s"):
                await connection.read(1, 2)
            await connection.ended()
            assert connection.reason == "Read of slot 1, index 2 had no answer in time"
        server.serve = lambda pdu: b"\x58\x00\x25"
        async with bus.class2.connect(9) as connection:
            reads = [connection.read(1, 2), connection.read(1, 3)]
            for end in await asyncio.gather(*reads, return_exceptions=True):
                assert isinstance(end, ConnectionEnded)
                assert end.abort == (0, 2, 5)
                assert "the slave aborted it: its user, reason 5" in str(end)
        server.serve = lambda pdu: b"\x5e\x01"
        async with bus.class2.connect(9) as connection:
            with pytest.raises(SlaveFault, match="unreadable octets"):
                await connection.read(1, 2)
        server.initiate = b"\xd7\x80\xc3\x00"
        with pytest.raises(ServiceRefused, match="refuses Initiate: resource unavailable") as refused:
            await bus.class2.connect(9)
        assert refused.value.status == "80 C3 00"
        server.initiate = b"\x58\x00\x17"
        with pytest.raises(ConnectionEnded, match="ABT_IA"):
            await bus.class2.connect(9)
        with pytest.raises(SlaveTimeout, match="slave 77 does not answer Initiate"):
            await bus.class2.connect(77)
        with pytest.raises(UsageError, match=r"address 127: a slave has 0\.\.126"):
            await bus.class2.connect(127)
        assert bus.class2.connections == 0


async def test_a_connection_is_opened_once() -> None:
    async with beside() as (bus, server):
        connecting = bus.class2.connect(9)
        async with connecting as connection:
            with pytest.raises(UsageError, match=r"was opened before: call connect\(\) again"):
                await connecting
            assert (await connection.read(1, 2), len(server.sessions)) == (b"\1\2", 1)


async def test_impossible_timeouts() -> None:
    async with beside() as (bus, server):
        connect = bus.class2.connect
        for wrong in (-1, math.nan, math.inf):
            with pytest.raises(UsageError, match=f"send_timeout = {wrong} is no time for a service"):
                connect(9, send_timeout=wrong)
            with pytest.raises(UsageError, match=f"response_timeout = {wrong} is"):
                connect(9, response_timeout=wrong)
            with pytest.raises(UsageError, match=f"timeout = {wrong} is"):
                connect(9, timeout=wrong)
        for wrong, text in ((0, "a send time-out of 0 s or less"), (655.36, r"655.36 s is not possible: 0..655.35 s")):
            with pytest.raises(UsageError, match=text):
                await bus.class2.connect(9, send_timeout=wrong)
        async with bus.class2.connect(9, send_timeout=655.35) as connection:
            with pytest.raises(UsageError, match="timeout = nan"):
                await connection.read(1, 2, timeout=math.nan)
            assert connection.send_timeout == 655.35
        with pytest.raises(UsageError, match="timeout = -1 "):
            await bus.class2.config(9, timeout=-1)
        assert [sap for sap, pdu in server.heard if pdu[:1] == b"\x57"] == [49]


async def test_after_a_defect_every_call_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulated bus stands still then: an order raises what happened, and the end comes at once."""

    def defect(*_: object) -> None:
        raise ZeroDivisionError("a defect")

    async with owner() as (bus, _):
        connection = await bus.class2.connect(9)
        monkeypatch.setattr(Acyclic, "token_received", defect)
        for what in (connection.read(1, 2), connection.read(1, 2), _connected(bus, 9)):
            with pytest.raises(BusError, match=r"stopped by a defect in dpstack \(ZeroDivisionError: a defect"):
                await what
        await connection.close()


@pytest.mark.parametrize("after_ms", range(12))
async def test_a_cancelled_connect_leaves_no_connection(after_ms: int) -> None:
    """The caller is cancelled while the connection opens, or just when it is open."""

    async with beside() as (bus, server):
        server.polls = 2
        opened: list[Connection] = []
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(after_ms / 1000):
                opened.append(await bus.class2.connect(9))
        await asyncio.sleep(0.1)
        assert len(server.sessions) == bus.class2.connections == len(opened)


async def test_a_cancelled_service_leaves_the_connection_open() -> None:
    async with beside() as (bus, server):
        server.polls = 30
        async with bus.class2.connect(9) as connection:
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.01):
                    await connection.read(5, 5)
            with pytest.raises(SlaveTimeout, match=r"was not over after 0\.01 s"):
                await connection.read(6, 6, timeout=0.01)
            assert await connection.read(1, 2) == b"\1\2"
            assert connection.is_open


async def test_the_bus_ends_meanwhile() -> None:
    async with owner() as (bus, server):
        connection = await bus.class2.connect(9)
        server.serve = lambda pdu: None
        waiting = [asyncio.create_task(connection.read(1, n)) for n in range(3)]
        opening = await begun(_connected(bus, 77), 0.01)
    for end in await asyncio.gather(*waiting, opening, return_exceptions=True):
        assert isinstance(end, (ConnectionEnded, SlaveTimeout)), end
    assert not server.sessions
    await connection.close()
    with pytest.raises(ConnectionEnded, match="the bus was closed here"):
        await connection.read(1, 2)
    with pytest.raises(UsageError, match="the bus is not open"):
        await bus.class2.connect(9)


async def _connected(bus: dpstack.Bus, address: int) -> Connection:
    return await bus.class2.connect(address)


async def test_the_limits_of_the_gsd_file() -> None:
    dpv1 = DpV1(
        slave=True,
        c2_read_write=True,
        c2_max_data_len=32,
        c2_response_timeout=20,
        c2_max_count_channels=1,
        max_initiate_pdu_length=24,
    )
    async with owner() as (bus, server):
        slave = bus.slave(9)
        slave.config = _with(slave.config, Device(dpv1=dpv1))
        async with bus.class2.connect(9) as connection:
            assert connection.max_data_len == 32
            await connection.read(1, 2)
            assert (48, b"\x5e\x01\x02\x20") in server.heard
            with pytest.raises(UsageError, match="33 octets, it takes 32 in one service"):
                await connection.transport(1, 2, bytes(33))
            server.free.clear()
            with pytest.raises(ServiceRefused, match="C2_Max_Count_Channels = 1, 1 of them from here"):
                await bus.class2.connect(9)
            server.free.append(47)
            server.serve = lambda pdu: None
            with pytest.raises(SlaveTimeout, match=r"within 0.2 s \(its C2_Response_Timeout\)"):
                await connection.read(1, 2)
        with pytest.raises(UsageError, match="Max_Initiate_PDU_Length = 24: leave network addresses out"):
            await bus.class2.connect(9, destination=bytes(9))
        slave.config = _with(slave.config, Device(dpv1=DpV1(slave=True)))
        with pytest.raises(UsageError, match="C2_Read_Write_supp = 0: it has no class 2 connections"):
            await bus.class2.connect(9)


def _with(config: SlaveConfig, device: Device) -> SlaveConfig:
    return structs.replace(config, device=device)


def test_send_timeouts_by_rate() -> None:
    rates = (12_000_000, 1_500_000, 500_000, 187_500, 9_600)
    assert [least_send_timeout(rate) // 1_000_000 for rate in rates] == [1_000, 1_000, 2_000, 4_000, 4_000]


async def test_a_read_only_bus_opens_none() -> None:
    world = World()
    ms2_in(world)
    config = make_config("virtual", 500_000, 5, bus={"read_only": True})
    async with dpstack.open_bus(config, world=world) as bus:
        with pytest.raises(UsageError, match="this bus is read-only: no connection is opened"):
            await bus.class2.connect(9)


async def test_the_parameter_channel_over_a_connection() -> None:
    """Record 47 of the simulated LS S100, while its own master uses it over MS1."""
    pump = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "ST1"}
    async with bus_of(pump) as bus:
        await bus.ready()
        async with bus.class2.connect("pump") as connection:
            parameters = connection.parameters()
            address, own = Address(965, 0, 0), await bus.slave("pump").parameters().read([Address(965, 0, 0)])
            assert await parameters.read([address]) == own
            assert isinstance(own[0], Values)
            assert (await connection.im()) == await bus.slave("pump").im()
            assert await connection.ident() == bus.slave("pump").setup.ident
        assert bus.class2.connections == 0
