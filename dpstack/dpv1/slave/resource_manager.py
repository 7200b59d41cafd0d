"""MS2 of a slave: the resource manager at SAP 49, the connections that it gives out, their timers.

Initiate comes to SAP 49 and is acknowledged; polled there, the resource manager names the server SAP, and the response
to Initiate, or an Abort, is fetched at that one (Felser; VPC3+). Open in every state of the slave, for any master:
class 2 needs no parameters (docs/protocol.md#ms2). Decisions where the sources leave something open:
docs/decisions/ms2.md#the-resource-manager-of-a-slave.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave.events import Report
from dpstack.dp.slave.extension import Handler, SlaveService
from dpstack.dpv1.pdu.ms2 import LEAST_INITIATE, MAX_REASON, SERVER_SAPS, ResourceManagerRes
from dpstack.dpv1.slave.ms2_connection import Offer, ServerConnection
from dpstack.dpv1.slave.ms2_states import State
from dpstack.dpv1.slave.record_requests import AcyclicDevice, Asker
from dpstack.dpv1.timeouts import least_send_timeout
from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.interface import SC_REPLY, Reply
from dpstack.fdl.telegram import MAX_DATA, SAP_MS2_RM, Resp, Telegram
from dpstack.units import NEVER

#: connections that one slave can have
MAX_CONNECTIONS: Final = len(SERVER_SAPS)


@dataclass(frozen=True, slots=True)
class ServedConnection:
    """A connection as it stands: its ``master``, the server ``sap``, the send time-out in ns, services asked for."""

    master: int
    sap: int
    send_timeout_ns: int
    services: int


def check_ms2(who: str, connections: int, max_len: int, max_initiate: int) -> None:
    """Raise ConfigError where the settings ``ms2``, ``ms2_max_len`` and ``ms2_max_initiate`` of a slave cannot be."""
    if not 0 <= connections <= MAX_CONNECTIONS:
        raise ConfigError(f"{who}: ms2 = {connections}: 0 to {MAX_CONNECTIONS} class 2 connections are possible")
    if not 0 < max_len <= MAX_RECORD:
        raise ConfigError(f"{who}: ms2_max_len {max_len} is outside 1..{MAX_RECORD}")
    if not LEAST_INITIATE <= max_initiate <= MAX_DATA:
        raise ConfigError(f"{who}: ms2_max_initiate {max_initiate} is outside {LEAST_INITIATE}..{MAX_DATA}")


class Ms2Server(SlaveService):
    """The connections of one slave application: as many as ``device.ms2`` says, 0 for a slave without MS2.

    With ``device.ms2_at_once`` the request itself gets the answer where it is known by then, not the poll after it;
    both are legal (docs/protocol.md#ms1).
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
