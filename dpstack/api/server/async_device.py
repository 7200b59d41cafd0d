"""Records of a slave served by async functions: each request is a task, whose end answers it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeVar

from dpstack.dp.error_origin import DEVICE_CALL
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.read_write import DataTransport, ReadReq
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.user_slave import DpSlave

T = TypeVar("T")


class AsyncRecords:
    """Serves records and Data_Transport by the functions of ``device``; a request without a function is refused."""

    def __init__(self, device: DpSlave) -> None:
        self._device = device
        self._tasks: set[asyncio.Task[None]] = set()

    def ask(self, request: RecordRequest) -> None:
        """Start the function; the master polls meanwhile. Where it gives up, the function is cancelled."""
        task = asyncio.get_running_loop().create_task(self._serve(request), name=request.title)
        self._tasks.add(task)
        request.abandoned = task.cancel
        task.add_done_callback(lambda done: self._over(request, done))

    def end(self) -> None:
        """The slave is served no more: cancel the running functions."""
        for task in self._tasks:
            task.cancel()

    def _over(self, request: RecordRequest, task: asyncio.Task[None]) -> None:
        """Answer for a function that somebody else has cancelled, or its master would wait in vain."""
        self._tasks.discard(task)
        if task.cancelled():
            request.fail(asyncio.CancelledError("what it awaited was cancelled"))

    async def _serve(self, request: RecordRequest) -> None:
        service = request.service
        name, result, refusal = "on_write", "", Code.ACCESS_DENIED
        if isinstance(service, ReadReq):
            name, result = "on_read", "a record"
        elif isinstance(service, DataTransport):
            name, result, refusal = "on_transport", "what goes back", Code.FEATURE_NOT_SUPPORTED
        function: Callable[..., Awaitable[object]] | None = getattr(self._device, name)
        if function is None:
            request.refuse(refusal)
            return
        try:
            octets = () if isinstance(service, ReadReq) else (service.data,)
            data = await _asked(name, function, service.slot, service.index, *octets)
            if not result:
                data = b""
            if not isinstance(data, (bytes, bytearray)):
                raise TypeError(f"{name} returned {type(data).__name__}, {result} is bytes")
            request.answer(bytes(data))
        except Exception as error:  # the user's: answered and reported, nothing else is disturbed
            request.fail(error)


async def _asked(name: str, function: Callable[..., Awaitable[T]], *args: object) -> T:
    with DEVICE_CALL:
        result = function(*args)
    if not isinstance(result, Awaitable):
        raise TypeError(f"{name} is an ordinary function, it has to be an async one: write async def")
    with DEVICE_CALL:
        return await result
