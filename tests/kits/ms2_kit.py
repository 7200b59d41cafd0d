"""A class 2 master with slaves of octets that have MS2, and the ends of its connections.

The slave knows telegrams as numbers only; nothing of the project is used to read or to make them.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any

from octet_slave import DL, RS, SC, OctetSlave, sd1, sd2
from order_bus import MS, OrderBus
from ring_bus import Sent

from dpstack.dp.acyclic.queue import Acyclic
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.master.alarm_orders import CloseConnection, ConnectionOver
from dpstack.dpv1.master.ms2 import Ms2
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.pdu.read_write import Function
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.interface import RS_REPLY, SC_REPLY, Reply
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Resp, Telegram
from dpstack.params import BusParams
from dpstack.sim.world import World

#: what a server SAP answers to a PDU: octets of its own, None for none yet
Serve = Callable[[bytes], bytes | None]


def served(pdu: bytes) -> bytes | None:
    """A slave whose records hold their slot and index, and that sends back what is transported."""
    match pdu[0]:
        case 0x5E:
            return bytes((0x5E, pdu[1], pdu[2], 2, pdu[1], pdu[2]))
        case 0x5F:
            return pdu[:4]
        case 0x51:
            return pdu
        case 0x48:
            return b"\x48\x01"
    return b"\x58\x00\x12"


@dataclass
class Session:
    """One connection in the slave: what waits to be fetched, after so many polls."""

    waiting: list[tuple[int, bytes]] = field(default_factory=list)
    busy: bool = False
    closing: bool = False


def connections_of(acyclic: Acyclic) -> int:
    """Connections that slaves may hold for this master."""
    return sum(len(one.connections) for one in acyclic.providers if isinstance(one, Ms2))


@dataclass(kw_only=True)
class Ms2Server:
    """Server SAPs from 48 down, ``free`` of them; each answer is there at poll number ``polls``, or in the request
    itself (``direct``).

    ``serve`` answers PDUs, ``initiate`` answers at the server SAP. ``heard``: PDUs by SAP.
    """

    free: list[int] = field(default_factory=lambda: [48, 47])
    timeout: bytes = b"\x00\x0a"
    polls: int = 1
    direct: bool = False
    serve: Serve = served
    initiate: bytes = bytes.fromhex("57 F0 01 00 00 00 00 00 00 02 00 02 00 00 00 00")
    sessions: dict[int, Session] = field(default_factory=dict)
    given_out: list[bytes] = field(default_factory=list)
    heard: list[tuple[int, bytes]] = field(default_factory=list)

    def received(self, function: int) -> list[bytes]:
        """The PDUs with this function number, so far."""
        return [pdu for _, pdu in self.heard if pdu[:1] == bytes((function,))]

    def ms2(self, sap: int, pdu: bytes) -> bytes | None:
        """The answer at SAP 0..49: data, None for SC, empty for RS."""
        self.heard.append((sap, pdu))
        return self.manage(pdu) if sap == 49 else self.session(sap, pdu)

    def manage(self, pdu: bytes) -> bytes | None:
        """The resource manager; empty is RS."""
        if not pdu:
            return self.given_out.pop(0) if self.given_out else None
        assert pdu[0] == 0x57
        if not self.free:
            return b""
        sap = self.free.pop(0)
        self.sessions[sap] = Session([(self.polls, self.initiate)], closing=self.initiate[0] in (0x58, 0xD7))
        answer = bytes((0x56, sap)) + self.timeout
        if self.direct:
            return answer
        self.given_out.append(answer)
        return None

    def session(self, sap: int, pdu: bytes) -> bytes | None:
        """A server SAP."""
        session = self.sessions.get(sap)
        if session is None:
            return b""
        if not pdu:
            if not session.waiting:
                return None
            left, answer = session.waiting[0]
            if left > 1 and not self.direct:
                session.waiting[0] = (left - 1, answer)
                return None
            return self.fetched(sap, session)
        if pdu[0] == 0x58:
            self.drop(sap)
            return None
        if session.waiting or session.busy:
            session.waiting = [(0, b"\x58\x00\x11")]  # a second service at a time: ABT_SE
            return None
        answer_or_none = self.serve(pdu)
        if answer_or_none is None:
            session.busy = True
            return None
        session.waiting.append((self.polls, answer_or_none))
        return self.fetched(sap, session) if self.direct else None

    def fetched(self, sap: int, session: Session) -> bytes:
        _, answer = session.waiting.pop(0)
        if answer[0] == 0x58 or session.closing:
            self.drop(sap)
        return answer

    def drop(self, sap: int) -> None:
        del self.sessions[sap]
        self.free.append(sap)
        self.free.sort(reverse=True)


@dataclass
class OctetMs2Slave(OctetSlave, Ms2Server):
    """On a :class:`RingBus`; ``says`` (of the base class) replaces whole SAPs. ``mute``: it answers nothing."""

    mute: bool = False
    last: bytes = b""

    def __call__(self, octets: bytes, now: int) -> tuple[int, bytes] | None:
        if self.mute:
            return None
        if self.kept is None or octets != self.last:  # the same FCB: the kept answer once more
            self.kept, self.last = super().__call__(octets, now), octets
        return self.kept

    def service(self, octets: bytes) -> bytes | None:
        sa, dsap, ssap = octets[5] & 0x7F, octets[7], octets[8]
        if dsap > 49 or dsap in self.says:
            return super().service(octets)
        assert ssap == 50
        answer = self.ms2(dsap, octets[9:-2])
        if answer is None:
            return SC
        return sd2(sa, self.address, DL, 50, dsap, answer) if answer else sd1(sa, self.address, RS)

    def usual(self, octets: bytes) -> bytes | None:
        """Its answer without ``says``."""
        says, self.says = self.says, {}
        try:
            return self.service(octets)
        finally:
            self.says = says

    def says_first(self, times: int, sap: int, answer: bytes) -> list[bytes]:
        """``answer`` to the first ``times`` requests at ``sap``, which come into the list; then as usual."""
        answered: list[bytes] = []

        def say(octets: bytes) -> bytes | None:
            if not octets[9:-2] or len(answered) == times:
                return self.usual(octets)
            answered.append(octets)
            return answer

        self.says[sap] = say
        return answered


@dataclass
class Ms2Bus(OrderBus[OctetMs2Slave]):
    """Station 2 with nothing but class 2, its slaves at ``addresses``."""

    addresses: tuple[int, ...] = (4,)
    kind: type[OctetMs2Slave] = field(default=OctetMs2Slave, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.run(20)

    def order_open(self, address: int = 4, send_timeout_ns: int = 200 * MS, **more: Any) -> int:
        """Only give the order; its token."""
        token = self.next_token()
        self.send(OpenConnection(token, address, InitiateReq(send_timeout_ns), **more))
        return token

    def open(self, address: int = 4, **more: Any) -> InitiateDone:
        """The end of one Initiate."""
        return self.end_of(self.order_open(address, **more), InitiateDone)

    def order_read(
        self, connection: int, slot: int = 1, index: int = 2, length: int = 240, *, run_ms: int = 0, **more: Any
    ) -> int:
        """Only give the order, and run for ``run_ms``; its token."""
        token = self.next_token()
        self.send(RecordOrder(token, Function.READ, slot, index, length, connection=connection, **more))
        if run_ms:
            self.run(run_ms)
        return token

    def read(self, connection: int, slot: int = 1, index: int = 2, length: int = 240, **more: Any) -> RecordDone:
        """The end of one Read."""
        return self.end_of(self.order_read(connection, slot, index, length, **more), RecordDone)

    def write(self, connection: int, slot: int, index: int, data: bytes) -> RecordDone:
        """The end of one Write."""
        token = self.next_token()
        self.send(RecordOrder(token, Function.WRITE, slot, index, data=data, connection=connection))
        return self.end_of(token, RecordDone)

    def transport(self, connection: int, slot: int, index: int, data: bytes) -> RecordDone:
        """The end of one Data_Transport."""
        token = self.next_token()
        self.send(RecordOrder(token, Function.DATA_TRANSPORT, slot, index, data=data, connection=connection))
        return self.end_of(token, RecordDone)

    def close(self, connection: int) -> ConnectionOver:
        """The end of a connection."""
        self.send(CloseConnection(connection))
        return self.over(connection)

    def over(self, connection: int, ms: int = 20_000) -> ConnectionOver:
        """Run until the connection is over."""
        (one,) = self.until(lambda: [e for e in self.events_of(ConnectionOver) if e.connection == connection], ms)
        return one

    def lose_first(self, times: int, wanted: Callable[[Sent], bool]) -> list[Sent]:
        """The first ``times`` of the ``wanted`` telegrams, repetitions included, get lost: they come into the list."""
        lost: list[Sent] = []

        def drop(sent: Sent) -> bool:
            if len(lost) == times or not wanted(sent):
                return False
            lost.append(sent)
            return True

        self.bus.drop = drop
        return lost

    def lose(self, lost: Collection[int]) -> None:
        """Of the services' telegrams from now on, counted from 0, these get lost (repetitions count, tokens do not)."""
        count = itertools.count()
        self.bus.drop = lambda sent: sent.octets[0] in (0x68, 0xE5) and next(count) in lost

    def freed(self) -> None:
        """Run until nothing is left of connections, at either end."""
        self.until(lambda: not connections_of(self.acyclic) and not self.acyclic.waiting)
        for slave in self.slaves.values():
            assert slave.mute or not slave.sessions, "the slave keeps a connection"


def connected(**more: Any) -> Ms2Bus:
    """A bus with connection 1 to slave 4, opened with ``more``."""
    kit = Ms2Bus()
    kit.open(**more)
    return kit


class Ms2App(SlaveApp):
    """A slave of ours whose SAPs 0..49 are a :class:`Ms2Server`."""

    __slots__ = ("server",)

    server: Ms2Server

    def serve(self, request: Telegram, now: int) -> Reply | None:
        if request.dsap is None or request.dsap > 49:
            return super().serve(request, now)
        assert request.ssap == 50
        answer = self.server.ms2(request.dsap, request.data)
        if answer is None:
            return SC_REPLY
        return Reply(Resp.DL, answer) if answer else RS_REPLY


def ms2_in(world: World, address: int = 9, baud: int = 500_000) -> Ms2Server:
    """Such a slave in ``world``: ident 0x1234, an octet of inputs and one of outputs."""
    app = Ms2App(MirrorDevice(0x1234, bytes.fromhex("20 10")))
    app.server = Ms2Server()
    world.add(PassiveStation(address, app, BusParams.preset(baud)))
    return app.server


__all__ = [
    "DL",
    "MS",
    "RS",
    "SC",
    "Ms2Bus",
    "Ms2Server",
    "OctetMs2Slave",
    "Session",
    "connections_of",
    "ms2_in",
    "sd1",
    "sd2",
    "served",
]
