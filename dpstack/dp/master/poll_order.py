"""The order of polls: which slaves have Data_Exchange in a round, and whose service comes next.

While the bus runs the rate groups decide (their offsets: :mod:`dpstack.dp.rate_groups`). A turn that could not be taken
(the cycle was left out) is taken in the next cycle, the one after that in its own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence

from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.settings import MasterContext
from dpstack.dp.master.slave_handler import AWAY, SlaveHandler
from dpstack.dp.rate_groups import offsets, round_interval_ns
from dpstack.dp.slave_params import SlaveParams
from dpstack.dp.telegram_times import share
from dpstack.params import BusParams


class RateTurns:
    """The slaves that are not due in every cycle. Free running the rounds are counted the same way."""

    def __init__(self, params: BusParams) -> None:
        self._params = params
        self._setups: Sequence[SlaveParams] = ()
        #: by address: n and offset, and the number of the next turn
        self._rare: dict[int, tuple[int, int]] = {}
        self._due: dict[int, int] = {}

    def arrange(self, setups: Sequence[SlaveParams]) -> None:
        """The slaves there are, whether they are in data exchange or not; who was there keeps its offset."""
        if setups == self._setups:
            return
        self._setups = setups
        kept = {address: offset for address, (_, offset) in self._rare.items()}
        chosen = offsets((share(self._params, s) for s in setups), kept)
        rare = {s.address: (s.every, chosen[s.address]) for s in setups if s.every > 1}
        self._due = {a: at for a, at in self._due.items() if rare.get(a) == self._rare[a]}
        self._rare = rare

    @property
    def uneven(self) -> bool:
        """Somebody is not due in every cycle."""
        return bool(self._rare)

    def due(self, address: int, number: int) -> bool:
        """Whether the slave at ``address`` has a turn in cycle ``number``, or one it could not take before."""
        spread = self._rare.get(address)
        if spread is None:
            return True
        at = self._due.get(address)
        if at is None:
            every, offset = spread
            at = self._due[address] = number + (offset - number) % every
        return number >= at

    def taken(self, address: int, number: int) -> None:
        """It had its turn in cycle ``number``."""
        spread = self._rare.get(address)
        if spread is not None:
            every, offset = spread
            self._due[address] = number + 1 + (offset - number - 1) % every

    def away(self, address: int) -> None:
        """It left data exchange: when it comes back it takes the next turn of its own."""
        self._due.pop(address, None)


class Turns:
    """The slaves of a master in order. ``exchanging``: those in data exchange, by address.

    ``interval``: the shortest time in ns between the beginnings of two rounds, by the Min_Slave_Interval of those that
    are spoken with (docs/protocol.md#min-slave-interval); ``interval_all``: the same beside a round that leaves nobody
    out. ``absent_divisor``: while any slave is in data exchange, silent polls of absent slaves take at most
    1/absent_divisor of the bus time. Polls of absent slaves that wait with patience have the same share on an account
    of their own: they hold up others no longer than any poll, and the first one of a slave that fell silent costs no
    more than its last exchange. 0 = no limit.
    """

    def __init__(self, context: MasterContext, handlers: Mapping[int, SlaveHandler]) -> None:
        self.rates = RateTurns(context.params)
        self.exchanging: list[SlaveHandler] = []
        self.interval = self.interval_all = 0
        self._absent_share = context.settings.absent_divisor
        self._handlers = handlers
        self._services: deque[SlaveHandler] = deque()
        self._stale = True
        self._fresh = False
        self._poll_from = self._long_from = 0
        self._pause = 0  # after the last poll without patience
        #: whose service does not fit before the next cycle: what is left of this one only gets shorter
        self._held: set[SlaveHandler] = set()

    @property
    def waiting(self) -> int:
        """How many slaves may want a service."""
        return len(self._services)

    def changed(self) -> None:
        """A slave came, went, or reached another state."""
        self._stale = True

    def forget(self, handler: SlaveHandler) -> None:
        """A slave was taken away: nothing more for it in this round."""
        self._stale = True
        if handler in self._services:
            self._services.remove(handler)

    def begin_round(self) -> None:
        """A round follows."""
        if self._held:
            self._held.clear()
        if self._stale:
            self.sort()

    def sort(self) -> None:
        """Sort anew where something changed. Who has a diagnosis waiting comes first: a DH is answered at once
        (docs/protocol.md#answers-to-data_exchange)."""
        if not self._stale:
            return
        self._stale = False
        by_address = [self._handlers[address] for address in sorted(self._handlers)]
        self.rates.arrange([h.setup for h in by_address])
        self.exchanging = [h for h in by_address if h.state is SlaveState.DATA_EXCHANGE]
        wanting = [h for h in by_address if h.state is not SlaveState.DATA_EXCHANGE or h.diag_due]
        wanted = set(wanting)
        kept = [h for h in self._services if h in wanted]
        known = set(kept)
        new = [h for h in wanting if h not in known]
        urgent = [h for h in new if h.diag_due]
        self._services = deque(urgent + kept + [h for h in new if not h.diag_due])
        spoken_with = [h.setup for h in by_address if h.state not in AWAY]  # others hold nobody up
        self.interval = round_interval_ns((s.every, s.min_slave_interval_ns) for s in spoken_with)
        self.interval_all = max((s.min_slave_interval_ns for s in spoken_with), default=0)
        for handler in wanting:
            if handler.state is not SlaveState.DATA_EXCHANGE:
                self.rates.away(handler.setup.address)

    def due(self, number: int) -> list[SlaveHandler]:
        """Who has a turn in cycle ``number``, of those in data exchange."""
        if not self.rates.uneven:
            return self.exchanging
        return [h for h in self.exchanging if self.rates.due(h.setup.address, number)]

    def held_back(self, handler: SlaveHandler) -> None:
        """Its service does not fit before the next cycle: it is the first one after that."""
        self._held.add(handler)
        if handler in self._services:
            self._services.remove(handler)
            self._services.appendleft(handler)

    def next(self, now: int, blocked: Callable[[int], bool], *, room: bool = True) -> SlaveHandler | None:
        """The next slave that wants a service and whose address is not ``blocked``.

        Fairly in turn, but while data are exchanged a bring-up under way goes first (its watchdog runs), and a slave
        that always has a diagnosis waiting takes every other turn at most. ``room`` False: between two cycles something
        was before it, so that a poll with patience waits for the next gap, all of which it may need.
        """
        chosen: SlaveHandler | None = None
        for handler in self._services:
            if not self._may(handler, now, blocked) or (not room and self.waits_long(handler, now)):
                continue
            if handler.under_way and self.exchanging:
                chosen = handler
                break
            if chosen is None or (self._fresh and chosen.diag_due and not handler.diag_due):
                chosen = handler
        if chosen is not None:
            self._fresh = chosen.diag_due
            self._services.remove(chosen)
            self._services.append(chosen)
        return chosen

    def _may(self, handler: SlaveHandler, now: int, blocked: Callable[[int], bool]) -> bool:
        """Absent ones within their share of the bus; nobody before the one removed at its address is unlocked."""
        if not handler.wants_service(now) or (handler.state is SlaveState.OFFLINE and now < self._poll_from):
            return False
        return handler not in self._held and not blocked(handler.setup.address)

    def waits_long(self, handler: SlaveHandler, now: int) -> bool:
        """Whether a poll of ``handler`` now is one with patience."""
        return handler.long_due(spared=now < self._long_from)

    def polled(self, handler: SlaveHandler, took_ns: int, now: int, *, long: bool) -> None:
        """A service to ``handler`` took so long: an absent one's is charged to the share of all absent ones."""
        if handler.state is SlaveState.OFFLINE and self._absent_share and self.exchanging:
            pause = took_ns * self._absent_share
            if long:
                self._long_from = now + pause
            else:
                self._pause = pause
            self._poll_from = now + self._pause
