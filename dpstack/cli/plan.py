"""``dpstack plan``: what a bus will do, before it is switched on."""

from __future__ import annotations

import argparse

from dpstack.api.compose import Case, Plan, plan_bus
from dpstack.api.config import Config, load_config
from dpstack.cli import options, output
from dpstack.units import BAUD_RATES, baud_text


def add_to(commands: options.Commands) -> None:
    """The command and its options."""
    parser = options.command(
        commands,
        "plan",
        "bus parameters, rotation times, watchdogs, and what does not fit together",
        "dpstack plan plant.toml --baud all",
    )
    parser.add_argument("config", metavar="CONFIG", help="configuration file")
    parser.add_argument("--baud", metavar="B|all", type=_baud_or_all, help="another rate, or all of them")
    options.add_json(parser)
    parser.set_defaults(execute=execute)


def _baud_or_all(text: str) -> int | str:
    return text if text == "all" else options.baud(text)


def execute(args: argparse.Namespace) -> int:
    """Print one plan, or one for each rate; 1 when something is out of bounds at the bus's own rate."""
    config = load_config(args.config)
    rates = list(BAUD_RATES) if args.baud == "all" else [args.baud or config.baud]
    plans = [plan_bus(config, rate) for rate in rates]
    if args.json:
        dicts = [plan.as_dict() for plan in plans]
        output.json_line(dicts if args.baud == "all" else dicts[0])
    elif len(plans) > 1:
        _show_rates(config, plans)
    else:
        _show(plans[0])
    judged = [plan for plan in plans if len(plans) == 1 or plan.params.baud == config.bus.baud]
    return 1 if any(plan.findings for plan in judged) else 0


def us(plan: Plan, case: Case) -> str:
    """A rotation for people."""
    ns = plan.rotation_ns(case)
    return f"{ns / 1_000_000:.3f} ms"


def _show(plan: Plan) -> None:
    p = plan.params
    parameters = [
        ("T_SL", p.t_sl),
        ("min T_SDR", p.min_tsdr),
        ("max T_SDR", p.max_tsdr),
        ("T_SET", p.t_set),
        ("T_QUI", p.t_qui),
        ("T_ID1", p.t_id1),
        ("T_ID2", p.t_id2),
        ("T_TR", p.t_tr),
        ("T_TO", p.t_to),
    ]
    rows = [(name, bits, f"{p.ns(bits) / 1000:.1f}") for name, bits in parameters]
    output.table(f"Bus parameters at {baud_text(p.baud)}, master {p.address}", ("parameter", "bit times", "us"), rows)
    gap = f"every {p.gap} T_TR" if p.gap else "off"
    output.line(f"GAP {gap}, HSA {p.hsa}, {p.max_retry} retries, watchdog {plan.watchdog_ms} ms where none is given")
    cases = ((Case.SHORTEST, "shortest"), (Case.TYPICAL, "typical"), (Case.LONGEST, "longest"))
    output.table(
        "Bus rotation time",
        ("case", "bit times", "time"),
        [(name, plan.rotations[case].bits, us(plan, case)) for case, name in cases],
    )
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
    for note in (*plan.notes, *([plan.beside] if plan.beside else [])):
        output.line(f"note: {note}", "dim")
    for finding in plan.findings:
        output.line(f"finding: {finding}", "bold red")
    if not plan.findings:
        output.line("nothing is out of bounds", "green")


def _show_rates(config: Config, plans: list[Plan]) -> None:
    rows = [
        (
            baud_text(plan.params.baud),
            us(plan, Case.SHORTEST),
            us(plan, Case.TYPICAL),
            us(plan, Case.LONGEST),
            f"{plan.watchdog_ms} ms",
            len(plan.findings) or "none",
        )
        for plan in plans
    ]
    title = f"Bus rotation time of {len(config.slaves)} slaves"
    output.table(title, ("rate", "shortest", "typical", "longest", "watchdog", "findings"), rows)
    for plan in plans:
        for finding in plan.findings:
            output.line(f"{baud_text(plan.params.baud)}: {finding}")
