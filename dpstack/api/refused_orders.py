"""Orders from outside that were refused, as events of the bus: each is accounted for, and a flood is counted."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final

from msgspec.structs import asdict, astuple

from dpstack.plant.orders import RefusedOrder as RefusedOrder
from dpstack.text import printable, shortened
from dpstack.trace import Event, Notice, Severity

#: s between two reports, orders named in one, and characters of a text of a stranger
_REFUSED_S: Final = 1.0
_MOST_REFUSED: Final = 5
_MOST_TEXT: Final = 200


class OrdersRefused(Notice):
    """Orders from outside (MQTT, OPC UA, the page) that were refused: one, or all of a second. ``orders`` has the first
    ones of them."""

    #: the first of the orders, each with its reason, origin, and time by its sender
    orders: tuple[RefusedOrder, ...] = ()
    #: number of the orders
    count: int = 1

    def details(self) -> dict[str, object]:
        return {"refused": [asdict(order) for order in self.orders], "count": self.count}


class RefusedOrders:
    """Reports refused orders: the first one at once, those of the second behind it in one event. Texts of strangers are
    cleaned here. ``now``: the time of the machine."""

    def __init__(self, publish: Callable[[Event], None], now: Callable[[], int]) -> None:
        self._publish = publish
        self._now = now
        self._waiting: list[RefusedOrder] = []
        self._count = 0
        self._pause: asyncio.TimerHandle | None = None

    def add(self, order: RefusedOrder) -> None:
        """Report ``order`` now, or with the others of this second."""
        self._count += 1
        if len(self._waiting) < _MOST_REFUSED:
            self._waiting.append(RefusedOrder(*(shortened(printable(text), _MOST_TEXT) for text in astuple(order))))
        if self._pause is None:
            self.report()

    def report(self) -> None:
        """Report those that wait, and let the next ones wait for a second."""
        if self._pause is not None:
            self._pause.cancel()
            self._pause = None
        if not self._count:
            return
        orders, count = tuple(self._waiting), self._count
        self._waiting, self._count = [], 0
        text = "; ".join(order.text for order in orders)
        if count > 1:
            more = f"; and {count - len(orders)} more" if count > len(orders) else ""
            text = f"{count} orders were refused: {text}{more}"
        self._publish(
            OrdersRefused(
                t_ns=self._now(), source="orders", message=text, severity=Severity.WARNING, orders=orders, count=count
            )
        )
        self._pause = asyncio.get_running_loop().call_later(_REFUSED_S, self._over)

    def _over(self) -> None:
        self._pause = None
        self.report()

    def end(self) -> None:
        """Report those that wait; it is over."""
        self.report()
        if self._pause is not None:
            self._pause.cancel()
