"""Calls that may block without a limit (disk, names of hosts, TCP, TLS) in daemon threads.

``asyncio.to_thread`` would delay the end of the program: ``asyncio.run`` joins the threads of the default executor.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from queue import SimpleQueue
from typing import Any, TypeVar

T = TypeVar("T")


class WorkerThread(Executor):
    """Carries out calls one behind the other in one thread, which never delays the end of the program."""

    def __init__(self, name: str) -> None:
        self._calls: SimpleQueue[tuple[Future[Any], Callable[[], object]] | None] = SimpleQueue()
        self._loop: asyncio.AbstractEventLoop | None = None
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        future: Future[T] = Future()
        self._calls.put((future, partial(fn, *args, **kwargs)))
        return future

    async def call(self, function: Callable[..., T], *arguments: Any) -> T:
        """The result of ``function``, or what it raises. It goes on if the caller is cancelled."""
        self._loop = loop = asyncio.get_running_loop()
        # a virtual loop waits for what this method began
        future = loop.run_in_executor(self, function, *arguments)
        future.add_done_callback(lambda done: done.cancelled() or done.exception())
        return await asyncio.shield(future)

    def run_last(self, function: Callable[[], object] = lambda: None) -> None:
        """Have ``function`` called behind all others, and end the thread. Does not wait."""
        self.submit(function)
        self._calls.put(None)

    def _run(self) -> None:
        while (call := self._calls.get()) is not None:
            self._carry_out(*call)
            del call  # while it waits, this thread keeps neither a result nor a file alive

    def _carry_out(self, future: Future[Any], function: Callable[[], object]) -> None:
        result, failed = None, None
        try:
            result = function()
        except BaseException as error:
            failed = error
        if self._loop is not None and self._loop.is_closed():
            return  # nobody waits any more
        if failed is None:
            future.set_result(result)
        else:
            future.set_exception(failed)


async def in_thread(name: str, function: Callable[..., T], *arguments: Any) -> T:
    """The result of ``function``, or what it raises, from a thread called ``name``; see :meth:`WorkerThread.call`."""
    thread = WorkerThread(name)
    try:
        return await thread.call(function, *arguments)
    finally:
        thread.run_last()
