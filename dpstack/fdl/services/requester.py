"""The user of the link layer that sends the requests of a program: a bounded queue.

It is asked after the DP master and the acyclic services of the same station. High priority goes before low; within one
priority the order of the calls counts. Its share of the token hold: ``per_hold`` requests at most (1 beside a DP
master), low priority only while T_TH lasts, and no request that could run into the next fixed cycle
(:mod:`dpstack.fdl.active.cycle_window`). Every request has exactly one end, :class:`FdlConfirmed`.
"""

from __future__ import annotations

from typing import Final, Protocol

from msgspec import Struct

from dpstack.errors import UsageError
from dpstack.fdl.commands import AttachUser
from dpstack.fdl.interface import LONG_NS, ActiveResponder, Failure, LinkUser, Request
from dpstack.fdl.services.confirmations import FUNCTIONS, WITH_DATA, Confirmation, FdlService, confirmation_of
from dpstack.fdl.services.identity import Ident
from dpstack.fdl.services.orders import (
    CAPACITY,
    CancelFdl,
    CloseSap,
    FdlConfirmed,
    FdlGuard,
    FdlRequest,
    OpenSap,
    TakenIndications,
    UpdateReply,
    fault_of,
)
from dpstack.fdl.services.saps import SapTable
from dpstack.fdl.telegram import MAX_DATA, Telegram
from dpstack.machine import LineDown
from dpstack.params import BusParams
from dpstack.phy.patience import Patience
from dpstack.trace import Event
from dpstack.units import NEVER, ns_to_s

#: SAP octets that a telegram without them has room for
_SAPS: Final = 2
_UNLIMITED: Final = 1 << 30


class FdlHost(Protocol):
    """The station as the FDL services see it."""

    #: why a request must not be sent beside the DP master of the same station; None: there is no such master
    fdl_guard: FdlGuard | None

    @property
    def in_ring(self) -> bool:
        """Whether the station is in the token ring."""

    def respond_with(self, responder: ActiveResponder | None) -> None:
        """Let ``responder`` answer the requests of other masters; None: RS to all."""


class _Entry(Struct, eq=False):
    order: FdlRequest
    deadline: int
    #: its first bit was on the wire
    sent: bool = False
    #: it was not sent, because it might have run into the next fixed cycle
    held_back: bool = False


class FdlUser(LinkUser):
    """A ``LinkUser``. ``per_hold``: requests in a token hold at most, 0: as many as T_TH permits."""

    def __init__(self, params: BusParams, *, per_hold: int = 1, ident: Ident | None = None) -> None:
        self._own = params.address
        self._per_hold = per_hold or _UNLIMITED
        self._left = 0
        self._high: list[_Entry] = []
        self._low: list[_Entry] = []
        self._asked: _Entry | None = None
        #: stations that answered their last request: the next one waits longer for its answer
        self._known: set[int] = set()
        self._host: FdlHost | None = None
        self.events: list[Event] = []
        #: the SAPs of this station
        self.saps = SapTable(params.address, self.events, ident or Ident())

    def attached(self, station: object) -> None:
        host: FdlHost = station  # type: ignore[assignment]
        self._host = host
        self.saps.guarded = host.fdl_guard is not None
        host.respond_with(self.saps)

    def detached(self) -> None:
        if self._host is not None:
            self._host.respond_with(None)

    @property
    def waiting(self) -> int:
        """Requests that are not over yet."""
        return len(self._high) + len(self._low) + (self._asked is not None)

    # --- orders -------------------------------------------------------------------------------------------------
    def command(self, command: object, now: int) -> bool:
        """Carry out an order of :mod:`dpstack.fdl.services.orders`. Raises UsageError for one that cannot be."""
        match command:
            case FdlRequest():
                self._queue(command, now)
            case CancelFdl(token):
                for queue in (self._high, self._low):
                    queue[:] = [entry for entry in queue if entry.order.token != token]
            case OpenSap() | CloseSap() | UpdateReply() | TakenIndications():
                self.saps.command(command)
            case LineDown(reason):
                for entry in (*self._high, *self._low):
                    self._end(entry, Confirmation.DS, now, f"the port vanished ({reason})")
                self._high.clear()
                self._low.clear()
                self._known.clear()
                self.saps.forget()
                return False
            case _:
                return False
        return True

    def _queue(self, order: FdlRequest, now: int) -> None:
        """Queue ``order``, or end it at once: IV, LS, LR. Raises UsageError if it is refused beside a DP master."""
        refused = self._refusal(order)
        if refused:
            raise UsageError(refused)
        entry = _Entry(order, now + order.timeout_ns)
        fault = fault_of(order, self._own)
        if fault:
            self._end(entry, Confirmation.IV, now, fault)
        elif order.service in WITH_DATA and self.saps.is_deactivated(order.ssap):
            self._end(entry, Confirmation.LS, now)
        elif self.waiting >= CAPACITY:
            self._end(entry, Confirmation.LR, now, f"{CAPACITY} requests wait already")
        else:
            (self._high if order.high else self._low).append(entry)

    def _refusal(self, order: FdlRequest) -> str | None:
        host = self._host
        return None if host is None or host.fdl_guard is None else host.fdl_guard(order)

    # --- link user ----------------------------------------------------------------------------------------------
    def token_received(self, now: int) -> None:
        """Allow ``per_hold`` requests in this hold."""
        self._left = self._per_hold

    def next_request(self, now: int, high_only: bool) -> Request | None:
        queue = self._high or ([] if high_only else self._low)
        if not queue or self._left <= 0:
            return None
        entry = queue.pop(0)
        refused = self._refusal(entry.order)
        if refused:  # a slave was added since
            self._end(entry, Confirmation.IV, now, refused)
            return self.next_request(now, high_only)
        self._left -= 1
        self._asked = entry
        order = entry.order
        low, high = FUNCTIONS[order.service]
        known = order.address in self._known
        return Request(
            order.address,
            high if order.high else low,
            order.data,
            order.dsap,
            order.ssap,
            patient=known,
            extra_ns=0 if known else LONG_NS,
            answer=_longest_answer(order),
            yields=True,
        )

    def started(self, request: Request, at: int) -> None:
        if self._asked is not None:
            self._asked.sent = True

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        entry, self._asked = self._asked, None
        if entry is None:
            return
        if outcome is Failure.HELD_BACK or (outcome is Failure.ABANDONED and not entry.sent):
            (self._high if entry.order.high else self._low).insert(0, entry)
            self._left = 0  # not before the next hold
            entry.held_back = entry.held_back or outcome is Failure.HELD_BACK
            return
        order = entry.order
        status, remark = confirmation_of(order.service, outcome)
        if isinstance(outcome, Telegram):
            if order.service is not FdlService.SDN:
                self._known.add(order.address)
            kind = outcome.fc >> 4 & 3 if outcome.fc >= 0 else None
            self._end(entry, status, now, remark, outcome.data, kind)
            return
        if outcome is Failure.NO_ANSWER:
            self._known.discard(order.address)
        elif outcome is Failure.ABANDONED:
            remark = "this station left the ring during the request; the remote station may have taken it"
        self._end(entry, status, now, remark)

    def wake_at(self) -> int:
        at = NEVER
        for entry in self._high:
            at = min(at, entry.deadline)
        for entry in self._low:
            at = min(at, entry.deadline)
        return at

    def tick(self, now: int) -> None:
        """End the requests that have waited too long for their turn."""
        host = self._host
        for queue in (self._high, self._low):
            late = [entry for entry in queue if entry.deadline <= now]
            if late:
                queue[:] = [entry for entry in queue if entry.deadline > now]
            for entry in late:
                limit = f"{ns_to_s(entry.order.timeout_ns):g} s"
                if host is not None and not host.in_ring:
                    self._end(entry, Confirmation.DS, now, f"not in the ring for {limit}")
                elif entry.held_back:
                    why = "give a longer cycle_ms, or a smaller reply_max"
                    self._end(entry, Confirmation.LR, now, f"it fitted between no two fixed cycles in {limit}: {why}")
                else:
                    self._end(entry, Confirmation.LR, now, f"no token hold had time for it within {limit}")

    def take_events(self) -> list[Event]:
        taken = self.events.copy()
        self.events.clear()
        return taken

    def _end(
        self,
        entry: _Entry,
        status: Confirmation,
        now: int,
        remark: str = "",
        data: bytes = b"",
        kind: int | None = None,
    ) -> None:
        order = entry.order
        self.events.append(
            FdlConfirmed(
                t_ns=now,
                token=order.token,
                service=order.service,
                address=order.address,
                status=status,
                data=data,
                kind=kind,
                remark=remark,
            )
        )


class AttachFdl(AttachUser):
    """Attach the FDL services to the station. ``per_hold``: requests in a token hold at most (0: as T_TH permits).

    ``ident``: the station's own answer to Request Ident.
    """

    per_hold: int = 1
    ident: Ident = Ident()

    def link_user(self, params: BusParams, patience: Patience, now: int) -> FdlUser:
        return FdlUser(params, per_hold=self.per_hold, ident=self.ident)


def _longest_answer(order: FdlRequest) -> int:
    """The largest number of data octets in the answer, as :class:`Request` counts them."""
    match order.service:
        case FdlService.FDL_STATUS | FdlService.SDA | FdlService.SDN:
            return 0
        case _:
            most = MAX_DATA if order.dsap is not None else MAX_DATA + _SAPS
            return most if order.reply_max is None else min(most, order.reply_max)
