"""The states of one class 2 connection at the slave as a table: what is heard, what is done, with the source per row.

Sources: protocol facts C2, C3, J; "VPC3+": what profichip's class 2 server does, as its public sources show it;
"ProSoft": the reasons of Abort in the MVI69-PDPMV1 manual, p123; "Felser": profibus.felser.ch, MS2.

Decisions where they are silent:

- Every request is acknowledged with SC and answered when polled, as slave chips do (a slave can be told to answer in
  the request itself); a poll before that gets SC, from half the send time-out on Idle: the master hears that it lives.
- An answer is given once; what is lost on the way the link layer asks for again. A poll after that gets SC: were it
  the last answer, it could be taken for that to a request which never arrived.
- A request while another one is under way, or before its answer was fetched, ends the connection (sequence error).
- Idle while a service is under way is acknowledged only: it asks for nothing.
- Whatever the master sends to its server SAP, polls included, says that it lives.
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
    """What happened to it."""

    POLL = "a poll"
    SERVICE = "Read, Write or Data_Transport"
    IDLE = "Idle"
    ABORT = "Abort"
    OUT_OF_PLACE = "a service that has no place here"
    UNREADABLE = "what cannot be read"
    SILENCE = "nothing heard in time"


class Act(Enum):
    """What it does."""

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

TABLE: Final[dict[tuple[State, Ev], Row]] = {
    (_O, Ev.POLL): Row(Act.ACKNOWLEDGE, "VPC3+: nothing is there any more"),
    (_O, Ev.SERVICE): Row(Act.SERVE, "C3"),
    (_O, Ev.IDLE): Row(Act.ANSWER_IDLE, "C3; VPC3+"),
    (_O, Ev.ABORT): Row(Act.FREE, "C3; VPC3+"),
    (_O, Ev.OUT_OF_PLACE): Row(Act.SEQUENCE, "ProSoft: a service that is not allowed in this state"),
    (_O, Ev.UNREADABLE): Row(Act.REQUEST_PDU, "VPC3+; ProSoft: an invalid request PDU"),
    (_O, Ev.SILENCE): Row(Act.TIMEOUT, "VPC3+: after twice the send time-out"),
    (_W, Ev.POLL): Row(Act.LOOK, "C3"),
    (_W, Ev.SERVICE): Row(Act.SEQUENCE, "ProSoft: a service that is not allowed in this state"),
    (_W, Ev.IDLE): Row(Act.ACKNOWLEDGE, "decision; VPC3+ ignores it"),
    (_W, Ev.ABORT): Row(Act.FREE, "VPC3+: in every state"),
    (_W, Ev.OUT_OF_PLACE): Row(Act.SEQUENCE, "ProSoft"),
    (_W, Ev.UNREADABLE): Row(Act.REQUEST_PDU, "ProSoft"),
    (_W, Ev.SILENCE): Row(Act.TIMEOUT, "VPC3+: after the send time-out"),
    (_A, Ev.POLL): Row(Act.GIVE, "C3"),
    (_A, Ev.SERVICE): Row(Act.SEQUENCE, "ProSoft: a service that is not allowed in this state"),
    (_A, Ev.IDLE): Row(Act.ACKNOWLEDGE, "decision; VPC3+ ignores it"),
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
