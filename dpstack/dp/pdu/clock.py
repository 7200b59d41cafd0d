"""Clock synchronisation of DP-V2: Time_Event, Clock_Value, time-stamped process alarms and their records.

Sources: VPC3+S user manual (profichip 2012), p 80 to 84; AUMA AC(V) 01.2 manual, p 50 to 52 (tables 36 to 39).
docs/reference/decisions/clock.md.
"""

from __future__ import annotations

import datetime
import struct
from typing import Final

from msgspec import Struct

from dpstack.errors import PduError
from dpstack.text import octets_text
from dpstack.units import NS_PER_MS, NS_PER_S

#: octets of a Clock_Value
CLOCK_VALUE_LENGTH: Final = 18
#: resolutions of CR, in ms
RESOLUTIONS_MS: Final = (1, 10, 100, 1000)
#: records of time-stamped process alarms: index of the first one, and their number
FIRST_RECORD: Final = 100
RECORDS: Final = range(FIRST_RECORD, 116)
#: octets of an entry of such a record, and entries of a record
ENTRY_LENGTH: Final = 14
MOST_ENTRIES: Final = 17
#: type of the data of a time-stamped process alarm
DELTA_TRIGGER_DISCRETE: Final = 0x0D
#: bits of the state in a time-stamped process alarm (table 38: 0 buffer overrun, 1 restarted)
_BUFFER_OVERRUN, _RESTARTED = 0x01, 0x02

#: seconds count from 2036-02-07 06:28:16 below this value, from 1900 else
_FIRST_OF_1900: Final = 0x9DFF4400
_ERA: Final = 1 << 32
#: seconds from 1900-01-01 to 1970-01-01
_TO_1970: Final = 2_208_988_800
_TIMES: Final = struct.Struct(">IIIIBB")
_FRACTION: Final = 1 << 32
_ANH, _SWT, _SYF = 0x80, 0x40, 0x01
_KINDS: Final = {
    0x01: "change",
    0x02: "time",
    0x80: "start-up data",
    0x84: "end of time stamps",
    0x85: "buffer overrun",
    0x86: "change of channel",
    0x87: "loss of information",
}


def time_octets(t_ns: int) -> bytes:
    """A time in ns since 1970 (UTC) as seconds and fraction. Raises PduError outside 1984-01-01 to 2120."""
    seconds, ns = divmod(t_ns, NS_PER_S)
    count = seconds + _TO_1970
    if not _FIRST_OF_1900 <= count < _ERA + _FIRST_OF_1900:
        raise PduError(f"a clock of PROFIBUS has the years 1984 to 2120, not {seconds} s since 1970")
    return struct.pack(">II", count % _ERA, ns * _FRACTION // NS_PER_S)


def parse_time(octets: bytes) -> int:
    """The time of seconds and fraction in ns since 1970; the fraction is rounded to the nearest ns."""
    if len(octets) != 8:
        raise PduError(f"a time has 8 octets, not {len(octets)}")
    seconds, fraction = struct.unpack(">II", octets)
    since_1900 = seconds if seconds >= _FIRST_OF_1900 else seconds + _ERA
    ns: int = (since_1900 - _TO_1970) * NS_PER_S + (fraction * NS_PER_S + _FRACTION // 2) // _FRACTION
    return ns


def time_text(t_ns: int) -> str:
    """A time in ns since 1970 as UTC with milliseconds, for instance ``2026-11-28 12:00:00.250``."""
    time = datetime.datetime.fromtimestamp(t_ns // NS_PER_S, datetime.UTC)
    return f"{time:%Y-%m-%d %H:%M:%S}.{t_ns % NS_PER_S // NS_PER_MS:03}"


class ClockValue(Struct, frozen=True):
    """A Clock_Value: the time of the Time_Event before it."""

    #: time of the Time_Event in ns since 1970
    time_ns: int
    #: time of the Time_Event before that; None without one (all octets 0)
    previous_ns: int | None = None
    #: C and CV: correction -31..31, in the unit of the sender (docs/reference/decisions/clock.md)
    correction: int = 0
    #: ANH: summer time begins or ends within the next hour
    announced_hour: bool = False
    #: SWT: summer time
    summer_time: bool = False
    #: CR: resolution in ms, 1, 10, 100 or 1000
    resolution_ms: int = 1
    #: not SYF: the sender's clock is synchronised
    synchronised: bool = True

    def build(self) -> bytes:
        """The 18 octets. Raises PduError if a value does not fit."""
        if abs(self.correction) > 31 or self.resolution_ms not in RESOLUTIONS_MS:
            raise PduError("Clock_Value: correction -31..31, resolution 1, 10, 100 or 1000 ms")
        previous = bytes(8) if self.previous_ns is None else time_octets(self.previous_ns)
        status_1 = (0x80 if self.correction < 0 else 0) | abs(self.correction) << 2
        status_2 = RESOLUTIONS_MS.index(self.resolution_ms) << 3
        status_2 |= self.announced_hour * _ANH | self.summer_time * _SWT | (not self.synchronised) * _SYF
        return time_octets(self.time_ns) + previous + bytes((status_1, status_2))

    @classmethod
    def parse(cls, octets: bytes) -> ClockValue:
        """Raises PduError for another length than 18 octets."""
        if len(octets) != CLOCK_VALUE_LENGTH:
            raise PduError(f"Clock_Value has {CLOCK_VALUE_LENGTH} octets, not {octets_text(len(octets))}")
        status_1, status_2 = octets[16:]
        correction = status_1 >> 2 & 0x1F
        return cls(
            time_ns=parse_time(octets[:8]),
            previous_ns=parse_time(octets[8:16]) if any(octets[8:16]) else None,
            correction=-correction if status_1 & 0x80 else correction,
            announced_hour=bool(status_2 & _ANH),
            summer_time=bool(status_2 & _SWT),
            resolution_ms=RESOLUTIONS_MS[status_2 >> 3 & 3],
            synchronised=not status_2 & _SYF,
        )

    @property
    def text(self) -> str:
        """One line."""
        parts = [f"{time_text(self.time_ns)} UTC", f"resolution {self.resolution_ms} ms"]
        if self.correction:
            parts.append(f"correction {self.correction:+}")
        if self.summer_time:
            parts.append("summer time")
        if self.announced_hour:
            parts.append("summer time changes within an hour")
        if not self.synchronised:
            parts.append("clock not synchronised")
        return ", ".join(parts)


class TimeStampedAlarm(Struct, frozen=True):
    """The data of a time-stamped process alarm."""

    #: the device's buffer was full; it stopped to stamp
    buffer_overrun: bool
    #: the device began to stamp anew
    restarted: bool
    #: index of the record with the events, 100..115
    index: int
    #: number of events in it, 1..17
    events: int

    @classmethod
    def of(cls, data: bytes) -> TimeStampedAlarm | None:
        """Read the data of a process alarm; None if they are no time stamps."""
        if len(data) != 4 or data[3] != DELTA_TRIGGER_DISCRETE or data[1] not in RECORDS:
            return None
        return cls(bool(data[0] & _BUFFER_OVERRUN), bool(data[0] & _RESTARTED), data[1], data[2])

    @property
    def octets(self) -> bytes:
        """The data of the alarm."""
        state = self.buffer_overrun * _BUFFER_OVERRUN | self.restarted * _RESTARTED
        return bytes((state, self.index, self.events, DELTA_TRIGGER_DISCRETE))

    @property
    def text(self) -> str:
        """One line."""
        parts = [f"{self.events} time-stamped events in record {self.index}"]
        parts += ["buffer overrun"] * self.buffer_overrun + ["time stamps restarted"] * self.restarted
        return ", ".join(parts)


class StampedEvent(Struct, frozen=True):
    """An entry of a record of time stamps."""

    #: 1 a signal changed, 2 a time, 80h to 87h the device's own reports
    kind: int
    slot: int
    #: number of the signal, the device's own
    signal: int
    #: state of the signal after the change; other values are the device's
    value: int
    #: time in ns since 1970
    time_ns: int
    #: octets 5 and 6, and status of the time, as they came
    rest: bytes = b"\0\0"

    @property
    def kind_text(self) -> str:
        """The kind in words."""
        return _KINDS.get(self.kind, f"kind 0x{self.kind:02X}")


def parse_record(octets: bytes) -> list[StampedEvent]:
    """The entries of a record of time stamps. Raises PduError if it does not consist of entries of 14 octets.

    Octets of an entry: kind, slot, signal, state, two more, 8 octets of time.
    """
    if len(octets) % ENTRY_LENGTH or len(octets) > ENTRY_LENGTH * MOST_ENTRIES:
        raise PduError(f"a record of time stamps has entries of {ENTRY_LENGTH} octets, not {octets_text(len(octets))}")
    entries = [octets[at : at + ENTRY_LENGTH] for at in range(0, len(octets), ENTRY_LENGTH)]
    return [
        StampedEvent(entry[0], entry[1], entry[2], entry[3], parse_time(entry[6:]), entry[4:6]) for entry in entries
    ]
