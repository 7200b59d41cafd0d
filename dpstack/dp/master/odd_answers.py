"""Answers to Data_Exchange that are no good data: when they are too many, and what they then mean (B6, A3)."""

from __future__ import annotations

from typing import Final

from dpstack.dp.master.slave_states import Ev
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

    def judge(self, answer: Telegram) -> Ev | None:
        """What ``answer`` to Data_Exchange means: WRONG_LENGTH, NOT_EXCHANGING (RS) or REFUSED; None: ask again in
        the next round.
        """
        self.none = False
        status = answer.fc & 0x0F
        if answer.kind is Kind.SC or status in _DATA:
            self._wrong += 1
            return None if self._wrong < _MAX_WRONG else Ev.WRONG_LENGTH
        if status == Resp.RS:
            return Ev.NOT_EXCHANGING
        self._busy += 1  # UE, RR, NR, RDL, RDH
        return None if self._busy < _MAX_BUSY else Ev.REFUSED
