"""What a UART with parity check makes of damaged characters, by hand-counted bits."""

from __future__ import annotations

import pytest

from dpstack.phy.uart import flipped
from dpstack.sim import transmission as uart

BIT_500K = 2_000  # ns


@pytest.mark.parametrize(
    ("flips", "got"),
    [
        (0b000_0000_0001, None),  # start bit: the character is not seen
        (0b100_0000_0000, None),  # stop bit: framing error
        (0b000_0000_0010, None),  # one data bit: parity error
        (0b010_0000_0000, None),  # the parity bit alone
        (0b000_0000_0110, 0x68 ^ 0x03),  # two data bits: passes for another octet
        (0b010_0000_0010, 0x68 ^ 0x01),  # a data bit and the parity bit
        (0b010_0000_0110, None),  # three
        (0b001_1111_1110, 0x97),  # all eight data bits
    ],
)
def test_inverted_bits(flips: int, got: int | None) -> None:
    assert flipped(0x68, flips) == got


def test_octets_come_at_the_end_of_their_stop_bit() -> None:
    assert uart.receive(b"\x10\x20\x30", 500_000, {1: 0b10}) == [(11 * BIT_500K, 0x10), (33 * BIT_500K, 0x30)]


@pytest.mark.parametrize(
    ("elapsed", "octets"),
    [(0, 0), (21_999, 0), (22_000, 1), (43_999, 1), (44_000, 2), (66_000, 3), (1_000_000, 3)],
)
def test_complete_octets(elapsed: int, octets: int) -> None:
    assert uart.complete(elapsed, 500_000, 3) == octets


def test_complete_agrees_with_the_ends_at_odd_rates() -> None:
    for number, (end, _) in enumerate(uart.receive(bytes(250), 45_450, {})):
        assert uart.complete(end, 45_450, 250) == number + 1
        assert uart.complete(end - 1, 45_450, 250) == number
