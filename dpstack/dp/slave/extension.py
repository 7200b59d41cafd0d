"""Services of a device beyond those of DP-V0 (MS1, MS2, DXB), and their blocks in the diagnosis."""

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

    def refuse_prm(self, prm: SetPrm) -> str | None:
        """A reason to refuse ``prm``, which the device accepts; None without one."""
        return None

    def refuse_cfg(self, config: bytes) -> str | None:
        """A reason to refuse the identifier octets of Chk_Cfg, which the device accepts; None without one."""
        return None

    def tick(self, now: int) -> None:
        """The time in :attr:`at` has come."""

    def end(self, why: str, now: int) -> None:
        """The slave was switched off, or has another address or rate: no master can finish its services."""


class BroadcastService(SlaveService):
    """Data exchange broadcast (DXB): publisher, subscriber, or both."""

    #: the device can publish: without Publisher_Enable it is silent to MSRD, and does not refuse it
    can_publish: bool = False
    #: the device can subscribe
    can_subscribe: bool = False
    #: the master has set Publisher_Enable
    publishes: bool = False
    #: values of publishers act as outputs, or have changed, since the device got its outputs
    stale: bool = False

    def begin(self, config: bytes, now: int) -> Callable[[bytes, bool], bytes] | None:
        """Data exchange begins with ``config``. Returns the function from the outputs of the master, and whether values
        of publishers may act, to the outputs of the device; None if publishers give none of them."""
        return None

    def hear(self, telegram: Telegram, now: int) -> None:
        """The answer of a publisher to all stations; its last bit was on the line at ``now``."""
