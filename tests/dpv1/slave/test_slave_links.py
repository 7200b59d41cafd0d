"""Data exchange broadcast at a slave, in octets: publisher, subscriber, safe values, link status, wrong filters."""

from __future__ import annotations

import pytest
from octet_slave import frame

from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.events import RequestRefused
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.dxb_links import DxbSupport, LinkChanged, links_of_slave
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import ConfigError
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams

MS = 1_000_000
P500 = BusParams.preset(500_000)
#: 2 octets of inputs in slot 1, 4 octets of outputs in slot 2
CFG = bytes.fromhex("11 23")
#: subscriber table: octets 1..2 of the 3 of publisher 7 to octet 1 of slot 2
FILTER = bytes.fromhex("0B 07 00 00 01 07 03 01 02 01 02")
SAFE = b"\xa0\xa1\xa2\xa3"


class Rig:
    """A slave at address 5 and its master 2, in octets; ``seen``: the outputs that its function got."""

    def __init__(self, support: DxbSupport | None = None, *, safe: bytes | None = SAFE, name: str = "valve") -> None:
        support = DxbSupport(publisher=True, links=4) if support is None else support
        kind = SlaveDescription(ident=0x1234, name=name, configs=(CFG,), dpv1=True, dxb=support, fail_safe=True)
        self.seen: list[bytes] = []
        self.inputs = b"\x01\x02"
        self.app = SlaveApp(DpSlave(kind, self.cycle, safe=safe), address=5)
        self.station = PassiveStation(5, self.app, P500)
        self.now = 0
        self.fcb = 0x20
        self.first = True

    def cycle(self, outputs: bytes, _: int) -> bytes:
        self.seen.append(outputs)
        return self.inputs

    def ask(self, function: int, *body: bytes, saps: bytes = b"") -> bytes:
        fc = 0x60 | function if self.first else 0x50 | function | self.fcb
        self.first, self.fcb = False, self.fcb ^ 0x20
        flag = 0x80 if saps else 0
        octets = frame(bytes((5 | flag, 2 | flag, fc)) + saps + b"".join(body))
        self.now += MS
        self.station.receive(octets, self.now)
        self.now += MS
        self.run()
        return self.station.take_tx(self.now) or b""

    def run(self, until: int = 0) -> None:
        self.now = max(self.now, until)
        if self.station.wake_at() <= self.now:
            self.station.wake(self.now)

    def set_prm(self, user: bytes, wd: bytes = b"\x01\x0a") -> None:
        flags = b"\x88" if wd != b"\0\0" else b"\x80"
        assert self.ask(0x0D, flags, wd, b"\x0b\x12\x34\x00", user, saps=b"\x3d\x3e") == b"\xe5"

    def start(self, user: bytes = b"\xa0\x00\x08" + FILTER, *, operate: bool = True) -> Rig:
        self.set_prm(user)
        assert self.ask(0x0D, CFG, saps=b"\x3e\x3e") == b"\xe5"
        assert self.app.state is SlaveAppState.DATA_EXCH
        if operate:
            self.control(b"\x00")
        return self

    def exchange(self, outputs: bytes = b"\x11\x22\x33\x44") -> bytes:
        return self.ask(0x0D, outputs)

    def broadcast(self, data: bytes, publisher: int = 7) -> None:
        self.now += MS
        self.station.receive(frame(bytes((0x7F, publisher, 0x08)) + data), self.now)
        self.run()

    def control(self, command: bytes) -> None:
        self.now += MS
        self.station.receive(frame(b"\xff\x82\x46\x3a\x3e" + command + b"\x00"), self.now)

    @property
    def state(self) -> tuple[bool, bool, bytes]:
        (link,) = links_of_slave(self.app)
        return link.good, link.wrong_length, link.data

    @property
    def changes(self) -> list[str]:
        return [one.text for one in self.app.take_events() if isinstance(one, LinkChanged)]

    @property
    def refusals(self) -> list[str]:
        return [one.reason for one in self.app.take_events() if isinstance(one, RequestRefused)]

    def link_status(self) -> str:
        """The link status message that its master reads."""
        self.now += 2 * MS
        self.run()
        assert self.exchange()[6] == 0x0A  # DH
        return self.ask(0x0D, saps=b"\x3c\x3e")[15:-2].hex(" ")


def test_a_publisher_answers_msrd_to_all() -> None:
    rig = Rig().start(b"\xa0\x00\x00")
    assert rig.ask(0x07, b"\x01\x02\x03\x04").hex(" ") == "68 05 05 68 7f 05 08 01 02 8f 16"
    assert rig.seen[-1] == b"\x01\x02\x03\x04"
    assert rig.exchange().hex(" ") == "68 05 05 68 02 05 08 01 02 12 16"  # SRD as ever


def test_the_answer_to_a_repeated_msrd_is_repeated() -> None:
    rig = Rig().start(b"\xa0\x00\x00")
    rig.exchange()
    rig.inputs = b"\x05\x06"
    first = rig.ask(0x07, b"\x01\x02\x03\x04")
    rig.inputs = b"\x07\x08"
    rig.fcb ^= 0x20
    assert rig.ask(0x07, b"\x01\x02\x03\x04") == first
    assert rig.ask(0x07, b"\x01\x02\x03\x04")[7:9] == b"\x07\x08"
    assert rig.ask(0x07, b"\x01\x02\x03\x04")[7:9] == b"\x07\x08"


def test_a_publisher_that_is_not_enabled_is_silent_to_msrd() -> None:
    rig = Rig().start(b"\x80\x00\x00")
    assert rig.ask(0x07, b"\x01\x02\x03\x04") == b""
    assert rig.exchange()


def test_a_slave_that_cannot_publish_refuses_msrd() -> None:
    rig = Rig(DxbSupport(links=4)).start(b"\x80\x00\x00")
    assert rig.ask(0x07, b"\x01\x02\x03\x04").hex(" ") == "10 02 05 03 0a 16"


def test_values_of_a_publisher_act_as_outputs() -> None:
    rig = Rig().start()
    rig.broadcast(b"\x61\x62\x63")
    assert rig.seen == []  # no outputs before the first Data_Exchange
    rig.exchange()
    assert rig.seen[-1] == b"\x11\x62\x63\x44"
    rig.broadcast(b"\x71\x72\x73")
    assert rig.seen[-1] == b"\x11\x72\x73\x44"  # at once
    assert rig.app.outputs == b"\x11\x72\x73\x44"
    assert rig.state == (True, False, b"\x72\x73")
    seen = len(rig.seen)
    rig.broadcast(b"\x00\x72\x73")  # octets that it does not take
    assert len(rig.seen) == seen


def test_they_are_safe_before_the_master_says_operate() -> None:
    rig = Rig().start(operate=False)
    rig.exchange(b"\0\0\0\0")
    rig.broadcast(b"\x61\x62\x63")
    assert rig.seen[-1] == b"\x00\xa1\xa2\x00"
    rig.control(b"\x00")
    rig.exchange()
    assert rig.seen[-1] == b"\x11\x62\x63\x44"


def test_they_are_safe_before_the_first_valid_broadcast() -> None:
    rig = Rig().start()
    rig.exchange()
    assert rig.seen == [b"\x11\xa1\xa2\x44"]
    assert rig.state == (False, False, b"")


def test_they_are_safe_when_the_publisher_is_lost() -> None:
    rig = Rig().start()
    rig.exchange()
    rig.broadcast(b"\x61\x62\x63")
    for _ in range(30):  # its own master asks on, the publisher is silent: 100 ms
        rig.now += 2 * MS
        rig.exchange()
    assert rig.seen[-1] == b"\x11\xa1\xa2\x44"
    assert rig.changes == [
        "slave 5 (valve): data of publisher 7 come",
        "slave 5 (valve): publisher 7 is lost, its octets are safe: no valid broadcast for 100 ms",
    ]
    rig.broadcast(b"\x61\x62\x63")
    assert rig.seen[-1] == b"\x11\x62\x63\x44"


def test_they_are_safe_at_once_when_the_time_is_over() -> None:
    rig = Rig().start()
    rig.exchange()
    rig.broadcast(b"\x61\x62\x63")
    rig.exchange()
    heard = rig.now
    rig.exchange()
    while rig.now < heard + 90 * MS:
        rig.exchange()
    before = len(rig.seen)
    rig.run(heard + 100 * MS)  # no request of its master
    assert rig.seen[before:] == [b"\x11\xa1\xa2\x44"]


def test_they_are_safe_when_the_publisher_lies_about_its_length() -> None:
    rig = Rig().start()
    rig.exchange()
    rig.broadcast(b"\x61\x62\x63")
    for data in (b"\x61\x62", b"\x61\x62\x63\x64"):
        rig.broadcast(data)
        assert rig.seen[-1] == b"\x11\xa1\xa2\x44"
        assert rig.state == (False, True, b"\x62\x63")
    assert rig.changes[1:] == [
        "slave 5 (valve): publisher 7 is lost, its octets are safe: its broadcast has 2 octets, the filter says 3"
    ]
    rig.broadcast(b"\x61\x62\x63")
    assert rig.state == (True, False, b"\x62\x63")


def test_they_are_safe_in_clear_and_with_an_empty_frame() -> None:
    rig = Rig().start()
    rig.exchange()
    rig.broadcast(b"\x61\x62\x63")
    rig.control(b"\x02")
    assert rig.seen[-1] == SAFE
    rig.broadcast(b"\x71\x72\x73")
    assert rig.seen[-1] == SAFE
    rig.control(b"\x00")
    rig.exchange()
    assert rig.seen[-1] == b"\x11\x72\x73\x44"
    rig.exchange(b"")
    rig.broadcast(b"\x61\x62\x63")
    assert rig.seen[-1] == SAFE


def test_they_are_safe_at_the_slave_s_own_watchdog() -> None:
    rig = Rig().start()
    rig.exchange()
    for _ in range(40):  # the publisher goes on
        rig.now += 2 * MS
        rig.broadcast(b"\x61\x62\x63")
    rig.broadcast(b"\x61\x62\x63")
    rig.run(rig.now + 100 * MS)
    assert rig.app.state is SlaveAppState.WAIT_PRM
    assert rig.seen[-1] == SAFE
    rig.broadcast(b"\x71\x72\x73")
    assert rig.seen[-1] == SAFE
    assert links_of_slave(rig.app) == ()


def test_sync_holds_them_and_passes_them_on() -> None:
    rig = Rig().start()
    rig.exchange()
    rig.broadcast(b"\x61\x62\x63")
    rig.control(b"\x20")
    rig.broadcast(b"\x71\x72\x73")
    rig.exchange(b"\x55\x66\x77\x88")
    assert rig.seen[-1] == b"\x11\x62\x63\x44"
    rig.control(b"\x20")
    assert rig.seen[-1] == b"\x55\x72\x73\x88"


def test_the_link_status_message() -> None:
    """Publisher, then bit 7 Link_Status, 6 Link_Error, 0 Data_Exist."""
    rig = Rig().start()
    rig.exchange()
    rig.broadcast(b"\x61\x62\x63")
    assert rig.link_status() == "06 83 00 00 07 81"
    rig.broadcast(b"\x61")
    assert rig.link_status() == "06 83 00 00 07 40"
    rig.broadcast(b"\x61\x62\x63")
    assert rig.link_status() == "06 83 00 00 07 81"


def test_a_publisher_that_never_comes_is_reported_once() -> None:
    rig = Rig().start()
    for _ in range(100):
        rig.now += 2 * MS
        rig.exchange()
    assert rig.changes == ["slave 5 (valve): publisher 7 is lost, its octets are safe: no valid broadcast for 100 ms"]


def test_a_link_without_a_place_is_only_read() -> None:
    rig = Rig().start(b"\x80\x00\x08" + bytes.fromhex("09 03 00 00 01 07 03 01 02"))
    rig.exchange()
    rig.broadcast(b"\x61\x62\x63")
    assert rig.seen == [b"\x11\x22\x33\x44"]
    assert rig.state == (True, False, b"\x62\x63")


def test_the_filter_block_of_sinamics() -> None:
    rig = Rig().start(b"\x80\x00\x08" + bytes.fromhex("0C E2 00 00 E2 01 03 07 03 01 02 02"))
    rig.broadcast(b"\x61\x62\x63")
    rig.exchange()
    assert rig.seen == [b"\x11\x22\x62\x63"]


def test_other_broadcasts_are_none() -> None:
    rig = Rig().start()
    rig.exchange()
    rig.broadcast(b"\x61\x62\x63", publisher=8)
    rig.station.receive(frame(b"\xff\x87\x08\x3e\x3c\x61\x62\x63"), rig.now)  # with SAPs
    rig.station.receive(frame(b"\x7f\x07\x03\x61\x62\x63"), rig.now)  # RS
    rig.station.receive(frame(b"\x02\x07\x08\x61\x62\x63"), rig.now)  # to its master only
    assert rig.state == (False, False, b"")


TWO = bytes.fromhex("11 07 00 00 01 07 03 00 02 01 02 08 01 00 02 01 01")
BAD_FILTERS = [
    (TWO, "filter: link 2: publishers 7 and 8 both give output octet 1 of slot 2"),
    (bytes.fromhex("0B 07 00 00 01 05 03 01 02 01 02"), "a filter with publisher 5, which is this device itself"),
    (bytes.fromhex("0B 07 00 00 01 07 03 01 02 01 03"), "filter: link 1: octets 1..3 of a publisher with 3"),
    (
        bytes.fromhex("19 03 00 00 01") + bytes.fromhex("07 03 00 01") * 5,
        "a filter with 5 links, this device has memory for 4",
    ),
    (
        bytes.fromhex("09 03 00 00 01 07 F4 00 F4"),
        "a filter with 244 octets, this device has memory for 200",
    ),
    (bytes.fromhex("0B 07 00 00 01 07 03 01"), "octet 11: parameter block 1 says it has 11 octets"),
]


@pytest.mark.parametrize(("block", "reason"), BAD_FILTERS)
def test_filters_that_are_refused(block: bytes, reason: str) -> None:
    rig = Rig(DxbSupport(links=4, octets=200))
    rig.set_prm(b"\x80\x00\x08" + block)
    (found,) = rig.refusals
    assert reason in found
    assert rig.app.state is SlaveAppState.WAIT_PRM
    assert rig.app.diagnosis(rig.now).flags[-1:] == ("prm_req",) or rig.app.diag.prm_fault


def test_a_filter_without_watchdog_is_refused() -> None:
    rig = Rig()
    rig.set_prm(b"\x80\x00\x08" + FILTER, b"\0\0")
    (reason,) = rig.refusals
    assert "without WD_On" in reason


def test_what_the_device_cannot_is_refused() -> None:
    rig = Rig(DxbSupport(links=0))
    rig.set_prm(b"\xa0\x00\x00")
    rig.set_prm(b"\x80\x00\x08" + FILTER)
    first, second = rig.refusals
    assert "this device does not publish" in first
    assert "this device is no subscriber" in second


def test_a_place_beyond_its_slot_is_a_wrong_configuration() -> None:
    rig = Rig()
    rig.set_prm(b"\x80\x00\x08" + bytes.fromhex("0B 07 00 00 01 07 03 01 02 03 02"))
    rig.ask(0x0D, CFG, saps=b"\x3e\x3e")
    assert rig.refusals == ["link 1 gives output octets 3..4 of slot 2, which has 4 octets"]
    assert rig.app.diag.cfg_fault


def test_an_exception_at_a_broadcast_ends_data_exchange_with_safe_outputs() -> None:
    rig = Rig().start()
    rig.exchange()
    rig.inputs = b"too long"
    rig.broadcast(b"\x61\x62\x63")
    assert rig.app.failure is not None
    assert rig.app.data is None
    assert rig.seen[-1] == SAFE


def test_publisher_and_subscriber_behind_one_port() -> None:
    subscriber = Rig()
    publisher = Rig(name="encoder")
    publisher.station.set_address(7)
    line = Multidrop([subscriber.station, publisher.station], P500)
    now = 0

    def ask(address: int, fc: int, data: bytes, saps: bytes = b"") -> bytes:
        nonlocal now
        flag = 0x80 if saps else 0
        now += MS
        line.receive(frame(bytes((address | flag, 2 | flag, fc)) + saps + data), now)
        now += MS
        line.wake(now)
        octets = line.take_tx(now) or b""
        now += MS
        line.sent(now)
        return octets

    two = bytes.fromhex("0B 07 00 00 01 07 02 00 02 01 02")  # this publisher has two octets
    for address, user in ((5, b"\x80\x00\x08" + two), (7, b"\xa0\x00\x00")):
        ask(address, 0x6D, bytes.fromhex("88 01 0A 0B 12 34 00") + user, b"\x3d\x3e")
        ask(address, 0x5D, CFG, b"\x3e\x3e")
        ask(address, 0x7D, b"\x11\x22\x33\x44")
    line.receive(frame(b"\xff\x82\x46\x3a\x3e\x00\x00"), now + MS)  # Operate
    assert ask(7, 0x57, b"\x11\x22\x33\x44").hex(" ") == "68 05 05 68 7f 07 08 01 02 91 16"
    assert subscriber.seen[-1] == b"\x11\x01\x02\x44"


def test_a_description_with_more_links_than_its_diagnosis_has_room_for() -> None:
    with pytest.raises(ConfigError, match="has no room for the status of 29 links"):
        SlaveDescription(ident=1, configs=(CFG,), dpv1=True, max_diag_len=64, dxb=DxbSupport(links=29))
    with pytest.raises(ConfigError, match="dxb without dpv1"):
        SlaveDescription(ident=1, configs=(CFG,), dxb=DxbSupport(links=1))
    with pytest.raises(ConfigError, match=r"30 links of a subscriber: 0\.\.29"):
        DxbSupport(links=30)
