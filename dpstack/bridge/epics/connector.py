"""``EpicsConnector``: the tree of a plant as a server of Channel Access."""

from __future__ import annotations

import asyncio
import logging
import socket
import time
from collections import Counter
from collections.abc import Sequence
from typing import ClassVar, Final

import caproto as ca

from dpstack.bridge.connector import Connector, Tell
from dpstack.bridge.epics.circuit import Refused
from dpstack.bridge.epics.names import Pv, pvs_of
from dpstack.bridge.epics.server import BEACON_PORT, Server
from dpstack.bridge.epics.variables import FIELDS, MOST_UNIT, Variable, cut
from dpstack.bridge.orders import OrderResult, Orders, Refusal
from dpstack.errors import ConfigError
from dpstack.plant.nodes import Node
from dpstack.plant.quality import BYTES, TEXT, Reading, Value
from dpstack.plant.tree import Change, Changed, ClockSet, NodesChanged, PlantTree
from dpstack.tcp_address import Listen, is_local, join
from dpstack.trace import Severity

#: s between two looks at the changes, which are merged for each variable
WRITE_S: Final = 0.1
#: s until clients are served, even if the plant is not known yet
_PLANT_S: Final = 2.0
#: variables that get a value before others have their turn, some 0.06 ms each
_AT_ONCE: Final = 20
#: s that a put waits, when it is done, for the value of the bus: a client reads it right behind
_SETTLE_S: Final = 0.5
#: s between two remarks about clients that were cut off
_REMARK_S: Final = 60.0
#: variables that clients use at the same time
MOST_VARIABLES: Final = 50_000


class EpicsConnector(Connector):
    """Serves the tree. A variable is made when a client asks for it first. ``beacons``: (host, port) of those that get
    them besides this computer."""

    name: ClassVar[str] = "epics"

    def __init__(
        self, tree: PlantTree, tell: Tell, listen: Listen, prefix: str, orders: Orders,
        *, beacons: Sequence[tuple[str, int]] = (),
    ) -> None:  # fmt: skip
        super().__init__(tree, tell)
        self.is_built = False
        self._listen = listen
        self._prefix = prefix
        self._orders = orders
        self._beacons = tuple(beacons)
        self._server: Server | None = None
        self._sockets: list[socket.socket] = []
        self._offset = 0.0
        self._structure = True
        self._pvs: dict[str, Pv] = {}
        self._readings: dict[str, Reading] = {}
        self._changed: set[str] = set()
        #: those that clients use, by name and field, and by the id of their node
        self._variables: dict[tuple[str, str], Variable] = {}
        self._of_node: dict[str, list[Variable]] = {}
        self._reported: set[str] = set()
        self._losses: Counter[str] = Counter()
        self._remark_at = 0.0

    @property
    def port(self) -> int:
        """The port on which it listens."""
        return self._listen.port if self._server is None else self._server.port

    async def open(self) -> None:
        log = logging.getLogger("caproto")  # it quotes clients, at any rate
        log.addHandler(logging.NullHandler())
        log.propagate = False
        for one in self._listen.sockets():
            if one.family == socket.AF_INET:
                self._sockets.append(one)
            else:
                one.close()
        if not self._sockets:
            raise ConfigError(f"listen {self._listen.host!r} has no address of IPv4; Channel Access has no other")
        local = is_local(self._sockets)
        beacons = [*self._beacons, *([("127.0.0.1", BEACON_PORT)] if local else [])]
        self._server = Server(self, self._sockets, beacons=beacons, cut_off=self._cut_off)
        self._server.bind()
        where = f"Channel Access on {join(self._listen.host, self.port)}, names begin with {self._prefix}"
        if local:
            self.tell(where, Severity.INFO)
            return
        self.tell(f"{where}; everybody who reaches this port may read the plant", Severity.WARNING)
        if self._orders.takes_any:
            self.tell(
                "everybody who reaches this port may give the orders of allow_commands: Channel Access has no password",
                Severity.WARNING,
            )

    def take(self, changes: Sequence[Change]) -> None:
        for change in changes:
            if isinstance(change, Changed):
                self._readings[change.node.id] = change.reading
                if change.node.id in self._of_node:
                    self._changed.add(change.node.id)
            elif isinstance(change, NodesChanged):
                self._structure, self.is_built = True, False
            elif isinstance(change, ClockSet):
                self._offset = change.offset
                self._changed.update(self._of_node)

    async def serve(self) -> None:
        assert self._server is not None
        loop = asyncio.get_running_loop()
        until = loop.time() + _PLANT_S
        while self.tree.plant is None and loop.time() < until:  # noqa: ASYNC110  the tree calls nobody
            await asyncio.sleep(WRITE_S)
        await self.write_changes()
        await self._server.begin()
        try:
            while True:
                await self.write_changes()
                await asyncio.sleep(WRITE_S)
        finally:
            try:
                await self.write_changes()  # the end of the bus
                await self._server.flush()
            finally:
                self._server.end()

    def close(self) -> None:
        if self._server is not None:
            self._server.end()
        for one in self._sockets:
            one.close()
        self._sockets.clear()

    # --- variables ------------------------------------------------------------------------------------------------

    def wall(self, at: float) -> float:
        """A time of the tree as one of this computer."""
        return at + self._offset

    async def write_changes(self) -> None:
        """Show what :meth:`take` has got since the last time."""
        if self._structure and self.tree.plant is not None:
            self._structure = False
            self._build()
            self.is_built = not self._structure
        assert self._server is not None
        changed, self._changed = self._changed, set()
        begun = time.thread_time()
        for number, id_ in enumerate(changed, 1):
            for variable in tuple(self._of_node.get(id_, ())):
                await variable.show(self._readings[id_], self.wall)
            if number % _AT_ONCE == 0:
                begun = await self._server.share.pause(begun)
        self._report_losses()

    def _build(self) -> None:
        nodes = [(node, reading) for slave in (None, *self.tree.slaves) for node, reading in self.tree.readings(slave)]
        self._readings = {node.id: reading for node, reading in nodes}
        bus = [node for node, _ in self.tree.readings(None)]
        found = pvs_of(self._prefix, bus, self.tree.slaves, self._orders.takes)
        self._pvs = dict(found.pvs)
        for name in found.too_long:
            self._tell_once(f"{name} is left out: it has {len(name)} characters, which is too long for EPICS")
        for text in found.changed:
            self._tell_once(text)
        units = dict.fromkeys(pv.node.unit for pv in self._pvs.values() if cut(pv.node.unit, MOST_UNIT) != pv.node.unit)
        for unit in units:
            self._tell_once(
                f"the unit {unit!r} is shown as {cut(unit, MOST_UNIT)!r}: Channel Access has {MOST_UNIT} octets"
            )
        for key, variable in tuple(self._variables.items()):
            if self._pvs.get(key[0]) != variable.pv:
                self._forget(key, variable)
        if self._server is not None:
            self._server.drop(lambda variable: self._pvs.get(variable.pv.name) != variable.pv)
        self._changed.update(self._of_node)

    def _forget(self, key: tuple[str, str], variable: Variable) -> None:
        del self._variables[key]
        others = self._of_node[variable.pv.node.id]
        others.remove(variable)
        if not others:
            del self._of_node[variable.pv.node.id]

    def _parse(self, name: str) -> tuple[Pv, str] | None:
        base, _, field = name.partition(".")
        pv = self._pvs.get(base)
        if pv is None or field not in FIELDS or (field == "VAL$" and not _is_text(pv.node)):
            return None
        return pv, "" if field == "VAL" else field

    def knows(self, name: str) -> bool:
        return self._parse(name) is not None

    async def find(self, name: str) -> Variable | None:
        found = self._parse(name)
        if found is None:
            return None
        key = found[0].name, found[1]
        variable = self._variables.get(key)
        if variable is None:
            if len(self._variables) >= MOST_VARIABLES and not self._made_room():
                return None
            variable = self._variables[key] = Variable(*found)
            self._of_node.setdefault(variable.pv.node.id, []).append(variable)
            await variable.show(self._readings[variable.pv.node.id], self.wall)
        return variable

    def _made_room(self) -> bool:
        """Forget variables that no client has a channel of. Returns whether there were any."""
        assert self._server is not None
        used = {id(variable) for circuit in self._server.circuits for variable in circuit.variables}
        unused = [(key, variable) for key, variable in self._variables.items() if id(variable) not in used]
        for key, variable in unused:
            self._forget(key, variable)
        return bool(unused)

    def _tell_once(self, text: str) -> None:
        if text not in self._reported and len(self._reported) < 1000:
            self._reported.add(text)
            self.tell(text, Severity.WARNING)

    def _cut_off(self, address: str, why: str) -> None:
        self.dropped += 1
        if len(self._losses) < 100:
            self._losses[f"{why} (last: {address})"] += 1

    def _report_losses(self) -> None:
        now = asyncio.get_running_loop().time()
        if self._losses and now >= self._remark_at:
            self._remark_at = now + _REMARK_S
            shown = "; ".join(f"{count} x a client was cut off: {why}" for why, count in self._losses.most_common(3))
            self._losses.clear()
            self.tell(shown, Severity.WARNING)

    # --- orders ---------------------------------------------------------------------------------------------------

    def may_put(self, variable: Variable) -> bool:
        order = variable.pv.order
        plant = self.tree.plant
        return (
            order is not None and variable.is_value and plant is not None and plant.read_only is False
            and self._orders.takes(order)
        )  # fmt: skip

    async def put(self, variable: Variable, value: Value, who: str) -> Refused | None:
        order = variable.pv.order
        assert order is not None
        if variable.pv.is_button:
            if not value:
                return None  # a button of a screen that is released
            value = None
        given = value if order.type is None else _of_type(value, order.type)
        before = self._readings.get(variable.pv.node.id)
        result = await self._give(order.name, given, who, is_output=bool(order.output))
        if result.result != "done":
            status = ca.CAStatus.ECA_NOWTACCESS if result.kind is Refusal.NOT_ALLOWED else ca.CAStatus.ECA_PUTFAIL
            return Refused(status, result.reason)
        if variable.pv.is_button:
            await self._settle_drive()
        else:
            await self._settle(variable, before, given)
        return None

    async def _give(self, name: str, value: Value, who: str, *, is_output: bool) -> OrderResult:
        if is_output:
            [result] = await self._orders.give_outputs([(name, value)], made_at=None, by=who)
            return result
        return await self._orders.give(name, value, made_at=None, by=who)

    async def _settle(self, variable: Variable, before: Reading | None, given: Value) -> None:
        """Wait until the bus shows ``given``, or another value than ``before``, for a while."""
        loop = asyncio.get_running_loop()
        id_, until = variable.pv.node.id, loop.time() + _SETTLE_S
        while loop.time() < until:
            now = self._readings.get(id_)
            if now is None or before is None or now.value != before.value or now.value == given:
                break
            await asyncio.sleep(0.02)
        if id_ in self._readings:
            await variable.show(self._readings[id_], self.wall)

    async def _settle_drive(self) -> None:
        """Wait until the stream shows the drive after its order, for a while: the first snapshot may be older."""
        loop = asyncio.get_running_loop()
        until, snapshots, last = loop.time() + _SETTLE_S, 0, self.tree.t
        while snapshots < 2 and loop.time() < until:
            await asyncio.sleep(0.02)
            if self.tree.t != last:
                snapshots, last = snapshots + 1, self.tree.t
        await self.write_changes()

    def refuse(self, variable: Variable, reason: str, who: str) -> None:
        order = variable.pv.order or variable.pv.node.order
        self._orders.refuse(variable.pv.name if order is None else order.name, reason, by=who)


def _is_text(node: Node) -> bool:
    return node.type == TEXT


def _of_type(value: Value, type_: str) -> Value:
    """A whole number as one: clients send most numbers as doubles."""
    if type_ != BYTES and isinstance(value, float) and value.is_integer() and type_ not in ("f32", "f64"):
        return int(value)
    return value
