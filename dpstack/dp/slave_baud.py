"""A slave that finds the baud rate by itself, as nearly all do. The rule is in :mod:`dpstack.dp.baud_watch`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dpstack.dp.baud_watch import BaudState, BaudWatch
from dpstack.dp.device import Device
from dpstack.dp.slave_events import SlaveAppEvent
from dpstack.dp.slaveapp import SlaveApp
from dpstack.fdl.passive import PassiveStation
from dpstack.fdl.telegram import Telegram
from dpstack.machine import LineDown, LineUp, RateRefused
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Event
from dpstack.units import BAUD_RATES, baud_text

__all__ = ["BaudState", "BaudStateChanged", "SearchingSlave", "make_searching_slave"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BaudStateChanged(SlaveAppEvent):
    """The slave's watch over the rate reached another state; ``baud`` in bit/s, None while it is searched."""

    state: BaudState
    baud: int | None

    @property
    def text(self) -> str:
        """Which, and the rate."""
        rate = "" if self.baud is None else f" at {baud_text(self.baud)}"
        return f"{self.who}: {self.state.value}{rate}"


class SearchingSlave:
    """A station around ``station``, whose responder is ``app``: deaf to the bus until the rate is found.

    ``rates``: those the device knows, in bit/s. ``params_at``: the station's parameters at a rate.
    """

    __slots__ = ("_events", "_watch", "app", "station")

    def __init__(
        self,
        station: PassiveStation,
        app: SlaveApp,
        *,
        rates: Sequence[int] = BAUD_RATES,
        params_at: Callable[[int], BusParams] = BusParams.preset,
    ) -> None:
        self.station = station
        self.app = app
        self._events: list[Event] = []
        self._watch = BaudWatch(
            lambda: app.watchdog.time_ns > 0, self._found, self._reached, rates=rates, params_at=params_at
        )

    def __repr__(self) -> str:
        return f"<SearchingSlave {self.station.address}: {self.state.value}>"

    @property
    def address(self) -> int:
        """The station address."""
        return self.station.address

    @property
    def state(self) -> BaudState:
        """Of its watch over the rate."""
        return self._watch.state

    @property
    def baud(self) -> int:
        """The rate its receiver listens at."""
        return self._watch.baud

    @property
    def hears_all(self) -> bool:
        """Every telegram tells that the rate is right."""
        return True

    # --- what it hears ---
    def receive(self, chunk: bytes, now: int) -> None:
        """Octets, at whatever rate it listens."""
        if self._watch.searching:
            self._watch.octets(chunk, now)
            return
        telegrams = self.station.decoder.stats.telegrams
        self.station.receive(chunk, now)
        if self.station.decoder.stats.telegrams > telegrams:
            self._watch.heard(now)

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

    # --- what it does ---
    def sent(self, at: int) -> None:
        """The answer leaves the line at ``at``."""
        self.station.sent(at)

    def wake(self, now: int) -> None:
        """Judge the search or the silence; the application has its time in every state."""
        self.station.wake(now)
        self._watch.wake(now)

    def take_tx(self, now: int) -> bytes | None:
        """The answer; none while the rate is not known."""
        return None if self._watch.searching else self.station.take_tx(now)

    def wake_at(self) -> int:
        """The station's deadlines, those of the search, the end of patience with silence."""
        return min(self.station.wake_at(), self._watch.wake_at())

    def take_events(self) -> list[Event]:
        """Its own events and those of station and application."""
        events, self._events = self._events, []
        return events + self.station.take_events()

    def command(self, command: object, now: int) -> None:
        """:class:`LineDown`, :class:`LineUp`, :class:`RateRefused` from the driver; UsageError on anything else."""
        if isinstance(command, RateRefused):
            self._watch.refused(now)
            return
        self.station.command(command, now)
        if isinstance(command, (LineDown, LineUp)):
            self._watch.begin_anew()

    # --- inside ---
    def _found(self, params: BusParams, now: int) -> None:
        self.station.set_params(params)
        self.station.line.heard(now)

    def _reached(self, state: BaudState, now: int) -> None:
        if state is BaudState.SEARCH:
            self.station.set_params(self.station.params)  # what is pending is forgotten
            self.app.rate_lost(now)
        self._events.append(
            BaudStateChanged(
                t_ns=now,
                address=self.station.address,
                name=self.app.device.name,
                state=state,
                baud=None if state is BaudState.SEARCH else self.station.baud,
            )
        )


def make_searching_slave(
    address: int,
    device: Device,
    *,
    rates: Sequence[int] = BAUD_RATES,
    params_at: Callable[[int], BusParams] = BusParams.preset,
    t_sdr: int | None = None,
    patience: Patience = EXACT,
) -> SearchingSlave:
    """A whole slave as :func:`~dpstack.dp.slaveapp.make_slave` makes it, that finds its rate among ``rates``.

    Raises ConfigError.
    """
    app = SlaveApp(device, address=address)
    station = PassiveStation(address, app, params_at(max(rates)), t_sdr=t_sdr, patience=patience)
    return SearchingSlave(station, app, rates=rates, params_at=params_at)
