"""``dpstack plan``: bus parameters, rotation times and watchdogs of a configuration."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Final

from dpstack.api.bus.compose import Case, Plan, plan_bus
from dpstack.api.bus.plan_checks import Verdict, cycle_rates
from dpstack.api.config.config import Config, load_config
from dpstack.cli import options
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import ConfigError
from dpstack.units import BAUD_RATES, NS_PER_MS, baud_text, ms_text

#: the slowest baud rate for each verdict on the cycle
Needs = Mapping[Verdict, int | None]
_HOW: Final = {
    Verdict.POSSIBLE: "possible",
    Verdict.TYPICAL: "typically kept",
    Verdict.UNDISTURBED: "kept while nothing is repeated",
    Verdict.ALWAYS: "always kept",
}
_CASES: Final = {Case.SHORTEST: "shortest", Case.TYPICAL: "typical", Case.LONGEST: "longest"}


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack plan plant.toml --baud all --cycle-ms 4"
    parser.value("config", "CONFIG", "configuration file")
    parser.value("--baud", "B|all", "another rate, or all of them", type=options.baud_or("all"))
    parser.value("--cycle-ms", "X", "judge this cycle, and tell which rate it needs", type=options.milliseconds)
    parser.flag("--octets", "the octets of Set_Prm and Chk_Cfg of each slave, as they will be sent")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 when the plan has findings at the baud rate of the configuration."""
    config = load_config(args.config).with_bus(cycle_ms=args.cycle_ms)
    needs = cycle_rates(config, config.bus.cycle_ns) if config.bus.cycle_ns else {}
    if args.baud == "all":
        return _all_rates(config, needs, json=args.json, octets=args.octets)
    plan = plan_bus(config, args.baud or config.baud)
    if args.json:
        output.json_line(_with_rates(plan.as_dict(), needs))
    else:
        _show(plan, needs)
        if args.octets:
            _show_octets(plan)
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


def _rotation_text(plan: Plan, case: Case) -> str:
    return f"{plan.rotation_ns(case) / NS_PER_MS:.3f} ms"


def _with_rates(data: dict[str, object], needs: Needs) -> dict[str, object]:
    """The plan with the slowest rate for each verdict on the cycle, null where there is none."""
    cycle = data.get("cycle")
    if isinstance(cycle, dict):
        cycle["slowest_baud"] = {verdict.value: baud for verdict, baud in needs.items()}
    return data


def _show(plan: Plan, needs: Needs) -> None:
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
        [(name, plan.rotations[case].bits, _rotation_text(plan, case)) for case, name in _CASES.items()],
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
    if plan.cycle is not None:
        output.line(
            f"cycle of {plan.cycle.cycle_ns / NS_PER_MS:g} ms: {plan.cycle.verdict.text}; "
            f"the typical rotation takes {plan.cycle.load:.0%} of it"
        )
        _show_needs(needs)
    for note in (*plan.notes, *([plan.beside] if plan.beside else [])):
        output.line(f"note: {note}", "dim")
    for finding in plan.findings:
        output.line(f"finding: {finding}", "bold red")
    if not plan.findings:
        output.line("nothing is out of bounds", "green")


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
            *(_rotation_text(plan, case) for case in _CASES),
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
