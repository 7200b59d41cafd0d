"""The simulated Demag Dedrive Compact: control modes 0 to 2 of 412, contacts, parameters, faults, a motor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from dpstack.devices.drive_device import FileDevice
from dpstack.devices.machines import Drivecom
from dpstack.devices.model import DeviceFile
from dpstack.profile import (
    NS_PER_MS,
    NS_PER_S,
    SPEED,
    ConfigError,
    DriveDevice,
    DriveProfile,
    Leave,
    Options,
    Pkw,
    ReplyId,
    State,
    TaskId,
    TelegramSpec,
)
from dpstack_drives.demag import outpzd, toggle
from dpstack_drives.demag import table as t

_WORDS: Final = frozenset({TaskId.WRITE_WORD, TaskId.WRITE_ARRAY_WORD})
_LONGS: Final = frozenset({TaskId.WRITE_LONG, TaskId.WRITE_ARRAY_LONG})
_ARRAYS: Final = frozenset({TaskId.READ_ARRAY, TaskId.WRITE_ARRAY_WORD, TaskId.WRITE_ARRAY_LONG})
_CONTACTS, _STATE_MACHINE, _REMOTE_CONTACTS = 0, 1, 2
#: of 392
_DC_BRAKE: Final = 1
_QUICK_STOP: Final = 0x0002
_POWERED: Final = frozenset({State.RUNNING, State.QUICK_STOP})


#: the module has a 24 V supply of its own (4.1)
OWN_SUPPLY: Final = "24v"
_S1, _S2, _S3, _S4, _S5 = 0x0001, 0x0002, 0x0004, 0x0008, 0x0010
_START: Final = _S2 | _S3
_CHOICE: Final = _S4 | _S5
#: S1IND to S8IND
_ALL: Final = 0x00FF
#: closed if the drive is ready: the release of mode 1
_WIRED: Final = frozenset({"S1", "S2"})


class _Settings(NamedTuple):
    """The parameters that every scan reads, those of the active data set."""

    mode: int  # 412
    rated_hz: float  # 375
    reference_hz: float  # of 100 %
    ramp_source: int  # 434
    internal_hz: float  # 228
    toggle_reaction: int  # 880
    toggle_ms: float  # 881
    stop: int  # 392
    still_percent: float  # 637
    deviation_hz: float  # 549


class DemagDevice(FileDevice):
    """Options: ``f_max``, ``f_min``, ``acceleration``, ``deceleration`` (Hz, Hz/s), ``load``, ``supply``; parameters by
    number. With ``supply`` = ``24v`` (4.1) ``mains off`` takes the inverter's power and leaves the module on the bus;
    ``power-off`` takes the module's only, which is F2061.

    ``application``: of the configurations that 392 depends on (``vf``, ``speed``, ``torque``).

    Contacts: S1 releases, S2 and S3 start (clockwise, anticlockwise), S4 and S5 are the bits of the data set if 414
    is 0; in mode 2 the control word has their places, S1 beside the hardware's.

    Readings: modes of 412 above 2 leave the drive off; S2 and S3 start by an edge; S4 and S5 count from data set 1 in
    binary; the toggle bit is of the modes 1 and 2; of the parameters 371 and 375 are locked in operation; entering
    mode 1 begins in switch-on inhibit; F2062 comes only when the bus has the power stage on, F2065 with every wrong
    Chk_Cfg; a write of 391 (6) resets the drive at once and is answered, then the module restarts at the new address;
    in mode 2 S3 turns the ramp's reference round, whatever its sign is; without the inverter's power all words are 0
    and the parameter channel is silent.
    """

    data_sets = t.SETS
    contacts = tuple(f"S{number}" for number in range(1, 7))
    set_slave_add = True
    machine: Drivecom

    def __init__(
        self,
        file: DeviceFile,
        profile: DriveProfile,
        telegram: TelegramSpec,
        options: Options,
        presets: Mapping[str, object],
    ) -> None:
        self._vf = options["application"] == "vf"
        factory = {"392": 0} if options["application"] == "torque" else {}
        super().__init__(file, profile, telegram, options, {**factory, **presets})
        self._use_scan_time(telegram)
        if not self._vf and self.store.value("state_transition_5") == _DC_BRAKE:
            raise ConfigError(f"{self.title}: 392 = 1 (DC brake) needs application = 'vf'")
        self.f_max = float(options["f_max"])
        self.f_min = float(options["f_min"])
        self.acceleration = float(options["acceleration"])
        self.deceleration = float(options["deceleration"])
        self._locked_until = 0
        self._own_supply = options["supply"] == OWN_SUPPLY
        if options["ready"]:
            self.contacts_on = self.contacts_wired = _WIRED
        self._inputs_on = 0  # contacts as they count, bits as in mode 2
        self._wire()
        self._started_by = 0  # S2 and S3 of the last scan
        self._anticlockwise = False  # started by S3
        self._mode = -1
        self.toggle = toggle.Toggle()
        self._words: tuple[int, ...] | None = None
        self._still_since: int | None = None
        self._braking_until: int | None = None
        self._sign = 1  # of the last line set point that was not 0
        self._bus_hz = 0.0
        self._ramp_hz = 0.0
        self._wanted_hz = 0.0
        self._settings_of = (self.store.changes, 0)
        self._settings = self._read_settings()

    # -- conditions -----------------------------------------------------------------------------------------------

    def enter(self, config: bytes, now: int) -> None:
        self.advance(now)  # by the scan time of the telegram so far
        self._use_scan_time(self.profile.telegrams_of(config)[0])
        super().enter(config, now)

    def _use_scan_time(self, telegram: TelegramSpec) -> None:
        self.scan_ns = t.scan_ms(telegram) * NS_PER_MS

    @property
    def active_set(self) -> int:
        """414, or by the contacts if that is 0."""
        contacts = self._inputs_on
        return int(self.store.value("data_set_selection")) or 1 + bool(contacts & _S4) + 2 * bool(contacts & _S5)

    @property
    def faulted(self) -> bool:
        return bool(self.fault)

    def reset_fault(self) -> None:
        """At the keypad. Raises ValueError in the first 15 s of the fault (11.2.1)."""
        left = self._locked_until - (self.seen_until or 0)
        if left > 0:
            raise ValueError(
                f"a fault can be acknowledged {t.FAULT_LOCK_S} s after it came: {left / NS_PER_S:.1f} s are left"
            )
        self.fault = 0
        self.machine.enter(State.SWITCH_ON_INHIBITED if self._mode == _STATE_MACHINE else State.READY)

    def contact(self, name: str, on: bool) -> None:
        super().contact(name, on)
        self._wire()

    def _wire(self) -> None:
        """The contacts have changed: bits S1 to S6, and the release by mode."""
        closed = self.contacts_on
        self._hardware = sum(1 << int(name[1:]) - 1 for name in closed)
        self.released = "S1" in closed
        self._release = {
            _STATE_MACHINE: self.released and not closed.isdisjoint(("S2", "S3")),
            _REMOTE_CONTACTS: self.released,
        }

    def release(self, on: bool) -> None:
        """S1."""
        self.contact("S1", on)

    def set_point(self, hertz: float) -> None:
        """228, that of the reference frequency channel. Raises ValueError beyond its limits."""
        spec = self.parameter_table.get(228)
        assert spec is not None
        spec.to_raw(hertz)
        self.store.install(spec.name, hertz)

    def fault_code(self, code: str) -> int:
        """``F2100`` or ``2100``. Raises ValueError."""
        try:
            number = int(code.strip().upper().removeprefix("F"), 16)
        except ValueError:
            number = 0
        if not 0 < number <= 0xFFFF:
            known = ", ".join(f"F{known:04X}" for known in t.FAULTS)
            raise ValueError(f"{code!r} is no fault number such as {known}")
        return number

    def source(self, number: int) -> bool | float:
        """The value that one of the sources 750 to 761 gives to the functions of the drive now (11.2.5).

        Raises ValueError if none exists: without PPO2 or PPO4 there are no sources.
        """
        words = self._words
        if self.telegram.outputs != 12:
            raise ValueError(f"source {number}: there are sources in PPO2 and PPO4 only")
        return outpzd.source(number, words or (0,) * 6, self._reference(self.active_set))

    def inherit(self, before: DriveDevice) -> None:
        """Parameters and contacts; with a supply of its own the module was off under a live inverter: F2061 (13.2)."""
        super().inherit(before)
        self._wire()
        if isinstance(before, DemagDevice):
            self.unpowered = before.unpowered
            if self._own_supply and not self.unpowered:
                self.pending_trip = t.FAULT_MODULE

    def mains(self, on: bool) -> None:
        """The mains of the inverter (4.1). Raises ValueError if the inverter feeds the module, too."""
        if not self._own_supply:
            raise ValueError(
                f"the inverter feeds the module of {self.name}: power-off takes both; "
                f'simulated = {{ supply = "{OWN_SUPPLY}" }} gives the module 24 V of its own'
            )
        if on and self.unpowered:
            self._reset()
            self.fault = 0
            self._locked_until = 0
        self.unpowered = not on

    @property
    def injected(self) -> tuple[str, ...]:
        """The conditions of every drive, and the mains of the inverter. S1 is the release if it was wired."""
        other = "contact S1 off" if "S1" in self.contacts_wired else "release off"
        found = tuple(text for text in super().injected if text != other)
        return found + (("mains off",) if self.unpowered else ())

    def check_cfg(self, config: bytes) -> str | None:
        """A wrong configuration is F2065 (13.2)."""
        reason = super().check_cfg(config)
        if reason is not None and not self.unpowered:
            self.pending_trip = t.FAULT_CONFIGURATION
        return reason

    def master_lost(self, reason: Leave, now: int) -> None:
        """The bus no longer controls: F2062 when the watchdog ended it, else the power stage just goes off."""
        if self._mode in (_STATE_MACHINE, _REMOTE_CONTACTS) and self.machine.state in _POWERED:
            if reason is Leave.WATCHDOG:
                self._fail(t.FAULT_MASTER_LOST, now)
            else:
                self.machine.enter(State.SWITCH_ON_INHIBITED)
            self.motor.switch(False)

    # -- the internal scan ----------------------------------------------------------------------------------------

    def scan(self, words: tuple[int, ...] | None, now: int) -> tuple[int, ...]:
        """Commands, set points, motor; then status and actual values."""
        self._words = words
        control, line = (words[0], words[1]) if words is not None else (0, 0)
        if self.unpowered:
            self.pending_trip = None
            self.motor.switch(False)
            return (0,) * (self.telegram.inputs // 2)
        contacts = self._hardware if self._mode != _REMOTE_CONTACTS else self._contacts_on(control)
        self._inputs_on = contacts
        if self._settings_of != (of := (self.store.changes, contacts & _CHOICE)):
            self._settings = self._read_settings()
            self._settings_of = of
        settings = self._settings
        mode = settings.mode
        machine = self.machine
        if (trip := self.take_trip()) is not None:
            self._fail(trip, now)
        if mode != self._mode:
            self._mode = mode
            self._inputs_on = contacts = self._hardware if mode != _REMOTE_CONTACTS else self._contacts_on(control)
            self._started_by = contacts & _START
            self._anticlockwise = False
            if machine.state is not State.FAULT:
                machine.enter(State.SWITCH_ON_INHIBITED if mode == _STATE_MACHINE else State.READY)
        remote = mode in self._release and self._release[mode]
        obeyed = self._answered(control, settings, now)
        if mode == _STATE_MACHINE:
            self._obey(obeyed, settings, now, released=remote)
        elif mode == _REMOTE_CONTACTS:
            self._start_and_stop(self._contacts_on(obeyed), now)
        else:
            self._start_and_stop(contacts if mode == _CONTACTS else 0, now)
        if machine.state is not State.FAULT:
            self.fault = 0
        reference = settings.reference_hz
        self._bus_hz = SPEED.decode(line) * reference
        additional_hz = SPEED.decode(words[2]) * reference if words and len(words) == 6 else 0.0
        self._drive(additional_hz, settings, now)
        return self._inputs_now(control, remote, settings)

    def _contacts_on(self, control: int) -> int:
        """S1 to S8 of the control word in mode 2: S1 only with the hardware's."""
        return control & (_ALL if self.released else _ALL & ~_S1)

    def _read_settings(self) -> _Settings:
        value, active = self.store.value, self.active_set
        return _Settings(
            mode=int(value("local_remote", active)),
            rated_hz=value("rated_frequency", active),
            reference_hz=self._reference(active),
            ramp_source=int(value("ramp_set_point", active)),
            internal_hz=value("internal_reference_frequency"),
            toggle_reaction=int(value("toggle_bit_reaction")),
            toggle_ms=value("toggle_bit_time"),
            stop=int(value("state_transition_5")),
            still_percent=value("switch_off_threshold"),
            deviation_hz=value("max_control_deviation") / 100 * value("rated_frequency", active),
        )

    def _answered(self, control: int, settings: _Settings, now: int) -> int:
        """The control word, or what stands for it while the toggle bit is not answered (8)."""
        by_bus = settings.mode in (_STATE_MACHINE, _REMOTE_CONTACTS)
        reaction = settings.toggle_reaction if by_bus else toggle.OFF
        late = self.toggle.step(
            control,
            now,
            reaction=reaction,
            limit_ms=settings.toggle_ms,
            locked=self.machine.state is State.FAULT or now < self._locked_until,
        )
        if late and reaction == toggle.FAULT:
            self._fail(t.FAULT_TOGGLE, now)
        if self.toggle.answered:
            return control
        acknowledge = control & t.CONTROL.mask("reset_fault")
        stops = reaction == toggle.QUICK_STOP and settings.mode == _STATE_MACHINE
        return acknowledge | (_QUICK_STOP if stops else 0)

    def _obey(self, control: int, settings: _Settings, now: int, *, released: bool) -> None:
        machine = self.machine
        if not released:
            # without the release the control word is not obeyed; a running drive coasts (11.2.1.2)
            if machine.state in _POWERED:
                machine.enter(State.READY)
            return
        if self._braking:
            if now >= (self._braking_until or 0):
                machine.enter(State.READY)  # no new control word is accepted before (11.2.1.2.1)
            return
        self._braking_until = None
        how = settings.stop
        machine.step(
            control,
            stops_at_once=how == 0,
            ack_allowed=now >= self._locked_until,
            still=self._still(now),
        )
        if machine.stopping and how == _DC_BRAKE:
            self._braking_until = now + round(self.store.value("braking_time") * NS_PER_S)

    @property
    def _braking(self) -> bool:
        """The DC brake of transition 5 is on."""
        return self._braking_until is not None and self.machine.state is State.RUNNING

    def _start_and_stop(self, contacts: int, now: int) -> None:
        """Modes 0 and 2: S1 releases, S2 and S3 start (clockwise, anticlockwise)."""
        machine = self.machine
        before, self._started_by = self._started_by, contacts & _START
        if machine.state is State.FAULT:
            return
        start = bool(contacts & _S1) and contacts & _START in (_S2, _S3)
        if start and (machine.state is State.RUNNING or contacts & _START != before):
            machine.enter(State.RUNNING)
            self._anticlockwise = bool(contacts & _S3)
        elif machine.state is State.RUNNING:
            machine.stopping = bool(contacts & _S1)
            if not machine.stopping or self._still(now):
                machine.enter(State.READY)
        else:
            machine.enter(State.READY)

    def _drive(self, additional_hz: float, settings: _Settings, now: int) -> None:
        machine, motor, rated = self.machine, self.motor, settings.rated_hz
        self._ramp_hz = self._combined(self._bus_hz, settings)
        if self._anticlockwise:
            self._ramp_hz = -self._ramp_hz
        wanted = min(max(self._ramp_hz + additional_hz, -self.f_max), self.f_max)
        self._wanted_hz = wanted
        quick = machine.state is State.QUICK_STOP
        braking = self._braking
        powered = machine.state in _POWERED and not braking
        if braking:
            motor.brake()
        else:
            motor.switch(powered)
        emergency = "emergency_stop_clockwise" if motor.frequency >= 0 else "emergency_stop_anticlockwise"
        motor.accel = self.acceleration / rated
        motor.decel = (self.store.value(emergency) if quick else self.deceleration) / rated
        motor.setpoint = 0.0 if quick or machine.stopping or not powered else wanted / rated
        if not powered or abs(motor.frequency) * rated > settings.still_percent / 100 * self.f_max:
            self._still_since = None
        elif self._still_since is None:
            self._still_since = now

    def _reference(self, active: int) -> float:
        """The frequency of 100 % in Hz: 390, or 375 if that is 0."""
        return self.store.value("profibus_reference", active) or self.store.value("rated_frequency", active)

    def _combined(self, line: float, settings: _Settings) -> float:
        """434: 1 internal, 2 line, limited to fmin, 3 their sum."""
        if line:
            self._sign = 1 if line > 0 else -1
        match settings.ramp_source:
            case 1:
                return settings.internal_hz
            case 2:
                return self._sign * self.f_min if abs(line) < self.f_min else line
            case _:
                return settings.internal_hz + line

    def _still(self, now: int) -> bool:
        """Below 637 for 638's time."""
        since = self._still_since
        return since is not None and now >= since + round(self.store.value("holding_time") * NS_PER_S)

    def _fail(self, code: int, now: int) -> None:
        if self.machine.state is not State.FAULT:
            self.fault = code
            self._locked_until = now + t.FAULT_LOCK_S * NS_PER_S
            self.machine.enter(State.FAULT)

    # -- inputs ---------------------------------------------------------------------------------------------------

    def _inputs_now(self, control: int, remote: bool, settings: _Settings) -> tuple[int, ...]:
        motor, rated = self.motor, settings.rated_hz
        status = self.machine.shown
        off = abs(motor.frequency * rated - self._wanted_hz)
        if motor.on and not motor.limited and off <= settings.deviation_hz:
            status |= 0x0400
        status |= 0x0200 if remote else 0
        status |= 0x0800 if motor.limited else 0
        status |= 0x0080 if self.warning_mask or not self.toggle.answered else 0
        status |= toggle.BIT if self.toggle.bit else 0
        status |= 0x8000 if self.warning_mask & t.TRIPS_SOON else 0
        frequency = SPEED.nearest(motor.frequency * rated / settings.reference_hz)
        select = control >> 12 & 7
        wide = self.telegram.inputs == 12
        if not wide and select not in t.SELECTABLE:
            return status, frequency
        current, active_current = SPEED.nearest(motor.current), SPEED.nearest(motor.motoring)
        if wide:
            return status, frequency, current, active_current, self.warning_mask, self.fault
        values = {
            t.SELECT_CURRENT: current,
            t.SELECT_ACTIVE: active_current,
            t.SELECT_WARNING: self.warning_mask,
            t.SELECT_FAULT: self.fault,
        }
        return status | select << 12, values[select]

    # -- parameter channel ----------------------------------------------------------------------------------------

    def carry_out(self, order: Pkw) -> tuple[int, int]:
        """Readings: docs/reference/drives/demag.md#parameter-channel; a plain order on a parameter with data sets takes
        the data set in IND."""
        if order.id not in t.PKW.answers:
            return ReplyId.ERROR, 108
        spec = self.parameter_table.get(order.pnu)
        if spec is None:
            return ReplyId.ERROR, 0
        array = order.id in _ARRAYS
        if order.ind > t.SETS + t.RAM_ONLY:
            return ReplyId.ERROR, 3
        data_set = order.ind % t.RAM_ONLY
        if not spec.per_set and (array or data_set):
            return ReplyId.ERROR, 4
        if order.id in _WORDS or order.id in _LONGS:
            if spec.read_only:
                return ReplyId.ERROR, 1
            if spec.type.wide != (order.id in _LONGS):
                return ReplyId.ERROR, 5
            raw = spec.from_pwe(order.pwe)
            if not spec.low <= spec.to_value(raw) <= spec.high:
                return ReplyId.ERROR, 2
            if spec.number == 392 and raw == _DC_BRAKE and not self._vf:
                return ReplyId.ERROR, 2  # a reading: the value is not offered there
            if spec.name in self.file.standstill and self.machine.state in _POWERED:
                return ReplyId.ERROR, 106
            self.store.write(spec, raw, data_set, ram_only=order.ind >= t.RAM_ONLY)
            if spec.name == self.address_parameter:
                self._reset()
                self.restart_soon()
        elif spec.text:
            return ReplyId.ERROR, 101
        elif spec.per_set and data_set == 0 and self.store.unequal(spec):
            return ReplyId.ERROR, 107
        else:
            live = self._live(order.pnu)
            raw = self.store.raw(spec, data_set or 1) if live is None else spec.nearest_raw(live)
        plain = ReplyId.LONG if spec.type.wide else ReplyId.WORD
        in_set = ReplyId.ARRAY_LONG if spec.type.wide else ReplyId.ARRAY_WORD
        return in_set if array else plain, spec.pwe(raw)

    def _reset(self) -> None:
        """391 was written (6), or the inverter has power again: as after power-on."""
        self.store.power_up()
        self.machine.power_up()
        self.motor.switch(False)
        self.toggle = toggle.Toggle()
        self._mode = -1

    def _live(self, number: int) -> float | None:
        present = {
            249: self.active_set,
            250: self._inputs_on,
            270: self.warning_mask,
            282: min(max(self._bus_hz, -1000), 1000),
            283: min(max(self._ramp_hz, -1000), 1000),
        }
        return present.get(number)
