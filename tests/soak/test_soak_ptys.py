"""The long run on ptys with both drivers, for a moment, and the count of its far end."""

from __future__ import annotations

import pytest
from process_kit import DRIVERS
from soak import results
from soak.far_end import Arrivals, FarEnd
from soak.ptys import start

MS = 1_000_000


@pytest.mark.soak
def test_two_minutes_with_both_drivers_side_by_side() -> None:
    for run in [start(driver, 2) for driver in DRIVERS]:
        line = run.result()
        assert results.problems(line) == []
        assert line["exchanges"] > 1000


def test_the_far_end_counts_telegrams_by_their_octets() -> None:
    far = FarEnd(10 * MS, 1000 * MS, ["3:0696:f3f1:12:12"])
    far.begun = True
    prm = bytes.fromhex("68 0C 0C 68 83 82 5D 3D 3E 80 00 00 0B 06 96 00 04 16")
    cfg = bytes.fromhex("68 07 07 68 83 82 7D 3E 3E F3 F1 E2 16")
    data = bytes.fromhex("68 0F 0F 68 03 02 5D" + 12 * "01" + "6E 16")
    token = bytes.fromhex("DC 02 02")
    assert far.feed(token + prm, 0) == b"\xe5"
    assert far.feed(cfg, 1) == b"\xe5"
    assert far.feed(data[:5], 2) == b""
    assert far.feed(data[5:], 3)[7:19] == data[7:19]
    assert far.feed(data, 4)[7:19] == data[7:19]  # repeated, as its frame count says
    assert far.feed(b"\x00" + token, 5) == b""
    found = far.account()
    assert (found["tokens"], found["telegrams"], found["junk"], found["repeats"]) == (2, 6, 1, 1)
    assert found["exchanges"] == {"3": 1}
    assert found["windows"] == [[1, 0, 0, 0]]


def test_arrivals_on_a_grid() -> None:
    arrivals = Arrivals(10 * MS, 50 * MS)
    for at in (0, 10, 19, 33, 52, 63, 70):  # in ms: early by 1, late by 3, 2 and 3; 40 is left out
        arrivals.add(at * MS)
    assert arrivals.windows == [[4, 0, -MS, 3 * MS], [3, 1, 0, 3 * MS]]
