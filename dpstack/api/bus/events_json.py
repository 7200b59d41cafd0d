"""Every event an application may meet, and the JSON lines they become."""

from __future__ import annotations

from dataclasses import dataclass

from dpstack.api.streams import SlaveFlapping
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import (
    ApplicationSilent,
    AutoCleared,
    Blocked,
    ControlFailed,
    ControlSent,
    CyclesMissed,
    DriveEvent,
    Fault,
    FaultKind,
    ForcedClear,
    MasterStopped,
    ModeChanged,
    OperateWaits,
    PictureTaken,
    SlaveDiagnosis,
    SlaveEvent,
    SlaveFaulted,
    SlaveRemark,
    SlaveState,
    SlaveStateChanged,
    Stalled,
)
from dpstack.dp.master.scanner import Found, ScanDone, SlaveView, StationSeen
from dpstack.dp.pdu.alarm_blocks import Alarm, Specifier, Status
from dpstack.dpv1.master.alarm_events import AlarmRaised, StatusTold
from dpstack.dpv1.master.ms2_commands import ConnectionOver
from dpstack.drivers.runtime import BehindRealTime, BusProcessBack, BusProcessSilent, OutputsDropped, PortBack, PortLost
from dpstack.fdl.events import AddressCollision, DoesNotFit, MasterSeen, RingJoined, RingLeft, StationFound, TokenLost
from dpstack.trace import Event, Notice, Severity
from dpstack.units import NS_PER_MS, NS_PER_US

__all__ = [
    "AddressCollision",
    "AlarmRaised",
    "ApplicationSilent",
    "AutoCleared",
    "BehindRealTime",
    "Blocked",
    "BusProcessBack",
    "BusProcessSilent",
    "ConnectionOver",
    "ControlFailed",
    "ControlSent",
    "CyclesMissed",
    "DoesNotFit",
    "DriveEvent",
    "Event",
    "Fault",
    "FaultKind",
    "ForcedClear",
    "Found",
    "Injected",
    "MasterSeen",
    "MasterStopped",
    "Mode",
    "ModeChanged",
    "Notice",
    "OperateWaits",
    "OutputsDropped",
    "PictureTaken",
    "PortBack",
    "PortLost",
    "RingJoined",
    "RingLeft",
    "ScanDone",
    "Severity",
    "SlaveDiagnosis",
    "SlaveEvent",
    "SlaveFaulted",
    "SlaveFlapping",
    "SlaveRemark",
    "SlaveState",
    "SlaveStateChanged",
    "SlaveView",
    "Stalled",
    "StationFound",
    "StationSeen",
    "StatusTold",
    "TokenLost",
    "event_json",
    "severity_of",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Injected(Event):
    """Something was done to a simulated slave, or to the segment, by ``dpstack ctl``.

    ``address`` and ``name``: of the slave; None where it is the segment. ``args`` as typed.
    """

    command: str
    args: tuple[str, ...]
    address: int | None = None
    name: str | None = None

    def _text(self) -> str:
        args = self.args if self.address is None else self.args[1:]
        who = "the segment" if self.address is None else f"slave {self.address} ({self.name})"
        return f"{who}: {' '.join((self.command, *args))} (dpstack ctl)"

    def as_dict(self, t: float) -> dict[str, object]:
        """Its JSON line at ``t`` seconds."""
        line: dict[str, object] = {"event": "injected", "t": round(t, 6)}
        if self.address is not None:
            line |= {"address": self.address, "name": self.name}
        return {**line, "command": self.command, "args": list(self.args), "text": self.text}


_RING = (RingJoined, RingLeft, MasterSeen, TokenLost, AddressCollision)


def severity_of(event: Event) -> Severity:
    """How much a person should care."""
    match event:
        case Notice(severity=severity):
            return severity
        case SlaveFaulted() | AddressCollision() | PortLost() | ForcedClear() | BusProcessSilent() | OutputsDropped():
            return Severity.ERROR
        case AlarmRaised(alarm=alarm) if alarm.specifier == Specifier.APPEARS:
            return Severity.WARNING
        case SlaveRemark() | SlaveFlapping() | TokenLost() | OperateWaits() | CyclesMissed() | DoesNotFit():
            return Severity.WARNING
        case DriveEvent(payload={"type": "failed"}):
            return Severity.ERROR
        case ConnectionOver(ordered=False) | BehindRealTime(keeps_up=False):
            return Severity.WARNING
    return Severity.INFO


def _message_json(message: Alarm | Status) -> dict[str, object]:
    """What an alarm and a status have in common."""
    return {
        "type": message.type,
        "title": message.title,
        "slot": message.slot,
        "specifier": Specifier(message.specifier).name.lower(),
        "data": message.data.hex(),
    }


def event_json(event: Event, t: float) -> dict[str, object] | None:
    """The JSON line of ``event`` at ``t`` seconds; None for what is not told (answers to orders)."""
    line: dict[str, object] = {"t": round(t, 6)}
    if isinstance(event, SlaveEvent):
        line |= {"address": event.address, "name": event.name}
    match event:
        case Injected():
            return event.as_dict(t)
        case SlaveStateChanged(state=state):
            return {"event": "slave", **line, "state": state.value}
        case SlaveDiagnosis(diagnosis=diagnosis, texts=texts):
            return {"event": "diagnosis", **line, "flags": list(diagnosis.flags), "texts": list(texts)}
        case AlarmRaised(alarm=alarm):
            more = {"sequence": alarm.sequence, "user_ack": alarm.add_ack, "texts": list(event.texts)}
            return {"event": "alarm", **line, **_message_json(alarm), **more, "text": event.text}
        case StatusTold(status=status):
            return {"event": "status_message", **line, **_message_json(status), "text": event.text}
        case SlaveFaulted(fault=fault):
            return {"event": "fault", **line, "kind": fault.kind.value, "text": fault.text}
        case SlaveFlapping(count=count):
            return {"event": "flapping", **line, "count": count, "text": event.text}
        case SlaveRemark(message=message):
            return {"event": "remark", **line, "text": message}
        case DriveEvent(payload=payload):
            if payload.get("type") == "result":
                return None
            rest = {key: value for key, value in payload.items() if key != "type"}
            return {"event": "drive", **line, "type": payload.get("type"), **rest}
        case ModeChanged(mode=mode):
            return {"event": "mode", **line, "mode": mode.name.lower()}
        case AutoCleared(slaves=slaves) | OperateWaits(slaves=slaves):
            name = "auto_clear" if isinstance(event, AutoCleared) else "operate_waits"
            return {"event": name, **line, "slaves": list(slaves), "text": event.text}
        case Stalled(slaves=slaves, gap_ns=gap, blocked=blocked):
            gap_ms = None if gap is None else round(gap / NS_PER_MS, 3)
            by = None if blocked is None else blocked.value
            return {
                "event": "stalled", **line, "gap_ms": gap_ms, "blocked": by, "slaves": list(slaves), "text": event.text,
            }  # fmt: skip
        case ApplicationSilent(limit_ns=limit):
            return {"event": "application_silent", **line, "limit_ms": round(limit / NS_PER_MS), "text": event.text}
        case ControlSent() | ControlFailed() | PictureTaken():
            return None
        case CyclesMissed(number=number, count=count, missed=missed, late_ns=late_ns):
            late_us = round(late_ns / NS_PER_US)
            told = {"number": number, "count": count, "missed": missed, "late_us": late_us, "text": event.text}
            return {"event": "cycles_missed", **line, **told}
        case MasterStopped():
            return {"event": "stopped", **line}
        case StationSeen(found=found, present=present):
            return {"event": "station", **line, **found.as_dict(), "present": present, "text": event.text}
        case StationFound(address=address):
            return {"event": "station", **line, "address": address, "text": event.text}
        case ConnectionOver(address=address):
            return {"event": "connection_over", **line, "address": address, "text": event.text}
        case PortLost(port=port) | PortBack(port=port):
            return {"event": "port", **line, "port": port, "lost": isinstance(event, PortLost), "text": event.text}
        case BusProcessSilent(silent_ns=silent_ns) | BusProcessBack(silent_ns=silent_ns):
            silent = {"silent": isinstance(event, BusProcessSilent), "silent_ms": round(silent_ns / NS_PER_MS, 1)}
            return {"event": "bus_process", **line, **silent, "text": event.text}
        case BehindRealTime(bus_ns=bus_ns, real_ns=real_ns, behind_ns=behind_ns):
            told = {"speed": round(bus_ns / real_ns, 3), "behind_ms": round(behind_ns / NS_PER_MS, 1)}
            return {"event": "behind", **line, **told, "keeps_up": event.keeps_up, "text": event.text}
        case OutputsDropped(outputs=outputs):
            return {"event": "outputs_dropped", **line, "outputs": outputs.hex(), "text": event.text}
        case Notice():
            return {"event": "notice", **line, "severity": event.severity.value, "text": event.text}
    kind = "ring" if isinstance(event, _RING) else "notice"
    return {"event": kind, **line, "text": event.text}
