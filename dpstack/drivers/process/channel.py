"""The application's end of the socket: start and end of the bus process, orders and their answers, news.

Nothing here waits for the bus process: the channel sends an order, and the answer ends a future. If no caller awaits
the future, the channel reports a refusal to ``on_refused``.

Each order has a time limit, :data:`LIMIT_NS`: the bus process drops an order that it reads later. It writes the number
of the order into shared memory before it reads the clock. So if the number is not there after the limit, the
application knows that the bus process will never carry out the order. Orders that end something
(:attr:`dpstack.machine.Order.ends`) have no limit.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import socket
import subprocess
from collections.abc import Callable
from functools import partial
from time import monotonic_ns
from typing import Final

from msgspec import Struct, structs

from dpstack.drivers.futures import wait_through_cancellation
from dpstack.drivers.line.shutdown import EndOrder
from dpstack.drivers.process.early_start import Begun, started
from dpstack.drivers.process.messages import (
    Answer,
    CloseBus,
    Frames,
    Hello,
    News,
    Outbox,
    Question,
    SetUp,
    error_of,
    named,
    received,
    typed,
)
from dpstack.drivers.process.shared_image import SharedImage, Word
from dpstack.drivers.runtime import stopped_by
from dpstack.errors import BusError, DpError, OrderDropped, UsageError
from dpstack.machine import Order
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S, ms_text, ns_to_s

#: after this time without a heartbeat a bus process counts as silent; it drops orders and outputs that it reads later
#: than this
LIMIT_NS: Final = NS_PER_S
#: time limit of the answer to an order that the bus process has taken (a plugin may have to be imported)
ANSWER_NS: Final = 5 * NS_PER_S
#: time limit of the answer of a silent bus process to an order that ends something
_AGAIN_NS: Final = 500 * NS_PER_MS
#: the interpreter starts, the plugins are imported, the port is opened
START_LIMIT_NS: Final = 30 * NS_PER_S
_END_S: Final = 3.0
#: interval of the checks whether an ending bus process has ended
_LOOK_S: Final = 0.005
#: chunks that are read before an order counts as unanswered: more than a bus process keeps for a slow reader
_CHUNKS: Final = 16
#: the end of a bus takes longer by at most this if the bus process hangs: four orders, and its own end
CLOSE_LIMIT_S: Final = (ANSWER_NS + 3 * _AGAIN_NS) / NS_PER_S + 2 * _END_S


class _Sent(Struct):
    """An order that the bus process has not answered. ``answer`` None: no caller awaits it.

    ``others_unanswered``: an earlier order had no answer when this one was sent. ``until``: time of the next check of
    this order. ``on_done``: called with the order once the bus process has carried it out.
    """

    order: Order
    answer: asyncio.Future[object] | None
    on_done: Callable[[Order], None] | None
    began: int
    until: int
    others_unanswered: bool


class Channel:
    """Starts the bus process and exchanges messages with it. ``on_news`` is called with its messages.

    ``on_refused`` is called with an order that nobody awaits and that the bus process refused, or dropped, and the
    error. ``why_gone`` makes the error of a bus process that ended unasked from its exit code (negative: a signal;
    None: it runs on, but has hung up) and its last message; from then on every order raises that error. ``on_gone`` is
    called with it after all earlier news.
    """

    def __init__(
        self,
        on_news: Callable[[News], None],
        on_refused: Callable[[Order, DpError], None],
        why_gone: Callable[[int | None, News | None], DpError],
        on_gone: Callable[[DpError], None],
    ) -> None:
        self._on_news = on_news
        self._on_refused = on_refused
        self._why_gone = why_gone
        self._on_gone = on_gone
        self._loop: asyncio.AbstractEventLoop | None = None
        self._sock: socket.socket | None = None
        self._outbox: Outbox | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._frames = Frames(News)
        self._hello: asyncio.Future[Hello] | None = None
        self._last_words: News | None = None
        self._unread = False  # no memory was left to read the messages of the bus process
        self._number = 0
        self._sent: dict[int, _Sent] = {}
        self._gone: DpError | None = None
        self._silent = False  # an answer is overdue, and no news has come since
        self._has_hung_up = False  # the bus process has closed its socket without an order to end
        self._image: SharedImage | None = None

    @property
    def pid(self) -> int | None:
        """The process id, once it was started."""
        return None if self._process is None else self._process.pid

    @property
    def is_open(self) -> bool:
        return self._sock is not None and self._gone is None

    def silent_ns(self) -> int:
        """Age in ns of the last heartbeat of the bus process; 0 while it is below :data:`LIMIT_NS`."""
        if self._image is None or not self.is_open or not self._image.words[Word.HEARTBEAT]:
            return 0
        silent = monotonic_ns() - self._image.words[Word.HEARTBEAT]
        return silent if silent > LIMIT_NS else 0

    async def start(self, setup: SetUp, memory: int, image: SharedImage, begun: Begun | None = None) -> Hello:
        """Start it with the shared memory behind the descriptor ``memory``, here mapped as ``image``; ``begun`` waits
        for its set-up already.

        Raises PortError, ConfigError, BusError.
        """
        self._image = image
        self._loop = loop = asyncio.get_running_loop()
        self._hello = loop.create_future()
        ctrl_z = callable(signal.getsignal(signal.SIGTSTP))  # it decides when both are stopped, maybe after Clear
        try:
            if begun is None:
                ours, theirs = socket.socketpair()
                self._sock = ours
                with theirs:
                    self._process = started(theirs.fileno(), memory)
            else:
                ours = self._sock = begun.sock
                self._process = begun.process
            ours.setblocking(False)
            self._outbox = Outbox(loop, ours)
            self._outbox.send(Question(0, named(structs.replace(setup, ctrl_z=ctrl_z))))
            loop.add_reader(ours.fileno(), self._on_readable)
            async with asyncio.timeout(ns_to_s(START_LIMIT_NS)):
                return await self._hello
        except BaseException as error:
            self.release()
            if isinstance(error, TimeoutError):
                raise BusError(f"the bus process did not start within {ns_to_s(START_LIMIT_NS):g} s") from None
            if isinstance(error, OSError) and not isinstance(error, DpError):
                raise not_started(error) from None
            raise

    async def ended(self) -> None:
        """Wait until the process has ended by itself, with a limit. Cancellations do not stop it.

        It polls: a thread would need the descriptor by which threads wake up the loop, and the child of a fork may have
        removed that descriptor from the loop.
        """
        process, loop = self._process, self._loop
        if process is None or loop is None or self._silent:
            return
        over: asyncio.Future[None] = loop.create_future()
        self._when_ended(partial(over.set_result, None))
        with contextlib.suppress(asyncio.CancelledError):
            await wait_through_cancellation(over)

    def _when_ended(self, then: Callable[[], object]) -> None:
        """Call ``then()`` when the process has ended, or :data:`_END_S` are over."""
        loop, process = self._loop, self._process
        limit = monotonic_ns() + round(_END_S * NS_PER_S)

        def look() -> None:
            if process is None or process.poll() is not None or monotonic_ns() > limit:
                then()
            elif loop is not None and not loop.is_closed():
                loop.call_later(_LOOK_S, look)

        look()

    def _continue_stopped(self) -> None:
        """Continue a process that somebody has stopped (SIGSTOP), so that it makes the ordered end of the bus."""
        if self._process is not None:
            self._process.send_signal(signal.SIGCONT)

    def hang_up_and_wait(self, error: DpError) -> bool:
        """Hang up without a loop; the process makes its ordered end. Whether it has ended in time; it is not killed."""
        self.hang_up(error)
        self.disconnect()
        self._continue_stopped()
        process = self._process
        if process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_END_S)
        return process is None or process.poll() is not None

    def release_after_fork(self) -> None:
        """In the child of a fork: the process and the loop are the parent's."""
        self._gone = UsageError("the bus process belongs to the parent of this process")
        sock, self._sock = self._sock, None
        process, self._process = self._process, None
        if sock is not None:
            sock.close()
        if process is not None:
            process.returncode = 0  # it is no child of this process

    def hang_up(self, error: DpError) -> None:
        """No more orders: ``error`` says why."""
        self._gone = self._gone or error
        sent, self._sent = self._sent, {}
        for one in sent.values():
            if one.answer is not None and not one.answer.done():
                one.answer.set_exception(self._gone)

    def release(self) -> bool:
        """Close the socket and make sure that the process has ended. True when it had to be killed."""
        self.disconnect()
        process = self._process
        if process is None or process.poll() is not None:
            return False
        process.kill()
        process.wait()
        return True

    # --- orders and answers -----------------------------------------------------------------------------------------

    def order(self, order: Order, on_done: Callable[[Order], None] | None = None) -> asyncio.Future[object]:
        """Send ``order``; the future ends with the answer of the bus process, or raises. ``on_done`` is called before.

        It raises OrderDropped when the bus process does not take the order in time, BusError when it is gone, or took
        the order and does not answer.
        """
        answer: asyncio.Future[object] = asyncio.get_running_loop().create_future()
        try:
            self._send(order, answer, on_done)
        except Exception as error:
            answer.set_exception(error)
        return answer

    def send(self, order: Order) -> None:
        """Send ``order``; ``on_refused`` is called if the bus process refuses or drops it.

        Raises UsageError before the start of the bus process, OrderDropped while it is silent, its end's reason later.
        """
        self._send(order, None)

    def send_unless_full(self, order: Order) -> None:
        """Send ``order`` without an answer, unless the bus process has stopped reading. Raises as :meth:`send`."""
        if not self.silent_ns() and (self._outbox is None or not self._outbox.waiting):
            self._send(order, None)
            self._sent.pop(self._number, None)

    def _send(
        self, order: Order, answer: asyncio.Future[object] | None, on_done: Callable[[Order], None] | None = None
    ) -> None:
        if self._gone is not None:
            raise self._gone
        if self._process is None or self._loop is None:
            raise UsageError("the driver is not open: await open() first")
        began = monotonic_ns()
        silent = self.silent_ns()
        if silent and not order.ends:
            raise OrderDropped(
                f"the bus process (pid {self.pid}) has shown no sign of life for {ms_text(silent)} (it is stopped, or "
                "hangs): the order was dropped"
            )
        number = self._number + 1
        limit = began + (_AGAIN_NS if silent or self._silent else LIMIT_NS)
        if self._outbox is not None:  # else it has hung up: how it ended is known soon
            self._outbox.send(Question(number, named(order), NEVER if order.ends else limit))
        if isinstance(order, EndOrder | CloseBus) and (silent or self._silent):
            self._continue_stopped()
        self._number = number
        self._sent[number] = _Sent(order, answer, on_done, began, limit, self._silent)
        if answer is not None:
            self._loop.call_later(ns_to_s(limit - began), self._check_answer, number)

    def _check_answer(self, number: int) -> None:
        """The time for the answer to order ``number`` is over."""
        for _ in range(_CHUNKS):  # this program itself may have been late
            if number not in self._sent or not self._on_readable():
                break
        sent, image = self._sent.get(number), self._image
        if sent is None or sent.answer is None or image is None or self._loop is None or self._sock is None:
            return
        taken = image.words[Word.ORDER_TAKEN] >= number
        if taken and not sent.others_unanswered and sent.until <= sent.began + LIMIT_NS:
            sent.until = sent.began + ANSWER_NS
            self._loop.call_later(ns_to_s(max(0, sent.until - monotonic_ns())), self._check_answer, number)
            return
        self._silent = True
        del self._sent[number]
        if not sent.answer.done():
            sent.answer.set_exception(self._unanswered(taken=taken, ending=sent.order.ends))

    def _unanswered(self, *, taken: bool, ending: bool) -> BusError:
        who = f"the bus process (pid {self.pid})"
        if taken:
            limit = ms_text(ANSWER_NS)
            return BusError(f"{who} took the order and did not answer within {limit}: whether it did it is not known")
        if ending:
            return BusError(f"{who} does not answer (it is stopped, or hangs); it carries the order out if it goes on")
        limit = ms_text(LIMIT_NS)
        return OrderDropped(f"{who} did not take the order within {limit} (it is stopped, or hangs): it was dropped")

    def _on_readable(self) -> bool:
        """Read news of the bus process; False if there are no more."""
        octets = None if self._sock is None else received(self._sock)
        if octets is None:
            return False
        if not octets:
            self._hung_up()
            return False
        self._silent = False
        try:
            for news in self._frames.feed(octets):
                if news.over is not None:
                    self._last_words = news
                self._on_news(news)
                if news.answer is not None:
                    self._on_answer(news.answer)
        except MemoryError:  # the rest of the stream is lost: the bus process ends the bus by itself
            self._unread = True
            self._hung_up()
            raise
        except BusError as error:
            self.give_up(error)
            return False
        return True

    def give_up(self, error: BusError) -> None:
        """Hang up on a bus process that cannot be understood: it counts as gone at once, and ends the bus in order."""
        if self._sock is not None:
            self._last_words = News(over=stopped_by(error), defect=True)
            self.disconnect()
            self._is_gone()

    def _on_answer(self, answer: Answer) -> None:
        hello = self._hello
        if not answer.number and hello is not None and not hello.done():
            if answer.error is None:
                hello.set_result(typed(answer.value, Hello))
            else:
                hello.set_exception(error_of(answer.error))
            return
        sent = self._sent.pop(answer.number, None)
        if sent is None:
            return
        if answer.error is None and sent.on_done is not None:
            sent.on_done(sent.order)
        if answer.error is None and isinstance(sent.order, CloseBus):
            # the process may be gone before the task that awaits this answer runs again
            self._gone = self._gone or UsageError("the bus is closed")
        if sent.answer is None:
            if answer.error is not None and not sent.order.ends:
                self._on_refused(sent.order, error_of(answer.error))
        elif sent.answer.done():  # the awaiting task was cancelled
            return
        elif answer.error is not None:
            sent.answer.set_exception(error_of(answer.error))
        else:
            sent.answer.set_result(answer.value)

    # --- the end ----------------------------------------------------------------------------------------------------

    def _hung_up(self) -> None:
        """The bus process is gone, or about to be."""
        self._has_hung_up = True
        self.disconnect()
        self._when_ended(self._is_gone)

    def settle(self) -> None:
        """End every order now if the bus process has hung up unasked, and report how it ended."""
        if self._has_hung_up and self._gone is None:
            self._is_gone()

    def _is_gone(self) -> None:
        process = self._process
        if process is None:
            return
        asked_for = self._gone is not None
        last = self._last_words
        if self._unread and process.poll() == 0:
            last = News(over="this program has no memory left to read its messages")
        error = self._gone or self._why_gone(process.poll(), last)
        self.hang_up(error)
        if self._hello is not None and not self._hello.done():
            self._hello.set_exception(error)
        elif not asked_for:
            self._on_gone(error)

    def disconnect(self) -> None:
        """Close the socket: a bus process that still runs makes the ordered end."""
        sock, self._sock = self._sock, None
        outbox, self._outbox = self._outbox, None
        if sock is not None:
            if self._loop is not None and not self._loop.is_closed():
                self._loop.remove_reader(sock.fileno())
                if outbox is not None:
                    outbox.forget()
            sock.close()


def not_started(error: OSError) -> BusError:
    """The error if the system has no descriptors, memory or processes left for a bus process."""
    why = error.strerror or str(error)
    return BusError(f'the bus process cannot be started ({why}): raise that limit, or take driver = "asyncio"')
