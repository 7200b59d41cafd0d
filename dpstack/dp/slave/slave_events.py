"""What a slave application tells."""

from __future__ import annotations

from dataclasses import dataclass

from dpstack.dp.slave.state_table import AppEv, SlaveAppState
from dpstack.dpv1.pdu.alarms import Alarm
from dpstack.params import UNADDRESSED
from dpstack.trace import Event
from dpstack.units import NS_PER_MS


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveAppEvent(Event):
    """Something about one slave application. ``address`` None: it is not on a station yet."""

    address: int | None
    name: str

    @property
    def who(self) -> str:
        """The slave as it stands in front of every text."""
        return self.name if self.address is None else f"slave {self.address} ({self.name})"


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveAppStateChanged(SlaveAppEvent):
    """The slave reached another state. ``master``: who has locked it."""

    state: SlaveAppState
    why: AppEv
    master: int | None

    @property
    def text(self) -> str:
        """Which, and why."""
        owner = "" if self.master is None else f", master {self.master}"
        return f"{self.who}: {self.state.value} ({self.why.value}{owner})"


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchdogExpired(SlaveAppEvent):
    """The master was silent for ``watchdog_ns``: the outputs are cleared."""

    master: int | None
    watchdog_ns: int

    @property
    def text(self) -> str:
        """Who was silent for how long."""
        return f"{self.who}: nothing from master {self.master} for {self.watchdog_ns // NS_PER_MS} ms, outputs cleared"


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestRefused(SlaveAppEvent):
    """A service of ``master`` was refused; ``reason`` names the octet. Told once for the same reason."""

    service: str
    master: int
    reason: str

    @property
    def text(self) -> str:
        """What and why."""
        return f"{self.who}: {self.service} of master {self.master} refused: {self.reason}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectionOpened(SlaveAppEvent):
    """``master`` has opened a connection of class 2 at the server ``sap``."""

    master: int
    sap: int
    send_timeout_ns: int

    @property
    def text(self) -> str:
        """Whose, and how long silence may last."""
        which = f"class 2 connection of master {self.master} opened (server SAP {self.sap}"
        return f"{self.who}: {which}, send time-out {self.send_timeout_ns // NS_PER_MS} ms)"


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectionClosed(SlaveAppEvent):
    """A connection of class 2 is over and given back; ``services``: how many its master asked for."""

    master: int
    sap: int
    services: int
    reason: str

    @property
    def text(self) -> str:
        """Whose and why."""
        which = f"class 2 connection of master {self.master} (server SAP {self.sap})"
        return f"{self.who}: {which} is over after {self.services} services: {self.reason}"


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmAcknowledged(SlaveAppEvent):
    """``master`` acknowledged ``alarm``, which is over with it."""

    alarm: Alarm
    master: int

    @property
    def text(self) -> str:
        """Which, by whom."""
        return f"{self.who}: {self.alarm.text}: acknowledged by master {self.master}"


@dataclass(frozen=True, slots=True, kw_only=True)
class AddressChanged(SlaveAppEvent):
    """``address`` is new: set by ``master``; None: at the device itself, 126 by an initial reset or another one by a
    parameter. ``fixed``: No_Add_Chg is set.

    ``kept``: the device keeps it over a restart.
    """

    before: int | None
    master: int | None
    fixed: bool
    kept: bool

    @property
    def text(self) -> str:
        """From where to where, by whom, for how long."""
        at_device = "by an initial reset" if self.address == UNADDRESSED else "by a setting of the device"
        by = at_device if self.master is None else f"by master {self.master}"
        how = ", fixed" if self.fixed else ""
        return f"{self.who}: address {self.before} became {self.address} {by}{how}" + (
            "" if self.kept else ", until the next restart"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceFailed(SlaveAppEvent):
    """An exception in the device ``during`` a service: the slave left data exchange until it is restarted.

    ``origin``: function, file and line of the exception, empty when it was not raised in the device's own code.
    """

    during: str
    error: str
    origin: str = ""

    @property
    def text(self) -> str:
        """What failed where, and what to do."""
        where = f" in {self.origin}" if self.origin else ""
        return f"{self.who}: the device failed during {self.during} ({self.error}{where}); correct and restart it"
