"""The interface of all drivers to the API (one machine, kept running on one line), and their events."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final, Protocol

from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveEvent
from dpstack.drivers.tap import Tap
from dpstack.errors import DpError
from dpstack.params import BusParams
from dpstack.trace import Event, Severity
from dpstack.units import BITS_PER_CHAR, NS_PER_S, ms_text, ns_to_s

if TYPE_CHECKING:
    import asyncio

#: Time limit of each step of the ordered end, plus ten rotations; it takes a few rotations.
END_LIMIT: Final = 2 * NS_PER_S
#: Global_Control, the longest telegram of the end
_LAST_OCTETS: Final = 13

#: Why nobody keeps a machine running in the child of a fork, for people.
IN_PARENT: Final = "the bus runs in the process from which this one was forked"

#: The driver calls it with the events of a machine, in order; from the loop, never from another thread.
OnEvents = Callable[[list[Event]], None]
#: Called with the exception of the machine: a defect of dpstack, the driver has stopped.
OnFailure = Callable[[Exception], None]
#: Called with an order that nobody awaits and that a machine in another process refused or dropped, and the error.
OnRefused = Callable[[object, DpError], None]


class PortLost(Event):
    """The port vanished; the driver tries to open it again with back-off."""

    SEVERITY = Severity.ERROR

    #: name of the port
    port: str
    #: error of the operating system
    reason: str

    TEMPLATE = "port {e.port} vanished ({e.reason}): trying to open it again"


class PortBack(Event):
    """The port could be opened again."""

    #: name of the port
    port: str

    TEMPLATE = "port {e.port} is back"


class PortDisturbed(Event):
    """Another program disturbs the port: it has changed its settings, or has it open, too. The driver looks for that
    when slaves fall silent."""

    SEVERITY = Severity.WARNING

    #: name of the port
    port: str
    #: what the other program did, and what to do
    what: str

    TEMPLATE = "{e.port}: {e.what}"


class BusProcessSilent(Event):
    """The bus process shows no sign of life. Its slaves count as offline, their inputs as not valid."""

    SEVERITY = Severity.ERROR

    #: process id of the bus process
    pid: int
    #: time without a sign of life, in ns
    silent_ns: int
    #: what the slaves do meanwhile, by their watchdogs, for people
    at_slaves: str

    def _text(self) -> str:
        return (
            f"the bus process (pid {self.pid}) has shown no sign of life for {ms_text(self.silent_ns)}: it is stopped, "
            f"or hangs. Orders and outputs are dropped until it goes on. {self.at_slaves}"
        )


class BusProcessBack(Event):
    """The bus process goes on."""

    #: process id of the bus process
    pid: int
    #: time that it was silent, in ns
    silent_ns: int

    def _text(self) -> str:
        return f"the bus process (pid {self.pid}) goes on after {ms_text(self.silent_ns)}"


class OutputsDropped(SlaveEvent):
    """The bus process did not take ``outputs`` of the application in time. They will not go out."""

    SEVERITY = Severity.ERROR

    #: octets that will not go out
    outputs: bytes

    def _text(self) -> str:
        return (
            f"{self.who}: outputs {self.outputs.hex()} were dropped: the bus process did not "
            "take them in time; its outputs are those from before"
        )


class BehindRealTime(Event):
    """The time of a simulated bus falls behind real time, how fast it goes has changed much, or it keeps up again.

    ``bus_ns`` of bus time went by in the last ``real_ns``; ``behind_ns`` is how far it is behind in all.
    """

    #: bus time that went by in the last ``real_ns``, in ns
    bus_ns: int
    #: real time over which it was measured, in ns
    real_ns: int
    #: lag of the bus behind real time, in ns
    behind_ns: int
    #: the bus keeps up with real time again
    keeps_up: bool

    @property
    def severity(self) -> Severity:
        """INFO when the bus keeps up again, else WARNING."""
        return Severity.INFO if self.keeps_up else Severity.WARNING

    def _text(self) -> str:
        if self.keeps_up:
            return f"the simulated bus keeps up with real time again, {ns_to_s(self.behind_ns):.1f} s behind in all"
        return (
            f"the simulated bus falls behind real time: {ns_to_s(self.bus_ns):.2f} s of bus time in the last "
            f"{ns_to_s(self.real_ns):.2f} s; the computer is too slow for it, or the program blocks its event loop: "
            f"take a lower baud rate, or fewer slaves"
        )


#: Memory (octets) that an open bus keeps for its end if the program has used up all other: more than one arena of
#: Python's allocator. It is never written, so it only takes addresses.
RESERVE: Final = 2 * 1024 * 1024


def stopped_by(error: BaseException) -> str:
    """The cause for people, after the machine raised ``error`` and the bus stopped."""
    if isinstance(error, MemoryError):
        return "a lack of memory in its process (MemoryError); find what fills it, or raise its limit"
    return f"a defect in dpstack ({type(error).__name__}: {error}); please report it"


def last_bits_ns(params: BusParams) -> int:
    """Wait in ns between the last event of the ordered end and the closing of the port: the machine reports a
    transmission before its last bit is on the wire."""
    return params.ns(_LAST_OCTETS * BITS_PER_CHAR + params.t_id2)


class Runtime(Protocol):
    """A running driver. Constructed with its machine, its line and an :data:`OnEvents`."""

    @property
    def port_name(self) -> str:
        """Name of the port in messages and JSON."""

    @property
    def pid(self) -> int | None:
        """The process id of the bus process; None without one, and before it runs."""

    @property
    def paced(self) -> bool:
        """True if octets take their time on a wire (or the virtual one), False on plain ptys and sockets."""

    @property
    def not_running(self) -> str | None:
        """Why the driver does not run the machine now; None while it runs it, before the opening, and after an ordered
        end."""

    @property
    def behind_ns(self) -> int:
        """How far the time of a simulated bus has fallen behind real time since the opening (ns), else 0."""

    @property
    def cleared(self) -> bool:
        """The driver itself has sent Clear, because its machine failed."""

    @property
    def mode_before_silence(self) -> Mode | None:
        """The master's mode before its bus process fell silent; None while it is not silent."""

    async def open(self) -> None:
        """Open the line and begin. Raises PortError."""

    async def close(self) -> None:
        """Stop and release the line. The caller has carried out the ordered end before.

        Cancellations do not stop it; it re-raises the cancellation at its end.
        """

    @property
    def close_limit_ns(self) -> int:
        """Longest time in ns that :meth:`close` and orders without an answer add to an ordered end."""

    def end_without_loop(self) -> str:
        """End a bus whose event loop can no longer run, and release the line.

        Returns why safe values and Clear could not be sent; empty after success.
        """

    def release_after_fork(self) -> None:
        """In the child of a fork: release its copies of line, timers and sockets without effect on the parent."""

    def command(self, command: object) -> None:
        """Hand an order to the machine. If a machine in another process refuses it, the driver calls
        :data:`OnRefused` later."""

    def order(self, command: object) -> asyncio.Future[object]:
        """As :meth:`command`; the future is done when the machine has carried out the order, or holds its exception."""

    async def hand_over_outputs(self) -> None:
        """Return when the machine has all outputs that the application has set. Raises OrderDropped, BusError."""

    def now(self) -> int:
        """The machine's time in ns."""

    def tap(self, tap: Tap | None) -> None:
        """Copy all octets received and sent into ``tap`` from now on; None ends it. Never delays the machine."""
