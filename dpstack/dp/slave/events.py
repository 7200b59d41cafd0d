"""Events and counters of a slave application; each refusal is reported once."""

from __future__ import annotations

from collections import defaultdict
from functools import partial
from typing import Any, Final, NamedTuple

from msgspec import Struct

from dpstack.dp.error_origin import error_text, origin_of
from dpstack.dp.slave.state_table import AppTrigger, SlaveAppState
from dpstack.fdl.interface import StationControl
from dpstack.params import UNADDRESSED
from dpstack.report_once import Novelty, ReportOnce
from dpstack.trace import Event
from dpstack.units import NS_PER_MS


class SlaveAppEvent(Event):
    """Something about one slave application. ``address`` None: it is not on a station yet."""

    #: station address, 0..126; None: it is not on a station yet
    address: int | None
    #: name of the slave
    name: str

    @property
    def who(self) -> str:
        """The slave as it stands in front of every text."""
        return self.name if self.address is None else f"slave {self.address} ({self.name})"


class SlaveAppStateChanged(SlaveAppEvent):
    """The slave reached another state."""

    #: state reached
    state: SlaveAppState
    #: what led to it
    why: AppTrigger
    #: address of the master that has locked the slave; None without one
    master: int | None

    def _text(self) -> str:
        owner = "" if self.master is None else f", master {self.master}"
        return f"{self.who}: {self.state.value} ({self.why.value}{owner})"


class WatchdogExpired(SlaveAppEvent):
    """The master was silent for ``watchdog_ns``: the outputs are cleared."""

    #: address of the master that fell silent
    master: int | None
    #: watchdog of the slave in ns
    watchdog_ns: int

    def _text(self) -> str:
        return f"{self.who}: nothing from master {self.master} for {self.watchdog_ns // NS_PER_MS} ms, outputs cleared"


class RequestRefused(SlaveAppEvent):
    """A service of ``master`` was refused; ``reason`` names the octet. Reported once for the same reason."""

    #: name of the service
    service: str
    #: address of the master that asked for it
    master: int
    #: why it was refused, with the octet concerned
    reason: str

    TEMPLATE = "{e.who}: {e.service} of master {e.master} refused: {e.reason}"


class AddressChanged(SlaveAppEvent):
    """``address`` is new: set by ``master``; None: at the device itself, 126 by an initial reset or another one by a
    parameter. ``fixed``: No_Add_Chg is set.

    ``kept``: the device keeps it over a restart.
    """

    #: former address; None: it was on no station
    before: int | None
    #: address of the master that set it; None: the device itself changed it
    master: int | None
    fixed: bool
    kept: bool

    def _text(self) -> str:
        at_device = "by an initial reset" if self.address == UNADDRESSED else "by a setting of the device"
        by = at_device if self.master is None else f"by master {self.master}"
        if self.address is None:
            what = f"has no address any more (it was {self.before}),"
        elif self.before is None:
            what = f"got address {self.address}"
        else:
            what = f"address {self.before} became {self.address}"
        how = (", fixed" if self.fixed else "") + ("" if self.kept else ", until the next restart")
        return f"{self.who}: {what} {by}{how}"


class DeviceFailed(SlaveAppEvent):
    """An exception in the device ``during`` a service: the slave left data exchange until it is restarted.

    ``origin``: function, file and line of the exception, empty when it was not raised in the device's own code.
    """

    #: service during which the exception came
    during: str
    #: the exception, one line
    error: str
    origin: str = ""

    def _text(self) -> str:
        where = f" in {self.origin}" if self.origin else ""
        return f"{self.who}: the device failed during {self.during} ({self.error}{where}); correct and restart it"


#: of an application that is on no station
_UNKNOWN_RATE: Final = 1_500_000
#: refusals to one master
_MAX_REPORTED: Final = 50
_NO_MORE: Final = "; further refusals to it are counted only"


class SlaveAppStats(Struct):
    """Counters of one slave application, always on."""

    exchanges: int = 0
    services: int = 0  # other services served
    refused: int = 0  # not open, or refused with a reason
    foreign: int = 0  # requests of masters that do not own the slave
    watchdogs: int = 0
    failures: int = 0  # exceptions in the device
    connections: int = 0  # of class 2, opened
    closed: int = 0  # of these, over


class LastRefusal(NamedTuple):
    """The refusal that came last, and how many times in a row."""

    service: str
    master: int
    reason: str
    times: int = 1

    @property
    def text(self) -> str:
        times = f", {self.times} times" if self.times > 1 else ""
        return f"{self.reason} ({self.service} of master {self.master}{times})"


class Report:
    """Events and counters of one slave application. ``name``: that of its device, for messages."""

    def __init__(self, name: str, address: int | None) -> None:
        self.stats = SlaveAppStats()
        self.station: StationControl | None = None
        self._name = name
        self._address = address
        #: the events that nobody has taken yet
        self.events: list[Event] = []
        #: the last refusal since it was restarted or in data exchange; None without one
        self.last_refusal: LastRefusal | None = None
        self._reported: defaultdict[int, ReportOnce] = defaultdict(partial(ReportOnce, _MAX_REPORTED))

    @property
    def address(self) -> int | None:
        """The address of the station, or the one given for messages."""
        return self._address if self.station is None else self.station.address

    @property
    def baud(self) -> int:
        """The rate of the station in bit/s."""
        return _UNKNOWN_RATE if self.station is None else self.station.baud

    def readdress(self, address: int) -> None:
        """Give the station another address."""
        self._address = address
        if self.station is not None and self.station.address != address:
            self.station.set_address(address)

    def take_events(self) -> list[Event]:
        """The events since the last call, oldest first."""
        if not self.events:
            return []
        events = self.events.copy()
        self.events.clear()
        return events

    def report_again(self) -> None:
        """Report refusals again that were reported before."""
        self._reported.clear()
        self.last_refusal = None

    def emit(self, kind: type[SlaveAppEvent], now: int, **fields: Any) -> None:
        """An event of ``kind`` with these fields."""
        self.events.append(kind(t_ns=now, address=self.address, name=self._name, **fields))

    def failed(self, during: str, error: Exception, now: int) -> None:
        """An exception in the device."""
        self.stats.failures += 1
        self.emit(DeviceFailed, now, during=during, error=error_text(error), origin=origin_of(error))

    def refused(self, service: str, master: int, reason: str, now: int) -> None:
        """Count a refusal and report it once until :meth:`report_again`; of a master whose requests are always wrong in
        another way only the first ones."""
        self.stats.refused += 1
        last = self.last_refusal
        times = last.times + 1 if last is not None and last[:3] == (service, master, reason) else 1
        self.last_refusal = LastRefusal(service, master, reason, times)
        news = self._reported[master].novelty((service, reason))
        if news is Novelty.KNOWN:
            return
        if news is Novelty.LAST:
            reason += _NO_MORE
        self.emit(RequestRefused, now, service=service, master=master, reason=reason)
