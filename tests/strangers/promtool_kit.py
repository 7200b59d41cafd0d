"""Scrapes in virtual time as the input of ``promtool test rules``: the alerts that Prometheus raises by them."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
from pathlib import Path
from typing import Any, Final

from metrics_kit import scrape
from prometheus_expressions import FOLDER

from dpstack.bridge.metrics.connector import MetricsConnector
from tests.strangers.stranger_kit import HANGS_S, program

#: s between two scrapes, and two evaluations of the rules
STEP_S: Final = 15
TARGET: Final = {"job": "dpstack", "instance": "line-7:9464"}
_GOT: Final = re.compile(r"got:(.*)", re.DOTALL)
_LABEL: Final = re.compile(r'(\w+)="((?:[^"\\]|\\.)*)"')


def series_name(name: str, labels: dict[str, str]) -> str:
    pairs = ", ".join(f"{key}={json.dumps(value)}" for key, value in sorted(labels.items()))
    return f"{name}{{{pairs}}}"


class Recording:
    """Samples of all series, one a step. A target that does not answer has ``up`` 0 and no other series."""

    def __init__(self) -> None:
        self.steps = 0
        self._samples: dict[str, list[str]] = {}

    async def take(self, connector: MetricsConnector | None, steps: int) -> None:
        """Wait and scrape ``connector`` (None: it does not answer) so many times."""
        for _ in range(steps):
            await asyncio.sleep(STEP_S)
            await self.scrape(connector)

    async def scrape(self, connector: MetricsConnector | None) -> None:
        """Scrape ``connector`` at this moment, as the next step."""
        self._note("up", {}, float(connector is not None))
        if connector is not None:
            for (name, labels), value in (await scrape(connector)).series.items():
                self._note(name, dict(labels), value)
        self.steps += 1

    def _note(self, name: str, labels: dict[str, str], value: float) -> None:
        # labels of ours win, as with honor_labels: false they would be called exported_...: there are none
        values = self._samples.setdefault(series_name(name, labels | TARGET), [])
        values += self._gap(values, self.steps)
        values.append(repr(value))

    @staticmethod
    def _gap(values: list[str], steps: int) -> list[str]:
        """A series that a scrape does not have is stale from there on."""
        missing = steps - len(values)
        return ([] if missing <= 0 else ["stale" if values else "_"]) + ["_"] * (missing - 1)

    def input_series(self) -> list[dict[str, str]]:
        return [
            {"series": name, "values": " ".join(values + self._gap(values, self.steps))}
            for name, values in self._samples.items()
        ]

    def firing(self, folder: Path, steps: list[int]) -> list[set[str]]:
        """The alerts that fire at each of ``steps``, as names with the address of a slave or the name of a connector or
        process, if there is one."""
        asked = [
            {
                "expr": 'group by (alertname, address, connector, process) (ALERTS{alertstate="firing"})',
                "eval_time": f"{step * STEP_S}s",
                # no alert is called so: promtool tells what it has got instead
                "exp_samples": [{"labels": f'{{alertname="none", at="{step}"}}', "value": 1}],
            }
            for step in steps
        ]
        test = {
            "rule_files": [str(FOLDER / "dpstack.rules.yml")],
            "evaluation_interval": f"{STEP_S}s",
            "tests": [
                {"interval": f"{STEP_S}s", "input_series": self.input_series(), "promql_expr_test": asked},
            ],
        }
        file = folder / "alerts.test.yml"
        file.write_text(json.dumps(test), encoding="utf-8")
        done = subprocess.run(
            [program("promtool"), "test", "rules", str(file)],
            capture_output=True,
            text=True,
            timeout=HANGS_S,
            check=False,
        )
        found: dict[int, set[str]] = {}
        for block in re.split(r"expr: ", done.stdout + done.stderr)[1:]:
            at = re.search(r'at="(\d+)"', block)
            got = _GOT.search(block)
            assert at is not None, done.stdout + done.stderr
            assert got is not None, done.stdout + done.stderr
            found[int(at[1])] = {_alert(one) for one in re.findall(r"{([^}]*)} \S+", got[1])}
        assert found.keys() == set(steps), done.stdout + done.stderr
        return [found[step] for step in steps]


def _alert(labels: str) -> str:
    found: dict[str, Any] = dict(_LABEL.findall(labels))
    more = [found[key] for key in ("address", "connector", "process") if key in found]
    return " ".join([found["alertname"].removeprefix("Dpstack"), *more])
