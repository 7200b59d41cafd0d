"""How a class 2 connection is opened: Initiate at the resource manager (SAP 49), which gives out a server SAP; polls of
that one bring the slave's answer (docs/protocol.md#ms2).

Decisions where the sources leave something open: docs/decisions/ms2.md#initiate-at-the-master.
"""

from __future__ import annotations

import dataclasses
from typing import Final

from dpstack.dp.acyclic.class2_services import leaves_out, left_out
from dpstack.dp.acyclic.job import ATTEMPTS, Outcome, ServiceFailure, Steps
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.services import refusal_text
from dpstack.dpv1.master.ms2_commands import InitiateDone
from dpstack.dpv1.master.ms2_connection import NOT_WANTED, TIMED_OUT, Ended, MasterConnection, Phase
from dpstack.dpv1.master.ms2_jobs import ConnectionJob, Connections
from dpstack.dpv1.master.srd_polling import NO_ANSWERS, Course, Said
from dpstack.dpv1.pdu.ms2 import AbortReason, InitiateReq, InitiateRes, Instance, ResourceManagerRes
from dpstack.dpv1.pdu.read_write import Function, Negative, parse_response
from dpstack.errors import PduError
from dpstack.fdl.interface import Failure
from dpstack.fdl.telegram import SAP_MS2_RM, Telegram
from dpstack.trace import Event
from dpstack.units import NS_PER_MS

#: by whoever wanted it
_GIVEN_UP: Final = (ServiceFailure.CANCELLED, ServiceFailure.ABORTED)
_NEGATIVE: Final = 0x80
_WITHOUT_MS2: Final = (
    "it has no class 2 connections (a device of DP-V0, or C2_Read_Write_supp = 0 in its GSD file): records of a DP-V1 "
    "slave can be asked for by its own master, of a DP-V0 slave by nobody"
)
#: octets of Initiate, response, without addresses
_INITIATE_RES: Final = 12


class InitiateJob(ConnectionJob):
    """Open ``connection``: the resource manager gives out a server SAP, whose polls bring the slave's answer."""

    title = "Initiate"

    def __init__(self, connection: MasterConnection, ms2: Connections, request: InitiateReq, channels: int) -> None:
        super().__init__(connection, ms2)
        self._channels = channels
        self._octets = request.build()
        self._answer = _INITIATE_RES + len(request.source.build()) + len(request.destination.build())
        self._response: InitiateRes | None = None

    def steps(self) -> Steps[Outcome]:
        """SAP 49 until it names a server SAP, then that one until Initiate is answered."""
        connection = self.connection
        course = connection.course(SAP_MS2_RM)
        managed = yield from self._managed(course)
        if isinstance(managed, Ended):
            if managed.outcome.failure is ServiceFailure.SILENT and (yield from leaves_out(self.address, SAP_MS2_RM)):
                return left_out(self.address, f"{self.title} (SAP {SAP_MS2_RM})", _WITHOUT_MS2)
            return self._refused(managed, course.now)
        wrong = self._check(managed)
        if wrong is not None:
            return wrong
        connection.server_sap = managed.server_sap
        connection.send_timeout_ns = max(connection.send_timeout_ns, managed.send_timeout_ns)
        course = self.course(self._answer)
        found = yield from connection.asked(course, b"", self.title)
        if isinstance(found, Ended):
            return self._refused(found, course.now)
        return self._judged(found, course.now)

    def _managed(self, course: Course) -> Steps[ResourceManagerRes | Ended]:
        """Initiate at the resource manager until it names a server SAP."""
        self.connection.taken = True  # from when it is handed on: what the link layer has goes out
        found = yield from course.requested(self._octets)
        while True:
            match found:
                case Said.OLD:
                    found = yield from course.requested(self._octets)
                case Said.WAIT:
                    found = yield from course.polled()
                case Said.DATA:
                    managed = self._read(course.pdu, course.now)
                    if managed is not None:
                        return managed
                    found = yield from course.polled()
                case Said.NOTHING if course.unanswered < ATTEMPTS:
                    found = yield from self._looked_for(course)
                case _:
                    return Ended(self._unmanaged(found, course.answer))

    def _looked_for(self, course: Course) -> Steps[Said]:
        """An Initiate without an answer: a poll tells whether it was taken. Where it was not it goes out again."""
        found = Said.AGAIN
        while found is Said.AGAIN:
            found = yield from course.ask(b"")
        if found in (Said.WAIT, Said.CLOSED):  # the slave is there, and has nothing
            course.unanswered = 0
        elif found is not Said.NOTHING:
            return found
        return (yield from course.requested(self._octets))

    def _check(self, managed: ResourceManagerRes) -> Outcome | None:
        """A server SAP that this master uses already cannot be another connection's."""
        if not self.ms2.uses(self.address, managed.server_sap):
            return None
        self.connection.taken = False
        text = f"slave {self.address} gives out server SAP {managed.server_sap}, which is in use by this master"
        return Outcome(failure=ServiceFailure.WRONG, text=f"{text}; close that connection first")

    def _judged(self, octets: bytes, now: int) -> Outcome:
        connection = self.connection
        try:
            if octets[0] == Function.INITIATE | _NEGATIVE:
                response = parse_response(octets)
                assert isinstance(response, Negative)
                connection.taken = False
                codes = (response.decode, response.code_1, response.code_2)
                text = f"slave {self.address} refuses Initiate: {response.text}"
                return Outcome(failure=ServiceFailure.NEGATIVE, text=text, codes=codes, status=codes_text(codes))
            self._response = InitiateRes.parse(octets)
        except PduError as error:
            text = f"slave {self.address} answers Initiate with what cannot be read: {error}"
            return self.over(connection.unreadable(Outcome(failure=ServiceFailure.LENGTH, text=text)), now)
        if connection.phase is not Phase.OPENING:  # closed meanwhile
            return connection.ended(self.title)
        connection.max_len = min(self._response.max_len or MAX_RECORD, MAX_RECORD)
        connection.phase = Phase.OPEN
        connection.opened = True
        return Outcome()

    def _refused(self, ended: Ended, now: int) -> Outcome:
        """Abort and closed SAPs are the slave's no; whether it holds anything is known to the connection."""
        if ended.abort is not None:
            self.ms2.end(self.connection, ended.reason, ended.abort, now)
        outcome = ended.outcome
        if outcome.codes is not None and outcome.codes[1:] == (Instance.MS2, AbortReason.SEND_TIMEOUT):
            least = self.connection.send_timeout_ns
            outcome = dataclasses.replace(outcome, text=f"{outcome.text}; ask for {least // NS_PER_MS} ms or more")
        return outcome

    def _read(self, octets: bytes, now: int) -> ResourceManagerRes | Ended | None:
        """A PDU of the resource manager, None for Idle."""
        connection = self.connection
        who = f"slave {self.address}"
        if octets[0] == Function.ABORT:
            return connection.aborted(octets, self.title)
        if octets[0] == Function.IDLE:
            return None
        try:
            if octets[0] == Function.INITIATE | _NEGATIVE:
                return Ended(self._judged(octets, now))
            return ResourceManagerRes.parse(octets)
        except PduError as error:
            text = f"{who}: its resource manager answers Initiate with what cannot be read: {error}"
            return Ended(Outcome(failure=ServiceFailure.LENGTH, text=text))

    def _unmanaged(self, found: Said, last: Telegram | Failure) -> Outcome:
        """No server SAP, and ``last`` was what came."""
        if not isinstance(last, Telegram):
            return self._unanswered(last)
        if found is Said.CLOSED:
            return self._no_service(last)
        text = (
            f"slave {self.address}: its resource manager has no answer to Initiate within "
            f"{self.connection.limit_text}; try again, or give it longer (response_timeout)"
        )
        return Outcome(failure=ServiceFailure.LATE, text=text)

    def _no_service(self, answer: Telegram) -> Outcome:
        """RS: the resource manager is closed for good, or has no server SAP left (Felser)."""
        self.connection.taken = False
        status = refusal_text(answer)
        own = self.ms2.count(self.address) - 1
        facts = (f"C2_Max_Count_Channels = {self._channels}", f"{own} of them from here")
        mine = ", ".join(fact for fact, known in zip(facts, (self._channels, own), strict=True) if known)
        text = (
            f"slave {self.address} refuses Initiate ({status} at SAP {SAP_MS2_RM}): all its class 2 connections are in "
            f"use{f' ({mine})' if mine else ''}, or it has none (C2_Read_Write_supp of its GSD file); close one, or "
            "wait until another master does"
        )
        return Outcome(failure=ServiceFailure.REFUSED, text=text, status=status)

    def _unanswered(self, why: Failure) -> Outcome:
        if why is Failure.REFUSED:
            self.connection.taken = False
            text = f"slave {self.address}: Initiate was not sent; this bus is read-only"
        elif why is Failure.NO_ANSWER:
            text = f"slave {self.address} does not answer Initiate; check address and power"
        else:
            what = "look for a second station with its address, and at cable and termination"
            text = f"slave {self.address} gives no readable answer to Initiate; {what}"
        return Outcome(failure=NO_ANSWERS[why], text=text)

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """One event; what the slave may have given is given back where it is not to be used."""
        connection = self.connection
        if outcome.failure is ServiceFailure.CLOSED:
            outcome = connection.ended(self.title)
        if outcome.failure is not None:
            self.ms2.end(connection, outcome.text, NOT_WANTED if outcome.failure in _GIVEN_UP else TIMED_OUT, now)
            return [InitiateDone(t_ns=now, token=token, address=self.address, outcome=outcome)]
        response = self._response
        assert response is not None
        assert connection.server_sap is not None
        return [
            InitiateDone(
                t_ns=now,
                token=token,
                address=self.address,
                outcome=outcome,
                server_sap=connection.server_sap,
                send_timeout_ns=connection.send_timeout_ns,
                max_len=connection.max_len,
                features=response.features,
                profile_features=response.profile_features,
                profile_ident=response.profile_ident,
            )
        ]


def codes_text(codes: tuple[int, int, int]) -> str:
    """A negative response as octets."""
    return bytes(codes).hex(" ").upper()
