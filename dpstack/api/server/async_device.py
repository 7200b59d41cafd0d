"""Records and alarms of a slave that async functions serve: each request is a task, whose end answers it.

An alarm is raised from async code; it is over when its master has acknowledged it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Sequence
from typing import TypeVar

from dpstack.dp.error_origin import DEVICE_CALL
from dpstack.dp.pdu.alarm_blocks import Alarm, ModuleState, Status, module_status
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.read_write import ReadReq
from dpstack.dpv1.slave.alarms import AlarmEnd, AlarmServer, Raised
from dpstack.dpv1.slave.record_requests import AnyTicket, Ticket, TransportTicket
from dpstack.dpv1.slave.user_slave import OnRead, OnTransport, OnWrite
from dpstack.errors import AlarmError, SlaveTimeout, UsageError


class ServedAlarms:
    """The alarms of one slave. ``server`` None: its type has no DP-V1, every call raises UsageError."""

    def __init__(self, server: AlarmServer | None, name: str) -> None:
        self._server = server
        self._name = name

    async def alarm(self, alarm: Alarm, address: int, timeout: float | None) -> None:
        """Raise it and wait. Cancelled or too late, it is withdrawn where the master has not seen it yet."""
        server = self._known()
        raised = server.alarm(alarm)
        over: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        raised.ended = lambda: None if over.done() else over.set_result(None)
        try:
            async with asyncio.timeout(timeout):
                await over
        except TimeoutError:
            what = f"slave {address} ({self._name}): {alarm.text}: not acknowledged after {timeout} s"
            raise SlaveTimeout(address, f"{what}; {_hint(raised)}") from None
        finally:
            raised.ended = None
            if raised.end is None:
                server.withdraw(raised)
        if raised.end is not None and raised.end is not AlarmEnd.ACKNOWLEDGED:
            text = f"slave {address} ({self._name}): {alarm.text}: {raised.end.value}"
            raise AlarmError(text, "data exchange ended" if raised.end is AlarmEnd.LEFT else "withdrawn")

    def status(self, status: Status) -> None:
        self._known().status(status)

    def module_status(self, states: Sequence[ModuleState]) -> None:
        """A module status of ``states``, slot 1 first."""
        given = tuple(states) if isinstance(states, Iterable) else (states,)
        if not given or any(not isinstance(state, int) or state not in range(4) for state in given):
            raise UsageError(
                f"{states!r} is no list of ModuleState: ModuleState.OK, .INVALID, .WRONG or .MISSING for each"
            )
        self.status(module_status(tuple(ModuleState(state) for state in given)))

    def _known(self) -> AlarmServer:
        if self._server is None:
            raise UsageError(f"slave {self._name}: it has no DP-V1, so no alarms; say dpv1=True in its description")
        return self._server


def _hint(raised: Raised) -> str:
    if raised.offered:
        return "its master has read it in the diagnosis, but sends no Alarm_Ack"
    return "its master has not fetched it: others are before it, or the master does not heed diagnosis messages"


T = TypeVar("T")


class AsyncRecords:
    """The functions of a :class:`~dpstack.dpv1.slave.user_slave.DpSlave` for records; one that is not there refuses."""

    def __init__(
        self, on_read: OnRead | None, on_write: OnWrite | None, on_transport: OnTransport | None = None
    ) -> None:
        self._on_read = on_read
        self._on_write = on_write
        self._on_transport = on_transport
        self._tasks: set[asyncio.Task[None]] = set()

    def ask(self, ticket: Ticket) -> None:
        """Start the function; the master polls meanwhile. Where it gives up, the function is cancelled."""
        self._start(ticket, self._serve(ticket))

    def transport(self, ticket: TransportTicket) -> None:
        self._start(ticket, self._carry(ticket))

    def end(self) -> None:
        """The slave is served no more: what is under way is cancelled."""
        for task in self._tasks:
            task.cancel()

    def _start(self, ticket: AnyTicket, work: Coroutine[None, None, None]) -> None:
        task = asyncio.get_running_loop().create_task(work, name=ticket.title)
        self._tasks.add(task)
        ticket.abandoned = task.cancel
        task.add_done_callback(lambda done: self._over(ticket, done))

    def _over(self, ticket: AnyTicket, task: asyncio.Task[None]) -> None:
        """What it awaited was cancelled, and not by us: that is a failure, too, or its master would wait in vain."""
        self._tasks.discard(task)
        if task.cancelled():
            ticket.fail(asyncio.CancelledError("what it awaited was cancelled"))

    async def _carry(self, ticket: TransportTicket) -> None:
        request = ticket.request
        try:
            if self._on_transport is None:
                ticket.refuse(Code.NOT_SUPPORTED)
                return
            data = await _asked("on_transport", self._on_transport, request.slot, request.index, request.data)
            if not isinstance(data, (bytes, bytearray)):
                raise TypeError(f"on_transport returned {type(data).__name__}, what goes back is bytes")
            ticket.answer(bytes(data))
        except Exception as error:  # the user's, as below
            ticket.fail(error)

    async def _serve(self, ticket: Ticket) -> None:
        request = ticket.request
        try:
            if isinstance(request, ReadReq):
                if self._on_read is None:
                    ticket.refuse(Code.ACCESS_DENIED)
                    return
                data = await _asked("on_read", self._on_read, request.slot, request.index)
                if not isinstance(data, (bytes, bytearray)):
                    raise TypeError(f"on_read returned {type(data).__name__}, a record is bytes")
                ticket.answer(bytes(data))
            elif self._on_write is None:
                ticket.refuse(Code.ACCESS_DENIED)
            else:
                await _asked("on_write", self._on_write, request.slot, request.index, request.data)
                ticket.answer()
        except Exception as error:  # the user's: answered, told, and nothing else is disturbed
            ticket.fail(error)


async def _asked(name: str, function: Callable[..., Awaitable[T]], *args: object) -> T:
    with DEVICE_CALL:
        result = function(*args)
    if not isinstance(result, Awaitable):
        raise TypeError(f"{name} is an ordinary function, it has to be an async one: write async def")
    with DEVICE_CALL:
        return await result
