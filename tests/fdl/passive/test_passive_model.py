"""A passive station against a model in octets, its clock to the nanosecond, and several stations behind one port."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.interface import RS_REPLY, SC_REPLY, Reply
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Resp
from dpstack.machine import LineDown, LineUp
from dpstack.params import BusParams
from dpstack.phy.patience import Patience
from dpstack.units import NEVER
from tests.fdl.passive_kit import BIT, Application

PARAMS = BusParams.preset(500_000)  # T_SL 200, min T_SDR 11
SLOT = 200 * BIT

#: what the application replies, and the octets from station 3 to master 2 or 9 (SAPs of the request exchanged)
REPLIES = [
    Reply(Resp.DL, b"\x99"),
    Reply(Resp.DH, b"\x98\x97"),
    Reply(Resp.DL),
    Reply(Resp.DH),
    Reply(Resp.OK),
    Reply(Resp.RS),
    Reply(Resp.UE),
    SC_REPLY,
    None,
]


def telegram(da: int, sa: int, fc: int, data: bytes = b"", saps: bytes = b"") -> bytes:
    body = bytes((da | (0x80 if saps else 0), sa | (0x80 if saps else 0), fc)) + saps + data
    tail = bytes((sum(body) & 0xFF, 0x16))
    if len(body) == 3:
        return b"\x10" + body + tail
    return bytes((0x68, len(body), len(body), 0x68)) + body + tail


@dataclass
class Model:
    """The responder of EN 50170-2: the frame count bit, the services, the answers; octets only."""

    kept: tuple[int, int, bytes | None] | None = None  # master, FCB, answer
    counts: dict[str, int] = field(default_factory=dict)
    calls: int = 0

    def count(self, name: str) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1

    def hears(self, da: int, sa: int, fc: int, saps: bytes, reply: Reply | None) -> bytes | None:
        if fc < 0x40:  # a response
            return None
        function = fc & 0xF
        if da == 127:
            if function in (0, 4, 6):
                self.count("indications")
            return None
        if da != 3 or sa == 3:
            return None
        if fc & 0x10 and self.kept and self.kept[:2] == (sa, fc & 0x20) and function in (3, 5, 7, 12, 13):
            self.count("repeats")
            return self.kept[2]
        self.kept = None
        if function in (3, 5, 12, 13, 14):
            self.count("requests")
            self.calls += 1
            answer = None if reply is None else self.octets(sa, saps, reply)
        elif function in (7, 15):
            answer = self.octets(sa, saps, RS_REPLY)
        elif function == 9:
            self.count("status")
            return telegram(sa, 3, 0x00)
        else:
            if function in (4, 6):
                self.count("indications")
            return None
        if fc & 0x30:
            self.kept = (sa, fc & 0x20, answer)
        return answer

    def octets(self, sa: int, saps: bytes, reply: Reply) -> bytes:
        if reply.short:
            return b"\xe5"
        if reply.data or reply.status in (8, 10):
            return telegram(sa, 3, reply.status, reply.data, saps[::-1])
        if reply.status:
            self.count("refused")
        return telegram(sa, 3, reply.status)


STEPS = st.tuples(
    st.sampled_from([3, 3, 3, 3, 4, 127]),
    st.sampled_from([2, 2, 9, 3]),
    st.sampled_from(
        [0x6D, 0x5D, 0x7D, 0x6C, 0x5C, 0x63, 0x55, 0x49, 0x4E, 0x47, 0x57, 0x4F, 0x46, 0x44, 0x40, 0x08, 0x4D]
    ),
    st.booleans(),
    st.sampled_from(REPLIES),
)


@examples(50)
@given(st.lists(STEPS, max_size=12))
def test_answers_and_counters_are_those_of_the_model(steps: list[tuple[int, int, int, bool, Reply | None]]) -> None:
    model, application = Model(), Application()
    station = PassiveStation(3, application, PARAMS)
    now = 0
    for da, sa, fc, with_saps, reply in steps:
        now += 10_000 * BIT
        saps = b"\x3c\x3e" if with_saps else b""
        application.replies = [reply]
        station.receive(telegram(da, sa, fc, b"\x01", saps), now)
        expected = model.hears(da, sa, fc, saps, reply)
        due = NEVER if expected is None else now + 11 * BIT
        assert (station.answer_at(), station.wake_at()) == (due, due)
        assert station.take_tx(now + 11 * BIT - 1) is None
        assert station.take_tx(now + 11 * BIT) == expected
        assert station.take_tx(now + 11 * BIT) is None
    assert len(application.served) == model.calls
    names = ("requests", "repeats", "status", "indications", "refused")
    assert {name: getattr(station.stats, name) for name in names if getattr(station.stats, name)} == model.counts


def test_a_new_master_parameters_and_a_new_address_end_the_kept_answer() -> None:
    first, again = telegram(3, 2, 0x6D, b"\x01"), telegram(3, 2, 0x7D, b"\x01")
    for between, repeats in (
        (lambda station: None, 1),
        (lambda station: station.set_address(3), 0),
        (lambda station: station.set_params(PARAMS), 0),
        (lambda station: station.command(LineDown("x"), 0), 0),
        (lambda station: station.command(LineUp(), 0), 0),
        (lambda station: station.receive(telegram(3, 9, 0x49), 10**7), 0),
        (lambda station: station.receive(telegram(4, 9, 0x49), 10**7), 1),
    ):
        station = PassiveStation(3, Application(), PARAMS)
        station.receive(first, 10**6)
        between(station)
        station.receive(again, 10**8)
        assert station.stats.repeats == repeats


# --- the clock -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("own", "given", "bits"),
    [(None, 0, 11), (11, 0, 11), (30, 0, 30), (None, 60, 60), (30, 20, 30), (30, 60, 60), (None, 5, 11)],
)
def test_the_time_before_an_answer(own: int | None, given: int, bits: int) -> None:
    station = PassiveStation(3, Application(), PARAMS, t_sdr=own)
    station.set_min_tsdr(given)
    assert station.t_sdr_ns == bits * BIT
    station.set_params(BusParams.preset(1_500_000))
    assert station.t_sdr_ns == (bits * 2_000 + 1) // 3
    assert station.baud == 1_500_000
    station.set_min_tsdr(0)
    assert station.t_sdr_ns == (bits * 2_000 + 1) // 3


def test_min_tsdr_of_the_bus_counts_until_set_prm_gives_one() -> None:
    params = BusParams.preset(500_000).replace(min_tsdr=25)
    station = PassiveStation(3, Application(), params)
    assert station.t_sdr_ns == 25 * BIT
    station.set_min_tsdr(12)
    assert station.t_sdr_ns == 12 * BIT


@pytest.mark.parametrize("t_sdr", [10, 0, -1])
def test_a_time_that_is_too_short(t_sdr: int) -> None:
    with pytest.raises(ConfigError) as refused:
        PassiveStation(3, Application(), PARAMS, t_sdr=t_sdr)
    assert str(refused.value) == f"station 3: t_sdr = {t_sdr} bit times; 11 is the least"


@pytest.mark.parametrize("address", [-1, 127])
def test_an_address_that_is_none(address: int) -> None:
    with pytest.raises(ConfigError) as refused:
        PassiveStation(address, Application(), PARAMS)
    assert str(refused.value) == f"station address {address}: must be 0..126"
    assert repr(PassiveStation(126, Application(), PARAMS)) == "<PassiveStation 126>"
    assert PassiveStation(0, Application(), PARAMS).address == 0


REQUEST = telegram(3, 2, 0x6D, b"\x01")


def test_octets_behind_the_request_hold_the_answer_until_they_stall() -> None:
    """An unfinished telegram stalls after 33 bits; the answer goes out T_SDR later."""
    station = PassiveStation(3, Application(), PARAMS)
    station.receive(REQUEST + b"\x68", 1_000)
    assert (station.wake_at(), station.answer_at()) == (1_000 + 33 * BIT, 1_000 + 11 * BIT)
    assert station.take_tx(1_000 + 11 * BIT) is None
    station.wake(1_000 + 33 * BIT - 1)
    assert station.decoder.pending
    station.wake(1_000 + 33 * BIT)
    assert not station.decoder.pending
    assert station.take_tx(1_000 + 33 * BIT) == telegram(2, 3, 0x08, b"\x99")


@pytest.mark.parametrize(("t_sdr", "limit"), [(11, SLOT), (250, 250 * BIT)])
def test_an_answer_that_noise_delays_past_the_slot_time_is_dropped(t_sdr: int, limit: int) -> None:
    for late, dropped in ((limit, 0), (limit + 1, 1)):
        station = PassiveStation(3, Application(), PARAMS, t_sdr=t_sdr)
        station.receive(REQUEST, 1_000)
        station.drop_if_late(1_000 + late)
        assert station.stats.dropped == dropped
    station.drop_if_late(1_000 + 10 * limit)
    assert station.stats.dropped == 1


def test_an_edge_drops_the_answer_and_begins_the_silence_anew() -> None:
    station = PassiveStation(3, Application(), PARAMS)
    station.receive(REQUEST, 1_000)
    station.activity(1_500)
    assert (station.answer_at(), station.stats.dropped, station.line.idle_since) == (NEVER, 1, 1_500)
    station.activity(1_600)
    assert station.stats.dropped == 1
    station.receive(REQUEST, 5_000)
    station.receive(telegram(4, 2, 0x49), 6_000)  # for another station: its master no longer waits
    assert (station.answer_at(), station.stats.dropped) == (NEVER, 2)


def test_the_application_is_called_at_its_deadline() -> None:
    application = Application()
    station = PassiveStation(3, application, PARAMS)
    application.due = 5_000
    station.poke()
    assert station.wake_at() == 5_000
    station.wake(4_999)
    assert application.ticks == []
    station.receive(REQUEST, 4_000)
    assert station.wake_at() == 5_000
    application.due = 4_000 + 11 * BIT + 1
    station.poke()
    assert station.wake_at() == 4_000 + 11 * BIT
    application.due = 5_000
    station.poke()
    station.wake(5_000)
    assert application.ticks == [5_000]


def test_the_slack_of_the_port_is_in_the_stall_time() -> None:
    station = PassiveStation(3, Application(), PARAMS, patience=Patience(stall_ns=7))
    assert station.decoder.stall_ns == 33 * BIT + 7
    station.sent(99)
    assert station.line.idle_since == 99


# --- several stations ------------------------------------------------------------------------------------------------
def port(
    *addresses: int, t_sdr: int | None = None
) -> tuple[Multidrop, dict[int, PassiveStation], dict[int, Application]]:
    applications = {address: Application() for address in addresses}
    stations = {address: PassiveStation(address, applications[address], PARAMS, t_sdr=t_sdr) for address in addresses}
    return Multidrop(stations.values(), PARAMS), stations, applications


def test_the_stations_of_a_port() -> None:
    line, stations, applications = port(5, 3)
    assert line.stations == (stations[3], stations[5])
    assert line.wake_at() == NEVER
    with pytest.raises(ConfigError) as refused:
        Multidrop([stations[3], PassiveStation(3, Application(), PARAMS)], PARAMS)
    assert str(refused.value) == "two stations with address 3 on one port: give one of them another address"
    with pytest.raises(ConfigError) as refused:
        line.add(PassiveStation(4, Application(), BusParams.preset(9_600)))
    assert str(refused.value) == "station 4 listens at 9600 bit/s, the port at 500000"
    for call in (line.remove, line.silence, line.resume, line.silent_until):
        with pytest.raises(UsageError) as unknown:
            call(PassiveStation(9, Application(), PARAMS))
        assert str(unknown.value) == "station 9 is not on this port; there are: 3, 5"
    line.remove(stations[5])
    line.remove(stations[3])
    assert line.wake_at() == NEVER
    with pytest.raises(UsageError, match="there are: none"):
        line.remove(stations[3])
    applications[3].due = 77
    line.add(stations[3])
    assert line.wake_at() == 77


def test_a_silenced_station_neither_hears_nor_answers_until_its_time() -> None:
    line, stations, applications = port(3)
    three = stations[3]
    line.receive(REQUEST, 1_000)
    line.silence(three, 9_000)
    assert (line.wake_at(), line.silent_until(three)) == (NEVER, 9_000)
    line.receive(REQUEST, 8_999)
    assert len(applications[3].served) == 1
    line.receive(REQUEST, 9_000)
    assert (len(applications[3].served), line.silent_until(three)) == (2, None)
    line.silence(three)
    assert line.silent_until(three) == NEVER
    line.resume(three)
    line.resume(three)
    assert line.silent_until(three) is None


def test_octets_of_a_faulty_station_go_out_at_their_time() -> None:
    line, stations, applications = port(3, 4)
    line.send_at(stations[3], b"\x02", 2_000)
    line.send_at(stations[4], b"\x01", 1_000)
    line.send_at(stations[4], b"\x03", 2_000)
    assert line.wake_at() == 1_000
    applications[3].due = 900
    line.poke()
    assert line.wake_at() == 900
    applications[3].due = NEVER
    line.poke()
    assert line.take_tx(999) is None
    assert line.take_tx(1_500) == b"\x01"
    assert line.take_tx(1_500) is None
    line.receive(REQUEST, 1_600)  # its answer is due later
    assert line.wake_at() == 2_000
    line.remove(stations[4])
    assert [line.take_tx(2_000), line.take_tx(2_000)] == [b"\x02", None]
    line.send_at(stations[3], b"\x05", 30_000)
    assert line.wake_at() == 1_600 + 11 * BIT
    line.command(LineDown("x"), 1_700)
    assert line.wake_at() == NEVER


def test_deadlines_of_the_applications() -> None:
    line, _, applications = port(3, 4)
    applications[3].due, applications[4].due = 500, 700
    line.poke()
    line.wake(499)
    assert applications[3].ticks == []
    line.wake(500)
    assert (applications[3].ticks, applications[4].ticks) == ([500], [])
    assert line.wake_at() == (500 if applications[3].due == 500 else 700)
    applications[3].due = NEVER
    line.poke()
    assert line.wake_at() == 700
    line.receive(telegram(4, 2, 0x46, b"\x01"), 600)
    assert line.wake_at() == 700
    applications[4].due = 900
    line.receive(telegram(4, 2, 0x46, b"\x01"), 650)
    assert line.wake_at() == 900
    applications[4].due = 800
    line.receive(telegram(4, 2, 0x46, b"\x01"), 660)
    assert line.wake_at() == 800


def test_one_answer_at_a_time() -> None:
    line, stations, _ = port(3, 4)
    line.receive(REQUEST + b"\x68", 1_000)
    assert line.take_tx(1_000 + 11 * BIT) is None
    assert line.wake_at() == 1_000 + 33 * BIT
    line.wake(1_000 + 33 * BIT)
    assert line.take_tx(1_000 + 33 * BIT) == telegram(2, 3, 0x08, b"\x99")
    line.receive(REQUEST, 200_000)
    line.receive(telegram(9, 2, 0x49), 210_000)
    assert stations[3].stats.dropped == 1
    assert line.take_tx(10**9) is None
    line.receive(REQUEST + b"\x68", 300_000)
    line.wake(300_000 + SLOT + 1)
    assert stations[3].stats.dropped == 2
