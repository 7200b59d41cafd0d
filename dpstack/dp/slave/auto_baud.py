"""A slave that finds the baud rate by itself, as nearly all do. The rule is in :mod:`dpstack.dp.slave.baud_control`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave.baud_control import BaudState, BaudWatch
from dpstack.dp.slave.device import Device
from dpstack.dp.slave.searching import Searching
from dpstack.dp.slave.slave_events import SlaveAppEvent
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Telegram
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
        """The station address."""
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
    device: Device,
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
