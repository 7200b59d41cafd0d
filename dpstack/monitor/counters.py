"""Counters of stations, masters and the bus, from the transmissions on a line.

Every telegram that asks a station is a request, repetitions too, and ends as one of three: answered, answered in a way
that nobody could read (damaged), or not answered: requests = answers + damaged + no_answer. Damaged octets belong to
the station that was asked just before; where nobody was asked, or where an answer came as well, they are
``unattributed``. So each damaged transmission counts once, at a station or as unattributed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from dpstack.capture.transmission import Transmission
from dpstack.fdl.codec import Flaw, decode, parse
from dpstack.fdl.telegram import (
    COUNTED,
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
from dpstack.params import BROADCAST
from dpstack.stats import Histogram
from dpstack.units import NS_PER_S, chars_to_ns

#: an exchange is repeated at most this often (max_retry up to 15 exists, DP masters have up to 8)
MAX_DEPTH: Final = 8
#: A station that was asked and has not answered for this time is offline; one that nobody asks is unknown.
SILENT_NS: Final = 2 * NS_PER_S
#: gaps of less than this, in bit times, do not exist on a wire (min T_SDR): the telegrams arrived together
TOGETHER_BITS: Final = 10
#: Global_Control: bit of Clear_Data
_CLEAR_DATA: Final = 2
_LONGEST: Final = 256
_NOT_ASKED = tuple(number in UNANSWERED for number in range(16))
_IS_COUNTED = tuple(number in COUNTED for number in range(16))


class State:
    """States of a slave, as ``run --json`` names them."""

    UNKNOWN: Final = "unknown"
    OFFLINE: Final = "offline"
    DIAGNOSIS: Final = "diagnosis"
    SET_PRM: Final = "set_prm"
    CHK_CFG: Final = "chk_cfg"
    WAIT_READY: Final = "wait_ready"
    DATA_EXCHANGE: Final = "data_exchange"


class Change(NamedTuple):
    """A change of a station for the time line. ``kind``: lost, back, diagnosis, joined, left, mode, rate.

    ``t_ns``: since 1970. ``octets``: of a new diagnosis.
    """

    t_ns: int
    kind: str
    address: int
    text: str
    octets: bytes = b""


@dataclass(slots=True, eq=False)
class Station:
    """Counters of one station that is asked. ``retry_depth[i]``: exchanges that needed i + 1 repetitions.

    ``repeated_polls``: unanswered requests without a frame count that were sent again as they were. ``late``: answers
    after the next telegram had begun. ``syncs``: bring-ups that ended in data exchange. ``lost``: times it left data
    exchange. ``answer_ns``: from the end of the request to the begin of the answer (T_SDR).
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
    syncs: int = 0
    lost: int = 0
    state: str = State.UNKNOWN
    master: int | None = None
    ident: int | None = None
    station_type: StationType | None = None
    answer_ns: Histogram = field(default_factory=Histogram)
    asked_at: int = 0
    answered_at: int = 0
    is_master: bool = False
    #: damaged and missing answers by the time of a minute's tenth, for "in bursts"
    failures: list[int] = field(default_factory=list)

    @property
    def is_present(self) -> bool:
        """It was heard: it has answered, or sends by itself."""
        return bool(self.answers or self.damaged or self.late or self.is_master)


@dataclass(slots=True, eq=False)
class Master:
    """Counters of one master. ``token_ns``: from token to token; ``hold_ns``: from the token to passing it on;
    ``rotation_ns``: from the first Data_Exchange of a round to that of the next. ``drops``: times it fell out of the
    ring. ``mode``: of its last Global_Control: operate, clear, or unknown.
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
    slaves: set[int] = field(default_factory=set)
    token_at: int | None = None
    held_since: int | None = None
    reference: int | None = None  # the slave whose Data_Exchange begins a round
    round_at: int | None = None


class _Exchange:
    """The last exchange of a master with a station."""

    __slots__ = ("answered", "pieces", "repeats", "station", "telegram")

    def __init__(self, station: Station, telegram: Telegram) -> None:
        self.station = station
        self.telegram = telegram
        self.answered = False
        self.repeats = 0
        self.pieces = 0  # damaged transmissions since the request


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
    """Counts the transmissions of one bus. ``on_change`` is called with each change for the time line."""

    def __init__(self, on_change: Callable[[Change], None] = lambda change: None) -> None:
        self.stations: dict[int, Station] = {}
        self.masters: dict[int, Master] = {}
        self.telegrams = 0
        #: damaged transmissions by cause: "fcs", "short", "start", "parity", "octets"
        self.damaged: dict[str, int] = {}
        self.unattributed = 0
        #: telegrams that began when the one before had hardly ended: they arrived together in the computer
        self.together = 0
        self.octets = 0
        self.busy_ns = 0
        self.begun_ns: int | None = None
        self.ended_ns = 0
        self.baud = 0
        #: answers that fit requests, tokens that were passed on: evidence that this is PROFIBUS
        self.fitting_answers = 0
        self.passed_tokens = 0
        self._on_change = on_change
        self._asked: _Exchange | None = None
        self._asked_end = 0
        self._missed: _Exchange | None = None
        self._missed_end = 0
        self._exchanges: dict[int, _Exchange] = {}  # by master * 128 + station
        self._durations: list[int] = []
        self._together_ns = 0
        self._token_to: int | None = None
        self._look_at = 0

    # --- the hot path ---
    def add(self, one: Transmission) -> None:
        """Count one transmission; its times must not run backwards. Never raises for octets."""
        octets = one.octets
        if one.baud != self.baud:
            self._new_rate(one)
        size = len(octets)
        start = self.ended_ns if one.t_ns is None else one.t_ns
        duration = self._durations[size] if size < _LONGEST else chars_to_ns(size, self.baud)
        self.octets += size
        self.busy_ns += duration
        if self.begun_ns is None:
            self.begun_ns = start
        elif start - self.ended_ns < self._together_ns:
            self.together += 1
        end = self.ended_ns = start + duration
        telegram = None if one.damage else decode(octets)
        if telegram is None:
            self._add_damaged(one)
        else:
            self.telegrams += 1
            fc = telegram.fc
            if fc < 0:
                if telegram.kind is Kind.SD4:
                    self._add_token(telegram, start, end)
                else:
                    self._add_answer(telegram, start, end)
            elif fc & FC_REQUEST:
                self._add_request(telegram, start, end)
            else:
                self._add_answer(telegram, start, end)
        if end >= self._look_at:
            self._look(end)

    def _add_request(self, telegram: Telegram, start: int, end: int) -> None:
        if self._asked is not None:
            self._give_up()
        fc, sa, da = telegram.fc, telegram.sa, telegram.da
        master = self.masters.get(sa) or self._new_master(sa)
        function = fc & FC_FUNCTION
        if da == BROADCAST or _NOT_ASKED[function]:
            self._missed = None
            if telegram.dsap == SAP_GLOBAL_CONTROL and telegram.data:
                self._global_control(master, telegram, start)
            return
        station = self.stations.get(da) or self._new_station(da)
        station.requests += 1
        station.asked_at = end
        if function == Req.FDL_STATUS:
            master.gap_polls += 1
        key = sa << 7 | da
        before = self._exchanges.get(key)
        if before is not None and not before.answered and before.telegram == telegram and _IS_COUNTED[function]:
            exchange = before
            exchange.pieces = 0
            if fc & FC_FCV:
                depth = station.retry_depth
                if exchange.repeats < MAX_DEPTH:
                    if exchange.repeats:
                        depth[exchange.repeats - 1] -= 1
                    depth[exchange.repeats] += 1
                exchange.repeats += 1
                station.repetitions += 1
            else:
                station.repeated_polls += 1
        elif before is not None and function == Req.FDL_STATUS:
            exchange = _Exchange(station, telegram)  # it belongs to no sequence of frame counts
        else:
            exchange = self._exchanges[key] = _Exchange(station, telegram)
            if station.state == State.DATA_EXCHANGE:
                starts_over = telegram.dsap == SAP_SET_PRM
                given_up = before is not None and not before.answered and not fc & FC_FCV
                if starts_over or given_up:
                    self._leave(station, start, State.SET_PRM if starts_over else State.OFFLINE)
            if telegram.dsap is None and _IS_COUNTED[function] and master.reference in (None, da):
                self._round(master, da, start)
        self._asked = exchange
        self._asked_end = end

    def _add_answer(self, telegram: Telegram, start: int, end: int) -> None:
        asked = self._asked
        if asked is not None:
            request = asked.telegram
            if telegram.fc < 0 or (telegram.sa == request.da and telegram.da == request.sa):
                self._asked = self._missed = None
                asked.answered = True
                station = asked.station
                station.answers += 1
                station.answered_at = end
                station.answer_ns.add(start - self._asked_end)
                self.unattributed += asked.pieces
                asked.pieces = 0
                self.fitting_answers += 1
                self._answered(station, request, telegram, start)
                return
        missed = self._missed
        if missed is not None:
            request = missed.telegram
            if telegram.fc < 0 or (telegram.sa == request.da and telegram.da == request.sa):
                self._missed = None
                missed.station.late += 1
                return
        self.unattributed += 1

    def _answered(self, station: Station, request: Telegram, answer: Telegram, start: int) -> None:
        dsap = request.dsap
        if answer.fc >= 0:
            function = answer.fc & FC_FUNCTION
            if function == Resp.RS:
                station.rs += 1
                return
            if function == Resp.RR:
                station.rr += 1
                return
        elif dsap is not None:
            if dsap == SAP_SET_PRM:
                station.state = State.SET_PRM
                station.master = request.sa
            elif dsap == SAP_CHK_CFG:
                station.state = State.CHK_CFG
            return
        if dsap is None:
            if _IS_COUNTED[request.fc & FC_FUNCTION]:
                if station.state != State.DATA_EXCHANGE:
                    self._enter(station, request.sa, start)
            elif answer.fc >= 0:
                station.station_type = answer.station_type
        elif dsap == SAP_SLAVE_DIAG and len(answer.data) >= 6:
            self._diagnosed(station, answer.data, start)

    def _add_token(self, telegram: Telegram, start: int, end: int) -> None:
        if self._asked is not None:
            self._give_up()
        self._missed = None
        sa, da = telegram.sa, telegram.da
        master = self.masters.get(sa) or self._new_master(sa)
        master.tokens += 1
        if master.held_since is not None:
            master.hold_ns.add(start - master.held_since)
            master.held_since = None
        if self._token_to == sa:
            self.passed_tokens += 1
        self._token_to = da
        if not master.in_ring:
            master.in_ring = True
            self._on_change(Change(start, "joined", sa, f"master {sa} is in the token ring"))
        if len(self.masters) > 1:
            self._skip(sa, da, start)
        receiver = self.masters.get(da)
        if receiver is not None:
            if receiver.token_at is not None:
                receiver.token_ns.add(end - receiver.token_at)
            receiver.token_at = receiver.held_since = end

    def _add_damaged(self, one: Transmission) -> None:
        flaw = parse(one.octets, 0, len(one.octets)) if one.octets else None
        cause = _CAUSES.get(flaw, "octets") if isinstance(flaw, Flaw) else "short" if flaw is None else "parity"
        self.damaged[cause] = self.damaged.get(cause, 0) + 1
        if self._asked is not None:
            self._asked.pieces += 1
        else:
            self.unattributed += 1

    # --- changes, which are rare ---
    def _give_up(self) -> None:
        """The next telegram begins: the request before it has no answer."""
        asked = self._asked
        assert asked is not None
        station = asked.station
        if asked.pieces:
            station.damaged += 1
            self.unattributed += asked.pieces - 1
            asked.pieces = 0
        else:
            station.no_answer += 1
        self._asked = None
        self._missed, self._missed_end = asked, self._asked_end

    def _round(self, master: Master, da: int, start: int) -> None:
        master.reference = da
        if master.round_at is not None:
            master.rotation_ns.add(start - master.round_at)
        master.round_at = start

    def _enter(self, station: Station, master: int, start: int) -> None:
        """The station exchanges data."""
        owner = self.masters.get(master)
        if owner is not None:
            owner.slaves.add(station.address)
        station.master = master
        known = station.state != State.UNKNOWN
        station.state = State.DATA_EXCHANGE
        if known:
            station.syncs += 1
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
        station.ident = octets[4] << 8 | octets[5]
        if station.state in (State.UNKNOWN, State.OFFLINE):
            station.state = State.DIAGNOSIS
        elif station.state == State.CHK_CFG:
            station.state = State.WAIT_READY
        if octets != station.diagnosis:
            station.diagnosis = octets
            text = f"station {station.address}: new diagnosis"
            self._on_change(Change(start, "diagnosis", station.address, text, octets))

    def _global_control(self, master: Master, telegram: Telegram, start: int) -> None:
        mode = "clear" if telegram.data[0] & _CLEAR_DATA else "operate"
        if mode != master.mode:
            master.mode = mode
            self._on_change(Change(start, "mode", master.address, f"master {master.address} is in {mode.capitalize()}"))

    def _skip(self, sa: int, da: int, start: int) -> None:
        """The masters between ``sa`` and ``da`` did not get the token: they are out of the ring."""
        for master in self.masters.values():
            address = master.address
            if not master.in_ring or address in (sa, da):
                continue
            if (address - sa) % 128 < ((da - sa) % 128 or 128):
                master.in_ring = False
                master.drops += 1
                master.token_at = master.held_since = None
                self._on_change(Change(start, "left", address, f"master {address} dropped out of the token ring"))

    def _new_station(self, address: int) -> Station:
        station = self.stations[address] = Station(address)
        return station

    def _new_master(self, address: int) -> Master:
        station = self.stations.get(address) or self._new_station(address)
        station.is_master = True
        master = self.masters[address] = Master(address)
        return master

    def _new_rate(self, one: Transmission) -> None:
        if self.baud:
            self._on_change(Change(one.t_ns or 0, "rate", -1, f"the bus runs at {one.baud} bit/s now"))
        self.baud = one.baud
        baud = one.baud or 9600
        self._durations = [chars_to_ns(size, baud) for size in range(_LONGEST)]
        self._together_ns = TOGETHER_BITS * NS_PER_S // baud

    def _look(self, now: int) -> None:
        """Once a second: stations that are silent, or that nobody asks any more."""
        self._look_at = now + NS_PER_S
        for station in self.stations.values():
            if station.state in (State.UNKNOWN, State.OFFLINE) or now - station.answered_at < SILENT_NS:
                continue
            state = State.UNKNOWN if now - station.asked_at >= SILENT_NS else State.OFFLINE
            if station.state == State.DATA_EXCHANGE:
                self._leave(station, now, state)
            station.state = state
