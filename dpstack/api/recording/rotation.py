"""The argument of ``--rotate``: a size or a time."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from dpstack.errors import UsageError
from dpstack.text import shortened

_GIVEN: Final = re.compile(r"(?P<number>[0-9]{1,9}(?:\.[0-9]{1,3})?) ?(?P<unit>[a-z]+)", re.IGNORECASE)
_OCTETS: Final = {"kb": 1_000, "mb": 1_000_000, "gb": 1_000_000_000}
_SECONDS: Final = {"min": 60, "h": 3600, "d": 86400}
#: a file has at least this many octets, or this many seconds
LEAST_OCTETS: Final = 10_000
LEAST_SECONDS: Final = 60
_SHOWN: Final = 20


@dataclass(frozen=True, slots=True)
class Rotation:
    """When the next file begins: after ``octets``, or after ``seconds``; None: not by that."""

    octets: int | None = None
    seconds: float | None = None

    @classmethod
    def parse(cls, text: str) -> Rotation:
        """``100MB``, ``1.5GB``, ``500kB``, ``1h``, ``30min``, ``1d``. Raises UsageError."""
        match = _GIVEN.fullmatch(text.strip())
        unit = "" if match is None else match["unit"].lower()
        if match is None or unit not in _OCTETS | _SECONDS:
            raise UsageError(
                f"rotate = {shortened(text, _SHOWN)!r}; give a size or a time, for instance 100MB, 1GB, 30min or 1h"
            )
        if unit in _OCTETS:
            octets = round(float(match["number"]) * _OCTETS[unit])
            if octets < LEAST_OCTETS:
                raise UsageError(f"rotate = {text.strip()!r} is too small; a file has 10kB at least")
            return cls(octets=octets)
        seconds = float(match["number"]) * _SECONDS[unit]
        if seconds < LEAST_SECONDS:
            raise UsageError(f"rotate = {text.strip()!r} is too short; a file has 1min at least")
        return cls(seconds=seconds)
