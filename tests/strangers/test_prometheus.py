"""Prometheus and promtool from Debian: our metrics and rules are clean, and every expression finds its series. Each
alert of tools/prometheus is raised by its own fault on a simulated plant, after its time, and by no other one: the
plant runs in virtual time, its metrics are scraped every 15 s, and promtool evaluates the rules."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest
from api_kit import RAW, bench_of
from far_ends import free_port
from foreign_master import ForeignMaster, fdl_status
from plant_files import plant_file
from probe_connector import ProbeConnector
from prometheus_expressions import FOLDER, expressions

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.bridge.metrics.connector import MetricsConnector
from dpstack.sim.world import World
from dpstack.testing.faults import Faults
from tests.strangers.promtool_kit import STEP_S, Recording
from tests.strangers.stranger_kit import HANGS_S, program, run_program

pytestmark = pytest.mark.strangers

#: a fixed cycle, for its metrics; a slave that loses its power for good, its value is stale then; damaged telegrams
SLAVES: Final = (
    {**RAW, "name": "valves", "address": 8, "config": "21 11", "inputs": {"level": "u8@0"}},
    {**RAW, "name": "pump", "inputs": {"pressure": "u8@0"}},
)
SCENARIO: Final = """[[step]]
at = 1.0
slave = "valves"
do = "noise"
rate = 1e-3
seed = 7
for = 6.0

[[step]]
at = 8.0
slave = "pump"
do = "power_off"
"""
SETUP: Final = """global:
  scrape_interval: 500ms
  evaluation_interval: 500ms
rule_files: [{rules}]
scrape_configs:
  - job_name: dpstack
    static_configs:
      - targets: ["127.0.0.1:{port}"]
  - job_name: other
    static_configs:
      - targets: ["127.0.0.1:{closed}"]
"""
#: the end of an expression that compares: without it an alert without a fault has series
_COMPARISON: Final = re.compile(r" (?:==|>) [0-9.]+$")


def fetch(port: int, path: str) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=10) as answer:
        text: str = answer.read().decode()
        return text


class Plant:
    """A run with metrics, and a Prometheus that reads them."""

    def __init__(self, folder: Path) -> None:
        self.port, self.own = free_port(), free_port()
        self.closed = socket.socket()  # nobody listens there, and no other program can take the port
        self.closed.bind(("127.0.0.1", 0))
        closed = self.closed.getsockname()[1]
        metrics = {"listen": f"127.0.0.1:{self.port}", "values": True}
        mqtt = {"url": f"mqtt://127.0.0.1:{closed}", "group": "hall 3", "node": "line 7"}
        plant_file(folder, *SLAVES, cycle_ms=10, tables={"metrics": metrics, "mqtt": mqtt})
        (folder / "faults.toml").write_text(SCENARIO, encoding="utf-8")
        setup = SETUP.format(rules=FOLDER / "dpstack.rules.yml", port=self.port, closed=closed)
        (folder / "prometheus.yml").write_text(setup, encoding="utf-8")
        words = [sys.executable, "-P", "-m", "dpstack.cli.main"]
        words += ["run", "plant.toml", "--scenario", "faults.toml", "--json"]
        with (folder / "run").open("wb") as output, (folder / "prometheus").open("wb") as told:
            state = os.environ | {"XDG_STATE_HOME": str(folder)}
            self.run = subprocess.Popen(words, cwd=folder, stdout=output, stderr=output, env=state)
            self.server = subprocess.Popen(
                [
                    program("prometheus"),
                    f"--config.file={folder / 'prometheus.yml'}",
                    f"--storage.tsdb.path={folder / 'data'}",
                    f"--web.listen-address=127.0.0.1:{self.own}",
                ],
                stdout=told,
                stderr=told,
            )

    def query(self, expression: str) -> list[dict[str, Any]]:
        try:
            answer = json.loads(fetch(self.own, "/api/v1/query?" + urllib.parse.urlencode({"query": expression})))
        except urllib.error.HTTPError as error:
            if error.code == 503:  # it has just begun
                raise
            raise AssertionError(f"{expression}: {error.read().decode()}") from None
        assert answer["status"] == "success"
        found: list[dict[str, Any]] = answer["data"]["result"]
        return found

    def until(self, expression: str) -> list[dict[str, Any]]:
        """The series of ``expression``, once there are some."""
        end = time.monotonic() + HANGS_S
        while time.monotonic() < end:
            try:
                found = self.query(expression)
            except (urllib.error.URLError, ConnectionError):
                found = []
            if found:
                return found
            time.sleep(0.3)
        raise AssertionError(f"{expression} has no series after {HANGS_S:g} s")

    def end(self) -> None:
        self.closed.close()
        for one in (self.run, self.server):
            if one.poll() is None:
                one.send_signal(signal.SIGTERM)
            one.wait(HANGS_S)


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    made = Plant(tmp_path_factory.mktemp("prometheus"))
    try:
        yield made
    finally:
        made.end()


def test_promtool_finds_nothing_in_the_rules() -> None:
    done = run_program("promtool", ["check", "rules", FOLDER / "dpstack.rules.yml"])
    count = len([one for one in expressions() if one.where.startswith("alert ")])
    assert f"SUCCESS: {count} rules found" in done.stdout


def test_prometheus_scrapes_a_run_and_promtool_finds_nothing_in_its_metrics(plant: Plant) -> None:
    [series] = plant.until('dpstack_bus_up{job="dpstack"}')
    assert series["value"][1] == "1"
    text = fetch(plant.port, "/metrics")
    done = subprocess.run(
        [program("promtool"), "check", "metrics"],
        input=text,
        capture_output=True,
        text=True,
        timeout=HANGS_S,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert plant.query('up{job="dpstack"}')[0]["value"][1] == "1"
    # every sample of the page is there, with its labels
    [count] = plant.query('scrape_samples_scraped{job="dpstack"}')
    assert int(count["value"][1]) > 150
    names = {one["metric"]["slave"] for one in plant.query("dpstack_slave_exchanges_total")}
    assert names == {"valves", "pump"}


def test_the_alert_of_a_lost_slave_is_raised(plant: Plant) -> None:
    [lost] = plant.until('ALERTS{alertname="DpstackSlaveLost", address="9"}')
    assert lost["metric"]["slave"] == "pump"
    assert lost["metric"]["severity"] == "critical"
    # the target that is closed
    assert plant.until('up{job="other"} == 0')


def test_every_expression_has_series(plant: Plant) -> None:
    """Of alerts: with their comparison, or without it, as most faults are not there."""
    plant.until("rate(dpstack_slave_damaged_total[5m])")
    for one in expressions():
        text = re.sub(r'=~"\$\w+"', '=~".*"', one.text)
        if one.where.startswith("alert ") and not plant.query(text):
            text = without_comparison(text)
        if text.endswith(("== 1", "> 0", "> 1")) and not plant.query(text):
            text = without_comparison(text)
        assert plant.until(text), one


def without_comparison(text: str) -> str:
    found = _COMPARISON.sub("", text.partition(" or ")[0])
    # a comparison of two series: with the other sign one of both always has a series
    return re.sub(r" > on ", " <= on ", found) if " > on " in found else found


def test_of_a_run_that_has_ended_no_series_is_fresh(plant: Plant) -> None:
    plant.until("dpstack_bus_up == 1")
    plant.run.send_signal(signal.SIGTERM)
    plant.run.wait(HANGS_S)
    assert plant.until('up{job="dpstack"} == 0')
    assert plant.query("dpstack_bus_up") == []
    assert plant.query("dpstack_slave_in_data_exchange") == []


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
class Scraped:
    """A simulated plant whose metrics are recorded."""

    bus: dpstack.Bus
    connector: MetricsConnector
    faults: Faults
    world: World
    recording: Recording = field(default_factory=Recording)

    async def take(self, scrapes: int) -> None:
        await self.recording.take(self.connector, scrapes)


@contextlib.asynccontextmanager
async def scraped(**bus_keys: Any) -> AsyncIterator[Scraped]:
    """Two slaves at a slow rate, so that minutes are cheap; in Operate, and nothing wrong for two minutes."""
    keys: dict[str, Any] = {"port": "virtual", "baud": 19_200, "slaves": [VALVES, PUMP]}
    bus = dpstack.open_bus(**keys | bus_keys)
    tables: dict[str, Any] = {"metrics": {"listen": "127.0.0.1:0"}, "probe": {}}
    async with dpstack.publish(bus, **tables) as publishing, bus:
        core = core_of(bus)
        assert core.world is not None
        [connector] = [one for one in publishing._connectors if isinstance(one, MetricsConnector)]
        made = Scraped(bus, connector, Faults(bench_of(bus), core.world, 1), core.world)
        await bus.operate()
        await bus.ready()
        await made.take(QUIET)
        yield made


Fault = Callable[[Scraped], Awaitable[None]]


async def slave_lost(plant: Scraped) -> None:
    plant.faults.power_off("pump")
    await plant.take(3)


async def slave_flapping(plant: Scraped) -> None:
    for _ in range(3):
        with plant.faults.power_off("pump"):
            await plant.take(1)
        await plant.take(1)


async def diagnosis(plant: Scraped) -> None:
    plant.faults.diagnosis("pump", octets=bytes.fromhex("44 01 00 00"))
    await plant.take(6)


async def retries(plant: Scraped) -> None:
    plant.faults.noise("pump", 3e-4)
    await plant.take(26)


async def damage(plant: Scraped) -> None:
    plant.faults.line_noise(3e-5)
    await plant.take(26)


async def not_operating(plant: Scraped) -> None:
    await plant.bus.clear()
    await plant.take(6)


async def clear_forced(plant: Scraped) -> None:
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


async def joined(plant: Scraped) -> Greedy:
    """Another master in the ring."""
    other = Greedy(3, MASTER, baud=19_200, says=(fdl_status(50, 3),))
    plant.world.add(other)
    await plant.take(2)
    assert other.in_ring
    return other


async def not_in_ring(plant: Scraped) -> None:
    (await joined(plant)).ns = 3
    await plant.take(6)


async def tokens_lost(plant: Scraped) -> None:
    (await joined(plant)).dies = True
    await plant.take(2)


async def other_master(plant: Scraped) -> None:
    """Another master, which the plan does not know, takes its time."""
    tables: list[dict[str, object]] = [
        {"name": f"rack {at}", "address": at, "ident": at, "config": "3F 3F 3F 3F"} for at in range(20, 26)
    ]
    dpstack.simulate(plant.world, tables, baud=19_200)
    async with dpstack.open_bus(world=plant.world, baud=19_200, address=3, slaves=tables) as other:
        await other.operate()
        await plant.take(26)


async def watchdog_near(plant: Scraped) -> None:
    with plant.faults.silence("pump"):
        await asyncio.sleep(1.5)
        await plant.recording.scrape(plant.connector)


async def verdict(plant: Scraped) -> None:
    plant.faults.power_off("pump")
    await plant.take(22)


async def bus_dead(plant: Scraped) -> None:
    await plant.bus.close()
    await plant.take(4)


async def gone(plant: Scraped) -> None:
    plant.connector.close()
    await plant.recording.take(None, 6)


async def connector_ended(plant: Scraped) -> None:
    ProbeConnector.made[-1].breaks = True
    plant.faults.power_off("pump", 1)
    await plant.take(2)


async def broker_gone(plant: Scraped) -> None:
    ProbeConnector.made[-1].connected = True
    await plant.take(1)
    ProbeConnector.made[-1].connected = False
    await plant.take(22)


async def changes_dropped(plant: Scraped) -> None:
    ProbeConnector.made[-1].dropped += 1
    await plant.take(2)


async def events_lost(plant: Scraped) -> None:
    for number in range(3000):
        core_of(plant.bus).notice("test", f"event {number}")
    await plant.take(3)


async def few_descriptors(plant: Scraped) -> None:
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


@pytest.mark.usefixtures("probe")
@pytest.mark.parametrize("alert", CASES)
def test_an_alert_is_raised_by_its_fault(alert: str, tmp_path: Path) -> None:
    case = CASES[alert]

    async def program() -> Recording:
        async with scraped(**case.bus) as made:
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
