"""Memory of the OPC UA server: messages that a client does not acknowledge; garbage collection at the start."""

from __future__ import annotations

import gc
from typing import Any

import pytest
from asyncua import ua
from asyncua.server.address_space import AddressSpace
from asyncua.server.internal_subscription import InternalSubscription

from dpstack.bridge.opcua.sessions import MOST_UNACKED
from dpstack.bridge.opcua.standard_nodes import add_standard_nodes
from dpstack.bridge.opcua.subscriptions import (
    MOST_FIELDS_IN_MESSAGE,
    MOST_IN_MESSAGE,
    MOST_UNACKED_VALUES,
    Losses,
    bound,
)


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
