"""A slave that exchanges data and left a service unanswered is asked for no other before its next exchange.

To the link layer silence is silence: the next request to that station is a first one (FCV 0, FCB 1), and after three of
these FCV is probed (protocol facts A4). A probe that carries the FCB of the request before is taken for its repetition.
That must never be a Data_Exchange, which several services in vain between two cycles would bring about: the slave would
be given up although it exchanges data.
"""

from __future__ import annotations

from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.fdl.interface import Failure
from dpstack.fdl.telegram import Telegram

#: ends of a request that the link layer takes for silence
_IN_VAIN = frozenset((Failure.NO_ANSWER, Failure.GARBLED, Failure.WRONG))


class Unheard:
    """``master``: whose slaves they are; None: nobody's, and everybody may be asked."""

    __slots__ = ("_exchanges", "_master")

    def __init__(self, master: Master | None) -> None:
        self._master = master
        #: by address: the exchanges there were when it left a service unanswered
        self._exchanges: dict[int, int] = {}

    def ended(self, address: int, outcome: Telegram | Failure) -> None:
        """A service to ``address`` is over."""
        handler = None if self._master is None else self._master.handlers.get(address)
        if handler is not None and outcome in _IN_VAIN:
            self._exchanges[address] = handler.exchanges
        elif self._exchanges:
            self._exchanges.pop(address, None)

    def bars(self, address: int) -> bool:
        """Whether ``address`` is not to be asked now. In Stop nobody has an exchange to wait for."""
        if not self._exchanges or self._master is None or self._master.mode <= Mode.STOP:
            return False
        handler = self._master.handlers.get(address)
        if handler is None or handler.state is not SlaveState.DATA_EXCHANGE:
            return False
        return handler.exchanges == self._exchanges.get(address)
