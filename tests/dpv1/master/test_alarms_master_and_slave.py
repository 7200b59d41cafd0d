"""Alarms between both ends, telegrams lost and damaged: what is acknowledged was delivered once, in order."""

from __future__ import annotations

import contextlib

from bus_kit import IDENT, PPO1, SimBus, setup
from hypothesis import given, note
from hypothesis import strategies as st
from property_kit import examples
from support import wire_log

from dpstack.dp.pdu.alarm_blocks import Alarm, Status
from dpstack.dp.pdu.dpv1_status import ALARMS, Dpv1
from dpstack.dpv1.master.orders import AlarmRaised, StatusTold
from dpstack.dpv1.slave.alarms import AlarmEnd, AlarmServer, AlarmSupport, Raised
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import AlarmError
from dpstack.params import BusParams
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World
from tests.dpv1.master.fault_steps import fault_step

MS = 1_000_000
VENDOR = 32


class Alarming(MirrorDevice):
    """Raises what it is told to; the data of an alarm are its number."""

    def __init__(self, sap: bool) -> None:
        super().__init__(IDENT, PPO1)
        self.alarm_server = self.server = AlarmServer(AlarmSupport(frozenset(ALARMS), 32, sap), 238)
        self.raised: list[Raised] = []

    def raise_(self, kind: int) -> None:
        try:
            self.raised.append(self.server.alarm(Alarm(kind, 1, 1, data=bytes((len(self.raised),)))))
        except AlarmError:
            return  # not in data exchange, or too many


_alarms = st.tuples(st.just("alarm"), st.sampled_from((1, 1, 2, 3, 32, 33)))
_others = st.tuples(
    st.sampled_from(
        ("run", "run", "status", "lose ms1", "lose diag", "damage", "lose all", "noise", "quiet", "line", "off")
    ),
    st.integers(1, 5),
)


def _ms1(sent: Transmission) -> bool:
    return sent.octets[0] == 0x68 and not {50, 51}.isdisjoint(sent.octets[7:9])


def _diag(sent: Transmission) -> bool:
    return sent.octets[0] == 0x68 and 60 in sent.octets[7:9]


@examples(16)
@given(
    st.lists(st.one_of(_alarms, _alarms, _others), min_size=10, max_size=30),
    st.sampled_from((0, 1, 4, 7)),
    st.booleans(),
    st.integers(0, 10_000),
)
def test_delivered_once_and_acknowledged(steps: list[tuple[str, int]], mode: int, sap: bool, seed: int) -> None:
    world = World(seed=seed)
    params = BusParams.preset(187_500, address=2, gap=0)
    device = Alarming(sap)
    dpv1 = Dpv1(alarms=tuple(ALARMS), alarm_mode=mode, c1_response_timeout_ns=60 * MS, extra_alarm_sap=sap)
    bus = SimBus(world, params, [setup(4, dpv1)], devices={4: device})
    events = bus.events
    world.run_for(200 * MS)
    for what, number in steps:
        match what:
            case "alarm":
                device.raise_(number)
            case "status":
                with contextlib.suppress(AlarmError):  # not in data exchange
                    if len(device.server.pending) < 20:
                        device.server.status(Status(1, number))
            case "run":
                world.run_for(number * number * MS)
            case "lose ms1":
                world.faults.drop(_ms1, times=number)
            case "lose diag":
                world.faults.drop(_diag, times=number)
            case _:
                fault_step(world, bus.station, what, number, lambda sent: _ms1(sent) or _diag(sent))
    world.faults.clear()
    end = world.now + 4_000 * MS
    while device.server.pending and world.now < end:
        world.run_for(10 * MS)
    world.run_for(50 * MS)
    note(wire_log(world, 80))
    assert device.server.pending == ()
    delivered = [event.alarm for event in events if isinstance(event, AlarmRaised)]
    numbers = [alarm.data[0] for alarm in delivered]
    assert len(numbers) == len(set(numbers))
    acknowledged = {n for n, one in enumerate(device.raised) if one.end is AlarmEnd.ACKNOWLEDGED}
    assert acknowledged <= set(numbers)
    assert all(device.raised[n].end is not None for n in range(len(device.raised)))
    for kind in (1, 2, 3, VENDOR):  # in sequence mode all of them are one row
        row = [alarm.data[0] for alarm in delivered if mode or min(alarm.type, VENDOR) == kind]
        assert row == sorted(row)
    # without faults again, everything is heard of at once
    bus.until_exchanging(8_000 * MS)  # a slave that stays away is asked once a second
    world.run_for(50 * MS)
    assert bus.exchanging
    before = len(events)
    device.raise_(6)
    device.server.status(Status(1, 9))
    device.server.status(Status(1, 9))
    world.run_for(100 * MS)
    assert device.raised[-1].end is AlarmEnd.ACKNOWLEDGED
    assert [event.alarm.type for event in events[before:] if isinstance(event, AlarmRaised)] == [6]
    assert [event.status.slot for event in events[before:] if isinstance(event, StatusTold)] == [9, 9]
