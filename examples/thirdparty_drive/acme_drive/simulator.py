"""The simulated drive: what the demo, tests and people without hardware run against."""

from __future__ import annotations

from collections.abc import Mapping

from acme_drive import table as t
from dpstack.profile import DriveDevice, DriveProfile, Options, ParamSpec, State, TelegramSpec, ramp


class AcmeDevice(DriveDevice):
    """Options: ``load``, and the parameters by name or number."""

    parameter_table = t.PARAMETERS
    trips: Mapping[int, str] = {number: text.split()[0] for number, text in t.FAULTS.items()}
    unknown_trip = f"no fault; known: {', '.join(t.FAULTS.values())}"
    scan_ns = t.SCAN_NS

    def __init__(
        self, profile: DriveProfile, telegram: TelegramSpec, options: Options, presets: Mapping[str, object]
    ) -> None:
        super().__init__(profile, telegram, options, presets)
        self.state = State.NOT_READY
        self.fault = 0
        self.starts = 0

    @property
    def faulted(self) -> bool:
        """Until it is acknowledged."""
        return bool(self.fault)

    def scan(self, words: tuple[int, ...] | None, now: int) -> tuple[int, ...]:
        """Every 10 ms: obey the control word, move the motor, report."""
        control, setpoint = (0, 0) if words is None else words
        remote = self.store.value("source") == 1
        trip = self.take_trip()
        if trip is not None:
            self.state, self.fault = State.FAULT, trip
        self._obey(control if remote else 0)
        motor = self.motor
        motor.switch(self.state is State.RUNNING)
        motor.accel = ramp(self.store.value("acceleration"))
        stop = "quick_stop" if control & t.CONTROL.mask("quick_stop") else "deceleration"
        motor.decel = ramp(self.store.value(stop))
        motor.setpoint = t.SPEED.decode(setpoint) if control & t.CONTROL.mask("run") else 0.0
        names = {State.READY: ("ready",), State.RUNNING: ("ready", "running"), State.FAULT: ("fault",)}
        near = self.state is State.RUNNING and motor.reached(motor.setpoint)
        bits = (*names.get(self.state, ()), *(["remote"] if remote else []), *(["reached"] if near else []))
        current = t.CURRENT.encode(motor.current)
        return t.STATUS.mask(*bits), t.SPEED.encode(motor.frequency), current, self.fault

    def _obey(self, control: int) -> None:
        power, run = control & t.CONTROL.mask("power"), control & t.CONTROL.mask("run")
        match self.state:
            case State.FAULT:
                if control & t.CONTROL.mask("reset"):
                    self.state, self.fault = State.NOT_READY, 0
            case _ if not power:
                self.state = State.NOT_READY
            case State.NOT_READY:
                self.state = State.READY
            case State.READY if run:
                self.state = State.RUNNING
                self.starts += 1
            case State.RUNNING if not run and not self.motor.frequency:
                self.state = State.READY

    def live(self, spec: ParamSpec) -> int | None:
        return self.starts if spec.name == "starts" else None

    def locked(self, spec: ParamSpec) -> bool:
        return spec.number == t.SOURCE and self.state is State.RUNNING
