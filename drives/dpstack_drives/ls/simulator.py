"""The simulated LS LSLV-S100 with CPDP-S100."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Final

from dpstack.devices.drive_device import DeclaredDevice
from dpstack.devices.model import DeviceFile
from dpstack.profile import (
    SPEED,
    DriveDevice,
    DriveProfile,
    Leave,
    Options,
    Pkw,
    State,
    TelegramSpec,
    profidrive_states,
    ramp,
    record47,
    signed16,
)
from dpstack_drives.ls import records, settings, telegrams
from dpstack_drives.ls import table as t
from dpstack_drives.ls.lostcommand import LostCommand
from dpstack_drives.ls.module import Module
from dpstack_drives.ls.plugin import profile_of
from dpstack_drives.ls.runstate import LsMachine, Rest, motor_status
from dpstack_drives.ls.settings import Settings

#: stop and emergency of the LS control word: a frame with them counts even when the next one follows within a scan
_STOPS: Final = t.LS_CONTROL.mask("stop", "emergency")


#: data of the motor (made up)
_RATED_VOLTS, _RATED_WATTS = 380, 7500


class LsDevice(DeclaredDevice):
    """Options: the plugin's, ``load``, ``version`` (2.01 knows only VENDOR), ``quick_stop_s``; parameters by code.

    Readings: a frame of PROFIdrive with bit 10 stands until the next one with it; OFF1 ramps by dr-04; what Para
    Control writes is not stored over power-off, and out of its limits it is ignored; 0005 and 0006 are obeyed in
    VENDOR only; a jog runs at dr-11 while there is no run command; a trip is a diagnosis alarm of slot 1 (table 2: MS1
    has alarms) with the number of PNU 947, its acknowledgement the one that the fault is gone; COM-09 shows an
    LED that flashes as on; COM-94 = 1 takes a new COM-07 over (4.2.2): the module restarts at that address.
    """

    unknown_trip = f"no trip; known: {', '.join(map(t.trip_text, t.TRIPS))}"
    max_diag_len = t.MAX_DIAG

    def __init__(
        self,
        file: DeviceFile,
        profile: DriveProfile,
        telegram: TelegramSpec,
        options: Options,
        presets: Mapping[str, object],
    ) -> None:
        self.legacy = options["version"] == "2.01"
        profile_of(telegram, str(options["profile"]))
        own = settings.presets(options, presets, f"simulated {profile.name}")
        super().__init__(file, profile, telegram, options, own)
        if self.legacy:  # its own configuration, which Get_Cfg shows, is one that it accepts
            if telegrams.number_of(telegram) != telegrams.VENDOR:
                self.telegram = telegrams.vendor(*(int(self.store.value(count)) for count in ("COM-50", "COM-30")))
            self.configs = (self.telegram.config,)
        self.machine = profidrive_states.ProfidriveMachine()
        self.runner = LsMachine()
        self._reference_rpm = float(options["reference_rpm"])
        self._quick_stop_s = float(options["quick_stop_s"])
        self._settings = Settings(self.store)
        self._control = self._reference = 0  # of PROFIdrive, as they stand
        self._word = self._status = 0  # control word as it came, status word
        self._stops = 0
        self._last: tuple[int, ...] = ()
        self._cyclic: dict[int, int] = {}
        self._hold = True
        self._received = False
        self._taken: bytes | None = None  # the last frame; None: the next one counts, even if it is the same
        self._loss = LostCommand(self.store)
        self._rest = Rest(self.store)
        self.module = Module(self, self._live, self._changed)
        self._online = self._config_refused = self._command_lost = False  # for the LEDs
        if not self.legacy:
            self.has_alarms("diagnostic")
            self.record47 = record47.ParameterServer(records.LsParameters(self.module), records.RULES)
            timed = record47.TimedRecords(self.record47, self._caught_up)
            self.records = record47.ImRecords((records.IDENTIFICATION,), timed)
            self.ms2 = records.CONNECTIONS

    def _caught_up(self, now: int) -> int:
        """The time of its last scan: a master of class 2 asks also while nobody exchanges data with it."""
        self.advance(now)
        return self.seen_until or 0

    @property
    def kind(self) -> int:
        """The profile in use, as COM-11 counts."""
        number = telegrams.number_of(self.telegram)
        if number == telegrams.VENDOR:
            return t.IO
        return t.LS_DRIVE if number != 1 and self._settings.profile == t.LS_DRIVE else t.PROFIDRIVE

    def check_cfg(self, config: bytes) -> str | None:
        """Version 2.01 has only the vendor telegram (2.1, table 2)."""
        found = self.profile.telegrams_of(config)
        reason = super().check_cfg(config)
        if found and self.legacy and telegrams.number_of(found[0]) != telegrams.VENDOR:
            reason = f"version 2.01 has no {found[0].name}: take VENDOR n/m"
        self._config_refused = reason is not None
        return reason

    @property
    def faulted(self) -> bool:
        return self.runner.fault

    def jog(self, direction: int) -> None:
        """Jog by the terminals of the drive: 1 forward, -1 reverse, 0 off."""
        self.jog_direction = direction

    def inherit(self, before: DriveDevice) -> None:
        """Take over the parameters; those that waited for COM-94 act from power-on."""
        super().inherit(before)
        self._apply()

    def installed(self, address: int, baud: int | None) -> None:
        """COM-07 and COM-12; a search for the rate leaves that at 255, invalid."""
        super().installed(address, baud)
        index = next((index for index, rate in t.BAUD_INDEX.items() if rate == baud), t.INVALID_BAUD)
        self.store.write(settings.spec("COM-12"), index, ram_only=True)

    def enter(self, config: bytes, now: int) -> None:
        """The vendor telegram's word counts become COM-50 and COM-30 (4.2.10)."""
        self.advance(now)
        spec = self.profile.telegrams_of(config)[0]
        if spec.config != self.telegram.config:
            self._begin()
        if telegrams.number_of(spec) == telegrams.VENDOR:
            settings.store_counts(self.store, spec)
            self._apply()
        self._cyclic.clear()
        self._taken = None
        self._hold = True
        self._online = True
        super().enter(config, now)

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """A frame that stops counts even when the next one follows within a scan."""
        inputs = DeclaredDevice.exchange(self, outputs, now)  # super() would take longer than the exchange
        if outputs != self._taken and len(outputs) == self.telegram.output_octets:
            self._taken = outputs
            self._hold = False
            self._received = True
            self._command_lost = False
            self._loss.returned()
            words = self._words(outputs[8 if self.telegram.channel else 0 :])
            if self.kind == t.PROFIDRIVE:
                if words[0] & 0x0400:
                    self._control, self._reference = words[0], words[1]
            else:
                self._stops |= self._commands(words)[0] & _STOPS
        return inputs

    def clear(self, now: int) -> None:
        super().clear(now)
        self._taken = None
        self._hold = False

    def master_lost(self, reason: Leave, now: int) -> None:
        """Lost command (docs/reference/drives/ls-s100.md#swap-and-lost-command): PRT-12 and PRT-13; until then the last
        outputs stand."""
        self._taken = None
        self._hold = True
        self._online = False
        if self._received:
            self._command_lost = bool(self.store.value("PRT-12"))
            self._loss.begin(now)
        self._received = False

    def refresh(self, process: bytes | None, now: int) -> bytes:
        """COM-68 swaps the octets of every word, not those of the parameter channel (a reading)."""
        order = "<" if self._settings.swap else ">"
        words = None if process is None else self._words(process)
        return struct.pack(f"{order}{self.telegram.inputs // 2}H", *self.scan(words, now))

    def _words(self, process: bytes) -> tuple[int, ...]:
        return struct.unpack(f"{'<' if self._settings.swap else '>'}{self.telegram.outputs // 2}H", process)

    # -- one scan -------------------------------------------------------------------------------------------------

    def scan(self, words: tuple[int, ...] | None, now: int) -> tuple[int, ...]:
        """Obey the outputs, move the motor, return the inputs."""
        size = self.telegram.outputs // 2
        if words is not None:
            self._write_mapped(words)
        elif self._hold and len(self._last) == size:
            words = self._last
        else:
            words = (0,) * size
        self._last = words
        if self._loss.step(self.motor, now):
            self._fail(t.LOST_COMMAND)
        if (trip := self.take_trip()) is not None:
            self._fail(trip)
        if self.kind == t.PROFIDRIVE:
            self._run_profidrive(words, now)
            front = [self._status, self._speed_word()]
        else:
            self._run_ls(*self._commands(words), now)
            front = [] if self.kind == t.IO else [self._status, self._hundredths()]
        room = self.telegram.inputs // 2 - len(front)
        mapped = [self._shown(where) for where in self._settings.status_map[:room]]
        return (*front, *mapped, *(0,) * (room - len(mapped)))

    def _commands(self, words: tuple[int, ...]) -> tuple[int, int]:
        """Control word and frequency command of the LS Drive profile; in VENDOR from 0006 and 0005."""
        if self.kind == t.LS_DRIVE:
            return words[0], words[1]
        values = dict(zip(self._settings.control_map, words, strict=False))
        return values.get(t.OPERATION, 0) | t.AUTHORITY, values.get(t.FREQUENCY, 0)

    def _fail(self, number: int) -> None:
        self.module.fault(number)
        self.diagnosis_alarm(records.SLOT, True, number.to_bytes(2, "big"))
        self.machine.state = State.FAULT
        self.runner.fault = True
        self._loss.forced = False

    def _bus_commands(self, source: str) -> bool:
        return self.store.value(source) == t.FIELD_BUS[source]

    def _run_profidrive(self, words: tuple[int, ...], now: int) -> None:
        motor, machine, control = self.motor, self.machine, self._control
        still = not motor.frequency
        before = machine.state
        if self._bus_commands("dr-06"):
            machine.step(control | 0x40, still=still)  # bit 6 works on the set point
        elif before is not State.FAULT:
            machine.state = State.SWITCH_ON_INHIBITED
        if before is State.FAULT and machine.state is not before:
            self.reset_fault()
        state = machine.state
        reference = self._fraction(self._reference) if self._bus_commands("dr-07") else 0.0
        if not control & 0x10 or not control & 0x40:
            reference = 0.0
        elif not control & 0x20:
            reference = motor.frequency
        jog = self.jog_direction if not machine.powered and state is not State.FAULT else 0
        self._power(machine.powered or bool(jog), now, stops=state is State.READY)
        self._ramp(reference if state is State.RUNNING else self._jogged(jog), quick=state is State.QUICK_STOP)
        self._word = words[0]
        status = machine.SHOWN[state] & 0x49
        for bit, of in t.COPIES.items():
            status |= (self._word >> of & 1) << bit
        status |= 0x0080 if self.warning_mask else 0
        if state is State.RUNNING and motor.reached(motor.setpoint):
            status |= 0x0100
        self._status = status

    def _power(self, on: bool, now: int, *, stops: bool) -> None:
        """``stops``: without ``on`` it comes to rest by Ad-08."""
        holds = self._rest.step(self.motor, now, wanted=stops and not on)
        if not self.motor.braking or not holds:
            self.motor.switch(on or holds)

    def _jogged(self, direction: int) -> float:
        return direction * self.store.value("dr-11") / self.store.value("dr-20")

    def _run_ls(self, control: int, hundredths: int, now: int) -> None:
        runner = self.runner
        stops, self._stops = self._stops, 0
        keypad = not self._bus_commands("dr-06")
        faulted = runner.fault
        runner.step(0 if keypad else control | stops)
        if faulted and not runner.fault:
            self.reset_fault()
        granted = bool(control & t.LS_CONTROL.mask("ramp_authority")) and self._bus_commands("dr-07")
        reference = min(hundredths / 100 / self.store.value("dr-20"), 1.0) if granted else 0.0
        direction = runner.direction
        jog = 0 if direction or runner.coast else self.jog_direction
        self._power(bool(direction or jog), now, stops=not runner.coast)
        self._ramp(direction * reference if direction else self._jogged(jog))
        self._word = control
        self._status = self._ls_status(control, direction)

    def _ls_status(self, control: int, direction: int) -> int:
        keypad = not self._bus_commands("dr-06")
        bits = {
            "fault": self.runner.fault,
            "keypad": keypad,
            "run_granted": not keypad and control & t.LS_CONTROL.mask("run_authority"),
            "ramp_granted": not keypad and control & t.LS_CONTROL.mask("ramp_authority"),
        }
        status = t.LS_STATUS.mask(*(name for name, on in bits.items() if on))
        jog = bool(self.jog_direction) and not direction
        return status | motor_status(self.motor, self.store, direction=direction, jog=jog)

    def _run_status(self) -> int:
        """000E: the LS status word, whatever the profile is."""
        if self.kind != t.PROFIDRIVE:
            return self._status
        direction = (-1 if self.motor.setpoint < 0 else 1) if self.machine.state is State.RUNNING else 0
        return self._ls_status(t.AUTHORITY, direction)

    def _ramp(self, setpoint: float, *, quick: bool = False) -> None:
        motor = self.motor
        up, down = self.store.value("dr-03"), self._quick_stop_s if quick else self.store.value("dr-04")
        motor.accel, motor.decel = ramp(up), ramp(down)
        if self._loss.instead is not None and setpoint:
            setpoint = self._loss.instead
        motor.setpoint = 0.0 if self._loss.forced else min(max(setpoint, -1.0), 1.0)

    def reset_fault(self) -> None:
        self.module.acknowledged()
        self.diagnosis_alarm(records.SLOT, False)
        self.machine.state = State.SWITCH_ON_INHIBITED
        self.runner.fault = False

    def _fraction(self, word: int) -> float:
        return signed16(word) / self._reference_rpm if self._settings.rpm else SPEED.decode(word)

    def _speed_word(self) -> int:
        frequency = self.motor.frequency
        return round(frequency * self._reference_rpm) & 0xFFFF if self._settings.rpm else SPEED.nearest(frequency)

    def _hundredths(self) -> int:
        return round(abs(self.motor.frequency) * self.store.value("dr-20") * 100) & 0xFFFF

    # -- parameters -----------------------------------------------------------------------------------------------

    def _write_mapped(self, words: tuple[int, ...]) -> None:
        at = 0 if self.kind == t.IO else t.PARA_AT
        for where, raw in zip(self._settings.control_map, words[at:], strict=False):
            if not where or self._cyclic.get(where) == raw:
                continue
            self._cyclic[where] = raw
            spec = t.spec_at(where)
            if spec is not None and spec.write_error(raw) is None:
                self.store.write(spec, raw, ram_only=True)

    def _shown(self, where: int) -> int:
        spec = t.spec_at(where) if where else None
        return 0 if spec is None else self.module.value(spec) & 0xFFFF

    def carry_out(self, order: Pkw) -> tuple[int, int]:
        return self.module.order(order)

    def _live(self, number: int, index: int) -> int | None:
        present = _LIVE.get(number if number > 0xFF else number << 8 | index)
        return None if present is None else present(self)

    def _changed(self, where: int) -> None:
        if where == t.PNU_RESET:
            self.module.clear()
            self.warning_mask = 0
        elif where == t.UPDATE and self.store.value("COM-94"):
            self.store.write(settings.spec("COM-94"), 0, ram_only=True)
            self._apply()
            if self.station_address not in (None, self.own_address):
                self.restart_soon()

    def _leds(self) -> int:
        """Table 7. ERROR: a fault, a configuration that differs, a lost command."""
        error = self.faulted or self._config_refused or self._command_lost
        return t.LED_CPU | error * t.LED_ERROR | self._online * t.LED_ONLINE

    def _apply(self) -> None:
        """COM-94 = 1 or power-on: the communication parameters act from now on."""
        before = self._settings.profile
        self._settings = Settings(self.store)
        self._taken = None
        self._cyclic.clear()
        if self._settings.profile != before:
            self._begin()

    def _begin(self) -> None:
        """Another profile or telegram: no command of the former one counts, a fault stays."""
        faulted = self.runner.fault
        self._control = self._reference = self._stops = 0
        self.machine, self.runner = profidrive_states.ProfidriveMachine(), LsMachine()
        self._last = ()
        if faulted:
            self.machine.state = State.FAULT
            self.runner.fault = True


#: by PNU or address: the present value of what is not stored
_LIVE: Final[Mapping[int, Callable[[LsDevice], int]]] = {
    t.PNU_ADDRESS: lambda drive: drive.store.raw(settings.spec("COM-07")),
    t.PNU_TELEGRAM: lambda drive: telegrams.number_of(drive.telegram),
    t.TELEGRAM: lambda drive: telegrams.number_of(drive.telegram),
    t.PNU_PROFILE: lambda drive: t.PNU_930[drive.kind],
    t.PROFILE: lambda drive: drive.kind,
    t.PNU_WARNING: lambda drive: drive.warning_mask,
    t.WARNING: lambda drive: drive.warning_mask,
    t.PNU_BAUD: lambda drive: drive.store.raw(settings.spec("COM-12")),
    t.PNU_VERSION: lambda drive: 0x0328,
    t.PNU_STW1: lambda drive: 0 if drive.kind == t.IO else drive._word,
    t.PNU_ZSW1: lambda drive: 0 if drive.kind == t.IO else drive._status,
    t.OUTPUT_FREQUENCY: LsDevice._hundredths,
    t.OUTPUT_VOLTAGE: lambda drive: round(_RATED_VOLTS * min(abs(drive.motor.frequency), 1.0)),
    t.OUTPUT_POWER: lambda drive: max(round(_RATED_WATTS / 100 * drive.motor.motoring * abs(drive.motor.speed)), 0),
    t.LEDS: LsDevice._leds,
    t.RUN_STATUS: LsDevice._run_status,
    t.TRIP: lambda drive: next(iter(drive.module.situations[0]), 0),
}
