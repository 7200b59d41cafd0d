"""Snapshots of the texts, tables and defaults of fdl, phy, dp and dpv1: one line a case in ``tests/snapshots``.

``python tests/kits/texts_snapshot.py`` writes the files anew. :mod:`texts_fdl` (with phy), :mod:`texts_dp`
and :mod:`texts_dpv1` have the cases, :mod:`texts_transcripts` the cases that run a bus.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import json
import pkgutil
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import Enum
from pathlib import Path
from types import FunctionType
from typing import Any

SNAPSHOTS = Path(__file__).parents[1] / "snapshots"
#: a case and its text
Case = tuple[str, str]
Group = Callable[[], Iterable[Case]]


def attempt(call: Callable[..., Any], *values: Any, **named: Any) -> Case:
    """The call as source text, and its result or the class and message of the exception."""
    name = getattr(call, "__qualname__", repr(call))
    arguments = ", ".join([*map(_shown, values), *(f"{key}={_shown(value)}" for key, value in named.items())])
    try:
        text = _shown(call(*values, **named))
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
    return f"{name}({arguments})", text


def _shown(value: object) -> str:
    if isinstance(value, bytes | bytearray):
        return f"<{value.hex(' ')}>" if len(value) < 16 else f"<{len(value)} octets from {value[:4].hex(' ')}>"
    return repr(value)


def interface(package: str) -> Iterator[Case]:
    """Members of enums, defaults of arguments and fields, plain attributes of the public classes and functions.

    All modules of ``package`` are searched. A name of ``__all__`` that its module does not have is a case too.
    """
    found = importlib.import_module(package)
    modules = [package, *(info.name for info in pkgutil.walk_packages(found.__path__, f"{package}."))]
    for module in map(importlib.import_module, modules):
        missing = [name for name in getattr(module, "__all__", ()) if not hasattr(module, name)]
        if missing:
            yield module.__name__, f"__all__ names {missing}"
        for name, made in vars(module).items():
            if getattr(made, "__module__", "") == module.__name__ and not name.startswith("_"):
                yield from _defaults(f"{module.__name__}.{name}", made)


def aliases(package: str) -> Iterator[Case]:
    """The types that the modules of ``package`` give names to: ``OnRead = Callable[...]``."""
    found = importlib.import_module(package)
    for module in (importlib.import_module(info.name) for info in pkgutil.walk_packages(found.__path__, f"{package}.")):
        source = inspect.getsource(module)
        for name in re.findall(
            r"^([A-Z]\w*[a-z]\w*) = (?:Callable|Iterable|Mapping|[A-Z]\w* \|)", source, re.MULTILINE
        ):
            yield f"{module.__name__}.{name}", str(getattr(module, name))


def _defaults(name: str, made: Any) -> Iterator[Case]:
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
                defaults = [
                    f"{one.name} = {one.default!r}"
                    for one in given
                    if one.default is not one.empty and one.name != "wall_ns"
                ]
                defaults = [default for default in defaults if " at 0x" not in default]
                if defaults:
                    yield called, ", ".join(defaults)


def lines_of(groups: Mapping[str, Group]) -> list[str]:
    """One line of JSON for each case: group, case, text."""
    return [json.dumps([name, *case], ensure_ascii=False) for name, group in groups.items() for case in group()]


def snapshot_lines(file: str, name: str) -> list[str]:
    """The lines of the group ``name`` in the snapshot ``file``."""
    lines = (SNAPSHOTS / file).read_text(encoding="utf-8").splitlines()
    return [line for line in lines if json.loads(line)[0] == name]


def main() -> None:
    import texts_dp
    import texts_dpv1
    import texts_fdl

    for module in (texts_dp, texts_dpv1, texts_fdl):
        (SNAPSHOTS / module.FILE).write_text("\n".join([*lines_of(module.GROUPS), ""]), encoding="utf-8")


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))
    main()
