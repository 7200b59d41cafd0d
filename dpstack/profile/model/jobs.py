"""Jobs of the application that take several cycles, written as generators that are resumed once a cycle.

And the orders of one drive that are under way, with the events about them.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping
from typing import Final, Literal, TypeVar

from msgspec import Struct

from dpstack.units import s_to_ns

T = TypeVar("T")
#: Yields once a cycle until it returns its result or raises :class:`CommandError`.
Steps = Generator[None, None, T]

#: The largest number in an order, an option or a parameter.
LARGEST: Final = 1e15
#: The largest parameter number, index or data set.
_LARGEST_WHOLE: Final = 999_999_999
#: Characters of the longest parameter name.
_LONGEST_NAME: Final = 100

#: Why an order failed: the drive's fault, time, the parameter channel, wrong use, or the slave left data exchange.
ErrorKind = Literal["fault", "timeout", "parameter", "usage", "lost"]


class CommandError(Exception):
    """Failure of an order; becomes its result event."""

    def __init__(self, kind: ErrorKind, text: str, number: int | None = None) -> None:
        super().__init__(text)
        #: "fault", "timeout", "parameter", "usage" or "lost"
        self.kind = kind
        #: the failure for people
        self.text = text
        #: error number of the drive; None if the drive did not give one
        self.number = number


class DriveJob(Struct, eq=False):
    """An order under way. ``motion``: at most one such job runs, a new one supersedes it. ``token`` None: our own.

    It sleeps until ``due_ns``, while the status word is ``status``.
    """

    op: str
    token: int | None
    steps: Steps[dict[str, object]]
    motion: bool
    due_ns: int = 0
    status: int = 0


class Args:
    """The arguments of one order in plain JSON data. Each method checks one; it raises CommandError of kind usage."""

    def __init__(self, op: str, given: Mapping[str, object]) -> None:
        self._op = op
        self._given = given
        self._read: set[str] = set()

    def number(self, name: str, default: float | None = None) -> float:
        """A finite number up to :data:`LARGEST`; required without a default."""
        value = self._get(name)
        if value is None and default is not None:
            return default
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not -math.inf < value < math.inf:
            raise self._wrong(name, "a number", value)
        if abs(value) > LARGEST:
            raise CommandError("usage", f"{self._op}: {name} must be a number up to {LARGEST:g}")
        return value

    def optional(self, name: str) -> float | None:
        return None if self._get(name) is None else self.number(name)

    def integer(self, name: str) -> int | None:
        """A whole number from 0 on, or None."""
        value = self._get(name)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise self._wrong(name, "a whole number from 0 on", value)
        return self._whole(name, value)

    def name_or_number(self, name: str) -> str | int:
        """Name or number of a parameter."""
        value = self._get(name)
        if isinstance(value, bool) or not isinstance(value, (int, str)):
            raise self._wrong(name, "a parameter number or name", value)
        if isinstance(value, int):
            return self._whole(name, value)
        if len(value) > _LONGEST_NAME:
            raise CommandError(
                "usage", f"{self._op}: {name} has {len(value)} characters; no parameter's name is so long"
            )
        return value

    def text(self, name: str) -> str | None:
        return self._typed(name, str, "a text")

    def tables(self, name: str) -> list[Args]:
        """A list of tables, each with arguments of its own."""
        value = self._get(name)
        if not isinstance(value, (list, tuple)) or not all(isinstance(one, Mapping) for one in value):
            raise self._wrong(name, "a list of tables", value)
        return [Args(f"{self._op}: {name} {number}", one) for number, one in enumerate(value, 1)]

    def flag(self, name: str) -> bool:
        """True or False, default False."""
        return bool(self._typed(name, bool, "true or false"))

    def timeout_ns(self, default_s: float) -> int:
        """``timeout_s`` in ns, not negative."""
        seconds = self.number("timeout_s", default_s)
        if seconds < 0:
            raise CommandError("usage", f"{self._op}: timeout_s must not be negative")
        return s_to_ns(seconds)

    def done(self) -> None:
        """Refuse arguments that no method has read."""
        unknown = [name for name in self._given if name not in self._read]
        if unknown:
            raise CommandError("usage", f"{self._op}: unknown argument {unknown[0]!r}")

    def _whole(self, name: str, value: int) -> int:
        if abs(value) > _LARGEST_WHOLE:
            raise CommandError("usage", f"{self._op}: {name} must be a whole number up to {_LARGEST_WHOLE}")
        return value

    def _wrong(self, name: str, wanted: str, value: object) -> CommandError:
        return CommandError("usage", f"{self._op}: {name} must be {wanted}, not {value!r}")

    def _typed(self, name: str, kind: type[T], wanted: str) -> T | None:
        value = self._get(name)
        if value is not None and not isinstance(value, kind):
            raise self._wrong(name, wanted, value)
        return value

    def _get(self, name: str) -> object:
        self._read.add(name)
        return self._given.get(name)


class DriveJobs:
    """The jobs of one drive in order of arrival; each is resumed once a cycle and ends with a result event.

    ``of``: the kind of device in its events, if it is no drive.
    """

    def __init__(self, of: str = "") -> None:
        self._of = {"of": of} if of else {}
        #: the jobs that are not over
        self.jobs: list[DriveJob] = []
        #: The drive's status word in the last :meth:`step`. All jobs sleep until :attr:`due_ns`, unless it changes.
        self.status = 0
        self.due_ns = 0
        #: set by a job before it yields: it sleeps until this time in ns, or until the status word changes
        self.sleep_until = 0
        self._events: list[dict[str, object]] = []

    def begin(self, job: DriveJob) -> None:
        """Begin an order; a new motion order supersedes the present one."""
        if job.motion:
            for other in [other for other in self.jobs if other.motion]:
                self._drop(other)
                self.failed(other.token, CommandError("usage", f"{other.op} was superseded by {job.op}"))
        self.jobs.append(job)
        self.due_ns = 0
        self._resume(job)

    def spawn(self, job: DriveJob) -> None:
        """Add a job of the plugin; it begins with the next cycle."""
        self.jobs.append(job)
        self.due_ns = 0

    def step(self, now: int, status: int) -> None:
        """A cycle at ``now`` (ns); ``status``: the drive's status word."""
        self.status = status
        for job in tuple(self.jobs):
            if now >= job.due_ns or status != job.status:
                self._resume(job)
        self.due_ns = min((job.due_ns for job in self.jobs), default=0)

    def runs(self, op: str) -> bool:
        """Whether an order ``op`` is under way."""
        return any(job.op == op for job in self.jobs)

    def end(self, error: CommandError) -> None:
        """End all jobs, as failed."""
        jobs, self.jobs = self.jobs, []
        for job in jobs:
            job.steps.close()
            self.failed(job.token, error)

    def cancel(self, token: int | None) -> int:
        """End the orders with ``token`` without a result; their number."""
        ended = [job for job in self.jobs if job.token == token and token is not None]
        for job in ended:
            self._drop(job)
        return len(ended)

    def failed(self, token: int | None, error: CommandError) -> None:
        """The result event of an order that failed; none without a ``token``."""
        if token is not None:
            why = {"error": error.kind, "number": error.number, "text": error.text}
            self.tell({"type": "result", "token": token, "ok": False, **why})

    def tell(self, event: dict[str, object]) -> None:
        self._events.append(event | self._of)

    def take_events(self) -> list[dict[str, object]]:
        """Plain JSON data for the application, oldest first."""
        if not self._events:
            return []
        events, self._events = self._events, []
        return events

    def _drop(self, job: DriveJob) -> None:
        self.jobs.remove(job)
        job.steps.close()

    def _resume(self, job: DriveJob) -> None:
        if job not in self.jobs:
            return
        try:
            self.sleep_until = 0
            next(job.steps)
            job.due_ns, job.status = self.sleep_until, self.status
        except StopIteration as done:
            self.jobs.remove(job)
            if job.token is not None:
                self.tell({"type": "result", "token": job.token, "ok": True, **done.value})
        except CommandError as error:
            self.jobs.remove(job)
            self.failed(job.token, error)
        except BaseException:
            self.jobs.remove(job)
            raise
