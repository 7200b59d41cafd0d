"""The active station: a master's link layer with the whole token ring, as a machine of :mod:`dpstack.machine`.

It receives octets or whole telegrams, classifies them, and runs the handler that the table in
:mod:`dpstack.fdl.active.states` names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from dpstack.errors import UsageError
from dpstack.fdl.active.admission import Admission
from dpstack.fdl.active.cycle_window import CycleWindow
from dpstack.fdl.active.exchange import Exchange
from dpstack.fdl.active.fcb import FrameCount
from dpstack.fdl.active.las_gap import Announced, Gap, Ring
from dpstack.fdl.active.listen_idle_claim import Waiting
from dpstack.fdl.active.membership import Membership
from dpstack.fdl.active.parts import ActiveLine, Times, Users
from dpstack.fdl.active.pass_token import TokenPass
from dpstack.fdl.active.peers import Peers
from dpstack.fdl.active.states import (
    ACTIVITY,
    AWAIT_DATA_RESPONSE,
    AWAIT_STATUS_RESPONSE,
    GO_OFFLINE,
    GO_ONLINE,
    LINE_DOWN,
    NONE,
    OFFLINE,
    SENT,
    State,
    StateMachine,
    handlers_by_state,
)
from dpstack.fdl.active.use_token import GapPoll, Guard, TokenHold
from dpstack.fdl.codec import PlainFrame, encode
from dpstack.fdl.commands import AttachUser, DetachUser, GoOffline, GoOnline
from dpstack.fdl.decoder import Decoder
from dpstack.fdl.interface import ActiveResponder, DecoderStats, LinkStats, LinkUser
from dpstack.fdl.telegram import SHORT_ACK, Kind, StationType, Telegram
from dpstack.machine import HeldUp, InDoubt, LineDown, LineUp
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Event, WireEntry
from dpstack.units import NS_PER_MS, chars_to_ns

if TYPE_CHECKING:
    from dpstack.fdl.services.orders import FdlGuard

#: octets of the longest telegram that may follow a start edge
_LONGEST: Final = 255
#: more telegrams in one chunk than a line delivers in order, even to a computer that was too busy to read
_FLOOD: Final = 8
#: a telegram queued for longer than this may have data that are too old
_LATE_NS: Final = NS_PER_MS


class ActiveStation:
    """An active station (BusStation) and its ``users``, asked in their order. Offline until :class:`GoOnline`.

    ``patience``: slack for a late port. ``guard``: refuses requests of the users. ``window``: holds acyclic requests
    back that would delay the next fixed cycle. ``wire``, when set, gets every telegram received and sent. The station
    hands commands that are not its own to the users and raises :class:`UsageError` when no user accepts one.
    """

    #: a member of the ring needs every token
    hears_all: Final = True
    #: never called (TellsMoves): address and rate are fixed
    on_move: Callable[[], None] | None = None

    def __init__(
        self,
        params: BusParams,
        users: Sequence[LinkUser],
        *,
        patience: Patience = EXACT,
        guard: Guard | None = None,
        window: CycleWindow | None = None,
        now: int = 0,
    ) -> None:
        self.params: Final = params
        #: TS
        self.address: Final = params.address
        #: the rate of its receiver
        self.baud: Final = params.baud
        self.wire: Callable[[WireEntry], None] | None = None
        #: why a request of a program must not be sent beside the DP master of this station; None without a DP master
        self.fdl_guard: FdlGuard | None = None
        self._stats = stats = LinkStats()
        self._sent = 0
        self._heard_whole = 0  # telegrams that came without octets
        self._events: list[Event] = []
        self._attached: dict[int, LinkUser] = {}  # by the token of their orders
        self._wanted = False
        self._line_is_down = False
        self._longest_ns = chars_to_ns(_LONGEST, params.baud)
        self._sending = b""
        self._line = line = ActiveLine(params, now)
        self._times = times = Times(params, patience, line)
        self._decoder = Decoder(stall_ns=line.t_stall_ns + patience.stall_ns)
        self._decoder.on_bad = self._count_damage
        self._pending = self._decoder.pending  # octets of an unfinished telegram
        self._machine = machine = StateMachine(params.address)
        self._users = Users(users, self._events)
        self._gap = gap = Gap(params)
        gap.limit(patience, times.slot_unknown_ns, now)
        ring = Ring(params.address)
        self._membership = Membership(params, ring, gap, Announced(self._decoder.stats), self._events)
        fcb = FrameCount()
        self._peers = Peers(gap, fcb, stats, self._events)
        if window is None:
            window = CycleWindow()
        admission = Admission(times, line, ring, self._peers, window, self._events)
        common = (times, line, machine, self._membership, self._peers, self._users, stats, self._events)
        self._exchange = exchange = Exchange(common, fcb, admission)
        self._waiting = waiting = Waiting(common, exchange)
        passing = TokenPass(common, exchange, waiting)
        self._poll = poll = GapPoll(common, gap, exchange, admission, passing)
        exchange.poll_sent = poll.sent
        self._hold = hold = TokenHold(common, gap, exchange, admission, window, passing, poll, waiting, guard)
        #: from receipt to receipt of the token
        self.token_rotation = hold.token_rotation
        owners = {"idle": waiting, "hold": hold, "exchange": exchange, "poll": poll, "passing": passing}
        machine.bind(handlers_by_state(owners, self._ignore))

    # --- state --------------------------------------------------------------------------------------------------
    @property
    def state(self) -> State:
        return self._machine.state

    @property
    def in_ring(self) -> bool:
        """Whether the station has held the token since it came online and has not left the ring since."""
        return self._membership.in_ring

    @property
    def claimed(self) -> bool:
        """Whether the station claimed the token on a silent bus and has got none from another master since."""
        return self._membership.claimed

    @property
    def las(self) -> frozenset[int]:
        """The known masters in the ring, this station included."""
        return frozenset(self._membership.ring.members)

    @property
    def stations(self) -> dict[int, StationType]:
        """The stations found by GAP polls, with the types in their answers."""
        return dict(self._gap.stations)

    @property
    def unread(self) -> Sequence[Sequence[Event]]:
        """See :class:`~dpstack.fdl.interface.Hears`."""
        return self._users.unread

    @property
    def stats(self) -> LinkStats:
        """The counters up to now, always the same object."""
        stats, heard = self._stats, self._heard_whole + self._decoder.stats.telegrams
        if stats.sent != self._sent or stats.heard != heard:  # somebody may read them slave by slave
            stats.sent, stats.heard, stats.tokens = self._sent, heard, self._hold.tokens
            self._exchange.add_up()
        return stats

    @property
    def decoder_stats(self) -> DecoderStats:
        """Counters of the octets received."""
        return self._decoder.stats

    def respond_with(self, responder: ActiveResponder | None) -> None:
        """Let ``responder`` answer the requests of other masters to this station; None: RS to all."""
        self._waiting.responder = responder

    def hear_clocks(self, hear: Callable[[Telegram, int], None]) -> None:
        """Let ``hear`` get each Time_Event and Clock_Value of other masters, with the time of its end."""
        self._waiting.hear_clock = hear

    # --- receiving ----------------------------------------------------------------------------------------------
    def receive(self, chunk: bytes, now: int) -> int:
        """Octets from the line (machine contract)."""
        machine, line = self._machine, self._line
        state = machine.state
        if state is OFFLINE:
            return self.wake_at()
        expected = machine.expected
        telegram = self._decoder.whole(chunk, expected)
        if telegram is None or self._times.exact or line.edge_seen or self.wire is not None:
            self._receive_carefully(chunk, telegram, now)
            return self.wake_at()
        line.idle_since = line.edge_at = now  # receiving while sending implies sent
        line.after_ns = line.t_id1_ns
        if telegram is expected.last[1] and state is AWAIT_DATA_RESPONSE:
            self._exchange.answered(telegram, now)  # as StateMachine.telegram() and Exchange.response()
        else:
            machine.telegram(telegram, now)
        if line.tx is None:
            return self.wake_at()
        at, due_at = line.idle_since + line.gate_ns, self._users.due_at  # as wake_at()
        return at if at < due_at else due_at

    def _receive_carefully(self, chunk: bytes, telegram: Telegram | None, now: int) -> None:
        """Octets on a line with exact times, or whose edges are reported; ``telegram`` None: they are not one whole
        telegram."""
        machine, line = self._machine, self._line
        exact, pending, decoder = self._times.exact, self._pending, self._decoder
        if telegram is not None:
            if not exact:
                line.idle_since = now
            line.telegram_ended(now, chars_to_ns(len(chunk), self.baud) if exact else 0)
            self._process(telegram, now)
            return
        first_at = -1 if pending else now
        if exact and not pending:
            first_at -= chars_to_ns(len(chunk), self.baud)
        found = decoder.feed_pieces(chunk, now)
        line.octets_ended(now, first_at, decoder.stall_at() if pending else 0, exact)
        if len(found) > _FLOOD:
            found = self._without_flood(found)
        for telegram in found:
            self._process(telegram, now)
        if not found:
            machine.row[ACTIVITY](NONE, now)

    def _without_flood(self, found: list[Telegram]) -> list[Telegram]:
        """``found`` with at most two SC in a row; the others count as stray.

        Two answers may arrive in one chunk, because the request between them is this station's own. A third SC in a
        row answers no request.
        """
        kept = [
            each for n, each in enumerate(found) if n < 2 or not (each is found[n - 1] is found[n - 2] is SHORT_ACK)
        ]
        self._stats.stray += len(found) - len(kept)
        return kept

    def activity(self, now: int) -> None:
        """A start edge (see BusStation): the queued telegram waits, for the longest telegram at most."""
        machine = self._machine
        if machine.state is not OFFLINE:
            self._line.edge(now, self._longest_ns)
            machine.row[ACTIVITY](NONE, now)

    def telegram(self, telegram: Telegram, now: int) -> None:
        """A whole telegram (see BusStation)."""
        machine = self._machine
        if machine.state is not OFFLINE:
            self._line.telegram_ended(now)
            self._heard_whole += 1
            if self.wire is not None:
                self._log_heard(self.wire, telegram, now)
            machine.telegram(telegram, now)

    def _process(self, telegram: Telegram, now: int) -> None:
        if self.wire is not None:
            self._log_heard(self.wire, telegram, now)
        self._machine.telegram(telegram, now)

    def _log_heard(self, wire: Callable[[WireEntry], None], telegram: Telegram, now: int) -> None:
        octets = _octets(telegram)
        sender = str(telegram.sa) if telegram.sa >= 0 else None
        wire(WireEntry(now - chars_to_ns(len(octets), self.baud), now, octets, sender))

    # --- time and sending ---------------------------------------------------------------------------------------
    def wake_at(self) -> int:
        """The earliest of: gate, deadline of the state, stall of a telegram, deadline of a user (machine contract)."""
        line, due_at = self._line, self._users.due_at
        at = self._machine.deadline if line.tx is None else line.idle_since + line.gate_ns
        if line.busy_until and at < line.busy_until:
            at = line.busy_until
        if self._pending:
            stall = self._decoder.stall_at()
            if stall < at:
                at = stall
        return at if at < due_at else due_at

    def wake(self, now: int) -> None:
        """Process a stalled telegram, the deadline of the state and those of the users."""
        if self._pending and now >= self._decoder.stall_at():
            found = self._decoder.stalled(now)
            self._line.end_arrival()
            for telegram in found:
                self._process(telegram, now)
        line = self._line
        if line.tx is None and self._machine.deadline <= now and line.busy_until <= now:
            self._machine.timeout(now)
        if self._users.due_at <= now:
            self._users.tick(now)

    def take_tx(self, now: int) -> bytes | None:
        """Do what is due, then give the queued telegram once its gate is open (machine contract)."""
        line = self._line
        octets = line.tx
        if octets is None or self._pending or self._users.due_at <= now:
            self.wake(now)
            octets = line.tx
            if octets is None:
                return None
        if now < line.idle_since + line.gate_ns or now < line.busy_until:
            return None
        if now - self._exchange.made_at > _LATE_NS and self._exchange.is_outdated(now):
            self._exchange.drop_outdated(now)
            return None
        line.tx = None
        line.taken_at = now
        self._sending = octets
        return octets

    def sent(self, at: int) -> int:
        """The end of the transmission, known in advance (machine contract)."""
        line, machine, users = self._line, self._machine, self._users
        self._sent += 1
        if self.wire is not None:
            self.wire(WireEntry(line.taken_at, at, self._sending, str(self.address)))
        at += self._times.sending_ns  # an answer ends this time, silence does not
        line.idle_since = at
        line.after_ns = line.t_id1_ns
        machine.row[SENT](NONE, at)
        if line.tx is not None or self._pending:
            return self.wake_at()
        at = machine.deadline  # as wake_at()
        return at if at < users.due_at else users.due_at

    def hear(self, telegram: Telegram, start: int, end: int) -> int:
        machine, line = self._machine, self._line
        if line.edge_at != start:
            if machine.state is AWAIT_DATA_RESPONSE and self.wire is None:
                line.idle_since = end  # as activity() and telegram()
                line.edge_at = start
                line.edge_seen = False
                line.busy_until = 0
                line.after_ns = line.t_id1_ns
                exchange = self._exchange
                exchange.garbled = True
                self._heard_whole += 1
                expected = machine.expected
                if start >= exchange.early_until and (
                    telegram is expected.last[1] or self._has_head(telegram, expected)
                ):
                    exchange.answered(telegram, end)  # as StateMachine.telegram() and Exchange.response()
                else:
                    machine.telegram(telegram, end)
                users = self._users
                if line.tx is None or self._pending:
                    return self.wake_at()
                at = end + line.gate_ns  # as wake_at()
                return at if at < users.due_at else users.due_at
            self.activity(start)
        self.telegram(telegram, end)
        return self.wake_at()

    def _has_head(self, telegram: Telegram, expected: PlainFrame) -> bool:
        """Whether ``telegram`` has the head of ``expected``; kept for the next time, as inputs often stay the same."""
        if (
            telegram.fc == expected.fc
            and telegram.sa == expected.sa
            and telegram.da == expected.da == self._line.ts
            and len(telegram.data) == expected.data_size
            and telegram.dsap is telegram.ssap is None
        ):
            expected.last = None, telegram
            return True
        return False

    @property
    def patience(self) -> Patience:
        """The slack of the time-outs for known and unknown stations."""
        return self._times.patience

    def set_patience(self, patience: Patience, now: int) -> None:
        """Use the slack that the port needs; it applies from the next deadline on."""
        self._times.set_patience(patience)
        self._gap.limit(patience, self._times.slot_unknown_ns, now)
        self._decoder.stall_ns = self._line.t_stall_ns + patience.stall_ns

    def held_up(self, gap: HeldUp, now: int) -> bool:
        """The driver ran this station late. True when the outputs of a user became too old by it."""
        if gap.suspended:  # the clock does not show it
            self._exchange.made_at -= gap.for_ns
        return self._users.broadcast(gap, now)

    # --- events and commands ------------------------------------------------------------------------------------
    def take_events(self) -> list[Event]:
        """The station's events, then its users'."""
        if not any(self._users.unread):
            return []
        events = self._events
        for user in self._users.all:
            if user.events:
                events += user.take_events()
        taken = events.copy()
        events.clear()
        return taken

    def command(self, command: object, now: int) -> None:
        """GoOnline, GoOffline, AttachUser, DetachUser, LineDown, LineUp, InDoubt; all else goes to the users.

        Raises UsageError if no user takes it.
        """
        row = self._machine.row
        match command:
            case GoOnline():
                self._wanted = True
                self._membership.leaving = False
                if not self._line_is_down:
                    row[GO_ONLINE](NONE, now)
            case GoOffline():
                self._wanted = False
                row[GO_OFFLINE](NONE, now)
            case LineDown():
                self._line_is_down = True
                self._decoder.reset()
                row[LINE_DOWN](NONE, now)
                self._users.broadcast(command, now)
            case LineUp():
                self._line_is_down = False
                if self._wanted:
                    row[GO_ONLINE](NONE, now)
                self._users.broadcast(command, now)
            case InDoubt():
                self._users.broadcast(command, now)
            case AttachUser(token=token):
                user = command.link_user(self.params, self.patience, now)
                self._attached[token] = user
                self._users.attach(user)
                user.attached(self)
            case DetachUser(token):
                gone = self._attached.pop(token, None)
                if gone is not None:
                    self._exchange.detach(gone)
                    self._users.detach(gone)
                    gone.detached()
            case _:
                if not self._users.offer(command, now):
                    raise UsageError(f"nobody on this bus takes the command {command!r}: its user is not attached")
                self._hold.reconsider(now)

    def _ignore(self, _: Telegram, now: int) -> None:
        self._stats.ignored += 1

    def _count_damage(self, cause: str, times: int) -> None:
        """Count damage; during a wait for an answer it counts for the station asked, too."""
        state, polled = self._machine.state, self._poll.request.da
        if state is AWAIT_DATA_RESPONSE:
            bad = self._stats.station(self._exchange.request.da).bad
        elif state is AWAIT_STATUS_RESPONSE and self._peers.knows(polled):
            bad = self._stats.station(polled).bad
        else:
            return
        bad[cause] = bad.get(cause, 0) + times


def _octets(telegram: Telegram) -> bytes:
    """The octets of a received telegram. The codec encodes no SD3 and no LE = 3: SD2 and SD1 with another head."""
    if telegram.kind is Kind.SD3:
        return b"\xa2" + encode(replace(telegram, kind=Kind.SD2))[4:]
    if telegram.empty_le3:
        return b"\x68\x03\x03\x68" + encode(replace(telegram, kind=Kind.SD1))[1:]
    return encode(telegram)
