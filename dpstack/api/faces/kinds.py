"""The faces that there are, by the name of their table: module, package of the extra, and maker of each.

A face is loaded only where a table asks for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

from dpstack.bridge.face import Face, Tell
from dpstack.bridge.orders import Orders
from dpstack.bridge.tree import PlantTree


class Parts(NamedTuple):
    """The parts of the gateway that a face is made with. ``orders``: makes the gate of its orders, from its
    ``allow_commands`` and ``command_max_age_s``; raises ConfigError for a name that fits no order of the plant."""

    tree: PlantTree
    tell: Tell
    orders: Callable[[Sequence[str], float], Orders]


class FaceKind(NamedTuple):
    """``module``: loaded before ``make`` is called, which takes the table of the face and its parts. ``needs``: the
    packages of its extra, which has the name of the face."""

    module: str
    needs: tuple[str, ...]
    make: Callable[[Any, Parts], Face]


KINDS: Final[dict[str, FaceKind]] = {}
