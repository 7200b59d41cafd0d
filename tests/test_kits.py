"""The maps of tests/kits and of its packages name each of their modules."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from file_scheduling import LONG_FILES

KITS = Path(__file__).parent / "kits"


@pytest.mark.parametrize(
    "folder", sorted(path.parent for path in KITS.rglob("__init__.py")), ids=lambda path: path.name
)
def test_a_map_names_each_module(folder: Path) -> None:
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))) or ""
    modules = {path.stem for path in folder.glob("*.py")} | {path.parent.name for path in folder.glob("*/__init__.py")}
    assert modules - {"__init__", "__main__"} <= set(re.findall(r"``(\w+)``", text))


def test_the_files_that_begin_first_are_there() -> None:
    assert [name for name in LONG_FILES if not (KITS.parents[1] / name).is_file()] == []
