"""What the plan of a bus takes from the configuration beside the slaves, and what keeps a bus from being opened."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from dpstack.api.config import Config, rate_findings
from dpstack.dp.plan import OtherMasters, Plan, t_tr_preset
from dpstack.dp.plan_cycle import Verdict, judge_cycle, slowest_rates
from dpstack.dp.rotations import Figures, figures
from dpstack.dp.setup import SlaveSetup
from dpstack.errors import ConfigError
from dpstack.params import BusParams
from dpstack.units import BAUD_RATES, NS_PER_MS, NS_PER_S, baud_text


def other_masters(config: Config, baud: int) -> OtherMasters:
    """``other_masters`` at ``baud``. What they need in ms they need at the bus's own rate: in bit times it is the same
    at every rate.
    """
    given = config.bus.other_masters
    if isinstance(given, int):
        return OtherMasters(alike=given)
    own = config.bus.baud if isinstance(config.bus.baud, int) else baud
    return OtherMasters(rounds=tuple(-(-round(ms * NS_PER_MS) * own // NS_PER_S) for ms in given))


def with_t_tr(config: Config, params: BusParams, setups: Sequence[SlaveSetup]) -> BusParams:
    """``params`` with T_TR enough for the longest normal round of all masters, unless the configuration fixes it."""
    if config.bus.t_tr is not None:
        return params
    return params.replace(t_tr=t_tr_preset(params, setups, other_masters(config, params.baud)))


def cycle_rates(config: Config, cycle_ns: int) -> dict[Verdict, int | None]:
    """The slowest baud rate, of those that all slaves know, at which ``cycle_ns`` is judged so or better."""
    return slowest_rates(_at_rates(config), cycle_ns)


def _at_rates(config: Config) -> Iterable[Figures]:
    for rate in BAUD_RATES:
        if rate_findings(config, rate):
            continue
        try:
            params, setups = config.params(rate), config.setups(rate)
        except ConfigError:
            continue  # its parameters are for another rate
        yield figures(params, setups, others=other_masters(config, rate))


def refuse_misfit(config: Config, plan: Plan, setups: Sequence[SlaveSetup]) -> None:
    """Refuse ``setups`` that the cycle of ``plan`` cannot have. Raises ConfigError, one line."""
    cycle_ns = config.bus.cycle_ns
    if not cycle_ns:
        return
    refusals = judge_cycle(figures(plan.params, setups, others=plan.figures.others, cycle_ns=cycle_ns)).refusals
    if not refusals:
        return
    what, todo, address = refusals[0]
    if address is None:
        faster = cycle_rates(config, cycle_ns)[Verdict.POSSIBLE]
        hint = f" ({baud_text(faster)} would do)" if faster is not None and faster > plan.params.baud else ""
        raise config.source.error(("bus", "cycle_ms"), f"[bus]: {what}", f"{todo}{hint}")
    numbers = {slave.address: number for number, slave in enumerate(config.slaves)}
    path = ("slave", numbers[address]) if address in numbers else ("bus", "cycle_ms")
    raise config.source.error(path, what, todo)


__all__ = ["Verdict", "cycle_rates", "other_masters", "refuse_misfit", "with_t_tr"]
