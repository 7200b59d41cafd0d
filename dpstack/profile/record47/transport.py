"""The DP-V1 services of record 47 as generators: the client yields services, the bus side executes them.

A :data:`Transport` yields services and is sent an :class:`Answer` for each; it owns no clock and no bus.
``AcyclicAccess`` runs one in the cycle of a drive plugin, :mod:`dpstack.api.slave.record_parameters` in an asyncio
program.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeVar

from dpstack.dpv1.pdu.error_codes import Code, code_text
from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq

T = TypeVar("T")

#: error codes of a missing record; 0: the slave does not support the service at all
ABSENT: Final = frozenset({0, Code.INVALID_INDEX, Code.INVALID_SLOT})


@dataclass(frozen=True, slots=True)
class Pause:
    """Send nothing for so many ns."""

    ns: int


Service = WriteReq | ReadReq | Pause


class Refused(NamedTuple):
    """A negative answer: Error_Code_1 of DP-V1, or 0 and why the slave does not support the service at all."""

    code: int
    why: str = ""

    def __str__(self) -> str:
        return self.why or f"error {self.code >> 4:X}/{self.code & 15:X}, {code_text(self.code)}"


class Silent(NamedTuple):
    """No answer: the slave may have carried out the service or not."""

    why: str


class Answer(NamedTuple):
    """The answer to a service and its time (ns): the octets read, b"" after a write or a pause, or the failure."""

    now: int
    data: bytes | Refused | Silent = b""


#: Yields services until it returns its result or raises CommandError.
Transport = Generator[Service, Answer, T]
