"""Lost command of the simulated drive (docs/reference/drives/ls-s100.md#swap-and-lost-command): PRT-12 is the reaction,
PRT-13 the time until it, PRT-14 a frequency.

The codes stand in the inverter's manual, so the meanings here are a reading: 0 nothing, 1 coast, 2 ramp, both with the
trip, 3 hold the input, 4 hold the output, 5 the preset frequency. It does not matter how data exchange ended.
"""

from __future__ import annotations

from dpstack.profile import NS_PER_S, Motor, ParamStore


class LostCommand:
    """``forced``: the drive ramps down to its trip. ``instead``: part of the reference that replaces the set point."""

    __slots__ = ("_at", "_store", "forced", "instead")

    def __init__(self, store: ParamStore) -> None:
        self._store = store
        self._at: int | None = None
        self.forced = False
        self.instead: float | None = None

    def begin(self, now: int) -> None:
        if int(self._store.value("PRT-12")):
            self._at = now + round(self._store.value("PRT-13") * NS_PER_S)

    def returned(self) -> None:
        self._at = self.instead = None

    def step(self, motor: Motor, now: int) -> bool:
        """One scan. True when the drive trips now."""
        if self._at is not None and now >= self._at:
            self._at = None
            match int(self._store.value("PRT-12")):  # 3: hold input, go on with the last outputs
                case 1:
                    return True
                case 2:
                    self.forced = motor.on
                    return not self.forced
                case 4:
                    self.instead = motor.frequency
                case 5:
                    self.instead = self._store.value("PRT-14") / self._store.value("dr-20")
        return self.forced and not motor.frequency
