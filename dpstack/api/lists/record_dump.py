"""A device's own list of parameters into a file and against a file: what was read as a whole, of whatever program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dpstack.api.lists.record_list import ListedValues, RecordList
from dpstack.errors import ConfigError


@dataclass(frozen=True, slots=True)
class RecordDifference:
    """A parameter whose values are not what the file says; ``elements`` that are not, from 0 on."""

    saved: ListedValues
    found: ListedValues
    elements: tuple[int, ...]

    @property
    def text(self) -> str:
        """One line for people: of an array those elements that differ."""
        saved, found = self.saved, self.found
        if found.unreadable is None and saved.format != found.format:
            return f"{saved.label}: file {saved.text} as {saved.format}, device {found.text} as {found.format}"
        if found.unreadable is not None or max(len(saved.values), len(found.values)) < 2:
            return f"{saved.label}: file {saved.text}, device {found.text}"
        parts = (f"[{at}] file {_element(saved, at)}, device {_element(found, at)}" for at in self.elements)
        return f"{saved.label}: {'; '.join(parts)}"


@dataclass(frozen=True, slots=True)
class RecordComparison:
    """What a compare found. ``same``: how many are equal; ``skipped``: what was not compared, and why."""

    differences: tuple[RecordDifference, ...]
    same: int
    skipped: tuple[tuple[ListedValues, str], ...]


def list_of(told: Mapping[str, Any]) -> RecordList:
    """The list in what the order ``parameters`` told (:mod:`dpstack.api.control.record_commands`)."""
    return RecordList(
        name=told["slave"],
        address=told["address"],
        ident=told["ident"],
        slot=told["slot"],
        object=told["object"],
        time=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        parameters=tuple(ListedValues.from_dict(one) for one in told["parameters"]),
    )


def compared(
    found: RecordList, saved: RecordList, *, read_only: bool = False, where: str | Path = "the list"
) -> RecordComparison:
    """Where the device is not as ``saved``, element by element.

    What is read only is what the device measures or is, and is compared with ``read_only`` alone. Raises ConfigError
    for a list of another type of device.
    """
    if saved.ident != found.ident:
        raise ConfigError(
            f"{where} holds the parameters of {saved.name}, a device of the type 0x{saved.ident:04X}; slave "
            f"{found.address} ({found.name}) is 0x{found.ident:04X}: take a file of such a device"
        )
    there = {one.number: one for one in found.parameters}
    differences: list[RecordDifference] = []
    skipped: list[tuple[ListedValues, str]] = []
    same = 0
    for one in saved.parameters:
        now = there.pop(one.number, None)
        why = _why_skipped(one, now, read_only)
        if now is None or why is not None:
            skipped.append((one, why or "the device does not have it"))
            continue
        elements = one.differences(now)
        if elements or now.unreadable is not None or one.format != now.format:
            differences.append(RecordDifference(one, now, elements))
        else:
            same += 1
    skipped += [(one, "it is not in the file") for one in there.values()]
    return RecordComparison(tuple(differences), same, tuple(skipped))


def _why_skipped(one: ListedValues, now: ListedValues | None, read_only: bool) -> str | None:
    if one.unreadable is not None:
        return f"it could not be read when the file was made: {one.unreadable}"
    if not read_only and (one.read_only or (now is not None and now.read_only)):
        return "it is read only"
    return None


def _element(one: ListedValues, at: int) -> str:
    return ListedValues(number=one.number, values=one.values[at : at + 1]).text
