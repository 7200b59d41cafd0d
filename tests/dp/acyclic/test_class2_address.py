"""Set_Slave_Add: literal octets, what is looked at before, and how its effect is verified afterwards."""

from __future__ import annotations

import pytest
from bus_kit import IDENT, PPO1, SimBus
from class2_kit import MS, Class2Bus
from octet_slave import DL, RS, OctetSlave, sd1, sd2
from ring_bus import fixed

from dpstack.dp.acyclic.class2 import ChangeAddress, Service, ServiceDone, ask
from dpstack.dp.acyclic.job import Outcome, RequestEnd, ServiceFailure
from dpstack.dp.services import reading_only
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import UsageError
from dpstack.fdl.interface import LONG_NS, SC_REPLY, Failure, Reply, StationControl
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Telegram
from dpstack.machine import LineDown
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Notice


def change(kit: Class2Bus, old: int = 126, new: int = 5) -> Outcome:
    return kit.change(ChangeAddress(1, old, new))


def orders(slave: OctetSlave) -> list[str]:
    """The data of each Set_Slave_Add that it got."""
    return [octets[9:-2].hex(" ") for octets in slave.requests if octets[0] == 0x68 and octets[7] == 55]


def begin_change(kit: Class2Bus, slave: OctetSlave) -> None:
    """Order the change from 126 to 5, and run until Set_Slave_Add has reached ``slave``."""
    kit.send(ChangeAddress(1, 126, 5))
    while not orders(slave):
        kit.bus.run(MS)


def test_literal_octets(kit: Class2Bus) -> None:
    """Slave 126 as delivered becomes slave 5: every telegram of it."""
    slave = OctetSlave(kit.bus, 126)
    kit.bus.log.clear()
    outcome = kit.change(ChangeAddress(1, 126, 5, ident=0x1234))
    assert (outcome.failure, outcome.data.hex(" ")) == (None, "02 05 00 ff 12 34")
    assert slave.address == 5
    assert [octets for octets in kit.bus.octets() if not octets.startswith("dc")] == [
        "68 05 05 68 fe 82 6d 3c 3e 67 16",
        "68 0b 0b 68 82 fe 08 3e 3c 02 05 00 ff 12 34 4e 16",
        "10 05 02 49 50 16",
        "10 05 02 49 50 16",
        "68 09 09 68 fe 82 5d 37 3e 05 12 34 00 9d 16",
        "e5",
        "68 05 05 68 85 82 6d 3c 3e ee 16",
        "68 0b 0b 68 82 85 08 3e 3c 02 05 00 ff 12 34 d5 16",
        "10 7e 02 49 c9 16",
        "10 7e 02 49 c9 16",
    ]
    assert [event.text for event in kit.bus.events_of(Notice)] == ["class 2: slave 126 has address 5 now"]


def test_the_rest_of_the_telegram(kit: Class2Bus) -> None:
    slave = OctetSlave(kit.bus, 7)
    assert kit.change(ChangeAddress(1, 7, 125, no_add_chg=True, rem_slave_data=b"\xca\xfe")).failure is None
    assert orders(slave) == ["7d 12 34 ff ca fe"]
    assert slave.locked
    assert [event.text for event in kit.bus.events_of(Notice)] == ["class 2: slave 7 has address 125 now for good"]
    outcome = kit.change(ChangeAddress(2, 125, 7))
    assert (outcome.failure, outcome.status) == (ServiceFailure.KEPT, "ignored")
    assert outcome.text.startswith("slave 125 acknowledged Set_Slave_Add and kept its address; its address was locked")
    assert slave.address == 125


@pytest.mark.parametrize("moves", ["acknowledges", "at once"])
@pytest.mark.parametrize("mode", ["whole", "octets"])
def test_the_effect_counts_not_the_acknowledgement(moves: str, mode: str) -> None:
    kit = Class2Bus(mode=mode)
    slave = OctetSlave(kit.bus, 126, moves=moves)
    assert change(kit).failure is None
    assert slave.address == 5


@pytest.mark.parametrize(
    ("silent", "text"),
    [
        (False, "slave 126 acknowledged Set_Slave_Add and kept its address"),
        (True, "slave 126 did not acknowledge Set_Slave_Add and kept its address"),
    ],
)
def test_a_slave_that_ignores_it(kit: Class2Bus, silent: bool, text: str) -> None:
    slave = OctetSlave(kit.bus, 126, moves="ignores")
    if silent:
        slave.says[55] = lambda octets: None
    begun = kit.bus.now
    outcome = change(kit)
    assert outcome.failure is ServiceFailure.KEPT
    assert outcome.text.startswith(text)
    assert kit.bus.now - begun < 2_000 * MS


def test_a_slave_that_takes_its_time(kit: Class2Bus) -> None:
    """It restarts with the new address: silent for three seconds."""
    slave = OctetSlave(kit.bus, 126, moves="dies")
    begin_change(kit, slave)
    kit.bus.run(3_000 * MS)
    OctetSlave(kit.bus, 5)
    assert kit.end(1).failure is None


def test_a_slave_that_is_gone(kit: Class2Bus) -> None:
    OctetSlave(kit.bus, 126, moves="dies")
    outcome = change(kit)
    assert outcome.failure is ServiceFailure.GONE
    assert outcome.text == (
        "slave 126 answers neither there nor at 5 after Set_Slave_Add; "
        "switch it off and on, then look with `dpstack scan`"
    )


def test_another_device_turns_up_at_the_new_address(kit: Class2Bus) -> None:
    slave = OctetSlave(kit.bus, 126, moves="dies")
    begin_change(kit, slave)
    OctetSlave(kit.bus, 5, ident=b"\xde\xad")
    outcome = kit.end(1)
    assert outcome.failure is ServiceFailure.IDENT
    assert outcome.text.startswith("another device answers at 5 after Set_Slave_Add: ident 0xDEAD instead of 0x1234;")


def test_two_devices_at_the_old_address(kit: Class2Bus) -> None:
    slave = OctetSlave(kit.bus, 126)
    begin_change(kit, slave)
    OctetSlave(kit.bus, 126)  # the other one had not heard it
    outcome = kit.end(1)
    assert outcome.failure is ServiceFailure.DOUBLE
    assert outcome.text.startswith("the slave has address 5 now, but a station still answers at 126: two had that")


# --- what is looked at before ---------------------------------------------------------------------------------------


def test_nobody_there(kit: Class2Bus) -> None:
    assert change(kit).failure is ServiceFailure.SILENT


def test_another_device(kit: Class2Bus) -> None:
    slave = OctetSlave(kit.bus, 126)
    outcome = kit.change(ChangeAddress(1, 126, 5, ident=0x0696))
    assert outcome.failure is ServiceFailure.IDENT
    assert outcome.text.startswith("slave 126 is another device: ident 0x1234 instead of 0x0696; nothing was changed:")
    assert orders(slave) == []


@pytest.mark.parametrize(
    ("octet_2", "words"),
    [
        (0x0C, "wait: its watchdog is on and gives it free; or switch it off and on"),
        (0x04, "its watchdog is off: switch it off and on, or let master 1 take it up again and end in order"),
    ],
)
def test_a_slave_that_a_master_left_locked_which_is_gone(kit: Class2Bus, octet_2: int, words: str) -> None:
    slave = OctetSlave(kit.bus, 7, master=1)
    slave.says[60] = lambda _: sd2(2, 7, DL, 62, 60, bytes((0, octet_2, 0, 1)) + slave.ident)
    outcome = change(kit, 7)
    assert outcome.failure is ServiceFailure.OWNED
    assert outcome.text == (
        "slave 7 is still locked by master 1, which is not in the token ring (any more) and takes no address "
        f"meanwhile; nothing was changed: {words}"
    )


def test_a_slave_of_another_master(kit: Class2Bus) -> None:
    slave = OctetSlave(kit.bus, 7, master=1)
    kit.bus.slaves[1] = fixed("10 01 02 49 4C 16", "10 02 01 30 33 16")  # FDL status: a master in the ring
    outcome = change(kit, 7)
    assert outcome.failure is ServiceFailure.OWNED
    assert outcome.text.startswith("slave 7 is owned by master 1 and takes no address meanwhile; nothing was changed:")
    assert orders(slave) == []


def test_an_address_in_use() -> None:
    kit = Class2Bus(mode="octets")
    slave = OctetSlave(kit.bus, 126)
    OctetSlave(kit.bus, 5, master=1)
    kit.bus.slaves[6] = lambda octets, now: (11, b"\x12\x34")  # two at one address garble each other
    for token, new in ((1, 5), (2, 6)):
        outcome = kit.change(ChangeAddress(token, 126, new))
        assert outcome.failure is ServiceFailure.TAKEN
        assert outcome.text.startswith(f"address {new} is in use: a station answers there; nothing was changed:")
    assert orders(slave) == []


def test_a_slave_that_cannot_do_it(kit: Class2Bus) -> None:
    slave = OctetSlave(kit.bus, 126)
    slave.says[55] = lambda octets: sd1(2, 126, RS)
    outcome = change(kit)
    assert (outcome.failure, outcome.status) == (ServiceFailure.REFUSED, "RS")
    assert outcome.text.startswith("slave 126 refuses Set_Slave_Add (RS); its address is set at the device itself")


@pytest.mark.parametrize(
    ("order", "text"),
    [
        (ChangeAddress(1, 126, 126), "address 126 cannot be given to a slave: 0..125"),
        (ChangeAddress(1, 126, -1), "address -1 cannot be given to a slave"),
        (ChangeAddress(1, 126, 2), "address 2 is that of this master itself: give the slave another one"),
        (ChangeAddress(1, 2, 5), "address 2 is that of this master itself"),
        (ChangeAddress(1, 127, 5), "address 127: a slave has 0..126"),
        (ChangeAddress(1, 5, 5), "the slave has address 5 already"),
        (ChangeAddress(1, 126, 5, rem_slave_data=bytes(241)), "241 octets for the device, 240 are possible"),
        (ChangeAddress(1, 126, 5, ident=0x10000), "ident = 65536 does not fit"),
    ],
)
def test_impossible_orders_are_refused_at_once(order: ChangeAddress, text: str) -> None:
    kit = Class2Bus()
    with pytest.raises(UsageError, match=text):
        kit.send(order)
    assert kit.acyclic.waiting == 0


def test_a_read_only_bus_changes_nothing() -> None:
    kit = Class2Bus(guard=reading_only)
    slave = OctetSlave(kit.bus, 126)
    outcome = change(kit)
    assert outcome.failure is ServiceFailure.GUARDED
    assert outcome.text == (
        "slave 126 was not sent Set_Slave_Add; this bus is read-only: leave read_only out where slaves shall be changed"
    )
    assert orders(slave) == []
    assert [e.text for e in kit.bus.events_of(Notice)] == [
        "fdl: Set_Slave_Add to station 126 was not sent: this bus is read-only; please report it, nothing may try"
    ]


def test_cut_short_it_says_what_may_have_happened(kit: Class2Bus) -> None:
    slave = OctetSlave(kit.bus, 126, moves="dies")
    begin_change(kit, slave)
    kit.bus.run(MS)
    kit.send(LineDown("unplugged"))
    outcome = kit.end(1)
    assert outcome.failure is ServiceFailure.LINE
    assert outcome.text.endswith("; Set_Slave_Add may have been sent to slave 126: look for it at 126 and 5")


# --- beside class 1 masters -----------------------------------------------------------------------------------------


def test_a_slave_of_its_own_station_is_refused_at_once(w: World) -> None:
    bus = SimBus(w, BusParams.preset(500_000, address=2), (3,)).until_exchanging()
    with pytest.raises(UsageError, match="slave 3 is parameterised by this master"):
        bus.send(ChangeAddress(1, 3, 9))


class Addressable(SlaveApp):
    """Takes any address it is given."""

    __slots__ = ("control",)

    control: StationControl

    def attached(self, station: StationControl) -> None:
        super().attached(station)
        self.control = station

    def serve(self, request: Telegram, now: int) -> Reply | None:
        if request.dsap != 55:
            return super().serve(request, now)
        self.control.set_address(request.data[0])
        return SC_REPLY


def test_beside_a_running_class_1_master_nobody_loses_an_exchange(w: World) -> None:
    params = BusParams.preset(500_000, address=2)
    bus = SimBus(w, params, (3, 4))
    w.add(PassiveStation(126, Addressable(MirrorDevice(IDENT, PPO1)), params))
    bus.until_exchanging()
    w.run_for(200 * MS)
    bus.send(ChangeAddress(1, 126, 4))
    bus.send(ChangeAddress(2, 126, 5, ident=IDENT))
    while bus.acyclic.waiting:
        w.run_for(MS)
    found = {e.token: e.outcome for e in bus.events if isinstance(e, ServiceDone)}
    assert found[1].failure is ServiceFailure.TAKEN
    assert (found[2].failure, found[2].data.hex(" ")) == (None, "02 05 00 ff 12 34")
    assert bus.exchanging
    stats = bus.station.stats
    assert [(stats.stations[a].retries, stats.stations[a].timeouts) for a in (3, 4)] == [(0, 0)] * 2


def test_a_slave_named_by_its_address_is_waited_for_before_it_counts_as_silent() -> None:
    """The first times no longer than for any address; the last time as for one that is there, where there is room."""
    silence = RequestEnd(Failure.NO_ANSWER, 0, 0)
    steps = ask(9, Service.DIAGNOSIS)
    sent = [next(steps).request, *(steps.send(silence).request for _ in range(3))]
    assert [one.extra_ns for one in sent] == [0, 0, 0, LONG_NS]
    assert not any(one.patient for one in sent)
    with pytest.raises(StopIteration) as end:
        steps.send(silence)
    assert end.value.value is Failure.NO_ANSWER
