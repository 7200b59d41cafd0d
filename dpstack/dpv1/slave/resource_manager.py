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

from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave.events import Report
from dpstack.dp.slave.extension import Handler, SlaveService
from dpstack.dpv1.pdu.ms2 import MAX_REASON, SERVER_SAPS, ResourceManagerRes
from dpstack.dpv1.slave.ms2_connection import ServerConnection
from dpstack.dpv1.slave.ms2_states import State
from dpstack.dpv1.slave.record_requests import AcyclicDevice, Asker
from dpstack.dpv1.timeouts import least_send_timeout
from dpstack.errors import UsageError
from dpstack.fdl.interface import SC_REPLY, Reply
from dpstack.fdl.telegram import SAP_MS2_RM, Resp, Telegram
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


@dataclass(slots=True)
class _Offer:
    connection: ServerConnection
    fetched: bool = False


class Ms2Server(SlaveService):
    """The connections of one slave application: as many as ``device.ms2`` says, 0 for a slave without MS2.

    With ``device.ms2_at_once`` the request itself gets the answer where it is known by then, not the poll after it;
    both are legal (docs/protocol.md#ms1).
    """

    __slots__ = ("_connections", "_device", "_free", "_offers", "_report", "at")

    def __init__(self, device: AcyclicDevice, report: Report) -> None:
        self.at = NEVER
        self._device = device
        self._report = report
        self._connections: dict[int, ServerConnection] = {}
        self._free = deque(SERVER_SAPS[::-1][: device.ms2])
        self._offers: dict[tuple[int, int | None], list[_Offer]] = {}

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
        """How many can be given out now."""
        return self._device.ms2 - len(self.connections)

    def handlers(self) -> dict[int | None, Handler]:
        """The resource manager, and the server SAPs."""
        return {**dict.fromkeys(SERVER_SAPS, self._serve), SAP_MS2_RM: self._manage}

    def _send_timeout(self) -> int:
        return least_send_timeout(self._report.baud)

    # --- SAP 49 ---------------------------------------------------------------------------------------------------

    def _manage(self, request: Telegram, now: int) -> Reply | None:
        """A request to the resource manager, or a poll (no octets); None for RS."""
        octets, sa, ssap = request.data, request.sa, request.ssap
        if not self._device.ms2:
            return None
        if not octets:
            return self._offered(sa, ssap)
        for offer in list(self._offers.get((sa, ssap), ())):
            if offer.connection.state is State.OVER:
                self._take_back(offer.connection, now)  # what was wrong with an earlier Initiate is no answer to this
        sap = self._next(sa, ssap, now)
        if sap is None:
            return None
        connection = ServerConnection(Asker(sa, sap), ssap, self._send_timeout(), self._device, self._report, now)
        self._connections[sap] = connection
        self._offers.setdefault((sa, ssap), []).append(_Offer(connection))
        connection.initiate(octets, now)
        self._watch(connection)
        return self._offered(sa, ssap) if self._device.ms2_at_once else SC_REPLY

    def _offered(self, sa: int, ssap: int | None) -> Reply:
        offers = self._offers.get((sa, ssap))
        if not offers:
            return SC_REPLY
        offer = next((one for one in offers if not one.fetched), offers[-1])
        offer.fetched = True
        manager = ResourceManagerRes(offer.connection.asker.sap, self._send_timeout())
        return Reply(Resp.DL, manager.build())

    def _next(self, sa: int, ssap: int | None, now: int) -> int | None:
        """A server SAP that is free, or one that nobody uses: its Abort, or what the manager said, was not fetched."""
        if not self._free:
            unused = [one for one in self._connections.values() if one.state is State.OVER]
            unused += [offer.connection for offer in self._offers.get((sa, ssap), ()) if not offer.fetched]
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
        self._forget_offer(connection)
        if octets:
            connection.take(octets, now)
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
        """Every connection is over, without an Abort: nobody could fetch it."""
        for connection in list(self._connections.values()):
            connection.end(why, now)
            self._give_back(connection)
        self._offers.clear()
        self.at = NEVER

    def _watch(self, connection: ServerConnection) -> None:
        if not connection.free:
            self.at = min(self.at, connection.deadline)

    def _give_back(self, connection: ServerConnection) -> None:
        """Give back what is free, and forget its offer."""
        sap = connection.asker.sap
        if not connection.free or self._connections.get(sap) is not connection:
            return
        del self._connections[sap]
        self._free.append(sap)
        self._forget_offer(connection)

    def _forget_offer(self, connection: ServerConnection) -> None:
        """Its Resource_Manager PDU is not wanted any more."""
        whose = (connection.asker.master, connection.ssap)
        offers = self._offers.get(whose)
        if offers is None:
            return
        offers[:] = [one for one in offers if one.connection is not connection]
        if not offers:
            del self._offers[whose]


def ms2_of(app: SlaveApp) -> Ms2Server:
    """The connections of a slave application whose device has MS2."""
    return next(one for one in app.services if isinstance(one, Ms2Server))
