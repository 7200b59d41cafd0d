"""The statements of parsed Python sources: a tenth of the nodes that ``ast.walk`` visits. Tests read all sources."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final

_BODIES: Final = ("body", "handlers", "cases", "orelse", "finalbody")


def statements(tree: ast.AST) -> Iterator[ast.stmt]:
    """The statements of ``tree``, also those inside others, level by level. Expressions have none and are left out."""
    todo = [tree]
    for node in todo:
        if isinstance(node, ast.stmt):
            yield node
        for name in _BODIES:
            inner = getattr(node, name, ())
            if type(inner) is list:  # the body of a lambda is no statement
                todo += inner


@cache  # parsing the whole product takes seconds
def import_statements(path: Path) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """The imports of a Python source, also those under TYPE_CHECKING and inside functions. Raises SyntaxError."""
    tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
    return tuple(node for node in statements(tree) if isinstance(node, (ast.Import, ast.ImportFrom)))
