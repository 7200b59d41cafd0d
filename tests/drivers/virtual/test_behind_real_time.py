"""A simulated bus that cannot keep up with real time says so, while it happens and at the end."""

from __future__ import annotations

import asyncio
import time

import pytest
from api_kit import RAW, bus_of, virtual

import dpstack
from dpstack.api.bus.events_json import event_json
from dpstack.cli.terminal.report import Reporter
from dpstack.drivers.runtime import BehindRealTime
from dpstack.drivers.virtual import runtime as driver
from dpstack.drivers.virtual.runtime import Pace
from dpstack.trace import Event, Severity
from dpstack.units import NS_PER_S

Out = pytest.CaptureFixture[str]


def paced(speeds: list[float]) -> list[BehindRealTime]:
    """Events of a bus whose time goes at each of these speeds for one second."""
    pace, real, bus = Pace(7 * NS_PER_S, 0), 7 * NS_PER_S, 0
    told = []
    for speed in speeds:
        for _ in range(10):
            real += NS_PER_S // 10
            bus += round(speed * NS_PER_S / 10)
            event = pace.event_at(real, bus)
            if event is not None:
                told.append(event)
    return told


def test_falling_behind_is_reported_once_and_again_when_the_speed_changes_much() -> None:
    told = paced([1.0, 0.95, 0.4, 0.42, 0.25, 0.15, 0.21, 0.5, 0.92, 1.0, 1.0, 0.5])
    speeds = [(round(one.bus_ns / one.real_ns, 2), one.keeps_up) for one in told]
    assert speeds == [(0.4, False), (0.15, False), (0.5, False), (1.0, True), (0.5, False)]
    first = told[0]
    assert first.behind_ns == round(0.65 * NS_PER_S)
    assert first.text.startswith("the simulated bus falls behind real time: 0.40 s of bus time in the last 1.00 s; ")
    assert event_json(first, 2.0) == {
        "event": "behind",
        "t": 2.0,
        "speed": 0.4,
        "behind_ms": 650.0,
        "keeps_up": False,
        "text": first.text,
    }
    assert first.severity is Severity.WARNING
    assert told[3].severity is Severity.INFO


def test_a_bus_that_keeps_up_reports_nothing() -> None:
    assert paced([1.0, 0.96, 1.04, 0.91]) == []


@pytest.mark.parametrize("loop", ["an ordinary loop", "a virtual loop in real time"])
def test_a_run_on_a_slow_computer_says_so_at_once_and_at_the_end(
    loop: str, monkeypatch: pytest.MonkeyPatch, capsys: Out
) -> None:
    """The clock goes 5000 times as fast: no computer simulates that much."""
    start, now = time.monotonic_ns(), time.monotonic_ns

    def clock() -> int:
        return start + 5000 * (now() - start)

    monkeypatch.setattr(driver, "monotonic_ns", clock)
    told: list[Event] = []

    async def program() -> None:
        async with bus_of(RAW, on_event=told.append) as bus:
            await bus.rotated(10)
            await bus.until(lambda: any(isinstance(event, BehindRealTime) for event in told), 60)
            stats = bus.stats
        assert stats.behind > 0.9
        assert stats.summary()["behind_ms"] == round(stats.behind * 1000, 1)
        assert bus.stats.behind >= stats.behind  # what it was is kept
        Reporter(bus, json=False).summary(stats)

    if loop == "an ordinary loop":
        asyncio.run(program())
    else:
        dpstack.run_virtual(program(), paced=True)
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("simulated "))
    assert line.endswith(" s: the simulated bus did not keep up with real time")


def test_virtual_time_that_is_not_held_to_real_time_is_never_behind(capsys: Out) -> None:
    async def program() -> None:
        async with bus_of(RAW) as bus:
            await bus.rotated(100)
            Reporter(bus, json=False).summary(bus.stats)
            assert bus.stats.behind == 0.0

    virtual(program())
    assert "simulated" not in capsys.readouterr().out
