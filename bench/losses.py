"""Why a master lost slaves: what it saw and when, and whether the computer kept the master or the wire from running."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

_STAT: Final = Path("/proc/stat")
#: of the words of the first line of /proc/stat: time in which another guest had the processor (proc(5))
_STEAL: Final = 8
#: so many events are told
_EVENTS: Final = 30
_MS: Final = 1_000_000


def stolen_ns() -> int:
    """For how long the host has kept processors from this virtual machine, all of them together; 0 elsewhere."""
    try:
        words = _STAT.read_text(encoding="ascii").partition("\n")[0].split()
        return int(words[_STEAL]) * 1_000_000_000 // os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0


def story(told: dict[str, Any], wire: dict[str, Any], stolen: int) -> str:
    """One line for people of what a master said last and what its wire says; ``stolen`` ns are the host's.

    Times are counted from the moment when all slaves were in data exchange.
    """
    if "lost" not in told:
        return str(told.get("error", told))
    ready = int(told["ready"])
    parts = [f"lost after {_ms(told['end'] - ready)}: {_named(told['lost']) or 'none'}"]
    parts += [f"failed: {error}" for error in told["failed"]]
    troubled = {name: counts for name, counts in told["asked"].items() if any(counts[1:])}
    parts += [
        f"{name} was asked {requests} times, {retries} retries, given up {timeouts}, late answers {late}"
        for name, (requests, retries, timeouts, late) in troubled.items()
    ]
    parts.append(f"the master's program was held up {_pauses(told['held_up'], ready)}")
    parts.append(f"the wire's process was held up {_pauses(wire.get('held_up', ()), ready)}")
    if wire.get("over"):
        parts.append(f"the wire serves no more: {wire['over']}")
    if stolen:
        parts.append(f"the host kept processors from this machine for {_ms(stolen)}")
    if told["host_us"]:
        parts.append(f"answers came late by (us) {_named(told['host_us'])}")
    events = told["events"]
    parts += [f"{_ms(at - ready)} {name}: {text}" for name, at, text in events[:_EVENTS]]
    if len(events) > _EVENTS:
        parts.append(f"and {len(events) - _EVENTS} more events")
    return "; ".join(parts)


def _named(values: dict[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())


def _pauses(pauses: Sequence[tuple[int, int]], ready: int) -> str:
    """Of (when, how long) in ns."""
    told = [f"{_ms(ns)} at {_ms(at - ready)}" for at, ns in sorted(pauses) if at + ns >= ready]
    return ", ".join(told) or "never for long"


def _ms(ns: int) -> str:
    return f"{ns / _MS:.1f} ms"
