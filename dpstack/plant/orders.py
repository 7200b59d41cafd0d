"""Orders to a plant as typed values. Connectors hand them on as they are; text is parsed where people write it.

:mod:`dpstack.api.control.orders` carries them out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal

from msgspec import Struct

#: value of an output, or the argument of an operation
Argument = bool | int | float | bytes
#: operations of a drive; ``acknowledge``: its fault, ``speed`` has the set point as argument (1.0: the reference)
Operation = Literal["start", "stop", "quick_stop", "coast", "acknowledge", "speed"]
#: operations that switch the motor off
HALTS: Final[frozenset[str]] = frozenset({"stop", "quick_stop", "coast"})


class SetOutputs(Struct, frozen=True):
    """Named outputs of the slave at ``address``: they change in one Data_Exchange, and no other bits change.

    ``values``: None takes an order back, if a plugin makes the outputs: it is as before any order.
    """

    address: int
    values: Mapping[str, Argument | None]


class SetCpuValues(SetOutputs, frozen=True):
    """Named values of the S7-200 at ``address``: they are written at once, one after the other; none is None."""


class SetOctets(Struct, frozen=True):
    """All outputs of the slave at ``address``."""

    address: int
    octets: bytes


class DriveOrder(Struct, frozen=True):
    """An operation of the drive at ``address``, with its argument ``value``."""

    address: int
    operation: Operation
    value: Argument | None = None


class ModeOrder(Struct, frozen=True):
    """Operate or Clear, for the whole bus."""

    mode: Literal["operate", "clear"]


class RefusedOrder(Struct, frozen=True):
    """An order that was refused, of somebody who does not stand beside the plant."""

    #: the order, as its sender named it
    order: str
    #: why it was refused
    reason: str
    #: the connector or the page, and the user if it has one
    origin: str
    #: time of the order, as its sender gave it; empty if it gave none
    order_time: str = ""

    @property
    def text(self) -> str:
        """``mqtt: order valves.lamp refused: it is not in allow_commands; order_time 2026-11-28T10:00:00.000Z``."""
        given = f"; order_time {self.order_time}" if self.order_time else ""
        return f"{self.origin}: order {self.order} refused: {self.reason}{given}"


#: an order to a plant
PlantOrder = SetOutputs | SetOctets | DriveOrder | ModeOrder
