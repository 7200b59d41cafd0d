"""The process driver: the bus runs in a process of its own, and the application's is told.

An order waits for its answer, for :data:`dpstack.drivers.link.ANSWER_S` at most: misuse raises at once in the caller,
and what an order changes is seen when it returns, as with every other driver. It takes the bus process a turn of its
loop. Nothing else waits: process image and outputs stand in shared memory, states come with the events.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import itertools
import os
from collections.abc import Callable
from time import monotonic_ns
from typing import Final

from dpstack.dp.commands import AddSlave, DriveCommand, RemoveSlave, ReparameteriseSlave
from dpstack.dp.events import SlaveState
from dpstack.dp.survey import SurveyOrder, SurveyResult
from dpstack.drivers.aio import outlast
from dpstack.drivers.base import OnEvents, OnFailure
from dpstack.drivers.lateness import Lateness
from dpstack.drivers.link import CLOSE_LIMIT_S, Link
from dpstack.drivers.messages import (
    AskCounters,
    AskUnit,
    AttachPlugin,
    CloseBus,
    Counters,
    EndSurvey,
    News,
    SetUp,
    StartSurvey,
    WatchRounds,
    event_of,
    typed,
)
from dpstack.drivers.mirror import MasterMirror, Mirror, SlaveMirror, StationMirror, WatcherMirror, checked_arguments
from dpstack.drivers.plugins import PluginRef
from dpstack.drivers.process_end import how_it_ended, killed_at_the_end
from dpstack.drivers.shared_image import Picture, SharedImage, make_memory, output_octets, read_picture
from dpstack.errors import BusError, DpError, UsageError
from dpstack.stats import Histogram
from dpstack.trace import Notice, Severity
from dpstack.units import NS_PER_MS, NS_PER_S, s_to_ns

#: counters asked for so shortly before are still those of this moment, unless a later picture was seen
_FRESH_NS: Final = NS_PER_MS
#: a bus process that did not answer is not asked for them again so soon: they are asked for many times in one go
_AGAIN_NS: Final = NS_PER_S
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
        self._link = Link(self._on_news, self._why_gone, self._on_gone)
        self._image: SharedImage | None = None
        self._picture = _EMPTY
        self._outputs: dict[int, bytes] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._publishing: asyncio.Handle | None = None
        self._counters = Counters()
        self._counted_ns = -_FRESH_NS
        self._unanswered_ns = -_AGAIN_NS
        self._surveys: dict[int, SurveyResult] = {}

    # --- Runtime ----------------------------------------------------------------------------------------------------

    @property
    def pid(self) -> int | None:
        """The process id of the bus process while there is one."""
        return self._link.pid

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
        if self._link.pid is not None:
            raise UsageError("the driver is open already")
        self._loop = asyncio.get_running_loop()
        memory = make_memory()
        try:
            self._image = SharedImage(memory)
            self._image.outputs.write(output_octets(self._outputs))
            hello = await self._link.start(self._setup, memory)
        finally:
            os.close(memory)
            if not self._link.is_open:
                self._close_image()
        self.port_name, self.paced = hello.port_name, hello.paced

    async def close(self) -> None:
        """Have the port released and the bus process end; the bus was left in order before. May be called again."""
        link = self._link
        try:
            if link.is_open:
                with contextlib.suppress(DpError):
                    self._counters = typed(self._ask(CloseBus()), Counters)
                link.hang_up(UsageError("the bus is closed"))
                await outlast(asyncio.ensure_future(link.ended()))
        finally:
            if link.release(kill=False):
                text = killed_at_the_end(self._watchdogs())
                self._on_events(
                    [Notice(t_ns=monotonic_ns(), source="bus process", message=text, severity=Severity.ERROR)]
                )
            self._close_image()

    @property
    def close_limit_ns(self) -> int:
        """Orders that a hanging bus process does not answer, and its end."""
        return s_to_ns(CLOSE_LIMIT_S)

    def end_without_loop(self) -> str:
        """Hang up: the bus process makes the ordered end by itself. Waits for it, and never kills it."""
        ended = self._link.hang_up_and_wait(UsageError("the bus is closed"))
        self._close_image()
        return "" if ended else f"the bus process (pid {self.pid}) has not ended yet"

    def forsake(self) -> None:
        """The bus process is the parent's: the child closes its copies of what leads there."""
        self._link.forsake()
        if self._image is not None:
            self._image.close()
            self._image = None

    def _close_image(self) -> None:
        if self._image is not None:
            self.picture()
            self._image.close()
            self._image = None

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
        if self._link.is_open:
            self._ask(AttachPlugin(address, plugin))
        self.mirror.master.handlers[address].image.unit = plugin

    def unit_status(self, address: int) -> object | None:
        """What the cyclic unit of a slave tells, as plain data; None when nobody can be asked any more."""
        if not self._link.is_open:
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
        """What was counted, never less than a picture has told; the last ones when the bus is over."""
        now = monotonic_ns()
        fresh = now - self._counted_ns < _FRESH_NS and self._counters.rotation.count >= self._picture.rotations
        if self._link.is_open and not fresh and now - self._unanswered_ns >= _AGAIN_NS:
            try:
                self._counters = typed(self._ask(AskCounters()), Counters)
                self._counted_ns = now
            except BusError:
                self._unanswered_ns = monotonic_ns()
        return self._counters

    def put_outputs(self, address: int, octets: bytes | None) -> None:
        """Publish the application's outputs of one slave, with those of all others."""
        if octets is None:
            self._outputs.pop(address, None)
        else:
            self._outputs[address] = octets
        if self._publishing is None and self._loop is not None and not self._loop.is_closed():
            self._publishing = self._loop.call_soon(self._publish)

    def _publish(self) -> None:
        """What was set in one go, or before an order, goes out in one: a round never has the half of it."""
        if self._publishing is not None:
            self._publishing.cancel()
            self._publishing = None
            if self._image is not None:
                self._image.outputs.write(output_octets(self._outputs))

    def _ask(self, order: object) -> object:
        self._publish()
        return self._link.ask(order)

    def watch_rounds(self, on: bool) -> None:
        """Have the ends of rounds told, or no longer."""
        if self._link.is_open:
            self._ask(WatchRounds(on))

    # --- from the bus process ---------------------------------------------------------------------------------------

    def _on_news(self, news: News) -> None:
        self.mirror.take(news)
        self._surveys |= news.surveys
        try:
            if news.round_over:
                on_round = self.mirror.master.on_round
                if on_round is not None:
                    on_round(monotonic_ns())
            else:
                self._on_events([self.mirror.worded(event_of(event)) for event in news.events])
        except Exception as error:  # the application's: the bus goes on
            asyncio.get_running_loop().call_exception_handler(
                {"message": "the handler of bus events raised", "exception": error}
            )

    def _why_gone(self, code: int | None, last: News | None) -> DpError:
        return how_it_ended(code, last, self._watchdogs())

    def _watchdogs(self) -> dict[str, int]:
        """Of the slaves that are in data exchange as far as is known, in ns."""
        return {
            slave.setup.name: slave.watchdog_effective_ns
            for slave in self.mirror.master.handlers.values()
            if slave.state is SlaveState.DATA_EXCHANGE
        }

    def _on_gone(self, error: DpError) -> None:
        self.mirror.lost()
        self._on_failure(error)


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
