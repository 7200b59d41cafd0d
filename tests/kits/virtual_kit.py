"""The loop of the virtual time a test runs in."""

from __future__ import annotations

import asyncio

from dpstack.drivers.virtual.loop import VirtualLoop
from dpstack.sim.world import World


def here() -> VirtualLoop:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    return loop


def attach(world: World) -> World:
    here().attach(world)
    return world
