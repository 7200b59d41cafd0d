"""The command ``scan`` of a run: the live list with identifier octets, beside data exchange that goes on."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

import pytest
from api_kit import HOIST, RAW, begun, cancelled, operating, slave_in
from support import present

import dpstack
from dpstack.api.config.config import make_config
from dpstack.api.control.commands import KINDS
from dpstack.api.control.handlers import control_run
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import UsageError

pytestmark = pytest.mark.virtual_time


async def ignored(_item: object) -> None:
    """A client that reads no items."""


def scan(bus: dpstack.Bus, send: Any = ignored) -> Coroutine[Any, Any, Any]:
    """As the socket hands it over."""
    server = control_run(bus, "pty")
    assert "scan" in {spec.name for spec in KINDS["run"]}
    command: Any = server._handlers["scan"]([])
    result: Coroutine[Any, Any, Any] = command(send)
    return result


async def test_a_scan_beside_data_exchange() -> None:
    items: list[Any] = []

    async def send(item: object) -> None:
        items.append(repr(item))

    async with operating(RAW, {**HOIST, "watchdog_ms": 50}) as bus:
        world = present(bus.world)
        slave_in(world, MirrorDevice(0x2222, bytes.fromhex("20 11")), 77)
        bus.slave("raw").outputs = b"\x5a"
        await asyncio.sleep(0.1)
        before = {slave.name: slave.exchanges for slave in bus.slaves}
        result = await scan(bus, send)
        assert result == {
            "baud": 500_000,
            "address": 2,
            "stations": [
                {
                    "address": 3,
                    "type": "slave",
                    "ident": "0x0696",
                    "state": "data_exchange",
                    "master": 2,
                    "config": "F3 71",
                    "name": "hoist",
                },
                {
                    "address": 9,
                    "type": "slave",
                    "ident": "0x1234",
                    "state": "data_exchange",
                    "master": 2,
                    "config": "20 10",
                    "name": "raw",
                },
                {
                    "address": 77,
                    "type": "slave",
                    "ident": "0x2222",
                    "state": "wait_prm",
                    "master": None,
                    "config": "20 11",
                    "name": None,
                },
            ],
            "unreadable": [],
            "notes": [],
        }
        for slave in bus.slaves:
            assert slave.ready_now
            assert slave.exchanges > before[slave.name] + 100
            assert (slave.timeouts, slave.retries) == (0, 0)
        assert bus.slave("raw").inputs == b"\x5a"
        assert items[0].startswith("{'progress': ['addresses', ")
        await scan(bus)  # and another one


async def test_one_scan_at_a_time() -> None:
    async with operating(RAW) as bus:
        server = control_run(bus, "pty")
        command: Any = server._handlers["scan"]
        first = await begun(command([])(ignored), 0)
        with pytest.raises(UsageError, match="under way"):
            await command([])(ignored)
        await cancelled(first)  # its client has gone
        assert len((await command([])(ignored))["stations"]) == 1


async def test_a_scan_of_a_read_only_run_changes_no_slave() -> None:
    async with operating(RAW) as owner:
        world = present(owner.world)
        slave_in(world, MirrorDevice(0x2222, b"\x21"), 4)
        config = make_config("virtual", 500_000, 5, [RAW], bus={"read_only": True})
        async with dpstack.open_bus(config, world=world) as bus:
            result = await scan(bus)
        found = {
            one["address"]: (one["type"], one["state"], one["master"], one["config"]) for one in result["stations"]
        }
        assert found == {
            2: ("master_in_ring", None, None, None),
            4: ("slave", "wait_prm", None, "21"),
            9: ("slave", "data_exchange", 2, "20 10"),
        }
        assert owner.slave("raw").ready_now
        assert owner.slave("raw").timeouts == 0
