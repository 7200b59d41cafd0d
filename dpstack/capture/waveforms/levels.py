"""Levels of the channels of a waveform, piece by piece: ``b"1"`` (high) or ``b"0"`` (low) for each sample."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import BinaryIO, Final, NamedTuple, TypeVar

from dpstack.errors import CaptureFileError
from dpstack.units import BAUD_RATES, NS_PER_S

T = TypeVar("T")
#: samples of a piece, about
PIECE: Final = 1 << 18
#: samples/s at most: times are whole nanoseconds
MOST_RATE: Final = NS_PER_S
#: in place of a level: the one before
KEPT: Final = -1
#: samples of a short pulse at least, where the rate is a matter of choice
_FINE: Final = 16
#: samples/s that analysers offer, slowest first
_USUAL_RATES: Final = tuple(
    round(10**decade * one)
    for decade in range(4, 9)
    for one in (1, 1.2, 1.25, 1.6, 2, 2.4, 2.5, 3, 3.125, 3.2, 4, 4.8, 5, 6, 6.25, 8)
)
#: ticks of a period at least: each time is wrong by half a tick
_LEAST_PERIOD: Final = 4
#: channels of one file
MOST_CHANNELS: Final = 1024
#: bits at the slowest rate after which a level that stays is left out of the pieces
_LONG_BITS: Final = 16
_RATE: Final = re.compile(r"\s*([\d.]{1,20})\s*([kMG]?)(?:Hz|[hz]?)\s*$", re.IGNORECASE)
_FACTOR: Final = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9}


class Piece(NamedTuple):
    """``levels`` of one channel from sample number ``start`` on."""

    channel: int
    start: int
    levels: bytes


class Change(NamedTuple):
    """A channel has the level 0 or 1 from the sample ``at`` on, or keeps the one it had (:data:`KEPT`)."""

    at: int
    channel: int
    level: int


class Waveform(ABC):
    """A file of a logic analyser. ``name``: of the file, in messages.

    ``channels``: their names. ``rate`` in samples/s; ``stated``: the file says it, else it follows from the times of
    the changes. ``period_ns``: how finely the analyser has sampled.
    ``begin_ns``: time of sample 0. ``remarks``: lines for the user, complete after :meth:`pieces`.
    """

    channels: tuple[str, ...]
    rate: int
    stated = True
    period_ns = 0
    begin_ns = 0

    def __init__(self, file: BinaryIO, name: str) -> None:
        self.file = file
        self.name = name
        self.remarks: list[str] = []

    @abstractmethod
    def pieces(self, channels: Sequence[int]) -> Iterator[Piece]:
        """The levels of ``channels`` from the begin of the file on. If two pieces of a channel do not touch, it keeps
        its level between them. Raises CaptureFileError, after what could be read."""

    def wrong(self, text: str) -> CaptureFileError:
        return CaptureFileError(f"{self.name}: {text}")


def parse_rate(text: str) -> int:
    """Samples/s of texts such as ``24 MHz``; 0 if it is no rate."""
    found = _RATE.match(text)
    try:
        return round(float(found[1]) * _FACTOR[found[2].lower()]) if found else 0
    except ValueError:
        return 0


def pieces_of(changes: Iterable[Change], rate: int) -> Iterator[Piece]:
    """Pieces at ``rate`` from ``changes``, whose samples must not run backwards, up to the last one. If that is a real
    change, the end of the capture is unknown: the levels stay for a while."""
    longest = _LONG_BITS * rate // BAUD_RATES[0] + 1
    levels = b"0" * longest, b"1" * longest
    runs: dict[int, _Runs] = {}
    at = last = 0
    failure: CaptureFileError | None = None
    try:
        for at, channel, level in changes:
            if level == KEPT:
                continue
            last = at
            run = runs.get(channel)
            if run is None:
                run = runs[channel] = _Runs(channel, at, levels)
            elif run.level != level and (piece := run.reach(at)) is not None:
                yield piece
            run.level = level
    except CaptureFileError as error:
        failure = error
    for run in runs.values():
        yield run.reach(at if at > last else at + longest) or run.take()
    if failure is not None:
        raise failure


def before_damage(items: Iterable[T]) -> list[T]:
    """``items`` up to a damage of their file. Raises CaptureFileError if nothing stands before it."""
    found: list[T] = []
    try:
        found.extend(items)
    except CaptureFileError:
        if not found:
            raise
    return found


class _Runs:
    """Collects the runs of one channel. ``level``: the present one."""

    def __init__(self, channel: int, start: int, levels: tuple[bytes, bytes]) -> None:
        self._channel = channel
        self._start = self._since = start
        self._levels = levels
        self._parts: list[bytes] = []
        self._size = 0
        self.level = 0

    def reach(self, at: int) -> Piece | None:
        """The level has stayed up to the sample ``at``; returns the piece that is complete with it."""
        count = at - self._since
        self._since = at
        self._parts.append(self._levels[self.level][:count])
        self._size += count
        if count <= len(self._levels[0]) and self._size < PIECE:
            return None
        return self.take()

    def take(self) -> Piece:
        piece = Piece(self._channel, self._start, b"".join(self._parts))
        self._start, self._size = self._since, 0
        self._parts.clear()
        return piece


def estimated_rate(ticks: Sequence[int], tick_ns: float) -> tuple[int, int]:
    """Samples/s, and the period of the samples in ns, for a file that has only the times of changes, in ascending
    ``ticks``: the slowest usual rate whose samples, rounded to ticks, they are.

    All changes of a simulated line stand at multiples of a bit. So that a bit is not read with one sample, the rate
    may be a multiple of the one that was found."""
    pulses = sorted(b - a for a, b in pairwise(ticks) if b > a)
    distances = sorted(set(pulses))
    per_second = NS_PER_S / tick_ns
    rate = min(MOST_RATE, per_second / max(1, math.gcd(*distances)))
    for usual in _USUAL_RATES if distances else ():
        period = per_second / usual
        if usual >= rate or period < _LEAST_PERIOD:
            break
        if all(abs(distance - round(distance / period) * period) <= 1.001 for distance in distances):
            rate = usual
            break
    pulse_ns = pulses[len(pulses) // 10] * tick_ns if pulses else NS_PER_S
    fine = math.ceil(_FINE * NS_PER_S / (pulse_ns * rate))
    return max(1, round(min(MOST_RATE, rate * fine))), math.ceil(NS_PER_S / rate)
