"""``dpstack.blocking.publish``: connectors that begin before the bus and end after it, or within it."""

from __future__ import annotations

import socket
from typing import Any

import pytest
from far_ends import eventually
from probe_connector import ProbeConnector

import dpstack
from dpstack import blocking
from dpstack.errors import PortError, UsageError
from tests.blocking.blocking_kit import target_of

FAN: dict[str, Any] = {"name": "fan", "address": 4, "drive": "fuji-frenic"}


pytestmark = pytest.mark.usefixtures("probe")


def opened() -> blocking.Bus:
    return blocking.open_bus(port="virtual", baud=500_000, slaves=[FAN])


def test_around_the_bus_and_inside_it() -> None:
    bus = opened()
    with blocking.publish(bus, probe={}) as connectors:
        [connector] = ProbeConnector.made
        assert list(connectors.connectors) == ["probe"]
        assert connector.course[0] == "open"
        assert not target_of(bus).is_open
        with bus:
            bus.ready(60)
            bus.operate()
            eventually(lambda: len(connector.lives) == 2, "births")
            with blocking.publish(bus, probe={}):
                within = ProbeConnector.made[1]
                eventually(lambda: len(within.lives) == 2, "births of the connector within")
            assert within.course[-1] == "close"
            assert bus.is_open
    assert connector.course[2:] == ["last: Died 4, Died None", "close"]
    assert list(connectors.connectors) == []
    assert connectors.remarks == []


def test_what_cannot_begin_is_an_error_before_the_bus_opens() -> None:
    bus = opened()
    with pytest.raises(UsageError, match="takes a bus of the same module"):
        dpstack.publish(bus, probe={})  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="no connector is given"):
        blocking.publish(bus)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        table = {"port": taken.getsockname()[1]}
        with pytest.raises(PortError, match="Address already in use"), blocking.publish(bus, probe=table), bus:
            pytest.fail("the bus was opened")
    assert not bus.is_open


def test_ctrl_c_in_the_block_ends_bus_and_connectors() -> None:
    bus = opened()

    def use() -> None:
        with blocking.publish(bus, probe={}), bus:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        use()
    assert ProbeConnector.made[0].course[-1] == "close"
    assert not target_of(bus).is_open
