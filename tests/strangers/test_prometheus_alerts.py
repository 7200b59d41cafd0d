"""Each alert of tools/prometheus is raised by its own fault on a simulated plant, after its time, and by no other one.

The plant runs in virtual time, its metrics are scraped every 15 s, and promtool from Debian evaluates the rules.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import probe_connector
import pytest
from api_kit import bench_of
from foreign_master import ForeignMaster, fdl_status
from probe_connector import ProbeConnector
from prometheus_expressions import FOLDER, expressions

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.bridge.metrics.connector import MetricsConnector
from dpstack.sim.world import World
from dpstack.testing.faults import Faults
from tests.strangers.promtool_kit import STEP_S, Recording

pytestmark = pytest.mark.strangers

VALVES: Final[dict[str, Any]] = {"name": "valves", "address": 9, "ident": 0x1234, "config": "21 11"}
PUMP: Final[dict[str, Any]] = {"name": "pump", "address": 8, "ident": 0x1234, "config": "20 10"}
#: scrapes before the fault: nothing must be raised until then
QUIET: Final = 8
#: the address of the master
MASTER: Final = 2
#: a program that has nearly no file descriptor left
HUNGRY: Final = """
import resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (10, 10))
kept = [open("/dev/null") for _ in range(6)]
print(flush=True)
sys.stdin.read()
"""


@dataclass
class Plant:
    """A simulated plant whose metrics are recorded."""

    bus: dpstack.Bus
    connector: MetricsConnector
    faults: Faults
    world: World
    recording: Recording = field(default_factory=Recording)

    async def take(self, scrapes: int) -> None:
        await self.recording.take(self.connector, scrapes)


@contextlib.asynccontextmanager
async def plant(**bus_keys: Any) -> AsyncIterator[Plant]:
    """Two slaves at a slow rate, so that minutes are cheap; in Operate, and nothing wrong for two minutes."""
    keys: dict[str, Any] = {"port": "virtual", "baud": 19_200, "slaves": [VALVES, PUMP]}
    bus = dpstack.open_bus(**keys | bus_keys)
    tables: dict[str, Any] = {"metrics": {"listen": "127.0.0.1:0"}, "probe": {}}
    async with dpstack.publish(bus, **tables) as publishing, bus:
        core = core_of(bus)
        assert core.world is not None
        [connector] = [one for one in publishing._connectors if isinstance(one, MetricsConnector)]
        made = Plant(bus, connector, Faults(bench_of(bus), core.world, 1), core.world)
        await bus.operate()
        await bus.ready()
        await made.take(QUIET)
        yield made


Fault = Callable[[Plant], Awaitable[None]]


async def slave_lost(plant: Plant) -> None:
    plant.faults.power_off("pump")
    await plant.take(3)


async def slave_flapping(plant: Plant) -> None:
    for _ in range(3):
        with plant.faults.power_off("pump"):
            await plant.take(1)
        await plant.take(1)


async def diagnosis(plant: Plant) -> None:
    plant.faults.diagnosis("pump", octets=bytes.fromhex("44 01 00 00"))
    await plant.take(6)


async def retries(plant: Plant) -> None:
    plant.faults.noise("pump", 3e-4)
    await plant.take(26)


async def damage(plant: Plant) -> None:
    plant.faults.line_noise(3e-5)
    await plant.take(26)


async def not_operating(plant: Plant) -> None:
    await plant.bus.clear()
    await plant.take(6)


async def clear_forced(plant: Plant) -> None:
    plant.faults.power_off("pump")
    await plant.take(3)


class Greedy(ForeignMaster):
    """Its own address as ``ns``: it passes the token to itself for ever. ``dies``: it begins to use its token, and
    loses its power."""

    dies = False

    def take_tx(self, now: int) -> bytes | None:
        octets = super().take_tx(now)
        if octets is not None and not self.plan and self.ns == self.address:
            self.speak(now + self.bits(33))
        if octets is not None and self.dies:
            self.plan.clear()
            self.ready = False
        return octets


async def joined(plant: Plant) -> Greedy:
    """Another master in the ring."""
    other = Greedy(3, MASTER, baud=19_200, says=(fdl_status(50, 3),))
    plant.world.add(other)
    await plant.take(2)
    assert other.in_ring
    return other


async def not_in_ring(plant: Plant) -> None:
    (await joined(plant)).ns = 3
    await plant.take(6)


async def tokens_lost(plant: Plant) -> None:
    (await joined(plant)).dies = True
    await plant.take(2)


async def other_master(plant: Plant) -> None:
    """Another master, which the plan does not know, takes its time."""
    tables: list[dict[str, object]] = [
        {"name": f"rack {at}", "address": at, "ident": at, "config": "3F 3F 3F 3F"} for at in range(20, 26)
    ]
    dpstack.simulate(plant.world, tables, baud=19_200)
    async with dpstack.open_bus(world=plant.world, baud=19_200, address=3, slaves=tables) as other:
        await other.operate()
        await plant.take(26)


async def watchdog_near(plant: Plant) -> None:
    with plant.faults.silence("pump"):
        await asyncio.sleep(1.5)
        await plant.recording.scrape(plant.connector)


async def verdict(plant: Plant) -> None:
    plant.faults.power_off("pump")
    await plant.take(22)


async def bus_dead(plant: Plant) -> None:
    await plant.bus.close()
    await plant.take(4)


async def gone(plant: Plant) -> None:
    plant.connector.close()
    await plant.recording.take(None, 6)


async def connector_ended(plant: Plant) -> None:
    ProbeConnector.made[-1].breaks = True
    plant.faults.power_off("pump", 1)
    await plant.take(2)


async def broker_gone(plant: Plant) -> None:
    ProbeConnector.made[-1].connected = True
    await plant.take(1)
    ProbeConnector.made[-1].connected = False
    await plant.take(22)


async def changes_dropped(plant: Plant) -> None:
    ProbeConnector.made[-1].dropped += 1
    await plant.take(2)


async def events_lost(plant: Plant) -> None:
    for number in range(3000):
        core_of(plant.bus).notice("test", f"event {number}")
    await plant.take(3)


async def few_descriptors(plant: Plant) -> None:
    """A simulated bus has no process: another one stands for it."""
    words = [sys.executable, "-S", "-c", HUNGRY]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:  # noqa: ASYNC220
        assert process.stdout is not None
        process.stdout.readline()
        plant.connector.collector._bus_pid = lambda: process.pid
        await plant.take(22)


class Case(NamedTuple):
    """``more``: further alerts that the fault raises until its end; ``bus``: keys of the bus."""

    fault: Fault
    more: set[str] = set()
    bus: dict[str, Any] = {}


SLOW: Final = {"t_sl": 16_383, "max_retry": 7, "slaves": [VALVES, PUMP | {"watchdog_ms": 1000}]}
CASES: Final[dict[str, Case]] = {
    "SlaveLost 8": Case(slave_lost),
    "SlaveFlapping 8": Case(slave_flapping),
    "SlaveDiagnosis 8": Case(diagnosis),
    "SlaveRetries 8": Case(retries, {"Damage", "VerdictCritical"}),
    "Damage": Case(damage),
    "NotOperating": Case(not_operating),
    "ClearForced": Case(clear_forced, {"SlaveLost 8"}, {"auto_clear": True}),
    "NotInRing": Case(not_in_ring, {"SlaveLost 8", "SlaveLost 9"}, {"hsa": 6}),
    "TokenLost": Case(tokens_lost, bus={"hsa": 6}),
    "RotationLong": Case(other_master),
    "CyclesMissed": Case(other_master, {"RotationLong"}, {"cycle_ms": 100}),
    "WatchdogNear 8": Case(watchdog_near, bus=SLOW),
    "VerdictCritical": Case(verdict, {"SlaveLost 8"}),
    "BusDead": Case(bus_dead),
    "Gone": Case(gone),
    "ConnectorEnded probe": Case(connector_ended),
    "ConnectorNotConnected probe": Case(broker_gone),
    "Losses probe": Case(changes_dropped),
    "Losses": Case(events_lost),
    "FewFileDescriptors bus": Case(few_descriptors),
}


@pytest.fixture(autouse=True)
def probe() -> Iterator[None]:
    probe_connector.register()
    yield
    probe_connector.forget()


def waits() -> dict[str, int]:
    """The scrapes between the first one with a fault and its alert (``for``), by alert."""
    text = (FOLDER / "dpstack.rules.yml").read_text(encoding="utf-8")
    found = {}
    for name, rest in re.findall(r"- alert: Dpstack(\w+)\n((?:(?! +- alert).*\n)*)", text):
        time = re.search(r"for: (\d+)([sm])", rest)
        found[name] = 0 if time is None else int(time[1]) * {"s": 1, "m": 60}[time[2]] // STEP_S
    return found


def test_every_alert_has_a_fault() -> None:
    alerts = {one.where.removeprefix("alert Dpstack") for one in expressions() if one.where.startswith("alert ")}
    assert {name.partition(" ")[0] for name in CASES} == alerts == set(waits())


@pytest.mark.parametrize("alert", CASES)
def test_an_alert_is_raised_by_its_fault(alert: str, tmp_path: Path) -> None:
    case = CASES[alert]

    async def program() -> Recording:
        async with plant(**case.bus) as made:
            await case.fault(made)
        return made.recording

    recording = dpstack.run_virtual(program())
    steps = list(range(recording.steps))
    raised = recording.firing(tmp_path, steps)
    # nothing before the fault, the alert not before its time, and at the end no alert of something else
    first = QUIET + waits()[alert.partition(" ")[0]]
    assert not any(raised[:QUIET])
    assert not any(alert in found for found in raised[:first])
    assert set().union(*raised) - case.more == {alert}
    assert raised[-1] == {alert, *case.more}
