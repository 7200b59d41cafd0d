"""The progress of reading files: one line on standard error that is written over, on a terminal only."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable
from typing import Final

#: nothing is shown before, in s; then so often
_EVERY_S: Final = 0.5
_CLEAR: Final = "\r\x1b[K"


class Progress:
    """Shows how much of the files ``names`` was read."""

    def __init__(self, names: Iterable[str]) -> None:
        self._on = sys.stderr.isatty() and os.environ.get("TERM", "dumb") != "dumb"
        self._sizes = {name: os.path.getsize(name) if os.path.isfile(name) else 0 for name in names} if self._on else {}
        self._next = time.monotonic() + _EVERY_S
        self._shown = False

    def at(self, name: str, octets: int) -> None:
        """``octets`` of the file ``name`` were read, and all files before it."""
        if not self._on or time.monotonic() < self._next:
            return
        self._next = time.monotonic() + _EVERY_S
        names = list(self._sizes)
        number = names.index(name)
        done, whole = sum(self._sizes[one] for one in names[:number]) + octets, sum(self._sizes.values())
        share = min(100, 100 * done // whole) if whole else 100
        file = f", file {number + 1} of {len(names)}" if len(names) > 1 else ""
        sys.stderr.write(f"{_CLEAR}{share} % of {whole / 1e6:.0f} MB{file}")
        sys.stderr.flush()
        self._shown = True

    def clear(self) -> None:
        """Other lines follow."""
        if self._shown:
            sys.stderr.write(_CLEAR)
            sys.stderr.flush()
            self._shown = False
