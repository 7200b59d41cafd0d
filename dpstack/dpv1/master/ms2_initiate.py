"""Initiate: the resource manager (SAP 49) gives out a server SAP, polls of that one bring the slave's answer
(docs/protocol.md#ms2).

Decisions where the sources leave something open: docs/decisions/ms2.md#initiate-at-the-master.
"""

from __future__ import annotations

import dataclasses
from typing import Final

from dpstack.dp.acyclic.class2 import answers_slave_diag, service_unanswered
from dpstack.dp.acyclic.job import ATTEMPTS, Outcome, ServiceFailure, Steps
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.services import refusal_text
from dpstack.dpv1.master.ms2_connection import (
    NOT_WANTED,
    TIMED_OUT,
    ConnectionJob,
    Connections,
    MasterConnection,
    Phase,
)
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection
from dpstack.dpv1.master.srd_polling import NO_ANSWERS, Polling, Reply, unreadable_outcome
from dpstack.dpv1.pdu.ms2 import AbortReason, InitiateRes, Instance, ResourceManagerRes
from dpstack.dpv1.pdu.read_write import Function, Negative, parse_response
from dpstack.errors import PduError
from dpstack.fdl.interface import Failure
from dpstack.fdl.telegram import SAP_MS2_RM, Telegram
from dpstack.trace import Event
from dpstack.units import NS_PER_MS

#: the program gave the connection up, or the slave aborted it
_GIVEN_UP: Final = (ServiceFailure.CANCELLED, ServiceFailure.ABORTED)
#: instance and reason of an Abort: the send time-out is too short
_TOO_SHORT: Final = (Instance.MS2, AbortReason.SEND_TIMEOUT)
_NEGATIVE: Final = 0x80
_WITHOUT_MS2: Final = (
    "it has no class 2 connections (a device of DP-V0, or C2_Read_Write_supp = 0 in its GSD file): records of a DP-V1 "
    "slave can be asked for by its own master, of a DP-V0 slave by nobody"
)
#: octets of Initiate, response, without addresses
_INITIATE_RES: Final = 12


class InitiateJob(ConnectionJob):
    """Open ``connection`` by ``order``. Raises UsageError, PduError for an Initiate that cannot be encoded."""

    title = "Initiate"

    def __init__(self, connection: MasterConnection, ms2: Connections, order: OpenConnection) -> None:
        super().__init__(connection, ms2)
        request = order.request
        self._channels = order.channels
        self._octets = request.build()
        self._answer = _INITIATE_RES + len(request.source.build()) + len(request.destination.build())
        self._response: InitiateRes | None = None

    def steps(self) -> Steps[Outcome]:
        """SAP 49 until it names a server SAP, then that one until Initiate is answered."""
        connection = self.connection
        managed = yield from self._ask_resource_manager(self.polling(sap=SAP_MS2_RM))
        if isinstance(managed, Outcome):
            if managed.failure is ServiceFailure.SILENT and (yield from answers_slave_diag(self.address, SAP_MS2_RM)):
                return service_unanswered(self.address, f"{self.title} (SAP {SAP_MS2_RM})", _WITHOUT_MS2)
            return managed
        if self.ms2.uses(self.address, managed.server_sap):  # it cannot be another connection's
            connection.taken = False
            text = f"slave {self.address} gives out server SAP {managed.server_sap}, which is in use by this master"
            return Outcome(ServiceFailure.WRONG, f"{text}; close that connection first")
        connection.server_sap = managed.server_sap
        connection.send_timeout_ns = max(connection.send_timeout_ns, managed.send_timeout_ns)
        polling = self.polling(self._answer)
        found = yield from self.exchange(polling, b"")
        return found if isinstance(found, Outcome) else self._outcome_of(found, polling.now)

    def _ask_resource_manager(self, polling: Polling) -> Steps[ResourceManagerRes | Outcome]:
        """Initiate at the resource manager until it names a server SAP."""
        self.connection.taken = True  # as soon as the link layer has the request: it may go out
        reply = yield from polling.send(self._octets)
        while True:
            match reply:
                case Reply.OLD:
                    reply = yield from polling.send(self._octets)
                case Reply.WAIT:
                    reply = yield from polling.poll()
                case Reply.DATA:
                    managed = self._parse_managed(polling.pdu, polling.now)
                    if managed is not None:
                        return managed
                    reply = yield from polling.poll()
                case Reply.NOTHING if polling.unanswered < ATTEMPTS:
                    reply = yield from self._repeat(polling)
                case _:
                    return self._unmanaged(reply, polling.answer)

    def _repeat(self, polling: Polling) -> Steps[Reply]:
        """After an Initiate without an answer: a poll tells whether the slave took it; if not it goes out again."""
        reply = Reply.AGAIN
        while reply is Reply.AGAIN:
            reply = yield from polling.ask(b"")
        if reply in (Reply.WAIT, Reply.CLOSED):  # the slave is there, and has nothing
            polling.unanswered = 0
        elif reply is not Reply.NOTHING:
            return reply
        return (yield from polling.send(self._octets))

    def _parse_managed(self, octets: bytes, now: int) -> ResourceManagerRes | Outcome | None:
        """A PDU of the resource manager, None for Idle."""
        if octets[0] == Function.ABORT:
            return self.aborted(octets, self.title, now)
        if octets[0] == Function.IDLE:
            return None
        if octets[0] == Function.INITIATE | _NEGATIVE:
            return self._outcome_of(octets, now)
        try:
            return ResourceManagerRes.parse(octets)
        except PduError as error:
            who = f"slave {self.address}: its resource manager"
            text = f"{who} answers Initiate with what cannot be read: {error}"
            return Outcome(ServiceFailure.LENGTH, text)

    def _outcome_of(self, octets: bytes, now: int) -> Outcome:
        """The outcome by the slave's answer to Initiate."""
        connection = self.connection
        try:
            if octets[0] == Function.INITIATE | _NEGATIVE:
                response = parse_response(octets)
                assert isinstance(response, Negative)
                connection.taken = False
                codes = (response.decode, response.code_1, response.code_2)
                text = f"slave {self.address} refuses Initiate: {response.text}"
                status = bytes(codes).hex(" ").upper()
                return Outcome(ServiceFailure.NEGATIVE, text, codes=codes, status=status)
            self._response = InitiateRes.parse(octets)
        except PduError as error:
            return self.unreadable(unreadable_outcome(self.address, self.title, error), now)
        if connection.phase is not Phase.OPENING:  # closed meanwhile
            return self.connection_over()
        connection.max_len = min(self._response.max_len or MAX_RECORD, MAX_RECORD)
        connection.phase = Phase.OPEN
        connection.opened = True
        return Outcome()

    def _unmanaged(self, reply: Reply, last: Telegram | Failure) -> Outcome:
        """No server SAP; ``last``: the slave's last answer."""
        who = f"slave {self.address}"
        match last:
            case Telegram():
                if reply is Reply.CLOSED:
                    return self._no_service(last)
                limit = self.connection.limit_text
                todo = "try again, or give it longer (response_timeout)"
                text = f"{who}: its resource manager has no answer to Initiate within {limit}; {todo}"
                return Outcome(ServiceFailure.LATE, text)
            case Failure.REFUSED:
                self.connection.taken = False
                text = f"{who}: Initiate was not sent; this bus is read-only"
            case Failure.NO_ANSWER:
                text = f"{who} does not answer Initiate; check address and power"
            case _:
                todo = "look for a second station with its address, and at cable and termination"
                text = f"{who} gives no readable answer to Initiate; {todo}"
        return Outcome(NO_ANSWERS[last], text)

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
        return Outcome(ServiceFailure.REFUSED, text, status=status)

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """The InitiateDone. After a failure the slave gets Abort for a connection that it may hold."""
        connection = self.connection
        if outcome.failure is ServiceFailure.CLOSED:
            outcome = self.connection_over()
        elif (
            outcome.failure is ServiceFailure.ABORTED and outcome.codes is not None and outcome.codes[1:] == _TOO_SHORT
        ):
            least = connection.send_timeout_ns // NS_PER_MS
            outcome = dataclasses.replace(outcome, text=f"{outcome.text}; ask for {least} ms or more")
        done = InitiateDone(t_ns=now, token=token, address=self.address, outcome=outcome)
        if outcome.failure is not None:
            self.ms2.end(connection, outcome.text, NOT_WANTED if outcome.failure in _GIVEN_UP else TIMED_OUT, now)
            return [done]
        response = self._response
        assert response is not None
        assert connection.server_sap is not None
        return [
            dataclasses.replace(
                done,
                server_sap=connection.server_sap,
                send_timeout_ns=connection.send_timeout_ns,
                max_len=connection.max_len,
                profile_ident=response.profile_ident,
            )
        ]
