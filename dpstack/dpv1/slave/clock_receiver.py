"""The clock of a slave, which follows Time_Event and Clock_Value of a class 3 master.

The time of the plant at a moment is the Clock_Value, plus the delay of Set_Prm (CS Delay Time), plus the time since the
Time_Event ended (VPC3+S manual, p 80). Decisions: docs/reference/decisions/clock.md.
"""

from __future__ import annotations

from typing import Final

from msgspec import Struct

from dpstack.dp.pdu.clock import JUMP_NS, ClockValue, Pairing, time_text
from dpstack.dp.pdu.dpv1_status import DPV1_ENABLE, PRM_STRUCTURE
from dpstack.dp.pdu.prm_blocks import parse_blocks
from dpstack.dp.pdu.prm_contents import BlockType, TimeAr
from dpstack.dp.pdu.requests import SetPrm
from dpstack.dp.slave.events import Report, SlaveAppEvent
from dpstack.dp.slave.extension import SlaveService
from dpstack.dp.slave.state import SlaveCore
from dpstack.errors import PduError
from dpstack.fdl.telegram import Telegram
from dpstack.params import DPV1_STATUS_LEN
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S

#: unit of Clock_Sync_Interval
_INTERVAL_UNIT_NS: Final = 10 * NS_PER_MS
#: octet of DPV1_Status with the bit Prm_Structure
_STATUS_3: Final = 2
_FRACTION: Final = 1 << 32


class PlantClock(Struct, frozen=True):
    """The clock of a slave at one moment."""

    #: time of the plant in ns since 1970 (UTC); None: no master has sent one yet
    time_ns: int | None = None
    #: whether the last Clock_Value came within the monitoring time of Set_Prm, and its sender is synchronised itself
    synchronised: bool = False
    #: address of the class 3 master that it follows
    master: int | None = None
    #: resolution of the sender in ms
    resolution_ms: int | None = None
    #: whether the sender has summer time; ``time_ns`` is UTC all the same
    summer_time: bool = False
    #: correction of this clock by the last Clock_Value in ns
    corrected_ns: int = 0


class ClockSet(SlaveAppEvent):
    """The clock has got its first time, or follows ``master`` again after it was lost."""

    #: address of the class 3 master
    master: int
    #: time of the plant in ns since 1970
    time_ns: int

    def _text(self) -> str:
        return f"{self.who}: its clock follows master {self.master}: {time_text(self.time_ns)} UTC"


class ClockLost(SlaveAppEvent):
    """No Clock_Value came for one and a half times the interval of Set_Prm: the clock runs on by itself."""

    #: address of the class 3 master that fell silent
    master: int
    #: interval of Set_Prm in ns
    interval_ns: int

    def _text(self) -> str:
        seconds = self.interval_ns / NS_PER_S
        return f"{self.who}: no time of master {self.master} for more than {seconds:g} s; its clock runs on by itself"


class ClockJumped(SlaveAppEvent):
    """A Clock_Value moved the clock by more than a second."""

    #: address of the class 3 master
    master: int
    #: correction in ns, positive: forward
    by_ns: int

    def _text(self) -> str:
        return f"{self.who}: master {self.master} moved its clock by {self.by_ns / NS_PER_S:+.3f} s"


class ClockReceiver(SlaveService):
    """The clock of one slave application. It follows one master, until that is silent for the monitoring time.

    Without a block of Set_Prm for it (type 8) there is no monitoring time and no delay; the clock follows all the same.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        #: interval in ns in which the time is expected; 0: it is not monitored
        self.interval_ns = 0
        #: delay of the Clock_Value in ns (CS Delay Time)
        self.delay_ns = 0
        self._pairing = Pairing()
        self._value: ClockValue | None = None
        self._master: int | None = None
        self._offset = 0  # time of the plant less the time of the station
        self._corrected = 0
        self._is_lost = False

    def parameterised(self, prm: SetPrm) -> None:
        """Take monitoring time and delay from the block of type 8."""
        self.interval_ns = self.delay_ns = 0
        status = prm.user_prm[:DPV1_STATUS_LEN].ljust(DPV1_STATUS_LEN, b"\0")
        if not (status[0] & DPV1_ENABLE and status[_STATUS_3] & PRM_STRUCTURE):
            return
        try:
            blocks = parse_blocks(prm.user_prm[DPV1_STATUS_LEN:], DPV1_STATUS_LEN + 1)
        except PduError:
            return  # a slave without DP-V1: from octet 8 on they are its maker's
        for block in blocks:
            if block.type == BlockType.TIME_AR and isinstance(content := block.content, TimeAr):
                self.interval_ns = content.clock_sync_interval * _INTERVAL_UNIT_NS
                fraction = content.cs_delay_fraction * NS_PER_S // _FRACTION
                self.delay_ns = content.cs_delay_seconds * NS_PER_S + fraction

    def hear_clock(self, telegram: Telegram, now: int) -> None:
        """A Time_Event or Clock_Value; its last bit was on the line at ``now``."""
        sender = telegram.sa
        if self._master is not None and sender != self._master and not self._is_lost:
            reason = f"this clock follows master {self._master}; two class 3 masters send the time"
            self._report.refused("Clock_Value", sender, reason, now)
            return
        if not telegram.is_clock_value:
            self._pairing.event(sender, now)
            return
        event_at = self._pairing.event_of(sender, now)
        if event_at is None:
            return
        try:
            value = ClockValue.parse(telegram.data)
        except PduError as error:
            self._report.refused("Clock_Value", sender, str(error), now)
            return
        self._set(value, sender, event_at, now)

    def _set(self, value: ClockValue, sender: int, event_at: int, now: int) -> None:
        offset = value.time_ns + self.delay_ns - event_at
        corrected = 0 if self._value is None else offset - self._offset
        first = self._value is None or self._is_lost or sender != self._master
        self._value, self._offset, self._corrected = value, offset, corrected
        self._master, self._is_lost = sender, False
        # one and a half: a master that sends exactly in this interval is late by its jitter every other time
        self.at = now + self.interval_ns * 3 // 2 if self.interval_ns else NEVER
        if first:
            self._report.emit(ClockSet, now, master=sender, time_ns=offset + now)
        if abs(corrected) > JUMP_NS:
            self._report.emit(ClockJumped, now, master=sender, by_ns=corrected)

    def tick(self, now: int) -> None:
        """The monitoring time is over."""
        self.at = NEVER
        self._is_lost = True
        if self._master is not None:
            self._report.emit(ClockLost, now, master=self._master, interval_ns=self.interval_ns)

    def plant_clock(self, now: int) -> PlantClock:
        """The clock at ``now``."""
        value = self._value
        if value is None:
            return PlantClock()
        return PlantClock(
            time_ns=self._offset + now,
            synchronised=value.synchronised and not self._is_lost,
            master=self._master,
            resolution_ms=value.resolution_ms,
            summer_time=value.summer_time,
            corrected_ns=self._corrected,
        )


def clock_of(app: SlaveCore) -> ClockReceiver:
    """The clock of a slave application whose device has DP-V1."""
    return next(one for one in app.services if isinstance(one, ClockReceiver))
