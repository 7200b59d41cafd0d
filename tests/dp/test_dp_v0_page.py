"""docs/dp-v0.md is the program's, and every test it names exists."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

from tools.make_dp_v0_docs import TARGET, render

ROOT = Path(__file__).resolve().parent.parent.parent


@functools.cache
def names_in(path: Path) -> set[str]:
    """Tests and test classes of a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = {node.name for node in tree.body if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
    targets = [t for node in tree.body if isinstance(node, ast.Assign) for t in node.targets]
    return functions | {t.id for t in targets if isinstance(t, ast.Name)}


def test_the_page_is_written_by_the_tool() -> None:
    assert TARGET.read_text(encoding="utf-8") == render(), "run tools/make_dp_v0_docs.py"


def test_modules_and_tests_named_on_the_page_exist() -> None:
    text = TARGET.read_text(encoding="utf-8")
    named = re.findall(r"`([\w/]+\.py)::(\w+)`", text)
    assert len(named) > 20
    assert [f"{file}::{test}" for file, test in named if test not in names_in(ROOT / "tests" / file)] == []
    modules = re.findall(r"`([\w/]+\.py)`", text)
    assert [m for m in modules if not any((base / m).exists() for base in (ROOT / "dpstack", ROOT))] == []
