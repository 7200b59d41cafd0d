"""Base class of all ports: octets in and out of one line, without protocol and clock. The drivers wait for the line.

The constructor touches nothing. A port is opened, attached to an event loop (asyncio's, or the select loop of the bus
process) and closed; it may be opened again after a close or a loss. Reading and writing never block: a telegram that
the line does not accept at once is dropped and counted, because on a bus a stale telegram is worse than a lost one
(the link layer repeats).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import Final, Protocol

from dpstack.errors import BaudError, PortError
from dpstack.text import decimal
from dpstack.units import baud_text

#: Stands for the simulated bus where the name of a port is wanted.
VIRTUAL: Final = "virtual"
#: Called if octets that were delivered in the last this many ns may be damaged, as the port learns only now.
OnDoubt = Callable[[int], None]
#: Receives the octets read from the line, in order; called from the loop.
OnData = Callable[[bytes], None]
#: Called from the loop with the reason when the line is lost, once per :meth:`Port.attach`.
OnLost = Callable[[str], None]


class Delivery(Enum):
    """How late a port may deliver octets; drivers derive their time-outs from it."""

    HOST = "host"  # the other end is a process of this kind of machine: pty, socket
    ADAPTER = "adapter"  # a UART or a USB adapter


class Pending(Protocol):
    """The handle of a scheduled call."""

    def cancel(self) -> object: ...


class Loop(Protocol):
    """The methods that a port calls on the event loop it is attached to; asyncio's loops have them."""

    def add_reader(self, fd: int, callback: Callable[[], object], /) -> object: ...

    def remove_reader(self, fd: int, /) -> object: ...

    def call_soon(self, callback: Callable[[], object], /) -> Pending:
        """Call once, in the next iteration of the loop."""

    def call_soon_threadsafe(self, callback: Callable[[], object], /) -> object:
        """The same from another thread. Raises RuntimeError when the loop is closed."""

    def is_closed(self) -> bool: ...


class Port(ABC):
    """One line. ``name`` is what people call it, ``baud`` the rate in bit/s at which it is opened.

    ``paced``: octets need the time of a real wire. ``notices``: settings that failed and are tolerated, one line each,
    renewed by every :meth:`open`. ``dropped``: telegrams that the line did not accept, whole or in part.
    ``discarded``: octets that arrived faster than this computer could process them and were thrown away unread.
    """

    delivery: Delivery = Delivery.HOST
    #: what becomes of damaged octets, in words; known once it is open
    damaged_octets: str = "the port does not report damaged octets"
    #: writes octets and returns the number of those written; raises BlockingIOError, or one of ``_failures``
    _send: Callable[[bytes], int]
    _failures: tuple[type[Exception], ...] = (OSError,)
    #: opening it may take seconds
    connects = False
    #: set by the driver of the port; see :data:`OnDoubt`
    on_doubt: OnDoubt | None = None

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
        """Like :meth:`open`, for drivers without asyncio. Raises PortError if the port needs asyncio."""
        raise PortError(f'{self.name}: a port of this kind works with the asyncio driver only: set driver = "asyncio"')

    @abstractmethod
    def read_now(self) -> bytes:
        """The octets that have arrived and were not delivered yet. Never blocks, never raises."""

    def write(self, octets: bytes) -> bool:
        """Write a telegram; False when it was dropped (and counted). Never blocks, never raises."""
        try:
            if self._send(octets) == len(octets):
                return True
        except BlockingIOError:
            pass
        except self._failures as exc:
            self._lose_soon(reason_of(exc))
        return self._drop()

    @abstractmethod
    def close(self) -> None:
        """Detach and release the line. May be called at any time and again."""

    @abstractmethod
    def _start(self, loop: Loop) -> None: ...

    @abstractmethod
    def _stop(self, loop: Loop) -> None: ...

    @property
    def fd(self) -> int | None:
        """The file descriptor of the open line, if it has one that a loop can wait for."""
        return None

    def line_baud(self) -> int | None:
        """The rate of the line in bit/s (of a pty: the one its opener has set); None if the port cannot know it."""
        return None

    def damage(self) -> dict[str, int]:
        """Octets lost since the port was made, by cause, without zeros: damaged ones, as far as the port reports
        them from others, and ``discarded``.
        """
        return {"discarded": self.discarded} if self.discarded else {}

    def set_baud(self, baud: int) -> None:
        """Change the rate of the open line at once and drop unread octets.

        Raises BaudError if the line, or this kind of port, cannot do so: the old rate stays then.
        """
        raise BaudError(f"{self.name}: a port of this kind keeps the rate it was opened with; give the rate")

    def inspection(self) -> Callable[[], list[str]] | None:
        """A look at the open line for other programs that disturb it, which also mends what they have set: a function
        for a thread of its own, because it takes milliseconds. It returns one line for each disturbance. None: this
        kind of port has nothing to look at."""
        return None

    def attach(self, loop: Loop, on_data: OnData, on_lost: OnLost) -> None:
        """From now on, deliver octets to ``on_data`` from within ``loop``."""
        self.detach()
        self._on_data, self._on_lost = on_data, on_lost
        self._start(loop)
        self._loop = loop

    def detach(self) -> None:
        loop, self._loop = self._loop, None
        self._on_data = self._on_lost = None
        if loop is not None and not loop.is_closed():
            self._stop(loop)

    def release_after_fork(self) -> None:
        """In the child of a fork: release this copy. Line, settings and loop belong to the parent."""
        self._loop = None
        self._on_data = self._on_lost = None

    def pause_reading(self, paused: bool) -> bool:
        """Pause delivery (the system keeps what arrives) or resume it; False if this port cannot do so."""
        return not paused

    def _drop(self) -> bool:
        """Count a telegram that the line did not accept; always False."""
        self.dropped += 1
        return False

    def _not_open(self) -> BaudError:
        return BaudError(f"{self.name} is not open: its rate is set when it is opened")

    def _refuses(self, baud: int, why: object, framing: str = " 8E1") -> BaudError:
        return BaudError(f"{self.name} refuses {baud_text(baud)}{framing} ({why}): choose another rate or adapter")

    def _lose(self, reason: str) -> None:
        """Report the loss of the line, once."""
        on_lost = self._on_lost
        self.detach()
        if on_lost is not None:
            on_lost(reason)

    def _lose_soon(self, reason: str) -> None:
        """Like :meth:`_lose`, from within a call of the driver."""
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


def reason_of(exc: Exception) -> str:
    """The text of an error of the operating system."""
    return getattr(exc, "strerror", None) or str(exc) or type(exc).__name__
