"""The standard nodes of OPC UA (Part 5) that a plant needs, from a file of the package.

asyncua makes all of its 6200 nodes by functions of 270 000 lines, which take most of the time and of the memory that a
server begins with. ``standard_nodes.bin`` (tools/make_opcua_nodes.py) has 1200 of them in the encoding of OPC UA, which
runs no code when it is read, and which no other user can write.
"""

from __future__ import annotations

import asyncio
import gc
import struct
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import struct_from_binary

FILE: Final = Path(__file__).with_name("standard_nodes.bin")
#: before the nodes, and before the references
COUNT: Final = struct.Struct("<I")
#: nodes that are added before others have their turn
_AT_ONCE: Final = 50


async def add_standard_nodes(service: Any) -> None:
    """Add them by the NodeManagementService of a server. Others have their turn every few milliseconds."""
    collects = gc.isenabled()
    gc.disable()  # the nodes stay: to look for garbage among them takes half of this time
    try:
        await _add_nodes(service)
    finally:
        if collects:
            gc.enable()


async def _add_nodes(service: Any) -> None:
    octets = Buffer(zlib.decompress(FILE.read_bytes()))

    async def add(kind: type, add_items: Callable[[list[Any]], Iterable[Any]]) -> None:
        (left,) = COUNT.unpack(octets.read(COUNT.size))
        while left:
            count = min(left, _AT_ONCE)
            tuple(add_items([struct_from_binary(kind, octets) for _ in range(count)]))
            left -= count
            await asyncio.sleep(0)

    await add(ua.AddNodesItem, lambda nodes: service.try_add_nodes(nodes, check=False))
    await add(ua.AddReferencesItem, service.try_add_references)
