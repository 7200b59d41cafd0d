"""Output of dumps and comparisons of parameter lists, as text and JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dpstack.api.lists.list_file import ListComparison, SavedList
from dpstack.cli.terminal import output
from dpstack.text import some_of


def show_dump(
    who: str, found: SavedList[Any], head: Mapping[str, object], unreadable: Sequence[object], *, json: bool
) -> None:
    """The dump ``found``; ``head``: of its JSON line, with its ``file``."""
    if json:
        output.json_line({**head, "parameters": len(found.parameters), "unreadable": unreadable})
        return
    output.line(f"{who}: {len(found.parameters) - len(found.unreadable)} parameters are in {head['file']}")
    for one in found.unreadable:
        output.line(f"not read: {one.title_label}: {one.unreadable}")


def show_comparison(
    who: str,
    found: ListComparison[Any, Any],
    head: Mapping[str, object],
    differences: Sequence[object],
    skipped: Sequence[object],
    *,
    json: bool,
) -> int:
    """The comparison ``found``, otherwise as :func:`show_dump`. Exit code 1 if a parameter differs."""
    if json:
        output.json_line({**head, "same": found.same, "differences": differences, "skipped": skipped})
    else:
        for difference in found.differences:
            output.line(difference.text, "yellow")
        for why in dict.fromkeys(why for _, why in found.skipped):
            labels = some_of([one.label for one, other in found.skipped if other == why])
            output.line(f"not compared: {labels}: {why}")
        count = len(found.differences)
        same = f"{found.same} {'parameter is' if found.same == 1 else 'parameters are'} as in {head['file']}"
        output.line(f"{who}: {same}, {count} {'differs' if count == 1 else 'differ'}")
    return int(bool(found.differences))
