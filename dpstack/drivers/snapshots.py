"""Snapshots of a bus for its application: made on the side of the bus, the same with every driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from msgspec import Struct, field

from dpstack.dp.master.bring_ups import History
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import Fault, SlaveState
from dpstack.dp.master.fixed_cycle import CycleData, CycleStats
from dpstack.dp.master.scanner import Found
from dpstack.dp.master.slave_reports import AlarmCounts
from dpstack.dp.pdu.alarm_blocks import Alarm
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.slave_params import SlaveParams
from dpstack.fdl.interface import DecoderStats, LinkStats
from dpstack.phy.patience import Lateness, Patience
from dpstack.stats import Histogram


class SlaveSnapshot(Struct, frozen=True):
    """One slave as its master handles it."""

    #: state in which the master has the slave
    state: SlaveState = SlaveState.OFFLINE
    #: why the slave is not in data exchange; None without a fault
    fault: Fault | None = None
    #: last diagnosis read; None before the first
    diagnosis: Diagnosis | None = None
    #: watchdog in effect in ns, 0 when off
    watchdog_ns: int = 0
    #: counters of its alarms; None for a slave that is not parameterised for DP-V1
    alarms: AlarmCounts | None = None
    #: the alarms whose slots are not good again
    standing: tuple[Alarm, ...] = ()
    #: how many times the diagnosis was another one than before
    diagnoses: int = 0
    #: time in ns at which it was read
    diagnosis_ns: int = 0
    #: outputs that wait to be set anew, see :class:`dpstack.dp.process_image.SlaveImage`
    withheld: bytes | None = None


class ImageSnapshot(Struct, frozen=True, array_like=True):
    """Inputs and outputs of one slave, see :class:`dpstack.dp.process_image.SlaveImage`; they change every round.

    ``exchanges``: successful ones since the start. ``announced``: an answer with DH has announced a diagnosis that is
    not read yet. ``diagnoses``: as in :class:`SlaveSnapshot`; it is higher there or here, if one comes later than the
    other. ``returns``: how many times the outputs were made safe until they are set anew.
    """

    inputs: bytes
    outputs: bytes
    valid: bool
    exchanges: int
    input_time: int
    announced: bool = False
    diagnoses: int = 0
    returns: int = 0


class SentClock(Struct, frozen=True):
    """The last Clock_Value of a class 3 master."""

    #: address of the master
    master: int
    #: time of the plant in ns since 1970
    time_ns: int
    #: resolution (CR) in ms
    resolution_ms: int
    #: not SYF: the clock of the master is synchronised
    synchronised: bool
    #: the master has summer time (SWT)
    summer_time: bool
    #: time of the bus in ns at which it was on the line
    at_ns: int
    #: number of Clock_Values so far
    values: int


class ClockSnapshot(Struct, frozen=True):
    """The time on the bus (DP-V2)."""

    #: interval in ns in which this master sends the time; 0: it sends none
    interval_ns: int
    #: lateness of the port that the resolution holds
    lateness: Lateness
    #: the last time that this master has sent; None: none yet
    sent: SentClock | None = None
    #: why no time is sent although it is due; empty: it is sent
    trouble: str = ""
    #: class 3 masters beside this one, by address
    others: tuple[SentClock, ...] = ()


class BusSnapshot(Struct, frozen=True):
    """Master and station. ``claimed``: the station made the token itself. ``las``: the list of active stations.

    ``found``: on a watched read-only bus the stations by address, else None; ``found_all``: the scanner has asked every
    address once.
    """

    #: mode of the master
    mode: Mode
    #: slack for late answers of this port, and what the computer adds
    patience: Patience
    #: addresses of the slaves that this master holds in SYNC
    synced: frozenset[int] = frozenset()
    #: addresses of the slaves that this master holds in FREEZE
    frozen: frozenset[int] = frozenset()
    #: the station takes part in the token ring
    in_ring: bool = False
    claimed: bool = False
    las: frozenset[int] = frozenset()
    found: Mapping[int, Found] | None = None
    found_all: bool = False
    #: the time on the bus; None: nobody sends it
    clock: ClockSnapshot | None = None


class Counters(Struct, frozen=True, kw_only=True):
    """All counters at the time ``t_ns`` (0: the final values).

    ``lateness``: how late the port delivers answers. ``held_back`` and ``forced``: see
    :class:`dpstack.fdl.active.cycle_window.CycleWindow`. ``damage``: octets that arrived damaged, by cause, as far as
    the port reports them.
    """

    t_ns: int = 0
    rotation: Histogram = field(default_factory=Histogram)
    token_rotation: Histogram = field(default_factory=Histogram)
    lateness: Histogram = field(default_factory=Histogram)
    link: LinkStats = field(default_factory=LinkStats)
    decoder: DecoderStats = field(default_factory=DecoderStats)
    cycles: CycleStats = field(default_factory=lambda: CycleStats(0))
    held_back: int = 0
    forced: int = 0
    damage: Mapping[str, int] = field(default_factory=dict)


class View(Protocol):
    """Access of an application to the snapshots of its bus, the same with every driver. Reading never waits, except
    for :meth:`history`."""

    @property
    def read_only(self) -> bool:
        """True when the master sends nothing that could change a slave."""

    @property
    def setups(self) -> Mapping[int, SlaveParams]:
        """The parameters of the slaves by address."""

    @property
    def mode(self) -> Mode:
        """The mode in :meth:`bus`, without the rest, which orders need at each output."""

    def bus(self) -> BusSnapshot: ...

    def slave(self, address: int) -> SlaveSnapshot:
        """The slave at ``address``; offline without one."""

    def image(self, setup: SlaveParams) -> ImageSnapshot:
        """Inputs and outputs of the slave with ``setup``; zeros and its first outputs if it is not there."""

    async def history(self, address: int) -> History:
        """The last bring-ups of the slave at ``address``, empty without one; a bus process is asked for it.

        Raises OrderDropped, BusError.
        """

    def set_outputs(self, address: int, octets: bytes) -> None:
        """The outputs of the next Data_Exchange in Operate. Raises ValueError for a wrong length."""

    def counters(self) -> Counters:
        """A copy of all counters."""

    def counted(self) -> Counters:
        """All counters, for a reader that takes what it needs at once: they may go on changing."""

    @property
    def link(self) -> LinkStats:
        """The counters of the link layer, to be read only."""

    @property
    def rotations(self) -> int:
        """Number of rotations; quick to read."""

    @property
    def cycle(self) -> CycleData | None:
        """The last round with data exchange, while :meth:`watch_rounds` is on."""

    def watch_rounds(self, on_round: Callable[[], None] | None) -> None:
        """Call ``on_round()`` at the end of every round with data exchange; None: no longer."""


def no_image(setup: SlaveParams) -> ImageSnapshot:
    outputs = setup.safe_outputs if setup.initial is None else setup.initial
    return ImageSnapshot(bytes(setup.input_len), outputs, False, 0, 0)
