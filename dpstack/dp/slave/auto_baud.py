"""A slave that finds the baud rate by itself, as nearly all do.

A machine around what listens at one rate: deaf to the bus until the rate is found, and again once it is lost. When it
is lost is told in :mod:`dpstack.dp.slave.baud_control`. Around one station, or around all the simulated slaves of one
port: one receiver, so one search for all.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave.baud_control import BaudState, BaudWatch
from dpstack.dp.slave.device import DpV0Device
from dpstack.dp.slave.events import SlaveAppEvent
from dpstack.fdl.baud_search import BaudNotFound
from dpstack.fdl.decoder import DecoderStats
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Telegram
from dpstack.machine import LineDown, LineUp, Machine, RateRefused
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Event
from dpstack.units import BAUD_RATES, baud_text


class Listener(Machine, Protocol):
    """What hears at one rate."""

    @property
    def params(self) -> BusParams: ...

    @property
    def decoder_stats(self) -> DecoderStats:
        """The counters of its receiver."""

    def set_params(self, params: BusParams) -> None:
        """Take rate and times; what was pending is forgotten."""


class Searching(abc.ABC):
    """A machine around ``listener``. Who derives gives ``_watch``, whose callbacks are its own methods."""

    __slots__ = ("_events", "_listener", "_watch")

    _watch: BaudWatch

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._events: list[Event] = []

    @property
    def state(self) -> BaudState:
        """Of the watch over the rate."""
        return self._watch.state

    @property
    def baud(self) -> int:
        """The rate to listen at now, in bit/s."""
        return self._watch.baud

    # --- Machine ---
    def receive(self, chunk: bytes, now: int) -> None:
        """Octets from the line, at whatever rate it listens."""
        if self._watch.searching:
            self._watch.octets(chunk, now)
            return
        telegrams = self._listener.decoder_stats.telegrams
        self._listener.receive(chunk, now)
        if self._listener.decoder_stats.telegrams > telegrams:
            self._watch.heard(now)

    def sent(self, at: int) -> None:
        """The answer leaves the line at ``at``."""
        self._listener.sent(at)

    def wake(self, now: int) -> None:
        """Judge the search or the silence; applications have their time in every state."""
        self._listener.wake(now)
        self._watch.wake(now)

    def take_tx(self, now: int) -> bytes | None:
        """The answer under way; none while the rate is not known."""
        return None if self._watch.searching else self._listener.take_tx(now)

    def wake_at(self) -> int:
        """The listener's deadlines, those of the search, the end of patience with silence."""
        return min(self._listener.wake_at(), self._watch.wake_at())

    def take_events(self) -> list[Event]:
        """Its own events and the listener's."""
        events, self._events = self._events, []
        return events + self._listener.take_events()

    def command(self, command: object, now: int) -> None:
        """:class:`LineDown`, :class:`LineUp`, :class:`RateRefused` from the driver; UsageError on anything else."""
        if isinstance(command, RateRefused):
            self._watch.refused(now)
            return
        self._listener.command(command, now)
        if isinstance(command, (LineDown, LineUp)):
            self._watch.begin_anew()

    # --- for the watch ---
    def _found(self, params: BusParams, now: int) -> None:
        self._listener.set_params(params)

    def _reached(self, state: BaudState, now: int) -> None:
        if state is BaudState.SEARCH:
            self._listener.set_params(self._listener.params)  # what is pending is forgotten
            self._lost(now)
        self._events.append(self._told(state, None if state is BaudState.SEARCH else self._watch.baud, now))

    @abc.abstractmethod
    def _lost(self, now: int) -> None: ...

    @abc.abstractmethod
    def _told(self, state: BaudState, baud: int | None, now: int) -> Event:
        """What is told of a state; ``baud`` in bit/s, None while it is searched."""


__all__ = ["BaudState", "BaudStateChanged", "SearchingSlave", "make_searching_slave"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BaudStateChanged(SlaveAppEvent):
    """The slave's watch over the rate reached another state; ``baud`` in bit/s, None while it is searched."""

    state: BaudState
    baud: int | None

    def _text(self) -> str:
        rate = "" if self.baud is None else f" at {baud_text(self.baud)}"
        return f"{self.who}: {self.state.value}{rate}"


class SearchingSlave(Searching):
    """A station around ``station``, whose responder is ``app``: deaf to the bus until the rate is found.

    ``rates``: those the device knows, in bit/s. ``params_at``: the station's parameters at a rate.
    """

    __slots__ = ("app", "station")

    def __init__(
        self,
        station: PassiveStation,
        app: SlaveApp,
        *,
        rates: Sequence[int] = BAUD_RATES,
        params_at: Callable[[int], BusParams] = BusParams.preset,
    ) -> None:
        super().__init__(station)
        self.station = station
        self.app = app
        self._watch = BaudWatch(
            lambda: app.watchdog.time_ns > 0, self._found, self._reached, rates=rates, params_at=params_at
        )

    def __repr__(self) -> str:
        return f"<SearchingSlave {self.station.address}: {self.state.value}>"

    @property
    def address(self) -> int:
        return self.station.address

    @property
    def hears_all(self) -> bool:
        """Every telegram tells that the rate is right."""
        return True

    # --- what it hears ---
    def telegram(self, telegram: Telegram, now: int) -> None:
        """A whole telegram."""
        if self._watch.searching:
            self._watch.telegram(telegram, now)
        else:
            self._watch.heard(now)
            self.station.telegram(telegram, now)

    def activity(self, now: int) -> None:
        """A start edge."""
        if not self._watch.searching:
            self.station.activity(now)

    # --- for the watch ---
    def _found(self, params: BusParams, now: int) -> None:
        super()._found(params, now)
        self.station.line.heard(now)

    def _lost(self, now: int) -> None:
        self.app.rate_lost(now)

    def _told(self, state: BaudState, baud: int | None, now: int) -> Event:
        name = self.app.device.name
        return BaudStateChanged(t_ns=now, address=self.station.address, name=name, state=state, baud=baud)


def make_searching_slave(
    address: int,
    device: DpV0Device,
    *,
    rates: Sequence[int] = BAUD_RATES,
    params_at: Callable[[int], BusParams] = BusParams.preset,
    t_sdr: int | None = None,
    patience: Patience = EXACT,
) -> SearchingSlave:
    """A whole slave as :func:`~dpstack.dp.slave.application.make_slave` makes it, that finds its rate among ``rates``.

    Raises ConfigError.
    """
    app = SlaveApp(device, address=address)
    station = PassiveStation(address, app, params_at(max(rates)), t_sdr=t_sdr, patience=patience)
    return SearchingSlave(station, app, rates=rates, params_at=params_at)


@dataclass(frozen=True, slots=True, kw_only=True)
class PortBaudChanged(Event):
    """The watch of a port's slaves over the rate reached another state; ``baud`` in bit/s, None while searched."""

    state: BaudState
    baud: int | None

    def _text(self) -> str:
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
