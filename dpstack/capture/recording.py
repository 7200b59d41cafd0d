"""Writes the transmissions of one port to a pcapng file, with their damage, the gaps, and the rates of the port."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from dpstack.capture.pcapng import USER0, Writable, Writer
from dpstack.capture.timing import timing_of
from dpstack.capture.transmission import Damage, Transmission
from dpstack.units import baud_text


@dataclass(frozen=True, slots=True)
class PortAbout:
    """The description of a port in the file. ``source``: see :mod:`dpstack.capture.timing`; ``exact``: its octets have
    the times of a simulated wire; ``paced``: octets take their time on a wire; ``more``: another remark.
    """

    name: str
    source: str
    paced: bool
    exact: bool = False
    more: str = ""

    def text(self, baud: int) -> str:
        """One line for readers of the file: rate, parity, origin and resolution of the times."""
        timing = timing_of(self.source, baud, exact=self.exact).text
        pace = "" if self.paced else "; no wire gives the octets their time"
        more = f"; {self.more}" if self.more else ""
        return f"{self.name}, {baud_text(baud)}, 8 data bits, even parity; {timing}{pace}{more}"


@dataclass(slots=True)
class Lost:
    """Octets that are missing. ``chunks``: number of chunks lost in this computer or in the program that holds the
    port; ``gaps``: the number of times something is missing; ``causes``: since the last transmission."""

    chunks: int = 0
    gaps: int = 0
    causes: list[str] = field(default_factory=list)


class Recording:
    """Writes to ``file``, whose ``write`` gets whole blocks. One interface for each rate of the port."""

    def __init__(self, file: Writable, application: str, about: PortAbout, linktype: int = USER0) -> None:
        self._writer = Writer(file, application)
        self._about = about
        self._linktype = linktype
        self._interfaces: dict[int, int] = {}  # by rate
        self._baud = -1
        self._interface = 0
        self._written: dict[int, int] = {}  # packets by interface
        self._begun_ns = 0
        self._ended_ns = 0
        self._lost = Lost()

    def add(self, one: Transmission, comment: str = "") -> None:
        """Write a transmission. ``comment``: a remark besides its own note and the gaps before it."""
        t_ns = self._ended_ns if one.t_ns is None else one.t_ns
        if one.baud != self._baud:
            self._use(one.baud, t_ns)
        self._ended_ns = t_ns
        self._written[self._interface] += 1
        if not one.damage and not comment and not one.note and not self._lost.causes:
            self._writer.packet(self._interface, t_ns, one.octets)
            return
        causes, self._lost.causes = self._lost.causes, []
        damage = [cause_text(one.damage)] if one.damage else []
        text = "; ".join(part for part in (*causes, comment, *damage, one.note) if part)
        self._writer.packet(self._interface, t_ns, one.octets, one.damage, text)

    def gap(self, cause: str, chunks: int = 0) -> None:
        """Octets are missing from here on: the next packet and the statistics say so."""
        self._lost.chunks += chunks
        self._lost.gaps += 1
        if cause not in self._lost.causes:
            self._lost.causes.append(cause)
        if self._baud >= 0:
            self._statistics(self._interface, self._ended_ns, cause)

    def close(self, now_ns: int) -> None:
        """Write the statistics of all interfaces; ``now_ns``: end of the capture, in ns since 1970."""
        for interface in self._written:
            self._statistics(interface, max(now_ns, self._ended_ns), "; ".join(self._lost.causes))

    def _use(self, baud: int, t_ns: int) -> None:
        self._baud = baud
        if baud not in self._interfaces:
            about = self._about
            self._interfaces[baud] = self._writer.interface(about.name, baud, about.text(baud), linktype=self._linktype)
            self._begun_ns = self._begun_ns or t_ns
        self._interface = self._interfaces[baud]
        self._written.setdefault(self._interface, 0)

    def _statistics(self, interface: int, now_ns: int, comment: str) -> None:
        lost = self._lost
        text = comment if not lost.gaps else f"{comment}; gaps so far: {lost.gaps}, lost chunks: {lost.chunks}"
        self._writer.statistics(
            interface, self._begun_ns, now_ns, self._written[interface], lost.chunks, text.removeprefix("; ")
        )


_CAUSES: Final = {
    Damage.FCS: "wrong check sequence or end octet",
    Damage.TOO_LONG: "too long",
    Damage.TOO_SHORT: "cut short",
    Damage.START_DELIMITER: "no valid start",
    Damage.PARITY_OR_FRAMING: "parity or framing error",
}


def cause_text(damage: int) -> str:
    """The causes of ``damage``, a sum of :class:`Damage`, in words."""
    return "damaged: " + ", ".join(text for bit, text in _CAUSES.items() if damage & bit)
