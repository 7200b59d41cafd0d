"""The order of polls: the slaves with Data_Exchange in a round, and the slave with the next service.

A slave of ``every`` n has a turn in each n-th cycle (:mod:`dpstack.dp.rate_groups`). If that cycle is left out, the
slave has its turn in the next cycle instead; its later turns stay where they were.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence

from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.settings import MasterContext
from dpstack.dp.master.slave_handler import AWAY, SlaveHandler
from dpstack.dp.process_image import SlaveImage
from dpstack.dp.rate_groups import offsets, round_interval_ns
from dpstack.dp.slave_params import SlaveParams
from dpstack.dp.telegram_times import share
from dpstack.params import BusParams


class RateTurns:
    """Turns of the slaves that do not exchange data in every cycle (``every`` > 1).

    ``number`` is the number of a fixed cycle, or of a round while rounds run free.
    """

    def __init__(self, params: BusParams) -> None:
        self._params = params
        self._setups: Sequence[SlaveParams] = ()
        #: address -> (every, offset), only of slaves with ``every`` > 1
        self._groups: dict[int, tuple[int, int]] = {}
        #: whether any slave does not exchange data in every cycle
        self.has_slower_slaves = False
        #: address -> number of the cycle in which the slave has its next turn
        self._next_turn: dict[int, int] = {}

    def arrange(self, setups: Sequence[SlaveParams]) -> None:
        """Give every slave of ``setups`` its offset, in data exchange or not. Slaves of the last call keep theirs."""
        if setups == self._setups:
            return
        self._setups = setups
        kept = {address: offset for address, (_, offset) in self._groups.items()}
        chosen = offsets((share(self._params, s) for s in setups), kept)
        groups = {s.address: (s.every, chosen[s.address]) for s in setups if s.every > 1}
        self._next_turn = {a: at for a, at in self._next_turn.items() if groups.get(a) == self._groups[a]}
        self._groups = groups
        self.has_slower_slaves = bool(groups)

    def due(self, address: int, number: int) -> bool:
        """Whether the slave at ``address`` has a turn in cycle ``number``, or missed a turn before it."""
        group = self._groups.get(address)
        if group is None:
            return True
        at = self._next_turn.get(address)
        if at is None:
            every, offset = group
            at = self._next_turn[address] = number + (offset - number) % every
        return number >= at

    def had_turn(self, address: int, number: int) -> None:
        """The slave at ``address`` had its turn in cycle ``number``."""
        group = self._groups.get(address)
        if group is not None:
            every, offset = group
            self._next_turn[address] = number + 1 + (offset - number - 1) % every

    def left_exchange(self, address: int) -> None:
        """The slave at ``address`` left data exchange: drop a missed turn; the next one follows from its offset."""
        self._next_turn.pop(address, None)


class Turns:
    """The slaves of a master in their order of polling. ``exchanging``: slaves in data exchange, by address;
    ``images``: their process images.

    ``interval``: the shortest time in ns between the beginnings of two rounds. It follows from the Min_Slave_Interval
    of the slaves that are not absent, in fault or deactivated (docs/reference/protocol.md#min-slave-interval).
    ``interval_all``: the same for a round in which every slave has a turn.

    ``absent_divisor``: while any slave is in data exchange, polls of absent slaves take at most 1/absent_divisor of the
    bus time; 0 = no limit. Long polls (:mod:`dpstack.dp.master.retry_timing`) have a budget of their own with the same
    share: after a long poll only slaves without a long poll so far may have one, until the pause for it is over. So
    long polls delay other slaves no more than short polls do. A slave that has just become absent need not wait for
    that: its first long poll costs no more time than its last unanswered Data_Exchange.
    """

    def __init__(self, context: MasterContext, handlers: Mapping[int, SlaveHandler]) -> None:
        self.rates = RateTurns(context.params)
        self.exchanging: list[SlaveHandler] = []
        self.images: dict[int, SlaveImage] = {}
        self.interval = self.interval_all = 0
        self._absent_divisor = context.settings.absent_divisor
        self._handlers = handlers
        self._services: deque[SlaveHandler] = deque()
        self._must_sort = True
        self._last_had_diag = False  # the slave chosen last by `next` had a diagnosis to be read
        #: no poll, and no second long poll, of an absent slave before this time in ns
        self._absent_poll_from = self._long_poll_from = 0
        self._absent_pause = 0  # ns, for the last short poll of an absent slave
        #: slaves without a service for the rest of this cycle: theirs did not fit in, and the time left only gets
        #: shorter
        self._postponed: set[SlaveHandler] = set()

    @property
    def candidates(self) -> int:
        """The number of slaves that may want a service."""
        return len(self._services)

    def request_sort(self) -> None:
        """Sort before the next round, because a slave was added or removed, or changed its state."""
        self._must_sort = True

    def forget(self, handler: SlaveHandler) -> None:
        """A slave was removed: it gets no further service in this round."""
        self._must_sort = True
        if handler in self._services:
            self._services.remove(handler)

    def begin_round(self) -> None:
        """Call at the begin of a round: sorts if necessary; postponed services are possible again."""
        if self._postponed:
            self._postponed.clear()
        if self._must_sort:
            self.sort()

    def sort(self) -> None:
        """Sort the slaves if :meth:`request_sort` was called.

        New slaves with a diagnosis to be read come first in the order of services, because the master answers DH at
        once (docs/reference/protocol.md#answers-to-data_exchange).
        """
        if not self._must_sort:
            return
        self._must_sort = False
        by_address = [self._handlers[address] for address in sorted(self._handlers)]
        self.rates.arrange([h.setup for h in by_address])
        self.exchanging = [h for h in by_address if h.state is SlaveState.DATA_EXCHANGE]
        self.images = {h.setup.address: h.image for h in self.exchanging}
        wanting = [h for h in by_address if h.state is not SlaveState.DATA_EXCHANGE or h.diag_due]
        wanted = set(wanting)
        kept = [h for h in self._services if h in wanted]
        known = set(kept)
        new = [h for h in wanting if h not in known]
        urgent = [h for h in new if h.diag_due]
        self._services = deque(urgent + kept + [h for h in new if not h.diag_due])
        present = [h.setup for h in by_address if h.state not in AWAY]
        self.interval = round_interval_ns((s.every, s.min_slave_interval_ns) for s in present)
        self.interval_all = max((s.min_slave_interval_ns for s in present), default=0)
        for handler in wanting:
            if handler.state is not SlaveState.DATA_EXCHANGE:
                self.rates.left_exchange(handler.setup.address)

    def due(self, number: int) -> list[SlaveHandler]:
        """The slaves in data exchange that have a turn in cycle ``number``."""
        if not self.rates.has_slower_slaves:
            return self.exchanging
        return [h for h in self.exchanging if self.rates.due(h.setup.address, number)]

    def postpone(self, handler: SlaveHandler) -> None:
        """Its service does not fit in before the next cycle: make it the first one after that cycle."""
        self._postponed.add(handler)
        if handler in self._services:
            self._services.remove(handler)
            self._services.appendleft(handler)

    def next(self, now: int, blocked: Callable[[int], bool], *, room: bool = True) -> SlaveHandler | None:
        """The next slave that wants a service and whose address is not ``blocked``.

        Slaves have services in turn, with two exceptions. While any slave is in data exchange, a bring-up under way
        goes first, because the watchdog of that slave runs. A slave that always has a diagnosis to be read gets at most
        every other service. ``room`` False: part of the time before the next cycle is used up already, so no long poll
        is chosen; it may need all of that time.
        """
        chosen: SlaveHandler | None = None
        for handler in self._services:
            if chosen is None:
                can_replace = True
            else:  # look on only for a better one: of 32 slaves that come up together, each is asked once a round
                can_replace = self._last_had_diag and chosen.diag_due
                if not can_replace and not self.exchanging:
                    break
            goes_first = bool(self.exchanging) and handler.under_way
            if not goes_first and (not can_replace or (chosen is not None and handler.diag_due)):
                continue
            if not self._is_eligible(handler, now, blocked) or (not room and self.is_long_poll(handler, now)):
                continue
            chosen = handler
            if goes_first:
                break
        if chosen is not None:
            self._last_had_diag = chosen.diag_due
            self._services.remove(chosen)
            self._services.append(chosen)
        return chosen

    def _is_eligible(self, handler: SlaveHandler, now: int, blocked: Callable[[int], bool]) -> bool:
        """Whether ``handler`` may have a service now.

        An absent slave may not while polls of absent slaves have used up their share of the bus time. A slave added at
        the address of a removed one may not (``blocked``) until the removed one is unlocked.
        """
        if not handler.wants_service(now) or (handler.state is SlaveState.OFFLINE and now < self._absent_poll_from):
            return False
        return handler not in self._postponed and not blocked(handler.setup.address)

    def is_long_poll(self, handler: SlaveHandler, now: int) -> bool:
        """Whether a poll of ``handler`` at ``now`` is a long one."""
        return handler.is_long_poll_due(only_first=now < self._long_poll_from)

    def count_poll(self, handler: SlaveHandler, took_ns: int, now: int, *, long: bool) -> None:
        """Count the time ``took_ns`` of a poll against the share of the absent slaves, if ``handler`` is absent."""
        if handler.state is SlaveState.OFFLINE and self._absent_divisor and self.exchanging:
            pause = took_ns * self._absent_divisor
            if long:
                self._long_poll_from = now + pause
            else:
                self._absent_pause = pause
            self._absent_poll_from = now + self._absent_pause
