"""Status of a drive, decoded from its inputs; plain JSON data of it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import StrEnum

from dpstack.profile.model.states import State


class SettingsState(StrEnum):
    """State of the comparison of the drive's settings; the values are those of the JSON lines."""

    NONE = "none"  # the plugin relies on no setting, or the drive is offline
    CHECKING = "checking"
    CHECKED = "checked"  # all are as the plugin requires
    DIFFERENT = "different"
    NOT_CHECKED = "not_checked"  # at least one could not be read, the others are as required


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveStatus:
    """State and values of a drive, from its last inputs and the master's own last command.

    Values that the telegram does not carry are None. ``reached``: as the drive says; if it has no bit for it, running
    within 1 % of the reference around the set point. ``bits``: names of the status bits set. ``speed`` and
    ``frequency_hz`` are None while the drive has another scale.
    """

    #: state of the drive; OFFLINE outside data exchange
    state: State
    #: the drive is in RUNNING
    running: bool
    reached: bool
    #: the drive follows the bus; None if no bit says it
    remote: bool | None
    #: set point as a part of the reference (1.0 = 100 %)
    setpoint: float
    #: actual speed as a part of the reference (1.0 = 100 %); None if the telegram does not carry it, or the drive
    #: has another scale
    speed: float | None
    #: ``speed`` in Hz, by the drive's reference; None as ``speed``
    frequency_hz: float | None
    #: ``speed`` in rpm, by the drive's reference; None as ``speed``, and if nobody knows that reference
    speed_rpm: float | None = None
    #: actual current as a part of the rated current; None if the telegram does not carry it
    current: float | None = None
    #: actual torque as a part of the rated torque; None if the telegram does not carry it
    torque: float | None = None
    #: names of the warnings that stand
    warnings: tuple[str, ...] = ()
    #: names of the faults that stand
    faults: tuple[str, ...] = ()
    #: the process data as received, 16 bits each
    words: tuple[int, ...] = ()
    bits: tuple[str, ...] = ()
    #: frequency in Hz that 100 % means; None while nobody knows it
    reference_hz: float | None = None
    #: speed in rpm that 100 % means; None while nobody knows it
    reference_rpm: float | None = None
    #: result of the comparison of the drive's settings with those that its plugin relies on
    settings: SettingsState = SettingsState.NONE
    #: settings that differ, were not checked, or were written and do not yet act, one line each
    settings_texts: tuple[str, ...] = ()

    @property
    def fault(self) -> str | None:
        """The fault by name, or None."""
        return ", ".join(self.faults) or None

    @property
    def warning(self) -> str | None:
        """The warnings by name, or None."""
        return ", ".join(self.warnings) or None

    def unknown(self) -> DriveStatus:
        """The same drive offline: set point and settings stay, all values from inputs are removed."""
        return DriveStatus(
            state=State.OFFLINE,
            running=False,
            reached=False,
            remote=self.remote,
            setpoint=self.setpoint,
            speed=None,
            frequency_hz=None,
            reference_hz=self.reference_hz,
            reference_rpm=self.reference_rpm,
            settings=self.settings,
            settings_texts=self.settings_texts,
        )

    def as_dict(self) -> dict[str, object]:
        """Plain JSON data; words as four hex digits. The references are left out: they do not change as values do."""
        names = (field.name for field in dataclasses.fields(self) if not field.name.startswith("reference_"))
        found = {name: getattr(self, name) for name in names}
        lists = {name: list(value) for name, value in found.items() if isinstance(value, tuple)}
        words = [f"{word:04X}" for word in self.words]
        return found | lists | {"words": words, "state": str(self.state), "settings": str(self.settings)}
