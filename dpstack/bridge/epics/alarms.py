"""Alarm status and severity of EPICS by quality, and by states that somebody should look at."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from caproto import AlarmSeverity, AlarmStatus

from dpstack.plant.judge import STATES, Level, drive_level
from dpstack.plant.nodes import Kind, Node
from dpstack.plant.quality import Quality, Reading, Reason


class Alarm(NamedTuple):
    status: AlarmStatus
    severity: AlarmSeverity


NO_ALARM: Final = Alarm(AlarmStatus.NO_ALARM, AlarmSeverity.NO_ALARM)
#: status of each reason; others have that of their quality
_BY_REASON: Final[Mapping[Reason, AlarmStatus]] = {
    **dict.fromkeys((Reason.WAITING, Reason.NO_VALUE, Reason.NOT_THERE, Reason.NOT_A_NUMBER), AlarmStatus.UDF),
    **dict.fromkeys(
        (
            Reason.NOT_EXCHANGING, Reason.BUS_STALE, Reason.NOT_SENT, Reason.SEARCHING, Reason.ENDED, Reason.FAILED,
            Reason.STATUS_NO_COMMUNICATION,
        ),
        AlarmStatus.COMM,
    ),
    **dict.fromkeys((Reason.TOO_OLD, Reason.STREAM_SILENT, Reason.STREAM_LATE), AlarmStatus.TIMEOUT),
    **dict.fromkeys((Reason.CHANNEL_LIMIT, Reason.STATUS_RANGE), AlarmStatus.HWLIMIT),
    **dict.fromkeys(
        (
            Reason.SLOT_WRONG, Reason.SLOT_MISSING, Reason.STATUS_CONFIGURATION, Reason.STATUS_NOT_CONNECTED,
        ),
        AlarmStatus.LINK,
    ),
    **dict.fromkeys((Reason.NO_VALID_DATA, Reason.STATUS_OUT_OF_SERVICE), AlarmStatus.DISABLE),
    Reason.STATUS_SUBSTITUTE: AlarmStatus.SIMM,
}  # fmt: skip
_BY_QUALITY: Final[Mapping[Quality, Alarm]] = {
    Quality.GOOD: NO_ALARM,
    Quality.UNCERTAIN: Alarm(AlarmStatus.SOFT, AlarmSeverity.MINOR_ALARM),
    Quality.STALE: Alarm(AlarmStatus.READ, AlarmSeverity.INVALID_ALARM),
    Quality.BAD: Alarm(AlarmStatus.READ, AlarmSeverity.INVALID_ALARM),
}
_BY_LEVEL: Final[Mapping[Level, AlarmSeverity]] = {
    Level.GOOD: AlarmSeverity.NO_ALARM,
    Level.BUSY: AlarmSeverity.MINOR_ALARM,
    Level.OFF: AlarmSeverity.MINOR_ALARM,
    Level.WARNING: AlarmSeverity.MINOR_ALARM,
    Level.ERROR: AlarmSeverity.MAJOR_ALARM,
}
#: texts that are empty while nothing is wrong, by kind and key
TEXTS: Final[Mapping[tuple[Kind, str], AlarmSeverity]] = {
    (Kind.SLAVE, "fault"): AlarmSeverity.MAJOR_ALARM,
    (Kind.DIAGNOSIS, "conspicuous"): AlarmSeverity.MINOR_ALARM,
    (Kind.DRIVE, "faults"): AlarmSeverity.MAJOR_ALARM,
    (Kind.DRIVE, "warnings"): AlarmSeverity.MINOR_ALARM,
    (Kind.BUS, "clear"): AlarmSeverity.MAJOR_ALARM,
}


def of_reason(reason: Reason) -> Alarm:
    """The alarm of a value for its quality alone."""
    alarm = _BY_QUALITY[reason.quality]
    return alarm if alarm is NO_ALARM else alarm._replace(status=_BY_REASON.get(reason, alarm.status))


def of_reading(node: Node, reading: Reading) -> Alarm:
    """The alarm of ``reading``, the value of ``node``."""
    alarm = of_reason(reading.reason)
    if reading.quality is Quality.BAD and alarm.severity is not AlarmSeverity.INVALID_ALARM:  # it has no value at all
        return Alarm(AlarmStatus.UDF, AlarmSeverity.INVALID_ALARM)
    if alarm is not NO_ALARM:
        return alarm
    severity = of_value(node, reading.value)
    return NO_ALARM if severity is AlarmSeverity.NO_ALARM else Alarm(AlarmStatus.STATE, severity)


def of_value(node: Node, value: object) -> AlarmSeverity:
    """The severity of a value that is good: of a trip or a lost slave, for instance."""
    key = node.keys[-1]
    if node.states and isinstance(value, str):
        if node.kind is Kind.SLAVE:
            return _BY_LEVEL[STATES.get(value, ("", Level.OFF))[1]]
        if node.kind is Kind.DRIVE:
            is_fault = drive_level(value) == Level.ERROR.value
            return AlarmSeverity.MAJOR_ALARM if is_fault else AlarmSeverity.NO_ALARM
        return AlarmSeverity.NO_ALARM if value == "operate" else AlarmSeverity.MINOR_ALARM
    return TEXTS.get((node.kind, key), AlarmSeverity.NO_ALARM) if value else AlarmSeverity.NO_ALARM
