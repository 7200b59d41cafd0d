"""``scan``, ``diag`` and ``why`` of a run with the word ``unasked``: answers from its own knowledge. The
wire log, to the nanosecond, is the one of a bus that nobody has asked anything."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest
from api_kit import RAW, bench_of, in_virtual_time, operating, slave_in
from support import present

import dpstack
from dpstack.api.control.handlers import control_run
from dpstack.api.slave.station_report import StationReading
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import UsageError
from dpstack.trace import WireEntry

VALVES = {**RAW, "name": "valves", "address": 8, "inputs": {"limit": "bool@0.3"}}


async def ask(bus: dpstack.Bus, *words: str) -> Any:
    """As the socket hands it over."""
    found: Any = control_run(bus, "pty")._handlers[words[0]](list(words[1:]))

    async def ignored(_item: object) -> None: ...

    return await found(ignored) if callable(found) else found


QUESTIONS: list[tuple[str, ...]] = [("scan", "unasked"), ("diag", "8", "unasked"), ("why", "valves", "unasked")]


async def wire_of(questions: list[tuple[str, ...]], *, silent: bool) -> list[WireEntry]:
    """The last telegrams of a plant with their times, of which ``questions`` are asked."""
    async with operating(VALVES, RAW) as bus:
        if silent:
            bench_of(bus).power(8, False)
        await asyncio.sleep(0.2)
        for words in questions:
            await ask(bus, *words)
        await asyncio.sleep(max(0.0, 0.5 - bus.seconds))  # the answer to why waits for the next exchange
        return list(present(bus.world).log)


@pytest.mark.parametrize("silent", [pytest.param(False, marks=pytest.mark.soak, id="healthy"), True])
def test_the_wire_is_the_same_with_and_without_the_questions(silent: bool) -> None:
    without = dpstack.run_virtual(wire_of([], silent=silent))
    assert len(without) == 400
    assert dpstack.run_virtual(wire_of(QUESTIONS, silent=silent)) == without
    # without the word the run asks, and the wire is another one
    assert dpstack.run_virtual(wire_of([words[:-1] for words in QUESTIONS], silent=silent)) != without


@in_virtual_time
async def test_of_a_slave_that_does_not_answer() -> None:
    async with operating(VALVES, RAW) as bus:
        bench_of(bus).power(8, False)
        await asyncio.sleep(0.5)
        found = await ask(bus, "diag", "8", "unasked")
        assert found["findings"] == [
            "does not answer: check power, cable, address switch and the baud rate; "
            "`dpstack scan` lists those who answer"
        ]
        assert (found["answers"], found["healthy"]) == (False, False)
        story = await ask(bus, "why", "valves", "unasked")
        assert story["causes"][0]["cause"] == "not_there"


@in_virtual_time
async def test_the_live_list_has_slaves_strangers_and_nobody_else() -> None:
    async with operating(VALVES, {**RAW, "name": "gone"}) as bus:
        slave_in(present(bus.world), MirrorDevice(0x2222, bytes.fromhex("20 11")), 5)
        bench_of(bus).power(9, False)
        await asyncio.sleep(3)  # GAP polls come to address 5
        found = await ask(bus, "scan", "unasked")
        assert found["stations"] == [
            {"address": 5, "type": "slave", "ident": None, "state": None, "master": None, "config": None, "name": None},
            {
                "address": 8,
                "type": "slave",
                "ident": "0x1234",
                "state": "data_exchange",
                "master": 2,
                "config": "20 10",
                "name": "valves",
            },
        ]
        assert found["notes"] == [
            "as the run knows the bus already: no station was asked for this list",
            "slave 9 of the configuration is offline",
        ]


@in_virtual_time
async def test_the_reading_is_that_of_the_process_image() -> None:
    async with operating({**VALVES, "outputs": {"open": "bool@0.3"}}) as bus:
        bus.slave("valves").outputs = b"\x08"  # the slave mirrors it
        await asyncio.sleep(0.1)
        found = await ask(bus, "diag", "valves", "unasked")
        asked = await ask(bus, "diag", "valves")
        assert {**found, "reading": None} == {**asked, "reading": None}
        reading = msgspec.convert(found["reading"], StationReading)
        assert (reading.config, reading.inputs, reading.outputs) == ("2010", "08", "08")
        assert found["inputs"]["fields"] == {"limit": True}


@in_virtual_time
async def test_of_a_master_that_asks_nobody_no_state_is_claimed() -> None:
    async with operating(VALVES) as bus:
        await bus.stop()
        await asyncio.sleep(0.1)
        found = await ask(bus, "diag", "8", "unasked")
        assert (found["answers"], found["healthy"], found["state"]) == (None, None, None)
        assert found["findings"] == ["its diagnosis is not known: not asked: the master is in stop"]
        listed = await ask(bus, "scan", "unasked")
        assert [(one["address"], one["state"]) for one in listed["stations"]] == [(8, None)]  # of the GAP polls
        assert listed["notes"][1:] == ["slave 8 is not asked now: the master is in stop"]


@in_virtual_time
async def test_another_word_and_another_station_are_refused() -> None:
    async with operating(VALVES) as bus:
        for words in (("scan", "quietly"), ("diag", "8", "quietly"), ("why", "8", "quietly")):
            with pytest.raises(UsageError, match="'quietly': the only word here is unasked, which sends no telegram"):
                await ask(bus, *words)
        with pytest.raises(UsageError, match="station 77 is no slave of this configuration: nothing is known of it"):
            await ask(bus, "diag", "77", "unasked")
