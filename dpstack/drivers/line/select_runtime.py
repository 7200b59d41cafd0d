"""The driver on select(), without asyncio: runs one protocol machine on one serial port; used by the bus process.

Setting a deadline costs no system call. The loop polls for the last microseconds before a deadline, within a budget.
"""

from __future__ import annotations

import threading
from functools import partial
from time import monotonic_ns

from dpstack.drivers.line.line_runtime import STEP_WAIT_NS, LineRuntime
from dpstack.drivers.line.rate import ReopenAttempts
from dpstack.drivers.line.select_loop import Alarm, SelectLoop
from dpstack.drivers.realtime.rights import unlocked
from dpstack.drivers.runtime import RESERVE
from dpstack.errors import PortError
from dpstack.units import NEVER


class SelectRuntime(LineRuntime):
    """:class:`LineRuntime` in a :class:`SelectLoop`; the caller runs it: ``loop.run()``.

    As :class:`dpstack.drivers.runtime.Runtime`, with ordinary functions ``open`` and ``close``. ``open`` refuses a port
    without a file descriptor.
    """

    _loop: SelectLoop  # set by open()
    _alarm: Alarm | None = None  # the timer
    _retry: Alarm | None = None
    _connecting: threading.Thread | None = None

    #: the loop itself polls before a deadline
    early_ns = 0

    def _make_reserve(self) -> object:
        return unlocked(RESERVE)  # the bus process has locked its memory

    def open(self, loop: SelectLoop) -> None:
        """Open the port and begin. Raises PortError; ConfigError when the port knows none of the machine's rates."""
        self._check_openable()
        if self._connecting is not None:  # begun before the last close; ends within seconds
            self._connecting.join()
            self._connecting = None
        self._port.open_now()
        self._begin_in(loop)

    def take_over(self, loop: SelectLoop, command: object) -> None:
        """Continue with the open port and the machine of another driver that has stopped; first hand it ``command``.

        Raises as ``open``; the port is closed then.
        """
        self._check_openable()
        self._machine.command(command, monotonic_ns())
        self._begin_in(loop)

    def _begin_in(self, loop: SelectLoop) -> None:
        self._loop = loop
        self._alarm = loop.alarm(self._timer_due)
        self._begin(loop, self._alarm)

    def close(self) -> None:
        """Stop, release the port and dispatch the machine's last events. May be called again."""
        was_open = self._at is not None
        self._halt()
        if was_open:
            self._expect(NEVER, 0)
        if self._retry is not None:
            self._retry.close()
            self._retry = None
        self._end(was_open)

    # --- waiting ---
    def _expect(self, at: int, sleep_until: int) -> None:
        loop = self._loop
        loop.expected_at = at
        loop.quiet_until = sleep_until

    def _attach(self) -> None:
        self._loop.set_quiet(self._port.fd)
        super()._attach()

    def _arm(self, deadline: int) -> None:
        """Each time, as it costs no system call: an alarm that is too early wakes the loop up in vain."""
        if self._alarm is not None:
            self._alarm.at = deadline

    def _count_spinning(self, spun_ns: int, now: int) -> None:
        budget = self._loop.budget
        budget.spun(spun_ns, now)
        if not budget.may_spin(now):
            self._step_wait_ns = 0

    def _timer_due(self) -> None:
        try:
            if not self._step_wait_ns and self._loop.budget.may_spin(monotonic_ns()):
                self._step_wait_ns = STEP_WAIT_NS
        except MemoryError as exc:
            self._fail(exc)
            return
        super()._timer_due()

    # --- a lost port ---
    def _begin_reopening(self, attempts: ReopenAttempts) -> None:
        self._retry = self._loop.call_at(monotonic_ns() + attempts.pause_ns(), partial(self._attempt, attempts))

    def _attempt(self, attempts: ReopenAttempts) -> None:
        self._retry = None
        if self._port.connects:
            name = f"connecting {self.port_name}"
            self._connecting = threading.Thread(target=self._attempt_aside, args=(attempts,), name=name, daemon=True)
            self._connecting.start()
        else:
            self._outcome(attempts, self._try())

    def _attempt_aside(self, attempts: ReopenAttempts) -> None:
        """:meth:`_attempt` in a thread, for a port whose opening may take seconds."""
        error = self._try()
        try:
            self._loop.call_soon_threadsafe(partial(self._outcome, attempts, error))
        except RuntimeError:  # the loop is closed
            self._port.close()

    def _try(self) -> Exception | None:
        try:
            self._port.open_now()
        except Exception as exc:
            return exc
        return None

    def _outcome(self, attempts: ReopenAttempts, error: Exception | None) -> None:
        if error is None:
            self._reopened(attempts)
        elif attempts is not self._attempts:
            return
        elif isinstance(error, PortError):
            self._reopening_refused(attempts, error)
            self._begin_reopening(attempts)
        else:
            self._fail(error)

    def _report(self, message: str, error: Exception) -> None:
        self._loop.report(message, error)
