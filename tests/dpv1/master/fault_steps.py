"""Steps of tests that let anything happen on a simulated bus: what is done to its wire and to the master's port."""

from __future__ import annotations

from collections.abc import Callable

from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.machine import LineDown, LineUp
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World

MS = 1_000_000


def fault_step(
    world: World, station: ActiveStation, what: str, number: int, mine: Callable[[Transmission], bool]
) -> None:
    """``what`` for ``number`` telegrams (``mine``: those that the test is about), or for so long."""
    match what:
        case "lose":
            world.faults.drop(mine, times=number)
        case "damage":
            world.faults.damage(mine, times=number)
        case "lose all":
            world.faults.drop(lambda sent: len(sent.octets) > 3, times=number)
        case "noise":
            world.faults.noise(number * 1e-4)
        case "quiet":
            world.faults.noise(0)
        case "line":
            world.command(station, LineDown("out"))
            world.command(station, LineUp())
        case "off":
            world.command(station, GoOffline())
            world.run_for(number * 20 * MS)
            world.command(station, GoOnline())
        case _:
            raise AssertionError(f"no step is called {what}")
