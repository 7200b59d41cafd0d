"""The bus process from the inside: machines and driver of one bus, and what is told to the application."""

from __future__ import annotations

import contextlib
import socket
from collections import deque
from functools import partial
from time import monotonic_ns
from typing import Final

from dpstack.dp.master.commands import AddSlave, Mode, SendControl, Shutdown
from dpstack.dp.master.events import DriveEvent
from dpstack.dp.master.fixed_cycle import CycleData
from dpstack.dp.process_image import SlaveImage
from dpstack.drivers.line.select_loop import SelectLoop
from dpstack.drivers.line.select_runtime import SelectRuntime
from dpstack.drivers.process import plugins
from dpstack.drivers.process.messages import (
    Answer,
    AttachPlugin,
    CloseBus,
    EndSurvey,
    Frames,
    Hello,
    Message,
    News,
    Question,
    SetUp,
    StartSurvey,
    TakeOutputs,
    WatchRounds,
    encoded,
    error_pair,
    named,
    order_of,
)
from dpstack.drivers.process.outbox import Outbox
from dpstack.drivers.process.shared_image import SharedImage, picture_octets
from dpstack.drivers.shutdown import Ending
from dpstack.drivers.snapshots import BusSnapshot, SlaveSnapshot
from dpstack.drivers.stack import StackSurvey, StackView, build_stack, image_snapshot
from dpstack.errors import BusError, OrderDropped, UsageError
from dpstack.fdl.commands import GoOffline
from dpstack.ports import open_port
from dpstack.trace import Event, Notice, Severity
from dpstack.units import NS_PER_MS, ms_text

#: what changes without an event, and what was held back for an application that did not read, is told so often
_RHYTHM: Final = 100 * NS_PER_MS
#: so often it shows that it lives, whatever the application does, and takes the application's outputs
_HEARTBEAT: Final = 20 * NS_PER_MS
#: and so often what its drives tell, where nobody watches the rounds and no event comes
_DRIVES_NS: Final = 10 * NS_PER_MS
#: SIGTERM is for the application, too, if that begins its end within this time
_GRACE: Final = 200 * NS_PER_MS
_CHUNK: Final = 65_536
#: no more is read while so many orders wait
_WAITING: Final = 32


def _notice(text: str) -> Notice:
    return Notice(t_ns=monotonic_ns(), source="bus process", message=text, severity=Severity.WARNING)


class Host:
    """Everything of one bus in ``loop``. ``sock`` leads to the application, ``image`` is shared with it.

    Raises ConfigError and PortError (:meth:`open`). Ends the loop when it is over.
    """

    def __init__(self, loop: SelectLoop, sock: socket.socket, image: SharedImage, setup: SetUp) -> None:
        self._loop = loop
        self._sock = sock
        self._image = image
        self._frames = Frames()
        self._questions: deque[Question] = deque()
        self._outbox = Outbox(loop, sock)
        stack = build_stack(setup.stack)
        self._master, self._station = stack.master, stack.station
        for place in setup.preload:
            plugins.found_at(place)
        for address, ref in setup.plugins.items():
            self._master.handlers[address].image.unit = plugins.load(ref)
        port = open_port(setup.port, setup.stack.params.baud, event_char=setup.event_char, rs485=setup.rs485)
        self._port = port
        self.runtime = SelectRuntime(
            loop,
            port,
            self._station,
            self.on_events,
            echo=setup.echo,
            on_failure=self._on_failure,
            tune=self._station.set_patience if setup.tune else None,
            held_up=self._station.held_up,
        )
        self._view = StackView(stack, self.runtime)
        self._ending = Ending(
            loop, self.runtime.command, stack.station, lambda: stack.master.rotation.max_ns, self._finish
        )
        self._surveys: dict[int, StackSurvey] = {}
        self._watched = False
        self._dropped = 0
        self._over = False
        self._leaving = False  # the application has begun the end
        self._until: dict[int, int] = {}  # the outputs that were taken or dropped, by address and deadline
        self._silences = 0  # of the application's words that this process is silent: those that were answered
        # what was told last
        self._bus: BusSnapshot | None = None
        self._slaves: dict[int, SlaveSnapshot] = {}
        self._told_surveys: set[int] = set()
        self._told_cycle: CycleData | None = None
        self._told_drives = encoded({})
        self._drives_at = 0  # when they were published

    def open(self, notices: list[str]) -> None:
        """Open the port, say hello, listen to the application. Raises PortError, ConfigError.

        ``notices``: what this process was not permitted, for people.
        """
        self._master.on_round = self._on_round
        self._master.on_begin = self._take_outputs
        self.runtime.open()
        self._image.heartbeat.value = monotonic_ns()
        self._count()
        self._tell([_notice(text) for text in notices])
        self._outbox.send(Message(answer=Answer(0, value=Hello(self.runtime.port_name, self.runtime.paced))))
        self._sock.setblocking(False)
        self._loop.add_reader(self._sock.fileno(), self._on_readable)
        self._on_heartbeat()
        self._loop.call_at(monotonic_ns() + _RHYTHM, self._on_rhythm)

    def end(self, why: str) -> None:
        """The ordered end without an order of the application: it is gone, or somebody wants this process to end."""
        self._ending.begin(why)

    def terminated(self, why: str) -> None:
        """The same after a moment: who stops a program often tells all its processes, and its own end comes first."""
        self._loop.call_at(monotonic_ns() + _GRACE, lambda: self.end(why) if not self._leaving else None)

    # --- the application's orders ---

    def _on_readable(self) -> None:
        try:
            octets = self._sock.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            octets = b""
        if not octets:
            self._loop.remove_reader(self._sock.fileno())
            self.end("the application is gone")
            return
        idle = not self._questions
        try:
            self._questions += [m.question for m in self._frames.feed(octets) if m.question is not None]
        except BusError as error:
            self._loop.remove_reader(self._sock.fileno())
            self.end(str(error))
            return
        if len(self._questions) >= _WAITING:
            self._loop.remove_reader(self._sock.fileno())
        if idle and self._questions:
            self._serve()

    def _serve(self) -> None:
        """One order a turn of the loop: whatever the application does, the bus comes in between."""
        question = self._questions.popleft()
        answer = Answer(question.number)
        order = None
        self._image.order_taken.value = question.number  # before the clock is read: so the application knows
        try:
            late = monotonic_ns() - question.until_ns
            if late > 0:
                raise OrderDropped(f"the bus process took the order {ms_text(late)} too late and dropped it")
            order = order_of(question.order)
            answer.value = self._carry_out(order)
        except Exception as error:
            answer.error = error_pair(error)
        self._outbox.send(Message(answer=answer))
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
            case AttachPlugin(address, ref):
                self._handler_image(address).unit = plugins.load(ref)
                self._publish_drives()
            case WatchRounds(on):
                self._watched = on
                self._count()  # who waited for rounds looks at the counters next
            case TakeOutputs():
                self._take_outputs()
            case StartSurvey(number, wanted):
                survey = self._view.survey()
                survey.begin_now(wanted)
                self._surveys[number] = survey
            case EndSurvey(number):
                found = self._surveys.pop(number, None)
                if found is not None:
                    found.end()
            case Shutdown():
                self._leaving = True
                self.runtime.command(order)
                self._tell([])
            case GoOffline() if self._master.mode is not Mode.OFFLINE:
                self.end("the application ended the bus")  # without a token no Clear could be sent
            case CloseBus():
                if self._has_ended:
                    self.runtime.close()
                self._tell([])
                return self._view.counted()
            case _:
                if isinstance(order, SendControl):  # what was set before it is what it acts on
                    self._take_outputs()
                self.runtime.command(order)
                if isinstance(order, AddSlave):
                    self._publish()
                self._tell([])
        return None

    def _handler_image(self, address: int) -> SlaveImage:
        handler = self._master.handlers.get(address)
        if handler is None:
            raise UsageError(f"no slave with address {address} in the bus process")
        return handler.image

    # --- the process image ---

    def _on_round(self, _now: int) -> None:
        self._publish()
        # after the round's last telegram, not before it
        if self._watched:
            self._loop.call_soon(partial(self._tell_round, self._master.cycle))
        elif monotonic_ns() - self._drives_at >= _DRIVES_NS:
            self._loop.call_soon(self._publish_drives)

    def _publish(self) -> None:
        slaves = [(address, image_snapshot(handler)) for address, handler in self._master.handlers.items()]
        self._image.inputs.write(picture_octets(self._master.rounds, self._master.rotation_count, slaves))

    def _publish_drives(self) -> None:
        """What the plugins tell of their drives, where that has changed."""
        if self._over:
            return
        self._drives_at = monotonic_ns()
        told = {}
        for address, handler in self._master.handlers.items():
            status = getattr(handler.image.unit, "status", None)
            if status is not None:
                with contextlib.suppress(Exception):  # the plugin's own: nothing is known of its drive
                    told[address] = status()
        octets = encoded(told)
        if octets != self._told_drives and len(octets) <= self._image.drives.limit:
            self._told_drives = octets
            self._image.drives.write(octets)

    def _take_outputs(self) -> None:
        """Those that were set since the last time, unless their time limit is over: a process that was stopped must not
        send what was meant for another moment."""
        found = self._image.take_outputs()
        if found is None:
            return
        now = monotonic_ns()
        before, self._until = self._until, {}
        dropped = {}
        for address, (until, octets) in found.items():
            handler = self._master.handlers.get(address)
            if handler is None or handler.image.unit is not None or len(octets) != handler.image.output_len:
                continue
            self._until[address] = until
            if before.get(address) == until:
                continue
            if until < now:
                dropped[address] = until
            else:
                handler.image.outputs = octets
        if dropped:
            self._publish()
            self._outbox.send(Message(news=News(dropped=dropped)))

    # --- what is told ---

    def on_events(self, events: list[Event]) -> None:
        for event in events:
            self._ending.on_event(event)
        self._tell(events)

    def _tell(self, events: list[Event], *, over: str | None = None, defect: bool = False) -> None:
        """Events, with what has changed by them. For an application that does not read: later."""
        self._publish()
        if any(isinstance(event, DriveEvent) for event in events):
            self._publish_drives()
        if self._outbox.full:
            kept = [event for event in events if event.owed]
            self._dropped += len(events) - len(kept)
            if not kept and over is None:  # the last words come in any case
                return
            events = kept
        news = News(events=[named(event) for event in events], over=over, defect=defect)
        silences = self._image.silences.value
        if silences != self._silences:  # the application gave the bus up: it is told everything anew
            self._silences = news.silence = silences
            self._bus, self._slaves = None, {}
        self._state(news)
        if events or over is not None or news.silence or news.bus or news.slaves or news.surveys:
            self._outbox.send(Message(news=news))

    def _state(self, news: News) -> None:
        """Into ``news`` what is not as it was told last."""
        bus = self._view.bus()
        if bus != self._bus:
            self._bus = news.bus = bus
        slaves = {address: self._view.slave(address) for address in self._master.handlers}
        if slaves != self._slaves:
            news.slaves = {a: now for a, now in slaves.items() if self._slaves.get(a) != now}
            self._slaves = slaves
        for number, survey in self._surveys.items():
            result = survey.result
            if result is not None and number not in self._told_surveys:
                self._told_surveys.add(number)
                news.surveys[number] = result

    def _tell_round(self, cycle: CycleData | None) -> None:
        self._publish_drives()
        if not self._outbox.full and not self._over:
            told, self._told_cycle = self._told_cycle, cycle
            self._outbox.send(Message(news=News(round_over=True, cycle=None if cycle is told else cycle)))

    def _on_heartbeat(self) -> None:
        if self._over:
            return
        now = monotonic_ns()
        self._image.heartbeat.value = now
        self._take_outputs()
        if self._image.silences.value != self._silences:
            self._tell([])
        self._loop.call_at(now + _HEARTBEAT, self._on_heartbeat)

    def _count(self) -> None:
        """Put the counters where the application reads them."""
        octets = encoded(self._view.counted())
        if len(octets) <= self._image.counters.limit:  # otherwise the application has older ones, with their age
            self._image.counters.write(octets)

    def _on_rhythm(self) -> None:
        if self._over:
            return
        self._count()
        if not self._outbox.full:
            missed, self._dropped = self._dropped, 0
            text = f"the application did not read for a while: {missed} events were dropped"
            self._tell([_notice(text)] if missed else [])
        self._loop.call_at(monotonic_ns() + _RHYTHM, self._on_rhythm)

    # --- the end ---

    @property
    def _has_ended(self) -> bool:
        """The master has stopped and left the token ring, or a defect has stopped it."""
        left = self._master.mode is Mode.OFFLINE and not self._station.in_ring
        return left or self.runtime.failed is not None

    def _on_failure(self, error: Exception) -> None:
        """The machine raised: a defect of ours."""
        self._tell([], over=f"{type(error).__name__}: {error}", defect=True)
        self._loop.call_soon(self._stop)

    def _finish(self, why: str) -> None:
        """The bus was left in order."""
        self.runtime.close()
        self._tell([], over=why)
        self._stop()

    def _stop(self) -> None:
        if not self._over:
            self._over = True
            self._loop.remove_reader(self._sock.fileno())
            self._outbox.close()
            self._loop.stop()
