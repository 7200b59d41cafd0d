"""What a class 2 master asks a slave, and what the answers mean; queue and token are :mod:`dpstack.dp.acyclic.queue`.

What a job is, is said in :mod:`dpstack.dp.acyclic.job`. Services (docs/protocol.md#services-by-state): Slave_Diag and
Get_Cfg are open in every state, RD_Inp and RD_Outp in data exchange, all of them to every master; none of these changes
anything in the slave.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from dpstack.dp.acyclic.job import ATTEMPTS, Job, Outcome, ServiceEnd, ServiceFailure, Step, Steps, pause_after_silence
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN, Diagnosis
from dpstack.dp.services import EMPTY_STATUS, SERVICE_NAMES, positive, refusal_text
from dpstack.fdl.interface import LONG_NS, Failure, Request
from dpstack.fdl.telegram import (
    SAP_GET_CFG,
    SAP_RD_INP,
    SAP_RD_OUTP,
    SAP_SET_SLAVE_ADD,
    SAP_SLAVE_DIAG,
    SSAP_MS0,
    Kind,
    Req,
    Resp,
    Telegram,
)
from dpstack.trace import Event

#: "later": asked again; everything else that is negative is an answer
_BUSY: Final = frozenset((int(Resp.UE), int(Resp.RR)))
_NO_DATA: Final = EMPTY_STATUS | {int(Resp.NR)}
#: so often a slave that does not answer a service is asked for its diagnosis
_LOOKS: Final = 2


class Service(IntEnum):
    """The services of a class 2 master at a slave; the values are the SAPs."""

    SET_ADDRESS = SAP_SET_SLAVE_ADD
    INPUTS = SAP_RD_INP
    OUTPUTS = SAP_RD_OUTP
    CONFIG = SAP_GET_CFG
    DIAGNOSIS = SAP_SLAVE_DIAG

    @property
    def title(self) -> str:
        """The standard's name."""
        return SERVICE_NAMES[self]


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceDone(ServiceEnd):
    """The one end of the service with ``token``."""

    service: Service

    @property
    def title(self) -> str:
        """The service's."""
        return self.service.title

    @property
    def result(self) -> str:
        return f"{self.title}, {len(self.outcome.data)} octets"


def done(job: Job, service: Service, token: int, outcome: Outcome, now: int) -> list[Event]:
    """What is told of the end of a class 2 master's ``job``."""
    return [ServiceDone(t_ns=now, token=token, address=job.address, service=service, outcome=outcome)]


class Reading(Job):
    """One of the reading services. ``expected``: the octets that RD_Inp and RD_Outp must have, None for any number."""

    def __init__(self, address: int, service: Service, expected: int | None = None) -> None:
        self.address = address
        self.title = service.title
        self.service = service
        self.expected = expected

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        return done(self, self.service, token, outcome, now)

    def steps(self) -> Steps[Outcome]:
        """One request, repeated where there is hope."""
        answer = yield from asked(request(self.address, self.service))
        if answer is Failure.NO_ANSWER and (yield from leaves_out(self.address, self.service)):
            return left_out(self.address, self.title, _CLOSED[self.service])
        return judged(self.address, self.service, answer, self.expected)


def leaves_out(address: int, service: int) -> Steps[bool]:
    """Whether the slave that did not answer at the SAP ``service`` is there all the same: it answers Slave_Diag.

    Some slaves leave a service that they do not have without any answer (docs/protocol.md#silent-service).
    """
    if service == Service.DIAGNOSIS:
        return False
    answer = yield from asked(request(address, Service.DIAGNOSIS), _LOOKS)
    return isinstance(answer, Telegram)


def left_out(address: int, title: str, why: str) -> Outcome:
    """The result of the service ``title`` where the slave is there and does not answer it."""
    return Outcome(
        failure=ServiceFailure.REFUSED,
        text=f"slave {address} is there (it answers Slave_Diag) and leaves {title} without an answer; {why}",
        status="no answer",
    )


def request(address: int, service: Service, data: bytes = b"") -> Request:
    """``service`` to ``address``: low priority by its place in the token hold; on the wire it is SRD high like all
    services of DP, because some slaves know no other (docs/protocol.md#slaves-that-know-only-fcv-1)."""
    return Request(address, Req.SRD_HIGH, data, service, SSAP_MS0)


def asked(request: Request, attempts: int = ATTEMPTS) -> Steps[Telegram | Failure]:
    """Up to ``attempts`` times, until there is an answer other than "busy"; others have their turn meanwhile.

    The last time the answer is waited for as long as that of a station that is there, because somebody has named this
    one; but before a fixed cycle, and beside other masters, only as long as there is room.
    """
    answer: Telegram | Failure = Failure.NO_ANSWER
    pause = 0
    for attempt in range(attempts):
        if 0 < attempt == attempts - 1:
            request = request._replace(extra_ns=LONG_NS)
        answer = (yield Step(request, pause)).answer
        if answer is Failure.REFUSED:
            break
        if isinstance(answer, Telegram) and (answer.kind is Kind.SC or answer.function not in _BUSY):
            break
        pause = pause_after_silence(attempt + 1)
    return answer


def judged(address: int, service: Service, answer: Telegram | Failure, expected: int | None = None) -> Outcome:
    """The result of a service that reads."""
    if not isinstance(answer, Telegram):
        return unanswered(address, service, answer)
    reads_data = service in (Service.INPUTS, Service.OUTPUTS)
    # without inputs, or outputs, the answer is NR, OK or SC (docs/protocol.md#function-code)
    empty = answer.kind is Kind.SC or answer.function in _NO_DATA
    if not (positive(service, answer) or (reads_data and empty and not answer.data)):
        return refused(address, service, answer)
    low, high = (FIXED_LEN, MAX_LEN) if service is Service.DIAGNOSIS else (0 if reads_data else 1, MAX_LEN)
    got = len(answer.data)
    if not low <= got <= high:
        return Outcome(
            failure=ServiceFailure.LENGTH,
            text=f"slave {address} answers {service.title} with {got} octets, {low}..{high} are possible; "
            f"it is no DP slave, or two stations have its address",
        )
    if expected is not None and got != expected:
        return Outcome(
            failure=ServiceFailure.LENGTH,
            text=f"slave {address} answers {service.title} with {got} octets instead of {expected}; its real "
            f"configuration differs from the one here: compare it with what Get_Cfg says",
        )
    return Outcome(answer.data)


def unanswered(address: int, service: Service, why: Failure) -> Outcome:
    """The result where no answer can be used."""
    failure, what, todo = _UNANSWERED[why]
    return Outcome(failure=failure, text=f"slave {address} {what} {service.title}; {todo}")


_UNANSWERED: Final = {
    Failure.NO_ANSWER: (
        ServiceFailure.SILENT,
        "does not answer",
        "check address and power; `dpstack scan` shows who is there",
    ),
    Failure.GARBLED: (
        ServiceFailure.UNREADABLE,
        "gives no readable answer to",
        "look for a second station with its address, and at cable and termination",
    ),
    Failure.WRONG: (
        ServiceFailure.WRONG,
        "gives answers that are none to",
        "it answers from other service access points: it is no DP slave, or two stations have its address",
    ),
    Failure.REFUSED: (
        ServiceFailure.GUARDED,
        "was not sent",
        "this bus is read-only: leave read_only out where slaves shall be changed",
    ),
}


def refused(address: int, service: Service, answer: Telegram) -> Outcome:
    """The result where the slave says no, and why that may be."""
    if answer.kind is Kind.SC or answer.function not in _REFUSALS:
        return Outcome(
            failure=ServiceFailure.WRONG,
            text=f"slave {address} answers {service.title} with {refusal_text(answer)}, which is no answer to it; "
            f"look for a second station with its address",
        )
    status = refusal_text(answer)
    todo = "it is busy: try again later" if answer.function in _BUSY else _CLOSED[service]
    return Outcome(
        failure=ServiceFailure.REFUSED,
        text=f"slave {address} refuses {service.title} ({status}); {todo}",
        status=status,
    )


_REFUSALS: Final = frozenset((int(Resp.UE), int(Resp.RR), int(Resp.RS), int(Resp.NR), int(Resp.RDL), int(Resp.RDH)))
_READS_IN_EXCHANGE: Final = "it is open in data exchange only, and not in every device: look at its state"
_CLOSED: Final = {
    Service.DIAGNOSIS: "every DP slave has this service: the station is none, or not switched on for long enough",
    Service.CONFIG: "every DP slave has this service: the station is none, or not switched on for long enough",
    Service.INPUTS: _READS_IN_EXCHANGE,
    Service.OUTPUTS: _READS_IN_EXCHANGE,
    Service.SET_ADDRESS: "its address is set at the device itself (switches, menu), was locked by an earlier "
    "Set_Slave_Add (No_Add_Chg), or a master has just parameterised it",
}


def diagnosis_of(answer: Telegram | Failure) -> Diagnosis | None:
    """What ``answer`` to Slave_Diag says, None where it says nothing."""
    if isinstance(answer, Telegram) and positive(Service.DIAGNOSIS, answer):
        return Diagnosis.parse(answer.data)
    return None
