"""The metrics of a simulated bus in virtual time, read back by the parser of others and held against the wire log."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from api_kit import bench_of, in_virtual_time, slave_in
from far_ends import until
from metrics_kit import Scrape, scrape
from process_kit import SPEC, bus_on, octet_slaves
from process_kit import VALVES as PTY_VALVES
from support import WorldFactory
from wire_truth import truth_of

import dpstack
from dpstack.api.connectors.publishing import Publishing
from dpstack.bridge.metrics.connector import MetricsConnector
from dpstack.bridge.metrics.health import liveness, readiness
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.user_slave import DpSlave

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
