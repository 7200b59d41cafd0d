"""Async functions that serve the records of a slave: a task for each request."""

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
    """Serves records and Data_Transport by the functions of ``device``. Refuses requests without a function."""

    def __init__(self, device: DpSlave) -> None:
        self._device = device
        self._tasks: set[asyncio.Task[None]] = set()

    def ask(self, request: RecordRequest) -> None:
        """Start the function; its result is the answer. Cancel it if the master gives up polling."""
        task = asyncio.get_running_loop().create_task(self._serve(request), name=request.title)
        self._tasks.add(task)
        request.abandoned = task.cancel
        task.add_done_callback(lambda done: self._on_done(request, done))

    def end(self) -> None:
        """The end of the slave: cancel the running functions."""
        for task in self._tasks:
            task.cancel()

    def _on_done(self, request: RecordRequest, task: asyncio.Task[None]) -> None:
        """If other code has cancelled the function, answer with an error: the master still polls."""
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
            data = await _result_of(name, function, service.slot, service.index, *octets)
            if not result:
                data = b""
            if not isinstance(data, (bytes, bytearray)):
                raise TypeError(f"{name} returned {type(data).__name__}, {result} is bytes")
            request.answer(bytes(data))
        except Exception as error:  # of the user's function: only this request fails
            request.fail(error)


async def _result_of(name: str, function: Callable[..., Awaitable[T]], *args: object) -> T:
    with DEVICE_CALL:
        result = function(*args)
    if not isinstance(result, Awaitable):
        raise TypeError(f"{name} is an ordinary function, it has to be an async one: write async def")
    with DEVICE_CALL:
        return await result
