"""Drives by name, found by the entry point group ``dpstack.drives``; any installed package can add one."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from dpstack.entry_points import EntryPoint, entry_points
from dpstack.errors import ConfigError

if TYPE_CHECKING:
    from dpstack.profile.drive_profile import DriveProfile

GROUP: Final = "dpstack.drives"


#: profiles that hide an installed drive of their name, see :func:`also`
_given: Final[dict[str, DriveProfile]] = {}


@functools.cache
def _points() -> dict[str, EntryPoint]:
    """The entry points by the name of their drive; nothing is imported yet."""
    return {point.name: point for point in sorted(entry_points(GROUP))}


@functools.cache
def _loaded(name: str) -> DriveProfile | str:
    """The drive at the entry point ``name``, or why it cannot be loaded."""
    from dpstack.profile.drive_profile import DriveProfile  # here, as :func:`places` needs no drive

    point = _points()[name]
    try:
        profile = point.load()
    except Exception as error:
        return f"{point.value}: {type(error).__name__}: {error}"
    if not isinstance(profile, DriveProfile):
        return f"{point.value} is {type(profile).__name__}, not a DriveProfile"
    if profile.name != point.name:
        return f"{point.value} calls itself {profile.name}, its entry point {point.name}"
    return profile


def known() -> dict[str, DriveProfile]:
    """All drives by name. A plugin that cannot be loaded is left out; see :func:`broken`."""
    found = {name: _loaded(name) for name in _points()}
    return {name: drive for name, drive in found.items() if not isinstance(drive, str)} | _given


def broken() -> dict[str, str]:
    """Entry points that could not be loaded: name -> why."""
    found = {name: _loaded(name) for name in _points()}
    return {name: why for name, why in found.items() if isinstance(why, str)}


def places() -> dict[str, str]:
    """Where drives are imported from: name -> ``package.module:name``. None is imported for it."""
    return {name: point.value for name, point in _points().items()}


def origins() -> dict[str, str]:
    """The package that brings each drive, with its version: name -> ``dpstack 1.0``. None is imported for it."""
    from importlib import metadata  # here, as it takes 25 ms

    found = sorted(metadata.entry_points(group=GROUP), key=lambda point: (point.name, point.value))
    dists = {point.name: point.dist for point in found}
    return {name: "" if dist is None else f"{dist.name} {dist.version}" for name, dist in dists.items()}


def refresh() -> None:
    """Forget what was found; the next call looks again."""
    _points.cache_clear()
    _loaded.cache_clear()


@contextlib.contextmanager
def also(profile: DriveProfile) -> Iterator[None]:
    """Find ``profile`` by its name inside the block, before an installed drive of that name."""
    before = _given.get(profile.name)
    _given[profile.name] = profile
    try:
        yield
    finally:
        del _given[profile.name]
        if before is not None:
            _given[profile.name] = before


def is_given(name: str) -> bool:
    """Whether :func:`also` gives a drive of this name now."""
    return name in _given


def find(name: str) -> DriveProfile:
    """The plugin called ``name``; :func:`dpstack.devices.finding.find` has the drives of device files, too.

    Raises ConfigError with the nearest names, or with the reason why it cannot load.
    """
    found = _given.get(name) or (_loaded(name) if name in _points() else None)
    if isinstance(found, str):
        raise ConfigError(f"drive {name} cannot be loaded: {found}; repair or uninstall that package")
    if found is not None:
        return found
    import difflib  # here, as most names are right

    drives = known()
    near = difflib.get_close_matches(name.lower(), drives, n=3)
    if near:
        raise ConfigError(f"no drive is called {name!r}; did you mean {' or '.join(near)}?")
    known_here = ", ".join(drives) or "none"
    raise ConfigError(
        f"no drive plugin is called {name!r}; known: {known_here}; dpstack.devices.finding.find has the drives of "
        "device files, too, and so those of dpstack"
    )
