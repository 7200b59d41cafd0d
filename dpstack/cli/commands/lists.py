"""Output of parameter lists, dumps and comparisons, as text and JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from dpstack.api.control.commands import Spec
from dpstack.api.control.record_orders import COMPARE, DUMP
from dpstack.api.lists.list_file import ListComparison, SavedList
from dpstack.api.lists.record_list import RecordList, compared, list_of
from dpstack.cli.terminal import output

FILES: Final = (
    Spec(DUMP, "FILE [SLOT] [OBJECT]", "that list into a file", "pump.toml"),
    Spec(COMPARE, "FILE [SLOT] [OBJECT]", "where the device differs from such a file", "pump.toml"),
)


def show_list(told: Mapping[str, Any]) -> None:
    found = list_of(told)
    rows = [(one.number, one.name, one.format, one.text, "ro" * one.read_only) for one in found.parameters]
    title = f"{_who(told)}: {len(rows)} parameters of slot {found.slot}, object {found.object}"
    output.table(title, ("number", "name", "format", "values", ""), rows)


def tell_dump(who: str, found: SavedList[Any], path: str) -> None:
    output.line(f"{who}: {len(found.parameters) - len(found.unreadable)} parameters are in {path}")
    for one in found.unreadable:
        output.line(f"not read: {one.title_label}: {one.unreadable}")


def tell_comparison(who: str, found: ListComparison[Any, Any], path: str) -> None:
    for difference in found.differences:
        output.line(difference.text, "yellow")
    for why in dict.fromkeys(why for _, why in found.skipped):
        labels = output.first_of([one.label for one, other in found.skipped if other == why])
        output.line(f"not compared: {labels}: {why}")
    output.line(f"{who}: {found.same} parameters are as in {path}, {len(found.differences)} differ")


def show_dump(told: Mapping[str, Any], path: str, *, json: bool) -> None:
    found = list_of(told)
    if json:
        plain = [one.as_dict() for one in found.unreadable]
        output.json_line({**_head(told, DUMP, path), "parameters": len(found.parameters), "unreadable": plain})
    else:
        tell_dump(_who(told), found, path)


def show_comparison(told: Mapping[str, Any], path: str, saved: RecordList, *, read_only: bool, json: bool) -> int:
    """Exit code 1 where a parameter differs."""
    found = compared(list_of(told), saved, read_only=read_only, where=path)
    if json:
        differences = [
            {"file": one.saved.as_dict(), "device": one.found.as_dict(), "elements": list(one.elements)}
            for one in found.differences
        ]
        skipped = [{"number": one.number, "reason": why} for one, why in found.skipped]
        head = _head(told, COMPARE, path)
        output.json_line({**head, "same": found.same, "differences": differences, "skipped": skipped})
    else:
        tell_comparison(_who(told), found, path)
    return int(bool(found.differences))


def _head(told: Mapping[str, Any], word: str, path: str) -> dict[str, object]:
    kept = {key: told[key] for key in ("slave", "address", "slot", "object", "through")}
    return {"order": word, **kept, "file": path}


def _who(told: Mapping[str, Any]) -> str:
    return f"slave {told['address']} ({told['slave']})"
