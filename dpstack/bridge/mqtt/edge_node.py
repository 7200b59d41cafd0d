"""The edge node of Sparkplug B 3.0: births, data, deaths and commands of a plant, in their order.

The bus is the edge node, its slaves are the devices. A message is made when it is asked for, with the values of that
moment: a slow broker gets fewer of them, and nothing waits in memory but the last value of each metric. With a
:class:`~dpstack.bridge.mqtt.history.History`, values that could not be delivered are kept there, and follow as history.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar, Final

from dpstack.bridge.mqtt.history import Absent, Entry
from dpstack.bridge.mqtt.json_payload import read_object
from dpstack.bridge.mqtt.payload import (
    BDSEQ,
    DATA_TYPES,
    LATEST_MS,
    REBIRTH,
    DataType,
    Given,
    MetricKind,
    Sample,
    birth,
    data,
    device_death,
    node_death,
    read_command,
    value_given,
)
from dpstack.bridge.mqtt.plant_node import (
    ConnectionNeeds,
    Disconnect,
    NodeOptions,
    NodeSetup,
    OrderWish,
    Phase,
    PlantNode,
    Publish,
)
from dpstack.bridge.names import SPARKPLUG_ID, SPARKPLUG_METRIC, unique_names
from dpstack.bridge.orders import time_words
from dpstack.plant.nodes import Node, OfferedOrder
from dpstack.plant.quality import BOOL, TEXT, Reading, Reason, Value
from dpstack.plant.tree import Born, Change, Changed, ClockSet, Died, NodesChanged, PlantTree
from dpstack.text import printable, shortened

#: sequence numbers are 0 to 255
_SEQUENCE: Final = 256
#: s between two births that hosts ask for
_REBIRTH_S: Final = 1.0
#: octets of a STATE message
_MOST_STATE: Final = 1024
_LAST_COMMAND: Final = "Last command"


class _Device:
    """A slave that has had its DBIRTH in this session."""

    def __init__(self, name: str) -> None:
        self.name = name
        #: changes that were not published: by id of the node
        self.pending: dict[str, Reading] = {}
        self.due = -math.inf
        #: metrics whose last published quality was not good, or had a remark
        self.remarked: set[str] = set()


class EdgeNode(PlantNode):
    counts_sessions: ClassVar[bool] = True

    def __init__(self, setup: NodeSetup, tree: PlantTree, options: NodeOptions) -> None:
        super().__init__(setup, tree, options)
        self._clear_first = options.clear_first
        self._pause = options.pause
        self._number = 0
        self._seq = 0
        self._death_sent = False
        # metrics by key: the id of a node; slave/N/order/... of an order without a node, own/... of the edge node
        self._kinds: dict[str, MetricKind] = {}
        self._orders: dict[str, OfferedOrder] = {}
        #: keys by slave (None: the edge node) and name, and by slave and alias
        self._keys: dict[tuple[int | None, str | int], str] = {}
        #: keys of the orders without a node, by slave
        self._bare_orders: dict[int, list[str]] = {}
        self._aliases: dict[str, int] = {}
        self._highest_alias = 0
        self._device_ids: dict[int, str] = {}
        self._bus_nodes: list[Node] = []
        # the session
        self._node: _Device | None = None
        self._devices: dict[int, _Device] = {}
        self._needs_birth = False
        self._births: dict[int, None] = {}
        self._deaths: dict[int, str] = {}
        self._rebirth_asked = False
        self._born_at = -math.inf
        # the primary host
        self._host_time: float | None = None
        self._host_online = False
        #: s until the births, from the next look at the clock on; and the time by ``clock`` before which none goes out
        self._pause_s = 0.0
        self._births_from = -math.inf
        # commands
        self._own: dict[str, tuple[Value, str, float]] = {}
        # history
        self._history = options.history
        self._clock = 0.0
        self._was_born = False
        #: devices by their id
        self._slave_of: dict[str, int] = {}
        #: values that are stale as their device has died: DDEATH says it
        self._dying: dict[int, list[Entry]] = {}
        self._rename()

    # --- the connection -------------------------------------------------------------------------------------------

    def connect(self, number: int, wall: float) -> ConnectionNeeds:
        self.disconnected()
        self._number = number
        self.phase = Phase.CONNECTING
        self._host_online = False
        setup = self._setup
        topics = [setup.topic("NCMD"), setup.topic("DCMD", "+")]
        if setup.primary_host:
            topics.append(setup.state_topic)
        will = Publish(setup.topic("NDEATH"), node_death(self._number, _ms(wall)), qos=1)
        return ConnectionNeeds(setup.client_id, will, tuple(topics))

    def connected(self) -> None:
        if self.phase is not Phase.CONNECTING:
            return
        if self._clear_first:
            self._clear_first = False
            self._leave("the number of the last session is not known: another session begins")
        elif self._setup.primary_host and not self._host_online:
            self.phase = Phase.WAITING
        else:
            self._begin()

    def disconnected(self) -> None:
        self.phase = Phase.OFFLINE
        self._end_session()

    def end(self, why: str) -> None:
        """An ordered end: NDEATH and the end of the connection come next."""
        if self.phase in (Phase.WAITING, Phase.ONLINE):
            self._leave(why)

    def _begin(self) -> None:
        self.phase = Phase.ONLINE
        self._needs_birth = True

    def _leave(self, why: str) -> None:
        self.phase, self._leaving, self._death_sent = Phase.LEAVING, why, False
        self._end_session()

    def _end_session(self) -> None:
        if self._history is not None:
            self._history.session_ended()  # before those of below, which are newer
        self._keep_pending()
        self._node = None
        self._devices.clear()
        self._births.clear()
        self._deaths.clear()
        self._needs_birth = self._rebirth_asked = False
        self._born_at = self._births_from = -math.inf
        self._pause_s = 0.0

    # --- the tree -------------------------------------------------------------------------------------------------

    def take(self, changes: Sequence[Change], wall: float, clock: float) -> None:
        self._clock = clock
        self._set_clock(changes, wall, clock)
        died = {change.slave for change in changes if isinstance(change, Died)}
        for change in changes:
            match change:
                case Changed(node=node, reading=reading):
                    owner = self._node if node.slave is None else self._devices.get(node.slave)
                    if owner is not None:
                        self._replace(node.slave, owner, node.id, clock)
                        owner.pending[node.id] = reading
                    else:
                        self._keep_change(node.slave, node.id, reading, has_died=node.slave in died)
                case Born(slave=None):
                    self._show("Bus running", True, wall)
                case Died(slave=None):
                    self._show("Bus running", False, wall)
                case Born(slave=slave) if self._node is not None and slave is not None:
                    self._births[slave] = None
                case Died(slave=slave) if slave is not None:
                    self._lose(slave)
                case NodesChanged():
                    self._rename()
                case ClockSet():
                    if self._node is not None:
                        self._tell("the clock of this computer was set: all values are published again, with new times")
                        self._needs_birth = True

    def _lose(self, slave: int) -> None:
        """The DBIRTH of a slave does not hold any more."""
        device = self._devices.pop(slave, None)
        if device is not None:
            self._keep_pending_of(slave, device)
            self._deaths[slave] = device.name
        self._births.pop(slave, None)

    def _rename(self) -> None:
        """Names and aliases of all metrics. A metric keeps its alias; none is given twice."""
        tree = self._tree
        slaves = tree.slaves
        ids_before, self._device_ids = self._device_ids, self._slave_names(SPARKPLUG_ID)
        self._slave_of = {name: one for one, name in self._device_ids.items()}
        self._kinds, self._orders, self._keys, self._bare_orders = {}, {}, {}, {}
        allowed = self._allowed_orders()
        known, self._aliases = self._aliases, {}
        # hosts know the old aliases of a device below its old name
        other_id = tuple(f"slave/{one}/" for one in slaves if ids_before.get(one) != self._device_ids[one])
        before = {key: alias for key, alias in known.items() if not key.startswith(other_id)}
        bus_nodes = [node for node, _ in tree.readings(None)]
        self._add_nodes(None, bus_nodes, before, allowed)
        for name, type_ in _OWN:
            self._add(None, f"own/{name}", MetricKind(name, None, DATA_TYPES[type_]), before)
        self._add(None, "own/bdSeq", BDSEQ, before)
        for address in slaves:
            self._add_nodes(address, [node for node, _ in tree.readings(address)], before, allowed)
        for order in allowed.values():
            self._add_order(order, before)
        for address, device in list(self._devices.items()):
            if self._device_ids.get(address) != device.name:
                self._lose(address)
                if address in self._device_ids:
                    self._births[address] = None
        if bus_nodes != self._bus_nodes:
            self._bus_nodes = bus_nodes
            self._needs_birth = self._needs_birth or self._node is not None

    def _add_nodes(
        self, slave: int | None, nodes: Sequence[Node], before: Mapping[str, int], allowed: Mapping[str, OfferedOrder]
    ) -> None:
        names, changed = _metric_names(nodes)
        for text in changed:
            self._tell(text)
        for node in nodes:
            order = node.order
            if order is not None and allowed.get(order.name) == order:
                self._orders[node.id] = order
            kind = MetricKind(
                names[node.id],
                None,
                DATA_TYPES[node.type],
                writable=node.id in self._orders,
                unit=node.unit,
                low=node.low,
                high=node.high,
                text=node.text,
            )
            self._add(slave, node.id, kind, before)

    def _add_order(self, order: OfferedOrder, before: Mapping[str, int]) -> None:
        """An order without a node of its own: it sets the node that shows it, or gets a metric."""
        word = order.operation
        if word is None:
            return
        shown = f"slave/{order.slave}/drive/{_SHOWN_BY.get(word)}"
        if shown in self._kinds:
            self._orders[shown] = order
            self._kinds[shown] = replace(self._kinds[shown], writable=True)
            return
        key = f"slave/{order.slave}/order/{word}"
        kind = MetricKind(f"Commands/{word}", None, DATA_TYPES[order.type or BOOL], writable=True)
        self._orders[key] = order
        self._bare_orders.setdefault(order.slave, []).append(key)
        self._add(order.slave, key, kind, before)

    def _add(self, slave: int | None, key: str, kind: MetricKind, before: Mapping[str, int]) -> None:
        """Keep a metric. Its alias is that of ``before``, or one that no metric ever had."""
        alias = before.get(key)
        if alias is None:
            alias = self._highest_alias = self._highest_alias + 1
        self._aliases[key] = alias
        self._kinds[key] = replace(kind, alias=alias)
        self._keys[slave, kind.name] = self._keys[slave, alias] = key

    # --- messages out ---------------------------------------------------------------------------------------------

    def next(self, wall: float, clock: float) -> Publish | Disconnect | None:
        if self.phase is Phase.LEAVING:
            if self._death_sent:
                return Disconnect(self._leaving)
            self._death_sent = True
            return Publish(self._setup.topic("NDEATH"), node_death(self._number, _ms(wall)))
        if self.phase is not Phase.ONLINE or self._tree.plant is None:
            return None
        if clock < self._first_births(clock):
            return None
        now_ms, self._clock = _ms(wall), clock
        if self._deaths:
            slave = next(iter(self._deaths))
            self._was_sent(self._dying.pop(slave, ()))
            return Publish(self._setup.topic("DDEATH", self._deaths.pop(slave)), device_death(self._next_seq(), now_ms))
        if self._needs_birth:
            return self._node_birth(now_ms, clock)
        while self._births:
            slave = next(iter(self._births))
            del self._births[slave]
            if self._tree.is_alive(slave) and slave in self._device_ids:
                return self._device_birth(slave, now_ms, clock)
        # behind the births: a host that asks again for each of them would never get the last one. Until it is due, data
        # and history go on: a host that asks again and again holds nothing back
        if self._rebirth_asked and clock >= self._born_at + _REBIRTH_S:
            return self._node_birth(now_ms, clock)
        assert self._node is not None
        waiting = [one for one in ((None, self._node), *self._devices.items()) if one[1].pending]
        # the one that has waited longest: behind a slow broker no device takes the turn of another
        slave_or_none, owner = min(waiting, key=lambda one: one[1].due, default=(None, self._node))
        if owner.pending and clock >= owner.due:
            return self._data(slave_or_none, owner, now_ms, clock)
        return self._historical(wall, clock)

    def due(self, clock: float) -> float:
        if self.phase is Phase.LEAVING:
            return clock
        if self.phase is not Phase.ONLINE or self._tree.plant is None:
            return math.inf
        if clock < (births_from := self._first_births(clock)):
            return births_from
        if self._deaths or self._births or self._needs_birth:
            return clock
        rebirth = self._born_at + _REBIRTH_S if self._rebirth_asked else math.inf
        history = math.inf if self._history is None else self._history.next_due()
        return min(rebirth, history, *(owner.due for owner in self._owners() if owner.pending))

    def _first_births(self, clock: float) -> float:
        """The time by ``clock`` before which this session has no births."""
        if self._pause_s:
            self._births_from, self._pause_s = clock + self._pause_s, 0.0
        return self._births_from

    def _node_birth(self, now_ms: int, clock: float) -> Publish:
        self._needs_birth = self._rebirth_asked = False
        self._born_at = clock
        self._seq = 0
        self._keep_pending()
        if self._history is not None:
            self._history.session_began()
        self._node = node = _Device("")
        node.due = clock + self._setup.interval_s
        self._devices.clear()
        self._deaths.clear()
        self._births = dict.fromkeys(slave for slave in self._device_ids if self._tree.is_alive(slave))
        for key, value in (("Bus running", self._tree.is_alive(None)), *((name, None) for name, _ in _OWN)):
            self._own.setdefault(key, (value, "", now_ms / 1000))
        readings = self._tree.readings(None)
        samples = [self._sample(node, one.id, reading, now_ms) for one, reading in readings]
        samples += [self._sample(node, f"own/{name}", self._own_reading(name), now_ms) for name, _ in _OWN]
        samples.append(Sample(self._kinds["own/bdSeq"], Reading(self._number, Reason.GOOD), now_ms))
        rebirth = MetricKind(REBIRTH, None, DataType.BOOLEAN, writable=True, text="true: publish all births again")
        samples.append(Sample(rebirth, Reading(False, Reason.GOOD), now_ms))
        self._is_covered(None, readings)
        return Publish(self._setup.topic("NBIRTH"), birth(samples, self._seq, now_ms))

    def _device_birth(self, slave: int, now_ms: int, clock: float) -> Publish:
        before = self._devices.get(slave)
        if before is not None:
            self._keep_pending_of(slave, before)
        device = self._devices[slave] = _Device(self._device_ids[slave])
        device.due = clock + self._setup.interval_s
        readings = self._tree.readings(slave)
        self._is_covered(slave, readings)
        samples = [self._sample(device, one.id, reading, now_ms) for one, reading in readings]
        for key in self._bare_orders.get(slave, ()):
            # as Node Control/Rebirth: it is false, and a host writes true
            reading = Reading(False if self._orders[key].type is None else None, Reason.GOOD)
            samples.append(Sample(self._kinds[key], reading, now_ms))
        return Publish(self._setup.topic("DBIRTH", device.name), birth(samples, self._next_seq(), now_ms))

    def _encoded(self, samples: Iterable[Sample], now_ms: int) -> bytes:
        return data(samples, self._next_seq(), now_ms, has_types=self._setup.has_types)

    def _data(self, slave: int | None, owner: _Device, now_ms: int, clock: float) -> Publish:
        pending, owner.pending = owner.pending, {}
        owner.due = clock + self._setup.interval_s
        self._was_sent(self._entries(slave, pending))
        samples = [self._sample(owner, key, reading, now_ms) for key, reading in pending.items()]
        kind, device = ("NDATA", None) if slave is None else ("DDATA", owner.name)
        return Publish(self._setup.topic(kind, device), self._encoded(samples, now_ms))

    def _sample(self, owner: _Device, key: str, reading: Reading, now_ms: int) -> Sample:
        had_remark = key in owner.remarked
        if reading.has_remark:
            owner.remarked.add(key)
        else:
            owner.remarked.discard(key)
        return Sample(self._kinds[key], reading, self._time_ms(key, reading, now_ms), with_quality=had_remark)

    def _time_ms(self, key: str, reading: Reading, now_ms: int) -> int:
        """The time of a value by the clock of the computer."""
        if not reading.time:
            return now_ms
        return min(_ms(reading.time if key.startswith("own/") else reading.time + self._offset), now_ms)

    def _owners(self) -> Iterator[_Device]:
        """Edge node and devices that have had their births in this session."""
        if self._node is not None:
            yield self._node
        yield from self._devices.values()

    def _next_seq(self) -> int:
        self._seq = (self._seq + 1) % _SEQUENCE
        return self._seq

    # --- history --------------------------------------------------------------------------------------------------

    def _set_clock(self, changes: Sequence[Change], wall: float, clock: float) -> None:
        """Changes that come with ClockSet have the new times."""
        offsets = [change.offset for change in changes if isinstance(change, ClockSet)]
        if offsets:
            self._offset = offsets[-1]
        if self._history is not None and (offsets or self._history.offset_ms is None):
            self._history.offset_ms = _offset_ms(wall, clock)

    def _entries(self, slave: int | None, readings: Mapping[str, Reading]) -> list[Entry]:
        """Values as they are kept: of a metric as hosts know it."""
        if self._history is None or self._history.offset_ms is None:
            return []
        device = None if slave is None else self._device_ids.get(slave)
        offset_ms, found = self._history.offset_ms, []
        now_ms = round(self._clock * 1000) + offset_ms
        for key, reading in readings.items():
            kind = self._kinds.get(key)
            if kind is not None and (slave is None or device is not None):
                at_ms = self._time_ms(key, reading, now_ms) - offset_ms
                what = (device, kind.name, int(kind.type), kind.unit)
                found.append(Entry(*what, at_ms, offset_ms, reading.value, reading.reason, reading.note))
        return found

    def _keep_change(self, slave: int | None, key: str, reading: Reading, *, has_died: bool) -> None:
        """Keep a change that no data can carry now. A device that is dead has none, but those of its death; one that is
        back before its DDEATH is out has others."""
        if reading.value is None and reading.reason is Reason.WAITING:
            return
        if slave in self._deaths and not self._tree.is_alive(slave):
            self._dying.setdefault(slave, []).extend(self._entries(slave, {key: reading}))
        elif slave is None or has_died or self._tree.is_alive(slave):
            self._keep(self._entries(slave, {key: reading}))

    def _replace(self, slave: int | None, owner: _Device, key: str, clock: float) -> None:
        """A newer value takes the place of one that was not sent: it is kept if it was its turn already."""
        before = owner.pending.get(key)
        if before is not None and clock >= owner.due:
            self._keep(self._entries(slave, {key: before}))

    def _keep_pending(self) -> None:
        """Keep changes that were not sent, and those that the deaths would have shown."""
        if self._node is not None:
            self._keep_pending_of(None, self._node)
        for slave, device in self._devices.items():
            self._keep_pending_of(slave, device)
        for entries in self._dying.values():
            self._keep(entries)
        self._dying.clear()

    def _keep_pending_of(self, slave: int | None, owner: _Device) -> None:
        self._keep(self._entries(slave, owner.pending))
        owner.pending = {}

    def _keep(self, entries: Iterable[Entry]) -> None:
        if self._history is not None:
            for entry in entries:
                self._history.keep(entry)

    def _was_sent(self, entries: Iterable[Entry]) -> None:
        if self._history is not None:
            self._history.sent(entries)

    def _is_covered(self, slave: int | None, readings: Iterable[tuple[Node, Reading]]) -> None:
        """A birth has these values. Those that wait in memory since the program began are in its first birth, whatever
        their times."""
        if self._history is None:
            return
        for node, reading in readings:
            for entry in self._entries(slave, {node.id: reading}):
                at_ms = entry.at_ms if self._was_born else None
                self._history.covered(entry.device, entry.metric, reading, at_ms)
        self._history.look_again()

    def _historical(self, wall: float, clock: float) -> Publish | None:
        """History, behind all births and the data of this moment."""
        if self._history is None:
            return None
        self._was_born = True
        now_ms = _ms(wall)
        found = self._history.next_samples(self._find, self._unborn, now_ms, _offset_ms(wall, clock), clock)
        if found is None:
            return None
        device, samples = found
        kind = "NDATA" if device is None else "DDATA"
        return Publish(self._setup.topic(kind, device), self._encoded(samples, now_ms))

    def _find(self, entry: Entry) -> MetricKind | Absent:
        """The metric of a kept value in the births of this session."""
        slave = None if entry.device is None else self._slave_of.get(entry.device)
        key = None if entry.device is not None and slave is None else self._keys.get((slave, entry.metric))
        kind = None if key is None else self._kinds[key]
        if kind is None or (int(kind.type), kind.unit) != (entry.type, entry.unit):
            return Absent.UNKNOWN
        return kind if slave is None or slave in self._devices else Absent.WAITING

    def _unborn(self) -> list[str]:
        """Devices without a birth in this session."""
        return [name for slave, name in self._device_ids.items() if slave not in self._devices]

    # --- metrics of the edge node itself --------------------------------------------------------------------------

    def _show(self, name: str, value: Value, wall: float) -> None:
        self._own[name] = (value, "", wall)
        if self._node is not None:
            self._node.pending[f"own/{name}"] = self._own_reading(name)
        else:
            self._keep(self._entries(None, {f"own/{name}": self._own_reading(name)}))

    def _own_reading(self, name: str) -> Reading:
        value, note, time = self._own[name]
        return Reading(value, Reason.GOOD if value is not None else Reason.WAITING, time, note)

    # --- messages in ----------------------------------------------------------------------------------------------

    def receive(self, topic: str, payload: bytes, wall: float, *, retained: bool = False) -> Sequence[OrderWish]:
        setup = self._setup
        if setup.primary_host and topic == setup.state_topic:
            self._host_state(payload, retained=retained)
            return ()
        if self.phase is not Phase.ONLINE or self._node is None:  # nobody knows a metric before its birth
            if topic.startswith(setup.topic("DCMD", "")):
                self._refused(topic.rpartition("/")[2], "this node has had no birth", "")
            return ()
        if topic == setup.topic("NCMD"):
            device = None
        elif topic.startswith(setup.topic("DCMD", "")):
            device = topic.rpartition("/")[2]
        else:
            return ()
        try:
            command = read_command(payload)
        except ValueError as error:
            self._refuse("", str(error), wall, None)
            return ()
        wishes: list[OrderWish] = []
        for given in command.metrics:
            if device is None and given.name == REBIRTH:
                # a rebirth is harmless, so it needs no age
                self._rebirth_asked = self._rebirth_asked or given.value is True
                continue
            try:
                wishes.append(self._wish(device, given, command.time_ms, retained=retained))
            except ValueError as error:
                name = f"{device}: {given.text}" if device is not None else given.text
                self._refuse(name, str(error), wall, command.time_ms)
        return wishes

    def answer(self, wish: OrderWish, result: str, reason: str, wall: float) -> None:
        self._show_result(wish.name, result, reason, wall)

    def _wish(self, device: str | None, given: Given, time_ms: int | None, *, retained: bool) -> OrderWish:
        """The order that a metric of a command means. Raises ValueError with the reason if none exists."""
        if retained:
            raise ValueError("the broker had kept this command: nobody knows how old it is")
        key, order = self._order_given(device, given)
        if order is None:
            raise ValueError("this metric cannot be written")
        if time_ms is None:
            raise ValueError("it has no timestamp")
        return OrderWish(order.name, value_given(given, self._kinds[key].type), time_ms / 1000)

    def _order_given(self, device: str | None, given: Given) -> tuple[str, OfferedOrder | None]:
        """The key of the metric, and its order. Raises ValueError for a metric that is in no birth."""
        slave = next((one for one, born in self._devices.items() if born.name == device), None)
        if device is not None and slave is None:
            raise ValueError("this device has had no birth")
        named = [one for one in (given.name, given.alias) if one is not None]
        keys = {self._keys.get((slave, one)) for one in named}
        if not named:
            raise ValueError("it has neither name nor alias")
        if len(keys) > 1:
            raise ValueError("name and alias are not those of one metric")
        key = keys.pop()
        if key is None:
            raise ValueError("there is no such metric")
        return key, self._orders.get(key)

    def _refuse(self, name: str, reason: str, wall: float, time_ms: int | None) -> None:
        self._refused(name or "unknown", reason, time_words(None if time_ms is None else time_ms / 1000))
        self._show_result(name or "unknown", "refused", reason, wall)

    def _show_result(self, name: str, result: str, reason: str, wall: float) -> None:
        for key, text in (("name", name), ("result", result), ("reason", reason)):
            self._show(f"{_LAST_COMMAND}/{key}", shortened(printable(text), 300), wall)

    # --- the primary host -----------------------------------------------------------------------------------------

    def _host_state(self, payload: bytes, *, retained: bool) -> None:
        """Take STATE. One that the broker had kept comes to this gateway alone, so births need no pause."""
        state = _read_state(payload)
        host = self._setup.primary_host
        if state is None:
            self._tell(f"a STATE message of primary host {host} cannot be read: it is left out")
            return
        online, time = state
        if self._host_time is not None and time < self._host_time:
            self._tell(f"a STATE message of primary host {host} is older than the last one: it is left out")
            return
        self._host_time, self._host_online = time, online
        if online and self.phase in (Phase.CONNECTING, Phase.WAITING):
            self._pause_s = 0.0 if retained else self._pause()
        if online and self.phase is Phase.WAITING:
            self._begin()
        elif not online and self.phase is Phase.ONLINE:
            self._tell(f"primary host {host} is offline: births wait for it")
            self._leave("the primary host is offline")


#: metrics of the edge node itself, besides those of the bus
_OWN: Final = (
    ("Bus running", BOOL),
    (f"{_LAST_COMMAND}/name", TEXT),
    (f"{_LAST_COMMAND}/result", TEXT),
    (f"{_LAST_COMMAND}/reason", TEXT),
)


#: the quantity of a drive that shows an order to it
_SHOWN_BY: Final = {"speed": "setpoint"}


def _metric_names(nodes: Sequence[Node]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Names of metrics by id of the node: the path of the node, each level valid; the changed ones are reported."""
    names: dict[str, str] = {}
    changed: list[str] = []
    folders: dict[tuple[str, ...], list[Node]] = {}
    for node in nodes:
        folders.setdefault(node.path[:-1], []).append(node)
    for folder, inside in folders.items():
        found = unique_names(SPARKPLUG_METRIC, [(node.id, node.path[-1]) for node in inside])
        changed += found.changed
        above = [SPARKPLUG_METRIC.valid(level) for level in folder]
        names |= {id_: "/".join((*above, name)) for id_, name in found.names.items()}
    return names, tuple(changed)


def _read_state(payload: bytes) -> tuple[bool, float] | None:
    """``online`` and ``timestamp`` of a STATE message; None for anything else."""
    try:
        state = read_object(payload, _MOST_STATE)
    except ValueError:
        return None
    online, time = state.get("online"), state.get("timestamp")
    if not isinstance(online, bool) or isinstance(time, bool) or not isinstance(time, (int, float)):
        return None
    return (online, time) if 0 <= time <= LATEST_MS else None


def _offset_ms(wall: float, clock: float) -> int:
    return round((wall - clock) * 1000)


def _ms(seconds: float) -> int:
    return min(max(0, round(seconds * 1000)), LATEST_MS)
