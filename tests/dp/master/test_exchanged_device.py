"""A device put in place of a wrong one, on a wire: the GAP poll that finds it is all that the master waits for."""

from __future__ import annotations

from bus_kit import IDENT, PPO1, SimBus
from slave_kit import make_slave
from support import MS, S, WorldFactory

from dpstack.dp.master.commands import AddSlave
from dpstack.dp.master.events import SlaveFaulted, SlaveState, SlaveStateChanged
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.events import StationFound
from dpstack.params import BusParams


def test_the_right_device_is_taken_up_when_a_gap_poll_has_found_it(world: WorldFactory) -> None:
    params = BusParams.preset(93_750, address=2, hsa=10)
    bus = SimBus(world(), params, [5])
    wrong = make_slave(3, MirrorDevice(0x4321, PPO1), params)
    bus.world.add(wrong)
    bus.send(AddSlave(SlaveParams(address=3, name="s3", ident=IDENT, config=PPO1)))
    bus.world.run_for(16 * S)  # refused after 1, 3, 7 and 15 s: the next time would be at 25 s
    (fault,) = (e.fault for e in bus.events if isinstance(e, SlaveFaulted) and e.address == 3)
    assert "0x4321 instead of 0x1234" in fault.message
    told = [e.state for e in bus.events if isinstance(e, SlaveStateChanged) and e.address == 3]
    assert told == [SlaveState.FAULT]  # the four questions in vain are no changes of state
    bus.world.remove(wrong)
    bus.world.run_for(1 * S)
    bus.events.clear()
    bus.world.add(make_slave(3, MirrorDevice(IDENT, PPO1), params))
    bus.world.run_for(1 * S)
    assert bus.master.handlers[3].state is SlaveState.DATA_EXCHANGE
    found = next(e.t_ns for e in bus.events if isinstance(e, StationFound) and e.address == 3)
    states = [(e.state, e.t_ns) for e in bus.events if isinstance(e, SlaveStateChanged) and e.address == 3]
    assert states[0][0] is SlaveState.SET_PRM
    assert states[0][1] - found < 20 * MS
    assert states[-1][0] is SlaveState.DATA_EXCHANGE
    assert states[-1][1] - found < 50 * MS
