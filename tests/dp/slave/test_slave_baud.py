"""A slave that finds its rate, with a real master in virtual time, and by literal octets."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from baud_rig import ANSWER, STATUS, TOKEN, OctetLine
from bus_kit import IDENT, PPO1, setup
from support import MS, S, instance, present

from dpstack.api.config.config import slave_config
from dpstack.api.slave_side.virtual_bench import SimulatedSlave
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.auto_baud import BaudState, BaudStateChanged, PortBaudChanged, SearchingPort, SearchingSlave
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.baud_search import Missing
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.fdl.passive.station import PassiveStation
from dpstack.machine import LineDown, LineUp, RateRefused
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
    searching = slave(3, rates=(1_500_000, 500_000, 187_500))
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
    assert w.run(5 * S, lambda: state_of(searching) is BaudState.CONTROL)
    w.run_for(S)
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


# --- Several slaves on one port that find the rate together, under literal octets -----------------------------------


# Set_Prm of slave 5 (ident 1234h) by master 2: station status 88h is lock and watchdog on (80h: off); WD_Fact 1 and 10
# (100 ms); min T_SDR 55; ident; group 0
SET_PRM = bytes.fromhex("68 0C 0C 68 85 82 7D 3D 3E 88 01 0A 37 12 34 00 0F 16")
SET_PRM_OFF = bytes.fromhex("68 0C 0C 68 85 82 7D 3D 3E 80 00 00 37 12 34 00 FC 16")
SC = b"\xe5"

SILENCE = 266 * 400_000  # (6 + 2 x 130) T_SL of 200 bits at 500 kbit/s, in ns


class Rig(OctetLine):
    """Slaves 5 and 7 on one port; ``lost``: the times at which they lost the rate."""

    def __init__(self, *, rates: tuple[int, ...] = (500_000,), slack_ns: int = 0) -> None:
        params = BusParams.preset(9_600)
        self.apps = [SlaveApp(MirrorDevice(0x1234, b"\x10"), address=address) for address in (5, 7)]
        stations = [PassiveStation(address, app, params) for address, app in zip((5, 7), self.apps, strict=True)]
        self.line = Multidrop(stations, params)
        self.lost: list[int] = []
        self.port = SearchingPort(self.line, self.watched, rates=rates, slack_ns=slack_ns, lost=self.lost.append)
        assert self.port.baud == max(rates)
        super().__init__(self.port)

    def watched(self) -> bool:
        return any(app.watchdog.time_ns for app in self.apps)

    def changes(self) -> list[tuple[BaudState, int | None]]:
        found = [event for event in self.port.take_events() if isinstance(event, PortBaudChanged)]
        return [(event.state, event.baud) for event in found]

    def find(self) -> None:
        for _ in range(3):
            self.hear(TOKEN)


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_all_slaves_answer_once_the_rate_is_found(rig: Rig) -> None:
    rig.hear(STATUS[5])
    rig.hear(b"")
    assert rig.port.state is BaudState.SEARCH
    rig.hear(STATUS[7])
    rig.hear(b"")
    assert rig.sent == []
    assert rig.changes() == [(BaudState.CONTROL, 500_000)]
    assert rig.line.baud == 500_000
    for address in (5, 7):
        rig.hear(STATUS[address])
    rig.hear(b"")
    assert rig.sent == [ANSWER[5], ANSWER[7]]


def test_silence_leads_back_to_the_search_and_to_another_rate() -> None:
    rig = Rig(rates=(500_000, 187_500))
    rig.find()
    rig.hear(b"", SILENCE - MS // 5)
    assert (rig.changes(), rig.lost) == ([(BaudState.CONTROL, 500_000)], [])
    rig.hear(b"", 2 * MS // 5)
    assert (rig.changes(), len(rig.lost)) == ([(BaudState.SEARCH, None)], 1)
    assert rig.port.in_vain(rig.now) is not None
    while rig.port.baud != 187_500:
        rig.hear(b"", MS)
    rig.find()
    assert rig.changes() == [(BaudState.CONTROL, 187_500)]
    assert rig.line.params == BusParams.preset(187_500)
    assert rig.port.in_vain(rig.now) is None


def test_octets_that_are_no_telegrams_and_a_late_port() -> None:
    rig = Rig(slack_ns=50 * MS)
    rig.find()
    rig.hear(b"\x00", SILENCE)
    rig.hear(b"\x00", 49 * MS)
    assert rig.changes() == [(BaudState.CONTROL, 500_000)]
    rig.hear(b"\x00", 2 * MS)
    assert rig.changes() == [(BaudState.SEARCH, None)]


def test_the_watchdog_of_one_slave_keeps_the_rate_of_all(rig: Rig) -> None:
    rig.find()
    rig.hear(SET_PRM)
    rig.hear(b"")
    assert rig.sent == [SC]
    assert rig.changes() == [(BaudState.CONTROL, 500_000), (BaudState.DP_MODE, 500_000)]
    rig.hear(b"", 99 * MS)  # the watchdog's 100 ms, then the silence
    assert rig.changes() == [(BaudState.CONTROL, 500_000)]
    assert rig.apps[0].state is SlaveAppState.WAIT_PRM
    rig.hear(b"", SILENCE - MS)
    assert rig.changes() == []
    rig.hear(b"", 2 * MS)
    assert rig.changes() == [(BaudState.SEARCH, None)]


def test_min_t_sdr_of_set_prm_outlives_a_search(rig: Rig) -> None:
    rig.find()
    rig.hear(SET_PRM_OFF)
    rig.hear(b"", SILENCE + MS)
    assert rig.port.state is BaudState.SEARCH
    assert rig.apps[0].state is SlaveAppState.WAIT_CFG  # no watchdog: it stays where it is
    rig.find()
    rig.sent.clear()
    rig.hear(STATUS[5])
    rig.hear(b"", 109_000)  # 55 bit times are 110 us
    assert rig.sent == []
    rig.hear(b"", 2_000)
    assert rig.sent == [ANSWER[5]]


def test_an_answer_that_waits_when_the_line_goes_is_forgotten(rig: Rig) -> None:
    rig.find()
    rig.hear(STATUS[5])
    rig.port.command(LineDown("unplugged"), rig.now)
    rig.hear(b"", S)
    assert rig.port.state is BaudState.SEARCH
    rig.port.command(LineUp(), rig.now)
    rig.find()
    assert rig.changes()[-1] == (BaudState.CONTROL, 500_000)
    assert rig.sent == []


def test_rates_that_the_port_cannot_do() -> None:
    rig = Rig(rates=(12_000_000, 500_000))
    rig.port.command(RateRefused("too fast"), 0)
    assert rig.port.baud == 500_000
    with pytest.raises(ConfigError, match="none of the rates"):
        rig.port.command(RateRefused("too slow"), 0)
    with pytest.raises(UsageError, match="knows no str"):
        rig.port.command("search", 0)


def test_why_nothing_is_found(rig: Rig) -> None:
    rig.hear(b"", S)
    why = present(rig.port.in_vain(rig.now))
    assert why.why is Missing.SILENCE
    rig.hear(b"\x00\x01")
    why = present(rig.port.in_vain(rig.now))
    assert why.why is Missing.NOISE
