"""The fieldbus toggle bit (docs/reference/drives/demag.md#toggle-bit): the drive alternates ZSW bit 8, the master
copies it.

Readings: 880 = 0 keeps the bit at 0; after it reacted, and 15 s after a fault, the drive begins anew with 1; 881 = 0
leaves no time at all; while it waits for the first copy ZSW 7 is set although no bit of 270 stands for it.
"""

from __future__ import annotations

from typing import Final

from dpstack.profile import NS_PER_MS
from dpstack_drives.demag import table as t

BIT: Final = t.STATUS.mask("toggle")
#: reactions of 880 to a missing answer
OFF, FAULT, SWITCH_OFF, QUICK_STOP = range(4)


class Toggle:
    """The drive's side, one step a scan. ``answered``: copies come, so the drive may be on."""

    __slots__ = ("_asked", "_until", "answered", "bit")

    def __init__(self) -> None:
        self.bit = False
        self.answered = True
        self._asked = False
        self._until: int | None = None  # the answer is limited

    def step(self, control: int, now: int, *, reaction: int, limit_ms: float, locked: bool) -> bool:
        """880, 881 -> True when the answer has not come in time. ``locked``: within 15 s of a fault."""
        if reaction == OFF or locked:
            self._begin(sends=False)
            return False
        if not self._asked:
            self._begin(sends=True)
            return False
        if bool(control & BIT) is self.bit:
            self.answered = True
            self.bit = not self.bit
            self._until = now + round(limit_ms * NS_PER_MS)
            return False
        if self._until is None or now < self._until:
            return False
        self._begin(sends=True)
        return True

    def _begin(self, *, sends: bool) -> None:
        self.bit = self._asked = sends
        self.answered = not sends
        self._until = None
