"""Two ports joined in memory, in one event loop."""

from __future__ import annotations

from dpstack.errors import PortError
from dpstack.ports.base import Loop, Pending, Port

#: Octets in one direction before writes are dropped: as many as a pty holds.
CAPACITY = 22_000


class MemoryPort(Port):
    """One end; make both with :func:`memory_pair`. Octets for an end that is not open vanish, as on a wire."""

    def __init__(self, name: str, baud: int) -> None:
        super().__init__(name, baud, paced=False)
        self._peer: MemoryPort | None = None
        self._inbox = bytearray()
        self._is_open = False
        self._handle: Pending | None = None
        self._unplugged = ""

    def open_now(self) -> None:
        """Raises PortError while unplugged."""
        if self._unplugged:
            raise PortError(f"{self.name}: {self._unplugged}")
        self._inbox.clear()
        self._is_open = True

    def line_baud(self) -> int | None:
        return self._peer.baud if self._peer is not None and self._peer._is_open else None

    def set_baud(self, baud: int) -> None:
        self.baud = baud
        self._inbox.clear()

    def read_now(self) -> bytes:
        octets = bytes(self._inbox)
        self._inbox.clear()
        return octets

    def write(self, octets: bytes) -> bool:
        if not self._is_open or self._peer is None:
            return self._drop()
        return not self._peer._is_open or self._peer._take(octets) or self._drop()

    def close(self) -> None:
        self.detach()
        self._is_open = False
        self._inbox.clear()

    def unplug(self, reason: str = "unplugged") -> None:
        """Lose the line like an adapter that is pulled out; until :meth:`plug` it cannot be opened."""
        self._unplugged = reason
        self._is_open = False
        self._lose_soon(reason)

    def plug(self) -> None:
        self._unplugged = ""

    def _take(self, octets: bytes) -> bool:
        if len(self._inbox) + len(octets) > CAPACITY:
            return False
        self._inbox += octets
        if self._handle is None and self._loop is not None:
            self._handle = self._loop.call_soon(self._deliver)
        return True

    def _deliver(self) -> None:
        self._handle = None
        if self._inbox and self._on_data is not None:
            self._on_data(self.read_now())

    def _start(self, loop: Loop) -> None:
        if self._inbox:
            self._handle = loop.call_soon(self._deliver)

    def _stop(self, loop: Loop) -> None:
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None


def memory_pair(baud: int, *, names: tuple[str, str] = ("memory:a", "memory:b")) -> tuple[MemoryPort, MemoryPort]:
    """Two ends of one line at ``baud`` bit/s."""
    one, other = MemoryPort(names[0], baud), MemoryPort(names[1], baud)
    one._peer, other._peer = other, one
    return one, other
