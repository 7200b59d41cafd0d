"""The command ``rounds`` of a running master: values of each round for the oscilloscope of a page.

The first request for some values begins to follow the rounds, into a bounded ring; each further one takes what has come
since the round that it names. Without requests nothing is followed: a round costs nothing then.
"""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final

from dpstack.api.bus.parts import BusBase
from dpstack.api.control import arguments
from dpstack.api.slave.slave import sent_outputs
from dpstack.errors import BusError, UsageError
from dpstack.plant.items import SlaveValues
from dpstack.plant.judge import DATA_EXCHANGE
from dpstack.plant.quality import Quality
from dpstack.units import NS_PER_S, ns_to_s

MOST_VALUES: Final = 8
#: rounds in the ring of some values, and rounds in one answer: 8 values of them fit into one message to a page
KEPT: Final = 4096
_MOST_IN_ANSWER: Final = 1000
#: sets of values that are followed at the same time; of further ones the one asked for longest ago ends
MOST_SETS: Final = 8
#: without a request for so long a set of values is followed no more
_FORGOTTEN_NS: Final = 5 * NS_PER_S
_QUANTITIES: Final = ("speed", "setpoint", "frequency_hz", "current", "torque")
#: a slave whose inputs came in this round
_FRESH: Final = SlaveValues(state=DATA_EXCHANGE, inputs_valid=True, inputs_age_ms=0.0)
_SHOWN: Final = (Quality.GOOD, Quality.UNCERTAIN)

#: a value; None while it is bad or stale, or the slave is not there
Value = float | int | bool | None
#: reads a value: the inputs of the slave in this round
_Read = Callable[[bytes], object]


class RoundTraces:
    """The traces of ``bus`` for all clients of its control socket."""

    def __init__(self, bus: BusBase) -> None:
        self._bus = bus
        self._rings: dict[tuple[str, ...], _Ring] = {}

    def read(self, args: Sequence[str]) -> dict[str, Any]:
        """``args``: the number of the last round that the client has (0: none), then the values: ``SLAVE.NAME``, or
        ``SLAVE:QUANTITY`` of a drive.

        Returns ``rounds``: rows of number, t in s since the start, and the values; ``lost``: rounds after the last
        one of the client that are missing; ``more``: further rounds wait. Raises UsageError, BusError.
        """
        bus = self._bus
        if bus.view.read_only:
            raise BusError("a read-only bus reads no process data: there are no values of rounds")
        after = arguments.whole_number(args[0], "the number of the last round, 0 without one")
        values = tuple(args[1:])
        if len(values) > MOST_VALUES:
            raise UsageError(f"{len(values)} values; at most {MOST_VALUES} are followed at a time")
        ring = self._rings.pop(values, None)
        if ring is None or ring.is_over:
            ring = _Ring(bus, values)
        self._rings[values] = ring  # the last one asked for stands at the end
        for other in [key for key, one in self._rings.items() if one.is_over][:]:
            del self._rings[other]
        while len(self._rings) > MOST_SETS:
            self._rings.pop(next(iter(self._rings))).end()
        return ring.take(after)


class _Ring:
    """The last rounds of some values."""

    def __init__(self, bus: BusBase, values: Sequence[str]) -> None:
        """Raises UsageError for a value that does not exist."""
        self._bus = bus
        self._reads = [self._reader(one) for one in values]
        self._rounds: deque[tuple[int, float, tuple[Value, ...]]] = deque(maxlen=KEPT)
        cycle = bus.view.cycle
        self._published = 0 if cycle is None else cycle.published
        self._asked_ns = bus.runtime.now()
        self._watching = contextlib.ExitStack()
        self._watching.enter_context(bus.rounds.watched(self._on_round))
        self.is_over = False

    def end(self) -> None:
        self.is_over = True
        self._watching.close()

    def take(self, after: int) -> dict[str, Any]:
        self._asked_ns = self._bus.runtime.now()
        last = self._rounds[-1][0] if self._rounds else 0
        if after > last:  # of another run, or of a ring that has ended
            after = 0
        found = [one for one in self._rounds if one[0] > after]
        rows = found[:_MOST_IN_ANSWER]
        lost = rows[-1][0] - after - len(rows) if rows and after else 0
        return {
            "rounds": [[number, t, *values] for number, t, values in rows],
            "lost": lost,
            "more": len(found) > len(rows),
        }

    def _on_round(self) -> None:
        bus = self._bus
        if bus.runtime.now() - self._asked_ns > _FORGOTTEN_NS:
            self.end()
            return
        data = bus.view.cycle
        if data is None or data.published == self._published:
            return  # no slave had its turn in this round
        self._published = data.published
        values = tuple(
            None if (octets := data.inputs.get(address)) is None else _plain(read(octets))
            for address, read in self._reads
        )
        self._rounds.append((data.published, round(ns_to_s(data.t_ns - bus.started_ns), 6), values))

    def _reader(self, text: str) -> tuple[int, _Read]:
        """The address of the slave of a value, and how it is read."""
        bus = self._bus
        names = {slave.address: slave.name for slave in bus.slaves}
        where, point, name = text.rpartition(".")
        if not point:
            return self._quantity(text, names)
        slave = bus.slave(arguments.address_of(where, names))
        inputs, view, judge = slave.config.input_fields, bus.view, slave.process_quality
        is_input = name in inputs
        field = inputs.fields[name] if is_input else slave.output_field(name)
        if field.type == "bytes":
            raise UsageError(f"{text}: octets are no trace; name a number or a bit")

        def read(octets: bytes) -> object:
            if not is_input:
                octets = sent_outputs(slave.setup, view.image(slave.setup).outputs, view.mode, exchanging=True)
            if not octets:
                return None
            # the quality of a slave that reports nothing is quick to know, and this is done in each round
            if (judge.standing or field.speaks_for_itself) and (
                judge.of_field(field, octets, judge.of_all(_FRESH, math.inf), judge.places()).quality not in _SHOWN
            ):
                return None
            return field.get(octets)

        return slave.address, read

    def _quantity(self, text: str, names: dict[int, str]) -> tuple[int, _Read]:
        where, _, name = text.rpartition(":")
        if name not in _QUANTITIES:
            raise UsageError(f"{text!r} is no value; write 8.level, or 3:speed (one of {', '.join(_QUANTITIES)})")
        drive = self._bus.drive(arguments.address_of(where, names))
        judge = drive.slave.process_quality

        def read(_octets: bytes) -> object:
            if judge.standing and judge.of_all(_FRESH, math.inf).quality not in _SHOWN:
                return None
            return getattr(drive.status, name)

        return drive.address, read


def _plain(value: object) -> Value:
    """A number as JSON has it."""
    if not isinstance(value, (bool, int, float)) or not math.isfinite(value):
        return None
    return value
