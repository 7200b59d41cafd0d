"""Entry points of the installed packages, without importlib.metadata, which takes 25 ms of the processor to load."""

from __future__ import annotations

import os
import re
import sys
from importlib.machinery import PathFinder
from pkgutil import resolve_name
from typing import Final, NamedTuple

_INFO: Final = (".dist-info", ".egg-info")
_TEXT: Final = "entry_points.txt"


class EntryPoint(NamedTuple):
    """A name that a package has registered in a group, and the place of its object, ``module:name``."""

    name: str
    value: str

    def load(self) -> object:
        """The object; its module is imported."""
        return resolve_name(self.value.partition("[")[0].strip())


def entry_points(group: str) -> list[EntryPoint]:
    """As :func:`importlib.metadata.entry_points`: of packages of one name the first one on ``sys.path`` counts."""
    texts: dict[str, str] = {}
    for folder in sys.path:
        try:
            with os.scandir(folder or ".") as entries:
                infos: list[str] | None = [entry.name for entry in entries if entry.name.lower().endswith(_INFO)]
        except FileNotFoundError:
            continue
        except OSError:  # a ZIP archive
            infos = None
        if infos is None or folder.lower().endswith(".egg"):
            return _by_metadata(group)
        for info in infos:
            package = re.sub(r"[-_.]+", "-", info.rpartition(".")[0].partition("-")[0]).lower()
            if package not in texts:
                texts[package] = _read(os.path.join(folder, info, _TEXT))
    if any(hasattr(finder, "find_distributions") for finder in sys.meta_path if finder is not PathFinder):
        return _by_metadata(group)
    return [point for text in texts.values() for point in _points_in(text, group)]


def _by_metadata(group: str) -> list[EntryPoint]:
    from importlib import metadata  # packages that are no plain folders

    return [EntryPoint(point.name, point.value) for point in metadata.entry_points(group=group)]


def _read(path: str) -> str:
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            return file.read()
    except OSError:
        return ""


def _points_in(text: str, group: str) -> list[EntryPoint]:
    found, inside = [], False
    for line in map(str.strip, text.splitlines()):
        if line.startswith("[") and line.endswith("]"):
            inside = line.strip("[]") == group
        elif inside and "=" in line and not line.startswith("#"):
            name, _, value = line.partition("=")
            found.append(EntryPoint(name.strip(), value.strip()))
    return found
