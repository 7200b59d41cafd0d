"""Parameters over PKW as orders: named, scaled, checked before anything is sent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from dpstack.profile.channel.base import ParamKey
from dpstack.profile.channel.pkw import Order, Pkw, PkwClient, PkwDialect, Reply
from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.model.params import ParamSpec
from dpstack.units import NS_PER_MS

#: pause before a drive that said it was busy is asked again
RETRY_NS: Final = 25 * NS_PER_MS


class ParamRef(NamedTuple):
    """A parameter as it stands in PKW: PNU, IND's high octet, array orders or plain ones, what is known of it.

    ``data_set`` is what to tell the user, None where the drive has none or the parameter exists once.
    """

    pnu: int
    ind: int
    array: bool
    spec: ParamSpec | None
    label: str
    data_set: int | None = None


#: Finds what a user named. Raises CommandError.
Resolver = Callable[[ParamKey], ParamRef]


class PkwChannel:
    """A :class:`~dpstack.profile.channel.base.ParameterChannel` by PKW without its orders.

    ``clock`` tells the time of the current cycle in ns, ``settle_ns`` after how long the drive's reply belongs to what
    is sent now. ``named``: what to call a reply to another order.
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
        """The eight octets as they go out now."""
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
    """Parameters by PKW. ``written`` is told after a write."""

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
        order = Pkw(Order.READ_ARRAY if ref.array else Order.READ, ref.pnu, ref.ind)
        reply = yield from self._exchange(order, ref, deadline)
        return _outcome(ref, reply)

    def write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        """Write one parameter; of an unknown one the type is read first and ``value`` is the integer on the wire."""
        ref = self._resolve(key)
        spec = ref.spec
        if spec is not None:
            if spec.read_only:
                raise CommandError("usage", f"{ref.label} is read only")
            try:
                pwe = spec.pwe(spec.to_raw(value))
            except ValueError as error:
                raise CommandError("usage", str(error)) from None
            long = spec.long
        else:
            order = Pkw(Order.READ_ARRAY if ref.array else Order.READ, ref.pnu, ref.ind)
            reply = yield from self._exchange(order, ref, deadline)
            long = reply.id in (Reply.LONG, Reply.ARRAY_LONG)
            pwe = _raw(ref, value, long)
        if ref.array:
            kind = Order.WRITE_ARRAY_LONG if long else Order.WRITE_ARRAY_WORD
        else:
            kind = Order.WRITE_LONG if long else Order.WRITE_WORD
        reply = yield from self._exchange(Pkw(kind, ref.pnu, ref.ind, pwe), ref, deadline)
        if self._written is not None:
            self._written(ref)
        return _outcome(ref, reply)

    def _exchange(self, order: Pkw, ref: ParamRef, deadline: int) -> Steps[Pkw]:
        if order.id not in self._dialect.answers:
            raise CommandError("usage", f"{ref.label}: the drive has no order {order.id} in its parameter channel")
        busy: CommandError | None = None
        while True:
            try:
                reply = yield from self.replied(order, ref.label, deadline)
            except CommandError as late:
                raise busy or late from None
            if reply.id != Reply.ERROR:
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
        if reply.id == Reply.NO_CONTROL:
            raise CommandError("parameter", f"{ref.label}: the bus has no control over the parameters (reply 8)")
        if reply.id not in self._dialect.answers[order.id]:
            raise CommandError("parameter", f"{ref.label}: reply {reply.id} does not answer order {order.id}")
        return reply


def _outcome(ref: ParamRef, reply: Pkw) -> dict[str, object]:
    """A reply is read as what its id says it is, a word or a double word, also where the table has the other type."""
    spec = ref.spec
    bits = 32 if reply.id in (Reply.LONG, Reply.ARRAY_LONG) else 16
    raw = reply.pwe & (1 << bits) - 1
    value: int | float = raw
    if spec is not None:
        raw = spec.from_wire(reply.pwe, bits)
        value = spec.to_value(raw)
    return {
        "value": value,
        "raw": raw,
        "number": ref.pnu,
        "name": spec.name if spec else None,
        "unit": spec.unit if spec else "",
        "data_set": ref.data_set,
    }


def _raw(ref: ParamRef, value: float, long: bool) -> int:
    bits = 32 if long else 16
    if value != int(value) or not -(1 << bits - 1) <= value < 1 << bits:
        raise CommandError("usage", f"{ref.label}: its scale is unknown here, give the {bits}-bit integer on the wire")
    return int(value) & (1 << bits) - 1


def _named(reply: Pkw) -> str:
    return f"parameter {reply.pnu} index {reply.ind} (reply {reply.id})"
