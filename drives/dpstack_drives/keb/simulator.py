"""The simulated KEB COMBIVERT F5 behind its PROFIBUS operator: parameters, control and status word, a motor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from dpstack.devices.drive_device import DeclaredDevice
from dpstack.devices.model import DeviceFile
from dpstack.profile import NS_PER_S, ConfigError, DriveDevice, DriveProfile, Leave, Options, TelegramSpec, ramp
from dpstack_drives.keb import table as t
from dpstack_drives.keb import telegrams
from dpstack_drives.keb.channel import KebServer
from dpstack_drives.keb.operator import Operator
from dpstack_drives.keb.parameters import Parameters
from dpstack_drives.keb.watchdog import Life, Watchdog

#: the quick stop ramp in parts of the reference per second (made up)
_QUICK: Final = 5.0
#: reference of oP.10 and of the ramps in Hz (made up)
_RATED_HZ: Final = 50.0
_TRIPS_AT_ONCE, _STOPS_FIRST = 0, 1


class KebDevice(DeclaredDevice):
    """Inverter and operator.

    Options: what the bits mean (``control_bits``, ``status_bits``), ``rpm_per_count`` and ``reference_rpm``,
    ``block2_inputs`` and ``block2_outputs`` (record and enable), ``com_cycle_us``, ``map_acts``, ``load``; parameters
    by name.

    Readings: sy.50 is obeyed while oP.01 is 9, sy.52 counts while oP.00 is 5 (the recipe's values);
    without enable (by the bit, or by the terminal: ``release``) the motor coasts; a reset works with the edge of its
    bit; Pn.05 = 0 trips E.buS, 1 after a quick stop, all others only switch a digital output (6 is the manual's). Clear
    writes zeros; after the end of data exchange the last outputs stand until the watchdog acts.
    """

    data_sets = t.SETS
    trips: Mapping[int, str] = {number: name for name, number in t.TRIPS.items()}
    unknown_trip = (
        "no trip of the simulated F5; known (made up): "
        f"{', '.join(f'{name} ({number})' for name, number in t.TRIPS.items())}"
    )

    def __init__(
        self,
        file: DeviceFile,
        profile: DriveProfile,
        telegram: TelegramSpec,
        options: Options,
        presets: Mapping[str, object],
    ) -> None:
        super().__init__(file, profile, telegram, options, presets)
        self.parameter_errors = {code.number: f"{code} {text}" for code, text in t.ERRORS.items()}
        self.parameters = Parameters(self.store, self._live, self.refusal)
        try:
            self._control = t.bits(str(options["control_bits"]), t.CONTROL_BITS, f"{self.title}: control_bits")
            self._status = t.bits(str(options["status_bits"]), t.STATUS_BITS, f"{self.title}: status_bits")
            into, out = (t.record_and_enable(str(options[f"block2_{way}"])) for way in ("inputs", "outputs"))
        except ValueError as error:
            raise ConfigError(str(error)) from None
        if into is None or out is None:
            raise ConfigError(f"{self.title}: block2_inputs and block2_outputs must name record and enable")
        self._rpm_per_count = float(options["rpm_per_count"])
        self._reference_rpm = float(options["reference_rpm"])
        at_once = options["map_acts"] == t.WITH_ENABLE
        self.operator = Operator(self.parameters, (into, out), float(options["com_cycle_us"]), at_once=at_once)
        self.server = KebServer(self._request)
        self.channel = self.server
        self.watchdog = Watchdog()
        #: ru.00 of the trip, 0 without one
        self.fault = 0
        #: switched by Pn.05 = 6
        self.digital_output = False
        self._link_seen = 0
        self._link_reported = False
        self._own = telegram
        self._exchanged = False  # since the last scan
        self._clear = False
        self._seen = (0, 0)  # output telegrams and requests up to the last scan
        self._reset = False
        self._stopping_for: int | None = None  # a trip that waits for the quick stop
        self._setpoint = 0.0

    # -- conditions -----------------------------------------------------------------------------------------------

    def link(self, on: bool) -> None:
        """HSP5, between operator and inverter."""
        self.parameters.linked = on

    @property
    def injected(self) -> tuple[str, ...]:
        return super().injected + (() if self.parameters.linked else ("link off",))

    @property
    def faulted(self) -> bool:
        return bool(self.fault)

    def reset_fault(self) -> None:
        self.fault = 0
        self.digital_output = False

    def warn(self, mask: int) -> None:
        """Raises ValueError: the F5 has no warnings on the bus."""
        raise ValueError("the F5 shows no warning on the bus, only at a digital output (Pn.05 = 6)")

    def inherit(self, before: DriveDevice) -> None:
        """Parameters and enabled maps; Fb23 = 0 restores the default maps."""
        super().inherit(before)
        if isinstance(before, KebDevice):
            self.operator.inherit(before.operator, default=not self.store.value("Fb.23"))

    def check_cfg(self, config: bytes) -> str | None:
        """Accept the configurations of the printed GSD, and the telegram of this drive."""
        spec = telegrams.of_config(config)
        if spec is None:
            return super().check_cfg(config)
        if spec.made_up and config != self._own.config:
            return f"configuration {config.hex(' ')} is more than the printed GSD allows"
        return None

    def enter(self, config: bytes, now: int) -> None:
        """Data exchange begins; the watchdog has to see that none came up to now."""
        self.advance(now)
        self._exchanged = True
        self._clear = False
        super().enter(config, now)

    def clear(self, now: int) -> None:
        super().clear(now)
        self._clear = True

    def exchange(self, outputs: bytes, now: int) -> bytes:
        inputs = super().exchange(outputs, now)
        self._exchanged = True
        self._clear = False
        return inputs

    def master_lost(self, reason: Leave, now: int) -> None:
        """The drive goes on until the watchdog of the operator expires."""
        self._clear = False

    # -- the internal scan ----------------------------------------------------------------------------------------

    def refresh(self, process: bytes | None, now: int) -> bytes:
        """Outputs to the inverter, watchdog, motor, inputs from it."""
        if process is None and self._clear:
            process = bytes(self.telegram.outputs)
        if self.parameters.linked and process is not None:
            self.operator.write_outputs(process, now)
        self._supervise(now)
        if (trip := self.take_trip()) is not None:
            self.fault = trip
        self._drive()
        if not self.parameters.linked:
            return self.operator.last_inputs(self.telegram.inputs)
        return self.operator.read_inputs(self.telegram.inputs, now)

    def _supervise(self, now: int) -> None:
        telegrams_sent, requests = self.operator.output_telegrams, self.server.requests
        life = Life(0)
        life |= Life.OUTPUTS if telegrams_sent != self._seen[0] else life
        life |= Life.REQUEST if requests != self._seen[1] else life
        life |= Life.EXCHANGE if self._exchanged else life
        self._exchanged = False
        self._seen = (telegrams_sent, requests)
        if self.watchdog.step(
            life,
            now,
            activation=int(self.store.value("Fb.39")),
            inhibit=int(self.store.value("Fb.40")),
            time_ns=self._seconds("Pn.06"),
        ):
            self._react()
        limit = self._seconds("sy.09")
        if self.parameters.linked:
            self._link_seen, self._link_reported = now, False
        elif limit and not self._link_reported and now - self._link_seen >= limit:
            self._link_reported = True
            self._react()

    def _react(self) -> None:
        """The reaction of Pn.05."""
        how = int(self.store.value("Pn.05"))
        if how == _TRIPS_AT_ONCE:
            self.fault = self.fault or t.E_BUS
        elif how == _STOPS_FIRST:
            self._stopping_for = t.E_BUS
        else:
            self.digital_output = True

    def _drive(self) -> None:
        motor = self.motor
        control = self.parameters.raw(t.CONTROL_WORD) if self.store.value("oP.01") == 9 else 0
        reset = self._is_set(control, "reset")
        if reset and not self._reset and self.fault:
            self.reset_fault()
        self._reset = reset
        if self._stopping_for is not None and not motor.frequency:
            self.fault, self._stopping_for = self._stopping_for, None
        enabled = self.released and (self._is_set(control, "enable") or "enable" not in self._control)
        run = enabled and self._is_set(control, "run") and not self.fault
        quick = self._is_set(control, "quick_stop") or self._stopping_for is not None
        counts = self.parameters.raw(t.SET_SPEED) if self.store.value("oP.00") == 5 else 0
        wanted = abs(counts) * self._rpm_per_count / self._reference_rpm
        wanted = min(wanted, self.store.value("oP.10") / _RATED_HZ)
        self._setpoint = -wanted if self._is_set(control, "reverse") else wanted
        motor.setpoint = self._setpoint if run and not quick else 0.0
        if self.fault or not enabled:
            motor.switch(False)
        elif run and not quick:
            motor.switch(True)
        elif not motor.frequency:
            motor.switch(False)  # at the end of the ramp
        motor.accel = self._rate("oP.28")
        motor.decel = _QUICK if quick else self._rate("oP.30")

    def _is_set(self, control: int, name: str) -> bool:
        bit = self._control.get(name)
        return bit is not None and bool(control >> bit & 1)

    def _rate(self, name: str) -> float:
        return ramp(self.store.value(name))

    def _seconds(self, name: str) -> int:
        return round(self.store.value(name) * NS_PER_S)

    # -- parameters -----------------------------------------------------------------------------------------------

    def _request(self, index: int, subindex: int, raw: int | None, octets: int) -> tuple[int, int]:
        """The operator's own first, then the inverter's."""
        found = self.operator.access(index, subindex, raw)
        if found is None:
            return self.parameters.request(index, subindex, raw, octets)
        return found, 1 if not subindex or subindex == 1 else 2

    def _status_word(self) -> int:
        motor = self.motor
        bits = {
            "ready": not self.fault and self.released,
            "fault": bool(self.fault),
            "run": motor.on,
            "reverse": motor.frequency < 0,
            "reached": motor.on and motor.reached(self._setpoint),
        }
        return sum(1 << bit for name, bit in self._status.items() if bits.get(name))

    def _state(self) -> int:
        if self.fault or not self.motor.on:
            return self.fault or t.RU_OFF
        if not self.motor.frequency:
            return t.RU_STANDING
        return t.RU_CONSTANT if self.motor.frequency == self.motor.setpoint else t.RU_RAMP

    def _counts(self) -> int:
        counts = round(self.motor.frequency * self._reference_rpm / self._rpm_per_count)
        return min(max(counts, -0x8000), 0x7FFF)

    def _live(self, index: int) -> int | None:
        present = _LIVE.get(index)
        return self.operator.shown(index) if present is None else present(self)


#: by index: the present value of what is not stored
_LIVE: Final[Mapping[int, Callable[[KebDevice], int]]] = {
    t.STATUS_WORD: KebDevice._status_word,
    t.STATUS_LONG: KebDevice._status_word,
    t.ACTUAL_SPEED: KebDevice._counts,
    t.INVERTER_STATE: KebDevice._state,
    0x220C: lambda drive: round(100 * drive.motor.torque),
    0x5F25: lambda drive: drive.telegram.inputs,  # Fb37
    0x5F26: lambda drive: drive.telegram.outputs,
    t.CONTROL_LONG: lambda drive: drive.parameters.raw(t.CONTROL_WORD),
}
