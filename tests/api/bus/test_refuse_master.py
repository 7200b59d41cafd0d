"""The key ``refuse_master``: nothing brings such a slave up; listening, read_only and simulation take it."""

from __future__ import annotations

import pytest
from api_kit import RAW, virtual

import dpstack
from dpstack import ConfigError, Mode
from dpstack.api.config.config import parse_config

WHY = "F modules (PROFIsafe) in slot 1: dpstack is no F-host"
F_SLAVE: dict[str, object] = {
    "name": "gate",
    "address": 14,
    "ident": 0x4321,
    "config": "C0 83 85",
    "refuse_master": WHY,
}
TEXT = f"""
[bus]
port = "virtual"
baud = 500000
[[slave]]
name = "gate"
address = 14
ident = 0x4321
config = "C0 83 85"
refuse_master = "{WHY}"
"""


def test_a_bus_with_it_is_refused_with_file_and_reason() -> None:
    config = parse_config(TEXT, "plant.toml")

    async def program() -> None:
        with pytest.raises(ConfigError) as caught:
            async with dpstack.open_bus(config):
                pass
        assert str(caught.value) == (
            f"plant.toml: slave 14 (gate) must not be brought up by dpstack: {WHY}; listen (monitor), look with "
            "read_only = true, or simulate it (sim); to run the others, take it out"
        )

    virtual(program())


def test_it_is_not_added_to_a_running_bus() -> None:
    async def program() -> None:
        async with dpstack.open_bus(port="virtual", baud=500_000, slaves=[RAW]) as bus:
            with pytest.raises(ConfigError, match="must not be brought up by dpstack: F modules"):
                await bus.add_slave(F_SLAVE)
            await bus.ready()
            assert [slave.name for slave in bus.slaves] == ["raw"]

    virtual(program())


def test_a_read_only_bus_takes_it_and_never_parameterises_it() -> None:
    async def program() -> None:
        world = dpstack.World()
        bench = dpstack.simulate(world, [F_SLAVE])
        async with dpstack.open_bus(parse_config(TEXT), world=world, baud=500_000, read_only=True) as bus:
            await bus.wait_state(Mode.STOP, timeout=5)
            assert bus.slave("gate").name == "gate"
        assert bench is not None

    virtual(program())


def test_an_empty_reason_is_refused() -> None:
    with pytest.raises(ConfigError, match="refuse_master is empty; give it a value or leave it out"):
        parse_config(TEXT.replace(WHY, ""))
