"""Payloads of plain JSON: values, conditions and results for people without Sparkplug; orders that come.

Times are texts of ISO 8601 in UTC, for instance ``2026-11-23T13:00:00.250Z``. docs/reference/mqtt-json.md has each
payload.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any, Final

from dpstack.plant.conditions import Condition
from dpstack.plant.nodes import Node
from dpstack.plant.quality import Quality, Reading, Value, clean
from dpstack.text import json_text, printable, shortened

#: octets of an order from a stranger: the longest value is the hex text of 244 octets
MOST_OCTETS: Final = 2048
#: s since 1970 at the end of the year 9999; a sender that gives milliseconds is far above the other limit
_LATEST: Final = 253_402_300_799.0
_SURELY_MS: Final = 1e11
#: characters of a time
_MOST_TIME: Final = 40
#: characters of a whole number: Python reads no longer ones
_MOST_DIGITS: Final = 4300
#: characters of a name or reason in a result
_MOST_TEXT: Final = 300
_EXAMPLE: Final = '{"value": true, "time": "2026-11-23T13:00:00Z"}'


def time_text(seconds: float) -> str:
    """The time ``seconds`` since 1970 with three decimals; one that cannot be is moved to the nearest one."""
    moved = min(max(0.0, seconds), _LATEST)
    return datetime.fromtimestamp(moved, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def values_payload(readings: Iterable[tuple[str, Node, Reading]], offset: float, wall: float, ended: str) -> bytes:
    """Values by name. ``offset``: the clock of the computer less that of the stream; ``wall``: now, which no source
    time exceeds. ``ended``: the reason why nobody keeps values up to date from now on; empty: somebody does. A bad
    value is null, as few programs look at its quality."""
    times: dict[float, str] = {}  # many values of a slave have the same one
    found: dict[str, object] = {}
    for name, node, reading in readings:
        value, quality, reason = reading.plain, reading.quality, reading.text
        if ended and quality in (Quality.GOOD, Quality.UNCERTAIN):
            quality, reason = Quality.STALE, ended
        time = None
        if reading.time:
            time = times.get(reading.time)
            if time is None:
                time = times[reading.time] = time_text(min(reading.time + offset, wall))
        found[name] = {
            "value": value.hex(" ") if isinstance(value, bytes) else value,
            "unit": node.unit,
            "quality": quality.value,
            "reason": clean(reason),
            "time": time,
        }
    return json_text(found).encode()


def condition_payload(condition: Condition, offset: float, wall: float) -> bytes:
    """A diagnosis, fault or alarm. ``offset``, ``wall``: as for :func:`values_payload`."""
    return json_text(
        {
            "title": condition.title,
            "text": condition.text,
            "severity": condition.level.value,
            "active": condition.active,
            "acknowledged": condition.acked,
            "since": time_text(min(condition.since + offset, wall)),
            "time": time_text(min(condition.time + offset, wall)),
        }
    ).encode()


def result_payload(order: str, made_at: float | None, result: str, reason: str, wall: float) -> bytes:
    """The result of an order; ``made_at``: the time that its sender gave."""
    return json_text(
        {
            "order": _short(order),
            "order_time": None if made_at is None else time_text(made_at),
            "result": result,
            "reason": _short(reason),
            "time": time_text(wall),
        }
    ).encode()


def _short(text: str) -> str:
    return shortened(printable(text[: _MOST_TEXT + 1]), _MOST_TEXT)


def read_object(octets: bytes, most: int, advice: str = "") -> dict[str, Any]:
    """The JSON object in a payload of a stranger of ``most`` octets at most, with finite numbers and each member once.
    ``advice``: stands behind the reason. Raises ValueError with a reason; ``octets`` may be anything."""
    if len(octets) > most:
        raise ValueError(f"the payload has {len(octets)} octets, at most {most} are taken")
    try:
        given = json.loads(
            octets.decode(),
            object_pairs_hook=_object,
            parse_constant=_constant,
            parse_float=_finite_float,
            parse_int=_whole,
        )
    except UnicodeDecodeError:
        raise ValueError("the payload is not UTF-8") from None
    except json.JSONDecodeError:
        raise ValueError(f"the payload is no JSON{advice}") from None
    except RecursionError:
        raise ValueError("the payload is nested too deeply") from None
    if not isinstance(given, dict):
        raise ValueError(f"the payload is no JSON object{advice}")
    return given


def read_order(octets: bytes) -> tuple[Value, float]:
    """Value, and time of the sender in s since 1970, of an order. Raises ValueError with a reason; ``octets`` may be
    anything."""
    given = read_object(octets, MOST_OCTETS, f": write for instance {_EXAMPLE}")
    for key in given:
        if key not in ("value", "time"):
            raise ValueError(f"unknown member {_key(key)}: an order has value and time")
    value = given.get("value")
    if value is not None and not isinstance(value, (bool, int, float, str)):
        raise ValueError("its value is neither a number, a text, true nor false")
    if given.get("time") is None:
        raise ValueError("it has no time: add the time of now, so that no order is carried out late")
    return value, _time_of(given["time"])


def sent_time(octets: bytes) -> tuple[str, float | None]:
    """The time of an order that may be damaged, as its sender wrote it (empty without one), and in s since 1970 (None
    if it is no time)."""
    try:
        given = read_object(octets, MOST_OCTETS).get("time")
    except ValueError:
        return "", None
    text = given if isinstance(given, str) else "" if given is None else json_text(given)
    try:
        return text, _time_of(given)
    except ValueError:
        return text, None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a member stands twice in the payload")
    return found


def _constant(text: str) -> float:
    raise ValueError(f"{text} is no number")


def _whole(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError("a number of the payload is too great")
    return int(text)


def _finite_float(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError("a number of the payload is too great")
    return number


def _time_of(given: object) -> float:
    if isinstance(given, str):
        try:
            if len(given) > _MOST_TIME:
                raise ValueError
            time = datetime.fromisoformat(given)
        except ValueError:
            raise ValueError("its time is none of ISO 8601, for instance 2026-11-23T13:00:00Z") from None
        if time.tzinfo is None:
            raise ValueError("its time has no time zone: write Z behind one of UTC")
        seconds = time.timestamp()
    elif isinstance(given, (int, float)) and not isinstance(given, bool):
        if given > _SURELY_MS:
            raise ValueError("its time is too great: a number counts seconds since 1970, not milliseconds")
        seconds = float(given) if given >= 0 else -1.0
    else:
        raise ValueError("its time is neither a text nor a number")
    if seconds < 0:
        raise ValueError("its time is before 1970")
    return seconds


def _key(key: str) -> str:
    return f"'{shortened(printable(key[:61]))}'"
