"""Numbers of the present faults and warnings by parameter: PROFIdrive's fault buffer, PNU 944, 945 and 947."""

from __future__ import annotations

from typing import Final, Protocol

from msgspec import Struct

from dpstack.profile.channel.base import ParameterChannel, ParamKey
from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.units import NS_PER_MS, NS_PER_S

#: for all requests of one reading: record 47 takes 1.4 s for one element at 9.6 kbit/s beside four drives
PATIENCE_NS: Final = 8 * NS_PER_S
#: between two readings of a drive that has no number yet
_PAUSE_NS: Final = 100 * NS_PER_MS


class MessageParameter(Struct, frozen=True, kw_only=True):
    """The parameter with the numbers of the present faults or warnings; 0 ends them.

    ``counter``: the parameter that counts changes of the buffer; it is read before and after the numbers, which are
    read again if it has changed.
    """

    #: parameter number
    number: int
    #: the first element that is read; None: the parameter is no array
    index: int | None = 0
    #: elements that are read at most
    count: int = 8
    counter: int | None = None


#: fault codes of the present fault situation
FAULT_CODES: Final = MessageParameter(number=945, counter=944)
#: fault numbers of the present fault situation
FAULT_NUMBERS: Final = MessageParameter(number=947, counter=944)


class MessageCore(Protocol):
    """Master side of a drive as a reading uses it."""

    now: int
    access: ParameterChannel | None

    def sleep_until(self, due_ns: int) -> None: ...


def read_messages(core: MessageCore, parameter: MessageParameter, deadline: int) -> Steps[tuple[int, ...]]:
    """The numbers, at least one: it waits for the first one. Raises CommandError."""
    access = core.access
    assert access is not None
    while True:
        before = yield from _counted(access, parameter, deadline)
        found = yield from _numbers(access, parameter, deadline)
        if (yield from _counted(access, parameter, deadline)) == before and found:
            return found
        if core.now >= deadline:
            raise CommandError("timeout", f"parameter {parameter.number} has no number")
        due = core.now + (0 if found else _PAUSE_NS)
        while core.now < due:
            core.sleep_until(due)
            yield


def _counted(access: ParameterChannel, parameter: MessageParameter, deadline: int) -> Steps[int]:
    if parameter.counter is None:
        return 0
    return (yield from access.read_raw(ParamKey(parameter.counter), deadline))


def _numbers(access: ParameterChannel, parameter: MessageParameter, deadline: int) -> Steps[tuple[int, ...]]:
    """In one request if several parameters fit into it, else one by one up to the first 0."""
    if parameter.index is None:
        keys = [ParamKey(parameter.number)]
    else:
        keys = [ParamKey(parameter.number, index=parameter.index + at) for at in range(parameter.count)]
    found: list[int] = []
    size = min(access.per_request, len(keys))
    for at in range(0, len(keys), size):
        for entry in (yield from access.read_many(keys[at : at + size], deadline)):
            if "error" in entry and not found:
                raise CommandError("parameter", str(entry["text"]))
            raw = entry.get("raw", 0)
            if not isinstance(raw, int) or not raw:
                return tuple(found)
            found.append(raw)
    return tuple(found)
