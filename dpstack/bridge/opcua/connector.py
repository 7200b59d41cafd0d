"""``OpcUaConnector``: the tree of a plant as an OPC UA server."""

from __future__ import annotations

import asyncio
import fcntl
import math
import os
import socket
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import ClassVar, Final

from asyncua import ua
from asyncua.server.monitored_item_service import MonitoredItemService
from cryptography import x509

from dpstack.bridge.connector import Connector, Tell
from dpstack.bridge.opcua.alarms import SERVER, Alarms, Event, emit, refresh, utc
from dpstack.bridge.opcua.certificate import (
    application_uri,
    client_fault,
    own_certificate,
    own_remarks,
    read_trusted,
    utc_now,
)
from dpstack.bridge.opcua.connection import PlantServer
from dpstack.bridge.opcua.history import BoundedHistory, PlantHistory
from dpstack.bridge.opcua.lateness import LATE_S, seconds_of
from dpstack.bridge.opcua.sessions import LimitedServer, LimitedSession, quieten
from dpstack.bridge.opcua.space import NAMESPACE, VARIANTS, Space
from dpstack.bridge.opcua.users import Account, Users, read_users
from dpstack.bridge.orders import Batch, OrderResult, Orders, Refusal, time_words
from dpstack.errors import ConfigError
from dpstack.plant.conditions import Condition
from dpstack.plant.nodes import Node, OfferedOrder
from dpstack.plant.quality import Quality, Reading, Reason, Value
from dpstack.plant.tree import Change, Changed, ClockSet, NodesChanged, PlantTree
from dpstack.tcp_address import Listen, is_local, join
from dpstack.trace import Severity

#: s between two writes of the changes, which are merged for each node
WRITE_S: Final = 0.2
#: changes of conditions that wait; the oldest beyond them are left out, and a refresh brings them
MOST_EVENTS_WAITING: Final = 4096
#: s until clients are served, even if the plant is not known yet
_PLANT_S: Final = 2.0
#: nodes that are written before clients have their turn
_AT_ONCE: Final = 100
#: addresses that stand for all of this computer
_EVERYWHERE: Final = ("", "0.0.0.0", "::")
#: writes and calls of one request that are worked on until others have their turn
_OPERATIONS_AT_ONCE: Final = 25
_S = ua.StatusCodes
_REFRESH: Final = ua.NodeId(ua.ObjectIds.ConditionType_ConditionRefresh)
_REFRESH_ITEM: Final = ua.NodeId(ua.ObjectIds.ConditionType_ConditionRefresh2)
_ACKNOWLEDGE: Final = ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Acknowledge)
_ADD_COMMENT: Final = ua.NodeId(ua.ObjectIds.ConditionType_AddComment)
_CONDITION_TYPE: Final = ua.NodeId(ua.ObjectIds.ConditionType)
#: Part 4, 7.39; writes and calls have codes of their own for orders that nobody may give
_CODES: Final = {
    Refusal.STATE: _S.BadInvalidState,
    Refusal.UNKNOWN: _S.BadNodeIdUnknown,
    Refusal.TYPE: _S.BadTypeMismatch,
    Refusal.TIME: _S.BadInvalidTimestamp,
    Refusal.NO_EXCHANGE: _S.BadNoCommunication,
    Refusal.TOO_MANY: _S.BadResourceUnavailable,
    Refusal.NO_RESULT: _S.BadTimeout,
}


#: what the server says itself to an order
_WHY: Final = {
    _S.BadUserAccessDenied: "this user may give no orders",
    _S.BadTypeMismatch: "its value has another type",
    _S.BadOutOfRange: "its value is out of range",
    _S.BadNotWritable: "this value cannot be written, or allow_commands does not list it",
    _S.BadNotExecutable: "it is not in allow_commands",
    _S.BadNodeIdUnknown: "there is no such node",
    _S.BadWriteNotSupported: "only a whole value with a good status can be written",
    _S.BadArgumentsMissing: "its argument is missing",
    _S.BadTooManyArguments: "it has too many arguments",
    _S.BadMethodInvalid: "this object has no such method",
}


@dataclass(frozen=True, slots=True)
class OpcUaSettings:
    """``cert``, ``key``: made at the first start if neither is there. ``trust_dir``: the
    certificates of clients; None: any. ``users_file``: None: no users. ``anonymous``: may read. ``history_s``, and
    ``history_values`` of all nodes together. ``lock``: a file for this name, which no other program must have."""

    listen: str
    name: str
    cert: Path
    key: Path
    trust_dir: Path | None = None
    users_file: Path | None = None
    anonymous: bool = False
    history_s: float = 3600.0
    history_values: int = 100_000
    lock: Path | None = None


class OpcUaConnector(Connector):
    """Serves the tree. The structure of nodes follows the configuration of the bus: a slave that leaves data exchange
    keeps its nodes, and their values get status codes that say so.
    """

    name: ClassVar[str] = "opcua"

    def __init__(
        self, tree: PlantTree, tell: Tell, settings: OpcUaSettings, orders: Orders, *,
        now: Callable[[], datetime] = utc_now,
    ) -> None:  # fmt: skip
        super().__init__(tree, tell)
        self.settings = settings
        self._listen = Listen.parse(settings.listen, "[opcua] listen")
        self.history = BoundedHistory(settings.history_s, settings.history_values)
        self._orders = orders
        self._now = now
        self._offset = 0.0
        self._listening: list[socket.socket] = []
        self._server: LimitedServer | None = None
        self._ua: PlantServer | None = None
        self._space: Space | None = None
        self._alarms: Alarms | None = None
        self._users: Users | None = None
        self._trusted: frozenset[bytes] | None = None
        self._changed: dict[str, tuple[Node, Reading]] = {}
        self._events: deque[Condition] = deque(maxlen=MOST_EVENTS_WAITING)
        self._structure = True
        self.is_built = False
        self._left_out = 0
        #: a remark has said that the history has too little room
        self._told_history = False
        self._lock = -1
        self._told_names: set[str] = set()
        #: subscriptions that get a refresh of the conditions
        self._refreshing: set[int] = set()

    @property
    def port(self) -> int:
        """The port on which it listens."""
        return int(self._listening[0].getsockname()[1]) if self._listening else self._listen.port

    # --- of a connector
    # ------------------------------------------------------------------------------------------------

    async def open(self) -> None:
        chosen = self.settings
        if chosen.users_file is None and not chosen.anonymous:
            raise ConfigError('users_file: nobody may connect; give users_file, or anonymous = "read"')
        quieten()
        if chosen.users_file is not None:
            self._users = Users(read_users(chosen.users_file))
        controls = self._users is not None and any(one.control for one in self._users.accounts.values())
        if self._orders.takes_any and not controls:
            todo = "give a users_file with a line of `python -m dpstack.bridge.opcua.users NAME control`"
            self.tell(f"allow_commands: nobody may give these orders, as no user has the right control; {todo}",
                      Severity.WARNING)  # fmt: skip
        if chosen.trust_dir is not None:
            self._trusted = read_trusted(chosen.trust_dir)
        self._take_name()  # before a second server could make the same files
        uri = application_uri(socket.gethostname(), chosen.name)
        host = self._listen.host
        shown = socket.gethostname() if host in _EVERYWHERE else host
        hosts = [socket.gethostname(), "localhost", "127.0.0.1", shown]
        cert, key = own_certificate(chosen.cert, chosen.key, uri=uri, hosts=hosts, now=self._now())
        self._judge_certificate(cert, shown)
        self._listening = self._listen.sockets()
        if chosen.anonymous and not is_local(self._listening):
            self.tell(f"everybody who reaches port {self.port} may read the plant", Severity.WARNING)
        server = LimitedServer(self._users, anonymous=chosen.anonymous, services=self, refuses=self._refuses)
        self._server = server
        server.certificate, server.private_key = cert, key
        server.history_manager = PlantHistory(server, self.history)
        self._ua = PlantServer(server, f"opc.tcp://{join(shown, self.port)}", uri, f"dpstack {chosen.name}")
        await self._ua.init()
        index = await self._ua.register_namespace(NAMESPACE)
        self._space = Space(server, index)
        self._space.add_types()
        self._space.add_last_command()
        await self._ua.get_node(SERVER).set_event_notifier([ua.EventNotifier.SubscribeToEvents])
        self._alarms = Alarms(os.urandom(8), self._space.node, self.wall)
        # a client shows the certificate at its first connection, and somebody has to compare it
        self.tell(f"opc.tcp://{join(shown, self.port)}, certificate {chosen.cert}", Severity.INFO)

    def take(self, changes: Sequence[Change]) -> None:
        for change in changes:
            if isinstance(change, Changed):
                self._changed[change.node.id] = (change.node, change.reading)
            elif isinstance(change, Condition):
                if len(self._events) == self._events.maxlen:
                    self._left_out += 1
                self._events.append(change)
            elif isinstance(change, NodesChanged):
                self._structure, self.is_built = True, False
            elif isinstance(change, ClockSet):
                self._offset = change.offset
                self.history.clear()
                self._write_all()

    async def serve(self) -> None:
        assert self._ua is not None
        await self._wait_for_plant()
        await self._ua.start_on(self._listening)
        try:
            while True:
                await self.write_changes()
                await asyncio.sleep(WRITE_S)
        finally:
            try:
                await self.write_changes()  # the death of the bus
                await asyncio.sleep(WRITE_S)  # subscriptions publish it
            finally:
                await self._ua.end()

    async def _wait_for_plant(self) -> None:
        """Fill the address space before the first client is served: one that is quick would find half a plant."""
        loop = asyncio.get_running_loop()
        until = loop.time() + _PLANT_S
        while self.tree.plant is None and loop.time() < until:  # noqa: ASYNC110  the tree calls nobody
            await asyncio.sleep(WRITE_S)
        await self.write_changes()

    def _take_name(self) -> None:
        """Hold the file of the name while this program runs: two servers with one URI are one for a client."""
        path = self.settings.lock
        if path is None:
            return
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            why = f"name: another OPC UA server of this computer is called {self.settings.name!r}"
            raise ConfigError(f"{why}; give this one another name") from None
        except OSError as error:
            raise ConfigError(f"{path}: cannot be used: {error.strerror or error}") from None

    def close(self) -> None:
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1
        for one in self._listening:
            one.close()
        if self._server is not None:
            self._server.method_service.stop()

    def _judge_certificate(self, cert: x509.Certificate, host: str) -> None:
        """Report what its clients will soon refuse: at the start, and every day."""
        self._judged, self._judge_at = (cert, host), self._now() + timedelta(days=1)
        for text in own_remarks(cert, self.settings.cert, self.settings.key, host, self._now()):
            self.tell(text, Severity.WARNING)

    # --- values and events ----------------------------------------------------------------------------------------

    def wall(self, time: float) -> datetime:
        """A time of the tree as one of this computer."""
        return utc(min(max(time + self._offset, 0.0), 253_402_300_799.0))

    async def write_changes(self) -> None:
        """Write what :meth:`take` has got since the last time."""
        assert self._ua is not None
        assert self._space is not None
        assert self._alarms is not None
        await self._ua.show_time(self._now())
        if self._structure and self.tree.plant is not None:
            self._structure = False
            await self._build()
            self.is_built = not self._structure
        changed, self._changed = self._changed, {}
        now = self._now()
        for number, (node, reading) in enumerate(changed.values(), 1):
            made = await self._space.write(node, reading, self.wall)
            if made is not None:
                is_old = reading.reason is Reason.WAITING or reading.reason.quality is Quality.STALE
                self.history.keep(self._space.node(node.id), made, now, is_old=is_old)
            if number % _AT_ONCE == 0:
                await asyncio.sleep(0)
        while self._events:
            condition = self._events.popleft()
            event = self._alarms.event(condition, self._source_name(condition), now)
            await emit(self._items(), event, self._alarms.emitters(condition))
            await asyncio.sleep(0)
        assert self._server is not None
        if self._now() >= self._judge_at:
            self._judge_certificate(*self._judged)
        self._count_losses()

    def _count_losses(self) -> None:
        assert self._server is not None
        self.dropped += self._server.losses.new_dropped()
        if news := self._server.losses.news():
            self.tell(news, Severity.WARNING)
        if self._left_out:
            left_out, self._left_out = self._left_out, 0
            self.dropped += left_out
            self.tell(f"{left_out} events were left out; a refresh of the conditions brings them", Severity.WARNING)
        # they reached the clients that were there, so they do not count as dropped: an alarm would never end
        if self.history.dropped and not self._told_history:
            self._told_history = True
            self.tell(
                f"the history has room for {self.settings.history_values} values, which is less than "
                f"{self.settings.history_s:g} s: the oldest go; give a greater history_values",
                Severity.WARNING,
            )

    async def _build(self) -> None:
        assert self._space is not None
        assert self._alarms is not None
        port = "" if self.tree.plant is None else str(self.tree.plant.port or "")
        bus = tuple(node for node, _ in self.tree.readings(None))
        allowed = frozenset(order.name for order in self._orders.allowed)
        names, changed = await self._space.build((port, bus), self.tree.slaves, allowed)
        for text in names:
            if text not in self._told_names and len(self._told_names) < 1000:
                self._told_names.add(text)
                self.tell(text, Severity.WARNING)
        self._write_all()
        if changed:
            kind = ua.ObjectIds.BaseModelChangeEventType
            event = self._alarms.system_event(kind, "the nodes have changed", self._now())
            await emit(self._items(), event, (SERVER,))

    def _write_all(self) -> None:
        for slave in (None, *self.tree.slaves):
            for node, reading in self.tree.readings(slave):
                self._changed[node.id] = (node, reading)

    def _items(self) -> list[MonitoredItemService]:
        assert self._server is not None
        return [one.monitored_item_srv for one in self._server.subscription_service.subscriptions.values()]

    def _source_name(self, condition: Condition) -> str:
        assert self._space is not None
        return self._space.names.get(condition.slave) or f"slave {condition.slave}"

    def _refuses(self, certificate: bytes) -> int | None:
        return client_fault(certificate, self._trusted, self._now())

    # --- orders of clients ----------------------------------------------------------------------------------------

    async def write(self, values: Sequence[ua.WriteValue], who: Account | None) -> list[ua.StatusCode]:
        """A client's writes: of outputs that ``allow_commands`` lists, by a user who may. Those of one slave with
        the same time are one order."""
        batch = self._orders.batch()
        found = [ua.StatusCode()] * len(values)
        together: dict[tuple[int, float | None], list[tuple[int, OfferedOrder, Value]]] = {}
        for number, one in enumerate(values):
            try:
                order, value = self._judge_write(one, who)
            except ua.UaStatusCodeError as error:
                found[number] = ua.StatusCode(error.code)
                self._refuse(self._order_name(one.NodeId), error.code, who, seconds_of(one.Value.SourceTimestamp))
            else:
                made_at = seconds_of(one.Value.SourceTimestamp)
                together.setdefault((order.slave, made_at), []).append((number, order, value))
            if number % _OPERATIONS_AT_ONCE == 0:
                await asyncio.sleep(0)
        for (_, made_at), outputs in together.items():
            given = [(order, value) for _, order, value in outputs]
            results = await self._orders.give_outputs(
                given, made_at=made_at, late_s=LATE_S.get(), batch=batch, by="" if who is None else who.name
            )
            for (number, *_), result in zip(outputs, results, strict=True):
                found[number] = _status_of(result, _S.BadNotWritable)
            await self._show_last(next((one for one in results if one.result != "done"), results[-1]))
        return found

    async def call(
        self, methods: Sequence[ua.CallMethodRequest], who: Account | None, session: LimitedSession
    ) -> list[ua.CallMethodResult]:
        """A client's calls: orders of drives, refreshes of conditions, acknowledgements."""
        batch = self._orders.batch()
        results = []
        for number, one in enumerate(methods, 1):
            results.append(await self._call(one, who, session, batch))
            if number % _OPERATIONS_AT_ONCE == 0:
                await asyncio.sleep(0)
        return results

    def _judge_write(self, write: ua.WriteValue, who: Account | None) -> tuple[OfferedOrder, Value]:
        """The order that a write means. Raises UaStatusCodeError."""
        assert self._space is not None
        assert self._server is not None
        if write.NodeId not in self._server.aspace:
            raise ua.UaStatusCodeError(_S.BadNodeIdUnknown)
        node = self._space.values.get(write.NodeId)
        order = None if node is None else node.order
        if write.AttributeId != ua.AttributeIds.Value or node is None or order is None or not self._orders.takes(order):
            raise ua.UaStatusCodeError(_S.BadNotWritable)
        given = write.Value
        if write.IndexRange or (given.StatusCode is not None and not given.StatusCode.is_good()):
            raise ua.UaStatusCodeError(_S.BadWriteNotSupported)
        return order, _judge_value(order, given.Value, who, node.low, node.high)

    async def _call(
        self, method: ua.CallMethodRequest, who: Account | None, session: LimitedSession, batch: Batch
    ) -> ua.CallMethodResult:
        assert self._space is not None
        assert self._server is not None
        arguments = list(method.InputArguments or ())
        if method.MethodId in (_REFRESH, _REFRESH_ITEM):
            return _result(await self._refresh(method, arguments, session))
        if method.MethodId in (_ACKNOWLEDGE, _ADD_COMMENT):
            return _result(self._speak(method, arguments, who))
        found = self._space.method(method.ObjectId, method.MethodId)
        code = self._judge_method(method, found)
        if found is None:  # a method of the server, or none
            return _result(code)
        _, order = found
        if code:
            self._refuse(order.name, code, who)
            return _result(code)
        try:
            value = _judge_value(order, arguments[0] if arguments else None, who, None, None)
        except ua.UaStatusCodeError as error:
            status = ua.StatusCode(error.code)
            self._refuse(order.name, error.code, who)
        else:
            done = await self._orders.give(
                order, value, made_at=None, late_s=LATE_S.get(), batch=batch, by=_name_of(who)
            )
            await self._show_last(done)
            status = _status_of(done, _S.BadNotExecutable)
        result = ua.CallMethodResult(status)
        if arguments:
            wrong = status.value in (_S.BadTypeMismatch, _S.BadOutOfRange)
            result.InputArgumentResults = [ua.StatusCode(status.value if wrong else _S.Good)]
            if wrong:
                result.StatusCode = ua.StatusCode(_S.BadInvalidArgument)
        return result

    def _judge_method(self, method: ua.CallMethodRequest, found: tuple[ua.NodeId, OfferedOrder] | None) -> int:
        """The status code that refuses the call of a method by itself; 0: none does."""
        assert self._server is not None
        if found is None:
            known = method.ObjectId in self._server.aspace or self._condition(method.ObjectId) is not None
            return int(_S.BadMethodInvalid if known else _S.BadNodeIdUnknown)
        owner, order = found
        if method.ObjectId != owner:
            return int(_S.BadMethodInvalid)
        if not self._orders.takes(order):
            return int(_S.BadNotExecutable)
        given, wanted = len(method.InputArguments or ()), 0 if order.type is None else 1
        if given == wanted:
            return 0
        return int(_S.BadArgumentsMissing if given < wanted else _S.BadTooManyArguments)

    def _order_name(self, id_: ua.NodeId) -> str:
        """The order of the value at ``id_``; the id itself if it has none."""
        assert self._space is not None
        node = self._space.values.get(id_)
        return id_.to_string() if node is None else f"{node.id}" if node.order is None else node.order.name

    def _refuse(self, name: str, code: int, who: Account | None, made_at: float | None = None) -> None:
        """Report an order that the server refuses by itself."""
        word = ua.status_codes.get_name_and_doc(code)[0]
        reason = f"{_WHY.get(code, 'the server refuses it')} ({word})"
        self._orders.refuse(name, reason, by=_name_of(who), order_time=time_words(made_at))

    async def _show_last(self, last: OrderResult) -> None:
        assert self._space is not None
        assert self._server is not None
        now = self._now()
        for part, text in (("Name", last.name), ("Result", last.result), ("Reason", last.reason)):
            shown = ua.DataValue(ua.Variant(text, ua.VariantType.String), SourceTimestamp=now, ServerTimestamp=now)
            id_ = self._space.node(f"last/{part}")
            await self._server.aspace.write_attribute_value(id_, ua.AttributeIds.Value, shown)

    # --- conditions -----------------------------------------------------------------------------------------------

    async def _refresh(self, method: ua.CallMethodRequest, arguments: list[ua.Variant], session: LimitedSession) -> int:
        assert self._space is not None
        assert self._alarms is not None
        if method.ObjectId != _CONDITION_TYPE:
            return int(_S.BadMethodInvalid)
        wanted = 1 if method.MethodId == _REFRESH else 2
        if len(arguments) != wanted:
            return int(_S.BadArgumentsMissing if len(arguments) < wanted else _S.BadTooManyArguments)
        subscription, item = arguments[0].Value, arguments[1].Value if wanted == 2 else None
        if not isinstance(subscription, int) or not session.owns(subscription):
            return int(_S.BadSubscriptionIdInvalid)
        items = session.subscription_service.subscriptions[subscription].monitored_item_srv
        if wanted == 2 and not any(item in ids for ids in items._monitored_events.values()):
            return int(_S.BadMonitoredItemIdInvalid)
        if subscription in self._refreshing:
            return int(_S.BadRefreshInProgress)
        now, alarms = self._now(), self._alarms
        begin = alarms.system_event(ua.ObjectIds.RefreshStartEventType, "refresh begins", now)
        end = alarms.system_event(ua.ObjectIds.RefreshEndEventType, "refresh has ended", now)
        assert self._server is not None
        self._refreshing.add(subscription)
        try:
            await refresh(items, item, begin, self._retained, end, self._server.pace.pause)
        finally:
            self._refreshing.discard(subscription)
        return 0

    def _retained(self) -> Iterator[tuple[Event, tuple[ua.NodeId, ...]]]:
        """The event of each retained condition, as it is when it is asked for, and the nodes that emit it."""
        assert self._alarms is not None
        now = self._now()
        for one in self.tree.conditions:
            condition = self.tree.conditions.get(one.id)
            if condition is not None:
                yield (
                    self._alarms.event(condition, self._source_name(condition), now),
                    self._alarms.emitters(condition),
                )

    def _condition(self, node: ua.NodeId) -> Condition | None:
        assert self._alarms is not None
        text = str(node.Identifier).removeprefix("condition/")
        found = self.tree.conditions.get(text)
        return found if found is not None and self._alarms.condition_id(found) == node else None

    def _speak(self, method: ua.CallMethodRequest, arguments: list[ua.Variant], who: Account | None) -> int:
        """Acknowledge and AddComment (Part 9, 5.7.3 and 5.5.6)."""
        assert self._alarms is not None
        if who is None or not who.control:
            return int(_S.BadUserAccessDenied)
        if len(arguments) != 2:
            return int(_S.BadArgumentsMissing if len(arguments) < 2 else _S.BadTooManyArguments)
        comment = arguments[1].Value
        if not isinstance(comment, ua.LocalizedText):
            return int(_S.BadInvalidArgument)
        found = self._condition(method.ObjectId)
        if found is None:
            return int(_S.BadNodeIdUnknown)
        count = self._alarms.count_of(found, arguments[0].Value)
        if count is None:
            return int(_S.BadEventIdUnknown)
        # an empty text without a language leaves the comment, an empty one with a language clears it
        said = (comment.Text or "") if comment.Text or comment.Locale else None
        if method.MethodId == _ADD_COMMENT:
            self.comment(found.id, who.name, found.comment if said is None else said)
            return 0
        if found.acked:
            return int(_S.BadConditionBranchAlreadyAcked)
        if count < found.unacked_from:
            return int(_S.BadEventIdUnknown)  # its user has not seen that it came again
        self.acknowledge(found.id, who.name, said)
        return 0


def _name_of(who: Account | None) -> str:
    return "anonymous" if who is None else who.name


def _judge_value(
    order: OfferedOrder, given: ua.Variant | None, who: Account | None, low: float | None, high: float | None
) -> Value:
    """The value of an order by ``who``, of the type of the order; ``low`` and ``high``: its range. Raises
    UaStatusCodeError."""
    if who is None or not who.control:
        raise ua.UaStatusCodeError(_S.BadUserAccessDenied)
    if order.type is None:
        return None
    if given is None or given.VariantType != VARIANTS[order.type] or given.is_array:
        raise ua.UaStatusCodeError(_S.BadTypeMismatch)
    value: Value = given.Value
    if isinstance(value, float) and not math.isfinite(value):
        raise ua.UaStatusCodeError(_S.BadOutOfRange)
    if isinstance(value, (int, float)) and low is not None and high is not None and not low <= value <= high:
        raise ua.UaStatusCodeError(_S.BadOutOfRange)
    return value


def _status_of(result: OrderResult, forbidden: int) -> ua.StatusCode:
    """``forbidden``: the status code of an order that nobody may give."""
    return ua.StatusCode() if result.result == "done" else ua.StatusCode(_CODES.get(result.kind, forbidden))


def _result(code: int) -> ua.CallMethodResult:
    return ua.CallMethodResult(ua.StatusCode(code))
