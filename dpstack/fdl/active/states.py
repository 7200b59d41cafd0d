"""The state machine of an active station as data: states, inputs, and one row per transition with its source.

Handlers are named ``module.function``, with a short name for the module; :func:`handlers_by_state` binds them. A pair
that has no row is ignored and counted. ``docs/fdl-states.md`` is made from this table by ``tools/make_pictures.py``.

Sources: facts docs/protocol.md#the-token-ring, the documents "Felser" and "EN 50170-2" docs/protocol.md#sources; "rule"
is a rule of this project with its reason.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Final, NamedTuple, TypeVar


class State(IntEnum):
    """The states of an active station (docs/protocol.md#states-of-a-master)."""

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
    """What can happen to an active station."""

    GO_ONLINE = 0
    GO_OFFLINE = 1
    LINE_DOWN = 2
    LINE_UP = 3
    TOKEN_TO_ME = 4  # a token with DA = TS
    TOKEN_SEEN = 5  # a token between others
    OWN_ADDRESS = 6  # a telegram with SA = TS that is not ours
    STATUS_REQUEST = 7  # an FDL status request with DA = TS
    REQUEST_TO_ME = 8  # another request with DA = TS
    REQUEST_SEEN = 9  # a request to somebody else, or to all
    RESPONSE = 10  # SC, or a response with DA = TS
    RESPONSE_SEEN = 11  # a response to somebody else
    ACTIVITY = 12  # an edge, or octets that are no telegram
    SENT = 13  # the waiting telegram went on the line; the time is that of its last bit
    TIMEOUT = 14  # the deadline of the state is over
    HOLD = 15  # the token is ours now
    CHECK = 16  # what comes next in this token hold


class Row(NamedTuple):
    """One transition: in ``state`` on ``input`` call ``handler``, which enters one of ``next``.

    A handler may pass an input on to the state it entered (HOLD, CHECK, a telegram of another token holder): what
    happens then is the business of that state's row.
    """

    state: State
    input: Input
    handler: str
    next: tuple[State, ...]
    does: str
    source: str


_S = State
_I = Input
_ONLINE: Final = tuple(s for s in State if s not in (State.OFFLINE, State.CHECK_ACCESS_TIME))
#: states in which this station holds the token and somebody else's token or request means that it does not
_HOLDING: Final = (_S.USE_TOKEN, _S.AWAIT_DATA_RESPONSE, _S.AWAIT_STATUS_RESPONSE, _S.PASS_TOKEN)
_REQUESTS: Final = (_I.STATUS_REQUEST, _I.REQUEST_TO_ME, _I.REQUEST_SEEN)

_FELSER = "Felser, state machine"


def _rows() -> list[Row]:
    rows = [
        # --- Offline ---
        Row(_S.OFFLINE, _I.GO_ONLINE, "idle.go_online", (_S.LISTEN_TOKEN, _S.OFFLINE),
            "listen first; without a line wait for it", _FELSER),
        Row(_S.OFFLINE, _I.GO_OFFLINE, "idle.stay_offline", (_S.OFFLINE,), "stay out, forget the wish", "rule"),
        Row(_S.OFFLINE, _I.LINE_DOWN, "idle.stay_offline", (_S.OFFLINE,), "stay out", "rule"),
        Row(_S.OFFLINE, _I.LINE_UP, "idle.line_up", (_S.LISTEN_TOKEN, _S.OFFLINE), "listen again if wanted", "rule"),
        # --- Listen_Token ---
        Row(_S.LISTEN_TOKEN, _I.TOKEN_SEEN, "idle.learn", (_S.LISTEN_TOKEN,),
            "build the LAS; accept it after two identical rotations", f"{_FELSER}; EN 50170-2 p102"),
        Row(_S.LISTEN_TOKEN, _I.TOKEN_TO_ME, "idle.learn", (_S.LISTEN_TOKEN,),
            "build the LAS; a listener takes no token", _FELSER),
        Row(_S.LISTEN_TOKEN, _I.STATUS_REQUEST, "idle.status_listening", (_S.LISTEN_TOKEN, _S.ACTIVE_IDLE),
            "answer 'not ready'; with the LAS 'ready', then wait for the token", _FELSER),
        Row(_S.LISTEN_TOKEN, _I.TIMEOUT, "idle.silence", (_S.LISTEN_TOKEN, _S.CLAIM_TOKEN),
            "silent for T_TO: claim the token; back-off over: listen afresh", f"{_FELSER}; EN 50170-2 p119"),
        # --- Active_Idle ---
        Row(_S.ACTIVE_IDLE, _I.TOKEN_TO_ME, "idle.token_to_me", (_S.ACTIVE_IDLE, _S.USE_TOKEN),
            "from PS, or who repeated a pass in vain: take it; else refuse it once, take it the second time",
            f"{_FELSER}; rule"),
        Row(_S.ACTIVE_IDLE, _I.TOKEN_SEEN, "idle.token_seen", (_S.ACTIVE_IDLE, _S.LISTEN_TOKEN),
            "keep the LAS; skipped by the ring: listen again", _FELSER),
        Row(_S.ACTIVE_IDLE, _I.STATUS_REQUEST, "idle.status_in_ring", (_S.ACTIVE_IDLE,),
            "answer 'in ring', before the first token 'ready'", _FELSER),
        Row(_S.ACTIVE_IDLE, _I.REQUEST_TO_ME, "idle.no_service", (_S.ACTIVE_IDLE,),
            "answer RS: no SAP of a master is open", "EN 50170-2 p131; Felser, function code"),
        Row(_S.ACTIVE_IDLE, _I.TIMEOUT, "idle.silence", (_S.ACTIVE_IDLE, _S.CLAIM_TOKEN),
            "silent for T_TO: the token is lost, claim it", f"{_FELSER}; EN 50170-2 p119"),
        # --- Claim_Token ---
        Row(_S.CLAIM_TOKEN, _I.SENT, "idle.claim_sent", (_S.CLAIM_TOKEN, _S.USE_TOKEN),
            "two tokens to itself, then it is ours", _FELSER),
        # --- Use_Token ---
        Row(_S.USE_TOKEN, _I.HOLD, "hold.begin", (_S.CHECK_ACCESS_TIME,),
            "T_TH = T_TR - T_RR; ask the users", "EN 50170-2 p119"),
        Row(_S.USE_TOKEN, _I.SENT, "hold.sent",
            (_S.AWAIT_DATA_RESPONSE, _S.AWAIT_STATUS_RESPONSE, _S.CHECK_ACCESS_TIME),
            "wait for the answer; after an SDN go on with T_ID2", "EN 50170-2 p119"),
        Row(_S.USE_TOKEN, _I.RESPONSE, "exchange.late", (_S.USE_TOKEN,), "a late answer: count it", "rule"),
        Row(_S.USE_TOKEN, _I.TIMEOUT, "hold.resume", (_S.CHECK_ACCESS_TIME,),
            "the fixed cycle for which the token was kept is due", "rule"),
        Row(_S.USE_TOKEN, _I.GO_OFFLINE, "hold.leave_now", (_S.PASS_TOKEN, _S.OFFLINE),
            "abandon what was not started, pass the token on", "rule"),
        # --- Await_Data_Response ---
        Row(_S.AWAIT_DATA_RESPONSE, _I.RESPONSE, "exchange.response", (_S.AWAIT_DATA_RESPONSE, _S.CHECK_ACCESS_TIME),
            "it answers the request: done; it does not: count it, keep waiting", "EN 50170-2 p119, p131"),
        Row(_S.AWAIT_DATA_RESPONSE, _I.TIMEOUT, "exchange.timeout", (_S.AWAIT_DATA_RESPONSE, _S.CHECK_ACCESS_TIME),
            "T_SL over: repeat with unchanged FCB, or give up", "EN 50170-2 p119, p131"),
        Row(_S.AWAIT_DATA_RESPONSE, _I.SENT, "exchange.repeated", (_S.AWAIT_DATA_RESPONSE,),
            "wait for the answer to the repetition", "EN 50170-2 p131"),
        # --- Check_Access_Time: never rests, what comes next is decided at once ---
        Row(_S.CHECK_ACCESS_TIME, _I.CHECK, "hold.check", (_S.USE_TOKEN, _S.PASS_TOKEN, _S.OFFLINE),
            "high priority once even when late, low while time is left, then the GAP, then the token; kept for a fixed "
            "cycle that is due at once", "EN 50170-2 p102, p119; rule"),
        # --- Pass_Token, Check_Token_Pass ---
        Row(_S.PASS_TOKEN, _I.SENT, "passing.sent", (_S.CHECK_TOKEN_PASS, _S.USE_TOKEN, _S.OFFLINE),
            "watch NS; a lone master holds the token again", "Felser, state machine; lone master"),
        Row(_S.PASS_TOKEN, _I.RESPONSE, "exchange.late", (_S.PASS_TOKEN,), "a late answer: count it", "rule"),
        Row(_S.CHECK_TOKEN_PASS, _I.TIMEOUT, "passing.timeout", (_S.PASS_TOKEN, _S.ACTIVE_IDLE, _S.OFFLINE),
            "silent: repeat twice, then drop NS; noise only: believe that NS has it", _FELSER),
        Row(_S.CHECK_TOKEN_PASS, _I.ACTIVITY, "passing.activity", (_S.CHECK_TOKEN_PASS,),
            "watch for a telegram for another T_SL", _FELSER),
        Row(_S.CHECK_TOKEN_PASS, _I.RESPONSE, "passing.response", (_S.CHECK_TOKEN_PASS, _S.ACTIVE_IDLE, _S.OFFLINE),
            "SC: somebody is active; a response to TS is a late one and proves nothing", "rule"),
        # --- Await_Status_Response ---
        Row(_S.AWAIT_STATUS_RESPONSE, _I.RESPONSE, "hold.status", (_S.AWAIT_STATUS_RESPONSE, _S.PASS_TOKEN, _S.OFFLINE),
            "'ready' becomes NS; note slaves; pass the token", "EN 50170-2 p102"),
        Row(_S.AWAIT_STATUS_RESPONSE, _I.TIMEOUT, "hold.status_timeout", (_S.PASS_TOKEN, _S.OFFLINE),
            "nobody there: pass the token", "EN 50170-2 p102"),
    ]  # fmt: skip
    idle, watching = (_S.LISTEN_TOKEN, _S.ACTIVE_IDLE), _S.CHECK_TOKEN_PASS
    others = (_I.TOKEN_TO_ME, _I.TOKEN_SEEN, *_REQUESTS)
    rows.append(Row(_S.LISTEN_TOKEN, _I.REQUEST_TO_ME, "idle.heard", (_S.LISTEN_TOKEN,), "stay silent", _FELSER))
    rows.append(Row(_S.LISTEN_TOKEN, _I.REQUEST_SEEN, "idle.request_listening", (_S.LISTEN_TOKEN,),
                    "note who sent it, drop an answer not yet sent", "rule"))  # fmt: skip
    for what, name, targets, does, source, states in (
        (_I.LINE_DOWN, "idle.line_down", (_S.OFFLINE,), "the port is gone: abandon everything", "rule", _ONLINE),
        (_I.OWN_ADDRESS, "idle.own_address", (None, _S.LISTEN_TOKEN, _S.OFFLINE),
         "somebody has this address: stay out, back off, listen again", _FELSER, _ONLINE),
        (_I.REQUEST_SEEN, "idle.heard", (None,), "drop an answer not yet sent", "rule", (_S.ACTIVE_IDLE,)),
        (_I.RESPONSE_SEEN, "idle.heard", (None,), "drop an answer not yet sent", "rule", idle),
        (_I.ACTIVITY, "idle.heard", (None,), "drop an answer not yet sent", "rule", idle),
        (_I.SENT, "idle.answered", (None,), "the status was answered", _FELSER, idle),
        (_I.RESPONSE, "idle.late", (None,), "a late answer, or SC: count it", "rule", idle),
        (_I.GO_OFFLINE, "idle.go_offline", (_S.OFFLINE,), "leave; the ring drops TS", _FELSER,
         (*idle, _S.CLAIM_TOKEN)),
        (_I.RESPONSE_SEEN, "hold.stray", (None,), "count it", "rule", _HOLDING),
        (_I.ACTIVITY, "hold.noise", (None,), "note it", "rule", _HOLDING),
        (_I.GO_OFFLINE, "hold.leave", (None,), "end this, pass the token, then Offline", "rule",
         (*_HOLDING[1:], watching)),
        (_I.TOKEN_TO_ME, "hold.withdraw", (_S.USE_TOKEN, _S.ACTIVE_IDLE, _S.OFFLINE),
         "repeated by PS before we started: still ours; else withdraw", f"{_FELSER}; EN 50170-2 p119", (_S.USE_TOKEN,)),
        (_I.TOKEN_TO_ME, "hold.withdraw", (_S.ACTIVE_IDLE, _S.OFFLINE), "somebody else held the token: withdraw",
         f"{_FELSER}; EN 50170-2 p119", _HOLDING[1:]),
        *((what, "hold.withdraw", (_S.ACTIVE_IDLE, _S.OFFLINE), "somebody else holds the token: withdraw",
           f"{_FELSER}; EN 50170-2 p119", _HOLDING) for what in others[1:]),
        *((what, "passing.confirmed", (_S.ACTIVE_IDLE, _S.OFFLINE), "NS has the token", _FELSER, (watching,))
          for what in (*others, _I.RESPONSE_SEEN)),
        *((what, "idle.claim_broken", (_S.ACTIVE_IDLE, _S.LISTEN_TOKEN), "the line lives: no claim", "rule",
           (_S.CLAIM_TOKEN,))
          for what in (*others, _I.RESPONSE_SEEN, _I.RESPONSE, _I.ACTIVITY)),
    ):  # fmt: skip
        rows += [Row(s, what, name, tuple(s if t is None else t for t in targets), does, source) for s in states]
    return sorted(rows, key=lambda r: (r.state, r.input))


TABLE: Final[tuple[Row, ...]] = tuple(_rows())

H = TypeVar("H", bound=Callable[..., None])


def handlers_by_state(modules: Mapping[str, object], default: H) -> tuple[tuple[H, ...], ...]:
    """``result[state][input]`` is the handler; pairs without a row get ``default``. ``modules`` by their short name."""
    result = [[default] * len(Input) for _ in State]
    for row in TABLE:
        module, name = row.handler.split(".")
        result[row.state][row.input] = getattr(modules[module], name)
    return tuple(map(tuple, result))
