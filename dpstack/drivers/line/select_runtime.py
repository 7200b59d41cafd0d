"""The plain driver: one machine on one port in a loop of its own, without asyncio; the bus process runs on it.

It is :class:`~dpstack.drivers.line.line_runtime.Stepping` as the asyncio driver is, and differs in how it waits: a
deadline costs no system call, and its last microseconds are looked at, not slept, within a budget.
"""

from __future__ import annotations

import threading
from functools import partial
from time import monotonic_ns
from typing import Final

from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.line_runtime import OnHeldUp, Stepping
from dpstack.drivers.line.port_latency import Tune
from dpstack.drivers.line.rate import BACKOFF_NS, Attempts
from dpstack.drivers.line.select_loop import Alarm, PlainLoop
from dpstack.drivers.runtime import OnEvents, OnFailure
from dpstack.errors import PortError
from dpstack.machine import Machine
from dpstack.ports import Port
from dpstack.units import NEVER, NS_PER_US

#: Waits within a step shorter than this are spun: going round the loop costs 8 us more, measured at 500 kbit/s, where
#: T_ID1 is 74 us and most of it is left when an answer has been looked at. Shorter than any slot time.
PLAIN_SPIN_NS: Final = 70 * NS_PER_US


class PlainRuntime(Stepping):
    """:class:`Stepping` in a :class:`PlainLoop`, which runs elsewhere: ``loop.run()``.

    As :class:`dpstack.drivers.runtime.Runtime`, with an ``open`` and a ``close`` that return when it is done. A port
    without a file descriptor is refused by ``open``.
    """

    def __init__(
        self,
        loop: PlainLoop,
        port: Port,
        machine: Machine,
        on_events: OnEvents,
        *,
        echo: Echo = Echo.AUTO,
        on_failure: OnFailure | None = None,
        tune: Tune | None = None,
        held_up: OnHeldUp | None = None,
        spin_ns: int = PLAIN_SPIN_NS,
        backoff_ns: tuple[int, int] = BACKOFF_NS,
    ) -> None:
        super().__init__(
            port,
            machine,
            on_events,
            echo=echo,
            on_failure=on_failure,
            tune=tune,
            held_up=held_up,
            spin_ns=spin_ns,
            backoff_ns=backoff_ns,
        )
        self._loop = loop
        self._budget = loop.budget
        self._spin_wanted_ns = spin_ns
        self._early_ns = 0  # the loop looks at what is near by itself
        self._retry: Alarm | None = None
        self._connecting: threading.Thread | None = None

    def open(self) -> None:
        """Open the port and begin. Raises PortError; ConfigError when the port knows none of the machine's rates."""
        self._may_open()
        if self._connecting is not None:  # of before the last close: it has a limit of some seconds
            self._connecting.join()
            self._connecting = None
        self._port.open_now()
        self._begin(self._loop, self._loop.alarm(self._timer_due))

    def take_over(self, command: object) -> None:
        """Go on with a port that another driver has opened and a machine that it has left: ``command`` comes first.

        Raises as ``open``; the port is closed then.
        """
        self._may_open()
        self._machine.command(command, monotonic_ns())
        self._begin(self._loop, self._loop.alarm(self._timer_due))

    def close(self) -> None:
        """Stop and release the port; what the machine still had to tell is told. May be called again."""
        was_open = self._at is not None
        self._halt()
        self._expect(NEVER, 0)
        if self._retry is not None:
            self._retry.close()
            self._retry = None
        self._end(was_open)

    # --- waiting ---
    def _expect(self, at: int, quiet_until: int) -> None:
        loop = self._loop
        loop.expected_at = at
        loop.hush(self._port.fd, quiet_until)

    def _waited(self, spun_ns: int, now: int) -> None:
        self._budget.spun(spun_ns, now)
        if not self._budget.may_spin(now):
            self._spin_ns = 0

    def _timer_due(self) -> None:
        if not self._spin_ns and self._budget.may_spin(monotonic_ns()):
            self._spin_ns = self._spin_wanted_ns
        super()._timer_due()

    # --- a lost port ---
    def _begin_reopening(self, attempts: Attempts) -> None:
        self._retry = self._loop.call_at(monotonic_ns() + attempts.pause_ns(), partial(self._attempt, attempts))

    def _attempt(self, attempts: Attempts) -> None:
        self._retry = None
        if self._port.connects:
            name = f"connecting {self.port_name}"
            self._connecting = threading.Thread(target=self._attempt_aside, args=(attempts,), name=name, daemon=True)
            self._connecting.start()
        else:
            self._outcome(attempts, self._try())

    def _attempt_aside(self, attempts: Attempts) -> None:
        """The same where it may take seconds: in a thread, while the loop does what else there is."""
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

    def _outcome(self, attempts: Attempts, error: Exception | None) -> None:
        if error is None:
            self._back(attempts)
        elif attempts is not self._attempts:
            return
        elif isinstance(error, PortError):
            self._refused(attempts, error)
            self._begin_reopening(attempts)
        else:
            self._fail(error)

    def _report(self, message: str, error: Exception) -> None:
        self._loop.report(message, error)
