"""Main object of the bus process: machines and driver of one bus, orders from the application, news to it."""

from __future__ import annotations

import contextlib
import gc
import socket
from collections import deque
from functools import partial
from time import monotonic_ns
from typing import Final

from dpstack.dp.master.commands import Mode, SendControl, Shutdown
from dpstack.dp.master.events import DriveEvent, SlaveEvent
from dpstack.dp.master.fixed_cycle import CycleData
from dpstack.dp.pdu import layouts
from dpstack.dp.process_image import CyclicPlugin, SlaveImage
from dpstack.drivers.line.last_clear import LastClear
from dpstack.drivers.line.select_loop import SelectLoop
from dpstack.drivers.line.select_runtime import SelectRuntime
from dpstack.drivers.line.shutdown import Ending
from dpstack.drivers.process.messages import (
    Answer,
    CloseBus,
    Frames,
    Hello,
    LoadFdl,
    LoadServices,
    News,
    Outbox,
    Question,
    ReadHistory,
    SetUp,
    TakeOutputs,
    error_pair,
    named,
    order_of,
    received,
)
from dpstack.drivers.process.plugins import AttachPlugin, do_beside, load
from dpstack.drivers.process.shared_image import Picture, SharedImage, Word
from dpstack.drivers.realtime.processors import AwakeProcessors
from dpstack.drivers.runtime import stopped_by
from dpstack.drivers.snapshots import BusSnapshot, ImageSnapshot
from dpstack.drivers.stack import Stack, image_snapshot
from dpstack.drivers.tap import TAP_PORTION, TAP_SHORT_PAUSE_NS, Tap
from dpstack.errors import BusError, OrderDropped, UsageError
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.ports import open_port
from dpstack.trace import Event, Notice, Severity
from dpstack.units import NEVER, NS_PER_MS, ms_text

#: interval of the heartbeat; the bus process reads the application's outputs at least as often
_HEARTBEAT: Final = 20 * NS_PER_MS
#: after this many heartbeats come the counters, changes without an event, the octets of a tap, and news held back for
#: an application that did not read
_BEATS_TO_NEWS: Final = 5
#: interval of the statuses of the drives, if the rounds are not watched and no event comes
_DRIVES_NS: Final = 10 * NS_PER_MS
#: after a SIGTERM the bus process waits this long for the application to begin the end
_GRACE: Final = 200 * NS_PER_MS
#: the bus process reads no more orders while this many wait
_WAITING: Final = 32


def _notice(text: str) -> Notice:
    return Notice(t_ns=monotonic_ns(), source="bus process", message=text, severity=Severity.WARNING)


def _load_fdl() -> None:
    from dpstack.fdl.services import requester  # noqa: F401 (here, as most buses have no use for it)


def _load_services() -> None:
    from dpstack.dp.acyclic import class2  # noqa: F401 (these here, as most buses have no use for them)
    from dpstack.dp.pdu import pa_diagnosis, redundancy  # noqa: F401
    from dpstack.dpv1.master import alarm_handler, ms2  # noqa: F401

    layouts.load()


class Host:
    """Machines and driver of one bus in ``loop``. ``sock``: connection to the application; ``image``: shared with it.

    Raises ConfigError and PortError (:meth:`open`). Stops the loop after the end of the bus.
    """

    def __init__(self, loop: SelectLoop, sock: socket.socket, image: SharedImage, setup: SetUp) -> None:
        self._loop = loop
        self._sock = sock
        self._image = image
        self._frames = Frames(Question)
        self._questions: deque[Question] = deque()
        self._outbox = Outbox(loop, sock)
        self._stack = stack = Stack(setup.stack, late_services=True)
        self._master, self._station = stack.master, stack.station
        for plugin in setup.plugins:
            self._handler_image(plugin.address).plugin = load(plugin)
        self.runtime = SelectRuntime(
            open_port(setup.port, setup.stack.params.baud, event_char=setup.event_char, rs485=setup.rs485),
            self._station,
            self.on_events,
            echo=setup.echo,
            on_failure=self._on_failure,
            tune=self._station.set_patience if setup.tune else None,
            last_clear=LastClear(self._station),
        )
        stack.line = self.runtime
        self._ending = Ending(
            loop, self.runtime.command, stack.station, lambda: stack.master.rotation.max_ns, self._finish
        )
        self._loads_layouts = any(slave.dpv1 is not None for slave in setup.stack.slaves)
        self._has_loaded = False
        self._rounds_watched = False
        self._tap: Tap | None = None
        self._tap_goes_on = False  # the next portion is due soon
        self._awake = AwakeProcessors()
        self._beats = 0
        self._dropped = 0
        self._over = False
        self._leaving = False  # the application has begun the end
        self._until: dict[int, int] = {}  # the outputs that were taken or dropped, by address and deadline
        self._silences = 0  # the application's last count of silences (Word.SILENCES) that was answered
        # sent or published last
        self._bus: BusSnapshot | None = None
        self._sent_cycle: CycleData | None = None
        self._published_images: dict[int, ImageSnapshot] = {}
        self._published_drives: dict[int, object] = {}
        self._drives_at = 0  # when they were published

    def open(self, notices: list[str]) -> None:
        """Open the port, say hello, listen to the application. Raises PortError, ConfigError.

        ``notices``: texts about rights that this process did not get.
        """
        self._master.on_round = self._on_round
        self._master.context.on_begin = self._take_outputs
        self.runtime.open(self._loop)
        self._image.words[Word.HEARTBEAT] = monotonic_ns()
        self._publish_counters()
        hello = Answer(0, value=Hello(self.runtime.port_name, self.runtime.paced))
        self._send_news([_notice(text) for text in notices], answer=hello)
        self._sock.setblocking(False)
        self._loop.add_reader(self._sock.fileno(), self._on_readable)
        self._on_heartbeat()

    def end(self, why: str) -> None:
        """Begin the ordered end without an order of the application: after its death, or after a signal."""
        self._ending.begin(why)

    def end_soon(self, why: str) -> None:
        """Begin the ordered end in 0.2 s, unless the application begins it first: a SIGTERM often goes to all processes
        of a program."""
        self._loop.call_at(monotonic_ns() + _GRACE, lambda: self.end(why) if not self._leaving else None)

    # --- the application's orders ---

    def _on_readable(self) -> None:
        octets = received(self._sock)
        if octets is None:
            return
        if not octets:
            self._loop.remove_reader(self._sock.fileno())
            self.end("the application is gone")
            return
        idle = not self._questions
        try:
            self._questions += self._frames.feed(octets)
        except (BusError, MemoryError) as error:  # the rest of the stream is lost
            self._loop.remove_reader(self._sock.fileno())
            self.end(str(error) or "it has no memory left")
            return
        if len(self._questions) >= _WAITING:
            self._loop.remove_reader(self._sock.fileno())
        if idle and self._questions:
            self._serve()

    def _serve(self) -> None:
        """Carry out one order in a turn of the loop, so that the bus runs between two orders."""
        question = self._questions.popleft()
        answer = Answer(question.number)
        order = None
        try:
            order = self._answer(question, answer)
        finally:  # after any exception the other orders are carried out
            self._after(order)

    def _answer(self, question: Question, answer: Answer) -> object:
        """Carry out an order and send its answer. Returns the order."""
        order = None
        self._image.words[Word.ORDER_TAKEN] = question.number  # before the clock is read: so the application knows
        try:
            late = monotonic_ns() - question.until_ns
            if late > 0:
                raise OrderDropped(f"the bus process took the order {ms_text(late)} too late and dropped it")
            order = order_of(question.order)
            if isinstance(order, AttachPlugin | LoadServices | LoadFdl):
                self._begin_beside(order, answer)
                return order
            answer.value = self._carry_out(order)
        except Exception as error:
            answer.error = error_pair(error)
        if isinstance(order, TakeOutputs) and not self._master.context.changed:  # it may come in each cycle
            self._outbox.send(News(answer=answer))
        else:
            self._send_news([], answer=answer)
        return order

    def _begin_beside(self, order: AttachPlugin | LoadServices | LoadFdl, answer: Answer) -> None:
        """Import what ``order`` needs, for which a running bus has no time, in a thread; other orders are carried out
        meanwhile. Then carry it out, and send its answer."""
        if isinstance(order, AttachPlugin):
            self._handler_image(order.address)
            do_beside(self._loop, partial(load, order), partial(self._end_beside, order, answer))
        else:
            load_parts = _load_services if isinstance(order, LoadServices) else _load_fdl
            do_beside(self._loop, load_parts, partial(self._end_beside, order, answer))

    def _end_beside(
        self,
        order: AttachPlugin | LoadServices | LoadFdl,
        answer: Answer,
        plugin: CyclicPlugin | None,
        error: Exception | None,
    ) -> None:
        if self._over:
            return
        gc.freeze()  # no collection of a running bus looks at modules
        try:
            if error is not None:
                raise error
            if isinstance(order, AttachPlugin):
                self._handler_image(order.address).plugin = plugin
                self._publish_drives()
            elif isinstance(order, LoadServices):
                self._stack.load_services()
        except Exception as failed:
            answer.error = error_pair(failed)
        self._send_news([], answer=answer)

    def _after(self, order: object) -> None:
        """Go on after an order."""
        if isinstance(order, GoOnline) and not self._has_loaded:
            # the bus listens: octets that arrive meanwhile are read before it acts, so it claims no token too early
            if self._loads_layouts:
                layouts.load()
            gc.freeze()  # no collection of a running bus looks at modules
            self._has_loaded = True
        if isinstance(order, CloseBus):
            if self._has_ended:
                self._stop()
            else:  # this process was stopped while the application ended the bus: its orders have come all at once
                self.end("the application closed the bus")
        elif self._questions:
            self._loop.call_soon(self._serve)
        else:
            self._loop.add_reader(self._sock.fileno(), self._on_readable)

    def _carry_out(self, order: object) -> object:
        match order:
            case TakeOutputs():
                self._take_outputs()
            case ReadHistory(address):
                return self._stack.bring_ups(address)
            case GoOffline() if self._master.mode is not Mode.OFFLINE:
                self.end("the application ended the bus")  # without a token no Clear could be sent
            case CloseBus():
                if self._has_ended:
                    self.runtime.close()
                    self._send_last_tapped()
                return self._stack.counted()
            case _:
                if isinstance(order, SendControl):  # it acts on the outputs that were set before it
                    self._take_outputs()
                elif isinstance(order, Shutdown):
                    self._leaving = True
                self.runtime.command(order)
        return None

    def _handler_image(self, address: int) -> SlaveImage:
        handler = self._master.handlers.get(address)
        if handler is None:
            raise UsageError(f"no slave with address {address} in the bus process")
        return handler.image

    # --- the process image ---

    def _on_round(self, _now: int) -> None:
        self.runtime.after_step(self._publish_round)

    def _publish_round(self) -> None:
        self._publish()
        watched = bool(self._image.words[Word.ROUNDS_WATCHED])
        if watched is not self._rounds_watched:
            self._rounds_watched = watched
            self._publish_counters()  # an application that waited for rounds looks at the counters next
        if watched:
            self._send_round(self._master.cycle)
        elif monotonic_ns() - self._drives_at >= _DRIVES_NS:
            self._publish_drives()

    def _publish(self) -> None:
        """Publish inputs and outputs of all slaves."""
        master = self._master
        self._published_images = {address: image_snapshot(handler) for address, handler in master.handlers.items()}
        self._image.inputs.write(Picture(master.rounds, master.rotation.count, self._published_images))

    def _publish_for(self, events: list[Event]) -> None:
        """Publish inputs and outputs as they are at ``events``: anew for their slaves, as an event of one slave says
        nothing of the others; for all slaves if an event is not of one slave."""
        master, images = self._master, self._published_images
        for event in events:
            if not isinstance(event, SlaveEvent) or event.address not in images:
                self._publish()
                return
            handler = master.handlers.get(event.address)
            if handler is None:
                del images[event.address]
            else:
                images[event.address] = image_snapshot(handler)
        self._image.inputs.write(Picture(master.rounds, master.rotation.count, images))

    def _publish_drives(self) -> None:
        """Publish the statuses of the drive plugins if one has changed."""
        if self._over:
            return
        self._drives_at = monotonic_ns()
        statuses: dict[int, object] = {}
        for address, handler in self._master.handlers.items():
            status = getattr(handler.image.plugin, "status", None)
            if status is not None:
                with contextlib.suppress(Exception):  # a defect of the plugin: the status of its drive is left out
                    statuses[address] = status()
        if statuses != self._published_drives:
            self._published_drives = statuses
            self._image.drives.write(statuses)

    def _take_outputs(self) -> None:
        """Read the outputs that the application has set since the last time. Drop those whose time limit is over: a
        process that was stopped must not send old outputs."""
        try:
            found = self._image.take_outputs()
        except BusError as error:  # the application cannot be understood
            self.end(str(error))
            return
        if found is None:
            return
        now = monotonic_ns()
        before, self._until = self._until, {}
        dropped = {}
        for address, outputs in found.items():
            until, octets = outputs.until_ns, outputs.octets
            handler = self._master.handlers.get(address)
            if handler is None or handler.image.plugin is not None or len(octets) != handler.image.output_len:
                continue
            self._until[address] = until
            if before.get(address) == until:
                continue
            if until < now:
                dropped[address] = until
            elif outputs.returns != handler.image.returns:
                handler.outputs_too_old(octets, now)
            else:
                handler.set_outputs(octets)
        if dropped:
            self._publish()
            self._outbox.send(News(dropped=dropped))

    # --- the tap ---

    def _follow_tap(self) -> None:
        """Begin or end the tap as the application wants it."""
        wanted = bool(self._image.words[Word.TAPPED])
        if wanted is (self._tap is None):
            self._tap = Tap() if wanted else None
            self.runtime.tap(self._tap)

    def _send_tapped(self) -> None:
        """Send a portion of the octets on the line; portions are small, so that they delay no cycle. While the
        application does not read, nothing is sent: the ring fills and counts the losses, and events have the room."""
        tap = self._tap
        if tap is None or self._over or self._outbox.waiting:
            return
        lost, entries = tap.take(TAP_PORTION)
        if entries or lost:
            self._outbox.send(News(tapped=entries, tap_lost=lost))
        if tap.waiting and not self._tap_goes_on:
            self._tap_goes_on = True
            self._loop.call_at(monotonic_ns() + TAP_SHORT_PAUSE_NS, self._continue_tapped)

    def _continue_tapped(self) -> None:
        self._tap_goes_on = False
        self._send_tapped()

    def _send_last_tapped(self) -> None:
        """At the end: all that the tap holds."""
        tap = self._tap
        while tap is not None and tap.waiting and not self._outbox.full:
            lost, entries = tap.take(TAP_PORTION)
            self._outbox.send(News(tapped=entries, tap_lost=lost))

    # --- news for the application ---

    def on_events(self, events: list[Event]) -> None:
        self._ending.on_events(events)
        self._send_news(events)

    def _send_news(
        self,
        events: list[Event],
        *,
        answer: Answer | None = None,
        over: str | None = None,
        defect: bool = False,
        cleared: bool = False,
    ) -> None:
        """Send events, the changes of the state and an answer. For an application that does not read: later."""
        if events and answer is None:
            self._publish_for(events)
        else:
            self._publish()
        if any(isinstance(event, DriveEvent) for event in events):
            self._publish_drives()
        if self._outbox.full:
            kept = [event for event in events if event.must_arrive]
            self._dropped += len(events) - len(kept)
            if not kept and answer is None and over is None:  # answers and the last words come in any case
                return
            events = kept
        news = News(events=[named(event) for event in events], answer=answer, over=over, defect=defect, cleared=cleared)
        silences = self._image.words[Word.SILENCES]
        if silences != self._silences:  # the application gave the bus up: it gets the whole state anew
            self._silences = news.silence = silences
            self._bus = None
            self._master.context.changed.update(self._master.handlers)
        self._add_state(news)
        if events or answer is not None or over is not None or news.silence or news.bus or news.slaves:
            self._outbox.send(news)

    def _add_state(self, news: News) -> None:
        """Put into ``news`` the parts of the state that have changed since the last one."""
        bus = self._stack.bus()
        if bus != self._bus:
            self._bus = news.bus = bus
        changed, known = self._master.take_changed(), self._master.handlers
        news.slaves = {address: self._stack.slave(address) for address in changed if address in known}

    def _send_round(self, cycle: CycleData | None) -> None:
        self._publish_drives()
        if not self._outbox.full and not self._over:
            before, self._sent_cycle = self._sent_cycle, cycle
            self._outbox.send(News(round_over=True, cycle=None if cycle is before else cycle))

    def _on_heartbeat(self) -> None:
        if self._over:
            return
        now = monotonic_ns()
        self._loop.call_at(now + _HEARTBEAT, self._on_heartbeat)  # first: an exception below must not stop it
        self._image.words[Word.HEARTBEAT] = now
        self._take_outputs()
        self._follow_tap()
        self._awake.hold(self._master.window.next_at != NEVER)
        self._beats += 1
        if not self._beats % _BEATS_TO_NEWS:
            self._send_tapped()
            self._publish_counters()
            if not self._outbox.full:
                missed, self._dropped = self._dropped, 0
                text = f"the application did not read for a while: {missed} events were dropped"
                self._send_news([_notice(text)] if missed else [])
        elif self._image.words[Word.SILENCES] != self._silences:
            self._send_news([])

    def _publish_counters(self) -> None:
        """Publish the counters."""
        self._image.counters.write(self._stack.counted())

    # --- the end ---

    @property
    def _has_ended(self) -> bool:
        """The master has stopped and left the token ring, or a defect has stopped it."""
        left = self._master.mode is Mode.OFFLINE and not self._station.in_ring
        return left or self.runtime.failed is not None

    def _on_failure(self, error: Exception) -> None:
        """The machine raised: a defect of ours, or there is no memory."""
        self._send_last_tapped()
        self._send_news([], over=stopped_by(error), defect=True, cleared=self.runtime.cleared)
        self._loop.call_soon(self._stop)

    def _finish(self, why: str) -> None:
        """The bus was left in order."""
        self.runtime.close()
        self._send_last_tapped()
        self._send_news([], over=why)
        self._stop()

    def _stop(self) -> None:
        if not self._over:
            self._over = True
            self._awake.hold(False)
            self._loop.remove_reader(self._sock.fileno())
            self._outbox.close()
            self._loop.stop()
