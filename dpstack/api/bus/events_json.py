"""Events of a bus for applications, their severity and their JSON."""

from __future__ import annotations

from dpstack.api.injected import Injected, ScenarioEvent
from dpstack.api.streams import SlaveFlapping
from dpstack.dp.master.events import (
    ApplicationSilent,
    AutoCleared,
    ControlFailed,
    ControlSent,
    CyclesMissed,
    DriveEvent,
    FaultKind,
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
from dpstack.dp.master.scanner import Found, StationSeen
from dpstack.dp.pdu.alarm_blocks import message_dict
from dpstack.dpv1.master.orders import AlarmDone, AlarmRaised, ConnectionOver, StatusTold
from dpstack.drivers.runtime import BehindRealTime, BusProcessBack, BusProcessSilent, OutputsDropped, PortBack, PortLost
from dpstack.fdl.events import AddressCollision, MasterSeen, RingJoined, RingLeft, StationFound, TokenLost
from dpstack.trace import Event, Notice, Severity
from dpstack.units import NS_PER_MS, NS_PER_US

#: for the command line
__all__ = [
    "AddressCollision",
    "AlarmRaised",
    "DriveEvent",
    "Event",
    "FaultKind",
    "Found",
    "MasterSeen",
    "MasterStopped",
    "Notice",
    "PortBack",
    "PortLost",
    "RingJoined",
    "Severity",
    "SlaveDiagnosis",
    "SlaveFaulted",
    "SlaveState",
    "SlaveStateChanged",
    "Stalled",
]


#: events whose JSON has no ``text``
_WITHOUT_TEXT = (SlaveStateChanged, SlaveDiagnosis, DriveEvent, ModeChanged, MasterStopped)
_RING = (RingJoined, RingLeft, MasterSeen, TokenLost, AddressCollision)


def event_json(event: Event, t: float) -> dict[str, object] | None:
    """The JSON line of ``event`` at ``t`` seconds; None for events that answer an order."""
    if isinstance(event, (Injected, ScenarioEvent)):
        return event.as_dict(t)
    found = _kind_and_fields(event)
    if found is None:
        return None
    kind, fields = found
    line: dict[str, object] = {"event": kind, "t": round(t, 6)}
    if isinstance(event, SlaveEvent):
        line |= {"address": event.address, "name": event.name}
    line |= fields
    return line if "text" in fields or isinstance(event, _WITHOUT_TEXT) else {**line, "text": event.text}


def _kind_and_fields(event: Event) -> tuple[str, dict[str, object]] | None:
    match event:
        case SlaveStateChanged(state=state):
            return "slave", {"state": state.value}
        case SlaveDiagnosis(diagnosis=diagnosis, texts=texts):
            return "diagnosis", {"flags": list(diagnosis.flags), "texts": list(texts)}
        case AlarmRaised(alarm=alarm):
            more = {
                "number": event.number,
                "held": event.held,
                "sequence": alarm.sequence,
                "user_ack": alarm.add_ack,
                "texts": list(event.texts),
            }
            return "alarm", {**message_dict(alarm), **more}
        case AlarmDone(number=number, outcome=outcome):
            return "notice", {"alarm": number, "acknowledged": outcome.failure is None}
        case StatusTold(status=status):
            return "status_message", message_dict(status)
        case SlaveFaulted(fault=fault):
            return "fault", {"kind": fault.kind.value, "text": fault.text}
        case SlaveFlapping(count=count):
            return "flapping", {"count": count}
        case SlaveRemark(message=message):
            return "remark", {"text": message}
        case DriveEvent(payload=payload):
            if payload.get("type") == "result":
                return None
            rest = {key: value for key, value in payload.items() if key != "type"}
            return "drive", {"type": payload.get("type"), **rest}
        case ModeChanged(mode=mode):
            return "mode", {"mode": mode.name.lower()}
        case AutoCleared(slaves=slaves) | OperateWaits(slaves=slaves):
            name = "auto_clear" if isinstance(event, AutoCleared) else "operate_waits"
            return name, {"slaves": list(slaves)}
        case Stalled(slaves=slaves, gap_ns=gap, blocked=blocked):
            gap_ms = None if gap is None else round(gap / NS_PER_MS, 3)
            by = None if blocked is None else blocked.value
            return "stalled", {"gap_ms": gap_ms, "blocked": by, "slaves": list(slaves)}
        case ApplicationSilent(limit_ns=limit):
            return "application_silent", {"limit_ms": round(limit / NS_PER_MS)}
        case ControlSent() | ControlFailed() | PictureTaken():
            return None
        case CyclesMissed(number=number, count=count, missed=missed, late_ns=late_ns):
            late_us = round(late_ns / NS_PER_US)
            return "cycles_missed", {"number": number, "count": count, "missed": missed, "late_us": late_us}
        case MasterStopped():
            return "stopped", {}
        case StationSeen(found=found, present=present):
            return "station", {**found.as_dict(), "present": present}
        case StationFound(address=address):
            return "station", {"address": address}
        case ConnectionOver(address=address):
            return "connection_over", {"address": address}
        case PortLost(port=port) | PortBack(port=port):
            return "port", {"port": port, "lost": isinstance(event, PortLost)}
        case BusProcessSilent(silent_ns=silent_ns) | BusProcessBack(silent_ns=silent_ns):
            silent = isinstance(event, BusProcessSilent)
            return "bus_process", {"silent": silent, "silent_ms": round(silent_ns / NS_PER_MS, 1)}
        case BehindRealTime(bus_ns=bus_ns, real_ns=real_ns, behind_ns=behind_ns):
            speed, behind_ms = round(bus_ns / real_ns, 3), round(behind_ns / NS_PER_MS, 1)
            return "behind", {"speed": speed, "behind_ms": behind_ms, "keeps_up": event.keeps_up}
        case OutputsDropped(outputs=outputs):
            return "outputs_dropped", {"outputs": outputs.hex()}
        case Notice():
            return "notice", {"severity": event.severity.value}
    return "ring" if isinstance(event, _RING) else "notice", {}
