"""What every benchmark prints: the machine, the versions, figures with their unit, goals as ratios of one run."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path


@dataclass
class Figure:
    """One figure; ``goal`` is an upper bound where the project has set one."""

    name: str
    value: float
    unit: str
    goal: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether the goal is met; None without a goal."""
        return None if self.goal is None else self.value <= self.goal


@dataclass
class Report:
    """All figures of one benchmark."""

    name: str
    figures: list[Figure] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, name: str, value: float, unit: str, goal: float | None = None) -> None:
        """One more figure."""
        self.figures.append(Figure(name, value, unit, goal))

    def as_json(self) -> str:
        """One object with machine, versions, figures and notes."""
        return json.dumps(
            {
                "benchmark": self.name,
                "machine": machine(),
                "figures": {f.name: {"value": round(f.value, 3), "unit": f.unit, "goal": f.goal} for f in self.figures},
                "notes": self.notes,
            }
        )

    def as_text(self) -> str:
        """Lines for people."""
        about = machine()
        lines = [f"{self.name}: Python {about['python']}, {about['processors']} processors, {about['processor']}"]
        width = max((len(f.name) for f in self.figures), default=0)
        for f in self.figures:
            goal = "" if f.goal is None else f"   goal {f.goal:g}: {'met' if f.met else 'MISSED'}"
            lines.append(f"  {f.name:<{width}}  {f.value:>10.2f} {f.unit}{goal}")
        return "\n".join(lines + [f"  {note}" for note in self.notes])


def machine() -> dict[str, object]:
    """Machine and versions, so that figures of different runs are not compared by mistake."""
    versions = {}
    for name in ("dpstack", "pyserial", "pyserial-asyncio", "construct"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
        "processor": _processor(),
        "processors": os.cpu_count(),
        "versions": versions,
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"


def quantile(values: Sequence[float], q: float) -> float:
    """The value at or above which a share ``q`` of ``values`` lies (nearest rank)."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, max(0, round(q * len(ordered)) - 1))]
