"""Whatever is lost on the wire: every alarm is delivered once, in order, and acknowledged."""

from __future__ import annotations

import contextlib

from alarm_kit import ALL, MS, AlarmBus, block, refusing
from bus_kit import IDENT, PPO1
from hypothesis import given, note
from hypothesis import strategies as st
from property_kit import examples
from support import wire_log

from dpstack.dp.acyclic import Acyclic
from dpstack.dp.dp_slave import DpSlave
from dpstack.dp.master import Master
from dpstack.dp.setup import SlaveSetup
from dpstack.dp.slave_description import SlaveDescription
from dpstack.dp.slaveapp import make_slave
from dpstack.dp.v1.alarm_events import AlarmRaised
from dpstack.dp.v1.alarm_server import AlarmEnd, Raised
from dpstack.dp.v1.alarms import Alarm
from dpstack.dp.v1.status import Dpv1
from dpstack.errors import AlarmError
from dpstack.fdl.active import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World
from dpstack.trace import Event

_KINDS = st.sampled_from([1, 2, 3, 4, 5, 6, 32, 126])
#: few slots and data, so that equal ones follow each other often
_ALARMS = st.lists(st.tuples(_KINDS, st.integers(0, 1), st.integers(0, 3), st.sampled_from(["", "00"])), max_size=8)
_LOSSES = st.lists(st.sampled_from(["", "", "", "r", "a"]), max_size=60)
_MODES = st.sampled_from([(0, 0), (1, 2), (3, 8), (7, 32)])


@examples(25)
@given(
    _MODES, _ALARMS, _LOSSES, st.integers(-1, 5), st.booleans(), st.booleans(), st.lists(st.integers(0, 9), max_size=8)
)
def test_with_loss(
    mode: tuple[int, int],
    alarms: list[tuple[int, int, int, str]],
    losses: list[str],
    polls: int,
    refuses: bool,
    offers_again: bool,
    pauses: list[int],
) -> None:
    number, limit = mode
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, alarm_mode=number, c1_response_timeout_ns=20_000_000))
    slave = kit.alarm_slave
    slave.at_a_time, slave.polls = limit, polls
    slave.offers_again = offers_again
    if refuses:
        slave.on_stray = refusing("B0")
    left = list(losses)
    slave.loses = lambda: left.pop(0) if left else ""
    blocks = [
        block(kind, slot, specifier, at % 32 if limit else 0, data)
        for at, (kind, slot, specifier, data) in enumerate(alarms)
    ]
    waits = list(pauses)
    for entry in blocks:
        slave.raises(entry)
        kit.run(waits.pop(0) if waits else 0)
    note(f"{[entry.hex(' ') for entry in blocks]}")
    kit.until(lambda: len(slave.taken) == len(blocks))
    kit.run(500)
    assert kit.blocks == blocks
    assert sorted(slave.taken) == sorted(blocks)
    assert not slave.open
    assert sorted(end.number for end in kit.ends if end.outcome.failure is None) == [*range(1, len(blocks) + 1)]


_steps = st.one_of(
    st.tuples(st.just("raise"), st.sampled_from([1, 2, 3, 32])),
    st.tuples(st.just("raise"), st.sampled_from([1, 2, 3, 32])),
    st.tuples(st.just("run"), st.integers(1, 60)),
    st.tuples(st.sampled_from(("lose", "damage", "lose all", "noise", "quiet")), st.integers(1, 4)),
)


def _ms1(sent: Transmission) -> bool:
    return sent.octets[0] == 0x68 and 51 in sent.octets[7:9]


@examples(12)
@given(st.lists(_steps, max_size=25), st.sampled_from((0, 3)), st.integers(0, 10_000))
def test_both_ends_with_loss(steps: list[tuple[str, int]], mode: int, seed: int) -> None:
    world = World(seed=seed)
    params = BusParams.preset(187_500, address=2, gap=0)
    description = SlaveDescription(ident=IDENT, configs=(PPO1,), dpv1=True, alarms=ALL, alarm_sequence=8)
    device = DpSlave(description, lambda outputs, elapsed: bytes(12))
    server = device.alarm_server
    assert server is not None
    world.add(make_slave(3, device, params))
    dpv1 = Dpv1(alarms=ALL, alarm_mode=mode, c1_response_timeout_ns=30 * MS)
    setup = SlaveSetup(address=3, name="s3", ident=IDENT, config=PPO1, user_prm=bytes(3), dpv1=dpv1)
    master = Master(params, [setup])
    station = ActiveStation(params, [master, Acyclic(2, master)], now=world.now)
    events: list[Event] = []
    world.add(station, on_events=events.extend)
    world.command(station, GoOnline())
    world.run_for(200 * MS)
    raised: list[Raised] = []
    for what, number in steps:
        match what:
            case "raise":
                with contextlib.suppress(AlarmError):  # not in data exchange
                    raised.append(server.alarm(Alarm(number, 1, data=bytes((len(raised),)))))
            case "run":
                world.run_for(number * MS)
            case "lose":
                world.faults.drop(_ms1, times=number)
            case "damage":
                world.faults.damage(_ms1, times=number)
            case "lose all":
                world.faults.drop(lambda sent: len(sent.octets) > 3, times=number)
            case "noise":
                world.faults.noise(number * 1e-4)
            case "quiet":
                world.faults.noise(0)
    world.faults.noise(0)
    end = world.now + 10_000 * MS
    while not all(alarm.end for alarm in raised) and world.now < end:
        world.run_for(10 * MS)
    note(wire_log(world, 80))
    delivered = [event.alarm.data[0] for event in events if isinstance(event, AlarmRaised)]
    assert len(set(delivered)) == len(delivered)
    acknowledged = {at for at, alarm in enumerate(raised) if alarm.end is AlarmEnd.ACKNOWLEDGED}
    assert acknowledged <= set(delivered)
    assert all(alarm.end for alarm in raised)
    if mode:
        assert delivered == sorted(delivered)
