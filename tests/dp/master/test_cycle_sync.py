"""FREEZE at the beginning of every cycle and SYNC at its end, as octets on the wire and as the slaves take them."""

from __future__ import annotations

import itertools

import pytest
from support import MS, WorldFactory, instance

from dpstack.dp.master.commands import AddSlave, Mode, RemoveSlave, SendControl, SetMode, Shutdown
from dpstack.dp.master.events import SlaveRemark, SlaveState
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import ConfigError, UsageError
from tests.dp.master import cycle_kit
from tests.dp.master.cycle_kit import P500, CycleBus, slave

BOTH = {"cycle_freeze": (1,), "cycle_sync": (1, 3)}


def member(address: int) -> SlaveParams:
    return slave(address, groups=(1,), sync=True, freeze=True)


def running(world: WorldFactory, *, cycle_ns: int = 10 * MS) -> CycleBus:
    setups = (member(5), member(6), slave(7))
    return cycle_kit.running(world, *setups, cycle_ns=cycle_ns, options=BOTH, after_ns=30 * MS)


def real_outputs(bus: CycleBus, address: int) -> bytes:
    """What stands at the outputs of the slave."""
    app = instance(bus.slaves[address].responder, SlaveApp)
    return app.outputs


def order(bus: CycleBus, begin: int, cycle_ns: int = 10 * MS) -> list[str]:
    """What was sent in one cycle: addresses of data, octets of Global_Control."""
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
    bus = running(world)
    bus.run(100 * MS)
    freezes = [e for e in bus.requests(58) if e.octets[9:11] == b"\x08\x01"]  # Freeze_Req to group 1
    assert {b.start_ns - a.start_ns for a, b in itertools.pairwise(freezes)} == {10 * MS}  # they are the cycle's start
    for freeze in freezes[:-1]:
        # Sync_Req (0x20) to groups 1 and 3 (0x05)
        assert [o for o in order(bus, freeze.start_ns) if o != "00 00"] == ["08 01", "5", "6", "7", "20 05"]
    assert bus.master.cycles.late.max_ns == 0
    assert bus.master.controls.freeze.held == bus.master.controls.sync.held == {5, 6}


def test_outputs_change_at_the_sync_and_inputs_are_of_the_freeze(world: WorldFactory) -> None:
    bus = running(world)
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
    bus = running(world)
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
    bus = running(world)
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
    bus = running(world, cycle_ns=0)
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
    bus = running(world)
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
