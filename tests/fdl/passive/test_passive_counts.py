"""Counters and notices of a passive station, one telegram at a time, and the name of each damage."""

from __future__ import annotations

from dpstack.fdl.decoder import Decoder
from dpstack.fdl.interface import Reply, Responder
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Resp, Telegram
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
