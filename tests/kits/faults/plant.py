"""A plant of the fault matrix: masters and slaves in a world of their own, with the truth of their wire."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import Any

from bus_kit import all_exchange, setup
from faults.truth import FAULTY, Application, Device, Truth
from slave_kit import make_slave
from support import MS, S

from dpstack.dp.master.commands import Mode, SetMode, Shutdown
from dpstack.dp.master.events import ForcedClear, MasterStopped, SlaveState, SlaveStateChanged, Stalled
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.plan.rotation_time import Case, Figures, OtherMasters
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.line.shutdown import step_limit_ns
from dpstack.drivers.runtime import last_bits_ns
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.fdl.events import RingLeft
from dpstack.fdl.interface import BusStation
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.sim.world import World
from dpstack.trace import Event

#: puts something between a master's station and the world: a driver, an adapter; returns what is added to the world
Plug = Callable[[ActiveStation, World], BusStation]

FIRST_MASTER = 2
FIRST_SLAVE = 20
HSA = 10


@dataclass
class MasterEnd:
    """One master: ``plugged`` is what stands in the world, with ``station`` in it."""

    station: ActiveStation
    master: Master
    plugged: BusStation
    applications: dict[int, Application]
    setups: Sequence[SlaveParams]
    events: list[Event] = field(default_factory=list)
    #: how many of ``events`` the operator has looked at
    looked: int = 0


class Plant:
    """``stations`` slaves of one master, or one for each of ``masters``, with the watchdogs that the plan recommends.

    ``rng``: for the faults. ``rotation_ns``: the plan's typical rotation, the unit of all times in the matrix.
    ``settings``: of the masters, beside the watchdog.
    """

    def __init__(
        self,
        baud: int,
        stations: int,
        seed: int,
        *,
        masters: int = 1,
        plug: Plug | None = None,
        patience: Patience = EXACT,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        self.world = world = World(seed=seed, keep=1)
        self.rng = Random(seed)
        self.truth = world.log.listener = Truth(baud)
        addresses = range(FIRST_SLAVE, FIRST_SLAVE + stations)
        setups = [setup(address) for address in addresses]
        params = BusParams.preset(baud, address=FIRST_MASTER, hsa=HSA, gap=1)
        shares = [setups[n::masters] for n in range(masters)]
        figures = Figures(params, shares[0], others=OtherMasters(alike=masters - 1))
        # the GAP is polled in nearly every rotation, so that a master that was dropped is let in again soon: T_TR has
        # room for the rounds, and none for acyclic services, which nobody orders here
        normal = figures.rotations[Case.NORMAL]
        self.params = params = params.replace(t_tr=normal.work + normal.hold)
        self.rotation_ns = figures.ns(Case.TYPICAL)
        self.longest_ns = figures.ns(Case.LONGEST)
        self.watchdog_ns = figures.watchdog_ms() * MS
        self.devices = {address: [Device(address)] for address in addresses}
        self.stations = {a: make_slave(a, devices[0], params) for a, devices in self.devices.items()}
        for slave in self.stations.values():
            world.add(slave)
        options = {"watchdog_ms": figures.watchdog_ms(), **(settings or {})}
        self.masters = [
            self._master(params.replace(address=FIRST_MASTER + n), share, MasterSettings(**options), plug, patience)
            for n, share in enumerate(shares)
        ]
        #: when slaves lost their power
        self.restarts: dict[int, list[int]] = {}
        #: when the fault ended
        self.over_ns = -1

    def _master(
        self,
        params: BusParams,
        setups: Sequence[SlaveParams],
        settings: MasterSettings,
        plug: Plug | None,
        patience: Patience,
    ) -> MasterEnd:
        master = Master(params, setups, settings)
        station = ActiveStation(params, (master,), patience=patience, window=master.window, now=self.world.now)
        plugged = station if plug is None else plug(station, self.world)
        end = MasterEnd(station, master, plugged, {s.address: Application(s.address) for s in setups}, setups)
        for address, image in master.images.items():
            image.plugin = end.applications[address]
        self.world.add(plugged, name=str(params.address), on_events=end.events.extend)
        self.world.command(plugged, GoOnline())
        self.world.command(plugged, SetMode(Mode.OPERATE))
        return end

    # --- time ---------------------------------------------------------------------------------------------------

    def rotations(self, count: float) -> None:
        """Let so many planned rotations pass."""
        self.world.run_for(round(count * self.rotation_ns))

    def at_least(self, rotations: float, ns: int) -> None:
        """Let so many rotations pass, and no less than ``ns``."""
        self.world.run_for(max(round(rotations * self.rotation_ns), ns))

    def after(self, ns: int, action: Callable[[], None]) -> None:
        """Call ``action`` in ``ns``."""
        self.world.call_at(self.world.now + ns, action)

    # --- the plant's people --------------------------------------------------------------------------------------

    @property
    def master(self) -> MasterEnd:
        return self.masters[0]

    @property
    def victim(self) -> int:
        """The slave that a fault of one slave is about: the one in the middle."""
        return FIRST_SLAVE + len(self.devices) // 2

    @property
    def events(self) -> list[Event]:
        """The events of all masters."""
        return [event for end in self.masters for event in end.events]

    def operate(self) -> None:
        """Order Operate again where a master went to Clear by itself, as a person does who has looked at the plant."""
        for end in self.masters:
            told, end.looked = end.events[end.looked :], len(end.events)
            if any(isinstance(event, ForcedClear) for event in told):
                self.world.command(end.plugged, SetMode(Mode.OPERATE))

    @property
    def well(self) -> bool:
        """Every master is in the ring and in Operate, and since the end of the fault every device got live outputs and
        every application inputs of a device."""
        return (
            all(end.station.in_ring and end.master.mode is Mode.OPERATE for end in self.masters)
            and all(all_exchange(end.master) for end in self.masters)
            and all(any(d.live_at > self.over_ns for d in devices) for devices in self.devices.values())
            and all(
                application.calls and application.calls[-1][1] and application.calls[-1][0] > self.over_ns
                for end in self.masters
                for application in end.applications.values()
            )
        )

    def until_well(self, limit_ns: int) -> int | None:
        """Rotations until all is well, and stays so for five more; None: not within ``limit_ns``."""
        begun, calm = self.world.now, 0
        passed = 0
        while calm < 5:
            self.operate()
            if self.well:
                calm += 1
            else:
                calm = 0
                if self.world.now - begun > limit_ns:
                    return None
            self.rotations(1)
            passed += 1
        return passed - calm

    def end(self) -> None:
        """The ordered end of all masters, with the time limits of a program's."""
        for end in self.masters:
            self._order(end, Shutdown(), MasterStopped)
            if end.station.in_ring:
                self._order(end, GoOffline(), RingLeft)
            self.world.run_for(last_bits_ns(self.params))

    def _order(self, end: MasterEnd, order: object, reached: type[Event]) -> None:
        told = len(end.events)
        self.world.command(end.plugged, order)

        def done() -> bool:
            return any(isinstance(event, reached) for event in end.events[told:])

        if not done():
            self.world.run(self.world.now + step_limit_ns(self.longest_ns), done)

    # --- a slave's power -------------------------------------------------------------------------------------------

    def switch_off(self, address: int) -> None:
        """Take a slave off the bus; it forgets everything."""
        station = self.stations[address]
        self.world.remove(station)
        assert isinstance(station.responder, SlaveApp)
        station.responder.restart(self.world.now)
        self.restarts.setdefault(address, []).append(self.world.now)
        self.truth.away.setdefault(address, []).append((self.world.now, 1 << 62))

    def switch_on(self, address: int) -> None:
        """Put it back, as a slave that nobody has parameterised."""
        times = self.truth.away[address]
        times[-1] = times[-1][0], self.world.now
        self.stations[address] = station = PassiveStation(address, self.stations[address].responder, self.params)
        self.world.add(station)

    # --- figures ---------------------------------------------------------------------------------------------------

    def drops(self, since: Mapping[int, int]) -> list[tuple[MasterEnd, SlaveStateChanged]]:
        """The slaves that left data exchange; ``since``: the number of earlier events by master."""
        found = []
        for number, end in enumerate(self.masters):
            exchanging: set[int] = set()
            for place, event in enumerate(end.events):
                if not isinstance(event, SlaveStateChanged):
                    continue
                if event.state is SlaveState.DATA_EXCHANGE:
                    exchanging.add(event.address)
                elif event.address in exchanging:
                    exchanging.discard(event.address)
                    if place >= since[number] and event.state is not SlaveState.DEACTIVATED:
                        found.append((end, event))
        return found

    def dropped_wrongly(self, end: MasterEnd, event: SlaveStateChanged) -> bool:
        """Whether nothing on the wire is a reason for the master to lose the slave.

        Reasons: the fault touched the request, its answer or the silence before it in the last attempt and in all its
        repetitions; the slave was restarted by the fault since its last exchange; the slave got no intact request for
        longer than its watchdog; the master had no token for T_TR and a second.
        """
        address, at = event.address, event.t_ns
        tries = self.params.max_retry + 1
        attempts = self.truth.attempts(address, at + 1, tries)
        if len(attempts) == tries and all(attempt.touched for attempt in attempts):
            return False
        restarted = [begin for begin in self.restarts.get(address, ()) if begin <= at]
        if restarted and not any(restarted[-1] < now < at for now, _, _ in self.devices[address][0].taken):
            return False
        silent = self.truth.unasked_ns(address, at, 2 * self.watchdog_ns + self.longest_ns)
        return silent <= min(self.watchdog_ns, S + self.params.ns(self.params.t_tr))

    def stalls(self) -> list[Stalled]:
        return [event for event in self.events if isinstance(event, Stalled)]

    def trouble(self) -> dict[str, int]:
        """The counters of all masters that are signs of trouble."""
        totals: dict[str, int] = {}
        for end in self.masters:
            station = end.station
            remote = station.stats.stations.values()
            counted = {
                "given up": sum(s.timeouts for s in remote),
                "late or wrong": sum(s.late + s.wrong for s in remote),
                "tokens lost": station.stats.tokens_lost,
                "tokens repeated": station.stats.token_retries,
                "withdrawn": station.stats.withdrawn,
                "bad frames": station.decoder_stats.bad,
            }
            for name, value in counted.items():
                totals[name] = totals.get(name, 0) + value
        assert self.world.referee is not None
        totals["referee"] = len(self.world.referee.violations)
        return totals

    def inject(self, octets: bytes) -> None:
        """Put octets on the line that no station sends."""
        self.world.inject(octets, baud=self.params.baud, sender=FAULTY)
