"""Record of the last bring-ups of one slave: each request besides the cycle with its answer, and the losses.

The master writes it only if a service is asked, and for the first and the last Data_Exchange: an exchange in between
costs nothing. It is bounded: :data:`MOST_BRING_UPS` bring-ups of :data:`MOST_STEPS` steps, :data:`MOST_LOSSES` losses.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from msgspec import Struct, field
from msgspec.structs import replace

from dpstack.dp.master.events import SlaveState
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.services import SERVICE_NAMES
from dpstack.fdl.interface import Failure
from dpstack.fdl.telegram import SAP_SLAVE_DIAG, Kind, Resp, Telegram

MOST_BRING_UPS: Final = 2
MOST_STEPS: Final = 20
MOST_LOSSES: Final = 8
#: the first steps of a bring-up, which are kept if it has more than :data:`MOST_STEPS`
_FIRST_STEPS: Final = 12
_MOST_IDENTS: Final = 4
DATA_EXCHANGE: Final = "Data_Exchange"
SLAVE_DIAG: Final = SERVICE_NAMES[SAP_SLAVE_DIAG]
#: how a request ended without an answer that can be used
NOTHING: Final = "nothing"
DAMAGED: Final = "damaged"
WRONG: Final = "wrong"
_FAILURES: Final = {Failure.NO_ANSWER: NOTHING, Failure.GARBLED: DAMAGED, Failure.WRONG: WRONG}
_ASKING: Final = (SlaveState.OFFLINE, SlaveState.DIAGNOSIS, SlaveState.FAULT)


class Step(Struct, frozen=True):
    """One request and its answer; ``times``: so often in a row, the last time at ``last_ns``.

    ``answered``: SC, or the status of the answer (DL, DH, RS ...), or "nothing", "damaged" (octets, no telegram),
    "wrong" (a telegram that answers something else).
    """

    t_ns: int
    asked: str
    sent: bytes
    answered: str
    received: bytes = b""
    times: int = 1
    last_ns: int = 0

    @property
    def diagnosis(self) -> Diagnosis | None:
        """The diagnosis that it received; None for other steps."""
        return Diagnosis.parse(self.received) if self.asked == SLAVE_DIAG and self.received else None


class BringUp(Struct, frozen=True):
    """Steps of one bring-up, and of the data exchange after it. ``left_out``: steps between the first and the last ones
    that were not kept. ``exchanging_ns``: time of the first good Data_Exchange, 0 without one."""

    steps: tuple[Step, ...]
    left_out: int = 0
    exchanging_ns: int = 0


class Loss(Struct, frozen=True):
    """The slave left data exchange at ``t_ns`` after ``stayed_ns``. ``how``: the answer that ended it, as in
    :class:`Step`, or "diagnosis".

    ``back_ns``: time of its next diagnosis, 0: none yet. ``prm_req``: that diagnosis wanted parameters. ``free``: it
    named no master.
    """

    t_ns: int
    stayed_ns: int
    how: str
    back_ns: int = 0
    prm_req: bool = False
    free: bool = False


class History(Struct, frozen=True):
    """The bring-ups of one slave, oldest first, and its last losses. ``lost``: number of losses since the start;
    ``brought_up``: times it reached data exchange. ``idents``: the ident numbers in its diagnoses, at most four.
    """

    bring_ups: tuple[BringUp, ...] = ()
    losses: tuple[Loss, ...] = ()
    lost: int = 0
    brought_up: int = 0
    idents: tuple[int, ...] = ()


class _Open(Struct):
    """A bring-up under way. ``advanced``: more than Slave_Diag was asked."""

    steps: list[Step] = field(default_factory=list)
    left_out: int = 0
    exchanging_ns: int = 0
    advanced: bool = False

    def add(self, step: Step) -> None:
        steps = self.steps
        if steps:
            last = steps[-1]
            same = (last.asked, last.sent, last.answered, last.received)
            if same == (step.asked, step.sent, step.answered, step.received):
                steps[-1] = replace(last, times=last.times + 1, last_ns=step.t_ns)
                return
        steps.append(step)
        if len(steps) > MOST_STEPS:
            del steps[_FIRST_STEPS]
            self.left_out += 1


class BringUps:
    """Collects the :class:`History` of one slave. ``first_due``: the next good Data_Exchange is the first one."""

    def __init__(self) -> None:
        self.first_due = False
        self._open: deque[_Open] = deque(maxlen=MOST_BRING_UPS)
        self._losses: deque[Loss] = deque(maxlen=MOST_LOSSES)
        self._lost = 0
        self._brought_up = 0
        self._idents: tuple[int, ...] = ()

    def answered(self, state: SlaveState, service: str, sent: bytes, outcome: Telegram | Failure, now: int) -> None:
        """A request ended; ``state``: of the slave's handling when it was asked."""
        step = Step(now, service, sent, *_answer(outcome), last_ns=now)
        diagnosis = step.diagnosis
        last = self._open[-1] if self._open else None
        if last is None or (last.advanced and state in _ASKING and service == SLAVE_DIAG):
            last = _Open()
            self._open.append(last)
        last.advanced = last.advanced or service != SLAVE_DIAG
        last.add(step)
        if diagnosis is not None:
            self._diagnosed(diagnosis, now)

    def _diagnosed(self, diagnosis: Diagnosis, now: int) -> None:
        if diagnosis.ident not in self._idents and len(self._idents) < _MOST_IDENTS:
            self._idents += (diagnosis.ident,)
        if self._losses and not self._losses[-1].back_ns:
            free = diagnosis.master is None
            self._losses[-1] = replace(self._losses[-1], back_ns=now, prm_req=diagnosis.prm_req, free=free)

    def entered_exchange(self) -> None:
        self.first_due = True
        self._brought_up += 1

    def first_exchange(self, sent: bytes, answer: Telegram, now: int) -> None:
        """The first good Data_Exchange of a bring-up."""
        self.first_due = False
        self.answered(SlaveState.DATA_EXCHANGE, DATA_EXCHANGE, sent, answer, now)
        self._open[-1].exchanging_ns = now

    def left_exchange(self, now: int, stayed_ns: int) -> None:
        """The slave left data exchange."""
        self.first_due = False
        self._lost += 1
        steps = self._open[-1].steps if self._open else []
        by_data = steps and steps[-1].asked == DATA_EXCHANGE and steps[-1].last_ns == now
        self._losses.append(Loss(now, stayed_ns, steps[-1].answered if by_data else "diagnosis"))

    def history(self) -> History:
        """A copy of what was recorded."""
        ups = tuple(BringUp(tuple(one.steps), one.left_out, one.exchanging_ns) for one in self._open)
        return History(ups, tuple(self._losses), self._lost, self._brought_up, self._idents)


def _answer(outcome: Telegram | Failure) -> tuple[str, bytes]:
    if not isinstance(outcome, Telegram):
        return _FAILURES.get(outcome, outcome.value), b""
    if outcome.kind is Kind.SC:
        return "SC", b""
    status = outcome.fc & 0x0F
    return Resp(status).name if status in Resp._value2member_map_ else f"status {status}", outcome.data
