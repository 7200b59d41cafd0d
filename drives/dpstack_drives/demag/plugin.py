"""The master's end of a Demag Dedrive Compact."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Sequence
from typing import Final

from msgspec import structs

from dpstack.devices.drive_core import DeclaredCore
from dpstack.devices.model import DeviceFile
from dpstack.profile import (
    FAULTED,
    NS_PER_MS,
    NS_PER_S,
    Args,
    CommandError,
    ControlTable,
    DriveProfile,
    Goal,
    ListedParam,
    Lookup,
    MappedCore,
    Options,
    ParamKey,
    ParamRef,
    PkwAccess,
    PkwDialect,
    Setting,
    State,
    Steps,
    TelegramSpec,
    find_parameter,
    listing,
    process_data_map,
    same,
    settled,
)
from dpstack_drives.demag import outpzd
from dpstack_drives.demag import table as t
from dpstack_drives.demag.trace import Trace

_SELECTOR: Final = 12
_REMOTE: Final = t.STATUS.mask("remote")
_WARNING: Final = t.STATUS.mask("warning")
_TOGGLE: Final = t.STATUS.mask("toggle")
#: a standing warning is read again after this time
_WARNING_AGE: Final = NS_PER_S
#: numbers of EEPROM writes of one parameter at which the user gets a notice
_TELL_WRITES: Final = frozenset({10, 100, 1000, 10_000, 100_000})
#: 412 of control by the state machine and by remote contacts (11.2.1)
_STATE_MACHINE, _REMOTE_CONTACTS = 1, 2
#: the option ``control`` and the value of 412 that it needs
MODES: Final = {"state-machine": _STATE_MACHINE, "remote-contacts": _REMOTE_CONTACTS}
_NO_RELEASE: Final = {
    _STATE_MACHINE: "no hardware release: switch on S1 and one of S2 and S3",
    _REMOTE_CONTACTS: "no hardware release: switch on S1",
}
#: The words while 412 is not known to be that of the option. In mode 2 bits 0 to 7 are contacts: zeros open all of
#: them, S1 (release) too. Bit 7 alone (S8IND) releases nothing, so a fault that hides the mode can be acknowledged.
_SILENT: Final = structs.replace(t.TABLE, run={}, steady={**dict.fromkeys(Goal, 0x0000), Goal.ACK_HIGH: 0x0080})
_TO_START: Final = (State.READY, State.RUNNING)


def _contacts(start: str) -> ControlTable:
    """The words of control by remote contacts (11.2.1.3): S1 releases, S2 starts clockwise, S3 anticlockwise.

    Without S2 and S3 the drive stops by its ramp, without S1 it coasts. A state is shown by 0x23, 0x27 or 0x08.
    """
    run = t.CONTACTS.mask("s1", start)
    return structs.replace(
        t.TABLE,
        control=t.CONTACTS,
        run=dict.fromkeys(_TO_START, run),
        steady={**dict.fromkeys(Goal, 0x0000), Goal.STOP: t.CONTACTS.mask("s1")},
        released_mask=run,
    )


_CLOCKWISE, _ANTICLOCKWISE = _contacts("s2"), _contacts("s3")
#: as _SILENT; S1 is what both directions have set
_OPEN: Final = structs.replace(_SILENT, control=t.CONTACTS, released_mask=t.CONTACTS.mask("s1"))
#: states that only control by the state machine has; the other modes show 0x23, 0x27 and 0x08 (11.2.1.1 to 11.2.1.3)
_OF_STATE_MACHINE: Final = frozenset(
    {State.SWITCH_ON_INHIBITED, State.READY_TO_SWITCH_ON, State.QUICK_STOP, State.FAULT_REACTION}
)
#: goals whose control word is not 0
_COMMANDS: Final = frozenset({Goal.RUN, Goal.STOP, Goal.QUICK_STOP})
#: 249 and 412 are read again before a start when they are older, and while the drive runs
_MODE_AGE: Final = NS_PER_S
#: without a parameter channel: a drive that has not slowed down by this much in this time does not obey
_SLOWER: Final = 0.01
_SLOWER_NS: Final = 3 * NS_PER_S


FieldMap = process_data_map.FieldMap


class DemagCore(MappedCore[FieldMap], DeclaredCore):
    """PZD2 reports the frequency; in PPO1 and PPO3 bits 12-14 fetch warning and fault words through it when needed.

    The words of the option ``control`` are sent only while 412 is known to be that of the option in the active data
    set: by reading 249 and 412 if the telegram has a parameter channel, otherwise by the status word. In every other
    mode the control word is 0. ``state-machine``: 412 = 1. ``remote-contacts``: 412 = 2, bits 0 to 7 are S1IND to
    S8IND; the sign of the speed chooses S2 or S3, the set point is its amount; there is no quick stop and no
    acknowledgement.

    Options: ``reference_hz`` (390, or 375 if 390 is 0), ``control``, ``set_412``: start() may set 412 in RAM itself;
    ``map_outputs``: what PZD3 to PZD6 of PPO2 and PPO4 mean (:mod:`~dpstack_drives.demag.outpzd`), and
    ``scaling_current``.

    Jobs of its own: ``output`` of a :class:`MappedCore` (``number`` pzd3 to pzd6) and ``trace``: the data as the
    drive shows them in 281 and 284, the words of this cycle.
    """

    outputs_at = 2  # behind PZD1 and PZD2
    outputs_map: FieldMap
    own_ops = ("output", "trace")

    def __init__(
        self, file: DeviceFile, profile: DriveProfile, name: str, telegram: TelegramSpec, options: Options
    ) -> None:
        self._trace = Trace(channel=telegram.channel)
        super().__init__(file, profile, name, telegram, options)
        self.scan_ns = t.scan_ms(telegram) * NS_PER_MS
        self._selector = 0
        self._actual = 0
        self._current: int | None = None
        self._active: int | None = None
        self._warning_word: int | None = None
        self._warning_at = 0
        self._fault_word = 0
        self._writes: Counter[str] = Counter()
        self._toggles = False
        self._toggle_time = Lookup(lambda: self._toggles, self._ask_toggle_time)
        self._scaling_current = float(options["scaling_current"])
        self._wide = telegram.inputs == 12
        self.inputs_map, self.outputs_map = self.maps_of_options(options)
        #: 412 in the active data set, as far as it is known; the active data set
        self._mode: int | None = None
        self._data_set: int | None = None
        self._mode_at = 0
        self._asking = self._watching = False
        self._set_412 = bool(options["set_412"])
        self._wanted_mode = MODES[str(options["control"])]
        self.table = self._table()
        if telegram.channel:
            self.lookups = (self._toggle_time,)

    def open_channel(self) -> PkwAccess:
        return _Watched(t.PKW, self, self._trace)

    def received(self) -> None:
        """Take the actual value for what ZSW bits 12-14 say it is (11.2.3), or all of them (11.2.4)."""
        words = self.words
        if self.access is None and self._mode != _STATE_MACHINE and self._shows_state_machine:
            self._set_mode(_STATE_MACHINE)
        self._toggles |= bool(words[0] & _TOGGLE)
        if self._wide:
            _, self._actual, self._current, self._active, self._warning_word, self._fault_word = words
            return
        status, value = words
        match status >> _SELECTOR & 7:
            case t.SELECT_FREQUENCY:
                self._actual = value
            case t.SELECT_WARNING:
                self._warning_word = value
                self._warning_at = self.now
            case t.SELECT_FAULT:
                self._fault_word = value
        if self.raw_state in FAULTED:
            self._selector = 0 if self._fault_word else t.SELECT_FAULT
            return
        self._fault_word = 0
        if not status & _WARNING:
            self._warning_word = None
            self._selector = 0
        elif self._warning_word is None or self.now >= self._warning_at + _WARNING_AGE:
            self._selector = t.SELECT_WARNING
        else:
            self._selector = 0

    def control_bits(self) -> int:
        """The selector of the value that PZD2 shows, and the toggle bit as the drive sent it
        (docs/reference/drives/demag.md#toggle-bit)."""
        return self._selector << _SELECTOR | (self.status_word & _TOGGLE if self.online else 0)

    def measured(self) -> tuple[float | None, float | None, float | None]:
        """Frequency of the reference; currents in PPO2 and PPO4."""
        decode = self.scale.decode
        current = None if self._current is None else decode(self._current)
        torque = None if self._active is None else decode(self._active)
        return decode(self._actual), current, torque

    def fault_texts(self) -> tuple[str, ...] | None:
        """The fault by number and text, as soon as its word has come."""
        code = self._fault_word
        return (self.fault_names.get(code, f"F{code:04X}"),) if code else None

    def warnings(self) -> tuple[str, ...]:
        if not self.status_word & _WARNING:
            return ()
        return tuple(name for bit, name in self.warning_names.items() if (self._warning_word or 0) >> bit & 1)

    def parameters(self) -> tuple[ListedParam, ...]:
        """Each parameter of a data set four times, for the data sets 1 to 4."""
        return listing(self.file.parameters, data_sets=range(1, t.SETS + 1))

    def obstacle(self) -> str | None:
        """Bit 9 says whether the bus controls the drive at all, and 412 how."""
        wanted = self._wanted_mode
        if self._mode not in (None, wanted):
            return self._wrong_mode()
        if self.status_word & _REMOTE:
            return None
        return f"remote (bit 9) is 0: 412 is not {wanted} in the active data set, or {_NO_RELEASE[wanted]}"

    def cannot(self, op: str) -> str | None:
        """Contacts have no quick stop; what acknowledges is set in the drive."""
        if self._wanted_mode == _STATE_MACHINE or op not in ("quick_stop", "acknowledge"):
            return super().cannot(op)
        how = {"quick_stop": "stop() takes the ramp, coast() opens S1", "acknowledge": "acknowledge at the drive"}
        return f"{op}: control by remote contacts (412 = 2) has no word for it: {how[op]}"

    def refused_in_clear(self) -> str | None:
        return self.obstacle()

    def prepare(self, deadline: int) -> Steps[None]:
        """A start needs 412 and the hardware release. Raises CommandError that names the missing one."""
        if self.access is None:
            yield from self._mode_by_status(deadline)
        else:
            yield from self._mode_by_channel(deadline)
        yield from settled(self, self._remote, deadline)
        if not self._remote():
            raise CommandError("fault", _NO_RELEASE[self._wanted_mode])

    # -- 412: who controls the drive ----------------------------------------------------------------------------------

    def _set_mode(self, mode: int | None) -> None:
        self._mode = mode
        if self._table() is not self.table:
            self.update()

    def _table(self) -> ControlTable:
        """The words of the mode, in which the direction of contacts is that of the set point."""
        known = self._mode == self._wanted_mode
        if self._wanted_mode == _STATE_MACHINE:
            return t.TABLE if known else _SILENT
        if not known:
            return _OPEN
        return _ANTICLOCKWISE if self.setpoint < 0 else _CLOCKWISE

    def update(self) -> None:
        table = self._table()
        if table is not self.table and table.run and self.table.run:  # the other direction
            self.change_words(table)
        self.table = table
        super().update()

    def setpoint_word(self, fraction: float) -> int:
        """PZD2; contacts have the direction (11.2.1), so it is without a sign there."""
        return self.scale.encode(fraction if self._wanted_mode == _STATE_MACHINE else abs(fraction))

    def decode(self, process: bytes) -> tuple[int | None, float | None]:
        """Control word and set point, with the direction of S3."""
        control, setpoint = super().decode(process)
        turned = self._wanted_mode == _REMOTE_CONTACTS and control is not None and t.CONTACTS.is_set(control, "s3")
        return control, -setpoint if turned and setpoint else setpoint

    @property
    def _shows_state_machine(self) -> bool:
        return self.raw_state in _OF_STATE_MACHINE

    def _shown_mode(self) -> int | None:
        """412 as far as the status word proves it while the control word is 0: with it the state machine never shows
        0x23, and without 412 = 1 or 2 remote (bit 9) is 0."""
        if self._shows_state_machine:
            return _STATE_MACHINE
        return _REMOTE_CONTACTS if self._remote() and self.raw_state is State.READY else None

    def _mode_by_status(self, deadline: int) -> Steps[None]:
        """Without a parameter channel: by the status word at the control word 0."""
        wanted = self._wanted_mode
        if self._mode == wanted and self.goal is not Goal.IDLE:
            return  # it obeys its words, and is watched
        self.set_goal(Goal.IDLE)
        yield from settled(self, lambda: self._shows_state_machine, deadline)
        self._set_mode(self._shown_mode())
        if self._mode == wanted:
            return
        where = f"{self.telegram.name} has no parameter channel to read or set 412"
        if self._mode is not None:
            raise CommandError("fault", f"{self._wrong_mode()}; {where}: do it at the keypad or over PPO1 or PPO2")
        if not self._remote():
            raise CommandError(
                "fault",
                f"remote (bit 9) is 0, and {where}: set 412 = {wanted} at the keypad or over PPO1 or PPO2 (factory "
                f"setting 44); if it is {wanted}, {_NO_RELEASE[wanted]}",
            )
        raise CommandError(
            "fault",
            f"the status word ({self.status_word:04X}) does not show whether 412 is {wanted}, and {where}: "
            f"set 412 = {wanted} at the keypad or over PPO1 or PPO2",
        )

    def _mode_by_channel(self, deadline: int) -> Steps[None]:
        assert self.access is not None
        yield from self._known_mode(deadline)
        mode, active, wanted = self._mode, self._data_set, self._wanted_mode
        if mode != wanted and self._set_412:
            yield from self.access.write(ParamKey(412, active, ram=True), wanted, deadline)
            self.notice(f"412 was {mode}: set to {wanted} in data set {active} (RAM only)")
            self._set_mode(wanted)
        elif mode != wanted:
            raise CommandError(
                "fault",
                f"{self._wrong_mode()} (over the bus: `write 412 {wanted}`), or let start do it in RAM: "
                f"write set_412 = true into the configuration file, table [slave.options] below the [[slave]] table "
                f'with name = "{self.name}"',
            )

    def _known_mode(self, deadline: int) -> Steps[None]:
        """Read 249 and 412 unless that was done just now; without an answer the status word may prove the mode."""
        until = self.answers_until(deadline)
        while self._asking and self.now < until:
            yield
        proven = self.goal is not Goal.IDLE or (self._mode == _STATE_MACHINE) == self._shows_state_machine
        if self._mode is not None and self.now < self._mode_at + _MODE_AGE and proven:
            return
        try:
            yield from self._ask_mode(until)
        except CommandError as error:
            if error.kind not in ("timeout", "parameter"):
                raise
            shown = self._shown_mode() if self.goal is Goal.IDLE or self._shows_state_machine else None
            if shown != self._wanted_mode and shown != _STATE_MACHINE:
                self._set_mode(None)
                raise CommandError(
                    error.kind,
                    f"nobody knows whether 412 is {self._wanted_mode}, so nothing is sent to the drive: {error.text}",
                ) from None
            self._set_mode(shown)

    def _ask_mode(self, deadline: int) -> Steps[None]:
        self._asking = True
        try:
            active = yield from self._raw(249, None, deadline)
            mode = yield from self._raw(412, active, deadline)
        finally:
            self._asking = False
        if self._data_set not in (None, active):
            self.settings_check.changed()
        self._data_set = active
        self._mode_at = self.now
        self._set_mode(mode)

    def _wrong_mode(self) -> str:
        which = "" if self._data_set is None else f" ({self._data_set})"
        write = f"write 412 = {self._wanted_mode} in the active data set{which}"
        if self._mode == _REMOTE_CONTACTS:
            return (
                "412 is 2: the control word drives contacts (S1IND to S8IND), whose meaning is set in the drive: "
                f"use the option control = 'remote-contacts', or {write}"
            )
        if self._mode == _STATE_MACHINE:
            return f"412 is 1: control by the state machine; {write}, or leave out the option control"
        return f"412 is {self._mode}: control not by the bus; {write}"

    def set_goal(self, goal: Goal) -> None:
        """412 may change with the data set: a command is given on a proof of now, and watched as long as it stands."""
        commands = goal in _COMMANDS
        by_words = self._wanted_mode == _STATE_MACHINE and not self._shows_state_machine
        if commands and self.goal is Goal.IDLE and goal is not Goal.RUN and by_words:
            self._set_mode(None)  # with the control word 0 the state machine would show another state
        super().set_goal(goal)
        if commands and not self._watching:
            self._watching = True
            self.spawn("watch", self._watch())

    def why_left(self) -> Steps[str | None]:
        """Another data set, and another 412 in it, is a reason that only the parameter channel shows."""
        obstacle = self.obstacle()
        if self.access is not None:
            try:
                yield from self._ask_mode(self.now + NS_PER_S)
            except CommandError:
                return obstacle
            if self._mode != self._wanted_mode:
                return self._wrong_mode()
        return obstacle

    def halted(self, deadline: int) -> Steps[None]:
        """Back to the control word 0, in which the status word shows the mode."""
        self.set_goal(Goal.IDLE)
        yield from settled(self, lambda: self._shown_mode() is not None, deadline)

    def before_acknowledge(self, deadline: int) -> Steps[None]:
        """Bit 7 acknowledges in mode 1 only, in mode 2 it is the contact S8IND."""
        if self.access is not None:
            try:
                yield from self._known_mode(deadline)
            except CommandError as error:
                if error.kind not in ("timeout", "parameter"):
                    raise
        if self._mode not in (None, _STATE_MACHINE):
            raise CommandError("fault", f"{self._wrong_mode()}; or acknowledge at the drive")

    def _watch(self) -> Steps[dict[str, object]]:
        """Until the control word is 0 again."""
        try:
            due = self.now + _MODE_AGE
            away: int | None = None
            mark: tuple[int, float] | None = None
            judged = False
            while self.online and self.goal is not Goal.IDLE:
                if judged and away is None and self.access is not None:
                    self.sleep_until(due)  # while the status word stays as it is there is nothing new to judge
                yield
                judged = True
                runs = self.raw_state is State.RUNNING
                away = None if self._remote() or not runs else self.now if away is None else away
                if away is not None and self.now >= away + self.settle_ns:
                    self._give_up("remote (bit 9) went to 0 while it runs: 412 changed, with the data set for instance")
                elif self.access is None:
                    mark = self._slows(mark) if runs and self.goal in (Goal.STOP, Goal.QUICK_STOP) else None
                elif self.now >= due and not self._asking:
                    with contextlib.suppress(CommandError):  # without an answer it is asked again
                        yield from self._ask_mode(self.now + 5 * _MODE_AGE)
                    due = self.now + _MODE_AGE
                    if self._mode != self._wanted_mode:
                        self._give_up(self._wrong_mode())
        finally:
            self._watching = False
        return {}

    def _slows(self, mark: tuple[int, float] | None) -> tuple[int, float]:
        """412 cannot be read: a drive that does not slow down after an order to stop is not in mode 1."""
        speed = abs(self.measured()[0] or 0.0)
        if mark is None or speed <= max(mark[1] - _SLOWER, _SLOWER):
            return self.now, speed
        if self.now >= mark[0] + _SLOWER_NS:
            self._set_mode(None)
            self._give_up(
                f"it was ordered to stop and has not slowed down for {_SLOWER_NS // NS_PER_S} s: is "
                f"412 = {self._wanted_mode} in the active data set?"
            )
        return mark

    def _give_up(self, why: str) -> None:
        self.set_goal(Goal.IDLE)
        self.notice(f"{why}; its control word is 0 now, and it stays off until the next start")

    # -- the settings that the plugin relies on ---------------------------------------------------------------------

    def before_settings(self, deadline: int) -> Steps[None]:
        """Read 249 first: the settings are those of the active data set."""
        yield from self._ask_mode(deadline)

    def settings(self) -> Sequence[Setting]:
        """390 or 375 (scale) and 434 (source of the set point) of the active data set."""
        active = self._data_set
        ramp = ParamKey(434, active)
        mode = Setting(
            wanted=f"412 = {self._wanted_mode}",
            keys=(),
            differs=lambda _: self._other_mode(),
            why="only 1 (state machine) and 2 (remote contacts) let the bus control the drive; 44 as delivered",
            source="11.2.1",
        )
        return (
            *(() if self._set_412 else (mode,)),
            Setting(
                wanted=f"390 (375 where 390 is 0) = {self.reference_hz:g} Hz",
                keys=(ParamKey(390, active), ParamKey(375, active)),
                differs=self._other_reference,
                why="100 % (4000h) of set point and actual value is 390, or 375 if 390 is 0",
                source="11.2.2",
            ),
            Setting(
                wanted="434 = 2 or 3",
                keys=(ramp,),
                differs=_without_line,
                why="with 1 the drive follows its internal set point, not that of the bus",
                source="11.2.2.1",
            ),
            Setting(
                wanted="228 = 0 Hz where 434 is 3",
                keys=(ramp, ParamKey(228)),
                differs=_added,
                refuse=False,
                why="with 434 = 3 the drive adds its internal set point (228) to that of the bus",
                source="11.2.2.1",
            ),
            Setting(
                wanted="880 other than 1",
                keys=(ParamKey(880),),
                differs=_trips_in_clear,
                refuse=False,
                why="with 1 every Clear that lasts longer than 881 trips F2100",
                source="8",
            ),
        )

    def _other_mode(self) -> str | None:
        """412, as it was read with 249."""
        if self._mode in (None, self._wanted_mode):
            return None
        return f"{self._wrong_mode()}, or set the option set_412 = true"

    def _other_reference(self, values: Sequence[float]) -> str | None:
        reference, rated = values
        number, hertz = (390, reference) if reference else (375, rated)
        if same(hertz, self.reference_hz):
            return None
        return (
            f"{number} is {hertz:g} Hz in data set {self._data_set}, the option reference_hz is {self.reference_hz:g}: "
            f"set 390 = {self.reference_hz:g} or reference_hz = {hertz:g}"
        )

    def wanted_speed(self) -> float:
        """The set point and the additional reference of PZD3, which the drive adds behind its ramp (11.2.2.2)."""
        fields = self.outputs_map.fields
        first = fields[0] if fields else None
        if first is None or first.text != outpzd.ADDITIONAL:
            return self.setpoint
        return self.setpoint + self.scale.decode(self.values.get(first.key, 0))

    def _remote(self) -> bool:
        return bool(self.status_word & _REMOTE)

    def _raw(self, number: int, data_set: int | None, deadline: int) -> Steps[int]:
        assert self.access is not None
        return (yield from self.access.read_raw(ParamKey(number, data_set), deadline))

    def lost(self, now: int) -> None:
        """The toggle bit begins anew; what was given for PZD3 to PZD6 does not come back by itself.

        Nothing is known of 412 any more.
        """
        self._toggles = False
        super().lost(now)
        self._data_set = None
        self._asking = self._watching = False
        self._set_mode(None)

    def _ask_toggle_time(self, deadline: int) -> Steps[int]:
        """881 must leave time for two of the drive's scans and two rotations
        (docs/reference/drives/demag.md#toggle-bit)."""
        began = self.now
        yield
        yield
        rotations = self.now - began
        limit = yield from self._raw(881, None, deadline)
        needed = 2 * t.scan_ms(self.telegram) + -(-rotations // NS_PER_MS)
        if limit < needed:
            self.notice(
                f"881 (toggle bit time) is {limit} ms, two scans of the drive and two rotations take {needed} ms: "
                f"it will miss answers that came in time; write 881 = {needed} or more"
            )
        return limit

    def order(self, op: str, args: Args) -> Steps[dict[str, object]] | None:
        return self._show() if op == "trace" else super().order(op, args)

    def _show(self) -> Steps[dict[str, object]]:
        yield from ()
        if not self.online:
            raise CommandError("lost", "the drive is not in data exchange")
        return {"value": self._trace.lines(self.last_outputs, self.last_inputs)}

    def place_name(self, word: str, title: str, *, outputs: bool) -> str:
        """PZD3 to PZD6 of the outputs with what the option says that they mean."""
        if not word.startswith("pzd_"):
            return title
        field = self.outputs_map.fields[int(word[-1]) - outpzd.FIRST]
        return f"{title} ({'not used' if field is None else field.text})"

    def parse_map(self, text: str, *, outputs: bool) -> FieldMap:
        """The meaning of PZD3 to PZD6 is set in the drive; the option gives it to the plugin."""
        if text.strip() and not self._wide:
            raise ValueError(f"{self.telegram.name} has no PZD3 to PZD6; take PPO2 or PPO4")
        return outpzd.parse(text, self.reference_hz, self._scaling_current)

    def written(self, ref: ParamRef) -> None:
        """About a million EEPROM writes are possible (11.1.4): warn the user who spends them in a loop."""
        if ref.pnu in (412, 414):
            self._mode_at = self.now - _MODE_AGE  # known no longer
        if ref.ind < t.RAM_ONLY:
            self._writes[ref.label] += 1
            count = self._writes[ref.label]
            if count in _TELL_WRITES:
                self.notice(f"{ref.label} was written to the EEPROM {count} times, which wears it out: use ram = true")

    def resolve(self, key: ParamKey) -> ParamRef:
        data_set, ram = key.place, key.ram
        spec, number, label = find_parameter(key, self.file.parameters, 999)
        if spec is not None and spec.text:
            raise CommandError("usage", f"{label} is a text, which the parameter channel cannot carry")
        if data_set is not None and data_set > t.SETS:
            raise CommandError("usage", f"{label}: data sets are 1..{t.SETS}, 0 for all of them")
        array = spec.per_set if spec is not None else data_set is not None
        if data_set and not array:
            raise CommandError("usage", f"{label} exists once, not in data sets")
        ind = (data_set or 0) + (t.RAM_ONLY if ram else 0)
        return ParamRef(number, ind, array, spec, label, (data_set or 0) if array else None)


def _without_line(values: Sequence[float]) -> str | None:
    if values[0] != 1:
        return None
    return "434 is 1: the drive follows its internal set point, not that of the bus; set 434 = 2 (bus) or 3 (their sum)"


def _added(values: Sequence[float]) -> str | None:
    how, internal = values
    if how != 3 or same(internal, 0):
        return None
    return f"434 is 3: the drive adds its internal set point ({internal:g} Hz by 228) to that of the bus; set 434 = 2"


def _trips_in_clear(values: Sequence[float]) -> str | None:
    if values[0] != 1:
        return None
    return (
        "880 is 1: every Clear longer than 881, also the one at the end of the program, trips F2100, which is locked "
        f"for {t.FAULT_LOCK_S} s; 880 = 2 switches off instead, without a fault"
    )


class _Watched(PkwAccess):
    """Shows its octets to the order ``trace``."""

    def __init__(self, dialect: PkwDialect, core: DemagCore, trace: Trace) -> None:
        super().__init__(dialect, core)
        self._trace = trace

    def step(self, inputs: bytes, now: int) -> None:
        self._trace.watch("in", inputs)
        self._trace.watch("out", self.octets)
        super().step(inputs, now)
