"""An edge node of Sparkplug B between the tree of a plant and a model of a broker with a host, in virtual time."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

from plant_items import HOIST, PLANT, VALVES
from sparkplug_host import Host, read_payload, tag

from dpstack.bridge.mqtt.edge_node import EdgeNode
from dpstack.bridge.mqtt.plant_node import (
    ConnectionNeeds,
    Disconnect,
    NodeOptions,
    NodeSetup,
    OrderWish,
    Phase,
    Publish,
    no_pause,
)
from dpstack.bridge.mqtt.session_file import SessionFile
from dpstack.plant.tree import Change, ClockSet, PlantTree

GROUP, NODE = "plant 1", "segment 4"


def all_orders(name: str) -> bool:
    return name != ""


class Rig:
    """Time passes in :meth:`wait` only. ``told``: the remarks of the edge node; ``wills``: those that the broker has
    not published yet; ``orders``: those that the edge node wishes."""

    def __init__(
        self,
        folder: Path,
        *,
        primary_host: str = "",
        may: Callable[[str], bool] = all_orders,
        interval_s: float = 1.0,
        pause: Callable[[], float] = no_pause,
        has_types: bool = False,
    ) -> None:
        self.folder = folder
        self.setup = NodeSetup(GROUP, NODE, primary_host, interval_s, has_types=has_types)
        self.may = may
        self.pause = pause
        self.clock, self.offset = 1000.0, 1_700_000_000.0 - 1000.0
        self.stream_offset = self.offset
        self.stream = 0.0
        self.host = Host(GROUP, NODE, has_types=has_types)
        self.told: list[str] = []
        #: name, reason and time of each order that the node refused
        self.refused: list[tuple[str, str, str]] = []
        self.orders: list[OrderWish] = []
        self.connection: ConnectionNeeds | None = None
        self.wills: list[Publish] = []
        self.sent: list[Publish] = []
        self.numbers: SessionFile | None = None
        self.plant: dict[str, Any] = copy.deepcopy(PLANT)
        self.values: dict[str, dict[str, Any]] = {"3": copy.deepcopy(HOIST), "8": copy.deepcopy(VALVES)}
        self.start()

    # --- the gateway ----------------------------------------------------------------------------------------------

    @property
    def wall(self) -> float:
        return self.clock + self.offset

    def start(self) -> None:
        """A new process: nothing but the folder is left of the one before."""
        if self.numbers is not None:
            self.numbers.close()  # a process that is killed loses its lock
        self.numbers = SessionFile(self.folder)
        self.tree = PlantTree()
        self.node = EdgeNode(
            self.setup,
            self.tree,
            NodeOptions(
                allowed=lambda: [one for one in self.tree.orders if self.may(one)],
                tell=self.told.append,
                refused=lambda *order: self.refused.append(order),
                clear_first=self.numbers.damaged,
                pause=self.pause,
            ),
        )

    def close(self) -> None:
        assert self.numbers is not None
        self.numbers.close()

    def take(self, changes: list[Change]) -> None:
        self.node.take([*changes, *self.clock_changes()], self.wall, self.clock)

    def clock_changes(self) -> list[ClockSet]:
        """As a gateway: the clock of the computer was set."""
        if self.stream_offset == self.offset or not self.tree.is_alive(None):
            return []
        self.stream_offset = self.offset
        return [ClockSet(self.wall - self.plant["started"] - self.stream)]

    def give_plant(self) -> None:
        self.take(self.tree.apply({"plant": copy.deepcopy(self.plant)}, self.clock))
        self.give_values()

    def give_values(self) -> None:
        """A whole snapshot."""
        slaves = {
            address: copy.deepcopy(one) for address, one in self.values.items() if address in self.plant["slaves"]
        }
        body = {
            "t": self.stream,
            "whole": True,
            "bus": {"stale": False, "mode": "operate", "in_ring": True},
            "slaves": slaves,
        }
        self.take(self.tree.apply({"snapshot": body}, self.clock))

    def wait(self, seconds: float, *, stream: bool = True) -> None:
        """Time passes; a snapshot comes where ``stream``."""
        self.clock += seconds
        self.stream += seconds
        if stream:
            self.give_values()
        else:
            self.take(self.tree.tick(self.clock))

    # --- the broker -----------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """The broker takes over: it publishes the will of an older connection with this client id first."""
        assert self.numbers is not None
        self.connection = self.node.connect(self.numbers.next(), self.wall)
        self.publish_wills()
        self.wills.append(self.connection.will)
        assert self.connection.will.qos == 1
        self.node.connected()

    def publish_wills(self) -> None:
        for will in self.wills:
            self.host.feed(will.topic, will.payload, qos=will.qos, retain=will.retain)
        self.wills.clear()

    def cut(self) -> None:
        """The network is gone; the broker will find out later."""
        self.connection = None
        self.node.disconnected()

    def kill(self) -> None:
        """SIGKILL of the gateway; its stream begins anew."""
        self.connection = None
        self.start()
        self.give_plant()

    def broker_dies(self) -> None:
        """SIGKILL of the broker: no wills, and the host knows nothing any more."""
        self.wills.clear()
        self.host.lose_broker()
        self.cut()

    def pump(self, most: int = 10_000) -> int:
        """Send messages until there are none; returns their number."""
        for count in range(most):
            if self.connection is None:
                return count
            message = self.node.next(self.wall, self.clock)
            if message is None:
                assert self.node.due(self.clock) > self.clock
                return count
            if isinstance(message, Disconnect):
                self.leave()
                return count
            self.send(message)
        return most

    def send(self, message: Publish) -> None:
        self.sent.append(message)
        self.host.feed(message.topic, message.payload, qos=message.qos, retain=message.retain)

    def leave(self) -> None:
        """With the reason code 0x04 the broker publishes the will, too."""
        self.connection = None
        self.publish_wills()
        self.node.disconnected()

    def join(self) -> int:
        """A connection begins, and what is due in it is sent: the births."""
        self.connect()
        return self.pump()

    def turn(self, seconds: float = 1.0) -> int:
        """Time passes, and what is due then is sent."""
        self.wait(seconds)
        return self.pump()

    def settle(self) -> None:
        """All that waits for its time is sent."""
        for _ in range(6):
            self.pump()
            if self.connection is None:
                self.connect()
            self.wait(1.0)
        self.pump()

    # --- the host -------------------------------------------------------------------------------------------------

    def state(self, *, online: bool, time_ms: int, host: str = "scada", retained: bool = False) -> None:
        text = f'{{"online": {str(online).lower()}, "timestamp": {time_ms}}}'
        if self.connection is not None:
            self.receive(f"spBv1.0/STATE/{host}", text.encode(), retained=retained)

    def command(
        self, device: str | None, metrics: list[bytes], *, age: float = 0.0, time: bool = True, retained: bool = False
    ) -> list[OrderWish]:
        """Send NCMD or DCMD with ``metrics`` (:func:`metric`); returns the orders that come of it."""
        payload = b"".join(tag(2, one) for one in metrics)
        if time:
            payload = tag(1, round((self.wall - age) * 1000)) + payload
        kind = "NCMD" if device is None else "DCMD"
        rest = "" if device is None else f"/{device}"
        return self.receive(f"spBv1.0/{GROUP}/{kind}/{NODE}{rest}", payload, retained=retained)

    def receive(self, topic: str, payload: bytes, *, retained: bool = False) -> list[OrderWish]:
        found = list(self.node.receive(topic, payload, self.wall, retained=retained))
        self.orders += found
        return found

    def rebirth(self) -> None:
        self.command(None, [metric("Node Control/Rebirth", boolean=True, datatype=11)])

    # --- the judgement --------------------------------------------------------------------------------------------

    def check(self) -> None:
        """The host shows what the tree holds."""
        host, tree = self.host, self.tree
        assert host.online == (self.node.phase is Phase.ONLINE)
        if not host.online:
            assert all(one.quality == 500 for one in host.node.values())
            return
        names = {address: one.name for address, one in tree.slaves.items()}
        assert host.alive == {names[one] for one in names if tree.is_alive(one)}
        for slave in (None, *(one for one in names if tree.is_alive(one))):
            device = None if slave is None else names[slave]
            for node, reading in tree.readings(slave):
                if node.path[0] == "Statistics":
                    continue  # they are given out every 10 s
                known = host.metric("/".join(node.path), device)
                assert known.quality == reading.quality.sparkplug, (node, reading, known)
                if isinstance(reading.value, float):
                    assert abs(known.value - reading.value) <= node.dead_band
                else:
                    assert known.value == reading.value

    def number_of(self, will: Publish) -> int:
        return int(read_payload(will.payload).metrics[0].value(4))


#: makes edge nodes (fixture ``new_rig`` of tests/bridge_mqtt)
NewRig = Callable[..., Rig]


def metric(
    name: str | None = None,
    *,
    alias: int | None = None,
    datatype: int | None = None,
    whole: int | None = None,
    long: int | None = None,
    double: float | None = None,
    boolean: bool | None = None,
    text: str | None = None,
    octets: bytes | None = None,
) -> bytes:
    """A metric of a command, as octets."""
    made = b"" if name is None else tag(1, name.encode())
    for number, value in ((2, alias), (4, datatype), (10, whole), (11, long), (13, double), (14, boolean)):
        made += b"" if value is None else tag(number, value)
    made += b"" if text is None else tag(15, text.encode())
    return made + (b"" if octets is None else tag(16, octets))
