"""Verdicts on a slave for people, made once: alive, level, words of its state, its most important remark.

They are keys of every slave in a snapshot (docs/reference/live.md); screen, page, metrics and replays show them and do
not judge again. ``alive`` is the bus's own verdict: a reader that gets no snapshots any more adds its own.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from enum import Enum
from typing import Final, Literal

from msgspec import structs

from dpstack.plant.items import ClockValues, DriveValues, QualityValues, Remark, SlaveValues
from dpstack.plant.quality import Quality, Reason
from dpstack.trace import Severity

#: keys of a slave that :func:`judged` looks at
JUDGED: Final = frozenset(
    {
        *("state", "inputs_valid", "quality", "qualities", "doubts", "fault", "conspicuous", "withheld", "drive"),
        *("drives", "injected", "master", "links"),
    }
)


class Level(Enum):
    """How a slave is. The levels of messages, and three more."""

    GOOD = "good"
    #: it is being brought up
    BUSY = "busy"
    #: nobody exchanges data with it, and nothing is known to be wrong
    OFF = "off"
    WARNING = Severity.WARNING.value
    ERROR = Severity.ERROR.value


DATA_EXCHANGE: Final = "data_exchange"
DEACTIVATED: Final = "deactivated"
#: words and level of each state without a remark. ``unknown``: the stream does not show it
STATES: Final[dict[str, tuple[str, Level]]] = {
    "offline": ("offline", Level.OFF),
    "diagnosis": ("diagnosis", Level.BUSY),
    "set_prm": ("parameters", Level.BUSY),
    "chk_cfg": ("configuration", Level.BUSY),
    "wait_ready": ("not ready yet", Level.BUSY),
    DATA_EXCHANGE: ("data exchange", Level.GOOD),
    "fault": ("fault", Level.ERROR),
    DEACTIVATED: ("deactivated", Level.OFF),
    "unknown": ("unknown", Level.OFF),
}
#: level of each state of a drive (:class:`dpstack.profile.State`) that is not on its way to another one
_DRIVE_STATES: Final = {
    "running": Level.GOOD,
    "fault": Level.ERROR,
    "fault_reaction": Level.ERROR,
    "offline": Level.OFF,
    "unknown": Level.OFF,
}
#: qualities as :class:`dpstack.plant.quality.Quality` has them
_GOOD, _UNCERTAIN, _BAD = Quality.GOOD.value, Quality.UNCERTAIN.value, Quality.BAD.value
_ANNOUNCED: Final = Reason.ANNOUNCED.name.lower()
#: doubts in a remark: the first ones say where to look
_MOST_DOUBTS: Final = 3
#: of a slave in data exchange whose inputs are too old
_NOT_VALID: Final = "not valid"
_INFO, _WARNING = Severity.INFO.value, Severity.WARNING.value
_WITHHELD: Final = "it was away: its outputs stay at their safe values until they are set anew"


def exchanging(values: SlaveValues) -> bool:
    """Whether the slave is in data exchange."""
    return values.state == DATA_EXCHANGE


def drive_level(state: str | None) -> str:
    """The verdict on the state of a drive."""
    return _DRIVE_STATES.get(state or "unknown", Level.BUSY).value


def judged(values: SlaveValues) -> SlaveValues:
    """``values`` with the verdicts on them; None is what is not known.

    ``alive``: its inputs are those of this moment. ``level``: see :class:`Level`. ``state_text``: its state in words.
    ``remark``: the most important thing to say about it, or None.
    """
    state = values.state or "unknown"
    words, level = STATES.get(state, (state.replace("_", " "), Level.OFF))  # one that a newer version has
    alive = level is Level.GOOD and values.inputs_valid is True
    if level is Level.GOOD and not alive and values.master is None:  # another master keeps its inputs to itself
        words, level = _NOT_VALID, Level.WARNING
    remark = _remark(values)
    if remark is not None:
        if remark.severity == Severity.ERROR.value or level in (Level.GOOD, Level.WARNING):
            level = Level(remark.severity)
    elif words == _NOT_VALID:
        remark = Remark("the inputs are not valid", Severity.WARNING.value)
    text = words if values.master is None else f"{words} (master {values.master})"
    drive = values.drive
    if drive is not None and drive.level is None:  # of an older version
        drive = structs.replace(drive, level=drive_level(drive.state))
    return structs.replace(values, alive=alive, level=level.value, state_text=text, remark=remark, drive=drive)


def clock_remark(clock: ClockValues) -> Remark:
    """The most important thing to say about the time on the bus."""
    from dpstack.dp.pdu.clock import NOT_KEPT, several_clocks  # here, as most buses have no clock

    sends = clock.interval_s is not None
    masters = [f"master {one.address}" for one in clock.masters or []]
    if sends:
        masters.insert(0, "this master")
    if clock.trouble:
        return Remark(clock.trouble, _WARNING)
    if len(masters) > 1:
        return Remark(several_clocks(masters), _WARNING)
    last = clock.sent if sends else next(iter(clock.masters or ()), None)
    if last is None:
        return Remark(f"{masters[0]} has not sent the time yet" if sends else "nobody sends the time", _INFO)
    how = f" every {clock.interval_s:g} s" if sends else ""
    text = f"{masters[0]} sends the time{how}, resolution {last.resolution_ms} ms"
    if last.synchronised is False:
        return Remark(f"{text}, but {NOT_KEPT}", _WARNING)
    return Remark(f"{text}, synchronised", _INFO)


def _remark(values: SlaveValues) -> Remark | None:
    """The first that applies: errors before warnings, the bus before the drive."""
    fault, drive = values.fault, values.drive or DriveValues()
    if fault is not None:
        return _said(Severity.ERROR, "", [fault.text or fault.kind or "fault"])
    faults = [*(drive.faults or ()), *_of_several(values, "faults")]
    if faults:
        return _said(Severity.ERROR, "drive fault: ", faults)
    about_values = diagnosis_remark(values)
    if about_values is not None:
        return about_values
    lost = [f"no valid data from publisher {one.name}: {one.text}" for one in values.links or () if one.good is False]
    if lost and exchanging(values):
        return _said(Severity.WARNING, "", lost)
    if values.withheld and exchanging(values):
        return _said(Severity.WARNING, "", [_WITHHELD])
    warnings = [*(drive.warnings or ()), *_of_several(values, "warnings")]
    if warnings:
        return _said(Severity.WARNING, "drive warning: ", warnings)
    if values.injected:
        return _said(Severity.WARNING, "simulated fault: ", values.injected)
    return None


def _of_several(values: SlaveValues, kind: Literal["faults", "warnings"]) -> list[str]:
    """The ``kind`` of all drives of a slave with several, each with the name of its drive."""
    drives = (values.drives or {}).items()
    return [f"{name} {text}" for name, drive in drives for text in getattr(drive, kind) or ()]


def diagnosis_remark(values: SlaveValues, *, announced: bool = True) -> Remark | None:
    """The diagnosis of the slave and its values that are bad or uncertain, the bad ones first; None: nothing of it. An
    error while a value is bad. ``announced`` False: without a diagnosis that is announced and not read yet."""
    doubts = [one for one in values.doubts or () if one.quality != _GOOD and (announced or one.reason != _ANNOUNCED)]
    said = {one.text for one in doubts}
    found = [(one.quality, one.text) for one in doubts]
    if exchanging(values):
        qualities = (values.qualities or {}).items()
        found += [(one.quality, f"{name}: {one.text}") for name, one in qualities if _is_news(one, said, announced)]
    if not any(quality == _BAD for quality, _ in found) and not doubts and values.conspicuous:
        return _said(Severity.WARNING, "", [values.conspicuous])
    if not found:
        return None
    found.sort(key=lambda one: one[0] != _BAD)
    severity = Severity.ERROR if found[0][0] == _BAD else Severity.WARNING
    return Remark("; ".join(text for _, text in found[:_MOST_DOUBTS]), severity.value)


def _is_news(quality: QualityValues, said: Collection[str], announced: bool) -> bool:
    """Whether the quality of a single value says more than the doubts have ``said``."""
    is_doubtful = quality.quality in (_BAD, _UNCERTAIN) and (announced or quality.reason != _ANNOUNCED)
    return is_doubtful and quality.text not in said


def _said(severity: Severity, head: str, texts: Sequence[str]) -> Remark:
    return Remark(head + ", ".join(texts), severity.value)
