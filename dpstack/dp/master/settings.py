"""Settings of a DP master that do not depend on its slaves, the state that all its parts share, and all plain data of a
bus."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Final

from msgspec import Struct

from dpstack.dp.master.commands import Mode
from dpstack.dp.slave_params import SlaveParams
from dpstack.params import BusParams
from dpstack.phy.patience import Lateness, Patience
from dpstack.trace import Event
from dpstack.units import NS_PER_S


class MasterSettings(Struct, frozen=True, kw_only=True):
    """``watchdog_ms`` is the default of slaves without a watchdog time of their own.

    ``absent_divisor``: while any slave is in data exchange, silent polls of absent slaves take at most
    1/absent_divisor of the bus time; 0 = no limit. ``auto_clear``: to Clear when a slave had no good data exchange for
    ``data_control_ns``. ``safe_after_stall``: to Clear before anything is sent after a time in which a slave was not
    asked for longer than its watchdog. ``application_watchdog_ns``: to Clear when
    :class:`~dpstack.dp.master.commands.Alive` did not come for so long in Operate; 0 is off. ``read_only``: the master
    stays in Stop, which sends nothing to slaves.

    ``cycle_ns``: the rounds begin on a grid of this length, best effort (0: free running). ``cycle_freeze``,
    ``cycle_sync``: groups (1..8) that every cycle sends FREEZE and SYNC to. ``clock_sync_ns``: interval of the time
    that this master sends as a class 3 master, 0 = none; ``clock_is_virtual``: it begins with 2026 and follows the
    time of the bus, else it is this computer's.
    """

    watchdog_ms: int = 200
    absent_divisor: int = 0
    auto_clear: bool = False
    data_control_ns: int = NS_PER_S  # the standard's default
    safe_after_stall: bool = True
    application_watchdog_ns: int = 0
    read_only: bool = False
    cycle_ns: int = 0
    cycle_freeze: tuple[int, ...] = ()
    cycle_sync: tuple[int, ...] = ()
    clock_sync_ns: int = 0
    clock_is_virtual: bool = False


DEFAULTS: Final = MasterSettings()


class MasterContext:
    """Shared by the parts of a master: bus parameters, settings, its mode, and the events for the application."""

    def __init__(self, params: BusParams, settings: MasterSettings) -> None:
        self.params = params
        self.settings = settings
        self.mode = Mode.STOP if settings.read_only else Mode.CLEAR
        #: the mode that the master is on its way to
        self.target = Mode.CLEAR
        #: in Operate, and to stay there
        self.operates = False
        #: outputs become safe: nothing waits for a grid
        self.descending = self.target < self.mode
        self.events: list[Event] = []
        #: addresses of slaves whose state, fault, diagnosis or alarm counts have changed, until somebody takes them
        self.changed: set[int] = set()
        #: addresses of slaves whose last answer announced a diagnosis that is not read yet
        self.announced: set[int] = set()
        #: called as a round begins: outputs that it puts into the process image go out in that round
        self.on_begin: Callable[[], None] = lambda: None
        #: gives the addresses of the masters in the token ring, None if they are not known
        self.ring: Callable[[], Collection[int] | None] = lambda: None
        #: gives the lateness of the port; None on a bus in virtual time, which is exact
        self.lateness: Callable[[], Lateness | None] = lambda: None

    def reach(self, mode: Mode) -> None:
        """Be in ``mode``."""
        self._go(mode, self.target)

    def head_for(self, target: Mode) -> None:
        """Be on the way to ``target``."""
        self._go(self.mode, target)

    def _go(self, mode: Mode, target: Mode) -> None:
        self.mode, self.target = mode, target
        self.operates = mode is target is Mode.OPERATE
        self.descending = target < mode

    def emit(self, event: Event) -> None:
        """Report ``event`` to the application."""
        self.events.append(event)


class StackSpec(Struct, frozen=True, kw_only=True):
    """The plain data that the machines of a bus are made from.

    ``watched``: a read-only bus shows the state of its stations. ``dp`` False: the station has no DP master and no
    acyclic services of DP; the master stays in Stop, sends nothing, and no guard watches the requests of other users.
    """

    params: BusParams
    patience: Patience
    slaves: tuple[SlaveParams, ...]
    master: MasterSettings
    watched: bool
    dp: bool = True
