"""Takes the marks of damaged characters out of what a tty delivers (PARMRK), in front of the decoder.

With INPCK and PARMRK and without IGNPAR a character with a parity or framing error arrives as FF 00 x, and a genuine FF
is doubled (termios(3)). A damaged octet is dropped, as with IGNPAR, and counted: dropping makes the telegram too short,
which is what its length and FCS are for; repairing it is nobody's business. The count is what IGNPAR would not tell.
"""

from __future__ import annotations

from typing import Final

_MARK: Final = 0xFF


class Unmarker:
    """Octets as the tty delivers them in, those that arrived intact out; marks may be cut anywhere by a chunk's end.

    ``damaged``: octets with an error. ``odd``: FF followed by neither FF nor 00, which cannot be: taken as two octets.
    """

    __slots__ = ("_held", "damaged", "odd")

    def __init__(self) -> None:
        self.damaged = 0
        self.odd = 0
        self._held = b""  # the beginning of a mark

    def feed(self, chunk: bytes) -> bytes:
        if not self._held and _MARK not in chunk:
            return chunk
        octets, self._held = self._held + chunk, b""
        kept = bytearray()
        at, end = 0, len(octets)
        while True:
            mark = octets.find(_MARK, at)
            if mark < 0:
                kept += octets[at:]
                return bytes(kept)
            kept += octets[at:mark]
            second = octets[mark + 1] if mark + 1 < end else None
            if second is None or (second == 0 and mark + 2 >= end):
                self._held = octets[mark:]
                return bytes(kept)
            if second == _MARK:
                kept.append(_MARK)
                at = mark + 2
            elif second == 0:
                self.damaged += 1
                at = mark + 3
            else:
                self.odd += 1
                kept += octets[mark : mark + 2]
                at = mark + 2

    def reset(self) -> None:
        """A mark that has begun is forgotten: the line was opened anew. Counters stay."""
        self._held = b""
