"""The parameter channel of PPO1 and PPO2 (PKW): eight octets PKE IND PWE with a handshake, both ends.

PKE: order or reply id in bits 15-12, SPM bit 11 (0 here), PNU bits 10-0. IND: subindex in the high octet. PWE: 32 bits.
Sources: PROFIdrive V2; the replies that are allowed to an order from the MICROMASTER and SIMOREG manuals. Which ids a
drive knows, its error texts and its handshake are data: a :class:`PkwDialect`.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

from dpstack.profile.channel.base import CycleTimes
from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.model.param_errors import BAD_TYPE, ILLEGAL_NUMBER, OPERATING_STATE, PARAMETER_ERRORS, READ_ONLY
from dpstack.profile.model.param_store import ParamStore
from dpstack.profile.model.params import ParamSpec

PKW_LEN: Final = 8
ZEROS: Final = bytes(PKW_LEN)
_LAYOUT: Final = struct.Struct(">HBBI")


class TaskId(IntEnum):
    """Order ids of the master."""

    NONE = 0
    READ = 1
    WRITE_WORD = 2
    WRITE_LONG = 3
    READ_ARRAY = 6
    WRITE_ARRAY_WORD = 7
    WRITE_ARRAY_LONG = 8
    ELEMENTS = 9


class ReplyId(IntEnum):
    """Reply ids of the drive."""

    NONE = 0
    WORD = 1
    LONG = 2
    ARRAY_WORD = 4
    ARRAY_LONG = 5
    ELEMENTS = 6
    ERROR = 7
    NO_CONTROL = 8


#: orders that change nothing
READS: Final = frozenset({int(TaskId.READ), int(TaskId.READ_ARRAY), int(TaskId.ELEMENTS)})


class Pkw(NamedTuple):
    """One content of the channel: order or reply id, PNU, IND (its high octet), value (32 bits unsigned)."""

    id: int
    pnu: int
    ind: int = 0
    pwe: int = 0

    def build(self) -> bytes:
        return _LAYOUT.pack(self.id << 12 | self.pnu & 0x7FF, self.ind, 0, self.pwe)

    @classmethod
    def parse(cls, octets: bytes) -> Pkw:
        """From (at least) eight octets; SPM and IND's low octet are ignored."""
        pke, ind, _, pwe = _LAYOUT.unpack_from(octets)
        return cls(pke >> 12, pke & 0x7FF, ind, pwe)


@dataclass(frozen=True, slots=True, kw_only=True)
class PkwDialect:
    """Differences between drives: positive replies allowed to each order, error texts, and the handshake.

    ``zero_between``: the drive takes a new order only after it has answered 0 with 0 (as
    docs/drives/demag.md#handshake-of-the-parameter-channel). Without it a new order may follow at once unless it looks
    like the last one; then a reply counts only when id, PNU and index match. ``parse``: of a :class:`Pkw` whose octets
    are laid out in another way. ``busy``: error numbers of a drive that cannot carry out the order yet: the order is
    repeated.
    """

    answers: Mapping[int, tuple[int, ...]]
    errors: Mapping[int, str]
    zero_between: bool = True
    parse: Callable[[bytes], Pkw] = Pkw.parse
    busy: frozenset[int] = frozenset()

    def error_text(self, number: int) -> str:
        """The drive's text for an error number."""
        return self.errors.get(number, "error without a text in the manual")


#: a drive without peculiarities: words and double words, no arrays, no data sets. V2 has error texts of its own
PLAIN_PKW: Final = PkwDialect(
    answers={
        TaskId.READ: (ReplyId.WORD, ReplyId.LONG),
        TaskId.WRITE_WORD: (ReplyId.WORD,),
        TaskId.WRITE_LONG: (ReplyId.LONG,),
    },
    errors={**PARAMETER_ERRORS, OPERATING_STATE: "not in this operating state", 18: "another error"},
)


@dataclass(slots=True, eq=False)
class Exchange:
    """One order. ``reply`` is set when the drive has answered; ``stray``: the last reply to another order."""

    order: Pkw
    reply: Pkw | None = None
    stray: Pkw | None = None


class PkwChannel:
    """The master's end: one order at a time, the others queue. ``octets``: the eight octets to send now."""

    def __init__(self, dialect: PkwDialect, times: CycleTimes) -> None:
        self._dialect = dialect
        self._times = times
        self._queue: deque[Exchange] = deque()
        self.reset()

    @property
    def busy(self) -> bool:
        """Whether :meth:`step` has to be called in every cycle."""
        return self._release or self._active is not None or bool(self._queue)

    def replied(self, order: Pkw, label: str, deadline: int) -> Steps[Pkw]:
        """The reply to an order, right or wrong. Raises CommandError of kind timeout."""
        exchange = self.submit(order)
        try:
            while exchange.reply is None:
                if self._times.now >= deadline:
                    stray = exchange.stray
                    text = (
                        "the drive did not answer in its parameter channel in time"
                        if stray is None
                        else f"the drive answered for {self.describe_stray(stray)} instead"
                    )
                    raise CommandError("timeout", f"{label}: {text}")
                yield
        finally:
            self.cancel(exchange)
        return exchange.reply

    def describe_stray(self, reply: Pkw) -> str:
        """Text for a reply to another order."""
        return f"parameter {reply.pnu} index {reply.ind} (reply {reply.id})"

    def submit(self, order: Pkw) -> Exchange:
        """Queue an order; the caller polls the exchange's ``reply``."""
        exchange = Exchange(order)
        self._queue.append(exchange)
        return exchange

    def cancel(self, exchange: Exchange) -> None:
        """Cancel an order; harmless when it is done."""
        if exchange is self._active:
            self._withdraw()
            self._quiet_until = self._times.now + self._times.settle_ns
        elif exchange in self._queue:
            self._queue.remove(exchange)

    def reset(self) -> None:
        """The slave left data exchange: both ends start at 0 again."""
        self._queue.clear()
        self._active: Exchange | None = None
        self._release = False  # our order is withdrawn, the drive's reply is not yet 0
        self._quiet_until = 0  # a 0 before this may be older than an order that was withdrawn unanswered
        self._last: Pkw | None = None
        self.octets = ZEROS

    def step(self, inputs: bytes, now: int) -> None:
        """Process the channel's octets in ``inputs`` (the first eight) and advance the handshake."""
        reply = self._dialect.parse(inputs)
        replied = reply.id != ReplyId.NONE
        active = self._active
        if active is None:
            if replied and self._queue and not self._release:
                self._queue[0].stray = reply  # the reply to no order of ours
            self._next(replied, now)
        elif replied and self._fits(active.order, reply):
            active.reply = reply
            self._withdraw()
        elif replied:
            active.stray = reply

    def _next(self, replied: bool, now: int) -> None:
        """Send the next order as soon as the drive's present reply cannot be mistaken for its answer."""
        if replied:
            self._quiet_until = 0  # the drive has seen the last order: its next 0 answers our 0
        if (replied or now < self._quiet_until) and not self._may_follow():
            return
        self._release = False
        if self._queue:
            self._active = active = self._queue.popleft()
            self._last, self.octets = active.order, active.order.build()

    def _may_follow(self) -> bool:
        """Whether an order may follow without a 0 between: PNU and index must differ, to recognise its answer."""
        last = self._last
        if self._dialect.zero_between or last is None or not self._queue:
            return False
        order = self._queue[0].order
        return (order.pnu, order.ind) != (last.pnu, last.ind)

    def _fits(self, order: Pkw, reply: Pkw) -> bool:
        if reply.pnu != order.pnu or reply.ind != order.ind:
            return False
        # after a zero any reply for this PNU is the answer, right or wrong; without one it may be an old one
        return self._dialect.zero_between or reply.id in self.expected(order.id)

    def expected(self, order_id: int) -> tuple[int, ...]:
        """The reply ids that can answer an order, negative ones included."""
        return (*self._dialect.answers.get(order_id, ()), ReplyId.ERROR, ReplyId.NO_CONTROL)

    def _withdraw(self) -> None:
        self._active = None
        self._release = True
        self.octets = ZEROS


class PkwServer:
    """The drive's end. ``handler`` carries an order out and returns the reply id and PWE.

    With ``zero_between`` an order is carried out once and its reply held until the order is 0. Without it an order
    acts when it changes, and a read (ids in ``reads``) returns the present value in every call. ``refuse`` is called
    once for each new order: the negative reply to it, None where it is carried out.
    """

    def __init__(
        self,
        dialect: PkwDialect,
        handler: Callable[[Pkw], tuple[int, int]],
        reads: frozenset[int] = READS,
        refuse: Callable[[Pkw], tuple[int, int] | None] = lambda order: None,
    ) -> None:
        self._dialect = dialect
        self._handler = handler
        self._reads = reads
        self._refuse = refuse
        self.reset()

    def reset(self) -> None:
        """Data exchange begins: the reply is 0, the next order is new."""
        self._held = self._refused = False
        self._last = self._reply = ZEROS

    def step(self, octets: bytes) -> bytes:
        """The reply to the eight octets of the order area."""
        order = self._dialect.parse(octets)
        if order.id == TaskId.NONE:
            self.reset()
            return ZEROS
        if self._held and self._dialect.zero_between:
            return self._reply
        again = octets == self._last
        if again and (self._refused or order.id not in self._reads):
            return self._reply
        self._held = True
        self._last = octets
        refusal = None if again else self._refuse(order)
        self._refused = refusal is not None
        reply, pwe = self._handler(order) if refusal is None else refusal
        self._reply = order._replace(id=reply, pwe=pwe).build()
        return self._reply


def plain_server(
    store: ParamStore,
    *,
    live: Callable[[ParamSpec], int | None] = lambda spec: None,
    locked: Callable[[ParamSpec], bool] = lambda spec: False,
    dialect: PkwDialect = PLAIN_PKW,
) -> PkwServer:
    """The drive's end of :data:`PLAIN_PKW` over ``store``: every parameter by its PNU.

    ``live``: the actual value on the wire where it is not stored; ``locked``: error 17 now.
    """

    def carry_out(order: Pkw) -> tuple[int, int]:
        spec = store.table.get(order.pnu)
        if spec is None or spec.text:
            return ReplyId.ERROR, ILLEGAL_NUMBER
        reply = ReplyId.LONG if spec.long else ReplyId.WORD
        if order.id == TaskId.READ:
            actual = live(spec)
            return reply, spec.pwe(store.raw(spec) if actual is None else actual)
        raw = spec.from_pwe(order.pwe)
        error = spec.write_error(raw)
        if error != READ_ONLY and order.id != (TaskId.WRITE_LONG if spec.long else TaskId.WRITE_WORD):
            error = BAD_TYPE
        elif error is None and locked(spec):
            error = OPERATING_STATE
        if error is not None:
            return ReplyId.ERROR, error
        store.write(spec, raw)
        return reply, spec.pwe(raw)

    return PkwServer(dialect, carry_out)
