"""``socket://host:port``: a serial line behind a TCP server (ser2net, an Ethernet-to-serial converter).

pyserial has a handler for these URLs, but under pyserial-asyncio it writes one loop turn late, leaves Nagle's algorithm
on (a short telegram waits for the acknowledgement of the one before, 40 ms) and sleeps 0.3 s in ``close`` within
the loop. So the socket is used directly, as the descriptor of a tty is. It only connects, it never listens.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Iterator

from dpstack.errors import PortError
from dpstack.ports.base import host_and_port, reason_of
from dpstack.ports.fdport import FdPort

_CONNECT_S = 5.0


class SocketPort(FdPort):
    """A TCP connection that carries the octets of a line. Its rate is set at the far end, not from here."""

    connects = True

    def __init__(self, name: str, baud: int, *, paced: bool = False) -> None:
        super().__init__(name, baud, paced=paced)
        self._address = host_and_port(name, "socket")
        self._socket: socket.socket | None = None

    async def open(self) -> None:
        """Connect. Raises PortError."""
        self.close()
        host, port = self._address
        with self._connecting():
            async with asyncio.timeout(_CONNECT_S):
                self._socket = await _connect(host, port)
        self._connected()

    def open_now(self) -> None:
        """Connect; blocks for up to 5 s. Raises PortError."""
        self.close()
        with self._connecting():
            self._socket = socket.create_connection(self._address, _CONNECT_S)
            self._socket.setblocking(False)
        self._connected()

    @contextlib.contextmanager
    def _connecting(self) -> Iterator[None]:
        try:
            yield
        except TimeoutError:
            raise PortError(f"{self.name}: no answer within {_CONNECT_S:g} s; is the server switched on?") from None
        except OSError as exc:
            raise PortError(
                f"{self.name}: cannot connect ({reason_of(exc)}); is the server running and the port number right?"
            ) from None

    def _connected(self) -> None:
        assert self._socket is not None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._fd = self._socket.fileno()
        self._read, self._send = self._socket.recv, self._socket.send
        self.notices = [f"the far end must be set to {self.baud} bit/s 8E1 itself"]

    def _close_fd(self, fd: int) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


async def _connect(host: str, port: int) -> socket.socket:
    loop = asyncio.get_running_loop()
    failure: OSError | None = None
    for family, kind, proto, _name, address in await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        connecting = socket.socket(family, kind, proto)
        try:
            connecting.setblocking(False)
            await loop.sock_connect(connecting, address)
            return connecting
        except OSError as exc:
            connecting.close()
            failure = exc
        except BaseException:
            connecting.close()
            raise
    raise failure or OSError("the name has no address")
