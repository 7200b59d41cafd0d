"""A stall on a simulated bus with a referee: the slaves' watchdogs run out, and nothing old goes out afterwards."""

from __future__ import annotations

import pytest
from bus_kit import SimBus
from support import MS, present

from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import Stalled
from dpstack.dp.slave.events import WatchdogExpired
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event, WireEntry

RUN = bytes(8) + b"\x04\x7f\x40\x00"


def outputs(entries: list[WireEntry], address: int) -> set[bytes]:
    """The data of Data_Exchange (SD2 without SAPs) to ``address``, from the octets on the wire."""
    found = [e.octets for e in entries if e.octets[:1] == b"\x68" and e.octets[4] == address and e.octets[6] & 0x40]
    return {octets[7:-2] for octets in found}


@pytest.mark.parametrize(("away_ms", "clear"), [(900, True), (100, False)])
def test_a_master_that_was_away(away_ms: int, clear: bool) -> None:
    """Nobody runs it for a while, as after SIGSTOP, and everything else goes on."""
    world = World()
    bus = SimBus(world, BusParams.preset(500_000, address=2), [3, 4]).until_exchanging()
    for image in bus.master.images.values():
        image.outputs = RUN
    world.run_for(50 * MS)
    entries: list[WireEntry] = []
    world.log.listener = entries.append
    world.run_for(20 * MS)
    assert outputs(entries, 3) == outputs(entries, 4) == {RUN}
    world.remove(bus.station)
    entries.clear()
    world.run_for(away_ms * MS)
    world.add(bus.station, on_events=bus.events.extend)
    world.run_for(2_000 * MS)
    assert bus.exchanging
    stalls = [event for event in bus.events if isinstance(event, Stalled)]
    if not clear:
        assert (bus.master.mode, stalls) == (Mode.OPERATE, [])
        assert outputs(entries, 3) == outputs(entries, 4) == {RUN}
        return
    assert bus.master.mode is Mode.CLEAR
    assert outputs(entries, 3) == outputs(entries, 4) == {bytes(12)}
    (stall,) = stalls
    assert stall.blocked is None  # nobody told the master
    assert present(stall.gap_ns) >= away_ms * MS
    world.command(bus.station, SetMode(Mode.OPERATE))
    world.run_for(50 * MS)
    assert RUN in outputs(entries, 3) & outputs(entries, 4)
    present(world.referee).check()  # (after a short absence it takes the master that comes back for a second one)


def test_a_slave_says_that_its_watchdog_ran_out() -> None:
    """What the master takes for a stall is what the slave tells."""
    world = World()
    bus = SimBus(world, BusParams.preset(500_000, address=2), [3]).until_exchanging()
    world.remove(bus.station)
    told: list[Event] = []
    world.remove(bus.slaves[3])
    world.add(bus.slaves[3], on_events=told.extend)
    world.run_for(300 * MS)
    assert [type(event) for event in told if isinstance(event, WatchdogExpired)] == [WatchdogExpired]
