"""The public names with their signatures, one line each: ``python tests/kits/public_names.py`` writes the snapshot."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
SNAPSHOT: Final = ROOT / "tests" / "snapshots" / "public_names.txt"


def lines() -> Iterator[str]:
    """Each name of each ``__all__``, and the members of each class where it is first named."""
    from tools.make_reference_docs import NAMESPACES  # run as a program, ROOT is not on the path before

    seen: set[int] = set()
    for namespace in NAMESPACES:
        module = importlib.import_module(namespace)
        for name in sorted(module.__all__):
            thing = getattr(module, name)
            called = f"{namespace}.{name}"
            if id(thing) in seen:
                yield f"{called} = {thing.__module__}.{thing.__qualname__}"
                continue
            if isinstance(thing, type) or callable(thing):
                seen.add(id(thing))
            yield from _of(called, thing)


def _of(called: str, thing: object) -> Iterator[str]:
    if isinstance(thing, ModuleType):
        yield f"{called}: module"
    elif isinstance(thing, type) and issubclass(thing, Enum):
        yield f"{called}: {', '.join(f'{member.name} = {member.value!r}' for member in thing)}"
    elif isinstance(thing, type):
        yield f"{called}{_signature(thing)}"
        for name in sorted(_members(thing)):
            yield from _member(f"{called}.{name}", inspect.getattr_static(thing, name, None))
    elif callable(thing):
        yield f"{called}{_signature(thing)}"
    elif called == "dpstack.__version__":
        yield f"{called}: {type(thing).__name__}"
    else:
        yield f"{called}: {type(thing).__name__}"


def _members(kind: type) -> set[str]:
    own = {name for base in kind.__mro__ if base.__module__.startswith("dpstack") for name in vars(base)}
    fields = {field.name for field in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else set()
    fields |= set(getattr(kind, "__struct_fields__", ()))
    return {name for name in own - fields if not name.startswith("_")}


def _member(called: str, member: object) -> Iterator[str]:
    if isinstance(member, property):
        returns = inspect.signature(member.fget).return_annotation if member.fget else ""
        yield f"{called}: {returns}{'' if member.fset is None else ', can be assigned'}"
    elif isinstance(member, (staticmethod, classmethod)):
        yield f"{called}{_signature(member.__func__)}"
    elif callable(member):
        yield f"{called}{_signature(member)}"


def _signature(thing: object) -> str:
    awaited = "async " if inspect.iscoroutinefunction(thing) else ""
    try:
        text = str(inspect.signature(thing))  # type: ignore[arg-type]
    except ValueError:  # of a class of C
        return ""
    text = re.sub(r" at 0x\w+", "", re.sub(r"(: |-> )'([^']*)'", r"\1\2", text))
    return f" {awaited}{text}" if awaited else text


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    SNAPSHOT.write_text("\n".join(lines()) + "\n", encoding="utf-8")
