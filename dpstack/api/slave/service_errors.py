"""Exceptions of failed acyclic services."""

from __future__ import annotations

from typing import Final

from dpstack.dp.acyclic.job import Outcome, ServiceFailure
from dpstack.errors import (
    AcyclicError,
    BusError,
    ConnectionEnded,
    DpError,
    ServiceRefused,
    SlaveFault,
    SlaveTimeout,
    UsageError,
)

_LATE: Final = (ServiceFailure.SILENT, ServiceFailure.LATE, ServiceFailure.GONE)
_NO: Final = (ServiceFailure.REFUSED, ServiceFailure.KEPT, ServiceFailure.NEGATIVE)


def error_of(address: int, title: str, outcome: Outcome, record: tuple[int, int] | None = None) -> DpError:
    """The exception of the service ``title`` at the slave ``address`` that ended with the failure in ``outcome``.

    ``record``: slot and index (of an alarm slot and type); None for other services.
    """
    text, failure = outcome.text, outcome.failure
    if failure is ServiceFailure.ABORTED:
        return ConnectionEnded(address, text, abort=outcome.codes)
    if record is not None and outcome.codes is not None:
        slot, index = record
        return AcyclicError(address, text, service=title, slot=slot, index=index, codes=outcome.codes)
    if failure in _LATE:
        return SlaveTimeout(address, text)
    if failure in _NO:
        return ServiceRefused(address, text, service=title, status=outcome.status)
    if failure is ServiceFailure.GUARDED:
        return UsageError(text)
    if failure is ServiceFailure.LINE:
        return BusError(text)
    return SlaveFault(address, text)
