"""Virtual time: the CPU time of an exchange and of a second of the simulated bus, in Python loops.

Ten PPO1 drives (plugin at the master, simulated drive at the other end) at 500 kbit/s are the measure, standing and
running; then mirrors, 1 to 100 of them: a telegram must cost the same however many slaves there are. With a
Global_Control (SYNC and FREEZE) in each round an exchange must cost hardly more where it is for all of the slaves than
where it is for one of them. The referee watches in all runs.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from functools import partial
from typing import Final

from bench.calibration import Beside
from bench.options import count, slaves
from bench.report import Report
from dpstack.devices.finding import find as find_drive
from dpstack.dp.master.commands import DriveCommand, Mode, SendControl, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams
from dpstack.profile.master.core import DriveCore
from dpstack.profile.model.states import State
from dpstack.sim.world import World
from dpstack.units import NS_PER_MS, NS_PER_S

_PPO1: Final = bytes((0xF3, 0xF1))
#: options of a plugin without which the start of its drive is refused
_OPTIONS: Final = {"demag-dedrive": {"set_412": True}}
_IDENT: Final = 0x1234
_FIRST: Final = 3
_WITHIN: Final = 60 * NS_PER_S
#: time for drives to start, to have their settings read and to reach the speed; then 412 is not being read
_SETTLE: Final = 9 * NS_PER_S // 2
#: CPU time of a simulated second of ten PPO1 drives, in Python loops
_GOAL: Final = 65_000
#: no worse than linear: an exchange costs no more with many slaves than with few
_LINEAR: Final = 1.0
#: an exchange with a Global_Control to all slaves in each round, to one with a Global_Control to one slave
_BROADCAST: Final = 1.2
#: groups of the slaves that a Global_Control of the benchmark is for, and of the others
_MEMBERS, _OTHERS = (1,), (2,)


class Plant:
    """A master with ``slaves`` slaves in data exchange and Operate: mirrors, or drives of ``drive``.

    ``running`` False: the drives stand, as their factory settings refuse control by the bus.

    ``members``: the number of mirrors that each Global_Control of :meth:`measure_rounds` is for, from the first on.
    """

    def __init__(
        self, slaves: int, baud: int, drive: str | None = None, *, members: int = 0, running: bool = True
    ) -> None:
        self.world = World()
        self._slaves = slaves
        self._orders = 0
        params = BusParams.preset(baud, address=2)
        addresses = range(_FIRST, _FIRST + slaves)
        profile = None if drive is None else find_drive(drive)
        spec = None if profile is None else profile.telegram("PPO1")
        config, ident = (_PPO1, _IDENT) if profile is None or spec is None else (spec.config, profile.ident)
        user_prm = b"" if profile is None else profile.user_prm
        for address in addresses:
            device: Device = MirrorDevice(_IDENT, _PPO1) if profile is None else profile.simulated("PPO1", {}, {})
            device.sync_supported = device.freeze_supported = members > 0
            self.world.add(PassiveStation(address, SlaveApp(device, address=address), params))
        self.master = Master(
            params,
            [
                SlaveParams(
                    address=a,
                    name=f"s{a}",
                    ident=ident,
                    config=config,
                    user_prm=user_prm,
                    sync=members > 0,
                    freeze=members > 0,
                    groups=_MEMBERS if a < _FIRST + members else _OTHERS,
                )
                for a in addresses
            ],
            MasterSettings(watchdog_ms=2_000),
        )
        self._station = station = ActiveStation(params, [self.master])
        self.world.add(station)
        #: the plugins at the master; none for mirrors
        self.drives: list[DriveCore] = []
        if profile is not None:
            for address, image in self.master.images.items():
                options = _OPTIONS.get(profile.name) if running else None
                image.plugin = core = profile.core(f"s{address}", "PPO1", options, simulated=True)
                self.drives.append(core)
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
        self.world.run_for(_SETTLE if self.drives and running else NS_PER_S)
        if running and (standing := [core.name for core in self.drives if core.state is not State.RUNNING]):
            raise RuntimeError(f"not every drive runs: {', '.join(standing)} do not")

    @property
    def exchanges(self) -> int:
        """Data_Exchange answered since the beginning."""
        return sum(handler.exchanges for handler in self.master.handlers.values())

    def measure(self, ns: int) -> float:
        """Run for ``ns``; the CPU time in ns."""
        begin = time.process_time_ns()
        self.world.run_for(ns)
        return max(1, time.process_time_ns() - begin)

    def measure_rounds(self, rounds: int) -> float:
        """Run for the time of so many rounds, each with a Global_Control to its members; the CPU time in ns."""
        begin = time.process_time_ns()
        self.run_rounds(rounds)
        return max(1, time.process_time_ns() - begin)

    def run_rounds(self, rounds: int) -> None:
        """Run for the time of so many rounds, each with a Global_Control to its members."""
        round_ns = self.world.now * self._slaves // self.exchanges  # longer than one: there was a bring-up
        for _ in range(rounds):
            self._orders += 1
            self.world.command(self._station, SendControl(self._orders, _MEMBERS, sync=True, freeze=True))
            self.world.run_for(round_ns)


def run(argv: Sequence[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench virtual")
    parser.add_argument("--drives", type=int, default=10)
    parser.add_argument("--drive", default="demag-dedrive", help="a drive with PPO1")
    parser.add_argument("--slaves", type=slaves, nargs="*", default=[1, 3, 10, 32, 100], help="how many mirrors")
    parser.add_argument("--baud", type=int, default=500_000)
    parser.add_argument("--rounds", type=count, default=7, help="interleaved")
    parser.add_argument("--ms", type=int, default=250, help="simulated time of a round")
    args = parser.parse_args(argv)
    report = Report("virtual")
    drives = f"{args.drives} {args.drive}, PPO1"
    runs = f"{drives}, running"
    plants = {
        drives: Plant(args.drives, args.baud, args.drive, running=False),  # as older commits measure them
        runs: Plant(args.drives, args.baud, args.drive),
    }
    portion = args.ms * NS_PER_MS
    counts = sorted(set(args.slaves))
    plants |= {_title(n): Plant(n, args.baud) for n in counts}
    seconds: dict[str, list[tuple[float, float]]] = {title: [] for title in plants}
    costs: dict[str, list[tuple[float, float]]] = {title: [] for title in plants}
    beside = Beside()
    for _ in range(args.rounds):
        for title, plant in plants.items():
            before = plant.exchanges
            cpu, loop = beside(partial(plant.measure, portion))
            seconds[title].append((cpu * NS_PER_S / portion, loop))
            costs[title].append((cpu / max(1, plant.exchanges - before), loop))
    report.calibrated("Python", beside.loops)
    for title, plant in plants.items():
        if plant.world.referee is not None:
            plant.world.referee.check()
        goal = _GOAL if title in (drives, runs) else None
        report.in_loops(f"{title}: CPU time of a simulated second", seconds[title], goal)
        report.in_loops(f"{title}: CPU per exchange, both ends and the wire", costs[title])
    if len(counts) > 1:
        few, many = ([cpu / loop for cpu, loop in costs[_title(n)]] for n in (counts[0], counts[-1]))
        name = f"CPU per exchange, {counts[-1]} mirrors to {counts[0]}"
        report.measured(name, [a / b for a, b in zip(many, few, strict=True)], "", _LINEAR)
    _measure_global_control(report, counts[-1], args.baud, args.rounds)
    return report


def _measure_global_control(report: Report, slaves: int, baud: int, rounds: int) -> None:
    """An exchange among ``slaves`` mirrors with a Global_Control in each round: to all of them, and to one."""
    plants = [Plant(slaves, baud, members=members) for members in (slaves, 1)]
    costs: list[list[float]] = [[], []]
    beside = Beside()
    for _ in range(rounds):
        for plant, found in zip(plants, costs, strict=True):
            before = plant.exchanges
            cpu, loop = beside(partial(plant.measure_rounds, 3))
            found.append(cpu / loop / max(1, plant.exchanges - before))
    name = f"CPU per exchange with a Global_Control in each round, to {slaves} mirrors to that to 1"
    report.measured(name, [a / b for a, b in zip(*costs, strict=True)], "", _BROADCAST)


def _title(mirrors: int) -> str:
    return f"{mirrors} mirror{'s' if mirrors > 1 else ''}"
