"""A slave that finds the baud rate by itself, as nearly all do.

It listens at one rate after the other (BAUD_SEARCH); once the rate is found it watches that telegrams keep coming
(BAUD_CONTROL); parameterised with the watchdog on, that watches the master instead (DP_MODE). States and transitions
are those of the VPC3+ (protocol facts, B5 and J): a watchdog that expires leads back to BAUD_CONTROL, silence there
to BAUD_SEARCH; with the watchdog off losing the rate restarts the search, but the slave stays in Data_Exchange.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final

from dpstack.dp.device import Device
from dpstack.dp.slave_events import SlaveAppEvent
from dpstack.dp.slaveapp import SlaveApp
from dpstack.fdl.autobaud import AutoBaud, BaudFound
from dpstack.fdl.passive import PassiveStation
from dpstack.fdl.telegram import Telegram
from dpstack.machine import LineDown, LineUp
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Event
from dpstack.units import BAUD_RATES, NOW, baud_text

#: BAUD_CONTROL gives up after T_TO of a station that is no master: 6 T_SL + 2 x 130 T_SL. A master that is alive is
#: never silent for so long; the chips have a register for it.
_CONTROL_SLOTS: Final = 6 + 2 * 130


class BaudState(Enum):
    """The states of the VPC3+'s watchdog."""

    SEARCH = "baud_search"
    CONTROL = "baud_control"
    DP_MODE = "dp_mode"


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

    __slots__ = ("_control_ns", "_events", "_heard_at", "_params_at", "_rates", "_search", "app", "state", "station")

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
        self.state = BaudState.SEARCH
        self._rates = rates
        self._params_at = params_at
        self._search: AutoBaud | None = None  # begins with the first call that tells the time
        self._heard_at = 0
        self._control_ns = 0
        self._events: list[Event] = []

    def __repr__(self) -> str:
        return f"<SearchingSlave {self.station.address}: {self.state.value}>"

    @property
    def address(self) -> int:
        """The station address."""
        return self.station.address

    @property
    def baud(self) -> int:
        """The rate its receiver listens at."""
        if self.state is not BaudState.SEARCH:
            return self.station.baud
        return max(self._rates) if self._search is None else self._search.baud

    @property
    def hears_all(self) -> bool:
        """Every telegram tells that the rate is right."""
        return True

    # --- what it hears ---
    def receive(self, chunk: bytes, now: int) -> None:
        """Octets, at whatever rate it listens."""
        if self.state is BaudState.SEARCH:
            search = self._searching(now)
            search.receive(chunk, now)
            self._judge(search, now)
            return
        telegrams = self.station.decoder.stats.telegrams
        self.station.receive(chunk, now)
        if self.station.decoder.stats.telegrams > telegrams:
            self._heard_at = now

    def telegram(self, telegram: Telegram, now: int) -> None:
        """A whole telegram."""
        if self.state is BaudState.SEARCH:
            search = self._searching(now)
            search.telegram(telegram, now)
            self._judge(search, now)
        else:
            self._heard_at = now
            self.station.telegram(telegram, now)

    def activity(self, now: int) -> None:
        """A start edge."""
        if self.state is not BaudState.SEARCH:
            self.station.activity(now)

    # --- what it does ---
    def sent(self, at: int) -> None:
        """The answer leaves the line at ``at``."""
        self.station.sent(at)

    def wake(self, now: int) -> None:
        """Judge the search or the silence; the application has its time in every state."""
        if self.state is BaudState.SEARCH:
            search = self._searching(now)
            search.wake(now)
            self._judge(search, now)
        self.station.wake(now)
        if self.state is BaudState.SEARCH:
            return
        watched = self.app.watchdog.time_ns > 0
        if watched is not (self.state is BaudState.DP_MODE):
            # the time without a watchdog over it begins, or ends, here
            self._heard_at = now
            self._reach(BaudState.DP_MODE if watched else BaudState.CONTROL, now)
        elif not watched and now >= self._heard_at + self._control_ns:
            self._search = None
            self._reach(BaudState.SEARCH, now)

    def take_tx(self, now: int) -> bytes | None:
        """The answer; none while the rate is not known."""
        return None if self.state is BaudState.SEARCH else self.station.take_tx(now)

    def wake_at(self) -> int:
        """The station's deadlines, those of the search, the end of patience with silence."""
        at = self.station.wake_at()
        if self.state is BaudState.SEARCH:
            return NOW if self._search is None else min(at, self._search.wake_at())
        watched = self.app.watchdog.time_ns > 0
        if watched is not (self.state is BaudState.DP_MODE):
            return NOW
        return at if watched else min(at, self._heard_at + self._control_ns)

    def take_events(self) -> list[Event]:
        """Its own events and those of station and application."""
        events, self._events = self._events, []
        return events + self.station.take_events()

    def command(self, command: object, now: int) -> None:
        """:class:`LineDown` and :class:`LineUp` from the driver; UsageError on anything else."""
        self.station.command(command, now)
        if isinstance(command, (LineDown, LineUp)) and self.state is BaudState.SEARCH:
            self._search = None

    # --- inside ---
    def _searching(self, now: int) -> AutoBaud:
        if self._search is None:
            self._search = AutoBaud(now, rates=self._rates)
        return self._search

    def _judge(self, search: AutoBaud, now: int) -> None:
        result = search.result
        if isinstance(result, BaudFound):
            params = self._params_at(result.baud)
            self.station.set_params(params)
            self.station.line.heard(now)
            self._control_ns = params.ns(_CONTROL_SLOTS * params.t_sl)
            self._heard_at = now
            self._search = None
            self._reach(BaudState.DP_MODE if self.app.watchdog.time_ns else BaudState.CONTROL, now)

    def _reach(self, state: BaudState, now: int) -> None:
        self.state = state
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
