"""SYNC and FREEZE: what the master sends, when, and what it does to the outputs and inputs of three slaves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from bus_kit import IDENT, SimBus
from msgspec.structs import replace
from scripted_link import MS, ScriptedLink, data, operating
from scripted_link import setup as slave
from support import US, WorldFactory, instance

from dpstack.dp.master.commands import Mode, RemoveSlave, SendControl, SetMode, Shutdown
from dpstack.dp.master.events import ControlFailed, ControlSent, PictureTaken
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.device import Device
from dpstack.errors import BusError, UsageError
from dpstack.fdl.codec import encode_sd2
from dpstack.fdl.telegram import Telegram
from dpstack.machine import LineDown
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event

PARAMS = BusParams.preset(500_000, address=2)


def setup(address: int, **changes: Any) -> SlaveParams:
    return slave(address, **({"groups": (1,), "sync": True, "freeze": True} | changes))


def controls(bus: ScriptedLink) -> list[tuple[int, str]]:
    """Address and octets of every Global_Control that says more than the mode."""
    made = [(r.da, r.data.hex(" ")) for r in bus.requests if r.dsap == 58]
    return [entry for entry in made if entry[1] not in ("00 00", "02 00")]


def outcomes(bus: ScriptedLink) -> list[Event]:
    return [e for e in bus.events if isinstance(e, (ControlSent, ControlFailed, PictureTaken))]


@pytest.mark.parametrize(
    ("what", "groups", "octets"),
    [
        ({"sync": True}, (1,), "20 01"),
        ({"unsync": True}, (1,), "10 01"),
        ({"freeze": True}, (1,), "08 01"),
        ({"unfreeze": True}, (1,), "04 01"),
        ({"sync": True, "freeze": True}, (1, 3), "28 05"),
        ({"unsync": True, "unfreeze": True}, (), "14 00"),
    ],
)
def test_each_is_sent_once_to_its_groups(what: dict[str, bool], groups: tuple[int, ...], octets: str) -> None:
    """Literal octets (docs/reference/protocol.md#global_control); a second SYNC would act again, so it is never
    repeated."""
    bus = operating(setup(3), setup(4))
    bus.send(SendControl(7, groups, **what), 500 * MS)
    assert controls(bus) == [(127, octets)]
    (sent,) = outcomes(bus)
    assert isinstance(sent, ControlSent)
    assert sent.token == 7
    at = next(r for r in bus.requests if r.data.hex(" ") == octets)
    assert at.ssap == 62


def test_in_clear_the_telegram_says_clear_too() -> None:
    bus = operating(setup(3))
    bus.send(SetMode(Mode.CLEAR), 5 * MS)
    bus.send(SendControl(1, (1,), freeze=True), 5 * MS)
    assert controls(bus) == [(127, "0a 01")]


def test_settle_waits_for_one_exchange_with_each_that_began_after_the_order() -> None:
    bus = operating(setup(3), setup(4, every=1000), setup(5))
    busy = {"left": 3}

    def answer(request: Any) -> Telegram:
        busy["left"] -= 1
        return Telegram(data(request, b"").kind, 2, 5, 0x02) if busy["left"] >= 0 else data(request, bytes(4))

    bus.slaves[5].answers[None] = answer  # RR three times
    bus.master.images[4].outputs = b"\x01\x02\x03\x04"
    bus.send(SendControl(1, (1,), sync=True, settle=True), 20 * MS)
    sync = next(n for n, r in enumerate(bus.requests) if r.data == b"\x20\x01")
    before = bus.requests[:sync]
    assert sum(r.da == 5 for r in before) == 4
    assert [r.data for r in before if r.da == 4][-1] == b"\x01\x02\x03\x04"  # every = 1000, but not now


def test_a_picture_is_of_exchanges_after_the_freeze() -> None:
    bus = operating(setup(3), setup(4))
    bus.send(SendControl(1, (1,), freeze=True, picture=True))
    while not controls(bus):
        bus.hold()
    bus.slave.inputs, bus.slaves[4].inputs = b"\x0a\x0b\x0c\x0d", b"\x01\x02\x03\x04"
    bus.run(5 * MS)
    picture = instance(outcomes(bus)[-1], PictureTaken)
    assert picture.inputs == {3: b"\x0a\x0b\x0c\x0d", 4: b"\x01\x02\x03\x04"}


def test_an_impossible_order_is_refused_by_name() -> None:
    bus = operating(setup(3), setup(4, sync=False), setup(5, groups=(2,), freeze=False))
    order = bus.master.command
    with pytest.raises(UsageError, match=r"slave 4 \(s4\): not parameterised for SYNC"):
        order(SendControl(1, (1,), sync=True), bus.now)
    with pytest.raises(UsageError, match=r"slave 5 \(s5\): not parameterised for FREEZE"):
        order(SendControl(1, (), freeze=True), bus.now)
    with pytest.raises(UsageError, match="no slave is in group 7; groups of this bus: 1, 2"):
        order(SendControl(1, (7,), sync=True), bus.now)
    with pytest.raises(UsageError, match=r"numbered 1\.\.8"):
        order(SendControl(1, (9,), sync=True), bus.now)
    bus.run(10 * MS)
    assert controls(bus) == []


def test_in_stop_and_without_a_token_it_is_refused_at_once() -> None:
    bus = operating(setup(3))
    bus.send(LineDown("unplugged"))
    with pytest.raises(BusError, match="holds no token"):
        bus.send(SendControl(1, (1,), sync=True))
    bus.run(20 * MS)
    bus.send(SetMode(Mode.STOP), 20 * MS)
    with pytest.raises(UsageError, match="in Stop"):
        bus.send(SendControl(1, (1,), sync=True))


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (LineDown("unplugged"), "the port vanished"),
        (SetMode(Mode.STOP), "the master goes to Stop"),
        (Shutdown(), "the master goes to Offline"),
        (RemoveSlave(3), "no slave is left in its groups"),
    ],
)
def test_an_order_that_can_no_longer_be_sent_ends_with_the_reason(end: object, words: str) -> None:
    bus = operating(setup(3), setup(4, groups=()))
    bus.send(SendControl(1, (1,), sync=True))
    bus.send(end, 20 * MS)
    (failed,) = outcomes(bus)
    assert isinstance(failed, ControlFailed)
    assert words in failed.reason
    assert controls(bus) == []


def test_a_member_that_is_lost_is_named() -> None:
    bus = operating(setup(3), setup(4))
    del bus.slaves[4]
    bus.send(SendControl(1, (1,), sync=True, settle=True), 20 * MS)
    (failed,) = outcomes(bus)
    assert isinstance(failed, ControlFailed)
    assert failed.address == 4
    assert "slave 4 (s4) is not in data exchange: stopped answering" in failed.reason


def test_a_slave_that_comes_back_is_put_back_into_its_groups_mode_before_its_outputs() -> None:
    """Alone, by a telegram of its own: a SYNC to the group would pass on what the others hold."""
    bus = operating(setup(3), setup(4))
    bus.send(SendControl(1, (1,), sync=True), 1_500 * MS)
    bus.slaves[4].configured = False
    bus.run_anew(20 * MS)
    assert controls(bus) == [(4, "20 00")]
    made = [(r.dsap, r.data.hex(" ")) for r in bus.requests if r.da == 4]
    back = made.index((58, "20 00"))
    assert [dsap for dsap, _ in made[back - 4 : back + 2]] == [60, 61, 62, 60, 58, None]
    assert any("put back alone" in remark for remark in bus.remarks(4))


@pytest.mark.parametrize("safe", [b"", b"\x04\x7e\x00\x00"])
@pytest.mark.parametrize("end", [SetMode(Mode.CLEAR), SetMode(Mode.STOP), Shutdown()])
def test_safe_values_reach_outputs_that_are_held(end: object, safe: bytes) -> None:
    bus = operating(setup(3, safe=safe, initial=b"\x04\x7f\x40\x00"))
    bus.send(SendControl(1, (1,), sync=True), 10 * MS)
    bus.send_anew(end, 100 * MS)
    made = [(r.dsap, r.data.hex(" ")) for r in bus.requests]
    first = next(n for n, (dsap, octets) in enumerate(made) if dsap == 58)
    assert made[first] == (58, "14 00" if safe else "16 00")
    assert made[first - 1] == (None, (safe or bytes(4)).hex(" "))


def test_a_slave_given_up_in_sync_gets_its_safe_values_too() -> None:
    bus = operating(setup(3), setup(4, safe=b"\x04\x7e\x00\x00", initial=b"\x04\x7f\x40\x00"))
    bus.send(SendControl(1, (1,), sync=True), 10 * MS)
    bus.send_anew(RemoveSlave(4), 100 * MS)
    made = [(r.dsap, r.data.hex(" ")) for r in bus.requests if r.da == 4]
    assert made[:3] == [(None, "04 7e 00 00"), (58, "14 00"), (None, "04 7e 00 00")]
    assert made[-1][0] == 61


@pytest.mark.parametrize(("mode", "octets"), [(Mode.OPERATE, "14 00"), (Mode.CLEAR, "16 00")])
def test_the_release_of_a_slave_given_up_says_the_mode_too(mode: Mode, octets: str) -> None:
    """Global_Control with UNSYNC and UNFREEZE; Clear_Data stays set where the master is in Clear."""
    bus = operating(setup(3), setup(4))
    bus.send(SetMode(mode), 200 * MS)
    bus.send(SendControl(1, (1,), freeze=True), 10 * MS)
    bus.send_anew(RemoveSlave(4), 100 * MS)
    assert [r.data.hex(" ") for r in bus.requests if (r.da, r.dsap) == (4, 58)] == [octets]


# --- three slaves in virtual time -----------------------------------------------------------------------------------


class Valve(Device):
    """Notes when its outputs change; its inputs are a clock of its own that the test sets."""

    ident = IDENT
    configs = (b"\x20\x10",)

    def __init__(self, clock: Callable[[], int]) -> None:
        self.clock = clock
        self.outputs = b"\x00"
        self.changes: list[tuple[int, bytes]] = []

    def exchange(self, outputs: bytes, now: int) -> bytes:
        if outputs != self.outputs:
            self.outputs = outputs
            self.changes.append((now, outputs))
        return bytes((self.clock() & 0xFF,))


class Three(SimBus):
    """Three valves in group 2 under a master in Operate."""

    def __init__(self, world: World) -> None:
        self.valves = [Valve(lambda: world.now // (100 * US)) for _ in range(3)]
        valve = slave(3, ident=IDENT, config=b"\x20\x10", groups=(2,), sync=True, freeze=True)
        setups = [replace(valve, address=address, name=f"v{address}") for address in (3, 4, 5)]
        super().__init__(world, PARAMS, setups, devices=dict(enumerate(self.valves, 3)))
        self.until_exchanging()
        self.world.run_for(100 * MS)

    def order(self, **what: bool) -> ControlSent:
        """Give an order, run until it is carried out."""
        self.events.clear()
        self.send(SendControl(1, (2,), **what))
        done = PictureTaken if what.get("picture") else ControlSent
        while not any(isinstance(e, done) for e in self.events):
            self.world.run_for(100 * US)
        sent = next(e for e in self.events if isinstance(e, ControlSent))
        self.world.run_for(max(0, sent.t_ns - self.world.now))
        return sent

    def write(self, value: int) -> None:
        """New outputs for all three, then many rotations."""
        for image in self.master.images.values():
            image.outputs = bytes((value,))
        self.world.run_for(50 * MS)


def test_nobodys_outputs_change_between_syncs_and_all_change_within_one_telegram(world: WorldFactory) -> None:
    three = Three(world())
    three.order(sync=True)
    for valve in three.valves:
        valve.changes.clear()
    wire = encode_sd2(127, 2, 0x46, b"\x20\x02", 58, 62)
    for value in (1, 2, 3):
        three.write(value)
        assert [valve.changes for valve in three.valves] == [[], [], []]
        sent = three.order(sync=True, settle=True)
        changes = [valve.changes for valve in three.valves]
        assert [[octets for _, octets in c] for c in changes] == [[bytes((value,))]] * 3
        assert {at for c in changes for at, _ in c} == {sent.t_ns}  # at the last bit of that telegram, all of them
        on_wire = [t for t in three.world.log if t.octets == wire]
        assert on_wire[-1].end_ns == sent.t_ns  # the medium's word for it
        for valve in three.valves:
            valve.changes.clear()
    three.write(9)
    three.order(unsync=True)
    assert [[octets for _, octets in valve.changes] for valve in three.valves] == [[b"\x09"]] * 3


def test_a_picture_is_of_one_moment(world: WorldFactory) -> None:
    """The valves' inputs are a clock of 100 us: live they differ from slave to slave, frozen they are the same."""
    three = Three(world())
    live = {h.image.inputs for h in three.master.handlers.values()}
    assert len(live) == 3
    seen = set()
    for _ in range(5):
        sent = three.order(freeze=True, picture=True)
        picture = next(e for e in three.events if isinstance(e, PictureTaken))
        assert set(picture.inputs.values()) == {bytes((sent.t_ns // (100 * US) & 0xFF,))}
        seen |= set(picture.inputs.values())
        three.world.run_for(7 * MS)
    assert len(seen) == 5
    three.order(unfreeze=True)
    three.world.run_for(20 * MS)
    assert len({h.image.inputs for h in three.master.handlers.values()}) == 3
