"""serve_slave: a slave of one's own beside others, in a virtual world and on ptys."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from api_kit import bus_of, in_virtual_time, serving
from far_ends import open_slave, until
from octet_wire import framed
from support import WorldFactory, present

import dpstack
from dpstack.api.slave_side.slave_server import ServedSlave
from dpstack.dp.slave.device import Leave
from dpstack.dp.slave.events import AddressChanged, DeviceFailed, SlaveAppStateChanged
from dpstack.drivers.segment.hub import Segment
from dpstack.errors import BusError, ConfigError, SlaveTimeout
from dpstack.sim.world import World
from dpstack.slave import DpSlave, SlaveAppState, SlaveDescription
from dpstack.trace import Notice, Severity

DATA_EXCH, WAIT_PRM = SlaveAppState.DATA_EXCH, SlaveAppState.WAIT_PRM
RIG = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig")
SLOW = SlaveDescription(ident=1, configs=RIG.configs, rates={9600: 60, 19200: 60})


def mirror(outputs: bytes, elapsed: int) -> bytes:
    return outputs


class Outputs(list[bytes]):
    """A function of a slave that keeps all its outputs, and mirrors them."""

    def __call__(self, outputs: bytes, elapsed: int) -> bytes:
        self.append(outputs)
        return outputs


def commissioned(**more: Any) -> DpSlave:
    description = SlaveDescription(ident=0x1234, name="rig", configs=RIG.configs, set_slave_add=True)
    return DpSlave(description, mirror, **more)


@in_virtual_time
async def test_beside_a_master_in_one_world(world: WorldFactory) -> None:
    left: list[Leave] = []
    seen: list[dpstack.Event] = []
    slave = DpSlave(RIG, lambda outputs, elapsed: bytes([outputs[0] + 1]), safe=b"\x0f", on_leave=left.append)
    async with serving(slave, world(), seen) as (bus, served):
        bus.slave(9).outputs = b"\x41"
        await bus.rotated(bus.stats.rotations + 3)
        assert (served.outputs, served.inputs, bus.slave(9).inputs) == (b"\x41", b"\x42", b"\x42")
        assert (served.master, served.address, served.name) == (2, 9, "rig")
        slave.diag = dpstack.slave.UserDiag.of(dpstack.slave.device_block(b"\x05"))
        await bus.rotated(bus.stats.rotations + 5)
        read = present(bus.slave(9).diagnosis)
        assert read.ext == served.diagnosis().ext == b"\x02\x05"
    assert "rig): data_exchange" in " ".join(event.text for event in seen if isinstance(event, SlaveAppStateChanged))
    assert left


@in_virtual_time
async def test_a_slave_at_another_rate_than_its_world_says_so_at_its_end(w: World) -> None:
    """A slave that a master has spoken to says nothing."""
    seen: list[dpstack.Event] = []
    raw = {"name": "raw", "address": 8, "ident": 0x1234, "config": "10 20"}
    heard = dpstack.slave.serve_slave(DpSlave(RIG, mirror), address=8, baud=500_000, world=w, on_event=seen.append)
    deaf = dpstack.slave.serve_slave(DpSlave(RIG, mirror), address=9, baud=1_500_000, world=w, on_event=seen.append)
    async with heard, deaf, dpstack.open_bus(baud=500_000, slaves=[raw], world=w) as bus:
        await bus.ready()
    notices = [event for event in seen if isinstance(event, Notice)]
    assert [event.text for event in notices] == [
        "slave 9 (rig): no master has spoken to it: it was served at 1.5 Mbit/s, and the bus ran at 500 kbit/s; "
        "give baud=500000"
    ]
    assert notices[0].severity is Severity.WARNING


@in_virtual_time
async def test_a_function_that_raises_stops_its_slave_only(w: World) -> None:
    given: list[bytes] = []
    events: list[object] = []

    def breaks(outputs: bytes, elapsed: int) -> bytes:
        given.append(outputs)
        if outputs == b"\x13":
            raise ZeroDivisionError("13")
        return outputs

    slaves = {8: DpSlave(RIG, mirror), 9: DpSlave(RIG, breaks)}
    async with (
        dpstack.slave.serve_slaves(slaves, world=w, on_event=events.append) as server,
        bus_of(RIG.table(8) | {"name": "good"}, RIG.table(9) | {"name": "bad"}, world=w) as bus,
    ):
        good, bad = server.slaves
        await bus.operate()
        await bad.reached(DATA_EXCH, timeout=2)
        bus.slave(9).outputs = b"\x13"
        await bad.reached(WAIT_PRM, timeout=2)
        assert given[-1] == b"\0"
        assert bad.failure == "ZeroDivisionError: 13"
        with pytest.raises(SlaveTimeout, match=r"slave 9 \(rig\) is still in .* its function failed"):
            await bad.reached(DATA_EXCH, timeout=0.5)
        read = present(bus.slave(9).diagnosis)
        assert read.stat_diag
        bus.slave(8).outputs = b"\x44"
        await bus.rotated(bus.stats.rotations + 3)
        assert good.outputs == b"\x44"
        bus.slave(9).outputs = b"\x01"
        bad.restart()
        await bad.reached(DATA_EXCH, timeout=20)
    assert [event.name for event in events if isinstance(event, DeviceFailed)] == ["rig"]


@in_virtual_time
async def test_a_function_cannot_restart_its_own_slave(world: WorldFactory) -> None:
    slaves: list[ServedSlave] = []

    def restarts(outputs: bytes, elapsed: int) -> bytes:
        if outputs == b"\x13":
            slaves[0].restart()
        return outputs

    async with serving(DpSlave(RIG, restarts), world()) as (bus, served):
        slaves.append(served)
        bus.slave(9).outputs = b"\x13"
        await served.reached(WAIT_PRM, timeout=2)
        assert "cannot be restarted or reset within its own function" in str(served.failure)
        bus.slave(9).outputs = b"\x01"
        served.restart()
        await served.reached(DATA_EXCH, timeout=20)


@pytest.mark.parametrize("how", ["exit", "exception", "cancelled"])
@in_virtual_time
async def test_outputs_are_safe_however_serving_ends(w: World, how: str) -> None:
    given = Outputs()

    async def serve() -> None:
        async with dpstack.slave.serve_slave(DpSlave(RIG, given, safe=b"\x0f"), world=w, address=9) as server:
            await server.slave.reached(DATA_EXCH, timeout=2)
            await asyncio.sleep(0.5)
            if how == "exception":
                raise ZeroDivisionError
            if how == "cancelled":
                await server.serve_forever()
        with pytest.raises(BusError, match="served no more"):
            await server.slave.reached(DATA_EXCH, timeout=1)

    async with bus_of(RIG.table(9), world=w) as bus:
        await bus.operate()
        bus.slave(9).outputs = b"\x77"
        task = asyncio.ensure_future(serve())
        if how == "cancelled":
            await asyncio.sleep(1)
            task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert given[-1] == b"\x0f"
        assert b"\x77" in given


@in_virtual_time
async def test_a_handler_that_raises_loses_no_event_and_does_not_stop_the_slave(world: WorldFactory) -> None:
    seen: list[str] = []
    told: list[str] = []

    def on_event(event: dpstack.Event) -> None:
        seen.append(event.text)
        raise ZeroDivisionError

    w = world()
    asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context["message"]))
    async with (
        dpstack.slave.serve_slave(DpSlave(RIG, mirror), world=w, address=9, on_event=on_event) as server,
        bus_of(RIG.table(9), world=w) as bus,
    ):
        await bus.operate()
        await server.slave.reached(DATA_EXCH, timeout=2)
        server.slave.restart()
        await bus.until(lambda: bus.slave(9).state is dpstack.SlaveState.DATA_EXCHANGE, 2)
        assert server.slave.state is DATA_EXCH
    assert told == [f"on_event raised at {text!r}" for text in seen]
    assert len(told) > 4


@in_virtual_time
async def test_an_address_by_set_slave_add_is_kept_by_the_application(world: WorldFactory) -> None:
    kept: list[tuple[int, bool, bytes]] = []
    events: list[object] = []
    w = world()
    slave = commissioned(on_address=lambda address, fixed, rest: kept.append((address, fixed, rest)))
    async with dpstack.slave.serve_slave(slave, world=w, on_event=events.append) as server:
        assert server.slave.address == 126
        w.inject(bytes.fromhex(framed(0xFE, 0x82, 0x6D, "37 3E 09 12 34 01 AA")), baud=500_000)
        await asyncio.sleep(0.01)
        assert (server.slave.address, server.slave.address_fixed) == (9, True)
        async with bus_of(RIG.table(9), world=w) as bus:
            await bus.operate()
            await server.slave.reached(DATA_EXCH, timeout=2)
        server.slave.restart()
        assert server.slave.address == 9
        server.slave.initial_reset()
        assert (server.slave.address, server.slave.address_fixed) == (126, False)
    assert kept == [(9, True, b"\xaa"), (126, False, b"")]
    assert [event.before for event in events if isinstance(event, AddressChanged)] == [126, 9]


@pytest.mark.parametrize("wait", ["serve_forever", "reached"])
@in_virtual_time
async def test_a_defect_of_ours_ends_serving_with_safe_outputs(
    world: WorldFactory, monkeypatch: pytest.MonkeyPatch, wait: str
) -> None:
    def broken(self: object, request: object, now: int) -> None:
        raise ZeroDivisionError("ours")

    w = world(referee=False)
    given = Outputs()

    async with dpstack.slave.serve_slave(DpSlave(RIG, given, safe=b"\x0f"), world=w, address=8) as server:
        for unit in ("3D 3E 80 01 01 0B 12 34 00", "3E 3E 10 20"):
            w.inject(bytes.fromhex(framed(0x88, 0x82, 0x6D, unit)), baud=500_000)
            await asyncio.sleep(0.01)
        assert server.slave.state is DATA_EXCH
        monkeypatch.setattr("dpstack.dp.slave.application.SlaveApp.serve", broken)
        w.inject(bytes.fromhex(framed(0x88, 0x82, 0x6D, "3C 3E")), baud=500_000)
        with pytest.raises(BusError, match=r"stopped by a defect in dpstack \(ZeroDivisionError: ours\)"):
            await (server.serve_forever() if wait == "serve_forever" else server.slave.reached(WAIT_PRM, 5))
        assert given == [b"\x0f"]
        assert server.failure is not None


@in_virtual_time
async def test_nobody_speaks_to_it(w: World) -> None:
    async with dpstack.slave.serve_slave(DpSlave(RIG, mirror), world=w, address=9) as server:
        with pytest.raises(SlaveTimeout, match="no master has spoken to it; check address, baud rate and cable"):
            await server.slave.reached(DATA_EXCH, timeout=1)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: dpstack.slave.serve_slave(DpSlave(RIG, mirror), port="/dev/x", baud=500_000), "no address"),
        (lambda: dpstack.slave.serve_slave(DpSlave(RIG, mirror), baud=500_000, address=3), "no port"),
        (lambda: dpstack.slave.serve_slave(DpSlave(RIG, mirror), port="/dev/x", address=3), "no baud"),
        (lambda: dpstack.slave.serve_slave(DpSlave(RIG, mirror), port="/dev/x", baud=1, address=3), "1"),
        (lambda: dpstack.slave.serve_slave(DpSlave(RIG, mirror), world=World(), address=127), "must be 0..126"),
        (lambda: dpstack.slave.serve_slaves({}, world=World()), "no slave to serve"),
        (
            lambda: dpstack.slave.serve_slave(DpSlave(SLOW, mirror), world=World(), address=3),
            "it has no 500 kbit/s; it knows",
        ),
    ],
)
def test_impossible_arguments(make: Callable[[], object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        make()


# --- on ptys: what happens, never when ----------------------------------------------------------------------------


async def test_on_a_port_octet_by_octet(tmp_path: Path) -> None:
    given = Outputs()

    async with Segment(2, tmp_path / "bus", baud=500_000) as segment:
        async with dpstack.slave.serve_slave(
            DpSlave(RIG, given), port=segment.paths[1], baud=500_000, address=8
        ) as server:
            far = open_slave(segment.paths[0])
            try:
                for request, answer in [
                    (framed(0x88, 0x82, 0x6D, "3D 3E 80 01 01 0B 12 34 00"), "e5"),
                    (framed(0x88, 0x82, 0x5D, "3E 3E 10 20"), "e5"),
                    ("68 04 04 68 08 02 7D 55 DC 16", "68 04 04 68 02 08 08 55 67 16"),
                ]:
                    far.send(bytes.fromhex(request))
                    octets = bytes.fromhex(answer)
                    assert await far.recv(len(octets)) == octets
                await until(lambda: server.slave.state is DATA_EXCH, "data exchange")
                assert server.slave.outputs == b"\x55"
                server.slave.restart()
                assert server.slave.state is WAIT_PRM
            finally:
                far.hang_up()
            assert server.port_name
        assert given == [b"\x55", b"\0"]
