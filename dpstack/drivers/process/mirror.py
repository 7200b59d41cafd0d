"""What the application's process knows of machines that run in another one.

The same names as at the machines themselves (:mod:`dpstack.drivers.views` says which are read), from three sources: the
process image stands in shared memory; states come with the events, in order, so that in a handler of an event they
agree with it; what is counted is asked for when somebody looks. What a GSD file says to a diagnosis stays here.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Protocol

from dpstack.dp.master.commands import Mode
from dpstack.dp.master.diag_reader import AlarmCounts
from dpstack.dp.master.events import Fault, SlaveDiagnosis, SlaveState
from dpstack.dp.master.fixed_cycle import CycleBook, CycleData
from dpstack.dp.master.scanner import Found
from dpstack.dp.pdu.diag_texts import block_texts
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.alarm_events import AlarmRaised, texts_beside
from dpstack.drivers.process.messages import BusNow, Counters, CyclesNow, News, SlaveNow, WatcherNow
from dpstack.drivers.process.shared_image import Picture
from dpstack.fdl.decoder import DecoderStats
from dpstack.fdl.interface import LinkStats
from dpstack.params import BusParams
from dpstack.phy.patience import Patience
from dpstack.stats import Histogram
from dpstack.text import octets_text
from dpstack.trace import Event


class Source(Protocol):
    """Where a mirror gets what is not told by itself."""

    def picture(self) -> Picture:
        """The newest process image."""

    def counters(self) -> Counters:
        """What was counted up to now."""

    def put_outputs(self, address: int, octets: bytes | None) -> None:
        """The application's outputs of one slave; None: it has none of its own any more."""

    def watch_rounds(self, on: bool) -> None:
        """Whether the ends of rounds are to be told."""


class ImageMirror:
    """The process image of one slave, see :class:`dpstack.dp.process_image.SlaveImage`."""

    __slots__ = ("_address", "_outputs", "_source", "input_len", "output_len", "unit")

    def __init__(self, setup: SlaveParams, source: Source) -> None:
        self.input_len = setup.input_len
        self.output_len = setup.output_len
        #: a drive plugin makes the outputs, over there
        self.unit: object | None = None
        self._address = setup.address
        self._source = source
        self._outputs = setup.safe_outputs if setup.initial is None else setup.initial

    @property
    def lengths(self) -> tuple[int, int]:
        """Octets of inputs and of outputs."""
        return self.input_len, self.output_len

    @property
    def inputs(self) -> bytes:
        """The last valid inputs, zeros before the first exchange."""
        found = self._source.picture().slaves.get(self._address)
        return bytes(self.input_len) if found is None or len(found.inputs) != self.input_len else found.inputs

    @property
    def valid(self) -> bool:
        """False while the inputs are not of a slave in data exchange."""
        found = self._source.picture().slaves.get(self._address)
        return found is not None and found.valid

    @property
    def input_time(self) -> int:
        """When the inputs came (CLOCK_MONOTONIC, ns); 0: there never were any."""
        found = self._source.picture().slaves.get(self._address)
        return 0 if found is None or len(found.inputs) != self.input_len else found.input_time

    @property
    def outputs(self) -> bytes:
        """The outputs of the next Data_Exchange in Operate."""
        if self.unit is not None:
            found = self._source.picture().slaves.get(self._address)
            if found is not None and len(found.outputs) == self.output_len:
                return found.outputs
        return self._outputs

    @outputs.setter
    def outputs(self, octets: bytes) -> None:
        octets = bytes(octets)
        if len(octets) != self.output_len:
            raise ValueError(
                f"{octets_text(len(octets))} of outputs given, the slave's configuration has {self.output_len}"
            )
        self._outputs = octets
        self._source.put_outputs(self._address, octets)

    def outputs_dropped(self) -> bytes:
        """The bus process did not take the outputs: those that it has count again. Returns what was dropped."""
        dropped = self._outputs
        found = self._source.picture().slaves.get(self._address)
        if found is not None and len(found.outputs) == self.output_len:
            self._outputs = found.outputs
        return dropped


class SlaveMirror:
    """The handling of one slave, see :class:`dpstack.dp.master.slave_handler.SlaveHandler`."""

    def __init__(self, setup: SlaveParams, source: Source, before: SlaveMirror | None = None) -> None:
        self.setup = setup
        self.state = SlaveState.OFFLINE
        self.fault: Fault | None = None
        self.diagnosis: Diagnosis | None = None
        self.alarm_counts: AlarmCounts | None = None
        self.watchdog_effective_ns = 0
        self._source = source
        self.image = ImageMirror(setup, source)
        if before is not None and before.image.lengths == self.image.lengths:
            self.image = before.image

    @property
    def exchanges(self) -> int:
        """Successful data exchanges since the start."""
        found = self._source.picture().slaves.get(self.setup.address)
        return 0 if found is None else found.exchanges

    def take(self, now: SlaveNow) -> None:
        """As it was told."""
        self.state = now.state
        self.fault = now.fault
        self.diagnosis = now.diagnosis
        self.alarm_counts = now.alarms
        self.watchdog_effective_ns = now.watchdog_ns


class MasterMirror:
    """The class 1 master, see :class:`dpstack.dp.master.master.Master`; its ``controls`` are this object, too."""

    def __init__(self, slaves: tuple[SlaveParams, ...], source: Source, *, read_only: bool) -> None:
        self.read_only = read_only
        self.mode = Mode.STOP if read_only else Mode.CLEAR
        self.handlers = {setup.address: SlaveMirror(setup, source) for setup in slaves}
        self.synced: frozenset[int] = frozenset()
        self.frozen: frozenset[int] = frozenset()
        #: the last round with data exchange, while ``on_round`` is set
        self.cycle: CycleData | None = None
        self._source = source
        self._on_round: Callable[[int], None] | None = None

    @property
    def cycles(self) -> CycleBook:
        """The books over fixed cycles, up to now."""
        return self._source.counters().cycles.book()

    @property
    def budget(self) -> CyclesNow:
        """What did not fit between fixed cycles, up to now."""
        return self._source.counters().cycles

    @property
    def controls(self) -> MasterMirror:
        """What is held by SYNC and FREEZE."""
        return self

    @property
    def rotation(self) -> Histogram:
        """Rotation times up to now."""
        return Histogram.of(self._source.counters().rotation)

    @property
    def rotation_count(self) -> int:
        """Rotations up to the last picture."""
        return self._source.picture().rotations

    @property
    def on_round(self) -> Callable[[int], None] | None:
        """Called at the end of every round with data exchange."""
        return self._on_round

    @on_round.setter
    def on_round(self, callback: Callable[[int], None] | None) -> None:
        changed = (callback is None) is not (self._on_round is None)
        self._on_round = callback
        if changed:
            self._source.watch_rounds(callback is not None)


class StationMirror:
    """The active station, see :class:`dpstack.fdl.active.station.ActiveStation`."""

    def __init__(self, params: BusParams, patience: Patience, source: Source) -> None:
        self.params = params
        self.patience = patience
        self.in_ring = False
        self.claimed = False
        self.las: frozenset[int] = frozenset()
        self._source = source

    @property
    def address(self) -> int:
        """TS."""
        return self.params.address

    @property
    def stats(self) -> LinkStats:
        """Counters of the link layer up to now."""
        return self._source.counters().link

    @property
    def decoder_stats(self) -> DecoderStats:
        """What was read up to now."""
        return self._source.counters().decoder

    @property
    def token_rotation(self) -> Histogram:
        """Token receipt to token receipt, up to now."""
        return Histogram.of(self._source.counters().token_rotation)


class WatcherMirror:
    """Of a read-only bus: what was found, see :class:`dpstack.dp.master.scanner.Scanner`."""

    def __init__(self) -> None:
        self.found: dict[int, Found] = {}
        self.done = False

    def take(self, now: WatcherNow) -> None:
        """As it was told."""
        self.found = {found.address: found for found in now.found}
        self.done = now.done


class Mirror:
    """All of them, kept by the :class:`~dpstack.drivers.process.messages.News`."""

    def __init__(self, master: MasterMirror, station: StationMirror, watcher: WatcherMirror | None) -> None:
        self.master = master
        self.station = station
        self.watcher = watcher

    def take(self, news: News) -> None:
        """The state that goes with the events of ``news``."""
        if news.bus is not None:
            self._take_bus(news.bus)
        for address, now in news.slaves.items():
            slave = self.master.handlers.get(address)
            if slave is not None:
                slave.take(now)
        if news.cycle is not None:
            self.master.cycle = news.cycle
        if news.watcher is not None and self.watcher is not None:
            self.watcher.take(news.watcher)

    def _take_bus(self, now: BusNow) -> None:
        master, station = self.master, self.station
        master.mode, master.synced, master.frozen = now.mode, now.synced, now.frozen
        station.in_ring, station.claimed, station.las = now.in_ring, now.claimed, now.las
        station.patience = now.patience

    def lost(self, fault: Fault) -> list[SlaveMirror]:
        """Nobody runs the bus any more, because of ``fault``: nothing is known of the slaves. Returns those whose state
        changed by it."""
        self.station.in_ring, self.station.las = False, frozenset()
        self.master.mode = Mode.OFFLINE
        self.master.synced = self.master.frozen = frozenset()
        changed = []
        for slave in self.master.handlers.values():
            if slave.state is not SlaveState.DEACTIVATED:
                if slave.state is not SlaveState.OFFLINE:
                    changed.append(slave)
                slave.state, slave.fault = SlaveState.OFFLINE, fault
        return changed

    def worded(self, event: Event) -> Event:
        """``event`` with what the GSD file of its slave says."""
        if isinstance(event, SlaveDiagnosis | AlarmRaised):
            slave = self.master.handlers.get(event.address)
            if slave is not None and (texts := slave.setup.texts) is not None:
                if isinstance(event, AlarmRaised):
                    return dataclasses.replace(event, texts=texts_beside(event.diagnosis, event.alarm, texts))
                said = block_texts(event.diagnosis, texts, dpv1=slave.setup.dpv1 is not None)
                return dataclasses.replace(event, texts=said)
        return event


def checked_arguments(args: Mapping[str, object]) -> dict[str, object]:
    """The arguments of a drive's order as JSON can carry them: what is no number there goes as text, to be refused."""
    return {key: _checked(value) for key, value in args.items()}


def _is_utf8(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _checked(value: object) -> object:
    """Lists and tables by their members."""
    match value:
        case str() if _is_utf8(value):
            return value
        case int() | None:
            return value
        case float() if math.isfinite(value):
            return value
        case list() | tuple():
            return [_checked(one) for one in value]
        case dict() if all(isinstance(key, str) for key in value):
            return {key: _checked(one) for key, one in value.items()}
    return repr(value)
