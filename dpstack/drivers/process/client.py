"""The process driver, in the application: the bus runs in a process of its own.

Only a caller that awaits an order waits for the bus process. An awaited order (:meth:`ProcessRuntime.order`) ends with
the answer: then the changes are visible, and an exception of the machines is raised. Any other order
(:meth:`ProcessRuntime.command`) is only sent; ``on_refused`` is called later if the bus process refuses it. Process
image, outputs, drives and counters stand in shared memory, states come with the events.

The bus process writes a heartbeat into the shared memory. When the heartbeat is older than
:data:`dpstack.drivers.process.channel.LIMIT_NS` the bus process counts as silent, and all slaves count as offline until
it has sent its whole state again (``News.silence``). Outputs that it does not read within the same time are dropped, by
the bus process or by the application. An event reports them.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Callable, Iterable, Mapping
from time import monotonic_ns
from typing import Final, TypeVar

from msgspec import structs

from dpstack.dp.master.bring_ups import History
from dpstack.dp.master.commands import AddSlave, Alive, DriveCommand, Mode, RemoveSlave, ReparameteriseSlave
from dpstack.dp.master.events import Fault, FaultKind, SlaveDiagnosis, SlaveFaulted, SlaveState, SlaveStateChanged
from dpstack.dp.master.fault_texts import in_words
from dpstack.dp.master.fixed_cycle import CycleData
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.alarm_orders import AlarmRaised, StatusTold, texts_beside
from dpstack.drivers.futures import wait_through_cancellation
from dpstack.drivers.line.shutdown import at_slaves, signal_name
from dpstack.drivers.process import channel, early_start
from dpstack.drivers.process.messages import (
    CloseBus,
    News,
    ReadHistory,
    SetUp,
    TakeOutputs,
    checked_arguments,
    event_of,
    typed,
)
from dpstack.drivers.process.shared_image import Area, Outputs, Picture, SharedImage, Word, make_memory
from dpstack.drivers.runtime import (
    IN_PARENT,
    BusProcessBack,
    BusProcessSilent,
    OnEvents,
    OnFailure,
    OnRefused,
    OutputsDropped,
)
from dpstack.drivers.snapshots import BusSnapshot, Counters, ImageSnapshot, SlaveSnapshot, no_image
from dpstack.drivers.tap import Tap
from dpstack.errors import BusError, DpError, OrderDropped, UsageError
from dpstack.fdl.interface import LinkStats
from dpstack.machine import Order
from dpstack.params import UNADDRESSED
from dpstack.trace import Event, Notice, Severity
from dpstack.units import s_to_ns

T = TypeVar("T")
#: interval of the checks whether the bus process is alive and reads the outputs
_WATCH_S: Final = 0.1
_UNKNOWN: Final = SlaveSnapshot()


class ProcessRuntime:
    """A :class:`~dpstack.drivers.runtime.Runtime`, and the :class:`~dpstack.drivers.snapshots.View` of its bus.

    ``on_failure`` is called when the bus process ends without an order to end.
    """

    def __init__(self, setup: SetUp, on_events: OnEvents, on_failure: OnFailure, on_refused: OnRefused) -> None:
        spec = setup.stack
        self.read_only = spec.master.read_only
        self.setups = {slave.address: slave for slave in spec.slaves}
        #: the last round with data exchange, while somebody watches
        self.cycle: CycleData | None = None
        self._bus = BusSnapshot(
            mode=Mode.STOP if self.read_only else Mode.CLEAR,
            patience=spec.patience,
            found={} if self.read_only and spec.watched else None,
        )
        self._slaves: dict[int, SlaveSnapshot] = {}
        self._on_round: Callable[[], None] | None = None
        self.port_name = setup.port
        self.paced = False
        self._setup = setup
        self._on_events = on_events
        self._on_failure = on_failure
        self._channel = channel.Channel(self._on_news, on_refused, self._why_gone, self._on_gone)
        self._image: SharedImage | None = None
        self._picture = Picture(0, 0, {})
        self._outputs: dict[int, Outputs] = {}
        self._changed: set[int] = set()  # outputs that are not published yet
        self._awaited: dict[int, int] = {}  # address -> number of the picture with its unread outputs
        self._loop: asyncio.AbstractEventLoop | None = None
        self._publishing: asyncio.Handle | None = None
        self._counters = Counters()
        self._drives: dict[int, object] = {}
        self._not_running: str | None = None
        #: the machine in the bus process failed, and Clear was sent without it
        self.cleared = False
        self.mode_before_silence: Mode | None = None
        self._silent_since = 0  # time of the last heartbeat before the silence; 0: the bus process is not silent
        self._silences = 0
        self._watchdogs_then: dict[str, int] = {}
        self._silence_events: list[Event] = []  # of the silence
        self._watch: asyncio.TimerHandle | None = None
        self._tap: Tap | None = None

    # --- Runtime ----------------------------------------------------------------------------------------------------

    @property
    def pid(self) -> int | None:
        """The process id of the bus process while there is one."""
        return self._channel.pid

    @property
    def not_running(self) -> str | None:
        """Why the bus process does not run: it is gone, or silent."""
        self._detect_silence()
        return self._not_running

    @property
    def behind_ns(self) -> int:
        return 0

    def now(self) -> int:
        return monotonic_ns()

    async def open(self) -> None:
        """Start the bus process, which opens the port. Raises PortError and ConfigError as it does, and BusError."""
        if self._channel.pid is not None:
            raise UsageError("the driver is open already")
        self._loop = asyncio.get_running_loop()
        begun = early_start.take()
        try:
            memory = make_memory() if begun is None else make_memory(begun.memory)
        except OSError as error:
            if begun is not None:
                begun.sock.close()
                early_start.end(begun.process)
            raise channel.not_started(error) from None
        try:
            try:
                self._image = SharedImage(memory)
            except OSError as error:  # it takes one more descriptor
                raise channel.not_started(error) from None
            self._image.words[Word.ROUNDS_WATCHED] = self._on_round is not None
            self._image.words[Word.TAPPED] = self._tap is not None
            self._publish()
            hello = await self._channel.start(self._setup, memory, self._image, begun)
        finally:
            os.close(memory)
            if not self._channel.is_open:
                self._close_image()
        self.port_name, self.paced = hello.port_name, hello.paced
        self._watch_bus_process()

    async def close(self) -> None:
        """Let the bus process release the port and end, after the ordered end of the bus. May be called again."""
        line = self._channel
        final: Counters | None = None
        try:
            if line.is_open:
                closing = self.order(CloseBus())
                with contextlib.suppress(asyncio.CancelledError):
                    await wait_through_cancellation(closing)
                if not closing.cancelled() and closing.exception() is None:
                    with contextlib.suppress(BusError):  # the bus process cannot be understood
                        final = structs.replace(typed(closing.result(), Counters), t_ns=0)
                else:  # it may still see that the socket is closed, and make the end by itself
                    line.disconnect()
                line.hang_up(UsageError("the bus is closed"))
                await wait_through_cancellation(asyncio.ensure_future(line.ended()))
            else:
                await wait_through_cancellation(asyncio.ensure_future(line.ended()))
                line.settle()
        finally:
            if line.release():
                text = killed_at_the_end(self._watchdogs())
                self._on_events(
                    [Notice(t_ns=monotonic_ns(), source="bus process", message=text, severity=Severity.ERROR)]
                )
            self._close_image()
            self._counters = final or self._counters

    @property
    def close_limit_ns(self) -> int:
        return s_to_ns(channel.CLOSE_LIMIT_S)

    def end_without_loop(self) -> str:
        """Hang up: the bus process makes the ordered end by itself. Waits for it, and never kills it."""
        ended = self._channel.hang_up_and_wait(UsageError("the bus is closed"))
        self._close_image()
        return "" if ended else f"the bus process (pid {self.pid}) has not ended yet"

    def release_after_fork(self) -> None:
        """In the child of a fork: close the child's copies of the descriptors that lead to the bus process."""
        self._not_running = IN_PARENT
        self._set_offline(IN_PARENT)
        self._channel.release_after_fork()
        if self._image is not None:
            self._image.close()
            self._image = None

    def _close_image(self) -> None:
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        if self._image is not None:
            self._newest_picture()
            self.counters()
            self._image.close()
            self._image = None

    def command(self, command: object) -> None:
        """Send an order that no caller awaits. ``on_refused`` is called if the bus process refuses it.

        Raises UsageError without a bus process, OrderDropped while it is silent, BusError after its end.
        """
        if isinstance(command, Alive):
            self._channel.send_unless_full(command)
            return
        self._publish_soon()
        self._channel.send(_sendable(command))

    def order(self, command: object) -> asyncio.Future[object]:
        """Send an order; the future is done when the machines have carried it out, and holds their exception if any.

        The future raises OrderDropped when the bus process read the order too late, BusError when its outcome is
        unknown or the bus process has ended.
        """
        self._publish_soon()
        return self._channel.order(_sendable(command), self._on_carried_out)

    def _on_carried_out(self, order: Order) -> None:
        """Keep the parameters of the slaves as the bus process has them."""
        match order:
            case AddSlave(setup) | ReparameteriseSlave(setup):
                before = self.setups.get(setup.address)
                if before is not None and before.output_len != setup.output_len:
                    self._put_outputs(setup.address, None)
                self.setups[setup.address] = setup
            case RemoveSlave(address) if address in self.setups:
                self._put_outputs(address, None)
                del self.setups[address]
                self._slaves.pop(address, None)

    def tap(self, tap: Tap | None) -> None:
        """The tap is in the bus process, which sends its entries here within some 0.1 s. At any time: a word in the
        shared memory cannot be refused, and a bus process that was stopped finds it when it goes on."""
        self._tap = tap
        if self._image is not None:
            self._image.words[Word.TAPPED] = tap is not None

    # --- drives -------------------------------------------------------------------------------

    def drive_status(self, address: int) -> object | None:
        """The last status of the drive plugin of a slave as plain data; None without one."""
        if not self._channel.is_open or self._image is None:
            return None
        self._drives = self._read(self._image.drives, self._drives)
        return self._drives.get(address)

    # --- the view ---------------------------------------------------------------------------------------------------

    @property
    def mode(self) -> Mode:
        return self._bus.mode

    def bus(self) -> BusSnapshot:
        return self._bus

    def slave(self, address: int) -> SlaveSnapshot:
        return self._slaves.get(address, _UNKNOWN)

    async def history(self, address: int) -> History:
        return typed(await self.order(ReadHistory(address)), History)

    def image(self, setup: SlaveParams) -> ImageSnapshot:
        """Inputs and outputs of the newest round; outputs that the application has set take precedence, unless the
        slave was away since then (``after_return``)."""
        own = self._outputs.get(setup.address)
        found = self._newest_picture().slaves.get(setup.address)
        if found is None or (len(found.inputs), len(found.outputs)) != (setup.input_len, setup.output_len):
            found = no_image(setup)
        if own is not None and len(own.octets) == setup.output_len and own.returns == found.returns:
            found = structs.replace(found, outputs=own.octets)
        return found

    def set_outputs(self, address: int, octets: bytes) -> None:
        """The outputs of the next Data_Exchange in Operate; they leave together with those of other slaves."""
        octets = bytes(octets)
        setup = self.setups[address]
        length = setup.output_len
        if len(octets) != length:
            raise ValueError(f"{len(octets)} output octets given, the slave's configuration has {length}")
        self._put_outputs(address, octets, self.image(setup).returns)
        known = self.slave(address)
        if known.withheld is not None:
            self._slaves[address] = structs.replace(known, withheld=None)

    def counters(self) -> Counters:
        """The counters as the bus process published them last; it is never asked."""
        if self._image is not None:
            self._counters = self._read(self._image.counters, self._counters)
        return self._counters

    counted = counters

    @property
    def link(self) -> LinkStats:
        return self.counters().link

    @property
    def rotations(self) -> int:
        return self._newest_picture().rotations

    def watch_rounds(self, on_round: Callable[[], None] | None) -> None:
        """Call ``on_round`` at the end of each round; None: no longer."""
        self._on_round = on_round
        if self._image is not None:
            self._image.words[Word.ROUNDS_WATCHED] = on_round is not None

    def _newest_picture(self) -> Picture:
        """The newest whole process image."""
        if self._image is not None:
            self._picture = self._read(self._image.inputs, self._picture)
        return self._picture

    def _read(self, area: Area[T], known: T) -> T:
        """The newest picture of ``area``, else ``known``. A bus process whose pictures cannot be read is given up in
        the next turn of the loop."""
        try:
            new = area.read_new()
        except BusError as error:
            if self._loop is not None and not self._loop.is_closed():
                self._loop.call_soon(self._channel.give_up, error)
            return known
        return known if new is None else new

    # --- the application's outputs ----------------------------------------------------------------------------------

    def _put_outputs(self, address: int, octets: bytes | None, returns: int = 0) -> None:
        """Publish the application's outputs of one slave (None: it has none of its own any more), with those of all
        others. ``returns``: see :class:`Outputs`."""
        self._awaited.pop(address, None)
        if octets is None:
            self._outputs.pop(address, None)
        else:
            self._outputs[address] = Outputs(0, octets, returns)
            self._changed.add(address)
        if self._publishing is None and self._loop is not None and not self._loop.is_closed():
            self._publishing = self._loop.call_soon(self._publish_soon)

    def _publish_soon(self) -> None:
        if self._publishing is not None:
            self._publishing.cancel()
            self._publishing = None
            self._publish()

    def _publish(self) -> None:
        """Publish all outputs that the application has set since the last time in one picture, so that they leave in
        one round.

        Before the bus process runs the time limit is longer than its start may take.
        """
        if self._image is None:
            return
        changed = self._changed & self._outputs.keys()
        self._changed.clear()
        for address in changed:
            limit_ns = channel.LIMIT_NS if self._watch is not None else 2 * channel.START_LIMIT_NS
            until = monotonic_ns() + limit_ns
            self._outputs[address] = structs.replace(self._outputs[address], until_ns=until)
        self._image.outputs.write(self._outputs)
        self._awaited |= dict.fromkeys(changed, self._image.outputs.newest)

    async def hand_over_outputs(self) -> None:
        """Return when the bus process has all outputs that the application has set.

        Raises OrderDropped when it did not read them in time: they are withdrawn, and never go out.
        """
        self._publish_soon()
        given = tuple(self._awaited)
        if not given:
            return
        why = "the bus process did not take the outputs in time"
        try:
            await self._channel.order(TakeOutputs())
        except OrderDropped as error:
            why = str(error)
            self._withdraw(given)
        gone = [self.setups[address] for address in given if address in self.setups and address not in self._outputs]
        if gone:
            raise OrderDropped(f"{why}; the outputs of {_names(gone)} will not go out")

    def _withdraw(self, addresses: Iterable[int]) -> None:
        """Withdraw published outputs that the bus process has not read. They never go out.

        The bus process sets the number of a picture before it reads the picture. So outputs whose number it has not set
        when this new picture is written can no longer be read.
        """
        image = self._image
        if image is None:
            return
        taken_back = {address: self._outputs.pop(address) for address in addresses if address in self._outputs}
        self._publish()
        dropped = {}
        for address, outputs in taken_back.items():
            if image.words[Word.OUTPUTS_TAKEN] >= self._awaited.pop(address, 0):
                self._outputs[address] = outputs
            else:
                dropped[address] = outputs.octets
        self._report_dropped(dropped)

    def _report_dropped(self, outputs: Mapping[int, bytes]) -> None:
        now = monotonic_ns()
        self._on_events(
            [
                OutputsDropped(t_ns=now, address=address, name=self.setups[address].name, outputs=octets)
                for address, octets in outputs.items()
                if address in self.setups
            ]
        )

    def _drop_late_outputs(self, dropped_until: Mapping[int, int]) -> None:
        """The bus process dropped outputs, by address and time limit."""
        dropped = {}
        for address, until in dropped_until.items():
            outputs = self._outputs.get(address)
            if outputs is not None and outputs.until_ns == until:
                del self._outputs[address]
                self._awaited.pop(address, None)
                dropped[address] = outputs.octets
        self._report_dropped(dropped)

    # --- whether it lives -------------------------------------------------------------------------------------------

    def _watch_bus_process(self) -> None:
        """Check periodically whether the bus process is alive and reads the outputs in time."""
        loop = self._loop
        if loop is None or self._image is None:
            return
        self._watch = loop.call_later(_WATCH_S, self._watch_bus_process)
        self._detect_silence()
        self._send_silence_events()
        taken, now = self._image.words[Word.OUTPUTS_TAKEN], monotonic_ns()
        self._awaited = {address: number for address, number in self._awaited.items() if number > taken}
        late = [address for address in self._awaited if self._outputs[address].until_ns < now]
        if late:
            self._withdraw(late)

    def _detect_silence(self) -> None:
        silent = 0 if self._silent_since or self._not_running is not None else self._channel.silent_ns()
        image, pid = self._image, self.pid
        if not silent or image is None or pid is None:
            return
        self._silences += 1
        image.words[Word.SILENCES] = self._silences
        now = monotonic_ns()
        self._watchdogs_then = self._watchdogs()
        self._silent_since = now - silent
        self.mode_before_silence = self._bus.mode
        silence = BusProcessSilent(t_ns=now, pid=pid, silent_ns=silent, at_slaves=at_slaves(self._watchdogs_then))
        self._not_running = f"the bus process (pid {pid}) shows no sign of life: it is stopped, or hangs"
        lost = self._set_offline(self._not_running, "its slaves are not asked until it goes on")
        self._silence_events = [silence, *self._state_events(lost, now)]
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon(self._send_silence_events)

    def _send_silence_events(self) -> None:
        events, self._silence_events = self._silence_events, []
        if events:
            self._on_events(events)

    def _end_silence(self, events: Iterable[Event]) -> list[Event]:
        """The silence is over: the bus process has sent its whole state and ``events``. Returns the events that come
        before ``events``: the end of the silence, and the state of each slave that ``events`` do not name."""
        self._send_silence_events()
        now = monotonic_ns()
        back = BusProcessBack(t_ns=now, pid=self.pid or 0, silent_ns=now - self._silent_since)
        self._silent_since, self._not_running, self.mode_before_silence = 0, None, None
        known = {event.address for event in events if isinstance(event, SlaveStateChanged)}
        here = (
            address
            for address, slave in self._slaves.items()
            if slave.state not in (SlaveState.OFFLINE, SlaveState.DEACTIVATED) and address not in known
        )
        return [back, *self._state_events(here, now)]

    def _set_offline(self, why: str, remedy: str = "") -> list[int]:
        """Mark bus and slaves as offline, because no process runs them. Returns the slaves whose state changed."""
        before = self._bus
        self._bus = BusSnapshot(
            Mode.OFFLINE, before.patience, claimed=before.claimed, found=before.found, found_all=before.found_all
        )
        fault = Fault(FaultKind.LOST, why, remedy)
        changed = []
        for address in dict.fromkeys((*self.setups, *self._slaves)):
            slave = self.slave(address)
            if slave.state is not SlaveState.DEACTIVATED:
                if slave.state is not SlaveState.OFFLINE:
                    changed.append(address)
                self._slaves[address] = structs.replace(slave, state=SlaveState.OFFLINE, fault=fault)
        return changed

    def _state_events(self, addresses: Iterable[int], now: int) -> list[Event]:
        """One event with the state of each slave in ``addresses``."""
        return [
            SlaveStateChanged(t_ns=now, address=a, name=self.setups[a].name, state=self.slave(a).state)
            for a in addresses
            if a in self.setups
        ]

    # --- from the bus process ---------------------------------------------------------------------------------------

    def _on_news(self, news: News) -> None:
        """Raises BusError for news that no bus process of this version sends."""
        if news.tapped or news.tap_lost:
            if self._tap is not None:
                self._tap.extend(news.tapped, news.tap_lost)
            return
        if news.cycle is not None:
            self.cycle = news.cycle
        try:
            events = [self._with_gsd_texts(event_of(event)) for event in news.events]
        except (DpError, ValueError) as error:
            raise BusError(str(error)) from None
        if any(not 0 <= address <= UNADDRESSED for address in news.slaves):
            raise BusError("a message between bus process and application names slaves that there cannot be")
        try:
            if news.round_over:
                if self._on_round is not None:
                    self._on_round()
                return
            if news.bus is not None:
                self._bus = news.bus
            self._slaves |= {address: self._in_words(address, one) for address, one in news.slaves.items()}
            if self._silent_since:
                if news.silence == self._silences:
                    events = [*self._end_silence(events), *events]
                else:  # it is from before the silence
                    self._set_offline(self._not_running or "")
            self._on_events(events)
            if news.dropped:
                self._drop_late_outputs(news.dropped)
        except Exception as error:  # the application's: the bus goes on
            context = {"message": "the handler of bus events raised", "exception": error}
            asyncio.get_running_loop().call_exception_handler(context)

    def _with_gsd_texts(self, event: Event) -> Event:
        """``event`` with the texts of its slave's GSD file, which the bus process does not have."""
        if isinstance(event, SlaveDiagnosis | SlaveFaulted | AlarmRaised | StatusTold):
            setup = self.setups.get(event.address)
            return event if setup is None else worded(event, setup)
        return event

    def _in_words(self, address: int, slave: SlaveSnapshot) -> SlaveSnapshot:
        """``slave`` with the names of telegrams and modules in its fault."""
        setup = self.setups.get(address)
        if slave.fault is None or setup is None or (fault := in_words(slave.fault, setup)) is slave.fault:
            return slave
        return structs.replace(slave, fault=fault)

    def _why_gone(self, code: int | None, last: News | None) -> DpError:
        self.cleared = last is not None and last.cleared
        return how_it_ended(code, last, self._watchdogs())

    def _watchdogs(self) -> dict[str, int]:
        """Watchdogs in ns of the slaves in data exchange, by name; during a silence those from before it."""
        if self._silent_since:
            return self._watchdogs_then
        return {
            setup.name: self.slave(address).watchdog_ns
            for address, setup in self.setups.items()
            if self.slave(address).state is SlaveState.DATA_EXCHANGE
        }

    def _on_gone(self, error: DpError) -> None:
        self._send_silence_events()
        self._not_running = str(error)
        lost = self._set_offline(self._not_running)
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        self._on_events(self._state_events(lost, monotonic_ns()))
        self._on_failure(error)


def worded(event: SlaveDiagnosis | SlaveFaulted | AlarmRaised | StatusTold, setup: SlaveParams) -> Event:
    """``event`` of the slave with ``setup``, with the texts of its GSD file and its plugin."""
    if isinstance(event, SlaveFaulted):
        return structs.replace(event, fault=in_words(event.fault, setup))
    if setup.texts is None:
        return event
    if isinstance(event, AlarmRaised):
        return structs.replace(event, texts=texts_beside(event.diagnosis, event.alarm, setup.texts))
    if isinstance(event, StatusTold):
        return structs.replace(event, first_slot=setup.texts.first_slot)
    return structs.replace(event, texts=setup.block_texts(event.diagnosis))


def _names(slaves: Iterable[SlaveParams]) -> str:
    return ", ".join(slave.who for slave in slaves)


def _sendable(command: object) -> Order:
    """A drive's order as JSON can carry it."""
    if isinstance(command, DriveCommand):
        return structs.replace(command, args=checked_arguments(command.args))
    assert isinstance(command, Order)
    return command


def how_it_ended(code: int | None, last: News | None, watchdogs: Mapping[str, int]) -> BusError:
    """The error for a bus process that has ended. ``code``: exit code, negative for a signal. ``last``: last message.

    ``watchdogs``: of the slaves that were in data exchange, by name, in ns (0 is off).
    """
    if last is not None and last.defect:
        safe = "Clear was sent before" if last.cleared else at_slaves(watchdogs)
        return BusError(f"the bus was stopped by {last.over}. {safe}")
    if last is not None:
        return BusError(f"the bus process has ended: {last.over}; outputs were set to their safe values before")
    if code is None:
        how = "does not talk any more"
    elif code < 0:
        how = f"was killed by {signal_name(-code)}"
    else:
        how = f"ended with exit code {code}, see what it wrote to standard error"
    return BusError(f"the bus process {how}: nothing is sent any more. {at_slaves(watchdogs)}; open the bus anew")


def killed_at_the_end(watchdogs: Mapping[str, int]) -> str:
    """Text for a bus process that did not end when ordered to; ``watchdogs`` as in :func:`how_it_ended`."""
    return f"it did not answer at the end of the bus and was killed: the end was not in order. {at_slaves(watchdogs)}"
