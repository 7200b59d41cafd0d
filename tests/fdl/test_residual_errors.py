"""What no UART and no check sum can see: how often a damaged telegram passes for a sound one, counted out.

The figures are those of docs/reference/bus-parameters.md and docs/development/reliability.md. A character with an error
of an odd number of bits is dropped, so it takes two inverted bits in each of two octets, and the two changes have to
cancel in the sum.
"""

from __future__ import annotations

from collections import Counter
from functools import cache
from itertools import combinations
from pathlib import Path
from random import Random

import pytest
from msgspec.structs import replace
from support import present

from dpstack.fdl.codec import decode
from dpstack.fdl.decoder import Decoder
from dpstack.fdl.telegram import Kind
from dpstack.phy.uart import flipped
from dpstack.ports.kernel_drivers import kernel_driver

#: a Data_Exchange answer with twelve octets, a status answer, and one of a slave with SAPs
ANSWER = bytes.fromhex("68 0F 0F 68 02 05 08 C4 1B 07 F0 5A 33 9E 62 D8 01 7F A6 70 16")
STATUS = bytes.fromhex("10 02 63 00 65 16")
DIAG = bytes.fromhex("68 0B 0B 68 E3 82 08 3E 3C 02 05 00 FF 0C DA D3 16")
#: two of the nine bits that the parity covers, as masks of a character
PAIRS = [1 << one | 1 << other for one, other in combinations(range(1, 10), 2)]


@pytest.mark.parametrize("octets", [ANSWER, STATUS, DIAG], ids=["exchange", "status", "diagnosis"])
def test_damage_to_one_octet_gives_no_wrong_data(octets: bytes) -> None:
    """Up to three errors are always noticed; four can make another start octet: of a token, or of the same in SD3."""
    sound = present(decode(octets))
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
                assert telegram.kind in (Kind.SD4, Kind.SC) or replace(telegram, kind=sound.kind) == sound


def test_errors_of_four_bits_pass_as_often_as_computed() -> None:
    """Of 45 million ways to invert four bits of 231 that do not show at the UART or in the sum: a few thousand."""
    passing = 0
    covered = range(4, len(ANSWER) - 1)
    for one, other in combinations(covered, 2):
        damaged = bytearray(ANSWER)
        for first in PAIRS:
            changed = present(flipped(ANSWER[one], first))
            damaged[one] = changed
            for second in PAIRS:
                changed = present(flipped(ANSWER[other], second))
                damaged[other] = changed
                passing += sum(damaged[4:-2]) & 0xFF == damaged[-2]
    assert 1_500 < passing < 3_500
    per_telegram = passing * 1e-3**4 * (1 - 1e-3) ** (11 * len(ANSWER) - 4)
    assert 1e-9 < per_telegram < 3e-9


# --- the share that no station can see, for any telegram: docs/development/reliability.md, "Fault matrix" ---
# Nothing below uses the codec, the decoder or the UART of the project.

#: patterns of two errors in each of two characters that cancel in the sum, on average over all octets
CANCELLING = 19
#: bits of a character that the parity covers, and the two that frame it
COVERED, FRAMING = 9, 2


def undetected(octets: int, per_bit: float) -> float:
    """The share of SD2 telegrams of ``octets`` that arrive changed and pass, of all that are sent: the formula.

    Two of the characters from DA to FCS have two errors each, which cancel in the sum; all other bits are sound.
    """
    summed = octets - 5  # without SD, LE, LEr, SD and ED
    pairs = summed * (summed - 1) / 2
    return CANCELLING * pairs * per_bit**4 * (1 - per_bit) ** (octets * (COVERED + FRAMING) - 4)


def changes() -> Counter[tuple[int, int]]:
    """Number of ways in which a character passes the parity check, by the change of its octet (modulo 256) and errors,
    over all octets and all patterns of errors in it."""
    found: Counter[tuple[int, int]] = Counter()
    for octet in range(256):
        for flips in range(256):
            errors = flips.bit_count()
            found[((octet ^ flips) - octet) & 0xFF, errors + errors % 2] += 1  # an odd number needs the parity bit too
    return found


CHANGES = changes()


def passing_changed(summed: int, per_bit: float) -> float:
    """The share of telegrams of which any of ``summed`` characters are changed, pass the parity check and keep the sum:
    every pattern of errors, counted out. Other characters are left out."""
    one = [0.0] * 256
    for (change, errors), count in CHANGES.items():
        one[change] += count / 256 * per_bit**errors * (1 - per_bit) ** (COVERED - errors)
    total = [1.0] + [0.0] * 255
    for _ in range(summed):
        total = convolved(total, one)
    framed = (1 - per_bit) ** (FRAMING * summed)
    return (total[0] - (1 - per_bit) ** (COVERED * summed)) * framed


def test_no_change_of_one_octet_keeps_the_sum() -> None:
    """The lowest changed bit changes the sum, and no other one can take that back."""
    assert {errors for (change, errors) in CHANGES if change == 0} == {0}


def test_nineteen_patterns_of_four_errors_cancel_in_each_pair_of_octets() -> None:
    two = [(change, count) for (change, errors), count in CHANGES.items() if errors == 2]
    cancelling = sum(one * other for a, one in two for b, other in two if (a + b) & 0xFF == 0)
    assert cancelling == CANCELLING * 256 * 256


# --- without marks of damaged octets only the check sum is left: drivers that pass no parity error on ---


def pairs_that_keep_the_sum(octets: bytes) -> int:
    """Patterns of two inverted data bits in a telegram of this kind that the check sum does not show."""
    covered = [(number, bit) for number in range(4, len(octets) - 1) for bit in range(8)]
    passing = 0
    for one, other in combinations(covered, 2):
        damaged = bytearray(octets)
        for number, bit in (one, other):
            damaged[number] ^= 1 << bit
        passing += sum(damaged[4:-2]) & 0xFF == damaged[-2]
    return passing


def test_two_errors_pass_where_no_parity_error_is_passed_on() -> None:
    """On average 540 patterns for 12 octets: two bits of the same weight, half of them in opposite senses, and the
    highest one always."""
    rng = Random(3)
    counts = []
    for _ in range(8):
        body = rng.randbytes(15)
        counts.append(pairs_that_keep_the_sum(b"\x68\x0f\x0f\x68" + body + bytes((sum(body) & 0xFF, 0x16))))
    assert sum(counts) / len(counts) == pytest.approx(WITHOUT_PARITY, rel=0.03)
    assert WITHOUT_PARITY == 120 * (7 / 2 + 1)
    # and one error is always noticed
    for number, bit in ((number, bit) for number in range(4, len(ANSWER) - 1) for bit in range(8)):
        damaged = bytearray(ANSWER)
        damaged[number] ^= 1 << bit
        assert decode(bytes(damaged)) is None


#: the average number of such patterns in an answer with twelve octets, and with parity
WITHOUT_PARITY, WITH_PARITY = 540, 2262
_ANSWERS_A_S = 900


def once_in(patterns: int, errors: int, per_bit: float) -> str:
    """The time between two wrong answers of 900 a second, as the documentation writes it."""
    seconds = 1 / (patterns * per_bit**errors * _ANSWERS_A_S)
    for unit, size in (("years", 365.25 * 86_400), ("days", 86_400), ("hours", 3_600), ("minutes", 60)):
        if seconds >= size:
            count = seconds / size
            return f"{count / 1e6:.1f} million {unit}" if count >= 1e6 else f"{count:.0f} {unit}"
    return f"{seconds:.0f} seconds"


def promise_rows() -> str:
    """The table of docs/reference/bus-parameters.md: the promise of each class of driver."""
    rows = []
    for title, names in (
        ("UART of the computer, `ftdi_sio`, `cp210x`", ("serial", "ftdi_sio", "cp210x")),
        ("`ch341-uart` (CH340, CH341)", ("ch341-uart",)),
        ("`pl2303`, `cdc_acm`, other USB drivers", ("pl2303", "cdc_acm", "other")),
    ):
        (distance,) = {kernel_driver(name, usb=name != "serial").distance for name in names}
        if distance is None:
            rows.append(f"| {title} | none is promised | | | |")
            continue
        patterns = WITH_PARITY if distance == 4 else WITHOUT_PARITY
        times = " | ".join(once_in(patterns, distance, per_bit) for per_bit in (1e-3, 1e-4, 1e-5))
        noticed = f"up to {distance - 1} wrong bits" if distance > 2 else "one wrong bit"
        rows.append(f"| {title} | {distance}: {noticed} | {times} |")
    return "".join(row + "\n" for row in rows)


def test_the_promise_of_each_class_of_driver_is_computed() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs/reference/bus-parameters.md").read_text(encoding="utf-8")
    assert promise_rows() in page, f"the table of docs/reference/bus-parameters.md is:\n{promise_rows()}"


@pytest.mark.parametrize("per_bit", [1e-3, 1e-2])
def test_the_formula_is_the_share_of_all_patterns_of_errors(per_bit: float) -> None:
    """More than four errors that cancel are rare beside four: less than a hundredth of them at 1e-2."""
    octets = 21
    frame = (1 - per_bit) ** (5 * (COVERED + FRAMING))  # SD, LE, LEr, SD, ED
    assert undetected(octets, per_bit) == pytest.approx(passing_changed(octets - 5, per_bit) * frame, rel=0.01)


def test_a_burst_passes_where_every_character_and_the_sum_agree_by_chance() -> None:
    """In a burst every bit is random: start, parity and stop bit of each character are right one time in eight, the sum
    one time in 256."""
    for characters in (2, 3):
        assert passing_changed(characters, 0.5) == pytest.approx(8**-characters / 256, rel=0.05)


def passing_burst(bits: int) -> float:
    """The share of bursts of ``bits`` random bits, at any place between DA and FCS, after which the telegram is changed
    and passes."""
    share = 0.0
    for place in range(11):
        total, unchanged = [1.0] + [0.0] * 255, 1.0
        for first in range(0, place + bits, 11):
            hit = [bit for bit in range(11) if place <= first + bit < place + bits]
            total = convolved(total, burst_changes(tuple(hit)))
            unchanged *= 0.5 ** len(hit)
        share += (total[0] - unchanged) / 11
    return share


@cache
def burst_changes(hit: tuple[int, ...]) -> list[float]:
    """The probability that a character passes, by the change of its octet, if the bits ``hit`` of it are random."""
    found = [0.0] * 256
    data = [bit - 1 for bit in hit if 1 <= bit <= 8]
    for pattern in range(1 << len(data)):
        flips = sum(1 << bit for n, bit in enumerate(data) if pattern >> n & 1)
        if flips.bit_count() % 2 and 9 not in hit:
            continue
        for octet in range(256):
            found[((octet ^ flips) - octet) & 0xFF] += 0.5 ** len(hit) / 256
    return found


def convolved(one: list[float], other: list[float]) -> list[float]:
    return [sum(one[n] * other[(total - n) & 0xFF] for n in range(256)) for total in range(256)]


def test_one_burst_of_20_bits_in_fourteen_thousand_passes() -> None:
    """It begins and ends within a character, whose other bits are sound."""
    assert passing_burst(20) == pytest.approx(1 / 14_050, rel=0.01)


def received(sent: bytes, flips: dict[int, int]) -> bytes | None:
    """The telegram that arrives, None where a receiver drops an octet of it or the telegram."""
    got = bytearray(sent)
    for number, mask in flips.items():
        octet = sent[number]
        bits = [0, *(octet >> n & 1 for n in range(8)), octet.bit_count() & 1, 1]
        bits = [bit ^ (mask >> n & 1) for n, bit in enumerate(bits)]
        if bits[0] or not bits[10] or sum(bits[1:10]) % 2:
            return None
        got[number] = sum(bit << n for n, bit in enumerate(bits[1:9]))
    sound = got[0] == got[3] == 0x68 and got[1] == got[2] == len(got) - 6 and got[-1] == 0x16
    return bytes(got) if sound and sum(got[4:-2]) & 0xFF == got[-2] else None


def test_random_telegrams_with_four_errors_pass_as_often_as_the_formula_says() -> None:
    """Two errors in each of two octets of random telegrams, any octets of them, at a receiver of a few lines."""
    rng, trials, octets = Random(4), 15_000, 21
    passed = 0
    for _ in range(trials):
        body = rng.randbytes(octets - 6)
        sent = b"\x68" + bytes((len(body),)) * 2 + b"\x68" + body + bytes((sum(body) & 0xFF, 0x16))
        flips = {n: sum(1 << bit for bit in rng.sample(range(1, 10), 2)) for n in rng.sample(range(4, octets - 1), 2)}
        got = received(sent, flips)
        assert got != sent
        passed += got is not None
    assert 0.8 < passed / (trials * CANCELLING / 36**2) < 1.2
