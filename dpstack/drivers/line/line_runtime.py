"""Common part of the real-time drivers: steps the protocol machine, follows its baud rate, dispatches its events.

Subclasses differ only in how they wait. From an answer to the next request: the loop calls the port's reader, which
reads and calls :meth:`LineRuntime._step`. That pumps the machine, waits for the end of the idle time when it is near,
and writes. Events and the timer follow after the write.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from time import monotonic_ns
from typing import Final

from dpstack.boottime import boottime_ns, suspended_ns
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState, SlaveStateChanged
from dpstack.drivers.line.answer_timing import AnswerTiming
from dpstack.drivers.line.echo import Echo, EchoFilter
from dpstack.drivers.line.last_clear import LastClear
from dpstack.drivers.line.port_latency import PortLatency, Tune
from dpstack.drivers.line.port_watch import PortWatch
from dpstack.drivers.line.rate import BACKOFF_NS, LONGEST, NoRateError, ReopenAttempts, follow, wire_times
from dpstack.drivers.line.timers import Lead, Timer
from dpstack.drivers.runtime import RESERVE, OnEvents, OnFailure, PortBack, PortDisturbed, PortLost, stopped_by
from dpstack.drivers.tap import Tap, TappedMachine
from dpstack.errors import BusError, DpError, PortError, UsageError
from dpstack.fdl.events import AddressCollision, RingLeft
from dpstack.machine import HeldUp, InDoubt, LineDown, LineUp, Machine, Pumped, pump
from dpstack.ports import Loop, Pending, Port
from dpstack.text import printable
from dpstack.trace import Event, Notice, Severity
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S, NS_PER_US, ms_text

#: The driver waits that long within a step: a turn of the loop costs 8 us more in the bus process, 40 us and seven
#: system calls in asyncio. T_ID1 at 500 kbit/s is 74 us. Shorter than any slot time.
STEP_WAIT_NS: Final = 75 * NS_PER_US
#: The timer is set this much before a deadline, the rest is spun (a timerfd is 20 to 40 us late).
_EARLY_NS: Final = 20 * NS_PER_US
#: Within a step the driver naps and spins the rest. A nap takes as much processor time as it is late (16 us in a
#: virtual machine, 25 us less than spinning through T_ID1 at 500 kbit/s); a shorter one saves nothing.
_SHORTEST_NAP_NS: Final = 10 * NS_PER_US
#: A nap ends this much before the deadline: first value, minimum, maximum, the step down. Nine of ten are less late.
_NAP_LEAD_NS: Final = 20 * NS_PER_US
_LEAST_NAP_LEAD_NS: Final = 5 * NS_PER_US
_MOST_NAP_LEAD_NS: Final = 80 * NS_PER_US
_NAP_LEAD_STEP_NS: Final = NS_PER_US // 4
#: Spinning within steps is counted when it is this much.
_COUNTED_NS: Final = 100 * NS_PER_US
#: The beginning of an expected answer is kept for this long: longer than a wake-up is late, and than one takes that is
#: set too early.
_REST_NS: Final = 150 * NS_PER_US
#: After a deadline missed by more than this the port is read again before the machine acts on the deadline.
_LATE_NS: Final = 30 * NS_PER_US
#: The driver reports to the machine that it ran later than this. No slave's watchdog is shorter.
_HELD_UP_NS: Final = 10 * NS_PER_MS
#: The same disturbance of the port is reported again after this time.
_SAME_AGAIN_NS: Final = 60 * NS_PER_S
#: Number of reads of a line that is never silent before the machine acts on a missed deadline.
_LOOKS: Final = 4
#: Steps before the loop has a turn; a lone master's token at 12 Mbit/s is due every few microseconds.
_BURST: Final = 8

#: see :attr:`Machine.held_up`
OnHeldUp = Callable[[HeldUp, int], bool]


def _filter(echo: Echo) -> EchoFilter | None:
    return None if echo is Echo.OFF else EchoFilter(echo)


class LineRuntime(ABC):
    """Keeps ``machine`` running on ``port`` in the loop of a subclass.

    Events of the machine and of the driver go to ``on_events``. The port follows the baud rate of the machine. The loss
    of the port is an event; the driver opens it again with back-off (``backoff_ns``: first and longest pause). An
    exception of the machine is a defect, or there is no memory: the driver sends ``last_clear``, stops, calls
    ``on_failure`` (without one: the loop's exception handler) and keeps the exception in ``failed``. ``echo``: whether
    the line returns transmitted octets.
    """

    #: reason for a late run, for messages
    blocked_by = "the process was stopped, or had no processor"
    #: the timer is set this much before a deadline, the rest is spun
    early_ns = _EARLY_NS

    def __init__(
        self,
        port: Port,
        machine: Machine,
        on_events: OnEvents,
        *,
        echo: Echo = Echo.AUTO,
        on_failure: OnFailure | None = None,
        tune: Tune | None = None,
        last_clear: LastClear | None = None,
        backoff_ns: tuple[int, int] = BACKOFF_NS,
    ) -> None:
        self.failed: Exception | None = None
        #: lateness of answers; with ``tune`` the machine's patience follows from it
        self.lateness = PortLatency(tune)
        self._port = port
        self._machine = machine
        self._on_events = on_events
        self._on_failure = on_failure
        self._held_up = machine.held_up
        self._last_clear = last_clear
        self._watch = PortWatch(port, self._disturbed)
        self._disturbances: dict[str, int] = {}  # by text, the time of its last report
        port.on_doubt = None if machine.held_up is None else self._in_doubt  # others have no inputs
        self._reserve: object = None
        self._stepped_at = 0  # end of the last step
        self._suspended_ns = 0  # sleep of the computer that was reported to the machine
        self._step_wait_ns, self._early_ns = STEP_WAIT_NS, self.early_ns
        self._nap_lead = Lead(
            _NAP_LEAD_NS,
            least=_LEAST_NAP_LEAD_NS,
            most=_MOST_NAP_LEAD_NS,
            raised=9 * _NAP_LEAD_STEP_NS,
            lowered=_NAP_LEAD_STEP_NS,
        )
        self._backoff_ns = backoff_ns
        self._attempts: ReopenAttempts | None = None  # while the port is lost
        self._echo_wanted = echo
        self._echo = _filter(echo)
        self._at: Loop | None = None  # the loop; set while running
        self._timer: Timer | None = None
        self._armed = NEVER  # the deadline the timer waits for: never later than _deadline
        self._deadline = NEVER
        self._answers = AnswerTiming()
        self._kept = b""  # the beginning of an expected answer, until its rest is read
        self._spun_ns = 0  # not yet counted
        self._tolerated: set[str] = set()  # notices of the port that were reported, once for all openings
        self._pending_step: Pending | None = None
        self._later: list[Callable[[], object]] = []
        self._wire_ns = wire_times(port)
        self._flood_from = 1  # number of discarded octets from which on the next one is looked at
        self._flood_notice = 1  # and from which on the next notice is due
        self._transmit = self._write  # bound once, for speed
        self._refused_at = 0  # first of the writes that the port has refused, all since the last that it took
        self._tap: Tap | None = None
        self._pumped: Pumped = machine  # the machine, or what copies received octets into the tap
        self._put: Callable[[bytes], bool] = port.write  # or what copies sent octets, too

    @property
    def pid(self) -> int | None:
        return None

    @property
    def port_name(self) -> str:
        """Name of the port (of a pty made here: the path of its other end, once it is open)."""
        return self._port.name

    @property
    def paced(self) -> bool:
        """True if octets take their time on a wire."""
        return self._port.paced

    @property
    def mode_before_silence(self) -> Mode | None:
        return None

    @property
    def cleared(self) -> bool:
        """The machine failed, and Clear was sent without it."""
        return self._last_clear is not None and self._last_clear.was_sent

    def damage(self) -> dict[str, int]:
        """Number of damaged octets by cause, as far as the port counts them."""
        return self._port.damage()

    def tap(self, tap: Tap | None) -> None:
        """Copy all octets received and sent into ``tap`` from now on; None ends it. At any time, also while closed."""
        self._tap = tap
        if tap is None:
            self._pumped, self._put = self._machine, self._port.write
            self._flood_from = self._flood_notice
        else:
            self._pumped, self._put = TappedMachine(self._machine, self._port, tap), self._put_and_copy
            self._flood_from = self._port.discarded + 1  # octets thrown away unread are a gap

    def _put_and_copy(self, octets: bytes) -> bool:
        """Write to the port; octets that it took go into the tap."""
        port, tap = self._port, self._tap
        if not port.write(octets):
            return False
        if tap is not None:
            if len(tap.ring) < tap.capacity:
                tap.ring.append((monotonic_ns() + self._wire_ns[len(octets)], port.baud, octets, True))
            else:
                tap.lost += 1
        return True

    def after_step(self, callback: Callable[[], object]) -> None:
        """Call ``callback`` once at the end of the step under way, after its transmissions and events: for work that
        the next telegram need not wait for. Called by the machine's users from within a step."""
        self._later.append(callback)

    @property
    def echo(self) -> Echo:
        return Echo.OFF if self._echo is None else self._echo.state

    # --- for subclasses -----------------------------------------------------------------------------------------------

    @abstractmethod
    def _report(self, message: str, error: Exception) -> None:
        """Report a defect in the way of the loop."""

    @abstractmethod
    def _expect(self, at: int, sleep_until: int) -> None:
        """Prepare for the answer to a transmission: it should be complete at ``at`` (ns, NEVER: unknown). Octets before
        ``sleep_until`` need not wake up the loop (0: all octets wake it up)."""

    @abstractmethod
    def _count_spinning(self, spun_ns: int, now: int) -> None:
        """A step has spun for ``spun_ns`` in all."""

    @abstractmethod
    def _begin_reopening(self, attempts: ReopenAttempts) -> None:
        """The port is lost: try to open it; after each attempt call :meth:`_reopening_refused` or :meth:`_reopened`."""

    # --- opening and closing ------------------------------------------------------------------------------------------

    def _check_openable(self) -> None:
        """Raises UsageError, BusError."""
        if self._at is not None:
            raise UsageError("the driver is open already")
        if self.failed is not None:
            raise BusError("the driver was stopped by a defect, make a new one") from self.failed

    def _begin(self, loop: Loop, timer: Timer) -> None:
        """Run in ``loop`` on the port just opened. Raises as open() does; the port is closed then."""
        try:
            if self._machine.baud != self._port.baud:
                self._port.set_baud(self._port.baud)  # raises if the port cannot change its rate
                follow(self._port, self._machine)
                self._wire_ns = wire_times(self._port)
        except DpError:
            timer.close()
            self._port.close()
            raise
        self._at = loop
        self._timer = timer
        self._reserve = self._make_reserve()
        self._suspended_ns = suspended_ns()
        self._stepped_at = monotonic_ns()
        self._attach()
        self._step(b"")

    def _make_reserve(self) -> object:
        """Memory for the end of the bus, see :data:`~dpstack.drivers.runtime.RESERVE`."""
        return bytearray(RESERVE)

    def _end(self, was_open: bool) -> None:
        """After :meth:`_halt`: release the port, dispatch the machine's last events."""
        self._port.close()
        if was_open and self.failed is None:
            self._dispatch(self._machine.take_events())

    def release_after_fork(self) -> None:
        """In the child of a fork: stop, without effect on line, timer and loop of the parent."""
        self._port.release_after_fork()
        self._halt()

    def command(self, command: object) -> None:
        """Hand an order to the machine and let it act at once. Exceptions of the machine reach the caller."""
        if self.failed is not None:
            raise BusError("the driver was stopped by a defect") from self.failed
        if self._at is None:
            raise UsageError("the driver is not open: open() comes first")
        self._machine.command(command, monotonic_ns())
        # as after a late timer: octets that arrived while the loop was blocked count before a deadline
        self._step(self._drain())

    def now(self) -> int:
        """CLOCK_MONOTONIC in ns."""
        return monotonic_ns()

    # --- the lean path ------------------------------------------------------------------------------------------------

    def _step(self, chunk: bytes) -> None:
        """Pump until nothing is due soon, then arm the timer and dispatch events."""
        machine, pumped, transmit, wait_ns = self._machine, self._pumped, self._transmit, self._step_wait_ns
        steps = _BURST
        count, sent_at, spun = 0, 0, self._spun_ns
        try:
            now = monotonic_ns()
            # one reading of the sleep clock a step: no old telegram may go out after a sleep
            if self._held_up is not None and (
                boottime_ns() - now - self._suspended_ns >= _HELD_UP_NS or now - self._deadline >= _HELD_UP_NS
            ):
                self._report_late_run(self._held_up, now)
            if now >= self._deadline:
                chunk, now = self._read_before_deadline(chunk, now)
            arrived = now
            if chunk:
                if self._kept:
                    chunk, self._kept = self._kept + chunk, b""
                count = self._answers.received(chunk, now)
                if count > 0:
                    sent_at, self.lateness.sent_at = self.lateness.sent_at, 0
                elif count and now < self._deadline:
                    self._keep(chunk)
                    return
            while True:
                deadline = pump(pumped, chunk, now, transmit)
                began, now = now, monotonic_ns()
                if now - began >= _HELD_UP_NS and self._held_up is not None:
                    self._held_up(self._late(now - began), now)
                    deadline = machine.wake_at()
                if deadline - now > wait_ns:
                    break
                steps -= 1
                if not steps:
                    self._let_loop_turn()
                    break
                if now < deadline:
                    spinning = self._nap(deadline, now)
                    while now < deadline:
                        now = monotonic_ns()
                    spun += now - spinning
                chunk = b""
                if now - deadline > _LATE_NS:
                    if now - deadline >= _HELD_UP_NS and self._held_up is not None:  # it was stopped while it spun
                        self._held_up(self._late(now - deadline), now)
                    chunk, now = self._read_before_deadline(b"", now)
            if machine.baud != self._port.baud and self._attempts is None:
                follow(self._port, machine)
                self._wire_ns = wire_times(self._port)
                deadline = machine.wake_at()
            self._deadline = deadline
            self._stepped_at = now
            if sent_at:
                self.lateness.add_answer(sent_at, self._wire_ns[min(count, LONGEST - 1)], arrived)
            events = machine.take_events()
            if deadline < self._armed:
                self._arm(deadline)
            if spun > _COUNTED_NS:
                self._count_spinning(spun, now)
                spun = 0
            self._spun_ns = spun
        except NoRateError as exc:
            self._lost(str(exc))
            return
        except Exception as exc:
            self._fail(exc)
            return
        except BaseException:  # Ctrl-C at any place: the bus runs on as long as the loop runs
            self._let_loop_turn()
            raise
        if events:
            if self._echo is None and self._echo_wanted is Echo.AUTO:
                self._suspect_echo(events)
            self._dispatch(events)
            self._look_at_port(events)
        if self._later:
            self._do_later()

    def _keep(self, chunk: bytes) -> None:
        """Keep the beginning of an answer until the rest is read, but not for longer than :data:`_REST_NS`."""
        self._kept = chunk
        until = monotonic_ns() + _REST_NS
        if until < self._armed:
            self._arm(until)

    def _do_later(self) -> None:
        later, self._later = self._later, []
        try:
            for callback in later:
                callback()
        except Exception as exc:
            self._fail(exc)

    def _nap(self, deadline: int, now: int) -> int:
        """Sleep up to shortly before ``deadline`` if that pays. Returns the time."""
        lead = self._nap_lead
        end = deadline - lead.ns
        if end - now < _SHORTEST_NAP_NS or self._timer is None:
            if deadline - now >= _SHORTEST_NAP_NS + _LEAST_NAP_LEAD_NS:
                lead.learn(0)  # it was too late for a nap: perhaps it is no longer
            return now
        self._timer.nap(end)
        now = monotonic_ns()
        lead.learn(now - end)
        return now

    def _report_late_run(self, tell: OnHeldUp, now: int) -> None:
        """Report to the machine, before it acts, that it did not run in time or that the computer slept."""
        self._report_sleep(tell, now)
        late = now - max(self._deadline, self._stepped_at)
        if late >= _HELD_UP_NS:
            tell(self._late(late), now)

    def _report_sleep(self, tell: OnHeldUp, now: int) -> bool:
        """Report to the machine that the computer slept, if it did. True: a telegram is too old now."""
        asleep = suspended_ns() - self._suspended_ns
        if asleep < _HELD_UP_NS:
            return False
        self._suspended_ns += asleep
        return tell(HeldUp(asleep, f"the computer was suspended for {ms_text(asleep)}", suspended=True), now)

    def _is_outdated(self, tell: OnHeldUp, taken_at: int) -> bool:
        """Whether the telegram handed out at ``taken_at`` is too old by a stop or a sleep since then."""
        now = monotonic_ns()
        outdated = self._report_sleep(tell, now)
        if now - taken_at >= _HELD_UP_NS:
            outdated |= tell(self._late(now - taken_at), now)
        return outdated

    def _late(self, late_ns: int) -> HeldUp:
        return HeldUp(late_ns, f"{self.blocked_by} for {ms_text(late_ns)}")

    def _write(self, octets: bytes, now: int) -> int:
        """Transmit. Returns the estimated time at which the last bit leaves."""
        # the sleep clock: the computer may have slept since the beginning of the step
        if (
            self._held_up is not None
            and boottime_ns() - self._suspended_ns - now >= _HELD_UP_NS
            and self._is_outdated(self._held_up, now)
        ):
            return monotonic_ns() + self._wire_ns[len(octets)]  # as if it had been lost on the line
        if self._echo is not None:
            self._echo.sent(octets)
        if not self._put(octets):
            self._dropped(now)
        written = monotonic_ns()
        end = self.lateness.sent_at = written + self._wire_ns[len(octets)]
        answers = self._answers
        self._expect(answers.sent(octets, written, end), answers.sleep_until)
        return end

    def _write_after_refusal(self, octets: bytes, now: int) -> int:
        """:meth:`_write` after a write that the port refused: nobody was asked since then."""
        refused_ns = now - self._refused_at
        if self._held_up is not None and refused_ns >= _HELD_UP_NS:
            what = f"the port took no octets for {ms_text(refused_ns)}"
            if self._held_up(HeldUp(refused_ns, what, unsent=True), now):
                return now + self._wire_ns[len(octets)]  # too old: as if it had been lost on the line
        dropped = self._port.dropped
        end = self._write(octets, now)
        if self._port.dropped == dropped:
            self._transmit = self._write
        return end

    def _arm(self, deadline: int) -> None:
        """Set the timer to ``deadline``. A later deadline is armed when this one has been reached: few calls."""
        if self._timer is not None:
            self._armed = deadline
            self._timer.set(deadline - self._early_ns)

    def _timer_due(self) -> None:
        self._armed = NEVER  # before the step, which may arm it again
        try:
            deadline = self._deadline
            now = monotonic_ns()
            if deadline - now > self._early_ns:
                if self._kept:  # the rest does not come in time
                    kept, self._kept = self._kept, b""
                    self._step(kept + self._drain())
                elif deadline != NEVER:
                    self._arm(deadline)
                return
            while now < deadline:
                now = monotonic_ns()
            echo, chunk = self._echo, b""
            if echo is not None:  # a deadline is due: the rest of the held octets will not arrive
                chunk = self._drain()
                chunk = echo.release() + chunk
        except Exception as exc:  # above all MemoryError: the timer is not armed again
            self._fail(exc)
            return
        self._step(chunk)

    def _read_before_deadline(self, chunk: bytes, now: int) -> tuple[bytes, int]:
        """After a deadline has passed at ``now``: ``chunk`` with the octets that have arrived since, and the time that
        counts for the deadline.

        Timers fire late, and the process may lose the processor between reading the line and reading the clock, for
        longer than a slot time. So the clock is read before the line: no octet up to that time is missed.
        """
        chunk, self._kept = self._kept + chunk, b""
        discarded = self._port.discarded
        for _ in range(_LOOKS):
            more = self._drain()
            if not more:
                break
            chunk += more
            now = monotonic_ns()  # the idle time after these octets counts from here
            if self._port.discarded != discarded:  # a line that is never silent and faster than this computer
                break
        return chunk, now

    def _drain(self) -> bytes:
        octets = self._port.read_now()
        if self._port.discarded >= self._flood_from:
            self._report_flood()
        return octets if self._echo is None else self._stripped(self._echo, octets)

    def _let_loop_turn(self) -> None:
        if self._at is not None and self._pending_step is None:
            self._pending_step = self._at.call_soon(self._continue_step)

    def _continue_step(self) -> None:
        self._pending_step = None
        self._step(self._drain())

    # --- echo ---------------------------------------------------------------------------------------------------------

    def _attach(self) -> None:
        """Connect the port's reader, through the echo filter unless there is no echo."""
        if self._at is None:
            return
        self._echo = _filter(self._echo_wanted)
        self._kept = b""
        self._expect(NEVER, 0)
        self._port.attach(self._at, self._step if self._echo is None else self._filtered, self._lost)
        news = [text for text in self._port.notices if text not in self._tolerated]
        self._tolerated.update(news)
        self._dispatch([self._notice(text) for text in news])

    def _filtered(self, chunk: bytes) -> None:
        echo = self._echo
        if echo is None or self._at is None:
            return
        self._step(self._stripped(echo, chunk))

    def _stripped(self, echo: EchoFilter, chunk: bytes) -> bytes:
        """``chunk`` without echo; a newly detected state of the echo takes effect here."""
        before = echo.state
        rest = echo.strip(chunk)
        if echo.state is not before:
            if echo.state is Echo.ON:
                self._dispatch([self._notice("the line echoes what is sent: the echo is removed")])
            elif before is Echo.ON:
                self._dispatch([self._notice("the line no longer echoes what is sent")])
            else:
                self._echo = None
                if self._at is not None:
                    self._port.attach(self._at, self._step, self._lost)
        return rest

    def _suspect_echo(self, events: list[Event]) -> None:
        """Look for an echo again after a telegram with this station's address: the line may have begun to echo."""
        if self._at is not None and any(isinstance(event, AddressCollision | RingLeft) for event in events):
            self._echo = _filter(Echo.AUTO)
            self._port.attach(self._at, self._filtered, self._lost)

    # --- loss, defects, events ----------------------------------------------------------------------------------------

    def _lost(self, reason: str) -> None:
        """The port vanished: report it and begin to open it again."""
        if self._at is None:
            return
        self._port.close()
        self._kept = b""
        self._transmit = self._write  # the machine learns of the loss as such
        self._attempts = ReopenAttempts(self._backoff_ns)
        if self._tap is not None:
            self._tap.add((monotonic_ns(), 0, b"", False))
        self._dispatch([PortLost(t_ns=monotonic_ns(), port=self.port_name, reason=reason)])
        self._command_machine(LineDown(reason))
        if self._at is not None:
            self._begin_reopening(self._attempts)

    def _reopening_refused(self, attempts: ReopenAttempts, refusal: PortError) -> None:
        if attempts.is_new_reason(str(refusal)):
            self._dispatch([self._notice(f"still without its port: {refusal}", Severity.WARNING)])

    def _reopened(self, attempts: ReopenAttempts) -> None:
        """The lost port is open again; it is closed if the driver was closed meanwhile."""
        if self._at is None:
            self._port.close()
        if attempts is not self._attempts:
            return
        self._attempts = None
        if self._tap is not None:
            self._tap.add((monotonic_ns(), self._port.baud, b"", False))
        self._dispatch([PortBack(t_ns=monotonic_ns(), port=self.port_name)])
        self._attach()
        self._command_machine(LineUp())

    def _look_at_port(self, events: list[Event]) -> None:
        """If slaves fell silent, another program may have the port."""
        lost = any(isinstance(event, SlaveStateChanged) and event.state is SlaveState.OFFLINE for event in events)
        if lost and self._at is not None and self._attempts is None:
            self._watch.look(self._at)

    def _disturbed(self, found: list[str]) -> None:
        """Report each disturbance, the same one at most once a minute: a slave may be lost again and again."""
        now = monotonic_ns()
        lately = {text: at for text, at in self._disturbances.items() if now - at < _SAME_AGAIN_NS}
        news = [text for text in found if text not in lately]
        self._disturbances = lately | dict.fromkeys(news, now)
        if self._at is not None:
            self._dispatch([PortDisturbed(t_ns=now, port=self.port_name, what=text) for text in news])

    def _in_doubt(self, for_ns: int) -> None:
        """The port learns only now that octets it has delivered may be damaged: not in the middle of a step."""
        self._kept = b""  # as the octets that came with this news
        if self._at is not None:
            self._at.call_soon(partial(self._command_machine, InDoubt(for_ns)))

    def _command_machine(self, command: object) -> None:
        """An order of the driver's own."""
        if self._at is None:
            return
        try:
            self._machine.command(command, monotonic_ns())
        except Exception as exc:
            self._fail(exc)
            return
        self._step(b"")

    def _dropped(self, now: int) -> None:
        """A telegram was not sent: a notice at the first, the tenth, the hundredth ..."""
        if self._transmit == self._write:
            self._refused_at = now
            self._transmit = self._write_after_refusal
        count = self._port.dropped
        if self._attempts is None and str(count).strip("0") == "1":
            self._warn_soon(f"{count} telegrams dropped: the line takes no more, is anybody reading at the other end?")

    def _report_flood(self) -> None:
        """Octets were discarded unread: a notice at the first ones, then at ten times as many."""
        count = self._port.discarded
        if self._tap is not None:
            self._tap.lost += 1
            self._flood_from = count + 1
            if count < self._flood_notice:
                return
            self._flood_notice = 10 * count
        else:
            self._flood_from = self._flood_notice = 10 * count
        self._warn_soon(
            f"the line brings octets faster than this computer can look at them, {count} were thrown away: "
            f"is a station sending without end?"
        )

    def _warn_soon(self, text: str) -> None:
        """Report ``text`` in the next turn of the loop, not in the middle of a step."""
        if self._at is not None:
            self._at.call_soon(partial(self._dispatch, [self._notice(text, Severity.WARNING)]))

    def _notice(self, text: str, severity: Severity = Severity.INFO) -> Event:
        return Notice(t_ns=monotonic_ns(), source=self.port_name, message=text, severity=severity)

    def _dispatch(self, events: list[Event]) -> None:
        """Call the event handler; the loop reports its exceptions, and the bus goes on."""
        if not events:
            return
        clear = self._last_clear
        try:
            if clear is not None and self._at is not None and self._attempts is None:
                events = [clear.completed(event, self._port) for event in events]
            self._on_events(events)
        except Exception as exc:
            self._report("the handler of bus events raised", exc)

    def _fail(self, exc: Exception) -> None:
        """The machine raised, or there is no memory for it: send Clear, stop, and call the failure handler."""
        if self._at is None:
            raise exc
        self.failed = exc
        self._reserve = None
        clear = None if self._attempts is not None else self._last_clear
        text = ""
        try:
            self._halt()
            if clear is not None:
                clear.send(self._port)
        except Exception as error:
            if clear is not None:
                clear.why_not = f"{type(error).__name__}: {error}"
        finally:
            self._port.close()
            try:
                text = f"stopped by {stopped_by(exc)}{self._text_of_clear(clear)}"
                self._dispatch([self._notice(text, Severity.ERROR)])
            finally:
                if self._on_failure is not None:
                    self._on_failure(exc)
                else:
                    self._report(printable(f"{self.port_name}: {text}"), exc)

    def _text_of_clear(self, clear: LastClear | None) -> str:
        if clear is None:
            return ""
        if clear.was_sent:
            return ". Clear was sent before"
        return f". Clear was not sent: {clear.why_not}"

    def _halt(self) -> None:
        self._at = None
        self._attempts = None
        self._reserve = None
        self._armed = self._deadline = NEVER
        self._port.detach()
        if self._pending_step is not None:
            self._pending_step.cancel()
            self._pending_step = None
        if self._timer is not None:
            self._timer.close()
            self._timer = None
