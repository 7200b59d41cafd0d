"""Capture files that commands name, and those in folders; several that are judged as one, in the order of their first
telegrams."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from typing import Final, NamedTuple

from dpstack.capture.pcapng import Reader
from dpstack.cli.listening.source_file import opened
from dpstack.errors import CaptureFileError, UsageError
from dpstack.text import some_of

_PCAPNG: Final = b"\n\r\r\n"
#: files of a folder that cannot be read and are named one by one
_NAMED: Final = 20


class NamedFile(NamedTuple):
    """A file that a command names itself, or as one in the folder ``folder``."""

    name: str
    #: empty if the command names the file
    folder: str


def captures_in(names: list[str], on_remark: Callable[[str], None]) -> list[str]:
    """The capture files in ``names``, of which each is a file or a folder; one file alone may be of any kind.

    Several ones are pcapng and stand in the order of their first telegrams, those that begin at the same time in the
    order of their names. ``on_remark`` gets what is left out of a folder, and files of one time. Raises UsageError.
    """
    if len(names) == 1 and not os.path.isdir(names[0]):
        return names
    begins: dict[str, int | None] = {}
    for name, folder in files_in(names, on_remark):
        if folder and not os.path.lexists(name):
            on_remark(f"{name}: has been removed since: left out")
        else:
            begins[name] = _begin_of(name)
    order = sorted(begins, key=lambda one: (begins[one] is None, begins[one] or 0, one))
    for before, one in pairwise(order):
        if begins[one] is not None and begins[one] == begins[before]:
            on_remark(f"{before} and {one} begin at the same time: they are read in the order of their names")
    if not order:
        raise UsageError(f"{' '.join(names)}: no capture file is left; name files that dpstack capture wrote")
    return order


def files_in(names: Iterable[str], on_remark: Callable[[str], None]) -> Iterator[NamedFile]:
    """The files that ``names`` name, and the pcapng files in the folders among them, each file once.

    ``on_remark`` gets what is left out of a folder. Raises UsageError for a folder without a pcapng file.
    """
    found: set[str] = set()
    for name in names:
        folder = name if os.path.isdir(name) else ""
        for one in _in_folder(folder, on_remark) if folder else (name,):
            place = os.path.realpath(one)
            if place not in found:
                found.add(place)
                yield NamedFile(one, folder)


def _in_folder(folder: str, on_remark: Callable[[str], None]) -> Iterator[str]:
    """The pcapng files in ``folder``, by name. Folders in it are left out without a remark."""
    captures: list[str] = []
    others: list[str] = []
    unread: list[str] = []
    try:
        names = sorted(os.listdir(folder))
    except OSError as error:
        raise UsageError(f"{folder}: cannot be read ({error.strerror}); name a folder of capture files") from None
    for name in names:
        path = os.path.join(folder, name)
        if os.path.isdir(path):
            continue
        try:
            (captures if _begins_as_pcapng(path) else others).append(name)
        except OSError as error:
            unread.append(f"{name} ({error.strerror})")
    if unread:
        on_remark(f"{folder}: left out, cannot be read: {some_of(unread, _NAMED)}")
    if not captures:
        raise UsageError(f"{folder}: no capture file (pcapng) in this folder; name one that dpstack capture wrote to")
    if others:
        on_remark(f"{folder}: left out, no telegrams in pcapng: {some_of(others)}")
    yield from (os.path.join(folder, name) for name in captures)


def is_pcapng(name: str) -> bool:
    """Whether ``name`` is a file that begins as pcapng."""
    try:
        return _begins_as_pcapng(name)
    except (OSError, ValueError):
        return False


def _begins_as_pcapng(name: str) -> bool:
    """Raises OSError if the file cannot be read. A pipe or a device is not opened: that could wait for ever."""
    if not stat.S_ISREG(os.stat(name).st_mode):
        return False
    with open(name, "rb") as file:
        return file.read(4) == _PCAPNG


def _begin_of(name: str) -> int | None:
    """The time of the first telegram; None without one, and for a file that cannot be read: its reader says why."""
    with opened(name) as file:
        if file.read(4) != _PCAPNG:
            raise UsageError(f"{name}: no pcapng file; files of another kind are judged one at a time")
        file.seek(0)
        try:
            return next((packet.t_ns for packet in Reader(file, name) if packet.t_ns is not None), None)
        except (CaptureFileError, OSError):
            return None
