"""Capture files that are judged as one: files and folders of them, in the order of their first telegrams."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Final

from dpstack.capture.pcapng import Reader
from dpstack.cli.listening.source_file import opened
from dpstack.errors import CaptureFileError, UsageError
from dpstack.text import some_of

_PCAPNG: Final = b"\n\r\r\n"


def captures_in(names: list[str], on_remark: Callable[[str], None]) -> list[str]:
    """The capture files in ``names``, of which each is a file or a folder; one file alone may be of any kind.

    Several ones are pcapng and stand in the order of their first telegrams, those that begin at the same time in the
    order of their names. ``on_remark`` gets what is left out of a folder, and files of one time. Raises UsageError.
    """
    if len(names) == 1 and not os.path.isdir(names[0]):
        return names
    found: dict[str, str] = {}
    begins: dict[str, int | None] = {}
    for name in names:
        is_folder = os.path.isdir(name)
        for one in _in_folder(name, on_remark) if is_folder else [name]:
            if found.setdefault(os.path.realpath(one), one) != one:
                continue
            if is_folder and not os.path.lexists(one):
                on_remark(f"{one}: has been removed since: left out")
            else:
                begins[one] = _begin_of(one)
    order = sorted(begins, key=lambda one: (begins[one] is None, begins[one] or 0, one))
    for before, one in pairwise(order):
        if begins[one] is not None and begins[one] == begins[before]:
            on_remark(f"{before} and {one} begin at the same time: they are read in the order of their names")
    if not order:
        raise UsageError(f"{' '.join(names)}: no capture file is left; name files that dpstack capture wrote")
    return order


def _in_folder(folder: str, on_remark: Callable[[str], None]) -> Iterator[str]:
    captures: list[str] = []
    others: list[str] = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_file():
                    (captures if is_pcapng(entry.path) else others).append(entry.name)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be read ({error.strerror}); name a folder of capture files") from None
    if not captures:
        raise UsageError(f"{folder}: no capture file (pcapng) in this folder; name one that dpstack capture wrote to")
    if others:
        on_remark(f"{folder}: left out, no telegrams in pcapng: {some_of(sorted(others))}")
    yield from (os.path.join(folder, name) for name in sorted(captures))


def is_pcapng(name: str) -> bool:
    """Whether ``name`` is a file that begins as pcapng."""
    try:
        if not os.path.isfile(name):
            return False
        with open(name, "rb") as file:
            return file.read(4) == _PCAPNG
    except (OSError, ValueError):
        return False


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
