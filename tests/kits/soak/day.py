"""A day of virtual time: two drives that start, stop, lose the bus or their power, trip, and get other maps.

A program drives them by the public API; the faults are those of the testing kit. The device ends are read beside the
bus: outputs and motor of a drive that is cut off, the maps and values that it really has.
"""

from __future__ import annotations

import asyncio
import gc
from collections import Counter
from collections.abc import Awaitable, Callable
from random import Random
from typing import Final

from soak.leftovers import Memory, belongings, memory

import dpstack
from dpstack.profile import DriveDevice
from dpstack.sim.world import World
from dpstack.testing import Fault, Faults
from dpstack.units import NS_PER_MS, ns_to_s

MASTER: Final = 2
#: at this rate and cycle a day takes some 13 minutes of a core
BAUD: Final = 19_200
CYCLE_MS: Final = 250
WATCHDOG_MS: Final = 2_000
#: by so much late answers are late
LATE_MS: Final = 3_000
DAY_S: Final = 86_400
#: memory is compared from this part of the run on
_WARM: Final = 0.3

PUMP: Final[dict[str, object]] = {
    "name": "pump",
    "address": 4,
    "drive": "ls-s100",
    "telegram": "PPO2",
    "options": {"check_settings": False},
}
MIXER: Final[dict[str, object]] = {
    "name": "mixer",
    "address": 5,
    "drive": "imo-hd2",
    "options": {"check_settings": False, "baud_index": 1, "set_map": True},
    "simulated": {"baud_index": 1, "on_loss": "stop"},
}
#: the maps that a program writes, of inputs and of outputs with their values, and what the drive then has
MAPS: Final[dict[str, tuple[tuple[str, str, str], ...]]] = {
    "pump": (
        ("1103 1104", "dr-03=1.5", "1103"),
        ("1104 1103 000E", "", "0000"),
        ("1104", "dr-03=1.5 dr-04=2", "1103 1104"),
    ),
    "mixer": (
        ("frequency current torque fault_code", "set_frequency", "set_frequency"),
        ("frequency rpm - power", "set_frequency braking_torque_limit=120", "set_frequency braking_torque_limit"),
        ("frequency - torque", "set_frequency", "set_frequency"),
    ),
}
#: a fault of each drive, by its name there
_TRIPS: Final = {"pump": "overload", "mixer": "OC1"}
#: the motor stands so long after a stop, a fault or a loss at the latest
_STANDS_S: Final = 10.0
#: time-out of orders: the maps of the pump are read parameter by parameter, some cycles each
_PATIENT_S: Final = 120.0


class Day:
    """``seconds`` of virtual time with the random numbers of ``seed``. ``longest_s``: the longest stay at a speed and
    in a loss. ``wrong``: everything that is not as it must be; ``acts``: number of each thing that was done."""

    def __init__(self, seed: int, seconds: float, longest_s: float) -> None:
        self.seconds = seconds
        self.longest_s = longest_s
        self.random = Random(seed)
        self.world = World(seed=seed)
        self.acts: Counter[str] = Counter()
        self.events: Counter[str] = Counter()
        self.wrong: list[str] = []
        #: begin and end in ns of times in which octets that nobody asked for collide with telegrams: a master cannot
        #: keep an idle time after octets that it did not hear because it was sending itself
        self.colliding: list[tuple[int, int]] = []
        self.memory: list[Memory] = []
        self.cycles = 0
        self.bus: dpstack.Bus
        self.faults: Faults

    @property
    def now_s(self) -> float:
        return ns_to_s(self.world.now)

    # --- what is looked at ------------------------------------------------------------------------------------------

    def device(self, drive: dpstack.Drive) -> DriveDevice:
        device = self.bench.units[drive.address].drive
        assert device is not None
        device.advance(self.world.now)
        return device

    def check(self, what: str, is_so: bool) -> None:
        if not is_so:
            self.wrong.append(f"{self.now_s:.3f} s: {what}")

    def outputs(self, drive: dpstack.Drive) -> bytes:
        return self.bench.units[drive.address].app.outputs

    async def _stands(self, drive: dpstack.Drive, why: str) -> None:
        """Its motor gets no power any more, after the ramp or the loss that its settings allow."""
        for _ in range(int(_STANDS_S / 0.1)):
            if not self.device(drive).motor.on:
                return
            await asyncio.sleep(0.1)
        self.check(f"{drive.name}: its motor is driven {_STANDS_S:g} s after {why}", False)

    # --- acts -------------------------------------------------------------------------------------------------------

    async def _run(self, drive: dpstack.Drive) -> None:
        """Start, run at some speeds, stop."""
        await drive.start(_PATIENT_S)
        for _ in range(self.random.randint(1, 3)):
            drive.speed = speed = self.random.choice((0.2, 0.5, 0.8, 1.0))
            await drive.reached(_PATIENT_S)
            await asyncio.sleep(self.random.uniform(1, self.longest_s))
            self.check(f"{drive.name}: turns at {drive.status.speed}", abs((drive.status.speed or 0) - speed) < 0.05)
        await drive.stop(_PATIENT_S)
        await self._stands(drive, "its stop")

    async def _map(self, drive: dpstack.Drive) -> None:
        """Other maps, at standstill; the drive has them, and values of the outputs where they belong."""
        inputs, outputs, bare = self.random.choice(MAPS[drive.name])
        await drive.order("write_map", timeout=_PATIENT_S, inputs=inputs, outputs=outputs)
        found = await drive.order("read_map", timeout=_PATIENT_S)
        self.check(f"{drive.name}: its maps are {found}", found == {"inputs": inputs, "outputs": bare})
        await asyncio.sleep(1)
        for parameter, value in {"dr-03": 1.5, "dr-04": 2.0}.items():
            if f"{parameter}=" in outputs:
                there = self.device(drive).store.value(parameter)
                self.check(f"{drive.name}: {parameter} is {there}", there == value)

    async def _lose(self, drive: dpstack.Drive) -> None:
        """A loss of the drive, or of the whole bus, while it runs: it is safe in time, and comes back at rest."""
        await drive.start(_PATIENT_S)
        drive.speed = 0.5
        await asyncio.sleep(self.random.uniform(1, self.longest_s / 6))
        begin: list[Callable[[], Fault]] = [
            lambda: self.faults.silence(drive.name),
            lambda: self.faults.power_off(drive.name),
            lambda: self.faults.late_answers(drive.name, LATE_MS),
            lambda: self.faults.rs(drive.name),
            lambda: self.faults.silence_master(),
        ]
        number = self.random.randrange(len(begin))
        since = self.world.now
        with begin[number]() as fault:
            self.acts[fault.text] += 1
            await asyncio.sleep(WATCHDOG_MS / 1000 + 1)
            self.check(f"{drive.name}: has outputs after {fault.text}", not any(self.outputs(drive)))
            await asyncio.sleep(self.random.uniform(0, self.longest_s))
        if "late" in fault.text:
            self.colliding.append((since, self.world.now + 2 * LATE_MS * NS_PER_MS))
        await self._back(drive)

    async def _short(self, drive: dpstack.Drive) -> None:
        """Shorter than the watchdog, and noise: nothing of it may be left behind."""
        if self.random.random() < 0.5:
            with self.faults.silence(drive.name):
                await asyncio.sleep(self.random.uniform(0.1, WATCHDOG_MS / 2000))
        else:
            self.faults.line_noise(10 ** -self.random.uniform(3, 5))
            await asyncio.sleep(self.random.uniform(1, self.longest_s / 2))
            self.faults.line_noise(0)
        await self._back(drive)

    async def _trip(self, drive: dpstack.Drive) -> None:
        await drive.start(_PATIENT_S)
        self.faults.trip(drive.name, _TRIPS[drive.name])
        await self.bus.until(lambda: drive.status.fault is not None, 30)
        await self._stands(drive, "a fault")
        await drive.acknowledge(_PATIENT_S)

    async def _back(self, drive: dpstack.Drive) -> None:
        """All are in data exchange again, without a fault, and at rest until they are started."""
        await self._exchanging()
        for each in self.bus.drives:
            await each.settled(_PATIENT_S)
            if each.status.fault is not None:
                await each.acknowledge(_PATIENT_S)
        await drive.stop(_PATIENT_S)
        await self._stands(drive, "its return")

    async def _exchanging(self) -> None:
        """Wait until the slaves stay in data exchange: an answer that was late by seconds may still damage another."""
        slaves = self.bus.slaves
        while True:
            for slave in slaves:
                await slave.wait_state(dpstack.SlaveState.DATA_EXCHANGE, timeout=_PATIENT_S)
            await asyncio.sleep(2 * LATE_MS / 1000)
            if all(slave.state is dpstack.SlaveState.DATA_EXCHANGE for slave in slaves):
                return

    # --- the course -------------------------------------------------------------------------------------------------

    async def _act(self) -> None:
        drive = self.random.choice(self.bus.drives)
        acts: dict[Callable[[dpstack.Drive], Awaitable[None]], int] = {
            self._run: 5,
            self._map: 2,
            self._lose: 3,
            self._short: 2,
            self._trip: 1,
        }
        act = self.random.choices(list(acts), list(acts.values()))[0]
        self.acts[act.__name__.strip("_")] += 1
        await act(drive)

    async def _until(self, part: float) -> None:
        while self.now_s < self.seconds * part:
            await self._act()

    async def _read_cycles(self) -> None:
        async for _ in self.bus.cycles():
            self.cycles += 1

    async def run(self) -> None:
        before = belongings()
        slaves = [{**one, "watchdog_ms": WATCHDOG_MS} for one in (PUMP, MIXER)]
        self.bench = dpstack.simulate(self.world, slaves, baud=BAUD)
        self.bus = dpstack.open_bus(
            world=self.world,
            baud=BAUD,
            address=MASTER,
            slaves=slaves,
            cycle_ms=CYCLE_MS,
            on_event=lambda event: self.events.update([type(event).__name__]),
        )
        self.faults = Faults(self.bench, self.world, MASTER)
        async with self.bus as bus:
            reader = asyncio.create_task(self._read_cycles())
            await bus.operate()
            await bus.ready(_PATIENT_S)
            await self._until(_WARM)
            self.memory.append(memory())
            await self._until(1)
            self.memory.append(memory())
            for drive in bus.drives:
                await drive.stop(_PATIENT_S)
        await reader
        for drive in bus.drives:
            await self._stands(drive, "the end of the bus")
        await asyncio.sleep(60)  # a timer that was forgotten would show as a task or as an event
        assert self.world.referee is not None
        for broken in self.world.referee.violations:
            if not any(begin <= broken.t_ns <= end for begin, end in self.colliding):
                self.wrong.append(str(broken))
        self.wrong += belongings().more_than(before)


def run_day(seed: int, seconds: float = DAY_S, longest_s: float = 60) -> Day:
    """Run ``seconds`` of a day, see :class:`Day`."""
    day = Day(seed, seconds, longest_s)
    dpstack.run_virtual(day.run())
    gc.collect()
    return day
