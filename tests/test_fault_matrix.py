"""The fault matrix is what it was; see :mod:`fault_matrix`."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

import pytest
from fault_matrix import Cell, Fault, cells, kept, line
from fault_matrix_rows import FAULTS

ADVICE = "read the diff; when it is meant, run: python tests/kits/fault_matrix.py, and say why in the commit"


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


@pytest.mark.soak
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_all_cells(fault: Fault) -> None:
    compare(list(cells([fault])))
