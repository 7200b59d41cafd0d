"""Subscriptions of asyncua whose messages, queues, filters and lookups are bounded."""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any, Final

from asyncua import ua
from asyncua.server.internal_subscription import InternalSubscription
from asyncua.server.monitored_item_service import MonitoredItemData, MonitoredItemService, WhereClauseEvaluator

# the class that is decoded; ua.DataChangeFilter is made of it, for clients
from asyncua.ua.uaprotocol_auto import DataChangeFilter

#: values, and fields of events, in one message; the others come with the next one
MOST_IN_MESSAGE: Final = 5000
MOST_FIELDS_IN_MESSAGE: Final = 20_000
#: values and fields of events in messages that a session has not acknowledged; its newest message is always kept
MOST_UNACKED_VALUES: Final = 10_000
#: fields of an event that a client selects; elements of its filter; their evaluations for one event
MOST_FIELDS: Final = 100
MOST_ELEMENTS: Final = 50
_MOST_STEPS: Final = 200
#: info bits of a status code: they concern a data value, and its queue has lost others (Part 4 of 1.04, 5.12.1.5)
_OVERFLOW: Final = 0x0480
#: s between two remarks about clients
_REMARK_S: Final = 60.0
_REFRESHES: Final = frozenset(
    ua.NodeId(one) for one in (ua.ObjectIds.RefreshStartEventType, ua.ObjectIds.RefreshEndEventType)
)


class Losses:
    """Clients that were cut off, and notifications that were dropped, until :meth:`news` reports them."""

    def __init__(self) -> None:
        self.dropped = 0
        self._told_dropped = self._counted = 0
        self._cut: Counter[str] = Counter()
        self._last = ""
        self._told_at = -_REMARK_S

    def cut_off(self, address: str, why: str) -> None:
        """``why``: one of a few texts, such as "did not read its answers"."""
        self._cut[why] += 1
        self._last = address

    def new_dropped(self) -> int:
        """The notifications that were dropped since the last call."""
        new, self._counted = self.dropped - self._counted, self.dropped
        return new

    def news(self) -> str:
        """One line about what happened since the last one, at most one a minute; empty: nothing to report."""
        new = self.dropped - self._told_dropped
        now = time.monotonic()
        if not (new or self._cut) or now < self._told_at + _REMARK_S:
            return ""
        parts = [f"{count} x a client was cut off, as it {why}" for why, count in self._cut.items()]
        if parts:
            parts[-1] += f" (last: {self._last})"
        if new:
            parts.append(f"{new} values or events were dropped, as clients did not fetch them")
        self._cut.clear()
        self._told_dropped, self._told_at = self.dropped, now
        return "; ".join(parts)


class Subscription(InternalSubscription):
    """A subscription whose messages are bounded: clients refuse those of many megabytes. Made of one of asyncua, which
    leaves no other place, by :func:`bound`."""

    losses: Losses
    #: all subscriptions of the same session
    of_session: Callable[[], Iterable[InternalSubscription]]
    #: what items in the mode Sampling have queued, which is not reported
    sampled: dict[int, list[Any]]
    _triggered_datachanges: dict[int, list[Any]]
    _triggered_events: dict[int, list[Any]]

    def _pop_triggered_datachanges(self, result: ua.PublishResult) -> None:
        rest: dict[int, list[Any]] = {}
        count = 0
        for item, values in tuple(self._triggered_datachanges.items()):
            count += len(values)
            if count > MOST_IN_MESSAGE:
                rest[item] = self._triggered_datachanges.pop(item)
        super()._pop_triggered_datachanges(result)
        self._triggered_datachanges = rest

    def _pop_triggered_events(self, result: ua.PublishResult) -> None:
        rest: dict[int, list[Any]] = {}
        fields = 0
        for item, events in tuple(self._triggered_events.items()):
            for number, event in enumerate(events):
                fields += len(event.EventFields)
                if fields > MOST_FIELDS_IN_MESSAGE:
                    rest[item] = events[number:]
                    del events[number:]
                    break
            if not events:
                del self._triggered_events[item]
        super()._pop_triggered_events(result)
        self._triggered_events = rest

    def _pop_publish_result(self) -> ua.PublishResult:
        result = super()._pop_publish_result()
        kept = [[one, _weights(one)] for one in self.of_session()]
        while sum(sum(weights) for _, weights in kept) > MOST_UNACKED_VALUES:
            # the oldest message of the subscription with most
            one, weights = max(kept, key=lambda pair: sum(pair[1]))
            results = one._not_acknowledged_results
            oldest = next(iter(results))
            if results[oldest] is result:
                break
            del results[oldest]
            del weights[0]
        result.AvailableSequenceNumbers = list(self._not_acknowledged_results)
        return result

    async def _enqueue_event(self, mid: int, eventdata: Any, size: int, queue: dict[int, list[Any]]) -> None:
        item = self.monitored_item_srv._monitored_items.get(mid)
        if item is not None and item.mode == ua.MonitoringMode.Sampling:
            queue = self.sampled
        # a queue of one holds the newest value: that one takes its place is no loss
        if size <= 1 or len(queue.get(mid, ())) < size:
            await super()._enqueue_event(mid, eventdata, size, queue)
            return
        self.losses.dropped += 1
        if getattr(item, "keeps_oldest", False):
            queue[mid][-1] = _marked(eventdata)
            return
        await super()._enqueue_event(mid, eventdata, size, queue)
        queue[mid][0] = _marked(queue[mid][0])


class Item(MonitoredItemData):
    """A monitored item that knows which values a full queue gives up."""

    #: the client wants the oldest values: a new one replaces the last one in the queue
    keeps_oldest: bool = False


class Items(MonitoredItemService):
    """The monitored items of a subscription, found without a search: a request may name a thousand of 20 000. A dead
    band counts from the value that was queued last, and never holds a new status back (Part 4, 7.22.2)."""

    isub: Subscription

    async def datachange_callback(self, handle: int, value: ua.DataValue, error: ua.StatusCode | None = None) -> None:
        if error:
            await super().datachange_callback(handle, value, error)
            return
        number = self._monitored_datachange[handle]
        item = self._monitored_items[number]
        if item.mode == ua.MonitoringMode.Disabled or not _is_news(item.mvalue.current_dvalue, value, item.filter):
            return
        item.mvalue.set_current_datavalue(value)
        news = ua.MonitoredItemNotification(item.client_handle, value)
        await self.isub.enqueue_datachange_event(number, news, item.queue_size)

    def _make_monitored_item_common(
        self, params: ua.MonitoredItemCreateRequest
    ) -> tuple[ua.MonitoredItemCreateResult, MonitoredItemData]:
        result, item = super()._make_monitored_item_common(params)
        item.__class__ = Item
        item.keeps_oldest = not params.RequestedParameters.DiscardOldest
        return result, item

    def _modify_monitored_item(self, params: ua.MonitoredItemModifyRequest) -> ua.MonitoredItemModifyResult:
        result = ua.MonitoredItemModifyResult()
        item = self._monitored_items.get(params.MonitoredItemId)
        if item is None:
            result.StatusCode = ua.StatusCode(ua.StatusCodes.BadMonitoredItemIdInvalid)
            return result
        asked, is_event = params.RequestedParameters, item.where_clause_evaluator is not None
        found, fault = judged_filter(asked.Filter, is_event=is_event)
        if fault is not None:
            result.StatusCode = ua.StatusCode(fault)
            return result
        if found is not None:
            item.filter = found
            if is_event:
                item.where_clause_evaluator = WhereClause(self.logger, self.aspace, found.WhereClause)
        if not is_event:
            item.queue_size = asked.QueueSize
            item.keeps_oldest = not asked.DiscardOldest
        result.RevisedSamplingInterval = self.isub.data.RevisedPublishingInterval
        result.RevisedQueueSize = item.queue_size
        return result

    async def _set_monitoring_mode(self, mode: ua.MonitoringMode, mid: int) -> ua.StatusCode:
        result = await super()._set_monitoring_mode(mode, mid)
        item = self._monitored_items.get(mid)
        held = () if mode == ua.MonitoringMode.Sampling else self.isub.sampled.pop(mid, ())
        if item is not None and mode == ua.MonitoringMode.Reporting:
            is_event = item.where_clause_evaluator is not None
            queue = self.isub._triggered_events if is_event else self.isub._triggered_datachanges
            for one in held:
                await self.isub._enqueue_event(mid, one, item.queue_size, queue)
        return result

    def _delete_monitored_items(self, mid: int) -> ua.StatusCode:
        self.isub.sampled.pop(mid, None)
        item = self._monitored_items.get(mid)
        if item is None or item.callback_handle is None:
            return super()._delete_monitored_items(mid)  # events: there are few
        self.aspace.delete_datachange_callback(item.callback_handle)
        self._monitored_datachange.pop(item.callback_handle, None)
        del self._monitored_items[mid]
        for queue in (self.isub._triggered_datachanges, self.isub._triggered_events):
            queue.pop(mid, None)
        return ua.StatusCode()


def bound(made: InternalSubscription, losses: Losses, of_session: Callable[[], Iterable[InternalSubscription]]) -> None:
    """Make a subscription of asyncua one with bounds. ``of_session``: all subscriptions of the same session."""
    made.__class__ = Subscription
    made.losses = losses
    made.of_session = of_session
    made.sampled = {}
    made.monitored_item_srv.__class__ = Items


def _marked(notification: Any) -> Any:
    """A value with the mark that its queue has lost others. A copy: other clients get the same value without it."""
    if not isinstance(notification, ua.MonitoredItemNotification):
        return notification
    value = notification.Value
    code = 0 if value.StatusCode is None else value.StatusCode.value
    return dataclasses.replace(
        notification, Value=dataclasses.replace(value, StatusCode=ua.StatusCode(code | _OVERFLOW))
    )


def _weights(subscription: InternalSubscription) -> list[int]:
    """The values and fields in each message that was not acknowledged, oldest first."""
    return [
        sum(_weight(one) for one in result.NotificationMessage.NotificationData)
        for result in subscription._not_acknowledged_results.values()
    ]


def _weight(notification: Any) -> int:
    if isinstance(notification, ua.DataChangeNotification):
        return len(notification.MonitoredItems)
    if isinstance(notification, ua.EventNotificationList):
        return sum(len(one.EventFields) for one in notification.Events)
    return 1


def _is_news(old: ua.DataValue | None, new: ua.DataValue, given: DataChangeFilter | None) -> bool:
    """Whether a client wants to know of ``new``, when it got ``old``. ``given``: its filter."""
    trigger = ua.DataChangeTrigger.StatusValue if given is None else given.Trigger
    has_deadband = given is not None and given.DeadbandType == ua.DeadbandType.Absolute
    if old is None or old.StatusCode != new.StatusCode:
        return True
    if trigger == ua.DataChangeTrigger.Status:
        return False
    if old.Value != new.Value:
        before, after = (None if one.Value is None else one.Value.Value for one in (old, new))
        if given is None or not has_deadband:
            return True
        if not isinstance(before, (int, float)) or not isinstance(after, (int, float)):
            return True
        return not abs(after - before) <= given.DeadbandValue  # true if one of them is NaN
    is_timed = trigger == ua.DataChangeTrigger.StatusValueTimestamp and not has_deadband
    return is_timed and (old.SourceTimestamp, old.SourcePicoseconds) != (new.SourceTimestamp, new.SourcePicoseconds)


def judged_filter(given: Any, *, is_event: bool) -> tuple[Any, int | None]:
    """The filter of a monitored item, None without one, and the status code that refuses it."""
    if given is None or (isinstance(given, ua.ExtensionObject) and given.TypeId.Identifier == 0):
        return None, int(ua.StatusCodes.BadEventFilterInvalid) if is_event else None
    if is_event:
        if not isinstance(given, ua.EventFilter):
            return None, int(ua.StatusCodes.BadFilterNotAllowed)
        fields, elements = given.SelectClauses or (), given.WhereClause.Elements or ()
        if not 0 < len(fields) <= MOST_FIELDS or len(elements) > MOST_ELEMENTS:
            return None, int(ua.StatusCodes.BadEventFilterInvalid)
    elif not isinstance(given, DataChangeFilter) or given.DeadbandType == ua.DeadbandType.Percent:
        return None, int(ua.StatusCodes.BadMonitoredItemFilterUnsupported)
    return given, None


class WhereClause(WhereClauseEvaluator):
    """``OfType`` is true for subtypes, too (Part 4, 7.7.3), for instance ConditionType for an alarm. Begin and end of a
    refresh pass every filter (Part 9, 4.5). A filter whose elements name each other again and again is false."""

    #: the event of the moment, and the steps for it
    _event: Any = None
    _steps = 0

    def _eval_el(self, index: int, event: Any) -> Any:
        if event.types[0] in _REFRESHES:
            return True
        if event is not self._event:
            self._event, self._steps = event, 0
        self._steps += 1
        if self._steps > _MOST_STEPS:
            raise ValueError("a filter of too many steps")
        element = self.elements[index]
        if element.FilterOperator == ua.FilterOperator.OfType:
            return self._eval_op(element.FilterOperands[0], event) in event.types
        return super()._eval_el(index, event)
