"""What every port offers: octets in and out of one line. No protocol and no clock; waiting is the driver's.

A port is made (cheap, touches nothing), opened, attached to an event loop (asyncio's, or the plain one of the bus
process), and closed; it may be opened again after a close or a loss. Reading and writing never block: a telegram that
the line does not take at once is dropped and counted, because on a bus a stale telegram is worse than a lost one (the
link layer repeats).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import Protocol

from dpstack.errors import BaudError, PortError
from dpstack.text import decimal

#: Takes octets read from the line, in order; called from the loop.
OnData = Callable[[bytes], None]
#: Told once per :meth:`Port.attach` when the line vanished, with the reason; called from the loop.
OnLost = Callable[[str], None]


class Delivery(Enum):
    """How late a port may deliver; drivers derive their patience from it."""

    HOST = "host"  # the other end is a process of this kind of machine: pty, socket, memory
    ADAPTER = "adapter"  # a UART or a USB adapter


class Pending(Protocol):
    """A call that was asked for."""

    def cancel(self) -> object: ...


class Loop(Protocol):
    """What a port needs of the loop it hands over in; asyncio's loops have it."""

    def add_reader(self, fd: int, callback: Callable[[], object], /) -> object:
        """Call back whenever ``fd`` is readable."""

    def remove_reader(self, fd: int, /) -> object: ...

    def call_soon(self, callback: Callable[[], object], /) -> Pending:
        """Call once, at the loop's next turn."""

    def call_soon_threadsafe(self, callback: Callable[[], object], /) -> object:
        """The same from another thread. Raises RuntimeError when the loop is closed."""

    def is_closed(self) -> bool:
        """Whether it will never run again."""


class Port(ABC):
    """One line. ``name`` is what people call it, ``baud`` the rate in bit/s it is opened at.

    ``paced``: octets take their time on a wire. ``notices``: what could not be set and is tolerated, one line each,
    made anew by every :meth:`open`. ``dropped``: telegrams that the line did not take, whole or in part. ``discarded``:
    octets that arrived faster than this computer could look at them and were thrown away unread.
    """

    delivery: Delivery = Delivery.HOST
    #: opening it may take seconds
    connects = False

    def __init__(self, name: str, baud: int, *, paced: bool) -> None:
        self.name = name
        self.baud = baud
        self.paced = paced
        self.notices: list[str] = []
        self.dropped = 0
        self.discarded = 0
        self._loop: Loop | None = None
        self._on_data: OnData | None = None
        self._on_lost: OnLost | None = None

    async def open(self) -> None:
        """Open the line, empty of old octets. Raises PortError with one line that says what to do."""
        self.open_now()

    def open_now(self) -> None:
        """As :meth:`open`, for drivers without asyncio. A kind of port that needs asyncio refuses with PortError."""
        raise PortError(f'{self.name}: a port of this kind works with the asyncio driver only: set driver = "asyncio"')

    @abstractmethod
    def read_now(self) -> bytes:
        """What has arrived and was not handed over yet; empty when there is nothing. Never blocks, never raises."""

    @abstractmethod
    def write(self, octets: bytes) -> bool:
        """Put a telegram on the line; False when it was dropped (counted). Never blocks, never raises."""

    @abstractmethod
    def close(self) -> None:
        """Detach and release the line. May be called at any time and again."""

    @abstractmethod
    def _start(self, loop: Loop) -> None: ...

    @abstractmethod
    def _stop(self, loop: Loop) -> None: ...

    @property
    def fd(self) -> int | None:
        """The file descriptor of the open line where it has one that can be waited for."""
        return None

    def line_baud(self) -> int | None:
        """The rate the line runs at as far as the port can see (a pty: what its opener set); None when it cannot."""
        return None

    def damage(self) -> dict[str, int]:
        """Octets that arrived and are lost since the port was made, by cause, zeros left out.

        Damaged ones as far as the port can tell them from others, and ``discarded``.
        """
        return {"discarded": self.discarded} if self.discarded else {}

    def set_baud(self, baud: int) -> None:
        """Change the rate of the open line at once; what was received before and not read is gone.

        Raises BaudError where the line, or this kind of port, cannot: the old rate stays then.
        """
        raise BaudError(f"{self.name}: a port of this kind keeps the rate it was opened with; give the rate")

    def attach(self, loop: Loop, on_data: OnData, on_lost: OnLost) -> None:
        """Hand over what arrives from now on, from within ``loop``."""
        self.detach()
        self._on_data, self._on_lost = on_data, on_lost
        self._start(loop)
        self._loop = loop

    def detach(self) -> None:
        loop, self._loop = self._loop, None
        self._on_data = self._on_lost = None
        if loop is not None and not loop.is_closed():
            self._stop(loop)

    def forsake(self) -> None:
        """In the child of a fork: let go. The line, its settings and the loop stay the parent's and are not touched."""
        self._loop = None
        self._on_data = self._on_lost = None

    def hush(self, quiet: bool) -> bool:
        """Hand over nothing for a while (the system keeps what arrives), or again; whether this port does as asked."""
        return not quiet

    def _lose(self, reason: str) -> None:
        """The line vanished: tell it once."""
        on_lost = self._on_lost
        self.detach()
        if on_lost is not None:
            on_lost(reason)

    def _lose_soon(self, reason: str) -> None:
        """As :meth:`_lose`, from within a call of the driver."""
        if self._loop is not None:
            self._loop.call_soon(partial(self._lose, reason))


def host_and_port(name: str, scheme: str) -> tuple[str, int]:
    """Host and TCP port of ``scheme://host:port``. Raises PortError."""
    host, colon, number = name.removeprefix(f"{scheme}://").partition("?")[0].rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    port = decimal(number)
    if not colon or not host or port is None or not 0 < port < 65_536:
        raise PortError(f"{name}: write it as {scheme}://host:port, for instance {scheme}://192.168.0.10:7000")
    return host, port
