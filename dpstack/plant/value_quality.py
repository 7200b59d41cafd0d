"""The quality of the values of a slave: the reason why none of them is good, and the worse ones of single values.

Made once for every reader: the keys ``quality``, ``qualities`` of a slave in a snapshot. A reader that gets no
snapshots any more adds its own reason (:mod:`dpstack.plant.tree`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from msgspec import Struct

from dpstack.plant.items import QualityValues, SlaveValues
from dpstack.plant.judge import exchanging
from dpstack.plant.quality import Quality, Reason, clean


class Judged(Struct, frozen=True):
    """A reason, further facts about it in words, the time in s after the start since which it holds, what to do."""

    reason: Reason
    note: str = ""
    since: float | None = None
    remedy: str = ""

    @property
    def quality(self) -> Quality:
        return self.reason.quality

    @property
    def rank(self) -> int:
        """Higher: worse."""
        return self.reason.quality.rank

    @property
    def values(self) -> QualityValues:
        """As the live stream has it."""
        text = self.reason.with_note(self.note)
        return QualityValues(self.quality.value, self.reason.name.lower(), text, self.since, self.remedy)


GOOD: Final = Judged(Reason.GOOD)


def worse(one: Judged, other: Judged) -> Judged:
    """The worse of two; of equal ones the first that has something to say."""
    return other if other.rank > one.rank or one is GOOD else one


def trouble_of(values: SlaveValues, limit_ms: float, *, has_ages: bool = True) -> tuple[Reason, str] | None:
    """The reason why the process data of a slave are old, by its state and the age of its inputs; None: they are those
    of this moment. ``has_ages`` False: a recording of named values has none."""
    if not exchanging(values):
        return Reason.NOT_EXCHANGING, clean(values.state if values.fault is None else values.fault.text)
    age = values.inputs_age_ms
    if values.inputs_valid is not True or (age is None and has_ages):
        return Reason.NOT_VALID, ""
    return None if age is None or age <= limit_ms else (Reason.TOO_OLD, f"limit {limit_ms:.0f} ms")


def qualities_of(values: SlaveValues) -> dict[str, QualityValues]:
    """The qualities of named values that are not good, by name."""
    of_all = {} if values.quality is None else dict.fromkeys(values.fields or (), values.quality)
    return {**of_all, **(values.qualities or {})}


def read_back(values: QualityValues | None) -> Judged | None:
    """The reason in a snapshot; of a newer version one with the same quality. None: good."""
    if values is None:
        return None
    text = clean(values.text)
    reason = Reason.__members__.get(values.reason.upper())
    if reason is None or reason.quality.value != values.quality:
        reason = _OF_NEWER.get(values.quality, Reason.STATUS_UNCERTAIN)
    # the words are whole, with those of the reason
    note = text if reason.is_by_slave else text.removeprefix(reason.text).removeprefix(": ")
    return Judged(reason, note, values.since, clean(values.remedy))


_OF_NEWER: Final[Mapping[str, Reason]] = {
    Quality.BAD.value: Reason.STATUS_BAD,
    Quality.STALE.value: Reason.NOT_VALID,
    Quality.UNCERTAIN.value: Reason.STATUS_UNCERTAIN,
}
