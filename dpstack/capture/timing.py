"""How finely a capture is timed: the kind of its source, its resolution, and the words for both in a file."""

from __future__ import annotations

import re
from typing import Final

from msgspec import Struct

from dpstack.units import NS_PER_MS, NS_PER_US, bits_to_ns

#: kinds of sources: the machine of a running program of ours; a UART or USB adapter; a pty or socket; the samples of a
#: logic analyser; a file that does not say what wrote it
TAP, ADAPTER, HOST, WAVEFORM, FILE = "tap", "adapter", "host", "waveform", "file"

#: Full-speed USB delivers once a millisecond; a computer with load wakes a program as late.
_DELIVERY_NS: Final = NS_PER_MS
#: A UART with a FIFO delivers the last octets of a telegram after four characters of silence (16550 data sheet).
_FIFO_BITS: Final = 44
_TEXT: Final = re.compile(r"times by (tap|adapter|host|waveform|file), resolution (\d{1,9}(?:\.\d{1,3})?) us")


class LineTiming(Struct, frozen=True):
    """``source``: "tap", "adapter", "host", "waveform" or "file". ``resolution_ns``: the error of the distance of two
    times, None if nobody knows it."""

    source: str
    resolution_ns: int | None

    @property
    def text(self) -> str:
        """For the description of an interface in a capture file; :meth:`parse` reads it there."""
        if self.resolution_ns is None:
            return f"times by {self.source}, resolution unknown"
        return f"times by {self.source}, resolution {self.resolution_ns / NS_PER_US:g} us"

    @classmethod
    def parse(cls, description: str) -> LineTiming:
        """The timing that ``description`` of an interface gives; else ("file", None)."""
        found = _TEXT.search(description)
        if found is None:
            return cls(FILE, None)
        return cls(found[1], round(float(found[2]) * NS_PER_US))


def timing_of(source: str, baud: int, *, exact: bool = False) -> LineTiming:
    """The timing of a ``source`` at ``baud`` bit/s. ``exact``: its octets have the times of a simulated wire."""
    if exact:
        return LineTiming(source, 1)
    fifo_ns = 0 if source == HOST else bits_to_ns(_FIFO_BITS, baud)
    return LineTiming(source, max(_DELIVERY_NS, fifo_ns))
