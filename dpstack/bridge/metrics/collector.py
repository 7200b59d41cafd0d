"""The metrics of this moment, from the tree of the plant, as families of ``prometheus_client``.

Of a dead bus there is nothing but ``dpstack_bus_up`` 0: its other series end, and with them those of its slaves. No
last value is given out that nobody has confirmed.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.core import Metric as Family

from dpstack.bridge.connector import ConnectorState
from dpstack.bridge.metrics import table
from dpstack.bridge.metrics.health import stream_comes
from dpstack.bridge.metrics.processes import usage_of
from dpstack.bridge.metrics.table import COUNTER, GAUGE, Metric
from dpstack.bridge.names import PROMETHEUS_LABEL, Names, unique_names
from dpstack.monitor.verdict import VERDICTS, Verdict
from dpstack.plant.items import BusValues, Classes
from dpstack.plant.judge import DATA_EXCHANGE, STATES
from dpstack.plant.nodes import Described, Kind, Node, Source
from dpstack.plant.quality import BYTES, FLOAT, TEXT, Quality, Reading, Reason, value_of
from dpstack.plant.tree import Change, NodesChanged, PlantTree
from dpstack.plant.verdicts import Judge
from dpstack.trace import Severity

#: causes of damage of one slave or of the bus: a decoder has 15, and an adapter some of its own
_MOST_CAUSES: Final = 24
_CAUSE: Final = re.compile(r"[a-z][a-z0-9_]{0,30}")
_OTHER: Final = "other"
#: classes of a histogram
_MOST_CLASSES: Final = 64
#: nodes of process data
_PROCESS: Final = (Kind.VALUE, Kind.DRIVE)
_US: Final = 1e6
_MS: Final = 1e3


class Collector:
    """The metrics of ``tree``. ``connectors``: all connectors; ``bus_pid``: process id of the
    bus process, None without one; ``version``: that of dpstack. ``most_values``: process values with series, at most;
    None: they are not published."""

    def __init__(
        self,
        tree: PlantTree,
        *,
        connectors: Callable[[], Sequence[ConnectorState]] = tuple,
        bus_pid: Callable[[], int | None] = lambda: None,
        version: str = "",
        most_values: int | None = None,
    ) -> None:
        #: answers of the server by HTTP status, and connections that it refused
        self.requests: Counter[int] = Counter()
        self.refused = 0
        self._tree = tree
        self._connectors = connectors
        self._bus_pid = bus_pid
        self._version = version
        self._names = Names({}, ())
        self._values = None if most_values is None else ProcessValues(most_values)
        self._judge = Judge(tree)

    def take(self, changes: Sequence[Change]) -> tuple[str, ...]:
        """Take the changes of the tree. Returns a line for each name that was changed for its label, and one if
        there is no room for all process values."""
        self._judge.take(changes)
        if not any(isinstance(one, NodesChanged) for one in changes):
            return ()
        names = self._name_slaves()
        return names if self._values is None else (*names, *self._values.choose(self._tree, self._slave_labels))

    def verdict(self) -> Verdict:
        """The verdict on the bus."""
        return self._judge.judge()[0]

    def _name_slaves(self) -> tuple[str, ...]:
        slaves = self._tree.slaves.items()
        self._names = unique_names(PROMETHEUS_LABEL, ((f"slave {at}", one.name) for at, one in slaves))
        return self._names.changed

    def _slave_labels(self, address: int, described: Described) -> tuple[str, str]:
        name = self._names.names.get(f"slave {address}", described.name)
        return str(address), PROMETHEUS_LABEL.valid(name)

    def families(self) -> list[Family]:
        """All families that have series at this moment, in the order of the table."""
        families = _Families()
        tree = self._tree
        alive = tree.is_alive(None)
        families.add(table.BUS_UP, alive)
        families.add(table.STREAM_UP, stream_comes(tree))
        families.add(table.STREAM_LOST, tree.lost)
        verdict, verdicts = self._judge.judge()
        for one in VERDICTS:
            families.add(table.BUS_VERDICT, one == verdict.level, one)
        if alive:
            self._add_bus(families, tree.bus_values)
            for address, described in tree.slaves.items():
                labels = self._slave_labels(address, described)
                self._add_slave(families, address, labels)
                for one in VERDICTS:
                    families.add(table.SLAVE_VERDICT, one == verdicts[address].level, *labels, one)
                if self._values is not None:
                    self._values.add(families, tree.readings(address))
        if self._values is not None:
            families.add(table.VALUES_LEFT_OUT, self._values.left_out)
        for connector in self._connectors():
            families.add(table.CONNECTOR_UP, connector.serves, connector.name)
            families.add(table.CONNECTOR_CONNECTED, connector.connected, connector.name)
            families.add(table.CONNECTOR_DROPPED, connector.dropped, connector.name)
        for code, count in sorted(self.requests.items()):
            families.add(table.REQUESTS, count, str(code))
        families.add(table.REFUSED, self.refused)
        _add_process(families, "run", os.getpid())
        _add_process(families, "bus", self._bus_pid())
        families.add(table.BUILD, 1, self._version)
        return families.all()

    def _add_bus(self, families: _Families, values: BusValues) -> None:
        plant = self._tree.plant
        about = (PROMETHEUS_LABEL.valid(_text(getattr(plant, key, None))) for key in table.BUS_INFO.labels)
        families.add(table.BUS_INFO, 1, *about)
        for mode in table.MODES:
            families.add(table.BUS_MODE, values.mode == mode, mode)
        families.add(table.BUS_IN_RING, values.in_ring)
        families.add(table.BUS_MASTERS, None if values.masters is None else len(values.masters))
        families.add(table.BUS_CLEAR, values.clear is not None)
        families.add(table.SLAVES, len(self._tree.slaves))
        rotation = None if plant is None or plant.plan is None else plant.plan.rotation_us
        if rotation is not None:
            for case in ("min", "typical", "max"):
                families.add(table.BUS_PLANNED, _scaled(getattr(rotation, case), _US), case)
        histograms = values.histograms or {}
        for key, metric in table.BUS_HISTOGRAMS.items():
            families.add_histogram(metric, histograms.get(key))
        for key, metric in table.BUS_COUNTERS.items():
            families.add(metric, getattr(values, key))
        for cause, count in _causes(values.bad):
            families.add(table.BUS_DAMAGED, count, cause)
        families.add(table.BUS_COUNTERS_AGE, _scaled(values.age_ms, _MS))

    def _add_slave(self, families: _Families, address: int, labels: tuple[str, str]) -> None:
        tree, values = self._tree, self._tree.slave_values(address)
        trouble = tree.trouble(address)
        reason = None if trouble is None else trouble[0]
        state = values.state or "unknown"
        if reason in (Reason.NOT_SENT, Reason.WAITING) or state not in STATES:
            state = "unknown"
        for one in STATES:
            families.add(table.SLAVE_STATE, one == state, *labels, one)
        exchanging = state == DATA_EXCHANGE
        families.add(table.EXCHANGING, exchanging, *labels)
        families.add(table.INPUTS_VALID, trouble is None, *labels)
        if exchanging:
            families.add(table.INPUTS_AGE, _scaled(values.inputs_age_ms, _MS), *labels)
        if state == "unknown":
            return
        families.add(table.WATCHDOG, _scaled(values.watchdog_ms, _MS), *labels)
        families.add(table.FAULT, values.fault is not None, *labels)
        families.add(table.DIAGNOSIS, bool(values.conspicuous), *labels)
        active = Counter(one.level for one in tree.conditions.of(address) if one.active)
        for level in table.LEVELS:
            families.add(table.CONDITIONS, active[Severity(level)], *labels, level)
        for key, metric in table.SLAVE_COUNTERS.items():
            families.add(metric, getattr(values, key), *labels)
        for cause, count in _causes(values.bad):
            families.add(table.SLAVE_DAMAGED, count, *labels, cause)


class ProcessValues:
    """Named values and quantities of drives as series: ``most`` of them, those of the lowest addresses first. Texts and
    octets have none. ``left_out``: the number of the others."""

    def __init__(self, most: int) -> None:
        self.left_out = 0
        self._most = most
        #: by the id of the node
        self._labels: dict[str, tuple[str, ...]] = {}

    def choose(self, tree: PlantTree, slave_labels: Callable[[int, Described], tuple[str, str]]) -> list[str]:
        """Choose the values, as the nodes have changed. Returns lines for people."""
        self._labels, self.left_out, found = {}, 0, list[str]()
        for address, described in tree.slaves.items():
            nodes = [one for one in described.nodes if one.kind in _PROCESS and one.type not in (TEXT, BYTES)]
            room = max(0, self._most - len(self._labels))
            self.left_out += len(nodes[room:])
            labels = slave_labels(address, described)
            for source in Source:
                of_source = [one for one in nodes[:room] if one.source is source]
                names = unique_names(PROMETHEUS_LABEL, [(one.id, one.path[-1]) for one in of_source])
                found += names.changed
                for one in of_source:
                    unit = PROMETHEUS_LABEL.valid(one.unit) if one.unit else ""
                    self._labels[one.id] = (*labels, names.names[one.id], source.value, unit)
        if self.left_out:
            whole = len(self._labels) + self.left_out
            found.append(f"{self.left_out} of {whole} process values have no metrics: give a greater most_values")
        return found

    def add(self, families: _Families, readings: Iterable[tuple[Node, Reading]]) -> None:
        """Add the values of a slave. A number that is not of this moment would look fresh: nobody sees its quality."""
        for node, reading in readings:
            labels = self._labels.get(node.id)
            if labels is not None:
                quality = reading.quality
                families.add(table.VALUE_QUALITY, Quality.BAD.rank - quality.rank, *labels)
                if quality.rank <= Quality.UNCERTAIN.rank:
                    families.add(table.VALUE, reading.value, *labels)


class _Families:
    """Families by metric. A value that is no number is left out."""

    def __init__(self) -> None:
        self._made: dict[str, Any] = {}

    def add(self, metric: Metric, value: object, *labels: str) -> None:
        number = float(value) if isinstance(value, bool) else value_of(value, FLOAT)
        if isinstance(number, float) and (number >= 0 or metric.kind == GAUGE):
            self._family(metric).add_metric(labels, number)

    def add_histogram(self, metric: Metric, given: Classes | None) -> None:
        """Add a histogram as the live stream has it: ``counts`` has one number more than ``limits_us``."""
        if given is None:
            return
        limits, counts = given.limits_us, given.counts
        if len(counts) != len(limits) + 1 or len(limits) > _MOST_CLASSES or limits != sorted(set(limits)):
            return
        buckets, sum_ = [], 0
        for limit, count in zip([*map(_bucket, limits), "+Inf"], counts, strict=True):
            sum_ += count
            buckets.append((limit, sum_))
        self._family(metric).add_metric((), buckets, given.sum_us / _US)

    def all(self) -> list[Family]:
        return [self._made[metric.name] for metric in table.METRICS if metric.name in self._made]

    def _family(self, metric: Metric) -> Any:
        made = self._made.get(metric.name)
        if made is None:
            kinds = {COUNTER: CounterMetricFamily, GAUGE: GaugeMetricFamily}
            made = kinds.get(metric.kind, HistogramMetricFamily)(metric.name, metric.text, labels=metric.labels)
            self._made[metric.name] = made
        return made


def _add_process(families: _Families, process: str, pid: int | None) -> None:
    usage = None if pid is None else usage_of(pid)
    if usage is None:
        return
    families.add(table.CPU, usage.cpu_s, process)
    families.add(table.MEMORY, usage.resident, process)
    families.add(table.OPEN_FDS, usage.open_fds, process)
    families.add(table.MAX_FDS, usage.max_fds, process)
    families.add(table.START, usage.started, process)


def _causes(given: object) -> Iterator[tuple[str, int]]:
    """Counts of damage by cause; those that have no plain name, or are too many, together."""
    found: Counter[str] = Counter()
    for cause, count in _items(given):
        plain = _CAUSE.fullmatch(cause) is not None and len(found) < _MOST_CAUSES
        found[cause if plain else _OTHER] += count
    return iter(found.items())


def _items(given: object) -> Iterable[tuple[str, int]]:
    return sorted(given.items()) if isinstance(given, Mapping) else ()


def _bucket(limit_us: float) -> str:
    """The label ``le``, in seconds."""
    return repr(limit_us / _US)


def _scaled(given: object, divisor: float) -> float | None:
    found = value_of(given, FLOAT)
    return found / divisor if isinstance(found, float) else None


def _text(given: object) -> str:
    return str(given) if isinstance(given, (str, int)) else ""
