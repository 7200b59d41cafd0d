"""The simulated Fuji FRENIC-Multi with OPC-E1-PDP."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Final

from dpstack.profile import (
    NS_PER_MS,
    NS_PER_S,
    SPEED,
    DriveDevice,
    DriveProfile,
    Leave,
    Motor,
    Order,
    ParamStore,
    Pkw,
    PkwServer,
    Reply,
    State,
    TelegramSpec,
    profidrive,
)
from dpstack_drives.fuji import table as t

_POWERED: Final = frozenset({State.RUNNING, State.STOPPING, State.QUICK_STOP})
#: reference reached within this part of F03 (a reading)
_NEAR: Final = 0.005
_AT_ONCE: Final = 1e6
_COMMAND: Final = struct.Struct(">HH")


class FujiDevice(DriveDevice):
    """Options: ``load``; function codes by name. ``y98`` is 3 here (0 at the factory), ``o30`` follows the telegram.

    The PPO type is the drive's own setting at power-on: another configuration is refused. Readings: a communications
    error is the end of data exchange by the watchdog only; b4 = 0 takes the frequency to 0 at once.
    """

    def __init__(
        self,
        profile: DriveProfile,
        telegram: TelegramSpec,
        options: Mapping[str, bool | float | str],
        presets: Mapping[str, object],
    ) -> None:
        where = f"simulated {profile.name}"
        given = {"y98": 3, "o30": t.O30[telegram.name], **presets}
        self.store = ParamStore(t.PARAMETERS, given, where=where)
        self.own = profile.telegram(t.telegram_of(int(self.store.value("o30"))))
        super().__init__(profile, self.own, Motor(load=float(options["load"])))
        self.channel = PkwServer(t.PKW, self._order)
        self.machine = profidrive.ProfidriveMachine()
        #: alarm codes (M16 to M19), latest first
        self.alarms: list[int] = []
        self._control = 0
        self._mrv = 0
        self._status = 0
        self._received = False
        self._loss: tuple[int, bool, bool] | None = None  # when, forgotten when data return, by ramp
        self._forced = False  # decelerates to a stop, then trips

    @property
    def scan_ns(self) -> int:
        """A reading: the manual gives none."""
        return t.SCAN_MS * NS_PER_MS

    def check_cfg(self, config: bytes) -> str | None:
        """Only the drive's own PPO type; no Er5."""
        if config == self.own.config:
            return None
        o30 = int(self.store.value("o30"))
        return f"configuration {config.hex(' ')} is not {self.own.name} ({self.own.config.hex(' ')}), o30 is {o30}"

    def fault_code(self, code: str) -> int:
        """Keypad text (``Er5``) or alarm code. Raises ValueError."""
        wanted = code.strip().lower()
        for alarm in t.ALARMS:
            if wanted in (alarm.keypad.lower(), str(alarm.code)):
                return alarm.code
        raise ValueError(f"{code!r} is no alarm; known: {', '.join(alarm.keypad for alarm in t.ALARMS)}")

    def inherit(self, before: DriveDevice) -> None:
        """The function codes; o30 counts from power-on."""
        if isinstance(before, FujiDevice):
            self.store.inherit(before.store)
            self.own = self.profile.telegram(t.telegram_of(int(self.store.value("o30"))))
            self.telegram = self.own
            self.configs = tuple(dict.fromkeys((self.own.config, *self.configs)))

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """A frame with bit 10 stands until the next one, even when it was there for less than a scan (a reading)."""
        inputs = super().exchange(outputs, now)
        self._received = True
        if len(outputs) == self.telegram.output_octets:
            control, mrv = _COMMAND.unpack_from(outputs, 8 if self.telegram.channel else 0)
            if control & 0x0400:
                self._control, self._mrv = control, mrv
        return inputs

    def master_lost(self, reason: Leave, now: int) -> None:
        """o27 and o28 (table 9.1)."""
        if reason is not Leave.WATCHDOG or not self._received:
            return
        later = now + round(self.store.value("o28") * NS_PER_S)
        match int(self.store.value("o27")):
            case 3 | 13 | 14 | 15:
                pass
            case 1 | 11 as how:
                self._loss = (later, False, how == 11)
            case 2 | 12 as how:
                self._loss = (later, True, how == 12)
            case 10:
                self._loss = (now, False, True)
            case _:
                self._loss = (now, False, False)

    def scan(self, words: tuple[int, ...] | None, now: int) -> tuple[int, ...]:
        """Obey CTW where y98 allows it, move the motor, report."""
        source = int(self.store.value("y98"))
        machine, motor = self.machine, self.motor
        trip = self.take_trip()
        if trip is not None:
            self._fail(trip)
        self._judge_loss(words is not None, now)
        still = not motor.frequency
        if self._forced:
            if still:
                self._forced = False
                self._fail(t.ER5)
        elif source in (2, 3):
            machine.step(self._control, still=still)
        reference = SPEED.decode(self._mrv) if source in (1, 3) else 0.0
        if self._control & 0x0800:
            reference = -reference
        self._drive(reference)
        self._status = self._word(source, reference)
        extra = (0,) * (self.telegram.inputs // 2 - 2)
        return (self._status, SPEED.encode(min(max(motor.frequency, -2.0), 0x7FFF / 0x4000)), *extra)

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
        motor, state, control = self.motor, self.machine.state, self._control
        motor.switch(state in _POWERED)
        motor.accel = self._rate("F07")
        motor.decel = self._rate("H56" if state is State.QUICK_STOP else "F08")
        if state is not State.RUNNING or self._forced:
            motor.setpoint = 0.0
        elif not control & 0x10:
            motor.setpoint = 0.0
            motor.decel = _AT_ONCE
        elif not control & 0x20:
            motor.setpoint = motor.frequency
        else:
            motor.setpoint = min(max(reference, -1.0), 1.0)

    def _rate(self, code: str) -> float:
        seconds = self.store.value(code)
        return 1 / seconds if seconds else _AT_ONCE

    def _word(self, source: int, reference: float) -> int:
        motor, state = self.motor, self.machine.state
        copied = self._control if source in (2, 3) else 0
        status = self.machine.SHOWN[state]
        status |= 0x0010 if copied & 0x02 else 0
        status |= 0x0020 if copied & 0x04 else 0
        status |= 0x0200 if source else 0
        reference = min(max(reference, -1.0), 1.0)
        if state is State.RUNNING and not motor.limited and abs(motor.frequency - reference) <= _NEAR:
            status |= 0x0100
        level = self.store.value("E31")
        if level and abs(motor.frequency) * self.store.value("F03") >= level - 1e-9:
            status |= 0x0400
        return status

    def _fail(self, code: int) -> None:
        if self.machine.state is not State.FAULT:
            self.alarms = [code, *self.alarms][: len(t.ALARM_INDEXES)]
            self.machine.state = State.FAULT
            self._forced = False

    # -- parameter channel ----------------------------------------------------------------------------------------

    def _order(self, order: Pkw) -> tuple[int, int]:
        array = order.pnu in t.ARRAYS
        spec = t.PARAMETERS.get(order.pnu, order.ind) or (t.PARAMETERS.get(order.pnu) if array else None)
        if order.id not in t.PKW.answers or spec is None:
            return Reply.ERROR, 0
        if order.id == Order.ELEMENTS:
            return (Reply.ELEMENTS, 32) if array else (Reply.ERROR, 4)
        if not array and order.id in (Order.READ_ARRAY, Order.WRITE_ARRAY_WORD):
            return Reply.ERROR, 4
        reply = Reply.ARRAY_WORD if array else Reply.WORD
        if order.id in (Order.READ, Order.READ_ARRAY):
            if array and (order.id == Order.READ or not 1 <= order.ind <= 32):
                return Reply.ERROR, 3
            live = self._live(order)
            return reply, self.store.raw(spec) if live is None else live
        if spec.read_only or (not self.store.value("access_permission") and spec.number != t.PNU_ACCESS):
            return Reply.ERROR, 1
        raw = spec.from_pwe(order.pwe)
        if not spec.low <= spec.to_value(raw) <= spec.high:
            return Reply.ERROR, 2
        self.store.write(spec, raw)
        return reply, spec.pwe(raw)

    def _live(self, order: Pkw) -> int | None:
        match order.pnu:
            case t.PNU_ALARMS:
                place = t.ALARM_INDEXES.index(order.ind) if order.ind in t.ALARM_INDEXES else len(self.alarms)
                code = self.alarms[place] if place < len(self.alarms) else 0
                return next((alarm.malfunction for alarm in t.ALARMS if alarm.code == code), 0)
            case t.PNU_CTW:
                return self._control
            case t.PNU_STW:
                return self._status
            case _:
                return None
