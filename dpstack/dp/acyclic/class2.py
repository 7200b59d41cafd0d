"""A class 2 master, beside any class 1 master: Slave_Diag, Get_Cfg, RD_Inp, RD_Outp, Set_Slave_Add.

The orders, the jobs that carry them out, and the judgement of the answers; queue and token are in
:mod:`dpstack.dp.acyclic.queue`. Services (docs/reference/protocol.md#services-by-state): Slave_Diag and Get_Cfg are
open in every state, RD_Inp and RD_Outp in data exchange, all of them to every master; none of these changes anything in
the slave.

Giving a slave another address (docs/reference/protocol.md#set_slave_add): its acknowledgement proves nothing. Some
slaves act at once, some acknowledge and ignore the service (docs/reference/protocol.md#set-slave-add-ignored), some
take the address at the next power-up. So: Slave_Diag first (the right device, nobody's slave), FDL status of the new
address (nobody there), the service, then Slave_Diag at the new address and silence at the old one.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from dpstack.dp.acyclic.job import ATTEMPTS, Job, Outcome, ServiceEnd, ServiceFailure, Step, Steps, pause_after_silence
from dpstack.dp.acyclic.queue import Provider
from dpstack.dp.master.fault_texts import left_locked
from dpstack.dp.master.master import Master
from dpstack.dp.master.verdicts import foreign_owner
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN, Diagnosis
from dpstack.dp.pdu.requests import SetSlaveAdd
from dpstack.dp.services import EMPTY_STATUS, SERVICE_NAMES, positive, refusal_text
from dpstack.errors import PduError, UsageError
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
    StationType,
    Telegram,
)
from dpstack.machine import Order
from dpstack.params import MAX_STATION, UNADDRESSED
from dpstack.text import octets_text
from dpstack.trace import Event, Notice
from dpstack.units import NS_PER_MS, NS_PER_S

#: "later": asked again; everything else that is negative is an answer
_BUSY: Final = frozenset((int(Resp.UE), int(Resp.RR)))
_NO_DATA: Final = EMPTY_STATUS | {int(Resp.NR)}
#: attempts of Slave_Diag at a slave that does not answer a service
_DIAGNOSIS_ATTEMPTS: Final = 2
_CHANGE_ATTEMPTS: Final = 3
#: a slave may restart with its new address: Slave_Diag to that address every 100 ms, up to 5 s
_VERIFY_PAUSE: Final = 100 * NS_PER_MS
_VERIFY_ATTEMPTS: Final = 50
#: after these attempts, and after each fifth further one, FDL status to the old address: the slave may have ignored the
#: service
_OLD_ADDRESS_AFTER: Final = 10
_OLD_ADDRESS_EVERY: Final = 5
READ_TIMEOUT: Final = 5 * NS_PER_S
#: a slave that restarts with its new address takes seconds
CHANGE_TIMEOUT: Final = 15 * NS_PER_S


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


#: octets of the shortest answer, by service; 0 for the others
_LEAST: Final = {Service.DIAGNOSIS: FIXED_LEN, Service.CONFIG: 1}


class ServiceDone(ServiceEnd):
    """The one end of the service with ``token``."""

    service: Service

    @property
    def title(self) -> str:
        return self.service.title

    @property
    def result(self) -> str:
        return f"{self.title}, {octets_text(len(self.outcome.data))}"


class ReadService(Order):
    """Send the reading ``service`` to ``address`` (0..126); the result is the :class:`ServiceDone` with ``token``.

    ``expected``: the octets that RD_Inp and RD_Outp must have, None for any number.
    """

    token: int
    address: int
    service: Service
    expected: int | None = None
    timeout_ns: int = READ_TIMEOUT


class ChangeAddress(Order):
    """Give the slave at ``old`` (0..126) the address ``new`` (0..125).

    ``ident`` None: whatever device is there; the rest as in :class:`~dpstack.dp.pdu.requests.SetSlaveAdd`.
    """

    token: int
    old: int
    new: int
    ident: int | None = None
    no_add_chg: bool = False
    rem_slave_data: bytes = b""
    timeout_ns: int = CHANGE_TIMEOUT


class Class2Job(Job):
    """A service of a class 2 master."""

    def __init__(self, address: int, service: Service) -> None:
        self.address = address
        self.service = service
        self.title = service.title

    def failed(self, failure: ServiceFailure, text: str, status: str = "") -> Outcome:
        """The outcome of a failed service; ``text`` begins with the verb, its subject is the slave."""
        return Outcome(failure, f"slave {self.address} {text}", status)

    def read(self, service: Service, answer: Telegram | Failure, expected: int | None = None) -> Outcome:
        """The outcome of a reading ``service``; ``expected``: octets that the answer must have, None for any number."""
        if not isinstance(answer, Telegram):
            return self.unanswered(service, answer)
        reads_data = service in (Service.INPUTS, Service.OUTPUTS)
        # without inputs, or outputs, the answer is NR, OK or SC (docs/reference/protocol.md#function-code)
        empty = answer.kind is Kind.SC or answer.function in _NO_DATA
        if not (positive(service, answer) or (reads_data and empty and not answer.data)):
            return self.refused(service, answer)
        low, got = _LEAST.get(service, 0), len(answer.data)
        answers = f"answers {service.title} with {octets_text(got)}"
        if not low <= got <= MAX_LEN:
            return self.failed(
                ServiceFailure.LENGTH,
                f"{answers}, {low}..{MAX_LEN} are possible; it is no DP slave, or two stations have its address",
            )
        if expected is not None and got != expected:
            return self.failed(
                ServiceFailure.LENGTH,
                f"{answers} instead of {expected}; its real configuration differs from the one here: compare it with "
                f"what Get_Cfg says",
            )
        return Outcome(data=answer.data)

    def unanswered(self, service: Service, why: Failure) -> Outcome:
        """The outcome of ``service`` without an answer that can be used."""
        failure, what, todo = _UNANSWERED[why]
        return self.failed(failure, f"{what} {service.title}; {todo}")

    def refused(self, service: Service, answer: Telegram) -> Outcome:
        """The outcome of ``service`` after a negative ``answer``."""
        status = refusal_text(answer)
        if answer.kind is Kind.SC or answer.function not in _REFUSALS:
            return self.failed(
                ServiceFailure.WRONG,
                f"answers {service.title} with {status}, which is no answer to it; look for a second station with its "
                f"address",
            )
        todo = "it is busy: try again later" if answer.function in _BUSY else _CLOSED[service]
        return self.failed(ServiceFailure.REFUSED, f"refuses {service.title} ({status}); {todo}", status)

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        return [ServiceDone(t_ns=now, token=token, address=self.address, service=self.service, outcome=outcome)]


class Class2Reading(Class2Job):
    """The job of a :class:`ReadService`."""

    def __init__(self, order: ReadService) -> None:
        super().__init__(order.address, order.service)
        self._expected = order.expected

    def steps(self) -> Steps[Outcome]:
        """The request with its repetitions. If the slave does not answer, Slave_Diag shows whether it is there."""
        answer = yield from ask(self.address, self.service)
        if answer is Failure.NO_ANSWER and (yield from answers_slave_diag(self.address, self.service)):
            return service_unanswered(self.address, self.title, _CLOSED[self.service])
        return self.read(self.service, answer, self._expected)


class AddressChange(Class2Job):
    """The job of a :class:`ChangeAddress`; ``own``: the asking station."""

    aftermath = ""

    def __init__(self, own: int, order: ChangeAddress) -> None:
        super().__init__(order.old, Service.SET_ADDRESS)
        self._own = own
        self._order = order

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """Also a notice of the new address."""
        events = super().ends(token, outcome, now)
        if outcome.failure is None:
            for_good = " for good" if self._order.no_add_chg else ""
            message = f"slave {self.address} has address {self._order.new} now{for_good}"
            events.append(Notice(t_ns=now, source="class 2", message=message))
        return events

    def steps(self) -> Steps[Outcome]:
        """Look, change, verify. ``data`` of a good end is the diagnosis read at the new address."""
        answer = yield from ask(self.address, Service.DIAGNOSIS)
        before = self.read(Service.DIAGNOSIS, answer)
        diagnosis = diagnosis_of(answer)
        if before.failure is not None or diagnosis is None:
            return before
        wrong = yield from self._forbidden(diagnosis)
        if wrong is not None:
            return wrong
        new, ident = self._order.new, diagnosis.ident
        if (yield from _fdl_status(new)) is not Failure.NO_ANSWER:
            return Outcome(
                ServiceFailure.TAKEN,
                f"address {new} is in use: a station answers there; nothing was changed: "
                f"take a free address (`dpstack scan` shows them)",
            )
        pdu = SetSlaveAdd(new, ident, self._order.no_add_chg, self._order.rem_slave_data)
        self.aftermath = (
            f"Set_Slave_Add may have been sent to slave {self.address}: look for it at {self.address} and {new}"
        )
        answer = yield from ask(self.address, self.service, pdu.build(), _CHANGE_ATTEMPTS)
        if answer is Failure.REFUSED:
            return self.unanswered(self.service, answer)
        acknowledged = isinstance(answer, Telegram)
        if isinstance(answer, Telegram) and not positive(self.service, answer):
            return self.refused(self.service, answer)
        return (yield from self._verified(ident, acknowledged))

    def _forbidden(self, diagnosis: Diagnosis) -> Steps[Outcome | None]:
        """The failure if this device must keep its address: another device, or one that a master owns."""
        wanted = self._order.ident
        if wanted is not None and wanted != diagnosis.ident:
            return self.failed(
                ServiceFailure.IDENT,
                f"is another device: ident 0x{diagnosis.ident:04X} instead of "
                f"0x{wanted:04X}; nothing was changed: give its ident, or look which device has that address",
            )
        owner = foreign_owner(diagnosis, self._own)
        if owner is None:
            return None
        answer = yield from _fdl_status(owner)
        no_master = isinstance(answer, Telegram) and answer.station_type is StationType.SLAVE
        if no_master or answer is Failure.NO_ANSWER:
            what, todo = left_locked(diagnosis, owner)
        else:  # unreadable octets may come from a master
            what = f"is owned by master {owner}"
            todo = f"stop master {owner}, or take the slave out of its configuration"
        return self.failed(ServiceFailure.OWNED, f"{what} and takes no address meanwhile; nothing was changed: {todo}")

    def _verified(self, ident: int, acknowledged: bool) -> Steps[Outcome]:
        at_new = request(self._order.new, Service.DIAGNOSIS)
        for attempt in range(_VERIFY_ATTEMPTS):
            answer = (yield Step(at_new, _VERIFY_PAUSE)).answer
            found = diagnosis_of(answer)
            if found is not None and isinstance(answer, Telegram):
                return (yield from self._arrived(ident, found.ident, answer.data))
            old_too = attempt >= _OLD_ADDRESS_AFTER and not attempt % _OLD_ADDRESS_EVERY
            if old_too and (yield from _fdl_status(self.address)) is not Failure.NO_ANSWER:
                return self._kept(acknowledged)
        return self.failed(
            ServiceFailure.GONE,
            f"answers neither there nor at {self._order.new} after Set_Slave_Add; "
            f"switch it off and on, then look with `dpstack scan`",
        )

    def _arrived(self, ident: int, found: int, data: bytes) -> Steps[Outcome]:
        if found != ident:
            return Outcome(
                ServiceFailure.IDENT,
                f"another device answers at {self._order.new} after Set_Slave_Add: ident 0x{found:04X} instead of "
                f"0x{ident:04X}; look which device has that address before anything else is changed",
            )
        if (yield from _fdl_status(self.address)) is not Failure.NO_ANSWER:
            return Outcome(
                ServiceFailure.DOUBLE,
                f"the slave has address {self._order.new} now, but a station still answers at {self.address}: "
                f"two had that address; give the other one an address of its own",
            )
        return Outcome(data=data)

    def _kept(self, acknowledged: bool) -> Outcome:
        did = "acknowledged" if acknowledged else "did not acknowledge"
        return self.failed(
            ServiceFailure.KEPT,
            f"{did} Set_Slave_Add and kept its address; its address was locked by an "
            f"earlier one (No_Add_Chg: only a reset at the device opens it), is set by switches, or changes at the "
            f"next power-up: switch it off and on, then look with `dpstack scan`",
            status="ignored",
        )


def _fdl_status(address: int) -> Steps[Telegram | Failure]:
    """The answer of ``address`` to FDL status; unreadable octets count as an answer.

    The second request waits as long as for a known station, because two stations with one address must not happen.
    """
    answer: Telegram | Failure = Failure.NO_ANSWER
    for patient in (False, True):
        answer = (yield Step(Request(address, Req.FDL_STATUS, patient=patient, retry=False))).answer
        if answer is not Failure.NO_ANSWER:
            break
    return answer


def answers_slave_diag(address: int, service: int) -> Steps[bool]:
    """Whether the slave answers Slave_Diag, after it did not answer at the SAP ``service``.

    Some slaves do not answer a service that they do not have (docs/reference/protocol.md#silent-service).
    """
    if service == Service.DIAGNOSIS:
        return False
    answer = yield from ask(address, Service.DIAGNOSIS, attempts=_DIAGNOSIS_ATTEMPTS)
    return isinstance(answer, Telegram)


def service_unanswered(address: int, title: str, why: str) -> Outcome:
    """The outcome of the service ``title`` that a present slave does not answer."""
    return Outcome(
        ServiceFailure.REFUSED,
        f"slave {address} is there (it answers Slave_Diag) and leaves {title} without an answer; {why}",
        status="no answer",
    )


def request(address: int, service: Service, data: bytes = b"") -> Request:
    """``service`` to ``address`` as SRD high, because some slaves know no other service of DP
    (docs/reference/protocol.md#slaves-that-know-only-fcv-1). The master sends it late in the token hold, like low
    priority."""
    return Request(address, Req.SRD_HIGH, data, service, SSAP_MS0)


def ask(address: int, service: Service, data: bytes = b"", attempts: int = ATTEMPTS) -> Steps[Telegram | Failure]:
    """Send ``service`` up to ``attempts`` times, until an answer other than "busy" comes. Other jobs run meanwhile.

    The last attempt waits for its answer as long as for a known station, because a program has named this address;
    before a fixed cycle, and beside other masters, only as long as there is room.
    """
    step = request(address, service, data)
    answer: Telegram | Failure = Failure.NO_ANSWER
    pause = 0
    for attempt in range(attempts):
        if 0 < attempt == attempts - 1:
            step = step.replaced(extra_ns=LONG_NS)
        answer = (yield Step(step, pause)).answer
        if answer is Failure.REFUSED:
            break
        if isinstance(answer, Telegram) and (answer.kind is Kind.SC or answer.function not in _BUSY):
            break
        pause = pause_after_silence(attempt + 1)
    return answer


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
        "gives answers that do not belong to",
        "it answers from other service access points: it is no DP slave, or two stations have its address",
    ),
    Failure.REFUSED: (
        ServiceFailure.GUARDED,
        "was not sent",
        "this bus is read-only: leave read_only out where slaves shall be changed",
    ),
}


_REFUSALS: Final = frozenset((int(Resp.UE), int(Resp.RR), int(Resp.RS), int(Resp.NR), int(Resp.RDL), int(Resp.RDH)))
_READS_IN_EXCHANGE: Final = "it is open in data exchange only, and not in every device: look at its state"
_CLOSED: Final = {
    Service.DIAGNOSIS: "every DP slave has this service: the station is no DP slave, or was switched on a moment ago",
    Service.CONFIG: "every DP slave has this service: the station is no DP slave, or was switched on a moment ago",
    Service.INPUTS: _READS_IN_EXCHANGE,
    Service.OUTPUTS: _READS_IN_EXCHANGE,
    Service.SET_ADDRESS: "its address is set at the device itself (switches, menu), was locked by an earlier "
    "Set_Slave_Add (No_Add_Chg), or a master has just parameterised it",
}


def diagnosis_of(answer: Telegram | Failure) -> Diagnosis | None:
    """The diagnosis in an ``answer`` to Slave_Diag, or None."""
    if isinstance(answer, Telegram) and positive(Service.DIAGNOSIS, answer):
        return Diagnosis.parse(answer.data)
    return None


class Class2(Provider):
    """The services of the station ``own`` as a class 2 master, beside its own class 1 ``master``, if any."""

    def __init__(self, own: int, master: Master | None) -> None:
        self._own = own
        self._master = master

    def job_of(self, order: object) -> tuple[int, Job, int] | None:
        match order:
            case ReadService():
                if order.service is Service.SET_ADDRESS:
                    raise UsageError("Set_Slave_Add does not read: use ChangeAddress")
                check_address(order.address, self._own)
                return order.token, Class2Reading(order), order.timeout_ns
            case ChangeAddress(old=old, new=new):
                check_address(old, self._own)
                _check_new(old, new, self._own, self._master)
                try:
                    SetSlaveAdd(new, order.ident or 0, order.no_add_chg, order.rem_slave_data).build()
                except PduError as error:
                    raise UsageError(str(error)) from None
                return order.token, AddressChange(self._own, order), order.timeout_ns
        return None


def check_address(address: int, own: int) -> None:
    """Raises UsageError for an address that no slave can have, beside the station ``own``."""
    if not 0 <= address <= UNADDRESSED:
        raise UsageError(f"address {address}: a slave has 0..{UNADDRESSED} ({UNADDRESSED}: as delivered)")
    if address == own:
        raise UsageError(f"address {address} is that of this master itself")


def _check_new(old: int, new: int, own: int, master: Master | None) -> None:
    if not 0 <= new <= MAX_STATION:
        raise UsageError(f"address {new} cannot be given to a slave: 0..{MAX_STATION}")
    if new == own:
        raise UsageError(f"address {new} is that of this master itself: give the slave another one")
    if new == old:
        raise UsageError(f"the slave has address {new} already: nothing to do")
    if master is not None and old in master.handlers and master.handlers[old].owned:
        raise UsageError(
            f"slave {old} is parameterised by this master and takes no address meanwhile: remove it from the bus first"
        )
