"""Readings of identifier octets: rows of modules of a GSD file that give the configuration that a slave has.

A GSD file often leaves several readings: modules with equal octets, and octets of one module that are those of two
others. Octets that no module gives stay unknown, one identifier at a time.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, TypeAlias

from msgspec import Struct

from dpstack.errors import ConfigError
from dpstack.gsd.identifiers import parse_identifiers
from dpstack.gsd.model import Device, Module, in_ranges

#: the identifier octet of an empty slot
_EMPTY: Final = b"\0"


class Place(Struct, frozen=True):
    """The octets of one slot. ``modules``: those of the file with these octets, in its order; empty for an empty slot
    (octet 0), and for octets of no module.
    """

    slot: int
    octets: bytes
    modules: tuple[Module, ...]

    @property
    def unknown(self) -> bool:
        """Whether no module of the file gives these octets."""
        return not self.modules and self.octets != _EMPTY


class ModuleReading(Struct, frozen=True):
    """One row of places that give the octets in order."""

    places: tuple[Place, ...]

    @property
    def unknown(self) -> int:
        """The number of octets that no module of the file gives."""
        return sum(len(place.octets) for place in self.places if place.unknown)


def read_modules(device: Device, config: bytes, most: int = 16) -> tuple[tuple[ModuleReading, ...], bool]:
    """The readings of ``config`` with the fewest unknown octets, at most ``most``, and whether there are more.

    Longer modules come first. Fixed presets stand in front only, and a module only in slots that allow it.
    """
    rows = _Rows(device, config)
    found: list[ModuleReading] = []
    for row in rows.all():
        if len(found) == most:
            return tuple(found), True
        found.append(ModuleReading(row))
    return tuple(found), False


#: a possible place: its octets, the modules with them, the fewest unknown octets from there to the end
_Step: TypeAlias = tuple[bytes, tuple[Module, ...], int]


class _Rows:
    """All rows of one configuration. A state is (place in the octets, number of slots in front of it)."""

    def __init__(self, device: Device, config: bytes) -> None:
        self._device = device
        self._config = config
        self._by_octets: dict[bytes, tuple[Module, ...]] = {}
        for module in device.modules:
            if module.complete and module.config:
                self._by_octets[module.config] = (*self._by_octets.get(module.config, ()), module)
        self._sizes = sorted({len(octets) for octets in self._by_octets}, reverse=True)
        self._allowed = {slot.number: slot.allowed for slot in device.slots if slot.allowed}
        self._fixed = [module for module in device.modules if device.fix_preset_modules and module.preset]
        self._ends = _identifier_ends(config)
        # behind this many slots each one takes every module: its number decides nothing
        self._last = max([len(self._fixed), *(number - device.first_slot + 1 for number in self._allowed)])
        self._steps: dict[tuple[int, int], list[_Step]] = {}
        for at in range(len(config) - 1, -1, -1):
            for slots in range(min(at, self._last) + 1):
                steps = list(self._steps_from(at, slots))
                best = min(cost for _, _, cost in steps)
                self._steps[at, slots] = [step for step in steps if step[2] == best]

    def _cost(self, at: int, slots: int) -> int:
        return self._steps[at, slots][0][2] if at < len(self._config) else 0

    def _steps_from(self, at: int, slots: int) -> Iterator[_Step]:
        behind = min(slots + 1, self._last)
        empty = self._config[at : at + 1] == _EMPTY
        for size in self._sizes:
            octets = self._config[at : at + size]
            modules = self._by_octets.get(octets, ()) if len(octets) == size else ()
            if self._last:
                modules = tuple(module for module in modules if self._fits(module, slots))
            if modules:
                empty = empty and octets != _EMPTY
                yield octets, modules, self._cost(at + size, behind)
        if empty:
            yield _EMPTY, (), self._cost(at + 1, behind)
        elif self._config[at : at + 1] != _EMPTY:
            end = self._ends.get(at, at + 1)
            yield self._config[at:end], (), end - at + self._cost(end, behind)

    def _fits(self, module: Module, slots: int) -> bool:
        """Whether ``module`` may stand behind so many slots."""
        if slots < len(self._fixed):
            return module is self._fixed[slots]
        if any(module is preset for preset in self._fixed):
            return False
        allowed = self._allowed.get(self._device.first_slot + slots, ())
        return not allowed or (module.reference is not None and in_ranges(module.reference, allowed))

    def all(self) -> Iterator[tuple[Place, ...]]:
        """The rows with the fewest unknown octets. Every beginning leads to one, so the first comes at once."""
        waiting: list[tuple[int, tuple[Place, ...]]] = [(0, ())]
        while waiting:
            at, row = waiting.pop()
            if at == len(self._config):
                yield row
                continue
            number = self._device.first_slot + len(row)
            steps = self._steps[at, min(len(row), self._last)]
            for octets, modules, _ in reversed(steps):
                waiting.append((at + len(octets), (*row, Place(number, octets, modules))))


def _identifier_ends(config: bytes) -> dict[int, int]:
    """The end of each identifier by its place; empty if the octets contradict themselves."""
    try:
        identifiers = parse_identifiers(config)
    except ConfigError:
        return {}
    ends, at = {}, 0
    for identifier in identifiers:
        ends[at] = at + len(identifier.octets)
        at = ends[at]
    return ends
