"""The verdicts on a slave of literal items, as the program of a bus makes them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msgspec import convert, to_builtins

from dpstack.plant.items import SlaveValues
from dpstack.plant.judge import judged

KEYS = ("alive", "level", "state_text", "remark")


def verdicts(values: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of the verdicts on a slave with ``values``, as in a snapshot."""
    found = judged(convert(dict(values), SlaveValues))
    return {key: to_builtins(getattr(found, key)) for key in KEYS}
