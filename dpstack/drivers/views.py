"""What an application sees of a running bus: the machines themselves, or their mirror where they run elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Protocol

from dpstack.dp.master.commands import Mode
from dpstack.dp.master.diag_reader import AlarmCounts
from dpstack.dp.master.events import Fault, SlaveState
from dpstack.dp.master.fixed_cycle import CycleBook, CycleData
from dpstack.dp.master.scanner import Found, SurveyOrder, SurveyResult
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.slave_params import SlaveParams
from dpstack.fdl.decoder import DecoderStats
from dpstack.fdl.interface import LinkStats
from dpstack.params import BusParams
from dpstack.phy.patience import Patience
from dpstack.stats import Histogram


class ImageSeen(Protocol):
    """See :class:`dpstack.dp.process_image.SlaveImage`."""

    @property
    def input_len(self) -> int:
        """Octets."""

    @property
    def output_len(self) -> int:
        """Octets."""

    @property
    def inputs(self) -> bytes:
        """The last valid ones."""

    @property
    def valid(self) -> bool:
        """Of a slave in data exchange."""

    @property
    def input_time(self) -> int:
        """When the inputs came, in ns; 0: there never were any."""

    @property
    def outputs(self) -> bytes:
        """Of the next Data_Exchange in Operate."""

    @outputs.setter
    def outputs(self, octets: bytes) -> None: ...

    @property
    def unit(self) -> object | None:
        """The drive plugin, if any."""


class HandlerSeen(Protocol):
    """See :class:`dpstack.dp.master.slave_handler.SlaveHandler`."""

    @property
    def setup(self) -> SlaveParams:
        """How it is parameterised."""

    @property
    def image(self) -> ImageSeen:
        """Its process image."""

    @property
    def state(self) -> SlaveState:
        """Where the master is with it."""

    @property
    def fault(self) -> Fault | None:
        """The last one."""

    @property
    def diagnosis(self) -> Diagnosis | None:
        """The last one."""

    @property
    def alarm_counts(self) -> AlarmCounts | None:
        """Of its alarms."""

    @property
    def exchanges(self) -> int:
        """Good ones."""

    @property
    def watchdog_effective_ns(self) -> int:
        """0 when off."""


class ControlsSeen(Protocol):
    """See :class:`dpstack.dp.master.global_control.Controls`."""

    @property
    def synced(self) -> Collection[int]:
        """Addresses."""

    @property
    def frozen(self) -> Collection[int]:
        """Addresses."""


class BudgetSeen(Protocol):
    """See :class:`dpstack.fdl.active.cycle_window.Budget`."""

    @property
    def held_back(self) -> int:
        """Waits."""

    @property
    def forced(self) -> int:
        """Sent without fitting in."""


class MasterSeen(Protocol):
    """See :class:`dpstack.dp.master.master.Master`."""

    @property
    def mode(self) -> Mode:
        """The mode."""

    @property
    def read_only(self) -> bool:
        """Nothing is sent to slaves."""

    @property
    def handlers(self) -> Mapping[int, HandlerSeen]:
        """By address."""

    @property
    def controls(self) -> ControlsSeen:
        """SYNC and FREEZE."""

    @property
    def cycle(self) -> CycleData | None:
        """The last round with data exchange, while somebody watches."""

    @property
    def cycles(self) -> CycleBook:
        """The books over fixed cycles."""

    @property
    def budget(self) -> BudgetSeen:
        """What did not fit between them."""

    @property
    def rotation(self) -> Histogram:
        """Times."""

    @property
    def rotation_count(self) -> int:
        """How many; quick to ask."""

    @property
    def on_round(self) -> Callable[[int], None] | None:
        """Called at the end of every round with data exchange."""

    @on_round.setter
    def on_round(self, callback: Callable[[int], None] | None) -> None: ...


class StationSeen(Protocol):
    """See :class:`dpstack.fdl.active.station.ActiveStation`."""

    @property
    def address(self) -> int:
        """TS."""

    @property
    def params(self) -> BusParams:
        """The bus parameters."""

    @property
    def patience(self) -> Patience:
        """At this moment."""

    @property
    def in_ring(self) -> bool:
        """It is given the token."""

    @property
    def claimed(self) -> bool:
        """It made the token itself."""

    @property
    def las(self) -> frozenset[int]:
        """The list of active stations."""

    @property
    def stats(self) -> LinkStats:
        """Counters."""

    @property
    def decoder_stats(self) -> DecoderStats:
        """Counters."""

    @property
    def token_rotation(self) -> Histogram:
        """Times."""


class WatcherSeen(Protocol):
    """See :class:`dpstack.dp.master.scanner.Scanner`."""

    @property
    def found(self) -> Mapping[int, Found]:
        """By address."""

    @property
    def done(self) -> bool:
        """Everything was asked once."""


class Survey(Protocol):
    """A live list that is being made."""

    async def begin(self, order: SurveyOrder) -> None:
        """Begin to ask. Raises DpError when the bus is over."""

    @property
    def result(self) -> SurveyResult | None:
        """None until everything was asked."""

    def end(self) -> None:
        """Nobody wants it any more. Raises DpError when the bus is over."""
