"""The fault matrix is what it was; see :mod:`faults.matrix`."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path

import pytest
from faults.matrix import NOTHING, Cell, Fault, cells, kept, line, table
from faults.rows import FAULTS
from faults.wire import NO_FAULT

ADVICE = "read the diff; when it is meant, run: python tests/kits/faults, and say why in the commit"


def compare(chosen: Sequence[Cell]) -> None:
    lines = kept()
    found = [line(cell) for cell in chosen]
    before = [line(cell, lines.get(cell.title, {})) for cell in chosen]
    diff = list(difflib.unified_diff(before, found, "kept", "found", n=0, lineterm=""))
    if diff:
        pytest.fail("\n".join(["the behaviour under a fault has changed", *diff, ADVICE]))


@pytest.mark.parametrize("fault", [f for f in FAULTS if f.quick], ids=lambda fault: fault.name)
def test_quick_cells(fault: Fault) -> None:
    compare([cell for cell in cells([fault]) if cell.quick])


def test_the_matrix_is_whole() -> None:
    assert list(kept()) == [cell.title for cell in cells(FAULTS)]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_every_cell_holds_its_promises(fault: Fault) -> None:
    """No wrong octet, every bus well again, no slave lost without a reason, no outputs left live."""
    lines = kept()
    for cell in cells([fault]):
        row = lines[cell.title]
        assert row["wrong data"] == 0, cell.title
        if fault.measure is None:  # where a port holds telegrams back, the wire does not show the reason
            assert row.get("dropped wrongly", 0) == 0, cell.title
        assert (row["back after"] == "never") is bool(fault.not_back), cell.title
        assert NOTHING not in str(row.get("made safe by")), cell.title
        if fault.name == NO_FAULT:
            assert row == {
                "exchanges": row["exchanges"],
                "retries": 0,
                "wrong data": 0,
                "back after": 1,
                "last octets": f"{cell.stations} x zeros, Clear x 2",
            }, cell.title


def test_the_table_of_the_reliability_page() -> None:
    page = (Path(__file__).parents[1] / "docs" / "development" / "reliability.md").read_text(encoding="utf-8")
    assert table(FAULTS) in page, "print it with: python tests/kits/faults --table"


@pytest.mark.soak
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_all_cells(fault: Fault) -> None:
    compare(list(cells([fault])))
