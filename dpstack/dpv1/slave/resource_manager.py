"""MS2 of a slave: the resource manager at SAP 49, the connections that it gives out, their timers.

Initiate comes to SAP 49 and is acknowledged; polled there, the resource manager names the server SAP, and the response
to Initiate, or an Abort, is fetched at that one (Felser; VPC3+). Open in every state of the slave, for any master:
class 2 needs no parameters (docs/reference/protocol.md#ms2). Decisions on points that the sources leave open:
docs/reference/decisions/ms2.md#the-resource-manager-of-a-slave.

A class 2 connection at the slave, from Initiate to its end. Its table of states: ms2_states.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from enum import Enum
from typing import Final

from msgspec import Struct
from msgspec.structs import replace

from dpstack.dp.error_origin import DEVICE_CALL, failure_text
from dpstack.dp.pdu.layouts import MAX_RECORD, MAX_SLOT
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave.events import Report, SlaveAppEvent
from dpstack.dp.slave.extension import Handler, SlaveService
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.ms2 import (
    IDLE,
    LEAST_INITIATE,
    MAX_REASON,
    SERVER_SAPS,
    Abort,
    AbortReason,
    InitiateReq,
    InitiateRes,
    Instance,
    ResourceManagerRes,
)
from dpstack.dpv1.pdu.read_write import (
    FUNCTIONS,
    DataTransport,
    Function,
    Negative,
    ReadReq,
    UnacceptableError,
    parse_request,
)
from dpstack.dpv1.slave.ms2_states import TABLE, Act, Ms2Trigger, State
from dpstack.dpv1.slave.record_requests import AcyclicDevice, Asker, RecordRequest, ask, ask_records
from dpstack.dpv1.timeouts import PATIENCE, WORKING_SHARE, least_send_timeout
from dpstack.errors import ConfigError, PduError, RecordRefused, UsageError
from dpstack.fdl.interface import SC_REPLY, Reply
from dpstack.fdl.telegram import MAX_DATA, SAP_MS2_RM, Resp, Telegram
from dpstack.units import NEVER, NS_PER_MS


class ConnectionOpened(SlaveAppEvent):
    """``master`` has opened a connection of class 2 at the server ``sap``."""

    #: address of the master that opened it
    master: int
    #: server SAP of the connection, 0..48
    sap: int
    #: longest silence of either end, in ns
    send_timeout_ns: int

    def _text(self) -> str:
        which = f"class 2 connection of master {self.master} opened (server SAP {self.sap}"
        return f"{self.who}: {which}, send time-out {self.send_timeout_ns // NS_PER_MS} ms)"


class ConnectionClosed(SlaveAppEvent):
    """A connection of class 2 is over and given back."""

    #: address of the master at the other end
    master: int
    #: server SAP of the connection, 0..48
    sap: int
    #: number of services that the master asked for
    services: int
    #: why it ended, for people
    reason: str

    def _text(self) -> str:
        which = f"class 2 connection of master {self.master} (server SAP {self.sap})"
        return f"{self.who}: {which} is over after {self.services} services: {self.reason}"


class Offer(Enum):
    """Progress of a master from the resource manager to its server SAP."""

    WAITING = "not fetched from the resource manager yet"
    FETCHED = "fetched"
    USED = "used"


class ServerConnection:
    """One connection. ``ssap``: its master's SAP, 50 as a rule; ``send_timeout_ns``: as agreed.

    ``last_request``: the time of the last sign of life of its master; ``services``: how many it has asked for.
    """

    def __init__(self, asker: Asker, ssap: int | None, device: AcyclicDevice, report: Report, now: int) -> None:
        self.asker = asker
        self.ssap = ssap
        self.send_timeout_ns = least_send_timeout(report.baud)
        self.state = State.ANSWERED
        self.offer = Offer.WAITING
        self.last_request = now
        self.services = 0
        #: its last sign of life to its master
        self._last_sign = now
        self._answer: bytes | None = None
        self._request: RecordRequest | None = None
        self._device = device
        self._report = report

    @property
    def deadline(self) -> int:
        """When silence ends it, in ns: the send time-out, twice that while nothing is asked (VPC3+)."""
        patience = PATIENCE if self.state is State.OPEN else 1
        return self.last_request + patience * self.send_timeout_ns

    def is_of(self, sa: int, ssap: int | None) -> bool:
        """True for the master of this connection: its server SAP is open for no other one."""
        return sa == self.asker.master and ssap == self.ssap

    # --- its beginning --------------------------------------------------------------------------------------------

    def initiate(self, octets: bytes, now: int) -> None:
        """A request to the resource manager: the connection is open, or over at once with an Abort as its answer."""
        try:
            longest = self._device.ms2_max_initiate
            if len(octets) > longest:
                raise PduError(f"Initiate of {len(octets)} octets, {longest} are possible (Max_Initiate_PDU_Length)")
            wanted = InitiateReq.parse(octets)
        except PduError as error:
            self._refuse(str(error), Abort(AbortReason.REQUEST_PDU), now)
            return
        if wanted.destination.net:
            reason = "D_Addr is an address in another network, and this slave is the end of the way"
            self._refuse(reason, Abort(AbortReason.ADDRESS), now)
            return
        try:
            with DEVICE_CALL:
                self._device.initiate(self.asker.master, wanted)
        except Exception as error:
            self._refuse_as_device(error, now)
            return
        # the shorter time-out is not refused, the longer of both counts (VPC3+)
        self.send_timeout_ns = max(self.send_timeout_ns, wanted.send_timeout_ns)
        longest = self._device.ms2_max_len
        self._answer = InitiateRes(longest, source=wanted.destination, destination=wanted.source).build()
        self._report.stats.connections += 1
        who = self.asker
        self._report.emit(ConnectionOpened, now, master=who.master, sap=who.sap, send_timeout_ns=self.send_timeout_ns)

    def _refuse_as_device(self, error: Exception, now: int) -> None:
        """The device raised ``error``: refuse Initiate by a negative response."""
        if isinstance(error, RecordRefused):
            negative = Negative(Function.INITIATE, error.code_1 & 0xFF, error.code_2 & 0xFF)
            reason = f"its function: {negative.text}"
        else:
            negative = Negative(Function.INITIATE, Code.RESOURCE_UNAVAILABLE)
            reason = failure_text(error)
        self._refuse(reason, negative, now)

    def _refuse(self, why: str, answer: Abort | Negative, now: int) -> None:
        self._report.refused("Initiate", self.asker.master, why, now)
        self.asker.open = False
        self.state = State.OVER
        self._answer = answer.build()

    # --- requests and polls ----------------------------------------------------------------------------------------

    def receive(self, octets: bytes, now: int) -> None:
        """A request of its master."""
        self.last_request = now
        trigger, why = _trigger_of(octets)
        match TABLE[self.state, trigger].act:
            case Act.SERVE:
                self.services += 1
                self._serve(octets, now)
            case Act.ANSWER_IDLE:
                self._answer = IDLE
                self.state = State.ANSWERED
            case Act.FREE:
                self.end(f"its master aborted it: {why}", now)
            case Act.SEQUENCE:
                self.end(f"{why} in the state '{self.state.value}'", now, Abort(AbortReason.SEQUENCE))
            case Act.REQUEST_PDU:
                self.end(why, now, Abort(AbortReason.REQUEST_PDU))

    def poll(self, now: int) -> bytes | None:
        """The answer to a poll, None for SC; an Abort that was fetched frees the connection."""
        self.last_request = now
        if self.state is State.WORKING and self._request is not None:
            self._answer = self._request.octets(self._report, now)
            if self._answer is not None:
                self._request = None
                self.state = State.ANSWERED
        act = TABLE[self.state, Ms2Trigger.POLL].act
        if act is Act.ANSWER:
            self.state = State.OPEN
        if act in (Act.ANSWER, Act.FREE):
            answer, self._answer = self._answer, None
            return answer
        if act is Act.ANSWER_IF_READY and now - self._last_sign >= self.send_timeout_ns // WORKING_SHARE:
            self._last_sign = now
            return IDLE
        return None

    def silence(self, now: int) -> None:
        if TABLE[self.state, Ms2Trigger.SILENCE].act is Act.FREE:
            self._answer = None
            return
        waited = (now - self.last_request) // NS_PER_MS
        self.last_request = now
        self.end(f"nothing was heard of its master for {waited} ms", now, Abort(AbortReason.TIMEOUT))

    @property
    def free(self) -> bool:
        """True when the connection is over and no answer waits to be fetched."""
        return self.state is State.OVER and self._answer is None

    def abort(self, reason: int, now: int) -> None:
        """The user of the slave ends it; both users know the meaning of ``reason`` 0..15."""
        self.end(f"it was aborted here (reason {reason})", now, Abort(reason, Instance.USER))
        self.last_request = now

    def end(self, why: str, now: int, abort: Abort | None = None) -> None:
        """End the connection. Its master may fetch ``abort``; None: nothing is sent."""
        if self.state is not State.OVER:
            self.state = State.OVER
            self.asker.open = False
            request, self._request = self._request, None
            if request is not None:
                request.drop()
            self._report.stats.closed += 1
            who = self.asker
            self._report.emit(ConnectionClosed, now, master=who.master, sap=who.sap, services=self.services, reason=why)
        self._answer = None if abort is None else abort.build()

    # --- inside ---------------------------------------------------------------------------------------------------

    def _serve(self, octets: bytes, now: int) -> None:
        """A service: what its application can be asked, else a negative response like that of MS1."""
        self._last_sign = now
        self.state = State.WORKING
        try:
            service = parse_transport(octets) if octets[0] == Function.DATA_TRANSPORT else parse_request(octets)
            longest = self._device.ms2_max_len
            if isinstance(service, ReadReq):
                service = replace(service, length=min(service.length, longest))
            elif len(service.data) > longest:
                reason = f"{len(service.data)} octets of data, {longest} are possible"
                raise UnacceptableError(reason, octets[0], Code.WRITE_LENGTH_ERROR)
        except UnacceptableError as error:
            self._report.refused("MS2", self.asker.master, str(error), now)
            self._answer = error.negative.build()
            self.state = State.ANSWERED
            return
        self._request = request = RecordRequest(service, self.asker, now)
        if isinstance(service, DataTransport):
            ask(request, self._device.transport, Code.FEATURE_NOT_SUPPORTED)
        else:
            ask_records(request, self._device.records)


_TRIGGERS: Final[Mapping[int, Ms2Trigger]] = {
    Function.ABORT: Ms2Trigger.ABORT,
    Function.IDLE: Ms2Trigger.IDLE,
    Function.READ: Ms2Trigger.SERVICE,
    Function.WRITE: Ms2Trigger.SERVICE,
    Function.DATA_TRANSPORT: Ms2Trigger.SERVICE,
}


def _trigger_of(octets: bytes) -> tuple[Ms2Trigger, str]:
    """The trigger that a request is, and the reason for people if it ends the connection."""
    function = octets[0]
    if function not in FUNCTIONS:
        return Ms2Trigger.UNREADABLE, f"octet 1: no service 0x{function:02X}"
    why = f"{Function(function).title} came"
    if function == Function.ABORT:
        try:
            why = Abort.parse(octets).text
        except PduError as error:
            why = f"an Abort that cannot be read: {error}"
    return _TRIGGERS.get(function, Ms2Trigger.OUT_OF_PLACE), why


def parse_transport(octets: bytes) -> DataTransport:
    """Read a Data_Transport request as a slave does. Raises UnacceptableError with what to answer."""
    try:
        request = DataTransport.parse(octets)
    except PduError as error:
        raise UnacceptableError(str(error), Function.DATA_TRANSPORT, Code.INVALID_PARAMETER) from None
    if request.slot > MAX_SLOT:
        reason = f"octet 2: there is no slot {request.slot}"
        raise UnacceptableError(reason, Function.DATA_TRANSPORT, Code.INVALID_SLOT)
    return request


#: connections that one slave can have
MAX_CONNECTIONS: Final = len(SERVER_SAPS)


class ServedConnection(Struct, frozen=True):
    """A connection as it stands: its ``master``, the server ``sap``, the send time-out in ns, services asked for."""

    master: int
    sap: int
    send_timeout_ns: int
    services: int


def check_ms2(who: str, connections: int, max_len: int, max_initiate: int) -> None:
    """Raise ConfigError if the settings ``ms2``, ``ms2_max_len`` and ``ms2_max_initiate`` of a slave cannot be."""
    if not 0 <= connections <= MAX_CONNECTIONS:
        raise ConfigError(f"{who}: ms2 = {connections}: 0 to {MAX_CONNECTIONS} class 2 connections are possible")
    if not 0 < max_len <= MAX_RECORD:
        raise ConfigError(f"{who}: ms2_max_len {max_len} is outside 1..{MAX_RECORD}")
    if not LEAST_INITIATE <= max_initiate <= MAX_DATA:
        raise ConfigError(f"{who}: ms2_max_initiate {max_initiate} is outside {LEAST_INITIATE}..{MAX_DATA}")


class Ms2Server(SlaveService):
    """The connections of one slave application: as many as ``device.ms2`` says, 0 for a slave without MS2.

    With ``device.ms2_at_once`` the request itself gets the answer if it is known by then, not the poll after it;
    both are legal (docs/reference/protocol.md#ms1).
    """

    def __init__(self, device: AcyclicDevice, report: Report) -> None:
        self.at = NEVER
        self._device = device
        self._report = report
        self._connections: dict[int, ServerConnection] = {}
        self._free = deque(SERVER_SAPS[::-1][: device.ms2])

    @property
    def connections(self) -> tuple[ServedConnection, ...]:
        """Those that are open, by server SAP from the highest down."""
        return tuple(
            ServedConnection(one.asker.master, sap, one.send_timeout_ns, one.services)
            for sap, one in sorted(self._connections.items(), reverse=True)
            if one.state is not State.OVER
        )

    @property
    def free(self) -> int:
        """The number of connections that are free."""
        return self._device.ms2 - len(self.connections)

    def handlers(self) -> dict[int | None, Handler]:
        """The resource manager, and the server SAPs."""
        return {**dict.fromkeys(SERVER_SAPS, self._serve), SAP_MS2_RM: self._manage}

    # --- SAP 49 ---------------------------------------------------------------------------------------------------

    def _manage(self, request: Telegram, now: int) -> Reply | None:
        """A request to the resource manager, or a poll (no octets); None for RS."""
        octets, sa, ssap = request.data, request.sa, request.ssap
        if not self._device.ms2:
            return None
        if not octets:
            return self._offer_reply(sa, ssap)
        for one in self._offers(sa, ssap):
            if one.state is State.OVER:
                self._take_back(one, now)  # the fault of an earlier Initiate is no answer to this one
        sap = self._free_sap(sa, ssap, now)
        if sap is None:
            return None
        connection = ServerConnection(Asker(sa, sap), ssap, self._device, self._report, now)
        self._connections[sap] = connection
        connection.initiate(octets, now)
        self._watch(connection)
        return self._offer_reply(sa, ssap) if self._device.ms2_at_once else SC_REPLY

    def _offers(self, sa: int, ssap: int | None) -> list[ServerConnection]:
        """The connections of a master that has not used the server SAP since its Initiate."""
        return [one for one in self._connections.values() if one.offer is not Offer.USED and one.is_of(sa, ssap)]

    def _offer_reply(self, sa: int, ssap: int | None) -> Reply:
        """The server SAP for a master; that of each Initiate once, then the last one."""
        offers = self._offers(sa, ssap)
        if not offers:
            return SC_REPLY
        connection = next((one for one in offers if one.offer is Offer.WAITING), offers[-1])
        connection.offer = Offer.FETCHED
        return Reply(Resp.DL, ResourceManagerRes(connection.asker.sap, least_send_timeout(self._report.baud)).build())

    def _free_sap(self, sa: int, ssap: int | None, now: int) -> int | None:
        """A free server SAP, or that of a connection whose Abort, or whose offer, its master has not fetched."""
        if not self._free:
            unused = [one for one in self._connections.values() if one.state is State.OVER]
            unused += [one for one in self._offers(sa, ssap) if one.offer is Offer.WAITING]
            for one in unused[:1]:
                self._take_back(one, now)
        return self._free.popleft() if self._free else None

    def _take_back(self, connection: ServerConnection, now: int) -> None:
        connection.end("another Initiate of its master came before the answer was fetched", now)
        self._give_back(connection)

    # --- server SAPs ------------------------------------------------------------------------------------------------

    def _serve(self, request: Telegram, now: int) -> Reply | None:
        """A request to a server SAP, or a poll (no octets); None for RS: it is not open, or not for this master."""
        octets = request.data
        connection = self._connections.get(request.dsap or 0)
        if connection is None or not connection.is_of(request.sa, request.ssap):
            return None
        connection.offer = Offer.USED
        if octets:
            connection.receive(octets, now)
        answer = connection.poll(now) if not octets or (self._device.ms2_at_once and not connection.free) else None
        self._give_back(connection)
        self._watch(connection)
        return SC_REPLY if answer is None else Reply(Resp.DL, answer)

    # --- time, and the end ------------------------------------------------------------------------------------------

    def tick(self, now: int) -> None:
        """Judge the deadlines; they are moved only when one has come."""
        for connection in list(self._connections.values()):
            if connection.deadline <= now:
                connection.silence(now)
                self._give_back(connection)
        self.at = min((one.deadline for one in self._connections.values()), default=NEVER)

    def abort(self, sap: int, reason: int, now: int) -> None:
        """End the connection at the server ``sap``; its master reads it in an Abort of the user with ``reason`` 0..15.

        Raises UsageError.
        """
        connection = self._connections.get(sap)
        if connection is None or connection.state is State.OVER:
            raise UsageError(f"there is no open class 2 connection at server SAP {sap}; see connections")
        if reason not in range(MAX_REASON + 1):
            raise UsageError(f"an Abort has no reason {reason}: 0..{MAX_REASON}")
        connection.abort(reason, now)
        self._watch(connection)

    def end(self, why: str, now: int) -> None:
        """End every connection without an Abort: no master could fetch it."""
        for connection in list(self._connections.values()):
            connection.end(why, now)
            self._give_back(connection)
        self.at = NEVER

    def _watch(self, connection: ServerConnection) -> None:
        if not connection.free:
            self.at = min(self.at, connection.deadline)

    def _give_back(self, connection: ServerConnection) -> None:
        """Give back the server SAP of a connection that is over."""
        sap = connection.asker.sap
        if connection.free and self._connections.get(sap) is connection:
            del self._connections[sap]
            self._free.append(sap)


def ms2_of(app: SlaveApp) -> Ms2Server:
    """The connections of a slave application whose device has MS2."""
    return next(one for one in app.services if isinstance(one, Ms2Server))
