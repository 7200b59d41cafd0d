"""Namespaces whose public names are loaded at their first use (PEP 562)."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable


def loader(package: str, places: str, hint: Callable[[str], str] = lambda _: "") -> Callable[[str], object]:
    """The ``__getattr__`` of ``package``.

    ``places``: in each line a module below ``package`` and its public names; a module without names is public itself.
    ``hint(name)``: the end of the message about an unknown name.
    """
    where: dict[str, str | None] = {}
    for module, *names in map(str.split, places.strip().splitlines()):
        where |= dict.fromkeys(names, module) if names else {module: None}

    def load(name: str) -> object:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}{hint(name)}")
        module = where[name]
        found: object
        if module is None:
            found = importlib.import_module(f"{package}.{name}")
        else:
            found = getattr(importlib.import_module(f"{package}.{module}"), name)
        setattr(sys.modules[package], name, found)
        return found

    return load
