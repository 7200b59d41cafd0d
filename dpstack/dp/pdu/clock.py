"""Clock synchronisation of DP-V2: Time_Event, Clock_Value, time-stamped process alarms and their records.

Sources: VPC3+S user manual (profichip 2012), p 80 to 84; AUMA AC(V) 01.2 manual, p 50 to 52 (tables 36 to 39);
ET 200M operating instructions (12/2008), p 154 to 157; ET 200iSP (11/2022), p 218. docs/reference/decisions/clock.md.
"""

from __future__ import annotations

import datetime
import struct
from collections.abc import Iterable
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
#: the same of the interface modules IM 153-2 and IM 152 (ET 200M, table 8-6)
SHORT_LENGTH: Final = 12
MOST_SHORT: Final = 20
#: a Clock_Value belongs to a Time_Event that is not older than this
BELONGS_NS: Final = NS_PER_S
#: a correction beyond this is a jump
JUMP_NS: Final = NS_PER_S
#: what to do about a master that sends the time and sets SYF
NOT_KEPT: Final = "its own clock is not synchronised (SYF): look at its time server"
#: type of the data of a time-stamped process alarm
DELTA_TRIGGER_DISCRETE: Final = 0x0D
#: bits of the state in a time-stamped process alarm (ET 200iSP, table 7-46: 1 and 2 overflow of the buffers outside and
#: inside, 5 reset; ET 200M, table 8-3: 5; AUMA, table 38, has both in this order, without places)
_BUFFER_OVERRUN, _RESTARTED = 0x06, 0x20
_OVERRUN_OUTSIDE: Final = 0x02

#: seconds count from 2036-02-07 06:28:16 below this value, from 1900 else
_FIRST_OF_1900: Final = 0x9DFF4400
_ERA: Final = 1 << 32
#: seconds from 1900-01-01 to 1970-01-01
_TO_1970: Final = 2_208_988_800
_TIMES: Final = struct.Struct(">IIIIBB")
_FRACTION: Final = 1 << 32
_ANH, _SWT, _SYF = 0x80, 0x40, 0x01
#: minutes of a step of CV: the sender's local time is UTC and CV (SIPROTEC profile C53000-L1840-B001-03, p 19)
_CV_MINUTES: Final = 30
#: kind of an entry of 12 octets of the interface module itself, beside its number
_SPECIAL: Final = 0x100
#: slot of the interface module, whose entries are its own reports
_INTERFACE_MODULE: Final = 2
#: state of a signal in an entry of 12 octets
_INCOMING: Final = 0x80
#: kinds from here on are the device's own reports and have no state of a signal
_FIRST_REPORT: Final = 0x80
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


def several_clocks(senders: Iterable[str]) -> str:
    """The remark about several masters that send the time, with their names."""
    return f"{' and '.join(senders)} send the time: devices follow one of them or jump; let one send it"


class ClockValue(Struct, frozen=True):
    """A Clock_Value: the time of the Time_Event before it."""

    #: time of the Time_Event in ns since 1970
    time_ns: int
    #: time of the Time_Event before that; None without one (all octets 0)
    previous_ns: int | None = None
    #: C and CV: correction -31..31 in half hours: local time of the sender less UTC
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
            parts.append(f"correction {_hours(self.correction)} (local time)")
        if self.summer_time:
            parts.append("summer time")
        if self.announced_hour:
            parts.append("summer time changes within an hour")
        if not self.synchronised:
            parts.append("clock not synchronised")
        return ", ".join(parts)


def _hours(correction: int) -> str:
    """CV as hours and minutes, for instance ``+2:00 h``."""
    hours, minutes = divmod(abs(correction) * _CV_MINUTES, 60)
    return f"{'-' if correction < 0 else '+'}{hours}:{minutes:02} h"


class Pairing:
    """Joins each Clock_Value with the Time_Event before it, which the same station sent."""

    __slots__ = ("_event",)

    def __init__(self) -> None:
        self._event: tuple[int, int] | None = None  # sender and end of the last Time_Event

    def event(self, sender: int, end: int) -> None:
        """A Time_Event of ``sender`` ended at ``end``."""
        self._event = sender, end

    def event_of(self, sender: int, end: int) -> int | None:
        """The end of the Time_Event of a Clock_Value that ended at ``end``; None if it did not arrive in time."""
        event, self._event = self._event, None
        if event is None or event[0] != sender or end - event[1] > BELONGS_NS:
            return None
        return event[1]


class TimeStampedAlarm(Struct, frozen=True):
    """The data of a time-stamped process alarm."""

    #: the device's buffer was full; it stopped to stamp
    buffer_overrun: bool
    #: the device began to stamp anew
    restarted: bool
    #: index of the record with the events, 100..115
    index: int
    #: number of events in it, 1..20
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
        state = self.buffer_overrun * _OVERRUN_OUTSIDE | self.restarted * _RESTARTED
        return bytes((state, self.index, self.events, DELTA_TRIGGER_DISCRETE))

    @property
    def text(self) -> str:
        """One line."""
        parts = [f"{self.events} time-stamped event{'s' * (self.events != 1)} in record {self.index}"]
        parts += ["buffer overrun"] * self.buffer_overrun + ["time stamps restarted"] * self.restarted
        return ", ".join(parts)


class StampedEvent(Struct, frozen=True):
    """An entry of a record of time stamps."""

    #: 1 a signal changed, 2 a time, 80h to 87h the device's own reports; 100h and its number: a special message of an
    #: interface module IM 153-2 or IM 152
    kind: int
    slot: int
    #: number of the signal, the device's own; the channel in an ET 200
    signal: int
    #: state of the signal after the change, 1: active; other values are the device's
    value: int
    #: time in ns since 1970
    time_ns: int
    #: octets of the entry without a meaning here, as they came
    rest: bytes = b"\0\0"

    @property
    def kind_text(self) -> str:
        """The kind in words."""
        if self.kind >= _SPECIAL:
            return f"special message {self.kind - _SPECIAL}"
        return _KINDS.get(self.kind, f"kind 0x{self.kind:02X}")

    @property
    def state_text(self) -> str:
        """The state in words; empty for a report of the device itself, which has no signal."""
        if self.kind >= _FIRST_REPORT:
            return ""
        return {0: "not active", 1: "active"}.get(self.value, f"0x{self.value:02X}")

    @property
    def time_text(self) -> str:
        """The time as UTC with milliseconds."""
        return time_text(self.time_ns)

    def as_dict(self) -> dict[str, object]:
        """The entry as plain data, with its texts."""
        return {
            "time": f"{self.time_text.replace(' ', 'T')}Z",
            "slot": self.slot,
            "signal": self.signal,
            "state": self.value,
            "state_text": self.state_text,
            "kind": self.kind,
            "kind_text": self.kind_text,
        }


def parse_record(octets: bytes) -> list[StampedEvent]:
    """The entries of a record of time stamps. Raises PduError if it does not consist of whole entries.

    Octets of an entry of 14: kind, slot, signal, state, two more, 8 octets of time; of 12, from an IM 153-2 or IM 152:
    slot, channel, state (bit 7), one more, 8 octets of time.
    """
    long, short = _entries(octets, ENTRY_LENGTH, MOST_ENTRIES), _entries(octets, SHORT_LENGTH, MOST_SHORT)
    # 84 and 168 octets may be either: in entries of 14 octets the first one is a kind
    if long and (not short or all(entry[0] in _KINDS for entry in long)):
        return [_long_event(entry) for entry in long]
    if not short and octets:
        raise PduError(
            f"a record of time stamps has up to {MOST_ENTRIES} entries of {ENTRY_LENGTH} octets, or {MOST_SHORT} of "
            f"{SHORT_LENGTH}; there are {octets_text(len(octets))}"
        )
    return [_short_event(entry) for entry in short]


def _entries(octets: bytes, length: int, most: int) -> list[bytes]:
    """``octets`` in entries of ``length``; none if they are not up to ``most`` whole ones."""
    if len(octets) % length or len(octets) > length * most:
        return []
    return [octets[at : at + length] for at in range(0, len(octets), length)]


def _long_event(entry: bytes) -> StampedEvent:
    return StampedEvent(entry[0], entry[1], entry[2], entry[3], parse_time(entry[6:]), entry[4:6])


def _short_event(entry: bytes) -> StampedEvent:
    slot, number, state, more = entry[:4]
    time_ns = parse_time(entry[4:])
    if slot == _INTERFACE_MODULE:
        return StampedEvent(_SPECIAL + number, slot, number, state, time_ns, bytes((more,)))
    return StampedEvent(1, slot, number, state >> 7, time_ns, bytes((state & ~_INCOMING, more)))
