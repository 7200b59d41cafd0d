"""The world's own account of a bus, to hold counters of a listening station against it.

It is made from the wire log: who sent each transmission (the world knows the station), and its octets, read here by
their places. Nothing of the codec, of the cutter or of the decoder is used.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from dpstack.sim.transmission import Transmission
from dpstack.trace import WireEntry

#: requests that nobody answers by their function: SDN, time event
UNANSWERED = (0, 4, 6)
#: those with a frame count
COUNTED = (3, 5, 7, 12, 13)
#: a first octet, and the place of DA in such a telegram; SA and FC follow it
HEADS = {0x10: 1, 0x68: 4}
LOST = ("dropped", "silenced")
FCB, FCV = 0x20, 0x10


@dataclass
class Truth:
    """Counts by station, and tokens by master; all of transmissions that were on the wire."""

    requests: Counter[int] = field(default_factory=Counter)
    answers: Counter[int] = field(default_factory=Counter)
    no_answer: Counter[int] = field(default_factory=Counter)
    late: Counter[int] = field(default_factory=Counter)
    repetitions: Counter[int] = field(default_factory=Counter)
    repeated_polls: Counter[int] = field(default_factory=Counter)
    rs: Counter[int] = field(default_factory=Counter)
    rr: Counter[int] = field(default_factory=Counter)
    tokens: Counter[int] = field(default_factory=Counter)
    status_polls: Counter[int] = field(default_factory=Counter)
    #: by station and number of repetitions: exchanges
    depth: Counter[tuple[int, int]] = field(default_factory=Counter)
    open: int | None = None
    telegrams: int = 0
    octets: int = 0


def on_wire(log: Iterable[WireEntry]) -> list[WireEntry]:
    """The transmissions that were on the wire, in the order of their begin."""
    heard = (e for e in log if e.octets and not any(lost in e.note for lost in LOST))
    return sorted(heard, key=lambda e: e.start_ns)


def truth_of(log: Iterable[WireEntry]) -> Truth:
    """The account of a bus on which every transmission arrives intact, from its first telegram on."""
    truth = Truth()
    asked: int | None = None
    last: dict[tuple[str | None, int], tuple[bytes, bool]] = {}  # by master and station: request, answered
    pair: tuple[str | None, int] | None = None
    repeats: Counter[tuple[str | None, int]] = Counter()
    missed: int | None = None
    for entry in on_wire(log):
        octets = entry.octets
        truth.telegrams += 1
        truth.octets += len(octets)
        at = HEADS.get(octets[0])
        fc = octets[at + 2] if at is not None else 0
        is_token = octets[0] == 0xDC
        if is_token or fc & 0x40:
            if asked is not None:
                truth.no_answer[asked] += 1
                missed = asked
            asked = None
            if is_token:
                truth.tokens[octets[2]] += 1
                continue
            assert at is not None
            da, function = octets[at] & 0x7F, fc & 0x0F
            if da == 127 or function in UNANSWERED:
                continue
            asked = da
            truth.requests[da] += 1
            if function == 9:
                truth.status_polls[octets[at + 1] & 0x7F] += 1
            pair = None
            if function not in COUNTED:
                continue
            pair = entry.sender, da
            before, answered = last.get(pair, (b"", True))
            same = before == octets and not answered
            if same and fc & FCV:
                truth.repetitions[da] += 1
                if repeats[pair]:
                    truth.depth[da, repeats[pair]] -= 1
                repeats[pair] += 1
                truth.depth[da, repeats[pair]] += 1
            elif same:
                truth.repeated_polls[da] += 1
            else:
                repeats[pair] = 0
            last[pair] = octets, False
            continue
        # an answer: the world knows whose
        sender = int(entry.sender or "-1")
        if sender != asked:
            truth.late[sender if octets[0] != 0xE5 or missed is None else missed] += 1
            continue
        asked = None
        truth.answers[sender] += 1
        if pair is not None:
            last[pair] = last[pair][0], True
        if at is not None:
            truth.rs[sender] += fc & 0x0F == 3
            truth.rr[sender] += fc & 0x0F == 2
    truth.open = asked
    return truth


def arriving(tx: Transmission) -> list[int]:
    """The octet numbers of ``tx`` that a UART hands over: start and stop bit sound, parity even."""
    kept = []
    for number in range(len(tx.octets)):
        bits = [tx.flips.get(number, 0) >> bit & 1 for bit in range(11)]
        if not bits[0] and not bits[10] and sum(bits[1:10]) % 2 == 0:
            kept.append(number)
    return kept
