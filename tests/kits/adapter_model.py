"""A station behind a USB serial adapter, in virtual time: delay and packing of octets.

The adapter, not its station, is added to the world. It pumps its station as a driver on a serial port would. Received
octets wait for a full packet or for the latency timer, and for the next USB frame. Octets that the host sends wait for
a USB frame too, while the host assumes that they went on the wire at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final, Protocol

from msgspec import Struct

from dpstack.errors import ConfigError
from dpstack.fdl.interface import BusStation
from dpstack.fdl.telegram import Telegram
from dpstack.machine import HeldUp, pump
from dpstack.params import BusParams
from dpstack.stats import Histogram
from dpstack.trace import Event
from dpstack.units import NEVER, NOW, NS_PER_MS, chars_to_ns


class Habits(Struct, frozen=True, kw_only=True):
    """The behaviour of an adapter. Times in ns; the default has full-speed USB frames and a latency timer of 1 ms.

    ``frame_ns``: octets go to and from the host only at multiples of this. ``latency_ns``: the time between a packet
    that is not full and the packet before it. ``packet``: octets of a full packet. ``echo``: the station hears its own
    octets.
    """

    frame_ns: int = NS_PER_MS
    latency_ns: int = NS_PER_MS
    packet: int = 62
    echo: bool = False

    def __post_init__(self) -> None:
        if self.frame_ns < 1 or self.latency_ns < 0 or self.packet < 1:
            raise ConfigError(f"{self}: frame_ns and packet must be 1 or more, latency_ns 0 or more")


#: an FTDI chip as delivered: latency timer of 16 ms, packets of 64 octets of which two are its status
FTDI: Final = Habits(latency_ns=16 * NS_PER_MS)
#: the same with the shortest latency timer, 1 ms
FTDI_LOW_LATENCY: Final = Habits()


class OwnOctets(Protocol):
    """Echo filter: removes a station's own octets from the octets that an adapter with echo delivers."""

    def sent(self, octets: bytes) -> None:
        """The station sends ``octets`` now."""

    def strip(self, chunk: bytes) -> bytes: ...

    def release(self) -> bytes:
        """The octets that the filter has held back; called when a deadline is due."""


class Adapter:
    """``station`` on an adapter with ``habits``. A BusStation: add it to the world, send commands to it.

    ``own``: removes the echo, if there is one. ``cost``: the time from the first octet of a packet on the wire to
    the delivery of the packet to the host.
    """

    def __init__(self, station: BusStation, habits: Habits = FTDI_LOW_LATENCY, *, own: OwnOctets | None = None) -> None:
        self.station = station
        self.habits = habits
        self.cost = Histogram()
        self._own = own
        self._fifo: deque[tuple[int, int]] = deque()  # end of the octet on the wire, octet
        self._packet_at = 0  # when the last packet went to the host
        self._out: deque[tuple[int, bytes]] = deque()  # earliest time on the wire, octets
        self._sending = b""
        self._busy_until = 0  # end of the transmission under way
        self._host_at = NOW  # the station's deadline

    # --- properties of the station ---
    @property
    def address(self) -> int:
        return self.station.address

    @property
    def baud(self) -> int:
        return self.station.baud

    @property
    def params(self) -> BusParams | None:
        """The station's bus parameters, for the referee; None if it has none."""
        return getattr(self.station, "params", None)

    @property
    def hears_all(self) -> bool:
        return True

    @property
    def by_octets(self) -> bool:
        return True

    def activity(self, now: int) -> None:
        """Ignored: a port does not report edges."""

    def telegram(self, telegram: Telegram, now: int) -> None:
        raise RuntimeError(f"an adapter was handed {telegram}: it takes octets only")

    def take_events(self) -> list[Event]:
        return self.station.take_events()

    def command(self, command: object, now: int) -> None:
        self.station.command(command, now)
        self._pump(b"", now)

    @property
    def held_up(self) -> Callable[[HeldUp, int], bool] | None:
        return self.station.held_up

    # --- the wire's side ---
    def receive(self, chunk: bytes, now: int) -> int:
        self._fifo.extend((now, octet) for octet in chunk)
        return NOW

    def take_tx(self, now: int) -> bytes | None:
        """Deliver the packets that are due; octets before timers, as a driver does. Then the host's octets, once a USB
        frame has brought them and the transmitter is free."""
        while self._packet_due() <= now:
            self._deliver(now)
        if self._host_at <= now:
            held = self._own.release() if self._own is not None else b""
            self._pump(held, now)
        if not self._out or now < self._start_at():
            return None
        self._sending = self._out.popleft()[1]
        return self._sending

    def sent(self, at: int) -> int:
        """The last bit will be on the wire at ``at``; with echo the octets come back by then."""
        self._busy_until = at
        if self.habits.echo:
            size = len(self._sending)
            self._fifo.extend((at - chars_to_ns(size - n - 1, self.baud), o) for n, o in enumerate(self._sending))
        return NOW

    def wake_at(self) -> int:
        """The next packet for the host, octets for the wire, or the host's own deadline."""
        return min(self._packet_due(), self._start_at() if self._out else NEVER, self._host_at)

    # --- inside ---
    def _start_at(self) -> int:
        return max(self._out[0][0], self._busy_until)

    def _frame(self, at: int) -> int:
        """The first frame not before ``at``."""
        frame_ns = self.habits.frame_ns
        return -(-at // frame_ns) * frame_ns

    def _packet_due(self) -> int:
        """When the next packet goes to the host: full, or at the latency timer, which always runs."""
        fifo, habits = self._fifo, self.habits
        if not fifo:
            return NEVER
        first = fifo[0][0]
        expiry = self._packet_at + habits.latency_ns
        if expiry < first and habits.latency_ns:
            expiry += -(-(first - expiry) // habits.latency_ns) * habits.latency_ns
        at = self._frame(max(expiry, first))
        if len(fifo) >= habits.packet:
            at = min(at, self._frame(fifo[habits.packet - 1][0]))
        return at

    def _deliver(self, now: int) -> None:
        fifo = self._fifo
        first = fifo[0][0]
        chunk = bytearray()
        while fifo and fifo[0][0] <= now and len(chunk) < self.habits.packet:
            chunk.append(fifo.popleft()[1])
        self._packet_at = now
        self.cost.add(now - first)
        octets = bytes(chunk)
        self._pump(octets if self._own is None else self._own.strip(octets), now)

    def _pump(self, chunk: bytes, now: int) -> None:
        self._host_at = pump(self.station, chunk, now, self._write)
        while self._host_at <= now:
            self._host_at = pump(self.station, b"", now, self._write)

    def _write(self, octets: bytes, now: int) -> int:
        """Send for the host: returns at once, with the end as a driver would estimate it."""
        if self._own is not None:
            self._own.sent(octets)
        self._out.append((self._frame(now), octets))
        return now + chars_to_ns(len(octets), self.baud)
