"""Namespaces whose public names are loaded at their first use (PEP 562)."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable


def namespace(
    package: str, places: str, hint: Callable[[str], str] = lambda _: ""
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of ``package``.

    ``places``: in each line a module below ``package`` (or from ``dpstack.`` on) and its public names; a module without
    names is public itself.
    ``hint(name)``: the end of the message about an unknown name.
    """
    #: public name -> module, and its name there (None: the module itself)
    where: dict[str, tuple[str, str | None]] = {}
    for place, *names in map(str.split, places.strip().splitlines()):
        module = place if place.startswith("dpstack.") else f"{package}.{place}"
        for name in names:
            where[name] = module, name
        if not names:
            where[place.rpartition(".")[2]] = module, None

    def load(name: str) -> object:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}{hint(name)}")
        module, there = where[name]
        found: object = importlib.import_module(module)
        if there is not None:
            found = getattr(found, there)
        setattr(sys.modules[package], name, found)
        return found

    public = sorted(where)
    return load, lambda: public, public
