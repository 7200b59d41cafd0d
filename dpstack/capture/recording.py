"""Writes the transmissions of one port to a pcapng file, with their damage, the gaps, and the rates of the port."""

from __future__ import annotations

from typing import Final

from msgspec import Struct

from dpstack.capture.pcapng import USER0, Writable, Writer
from dpstack.capture.timing import LineTiming, timing_of
from dpstack.capture.transmission import Transmission, damage_text
from dpstack.units import baud_text

#: causes of a gap that are kept until the next transmission
_MOST_CAUSES: Final = 8


class PortAbout(Struct, frozen=True):
    """The description of a port in the file. ``source``: see :mod:`dpstack.capture.timing`; ``exact``: its octets have
    the times of a simulated wire; ``paced``: octets take their time on a wire; ``more``: another remark; ``timing``: of
    a file, whatever its source.
    """

    name: str
    source: str
    paced: bool
    exact: bool = False
    more: str = ""
    timing: LineTiming | None = None

    def text(self, baud: int) -> str:
        """One line for readers of the file: rate, parity, origin and resolution of the times."""
        timing = (self.timing or timing_of(self.source, baud, exact=self.exact)).text
        pace = "" if self.paced else "; no wire gives the octets their time"
        more = f"; {self.more}" if self.more else ""
        return f"{self.name}, {baud_text(baud)}, 8 data bits, even parity; {timing}{pace}{more}"


#: begin of the comment of a packet before which octets are missing
GAP: Final = "gap: "


class Gaps:
    """Places where octets are missing. ``count``: their number; ``chunks``: of octets, lost in this computer or in the
    program that holds the port."""

    def __init__(self) -> None:
        self.count = 0
        self.chunks = 0
        self._causes: list[str] = []
        self._more = 0

    def add(self, cause: str, chunks: int = 0) -> None:
        """Octets are missing from here on."""
        self.count += 1
        self.chunks += chunks
        if len(self._causes) < _MOST_CAUSES:
            self._causes.append(cause)
        else:
            self._more += 1

    def take(self) -> str:
        """The causes since the last call, in one line; empty if there was no gap."""
        causes, self._causes = self._causes, []
        more, self._more = self._more, 0
        if not causes:
            return ""
        return GAP + "; ".join([*causes, *([f"{more} more gaps"] if more else [])])


class Recording:
    """Writes one section to ``file``, whose ``write`` gets whole blocks. One interface for each rate of the port."""

    def __init__(
        self, file: Writable, application: str, about: PortAbout, gaps: Gaps | None = None, linktype: int = USER0
    ) -> None:
        self._writer = Writer(file, application)
        self._about = about
        self._gaps = gaps or Gaps()
        self._chunks_before = self._gaps.chunks
        self._linktype = linktype
        self._interfaces: dict[int, int] = {}  # by rate
        self._written: dict[int, int] = {}  # packets by interface
        self._baud = -1
        self._interface = 0
        self._begun_ns = 0
        self._ended_ns = 0

    def add(self, one: Transmission, remark: str = "", gap: str = "") -> None:
        """Write a transmission. ``remark``: for its comment, besides its own note; ``gap``: the cause if octets are
        missing before it."""
        t_ns = self._ended_ns if one.t_ns is None else one.t_ns
        if one.baud != self._baud:
            self._use(one.baud, t_ns)
        self._ended_ns = t_ns
        interface = self._interface
        if not (one.damage or remark or one.note or gap):
            self._written[interface] += 1
            self._writer.packet(interface, t_ns, one.octets)
            return
        if gap:
            self._statistics(interface, t_ns, gap)
        self._written[interface] += 1
        cause = f"damaged: {damage_text(one.damage)}" if one.damage else ""
        if cause in one.note:  # copied from another file
            cause = ""
        text = "; ".join(part for part in (gap, remark, cause, one.note) if part)
        self._writer.packet(interface, t_ns, one.octets, one.damage, text)

    def close(self, now_ns: int) -> None:
        """Write the statistics of all interfaces; ``now_ns``: end of this file, in ns since 1970."""
        for interface in self._written:
            self._statistics(interface, max(now_ns, self._ended_ns), self._gaps.take())

    def _use(self, baud: int, t_ns: int) -> None:
        self._baud = baud
        if baud not in self._interfaces:
            about = self._about
            self._interfaces[baud] = self._writer.interface(about.name, baud, about.text(baud), linktype=self._linktype)
            self._begun_ns = self._begun_ns or t_ns
        self._interface = self._interfaces[baud]
        self._written.setdefault(self._interface, 0)

    def _statistics(self, interface: int, now_ns: int, comment: str) -> None:
        gaps = self._gaps
        if gaps.count:
            so_far = f"in this capture so far: {gaps.count} gaps, {gaps.chunks} lost chunks"
            comment = f"{comment}; {so_far}" if comment else so_far
        chunks = gaps.chunks - self._chunks_before
        self._writer.statistics(interface, self._begun_ns, now_ns, self._written[interface], chunks, comment)
