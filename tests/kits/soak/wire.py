"""The account of a soak run that is kept on the wire: telegrams by kind and station, and the grid of the rounds.

It reads octets by their places and uses no counter, no codec and no clock of the stack under test.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from dpstack.trace import WireEntry

#: first octets; DA, SA and FC follow at 4 in a telegram with a variable length, else at 1
_SD2: Final = 0x68
_TOKEN: Final = 0xDC
_SHORT: Final = 0xE5
_REQUEST: Final = 0x40
_SAP: Final = 0x80
_STATUS: Final = 0x49
#: rounds of one measurement of the drift
_MANY: Final = 100


@dataclass
class Grid:
    """The rounds of a fixed cycle of ``cycle_ns``, against a grid that begins with the first of them.

    ``rounds`` that began, ``off`` of them beside their place on the grid, ``late`` of them by more than a tenth of the
    cycle. ``left_out``: places without a round. ``earliest_ns`` and ``latest_ns``: the largest deviations both ways.
    ``drift_ns``: the smallest deviation, either way, among the last hundred rounds: that of the grid as a whole.
    """

    cycle_ns: int
    rounds: int = 0
    off: int = 0
    late: int = 0
    left_out: int = 0
    earliest_ns: int = 0
    latest_ns: int = 0
    drift_ns: int = 0
    _first_ns: int = -1
    _place: int = -1
    _least_ns: int = 1 << 62

    def add(self, at_ns: int) -> None:
        """A round began with a bit on the line at ``at_ns``."""
        cycle_ns = self.cycle_ns
        self.rounds += 1
        if self._first_ns < 0:
            self._first_ns = at_ns
        # a round more than half a cycle late belongs to the next place
        place = (at_ns - self._first_ns + cycle_ns // 2 - 1) // cycle_ns
        off_ns = at_ns - self._first_ns - place * cycle_ns
        self.left_out += place - self._place - 1
        self._place = place
        if off_ns:
            self.off += 1
            self.late += off_ns > cycle_ns // 10
            self.earliest_ns = min(self.earliest_ns, off_ns)
            self.latest_ns = max(self.latest_ns, off_ns)
        self._least_ns = min(self._least_ns, abs(off_ns))
        if not self.rounds % _MANY:
            self.drift_ns, self._least_ns = self._least_ns, 1 << 62

    def as_dict(self) -> dict[str, int]:
        """For a results file."""
        return {
            "rounds": self.rounds,
            "off": self.off,
            "late": self.late,
            "left_out": self.left_out,
            "earliest_ns": self.earliest_ns,
            "latest_ns": self.latest_ns,
            "drift_ns": self.drift_ns,
        }


@dataclass
class WireCount:
    """All transmissions of a bus with the one master ``master``; the listener of a world's wire log.

    ``asked`` and ``answered``: Data_Exchange by slave; ``services`` and ``replies``: requests and answers beside it by
    slave. ``polls`` and ``polled``: FDL status requests and their answers. ``inputs``: octets of the last Data_Exchange
    by slave. ``bad``: transmissions that a collision or a fault damaged. ``grid``: None while no cycle is to
    be judged.
    """

    master: int
    telegrams: int = 0
    octets: int = 0
    sent: int = 0
    tokens: int = 0
    polls: int = 0
    polled: int = 0
    short: int = 0
    broadcasts: int = 0
    rounds: int = 0
    bad: int = 0
    asked: Counter[int] = field(default_factory=Counter)
    answered: Counter[int] = field(default_factory=Counter)
    services: Counter[int] = field(default_factory=Counter)
    replies: Counter[int] = field(default_factory=Counter)
    inputs: dict[int, bytes] = field(default_factory=dict)
    grid: Grid | None = None
    _last: int = 127
    #: the station that a service or an FDL status request has asked
    _open: int = -1
    _status: bool = False

    def __call__(self, entry: WireEntry) -> None:
        octets = entry.octets
        self.telegrams += 1
        self.octets += len(octets)
        if entry.note:
            self.bad += 1
        first = octets[0]
        if first == _TOKEN:
            self.tokens += 1
            self.sent += octets[2] == self.master
            return
        if first == _SHORT:  # it has no address: it answers the last request
            self.short += 1
            self.replies[self._open] += 1
            return
        da, sa, fc = octets[4:7] if first == _SD2 else octets[1:4]
        if fc & _REQUEST:
            self.sent += sa & 0x7F == self.master
            if fc == _STATUS:
                self.polls += 1
                self._status = True
                return
            self._status = False
            if not (da | sa) & _SAP:
                self._exchange(da, entry.start_ns)
            elif da & 0x7F == 0x7F:
                self.broadcasts += 1
            else:
                self._open = da & 0x7F
                self.services[da & 0x7F] += 1
        elif self._status:
            self.polled += 1
        elif da & _SAP:
            self.replies[sa & 0x7F] += 1
        else:
            self.answered[sa] += 1
            self.inputs[sa] = octets[7:-2] if first == _SD2 else b""

    def _exchange(self, da: int, at_ns: int) -> None:
        """A Data_Exchange request; in Clear it may have no data, and is a telegram without a data unit then."""
        if da <= self._last:
            self.rounds += 1
            if self.grid is not None:
                self.grid.add(at_ns)
        self._last = da
        self.asked[da] += 1
