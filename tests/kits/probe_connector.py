"""A connector for tests: keeps what it gets, and fails when and as its table says. :func:`register` makes it known to
the readers of configurations."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

from dpstack.api.config.connectors import CONNECTORS, ConnectorConfig, read_names
from dpstack.api.connectors.kinds import KINDS, ConnectorKind, Parts
from dpstack.bridge.connector import Connector
from dpstack.bridge.orders import Orders
from dpstack.errors import PortError
from dpstack.plant.tree import Born, Change, Changed, Died
from dpstack.toml.table import Key
from dpstack.trace import Severity

#: s for which the failures "thread" and "loop" last, which nobody can end
HANG_S: Final = 8.0
#: the order of the failures "fault", "blocks" and "old", which come when the file ``go`` is there
ORDERED: Final = ("valves.target", 0x1122)
#: of the failure "old": another value, made so many s ago
OLD: Final = ("valves.target", 0x3344)
OLD_S: Final = 10.0


class ProbeConfig(ConnectorConfig, frozen=True, kw_only=True):
    fails: str = ""
    log: str = ""
    go: str = ""
    port: Annotated[int, Key(0, 65535)] = 0
    allow_commands: Annotated[tuple[str, ...], Key(read=read_names)] = ()


class ProbeConnector(Connector):
    name: ClassVar[str] = "probe"
    made: ClassVar[list[ProbeConnector]] = []

    def __init__(self, config: ProbeConfig, parts: Parts) -> None:
        super().__init__(parts.tree, parts.tell)
        self.orders: Orders = parts.orders(config.allow_commands, 2.0)
        self.config = config
        self.changes: list[Change] = []
        self.course: list[str] = []
        #: fail at the next changes
        self.breaks = False
        self.listening: socket.socket | None = None
        self.is_built = config.fails != "build"
        ProbeConnector.made.append(self)

    async def open(self) -> None:
        self.course.append("open")
        if self.config.port:
            self.listening = socket.socket()
            try:
                self.listening.bind(("127.0.0.1", self.config.port))
            except OSError as error:
                raise PortError(f"[probe] port {self.config.port}: {error.strerror}; give another one") from None
            self.tell(f"on port {self.config.port}", Severity.INFO)

    def take(self, changes: Sequence[Change]) -> None:
        self.changes += changes
        for one in changes:
            if isinstance(one, Born):
                self.tell(f"born {one.slave}", Severity.INFO)
        if self.breaks or (self.config.fails == "take" and self.lives):
            raise ZeroDivisionError("take")

    async def serve(self) -> None:
        self.course.append("serve")
        if self.config.fails == "build":
            print("builds", flush=True)
        if self.config.go:
            await self._order()
        if self.config.fails == "serve":
            await asyncio.sleep(0.4)
            raise ZeroDivisionError("serve")
        try:
            await asyncio.Event().wait()
        finally:
            self.course.append("last: " + ", ".join(f"{type(one).__name__} {one.slave}" for one in self.lives[-2:]))
            if self.config.fails == "end":
                await asyncio.Event().wait()
            if self.config.fails == "thread":
                await asyncio.to_thread(time.sleep, HANG_S)
            if self.config.fails == "loop":
                time.sleep(HANG_S)  # noqa: ASYNC251  the failure

    async def _order(self) -> None:
        """Give an order, and fail once somebody has made the file ``go``."""
        while Born(4) not in self.lives:  # noqa: ASYNC110  the tree tells nobody
            await asyncio.sleep(0.05)
        if self.config.fails != "old":
            result = await self.orders.give(*ORDERED, made_at=None)
            assert result.result == "done", result
        print("ordered", flush=True)
        while not Path(self.config.go).exists():  # noqa: ASYNC110  another program makes it
            await asyncio.sleep(0.05)
        if self.config.fails == "fault":
            raise ZeroDivisionError("serve")
        if self.config.fails == "blocks":
            time.sleep(10 * HANG_S)  # noqa: ASYNC251  the failure
        if self.config.fails == "old":
            await self.orders.give(*OLD, made_at=time.time() - OLD_S)

    def close(self) -> None:
        self.course.append("close")
        if self.listening is not None:
            self.listening.close()
        if self.config.log:
            Path(self.config.log).write_text("\n".join(self.course), encoding="utf-8")
        if self.config.fails == "close":
            raise ZeroDivisionError("close")

    @property
    def lives(self) -> list[Born | Died]:
        return [one for one in self.changes if isinstance(one, (Born, Died))]

    def values(self, id_: str) -> list[Any]:
        return [one.reading.value for one in self.changes if isinstance(one, Changed) and one.node.id == id_]


def register() -> None:
    CONNECTORS["probe"] = ProbeConfig
    KINDS["probe"] = ConnectorKind("probe_connector", (), ProbeConnector)


def forget() -> None:
    CONNECTORS.pop("probe", None)
    KINDS.pop("probe", None)
    ProbeConnector.made.clear()
