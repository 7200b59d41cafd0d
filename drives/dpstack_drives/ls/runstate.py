"""The drive's side of the LS Drive profile (5.3, row L4).

Readings, as the state diagram is not in the text: a run command stands until stop, emergency or the end of the run
authority; emergency goes before stop, stop before a direction; both directions
at once change nothing; without run authority the drive stops.
"""

from __future__ import annotations

from typing import Final

from dpstack_drives.ls import table as t

_STOP: Final = t.LS_CONTROL.mask("stop")
_FORWARD: Final = t.LS_CONTROL.mask("forward")
_REVERSE: Final = t.LS_CONTROL.mask("reverse")
_ACKNOWLEDGE: Final = t.LS_CONTROL.mask("acknowledge")
_EMERGENCY: Final = t.LS_CONTROL.mask("emergency")
_RUN_AUTHORITY: Final = t.LS_CONTROL.mask("run_authority")


class LsMachine:
    """``direction``: 1 forward, -1 reverse, 0 no run command. ``coast``: the power stage is to be off at once."""

    __slots__ = ("_acknowledge", "coast", "direction", "fault")

    def __init__(self) -> None:
        self.direction = 0
        self.coast = False
        self.fault = False
        self._acknowledge = False

    def step(self, control: int) -> None:
        """Obey the control word."""
        rising = bool(control & _ACKNOWLEDGE) and not self._acknowledge
        self._acknowledge = bool(control & _ACKNOWLEDGE)
        if self.fault:
            self.direction = 0
            self.coast = True
            if rising:
                self.fault = False
            return
        self.coast = bool(control & _EMERGENCY)
        if self.coast or control & _STOP or not control & _RUN_AUTHORITY:
            self.direction = 0
        elif control & (_FORWARD | _REVERSE) == _FORWARD:
            self.direction = 1
        elif control & (_FORWARD | _REVERSE) == _REVERSE:
            self.direction = -1
