"""The simulated IMO HD2 with its HD2-E-PDP card."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from msgspec import structs

from dpstack.devices.drive_device import DeclaredDevice
from dpstack.devices.model import DeviceFile
from dpstack.profile import (
    AT_ONCE,
    ConfigError,
    DriveDevice,
    DriveProfile,
    Leave,
    Options,
    Pkw,
    PkwServer,
    TelegramSpec,
    ramp,
    signed16,
)
from dpstack_drives.imo import table as t
from dpstack_drives.imo.channel import ImoPkw, Request, Response

#: data of the motor (made up)
_RATED_HZ: Final = 50.0
_RPM_PER_HZ: Final = 30.0
_RATED_VOLTS, _BUS_VOLTS = 400.0, 540.0
_RATED_TORQUE: Final = 65.0
_INCH_HZ: Final = 5.0
#: torque limit of the inverter itself, of the rated one
_MOST_TORQUE: Final = 1.5

_RUNS: Final = {
    t.Command.FORWARD: 1,
    t.Command.REVERSE: -1,
    t.Command.INCH_FORWARD: 1,
    t.Command.INCH_REVERSE: -1,
}
_COMMANDS: Final = {int(command): command for command in t.Command if command is not t.Command.NONE}
_INCHES: Final = frozenset({t.Command.INCH_FORWARD, t.Command.INCH_REVERSE})
#: reactions of the inverter to the loss of its master
GO_ON, STOP, COAST, TRIP = "go_on", "stop", "coast", "fault"


class ImoDevice(DeclaredDevice):
    """Options: ``load``, ``rated_current``, ``on_loss`` (go_on, stop, coast or fault), ``protected`` (a password),
    ``baud_index``; parameters by name.

    Readings: command 0 changes nothing; a PZD whose function is 0, or one beyond its range, is ignored or limited; the
    running frequency has no sign; DC braking takes the frequency to 0 and holds it; the position feedback is taken when
    its flag goes from 1 to 0; without a master the inverter does what ``on_loss`` says, at once. ``release`` switches
    its mains: POFF.
    """

    trips = t.faults(t.FAULTS_MADE_UP)
    unknown_trip = (
        "no fault of the simulated HD2; known (made up): "
        f"{', '.join(f'{name} ({number})' for number, name in trips.items())}"
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
        assert file.maps is not None
        self._into, self._out = file.maps
        self._control_bits, self._status_bits = file.table.control, file.table.status
        try:
            t.check_rate(float(options["baud_index"]))
        except ValueError as error:
            raise ConfigError(f"{self.title}: {error}") from None
        self.channel = PkwServer(
            structs.replace(file.channel.of_pkw, layout=ImoPkw),
            self._request,
            reads=frozenset({int(Request.READ)}),
            refuse=self._refuse_request,
        )
        self._rated_current = float(options["rated_current"])
        self._on_loss = str(options["on_loss"])
        self._protected = bool(options["protected"])
        self._control = 0
        self._command = t.Command.NONE
        #: words received by function of table 2-6
        self.values: dict[int, int] = {}
        self._position = (0, 0)
        #: the present fault code, 0 without one
        self.fault = 0
        #: consumed energy in rated power x seconds
        self.energy = 0.0
        self._received: tuple[int, ...] = ()
        self._transmitted: tuple[int, ...] = ()
        self._load_maps()

    # -- conditions -----------------------------------------------------------------------------------------------

    @property
    def faulted(self) -> bool:
        return bool(self.fault)

    def reset_fault(self) -> None:
        self.fault = 0
        self._command = t.Command.STOP

    def mains(self, on: bool) -> None:
        """As :meth:`release`: the card stays on the bus."""
        self.release(on)

    def warn(self, mask: int) -> None:
        """1: the overload pre-alarm, SW bit 12. Raises ValueError on any other."""
        if mask not in (0, 1):
            raise ValueError("the HD2 shows one warning on the bus, the overload pre-alarm: 1 sets it, 0 clears it")
        super().warn(mask)

    def inherit(self, before: DriveDevice) -> None:
        """Take over the parameters, with the maps of P15."""
        super().inherit(before)
        self._load_maps()

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """A command stands until the next one, even when it was there for less than a scan."""
        inputs = super().exchange(outputs, now)
        if len(outputs) == self.telegram.output_octets:
            self._control = int.from_bytes(outputs[8:10], "big")
            self._command = _COMMANDS.get(self._control & t.CODE, self._command)
        return inputs

    def master_lost(self, reason: Leave, now: int) -> None:
        """The option ``on_loss``: what the inverter does is not in the card's manual."""
        if self._on_loss == STOP:
            self._command = t.Command.STOP
        elif self._on_loss == COAST:
            self._command = t.Command.COAST
        elif self._on_loss == TRIP and self._command in _RUNS:
            self._fail(t.LOST_MASTER)

    # -- the internal scan ----------------------------------------------------------------------------------------

    def scan(self, words: tuple[int, ...] | None, now: int) -> tuple[int, ...]:
        """Receive the process data, move the motor, return the inputs."""
        if (trip := self.take_trip()) is not None:
            self._fail(trip)
        if words is not None:
            self._receive(words)
        if self._command is t.Command.RESET and self.fault:
            self.reset_fault()
        self._drive()
        self._count_energy()
        status = self._status()
        return (status, *(self._word(number, status) for number in self._transmitted))

    def _receive(self, words: tuple[int, ...]) -> None:
        flag = self.values.get(18, 0)
        self.values = {number: word for number, word in zip(self._received, words[1:], strict=True) if number}
        if flag and not self.values.get(18, 1):
            self._position = (self.values.get(16, 0), self.values.get(17, 0))

    def _drive(self) -> None:
        motor, command = self.motor, self._command
        obeys = self._obeys
        direction = _RUNS.get(command, 0) if obeys else 0
        brakes = obeys and self._is_set("dc_brake")
        if not self.released or self.fault or command is t.Command.COAST:
            motor.switch(False)
        elif direction or brakes or self._pre_excites():
            motor.switch(True)
        elif not motor.frequency:
            motor.switch(False)
        hertz = _INCH_HZ if command in _INCHES else self._set_hertz(direction)
        motor.setpoint = 0.0 if brakes else direction * hertz / _RATED_HZ
        motor.accel = self._rate(t.ACCELERATION)
        motor.decel = AT_ONCE if brakes else self._rate(t.DECELERATION)
        motor.limit = self._torque_limit()

    @property
    def _obeys(self) -> bool:
        return self.store.value(t.SOURCE) == t.Source.COMMUNICATION and self.released and not self.fault

    def _is_set(self, name: str) -> bool:
        """A bit of the control word."""
        return self._control_bits.is_set(self._control, name)

    def _pre_excites(self) -> bool:
        return self._obeys and (self._command is t.Command.PRE_EXCITE or self._is_set("pre_excitation"))

    def _set_hertz(self, direction: int) -> float:
        from_bus = self.store.value(t.FREQUENCY_CHANNEL) == t.FROM_PROFIBUS
        wanted = self.values.get(1, 0) / 100 if from_bus else self.store.value(t.KEYPAD_FREQUENCY)
        hertz = min(wanted, self.store.value(t.MAXIMUM_HZ))
        limit = self.values.get(5 if direction > 0 else 6)
        return hertz if limit is None else min(hertz, limit / 100)

    def _torque_limit(self) -> float:
        """PZD 7 or 8 by whether the motor drives or brakes; PZD 4 under torque control."""
        motoring = self.motor.torque * self.motor.speed >= 0
        most = [_MOST_TORQUE]
        if (limit := self.values.get(7 if motoring else 8)) is not None:
            most.append(limit / 1000)
        if self._is_set("torque_control") and 4 in self.values:
            most.append(abs(signed16(self.values[4])) / 1000)
        return min(most)

    def _rate(self, name: str) -> float:
        """Up to the maximum frequency in the parameter's time."""
        return ramp(self.store.value(name), self.store.value(t.MAXIMUM_HZ) / _RATED_HZ)

    def _count_energy(self) -> None:
        if self._is_set("clear_energy"):
            self.energy = 0.0
        self.energy += abs(self.motor.torque * self.motor.speed) * self.scan_ns / 1e9

    def _status(self) -> int:
        kept = self._control & self._control_bits.mask("motor_2", "heartbeat")
        status = int(self._state()) | kept | int(self.store.value(t.SOURCE)) << t.SOURCE_SHIFT
        status |= self._status_bits.mask("bus_voltage") if self.released else 0
        return status | (self._status_bits.mask("overload") if self.warning_mask else 0)

    def _state(self) -> t.Running:
        motor = self.motor
        if self.fault:
            return t.Running.FAULT
        if not self.released:
            return t.Running.POFF
        if motor.on and motor.frequency:
            return t.Running.FORWARD if motor.frequency > 0 else t.Running.REVERSE
        if motor.on and not self._is_set("dc_brake") and self._command in _RUNS:
            return t.Running.FORWARD if _RUNS[self._command] > 0 else t.Running.REVERSE
        return t.Running.PRE_EXCITED if motor.on and self._pre_excites() else t.Running.STOPPED

    def _fail(self, code: int) -> None:
        self.fault = code
        self._command = t.Command.STOP
        self.motor.switch(False)

    @property
    def hertz(self) -> float:
        """The frequency without its sign."""
        return abs(self.motor.frequency) * _RATED_HZ

    @property
    def volts(self) -> float:
        """By the voltage set point where there is one, else by the frequency."""
        part = self.values[11] / 1000 if 11 in self.values else abs(self.motor.frequency)
        return round(min(1.0, part) * _RATED_VOLTS) if self.motor.on else 0.0

    def _word(self, number: int, status: int) -> int:
        function = self._into.fields.fields.get(number)
        if function is None:
            return 0
        value: float = status if number == t.STATE_WORD else 0.0
        if number in _ACTUAL:
            value = _ACTUAL[number](self)
        return round(min(max(value, function.low), function.high) * function.per_unit) & 0xFFFF

    # -- parameters -----------------------------------------------------------------------------------------------

    def _load_maps(self) -> None:
        self._transmitted, self._received = (
            tuple(int(self.store.value(str(key.name))) for key in way.codes.places) for way in (self._into, self._out)
        )

    def _refuse_request(self, request: Pkw) -> tuple[int, int] | None:
        number = self.refusal(write=request.id != Request.READ)
        return None if number is None else _error(number)

    def _request(self, request: Pkw) -> tuple[int, int]:
        """Tables 2-10 and 2-11; what is wrong first: the request, the right, the address, then the parameter."""
        spec = self.parameter_table.get(request.pnu)
        if request.id == Request.READ:
            return (Response.WORD, self.store.raw(spec)) if spec is not None else _error(2)
        if request.id != Request.WORD:
            return _error(1)
        control = self.last_outputs[8:10] if self.last_outputs else b"\0\0"
        if not int.from_bytes(control, "big") & self._control_bits.mask("enable_writing"):
            return Response.NO_RIGHTS, 0
        if spec is None:
            return _error(2)
        raw = request.pwe & 0xFFFF
        if self._protected:
            return _error(9)
        if spec.read_only:
            return _error(7)
        if spec.name in t.STANDSTILL_ONLY and self.motor.on:
            return _error(8)
        if not spec.low <= spec.to_value(raw) <= spec.high:
            return _error(3)
        self.store.write(spec, raw)
        self._load_maps()
        return Response.WORD, raw


#: by number of a transmitted function: its value, in its unit (table 2-8). The speed of a line, and analog and pulse
#: inputs are not there
_ACTUAL: Final[Mapping[int, Callable[[ImoDevice], float]]] = {
    1: lambda drive: drive.hertz,
    2: lambda drive: drive.values.get(1, 0) / 100,
    3: lambda drive: _BUS_VOLTS if drive.released else 0.0,
    4: lambda drive: drive.volts,
    5: lambda drive: drive.motor.current * drive._rated_current,
    6: lambda drive: 100 * drive.motor.torque,
    7: lambda drive: 100 * drive.motor.torque * drive.motor.speed,
    8: lambda drive: round(abs(drive.motor.speed) * _RATED_HZ * _RPM_PER_HZ),
    10: lambda drive: drive.hertz,
    11: lambda drive: drive.fault,
    16: lambda drive: drive.values.get(9, 0),
    17: lambda drive: drive.values.get(10, 0),
    18: lambda drive: drive.values.get(2, 0) / 10,
    19: lambda drive: drive.values.get(3, 0) / 10,
    20: lambda drive: _RATED_TORQUE,
    21: lambda drive: signed16(drive.values.get(14, 0)),
    22: lambda drive: drive.values.get(15, 0),
    23: lambda drive: signed16(drive._position[0]),
    24: lambda drive: drive._position[1],
}


def _error(number: int) -> tuple[int, int]:
    """Response 3 with the number in PKW3."""
    return Response.ERROR, number << 16
