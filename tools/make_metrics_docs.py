"""Writes the table of docs/reference/metrics.md from dpstack.bridge.metrics.table; a test holds the page to it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from dpstack.bridge.metrics.table import METRICS

TARGET: Final = Path(__file__).resolve().parent.parent / "docs" / "reference" / "metrics.md"
_BEGIN: Final = "<!-- table: metrics -->\n"
_END: Final = "<!-- end -->"


def rows() -> Iterator[str]:
    yield "| metric | kind | labels | meaning |"
    yield "|---|---|---|---|"
    for metric in METRICS:
        labels = ", ".join(f"`{label}`" for label in metric.labels)
        yield f"| `{metric.name}` | {metric.kind} | {labels} | {metric.text} |"


def render(page: str) -> str:
    """``page`` with its table as it is now."""
    before, begin, rest = page.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    return before + begin + "\n".join(rows()) + "\n" + end + after


def main() -> None:
    TARGET.write_text(render(TARGET.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
