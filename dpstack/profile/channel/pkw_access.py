"""Parameter access over PKW: parameters by name, scaled values, checks before anything is sent."""

from __future__ import annotations

from typing import Final, NamedTuple, Protocol

from dpstack.profile.channel.base import CycleTimes, ParamKey, check_write, find_parameter, outcome
from dpstack.profile.channel.pkw import Pkw, PkwChannel, PkwDialect, ReplyId, TaskId
from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.model.params import ParamSpec, ParamTable
from dpstack.units import NS_PER_MS

#: pause before the order to a busy drive is repeated
RETRY_NS: Final = 25 * NS_PER_MS
#: the highest PNU that PKE holds
_MOST: Final = 0x7FF


class ParamRef(NamedTuple):
    """A parameter in PKW: PNU, IND's high octet, array orders or plain ones, its specification where it is known.

    ``data_set`` for messages, None where the drive has none or the parameter exists once.
    """

    pnu: int
    ind: int
    array: bool
    spec: ParamSpec | None
    label: str
    data_set: int | None = None


class PkwCore(CycleTimes, Protocol):
    """A drive plugin with parameters by PKW."""

    def resolve(self, key: ParamKey) -> ParamRef:
        """Find the parameter that a user has named. Raises CommandError."""

    def written(self, ref: ParamRef) -> None:
        """The drive has taken a write."""


def plain_ref(key: ParamKey, table: ParamTable, drive: str) -> ParamRef:
    """A parameter of ``table`` by name or number; a number that is not in it goes as it is, without a scale."""
    spec, number, label = find_parameter(key, table, _MOST)
    if key.data_set is not None or key.index is not None:
        raise CommandError("usage", f"{label}: {drive} has neither data sets nor indexes")
    if key.ram:
        raise CommandError("usage", f"{label}: {drive} has no writes to RAM only")
    return ParamRef(number, 0, False, spec, label)


class PkwAccess(PkwChannel):
    """A :class:`~dpstack.profile.channel.base.ParameterChannel` by PKW, of the plugin ``core``."""

    def __init__(self, dialect: PkwDialect, core: PkwCore) -> None:
        super().__init__(dialect, core)
        self._core = core

    def read(self, key: ParamKey, deadline: int) -> Steps[dict[str, object]]:
        ref = self._core.resolve(key)
        return _outcome(ref, (yield from self._read(ref, deadline)))

    def write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        """Write one parameter; of an unknown one the type is read first and ``value`` is the integer on the wire."""
        ref = self._core.resolve(key)
        raw = check_write(ref.spec, ref.label, value)
        if ref.spec is not None and raw is not None:
            pwe, long = ref.spec.pwe(raw), ref.spec.long
        else:
            reply = yield from self._read(ref, deadline)
            long = reply.id in (ReplyId.LONG, ReplyId.ARRAY_LONG)
            pwe = _raw(ref, value, long)
        if ref.array:
            kind = TaskId.WRITE_ARRAY_LONG if long else TaskId.WRITE_ARRAY_WORD
        else:
            kind = TaskId.WRITE_LONG if long else TaskId.WRITE_WORD
        reply = yield from self._exchange(Pkw(kind, ref.pnu, ref.ind, pwe), ref, deadline)
        self._core.written(ref)
        return _outcome(ref, reply)

    def _read(self, ref: ParamRef, deadline: int) -> Steps[Pkw]:
        return self._exchange(Pkw(TaskId.READ_ARRAY if ref.array else TaskId.READ, ref.pnu, ref.ind), ref, deadline)

    def _exchange(self, order: Pkw, ref: ParamRef, deadline: int) -> Steps[Pkw]:
        if order.id not in self._dialect.answers:
            raise CommandError("usage", f"{ref.label}: the drive has no order {order.id} in its parameter channel")
        busy: CommandError | None = None
        while True:
            try:
                reply = yield from self.replied(order, ref.label, deadline)
            except CommandError as late:
                raise busy or late from None
            if reply.id != ReplyId.ERROR:
                break
            number = reply.pwe & 0xFFFF
            text = self._dialect.error_text(number)
            refusal = CommandError("parameter", f"{ref.label}: error {number}, {text}", number)
            again = self._times.now + RETRY_NS
            if number not in self._dialect.busy or again >= deadline:
                raise refusal
            busy = refusal
            while self._times.now < again:
                yield
        if reply.id == ReplyId.NO_CONTROL:
            raise CommandError("parameter", f"{ref.label}: the bus has no control over the parameters (reply 8)")
        if reply.id not in self._dialect.answers[order.id]:
            raise CommandError("parameter", f"{ref.label}: reply {reply.id} does not answer order {order.id}")
        return reply


def _outcome(ref: ParamRef, reply: Pkw) -> dict[str, object]:
    """The id of the reply decides its size, a word or a double word, also where the table has the other type."""
    spec = ref.spec
    bits = 32 if reply.id in (ReplyId.LONG, ReplyId.ARRAY_LONG) else 16
    raw = reply.pwe & (1 << bits) - 1
    value: int | float = raw
    if spec is not None:
        raw = spec.from_wire(reply.pwe, bits)
        value = spec.to_value(raw)
    return outcome(spec, ref.pnu, value, raw, ref.data_set)


def _raw(ref: ParamRef, value: float, long: bool) -> int:
    bits = 32 if long else 16
    if value != int(value) or not -(1 << bits - 1) <= value < 1 << bits:
        raise CommandError("usage", f"{ref.label}: its scale is unknown here, give the {bits}-bit integer on the wire")
    return int(value) & (1 << bits) - 1
