"""Parameters that the manual of a drive knows by codes: number and index follow from the code."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from dpstack.profile import ParamSpec


def placed(place: Callable[[str], tuple[int, int] | None], *specs: ParamSpec) -> Iterator[ParamSpec]:
    """``specs``, those that are declared with the number 0 at the number and index that ``place`` gives their names."""
    for spec in specs:
        found = None if spec.number else place(spec.name)
        yield spec if found is None else replace(spec, number=found[0], index=found[1])
