"""Faults of the testing kit and of ``dpstack ctl`` in both worlds: a simulated bus, and slaves behind a port.

A place has one master in Operate and the same three slaves; its orders are those of the control server of a program.
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from api_kit import bench_of
from support import present

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.config.config import make_config
from dpstack.api.control.handlers import control_run
from dpstack.api.control.simulation_handlers import control_segment, control_sim
from dpstack.api.slave_side.simulation import Simulation
from dpstack.api.slave_side.virtual_bench import Bench
from dpstack.drivers.segment.hub import Segment
from dpstack.profile import DriveDevice
from dpstack.testing import Faults
from dpstack.trace import Event

BAUD: Final = 19_200
MASTER: Final = 2
WATCHDOG_MS: Final = 400
FAN: Final[Mapping[str, object]] = {
    "name": "fan",
    "address": 4,
    "drive": "fuji-frenic",
    "telegram": "PPO3",
    "options": {"check_settings": False},
}
TANK: Final[Mapping[str, object]] = {
    "name": "tank",
    "address": 8,
    "ident": 0x1234,
    "config": "11 20",
    "inputs": {"level": "u8@0"},
}
STATION: Final[Mapping[str, object]] = {
    "name": "io",
    "address": 9,
    "gsd": "io-station",
    "modules": ["8 DI", "2 AI", "8 DO"],
}
PLANT: Final = [{**slave, "watchdog_ms": WATCHDOG_MS} for slave in (FAN, TANK, STATION)]

#: a state stays for so long
_STAYS_S: Final = 0.2
#: what no command ends: an acknowledgement, the access that it was for
_BY_ITSELF: Final = ("trip", "parameter-error")

Order = Callable[[str], Awaitable[object]]


@dataclass
class Place:
    """A world with the plant in it. ``seconds``: how long a state may take to be reached."""

    bus: dpstack.Bus
    bench: Bench
    order: Order
    seconds: float
    faults: Faults | None = None  # the testing kit, in virtual time
    line: Order | None = None
    told: list[str] = field(default_factory=list)

    def differences(self, name: str, truth: Truth, injected: str) -> list[str]:
        """The deviations from the row at this moment."""
        unit = self.bench.units[self.bench.address_of(name)]
        device = unit.device
        if isinstance(device, DriveDevice):
            device.advance(self.bench.now)
        seen = {
            "outputs": (any(unit.app.outputs), truth.outputs),
            "device": (unit.app.state.value, truth.device),
            "master": (self.bus.slave(name).state.value, truth.master),
            "motor": (device.motor.on if isinstance(device, DriveDevice) else None, truth.motor),
        }
        wrong = [f"{key}: {is_} instead of {must}" for key, (is_, must) in seen.items() if is_ not in must]
        wrong += [f"no event: {text}" for text in truth.events if not any(text in told for told in self.told)]
        acts = self.injected(name)
        if injected and not any(text.startswith(injected) for text in acts):
            wrong.append(f"injected: {acts} instead of {injected}")
        return wrong

    def injected(self, name: str) -> list[str]:
        return self.bench.injected(self.bench.address_of(name))

    async def until(self, name: str, truth: Truth, injected: str) -> None:
        """Wait until everything is as ``truth`` says, and stays so for a while."""
        loop = asyncio.get_running_loop()
        limit, since = loop.time() + self.seconds, loop.time()
        while loop.time() < since + _STAYS_S:
            await asyncio.sleep(0.05)
            wrong = self.differences(name, truth, injected)
            if wrong:
                since = loop.time()
                assert since < limit, (*wrong, *self.told)

    async def until_over(self, name: str) -> None:
        """Wait until the slave is in data exchange and no fault of it acts but one that its master acknowledges."""
        loop = asyncio.get_running_loop()
        limit = loop.time() + self.seconds
        while True:
            left = [text for text in self.injected(name) if not text.startswith(_BY_ITSELF)]
            state = self.bus.slave(name).state
            if not left and state is dpstack.SlaveState.DATA_EXCHANGE:
                return
            assert loop.time() < limit, (left, state, *self.told)
            await asyncio.sleep(0.05)


def order_of(server: Any) -> Order:
    async def order(text: str) -> object:
        name, *args = text.split()
        result = server._handlers[name](args)
        return await result if inspect.isawaitable(result) else result

    return order


@contextlib.asynccontextmanager
async def virtual_place() -> AsyncIterator[Place]:
    told: list[str] = []

    def tell(event: Event) -> None:
        told.append(event.text)

    async with dpstack.open_bus(port="virtual", baud=BAUD, slaves=PLANT, on_event=tell) as bus:
        bench = bench_of(bus)
        report = present(bench.on_events)

        def report_all(events: list[Event]) -> None:
            report(events)
            for event in events:
                tell(event)

        bench.on_events = report_all
        world = present(core_of(bus).world)
        yield Place(bus, bench, order_of(control_run(bus, "virtual")), 20.0, Faults(bench, world, MASTER), told=told)


@contextlib.asynccontextmanager
async def port_place(directory: Path | None = None) -> AsyncIterator[Place]:
    """The slaves on a pty, or with ``directory`` on station 1 of a segment, whose station 0 is the master's."""
    told: list[str] = []

    def tell(event: Event) -> None:
        told.append(event.text)

    async with contextlib.AsyncExitStack() as stack:
        line: Order | None = None
        slaves_at, master_at = "pty", ""
        if directory is not None:
            hub = await stack.enter_async_context(Segment(2, directory, baud=BAUD))
            line = order_of(control_segment(hub, tell))
            master_at, slaves_at = hub.paths
        simulation = Simulation(make_config(slaves_at, BAUD, MASTER, PLANT, where="plant", bus={}), slaves_at, BAUD)
        simulation.on_event = tell
        await stack.enter_async_context(simulation)
        bus = dpstack.open_bus(
            port=master_at or simulation.port_name, baud=BAUD, address=MASTER, slaves=PLANT, on_event=tell
        )
        await stack.enter_async_context(bus)
        yield Place(bus, simulation, order_of(control_sim(simulation, slaves_at)), 20.0, line=line, told=told)


# --- the table -------------------------------------------------------------------------------------------------------

ON: Final = (True,)
OFF: Final = (False,)
#: it comes and goes, because the master brings the slave up again and again
BY_TURNS: Final = (True, False)
_EXCHANGE: Final = ("data_exchange",)
_ANY: Final = ("wait_prm", "wait_cfg", "data_exchange")
_BRING_UP: Final = ("offline", "diagnosis", "set_prm", "chk_cfg", "wait_ready", "fault")


@dataclass(frozen=True)
class Truth:
    """What must happen at a slave: ``outputs`` on at the device, the state of the ``device`` and of the ``master``,
    whether the ``motor`` is driven (None: it has none); ``events``: pieces of texts, each in one event at least.
    """

    outputs: tuple[bool, ...] = ON
    device: tuple[str, ...] = _EXCHANGE
    master: tuple[str, ...] = _EXCHANGE
    motor: tuple[bool | None, ...] = (None,)
    events: tuple[str, ...] = ()


@dataclass(frozen=True)
class Row:
    """A fault at ``slave``. ``begin``: commands of ``run`` on "virtual" and of ``sim``, in order; ``kit``: the call of
    the testing kit that does the same; ``line``: the command of ``segment``, where the slaves are behind a port.
    ``end``: commands of the same program that end it. ``injected``: the beginning of what ``status`` says meanwhile.
    """

    slave: str
    truth: Truth
    begin: tuple[str, ...] = ()
    end: tuple[str, ...] = ()
    kit: Callable[[Faults], object] | None = None
    line: str = ""
    injected: str = ""

    @property
    def name(self) -> str:
        return "; ".join((self.line, *self.begin)).strip("; ")


_LOST: Final = "slave 4 (fan): stopped answering during Data_Exchange"
_WATCHDOG: Final = "slave 4 (fan): nothing from master 2 for 400 ms, outputs cleared"
#: nothing passes any more: the watchdog of the slave makes it safe, and the master has lost it
CUT: Final = Truth(OFF, ("wait_prm",), ("offline",), OFF, (_LOST, _WATCHDOG))
NO_POWER: Final = replace(CUT, events=(_LOST,))
NORMAL: Final = Truth(motor=ON)
TRIPPED: Final = Truth(motor=OFF, events=("drive 4 (fan): fault",))
NO_INVERTER: Final = Truth(motor=OFF, events=("left the running state by itself: STW is 0000",))
REFUSED: Final = Truth(OFF, _ANY, _BRING_UP, OFF, ("slave 4 (fan): refuses Data_Exchange",))
EXCHANGING: Final = Truth()

ROWS: Final = (
    # cut off and without power; what comes later replaces what was before
    Row("fan", CUT, ("silence fan",), ("resume fan",), lambda f: f.silence("fan"), injected="silence"),
    Row("fan", CUT, ("fault fan silence",), ("normal fan",), lambda f: f.begin("fan", "silence"), injected="silence"),
    Row("fan", CUT, ("silence fan 1s", "silence fan"), ("resume fan",), injected="silence"),
    Row("fan", NORMAL, ("silence fan", "resume fan")),
    Row("fan", NO_POWER, ("power-off fan",), ("power-on fan",), lambda f: f.power_off("fan"), injected="power-off"),
    Row("fan", NO_POWER, ("fault fan power_off",), ("normal fan",), injected="power-off"),
    Row("fan", NO_POWER, ("silence fan", "power-off fan"), ("power-on fan",), injected="power-off"),
    Row("fan", NO_POWER, ("power-off fan", "silence fan", "resume fan"), ("power-on fan",), injected="power-off"),
    # on its stub
    Row(
        "fan",
        CUT,
        ("fault fan late_answers by_ms=300",),
        ("normal fan",),
        lambda f: f.late_answers("fan", 300),
        injected="late answers by 300 ms",
    ),
    Row(
        "fan",
        CUT,
        ("fault fan noise rate=0.05",),
        ("normal fan",),
        lambda f: f.noise("fan", 0.05),
        injected="noise on its stub",
    ),
    Row(
        "fan",
        replace(NORMAL, events=("station 4 gives more answers than it gets requests",)),
        ("fault fan repeated_answers",),
        ("normal fan",),
        lambda f: f.repeated_answers("fan"),
        injected="every answer twice",
    ),
    # refusals and wrong answers
    Row("fan", REFUSED, ("fault fan rs",), ("normal fan",), lambda f: f.rs("fan"), injected="Data_Exchange refused"),
    Row("fan", REFUSED, ("fault fan rs status=UE",), ("normal fan",), lambda f: f.rs("fan", "UE")),
    Row("fan", REFUSED, ("fault fan rs status=RR",), ("normal fan",), lambda f: f.rs("fan", "RR")),
    Row(
        "tank",
        Truth(BY_TURNS, _ANY, (*_BRING_UP, *_EXCHANGE), events=("slave 8 (tank): answers Data_Exchange with 1 octet",)),
        ("fault tank wrong_length",),
        ("normal tank",),
        lambda f: f.wrong_length("tank"),
        injected="inputs of the wrong length",
    ),
    Row(
        "tank",
        Truth(events=("input channel 0 (bit): line break",)),
        ("fault tank diagnosis error=6",),
        ("normal tank",),
        lambda f: f.diagnosis("tank", error=6),
        injected="diagnosis, slot 1, input channel 0 (bit): line break",
    ),
    Row(
        "tank",
        Truth(events=("slave 8 (tank): diagnosis wd_on; device: 05",)),
        ("fault tank diagnosis octets=0205 fault=false",),
        ("normal tank",),
        lambda f: f.diagnosis("tank", octets=b"\2\5", fault=False),
        injected="diagnosis 02 05",
    ),
    # in the drive
    Row("fan", TRIPPED, ("trip fan OC1",), kit=lambda f: f.trip("fan", "OC1"), injected="trip OC1"),
    Row("fan", TRIPPED, ("fault fan trip code=OC1",), injected="trip OC1"),
    Row("fan", NORMAL, ("warn fan 0080",), ("warn fan 0",), injected="warn 0080"),
    Row("fan", NORMAL, ("load fan 0.6",), ("load fan 0.2",), injected="load 0.6"),
    Row("fan", NO_INVERTER, ("release fan off",), ("release fan on",), injected="release off"),
    Row("fan", NO_INVERTER, ("mains fan off",), ("mains fan on",), injected="release off"),
    Row("fan", NORMAL, ("parameter-error fan 104",), injected="parameter-error 104 1"),
    # inputs
    Row("tank", EXCHANGING, ("input tank 0102",), ("mirror tank",)),
    Row("tank", EXCHANGING, ("set tank.level=7",), ("mirror tank",)),
    Row(
        "tank",
        EXCHANGING,
        ("fault tank set octets=0708",),
        ("normal tank",),
        lambda f: f.begin("tank", "set", octets=b"\7\x08"),
    ),
    # in the station
    Row(
        "io",
        Truth(events=("module status: slot 2 data invalid",)),
        ("wire-break io 2 0 on",),
        ("wire-break io 2 0 off",),
        injected="wire-break 2 0 on",
    ),
    Row("io", Truth(events=("module status: slot 1 no module",)), ("pull io 1",), ("plug io 1",), injected="pull 1"),
    Row("io", EXCHANGING, ("parameter io 1 03",), ("parameter io 1 01",)),
    # on the line
    Row("fan", CUT, kit=lambda f: f.silence_master(), line="silence 0", end=("resume 0",)),
    Row("fan", CUT, line="silence 1", end=("resume 1",)),
    Row("fan", CUT, kit=lambda f: f.line_noise(0.05), line="noise 0.05", end=("noise 0",)),
)

#: commands of ``ctl`` to a simulated slave that are no fault of this plant: other drives have them
ELSEWHERE: Final = {
    "jog": "tests/drives/test_ls_simulator.py",
    "acknowledge": "tests/api/slave_side/test_simulated_orders.py",
    "contact": "tests/api/slave_side/test_simulated_orders.py",
    "link": "tests/api/slave_side/test_simulated_orders.py",
    "set-point": "tests/api/slave_side/test_simulated_orders.py",
    "turn": "tests/devices/test_encoder_preset.py",
    "hart": "tests/api/slave/test_hart_api.py",
    **dict.fromkeys(
        (
            "process",
            "simulate",
            "fail-safe",
            "sensor-failure",
            "maintenance",
            "function-check",
            "out-of-service",
            "local-operation",
            "jam",
            "write-protect",
            "slow",
        ),
        "tests/pa/test_simulated_slave.py",
    ),
}


# --- the trial -------------------------------------------------------------------------------------------------------


async def make_normal(place: Place) -> None:
    """All in data exchange, with outputs that are not zero; the fan turns."""
    bus = place.bus
    for slave in bus.slaves:
        await place.until_over(slave.name)
    bus.slave("tank").outputs = b"\x01"
    bus.slave("io").outputs = b"\x05"
    fan = bus.drive("fan")
    await fan.settled()
    if fan.status.state is dpstack.profile.State.FAULT:
        await fan.acknowledge()
    await fan.start()
    fan.speed = 0.5
    for name in ("fan", "tank", "io"):
        await place.until(name, replace(NORMAL, motor=(True, None)), "")


async def carry_out(place: Place, row: Row, order: Order) -> None:
    """Begin the fault of ``row`` by commands on a healthy plant, wait for what must happen, and end it."""
    await make_normal(place)
    place.told.clear()
    for text in (row.line,) if row.line else row.begin:
        await order(text)
    await place.until(row.slave, row.truth, row.injected)
    for text in row.end:
        await order(text)
    await place.until_over(row.slave)


async def call(place: Place, row: Row, faults: Faults) -> None:
    """The same by the call of the testing kit."""
    await make_normal(place)
    place.told.clear()
    assert row.kit is not None
    row.kit(faults)
    await place.until(row.slave, row.truth, row.injected)
    faults.clear()
    await place.until_over(row.slave)
