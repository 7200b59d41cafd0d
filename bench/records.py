"""Records of a paced wire: rotations, the time on the wire by the rules, the pty's own share."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from statistics import median
from typing import NamedTuple

from bench.masters import FIRST, OCTETS
from bench.report import quantile
from dpstack.params import BusParams


class Record(NamedTuple):
    """One telegram of the master on a paced wire. Times in ns of CLOCK_MONOTONIC; of answers 0 where there is none."""

    read: int  # the wire has it
    begin: int  # on the wire
    end: int
    answer_end: int
    due: int  # the answer's last octet, at the master
    written: int  # when it was written there
    first: int  # octet
    to: int  # DA, -1 for a token
    octets: int
    answer_octets: int

    @property
    def exchange(self) -> bool:
        """A Data_Exchange as these masters send it."""
        return self.answer_octets == 9 + OCTETS and self.octets == 9 + OCTETS


def pty_share(records: Sequence[Record], baud: int) -> float:
    """Of a bare loop: from its answer's last octet written to its next request read, without T_ID1, in ns.

    That is what two ways over the pty cost and what the system needs to wake a process. It is the share that nine of
    ten exchanges exceed: other programs, which hold up a loop without priority most of all, shall not excuse a master.
    """
    idle = BusParams.preset(baud).ns(BusParams.preset(baud).t_id1)
    return quantile([b.read - a.written - idle for a, b in pairwise(records) if a.written], 0.1)


class Round(NamedTuple):
    """One rotation: how long it took, and the time on the wire by the rules of what was sent in it. In ns."""

    took: int
    wire: int
    exchanges: int


def rotations(records: Sequence[Record], baud: int, *, services: bool = False) -> list[Round]:
    """Rotations between Data_Exchanges with the first slave; those with a silent address or a service left out.

    ``services``: all of them.
    """
    params = BusParams.preset(baud)
    rounds: list[Round] = []
    begin, bits, exchanges, usual = 0, 0, 0, False  # not before the first
    for record in records:
        if record.exchange and record.to == FIRST:
            if usual:
                rounds.append(Round(record.read - begin, params.ns(bits), exchanges))
            begin, bits, exchanges, usual = record.read, 0, 0, True
        bits += 11 * record.octets + params.t_id1
        if record.answer_octets:
            bits += params.min_tsdr + 11 * record.answer_octets
        exchanges += record.exchange
        usual = usual and (services or record.exchange or record.to < 0)
    return rounds


def fetched(records: Sequence[Record], octets: int) -> int:
    """The number of answered Reads of ``octets`` octets (two SAPs and four octets of DP-V1 stand before them)."""
    return sum(record.answer_octets == 9 + 2 + 4 + octets for record in records)


def middle(values: Sequence[float]) -> float:
    """The median. Raises RuntimeError when nothing was measured."""
    if not values:
        raise RuntimeError("nothing was measured: take more seconds")
    return median(values)
