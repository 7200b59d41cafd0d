"""Pictures of a terminal, made from the SVG of textual by chromium."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from tests.strangers.stranger_kit import run_program


def box(svg: Path) -> tuple[int, int]:
    found = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg.read_text(encoding="utf-8"))
    assert found is not None
    return round(float(found[1])), round(float(found[2]))


def render(svg: Path, png: Path, folder: Path) -> None:
    width, height = box(svg)
    page = folder / "page.html"
    page.write_text(
        f'<body style="margin:0"><img src="{svg.name}" width="{width}" height="{height}">', encoding="utf-8"
    )
    arguments: list[Any] = [
        "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run", "--disable-dev-shm-usage",
        f"--user-data-dir={folder / 'profile'}", f"--window-size={width},{height}", f"--screenshot={png.absolute()}",
        page.as_uri(),
    ]  # fmt: skip
    run_program("chromium", arguments)
