"""Entries of a tap become transmissions: times since 1970, telegrams in slow pieces, those of the program itself."""

from __future__ import annotations

from dpstack.api.listen.tap_cutter import TapCutter
from dpstack.capture.transmission import Transmission
from dpstack.units import chars_to_ns

POLL = bytes.fromhex("10 05 02 49 50 16")
LONG = b"\x68\xf9\xf9\x68" + bytes(249) + b"\0\x16"
EPOCH = 1_790_000_000_000_000_000


def test_a_long_telegram_at_a_slow_rate_comes_in_pieces_that_last_longer_than_a_silence() -> None:
    """An adapter on USB delivers 62 octets at a time: 71 ms at 9600 bit/s."""
    heard: list[Transmission] = []
    tap = TapCutter("a port", heard.append, lambda event: None)
    tap.begin(EPOCH, "run")
    now = 0
    for at in range(0, len(LONG), 62):
        piece = LONG[at : at + 62]
        now += chars_to_ns(len(piece), 9_600)
        tap.add(now, 9_600, piece, False)
    assert [(one.octets, one.t_ns) for one in heard] == [(LONG, EPOCH + now - chars_to_ns(len(LONG), 9_600))]


def test_octets_of_the_program_begin_a_telegram_and_another_epoch_counts_from_then_on() -> None:
    heard: list[Transmission] = []
    tap = TapCutter("a port", heard.append, lambda event: None)
    tap.begin(EPOCH, "run")
    tap.add(1_000_000, 500_000, POLL[:3], False)
    tap.add(1_200_000, 500_000, POLL, True)
    tap.begin(EPOCH + 7, "run")
    tap.add(2_000_000, 500_000, POLL, False)
    assert [(one.octets, bool(one.damage)) for one in heard] == [(POLL[:3], True), (POLL, False), (POLL, False)]
    assert heard[2].t_ns == EPOCH + 7 + 2_000_000 - chars_to_ns(len(POLL), 500_000)
