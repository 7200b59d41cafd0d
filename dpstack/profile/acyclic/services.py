"""The services that record 47 travels by, as a talk: who wants them says which, who has a bus carries them out.

A :data:`Talk` is a generator that yields services and is sent an :class:`Answer` for each; it owns no clock and no bus.
``AcyclicAccess`` runs one in the cycle of a drive plugin, :mod:`dpstack.api.records` in an asyncio program.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeVar

from dpstack.profile.jobs import CommandError

T = TypeVar("T")

#: Error_Code_1 of a negative answer: class << 4 | code (protocol facts C2)
INVALID_INDEX, WRITE_LENGTH, INVALID_SLOT, STATE_CONFLICT, ACCESS_DENIED = 0xB0, 0xB1, 0xB2, 0xB5, 0xB6
INVALID_RANGE, INVALID_PARAMETER = 0xB7, 0xB8
READ_BUSY, WRITE_BUSY, BUSY = 0xC0, 0xC1, 0xC2
#: there is no such record
ABSENT: Final = frozenset({0, INVALID_INDEX, INVALID_SLOT})
#: not now: worth another try
AGAIN: Final = frozenset({STATE_CONFLICT, READ_BUSY, WRITE_BUSY, BUSY})


@dataclass(frozen=True, slots=True)
class WriteRecord:
    """Write ``data`` into a record."""

    slot: int
    index: int
    data: bytes


@dataclass(frozen=True, slots=True)
class ReadRecord:
    """Read at most ``length`` octets of a record."""

    slot: int
    index: int
    length: int


@dataclass(frozen=True, slots=True)
class Pause:
    """Nothing for so many ns."""

    ns: int


Service = WriteRecord | ReadRecord | Pause


class Refused(NamedTuple):
    """A negative answer: Error_Code_1 and, where whoever carried the service out knows one, a text for people."""

    code: int
    text: str = ""

    def __str__(self) -> str:
        return f"error {self.code >> 4:X}/{self.code & 15:X}" + (f", {self.text}" if self.text else "")


class Answer(NamedTuple):
    """What came of a service, and when (ns): what was read, b"" after a write or a pause, or a negative answer."""

    now: int
    data: bytes | Refused = b""


#: Yields services until it returns its result or raises CommandError.
Talk = Generator[Service, Answer, T]


class PendingService:
    """A service under way; ``answer`` is None until it is over: what was read, a negative answer, or why there is none.

    ``Refused`` with code 0: the slave does not take the service at all.
    """

    __slots__ = ("answer", "service")

    def __init__(self, service: WriteRecord | ReadRecord) -> None:
        self.service = service
        self.answer: bytes | Refused | CommandError | None = None


class RecordQueue:
    """The services that one slave is to be asked, oldest first: the plugin puts in, the master takes out."""

    __slots__ = ("_waiting",)

    def __init__(self) -> None:
        self._waiting: deque[PendingService] = deque()

    def submit(self, service: WriteRecord | ReadRecord) -> PendingService:
        """Queue a service."""
        pending = PendingService(service)
        self._waiting.append(pending)
        return pending

    def cancel(self, pending: PendingService) -> None:
        """Give one up; one that was taken goes on and nobody looks at its answer."""
        if pending in self._waiting:
            self._waiting.remove(pending)

    def take(self) -> PendingService | None:
        """The next one for the master, who sets its ``answer``."""
        return self._waiting.popleft() if self._waiting else None

    def clear(self) -> None:
        """The slave left data exchange."""
        self._waiting.clear()
