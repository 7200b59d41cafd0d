"""What every driver offers to the API: one machine kept running on one line inside an asyncio loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

from dpstack.drivers.lateness import Lateness
from dpstack.params import BusParams
from dpstack.trace import Event
from dpstack.units import BITS_PER_CHAR, NS_PER_S

#: the ordered end takes a few rotations; nobody waits longer than this for each of its steps (plus ten rotations)
END_LIMIT: Final = 2 * NS_PER_S
#: Global_Control, the longest telegram of the end
_LAST_OCTETS: Final = 13

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


def last_bits_ns(params: BusParams) -> int:
    """How long to wait after the event that ends the ordered end, before the port is closed: events tell of
    transmissions whose last bit lies ahead."""
    return params.ns(_LAST_OCTETS * BITS_PER_CHAR + params.t_id2)


class Runtime(Protocol):
    """A running driver. Constructed with its machine, its line and an :data:`OnEvents`."""

    @property
    def lateness(self) -> Lateness:
        """How late answers arrive."""

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
        """Stop and release the line. The machine has been taken off the bus in order before.

        It goes through any number of cancellations, and re-raises the cancellation.
        """

    @property
    def close_limit_ns(self) -> int:
        """What :meth:`close`, and orders that nobody answers, may add to the time of an ordered end (ns)."""

    def end_without_loop(self) -> str:
        """Make the end of a bus whose event loop can run no more; why safe values and Clear could not be sent, empty
        where they were. The line is released."""

    def forsake(self) -> None:
        """In the child of a fork: let go of everything that the parent uses too, and change nothing at it."""

    def command(self, command: object) -> None:
        """Hand an order to the machine and let it act at once."""

    def now(self) -> int:
        """The machine's time in ns."""
