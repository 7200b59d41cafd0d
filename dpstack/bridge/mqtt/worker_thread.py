"""Calls that may block without a limit (disk, names of hosts, TCP, TLS) in daemon threads.

``asyncio.to_thread`` would delay the end of the program: ``asyncio.run`` joins the threads of the default executor.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, TypeVar

T = TypeVar("T")


class WorkerThread:
    """Carries out calls one behind the other in one thread, which never delays the end of the program."""

    def __init__(self, name: str) -> None:
        self._calls: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        threading.Thread(target=self._run, name=name, daemon=True).start()

    async def call(self, function: Callable[..., T], *arguments: Any) -> T:
        """The result of ``function``, or what it raises. It goes on where the caller is cancelled."""
        loop = asyncio.get_running_loop()
        future: asyncio.Future[T] = loop.create_future()

        def finish(result: T | None, error: BaseException | None) -> None:
            if future.done():
                return
            if error is None:
                future.set_result(result)  # type: ignore[arg-type]
            else:
                future.set_exception(error)

        def work() -> None:
            result, failed = None, None
            try:
                result = function(*arguments)
            except BaseException as error:
                failed = error
            with contextlib.suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(finish, result, failed)

        self._calls.put(work)
        return await future

    def run_last(self, function: Callable[[], object] = lambda: None) -> None:
        """Have ``function`` called behind all others, and end the thread. Does not wait."""

        def work() -> None:
            with contextlib.suppress(Exception):
                function()

        self._calls.put(work)
        self._calls.put(None)

    def _run(self) -> None:
        while (call := self._calls.get()) is not None:
            call()


async def in_thread(name: str, function: Callable[..., T], *arguments: Any) -> T:
    """The result of ``function``, or what it raises, from a thread called ``name``; see :meth:`WorkerThread.call`."""
    thread = WorkerThread(name)
    try:
        return await thread.call(function, *arguments)
    finally:
        thread.run_last()
