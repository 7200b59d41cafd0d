"""``bus.cycles()``: consistent inputs of all slaves, once a round of data exchange. A slow reader gets the latest."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TypeVar

from dpstack.api.bus.parts import BusBase
from dpstack.api.slave.typed import Inputs, typed
from dpstack.api.streams import Stream
from dpstack.dp.master.fixed_cycle import CycleData
from dpstack.dp.process_data import FieldMap, NamedValues, Value
from dpstack.dp.process_image import inputs_are_valid
from dpstack.errors import NoInputs, UsageError
from dpstack.units import NS_PER_MS, NS_PER_S, ns_to_s

In = TypeVar("In", bound=Inputs)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cycle:
    """A round of data exchange. Made by the bus, see ``Bus.cycles``.

    ``number`` counts the due times of fixed cycles (also of cycles left out), free running the rounds. ``fresh`` names
    the slaves that answered in this round, :attr:`stale` the others. ``inputs`` leaves out a slave if the round is
    older than its ``Slave.inputs_limit`` when the reader gets it, and all slaves while the bus does not run.
    ``skipped``: rounds that this reader missed since its last one. ``missed``: deadline misses since the start of the
    bus.
    """

    #: number of the due time of a fixed cycle (cycles left out count, too); free running the number of the round
    number: int
    #: time of the machine at the first bit of the round, in ns
    t_ns: int
    #: delay behind the due time in ns; 0 free running
    late_ns: int
    #: octets of every slave in data exchange by name, all of the end of this round
    inputs: Mapping[str, bytes]
    #: the slaves that answered in this round; :attr:`stale` has the others
    fresh: frozenset[str]
    missed: int
    skipped: int = 0
    _fields: Mapping[str, FieldMap] = field(default_factory=dict, repr=False, compare=False)
    #: the wall clock in ns at a time of the machine
    _wall: Callable[[int], int] = field(default=lambda t_ns: t_ns, repr=False, compare=False)
    #: addresses of all slaves of the bus by name
    _slaves: Mapping[str, int] = field(default_factory=dict, repr=False, compare=False)
    _now: Callable[[], int] = field(default=lambda: 0, repr=False, compare=False)

    @property
    def time(self) -> datetime:
        """The wall clock (UTC) at its first bit."""
        return datetime.fromtimestamp(self._wall(self.t_ns) / NS_PER_S, UTC)

    @property
    def late_ms(self) -> float:
        """:attr:`late_ns` in ms"""
        return self.late_ns / NS_PER_MS

    @property
    def age(self) -> float:
        """Time since its first bit up to now in seconds."""
        return ns_to_s(max(0, self._now() - self.t_ns))

    @property
    def stale(self) -> frozenset[str]:
        """The slaves whose inputs are of an earlier round: no turn in this one (``every``), or no answer."""
        return frozenset(self.inputs) - self.fresh

    def get(self, name: str) -> dict[str, Value] | None:
        """The named inputs of one slave; None while it is not in data exchange.

        Raises UsageError for a name that no slave of the bus has.
        """
        octets = self.inputs.get(name)
        if octets is not None:
            return NamedValues(self._fields[name].values(octets))
        if name not in self._slaves:
            known = ", ".join(self._slaves) or "none"
            raise UsageError(f"no slave {name!r} on this bus; there are: {known}")
        return None

    def values(self, name: str) -> dict[str, Value]:
        """As :meth:`get`; raises NoInputs instead of returning None."""
        found = self.get(name)
        if found is None:
            address = self._slaves[name]
            text = f"slave {address} ({name}) has no inputs in cycle {self.number}: it is not in data exchange"
            raise NoInputs(address, f"{text}; cycle.get({name!r}) gives None then")
        return found

    def inputs_as(self, name: str, kind: type[In]) -> In:
        """The inputs of one slave as an object of ``kind``, a class of :class:`dpstack.Inputs`.

        Raises NoInputs while it is not in data exchange (see ``name in cycle``), UsageError for a name that no slave
        of the bus has, and if the class does not fit the configuration.
        """
        self.values(name)
        return typed(Inputs, kind).taken(self.inputs[name], self._fields[name], f"slave {self._slaves[name]} ({name})")

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
            reader.over = True
            reader.newest.end()

    async def read(self) -> AsyncIterator[Cycle]:
        """Each new cycle; a slow reader gets the latest."""
        if self._over:
            return
        reader = _Reader(self._bus)
        self._readers.append(reader)
        try:
            with self._bus.rounds.watched(reader.on_round):
                async for data in reader.newest:
                    if reader.over:  # the bus has ended: an older cycle is worthless
                        break
                    yield reader.cycle(data)
        finally:
            self._readers.remove(reader)


class _Reader:
    def __init__(self, bus: BusBase) -> None:
        self._bus = bus
        self.newest: Stream[CycleData] = Stream(1)
        self.over = False
        last = bus.view.cycle
        self._last = 0 if last is None else last.published
        self._before: int | None = None  # count of published rounds at the last read

    def on_round(self) -> None:
        data = self._bus.view.cycle
        if data is None or data.published == self._last:
            return  # no slave had its turn in this round
        if self._before is None:
            self._before = data.published - 1
        self._last = data.published
        self.newest.put(data)

    def cycle(self, data: CycleData) -> Cycle:
        assert self._before is not None
        skipped = data.published - self._before - 1
        self._before = data.published
        slaves = {slave.address: slave for slave in self._bus.slaves}
        now = self._bus.runtime.now
        age_ns = max(0, now() - data.t_ns)
        alive = self._bus.runtime.not_running is None
        here = [
            slave
            for address in data.inputs
            if (slave := slaves.get(address)) is not None
            and inputs_are_valid(exchanging=alive, age_ns=age_ns, limit_ns=slave.inputs_limit_ns)
        ]
        return Cycle(
            number=data.number,
            t_ns=data.t_ns,
            late_ns=data.late_ns,
            inputs={slave.name: data.inputs[slave.address] for slave in here},
            fresh=frozenset(slave.name for slave in here if slave.address in data.fresh),
            missed=data.missed,
            skipped=skipped,
            _slaves={slave.name: slave.address for slave in slaves.values()},
            _fields={slave.name: slave.config.input_fields for slave in here},
            _now=now,
            _wall=self._bus.wall_ns,
        )
