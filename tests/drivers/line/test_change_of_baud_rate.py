"""The driver's port follows the rate that the machine wants."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from far_ends import TcpFarEnd, until

from dpstack.drivers.runtime import PortBack, PortLost
from dpstack.errors import BaudError, ConfigError, PortError
from dpstack.machine import LineDown, LineUp, RateRefused
from dpstack.ports import open_port
from tests.drivers.driver_rig import Rig, Script, driver_on

pytestmark = pytest.mark.usefixtures("each_driver")


class Choosy(Script):
    """Wants one rate after the other as they are refused."""

    def __init__(self, *rates: int) -> None:
        super().__init__()
        self.rates = list(rates)

    @property
    def baud(self) -> int:
        return self.rates[0]

    @baud.setter
    def baud(self, baud: int) -> None:
        self.rates = [baud]

    def command(self, command: object, now: int) -> None:
        super().command(command, now)
        if isinstance(command, RateRefused):
            if len(self.rates) == 1:
                raise ConfigError("none of the rates is left")
            self.rates.pop(0)


def up_to(rig: Rig, limit: int, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The near port refuses rates above ``limit``; returns those it was set to."""
    really: Callable[[int], None] = rig.port.set_baud
    taken: list[int] = []

    def set_baud(baud: int) -> None:
        if baud > limit:
            raise BaudError(f"cannot do {baud}")
        really(baud)
        taken.append(baud)

    monkeypatch.setattr(rig.port, "set_baud", set_baud)
    return taken


async def test_the_port_is_set_without_being_closed() -> None:
    async with Rig() as rig:
        rig.machine.baud = 187_500
        rig.driver.command(b"\xe5")
        assert rig.port.baud == 187_500
        assert rig.far.line_baud() == 187_500
        assert rig.far.read_now() == b"\xe5"
        assert rig.events == []
        assert rig.machine.commands == [b"\xe5"]  # no LineDown, no LineUp


async def test_at_once_when_it_is_opened() -> None:
    rig = Rig()
    rig.machine.baud = 19_200
    async with rig:
        assert rig.port.baud == 19_200


async def test_a_refused_rate_is_reported_and_the_machine_chooses_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig()
    machine = Choosy(500_000)
    rig.driver = driver_on(rig.port, machine, rig.on_events, backoff_ns=(1, 1))
    taken = up_to(rig, 3_000_000, monkeypatch)
    async with rig:
        machine.rates = [12_000_000, 6_000_000, 3_000_000, 9_600]
        rig.driver.command(b"")
        assert taken == [3_000_000]
        assert [order for order in machine.commands if isinstance(order, RateRefused)] == [
            RateRefused("cannot do 12000000"),
            RateRefused("cannot do 6000000"),
        ]


async def test_a_port_without_any_of_the_rates_cannot_be_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig()
    machine = Choosy(12_000_000, 6_000_000)
    rig.driver = driver_on(rig.port, machine, rig.on_events)
    up_to(rig, 500_000, monkeypatch)
    with pytest.raises(ConfigError, match="none of the rates is left"):
        await rig.driver.open()
    assert not rig.port._is_open


async def test_a_port_that_loses_all_its_rates_is_lost_and_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig()
    machine = Choosy(500_000)
    rig.driver = driver_on(rig.port, machine, rig.on_events, backoff_ns=(1, 1))
    async with rig:
        up_to(rig, 500_000, monkeypatch)
        machine.baud = 12_000_000
        rig.driver.command(b"")
        (lost,) = rig.events_of(PortLost)
        assert lost.reason == "none of the rates is left"
        machine.baud = 187_500  # while it is away it is not followed
        await until(lambda: bool(rig.events_of(PortBack)), "the port is back")
        assert rig.port.baud == 187_500
        assert [type(order) for order in machine.commands[-2:]] == [LineDown, LineUp]
        assert rig.driver.failed is None


async def test_a_lost_port_comes_back_at_the_rate_it_could_do() -> None:
    rig = Rig()
    machine = Choosy(500_000)
    rig.driver = driver_on(rig.port, machine, rig.on_events, backoff_ns=(1, 1))
    async with rig:
        rig.port.unplug()
        await until(lambda: bool(rig.events), "the loss")
        machine.baud = 12_000_000
        await rig.settle()
        assert rig.port.baud == 500_000
        rig.port.plug()
        await until(lambda: rig.port.baud == 12_000_000, "the port follows again")


async def test_a_port_whose_rate_cannot_be_changed_says_so() -> None:
    far = TcpFarEnd()
    machine = Script()
    driver = driver_on(open_port(far.path, 9_600), machine, lambda _: None)
    with pytest.raises(PortError, match="keeps the rate it was opened with; give the rate"):
        await driver.open()
    far.shut()
