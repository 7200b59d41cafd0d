"""The session in docs/how-to/blocking.md, line by line."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "how-to" / "blocking.md"
_SESSION = re.compile(r"<!-- session -->\n```text\n(.*?)^```", re.DOTALL | re.MULTILINE)
_CELL = re.compile(r"^In \[(\d+)\]: (.*)\n(?:Out\[\1\]: (.*)\n)?", re.MULTILINE)


def cells() -> list[tuple[str, str]]:
    """Input and output of each cell; the output of a cell without one is empty."""
    (session,) = _SESSION.findall(PAGE.read_text(encoding="utf-8"))
    found = _CELL.findall(session)
    assert [int(number) for number, _, _ in found] == list(range(1, len(found) + 1))
    return [(given, shown) for _, given, shown in found]


def test_the_session_shows_what_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT / "examples")
    shell: dict[str, object] = {}
    for given, shown in cells():
        *before, last = ast.parse(given).body
        exec(compile(ast.Module(before, []), "<cell>", "exec"), shell)
        value = None
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "<cell>", "eval"), shell)
        else:
            exec(compile(ast.Module([last], []), "<cell>", "exec"), shell)
        assert ("" if value is None else repr(value)) == shown, given
