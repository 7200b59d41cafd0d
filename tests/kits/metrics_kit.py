"""Scrapes of the metrics connector, read back by the parser of ``prometheus_client``, and requests to it over a
socket."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from prometheus_client.parser import text_string_to_metric_families

from dpstack.bridge.connector import ConnectorState
from dpstack.bridge.metrics import table
from dpstack.bridge.metrics.connector import MetricsConnector, rendered
from dpstack.plant.tree import PlantTree
from dpstack.tcp_address import Listen

Labels = frozenset[tuple[str, str]]


@dataclass
class Scrape:
    """``series``: values by name and labels; ``kinds``, ``labels``: by the name of the family as the table has it."""

    series: dict[tuple[str, Labels], float] = field(default_factory=dict)
    kinds: dict[str, str] = field(default_factory=dict)
    labels: dict[str, set[frozenset[str]]] = field(default_factory=dict)

    def __call__(self, name: str, **labels: str) -> float:
        return self.series[name, frozenset(labels.items())]

    def of(self, name: str) -> dict[Labels, float]:
        return {labels: value for (one, labels), value in self.series.items() if one == name}

    def has(self, prefix: str) -> bool:
        return any(name.startswith(prefix) for name, _ in self.series)


def read(text: bytes) -> Scrape:
    found = Scrape()
    for family in text_string_to_metric_families(text.decode()):
        name = family.name + ("_total" if family.type == "counter" else "")
        assert name not in found.kinds, f"{name} comes twice"
        found.kinds[name] = family.type
        for sample in family.samples:
            key = sample.name, frozenset(sample.labels.items())
            assert key not in found.series, f"{key} comes twice"
            found.series[key] = sample.value
            found.labels.setdefault(name, set()).add(frozenset(sample.labels) - {"le"})
    return found


async def scrape(connector: MetricsConnector) -> Scrape:
    return read(await rendered(connector.collector.families()))


async def ask(port: int, octets: bytes, *, whole: bool = True) -> bytes:
    """All octets of the server's answer to ``octets``, with its port for PORT. ``whole`` False: the client does not say
    that it sends no more."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(octets.replace(b"PORT", str(port).encode()))
        if whole:
            writer.write_eof()
        return await reader.read()
    except ConnectionError:
        return b""
    finally:
        writer.close()


def request(path: str = "/metrics", method: str = "GET", headers: Mapping[str, str] | None = None) -> bytes:
    given = {"Host": "127.0.0.1:PORT"} if headers is None else headers
    head = "".join(f"{name}: {value}\r\n" for name, value in given.items())
    return f"{method} {path} HTTP/1.1\r\n{head}\r\n".encode("latin-1")


FINE: dict[str, Any] = {
    "state": "data_exchange",
    "inputs_valid": True,
    "inputs_age_ms": 4.0,
    "inputs_limit_ms": 100.0,
    "watchdog_ms": 50.0,
    "fault": None,
    "conspicuous": "",
    "exchanges": 10,
    "telegrams": 20,
    "retries": 1,
    "timeouts": 2,
    "late": 3,
    "wrong": 4,
    "bad": {"bad_fcs": 5},
    "fields": {"level": 12.5},
}
LEVEL: dict[str, Any] = {"name": "level", "type": "f32", "at": "f32@0", "unit": "bar"}
CLASSES = {"limits_us": [10, 20, 50], "counts": [1, 2, 3, 4], "sum_us": 500.0}
BUS: dict[str, Any] = {
    "stale": False,
    "age_ms": 100.0,
    "mode": "operate",
    "in_ring": True,
    "masters": [1, 2],
    "clear": None,
    "bad": {"bad_ed": 6},
    "histograms": dict.fromkeys(("rotation", "token", "host", "late"), CLASSES),
    **{key: number for number, key in enumerate(table.BUS_COUNTERS, 100)},
}
PLAN = {"rotation_us": {"min": 1000.0, "typical": 2000.0, "max": 3000.0}}


def plant(*names: str, **more: Any) -> dict[str, Any]:
    slaves = {str(address): {"name": name, "inputs": [LEVEL]} for address, name in enumerate(names, 3)}
    about = {"started": 1e9, "port": "COM1", "baud": 500_000, "driver": "process", "read_only": False, "plan": PLAN}
    return {"plant": about | {"slaves": slaves} | more}


def snapshot(t: float, *slaves: dict[str, Any], **bus: Any) -> dict[str, Any]:
    given = {str(address): values for address, values in enumerate(slaves, 3)}
    return {"snapshot": {"t": t, "whole": True, "bus": BUS | bus, "slaves": given}}


class Bench:
    """A connector that has got items. ``told``: its remarks."""

    def __init__(self, *items: dict[str, Any], most_values: int | None = 2000) -> None:
        self.told: list[str] = []
        self.tree = PlantTree()
        self.connector = MetricsConnector(
            self.tree,
            lambda text, severity: self.told.append(text),
            Listen("127.0.0.1", 0),
            connectors=lambda: [ConnectorState("metrics", True), ConnectorState("mqtt", False, 12, connected=False)],
            bus_pid=os.getpid,
            most_values=most_values,
        )
        self.give(1.0, *items)

    def give(self, now: float, *items: dict[str, Any]) -> None:
        self.connector.take(self.tree.apply_all(items, now))

    def scrape(self) -> Scrape:
        return asyncio.run(scrape(self.connector))
