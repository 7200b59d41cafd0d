"""Inputs of the plan from the configuration (other masters, T_TR, adapter), and the refusal of impossible cycles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from dpstack.api.config.config import Config, rate_findings
from dpstack.api.config.slave import SlaveConfig
from dpstack.dp.pdu.dpv1_status import PRM_STRUCTURE
from dpstack.dp.plan.cycle_check import CycleVerdict, judge_cycle, slowest_rates
from dpstack.dp.plan.plan import Plan, make_plan
from dpstack.dp.plan.rotation_time import Case, Figures, OtherMasters, rotation
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import ConfigError
from dpstack.params import DPV1_STATUS_LEN, BusParams
from dpstack.phy.patience import Patience
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


def isochronous_notes(config: Config, patience: Patience | None) -> Iterator[str]:
    """A note for each slave that demands isochronous mode. ``patience``: that of the port, None: no real port."""
    figure = "a figure of the port is not known here"
    if patience is not None:
        late = ms_text(patience.unknown_ns + patience.sending_ns)
        figure = f"this port counts as {late} late until a bus that runs has measured it"
    for slave in config.slaves:
        demand = slave.params.isochronous
        if demand is not None:
            yield (
                f"slave {slave.address} ({slave.name}): it demands isochronous mode ({demand.why}): its clock telegram "
                f"may be {demand.window_us:g} us off (T_PLL_W), which no port of a computer keeps; {figure}. Its "
                "bring-up is refused with the figure that is measured then"
            )


def clock_notes(config: Config) -> Iterator[str]:
    """A note for each slave that the interval of the time on the bus does not suit."""
    sent_s = config.bus.clock_sync_s
    for slave in config.slaves:
        for note in (_monitored(slave, sent_s), _wanted(slave, sent_s)):
            if note:
                yield f"slave {slave.address} ({slave.name}): {note}"


def _monitored(slave: SlaveConfig, sent_s: float | None) -> str:
    """About the monitoring time of the clock in its Set_Prm, a block of type 8."""
    octets = slave.params.user_octets(None)
    if len(octets) < DPV1_STATUS_LEN or not octets[2] & PRM_STRUCTURE:
        return ""
    from dpstack.dp.pdu.prm_checks import clock_interval_s  # here, as few slaves have structured parameters

    interval_s = clock_interval_s(octets)
    if not interval_s:
        return ""
    block = f"its Set_Prm (block of type 8, time_ar) expects the time every {interval_s:g} s"
    if sent_s is None:
        give = f"give clock_sync_s = {_interval_for(interval_s):g} in [bus], or let another master send it"
        return f"{block}, and this master sends none: {give}"
    if sent_s > interval_s:
        return (
            f"{block}, and clock_sync_s = {sent_s:g} is longer: its clock counts as lost in between; give "
            f"clock_sync_s = {_interval_for(interval_s):g}, or clock_sync_interval = {round(sent_s * 100)} in its block"
        )
    return ""


def _interval_for(interval_s: float) -> float:
    """The longest interval up to ``interval_s`` that all known devices accept; 1 s at least."""
    return max((one for one in _GOOD_INTERVALS if one <= interval_s), default=1.0)


def _wanted(slave: SlaveConfig, sent_s: float | None) -> str:
    """About the intervals that the device accepts, as far as its manual is known."""
    if sent_s is None or slave.device is None:
        return ""
    words = f"{slave.device.vendor} {slave.device.model}".upper()
    for name, ranges, source in _CLOCK_DEVICES:
        if name in words and not any(low <= sent_s <= high for low, high in ranges):
            accepted = ", ".join(f"{low:g}" if low == high else f"{low:g} to {high:g}" for low, high in ranges)
            return f"clock_sync_s = {sent_s:g}, and it accepts the time every {accepted} s ({source})"
    return ""


#: intervals in s that suit all known devices
_GOOD_INTERVALS: Final = (1.0, 10.0, 60.0)
#: a word in vendor or model of the GSD file (no public source has the ident numbers), the intervals that the device
#: accepts in s, the source
_CLOCK_DEVICES: Final = (
    ("AUMA", ((1, 1), (10, 10), (60, 60), (600, 600)), "AUMA AC 01.2 manual, p48"),
    (
        "SIPROTEC",
        ((1, 15), (17, 20), (26, 30), (50.05, 61.95)),
        "SIPROTEC profile C53000-L1840-B001-03, p76; before firmware 03.01.03 only 50.05 to 61.95",
    ),
)


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
