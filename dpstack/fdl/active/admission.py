"""How long a request can take, how long its answer is waited for, and whether it may start before the next cycle."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from dpstack.fdl.active.cycle_window import CycleWindow
from dpstack.fdl.active.las_gap import Ring
from dpstack.fdl.active.parts import ActiveLine, Times
from dpstack.fdl.active.peers import Peers
from dpstack.fdl.active.services import SERVICES
from dpstack.fdl.describe import request_name
from dpstack.fdl.events import DoesNotFit
from dpstack.fdl.interface import Request
from dpstack.trace import Event
from dpstack.units import chars_to_ns

#: octets around the data unit of SD2, those of SD1, and those of two SAPs
_FRAME: Final = 9
_SD1: Final = 6
_SAPS: Final = 2


@dataclass(slots=True, eq=False)
class Admission:
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
        """Whether the station may send a request that is no part of the cycle now; ``then_ns``: time of the telegrams
        that have to follow it."""
        window = self.window
        until = self.ends_at(request, now) + then_ns
        if not window.admits((request.function, request.da, request.dsap), until):
            return False
        if until > window.next_at:
            name = request_name(request)
            window.set_forced(f"{name} to station {request.da}")
            if request.dsap not in self._reported:
                self._reported.add(request.dsap)
                slack_ns = self.times.patience.unknown_ns if self.waits_long(request) else 0
                self.events.append(
                    DoesNotFit(t_ns=now, service=name, address=request.da, takes_ns=until - now, slack_ns=slack_ns)
                )
        return True

    def unanswered(self, request: Request, now: int) -> None:
        """No station answered ``request``: note the service if its time-out ended after the next cycle was due."""
        if now > self.window.next_at:
            self.window.set_unanswered(f"{request_name(request)} to station {request.da}")

    def waits_long(self, request: Request) -> bool:
        """Whether the answer to ``request`` gets the slack of a station whose silence would be news."""
        return request.patient or self.peers.is_slow(request.da) or self.peers.knows(request.da)

    def kept_back_ns(self) -> int:
        """An answer that may be a late one is kept back so long."""
        return self.line.t_sl_ns + self.times.patience.known_ns // 4

    def ends_at(self, request: Request, now: int) -> int:
        """When ``request``, asked for now, and the idle time after it are over at the latest, in ns: every attempt in
        vain but the last one, whose answer begins at the end of its slot time and has all the octets it may have.

        Where a station that is there is given more slack than its port usually needs, it is taken to answer the first
        attempt within what is usual: its silence costs a service what it costs a Data_Exchange. Nobody known to be
        there is waited for as long as there is room (:meth:`in_vain_until`).
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
        """How long the answer of an address where nobody is known is waited for: ``at`` is the last bit of ``request``.

        A port may be late, and one look longer than others (``extra_ns``), but before a fixed cycle ``then_ns`` (what
        follows) and T_ID1 have to fit in: as long as there is room, and never so short that an answer could still be on
        the wire. One that is later than that is recognised.
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
        """Of ``extra_ns`` what makes nobody wait longer than for a station that is there, and no other master on a wire
        claim the token meanwhile. (Where there is no wire the others are programs with a slack of their own.)
        """
        times, ring = self.times, self.ring
        params, patience = times.params, times.patience
        extra = min(request.extra_ns, patience.known_ns - patience.unknown_ns)
        if patience.sending_ns and ring.ns != ring.ts:
            lowest = min(address for address in ring.members if address != ring.ts)
            t_to_ns = params.ns(params.t_to_of(lowest))
            extra = min(extra, t_to_ns - times.slot_unknown_ns - patience.unknown_ns)
        return max(0, extra)
