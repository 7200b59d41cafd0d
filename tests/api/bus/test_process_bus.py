"""A bus in a process of its own on ptys and sockets: the tests that ``test_both_drivers`` has not for both drivers."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from far_ends import eventually, until
from process_kit import (
    LAMPS,
    SPEC,
    UNHURRIED,
    VALVES,
    begun,
    bus_on,
    octet_slaves,
    operating_octets,
    process_of,
)
from support_responder import Responder

import dpstack
from dpstack.api.config.config import make_config
from dpstack.api.lists.parameter_list import ParameterList
from dpstack.api.slave_side.simulation import Segment, Simulation
from dpstack.errors import ConfigError, UsageError

INVERTER: dict[str, object] = {"name": "it", "address": 4, "drive": "imo-hd2"}


def has_exchanged(there: Responder, count: int) -> bool:
    return there.slaves[4].exchanges >= count


async def test_rounds_that_could_not_be_told_are_skipped_ones() -> None:
    """The application's loop stands still until more has piled up than the bus process keeps."""
    wide: dict[str, object] = {"name": "wide", "address": 4, "ident": 0x1234, "config": "5F" * 7}
    with octet_slaves(f"4:1234:{'5f' * 7}:224:0") as (path, there):
        async with bus_on(path, "process", wide) as bus:
            await bus.ready(60)
            read = skipped = first = 0
            async for cycle in bus.cycles():
                read += 1
                if not first:
                    first = cycle.number
                    enough = there.slaves[4].exchanges + 1_500  # of 400 octets each
                    eventually(functools.partial(has_exchanged, there, enough), "many rounds")
                    continue
                skipped += cycle.skipped
                assert cycle.number - first == skipped + read - 1
                if cycle.number - first > 1_500:
                    break
            assert skipped > 1_000


async def test_rate_groups_cyclic_control_and_the_books() -> None:
    lamps = LAMPS | {"every": 3, "groups": [2]}
    fixed = {"cycle_ms": 60.0, "cycle_freeze": [1], "cycle_sync": [1]}
    async with operating_octets("process", VALVES, lamps, **fixed) as (bus, there):
        await until(lambda: there.slaves[4].control in (b"\x08\x01", b"\x20\x01"), "cyclic FREEZE or SYNC")
        numbers: list[int] = []
        fresh: list[frozenset[str]] = []
        async for cycle in bus.cycles():
            numbers.append(cycle.number)
            fresh.append(cycle.fresh)
            if len(numbers) >= 7 and {frozenset({"valves"}), frozenset({"valves", "lamps"})} <= set(fresh):
                break
        assert numbers == sorted(set(numbers))
        # one cycle in three is its turn; when that was left out, a later one before the next turn
        assert sum("lamps" in names for names in fresh) <= (numbers[-1] - numbers[0] + 2) // 3 + 1
        await until(lambda: begun(bus) >= len(numbers), "the books follow the cycles")
        book = bus.stats.cycles
        assert book is not None
        assert book.missed == book.begun_late + book.left_out == sum(book.reasons.values())
        assert book.late.count == book.begun


def held_open(pid: int) -> set[str]:
    """The files that a process has open."""
    folder = Path(f"/proc/{pid}/fd")
    found = set()
    for link in folder.iterdir():
        with contextlib.suppress(OSError):
            found.add(os.readlink(link))
    return found


async def test_a_bus_process_on_its_processor_is_awake_while_a_fixed_cycle_runs() -> None:
    latency = "/dev/cpu_dma_latency"
    cpu = max(os.sched_getaffinity(0))
    async with operating_octets("process", VALVES, cycle_ms=60.0, cpu=cpu) as (bus, _):
        pid = process_of(bus)
        assert os.sched_getaffinity(pid) == {cpu}
        if os.access(latency, os.W_OK):
            await until(lambda: latency in held_open(pid), "the processors are kept awake")
            await bus.stop()
            await until(lambda: latency not in held_open(pid), "they may sleep without a fixed cycle")


async def test_a_bus_process_does_not_begin_on_a_processor_that_is_not_there() -> None:
    with pytest.raises(ConfigError, match="cpu = 8191: processor 8191 is not there"):
        async with operating_octets("process", VALVES, cpu=8191):
            pass


async def test_an_encoder_takes_a_preset(tmp_path: Path) -> None:
    spindle: dict[str, object] = {"name": "spindle", "address": 5, "device": "simodrive-sensor", "telegram": "2.2"}
    spindle["parameters"] = {"Total measuring range (high)": 0, "Total measuring range (low)": 40960}
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        plant = make_config(segment.paths[1], 1_500_000, slaves=[spindle])
        async with Simulation(plant, segment.paths[1], 1_500_000), bus_on(segment.paths[0], "process") as bus:
            await bus.operate()
            await bus.add_slave(spindle)
            slave = bus.slave("spindle")
            await slave.ready(60)
            assert slave.orders == ("preset",)
            assert await slave.order("preset", value=6144, timeout=20) == 6144
            await slave.until(lambda v: v["turns"] == 1.5 and v["degrees"] == 180.0, 20)
            with pytest.raises(UsageError, match=r"40960 is outside 0\.\.40959"):
                await slave.order("preset", value=40960)


async def test_parameters_are_listed_dumped_and_compared(tmp_path: Path) -> None:
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        plant = make_config(segment.paths[1], 1_500_000, slaves=[INVERTER])
        async with Simulation(plant, segment.paths[1], 1_500_000):
            bus = dpstack.open_bus(
                port=segment.paths[0], baud=1_500_000, driver="process", slaves=[INVERTER], **UNHURRIED
            )
            async with bus:
                await bus.operate()
                await bus.ready(20)
                it = bus.drive("it")
                found = await it.dump(tmp_path / "it.toml")
                assert len(found.parameters) == len(it.parameters) > 0
                assert ParameterList.load(tmp_path / "it.toml") == found
                assert not (await it.compare(found)).differences


@contextlib.contextmanager
def octets_on_tcp(*specs: str) -> Iterator[tuple[str, Responder]]:
    """The same slaves behind a TCP connection: ``socket://``."""
    with socket.create_server(("127.0.0.1", 0)) as listener, octet_slaves(*specs) as (_path, _unused):
        responder = Responder("/dev/ptmx", specs)

        def serve() -> None:
            connected, _address = listener.accept()
            with connected:
                os.dup2(connected.fileno(), responder.fd)
            responder.run()

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"socket://127.0.0.1:{listener.getsockname()[1]}", responder
        thread.join(10)
        responder.stop()


async def test_a_socket() -> None:
    with octets_on_tcp(SPEC) as (url, there):
        async with bus_on(url, "process", VALVES) as bus:
            assert bus.driver == "process"
            await bus.ready(20)
            await bus.operate()
            bus.slave(4).outputs = b"\x11\x22"
            await until(lambda: bus.slave(4).inputs == b"\x11\x22", "its mirror")
        await until(lambda: there.slaves[4].control == b"\x02\x00", "Clear")


async def test_a_port_that_vanishes_is_lost_and_back(tmp_path: Path) -> None:
    """The line hangs up under the bus process, and comes back as another pty of the same name."""
    link = tmp_path / "line"
    told: list[str] = []
    with octet_slaves(SPEC) as (second, there):
        with octet_slaves(SPEC) as (first, _gone):
            link.symlink_to(first)
            bus = bus_on(str(link), "process", VALVES, on_event=lambda event: told.append(type(event).__name__))
            await bus.open()
            await bus.ready(60)
            await bus.operate()
            link.unlink()
            link.symlink_to(second)
        try:
            await until(lambda: "PortBack" in told, "the port is back")
            assert told.index("PortLost") < told.index("PortBack")
            await until(lambda: there.slaves[4].exchanges > 3, "data exchange again")
            await asyncio.sleep(0)
            bus.slave(4).outputs = b"\x11\x22"
            await until(lambda: bus.slave(4).inputs == b"\x11\x22", "its mirror")
        finally:
            await bus.close()
