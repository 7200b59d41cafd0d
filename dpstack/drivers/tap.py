"""Tap: a bounded ring with the octets that a running machine receives and sends, for programs that look on.

A tap adds one Python call and one tuple to each chunk received and to each telegram sent; without a tap nothing is
added. A reader that is too slow loses octets, which the tap counts. It never delays the machine.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple, Protocol

from dpstack.errors import UsageError
from dpstack.fdl.codec import encode
from dpstack.fdl.telegram import Telegram
from dpstack.machine import Machine, Transmit
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_MS

#: entries: a full bus at 12 Mbit/s has some 20 000 telegrams a second, and a reader comes every 20 ms
CAPACITY: Final = 8_192
#: A reader takes at most this many entries at once, so that it delays no cycle ...
TAP_PORTION: Final = 64
#: ... and comes back after this time
TAP_PAUSE_NS: Final = 20 * NS_PER_MS


class Tapped(NamedTuple):
    """Octets on the line. ``end_ns``: no later than this the last bit was on the line (the machine's time).

    ``baud`` in bit/s. ``sent``: sent by the machine itself; ``end_ns`` is its exact end then.
    """

    end_ns: int
    baud: int
    octets: bytes
    sent: bool


class Tap:
    """The ring. ``lost``: chunks and telegrams that found it full."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self.ring: deque[Tapped] = deque()
        self.capacity = capacity
        self.lost = 0

    def add(self, entry: Tapped) -> None:
        if len(self.ring) < self.capacity:
            self.ring.append(entry)
        else:
            self.lost += 1

    def take(self, most: int) -> list[Tapped]:
        """Remove the oldest entries, at most ``most``."""
        ring = self.ring
        return [ring.popleft() for _ in range(min(most, len(ring)))]


class Line(Protocol):
    """A port; ``baud``: its rate in bit/s."""

    baud: int


class TappedMachine:
    """Stands for ``machine`` in :func:`dpstack.machine.pump`, and copies the octets received from ``line`` into
    ``tap``."""

    __slots__ = ("_line", "_receive", "_ring", "_tap", "sent", "take_tx", "wake", "wake_at")

    def __init__(self, machine: Machine, line: Line, tap: Tap) -> None:
        self._line = line
        self._receive = machine.receive
        self._tap = tap
        self._ring = tap.ring
        self.sent = machine.sent
        self.take_tx = machine.take_tx
        self.wake = machine.wake
        self.wake_at = machine.wake_at

    def receive(self, chunk: bytes, now: int) -> None:
        tap = self._tap
        if len(self._ring) < tap.capacity:
            self._ring.append(Tapped(now, self._line.baud, chunk, False))
        else:
            tap.lost += 1
        self._receive(chunk, now)


def tapped_transmit(line: Line, transmit: Transmit, tap: Tap) -> Transmit:
    """``transmit``, which also copies the octets into ``tap``."""
    ring = tap.ring

    def transmit_and_copy(octets: bytes, now: int) -> int:
        end_ns = transmit(octets, now)
        if len(ring) < tap.capacity:
            ring.append(Tapped(end_ns, line.baud, octets, True))
        else:
            tap.lost += 1
        return end_ns

    return transmit_and_copy


class TapStation:
    """A station of the simulated bus that only listens, at the rate of ``station``, and fills ``tap``."""

    #: a listening station has no address
    address: Final = -1
    hears_all: Final = True

    def __init__(self, station: Machine, tap: Tap) -> None:
        self._station = station
        self._tap = tap

    @property
    def baud(self) -> int:
        return self._station.baud

    def receive(self, chunk: bytes, now: int) -> None:
        self._tap.add(Tapped(now, self.baud, chunk, False))

    def telegram(self, telegram: Telegram, now: int) -> None:
        self._tap.add(Tapped(now, self.baud, encode(telegram), False))

    def activity(self, now: int) -> None:
        """Ignored: only octets count."""

    def sent(self, at: int) -> None:
        """Never called: it sends nothing."""

    def wake(self, now: int) -> None:
        """Never due."""

    def wake_at(self) -> int:
        return NEVER

    def take_tx(self, now: int) -> None: ...

    def take_events(self) -> list[Event]:
        return []

    def command(self, command: object, now: int) -> None:
        raise UsageError(f"a tap knows no {type(command).__name__}")
