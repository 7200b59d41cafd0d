"""The master's end of a Demag Dedrive Compact."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Final

from dpstack.profile import (
    FAULTED,
    NS_PER_MS,
    NS_PER_S,
    Args,
    CommandError,
    ConfigError,
    DriveProfile,
    ListedParam,
    Lookup,
    MappedCore,
    ParamKey,
    ParamRef,
    PkwAccess,
    Steps,
    TelegramSpec,
    datamap,
    drivecom,
    listing,
    settled,
)
from dpstack_drives.demag import outpzd
from dpstack_drives.demag import table as t
from dpstack_drives.demag.outpzd import OutMap
from dpstack_drives.demag.trace import Trace

_SELECTOR: Final = 12
_REMOTE: Final = drivecom.STATUS.mask("remote")
_WARNING: Final = drivecom.STATUS.mask("warning")
_TOGGLE: Final = drivecom.STATUS.mask("toggle")
#: a standing warning is read again after this time
_WARNING_AGE: Final = NS_PER_S
#: numbers of EEPROM writes of one parameter at which the user is told
_TELL_WRITES: Final = frozenset({10, 100, 1000, 10_000, 100_000})
_NO_RELEASE: Final = "no hardware release: switch on S1 and one of S2 and S3"


class DemagCore(MappedCore[OutMap]):
    """PZD2 reports the frequency; in PPO1 and PPO3 bits 12-14 fetch warning and fault words through it when needed.

    Options: ``reference_hz`` (390, or 375 where 390 is 0), ``set_412``: start() may set 412 = 1 in RAM itself;
    ``map_outputs``: what PZD3 to PZD6 of PPO2 and PPO4 mean (:mod:`~dpstack_drives.demag.outpzd`), and
    ``scaling_current``.

    Orders of its own: ``output`` of a :class:`MappedCore` (``number`` pzd3 to pzd6) and ``trace``: the data as the
    drive shows them in 281 and 284, the words of this cycle.
    """

    own_ops = ("output", "trace")
    lock_hint = f" before it is {t.FAULT_LOCK_S} s old, nor while its cause lasts"

    def __init__(
        self, profile: DriveProfile, name: str, telegram: TelegramSpec, options: Mapping[str, bool | float | str]
    ) -> None:
        self._selector = 0
        self._actual = 0
        self._current: int | None = None
        self._active: int | None = None
        self._warning_word: int | None = None
        self._warning_at = 0
        self._fault_word = 0
        self._writes: Counter[str] = Counter()
        self._toggles = False
        self._trace = Trace(channel=telegram.channel)
        self._toggle_time = Lookup(lambda: self._toggles, self._ask_toggle_time)
        self.inputs_map = None
        self.outputs_map: OutMap = _map(name, profile, telegram, options)
        what = f"drive {name} ({profile.name}): map_outputs"
        self.take_presets(str(options["map_outputs"]), self.outputs_map.fields, what)
        self.outputs_at = 2  # behind PZD1 and PZD2
        super().__init__(
            name,
            profile.name,
            telegram,
            drivecom.TABLE,
            scan_ns=t.scan_ms(telegram) * NS_PER_MS,
            reference_hz=float(options["reference_hz"]),
            safe_outputs=bytes(telegram.output_octets),
        )
        self._set_412 = bool(options["set_412"])
        self._wide = telegram.inputs == 12
        if telegram.channel:
            self.access = _Watched(t.PKW, self._resolve, lambda: self.now, lambda: self.settle_ns, self._written)
            self.access.trace = self._trace
            self.lookups = (self._toggle_time,)

    def encode(self, control: int, setpoint: int) -> bytes:
        """PZD1 and PZD2, and what was given for PZD3 to PZD6."""
        if not self._wide:
            return self._pack(control, setpoint)
        return self._pack(control, setpoint, *datamap.pack(self.outputs_map.fields, self.values, outpzd.COUNT))

    def received(self) -> None:
        """Take the actual value for what ZSW bits 12-14 say it is (11.2.3), or all of them (11.2.4)."""
        words = self.words
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
        """What PZD2 is to report, and the toggle bit as the drive sent it (D10), never inverted."""
        return self._selector << _SELECTOR | (self.status_word & _TOGGLE if self.online else 0)

    def measured(self) -> tuple[float | None, float | None, float | None]:
        """Frequency of the reference; currents in PPO2 and PPO4."""
        decode = self.scale.decode
        current = None if self._current is None else decode(self._current)
        torque = None if self._active is None else decode(self._active)
        return decode(self._actual), current, torque

    def faults(self) -> tuple[str, ...]:
        """The fault by number and text, as soon as its word has come."""
        if self.raw_state not in FAULTED:
            return ()
        return (t.fault_name(self._fault_word) if self._fault_word else "not yet named",)

    def fault_named(self) -> bool:
        """The fault word has come."""
        return bool(self._fault_word)

    def warnings(self) -> tuple[str, ...]:
        """By name."""
        if not self.status_word & _WARNING:
            return ()
        return t.warning_names(self._warning_word or 0)

    def parameters(self) -> tuple[ListedParam, ...]:
        """Of the data sets 1 to 4 each."""
        return listing(t.PARAMETERS, data_sets=range(1, t.SETS + 1))

    def obstacle(self) -> str | None:
        """Bit 9 tells whether the bus controls the drive at all."""
        if self.status_word & _REMOTE:
            return None
        return f"remote (bit 9) is 0: 412 is not 1 in the active data set, or {_NO_RELEASE}"

    def prepare(self, deadline: int) -> Steps[None]:
        """Without bit 9 no command is obeyed: find out whether 412 or the release is missing."""
        yield from settled(self, self._remote, deadline)
        if self._remote():
            return
        if self.access is None:
            raise CommandError(
                "fault",
                f"remote (bit 9) is 0, and {self.telegram.name} has no parameter channel to read or set 412: "
                f"set 412 = 1 at the keypad or over PPO1 or PPO2 (factory setting 44); if it is 1, {_NO_RELEASE}",
            )
        active = yield from self._read(249, None, deadline)
        mode = yield from self._read(412, active, deadline)
        if mode != 1 and self._set_412:
            yield from self.access.write(ParamKey(412, active, ram=True), 1, deadline)
            self.notice(f"412 was {mode}: set to 1 in data set {active} (RAM only)")
            yield from settled(self, self._remote, deadline)
            mode = 1
        if mode != 1:
            raise CommandError(
                "fault",
                f"412 is {mode}: control not by the bus; write 412 = 1 in the active data set ({active}), "
                "or let start do it with the option set_412",
            )
        if not self._remote():
            raise CommandError("fault", _NO_RELEASE)

    def _remote(self) -> bool:
        return bool(self.status_word & _REMOTE)

    def _read(self, number: int, data_set: int | None, deadline: int) -> Steps[int]:
        assert self.access is not None
        outcome = yield from self.access.read(ParamKey(number, data_set), deadline)
        value = outcome["value"]
        assert isinstance(value, int)
        return value

    def lost(self, now: int) -> None:
        """The toggle bit begins anew; what was given for PZD3 to PZD6 does not come back by itself."""
        self._toggles = False
        super().lost(now)

    def _ask_toggle_time(self, deadline: int) -> Steps[int]:
        """881 must leave time for two of the drive's scans and two rotations (D10)."""
        began = self.now
        yield
        yield
        rotations = self.now - began
        limit = yield from self._read(881, None, deadline)
        needed = 2 * t.scan_ms(self.telegram) + -(-rotations // NS_PER_MS)
        if limit < needed:
            self.notice(
                f"881 (toggle bit time) is {limit} ms, two scans of the drive and two rotations take {needed} ms: "
                f"it will miss answers that came in time; write 881 = {needed} or more"
            )
        return limit

    def order(self, op: str, args: Args) -> Steps[dict[str, object]] | None:
        """See the class."""
        return self._show() if op == "trace" else super().order(op, args)

    def _show(self) -> Steps[dict[str, object]]:
        yield from ()
        if not self.online:
            raise CommandError("lost", "the drive is not in data exchange")
        return {"value": self._trace.lines(self._outputs, self._inputs)}

    def parse_map(self, text: str | None, *, outputs: bool) -> OutMap:
        """What PZD3 to PZD6 mean is set in the drive, and told to the plugin by its option."""
        return self.outputs_map

    def _written(self, ref: ParamRef) -> None:
        """About a million EEPROM writes are possible (11.1.4): tell the user who spends them in a loop."""
        if ref.ind < t.RAM_ONLY:
            self._writes[ref.label] += 1
            count = self._writes[ref.label]
            if count in _TELL_WRITES:
                self.notice(f"{ref.label} was written to the EEPROM {count} times, which wears it out: use ram = true")

    def _resolve(self, key: ParamKey) -> ParamRef:
        data_set, ram = key.place, key.ram
        spec = key.spec_in(t.PARAMETERS)
        number = spec.number if spec is not None else int(key.name)
        label = f"parameter {spec.label}" if spec is not None else f"parameter {number}"
        if not 1 <= number <= 999:
            raise CommandError("usage", f"{label}: parameter numbers are 1..999")
        if spec is not None and spec.text:
            raise CommandError("usage", f"{label} is a text, which the parameter channel cannot carry")
        if data_set is not None and data_set > t.SETS:
            raise CommandError("usage", f"{label}: data sets are 1..{t.SETS}, 0 for all of them")
        array = spec.per_set if spec is not None else data_set is not None
        if data_set and not array:
            raise CommandError("usage", f"{label} exists once, not in data sets")
        ind = (data_set or 0) + (t.RAM_ONLY if ram else 0)
        return ParamRef(number, ind, array, spec, label, (data_set or 0) if array else None)


class _Watched(PkwAccess):
    """Kept for the trace while it is used."""

    __slots__ = ("trace",)

    trace: Trace

    def step(self, inputs: bytes, now: int) -> None:
        """One cycle of the handshake, and what it was about."""
        self.trace.watch("in", inputs)
        self.trace.watch("out", self.octets)
        super().step(inputs, now)


def _map(name: str, profile: DriveProfile, telegram: TelegramSpec, options: Mapping[str, bool | float | str]) -> OutMap:
    """The option. Raises ConfigError."""
    where = f"drive {name} ({profile.name})"
    text = str(options["map_outputs"])
    if text.strip() and telegram.outputs != 12:
        raise ConfigError(f"{where}: map_outputs: {telegram.name} has no PZD3 to PZD6; take PPO2 or PPO4")
    try:
        return outpzd.parse(text, float(options["reference_hz"]), float(options["scaling_current"]))
    except ValueError as error:
        raise ConfigError(f"{where}: map_outputs: {error}") from None
