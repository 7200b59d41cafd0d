"""Parameter access over PKW: parameters by name, scaled values, checks before anything is sent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from dpstack.profile.channel.base import ParamKey, check_write, outcome
from dpstack.profile.channel.pkw import Pkw, PkwClient, PkwDialect, ReplyId, TaskId
from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.model.params import ParamSpec
from dpstack.units import NS_PER_MS

#: pause before the order to a busy drive is repeated
RETRY_NS: Final = 25 * NS_PER_MS


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


#: Finds the parameter that a user has named. Raises CommandError.
Resolver = Callable[[ParamKey], ParamRef]


class PkwChannel:
    """A :class:`~dpstack.profile.channel.base.ParameterChannel` by PKW without its orders.

    ``clock``: time of the current cycle in ns; ``settle_ns``: time after which the drive's reply belongs to the octets
    sent now; ``named``: text for a reply to another order.
    """

    __slots__ = ("_client", "_clock", "_named")

    def __init__(
        self, dialect: PkwDialect, clock: Callable[[], int], settle_ns: Callable[[], int], named: Callable[[Pkw], str]
    ) -> None:
        self._client = PkwClient(dialect, settle_ns)
        self._clock = clock
        self._named = named

    @property
    def octets(self) -> bytes:
        """The eight octets to send now."""
        return self._client.octets

    @property
    def busy(self) -> bool:
        """An order waits or runs, or the last one is not yet released."""
        return self._client.busy

    def step(self, inputs: bytes, now: int) -> None:
        self._client.step(inputs, now)

    def reset(self) -> None:
        """Both ends start at 0 again."""
        self._client.reset()

    def replied(self, order: Pkw, label: str, deadline: int) -> Steps[Pkw]:
        """The reply to an order, right or wrong. Raises CommandError of kind timeout."""
        exchange = self._client.submit(order)
        try:
            while exchange.reply is None:
                if self._clock() >= deadline:
                    stray = exchange.stray
                    text = (
                        "the drive did not answer in its parameter channel in time"
                        if stray is None
                        else f"the drive answered for {self._named(stray)} instead"
                    )
                    raise CommandError("timeout", f"{label}: {text}")
                yield
        finally:
            self._client.cancel(exchange, self._clock())
        return exchange.reply


class PkwAccess(PkwChannel):
    """Parameters by PKW. ``written`` is called after a write."""

    __slots__ = ("_dialect", "_resolve", "_written")

    def __init__(
        self,
        dialect: PkwDialect,
        resolve: Resolver,
        clock: Callable[[], int],
        settle_ns: Callable[[], int],
        written: Callable[[ParamRef], None] | None = None,
    ) -> None:
        super().__init__(dialect, clock, settle_ns, _named)
        self._written = written
        self._dialect = dialect
        self._resolve = resolve

    def read(self, key: ParamKey, deadline: int) -> Steps[dict[str, object]]:
        ref = self._resolve(key)
        return _outcome(ref, (yield from self._read(ref, deadline)))

    def write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        """Write one parameter; of an unknown one the type is read first and ``value`` is the integer on the wire."""
        ref = self._resolve(key)
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
        if self._written is not None:
            self._written(ref)
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
            again = self._clock() + RETRY_NS
            if number not in self._dialect.busy or again >= deadline:
                raise refusal
            busy = refusal
            while self._clock() < again:
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


def _named(reply: Pkw) -> str:
    return f"parameter {reply.pnu} index {reply.ind} (reply {reply.id})"
