"""``dpstack sim``: simulated slaves on a port."""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path
from typing import Literal

from dpstack.api.config.config import AUTO, Config, load_config, make_config, slave_config
from dpstack.api.control.scenario import SimulatedPlant
from dpstack.api.control.simulation_handlers import control_sim, slave_handlers
from dpstack.api.recording.event_log import EventLog
from dpstack.api.slave_side.repeated_events import PassOn, RepeatedEvents, times_text
from dpstack.api.slave_side.simulation import DEFAULT_BAUD, Simulation, sim_event_json
from dpstack.cli import options
from dpstack.cli.commands.on_bus import reachable
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.nonblocking_stdout import run_unhurried
from dpstack.cli.terminal.report import event_printer
from dpstack.cli.terminal.signals import StopSignal
from dpstack.errors import UsageError
from dpstack.text import number_or_name
from dpstack.trace import Event
from dpstack.units import baud_text, ns_to_s


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "example: dpstack sim plant.toml --port pty\n"
        "         dpstack sim --drive fuji-frenic --address 4 --port pty\n"
        '         dpstack sim --gsd io-station --modules "8 DI" "8 DO" --address 8 --port pty\n'
        "         dpstack sim --drive demag-dedrive --address 126 --port pty\n"
        "         dpstack sim plant.toml --port pty --scenario faults.toml"
    )
    parser.value("config", "CONFIG", "configuration file", nargs="?")
    parser.value("--drive", "NAME", "one simulated drive instead of a configuration")
    parser.value("--gsd", "FILE", "one device of this GSD file; io-station is brought along")
    parser.value("--modules", "M", "what is plugged into it, by name or reference number", nargs="+")
    parser.value(
        "--address",
        "A",
        "its address; 126: as delivered, until `dpstack address` gives it another one",
        type=options.slave_address,
    )
    parser.value("--telegram", "T", "its telegram")
    parser.value("--port", "P", 'the port; "pty" makes one and prints its path', required=True)
    parser.value("--baud", "B|auto", "the rate, else the configuration's; auto: listens", type=options.baud_or_auto)
    parser.value("--scenario", "FILE", "faults and inputs in time: a TOML file of steps")
    parser.value("--log", "FILE", "write events with wall clock, JSON if it ends in .jsonl; 10 MB, then a new file")
    parser.flag("--allow-code", "load and call the functions that the configuration names (key simulate)")
    parser.value("--seconds", "S", "end after S seconds", type=options.seconds)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    config = _config(args)
    baud = args.baud or config.bus.baud or DEFAULT_BAUD
    return run_unhurried(_run(config, baud, args), json=args.json)


def _config(args: argparse.Namespace) -> Config:
    given = {key: getattr(args, key) for key in ("drive", "gsd", "modules", "telegram", "address")}
    table: dict[str, object] = {key: value for key, value in given.items() if value is not None}
    if args.config is not None:
        if table:
            option = "--gsd" if args.drive is None and args.gsd is not None else "--drive"
            raise UsageError(f"sim: a CONFIG or {option} with --address, not both; leave one out")
        return load_config(args.config)
    device = args.drive or args.gsd
    if device is None or args.address is None:
        raise UsageError(
            "sim: neither CONFIG nor --drive NAME with --address A; give one of them, or --gsd FILE with --address"
        )
    table["name"] = args.drive or Path(args.gsd).stem
    if args.modules:
        table["modules"] = [number_or_name(module) for module in args.modules]
    master = 2 if args.address != 2 else 1
    slave = slave_config(table, where="sim", unaddressed=True)
    return make_config(args.port, DEFAULT_BAUD, master, [slave], where="sim")


async def _run(config: Config, baud: int | Literal["auto"], args: argparse.Namespace) -> int:
    with StopSignal() as stop, contextlib.ExitStack() as stack:
        log = None if args.log is None else stack.enter_context(contextlib.closing(EventLog(args.log)))
        simulation = Simulation(config, args.port, baud)
        plant = SimulatedPlant(
            simulation,
            simulation.publish,
            slave_handlers(simulation),
            scenario=args.scenario,
            allow_code=args.allow_code,
        )
        async with simulation, reachable(control_sim(simulation, args.port)):
            if args.port == "pty":
                output.json_line({"port": simulation.port_name})
            if not args.json:
                rate = f"at {baud_text(baud)}" if baud != AUTO else "(searching for the baud rate)"
                output.line(f"simulating on {simulation.port_name} {rate}:")
                for slave in simulation.slaves:
                    output.line(f"  {slave.address:3}  {slave.name}  ({slave.kind})")
                for cpu in simulation.cpus.values():
                    output.line(f"  {cpu.address:3}  {cpu.name}  (S7-200 over PPI)")
            if simulation.t_sl:
                output.warn(
                    f"a master needs t_sl = {simulation.t_sl} or more for these slaves: the adapter answers late"
                )
            repeated = RepeatedEvents(_event_writer(simulation, args.json, log))
            simulation.on_event = repeated.publish
            with plant:
                plant.start(simulation.started_ns)
                await stop.or_done(simulation.failed(args.seconds))
            repeated.report()
            if simulation.never_found is not None:
                output.warn(f"{args.port}: the baud rate was not found: {simulation.never_found}; or give the rate")
                return 0 if stop.received else 1
            print_summary(simulation, args.json)
    return 1 if plant.failed_steps else 0


def _event_writer(simulation: Simulation, json: bool, log: EventLog | None) -> PassOn:
    """A function that prints the events of ``simulation``, and writes them into ``log``."""
    show = event_printer(simulation.started_ns, json=json)
    if log is None:
        return show

    def write(event: Event, times: int) -> None:
        show(event, times)
        line = sim_event_json(event, ns_to_s(event.t_ns - simulation.started_ns))
        text = event.text + times_text(times)
        log.put({**line, **({"times": times} if times > 1 else {}), "severity": event.severity.value, "text": text})

    return write


def print_summary(simulation: Simulation, json: bool) -> None:
    if json:
        slaves = {str(slave.address): slave.as_dict() for slave in simulation.slaves}
        slaves |= {str(cpu.address): cpu.as_dict() for cpu in simulation.cpus.values()}
        heard = {"telegrams": simulation.telegrams, "bad": simulation.bad}
        output.json_line({"event": "summary", "t": round(simulation.seconds, 3), **heard, "slaves": slaves})
        return
    rows = [(slave.address, *slave.as_dict().values()) for slave in simulation.slaves]
    columns = ("address", "name", "state", "exchanges", "watchdog expired", "answers too late")
    if rows:
        output.table("Slaves", columns, rows)
    for cpu in simulation.cpus.values():
        output.line(f"{cpu.who}: {cpu.responder.requests} requests")
    for slave in simulation.slaves:
        if slave.refused is not None:
            output.line(f"the last refusal of {slave.who}: {slave.refused}", "yellow")
    if any(slave.station.stats.dropped for slave in simulation.slaves):
        output.line(
            "answers too late were not sent, because another telegram was there already: this computer was busy for "
            "longer than the master waits, or another master talked at the same time"
        )
    bad = ", ".join(f"{count} {cause.replace('_', ' ')}" for cause, count in simulation.bad.items())
    output.line(f"{simulation.telegrams} telegrams heard" + (f", bad: {bad}" if bad else ", none of them bad"))
