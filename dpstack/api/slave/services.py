"""Pending acyclic services of a bus: requests, results, cancellation."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
from collections import defaultdict
from collections.abc import Awaitable, Callable
from typing import Protocol, TypeVar

from dpstack.api.slave.alarms import AlarmListeners
from dpstack.api.slave.service_errors import error_of
from dpstack.dp.acyclic.job import CancelService, ServiceEnd, ServiceFailure
from dpstack.dp.master.events import ControlFailed, ControlSent, PictureTaken
from dpstack.dp.master.scanner import ScanDone
from dpstack.dpv1.master.alarm_orders import CloseConnection, ConnectionOver, ConnectionsClosed
from dpstack.errors import BusError, DpError, UsageError
from dpstack.text import brief
from dpstack.trace import Event
from dpstack.units import s_to_ns

E = TypeVar("E", bound=Event)
D = TypeVar("D", bound=ServiceEnd)


class TokenOrder(Protocol):
    """An order whose end is an event with the same ``token``."""

    @property
    def token(self) -> int: ...


def time_of(seconds: float, what: str = "timeout") -> int:
    """A timeout of the user in ns. Raises UsageError unless it is a number of seconds from 0 on."""
    if isinstance(seconds, bool) or not isinstance(seconds, (int, float)) or not 0 <= seconds < math.inf:
        raise UsageError(f"{what} = {brief(seconds)} is no time for a service: seconds are wanted, 0 or more")
    return s_to_ns(seconds)


class ConnectionEnd:
    """The end of a class 2 connection. ``over``: its event; ``lost``: the error of a bus that ended before."""

    def __init__(self) -> None:
        self.over: ConnectionOver | None = None
        self.lost: DpError | None = None
        self.ended = asyncio.Event()


class Services:
    """The pending services, class 2 connections and alarm listeners of one bus."""

    def __init__(
        self,
        command: Callable[[object], None],
        order: Callable[[object], Awaitable[None]],
        is_open: Callable[[], bool],
        load_layouts: Callable[[], Awaitable[None]],
    ) -> None:
        self._command = command
        self._order = order
        self._is_open = is_open
        self._load_layouts = load_layouts
        self._tokens = itertools.count(1)
        self._waiting: dict[int, tuple[asyncio.Future[Event], tuple[type[Event], ...]]] = {}
        #: class 2 connections by the token that opened them
        self.connections: dict[int, ConnectionEnd] = {}
        self.alarms = AlarmListeners(command)
        #: of the slave at each address, see :class:`~dpstack.api.slave.records.RecordWay`
        self.im_calls: defaultdict[int, asyncio.Lock] = defaultdict(asyncio.Lock)

    def token(self) -> int:
        return next(self._tokens)

    async def do(self, order: TokenOrder, kind: type[D], cancel: object = None) -> D:
        """Order a service and wait for its end, an event of ``kind``. Raises the exception of a failure
        (:mod:`dpstack.api.slave.service_errors`).

        ``cancel``: the order that is sent when the caller is cancelled (default CancelService).
        """
        await self._load_layouts()
        try:
            done = await self.answer_to(order, kind)
        except asyncio.CancelledError:
            with contextlib.suppress(DpError):  # the bus may have ended meanwhile
                self._command(CancelService(order.token) if cancel is None else cancel)
            raise
        if done.outcome.failure is not None:
            if done.outcome.failure is ServiceFailure.CLOSED and not self._is_open():  # no fault of the slave
                raise BusError(f"this bus was closed: {done.outcome.text}")
            raise error_of(done.address, done.title, done.outcome, done.record)
        return done

    async def answer_to(self, order: TokenOrder, *kinds: type[E]) -> E:
        """Give the ``order`` and wait for its answer: an event of one of ``kinds``."""
        future: asyncio.Future[Event] = asyncio.get_running_loop().create_future()
        self._waiting[order.token] = future, kinds
        try:
            await self._order(order)
            event = await future
        finally:
            del self._waiting[order.token]
            if future.done() and not future.cancelled():
                future.exception()  # asyncio reports one that nobody has asked for: the order may have failed before
        assert isinstance(event, kinds)
        return event

    def resolve(self, token: int, event: Event) -> None:
        """``event`` answers the order with ``token``, if a caller still waits for it."""
        if (waiting := self._waiting.get(token)) is not None:
            future, kinds = waiting
            if isinstance(event, kinds) and not future.done():
                future.set_result(event)

    def close_connection(self, token: int, ending: ConnectionEnd) -> None:
        """End the connection that ``token`` opened, unless ``ending`` says that it has ended."""
        if self._is_open() and not ending.ended.is_set():
            with contextlib.suppress(DpError):  # the bus may have ended meanwhile
                self._command(CloseConnection(token))

    def handle_event(self, event: Event) -> bool:
        """Returns True for the end of a service, an event for its caller only."""
        if isinstance(event, ConnectionOver):
            ending = self.connections.pop(event.connection, None)
            if ending is not None:
                ending.over = event
                ending.ended.set()
            return False  # all readers get this event, too
        if isinstance(event, ConnectionsClosed):
            return True
        if not isinstance(event, ServiceEnd | ControlSent | ControlFailed | PictureTaken | ScanDone):
            return self.alarms.handle_event(event)
        self.resolve(event.token, event)
        return isinstance(event, ServiceEnd) or (isinstance(event, ScanDone) and event.token != 0)

    def end(self, error: DpError) -> None:
        """Pending services and connections end with ``error``."""
        for future, _ in self._waiting.values():
            if not future.done():
                future.set_exception(error)
        for ending in self.connections.values():
            ending.lost = error
            ending.ended.set()
        self.connections.clear()
        self.alarms.end(error)
