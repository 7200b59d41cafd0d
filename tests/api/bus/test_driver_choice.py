"""The choice of the driver: the rule of "auto", and what a bus process cannot do."""

from __future__ import annotations

import os
import sys

import pytest
from api_kit import RAW, bus_of, in_virtual_time

import dpstack
from dpstack.api.bus.driver_choice import driver_for
from dpstack.api.config.config import Config, make_config, parse_config
from dpstack.drivers.realtime import rights as real_time
from dpstack.drivers.realtime.rights import Rights
from dpstack.errors import ConfigError
from dpstack.ports import Delivery, Port, open_port


def config(driver: str | None, port: str = "/dev/ttyUSB7") -> Config:
    return make_config(port, 500_000, bus={"driver": driver})


def uart() -> Port:
    port = open_port("/dev/ttyUSB7", 500_000)
    assert port.delivery is Delivery.ADAPTER
    return port


@pytest.fixture
def rights(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Two processors, and the right to real-time priority."""
    monkeypatch.setattr(real_time, "rights", lambda: Rights(True, None, None))
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})
    return monkeypatch


@pytest.mark.usefixtures("rights")
def test_auto_takes_a_process_for_a_real_line() -> None:
    assert driver_for(config(None), uart()) == "process"
    assert driver_for(config("auto"), uart()) == "process"
    assert driver_for(config("asyncio"), uart()) == "asyncio"


def test_auto_needs_rights_and_a_processor_of_its_own(rights: pytest.MonkeyPatch) -> None:
    rights.setattr(os, "sched_getaffinity", lambda pid: {0})
    assert driver_for(config("auto"), uart()) == "asyncio"
    rights.setattr(os, "sched_getaffinity", lambda pid: {0, 1})
    rights.setattr(real_time, "rights", lambda: Rights(False, 0, None))
    assert driver_for(config("auto"), uart()) == "asyncio"
    assert driver_for(config("process"), uart()) == "process"  # asked for: it says what it was not permitted


def test_a_processor_for_the_bus_process_asks_for_a_bus_process() -> None:
    def with_cpu(driver: str, port: str = "pty") -> Config:
        return make_config(port, 500_000, bus={"driver": driver, "cpu": 1})

    pty = open_port("pty", 500_000)
    assert driver_for(config("auto", "pty"), pty) == "asyncio"
    assert driver_for(with_cpu("auto"), pty) == "process"
    assert driver_for(with_cpu("process"), pty) == "process"
    assert driver_for(with_cpu("auto", "virtual"), None) == "virtual"
    with pytest.raises(
        ConfigError, match=r'cpu is for a bus process: with driver = "asyncio" .*; leave cpu out, or take'
    ):
        driver_for(with_cpu("asyncio"), pty)
    far = "rfc2217://localhost:7000"
    with pytest.raises(ConfigError, match=r"cpu is for a bus process: the port .* needs asyncio; leave cpu out"):
        driver_for(with_cpu("auto", far), open_port(far, 500_000))


@pytest.mark.usefixtures("rights")
@pytest.mark.parametrize("port", ["pty", "socket://localhost:7000", "rfc2217://localhost:7000"])
def test_auto_keeps_asyncio_where_there_is_no_wire_of_ours(port: str) -> None:
    assert driver_for(config("auto", port), open_port(port, 500_000)) == "asyncio"


def test_a_bus_process_that_cannot_be_is_refused_with_advice(rights: pytest.MonkeyPatch) -> None:
    wanted = r'\[bus\]: driver = "process": '
    with pytest.raises(ConfigError, match=wanted + "a simulated bus lives in the program's own process; leave driver"):
        dpstack.open_bus(port="virtual", baud=500_000, driver="process")
    with pytest.raises(ConfigError, match=wanted + "a simulated bus"):
        dpstack.open_bus(world=dpstack.World(referee=False), baud=500_000, driver="process")
    with pytest.raises(ConfigError, match=wanted + "the port rfc2217://localhost:7000 is of a kind that needs asyncio"):
        dpstack.open_bus(port="rfc2217://localhost:7000", baud=500_000, driver="process")
    file = parse_config('[bus]\nport = "virtual"\nbaud = 500000\ndriver = "process"\n', "plant.toml")
    with pytest.raises(ConfigError, match=r"^plant.toml:4: \[bus\]: driver"):
        dpstack.open_bus(file)
    with pytest.raises(ConfigError, match=r"unknown driver 'thread'; it must be "):
        config("thread")
    rights.setattr(sys, "frozen", True, raising=False)
    assert driver_for(config("auto"), uart()) == "asyncio"
    with pytest.raises(ConfigError, match=wanted + "this program is one file without a Python beside it"):
        driver_for(config("process"), uart())
    rights.delattr(sys, "frozen")
    rights.setattr(sys, "platform", "win32")
    with pytest.raises(ConfigError, match=wanted + "the bus process needs Linux, this is win32"):
        driver_for(config("process"), uart())


@in_virtual_time
async def test_the_driver_of_a_simulated_bus_is_called_virtual() -> None:
    async with bus_of(RAW, driver="auto") as bus:
        assert bus.driver == "virtual"
