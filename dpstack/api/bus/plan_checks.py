"""Inputs of the plan from the configuration (other masters, T_TR, adapter), and the refusal of impossible cycles."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from dpstack.api.config.config import Config, rate_findings
from dpstack.api.config.slave import SlaveConfig
from dpstack.dp.plan.cycle_check import CycleVerdict, judge_cycle, slowest_rates
from dpstack.dp.plan.plan import Plan, make_plan
from dpstack.dp.plan.rotation_time import Case, Figures, OtherMasters, rotation
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import ConfigError
from dpstack.params import BusParams
from dpstack.units import BAUD_RATES, NS_PER_MS, NS_PER_S, baud_text, ms_text

__all__ = ["CycleVerdict"]  # for the command line

#: time (ns) of an exchange and of the token over an adapter with a latency timer of 1 ms
#: (docs/reference/bus-parameters.md)
_ADAPTER_EXCHANGE: Final = 2 * NS_PER_MS
_ADAPTER_TOKEN: Final = NS_PER_MS


def other_masters(config: Config, baud: int) -> OtherMasters:
    """``other_masters`` of the configuration at ``baud``. Its times in ms are for the bus's own rate; at another rate
    the other masters need as many bit times.
    """
    given = config.bus.other_masters
    if isinstance(given, int):
        return OtherMasters(alike=given)
    own = config.bus.baud if isinstance(config.bus.baud, int) else baud
    return OtherMasters(rounds=tuple(-(-round(ms * NS_PER_MS) * own // NS_PER_S) for ms in given))


def with_t_tr(config: Config, params: BusParams, setups: Sequence[SlaveParams]) -> BusParams:
    """``params`` with T_TR long enough for a normal round of all masters, or with T_TR of the configuration."""
    if config.bus.t_tr is not None:
        return params
    return params.replace(t_tr=Figures(params, setups, other_masters(config, params.baud)).t_tr_preset)


def data_control_ns(config: Config) -> int:
    """The Data_Control_Time of a bus with auto-clear, else 0."""
    return config.bus.data_control_time_ms * NS_PER_MS if config.bus.auto_clear else 0


def new_plan_texts(config: Config, plan: Plan, setups: Sequence[SlaveParams], added: SlaveParams) -> list[str]:
    """New findings and notes of the plan for a running bus when ``added`` joins ``setups``."""

    def texts(slaves: Sequence[SlaveParams]) -> tuple[str, ...]:
        now = make_plan(
            plan.params,
            slaves,
            others=plan.figures.others,
            cycle_ns=config.bus.cycle_ns,
            host_slack_ns=plan.figures.host_slack_ns,
            data_control_ns=data_control_ns(config),
            watchdog_ms=plan.watchdog_ms,
        )
        return (*now.findings, *now.notes)

    known = set(texts(setups))
    return [text for text in texts([*setups, added]) if text not in known]


def cycle_rates(config: Config, cycle_ns: int) -> dict[CycleVerdict, int | None]:
    """For each verdict the slowest baud rate, known by all slaves, at which ``cycle_ns`` gets it or a better one."""
    return slowest_rates(_at_rates(config), cycle_ns)


def _at_rates(config: Config) -> Iterable[Figures]:
    for rate in BAUD_RATES:
        if rate_findings(config, rate):
            continue
        try:
            params, setups = config.params(rate), config.slave_params
        except ConfigError:
            continue  # the bus parameters of the file are for another rate
        yield Figures(params, setups, other_masters(config, rate))


def adapter_notes(config: Config, params: BusParams, setups: Sequence[SlaveParams]) -> list[str]:
    """A note if the fixed cycle is shorter than a round over a USB adapter usually takes."""
    slaves = len(rotation(params, setups, Case.SHORTEST).together)
    round_ns = slaves * _ADAPTER_EXCHANGE + _ADAPTER_TOKEN
    if not config.bus.cycle_ns or round_ns <= config.bus.cycle_ns:
        return []
    return [
        f"over a USB adapter with a latency timer of 1 ms an exchange takes {ms_text(_ADAPTER_EXCHANGE)} or so at any "
        f"rate, a round of {slaves} slave{'s' * (slaves != 1)} {ms_text(round_ns)}: longer than "
        f"cycle_ms = {config.bus.cycle_ms:g}; a UART of the computer's own has no such delay"
    ]


def refuse_forbidden(config: Config, slaves: Iterable[SlaveConfig]) -> None:
    """Raises ConfigError, one line, if one of ``slaves`` must not have this master (key ``refuse_master``). A bus that
    is read only is no slave's master."""
    forbidden = [slave for slave in slaves if slave.refuse_master and not config.bus.read_only]
    if forbidden:
        first, more = forbidden[0], len(forbidden) - 1
        also = f" (and {more} more slave{'s' * (more > 1)})" if more else ""
        raise ConfigError(  # without a line: the configuration may have been cut down to this slave
            f"{config.source.name}: slave {first.address} ({first.name}){also} must not be brought up by dpstack: "
            f"{first.refuse_master}; listen (monitor), look with read_only = true, or simulate it (sim); to run the "
            f"others, take it out"
        )


def refuse_misfit(config: Config, plan: Plan, setups: Sequence[SlaveParams]) -> None:
    """Raises ConfigError, one line, if the fixed cycle of ``plan`` is impossible with ``setups``."""
    cycle_ns = config.bus.cycle_ns
    if not cycle_ns:
        return
    refusals = judge_cycle(Figures(plan.params, setups, plan.figures.others, cycle_ns)).refusals
    if not refusals:
        return
    first = refusals[0]
    what, todo, address = first.what, first.todo, first.slave
    if address is None:
        faster = cycle_rates(config, cycle_ns)[CycleVerdict.POSSIBLE]
        hint = f" ({baud_text(faster)} would do)" if faster is not None and faster > plan.params.baud else ""
        raise config.source.error(("bus", "cycle_ms"), f"[bus]: {what}", f"{todo}{hint}")
    numbers = {slave.address: number for number, slave in enumerate(config.slaves)}
    path = ("slave", numbers[address]) if address in numbers else ("bus", "cycle_ms")
    raise config.source.error(path, what, todo)
