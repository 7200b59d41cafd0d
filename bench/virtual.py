"""Virtual time: seconds of the simulated bus per second of CPU time.

Ten PPO1 drives (plugin at the master, simulated drive at the other end, running) at 500 kbit/s are the measure; then
mirrors, 1 to 100 of them: a telegram must cost the same however many slaves there are. The referee watches in all runs.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import Final

from bench.report import Report
from dpstack.dp.commands import DriveCommand, Mode, SetMode
from dpstack.dp.device import Device
from dpstack.dp.events import SlaveState
from dpstack.dp.master import Master
from dpstack.dp.mirror import MirrorDevice
from dpstack.dp.setup import SlaveSetup
from dpstack.dp.slaveapp import make_slave
from dpstack.fdl.active import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams
from dpstack.profile.registry import find as find_drive
from dpstack.sim.world import World
from dpstack.units import NS_PER_MS, NS_PER_S

_PPO1: Final = bytes((0xF3, 0xF1))
_IDENT: Final = 0x1234
_FIRST: Final = 3
_WITHIN: Final = 60 * NS_PER_S
#: simulated seconds per second of CPU time, ten PPO1 drives
_GOAL: Final = 20.0


class Plant:
    """A master with ``slaves`` slaves in data exchange and Operate: mirrors, or drives of ``drive`` that run."""

    def __init__(self, slaves: int, baud: int, drive: str | None = None) -> None:
        self.world = World()
        params = BusParams.preset(baud, address=2)
        addresses = range(_FIRST, _FIRST + slaves)
        profile = None if drive is None else find_drive(drive)
        spec = None if profile is None else profile.telegram("PPO1")
        config, ident = (_PPO1, _IDENT) if profile is None or spec is None else (spec.config, profile.ident)
        user_prm = b"" if profile is None else profile.user_prm
        for address in addresses:
            device: Device = MirrorDevice(_IDENT, _PPO1) if profile is None else profile.device("PPO1")
            self.world.add(make_slave(address, device, params))
        self.master = Master(
            params,
            [SlaveSetup(address=a, name=f"s{a}", ident=ident, config=config, user_prm=user_prm) for a in addresses],
            watchdog_ms=2_000,
        )
        station = ActiveStation(params, [self.master])
        self.world.add(station)
        if profile is not None:
            for address, image in self.master.images.items():
                image.unit = profile.core(f"s{address}", "PPO1", simulated=True)
        self.world.command(station, GoOnline())
        self.world.command(station, SetMode(Mode.OPERATE))
        handlers = self.master.handlers.values()
        while not all(h.state is SlaveState.DATA_EXCHANGE for h in handlers):
            self.world.run_for(10 * NS_PER_MS)
            if self.world.now > _WITHIN:
                raise RuntimeError("not every slave came into data exchange")
        if profile is not None:
            for token, address in enumerate(addresses):
                self.world.command(station, DriveCommand(address, "start", {}, 2 * token + 1))
                self.world.command(station, DriveCommand(address, "speed", {"value": 0.5}, 2 * token + 2))
        self.world.run_for(NS_PER_S)

    @property
    def exchanges(self) -> int:
        """Data_Exchange answered since the beginning."""
        return sum(handler.exchanges for handler in self.master.handlers.values())

    def measure(self, ns: int) -> float:
        """Run for ``ns``; the CPU time in ns."""
        begin = time.process_time_ns()
        self.world.run_for(ns)
        return time.process_time_ns() - begin


def run(argv: Sequence[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench virtual")
    parser.add_argument("--drives", type=int, default=10)
    parser.add_argument("--drive", default="demag-dedrive", help="a drive with PPO1")
    parser.add_argument("--slaves", type=int, nargs="*", default=[1, 3, 10, 32, 100], help="how many mirrors")
    parser.add_argument("--baud", type=int, default=500_000)
    parser.add_argument("--rounds", type=int, default=7, help="interleaved; the best of each is reported")
    parser.add_argument("--ms", type=int, default=250, help="simulated time of a round")
    args = parser.parse_args(argv)
    report = Report("virtual")
    drives = f"{args.drives} {args.drive}, PPO1"
    plants = {drives: Plant(args.drives, args.baud, args.drive)}
    portion = args.ms * NS_PER_MS
    counts = sorted(set(args.slaves))
    plants |= {_title(n): Plant(n, args.baud) for n in counts}
    best: dict[str, tuple[float, float]] = {}
    for _ in range(args.rounds):
        for title, plant in plants.items():
            before = plant.exchanges
            cpu = plant.measure(portion)
            per_exchange = cpu / max(1, plant.exchanges - before)
            known = best.get(title)
            best[title] = (cpu, per_exchange) if known is None else (min(cpu, known[0]), min(per_exchange, known[1]))
    for plant in plants.values():
        if plant.world.referee is not None:
            plant.world.referee.check()
    for title, (cpu, per_exchange) in best.items():
        report.add(f"{title}: simulated seconds per second of CPU", portion / cpu, "s/s")
        report.add(f"{title}: CPU per exchange, both ends and the wire", per_exchange / 1000, "us")
    report.add(f"CPU per simulated second, {drives}", best[drives][0] / portion, "s/s", 1 / _GOAL)
    if len(counts) > 1:
        few, many = best[_title(counts[0])][1], best[_title(counts[-1])][1]
        report.add(f"CPU per exchange, {counts[-1]} mirrors to {counts[0]}", many / few, "", 1.0)
    return report


def _title(mirrors: int) -> str:
    return f"{mirrors} mirror{'s' if mirrors > 1 else ''}"
