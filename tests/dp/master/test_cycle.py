"""The fixed cycle on the simulated wire: when rounds begin, outputs of one moment, rate groups, two masters."""

from __future__ import annotations

import itertools

import pytest
from support import MS, US, S, WorldFactory, instance, present

from dpstack.dp.master.commands import AddSlave, Mode, RemoveSlave, SendControl, SetMode, Shutdown
from dpstack.dp.master.events import SlaveRemark, SlaveState
from dpstack.dp.master.fixed_cycle import CycleData, MissReason
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import ConfigError, UsageError
from dpstack.params import BusParams
from dpstack.sim.world import World
from tests.dp.master.cycle_kit import P500, CycleBus, running, slave, steps

#: a bit at 500 kbit/s in ns; one exchange of twelve octets each way in bits: request, T_SDR, answer, T_ID1
BIT = 2_000
EXCHANGE = 231 + 11 + 231 + 37


# --- the grid ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("baud", [9_600, 19_200, 93_750, 187_500, 500_000, 1_500_000, 3_000_000, 12_000_000])
def test_rounds_begin_on_the_grid_to_the_nanosecond(world: WorldFactory, baud: int) -> None:
    """Alone on the bus, with GAP polls and repeated Global_Control between the rounds."""
    params = BusParams.preset(baud, address=2, gap=1)
    cycle_ns = 40 * S // baud * 100 + 12_345  # 4000 bits and a little
    bus = CycleBus(world(), params, (slave(5), slave(6)), cycle_ns)
    bus.until_exchanging(60 * S)
    bus.run(20 * cycle_ns)
    bus.quiet()
    bus.run(100 * cycle_ns)
    starts = bus.exchanges(5)
    assert 100 <= len(starts) <= 101
    assert steps(starts) == {cycle_ns}
    assert bus.station.stats.gap_polls > 50
    book = bus.master.cycles
    assert (book.missed, book.late.max_ns) == (0, 0)


def test_between_the_rounds_the_token_goes_on_round(world: WorldFactory) -> None:
    """4 ms are 2000 bits: two exchanges, then a token to itself every 33 + 37 bits until a cycle is near."""
    bus = running(world)
    bus.run(400 * MS)
    tokens = sum(len(entry.octets) == 3 for entry in bus.wire)
    assert tokens > 100 * 2
    held = bus.master.cycles.begun
    assert bus.station.stats.tokens > held


def test_the_gap_off_the_pause_before_a_cycle_is_shorter_than_t_to(world: WorldFactory) -> None:
    params = P500.replace(gap=0)
    bus = running(world, slave(5), params=params, after_ns=0)
    bus.run(100 * MS)
    silences = [b.start_ns - a.end_ns for a, b in itertools.pairwise(bus.wire)]
    assert max(silences) <= (200 + 2 * 70) * BIT  # T_SL and two tokens
    assert max(silences) < 6 * 200 * BIT  # T_TO of address 0


def test_free_running_is_as_it_was(world: WorldFactory) -> None:
    bus = running(world, params=P500.replace(gap=0), cycle_ns=0)
    bus.run(20 * MS)
    assert steps(bus.exchanges(5)) == {(2 * EXCHANGE + 33 + 37) * BIT}
    assert bus.master.cycles.begun == 0


def test_the_picture_of_a_cycle(world: WorldFactory) -> None:
    bus = running(world)
    seen: list[CycleData] = []

    def on_round(now: int) -> None:
        seen.append(present(bus.master.cycle))

    bus.master.on_round = on_round
    bus.master.images[5].outputs = bytes(range(12))
    bus.run(40 * MS)
    assert [c.t_ns for c in seen[-5:]] == bus.exchanges(5)[-5:]
    assert [c.number for c in seen] == list(range(seen[0].number, seen[0].number + len(seen)))
    last = seen[-1]
    assert last.inputs == {5: bytes(range(12)), 6: bytes(12)}  # the slaves mirror their outputs
    assert (last.fresh, last.late_ns, last.missed) == (frozenset((5, 6)), 0, 0)
    bus.world.remove(bus.slaves[6])
    bus.run(4 * MS)
    assert present(bus.master.cycle).fresh == {5}


# --- outputs of one moment --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cycle_ns", [0, 4 * MS])
def test_outputs_set_in_the_middle_of_a_round_wait_for_the_next(world: WorldFactory, cycle_ns: int) -> None:
    """At every instant of two rounds: never one slave with the new outputs and the other one without."""
    bus = running(world, cycle_ns=cycle_ns)
    images = bus.master.images
    new = 0

    def change() -> None:
        nonlocal new
        new = (new + 1) % 256
        for image in images.values():
            image.outputs = bytes([new]) * 12

    begin = bus.world.now
    for n in range(400):
        bus.world.call_at(begin + n * 20_011, change)
    bus.run(10 * MS)
    first = bus.exchanges(5)[0]
    sent = {a: [e.octets[7] for e in bus.data(a) if e.start_ns >= first] for a in (5, 6)}
    pairs = list(zip(sent[5], sent[6], strict=False))
    assert len(set(pairs)) > 2
    assert all(five == six for five, six in pairs)


@pytest.mark.parametrize("cycle_ns", [0, 4 * MS])
def test_operate_in_the_middle_of_a_round_lets_all_outputs_out_at_once(world: WorldFactory, cycle_ns: int) -> None:
    bus = running(world, cycle_ns=cycle_ns)
    for image in bus.master.images.values():
        image.outputs = bytes([7]) * 12
    for offset in range(0, 4 * MS, 170_011):
        bus.send(SetMode(Mode.CLEAR), 20 * MS)
        bus.quiet()
        bus.run(4 * MS + offset)
        bus.send(SetMode(Mode.OPERATE), 20 * MS)
        first = bus.exchanges(5)[0]
        sent = {a: [e.octets[7] for e in bus.data(a) if e.start_ns >= first] for a in (5, 6)}
        assert set(zip(sent[5], sent[6], strict=False)) == {(0, 0), (7, 7)}


def test_outputs_set_just_before_the_start_go_out_in_it(world: WorldFactory) -> None:
    bus = running(world)
    bus.run(8 * MS)
    due = bus.exchanges(5)[-1] + 4 * MS
    bus.world.run_until(due - 1)
    bus.master.images[6].outputs = bytes([7]) * 12
    bus.run(3 * MS)
    data = [e for e in bus.data(6) if e.start_ns > due]
    assert data[0].octets[7:19] == bytes([7]) * 12


# --- rate groups ------------------------------------------------------------------------------------------------------


def test_rate_groups_are_spread_and_keep_their_cycles(world: WorldFactory) -> None:
    bus = running(world, slave(5), *(slave(a, every=2) for a in (6, 7, 8, 9)))
    bus.run(80 * MS)
    grid = bus.exchanges(5)
    assert steps(grid) == {4 * MS}
    for address in (6, 7, 8, 9):
        assert steps(bus.exchanges(address)) == {8 * MS}
    # 6 and 8 in the even cycles, 7 and 9 in the odd ones (equal telegrams, lowest address first)
    first = {a: bus.exchanges(a)[0] for a in (6, 7, 8, 9)}
    assert first[8] - first[6] == first[9] - first[7] == EXCHANGE * BIT
    assert abs(first[7] - first[6]) == 4 * MS
    data = [e for e in bus.wire if e.octets[:4] == bytes((0x68, 15, 15, 0x68))]
    later = grid[2:-2]
    assert {sum(s <= e.start_ns < s + 4 * MS for e in data) for s in later} == {2 * 3}  # requests and answers


def test_min_slave_interval_is_kept_after_a_late_start(world: WorldFactory) -> None:
    """Its own bound, not only the grid's: after a late exchange the next one waits, others do not."""
    params = P500.replace(max_retry=5)
    bus = running(world, slave(5), slave(6, min_slave_interval_ns=4 * MS), params=params, after_ns=0)
    begin = bus.world.now
    for n in range(40):  # a lost answer of slave 5 now and then makes 6 later by a repetition
        bus.world.call_at(begin + n * 9_310_000, lambda: bus.world.silence(bus.slaves[5], 600 * US))
    bus.run(400 * MS)
    assert bus.station.stats.station(5).retries > 2
    assert min(steps(bus.exchanges(6))) == 4 * MS
    assert max(steps(bus.exchanges(6))) > 4 * MS


def test_a_slave_that_is_too_slow_for_the_cycle_is_refused(world: WorldFactory) -> None:
    wanted = r"s5\): its Min_Slave_Interval of 6 ms is longer than 4 ms, the time between its turns; give it every = 2"
    with pytest.raises(ConfigError, match=wanted):
        CycleBus(world(), P500, [slave(5, min_slave_interval_ns=6 * MS)], 4 * MS)
    bus = running(world)
    with pytest.raises(ConfigError, match=r"give it every = 3, or take a longer cycle"):
        bus.send(AddSlave(slave(7, every=2, min_slave_interval_ns=9 * MS)))
    bus.send(AddSlave(slave(7, every=3, min_slave_interval_ns=9 * MS)))


# --- two masters ------------------------------------------------------------------------------------------------------


def test_two_masters_with_fixed_cycles_in_one_ring(w: World) -> None:
    """Each keeps its own grid on average; a start waits for the other's hold: a round, a poll, three tokens at most."""
    first = CycleBus(w, P500, (slave(5), slave(6)), 8 * MS)
    w.run_for(100 * MS)
    second = CycleBus(w, BusParams.preset(500_000, address=1), (slave(15), slave(16)), 10 * MS)
    first.until_exchanging()
    second.until_exchanging()
    w.run_for(200 * MS)
    first.quiet()
    second.quiet()
    began = [bus.master.cycles.begun for bus in (first, second)]
    w.run_for(2 * S)
    # the other's round, its GAP poll (66 + T_SL), its Global_Control and both tokens
    hold = (2 * EXCHANGE + 2 * (66 + 200) + 343 + 3 * 70 + 2 * 66) * BIT
    for bus, address, cycle_ns, before in ((first, 5, 8 * MS, began[0]), (second, 15, 10 * MS, began[1])):
        book = bus.master.cycles
        starts = bus.exchanges(address)
        assert abs(len(starts) - 2 * S // cycle_ns) <= 1
        assert book.begun - before == pytest.approx(len(starts), abs=1)
        assert book.left_out == 0
        assert set(book.reasons) <= {MissReason.TOKEN}
        assert book.late.max_ns <= hold
        assert max(steps(starts)) <= cycle_ns + hold
    assert first.master.cycles.begun_late > 0  # told, not hidden


# --- FREEZE at the beginning of every cycle and SYNC at its end, as octets on the wire and as the slaves take them --


BOTH = {"cycle_freeze": (1,), "cycle_sync": (1, 3)}


def member(address: int) -> SlaveParams:
    return slave(address, groups=(1,), sync=True, freeze=True)


def grouped(world: WorldFactory, *, cycle_ns: int = 10 * MS) -> CycleBus:
    setups = (member(5), member(6), slave(7))
    return running(world, *setups, cycle_ns=cycle_ns, options=BOTH, after_ns=30 * MS)


def real_outputs(bus: CycleBus, address: int) -> bytes:
    """What stands at the outputs of the slave."""
    app = instance(bus.slaves[address].responder, SlaveApp)
    return app.outputs


def order(bus: CycleBus, begin: int, cycle_ns: int = 10 * MS) -> list[str]:
    """All that was sent in one cycle: addresses of data, octets of Global_Control."""
    told = []
    for entry in bus.wire:
        octets = entry.octets
        if begin <= entry.start_ns < begin + cycle_ns and len(octets) > 6 and octets[0] == 0x68:
            if octets[4] == 0xFF and octets[5] == 0x82:
                told.append(octets[9:11].hex(" "))
            elif octets[1] == 15 and octets[5] == 2:
                told.append(str(octets[4]))
    return told


def test_freeze_begins_and_sync_ends_each_cycle(world: WorldFactory) -> None:
    bus = grouped(world)
    bus.run(100 * MS)
    freezes = [e for e in bus.requests(58) if e.octets[9:11] == b"\x08\x01"]  # Freeze_Req to group 1
    assert {b.start_ns - a.start_ns for a, b in itertools.pairwise(freezes)} == {10 * MS}  # they are the cycle's start
    for freeze in freezes[:-1]:
        # Sync_Req (0x20) to groups 1 and 3 (0x05)
        assert [o for o in order(bus, freeze.start_ns) if o != "00 00"] == ["08 01", "5", "6", "7", "20 05"]
    assert bus.master.cycles.late.max_ns == 0
    assert bus.master.controls.freeze.held == bus.master.controls.sync.held == {5, 6}


def test_outputs_change_at_the_sync_and_inputs_are_of_the_freeze(world: WorldFactory) -> None:
    bus = grouped(world)
    bus.master.images[5].outputs = bus.master.images[6].outputs = bytes([3]) * 12
    changed: dict[int, list[int]] = {5: [], 6: []}

    def watch() -> None:
        for address in (5, 6):
            if real_outputs(bus, address) == bytes([3]) * 12 and not changed[address]:
                changed[address].append(bus.world.now)
        if not all(changed.values()):
            bus.world.call_at(bus.world.now + 1000, watch)

    watch()
    bus.run(30 * MS)
    sync = next(e for e in bus.requests(58) if e.octets[9] == 0x20 and e.start_ns > bus.exchanges(6)[0])
    assert changed[5] == changed[6]
    assert abs(changed[5][0] - sync.end_ns) <= 1000


def test_clear_and_the_end_let_go(world: WorldFactory) -> None:
    bus = grouped(world)
    bus.send(SetMode(Mode.CLEAR), 100 * MS)
    controls = [e.octets[9:11] for e in bus.requests(58)]
    assert b"\x16\x00" in controls  # Clear, Unfreeze, Unsync to all
    assert controls[-1] in (b"\x02\x00", b"\x16\x00")
    bus.quiet()
    bus.run(50 * MS)
    assert {e.octets[9] & 0x28 for e in bus.requests(58)} <= {0}  # neither in Clear
    bus.send(SetMode(Mode.OPERATE))
    for image in bus.master.images.values():
        image.outputs = bytes([3]) * 12
    bus.run(50 * MS)
    assert [real_outputs(bus, a) for a in (5, 6)] == [bytes([3]) * 12] * 2
    assert {b"\x08\x01", b"\x20\x05"} <= {bytes(e.octets[9:11]) for e in bus.requests(58)}
    bus.send(Shutdown(), 200 * MS)
    assert bus.requests(58)[-1].octets[9] & 0x16 == 0x16
    assert [real_outputs(bus, a) for a in (5, 6)] == [bytes(12)] * 2  # SYNC held nothing back


def test_a_slave_that_comes_back_is_taken_in_without_a_report(world: WorldFactory) -> None:
    bus = grouped(world)
    bus.world.remove(bus.slaves[6])
    bus.run(60 * MS)
    bus.world.add(bus.slaves[6])
    bus.until_exchanging()
    bus.run(30 * MS)
    assert bus.master.controls.sync.held == {5, 6}
    assert [e.message for e in bus.events_of(SlaveRemark) if "put back" in e.message] == []
    bus.send(RemoveSlave(5), 200 * MS)  # out of both modes first, see test_sync_freeze
    alone = [e for e in bus.wire if e.octets[4:8] == bytes((0x85, 0x82, 0x46, 58)) and e.octets[9] & 0x14 == 0x14]
    assert alone


def test_free_running_rounds_have_them_too(world: WorldFactory) -> None:
    bus = grouped(world, cycle_ns=0)
    bus.run(30 * MS)
    kinds = [e.octets[9:11].hex() for e in bus.requests(58) if e.octets[9]]
    assert set(kinds) == {"0801", "2005"}
    assert all(a != b for a, b in itertools.pairwise(kinds))


def test_refusals(world: WorldFactory) -> None:
    why = r"slave 5 \(s5\) is in a group of cycle_sync and not parameterised for SYNC: give it sync = true"
    with pytest.raises(ConfigError, match=why):
        CycleBus(world(), P500, [slave(5, groups=(3,), freeze=True)], 4 * MS, options=BOTH)
    with pytest.raises(ConfigError, match=r"cycle_freeze: groups are numbered 1..8, \[9\] were given"):
        CycleBus(world(), P500, [slave(5)], 4 * MS, options={"cycle_freeze": (9,)})
    bus = grouped(world)
    with pytest.raises(ConfigError, match="in a group of cycle_freeze and not parameterised for FREEZE"):
        bus.send(AddSlave(slave(8, groups=(1,), sync=True)))
    for command in (
        SendControl(1, (1,), unsync=True),
        SendControl(1, (), sync=True),
        SendControl(1, (1,), freeze=True),
    ):
        with pytest.raises(UsageError, match=r"every cycle sends (SYNC|FREEZE) to group|not parameterised"):
            bus.send(command)
    assert bus.state(5) is SlaveState.DATA_EXCHANGE
