"""The texts of the rooms dp and dpv1 in full, one line each, kept in ``tests/snapshots`` so that a change is a diff.

``python tests/kits/said_texts.py`` writes the files anew. :mod:`said_dp` and :mod:`said_dpv1` have the cases.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

SNAPSHOTS = Path(__file__).parents[1] / "snapshots"
#: a case and its text
Said = tuple[str, str]
Group = Callable[[], Iterable[Said]]


def refused(call: Callable[..., Any], *values: Any, **named: Any) -> Said:
    """The call as a person writes it, and the class and message of what it raises, or its result."""
    name = getattr(call, "__qualname__", repr(call))
    arguments = ", ".join([*map(_shown, values), *(f"{key}={_shown(value)}" for key, value in named.items())])
    try:
        said = _shown(call(*values, **named))
    except Exception as error:
        said = f"{type(error).__name__}: {error}"
    return f"{name}({arguments})", said


def _shown(value: object) -> str:
    if isinstance(value, bytes | bytearray):
        return f"<{value.hex(' ')}>" if len(value) < 16 else f"<{len(value)} octets from {value[:4].hex(' ')}>"
    return repr(value)


def lines_of(groups: Mapping[str, Group]) -> list[str]:
    """One line of JSON for each case: group, case, text."""
    return [json.dumps([name, *said], ensure_ascii=False) for name, group in groups.items() for said in group()]


def kept(file: str, name: str) -> list[str]:
    """The lines of the group ``name`` in the snapshot."""
    lines = (SNAPSHOTS / file).read_text(encoding="utf-8").splitlines()
    return [line for line in lines if json.loads(line)[0] == name]


def main() -> None:
    import said_dp
    import said_dpv1

    for module in (said_dp, said_dpv1):
        (SNAPSHOTS / module.FILE).write_text("\n".join([*lines_of(module.GROUPS), ""]), encoding="utf-8")


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))
    main()
