"""Verdicts and their reasons: counters in, words out. Every number of a reason is computed by hand here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from bus_kit import SimBus
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples
from support import S

from dpstack.capture.listener import Listener
from dpstack.capture.timing import LineTiming, timing_of
from dpstack.capture.transmission import Transmission
from dpstack.dp.master.events import SlaveState
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.parser import load_gsd
from dpstack.monitor.clock import SentTime
from dpstack.monitor.counters import Master, State, Station
from dpstack.monitor.devices import Devices, KnownDevice
from dpstack.monitor.monitor import Happening, Monitor
from dpstack.monitor.thresholds import Thresholds, limits
from dpstack.monitor.verdict import Verdict
from dpstack.monitor.verdicts import judge
from dpstack.params import BusParams
from dpstack.sim.transmission import Transmission as Sent
from dpstack.sim.world import World
from dpstack.text import json_text
from dpstack.units import NS_PER_US

BAUD = 500_000
EXACT = timing_of("tap", BAUD, exact=True)
NOW = 1_800_000_000 * S


class Bus(Monitor):
    """A minute of a bus without faults: master 2, slaves 3, 4 and 5 with 10 000 requests each. Tests spoil it."""

    def __init__(self, timing: LineTiming = EXACT, **more: object) -> None:
        super().__init__(timing, begun_ns=NOW - 60 * S, **more)  # type: ignore[arg-type]
        counters = self.counters
        counters.add(Transmission(bytes.fromhex("DC 02 02"), NOW, BAUD))
        counters.telegrams = 60_000
        counters.passed_tokens = counters.fitting_answers = 15_000
        counters.stations.setdefault(2, Station(2)).is_master = True
        counters.masters.setdefault(2, Master(2, mode="operate", slaves={3, 4, 5}))
        for address in (3, 4, 5):
            station = counters.stations[address] = Station(
                address, requests=10_000, answers=10_000, state=State.DATA_EXCHANGE, master=2
            )
            for _ in range(1_000):
                station.answer_ns.add(40 * NS_PER_US)
        self.history.look(counters, NOW - 59 * S)

    def __getitem__(self, address: int) -> Station:
        return self.counters.stations[address]

    def retries(self, address: int, count: int, *, damaged: int = 0, depth: int = 1) -> None:
        station = self[address]
        station.retry_depth[depth - 1] += count
        station.repetitions += depth * count
        station.requests += depth * count
        station.damaged += damaged
        station.no_answer += depth * count - damaged

    def verdict(self, address: int, now_ns: int = NOW) -> Verdict:
        return judge(self.heard(now_ns))[1][address]

    @property
    def bus(self) -> Verdict:
        return judge(self.heard(NOW))[0]


def test_a_bus_in_order_is_good() -> None:
    bus = Bus()
    found, stations = judge(bus.heard(NOW))
    assert (found, set(stations.values()), list(stations)) == (
        Verdict("good"),
        {Verdict("good")},
        [2, 3, 4, 5],
    )


def test_one_station_with_retries_in_bursts() -> None:
    bus = Bus()
    counters, history = bus.counters, bus.history
    for second in range(58):
        bus[5].requests += 1  # it is asked in each second
        bus[5].answers += 1
        if second in (20, 21):
            bus.retries(5, 150, damaged=100)
        history.look(counters, NOW - (58 - second) * S)
    # 300 retries of 10 058 exchanges, 200 of them answered in a damaged way
    assert bus.verdict(5) == Verdict(
        "critical",
        (
            "2.98 % of its requests needed a retry, its neighbours none: answers damaged or missing in bursts: "
            "look at its connector, its stub and the segment's end",
        ),
    )
    assert bus.verdict(3) == bus.verdict(4) == Verdict("good")
    assert bus.bus.level == "critical"
    assert bus.bus.reasons[0].startswith("station 5: 2.98 % of its requests")


def test_many_stations_at_once() -> None:
    bus = Bus()
    for second in range(58):
        for address in (3, 4, 5):
            bus[address].requests += 1
            bus[address].answers += 1
            if second == 30:
                bus.retries(address, 20)
        bus.history.look(bus.counters, NOW - (58 - second) * S)
    reason = bus.verdict(4).reasons[0]
    assert reason.startswith("0.199 % of its requests needed a retry, its neighbours 0.199 % at most: answers missing")
    assert "in bursts, together with other stations: look at the termination at both ends" in reason
    assert "3 stations failed in the same second, once: look at the termination at both ends" in bus.bus.reasons[0]


def test_spread_retries_of_several_stations() -> None:
    bus = Bus()
    for second in range(58):
        for address in (3, 4, 5):
            bus[address].requests += 1
            bus[address].answers += 1
            if second % 3 == address % 3:
                bus.retries(address, 1, damaged=1)
        bus.history.look(bus.counters, NOW - (58 - second) * S)
    assert "answers damaged spread over the time: look at its connector" in bus.verdict(3).reasons[0]
    assert "then at the termination" in bus.verdict(3).reasons[0]


def _deep(bus: Bus) -> None:
    bus.retries(3, 1, depth=2)


def _lost(bus: Bus) -> None:
    bus[3].lost = 1


def _often_lost(bus: Bus) -> None:
    bus[3].lost = 3
    bus[3].state = State.WAIT_READY


def _late(bus: Bus) -> None:
    bus[3].late = 10


def _refused(bus: Bus) -> None:
    bus[3].rs, bus[3].rr = 4, 16


def _diagnosis(bus: Bus) -> None:
    bus[3].diagnosis = bytes.fromhex("08 0C 00 02 12 34 02 01")


def _stat_diag(bus: Bus) -> None:
    bus[3].diagnosis = bytes.fromhex("00 0E 00 02 12 34")


@pytest.mark.parametrize(
    ("spoil", "level", "text"),
    [
        (_deep, "warning", "1 of them needed two or more"),
        (_lost, "warning", "left data exchange once, is back: look at its supply and its connector"),
        (_often_lost, "critical", "left data exchange 3 times, is not back"),
        (_late, "warning", "10 answers came after the master had given up: look at T_SL"),
        (_refused, "warning", "refused 20 requests (RS 4: service not active; RR 16: no"),
        (_diagnosis, "warning", "reports a diagnosis: ext_diag; device: 01: look at the device"),
        (_stat_diag, "warning", "reports a diagnosis: stat_diag (cannot give valid data): look"),
    ],
)
def test_findings_of_a_station(spoil: Callable[[Bus], None], level: str, text: str) -> None:
    bus = Bus()
    spoil(bus)
    found = bus.verdict(3)
    assert found.level == level
    assert any(text in reason for reason in found.reasons), found
    assert bus.bus.level == level


@pytest.mark.parametrize(
    ("state", "text"),
    [
        (State.OFFLINE, "does not answer any more: look at its power"),
        (State.SET_PRM, "is not in data exchange, its master brings it up again and again (now set_prm): look at"),
    ],
)
def test_a_slave_that_does_not_come_up(state: str, text: str) -> None:
    bus = Bus()
    bus[3].state = state
    bus.history.look(bus.counters, NOW)
    assert bus.verdict(3, NOW + 1 * S).level == "good"  # a bring-up takes its time
    assert bus.verdict(3, NOW + 11 * S).level == "critical"
    assert text in bus.verdict(3, NOW + 11 * S).reasons[0]


def test_a_refused_parameterisation_says_what_to_look_at() -> None:
    bus = Bus()
    bus[3].state = State.DIAGNOSIS
    bus[3].diagnosis = bytes.fromhex("40 05 00 02 12 34")
    bus.history.look(bus.counters, NOW - 20 * S)
    assert (
        "prm_fault, it refuses the parameters: compare ident number and parameters with its GSD file"
        in bus.verdict(3).reasons[0]
    )


def test_an_address_that_is_asked_and_never_answers() -> None:
    bus = Bus()
    # Slave_Diag 2 -> 9, twice, and a GAP poll of 10
    for number in range(2):
        octets = bytes.fromhex("68 05 05 68 89 82 6D 3C 3E F2 16")
        bus.add(Transmission(octets, NOW + number * S // 100, BAUD))
    bus.add(Transmission(bytes.fromhex("10 0A 02 49 55 16"), NOW + S // 10, BAUD))
    stations = judge(bus.heard(NOW + S))[1]
    assert stations[9].level == "critical"
    assert "is asked and never answers" in stations[9].reasons[0]
    assert 10 not in stations


def test_masters() -> None:
    bus = Bus()
    bus.counters.masters[2].mode = "clear"
    assert bus.verdict(2).level == "warning"
    assert "is in Clear, the outputs of its slaves are zero" in bus.verdict(2).reasons[0]
    bus.counters.masters[2].drops = 3
    assert bus.verdict(2).level == "critical"
    assert "dropped out of the token ring 3 times: look at its connector" in bus.verdict(2).reasons[0]


def test_a_master_that_is_silent() -> None:
    bus = Bus()
    bus.counters.masters[2].is_silent = True
    assert bus.verdict(2).level == "critical"
    assert "sends nothing any more, while others do" in bus.verdict(2).reasons[0]
    bus.counters.masters[2].slaves.clear()  # a class 2 master comes and goes
    assert bus.verdict(2).level == "warning"
    assert bus.verdict(2, NOW + 3 * S).level == "unknown"  # all are silent


def test_damaged_octets_on_the_bus() -> None:
    bus = Bus()
    bus.counters.damaged = {"fcs": 400, "short": 206}
    # 606 of 60 606 transmissions: 0.99990 %
    assert bus.bus.level == "warning"
    assert bus.bus.reasons[0].startswith("1 % of all transmissions are damaged (400 fcs, 206 short): look at the term")
    bus.counters.damaged = {"fcs": 607}
    assert bus.bus.level == "critical"


GSD = (
    '#Profibus_DP\nGSD_Revision = 1\nVendor_Name = "Acme"\nModel_Name = "Valves"\nIdent_Number = 0x1234\n'
    'Unit_Diag_Bit(3) = "coil open"\n'
)


def test_the_texts_of_a_gsd_file() -> None:
    texts = DiagTexts(load_gsd(GSD.encode(), "valves.gsd").device)
    bus = Bus(devices=Devices(by_ident={0x1234: KnownDevice(model="Acme Valves", texts=texts)}))
    bus[3].ident = 0x1234
    bus[3].diagnosis = bytes.fromhex("08 0C 00 02 12 34 02 08")
    assert bus.verdict(3).reasons == (
        "reports a diagnosis: ext_diag; coil open: look at the device and what is connected to it",
    )


def _slow(bus: Bus, bits: int) -> None:
    for _ in range(1_000):
        bus[3].answer_ns.add(bits * S // BAUD)


def test_t_sdr_against_the_gsd_file_and_t_sl() -> None:
    device = KnownDevice(max_tsdr={BAUD: 60, 1_500_000: 200})
    bus = Bus(devices=Devices(by_address={3: device, 4: device}, t_sl={BAUD: 200}))
    _slow(bus, 100)
    assert bus.verdict(4).level == "good"
    assert [reason.partition(":")[0] for reason in bus.verdict(3).reasons] == [
        "answers after 100 bit times (p99), its GSD file allows 60 at 500 kbit/s"
    ]
    _slow(bus, 190)
    assert "answers after 190 bit times at most, the master waits T_SL = 200" in " ".join(bus.verdict(3).reasons)


@pytest.mark.parametrize("timing", [timing_of("adapter", BAUD), timing_of("host", BAUD), LineTiming("file", None)])
def test_no_verdict_rests_on_what_the_source_cannot_time(timing: LineTiming) -> None:
    bus = Bus(timing, devices=Devices(by_address={3: KnownDevice(max_tsdr={BAUD: 60})}, t_sl={BAUD: 200}))
    _slow(bus, 190)
    past = bus.history.of(3)
    past.first_tsdr, past.last_tsdr = 20_000, 200_000
    assert bus.verdict(3) == Verdict("good")


def test_no_verdict_rests_on_answers_that_arrived_together() -> None:
    bus = Bus(devices=Devices(by_address={3: KnownDevice(max_tsdr={BAUD: 60})}))
    _slow(bus, 100)
    bus.counters.together = 7_000  # of 60 000
    assert bus.verdict(3).level == "good"
    bus.counters.together = 5_000
    assert bus.verdict(3).level == "warning"


def test_t_sdr_against_the_past_of_the_station() -> None:
    bus = Bus()
    bus.history.look(bus.counters, NOW + 61 * S)  # the first minute: 20 bit times
    _slow(bus, 35)
    bus.history.look(bus.counters, NOW + 122 * S)
    assert bus.verdict(3, NOW + 1).reasons == (
        "answers after 35 bit times, in its first minute 20: look at the load of the device",
    )
    assert bus.verdict(4, NOW + 1).level == "good"


def test_unknown() -> None:
    short = Monitor(EXACT, begun_ns=NOW - 3 * S)
    assert judge(short.heard(NOW))[0] == Verdict(
        "unknown", ("nothing was heard: look at power, cable, A and B, the rate, and whether a master runs",)
    )
    short.add(Transmission(b"\x55\x55", NOW, BAUD))
    assert "1 transmissions, none of them a telegram" in judge(short.heard(NOW))[0].reasons[0]
    bus = Bus()
    assert judge(bus.heard(NOW + 10 * S))[0].reasons == ("silent since 10.0 s: no master sends any more",)
    bus = Bus(thresholds=Thresholds(min_seconds=100))
    assert bus.bus == Verdict("unknown", ("too little was heard: 60.0 s, 100 s are needed",))
    # the figure in the message is never the one that is needed
    bus = Bus(thresholds=Thresholds(min_seconds=60))
    assert judge(replace(bus.heard(), seconds=59.97))[0].level == "good"
    assert judge(replace(bus.heard(), seconds=59.94))[0].reasons == ("too little was heard: 59.9 s, 60 s are needed",)
    bus = Bus()
    bus[3].requests = 100
    assert bus.verdict(3) == Verdict("unknown", ("too little was heard: 100 requests, 200 are needed",))
    bus[3].state = State.UNKNOWN
    assert bus.verdict(3) == Verdict("unknown", ("no master exchanges data with it",))
    assert bus.bus.level == "good"


def test_an_adapter_is_no_finer_than_the_pieces_in_which_it_delivers() -> None:
    monitor = Monitor(timing_of("adapter", BAUD))
    token = bytes.fromhex("DC 02 02")
    for piece in range(100):
        for number in range(240):  # tokens of 66 us, without a gap
            monitor.add(Transmission(token, NOW + piece * 20_000_000 + number * 66_000, BAUD))
    timing = monitor.heard().timing
    assert timing.batched == pytest.approx(239 / 240)
    # 239 tokens after the first one of a piece
    assert timing.line.resolution_ns == pytest.approx(239 * 66_000, rel=0.01)
    assert timing.neighbours(monitor.counters.masters[2].token_ns) is None


def test_durations_begin_anew_at_another_rate() -> None:
    bus = Bus(devices=Devices(by_address={3: KnownDevice(max_tsdr={1_500_000: 60})}))
    _slow(bus, 50)  # 100 us, which are 150 bit times at 1.5 Mbit/s
    bus.counters.add(Transmission(bytes.fromhex("DC 02 02"), NOW + 1, 1_500_000))
    assert bus[3].answer_ns.count == 0
    assert bus.history.of(3).first_tsdr is None
    assert not any("MaxTsdr" in reason or "bit times" in reason for reason in bus.verdict(3).reasons)


def test_a_slave_that_nobody_parameterises() -> None:
    bus = Bus()
    bus[3].state, bus[3].master = State.DIAGNOSIS, None
    bus.history.look(bus.counters, NOW - 20 * S)
    assert bus.verdict(3) == Verdict("unknown", ("no master exchanges data with it",))


def test_too_little_evidence_for_profibus() -> None:
    bus = Bus()
    bus.counters.passed_tokens = bus.counters.fitting_answers = 0
    bus[3].lost = 5
    bus.counters.damaged = {"fcs": 60_000}
    assert bus.bus.level == bus.verdict(3).level == "unknown"
    assert "M-Bus" in bus.bus.reasons[0]


def test_every_threshold_has_values_that_it_allows() -> None:
    names = [limit.name for limit in limits()]
    assert len(names) == len(set(names))
    for limit in limits():
        assert limit.low <= limit.default <= limit.high
        assert limit.source
        assert getattr(replace(Thresholds(), **{limit.name: limit.high}), limit.name) == limit.high


def test_a_connector_and_an_absent_slave_on_a_simulated_bus() -> None:
    """The world damages every 25th answer of slave 4 in two short times; nobody is at address 5."""
    world = World(keep=10, referee=False)
    params = BusParams.preset(93_750, address=2)
    bus = SimBus(world, params, [3, 4, 5, 6], silent=[5])
    monitor = Monitor(timing_of("tap", 93_750, exact=True))
    world.add(Listener(world.now, monitor.add, baud=93_750, epoch_ns=NOW), name="listener")
    world.run_for(4 * S)
    answers = 0

    def some_of_slave_4(tx: Sent) -> bool:
        nonlocal answers
        answers += tx.octets[5:6] == b"\x84" or tx.octets[5:6] == b"\x04"
        return (tx.octets[5:6] == b"\x04" and answers % 4 == 0) and len(tx.octets) > 6

    world.faults.damage(some_of_slave_4, octet=-2, flips=0b110, times=8)
    world.run_for(14 * S)
    assert bus.state(4) is SlaveState.DATA_EXCHANGE
    found, stations = judge(monitor.heard())
    assert {address: one.level for address, one in stations.items()} == {
        2: "good", 3: "good", 4: "warning", 5: "critical", 6: "good",
    }  # fmt: skip
    assert (
        " of its requests needed a retry, its neighbours none: answers damaged in bursts: look at its connector"
        in (stations[4].reasons[0])
    )
    assert stations[5].reasons[0].startswith("is asked and never answers: look at its power")
    assert found.level == "critical"
    assert sum(monitor.counters.stations[4].retry_depth) == 8


OCTETS = st.one_of(
    st.binary(max_size=12),
    st.sampled_from(
        [
            bytes.fromhex(text)
            for text in (
                "DC 02 02", "DC 05 02", "DC 02 05", "E5", "68 05 05 68 83 82 6D 3C 3E EC 16", "10 03 02 49 4E 16",
                "68 0B 0B 68 82 83 08 3E 3C 02 05 00 FF 12 34 D3 16", "10 03 02 5D 62 16", "10 03 02 7D 82 16",
                "68 04 04 68 02 03 08 AA B7 16", "10 02 03 03 08 16", "10 02 03 02 07 16",
            )
        ]
    ),
)  # fmt: skip


@given(
    st.lists(
        st.builds(
            Transmission,
            OCTETS,
            st.one_of(st.none(), st.integers(0, 10**10), st.integers(0, 1 << 70)),
            st.sampled_from((0, 500_000, 500_000, 12_000_000, 1)),
            st.just(""),
            st.sampled_from((0, 0, 1 << 24)),
        ),
        max_size=30,
    )
)
@examples(40)
def test_nothing_that_is_heard_makes_it_fail(heard: list[Transmission]) -> None:
    """Times that run backwards, rates that change, damage: there is always a summary that JSON has."""
    events: list[Happening] = []
    monitor = Monitor(EXACT, on_event=events.append)
    for one in heard:
        monitor.add(one)
    summary = monitor.summary()
    json_text([summary, *(one.as_dict(monitor.begun_ns) for one in events)])
    assert summary["verdict"] in ("good", "warning", "critical", "unknown")
    assert 0 <= summary["load"] <= 1  # type: ignore[operator]
    assert summary["seconds"] >= 0  # type: ignore[operator]


def test_two_clock_masters_and_a_clock_that_nobody_keeps() -> None:
    bus = Bus()
    value = bytes.fromhex("e81b2c80 80000000 e81b2c76 80000000 00 01")
    bus.counters.masters[2].clock = clock = SentTime()
    clock.event(NOW)
    clock.clock_value(value, NOW)
    reason = "sends the time, but its own clock is not synchronised (SYF): look at its time server"
    assert bus.verdict(2) == Verdict("warning", (reason,))
    bus.counters.masters[7] = Master(7, clock=SentTime())
    found, _ = judge(bus.heard(NOW))
    assert "master 2 and master 7 send the time: devices follow one of them or jump; let one send it" in found.reasons
