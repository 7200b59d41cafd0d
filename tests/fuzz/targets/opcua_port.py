"""Octets to the port of OPC UA before a user is known, guided by the structure of the protocol.

In memory, without cryptography. The first octet of the input says how far the client comes by itself: nowhere, past the
greeting, past a channel without security, or, as if that were allowed, past an active session of an anonymous user. The
rest is pieces: octets as they are, or a right request with some octets bent. Behind a piece, if it says so, values
change and an alarm comes. Judged: nothing reaches the loop's handler; the octets and reads of the decoder stay in their
bounds; no filter keeps a value or an alarm from others; another client is answered meanwhile; no connection, session
or subscription is left.
"""

from __future__ import annotations

import asyncio
import logging
import struct
from types import SimpleNamespace
from typing import Any, Final
from unittest import mock

from asyncua import ua
from asyncua.server.address_space import AttributeValue, NodeData
from asyncua.ua.ua_binary import struct_to_binary

from dpstack.bridge.opcua import connection
from dpstack.bridge.opcua.alarms import SERVER, Alarms, emit, utc
from dpstack.bridge.opcua.connection import MOST_REQUEST
from dpstack.bridge.opcua.sessions import LimitedServer
from dpstack.bridge.opcua.space import SharedValue
from dpstack.plant.conditions import Condition
from dpstack.trace import Severity
from tests.fuzz import opcua_wire as by
from tests.fuzz.frame import Cutter, Target
from tests.fuzz.quick_loop import quick_loop

logging.getLogger("asyncua").setLevel(logging.CRITICAL)


class _Heard(logging.Handler):
    """Collects exceptions that asyncua only logs: at a change of a value, and when messages are published."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.records: list[str] = []
        for name in ("address_space", "internal_subscription"):
            log = logging.getLogger(f"asyncua.server.{name}")
            log.setLevel(logging.ERROR)
            log.propagate = False
            log.addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(self.format(record))


_HEARD: Final = _Heard()
_NO_TIME: Final = SimpleNamespace(thread_time=float)
_NOW: Final = 1_700_000_000.0
_LEVEL, _NAME, _OBJECT = (ua.NodeId(name, 2) for name in ("level", "name", "slave/8"))
_ASK_ENDPOINTS: Final = by.request(ua.ObjectIds.GetEndpointsRequest_Encoding_DefaultBinary, by.text(b"") + bytes(8))
_SERVICES: Final[dict[str, Any]] = {
    "GetEndpoints": ua.GetEndpointsParameters(), "FindServers": ua.FindServersParameters(),
    "CreateSession": ua.CreateSessionParameters(), "ActivateSession": ua.ActivateSessionParameters(),
    "Read": ua.ReadParameters(NodesToRead=[ua.ReadValueId(ua.NodeId(2253), ua.AttributeIds.Value)]),
    "Browse": ua.BrowseParameters(NodesToBrowse=[ua.BrowseDescription(ua.NodeId(84))]),
    "TranslateBrowsePathsToNodeIds": ua.TranslateBrowsePathsToNodeIdsParameters(
        [ua.BrowsePath(ua.NodeId(84), ua.RelativePath([ua.RelativePathElement(TargetName=ua.QualifiedName("x"))]))]
    ),
    "Write": ua.WriteParameters([ua.WriteValue(ua.NodeId(84), 13, Value=ua.DataValue(ua.Variant(1)))]),
    "Call": ua.CallParameters([ua.CallMethodRequest(ua.NodeId(84), ua.NodeId(85), [ua.Variant("x")])]),
    "HistoryRead": ua.HistoryReadParameters(
        HistoryReadDetails=ua.ReadRawModifiedDetails(), NodesToRead=[ua.HistoryReadValueId(ua.NodeId(84))]
    ),
    "CreateSubscription": ua.CreateSubscriptionParameters(100.0, 60, 10, 0, True),
    "CreateMonitoredItems": ua.CreateMonitoredItemsParameters(
        78,
        ItemsToCreate=[ua.MonitoredItemCreateRequest(ua.ReadValueId(ua.NodeId(84), ua.AttributeIds.EventNotifier),
                                                     RequestedParameters=ua.MonitoringParameters(Filter=ua.EventFilter()))],
    ),
    "Publish": ua.PublishParameters([ua.SubscriptionAcknowledgement(78, 1)]),
    "Republish": ua.RepublishParameters(78, 1), "DeleteSubscriptions": ua.DeleteSubscriptionsParameters([78]),
    "ModifySubscription": ua.ModifySubscriptionParameters(78, 200.0, 60, 10),
    "SetPublishingMode": ua.SetPublishingModeParameters(True, [78]),
    "ModifyMonitoredItems": ua.ModifyMonitoredItemsParameters(
        78, ItemsToModify=[ua.MonitoredItemModifyRequest(112, ua.MonitoringParameters(1, 0.0, None, 5))]
    ),
    "SetMonitoringMode": ua.SetMonitoringModeParameters(78, ua.MonitoringMode.Disabled, [112]),
    "DeleteMonitoredItems": ua.DeleteMonitoredItemsParameters(78, [112]),
}  # fmt: skip


def _items(*wanted: tuple[ua.NodeId, ua.AttributeIds, Any]) -> ua.CreateMonitoredItemsParameters:
    """Items of the first subscription."""
    made = [
        ua.MonitoredItemCreateRequest(ua.ReadValueId(node, attribute), ua.MonitoringMode.Reporting,
                                      ua.MonitoringParameters(1, 0.0, filter_, 10))
        for node, attribute, filter_ in wanted
    ]  # fmt: skip
    return ua.CreateMonitoredItemsParameters(78, ua.TimestampsToReturn.Both, made)


_FIELDS: Final = [ua.SimpleAttributeOperand(BrowsePath=[ua.QualifiedName(name)]) for name in ("Message", "Severity")]
_NULL: Final = ua.SimpleAttributeOperand(BrowsePath=[ua.QualifiedName(None)])
_ELEMENTS: Final = [
    ua.ContentFilterElement(ua.FilterOperator.And, [ua.ElementOperand(1), ua.ElementOperand(2)]),
    ua.ContentFilterElement(ua.FilterOperator.OfType, [ua.LiteralOperand(ua.Variant(ua.NodeId(2915)))]),
    ua.ContentFilterElement(ua.FilterOperator.GreaterThan, [_FIELDS[1], ua.LiteralOperand(ua.Variant(100))]),
]
_EVENTS: Final = ua.EventFilter(_FIELDS, ua.ContentFilter(_ELEMENTS))
#: values with and without a dead band, events with a condition, and with a name that is null
_ITEMS: Final = (
    _items(
        (_LEVEL, ua.AttributeIds.Value, None),
        (_LEVEL, ua.AttributeIds.Value, ua.DataChangeFilter(DeadbandType=1, DeadbandValue=2.0)),
        (_NAME, ua.AttributeIds.Value, ua.DataChangeFilter(DeadbandType=1, DeadbandValue=2.0)),
    ),
    _items((SERVER, ua.AttributeIds.EventNotifier, _EVENTS)),
    _items((_OBJECT, ua.AttributeIds.EventNotifier, ua.EventFilter([*_FIELDS, _NULL]))),
)


def _requests() -> list[bytes]:
    found = []
    for name, params in _SERVICES.items():
        type_ = getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary")
        found.append(by.request(type_, struct_to_binary(params)))
    create = ua.ObjectIds.CreateMonitoredItemsRequest_Encoding_DefaultBinary
    found += [by.request(create, struct_to_binary(params)) for params in _ITEMS]
    found.append(by.request(ua.ObjectIds.CloseSessionRequest_Encoding_DefaultBinary, b"\x01"))
    # what asyncua believed: an array without octets, and one of texts that step back
    hostile = (b"\x80" + struct.pack("<i", 2**31 - 1), b"\x8c" + struct.pack("<ii", 2**31 - 1, -4))
    found += [by.request(428, b"", by.header(by.structure(597, one))) for one in hostile]
    return found


_RIGHT: Final = _requests()
_FIRST: Final = (b"", by.HELLO, by.HELLO + by.opening())
_STAGES: Final = 4


def _bent(octets: bytes, script: Cutter) -> bytes:
    made = bytearray(octets)
    for _ in range(script.octet() & 7):
        at, how = script.word() % len(made), script.octet()
        if how < 64:
            made[at : at + 4] = (2**31 - 1, -4 & 0xFFFFFFFF, 0, 70_000)[how & 3].to_bytes(4, "little")
        elif how < 96:
            made[at:at] = script.take(how & 15)
        else:
            made[at] = script.octet()
    return bytes(made)


class _Plant:
    """Two variables and two nodes that emit alarms. A change reaches all subscriptions."""

    def __init__(self, server: LimitedServer) -> None:
        self._server = server
        self._count = 0
        self._alarms = Alarms(b"run", lambda text: ua.NodeId(text, 2), utc)
        for id_ in (_LEVEL, _NAME, _OBJECT, SERVER):
            is_object = id_ in (_OBJECT, SERVER)
            node = server.aspace[id_] = NodeData(id_)
            class_ = ua.NodeClass.Object if is_object else ua.NodeClass.Variable
            node.attributes[ua.AttributeIds.NodeClass] = AttributeValue(ua.DataValue(ua.Variant(class_)))
            if is_object:
                notifier = ua.DataValue(ua.Variant(1, ua.VariantType.Byte))
                node.attributes[ua.AttributeIds.EventNotifier] = AttributeValue(notifier)
            else:
                node.attributes[ua.AttributeIds.Value] = AttributeValue(self._values()[id_])

    def _values(self) -> dict[ua.NodeId, ua.DataValue]:
        bad = ua.StatusCode(ua.StatusCodes.BadNoCommunication if self._count % 4 == 3 else ua.StatusCodes.Good)
        number = float("nan") if self._count % 8 == 6 else 1.5 * self._count
        return {
            _LEVEL: SharedValue(ua.Variant(number, ua.VariantType.Double), StatusCode=bad),
            _NAME: SharedValue(ua.Variant(f"name {self._count}", ua.VariantType.String), StatusCode=bad),
        }

    async def change(self) -> None:
        self._count += 1
        for id_, value in self._values().items():
            await self._server.aspace.write_attribute_value(id_, ua.AttributeIds.Value, value)
        services = [one.monitored_item_srv for one in self._server.subscription_service.subscriptions.values()]
        is_bad = self._count % 2 == 1
        condition = Condition("slave/8/x", 8, "x", "x", Severity.ERROR, is_bad, False, _NOW, _NOW, self._count)
        await emit(services, self._alarms.event(condition, "valves", utc(_NOW)), (_OBJECT, SERVER))
        await asyncio.sleep(0.11)


def _is_fine(certificate: bytes, uri: str) -> bool:
    return True


async def _main(octets: bytes) -> None:
    _HEARD.records.clear()
    script = Cutter(octets)
    head = script.octet()
    stage = head % _STAGES
    server = by.bare_server()
    plant = _Plant(server)
    unsecured = connection._SERVICES if stage == _STAGES - 1 else connection._UNSECURED
    # there are no certificates, and nobody has to wait
    with mock.patch.multiple(connection, _UNSECURED=unsecured, is_of_application=_is_fine, time=_NO_TIME):
        good = await by.Wire(server, "10.0.0.1").opened()
        wire = by.Wire(server, "10.0.0.2")
        await wire.send(_FIRST[min(stage, 2)])
        if stage == _STAGES - 1:
            await wire.send(wire.message(_RIGHT[2]))
            await wire.send(wire.message(_RIGHT[3]))
            assert isinstance(wire.protocol.processor, connection.Processor)
            assert wire.protocol.processor.is_active
        while script.at < len(octets) and not wire.closed:
            kind = script.octet()
            piece = script.take(kind & 31) if kind & 128 else _bent(_RIGHT[kind % len(_RIGHT)], script)
            whole = wire.message(piece) if stage >= 2 and kind & 64 == 0 else _bent(_FIRST[2] + piece, script)
            await wire.send(whole)
            if kind & 32:
                await plant.change()
        assert b"MSGF" in await good.send(good.message(_ASK_ENDPOINTS))
    assert len(wire.said) <= MOST_REQUEST
    for one in (wire, good):
        one.close()
    await asyncio.sleep(0.1)
    for session in server.sessions:
        await session.close_session(True)
    await server.subscription_service.delete_subscriptions(list(server.subscription_service.subscriptions))
    assert not server.wires
    assert not server.sessions
    assert not server.subscription_service.subscriptions
    server.method_service.stop()
    assert not _HEARD.records, _HEARD.records


def run(octets: bytes) -> None:
    quick_loop().play(_main(octets))


TARGET = Target(
    run=run,
    covers=tuple(f"dpstack.bridge.opcua.{one}" for one in ("connection", "decoding", "server", "subscriptions")),
    executions=100_000,
    compares=False,
    words=(b"HELF", b"OPNF", b"MSGF", b"MSGC", b"CLOF", struct.pack("<i", -4), struct.pack("<i", 2**31 - 1)),
)
