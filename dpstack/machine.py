"""The interface of every protocol machine, and :func:`pump`, the one step function that drives it.

A machine has protocol rules and nothing else: no clock, no socket, no thread. The driver passes received octets and the
time; the machine returns the octets to send and the time of its next call. The drivers (an asyncio loop, a child
process, the virtual world) differ only in how they wait. All of them step the machine with :func:`pump`; between two
steps they pass commands to it, report delays (:class:`HeldUp`), follow its baud rate and take its events.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Protocol, dataclass_transform

from msgspec import Struct

from dpstack.trace import Event

#: Puts octets on the line and returns the time in ns at which their last bit leaves it (may lie ahead of now).
Transmit = Callable[[bytes, int], int]

#: More timer steps than this without input are a defect of the machine, not of its peer.
_MAX_SETTLE = 1000


@dataclass_transform(frozen_default=True)
class Order(Struct, frozen=True):
    """An order of the application to a machine: plain data. A derived class is immutable by itself; an instance may go
    to another process by the name of its class.

    ``ENDS``: see :attr:`ends`.
    """

    ENDS: ClassVar[bool] = False

    @property
    def ends(self) -> bool:
        """True if the order ends something: a driver carries it out however late it comes."""
        return self.ENDS


class LineDown(Struct, frozen=True):
    """Command from a driver: the port is lost. Nothing can be sent or received until :class:`LineUp`."""

    reason: str


class LineUp(Struct, frozen=True):
    """Command from a driver: the port is open (again); the bus may have changed meanwhile."""


class RateRefused(Struct, frozen=True):
    """Command from a driver: the port cannot do the rate that :attr:`Machine.baud` asks for.

    The machine then asks for another rate, or raises if it knows none.
    """

    reason: str


class HeldUp(Struct, frozen=True):
    """Report of a driver for :attr:`Machine.held_up`: it ran the machine ``for_ns`` too late for one of its deadlines.

    ``suspended``: the computer slept, and ``now`` does not contain this time. ``unsent``: it did run the machine, but
    the port took none of its telegrams. ``what``: the cause, for people.
    """

    for_ns: int
    what: str
    suspended: bool = False
    unsent: bool = False


class InDoubt(Struct, frozen=True):
    """Command from a driver: octets that it has passed on in the last ``for_ns`` may be damaged, as the port learns
    only now."""

    for_ns: int


class Pumped(Protocol):
    """The methods of a machine that :func:`pump` calls. ``now`` is CLOCK_MONOTONIC or virtual time in nanoseconds and
    never runs backwards.

    :meth:`receive` and :meth:`sent` return the new :meth:`wake_at`, or ``units.NOW`` if it must be asked.
    """

    def receive(self, chunk: bytes, now: int) -> int:
        """Process received octets; the last bit of the last one was on the line no later than ``now``."""

    def take_tx(self, now: int) -> bytes | None:
        """Process the deadlines that are due. Returns the octets to put on the line now, at most one telegram, or None.

        The machine itself keeps the idle times. A call too early is harmless.
        """

    def sent(self, at: int) -> int:
        """The transmission taken last leaves the line at ``at``; this may lie ahead if the rate is known.

        An answer may arrive before the port's own estimate of this: receiving while sending implies sent.
        """

    def wake_at(self) -> int:
        """When to call again: a time in ns, ``units.NOW``, or ``units.NEVER`` (on input only)."""


class Machine(Pumped, Protocol):
    """A protocol machine."""

    @property
    def baud(self) -> int:
        """The rate in bit/s at which it wants to receive and send. It may change with each step: the driver follows."""

    def take_events(self) -> list[Event]:
        """The events since the last call, oldest first."""

    def command(self, command: object, now: int) -> None:
        """Carry out a command of the application, or of the driver (:class:`LineDown`, :class:`LineUp`,
        :class:`RateRefused`, with :attr:`held_up` also :class:`InDoubt`). Misuse raises at once; results are events."""

    @property
    def held_up(self) -> Callable[[HeldUp, int], bool] | None:
        """Called with the report and the time, before the next step. It returns True if a telegram that the machine has
        handed out, but that is not yet sent, is too old now: the driver then drops it.

        None: the machine sends nothing that can become too old, and the driver measures no delays for it.
        """


def pump(machine: Pumped, chunk: bytes, now: int, transmit: Transmit) -> int:
    """One step: octets before timers, run until settled, at most one transmission. Returns the new deadline in ns.

    Call it for every chunk read, when the returned deadline is reached, and after every command. A deadline
    not after ``now`` asks for another step at once.
    """
    if chunk:
        deadline = machine.receive(chunk, now)
        if deadline > now:
            return deadline
    return run_due(machine, now, transmit)  # it is due, or hardly too early, which is harmless


def run_due(machine: Pumped, now: int, transmit: Transmit) -> int:
    """The part of :func:`pump` without octets, as a rule at the machine's deadline. Returns the new deadline in ns."""
    settle = _MAX_SETTLE
    while settle:
        tx = machine.take_tx(now)
        if tx is not None:
            try:
                end = transmit(tx, now)
            except Exception:
                raise
            except BaseException:  # Ctrl-C in the middle of writing: without sent() the machine would wait for ever
                machine.sent(now)
                raise
            deadline = machine.sent(end)
            return deadline if deadline > now else machine.wake_at()
        deadline = machine.wake_at()
        if deadline > now:
            return deadline
        settle -= 1
    raise RuntimeError(f"{machine!r} does not settle: it wants to be called at {deadline} again and again")
