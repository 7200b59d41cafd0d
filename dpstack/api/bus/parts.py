"""The parts of a bus, which are there once its baud rate is known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.api.bus.compose import Parts
from dpstack.api.bus.find_baud import need_wire, rate_of
from dpstack.api.bus.plan_checks import refuse_misfit
from dpstack.api.bus.streams import Rounds
from dpstack.api.config.config import AUTO, Config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.server.virtual_bench import VirtualBench
from dpstack.dp.master.commands import Mode
from dpstack.dp.plan.plan import Case, Plan
from dpstack.dp.plan.rotation_time import figures
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.runtime import Runtime
from dpstack.drivers.views import MasterSeen, StationSeen, WatcherSeen
from dpstack.errors import UsageError
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.units import ns_to_s

SEARCHING: Final = "searching for the baud rate"


class Composed:
    """Made by ``make`` of a ``config``: at once, or once the rate is found where it is "auto".

    Until then every part raises UsageError. ``world``: the simulated bus to find it on, if any. Raises ConfigError
    where nothing can be found.
    """

    def __init__(self, config: Config, make: Callable[[Config], Parts], world: World | None) -> None:
        self.config = config
        self._given_world = world
        self._make = make
        self._parts: Parts | None = None
        self._round_ns: int | None = None  # None: to be counted again
        if self.searching and world is None:
            need_wire(config.port)

    def _build(self, config: Config) -> None:
        """Make the parts, now that the rate is in ``config``. Raises ConfigError."""
        self._parts = self._make(config)
        self.config = config

    async def _find_rate(self) -> str | None:
        """Listen for the rate where it is to be found, then make the parts; what it was recognised by, for people.

        Raises BusError, ConfigError, PortError.
        """
        if not self.searching:
            return None
        report = await rate_of(self.config, self._given_world)
        self._build(self.config.with_bus(baud=report.baud))
        return report.text

    @property
    def searching(self) -> bool:
        """The baud rate is to be found and not known yet."""
        return self._parts is None and self.config.bus.baud == AUTO

    @property
    def parts(self) -> Parts:
        """All of them."""
        if self._parts is None:
            raise UsageError(f"{SEARCHING}: what depends on it is known once the bus is entered (async with)")
        return self._parts

    @property
    def plan(self) -> Plan:
        """Rotation times, watchdogs, findings."""
        return self.parts.plan

    @property
    def params(self) -> BusParams:
        """The bus parameters."""
        return self.parts.plan.params

    def fitting(self, slave: SlaveConfig) -> SlaveParams:
        """``slave`` for the master, beside all others. Raises ConfigError where the cycle has no room for it."""
        setup = slave.setup(self.params.baud)
        others = [h.setup for address, h in self.master.handlers.items() if address != slave.address]
        refuse_misfit(self.config, self.plan, [*others, setup])
        self._round_ns = None
        return setup

    def poll_interval_ns(self, slave: SlaveParams) -> int:
        """The time from one Data_Exchange of ``slave`` to the next where nothing is repeated and no service is beside
        it, as the plan counts it with the slaves that are on the bus now."""
        if self._round_ns is None:
            counted = self.plan.figures
            setups = [handler.setup for handler in self.master.handlers.values()]
            if setups != list(counted.setups):
                counted = figures(
                    counted.params,
                    setups,
                    others=counted.others,
                    cycle_ns=counted.cycle_ns,
                    host_slack_ns=counted.host_slack_ns,
                )
            self._round_ns = counted.round_ns(Case.NORMAL)
        return self._round_ns * slave.every

    @property
    def rotation_limit_s(self) -> float:
        """The longest rotation of the plan in seconds."""
        return ns_to_s(self.rotation_limit_ns)

    @property
    def rotation_limit_ns(self) -> int:
        """The longest rotation of the plan in ns."""
        return self.plan.rotation_ns(Case.LONGEST)

    @property
    def mode(self) -> Mode:
        """The mode of the master; OFFLINE while nobody keeps it running."""
        return self.master.mode if self.runtime.not_running is None else Mode.OFFLINE

    @property
    def station(self) -> StationSeen:
        """The link layer."""
        return self.parts.station

    @property
    def master(self) -> MasterSeen:
        """The class 1 master."""
        return self.parts.master

    @property
    def driver(self) -> str:
        """What keeps it running: "asyncio", "process", or "virtual" on a simulated bus."""
        return self.parts.driver

    @property
    def runtime(self) -> Runtime:
        """What keeps it running."""
        return self.parts.runtime

    @property
    def rounds(self) -> Rounds:
        """The ends of the rounds with data exchange."""
        return self.parts.rounds

    @property
    def watcher(self) -> WatcherSeen | None:
        """Of a read-only bus: what shows the state of its stations."""
        return self.parts.watcher

    @property
    def world(self) -> World | None:
        """The simulated bus when there is one."""
        return self.parts.world

    @property
    def bench(self) -> VirtualBench | None:
        """The simulated slaves, where they are part of this bus."""
        return self.parts.bench
