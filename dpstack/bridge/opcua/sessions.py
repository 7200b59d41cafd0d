"""The sessions of the OPC UA server with rights and limits. ``connection`` has its connections.

asyncua 2.1 lets a client use subscriptions of other sessions, and ask for more than the loop of a bus can wait for. The
classes here refuse that. :class:`Services` is what the plant answers to writes, method calls and reads of history.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import secrets
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, Protocol

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.address_space import ViewService
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession, SessionState
from asyncua.server.internal_subscription import InternalSubscription

from dpstack.bridge.opcua.decoding import guard
from dpstack.bridge.opcua.standard_nodes import add_standard_nodes
from dpstack.bridge.opcua.subscriptions import Losses, WhereClause, bound, judged_filter
from dpstack.bridge.opcua.users import Account, Users
from dpstack.bridge.processor_share import ProcessorShare

MOST_CONNECTIONS: Final = 32
MOST_SESSIONS: Final = 16
MOST_SUBSCRIPTIONS: Final = 64
#: monitored items of all sessions: of values, each with a queue of this many; of events, each with room for a refresh
MOST_ITEMS: Final = 20_000
MOST_QUEUE: Final = 10
MOST_EVENT_ITEMS: Final = 16
MOST_EVENTS: Final = 4200
#: notifications that are kept until the client acknowledges them, of one subscription
MOST_UNACKED: Final = 5
#: ms: the shortest interval of a subscription; values come five times a second
FASTEST_MS: Final = 100.0
#: requests of one connection that wait
MOST_WAITING: Final = 50
#: nodes, items or methods in one request
MOST_OPERATIONS: Final = 1000
#: references in an answer to Browse, and octets of texts in one to Read; beyond that single results are refused. A node
#: alone is always answered
MOST_REFERENCES: Final = 2000
_MOST_OCTETS: Final = 1 << 20
#: nodes on the way of a path at a time; nodes of one request that are worked on until others have their turn
_MOST_TARGETS: Final = 100
_AT_ONCE: Final = 25
_S = ua.StatusCodes
_BAD_ITEMS: Final = ua.StatusCode(_S.BadTooManyMonitoredItems)
#: a part of a value, by an index range
_BAD_PART: Final = ua.StatusCode(_S.BadIndexRangeNoData)


class Services(Protocol):
    """Writes and calls of clients, all of one request. ``who`` None: an anonymous one, which may only read."""

    async def write(self, values: Sequence[ua.WriteValue], who: Account | None) -> list[ua.StatusCode]: ...

    async def call(
        self, methods: Sequence[ua.CallMethodRequest], who: Account | None, session: LimitedSession
    ) -> list[ua.CallMethodResult]: ...


class LimitedServer(InternalServer):
    """Limits, users and services of the server. ``refuses``: the status code that refuses a client's certificate."""

    def __init__(
        self, users: Users | None, *, anonymous: bool, services: Services, refuses: Callable[[bytes], int | None]
    ) -> None:
        self.users = users
        self.anonymous = anonymous
        self.services = services
        self.refuses = refuses
        #: users whose password was found right a moment ago, by name and digest of the password
        self.verified: dict[tuple[str, bytes], Account] = {}
        self.losses = Losses()
        self.pace = ProcessorShare()
        guard()
        super().__init__(user_manager=_UserManager())
        self.view_service = _Views(self.aspace)
        self.disabled_clock = True
        self.allow_remote_admin = False
        self.max_connections = MOST_CONNECTIONS
        self.max_subscriptions = MOST_SUBSCRIPTIONS
        self.max_monitored_item_queue_size = MOST_EVENTS
        self.max_unacked_messages_per_subscription = MOST_UNACKED
        self.max_pending_messages_per_connection = MOST_WAITING
        self.max_pending_activation_seconds = 10.0
        self.max_session_timeout_ms = 120_000
        self.max_lifetime_count = 600
        self.max_keep_alive_count = 200
        tokens: list[type] = [ua.AnonymousIdentityToken] if anonymous else []
        self.supported_tokens = (*tokens, ua.UserNameIdentityToken)

    @property
    def sessions(self) -> Sequence[InternalSession]:
        return tuple(self._external_sessions.values())

    async def load_standard_address_space(self, shelffile: object = None) -> None:
        await add_standard_nodes(self.node_mgt_service)

    def create_session(self, name: str, user: User | None = None, external: bool = False) -> InternalSession:
        if external and len(self._external_sessions) >= MOST_SESSIONS:
            raise ServiceError(_S.BadTooManySessions)
        return LimitedSession(self, name)

    @property
    def views(self) -> _Views:
        assert isinstance(self.view_service, _Views)
        return self.view_service

    def count_items(self) -> tuple[int, int]:
        """Monitored items of values and of events, of all sessions."""
        services = [one.monitored_item_srv for one in self.subscription_service.subscriptions.values()]
        every = sum(len(one._monitored_items) for one in services)
        events = sum(len(ids) for one in services for ids in one._monitored_events.values())
        return every - events, events


class _Views(ViewService):
    """Browse and paths without the search through all subtypes for each reference."""

    def __init__(self, aspace: Any) -> None:
        super().__init__(aspace)
        self._below: dict[ua.NodeId, frozenset[ua.NodeId]] = {}

    def is_reference_type(self, type_: ua.NodeId) -> bool:
        """Also true for the null NodeId, which stands for all references."""
        if type_.is_null():
            return True
        node = self._aspace.get(type_)
        class_ = None if node is None else node.attributes.get(ua.AttributeIds.NodeClass)
        value = None if class_ is None or class_.value is None else class_.value.Value
        return value is not None and value.Value == ua.NodeClass.ReferenceType

    def _suitable_reftype(self, ref1: ua.NodeId, ref2: ua.NodeId, subtypes: bool) -> bool:
        if ref1.is_null() or ref1 == ref2:
            return True
        if not subtypes:
            return False
        below = self._below.get(ref1)
        if below is None:
            if not self.is_reference_type(ref1):
                return False
            below = self._below[ref1] = frozenset(self._get_sub_ref(ref1))
        return ref2 in below

    def browse_node(self, asked: ua.BrowseDescription) -> ua.BrowseResult:
        return self._browse(asked)

    def _navigate(self, start_nodeid: ua.NodeId, elements: list[ua.RelativePathElement]) -> list[ua.NodeId]:
        nodes = [start_nodeid]
        for one in elements:
            found = (way for node in nodes if node in self._aspace for way in self._find_elements_in_node(one, node))
            nodes = list(dict.fromkeys(found))[:_MOST_TARGETS]
        return nodes


class _PlantUser(User):
    """A user of asyncua with the account; None: anonymous."""

    def __init__(self, account: Account | None) -> None:
        super().__init__(UserRole.User, account.name if account else None)
        self.account = account


class _UserManager:
    def get_user(
        self, iserver: Any, username: str | None = None, password: str | None = None, certificate: object = None
    ) -> User | None:
        if username is None:
            return _PlantUser(None) if iserver.anonymous else None
        account = iserver.verified.pop((username, digest(password)), None)
        return None if account is None else _PlantUser(account)


def digest(password: str | None) -> bytes:
    return hashlib.sha256((password or "").encode("utf-8", "surrogatepass")).digest()


class LimitedSession(InternalSession):
    """A session that sees only its own subscriptions; its token cannot be guessed."""

    iserver: LimitedServer
    user: User

    def __init__(self, server: LimitedServer, name: str) -> None:
        super().__init__(server, server.aspace, server.subscription_service, name, external=False)
        self.external = True
        self.auth_token = ua.NodeId(secrets.token_bytes(32), 0, ua.NodeIdType.ByteString)
        server.register_external_session(self)

    @property
    def account(self) -> Account | None:
        return self.user.account if isinstance(self.user, _PlantUser) else None

    def activate_session(
        self, params: ua.ActivateSessionParameters, peer_certificate: bytes | None
    ) -> ua.ActivateSessionResult:
        before, was = self.user, self.state
        result = super().activate_session(params, peer_certificate)
        if was is SessionState.Activated and before.name != self.user.name:
            # another client with the token of this session would change its rights
            self.user = before
            raise ServiceError(_S.BadIdentityChangeNotSupported)
        return result

    async def read(self, params: ua.ReadParameters) -> list[ua.DataValue]:
        _limit(params.NodesToRead)
        found: list[ua.DataValue] = []
        octets = 0
        for part in _parts(params.NodesToRead):
            read = self.iserver.attribute_service.read(ua.ReadParameters(NodesToRead=list(part)))
            for asked, one in zip(part, read, strict=True):
                text = one.Value.Value if one.Value is not None else None
                if asked.IndexRange and text is not None:  # asyncua would give the whole value as if it were the part
                    found.append(ua.DataValue(StatusCode=_BAD_PART))
                    continue
                octets += len(text) if isinstance(text, (bytes, str)) else 0
                fits = octets <= _MOST_OCTETS or not found
                found.append(one if fits else ua.DataValue(StatusCode=ua.StatusCode(_S.BadResponseTooLarge)))
            await asyncio.sleep(0)
        account = self.account
        if account is None or not account.control:
            for number, one in enumerate(params.NodesToRead):
                if one.AttributeId == ua.AttributeIds.UserExecutable and found[number].StatusCode.is_good():
                    found[number] = ua.DataValue(ua.Variant(False, ua.VariantType.Boolean))
                elif one.AttributeId == ua.AttributeIds.UserAccessLevel and found[number].Value is not None:
                    level = int(found[number].Value.Value or 0) & ~(1 << ua.AccessLevel.CurrentWrite)
                    found[number] = ua.DataValue(ua.Variant(level, ua.VariantType.Byte))
        return found

    async def browse(self, params: ua.BrowseParameters) -> list[ua.BrowseResult]:
        _limit(params.NodesToBrowse)
        views = self.iserver.views
        found: list[ua.BrowseResult] = []
        references = 0
        for part in _parts(params.NodesToBrowse):
            for one in part:
                if references >= MOST_REFERENCES:
                    found.append(ua.BrowseResult(ua.StatusCode(_S.BadNoContinuationPoints)))
                    continue
                if not views.is_reference_type(one.ReferenceTypeId):
                    found.append(ua.BrowseResult(ua.StatusCode(_S.BadReferenceTypeIdInvalid)))
                    continue
                result = views.browse_node(one)
                if references and references + len(result.References) > MOST_REFERENCES:
                    result = ua.BrowseResult(ua.StatusCode(_S.BadNoContinuationPoints))
                references += len(result.References)
                found.append(result)
            await asyncio.sleep(0)
        return found

    async def translate_browsepaths_to_nodeids(self, params: list[ua.BrowsePath]) -> list[ua.BrowsePathResult]:
        _limit(params)
        if sum(len(one.RelativePath.Elements) for one in params) > MOST_OPERATIONS:
            raise ServiceError(_S.BadTooManyOperations)
        found: list[ua.BrowsePathResult] = []
        for one in params:
            if one.RelativePath.Elements:
                found += await super().translate_browsepaths_to_nodeids([one])
            else:
                found.append(ua.BrowsePathResult(ua.StatusCode(_S.BadNothingToDo)))
            if len(found) % _AT_ONCE == 0:
                await asyncio.sleep(0)
        return found

    async def history_read(self, params: ua.HistoryReadParameters) -> list[ua.HistoryReadResult]:
        if len(params.NodesToRead) > 10:
            raise ServiceError(_S.BadTooManyOperations)
        found: list[ua.HistoryReadResult] = []
        nodes, params.NodesToRead = params.NodesToRead, []
        for one in nodes:
            params.NodesToRead = [one]
            found += await super().history_read(params)
            await asyncio.sleep(0)
        return found

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        _limit(params.NodesToWrite)
        return await self.iserver.services.write(params.NodesToWrite, self.account)

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        _limit(params)
        return await self.iserver.services.call(params, self.account, self)

    # --- subscriptions --------------------------------------------------------------------------------------------

    def owns(self, subscription: int) -> bool:
        found = self.subscription_service.subscriptions.get(subscription)
        return found is not None and found.session_id == self.session_id

    def _own_subscriptions(self) -> list[InternalSubscription]:
        return [one for one in self.subscription_service.subscriptions.values() if one.session_id == self.session_id]

    def _check_own(self, subscription: int) -> None:
        if not self.owns(subscription):
            raise ServiceError(_S.BadSubscriptionIdInvalid)

    async def create_subscription(
        self, params: ua.CreateSubscriptionParameters, callback: Callable[..., Any],
        request_callback: Callable[..., Any] | None = None,
    ) -> ua.CreateSubscriptionResult:  # fmt: skip
        interval = params.RequestedPublishingInterval
        params.RequestedPublishingInterval = min(max(interval, FASTEST_MS), 3_600_000.0) if interval > 0 else FASTEST_MS
        made = await super().create_subscription(params, callback, request_callback)
        bound(
            self.subscription_service.subscriptions[made.SubscriptionId], self.iserver.losses, self._own_subscriptions
        )
        return made

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        self._check_own(params.SubscriptionId)
        _limit(params.ItemsToCreate)
        made = self.subscription_service.subscriptions[params.SubscriptionId].monitored_item_srv._monitored_items
        values, events = self.iserver.count_items()
        results: list[ua.MonitoredItemCreateResult] = []
        given, params.ItemsToCreate = params.ItemsToCreate, []
        for one in given:
            asked = one.RequestedParameters
            is_event = one.ItemToMonitor.AttributeId == ua.AttributeIds.EventNotifier
            if one.ItemToMonitor.IndexRange:
                results.append(ua.MonitoredItemCreateResult(_BAD_PART))
                continue
            asked.Filter, fault = judged_filter(asked.Filter, is_event=is_event)
            if fault is not None:
                results.append(ua.MonitoredItemCreateResult(ua.StatusCode(fault)))
                continue
            if is_event:
                events += 1
                fits = events <= MOST_EVENT_ITEMS
                asked.QueueSize = MOST_EVENTS
            else:
                values += 1
                fits = values <= MOST_ITEMS
                asked.QueueSize = min(max(asked.QueueSize, 1), MOST_QUEUE)
            if not fits:
                results.append(ua.MonitoredItemCreateResult(_BAD_ITEMS))
                continue
            params.ItemsToCreate = [one]
            results += await super().create_monitored_items(params)
            if is_event and results[-1].StatusCode.is_good():
                item = made[results[-1].MonitoredItemId]
                item.where_clause_evaluator = WhereClause(self.logger, self.aspace, item.filter.WhereClause)
            if len(results) % _AT_ONCE == 0:
                await asyncio.sleep(0)
                self._check_own(params.SubscriptionId)  # it can be gone meanwhile
                values, events = self.iserver.count_items()  # others have made theirs
        return results

    async def modify_monitored_items(
        self, params: ua.ModifyMonitoredItemsParameters
    ) -> list[ua.MonitoredItemModifyResult]:
        self._check_own(params.SubscriptionId)
        _limit(params.ItemsToModify)
        for one in params.ItemsToModify:
            one.RequestedParameters.QueueSize = min(max(one.RequestedParameters.QueueSize, 1), MOST_QUEUE)
        return await super().modify_monitored_items(params)

    async def delete_monitored_items(self, params: ua.DeleteMonitoredItemsParameters) -> list[ua.StatusCode]:
        self._check_own(params.SubscriptionId)
        _limit(params.MonitoredItemIds)
        return await super().delete_monitored_items(params)

    async def set_monitoring_mode(self, params: ua.SetMonitoringModeParameters) -> list[ua.StatusCode]:
        self._check_own(params.SubscriptionId)
        _limit(params.MonitoredItemIds)
        return await super().set_monitoring_mode(params)

    def modify_subscription(self, params: ua.ModifySubscriptionParameters) -> ua.ModifySubscriptionResult:
        self._check_own(params.SubscriptionId)
        return super().modify_subscription(params)

    async def set_publishing_mode(self, params: ua.SetPublishingModeParameters) -> list[ua.StatusCode]:
        for one in params.SubscriptionIds:
            self._check_own(one)
        return await super().set_publishing_mode(params)

    def publish(self, acks: Iterable[ua.SubscriptionAcknowledgement] | None = None) -> tuple[int, list[ua.StatusCode]]:
        own = {number for number in self.subscription_service.subscriptions if self.owns(number)}
        if not own:
            raise ServiceError(_S.BadNoSubscription)
        results: list[ua.StatusCode] = []
        for one in acks or ():
            if one.SubscriptionId in own:
                self.subscription_service.subscriptions[one.SubscriptionId].publish([one.SequenceNumber])
            results.append(ua.StatusCode(_S.Good if one.SubscriptionId in own else _S.BadSubscriptionIdInvalid))
        return len(own), results

    def republish(self, params: ua.RepublishParameters) -> ua.NotificationMessage:
        self._check_own(params.SubscriptionId)
        found = super().republish(params)
        if not found.NotificationData:
            raise ServiceError(_S.BadMessageNotAvailable)
        return found

    async def delete_subscriptions(self, ids: list[int]) -> list[ua.StatusCode]:
        bad = ua.StatusCode(_S.BadSubscriptionIdInvalid)
        return [(await super(LimitedSession, self).delete_subscriptions([one]))[0] if self.owns(one) else bad
                for one in ids]  # fmt: skip

    async def transfer_subscriptions(
        self, params: ua.TransferSubscriptionsParameters, callback: Callable[..., Any]
    ) -> list[ua.TransferResult]:
        # a session that goes on over a new connection keeps its subscriptions; another one makes its own
        return [ua.TransferResult(ua.StatusCode(_S.BadSubscriptionIdInvalid)) for _ in params.SubscriptionIds]


def _limit(operations: Sequence[object]) -> None:
    if not operations:
        raise ServiceError(_S.BadNothingToDo)
    if len(operations) > MOST_OPERATIONS:
        raise ServiceError(_S.BadTooManyOperations)


def _parts(operations: Sequence[Any]) -> Iterable[Sequence[Any]]:
    return (operations[at : at + _AT_ONCE] for at in range(0, len(operations), _AT_ONCE))


def quieten() -> None:
    """Keep the log of asyncua away from the terminal: it quotes clients, at any rate."""
    log = logging.getLogger("asyncua")
    log.addHandler(logging.NullHandler())
    log.propagate = False
