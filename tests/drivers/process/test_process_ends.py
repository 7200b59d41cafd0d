"""Ends of the bus process and of its application: safe outputs, a free port, an error at the survivor."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import itertools
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from far_ends import eventually, until
from process_kit import (
    LAMPS,
    LAMPS_SPEC,
    SPEC,
    VALVES,
    bus_on,
    octet_slaves,
    process_of,
    ready_bus,
    runs,
    runtime_of,
    stop_for_good,
)
from support_responder import Responder

import dpstack
from dpstack.devices.finding import find
from dpstack.dp.master.events import MasterStopped
from dpstack.drivers.process.channel import Channel
from dpstack.drivers.process.messages import Answer, CloseBus
from dpstack.errors import BusError, ConfigError, PortError, UsageError
from dpstack.ports import open_port
from dpstack.trace import Event, Notice, Severity

#: a drive that is an object of this program
OWN = dataclasses.replace(find("fuji-frenic"), name="own", file="")
#: safe values reach the outputs, then Clear's zeros
AFTER = (b"\xa5\x5a", bytes(2))
APPLICATION = """
import asyncio, sys
sys.path.insert(0, {kits!r})
from process_kit import VALVES, bus_on, process_of
async def main():
    async with bus_on({path!r}, "process", VALVES) as bus:
        await bus.ready(60)
        await bus.operate()
        bus.slave("valves").outputs = b"\\x11\\x22"
        while bus.slave("valves").inputs != b"\\x11\\x22":
            await asyncio.sleep(0.005)
        print(process_of(bus), flush=True)
        {then}
asyncio.run(main())
"""


@contextlib.contextmanager
def recorded(there: Responder) -> Iterator[list[str]]:
    """Telegrams to slave 4 from now on: outputs in hex, "clear"; and "left out" before what came after more than 20
    tokens, or after 20 looks of 50 ms in which nobody said anything (a busy computer keeps who looks waiting, too).
    """
    heard: list[str] = []
    slave, take_control = there.slaves[4], there.request
    tokens, idle = there.tokens, there.idle

    def request(body: bytes) -> bytes:
        nonlocal tokens, idle
        before, slave.control = slave.exchanges, b""
        answer = take_control(body)
        told = [slave.outputs.hex()] if slave.exchanges != before else []
        if slave.control == b"\x02\x00":
            told.append("clear")
        if told:
            if there.tokens > tokens + 20 or there.idle >= idle + 20:
                heard.append("left out")
            tokens, idle = there.tokens, there.idle
            heard.extend(told)
        return answer

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(there, "request", request)
        yield heard


async def test_the_bus_process_is_killed() -> None:
    told: list[str] = []
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there):
        lamps = LAMPS | {"watchdog_ms": 0}
        bus = bus_on(path, "process", VALVES | {"watchdog_ms": 200}, lamps, on_event=lambda e: told.append(e.text))
        async with bus:
            await bus.ready(60)
            await bus.operate()
            bus.slave("lamps").outputs = b"\x11"
            await until(lambda: bus.slave("lamps").inputs == b"\x11", "its mirror")
            waiting = asyncio.gather(
                bus.rotated(None),
                bus.class2.diagnosis(99, timeout=60),
                bus.events().__anext__(),
                return_exceptions=True,
            )
            await asyncio.sleep(0)
            os.kill(process_of(bus), signal.SIGKILL)
            for error in await waiting:
                if isinstance(error, BusError):
                    assert str(error) == (
                        "the bus process was killed by SIGKILL: nothing is sent any more. The slaves' watchdogs make "
                        "their outputs safe within 200 ms; lamps without watchdog keeps the last outputs; "
                        "open the bus anew"
                    )
            assert [type(error) for error in await waiting][:2] == [BusError, BusError]
            with pytest.raises(BusError, match="killed by SIGKILL"):
                await bus.operate()
            with pytest.raises(BusError, match="killed by SIGKILL"):
                await bus.ready(60)
            assert not bus.snapshot.in_ring
            assert not bus.slave("lamps").ready_now
            assert bus.stats.slaves[5].exchanges > 0  # what is known stays
            async with bus_on(path, "asyncio", VALVES) as again:  # the port is free
                await again.ready()
        assert sum("SIGKILL" in text for text in told) == 1
        assert there.slaves[5].outputs == b"\x11"


async def test_sigterm_ends_the_bus_process_in_order() -> None:
    async with ready_bus(VALVES) as (bus, there):
        await bus.operate()
        bus.slave(4).outputs = b"\x11\x22"
        await until(lambda: bus.slave(4).inputs == b"\x11\x22", "its mirror")
        for of_a_terminal in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):  # the application's
            os.kill(process_of(bus), of_a_terminal)
        os.kill(process_of(bus), signal.SIGTERM)
        with pytest.raises(BusError, match=r"has ended: it was ordered to end \(SIGTERM\); outputs were set to their"):
            await bus.rotated(None, 20)
        await until(lambda: there.slaves[4].outputs in AFTER, "safe values")
        await until(lambda: there.slaves[4].control == b"\x02\x00", "Clear")


async def test_ctrl_c_while_the_bus_process_starts() -> None:
    """A terminal sends it to both, before the new interpreter could say what it does about it."""
    with octet_slaves(SPEC) as (path, _there):
        bus = bus_on(path, "process", VALVES)
        opening = asyncio.ensure_future(bus.open())
        await until(lambda: runtime_of(bus).pid is not None, "its start")
        os.kill(process_of(bus), signal.SIGINT)
        await opening
        await bus.ready(60)
        await bus.close()


async def test_an_event_handler_gets_the_reason_of_the_end_of_the_bus_process() -> None:
    failed: list[str] = []
    with octet_slaves(SPEC) as (path, _there):

        def on_event(event: Event) -> None:
            if isinstance(event, MasterStopped):
                eventually(lambda: not runs(process_of(bus)), "the end of the bus process")
                assert bus.stats.slaves[4].exchanges  # asks for counters
            elif isinstance(event, Notice) and event.source == "bus" and event.severity is Severity.ERROR:
                failed.append(event.text)

        bus = bus_on(path, "process", VALVES, on_event=on_event)
        async with bus:
            await bus.ready(60)
            os.kill(process_of(bus), signal.SIGTERM)
            with pytest.raises(BusError, match=r"has ended: it was ordered to end \(SIGTERM\)"):
                await bus.rotated(None, 20)
    assert len(failed) == 1
    assert "ordered to end (SIGTERM)" in failed[0]


async def test_a_bus_process_that_hangs_at_the_end_is_killed_and_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    slave = VALVES | {"watchdog_ms": 500}
    async with ready_bus(slave, on_event=lambda event: told.append(event.text)) as (bus, _there):
        monkeypatch.setattr("dpstack.drivers.process.channel.LIMIT_NS", 50_000_000)
        monkeypatch.setattr("dpstack.drivers.process.channel._AGAIN_NS", 10_000_000)
        stop_for_good(monkeypatch, process_of(bus))
    assert not runs(process_of(bus))
    assert told[-1] == (
        "bus process: it did not answer at the end of the bus and was killed: the end was not in order. The slaves' "
        "watchdogs make their outputs safe within 500 ms"
    )


async def test_a_bus_process_that_is_gone_before_its_last_answer_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    on_answer = Channel._on_answer

    def late(channel: Channel, answer: Answer) -> None:
        sent = channel._sent.get(answer.number)
        on_answer(channel, answer)
        if sent is not None and isinstance(sent.order, CloseBus) and channel._process is not None:
            channel._process.wait(60)

    monkeypatch.setattr(Channel, "_on_answer", late)
    events: list[Event] = []
    async with ready_bus(VALVES, on_event=events.append):
        pass
    assert not [event.text for event in events if isinstance(event, Notice) and event.severity is Severity.ERROR]


async def test_it_finds_modules_where_the_application_does(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Also in the working directory, which python -c and an interactive one have as an empty string."""
    monkeypatch.setattr(sys, "path", [*sys.path, ""])
    monkeypatch.chdir(tmp_path)
    (tmp_path / "made_here.py").write_text(
        "class P:\n    def core(self, *a, **k):\n        raise ValueError('found')\nD = P()\n"
    )
    from dpstack.profile import registry

    monkeypatch.setattr(registry, "places", lambda: {"own": "made_here:D"})
    with registry.also(OWN), pytest.raises(BusError, match="ValueError: found"):
        await bus_on("/dev/null", "process", {"name": "fan", "address": 4, "drive": "own"}).open()


@pytest.mark.parametrize("then", ["await asyncio.sleep(60)", "import time; time.sleep(60)"])
def test_the_application_is_killed(then: str) -> None:
    with octet_slaves(SPEC) as (path, there):
        text = APPLICATION.format(kits=str(Path(__file__).parents[2] / "kits"), path=path, then=then)
        with subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE) as application:
            assert application.stdout is not None
            child = int(application.stdout.readline())
            assert there.slaves[4].outputs == b"\x11\x22"
            with recorded(there) as heard:
                application.kill()
                eventually(lambda: not runs(child), "the end of the bus process")
                idle = there.idle
                eventually(lambda: there.idle > idle, "its last octets read")
            # all of it while it is asked again and again: its watchdog has no reason to expire
            values = [what for what, _ in itertools.groupby(heard)]
            safe = values.index("a55a")
            assert set(values[:safe]) <= {"1122"}
            assert values.index("clear") > safe
            assert heard.count("clear") == 2
            assert "1122" not in values[safe:]
            assert "left out" not in heard
        port = open_port(path, 1_500_000)
        asyncio.run(port.open())  # nobody holds it
        port.close()


async def test_a_port_that_cannot_be_opened_raises_as_with_the_asyncio_driver(tmp_path: Path) -> None:
    with pytest.raises(PortError, match="nowhere"):
        await bus_on(str(tmp_path / "nowhere"), "process", VALVES).open()
    with octet_slaves(SPEC) as (path, _there):
        async with bus_on(path, "process", VALVES):
            with pytest.raises(dpstack.PortBusyError, match=r"held by|in use|busy"):
                await bus_on(path, "process", VALVES).open()


async def test_the_end_of_a_bus_that_was_never_opened() -> None:
    bus = bus_on("/dev/nowhere", "process", VALVES)
    assert bus.stats.slaves[4].held == b"\xa5\x5a"
    await bus.close()
    with pytest.raises(UsageError):
        await bus.operate()


async def test_an_application_that_does_not_read_for_a_while() -> None:
    """Its loop is held up while slaves come and go: the bus goes on, and it learns the latest state."""
    async with ready_bus(VALVES, LAMPS, specs=(SPEC, LAMPS_SPEC)) as (bus, there):
        await bus.operate()
        exchanges = there.slaves[4].exchanges
        gone = there.slaves.pop(5)
        eventually(lambda: there.slaves[4].exchanges > exchanges + 50, "the bus goes on")
        there.slaves[5] = gone
        gone.prm_ok = gone.cfg_ok = False
        await bus.until(lambda: not bus.slave("lamps").ready_now, 20)
        await bus.slave("lamps").ready(20)
        assert bus.slave("valves").ready_now


async def test_a_plugin_that_cannot_be_imported_there(monkeypatch: pytest.MonkeyPatch) -> None:
    from dpstack.profile import registry

    fan = {"name": "fan", "address": 4, "drive": "own"}
    with registry.also(OWN):
        monkeypatch.setattr(registry, "places", lambda: {"own": "elsewhere.module:DRIVE"})
        with pytest.raises(ConfigError, match=r"plugin elsewhere.module:DRIVE cannot be imported in the bus process"):
            await bus_on("/dev/null", "process", fan).open()
        monkeypatch.setattr(registry, "places", dict)
        with pytest.raises(ConfigError, match=r"slave 4 \(fan\): its drive plugin 'own' is an object of this program"):
            bus_on("/dev/null", "process", fan)


def test_it_runs_in_a_thread_of_the_application() -> None:
    """The bus process ends with the thread that started it only when its loop is over, too."""

    async def program() -> None:
        async with ready_bus(VALVES):
            pass

    failed: list[BaseException] = []

    def run() -> None:
        try:
            asyncio.run(program())
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert not failed
