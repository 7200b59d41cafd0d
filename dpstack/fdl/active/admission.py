"""The longest duration of a request, the time-out of its answer, and whether it may start before the next cycle."""

from __future__ import annotations

from typing import Final

from msgspec import Struct, field

from dpstack.fdl.active.cycle_window import CycleWindow
from dpstack.fdl.active.las_gap import Ring
from dpstack.fdl.active.parts import ActiveLine, Times
from dpstack.fdl.active.peers import Peers
from dpstack.fdl.active.services import SERVICES
from dpstack.fdl.events import DoesNotFit
from dpstack.fdl.interface import Request
from dpstack.fdl.service_names import request_name
from dpstack.trace import Event
from dpstack.units import chars_to_ns

#: octets around the data unit of SD2, those of SD1, and those of two SAPs
_FRAME: Final = 9
_SD1: Final = 6
_SAPS: Final = 2


class Admission(Struct, eq=False):
    """The rule of :mod:`dpstack.fdl.active.cycle_window`, applied to the requests of one station."""

    times: Times
    line: ActiveLine
    ring: Ring
    peers: Peers
    window: CycleWindow
    events: list[Event]
    #: SAPs of services that the station has reported as too long for every window
    _reported: set[int | None] = field(default_factory=set)

    def admits(self, request: Request, now: int, then_ns: int = 0) -> bool:
        """Whether the station may now send a request that is no part of the cycle.

        ``then_ns``: duration of the telegrams that have to follow it.
        """
        window = self.window
        until = self.ends_at(request, now) + then_ns
        if request.yields and until > window.next_at:
            window.held_back += 1
            return False
        if not window.admits((request.function, request.da, request.dsap), until):
            return False
        if until > window.next_at:
            name = request_name(request)
            window.forced_service = f"{name} to station {request.da}"
            if request.dsap not in self._reported:
                self._reported.add(request.dsap)
                slack_ns = self.times.patience.unknown_ns if self.waits_long(request) else 0
                self.events.append(
                    DoesNotFit(t_ns=now, service=name, address=request.da, takes_ns=until - now, slack_ns=slack_ns)
                )
        return True

    def unanswered(self, request: Request, now: int) -> None:
        """``request`` has no answer: note the service if its time-out ended after the next cycle was due."""
        if now > self.window.next_at:
            self.window.unanswered = f"{request_name(request)} to station {request.da}"

    def waits_long(self, request: Request) -> bool:
        """Whether the answer to ``request`` gets the slack of a known station."""
        return request.patient or self.peers.knows(request.da)

    def kept_back_ns(self) -> int:
        """The time for which the station keeps back an answer that may belong to an earlier request."""
        return self.line.t_sl_ns + self.times.patience.known_ns // 4

    def ends_at(self, request: Request, now: int) -> int:
        """The latest end of ``request``, made now, and of the idle time after it, in ns.

        In the worst case every attempt but the last fails, and the last answer begins at the end of its slot time and
        has the largest number of octets. If a known station gets more slack than its port usually needs, one attempt
        with the usual slack counts. An unknown address counts without slack: its time-out depends on the time left
        (:meth:`in_vain_until`).
        """
        times, line = self.times, self.line
        params, patience = times.params, times.patience
        service = SERVICES[request.function]
        begins = max(now, line.idle_since + line.after_ns)
        octets = len(request.data) + (_SAPS if request.dsap is not None else 0)
        sending = chars_to_ns(octets + _FRAME if octets else _SD1, params.baud) + patience.sending_ns
        if not service.answered:
            return begins + sending + line.t_id2_ns
        tries = params.max_retry if request.retry else 0
        if service.counted and (request.restart or not self.peers.fcb.operational[request.da]):
            tries = 0
        if not self.waits_long(request):
            slot = times.slot_ns
        elif patience.known_ns > patience.unknown_ns:
            slot, tries = times.slot_unknown_ns, 0
        else:
            slot = times.slot_known_ns
        kept = self.kept_back_ns() if self.peers.may_confuse(request, now) else 0
        return begins + (tries + 1) * (sending + slot) + self._longest_answer_ns(request) + kept + line.t_id1_ns

    def in_vain_until(self, request: Request, at: int, then_ns: int = 0) -> int:
        """End of the time-out for an unknown address, in ns. ``at``: time of the last bit of ``request``.

        The time-out includes the slack of the port and ``extra_ns`` of the request, as far as ``then_ns`` (duration of
        the telegrams that follow) and T_ID1 fit before the next fixed cycle. It is never so short that an answer could
        still be on the wire. The station recognises a later answer as late.
        """
        times, next_at = self.times, self.window.next_at
        longest = at + times.slot_unknown_ns + (self._extra_ns(request) if request.extra_ns else 0)
        then_ns += self.line.t_id1_ns
        if next_at >= longest + then_ns:
            return longest
        shortest = at + times.slot_ns + times.patience.sending_ns + self._longest_answer_ns(request)
        return min(longest, max(shortest, next_at - then_ns))

    def _longest_answer_ns(self, request: Request) -> int:
        return chars_to_ns(request.answer + _SAPS + _FRAME, self.times.params.baud)

    def _extra_ns(self, request: Request) -> int:
        """The part of ``extra_ns`` that is allowed: the time-out stays within that of a known station and T_TO of other
        masters on a wire. (Without a wire the other masters are programs with their own slack.)
        """
        times, ring = self.times, self.ring
        params, patience = times.params, times.patience
        extra = min(request.extra_ns, patience.known_ns - patience.unknown_ns)
        if patience.sending_ns and ring.ns != ring.ts:
            lowest = min(address for address in ring.members if address != ring.ts)
            t_to_ns = params.ns(params.t_to_of(lowest))
            extra = min(extra, t_to_ns - times.slot_unknown_ns - patience.unknown_ns)
        return max(0, extra)
