"""Answers to Data_Exchange that are no good data: when they are too many, and what they then mean (B6, A3)."""

from __future__ import annotations

from typing import Final

from dpstack.dp import faults
from dpstack.dp.bringup import Ev
from dpstack.dp.events import Fault
from dpstack.fdl.telegram import Kind, Resp, Telegram

_MAX_WRONG: Final = 3
_MAX_BUSY: Final = 5
_DATA: Final = (int(Resp.DL), int(Resp.DH))


class OddAnswers:
    """Counts them; one good exchange forgives all (:attr:`none` is False while there is something to forgive)."""

    __slots__ = ("_busy", "_wrong", "none")

    def __init__(self) -> None:
        self.none = True
        self._wrong = self._busy = 0

    def clear(self) -> None:
        """A good exchange, or a new state."""
        self.none = True
        self._wrong = self._busy = 0

    def judge(self, answer: Telegram, expected: int) -> tuple[Ev, Fault | None] | None:
        """What ``answer`` means to a slave with ``expected`` octets of inputs; None: ask again in the next round."""
        self.none = False
        status = answer.fc & 0x0F
        if answer.kind is Kind.SC or status in _DATA:
            self._wrong += 1
            if self._wrong < _MAX_WRONG:
                return None
            return Ev.WRONG_LENGTH, faults.wrong_length(expected, len(answer.data))
        if status == Resp.RS:
            return Ev.NOT_EXCHANGING, None
        self._busy += 1  # UE, RR, NR, RDL, RDH
        return None if self._busy < _MAX_BUSY else (Ev.REFUSED, None)
