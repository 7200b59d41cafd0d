"""The line between an application and its bus process: one process, one socket, questions and answers, news.

A question waits for its answer; news that arrive meanwhile are handed on at once, in order. A handler of news that asks
in turn does not get ahead of what was told before.

Each order has a time limit, :data:`LIMIT_NS`: the bus process drops an order that it takes later. It sets the number of
the order that it takes in shared memory before it looks at the clock. So an application that gives up after the limit,
and sees that its order was not taken, knows that nothing will come of it. Orders that end something
(:func:`~dpstack.drivers.process.messages.is_ending`) have no limit.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Callable
from time import monotonic_ns
from typing import Final

from dpstack.drivers.line.asyncio_runtime import outlast
from dpstack.drivers.process.messages import (
    FROM_TERMINALS,
    Answer,
    Frames,
    Hello,
    Message,
    News,
    Question,
    SetUp,
    error_of,
    framed,
    is_ending,
    named,
    typed,
)
from dpstack.drivers.process.shared_image import SharedImage
from dpstack.errors import BusError, DpError, OrderDropped, UsageError
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S, ms_text

#: a bus process without a sign of life for so long is silent; orders and outputs that it does not take in this time are
#: dropped
LIMIT_NS: Final = NS_PER_S
#: so long the answer to an order may take that the bus process has taken (a plugin may have to be imported)
ANSWER_NS: Final = 5 * NS_PER_S
#: so long a silent bus process is waited for where an order ends something
_AGAIN_NS: Final = 500 * NS_PER_MS
#: the interpreter starts, the plugins are imported, the port is opened
_START_S: Final = 30.0
_END_S: Final = 3.0
_CHUNK: Final = 65_536
#: what the end of a bus takes longer at most where the bus process hangs: four orders, and its own end
CLOSE_LIMIT_S: Final = (ANSWER_NS + 3 * _AGAIN_NS) / NS_PER_S + 2 * _END_S


class Link:
    """Starts the bus process and talks to it. ``on_news`` takes what it tells.

    ``why_gone`` makes the error of a bus process that ended unasked from its exit code (negative: a signal; None: it
    runs on, but has hung up) and its last words; from then on that is raised by every question. ``on_gone`` is told
    when all that came before was handed on.
    """

    def __init__(
        self,
        on_news: Callable[[News], None],
        why_gone: Callable[[int | None, News | None], DpError],
        on_gone: Callable[[DpError], None],
    ) -> None:
        self._on_news = on_news
        self._why_gone = why_gone
        self._on_gone = on_gone
        self._loop: asyncio.AbstractEventLoop | None = None
        self._sock: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._frames = Frames()
        self._hello: asyncio.Future[Hello] | None = None
        self._inbox: deque[News | DpError] = deque()
        self._last_words: News | None = None
        self._dispatching = False
        self._number = 0
        self._awaited: set[int] = set()
        self._answers: dict[int, Answer] = {}
        self._gone: DpError | None = None
        self._silent = False  # it owes an answer, and has said nothing since
        self._image: SharedImage | None = None
        self._unsent = bytearray()  # what the socket did not take: later frames come behind it

    @property
    def pid(self) -> int | None:
        """The process id, once it was started."""
        return None if self._process is None else self._process.pid

    @property
    def is_open(self) -> bool:
        """Questions can be asked."""
        return self._sock is not None and self._gone is None

    def silent_ns(self) -> int:
        """For how long the bus process has shown no sign of life; 0 while that is not yet :data:`LIMIT_NS`."""
        if self._image is None or not self.is_open or not self._image.heartbeat.value:
            return 0
        silent = monotonic_ns() - self._image.heartbeat.value
        return silent if silent > LIMIT_NS else 0

    async def start(self, setup: SetUp, memory: int, image: SharedImage) -> Hello:
        """Start it with the shared memory behind the descriptor ``memory``, here mapped as ``image``.

        Raises PortError, ConfigError, BusError.
        """
        self._image = image
        self._loop = loop = asyncio.get_running_loop()
        self._hello = loop.create_future()
        ours, theirs = socket.socketpair()
        self._sock = ours
        try:
            with theirs:
                ours.setblocking(False)
                self._process = _started(theirs.fileno(), memory)
            async with asyncio.timeout(_START_S):
                await loop.sock_sendall(ours, framed(Message(question=Question(0, named(setup)))))
                loop.add_reader(ours.fileno(), self._on_readable)
                return await self._hello
        except BaseException as error:
            self.release(kill=True)
            if isinstance(error, TimeoutError):
                raise BusError(f"the bus process did not start within {_START_S:g} s") from None
            raise

    async def ended(self) -> None:
        """Wait until the process has ended by itself, with a limit. Cancellations change nothing.

        The loop waits for the process itself: a thread would need the descriptor by which threads wake up the loop,
        and the child of a fork may have taken that away from it.
        """
        process, loop = self._process, self._loop
        if process is None or loop is None or self._silent or process.poll() is not None:
            return
        try:
            fd = os.pidfd_open(process.pid)
        except OSError:  # no descriptor is left: who releases it waits for it
            return
        over: asyncio.Future[None] = loop.create_future()
        limit = loop.call_later(_END_S, _set, over)
        try:
            loop.add_reader(fd, _set, over)
            with contextlib.suppress(asyncio.CancelledError):
                await outlast(over)
        finally:
            limit.cancel()
            loop.remove_reader(fd)
            os.close(fd)

    def hang_up_and_wait(self, error: DpError) -> bool:
        """Hang up without a loop; the process makes its ordered end. Whether it has ended in time; it is not killed."""
        self.hang_up(error)
        self._disconnect()
        process = self._process
        if process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_END_S)
        return process is None or process.poll() is not None

    def forsake(self) -> None:
        """In the child of a fork: the process and the loop are the parent's."""
        self._gone = UsageError("the bus process belongs to the parent of this process")
        sock, self._sock = self._sock, None
        process, self._process = self._process, None
        if sock is not None:
            sock.close()
        if process is not None:
            process.returncode = 0  # it is no child of this process

    def hang_up(self, error: DpError) -> None:
        """Nothing more will be asked: ``error`` says why."""
        self._gone = self._gone or error

    def release(self, *, kill: bool) -> bool:
        """Whatever state it is in: no process and no descriptor is left behind. Whether it had to be killed."""
        self._disconnect()
        process = self._process
        if process is None or process.poll() is not None:
            return False
        if not kill and not self._silent:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_END_S)  # it ends in order when nobody is there any more
        if process.poll() is not None:
            return False
        process.kill()
        process.wait()
        return True

    # --- question and answer ----------------------------------------------------------------------------------------

    def ask(self, order: object) -> object:
        """What it answers to ``order``; what it raises is raised here.

        Raises OrderDropped when the bus process does not take the order in time, BusError when it is gone, or took the
        order and does not answer.
        """
        if self._gone is not None:
            raise self._gone
        image = self._image
        if self._sock is None or image is None:
            raise UsageError("the driver is not open: await open() first")
        began = monotonic_ns()
        silent, ending, owing = self.silent_ns(), is_ending(order), self._silent
        if silent and not ending:
            raise OrderDropped(
                f"the bus process (pid {self.pid}) has shown no sign of life for {ms_text(silent)} (it is stopped, or "
                "hangs): the order was dropped"
            )
        self._number += 1
        number = self._number
        self._awaited.add(number)
        limit = began + (_AGAIN_NS if silent or owing else LIMIT_NS)
        try:
            self._send(framed(Message(question=Question(number, named(order), NEVER if ending else limit))), limit)
            while number not in self._answers:
                if self._wait(limit, writing=bool(self._unsent)):
                    continue
                taken = image.order_taken.value >= number
                if not taken or owing or limit > began + LIMIT_NS:
                    self._silent = True
                    raise self._unanswered(taken=taken, ending=ending)
                limit = began + ANSWER_NS
            answer = self._answers.pop(number)
        finally:
            self._awaited.discard(number)
        if answer.error is not None:
            raise error_of(answer.error)
        return answer.value

    def tell(self, order: object) -> None:
        """Send ``order`` without waiting for its answer. Left out while the bus process reads nothing.

        Raises what :meth:`ask` raises of a bus process that is gone.
        """
        if self._gone is not None:
            raise self._gone
        if self._sock is None:
            raise UsageError("the driver is not open: await open() first")
        if self.silent_ns() or self._unsent:
            return
        self._number += 1
        now = monotonic_ns()
        self._send(framed(Message(question=Question(self._number, named(order), now + LIMIT_NS))), now)

    def _unanswered(self, *, taken: bool, ending: bool) -> BusError:
        who = f"the bus process (pid {self.pid})"
        if taken:
            limit = ms_text(ANSWER_NS)
            return BusError(f"{who} took the order and did not answer within {limit}: whether it did it is not known")
        if ending:
            return BusError(f"{who} does not answer (it is stopped, or hangs); it carries the order out if it goes on")
        limit = ms_text(LIMIT_NS)
        return OrderDropped(f"{who} did not take the order within {limit} (it is stopped, or hangs): it was dropped")

    def _send(self, octets: bytes, limit: int) -> None:
        """As much as the socket takes up to ``limit``; the rest goes before what is sent next."""
        left = self._unsent
        left += octets
        while left and self._sock is not None:
            try:
                del left[: self._sock.send(left)]
            except BlockingIOError:
                if not self._wait(limit, writing=True):
                    return
            except OSError:  # gone, but its last words may still be here
                while self._sock is not None:
                    if not self._wait(limit, writing=False):
                        return

    def _wait(self, limit: int, *, writing: bool) -> bool:
        """For octets of the bus process, or for room to write; what it says meanwhile is taken. False: in vain."""
        sock = self._sock
        if sock is None:
            if self._gone is not None:
                raise self._gone
            return False
        left_s = max(0, limit - monotonic_ns()) / NS_PER_S
        ready, room, _ = select.select([sock], [sock] if writing else [], [], left_s)
        if ready:
            self._on_readable()
        if room and self._unsent and self._sock is not None:
            with contextlib.suppress(OSError):
                del self._unsent[: self._sock.send(self._unsent)]
        return bool(ready or room)

    def _on_readable(self) -> None:
        if self._sock is None:
            return
        try:
            octets = self._sock.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            octets = b""
        if not octets:
            self._hung_up()
            return
        self._silent = False
        for message in self._frames.feed(octets):
            if message.news is not None:
                self._inbox.append(message.news)
                if message.news.over is not None:
                    self._last_words = message.news
            answer = message.answer
            if answer is None:
                continue
            if answer.number in self._awaited:
                self._answers[answer.number] = answer
            elif not answer.number and self._hello is not None and not self._hello.done():
                if answer.error is None:
                    self._hello.set_result(typed(answer.value, Hello))
                else:
                    self._hello.set_exception(error_of(answer.error))
        self._dispatch()

    def _dispatch(self) -> None:
        """Hand on what was told, in order; a handler that gives orders of its own does not get ahead of it."""
        if self._dispatching:
            return
        self._dispatching = True
        try:
            while self._inbox:
                told = self._inbox.popleft()
                if isinstance(told, DpError):
                    self._on_gone(told)
                else:
                    self._on_news(told)
        finally:
            self._dispatching = False

    # --- the end ----------------------------------------------------------------------------------------------------

    def _hung_up(self) -> None:
        """The bus process is gone, or about to be."""
        process = self._process
        if self._sock is None or process is None:
            return
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_END_S)
        asked_for = self._gone is not None
        self._gone = self._gone or self._why_gone(process.returncode, self._last_words)
        self._disconnect()
        if self._hello is not None and not self._hello.done():
            self._hello.set_exception(self._gone)
        elif not asked_for:
            self._inbox.append(self._gone)
            self._dispatch()

    def _disconnect(self) -> None:
        sock, self._sock = self._sock, None
        if sock is not None:
            if self._loop is not None and not self._loop.is_closed():
                self._loop.remove_reader(sock.fileno())
            sock.close()


def _set(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def _started(sock: int, memory: int) -> subprocess.Popen[bytes]:
    """The process, which is given two file descriptors by number and finds modules where this one does.

    What a terminal sends to everybody waits until it has said what it does about it.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, FROM_TERMINALS)
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "dpstack.drivers.process", str(sock), str(memory), str(os.getpid())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=(sock, memory),
            env=os.environ | {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
