"""A slice of the long run in virtual time: ten PPO1 drives at 500 kbit/s for so many telegrams, judged on the wire.

Slice ``number`` has a seed of its own and no faults on its bus. Real drive plugins run at the master and simulated
drives at the other end; a program sets speeds, reads and writes parameters, asks for services of class 2, reads records
and acknowledges the faults of drives, while readers follow events, the live stream, cycles and statuses.
"""

from __future__ import annotations

import asyncio
import gc
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from random import Random
from typing import Any, Final

from soak.leftovers import Memory, belongings, memory, stack_objects
from soak.readers import StreamReaders
from soak.wire import Grid, WireCount

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.slave_side.virtual_bench import VirtualBench
from dpstack.dp.master.events import DriveEvent
from dpstack.profile import DriveDevice
from dpstack.sim.world import World
from dpstack.units import NS_PER_MS

BAUD: Final = 500_000
MASTER: Final = 2
#: telegrams of the whole run and of one slice
WHOLE: Final = 100_000_000
SLICE: Final = 1_000_000
SLICES: Final = WHOLE // SLICE
#: the fixed cycle in ms of every fourth slice each; 0: free running. 12 ms is tight for ten PPO1 drives at 500 kbit/s,
#: 20 ms has room for every service between two rounds
CYCLES_MS: Final = (12, 14, 20, 0)
#: memory is compared from this part of a slice on: readers, histories and histograms are filled
_WARM: Final = 0.3
#: events, statuses and notices that readers keep
_FILL: Final = 1000
_DRIVES: Final = ("demag-dedrive", "fuji-frenic", "ls-s100")
_FIRST: Final = 3
_COUNT: Final = 10
#: parameters that a program reads, one that it writes with two values, and a fault
_READS: Final[dict[str, tuple[int | str, ...]]] = {
    "demag-dedrive": (249, 270, 400, 880),
    "fuji-frenic": ("F07", "o30", "W90", 918),
    "ls-s100": (918, "dr-03", "COM-06", "0x000E"),
}
_WRITES: Final[dict[str, tuple[int | str, tuple[float, float], dict[str, Any]]]] = {
    "demag-dedrive": (480, (12.5, -20.0), {"data_set": 3}),
    "fuji-frenic": ("F07", (1.0, 1.5), {}),
    "ls-s100": ("dr-03", (1.0, 1.5), {}),
}
#: the Demag obeys the bus only with 412 = 1
_OPTIONS: Final[dict[str, dict[str, object]]] = {"demag-dedrive": {"set_412": True}}
_FAULTS: Final = {"demag-dedrive": "F0500", "fuji-frenic": "OC1", "ls-s100": "LV"}


def tables(number: int) -> list[dict[str, object]]:
    """The [[slave]] tables of slice ``number``: the three kinds of drives in another order in each."""
    return [
        {
            "name": f"d{address}",
            "address": address,
            "drive": _DRIVES[(number + address) % 3],
            "telegram": "PPO1",
            "options": _OPTIONS.get(_DRIVES[(number + address) % 3], {}),
        }
        for address in range(_FIRST, _FIRST + _COUNT)
    ]


@dataclass
class Mark:
    """The counters of both sides at one moment between two rounds."""

    rounds: int
    begun: int
    missed: int
    rotations: int


class Slice(StreamReaders):
    """Slice ``number`` until ``wanted`` transmissions are :attr:`done`; :func:`run_slice` runs it."""

    def __init__(self, number: int, wanted: int) -> None:
        super().__init__()
        self.number = number
        self.random = Random(number)
        self.cycle_ms = CYCLES_MS[number % len(CYCLES_MS)]
        self.wanted = wanted
        self.world = World(seed=number)
        self.wire = WireCount(MASTER)
        self.world.log.listener = self.wire
        self.acts: Counter[str] = Counter()
        self.statuses = 0
        self.cycles = 0
        self.faults: list[str] = []
        self.memory: list[Memory] = []
        self.result: dict[str, Any] = {}
        self.bench: VirtualBench

    # --- readers ----------------------------------------------------------------------------------------------------

    async def _read_statuses(self, drive: dpstack.Drive) -> None:
        async for _ in drive.statuses():
            self.statuses += 1

    async def _read_cycles(self) -> None:
        """The inputs of every round are those of its answers on the wire."""
        async for cycle in self.bus.cycles():
            self.cycles += 1
            seen = self.wire.inputs
            for slave in self.bus.slaves:
                if cycle.inputs.get(slave.name) != seen.get(slave.address):
                    self.faults.append(f"round {cycle.number}: inputs of slave {slave.address} are not the wire's")

    # --- acts of a program ------------------------------------------------------------------------------------------

    async def _act(self) -> None:
        bus, random = self.bus, self.random
        drive = random.choice(bus.drives)
        acts: list[tuple[int, Callable[[dpstack.Drive], Awaitable[None]]]] = [
            (30, self._set_speed),
            (30, self._read_parameter),
            (10, self._write_parameter),
            (10, self._class_2),
            (6, self._history),
            (4, self._stop_and_start),
            (2, self._trip),
            (2, self._why),
            (1, self._scan),
        ]
        chosen = random.choices([act for _, act in acts], [weight for weight, _ in acts])[0]
        self.acts[chosen.__name__.strip("_")] += 1
        await chosen(drive)

    async def _set_speed(self, drive: dpstack.Drive) -> None:
        drive.speed = self.random.choice((-1.0, -0.5, 0.1, 0.25, 0.5, 0.75, 1.0))

    async def _read_parameter(self, drive: dpstack.Drive) -> None:
        await drive.read(self.random.choice(_READS[drive.kind]), timeout=30)

    async def _write_parameter(self, drive: dpstack.Drive) -> None:
        parameter, values, more = _WRITES[drive.kind]
        value = self.random.choice(values)
        # the Demag's data sets are in RAM too: its EEPROM wears out
        await drive.write(parameter, value, ram=bool(more), timeout=30, **more)
        if await drive.read(parameter, timeout=30, **more) != value:
            self.faults.append(f"{drive.name}: parameter {parameter} is not {value} after its write")

    async def _class_2(self, drive: dpstack.Drive) -> None:
        class2 = self.bus.class2
        service = self.random.choice((class2.diagnosis, class2.config, class2.inputs, class2.outputs))
        await service(drive.address, timeout=30)

    async def _history(self, drive: dpstack.Drive) -> None:
        history = await core_of(self.bus).view.history(drive.address)
        if history.bring_ups and len(history.bring_ups) != 1:
            self.faults.append(f"{drive.name}: {len(history.bring_ups)} bring-ups on a bus without faults")

    async def _stop_and_start(self, drive: dpstack.Drive) -> None:
        await drive.stop()
        await drive.start(30)

    async def _trip(self, drive: dpstack.Drive) -> None:
        device = self.bench.device(drive.address)
        assert isinstance(device, DriveDevice)
        device.trip(_FAULTS[drive.kind])
        await self.bus.until(lambda: drive.status.fault is not None, 30)
        await drive.acknowledge(60)
        await drive.start(30)

    async def _why(self, drive: dpstack.Drive) -> None:
        await self.bus.why(drive.address)

    async def _scan(self, drive: dpstack.Drive) -> None:
        found = await self.bus.scan()
        if {f.address for f in found} != {drive.address for drive in self.bus.drives}:
            self.faults.append(f"the live list has {[f.address for f in found]}")

    # --- the course -------------------------------------------------------------------------------------------------

    def _fill(self) -> None:
        """Fill all that keeps the last events with the usual ones, the statuses of drives: no growth later."""
        drives, now = self.bus.drives, core_of(self.bus).runtime.now()
        for number in range(_FILL):
            drive = drives[number % len(drives)]
            payload: dict[str, object] = {"type": "status", "state": f"filling {number}", "settings": "none"}
            payload |= dict.fromkeys(("running", "reached", "remote"), False)
            payload |= dict.fromkeys(("setpoint", "speed", "frequency_hz", "current", "torque"), number / 3)
            payload |= {name: [] for name in ("warnings", "faults", "words", "bits", "settings_texts")}
            core_of(self.bus).publish(DriveEvent(t_ns=now, address=drive.address, name=drive.name, payload=payload))

    async def _mark(self) -> Mark:
        """The counters right after a round, when no Data_Exchange is under way."""
        async for _ in self.bus.cycles():
            break
        book = core_of(self.bus).view.counters().cycles
        return Mark(self.wire.rounds, book.begun, book.missed, core_of(self.bus).view.rotations)

    async def run(self) -> None:
        """Bring the bus up, let the program act, end the bus, and compare both accounts."""
        before = belongings()
        slaves = tables(self.number)
        self.bench = dpstack.simulate(self.world, slaves, baud=BAUD)
        cycle: dict[str, Any] = {"cycle_ms": self.cycle_ms} if self.cycle_ms else {}
        bus = self.bus = dpstack.open_bus(world=self.world, baud=BAUD, address=MASTER, slaves=slaves, **cycle)
        async with bus:
            readers = [asyncio.create_task(r()) for r in (self.read_events, self.read_live, self._read_cycles)]
            readers += [asyncio.create_task(self._read_statuses(drive)) for drive in bus.drives[:3]]
            await bus.operate()
            await bus.ready()
            self._fill()
            for drive in bus.drives:
                await drive.start(30)
                drive.speed = 0.5
            begin = await self._mark()
            if self.cycle_ms:
                self.wire.grid = Grid(self.cycle_ms * NS_PER_MS)
            await self.work()
            end = await self._mark()
            grid, self.wire.grid = self.wire.grid, None
        # readers end with the bus
        async with asyncio.timeout(60):
            await asyncio.gather(*readers)
        self._compare(begin, end, grid)
        assert self.world.referee is not None
        self.world.referee.check()
        await asyncio.sleep(60)  # a timer that was forgotten would show as a task or as an event
        self.result["leftovers"] = belongings().more_than(before)

    @property
    def done(self) -> int:
        """The part of the number wanted that is done."""
        return self.wire.telegrams

    async def work(self) -> None:
        """Let the program act until the slice is done."""
        await self.work_until(int(self.wanted * _WARM))
        self.memory.append(memory())
        await self.work_until(self.wanted)
        self.memory.append(memory())

    async def work_until(self, done: int) -> None:
        """Let the program act until so much is done."""
        while self.done < done:
            await asyncio.sleep(self.random.choice((0.02, 0.1, 0.3, 1.0)))
            await self._act()

    def _compare(self, begin: Mark, end: Mark, grid: Grid | None) -> None:
        """Our counters against the wire's; every difference is a fault."""
        bus, wire = self.bus, self.wire
        counters = core_of(bus).view.counters()
        link = counters.link
        drives = {slave.address for slave in bus.slaves}
        scans = self.acts["scan"]  # each asks every drive once, and the other addresses 0 to 126 with a repetition
        ours: dict[str, int] = {
            "sent": link.sent,
            "heard": link.heard,
            "tokens": link.tokens,
            "exchanges": sum(slave.exchanges for slave in bus.slaves),
            "rounds": end.begun - begin.begun if self.cycle_ms else end.rotations - begin.rotations,
            "missed": end.missed - begin.missed,
            "polls": link.gap_polls + scans * (len(drives) + 2 * (126 - len(drives))),
            "broadcasts": link.station(127).requests,
            "tokens lost": link.tokens_lost + link.token_retries + link.withdrawn,
            "unreadable": link.stray + link.late + link.garbled + link.refused + link.ignored + counters.decoder.bad,
        }
        theirs = {
            "sent": wire.sent,
            "heard": wire.telegrams - wire.sent,
            "tokens": wire.tokens - 1,  # the two of a claim are one
            "exchanges": wire.answered.total(),
            "rounds": end.rounds - begin.rounds,
            "missed": grid.late + grid.left_out if grid is not None else 0,
            "polls": wire.polls,
            "broadcasts": wire.broadcasts,
            "tokens lost": 0,
            "unreadable": wire.bad,
        }
        self.result |= {"ours": dict(ours), "wire": dict(theirs)}
        for slave in bus.slaves:
            address = slave.address
            counted, unit = link.station(address), self.bench.units[address]
            ours |= {
                f"{address} exchanges": slave.exchanges,
                f"{address} served": unit.app.stats.exchanges,
                f"{address} answers": counted.answers,
                f"{address} requests": counted.requests,
                f"{address} lost": counted.retries + counted.timeouts + counted.late + counted.wrong,
                f"{address} unsent": unit.station.stats.dropped + unit.app.stats.watchdogs + unit.app.stats.failures,
            }
            theirs |= {
                f"{address} exchanges": wire.answered[address],
                f"{address} served": wire.asked[address],
                f"{address} answers": wire.answered[address] + wire.replies[address] + scans,
                f"{address} requests": wire.asked[address] + wire.services[address] + scans,
                f"{address} lost": 0,
                f"{address} unsent": 0,
            }
        both = [(key, ours[key], theirs[key]) for key in ours]
        self.faults += [f"{key}: {mine} of ours, {seen} on the wire" for key, mine, seen in both if mine != seen]
        self.result |= {
            "telegrams": wire.telegrams,
            "octets": wire.octets,
            "services": wire.services.total(),
            "bus_s": round(self.world.now / 1e9, 3),
            "cycle_ms": self.cycle_ms,
            "grid": None if grid is None else grid.as_dict(),
            "acts": dict(self.acts),
            "events": self.events.total(),
            "live_items": self.items,
            "cycles_read": self.cycles,
            "statuses": self.statuses,
        }


def run_slice(number: int, telegrams: int = SLICE) -> dict[str, Any]:
    """Run slice ``number`` and return its line of the results file. ``faults``: every difference that was found.

    ``objects_left``: objects of the stack that were not there before; what is loaded or kept once counts in the first
    slice of a process.
    """
    objects = stack_objects()
    cpu, began = time.process_time(), time.time()
    piece = Slice(number, telegrams)
    dpstack.run_virtual(piece.run())
    result, faults = piece.result, piece.faults
    warm, end = piece.memory
    del piece
    gc.collect()
    left = stack_objects() - objects
    return {
        "slice": number,
        **result,
        "cpu_s": round(time.process_time() - cpu, 1),
        "began": int(began),
        "rss_warm": warm.rss,
        "rss_end": end.rss,
        "objects_warm": warm.objects,
        "objects_end": end.objects,
        "objects_left": dict(left.most_common(20)),
        "faults": faults,
    }
