"""The parameter channel of PPO1 and PPO2 (PKW): eight octets PKE IND PWE with a handshake, both ends.

The master's end has the orders (:class:`PkwChannel`), and over them access to parameters by name with scaled values and
checks before anything is sent (:class:`PkwAccess`).

PKE: order or reply id in bits 15-12, SPM bit 11 (0 here), PNU bits 10-0. IND: subindex in the high octet. PWE: 32 bits.
Sources: PROFIdrive V2; the replies that are allowed to an order from the MICROMASTER and SIMOREG manuals. Which ids a
drive knows, its error texts and its handshake are data: a :class:`PkwDialect`.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Final, NamedTuple, Protocol

from msgspec import Struct

from dpstack.profile.channel.base import (
    CycleTimes,
    FindSpec,
    ParameterChannel,
    ParamKey,
    ParamRef,
    check_write,
    outcome,
)
from dpstack.profile.channel.stored_writes import StoredWrites
from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.model.param_errors import OPERATING_STATE, PARAMETER_ERRORS, SIEMENS
from dpstack.profile.model.param_types import ParamType
from dpstack.text import NamedInt
from dpstack.units import NS_PER_MS

PKW_LEN: Final = 8
ZEROS: Final = bytes(PKW_LEN)
_LAYOUT: Final = struct.Struct(">HBBI")
#: pause before the order to a busy drive is repeated
RETRY_NS: Final = 25 * NS_PER_MS
#: numbers of one page of :class:`PagedPkw`
_PAGE: Final = 2000
#: bits of the page octet with their weights
_WEIGHTS: Final = {0x80: 1, 0x10: 2, 0x20: 4, 0x40: 8, 0x04: 16}


class TaskId(NamedInt):
    """Order ids of the master."""

    NONE = 0
    READ = 1
    WRITE_WORD = 2
    WRITE_LONG = 3
    READ_ARRAY = 6
    WRITE_ARRAY_WORD = 7
    WRITE_ARRAY_LONG = 8
    ELEMENTS = 9


class ReplyId(NamedInt):
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


#: orders with an index in IND
ARRAYS: Final = frozenset(map(int, (TaskId.READ_ARRAY, TaskId.WRITE_ARRAY_WORD, TaskId.WRITE_ARRAY_LONG)))


class Pkw(NamedTuple):
    """Content of the channel: order or reply id, PNU, IND (its high octet), value (32 bits unsigned)."""

    #: order or reply id, 0..15
    id: int
    #: parameter number
    pnu: int
    #: high octet of IND
    ind: int = 0
    #: value, 32 bits unsigned
    pwe: int = 0

    def build(self) -> bytes:
        return _LAYOUT.pack(self.id << 12 | self.pnu & 0x7FF, self.ind, 0, self.pwe)

    @classmethod
    def parse(cls, octets: bytes) -> Pkw:
        """From (at least) eight octets; SPM and IND's low octet are ignored."""
        pke, ind, _, pwe = _LAYOUT.unpack_from(octets)
        return cls(pke >> 12, pke & 0x7FF, ind, pwe)

    @property
    def most(self) -> int:
        """The highest parameter number that this layout holds."""
        return 0x7FF


class PagedPkw(Pkw):
    """Parameter numbers in pages of 2000: PKE has the number in its page, the low octet of IND the page.

    Bit 7 of that octet is page 1 (2000 to 3999), bits 4, 5, 6 and 2 are 2, 4, 8 and 16 pages. Sources: MICROMASTER
    PROFIBUS optional board, 6SE6400-5AK00-0BP0, p28 (bit 7); MICROMASTER 420 operating instructions p115 (weights);
    SINAMICS G120C operating instructions p224 (80h 2000, 90h 6000, 20h 8000, A0h 10000, 50h 20000, F0h 30000,
    74h 60000; p7841[2] is PNU 1841, IND 0290h). That 29000 is number 1000 of page 70h follows from the weights; the
    manual prints no example.
    """

    __slots__ = ()

    def build(self) -> bytes:
        page, pnu = divmod(self.pnu, _PAGE)
        octet = sum(bit for bit, weight in _WEIGHTS.items() if page & weight)
        return _LAYOUT.pack(self.id << 12 | pnu, self.ind, octet, self.pwe)

    @classmethod
    def parse(cls, octets: bytes) -> PagedPkw:
        """From (at least) eight octets; SPM and the other bits of IND's low octet are ignored."""
        pke, ind, octet, pwe = _LAYOUT.unpack_from(octets)
        page = sum(weight for bit, weight in _WEIGHTS.items() if octet & bit)
        return cls(pke >> 12, page * _PAGE + (pke & 0x7FF), ind, pwe)

    @property
    def most(self) -> int:
        return _PAGE * (sum(_WEIGHTS.values()) + 1) - 1


class PkwDialect(Struct, frozen=True, kw_only=True):
    """Differences between drives: positive replies allowed to each order, error texts, and the handshake.

    ``zero_between``: the drive takes a new order only after it has answered 0 with 0 (as
    docs/reference/drives/demag.md#handshake-of-the-parameter-channel). Without it a new order may follow at once unless
    it looks like the last one; then a reply counts only when id, PNU and index match. ``busy``: error numbers of a
    drive that cannot carry out the order yet: the order is repeated. ``layout``: where the eight octets have what.
    """

    #: reply ids that are positive, by order id
    answers: Mapping[int, tuple[int, ...]]
    #: error texts by number
    errors: Mapping[int, str]
    zero_between: bool = True
    #: a subclass of :class:`Pkw` for octets that are laid out in another way
    layout: type[Pkw] = Pkw
    busy: frozenset[int] = frozenset()
    #: a refusal has neither the number nor the index of the order
    bare_errors: bool = False

    def error_text(self, number: int) -> str:
        """The drive's text for an error number."""
        return self.errors.get(number, "error without a text in the manual")

    def code(self, number: int) -> str:
        """An error number for people."""
        return str(number)

    @property
    def most(self) -> int:
        """The highest parameter number."""
        return self.layout(0, 0).most

    @property
    def arrays(self) -> bool:
        """Whether the drive knows the orders of arrays, with an index in IND."""
        return TaskId.READ_ARRAY in self.answers

    @property
    def ram(self) -> bool:
        """Whether the drive has orders for writes to RAM only."""
        return False


#: a drive without peculiarities: words and double words, no arrays, no data sets. V2 has error texts of its own
PLAIN_PKW: Final = PkwDialect(
    answers={
        TaskId.READ: (ReplyId.WORD, ReplyId.LONG),
        TaskId.WRITE_WORD: (ReplyId.WORD,),
        TaskId.WRITE_LONG: (ReplyId.LONG,),
    },
    errors={**PARAMETER_ERRORS, OPERATING_STATE: "not in this operating state", 18: "another error"},
)
#: arrays by index too, numbers up to 2047; ABB FPBA-01 manual 3AFE68573271 p117 and p121
ARRAY_PKW: Final = PkwDialect(
    answers={
        **PLAIN_PKW.answers,
        TaskId.READ_ARRAY: (ReplyId.ARRAY_WORD, ReplyId.ARRAY_LONG),
        TaskId.WRITE_ARRAY_WORD: (ReplyId.ARRAY_WORD,),
        TaskId.WRITE_ARRAY_LONG: (ReplyId.ARRAY_LONG,),
    },
    errors=PLAIN_PKW.errors,
)
#: Danfoss VLT: a refusal is 7000 0000h and its error; VLT PROFIBUS DP operating instructions MG.33.C4.02 p61
VLT_PKW: Final = PkwDialect(answers=ARRAY_PKW.answers, errors=PLAIN_PKW.errors, bare_errors=True)
#: SINAMICS and MICROMASTER 4: arrays by index, numbers up to 63999 by pages; replies, G110M operating instructions p198
PAGED_PKW: Final = PkwDialect(answers=ARRAY_PKW.answers, errors={**PLAIN_PKW.errors, **SIEMENS}, layout=PagedPkw)


class Exchange(Struct, eq=False):
    """An order. ``reply`` is set when the drive has answered; ``stray``: the last reply to another order."""

    order: Pkw
    reply: Pkw | None = None
    stray: Pkw | None = None


class PkwChannel:
    """The handshake at the master's end: one order at a time, the others queue."""

    #: the eight octets to send now
    octets: bytes = ZEROS
    #: :meth:`step` has to be called in every cycle
    busy: bool = False

    def __init__(self, dialect: PkwDialect, times: CycleTimes) -> None:
        self._dialect = dialect
        #: clock and settle time of the drive core
        self.times = times
        self._queue: deque[Exchange] = deque()
        self.reset()

    def replied(self, order: Pkw, label: str, deadline: int) -> Steps[Pkw]:
        """The reply to an order, right or wrong. Raises CommandError of kind timeout."""
        exchange = self.submit(order)
        try:
            while exchange.reply is None:
                if self.times.now >= deadline:
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
        return f"parameter {reply.pnu} index {reply.ind} (reply {reply.id:d})"

    #: names of the order ids
    orders: type[IntEnum] = TaskId
    #: names of the reply ids
    replies: type[IntEnum] = ReplyId
    #: reply id of an error
    error_reply: int = ReplyId.ERROR

    def fields(self, octets: bytes, *, order: bool, find: FindSpec) -> dict[str, object]:
        """See :class:`ParameterChannel`. AK, PNU, IND and PWE have PROFIdrive's names; PWE in hex."""
        pkw = self._dialect.layout.parse(octets)
        if not pkw.id:
            return {}
        names = self.orders if order else self.replies
        known = pkw.id in names.__members__.values()
        what = names(pkw.id).name.lower().replace("_", " ") if known else f"{'order' if order else 'reply'} {pkw.id:d}"
        found: dict[str, object] = {"AK": pkw.id, "what": what, "PNU": pkw.pnu, "IND": pkw.ind}
        found["PWE"] = f"0x{pkw.pwe:08x}"
        spec = find(pkw.pnu, pkw.ind)
        label = f"{pkw.pnu}[{pkw.ind}]" if spec is None else spec.label
        found["name"] = None if spec is None else spec.name
        text = f"{what} {label}"
        if not order and pkw.id == self.error_reply:
            number = self.error_number(pkw)
            found["error"] = f"error {number}, {self._dialect.error_text(number)}"
            return found | {"text": f"{text}: {found['error']}"}
        reads = order and "READ" in what.upper()
        bits = 32 if "long" in what else 16
        if spec is not None and not reads and (spec.type is not ParamType.F32 or bits == 32):
            value = spec.to_value(spec.from_wire(pkw.pwe, bits))
            found["value"] = value
            if spec.unit:
                found["unit"] = spec.unit
            text += f" = {value:g}" + (f" {spec.unit}" if spec.unit else "")
        elif not reads:
            text += f" = {pkw.pwe:#x}"
        return found | {"text": text}

    def error_number(self, reply: Pkw) -> int:
        """The number in a negative reply."""
        return reply.pwe & 0xFFFF

    def submit(self, order: Pkw) -> Exchange:
        """Queue an order; the caller polls the exchange's ``reply``."""
        exchange = Exchange(order)
        self._queue.append(exchange)
        self.busy = True
        return exchange

    def cancel(self, exchange: Exchange) -> None:
        """Cancel an order; harmless when it is done."""
        if exchange is self._active:
            self._withdraw()
            self._quiet_until = self.times.now + self.times.settle_ns
        elif exchange in self._queue:
            self._queue.remove(exchange)
            self._note_busy()

    def reset(self) -> None:
        """The slave left data exchange: both ends start at 0 again."""
        self._queue.clear()
        self._active: Exchange | None = None
        self._release = False  # our order is withdrawn, the drive's reply is not yet 0
        self._quiet_until = 0  # a 0 before this may be older than an order that was withdrawn unanswered
        self._last: Pkw | None = None
        self.octets = ZEROS
        self.busy = False

    def step(self, inputs: bytes, now: int) -> None:
        """Process the channel's octets in ``inputs`` (the first eight) and advance the handshake."""
        reply = self._dialect.layout.parse(inputs)
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
        self._note_busy()

    def _note_busy(self) -> None:
        self.busy = self._release or self._active is not None or bool(self._queue)

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
        if self._dialect.bare_errors and reply.id == ReplyId.ERROR and not reply.pnu:
            return True
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


class PkwCore(CycleTimes, Protocol):
    """A drive plugin with parameters by PKW."""

    def resolve(self, key: ParamKey) -> ParamRef:
        """Find the parameter that a user has named. Raises CommandError."""

    def written(self, ref: ParamRef) -> None:
        """The drive has taken a write."""


class PkwAccess(PkwChannel, ParameterChannel):
    """Parameters by PKW, of the plugin ``core``."""

    def __init__(self, dialect: PkwDialect, core: PkwCore) -> None:
        super().__init__(dialect, core)
        self._core = core
        self._stored_writes = StoredWrites()

    def read(self, key: ParamKey, deadline: int) -> Steps[dict[str, object]]:
        ref = self._core.resolve(key)
        return self._outcome(ref, (yield from self._read(ref, deadline)))

    def write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        """Write one parameter; of an unknown one the type is read first and ``value`` is the integer on the wire."""
        ref = self._core.resolve(key)
        raw = check_write(ref.spec, ref.label, value)
        if ref.spec is not None and raw is not None:
            pwe, long = ref.spec.pwe(raw), ref.spec.type.wide
        else:
            reply = yield from self._read(ref, deadline)
            long = reply.id in (ReplyId.LONG, ReplyId.ARRAY_LONG)
            pwe = _raw(ref, value, long)
        if ref.array:
            kind = TaskId.WRITE_ARRAY_LONG if long else TaskId.WRITE_ARRAY_WORD
        else:
            kind = TaskId.WRITE_LONG if long else TaskId.WRITE_WORD
        if not key.ram:
            self._stored_writes.admit((ref.pnu, ref.ind), ref.label, self._core.now, ref.spec)
        reply = yield from self._exchange(self._dialect.layout(kind, ref.pnu, ref.ind, pwe), ref, deadline)
        self._core.written(ref)
        return self._outcome(ref, reply, value)

    def _read(self, ref: ParamRef, deadline: int) -> Steps[Pkw]:
        order = TaskId.READ_ARRAY if ref.array else TaskId.READ
        return self._exchange(self._dialect.layout(order, ref.pnu, ref.ind), ref, deadline)

    def _exchange(self, order: Pkw, ref: ParamRef, deadline: int) -> Steps[Pkw]:
        if order.id not in self._dialect.answers:
            raise CommandError("usage", f"{ref.label}: the drive has no order {order.id:d} in its parameter channel")
        busy: CommandError | None = None
        while True:
            try:
                reply = yield from self.replied(order, ref.label, deadline)
            except CommandError as late:
                raise busy or late from None
            if reply.id != ReplyId.ERROR:
                break
            number = self.error_number(reply)
            text = self._dialect.error_text(number)
            refusal = CommandError("parameter", f"{ref.label}: error {number}, {text}", number)
            again = self.times.now + RETRY_NS
            if number not in self._dialect.busy or again >= deadline:
                raise refusal
            busy = refusal
            while self.times.now < again:
                yield
        if reply.id == ReplyId.NO_CONTROL:
            raise CommandError("parameter", f"{ref.label}: the bus has no control over the parameters (reply 8)")
        if reply.id not in self._dialect.answers[order.id]:
            raise CommandError("parameter", f"{ref.label}: reply {reply.id:d} does not answer order {order.id:d}")
        return reply

    def _outcome(self, ref: ParamRef, reply: Pkw, written: float = 0) -> dict[str, object]:
        """The id of the reply decides its size, a word or a double word, also if the table has the other type.
        ``written``: the value of a write; a negative one says that a parameter of unknown type has a sign."""
        spec = ref.spec
        bits = 32 if reply.id in (ReplyId.LONG, ReplyId.ARRAY_LONG) else 16
        raw = reply.pwe & (1 << bits) - 1
        if written < 0 and raw >> bits - 1:
            raw -= 1 << bits
        value: int | float = raw
        if spec is not None:
            raw = spec.from_wire(reply.pwe, bits)
            misfit = spec.misfit(raw, real=spec.type is ParamType.F32 and bits == 32)
            if misfit is not None and spec.type is ParamType.F32:
                raise CommandError("parameter", f"{ref.label}: {misfit}")
            self.remark(ref.label, misfit)
            value = spec.to_value(raw)
        return outcome(spec, ref.pnu, value, raw, ref.data_set)


def _raw(ref: ParamRef, value: float, long: bool) -> int:
    bits = 32 if long else 16
    if value != int(value) or not -(1 << bits - 1) <= value < 1 << bits:
        raise CommandError("usage", f"{ref.label}: its scale is unknown here, give the {bits}-bit integer on the wire")
    return int(value) & (1 << bits) - 1


class PkwServer:
    """The drive's end. ``handler`` carries an order out and returns the reply id and PWE.

    With ``zero_between`` an order is carried out once and its reply held until the order is 0. Without it an order
    acts when it changes, and a read (ids in ``reads``) returns the present value in every call. ``refuse`` is called
    once for each new order: the negative reply to it, None if it is carried out.
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
        if octets == ZEROS:  # no order, in every dialect
            if self._last != ZEROS:
                self.reset()
            return ZEROS
        order = self._dialect.layout.parse(octets)
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
        if self._dialect.bare_errors and reply == ReplyId.ERROR:
            order = self._dialect.layout(reply, 0)
        self._reply = order._replace(id=reply, pwe=pwe).build()
        return self._reply
