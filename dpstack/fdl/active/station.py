"""The active station: a master's link layer with the whole token ring, as a machine of :mod:`dpstack.machine`.

It hears octets or whole telegrams, finds out what they are to this station, and runs the handler that the table in
:mod:`dpstack.fdl.active.states` names. Deadlines, gates and books are in :class:`~dpstack.fdl.active.context.Link`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from dpstack.errors import UsageError
from dpstack.fdl.active import exchange, listen_idle_claim, pass_token, use_token
from dpstack.fdl.active.context import NONE, Link, Rows, classify
from dpstack.fdl.active.cycle_window import CycleWindow
from dpstack.fdl.active.request_filter import Guard, GuardedUser
from dpstack.fdl.active.states import Input, State, handlers_by_state
from dpstack.fdl.codec import encode
from dpstack.fdl.commands import AttachUser, DetachUser, GoOffline, GoOnline
from dpstack.fdl.decoder import Decoder, DecoderStats
from dpstack.fdl.interface import LinkStats, LinkUser
from dpstack.fdl.telegram import SHORT_ACK, Kind, StationType, Telegram
from dpstack.machine import HeldUp, LineDown, LineUp
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.stats import Histogram
from dpstack.trace import Event, Notice, Severity, WireEntry
from dpstack.units import NEVER, NS_PER_MS, chars_to_ns

#: the longest telegram in octets: what an edge on the line may turn into
_LONGEST: Final = 255
#: more telegrams in one chunk than a line brings in order, with those a busy computer had no time to read before
_FLOOD: Final = 8
#: a telegram that was made so long ago may have data that are too old
_LATE_NS: Final = NS_PER_MS


def _ignored(link: Link, _: Telegram, now: int) -> None:
    link.stats.ignored += 1


#: the table with its handlers bound
ROWS: Final[Rows] = handlers_by_state(
    {"idle": listen_idle_claim, "hold": use_token, "exchange": exchange, "passing": pass_token}, _ignored
)

# asked with every telegram: an enum's member costs ten times a name of the module
_OFFLINE: Final = State.OFFLINE
_ACTIVITY: Final = Input.ACTIVITY
_SENT: Final = Input.SENT

_COMMANDS: Final[dict[type, Input]] = {
    GoOnline: Input.GO_ONLINE,
    GoOffline: Input.GO_OFFLINE,
    LineDown: Input.LINE_DOWN,
    LineUp: Input.LINE_UP,
}


class ActiveStation:
    """An active station (BusStation) and its ``users``, asked in their order. Offline until :class:`GoOnline`.

    ``patience`` is what the port may be late; what ``guard`` refuses no user can send; ``budget`` keeps everything but
    the cycle itself out of a fixed cycle; ``wire``, when set, is told every telegram heard and sent. Commands that are
    not its own go to the users; :class:`UsageError` when none takes it.
    """

    __slots__ = (
        "_attached",
        "_decoder",
        "_guard",
        "_link",
        "_longest_ns",
        "_partial",
        "_sending",
        "address",
        "baud",
        "wire",
    )

    def __init__(
        self,
        params: BusParams,
        users: Sequence[LinkUser],
        *,
        patience: Patience = EXACT,
        guard: Guard | None = None,
        budget: CycleWindow | None = None,
        now: int = 0,
    ) -> None:
        #: TS
        self.address: Final = params.address
        #: the rate of its receiver
        self.baud: Final = params.baud
        self._guard = guard
        self._attached: dict[int, LinkUser] = {}  # by the token of their orders
        self._link = Link(params, [self._guarded(user) for user in users], patience, ROWS, now)
        if budget is not None:
            self._link.budget = budget
        self._decoder = Decoder(stall_ns=self._link.line.t_stall_ns + patience.stall_ns)
        self._decoder.on_bad = self._bad
        self._link.announced.received = self._decoder.stats
        self._partial = False  # the decoder holds an unfinished telegram
        self._longest_ns = chars_to_ns(_LONGEST, params.baud)
        self._sending = b""
        self.wire: Callable[[WireEntry], None] | None = None

    # --- what others may know -----------------------------------------------------------------------------------
    @property
    def hears_all(self) -> bool:
        """A ring member has to hear every token."""
        return True

    @property
    def params(self) -> BusParams:
        return self._link.params

    @property
    def state(self) -> State:
        """The state of the link layer."""
        return self._link.state

    @property
    def in_ring(self) -> bool:
        """It has held the token since it came online, and has not been dropped since."""
        return self._link.in_ring

    @property
    def claimed(self) -> bool:
        """It claimed the token on a silent bus; nobody has passed it one since."""
        return self._link.claimed

    @property
    def las(self) -> frozenset[int]:
        """The masters in the ring as far as is known, this one included."""
        return frozenset(self._link.ring.members)

    @property
    def stations(self) -> dict[int, StationType]:
        """The stations found by GAP polls and what they said they are."""
        return dict(self._link.gap.stations)

    @property
    def stats(self) -> LinkStats:
        return self._link.stats

    @property
    def decoder_stats(self) -> DecoderStats:
        """Counters of the octets received."""
        return self._decoder.stats

    @property
    def last_rotation(self) -> int:
        """The last token rotation (receipt to receipt) in ns, 0 before the second receipt."""
        return self._link.last_rotation

    @property
    def token_rotation(self) -> Histogram:
        return self._link.token_rotation

    # --- hearing ------------------------------------------------------------------------------------------------
    def receive(self, chunk: bytes, now: int) -> None:
        """Octets from the line (machine contract)."""
        link = self._link
        if link.state is _OFFLINE:
            return
        line = link.line
        # receiving while sending implies sent, except where nothing is late: there it is a collision
        if now > line.idle_since or not link.exact:
            line.idle_since = now
        if not self._partial and not link.edge_told:
            link.edge_at = now - chars_to_ns(len(chunk), self.baud) if link.exact else now
        decoder = self._decoder
        found = decoder.feed(chunk, now)
        self._arriving(bool(decoder.pending))
        if len(found) > _FLOOD:
            found = self._without_flood(found)
        for telegram in found:
            self._heard(telegram, now)
        if not found:
            link.row[_ACTIVITY](link, NONE, now)

    def _without_flood(self, found: list[Telegram]) -> list[Telegram]:
        """``found`` with at most two SC in a row, the others counted as stray: a line brings two answers at once where
        the request between them is our own, and a third one is no answer to anybody."""
        kept = [
            each for n, each in enumerate(found) if n < 2 or not (each is found[n - 1] is found[n - 2] is SHORT_ACK)
        ]
        stats = self._link.stats
        stats.heard += len(found) - len(kept)
        stats.stray += len(found) - len(kept)
        return kept

    def _arriving(self, pending: bool) -> None:
        link = self._link
        self._partial = pending
        link.after_ns = link.line.t_id1_ns
        if pending:
            link.busy_until = self._decoder.stall_at()
        else:
            link.busy_until = 0
            link.edge_told = False

    def activity(self, now: int) -> None:
        """A start edge (see BusStation): what waits goes on waiting, for the longest telegram at most."""
        link = self._link
        if link.state is _OFFLINE:
            return
        link.line.heard(now)
        link.edge_at = now
        link.edge_told = True
        link.after_ns = link.line.t_id1_ns
        link.busy_until = now + self._longest_ns
        link.row[_ACTIVITY](link, NONE, now)

    def telegram(self, telegram: Telegram, now: int) -> None:
        """A whole telegram (see BusStation)."""
        link = self._link
        if link.state is _OFFLINE:
            return
        line = link.line
        if now > line.idle_since:
            line.idle_since = now
        if not link.edge_told:
            link.edge_at = now
        link.edge_told = False
        link.busy_until = 0
        link.after_ns = line.t_id1_ns
        self._heard(telegram, now)

    def _heard(self, telegram: Telegram, now: int) -> None:
        link = self._link
        link.stats.heard += 1
        if self.wire is not None:
            octets = _octets(telegram)
            sender = str(telegram.sa) if telegram.sa >= 0 else None
            self.wire(WireEntry(now - chars_to_ns(len(octets), self.baud), now, octets, sender))
        link.row[classify(telegram, link.ts)](link, telegram, now)

    # --- time and sending ---------------------------------------------------------------------------------------
    def wake_at(self) -> int:
        """The machine contract: a gate, a deadline, the end of a stalled telegram, or a user's time."""
        link = self._link
        if link.tx is not None:
            at = link.line.idle_since + link.gate_ns  # as Link.tx_at
            if at < link.busy_until:
                at = link.busy_until
        else:
            at = link.deadline
            if at < link.busy_until:
                at = link.busy_until
        if self._partial:
            stall = self._decoder.stall_at()
            if stall < at:
                at = stall
        return at if at < link.users_at else link.users_at

    def wake(self, now: int) -> None:
        """Judge what is due (machine contract)."""
        link = self._link
        if self._partial and now >= self._decoder.stall_at():
            self._stalled(now)
        if link.tx is None and link.deadline <= now and link.busy_until <= now:
            link.deadline = NEVER
            link.row[Input.TIMEOUT](link, NONE, now)
        if link.users_at <= now:
            for user in link.users:
                if user.wake_at() <= now:
                    user.tick(now)
            link.ask_times()

    def _stalled(self, now: int) -> None:
        found = self._decoder.stalled(now)
        self._arriving(bool(self._decoder.pending))
        for telegram in found:
            self._heard(telegram, now)

    def take_tx(self, now: int) -> bytes | None:
        """The waiting telegram once its gate is open (machine contract)."""
        link = self._link
        octets = link.tx
        if octets is None or now < link.tx_at():
            return None
        if now - link.made_at > _LATE_NS and exchange.is_outdated(link, now):
            exchange.drop_outdated(link, now)
            return None
        link.tx = None
        link.taken_at = now
        self._sending = octets
        return octets

    def sent(self, at: int) -> None:
        """The end of the transmission, known in advance (machine contract)."""
        link = self._link
        link.stats.sent += 1
        if self.wire is not None:
            self.wire(WireEntry(link.taken_at, at, self._sending, str(link.ts)))
        at += link.patience.sending_ns  # an answer cuts this short, silence does not
        link.line.idle_since = at
        link.after_ns = link.line.t_id1_ns
        link.row[_SENT](link, NONE, at)

    @property
    def patience(self) -> Patience:
        """How long it waits for whom."""
        return self._link.patience

    def set_patience(self, patience: Patience, now: int) -> None:
        """Wait as long as the port turned out to need; counts from the next deadline on."""
        link = self._link
        link.patience = patience
        link.set_times(now)
        self._decoder.stall_ns = link.line.t_stall_ns + patience.stall_ns

    def held_up(self, gap: HeldUp, now: int) -> bool:
        """The driver ran this station late; True when one of its users says that its outputs are too old by it."""
        too_old = [user.command(gap, now) for user in self._link.users]
        self._link.ask_times()
        return any(too_old)

    # --- orders and news ----------------------------------------------------------------------------------------
    def take_events(self) -> list[Event]:
        """The station's events, then its users'."""
        link = self._link
        events = link.events
        if events:
            link.events = []
        else:
            events = []
        for user in link.users:
            events += user.take_events()
        return events

    def command(self, command: object, now: int) -> None:
        """GoOnline, GoOffline, AttachUser, DetachUser, LineDown, LineUp; all else goes to the users, or UsageError."""
        link = self._link
        what = _COMMANDS.get(type(command))
        if what is None:
            self._offer(command, now)
            return
        match what:
            case Input.GO_ONLINE:
                link.wanted, link.leaving = True, False
            case Input.GO_OFFLINE:
                link.wanted = False
            case Input.LINE_DOWN:
                link.line_is_down = True
                self._decoder.reset()
                self._partial = False
            case Input.LINE_UP:
                link.line_is_down = False
        link.dispatch(what, NONE, now)
        if what in (Input.LINE_DOWN, Input.LINE_UP):  # concerns everyone
            for user in link.users:
                user.command(command, now)
            link.ask_times()

    def _guarded(self, user: LinkUser) -> LinkUser:
        return user if self._guard is None else GuardedUser(user, self._guard, self._refused)

    def _refused(self, text: str, now: int, news: bool) -> None:
        link = self._link
        link.stats.refused += 1
        if news:
            link.events.append(Notice(t_ns=now, source="fdl", message=text, severity=Severity.ERROR))

    def _bad(self, cause: str, times: int) -> None:
        """Something damaged: while an answer is awaited it counts for the station asked, too."""
        link = self._link
        if link.state is State.AWAIT_DATA_RESPONSE:
            bad = link.stats.station(link.request.da).bad
        elif link.state is State.AWAIT_STATUS_RESPONSE and link.knows(link.polling):
            bad = link.stats.station(link.polling).bad
        else:
            return
        bad[cause] = bad.get(cause, 0) + times

    def _offer(self, command: object, now: int) -> None:
        link = self._link
        match command:
            case AttachUser(token=token):
                user = self._attached[token] = self._guarded(command.link_user(link.params, link.patience, now))
                link.users += (user,)
                link.ask_times()
                return
            case DetachUser(token):
                gone = self._attached.pop(token, None)
                if link.user is gone:
                    link.user = None
                link.users = tuple(user for user in link.users if user is not gone)
                link.ask_times()
                return
        for user in link.users:
            if user.command(command, now):
                link.ask_times()
                use_token.let_go(link, now)
                return
        raise UsageError(f"nobody on this bus takes the command {command!r}: its user is not attached")


def _octets(telegram: Telegram) -> bytes:
    """The octets of a telegram heard. SD3 and LE = 3 are never sent: they are SD2 and SD1 with another head."""
    if telegram.kind is Kind.SD3:
        return b"\xa2" + encode(telegram._replace(kind=Kind.SD2))[4:]
    if telegram.empty_le3:
        return b"\x68\x03\x03\x68" + encode(telegram._replace(kind=Kind.SD1))[1:]
    return encode(telegram)
