"""The ordered end of a bus: despite cancellations and Ctrl-C, by a finaliser without event loop, not in a fork.

The steps are :class:`dpstack.drivers.line.shutdown.EndSteps`; docs/explanation/ends.md lists every way out.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import functools
import logging
import os
import re
import select
import signal
import sys
import threading
import weakref
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterable
from pathlib import Path
from time import monotonic
from types import FrameType
from typing import Final

from dpstack.api.bus.events_json import log_or_print
from dpstack.api.bus.parts import BusBase
from dpstack.dp.master.commands import Mode
from dpstack.drivers.futures import wait_through_cancellation
from dpstack.drivers.line.shutdown import EndSteps, at_slaves, ending_signals
from dpstack.drivers.runtime import RESERVE
from dpstack.errors import BusError, DpError, UsageError
from dpstack.text import printable
from dpstack.trace import Event, Severity
from dpstack.units import NS_PER_MS, ns_to_s

#: the :class:`OrderedEnd` of every open bus of this process
_open: Final[set[weakref.ref[OrderedEnd]]] = set()
#: delay of a timer (ns) above which the event loop counts as blocked
_HELD_UP_NS: Final = 10 * NS_PER_MS
#: signals that end a program without a handler
ENDING_SIGNALS: Final = tuple(ending_signals())
#: Ctrl-C within this time (s) after the beginning of the end counts as the one that began it
SAME_SIGNAL_S: Final = 1.0


def open_ends() -> list[OrderedEnd]:
    """The end of every open bus of this process, also while other threads open and close theirs."""
    # tuple() copies at once: another thread that came into the iteration of a WeakSet would end it with an error
    return [end for kept in tuple(_open) if (end := kept()) is not None]


def hurry_all() -> None:
    """Hurry the end of every open bus of this process (see ``Bus.hurry``). Call it in their event loop."""
    for end in open_ends():
        end.hurry_bus()


class OrderedEnd:
    """The end of ``bus``: its steps, the task or finaliser that carries it out, and the report if it failed.

    ``close``, ``hurry_bus``: methods of the bus.
    """

    def __init__(
        self, bus: BusBase, close: Callable[[], Coroutine[object, object, None]], hurry_bus: Callable[[], None]
    ) -> None:
        self._bus = bus
        self._close = close
        self.hurry_bus = hurry_bus
        self._steps: EndSteps | None = None
        self._step: asyncio.Future[None] | None = None
        self._hurried = False
        self._keeper: AsyncGenerator[None, None] | None = None
        self._finalizer: weakref.finalize[[], _HeldByLoop] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._wake_fd = -1
        self._held: _HeldByLoop | None = None
        self._pid = os.getpid()
        self._reserve: bytearray | None = None
        #: see ``Bus.end_failed``
        self.failed = False

    # --- opening and closing -------------------------------------------------------------------------------

    async def watch(self) -> None:
        """The bus is open: register the objects that end it when its task, its loop or the program ends.

        Through an asynchronous generator asyncio.run() ends a bus that the program has not closed. A finaliser ends it
        if the loop is closed or never runs again.
        """
        self._loop = loop = asyncio.get_running_loop()
        self._pid = os.getpid()
        self._reserve = bytearray(RESERVE)
        _open.add(weakref.ref(self, _open.discard))
        self._keeper = self._keep()
        await anext(self._keeper)
        held = _HeldByLoop()
        if hasattr(os, "eventfd"):
            with contextlib.suppress(OSError):  # no descriptors left
                self._wake_fd = os.eventfd(0, os.EFD_CLOEXEC)
        if self._wake_fd >= 0:
            try:
                loop.add_reader(self._wake_fd, held.never)
            except NotImplementedError:
                os.close(self._wake_fd)
                self._wake_fd = -1
        if self._bus.driver == "virtual":  # simulated slaves need no safe values
            return
        if self._wake_fd < 0:  # without the descriptor only the end of the interpreter runs the finaliser
            self._held = held
        self._finalizer = weakref.finalize(held, self._without_loop)
        self._finalizer.atexit = False  # see _at_exit

    async def _keep(self) -> AsyncGenerator[None, None]:
        try:
            yield
        finally:
            ender = self._bus.ender
            if ender is None or asyncio.current_task() is not ender:
                await self._close()

    async def unwatch(self) -> None:
        """The bus is closed: remove all that :meth:`watch` has registered."""
        self._forget()
        keeper, self._keeper = self._keeper, None
        if keeper is not None:
            with contextlib.suppress(RuntimeError):  # asyncio.run() is closing the generator and waits for this end
                await keeper.aclose()

    def _forget(self) -> None:
        _open.discard(weakref.ref(self))
        self._reserve = None
        if self._finalizer is not None:
            self._finalizer.detach()
            self._finalizer = None
        fd, self._wake_fd = self._wake_fd, -1
        if fd >= 0:
            if self._loop is not None and not self._loop.is_closed():
                self._loop.remove_reader(fd)
            os.close(fd)

    # --- the end in the event loop --------------------------------------------------------------------------------

    def on_event(self, event: Event) -> None:
        if self._steps is not None:
            self._steps.on_event(event)
            if self._steps.done:
                self._wake()

    def hurry(self) -> None:
        """Skip the steps that do not make outputs safe, see :class:`EndSteps`."""
        self._hurried = True
        if self._steps is not None:
            self._steps.hurry(self._bus.runtime.now())
            self._wake()

    def is_over(self) -> None:
        """The bus can send no more telegrams: end the steps."""
        if self._steps is not None:
            self._steps.done = True
            self._wake()

    async def carry_out(self) -> None:
        """Carry out the steps, as far as the bus still can, in :func:`~dpstack.drivers.line.shutdown.end_limit_ns`.

        Cancellations of the calling task have no effect: asyncio.run() cancels all tasks.
        """
        bus = self._bus
        steps = self._steps = EndSteps(bus.params, lambda: bus.snapshot.in_ring)
        if self._hurried:
            steps.hurry(bus.runtime.now())
        exchanging = self._exchanging()
        self._reserve = None
        try:
            with self._interrupts_deferred():
                await self._carry_out(steps)
        except Exception as error:  # without memory the loop cannot make it
            steps.cleared = not bus.runtime.end_without_loop()
            text = f"{type(error).__name__} at the end, which was made without the event loop"
            bus.notice("bus", text, Severity.WARNING)
        self.failed = bool(exchanging) and not (steps.cleared or bus.runtime.cleared)
        # the process driver itself reports the death of its bus process
        if self.failed and not (steps.cleared is None and bus.driver == "process"):
            text = f"the end could not be sent: the slaves got neither safe values nor Clear. {at_slaves(exchanging)}"
            bus.notice("bus", text, Severity.ERROR)

    async def _carry_out(self, steps: EndSteps) -> None:
        bus = self._bus
        rotation = bus.rotation_limit_ns
        while (order := steps.next_order()) is not None:
            begun = bus.runtime.now()
            with contextlib.suppress(DpError):  # a failed step must not hold up the program
                ordered = bus.runtime.order(order)
                with contextlib.suppress(asyncio.CancelledError):
                    await wait_through_cancellation(ordered)
                ordered.result()
                held_up = False
                while not steps.done and (left := steps.wait_until(begun, rotation) - bus.runtime.now()) > 0:
                    paused = bus.runtime.now()
                    await self._pause(ns_to_s(left))
                    if not held_up and bus.runtime.now() - paused - left > _HELD_UP_NS:
                        held_up = True  # another task blocked the loop, and with it the bus
                        begun = bus.runtime.now()
        now = bus.runtime.now()
        self._steps = None
        # wait for the last bit by time: no port reports when it has left the line
        await self._pause(ns_to_s(steps.over_at(now) - now))

    def _exchanging(self) -> dict[str, int]:
        """By name the watchdog times (ns) of the slaves that have outputs of this master."""
        if (self._bus.runtime.mode_before_silence or self._bus.snapshot.mode) is not Mode.OPERATE:
            return {}
        view = self._bus.view
        return {s.name: view.slave(s.address).watchdog_ns for s in view.setups.values() if view.image(s).exchanges}

    async def _pause(self, seconds: float) -> None:
        """Wait for :meth:`_wake`, at most ``seconds``; cancellations have no effect."""
        loop = asyncio.get_running_loop()
        self._step = step = loop.create_future()
        timer = loop.call_later(seconds, _set, step)
        try:
            with contextlib.suppress(asyncio.CancelledError):
                await wait_through_cancellation(step)
        finally:
            timer.cancel()
            self._step = None

    def _wake(self) -> None:
        if self._step is not None:
            _set(self._step)

    def _interrupts_deferred(self) -> contextlib.AbstractContextManager[object]:
        """Defer KeyboardInterrupt by Ctrl-C until the end is over.

        A Ctrl-C later than :data:`SAME_SIGNAL_S` after the beginning hurries the end. Signal handlers of the program
        itself stay as they are.
        """
        loop = asyncio.get_running_loop()
        before = signal.getsignal(signal.SIGINT) if threading.current_thread() is threading.main_thread() else None
        if not callable(before) or not _raises(before):
            return contextlib.nullcontext()
        return _DeferredSignals(
            (signal.SIGINT,),
            late=lambda: loop.call_soon_threadsafe(self.hurry_bus),
            raise_again=lambda number: loop.call_soon(before, number, None),
        )

    # --- the end without an event loop ----------------------------------------------------------------------------

    def at_exit(self) -> None:
        """The interpreter ends: run the finaliser of the bus, if it has one."""
        if self._finalizer is not None and self._finalizer.detach():
            self._without_loop()

    def _without_loop(self) -> None:
        """The finaliser: the loop or the interpreter ends, and the program has not closed the bus."""
        bus, loop = self._bus, self._loop
        if os.getpid() != self._pid or bus.is_left:
            return
        where = f"the bus on {printable(bus.runtime.port_name)}"
        with _DeferredSignals(ENDING_SIGNALS, late=self._hurry_in_thread):
            if loop is not None and loop.is_running():  # in a daemon thread
                with contextlib.suppress(Exception):
                    asyncio.run_coroutine_threadsafe(self._close(), loop).result(bus.end_limit_s)
                    log_or_print(logging.WARNING, f"{where} was still open as the program ended and was closed then")
                    return
            self._end_now(f"{where} was not closed before its event loop was (use `async with`)")

    def _hurry_in_thread(self) -> None:
        loop = self._loop
        if loop is not None and loop.is_running():
            loop.call_soon_threadsafe(self.hurry_bus)

    def _end_now(self, how: str) -> None:
        """The end in this thread, without the loop. ``how``: the way in which the program left the bus, for the log."""
        self._reserve = None
        bus = self._bus
        exchanging = self._exchanging()
        why = bus.runtime.end_without_loop()
        bus.leave(UsageError("the bus was left with its event loop"))
        self._forget()
        self._drop_keeper()
        self.failed = bool(exchanging and why)
        if not why:
            log_or_print(logging.WARNING, f"{how}: safe values and Clear were sent at the last moment")
        elif exchanging:
            text = f"{how}, and safe values and Clear could not be sent: {why}. {at_slaves(exchanging)}"
            log_or_print(logging.ERROR, text)

    async def elsewhere(self) -> bool:
        """Close the bus for a caller outside of the bus's event loop; False if the caller is in that loop.

        If that loop runs in another thread, it carries out the end. If it does not run, the end is carried out here as
        by the finaliser. Without any running loop (Python discards a coroutine) the finaliser does it later. Raises
        BusError if the loop in the other thread is blocked.
        """
        loop = self._loop
        try:
            running = asyncio.get_running_loop()
        except RuntimeError:
            return True
        if loop is None or loop is running:
            return False
        if loop.is_running():
            ending = asyncio.wrap_future(asyncio.run_coroutine_threadsafe(self._close(), loop))
            limit = running.call_later(self._bus.end_limit_s, ending.cancel)
            await wait_through_cancellation(ending)
            limit.cancel()
            if ending.cancelled():
                raise BusError(
                    f"the event loop of the bus on {self._bus.runtime.port_name} is blocked: it does not end it"
                )
            ending.result()
        else:
            with _DeferredSignals(ENDING_SIGNALS):
                self._end_now(f"the bus on {self._bus.runtime.port_name} was closed in another event loop than its own")
        return True

    def _drop_keeper(self) -> None:
        keeper, self._keeper = self._keeper, None
        if keeper is not None:
            with contextlib.suppress(StopIteration, StopAsyncIteration, RuntimeError):
                keeper.aclose().send(None)

    # --- the child of a fork --------------------------------------------------------------------------------------

    def release_after_fork(self) -> None:
        """In the child of a fork: forget the bus without effect on the parent."""
        bus = self._bus
        if self._wake_fd >= 0:
            os.close(self._wake_fd)  # the next step needs a descriptor, and this process may have no other
        _replace_epoll(self._wake_fd)
        self._wake_fd = -1
        bus.runtime.release_after_fork()
        text = "this process was forked from the one that runs the bus, which goes on there: open a bus of its own"
        bus.leave(UsageError(text))
        self._forget()
        self._drop_keeper()


class _HeldByLoop:
    """An object to which only the event loop refers, so that Python finalises it when the loop is closed."""

    def never(self) -> None:
        """Its descriptor never becomes readable."""


def _set(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def _raises(handler: object) -> bool:
    """Whether a signal handler raises KeyboardInterrupt at any place: that of Python, and that of asyncio.run()."""
    if handler is signal.default_int_handler:
        return True
    func = handler.func if isinstance(handler, functools.partial) else handler
    return isinstance(getattr(func, "__self__", None), asyncio.Runner)


class _DeferredSignals:
    """Holds back the signals ``numbers`` during the block; afterwards calls ``raise_again`` once with each of them.

    A signal more than :data:`SAME_SIGNAL_S` after the beginning calls ``late``. No effect in threads other than the
    main one, where no handler runs, and on ignored signals.
    """

    def __init__(
        self,
        numbers: Iterable[int],
        *,
        late: Callable[[], object] = lambda: None,
        raise_again: Callable[[int], object] = signal.raise_signal,
    ) -> None:
        self._numbers = numbers
        self._late = late
        self._raise_again = raise_again
        self._caught: list[int] = []
        self._before: dict[int, object] = {}
        self._begun = monotonic()

    def __enter__(self) -> None:
        if threading.current_thread() is threading.main_thread():
            for number in self._numbers:
                self._defer(number)

    def _defer(self, number: int) -> None:
        before = signal.getsignal(number)
        while before not in (None, signal.SIG_IGN) and number not in self._before:
            try:
                signal.signal(number, self._keep)
            except BaseException as error:  # the signal came just before: Python still runs its old handler
                self._caught.append(signal.SIGINT if isinstance(error, KeyboardInterrupt) else signal.SIGTERM)
            else:
                self._before[number] = before

    def _keep(self, number: int, _frame: FrameType | None) -> None:
        self._caught.append(number)
        if monotonic() - self._begun >= SAME_SIGNAL_S:
            self._late()

    def __exit__(self, *_exc: object) -> None:
        for number, before in self._before.items():
            if callable(before) or isinstance(before, signal.Handlers):
                signal.signal(number, before)
        for number in dict.fromkeys(self._caught):
            self._raise_again(number)


def _replace_epoll(watched_fd: int) -> None:
    """In the child of a fork: replace the epoll object that watches ``watched_fd`` by a new one.

    The child's copy of an event loop has the parent's epoll object. Closing the loop in the child, as asyncio.run()
    does, would remove descriptors from the parent's loop, among them the one by which threads and signals wake it.
    Linux lists the descriptors that an epoll object watches, so this works for other loops (uvloop), too.
    """
    if sys.platform != "linux" or watched_fd < 0:
        return
    for name in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError, ValueError):
            # no text: the import of its codec might need a file descriptor
            watched = Path("/proc/self/fdinfo", name).read_bytes()
            if re.search(rb"^tfd:\s*%d\s" % watched_fd, watched, re.MULTILINE):
                with select.epoll() as fresh:
                    os.dup2(fresh.fileno(), int(name), inheritable=False)


def _in_child() -> None:
    for end in open_ends():
        end.release_after_fork()


def _at_exit() -> None:
    """End all open buses. A signal during that takes effect afterwards."""
    with _DeferredSignals(ENDING_SIGNALS):
        for end in open_ends():
            end.at_exit()


atexit.register(_at_exit)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_in_child)
