"""Simulated slaves behind a real port, and the segment that ports can be joined by."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from types import TracebackType
from typing import Final

from dpstack.api.compose import device_of
from dpstack.api.config import Config
from dpstack.dp.slave_events import SlaveAppEvent, SlaveAppStateChanged
from dpstack.dp.slaveapp import SlaveApp, SlaveAppState
from dpstack.drivers.aio import AsyncioRuntime, patience_of
from dpstack.drivers.segment import Segment, default_directory
from dpstack.errors import BusError, ConfigError
from dpstack.fdl.multidrop import Multidrop
from dpstack.fdl.passive import PassiveStation
from dpstack.params import BusParams
from dpstack.ports import open_port
from dpstack.trace import Event
from dpstack.units import ns_to_s

__all__ = [
    "DEFAULT_BAUD",
    "Segment",
    "SimulatedSlave",
    "Simulation",
    "SlaveAppState",
    "default_directory",
    "sim_event_json",
]

#: where neither the arguments nor the configuration name a rate
DEFAULT_BAUD: Final = 500_000


class SimulatedSlave:
    """One slave of a simulation: what it is and what it does."""

    def __init__(self, name: str, address: int, kind: str, app: SlaveApp) -> None:
        self.name = name
        self.address = address
        self.kind = kind
        self._app = app

    @property
    def state(self) -> SlaveAppState:
        """Wait_Prm, Wait_Cfg or Data_Exch."""
        return self._app.state

    @property
    def exchanges(self) -> int:
        """Data exchanges since the start."""
        return self._app.stats.exchanges

    @property
    def watchdogs(self) -> int:
        """How often its watchdog ended data exchange."""
        return self._app.stats.watchdogs


class Simulation:
    """All slaves of ``config`` as stations behind one ``port``; ``async with`` opens and closes it.

    ``port``: as everywhere, or "pty" for a new one, whose path is then ``port_name``.
    Raises ConfigError; PortError on entering.
    """

    def __init__(self, config: Config, port: str, baud: int) -> None:
        if not config.slaves:
            raise ConfigError("no slave to simulate: add a [[slave]] table, or give --drive and --address")
        if port == "virtual":
            raise ConfigError('port "virtual" has no other end; take "pty" or a device')
        self.baud = baud
        #: called for every event, at once
        self.on_event: Callable[[Event], None] | None = None
        opened = open_port(port, baud)
        patience = patience_of(opened)
        params = BusParams.preset(baud)
        stations = []
        slaves = []
        for slave in config.slaves:
            app = SlaveApp(device_of(slave), address=slave.address)
            stations.append(PassiveStation(slave.address, app, params, patience=patience))
            kind = slave.profile.name if slave.profile else "mirror"
            slaves.append(SimulatedSlave(slave.name, slave.address, kind, app))
        self.slaves = tuple(slaves)
        self._failure: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        machine = Multidrop(stations, params, patience=patience)
        self.runtime = AsyncioRuntime(opened, machine, self._on_events, on_failure=self._failed)
        #: machine time of the start in ns
        self.started_ns = 0

    @property
    def port_name(self) -> str:
        """What the port is called; of a pty made here the path to open."""
        return self.runtime.port_name

    @property
    def seconds(self) -> float:
        """Since the start."""
        return ns_to_s(self.runtime.now() - self.started_ns)

    async def failed(self, seconds: float | None = None) -> None:
        """Wait for ``seconds`` (None: for ever). Raises BusError when the simulation fails meanwhile."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await asyncio.shield(self._failure)

    async def __aenter__(self) -> Simulation:
        self.started_ns = self.runtime.now()
        await self.runtime.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.runtime.close()

    def _on_events(self, events: list[Event]) -> None:
        if self.on_event is not None:
            for event in events:
                self.on_event(event)

    def _failed(self, error: Exception) -> None:
        failure = BusError(f"the simulation was stopped by a defect in dpstack ({type(error).__name__}: {error})")
        failure.__cause__ = error
        if not self._failure.done():
            self._failure.set_exception(failure)


def sim_event_json(event: Event, t: float) -> dict[str, object]:
    """The JSON line of a simulation's ``event`` at ``t`` seconds."""
    line: dict[str, object] = {"event": "notice", "t": round(t, 6)}
    if isinstance(event, SlaveAppEvent):
        line |= {"address": event.address, "name": event.name}
    if isinstance(event, SlaveAppStateChanged):
        return line | {"event": "slave", "state": event.state.value, "master": event.master, "why": event.why.value}
    return line | {"text": event.text}
