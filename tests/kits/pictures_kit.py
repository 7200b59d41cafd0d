"""The pictures of README and docs: the plant that they show, where they are written, and what none of them may show."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
FOLDER: Final = ROOT / "docs" / "pictures"
#: the simulated plant of the pictures; it needs :data:`TANK` beside it
PLANT: Final = FOLDER / "plant.toml"
TANK: Final = FOLDER / "tank.csv"
#: the pictures that are taken, with the tests in tests/strangers that take them (DPSTACK_PICTURES=docs/pictures)
PICTURES: Final = {
    **dict.fromkeys(
        (
            *("plot.png", "screen.png", "screen-narrow.png", "screen-slave.png", "screen-rack.png"),
            *("screen-watch.png", "tutorial-page.png", "tutorial-screen.png"),
        ),
        "test_pictures.py",
    ),
    **dict.fromkeys(
        (
            "web-plant.png",
            "web-slave.png",
            "web-rack.png",
            "web-watch.png",
            "web-scope.png",
            "web-bus.png",
            "web-commissioning.png",
        ),
        "test_web_page_of_a_run.py",
    ),
}
#: a folder of the computer that took the picture, or a port that looks like hardware
_PLACE: Final = re.compile(r"/tmp\b|/home/|/root\b|/work\b|/Users/|pytest|/dev/|COM\d")


def picture_folder(otherwise: Path) -> Path:
    """The folder of DPSTACK_PICTURES, by which a picture goes to the documentation; else ``otherwise``."""
    return Path(os.environ.get("DPSTACK_PICTURES") or otherwise).absolute()


def copy_plant(folder: Path) -> Path:
    """The plant of the pictures in ``folder``."""
    shutil.copy(TANK, folder)
    return Path(shutil.copy(PLANT, folder))


def shows_no_place(text: str) -> None:
    """A picture with ``text`` shows no folder of this computer, and no port of hardware. One for the documentation does
    not say either that this computer was busy: it is to be taken again."""
    found = _PLACE.search(text)
    assert found is None, f"{found[0]!r} in {text}"
    assert "DPSTACK_PICTURES" not in os.environ or "behind real time" not in text, "this computer is busy"
