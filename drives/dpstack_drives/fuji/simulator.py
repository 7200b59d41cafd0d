"""The simulated Fuji FRENIC-Multi with OPC-E1-PDP."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Final

from dpstack.devices.drive_device import FileDevice
from dpstack.devices.machines import Profidrive
from dpstack.devices.model import DeviceFile
from dpstack.profile import (
    AT_ONCE,
    NS_PER_S,
    SPEED,
    ConfigError,
    DriveDevice,
    DriveProfile,
    Leave,
    Options,
    Pkw,
    State,
    TelegramSpec,
)
from dpstack_drives.fuji import table as t
from dpstack_drives.fuji.option import OptionCard

#: the option has a 24 V supply of its own
OWN_SUPPLY: Final = "24v"
#: bits of y98 and y99
_FREQUENCY, _RUN = 1, 2
#: ramp down, all other bits as they must be to run
_OFF1: Final = 0x047E
_COMMAND: Final = struct.Struct(">HH")


class FujiDevice(FileDevice):
    """Options: ``load``, ``switches``, ``supply``; function codes by name.

    ``o30`` follows the telegram. ``release off`` takes the inverter's power
    and leaves the option on the bus; with ``supply`` = ``24v`` ``power-off`` takes the option's only.

    The PPO type is the drive's own setting at power-on: another configuration is refused. Readings: a communications
    error is the end of data exchange by the watchdog only; b4 = 0 takes the frequency to 0 at once; without the
    inverter all words are 0; the terminal LE is on unless it is switched off; a drive whose run command leaves the bus
    stops by F08; with o31 beyond 125 it trips Er5 and stays at the address it has. F01 has no effect.
    """

    contacts = (t.LE, t.LOC)
    trips: Mapping[int, str] = {alarm.code: alarm.keypad for alarm in t.ALARMS}
    unknown_trip = f"no alarm; known: {', '.join(trips.values())}"
    machine: Profidrive

    def __init__(
        self,
        file: DeviceFile,
        profile: DriveProfile,
        telegram: TelegramSpec,
        options: Options,
        presets: Mapping[str, object],
    ) -> None:
        super().__init__(file, profile, telegram, options, {"o30": file.telegrams[telegram.name].number, **presets})
        self._use_own_telegram()
        self._own_supply = options["supply"] == OWN_SUPPLY
        self.contacts_on = self.contacts_wired = frozenset({t.LE})
        if float(options["switches"]) != int(float(options["switches"])):
            raise ConfigError(f"{self.title}: switches must be a whole number, -1 or 00..99")
        self.option = OptionCard(self, int(float(options["switches"])), self._live)
        #: alarm codes (M16 to M19), latest first
        self.alarms: list[int] = []
        self._ctw = 0
        self._sent = 0  # CTW as it came, also without bit 10
        self._mrv = 0
        self._stw = 0
        self._received = False
        self._loss: tuple[int, bool, bool] | None = None  # when, forgotten when data return, by ramp
        self._forced = False  # decelerates to a stop, then trips
        self._off_since: int | None = None  # the option lost its own supply under a live inverter

    def _use_own_telegram(self) -> None:
        """The PPO type of o30 counts from power-on."""
        self.own = self.telegram = self.profile.telegram(t.BY_O30.get(int(self.store.value("o30")), "PPO1"))
        self.configs = tuple(dict.fromkeys((self.own.config, *self.configs)))

    def check_cfg(self, config: bytes) -> str | None:
        """Accept only the PPO type of the drive; another one is no Er5."""
        if config == self.own.config:
            return None
        o30 = int(self.store.value("o30"))
        return f"configuration {config.hex(' ')} is not {self.own.name} ({self.own.config.hex(' ')}), o30 is {o30}"

    def mains(self, on: bool) -> None:
        """The mains of the inverter, as :meth:`release`: the option stays on the bus."""
        self.release(on)

    def inherit(self, before: DriveDevice) -> None:
        """The function codes; o30 counts from power-on."""
        super().inherit(before)
        if isinstance(before, FujiDevice):
            self._use_own_telegram()
            self.option.switches, self.option.address = before.option.switches, before.option.address
            self.option.power_on()
            self._off_since = before.seen_until if self._own_supply and before.released else None
            self.released = before.released
            if self.own_address is None:
                self._fail(t.ER5)

    def installed(self, address: int, baud: int | None) -> None:
        """Switches, o31 and PNU 963."""
        self.option.installed(address, baud)

    @property
    def own_address(self) -> int | None:
        """SW1 and SW2, o31 if they are 00 (docs/reference/drives/fuji.md#address)."""
        return self.option.own_address

    def advance(self, now: int) -> None:
        """Er4 if the option was off for about a second under a live inverter
        (docs/reference/drives/fuji.md#supplies)."""
        since, self._off_since = self._off_since, None
        if since is not None and now - since >= round(t.OPTION_OFF_S * NS_PER_S):
            self._fail(t.ER4)
        super().advance(now)

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """A frame with bit 10 stands until the next one, even when it was there for less than a scan (a reading)."""
        inputs = super().exchange(outputs, now)
        self._received = True
        if len(outputs) == self.telegram.output_octets:
            control, mrv = _COMMAND.unpack_from(outputs, 8 if self.telegram.channel else 0)
            self._sent = control
            if control & 0x0400:
                self._ctw, self._mrv = control, mrv
        return inputs

    def master_lost(self, reason: Leave, now: int) -> None:
        """o27 and o28 (table 9.1)."""
        if reason is not Leave.WATCHDOG or not self._received:
            return
        how = int(self.store.value("o27"))
        if how not in (3, 13, 14, 15):
            delay = round(self.store.value("o28") * NS_PER_S) if how in (1, 2, 11, 12) else 0
            self._loss = (now + delay, how in (2, 12), how in (10, 11, 12))

    def scan(self, words: tuple[int, ...] | None, now: int) -> tuple[int, ...]:
        """Obey CTW if y98 allows it, move the motor, report."""
        if not self.released:
            return self._unpowered()
        source = self._source()
        machine, motor = self.machine, self.motor
        if (trip := self.take_trip()) is not None:
            self._fail(trip)
        self._judge_loss(words is not None, now)
        still = not motor.frequency
        if self._forced:
            if still:
                self._forced = False
                self._fail(t.ER5)
        elif source & _RUN:
            machine.step(self._ctw, still=still)
        elif machine.powered:
            machine.step(_OFF1, still=still)
        elif machine.state is not State.FAULT:
            machine.state = State.SWITCH_ON_INHIBITED
        reference = SPEED.decode(self._mrv) if source & _FREQUENCY else 0.0
        if self._ctw & 0x0800:
            reference = -reference
        self._drive(reference)
        self._stw = self._word(source, reference)
        if words is not None:
            self.option.write_words(words[2:])
        extra = self.option.read_words()[: self.telegram.inputs // 2 - 2]
        return (self._stw, SPEED.nearest(motor.frequency), *extra)

    def _source(self) -> int:
        """The commands that the bus has, as the bits of y98: y99 and the terminals go first."""
        if t.LE not in self.contacts_on or t.LOC in self.contacts_on:
            return 0
        return int(self.store.value("y98")) & ~int(self.store.value("y99"))

    def _unpowered(self) -> tuple[int, ...]:
        """Only the option is on the bus."""
        self.motor.switch(False)
        self.machine = Profidrive()
        self._ctw = self._mrv = self._stw = 0
        self._loss, self._forced = None, False
        return (0,) * (self.telegram.inputs // 2)

    def _judge_loss(self, data: bool, now: int) -> None:
        loss = self._loss
        if loss is None:
            return
        when, forgives, by_ramp = loss
        if data and forgives:
            self._loss = None
        elif now >= when:
            self._loss = None
            if by_ramp:
                self._forced = self.machine.state is not State.FAULT
            else:
                self._fail(t.ER5)

    def _drive(self, reference: float) -> None:
        motor, state, control = self.motor, self.machine.state, self._ctw
        motor.switch(self.machine.powered)
        motor.accel = self.rate("F07")
        motor.decel = self.rate("H56" if state is State.QUICK_STOP else "F08")
        if state is not State.RUNNING or self._forced:
            motor.setpoint = 0.0
        elif not control & 0x10:
            motor.setpoint = 0.0
            motor.decel = AT_ONCE
        elif not control & 0x20:
            motor.setpoint = motor.frequency
        else:
            motor.setpoint = min(max(reference, -1.0), 1.0)

    def _word(self, source: int, reference: float) -> int:
        motor, state = self.motor, self.machine.state
        copied = self._ctw if source & _RUN else 0
        status = self.machine.shown
        status |= 0x0010 if copied & 0x02 else 0
        status |= 0x0020 if copied & 0x04 else 0
        status |= 0x0200 if source else 0
        reference = min(max(reference, -1.0), 1.0)
        if state is State.RUNNING and motor.reached(reference):
            status |= 0x0100
        level = self.store.value("E31")
        if level and abs(motor.frequency) * self.store.value("F03") >= level - 1e-9:
            status |= 0x0400
        return status

    def _fail(self, code: int) -> None:
        if self.machine.state is not State.FAULT:
            self.alarms = [code, *self.alarms][: len(t.ALARM_INDEXES)]
            self.machine.fail()
            self._forced = False

    def carry_out(self, order: Pkw) -> tuple[int, int]:
        return self.option.order(order)

    def _live(self, where: int) -> int | None:
        """By PNU << 8 | index; function codes by their PNU and number."""
        match where >> 8:
            case t.PNU_ALARMS:
                code = self._alarm(t.ALARM_INDEXES.index(where & 0xFF)) if where & 0xFF in t.ALARM_INDEXES else 0
                return next((alarm.malfunction for alarm in t.ALARMS if alarm.code == code), 0)
            case t.PNU_CTW:
                return self._sent
            case t.PNU_STW:
                return self._stw
            case 0x103 if 16 <= where & 0xFF <= 19:
                return self._alarm((where & 0xFF) - 16)
            case _:
                return None

    def _alarm(self, place: int) -> int:
        return self.alarms[place] if place < len(self.alarms) else 0
