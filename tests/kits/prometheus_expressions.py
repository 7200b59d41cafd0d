"""The expressions of tools/prometheus: of the alert rules, and of the panels of the dashboards."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[2]
FOLDER: Final = ROOT / "tools" / "prometheus"
#: the dashboards by the name of their file
BOARDS: Final[dict[str, Any]] = {
    path.name: json.loads(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.dashboard.json"))
}
_ALERT: Final = re.compile(r"^      - alert: (\w+)\n        expr: (.+)\n((?:        .*\n?)*)", re.MULTILINE)
_SERIES: Final = re.compile(r"(?<![\w$:\"])(up|dpstack_\w+)\b(?:\{([^}]*)\})?")


class Expression(NamedTuple):
    """``where``: ``alert NAME`` or ``panel TITLE``; ``legend``: text with labels of the result."""

    where: str
    text: str
    legend: str

    def series(self) -> dict[str, set[str]]:
        """The series that it reads, with the labels by which they are chosen."""
        found: dict[str, set[str]] = {}
        for name, chosen in _SERIES.findall(self.text):
            found.setdefault(name, set()).update(re.findall(r"(\w+) ?=~?", chosen))
        return found


def expressions() -> list[Expression]:
    rules = (FOLDER / "dpstack.rules.yml").read_text(encoding="utf-8")
    found = [Expression(f"alert {name}", text, more) for name, text, more in _ALERT.findall(rules)]
    assert len(found) == rules.count("alert:")
    for panel in (panel for board in BOARDS.values() for panel in board["panels"]):
        found += (Expression(f"panel {panel['title']}", one["expr"], one["legendFormat"]) for one in panel["targets"])
    return found
