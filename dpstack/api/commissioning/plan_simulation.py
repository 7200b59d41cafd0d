"""``dpstack plan --simulate``: the configured plant runs in virtual time, and its rotation times are measured."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Final

from msgspec import Struct, field, structs

from dpstack.api.bus.bus import core_of
from dpstack.api.bus.opening import open_bus
from dpstack.api.config.config import Config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave.slave import Slave
from dpstack.api.slave_side.virtual_bench import VirtualBench
from dpstack.dp.master.fixed_cycle import CycleStats
from dpstack.dp.plan.plan import Plan
from dpstack.dp.plan.rotation_time import TYPICAL_TSDR, Case, tsdr_bits
from dpstack.drivers.snapshots import Counters
from dpstack.errors import AcyclicError, DpError
from dpstack.sim.world import World
from dpstack.stats import Histogram
from dpstack.units import NS_PER_US, ns_to_s

__all__ = ["CycleStats"]  # for the command line

#: the measurement begins without the slaves that are missing when none has come up for this many s of bus time, and for
#: this many of the longest rotations
_QUIET_S: Final = 2.0
_QUIET_ROTATIONS: Final = 5
#: a DP-V1 slave is asked for one record in this many s
_SERVICE_EVERY_S: Final = 1.0
#: slot and index of the record: I&M0
_RECORD: Final = (0, 255)
#: bus time in s between two calls of ``on_progress``
_STEP_S: Final = 0.5
_POINTS: Final = {"p50": 0.5, "p99": 0.99}


class Services(Struct):
    """The reads of records beside the cycle: ``took`` from the order to the answer, ``refused`` of them with a negative
    one, as the device has no such record; ``failed``: those without an answer."""

    took: Histogram = field(default_factory=Histogram)
    refused: int = 0
    failed: int = 0


class SimulatedPlan(Struct, frozen=True, kw_only=True):
    """The measured bus of one plan. ``ns``: bus time; ``missing``: the slaves that are not in data exchange, in words.

    ``cycles``: of the fixed cycle, None free running. ``services``: None without a DP-V1 slave.
    """

    ns: int
    rotation: Histogram
    cycles: CycleStats | None
    services: Services | None
    gap_polls: int
    missing: tuple[str, ...]
    limits: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        """The key ``simulated`` of ``dpstack plan --simulate --json``."""
        found: dict[str, object] = {
            "seconds": round(ns_to_s(self.ns), 3),
            "rotations": self.rotation.count,
            "rotation_us": distribution_us(self.rotation),
            "gap_polls": self.gap_polls,
            "missing": list(self.missing),
            "limits": list(self.limits),
        }
        if self.cycles is not None:
            found["cycle"] = {
                "cycles": self.cycles.begun,
                "late_us": distribution_us(self.cycles.late),
                "missed": self.cycles.missed,
                "left_out": self.cycles.left_out,
                "missed_by": {reason.value: count for reason, count in self.cycles.reasons.items()},
            }
        if self.services is not None:
            found["services"] = {
                "done": self.services.took.count,
                "refused": self.services.refused,
                "failed": self.services.failed,
                "took_us": distribution_us(self.services.took),
            }
        return found


def _without_refusal(slave: SlaveConfig) -> SlaveConfig:
    params = structs.replace(slave.params, isochronous=None)
    return structs.replace(slave, refuse_master="", params=params)


def distribution_us(durations: Histogram) -> dict[str, float | None]:
    """``min``, ``p50``, ``p99`` and ``max`` in microseconds; null without any. Quantiles are to 0.4 %."""
    ends = {"min": durations.min_ns, **{name: durations.quantile_ns(q) for name, q in _POINTS.items()}}
    ends["max"] = durations.max_ns
    return {name: round(ns / NS_PER_US, 1) if durations.count else None for name, ns in ends.items()}


class PlanSimulation:
    """The plant of ``plan`` in virtual time: all slaves of ``config`` with their devices, and the master in Operate.

    Slaves answer after the T_SDR of the typical rotation. :meth:`run` may be cancelled; :meth:`result` has what was
    measured until then. Raises ConfigError if the bus cannot be opened.
    """

    def __init__(self, config: Config, plan: Plan) -> None:
        self._plan = plan
        made = config.with_bus(
            port="virtual", baud=plan.params.baud, driver="auto", read_only=False, application_watchdog_ms=0
        )
        # a simulated master of simulated slaves endangers nobody, and the rotation is the same without their demands
        made = dataclasses.replace(made, slaves=tuple(map(_without_refusal, made.slaves)))
        world = World(referee=False)
        bench = VirtualBench(world, plan.params)
        for slave in made.slaves:
            bench.add(slave, t_sdr=tsdr_bits(plan.params, slave.params, Case.TYPICAL))
        for cpu in made.ppi:
            bench.add_cpu(cpu)
        self._bus = open_bus(made, world=world)
        self._core = core_of(self._bus)
        self._rotation = Histogram()
        self._late = Histogram()
        self._last_ns: int | None = None  # first bit of the round before
        self._begun: tuple[int, Counters] | None = None  # of the measurement
        self._services = Services() if any(slave.params.dpv1 for slave in made.slaves) else None
        self._result: SimulatedPlan | None = None

    async def run(self, seconds: float, on_progress: Callable[[float], None]) -> None:
        """Bring the bus up and measure for ``seconds`` of bus time, of which ``on_progress`` gets those that are over.
        Needs a loop in virtual time."""
        async with self._bus:
            await self._bring_up()
            self._begun = self._core.runtime.now(), self._counters()
            readers = [
                asyncio.ensure_future(self._read_records(slave, number))
                for number, slave in enumerate(slave for slave in self._bus.slaves if slave.config.params.dpv1)
            ]
            try:
                with self._core.rounds.watched(self._on_round):
                    await self._wait(seconds, on_progress)
            finally:
                for reader in readers:
                    reader.cancel()
                self._result = self._measured()

    def result(self) -> SimulatedPlan | None:
        """The measured figures; None if it ended before the measurement began."""
        return self._result

    async def _bring_up(self) -> None:
        """Order Operate and wait until all slaves are in data exchange, or no more of them come."""
        await self._bus.operate()
        quiet_s = max(_QUIET_S, _QUIET_ROTATIONS * self._core.rotation_limit_s)
        with contextlib.suppress(TimeoutError):
            while missing := self._missing():
                await self._bus.until(partial(self._are_fewer_than, missing), quiet_s)

    def _missing(self) -> int:
        return sum(not slave.ready_now for slave in self._bus.slaves)

    def _are_fewer_than(self, missing: int) -> bool:
        return self._missing() < missing

    async def _wait(self, seconds: float, on_progress: Callable[[float], None]) -> None:
        done = 0.0
        while done < seconds:
            on_progress(done)
            step = min(_STEP_S, seconds - done)
            await asyncio.sleep(step)
            done += step

    def _on_round(self) -> None:
        cycle = self._core.view.cycle
        if cycle is None or cycle.t_ns == self._last_ns:  # the round had no slave in turn
            return
        if self._last_ns is not None:
            self._rotation.add(cycle.t_ns - self._last_ns)
        self._late.add(cycle.late_ns)
        self._last_ns = cycle.t_ns

    async def _read_records(self, slave: Slave, number: int) -> None:
        """One read a second; the slaves take turns, so that their reads do not wait for each other."""
        assert self._services is not None
        await asyncio.sleep(_SERVICE_EVERY_S * (number * 0.618 % 1))
        while True:
            begin = self._core.runtime.now()
            try:
                await slave.read(*_RECORD)
            except AcyclicError:  # a negative answer
                self._services.refused += 1
                self._services.took.add(self._core.runtime.now() - begin)
            except DpError:
                self._services.failed += 1
            else:
                self._services.took.add(self._core.runtime.now() - begin)
            await asyncio.sleep(_SERVICE_EVERY_S)

    def _counters(self) -> Counters:
        return self._core.view.counters()

    def _measured(self) -> SimulatedPlan:
        assert self._begun is not None
        begun_ns, before = self._begun
        after = self._counters()
        cycle_ns = self._plan.figures.cycle_ns
        return SimulatedPlan(
            ns=self._core.runtime.now() - begun_ns,
            rotation=self._rotation,
            cycles=_since(before.cycles, after.cycles, self._late) if cycle_ns else None,
            services=self._services,
            gap_polls=after.link.gap_polls - before.link.gap_polls,
            missing=tuple(
                f"{slave.name} ({slave.address}): {slave.state.value}"
                for slave in self._bus.slaves
                if not slave.ready_now
            ),
            limits=_limits(self._plan),
        )


def _since(before: CycleStats, after: CycleStats, late: Histogram) -> CycleStats:
    """The cycles between two readings of the statistics; ``late``: the delays of these cycles."""
    reasons = {reason: count - before.reasons.get(reason, 0) for reason, count in after.reasons.items()}
    return CycleStats(
        after.cycle_ns,
        begun=after.begun - before.begun,
        begun_late=after.begun_late - before.begun_late,
        left_out=after.left_out - before.left_out,
        late=late,
        reasons={reason: count for reason, count in reasons.items() if count},
    )


def _limits(plan: Plan) -> tuple[str, ...]:
    """The differences between the simulated bus and the real one, a line each."""
    others = plan.figures.others.count
    beside = f"{others} other master{'s' * (others > 1)}: the plan counts their token holds, the simulation does not"
    return (
        "delays of computer, port and adapter: only the wire is simulated",
        f"other T_SDR: each slave answers after {TYPICAL_TSDR} bit times, or the nearest that it allows",
        "disturbances: no telegram is repeated, and no slave is lost",
        "a program: outputs keep their initial values, and no drive is started",
        *([beside] if others else []),
    )
