"""Thresholds of the verdicts, each with its unit, its meaning and its source ("our choice" if no source has one)."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Final, NamedTuple

_OURS: Final = "our choice"


class Limit(NamedTuple):
    """A threshold: its name, default, allowed values, unit, meaning and source."""

    name: str
    default: float
    low: float
    high: float
    unit: str
    text: str
    source: str


def _limit(default: float, low: float, high: float, unit: str, text: str, source: str = _OURS) -> Any:
    return field(default=default, metadata={"limit": (low, high, unit, text, source)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Thresholds:
    """Values beyond which a finding is a warning, or critical. :func:`limits` has the meaning of each."""

    min_seconds: float = _limit(5.0, 0, 1e6, "s", "less than this received: the verdict is unknown")
    min_requests: float = _limit(200, 1, 1e9, "requests", "shares of a station count from this number of requests on")
    silence_s: float = _limit(2.0, 0.1, 1e6, "s", "nothing received for this time at the end: the bus is silent")
    bring_up_s: float = _limit(
        10.0, 0, 1e6, "s", "a slave that is asked and not in data exchange for longer is critical",
        "our choice: as long as our master waits for a slave to become ready",
    )  # fmt: skip
    retries_warning: float = _limit(
        0.0005, 0, 1, "share", "exchanges of a station that needed a repetition",
        "our choice: a sound RS-485 segment has none in hours",
    )  # fmt: skip
    retries_critical: float = _limit(0.02, 0, 1, "share", "exchanges of a station that needed a repetition")
    deep_retries_warning: float = _limit(
        1, 1, 1e9, "exchanges", "exchanges that needed two or more repetitions",
        "our choice: with max_retry = 1 (default of many masters) the slave is lost then",
    )  # fmt: skip
    lost_warning: float = _limit(1, 1, 1e9, "times", "times that a slave left data exchange")
    lost_critical: float = _limit(3, 1, 1e9, "times", "times that a slave left data exchange")
    refusals_warning: float = _limit(0.001, 0, 1, "share", "answers RS or RR of a station; of an S7-200 RS only")
    late_warning: float = _limit(0.0005, 0, 1, "share", "answers that came after the next telegram had begun")
    damaged_warning: float = _limit(0.0002, 0, 1, "share", "damaged transmissions among all of the bus")
    damaged_critical: float = _limit(0.01, 0, 1, "share", "damaged transmissions among all of the bus")
    neighbours: float = _limit(
        10, 1, 1e6, "times", "one station has this multiple of the retries of all others: it alone"
    )
    many_stations: float = _limit(
        3, 2, 126, "stations", "this number of stations fail in the same second: they fail at once"
    )
    bursts: float = _limit(0.1, 0, 1, "share", "half of the failures within this share of the seconds: in bursts")
    drops_warning: float = _limit(1, 1, 1e9, "times", "times that a master dropped out of the token ring")
    drops_critical: float = _limit(3, 1, 1e9, "times", "times that a master dropped out of the token ring")
    tsdr_of_max: float = _limit(
        1.0, 0, 100, "times", "p99 of T_SDR above this multiple of the MaxTsdr of its GSD file",
        "MaxTsdr_<rate> is the longest T_SDR of the device (GSD specification)",
    )  # fmt: skip
    tsdr_of_t_sl: float = _limit(
        0.9, 0, 1, "share", "longest T_SDR as a share of T_SL",
        "a master repeats its request after T_SL (IEC 61158-4-3); the rest is our choice",
    )  # fmt: skip
    tsdr_of_past: float = _limit(1.5, 1, 1e6, "times", "median of T_SDR in a minute against the station's first minute")


def limits() -> tuple[Limit, ...]:
    """All thresholds, in the order of docs/how-to/monitor.md."""
    return tuple(_of(one.name, one.default, one.metadata["limit"]) for one in fields(Thresholds))


def _of(name: str, default: Any, limit: tuple[float, float, str, str, str]) -> Limit:
    return Limit(name, default, *limit)
