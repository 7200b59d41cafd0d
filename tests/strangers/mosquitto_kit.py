"""The broker mosquitto as a program of its own, a subscriber that is judged by the specification, and a plant on it."""

from __future__ import annotations

import asyncio
import copy
import os
import signal
import socket
import subprocess
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

from edge_node_rig import GROUP, NODE
from far_ends import eventually, free_port, until
from plant_files import plant_file
from plant_items import HOIST, PLANT, VALVES
from sparkplug_host import Host

from dpstack.bridge.connector import Tell
from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.client import MqttConnector
from dpstack.bridge.mqtt.edge_node import EdgeNode
from dpstack.bridge.mqtt.plant_node import NodeSetup, PlantNode
from dpstack.bridge.orders import Orders
from dpstack.plant.orders import DriveOrder, SetOutputs
from dpstack.plant.tree import PlantTree
from dpstack.trace import Severity

LONGEST_S = 30.0


class Mosquitto:
    """A broker on a free port. ``lines``: of its configuration, besides the listener."""

    def __init__(self, folder: Path, *lines: str, anonymous: bool = True) -> None:
        self.folder = folder
        self.port = free_port()
        config = [
            f"listener {self.port} 127.0.0.1",
            f"allow_anonymous {str(anonymous).lower()}",
            "log_type all",
            *lines,
        ]
        if os.geteuid() == 0:
            config.append("user root")  # else it becomes a user who may not read the folder
        (folder / "mosquitto.conf").write_text("\n".join(config) + "\n")
        self.log = folder / "mosquitto.log"
        self.program: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        with self.log.open("ab") as log:
            self.program = subprocess.Popen(
                ["mosquitto", "-c", str(self.folder / "mosquitto.conf")], stdout=log, stderr=log, cwd=self.folder
            )
        eventually(self.listens, "the broker listens")

    def listens(self) -> bool:
        with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            return True
        assert self.program is not None
        assert self.program.poll() is None, self.log.read_text()
        return False

    def subscriptions(self) -> int:
        """Those that it has confirmed since its start."""
        return self.log.read_text(errors="replace").count("Sending SUBACK")

    def kill(self, number: int = signal.SIGKILL) -> None:
        assert self.program is not None
        self.program.send_signal(number)
        if number in (signal.SIGKILL, signal.SIGTERM):
            self.program.wait(LONGEST_S)

    def clients(self, program: str, *options: str) -> list[str]:
        return [program, "-h", "127.0.0.1", "-p", str(self.port), "-V", "5", *options]


def valves_file(folder: Path, broker: Mosquitto, **keys: object) -> str:
    """A configuration for ``dpstack run`` with valves at ``broker``. ``keys``: more of [mqtt]."""
    names = {"inputs": {"level": "i16@0"}, "outputs": {"lamp": "bool@0.1", "speed": "u8@1"}}
    valves = {"name": "valves", "address": 8, "ident": 0x1234, "config": "21 11", **names}
    mqtt = {"url": f"mqtt://127.0.0.1:{broker.port}", "group": GROUP, "node": NODE, "interval_ms": 50, **keys}
    return str(plant_file(folder, valves, tables={"mqtt": mqtt}))


class Subscriber:
    """mosquitto_sub with a host behind it. ``retained``: flags of what came."""

    def __init__(self, broker: Mosquitto, *options: str) -> None:
        self.host = Host(GROUP, NODE)
        self.flags: set[str] = set()
        self.broken: BaseException | None = None
        self.program = subprocess.Popen(
            broker.clients("mosquitto_sub", "-t", f"spBv1.0/{GROUP}/#", "-q", "1", "-F", "%r %q %x %t", *options),
            stdout=subprocess.PIPE,
            text=True,
        )

    async def follow(self) -> None:
        assert self.program.stdout is not None
        while line := await asyncio.to_thread(self.program.stdout.readline):
            retained, qos, octets, topic = line.rstrip("\n").split(" ", 3)
            self.flags.add(retained)
            if topic.split("/")[2] in ("NCMD", "DCMD"):
                continue
            try:
                self.host.feed(topic, bytes.fromhex(octets), qos=int(qos) if "DEATH" in topic else 0)
            except BaseException as error:
                self.broken = error
                raise

    def kinds(self) -> list[str]:
        return [kind for kind, _, _ in self.host.messages]

    def end(self) -> None:
        self.program.kill()
        self.program.wait()
        assert self.program.stdout is not None
        self.program.stdout.close()


class Plant:
    """A tree with two slaves, fed by the test, and a connector on it."""

    def __init__(
        self,
        folder: Path,
        broker: Broker,
        *,
        primary_host: str = "",
        orders: bool = True,
        store_mb: int = 0,
        setup: NodeSetup | None = None,
        make_node: type[PlantNode] = EdgeNode,
    ) -> None:
        self.told: list[str] = []
        self.values: dict[str, Any] = {"3": copy.deepcopy(HOIST), "8": copy.deepcopy(VALVES)}
        self.plant: dict[str, Any] = copy.deepcopy(PLANT) | {"started": time.time()}  # tests change it
        self.tree = PlantTree()
        self.carried_out: list[SetOutputs | DriveOrder] = []
        tell: Tell = self.tell
        self.connector = MqttConnector(
            self.tree,
            tell,
            broker=broker,
            setup=setup or NodeSetup(GROUP, NODE, primary_host, interval_s=0.05),
            make_node=make_node,
            folder=folder / "state",
            orders=Orders(self.tree, self.carry_out, ["valves.lamp", "valves.speed"]) if orders else None,
            store_mb=store_mb,
            again_s=0.1,
        )
        self.began = time.monotonic()

    def tell(self, text: str, severity: Severity) -> None:
        self.told.append(text)

    async def carry_out(self, order: SetOutputs | DriveOrder) -> None:
        self.carried_out.append(order)
        if order == SetOutputs(8, {"lamp": True}):
            self.values["8"]["fields"]["lamp"] = True

    async def feed(self) -> None:
        self.connector.take(self.tree.apply({"plant": self.plant}, time.monotonic()))
        while True:
            now = time.monotonic()
            body = {
                "t": now - self.began,
                "whole": True,
                "bus": {"stale": False, "mode": "operate"},
                "slaves": copy.deepcopy(self.values),
            }
            self.connector.take(self.tree.apply({"snapshot": body}, now))
            await asyncio.sleep(0.05)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        await self.connector.open()
        tasks = [asyncio.create_task(self.feed()), asyncio.create_task(self.connector.serve())]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            ends = await asyncio.gather(*tasks, return_exceptions=True)
            self.connector.close()
            assert [type(one) for one in ends] == [asyncio.CancelledError] * 2, ends

    async def until(self, found: Callable[[], object]) -> None:
        await until(found, lambda: self.told)


@asynccontextmanager
async def following(broker: Mosquitto, *options: str) -> AsyncIterator[Subscriber]:
    """Enter it before the plant is published: births are not retained."""
    before = broker.subscriptions()
    subscriber = Subscriber(broker, *options)
    task = asyncio.create_task(subscriber.follow())
    await asyncio.to_thread(eventually, lambda: broker.subscriptions() > before, "a subscription")
    try:
        yield subscriber
    finally:
        subscriber.end()
        await asyncio.gather(task, return_exceptions=True)
        assert subscriber.broken is None, subscriber.broken


def plain(broker: Mosquitto) -> Broker:
    return Broker(url=f"mqtt://127.0.0.1:{broker.port}", keepalive_s=2)


async def run(command: list[str]) -> None:
    await asyncio.to_thread(subprocess.run, command, check=True, timeout=LONGEST_S, capture_output=True)
