"""After a stall: what an application, a drive and the control socket see. The application watchdog in virtual time."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from api_kit import HOIST, RAW, begun, bench_of, bus_of, operating, stack_of

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.bus.events_json import event_json
from dpstack.api.config.config import parse_config
from dpstack.api.control.handlers import run_status
from dpstack.dp.master.events import ApplicationSilent, AutoCleared, ModeChanged, Stalled
from dpstack.errors import ConfigError, DriveError, UsageError
from dpstack.machine import HeldUp
from dpstack.trace import Event, Severity
from dpstack.units import NS_PER_MS

pytestmark = pytest.mark.virtual_time

CONFIG = """
[bus]
port = "virtual"
baud = 500000
{keys}
[[slave]]
name = "raw"
address = 9
ident = 0x1234
config = "20 10"
"""


def suspend(bus: dpstack.Bus, ms: int) -> None:
    """The computer sleeps for ``ms``, as the driver tells it."""
    station = stack_of(bus).station
    gap = HeldUp(ms * NS_PER_MS, f"the computer was suspended for {ms} ms", suspended=True)
    station.held_up(gap, core_of(bus).runtime.now())


async def mirrored(slave: dpstack.Slave, octets: bytes) -> None:
    """Until the inputs of the slave, which are its outputs, are ``octets``."""
    for _ in range(500):
        if slave.inputs == octets:
            return
        await asyncio.sleep(0.01)
    raise AssertionError(f"its inputs are {slave.inputs.hex()}")


async def test_the_bus_stays_in_clear_until_operate() -> None:
    told: list[Event] = []
    async with bus_of(RAW, on_event=told.append) as bus:
        raw = bus.slave("raw")
        raw.outputs = b"\x5a"
        await bus.operate()
        await mirrored(raw, b"\x5a")
        suspend(bus, 5_000)
        await mirrored(raw, b"\x00")
        assert bus.mode is dpstack.Mode.CLEAR
        assert isinstance(bus.forced_clear, Stalled)
        status: Any = run_status(bus)["clear"]
        assert status["since"] == pytest.approx(bus.seconds, abs=1)
        assert status["because"].startswith("stall: slave 9 (raw) was not asked for 500")
        await asyncio.sleep(0.5)
        assert bus.mode is dpstack.Mode.CLEAR
        await bus.operate()
        await mirrored(raw, b"\x5a")
        assert "clear" not in run_status(bus)
    (stall,) = [event for event in told if isinstance(event, Stalled)]
    assert stall.severity is Severity.ERROR
    line = event_json(stall, 1.5)
    assert line is not None
    gap = line.pop("gap_ms")
    assert isinstance(gap, float)
    assert 5_000 <= gap < 5_050
    assert line == {"event": "stalled", "t": 1.5, "blocked": "suspended", "slaves": [9], "text": stall.text}


async def test_a_drive_that_ran_stays_off_until_it_is_started_again() -> None:
    async with bus_of(HOIST | {"simulated": {"412": 1}}) as bus:
        await bus.operate()
        hoist = bus.drive("hoist")
        await hoist.start()
        hoist.speed = 0.5
        waiting = await begun(hoist.reached(), 0.1)
        suspend(bus, 2_000)
        with pytest.raises(DriveError, match=r"hoist: ended: the bus went to Clear by itself \(stall: slave 3"):
            await waiting
        assert isinstance(bus.forced_clear, Stalled)
        with pytest.raises(DriveError, match=r"went to Clear by itself .* then operate\(\)"):
            await hoist.start(1)
        await bus.operate()
        await bus.slave("hoist").ready()
        await asyncio.sleep(2)
        status = hoist.status
        assert not status.running
        assert status.speed == pytest.approx(0, abs=0.01)
        await hoist.start()
        await hoist.reached()
        assert hoist.status.speed == pytest.approx(0.5, abs=0.01)


async def test_resume_is_what_it_says() -> None:
    async with bus_of(RAW, after_stall="resume") as bus:
        raw = bus.slave("raw")
        raw.outputs = b"\x5a"
        await bus.operate()
        await mirrored(raw, b"\x5a")
        suspend(bus, 5_000)
        await asyncio.sleep(1)
        assert (bus.mode, raw.inputs, bus.forced_clear) == (dpstack.Mode.OPERATE, b"\x5a", None)


async def test_auto_clear_is_told_the_same_way() -> None:
    async with operating(RAW, auto_clear=True) as bus:
        await bus.until(lambda: bus.mode is dpstack.Mode.OPERATE, 5)
        bench_of(bus).power(9, False)
        await bus.until(lambda: bus.forced_clear is not None, 5)
        assert isinstance(bus.forced_clear, AutoCleared)
        status: Any = run_status(bus)["clear"]
        assert "auto_clear: slave 9 (raw) had no data exchange for 1000 ms" in status["because"]
        await bus.operate()  # it waits for the slave, by order
        assert bus.forced_clear is None


# --- the application watchdog -----------------------------------------------------------------------------------------


async def test_a_program_that_hangs_is_noticed() -> None:
    told: list[Event] = []
    async with bus_of(RAW, application_watchdog_ms=100, on_event=told.append) as bus:
        raw = bus.slave("raw")
        raw.outputs = b"\x5a"
        await asyncio.sleep(0.3)  # not armed yet
        await bus.operate()
        for _ in range(8):
            bus.alive()
            await asyncio.sleep(0.08)
        assert raw.inputs == b"\x5a"
        await mirrored(raw, b"\x00")  # nobody says that it is alive
        assert isinstance(bus.forced_clear, ApplicationSilent)
        bus.alive()
        await asyncio.sleep(0.3)
        assert bus.mode is dpstack.Mode.CLEAR
        await bus.operate()
        bus.alive()
        await mirrored(raw, b"\x5a")
    assert [type(event) for event in told].count(ApplicationSilent) == 1
    (silent,) = [event for event in told if isinstance(event, ApplicationSilent)]
    modes = [event.mode for event in told if isinstance(event, ModeChanged)]
    assert modes[:3] == [dpstack.Mode.OPERATE, dpstack.Mode.CLEAR, dpstack.Mode.OPERATE]
    assert event_json(silent, 2.0) == {
        "event": "application_silent", "t": 2.0, "limit_ms": 100, "text": silent.text
    }  # fmt: skip
    assert silent.severity is Severity.ERROR


async def test_alive_without_a_watchdog_and_without_a_bus() -> None:
    bus = bus_of(RAW)
    with pytest.raises(UsageError, match="not open"):
        bus.alive()
    async with bus:
        await bus.operate()
        bus.alive()
        await asyncio.sleep(1)
        assert bus.mode is dpstack.Mode.OPERATE


# --- configuration ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ('after_stall = "sfae"', "config:5: [bus]: unknown after_stall 'sfae'"),
        ("after_stall = true", "config:5: [bus]: after_stall"),
        ("application_watchdog_ms = 5", "config:5: [bus]: application_watchdog_ms = 5 is too short"),
        ("application_watchdog_ms = -1", "config:5: [bus]: application_watchdog_ms"),
    ],
)
def test_wrong_values_of_after_stall_are_refused(keys: str, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(CONFIG.format(keys=keys))
    assert text in str(caught.value)


def test_the_defaults() -> None:
    bus = parse_config(CONFIG.format(keys="")).bus
    assert (bus.after_stall, bus.application_watchdog_ms) == ("safe", 0)
    bus = parse_config(CONFIG.format(keys='after_stall = "resume"\napplication_watchdog_ms = 250')).bus
    assert (bus.after_stall, bus.application_watchdog_ms) == ("resume", 250)
