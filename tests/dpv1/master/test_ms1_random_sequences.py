"""Random events on the wire and at the slave, in random order: every Read and Write has exactly one end.

Against a slave of octets that answers anything; and with a slave of ours in a world with lost and damaged telegrams.
"""

from __future__ import annotations

import contextlib
from collections import Counter

from alarm_kit import ALL, AlarmBus, block, refusing
from bus_kit import IDENT, PPO1, SimBus, setup
from hypothesis import example, given, note
from hypothesis import strategies as st
from ms1_kit import MS, Ms1Bus, answer, status
from octet_slave import NR, RR, RS, SC, UE
from property_kit import examples
from support import present, wire_log

from dpstack.dp.acyclic.job import CancelService, ServiceFailure
from dpstack.dp.master.events import SlaveState
from dpstack.dp.pdu.alarm_blocks import Alarm, Status
from dpstack.dp.pdu.dpv1_status import ALARMS, Dpv1
from dpstack.dpv1.master.alarm_orders import AlarmRaised, StatusTold
from dpstack.dpv1.master.orders import RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.dpv1.slave.alarms import AlarmEnd, AlarmServer, AlarmSupport, Raised
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import AlarmError
from dpstack.params import BusParams
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World
from tests.dpv1.master.fault_steps import fault_step
from tests.dpv1.master.patient_kit import Patient

S = 1_000 * MS
LIMIT = 60 * MS

#: telegrams, or parts of one: lengths that lie, functions that do not exist, answers to others, too many octets
_ODD = st.sampled_from(
    [
        None,
        SC,
        *(status(4, code) for code in (0x00, NR, RR, UE, RS, 0x0C, 0x07)),
        *(
            answer(4, text)
            for text in (
                "5E 01 02 01 55",
                "5E 01 03 01 55",
                "5F 01 02 02",
                "5F 01 02 00",
                "5E 01 02 F0 55",
                "DE 80 B5 00",
                "DF 80 C2 00",
                "DC 80 B5 00",
                "57 00",
                "00",
                "5E 01 02 F1" + " 55" * 240,
            )
        ),
        answer(4, "5E 01 02 01 66", 0x0C),
        answer(4, "5E 01 02 01 77", 0x0A),
        b"\x68\x00\xff",
    ]
)


@examples(30)
@given(st.lists(_ODD, max_size=30), st.lists(st.sampled_from("rrrwcmu..."), max_size=14))
def test_a_slave_that_answers_anything(answers: list[bytes | None], steps: list[str]) -> None:
    kit = Ms1Bus((4, 5), dpv1=Dpv1(c1_response_timeout_ns=LIMIT))
    kit.slaves[5].ms1 = lambda data: answer(5, "5E 01 02 01 22")
    queue = list(answers)
    kit.slaves[4].ms1 = lambda data: queue.pop(0) if queue else SC
    taken = 0
    for step in steps:
        match step:
            case "r" | "w":
                taken += 1
                kit.send(
                    RecordOrder(taken, Function.READ, 1, 2, 8, address=4, timeout_ns=S)
                    if step == "r"
                    else RecordOrder(taken, Function.WRITE, 1, 2, data=b"\1\2", address=4, timeout_ns=S)
                )
            case "c":
                kit.send(CancelService(taken))
            case "m" | "u":
                kit.slaves[4].mute = step == "m"
            case _:
                kit.run(15)
    end = kit.bus.now + 1_100 * MS
    while kit.acyclic.waiting and kit.bus.now < end:
        kit.run(10)
    assert Counter(done.token for done in kit.done) == Counter(range(1, taken + 1))
    assert kit.acyclic.waiting == 0
    for done in kit.done:
        failure = done.outcome.failure
        assert failure is None or done.outcome.text.startswith(("slave 4 ", "Read of slot 1", "Write of slot 1"))
        assert (
            failure is not None or done.function is Function.WRITE or done.outcome.data in (b"\x55", b"\x77", b"\x66")
        )
    kit.tokens = taken
    # the other slave noticed nothing, and the bus goes on
    assert kit.master.handlers[5].state is SlaveState.DATA_EXCHANGE
    assert kit.read(address=5).outcome.data == b"\x22"


_orders = st.tuples(
    st.sampled_from("rrw"), st.sampled_from((3, 4)), st.integers(0, 2), st.sampled_from((0, 1, 5, 98, 99))
)
_runs = st.tuples(st.just("run"), st.integers(1, 120), st.just(0), st.just(0))
_faults = st.tuples(
    st.sampled_from(("lose", "damage", "lose all", "noise", "quiet", "cancel", "line", "off")),
    st.integers(1, 4),
    st.just(0),
    st.just(0),
)


def _ms1(sent: Transmission) -> bool:
    return sent.octets[0] == 0x68 and 51 in sent.octets[7:9]


@examples(14)
@example([("line", 1, 0, 0), ("lose all", 4, 0, 0)], 0)
@given(st.lists(st.one_of(_orders, _orders, _runs, _faults), max_size=25), st.integers(0, 10_000))
def test_reads_and_writes_with_lost_telegrams(steps: list[tuple[str, int, int, int]], seed: int) -> None:
    world = World(seed=seed)
    params = BusParams.preset(187_500, address=2, gap=0)
    devices = {address: Patient() for address in (3, 4)}
    dpv1 = Dpv1(c1_response_timeout_ns=LIMIT)
    bus = SimBus(world, params, [setup(address, dpv1) for address in devices], devices=devices)
    world.run_for(200 * MS)
    taken = 0
    for what, number, slot, index in steps:
        match what:
            case "r":
                taken += 1
                bus.send(RecordOrder(taken, Function.READ, slot, index, 3, address=number, timeout_ns=S))
            case "w":
                taken += 1
                bus.send(RecordOrder(taken, Function.WRITE, slot, index, data=b"\1", address=number, timeout_ns=S))
            case "run":
                world.run_for(number * MS // 4)
            case "cancel":
                bus.send(CancelService(taken))
            case _:
                fault_step(world, bus.station, what, number, _ms1)
    world.faults.noise(0)
    end = world.now + 1_100 * MS
    while bus.acyclic.waiting and world.now < end:
        world.run_for(10 * MS)
    note(wire_log(world, 80))
    done = [event for event in bus.events if isinstance(event, RecordDone)]
    assert Counter(one.token for one in done) == Counter(range(1, taken + 1))
    assert bus.acyclic.waiting == 0
    orders = [step for step in steps if step[0] in "rw"]
    for address in devices:
        given_out = []
        for one in sorted((one for one in done if one.address == address), key=lambda one: one.token):
            what, _, slot, index = orders[one.token - 1]
            assert (one.function is Function.WRITE, one.slot, one.index) == (what == "w", slot, index)
            outcome = one.outcome
            if outcome.failure is ServiceFailure.NEGATIVE:
                assert index == 98
                given_out.append(present(outcome.codes)[2])
            elif outcome.failure is None:
                assert index not in (98, 99)
                if one.function is Function.READ:
                    assert outcome.data[1:] == bytes((slot, index))
                    given_out.append(outcome.data[0])
        # no answer was taken for two services, or for one that was asked before it
        assert given_out == sorted(set(given_out))
    # four telegrams may still be lost: who was asked in vain is asked again after 0.1, 0.2, 0.4 and 0.8 s
    bus.until_exchanging(2 * S)


# --- Alarms between both ends, telegrams lost and damaged: what is acknowledged was delivered once, in order --------


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


def _ms1_or_alarms(sent: Transmission) -> bool:
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
                world.faults.drop(_ms1_or_alarms, times=number)
            case "lose diag":
                world.faults.drop(_diag, times=number)
            case _:
                fault_step(world, bus.station, what, number, lambda sent: _ms1_or_alarms(sent) or _diag(sent))
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


# --- Random telegrams are lost on the wire: every alarm is delivered once, in order, and acknowledged ---------------


_KINDS = st.sampled_from([1, 2, 3, 4, 5, 6, 32, 126])
#: few slots and data, so that equal ones follow each other often
_ALARMS = st.lists(
    st.tuples(_KINDS, st.integers(0, 1), st.integers(0, 3), st.sampled_from(["", "00"])), min_size=3, max_size=8
)
_LOSSES = st.lists(st.sampled_from(["", "", "", "r", "a"]), min_size=20, max_size=60)
_MODES = st.sampled_from([(0, 0), (1, 2), (3, 8), (7, 32)])


@examples(25)
@given(
    _MODES, _ALARMS, _LOSSES, st.integers(-1, 5), st.booleans(), st.booleans(), st.lists(st.integers(0, 9), max_size=8)
)
def test_alarms_with_lost_telegrams(
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
    slave.lose(losses)
    blocks = [
        block(kind, slot, specifier, at % 32 if limit else 0, data)
        for at, (kind, slot, specifier, data) in enumerate(alarms)
    ]
    waits = list(pauses)
    for entry in blocks:
        kit.raise_and_run(waits.pop(0) if waits else 0, entry)
    note(f"{[entry.hex(' ') for entry in blocks]}")
    kit.until(lambda: len(kit.ends) == len(blocks))
    kit.run(150)  # longer than anything could come of what stands in the diagnosis
    assert kit.blocks == blocks
    assert sorted(slave.taken) == sorted(blocks)
    assert not slave.open
    assert sorted(end.number for end in kit.ends if end.outcome.failure is None) == [*range(1, len(blocks) + 1)]
