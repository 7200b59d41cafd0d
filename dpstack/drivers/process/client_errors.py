"""Why a bus process is no more, and what that means at the slaves; for people."""

from __future__ import annotations

import signal
from collections.abc import Mapping

from dpstack.drivers.process.messages import News
from dpstack.drivers.shutdown import at_slaves
from dpstack.errors import BusError


def how_it_ended(code: int | None, last: News | None, watchdogs: Mapping[str, int]) -> BusError:
    """``code``: its exit code, negative for a signal. ``last``: its last words, if any.

    ``watchdogs``: of the slaves that were in data exchange, by name, in ns (0 is off).
    """
    if last is not None and last.defect:
        text = f"the bus was stopped by a defect in dpstack ({last.over}); please report it. {at_slaves(watchdogs)}"
        return BusError(text)
    if last is not None:
        return BusError(f"the bus process has ended: {last.over}; outputs were set to their safe values before")
    if code is None:
        how = "does not talk any more"
    elif code < 0:
        how = f"was killed by {_signal(-code)}"
    else:
        how = f"ended with exit code {code}, see what it wrote to standard error"
    return BusError(f"the bus process {how}: nothing is sent any more. {at_slaves(watchdogs)}; open the bus anew")


def killed_at_the_end(watchdogs: Mapping[str, int]) -> str:
    """It did not end when it was told to; ``watchdogs`` as in :func:`how_it_ended`."""
    return f"it did not answer at the end of the bus and was killed: the end was not in order. {at_slaves(watchdogs)}"


def _signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
