"""Counters and notices of a passive station, one telegram at a time, and the name of each damage."""

from __future__ import annotations

from dpstack.fdl.decoder import Decoder
from dpstack.fdl.interface import Reply, Responder
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Resp, Telegram
from dpstack.machine import pump
from dpstack.params import BusParams
from dpstack.trace import Notice


class _Ok(Responder):
    def serve(self, request: Telegram, now: int) -> Reply:
        return Reply(Resp.OK)


def _sd2(*body: int) -> bytes:
    return bytes((0x68, len(body), len(body), 0x68, *body, sum(body) & 0xFF, 0x16))


def test_each_telegram_counts_once() -> None:
    station = PassiveStation(3, _Ok(), BusParams.preset(500_000))
    assert station.decoder_stats is station.decoder.stats
    station.receive(_sd2(3, 2, 0x4D, 7), 10**6)
    assert (station.stats.requests, station.stats.indications) == (1, 0)
    station.receive(_sd2(127, 2, 0x46, 7), 2 * 10**6)
    assert (station.stats.requests, station.stats.indications) == (1, 1)
    station.receive(_sd2(3, 2, 0x46, 7), 3 * 10**6)
    assert (station.stats.requests, station.stats.indications) == (1, 2)
    assert station.decoder_stats.telegrams == 3


def test_a_request_with_le_3_is_reported_with_the_name_of_the_station() -> None:
    station = PassiveStation(3, _Ok(), BusParams.preset(500_000))
    station.receive(_sd2(3, 2, 0x4D), 10**6)
    (notice,) = station.take_events()
    assert isinstance(notice, Notice)
    assert notice.source == "station 3"


def test_damage_has_its_name() -> None:
    told: list[tuple[str, int]] = []
    decoder = Decoder(stall_ns=1_000)
    decoder.on_bad = lambda name, times: told.append((name, times))
    decoder.feed(b"\x10\x03\x02\x49\x00\x16", 0)
    decoder.feed(b"\x00\x00", 5_000)
    assert told == [("bad_fcs", 1), ("bad_start", 2)]


class _Timed(_Ok):
    """An application with a deadline that each of its calls puts off."""

    def __init__(self) -> None:
        self.asked = 0
        self.due = 10**6
        self.ticks: list[int] = []

    def serve(self, request: Telegram, now: int) -> Reply:
        self.due = now + 10**6
        return super().serve(request, now)

    def tick(self, now: int) -> None:
        self.ticks.append(now)
        self.due += 10**6

    def wake_at(self) -> int:
        self.asked += 1
        return self.due


def test_the_station_asks_for_the_deadline_of_its_application_once_a_call_of_it() -> None:
    application = _Timed()
    station = PassiveStation(3, application, BusParams.preset(500_000))
    before = application.asked
    octets = bytes.fromhex("68 04 04 68 03 02 4D 07 59 16")
    answer_at = pump(station, octets, 500_000, lambda _octets, now: now)
    assert answer_at == 500_000 + station.t_sdr_ns
    assert pump(station, b"", answer_at, lambda octets, now: now + 2_000 * len(octets)) == 1_500_000
    assert application.asked == before + 1
    assert pump(station, b"", 1_499_999, lambda _octets, now: now) == 1_500_000
    assert application.ticks == []
    assert pump(station, b"", 1_500_000, lambda _octets, now: now) == 2_500_000
    assert application.ticks == [1_500_000]
    assert application.asked == before + 2
