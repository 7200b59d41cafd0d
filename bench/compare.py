"""Two reports of one benchmark side by side: ratios, and which of them are more than noise."""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Final

from bench.machine import differences
from bench.report import Figure, Report, report_of

REFERENCE: Final = Path(__file__).resolve().parent / "reference"
#: a difference smaller than this is never told apart, however still the rounds were
_LEAST: Final = 0.03


class Verdict(Enum):
    SAME = "same"  # within the noise of the rounds
    BETTER = "BETTER"
    WORSE = "WORSE"
    UNKNOWN = "?"  # no rounds: nothing is known of the noise; or the units differ
    GONE = "gone"
    NEW = "new"


@dataclass(frozen=True, slots=True)
class Change:
    """One figure in both reports; ``ratio`` is new to old, ``noise`` the share that may be chance."""

    name: str
    unit: str
    old: float | None
    new: float | None
    ratio: float | None
    noise: float | None
    verdict: Verdict


@dataclass(frozen=True, slots=True)
class Comparison:
    """All figures of two reports of one benchmark, and what speaks against comparing them."""

    name: str
    changes: tuple[Change, ...]
    warnings: tuple[str, ...]

    @property
    def worse(self) -> tuple[str, ...]:
        """Names of the figures that became worse beyond noise, and of those that are gone."""
        return tuple(c.name for c in self.changes if c.verdict in (Verdict.WORSE, Verdict.GONE))

    def as_json(self) -> str:
        changes = {
            c.name: {
                "old": c.old,
                "new": c.new,
                "unit": c.unit,
                "ratio": None if c.ratio is None else round(c.ratio, 4),
                "noise": None if c.noise is None else round(c.noise, 4),
                "verdict": c.verdict.value.lower(),
            }
            for c in self.changes
        }
        return json.dumps(
            {"benchmark": self.name, "changes": changes, "worse": list(self.worse), "warnings": list(self.warnings)}
        )

    def as_text(self) -> str:
        width = max((len(c.name) for c in self.changes), default=0)
        lines = [f"{self.name}: {'old':>{width + 5}} {'new':>12} {'new/old':>10} {'noise':>8}"]
        for c in self.changes:
            old, new = (f"{v:>12.2f}" if v is not None else f"{'-':>12}" for v in (c.old, c.new))
            ratio = f"{c.ratio:>10.3f}" if c.ratio is not None else f"{'-':>10}"
            noise = f"{c.noise:>8.0%}" if c.noise is not None else f"{'-':>8}"
            lines.append(f"  {c.name:<{width}} {old} {new} {ratio} {noise} {c.unit:<6} {c.verdict.value}")
        return "\n".join(lines + [f"  {w}" for w in self.warnings])


def compare(old: Report, new: Report) -> Comparison:
    """Both reports figure by figure. Raises ValueError when they are of different benchmarks."""
    if old.name != new.name:
        raise ValueError(f"one report is of {old.name}, the other of {new.name}: they cannot be compared")
    before, after = ({f.name: f for f in report.figures} for report in (old, new))
    names = [*before, *(name for name in after if name not in before)]
    changes = tuple(_change(name, before.get(name), after.get(name)) for name in names)
    warnings = [f"not the same: {difference}" for difference in differences(old.about, new.about)]
    warnings += [f"taken on a busy machine: {report.taken}" for report in (old, new) if report.busy]
    return Comparison(old.name, changes, tuple(warnings))


def _change(name: str, old: Figure | None, new: Figure | None) -> Change:
    if old is None or new is None:
        known = old or new
        assert known is not None
        verdict = Verdict.NEW if old is None else Verdict.GONE
        return Change(name, known.unit, old.value if old else None, new.value if new else None, None, None, verdict)
    ratio = new.value / old.value if old.value and old.unit == new.unit else None
    spreads = (old.spread, new.spread)
    noise = None if None in spreads else max(_LEAST, sum(s for s in spreads if s is not None))
    return Change(name, new.unit, old.value, new.value, ratio, noise, _verdict(ratio, noise, new.more))


def _verdict(ratio: float | None, noise: float | None, more: bool) -> Verdict:
    if ratio is None or noise is None:
        return Verdict.UNKNOWN
    if 1 / (1 + noise) <= ratio <= 1 + noise:
        return Verdict.SAME
    return Verdict.BETTER if (ratio > 1) is more else Verdict.WORSE


def load_report(path: Path) -> Report:
    """A report from a file that ``--json`` or ``--save`` wrote. Raises ValueError that names the file."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(data, dict):
            raise ValueError("no object")
        return report_of(data)
    except (OSError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} cannot be read as a benchmark's JSON: {error}") from None


def reference_of(name: str) -> Path:
    """Where the stored reference of a benchmark is."""
    return REFERENCE / f"{name}.json"


def load_reference(name: str) -> Report:
    """The stored reference of a benchmark. Raises ValueError that says how to get one."""
    if not reference_of(name).exists():
        raise ValueError(f"there is no stored reference of {name} yet: python -m bench {name} --save takes one")
    return load_report(reference_of(name))


def save(report: Report, path: Path) -> None:
    """Store ``report``, in lines that a diff can show."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report.as_dict(), indent=1) + "\n", encoding="utf-8")
