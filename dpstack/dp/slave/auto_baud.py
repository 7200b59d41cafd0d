"""Slaves that find the baud rate by themselves, as nearly all do.

:class:`Searching` is a machine around a listener, which gets no octets until the rate is found, nor after the rate is
lost. The listener is one station, or all the simulated slaves of one port: these share a receiver, so they share the
search.

The machine listens at one rate after the other (BAUD_SEARCH). Once the rate is found, it watches that telegrams keep
coming (BAUD_CONTROL). With the watchdog of Set_Prm on, this one watches the master instead (DP_MODE). States and
transitions are those of the VPC3+ (docs/reference/protocol.md#baud-search): a watchdog that expires leads back to
BAUD_CONTROL, silence there to BAUD_SEARCH; with the watchdog off losing the rate restarts the search, but the slave
stays in Data_Exchange.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Final

from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave.events import SlaveAppEvent
from dpstack.fdl.baud_search import AutoBaud, BaudFound, BaudNotFound
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Telegram
from dpstack.machine import LineDown, LineUp, RateRefused
from dpstack.params import BusParams
from dpstack.trace import Event
from dpstack.units import NOW, baud_text

#: BAUD_CONTROL gives up after T_TO of a station that is no master: the standard counts 130 as its address
#: (docs/reference/protocol.md#t_to). A live master is never silent for this long; the chips have a register for
#: it.
_NO_MASTER: Final = 130


class BaudState(Enum):
    """The states of the VPC3+'s watchdog."""

    SEARCH = "baud_search"
    CONTROL = "baud_control"
    DP_MODE = "dp_mode"


class Searching(abc.ABC):
    """A machine around ``listener``, which listens at one rate after the other until one is found.

    ``watched`` says whether a watchdog runs behind it. ``lost`` is called with the time when the rate is lost.
    ``rates`` in bit/s. ``slack_ns`` is how late the port may deliver,
    ``settle_ns`` see :class:`AutoBaud`.
    """

    held_up: Final = None

    def __init__(
        self,
        listener: PassiveStation | Multidrop,
        watched: Callable[[], bool],
        *,
        lost: Callable[[int], None],
        rates: Sequence[int],
        slack_ns: int = 0,
        settle_ns: int = 0,
    ) -> None:
        self.state = BaudState.SEARCH
        self._listener = listener
        self._watched = watched
        self._lost = lost
        self._rates = rates
        self._slack_ns = slack_ns
        self._settle_ns = settle_ns
        self._events: list[Event] = []
        self._search: AutoBaud | None = None  # begins with the first call that has a time
        self._rate = max(rates)
        self._last_telegram = 0
        self._control_ns = 0

    @property
    def baud(self) -> int:
        """The rate to listen at now, in bit/s."""
        return self._rate if self._search is None else self._search.baud

    # --- Machine ---
    def receive(self, chunk: bytes, now: int) -> int:
        """Octets from the line, at whatever rate it listens."""
        if self.state is BaudState.SEARCH:
            self._begun(now).receive(chunk, now)
            self._judge_search(now)
        else:
            telegrams = self._listener.decoder_stats.telegrams
            self._listener.receive(chunk, now)
            if self._listener.decoder_stats.telegrams > telegrams:
                self._last_telegram = now
        return self.wake_at()

    def sent(self, at: int) -> int:
        """The answer leaves the line at ``at``."""
        self._listener.sent(at)
        return self.wake_at()

    def wake(self, now: int) -> None:
        """Check the search or the silence; the deadlines of applications count in every state."""
        self._listener.wake(now)
        if self.state is BaudState.SEARCH:
            self._begun(now).wake(now)
            self._judge_search(now)
            return
        watched = self._watched()
        if watched is not (self.state is BaudState.DP_MODE):
            # the watch over silence begins, or ends, here
            self._last_telegram = now
            self._reach(BaudState.DP_MODE if watched else BaudState.CONTROL, now)
        elif not watched and now >= self._last_telegram + self._control_ns:
            self._rate = max(self._rates)
            self._reach(BaudState.SEARCH, now)

    def take_tx(self, now: int) -> bytes | None:
        """The answer under way; none while the rate is not known."""
        self.wake(now)
        return None if self.state is BaudState.SEARCH else self._listener.take_tx(now)

    def wake_at(self) -> int:
        """The listener's deadlines, the next step of the search, the end of patience with silence; NOW when a watchdog
        came or went."""
        at = self._listener.wake_at()
        if self.state is BaudState.SEARCH:
            return NOW if self._search is None else min(at, self._search.wake_at())
        watched = self._watched()
        if watched is not (self.state is BaudState.DP_MODE):
            return NOW
        return at if watched else min(at, self._last_telegram + self._control_ns)

    def take_events(self) -> list[Event]:
        """Its own events and the listener's."""
        events, self._events = self._events, []
        return events + self._listener.take_events()

    def command(self, command: object, now: int) -> None:
        """:class:`LineDown`, :class:`LineUp`, :class:`RateRefused` from the driver; UsageError on anything else.

        Raises ConfigError when the port can do none of the rates.
        """
        if isinstance(command, RateRefused):
            self._begun(now).refused(now)
            return
        self._listener.command(command, now)
        if isinstance(command, (LineDown, LineUp)):
            self._search = None  # the octets before the gap say nothing about the rate

    # --- inside ---
    def _begun(self, now: int) -> AutoBaud:
        """The search, which begins with the first call that has a time."""
        if self._search is None:
            self._search = AutoBaud(now, rates=self._rates, slack_ns=self._slack_ns, settle_ns=self._settle_ns)
        return self._search

    def _judge_search(self, now: int) -> None:
        result = self._begun(now).result
        if isinstance(result, BaudFound):
            params = BusParams.preset(result.baud)
            self._rate = result.baud
            self._search = None
            self._control_ns = params.ns(params.t_to_of(_NO_MASTER)) + self._slack_ns
            self._last_telegram = now
            self._found(params, now)
            self._reach(BaudState.DP_MODE if self._watched() else BaudState.CONTROL, now)

    def _found(self, params: BusParams, now: int) -> None:
        self._listener.set_params(params)

    def _reach(self, state: BaudState, now: int) -> None:
        self.state = state
        if state is BaudState.SEARCH:
            self._listener.set_params(self._listener.params)  # forgets the answer under way
            self._lost(now)
        self._events.append(self._event(None if state is BaudState.SEARCH else self.baud, now))

    @abc.abstractmethod
    def _event(self, baud: int | None, now: int) -> Event:
        """The event of a state that was reached; ``baud`` in bit/s, None while it is searched."""


class BaudStateChanged(SlaveAppEvent):
    """The slave's watch over the rate reached another state; ``baud`` in bit/s, None while it is searched."""

    #: what the slave does about the rate
    state: BaudState
    #: rate in bit/s; None while it is searched
    baud: int | None

    def _text(self) -> str:
        rate = "" if self.baud is None else f" at {baud_text(self.baud)}"
        return f"{self.who}: {self.state.value}{rate}"


class SearchingSlave(Searching):
    """A station around ``station``, whose responder is ``app``: deaf to the bus until the rate is found.

    ``rates``: those the device knows, in bit/s.
    """

    def __init__(self, station: PassiveStation, app: SlaveApp, *, rates: Sequence[int]) -> None:
        super().__init__(station, lambda: app.watchdog.time_ns > 0, lost=app.rate_lost, rates=rates)
        self.station = station
        self.app = app

    def __repr__(self) -> str:
        return f"<SearchingSlave {self.station.address}: {self.state.value}>"

    @property
    def address(self) -> int:
        return self.station.address

    @property
    def hears_all(self) -> bool:
        """Every telegram shows that the rate is right."""
        return True

    # --- what it hears ---
    def telegram(self, telegram: Telegram, now: int) -> None:
        """A whole telegram."""
        if self.state is BaudState.SEARCH:
            self._begun(now).telegram(telegram, now)
            self._judge_search(now)
        else:
            self._last_telegram = now
            self.station.telegram(telegram, now)

    def activity(self, now: int) -> None:
        """A start edge."""
        if self.state is not BaudState.SEARCH:
            self.station.activity(now)

    # --- inside ---
    def _found(self, params: BusParams, now: int) -> None:
        super()._found(params, now)
        self.station.line.note_activity(now)

    def _event(self, baud: int | None, now: int) -> Event:
        name = self.app.device.name
        return BaudStateChanged(t_ns=now, address=self.station.address, name=name, state=self.state, baud=baud)


class PortBaudChanged(Event):
    """The watch of a port's slaves over the rate reached another state; ``baud`` in bit/s, None while searched."""

    #: what the slaves do about the rate
    state: BaudState
    #: rate in bit/s; None while it is searched
    baud: int | None

    def _text(self) -> str:
        if self.baud is None:
            return f"{self.state.value}: the bus fell silent, searching for the baud rate"
        return f"{self.state.value} at {baud_text(self.baud)}"


class SearchingPort(Searching):
    """The machine of one port around all of its slaves: ``watched`` says whether the watchdog of any of them runs."""

    def in_vain(self, now: int) -> BaudNotFound | None:
        """Why no rate was recognised up to now; None when one was."""
        return self._begun(now).in_vain(now) if self.state is BaudState.SEARCH else None

    def _event(self, baud: int | None, now: int) -> Event:
        return PortBaudChanged(t_ns=now, state=self.state, baud=baud)
