"""Scenario files for two simulated slaves, up to the checked steps; an error is a ConfigError of one plain line."""

from __future__ import annotations

from functools import cache

from dpstack.api.config.config import slave_config
from dpstack.api.control.control_server import Handler
from dpstack.api.control.scenario import Scenario, parse_scenario
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.slave_side.virtual_bench import VirtualBench
from dpstack.errors import ConfigError
from dpstack.params import BusParams
from dpstack.sim.world import World
from tests.fuzz.frame import Target, assert_plain, parsed, words


@cache
def _bench() -> tuple[VirtualBench, dict[str, Handler]]:
    bench = VirtualBench(World(), BusParams.preset(500_000))
    bench.add(
        slave_config({"address": 3, "name": "raw", "ident": 0x1234, "config": "20 10", "inputs": {"limit": "bool@0.0"}})
    )
    bench.add(slave_config({"address": 4, "name": "hoist", "drive": "demag-dedrive"}))
    return bench, slave_handlers(bench)


def run(octets: bytes) -> None:
    """The octets are a file."""
    bench, handlers = _bench()
    text = octets.decode("utf-8", "replace")
    found = parsed(lambda _: parse_scenario(text, bench, handlers), b"", ConfigError)
    if found is not None:
        _check(found)


def _check(found: Scenario) -> None:
    assert found.steps == tuple(sorted(found.steps, key=lambda step: step.at_ns))
    assert found.period_ns is None or found.period_ns >= found.end_ns
    for step in found.steps:
        assert step.address in (3, 4)
        assert step.at_ns >= 0
        if step.deed is not None:
            assert_plain(step.deed.text.replace("\n", ""))


def repair(octets: bytes) -> bytes:
    """Let the file begin with a step."""
    return octets if b"[[step]]" in octets else b'[[step]]\nat=1\nslave="raw"\n' + octets


TARGET = Target(
    run,
    covers=(
        "dpstack.api.control.scenario",
        "dpstack.api.slave_side.fault_steps",
        "dpstack.api.slave_side.diagnosis_steps",
        "dpstack.toml.table",
    ),
    max_len=200,
    repair=repair,
    words=words("scenario"),
)
