"""The process driver: the bus runs in a process of its own, and the application's is told.

An order waits for its answer, for :data:`ANSWER_S` at most: misuse raises at once in the caller and what an order
changes is seen when it returns, as with every other driver. It takes the bus process a turn of its loop. Nothing else
waits: process image and outputs stand in shared memory, states come with the events.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import itertools
import os
import select
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Callable
from time import monotonic, monotonic_ns
from typing import Final

from dpstack.dp.commands import AddSlave, DriveCommand, RemoveSlave, ReparameteriseSlave
from dpstack.dp.events import SlaveState
from dpstack.dp.survey import SurveyOrder, SurveyResult
from dpstack.drivers.base import OnEvents, OnFailure
from dpstack.drivers.lateness import Lateness
from dpstack.drivers.messages import (
    Answer,
    AskCounters,
    AskUnit,
    AttachPlugin,
    CloseBus,
    Counters,
    EndSurvey,
    Frames,
    Hello,
    Message,
    News,
    Question,
    SetUp,
    StartSurvey,
    WatchRounds,
    error_of,
    event_of,
    framed,
    named,
    typed,
)
from dpstack.drivers.mirror import MasterMirror, Mirror, SlaveMirror, StationMirror, WatcherMirror, checked_arguments
from dpstack.drivers.plugins import PluginRef
from dpstack.drivers.process_end import how_it_ended
from dpstack.drivers.shared_image import Picture, SharedImage, make_memory, output_octets, read_picture
from dpstack.errors import BusError, DpError, UsageError
from dpstack.stats import Histogram
from dpstack.units import NS_PER_MS

#: an order that is not answered so long: the bus process hangs, or is stopped
ANSWER_S: Final = 5.0
#: the interpreter starts, the plugins are imported, the port is opened (an rfc2217:// port waits for its server)
_START_S: Final = 30.0
_END_S: Final = 3.0
#: counters asked for so shortly before are still those of this moment
_FRESH_NS: Final = 10 * NS_PER_MS
_CHUNK: Final = 65_536
_EMPTY: Final = Picture(0, 0, {})
_numbers = itertools.count(1)


class ProcessRuntime:
    """Implements :class:`dpstack.drivers.base.Runtime`; ``mirror`` is what is known of the machines over there.

    ``on_failure`` is told when the bus process ends without having been told to.
    """

    def __init__(self, setup: SetUp, on_events: OnEvents, on_failure: OnFailure) -> None:
        spec = setup.stack
        self.mirror = Mirror(
            MasterMirror(spec.slaves, self, read_only=spec.read_only),
            StationMirror(spec.params, spec.patience, self),
            WatcherMirror() if spec.read_only and spec.watched else None,
        )
        self.port_name = setup.port
        self.paced = False
        self._setup = setup
        self._on_events = on_events
        self._on_failure = on_failure
        self._loop: asyncio.AbstractEventLoop | None = None
        self._sock: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._image: SharedImage | None = None
        self._frames = Frames()
        self._hello: asyncio.Future[Hello] | None = None
        self._inbox: deque[News] = deque()
        self._dispatching = False
        self._number = 0
        self._awaited: set[int] = set()
        self._answers: dict[int, Answer] = {}
        self._last_news: News | None = None  # that it is over
        self._gone: DpError | None = None
        self._picture = _EMPTY
        self._outputs: dict[int, bytes] = {}
        self._counters = Counters()
        self._counted_ns = -_FRESH_NS
        self._surveys: dict[int, SurveyResult] = {}

    # --- Runtime ----------------------------------------------------------------------------------------------------

    @property
    def pid(self) -> int | None:
        """The process id of the bus process while there is one."""
        return None if self._process is None else self._process.pid

    @property
    def lateness(self) -> Lateness:
        """How late answers arrive, up to now."""
        made = Lateness()
        made.histogram = Histogram.of(self.counters().lateness)
        return made

    def damage(self) -> dict[str, int]:
        """Octets that arrived damaged, by cause."""
        return dict(self.counters().damage)

    def now(self) -> int:
        """CLOCK_MONOTONIC in ns, which both processes share."""
        return monotonic_ns()

    async def open(self) -> None:
        """Start the bus process, which opens the port. Raises PortError and ConfigError as it does, and BusError."""
        if self._process is not None:
            raise UsageError("the driver is open already")
        self._loop = loop = asyncio.get_running_loop()
        self._start()
        try:
            assert self._sock is not None
            self._hello = loop.create_future()
            async with asyncio.timeout(_START_S):
                await loop.sock_sendall(self._sock, framed(Message(question=Question(0, named(self._setup)))))
                loop.add_reader(self._sock.fileno(), self._on_readable)
                hello = await self._hello
        except BaseException as error:
            self._release(kill=True)
            if isinstance(error, TimeoutError):
                raise BusError(f"the bus process did not start within {_START_S:g} s") from None
            raise
        self.port_name, self.paced = hello.port_name, hello.paced

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        memory = make_memory()
        try:
            self._image = SharedImage(memory)
            ours.setblocking(False)
            self._sock = ours
            numbers = (theirs.fileno(), memory)
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "dpstack.drivers.child", *map(str, numbers), str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=numbers,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            )
        finally:
            theirs.close()
            os.close(memory)

    async def close(self) -> None:
        """Have the port released and the bus process end; the bus was left in order before. May be called again."""
        process = self._process
        if process is None or self._sock is None:
            return
        try:
            if self._gone is None:
                with contextlib.suppress(DpError):
                    self._counters = typed(self._ask(CloseBus()), Counters)
            self._gone = self._gone or UsageError("the bus is closed")
            if self._loop is not None and self._sock is not None:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    await self._loop.run_in_executor(None, process.wait, _END_S)
        finally:
            self._release(kill=False)

    def command(self, command: object) -> None:
        """Hand an order to the machines and wait until they have taken it. What they raise is raised here."""
        handlers = self.mirror.master.handlers
        match command:
            case AddSlave(setup) if setup.address not in handlers:
                handlers[setup.address] = SlaveMirror(setup, self)
                try:
                    self._ask(command)
                except BaseException:
                    del handlers[setup.address]
                    raise
            case ReparameteriseSlave(setup) if setup.address in handlers:
                before = handlers[setup.address]
                after = handlers[setup.address] = SlaveMirror(setup, self, before)
                try:
                    self._ask(command)
                except BaseException:
                    handlers[setup.address] = before
                    raise
                if after.image is not before.image:
                    self.put_outputs(setup.address, None)
            case RemoveSlave(address):
                self._ask(command)
                self.put_outputs(address, None)
                handlers.pop(address, None)
            case EndSurvey(number):
                self._surveys.pop(number, None)
                self._ask(command)
            case DriveCommand(args=args):
                self._ask(dataclasses.replace(command, args=checked_arguments(args)))
            case _:
                self._ask(command)

    # --- what else the bus process does -------------------------------------------------------------------------------

    def attach_plugin(self, address: int, plugin: PluginRef) -> None:
        """Put a drive plugin onto a process image over there. Raises ConfigError when it cannot be imported.

        The plugins that the bus process is started with stand there already.
        """
        if self._sock is not None:
            self._ask(AttachPlugin(address, plugin))
        self.mirror.master.handlers[address].image.unit = plugin

    def unit_status(self, address: int) -> object | None:
        """What the cyclic unit of a slave tells, as plain data; None when nobody can be asked any more."""
        if self._gone is not None or self._sock is None:
            return None
        return self._ask(AskUnit(address))

    def survey_result(self, number: int) -> SurveyResult | None:
        """What came of the live list with ``number``; None until it is complete."""
        return self._surveys.get(number)

    # --- the source of the mirror -------------------------------------------------------------------------------------

    def picture(self) -> Picture:
        """The newest whole process image."""
        octets = None if self._image is None else self._image.inputs.read()
        if octets is not None:
            self._picture = read_picture(octets)
        return self._picture

    def counters(self) -> Counters:
        """What was counted: asked for anew, but at most every 10 ms; the last ones when the bus is over."""
        now = monotonic_ns()
        if self._gone is None and self._sock is not None and now - self._counted_ns >= _FRESH_NS:
            with contextlib.suppress(BusError):
                self._counters = typed(self._ask(AskCounters()), Counters)
                self._counted_ns = now
        return self._counters

    def put_outputs(self, address: int, octets: bytes | None) -> None:
        """Publish the application's outputs of one slave, with those of all others."""
        if octets is None:
            self._outputs.pop(address, None)
        else:
            self._outputs[address] = octets
        if self._image is not None:
            self._image.outputs.write(output_octets(self._outputs))

    def watch_rounds(self, on: bool) -> None:
        """Have the ends of rounds told, or no longer."""
        if self._gone is None and self._sock is not None:
            self._ask(WatchRounds(on))

    # --- question and answer ------------------------------------------------------------------------------------------

    def _ask(self, order: object) -> object:
        if self._gone is not None:
            raise self._gone
        if self._sock is None:
            raise UsageError("the driver is not open: await open() first")
        self._number += 1
        number = self._number
        self._awaited.add(number)
        try:
            end = monotonic() + ANSWER_S
            self._send(framed(Message(question=Question(number, named(order)))), end)
            while number not in self._answers:
                self._wait(end, reading=True)
            answer = self._answers.pop(number)
        finally:
            self._awaited.discard(number)
        if answer.error is not None:
            raise error_of(answer.error)
        return answer.value

    def _send(self, octets: bytes, end: float) -> None:
        left = memoryview(octets)
        while left and self._sock is not None:
            try:
                left = left[self._sock.send(left) :]
            except BlockingIOError:
                self._wait(end, reading=False)
            except OSError:
                self._hung_up()

    def _wait(self, end: float, *, reading: bool) -> None:
        """For octets of the bus process, or for room to write; what it says meanwhile is taken."""
        sock = self._sock
        if sock is not None:
            writers = [] if reading else [sock]
            ready, room, _ = select.select([sock], writers, [], max(0.0, end - monotonic()))
            if ready:
                self._on_readable()
            elif not room:
                raise BusError(f"the bus process (pid {self.pid}) did not answer within {ANSWER_S:g} s")
        if self._gone is not None and sock is None:
            raise self._gone

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
        for message in self._frames.feed(octets):
            if message.news is not None:
                self._inbox.append(message.news)
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
                self._hand_on(self._inbox.popleft())
        finally:
            self._dispatching = False

    def _hand_on(self, news: News) -> None:
        if news.over is not None:
            self._last_news = news
        self.mirror.take(news)
        self._surveys |= news.surveys
        try:
            if news.round_over:
                on_round = self.mirror.master.on_round
                if on_round is not None:
                    on_round(monotonic_ns())
            else:
                self._on_events([self.mirror.worded(event_of(event)) for event in news.events])
        except Exception as error:
            if self._loop is not None:
                self._loop.call_exception_handler({"message": "the handler of bus events raised", "exception": error})

    # --- the end ------------------------------------------------------------------------------------------------------

    def _hung_up(self) -> None:
        """The bus process is gone, or about to be."""
        process, sock = self._process, self._sock
        if sock is None or process is None:
            return
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_END_S)
        self.picture()
        watchdogs = {
            slave.setup.name: slave.watchdog_effective_ns
            for slave in self.mirror.master.handlers.values()
            if slave.state is SlaveState.DATA_EXCHANGE
        }
        closed, self._gone = self._gone, self._gone or how_it_ended(process.returncode, self._last_news, watchdogs)
        self._disconnect()
        if self._hello is not None and not self._hello.done():
            self._hello.set_exception(self._gone)
        elif closed is None:
            self.mirror.lost()
            self._on_failure(self._gone)

    def _disconnect(self) -> None:
        sock, self._sock = self._sock, None
        if sock is not None:
            if self._loop is not None and not self._loop.is_closed():
                self._loop.remove_reader(sock.fileno())
            sock.close()

    def _release(self, *, kill: bool) -> None:
        """Whatever state it is in: no process and no descriptor is left behind."""
        self._disconnect()
        process = self._process
        if process is not None and process.poll() is None:
            if kill:
                process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_END_S)
            if process.poll() is None:
                process.kill()
                process.wait()
        if self._image is not None:
            self.picture()
            self._image.close()
            self._image = None


class ProcessSurvey:
    """One live list made by ``runtime``'s bus process; ``command`` takes its orders. A :class:`Survey`."""

    def __init__(self, runtime: ProcessRuntime, command: Callable[[object], None], order: SurveyOrder) -> None:
        self._runtime = runtime
        self._command = command
        self._number = next(_numbers)
        command(StartSurvey(self._number, order))

    @property
    def result(self) -> SurveyResult | None:
        """None until everything was asked."""
        return self._runtime.survey_result(self._number)

    def end(self) -> None:
        """Nobody wants it any more."""
        self._command(EndSurvey(self._number))
