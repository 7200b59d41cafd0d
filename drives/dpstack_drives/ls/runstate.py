"""The drive's side of the LS Drive profile (docs/reference/drives/ls-s100.md#ls-drive-profile), and how it comes to
rest (Ad-08).

Readings, as the state diagram is not in the text: a run command stands until stop, emergency or the end of the run
authority; emergency goes before stop, stop before a direction; both directions
at once change nothing; without run authority the drive stops.
"""

from __future__ import annotations

from typing import Final

from dpstack.profile import NEAR, NS_PER_S, Motor, ParamStore
from dpstack_drives.ls import table as t

_STOP: Final = t.LS_CONTROL.mask("stop")
_FORWARD: Final = t.LS_CONTROL.mask("forward")
_REVERSE: Final = t.LS_CONTROL.mask("reverse")
_ACKNOWLEDGE: Final = t.LS_CONTROL.mask("acknowledge")
_EMERGENCY: Final = t.LS_CONTROL.mask("emergency")
#: of Ad-08
_DC_BRAKE, _COAST = 1, 2
#: of OU-31: relay 1 is the signal that opens the brake
_BRAKE_CONTROL: Final = 35
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


class Rest:
    """Ad-08: 0 ramp, 1 ramp and DC brake from Ad-17 for Ad-15, 2 coast. All is the inverter manual's (a reading)."""

    __slots__ = ("_store", "_until")

    def __init__(self, store: ParamStore) -> None:
        self._store = store
        self._until: int | None = None

    def step(self, motor: Motor, now: int, *, wanted: bool) -> bool:
        """``wanted``: a running motor is to stop by Ad-08 -> the power stage stays on for it."""
        how = int(self._store.value("Ad-08"))
        if not wanted or not motor.on or how == _COAST:
            self._until = None
            return False
        if how != _DC_BRAKE:
            return bool(motor.frequency)
        if self._until is None:
            if abs(motor.frequency) * self._store.value("dr-20") > self._store.value("Ad-17"):
                return True
            self._until = now + round(self._store.value("Ad-15") * NS_PER_S)
        if now < self._until:
            motor.brake()
            return True
        self._until = None
        return False


def motor_status(motor: Motor, store: ParamStore, *, direction: int, jog: bool) -> int:
    """The bits of the LS status word (5.3.2) that show the motor.

    Readings: the brake opens from Ad-44 on if OU-31 is 35; jog is the terminals'.
    """
    turning = motor.frequency or direction
    gap = abs(motor.setpoint) - abs(motor.frequency)
    moving = motor.on and not motor.braking and abs(gap) > NEAR
    hertz = abs(motor.frequency) * store.value("dr-20")
    bits = {
        "stopped": not motor.on,
        "forward": motor.on and not motor.braking and turning > 0,
        "reverse": motor.on and not motor.braking and turning < 0,
        "accelerating": moving and gap > 0,
        "decelerating": moving and gap < 0,
        "reached": motor.on and bool(direction) and motor.reached(motor.setpoint),
        "dc_brake": motor.braking,
        "stopping": motor.on and not direction and not jog,
        "jog": jog and motor.on,
        "brake_open": motor.on and store.value("OU-31") == _BRAKE_CONTROL and hertz >= store.value("Ad-44"),
        "forward_command": direction > 0,
        "reverse_command": direction < 0,
    }
    return t.LS_STATUS.mask(*(name for name, on in bits.items() if on))
