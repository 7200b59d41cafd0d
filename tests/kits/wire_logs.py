"""Wire logs of scenarios with fixed seeds in virtual time, one line each: name, telegrams, hash, events, their hash.

``python tests/kits/wire_logs.py`` writes ``tests/snapshots/wire_logs.jsonl``, ``--lines`` prints its lines, and
``--show NAME SEED`` prints one wire log, for a diff between two commits. The hash of the wire counts start, end,
octets, sender and remark of every transmission, that of the events their times. The scenarios use names that commit
364aac1 has, too, and the file runs there as it is. Its lines are those of the snapshot, but for :data:`CHANGED`.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import importlib
import json
import sys
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any, Final

import dpstack

SNAPSHOT: Final = Path(__file__).parents[1] / "snapshots" / "wire_logs.jsonl"
_SETTINGS: Final = "6d07c65: a drive compares its settings when data exchange begins"
_SHARE: Final = "cd04562: the plan of a fixed cycle has a note on the share of services; the wire is the same"
#: scenario and seed whose line is not that of commit 364aac1, with the commit that changed it, and the reason
CHANGED: Final = {
    ("noise", 2): "a042e8e: a slave that answers and is lost in its bring-up is asked again after the shortest pause",
    ("noise", 3): "8db2bfb: a slave is taken up again when a GAP poll has found it",
    ("noise_while_slaves_come", 1): _SETTINGS,
    ("noise_while_slaves_come", 2): _SETTINGS,
    ("noise_while_slaves_come", 3): _SETTINGS,
    ("class2", 1): "506229d: the parts of a scan are no events any more; the wire is the same",
    ("five_drives", 1): _SETTINGS,
    ("tight_cycle", 1): _SHARE,
    ("tight_cycle", 2): _SHARE,
    ("tight_cycle", 3): _SHARE,
    ("fixed_cycle", 1): _SHARE,
    ("rate_groups_on_a_grid", 1): _SHARE,
}
_ALARMS: Final = ("pull_plug", "process", "diagnostic", "update")


class Recorder:
    """A world whose wire is recorded, with the times of the events of its buses."""

    def __init__(self, seed: int) -> None:
        self.world = dpstack.World(seed=seed)
        self.wire: list[str] = []
        self.events: list[int] = []
        self.world.log.listener = self._add

    def _add(self, entry: Any) -> None:
        self.wire.append(f"{entry.start_ns} {entry.end_ns} {entry.octets.hex()} {entry.sender} {entry.note}")

    def on_event(self, event: Any) -> None:
        self.events.append(event.t_ns)

    def on_events(self, events: Sequence[Any]) -> None:
        self.events += [event.t_ns for event in events]

    def bus(self, *tables: dict[str, Any], baud: Any = 500_000, **keys: Any) -> Any:
        """A bus on the recorded line whose slaves stand there already."""
        return dpstack.open_bus(
            port="virtual", baud=baud, slaves=list(tables), world=self.world, on_event=self.on_event, **keys
        )

    def simulate(self, *tables: dict[str, Any], baud: Any = 500_000) -> Any:
        return dpstack.simulate(self.world, list(tables), baud=baud)


def _mirrors(count: int, first: int = 3, **keys: Any) -> list[dict[str, Any]]:
    return [
        {"name": f"s{a}", "address": a, "ident": 0x1234, "config": "20 10"} | keys for a in range(first, first + count)
    ]


def _drives() -> list[dict[str, Any]]:
    kinds: dict[str, dict[str, Any]] = {
        "demag-dedrive": {"set_412": True},
        "keb-f5": {"control_bits": "simulated", "status_bits": "simulated", "rpm_per_count": 1.0},
        "fuji-frenic": {},
        "ls-s100": {},
        "imo-hd2": {"baud_index": 5},  # 500 kbit/s
    }
    return [
        {"name": kind, "address": 10 + n, "drive": kind, "options": options}
        for n, (kind, options) in enumerate(kinds.items())
    ]


def _station(address: int) -> dict[str, Any]:
    modules = ["8 DI", "8 DO", "2 AI"]
    dpv1 = {"alarms": list(_ALARMS), "alarm_mode": 0}
    return {"name": f"io{address}", "address": address, "gsd": "io-station", "modules": modules, "dpv1": dpv1}


def _first(*names: str) -> Any:
    """The first of ``names`` ("module:attribute") that this commit has."""
    for name in names:
        module, _, attribute = name.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError):
            continue
    raise ImportError(f"none of {', '.join(names)} exists")


async def _change_outputs(bus: Any, rounds: int, pause: float = 0.01) -> None:
    for number in range(rounds):
        for slave in bus.slaves:
            slave.outputs = bytes((number & 0xFF,) * len(slave.outputs))
        await asyncio.sleep(pause)


# --- scenarios ---


async def noise(log: Recorder) -> None:
    tables = _mirrors(4)
    log.simulate(*tables)
    async with log.bus(*tables) as bus:
        await bus.operate()
        await bus.ready(10)
        for per_bit in (3e-5, 0, 3e-4, 0, 2e-3):
            log.world.faults.noise(per_bit)
            await _change_outputs(bus, 25)
        log.world.faults.clear()
        await bus.ready(10)


async def noise_while_slaves_come(log: Recorder) -> None:
    """Noise from the first telegram on, with drives and DP-V1 slaves."""
    tables = [_station(5), *_drives()[:2], *_mirrors(2, 20)]
    log.simulate(*tables)
    log.world.faults.noise(1e-4)
    async with log.bus(*tables) as bus:
        await bus.operate()
        await asyncio.sleep(0.4)


async def many_slaves(log: Recorder) -> None:
    """32 slaves of several lengths at 12 Mbit/s, with a GAP."""
    config = ("20 10", "F3 F1", "40 20 20", "00")
    tables = [table | {"config": config[table["address"] % 4]} for table in _mirrors(32)]
    log.simulate(*tables, baud=12_000_000)
    async with log.bus(*tables, baud=12_000_000, hsa=50, gap=2) as bus:
        await bus.operate()
        await bus.ready(10)
        await _change_outputs(bus, 10)


async def slow_line(log: Recorder) -> None:
    """9600 bit/s, with a GAP and a slave that nobody has."""
    tables = _mirrors(2)
    log.simulate(*tables, {"name": "foreign", "address": 9, "ident": 0x4321, "config": "10"}, baud=9_600)
    async with log.bus(*tables, baud=9_600, hsa=12) as bus:
        await bus.operate()
        await bus.ready(30)
        await _change_outputs(bus, 20, 0.2)


async def line_faults(log: Recorder) -> None:
    """Telegrams dropped, damaged and delayed by choice, and foreign octets between and into telegrams."""
    tables = _mirrors(3)
    log.simulate(*tables)
    faults, world = log.world.faults, log.world
    async with log.bus(*tables) as bus:
        await bus.operate()
        await bus.ready(10)
        faults.drop(lambda tx: tx.octets[0] == 0x68, times=3)
        await asyncio.sleep(0.02)
        faults.damage(lambda tx: tx.octets[0] == 0x68, times=4)
        faults.damage(lambda tx: tx.octets[0] == 0xDC, octet=1, flips=6, times=1)
        await asyncio.sleep(0.02)
        faults.delay(lambda tx: tx.octets[0] == 0xE5 or len(tx.octets) == 10, 400_000, times=5)
        await asyncio.sleep(0.05)
        for number in range(20):
            world.inject(bytes((0x10, 2, number)))
            await asyncio.sleep(0.0031)
        world.inject(bytes.fromhex("68 05 05 68 05 02 7D AB CD FC 16"), baud=187_500)
        await asyncio.sleep(0.05)


async def two_masters(log: Recorder) -> None:
    mine, others = _mirrors(3), _mirrors(3, 10)
    log.simulate(*mine, *others)
    async with log.bus(*mine, address=2, hsa=20) as first:
        await first.operate()
        await first.ready(10)
        async with log.bus(*others, address=8, hsa=20) as second:
            await second.operate()
            await second.ready(20)
            await _change_outputs(first, 10)
            await _change_outputs(second, 10)
            log.world.faults.drop(lambda tx: tx.octets[0] == 0xDC, times=4)
            await asyncio.sleep(0.1)
        await asyncio.sleep(0.1)


async def three_masters_in_noise(log: Recorder) -> None:
    """Masters that begin at once, lose tokens and slaves, and leave one by one."""
    tables = [_mirrors(2, first) for first in (10, 20, 30)]
    log.simulate(*(table for each in tables for table in each))
    buses = [log.bus(*each, address=2 + n, hsa=8) for n, each in enumerate(tables)]
    await asyncio.gather(*(bus.open() for bus in buses))
    for bus in buses:
        await bus.operate()
    for per_bit in (0, 1e-5, 3e-4, 0):
        log.world.faults.noise(per_bit)
        await asyncio.sleep(0.15)
    for bus in buses:
        await bus.close()
        await asyncio.sleep(0.05)


async def same_address(log: Recorder) -> None:
    """A second master with the address of the first joins the line."""
    tables = _mirrors(2)
    log.simulate(*tables)
    async with log.bus(*tables, hsa=8) as bus:
        await bus.operate()
        await bus.ready(10)
        other = log.bus(hsa=8)
        opening = asyncio.ensure_future(other.open())
        await asyncio.sleep(0.3)
        opening.cancel()
        await asyncio.gather(opening, return_exceptions=True)
        await other.close()


async def echo(log: Recorder) -> None:
    """A master of its own machine behind a USB adapter that echoes, on a line with noise."""
    params = _first("dpstack.params:BusParams").preset(500_000, address=2, hsa=10)
    tables = _mirrors(3)
    log.simulate(*tables)
    slave = _first("dpstack.dp.slave_params:SlaveParams", "dpstack.dp.setup:SlaveSetup")
    slaves = [slave(address=each["address"], name=each["name"], ident=0x1234, config=b"\x20\x10") for each in tables]
    master_class = _first("dpstack.dp.master.master:Master", "dpstack.dp.master:Master")
    try:
        settings = _first("dpstack.dp.master.settings:MasterSettings")
    except ImportError:
        master = master_class(params, slaves, watchdog_ms=1000)
    else:
        master = master_class(params, slaves, settings(watchdog_ms=1000))
    station_class = _first("dpstack.fdl.active.station:ActiveStation", "dpstack.fdl.active:ActiveStation")
    station = station_class(params, [master], patience=_first("dpstack.phy.patience:ADAPTER"))
    filters = ("dpstack.drivers.line.echo", "dpstack.drivers.echo")
    own = _first(*(f"{module}:EchoFilter" for module in filters))(
        _first(*(f"{module}:Echo" for module in filters)).AUTO
    )
    habits = _first("adapter_model:Habits", "dpstack.sim.adapter:Habits")(echo=True)
    adapter = _first("adapter_model:Adapter", "dpstack.sim.adapter:Adapter")(station, habits, own=own)
    log.world.add(adapter, on_events=log.on_events)
    log.world.command(adapter, _first("dpstack.fdl.commands:GoOnline")())
    operate = _first("dpstack.dp.master.commands:Mode", "dpstack.dp.commands:Mode").OPERATE
    log.world.command(adapter, _first("dpstack.dp.master.commands:SetMode", "dpstack.dp.commands:SetMode")(operate))
    for number in range(50):
        for image in master.images.values():
            image.outputs = bytes((number,))
        log.world.run_for(20_000_000)
        log.world.faults.noise(2e-5 if number > 25 else 0)


async def alarms(log: Recorder) -> None:
    tables = [_station(5), _station(6), *_mirrors(1)]
    bench = log.simulate(*tables)
    async with log.bus(*tables) as bus:
        await bus.operate()
        await bus.ready(10)
        device = bench.device(5)
        other = bench.device(6)
        taken = [asyncio.ensure_future(_count_alarms(bus.slave(a))) for a in (5, 6)]
        await asyncio.sleep(0.02)
        for number in range(6):
            device.wire_break(3, 0, number % 2 == 0)
            other.set_input(1, bytes((1 << number,)))
            await asyncio.sleep(0.03)
        device.pull(1)
        other.pull(2)
        await asyncio.sleep(0.05)
        device.plug(1)
        log.world.faults.drop(lambda tx: len(tx.octets) > 12, times=2)
        other.plug(2)
        await asyncio.sleep(0.1)
        for one in taken:
            one.cancel()


async def _count_alarms(slave: Any) -> None:
    async for _ in slave.alarms():
        pass


async def records(log: Recorder) -> None:
    """DP-V1 records of two slaves beside the cycle, refusals among them."""
    tables = [_station(5), _station(6), *_mirrors(2)]
    log.simulate(*tables)
    async with log.bus(*tables) as bus:
        await bus.operate()
        await bus.ready(10)

        async def ask(address: int) -> None:
            slave = bus.slave(address)
            for number in range(8):
                await slave.read(0, 2)
                await slave.write(1, 1, bytes((number & 3,)))
                await slave.im(0, slot=1)
                try:
                    await slave.read(7, 9)
                except dpstack.DpError:
                    await asyncio.sleep(0.001)

        await asyncio.gather(ask(5), ask(6), _change_outputs(bus, 5))


async def class2(log: Recorder) -> None:
    """Services and a connection of class 2, and a scan of the addresses."""
    tables = [_station(5), *_mirrors(1)]
    log.simulate(*tables)
    async with log.bus(*tables) as bus:
        await bus.operate()
        await bus.ready(10)
        async with bus.class2.connect(5) as connection:
            for slot in (0, 1, 2):
                await connection.read(slot, 2)
            await asyncio.sleep(0.2)
        await bus.class2.config(5)
        await bus.class2.inputs(5)
        await bus.scan(addresses=range(12))


async def fixed_cycle(log: Recorder) -> None:
    tables = [_station(5), *_mirrors(3, 10)]
    log.simulate(*tables)
    async with log.bus(*tables, cycle_ms=8) as bus:
        await bus.operate()
        await bus.ready(10)
        for _ in range(10):
            await bus.slave(5).read(0, 2)
        await _change_outputs(bus, 12)


async def tight_cycle(log: Recorder) -> None:
    """Cycles with lost telegrams and services, of which some come late."""
    tables = [_station(5), *_mirrors(4, 10)]
    log.simulate(*tables)
    async with log.bus(*tables, cycle_ms=6) as bus:
        await bus.operate()
        await bus.ready(10)
        log.world.faults.noise(2e-5)
        for _ in range(8):
            try:
                await bus.slave(5).read(0, 2)
            except dpstack.DpError:
                await asyncio.sleep(0.01)
        await _change_outputs(bus, 25)


async def rate_groups(log: Recorder) -> None:
    tables = [table | {"every": every} for table, every in zip(_mirrors(6), (1, 2, 2, 3, 4, 6), strict=True)]
    log.simulate(*tables)
    async with log.bus(*tables) as bus:
        await bus.operate()
        await bus.ready(10)
        await _change_outputs(bus, 25)


async def rate_groups_on_a_grid(log: Recorder) -> None:
    tables = [table | {"every": every} for table, every in zip(_mirrors(5), (1, 2, 3, 3, 5), strict=True)]
    log.simulate(*tables)
    async with log.bus(*tables, cycle_ms=5) as bus:
        await bus.operate()
        await bus.ready(10)
        await _change_outputs(bus, 25)


async def five_drives(log: Recorder) -> None:
    tables = _drives()
    log.simulate(*tables)
    async with log.bus(*tables) as bus:
        await bus.operate()
        await bus.ready(10)

        async def turn(drive: Any, speed: float) -> None:
            with contextlib.suppress(dpstack.DpError):
                await drive.start()
                drive.speed = speed
                await asyncio.sleep(0.2)
                await drive.stop()

        await asyncio.gather(*(turn(drive, 0.1 * (n + 1)) for n, drive in enumerate(bus.drives)))


async def sync_freeze(log: Recorder) -> None:
    tables = [
        table | {"groups": groups, "sync": True, "freeze": True}
        for table, groups in zip(_mirrors(4), ([1], [1, 2], [2], [3]), strict=True)
    ]
    log.simulate(*tables)
    async with log.bus(*tables) as bus:
        await bus.operate()
        await bus.ready(10)
        await bus.sync(1)
        await _change_outputs(bus, 4)
        await bus.sync([1, 2], settle=True)
        await bus.freeze(2)
        await asyncio.sleep(0.02)
        await bus.unfreeze()
        await bus.unsync()
        async with bus.group(1) as group:
            for number in range(4):
                await group.exchange({"s3": bytes((number,)), "s4": bytes((number + 7,))})


async def comes_and_goes(log: Recorder) -> None:
    """Slaves that fall silent, lose power, come back, are taken out of service and parameterised anew."""
    tables = _mirrors(5)
    bench = log.simulate(*tables)
    bench.power(7, False)
    async with log.bus(*tables) as bus:
        await bus.operate()
        await bus.slave(3).ready(10)
        bench.silence(4, 30_000_000)
        await asyncio.sleep(0.1)
        bench.power(5, False)
        await asyncio.sleep(0.1)
        bench.power(5, True)
        bench.power(7, True)
        await bus.ready(10)
        await bus.slave(6).deactivate()
        await asyncio.sleep(0.05)
        await bus.slave(6).activate()
        await bus.slave(3).reparameterise(watchdog_ms=200)
        await bus.clear()
        await asyncio.sleep(0.02)
        await bus.operate()
        await asyncio.sleep(0.02)
        await bus.stop()
        await asyncio.sleep(0.02)


async def baud_search(log: Recorder) -> None:
    """Slaves and a second master that search the rate; the rate of the bus changes."""
    tables, others = _mirrors(2), _mirrors(1, 10)
    log.simulate(*tables, *others, baud="auto")
    async with log.bus(*tables, baud=187_500, address=2, hsa=12) as first:
        await first.operate()
        await first.ready(20)
        async with log.bus(*others, baud="auto", address=6, hsa=12) as second:
            await second.operate()
            await second.ready(20)
            await asyncio.sleep(0.1)


Scenario = Callable[[Recorder], Awaitable[None]]

#: scenarios that depend on chance, with their seeds
_BY_CHANCE: Final[dict[Scenario, Sequence[int]]] = {
    noise: (1, 2, 3),
    noise_while_slaves_come: (1, 2, 3),
    line_faults: (1, 2),
    three_masters_in_noise: (1, 2, 3),
    echo: (1, 2, 3),
    tight_cycle: (1, 2, 3),
}
_SCENARIOS: Final[Sequence[Scenario]] = (
    *_BY_CHANCE,
    many_slaves,
    slow_line,
    two_masters,
    same_address,
    alarms,
    records,
    class2,
    fixed_cycle,
    rate_groups,
    rate_groups_on_a_grid,
    five_drives,
    sync_freeze,
    comes_and_goes,
    baud_search,
)
#: every scenario with each of its seeds
RUNS: Final = [(scenario, seed) for scenario in _SCENARIOS for seed in _BY_CHANCE.get(scenario, (1,))]


def record(scenario: Scenario, seed: int) -> Recorder:
    """The recorded run of one scenario."""
    log = Recorder(seed)

    async def run() -> None:
        await scenario(log)

    dpstack.run_virtual(run())
    return log


def line(scenario: Scenario, seed: int) -> str:
    """The line of one scenario in the snapshot."""
    log = record(scenario, seed)
    texts = ("\n".join(log.wire), "\n".join(map(str, log.events)))
    wire, events = (hashlib.sha256(text.encode()).hexdigest() for text in texts)
    return json.dumps([scenario.__name__, seed, len(log.wire), wire, len(log.events), events])


def main(words: Sequence[str]) -> None:
    if words[:1] == ["--show"]:
        scenario = next(one for one in _SCENARIOS if one.__name__ == words[1])
        print("\n".join(record(scenario, int(words[2])).wire))
        return
    lines = [line(*run) for run in RUNS]
    if words[:1] == ["--lines"]:
        print("\n".join(lines))
    else:
        SNAPSHOT.write_text("\n".join([*lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
