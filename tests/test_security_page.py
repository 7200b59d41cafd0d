"""docs/explanation/security.md: every promise has tests that exist; every dependency has a range and a reason."""

from __future__ import annotations

import ast
import functools
import re
import tomllib
from pathlib import Path

import pytest
from promises import PROMISES, ROOT, promises

TESTS = ROOT / "tests"
PROJECT = ROOT / "pyproject.toml"


@functools.cache
def _functions(path: Path) -> dict[str, ast.FunctionDef | ast.AsyncFunctionDef]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name: node for node in tree.body if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))}


def test_every_promise_of_the_page_has_tests() -> None:
    written = promises()
    assert len(written) > 40
    assert list(written) == list(PROMISES)
    assert [number for number, tests in PROMISES.items() if not tests] == []


@pytest.mark.parametrize("number", PROMISES)
def test_the_tests_of_a_promise_exist_and_assert(number: str) -> None:
    for test in PROMISES[number]:
        file, _, name = test.partition("::")
        function = _functions(TESTS / file).get(name)
        assert function is not None, f"{test} of promise {number} is gone: name the test that shows it now"
        marks = [ast.unparse(mark) for mark in function.decorator_list]
        assert not [mark for mark in marks if mark.startswith(("pytest.mark.skip(", "pytest.mark.xfail"))], test
        text = ast.unparse(function)
        named = {node.id for node in ast.walk(function) if isinstance(node, ast.Name)}
        text += "".join(ast.unparse(one) for other, one in _functions(TESTS / file).items() if other in named)
        # a test that suppresses the one allowed exception fails at any other
        assert re.search(r"assert[ _]|pytest\.raises|suppress\(", text), f"{test} asserts nothing"


def _dependencies() -> list[tuple[str, str]]:
    """Each requirement of pyproject.toml, with the comment above it."""
    found: list[tuple[str, str]] = []
    comment: list[str] = []
    for line in (
        PROJECT.read_text(encoding="utf-8")
        .partition("[project.scripts]")[0]
        .partition("\ndependencies = [")[2]
        .splitlines()
    ):
        text = line.strip()
        if text.startswith("#"):
            comment.append(text.lstrip("# "))
        elif text.startswith('"') and re.match(r'"[\w.-]+(\[.*\])?[<>=~! ;]', text):
            found.append((text.strip(",").strip('"'), " ".join(comment)))
            comment = []
        else:
            comment = []
    return found


def test_every_dependency_has_a_range_and_a_reason() -> None:
    written = _dependencies()
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    extras = [one for many in project["optional-dependencies"].values() for one in many]
    needed = [one for one in (*project["dependencies"], *extras) if not one.startswith("dpstack[")]
    assert sorted(needed) == sorted(one for one, _ in written)
    for requirement, reason in written:
        assert re.search(r">=\d", requirement), f"{requirement}: which version is the lowest that works?"
        assert "<" in requirement, f"{requirement}: from which major version on may it break?"
        assert len(reason) > 20, f"{requirement}: a comment above it says what it is for"


def test_the_release_page_names_every_extra_and_the_tools() -> None:
    page = (ROOT / "docs" / "development" / "release.md").read_text(encoding="utf-8")
    for tool in ("cyclonedx-py environment", "pip-audit", "python -m build", "SOURCE_DATE_EPOCH"):
        assert tool in page
