"""The texts of fdl, phy, dp and dpv1 in full, one line each, kept in ``tests/snapshots`` so that a change is a diff.

``python tests/kits/said_texts.py`` writes the files anew. :mod:`said_fdl`, :mod:`said_dp`
and :mod:`said_dpv1` have the cases.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import json
import pkgutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import Enum
from pathlib import Path
from types import FunctionType
from typing import Any

SNAPSHOTS = Path(__file__).parents[1] / "snapshots"
#: a case and its text
Said = tuple[str, str]
Group = Callable[[], Iterable[Said]]


def refused(call: Callable[..., Any], *values: Any, **named: Any) -> Said:
    """The call as a person writes it, and the class and message of what it raises, or its result."""
    name = getattr(call, "__qualname__", repr(call))
    arguments = ", ".join([*map(_shown, values), *(f"{key}={_shown(value)}" for key, value in named.items())])
    try:
        said = _shown(call(*values, **named))
    except Exception as error:
        said = f"{type(error).__name__}: {error}"
    return f"{name}({arguments})", said


def _shown(value: object) -> str:
    if isinstance(value, bytes | bytearray):
        return f"<{value.hex(' ')}>" if len(value) < 16 else f"<{len(value)} octets from {value[:4].hex(' ')}>"
    return repr(value)


def interface(package: str) -> Iterator[Said]:
    """Members of enums, defaults of arguments and fields, plain attributes of the public classes and functions.

    ``package`` is searched with all that is in it. A name of ``__all__`` that is not there is a line too.
    """
    found = importlib.import_module(package)
    modules = [package, *(info.name for info in pkgutil.walk_packages(found.__path__, f"{package}."))]
    for module in map(importlib.import_module, modules):
        missing = [name for name in getattr(module, "__all__", ()) if not hasattr(module, name)]
        if missing:
            yield module.__name__, f"__all__ names {missing}"
        for name, made in vars(module).items():
            if getattr(made, "__module__", "") == module.__name__ and not name.startswith("_"):
                yield from _without_more(f"{module.__name__}.{name}", made)


def _without_more(name: str, made: Any) -> Iterator[Said]:
    if isinstance(made, type) and issubclass(made, Enum):
        yield name, ", ".join(f"{key} = {member.value!r}" for key, member in made.__members__.items())
        return
    if isinstance(made, type):
        plain = {
            key: value
            for key, value in vars(made).items()
            if isinstance(value, bool | int | str | bytes) and not key.startswith("_")
        }
        if plain:
            yield f"{name}, attributes", ", ".join(f"{key} = {value!r}" for key, value in plain.items())
    functions = {name: made}
    if isinstance(made, type):
        functions |= {
            f"{name}.{key}": getattr(value, "__func__", value)
            for key, value in vars(made).items()
            if not key.startswith("_") and callable(getattr(value, "__func__", value))
        }
    for called, function in functions.items():
        if isinstance(function, type | FunctionType):
            with contextlib.suppress(ValueError):  # a class without a signature of its own
                given = inspect.signature(function).parameters.values()
                defaults = [f"{one.name} = {one.default!r}" for one in given if one.default is not one.empty]
                defaults = [default for default in defaults if " at 0x" not in default]
                if defaults:
                    yield called, ", ".join(defaults)


def lines_of(groups: Mapping[str, Group]) -> list[str]:
    """One line of JSON for each case: group, case, text."""
    return [json.dumps([name, *said], ensure_ascii=False) for name, group in groups.items() for said in group()]


def kept(file: str, name: str) -> list[str]:
    """The lines of the group ``name`` in the snapshot."""
    lines = (SNAPSHOTS / file).read_text(encoding="utf-8").splitlines()
    return [line for line in lines if json.loads(line)[0] == name]


def main() -> None:
    import said_dp
    import said_dpv1
    import said_fdl

    for module in (said_dp, said_dpv1, said_fdl):
        (SNAPSHOTS / module.FILE).write_text("\n".join([*lines_of(module.GROUPS), ""]), encoding="utf-8")


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))
    main()
