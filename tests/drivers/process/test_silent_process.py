"""A bus process that is killed or stopped: what the application sees of it, and what becomes of its orders. An
application that hangs: its watchdog with the bus in a process of its own."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from api_kit import FAN
from ends.telegrams import heard, is_in_order
from far_ends import HANG_S, eventually, until
from process_kit import (
    DRIVERS,
    LAMPS,
    LAMPS_SPEC,
    SPEC,
    VALVES,
    Driver,
    bus_on,
    octet_slaves,
    process_of,
    ready_bus,
    runs,
    runtime_of,
    stop_for_good,
    stopped,
)
from support_responder import Responder

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.bus.events_json import event_json
from dpstack.api.config.config import make_config
from dpstack.api.control.handlers import control_run, run_status
from dpstack.api.slave_side.simulation import Segment, Simulation
from dpstack.dp.master.commands import DriveCommand, Mode
from dpstack.dp.master.events import ApplicationSilent, ForcedClear
from dpstack.drivers.process.channel import Channel
from dpstack.drivers.runtime import BusProcessBack, BusProcessSilent, OutputsDropped
from dpstack.errors import BusError, OrderDropped
from dpstack.profile import State
from dpstack.trace import Event, Severity
from dpstack.units import s_to_ns

#: a slave whose watchdog does not expire while the bus process is stopped
UNWATCHED: dict[str, object] = VALVES | {"watchdog_ms": 30_000}
OLD, NEW = b"\x11\x22", b"\x33\x44"


@contextlib.contextmanager
def outputs_seen(there: Responder) -> Iterator[set[bytes]]:
    """All outputs that slave 4 gets from now on."""
    seen: set[bytes] = set()
    request = there.request

    def watched(body: bytes) -> bytes:
        answer = request(body)
        seen.add(there.slaves[4].outputs)
        return answer

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(there, "request", watched)
        yield seen


def is_valid(slave: dpstack.Slave) -> bool:
    return slave.inputs_valid


def is_stale(bus: dpstack.Bus) -> bool:
    return bus.stats.stale


async def counted(bus: dpstack.Bus) -> None:
    """The counters come now and then: only those that were read before the bus process stops are there afterwards."""
    await until(lambda: bus.stats.rotation_us["p50"] > 0, "the counters have rotations")


def never_send(_channel: Channel, order: object, _answer: object) -> None:
    raise AssertionError(f"the bus process was asked: {order}")


async def test_the_slaves_of_a_killed_bus_process_are_offline_at_once() -> None:
    told: list[dict[str, object] | None] = []
    slaves = (UNWATCHED, LAMPS | {"watchdog_ms": 0})
    async with ready_bus(
        *slaves, specs=(SPEC, LAMPS_SPEC), on_event=lambda event: told.append(event_json(event, 0))
    ) as (bus, _there):
        await bus.operate()
        await bus.rotated(bus.stats.rotations + 3, 60)
        await counted(bus)
        valves = bus.slave("valves")
        assert is_valid(valves)
        assert not is_stale(bus)
        before = len(told)
        os.kill(process_of(bus), signal.SIGKILL)
        with pytest.raises(BusError, match="SIGKILL"):
            await bus.rotated(None)
        # told at once, before the notice that says why
        states = [line for line in told[before:] if line is not None]
        assert [(line.get("name"), line.get("state")) for line in states[:2]] == [
            ("valves", "offline"),
            ("lamps", "offline"),
        ]
        assert [line["event"] for line in states] == ["slave", "slave", "notice"]
        assert valves.state is dpstack.SlaveState.OFFLINE
        assert not is_valid(valves)
        assert not bus.slave("lamps").inputs_valid  # no watchdog, and younger than 1 s
        assert valves.inputs_age is not None
        assert valves.fault is not None
        assert "killed by SIGKILL" in valves.fault.text
        stats = bus.stats
        assert stats.stale
        assert stats.stations[4].answers > 0
        assert stats.rotation_us["p50"] > 0


async def test_a_stopped_bus_process_is_silent_and_nothing_old_goes_out_when_it_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[Event] = []
    async with ready_bus(UNWATCHED, on_event=told.append) as (bus, there):
        await bus.operate()
        valves = bus.slave("valves")
        valves.outputs = b"\x01\x02"
        await until(lambda: valves.inputs == b"\x01\x02", "its mirror")
        await bus.rotated(bus.stats.rotations + 3, 60)
        await counted(bus)
        before = len(told)
        with outputs_seen(there) as seen, stopped(process_of(bus)):
            valves.outputs = OLD
            await bus.until(lambda: any(isinstance(event, OutputsDropped) for event in told), 60)
            await until(lambda: valves.state is dpstack.SlaveState.OFFLINE, "the silence")
            assert not is_valid(valves)  # younger than its watchdog
            assert valves.outputs == b"\x01\x02"
            assert not bus.snapshot.in_ring
            assert not bus.snapshot.las
            assert bus.mode is dpstack.Mode.OFFLINE
            assert valves.fault is not None
            assert "no sign of life" in valves.fault.text
            status = run_status(bus)["slaves"]
            assert isinstance(status, dict)
            assert (status["4"]["state"], status["4"]["inputs_valid"]) == ("offline", False)
            with monkeypatch.context() as patch:
                patch.setattr(Channel, "_send", never_send)
                stats = bus.stats
            assert stats.stale
            assert stats.age > 0.9
            assert stats.rotations > 0
            assert stats.rotation_us["p50"] > 0
            assert stats.stations[4].answers > 0
            valves.outputs = NEW
            with pytest.raises(OrderDropped, match=r"the outputs of slave 4 \(valves\) will not go out"):
                await bus.outputs_taken()
            with pytest.raises(OrderDropped, match="has shown no sign of life"):
                await bus.clear()
        await valves.ready(60)
        await bus.until(lambda: any(isinstance(event, BusProcessBack) for event in told), 60)
        assert valves.outputs == b"\x01\x02"
        await bus.rotated(bus.stats.rotations + 3, 60)
        assert is_valid(valves)
        await until(lambda: not is_stale(bus), "a sign of life")
        assert not {OLD, NEW} & seen
        await bus.operate()
        valves.outputs = NEW
        await bus.outputs_taken()
        await until(lambda: valves.inputs == NEW, "its mirror")
    events = told[before:]
    silent = next(event for event in events if isinstance(event, BusProcessSilent))
    back = next(event for event in events if isinstance(event, BusProcessBack))
    dropped = [event for event in events if isinstance(event, OutputsDropped)]
    assert [event.outputs for event in dropped] == [OLD, NEW]
    assert back.silent_ns >= silent.silent_ns > 0
    assert "valves" not in silent.text
    assert "The slaves' watchdogs make their outputs safe within 30000 ms" in silent.text
    states = [line for event in events if (line := event_json(event, 0)) and line["event"] in ("slave", "bus_process")]
    assert [line.get("state", line.get("silent")) for line in states[:2]] == [True, "offline"]
    assert [line.get("state", line.get("silent")) for line in states if line.get("silent") is False] == [False]
    told_of_drop = event_json(dropped[0], 1.5)
    assert told_of_drop is not None
    assert {key: told_of_drop[key] for key in ("event", "t", "address", "name", "outputs")} == {
        "event": "outputs_dropped", "t": 1.5, "address": 4, "name": "valves", "outputs": "1122"
    }  # fmt: skip
    assert silent.severity is dropped[0].severity is Severity.ERROR


async def test_an_order_that_is_not_taken_in_time_is_never_carried_out() -> None:
    """Given before anybody could know that the bus process is stopped."""
    async with ready_bus(UNWATCHED) as (bus, there):
        refused = pytest.raises(OrderDropped, match="did not take the order within 1000 ms")
        with outputs_seen(there) as seen, stopped(process_of(bus)), refused:
            await bus.operate()
        await bus.until(lambda: runtime_of(bus).not_running is None, 60)
        await bus.ready(60)
        await bus.rotated(bus.stats.rotations + 3, 60)
        assert bus.mode is dpstack.Mode.CLEAR
        assert seen <= {bytes(2)}


async def test_ctl_outputs_succeeds_only_after_the_bus_process_has_taken_them() -> None:
    with octet_slaves(SPEC) as (path, there):
        async with bus_on(path, "process", UNWATCHED) as bus:
            await bus.ready(60)
            await bus.operate()
            handlers = control_run(bus, path)._handlers
            await handlers["outputs"](["4=1122"])  # type: ignore[misc]
            assert bus.slave("valves").outputs == OLD
            await until(lambda: there.slaves[4].outputs == OLD, "the outputs")
            with outputs_seen(there) as seen, stopped(process_of(bus)):
                with pytest.raises(OrderDropped, match="will not go out"):
                    await handlers["outputs"](["4=3344"])  # type: ignore[misc]
                with pytest.raises(OrderDropped, match="will not go out"):
                    await handlers["set"](["4.target=5"])  # type: ignore[misc]
            await bus.ready(60)
            await bus.rotated(bus.stats.rotations + 3, 60)
            assert not {NEW, b"\x00\x05"} & seen
            assert bus.slave("valves").outputs == OLD


async def test_orders_that_the_socket_does_not_take_are_sent_when_the_bus_process_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Orders that end something have no time limit: half a frame in the socket is followed by its other half."""
    monkeypatch.setattr("dpstack.drivers.process.channel._AGAIN_NS", 10_000_000)
    async with ready_bus(UNWATCHED) as (bus, _there):
        with stopped(process_of(bus)):
            await until(lambda: runtime_of(bus).not_running is not None, "the silence")
            for number in range(8):
                with pytest.raises(BusError, match="it carries the order out if it goes on"):
                    await core_of(bus).order(DriveCommand(4, "cancel", {"long": "x" * 100_000}, number))
        await bus.ready(60)
        await bus.rotated(bus.stats.rotations + 3, 60)
        await bus.operate()


async def test_a_wait_for_rounds_ends_when_a_silent_bus_process_goes_on() -> None:
    async with ready_bus(UNWATCHED) as (bus, _there):
        with stopped(process_of(bus)):
            await until(lambda: runtime_of(bus).not_running is not None, "the silence")
            waiting = asyncio.ensure_future(bus.rotated(bus.stats.rotations + 3, 60))
            await asyncio.sleep(0)
        await waiting


async def test_the_drives_of_a_stopped_bus_process_do_not_look_alive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dpstack.drivers.process.channel._AGAIN_NS", 10_000_000)  # of the end
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        plant = make_config(segment.paths[1], 1_500_000, slaves=[FAN])
        async with Simulation(plant, segment.paths[1], 1_500_000), bus_on(segment.paths[0], "process", FAN) as bus:
            await bus.operate()
            await bus.ready(60)
            fan = bus.drive("fan")
            await fan.start(60)
            assert is_running(fan)
            statuses = fan.statuses()
            assert (await anext(statuses)).running
            os.kill(process_of(bus), signal.SIGSTOP)
            async for status in statuses:
                if status.state is State.OFFLINE:
                    break
            with monkeypatch.context() as patch:
                patch.setattr(Channel, "_send", never_send)
                assert not is_running(fan)
                assert (fan.status.state, fan.status.speed, fan.status.words) == (State.OFFLINE, None, ())


def is_running(drive: dpstack.Drive) -> bool:
    return drive.status.running


@pytest.mark.parametrize("end", ["close", "end_without_loop"])
async def test_the_end_of_a_bus_continues_a_stopped_bus_process(end: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody else could make outputs of slaves without a watchdog safe. It has lost its time in the ring, and knows."""
    # on a busy computer it takes longer than half a second to answer, and would be killed meanwhile
    monkeypatch.setattr("dpstack.drivers.process.channel._AGAIN_NS", s_to_ns(HANG_S))
    told: list[str] = []
    slaves = (VALVES | {"watchdog_ms": 0}, LAMPS | {"watchdog_ms": 0})
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there):
        bus = bus_on(path, "process", *slaves, on_event=lambda event: told.append(event.text))
        await bus.open()
        await bus.ready(60)
        await bus.operate()
        bus.slave("valves").outputs = OLD
        await until(lambda: there.slaves[4].outputs == OLD, "the outputs")
        with heard(there) as words:
            os.kill(process_of(bus), signal.SIGSTOP)
            await until(lambda: bus.slave("valves").state is dpstack.SlaveState.OFFLINE, "the silence")
            if end == "end_without_loop":
                assert core_of(bus).runtime.end_without_loop() == ""
            await bus.close()
            eventually(lambda: words[-1:] == ["clear"], "Clear")
            assert is_in_order([OLD.hex(), *words], live=OLD.hex(), safe="a55a")
        assert not runs(process_of(bus))
        assert not [text for text in told if "was killed" in text]
        assert end != "close" or not bus.end_failed


async def test_the_end_of_a_bus_with_a_stopped_process_reports_the_watchdogs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("dpstack.drivers.process.channel._AGAIN_NS", 10_000_000)
    told: list[str] = []
    slave = VALVES | {"watchdog_ms": 500}
    async with ready_bus(slave, on_event=lambda event: told.append(event.text)) as (bus, _there):
        await bus.operate()
        await bus.rotated(bus.stats.rotations + 3, 60)
        stop_for_good(monkeypatch, process_of(bus))
        await until(lambda: not bus.slave("valves").ready_now, "the silence")
    assert bus.end_failed
    assert "The slaves' watchdogs make their outputs safe within 500 ms" in told[-1]
    assert "it did not answer at the end of the bus and was killed" in told[-1]


OUT = b"\x11\x22"


async def test_the_application_hangs() -> None:
    """The outputs of the slave become zeros although nothing runs in the application."""
    async with ready_bus(VALVES, application_watchdog_ms=1000, after_stall="safe") as (bus, there):
        bus.slave("valves").outputs = OUT
        await operates(bus, there)
        eventually(lambda: there.slaves[4].outputs == bytes(2), "Clear while the application hangs")
        await until(lambda: bus.mode is Mode.CLEAR, "the application is told")
        assert isinstance(bus.forced_clear, ApplicationSilent)
        await operates(bus, there)


async def operates(bus: dpstack.Bus, there: Responder) -> None:
    """Operate until the slave has its outputs, ordered again if a busy computer was the application that hangs."""
    end = time.monotonic() + HANG_S
    while there.slaves[4].outputs != OUT:
        assert time.monotonic() < end, "its outputs did not come"
        if bus.mode is not Mode.OPERATE:
            await bus.operate()
        await asyncio.sleep(0.001)


@pytest.mark.parametrize("driver", DRIVERS)
async def test_an_application_that_is_alive(driver: Driver) -> None:
    """The bus process reads every sign of life, however many come, and answers orders between them."""
    told: list[object] = []
    async with ready_bus(
        VALVES, application_watchdog_ms=20_000, after_stall="resume", on_event=told.append, driver=driver
    ) as (bus, there):
        bus.slave("valves").outputs = OUT
        await bus.operate()
        await until(lambda: there.slaves[4].outputs == OUT, "its outputs")
        end = time.monotonic() + 0.3
        while time.monotonic() < end:
            for _ in range(100):
                bus.alive()
            await asyncio.sleep(0)
        assert bus.stats.slaves[4].exchanges
        assert not [event for event in told if isinstance(event, ForcedClear)]
        assert there.slaves[4].outputs == OUT
