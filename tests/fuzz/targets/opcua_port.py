"""Octets to the port of OPC UA before a user is known, guided by the structure of the protocol.

In memory, without cryptography. The first octet of the input says how far the client comes by itself: nowhere, past the
greeting, past a channel without security, or, as if that were allowed, past an active session of an anonymous user. The
rest is pieces: octets as they are, or a right request with some octets bent. Judged: nothing reaches the loop's
handler; the octets and reads of the decoder stay in their bounds; another client is answered meanwhile; no connection,
session or subscription is left.
"""

from __future__ import annotations

import asyncio
import logging
import struct
from typing import Any, Final
from unittest import mock

from asyncua import ua
from asyncua.ua.ua_binary import struct_to_binary

from dpstack.bridge.opcua import connection
from dpstack.bridge.opcua.connection import MOST_REQUEST
from tests.fuzz import opcua_wire as by
from tests.fuzz.frame import Cutter, Target
from tests.fuzz.quick_loop import quick_loop

logging.getLogger("asyncua").setLevel(logging.CRITICAL)
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
}  # fmt: skip


def _requests() -> list[bytes]:
    found = []
    for name, params in _SERVICES.items():
        type_ = getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary")
        found.append(by.request(type_, struct_to_binary(params)))
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


async def _main(octets: bytes) -> None:
    script = Cutter(octets)
    head = script.octet()
    stage = head % _STAGES
    server = by.bare_server()
    good = await by.Wire(server, "10.0.0.1").opened()
    wire = by.Wire(server, "10.0.0.2")
    unsecured = connection._SERVICES if stage == _STAGES - 1 else connection._UNSECURED
    with (
        mock.patch.object(connection, "_UNSECURED", unsecured),
        mock.patch.object(connection, "is_of_application", return_value=True),  # nor are there certificates
    ):
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


def run(octets: bytes) -> None:
    quick_loop().play(_main(octets))


TARGET = Target(
    run=run,
    covers=("dpstack.bridge.opcua.connection", "dpstack.bridge.opcua.decoding", "dpstack.bridge.opcua.subscriptions"),
    executions=100_000,
    compares=False,
    words=(b"HELF", b"OPNF", b"MSGF", b"MSGC", b"CLOF", struct.pack("<i", -4), struct.pack("<i", 2**31 - 1)),
)
