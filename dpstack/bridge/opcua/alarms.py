"""Conditions of the tree as events of OffNormalAlarmType (Part 9, 5.5 to 5.8), and ConditionRefresh."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Iterable, Sequence
from datetime import UTC, datetime
from hashlib import blake2b
from typing import Any, Final

from asyncua import ua
from asyncua.server.monitored_item_service import MonitoredItemService

from dpstack.plant.conditions import Condition
from dpstack.trace import Severity

_V = ua.VariantType
#: by the scale of OPC UA, 1 to 1000 (Part 5, 6.4.2)
_SEVERITIES: Final = {Severity.INFO: 100, Severity.WARNING: 500, Severity.ERROR: 800}


def _ids(*ids: int) -> tuple[ua.NodeId, ...]:
    return tuple(ua.NodeId(one) for one in ids)


#: OffNormalAlarmType and its supertypes
_ALARM_TYPES: Final = _ids(
    ua.ObjectIds.OffNormalAlarmType, ua.ObjectIds.DiscreteAlarmType, ua.ObjectIds.AlarmConditionType,
    ua.ObjectIds.AcknowledgeableConditionType, ua.ObjectIds.ConditionType, ua.ObjectIds.BaseEventType,
)  # fmt: skip
_SYSTEM_TYPES: Final = _ids(ua.ObjectIds.SystemEventType, ua.ObjectIds.BaseEventType)
SERVER: Final = ua.NodeId(ua.ObjectIds.Server)
#: events of a condition that a client may still name
_MOST_KNOWN: Final = 32
#: conditions of a refresh until others have their turn
_AT_ONCE: Final = 25


class Event:
    """An event for the monitored items of ``emitting_node``. ``fields``: by browse path, ``NodeId`` is the ConditionId;
    ``types``: its type and all supertypes."""

    def __init__(self, types: Sequence[ua.NodeId], fields: dict[str, ua.Variant], emitting_node: ua.NodeId) -> None:
        self.types = types
        self.fields = fields
        self.emitting_node = emitting_node

    def at(self, node: ua.NodeId) -> Event:
        return Event(self.types, self.fields, node)

    def __getattr__(self, name: str) -> Any:
        """The value of a field, for the filters of clients."""
        try:
            return self.__dict__["fields"][name].Value
        except KeyError:
            raise AttributeError(name) from None

    def to_event_fields(self, clauses: Iterable[ua.SimpleAttributeOperand]) -> list[ua.Variant]:
        return [self.fields.get(_name(one), ua.Variant()) for one in clauses]


def _name(clause: ua.SimpleAttributeOperand) -> str:
    if not clause.BrowsePath:
        return "NodeId" if clause.AttributeId == ua.AttributeIds.NodeId else ""
    return "/".join(part.Name or "" for part in clause.BrowsePath)


class Alarms:
    """Makes the events of conditions. ``run``: another for each run, so that no event id comes twice; ``node``: the
    NodeId of a text; ``wall``: a time of the tree in s as that of the computer."""

    def __init__(self, run: bytes, node: Callable[[str], ua.NodeId], wall: Callable[[float], datetime]) -> None:
        self._run = run
        self._node = node
        self._wall = wall
        self._system_events = 0

    def event_id(self, condition: Condition, count: int | None = None) -> bytes:
        """The same for all nodes that emit it, and for a refresh of it. ``count``: of an earlier event."""
        number = condition.count if count is None else count
        return blake2b(self._run + f"{number} {condition.id}".encode(), digest_size=16).digest()

    def count_of(self, condition: Condition, event_id: object) -> int | None:
        """The count of ``condition`` at its event ``event_id``; None: it is none of the last ones."""
        counts = range(condition.count, max(0, condition.count - _MOST_KNOWN), -1)
        return next((count for count in counts if self.event_id(condition, count) == event_id), None)

    def condition_id(self, condition: Condition) -> ua.NodeId:
        return self._node(f"condition/{condition.id}")

    def source(self, condition: Condition) -> ua.NodeId:
        return self._node("bus" if condition.slave is None else f"slave/{condition.slave}")

    def emitters(self, condition: Condition) -> tuple[ua.NodeId, ...]:
        """The nodes whose subscribers get the event: the source, the bus, the Server object."""
        return tuple(dict.fromkeys((self.source(condition), self._node("bus"), SERVER)))

    def event(self, condition: Condition, source_name: str, now: datetime) -> Event:
        time = self._wall(condition.time)
        active, acked = condition.active, condition.acked
        fields = {
            "EventId": ua.Variant(self.event_id(condition), _V.ByteString),
            "EventType": ua.Variant(_ALARM_TYPES[0], _V.NodeId),
            "NodeId": ua.Variant(self.condition_id(condition), _V.NodeId),
            "SourceNode": ua.Variant(self.source(condition), _V.NodeId),
            "SourceName": ua.Variant(source_name, _V.String),
            "Time": ua.Variant(time, _V.DateTime),
            "ReceiveTime": ua.Variant(now, _V.DateTime),
            "Message": _text(condition.text),
            "Severity": ua.Variant(_SEVERITIES[condition.level], _V.UInt16),
            "ConditionName": ua.Variant(condition.title, _V.String),
            "ConditionClassId": ua.Variant(ua.NodeId(ua.ObjectIds.ProcessConditionClassType), _V.NodeId),
            "ConditionClassName": _text("ProcessConditionClassType"),
            "BranchId": ua.Variant(ua.NodeId(), _V.NodeId),
            "Retain": ua.Variant(condition.retain, _V.Boolean),
            "EnabledState": _text("Enabled"),
            "EnabledState/Id": ua.Variant(True, _V.Boolean),
            "ActiveState": _text("Active" if active else "Inactive"),
            "ActiveState/Id": ua.Variant(active, _V.Boolean),
            "ActiveState/TransitionTime": ua.Variant(self._wall(condition.since) if active else time, _V.DateTime),
            "AckedState": _text("Acknowledged" if acked else "Unacknowledged"),
            "AckedState/Id": ua.Variant(acked, _V.Boolean),
            "Quality": ua.Variant(ua.StatusCode(), _V.StatusCode),
            "LastSeverity": ua.Variant(_SEVERITIES[condition.level], _V.UInt16),
            "Comment": _text(condition.comment),
            "ClientUserId": ua.Variant(condition.said_by, _V.String),
            "InputNode": ua.Variant(ua.NodeId(), _V.NodeId),
            "NormalState": ua.Variant(ua.NodeId(), _V.NodeId),
            "SuppressedOrShelved": ua.Variant(False, _V.Boolean),
        }
        return Event(_ALARM_TYPES, fields, SERVER)

    def system_event(self, kind: int, message: str, now: datetime) -> Event:
        """RefreshStartEventType, RefreshEndEventType, BaseModelChangeEventType."""
        self._system_events += 1
        id_ = blake2b(self._run + f"system {self._system_events}".encode(), digest_size=16).digest()
        fields = {
            "EventId": ua.Variant(id_, _V.ByteString),
            "EventType": ua.Variant(ua.NodeId(kind), _V.NodeId),
            "SourceNode": ua.Variant(SERVER, _V.NodeId),
            "SourceName": ua.Variant("Server", _V.String),
            "Time": ua.Variant(now, _V.DateTime),
            "ReceiveTime": ua.Variant(now, _V.DateTime),
            "Message": _text(message),
            "Severity": ua.Variant(1, _V.UInt16),
        }  # fmt: skip
        return Event((ua.NodeId(kind), *_SYSTEM_TYPES), fields, SERVER)


async def emit(services: Iterable[MonitoredItemService], event: Event, nodes: Iterable[ua.NodeId]) -> None:
    """Give ``event`` to the subscribers of each of ``nodes``."""
    made = [event.at(node) for node in nodes]
    for service in tuple(services):
        for one in made:
            await service.trigger_event(one)


async def refresh(
    service: MonitoredItemService,
    item: int | None,
    begin: Event,
    retained: Callable[[], Iterable[tuple[Event, Sequence[ua.NodeId]]]],
    end: Event,
    pause: Callable[[float], Awaitable[float]],
) -> None:
    """ConditionRefresh of a subscription, or of one of its monitored items (Part 9, 5.5.7 and 5.5.8). ``retained``:
    events, and the nodes that emit them. ``pause``: waits until others had their turn; it takes the processor time
    at which the work before began, and returns that at which the next one begins."""
    begun = time.thread_time()
    for node, items in tuple(service._monitored_events.items()):
        for one in tuple(items):
            if item is not None and one != item:
                continue
            await service._trigger_event(begin.at(node), one)
            for number, (event, nodes) in enumerate(retained(), 1):
                if node in nodes:
                    await service._trigger_event(event.at(node), one)
                if number % _AT_ONCE == 0:
                    begun = await pause(begun)
            await service._trigger_event(end.at(node), one)


def _text(text: str) -> ua.Variant:
    return ua.Variant(ua.LocalizedText(text), _V.LocalizedText)


def utc(time: float) -> datetime:
    return datetime.fromtimestamp(time, UTC)
