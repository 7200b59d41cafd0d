"""Simulated slaves behind a real port (``dpstack sim``)."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final, Literal

from dpstack.api.config.config import AUTO, ECHO, Config, port_of, rate_findings
from dpstack.api.slave_side.virtual_bench import Bench, rates_of, set_rate
from dpstack.api.slave_side.virtual_bench import SimulatedSlave as SimulatedSlave
from dpstack.api.slave_side.virtual_bench import sim_event_json as sim_event_json
from dpstack.api.streams import OnEvent, WallClock, call_on_event
from dpstack.dp.pdu import layouts
from dpstack.dp.slave.auto_baud import BaudState, PortBaudChanged, SearchingPort
from dpstack.drivers.line.asyncio_runtime import AsyncioRuntime
from dpstack.drivers.line.port_latency import patience_of
from dpstack.drivers.line.rate import settle_ns_of
from dpstack.drivers.segment.hub import Segment as Segment
from dpstack.errors import BusError, ConfigError
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.params import MAX_STATION, UNADDRESSED, BusParams
from dpstack.phy.neighbours import t_sl_of_answers
from dpstack.trace import Event
from dpstack.units import BAUD_RATES, NEVER, ns_to_s

#: the rate in bit/s if neither the arguments nor the configuration give one
DEFAULT_BAUD: Final = 500_000


class Simulation(Bench):
    """All slaves of ``config`` as stations behind one ``port``. A context manager (``async with``).

    ``port``: as for a master, or "pty" for a new one, whose path is then ``port_name``. ``baud`` in bit/s, or "auto":
    the slaves detect the rate, and search again when the bus falls silent. Raises ConfigError; PortError on entering.
    """

    def __init__(self, config: Config, port: str, baud: int | Literal["auto"]) -> None:
        if not (config.slaves or config.ppi):
            raise ConfigError("no slave to simulate: add a [[slave]] table, or give --drive and --address")
        if port == "virtual":
            raise ConfigError('port "virtual" has no other end; take "pty" or a device')
        self.config = config
        #: callback for every event
        self.on_event: OnEvent | None = None
        if baud != AUTO and any(set_rate(slave) not in (None, baud) for slave in config.slaves):
            # the stations of a port share its receiver, so all have the same rate
            raise ConfigError("; ".join(rate_findings(config, baud)))
        rates = [DEFAULT_BAUD] if baud != AUTO else _common_rates(config)
        # every adapter supports the slowest rate: if the port does not open at it, it does not exist
        start = baud if baud != AUTO else DEFAULT_BAUD if port == "pty" else min(rates)
        opened = port_of(config, start, port)
        patience = patience_of(opened)
        self._params = params = BusParams.preset(start)
        #: T_SL in bit times that a master needs for these slaves behind this port; 0: any T_SL is long enough
        self.t_sl = t_sl_of_answers(params, patience)
        self.slaves = tuple(SimulatedSlave(slave, params, patience) for slave in config.slaves)
        for slave in self.slaves:
            if slave.address == UNADDRESSED and not slave.device.set_slave_add:
                raise ConfigError(
                    f"slave {slave.name} has no Set_Slave_Add: nobody could give it another address than "
                    f"{UNADDRESSED} over the bus; give it one of 0..{MAX_STATION}"
                )
        if config.ppi:
            from dpstack.api.slave_side.simulated_cpu import SimulatedPlantCpu  # here, as most plants have none

            self.cpus = {one.address: SimulatedPlantCpu(one, params, patience, at_once=True) for one in config.ppi}
        self._failure: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        layouts.load()
        stations = [slave.station for slave in self.slaves] + [cpu.station for cpu in self.cpus.values()]
        self._line = Multidrop(stations, params, patience=patience)
        for slave in self.slaves:
            slave.faults.connect(partial(self._send_at, slave))
        self._search: SearchingPort | None = None
        self._was_found = False
        if baud == AUTO:
            self._search = SearchingPort(
                self._line,
                self._any_watchdog_runs,
                rates=rates,
                slack_ns=patience.known_ns,
                settle_ns=settle_ns_of(opened),
                lost=self._rate_lost,
            )
        machine = self._search or self._line
        self.runtime = AsyncioRuntime(
            opened, machine, self._on_events, echo=ECHO[config.bus.echo], on_failure=self._failed
        )
        self._clock = WallClock(self.runtime.now, lambda: False)
        #: machine time of the start in ns
        self.started_ns = 0
        self._is_over = False

    @property
    def port_name(self) -> str:
        """The name of the port; of a pty made here the path to open."""
        return self.runtime.port_name

    @property
    def baud(self) -> int | None:
        """The rate in bit/s; None during the search."""
        searching = self._search is not None and self._search.state is BaudState.SEARCH
        return None if searching else self._line.baud

    @property
    def never_found(self) -> str | None:
        """For people the reason why the search has not found the rate yet; None without a search, or after it."""
        if self._search is None or self._was_found:
            return None
        result = self._search.in_vain(self.runtime.now())
        return None if result is None else result.text

    @property
    def seconds(self) -> float:
        return ns_to_s(self.runtime.now() - self.started_ns)

    @property
    def telegrams(self) -> int:
        """Number of telegrams received, to any station."""
        return self._line.decoder_stats.telegrams

    @property
    def bad(self) -> dict[str, int]:
        """Damaged telegrams and stray octets received, by cause, as in BusStats."""
        damage = {f"uart_{cause}": count for cause, count in self.runtime.damage().items() if count}
        return self._line.decoder_stats.by_cause() | damage

    # --- faults from outside ----------------------------------------------------------------------------------------

    def status(self) -> dict[str, object]:
        slaves: dict[str, object] = {}
        for slave in self.slaves:
            address = str(slave.address)
            entry = {"name": slave.name, "kind": slave.kind, **slave.as_dict()}
            if not slave.powered:
                entry["state"] = "off"
            # of two slaves that have come to have one address the second one is shown with its name
            place = f"{address} ({slave.name})" if address in slaves else address
            slaves[place] = entry | self.status_of(slave.config.address)
        for cpu in self.cpus.values():
            injected = self.injected(cpu.address)
            slaves[str(cpu.address)] = cpu.as_dict() | ({"injected": injected} if injected else {})
        status: dict[str, object] = {"seconds": round(self.seconds, 3), "baud": self.baud}
        status |= {"telegrams": self.telegrams, "bad": self.bad}
        if self._search is not None:
            status["search"] = self._search.state.value
        return status | {"slaves": slaves}

    @property
    def units(self) -> Mapping[int, SimulatedSlave]:
        return {slave.config.address: slave for slave in self.slaves}

    @property
    def now(self) -> int:
        return self.runtime.now()

    def call_at(self, at_ns: int, callback: Callable[[], None]) -> None:
        asyncio.get_running_loop().call_later(max(0.0, ns_to_s(at_ns - self.now)), self._call, callback)

    def _send_at(self, slave: SimulatedSlave, octets: bytes, at_ns: int) -> None:
        self._line.send_at(slave.station, octets, at_ns)

    def _call(self, callback: Callable[[], None]) -> None:
        if not self._is_over:
            callback()

    def _silence(self, address: int, for_ns: int | None) -> None:
        self._line.silence(self.units[address].station, NEVER if for_ns is None else self.runtime.now() + for_ns)

    def _resume(self, address: int) -> None:
        self._line.resume(self.units[address].station)

    def _silent_ns(self, address: int) -> int | None:
        slave = self.units[address]
        until = self._line.silent_until(slave.station) if slave.powered else None
        return None if until is None else until - self.runtime.now()

    def _switch(self, address: int, on: bool) -> None:
        slave = self.units[address]
        if on:
            slave.renew(self._line.params)
            self._line.add(slave.station)
        else:
            self._line.remove(slave.station)

    def publish(self, event: Event) -> None:
        call_on_event(self.on_event, self._clock.stamped(event))

    async def failed(self, seconds: float | None = None) -> None:
        """Wait for ``seconds`` (None: for ever). Raises BusError if the simulation fails in this time."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await asyncio.shield(self._failure)

    async def __aenter__(self) -> Simulation:
        self.started_ns = self.runtime.now()
        await self.runtime.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        self._is_over = True
        await self.runtime.close()

    def _on_events(self, events: list[Event]) -> None:
        self._was_found = self._was_found or any(isinstance(event, PortBaudChanged) for event in events)
        for event in events:
            self.publish(event)

    def _any_watchdog_runs(self) -> bool:
        """Whether the watchdog of any slave runs."""
        return any(slave.app.watchdog.time_ns and slave.powered for slave in self.slaves)

    def _rate_lost(self, now: int) -> None:
        for slave in self.slaves:
            slave.app.rate_lost(now)

    def _failed(self, error: Exception) -> None:
        failure = BusError(f"the simulation was stopped by a defect in dpstack ({type(error).__name__}: {error})")
        failure.__cause__ = error
        if not self._failure.done():
            self._failure.set_exception(failure)


def _common_rates(config: Config) -> Sequence[int]:
    """The rates that all slaves support: they share one receiver. Raises ConfigError."""
    rates = [rate for rate in BAUD_RATES if all(rate in rates_of(slave) for slave in config.slaves)]
    if not rates:
        raise ConfigError("the slaves have no baud rate in common: simulate them on ports of their own")
    return rates
