"""The simulated slaves of one port that find the baud rate by themselves: one receiver, so one search for all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dpstack.dp.baud_watch import BaudState, BaudWatch
from dpstack.fdl.autobaud import BaudNotFound
from dpstack.fdl.multidrop import Multidrop
from dpstack.machine import LineDown, LineUp, RateRefused
from dpstack.params import BusParams
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


class SearchingPort:
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
        lost: Callable[[int], None] | None = None,
    ) -> None:
        self._line = line
        self._lost = lost
        self._events: list[Event] = []
        self._watch = BaudWatch(
            watched, self._found, self._reached, rates=rates, slack_ns=slack_ns, settle_ns=settle_ns
        )

    @property
    def state(self) -> BaudState:
        """Of the watch over the rate."""
        return self._watch.state

    @property
    def baud(self) -> int:
        """The rate to listen at now, in bit/s."""
        return self._watch.baud

    def in_vain(self, now: int) -> BaudNotFound | None:
        """Why no rate was recognised up to now; None when one was."""
        return self._watch.search(now).in_vain(now) if self._watch.searching else None

    # --- Machine ---
    def receive(self, chunk: bytes, now: int) -> None:
        """Octets from the line, at whatever rate it listens."""
        if self._watch.searching:
            self._watch.octets(chunk, now)
            return
        stats = self._line.decoder_stats
        telegrams = stats.telegrams
        self._line.receive(chunk, now)
        if stats.telegrams > telegrams:
            self._watch.heard(now)

    def sent(self, at: int) -> None:
        """An answer leaves the line at ``at``."""
        self._line.sent(at)

    def wake(self, now: int) -> None:
        """Judge the search or the silence; the applications have their time in every state."""
        self._line.wake(now)
        self._watch.wake(now)

    def take_tx(self, now: int) -> bytes | None:
        """The answer under way; none while the rate is not known."""
        return None if self._watch.searching else self._line.take_tx(now)

    def wake_at(self) -> int:
        """The slaves' deadlines, those of the search, the end of patience with silence."""
        return min(self._line.wake_at(), self._watch.wake_at())

    def take_events(self) -> list[Event]:
        """Its own events and those of all slaves."""
        events, self._events = self._events, []
        return events + self._line.take_events()

    def command(self, command: object, now: int) -> None:
        """:class:`LineDown`, :class:`LineUp`, :class:`RateRefused` from the driver; UsageError on anything else."""
        if isinstance(command, RateRefused):
            self._watch.refused(now)
            return
        self._line.command(command, now)
        if isinstance(command, (LineDown, LineUp)):
            self._watch.begin_anew()

    # --- inside ---
    def _found(self, params: BusParams, now: int) -> None:
        self._line.set_params(params)

    def _reached(self, state: BaudState, now: int) -> None:
        if state is BaudState.SEARCH:
            self._line.set_params(self._line.params)  # what is pending is forgotten
            if self._lost is not None:
                self._lost(now)
        baud = None if state is BaudState.SEARCH else self._watch.baud
        self._events.append(PortBaudChanged(t_ns=now, state=state, baud=baud))
