"""What every real-time driver does, however it waits: step the machine, follow the port, tell what happened.

The way from an answer to the next request is: the loop calls the port's reader, which reads and calls
:meth:`Stepping._step`; that pumps the machine, spins to the end of the idle time when it is near, and writes.
Everything that can wait (events, arming the timer) comes after the write.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from time import monotonic_ns
from typing import Final

from dpstack.drivers.line.answer_timing import Answers
from dpstack.drivers.line.echo import Echo, EchoFilter
from dpstack.drivers.line.port_latency import Lateness, Tune
from dpstack.drivers.line.rate import BACKOFF_NS, Attempts, NoRateError, follow, wire_times
from dpstack.drivers.line.timers import Timer, boottime_ns, suspended_ns
from dpstack.drivers.runtime import OnEvents, OnFailure, PortBack, PortLost
from dpstack.errors import BusError, DpError, PortError, UsageError
from dpstack.machine import HeldUp, LineDown, LineUp, Machine, pump
from dpstack.ports import Loop, Pending, Port
from dpstack.text import printable
from dpstack.trace import Event, Notice, Severity
from dpstack.units import NEVER, NS_PER_MS, NS_PER_US, ms_text

#: Waits shorter than this are spun: a timer would be later (measured 40 us).
SPIN_NS: Final = 20 * NS_PER_US
#: A deadline missed by more than this is judged only after the port was read again.
_LATE_NS: Final = 30 * NS_PER_US
#: A machine that is run later than this is told. No slave's watchdog is shorter.
_HELD_UP_NS: Final = 10 * NS_PER_MS
#: A line that is never silent is not looked at more often before a deadline is judged.
_LOOKS: Final = 4
#: Steps without giving the loop a turn; a lone master's token at 12 Mbit/s is due every few microseconds.
_BURST: Final = 8

_LONGEST: Final = 256

#: Takes what a machine is told when it was not run in time, and the time. True: what it has handed out to be sent, and
#: is not sent yet, is too old by it.
OnHeldUp = Callable[[HeldUp, int], bool]


def _filter(echo: Echo) -> EchoFilter | None:
    return None if echo is Echo.OFF else EchoFilter(echo)


class Stepping(ABC):
    """Keeps ``machine`` running on ``port``, with a loop that a subclass knows.

    Events of the machine and of the driver go to ``on_events``. The port follows the rate that the machine wants. A
    port that vanishes is an event and is opened again with back-off. When the machine raises, which it never should,
    the driver stops, tells ``on_failure`` (without one: the loop's exception handler) and keeps the exception in
    ``failed``. ``echo``: whether the line returns what is sent. ``held_up`` is told when the machine was run late, or
    the computer slept, before the machine does anything.
    """

    #: for people: why a machine is run late
    blocked_by = "the process was stopped, or had no processor"

    def __init__(
        self,
        port: Port,
        machine: Machine,
        on_events: OnEvents,
        *,
        echo: Echo = Echo.AUTO,
        on_failure: OnFailure | None = None,
        tune: Tune | None = None,
        held_up: OnHeldUp | None = None,
        spin_ns: int = SPIN_NS,
        backoff_ns: tuple[int, int] = BACKOFF_NS,
    ) -> None:
        self.failed: Exception | None = None
        #: how late answers arrive; with ``tune`` the machine's patience follows from it
        self.lateness = Lateness(tune)
        self._port = port
        self._machine = machine
        self._on_events = on_events
        self._on_failure = on_failure
        self._held_up = held_up
        self._stepped_at = 0  # the last step was over
        self._suspended_ns = 0  # so long the computer has slept, as far as the machine knows
        self._spin_ns = spin_ns
        self._early_ns = spin_ns  # so much before a deadline the timer shall call: the rest is spun
        self._backoff_ns = backoff_ns
        self._attempts: Attempts | None = None  # while the port is lost
        self._echo_wanted = echo
        self._echo = _filter(echo)
        self._at: Loop | None = None  # where it runs; set while running
        self._timer: Timer | None = None
        self._armed = NEVER  # the deadline the timer waits for: never later than _deadline
        self._deadline = NEVER
        self._answers = Answers()
        self._tolerated: set[str] = set()  # what the port cannot do: told once, however often it is opened
        self._again: Pending | None = None
        self._wire_ns = wire_times(port)
        self._flood_from = 1  # discarded octets from which on the owner is told again
        self._transmit = self._put  # bound once

    @property
    def port_name(self) -> str:
        """What the port is called (a pty made here: the path of its other end, once it is open)."""
        return self._port.name

    @property
    def paced(self) -> bool:
        """True where octets take their time on a wire."""
        return self._port.paced

    def damage(self) -> dict[str, int]:
        """Octets that arrived damaged, by cause, as far as the port can tell."""
        return self._port.damage()

    @property
    def echo(self) -> Echo:
        """Whether the line returns what is sent, as far as is known."""
        return Echo.OFF if self._echo is None else self._echo.state

    # --- what a subclass knows ----------------------------------------------------------------------------------------

    @abstractmethod
    def _report(self, message: str, error: Exception) -> None:
        """A defect that nobody was told of: say it as the loop says such things."""

    @abstractmethod
    def _expect(self, at: int, quiet_until: int) -> None:
        """A telegram went out; its answer should be whole at ``at`` (ns, NEVER: nobody knows), and what arrives before
        ``quiet_until`` need not wake the loop up (0: all shall)."""

    @abstractmethod
    def _waited(self, spun_ns: int, now: int) -> None:
        """So long was spun within a step that is over."""

    @abstractmethod
    def _begin_reopening(self, attempts: Attempts) -> None:
        """The port is lost: :meth:`_refused` or :meth:`_back` after each of the attempts."""

    # --- opening and closing ------------------------------------------------------------------------------------------

    def _may_open(self) -> None:
        """Raises UsageError or BusError when it may not be opened (any more)."""
        if self._at is not None:
            raise UsageError("the driver is open already")
        if self.failed is not None:
            raise BusError("the driver was stopped by a defect, make a new one") from self.failed

    def _begin(self, loop: Loop, timer: Timer) -> None:
        """The port has just been opened: run in ``loop``. Raises as open() does; the port is closed then."""
        try:
            if self._machine.baud != self._port.baud:
                self._port.set_baud(self._port.baud)  # one that cannot change its rate says so
                follow(self._port, self._machine)
                self._wire_ns = wire_times(self._port)
        except DpError:
            timer.close()
            self._port.close()
            raise
        self._at = loop
        self._timer = timer
        self._suspended_ns = suspended_ns()
        self._stepped_at = monotonic_ns()
        self._attach()
        self._step(b"")

    def _end(self, was_open: bool) -> None:
        """After :meth:`_halt`: release the port, tell what the machine still had to tell."""
        self._port.close()
        if was_open and self.failed is None:
            self._tell(self._machine.take_events())

    def forsake(self) -> None:
        """In the child of a fork: no more steps; line, timer and loop stay the parent's."""
        self._port.forsake()
        self._halt()

    def command(self, command: object) -> None:
        """Hand an order to the machine and let it act at once. What it raises is the caller's."""
        if self.failed is not None:
            raise BusError("the driver was stopped by a defect") from self.failed
        if self._at is None:
            raise UsageError("the driver is not open: open() comes first")
        self._machine.command(command, monotonic_ns())
        # as with a late timer: what arrived while the loop was held up counts before a deadline is judged
        self._step(self._drain())

    def now(self) -> int:
        """CLOCK_MONOTONIC in ns."""
        return monotonic_ns()

    # --- the lean path ------------------------------------------------------------------------------------------------

    def _step(self, chunk: bytes) -> None:
        """Pump until nothing is due within the spin time, then tell events and arm the timer."""
        machine, transmit, spin_ns = self._machine, self._transmit, self._spin_ns
        steps = _BURST
        heard, sent_at, spun = 0, 0, 0
        try:
            now = monotonic_ns()
            # one look at the clock of sleep a step: nothing old may go out after it
            if self._held_up is not None and (
                boottime_ns() - now - self._suspended_ns >= _HELD_UP_NS or now - self._deadline >= _HELD_UP_NS
            ):
                self._tell_held_up(self._held_up, now)
            if now >= self._deadline:
                chunk, now = self._look(chunk, now)
            arrived = now
            if chunk:
                heard = self._answers.heard(len(chunk), now)
                if heard:
                    sent_at, self.lateness.sent_at = self.lateness.sent_at, 0
            while True:
                deadline = pump(machine, chunk, now, transmit)
                began, now = now, monotonic_ns()
                if now - began >= _HELD_UP_NS and self._held_up is not None:
                    self._held_up(self._late(now - began), now)
                    deadline = machine.wake_at()
                if deadline - now > spin_ns:
                    break
                steps -= 1
                if not steps:
                    self._let_loop_turn()
                    break
                if now < deadline:
                    spun += deadline - now
                    while now < deadline:
                        now = monotonic_ns()
                chunk, now = self._look(b"", now) if now - deadline > _LATE_NS else (b"", now)
            if machine.baud != self._port.baud and self._attempts is None:
                follow(self._port, machine)
                self._wire_ns = wire_times(self._port)
                deadline = machine.wake_at()
            self._deadline = deadline
            self._stepped_at = now
            if sent_at:
                self.lateness.heard(sent_at, self._wire_ns[min(heard, _LONGEST - 1)], arrived)
            events = machine.take_events()
        except NoRateError as exc:
            self._lost(str(exc))
            return
        except Exception as exc:
            self._fail(exc)
            return
        except BaseException:  # Ctrl-C, wherever it came: where the loop runs on, so does the bus
            self._let_loop_turn()
            raise
        if deadline < self._armed:
            self._arm(deadline)
        if spun:
            self._waited(spun, now)
        if events:
            self._tell(events)

    def _tell_held_up(self, tell: OnHeldUp, now: int) -> None:
        """Tell the machine before it acts that it was not run in time, or that the computer slept."""
        asleep = suspended_ns() - self._suspended_ns
        if asleep >= _HELD_UP_NS:
            self._suspended_ns += asleep
            tell(HeldUp(asleep, f"the computer was suspended for {ms_text(asleep)}", suspended=True), now)
        late = now - max(self._deadline, self._stepped_at)
        if late >= _HELD_UP_NS:
            tell(self._late(late), now)

    def _late(self, late_ns: int) -> HeldUp:
        return HeldUp(late_ns, f"{self.blocked_by} for {ms_text(late_ns)}")

    def _put(self, octets: bytes, now: int) -> int:
        """Transmit: the return value is when the last bit leaves, as well as can be known."""
        if self._held_up is not None:
            before = monotonic_ns()
            if before - now >= _HELD_UP_NS and self._held_up(self._late(before - now), before):
                return before + self._wire_ns[len(octets)]  # as if it had been lost on the line
        if self._echo is not None:
            self._echo.sent(octets)
        if not self._port.write(octets):
            self._dropped()
        end = self.lateness.sent_at = monotonic_ns() + self._wire_ns[len(octets)]
        answers = self._answers
        self._expect(answers.sent(octets, end), answers.quiet_until)
        return end

    def _arm(self, deadline: int) -> None:
        """Wait for ``deadline``; a later one is looked at when this one is reached, which saves most of the arming."""
        if self._timer is not None:
            self._armed = deadline
            # A timer is late by more than the spin time: the rest is spun.
            self._timer.set(deadline - self._early_ns)

    def _timer_due(self) -> None:
        self._armed = NEVER  # before the step: whatever it leads to may arm afresh
        deadline = self._deadline
        now = monotonic_ns()
        if deadline - now > self._early_ns:
            if deadline != NEVER:
                self._arm(deadline)
            return
        while now < deadline:
            now = monotonic_ns()
        echo, chunk = self._echo, b""
        if echo is not None:  # a deadline is due: the rest of what is held does not come
            chunk = self._drain()
            chunk = echo.release() + chunk
        self._step(chunk)

    def _look(self, chunk: bytes, now: int) -> tuple[bytes, int]:
        """A deadline has passed at ``now``: ``chunk`` with what arrived since it was read, and the time to judge at.

        Timers fire late, and a process can be held up anywhere, also between reading the line and reading the clock,
        and for longer than a slot time. So the clock is read first: up to the time that counts nothing was missed.
        """
        discarded = self._port.discarded
        for _ in range(_LOOKS):
            more = self._drain()
            if not more:
                break
            chunk += more
            now = monotonic_ns()  # the idle time after these octets counts from here
            if self._port.discarded != discarded:  # a line that is never silent and faster than we are
                break
        return chunk, now

    def _drain(self) -> bytes:
        octets = self._port.read_now()
        if self._port.discarded >= self._flood_from:
            self._tell_flood()
        return octets if self._echo is None else self._stripped(self._echo, octets)

    def _let_loop_turn(self) -> None:
        if self._at is not None and self._again is None:
            self._again = self._at.call_soon(self._go_on)

    def _go_on(self) -> None:
        self._again = None
        self._step(self._drain())

    # --- echo ---------------------------------------------------------------------------------------------------------

    def _attach(self) -> None:
        """Take what the port delivers, through the echo filter unless there is no echo."""
        if self._at is None:
            return
        self._echo = _filter(self._echo_wanted)
        self._expect(NEVER, 0)
        self._port.attach(self._at, self._step if self._echo is None else self._filtered, self._lost)
        news = [text for text in self._port.notices if text not in self._tolerated]
        self._tolerated.update(news)
        self._tell([self._notice(text) for text in news])

    def _filtered(self, chunk: bytes) -> None:
        echo = self._echo
        if echo is None or self._at is None:
            return
        self._step(self._stripped(echo, chunk))

    def _stripped(self, echo: EchoFilter, chunk: bytes) -> bytes:
        """``chunk`` without echo; what the line turns out to be takes effect here, whoever has read the port."""
        before = echo.state
        rest = echo.strip(chunk)
        if echo.state is not before:
            if echo.state is Echo.ON:
                self._tell([self._notice("the line echoes what is sent: the echo is removed")])
            else:
                self._echo = None
                if self._at is not None:
                    self._port.attach(self._at, self._step, self._lost)
        return rest

    # --- loss, defects, events ----------------------------------------------------------------------------------------

    def _lost(self, reason: str) -> None:
        """The port vanished: an event, and attempts to open it again."""
        if self._at is None:
            return
        self._port.close()
        self._attempts = Attempts(self._backoff_ns)
        self._tell([PortLost(t_ns=monotonic_ns(), port=self.port_name, reason=reason)])
        self._order(LineDown(reason))
        if self._at is not None:
            self._begin_reopening(self._attempts)

    def _refused(self, attempts: Attempts, refusal: PortError) -> None:
        """The lost port could not be opened."""
        if attempts.is_news(str(refusal)):
            self._tell([self._notice(f"still without its port: {refusal}", Severity.WARNING)])

    def _back(self, attempts: Attempts) -> None:
        """The lost port is open again; closed at once where nobody wants it any more."""
        if self._at is None:
            self._port.close()
        if attempts is not self._attempts:
            return
        self._attempts = None
        self._tell([PortBack(t_ns=monotonic_ns(), port=self.port_name)])
        self._attach()
        self._order(LineUp())

    def _order(self, command: object) -> None:
        """An order of the driver's own."""
        if self._at is None:
            return
        try:
            self._machine.command(command, monotonic_ns())
        except Exception as exc:
            self._fail(exc)
            return
        self._step(b"")

    def _dropped(self) -> None:
        """A telegram was not sent: told at the first, the tenth, the hundredth ..."""
        count = self._port.dropped
        if self._at is not None and self._attempts is None and str(count).strip("0") == "1":
            text = f"{count} telegrams dropped: the line takes no more, is anybody reading at the other end?"
            self._at.call_soon(partial(self._tell, [self._notice(text, Severity.WARNING)]))

    def _tell_flood(self) -> None:
        """Octets were thrown away unread: told at the first ones, then whenever there are ten times as many."""
        count = self._port.discarded
        self._flood_from = 10 * count
        if self._at is not None:
            text = (
                f"the line brings octets faster than this computer can look at them, {count} were thrown away: "
                f"is a station sending without end?"
            )
            self._at.call_soon(partial(self._tell, [self._notice(text, Severity.WARNING)]))

    def _notice(self, text: str, severity: Severity = Severity.INFO) -> Event:
        return Notice(t_ns=monotonic_ns(), source=self.port_name, message=text, severity=severity)

    def _tell(self, events: list[Event]) -> None:
        """Hand over events; an owner whose handler raises is told by the loop, and the bus goes on."""
        if not events:
            return
        try:
            self._on_events(events)
        except Exception as exc:
            self._report("the handler of bus events raised", exc)

    def _fail(self, exc: Exception) -> None:
        """The machine raised: stop, tell the owner."""
        if self._at is None:
            raise exc
        self.failed = exc
        self._halt()
        self._port.close()
        text = f"stopped by a defect, please report it: {type(exc).__name__}: {exc}"
        self._tell([self._notice(text, Severity.ERROR)])
        if self._on_failure is not None:
            self._on_failure(exc)
        else:
            self._report(printable(f"{self.port_name}: {text}"), exc)

    def _halt(self) -> None:
        """No more steps."""
        self._at = None
        self._attempts = None
        self._armed = self._deadline = NEVER
        self._port.detach()
        if self._again is not None:
            self._again.cancel()
            self._again = None
        if self._timer is not None:
            self._timer.close()
            self._timer = None
