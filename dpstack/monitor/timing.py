"""Figures of durations as far as the source of the octets can time them; None stands for those that it cannot.

A duration is the distance of two times, each of which may be wrong by the resolution of the source. Durations between
neighbouring telegrams (T_SDR, hold time) mean nothing if telegrams arrive together in one piece.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from dpstack.capture.timing import LineTiming
from dpstack.monitor.counters import Counters
from dpstack.stats import Histogram
from dpstack.units import NS_PER_US

#: A figure is given from this multiple of the resolution on: its error is a quarter at most (our choice).
RESOLVED: Final = 4
#: If more than this share of the telegrams arrived together, distances of neighbouring telegrams say nothing (our
#: choice).
MOST_BATCHED: Final = 0.1
#: and the source is no finer than this much of the pieces in which it delivers them
_PIECES: Final = 0.9
#: the quantiles of a summary
QUANTILES: Final[Mapping[str, float]] = {"p50": 0.5, "p99": 0.99}
ROTATION_QUANTILES: Final[Mapping[str, float]] = {**QUANTILES, "p999": 0.999}


@dataclass(frozen=True, slots=True)
class Timing:
    """``line``: the source and its resolution. ``batched``: the share of telegrams that arrived together with the one
    before, 0..1."""

    line: LineTiming
    batched: float

    @classmethod
    def of(cls, line: LineTiming, counters: Counters) -> Timing:
        """The timing that ``line`` gives, and that shows in the telegrams: an adapter whose latency timer is 16 ms
        delivers pieces of 16 ms."""
        whole = counters.telegrams + sum(counters.damaged.values())
        batched = counters.together / whole if whole else 0.0
        if batched > MOST_BATCHED and line.resolution_ns is not None:
            piece = counters.pieces_ns.quantile_ns(_PIECES)
            line = LineTiming(line.source, max(line.resolution_ns, piece))
        return cls(line, batched)

    @property
    def times_neighbours(self) -> bool:
        """Whether distances of neighbouring telegrams mean anything."""
        return self.line.resolution_ns is not None and self.batched <= MOST_BATCHED

    def resolves(self, ns: int) -> bool:
        """Whether the source can time a duration of ``ns``."""
        resolution = self.line.resolution_ns
        return resolution is not None and ns >= RESOLVED * resolution

    def as_dict(self) -> dict[str, object]:
        resolution = self.line.resolution_ns
        return {
            "source": self.line.source,
            "resolution_us": None if resolution is None else resolution / NS_PER_US,
            "batched": round(self.batched, 4),
        }

    def neighbours(self, durations: Histogram) -> dict[str, float] | None:
        """``min``, ``p50``, ``p99`` and ``max`` in us of durations between neighbouring telegrams; None if their
        median cannot be timed."""
        if not durations.count or not self.times_neighbours or not self.resolves(durations.quantile_ns(0.5)):
            return None
        return {name: _us(ns) for name, ns in _points(durations, QUANTILES).items()}

    def rotations(self, durations: Histogram) -> dict[str, float | None] | None:
        """The figures in us of durations over many telegrams; the mean needs no resolution. None if there are no
        durations."""
        if not durations.count:
            return None
        points = _points(durations, ROTATION_QUANTILES)
        figures = {name: _us(ns) if self.resolves(ns) else None for name, ns in points.items()}
        return {"mean": _us(durations.mean_ns()), **figures}


def _points(durations: Histogram, quantiles: Mapping[str, float]) -> dict[str, int]:
    inner = {name: durations.quantile_ns(q) for name, q in quantiles.items()}
    return {"min": durations.min_ns, **inner, "max": durations.max_ns}


def _us(ns: int) -> float:
    return round(ns / NS_PER_US, 1)
