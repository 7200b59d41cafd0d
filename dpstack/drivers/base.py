"""What every driver offers to the API: one machine kept running on one line inside an asyncio loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from dpstack.drivers.lateness import Lateness
from dpstack.trace import Event

#: Takes what a machine told, in order; called from the loop, never from another thread.
OnEvents = Callable[[list[Event]], None]
#: Told when the machine raised: a defect of ours, the driver has stopped.
OnFailure = Callable[[Exception], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class PortLost(Event):
    """The port vanished; the driver tries to open it again with back-off."""

    port: str
    reason: str

    @property
    def text(self) -> str:
        """What happens next."""
        return f"port {self.port} vanished ({self.reason}): trying to open it again"


@dataclass(frozen=True, slots=True, kw_only=True)
class PortBack(Event):
    """The port could be opened again."""

    port: str

    @property
    def text(self) -> str:
        """Which."""
        return f"port {self.port} is back"


class Runtime(Protocol):
    """A running driver. Constructed with its machine, its line and an :data:`OnEvents`."""

    lateness: Lateness

    @property
    def port_name(self) -> str:
        """What the port is called in messages and JSON."""

    @property
    def paced(self) -> bool:
        """True where octets take their time on a wire (or the virtual one), False on plain ptys and sockets."""

    def damage(self) -> dict[str, int]:
        """Octets that arrived damaged, by cause, as far as the port can tell."""

    async def open(self) -> None:
        """Open the line and begin. Raises PortError."""

    async def close(self) -> None:
        """Stop and release the line. The machine has been taken off the bus in order before."""

    def command(self, command: object) -> None:
        """Hand an order to the machine and let it act at once."""

    def now(self) -> int:
        """The machine's time in ns."""
