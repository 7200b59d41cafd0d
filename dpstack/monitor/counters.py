"""Counters of stations, masters and the bus, from the transmissions on a line.

Every telegram that asks a station is a request, repetitions too, and ends as one of three: answered, answered in a way
that nobody could read (damaged), or not answered: requests = answers + damaged + no_answer, and one more for the
request that waits for its answer at this moment (:attr:`Counters.asked`).

Damaged octets belong to the station that was asked just before; if nobody was asked, if they begin like the next
telegram of the master, or if an answer came as well, they are ``unattributed``. So each damaged transmission counts
once: all damaged = damaged of the stations + pieces of open requests + unattributed. A readable answer that no request
asked for is ``late`` at the station that sent it, or one of ``strays``.

Nothing that is gone is shown as alive: see :meth:`Counters.look`. A token has no check sequence, so an address that was
seen as the sender of one token only is no master yet.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Final, NamedTuple

from dpstack.capture.transmission import Columns, Damage, Transmission
from dpstack.fdl.codec import Flaw, decode, parse
from dpstack.fdl.telegram import (
    COUNTED,
    FC_FCB,
    FC_FCV,
    FC_FUNCTION,
    FC_REQUEST,
    SAP_CHK_CFG,
    SAP_GLOBAL_CONTROL,
    SAP_SET_PRM,
    SAP_SLAVE_DIAG,
    UNANSWERED,
    Kind,
    Req,
    Resp,
    StationType,
    Telegram,
)
from dpstack.monitor.exchanges import Batch, Exchanges, Telegrams, condense, is_pdu
from dpstack.params import BROADCAST
from dpstack.stats import Histogram
from dpstack.units import NS_PER_S, bits_to_ns, chars_to_ns

if TYPE_CHECKING:
    from dpstack.monitor.clock import SentTime

#: an exchange is repeated at most this often (max_retry up to 15 exists, DP masters have up to 8)
MAX_DEPTH: Final = 8
#: A station without an answer for this time is offline if it was asked, and unknown if nobody asks it. Slow buses
#: get more: SILENT_BITS, three of the longest rotations of its master, at most LONGEST_SILENCE_NS (all our choice).
SILENT_NS: Final = 2 * NS_PER_S
SILENT_BITS: Final = 200_000
LONGEST_SILENCE_NS: Final = 30 * NS_PER_S
#: unanswered requests in a row after which a station is offline and not merely unasked
OFFLINE_AFTER: Final = 2
#: tokens in a row that pass a master over, after which it is out of the ring: one may be a damaged one
PASSED_OVER: Final = 2
#: gaps of less than this, in bit times, do not exist on a wire (min T_SDR): the telegrams arrived together
TOGETHER_BITS: Final = 10
#: Global_Control: bit of Clear_Data
_CLEAR_DATA: Final = 2
_TOKENS_OF_NOBODY: Final = 2  # this many tokens of one sender may be damaged ones of others
_LONGEST: Final = 256
#: if the source does not say the rate
_ANY_BAUD: Final = 9600
_NOT_ASKED = tuple(number in UNANSWERED for number in range(16))
_IS_COUNTED = tuple(number in COUNTED for number in range(16))
#: functions and states without a meaning (docs/reference/protocol.md#function-code)
_RESERVED_FUNCTION = tuple(number not in Req._value2member_map_ for number in range(16))
_RESERVED_STATUS = tuple(number not in Resp._value2member_map_ for number in range(16))
#: answers of a slave in data exchange; OK and NR come from slaves without inputs
_EXCHANGES = tuple(number in (Resp.OK, Resp.DL, Resp.NR, Resp.DH, Resp.RDL, Resp.RDH) for number in range(16))
#: answers that announce a diagnosis; 15 stands for SC, which does not
_ANNOUNCES = tuple(number in (Resp.DH, Resp.RDH) for number in range(16))


class State:
    """States of a slave, as ``run --json`` names them."""

    UNKNOWN: Final = "unknown"
    OFFLINE: Final = "offline"
    DIAGNOSIS: Final = "diagnosis"
    SET_PRM: Final = "set_prm"
    CHK_CFG: Final = "chk_cfg"
    WAIT_READY: Final = "wait_ready"
    DATA_EXCHANGE: Final = "data_exchange"


class Unheard(StrEnum):
    """Why the diagnosis of a slave that stands now is not known."""

    #: it is the last one that was heard
    NOTHING = ""
    #: no Slave_Diag was heard
    NEVER = "never"
    #: octets were missed after the last one
    GAP = "gap"
    #: nobody could read the answer to the last Slave_Diag
    UNREADABLE = "unreadable"
    #: the slave announces another one (DH), and its master has not asked for it yet
    UNREAD = "unread"


class Change(NamedTuple):
    """A change of a station for the time line. ``kind``: lost, back, diagnosis, joined, left, mode, clock, rate.

    ``t_ns``: since 1970. ``octets``: of a new diagnosis.
    """

    t_ns: int
    kind: str
    address: int
    text: str
    octets: bytes = b""


@dataclass(slots=True, eq=False)
class Station:
    """Counters of one station that is asked. ``retry_depth[i]``: exchanges that needed i + 1 repetitions, the last also
    those that needed more; ``repetitions``: requests with the frame count bit of the one before (FCV = 1).

    ``repeated_polls``: unanswered requests without a frame count that were sent again as they were. ``late``: answers
    when nobody waited for them any more. ``syncs``: bring-ups that ended in data exchange. ``lost``: times it left data
    exchange. ``unheard``: why ``diagnosis`` may not be the present one. ``set_prm``: the data unit of the last Set_Prm
    that it acknowledged. ``link_status``: the last diagnosis since then that may have a link status message of data
    exchange broadcast. ``is_cpu``: an S7-200, which is asked over PPI: in data exchange while it answers, as in a run.
    ``answer_ns``: from the end of the request to the begin of the answer (T_SDR). ``in_vain``:
    requests since its last answer.
    """

    address: int
    requests: int = 0
    answers: int = 0
    damaged: int = 0
    no_answer: int = 0
    repetitions: int = 0
    retry_depth: list[int] = field(default_factory=lambda: [0] * MAX_DEPTH)
    repeated_polls: int = 0
    late: int = 0
    rs: int = 0
    rr: int = 0
    diagnoses: int = 0
    diagnosis: bytes | None = None
    unheard: Unheard = Unheard.NEVER
    set_prm: bytes | None = None
    link_status: bytes | None = None
    syncs: int = 0
    lost: int = 0
    state: str = State.UNKNOWN
    master: int | None = None
    ident: int | None = None
    station_type: StationType | None = None
    answer_ns: Histogram = field(default_factory=Histogram)
    asked_at: int = 0
    answered_at: int = 0
    in_vain: int = 0
    is_master: bool = False
    is_cpu: bool = False

    @property
    def is_present(self) -> bool:
        """A station is, or was, at this address: it has answered, sends by itself, or most of its requests are followed
        by octets that nobody can read."""
        if self.answers or self.late or self.is_master:
            return True
        return self.damaged >= _UNREADABLE and 2 * self.damaged > self.requests


#: A damaged answer alone may be noise behind a poll of an empty address; this many are a station.
_UNREADABLE: Final = 3


@dataclass(slots=True, eq=False)
class Master:
    """Counters of one master. ``token_ns``: from token to token; ``hold_ns``: from the token to passing it on;
    ``rotation_ns``: from the first Data_Exchange of a round to that of the next. ``gap_polls``: requests for the FDL
    status. ``drops``: times it fell out of the ring, or silent in it. ``mode``: of its last Global_Control: operate,
    clear, or unknown. ``is_silent``: it was not heard for a while. ``clock``: the time that it sends, if it does.
    """

    address: int
    mode: str = "unknown"
    token_ns: Histogram = field(default_factory=Histogram)
    rotation_ns: Histogram = field(default_factory=Histogram)
    hold_ns: Histogram = field(default_factory=Histogram)
    gap_polls: int = 0
    drops: int = 0
    tokens: int = 0
    in_ring: bool = False
    is_silent: bool = False
    slaves: set[int] = field(default_factory=set)
    heard_at: int = 0
    token_at: int | None = None
    held_since: int | None = None
    passed_over: int = 0  # tokens since its last one that went past it
    clock: SentTime | None = None
    reference: int | None = None  # the slave whose Data_Exchange begins a round
    round_at: int | None = None

    def forget_times(self) -> None:
        """Something was missed: no duration begins before it."""
        self.token_at = self.held_since = self.round_at = None
        if self.clock is not None:
            self.clock.forget_times()


class _Exchange:
    """The last exchange of a master with a station. ``turned``: its frame count bit is the other one than that of the
    answered exchange before."""

    __slots__ = ("answered", "master", "pieces", "repeats", "station", "telegram", "turned")

    def __init__(self, master: Master, station: Station, telegram: Telegram, turned: bool) -> None:
        self.master = master
        self.station = station
        self.telegram = telegram
        self.turned = turned
        self.answered = False
        self.repeats = 0
        self.pieces = 0  # damaged transmissions since the request


_NEW = tuple.__new__  # the constructor of a NamedTuple takes twice as long

#: the cause of damage by the first thing found wrong
_CAUSES: Final = {
    Flaw.BAD_FCS: "fcs",
    Flaw.BAD_ED: "fcs",
    Flaw.BAD_FC: "fcs",
    Flaw.BAD_ADDRESS: "fcs",
    Flaw.BAD_EXTENSION: "fcs",
    Flaw.BAD_START: "start",
    Flaw.LE_MISMATCH: "start",
    Flaw.LE_RANGE: "start",
    Flaw.BAD_SECOND_SD: "start",
}


class Counters:
    """Counts the transmissions of one bus. ``on_change`` is called with each change for the time line, ``on_look`` once
    in a second of bus time, with the time in ns."""

    def __init__(
        self,
        on_change: Callable[[Change], None] = lambda change: None,
        on_look: Callable[[int], None] = lambda now: None,
    ) -> None:
        self.stations: dict[int, Station] = {}
        self.masters: dict[int, Master] = {}
        self.telegrams = 0
        #: damaged transmissions by cause: "fcs", "short", "start", "parity", "octets"
        self.damaged: dict[str, int] = {}
        self.unattributed = 0
        #: readable answers of stations that nobody had asked, and SC if nobody was asked
        self.strays = 0
        #: telegrams that began when the one before had hardly ended: they arrived together in the computer
        self.together = 0
        #: how long the telegrams that arrived together with the one before took on the wire, by pieces of the source
        self.pieces_ns = Histogram()
        self._piece_ns = 0
        self.octets = 0
        self.busy_ns = 0
        self.begun_ns: int | None = None
        self.ended_ns = 0
        self.baud = 0
        #: evidence that this is PROFIBUS (dpstack.monitor.evidence): answers that fit requests, tokens that were passed
        #: on, and against it: functions without a meaning, tokens of a station that did not have it
        self.fitting_answers = 0
        self.passed_tokens = 0
        self.reserved = 0
        self.broken_tokens = 0
        self._strays_before = self._telegrams_before = 0  # at other rates
        self._on_change = on_change
        self._on_look = on_look
        self._asked: _Exchange | None = None
        self._asked_end = 0
        self._missed: _Exchange | None = None  # the last one that nobody answered
        self._exchanges: dict[int, _Exchange] = {}  # those with a frame count, by master * 128 + station
        self._doubtful: dict[int, Master] = {}  # senders of one token
        self._token: Telegram | None = None
        self._damaged_after = -1  # number of telegrams before the last damaged transmission
        self._look_at = 0
        self._known = Telegrams()
        self._set_rate(_ANY_BAUD)

    @property
    def asked(self) -> Station | None:
        """The station that was asked and whose answer may still come: its ``requests`` are one more than their ends."""
        return None if self._asked is None else self._asked.station

    @property
    def open_pieces(self) -> int:
        """Damaged transmissions since the request that waits for its answer: they count with its end."""
        return 0 if self._asked is None else self._asked.pieces

    @property
    def telegrams_at_rate(self) -> int:
        """Telegrams at the present rate."""
        return self.telegrams - self._telegrams_before

    @property
    def contradictions(self) -> int:
        """Telegrams at the present rate that PROFIBUS has no place for: evidence against it."""
        return self.reserved + self.broken_tokens + self.strays - self._strays_before

    def is_used(self, address: int) -> bool:
        """Whether a master asks ``address`` for more than its FDL status: it is no address of the GAP only."""
        return any(key & 0x7F == address for key in self._exchanges)

    @property
    def repeats(self) -> int:
        """How often the request that waits for its answer has been repeated with its frame count bit; 0 if none
        waits."""
        asked = self._asked
        return 0 if asked is None else asked.repeats

    # --- the hot path ---
    def add(self, one: Transmission) -> None:
        """Count one transmission; its times must not run backwards. Never raises, whatever the octets."""
        self._count(one, None if one.damage else decode(one.octets))

    def _count(self, one: Transmission, telegram: Telegram | None) -> None:
        if one.baud != self.baud and one.baud:
            self._new_rate(one)
        size = len(one.octets)
        start = self.ended_ns if one.t_ns is None else one.t_ns
        if start >= self._look_at:
            self.look(start)
        duration = self._durations[size] if size < _LONGEST else chars_to_ns(size, self.baud or _ANY_BAUD)
        self.octets += size
        self.busy_ns += duration
        if self.begun_ns is None:
            self.begun_ns = start
        elif start - self.ended_ns < self._together_ns:
            self.together += 1
            self._piece_ns += duration
        elif self._piece_ns:
            self._end_piece()
        end = self.ended_ns = start + duration
        if telegram is None:
            self._add_damaged(one)
            return
        self.telegrams += 1
        fc = telegram.fc
        if fc < 0:
            if telegram.kind is _SD4:
                self._add_token(telegram, start, end)
            else:
                self._add_answer(telegram, fc, start, end)
        elif fc & FC_REQUEST:
            self._add_request(telegram, fc, start, end)
        else:
            self._add_answer(telegram, fc, start, end)

    def add_all(self, transmissions: Batch) -> None:
        """Count transmissions one after another, those in columns quicker than :meth:`add` and with the same result."""
        heard: Batch | None = transmissions
        if isinstance(heard, Columns):
            heard = condense(heard, self._known) if heard else None
        if isinstance(heard, Exchanges):
            self._add_exchanges(heard)
        else:
            for one in transmissions:
                self.add(one)

    def _add_exchanges(self, heard: Exchanges) -> None:
        """A Data_Exchange of a slave that is in it is counted here as long as nothing is out of the ordinary."""
        baud, table, starts = heard.baud, heard.table, heard.starts
        if baud and baud != self.baud:
            self._new_rate(Transmission(b"", starts[0], baud))
        durations, known = self._durations, self._known
        entries: list[tuple[int, Telegram | None, int, int, int, int] | None] = []
        for octets, answer in table:
            if answer is None:
                entries.append(None)
            else:
                _, telegram, fc, key = known[octets]
                sizes = len(octets), len(answer)
                until, after = durations[sizes[0]], durations[sizes[1]]
                entries.append((key, telegram, fc, until, after, sum(sizes)))
        exchanges, together_ns = self._exchanges, self._together_ns
        count = octets_sum = busy = 0  # since the last transmission that was counted elsewhere
        ended, asked_end, waits = self.ended_ns, self._asked_end, self._asked is not None
        look_at = 0 if self.begun_ns is None else self._look_at
        for row, start, answered in zip(heard.rows, starts, heard.answers, strict=True):
            entry = entries[row]
            if entry is not None:
                key, telegram, fc, request_ns, answer_ns, size = entry
                before = exchanges.get(key)
                if (
                    before is not None
                    and before.answered
                    and (fc ^ before.telegram.fc) & FC_FCB
                    and answered < look_at
                    and not waits
                ):
                    master, station = before.master, before.station
                    if station.state == _DATA_EXCHANGE and station.master == master.address:
                        before.turned = True
                        before.repeats = 0
                        before.telegram = telegram  # type: ignore[assignment]
                        if start - ended < together_ns:
                            self.together += 1
                            self._piece_ns += request_ns
                        elif self._piece_ns:
                            self._end_piece()
                        master.heard_at = station.asked_at = asked_end = start + request_ns
                        station.requests += 1
                        if master.reference == station.address or master.reference is None:
                            self._round(master, station, start)
                        t_sdr = answered - asked_end
                        if t_sdr < together_ns:
                            self.together += 1
                            self._piece_ns += answer_ns
                        else:
                            station.answer_ns.add(t_sdr)
                            if self._piece_ns:
                                self._end_piece()
                        station.answers += 1
                        station.answered_at = ended = answered + answer_ns
                        station.in_vain = 0
                        count += 1
                        octets_sum += size
                        busy += request_ns + answer_ns
                        continue
            if count:
                self._take(count, octets_sum, busy, asked_end, ended)
                count = octets_sum = busy = 0
            octets, answer = table[row]
            self._count(_NEW(Transmission, (octets, start, baud, "", 0)), known[octets].telegram)
            if answer is not None:
                self._count(_NEW(Transmission, (answer, answered, baud, "", 0)), known[answer].telegram)
            waits, asked_end = self._asked is not None, self._asked_end
            ended, look_at = self.ended_ns, self._look_at
        if count:
            self._take(count, octets_sum, busy, asked_end, ended)

    def _take(self, count: int, octets: int, busy_ns: int, asked_end: int, ended_ns: int) -> None:
        """Add ``count`` exchanges that :meth:`add_all` has counted."""
        self.telegrams += 2 * count
        self.fitting_answers += count
        self.octets += octets
        self.busy_ns += busy_ns
        self._asked_end = asked_end
        self.ended_ns = ended_ns
        self._missed = None

    def _end_piece(self) -> None:
        self.pieces_ns.add(self._piece_ns)
        self._piece_ns = 0

    def _add_request(self, telegram: Telegram, fc: int, start: int, end: int) -> None:
        if self._asked is not None:
            self._give_up()
        da, sa, dsap = telegram.da, telegram.sa, telegram.dsap
        master = self.masters.get(sa)
        if master is None:
            master = self._new_master(sa)
        master.heard_at = end
        function = fc & FC_FUNCTION
        if da == BROADCAST or _NOT_ASKED[function]:
            if dsap == SAP_GLOBAL_CONTROL and telegram.data:
                self._global_control(master, telegram, start)
            elif not function:
                self._time_sent(master, telegram, start, end)
            return
        station = self.stations.get(da)
        if station is None:
            station = self._new_station(da)
        station.requests += 1
        station.asked_at = self._asked_end = end
        if not _IS_COUNTED[function]:
            if function == Req.FDL_STATUS:
                master.gap_polls += 1
            elif _RESERVED_FUNCTION[function]:
                self.reserved += 1
            self._asked = _Exchange(master, station, telegram, False)  # it belongs to no sequence of frame counts
            return
        key = sa << 7 | da
        before = self._exchanges.get(key)
        if dsap is None and telegram.data and is_pdu(telegram.data):
            self._is_asked_by_ppi(station)
        if before is None:
            self._asked = self._exchanges[key] = _Exchange(master, station, telegram, False)
            if dsap == SAP_SET_PRM:
                self._set_prm_begins(station, sa, start)
            return
        old = before.telegram.fc
        turned = (fc ^ old) & FC_FCB
        if fc & FC_FCV and not turned and (old & FC_FCV or before.answered):
            self._repeated(before, telegram)
            self._asked = before
            return
        if not (before.answered or fc & FC_FCV):
            if before.telegram == telegram:
                station.repeated_polls += 1
                self._asked = before
                return
            if station.state == _DATA_EXCHANGE and station.master == sa:
                self._leave(station, start, State.OFFLINE)  # the master gave it up: the frame count begins anew
        self._asked = self._exchanges[key] = _Exchange(
            master, station, telegram, before.answered and turned != 0 and fc & FC_FCV != 0
        )
        if dsap is None:
            reference = master.reference
            if reference == da or reference is None:
                self._round(master, station, start)
        elif dsap == SAP_SET_PRM:
            self._set_prm_begins(station, sa, start)

    def _add_answer(self, telegram: Telegram, fc: int, start: int, end: int) -> None:
        asked = self._asked
        if asked is None:
            self._add_late(telegram)
            return
        request = asked.telegram
        if fc < 0:
            if not _IS_COUNTED[request.fc & FC_FUNCTION]:
                self._add_late(telegram)
                return
            if asked.turned:
                self.fitting_answers += 1
        else:
            if not _fits(telegram, request):
                self._add_late(telegram)
                return
            if _RESERVED_STATUS[fc & FC_FUNCTION]:
                self.reserved += 1
            else:
                self.fitting_answers += 1
        self._asked = self._missed = None
        asked.answered = True
        station = asked.station
        station.answers += 1
        station.answered_at = end
        station.in_vain = 0
        t_sdr = start - self._asked_end
        if t_sdr >= self._together_ns:  # else it arrived together with its request, and nobody knows
            station.answer_ns.add(t_sdr)
        if asked.pieces:
            self.unattributed += asked.pieces
            asked.pieces = 0
        if request.dsap is None and _IS_COUNTED[request.fc & FC_FUNCTION] and (fc < 0 or _EXCHANGES[fc & FC_FUNCTION]):
            if station.state != _DATA_EXCHANGE or station.master != request.sa:
                if is_pdu(telegram.data):
                    self._is_asked_by_ppi(station)
                self._enter(station, request.sa, start)
            if _ANNOUNCES[fc & FC_FUNCTION]:
                station.unheard = Unheard.UNREAD
        else:
            self._answered(station, request, telegram, start)

    def _answered(self, station: Station, request: Telegram, answer: Telegram, start: int) -> None:
        """An answer to another service than Data_Exchange, or a refusal of that."""
        if station.state == State.OFFLINE:
            station.state = State.UNKNOWN
        dsap = request.dsap
        if answer.fc >= 0:
            status = answer.fc & FC_FUNCTION
            if status == Resp.RS:
                station.rs += 1
            elif status == Resp.RR:
                station.rr += 1
            elif dsap == SAP_SLAVE_DIAG:
                if len(answer.data) >= _DIAGNOSIS:
                    self._diagnosed(station, answer.data, start)
            elif dsap is None and request.fc & FC_FUNCTION == Req.FDL_STATUS:
                station.station_type = answer.station_type
        elif station.state != State.DATA_EXCHANGE or station.master == request.sa:
            if dsap == SAP_SET_PRM:
                station.state = State.SET_PRM
                station.master = request.sa
                station.set_prm = request.data
                station.link_status = None
                station.is_cpu = False
            elif dsap == SAP_CHK_CFG:
                station.state = State.CHK_CFG

    def _add_token(self, telegram: Telegram, start: int, end: int) -> None:
        if self._asked is not None:
            self._give_up()
        da, sa = telegram.da, telegram.sa
        last, self._token = self._token, telegram
        repeated = False
        if last is not None:
            if last.da == sa:
                self.passed_tokens += 1
            elif last.sa != sa:
                self.broken_tokens += 1
            else:
                repeated = last.da == da  # the receiver did not react
        master = self.masters.get(sa)
        if master is None:
            master = self._sender_of_token(sa, end)
            if master is None:
                return
        master.tokens += 1
        master.heard_at = end
        master.passed_over = 0
        if master.held_since is not None:
            master.hold_ns.add(start - master.held_since)
            master.held_since = None
        if not master.in_ring:
            master.in_ring = True
            self._on_change(Change(start, "joined", sa, f"master {sa} is in the token ring"))
        if repeated:
            receiver = self.masters.get(da)
            if receiver is not None:
                receiver.token_at = receiver.held_since = end
            return
        if len(self.masters) > 1:
            self._pass_over(sa, da, start)
        receiver = self.masters.get(da)
        if receiver is not None:
            if receiver.token_at is not None:
                receiver.token_ns.add(end - receiver.token_at)
            receiver.token_at = receiver.held_since = end

    # --- what is rare ---
    def _add_damaged(self, one: Transmission) -> None:
        cause = _cause(one)
        self.damaged[cause] = self.damaged.get(cause, 0) + 1
        self._damaged_after = self.telegrams
        asked = self._asked
        if asked is None:
            self.unattributed += 1
        elif _is_of_master(one.octets, asked.telegram.sa):
            self._give_up()
            self.unattributed += 1
        else:
            asked.pieces += 1

    def _add_late(self, telegram: Telegram) -> None:
        """A readable answer that does not fit the request before it: late, or nobody was heard asking for it."""
        missed = self._missed
        if self._damaged_after == self.telegrams - 1:  # its request was perhaps among the damaged octets
            self._exchanges.clear()
            self.strays += 1
        elif telegram.fc < 0:
            if missed is None or not _IS_COUNTED[missed.telegram.fc & FC_FUNCTION]:
                self.strays += 1
                return
            self._missed = None
            missed.station.late += 1
        else:
            station = self.stations.get(telegram.sa)
            if station is None or not station.requests or telegram.da not in self.masters:
                self.strays += 1
                return
            if missed is not None and missed.station is station:
                self._missed = None
            station.late += 1

    def _give_up(self) -> None:
        """The next telegram begins: the request before it has no answer."""
        asked = self._asked
        assert asked is not None
        station = asked.station
        station.in_vain += 1
        if asked.pieces:
            station.damaged += 1
            self.unattributed += asked.pieces - 1
            asked.pieces = 0
        else:
            station.no_answer += 1
        if asked.telegram.dsap == SAP_SLAVE_DIAG and station.diagnosis is not None:
            station.unheard = Unheard.UNREADABLE
        self._asked = None
        self._missed = asked

    def _repeated(self, exchange: _Exchange, telegram: Telegram) -> None:
        """The frame count bit was not turned: the slave takes ``telegram`` for a repetition."""
        station = exchange.station
        depth = station.retry_depth
        repeats = exchange.repeats
        if repeats < MAX_DEPTH:
            if repeats:
                depth[repeats - 1] -= 1
            depth[repeats] += 1
        exchange.repeats = repeats + 1
        exchange.telegram = telegram
        exchange.answered = False
        exchange.turned = False
        station.repetitions += 1

    def _set_prm_begins(self, station: Station, sa: int, start: int) -> None:
        """Its master begins a bring-up; a Set_Prm of another master is refused by a slave in data exchange."""
        if station.state == State.DATA_EXCHANGE and station.master == sa:
            self._leave(station, start, State.SET_PRM)

    def _is_asked_by_ppi(self, station: Station) -> None:
        """It is sent a PDU of an S7-200, or sends one; nothing has shown that it is a DP slave."""
        if station.is_cpu or station.ident is not None or station.set_prm is not None:
            return
        station.is_cpu = True
        for master in self.masters.values():
            master.slaves.discard(station.address)
            if master.reference == station.address:
                master.reference = master.round_at = None

    def _round(self, master: Master, station: Station, start: int) -> None:
        """A Data_Exchange that may begin a round of the master; requests of PPI come at other times."""
        if station.is_cpu:
            return
        master.reference = station.address
        if master.round_at is not None:
            master.rotation_ns.add(start - master.round_at)
        master.round_at = start

    def _enter(self, station: Station, master: int, start: int) -> None:
        """The station exchanges data with ``master``."""
        before = self.masters.get(-1 if station.master is None else station.master)
        if before is not None:
            before.slaves.discard(station.address)
        owner = self.masters.get(master)
        if owner is not None and not station.is_cpu:
            owner.slaves.add(station.address)
        station.master = master
        brought_up = station.state in (State.SET_PRM, State.CHK_CFG, State.WAIT_READY)
        was_away = station.state != State.DATA_EXCHANGE and station.lost > 0
        station.state = State.DATA_EXCHANGE
        if brought_up:
            station.syncs += 1
        if brought_up or was_away:
            self._on_change(Change(start, "back", station.address, f"station {station.address} exchanges data"))

    def _leave(self, station: Station, start: int, state: str) -> None:
        """The station exchanges no data any more."""
        station.state = state
        station.lost += 1
        master = self.masters.get(-1 if station.master is None else station.master)
        if master is not None and master.reference == station.address:
            master.reference = master.round_at = None
        self._on_change(Change(start, "lost", station.address, f"station {station.address} left data exchange"))

    def _diagnosed(self, station: Station, octets: bytes, start: int) -> None:
        station.diagnoses += 1
        station.unheard = Unheard.NOTHING
        station.ident = octets[4] << 8 | octets[5]
        station.is_cpu = False
        if station.state in (State.UNKNOWN, State.OFFLINE):
            station.state = State.DIAGNOSIS
        elif station.state == State.CHK_CFG:
            station.state = State.WAIT_READY
        if octets.find(_LINK_STATUS, _DIAGNOSIS) > 0:
            station.link_status = octets
        if octets != station.diagnosis:
            station.diagnosis = octets
            text = f"station {station.address}: new diagnosis"
            self._on_change(Change(start, "diagnosis", station.address, text, octets))

    def _global_control(self, master: Master, telegram: Telegram, start: int) -> None:
        mode = "clear" if telegram.data[0] & _CLEAR_DATA else "operate"
        if mode != master.mode:
            master.mode = mode
            self._on_change(Change(start, "mode", master.address, f"master {master.address} is in {mode.capitalize()}"))

    def _time_sent(self, master: Master, telegram: Telegram, start: int, end: int) -> None:
        """A Time_Event or a Clock_Value."""
        clock = master.clock
        if clock is None:
            from dpstack.monitor.clock import SentTime  # here, as few buses send the time

            clock = master.clock = SentTime()
            self._on_change(Change(start, "clock", master.address, f"master {master.address} sends the time"))
        if telegram.is_clock_value:
            clock.clock_value(telegram.data, end)
        else:
            clock.event(end)

    def _pass_over(self, sa: int, da: int, start: int) -> None:
        """The masters between ``sa`` and ``da`` did not get the token."""
        reach = (da - sa) % 128 or 128
        for master in self.masters.values():
            address = master.address
            if not master.in_ring or address in (sa, da) or (address - sa) % 128 >= reach:
                continue
            master.passed_over += 1
            master.forget_times()
            if master.passed_over >= PASSED_OVER:
                self._drop_out(master, start, "dropped out of the token ring")

    def _drop_out(self, master: Master, start: int, why: str) -> None:
        master.in_ring = False
        master.drops += 1
        master.forget_times()
        self._on_change(Change(start, "left", master.address, f"master {master.address} {why}"))

    def _sender_of_token(self, sa: int, end: int) -> Master | None:
        """The master that sent a token, if it is the third one of this sender: damage makes tokens of nobody."""
        doubtful = self._doubtful.get(sa)
        if doubtful is None or end - doubtful.heard_at > self._silent_ns:
            doubtful = self._doubtful[sa] = Master(sa)
        elif doubtful.tokens == _TOKENS_OF_NOBODY:
            return self._new_master(sa, self._doubtful.pop(sa))
        doubtful.tokens += 1
        doubtful.heard_at = end
        return None

    def _new_station(self, address: int) -> Station:
        station = self.stations[address] = Station(address)
        return station

    def _new_master(self, address: int, seen: Master | None = None) -> Master:
        station = self.stations.get(address) or self._new_station(address)
        station.is_master = True
        master = self.masters[address] = seen or self._doubtful.pop(address, None) or Master(address)
        return master

    def _new_rate(self, one: Transmission) -> None:
        before, self.baud = self.baud, one.baud
        self._set_rate(one.baud)
        if before:
            self.gap()
            self.fitting_answers = self.passed_tokens = self.reserved = self.broken_tokens = 0
            self._strays_before, self._telegrams_before = self.strays, self.telegrams
            self._on_change(Change(one.t_ns or 0, "rate", -1, f"the bus runs at {one.baud} bit/s now"))

    def _set_rate(self, baud: int) -> None:
        self._durations = [chars_to_ns(size, baud) for size in range(_LONGEST)]
        self._together_ns = TOGETHER_BITS * NS_PER_S // baud
        self._silent_ns = min(max(SILENT_NS, bits_to_ns(SILENT_BITS, baud)), LONGEST_SILENCE_NS)

    def gap(self, until_ns: int = 0) -> None:
        """Octets were lost here before they could be counted. The open request counts no more: nobody knows its end.
        Until ``until_ns`` (since 1970) nobody listened, so that no station counts as silent."""
        asked = self._asked
        if asked is not None:
            asked.station.requests -= 1
            self.unattributed += asked.pieces
        self._asked = self._missed = self._token = None
        self._exchanges.clear()
        self._damaged_after = self.telegrams
        for master in self.masters.values():
            master.forget_times()
            master.heard_at = max(master.heard_at, until_ns)
        for station in self.stations.values():
            station.answered_at = max(station.answered_at, until_ns)
            if not station.unheard:
                station.unheard = Unheard.GAP

    # --- silence ---
    def look(self, now: int) -> None:
        """Find stations that are silent at ``now`` (ns since 1970); :meth:`add` does it once a second, the caller does
        on a line where nothing is heard. A slave of which nothing is heard is offline if it was asked, else unknown; a
        silent master is in no ring and no mode."""
        self._look_at = now + NS_PER_S
        for master in self.masters.values():
            master.is_silent = now - master.heard_at >= self._silence_of(master)
            if master.is_silent:
                master.mode = "unknown"
                master.reference = None
                master.forget_times()
                if master.in_ring:
                    self._drop_out(master, now, "is silent")
        for station in self.stations.values():
            if station.is_master:  # it sends by itself
                station.state = State.OFFLINE if self.masters[station.address].is_silent else State.UNKNOWN
                continue
            if station.state == State.OFFLINE or not station.answers:
                continue
            owner = self.masters.get(-1 if station.master is None else station.master)
            if now - station.answered_at < (self._silent_ns if owner is None else self._silence_of(owner)):
                continue
            state = State.OFFLINE if station.in_vain >= OFFLINE_AFTER else State.UNKNOWN
            if station.state == State.DATA_EXCHANGE:
                self._leave(station, now, state)
            station.state = state
        self._on_look(now)

    def _silence_of(self, master: Master) -> int:
        """A master or its slave that is silent for so long (ns) is gone."""
        longest = 3 * max(master.rotation_ns.max_ns, master.token_ns.max_ns)
        return min(max(self._silent_ns, longest), LONGEST_SILENCE_NS)


#: looked up in each telegram
_SD4: Final = Kind.SD4
_DATA_EXCHANGE: Final = State.DATA_EXCHANGE
#: type and slot of a link status message
_LINK_STATUS: Final = b"\x83\0"
#: octets of the shortest diagnosis
_DIAGNOSIS: Final = 6


def _fits(answer: Telegram, request: Telegram) -> bool:
    """Whether an answer with addresses is one to ``request``: those of the request exchanged, and so the SAPs. SD1 has
    no SAPs: a refusal. The answer to MSRD goes to everybody."""
    if answer.sa != request.da:
        return False
    function = request.fc & FC_FUNCTION
    da, dsap, ssap = answer.da, answer.dsap, answer.ssap
    if da != request.sa and not (da == BROADCAST and function == Req.MSRD):
        return False
    if dsap is None and ssap is None:
        return not answer.data or (request.dsap is None and function != Req.FDL_STATUS)
    return dsap == request.ssap and ssap == request.dsap


def _is_of_master(octets: bytes, master: int) -> bool:
    """Whether damaged octets begin like a token or a request of ``master``, so that they are no answer to it."""
    if not octets or octets[0] == Kind.SD4:
        return bool(octets)
    at = _HEADS.get(octets[0])
    if at is None or len(octets) < at + 3:
        return False
    return octets[at + 1] & 0x7F == master and bool(octets[at + 2] & FC_REQUEST)


#: place of DA by start octet
_HEADS: Final[dict[int, int]] = {Kind.SD1: 1, Kind.SD2: 4, Kind.SD3: 1}


def _cause(one: Transmission) -> str:
    """The cause of damage: what the port marked, else the first thing found wrong."""
    if one.damage & Damage.PARITY_OR_FRAMING:
        return "parity"
    flaw = parse(one.octets, 0, len(one.octets)) if one.octets else None
    if flaw is None:
        return "short"
    return _CAUSES[flaw] if isinstance(flaw, Flaw) else "octets"
