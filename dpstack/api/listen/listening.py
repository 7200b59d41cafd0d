"""The transmissions of a line, from an own port or from the tap of a running program. Nothing is ever sent."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic_ns, time_ns
from typing import Final

from dpstack.api.control.client import ControlClient, connect
from dpstack.api.listen.program_tap import ProgramTap
from dpstack.api.listen.tap_cutter import OctetsLost
from dpstack.capture.listener import Listener, OnTransmission
from dpstack.capture.timing import ADAPTER, HOST, TAP, LineTiming, timing_of
from dpstack.drivers.line.asyncio_runtime import AsyncioRuntime
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.port_latency import patience_of
from dpstack.drivers.line.rate import settle_ns_of
from dpstack.errors import BusError, DpError, PortError, UsageError
from dpstack.fdl.baud_search import BaudFound
from dpstack.ports import Delivery, open_port
from dpstack.ports.base import VIRTUAL
from dpstack.trace import Event
from dpstack.units import BAUD_RATES

__all__ = ["PORT_LOSSES", "BaudFound", "ListenedLine", "Listening", "OctetsLost"]

#: pause in s before the next attempt to find the program that held the port
_AGAIN_S: Final = 0.5
#: causes in :meth:`Listening.damage` of octets that are missing: overruns of UART and driver, and thrown away unread
PORT_LOSSES: Final = ("overrun", "buf_overrun", "discarded")


_DROPPED: Final = "the program that holds the port drops octets that the port marks as damaged"


@dataclass(frozen=True, slots=True)
class ListenedLine:
    """The line that is listened to. ``port``: its name; ``program``: the kind of dpstack program that holds it ("run",
    "sim", "segment"), None for an own port. ``baud`` in bit/s, None while the rate is searched.

    ``source``: "tap" (the times of a program of ours), "host" (octets come from another process: a pty, a socket) or
    "adapter" (a UART or a USB adapter). ``paced``: octets take their time on a wire; otherwise the times are those of
    the computer.
    """

    port: str
    source: str
    program: str | None
    baud: int | None
    paced: bool
    #: the times are those of a simulated wire
    exact: bool = False
    #: what becomes of damaged octets, in words
    damaged: str = ""

    @property
    def timing(self) -> LineTiming:
        """How finely the transmissions are timed, at the slowest rate if the rate is not known yet."""
        return timing_of(self.source, self.baud or BAUD_RATES[0], exact=self.exact)


class Listening:
    """Listens on ``port`` while it is entered (``async with``): through the ``run``, ``sim`` or ``segment`` that holds
    it, else on the port itself, at ``baud`` bit/s (None: the rate is found by listening).

    ``on_transmission`` gets each transmission, ``on_event`` :class:`BaudFound`, :class:`PortLost`, :class:`PortBack`,
    notices, :class:`OctetsLost`. ``own`` False: only through a program, the port itself is never opened. Entering
    raises PortError if the port cannot be opened, UsageError for a port that has no wire.
    """

    def __init__(
        self,
        port: str,
        baud: int | None,
        on_transmission: OnTransmission,
        on_event: Callable[[Event], None] = lambda event: None,
        *,
        own: bool = True,
    ) -> None:
        self.port = port
        self._own = own
        self._baud = baud
        self._on_transmission = on_transmission
        self._on_event = on_event
        self._line: ListenedLine | None = None
        self._listener: Listener | None = None
        self._runtime: AsyncioRuntime | None = None
        self._tap: ProgramTap | None = None
        self._reading: asyncio.Task[None] | None = None
        self._failed: asyncio.Future[None] | None = None

    @property
    def line(self) -> ListenedLine:
        """The line, once it is entered."""
        tap = self._tap
        if tap is not None:
            return ListenedLine(self.port, TAP, tap.program, tap.baud, tap.paced, tap.exact, _DROPPED)
        assert self._line is not None
        if self._listener is None or self._line.baud == self._listener.found:
            return self._line
        self._line = dataclasses.replace(self._line, baud=self._listener.found)
        return self._line

    async def __aenter__(self) -> Listening:
        self._failed = asyncio.get_running_loop().create_future()
        client = _program_on(self.port)
        if client is None:
            if not self._own:
                raise PortError(f"{self.port}: no program of yours holds it")
            await self._open_own()
        else:
            await self._open_tap(client)
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._reading is not None:
            self._reading.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await self._reading
        if self._tap is not None:
            await self._tap.close()
        if self._runtime is not None:
            await self._runtime.close()
        if self._failed is not None and self._failed.done() and not self._failed.cancelled():
            self._failed.exception()  # whoever waits for the end has got it

    async def ended(self) -> None:
        """Wait for the end of the line. An own port that vanishes is opened again. Raises PortError when the program
        that held the port has ended, BusError for a defect."""
        assert self._failed is not None
        await asyncio.shield(self._failed)

    def damage(self) -> dict[str, int]:
        """Octets that an own port has lost or marked as damaged, by cause, as far as it counts them."""
        return {} if self._runtime is None else {k: v for k, v in self._runtime.damage().items() if v}

    # --- an own port ---
    async def _open_own(self) -> None:
        if self.port in (VIRTUAL, "pty"):
            raise UsageError(f'no program of yours holds the port "{self.port}", and nobody else can be on it')
        port = open_port(self.port, self._baud or BAUD_RATES[0], listen=True)
        self._listener = Listener(
            monotonic_ns(),
            self._on_transmission,
            baud=self._baud,
            epoch_ns=time_ns() - monotonic_ns(),
            slack_ns=patience_of(port).known_ns,
            settle_ns=settle_ns_of(port),
        )
        self._runtime = AsyncioRuntime(
            port, self._listener, self._on_events, echo=Echo.OFF, on_failure=self._on_failure
        )
        await self._runtime.open()
        source = ADAPTER if port.delivery is Delivery.ADAPTER else HOST
        self._line = ListenedLine(
            self._runtime.port_name, source, None, self._baud, self._runtime.paced, damaged=port.damaged_octets
        )

    def _on_events(self, events: list[Event]) -> None:
        for event in events:
            self._on_event(event)

    def _on_failure(self, error: Exception) -> None:
        self._fail(BusError(f"listening was stopped by a defect in dpstack ({type(error).__name__}: {error})"))

    def _fail(self, error: Exception) -> None:
        if self._failed is not None and not self._failed.done():
            self._failed.set_exception(error)

    # --- the tap of a program ---
    async def _open_tap(self, client: ControlClient) -> None:
        tap = ProgramTap(client, self._on_transmission, self._on_event)
        await tap.open()
        self._tap = tap
        self._reading = asyncio.create_task(self._read_tap(tap))

    async def _read_tap(self, tap: ProgramTap) -> None:
        try:
            await tap.read()
        except DpError as error:
            self._fail(error)
        except Exception as error:
            self._on_failure(error)


async def keep_listening(
    make: Callable[[bool], Listening], begin: Callable[[Listening], None], interrupt: Callable[[str], None]
) -> None:
    """Listen for ever: if the program that held the port ends, wait until one holds it again.

    ``make``: a new :class:`Listening`; its argument is ``own``. ``begin`` is called with each one that is entered,
    ``interrupt`` with the reason when it has ended. Raises PortError for an own port, and if the first one cannot be
    entered; UsageError.
    """
    program: str | None = None
    first = True
    while True:
        listening = make(first)
        entered = False
        try:
            async with listening:
                program, first, entered = listening.line.program, False, True
                begin(listening)
                await listening.ended()
        except PortError as error:
            if program is None:
                raise
            if entered:
                interrupt(str(error))
        await asyncio.sleep(_AGAIN_S)


def _program_on(port: str) -> ControlClient | None:
    """A connection to the program that holds ``port``; None without one. Raises UsageError if there are
    several."""
    try:
        return connect(port)
    except PortError:
        return None
