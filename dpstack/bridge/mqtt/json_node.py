"""A plant as topics with plain JSON: values, conditions, orders and their results, in their order.

docs/reference/mqtt-json.md has all topics, and the reasons for this layout.

All topics but the results are retained with a message expiry, and sent again long before it. So the broker forgets
what nobody keeps up to date. A message is made when it is asked for, with the values of that moment: nothing waits in
memory but the names of the topics that have news.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, Final, NamedTuple

from dpstack.bridge.connector import product_version
from dpstack.bridge.homeassistant.discovery import MOST_ENTITIES, Discovery, Leave
from dpstack.bridge.homeassistant.entities import Device, Entity, Gateway, Shown, entities
from dpstack.bridge.mqtt.json_payload import condition_payload, read_order, result_payload, sent_time, values_payload
from dpstack.bridge.mqtt.plant_node import (
    ConnectionNeeds,
    Disconnect,
    NodeOptions,
    NodeSetup,
    OrderWish,
    Phase,
    PlantNode,
    Publish,
    Unsubscribe,
)
from dpstack.bridge.names import MQTT_NAME, unique_names
from dpstack.plant.conditions import Condition
from dpstack.plant.nodes import Node, OfferedOrder
from dpstack.plant.tree import Born, Change, Changed, ClockSet, Died, NodesChanged, PlantTree

NAMESPACE: Final = "dpstack"
#: s after which the broker forgets a message, at least; it is sent again three times as often
EXPIRY_S: Final = 30
#: results that wait to be sent
_MOST_RESULTS: Final = 256
#: the last level of the topics of a slave, or of the bus, in the order in which they are sent first: whoever sees
#: ``online`` has seen the values
_STATE, _ONLINE, _CONDITION = "state", "online", "condition"
_SAID: Final = (b"false", b"true")


class _Key(NamedTuple):
    """A topic by its content, whatever the names are. ``slave`` None: the bus; ``id``: of a condition."""

    slave: int | None
    part: str
    id: str = ""


class _Sent(NamedTuple):
    """A topic that the broker keeps. ``at``: the time by ``clock``."""

    topic: str
    at: float


class JsonNode(PlantNode):
    """``clear_first`` and ``pause`` of the options have no meaning here, as only the will has the number of the
    session, and births wait for no primary host."""

    counts_sessions: ClassVar[bool] = False

    def __init__(self, setup: NodeSetup, tree: PlantTree, options: NodeOptions) -> None:
        assert options.history is None, "plain JSON has no flag for history"
        super().__init__(setup, tree, options)
        self._base = f"{NAMESPACE}/{setup.client_id}"
        self._expiry_s = max(EXPIRY_S, math.ceil(3 * setup.interval_s))
        self._is_told = False
        # names; all of them are made anew with the nodes
        self._folders: dict[int | None, str] = {}
        self._parts: dict[_Key, list[tuple[str, Node]]] = {}
        self._key_of: dict[str, _Key] = {}
        self._orders: dict[tuple[str, str], OfferedOrder] = {}
        # messages
        #: topics with news; True: they do not wait for the interval
        self._waiting: dict[_Key, bool] = {}
        #: topics that the broker keeps, the one first that was sent first
        self._sent: dict[_Key, _Sent] = {}
        #: topics that the broker shall forget
        self._gone: dict[str, None] = {}
        #: conditions that have ended and are acknowledged: the tree has forgotten them
        self._ended: dict[str, Condition] = {}
        self._results: deque[bytes] = deque()
        self._is_turn_of_others = False
        self._discovery: Discovery | None = None
        if setup.discovery_prefix:
            self._discovery = Discovery(setup.discovery_prefix, self._base, tell=self._tell, pause=options.pause)
        self._rename()

    # --- the connection -------------------------------------------------------------------------------------------

    def connect(self, number: int, wall: float) -> ConnectionNeeds:
        self.disconnected()
        self.phase = Phase.CONNECTING
        will = Publish(self._online_topic, _SAID[False], qos=1, retain=True, session=number)
        topics = (f"{self._base}/slave/+/set/+",)
        if self._discovery is None:
            return ConnectionNeeds(self._setup.client_id, will, topics)
        return ConnectionNeeds(self._setup.client_id, will, (*topics, *self._discovery.subscriptions), MOST_ENTITIES)

    def connected(self) -> None:
        if self.phase is not Phase.CONNECTING:
            return
        self.phase, self._leaving = Phase.ONLINE, ""
        for key in list(self._sent):
            if key.part == _CONDITION and self._tree.conditions.get(key.id) is None:
                self._forget(key)
        self._mark_all()
        if self._discovery is not None:
            self._discovery.connected()

    def disconnected(self) -> None:
        """The connection is gone, or was not made. The broker may keep what was sent; the next session corrects it."""
        self.phase = Phase.OFFLINE
        self._waiting.clear()
        self._ended.clear()

    def end(self, why: str) -> None:
        """An ordered end: ``online`` becomes false, good values become stale, and the end of the connection comes."""
        if self.phase is not Phase.ONLINE:
            return
        self.phase, self._leaving, self._is_told = Phase.LEAVING, why, False
        kept = [key for key in self._sent if key.part != _CONDITION]
        self._waiting = dict.fromkeys(sorted(kept, key=lambda key: key.part != _ONLINE), True)

    @property
    def _online_topic(self) -> str:
        return f"{self._base}/{_ONLINE}"

    # --- the tree -------------------------------------------------------------------------------------------------

    def take(self, changes: Sequence[Change], wall: float, clock: float) -> None:
        for change in changes:
            match change:
                case Changed(node=node):
                    self._mark(self._key_of.get(node.id))
                case Born(slave=slave):
                    self._mark_parts(slave)
                    self._mark(_Key(slave, _ONLINE), urgent=True)
                case Died(slave=slave):
                    self._mark(_Key(slave, _ONLINE), urgent=True)
                    self._mark_parts(slave)
                case Condition():
                    self._take_condition(change)
                case NodesChanged():
                    self._rename()
                case ClockSet(offset=offset):
                    self._offset = offset
                    if self.phase is Phase.ONLINE:
                        self._tell("the clock of this computer was set: all values are published again, with new times")
                        self._mark_all()

    def _mark(self, key: _Key | None, *, urgent: bool = False) -> None:
        """The topic has news. Urgent ones go out in the order of their last mark."""
        if key is None or self.phase is not Phase.ONLINE:
            return
        if urgent:
            self._waiting.pop(key, None)
        self._waiting[key] = urgent or self._waiting.get(key, False)

    def _mark_parts(self, slave: int | None) -> None:
        for key in self._parts:
            if key.slave == slave:
                self._mark(key, urgent=True)

    def _mark_all(self) -> None:
        """All topics are sent; those that say ``online`` behind the others."""
        for key in self._parts:
            self._mark(key, urgent=True)
        for condition in self._tree.conditions:
            self._mark(_Key(condition.slave, _CONDITION, condition.id), urgent=True)
        for slave in (*self._tree.slaves, None):
            self._mark(_Key(slave, _ONLINE), urgent=True)

    def _take_condition(self, condition: Condition) -> None:
        key = _Key(condition.slave, _CONDITION, condition.id)
        self._ended.pop(condition.id, None)
        if condition.retain:
            self._mark(key)
        elif key in self._sent:
            self._ended[condition.id] = condition
            self._mark(key)

    def _rename(self) -> None:
        """Names of all slaves, values and orders. Topics of other names than before are taken from the broker."""
        tree = self._tree
        slaves = tree.slaves
        folders = self._slave_names(MQTT_NAME)
        self._folders = {None: "bus", **{address: f"slave/{name}" for address, name in folders.items()}}
        self._parts, self._key_of, self._orders = {}, {}, {}
        allowed = self._allowed_orders()
        for address in (None, *slaves):
            self._add_parts(address, [node for node, _ in tree.readings(address)])
        for key, members in self._parts.items():
            for name, node in members:
                if node.order is not None and key.slave is not None and allowed.get(node.order.name) == node.order:
                    self._orders[folders[key.slave], name] = node.order
        for order in allowed.values():
            if order.operation is not None:
                self._orders[folders[order.slave], order.operation] = order
        for key, sent in list(self._sent.items()):
            if self._topic(key) != sent.topic:
                self._forget(key)
        for key in (*self._parts, *(_Key(slave, _ONLINE) for slave in slaves)):
            if key not in self._sent:
                self._mark(key, urgent=True)
        if self._discovery is not None and tree.plant is not None:
            self._discovery.show(self._entities())
        for condition in tree.conditions:
            if (key := _Key(condition.slave, _CONDITION, condition.id)) not in self._sent:
                self._mark(key)

    def _add_parts(self, slave: int | None, nodes: Sequence[Node]) -> None:
        parts: dict[str, list[Node]] = {}
        for node in nodes:
            # the topics of a bus without a node would say nothing
            parts.setdefault(node.path[0].lower() if len(node.path) > 1 else _STATE, []).append(node)
        for part, inside in parts.items():
            key = _Key(slave, part)
            names = unique_names(MQTT_NAME, [(node.id, _wanted(node)) for node in inside])
            for text in names.changed:
                self._tell(text)
            self._parts[key] = [(names.names[node.id], node) for node in inside]
            self._key_of |= dict.fromkeys((node.id for node in inside), key)

    def _entities(self) -> Iterator[Entity]:
        """The bus first: its slaves are connected through it."""
        tree = self._tree
        name, version = f"PROFIBUS {self._setup.node}", product_version() or "unknown"
        gateway = Gateway(self._base, name, self._expiry_s, bool(self._orders), version)
        topics = {order: f"{self._base}/slave/{folder}/set/{name}" for (folder, name), order in self._orders.items()}
        yield from entities(gateway, Device(None, "", {}, self._online_topic, self._shown(None, topics)))
        for address, described in tree.slaves.items():
            buttons = [
                (order.operation, topics[order])
                for order in described.orders
                if order in topics and order.operation is not None and order.type is None
            ]
            online = f"{self._base}/{self._folders[address]}/{_ONLINE}"
            shown = self._shown(address, topics)
            yield from entities(gateway, Device(address, described.name, described.about, online, shown, buttons))

    def _shown(self, slave: int | None, topics: Mapping[OfferedOrder, str]) -> list[Shown]:
        """The nodes of the bus or of a slave in their topics. The order ``speed`` sets the set point of a drive."""
        speeds = [topic for order, topic in topics.items() if order.slave == slave and order.operation == "speed"]
        found = []
        for key, members in self._parts.items():
            for name, node in members if key.slave == slave else ():
                topic = "" if node.order is None else topics.get(node.order, "")
                if speeds and node.keys == ("drive", "setpoint"):
                    topic = speeds[0]
                found.append(Shown(node, f"{self._base}/{self._folders[slave]}/{key.part}", name, topic))
        return found

    def _forget(self, key: _Key) -> None:
        """The broker shall forget a topic."""
        self._gone[self._sent.pop(key).topic] = None

    def _topic(self, key: _Key) -> str | None:
        """None if nothing has this topic any more."""
        if key.part == _ONLINE and key.slave is None:
            return self._online_topic
        folder = self._folders.get(key.slave)
        if folder is None:
            return None
        if key.part == _CONDITION:
            # its id begins with bus/ or slave/N/; the rest is different for each
            rest = key.id.split("/", 1 if key.slave is None else 2)[-1]
            return f"{self._base}/{folder}/{_CONDITION}/{rest.translate(_ESCAPES)}"
        is_there = key.part == _ONLINE or key in self._parts
        return f"{self._base}/{folder}/{key.part}" if is_there else None

    # --- messages out ---------------------------------------------------------------------------------------------

    def next(self, wall: float, clock: float) -> Publish | Unsubscribe | Disconnect | None:
        if self.phase is Phase.LEAVING:
            return self._farewell(wall, clock)
        if self.phase is not Phase.ONLINE or self._tree.plant is None:
            return None
        if self._gone:
            return self._next_gone()
        # whoever gives orders at any rate gets every second message at most: values do not wait for them
        self._is_turn_of_others = not self._is_turn_of_others
        if self._is_turn_of_others and (other := self._next_other(clock)) is not None:
            return other
        for key in self._due_keys(clock):
            self._waiting.pop(key, None)
            if (message := self._publish(key, wall, clock)) is not None:
                return message
        return self._next_gone() if self._gone else self._next_other(clock)

    def due(self, clock: float) -> float:
        if self.phase is Phase.LEAVING:
            return clock
        if self.phase is not Phase.ONLINE or self._tree.plant is None:
            return math.inf
        if self._gone or self._results:
            return clock
        described = math.inf if self._discovery is None else self._discovery.due(clock)
        first = min((clock if urgent else self._due_at(key) for key, urgent in self._waiting.items()), default=math.inf)
        oldest = next(iter(self._sent.values()), None)
        return min(first, described, math.inf if oldest is None else oldest.at + self._expiry_s / 3)

    def _due_keys(self, clock: float) -> Iterator[_Key]:
        """Topics to send now: urgent ones, those that the broker is about to forget, as news take all its time, those
        with news, those to renew."""
        while (key := next((key for key, urgent in self._waiting.items() if urgent), None)) is not None:
            yield key
        yield from self._older(2 * self._expiry_s / 3, clock)
        while (key := next((key for key in self._waiting if self._due_at(key) <= clock), None)) is not None:
            yield key
        yield from self._older(self._expiry_s / 3, clock)

    def _older(self, age_s: float, clock: float) -> Iterator[_Key]:
        """Topics that were sent ``age_s`` ago or before, oldest first; each is sent before the next is asked for."""
        while self._sent:
            key, sent = next(iter(self._sent.items()))
            if sent.at + age_s > clock:
                return
            yield key

    def _due_at(self, key: _Key) -> float:
        sent = self._sent.get(key)
        return -math.inf if sent is None else sent.at + self._setup.interval_s

    def _next_gone(self) -> Publish:
        """A topic to forget, before another one gets its name."""
        topic = next(iter(self._gone))
        del self._gone[topic]
        return Publish(topic, b"", retain=True)

    def _next_other(self, clock: float) -> Publish | Unsubscribe | None:
        """A result, or a discovery message."""
        if self._results:
            return self._next_result()
        step = None if self._discovery is None else self._discovery.next(clock)
        if isinstance(step, Leave):
            return Unsubscribe(step.topic)
        return None if step is None else Publish(step.topic, step.payload, retain=True)

    def _next_result(self) -> Publish:
        return Publish(f"{self._base}/result", self._results.popleft())

    def _publish(self, key: _Key, wall: float, clock: float) -> Publish | None:
        topic = self._topic(key)
        if topic is None:
            return None
        expiry_s = self._expiry_s
        is_kept = True
        if key.part == _ONLINE:
            alive = self.phase is Phase.ONLINE and self._tree.is_alive(None) and self._tree.is_alive(key.slave)
            payload = _SAID[alive]
            if key.slave is None and not alive:
                expiry_s = 0  # as the will: what is not there stays so
        elif key.part == _CONDITION:
            condition = self._tree.conditions.get(key.id) or self._ended.pop(key.id, None)
            if condition is None:
                if key in self._sent:
                    self._forget(key)
                return None
            # one that has ended is sent once more, and expires
            is_kept = condition.retain
            payload = condition_payload(condition, self._offset, wall)
        else:
            readings = {node.id: reading for node, reading in self._tree.readings(key.slave)}
            members = [(name, node, readings[node.id]) for name, node in self._parts[key]]
            payload = values_payload(members, self._offset, wall, self._leaving)
        self._sent.pop(key, None)
        if is_kept:
            self._sent[key] = _Sent(topic, clock)
        return Publish(topic, payload, retain=True, expiry_s=expiry_s)

    def _farewell(self, wall: float, clock: float) -> Publish | Disconnect:
        """That nobody is there any more comes first, as the time may be short."""
        if not self._is_told:
            self._is_told = True
            self._waiting.pop(_Key(None, _ONLINE), None)
            return Publish(self._online_topic, _SAID[False], retain=True)
        if self._gone:
            return self._next_gone()
        if self._results:
            return self._next_result()
        while self._waiting:
            key = next(iter(self._waiting))
            del self._waiting[key]
            if (message := self._publish(key, wall, clock)) is not None:
                return message
        return Disconnect(self._leaving)

    # --- messages in ----------------------------------------------------------------------------------------------

    def receive(self, topic: str, payload: bytes, wall: float, *, retained: bool = False) -> Sequence[OrderWish]:
        """Take a message of the broker; nothing that it may hold raises. Returns an order for the run, whose result
        :meth:`answer` takes."""
        if self._discovery is not None and self._discovery.receive(topic, payload, retained=retained):
            return ()
        below = topic.removeprefix(f"{self._base}/slave/")
        levels = below.split("/")
        if self.phase is not Phase.ONLINE or below == topic or len(levels) != 3 or levels[1] != "set":
            return ()
        slave, _, name = levels
        order_time, made_at = sent_time(payload)
        try:
            return (self._wish(slave, name, payload, order_time, retained=retained),)
        except ValueError as error:
            self._refused(f"{slave}.{name}", str(error), order_time)
            self._add_result(f"{slave}.{name}", made_at, "refused", str(error), wall)
            return ()

    def answer(self, wish: OrderWish, result: str, reason: str, wall: float) -> None:
        self._add_result(wish.name, wish.made_at, result, reason, wall)

    def _wish(self, slave: str, name: str, payload: bytes, order_time: str, *, retained: bool) -> OrderWish:
        """The order that a message means. Raises ValueError with the reason if none exists."""
        if retained:
            raise ValueError("the broker had kept this order: nobody knows how old it is")
        order = self._orders.get((slave, name))
        if order is None:
            raise ValueError("there is no such order, or allow_commands does not list it")
        value, made_at = read_order(payload)
        return OrderWish(order.name, value, made_at, order_time)

    def _add_result(self, name: str, made_at: float | None, result: str, reason: str, wall: float) -> None:
        if len(self._results) >= _MOST_RESULTS:
            self.lost_results += 1
            self._tell("results of orders came faster than they could be sent: the oldest are lost")
            self._results.popleft()
        self._results.append(result_payload(name, made_at, result, reason, wall))


#: in the last levels of the topic of a condition, which may hold texts of a drive: different ids stay different
_ESCAPES: Final[Mapping[int, str]] = str.maketrans({"%": "%25", "+": "%2B", "#": "%23"})


def _wanted(node: Node) -> str:
    """The name of a value in its topic: that of a named value, or a word of dpstack for a program."""
    if node.path[0] in ("Inputs", "Outputs"):
        return node.path[-1]
    return "_".join(node.path[1:] or node.path).lower().replace(" ", "_")
