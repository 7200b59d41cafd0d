"""Writes the snapshots of the stories; the package says how."""

from __future__ import annotations

import sys
from pathlib import Path


def main(names: list[str]) -> None:
    from stories import master, ring, slave

    modules = {"master": master, "ring": ring, "slave": slave}
    for name in names or modules:
        story = modules[name]
        story.SNAPSHOT.write_text("\n".join([*story.lines(range(story.STORIES)), ""]), encoding="utf-8")


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    main(sys.argv[1:])
