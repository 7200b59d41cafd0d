"""The time line of a monitored bus: octets in, events out, in the order of the wire."""

from __future__ import annotations

import resource

import pytest
from bus_kit import SimBus
from support import MS, S

from dpstack.capture.listener import Listener
from dpstack.capture.timing import timing_of
from dpstack.capture.transmission import Transmission
from dpstack.fdl.codec import encode
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.parser import load_gsd
from dpstack.monitor import monitor as monitor_module
from dpstack.monitor.devices import Devices, KnownDevice
from dpstack.monitor.monitor import Happening, Monitor
from dpstack.params import BusParams
from dpstack.sim.world import World

BAUD = 500_000
EPOCH = 1_800_000_000 * S
DIAG = bytes.fromhex("68 05 05 68 83 82 6D 3C 3E EC 16")
#: Slave_Diag answer, flags of a slave in data exchange with extended diagnosis
EXT = bytes.fromhex("08 0C 00 02 12 34")
#: diagnosis alarm of slot 2, appears, sequence number 3; the same disappears, sequence number 4
APPEARS, GOES = bytes.fromhex("04 01 02 19"), bytes.fromhex("04 01 02 22")


class Line:
    """A monitor and the octets that it hears, one millisecond after the other."""

    def __init__(self, devices: Devices | None = None) -> None:
        self.events: list[Happening] = []
        self.monitor = Monitor(timing_of("tap", BAUD, exact=True), devices=devices, on_event=self.events.append)
        self.now = EPOCH
        self.baud = BAUD

    def send(self, *octets: bytes) -> None:
        for one in octets:
            self.monitor.add(Transmission(one, self.now, self.baud))
            self.now += MS

    def diagnosis(self, data: bytes) -> None:
        """Master 2 reads the diagnosis of slave 3."""
        self.send(DIAG, encode(Telegram(Kind.SD2, 2, 3, 0x08, 62, 60, data)))

    @property
    def told(self) -> list[tuple[str, str]]:
        return [(one.kind, one.text) for one in self.monitor.time_line]

    def jsons(self, kind: str) -> list[dict[str, object]]:
        return [one.as_dict(EPOCH) for one in self.events if one.as_dict(EPOCH)["event"] == kind]


def token(sender: int, receiver: int) -> bytes:
    return bytes((0xDC, receiver, sender))


def test_an_alarm_is_told_once_and_so_is_its_end() -> None:
    line = Line()
    for data in (EXT + APPEARS, EXT + APPEARS, EXT + GOES, EXT[:1] + b"\x0c" + EXT[2:]):
        line.diagnosis(data)
    first, second = line.jsons("alarm")
    expected = {"event": "alarm", "address": 3, "name": None, "type": 1, "title": "diagnosis alarm", "slot": 2}
    assert {key: first[key] for key in expected} == expected
    assert (first["specifier"], first["sequence"], first["user_ack"]) == ("appears", 3, False)
    assert (second["specifier"], second["sequence"]) == ("disappears", 4)
    assert ("alarm", "station 3: diagnosis alarm, slot 2, appears, slot disturbed") in line.told


def test_a_device_without_dpv1_has_no_alarms() -> None:
    line = Line(Devices(by_address={3: KnownDevice("pump", dpv1=False)}))
    line.diagnosis(EXT + APPEARS)
    assert line.jsons("alarm") == []
    assert line.told == [("diagnosis", "station 3 (pump): new diagnosis: ext_diag; device: 01 02 19")]


def test_a_diagnosis_in_the_words_of_a_gsd_file_and_its_end() -> None:
    gsd = '#Profibus_DP\nGSD_Revision = 1\nVendor_Name = "A"\nModel_Name = "B"\nIdent_Number = 0x1234\n'
    device = load_gsd((gsd + 'Unit_Diag_Bit(3) = "coil \x1b[2J open"\n').encode(), "a.gsd").device
    line = Line(Devices(by_ident={0x1234: KnownDevice(texts=DiagTexts(device), dpv1=False)}))
    line.diagnosis(EXT + b"\x02\x08")
    line.diagnosis(EXT + b"\x02\x08")
    line.diagnosis(b"\x00" + EXT[1:])
    (first, last) = line.jsons("diagnosis")
    assert (first["flags"], first["texts"]) == (["ext_diag", "wd_on"], ["coil \x1b[2J open"])
    assert last["flags"] == ["wd_on"]
    assert line.told[0][1].startswith("station 3: new diagnosis: ext_diag; coil")
    assert line.told[1] == ("diagnosis", "station 3: its diagnosis is clear")


def test_a_module_status_counts_the_slots_as_the_gsd_file_does() -> None:
    gsd = "#Profibus_DP\nGSD_Revision = 3\nIdent_Number = 0x1234\nModular_Station = 1\nModul_Offset = 0\n"
    device = load_gsd(gsd.encode(), "a.gsd").device
    line = Line(Devices(by_ident={0x1234: KnownDevice(texts=DiagTexts(device))}))
    line.diagnosis(EXT + bytes.fromhex("05 82 00 00 09"))
    said = "station 3: module status: slot 0 data invalid, slot 1 wrong module"
    assert ("status_message", said) in line.told


def test_masters_join_drop_out_and_change_their_mode() -> None:
    line = Line()
    for _ in range(3):
        line.send(token(2, 5), token(5, 2))
    line.send(encode(Telegram(Kind.SD2, 127, 2, 0x46, 58, 62, b"\x02\x00")))
    line.send(encode(Telegram(Kind.SD2, 127, 2, 0x46, 58, 62, b"\x00\x00")))
    for _ in range(8):
        line.send(token(2, 2))
    assert [kind for kind, _ in line.told] == ["joined", "joined", "mode", "mode", "left"]
    assert line.told[2:4] == [("mode", "master 2: is in Clear"), ("mode", "master 2: is in Operate")]
    assert line.told[4][1].startswith("master 5: dropped out of the token ring")
    assert [one["mode"] for one in line.jsons("mode")] == ["clear", "operate"]
    assert [one["address"] for one in line.jsons("ring")][-1] == 5


def test_another_rate_and_a_gap() -> None:
    line = Line()
    line.send(token(2, 2))
    line.baud = 1_500_000
    line.send(token(2, 2))
    line.monitor.gap(line.now, "the port was lost")
    assert [one for one in line.told if one[0] != "joined"] == [
        ("rate", "the bus runs at 1.5 Mbit/s now"),
        ("gap", "the port was lost"),
    ]
    assert line.jsons("notice")[0]["baud"] == 1_500_000
    assert line.jsons("gap") == [{"event": "gap", "t": 0.002, "text": "the port was lost"}]


def test_a_line_that_falls_silent() -> None:
    line = Line()
    for _ in range(4):
        line.send(token(2, 5), token(5, 2))
    line.monitor.tick(line.now + 10 * S)
    line.monitor.tick(line.now + 10 * S + 1)  # once a second is enough
    assert [text for kind, text in line.told if kind == "left"] == ["master 2: is silent", "master 5: is silent"]
    assert line.monitor.summary(line.now + 10 * S)["reasons"] == ["silent since 10.0 s: no master sends any more"]


def test_a_time_in_which_nothing_could_be_heard_is_no_silence() -> None:
    line = Line()
    for _ in range(4):
        line.send(token(2, 5), token(5, 2))
    heard = line.monitor.summary()["seconds"]
    line.monitor.lost(line.now, "the port was lost")
    line.monitor.tick(line.now + 30 * S)
    assert line.monitor.summary(line.now + 30 * S)["seconds"] == 0.008
    line.now += 60 * S
    line.monitor.back(line.now, "the port is back")
    line.monitor.tick(line.now + 1)
    line.send(token(2, 5), token(5, 2))
    assert [kind for kind, _ in line.told] == ["joined", "joined", "gap", "gap"]
    assert line.monitor.summary()["seconds"] == pytest.approx(float(str(heard)) + 0.002, abs=0.001)
    assert line.monitor.counters.masters[5].drops == 0


def _hours(line: Line, seconds: int) -> None:
    """A round with a retry, a damaged answer and another diagnosis each second."""
    request = [encode(Telegram(Kind.SD2, 3, 2, fc, None, None, b"\1\2")) for fc in (0x5D, 0x7D)]
    answer = encode(Telegram(Kind.SD2, 2, 3, 0x08, None, None, b"\3\4"))
    for second in range(seconds):
        line.send(token(2, 2), request[second & 1], request[second & 1], answer)
        line.send(request[second + 1 & 1], answer[:-2], request[second + 1 & 1], answer)
        line.diagnosis(EXT + bytes((4, 1, 2, second % 32 << 3 | 1)))
        line.now += S


def test_the_time_line_keeps_the_newest_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(monitor_module, "TIME_LINE", 50)
    line = Line()
    _hours(line, 70)
    happened = [one for one in line.events if not one.routine]
    assert list(line.monitor.time_line) == happened[-50:]
    assert line.monitor.left_out == len(happened) - 50 > 0


@pytest.mark.soak
def test_an_hour_of_a_full_bus_at_1_5_mbit_in_flat_memory() -> None:
    world = World(keep=10, referee=False)
    bus = SimBus(world, BusParams.preset(1_500_000, address=2), [3, 4, 5])
    assert world.run(world.now + 10 * S, lambda: bus.exchanging)
    second: list[Transmission] = []
    world.add(Listener(world.now, second.append, baud=1_500_000, epoch_ns=EPOCH), name="listener")
    world.run_for(1 * S)
    monitor = Monitor(timing_of("tap", 1_500_000, exact=True))
    add, used = monitor.add, 0
    for number in range(3_600):
        shift = number * S
        for octets, t_ns, baud, note, damage in second:
            add(Transmission(octets, (t_ns or 0) + shift, baud, note, damage))
        if number % 60 == 0:
            monitor.summary()
        if number == 300:
            used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    summary = monitor.summary()
    assert summary["telegrams"] == 3_600 * len(second)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - used < 4_000  # KiB
