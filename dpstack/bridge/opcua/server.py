"""The OPC UA server of asyncua with rights and limits: each session, subscription and connection is bounded.

asyncua 2.1 lets a client open a session over a channel without security, use subscriptions of other sessions, and send
requests faster than it reads answers. The classes here refuse that. :class:`Services` is what the plant answers to
writes, method calls and reads of history.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import secrets
import socket
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Any, Final, Protocol

from asyncua import Server, ua
from asyncua.common.utils import Buffer, ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.crypto.security_policies import SecurityPolicyNone
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession, SessionState
from asyncua.server.internal_subscription import InternalSubscription
from asyncua.server.monitored_item_service import WhereClauseEvaluator
from asyncua.server.standard_address_space import standard_address_space
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import nodeid_from_binary, struct_from_binary, uatcp_to_binary

from dpstack.bridge.opcua.users import Account, Users

MOST_CONNECTIONS: Final = 32
MOST_SESSIONS: Final = 16
MOST_SUBSCRIPTIONS: Final = 64
#: monitored items of all sessions: of values, each with a queue of so many; of events, each with room for a refresh
MOST_ITEMS: Final = 20_000
MOST_QUEUE: Final = 10
MOST_EVENT_ITEMS: Final = 16
MOST_EVENTS: Final = 4200
#: notifications that are kept until the client acknowledges them, of one subscription
MOST_UNACKED: Final = 5
#: values in one message; the others come with the next one
MOST_IN_MESSAGE: Final = 5000
#: ms: the shortest interval of a subscription; values come five times a second
FASTEST_MS: Final = 100.0
#: octets of a request, and of answers that a client has not read
_MOST_REQUEST: Final = 4 << 20
_MOST_UNREAD: Final = 4 << 20
_CHUNK: Final = 65_535
#: requests of one connection that wait; orders of one that are carried out at a time
_MOST_WAITING: Final = 50
_MOST_ORDERS: Final = 8
#: nodes, items or methods in one request
MOST_OPERATIONS: Final = 1000
_UNSECURED: Final = frozenset(
    ua.NodeId(one)
    for one in (
        ua.ObjectIds.GetEndpointsRequest_Encoding_DefaultBinary,
        ua.ObjectIds.FindServersRequest_Encoding_DefaultBinary,
    )
)
_WITHOUT_USER: Final = _UNSECURED | {
    ua.NodeId(ua.ObjectIds.CreateSessionRequest_Encoding_DefaultBinary),
    ua.NodeId(ua.ObjectIds.ActivateSessionRequest_Encoding_DefaultBinary),
    ua.NodeId(ua.ObjectIds.CloseSessionRequest_Encoding_DefaultBinary),
}
_ACTIVATE: Final = ua.NodeId(ua.ObjectIds.ActivateSessionRequest_Encoding_DefaultBinary)
#: they may take long, and must not hold up a stop that comes behind them over the same connection
_ORDERS: Final = frozenset(
    ua.NodeId(one)
    for one in (ua.ObjectIds.CallRequest_Encoding_DefaultBinary, ua.ObjectIds.WriteRequest_Encoding_DefaultBinary)
)
_STARTS: Final = (b"HEL", b"OPN", b"MSG", b"CLO", b"ERR")
_REFRESHES: Final = frozenset(
    ua.NodeId(one) for one in (ua.ObjectIds.RefreshStartEventType, ua.ObjectIds.RefreshEndEventType)
)
_BAD_ITEMS: Final = ua.StatusCode(ua.StatusCodes.BadTooManyMonitoredItems)


class Services(Protocol):
    """Writes and calls of clients. ``who`` None: an anonymous one, which may only read."""

    async def write(self, value: ua.WriteValue, who: Account | None) -> ua.StatusCode: ...

    async def call(
        self, method: ua.CallMethodRequest, who: Account | None, session: LimitedSession
    ) -> ua.CallMethodResult: ...


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
        super().__init__(user_manager=_UserManager())
        self.disabled_clock = True
        self.allow_remote_admin = False
        self.max_connections = MOST_CONNECTIONS
        self.max_subscriptions = MOST_SUBSCRIPTIONS
        self.max_monitored_item_queue_size = MOST_EVENTS
        self.max_unacked_messages_per_subscription = MOST_UNACKED
        self.max_pending_messages_per_connection = _MOST_WAITING
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
        # not in a thread: the face is opened before the bus
        standard_address_space.fill_address_space(self.node_mgt_service)

    def create_session(self, name: str, user: User | None = None, external: bool = False) -> InternalSession:
        if external and len(self._external_sessions) >= MOST_SESSIONS:
            raise ServiceError(ua.StatusCodes.BadTooManySessions)
        return LimitedSession(self, name)

    def count_items(self) -> tuple[int, int]:
        """Monitored items of values and of events, of all sessions."""
        services = [one.monitored_item_srv for one in self.subscription_service.subscriptions.values()]
        every = sum(len(one._monitored_items) for one in services)
        events = sum(len(ids) for one in services for ids in one._monitored_events.values())
        return every - events, events


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
        account = iserver.verified.pop((username, _digest(password)), None)
        return None if account is None else _PlantUser(account)


def _digest(password: str | None) -> bytes:
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
            # whoever shares this session by its token would change its rights
            self.user = before
            raise ServiceError(ua.StatusCodes.BadIdentityChangeNotSupported)
        return result

    async def read(self, params: ua.ReadParameters) -> list[ua.DataValue]:
        _limit(params.NodesToRead)
        found = self.iserver.attribute_service.read(params)
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
        return await super().browse(params)

    async def browse_next(self, parameters: ua.BrowseNextParameters) -> list[ua.BrowseResult]:
        bad = ua.StatusCode(ua.StatusCodes.BadContinuationPointInvalid)  # each answer of browse is whole
        return [ua.BrowseResult(bad) for _ in parameters.ContinuationPoints]

    async def translate_browsepaths_to_nodeids(self, params: list[ua.BrowsePath]) -> list[ua.BrowsePathResult]:
        _limit(params)
        return await super().translate_browsepaths_to_nodeids(params)

    async def history_read(self, params: ua.HistoryReadParameters) -> list[ua.HistoryReadResult]:
        if len(params.NodesToRead) > 10:
            raise ServiceError(ua.StatusCodes.BadTooManyOperations)
        return await super().history_read(params)

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        _limit(params.NodesToWrite)
        return [await self.iserver.services.write(one, self.account) for one in params.NodesToWrite]

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        _limit(params)
        return [await self.iserver.services.call(one, self.account, self) for one in params]

    # --- subscriptions --------------------------------------------------------------------------------------------

    def owns(self, subscription: int) -> bool:
        found = self.subscription_service.subscriptions.get(subscription)
        return found is not None and found.session_id == self.session_id

    def _check_own(self, subscription: int) -> None:
        if not self.owns(subscription):
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)

    async def create_subscription(
        self, params: ua.CreateSubscriptionParameters, callback: Callable[..., Any],
        request_callback: Callable[..., Any] | None = None,
    ) -> ua.CreateSubscriptionResult:  # fmt: skip
        interval = params.RequestedPublishingInterval
        params.RequestedPublishingInterval = min(max(interval, FASTEST_MS), 3_600_000.0) if interval > 0 else FASTEST_MS
        made = await super().create_subscription(params, callback, request_callback)
        # asyncua makes it by itself, and leaves no other place
        self.subscription_service.subscriptions[made.SubscriptionId].__class__ = _Subscription
        return made

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        self._check_own(params.SubscriptionId)
        _limit(params.ItemsToCreate)
        values, events = self.iserver.count_items()
        results: list[ua.MonitoredItemCreateResult] = []
        given, params.ItemsToCreate = params.ItemsToCreate, []
        for one in given:
            asked = one.RequestedParameters
            if one.ItemToMonitor.AttributeId == ua.AttributeIds.EventNotifier:
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
        service = self.subscription_service.subscriptions[params.SubscriptionId].monitored_item_srv
        for item in service._monitored_items.values():
            if item.where_clause_evaluator is not None and not isinstance(item.where_clause_evaluator, _WhereClause):
                item.where_clause_evaluator = _WhereClause(self.logger, self.aspace, item.filter.WhereClause)
        return results

    async def modify_monitored_items(
        self, params: ua.ModifyMonitoredItemsParameters
    ) -> list[ua.MonitoredItemModifyResult]:
        self._check_own(params.SubscriptionId)
        for one in params.ItemsToModify:
            one.RequestedParameters.QueueSize = min(max(one.RequestedParameters.QueueSize, 1), MOST_QUEUE)
        return await super().modify_monitored_items(params)

    async def delete_monitored_items(self, params: ua.DeleteMonitoredItemsParameters) -> list[ua.StatusCode]:
        self._check_own(params.SubscriptionId)
        return await super().delete_monitored_items(params)

    async def set_monitoring_mode(self, params: ua.SetMonitoringModeParameters) -> list[ua.StatusCode]:
        self._check_own(params.SubscriptionId)
        return await super().set_monitoring_mode(params)

    def modify_subscription(self, params: ua.ModifySubscriptionParameters) -> ua.ModifySubscriptionResult:
        self._check_own(params.SubscriptionId)
        return super().modify_subscription(params)

    async def set_publishing_mode(self, params: ua.SetPublishingModeParameters) -> list[ua.StatusCode]:
        for one in params.SubscriptionIds:
            self._check_own(one)
        return await super().set_publishing_mode(params)

    def republish(self, params: ua.RepublishParameters) -> ua.NotificationMessage:
        self._check_own(params.SubscriptionId)
        found = super().republish(params)
        if not found.NotificationData:
            raise ServiceError(ua.StatusCodes.BadMessageNotAvailable)
        return found

    async def delete_subscriptions(self, ids: list[int]) -> list[ua.StatusCode]:
        bad = ua.StatusCode(ua.StatusCodes.BadSubscriptionIdInvalid)
        return [(await super(LimitedSession, self).delete_subscriptions([one]))[0] if self.owns(one) else bad
                for one in ids]  # fmt: skip

    async def transfer_subscriptions(
        self, params: ua.TransferSubscriptionsParameters, callback: Callable[..., Any]
    ) -> list[ua.TransferResult]:
        # a session that goes on over a new connection keeps its subscriptions; another one makes its own
        return [
            ua.TransferResult(ua.StatusCode(ua.StatusCodes.BadSubscriptionIdInvalid)) for _ in params.SubscriptionIds
        ]


class _Subscription(InternalSubscription):
    """A subscription whose messages are bounded: clients refuse those of many megabytes."""

    _triggered_datachanges: dict[int, list[Any]]

    def _pop_triggered_datachanges(self, result: ua.PublishResult) -> None:
        rest: dict[int, list[Any]] = {}
        count = 0
        for item, values in tuple(self._triggered_datachanges.items()):
            count += len(values)
            if count > MOST_IN_MESSAGE:
                rest[item] = self._triggered_datachanges.pop(item)
        super()._pop_triggered_datachanges(result)
        self._triggered_datachanges = rest


class _WhereClause(WhereClauseEvaluator):
    """``OfType`` is true for subtypes, too (Part 4, 7.7.3), for instance ConditionType for an alarm. Begin and end of a
    refresh pass every filter (Part 9, 4.5)."""

    def _eval_el(self, index: int, event: Any) -> Any:
        if event.types[0] in _REFRESHES:
            return True
        element = self.elements[index]
        if element.FilterOperator == ua.FilterOperator.OfType:
            return self._eval_op(element.FilterOperands[0], event) in event.types
        return super()._eval_el(index, event)


def _limit(operations: Sequence[object]) -> None:
    if not operations:
        raise ServiceError(ua.StatusCodes.BadNothingToDo)
    if len(operations) > MOST_OPERATIONS:
        raise ServiceError(ua.StatusCodes.BadTooManyOperations)


# --- connections --------------------------------------------------------------------------------------------------


class _Processor(UaProcessor):
    """Requests of one connection. Writes and calls are carried out beside the others."""

    iserver: LimitedServer

    def __init__(self, server: LimitedServer, transport: Any, limits: Any) -> None:
        super().__init__(server, transport, limits)
        self._orders: set[asyncio.Task[object]] = set()

    def open_secure_channel(self, algohdr: Any, seqhdr: Any, body: Any) -> None:
        if algohdr.SenderCertificate:
            fault = self.iserver.refuses(algohdr.SenderCertificate)
            if fault is not None:
                self.end_with(fault)
                return
        super().open_secure_channel(algohdr, seqhdr, body)

    def end_with(self, code: int) -> None:
        """Send the reason and close the connection (Part 6, 7.1.2.5)."""
        status = ua.StatusCode(code)
        self._transport.write(uatcp_to_binary(ua.MessageType.Error, ua.ErrorMessage(status, status.doc)))
        self._transport.close()

    async def process_message(self, seqhdr: Any, body: Any) -> Any:
        if nodeid_from_binary(body.copy()) in _ORDERS and len(self._orders) < _MOST_ORDERS:
            task = asyncio.create_task(super().process_message(seqhdr, body))
            self._orders.add(task)
            task.add_done_callback(self._ordered)
            return True
        return await super().process_message(seqhdr, body)

    def _ordered(self, task: asyncio.Task[object]) -> None:
        self._orders.discard(task)
        if not task.cancelled():
            task.exception()  # the connection is gone

    async def _process_message(self, typeid: Any, requesthdr: Any, seqhdr: Any, body: Any) -> Any:
        if isinstance(self._connection.security_policy, SecurityPolicyNone) and typeid not in _UNSECURED:
            raise ServiceError(ua.StatusCodes.BadSecurityPolicyRejected)
        if typeid not in _WITHOUT_USER and (self.session is None or not self.session.is_activated()):
            raise ServiceError(ua.StatusCodes.BadSessionNotActivated)
        if typeid == _ACTIVATE:
            await self._verify(requesthdr, body.copy())
        return await super()._process_message(typeid, requesthdr, seqhdr, body)

    async def _verify(self, requesthdr: Any, body: Buffer) -> None:
        """Look at a password in a thread, as that takes long; :class:`_UserManager` finds the result."""
        params = struct_from_binary(ua.ActivateSessionParameters, body)
        token, users = params.UserIdentityToken, self.iserver.users
        session = self.session or self.iserver.lookup_external_session(requesthdr.AuthenticationToken)
        if session is None or users is None or not isinstance(token, ua.UserNameIdentityToken):
            return
        try:
            name, password = self.iserver.decrypt_user_token(session, token)
        except Exception:
            raise ServiceError(ua.StatusCodes.BadIdentityTokenInvalid) from None
        if not isinstance(name, str) or not isinstance(password, str):
            raise ServiceError(ua.StatusCodes.BadIdentityTokenInvalid)
        account = await users.verify(name, password, str((self.name or ("",))[0]))
        if account is not None:
            self.iserver.verified[name, _digest(password)] = account

    async def close(self) -> None:
        for task in tuple(self._orders):
            task.cancel()
        await super().close()


class _Protocol(OPCUAProtocol):
    """A connection whose octets and answers are bounded."""

    processor: UaProcessor | None
    _buffer: bytes

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if self.processor is not None and self.transport is not None:
            assert isinstance(self.iserver, LimitedServer)
            self.processor = _Processor(self.iserver, self.transport, self.limits)
            self.processor.set_policies(self.policies)

    def data_received(self, data: bytes) -> None:
        if self.transport is None or self.transport.is_closing():
            return
        super().data_received(data)
        rest = self._buffer
        size = int.from_bytes(rest[4:8], "little") if len(rest) >= 8 else 8
        if rest and ((rest[:3] not in _STARTS and len(rest) >= 3) or not 8 <= size <= _CHUNK):
            self.transport.abort()
            self._buffer = b""

    async def _process_one_msg(self, header: Any, buf: Any) -> bool:
        await asyncio.sleep(0)  # others have their turn, however many requests wait
        transport = self.transport
        if transport is None or transport.is_closing():
            return False
        if transport.get_write_buffer_size() > _MOST_UNREAD:
            transport.abort()
            return False
        try:
            return await super()._process_one_msg(header, buf)
        except asyncio.CancelledError:
            raise
        except Exception as error:  # a chunk that cannot be decrypted or parsed ends its connection
            code = getattr(error, "code", None) or ua.StatusCodes.BadTcpMessageTypeInvalid
            if isinstance(self.processor, _Processor) and not transport.is_closing():
                self.processor.end_with(code)
            return False


class _Listener(BinaryServer):
    """Serves sockets that are bound already."""

    def __init__(self, server: LimitedServer, listening: Sequence[socket.socket], limits: Any) -> None:
        host, port = listening[0].getsockname()[:2]
        super().__init__(server, host, port, limits)
        self._listening = listening

    def _make_protocol(self) -> OPCUAProtocol:
        return _Protocol(self.iserver, self._policies, self.clients, self.closing_tasks, self.limits)

    async def start(self) -> None:
        loop = asyncio.get_running_loop()
        self._servers = [await loop.create_server(self._make_protocol, sock=one) for one in self._listening]
        self.cleanup_task = asyncio.create_task(self._close_task_loop())

    async def stop(self) -> None:
        for one in self._servers:
            one.close()
        await super().stop()


class PlantServer(Server):
    """The server as a whole. :meth:`start_on` serves sockets; ``now`` gives the time of ``CurrentTime``."""

    def __init__(self, server: LimitedServer, url: str, uri: str, name: str) -> None:
        super().__init__(iserver=server)
        self.set_endpoint(url)
        self._application_uri = uri
        self.set_server_name(name)
        self.product_uri = "urn:dpstack"
        self.manufacturer_name = "dpstack"
        self.application_type = ua.ApplicationType.Server
        self.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        self.limits.max_message_size = _MOST_REQUEST
        self.limits.max_chunk_count = _MOST_REQUEST // _CHUNK + 1

    async def start_on(self, listening: Sequence[socket.socket]) -> None:
        await self._setup_server_nodes()
        await self.iserver.start()
        assert isinstance(self.iserver, LimitedServer)
        self.bserver = _Listener(self.iserver, listening, self.limits)
        self.bserver.set_policies(self._policies)
        await self.bserver.start()

    async def show_time(self, now: datetime) -> None:
        """Write CurrentTime; a client that sees it stand still knows that this program does not run."""
        await self.iserver.current_time_node.write_value(now)

    async def end(self) -> None:
        with contextlib.suppress(Exception):
            await self.stop()


def quieten() -> None:
    """Keep the log of asyncua away from the terminal: it quotes clients, at any rate."""
    log = logging.getLogger("asyncua")
    log.addHandler(logging.NullHandler())
    log.propagate = False
