"""The state machine of an active station as data: states, inputs, and one row per transition with its source.

Handlers are named ``owner.method``, with a short name for the class; :func:`handlers_by_state` binds them. A pair that
has no row is ignored and counted. ``docs/reference/fdl-states.md`` is made from this table by
``tools/make_pictures.py``.

Sources: facts docs/reference/protocol.md#the-token-ring, the documents "Felser" and "EN 50170-2"
docs/reference/protocol.md#sources; "rule" is a rule of this project with its reason.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Final

from msgspec import Struct

from dpstack.fdl.codec import NO_FRAME
from dpstack.fdl.telegram import FC_FUNCTION, FC_REQUEST, Kind, Req, Telegram
from dpstack.params import MAX_STATION
from dpstack.units import NEVER


class State(IntEnum):
    """The states of an active station (docs/reference/protocol.md#states-of-a-master)."""

    OFFLINE = 0
    LISTEN_TOKEN = 1
    ACTIVE_IDLE = 2
    CLAIM_TOKEN = 3
    USE_TOKEN = 4
    AWAIT_DATA_RESPONSE = 5
    CHECK_ACCESS_TIME = 6
    PASS_TOKEN = 7
    CHECK_TOKEN_PASS = 8
    AWAIT_STATUS_RESPONSE = 9


class Input(IntEnum):
    """The inputs of the state machine."""

    GO_ONLINE = 0  # ordered, while the line is up
    GO_OFFLINE = 1
    LINE_DOWN = 2
    TOKEN_TO_ME = 3  # a token with DA = TS
    TOKEN_SEEN = 4  # a token between others
    OWN_ADDRESS = 5  # a telegram with SA = TS that is not ours
    STATUS_REQUEST = 6  # an FDL status request with DA = TS
    REQUEST_TO_ME = 7  # another request with DA = TS
    REQUEST_SEEN = 8  # a request to somebody else, or to all
    RESPONSE = 9  # SC, or a response with DA = TS
    RESPONSE_SEEN = 10  # a response to somebody else
    ACTIVITY = 11  # an edge, or octets that are no telegram
    SENT = 12  # the telegram that waited is sent; the time is that of its last bit
    TIMEOUT = 13  # the deadline of the state is over
    HOLD = 14  # this station has the token now
    CHECK = 15  # choose the next telegram of this token hold


class Row(Struct, frozen=True):
    """A transition: in ``state`` on ``input`` call ``handler``, which enters one of ``next``.

    A handler may pass an input on to the state it entered (HOLD, CHECK, a telegram of another token holder): then the
    row of that state applies.
    """

    state: State
    input: Input
    handler: str
    next: tuple[State, ...]
    does: str
    source: str


# names of the module, because the look-up of an enum's member takes ten times as long; inputs as plain numbers, because
# an index that is an enum's member takes five times as long
(
    OFFLINE, LISTEN_TOKEN, ACTIVE_IDLE, CLAIM_TOKEN, USE_TOKEN,
    AWAIT_DATA_RESPONSE, CHECK_ACCESS_TIME, PASS_TOKEN, CHECK_TOKEN_PASS, AWAIT_STATUS_RESPONSE,
) = State  # fmt: skip
(
    GO_ONLINE, GO_OFFLINE, LINE_DOWN, TOKEN_TO_ME, TOKEN_SEEN, OWN_ADDRESS, STATUS_REQUEST, REQUEST_TO_ME,
    REQUEST_SEEN, RESPONSE, RESPONSE_SEEN, ACTIVITY, SENT, TIMEOUT, HOLD, CHECK,
) = map(int, Input)  # fmt: skip

_ONLINE: Final = tuple(s for s in State if s not in (OFFLINE, CHECK_ACCESS_TIME))
_WITHOUT_TOKEN: Final = (LISTEN_TOKEN, ACTIVE_IDLE)
#: states of a token hold in which a token or request of another station means that this station lost the token
_HOLDING: Final = (USE_TOKEN, AWAIT_DATA_RESPONSE, AWAIT_STATUS_RESPONSE, PASS_TOKEN)
_REQUESTS: Final = (STATUS_REQUEST, REQUEST_TO_ME, REQUEST_SEEN)
#: telegrams that only a token holder sends
_OF_A_HOLDER: Final = (TOKEN_TO_ME, TOKEN_SEEN, *_REQUESTS)

#: stands for "no telegram"; compared by identity
NONE: Final = Telegram(Kind.SC, -1, -1)
_SC: Final = Kind.SC

_FELSER: Final = "Felser, state machine"
_EN_P119: Final = f"{_FELSER}; EN 50170-2 p119"


def _rows() -> list[Row]:
    # states, inputs, handler, next states (none, or None: the state stays), what is done, source
    groups: tuple[tuple[tuple[State, ...], tuple[int, ...], str, tuple[State | None, ...], str, str], ...] = (
        # --- Offline ---
        ((OFFLINE,), (GO_ONLINE,), "idle.go_online", (LISTEN_TOKEN,), "listen first", _FELSER),
        ((OFFLINE,), (GO_OFFLINE, LINE_DOWN), "idle.stay_offline", (), "stay out", "rule"),
        (_ONLINE, (LINE_DOWN,), "idle.line_down", (OFFLINE,), "the port is gone: abandon everything", "rule"),
        # --- Listen_Token ---
        ((LISTEN_TOKEN,), (TOKEN_SEEN,), "idle.learn", (),
         "build the LAS; accept it after two identical rotations", f"{_FELSER}; EN 50170-2 p102"),
        ((LISTEN_TOKEN,), (TOKEN_TO_ME,), "idle.learn", (), "build the LAS; a listener takes no token", _FELSER),
        ((LISTEN_TOKEN,), (STATUS_REQUEST,), "idle.status_listening", (LISTEN_TOKEN, ACTIVE_IDLE),
         "answer 'not ready'; with the LAS 'ready', then wait for the token", _FELSER),
        ((LISTEN_TOKEN,), (REQUEST_TO_ME,), "idle.drop_answer", (), "stay silent", _FELSER),
        ((LISTEN_TOKEN,), (REQUEST_SEEN,), "idle.request_listening", (),
         "note who sent it, drop an answer not yet sent; a clock telegram is noted", "rule"),
        ((LISTEN_TOKEN,), (TIMEOUT,), "idle.silence", (LISTEN_TOKEN, CLAIM_TOKEN),
         "silent for T_TO: claim the token; back-off over: listen afresh", _EN_P119),
        # --- Active_Idle ---
        ((ACTIVE_IDLE,), (TOKEN_TO_ME,), "idle.token_to_me", (ACTIVE_IDLE, USE_TOKEN),
         "from PS, or who repeated a pass in vain: take it; else refuse it once, take it the second time",
         f"{_FELSER}; rule"),
        ((ACTIVE_IDLE,), (TOKEN_SEEN,), "idle.token_seen", (ACTIVE_IDLE, LISTEN_TOKEN),
         "keep the LAS; skipped by the ring: listen again", _FELSER),
        ((ACTIVE_IDLE,), (STATUS_REQUEST,), "idle.status_in_ring", (),
         "answer 'in ring', before the first token 'ready'", _FELSER),
        ((ACTIVE_IDLE,), (REQUEST_TO_ME,), "idle.request_to_me", (),
         "answer as the SAPs of the program say; RS while none is open",
         "EN 50170-2 p59, p62, p131; Felser, function code"),
        ((ACTIVE_IDLE,), (REQUEST_SEEN,), "idle.request_seen", (),
         "drop an answer not yet sent; an SDN to all is for the SAPs of the program, a clock telegram is noted",
         "rule; EN 50170-2 p59"),
        ((ACTIVE_IDLE,), (TIMEOUT,), "idle.silence", (ACTIVE_IDLE, CLAIM_TOKEN),
         "silent for T_TO: the token is lost, claim it", _EN_P119),
        # --- Listen_Token, Active_Idle, Claim_Token ---
        (_WITHOUT_TOKEN, (RESPONSE_SEEN, ACTIVITY), "idle.drop_answer", (), "drop an answer not yet sent", "rule"),
        (_WITHOUT_TOKEN, (SENT,), "idle.answered", (), "the status was answered", _FELSER),
        (_WITHOUT_TOKEN, (RESPONSE,), "idle.late", (), "a late answer, or SC: count it", "rule"),
        ((*_WITHOUT_TOKEN, CLAIM_TOKEN), (GO_OFFLINE,), "idle.leave", (OFFLINE,), "leave; the ring drops TS", _FELSER),
        ((CLAIM_TOKEN,), (SENT,), "idle.claim_sent", (CLAIM_TOKEN, USE_TOKEN),
         "two tokens to itself, then it is ours", _FELSER),
        ((CLAIM_TOKEN,), (*_OF_A_HOLDER, RESPONSE_SEEN, RESPONSE, ACTIVITY), "idle.claim_broken",
         (ACTIVE_IDLE, LISTEN_TOKEN), "the line lives: no claim", "rule"),
        # --- Use_Token ---
        ((USE_TOKEN,), (HOLD,), "hold.begin", (CHECK_ACCESS_TIME,),
         "T_TH = T_TR - T_RR; ask the users", "EN 50170-2 p119"),
        ((USE_TOKEN,), (SENT,), "exchange.sent", (AWAIT_DATA_RESPONSE, AWAIT_STATUS_RESPONSE, CHECK_ACCESS_TIME),
         "wait for the answer; after an SDN go on with T_ID2", "EN 50170-2 p119"),
        ((USE_TOKEN, PASS_TOKEN), (RESPONSE,), "exchange.late", (), "a late answer: count it", "rule"),
        ((USE_TOKEN,), (TIMEOUT,), "hold.resume", (CHECK_ACCESS_TIME,),
         "the fixed cycle for which the token was kept is due", "rule"),
        ((USE_TOKEN,), (GO_OFFLINE,), "hold.leave_now", (PASS_TOKEN, OFFLINE),
         "abandon what was not started, pass the token on", "rule"),
        # --- Await_Data_Response ---
        ((AWAIT_DATA_RESPONSE,), (RESPONSE,), "exchange.response", (AWAIT_DATA_RESPONSE, CHECK_ACCESS_TIME),
         "it answers the request: done; it does not: count it, keep waiting", "EN 50170-2 p119, p131"),
        ((AWAIT_DATA_RESPONSE,), (TIMEOUT,), "exchange.timeout", (AWAIT_DATA_RESPONSE, CHECK_ACCESS_TIME),
         "T_SL over: repeat with unchanged FCB, or give up", "EN 50170-2 p119, p131"),
        ((AWAIT_DATA_RESPONSE,), (SENT,), "exchange.sent", (),
         "wait for the answer to the repetition", "EN 50170-2 p131"),
        # --- Check_Access_Time: never rests, what comes next is decided at once ---
        ((CHECK_ACCESS_TIME,), (CHECK,), "hold.check", (USE_TOKEN, PASS_TOKEN, OFFLINE),
         "high priority once even when late, low while time is left, then the GAP, then the token; kept for a fixed "
         "cycle that is due at once", "EN 50170-2 p102, p119; rule"),
        # --- Pass_Token, Check_Token_Pass ---
        ((PASS_TOKEN,), (SENT,), "passing.sent", (CHECK_TOKEN_PASS, USE_TOKEN, OFFLINE),
         "watch NS; a lone master holds the token again", "Felser, state machine; lone master"),
        ((CHECK_TOKEN_PASS,), (TIMEOUT,), "passing.timeout", (PASS_TOKEN, ACTIVE_IDLE, OFFLINE),
         "silent: repeat twice, then drop NS; noise only: believe that NS has it", _FELSER),
        ((CHECK_TOKEN_PASS,), (ACTIVITY,), "passing.activity", (), "watch for a telegram for another T_SL", _FELSER),
        ((CHECK_TOKEN_PASS,), (RESPONSE,), "passing.response", (CHECK_TOKEN_PASS, ACTIVE_IDLE, OFFLINE),
         "SC: somebody is active; a response to TS is a late one and proves nothing", "rule"),
        ((CHECK_TOKEN_PASS,), (*_OF_A_HOLDER, RESPONSE_SEEN), "passing.confirmed", (ACTIVE_IDLE, OFFLINE),
         "NS has the token", _FELSER),
        # --- Await_Status_Response ---
        ((AWAIT_STATUS_RESPONSE,), (RESPONSE,), "poll.status", (AWAIT_STATUS_RESPONSE, PASS_TOKEN, OFFLINE),
         "'ready' becomes NS; note slaves; pass the token", "EN 50170-2 p102"),
        ((AWAIT_STATUS_RESPONSE,), (TIMEOUT,), "poll.timeout", (PASS_TOKEN, OFFLINE),
         "nobody there: pass the token", "EN 50170-2 p102"),
        ((AWAIT_STATUS_RESPONSE,), (RESPONSE_SEEN,), "poll.stray", (), "count it", "rule"),
        ((AWAIT_STATUS_RESPONSE,), (ACTIVITY,), "poll.noise", (), "note it", "rule"),
        # --- all states of a token hold ---
        ((USE_TOKEN, PASS_TOKEN), (RESPONSE_SEEN,), "exchange.stray", (), "count it", "rule"),
        ((AWAIT_DATA_RESPONSE,), (RESPONSE_SEEN,), "exchange.response_to_all",
         (AWAIT_DATA_RESPONSE, CHECK_ACCESS_TIME),
         "the answer to MSRD goes to all stations: as one to TS; any other: count it", "VPC3+C manual p58; rule"),
        ((USE_TOKEN, AWAIT_DATA_RESPONSE, PASS_TOKEN), (ACTIVITY,), "exchange.noise", (), "note it", "rule"),
        ((*_HOLDING[1:], CHECK_TOKEN_PASS), (GO_OFFLINE,), "hold.leave", (),
         "end this, pass the token, then Offline", "rule"),
        ((USE_TOKEN,), (TOKEN_TO_ME,), "hold.withdraw", (USE_TOKEN, ACTIVE_IDLE, OFFLINE),
         "repeated by PS before we started: still ours; else withdraw", _EN_P119),
        (_HOLDING[1:], (TOKEN_TO_ME,), "hold.withdraw", (ACTIVE_IDLE, OFFLINE),
         "somebody else held the token: withdraw", _EN_P119),
        (_HOLDING, _OF_A_HOLDER[1:], "hold.withdraw", (ACTIVE_IDLE, OFFLINE),
         "somebody else holds the token: withdraw", _EN_P119),
        (_ONLINE, (OWN_ADDRESS,), "idle.own_address", (None, LISTEN_TOKEN, OFFLINE),
         "somebody has this address: stay out, back off, listen again", _FELSER),
    )  # fmt: skip
    rows = [
        Row(state, Input(what), handler, tuple(state if t is None else t for t in targets) or (state,), does, source)
        for states, inputs, handler, targets, does, source in groups
        for state in states
        for what in inputs
    ]
    return sorted(rows, key=lambda row: (row.state, row.input))


TABLE: Final[tuple[Row, ...]] = tuple(_rows())

#: a method of one of the state classes, called with a telegram (NONE for another input) and the time
Handler = Callable[[Telegram, int], None]
Rows = dict[State, tuple[Handler, ...]]


def handlers_by_state(owners: Mapping[str, object], default: Handler) -> Rows:
    """``result[state][input]`` is the handler; pairs without a row get ``default``. ``owners`` by their short name."""
    result = {state: [default] * len(Input) for state in State}
    for row in TABLE:
        owner, name = row.handler.split(".")
        result[row.state][row.input] = getattr(owners[owner], name)
    return {state: tuple(handlers) for state, handlers in result.items()}


class StateMachine:
    """The state of station ``ts``, the deadline of that state, and its handlers."""

    def __init__(self, ts: int) -> None:
        self.ts = ts
        self.state = OFFLINE
        self.deadline = NEVER
        self.row: tuple[Handler, ...] = ()
        self.rows: Rows = {}
        # the rows of the states that every exchange goes through
        self.checking: tuple[Handler, ...] = ()
        self.using: tuple[Handler, ...] = ()
        self.awaiting_data: tuple[Handler, ...] = ()
        #: the frame of the likely answer to the last request: its telegram is a response to this station
        self.expected = NO_FRAME

    def bind(self, rows: Rows) -> None:
        """Use ``rows[state][input]`` as handlers."""
        self.rows = rows
        self.row = rows[self.state]
        self.checking = rows[CHECK_ACCESS_TIME]
        self.using = rows[USE_TOKEN]
        self.awaiting_data = rows[AWAIT_DATA_RESPONSE]

    def enter(self, state: State, deadline: int = NEVER) -> None:
        """Change to ``state`` with its own ``deadline``."""
        self.state = state
        self.row = self.rows[state]
        self.deadline = deadline

    def timeout(self, now: int) -> None:
        """The deadline of the state is over: run its handler."""
        self.deadline = NEVER
        self.row[TIMEOUT](NONE, now)

    def hold(self, now: int) -> None:
        """This station has the token since ``now``."""
        self.enter(USE_TOKEN)
        self.row[HOLD](NONE, now)

    def check(self, now: int) -> None:
        """Choose the next telegram of this token hold."""
        self.state = CHECK_ACCESS_TIME
        self.row = row = self.checking
        self.deadline = NEVER
        row[CHECK](NONE, now)

    def telegram(self, telegram: Telegram, now: int) -> None:
        """Classify ``telegram`` for this station and run the handler of that input."""
        if telegram is self.expected.last[1]:
            self.row[RESPONSE](telegram, now)
            return
        ts, fc = self.ts, telegram.fc
        if fc >= 0:
            if telegram.sa == ts:
                what = OWN_ADDRESS
            elif not fc & FC_REQUEST:
                what = RESPONSE if telegram.da == ts else RESPONSE_SEEN
            elif telegram.da != ts:
                what = REQUEST_SEEN
            else:
                status = fc & (FC_FUNCTION | 0x80) == Req.FDL_STATUS
                what = STATUS_REQUEST if status else REQUEST_TO_ME
        elif telegram.kind is _SC:
            what = RESPONSE
        elif telegram.da > MAX_STATION or telegram.sa > MAX_STATION:
            what = ACTIVITY  # no master can have such an address: a damaged token
        elif telegram.sa == ts:
            what = OWN_ADDRESS
        else:
            what = TOKEN_TO_ME if telegram.da == ts else TOKEN_SEEN
        self.row[what](telegram, now)
