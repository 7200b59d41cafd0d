"""Drive plugins by declaration, without code: words, scales, states, safe outputs, texts and parameters.

A drive with peculiarities (a named obstacle to starting, a direction bit) is a subclass of :class:`DeclaredCore` with
the hooks of :class:`~dpstack.profile.master.core.DriveCore`.

Its parameter channel is that of a drive without peculiarities: every parameter by its PNU, PROFIdrive's error numbers.
Both ends are here: :func:`plain_resolver` for :class:`~dpstack.profile.channel.pkw_access.PkwAccess`,
:func:`plain_server` over a :class:`~dpstack.profile.model.param_store.ParamStore`. Source: PROFIdrive V2, parameter
channel.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

from dpstack.dpv1.master.plugin_queue import RecordQueue
from dpstack.profile.channel.base import ParamKey
from dpstack.profile.channel.pkw import Pkw, PkwDialect, PkwServer, ReplyId, TaskId
from dpstack.profile.channel.pkw_access import ParamRef, PkwAccess, Resolver
from dpstack.profile.drive_profile import DriveProfile
from dpstack.profile.master.core import DriveCore
from dpstack.profile.model.drive_type import CHANNEL_LEN, TelegramSpec
from dpstack.profile.model.jobs import CommandError
from dpstack.profile.model.param_errors import PARAMETER_ERRORS
from dpstack.profile.model.param_store import ParamStore
from dpstack.profile.model.params import ListedParam, ParamSpec, ParamTable, listing
from dpstack.profile.model.states import FAULTED, ControlTable
from dpstack.profile.model.words import SPEED, Scale
from dpstack.profile.record47.client import PLUGIN, ParameterClient
from dpstack.profile.record47.drive_access import AcyclicAccess, plain_places

#: words and double words, no arrays, no data sets
PLAIN_PKW: Final = PkwDialect(
    answers={
        TaskId.READ: (ReplyId.WORD, ReplyId.LONG),
        TaskId.WRITE_WORD: (ReplyId.WORD,),
        TaskId.WRITE_LONG: (ReplyId.LONG,),
    },
    errors={**PARAMETER_ERRORS, 17: "not in this operating state", 18: "another error"},  # V2 has words of its own
)
#: the highest PNU that PKE holds
_MOST: Final = 0x7FF


def plain_resolver(table: ParamTable, drive: str) -> Resolver:
    """Finds parameters of ``table`` by name or number; a number that is not in it goes as it is, without a scale."""

    def resolve(key: ParamKey) -> ParamRef:
        spec = key.spec_in(table)
        number = spec.number if spec is not None else int(key.name)
        label = f"parameter {spec.label}" if spec is not None else f"parameter {number}"
        if not 1 <= number <= _MOST:
            raise CommandError("usage", f"{label}: parameter numbers are 1..{_MOST}")
        if key.data_set is not None or key.index is not None:
            raise CommandError("usage", f"{label}: {drive} has neither data sets nor indexes")
        if key.ram:
            raise CommandError("usage", f"{label}: {drive} has no writes to RAM only")
        return ParamRef(number, 0, False, spec, label)

    return resolve


def plain_server(
    store: ParamStore,
    *,
    live: Callable[[ParamSpec], int | None] = lambda spec: None,
    locked: Callable[[ParamSpec], bool] = lambda spec: False,
    dialect: PkwDialect = PLAIN_PKW,
) -> PkwServer:
    """The drive's end. ``live``: the actual value on the wire where it is not stored; ``locked``: error 17 now."""

    def carry_out(order: Pkw) -> tuple[int, int]:
        spec = store.table.get(order.pnu)
        if spec is None or spec.text:
            return ReplyId.ERROR, 0
        reply = ReplyId.LONG if spec.long else ReplyId.WORD
        if order.id == TaskId.READ:
            actual = live(spec)
            return reply, spec.pwe(store.raw(spec) if actual is None else actual)
        if spec.read_only:
            return ReplyId.ERROR, 1
        if order.id != (TaskId.WRITE_LONG if spec.long else TaskId.WRITE_WORD):
            return ReplyId.ERROR, 5
        raw = spec.from_pwe(order.pwe)
        if not spec.low <= spec.to_value(raw) <= spec.high:
            return ReplyId.ERROR, 2
        if locked(spec):
            return ReplyId.ERROR, 17
        store.write(spec, raw)
        return reply, spec.pwe(raw)

    return PkwServer(dialect, carry_out)


#: 0x4000 = 100 % of the rated one
_CURRENT: Final = Scale("current")


@dataclass(frozen=True, slots=True, kw_only=True)
class Declaration:
    """Data of a drive without code of its own.

    ``inputs``: what the words of the process data are, in order: ``status`` first, then ``speed``, ``current``,
    ``torque``, ``fault`` (a number), ``warning`` (bits), or a name of its own; a telegram has as many of them as it
    has words. Control word and set point lead the outputs. ``safe``: the control word of the safe outputs, the set
    point is 0 then. ``scan_ns``: how long the drive takes to notice outputs. ``scale`` of speed and set point, in
    parts of the reference; ``current_scale`` of current and torque, in parts of the rated ones. ``faults``: texts by
    number; ``warnings``: texts by bit. ``record_slot``: where record 47 is, of a drive that has it. Raises ValueError.
    """

    table: ControlTable
    safe: int
    scan_ns: int
    inputs: tuple[str, ...] = ("status", "speed")
    scale: Scale = SPEED
    current_scale: Scale = _CURRENT
    faults: Mapping[int, str] = field(default_factory=dict)
    warnings: Mapping[int, str] = field(default_factory=dict)
    parameters: ParamTable | None = None
    dialect: PkwDialect = PLAIN_PKW
    resolver: Callable[[ParamTable, str], Resolver] = plain_resolver
    record_slot: int = 1

    def __post_init__(self) -> None:
        if self.inputs[:1] != ("status",) or len(set(self.inputs)) != len(self.inputs):
            raise ValueError(f"inputs must begin with 'status' and name each word once, not {self.inputs}")

    def core(
        self, profile: DriveProfile, name: str, telegram: TelegramSpec, options: Mapping[str, bool | float | str]
    ) -> DeclaredCore:
        """A ``core_factory`` for the profile of a drive that needs nothing else."""
        return DeclaredCore(self, profile, name, telegram, options)

    def record_access(self, core: DriveCore, queue: RecordQueue) -> AcyclicAccess:
        """A ``record_access`` for the profile of a drive whose parameters have the same numbers in record 47."""
        places = plain_places(self.parameters or ParamTable(()), core.drive)
        return AcyclicAccess(ParameterClient(self.record_slot, references=PLUGIN), queue, places, lambda: core.now)


class DeclaredCore(DriveCore):
    """The master's end of a declared drive. Its option ``reference_hz``, where declared, goes before the profile's."""

    def __init__(
        self,
        declared: Declaration,
        profile: DriveProfile,
        name: str,
        telegram: TelegramSpec,
        options: Mapping[str, bool | float | str],
    ) -> None:
        self.declared = declared
        self.scale = declared.scale
        self._places = {field: place for place, field in enumerate(declared.inputs[: telegram.inputs // 2])}
        lead = bytes(CHANNEL_LEN) if telegram.channel else b""
        super().__init__(
            name,
            profile.name,
            telegram,
            declared.table,
            scan_ns=declared.scan_ns,
            reference_hz=float(options.get("reference_hz", profile.reference_hz)),
            safe_outputs=lead + declared.safe.to_bytes(2, "big") + bytes(telegram.outputs - 2),
        )
        if telegram.channel and declared.parameters is not None:
            resolve = declared.resolver(declared.parameters, profile.name)
            self.access = PkwAccess(declared.dialect, resolve, lambda: self.now, lambda: self.settle_ns)

    def word(self, name: str) -> int | None:
        """The word of the process data that is declared as ``name``; None where the telegram does not reach it."""
        place = self._places.get(name)
        return None if place is None else self.words[place]

    def measured(self) -> tuple[float | None, float | None, float | None]:
        """Speed, current and torque as far as they are declared."""
        scale = self.declared.current_scale
        current, torque = (_decoded(scale, self.word(name)) for name in ("current", "torque"))
        return _decoded(self.scale, self.word("speed")), current, torque

    def faults(self) -> tuple[str, ...]:
        """The fault by its text, by its number where there is none."""
        if self.raw_state not in FAULTED:
            return ()
        number = self.word("fault")
        if number is None:
            return (f"without a name: {self.telegram.name} does not carry it",)
        return (self.declared.faults.get(number, f"number {number}") if number else "not yet named",)

    def fault_named(self) -> bool:
        """Its number has come, or never will."""
        return self.word("fault") != 0

    def warnings(self) -> tuple[str, ...]:
        """By the bits of the warning word."""
        word = self.word("warning") or 0
        return tuple(self.declared.warnings.get(bit, f"bit {bit}") for bit in range(16) if word >> bit & 1)

    def parameters(self) -> tuple[ListedParam, ...]:
        return () if self.declared.parameters is None else listing(self.declared.parameters)


def _decoded(scale: Scale, word: int | None) -> float | None:
    return None if word is None else scale.decode(word)
