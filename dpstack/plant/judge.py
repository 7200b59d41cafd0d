"""Verdicts on a slave for people, made once: alive, level, words of its state, its most important remark.

They are keys of every slave in a snapshot (docs/reference/live.md); screen, page, metrics and replays show them and do
not judge again. ``alive`` is the bus's own verdict: a reader that gets no snapshots any more adds its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Final

from msgspec import structs

from dpstack.plant.items import DriveValues, Remark, SlaveValues
from dpstack.plant.quality import Quality
from dpstack.trace import Severity

#: keys of a slave that :func:`judged` looks at
JUDGED: Final = frozenset(
    {"state", "inputs_valid", "quality", "qualities", "doubts", "fault", "conspicuous", "drive", "injected", "master"}
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
#: doubts in a remark: the first ones say where to look
_MOST_DOUBTS: Final = 3
#: of a slave in data exchange whose inputs are too old
_NOT_VALID: Final = "not valid"


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
    if level is Level.GOOD and not alive:
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


def _remark(values: SlaveValues) -> Remark | None:
    """The first that applies: errors before warnings, the bus before the drive."""
    fault, drive = values.fault, values.drive or DriveValues()
    if fault is not None:
        return _said(Severity.ERROR, "", [fault.text or fault.kind or "fault"])
    if drive.faults:
        return _said(Severity.ERROR, "drive fault: ", drive.faults)
    doubts = [one for one in values.doubts or () if one.quality != _GOOD]
    if doubts:
        is_bad = any(one.quality == _BAD for one in doubts)
        return _said(Severity.ERROR if is_bad else Severity.WARNING, "", [one.text for one in doubts[:_MOST_DOUBTS]])
    if values.conspicuous:
        return _said(Severity.WARNING, "", [values.conspicuous])
    own = [(name, one) for name, one in (values.qualities or {}).items() if one.quality in (_BAD, _UNCERTAIN)]
    if own:
        is_bad = any(one.quality == _BAD for _, one in own)
        words = [f"{name}: {one.text}" for name, one in own[:_MOST_DOUBTS]]
        return _said(Severity.ERROR if is_bad else Severity.WARNING, "", words)
    if drive.warnings:
        return _said(Severity.WARNING, "drive warning: ", drive.warnings)
    if values.injected:
        return _said(Severity.WARNING, "simulated fault: ", values.injected)
    return None


def _said(severity: Severity, head: str, texts: Sequence[str]) -> Remark:
    return Remark(head + ", ".join(texts), severity.value)
