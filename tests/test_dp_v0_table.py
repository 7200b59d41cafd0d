"""The table of DP-V0 at the slave in the documents: the tests it names exist, and no service is left out."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

from dpstack.dp.slave_states import ACCESS

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "dp-v0-slave.md"
_TEST = re.compile(r"`([\w/]+\.py)::(\w+)`")


def rows(page: Path) -> list[str]:
    lines = page.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line.startswith("| ") and not line.startswith("| service or option")]


@cache
def names_in(path: str) -> frozenset[str]:
    file = ROOT / "tests" / path
    tree = ast.parse(file.read_text(encoding="utf-8")) if file.exists() else ast.Module(body=[], type_ignores=[])
    return frozenset(node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def test_every_row_names_tests_that_exist() -> None:
    found = rows(PAGE)
    assert found
    missing: list[str] = []
    for row in found:
        named = _TEST.findall(row)
        if not named:
            missing.append(row)
        missing += [f"{path}::{test}" for path, test in named if test not in names_in(path)]
    assert missing == []


def test_every_service_of_the_slave_has_a_row() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert [
        access.name for access in ACCESS.values() if not re.search(rf"^\| .*{access.name}", text, re.MULTILINE)
    ] == []
