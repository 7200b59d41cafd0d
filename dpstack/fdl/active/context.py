"""What the handlers of an active station share: its state, what it is about to send, its deadline, its books.

A handler is a function ``(link, telegram, now)``; which one runs is a matter of the table in
:mod:`dpstack.fdl.active.states`. Inputs that are no telegram come with :data:`NONE`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from dpstack.fdl.active.cycle_window import CycleWindow
from dpstack.fdl.active.fcb import FrameCount
from dpstack.fdl.active.las_gap import Announced, Gap, News, Ring
from dpstack.fdl.active.states import Input, State
from dpstack.fdl.codec import encode_token
from dpstack.fdl.events import MasterSeen, RingLeft
from dpstack.fdl.interface import Failure, LinkStats, LinkUser, Request, StationStats
from dpstack.fdl.telegram import FC_FUNCTION, FC_REQUEST, Kind, Req, Telegram
from dpstack.params import MAX_STATION, BusParams
from dpstack.phy.line import Line
from dpstack.phy.patience import EXACT, Patience
from dpstack.stats import Histogram
from dpstack.trace import Event
from dpstack.units import BITS_PER_CHAR, NEVER

#: T_TO is longer by so many times the slack of a known station
_SLACK_IN_T_TO: Final = 2
#: repetitions of a token get this share of the slack that the first pass gets (but what is there for unknown ones)
_AGAIN: Final = 4
#: beside other masters a token is kept for a cycle that is due within this share of T_SL
_KEPT: Final = 4
TOKEN_OCTETS: Final = 3
#: stands for "no telegram"; told by identity
NONE: Final = Telegram(Kind.SC, -1, -1)
#: stands for "no request"; told by identity
NO_REQUEST: Final = Request(-1, Req.FDL_STATUS)

_NO_PASS: Final = (-1, -1)

# what every telegram needs: an enum's member costs ten times a name of the module
_SC: Final = Kind.SC
_RESPONSE: Final = Input.RESPONSE
_RESPONSE_SEEN: Final = Input.RESPONSE_SEEN

Handler = Callable[["Link", Telegram, int], None]
Rows = tuple[tuple[Handler, ...], ...]


def classify(telegram: Telegram, ts: int) -> Input:
    """What ``telegram`` is to station ``ts``."""
    fc = telegram.fc
    if fc < 0:
        if telegram.kind == _SC:
            return _RESPONSE
        if telegram.da > MAX_STATION or telegram.sa > MAX_STATION:
            return Input.ACTIVITY  # no master can have such an address: a damaged token
        if telegram.sa == ts:
            return Input.OWN_ADDRESS
        return Input.TOKEN_TO_ME if telegram.da == ts else Input.TOKEN_SEEN
    if telegram.sa == ts:
        return Input.OWN_ADDRESS
    if not fc & FC_REQUEST:
        return _RESPONSE if telegram.da == ts else _RESPONSE_SEEN
    if telegram.da != ts:
        return Input.REQUEST_SEEN
    return Input.STATUS_REQUEST if fc & (FC_FUNCTION | 0x80) == Req.FDL_STATUS else Input.REQUEST_TO_ME


@dataclass(slots=True)
class Doubt:
    """Odd answers of one station since its request number ``since``: more than were asked for, and unreadable ones."""

    since: int
    superfluous: int = 0
    unreadable: int = 0
    told_doubled: bool = False
    told_unreadable: bool = False


class Link:
    """The data of one active station. Times in ns; see the groups below."""

    __slots__ = (
        "after_ns",
        "announced",
        "asked",
        "attempt",
        "back_off_until",
        "budget",
        "busy_until",
        "candidate",
        "claim_from",
        "claimed",
        "claims_left",
        "collision_told",
        "deadline",
        "doubted",
        "doubts",
        "early_ns",
        "early_until",
        "edge_at",
        "edge_told",
        "events",
        "exact",
        "fcb",
        "frame",
        "fresh",
        "gap",
        "gap_turn",
        "garbled",
        "gate_ns",
        "in_ring",
        "in_vain",
        "keep_alone_ns",
        "keep_ns",
        "last_pass",
        "last_rotation",
        "leaving",
        "line",
        "line_is_down",
        "made_at",
        "max_retry",
        "owed",
        "own_token_at",
        "params",
        "pass_ns",
        "patience",
        "polling",
        "refused",
        "repeats",
        "request",
        "ring",
        "row",
        "rows",
        "slot_again_ns",
        "slot_known_ns",
        "slot_ns",
        "slot_unknown_ns",
        "slow",
        "staggered",
        "state",
        "stats",
        "t_to_ns",
        "t_tr_ns",
        "taken_at",
        "token_at",
        "token_rotation",
        "told_forced",
        "told_le3",
        "tries_left",
        "ts",
        "tx",
        "until",
        "user",
        "users",
        "users_at",
        "wanted",
        "wrong",
    )  # fmt: skip

    def __init__(self, params: BusParams, users: Sequence[LinkUser], patience: Patience, rows: Rows, now: int) -> None:
        self.params = params
        self.ts = params.address
        self.users: tuple[LinkUser, ...] = tuple(users)
        self.users_at = NEVER  # the earliest time a user wants its tick
        self.patience = patience
        self.rows = rows
        self.line = Line(params, now)
        self.ring = Ring(self.ts)
        self.gap = Gap(params)
        self.fcb = FrameCount()
        self.stats = LinkStats()
        self.events: list[Event] = []
        self.state = State.OFFLINE
        self.row = rows[State.OFFLINE]
        self.set_times(now)

        # what goes out next, and when
        self.tx: bytes | None = None
        self.gate_ns = 0  # silence that has to precede tx
        self.staggered = 0  # so many tokens to ourselves are delayed by TS bit times
        self.after_ns = self.line.t_id1_ns  # silence that has to follow what was on the line last
        self.taken_at = 0  # first bit of the last transmission
        self.made_at = 0  # the last request of a user was made
        self.deadline = NEVER
        # what is on the line now
        self.busy_until = 0  # a telegram is arriving; deadlines and starts wait so long
        self.edge_at = 0  # first bit of what is arriving
        self.edge_told = False
        # membership
        self.wanted = False
        self.leaving = False
        self.line_is_down = False
        self.in_ring = False
        self.announced = Announced()
        self.refused = -1  # sender of a token refused once
        self.last_pass = _NO_PASS  # SA and DA of the last token between others, while nothing else followed
        self.in_vain = -1  # who repeated that pass: its NS is silent
        self.claims_left = 0
        self.claimed = False
        self.claim_from = State.LISTEN_TOKEN
        self.own_token_at = -NEVER  # when a token with SA = TS was seen last
        self.collision_told = False
        self.back_off_until = 0
        # the token hold
        self.token_at = -1  # last receipt of the token, -1 when out of the ring
        self.until = 0  # end of T_TH
        self.fresh = False  # nothing was sent in this hold yet
        self.budget = CycleWindow()
        self.told_forced: set[int | None] = set()  # services (SAPs) of which was told that they fit into no gap
        self.gap_turn = False  # low priority stands back for the GAP in this hold
        self.attempt = 0  # of passing the token
        self.last_rotation = 0
        self.token_rotation = Histogram()
        # the exchange under way
        self.end_exchange()
        self.frame = b""
        self.asked = StationStats()  # counters of the station asked last
        self.tries_left = 0
        self.repeats = 0
        self.polling = -1  # address of the GAP poll under way
        self.early_until = -NEVER  # what begins before this cannot be the answer
        self.wrong = False
        self.garbled = False  # octets came that are no telegram (yet)
        self.told_le3: set[int] = set()  # stations whose answers with LE = 3 were told
        #: stations that answered late: they are there, and given the slack of a known one until they are silent again
        self.slow: set[int] = set()
        #: stations that left a request unanswered since their last GAP poll: no slack beyond anybody's for the next one
        self.doubted: set[int] = set()
        #: exchanges whose answer may still come: request and until when, by address
        self.owed: dict[int, tuple[Request, int]] = {}
        #: stations with odd answers, by address
        self.doubts: dict[int, Doubt] = {}

    def set_times(self, now: int) -> None:
        """Work out all durations from ``params`` and ``patience``."""
        params, patience, line = self.params, self.patience, self.line
        #: nothing is delivered late, edges are told
        self.exact = patience == EXACT
        # Octets are seen at their end: without edges the slot time counts from there.
        self.slot_ns = slot_ns = line.t_sl_ns if self.exact else params.ns(params.t_sl + BITS_PER_CHAR)
        self.slot_known_ns = slot_ns + patience.known_ns
        self.slot_unknown_ns = slot_ns if self.exact else patience.silent_ns(params)
        # A stalled host had its time at the first pass: repetitions are for a damaged token.
        self.slot_again_ns = slot_ns + max(patience.known_ns // _AGAIN, patience.unknown_ns)
        # The holder may be silent for T_SL and its slack, and notice the end of that late by as much. With the slack
        # once (5 ms more than a known station's answer is waited for) a busy computer lost the token with every master
        # that left, and two rings stood side by side (measured).
        self.t_to_ns = line.t_to_ns + _SLACK_IN_T_TO * patience.known_ns
        self.t_tr_ns = params.ns(params.t_tr)
        self.max_retry = params.max_retry
        # A fixed cycle that is due so soon begins with this token. With others in the ring a silence that is far from
        # their T_SL; alone any start is caught between two tokens to ourselves, far from anybody's T_TO (600 bits).
        self.keep_ns = line.t_sl_ns // _KEPT
        # the token to ourselves, until the next request may follow it
        self.pass_ns = params.ns(TOKEN_OCTETS * BITS_PER_CHAR) + line.t_id1_ns + patience.sending_ns
        self.keep_alone_ns = line.t_sl_ns + 2 * self.pass_ns
        # half a bit of tolerance: telegram and pause are rounded to ns apart from each other
        self.early_ns = params.ns(params.min_tsdr) - params.ns(1) // 2
        self.gap.limit(patience, self.slot_unknown_ns, now)

    def forget_pass(self) -> None:
        """The token has gone on: what was seen of the last pass does not count any more."""
        self.last_pass = _NO_PASS
        self.in_vain = -1

    def end_exchange(self) -> None:
        """No exchange is under way (any more); the caller tells the user."""
        self.user: LinkUser | None = None
        self.request = NO_REQUEST
        self.candidate = NONE

    def knows(self, address: int) -> bool:
        """It answered our last GAP poll, if late, or answers our requests: its silence would be news."""
        if self.fcb.operational[address] or address in self.slow:
            return True
        return address in self.gap.stations and address not in self.doubted

    def ask_times(self) -> None:
        """A user was called that may want its tick at another time now."""
        self.users_at = min((user.wake_at() for user in self.users), default=NEVER)

    # --- states and sending -------------------------------------------------------------------------------------
    def enter(self, state: State) -> None:
        """Change state; the deadline of the old one is gone."""
        self.state = state
        self.row = self.rows[state]
        self.deadline = NEVER

    def dispatch(self, what: Input, telegram: Telegram, now: int) -> None:
        """Run the handler of ``what`` in the present state."""
        self.row[what](self, telegram, now)

    def queue(self, octets: bytes) -> None:
        """Send ``octets`` as soon as the gate after the last telegram opens."""
        self.tx = octets
        self.gate_ns = self.after_ns

    def reply(self, octets: bytes) -> None:
        """Answer another master after min T_SDR."""
        self.tx = octets
        self.gate_ns = self.line.t_sdr_ns

    def stagger(self) -> None:
        """Alone all at once: another one may be, in step and unheard; a GAP pass long the tokens to ourselves differ.

        With the GAP off nobody else is expected.
        """
        self.staggered = self.params.hsa + 1 if self.gap.enabled else 0

    def queue_token(self, da: int) -> None:
        """Queue the token to ``da``."""
        self.queue(encode_token(da, self.ts))

    def tx_at(self) -> int:
        """When the waiting telegram may start."""
        at = self.line.idle_since + self.gate_ns
        return at if at > self.busy_until else self.busy_until

    def await_silence(self) -> None:
        """Arm T_TO: counted from the last activity."""
        self.deadline = self.line.idle_since + self.t_to_ns

    # --- ways out of a state that several handlers take -----------------------------------------------------------
    def abandon(self, now: int) -> None:
        """Drop what is waiting or under way; its user is told."""
        self.tx = None
        self.polling = -1
        user, request = self.user, self.request
        self.end_exchange()
        if user is not None:
            user.result(request, Failure.ABANDONED, now)
            self.ask_times()

    def go_idle(self, now: int) -> None:
        """Somebody else has the token: Active_Idle, or Offline when this was the last hold."""
        if self.leaving:
            self.go_offline(now, "ordered")
            return
        self.enter(State.ACTIVE_IDLE)
        self.await_silence()

    def go_offline(self, now: int, reason: str) -> None:
        self.abandon(now)
        self.leave_ring(now, reason)
        self.leaving = False
        self.busy_until = 0
        self.owed.clear()
        self.enter(State.OFFLINE)

    def go_listening(self, now: int) -> None:
        """Begin to listen: nothing is known of the ring."""
        self.ring.forget()
        for address in sorted(self.announced.masters):
            self.tell_master(address, now)
        self.enter(State.LISTEN_TOKEN)
        self.await_silence()

    def leave_ring(self, now: int, reason: str) -> None:
        """Out of the ring; told once."""
        self.token_at = -1
        self.refused = -1
        self.forget_pass()
        self.ring.forget()
        self.announced.forget()
        if self.in_ring:
            self.in_ring = False
            self.events.append(RingLeft(t_ns=now, address=self.ts, reason=reason))

    def tell_master(self, address: int, now: int) -> None:
        """Tell that a master came or went, unless it was told; it did so beyond doubt."""
        self._tell(self.announced.certain(address, address in self.ring.members), now)

    def heard_token(self, sa: int, now: int) -> None:
        """A token from ``sa`` is in the LAS: tell what is certain now of masters that came and went."""
        if self.ring.learned or self.in_ring:
            self._tell(self.announced.token(sa, frozenset(self.ring.members) - {self.ts}), now)

    def _tell(self, news: News, now: int) -> None:
        for address, present in news:
            before = present and not self.in_ring
            self.events.append(MasterSeen(t_ns=now, address=address, present=present, before=before))
