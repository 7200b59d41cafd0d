"""The driver on select: expected answers, the spin budget, ports that it refuses, ports that connect slowly."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from time import monotonic_ns

import pytest
from far_ends import TcpFarEnd
from memory_port import memory_pair
from support_responder import Responder

from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.line.answer_timing import AnswerTiming
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.port_latency import patience_of
from dpstack.drivers.line.select_loop import SelectLoop
from dpstack.drivers.line.select_runtime import SelectRuntime
from dpstack.drivers.realtime.cpu_budget import Budget
from dpstack.drivers.runtime import PortBack, PortLost
from dpstack.errors import PortError
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.machine import Machine
from dpstack.params import BusParams
from dpstack.ports import Port, open_port
from dpstack.ports.pyserial import PySerialPort
from dpstack.trace import Event, Notice
from dpstack.units import NEVER, NS_PER_MS, NS_PER_US
from tests.drivers.driver_rig import BACKOFF, REQUEST, TOKEN, Script

OTHER = bytes.fromhex("10 03 02 49 4E 16")


@pytest.fixture
def loop() -> Iterator[SelectLoop]:
    loop = SelectLoop()
    yield loop
    loop.close()


def run_until(loop: SelectLoop, condition: Callable[[], bool]) -> None:
    """Looks after every millisecond; the limit is for hangs only."""
    limit = monotonic_ns() + 10_000 * NS_PER_MS

    def look() -> None:
        if condition() or monotonic_ns() > limit:
            loop.stop()
        else:
            loop.call_at(monotonic_ns() + NS_PER_MS, look)

    loop.call_soon(look)
    loop.run()
    assert condition()


def opened(loop: SelectLoop, port: Port, machine: Machine, events: list[Event] | None = None) -> SelectRuntime:
    """A driver in ``loop`` on ``port``; it tries a lost port again at once."""
    on_events = list[Event]().extend if events is None else events.extend
    driver = SelectRuntime(port, machine, on_events, echo=Echo.OFF, backoff_ns=BACKOFF)
    driver.open(loop)
    return driver


def test_an_answer_is_expected_when_the_last_alike_came() -> None:
    answers = AnswerTiming()
    assert answers.sent(REQUEST, 1_000, 1_000) == NEVER
    answers.received(bytes(6), 5_000)
    assert answers.sent(OTHER, 10_000, 10_000) == NEVER  # the first was answered after 4000
    answers.received(bytes(6), 12_000)
    assert answers.sent(REQUEST, 20_000, 20_000) == 24_000  # the other one after 2000
    answers.received(bytes(6), 32_000)
    assert answers.sent(OTHER, 40_000, 40_000) == 42_000  # after 12000 this time: an eighth of the way
    answers.received(bytes(6), 42_000)
    assert answers.sent(REQUEST, 50_000, 50_000) == 55_000


def test_after_a_silence_no_answer_is_expected() -> None:
    answers = AnswerTiming()
    answers.sent(REQUEST, 1_000, 1_000)
    answers.received(bytes(6), 5_000)
    answers.sent(REQUEST, 10_000, 10_000)
    assert answers.sent(REQUEST, 20_000, 20_000) == NEVER


def test_the_number_of_remembered_requests_is_bounded() -> None:
    answers = AnswerTiming()
    for number in range(5_000):
        answers.received(bytes(6), 10 * number - 5)
        answers.sent(number.to_bytes(7, "big"), 10 * number, 10 * number)
    assert len(answers._usual) <= 1024


def test_the_driver_tells_its_loop_when_an_answer_is_expected(loop: SelectLoop) -> None:
    near, far = memory_pair(500_000)
    machine = Script()
    far.open_now()
    driver = opened(loop, near, machine)
    driver.command(REQUEST)
    assert loop.expected_at == NEVER
    far.write(TOKEN)
    run_until(loop, lambda: bool(machine.did("receive")))
    ((_, first, _),) = machine.did("sent")
    driver.command(REQUEST)
    (_, (_, again, _)) = machine.did("sent")
    ((_, _, heard),) = machine.did("receive")
    assert loop.expected_at - again == heard - first
    driver.close()
    assert loop.expected_at == NEVER


def test_a_driver_without_budget_waits_by_timer_and_is_never_early(loop: SelectLoop) -> None:
    near, _far = memory_pair(500_000)
    machine = Script()

    def again(now: int) -> None:
        loop.budget.spun(1_000 * NS_PER_MS, now)  # nothing is left, and never will be
        if len(machine.did("wake")) < 30:
            machine.deadline = now + 10 * NS_PER_US

    machine.on_wake = again
    driver = opened(loop, near, machine)
    driver.command(10 * NS_PER_US)
    run_until(loop, lambda: len(machine.did("wake")) == 30)
    assert all(now >= deadline for _, deadline, now in machine.did("wake"))
    assert driver._step_wait_ns == 0
    driver.close()


class Spent(Budget):
    """A budget that never permits spinning."""

    def may_spin(self, now: int) -> bool:
        return False


@pytest.mark.parametrize("baud", [45_450, 500_000, 12_000_000])
def test_at_every_rate_a_bus_goes_on_when_the_budget_is_used_up(baud: int) -> None:
    loop = SelectLoop(budget=Spent())
    port = open_port("pty", baud)
    params = BusParams.preset(baud, address=2, gap=0)
    master = Master(
        params, [SlaveParams(address=3, name="s", ident=0x0696, config=b"\xf3\xf1")], MasterSettings(watchdog_ms=1000)
    )
    station = ActiveStation(params, [master], patience=patience_of(port), now=monotonic_ns())
    driver = opened(loop, port, station)
    driver._count_spinning(1, monotonic_ns())  # as after a spin that was the last
    with Responder(driver.port_name, ["3:0696:f3f1:12:12"]):
        driver.command(GoOnline())
        driver.command(SetMode(Mode.OPERATE))
        handler = master.handlers[3]
        run_until(loop, lambda: handler.state is SlaveState.DATA_EXCHANGE and handler.exchanges >= 20)
    assert driver.failed is None
    driver.close()
    loop.close()


@pytest.mark.parametrize("port", [open_port("rfc2217://127.0.0.1:7000", 500_000), PySerialPort("COM3", 500_000)])
def test_a_port_that_needs_asyncio_is_refused(port: Port) -> None:
    driver = SelectRuntime(port, Script(), lambda _events: None)
    with pytest.raises(PortError, match='works with the asyncio driver only: set driver = "asyncio"'):
        driver.open(SelectLoop())


class SlowLine:
    """A TCP line whose connecting waits for the test, from the second time on."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.far = TcpFarEnd()
        self.port = open_port(self.far.path, 500_000)
        self.threads: list[str] = []
        self.go = threading.Event()
        self._really = self.port.open_now
        monkeypatch.setattr(self.port, "open_now", self._open_now)

    def _open_now(self) -> None:
        if self.threads:
            self.go.wait(10)
        self.threads.append(threading.current_thread().name)
        self._really()


def test_a_lost_connection_is_made_again_while_the_loop_goes_on(
    loop: SelectLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = SlowLine(monkeypatch)
    machine, events = Script(), list[Event]()
    driver = opened(loop, line.port, machine, events)
    line.far.hang_up()
    run_until(loop, lambda: any(isinstance(event, PortLost) for event in events))
    turns = 0

    def meanwhile() -> None:
        nonlocal turns
        turns += 1
        if turns == 20:
            line.go.set()
        loop.call_at(monotonic_ns() + NS_PER_MS, meanwhile)

    loop.call_soon(meanwhile)
    run_until(loop, lambda: any(isinstance(event, PortBack) for event in events))
    assert turns >= 20
    assert line.threads == ["MainThread", f"connecting {line.far.path}"]
    driver.command(TOKEN)
    assert machine.did("sent")
    driver.close()
    line.far.shut()


@pytest.mark.parametrize("loop_is_closed", [True, False])
def test_a_connection_that_comes_about_too_late_is_closed(
    loop: SelectLoop, monkeypatch: pytest.MonkeyPatch, loop_is_closed: bool
) -> None:
    line = SlowLine(monkeypatch)
    events = list[Event]()
    driver = opened(loop, line.port, Script(), events)
    line.far.hang_up()

    def connecting() -> list[threading.Thread]:
        return [thread for thread in threading.enumerate() if thread.name.startswith("connecting")]

    run_until(loop, lambda: bool(connecting()))
    (thread,) = connecting()
    driver.close()
    if loop_is_closed:
        loop.close()
    line.go.set()
    thread.join()
    if not loop_is_closed:
        run_until(loop, lambda: line.port.fd is None)
        loop.close()
    assert line.port.fd is None
    assert not any(isinstance(event, PortBack) for event in events)
    line.far.shut()


def test_opened_again_while_an_old_attempt_connects(loop: SelectLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    line = SlowLine(monkeypatch)
    events, machine = list[Event](), Script()
    driver = opened(loop, line.port, machine, events)
    line.far.hang_up()
    run_until(loop, lambda: driver._connecting is not None)
    driver.close()
    line.go.set()
    driver.open(loop)
    turns = monotonic_ns() + 5 * NS_PER_MS
    run_until(loop, lambda: monotonic_ns() > turns)  # the outcome of the old attempt comes now, and changes nothing
    assert line.port.fd is not None
    assert not any(isinstance(event, PortBack) for event in events)
    driver.close()
    line.far.shut()


def test_notices_of_the_port_are_reported_at_open(loop: SelectLoop) -> None:
    events = list[Event]()
    near, _far = memory_pair(500_000)
    near.notices = ["has no parity bit"]
    driver = opened(loop, near, Script(), events)
    assert [event.text for event in events if isinstance(event, Notice)] == [f"{near.name}: has no parity bit"]
    driver.close()
    driver.close()
