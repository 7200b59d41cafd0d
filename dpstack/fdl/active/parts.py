"""The parts that the states of an active station share: durations, line, state machine, users of the link layer."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from dpstack.fdl.active.membership import Membership
from dpstack.fdl.active.peers import Peers
from dpstack.fdl.active.states import StateMachine
from dpstack.fdl.codec import encode_token
from dpstack.fdl.interface import LinkStats, LinkUser
from dpstack.fdl.telegram import Telegram
from dpstack.params import BusParams
from dpstack.phy.line import Line
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Event
from dpstack.units import BITS_PER_CHAR, NEVER

#: T_TO is longer by this many times the slack of a known station
_SLACK_IN_T_TO: Final = 2
#: repetitions of a token get this share of the slack of the first pass (but at least the slack of unknown stations)
_AGAIN: Final = 4
#: beside other masters the station keeps the token for a cycle that is due within this share of T_SL
_KEPT: Final = 4
TOKEN_OCTETS: Final = 3


class ActiveLine(Line):
    """The line of an active station: the queued telegram, its gate, and the telegram that is arriving."""

    def __init__(self, params: BusParams, now: int) -> None:
        super().__init__(params, now)
        self.ts = params.address
        self.tx: bytes | None = None
        self.gate_ns = 0  # silence that has to precede ``tx``
        self.after_ns = self.t_id1_ns  # silence that has to follow the last telegram on the line
        self.taken_at = 0  # first bit of the last transmission
        self.busy_until = 0  # a telegram is arriving: deadlines and sending wait until then
        self.edge_at = -1  # first bit of the telegram that is arriving
        self.edge_seen = False  # its edge was reported

    def edge(self, now: int, longest_ns: int) -> None:
        """A start edge: a telegram of up to ``longest_ns`` may follow."""
        if now > self.idle_since:
            self.idle_since = now
        self.edge_at = now
        self.edge_seen = True
        self.after_ns = self.t_id1_ns
        self.busy_until = now + longest_ns

    def telegram_ended(self, now: int, lasted_ns: int = 0) -> None:
        """A whole telegram ended at ``now``. ``lasted_ns``: its duration, if the port is exact and has no edges."""
        if now > self.idle_since:
            self.idle_since = now
        if self.edge_seen:
            self.edge_seen = False
        else:
            self.edge_at = now - lasted_ns
        self.busy_until = 0
        self.after_ns = self.t_id1_ns

    def octets_ended(self, now: int, first_at: int, stall_at: int, exact: bool) -> None:
        """Octets ended at ``now``. ``first_at``: first bit of the telegram that they begin, -1 if they continue one.

        ``stall_at``: time at which an unfinished telegram stalls; 0 without one.
        """
        # receiving while sending implies sent; only on an exact line it is a collision
        if now > self.idle_since or not exact:
            self.idle_since = now
        if not self.edge_seen:
            if first_at >= 0:
                self.edge_at = first_at
        elif not stall_at:
            self.edge_seen = False
        self.busy_until = stall_at
        self.after_ns = self.t_id1_ns

    def end_arrival(self) -> None:
        """The unfinished telegram has stalled."""
        self.edge_seen = False
        self.busy_until = 0
        self.after_ns = self.t_id1_ns

    def queue(self, octets: bytes) -> None:
        """Queue ``octets``; the gate is the idle time after the last telegram."""
        self.tx = octets
        self.gate_ns = self.after_ns

    def queue_token(self, da: int) -> None:
        self.queue(encode_token(da, self.ts))

    def reply(self, octets: bytes) -> None:
        """Queue an answer to another master; the gate is min T_SDR."""
        self.tx = octets
        self.gate_ns = self.t_sdr_ns

    def lengthen_gate(self, least_ns: int) -> None:
        """Require a silence of ``least_ns`` or more before the queued telegram."""
        self.gate_ns = max(self.gate_ns, least_ns)

    def drop(self) -> None:
        """Do not send the queued telegram."""
        self.tx = None

    def expect_no_answer(self) -> None:
        """The last telegram has no answer: T_ID2 follows."""
        self.after_ns = self.t_id2_ns


class Times:
    """The durations of an active station in ns, from its parameters and its patience with the port."""

    def __init__(self, params: BusParams, patience: Patience, line: Line) -> None:
        self.params = params
        self._line = line
        self.set_patience(patience)

    def set_patience(self, patience: Patience) -> None:
        params, line = self.params, self._line
        self.patience = patience
        self.sending_ns = patience.sending_ns
        #: the port delivers nothing late and reports start edges
        self.exact = patience == EXACT
        # A port without edges delivers an octet at its end: the slot time includes that octet.
        self.slot_ns = slot_ns = line.t_sl_ns if self.exact else params.ns(params.t_sl + BITS_PER_CHAR)
        self.slot_known_ns = slot_ns + patience.known_ns
        self.slot_unknown_ns = slot_ns if self.exact else patience.silent_ns(params)
        # The first pass had the slack for a stalled host; repetitions serve a damaged token only.
        self.slot_again_ns = slot_ns + max(patience.known_ns // _AGAIN, patience.unknown_ns)
        # The token holder may be silent for T_SL and its slack, and may notice the end of that time late by the same
        # slack. With a single slack a busy computer lost the token with every master that left, and two rings existed
        # side by side (measured).
        self.t_to_ns = line.t_to_ns + _SLACK_IN_T_TO * patience.known_ns
        self.t_tr_ns = params.ns(params.t_tr)
        self.max_retry = params.max_retry
        # The station keeps the token for a fixed cycle that is due within this time. Beside other masters the silence
        # is far shorter than their T_SL; alone it covers the time between two tokens to itself, far below T_TO (600
        # bits).
        self.keep_ns = line.t_sl_ns // _KEPT
        # duration of a token to itself until the next request may follow
        self.pass_ns = params.ns(TOKEN_OCTETS * BITS_PER_CHAR) + line.t_id1_ns + patience.sending_ns
        self.keep_alone_ns = line.t_sl_ns + 2 * self.pass_ns
        # half a bit of tolerance: telegram and pause are rounded to ns apart from each other
        self.early_ns = params.ns(params.min_tsdr) - params.ns(1) // 2


class Users:
    """The users of the link layer in their order.

    ``due_at``: the earliest deadline of a user. ``unread``: the events of the station (``own``) and of its users that
    nobody has taken yet, always in the same list. ``asked``: each user with its :meth:`LinkUser.next_request`.
    """

    def __init__(self, users: Iterable[LinkUser], own: list[Event]) -> None:
        self._own = own
        self.unread: list[Sequence[Event]] = []
        self.due_at = NEVER
        self._use(tuple(users))

    def attach(self, user: LinkUser) -> None:
        self._use((*self.all, user))
        self.update_due()

    def detach(self, user: LinkUser) -> None:
        self._use(tuple(other for other in self.all if other is not user))
        self.update_due()

    def _use(self, users: tuple[LinkUser, ...]) -> None:
        self.all = users
        self.asked = tuple((user, user.next_request) for user in users)
        self.unread[:] = (self._own, *(user.events for user in users))

    def update_due(self) -> None:
        """Read the deadlines of the users anew, after a call that may have changed one."""
        due_at = NEVER
        for user in self.all:
            at = user.wake_at()
            if at < due_at:
                due_at = at
        self.due_at = due_at

    def broadcast(self, command: object, now: int) -> bool:
        """Pass ``command`` to all users; True when one of them accepted it."""
        taken = [user.command(command, now) for user in self.all]
        self.update_due()
        return any(taken)

    def offer(self, command: object, now: int) -> bool:
        """Pass ``command`` to the first user that accepts it; False when none does."""
        taken = any(user.command(command, now) for user in self.all)
        if taken:
            self.update_due()
        return taken

    def tick(self, now: int) -> None:
        for user in self.all:
            if user.wake_at() <= now:
                user.tick(now)
        self.update_due()


#: the objects of one station, in the order of the attributes of :class:`Parts`
Common = tuple[Times, ActiveLine, StateMachine, Membership, Peers, Users, LinkStats, list[Event]]


class Parts:
    """Base of the state classes: the objects on which their handlers work.

    No state class is a dataclass: to make one takes longer than to import a module.
    """

    __slots__ = ("events", "line", "machine", "membership", "peers", "stats", "times", "users")

    def __init__(self, common: Common) -> None:
        self.times, self.line, self.machine, self.membership = common[:4]
        self.peers, self.users, self.stats, self.events = common[4:]


class Awaiting(Parts):
    """Base of the state classes that wait for an answer."""

    __slots__ = ("early_until", "garbled")

    def __init__(self, common: Common) -> None:
        super().__init__(common)
        self.early_until = -NEVER  # a telegram that begins earlier is no answer
        self.garbled = False  # octets came that form no telegram (yet)

    def stray(self, _: Telegram, now: int) -> None:
        """A response to another station while this station has the token."""
        self.garbled = False
        self.stats.stray += 1

    def noise(self, _: Telegram, now: int) -> None:
        """An edge or octets: if no telegram follows, the answer was garbled."""
        self.garbled = True
