"""Addresses of servers: ``HOST:PORT`` to listen on, its sockets, and the ``Host`` and ``Origin`` of a request.

A page of a stranger's site can make a browser send requests to 127.0.0.1, and can give its own name that address (DNS
rebinding). So a request has to name this server by an IP address or by a name that is known to be its own, and a
WebSocket has to come from a page of this server.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from dpstack.errors import PortError, UsageError

_HOST: Final = "127.0.0.1"
_LISTEN: Final = re.compile(r"(?:(?P<host>\[[0-9a-fA-F:.]+(?:%\w+)?\]|[^:\[\]\s/]+):)?(?P<port>\d{1,5})")
_HOST_HEADER: Final = re.compile(r"(?P<host>\[[0-9a-fA-F:.]+\]|[^:\[\]\s/@]+)(?::(?P<port>\d{1,5}))?")
_BACKLOG: Final = 64


@dataclass(frozen=True, slots=True)
class Listen:
    """An address to listen on. ``port`` 0: any free one. ``option``: its name in messages."""

    host: str
    port: int
    option: str = "--listen"

    @classmethod
    def parse(cls, text: str, option: str = "--listen") -> Listen:
        """``HOST:PORT``, ``[::1]:PORT`` or ``PORT``. Raises UsageError."""
        found = _LISTEN.fullmatch(text)
        if found is None or int(found["port"]) > 0xFFFF:
            raise UsageError(f"{option} {text!r} is not HOST:PORT; write it as 127.0.0.1:8470, or [::1]:8470")
        return cls((found["host"] or _HOST).strip("[]"), int(found["port"]), option)

    def sockets(self) -> list[socket.socket]:
        """Listening sockets on all addresses of the host. Raises PortError if it has none, or the port is in use."""
        try:
            found = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        except (OSError, UnicodeError) as exc:
            raise PortError(f"{self.option} {self.host}: there is no such address ({_reason(exc)})") from None
        opened: list[socket.socket] = []
        port = self.port
        try:
            for family, kind, protocol, _, place in dict.fromkeys(found):
                one = socket.socket(family, kind, protocol)
                opened.append(one)
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    one.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                one.bind((place[0], port, *place[2:]))
                one.listen(_BACKLOG)
                one.setblocking(False)
                port = one.getsockname()[1]
        except OSError as exc:
            for one in opened:
                one.close()
            raise PortError(
                f"{self.option} {join(self.host, port)}: {_reason(exc)}; give another address, HOST:PORT"
            ) from None
        return opened


def is_local(sockets: Collection[socket.socket]) -> bool:
    """Whether only this computer reaches ``sockets``."""
    return all(ipaddress.ip_address(one.getsockname()[0].partition("%")[0]).is_loopback for one in sockets)


def join(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


class Origins:
    """The values of ``Host`` and ``Origin`` that belong to this server.

    ``names``: its names beside IP addresses and localhost; ``port``: that it listens on; ``secure``: over TLS.
    """

    def __init__(self, names: Collection[str], port: int, *, secure: bool) -> None:
        self._names = frozenset({"localhost", *(name.lower() for name in names)})
        self._port = port
        self._scheme, self._default = ("https", 443) if secure else ("http", 80)

    def is_own_host(self, header: str | None) -> bool:
        """Whether ``header``, the Host of a request, names this server."""
        found = _HOST_HEADER.fullmatch(header or "")
        if found is None or int(found["port"] or self._default) != self._port:
            return False
        host = found["host"].strip("[]").lower()
        return host in self._names or _is_ip(host)

    def is_own_origin(self, header: str | None, host: str | None) -> bool:
        """Whether ``header``, the Origin of a WebSocket, is a page of this server; ``host``: the request's own Host."""
        return self.is_own_host(host) and (header or "").lower() == f"{self._scheme}://{host}".lower()


def _is_ip(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _reason(exc: Exception) -> str:
    return str(getattr(exc, "strerror", None) or exc)
