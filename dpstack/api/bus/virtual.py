"""Programs on simulated buses in virtual time: ``run_virtual``, ``simulate``."""

from __future__ import annotations

from collections.abc import Coroutine, Iterable, Mapping
from typing import TYPE_CHECKING, Literal, TypeVar

from dpstack.api.bus.bus import SlaveTable
from dpstack.api.config.config import AUTO, cpu_configs, slave_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave_side.virtual_bench import VirtualBench
from dpstack.drivers.virtual import loop
from dpstack.errors import UsageError
from dpstack.params import BusParams
from dpstack.sim.io_station.station import IoStation
from dpstack.sim.world import World

if TYPE_CHECKING:
    from dpstack.api.config.cpu import CpuConfig

__all__ = ["IoStation", "World"]  # for the package dpstack and the command line

T = TypeVar("T")


def run_virtual(program: Coroutine[object, object, T], *, paced: bool = False) -> T:
    """Like ``asyncio.run``, but in virtual time: exact, deterministic, and as fast as this computer can. Buses need
    ``port="virtual"``. ``paced``: not faster than real time. Raises UsageError inside a running event loop.
    """
    if not isinstance(program, Coroutine):
        raise UsageError(f"run_virtual({program!r}) takes a coroutine: write run_virtual(main()), with the brackets")
    return loop.run(program, paced=paced)


def simulate(
    world: World,
    slaves: Iterable[SlaveTable],
    *,
    baud: int | Literal["auto"] = AUTO,
    ppi: Iterable[Mapping[str, object] | CpuConfig] = (),
) -> VirtualBench:
    """Put simulated ``slaves`` (mappings with the keys of a [[slave]] table) on the bus of ``world``, and S7-200 CPUs
    (``ppi``: mappings with the keys of an entry of that list; with ``baud`` "auto" they have 9600, as delivered).

    ``baud`` in bit/s, or "auto": the slaves search the rate, and search again when the bus falls silent. Open a master
    on the same bus by ``open_bus(world=world, ...)``. The returned bench sets their inputs, and switches
    them off and on. Raises ConfigError.
    """
    bench = VirtualBench(world, None if baud == AUTO else BusParams.preset(baud))
    for slave in slaves:
        bench.add(slave if isinstance(slave, SlaveConfig) else slave_config(slave))
    for cpu in cpu_configs(ppi, "simulate"):
        bench.add_cpu(cpu)
    return bench
