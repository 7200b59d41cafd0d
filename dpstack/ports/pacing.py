"""Pacing: octets are delivered in slices, each at the time when its last bit would be on the wire."""

from __future__ import annotations

import asyncio
import heapq
from collections.abc import Callable
from time import monotonic_ns
from typing import Final, Generic, TypeVar

from dpstack.ports.timerfd import Timerfd
from dpstack.units import NS_PER_MS, bits_to_ns, chars_to_ns

Sender = TypeVar("Sender")

# A quarter of T_SL exceeds 1 ms only at the slowest rates, where T_SL is 100 bit times, and at 45.45 kbit/s (640).
_SLOT_BITS: Final = 100
_SLOT_BITS_45: Final = 640


def slice_octets(baud: int) -> int:
    """Octets in one slice at ``baud``: a quarter slot time or 1 ms, the larger; at least one."""
    slot_bits = _SLOT_BITS_45 if baud == 45_450 else _SLOT_BITS
    slice_ns = max(bits_to_ns(slot_bits // 4, baud), NS_PER_MS)
    return max(1, slice_ns // chars_to_ns(1, baud))


#: Octets a sender may have waiting, as much as the kernel buffers in front of a UART (a page).
_BACKLOG: Final = 4096


class PacedWire(Generic[Sender]):
    """Delays the octets of all senders. Their transmissions run side by side: the wire does not arbitrate."""

    def __init__(self, loop: asyncio.AbstractEventLoop, deliver: Callable[[Sender, bytes, int], None]) -> None:
        self._loop = loop
        self._deliver = deliver
        self._timer = Timerfd()
        self._queue: list[tuple[int, int, Sender, bytes, int]] = []  # at, order, sender, octets, baud
        self._order = 0
        self._free_at: dict[Sender, int] = {}  # when a sender's own transmitter is empty
        loop.add_reader(self._timer.fd, self._due)

    def send(self, sender: Sender, octets: bytes, baud: int) -> bool:
        """Send ``octets`` now, or after those that ``sender`` is still sending; False: too many wait, dropped."""
        now = monotonic_ns()
        start = max(now, self._free_at.get(sender, 0))
        if start - now > chars_to_ns(_BACKLOG, baud):
            return False
        step = slice_octets(baud)
        for first in range(0, len(octets), step):
            piece = octets[first : first + step]
            self._order += 1
            at = start + chars_to_ns(first + len(piece), baud)
            heapq.heappush(self._queue, (at, self._order, sender, piece, baud))
        self._free_at[sender] = start + chars_to_ns(len(octets), baud)
        self._timer.set(self._queue[0][0])
        return True

    def close(self) -> None:
        self._queue.clear()
        if self._timer.fd >= 0:
            self._loop.remove_reader(self._timer.fd)
        self._timer.close()

    def _due(self) -> None:
        self._timer.clear()
        queue = self._queue
        while queue and queue[0][0] <= monotonic_ns():
            _at, _order, sender, octets, baud = heapq.heappop(queue)
            self._deliver(sender, octets, baud)
        if queue:
            self._timer.set(queue[0][0])
