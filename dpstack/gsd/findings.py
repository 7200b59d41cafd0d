"""Collector of the findings (diagnostics) of one GSD file, at most 500 of each severity."""

from __future__ import annotations

from typing import Final

from dpstack.gsd.model import Diagnostic, ordered
from dpstack.trace import Severity

_MOST: Final = 500


class Findings:
    """Diagnostics of one file; beyond 500 of a severity the rest is only counted."""

    def __init__(self) -> None:
        self._kept: dict[Severity, list[Diagnostic]] = {severity: [] for severity in Severity}
        self._more: dict[Severity, int] = {}

    def info(self, line: int, column: int, message: str) -> None:
        self._add(Diagnostic(line, column, Severity.INFO, message))

    def warning(self, line: int, column: int, message: str) -> None:
        """Report a violation of the specification or a contradiction; ``message`` says how the file was read."""
        self._add(Diagnostic(line, column, Severity.WARNING, message))

    def error(self, line: int, column: int, message: str) -> None:
        """Report damage of the file."""
        self._add(Diagnostic(line, column, Severity.ERROR, message))

    def _add(self, diagnostic: Diagnostic) -> None:
        kept = self._kept[diagnostic.severity]
        if len(kept) < _MOST:
            kept.append(diagnostic)
        else:
            self._more[diagnostic.severity] = self._more.get(diagnostic.severity, 0) + 1

    def all(self) -> tuple[Diagnostic, ...]:
        """The findings by place, and for each severity with more than 500 their number."""
        counted = [
            Diagnostic(0, 1, severity, f"{more} more findings of this severity are not listed")
            for severity, more in self._more.items()
        ]
        return ordered([*counted, *(d for kept in self._kept.values() for d in kept)])
