"""The states of one class 2 connection at the slave as a table: trigger, action and source of each row.

Facts: docs/reference/protocol.md#ms2, docs/reference/protocol.md#idle, docs/reference/protocol.md#abort; the documents
"VPC3+", "ProSoft" and "Felser": docs/reference/protocol.md#sources.

Decisions on points that they leave open: docs/reference/decisions/ms2.md#connections-at-the-slave.
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


class Ms2Trigger(Enum):
    POLL = "a poll"
    SERVICE = "Read, Write or Data_Transport"
    IDLE = "Idle"
    ABORT = "Abort"
    OUT_OF_PLACE = "a service that has no place here"
    UNREADABLE = "what cannot be read"
    SILENCE = "nothing heard in time"


class Act(Enum):
    ACKNOWLEDGE = "SC"
    ANSWER = "the answer"
    ANSWER_IF_READY = "the answer if there is one by now, else SC or Idle"
    SERVE = "hand the service to the application"
    ANSWER_IDLE = "Idle as the answer"
    FREE = "over, the connection is free"
    SEQUENCE = "Abort: sequence error"
    REQUEST_PDU = "Abort: a request that cannot be read"
    TIMEOUT = "Abort: time-out"


class Row(NamedTuple):
    """A row: what is done, and if the rule comes from."""

    act: Act
    source: str


_O, _W, _A, _V = State.OPEN, State.WORKING, State.ANSWERED, State.OVER
_MS2: Final = "docs/reference/protocol.md#ms2"
_DECIDED: Final = "docs/reference/decisions/ms2.md#connections-at-the-slave"

#: while a service is under way: the slave works at it, or its answer waits to be fetched
_UNDER_WAY: Final = {
    Ms2Trigger.SERVICE: Row(Act.SEQUENCE, "ProSoft: a service that is not allowed in this state"),
    Ms2Trigger.IDLE: Row(Act.ACKNOWLEDGE, f"{_DECIDED}; VPC3+ ignores it"),
    Ms2Trigger.ABORT: Row(Act.FREE, "VPC3+: in every state"),
    Ms2Trigger.OUT_OF_PLACE: Row(Act.SEQUENCE, "ProSoft"),
    Ms2Trigger.UNREADABLE: Row(Act.REQUEST_PDU, "ProSoft"),
    Ms2Trigger.SILENCE: Row(Act.TIMEOUT, "VPC3+: after the send time-out"),
}
TABLE: Final[dict[tuple[State, Ms2Trigger], Row]] = {
    (_O, Ms2Trigger.POLL): Row(Act.ACKNOWLEDGE, "VPC3+: nothing is there any more"),
    (_O, Ms2Trigger.SERVICE): Row(Act.SERVE, _MS2),
    (_O, Ms2Trigger.IDLE): Row(Act.ANSWER_IDLE, "docs/reference/protocol.md#idle; VPC3+"),
    (_O, Ms2Trigger.ABORT): Row(Act.FREE, "docs/reference/protocol.md#abort; VPC3+"),
    (_O, Ms2Trigger.OUT_OF_PLACE): Row(Act.SEQUENCE, "ProSoft: a service that is not allowed in this state"),
    (_O, Ms2Trigger.UNREADABLE): Row(Act.REQUEST_PDU, "VPC3+; ProSoft: an invalid request PDU"),
    (_O, Ms2Trigger.SILENCE): Row(Act.TIMEOUT, "VPC3+: after twice the send time-out"),
    (_W, Ms2Trigger.POLL): Row(Act.ANSWER_IF_READY, _MS2),
    **{(_W, trigger): row for trigger, row in _UNDER_WAY.items()},
    (_A, Ms2Trigger.POLL): Row(Act.ANSWER, _MS2),
    **{(_A, trigger): row for trigger, row in _UNDER_WAY.items()},
    (_V, Ms2Trigger.POLL): Row(Act.FREE, "VPC3+: the SAP is closed once the Abort was fetched"),
    (_V, Ms2Trigger.SERVICE): Row(Act.ACKNOWLEDGE, "VPC3+: only the Abort is left"),
    (_V, Ms2Trigger.IDLE): Row(Act.ACKNOWLEDGE, "VPC3+"),
    (_V, Ms2Trigger.ABORT): Row(Act.FREE, "VPC3+"),
    (_V, Ms2Trigger.OUT_OF_PLACE): Row(Act.ACKNOWLEDGE, "VPC3+"),
    (_V, Ms2Trigger.UNREADABLE): Row(Act.ACKNOWLEDGE, "VPC3+"),
    (_V, Ms2Trigger.SILENCE): Row(Act.FREE, "VPC3+: nobody fetched the Abort for another send time-out"),
}
