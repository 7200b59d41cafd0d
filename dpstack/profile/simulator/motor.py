"""The simulated motor: first order, per unit of the rated values, on a fixed grid of 1 ms of the bus's clock.

An inverter puts frequency f on the stator; the torque is (f - w) / slip, J dw/dt = torque - load(w). The ramp moves f
towards the set point; the current limit holds it back. Per step the speed is integrated exactly (exponential), and
because the grid is fixed, results do not depend on how often it is called.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from dpstack.units import NS_PER_MS

STEP_NS: Final = NS_PER_MS
_STEP_S: Final = 0.001
_REST: Final = 1e-9
#: a ramp that takes no time, per unit per second
AT_ONCE: Final = 1e6
#: a reference is reached within this part of the rated frequency (a reading: the manuals give no figure)
NEAR: Final = 0.005
#: below this speed the load torque goes to 0: friction holds the shaft, it does not turn it
_CREEP: Final = 0.02


def ramp(seconds: float, span: float = 1.0) -> float:
    """The rate of a ramp that takes ``seconds`` for ``span`` (per unit), per second; 0 s: :data:`AT_ONCE`."""
    return span / seconds if seconds else AT_ONCE


@dataclass(slots=True, kw_only=True, eq=False)
class Motor:
    """Speed ``speed`` and stator frequency ``frequency`` in per unit of the rated frequency, ``torque`` of the rated.

    ``inertia``: seconds from standstill to rated speed at rated torque. ``slip`` at rated torque. ``braking``: the DC
    brake is on.
    """

    inertia: float = 0.1
    #: slip at rated torque, as a part of the rated frequency
    slip: float = 0.04
    #: torque limit, as a part of the rated torque
    limit: float = 1.5
    #: current at no load, as a part of the rated one
    magnetising: float = 0.4
    #: torque against the motion at any speed, as a part of the rated torque
    load: float = 0.2
    #: ramp up in per unit of the rated frequency per second
    accel: float = 1.0
    #: ramp down in per unit of the rated frequency per second
    decel: float = 1.0
    #: the inverter feeds the motor
    on: bool = field(default=False, init=False)
    braking: bool = field(default=False, init=False)
    #: set point of the frequency, per unit of the rated one
    setpoint: float = 0.0
    #: speed, per unit of the rated frequency
    speed: float = 0.0
    #: stator frequency, per unit of the rated one
    frequency: float = 0.0
    #: torque, per unit of the rated one
    torque: float = 0.0
    #: the torque limit holds the frequency back
    limited: bool = field(default=False, init=False)
    _decay: float = field(init=False)
    _at: int | None = field(default=None, init=False)
    _settled: tuple[float, ...] | None = field(default=None, init=False)  # a step from here changes nothing

    def __post_init__(self) -> None:
        self._decay = math.exp(-_STEP_S / (self.slip * self.inertia))

    @property
    def current(self) -> float:
        """Absolute current of the rated one."""
        return math.hypot(self.torque, self.magnetising) if self.on else 0.0

    @property
    def motoring(self) -> float:
        """Torque of the rated one in the direction of the motion: positive as a motor, negative as a generator."""
        if not self.on:
            return 0.0
        return math.copysign(1.0, self.speed or self.frequency) * self.torque

    def reached(self, reference: float) -> bool:
        """Whether the frequency is at ``reference`` (:data:`NEAR`) and the limit does not hold it back."""
        return not self.limited and abs(self.frequency - reference) <= NEAR

    def switch(self, on: bool) -> None:
        """Power stage on or off (coasting). Switched on, the frequency starts at 0 or, by the limit, near the speed."""
        if on != self.on or self.braking:
            self.on = on
            self.braking = False
            self._settled = None
            self.frequency = 0.0
            self.torque = 0.0
            self.limited = False

    def brake(self) -> None:
        """DC brake: a standing field holds the shaft back until :meth:`switch`, with ``limit`` at most."""
        if not self.braking:
            self.switch(True)
            self.braking = True
            self._settled = None
            self.frequency = 0.0

    def advance(self, now: int) -> None:
        """Integrate up to ``now`` in whole steps."""
        at = self._at
        if at is None:
            self._at = now
            return
        steps = (now - at) // STEP_NS
        if steps <= 0:
            return
        self._at = at + steps * STEP_NS
        if not self.on and not self.speed:  # at rest
            return
        if self._settled == (self.setpoint, self.frequency, self.speed, self.torque, self.load, self.limit, self.slip):
            return
        self._settled = None
        step = self._braked if self.braking else self._driven if self.on else self._coasting
        while steps:
            steps -= 1
            if step():
                return

    def _driven(self) -> bool:
        """A step under power. Returns True at rest: further steps would change nothing."""
        frequency, speed = self.frequency, self.speed
        wanted = self._ramped(frequency)
        reach = self.slip * self.limit
        held = min(max(wanted, speed - reach), speed + reach)
        self.limited = held != wanted
        self.frequency = held
        rest = held - self.slip * self._load(speed)
        slower = rest + (speed - rest) * self._decay
        torque = (held - slower) / self.slip
        if held != self.setpoint or held != frequency:
            self.speed, self.torque = slower, torque
            return False
        if slower == speed and torque == self.torque:  # the same to the last bit, so every further step gives it again
            self._settled = (held, held, speed, torque, self.load, self.limit, self.slip)
            return True
        self.speed, self.torque = slower, torque
        return abs(rest - slower) < _REST

    def _ramped(self, frequency: float) -> float:
        wanted = self.setpoint
        up = (wanted - frequency) * (frequency or wanted) > 0
        most = (self.accel if up else self.decel) * _STEP_S
        ahead = frequency + min(max(wanted - frequency, -most), most)
        # one step never carries the ramp through zero: the other ramp takes over there
        return 0.0 if ahead * frequency < 0 else ahead

    def _braked(self) -> bool:
        """A step of the DC brake. Returns True at rest."""
        speed = self.speed
        self.limited = abs(speed) > self.slip * self.limit
        if self.limited:
            slower = speed - (math.copysign(self.limit, speed) + self._load(speed)) / self.inertia * _STEP_S
            self.speed = 0.0 if slower * speed < 0 else slower
        else:
            rest = -self.slip * self._load(speed)
            slower = rest + (speed - rest) * self._decay
            self.speed = 0.0 if abs(slower) < 1e-4 or slower * speed < 0 else slower
        self.torque = min(max(-self.speed / self.slip, -self.limit), self.limit)
        return not self.speed

    def _coasting(self) -> bool:
        speed = self.speed
        # a little friction brings the shaft to rest even without a load
        slower = speed - (self._load(speed) + 0.02 * speed) / self.inertia * _STEP_S
        self.speed = 0.0 if abs(slower) < 1e-4 or slower * speed < 0 else slower
        return not self.speed

    def _load(self, speed: float) -> float:
        return self.load * min(max(speed / _CREEP, -1.0), 1.0)
