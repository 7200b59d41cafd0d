"""A slave that finds its rate, with a real master in virtual time, and by literal octets."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from baud_rig import OctetLine
from bus_kit import IDENT, PPO1, setup
from support import MS, S, instance

from dpstack.api.config.config import slave_config
from dpstack.api.slave_side.virtual_bench import SimulatedSlave
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.auto_baud import BaudState, BaudStateChanged, SearchingSlave
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import UsageError
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.passive.station import PassiveStation
from dpstack.machine import LineUp
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event
from dpstack.units import BAUD_RATES


def slave(address: int, rates: Sequence[int] = BAUD_RATES) -> SearchingSlave:
    app = SlaveApp(MirrorDevice(IDENT, PPO1), address=address)
    return SearchingSlave(PassiveStation(address, app, BusParams.preset(max(rates))), app, rates=rates)


def state_of(station: SearchingSlave) -> BaudState:
    return station.state  # a call: mypy takes the state for constant otherwise


def master_at(world: World, baud: int, *addresses: int, watchdog_ms: int = 500) -> tuple[ActiveStation, Master]:
    params = BusParams.preset(baud, address=2, hsa=10)
    master = Master(params, [setup(address) for address in addresses], MasterSettings(watchdog_ms=watchdog_ms))
    station = ActiveStation(params, [master], now=world.now)
    world.add(station, name="master")
    world.command(station, GoOnline())
    world.command(station, SetMode(Mode.OPERATE))
    return station, master


def run_until_exchanging(world: World, master: Master, within_ns: int) -> None:
    handlers = list(master.handlers.values())
    assert world.run(world.now + within_ns, lambda: all(h.state is SlaveState.DATA_EXCHANGE for h in handlers)), [
        handler.state for handler in handlers
    ]


@pytest.mark.parametrize("baud", BAUD_RATES)
def test_two_slaves_find_the_rate_and_are_taken_up(w: World, baud: int) -> None:
    events: list[Event] = []
    slaves = [slave(3), slave(7)]
    for each in slaves:
        w.add(each, on_events=events.extend)
    _, master = master_at(w, baud, 3, 7, watchdog_ms=2000)
    run_until_exchanging(w, master, 40 * S)
    w.run_for(50 * MS if baud > 100_000 else S)
    assert [each.baud for each in slaves] == [baud, baud]
    assert [state_of(each) for each in slaves] == [BaudState.DP_MODE] * 2
    changes = [event for event in events if isinstance(event, BaudStateChanged) and event.address == 3]
    assert [(change.state, change.baud) for change in changes] == [
        (BaudState.CONTROL, baud),
        (BaudState.DP_MODE, baud),
    ]
    assert changes[0].text.startswith("slave 3 (mirror): baud_control at ")


def test_back_to_the_search_when_the_bus_falls_silent_and_to_another_rate(w: World) -> None:
    searching = slave(3)
    w.add(searching)
    station, master = master_at(w, 500_000, 3, watchdog_ms=100)
    run_until_exchanging(w, master, 5 * S)
    w.remove(station)
    w.run_for(50 * MS)
    assert state_of(searching) is BaudState.DP_MODE
    # the watchdog's 100 ms, then the silence of 266 slot times of 400 us
    w.run_for(60 * MS)
    assert searching.app.state is SlaveAppState.WAIT_PRM
    assert state_of(searching) is BaudState.CONTROL
    w.run_for(120 * MS)
    assert state_of(searching) is BaudState.SEARCH
    _, master = master_at(w, 1_500_000, 3)
    run_until_exchanging(w, master, 10 * S)
    assert searching.baud == 1_500_000


def test_without_a_watchdog_it_searches_and_stays_in_data_exchange(w: World) -> None:
    searching = slave(3)
    w.add(searching)
    station, master = master_at(w, 500_000, 3, watchdog_ms=0)
    run_until_exchanging(w, master, 5 * S)
    w.run_for(20 * MS)
    assert state_of(searching) is BaudState.CONTROL
    w.remove(station)
    w.run_for(200 * MS)
    assert state_of(searching) is BaudState.SEARCH
    assert searching.app.state is SlaveAppState.DATA_EXCH


def test_a_slave_that_is_not_asked_keeps_the_rate_as_long_as_others_talk(w: World) -> None:
    searching = slave(9)
    w.add(searching)
    master_at(w, 500_000)
    w.run_for(5 * S)
    assert state_of(searching) is BaudState.CONTROL
    assert searching.baud == 500_000


def test_a_port_that_returns_begins_the_search_anew() -> None:
    station = slave(5, rates=(500_000, 9_600))
    wire = OctetLine(station)
    wire.hear(b"", 30 * MS)
    assert station.baud == 9_600
    station.command(LineUp(), wire.now)
    assert station.baud == 500_000
    with pytest.raises(UsageError):
        station.command("search", wire.now)


def test_a_simulated_drive_finds_those_rates_that_its_device_knows() -> None:
    config = slave_config({"name": "hoist", "address": 3, "drive": "demag-dedrive"})
    station = instance(SimulatedSlave(config, BusParams.preset(500_000), searching=True).on_bus, SearchingSlave)
    heard_at: set[int] = set()
    wire = OctetLine(station)
    for _ in range(5000):
        wire.hear(b"", MS)
        heard_at.add(station.baud)
    assert heard_at == set(BAUD_RATES) - {31_250}
