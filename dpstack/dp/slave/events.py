"""What a slave application tells and counts: events, each refusal once, counters."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from typing import Final

from dpstack.dp.error_origin import error_text, origin_of
from dpstack.dp.slave.device import Device
from dpstack.dp.slave.slave_events import (
    AddressChanged,
    AlarmAcknowledged,
    ConnectionClosed,
    ConnectionOpened,
    DeviceFailed,
    RequestRefused,
    SlaveAppStateChanged,
    WatchdogExpired,
)
from dpstack.dp.slave.state_table import AppEv, SlaveAppState
from dpstack.dpv1.pdu.alarms import Alarm
from dpstack.dpv1.slave.record_requests import Asker
from dpstack.fdl.interface import StationControl
from dpstack.report_once import News, Once
from dpstack.trace import Event

#: of one master
_MAX_TOLD: Final = 50
_NO_MORE: Final = "; further refusals to it are counted only"


@dataclass(slots=True)
class SlaveAppStats:
    """Counters of one slave application, always on."""

    exchanges: int = 0
    services: int = 0  # other services served
    refused: int = 0  # not open, or refused with a reason
    foreign: int = 0  # requests of masters that do not own the slave
    watchdogs: int = 0
    failures: int = 0  # exceptions in the device
    connections: int = 0  # of class 2, opened
    closed: int = 0  # of these, over


class Report:
    """Events and counters of one slave application."""

    __slots__ = ("_address", "_device", "_events", "_told", "station", "stats")

    def __init__(self, device: Device, address: int | None) -> None:
        self.stats = SlaveAppStats()
        self.station: StationControl | None = None
        self._device = device
        self._address = address
        self._events: list[Event] = []
        self._told: defaultdict[int, Once] = defaultdict(partial(Once, _MAX_TOLD))

    @property
    def address(self) -> int | None:
        """The address of the station, or the one given for messages."""
        return self._address if self.station is None else self.station.address

    def readdress(self, address: int) -> None:
        """Give the station another address."""
        self._address = address
        if self.station is not None and self.station.address != address:
            self.station.address = address

    def take(self) -> list[Event]:
        """What there is to tell, oldest first."""
        events = self._events
        if events:
            self._events = []
        return events

    def forget(self) -> None:
        """Refusals told before are news again."""
        self._told.clear()

    def state(self, state: SlaveAppState, why: AppEv, master: int | None, now: int) -> None:
        """Another state."""
        name = self._device.name
        self._events.append(
            SlaveAppStateChanged(t_ns=now, address=self.address, name=name, state=state, why=why, master=master)
        )

    def watchdog(self, master: int | None, watchdog_ns: int, now: int) -> None:
        """The master fell silent."""
        self.stats.watchdogs += 1
        name = self._device.name
        self._events.append(
            WatchdogExpired(t_ns=now, address=self.address, name=name, master=master, watchdog_ns=watchdog_ns)
        )

    def address_changed(self, before: int | None, master: int | None, fixed: bool, kept: bool, now: int) -> None:
        """The station has another address."""
        name, address = self._device.name, self.address
        self._events.append(
            AddressChanged(t_ns=now, address=address, name=name, before=before, master=master, fixed=fixed, kept=kept)
        )

    def connection_opened(self, asker: Asker, send_timeout_ns: int, now: int) -> None:
        """A connection of class 2."""
        self.stats.connections += 1
        self._events.append(
            ConnectionOpened(
                t_ns=now,
                address=self.address,
                name=self._device.name,
                master=asker.master,
                sap=asker.sap,
                send_timeout_ns=send_timeout_ns,
            )
        )

    def connection_closed(self, asker: Asker, services: int, reason: str, now: int) -> None:
        """A connection of class 2 is over."""
        self.stats.closed += 1
        self._events.append(
            ConnectionClosed(
                t_ns=now,
                address=self.address,
                name=self._device.name,
                master=asker.master,
                sap=asker.sap,
                services=services,
                reason=reason,
            )
        )

    def failed(self, during: str, error: Exception, now: int) -> None:
        """An exception in the device."""
        self.stats.failures += 1
        name, text, origin = self._device.name, error_text(error), origin_of(error)
        self._events.append(
            DeviceFailed(t_ns=now, address=self.address, name=name, during=during, error=text, origin=origin)
        )

    def acknowledged(self, alarm: Alarm, master: int, now: int) -> None:
        """An alarm is over."""
        name = self._device.name
        self._events.append(AlarmAcknowledged(t_ns=now, address=self.address, name=name, alarm=alarm, master=master))

    def refused(self, service: str, master: int, reason: str, now: int) -> None:
        """A refusal; told once until :meth:`forget`, of a master whose requests are always wrong in another way the
        first ones."""
        self.stats.refused += 1
        news = self._told[master].news((service, reason))
        if news is News.KNOWN:
            return
        if news is News.LAST:
            reason += _NO_MORE
        name = self._device.name
        self._events.append(
            RequestRefused(t_ns=now, address=self.address, name=name, service=service, master=master, reason=reason)
        )
