"""docs/development/asyncua.md names methods that exist, tests that exist, and the version that is installed."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

from dpstack.bridge import opcua

PAGE = (Path(__file__).parents[2] / "docs" / "development" / "asyncua.md").read_text(encoding="utf-8")
CODE = Path(opcua.__file__).parent
ROWS = [
    (re.findall(r"`([\w.]+)`", cells[1]), re.findall(r"`(test_\w+)`", cells[2]))
    for line in PAGE.splitlines()
    if line.startswith("| ") and len(cells := line.strip("| ").split(" | ")) == 3 and "`" in cells[1]
]


def _methods(file: Path) -> Iterator[str]:
    """The functions of ``file`` and the methods of its classes, with the file in front."""
    for one in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(one, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield f"{file.stem}.{one.name}"
        if isinstance(one, ast.ClassDef):
            yield from (
                f"{file.stem}.{one.name}.{part.name}"
                for part in one.body
                if isinstance(part, (ast.FunctionDef, ast.AsyncFunctionDef))
            )


def test_each_row_names_methods_and_tests_that_exist() -> None:
    assert len(ROWS) > 25
    methods = {name for file in CODE.glob("*.py") for name in _methods(file)}
    named = {name for names, _ in ROWS for name in names}
    assert named <= methods, named - methods
    sources = "".join(file.read_text(encoding="utf-8") for file in Path(__file__).parent.glob("test_*.py"))
    tests = {test for _, found in ROWS for test in found}
    assert all(found for _, found in ROWS)
    assert {test for test in tests if f"def {test}(" not in sources} == set()


def test_each_method_that_replaces_one_of_asyncua_stands_on_the_page() -> None:
    for file in sorted(CODE.glob("*.py")):
        module = importlib.import_module(f"{opcua.__name__}.{file.stem}")
        for cls in vars(module).values():
            if not inspect.isclass(cls) or cls.__module__ != module.__name__:
                continue
            theirs = [base for base in cls.__mro__ if base.__module__.startswith("asyncua")]
            for name, member in vars(cls).items():
                if callable(member) and name != "__init__" and any(name in vars(base) for base in theirs):
                    assert f"`{file.stem}.{cls.__name__}.{name}`" in PAGE


def test_the_version_is_the_one_that_was_tried() -> None:
    assert version("asyncua") in PAGE, "try the rows of the page with this version, and write it there"
