"""The data of a picture of a recording: panes by unit, gaps, bands, a choice of columns, and how much finds room."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from dpstack.errors import UsageError
from dpstack.record.plot import MOST_BANDS, MOST_TRACES, Drawing, drawing_of
from dpstack.record.reader import Recording


def drawn(path: Path, lines: list[str], *names: str) -> Drawing:
    path.write_text("\n".join(lines) + "\n")
    return drawing_of(Recording(path), names)


HEAD = "time,t,a.state,a.level [bar],a.limit [bar],a.speed,a.on,note"


def at(second: int) -> str:
    return f"2026-01-31T12:00:{second:02}.000Z,{second}"


LINES = [
    HEAD,
    f"{at(0)},data_exchange,1.5,9,0,true,",
    f"{at(1)},data_exchange,1.6,9,,true,lost 3",
    f"{at(2)},offline,,,,,",
    f"{at(3)},data_exchange,1.7,9,1,false,",
    f"{at(9)},data_exchange,1.8,9,1,false,",
    f"{at(10)},,,,,,end of the recording",
]


def test_panes_bands_and_gaps(tmp_path: Path) -> None:
    of = drawn(tmp_path / "a.csv", LINES)
    assert (of.rows, of.ended_at, of.began) == (6, 10.0, 1_769_860_800.0)
    assert {unit: [trace.name for trace in traces] for unit, traces in of.panes.items()} == {
        "bar": ["a.level", "a.limit"],
        "": ["a.speed"],
    }
    level = of.panes["bar"][0]
    points = [(t, None if math.isnan(value) else value) for t, value in zip(level.at, level.values, strict=True)]
    # between 3 s and 9 s the program wrote no row: nothing is known about that time
    assert points == [(0, 1.5), (1, 1.6), (2, None), (3, 1.7), (3, None), (9, 1.8), (10, None)]
    state, on = of.bands
    assert (state.name, on.name) == ("a.state", "a.on")
    assert state.spans == [(0, 2, "data_exchange"), (2, 3, "offline"), (9, 10, "data_exchange")]
    assert on.spans == [(0, 2, "true"), (9, 10, "false")]
    assert of.notes == [(1, "lost 3"), (10, "end of the recording")]


def test_a_choice_of_slaves_and_columns(tmp_path: Path) -> None:
    of = drawn(tmp_path / "a.csv", LINES, "a.speed")
    assert (list(of.panes), of.bands) == ([""], [])
    assert len(drawn(tmp_path / "a.csv", LINES, "a").bands) == 2
    with pytest.raises(UsageError, match=r"has neither a slave nor a column 'b'; there are: a$"):
        drawn(tmp_path / "a.csv", LINES, "b")
    with pytest.raises(UsageError, match="has no rows"):
        drawn(tmp_path / "a.csv", [HEAD])


def test_columns_without_room_are_named(tmp_path: Path) -> None:
    numbers = [f"s{n}.x" for n in range(MOST_TRACES + 2)]
    bits = [f"s{n}.b" for n in range(MOST_BANDS + 1)]
    line = ",".join([at(0), *["1.5"] * len(numbers), *["true"] * len(bits)])
    lines = [",".join(["time,t", *numbers, *bits]), line, line.replace(":00.000Z,0", ":01.000Z,1")]
    of = drawn(tmp_path / "a.csv", lines)
    assert of.left_out == [*numbers[MOST_TRACES:], *bits[MOST_BANDS:]]
