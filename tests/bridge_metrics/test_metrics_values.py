"""Metrics of given items: hostile names, odd values, a silent stream, states and modes of the product; classes of a
histogram with fixed limits. Those of a simulated bus, read back by the parser of others and held against the wire
log."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from collections.abc import AsyncIterator
from itertools import accumulate
from pathlib import Path
from typing import Any

import pytest
from api_kit import bench_of, in_virtual_time, slave_in
from far_ends import until
from hypothesis import given
from hypothesis import strategies as st
from metrics_kit import BUS, FINE, LEVEL, Bench, Scrape, plant, scrape, snapshot
from process_kit import SPEC, bus_on, octet_slaves
from process_kit import VALVES as PTY_VALVES
from rack_kit import LINE_BREAK, device, rack
from support import WorldFactory
from wire_truth import truth_of

import dpstack
from dpstack.api.bus.live import LIMITS_US
from dpstack.api.config.config import parse_config
from dpstack.api.config.connectors import MetricsConfig
from dpstack.api.connectors.publishing import Publishing
from dpstack.bridge.metrics import table
from dpstack.bridge.metrics.connector import MetricsConnector
from dpstack.bridge.metrics.health import liveness, readiness
from dpstack.bridge.metrics.processes import usage_of
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import ConfigError
from dpstack.plant.judge import STATES
from dpstack.plant.tree import SILENT_S
from dpstack.slave import UserDiag
from dpstack.stats import Histogram

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
    assert (config.listen, config.values, config.most_values) == ("[::1]:9999", False, 2000)
    many = parse_config(bus + "[metrics]\nvalues = true\nmost_values = 10000\n", "plant.toml").connectors["metrics"]
    assert isinstance(many, MetricsConfig)
    assert (many.values, many.most_values) == (True, 10_000)
    for wrong in ("most_values = 0", "most_values = 10001", "values = 1"):
        with pytest.raises(ConfigError, match="values"):
            parse_config(f"{bus}[metrics]\n{wrong}\n", "plant.toml")
    default = parse_config(bus + "[metrics]\n", "plant.toml").connectors["metrics"]
    assert isinstance(default, MetricsConfig)
    assert default.listen == "127.0.0.1:9464"
    for wrong in ('listen = "here"', "listen = 9464", 'listen = "127.0.0.1:99999"', 'lisen = "127.0.0.1:1"'):
        with pytest.raises(ConfigError, match="listen"):
            parse_config(f"{bus}[metrics]\n{wrong}\n", "plant.toml")


LIMITS_NS = [10_000, 20_000, 50_000, 1_000_000, 5_000_000_000]
#: a bucket of 128 ns holds each of these limits
_durations = st.one_of(
    st.integers(0, 10**10), st.sampled_from(LIMITS_NS).flatmap(lambda limit: st.integers(limit - 200, limit + 200))
)


@given(st.lists(_durations, min_size=1, max_size=40))
def test_cumulated_counts_and_sum_only_grow_and_are_right_to_a_bucket(durations: list[int]) -> None:
    histogram, before, sum_before = Histogram(), [0] * (len(LIMITS_NS) + 1), 0
    for seen, ns in enumerate(durations, 1):
        histogram.add(ns)
        counts, total = histogram.in_classes(LIMITS_NS)
        now = list(accumulate(counts))
        assert now[-1] == seen
        assert all(old <= new for old, new in zip(before, now, strict=True))
        assert total >= sum_before
        before, sum_before = now, total
        for limit, count in zip(LIMITS_NS, now, strict=False):
            # the limit itself counts to it, and what is 0.4 % above it may
            assert sum(one <= limit for one in durations[:seen]) <= count
            assert count <= sum(one <= limit * 1.004 for one in durations[:seen])
    assert abs(sum_before - sum(durations)) <= 0.004 * sum(durations)


def test_a_new_maximum_moves_no_earlier_count() -> None:
    """20 000 ns lies in the bucket of 19 968 to 20 031 ns: its middle is above the limit, its first maximum below."""
    histogram = Histogram()
    histogram.add(19_970)
    first, _ = histogram.in_classes([20_000])
    histogram.add(900_000)
    assert (first, histogram.in_classes([20_000])[0]) == ([1, 0], [1, 1])


def test_process_values_and_their_quality_by_name_direction_and_unit() -> None:
    slaves = {
        "3": {
            "name": "tank",
            "inputs": [
                LEVEL,
                {"name": "full", "type": "bool", "at": "bool@4.0"},
                {"name": "id", "type": "bytes", "at": "bytes2@5"},
            ],
            "outputs": [{"name": "heat", "type": "i16", "at": "i16@0", "scale": 0.5, "unit": "K"}],
        },
        "4": {"name": "fan", "drive": {"profile": "vik-namur"}, "inputs": [LEVEL | {"name": "speed"}]},
    }
    tank = FINE | {"fields": {"level": 12.5, "full": True, "id": "0102", "heat": -20.5}}
    fan = FINE | {
        "fields": {"speed": 0.0},
        "drive": {"state": "running", "running": True, "speed": 0.25, "frequency_hz": 12.5},
    }
    bench = Bench(plant() | {"plant": plant()["plant"] | {"slaves": slaves}}, snapshot(1.0, tank, fan))

    def values() -> dict[tuple[str, ...], tuple[float | None, float]]:
        """Value and quality by slave, value, direction, unit."""
        seen, found = bench.scrape(), {}
        for labels, quality in seen.of("dpstack_slave_value_quality").items():
            key = tuple(dict(labels)[name] for name in ("slave", "value", "direction", "unit"))
            found[key] = seen.of("dpstack_slave_value").get(labels), quality
        assert seen.of("dpstack_slave_value").keys() <= seen.of("dpstack_slave_value_quality").keys()
        return found

    level, heat = ("tank", "level", "input", "bar"), ("tank", "heat", "output", "K")
    found = values()
    assert {key[1] for key in found if key[0] == "tank"} == {"level", "full", "heat"}
    assert [found[key] for key in (level, ("tank", "full", "input", ""), heat)] == [(12.5, 3), (1, 3), (-20.5, 3)]
    of_fan = [("fan", "speed", "input", "bar"), ("fan", "speed", "drive", ""), ("fan", "frequency_hz", "drive", "Hz")]
    assert [found[key] for key in of_fan] == [(0, 3), (0.25, 3), (12.5, 3)]
    broken = {"quality": "bad", "reason": "channel_fault", "text": "line break: slot 3, input channel 0"}
    limit = {"quality": "uncertain", "reason": "channel_limit", "text": "lower limit value exceeded: slot 2"}
    bench.give(1.2, snapshot(1.2, tank | {"qualities": {"level": broken, "heat": limit}}, fan))
    assert [values()[key] for key in (level, heat)] == [(None, 0), (-20.5, 2)]
    # a slave that is lost: no old number looks fresh
    bench.give(1.4, snapshot(1.4, tank | {"state": "offline"}, fan))
    assert [values()[key] for key in (level, heat, of_fan[1])] == [(None, 1), (None, 1), (0.25, 3)]
    nan = FINE | {"fields": {"level": None}}
    bench.give(1.6, snapshot(1.6, nan, fan))
    assert values()[level] == (None, 0)


def test_the_number_of_process_values_is_bounded_and_the_rest_is_reported() -> None:
    inputs = [LEVEL | {"name": f"v{number}"} for number in range(32)]
    slaves = {str(address): {"name": f"rack {address}", "inputs": inputs} for address in range(1, 11)}
    values = FINE | {"fields": {f"v{number}": number for number in range(32)}}
    items = (
        {"plant": plant()["plant"] | {"slaves": slaves}},
        {"snapshot": {"t": 1.0, "whole": True, "bus": BUS, "slaves": dict.fromkeys(slaves, values)}},
    )
    bench = Bench(*items, most_values=100)
    seen = bench.scrape()
    assert len(seen.of("dpstack_slave_value")) == len(seen.of("dpstack_slave_value_quality")) == 100
    assert seen("dpstack_metrics_values_left_out") == 220
    assert {dict(labels)["address"] for labels in seen.of("dpstack_slave_value")} == {"1", "2", "3", "4"}
    assert bench.told == ["220 of 320 process values have no metrics: give a greater most_values"]
    bench = Bench(*items, most_values=None)
    assert not bench.scrape().has("dpstack_slave_value")
    assert not bench.scrape().has("dpstack_metrics_values")
    assert bench.told == []


@in_virtual_time
async def test_a_broken_wire_takes_its_number_out_of_the_metrics() -> None:
    async with rack() as (bus, slave, served):
        table = {"listen": "127.0.0.1:0", "values": True}
        async with dpstack.publish(bus, metrics=table) as publishing:
            connector = connector_of(publishing)
            level = {"address": "9", "slave": slave.name, "value": "level", "direction": "input", "unit": ""}
            slave["setpoint"] = 77  # its inputs mirror the outputs: the level
            seen = await settled(connector)
            assert (seen("dpstack_slave_value", **level), seen("dpstack_slave_value_quality", **level)) == (77, 3)
            device(served).diag = UserDiag.of(LINE_BREAK)
            seen = await settled(connector)
            assert frozenset(level.items()) not in seen.of("dpstack_slave_value")
            assert seen("dpstack_slave_value_quality", **level) == 0
            assert seen("dpstack_slave_value", **level | {"value": "flow"}) == 0
            assert seen("dpstack_slave_conditions_active", address="9", slave=slave.name, level="error") == 1
            device(served).diag = UserDiag()
            seen = await settled(connector)
            assert (seen("dpstack_slave_value", **level), seen("dpstack_slave_value_quality", **level)) == (77, 3)


VALVES: dict[str, Any] = {"name": "valves", "address": 9, "ident": 0x1234, "config": "21 11"}
DESCRIPTION = SlaveDescription(ident=0x1234, configs=(bytes.fromhex("21 11"),))
NINE = {"address": "9", "slave": "valves"}


def connector_of(publishing: Publishing) -> MetricsConnector:
    [connector] = publishing._connectors
    assert isinstance(connector, MetricsConnector)
    return connector


@contextlib.asynccontextmanager
async def published(bus: dpstack.Bus) -> AsyncIterator[MetricsConnector]:
    async with bus, dpstack.publish(bus, metrics={"listen": "127.0.0.1:0"}) as publishing:
        yield connector_of(publishing)


async def settled(connector: MetricsConnector) -> Scrape:
    """A scrape behind the next counters, which the stream brings once a second."""
    await asyncio.sleep(1.3)
    return await scrape(connector)


@in_virtual_time
async def test_counters_and_histograms_are_those_of_the_wire(world: WorldFactory) -> None:
    here = world(keep=1_000_000)
    station, _ = slave_in(here, DpSlave(DESCRIPTION, lambda outputs, elapsed: outputs), 9)
    # no watchdog, and 15 repetitions: it stays in data exchange while it is silent for a moment
    bus = dpstack.open_bus(port="virtual", baud=500_000, max_retry=7, slaves=[VALVES], world=here)
    async with published(bus) as connector:
        await bus.operate()
        await bus.ready()
        before = await settled(connector)
        assert before("dpstack_slave_retries_total", **NINE) == 0
        here.silence(station, 2_000_000)
        await asyncio.sleep(0.5)
        await bus.stop()
        seen = await settled(connector)
        truth = truth_of(here.log)
        assert seen("dpstack_slave_retries_total", **NINE) == truth.repetitions[9] + truth.repeated_polls[9] > 0
        assert seen("dpstack_bus_retries_total") == truth.repetitions[9] + truth.repeated_polls[9]
        # without the polls of the GAP, Request FDL Status, which are no requests of the DP master
        polls = sum(entry.octets[:4] == bytes.fromhex("10 09 02 49") for entry in here.log)
        counted = truth.requests[9] + truth.answers[9] - 2 * polls
        assert seen("dpstack_slave_telegrams_total", **NINE) == counted
        # tokens go on in Stop: of all telegrams until the last counters
        assert 0 <= truth.telegrams - seen("dpstack_bus_telegrams_total") < 0.1 * truth.telegrams
        rotations = seen("dpstack_bus_rotation_seconds_count")
        assert rotations == seen("dpstack_bus_rotation_seconds_bucket", le="+Inf") > 100
        assert rotations <= truth.answers[9]
        buckets = [
            (float(dict(labels)["le"]), count)
            for labels, count in seen.of("dpstack_bus_rotation_seconds_bucket").items()
        ]
        counts = [count for _, count in sorted(buckets)]
        assert counts == sorted(counts)
        # the mean of a rotation is that of the wire: about 2.5 s of rounds
        mean = seen("dpstack_bus_rotation_seconds_sum") / rotations
        assert seen("dpstack_bus_planned_rotation_seconds", case="min") <= mean
        assert mean <= seen("dpstack_bus_planned_rotation_seconds", case="max")


@in_virtual_time
async def test_a_slave_that_goes_has_no_value_that_looks_fresh() -> None:
    bus = dpstack.open_bus(port="virtual", baud=500_000, slaves=[VALVES])
    async with published(bus) as connector:
        await bus.operate()
        await bus.ready()
        seen = await settled(connector)
        assert seen("dpstack_bus_up") == seen("dpstack_stream_up") == 1
        assert seen("dpstack_bus_mode", mode="operate") == 1
        assert seen("dpstack_slave_state", **NINE, state="data_exchange") == 1
        assert sum(seen.of("dpstack_slave_state").values()) == 1
        assert seen("dpstack_slave_in_data_exchange", **NINE) == seen("dpstack_slave_inputs_valid", **NINE) == 1
        assert seen("dpstack_slave_inputs_age_seconds", **NINE) < 0.1
        assert readiness(connector.tree, connector.collector.verdict) == (
            True,
            "the bus operates; in data exchange: all slaves (1)\n",
        )
        bench_of(bus).power(9, False)
        seen = await settled(connector)
        assert seen("dpstack_bus_up") == 1
        assert seen("dpstack_slave_in_data_exchange", **NINE) == seen("dpstack_slave_inputs_valid", **NINE) == 0
        assert seen("dpstack_slave_state", **NINE, state="data_exchange") == 0
        assert seen("dpstack_slave_fault", **NINE) == 1
        assert seen("dpstack_slave_conditions_active", **NINE, level="error") == 1
        assert not seen.has("dpstack_slave_inputs_age")
        assert seen("dpstack_slave_timeouts_total", **NINE) > 0
        assert liveness(connector.tree).good
        good, text = readiness(connector.tree, connector.collector.verdict)
        assert not good
        assert text.startswith("slave 9 (valves) is not in data exchange: ")
        await bus.clear()
        await asyncio.sleep(0.5)
        assert "the master is in clear, not in operate\n" in readiness(connector.tree, connector.collector.verdict).text


async def test_a_bus_process_has_its_own_metrics_and_its_death_is_told() -> None:
    with octet_slaves(SPEC) as (path, _):
        bus = bus_on(path, "process", PTY_VALVES)
        async with dpstack.publish(bus, metrics={"listen": "127.0.0.1:0"}) as publishing:
            connector = connector_of(publishing)
            assert liveness(connector.tree) == (False, "the bus is not open yet\n")
            async with bus:
                await bus.ready(60)
                await until(lambda: connector.tree.is_alive(None), "the birth of the bus")
                pid = connector.collector._bus_pid()
                assert pid is not None
                seen = await scrape(connector)
                for process, one in (("run", os.getpid()), ("bus", pid)):
                    assert seen("dpstack_process_open_fds", process=process) > 2
                    stat = Path(f"/proc/{one}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
                    cpu = seen("dpstack_process_cpu_seconds_total", process=process)
                    assert cpu == pytest.approx((int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK"), abs=0.2)
                starts = seen.of("dpstack_process_start_time_seconds")
                assert starts[frozenset({("process", "run")})] < starts[frozenset({("process", "bus")})]
                os.kill(pid, signal.SIGKILL)
                await until(lambda: not connector.tree.is_alive(None), "the death of the bus")
                seen = await scrape(connector)
                assert seen("dpstack_bus_up") == 0
                assert {dict(one)["process"] for one in seen.of("dpstack_process_open_fds")} == {"run"}
                assert liveness(connector.tree).text.startswith("a fault has ended the bus: the bus process was killed")
                assert seen("dpstack_bus_verdict", verdict="critical") == 1


@in_virtual_time
async def test_of_a_dead_bus_nothing_but_its_death_is_left() -> None:
    bus = dpstack.open_bus(port="virtual", baud=500_000, slaves=[VALVES])
    publishing = dpstack.publish(bus, metrics={"listen": "127.0.0.1:0"})
    async with publishing:
        connector = connector_of(publishing)
        assert not liveness(connector.tree).good
        assert not readiness(connector.tree, connector.collector.verdict).good
        async with bus:
            await bus.operate()
            await bus.ready()
            assert (await settled(connector)).has("dpstack_slave_exchanges")
        await asyncio.sleep(0.1)
        seen = await scrape(connector)
        assert seen("dpstack_bus_up") == seen("dpstack_stream_up") == 0
        assert seen("dpstack_connector_up", connector="metrics") == 1, "it ends with the run, and not by a fault"
        assert not seen.has("dpstack_slave_")
        assert {name for name, _ in seen.series if name.startswith("dpstack_bus_")} == {
            "dpstack_bus_up",
            "dpstack_bus_verdict",
        }
        assert seen("dpstack_bus_verdict", verdict="unknown") == 1
        assert liveness(connector.tree).text.startswith("the bus has ended")
        assert readiness(connector.tree, connector.collector.verdict).text.startswith("the bus has ended")
