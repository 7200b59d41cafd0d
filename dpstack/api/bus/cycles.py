"""``bus.cycles()``: consistent inputs of all slaves, once a round of data exchange. A slow reader gets the latest."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Collection, Iterator, Mapping
from datetime import UTC, datetime
from typing import TYPE_CHECKING, TypeVar

from dpstack.api.bus.parts import BusBase
from dpstack.api.config.slave import SlaveConfig
from dpstack.dp.field_map import FieldMap, NamedValues
from dpstack.dp.master.fixed_cycle import CycleData
from dpstack.dp.process_image import Value, inputs_are_valid, least_limit_ns
from dpstack.errors import NoInputs, UsageError
from dpstack.units import NS_PER_MS, NS_PER_S, ns_to_s

if TYPE_CHECKING:
    from dpstack.api.slave.typed import Inputs

In = TypeVar("In", bound="Inputs")


class _Names:
    """The names of the slaves of a bus, and of their inputs, as their configurations ``configs`` have them."""

    def __init__(self, configs: list[SlaveConfig]) -> None:
        self.configs = configs
        #: names by address
        self.by_address = {config.address: config.name for config in configs}
        #: addresses by name, in the order of the addresses
        self.addresses = {self.by_address[address]: address for address in sorted(self.by_address)}
        self.fields: dict[str, FieldMap] = {config.name: config.input_fields for config in configs}


class Cycle:
    """A round of data exchange. Made by the bus, see ``Bus.cycles``.

    ``number`` counts the due times of fixed cycles (also of cycles left out), free running the rounds. ``fresh`` names
    the slaves that answered in this round, :attr:`stale` the others. ``inputs`` leaves out a slave if the round is
    older than its ``Slave.inputs_limit`` when the reader gets it, and all slaves while the bus does not run.
    ``skipped``: rounds that this reader missed since its last one. ``missed``: deadline misses since the start of the
    bus.
    """

    __slots__ = ("_bus", "_data", "_inputs", "_left_out", "_names", "skipped")

    def __init__(
        self, data: CycleData, bus: BusBase, names: _Names, *, left_out: Collection[int], skipped: int
    ) -> None:
        self._data = data
        self._bus = bus
        self._names = names
        self._left_out = left_out
        self._inputs: dict[str, bytes] | None = None
        #: rounds that this reader missed since its last one
        self.skipped: int = skipped

    @property
    def number(self) -> int:
        """Number of the due time of a fixed cycle (cycles left out count, too); free running the number of the round"""
        return self._data.number

    @property
    def t_ns(self) -> int:
        """Time of the machine at the first bit of the round, in ns"""
        return self._data.t_ns

    @property
    def late_ns(self) -> int:
        """Delay behind the due time in ns; 0 free running"""
        return self._data.late_ns

    @property
    def missed(self) -> int:
        """Deadline misses since the start of the bus"""
        return self._data.missed

    def __repr__(self) -> str:
        return f"<Cycle {self.number} at {self.t_ns} ns: {', '.join(self.inputs) or 'no inputs'}>"

    @property
    def inputs(self) -> Mapping[str, bytes]:
        """Octets of every slave in data exchange by name, all of the end of this round."""
        if self._inputs is None:
            names, left_out = self._names.by_address, self._left_out
            self._inputs = {
                names[address]: octets
                for address, octets in self._data.inputs.items()
                if address in names and address not in left_out
            }
        return self._inputs

    @property
    def fresh(self) -> frozenset[str]:
        """The slaves that answered in this round; :attr:`stale` has the others."""
        fresh, addresses = self._data.fresh, self._names.addresses
        return frozenset(name for name in self.inputs if addresses[name] in fresh)

    @property
    def time(self) -> datetime:
        """The wall clock (UTC) at its first bit."""
        return datetime.fromtimestamp(self._bus.wall_ns(self.t_ns) / NS_PER_S, UTC)

    @property
    def late_ms(self) -> float:
        """:attr:`late_ns` in ms"""
        return self.late_ns / NS_PER_MS

    @property
    def age(self) -> float:
        """Time since its first bit up to now in seconds."""
        return ns_to_s(max(0, self._bus.runtime.now() - self.t_ns))

    @property
    def stale(self) -> frozenset[str]:
        """The slaves whose inputs are of an earlier round: no turn in this one (``every``), or no answer."""
        return frozenset(self.inputs) - self.fresh

    def get(self, name: str) -> dict[str, Value] | None:
        """The named inputs of one slave; None while it is not in data exchange.

        Raises UsageError for a name that no slave of the bus has.
        """
        address = self._names.addresses.get(name)
        if address is None:
            known = ", ".join(self._names.addresses) or "none"
            raise UsageError(f"no slave {name!r} on this bus; there are: {known}")
        octets = self._data.inputs.get(address)
        if octets is None or address in self._left_out:
            return None
        return NamedValues(self._names.fields[name].values(octets))

    def values(self, name: str) -> dict[str, Value]:
        """As :meth:`get`; raises NoInputs instead of returning None."""
        found = self.get(name)
        if found is None:
            address = self._names.addresses[name]
            text = f"slave {address} ({name}) has no inputs in cycle {self.number}: it is not in data exchange"
            raise NoInputs(address, f"{text}; cycle.get({name!r}) gives None then")
        return found

    def inputs_as(self, name: str, kind: type[In]) -> In:
        """The inputs of one slave as an object of ``kind``, a class of :class:`dpstack.Inputs`.

        Raises NoInputs while it is not in data exchange (see ``name in cycle``), UsageError for a name that no slave
        of the bus has, and if the class does not fit the configuration.
        """
        from dpstack.api.slave.typed import Inputs, typed  # here: a program with such a class has loaded it

        self.values(name)
        names = self._names
        who = f"slave {names.addresses[name]} ({name})"
        return typed(Inputs, kind).taken(self.inputs[name], names.fields[name], who)

    def __contains__(self, name: object) -> bool:
        """Whether the slave is in data exchange, with valid inputs."""
        return name in self.inputs

    def __iter__(self) -> Iterator[str]:
        """The names of the slaves in data exchange."""
        return iter(self.inputs)

    def __getitem__(self, name: str) -> dict[str, Value]:
        return self.values(name)


class Cycles:
    """All readers of the cycles of one bus."""

    def __init__(self, bus: BusBase) -> None:
        self._bus = bus
        self._readers: list[_Reader] = []
        self._over = False

    def end(self) -> None:
        self._over = True
        for reader in self._readers:
            reader.end()

    async def read(self) -> AsyncIterator[Cycle]:
        """Each new cycle; a slow reader gets the latest."""
        if self._over:
            return
        reader = _Reader(self._bus)
        self._readers.append(reader)
        try:
            with self._bus.rounds.watched(reader.on_round):
                while not reader.over:  # once the bus has ended an older cycle is worthless
                    data, reader.newest = reader.newest, None
                    if data is None:
                        await reader.more()
                    else:
                        yield reader.cycle(data)
        finally:
            self._readers.remove(reader)


class _Reader:
    def __init__(self, bus: BusBase) -> None:
        self._bus = bus
        self._view, self._runtime = bus.view, bus.runtime
        self.newest: CycleData | None = None
        self.over = False
        self._waiting: asyncio.Future[None] | None = None
        last = bus.view.cycle
        self._last = 0 if last is None else last.published
        self._before: int | None = None  # count of published rounds at the last read
        self._names = _Names([])

    def on_round(self) -> None:
        data = self._view.cycle
        if data is None or data.published == self._last:
            return  # no slave had its turn in this round
        if self._before is None:
            self._before = data.published - 1
        self._last = data.published
        self.newest = data
        self._wake()

    def more(self) -> asyncio.Future[None]:
        """Done with the next cycle, or with the end of the bus."""
        self._waiting = asyncio.get_running_loop().create_future()
        return self._waiting

    def end(self) -> None:
        self.over = True
        self._wake()

    def _wake(self) -> None:
        waiting, self._waiting = self._waiting, None
        if waiting is not None and not waiting.done():  # else its task was cancelled
            waiting.set_result(None)

    def cycle(self, data: CycleData) -> Cycle:
        assert self._before is not None
        skipped = data.published - self._before - 1
        self._before = data.published
        bus, runtime = self._bus, self._runtime
        slaves = bus.by_address
        configs = [slave.config for slave in slaves.values()]
        if configs != self._names.configs:
            self._names = _Names(configs)
        left_out: Collection[int] = ()
        age_ns = runtime.now() - data.t_ns
        alive = runtime.not_running is None
        if not alive or age_ns > least_limit_ns(bus.round_ns):
            limits = {address: slaves[address].inputs_limit_ns for address in data.inputs if address in slaves}
            left_out = [
                address
                for address, limit_ns in limits.items()
                if not inputs_are_valid(exchanging=alive, age_ns=age_ns, limit_ns=limit_ns)
            ]
        return Cycle(data, bus, self._names, left_out=left_out, skipped=skipped)
