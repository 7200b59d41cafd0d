"""``PlantNode``: the part of a face of MQTT that decides what is sent, and what comes of a message.

:class:`~dpstack.bridge.mqtt.edge_node.EdgeNode` speaks Sparkplug B, :class:`~dpstack.bridge.mqtt.json_node.JsonNode`
plain JSON. The client owns the connection and the time; see ``edge_node`` for ``wall`` and ``clock``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import ClassVar, Protocol

from dpstack.bridge.mqtt.edge_node import Connection, Disconnect, NodeSetup, OrderWish, Publish
from dpstack.bridge.mqtt.history import History
from dpstack.bridge.tree import Change, PlantTree


class PlantNode(Protocol):
    """A plant on a broker, without network and clock. ``counts_sessions``: the number of a session is part of what it
    sends, so one that was lost must be told. ``lost_results``: results of orders that were too many to wait."""

    counts_sessions: ClassVar[bool]
    lost_results: int

    def __init__(
        self,
        setup: NodeSetup,
        tree: PlantTree,
        *,
        allowed: Callable[[], Collection[str]],
        tell: Callable[[str], object],
        clear_first: bool,
        history: History | None,
        pause: Callable[[], float],
    ) -> None: ...

    def connect(self, number: int, wall: float) -> Connection: ...

    def connected(self) -> None: ...

    def disconnected(self) -> None: ...

    def end(self, why: str) -> None: ...

    def take(self, changes: Sequence[Change], wall: float, clock: float) -> None: ...

    def next(self, wall: float, clock: float) -> Publish | Disconnect | None: ...

    def due(self, clock: float) -> float: ...

    def receive(self, topic: str, payload: bytes, wall: float, *, retained: bool = False) -> Sequence[OrderWish]: ...

    def answer(self, wish: OrderWish, result: str, reason: str, wall: float) -> None: ...
