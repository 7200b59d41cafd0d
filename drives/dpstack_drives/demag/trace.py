"""The process data as the drive itself shows them in 281 and 284 (docs/reference/drives/demag.md#trace-lines), from
live data.

The parameter channel's part is the last transmission, not the zeros between two. The manual has words 3 to 6 of OUT as
not used, which is not so in PPO2 and PPO4: the real words are shown.
"""

from __future__ import annotations

import struct
from typing import Final

from dpstack.profile import CHANNEL_LEN, Pkw

_IDLE: Final = bytes(CHANNEL_LEN)


class Trace:
    """Keeps the last transmission of the channel each way; ``channel``: the telegram has one."""

    __slots__ = ("_channel", "_last")

    def __init__(self, *, channel: bool) -> None:
        self._channel = channel
        self._last = {"out": _IDLE, "in": _IDLE}

    def watch(self, way: str, octets: bytes) -> None:
        """Octets that went ``out`` or came ``in``."""
        if self._channel and octets[0] >> 4:
            self._last[way] = octets[:CHANNEL_LEN]

    def lines(self, outputs: bytes, inputs: bytes) -> dict[str, object]:
        """``out`` and ``in`` as 281 and 284 show them, the words from the octets given."""
        return {
            "out": self._line("out", outputs, ("CTR", "STP")),
            "in": self._line("in", inputs, ("STA", "VAL")),
        }

    def _line(self, way: str, octets: bytes, names: tuple[str, str]) -> str:
        found: list[str] = []
        if self._channel:
            last = Pkw.parse(self._last[way])
            low = self._last[way][3]
            value = (last.pwe ^ 0x8000_0000) - 0x8000_0000
            found.append(f"PKE: {last.id:X} {last.pnu:03} IND: {last.ind:02X} {low:02X} PWE: {value:+07d}")
            octets = octets[CHANNEL_LEN:]
        words = struct.unpack(f">{len(octets) // 2}H", octets)
        labels = (*names, *(str(number) for number in range(3, 7)))
        found += [f"{label}: {word:04X}" for label, word in zip(labels, words, strict=False)]
        return " ".join(found)
