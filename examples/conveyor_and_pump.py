"""A state machine over two drives: a conveyor that may run only while its pump runs, with a panel, faults, acknowledge.

Start it with ``python examples/conveyor_and_pump.py`` on a simulated bus, where a simulated operator works at the
panel, or with ``python examples/conveyor_and_pump.py /dev/ttyUSB0`` on a real one.
"""

import asyncio
import contextlib
import sys
from collections.abc import Callable
from dataclasses import replace
from enum import Enum

import dpstack
from dpstack import Bool, at
from dpstack.events import DriveEvent, Event, SlaveFaulted
from dpstack.profile import DriveDevice

BAUD = 500_000
SLAVES: list[dict[str, object]] = [
    {"name": "conveyor", "address": 4, "drive": "fuji-frenic", "telegram": "PPO3"},
    {"name": "pump", "address": 5, "drive": "fuji-frenic", "telegram": "PPO3"},
    {"name": "panel", "address": 8, "ident": 0x1234, "config": "20 10", "inputs": {"buttons": "u8@0"}},
]


class Panel(dpstack.Inputs):
    """Buttons, and the level switch of the pump's tank. Both stop conditions are wired so that a broken wire stops."""

    start: Bool = at(0, 0)
    not_stopped: Bool = at(0, 1)
    acknowledge: Bool = at(0, 2)
    water: Bool = at(0, 3)


class Lamps(dpstack.Outputs):
    running: Bool = at(0, 0)
    fault: Bool = at(0, 1)


class State(Enum):
    IDLE = "idle"
    RUNNING = "running"
    FAULT = "fault"


class Plant:
    """One transition at a time: ``follow`` reads events of the bus and pictures of the panel from one queue."""

    def __init__(self, bus: dpstack.Bus) -> None:
        self.bus = bus
        self.conveyor, self.pump = bus.drive("conveyor"), bus.drive("pump")
        self.panel = bus.slave("panel")
        self.state = State.IDLE
        self.entered = asyncio.Event()
        self.queue: asyncio.Queue[Event | Panel] = asyncio.Queue()

    async def read_events(self) -> None:
        async for event in self.bus.events():
            self.queue.put_nowait(event)

    async def read_panel(self) -> None:
        async for _ in self.panel.changes("buttons"):
            self.queue.put_nowait(self.panel.inputs_as(Panel))

    async def follow(self) -> None:
        while True:
            happened = await self.queue.get()
            match self.state, happened:
                case State.FAULT, Panel(acknowledge=True):
                    await self.acknowledge()
                case State.FAULT, _:
                    pass  # whatever else happens: acknowledge comes first
                case _, SlaveFaulted(name=name, fault=fault):
                    await self.fail(f"{name}: {fault.message}")
                case _, DriveEvent(name=name, payload={"type": "status", "faults": [str(fault), *_]}):
                    await self.fail(f"{name}: {fault}")
                case State.IDLE, Panel(start=True, not_stopped=True, water=True):
                    await self.start()
                case State.IDLE, Panel(start=True):
                    print("not started: the tank is empty, or the stop button is pressed")
                case State.RUNNING, Panel(not_stopped=False) | Panel(water=False) as panel:
                    await self.stop("the tank is empty" if panel.not_stopped else "stop button")

    async def start(self) -> None:
        """The pump first; the conveyor once the pump has reached its speed."""
        try:
            for drive, speed in ((self.pump, 0.2), (self.conveyor, 0.1)):
                drive.speed = speed
                await drive.start()
                await drive.reached()
        except dpstack.DpError as error:  # of the drive, or the slave has left data exchange
            await self.fail(str(error))
        else:
            self.enter(State.RUNNING, "pump and conveyor turn")

    async def stop(self, reason: str) -> None:
        """The conveyor first; the pump once the conveyor stands."""
        try:
            await self.conveyor.stop()
            await self.pump.stop()
        except dpstack.DpError as error:
            await self.fail(str(error))
        else:
            self.enter(State.IDLE, reason)

    async def fail(self, reason: str) -> None:
        """Whatever has failed, stop what can still be stopped."""
        self.enter(State.FAULT, reason)
        ends = await asyncio.gather(self.conveyor.quick_stop(5), self.pump.stop(5), return_exceptions=True)
        for drive, end in zip((self.conveyor, self.pump), ends, strict=True):
            print(f"  {drive.name} {'stopped' if end is None else 'did not stop by order'}")

    async def acknowledge(self) -> None:
        try:
            for drive in (self.conveyor, self.pump):
                await drive.slave.ready(timeout=1)
                if drive.status.fault:
                    await drive.acknowledge()
        except (dpstack.DpError, TimeoutError) as error:
            print(f"not acknowledged: {error}")
        else:
            self.enter(State.IDLE, "acknowledged")

    def enter(self, state: State, reason: str) -> None:
        self.state = state
        self.entered.set()
        print(f"{state.value}: {reason}")
        with contextlib.suppress(dpstack.DpError):  # a panel that is off has no lamps
            lamps = self.panel.outputs_as(Lamps)
            self.panel.send(replace(lamps, running=state is State.RUNNING, fault=state is State.FAULT))


async def run(plant: Plant) -> None:
    """Ends when it is cancelled, or with the bus."""
    await plant.bus.operate()
    await plant.bus.ready(20)
    async with asyncio.TaskGroup() as group:
        for work in (plant.read_events(), plant.read_panel(), plant.follow()):
            group.create_task(work)


class Operator:
    """Works at the simulated panel, and waits for what the plant does."""

    def __init__(self, plant: Plant, set_inputs: Callable[[bytes], object]) -> None:
        self.plant = plant
        self.set_inputs = set_inputs

    async def press(self, buttons: int, then: State | None = None) -> None:
        self.set_inputs(bytes((buttons,)))
        await asyncio.sleep(0.1)
        self.set_inputs(bytes((buttons & 0b1010,)))  # start and acknowledge are released
        await self.wait(then)

    async def wait(self, state: State | None) -> None:
        await asyncio.sleep(0.1)
        while state not in (None, self.plant.state):
            self.plant.entered.clear()
            await self.plant.entered.wait()


async def simulated_shift() -> None:
    """No water, an empty tank, a conveyor that trips, a pump that loses its power."""
    world = dpstack.World()
    bench = dpstack.simulate(world, SLAVES, baud=BAUD)
    conveyor = bench.device(4)
    assert isinstance(conveyor, DriveDevice)
    async with dpstack.open_bus(world=world, baud=BAUD, slaves=SLAVES) as bus:
        plant = Plant(bus)
        operator = Operator(plant, bench.units[8].set_inputs)
        running = asyncio.create_task(run(plant))
        await bus.wait_state(dpstack.Mode.OPERATE)
        await bus.ready()
        await operator.press(0b0011)  # start without water
        await operator.press(0b1011, State.RUNNING)
        await operator.press(0b0010, State.IDLE)  # the tank is empty
        await operator.press(0b1011, State.RUNNING)
        conveyor.trip("OC1")
        await operator.wait(State.FAULT)
        await operator.press(0b1110, State.IDLE)  # acknowledge
        await operator.press(0b1011, State.RUNNING)
        bench.power(5, False)
        await operator.wait(State.FAULT)
        await operator.press(0b1110)  # too early
        await asyncio.sleep(7)
        bench.power(5, True)
        await bus.ready(20)
        await operator.press(0b1110, State.IDLE)
        running.cancel()
        await asyncio.wait([running])


async def real_plant(port: str) -> None:
    async with dpstack.open_bus(port=port, baud=BAUD, slaves=SLAVES) as bus:
        await run(Plant(bus))


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C: the bus has ended in order
        port = sys.argv[1] if len(sys.argv) > 1 else "virtual"
        asyncio.run(simulated_shift() if port == "virtual" else real_plant(port))
