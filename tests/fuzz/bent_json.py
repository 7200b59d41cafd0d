"""Values of JSON that an input bends: other types, other sizes, keys that are missing, doubled or foreign; and samples
of types."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from enum import Enum
from types import UnionType
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

import msgspec

from tests.fuzz.frame import Cutter

_DEEP: Final[list[Any]] = [[[[[[[[1]]]]]]]]
#: what a bent place gets
VALUES: Final[tuple[Any, ...]] = (
    *(
        None,
        True,
        False,
        0,
        1,
        -1,
        3,
        126,
        255,
        256,
        2**31,
        2**53,
        2**63,
        2**64,
        10**30,
        -(2**63),
        9_999_999_999_999,
        -5,
    ),
    *(0.5, -0.0, 1e308, float("inf"), float("-inf"), float("nan")),
    *("", "x", "3", "8", "\x1b[31m", "\ud800", "\u202e", "\0", "e\u0300", "\u0661", "AQ==", "!", "a" * 300),
    *("data_exchange", "offline", "operate", "2026-01-31T12:00:00Z"),
    *([], {}, [1], ["x"], [None], [[]], [{}], [[1, 2], [3, 4]], [[0, 0]], _DEEP),
    *({"a": 1}, {"": {}}, {"3": 1}, {"3": {}}, {"3": []}, {"text": 1}, {"slaves": {}}, {"slaves": []}, {"max": 1}),
)


def places(value: Any, found: list[tuple[Any, Any]]) -> None:
    """All places in ``value``, a list or a dict: the container and the key."""
    keys = list(value) if isinstance(value, dict) else range(len(value))
    for key in keys:
        found.append((value, key))
        if isinstance(value[key], (dict, list)):
            places(value[key], found)


def copied(value: Any) -> Any:
    """A copy of ``value`` and of everything in it."""
    if isinstance(value, dict):
        return {key: copied(one) for key, one in value.items()}
    return [copied(one) for one in value] if isinstance(value, list) else value


def bent(value: Any, script: Cutter, most: int = 3) -> Any:
    """A copy of ``value`` with as many changes as the input says, at most ``most``."""
    root = [copied(value)]
    for _ in range(script.octet() % (most + 1)):
        found: list[tuple[Any, Any]] = []
        places(root, found)
        if not found:
            break
        container, key = found[script.word() % len(found)]
        how = script.octet()
        match how >> 6:
            case 0 | 1:
                container[key] = copied(VALUES[how % len(VALUES)])
            case 2 if isinstance(container, dict):
                del container[key]
            case 2:
                container.append(copied(container[key]))
            case _:
                other, name = found[script.word() % len(found)]
                taken = copied(other[name])
                if isinstance(container, dict) and how & 1:
                    container[str(VALUES[how % len(VALUES)])[:20]] = taken
                else:
                    container[key] = taken
    return root[0] if root else None


def text_of(value: Any) -> str:
    """``value`` as JSON; a lone surrogate stands as its escape, infinite numbers as Python writes them."""
    return json.dumps(value)


def sample(hint: Any, depth: int = 0) -> Any:
    """A value of a type hint as plain JSON data: the first member of each type."""
    if hint in (int, float):
        return 1
    if hint is str:
        return "x"
    if hint is bytes:
        return "AQI="
    if hint is bool:
        return True
    if hint in (type(None), None, object, Any):
        return None
    if isinstance(hint, type) and issubclass(hint, Enum):
        return next(iter(hint)).value
    if depth > 6:
        return None
    fields = fields_of(hint)
    if fields is not None:
        made = {name: sample(kind, depth + 1) for name, kind in fields.items()}
        return list(made.values()) if hasattr(hint, "_fields") else made
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return sample(arguments[0], depth + 1)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {str(sample(arguments[0])): sample(arguments[1], depth + 1)}
    if origin is tuple and arguments[-1] is not ...:
        return [sample(one, depth + 1) for one in arguments]
    if origin is not None and arguments:
        return [sample(arguments[0], depth + 1)]
    return None


def fields_of(hint: Any) -> dict[str, Any] | None:
    """Names and hints of the fields of a dataclass or of a named tuple."""
    if not isinstance(hint, type):
        return None
    if issubclass(hint, msgspec.Struct):
        hints = get_type_hints(hint)
        return {name: hints[name] for name in hint.__struct_fields__}
    if dataclasses.is_dataclass(hint):
        hints = get_type_hints(hint)
        return {field.name: hints[field.name] for field in dataclasses.fields(hint)}
    return get_type_hints(hint) if hasattr(hint, "_fields") else None
