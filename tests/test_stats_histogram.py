"""Classes of a histogram with fixed limits: nothing that monitoring systems take for a counter ever falls."""

from __future__ import annotations

from itertools import accumulate

from hypothesis import given
from hypothesis import strategies as st

from dpstack.stats import Histogram

LIMITS_NS = [10_000, 20_000, 50_000, 1_000_000, 5_000_000_000]
#: a bucket of 128 ns holds each of these limits
_durations = st.one_of(
    st.integers(0, 10**10), st.sampled_from(LIMITS_NS).flatmap(lambda limit: st.integers(limit - 200, limit + 200))
)


@given(st.lists(_durations, min_size=1, max_size=40))
def test_cumulated_counts_and_sum_only_grow_and_are_right_to_a_bucket(durations: list[int]) -> None:
    histogram, before, sum_before = Histogram(), [0] * (len(LIMITS_NS) + 1), 0
    for seen, ns in enumerate(durations, 1):
        histogram.add(ns)
        counts, total = histogram.in_classes(LIMITS_NS)
        now = list(accumulate(counts))
        assert now[-1] == seen
        assert all(old <= new for old, new in zip(before, now, strict=True))
        assert total >= sum_before
        before, sum_before = now, total
        for limit, count in zip(LIMITS_NS, now, strict=False):
            # the limit itself counts to it, and what is 0.4 % above it may
            assert sum(one <= limit for one in durations[:seen]) <= count
            assert count <= sum(one <= limit * 1.004 for one in durations[:seen])
    assert abs(sum_before - sum(durations)) <= 0.004 * sum(durations)


def test_a_new_maximum_moves_no_earlier_count() -> None:
    """20 000 ns lies in the bucket of 19 968 to 20 031 ns: its middle is above the limit, its first maximum below."""
    histogram = Histogram()
    histogram.add(19_970)
    first, _ = histogram.in_classes([20_000])
    histogram.add(900_000)
    assert (first, histogram.in_classes([20_000])[0]) == ([1, 0], [1, 1])
