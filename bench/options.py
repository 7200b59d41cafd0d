"""Types of command line options of the benchmarks. Each refuses a value with one line that says what it takes."""

from __future__ import annotations

import argparse
from typing import Final

#: the slaves of a line have consecutive addresses, and a ring of two masters has twice as many
_MOST_SLAVES: Final = 100


def count(text: str) -> int:
    """A number of rounds and the like: 1 or more."""
    if text.isdecimal() and int(text) >= 1:
        return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1 on")


def slaves(text: str) -> int:
    """A number of slaves: 1..100."""
    if text.isdecimal() and 1 <= int(text) <= _MOST_SLAVES:
        return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is no number of slaves from 1 to {_MOST_SLAVES}")


def duration(text: str) -> float:
    """A time above 0 in the unit of the option."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if 0 < value < float("inf"):
        return value
    raise argparse.ArgumentTypeError(f"{text!r} is no time above 0")
