"""``dpstack segment --error-rate 1e-3`` between a master's application and simulated slaves, held against the truth.

The application knows what it wrote, the segment what it damaged, the slaves mirror. Two octets damaged alike could
pass the check sum (docs/reference/bus-parameters.md says how seldom); the seed is fixed, and it does not happen here.
"""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest
from programs import Starter, wait_for_socket

import dpstack
from dpstack.api.control.client import connect

SLAVES = """
[bus]
port = "{port}"
baud = 500000
gap = 0
[[slave]]
name = "left"
address = 5
ident = 0x1234
config = "13 23"
[[slave]]
name = "right"
address = 100
ident = 0x1234
config = "13 23"
"""
#: counters of `bad` that are octets or remarks, not damaged telegrams
NO_TELEGRAMS = {"skipped", "doubtful", "empty_le3"}
#: different inputs of each slave during the noise, at least
ENOUGH = 3


def bad_telegrams(bad: dict[str, int]) -> int:
    return sum(count for cause, count in bad.items() if cause not in NO_TELEGRAMS)


async def exchange(bus: dpstack.Bus, directory: Path, seconds: float) -> None:
    """Outputs change in every turn, every input is looked at, in ``seconds`` of noise and until the slaves are back.

    The noise lasts until each slave gave some inputs, and telegrams of either end were damaged.
    """
    written: dict[str, dict[bytes, int]] = {slave.name: {bytes(4): 0} for slave in bus.slaves}
    seen: dict[str, set[bytes]] = {slave.name: set() for slave in bus.slaves}
    newest = dict.fromkeys(written, 0)
    number = 0
    end = time.monotonic() + seconds
    quiet = 0  # what was written when the noise ended
    while not quiet or min(newest.values()) < quiet:
        if not quiet and time.monotonic() >= end and min(map(len, seen.values())) >= ENOUGH:
            with connect(str(directory)) as segment:
                if all(station["damaged"] for station in segment.call("stats")["stations"]):
                    quiet = number + 1
                    segment.call("noise", "0")
        assert time.monotonic() < end + 90, [(s.name, s.state, s.fault, newest[s.name], quiet) for s in bus.slaves]
        number += 1
        count = number.to_bytes(2, "big")
        for slave in bus.slaves:
            inputs = slave.inputs
            at = written[slave.name][inputs]  # a wrong octet: KeyError
            assert at == 0 or at >= newest[slave.name], "an older input after a newer one"
            newest[slave.name] = max(at, newest[slave.name])
            if not quiet:
                seen[slave.name].add(inputs)
            slave.outputs = count + bytes(slave.address ^ octet for octet in count)
            written[slave.name][slave.outputs] = number
        try:
            await bus.rotated(bus.stats.rotations + 1, 0.05)
        except TimeoutError:  # no slave in data exchange: no rotation
            continue


async def hold_against_the_truth(tmp_path: Path, start: Starter, seconds: float) -> None:
    directory = tmp_path / "bus"
    segment = start("segment", "--dir", str(directory), "--error-rate", "1e-3", "--seed", "11", "--json")
    segment.wait_for(str(directory / "1"))
    config = tmp_path / "plant.toml"
    config.write_text(SLAVES.format(port=directory / "1"), encoding="utf-8")
    sim = start("sim", str(config), "--port", str(directory / "0"), "--json")
    wait_for_socket(directory / "0")  # what is damaged before the slaves listen no slave can count
    with connect(str(directory)) as ctl:  # it is there
        assert ctl.call("status")["error_rate"] == 1e-3
    async with dpstack.open_bus(config) as bus:
        await bus.operate()
        await exchange(bus, directory, seconds)
        stats = bus.stats
        assert all(slave.ready_now for slave in bus.slaves)
    assert sim.end(signal.SIGTERM) == segment.end(signal.SIGTERM) == 0
    slaves, truth = sim.lines[-1], segment.lines[-1]
    answers, requests = truth["stations"]

    # the master: each damaged answer of which anything came is a bad telegram, and each one cost its attempt
    assert answers["damaged"] > 0
    assert bad_telegrams(stats.bad) >= answers["damaged"] - answers["erased"]
    failed = stats.retries + stats.timeouts
    assert answers["damaged"] <= failed
    # ... as does a damaged request, or a damaged token right before one, and an answer this computer kept too long
    too_late = stats.late + sum(slave["too_late"] for slave in slaves["slaves"].values())
    assert failed <= answers["damaged"] + requests["damaged"] + too_late
    # The slaves: where no silence is seen, what is left of one telegram takes the next one with it, so that two damaged
    # ones may be counted as one.
    assert bad_telegrams(slaves["bad"]) * 2 >= requests["damaged"] - requests["erased"] > 0
    assert truth["damaged"] == truth["lost"] + truth["changed"]

    assert sim.err == segment.err == ""


async def test_no_wrong_octet_and_every_damaged_telegram_counted(tmp_path: Path, start: Starter) -> None:
    await hold_against_the_truth(tmp_path, start, 1.0)


@pytest.mark.soak
async def test_a_minute_of_it(tmp_path: Path, start: Starter) -> None:
    await hold_against_the_truth(tmp_path, start, 60.0)
