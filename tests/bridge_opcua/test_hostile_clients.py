"""Hostile clients of OPC UA: their octets cost little, end their own connection at most, and are counted; memory for
messages that they do not acknowledge; garbage collection at the start."""

from __future__ import annotations

import asyncio
import gc
import inspect
import struct
import time
import tracemalloc
from types import SimpleNamespace
from typing import Any, Final, cast

import pytest
from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.server.address_space import AddressSpace, NodeData
from asyncua.server.internal_subscription import InternalSubscription
from asyncua.ua import ua_binary
from asyncua.ua.ua_binary import struct_from_binary, struct_to_binary
from far_ends import until

from dpstack.bridge import processor_share
from dpstack.bridge.opcua import connection, decoding
from dpstack.bridge.opcua import sessions as server
from dpstack.bridge.opcua.decoding import READS, READS_BEFORE_SESSION, Octets, guard
from dpstack.bridge.opcua.sessions import MOST_UNACKED
from dpstack.bridge.opcua.standard_nodes import add_standard_nodes
from dpstack.bridge.opcua.subscriptions import (
    MOST_FIELDS_IN_MESSAGE,
    MOST_IN_MESSAGE,
    MOST_UNACKED_VALUES,
    Losses,
    WhereClause,
    bound,
)
from dpstack.errors import DpError
from tests.fuzz import opcua_wire as by
from tests.fuzz.opcua_wire import HELLO, Wire

guard()
#: numbers of OPC 10000-6, annex A: GetEndpointsRequest, LiteralOperand, RolePermissionType, EventFilter
GET_ENDPOINTS, LITERAL, ROLE_PERMISSION, EVENT_FILTER = 428, 597, 128, 727
MOST: Final = 0x7FFFFFFF
LIMITS, DECODING, TOO_LARGE, REFUSED = "80080000", "80070000", "80800000", "80ac0000"


def literal(octets: bytes) -> bytes:
    return by.structure(LITERAL, octets)


def nested(count: int) -> bytes:
    """Variants in LiteralOperands in Variants."""
    made = literal(b"\0")
    for _ in range(count):
        made = literal(b"\x16" + made)
    return made


def array(type_: int, count: int, octets: bytes = b"") -> bytes:
    return literal(bytes((0x80 | type_,)) + struct.pack("<i", count) + octets)


HOSTILE: Final = {
    "2147483647 values without octets": array(0, MOST),
    "values without octets in values": array(24, 400, (b"\x80" + struct.pack("<i", 400)) * 400),
    "2147483647 texts, each of length -4, that step back": array(12, MOST, struct.pack("<i", -4)),
    "2147483647 octet strings of length -4": array(15, MOST, struct.pack("<i", -4)),
    "2147483647 numbers": array(6, MOST),
    "2147483647 times": array(13, MOST),
    "-2 numbers": array(6, -2),
    "a text of 2 GB": literal(b"\x0c" + struct.pack("<i", MOST)),
    "a matrix of a million empty lists": literal(b"\xc6" + struct.pack("<ii", 0, 2) + struct.pack("<ii", 1000, 1000)),
    "a matrix without dimensions": literal(b"\xc6" + struct.pack("<ii", 0, 0)),
    "a matrix of negative size": literal(b"\xc6" + struct.pack("<iii", 0, 2, -3) + struct.pack("<i", -3)),
    "200 structures in each other": nested(200),
    "400 DiagnosticInfos in each other": literal(b"\x19" + b"\x40" * 400 + b"\0"),
    "400 DataValues in each other": literal(b"\x17\x01" * 400 + b"\0"),
    "400 Variants in each other": literal((b"\x98" + struct.pack("<i", 1)) * 400 + b"\0"),
    "a structure without an end": b"\x01\x00" + struct.pack("<H", LITERAL) + b"\x01\xff\xff\xff\xff\x16" * 60,
}  # fmt: skip


def decode(octets: bytes, reads: int) -> object:
    return struct_from_binary(ua.RequestHeader, Octets(octets, reads))


@pytest.mark.parametrize("name", HOSTILE)
def test_a_length_or_depth_that_is_believed_costs_little(name: str) -> None:
    octets = by.header(HOSTILE[name])
    tracemalloc.start()
    begun = time.process_time()
    try:
        for reads in (READS_BEFORE_SESSION, 2_000):
            with pytest.raises((ua.UaStatusCodeError, ua.UaError, struct.error, ValueError, RecursionError)):
                decode(octets, reads)
        assert tracemalloc.get_traced_memory()[1] < 8 << 20
    finally:
        tracemalloc.stop()
    assert time.process_time() - begun < 1  # seconds, also where everything is slow; unbounded it took for ever


def test_the_bound_is_the_one_of_reads() -> None:
    left = Octets(by.header(array(0, MOST)), 10_000)
    with pytest.raises(ua.UaStatusCodeError) as found:
        struct_from_binary(ua.RequestHeader, left)
    assert f"{found.value.code:x}" == LIMITS
    assert left._left[0] == -1
    for step in (left.read, left.skip):
        with pytest.raises(ua.UaStatusCodeError) as found:
            step(-4)
        assert f"{found.value.code:x}" == DECODING


def test_what_an_honest_client_sends_is_decoded_as_before() -> None:
    asked = ua.MonitoredItemCreateRequest(ua.ReadValueId(ua.NodeId("slave/8/input/level", 2), ua.AttributeIds.Value))
    asked.RequestedParameters.Filter = ua.DataChangeFilter()
    params = ua.CreateMonitoredItemsParameters(ItemsToCreate=[asked] * 1000)
    octets = struct_to_binary(params)
    assert struct_from_binary(type(params), Octets(octets, READS)) == struct_from_binary(type(params), Buffer(octets))
    for type_ in (ua.RequestHeader, ua.CreateSessionParameters, ua.ActivateSessionParameters):
        octets = struct_to_binary(type_())
        assert struct_to_binary(struct_from_binary(type_, Octets(octets, READS_BEFORE_SESSION))) == octets


def test_structures_whose_flags_python_would_keep_for_ever_stay_octets() -> None:
    flags = ua.PermissionType
    before = len(flags._value2member_map_)
    for number in range(0x20000, 0x20010):
        role = by.structure(ROLE_PERMISSION, b"\0\0" + struct.pack("<I", number))
        found = struct_from_binary(ua.RequestHeader, Octets(by.header(role), READS)).AdditionalHeader
        assert isinstance(found, ua.ExtensionObject)
        assert len(found.Body) == 6
    assert len(flags._value2member_map_) == before
    other = struct_from_binary(ua.RequestHeader, Buffer(by.header(role))).AdditionalHeader
    assert type(other) is ua.RolePermissionType  # other buffers, such as those of a client, are left alone


def test_another_asyncua_is_refused_with_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ua_binary, "extensionobject_from_binary", lambda data: None)
    monkeypatch.delattr(ua_binary, "_create_list_deserializer")
    with pytest.raises(DpError, match=r"asyncua has no _create_list_deserializer, .*: install a version"):
        guard()


def test_asyncua_still_is_what_the_guard_was_written_for() -> None:
    """No list holds a structure without fields, which would be an array that takes no octets; and the parts of a
    request have no flags."""
    for type_ in (
        getattr(ua, name) for name in dir(ua) if name.endswith(("Parameters", "Filter", "Operand", "Details"))
    ):
        hints = ua_binary.get_safe_type_hints(type_, {"ua": ua}) if inspect.isclass(type_) else {}
        for hint in hints.values():
            inner = ua.uatypes.type_from_list(hint) if ua.uatypes.type_is_list(hint) else hint
            assert not (inspect.isclass(inner) and issubclass(inner, ua.IntFlag if hasattr(ua, "IntFlag") else ())), (
                hint
            )
            if inner is not hint and hasattr(inner, "__dataclass_fields__"):
                assert inner.__dataclass_fields__, hint
    source = inspect.getsource(ua_binary._create_uatype_array_deserializer)
    assert "range(length)" in source, "asyncua bounds arrays now: is decoding.py still needed?"


# --- connections --------------------------------------------------------------------------------------------------


def over(answer: bytes) -> str:
    """The status code of an ERR message."""
    assert answer[:4] == b"ERRF", answer
    return f"{struct.unpack_from('<I', answer, 8)[0]:x}"


async def test_a_hostile_request_ends_its_connection_alone() -> None:
    server = by.bare_server()
    good = await Wire(server).opened()
    for name, octets in HOSTILE.items():
        hostile, first = await Wire(server).opened(), Wire(server)
        answer = await hostile.send(hostile.message(by.request(GET_ENDPOINTS, b"", by.header(octets))))
        assert answer[:3] == b"ERR", name
        assert hostile.closed
        await first.send(HELLO, by.opening(by.request(446, b"", by.header(octets))))
        assert first.closed, name
    assert b"MSGF" in await good.send(good.message(by.request(GET_ENDPOINTS, by.text(b"") + bytes(8))))
    assert server.wires == [good.protocol]
    good.close()
    await asyncio.sleep(0)


async def test_what_is_no_handshake_ends_the_connection() -> None:
    server = by.bare_server()

    async def said(*octets: bytes) -> tuple[bytes, bool]:
        wire = Wire(server)
        return await wire.send(*octets), wire.closed

    small = b"HELF" + struct.pack("<I5Ii", 32, 0, 16, 16, 0, 0, -1)
    assert over((await said(small))[0]) == REFUSED  # a megabyte would be sent in a million parts
    answer, closed = await said(HELLO, HELLO)
    assert closed
    assert over(answer[28:]) == REFUSED
    assert (await said(by.opening()))[1]  # before the greeting
    acknowledge = b"ACKF" + struct.pack("<I5I", 28, 0, 1 << 30, 1 << 30, 0, 0)  # limits that a server would give
    assert (await said(HELLO, acknowledge))[1]
    sealed = by.opening()[:12] + by.text(by.POLICY_NONE) + struct.pack("<ii", -1, -1) + bytes(60_000)
    sealed = sealed[:4] + struct.pack("<I", len(sealed)) + sealed[8:]
    answer, closed = await said(HELLO, sealed)
    assert closed
    assert over(answer[28:]) == TOO_LARGE  # a quarter of a second of the private key
    wire = await Wire(server).opened()
    assert over(await wire.send(wire.message(bytes(100), b"MSGC"))) == TOO_LARGE  # parts, before a session
    for octets in (b"MSGF\x0c\0\0\0", b"HELF\x08\0\0\0", b"HELF\xff\xff\xff\xff", b"GET"):
        assert (await said(octets))[1]


async def test_waiting_messages_hold_their_own_octets_and_are_few() -> None:
    wire = await Wire(by.bare_server()).opened()
    one = wire.message(by.request(GET_ENDPOINTS, by.text(b"") + bytes(8)))
    wire.protocol.data_received(one * 20)
    waiting = list(wire.protocol.messages._queue)
    assert {len(buffer._data) for _, buffer in waiting} == {len(one)}
    wire.protocol.data_received(one * 60)
    assert wire.closed
    server = wire.protocol.iserver
    assert server.losses.news() == "1 x a client was cut off, as it sent too many requests at once (last: 127.0.0.1)"
    await asyncio.sleep(0)


async def test_services_that_change_the_server_are_refused_and_sessions_need_security() -> None:
    wire = await Wire(by.bare_server()).opened()
    names = ("AddNodes", "DeleteNodes", "AddReferences", "DeleteReferences", "RegisterServer", "RegisterServer2",
             "HistoryUpdate", "QueryFirst", "SetTriggering", "BrowseNext")  # fmt: skip
    for name, code in [(name, "800b0000") for name in names] + [("CreateSession", "80550000"), ("Read", "80550000")]:
        type_ = getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary")
        answer = await wire.send(wire.message(by.request(type_, bytes(4))))
        [found] = struct.unpack_from("<I", answer, 24 + 4 + 8 + 4)
        assert f"{found:x}" == code, name


async def test_a_client_that_does_not_read_is_cut_off_also_by_a_message_that_it_did_not_ask_for() -> None:
    server = by.bare_server()
    wire = await Wire(server).opened()
    processor: Any = wire.protocol.processor
    wire.unread = connection.MOST_UNREAD + 1
    said = len(wire.said)
    processor.send_response(1, ua.SequenceHeader(), ua.ServiceFault())
    assert wire.closed
    assert len(wire.said) == said
    assert "did not read its answers" in server.losses.news()
    await asyncio.sleep(0)


async def test_one_address_leaves_room_for_others_and_needs_a_session() -> None:
    server = by.bare_server()
    server.max_pending_activation_seconds = 0.01
    wires = [Wire(server) for _ in range(connection.MOST_OF_ADDRESS + 1)]
    assert [one.closed for one in wires] == [False] * connection.MOST_OF_ADDRESS + [True]
    assert not Wire(server, "10.0.0.9").closed
    await until(lambda: not server.wires)
    news = server.losses.news()
    assert "1 x a client was cut off, as it had 16 connections already; 17 x" in news
    assert server.losses.news() == ""


async def test_requests_get_half_of_the_time_beyond_a_burst(monkeypatch: pytest.MonkeyPatch) -> None:
    now, slept = [100.0], [0.0]

    async def sleep(seconds: float) -> None:
        now[0] += seconds
        slept[0] += seconds

    monkeypatch.setattr(processor_share, "time", type("Time", (), {"monotonic": lambda: now[0]}))
    monkeypatch.setattr(processor_share, "asyncio", type("Asyncio", (), {"sleep": sleep}))
    turns = processor_share.ProcessorShare()
    for _ in range(100):
        await turns.turn()
        now[0] += 0.01
        turns.spent(0.01)
    assert slept[0] == pytest.approx(0.98, abs=0.05)
    turns.spent(8.0)  # a password that waited in a thread
    await turns.turn()
    assert slept[0] < 1.3
    now[0] += 1
    await turns.turn()
    assert slept[0] < 1.3


async def test_queues_of_a_client_that_fetches_nothing_are_bounded_and_what_they_drop_is_counted() -> None:
    losses, none = Losses(), cast(Any, None)
    made = InternalSubscription(ua.CreateSubscriptionResult(78, 100.0), none, none, ua.NodeId(1), lambda _: None)
    bound(made, losses, lambda: [made])
    for number in range(25):
        await made.enqueue_datachange_event(1, ua.MonitoredItemNotification(number), 10)
        await made.enqueue_datachange_event(2, ua.MonitoredItemNotification(number), 1)
    assert [one.ClientHandle for one in made._triggered_datachanges[1]] == list(range(15, 25))
    assert [one.ClientHandle for one in made._triggered_datachanges[2]] == [24]  # the newest of a queue of one: no loss
    assert (losses.dropped, losses.new_dropped(), losses.new_dropped()) == (15, 15, 0)


@pytest.mark.parametrize(
    ("discards_oldest", "wanted"), [(True, [(5, 0x480), (6, 0), (7, 0)]), (False, [(1, 0), (2, 0), (7, 0x480)])]
)
async def test_a_queue_that_lost_values_says_so_and_keeps_those_that_the_client_wants(
    discards_oldest: bool, wanted: list[tuple[int, int]]
) -> None:
    none = cast(Any, None)
    made = InternalSubscription(
        ua.CreateSubscriptionResult(78, 100.0), AddressSpace(), none, ua.NodeId(1), lambda _: None
    )
    bound(made, Losses(), lambda: [made])
    how = ua.MonitoringParameters(QueueSize=3, DiscardOldest=discards_oldest)
    result, item = made.monitored_item_srv._make_monitored_item_common(
        ua.MonitoredItemCreateRequest(RequestedParameters=how)
    )
    made.monitored_item_srv._commit_monitored_item(result, item)
    values = [ua.DataValue(ua.Variant(number), ua.StatusCode(0)) for number in range(1, 8)]
    for value in values:
        await made.enqueue_datachange_event(
            item.monitored_item_id, ua.MonitoredItemNotification(7, value), item.queue_size
        )
    queued = [one.Value for one in made._triggered_datachanges[item.monitored_item_id]]
    assert [(one.Value.Value, one.StatusCode.value) for one in queued] == wanted
    assert all(one.StatusCode.value == 0 for one in values)  # those of the node and of other clients


async def test_an_item_in_the_mode_sampling_reports_nothing_until_its_mode_is_reporting() -> None:
    none = cast(Any, None)
    made = InternalSubscription(
        ua.CreateSubscriptionResult(78, 100.0), AddressSpace(), none, ua.NodeId(1), lambda _: None
    )
    bound(made, Losses(), lambda: [made])
    service = made.monitored_item_srv
    wanted = ua.MonitoredItemCreateRequest(MonitoringMode=ua.MonitoringMode.Sampling)
    wanted.RequestedParameters.QueueSize = 3
    result, item = service._make_monitored_item_common(wanted)
    service._commit_monitored_item(result, item)
    number = result.MonitoredItemId

    async def queue(*values: int) -> None:
        for value in values:
            news = ua.MonitoredItemNotification(7, ua.DataValue(ua.Variant(value), ua.StatusCode(0)))
            await made.enqueue_datachange_event(number, news, item.queue_size)

    await queue(1, 2, 3, 4)
    assert made._triggered_datachanges == {}
    assert [one.value for one in await service.set_monitoring_mode(ua.MonitoringMode.Reporting, [number])] == [0]
    queued = [one.Value for one in made._triggered_datachanges[number]]
    assert [(one.Value.Value, one.StatusCode.value) for one in queued] == [(2, 0x480), (3, 0), (4, 0)]
    await service.set_monitoring_mode(ua.MonitoringMode.Sampling, [number])
    await queue(5)
    await service.set_monitoring_mode(ua.MonitoringMode.Disabled, [number])  # what was sampled goes
    await service.set_monitoring_mode(ua.MonitoringMode.Sampling, [number])
    await queue(6)
    assert [len(one) for one in (cast(Any, made).sampled, made._triggered_datachanges[number])] == [1, 3]
    service.delete_monitored_items([number])
    assert cast(Any, made).sampled == {}


async def test_orders_of_a_connection_that_is_gone_are_taken_back() -> None:
    wire = await Wire(by.bare_server()).opened()
    processor: Any = wire.protocol.processor
    order = asyncio.ensure_future(asyncio.sleep(60))
    processor._orders.add(order)
    await processor.close()
    await asyncio.sleep(0)
    assert order.cancelled()


def test_a_path_between_nodes_that_name_each_other_twice_does_not_double() -> None:
    here, there = ua.NodeId("here", 2), ua.NodeId("there", 2)

    def way(to: ua.NodeId) -> ua.ReferenceDescription:
        return ua.ReferenceDescription(
            ua.NodeId(ua.ObjectIds.Organizes), True, to, ua.QualifiedName(str(to.Identifier), 2)
        )

    nodes: dict[ua.NodeId, Any] = {}
    for one, other in ((here, there), (there, here)):
        nodes[one] = NodeData(one)
        nodes[one].references = [way(other), way(other)]
    elements = [
        ua.RelativePathElement(ua.NodeId(), False, True, ua.QualifiedName(name, 2)) for name in ("there", "here") * 6
    ]
    assert server._Views(nodes)._navigate(here, elements) == [here]
    assert server._Views(nodes)._navigate(ua.NodeId("nowhere", 2), elements) == []


def test_losses_are_told_once_a_minute_and_counted_always() -> None:
    losses = Losses()
    assert losses.news() == ""
    losses.dropped += 3
    assert losses.news() == "3 values or events were dropped, as clients did not fetch them"
    losses.dropped += 2
    assert losses.news() == ""
    assert losses.dropped == 5


def test_a_filter_whose_elements_name_each_other_is_false_soon() -> None:
    """Each of twelve elements asks for the next one twice; asyncua alone says true behind 4096 steps."""

    def both(number: int) -> ua.ContentFilterElement:
        return ua.ContentFilterElement(ua.FilterOperator.And, [ua.ElementOperand(number + 1)] * 2)

    one = ua.LiteralOperand(ua.Variant(1))
    elements = [*map(both, range(12)), ua.ContentFilterElement(ua.FilterOperator.Equals, [one, one])]
    none: Any = None
    log: Any = type("Log", (), {"exception": lambda *_: None, "warning": lambda *_: None})()
    event: Any = type("Event", (), {"types": (ua.NodeId(),)})()
    assert WhereClause(log, none, ua.ContentFilter(elements[-1:])).eval(event) is True
    assert WhereClause(log, none, ua.ContentFilter(elements)).eval(event) is False
    assert decoding.DEEPEST < 100


def test_monitored_items_that_a_request_names_are_found_without_a_search() -> None:
    """A request may name a thousand of 20 000."""

    class Unsearched(dict[int, Any]):
        def values(self) -> Any:
            raise AssertionError("a search")

        items = values

    made = InternalSubscription(
        ua.CreateSubscriptionResult(78, 100.0), AddressSpace(), cast(Any, None), ua.NodeId(1), lambda _: None
    )
    bound(made, Losses(), lambda: [made])
    service = made.monitored_item_srv
    item = SimpleNamespace(callback_handle=7, where_clause_evaluator=None, filter=None, queue_size=1)
    service._monitored_items = Unsearched({5: item})
    service._monitored_datachange = Unsearched({7: 5})
    wanted = ua.MonitoredItemModifyRequest(5, ua.MonitoringParameters(QueueSize=4))
    assert service._modify_monitored_item(wanted).RevisedQueueSize == item.queue_size == 4
    assert service._delete_monitored_items(5).is_good()
    assert (len(service._monitored_items), len(service._monitored_datachange)) == (0, 0)


class Session:
    """Subscriptions of one session, whose client has asked for messages and acknowledges none."""

    def __init__(self, count: int) -> None:
        self.sent: list[ua.PublishResult] = []
        self.subscriptions = [self._subscription(number) for number in range(count)]

    def _subscription(self, number: int) -> InternalSubscription:
        async def send(result: ua.PublishResult, request: object) -> None:
            self.sent.append(result)

        def asked(subscription: int) -> Any:
            return object()

        data = ua.CreateSubscriptionResult(number, 100.0, 600, 10)
        made = InternalSubscription(data, AddressSpace(), send, ua.NodeId(1), asked, no_acks_limit=MOST_UNACKED)
        bound(made, Losses(), lambda: self.subscriptions)
        return made

    def kept(self) -> int:
        return sum(
            len(getattr(part, "MonitoredItems", ())) + sum(len(one.EventFields) for one in getattr(part, "Events", ()))
            for one in self.subscriptions
            for result in one._not_acknowledged_results.values()
            for part in result.NotificationMessage.NotificationData
        )


async def test_values_that_a_session_does_not_acknowledge_are_bounded_over_its_subscriptions() -> None:
    session = Session(6)
    for _ in range(4):
        for one in session.subscriptions:
            for item in range(600):
                await one.enqueue_datachange_event(item, ua.MonitoredItemNotification(), 10)
            await one.publish_results()
            assert session.kept() <= MOST_UNACKED_VALUES
    assert len(session.sent) == 24
    assert session.kept() > MOST_UNACKED_VALUES - 600
    newest = session.sent[-1]
    assert newest.AvailableSequenceNumbers == list(session.subscriptions[-1]._not_acknowledged_results)
    assert newest.NotificationMessage.SequenceNumber in newest.AvailableSequenceNumbers


async def test_a_message_has_no_more_than_its_values_and_fields_and_the_next_one_has_the_others() -> None:
    session = Session(1)
    [one] = session.subscriptions
    for number in range(3):
        for item in range(MOST_IN_MESSAGE // 2):
            await one.enqueue_datachange_event(item + number * 10_000, ua.MonitoredItemNotification(), 10)
    fields = [ua.Variant()] * 100
    for handle in range(MOST_FIELDS_IN_MESSAGE // 100 + 50):
        await one.enqueue_event(7, ua.EventFieldList(handle, fields), 4200)
    await one.enqueue_event(8, ua.EventFieldList(1000, fields), 4200)
    while await one.publish_results():
        pass
    values, events = [], []
    for result in session.sent:
        parts = result.NotificationMessage.NotificationData
        values += [len(part.MonitoredItems) for part in parts if isinstance(part, ua.DataChangeNotification)]
        events += [
            [it.ClientHandle for it in part.Events] for part in parts if isinstance(part, ua.EventNotificationList)
        ]
    assert values == [MOST_IN_MESSAGE, MOST_IN_MESSAGE // 2]
    assert events == [list(range(200)), [*range(200, 250), 1000]]
    assert session.kept() <= MOST_UNACKED_VALUES + MOST_FIELDS_IN_MESSAGE


async def test_garbage_is_not_looked_for_among_standard_nodes_and_is_again_afterwards() -> None:
    seen: list[bool] = []

    class Service:
        fails = False

        def try_add_nodes(self, nodes: list[ua.AddNodesItem], *, check: bool) -> list[object]:
            seen.append(gc.isenabled())
            return nodes[:0]

        def try_add_references(self, references: list[ua.AddReferencesItem]) -> list[object]:
            if self.fails:
                raise MemoryError
            return references[:0]

    service = Service()
    await add_standard_nodes(service)
    assert gc.isenabled()
    service.fails = True
    with pytest.raises(MemoryError):
        await add_standard_nodes(service)
    assert gc.isenabled()
    assert set(seen) == {False}
