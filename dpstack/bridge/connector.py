"""``Connector``: one way to publish the tree of a plant, such as MQTT, OPC UA or metrics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import ClassVar, NamedTuple

from dpstack.plant.tree import Change, PlantTree
from dpstack.text import printable, shortened
from dpstack.trace import Severity

#: takes a remark for the operator of the run
Tell = Callable[[str, Severity], object]


class ConnectorState(NamedTuple):
    """``serves``: it has not ended by a fault. See :class:`Connector` for ``dropped`` and ``connected``."""

    name: str
    serves: bool
    dropped: int = 0
    connected: bool | None = None


class Connector(ABC):
    """Made before the bus is opened; a :class:`~dpstack.bridge.gateway.Gateway` feeds it.

    ``tree`` is read in :meth:`take` and :meth:`serve`; the gateway, :meth:`acknowledge` and :meth:`comment` change it.
    ``tell``: for remarks, each one line; the caller leaves out one that repeats the last one. The constructor touches
    neither network nor disk.
    """

    #: name of its table of the configuration and of its extra: "mqtt", "opcua", "metrics"
    name: ClassVar[str]
    #: changes, values and messages that it dropped, as there was no room or nobody took them in time
    dropped: int = 0
    #: whether it is connected to its broker; None: it has none, clients come to it
    connected: bool | None = None
    #: whether it has made all that it makes of the nodes of the tree. The bus opens its port behind that: a connector
    #: that makes many would hold up the bus, and its safe end
    is_built: bool = True

    def __init__(self, tree: PlantTree, tell: Tell) -> None:
        self.tree = tree
        self.tell = tell
        #: gives changes to all connectors that serve, this one too; a gateway puts its own here
        self.spread: Callable[[Sequence[Change]], None] = self.take

    def acknowledge(self, id_: str, by: str = "", comment: str | None = None) -> bool:
        """Acknowledge a condition of the tree in the name of ``by``; all connectors get the change. False if it is
        not there, or acknowledged already. ``comment`` None leaves the one that it has."""
        return self._spread(self.tree.acknowledge(id_, by, comment))

    def comment(self, id_: str, by: str, comment: str) -> bool:
        """Give a condition of the tree another comment; all connectors get the change. False if it is not there."""
        return self._spread(self.tree.comment(id_, by, comment))

    def _spread(self, changes: Sequence[Change]) -> bool:
        if changes:
            self.spread(changes)
        return bool(changes)

    async def open(self) -> None:  # noqa: B027  a connector that only connects to others needs none
        """Take the resources of this computer: a listening socket, a directory. Called once, before the bus is opened.

        Raises DpError in one line, for instance if the port is taken or a file cannot be read; then nothing goes
        on the bus. It must release what it has taken in :meth:`close`.
        """

    @abstractmethod
    def take(self, changes: Sequence[Change]) -> None:
        """Take changes of the tree. Never waits; its memory is bounded, and what it drops it counts and reports.

        It runs in the loop that may also drive a bus: it keeps what it needs and leaves the work to :meth:`serve`.
        """

    @abstractmethod
    async def serve(self) -> None:
        """Serve until cancelled. The loss of a broker or client is reported once, and it is tried again.

        The cancellation is the end of the run, behind the last :meth:`take`: what is still to be sent then (the death
        of the bus, a farewell) may take :data:`~dpstack.bridge.gateway.END_S` in all. Raises DpError for a
        configuration that cannot work.
        """

    def close(self) -> None:  # noqa: B027  a connector that only connects to others needs none
        """Release everything at once, without waiting. Called once at the end, also if :meth:`open` failed."""


class RemarkReporter:
    """Passes remarks on with the name of their connector in front; one that is the same as the last one is left out."""

    def __init__(self, name: str, tell: Tell) -> None:
        self._name = name
        self._tell = tell
        self._last = ""

    def __call__(self, text: str, severity: Severity) -> None:
        line = f"{self._name}: {shortened(printable(text), 300)}"
        if line != self._last:
            self._last = line
            self._tell(line, severity)


def product_version() -> str:
    """The version of dpstack; empty if it is not installed."""
    try:
        return version("dpstack")
    except PackageNotFoundError:
        return ""
