"""A fixed cycle under fire: slaves that flap, come, go and change, class 2, modes, FREEZE and SYNC, tight cycles.

What is asked of every run: no exception, no fault on the wire, starts on the grid or counted, each Min_Slave_Interval.
"""

from __future__ import annotations

import contextlib
import itertools
import random

import pytest
from bus_kit import mirror
from msgspec.structs import replace
from support import MS, WorldFactory

from dpstack.dp.acyclic.class2 import ReadService, Service
from dpstack.dp.master.commands import (
    ActivateSlave,
    AddSlave,
    DeactivateSlave,
    Mode,
    RemoveSlave,
    ReparameteriseSlave,
    SetMode,
)
from dpstack.dp.master.fixed_cycle import Cadence, CycleData
from dpstack.dp.plan.rotation_time import Case, Figures
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.stack import acyclic_services
from dpstack.errors import BusError, UsageError
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, HOST
from dpstack.sim.world import World
from tests.dp.master.cycle_kit import CycleBus, slave

#: addresses from here on are of slaves added later
_LATER = 50


class Attack:
    """One bus and what is done to it, all by the seed ``n``."""

    def __init__(self, world: World, n: int) -> None:
        self.random = r = random.Random(n)
        params = BusParams.preset(r.choice((187_500, 500_000, 1_500_000, 12_000_000)), address=2, gap=r.choice((0, 1)))
        setups = [self.setup(address) for address in r.sample(range(3, 40), r.randint(1, 6))]
        shortest = Figures(params, setups).work_ns(Case.SHORTEST)
        self.cycle_ns = cycle_ns = int(shortest * r.choice((1.05, 1.3, 2.0, 3.0)))
        whole = 100_000  # Min_Slave_Interval comes in these
        self.setups = [
            replace(s, min_slave_interval_ns=r.choice((0, cycle_ns * s.every // whole * whole))) for s in setups
        ]
        self.params = params = params.replace(t_tr=Figures(params, setups).t_tr_preset)
        options: dict[str, object] = {
            "absent_divisor": r.choice((0, 100)),
            "cycle_freeze": r.choice(((), (1,))),
            "cycle_sync": r.choice(((), (), (1,))),
            "auto_clear": r.random() < 0.2,
            "data_control_ns": 50 * MS,
        }
        self.bus = CycleBus(
            world,
            params,
            self.setups,
            cycle_ns,
            silent=[s.address for s in setups[1:] if r.random() < 0.2],
            more=[acyclic_services(2)],
            options=options,
            patience=r.choice((EXACT, HOST)),
        )
        self.cycles: list[CycleData] = []
        self.bus.master.on_round = self._on_round
        self.there = dict(self.bus.slaves)
        self.gone: list[int] = []
        self.number = itertools.count()
        self.grid = self.grids = 0  # the number of the grid that rounds are on, 0 without one; how many there were
        self.grid_of: dict[int, int] = {}

    def setup(self, address: int) -> SlaveParams:
        r = self.random
        return slave(
            address,
            every=r.choice((1, 1, 1, 2, 3, 4)),
            safe=r.choice((bytes(12), bytes([9]) * 12)),
            watchdog_ms=2000,
            groups=r.choice(((), (1,))),
            sync=True,
            freeze=True,
        )

    def _on_round(self, now: int) -> None:
        if self.bus.master.cycle is not None and self.bus.master.cycle not in self.cycles[-1:]:
            self.cycles.append(self.bus.master.cycle)
            self.grid_of[self.bus.master.cycle.published] = self.grid

    def on_grid(self, before: bool, now: bool) -> None:
        """A round begins; the first one of a grid may begin anywhere."""
        self.grids += now and not before
        self.grid = self.grids if now else 0

    def strike(self) -> None:
        """Something happens at some time."""
        r, bus, world = self.random, self.bus, self.bus.world
        world.run_for(r.randint(0, 12 * self.cycle_ns))
        address = r.choice([*bus.master.handlers, 3])
        new = _LATER + next(self.number)
        match r.choice(
            ("flap", "flap", "die", "back", "back", "read", "read", "mode", "remove", "add", "change", "off", "on")
        ):
            case "flap" if address in self.there:
                world.silence(self.there[address], r.randint(1, 5 * self.cycle_ns), deaf=r.random() < 0.5)
            case "die" if address in self.there:
                world.remove(self.there.pop(address))
                self.gone.append(address)
            case "back" if self.gone:
                self._come(self.gone.pop())
            case "read":
                world.command(bus.station, ReadService(new, address, r.choice((Service.DIAGNOSIS, Service.CONFIG))))
            case "mode":
                modes = (Mode.STOP, Mode.CLEAR, Mode.OPERATE, Mode.OPERATE)
                world.command(bus.station, SetMode(r.choice(modes)))
            case "remove":
                world.command(bus.station, RemoveSlave(address))
            case "add" if new < 120:
                world.command(bus.station, AddSlave(self.setup(new)))
                if r.random() < 0.7:
                    self._come(new)
            case "change" if address in bus.master.handlers:
                before = bus.master.handlers[address].setup
                changed = replace(before, every=before.every + 1)
                world.command(bus.station, ReparameteriseSlave(changed))
            case "off":
                world.command(bus.station, DeactivateSlave(address))
            case "on":
                world.command(bus.station, ActivateSlave(address))

    def _come(self, address: int) -> None:
        self.there[address] = mirror(address, self.params)
        self.bus.world.add(self.there[address])

    def hold_grid(self) -> None:
        """Between two cycles of one grid lie as many as their numbers say; none is near, early, or later than half."""
        cycle_ns = self.cycle_ns
        slack = self.params.ns(self.params.t_sl + 300)  # a token, and idle times, after it was judged
        spaced = any(setup.min_slave_interval_ns for setup in self.setups)
        for earlier, later in itertools.pairwise(self.cycles):
            assert later.number > earlier.number
            assert later.t_ns >= later.due_ns - 1
            if self.grid_of[earlier.published] == self.grid_of[later.published] > 0:
                apart = later.due_ns - earlier.due_ns
                assert apart % cycle_ns == 0
                assert later.number - earlier.number == apart // cycle_ns
                # a first slave whose Min_Slave_Interval is not over holds its round up, which was begun in time
                assert spaced or later.late_ns <= cycle_ns // 2 + slack
                assert spaced or later.t_ns - earlier.t_ns >= cycle_ns // 2 - slack

    def hold_intervals(self) -> None:
        for setup in self.setups:
            starts = self.bus.exchanges(setup.address)
            for earlier, later in itertools.pairwise(starts):
                assert later - earlier >= setup.min_slave_interval_ns


@pytest.mark.parametrize("n", [*range(10), *(pytest.param(n, marks=pytest.mark.soak) for n in range(10, 400))])
def test_cycles_stay_on_the_grid_under_any_fault(world: WorldFactory, n: int) -> None:
    attack = Attack(world(), n)
    begin = Cadence.begin

    def begun(cadence: Cadence, now: int, *, fixed: bool, interval: int) -> None:
        going = cadence.fixed
        begin(cadence, now, fixed=fixed, interval=interval)
        attack.on_grid(going, cadence.fixed)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Cadence, "begin", begun)
        for _ in range(30):
            with contextlib.suppress(UsageError, BusError):  # what makes no sense now is refused
                attack.strike()
        attack.bus.run(10 * attack.cycle_ns)
    attack.hold_grid()
    attack.hold_intervals()
