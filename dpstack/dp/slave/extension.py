"""Services of a device beyond those of DP-V0 (MS1, MS2), at SAPs of their own, and their blocks in the diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from dpstack.dp.pdu.requests import SetPrm
from dpstack.fdl.interface import Reply
from dpstack.fdl.telegram import Telegram
from dpstack.units import NEVER

#: answers a request, None for RS
Handler = Callable[[Telegram, int], Reply | None]


class DiagMessages(Protocol):
    """Blocks that stand in the diagnosis before the device's own: alarms and status messages."""

    def must_fetch(self) -> bool:
        """A Data_Exchange is answered: whether the master must fetch a diagnosis."""

    def octets(self) -> bytes:
        """The blocks of this moment."""

    def offered(self) -> None:
        """An answer to the owner holds them; whether it arrived is not known yet."""

    def fetched(self) -> None:
        """The owner has the answer that was offered last."""


class SlaveService:
    """Services of one slave application. Subclass it, override what differs."""

    #: when :meth:`tick` is wanted, in ns
    at: int = NEVER
    messages: DiagMessages | None = None

    def handlers(self) -> Mapping[int | None, Handler]:
        """The functions that answer requests, by DSAP. In which states, and whether to the owner only, is in
        :data:`~dpstack.dp.slave.state_table.ACCESS`."""
        return {}

    def parameterised(self, prm: SetPrm) -> None:
        """The slave accepted ``prm``."""

    def entered(self) -> None: ...

    def left(self) -> None: ...

    def hear_clock(self, telegram: Telegram, now: int) -> None:
        """A Time_Event or Clock_Value of a class 3 master (DP-V2)."""

    def tick(self, now: int) -> None:
        """The time in :attr:`at` has come."""

    def end(self, why: str, now: int) -> None:
        """The slave was switched off, or has another address or rate: no master can finish its services."""
