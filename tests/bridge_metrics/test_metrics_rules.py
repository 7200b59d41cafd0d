"""Metrics of given items: hostile names, odd values, a silent stream, states and modes of the product."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from metrics_kit import FINE, Bench, plant, snapshot

from dpstack.api.bus.live import LIMITS_US
from dpstack.api.config.config import parse_config
from dpstack.api.config.connectors import MetricsConfig
from dpstack.bridge.metrics import table
from dpstack.bridge.metrics.health import liveness, readiness
from dpstack.bridge.metrics.processes import usage_of
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState
from dpstack.errors import ConfigError
from dpstack.plant.judge import STATES
from dpstack.plant.tree import SILENT_S

EVIL = 'a"} 1\n\x1b[31mdpstack_bus_up 7\\ \ud800 é'


def labels(address: int, slave: str) -> dict[str, str]:
    return {"address": str(address), "slave": slave}


def test_a_scrape_has_every_metric_of_the_table_and_no_other() -> None:
    bench = Bench(plant("valves"), snapshot(1.0, FINE))
    bench.connector.collector.requests[200] += 1
    seen = bench.scrape()
    assert {
        name: (kind, {frozenset(seen_labels) for seen_labels in seen.labels[name]}) for name, kind in seen.kinds.items()
    } == {one.name: (one.kind, {frozenset(one.labels)}) for one in table.METRICS}
    assert seen("dpstack_connector_up", connector="mqtt") == 0
    assert seen("dpstack_connector_dropped_total", connector="mqtt") == 12
    assert seen.of("dpstack_connector_connected") == {frozenset({("connector", "mqtt")}): 0}
    assert seen("dpstack_bus_counters_age_seconds") == 0.1
    assert seen("dpstack_bus_planned_rotation_seconds", case="max") == 0.003
    assert seen("dpstack_bus_masters") == 2
    assert seen("dpstack_slave_watchdog_seconds", **labels(3, "valves")) == 0.05
    assert seen("dpstack_slave_damaged_total", **labels(3, "valves"), cause="bad_fcs") == 5
    assert [seen("dpstack_bus_rotation_seconds_bucket", le=le) for le in ("1e-05", "2e-05", "5e-05", "+Inf")] == [
        1,
        3,
        6,
        10,
    ]
    assert seen("dpstack_bus_rotation_seconds_sum") == pytest.approx(5e-4)


def test_states_modes_and_limits_are_those_of_the_product() -> None:
    assert [*(state.value for state in SlaveState), "unknown"] == [*STATES]
    assert {mode.name.lower() for mode in Mode} == set(table.MODES)
    assert len(LIMITS_US) <= 64


def test_hostile_and_equal_names_become_labels_that_are_different() -> None:
    bench = Bench(plant(EVIL, "pump", "pump", "x" * 5000), snapshot(1.0, FINE, FINE, FINE, FINE))
    seen = bench.scrape()
    names = {dict(one)["slave"] for one in seen.of("dpstack_slave_exchanges_total")}
    assert len(names) == 4
    assert all(len(name) <= 200 and name.isprintable() for name in names)
    assert {"pump", "pump slave 5"} <= names
    assert seen("dpstack_bus_up") == 1
    assert [line for line in bench.told if "pump slave 5" in line]
    assert all(line.isprintable() for line in bench.told)
    bench.give(2.0, snapshot(2.0, *[FINE | {"state": "fault", "fault": {"kind": "lost", "text": EVIL}}] * 4))
    text = readiness(bench.tree, bench.connector.collector.verdict).text
    assert len(text.splitlines()) == 4
    assert all(line.isprintable() for line in text.splitlines())


def test_causes_and_classes_of_a_hostile_stream_are_bounded() -> None:
    causes = {f"cause_{number}": 1 for number in range(1000)} | {'x"}': 5}
    odd = {"rotation": {"limits_us": [20, 10], "counts": [1, 1, 1]}, "token": {"limits_us": [1], "counts": [1]},
           "host": {"limits_us": list(range(1000)), "counts": [0] * 1001}, "late": None}  # fmt: skip
    seen = Bench(
        plant("valves"), snapshot(1.0, FINE | {"bad": causes}, bad=causes, histograms=odd, mode="fly")
    ).scrape()
    assert len(seen.of("dpstack_bus_damaged_total")) == len(seen.of("dpstack_slave_damaged_total")) == 25
    assert sum(seen.of("dpstack_bus_damaged_total").values()) == 1005
    assert not any("histogram" in kind for kind in seen.kinds.values())
    assert set(seen.of("dpstack_bus_mode").values()) == {0}


@pytest.mark.parametrize("how", ["silent", "stale", "ended", "searching"])
def test_a_bus_that_is_dead_in_any_way_loses_its_series(how: str) -> None:
    bench = Bench(plant("valves"), snapshot(1.0, FINE))
    assert bench.scrape()("dpstack_bus_up") == 1
    if how == "silent":
        bench.give(1.0 + SILENT_S + 0.1)
    elif how == "stale":
        bench.give(1.2, snapshot(1.2, FINE, stale=True))
    elif how == "ended":
        bench.give(1.2, {"end": {"text": "\x1b[31mthe end"}})
    else:
        bench.give(1.2, plant(baud=None), snapshot(1.2))
    seen = bench.scrape()
    assert seen("dpstack_bus_up") == 0
    assert seen("dpstack_stream_up") == (how in ("stale", "searching"))
    assert not seen.has("dpstack_slave_")
    assert not seen.has("dpstack_bus_rotation")
    assert liveness(bench.tree).good == (how in ("stale", "searching"))
    good, text = readiness(bench.tree, bench.connector.collector.verdict)
    assert not good
    assert text.rstrip("\n").isprintable()


def test_a_slave_that_the_stream_does_not_show_any_more_is_unknown() -> None:
    bench = Bench(plant("valves", "pump"), snapshot(1.0, FINE, FINE))
    for step in range(1, 30):
        one = {"t": 1.0 + step / 10, "whole": False, "bus": {"tokens": step}, "slaves": {"3": {"exchanges": step}}}
        bench.give(1.0 + step / 10, {"snapshot": one})
    seen = bench.scrape()
    assert seen("dpstack_slave_state", **labels(4, "pump"), state="unknown") == 1
    assert seen("dpstack_slave_in_data_exchange", **labels(4, "pump")) == 0
    assert {dict(one)["slave"] for one in seen.of("dpstack_slave_exchanges_total")} == {"valves"}
    assert "slave 4 (pump)" in readiness(bench.tree, bench.connector.collector.verdict).text


def test_a_new_configuration_leaves_no_series_of_the_old_one() -> None:
    bench = Bench(plant("valves", "pump", "fan"), snapshot(1.0, FINE, FINE, FINE))
    assert {dict(one)["slave"] for one in bench.scrape().of("dpstack_slave_state")} == {"valves", "pump", "fan"}
    # one gets another name, another one the name of the third, which is gone
    bench.give(1.2, plant("valves 2", "fan"), snapshot(1.2, FINE, FINE))
    seen = bench.scrape()
    assert {frozenset(dict(one).items()) for name, one in seen.series if name == "dpstack_slave_inputs_valid"} == {
        frozenset(labels(3, "valves 2").items()),
        frozenset(labels(4, "fan").items()),
    }
    assert {dict(one).get("slave") for _, one in seen.series} == {None, "valves 2", "fan"}
    assert seen("dpstack_bus_slaves") == 2


def test_the_series_of_a_full_bus_are_bounded() -> None:
    """126 slaves, each with all causes of damage that there can be."""
    busy = FINE | {"bad": {f"cause_{number}": 1 for number in range(100)}}
    slaves = [busy] * 124
    bench = Bench(plant(*(f"slave {number}" for number in range(124))), snapshot(1.0, *slaves))
    seen = bench.scrape()
    assert len(seen.of("dpstack_slave_exchanges_total")) == 124
    assert len(seen.series) < 124 * 55 + 150


def test_a_slave_out_of_service_does_not_count_and_a_reading_run_is_ready_in_the_ring() -> None:
    bench = Bench(plant("valves", "pump"), snapshot(1.0, FINE, FINE | {"state": "deactivated"}))
    assert readiness(bench.tree, bench.connector.collector.verdict) == (
        True,
        "the bus operates; in data exchange: all slaves (1)\n",
    )
    bench = Bench(plant("valves", read_only=True), snapshot(1.0, FINE, mode="stop"))
    assert readiness(bench.tree, bench.connector.collector.verdict).good
    bench.give(1.2, snapshot(1.2, FINE, mode="stop", in_ring=False))
    assert readiness(bench.tree, bench.connector.collector.verdict).text == "the master is not in the token ring\n"


def test_the_usage_of_a_process_is_that_of_the_system() -> None:
    usage = usage_of(os.getpid())
    assert usage is not None
    times = os.times()
    assert usage.cpu_s == pytest.approx(times.user + times.system, abs=0.1)
    assert usage.open_fds == pytest.approx(len(os.listdir("/proc/self/fd")), abs=2)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    assert usage.resident == pytest.approx(pages * os.sysconf("SC_PAGE_SIZE"), rel=0.2)
    assert usage_of(2**22 + 1) is None


def test_the_table_of_the_configuration() -> None:
    bus = '[bus]\nport = "virtual"\nbaud = 500000\n'
    config = parse_config(bus + '[metrics]\nlisten = "[::1]:9999"\n', "plant.toml").connectors["metrics"]
    assert isinstance(config, MetricsConfig)
    assert config.listen == "[::1]:9999"
    default = parse_config(bus + "[metrics]\n", "plant.toml").connectors["metrics"]
    assert isinstance(default, MetricsConfig)
    assert default.listen == "127.0.0.1:9464"
    for wrong in ('listen = "here"', "listen = 9464", 'listen = "127.0.0.1:99999"', 'lisen = "127.0.0.1:1"'):
        with pytest.raises(ConfigError, match="listen"):
            parse_config(f"{bus}[metrics]\n{wrong}\n", "plant.toml")
