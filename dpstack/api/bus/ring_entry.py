"""Joining the token ring of other masters: time limit, failure texts, notices."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final

from dpstack.api.bus.parts import BusBase
from dpstack.drivers.snapshots import BusSnapshot, View
from dpstack.errors import BusError
from dpstack.fdl.events import MasterSeen
from dpstack.params import BusParams
from dpstack.phy.neighbours import Neighbours
from dpstack.phy.patience import Patience
from dpstack.trace import Event, Notice, Severity
from dpstack.units import NS_PER_S, ns_to_s

#: shortest time limit (s): masters of other makers may be slower
_LEAST_LIMIT_S: Final = 30.0
#: number of passes over the GAP to wait for: this station may not know the ring yet at the first poll, or its answer
#: may be damaged
_PASSES: Final = 2


def pass_ns(params: BusParams, patience: Patience) -> int:
    """The longest time in ns that a new station waits for the GAP poll of a master with ``params``: the pause between
    two passes and one pass over every address up to HSA. (Only the slot time of each poll counts.)"""
    cost_ns = patience.silent_ns(params)
    polls = params.hsa + 1
    return params.gap * params.ns(params.t_tr) + polls * cost_ns * max(1, patience.gap_divisor(polls, cost_ns))


def join_limit_s(params: BusParams, patience: Patience) -> float:
    """Time limit for joining in seconds: two passes, 30 s at least."""
    return max(_LEAST_LIMIT_S, float(-(-_PASSES * pass_ns(params, patience) // NS_PER_S)))


class OtherMasterNotices:
    """Notices about other masters: the time that joining takes, and the settings that they need beside this port.

    A notice has the figures of the moment. When another master appears and they have changed, it comes again.
    """

    def __init__(self, params: BusParams, snapshot: Callable[[], BusSnapshot]) -> None:
        self._params = params
        self._snapshot = snapshot
        self._reported: set[str] = set()

    def notices(self, event: Event) -> Iterator[Notice]:
        if not (isinstance(event, MasterSeen) and event.present):
            return
        params, bus = self._params, self._snapshot()
        patience = bus.patience
        if not bus.in_ring and not self._reported:
            within = ns_to_s(pass_ns(params, patience))
            text = (
                f"waiting for master {event.address} to let station {params.address} into the ring: up to "
                f"{within:.1f} s if it is set like this one; a lower hsa on all masters makes it shorter"
            )
            yield self._notice(event.t_ns, text, Severity.INFO)
        lowest = min(bus.las - {params.address}, default=event.address)
        advice = Neighbours(params, patience, lowest).advice()
        if advice and advice not in self._reported:
            yield self._notice(event.t_ns, advice, Severity.WARNING)

    def _notice(self, now: int, text: str, severity: Severity) -> Notice:
        self._reported.add(text)
        return Notice(t_ns=now, source="ring", message=text, severity=severity)


async def join(bus: BusBase, timeout: float | None) -> None:
    """Wait until the station is in the ring, for :func:`join_limit_s` unless ``timeout`` is given. Raises BusError."""
    limit = join_limit_s(bus.params, bus.snapshot.patience) if timeout is None else timeout

    def joined() -> bool:
        if bus.collision is not None:
            raise BusError(bus.collision)
        return bus.snapshot.in_ring

    try:
        await bus.until(joined, limit)
    except TimeoutError:
        raise BusError(why_not_joined(bus.params.address, bus.view, limit)) from None


def why_not_joined(own: int, view: View, after_s: float) -> str:
    """One line for people: the telegrams received up to now, and advice."""
    counters = view.counters()
    late = f"station {own} is not in the token ring after {after_s:g} s"
    others = sorted(view.bus().las - {own})
    if others:
        return (
            f"{late}: masters {', '.join(map(str, others))} do not let it in; "
            f"their HSA must be {own} or more and their GAP on"
        )
    if counters.link.heard:
        requesters = counters.link.without_token
        who = _masters(requesters) if requesters else "a master"
        return (
            f"{late}: {counters.link.heard} telegrams of other stations are heard, and no token: {who} that "
            f"{'pass' if len(requesters) > 1 else 'passes'} none can share the bus with nobody; stop "
            f"{'them' if len(requesters) > 1 else 'it'} first"
        )
    if counters.decoder.octets:
        return f"{late}: what is heard is no PROFIBUS at this rate; check the baud rate, A and B, the termination"
    return f"{late}: nothing is heard and nothing could be sent; check port and cable"


def listening_report(own: int, view: View) -> tuple[str, Severity]:
    """A line about the telegrams that station ``own`` received before it joined the ring, and its severity."""
    counters, las = view.counters(), view.bus().las
    heard, bad = counters.link.heard, counters.decoder.bad
    others = sorted(las - {own})
    unreadable = f"{bad} damaged" if heard else f"{bad} damaged telegrams, no readable one: is this the right rate?"
    words = [f"{heard} telegrams"] if heard else []
    words += [unreadable] if bad else []
    words += [_masters(others)] if others else []
    text = f"listened first: {', '.join(words) or 'silence'}; nobody has address {own}"
    requesters = [address for address in counters.link.without_token if address not in las]
    if not requesters:
        return text, Severity.INFO
    several = len(requesters) > 1
    does = "send requests and pass no token: they" if several else "sends requests and passes no token: it"
    return (
        f"{text}; {_masters(requesters)} {does} and station {own} will garble each other's telegrams; stop one of them"
    ), Severity.WARNING


def _masters(addresses: Sequence[int]) -> str:
    return f"master{'s' if len(addresses) > 1 else ''} {', '.join(map(str, addresses))}"
