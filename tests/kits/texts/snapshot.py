"""Groups of cases as lines of a snapshot: one line a case, its group, its name and its text."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

SNAPSHOTS = Path(__file__).parents[2] / "snapshots"
#: a case and its text
Case = tuple[str, str]
Group = Callable[[], Iterable[Case]]


def attempt(call: Callable[..., Any], *values: Any, **named: Any) -> Case:
    """The call as source text, and its result or the class and message of the exception."""
    name = getattr(call, "__qualname__", repr(call))
    arguments = ", ".join([*map(_shown, values), *(f"{key}={_shown(value)}" for key, value in named.items())])
    try:
        text = _shown(call(*values, **named))
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
    return f"{name}({arguments})", text


def _shown(value: object) -> str:
    if isinstance(value, bytes | bytearray):
        return f"<{value.hex(' ')}>" if len(value) < 16 else f"<{len(value)} octets from {value[:4].hex(' ')}>"
    return repr(value)


def lines_of(groups: Mapping[str, Group]) -> list[str]:
    """One line of JSON for each case: group, case, text."""
    return [json.dumps([name, *case], ensure_ascii=False) for name, group in groups.items() for case in group()]


def snapshot_lines(file: str, name: str) -> list[str]:
    """The lines of the group ``name`` in the snapshot ``file``."""
    lines = (SNAPSHOTS / file).read_text(encoding="utf-8").splitlines()
    return [line for line in lines if json.loads(line)[0] == name]
