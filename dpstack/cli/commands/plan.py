"""``dpstack plan``: bus parameters, rotation times and watchdogs of a configuration."""

from __future__ import annotations

import argparse
import contextlib
import shlex
from collections.abc import Callable, Mapping, Sequence
from time import monotonic
from typing import TYPE_CHECKING, Final

from dpstack.api.bus.compose import Case, Plan, plan_bus
from dpstack.api.bus.plan_checks import CycleVerdict, cycle_rates
from dpstack.api.config.config import Config, load_config
from dpstack.cli import options
from dpstack.cli.parser import Parser, lasting
from dpstack.cli.terminal import output
from dpstack.errors import ConfigError, UsageError
from dpstack.units import BAUD_RATES, NS_PER_MS, NS_PER_S, baud_text, ms_text

if TYPE_CHECKING:
    from dpstack.api.commissioning.plan_simulation import CycleStats, SimulatedPlan
    from dpstack.api.ppi.poll_plan import PollPlan

_PROGRESS: Final = "simulated seconds"
#: the slowest baud rate for each verdict on the cycle
Needs = Mapping[CycleVerdict, int | None]
#: seconds of bus time that --simulate runs for by default
_SIMULATED_S: Final = 60.0
#: a simulation that takes longer than this (s) shows its progress on a terminal
_QUICK_S: Final = 1.0
_HOW: Final = {
    CycleVerdict.POSSIBLE: "possible",
    CycleVerdict.TYPICAL: "typically kept",
    CycleVerdict.UNDISTURBED: "kept while nothing is repeated",
    CycleVerdict.ALWAYS: "always kept",
}
_CASES: Final = {Case.SHORTEST: "shortest", Case.TYPICAL: "typical", Case.LONGEST: "longest"}


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack plan plant.toml --baud all --cycle-ms 4"
    parser.value("config", "CONFIG", "configuration file")
    parser.value("--baud", "B|all", "another rate, or all of them", type=options.baud_or("all"))
    parser.value("--cycle-ms", "X", "judge this cycle, and name the rate that it needs", type=options.milliseconds)
    parser.flag("--octets", "the octets of Set_Prm and Chk_Cfg of each slave, as they will be sent")
    parser.value(
        "--simulate",
        "SECONDS",
        "run the plant in virtual time, without a port, and print its rotation times beside the plan; SECONDS of bus "
        f"time (default {_SIMULATED_S:g})",
        nargs="?",
        type=options.seconds,
        const=_SIMULATED_S,
    )
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 when the plan has findings at the baud rate of the configuration."""
    with lasting():
        config = load_config(args.config).with_bus(cycle_ms=args.cycle_ms)
    needs = cycle_rates(config, config.bus.cycle_ns) if config.bus.cycle_ns else {}
    if args.baud == "all":
        if args.simulate is not None:
            raise UsageError("--simulate runs at one rate: give --baud B, or leave --baud all out")
        return _all_rates(config, needs, json=args.json, octets=args.octets)
    plan = plan_bus(config, args.baud or config.baud)
    if args.json:
        data = _with_rates(plan.as_dict(), needs) | _loss_json(config) | _ppi_json(config, plan)
        if args.simulate is not None:
            found = _simulate(config, plan, args.simulate)
            data["simulated"] = None if found is None else found.as_dict()
        output.json_line(data)
    else:
        more = (*_notes_on_ppi(config, plan), *_notes_on_return(config), *_notes_on_loss(config))
        _show(plan, needs, [*more, *_sheet_note(args.config)])
        if args.octets:
            _show_octets(plan)
        if args.simulate is not None:
            _show_simulated(plan, _simulate(config, plan, args.simulate))
    return 1 if plan.findings else 0


def _all_rates(config: Config, needs: Needs, *, json: bool, octets: bool) -> int:
    """One plan for each baud rate, or the reason why the bus parameters are impossible at that rate."""
    plans: dict[int, Plan] = {}
    without: dict[int, ConfigError] = {}
    for rate in BAUD_RATES:
        try:
            plans[rate] = plan_bus(config, rate)
        except ConfigError as error:
            without[rate] = error
    own = config.bus.baud if plans else BAUD_RATES[0]
    if isinstance(own, int) and own in without:
        raise without[own]
    if json:
        nothing: dict[str, object] = {"rotation_us": None, "parameters": None, "slaves": []}
        output.json_line(
            [
                {"baud": rate, **nothing, "findings": [str(without[rate])]}
                if rate in without
                else _with_rates(plans[rate].as_dict(), needs)
                for rate in BAUD_RATES
            ]
        )
    else:
        _show_rates(config, plans)
        for rate, why in without.items():
            output.line(f"{baud_text(rate)}: no plan: {why}")
        _show_needs(needs)
        for rate, plan in plans.items() if octets else ():
            _show_octets(plan, f"{baud_text(rate)}: ")
    return int(any(plan.findings for rate, plan in plans.items() if rate == config.bus.baud))


def _simulate(config: Config, plan: Plan, seconds: float) -> SimulatedPlan | None:
    """The figures measured until the end or until a signal; None if no bus can run by this plan, and if the
    measurement did not begin."""
    if plan.refusals:
        return None
    # here, as the plan itself needs no bus
    from dpstack.api.bus.virtual import run_virtual
    from dpstack.api.commissioning.plan_simulation import PlanSimulation
    from dpstack.cli.terminal.signals import StopSignal

    async def run() -> SimulatedPlan | None:
        simulation = PlanSimulation(config, plan)
        with StopSignal() as stop, contextlib.ExitStack() as stack:
            await stop.or_done(simulation.run(seconds, _Progress(stack, seconds)))
        return simulation.result()

    return run_virtual(run())


class _Progress:
    """Shows the progress of a simulation of ``seconds``, a bar on a terminal, once it has taken a while."""

    def __init__(self, stack: contextlib.ExitStack, seconds: float) -> None:
        self._stack = stack
        self._seconds = seconds
        self._since = monotonic()
        self._show: Callable[[str, int, int], None] | None = None

    def __call__(self, done: float) -> None:
        if self._show is None:
            if monotonic() - self._since < _QUICK_S:
                return
            from dpstack.cli.terminal.drawing import progress_bar

            self._show = self._stack.enter_context(progress_bar(_PROGRESS))
        self._show(_PROGRESS, round(done), round(self._seconds))


def _with_rates(data: dict[str, object], needs: Needs) -> dict[str, object]:
    """The plan with the slowest rate for each verdict on the cycle, null without one."""
    cycle = data.get("cycle")
    if isinstance(cycle, dict):
        cycle["slowest_baud"] = {verdict.value: baud for verdict, baud in needs.items()}
    return data


def _notes_on_return(config: Config) -> list[str]:
    """The slaves with outputs of the application that do not go out again by themselves."""
    return [
        f"{slave.params.who}: after it was away {slave.on_return}"
        for slave in config.slaves
        if slave.params.after_return == "safe" and not slave.has_plugin and slave.on_return
    ]


def _notes_on_loss(config: Config) -> list[str]:
    """What happens when a connector that may give orders is lost."""
    if not config.connectors or config.bus.read_only:
        return []
    from dpstack.api.config.connectors import loss_text, who_may_order  # here, as most configurations have none

    names = who_may_order(config.connectors)
    return [loss_text(names, config.bus.on_connector_loss)] if names else []


def _polls(config: Config, plan: Plan) -> list[PollPlan]:
    if not config.ppi or config.bus.read_only:
        return []
    from dpstack.api.ppi.poll_plan import poll_plan  # here, as most plants have no S7-200

    return [poll_plan(cpu, plan) for cpu in config.ppi]


def _ppi_json(config: Config, plan: Plan) -> dict[str, object]:
    polls = _polls(config, plan)
    return {"ppi": [one.as_dict(plan) for one in polls]} if polls else {}


def _notes_on_ppi(config: Config, plan: Plan) -> list[str]:
    """The requests to each S7-200, and what they cost."""
    notes = []
    for one in _polls(config, plan):
        count, many = len(one.cpu.values), "" if one.requests == 1 else "s"
        takes = ms_text(plan.params.ns(one.longest_bits))
        note = (
            f"{one.cpu.who}: {count} value{'s' * (count != 1)} by {one.requests} request{many} every "
            f"{one.cpu.poll_ms} ms; each takes up to {takes} of a rotation, a repetition as much again, one in a token "
            "hold"
        )
        if not one.fits:
            note += "; they fit between no two cycles: its values will be bad; take a longer cycle_ms or a faster rate"
        notes.append(note)
    return notes


def _sheet_note(path: str) -> list[str]:
    """Where to read what has to be set at the devices."""
    return [f"what to set at each drive and device, faults and LEDs: dpstack sheet {shlex.quote(path)}"]


def _loss_json(config: Config) -> dict[str, object]:
    return {"on_connector_loss": config.bus.on_connector_loss} if _notes_on_loss(config) else {}


def _show(plan: Plan, needs: Needs, more: Sequence[str]) -> None:
    p = plan.params
    parameters = {
        "T_SL": p.t_sl,
        "min T_SDR": p.min_tsdr,
        "max T_SDR": p.max_tsdr,
        "T_SET": p.t_set,
        "T_QUI": p.t_qui,
        "T_ID1": p.t_id1,
        "T_ID2": p.t_id2,
        "T_TR": p.t_tr,
        "T_TO": p.t_to,
    }
    rows = [(name, bits, f"{p.ns(bits) / 1000:.1f}") for name, bits in parameters.items()]
    output.table(f"Bus parameters at {baud_text(p.baud)}, master {p.address}", ("parameter", "bit times", "us"), rows)
    gap = f"every {p.gap} T_TR" if p.gap else "off"
    retries = "1 retry" if p.max_retry == 1 else f"{p.max_retry} retries"
    output.line(f"GAP {gap}, HSA {p.hsa}, {retries}, watchdog {plan.watchdog_ms} ms where none is given")
    others = plan.figures.others.count
    if others:
        output.line(
            f"{others} other master{'s' * (others > 1)}: a T_TR of {plan.figures.t_tr_needed} or more on all of them, "
            f"then each sees this rotation"
        )
    output.table(
        "Bus rotation time",
        ("case", "bit times", "time"),
        [(name, plan.rotations[case].bits, _ms(plan.rotation_ns(case))) for case, name in _CASES.items()],
    )
    service = plan.figures.acyclic_bits
    output.line(f"one acyclic service makes it longer by {service} bit times at the most, {ms_text(p.ns(service))}")
    output.table(
        "Slaves",
        ("address", "name", "in/out octets", "bit times", "watchdog", "when the master stops"),
        [
            (
                s.setup.address,
                s.setup.name,
                f"{s.setup.input_len}/{s.setup.output_len}",
                s.shortest_bits,
                f"{s.watchdog_ms} ms" if s.watchdog_ms else "off",
                s.on_loss,
            )
            for s in plan.slaves
        ],
    )
    _show_slots(plan)
    if plan.cycle is not None:
        output.line(
            f"cycle of {plan.cycle.cycle_ns / NS_PER_MS:g} ms: {plan.cycle.verdict.text}; "
            f"the typical rotation takes {plan.cycle.load:.0%} of it"
        )
        _show_needs(needs)
    for note in (*plan.notes, *([plan.beside] if plan.beside else []), *more):
        output.line(f"note: {note}", "dim")
    for finding in plan.findings:
        output.line(f"finding: {finding}", "bold red")
    if not plan.findings:
        output.line("nothing is out of bounds", "green")


def _show_slots(plan: Plan) -> None:
    """The slots of all slaves; empty ones have no line."""
    output.table(
        "Slots, their octets of inputs and outputs and their channels",
        ("address", "name", "slot", "module", "identifier", "inputs", "outputs"),
        [
            (
                slave.setup.address,
                slave.setup.name,
                slot.number,
                slot.name,
                slot.config.hex(" ").upper(),
                slot.inputs.channel_text,
                slot.outputs.channel_text,
            )
            for slave in plan.slaves
            for slot in slave.setup.slots.slots
            if not slot.is_empty
        ],
    )


def _show_simulated(plan: Plan, found: SimulatedPlan | None) -> None:
    if found is None:
        why = plan.refusals[0].text if plan.refusals else "ended before all slaves were in data exchange"
        output.line(f"not simulated: {why}", "bold red")
        return
    for text in found.missing:
        output.line(f"not in data exchange in the simulation: {text}", "bold red")
    times = found.rotation
    if not times.count:
        output.line("not simulated: no slave was in data exchange", "bold red")
        return
    measured = {"min": times.min_ns, "median": times.quantile_ns(0.5), "p99": times.quantile_ns(0.99)}
    planned = [(name, _ms(plan.figures.between_ns(case))) for case, name in _CASES.items()]
    planned.insert(2, ("", ""))
    simulated = [(name, _ms(ns)) for name, ns in (*measured.items(), ("max", times.max_ns))]
    what = "Time from cycle to cycle" if plan.figures.cycle_ns else "Bus rotation time"
    output.table(
        f"{what} of the plan, and of {times.count} simulated rotations in {found.ns / NS_PER_S:g} s",
        ("plan", "time", "simulated", "time"),
        [(*left, *right) for left, right in zip(planned, simulated, strict=True)],
    )
    if found.cycles is not None:
        _show_cycles(found.cycles)
    if found.services is not None:
        took = found.services.took
        output.line(
            f"one record read a second from each DP-V1 slave: {took.count} answered"
            + (f" ({found.services.refused} of them refused)" if found.services.refused else "")
            + (f", {found.services.failed} failed" if found.services.failed else "")
            + f"; from the order to the answer median {_ms(took.quantile_ns(0.5))}, max {_ms(took.max_ns)}"
        )
    for text in found.limits:
        output.line(f"not simulated: {text}", "dim")


def _show_cycles(cycles: CycleStats) -> None:
    late = cycles.late
    all_of_them = cycles.begun + cycles.left_out
    causes = ", ".join(f"{count} {reason.text}" for reason, count in cycles.reasons.items())
    output.line(
        f"cycles simulated: {all_of_them}, {cycles.missed} missed"
        + (f" ({cycles.missed / all_of_them:.2%}: {causes})" if cycles.missed else "")
        + f"; begin late by: median {_ms(late.quantile_ns(0.5))}, p99 {_ms(late.quantile_ns(0.99))}, "
        f"max {_ms(late.max_ns)}"
    )


def _ms(ns: int) -> str:
    return f"{ns / NS_PER_MS:.3f} ms"


def _show_octets(plan: Plan, where: str = "") -> None:
    """One line for each telegram: a table would cut long ones."""
    for slave in plan.slaves:
        for service, octets in (("Set_Prm", slave.set_prm), ("Chk_Cfg", slave.chk_cfg)):
            spaced = " ".join(octets[at : at + 2] for at in range(0, len(octets), 2)).upper()
            output.line(f"{where}{service} of slave {slave.setup.address} ({slave.setup.name}): {spaced}")
    if any(slave.setup.ident is None for slave in plan.slaves):
        output.line("..: an octet of the ident number, which the slave is asked for")


def _show_rates(config: Config, plans: Mapping[int, Plan]) -> None:
    rows = [
        (
            baud_text(rate),
            *(_ms(plan.rotation_ns(case)) for case in _CASES),
            *([plan.cycle.verdict.value] if plan.cycle else []),
            f"{plan.watchdog_ms} ms",
            len(plan.findings) or "none",
        )
        for rate, plan in plans.items()
    ]
    title = f"Bus rotation time of {len(config.slaves)} slaves"
    cycle = [f"cycle {config.bus.cycle_ms:g} ms"] if config.bus.cycle_ms else []
    output.table(title, ("rate", *_CASES.values(), *cycle, "watchdog", "findings"), rows)
    for rate, plan in plans.items():
        for finding in plan.findings:
            output.line(f"{baud_text(rate)}: {finding}")


def _show_needs(needs: Needs) -> None:
    if needs:
        texts = (f"{_HOW[verdict]} {_from(baud)}" for verdict, baud in needs.items())
        output.line(f"this cycle is {', '.join(texts)}")


def _from(baud: int | None) -> str:
    return "at no rate" if baud is None else f"from {baud_text(baud)} on"
