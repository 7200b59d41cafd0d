"""``Verdict``: the level of a bus or a station, with reasons; of a bus that is listened to, and of one that runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

GOOD, UNKNOWN, WARNING, CRITICAL = "good", "unknown", "warning", "critical"
#: the levels of a verdict, the best first
VERDICTS: Final = (GOOD, UNKNOWN, WARNING, CRITICAL)


class Verdict(NamedTuple):
    """``level``: one of :data:`VERDICTS`; ``reasons``: one line each, the most serious first."""

    level: str
    reasons: tuple[str, ...] = ()


#: a level and its reason
Finding = tuple[str, str]


def verdict_of(findings: Sequence[Finding], doubt: str) -> Verdict:
    """The worst finding decides; without findings the verdict is unknown if there is a ``doubt``."""
    found = sorted(findings, key=lambda finding: -VERDICTS.index(finding[0]))
    if found:
        return Verdict(found[0][0], tuple(text for _, text in found))
    return Verdict(UNKNOWN, (doubt,)) if doubt else Verdict(GOOD)
