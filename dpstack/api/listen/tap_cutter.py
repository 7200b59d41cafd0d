"""The entries of a tap, cut into transmissions with their times since 1970."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic_ns
from typing import Final

from dpstack.capture.cutter import Cutter
from dpstack.capture.listener import OnTransmission
from dpstack.capture.transmission import Transmission
from dpstack.drivers.runtime import PortBack, PortLost
from dpstack.errors import PortError
from dpstack.trace import Event
from dpstack.units import BAUD_RATES, NS_PER_MS

#: a telegram from a tap comes in pieces only while it is on the line
_STALL_NS: Final = 50 * NS_PER_MS


class OctetsLost(Event):
    """The program that holds the port, or this computer, lost ``count`` chunks of octets: there is a gap here."""

    count: int
    port: str

    TEMPLATE = (
        "{e.port}: {e.count} chunks of octets were lost: this computer cannot keep up; the transmissions have a gap"
    )


class TapCutter:
    """Cuts the entries of the tap on ``port``.

    ``on_transmission`` gets each transmission, ``on_event`` :class:`OctetsLost`, PortLost and PortBack.
    """

    def __init__(self, port: str, on_transmission: OnTransmission, on_event: Callable[[Event], None]) -> None:
        #: rate of the last entry in bit/s, 0 before the first
        self.baud = 0
        #: the kind of program that holds the port; empty before :meth:`begin`
        self.program = ""
        self._port = port
        self._on_transmission = on_transmission
        self._on_event = on_event
        self._epoch_ns = 0
        self._cutter: Cutter | None = None

    def begin(self, epoch_ns: int, program: str) -> None:
        """``epoch_ns`` plus the time of a later entry is the time since 1970. ``program``: the kind that holds the
        port."""
        self.give_up()
        self._cutter = None
        self._epoch_ns = epoch_ns
        self.program = program

    def lose(self, count: int) -> None:
        """``count`` entries (0: none) are missing here."""
        if count:
            self.give_up()
            self._on_event(OctetsLost(t_ns=monotonic_ns(), count=count, port=self._port))

    def add(self, end_ns: int, baud: int, octets: bytes, sent: bool) -> None:
        """An entry as :data:`dpstack.drivers.tap.Tapped` has it. Raises PortError for a rate that PROFIBUS does not
        have."""
        if not octets:
            self._port_changed(there=bool(baud))
            return
        cutter = self._cutter
        if cutter is None or cutter.baud != baud:
            cutter = self._new_cutter(baud)
        elif sent:  # a telegram of the program's own begins; after a silence the cutter gives up by itself
            self._deliver(cutter.give_up())
        self._deliver(cutter.feed(octets, end_ns))

    def give_up(self) -> None:
        """The octets held wait for nothing more."""
        if self._cutter is not None:
            self._deliver(self._cutter.give_up())

    def _new_cutter(self, baud: int) -> Cutter:
        if baud not in BAUD_RATES:
            raise PortError(f"{self._port}: its tap speaks of {baud} bit/s, which is no PROFIBUS rate: is it dpstack?")
        self.give_up()
        self.baud = baud
        cutter = self._cutter = Cutter(baud, _STALL_NS, self._epoch_ns)
        return cutter

    def _port_changed(self, *, there: bool) -> None:
        self.give_up()
        now = monotonic_ns()
        if there:
            self._on_event(PortBack(t_ns=now, port=self._port))
        else:
            self._on_event(PortLost(t_ns=now, port=self._port, reason=f"for the {self.program} that holds it"))

    def _deliver(self, transmissions: list[Transmission]) -> None:
        for one in transmissions:
            self._on_transmission(one)
