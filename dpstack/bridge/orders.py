"""``Orders``: the orders that connectors may give to the run, with an allow list, an age, and one at a time a slave."""

from __future__ import annotations

import asyncio
import difflib
import math
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from enum import Enum, auto
from typing import Final, Literal, NamedTuple, cast

from dpstack.bridge.connector import Tell
from dpstack.errors import ConfigError, DpError, SlaveError
from dpstack.plant.nodes import OfferedOrder
from dpstack.plant.orders import HALTS, Argument, DriveOrder, RefusedOrder, SetOutputs
from dpstack.plant.quality import Value, clean
from dpstack.plant.tree import PlantTree
from dpstack.text import iso_time
from dpstack.trace import Severity

#: age of an order in s, as long as the configuration does not say otherwise
MAX_AGE_S: Final = 2.0
#: orders that wait or are carried out: of one slave
MOST_OF_A_SLAVE: Final = 16
#: orders that are remembered, so that none is carried out twice
_MOST_KNOWN: Final = 1000
#: s after which an order that has no result counts as refused
_LONGEST_S: Final = 90.0


class Refusal(Enum):
    """Kind of the reason why an order was refused, for status codes."""

    #: the run refuses it, or has changed meanwhile
    STATE = auto()
    NOT_ALLOWED = auto()
    #: the plant has no such order
    UNKNOWN = auto()
    TYPE = auto()
    #: too old, ahead of the clock, or given before
    TIME = auto()
    NO_EXCHANGE = auto()
    TOO_MANY = auto()
    NO_RESULT = auto()


class OrderResult(NamedTuple):
    """Result of an order; ``reason``: why it was refused, printable, and its kind."""

    name: str
    result: Literal["done", "refused"]
    reason: str = ""
    kind: Refusal = Refusal.STATE


class Batch:
    """Orders that came in one message, and are carried out one after the other. The age of each counts from when the
    message came; a halt that comes by another message ends those behind it, too. See :meth:`Orders.batch`."""

    def __init__(self, came: float, halts: Counter[int]) -> None:
        self.came = came
        self.halts = halts


class _Age(NamedTuple):
    """Times by which an order is too old. ``came``: when its message came, by the clock of the loop; see
    :meth:`Orders.give` for the others.

    It counts from ``made_at`` by the clock of the computer, and from ``came`` as well: clocks that differ, or are set
    meanwhile, let no order wait for longer. Without ``made_at`` it counts from ``late_s`` before ``came``.
    """

    came: float
    made_at: float | None = None
    late_s: float | None = None


class _RefusedError(Exception):
    """The order is not carried out; its text is the reason."""

    def __init__(self, reason: str, kind: Refusal = Refusal.STATE) -> None:
        super().__init__(reason)
        self.kind = kind


class _ChangedError(_RefusedError):
    def __init__(self) -> None:
        super().__init__("the configuration of the bus has changed meanwhile")


class Orders:
    """Gives orders of ``tree`` to the run, which has ``carry_out``.

    An order of :data:`~dpstack.plant.orders.HALTS` waits for no other order, and none that waits is carried out after
    it. ``allow``: names of orders (``valves.lamp``, ``hoist.start``), or all of a slave (``hoist.*``); see
    :func:`check_allowed`. ``now``: the clock of the computer in s since 1970. ``tell`` takes a remark about each order
    that is carried out, ``refused`` each that is not; ``origin``: the connector that hands them in.
    """

    def __init__(
        self,
        tree: PlantTree,
        carry_out: Callable[[SetOutputs | DriveOrder], Awaitable[object]],
        allow: Sequence[str],
        *,
        now: Callable[[], float] = time.time,
        max_age_s: float = MAX_AGE_S,
        tell: Tell | None = None,
        refused: Callable[[RefusedOrder], object] | None = None,
        origin: str = "",
    ) -> None:
        self._tree = tree
        self._carry_out = carry_out
        self._allow = frozenset(allow)
        self._now = now
        self._max_age_s = max_age_s
        self._tell = tell
        self._refused = refused
        self._origin = origin
        self._known: dict[tuple[str, float], None] = {}
        self._waiting: Counter[int] = Counter()
        self._turns: dict[int, asyncio.Lock] = {}
        #: number of the halts of each slave
        self._halts: Counter[int] = Counter()
        self._halting: set[asyncio.Task[None]] = set()
        #: orders that came before this time of the loop are refused
        self._recalled_at = -math.inf

    def recall(self, *, for_ever: bool) -> None:
        """The connector is lost: refuse the orders that have come by now, and with ``for_ever`` all others. A halt that
        has begun goes on."""
        self._recalled_at = math.inf if for_ever else asyncio.get_running_loop().time()

    def sets_output(self, name: str) -> bool:
        """Whether :meth:`give_outputs` takes the order ``name``."""
        order = self._tree.orders.get(name)
        return order is not None and bool(order.output)

    @property
    def takes_any(self) -> bool:
        """Whether ``allow_commands`` lists any order."""
        return bool(self._allow)

    @property
    def allowed(self) -> tuple[OfferedOrder, ...]:
        """The orders of the plant that :meth:`give` takes."""
        return tuple(order for order in self._tree.orders.values() if is_allowed(self._allow, order.name))

    def takes(self, order: OfferedOrder) -> bool:
        """Whether ``order`` is one of :attr:`allowed`, without a search."""
        return self._tree.orders.get(order.name) == order and is_allowed(self._allow, order.name)

    def batch(self) -> Batch:
        """A message with several orders has come now: hand the result over to each :meth:`give`."""
        return Batch(asyncio.get_running_loop().time(), self._halts.copy())

    async def give(
        self,
        wanted: str | OfferedOrder,
        value: object = None,
        *,
        made_at: float | None,
        late_s: float | None = None,
        batch: Batch | None = None,
        by: str = "",
        order_time: str = "",
    ) -> OrderResult:
        """Carry out the order ``wanted`` with its argument ``value``, and wait for the result. ``wanted`` is the name
        of the order (``SLAVE.NAME``), or an order of :attr:`allowed` whose caller has checked the type of ``value``.

        ``made_at``: the time of its sender in s since 1970; None if it has none. ``late_s``: the s that its
        connection has delivered it late, for one without ``made_at``. ``by``: its user, if it has one; ``order_time``:
        ``made_at`` as the sender wrote it, if it is a text. Its age (see :class:`_Age`) is judged when it
        comes and once more right before it is carried out. Raises nothing but the cancellation of its caller, which
        ends the order as far as the run can take it back; a halt that has begun goes on.
        """
        name = _name(wanted)
        batch = batch or self.batch()
        age = _Age(batch.came, made_at, late_s)
        who = _Sender(by, made_at, order_time)
        try:
            order, argument = self._judge(wanted, value, age)
            if order.operation in HALTS:
                self._halts[order.slave] += 1
                batch.halts[order.slave] += 1  # a start behind a stop of the same message is meant
                with self._counted(order.slave, spare=MOST_OF_A_SLAVE):
                    await self._carry_on(order.typed(argument))
            else:
                await self._carry_in_turn([order], order.typed(argument), age, batch)
        except Exception as error:  # whatever the run does: the sender gets a result
            return self._reported(_refused(name, error), who)
        return self._reported(OrderResult(name, "done"), who)

    async def give_outputs(
        self,
        given: Sequence[tuple[str | OfferedOrder, object]],
        *,
        made_at: float | None,
        late_s: float | None = None,
        batch: Batch | None = None,
        by: str = "",
        order_time: str = "",
    ) -> list[OrderResult]:
        """Set outputs of one slave, by name and value, so that all of them change in one Data_Exchange. Each is judged
        as by :meth:`give`, and one that is refused leaves the others; but the run takes those as one order, and refuses
        all if it refuses one. Results and the rest: as of :meth:`give`."""

        batch = batch or self.batch()
        age = _Age(batch.came, made_at, late_s)
        who = _Sender(by, made_at, order_time)
        results: list[OrderResult | None] = []
        orders: list[OfferedOrder] = []
        values: dict[str, Argument] = {}
        for wanted, value in given:
            try:
                order, argument = self._judge(wanted, value, age)
                if not order.output or argument is None or (orders and order.slave != orders[0].slave):
                    raise _ChangedError
                values[order.output] = argument
            except Exception as error:
                results.append(self._reported(_refused(_name(wanted), error), who))
            else:
                orders.append(order)
                results.append(None)
        failed: Exception | None = None
        try:
            if orders:
                await self._carry_in_turn(orders, orders[0].sets(orders[0].slave, values), age, batch)
        except Exception as error:
            failed = error
        rest = iter(OrderResult(one.name, "done") if failed is None else _refused(one.name, failed) for one in orders)
        return [self._reported(next(rest), who) if one is None else one for one in results]

    def refuse(self, name: str, reason: str, *, by: str = "", order_time: str = "") -> None:
        """Report an order that its connector has refused itself; texts may be of a stranger."""
        if self._refused is not None:
            self._refused(RefusedOrder(name, reason, f"{self._origin} ({by})" if by else self._origin, order_time))

    def _judge(self, wanted: str | OfferedOrder, value: object, age: _Age) -> tuple[OfferedOrder, Argument | None]:
        """An order that comes, and its argument. Raises _RefusedError."""
        order = self._find(_name(wanted))
        self._judge_slave(order)
        self._judge_age(age)
        if isinstance(wanted, str):
            try:
                argument = order.argument(_plain(value))
            except ValueError as error:
                raise _RefusedError(str(error), Refusal.TYPE) from None
        elif wanted == order:
            argument = cast("Argument | None", value)  # of the type of the order, see `give`
        else:
            raise _ChangedError
        self._refuse_twice(order.name, age.made_at, halts_drive=order.operation in HALTS)
        return order, argument

    async def _carry_in_turn(
        self, orders: Sequence[OfferedOrder], typed: SetOutputs | DriveOrder, age: _Age, batch: Batch
    ) -> None:
        """Carry out ``typed``, which stands for ``orders`` to one slave, when its turn has come."""
        slave = orders[0].slave
        with self._counted(slave):
            async with self._turns.setdefault(slave, asyncio.Lock()):
                if any(self._find(order.name) != order for order in orders):
                    raise _ChangedError
                if self._halts[slave] != batch.halts[slave]:
                    raise _RefusedError("a later order has stopped the drive meanwhile")
                self._judge_slave(orders[0])
                self._judge_age(age)
                await self._carry(typed)

    async def _carry_on(self, typed: SetOutputs | DriveOrder) -> None:
        """Carry out a halt to its end, also if its sender has gone meanwhile."""
        task = asyncio.ensure_future(self._carry(typed))
        self._halting.add(task)
        task.add_done_callback(self._halted)
        await asyncio.shield(task)

    def _halted(self, task: asyncio.Task[None]) -> None:
        self._halting.discard(task)
        if not task.cancelled():
            task.exception()  # asyncio reports one that nobody has asked for

    async def _carry(self, typed: SetOutputs | DriveOrder) -> None:
        try:
            async with asyncio.timeout(_LONGEST_S) as limit:
                await self._carry_out(typed)
        except TimeoutError:
            if not limit.expired():
                raise
            raise _RefusedError(f"no result after {_LONGEST_S:g} s", Refusal.NO_RESULT) from None

    def _find(self, name: str) -> OfferedOrder:
        """The order ``name``. Raises _RefusedError for one that is not allowed, or that the plant does not have."""
        plant = self._tree.plant
        if plant is None:
            raise _RefusedError("the bus is not known yet")
        if plant.read_only is not False:
            raise _RefusedError("this run is read only: it takes no orders", Refusal.NOT_ALLOWED)
        if not is_allowed(self._allow, name):
            raise _RefusedError("it is not in allow_commands", Refusal.NOT_ALLOWED)
        order = self._tree.orders.get(name)
        if order is None:
            raise _RefusedError("the plant has no such order", Refusal.UNKNOWN)
        return order

    def _judge_slave(self, order: OfferedOrder) -> None:
        """Raises _RefusedError if the slave is not in data exchange: it would get the order when it is back,
        whenever that is. A halt goes to the run, which keeps it for that moment: else the drive would go on then."""
        if order.operation not in HALTS and not self._tree.is_alive(order.slave):
            raise _RefusedError("the slave is not in data exchange", Refusal.NO_EXCHANGE)

    def _judge_age(self, age: _Age) -> None:
        if age.came <= self._recalled_at:
            raise _RefusedError("its connector has ended, or hung, since the order came")
        waited = asyncio.get_running_loop().time() - age.came
        if age.made_at is not None:
            by_clocks = self._now() - age.made_at
            if not by_clocks >= -self._max_age_s:
                raise _RefusedError(
                    f"its time is {-by_clocks:.1f} s ahead of the clock of this computer: set the clocks", Refusal.TIME
                )
            if by_clocks > self._max_age_s:
                raise _RefusedError(
                    f"it is {by_clocks:.1f} s old by the clock of this computer; {self._max_age_s:g} s are allowed",
                    Refusal.TIME,
                )
        elif age.late_s is not None:
            waited += age.late_s
        else:
            return
        if waited > self._max_age_s:
            raise _RefusedError(
                f"it has been on its way for {waited:.1f} s; {self._max_age_s:g} s are allowed", Refusal.TIME
            )

    def _refuse_twice(self, name: str, made_at: float | None, *, halts_drive: bool) -> None:
        if made_at is None:
            return
        # an order is refused for its age before it could be given again with the same time
        now = self._now()
        while self._known and (oldest := next(iter(self._known)))[1] < now - 2 * self._max_age_s:
            del self._known[oldest]
        if self._known and next(iter(self._known))[1] > now + 2 * self._max_age_s:
            # the clock was set back: those of before it are refused for their time, too
            self._known = {one: None for one in self._known if abs(now - one[1]) <= 2 * self._max_age_s}
        if (name, made_at) in self._known:
            raise _RefusedError("an order with this name and time was given already", Refusal.TIME)
        if len(self._known) < _MOST_KNOWN:
            self._known[name, made_at] = None
        elif not halts_drive:
            raise _RefusedError("too many orders have come", Refusal.TOO_MANY)

    @contextmanager
    def _counted(self, slave: int, *, spare: int = 0) -> Iterator[None]:
        if self._waiting[slave] >= MOST_OF_A_SLAVE + spare:
            raise _RefusedError("too many orders to this slave wait", Refusal.TOO_MANY)
        self._waiting[slave] += 1
        try:
            yield
        finally:
            self._waiting[slave] -= 1

    def _reported(self, result: OrderResult, who: _Sender) -> OrderResult:
        if result.result == "refused":
            self.refuse(result.name, result.reason, by=who.by, order_time=who.order_time or time_words(who.made_at))
        elif self._tell is not None:
            self._tell(f"order {result.name}: done", Severity.INFO)
        return result


class _Sender(NamedTuple):
    """See :meth:`Orders.give`. No text is made of an order that is carried out."""

    by: str
    made_at: float | None
    order_time: str


def time_words(made_at: float | None) -> str:
    """``made_at`` (s since 1970) for people; a number that is no time as it is, empty without one."""
    if made_at is None:
        return ""
    try:
        return iso_time(made_at)
    except (ValueError, OverflowError, OSError):
        return repr(made_at)


def _name(wanted: str | OfferedOrder) -> str:
    return clean(wanted) if isinstance(wanted, str) else wanted.name


def _refused(name: str, error: Exception) -> OrderResult:
    """The result of an order that has failed by ``error``."""
    if isinstance(error, _RefusedError):
        return OrderResult(name, "refused", str(error), error.kind)
    if isinstance(error, SlaveError):
        return OrderResult(name, "refused", clean(str(error)), Refusal.NO_EXCHANGE)
    text = str(error) if isinstance(error, DpError) else f"{type(error).__name__}: {error}"
    return OrderResult(name, "refused", clean(text))


def is_allowed(allow: Iterable[str], name: str) -> bool:
    """Whether the order ``name`` is one of ``allow``, as a name or with all of its slave."""
    slave, dot, _ = name.rpartition(".")
    return name in allow or (bool(dot) and f"{slave}.*" in allow)


def check_allowed(allow: Sequence[str], orders: Iterable[str], read_only: Callable[[str], str] | None = None) -> None:
    """Raises ConfigError for a member of ``allow`` that fits none of ``orders``, with the nearest one. ``read_only``:
    says why a value is no order; empty for any other name."""
    names = set(orders)
    known = names | {f"{name.rpartition('.')[0]}.*" for name in names}
    for pattern in allow:
        if pattern not in known:
            near = difflib.get_close_matches(pattern, sorted(known), n=1, cutoff=0.5)
            if read_only is not None and (why := read_only(pattern)):
                raise ConfigError(f"allow_commands: {clean(pattern)!r}: {why}")
            todo = f"did you mean {near[0]!r}?" if near else "write SLAVE.OUTPUT, SLAVE.start for a drive, or SLAVE.*"
            raise ConfigError(f"allow_commands: {clean(pattern)!r} fits no order of this plant; {todo}")


def _plain(value: object) -> Value:
    """``value`` if it is a value of a node. Raises ValueError."""
    if value is None or isinstance(value, (bool, int, float, str, bytes)):
        return value
    raise ValueError(f"a {type(value).__name__} is no value of an order")
