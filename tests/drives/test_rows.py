"""The check list of the drives cannot rot: every row is named by tests of both ends, against literal octets.

A test names its rows in its own name (``test_d7_...``, ``test_k9_k12_...``). Which end it shows is read from its
source, with whatever of its module and of the kits it uses: the plugin is made by ``PluginBench`` or ``core()``, the
simulated drive by ``DeviceBench`` or ``device()``. A test of both against each other shows neither: they share a table
and would be wrong together.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final

import pytest

TESTS: Final = Path(__file__).parent.parent
ROWS: Final = tuple(
    f"{letter}{number}"
    for letter, numbers in {
        "D": range(1, 23),
        "K": range(1, 13),
        "I": range(1, 6),
        "L": range(1, 12),
        "F": range(1, 16),
    }.items()
    for number in numbers
)
PLUGIN, DRIVE = "plugin", "simulated drive"
#: names in the source that make one end; those of PAIR make both and have them talk to each other
MAKES: Final = {"PluginBench": PLUGIN, "core": PLUGIN, "DeviceBench": DRIVE, "device": DRIVE}
PAIR: Final = "PairBench"
#: rows that have one end only, and why
ONE_END: Final = {
    ("D22", PLUGIN): "SYNC is an order of the bus to a group of slaves, plugins know nothing of it",
    ("L10", PLUGIN): "I&M is a matter of program and slave, plugins know nothing of it",
    ("K1", PLUGIN): "the services are those of the bus's slave handler, which every drive has",
}
_NAMED: Final = re.compile(r"test_((?:[dkilf]\d+_)+)")
_OCTETS: Final = re.compile(r"\b[0-9A-Fa-f]{2}(?: [0-9A-Fa-f]{2})+\b")


@cache
def definitions(path: Path) -> dict[str, ast.AST]:
    """What a module defines at its top, and what it takes from the kits beside it, by name."""
    found: dict[str, ast.AST] = {}
    for node in ast.parse(path.read_text()).body:
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                found[name] = node
            case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
                found[name] = node
            case ast.ImportFrom(module=str(module), names=names) if (TESTS / f"{module}.py").exists():
                kit = definitions(TESTS / f"{module}.py")
                found |= {(one.asname or one.name): kit[one.name] for one in names if one.name in kit}
    return found


def used(node: ast.AST, known: dict[str, ast.AST]) -> Iterator[ast.AST]:
    """The nodes of a definition and of all that it uses; the benches themselves are names only."""
    seen: set[str] = set()
    todo = [node]
    while todo:
        for inner in ast.walk(todo.pop()):
            yield inner
            if isinstance(inner, ast.Name) and inner.id in known and inner.id not in (*seen, *MAKES, PAIR):
                seen.add(inner.id)
                todo.append(known[inner.id])


def ends(test: ast.AST, known: dict[str, ast.AST]) -> set[str]:
    """The ends that a test shows against literal octets."""
    found: set[str] = set()
    octets = False
    for node in used(test, known):
        match node:
            case ast.Name(id="PairBench"):
                return set()
            case ast.Name(id="PluginBench" | "DeviceBench" as name):
                found.add(MAKES[name])
            case ast.Call(func=ast.Attribute(attr=name)) if name in MAKES:
                found.add(MAKES[name])
            case ast.Constant(value=str(text)) if _OCTETS.search(text):
                octets = True
            case ast.Constant(value=bytes()):
                octets = True
    return found if octets else set()


@cache
def shown() -> dict[tuple[str, str], list[str]]:
    """The tests of every row and end."""
    found: dict[tuple[str, str], list[str]] = {(row, end): [] for row in ROWS for end in (PLUGIN, DRIVE)}
    for path in sorted(TESTS.rglob("test_*.py")):
        if not re.search(r"def test_[dkilf]\d+_", path.read_text()):
            continue
        known = definitions(path)
        for name, node in known.items():
            if (match := _NAMED.match(name)) is None:
                continue
            for row in match[1].upper().strip("_").split("_"):
                for end in ends(node, known):
                    found.setdefault((row, end), []).append(f"{path.name}::{name}")
    return found


@pytest.mark.parametrize("end", [PLUGIN, DRIVE])
@pytest.mark.parametrize("row", ROWS)
def test_a_row_is_shown_at_both_ends(row: str, end: str) -> None:
    tests = shown()[row, end]
    if (row, end) in ONE_END:
        assert not tests, f"row {row} is shown at the {end} after all: take it out of ONE_END"
    else:
        assert tests, f"no test named test_{row.lower()}_... shows the {end} against literal octets"


def test_no_test_names_a_row_that_is_not_there() -> None:
    assert set(shown()) == {(row, end) for row in ROWS for end in (PLUGIN, DRIVE)}
