"""Turn-arounds by steps and the efficiency to a bare loop: literal times, summed up by hand; a small run."""

from __future__ import annotations

import pytest

from bench import rotation, steps
from bench.records import Record
from bench.report import Report, Table
from bench.rig import Noted
from bench.steps import Steps, turn_arounds, turns


def exchange(to: int, read: int, written: int) -> Record:
    """Read by the wire at ``read``, its answer written at ``written``."""
    return Record(read, read, 0, 0, 0, written, 0x68, to, 21, 21)


#: slaves 3 to 5, the token, slave 3 again
RECORDS = [
    exchange(3, 0, 1_000),
    exchange(4, 1_100, 2_000),
    exchange(5, 2_090, 3_000),
    Record(3_050, 0, 0, 0, 0, 0, 0xDC, -1, 3, 0),
    exchange(3, 3_200, 4_000),
]


def test_steps_of_a_turn_around_follow_one_another_and_sum_up_to_it() -> None:
    noted = [
        Noted(1_020, 1_025, 1_080, 1_095, pumped=30, waited=12, late=3),
        Noted(2_008, 2_012, 2_070, 2_095, pumped=40, waited=0, late=0),  # the wire read it before the write returned
        Noted(3_010, 3_015, 3_180, 3_190, pumped=60, waited=5, late=0),
    ]
    found = turn_arounds(RECORDS, noted, t_id1_ns=25)
    assert found == [Steps(20, 5, 30, 12, 3, 10, 15, 5), Steps(8, 4, 40, 0, 0, 18, 25, -5)]
    assert [sum(each) for each in found] == turns(RECORDS) == [100, 90]


def test_a_waiting_read_is_a_wake_up_and_a_loop_without_pump_waits_for_t_id1() -> None:
    noted = [Noted(200, 1_030, 1_060, 1_080, 0, 0, 0), Noted(1_090, 2_050, 2_060, 2_080, 0, 0, 0)]
    assert turn_arounds(RECORDS, noted, t_id1_ns=25) == [
        Steps(30, 0, 0, 25, 0, 5, 20, 20),
        Steps(50, 0, 0, 10, 0, 0, 20, 10),
    ]


def test_a_turn_around_that_the_master_did_not_note_is_left_out() -> None:
    assert turn_arounds(RECORDS, [Noted(2_008, 2_012, 2_070, 2_085, 40, 0, 0)], 25) == [
        Steps(8, 4, 40, 0, 0, 18, 15, 5)
    ]
    assert turn_arounds(RECORDS, [], 25) == []


def test_figures_of_a_table_stand_in_it_and_not_on_lines_of_their_own() -> None:
    report = Report("steps")
    report.add("alone", 1.0, "us")
    report.add("3 Mbit/s, bare: read", 1.25, "us")
    report.add("3 Mbit/s, asyncio: read", 12.5, "us")
    report.tables.append(Table("3 Mbit/s", ("read", "pump"), ("bare", "asyncio")))
    head, *lines = report.as_text().splitlines()[1:]
    assert "Python" not in head
    assert lines == [
        "  alone        1.00 us",
        "",
        "  3 Mbit/s   read  pump",
        "  bare       1.25     -",
        "  asyncio   12.50     -",
    ]


@pytest.mark.parametrize(
    ("bare", "verdict"), [([0.8, 0.82, 0.6], "met"), ([0.4, 0.41, 0.9], "no verdict"), ([0.95, 0.94, 0.93], "MISSED")]
)
def test_a_driver_is_judged_by_the_bare_loop_unless_that_keeps_the_wire_idle(bare: list[float], verdict: str) -> None:
    report = Report("rotation")
    rotation.to_bare(report, "3 Mbit/s", {"process": [0.8, 0.8, 0.57], "bare": bare}, 0.90)
    (figure,) = report.figures
    assert figure.name == "3 Mbit/s, process: efficiency to the bare loop's"
    assert figure.rounds == pytest.approx([0.8 / bare[0], 0.8 / bare[1], 0.57 / bare[2]])
    assert {"met": True, "MISSED": False, "no verdict": None}[verdict] is figure.met
    assert report.notes == (
        ["3 Mbit/s: no verdict: the bare loop's own efficiency is 0.41, less than 0.5"] if figure.met is None else []
    )


def test_steps_run_on_a_wire() -> None:
    words = ["--bauds", "1500000", "--slaves", "3", "--rounds", "1", "--seconds", "0.05"]
    report = steps.run([*words, "--kinds", "bare", "asyncio"])
    columns = ("wake-up", "read", "pump", "T_ID1", "late", "driver", "write", "to the wire")
    values = {figure.name: figure.value for figure in report.figures}
    for kind in ("bare", "asyncio"):
        whole = values.pop(f"1.5 Mbit/s, {kind}: turn-around")
        assert values.pop(f"1.5 Mbit/s, {kind}: without noting") > 0
        assert sum(values.pop(f"1.5 Mbit/s, {kind}: {column}") for column in columns) == pytest.approx(whole)
    assert values == {}
