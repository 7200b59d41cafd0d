"""Events of a bus for applications: their severity, their JSON, and records of ``logging``.

Loggers are ``dpstack.bus`` and, for each slave, ``dpstack.slave.NAME``. A record has the text of the event as its
message, its severity as its level, and as the attribute ``dpstack`` the fields of the event as ``run --json`` has them,
with the port. An event whose level is disabled makes no record.

The command line has its events from here: those imported ``as`` themselves.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Final

from msgspec import structs

from dpstack.api.injected import Injected, ScenarioEvent
from dpstack.api.streams import LEVELS, ROOT, SlaveFlapping, logger_below
from dpstack.dp.master.events import (
    ApplicationSilent,
    AutoCleared,
    ControlFailed,
    ControlSent,
    CyclesMissed,
    ModeChanged,
    OperateWaits,
    OutputsWithheld,
    PictureTaken,
    SlaveEvent,
    SlaveRemark,
)
from dpstack.dp.master.events import DriveEvent as DriveEvent
from dpstack.dp.master.events import FaultKind as FaultKind
from dpstack.dp.master.events import MasterStopped as MasterStopped
from dpstack.dp.master.events import SlaveDiagnosis as SlaveDiagnosis
from dpstack.dp.master.events import SlaveFaulted as SlaveFaulted
from dpstack.dp.master.events import SlaveState as SlaveState
from dpstack.dp.master.events import SlaveStateChanged as SlaveStateChanged
from dpstack.dp.master.events import Stalled as Stalled
from dpstack.dp.master.scanner import Found as Found
from dpstack.dp.master.scanner import StationSeen
from dpstack.dp.pdu.alarm_blocks import message_dict
from dpstack.dp.process_image import DRIVE as DRIVE
from dpstack.dpv1.master.alarm_orders import AlarmDone, ConnectionOver, StatusTold
from dpstack.dpv1.master.alarm_orders import AlarmRaised as AlarmRaised
from dpstack.drivers.runtime import BehindRealTime, BusProcessBack, BusProcessSilent, OutputsDropped
from dpstack.drivers.runtime import PortBack as PortBack
from dpstack.drivers.runtime import PortLost as PortLost
from dpstack.fdl.events import AddressCollision as AddressCollision
from dpstack.fdl.events import MasterSeen as MasterSeen
from dpstack.fdl.events import RingJoined as RingJoined
from dpstack.fdl.events import RingLeft, StationFound, TokenLost
from dpstack.trace import Event as Event
from dpstack.trace import Notice as Notice
from dpstack.trace import Severity as Severity
from dpstack.units import NS_PER_MS, NS_PER_US, ns_to_s

_BUS: Final = logging.getLogger("dpstack.bus")
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
    own: Callable[[], tuple[str, dict[str, object]]] | None = getattr(event, "_json_fields", None)
    if own is not None:  # of a class that is loaded with the first named value
        return own()
    match event:
        case SlaveStateChanged(state=state):
            return "slave", {"state": state.value}
        case SlaveDiagnosis(diagnosis=diagnosis, texts=texts):
            return "diagnosis", {"flags": list(diagnosis.flags), "texts": list(texts)}
        case AlarmRaised(alarm=alarm):
            more: dict[str, object] = {
                "number": event.number,
                "held": event.held,
                "sequence": alarm.sequence,
                "user_ack": alarm.add_ack,
                "texts": list(event.texts),
            }
            if (stamps := alarm.time_stamps) is not None:
                more["time_stamps"] = structs.asdict(stamps)
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
        case OutputsDropped(outputs=outputs) | OutputsWithheld(outputs=outputs):
            name = "outputs_dropped" if isinstance(event, OutputsDropped) else "outputs_withheld"
            return name, {"outputs": outputs.hex()}
        case Notice():
            return "notice", {"severity": event.severity.value, **event.details()}
    return "ring" if isinstance(event, _RING) else "notice", {}


# --- records of logging -----------------------------------------------------------------------------------------------


class EventLogging:
    """Logs the events of one bus. ``origin`` returns the machine time of its start in ns, and the name of its port."""

    def __init__(self, origin: Callable[[], tuple[int, str]]) -> None:
        self._origin = origin
        self._slaves: dict[str, logging.Logger] = {}

    def __call__(self, event: Event) -> None:
        logger = self._of_slave(event.name) if isinstance(event, SlaveEvent) else _BUS
        level = LEVELS[event.severity]
        if not logger.isEnabledFor(level):
            return
        started_ns, port = self._origin()
        fields = event_json(event, ns_to_s(event.t_ns - started_ns))
        if fields is not None:  # else the answer to an order
            fields.pop("text", None)
            logger.log(level, "%s", event.text, extra={"dpstack": {**fields, "port": port}})

    def _of_slave(self, name: str) -> logging.Logger:
        logger = self._slaves.get(name)
        if logger is None:
            logger = self._slaves[name] = logging.getLogger(slave_logger_name(name))
        return logger


def slave_logger_name(name: str) -> str:
    """The logger of the slave ``name`` of a bus."""
    return logger_below("slave", name)


def log_or_print(level: int, text: str) -> None:
    """Log ``text``; on standard error if the program has not configured logging: for what somebody must read."""
    if _is_handled(ROOT):
        ROOT.log(level, "%s", text)
    elif logging.lastResort is not None:
        logging.lastResort.handle(ROOT.makeRecord(ROOT.name, level, __file__, 0, text, (), None))


def _is_handled(logger: logging.Logger) -> bool:
    """Whether a handler that is no NullHandler gets the records of ``logger``."""
    at: logging.Logger | None = logger
    while at is not None:
        if not all(isinstance(handler, logging.NullHandler) for handler in at.handlers):
            return True
        at = at.parent if at.propagate else None
    return False
