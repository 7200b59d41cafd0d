"""Writes the snapshots of the texts; the package says which."""

from __future__ import annotations

import sys
from pathlib import Path


def main() -> None:
    from texts import dp, dpv1, fdl
    from texts.snapshot import SNAPSHOTS, lines_of

    for module in (dp, dpv1, fdl):
        (SNAPSHOTS / module.FILE).write_text("\n".join([*lines_of(module.GROUPS), ""]), encoding="utf-8")


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    main()
