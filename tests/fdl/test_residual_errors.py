"""What no UART and no check sum can see: how often a damaged telegram passes for a sound one, counted out.

The figures are those of docs/bus-parameters.md. A character with an error of an odd number of bits is dropped, so it
takes two inverted bits in each of two octets, and the two changes have to cancel in the sum.
"""

from __future__ import annotations

from itertools import combinations

import pytest

from dpstack.fdl.codec import decode
from dpstack.fdl.decoder import Decoder
from dpstack.fdl.telegram import Kind
from dpstack.phy.uart import flipped

#: a Data_Exchange answer with twelve octets, a status answer, and one of a slave with SAPs
ANSWER = bytes.fromhex("68 0F 0F 68 02 05 08 C4 1B 07 F0 5A 33 9E 62 D8 01 7F A6 70 16")
STATUS = bytes.fromhex("10 02 63 00 65 16")
DIAG = bytes.fromhex("68 0B 0B 68 E3 82 08 3E 3C 02 05 00 FF 0C DA D3 16")
#: two of the nine bits that the parity covers, as masks of a character
PAIRS = [1 << one | 1 << other for one, other in combinations(range(1, 10), 2)]


@pytest.mark.parametrize("octets", [ANSWER, STATUS, DIAG], ids=["exchange", "status", "diagnosis"])
def test_damage_to_one_octet_gives_no_wrong_data(octets: bytes) -> None:
    """Up to three errors are always noticed; four can make another start octet: of a token, or of the same in SD3."""
    sound = decode(octets)
    assert sound is not None
    for number, octet in enumerate(octets):
        before, behind = octets[:number], octets[number + 1 :]
        for got in [None, *range(256)]:
            if got == octet:
                continue
            decoder = Decoder(stall_ns=1)
            found = decoder.feed(before + (b"" if got is None else bytes([got])) + behind, 0) + decoder.stalled(1)
            errors = 1 if got is None else (octet ^ got).bit_count()
            if errors <= 3:
                assert found == []
                assert decoder.stats.bad >= 1
            for telegram in found:
                assert telegram.kind in (Kind.SD4, Kind.SC) or telegram._replace(kind=sound.kind) == sound


def test_how_many_errors_of_four_bits_pass() -> None:
    """Of 45 million ways to invert four bits of 231 that do not show at the UART or in the sum: a few thousand."""
    passing = 0
    covered = range(4, len(ANSWER) - 1)
    for one, other in combinations(covered, 2):
        damaged = bytearray(ANSWER)
        for first in PAIRS:
            changed = flipped(ANSWER[one], first)
            assert changed is not None
            damaged[one] = changed
            for second in PAIRS:
                changed = flipped(ANSWER[other], second)
                assert changed is not None
                damaged[other] = changed
                passing += sum(damaged[4:-2]) & 0xFF == damaged[-2]
    assert 1_500 < passing < 3_500
    per_telegram = passing * 1e-3**4 * (1 - 1e-3) ** (11 * len(ANSWER) - 4)
    assert 1e-9 < per_telegram < 3e-9
