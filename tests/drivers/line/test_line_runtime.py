"""The real-time drivers with a machine that does as it is told: steps, deadlines, loss, defects, the rate that it
wants."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable
from time import monotonic_ns
from typing import Any

import pytest
from far_ends import PtyFarEnd, TcpFarEnd, until
from memory_port import MemoryPort

from dpstack.drivers.line import line_runtime
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.port_latency import patience_of
from dpstack.drivers.runtime import PortBack, PortLost
from dpstack.errors import BaudError, BusError, ConfigError, PortError, UsageError
from dpstack.machine import InDoubt, LineDown, LineUp, RateRefused
from dpstack.phy.patience import ADAPTER, HOST
from dpstack.ports import open_port, timerfd
from dpstack.ports.pty import PtyPort
from dpstack.trace import Event, Notice
from dpstack.units import NEVER, NS_PER_MS, chars_to_ns
from tests.drivers.driver_rig import BACKOFF, REQUEST, TOKEN, Rig, Script, defect, driver_on

pytestmark = pytest.mark.usefixtures("each_driver")


async def test_octets_go_to_the_machine_and_its_answer_to_the_line() -> None:
    async with Rig() as rig:
        rig.machine.on_receive = lambda _chunk, _now: rig.machine.tx.append(TOKEN)
        rig.far.write(REQUEST)
        await rig.settle()
        assert rig.machine.received == [REQUEST]
        assert rig.far.read_now() == TOKEN
        assert rig.calls == 0


async def test_a_transmission_is_over_when_written_where_no_wire_gives_it_time() -> None:
    async with Rig() as rig:
        before = monotonic_ns()
        rig.driver.command(REQUEST)
        ((_sent, at, after),) = rig.machine.did("sent")
        assert before <= at <= after
        assert not rig.driver.paced


async def test_a_transmission_takes_its_time_on_a_wire() -> None:
    rig = Rig()
    rig.port.paced = True
    rig.driver = driver_on(rig.port, rig.machine, rig.on_events)
    async with rig:
        before = monotonic_ns()
        rig.driver.command(REQUEST)
        ((_sent, at, after),) = rig.machine.did("sent")
        wire = chars_to_ns(6, 500_000)
        assert before + wire <= at <= after + wire
        assert rig.driver.paced


@pytest.mark.parametrize("wait_ns", [1_000, 15_000, 25_000, 300_000, 3_000_000])
@pytest.mark.parametrize("fd_timer", [True, False])
async def test_a_deadline_is_judged_once_and_never_early(
    monkeypatch: pytest.MonkeyPatch, wait_ns: int, fd_timer: bool
) -> None:
    monkeypatch.setattr(timerfd, "AVAILABLE", fd_timer)
    async with Rig() as rig:
        rig.driver.command(wait_ns)
        await until(lambda: bool(rig.machine.did("wake")), "the deadline")
        await asyncio.sleep(0.002)
        ((_wake, deadline, now),) = rig.machine.did("wake")
        assert now >= deadline


async def test_a_deadline_that_moves_later_is_not_judged_before() -> None:
    async with Rig() as rig:
        rig.driver.command(2 * NS_PER_MS)
        rig.driver.command(20 * NS_PER_MS)
        rig.driver.command(8 * NS_PER_MS)
        await until(lambda: bool(rig.machine.did("wake")), "the deadline")
        ((_wake, deadline, now),) = rig.machine.did("wake")
        assert now >= deadline


async def test_one_deadline_may_set_the_next() -> None:
    async with Rig() as rig:

        def again(now: int) -> None:
            if len(rig.machine.did("wake")) < 20:
                rig.machine.deadline = now + 100_000

        rig.machine.on_wake = again
        rig.driver.command(100_000)
        await until(lambda: len(rig.machine.did("wake")) == 20, "all deadlines")


@pytest.mark.parametrize("occasion", ["the timer", "an order"])
async def test_after_the_loop_was_held_up_the_port_is_read_before_deadlines_are_judged(occasion: str) -> None:
    async with Rig() as rig:

        def answered(_chunk: bytes, _now: int) -> None:
            rig.machine.deadline = NEVER

        rig.machine.on_receive = answered
        rig.driver.command(20 * NS_PER_MS)
        rig.far.write(TOKEN)
        end = monotonic_ns() + 25 * NS_PER_MS
        while monotonic_ns() < end:  # the application holds the loop up: deadline and answer are both there afterwards
            pass
        if occasion == "the timer":
            rig.driver._timer_due()
        else:
            rig.driver.command("something")
        assert not rig.machine.did("wake")
        assert rig.machine.received == [TOKEN]


async def test_endless_near_deadlines_leave_the_loop_its_turns() -> None:
    async with Rig() as rig:

        def at_once(now: int) -> None:
            rig.machine.deadline = now + 2_000

        rig.machine.on_wake = at_once
        rig.driver.command(2_000)
        enough = len(rig.machine.did("wake")) + 2 * line_runtime._BURST
        await until(lambda: len(rig.machine.did("wake")) > enough, "turns of the loop between them")
        rig.machine.on_wake = lambda _now: None


async def test_work_for_later_is_done_once_after_the_transmission_and_the_events() -> None:
    async with Rig() as rig:
        seen: list[tuple[bytes, int]] = []

        def on_receive(_chunk: bytes, now: int) -> None:
            rig.driver.after_step(lambda: seen.append((rig.far.read_now(), rig.calls)))
            rig.machine.events.append(Notice(t_ns=now, source="test", message="hello"))
            rig.machine.tx.append(TOKEN)

        rig.machine.on_receive = on_receive
        rig.far.write(REQUEST)
        await rig.settle()
        rig.driver.command(REQUEST)
        assert seen == [(TOKEN, 1)]


async def test_a_defect_in_work_for_later_stops_the_driver() -> None:
    async with Rig() as rig:
        rig.machine.on_receive = lambda _chunk, _now: rig.driver.after_step(lambda: defect(None))
        rig.far.write(REQUEST)
        await rig.settle()
        assert [type(exc) for exc in rig.failures] == [ZeroDivisionError]


async def test_events_are_handed_over_after_the_step_and_only_when_there_are_some() -> None:
    async with Rig() as rig:
        rig.far.write(TOKEN)
        await rig.settle()
        assert rig.calls == 0
        notice = Notice(t_ns=1, source="test", message="hello")
        rig.machine.on_receive = lambda _chunk, _now: rig.machine.events.append(notice)
        rig.far.write(TOKEN)
        await rig.settle()
        assert rig.events == [notice]


async def test_the_last_events_are_dispatched_at_close() -> None:
    rig = Rig()
    notice = Notice(t_ns=1, source="test", message="goodbye")
    async with rig:
        rig.machine.events.append(notice)
    assert rig.events == [notice]
    await rig.driver.close()


async def test_a_handler_that_raises_does_not_stop_the_bus() -> None:
    reported: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _loop, context: reported.append(context))
    rig = Rig()

    def broken(_events: list[Event]) -> None:
        raise ValueError("the application's own")

    rig.driver = driver_on(rig.port, rig.machine, broken, echo=Echo.OFF)
    async with rig:
        rig.machine.events.append(Notice(t_ns=1, source="test", message="hello"))
        rig.driver.command(TOKEN)
        rig.driver.command(REQUEST)
        assert rig.far.read_now() == TOKEN + REQUEST
    assert isinstance(reported[0]["exception"], ValueError)


async def test_misuse_raises_at_once() -> None:
    rig = Rig()
    with pytest.raises(UsageError, match="open"):
        rig.driver.command(TOKEN)
    async with rig:
        with pytest.raises(UsageError, match="already"):
            await rig.driver.open()
        with pytest.raises(KeyError):
            rig.driver.command(KeyError("the machine refuses the order"))
        rig.driver.command(TOKEN)  # which stops nothing
        assert rig.far.read_now() == TOKEN
    with pytest.raises(UsageError, match="open"):
        rig.driver.command(TOKEN)


async def test_a_defect_of_the_machine_stops_the_driver_and_is_reported() -> None:
    async with Rig() as rig:
        rig.machine.on_receive = defect
        rig.far.write(TOKEN)
        await rig.settle()
        assert [type(exc) for exc in rig.failures] == [ZeroDivisionError]
        assert rig.driver.failed is rig.failures[0]
        assert "a defect" in rig.events[-1].text
        with pytest.raises(BusError):
            rig.driver.command(TOKEN)
        rig.far.write(TOKEN)
        await rig.settle()
        assert len(rig.failures) == 1
    with pytest.raises(BusError):
        await rig.driver.open()


async def test_a_defect_without_an_owner_goes_to_the_loops_handler() -> None:
    reported: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _loop, context: reported.append(context))
    async with Rig(on_failure=None) as rig:
        rig.machine.on_wake = defect
        rig.driver.command(NS_PER_MS)
        await until(lambda: bool(reported), "the report")
    assert isinstance(reported[0]["exception"], ZeroDivisionError)


async def test_a_machine_that_never_settles_is_a_defect() -> None:
    async with Rig() as rig:

        def never(_now: int) -> None:
            rig.machine.deadline = 0

        rig.machine.on_wake = never
        rig.driver.command(1)
        assert "does not settle" in str(rig.failures[0])


async def test_a_lost_port_is_reported_and_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    async with Rig() as rig:
        attempts: list[None] = []
        open_now = rig.port.open_now

        def counted() -> None:
            attempts.append(None)
            open_now()

        monkeypatch.setattr(rig.port, "open_now", counted)
        rig.port.unplug("pulled out")
        await until(lambda: len(rig.events) >= 2, "the loss")
        assert isinstance(rig.events[0], PortLost)
        assert rig.events[0].reason == "pulled out"
        assert "pulled out" in rig.events[1].text  # why it cannot be opened again: told once, not at every attempt
        rig.driver.command(TOKEN)  # goes nowhere
        await until(lambda: len(attempts) > 3, "several attempts to open the port")
        assert len(rig.events) == 2
        rig.port.plug()
        await until(lambda: len(rig.events) == 3, "the return")
        assert isinstance(rig.events[2], PortBack)
        assert rig.machine.commands == [LineDown("pulled out"), TOKEN, LineUp()]
        rig.driver.command(REQUEST)
        assert rig.far.read_now() == REQUEST


async def test_the_beginning_of_an_answer_is_kept_for_its_rest_and_not_for_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Until the rest comes, a deadline is due, or it does not come in time."""
    begin, rest = REQUEST[:4], REQUEST[4:]
    monkeypatch.setattr(line_runtime, "_REST_NS", 1_000 * NS_PER_MS)
    async with Rig() as rig:
        rig.driver._keep(begin)
        rig.far.write(rest)
        await rig.settle()
        assert rig.machine.received == [REQUEST]
        rig.driver._keep(begin)
        rig.driver.command(NS_PER_MS)
        await until(lambda: bool(rig.machine.did("wake")), "the deadline")
        assert rig.machine.received == [REQUEST, begin]
        assert [what for what, *_ in rig.machine.log[-2:]] == ["receive", "wake"]
        monkeypatch.setattr(line_runtime, "_REST_NS", NS_PER_MS)
        rig.driver._keep(begin)
        await until(lambda: len(rig.machine.received) == 3, "what was kept")
        assert rig.machine.received[-1] == begin


async def test_what_was_kept_is_not_joined_to_octets_after_a_loss() -> None:
    async with Rig() as rig:
        rig.driver._keep(REQUEST[:4])
        rig.port.unplug()
        rig.port.plug()
        await until(lambda: bool(rig.events_of(PortBack)), "the return")
        rig.far.write(TOKEN)
        await rig.settle()
        assert rig.machine.received == [TOKEN]


async def test_what_was_kept_is_dropped_when_the_port_doubts_it() -> None:
    """A port that only counts damaged octets learns late of them, and drops those that come with a new count."""
    async with Rig() as rig:
        rig.driver._keep(REQUEST[:4])
        rig.driver._in_doubt(NS_PER_MS)
        rig.far.write(TOKEN)
        await rig.settle()
        assert rig.machine.received == [TOKEN]
        assert rig.machine.commands == [InDoubt(NS_PER_MS)]


async def test_a_notice_of_the_port_is_reported_once_for_all_openings() -> None:
    rig = Rig()
    rig.port.notices = ["has no parity bit"]

    def count(text: str) -> int:
        return sum(text in notice.text for notice in rig.events_of(Notice))

    async def come_back() -> None:
        before = len(rig.events_of(PortBack))
        rig.port.unplug("pulled out")
        rig.port.plug()
        await until(lambda: len(rig.events_of(PortBack)) == before + 1, "the return")

    async with rig:
        assert rig.events[0].text == f"{rig.port.name}: has no parity bit"
        await come_back()
        await come_back()
        assert count("no parity") == 1
        rig.port.notices = ["has no parity bit", "its latency timer stays at 16 ms"]  # another adapter
        await come_back()
        await come_back()
        assert (count("no parity"), count("latency timer")) == (1, 1)


async def test_a_lost_port_may_be_closed() -> None:
    async with Rig() as rig:
        rig.port.unplug()
        await until(lambda: bool(rig.events), "the loss")
    rig.port.plug()
    await asyncio.sleep(0.005)
    assert not rig.events_of(PortBack)


async def test_a_machine_that_fails_over_the_loss_is_a_defect(monkeypatch: pytest.MonkeyPatch) -> None:
    async with Rig() as rig:
        monkeypatch.setattr(Script, "command", defect)
        rig.port.unplug()
        await until(lambda: bool(rig.failures), "the failure")


async def test_a_driver_that_was_stopped_while_its_port_is_away_does_not_take_it_back() -> None:
    async with Rig() as rig:
        rig.port.unplug()
        await until(lambda: bool(rig.events), "the loss")
        rig.machine.on_wake = defect
        rig.driver.command(1)
        await until(lambda: bool(rig.failures), "the failure")
        rig.port.plug()
        await asyncio.sleep(0.01)
        assert not rig.port._is_open
        assert not rig.events_of(PortBack)


async def test_a_port_class_that_fails_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    async with Rig() as rig:
        monkeypatch.setattr(MemoryPort, "open_now", defect)
        rig.port.unplug()
        await until(lambda: bool(rig.failures), "the failure")


async def test_dropped_telegrams_are_reported_by_powers_of_ten() -> None:
    async with Rig() as rig:
        for _ in range(500):
            rig.driver.command(bytes(250))
        await rig.settle()
        assert rig.port.dropped > 100
        assert [event.text.split(": ")[1].split()[0] for event in rig.events] == ["1", "10", "100"]


async def test_a_port_that_cannot_be_opened_raises() -> None:
    rig = Rig()
    rig.port.unplug("not there")
    with pytest.raises(PortError, match="not there"):
        await rig.driver.open()
    await rig.driver.close()


async def test_a_pty_that_vanishes_and_its_name_coming_back(tmp_path: Any) -> None:
    link = tmp_path / "port"
    far = PtyFarEnd()
    link.symlink_to(far.path)
    machine, events = Script(), list[Event]()
    driver = driver_on(open_port(str(link), 500_000), machine, events.extend, backoff_ns=BACKOFF)
    await driver.open()
    driver.command(TOKEN)
    assert await far.recv(3) == TOKEN
    far.hang_up()
    await until(lambda: any(isinstance(event, PortLost) for event in events), "the loss")
    link.unlink()
    far = PtyFarEnd()
    link.symlink_to(far.path)
    await until(lambda: any(isinstance(event, PortBack) for event in events), "the return")
    driver.command(REQUEST)
    assert await far.recv(6) == REQUEST
    await driver.close()
    far.hang_up()
    gc.collect()


async def test_a_pty_made_here_is_named_by_its_other_end() -> None:
    driver = driver_on(open_port("pty", 500_000), Script(), lambda _events: None)
    assert driver.port_name == "pty"
    await driver.open()
    assert driver.port_name.startswith("/dev/pts/")
    assert driver.now() <= monotonic_ns()
    await driver.close()


def test_patience_follows_the_kind_of_port() -> None:
    assert patience_of(PtyPort(9600)) is HOST
    assert patience_of(open_port("/dev/ttyUSB9", 9600)) is ADAPTER


# --- a line that is never silent --------------------------------------------------------------------------------------


async def test_discarded_octets_are_reported_by_powers_of_ten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with Rig() as rig:
        looks = 0

        def endless() -> bytes:
            nonlocal looks
            looks += 1
            rig.port.discarded += 1_000
            return b"\x55"

        monkeypatch.setattr(rig.port, "read_now", endless)
        told = []
        for _ in range(12):
            before = looks
            rig.driver.command(1)  # a deadline that is over at once: the driver looks before the machine judges it
            assert looks - before <= 8  # with four looks each time it would never come back
            await rig.settle()
            told = [notice.message for notice in rig.events_of(Notice)]
        assert [int(text.split(", ")[1].split()[0]) for text in told] == [1_000, 10_000]
        assert told[0].startswith(
            "the line brings octets faster than this computer can look at them, 1000 were thrown away"
        )


class Choosy(Script):
    """Wants one rate after the other as they are refused."""

    def __init__(self, *rates: int) -> None:
        super().__init__()
        self.rates = list(rates)

    @property
    def baud(self) -> int:
        return self.rates[0]

    @baud.setter
    def baud(self, baud: int) -> None:
        self.rates = [baud]

    def command(self, command: object, now: int) -> None:
        super().command(command, now)
        if isinstance(command, RateRefused):
            if len(self.rates) == 1:
                raise ConfigError("none of the rates is left")
            self.rates.pop(0)


def up_to(rig: Rig, limit: int, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The near port refuses rates above ``limit``; returns those it was set to."""
    really: Callable[[int], None] = rig.port.set_baud
    taken: list[int] = []

    def set_baud(baud: int) -> None:
        if baud > limit:
            raise BaudError(f"cannot do {baud}")
        really(baud)
        taken.append(baud)

    monkeypatch.setattr(rig.port, "set_baud", set_baud)
    return taken


async def test_the_port_is_set_without_being_closed() -> None:
    async with Rig() as rig:
        rig.machine.baud = 187_500
        rig.driver.command(b"\xe5")
        assert rig.port.baud == 187_500
        assert rig.far.line_baud() == 187_500
        assert rig.far.read_now() == b"\xe5"
        assert rig.events == []
        assert rig.machine.commands == [b"\xe5"]  # no LineDown, no LineUp


async def test_at_once_when_it_is_opened() -> None:
    rig = Rig()
    rig.machine.baud = 19_200
    async with rig:
        assert rig.port.baud == 19_200


async def test_a_refused_rate_is_reported_and_the_machine_chooses_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig()
    machine = Choosy(500_000)
    rig.driver = driver_on(rig.port, machine, rig.on_events, backoff_ns=(1, 1))
    taken = up_to(rig, 3_000_000, monkeypatch)
    async with rig:
        machine.rates = [12_000_000, 6_000_000, 3_000_000, 9_600]
        rig.driver.command(b"")
        assert taken == [3_000_000]
        assert [order for order in machine.commands if isinstance(order, RateRefused)] == [
            RateRefused("cannot do 12000000"),
            RateRefused("cannot do 6000000"),
        ]


async def test_a_port_without_any_of_the_rates_cannot_be_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig()
    machine = Choosy(12_000_000, 6_000_000)
    rig.driver = driver_on(rig.port, machine, rig.on_events)
    up_to(rig, 500_000, monkeypatch)
    with pytest.raises(ConfigError, match="none of the rates is left"):
        await rig.driver.open()
    assert not rig.port._is_open


async def test_a_port_that_loses_all_its_rates_is_lost_and_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig()
    machine = Choosy(500_000)
    rig.driver = driver_on(rig.port, machine, rig.on_events, backoff_ns=(1, 1))
    async with rig:
        up_to(rig, 500_000, monkeypatch)
        machine.baud = 12_000_000
        rig.driver.command(b"")
        (lost,) = rig.events_of(PortLost)
        assert lost.reason == "none of the rates is left"
        machine.baud = 187_500  # while it is away it is not followed
        await until(lambda: bool(rig.events_of(PortBack)), "the port is back")
        assert rig.port.baud == 187_500
        assert [type(order) for order in machine.commands[-2:]] == [LineDown, LineUp]
        assert rig.driver.failed is None


async def test_a_lost_port_comes_back_at_the_rate_it_could_do() -> None:
    rig = Rig()
    machine = Choosy(500_000)
    rig.driver = driver_on(rig.port, machine, rig.on_events, backoff_ns=(1, 1))
    async with rig:
        rig.port.unplug()
        await until(lambda: bool(rig.events), "the loss")
        machine.baud = 12_000_000
        await rig.settle()
        assert rig.port.baud == 500_000
        rig.port.plug()
        await until(lambda: rig.port.baud == 12_000_000, "the port follows again")


async def test_a_port_whose_rate_cannot_be_changed_says_so() -> None:
    far = TcpFarEnd()
    machine = Script()
    driver = driver_on(open_port(far.path, 9_600), machine, lambda _: None)
    with pytest.raises(PortError, match="keeps the rate it was opened with; give the rate"):
        await driver.open()
    far.shut()
