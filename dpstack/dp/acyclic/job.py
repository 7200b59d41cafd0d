"""Jobs of the acyclic queue (:mod:`dpstack.dp.acyclic.queue`): a service as a sequence of requests with one end.

A job is a generator: it yields its next request (:class:`Step`) and receives the end of that request with its times
(:class:`RequestEnd`). A job has no other clock. It ends with one :class:`Outcome`; if a program ordered the service,
one :class:`ServiceEnd` reports it. Jobs are in
:mod:`dpstack.dp.acyclic.class2`, :mod:`dpstack.dpv1.master.ms1` and
:mod:`dpstack.dpv1.master.ms2_connection`.
"""

from __future__ import annotations

import abc
from collections.abc import Generator, Hashable
from enum import Enum
from typing import Final, TypeVar

from msgspec import Struct

from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Telegram
from dpstack.machine import Order
from dpstack.trace import Event
from dpstack.units import NS_PER_MS

T = TypeVar("T")

#: three first requests and the probe with FCV = 1 that finds slaves which know nothing else
#: (docs/reference/protocol.md#slaves-that-know-only-fcv-1)
ATTEMPTS: Final = 4
#: before the repetition of a request that the slave refused as busy, or did not answer for the first time
BUSY_PAUSE: Final = 10 * NS_PER_MS
#: the longest pause before the repetition of an unanswered request
_SILENT_PAUSE: Final = 16 * BUSY_PAUSE


class ServiceFailure(Enum):
    """Why a service has no result."""

    SILENT = "silent"  # no answer
    UNREADABLE = "unreadable"  # octets came, no telegram
    WRONG = "wrong"  # an answer that cannot be one
    LENGTH = "length"  # an answer of an impossible length
    REFUSED = "refused"  # the slave says no
    GUARDED = "guarded"  # this bus is read-only
    LATE = "late"  # not in the time given
    LINE = "line"  # the port vanished
    CANCELLED = "cancelled"  # by order of the program
    CLOSED = "closed"  # the slave is not in data exchange (any more)
    NEGATIVE = "negative"  # a negative response of DP-V1
    ABORTED = "aborted"  # its class 2 connection is over
    IDENT = "ident"  # another device
    OWNED = "owned"  # by a class 1 master
    TAKEN = "taken"  # the new address is in use
    KEPT = "kept"  # the slave did not take the new address
    GONE = "gone"  # it answers neither at the old nor at the new address
    DOUBLE = "double"  # it has the new address, and the old one still answers


class Outcome(Struct, frozen=True):
    """The one end of a service: ``data`` of the answer, or ``failure`` with ``text`` that says what to do.

    ``status``: how a refusing slave answered. ``codes``: Error_Decode, Error_Code_1 and 2 of a negative response, or
    subnet, instance and reason of the Abort that ended its class 2 connection.
    """

    failure: ServiceFailure | None = None
    text: str = ""
    status: str = ""
    codes: tuple[int, int, int] | None = None
    data: bytes = b""


class ServiceEnd(Event):
    """The one end of the service that was ordered with ``token``, whatever the service and the way to the slave."""

    token: int
    address: int
    outcome: Outcome

    MUST_ARRIVE = True

    @property
    def title(self) -> str:
        """The service by the standard's name. Each derived class has it."""
        raise NotImplementedError

    @property
    def record(self) -> tuple[int, int] | None:
        """Slot and index of the record that the service was about; None for another service."""
        return None

    @property
    def result(self) -> str:
        """The text of a service without failure. Each derived class has it."""
        raise NotImplementedError

    def _text(self) -> str:
        outcome = self.outcome
        return f"slave {self.address}: {self.result}" if outcome.failure is None else outcome.text


class Step(Struct, frozen=True):
    """The next request of a job, not earlier than ``pause_ns`` after the last one's end."""

    request: Request
    pause_ns: int = 0


class RequestEnd(Struct, frozen=True):
    """The end of a request at ``now``; its first bit was on the wire at ``begun``, both in ns.

    If the request was never sent, ``begun`` is ``now``.
    """

    answer: Telegram | Failure
    begun: int
    now: int


#: a running job: it receives the end of each request and returns the result
Steps = Generator[Step, RequestEnd, T]


class Job(abc.ABC):
    """One service from its beginning to its one end: ``title``, by the standard's name, to the slave at ``address``."""

    address: int
    title: str

    @property
    def lane(self) -> Hashable | None:
        """Jobs of the same lane run one after the other, in the order they came."""
        return None

    @property
    def aftermath(self) -> str:
        """The warning for a job that is cut short now; empty when nothing has happened to the slave."""
        return ""

    def bar(self) -> str:
        """Why the slave can never answer it any more (a text to follow its title), empty while it can. The queue calls
        this in every token hold."""
        return ""

    def held_up(self, now: int) -> str:
        """The reason why it may not begin yet, for a text; empty when it may. Meanwhile later jobs of its
        lane overtake it. Called in every token hold until it begins."""
        return ""

    @abc.abstractmethod
    def steps(self) -> Steps[Outcome]:
        """Its requests, one after the other."""

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """The events of its one end, for the program that ordered it with ``token``."""
        return []


#: the token of jobs that no program ordered: of drive plugins and connections; acknowledgements of alarms
UNORDERED: Final = -1
ACKS: Final = -2


def pause_after_silence(silent: int) -> int:
    """The pause in ns before the next request to a slave that left ``silent`` requests in a row unanswered (1 or more).

    The pause grows, because a computer that stands still for 30 ms must not use up all attempts at once.
    """
    return min(BUSY_PAUSE << (silent - 1), _SILENT_PAUSE)


class CancelService(Order):
    """End the service with ``token``, because no program waits for it. A service that is over already is no error."""

    ENDS = True

    token: int
