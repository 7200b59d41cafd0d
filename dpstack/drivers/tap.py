"""Tap: a bounded ring with the octets that a running machine receives and sends, for programs that look on.

A tap adds one Python call and one tuple to each chunk received and to each telegram sent; without a tap nothing is
added. A reader that is too slow loses entries, which the tap counts with their place. It never delays the machine.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, Protocol

from dpstack.errors import UsageError
from dpstack.fdl.telegram import Telegram
from dpstack.machine import Machine
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_MS

#: entries: a full bus at 12 Mbit/s has some 47 000 telegrams of 21 octets a second, and a reader comes every 0.1 s
CAPACITY: Final = 16_384
#: A reader takes at most this many entries at once, so that it delays no cycle (it needs some 50 us for them) ...
TAP_PORTION: Final = 256
#: ... and comes back after this time, as each wake-up costs more than the entries ...
TAP_PAUSE_NS: Final = 100 * NS_PER_MS
#: ... or after this one, if entries are left.
TAP_SHORT_PAUSE_NS: Final = NS_PER_MS

#: Octets on the line: ``(end_ns, baud, octets, sent)``. No later than ``end_ns`` (the machine's time) the last bit was
#: on the line; ``baud`` in bit/s; ``sent``: the machine itself sent them. An entry without octets: the port was lost
#: (``baud`` 0), or is back. A plain tuple, as making one of a class takes four times as long.
Tapped = tuple[int, int, bytes, bool]


class Tap:
    """The ring. ``lost``: chunks and telegrams that found it full since the last :meth:`take`. ``on_portion`` is called
    after each :meth:`extend`."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self.ring: deque[Tapped] = deque()
        self.capacity = capacity
        self.lost = 0
        self.on_portion: Callable[[], object] | None = None
        self._taken = 0  # entries taken so far
        self._gaps: deque[tuple[int, int]] = deque()  # entries before the gap, counted from the first; entries lost

    def add(self, entry: Tapped) -> None:
        if len(self.ring) < self.capacity:
            self.ring.append(entry)
        else:
            self.lost += 1

    def extend(self, entries: Sequence[Tapped], lost: int) -> None:
        """Add ``entries``, before which another ring lost ``lost`` entries."""
        self._note_losses()
        if lost:
            self._add_gap(lost)
        room = max(0, self.capacity - len(self.ring))
        self.ring.extend(entries[:room])
        self.lost += len(entries[room:])
        if self.on_portion is not None:
            self.on_portion()

    def take(self, most: int = CAPACITY) -> tuple[int, list[Tapped]]:
        """Remove the oldest entries, at most ``most``, and none behind the next gap. Returns the number of entries
        that were lost directly before them, and the entries."""
        self._note_losses()
        ring, gaps = self.ring, self._gaps
        lost = 0
        if gaps and gaps[0][0] == self._taken:
            lost = gaps.popleft()[1]
        count = min(most, len(ring), gaps[0][0] - self._taken if gaps else most)
        self._taken += count
        if count == len(ring):
            entries = list(ring)
            ring.clear()
        else:
            entries = [ring.popleft() for _ in range(count)]
        return lost, entries

    @property
    def waiting(self) -> bool:
        """There is something to take."""
        return bool(self.ring or self.lost or self._gaps)

    def _note_losses(self) -> None:
        """Whatever was lost since the last call found the ring full: all entries in it are older."""
        if self.lost:
            lost, self.lost = self.lost, 0
            self._add_gap(lost)

    def _add_gap(self, lost: int) -> None:
        position = self._taken + len(self.ring)
        if self._gaps and self._gaps[-1][0] == position:
            lost += self._gaps.pop()[1]
        self._gaps.append((position, lost))


class TappedPort(Protocol):
    """A port; ``baud``: its rate in bit/s."""

    baud: int


class TappedMachine:
    """Stands for ``machine`` in :func:`dpstack.machine.pump`, and copies the octets received from ``line`` into
    ``tap``."""

    __slots__ = ("_line", "_receive", "_ring", "_tap", "sent", "take_tx", "wake_at")

    def __init__(self, machine: Machine, line: TappedPort, tap: Tap) -> None:
        self._line = line
        self._receive = machine.receive
        self._tap = tap
        self._ring = tap.ring
        self.sent = machine.sent
        self.take_tx = machine.take_tx
        self.wake_at = machine.wake_at

    def receive(self, chunk: bytes, now: int) -> int:
        tap = self._tap
        if len(self._ring) < tap.capacity:
            self._ring.append((now, self._line.baud, chunk, False))
        else:
            tap.lost += 1
        return self._receive(chunk, now)


class TapStation:
    """A station of the simulated bus that only listens, at the rate of ``station``, and fills ``tap``."""

    #: a listening station has no address
    address: Final = -1
    hears_all: Final = True
    held_up: Final = None

    def __init__(self, station: Machine, tap: Tap) -> None:
        from dpstack.fdl.codec import encode  # here, as the application of a bus process has no codec

        self._encode = encode
        self._station = station
        self._tap = tap

    @property
    def baud(self) -> int:
        return self._station.baud

    def receive(self, chunk: bytes, now: int) -> int:
        self._tap.add((now, self.baud, chunk, False))
        return NEVER

    def telegram(self, telegram: Telegram, now: int) -> None:
        self._tap.add((now, self.baud, self._encode(telegram), False))

    def activity(self, now: int) -> None:
        """Ignored: only octets count."""

    def sent(self, at: int) -> int:
        """Never called: it sends nothing."""
        return NEVER

    def wake_at(self) -> int:
        return NEVER

    def take_tx(self, now: int) -> None: ...

    def take_events(self) -> list[Event]:
        return []

    def command(self, command: object, now: int) -> None:
        raise UsageError(f"a tap knows no {type(command).__name__}")
