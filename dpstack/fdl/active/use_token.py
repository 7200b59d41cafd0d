"""Handlers of a token hold: Use_Token, Check_Access_Time, the GAP poll; withdrawing from a token that is not ours."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.fdl.active.admission import Admission
from dpstack.fdl.active.cycle_window import CycleWindow
from dpstack.fdl.active.exchange import NO_REQUEST, Exchange
from dpstack.fdl.active.las_gap import Gap
from dpstack.fdl.active.listen_idle_claim import Waiting
from dpstack.fdl.active.parts import Awaiting, Common, Parts
from dpstack.fdl.active.pass_token import TokenPass
from dpstack.fdl.active.states import AWAIT_STATUS_RESPONSE, NONE, USE_TOKEN
from dpstack.fdl.codec import encode_sd1
from dpstack.fdl.events import StationFound
from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import FC_REQUEST, Kind, Req, StationType, Telegram
from dpstack.stats import Histogram
from dpstack.trace import Notice, Severity
from dpstack.units import NEVER

#: Returns the reason why a request must not be sent, or None. It checks the requests of all users, so that no defect of
#: a user can write on a read-only bus.
Guard = Callable[[Request], str | None]

_STATUS_FC: Final = FC_REQUEST | Req.FDL_STATUS
#: after this number of holds without time for a due GAP poll, the station sends it before low-priority requests
_GAP_PATIENCE: Final = 8


class GapPoll(Awaiting):
    """The current GAP poll. Handlers of Await_Status_Response."""

    __slots__ = ("admission", "exchange", "gap", "passing", "request")

    def __init__(self, common: Common, gap: Gap, exchange: Exchange, admission: Admission, passing: TokenPass) -> None:
        super().__init__(common)
        self.gap = gap
        self.exchange = exchange
        self.admission = admission
        self.passing = passing
        self.request = NO_REQUEST

    def start(self, now: int, until: int) -> bool:
        """Queue a GAP poll if one is due, T_TH is not over (``until``) and the allowance of silent polls permits it."""
        gap = self.gap
        address = gap.due(self.membership.ring.ns, now)
        if address < 0:
            return False
        if now >= until:
            gap.skipped += 1
            return False
        if not self.peers.knows(address) and not gap.allowance.allows(now):
            return False
        request = Request(address, Req.FDL_STATUS, retry=False, answer=0)
        admission = self.admission
        if admission.window.next_at != NEVER and not admission.admits(request, now, self.times.pass_ns):
            return False
        self.request = request
        self.machine.enter(USE_TOKEN)
        self.line.queue(encode_sd1(address, self.line.ts, _STATUS_FC))
        return True

    def sent(self, at: int) -> None:
        """The poll is on the line; its last bit at ``at``."""
        request, times = self.request, self.times
        self.stats.gap_polls += 1
        self.garbled = False  # octets before the poll are no part of its answer
        if self.peers.knows(request.da):
            deadline = at + times.slot_known_ns
        else:
            deadline = self.admission.in_vain_until(request, at, times.pass_ns)
        self.machine.enter(AWAIT_STATUS_RESPONSE, deadline)
        if times.exact:
            self.early_until = at + times.early_ns

    def status(self, telegram: Telegram, now: int) -> None:
        """The answer of the address polled: a ready master becomes NS (docs/reference/protocol.md#gap-update)."""
        request, membership = self.request, self.membership
        plain = not telegram.data and telegram.dsap is telegram.ssap is None and telegram.kind != Kind.SC
        if telegram.sa != request.da or not plain or self.line.edge_at < self.early_until:
            self.garbled = False
            self.exchange.late(telegram, now)
            return
        kind = telegram.station_type
        self._over(request.da, kind, now)
        # 'in ring' from a station outside of the LAS: it lost its token as this station did, so add it to the LAS
        if kind >= StationType.MASTER_READY and membership.ring.add(request.da):
            membership.report_master(request.da, now)
        self.passing.start(now)

    def timeout(self, _: Telegram, now: int) -> None:
        """No station answered the GAP poll in time. Unreadable octets prove neither presence nor absence."""
        request, peers, times = self.request, self.peers, self.times
        known = peers.knows(request.da)
        peers.attempt_failed(request.da)
        self._over(request.da, None, now)
        if known:
            peers.expect_late(request, now, times.slot_known_ns)
            self.admission.unanswered(request, now)
        else:
            self.gap.allowance.charge(times.slot_unknown_ns)
            if self.admission.window.next_at != NEVER and not times.exact:  # the time-out may have been shorter
                peers.expect_late(request, now, times.slot_unknown_ns)
        self.passing.start(now)

    def _over(self, address: int, kind: StationType | None, now: int) -> None:
        self.peers.polled(address, kind is not None)
        if kind is None and self.garbled:
            self.gap.passed(address)
        elif self.gap.polled(address, kind):
            found = StationFound(t_ns=now, address=address, kind=kind)
            self.events.append(found)
            self.users.broadcast(found, now)  # users may act at once


class TokenHold(Parts):
    """A token hold. Handlers of Use_Token and Check_Access_Time, and of the end of a hold in other states."""

    __slots__ = (
        "_fresh",
        "_gap_turn",
        "_refusals",
        "_token_at",
        "_until",
        "admission",
        "exchange",
        "gap",
        "guard",
        "passing",
        "poll",
        "token_rotation",
        "tokens",
        "waiting",
        "window",
    )

    def __init__(
        self,
        common: Common,
        gap: Gap,
        exchange: Exchange,
        admission: Admission,
        window: CycleWindow,
        passing: TokenPass,
        poll: GapPoll,
        waiting: Waiting,
        guard: Guard | None,
    ) -> None:
        super().__init__(common)
        self.gap = gap
        self.exchange = exchange
        self.admission = admission
        self.window = window
        self.passing = passing
        self.poll = poll
        self.waiting = waiting
        self.guard = guard
        self.token_rotation = Histogram()
        #: tokens received and used (:attr:`LinkStats.tokens`): a Struct takes ten times as long to count
        self.tokens = 0
        self._token_at = 0  # last receipt of the token
        self._until = 0  # end of T_TH
        self._fresh = False  # the station has sent nothing in this hold yet
        self._gap_turn = False  # the GAP poll goes before low-priority requests in this hold
        self._refusals: set[str] = set()  # reasons already reported

    def begin(self, _: Telegram, now: int) -> None:
        """A token hold begins: T_TH = T_TR - T_RR, so it ends one T_TR after the previous receipt
        (docs/reference/protocol.md#token-rotation)."""
        before, self._token_at = self._token_at, now
        in_ring = self.membership.in_ring
        self._until = (before if in_ring else now) + self.times.t_tr_ns
        if in_ring:
            self.token_rotation.add(now - before)
        self._fresh = True
        self.window.alone = self.membership.ring.ns == self.line.ts
        self._gap_turn = self.gap.skipped >= _GAP_PATIENCE
        self.tokens += 1
        if not in_ring:
            self.membership.join(now)
        self.resume(NONE, now)

    def resume(self, _: Telegram, now: int) -> None:
        """Ask the users: a hold begins, or the cycle is due for which the station kept the token.

        (With hardly any time between two cycles the station keeps the token for the whole of T_TH.)
        """
        for user in self.users.all:
            user.token_received(now)
        self.users.update_due()
        self.machine.check(now)

    def check(self, _: Telegram, now: int) -> None:
        """Choose the next telegram: high priority once even after T_TH, others within T_TH, then GAP, then token."""
        if not self.membership.leaving:
            in_time = now < self._until
            if in_time or self._fresh:
                high_only = self._gap_turn if in_time else True
                for user, next_request in self.users.asked:
                    request = next_request(now, high_only)
                    if request is None:
                        continue
                    if self.guard is not None and (reason := self.guard(request)) is not None:
                        self._refuse(user, request, reason, now)
                        continue
                    if not (request.cyclic or self.window.next_at == NEVER or self.admission.admits(request, now)):
                        user.result(request, Failure.HELD_BACK, now)
                        continue
                    self._fresh = False
                    self.exchange.start(user, request, now)
                    return
            if self.gap.enabled and self.poll.start(now, self._until):
                self._fresh = False
                return
            window = self.window
            if now < window.next_at != NEVER and (in_time or self._fresh):
                keep_ns = self.times.keep_alone_ns if window.alone else self.times.keep_ns
                # the user gets the result of an SDN before its last bit: the token cannot go on before this time
                free_at = max(now, self.line.idle_since + self.line.after_ns)
                if window.next_at - free_at <= keep_ns:
                    # keep the token for the next cycle and stay silent until then
                    self.machine.enter(USE_TOKEN, window.next_at)
                    return
        self.passing.start(now, unused=self._fresh)

    def _refuse(self, user: LinkUser, request: Request, reason: str, now: int) -> None:
        """Count a refusal of the guard; report it once for each kind of request."""
        self.stats.refused += 1
        if reason not in self._refusals:
            self._refusals.add(reason)
            self.events.append(Notice(t_ns=now, source="fdl", message=reason, severity=Severity.ERROR))
        user.result(request, Failure.REFUSED, now)

    def reconsider(self, now: int) -> None:
        """A user got an order: if the station keeps the token for a cycle, choose the next telegram anew."""
        machine = self.machine
        if machine.state is USE_TOKEN and self.line.tx is None and machine.deadline != NEVER:
            machine.check(now)

    def withdraw(self, telegram: Telegram, now: int) -> None:
        """Another station sends as only a token holder does: give up the hold. Active_Idle handles ``telegram``."""
        ts, ps = self.line.ts, self.membership.ring.ps
        repeated = telegram.kind == Kind.SD4 and telegram.da == ts and telegram.sa == ps
        if repeated and self.machine.state is USE_TOKEN:
            return  # the predecessor missed the start of this hold; the token is still here
        self.stats.withdrawn += 1
        self.exchange.abandon(now)
        self.waiting.go_idle(now, telegram)

    def leave(self, _: Telegram, now: int) -> None:
        """Go offline after the current request or pass, without repetitions."""
        self.membership.leaving = True

    def leave_now(self, _: Telegram, now: int) -> None:
        """Go offline at once: drop the queued telegram and pass the token."""
        self.membership.leaving = True
        self.exchange.abandon(now)
        self.passing.start(now)
