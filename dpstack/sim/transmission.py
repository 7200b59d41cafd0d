"""One transmission: octets of one sender on the wire, and what becomes of them on the way."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from dpstack.fdl.codec import decode
from dpstack.fdl.telegram import Telegram
from dpstack.sim.nodes import Node

#: The same octets come again and again: a telegram is decoded once for all of them.
_decode: Final = lru_cache(1_024)(decode)


class Transmission:
    """Octets of one sender on the wire, without gaps. ``telegram`` is None when they are not exactly one.

    ``forced``: by an order from outside (injected, delayed), so not a station's doing. ``flips``: inverted bits
    by octet number (see :mod:`dpstack.sim.uart`). ``lost``: not on the wire at all. ``whole``: intact so far for
    everybody at its rate. ``heard_ns``: when the last octet of it that could be read was over.
    """

    __slots__ = (
        "baud",
        "collided",
        "cut",
        "end_ns",
        "flips",
        "forced",
        "heard_ns",
        "lost",
        "node",
        "notes",
        "octets",
        "sender",
        "start_ns",
        "telegram",
        "whole",
    )

    def __init__(self, node: Node | None, sender: str, octets: bytes, baud: int, start_ns: int, end_ns: int) -> None:
        self.node = node
        self.sender = sender
        self.octets = octets
        self.baud = baud
        self.start_ns = start_ns
        self.end_ns = self.heard_ns = end_ns
        self.telegram: Telegram | None = _decode(octets)
        self.flips: dict[int, int] = {}
        self.notes: list[str] = []
        self.forced = node is None
        self.whole = self.lost = self.collided = self.cut = False
