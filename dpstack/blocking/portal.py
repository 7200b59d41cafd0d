"""``Portal``: an event loop in a thread of its own, in which calls of blocking programs are carried out."""

from __future__ import annotations

import asyncio
import concurrent.futures
import inspect
import logging
import os
import sys
import threading
import types
from collections.abc import Callable
from time import monotonic
from typing import Any, Final

from dpstack.errors import UsageError

_log: Final = logging.getLogger("dpstack")
#: Ctrl-C again within this time (s) counts as the same one
_SAME_SIGNAL_S: Final = 1.0
#: the code by which an event loop runs a callback, or a step of a task
_STEP: Final = asyncio.Handle._run.__code__
_WAITS: Final = inspect.CO_COROUTINE | inspect.CO_ASYNC_GENERATOR | inspect.CO_ITERABLE_COROUTINE


class Call:
    """One call in the loop's thread: ``function(*args, **kwargs)``, and its result is awaited if it is awaitable."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        function: Callable[..., object],
        args: tuple[object, ...],
        kwargs: dict[str, object],
    ) -> None:
        self._loop = loop
        self._work = function, args, kwargs
        self._task: asyncio.Task[object] | None = None
        self.outcome: concurrent.futures.Future[object] = concurrent.futures.Future()

    def begin(self) -> None:
        self._loop.call_soon_threadsafe(self._begin)

    def cancel(self) -> None:
        """Cancel the task, in any thread; ``outcome`` comes when the task has ended."""
        self._loop.call_soon_threadsafe(self._cancel)

    def _begin(self) -> None:
        self._task = self._loop.create_task(_carry_out(*self._work))
        self._task.add_done_callback(self._on_done)

    def _cancel(self) -> None:
        if self._task is not None:
            self._task.cancel()

    def _on_done(self, task: asyncio.Task[object]) -> None:
        self._task = None  # it refers to this call, which would keep an iterator that was left
        if task.cancelled():
            self.outcome.set_exception(asyncio.CancelledError())
        elif (error := task.exception()) is not None:
            self.outcome.set_exception(error)
        else:
            self.outcome.set_result(task.result())


async def _carry_out(function: Callable[..., object], args: tuple[object, ...], kwargs: dict[str, object]) -> object:
    __tracebackhide__ = True
    result = function(*args, **kwargs)
    return await result if inspect.isawaitable(result) else result


def _inside(trace: types.TracebackType | None) -> types.TracebackType | None:
    """The part of ``trace`` in the loop's thread, without the frames of the future in between."""
    while trace is not None and trace.tb_frame.f_code is not _carry_out.__code__:
        trace = trace.tb_next
    return trace


class Portal:
    """An event loop in a daemon thread, which runs as long as the interpreter.

    What ends a bus that is still open then is the same as for any event loop: docs/explanation/ends.md.
    """

    def __init__(self) -> None:
        self._pid = os.getpid()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="dpstack.blocking", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        while not self._loop.is_closed():
            try:
                self._loop.run_forever()
            except BaseException as error:  # asyncio passes these two on: they end neither this thread nor the bus
                if not isinstance(error, (SystemExit, KeyboardInterrupt)):
                    raise
                _log.error("%s in the thread of the bus does not end the program", type(error).__name__)

    @property
    def is_forked(self) -> bool:
        """Whether this process is a child of the one with the loop."""
        return os.getpid() != self._pid

    @property
    def is_own_thread(self) -> bool:
        """Whether the caller is a callback in the loop's thread."""
        return threading.current_thread() is self._thread

    def run(self, function: Callable[..., object], *args: object, **kwargs: object) -> object:
        """The result of ``function(*args, **kwargs)`` in the loop's thread, awaited if it is awaitable.

        An exception in the waiting thread (Ctrl-C) cancels the call, and is raised when the call has ended; another
        one more than a second later is raised at once. Raises UsageError if the caller must not wait.
        """
        __tracebackhide__ = True
        if self.is_own_thread:
            return self._run_here(function, args, kwargs)
        call = self._new_call(function, args, kwargs)
        try:
            call.begin()
            return call.outcome.result()
        except BaseException as error:
            if call.outcome.done():
                error.__traceback__ = _inside(error.__traceback__)
                raise
            call.cancel()
            until = monotonic() + _SAME_SIGNAL_S
            while not call.outcome.done():
                try:
                    concurrent.futures.wait([call.outcome])
                except KeyboardInterrupt:
                    if monotonic() > until:
                        raise
            raise

    def start(self, function: Callable[..., object], *args: object) -> Call:
        """Begin a call for which the caller waits by its ``outcome``. Raises UsageError as :meth:`run` does."""
        if self.is_own_thread:
            raise _waits_for_itself(function)
        call = self._new_call(function, args, {})
        call.begin()
        return call

    def _new_call(self, function: Callable[..., object], args: tuple[object, ...], kwargs: dict[str, object]) -> Call:
        if self.is_forked:
            raise UsageError(
                "this process was forked from the one that runs the bus, which goes on there: open a bus of its own"
            )
        if sys.is_finalizing():
            raise UsageError("the interpreter ends: the bus was closed before")
        if asyncio._get_running_loop() is not None and _is_in_coroutine():
            raise UsageError(
                "a name of dpstack.blocking was called by a coroutine, or a callback, of an event loop, which it would "
                "hold up: use the asynchronous names there (async with dpstack.open_bus(...), await bus.operate())"
            )
        return Call(self._loop, function, args, kwargs)

    def _run_here(self, function: Callable[..., object], args: tuple[object, ...], kwargs: dict[str, object]) -> object:
        result = function(*args, **kwargs)
        if inspect.isawaitable(result):
            if inspect.iscoroutine(result):
                result.close()
            raise _waits_for_itself(function)
        return result


def _waits_for_itself(function: Callable[..., object]) -> UsageError:
    return UsageError(
        f"{getattr(function, '__name__', function)} was called in the thread of the bus (by on_event, a condition, or "
        "a function of a slave), where it would wait for itself: call it in a thread of the program"
    )


def _is_in_coroutine() -> bool:
    """Whether the caller is a coroutine, or a callback, of the event loop that runs in this thread.

    A cell of Jupyter, or of another shell that runs in an event loop, is neither: it is a module, or the kernel calls
    it (a widget).
    """
    frame: Any = sys._getframe()
    while frame is not None:
        name = frame.f_globals.get("__name__", "")
        if frame.f_code.co_name == "<module>" or name.startswith("ipykernel."):
            return False
        if frame.f_code.co_flags & _WAITS or frame.f_code is _STEP:
            return True
        frame = frame.f_back
    return True


_portal: Portal | None = None
_making = threading.Lock()


def the_portal() -> Portal:
    """The portal of this process, made at its first use."""
    global _portal
    with _making:
        if _portal is None:
            _portal = Portal()
        return _portal


def _forget() -> None:
    """In the child of a fork, which has no thread of the portal."""
    global _portal, _making
    _portal, _making = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
