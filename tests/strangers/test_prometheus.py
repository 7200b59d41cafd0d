"""Prometheus and promtool from Debian: our metrics and rules are clean, and every expression finds its series."""

from __future__ import annotations

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
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from prometheus_expressions import FOLDER, expressions

from tests.strangers.stranger_kit import HANGS_S, program, run_program

pytestmark = pytest.mark.strangers

#: a fixed cycle, for its metrics; a slave that loses its power, and telegrams that are damaged
PLANT: Final = """[bus]
port = "virtual"
baud = 500000
cycle_ms = 10

[[slave]]
name = "valves"
address = 8
ident = 0x1234
config = "21 11"

[[slave]]
name = "pump"
address = 9
ident = 0x1234
config = "20 10"

[metrics]
listen = "127.0.0.1:{port}"

[mqtt]
url = "mqtt://127.0.0.1:{closed}"
group = "hall 3"
node = "line 7"
"""
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


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port: int = one.getsockname()[1]
        return port


def fetch(port: int, path: str) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=10) as answer:
        text: str = answer.read().decode()
        return text


class Plant:
    """A run with metrics, and a Prometheus that reads them."""

    def __init__(self, folder: Path) -> None:
        self.port, self.own = free_port(), free_port()
        closed = free_port()
        (folder / "plant.toml").write_text(PLANT.format(port=self.port, closed=closed), encoding="utf-8")
        (folder / "faults.toml").write_text(SCENARIO, encoding="utf-8")
        setup = SETUP.format(rules=FOLDER / "dpstack.rules.yml", port=self.port, closed=closed)
        (folder / "prometheus.yml").write_text(setup, encoding="utf-8")
        words = [
            sys.executable,
            "-P",
            "-m",
            "dpstack.cli.main",
            "run",
            "plant.toml",
            "--scenario",
            "faults.toml",
            "--json",
        ]
        with (folder / "run").open("wb") as output, (folder / "prometheus").open("wb") as told:
            self.run = subprocess.Popen(
                words, cwd=folder, stdout=output, stderr=output, env=os.environ | {"XDG_STATE_HOME": str(folder)}
            )
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
        text = one.text.replace('instance=~"$instance"', 'instance=~".*"')
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
