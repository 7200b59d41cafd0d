"""Identifier octets against the examples of manuals (docs/reference/protocol.md#identifiers), and the watchdog
factors."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.dp.slave_params import WatchdogTime, watchdog_factors
from dpstack.errors import ConfigError
from dpstack.gsd.identifiers import Identifier, io_lengths, parse_identifiers


@pytest.mark.parametrize(
    ("octets", "inputs", "outputs"),
    [
        ("11", 2, 0),  # 2 octets in
        ("22", 0, 3),  # 3 octets out
        ("F3", 8, 8),  # 4 words in and out, consistent
        ("71", 4, 4),  # 2 words in and out
        ("21", 0, 2),  # pyprofibus#19
        ("F3 F1", 12, 12),  # PPO1
        ("F1", 4, 4),  # PPO3
        ("00", 0, 0),  # empty slot
        ("C3 C1 C1 FD 00 01", 4, 4),  # ABB FPBA-01 ST1: two words each way and three octets of the maker
        ("40 07", 8, 0),  # special, input only
        ("80 47", 0, 16),  # special, output only, words
        ("C0 83 C1", 4, 4),  # special: output 4 octets, input 2 words, both consistent
        ("CF 00 00", 1, 1),  # 15: no octets of the maker follow
        ("10 00 20", 1, 1),  # an empty slot between modules
    ],
)
def test_lengths(octets: str, inputs: int, outputs: int) -> None:
    assert io_lengths(bytes.fromhex(octets)) == (inputs, outputs)


@pytest.mark.parametrize(
    ("octets", "inputs", "outputs", "manufacturer"),
    [
        ("C3 C1 C1 FD 00 01", (4, True), (4, True), "FD 00 01"),  # the special format in full
        ("C0 81 02", (3, False), (2, True), ""),  # the length of outputs comes before that of inputs
        ("B0", (1, True), (1, True), ""),  # general format, consistent over the whole
        ("10", (1, False), (0, False), ""),
    ],
)
def test_lengths_consistency_and_manufacturer_octets(
    octets: str, inputs: tuple[int, bool], outputs: tuple[int, bool], manufacturer: str
) -> None:
    (identifier,) = parse_identifiers(bytes.fromhex(octets))
    whole = Identifier(bytes.fromhex(octets), inputs[0], outputs[0], inputs[1], outputs[1], bytes.fromhex(manufacturer))
    assert identifier == whole
    assert not identifier.empty


def test_several_identifiers_keep_their_octets() -> None:
    config = bytes.fromhex("F3 C3 C1 C1 FD 00 01 00 22")
    identifiers = parse_identifiers(config)
    assert [i.octets.hex() for i in identifiers] == ["f3", "c3c1c1fd0001", "00", "22"]
    assert identifiers[2].empty


@pytest.mark.parametrize(
    ("octets", "finding"),
    [
        ("C3", "identifier octet 0 .*missing"),
        ("C3 C1", "identifier octet 0 .*missing"),
        ("C3 C1 C1", "announces 3 manufacturer octets, 0 are left"),
        ("C3 C1 C1 FD 00", "announces 3 manufacturer octets, 2 are left"),
        ("11 40", "identifier octet 1 "),
        ("04 01 02", "announces 4 manufacturer octets, 2 are left"),
    ],
)
def test_truncated_ones_name_the_octet(octets: str, finding: str) -> None:
    with pytest.raises(ConfigError, match=finding):
        parse_identifiers(bytes.fromhex(octets))


@given(st.binary(max_size=244))
def test_any_octets_are_split_or_refused(config: bytes) -> None:
    try:
        identifiers = parse_identifiers(config)
    except ConfigError:
        return
    assert b"".join(i.octets for i in identifiers) == config
    assert io_lengths(config) == (sum(i.inputs for i in identifiers), sum(i.outputs for i in identifiers))
    assert all(0 <= i.inputs <= 128 and 0 <= i.outputs <= 128 for i in identifiers)


@pytest.mark.parametrize(
    ("ms", "effective_ms"),
    [(1, 10), (10, 10), (11, 20), (200, 200), (2550, 2550), (2560, 2560), (2570, 2580), (650_250, 650_250)],
)
def test_watchdog_factors(ms: int, effective_ms: int) -> None:
    """2570 ms: 257 is a prime above 255, so the next product of two factors is taken, 258 = 2 x 129."""
    factors = watchdog_factors(ms)
    assert all(1 <= factor <= 255 for factor in factors)
    assert WatchdogTime(factors).ns == effective_ms * 1_000_000


_PRODUCTS = sorted({a * b for a in range(1, 256) for b in range(1, 256)})


@given(st.integers(1, 650_250))
def test_the_watchdog_is_the_shortest_possible_one(ms: int) -> None:
    first, second = watchdog_factors(ms)
    ticks = -(-ms // 10)
    assert first * second == next(product for product in _PRODUCTS if product >= ticks)
