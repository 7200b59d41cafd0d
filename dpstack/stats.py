"""A histogram of durations that is cheap enough to be always on."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from typing import Final

from msgspec import Struct, field
from msgspec.structs import replace

from dpstack.units import NS_PER_US

_SUB_BITS: Final = 8  # 256 buckets an octave: values are kept to 0.4 %
_KEY_BITS: Final = _SUB_BITS + 1


class Histogram(Struct):
    """Counts of durations in ns in logarithmic buckets (relative width 2^-8), minimum and maximum exact.

    ``buckets`` is internal.
    """

    count: int = 0
    min_ns: int = 0
    max_ns: int = 0
    buckets: dict[int, int] = field(default_factory=dict)

    def add(self, ns: int) -> None:
        """Count one duration in nanoseconds (negative ones count as 0)."""
        if ns < 0:
            ns = 0
        shift = ns.bit_length() - _KEY_BITS
        key = ns if shift <= 0 else (shift << _KEY_BITS) + (ns >> shift)
        buckets = self.buckets
        if key in buckets:
            buckets[key] += 1
        else:
            buckets[key] = 1
        if ns > self.max_ns:
            self.max_ns = ns
        if ns < self.min_ns or not self.count:
            self.min_ns = ns
        self.count += 1

    def __deepcopy__(self, _memo: object) -> Histogram:
        """A copy of the counters of a running bus must not take long: its buckets are plain numbers."""
        return replace(self, buckets=dict(self.buckets))

    def values(self) -> list[tuple[int, int]]:
        """The durations in ns, each to 0.4 %, with the count of each, in ascending order."""
        return [(min(max(_value(key), self.min_ns), self.max_ns), self.buckets[key]) for key in sorted(self.buckets)]

    def quantile_ns(self, q: float) -> int:
        """The smallest bucket value at or above which ``q`` (0..1) of the durations lie; 0 when empty."""
        if not self.count:
            return 0
        rank = q * self.count
        seen = 0
        for key in sorted(self.buckets):
            seen += self.buckets[key]
            if seen >= rank:
                return min(max(_value(key), self.min_ns), self.max_ns)
        return self.max_ns

    def in_classes(self, limits_ns: Sequence[int]) -> tuple[list[int], int]:
        """The count of the durations up to each limit and above the one before (ascending, in ns), that above all
        limits, and the sum of all in ns. A limit counts to 0.4 %. None of the cumulated counts ever falls.
        """
        # by bucket alone: its middle within minimum and maximum would move with them, and pass a limit
        keys = [_key(limit) for limit in limits_ns]
        counts, total = [0] * (len(keys) + 1), 0
        for key, count in self.buckets.items():
            counts[bisect_left(keys, key)] += count
            total += _value(key) * count
        return counts, total

    def mean_ns(self) -> int:
        """The mean of the durations, to 0.4 %; 0 when empty."""
        if not self.count:
            return 0
        mean = sum(_value(key) * count for key, count in self.buckets.items()) // self.count
        return min(max(mean, self.min_ns), self.max_ns)

    def summary_us(self) -> dict[str, int]:
        """``min``, ``p50``, ``p99``, ``p999`` and ``max`` in whole microseconds, as the JSON lines print them."""
        points = {
            "min": self.min_ns,
            "p50": self.quantile_ns(0.5),
            "p99": self.quantile_ns(0.99),
            "p999": self.quantile_ns(0.999),
            "max": self.max_ns,
        }
        return {name: (ns + NS_PER_US // 2) // NS_PER_US for name, ns in points.items()}


def _key(ns: int) -> int:
    """The bucket of a duration."""
    shift = ns.bit_length() - _KEY_BITS
    return ns if shift <= 0 else (shift << _KEY_BITS) + (ns >> shift)


def _value(key: int) -> int:
    """The middle of a bucket in ns."""
    shift = key >> (_SUB_BITS + 1)
    if not shift:
        return key
    return ((key - (shift << (_SUB_BITS + 1))) << shift) + (1 << shift >> 1)
