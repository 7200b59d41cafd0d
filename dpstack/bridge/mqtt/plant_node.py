"""``PlantNode``: the part of a connector of MQTT that decides what is sent, and what comes of a message.

:class:`~dpstack.bridge.mqtt.edge_node.EdgeNode` speaks Sparkplug B, :class:`~dpstack.bridge.mqtt.json_node.JsonNode`
plain JSON. The caller owns the connection, the time and the tree:

- it connects with :meth:`PlantNode.connect`, says :meth:`~PlantNode.connected` when the broker has taken connection and
  subscriptions, and :meth:`~PlantNode.disconnected` when the connection is gone
- it hands in changes of the tree (:meth:`~PlantNode.take`) and messages (:meth:`~PlantNode.receive`)
- it asks for the next message whenever it can send one (:meth:`~PlantNode.next`)

``wall``: s since 1970 by the clock of the computer, which may jump; ``clock``: s since the start of the computer, by a
clock that nobody sets.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import ClassVar, Final, NamedTuple

from dpstack.bridge.mqtt.history import History
from dpstack.bridge.names import MQTT_NAME, SPARKPLUG_ID, NameRule, unique_names
from dpstack.errors import ConfigError
from dpstack.plant.nodes import OfferedOrder
from dpstack.plant.quality import Value
from dpstack.plant.tree import Change, PlantTree
from dpstack.text import printable, shortened

#: the first level of all topics of Sparkplug B
SPARKPLUG: Final = "spBv1.0"


class Publish(NamedTuple):
    """A message for the broker. ``expiry_s``: s after which the broker forgets it; 0: never. ``session``: of a will
    whose payload does not have it, the number of its session, as a user property."""

    topic: str
    payload: bytes
    qos: int = 0
    retain: bool = False
    expiry_s: int = 0
    session: int | None = None


class Disconnect(NamedTuple):
    """End the connection now; in MQTT 5 with the reason code "Disconnect with Will Message" (0x04)."""

    why: str


class Unsubscribe(NamedTuple):
    """Leave a subscription of :class:`ConnectionNeeds`."""

    topic: str


class ConnectionNeeds(NamedTuple):
    """The needs of a connection. Clean Start is set, and the Session Expiry Interval is 0. ``subscriptions``: topics,
    each with QoS 1; ``most_kept``: messages that the broker may have kept for them."""

    client_id: str
    will: Publish
    subscriptions: tuple[str, ...]
    most_kept: int = 0


class OrderWish(NamedTuple):
    """An order for the run. ``made_at``: by the clock of its sender, in s since 1970; ``order_time``: as it wrote it,
    if that is a text."""

    name: str
    value: Value
    made_at: float
    order_time: str = ""


@dataclass(frozen=True, slots=True)
class NodeSetup:
    """A plant on a broker as it is configured. ``primary_host``: births wait for it; empty: none. ``interval_s``:
    the values of a slave are published no more often. ``has_types``: data of Sparkplug have the types of the births.
    ``discovery_prefix``: of the discovery messages of Home Assistant; empty: none are sent.

    Raises ConfigError for a name that Sparkplug does not permit.
    """

    group: str
    node: str
    primary_host: str = ""
    interval_s: float = 1.0
    has_types: bool = False
    discovery_prefix: str = ""

    def __post_init__(self) -> None:
        for key in ("group", "node", "primary_host"):
            name = getattr(self, key)
            valid = SPARKPLUG_ID.valid(name)
            if name != valid and (name or key != "primary_host"):
                raise ConfigError(
                    f"{key} {shortened(printable(name))!r}: MQTT does not permit this name; take {valid!r}"
                )
        prefix = self.discovery_prefix
        valid = "/".join(MQTT_NAME.valid(level) for level in prefix.split("/")) if prefix else ""
        if prefix != valid:
            raise ConfigError(
                f"discovery_prefix {shortened(printable(prefix))!r}: MQTT does not permit this topic; take {valid!r}"
            )

    @property
    def client_id(self) -> str:
        # neither name has a slash: so two different nodes never have the same id
        return f"{self.group}/{self.node}"

    def topic(self, kind: str, device: str | None = None) -> str:
        """The topic of a message of ``kind``, for instance ``NBIRTH``."""
        return "/".join((SPARKPLUG, self.group, kind, self.node, *(() if device is None else (device,))))

    @property
    def state_topic(self) -> str:
        """The topic on which the primary host says whether it is online."""
        return f"{SPARKPLUG}/STATE/{self.primary_host}"


class Phase(Enum):
    """Phases of a node."""

    OFFLINE = auto()
    #: the connection is being made
    CONNECTING = auto()
    #: the primary host is not online
    WAITING = auto()
    ONLINE = auto()
    #: the last messages, of which Sparkplug has NDEATH, then the end of the connection
    LEAVING = auto()


def no_pause() -> float:
    return 0.0


@dataclass(frozen=True, slots=True)
class NodeOptions:
    """``allowed``: the names of the orders that may be given by MQTT. ``tell``: takes a remark for people. ``refused``:
    takes name, reason, and time by its sender of an order that :meth:`PlantNode.receive` refuses.
    ``clear_first``: the number of the last session is not known. So one session without births comes before the
    others: the broker has published the old will when the first births come. ``history``: keeps values that could not
    be delivered; None: they are lost. ``pause``: draws the s between "online" of the primary host, which all gateways
    get at the same moment, and the births."""

    allowed: Callable[[], Collection[str]] = tuple
    tell: Callable[[str], object] = lambda _: None
    refused: Callable[[str, str, str], object] = lambda _name, _reason, _time: None
    clear_first: bool = False
    history: History | None = None
    pause: Callable[[], float] = no_pause


class PlantNode(ABC):
    """A plant on a broker, without network and clock. ``counts_sessions``: the number of a session is part of what it
    sends, so a lost one must be reported. ``lost_results``: number of the results of orders that were dropped, as
    too many waited."""

    counts_sessions: ClassVar[bool]

    def __init__(self, setup: NodeSetup, tree: PlantTree, options: NodeOptions) -> None:
        self.phase = Phase.OFFLINE
        self.lost_results = 0
        self._setup = setup
        self._tree = tree
        self._allowed = options.allowed
        self._tell = options.tell
        self._refused = options.refused
        self._leaving = ""
        #: the clock of the computer less that of the stream, in s
        self._offset = 0.0

    @abstractmethod
    def connect(self, number: int, wall: float) -> ConnectionNeeds:
        """Begin the session ``number``, which is on disk already (:mod:`dpstack.bridge.mqtt.session_file`)."""

    @abstractmethod
    def connected(self) -> None:
        """The broker has taken connection and subscriptions."""

    @abstractmethod
    def disconnected(self) -> None:
        """The connection is gone, or was not made."""

    @abstractmethod
    def end(self, why: str) -> None:
        """An ordered end: the last messages and the end of the connection come next."""

    @abstractmethod
    def take(self, changes: Sequence[Change], wall: float, clock: float) -> None:
        """Take changes of the tree."""

    @abstractmethod
    def next(self, wall: float, clock: float) -> Publish | Unsubscribe | Disconnect | None:
        """The next message, subscription to leave, or the end of the connection; None: nothing is to be sent now."""

    @abstractmethod
    def due(self, clock: float) -> float:
        """The time by ``clock`` at which :meth:`next` has a message, if nothing happens before; infinite: none."""

    @abstractmethod
    def receive(self, topic: str, payload: bytes, wall: float, *, retained: bool = False) -> Sequence[OrderWish]:
        """Take a message of the broker; nothing that it may hold raises. Returns orders for the run, whose results
        :meth:`answer` takes."""

    @abstractmethod
    def answer(self, wish: OrderWish, result: str, reason: str, wall: float) -> None:
        """The result of an order of :meth:`receive`: ``done``, or ``refused`` with the reason."""

    def _slave_names(self, rule: NameRule) -> dict[int, str]:
        """The names of all slaves by ``rule``; those that had to be changed are reported."""
        found = unique_names(rule, [(f"slave {address}", one.name) for address, one in self._tree.slaves.items()])
        for text in found.changed:
            self._tell(text)
        return {address: found.names[f"slave {address}"] for address in self._tree.slaves}

    def _allowed_orders(self) -> dict[str, OfferedOrder]:
        """The orders of the tree that may be given by MQTT."""
        return {name: self._tree.orders[name] for name in self._allowed() if name in self._tree.orders}
