"""Drives by name, found by the entry point group ``dpstack.drives``; any installed package can add one."""

from __future__ import annotations

import contextlib
import difflib
import functools
from collections.abc import Iterator
from importlib import metadata
from typing import Final

from dpstack.errors import ConfigError
from dpstack.profile.drive_profile import DriveProfile

GROUP: Final = "dpstack.drives"


@functools.cache
def _scan() -> tuple[dict[str, DriveProfile], dict[str, str], dict[str, str]]:
    drives: dict[str, DriveProfile] = {}
    places: dict[str, str] = {}
    broken: dict[str, str] = {}
    for point in sorted(metadata.entry_points(group=GROUP), key=lambda p: (p.name, p.value)):
        try:
            profile = point.load()
        except Exception as error:
            broken[point.name] = f"{point.value}: {type(error).__name__}: {error}"
            continue
        if not isinstance(profile, DriveProfile):
            broken[point.name] = f"{point.value} is {type(profile).__name__}, not a DriveProfile"
        elif profile.name != point.name:
            broken[point.name] = f"{point.value} calls itself {profile.name}, its entry point {point.name}"
        else:
            drives[profile.name] = profile
            places[profile.name] = point.value
    return drives, broken, places


def known() -> dict[str, DriveProfile]:
    """All drives by name. A plugin that cannot be loaded is left out; see :func:`broken`."""
    return dict(_scan()[0])


def broken() -> dict[str, str]:
    """Entry points that could not be loaded: name -> why."""
    return dict(_scan()[1])


def places() -> dict[str, str]:
    """Where the drives of :func:`known` are imported from: name -> ``package.module:name``."""
    return dict(_scan()[2])


def refresh() -> None:
    """Forget what was found; the next call looks again."""
    _scan.cache_clear()


@contextlib.contextmanager
def also(profile: DriveProfile) -> Iterator[None]:
    """Find ``profile`` by its name inside the block, before an installed drive of that name."""
    drives = _scan()[0]
    before = drives.get(profile.name)
    drives[profile.name] = profile
    try:
        yield
    finally:
        del drives[profile.name]
        if before is not None:
            drives[profile.name] = before


def find(name: str) -> DriveProfile:
    """The drive called ``name``. Raises ConfigError with the nearest names, or with the reason why it cannot load."""
    drives, failed, _places = _scan()
    if name in drives:
        return drives[name]
    if name in failed:
        raise ConfigError(f"drive {name} cannot be loaded: {failed[name]}; repair or uninstall that package")
    near = difflib.get_close_matches(name.lower(), drives, n=3)
    if near:
        raise ConfigError(f"no drive is called {name!r}; did you mean {' or '.join(near)}?")
    raise ConfigError(f"no drive is called {name!r}; known: {', '.join(drives) or 'none (is dpstack installed?)'}")
