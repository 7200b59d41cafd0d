"""Writes docs/fdl-states.md from the transition table; a test holds the file to it."""

from __future__ import annotations

from pathlib import Path

from dpstack.fdl.active.states import render

TARGET = Path(__file__).resolve().parent.parent / "docs" / "fdl-states.md"


def main() -> None:
    TARGET.write_text(render(), encoding="utf-8")


if __name__ == "__main__":
    main()
