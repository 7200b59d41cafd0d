"""The simulated slaves of one port that find the baud rate by themselves: one receiver, so one search for all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dpstack.dp.slave.baud_control import BaudState, BaudWatch
from dpstack.dp.slave.searching import Searching
from dpstack.fdl.baud_search import BaudNotFound
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.trace import Event
from dpstack.units import BAUD_RATES, baud_text


@dataclass(frozen=True, slots=True, kw_only=True)
class PortBaudChanged(Event):
    """The watch of a port's slaves over the rate reached another state; ``baud`` in bit/s, None while searched."""

    state: BaudState
    baud: int | None

    @property
    def text(self) -> str:
        """Which, and the rate."""
        if self.baud is None:
            return f"{self.state.value}: the bus fell silent, searching for the baud rate"
        return f"{self.state.value} at {baud_text(self.baud)}"


class SearchingPort(Searching):
    """The machine of one port around ``line``: deaf to the bus until the rate is found, among ``rates`` in bit/s.

    ``watched`` tells whether the watchdog of any of the slaves runs. ``slack_ns``, ``settle_ns``: see
    :class:`BaudWatch`. ``lost`` is told the time when the rate is lost and searched again.
    """

    def __init__(
        self,
        line: Multidrop,
        watched: Callable[[], bool],
        *,
        rates: Sequence[int] = BAUD_RATES,
        slack_ns: int = 0,
        settle_ns: int = 0,
        lost: Callable[[int], None] = lambda now: None,
    ) -> None:
        super().__init__(line)
        self._tell_lost = lost
        self._watch = BaudWatch(
            watched, self._found, self._reached, rates=rates, slack_ns=slack_ns, settle_ns=settle_ns
        )

    def in_vain(self, now: int) -> BaudNotFound | None:
        """Why no rate was recognised up to now; None when one was."""
        return self._watch.search(now).in_vain(now) if self._watch.searching else None

    # --- for the watch ---
    def _lost(self, now: int) -> None:
        self._tell_lost(now)

    def _told(self, state: BaudState, baud: int | None, now: int) -> Event:
        return PortBaudChanged(t_ns=now, state=state, baud=baud)
