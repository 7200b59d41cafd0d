"""The loop without asyncio: descriptors, deadlines, calls of the next turn, threads and signals."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from time import monotonic_ns

import pytest

from dpstack.drivers.line.select_loop import SelectLoop
from dpstack.drivers.realtime.cpu_budget import Budget
from dpstack.errors import UsageError
from dpstack.units import NEVER, NS_PER_MS, NS_PER_US

LIMIT_NS = 10_000 * NS_PER_MS  # for hangs only


class Failures(list[tuple[str, Exception]]):
    def __call__(self, message: str, error: Exception) -> None:
        self.append((message, error))


@pytest.fixture
def failures() -> Failures:
    return Failures()


@pytest.fixture
def loop(failures: Failures) -> Iterator[SelectLoop]:
    loop = SelectLoop(report=failures)
    yield loop
    loop.close()


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    near, far = socket.socketpair()
    near.setblocking(False)
    yield near, far
    near.close()
    far.close()


def run(loop: SelectLoop) -> None:
    """Until it is stopped."""
    hang = loop.call_at(monotonic_ns() + LIMIT_NS, lambda: pytest.fail("nobody stopped the loop"))
    loop.run()
    hang.cancel()


def test_a_reader_is_called_until_all_octets_are_read(
    loop: SelectLoop, pair: tuple[socket.socket, socket.socket]
) -> None:
    near, far = pair
    calls: list[bytes] = []

    def readable() -> None:
        calls.append(near.recv(2))
        if len(calls) == 3:
            loop.stop()

    loop.add_reader(near.fileno(), readable)
    far.send(b"abcdef")
    run(loop)
    assert calls == [b"ab", b"cd", b"ef"]


@pytest.mark.parametrize("octets", [b"abc", b""])
def test_a_quiet_descriptor_is_read_once_at_the_end_of_its_time(
    loop: SelectLoop, pair: tuple[socket.socket, socket.socket], octets: bytes
) -> None:
    near, far = pair
    calls: list[tuple[int, bytes]] = []
    until = monotonic_ns() + 5 * NS_PER_MS

    def readable() -> None:
        got = b""
        with contextlib.suppress(BlockingIOError):
            got = near.recv(9)
        calls.append((monotonic_ns(), got))

    loop.add_reader(near.fileno(), readable)
    loop.set_quiet(near.fileno())
    loop.quiet_until = until
    far.send(octets)
    loop.call_at(until + 5 * NS_PER_MS, loop.stop)
    run(loop)
    ((at, got),) = calls
    assert at >= until
    assert got == octets


def test_other_descriptors_wake_the_loop_up_while_one_is_quiet(
    loop: SelectLoop, pair: tuple[socket.socket, socket.socket]
) -> None:
    near, far = pair
    other, its_far = socket.socketpair()
    calls: list[str] = []

    def on_other() -> None:
        calls.append("other")
        other.recv(9)
        loop.stop()

    loop.add_reader(near.fileno(), lambda: calls.append("quiet"))
    loop.add_reader(other.fileno(), on_other)
    loop.set_quiet(near.fileno())
    loop.quiet_until = monotonic_ns() + LIMIT_NS // 2
    far.send(b"a")
    its_far.send(b"b")
    run(loop)
    assert calls == ["other"]
    other.close()
    its_far.close()


def test_a_hang_up_is_readable(loop: SelectLoop, pair: tuple[socket.socket, socket.socket]) -> None:
    near, far = pair
    got: list[bytes] = []

    def readable() -> None:
        got.append(near.recv(9))
        loop.stop()

    loop.add_reader(near.fileno(), readable)
    far.close()
    run(loop)
    assert got == [b""]


def test_a_writer_is_called_when_the_descriptor_takes_octets_again(
    loop: SelectLoop, pair: tuple[socket.socket, socket.socket]
) -> None:
    near, far = pair
    with contextlib.suppress(BlockingIOError):
        while near.send(bytes(65_536)):
            pass
    told: list[str] = []

    def writable() -> None:
        told.append("writable")
        assert loop.remove_writer(near.fileno())
        loop.stop()

    def drain() -> None:
        assert told == []
        far.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while far.recv(65_536):
                pass

    loop.add_writer(near.fileno(), writable)
    loop.add_reader(near.fileno(), lambda: None)
    loop.call_at(monotonic_ns() + NS_PER_MS, drain)
    run(loop)
    assert told == ["writable"]
    assert not loop.remove_writer(near.fileno())


def test_a_reader_removed_in_the_same_turn_is_not_called(loop: SelectLoop) -> None:
    pairs = [socket.socketpair() for _ in range(2)]
    called: list[int] = []

    def make(own: int) -> Callable[[], None]:
        def readable() -> None:
            called.append(own)
            assert loop.remove_reader(pairs[1 - own][0].fileno())
            loop.remove_reader(pairs[own][0].fileno())
            loop.stop()

        return readable

    for i, (near, far) in enumerate(pairs):
        loop.add_reader(near.fileno(), make(i))
        far.send(b"x")
    run(loop)
    assert len(called) == 1
    for near, far in pairs:
        near.close()
        far.close()


@pytest.mark.parametrize("wait_ns", [-1, 1, 10 * NS_PER_US, 60 * NS_PER_US, 300 * NS_PER_US, 3 * NS_PER_MS])
def test_an_alarm_is_never_early(loop: SelectLoop, wait_ns: int) -> None:
    at = monotonic_ns() + wait_ns
    called: list[int] = []

    def due() -> None:
        called.append(monotonic_ns())
        loop.stop()

    loop.call_at(at, due)
    run(loop)
    (now,) = called
    assert now >= at


def test_an_alarm_is_never_early_when_the_budget_is_used_up(loop: SelectLoop) -> None:
    wanted: list[int] = []
    late: list[int] = []

    def due() -> None:
        late.append(monotonic_ns() - wanted[-1])
        loop.budget.spun(1_000 * NS_PER_MS, monotonic_ns())
        if len(late) < 20:
            again()
        else:
            loop.stop()

    def again() -> None:
        wanted.append(monotonic_ns() + 30 * NS_PER_US)
        alarm.set(wanted[-1])

    alarm = loop.alarm(due)
    again()
    run(loop)
    assert len(late) == 20
    assert min(late) >= 0


def test_alarms_move_and_are_cancelled(loop: SelectLoop) -> None:
    told: list[str] = []
    now = monotonic_ns()
    loop.call_at(now, lambda: told.append("cancelled")).cancel()

    def first() -> None:
        told.append("first")
        moved.set(NEVER)
        closed.close()

    loop.call_at(now, first)
    moved = loop.alarm(lambda: told.append("moved"))
    moved.set(now)
    closed = loop.call_at(now, lambda: told.append("closed"))
    loop.call_at(now + NS_PER_MS, loop.stop)
    run(loop)
    assert told == ["first"]
    closed.close()
    moved.set(monotonic_ns())
    moved.callback = loop.stop
    run(loop)


def test_calls_of_the_next_turn_keep_their_order_and_let_others_have_theirs(
    loop: SelectLoop, pair: tuple[socket.socket, socket.socket]
) -> None:
    near, far = pair
    told: list[str] = []

    def for_ever() -> None:
        told.append("soon")
        loop.call_soon(for_ever)

    def readable() -> None:
        told.append("readable")
        loop.stop()

    loop.add_reader(near.fileno(), readable)
    far.send(b"x")
    loop.call_soon(lambda: told.append("never")).cancel()
    loop.call_soon(lambda: told.append("one"))
    loop.call_soon(for_ever)
    run(loop)
    assert told[:2] == ["one", "soon"]
    assert told[-1] == "readable"
    assert "never" not in told


def test_an_exception_of_a_callback_is_reported_and_stops_nothing(loop: SelectLoop, failures: Failures) -> None:
    def broken() -> None:
        raise ValueError("the callback's own")

    loop.call_soon(broken)
    loop.call_at(monotonic_ns() + NS_PER_MS, loop.stop)
    run(loop)
    ((message, error),) = failures
    assert message == "a callback raised"
    assert isinstance(error, ValueError)


def test_without_a_report_function_an_exception_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    loop = SelectLoop()

    def broken() -> None:
        raise ValueError("the callback's own")

    loop.call_soon(broken)
    loop.call_soon(loop.stop)
    loop.run()
    loop.close()
    assert "ValueError: the callback's own" in capsys.readouterr().err


def test_another_thread_wakes_it(loop: SelectLoop) -> None:
    idle = threading.Event()
    loop.on_idle = lambda _now, _until: idle.set()

    def other() -> None:
        idle.wait(10)
        loop.call_soon_threadsafe(loop.stop)

    thread = threading.Thread(target=other)
    thread.start()
    run(loop)
    thread.join()
    loop.close()
    with pytest.raises(RuntimeError, match="closed"):
        loop.call_soon_threadsafe(loop.stop)


def test_a_call_while_it_is_closed_is_refused_as_one_afterwards(
    loop: SelectLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop._waker_fd()
    call_soon = loop.call_soon

    def closed_meanwhile(callback: Callable[[], object]) -> object:
        soon = call_soon(callback)
        loop.close()
        return soon

    monkeypatch.setattr(loop, "call_soon", closed_meanwhile)
    with pytest.raises(RuntimeError, match="closed"):
        loop.call_soon_threadsafe(loop.stop)


def test_a_signal_wakes_it(loop: SelectLoop) -> None:
    told: list[int] = []

    def signalled() -> None:
        told.append(1)
        loop.stop()

    loop.add_signal_handler(signal.SIGUSR1, signalled)
    loop.call_at(monotonic_ns() + NS_PER_MS, lambda: os.kill(os.getpid(), signal.SIGUSR1))
    run(loop)
    assert told == [1]
    loop.close()
    assert signal.getsignal(signal.SIGUSR1) is signal.SIG_DFL


def test_on_idle_is_called_with_the_end_of_the_idle_time(
    loop: SelectLoop, pair: tuple[socket.socket, socket.socket]
) -> None:
    near, far = pair
    told: list[int] = []
    loop.on_idle = lambda _now, until: told.append(until)
    due = monotonic_ns() + LIMIT_NS // 2
    loop.expected_at = expected = due - 1_000 * NS_PER_MS
    loop.call_at(due, lambda: pytest.fail("nobody stopped the loop"))

    def readable() -> None:  # left unread: no sleep lasts
        if loop.expected_at < monotonic_ns():
            loop.stop()
        loop.expected_at = 1

    loop.add_reader(near.fileno(), readable)
    far.send(b"x")
    loop.run()
    assert told == [expected, due]  # and once it should have come: what is due


class Counting(Budget):
    """Counts the sleep it is told of."""

    __slots__ = ("total",)

    def __init__(self) -> None:
        super().__init__(rests=True)
        self.total = 0

    def slept(self, ns: int, now: int) -> None:
        self.total += ns
        super().slept(ns, now)


def test_a_forced_rest_comes_before_all_that_is_due() -> None:
    budget = Counting()
    loop = SelectLoop(budget=budget)
    end = monotonic_ns() + 20 * NS_PER_MS

    def busy() -> None:
        if monotonic_ns() < end:
            loop.call_soon(busy)
        else:
            loop.stop()

    loop.call_soon(busy)
    run(loop)
    loop.close()
    assert budget.total >= 0.06 * 20 * NS_PER_MS


@pytest.mark.parametrize("sleeps", [True, False])
def test_a_descriptor_closed_without_being_removed_is_reported_and_dropped(
    loop: SelectLoop, failures: Failures, pair: tuple[socket.socket, socket.socket], sleeps: bool
) -> None:
    near, far = pair
    got: list[bytes] = []

    def readable() -> None:
        got.append(near.recv(9))
        loop.stop()

    loop.call_soon(loop.stop)
    run(loop)  # its own descriptors are there: the number that is closed here is not used again
    closed, other = os.pipe()
    loop.add_reader(closed, lambda: pytest.fail("it is closed"))
    loop.add_reader(near.fileno(), readable)
    os.close(closed)
    os.close(other)
    if not sleeps:
        loop.call_soon(lambda: loop.call_soon(lambda: None))
    loop.call_at(monotonic_ns() + NS_PER_MS, lambda: far.send(b"x"))
    run(loop)
    assert got == [b"x"]
    assert [message for message, _ in failures] == [f"descriptor {closed} was closed without being removed"]


def test_misuse_raises_at_once(loop: SelectLoop) -> None:
    raised: list[str] = []

    def nested() -> None:
        for wrong in (loop.run, loop.close):
            with pytest.raises(UsageError) as info:
                wrong()
            raised.append(str(info.value))
        loop.stop()

    loop.call_soon(nested)
    run(loop)
    assert raised == ["the loop is running already", "the loop is running: stop it first"]
    loop.close()
    assert loop.is_closed()
    with pytest.raises(UsageError, match="closed"):
        loop.run()


def test_a_descriptor_beyond_the_limit_of_select(loop: SelectLoop, pair: tuple[socket.socket, socket.socket]) -> None:
    near, far = pair
    high = fcntl.fcntl(near.fileno(), fcntl.F_DUPFD, 1024)
    got: list[bytes] = []

    def readable() -> None:
        got.append(os.read(high, 10))
        loop.stop()

    try:
        loop.add_reader(high, readable)
        rung: list[int] = []
        due = monotonic_ns() + 2 * NS_PER_MS + 500_000

        def ring() -> None:
            rung.append(monotonic_ns())
            far.send(b"x")

        loop.call_at(due, ring)
        run(loop)
        assert got == [b"x"]
        assert rung[0] >= due
        loop.remove_reader(high)
    finally:
        os.close(high)
