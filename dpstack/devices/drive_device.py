"""The simulated drive of a device file: the state machine of its base, a motor, its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dpstack.devices.machines import Machine, machine_of
from dpstack.devices.model import DeviceFile, WordSpec, counts_of
from dpstack.dp.slave.device import Leave
from dpstack.profile.drive_profile import READY
from dpstack.profile.master.settings import same
from dpstack.profile.model.drive_type import DriveType, Options, TelegramSpec
from dpstack.profile.model.params import ParamSpec, ParamTable
from dpstack.profile.model.states import State
from dpstack.profile.record47.parameter_server import ParameterServer, Rules, StoreParameters, TimedRecords
from dpstack.profile.simulator.device import DriveDevice
from dpstack.profile.simulator.motor import AT_ONCE, ramp

#: the fault of the simulated drive of a file that has no fault texts
_ANY_FAULT: Final = {1: "a fault"}
#: bits of the status word that follow those of the control word: OFF2 and OFF3 of PROFIdrive
_ECHOED: Final = ("no_coast", "no_quick_stop")
_DEFAULT_RAMP_S: Final = 1.0


class DeclaredDevice(DriveDevice):
    """A simulated drive whose parameters, faults and errors are those of ``file``: the Python of a device file derives
    from it."""

    def __init__(
        self,
        file: DeviceFile,
        profile: DriveType,
        telegram: TelegramSpec,
        options: Options,
        presets: Mapping[str, object],
    ) -> None:
        self.file = file
        self.parameter_table = _with_messages(file)
        self.dialect = file.channel.pkw
        self.address_parameter = file.address_parameter
        self.trips = self.trips or file.fault.texts or _ANY_FAULT
        simulate = file.simulate
        self.read_errors, self.write_errors = frozenset(simulate.read_errors), frozenset(simulate.write_errors)
        ordered = sorted({*simulate.errors, *self.read_errors, *self.write_errors})
        self.parameter_errors = {number: self.dialect.error_text(number) for number in ordered}
        self.scan_ns = round(file.simulate.scan_ms * 1_000_000)
        number = file.telegrams[telegram.name].number if telegram.name in file.telegrams else None
        if options.get(READY) and number is not None:  # set up for this telegram
            wanted = {one.parameter: number for one in file.settings if one.equals == "telegram"}
            presets = {**wanted, **presets}
        super().__init__(profile, telegram, options, presets)


class FileDevice(DeclaredDevice):
    """The simulated drive of ``file``. It follows the bus while its settings are those that the file wants."""

    def __init__(
        self,
        file: DeviceFile,
        profile: DriveType,
        telegram: TelegramSpec,
        options: Options,
        presets: Mapping[str, object],
    ) -> None:
        super().__init__(file, profile, telegram, options, presets)
        if "load" not in options:
            self.motor.load = file.simulate.load
        if not file.python:
            self.unknown_trip = f"no fault of this drive; known: {', '.join(self.trips.values())}, or any number"
        #: its state machine
        self.machine: Machine = machine_of(file)
        #: number of the fault that stands; 0: none
        self.fault = 0
        self._changes = 0  # of the faults that stand
        self._control = 0
        self._lost_by: str | None = None  # what its lost master ordered
        slot = file.channel.record_slot
        if slot is not None and self.parameter_table is not None:
            self.record47 = server = ParameterServer(
                StoreParameters(self.store, live=self.live, locked=self.locked),
                Rules(slots=frozenset({slot}), objects=frozenset({0, file.channel.record_object})),
            )
            self.records = TimedRecords(server, self._caught_up)

    @property
    def faulted(self) -> bool:
        return self.machine.state is State.FAULT

    def reset_fault(self) -> None:
        self.machine.reset()
        self.fault = 0

    def fault_code(self, code: str) -> int:
        """By number, text or the text's beginning, such as ``F07011``; of a file without Python any number."""
        wanted = code.strip().lower()
        for number, text in self.trips.items():
            if text.lower().startswith(wanted) and wanted:
                return number
        digits = "".join(filter(str.isdecimal, wanted))
        unknown = self.file.fault.unknown
        if digits and not self.file.python and wanted in (digits, unknown.format(int(digits)).lower()):
            return int(digits)
        return super().fault_code(code)

    def live(self, spec: ParamSpec) -> int | None:
        """Faults and warnings that stand, in the parameters that have them."""
        for messages, number in ((self.file.fault, self.fault), (self.file.warning, self.warning_mask)):
            place = messages.parameter
            if place is not None and spec.number == place.number:
                return number if spec.index == (place.index or 0) else 0
            if place is not None and spec.number == place.counter:
                return self._changes & 0xFFFF
        return None

    def locked(self, spec: ParamSpec) -> bool:
        return self.machine.powered and spec.name in self.file.standstill

    def master_lost(self, reason: Leave, now: int) -> None:
        self._lost_by = self.file.simulate.lost

    def check_prm(self, user_prm: bytes) -> str | None:
        """Any octets while no file says how many there are."""
        return super().check_prm(user_prm) if self.profile.user_prm else None

    def enter(self, config: bytes, now: int) -> None:
        self._lost_by = None
        super().enter(config, now)

    def scan(self, words: tuple[int, ...] | None, now: int) -> tuple[int, ...]:
        machine, motor, file = self.machine, self.motor, self.file
        if (trip := self.take_trip()) is not None:
            self._trip(trip)
        still = not motor.frequency or not motor.on
        control, setpoint = self._ordered(words)
        self._control = control or 0
        follows = self.follows
        if self._lost_by is not None:
            self._without_master(still)
        elif control is not None and follows:
            before = machine.state
            clear = self.file.table.control.mask(*self.file.telegrams[self.telegram.name].clear)
            machine.obey(control | clear, still=still)
            if before is State.FAULT and machine.state is not State.FAULT:
                self.fault = 0
        elif words is None or not follows:
            machine.hold()
            if machine.state is State.STOPPING and still:
                machine.reset()
        motor.switch(machine.powered)
        motor.accel = self.rate(file.simulate.up)
        motor.decel = self.rate(file.simulate.quick if machine.state is State.QUICK_STOP else file.simulate.down)
        if machine.state is State.RUNNING:
            if setpoint is not None:
                motor.setpoint = min(max(setpoint, -2.0), 2.0)
        else:
            motor.setpoint = 0.0
        return self._report(follows)

    # -- inside ---------------------------------------------------------------------------------------------------

    @property
    def follows(self) -> bool:
        """It follows the bus: released, and set as the file wants it."""
        if not self.released:
            return False
        for one in self.file.settings:
            if one.notice or isinstance(one.equals, str):
                continue
            if not same(float(self.store.value(one.parameter)), one.equals):
                return False
        return True

    def _caught_up(self, now: int) -> int:
        """The time of its last scan: a master of class 2 asks also while nobody exchanges data with it."""
        self.advance(now)
        return self.seen_until or 0

    def _ordered(self, words: tuple[int, ...] | None) -> tuple[int | None, float | None]:
        """Control word and set point of the reference in the outputs."""
        if words is None:
            return None, None
        found = self.file.telegrams[self.telegram.name]
        control: int | None = None
        setpoint: float | None = None
        at = 0
        for name in found.outputs:
            word = None if isinstance(name, int) else self.file.words[name]
            wide = word is not None and word.octets == 4
            value = words[at] << 16 | words[at + 1] if wide else words[at]
            at += 2 if wide else 1
            if word is not None and word.part == "control":
                control = value
            elif word is not None and word.part == "setpoint":
                setpoint = word.scale.decode(value)
        if (
            control is not None
            and setpoint is not None
            and self.file.reverse is not None
            and control & self.file.reverse
        ):
            setpoint = -setpoint
        return control, setpoint

    def _without_master(self, still: bool) -> None:
        machine, lost = self.machine, self._lost_by
        if lost == "go_on" or machine.state is State.FAULT:
            return
        if lost == "coast":
            machine.reset()
        elif lost in ("stop", "quick_stop"):
            if machine.state is State.RUNNING:
                machine.state = State.QUICK_STOP if lost == "quick_stop" else State.STOPPING
            if machine.state in (State.QUICK_STOP, State.STOPPING) and still:
                machine.reset()
        elif machine.powered:
            self._trip(int(str(lost)))

    def _trip(self, number: int) -> None:
        if self.machine.state is not State.FAULT:
            self.machine.fail()
            self.fault = number
            self._changes += 1

    def rate(self, name: str) -> float:
        """The ramp whose time is in the parameter ``name``, see :class:`Motor`."""
        seconds = float(self.store.value(name)) if name else _DEFAULT_RAMP_S
        return ramp(seconds) if seconds else AT_ONCE

    def _report(self, follows: bool) -> tuple[int, ...]:
        found: list[int] = []
        for name in self.file.telegrams[self.telegram.name].inputs:
            if isinstance(name, int):
                found.append(name)
                continue
            word = self.file.words[name]
            value = self._value(word, follows)
            found += [value >> 16, value & 0xFFFF] if word.octets == 4 else [value]
        return tuple(found)

    def _value(self, word: WordSpec, follows: bool) -> int:
        motor = self.motor
        match word.part:
            case "status":
                return self._status(follows)
            case "speed":
                turned = abs(motor.frequency) if self.file.reversed is not None else motor.frequency
                return word.scale.nearest(turned)
            case "current":
                return word.scale.nearest(motor.current)
            case "torque":
                return word.scale.nearest(motor.torque)
            case "fault":
                return self.fault if word.name == self.file.fault.word else 0
            case "warning":
                return self.warning_mask
        if word.name == self.file.fault.word:
            return self.fault
        return counts_of(word, 0.0) if (word.low or 0) <= 0 else 0

    def _status(self, follows: bool) -> int:
        file, machine, motor = self.file, self.machine, self.motor
        bits, ordered = file.table.status.bits, file.table.control.bits
        status = machine.shown
        said = {
            "remote": follows,
            "warning": bool(self.warning_mask),
            **{name: file.table.control.is_set(self._control, name) for name in _ECHOED if name in ordered},
            "reached": machine.state is State.RUNNING and motor.reached(motor.setpoint),
        }
        mask = self._judged
        for name, on in said.items():
            if on and name in bits and not mask >> bits[name] & 1:
                status |= 1 << bits[name]
        if file.reversed is not None and motor.frequency < 0:
            status |= file.reversed
        messages, number = (
            (file.fault, self.fault) if machine.state is State.FAULT else (file.warning, self.warning_mask)
        )
        derived = file.derived.get(messages.word)
        if derived is not None and number and file.words[derived.of].part == "status":
            status = status & ~(derived.mask << derived.shift) | derived.when
            status |= (number & derived.mask) << derived.shift
        for obstacle in file.obstacles:
            ahead = follows and not status & obstacle.mask and obstacle.value == 0
            if ahead and not mask & obstacle.mask:
                status |= obstacle.mask
        return status & 0xFFFF

    @property
    def _judged(self) -> int:
        """The bits of the status word that show the state."""
        mask = 0
        for row in self.file.table.states.rows:
            mask |= row.mask
        return mask


def _with_messages(file: DeviceFile) -> ParamTable:
    """The parameters of ``file``, and those that have its faults and warnings."""
    found = {(one.number, one.index): one for one in file.parameters}
    for place in (file.fault.parameter, file.warning.parameter):
        if place is not None:
            first = place.index or 0
            keys = [(place.number, at) for at in range(first, first + place.count)]
            for number, index in keys + ([] if place.counter is None else [(place.counter, 0)]):
                name = f"{number}[{index}]" if index else f"{number}"
                spec = ParamSpec(number, name, "Messages that stand", index=index, read_only=True)
                found.setdefault((number, index), spec)
    return ParamTable(found.values())
