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
    """Named outputs of the slave at ``address``: they change in one Data_Exchange, and no other bits change."""

    address: int
    values: Mapping[str, Argument]


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


#: an order to a plant
PlantOrder = SetOutputs | SetOctets | DriveOrder | ModeOrder
