"""Octets of a port that marks damaged ones: a parity or framing error, at its place."""

from __future__ import annotations

from typing import Final

#: note on octets that are marked because the adapter marks all octets of a packet alike
PACKET_NOTE: Final = "the port marks whole packets: at least one octet of this packet was damaged, perhaps not here"


class MarkedOctets(bytes):
    """Octets with ``marks``, the places of those that the port has marked as damaged, in ascending order.

    ``packets``: a mark may stand for a whole packet of the adapter, of which some octet was damaged. They may be joined
    with ``+`` as other octets, and keep their marks.
    """

    marks: tuple[int, ...]
    packets: bool

    def __new__(cls, octets: bytes, marks: tuple[int, ...], *, packets: bool = False) -> MarkedOctets:
        self = super().__new__(cls, octets)
        self.marks = marks
        self.packets = packets
        return self

    def __add__(self, behind: bytes, /) -> MarkedOctets:  # type: ignore[override]
        marks = self.marks
        packets = self.packets
        if isinstance(behind, MarkedOctets):
            marks += tuple(len(self) + place for place in behind.marks)
            packets |= behind.packets
        return MarkedOctets(bytes(self) + bytes(behind), marks, packets=packets)

    def __radd__(self, before: bytes) -> MarkedOctets:
        if not isinstance(before, bytes):
            return NotImplemented  # a bytearray takes the octets without their marks
        marks = tuple(len(before) + place for place in self.marks)
        return MarkedOctets(bytes(before) + bytes(self), marks, packets=self.packets)
