"""Exceptions in somebody's device: told, out of data exchange, never out of the application."""

from __future__ import annotations

import pytest
from slave_kit import CFG, CLEAR, MASTER, MS, OPERATE, SYNC, Bench, Recorder

from dpstack.dp.slave.application import SlaveAppState
from dpstack.dp.slave.events import DeviceFailed
from dpstack.fdl.interface import RS_REPLY
from dpstack.units import NEVER

DURING = {
    "check_prm": "Set_Prm",
    "check_cfg": "Chk_Cfg",
    "enter": "Chk_Cfg",
    "operate": "Data_Exchange",
    "exchange": "Data_Exchange",
    "clear": "Global_Control",
    "leave": "leaving (new parameters)",
    "ext_diag": "Data_Exchange",
}


@pytest.mark.parametrize("call", DURING)
def test_a_broken_device_waits_in_wait_cfg_until_restarted(call: str) -> None:
    bench = Bench()
    bench.recorder.broken = call
    # all the calls that a device gets
    bench.prm_and_cfg()
    bench.dx()
    bench.dx()
    for command in (CLEAR, OPERATE, SYNC):
        bench.control(command)
    bench.diag()
    bench.prm()
    failures = [event for event in bench.app.take_events() if isinstance(event, DeviceFailed)]
    assert [failure.during for failure in failures] == [DURING[call]]
    origin = "ext_diag()" if call == "ext_diag" else "_call()"
    assert failures[0].origin.startswith(f"{origin}, slave_kit.py line ")
    assert f"(ZeroDivisionError: the device is broken in {origin}" in failures[0].text
    assert "restart" in failures[0].text
    assert (bench.app.failure, bench.app.stats.failures) == ("ZeroDivisionError: the device is broken", 1)
    assert bench.app.state is not SlaveAppState.DATA_EXCH
    assert bench.app.outputs == b""
    bench.recorder.take()
    for _ in range(3):  # the master tries again and again: accepted, never ready, and the device left alone
        bench.prm_and_cfg()
        assert bench.app.state is SlaveAppState.WAIT_CFG
        assert bench.diag() == bytes.fromhex("02 0E 00 02 0A 35")  # not ready, Stat_Diag
        assert bench.dx() == RS_REPLY
    assert bench.recorder.take() == []
    bench.recorder.broken = ""
    bench.app.restart(bench.now)
    assert bench.app.failure is None
    bench.up()
    assert bench.dx() != RS_REPLY
    assert bench.diag()[1] == 0x0C


def test_an_exception_in_an_exchange_clears_the_outputs(bench: Bench) -> None:
    bench.dx(b"\x11")
    bench.recorder.broken = "exchange"
    assert bench.dx(b"\x22") == RS_REPLY
    assert (bench.app.state, bench.app.master, bench.app.outputs) == (SlaveAppState.WAIT_PRM, None, b"")
    assert bench.recorder.take() == ["operate", "exchange 11", "exchange 22", "leave failure"]
    assert bench.diag() == bytes.fromhex("02 07 00 FF 0A 35")


def test_a_failing_leave_after_a_watchdog_is_reported_too(bench: Bench) -> None:
    bench.dx()
    bench.recorder.broken = "leave"
    bench.pass_time(100 * MS)
    assert bench.app.state is SlaveAppState.WAIT_PRM
    texts = bench.texts()
    assert "nothing from master 2" in texts[0]
    assert "wait_prm (watchdog expired)" in texts[1]
    assert "the device failed during leaving (watchdog)" in texts[2]


def test_a_failing_leave_at_another_configuration() -> None:
    bench = Bench(Recorder(CFG, b"\x10")).up()
    bench.recorder.broken = "leave"
    bench.cfg(b"\x10")
    assert bench.app.state is SlaveAppState.WAIT_PRM
    assert "enter" not in bench.recorder.take()


def test_a_failing_leave_does_not_keep_it_from_restarting(bench: Bench) -> None:
    bench.recorder.broken = "leave"
    bench.app.restart(0)
    assert bench.app.failure is None
    assert bench.app.state is SlaveAppState.WAIT_PRM


# --- the time a device asks for -------------------------------------------------------------------------------------


class Ticking(Recorder):
    """Wants its time every 10 ms, also outside data exchange."""

    def __init__(self) -> None:
        super().__init__()
        self.due = 10 * MS
        self.ticks: list[int] = []
        self.step = 10 * MS

    def wake_at(self) -> int:
        if self.broken == "wake_at":
            raise ZeroDivisionError("the device is broken")
        return self.due

    def tick(self, now: int) -> None:
        if self.broken == "tick":
            raise ZeroDivisionError("the device is broken")
        self.ticks.append(now)
        self.due += self.step


def test_ticks_come_when_asked_for_and_all_of_them_after_a_stall() -> None:
    device = Ticking()
    bench = Bench(device)
    bench.pass_time(25 * MS)
    assert device.ticks == [10 * MS, 20 * MS]
    bench.app.tick(52 * MS)
    assert device.ticks[2:] == [52 * MS] * 3
    assert bench.app.wake_at() == 60 * MS


@pytest.mark.parametrize("call", ["tick", "wake_at"])
def test_a_failing_tick(call: str) -> None:
    device = Ticking()
    bench = Bench(device).up()
    bench.dx()
    device.broken = call
    bench.pass_time(20 * MS)
    assert "during its own time (ZeroDivisionError" in bench.texts()[0]
    assert bench.app.state is SlaveAppState.WAIT_PRM
    assert bench.app.wake_at() == NEVER
    device.broken = ""
    bench.app.restart(bench.now)
    bench.pass_time(20 * MS)
    assert bench.app.failure is None
    assert device.ticks


def test_a_device_whose_time_stands_still_does_not_hang_the_bus() -> None:
    device = Ticking()
    device.step = 0
    bench = Bench(device)
    bench.pass_time(20 * MS)
    assert bench.app.failure == f"RuntimeError: wake_at() stays at {10 * MS} after tick({10 * MS})"


def test_watchdog_and_ticks_side_by_side() -> None:
    device = Ticking()
    bench = Bench(device).up()
    bench.pass_time(100 * MS)
    assert bench.app.state is SlaveAppState.WAIT_PRM
    assert len(device.ticks) == 10
    assert bench.app.master != MASTER
