"""The states of one class 2 connection at the slave as a table: what is heard, what is done, with the source per row.

Facts: docs/protocol.md#ms2, docs/protocol.md#idle, docs/protocol.md#abort; the documents "VPC3+", "ProSoft" and
"Felser": docs/protocol.md#sources.

Decisions where they leave something open: docs/decisions/ms2.md#connections-at-the-slave.
"""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple


class State(Enum):
    """States of a connection."""

    OPEN = "open"  # nothing asked, or the answer was fetched
    WORKING = "working"  # a service is being worked at
    ANSWERED = "answered"  # an answer waits to be fetched
    OVER = "over"  # an Abort waits to be fetched, the services are over


class Ev(Enum):
    POLL = "a poll"
    SERVICE = "Read, Write or Data_Transport"
    IDLE = "Idle"
    ABORT = "Abort"
    OUT_OF_PLACE = "a service that has no place here"
    UNREADABLE = "what cannot be read"
    SILENCE = "nothing heard in time"


class Act(Enum):
    ACKNOWLEDGE = "SC"
    GIVE = "the answer"
    LOOK = "the answer if there is one by now, else SC or Idle"
    SERVE = "hand the service to the application"
    ANSWER_IDLE = "Idle as the answer"
    FREE = "over, the connection is free"
    SEQUENCE = "Abort: sequence error"
    REQUEST_PDU = "Abort: a request that cannot be read"
    TIMEOUT = "Abort: time-out"


class Row(NamedTuple):
    """A row: what is done, and where the rule comes from."""

    act: Act
    source: str


_O, _W, _A, _V = State.OPEN, State.WORKING, State.ANSWERED, State.OVER
_MS2: Final = "docs/protocol.md#ms2"
_DECIDED: Final = "docs/decisions/ms2.md#connections-at-the-slave"

TABLE: Final[dict[tuple[State, Ev], Row]] = {
    (_O, Ev.POLL): Row(Act.ACKNOWLEDGE, "VPC3+: nothing is there any more"),
    (_O, Ev.SERVICE): Row(Act.SERVE, _MS2),
    (_O, Ev.IDLE): Row(Act.ANSWER_IDLE, "docs/protocol.md#idle; VPC3+"),
    (_O, Ev.ABORT): Row(Act.FREE, "docs/protocol.md#abort; VPC3+"),
    (_O, Ev.OUT_OF_PLACE): Row(Act.SEQUENCE, "ProSoft: a service that is not allowed in this state"),
    (_O, Ev.UNREADABLE): Row(Act.REQUEST_PDU, "VPC3+; ProSoft: an invalid request PDU"),
    (_O, Ev.SILENCE): Row(Act.TIMEOUT, "VPC3+: after twice the send time-out"),
    (_W, Ev.POLL): Row(Act.LOOK, _MS2),
    (_W, Ev.SERVICE): Row(Act.SEQUENCE, "ProSoft: a service that is not allowed in this state"),
    (_W, Ev.IDLE): Row(Act.ACKNOWLEDGE, f"{_DECIDED}; VPC3+ ignores it"),
    (_W, Ev.ABORT): Row(Act.FREE, "VPC3+: in every state"),
    (_W, Ev.OUT_OF_PLACE): Row(Act.SEQUENCE, "ProSoft"),
    (_W, Ev.UNREADABLE): Row(Act.REQUEST_PDU, "ProSoft"),
    (_W, Ev.SILENCE): Row(Act.TIMEOUT, "VPC3+: after the send time-out"),
    (_A, Ev.POLL): Row(Act.GIVE, _MS2),
    (_A, Ev.SERVICE): Row(Act.SEQUENCE, "ProSoft: a service that is not allowed in this state"),
    (_A, Ev.IDLE): Row(Act.ACKNOWLEDGE, f"{_DECIDED}; VPC3+ ignores it"),
    (_A, Ev.ABORT): Row(Act.FREE, "VPC3+: in every state"),
    (_A, Ev.OUT_OF_PLACE): Row(Act.SEQUENCE, "ProSoft"),
    (_A, Ev.UNREADABLE): Row(Act.REQUEST_PDU, "ProSoft"),
    (_A, Ev.SILENCE): Row(Act.TIMEOUT, "VPC3+: after the send time-out"),
    (_V, Ev.POLL): Row(Act.FREE, "VPC3+: the SAP is closed once the Abort was fetched"),
    (_V, Ev.SERVICE): Row(Act.ACKNOWLEDGE, "VPC3+: only the Abort is left"),
    (_V, Ev.IDLE): Row(Act.ACKNOWLEDGE, "VPC3+"),
    (_V, Ev.ABORT): Row(Act.FREE, "VPC3+"),
    (_V, Ev.OUT_OF_PLACE): Row(Act.ACKNOWLEDGE, "VPC3+"),
    (_V, Ev.UNREADABLE): Row(Act.ACKNOWLEDGE, "VPC3+"),
    (_V, Ev.SILENCE): Row(Act.FREE, "VPC3+: nobody fetched the Abort for another send time-out"),
}
