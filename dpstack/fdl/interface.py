"""Interfaces of the link layer: to its users, to the application of a passive station, to the medium.

DP master, live list and scanner are users of the link layer, side by side. The link layer asks them for the next
request when it holds the token. It manages FC, FCB, retries, slot times and the token; a user chooses the requests and
evaluates the answers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, runtime_checkable

from msgspec import Struct, field
from msgspec.structs import asdict

from dpstack.fdl.telegram import MAX_DATA, Req, Resp, Telegram
from dpstack.machine import Machine
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_S

if TYPE_CHECKING:
    from dpstack.fdl.standing import Standing  # it brings the codec, which an application of a bus process does without

#: value of ``extra_ns`` for a request to an unknown station that gets the time-out of a known one, if there is time
LONG_NS: Final = NS_PER_S


class Request:
    """A request of a link user. ``data`` is the data unit without SAP octets (0..244 octets).

    ``function`` contains the priority (SRD_HIGH, SRD_LOW ...). ``patient``: wait with the slack of a known station
    (:class:`dpstack.phy.patience.Patience`). ``extra_ns``: additional wait for an unknown station, up to that slack and
    as far as a fixed cycle and other masters have time. ``retry`` False: only one attempt. ``restart``: begin with FCV
    0 and FCB 1, whatever the state of the station. ``tag``: for the user alone. ``answer``: largest number of data
    octets in the answer, if known. ``cyclic``: part of a fixed cycle, never held back. ``yields``: never sent if it
    could run into the next fixed cycle, however long it waits. ``still``: the station calls it with the time before a
    repetition, and before a telegram that the driver sends late; if it returns False, the data are too old and the
    request ends as ABANDONED. ``done``: gets the answer or the failure, and the time, in place of
    :meth:`LinkUser.result`, once the request was queued. ``standing``: see :class:`dpstack.fdl.standing.Standing`.
    """

    # no Struct, whose attributes take ten times as long to set: ``data`` changes in every exchange
    __slots__ = (
        "answer",
        "cyclic",
        "da",
        "data",
        "done",
        "dsap",
        "extra_ns",
        "function",
        "patient",
        "restart",
        "retry",
        "ssap",
        "standing",
        "still",
        "tag",
        "yields",
    )

    def __init__(
        self,
        da: int,
        function: Req,
        data: bytes = b"",
        dsap: int | None = None,
        ssap: int | None = None,
        *,
        patient: bool = False,
        retry: bool = True,
        restart: bool = False,
        tag: object = None,
        extra_ns: int = 0,
        answer: int = MAX_DATA,
        cyclic: bool = False,
        yields: bool = False,
        still: Callable[[int], bool] | None = None,
        done: Callable[[Telegram | Failure, int], None] | None = None,
        standing: Standing | None = None,
    ) -> None:
        self.da = da
        self.function = function
        self.data = data
        self.dsap = dsap
        self.ssap = ssap
        self.patient = patient
        self.retry = retry
        self.restart = restart
        self.tag = tag
        self.extra_ns = extra_ns
        self.answer = answer
        self.cyclic = cyclic
        self.yields = yields
        self.still = still
        self.done = done
        self.standing = standing

    def replaced(self, **changes: Any) -> Request:
        """A copy with other attributes."""
        return Request(**{name: getattr(self, name) for name in self.__slots__} | changes)


class Failure(Enum):
    """Reasons for a request without answer."""

    NO_ANSWER = "no answer"  # slot time over, retries used up
    GARBLED = "garbled answer"  # octets came, but no telegram
    WRONG = "wrong answer"  # a telegram that does not answer this request: other SAPs, another station
    ABANDONED = "abandoned"  # the station left the ring or went offline meanwhile, or Request.still said no
    REFUSED = "refused by this station's guard"  # never sent: this station may not (Guard)
    HELD_BACK = (
        "held back"  # not sent now: it might run into the next cycle (dpstack.fdl.active.cycle_window); ask again
    )


class ActiveResponder(Protocol):
    """Answers the requests of other masters to an active station (:mod:`dpstack.fdl.services.saps`)."""

    def answer(self, request: Telegram, now: int) -> bytes | None:
        """The octets of the answer to a request with an answer, other than FDL status; None: stay silent. It repeats
        the last answer for a repetition (FCB)."""

    def indicate(self, telegram: Telegram, now: int) -> None:
        """Process an SDN to this station or to all."""

    def forget(self) -> None:
        """Another telegram came to this station: the last answer is no longer repeated."""


class LinkUser(Protocol):
    """A user of an active station's link layer. All calls come from within the station's pump.

    A user derived from this class has no commands, no deadlines and no events, unless it says so.
    """

    #: the events of this user that the station has not taken yet, always in the same list
    events: Sequence[Event] = ()

    def attached(self, station: object) -> None:
        """``station`` (:class:`~dpstack.fdl.active.station.ActiveStation`) has added this user by an order."""
        return

    def detached(self) -> None:
        """The station has removed this user by an order."""
        return

    def token_received(self, now: int) -> None:
        """A token hold begins, or the next cycle in one that was kept for it
        (:mod:`dpstack.fdl.active.cycle_window`)."""
        return

    def next_request(self, now: int, high_only: bool, /) -> Request | None:
        """The next request of this token hold, or None when the user has no more in this hold.

        ``high_only``: T_TH is used up or about to be: only high-priority service. The station asks again after each
        result until all users return None; then it polls the GAP and passes the token on.
        """

    def started(self, request: Request, at: int) -> None:
        """The first bit of ``request`` (of its first attempt) is on the wire at ``at``. Not called for a quiet
        :class:`Standing` request."""
        return

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """The end of a request: the answer (SC included), or the reason for its absence.

        For SDN: :data:`~dpstack.fdl.telegram.SHORT_ACK` once it has been sent.
        """

    def command(self, command: object, now: int) -> bool:
        """Process an order of the application; False when it is not for this user.

        The reports of the driver come here, too, to all users: LineDown, LineUp, and HeldUp. True for HeldUp: data in
        a request of this user, already made, are too old now (:attr:`dpstack.machine.Machine.held_up`).
        """
        return False

    def wake_at(self) -> int:
        """Deadline of this user for :meth:`tick`, in ns, or NEVER; independent of the token.

        The station asks after a token receipt, a tick, a command and an abandoned request: only these may change it.
        """
        return NEVER

    def tick(self, now: int) -> None:
        """The deadline of :meth:`wake_at` is over."""
        return

    def take_events(self) -> list[Event]:
        """The events of this user since the last call, oldest first; the station adds them to its own.

        The station calls it while there are :attr:`events`.
        """
        return []


class Reply(NamedTuple):
    """A passive station's answer to a request: status and data. The station adds the SAPs of the request, exchanged.

    ``short`` sends SC instead (allowed for OK without data).
    """

    status: Resp
    data: bytes = b""
    short: bool = False


SC_REPLY = Reply(Resp.OK, b"", True)
RS_REPLY = Reply(Resp.RS)


class StationControl(Protocol):
    """The settings of a passive station that its application may change."""

    @property
    def address(self) -> int:
        """The station address."""

    @property
    def baud(self) -> int:
        """The rate it listens at, in bit/s."""

    def set_address(self, address: int) -> None:
        """Change the address; an answer under way still goes out under the old one."""

    def set_min_tsdr(self, bits: int) -> None:
        """Set_Prm's min T_SDR in bit times: no answer earlier than this; 0 keeps, 1..10 count as 11."""


class Responder(Protocol):
    """The application of a passive station.

    An application derived from this class has no deadlines and no events, and ignores SDN and clocks, unless it says
    so. One with a list ``events`` of those that were not taken yet is asked for events only while it has some. One with
    ``takes_msrd`` True gets MSRD, too, and its data go to all stations; the function ``overhear(telegram, now)`` of
    another gets the answers of other stations to all.
    """

    def attached(self, station: StationControl) -> None:
        """A station with this application was created (once): keep ``station`` to set min T_SDR and address."""
        return

    def take_events(self) -> list[Event]:
        """The events of the application since the last call, oldest first. Called after every step: be quick."""
        return []

    def serve(self, request: Telegram, now: int) -> Reply | None:
        """Answer a new request to this station (SDA, SRD, ident), never a repetition. None = stay silent."""

    def indicate(self, telegram: Telegram, now: int) -> None:
        """Process an SDN, a Time_Event or a Clock_Value to this station or to all."""
        return

    def wake_at(self) -> int:
        """Deadline of the application for :meth:`tick` in ns (its watchdog, its process), or NEVER.

        The station asks after a request, an SDN, a tick and a command: only these may change it.
        """
        return NEVER

    def tick(self, now: int) -> None:
        """The deadline of :meth:`wake_at` is over."""
        return


class StationStats(Struct):
    """Counters of one remote station, always on."""

    #: requests without their repetitions
    requests: int = 0
    #: answers in time
    answers: int = 0
    #: repetitions of requests
    retries: int = 0
    #: requests without an answer
    timeouts: int = 0
    #: answers that came after their time-out
    late: int = 0
    #: late answers that began before min T_SDR
    early: int = 0
    #: telegrams that are no answer to the request
    wrong: int = 0
    #: damaged telegrams and stray octets during the wait for its answer, by cause (names of DecoderStats)
    bad: dict[str, int] = field(default_factory=dict)

    @property
    def telegrams(self) -> int:
        """Telegrams to and from the station: requests, repetitions, answers (late and wrong ones, too)."""
        return self.requests + self.retries + self.answers + self.late + self.wrong


#: counters of a decoder that count no damage
_NO_DAMAGE: Final = ("octets", "telegrams", "empty_le3", "skipped", "doubtful")


class DecoderStats(Struct):
    """Counters of a decoder. A damaged telegram counts once, under the first flaw found."""

    octets: int = 0
    telegrams: int = 0
    empty_le3: int = 0  # SD2 with LE = 3, taken as an empty data unit
    skipped: int = 0  # octets that belonged to no telegram
    bad_start: int = 0  # octets outside of any frame that are no start octet
    le_mismatch: int = 0
    le_range: int = 0
    bad_second_sd: int = 0
    bad_ed: int = 0
    bad_fcs: int = 0
    bad_address: int = 0
    bad_extension: int = 0
    bad_fc: int = 0
    stalled: int = 0  # telegrams that stayed unfinished for the stall time
    doubtful: int = 0  # octets inside a damaged frame that look like SC or the begin of a token

    @property
    def bad(self) -> int:
        """Damaged frames and octets outside of frames, of every kind."""
        return sum(n for name, n in self.as_dict().items() if name not in _NO_DAMAGE)

    def by_cause(self) -> dict[str, int]:
        """Counters of damage and of octets outside of telegrams, without zeros."""
        return {name: n for name, n in self.as_dict().items() if n and name not in ("octets", "telegrams")}

    def as_dict(self) -> dict[str, int]:
        return asdict(self)


class LinkStats(Struct):
    """Counters of one active station's link, always on."""

    #: telegrams of this station, tokens included
    sent: int = 0
    #: readable telegrams of all other stations
    heard: int = 0
    #: tokens that this station received and used
    tokens: int = 0
    #: times that this station found the bus silent for T_TO and claimed the token
    tokens_lost: int = 0
    #: token frames repeated because the next station was silent
    token_retries: int = 0
    #: token holds ended because another station sent as a token holder does
    withdrawn: int = 0
    #: polls of addresses in the GAP
    gap_polls: int = 0
    #: responses without a request
    stray: int = 0
    #: answers that came after their slot time
    late: int = 0
    #: answers of which only unreadable octets came
    garbled: int = 0
    #: requests of users that the guard refused
    refused: int = 0
    #: inputs without a row in the state table
    ignored: int = 0
    #: stations that sent requests while this one listened, before it joined the ring
    requesters: frozenset[int] = frozenset()
    #: stations that passed a token while this one listened, before it joined the ring
    token_senders: frozenset[int] = frozenset()
    #: counters by address of the station that got a request
    stations: dict[int, StationStats] = field(default_factory=dict)

    @property
    def without_token(self) -> list[int]:
        """Addresses of the masters that sent requests and never passed a token, in ascending order."""
        return sorted(self.requesters - self.token_senders)

    def station(self, address: int) -> StationStats:
        """The counters of ``address``, created with the first call."""
        stats = self.stations.get(address)
        if stats is None:
            stats = self.stations[address] = StationStats()
        return stats


@runtime_checkable
class TellsMoves(Protocol):
    """A :class:`BusStation` that calls ``on_move`` when its address or its rate has changed. The medium sets it, and
    looks at address and rate of all other stations after each of their steps."""

    on_move: Callable[[], None] | None


@runtime_checkable
class Hears(Protocol):
    """A :class:`BusStation` that hears an undisturbed telegram in one call: the medium makes it where nothing else can
    come between."""

    @property
    def unread(self) -> Sequence[Sequence[Event]]:
        """The lists of its events, always the same object: the medium takes them when one is not empty. Empty: the
        station returns NOW if there are events."""

    def hear(self, telegram: Telegram, start: int, end: int) -> int:
        """``activity`` at ``start``, unless the medium has called it already, then ``telegram`` at ``end``. Returns the
        new deadline as ``receive`` does."""


class BusStation(Machine, Protocol):
    """A station for a simulated medium, which can deliver whole telegrams instead of octets."""

    @property
    def address(self) -> int:
        """The station address, 0..126."""

    @property
    def hears_all(self) -> bool:
        """True for ring members and listeners: they need every telegram, not only those to their address."""

    def activity(self, now: int) -> None:
        """A start edge on a silent line; a telegram, octets or nothing readable may follow.

        The medium calls it for stations that hear all, and for the addressee. Ports without edges never call it. It may
        put the station's deadline off, but never bring it forward.
        """

    def telegram(self, telegram: Telegram, now: int) -> None:
        """A whole, intact telegram whose last bit was on the wire at ``now``, decoded once for all receivers."""
