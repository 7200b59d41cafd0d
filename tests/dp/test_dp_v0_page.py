"""docs/reference/dp-v0.md is the program's, and every test that it, dp-v1.md and ends.md name exists."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest

from dpstack.dp.slave.state_table import ACCESS
from tools.make_dp_v0_docs import TARGET, render

ROOT = Path(__file__).resolve().parent.parent.parent
DP_V1 = ROOT / "docs" / "how-to" / "dp-v1.md"
ENDS = ROOT / "docs" / "explanation" / "ends.md"


@functools.cache
def names_in(path: Path) -> set[str]:
    """Tests and test classes of a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = {
        node.name for node in tree.body if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef))
    }
    targets = [t for node in tree.body if isinstance(node, ast.Assign) for t in node.targets]
    return functions | {t.id for t in targets if isinstance(t, ast.Name)}


def test_the_page_is_written_by_the_tool() -> None:
    assert TARGET.read_text(encoding="utf-8") == render(), "run tools/make_dp_v0_docs.py"


def rows() -> list[str]:
    """Of both tables with tests, without the table of bits (its tests stand above it) and without heads."""
    lines = TARGET.read_text(encoding="utf-8").partition("## The diagnosis, bit by bit")[0].splitlines()
    return [line for line in lines if line.startswith("| ") and not line.startswith("| | the master")]


def test_every_row_names_a_test_for_each_end_it_has() -> None:
    found = rows()
    assert len(found) > 40
    for row in found:
        _, _, _, master, slave_what, slave, _ = re.split(r" ?\| ?", row)
        assert "::" in master, row
        assert "::" in slave or slave_what == "(the master's)", row


def test_every_service_of_the_slave_has_a_row() -> None:
    text = "\n".join(rows()) + DP_V1.read_text(encoding="utf-8")
    assert [a.name for a in ACCESS.values() if not re.search(rf"^\| .*{a.name}", text, re.MULTILINE)] == []


@pytest.mark.parametrize(("page", "least"), [(TARGET, 80), (DP_V1, 15), (ENDS, 5)])
def test_modules_and_tests_named_on_the_page_exist(page: Path, least: int) -> None:
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"`([\w/]+\.py)::(\w+)`", text)
    assert len(named) > least
    assert [f"{file}::{test}" for file, test in named if test not in names_in(ROOT / "tests" / file)] == []
    modules = re.findall(r"`([\w/]+\.py)`", text)
    assert [m for m in modules if not any((base / m).exists() for base in (ROOT / "dpstack", ROOT))] == []
