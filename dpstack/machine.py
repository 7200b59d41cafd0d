"""The contract of every protocol machine, and the one step function that drives it.

A machine owns a protocol rule and nothing else: no clock, no socket, no thread. It is told what arrived and what time
it is, says what to send and when it wants to be called again. What drives it (an asyncio loop, a child process,
the virtual world) differs only in how it waits; all of them call :func:`pump` and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from dpstack.trace import Event
from dpstack.units import NEVER, NOW

__all__ = ["NEVER", "NOW", "HeldUp", "LineDown", "LineUp", "Machine", "RateRefused", "Transmit", "pump"]

#: Puts octets on the line and returns the time in ns at which their last bit leaves it (may lie ahead of now).
Transmit = Callable[[bytes, int], int]

#: More timer steps than this without input are a defect of the machine, not of its peer.
_MAX_SETTLE = 1000


@dataclass(frozen=True, slots=True)
class LineDown:
    """Command from a driver: the port vanished. Nothing can be sent or heard until :class:`LineUp`."""

    reason: str


@dataclass(frozen=True, slots=True)
class LineUp:
    """Command from a driver: the port is (again) there; the bus may have changed meanwhile."""


@dataclass(frozen=True, slots=True)
class RateRefused:
    """Command from a driver: the port cannot do the rate that :attr:`Machine.baud` asks for.

    The machine wants another one then, or raises when it knows none.
    """

    reason: str


@dataclass(frozen=True, slots=True)
class HeldUp:
    """A driver tells its machine: nobody ran the machine for ``for_ns`` although one of its deadlines was over.

    ``suspended``: the computer slept, and ``now`` does not contain this time. ``what`` says for people what blocked.
    """

    for_ns: int
    what: str
    suspended: bool = False


class Machine(Protocol):
    """A protocol machine. ``now`` is CLOCK_MONOTONIC or virtual time in nanoseconds and never runs backwards."""

    @property
    def baud(self) -> int:
        """The rate in bit/s it wants to hear and send at. It may change with every step: the driver follows."""

    def receive(self, chunk: bytes, now: int) -> None:
        """Octets that arrived; the last bit of the last one was on the line no later than ``now``."""

    def sent(self, at: int) -> None:
        """The transmission taken last leaves the line at ``at``; this may lie ahead where the rate is known.

        An answer may arrive before the port's own estimate of this: receiving while sending implies sent.
        """

    def wake(self, now: int) -> None:
        """Time has passed: judge the deadlines that are due. A call too early is harmless."""

    def take_tx(self, now: int) -> bytes | None:
        """The octets to put on the line now, at most one telegram, or None. The gates are the machine's own."""

    def wake_at(self) -> int:
        """When to call again: :data:`NOW`, a time in ns, or :data:`NEVER` (on input only)."""

    def take_events(self) -> list[Event]:
        """What happened since the last call, oldest first, for whoever is interested."""

    def command(self, command: object, now: int) -> None:
        """An order of the application. Misuse raises at once; what an order leads to is told by events."""


def pump(machine: Machine, chunk: bytes, now: int, transmit: Transmit) -> int:
    """One step: octets before timers, run until settled, at most one transmission. Returns the new deadline in ns.

    Call it for every chunk read, when the returned deadline is reached, and after every command. A deadline
    not after ``now`` asks for another step at once.
    """
    if chunk:
        machine.receive(chunk, now)
    settle = _MAX_SETTLE
    deadline = machine.wake_at()
    while deadline <= now:
        machine.wake(now)
        tx = machine.take_tx(now)
        if tx is not None:
            try:
                end = transmit(tx, now)
            except Exception:
                raise
            except BaseException:  # Ctrl-C in the middle of writing: a machine that is not told waits for ever
                machine.sent(now)
                raise
            machine.sent(end)
            return machine.wake_at()
        deadline = machine.wake_at()
        settle -= 1
        if not settle:
            raise RuntimeError(f"{machine!r} does not settle: it wants to be called at {deadline} again and again")
    return deadline
