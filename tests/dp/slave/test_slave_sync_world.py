"""SYNC and FREEZE over three slaves on one wire in virtual time; the master is nothing but octets."""

from __future__ import annotations

import pytest
from octet_wire import BIT, PARAMS, framed
from slave_kit import make_slave
from support import MS, Dummy, WorldFactory

from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.user_slave import DpSlave, OnCycle
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.sim.world import World

SLAVES = (3, 4, 5)
TYPE = SlaveDescription(ident=0x0A35, configs=(bytes.fromhex("11 21"),), fail_safe=True)
CLEAR, OPERATE, SYNC, UNSYNC, FREEZE, UNFREEZE = "02", "00", "20", "10", "08", "04"


class Plant:
    """Three slaves of 2 octets each way that see one moving sensor, in data exchange with master 2.

    ``changes``: at which time which slave's outputs became what. Slaves 3 and 4 are in group 1, slave 5 in 1 and 2.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self.sensor = 0
        self.changes: list[tuple[int, int, str]] = []
        self.outputs = dict.fromkeys(SLAVES, "")
        self.master = Dummy(address=2, hears_all=True)
        self.fcb = dict.fromkeys(SLAVES, 0x6D)
        world.add(self.master)
        for address in SLAVES:
            world.add(make_slave(address, DpSlave(TYPE, self.function(address)), PARAMS))
        for address in SLAVES:
            group = "03" if address == 5 else "01"
            assert self.ask(address, f"3D 3E B8 0A 0A 0B 0A 35 {group}") is Kind.SC
            assert self.ask(address, "3E 3E 11 21") is Kind.SC
        self.round("11 11")

    def function(self, address: int) -> OnCycle:
        def cycle(outputs: bytes, elapsed: int) -> bytes:
            if outputs.hex(" ") != self.outputs[address]:
                self.outputs[address] = outputs.hex(" ")
                self.changes.append((self.world.now, address, outputs.hex(" ")))
            return self.sensor.to_bytes(2, "big")

        return cycle

    def send(self, octets: str) -> int:
        """Put it on the wire and let 2 ms pass; returns when its last bit was on the wire."""
        data = bytes.fromhex(octets)
        end = self.world.now + 11 * BIT * len(data)
        self.sensor += 1
        self.master.heard.clear()
        self.world.inject(data)
        self.world.run_for(2 * MS)
        return end

    def request(self, octets: str) -> Telegram:
        self.send(octets)
        (_, _), (_, answer) = self.master.heard  # what was sent, and what came
        return answer

    def ask(self, address: int, unit: str) -> Kind:
        """A service of the slave, by its data unit; what kind of answer came."""
        return self.request(framed(0x80 | address, 0x82, self.next_fc(address), unit)).kind

    def next_fc(self, address: int) -> int:
        """FCV 0, FCB 1 first, then FCV 1 with FCB toggling."""
        fc = self.fcb[address]
        self.fcb[address] = 0x7D if fc == 0x5D else 0x5D
        return fc

    def exchange(self, address: int, outputs: str) -> str:
        """A Data_Exchange; the inputs."""
        return self.request(framed(address, 2, self.next_fc(address), outputs)).data.hex(" ")

    def round(self, outputs: str) -> list[str]:
        """Data_Exchange with all three, the same outputs; their inputs."""
        return [self.exchange(address, outputs) for address in SLAVES]

    def control(self, command: str, groups: str = "00") -> int:
        """Global_Control to 127; when its last bit was on the wire."""
        return self.send(framed(0xFF, 0x82, 0x46, f"3A 3E {command} {groups}"))

    def take(self) -> list[tuple[int, int, str]]:
        changes, self.changes = self.changes, []
        return changes


@pytest.fixture
def plant(world: WorldFactory) -> Plant:
    made = Plant(world())
    made.take()
    return made


def test_between_syncs_nobody_s_outputs_change_and_all_change_within_one_telegram(plant: Plant) -> None:
    plant.control(SYNC)
    for n in range(2, 12):
        for part in range(3):  # several rounds between two SYNCs: only the last one counts
            plant.round(f"{n:02x} {part:02x}")
        assert plant.take() == []
        at = plant.control(SYNC)
        assert plant.take() == [(at, address, f"{n:02x} 02") for address in SLAVES]
    plant.round("77 77")
    at = plant.control(UNSYNC)
    assert plant.take() == [(at, address, "77 77") for address in SLAVES]
    plant.exchange(4, "88 88")
    assert [change[1:] for change in plant.take()] == [(4, "88 88")]


def test_freeze_is_one_picture_of_all(plant: Plant) -> None:
    for _ in range(3):
        plant.control(FREEZE)
        seen = f"{plant.sensor:04x}"
        picture = f"{seen[:2]} {seen[2:]}"
        assert plant.round("11 11") == [picture] * 3
        assert plant.round("11 11") == [picture] * 3
    plant.control(UNFREEZE)
    assert len(set(plant.round("11 11"))) == 3


def test_sync_and_freeze_together_give_a_consistent_picture(plant: Plant) -> None:
    plant.control("28")
    plant.round("22 22")
    assert plant.take() == []
    at = plant.control("28")
    seen = f"{plant.sensor:04x}"
    assert plant.take() == [(at, address, "22 22") for address in SLAVES]
    assert plant.round("33 33") == [f"{seen[:2]} {seen[2:]}"] * 3


def test_sync_of_one_group_leaves_the_others_alone(plant: Plant) -> None:
    plant.control(SYNC, "02")  # slave 5 alone
    plant.round("22 22")
    assert [change[1:] for change in plant.take()] == [(3, "22 22"), (4, "22 22")]
    plant.control(SYNC, "01")  # all three are in group 1
    assert [change[1:] for change in plant.take()] == [(5, "22 22")]
    plant.round("33 33")
    plant.control(UNSYNC, "02")
    assert [change[1:] for change in plant.take()] == [(5, "33 33")]
    plant.control(SYNC, "04")  # nobody's
    assert plant.take() == []


def test_clear_goes_through_sync_in_one_telegram_and_operate_waits_for_the_next(plant: Plant) -> None:
    plant.control(SYNC)
    plant.round("22 22")
    at = plant.control(CLEAR)
    assert plant.take() == [(at, address, "00 00") for address in SLAVES]
    plant.round("33 33")
    plant.control(OPERATE)
    plant.round("44 44")
    assert plant.take() == []
    at = plant.control(SYNC)
    assert plant.take() == [(at, address, "44 44") for address in SLAVES]


def test_clear_and_sync_in_one_telegram(plant: Plant) -> None:
    """In Clear SYNC passes on zeros."""
    plant.control(SYNC)
    plant.round("22 22")
    at = plant.control("22")
    assert plant.take() == [(at, address, "00 00") for address in SLAVES]
    plant.control(SYNC)
    plant.round("33 33")
    assert plant.take() == []


def test_leaving_data_exchange_ends_the_modes(plant: Plant) -> None:
    plant.control("28")
    plant.ask(3, "3D 3E B8 0A 0A 0B 0A 35 01")
    plant.ask(3, "3E 3E 11 21")
    assert plant.request(framed(0x83, 0x82, plant.next_fc(3), "3C 3E")).data.hex(" ") == "00 0c 00 02 0a 35"
    plant.exchange(3, "66 66")
    assert plant.outputs == {3: "66 66", 4: "11 11", 5: "11 11"}


def test_the_watchdog_in_virtual_time_is_exact(plant: Plant) -> None:
    """10 x 10 x 10 ms after the last bit of the last request to each; safe outputs at that very instant."""
    ends = []
    for address in SLAVES:
        begin = plant.world.now
        plant.exchange(address, "22 22")
        ends.append(begin + 11 * BIT * 11)  # SD2 telegram of 2 octets: 9 + 2
    plant.take()
    plant.world.run_for(1100 * MS)
    assert plant.take() == [(end + 1000 * MS, address, "00 00") for end, address in zip(ends, SLAVES, strict=True)]
