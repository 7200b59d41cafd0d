"""The services of a class 2 master, beside any class 1 master: Slave_Diag, Get_Cfg, RD_Inp, RD_Outp, Set_Slave_Add.

The orders, and what is refused of them at once. Queue and token are :mod:`dpstack.dp.acyclic.queue`, the requests
:mod:`dpstack.dp.acyclic.class2_services`.

Giving a slave another address (docs/protocol.md#set_slave_add): its acknowledgement proves nothing. Some slaves act at
once, some acknowledge and ignore the service (docs/protocol.md#set-slave-add-ignored), some take the address at the
next power-up. So: Slave_Diag first (the right device, nobody's slave), FDL status of the new address (nobody there),
the service, then Slave_Diag at the new address and silence at the old one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.dp.acyclic.class2_services import (
    Reading,
    Service,
    asked,
    diagnosis_of,
    done,
    judged,
    refused,
    request,
    unanswered,
)
from dpstack.dp.acyclic.job import Job, Outcome, Provider, ServiceFailure, Step, Steps
from dpstack.dp.master.fault_texts import left_locked
from dpstack.dp.master.master import Master
from dpstack.dp.master.verdicts import foreign_owner
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.requests import SetSlaveAdd
from dpstack.dp.services import positive
from dpstack.errors import PduError, UsageError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Req, StationType, Telegram
from dpstack.machine import Order
from dpstack.params import MAX_STATION, UNADDRESSED
from dpstack.trace import Event, Notice
from dpstack.units import NS_PER_MS, NS_PER_S

_ATTEMPTS: Final = 3
#: a slave may restart with its new address: it is looked for every 100 ms, up to 5 s
_LOOK_PAUSE: Final = 100 * NS_PER_MS
_LOOKS: Final = 50
#: from here on, and then now and then, the old address is asked too: a slave that ignored the service is still there
_LOOK_BACK: Final = 10
_LOOK_BACK_EVERY: Final = 5


@dataclass
class AddressChange(Job):
    """The job. ``own``: the asking station; ``ident`` None: whatever device is there; the rest as in
    :class:`~dpstack.dp.pdu.requests.SetSlaveAdd`."""

    own: int
    address: int
    new: int
    ident: int | None = None
    no_add_chg: bool = False
    rem_slave_data: bytes = b""
    service = Service.SET_ADDRESS
    title = service.title
    aftermath = ""

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """A notice of a new address, too."""
        events = done(self, self.service, token, outcome, now)
        if outcome.failure is None:
            message = f"slave {self.address} has address {self.new} now" + (" for good" if self.no_add_chg else "")
            events.append(Notice(t_ns=now, source="class 2", message=message))
        return events

    def steps(self) -> Steps[Outcome]:
        """Look, change, verify. ``data`` of a good end is the diagnosis read at the new address."""
        answer = yield from asked(request(self.address, Service.DIAGNOSIS))
        before = judged(self.address, Service.DIAGNOSIS, answer)
        diagnosis = diagnosis_of(answer)
        if before.failure is not None or diagnosis is None:
            return before
        wrong = yield from self._forbidden(diagnosis)
        if wrong is not None:
            return wrong
        if not (yield from _silent(self.new)):
            return Outcome(
                failure=ServiceFailure.TAKEN,
                text=f"address {self.new} is in use: a station answers there; nothing was changed: "
                f"take a free address (`dpstack scan` shows them)",
            )
        pdu = SetSlaveAdd(self.new, diagnosis.ident, self.no_add_chg, self.rem_slave_data)
        order = request(self.address, Service.SET_ADDRESS, pdu.build())
        self.aftermath = (
            f"Set_Slave_Add may have been sent to slave {self.address}: look for it at {self.address} and {self.new}"
        )
        answer = yield from asked(order, _ATTEMPTS)
        if answer is Failure.REFUSED:
            return unanswered(self.address, self.service, answer)
        acknowledged = isinstance(answer, Telegram)
        if isinstance(answer, Telegram) and not positive(self.service, answer):
            return refused(self.address, self.service, answer)
        return (yield from self._verified(diagnosis.ident, acknowledged))

    def _forbidden(self, diagnosis: Diagnosis) -> Steps[Outcome | None]:
        """Why this device must be left alone."""
        if self.ident not in (None, diagnosis.ident):
            return Outcome(
                failure=ServiceFailure.IDENT,
                text=f"slave {self.address} is another device: ident 0x{diagnosis.ident:04X} instead of "
                f"0x{self.ident:04X}; nothing was changed: give its ident, or look which device has that address",
            )
        owner = foreign_owner(diagnosis, self.own)
        if owner is not None and (yield from _is_no_master(owner)):
            what, todo = left_locked(diagnosis, owner)
            return Outcome(
                failure=ServiceFailure.OWNED,
                text=f"slave {self.address} {what} and takes no address meanwhile; nothing was changed: {todo}",
            )
        if owner is not None:
            return Outcome(
                failure=ServiceFailure.OWNED,
                text=f"slave {self.address} is owned by master {owner} and takes no address meanwhile; nothing was "
                f"changed: stop master {owner}, or take the slave out of its configuration",
            )
        return None

    def _verified(self, ident: int, acknowledged: bool) -> Steps[Outcome]:
        at_new = request(self.new, Service.DIAGNOSIS)
        for look in range(_LOOKS):
            answer = (yield Step(at_new, _LOOK_PAUSE)).answer
            found = diagnosis_of(answer)
            if found is not None and isinstance(answer, Telegram):
                return (yield from self._arrived(ident, found.ident, answer.data))
            back = look >= _LOOK_BACK and not look % _LOOK_BACK_EVERY
            if back and not (yield from _silent(self.address)):
                return self._kept(acknowledged)
        return Outcome(
            failure=ServiceFailure.GONE,
            text=f"slave {self.address} answers neither there nor at {self.new} after Set_Slave_Add; "
            f"switch it off and on, then look with `dpstack scan`",
        )

    def _arrived(self, ident: int, found: int, data: bytes) -> Steps[Outcome]:
        if found != ident:
            return Outcome(
                failure=ServiceFailure.IDENT,
                text=f"another device answers at {self.new} after Set_Slave_Add: ident 0x{found:04X} instead of "
                f"0x{ident:04X}; look which device has that address before anything else is changed",
            )
        if not (yield from _silent(self.address)):
            return Outcome(
                failure=ServiceFailure.DOUBLE,
                text=f"the slave has address {self.new} now, but a station still answers at {self.address}: "
                f"two had that address; give the other one an address of its own",
            )
        return Outcome(data)

    def _kept(self, acknowledged: bool) -> Outcome:
        did = "acknowledged" if acknowledged else "did not acknowledge"
        return Outcome(
            failure=ServiceFailure.KEPT,
            text=f"slave {self.address} {did} Set_Slave_Add and kept its address; its address was locked by an "
            f"earlier one (No_Add_Chg: only a reset at the device opens it), is set by switches, or changes at the "
            f"next power-up: switch it off and on, then look with `dpstack scan`",
            status="ignored",
        )


def _is_no_master(address: int) -> Steps[bool]:
    """Whether no master answers FDL status at ``address``; octets that cannot be read may be one's."""
    for patient in (False, True):
        answer = (yield Step(Request(address, Req.FDL_STATUS, patient=patient, retry=False))).answer
        if isinstance(answer, Telegram):
            return answer.station_type is StationType.SLAVE
        if answer is not Failure.NO_ANSWER:
            return False
    return True


def _silent(address: int) -> Steps[bool]:
    """Nobody answers FDL status at ``address``; octets that cannot be read are an answer too. The second time the
    answer is waited for as long as that of a station that matters: two stations with one address are worse."""
    for patient in (False, True):
        poll = Request(address, Req.FDL_STATUS, patient=patient, retry=False)
        if (yield Step(poll)).answer is not Failure.NO_ANSWER:
            return False
    return True


READ_TIMEOUT: Final = 5 * NS_PER_S
#: a slave that restarts with its new address takes seconds
CHANGE_TIMEOUT: Final = 15 * NS_PER_S


@dataclass(frozen=True, slots=True)
class ReadService(Order):
    """Ask ``address`` (0..126) for ``service``; ``expected`` as in
    :class:`~dpstack.dp.acyclic.class2_services.Reading`.

    The result is the :class:`~dpstack.dp.acyclic.class2_services.ServiceDone` with ``token``.
    """

    token: int
    address: int
    service: Service
    expected: int | None = None
    timeout_ns: int = READ_TIMEOUT


@dataclass(frozen=True, slots=True)
class ChangeAddress(Order):
    """Give the slave at ``old`` (0..126) the address ``new`` (0..125); see :mod:`dpstack.dp.acyclic.class2`."""

    token: int
    old: int
    new: int
    ident: int | None = None
    no_add_chg: bool = False
    rem_slave_data: bytes = b""
    timeout_ns: int = CHANGE_TIMEOUT


class Class2(Provider):
    """The services of the station ``own`` as a class 2 master, beside its own class 1 ``master``, if any."""

    def __init__(self, own: int, master: Master | None) -> None:
        self._own = own
        self._master = master

    def job_of(self, order: object) -> tuple[int, Job, int] | None:
        match order:
            case ReadService(token, address, service, expected, timeout_ns):
                if service is Service.SET_ADDRESS:
                    raise UsageError("Set_Slave_Add does not read: use ChangeAddress")
                check_address(address, self._own)
                return token, Reading(address, service, expected), timeout_ns
            case ChangeAddress(token, old, new, ident, no_add_chg, rem_slave_data, timeout_ns):
                check_address(old, self._own)
                _check_new(old, new, self._own, self._master)
                try:
                    SetSlaveAdd(new, ident or 0, no_add_chg, rem_slave_data).build()
                except PduError as error:
                    raise UsageError(str(error)) from None
                return token, AddressChange(self._own, old, new, ident, no_add_chg, rem_slave_data), timeout_ns
        return None


def check_address(address: int, own: int) -> None:
    """Raises UsageError for an address that no slave can have, beside the station ``own``."""
    if not 0 <= address <= UNADDRESSED:
        raise UsageError(f"{address} is no address of a slave: 0..{UNADDRESSED} ({UNADDRESSED}: as delivered)")
    if address == own:
        raise UsageError(f"{address} is the address of this master itself")


def _check_new(old: int, new: int, own: int, master: Master | None) -> None:
    if not 0 <= new <= MAX_STATION:
        raise UsageError(f"{new} is no address to give to a slave: 0..{MAX_STATION}")
    if new == own:
        raise UsageError(f"{new} is the address of this master itself: give the slave another one")
    if new == old:
        raise UsageError(f"the slave has address {new} already: nothing to do")
    if master is not None and old in master.handlers and master.handlers[old].owned:
        raise UsageError(
            f"slave {old} is parameterised by this master and takes no address meanwhile: remove it from the bus first"
        )
