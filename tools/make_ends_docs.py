"""Writes the table of docs/explanation/ends.md from tests/snapshots/ends.json, which a recording slave has measured.

    python tools/make_ends_docs.py              the page from the data
    python tools/make_ends_docs.py --measure    measures all rows first, about 10 minutes (see tests/kits/ends)

A test holds the page to the data.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
TARGET: Final = ROOT / "docs" / "explanation" / "ends.md"
DATA: Final = ROOT / "tests" / "snapshots" / "ends.json"
_MEASURE: Final = ROOT / "tests" / "kits" / "ends"
_BEGIN: Final = "<!-- table: ways out -->\n"
_END: Final = "<!-- end -->"

_COLUMNS: Final = (
    ("way out", "program", "driver", "last octets to the slave", "safe by", "slave without watchdog"),
    ("messages", "exit code"),
)
_PROGRAMS: Final = {"application": "application", "blocking": "script", "run": "`dpstack run`"}
#: the groups of the data in the order of the page, with the words before a row's own
_GROUPS: Final = {
    "end": "",
    "exception": "exception: ",
    "connector": "a [connector](bridge.md): ",
    "cancellation": "cancellation: ",
    "signal": "signal ",
    "stopped": "stopped ",
    "terminal": "terminal ",
    "standard output": "standard output: ",
    "port": "port ",
    "bus process": "bus process: ",
    "full disk": "full disk: ",
    "no handles": "no file descriptors: ",
    "no memory": "no memory: ",
}
_KEY: Final = re.compile(r"(?P<group>[\w ]+): (?P<text>.*); (?P<program>\w+), (?P<driver>\w+)")
_REAL_TIME: Final = re.compile(r"SIGRT(MIN|MAX)?(\+\d+)?$")

#: characters of each message on the page
_MOST: Final = 110

#: measured cells of one row
Cells = tuple[str, ...]


def _cells(row: Mapping[str, str]) -> Cells:
    parts = row["told"].replace("`", "'").split(" / ") if row["told"] else []
    told = " / ".join(f"`{textwrap.shorten(part, _MOST, placeholder=' ...')}`" for part in parts) or "nothing"
    return (row["last"], row["safe by"], row["without watchdog"], told, row["exit"])


def _without_own_name(cells: Cells, text: str) -> Cells:
    """Signals that differ only by their own names have the same outcome."""
    return tuple(re.sub(rf"\b{re.escape(text)}(?!\w)", "it", cell) for cell in cells)


def _joined(names: Iterable[str]) -> str:
    """Signals in words; all real-time signals are one. A text may have commas of its own."""
    plain = [name for name in names if not _REAL_TIME.match(name)]
    real_time = [name for name in names if _REAL_TIME.match(name)]
    mark = ", " if all(name.startswith("SIG") for name in plain) else "; "
    return mark.join(plain + (["SIGRTMIN to SIGRTMAX"] if len(real_time) > 1 else real_time))


def rows(data: Mapping[str, Mapping[str, str]]) -> list[str]:
    """The lines of the table. Rows of equal outcome are one: drivers, programs, signals."""
    outcomes: dict[tuple[str, str], dict[tuple[str, str], Cells]] = {}
    for key, row in data.items():
        found = _KEY.fullmatch(key)
        assert found is not None, key
        group, text = found["group"], found["text"]
        cells = _without_own_name(_cells(row), text) if group in ("signal", "bus process") else _cells(row)
        outcomes.setdefault((group, text), {})[found["program"], found["driver"]] = cells
    # texts of a group that have the same outcomes everywhere stand together
    alike: dict[tuple[str, tuple[tuple[tuple[str, str], Cells], ...]], list[str]] = {}
    for (group, text), by_place in outcomes.items():
        alike.setdefault((group, tuple(by_place.items())), []).append(text)
    lines = []
    for group, words in _GROUPS.items():
        for (of, found_there), texts in alike.items():
            if of == group:
                lines += _of_one(words + _joined(texts), dict(found_there))
    return lines


def _of_one(text: str, by_place: Mapping[tuple[str, str], Cells]) -> list[str]:
    """The lines of one way out: one for each outcome."""
    places: dict[Cells, list[tuple[str, str]]] = {}
    for place, cells in by_place.items():
        places.setdefault(cells, []).append(place)
    lines = []
    for cells, where in places.items():
        by_program: dict[tuple[str, ...], list[str]] = {}
        for program in dict.fromkeys(program for program, _ in where):
            drivers = tuple(driver for of, driver in where if of == program)
            by_program.setdefault(drivers, []).append(_PROGRAMS[program])
        for drivers, programs in by_program.items():
            lines.append(" | ".join((f"| {text}", ", ".join(programs), ", ".join(drivers), *cells)) + " |")
            text = "the same"
    return lines


def render(page: str, data: Mapping[str, Mapping[str, str]]) -> str:
    """``page`` with the table of ``data``."""
    columns = [name for line in _COLUMNS for name in line]
    head = [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]
    before, _, rest = page.partition(_BEGIN)
    _, _, after = rest.partition(_END)
    return before + _BEGIN + "\n".join([*head, *rows(data)]) + "\n" + _END + after


def main() -> None:
    if "--measure" in sys.argv:
        subprocess.run([sys.executable, str(_MEASURE)], check=True)
    data = json.loads(DATA.read_text(encoding="utf-8"))
    TARGET.write_text(render(TARGET.read_text(encoding="utf-8"), data), encoding="utf-8")


if __name__ == "__main__":
    main()
