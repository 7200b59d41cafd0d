"""The long runs, in short: a slice in virtual time, its judge and its results file; under tracemalloc; on ptys with
both drivers, and the count of their far end."""

from __future__ import annotations

from pathlib import Path

import pytest
from process_kit import DRIVERS
from soak import results
from soak.far_end import Arrivals, FarEnd
from soak.ptys import start
from soak.slice import SLICE, run_slice
from soak.traced import run_traced
from soak.wire import Grid, WireCount

from dpstack.trace import WireEntry

MS = 1_000_000


def slice_of(number: int, telegrams: int) -> results.Line:
    return {"commit": "", "before": 0, **run_slice(number, telegrams)}


def test_a_small_slice_counts_what_the_wire_counts() -> None:
    line = slice_of(1, 10_000)
    # its memory is that of all tests before it in this process
    assert results.problems(line | {"rss_end": line["rss_warm"]}) == []
    assert line["telegrams"] >= 10_000
    assert line["grid"]["rounds"] > 50


@pytest.mark.soak
@pytest.mark.parametrize("number", [0])
def test_a_whole_slice(number: int) -> None:
    line = slice_of(number, SLICE)
    assert results.problems(line) == []
    assert line["telegrams"] >= SLICE


def test_the_grid_judges_rounds() -> None:
    grid = Grid(10 * MS)
    for at in (5, 15, 25.5, 37, 44.9, 65.1, 80.0, 85):  # in ms
        grid.add(int(at * MS))
    assert grid.rounds == 8
    assert grid.late == 2  # 37 and 80: by more than a tenth
    assert grid.left_out == 1  # that of 55
    assert grid.earliest_ns == -100_000
    assert grid.latest_ns == 5 * MS  # 80 is half a cycle late: still that of 75
    assert grid.off == 5


def test_a_grid_that_drifts_as_a_whole() -> None:
    grid = Grid(10 * MS)
    for number in range(200):
        grid.add(number * 10 * MS + number * 3)
    assert grid.drift_ns == 300
    line = {"slice": 1, "faults": [], "leftovers": [], "rss_end": 0, "rss_warm": 0, "before": 0, "grid": grid.as_dict()}
    assert "drifts" in results.problems(line)[0]


def test_the_wire_is_counted_by_its_octets() -> None:
    wire = WireCount(2)
    for octets in (
        "DC 02 02",
        "10 07 02 49 52 16",  # FDL status of 7, and its answer
        "10 02 07 00 09 16",
        "68 05 05 68 85 82 6D 3C 3E EE 16",  # Slave_Diag of 5
        "68 0B 0B 68 82 85 08 3E 3C 00 0C 00 02 12 34 EF 16",
        "68 07 07 68 85 82 5D 3E 3E 21 11 12 16",  # Chk_Cfg of 5, acknowledged
        "E5",
        "68 07 07 68 FF 82 46 3A 3E 00 00 3F 16",  # Global_Control
        "68 05 05 68 05 02 7D AA BB E9 16",  # Data_Exchange of 5
        "68 05 05 68 02 05 08 11 22 42 16",
        "10 06 02 7D 85 16",  # Data_Exchange of 6, without data
        "68 05 05 68 02 06 08 33 44 87 16",
        "68 05 05 68 05 02 5D AA BB C9 16",  # the next round
        "68 05 05 68 02 05 08 55 66 CA 16",
    ):
        wire(WireEntry(0, 1, bytes.fromhex(octets)))
    assert (wire.telegrams, wire.sent, wire.tokens, wire.polls, wire.polled, wire.broadcasts) == (14, 8, 1, 1, 1, 1)
    assert (wire.asked, wire.answered) == ({5: 2, 6: 1}, {5: 2, 6: 1})
    assert (wire.services, wire.replies) == ({5: 2}, {5: 2})
    assert wire.inputs == {5: b"\x55\x66", 6: b"\x33\x44"}
    assert wire.rounds == 2


def test_a_results_file_that_was_cut_is_read(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "soak.jsonl"
    results.append(path, {"slice": 3})
    with path.open("a", encoding="utf-8") as file:
        file.write('{"slice": 4, "tele')
    assert results.read(path) == [{"slice": 3}]
    assert results.slices_of("3-5") == [3, 4, 5]
    assert results.slices_of("7") == [7]


@pytest.mark.soak
def test_nothing_grows_in_100_000_exchanges() -> None:
    line = run_traced(100_000)
    assert results.problems(line) == []
    assert line["exchanges"] >= 100_000


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
