"""Plants with a fault: a configuration as the user wrote it, and the bus as it really is, in virtual time.

A plant knows the causes of its trouble because it was built with them, see ``fault_table``. Nothing here knows how
they are found: a diagnosis gets ``plant.name`` and the bus of :func:`bring`, and the test compares its causes with
``plant.causes``. The facts that prove the trouble are the counters and events of the simulated devices and the wire
log of the world.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any, Final

from bus_kit import add_station
from plant_files import plant_text

import dpstack
from dpstack.api.config.config import slave_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave_side.virtual_bench import device_of
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.device import Device
from dpstack.errors import DpError
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.passive.station import PassiveStation
from dpstack.machine import LineDown
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event, WireEntry

MS: Final = 1_000_000
ROOT: Final = Path(__file__).parents[2]
TERMINAL: Final = str(ROOT / "examples" / "terminal.gsd")

#: rate -> seconds in which a few slaves come up. Faster rates would take more time of the computer for nothing
RATES: Final = {45_450: 2.5, 93_750: 1.0, 187_500: 0.5, 500_000: 0.25, 1_500_000: 0.12}
TERMINAL_RATES: Final = (45_450, 500_000)
#: T_TR of other masters in bit times: they look for new masters once in that time
T_TR: Final = 15_000
#: highest station address of the masters, so that a GAP pass is short; slaves are above it
HSA: Final = 9
#: modules of dpstack's I/O station, and of examples/terminal.gsd
IO_MODULES: Final = ("8 DI", "16 DI", "8 DO", "16 DO", "2 AI", "2 AO")
TERMINAL_MODULES: Final = ("8 DI", "8 DO", "4 AI")
#: identifier octets of made-up slaves: octets, words, inputs and outputs, consistent or not
CONFIGS: Final = ("20 10", "21 11", "F3 F1", "10 20 30", "61 51", "31", "93 A1")

Table = dict[str, Any]


@dataclass(eq=False)
class Unit:
    """A slave that is really there. ``events``: its own, oldest first."""

    station: PassiveStation
    app: SlaveApp
    events: list[Event] = field(default_factory=list)
    #: how often it was connected
    plugged: int = 0

    @property
    def address(self) -> int:
        return self.station.address

    @property
    def requests(self) -> int:
        """Telegrams that it received for its address, repetitions and FDL status requests too."""
        stats = self.station.stats
        return stats.requests + stats.repeats + stats.status

    def texts(self) -> str:
        """Its events for people, a line each."""
        return "\n".join(event.text for event in self.events)


@dataclass(eq=False)
class OtherMaster:
    """A second real master. ``events``: its own, oldest first."""

    station: ActiveStation
    master: Master
    events: list[Event] = field(default_factory=list)

    def exchanges_with(self, address: int) -> bool:
        return self.master.handlers[address].state is SlaveState.DATA_EXCHANGE


class Plant:
    """A plant with the fault ``fault`` and its ``seed``; :func:`bring` runs it, once.

    ``tables``: the [[slave]] tables of the user, that of slave ``name`` first; ``bus_keys``: his keys of [bus].
    ``causes``: the right answers, by the fixed names of ``dpstack why``. With ``every`` all of them are wanted (a
    pair of faults), each as the first one; otherwise one is enough. ``asked``: the unit that answers for the slave, if
    there is one. ``stretch``, ``least_s``: more time, as a factor and in seconds, until the slave is asked about.
    """

    def __init__(
        self, fault: str, seed: int, causes: Sequence[str], *, every: bool = False, rates: Sequence[int] = tuple(RATES)
    ) -> None:
        self.fault = fault
        self.seed = seed
        self.causes = frozenset(causes)
        self.every = every
        self.rng = Random(f"{fault} {seed}")
        self.world = World(seed=seed, referee=False, keep=20_000)
        self.rates = rates
        self.baud = self.rng.choice(rates)
        self.address = self.rng.randrange(HSA - 1)
        self.bus_keys: Table = {"hsa": HSA, "gap": self.rng.randint(1, 3)}
        self.tables: list[Table] = []
        self.units: list[Unit] = []
        self.masters: list[OtherMaster] = []
        self.name = ""
        self.stretch = 1.0
        self.least_s = 0.0
        self.orders: list[Callable[[dpstack.Bus], Awaitable[object]]] = []
        self.asked: Unit | None = None
        self.driven = ""
        self.failure: DpError | None = None
        self._free = self.rng.sample(range(HSA + 1, 126), 60)
        self._free_masters = [one for one in range(HSA) if one != self.address]

    def __repr__(self) -> str:
        return f"<{self.fault} {self.seed}>"

    @property
    def seconds(self) -> float:
        """Bus time in seconds from the opening of the user's bus until the slave is asked about."""
        rate = RATES[self.baud]
        join = 4 * T_TR / self.baud if self.masters else 0.0
        return max(rate * self.stretch + join, self.least_s)

    # --- addresses and parameters ---------------------------------------------------------------------------------

    def free_address(self) -> int:
        return self._free.pop()

    def free_master(self) -> int:
        return self._free_masters.pop(self.rng.randrange(len(self._free_masters)))

    @property
    def at(self) -> int:
        """The address of the slave asked about, as it is configured."""
        address: int = self.tables[0]["address"]
        return address

    def params(self, baud: int | None = None, **given: int) -> BusParams:
        """The bus parameters of a real station."""
        return BusParams.preset(baud or self.baud, slave_max_tsdr=[250 if self.baud == 45_450 else 100], **given)

    @property
    def slave(self) -> SlaveConfig:
        """The slave asked about, as it is configured."""
        return slave_config(self.tables[0])

    # --- tables ---------------------------------------------------------------------------------------------------

    def made_up(self, **keys: object) -> Table:
        """A slave without GSD file."""
        prm = bytes([0, *self.rng.randbytes(self.rng.randint(2, 9))]) if self.rng.random() < 0.7 else b""
        table: Table = {
            "ident": self.rng.randrange(0x1000, 0xFFFF),
            "config": self.rng.choice(CONFIGS),
            "user_prm": prm.hex(" "),
        }
        return self._named(table | keys)

    def io_station(self, **keys: object) -> Table:
        modules = [self.rng.choice(IO_MODULES) for _ in range(self.rng.randint(2, 6))]
        return self._named({"gsd": "io-station", "modules": modules, **keys})

    def terminal(self, **keys: object) -> Table:
        """The terminal of the examples. It knows two rates of the plants only: the plant takes one of them."""
        if self.baud not in TERMINAL_RATES:
            self.baud = self.rng.choice([rate for rate in TERMINAL_RATES if rate in self.rates] or TERMINAL_RATES[:1])
        modules = self.terminal_modules()
        return self._named({"gsd": TERMINAL, "modules": modules, **keys})

    def terminal_modules(self) -> list[str]:
        """Two to four modules, among them at most one of those that take half of the input octets."""
        modules = [self.rng.choice(TERMINAL_MODULES[:2]) for _ in range(self.rng.randint(2, 4))]
        if self.rng.random() < 0.6:
            modules[self.rng.randrange(len(modules))] = TERMINAL_MODULES[2]
        return modules

    def hoist(self, **keys: object) -> Table:
        return self._named({"drive": "demag-dedrive", "options": {"set_412": True}, **keys})

    def _named(self, table: Table) -> Table:
        kind = str(table.get("drive") or Path(str(table.get("gsd", "raw"))).stem)
        address = table.get("address") or self.free_address()
        return {"name": f"{kind} {address}", "address": address, **table}

    def ask(self, table: Table) -> None:
        """``table`` is that of the slave asked about."""
        self.tables.insert(0, table)
        self.name = str(table["name"])

    def ask_any(self, *kinds: str) -> None:
        """The slave asked about is one of ``kinds`` (the methods above)."""
        kind = self.rng.choice(kinds or ("made_up", "io_station", "terminal"))
        self.ask(getattr(self, kind)())

    # --- stations that are really there -----------------------------------------------------------------------------

    def unit(
        self,
        device: Device | SlaveApp,
        address: int,
        *,
        baud: int | None = None,
        t_sdr: int | None = None,
        kind: type[PassiveStation] = PassiveStation,
        on: bool = True,
        label: str | None = None,
    ) -> Unit:
        """Put a slave on the bus; its answers begin ``t_sdr`` bit times after the request."""
        app = device if isinstance(device, SlaveApp) else SlaveApp(device)
        least = t_sdr if t_sdr is not None else self.rng.randint(11, 50)
        station = kind(address, app, self.params(baud), t_sdr=max(11, least))
        unit = Unit(station, app)
        self.units.append(unit)
        if on:
            self.plug(unit, label)
        return unit

    def plug(self, unit: Unit, label: str | None = None) -> None:
        unit.plugged += 1
        self.world.add(unit.station, name=label or f"slave {unit.address}", on_events=unit.events.extend)

    def unplug(self, unit: Unit) -> None:
        self.world.remove(unit.station)
        unit.station.command(LineDown("no power"), self.world.now)

    def there(self, table: Table, **more: Any) -> Unit:
        """Put a slave on the bus as ``table`` configures it."""
        config = slave_config(table)
        return self.unit(device_of(config), config.address, **more)

    def real(self, table: Table | None = None, **more: Any) -> Unit:
        """The slave asked about is there, as ``table`` (default: as it is configured)."""
        self.asked = self.there(table or self.tables[0], **more)
        return self.asked

    def asked_unit(self, app: SlaveApp | Device, **more: Any) -> Unit:
        """The slave asked about is there, and is ``app``."""
        self.asked = self.unit(app, self.at, **more)
        return self.asked

    def neighbours(self, least: int = 1, most: int = 4) -> list[Unit]:
        """So many healthy slaves beside it, configured and there; one may be a drive that runs."""
        found = []
        for _ in range(self.rng.randint(least, most)):
            kinds = ["made_up", "made_up", "io_station"]
            if not self.driven:
                kinds.append("hoist")
            table = getattr(self, self.rng.choice(kinds))()
            if "drive" in table:
                self.driven = str(table["name"])
            self.tables.append(table)
            found.append(self.there(table))
        return found

    def other_master(
        self,
        *slaves: SlaveParams,
        address: int | None = None,
        baud: int | None = None,
        watchdog_ms: int = 2_000,
        **given: int,
    ) -> OtherMaster:
        """Another master from now on, with a slave of its own beside ``slaves``."""
        own = self.free_master() if address is None else address
        params = self.params(baud, address=own, **{"hsa": HSA, "gap": 1, "t_tr": T_TR, **given})
        mine = slave_config(self.made_up()).params
        self.there({"name": "m", "address": mine.address} | _octets(mine), baud=baud)
        master = Master(params, [mine, *slaves], MasterSettings(watchdog_ms=watchdog_ms))
        other = OtherMaster(add_station(self.world, params, master), master)
        self.masters.append(other)
        return other

    def surrounded(self, least: int = 1, most: int = 4, share: float = 0.35) -> None:
        """Neighbours, and the traffic of another master in a share of the seeds."""
        self.neighbours(least, most)
        if self.rng.random() < share:
            self.other_master()

    def until_taken(self) -> None:
        """Let time pass until the other master exchanges data with the slave asked about."""
        for _ in range(200):
            self.run(10)
            if self.masters[-1].exchanges_with(self.at):
                return
        raise AssertionError("the other master does not get the slave")

    def run(self, ms: float) -> None:
        """Let time pass before the user's master comes."""
        self.world.run_for(round(ms * MS))

    def later(self, ms: float, call: Callable[[], None]) -> None:
        self.world.call_at(self.world.now + round(ms * MS), call)

    # --- the user's bus -------------------------------------------------------------------------------------------

    def open(self) -> dpstack.Bus:
        return dpstack.open_bus(
            world=self.world, baud=self.baud, address=self.address, slaves=self.tables, **self.bus_keys
        )

    def config(self) -> str:
        """The configuration as a TOML file, for commands."""
        return plant_text(*self.tables, baud=self.baud, address=self.address, **self.bus_keys)

    # --- facts ----------------------------------------------------------------------------------------------------

    def sent(self, unit: Unit) -> list[WireEntry]:
        """The transmissions of ``unit`` in the wire log."""
        label = f"slave {unit.address}"
        return [entry for entry in self.world.log if entry.sender == label]

    def sent_by_master(self, address: int) -> list[WireEntry]:
        """The transmissions of the stations in the ring with that address."""
        return [entry for entry in self.world.log if entry.sender == str(address)]

    def asked_for(self, address: int) -> int:
        """How many requests of any master to ``address`` the wire log has."""
        found = 0
        for entry in self.world.log:
            octets = entry.octets
            at = 4 if octets[0] == 0x68 else 1
            if octets[0] in (0x10, 0x68) and len(octets) > at + 2:
                found += octets[at] & 0x7F == address and bool(octets[at + 2] & 0x40)
        return found


def _octets(params: SlaveParams) -> Table:
    return {"ident": params.ident, "config": params.config.hex(" "), "user_prm": params.user_prm.hex(" ")}


@contextlib.asynccontextmanager
async def bring(plant: Plant) -> AsyncIterator[dpstack.Bus]:
    """The user's bus after ``plant.seconds``: ordered to Operate as soon as it is in the ring, its drive runs.

    A bus that is not in the ring then is still waiting for it. One that failed is closed; ``plant.failure`` has the
    reason. Ask about ``plant.name``.
    """
    bus = plant.open()

    async def program() -> None:
        try:
            await bus.open()
        except DpError as error:
            plant.failure = error
            return
        await bus.operate()
        for order in plant.orders:
            await order(bus)
        if plant.driven:
            drive = bus.drive(plant.driven)
            drive.speed = 0.3
            with contextlib.suppress(DpError):  # on a bad line it may not start in time
                await drive.slave.ready()
                await drive.start()

    opening = asyncio.create_task(program())
    try:
        await asyncio.sleep(plant.seconds)
        yield bus
    finally:
        opening.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await opening
        await bus.close()
