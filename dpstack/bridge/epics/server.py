"""Sockets of Channel Access: searches over UDP, beacons, connections over TCP.

caproto's own server was tried and left: if the port is taken it listens on another one without a word; it sends
beacons to 255.255.255.255 unless the environment forbids it; EPICS_CA_NAME_SERVERS does not find it; its clients have
no bounds. Its protocol core has no sockets, and is used here.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, Final, cast

import caproto as ca

from dpstack.bridge.epics.circuit import Circuit, Plant, version_answer
from dpstack.bridge.epics.variables import Variable
from dpstack.bridge.processor_share import ProcessorShare
from dpstack.errors import ConfigError, PortError

#: connections: in all, and from one address
MOST_CONNECTIONS: Final = 100
MOST_OF_ONE: Final = 50
#: s between two beacons: at the begin, and later
_FIRST_BEACON_S: Final = 0.02
_LAST_BEACON_S: Final = 15.0
#: port of beacons
BEACON_PORT: Final = 5065
#: octets of a datagram with searches
_MOST_DATAGRAM: Final = 2048
#: s of processor that searches may owe; those beyond it are left out, and clients repeat them
_MOST_DEBT_S: Final = 0.1
_VERSION: Final = ca.DEFAULT_PROTOCOL_VERSION


def beacon_address(text: str) -> tuple[str, int]:
    """``HOST`` or ``HOST:PORT`` of IPv4. Raises ConfigError."""
    host, _, port = text.partition(":")
    try:
        address = str(ipaddress.IPv4Address(host))
        number = int(port or BEACON_PORT)
    except ValueError:
        number = 0
    if not 0 < number <= 0xFFFF:
        raise ConfigError(f'beacons: {text!r} is not an address; write for instance "192.168.7.255"')
    return address, number


class Server:
    """``sockets``: listen on IPv4. ``beacons``: the addresses that get them. ``cut_off``: called with the address of
    a client and the reason if it is cut off."""

    def __init__(
        self, plant: Plant, sockets: Sequence[socket.socket], *,
        beacons: Sequence[tuple[str, int]] = (), cut_off: Callable[[str, str], object],
    ) -> None:  # fmt: skip
        self.share = ProcessorShare()
        self.port = int(sockets[0].getsockname()[1])
        self._plant = plant
        self.beacons = tuple(beacons)
        self._cut_off = cut_off
        self._sockets = list(sockets)
        self._search_sockets: list[socket.socket] = []
        self._listening: list[asyncio.Server] = []
        self._searches: list[asyncio.DatagramTransport] = []
        self._circuits: dict[asyncio.Task[None], Circuit] = {}
        self._of: Counter[str] = Counter()
        self._beaconing: asyncio.Task[None] | None = None

    @property
    def circuits(self) -> tuple[Circuit, ...]:
        return tuple(self._circuits.values())

    def bind(self) -> None:
        """Take the UDP ports of the searches, those of the sockets. Raises PortError."""
        for one in self._sockets:
            host, port = one.getsockname()[:2]
            search = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._search_sockets.append(search)
            try:
                search.setblocking(False)
                search.bind((host, port))
            except OSError as error:
                why = error.strerror or error
                raise PortError(f"[epics] listen {host}:{port} (UDP): {why}; give another port") from None

    async def begin(self) -> None:
        loop = asyncio.get_running_loop()
        for one in self._sockets:
            self._listening.append(await asyncio.start_server(self._serve, sock=one))
        for search in self._search_sockets:
            transport, _ = await loop.create_datagram_endpoint(lambda: _Searches(self), sock=search)
            self._searches.append(transport)
        if self.beacons:
            self._beaconing = asyncio.create_task(self._send_beacons(), name="dpstack epics: beacons")

    async def flush(self) -> None:
        """Send the last values to all clients."""
        await asyncio.gather(*(circuit.flush() for circuit in self.circuits))

    def end(self) -> None:
        """Close everything at once. May be repeated."""
        if self._beaconing is not None:
            self._beaconing.cancel()
        for server in self._listening:
            server.close()
        for transport in self._searches:
            transport.close()
        for one in (*self._sockets, *self._search_sockets):
            one.close()
        for task in self._circuits:
            task.cancel()

    def drop(self, is_gone: Callable[[Variable], bool]) -> None:
        """End the channels of variables that are gone."""
        for circuit in self.circuits:
            circuit.drop(is_gone)

    def answer(self, octets: bytes, address: Any) -> bytes:
        """The answer to a datagram of searches; empty without one."""
        broadcaster = ca.Broadcaster(ca.SERVER)
        commands = broadcaster.recv(octets, address)
        broadcaster.process_commands(commands)
        found = [
            ca.SearchResponse(self.port, None, command.cid, _VERSION)
            for command in commands
            if isinstance(command, ca.SearchRequest) and self._plant.knows(command.name)
        ]
        if not found:
            return b""
        versions = [version_answer(one) for one in commands if isinstance(one, ca.VersionRequest)]
        return bytes(broadcaster.send(*versions[:1], *found))

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = writer.get_extra_info("peername")
        address = str(peer[0]) if peer else ""
        if not peer or len(self._circuits) >= MOST_CONNECTIONS or self._of[address] >= MOST_OF_ONE:
            self._cut_off(address, "there are too many connections")
            writer.transport.abort()
            return
        with contextlib.suppress(OSError):
            sock = writer.get_extra_info("socket")
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)  # a computer that is gone says nothing
        circuit = Circuit(
            reader, writer, plant=self._plant, share=self.share, port=self.port,
            cut_off=lambda why: self._cut_off(address, why),
        )  # fmt: skip
        task = asyncio.current_task()
        assert task is not None
        self._circuits[task] = circuit
        self._of[address] += 1
        try:
            await circuit.run()
        except asyncio.CancelledError:
            return  # the end of the server: asyncio would report it as an error
        finally:
            del self._circuits[task]
            self._of -= Counter((address,))

    async def _send_beacons(self) -> None:
        pause = _FIRST_BEACON_S
        number = 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            out.setblocking(False)
            out.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            while True:
                for host, port in self.beacons:
                    beacon = ca.Beacon(_VERSION, self.port, number, "0.0.0.0")
                    with contextlib.suppress(OSError):  # nobody listens, or the network is away
                        out.sendto(bytes(beacon), (host, port))
                number = (number + 1) & 0xFFFF_FFFF
                await asyncio.sleep(pause)
                pause = min(2 * pause, _LAST_BEACON_S)


class _Searches(asyncio.DatagramProtocol):
    def __init__(self, server: Server) -> None:
        self._server = server
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.DatagramTransport", transport)  # that of asyncio is no instance before 3.12

    def datagram_received(self, data: bytes, addr: Any) -> None:
        if self._transport is None or len(data) > _MOST_DATAGRAM or self._server.share.debt > _MOST_DEBT_S:
            return
        begun = time.thread_time()
        with contextlib.suppress(Exception):  # of a program that speaks something else; nobody waits for an answer
            if answer := self._server.answer(data, addr):
                self._transport.sendto(answer, addr)
        self._server.share.spent(time.thread_time() - begun)
