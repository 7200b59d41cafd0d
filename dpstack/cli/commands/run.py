"""``dpstack run``: the soft master."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
from collections.abc import AsyncIterator
from functools import partial
from typing import TYPE_CHECKING

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.events_json import Event, Severity, event_json
from dpstack.api.bus.statistics import clear_since
from dpstack.api.config.config import Config, load_config
from dpstack.api.control import arguments
from dpstack.api.control.arguments import PTY, address_of
from dpstack.api.control.control_server import ControlServer
from dpstack.api.control.handlers import control_run, run_feed
from dpstack.cli import options
from dpstack.cli.commands.on_bus import reachable, refuse_application_watchdog
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import causes, output
from dpstack.cli.terminal.nonblocking_stdout import reader_watched, run_unhurried
from dpstack.cli.terminal.report import Reporter, clear_text, not_exchanging
from dpstack.cli.terminal.signals import INTERRUPTED, StopSignal
from dpstack.cli.terminal.suspension import Suspension
from dpstack.errors import UsageError
from dpstack.service.notify import BusState, ServiceReport
from dpstack.text import some_of
from dpstack.units import ns_to_s

if TYPE_CHECKING:
    from dpstack.api.bus.core import BusCore
    from dpstack.api.bus.recording import BusRecording
    from dpstack.api.control.scenario import SimulatedPlant
    from dpstack.api.listen.report_file import RunReport
    from dpstack.api.recording.event_log import EventLog


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "example: dpstack run plant.toml --outputs valves=07 9=00FF --seconds 10\n"
        "         dpstack run plant.toml --read-only --address 1"
    )
    # optional, because --outputs may stand before it
    parser.value("config", "CONFIG", "configuration file", nargs="?")
    options.add_other_port(parser)
    parser.value("--seconds", "S", "end after S seconds in the ring", type=options.seconds)
    parser.value("--rotations", "N", "end after N rotations in Operate (or Clear)", type=options.count)
    parser.value("--driver", None, "what keeps the bus going", choices=("auto", "asyncio", "process"))
    parser.value("--address", "N", "another station address of the master, 0..125", type=options.address)
    parser.value(
        "--outputs",
        "SLAVE=HEX",
        "initial output octets of slaves by address or name; a drive that gets some is run without its plugin",
        nargs="+",
        action="extend",
        default=[],
    )
    parser.flag("--clear", "stay in Clear: read inputs, outputs are zero")
    parser.flag(
        "--read-only",
        "join the token ring as one more master, show who is there and in what state, write nothing to any slave; "
        "with --address beside the master that has the same file",
    )
    parser.value("--scenario", "FILE", 'faults and inputs of the simulated slaves in time, on the port "virtual"')
    parser.flag("--allow-code", "load and call the functions of simulated slaves (key simulate)")
    parser.value(
        "--record", "FILE", "keep named values, states and drive quantities, a new file: .csv, .jsonl or .parquet"
    )
    parser.flag("--on-change", "with --record: only rows in which a value has left its dead band")
    parser.flag("--quality", "with --record: a column with the quality of each named value; a bad one keeps its number")
    parser.value("--rotate", "SIZE|TIME", "with --record: a new file after this size (100MB, 1GB) or time (30min, 1h)")
    parser.value("--log", "FILE", "write events with wall clock, JSON if it ends in .jsonl; 10 MB, then a new file")
    parser.flag("--plain", "plain lines on a terminal, too, instead of the live screen")
    parser.value("--report", "FILE.html", "write an acceptance report of what was on the bus, a new file")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 when at the end a slave is not in data exchange, or is there by chance as it flaps (but for a
    scenario, whose faults are wanted), the master is in Clear by itself, or safe values and Clear could not be sent;
    and after a stall."""
    name, given = _config_and_outputs(args)
    config = load_config(name).with_bus(
        port=args.port,
        baud=args.baud,
        address=args.address,
        driver=args.driver,
        read_only=args.read_only or None,
    )
    refuse_application_watchdog(config, "run")
    if config.bus.read_only and given:
        raise UsageError("--outputs on a read-only bus: nothing is written there; leave one of the two out")
    if config.bus.read_only and args.record is not None:
        raise UsageError("--record on a read-only bus: it reads no process data; leave one of the two out")
    if args.scenario is not None and not config.virtual:
        raise UsageError(f'--scenario on {config.port}: only simulated slaves have one; take "virtual", or dpstack sim')
    names = {slave.address: slave.name for slave in config.slaves}
    outputs = {address_of(slave, names): octets for slave, octets in map(arguments.octets, given)}
    return run_unhurried(_run(config.with_outputs(outputs), args), json=args.json)


def _config_and_outputs(args: argparse.Namespace) -> tuple[str, list[str]]:
    """CONFIG and all SLAVE=HEX. A text without "=" behind ``--outputs SLAVE=HEX`` is CONFIG."""
    given = list(args.outputs)
    name: str | None = args.config
    others = [text for text in given if "=" not in text]
    if name is None and len(others) == 1 and len(given) > 1:
        name = others[0]
        given.remove(name)
    if name is None:
        raise UsageError("run: no CONFIG; give the configuration file, for instance dpstack run plant.toml")
    return name, given


async def _run(config: Config, args: argparse.Namespace) -> int:
    report = _report(config, args)
    files = RunFiles(args.record, args.log, on_change=args.on_change, rotate=args.rotate, quality=args.quality)
    with files, report or contextlib.nullcontext(), StopSignal() as stop, contextlib.ExitStack() as stack:
        stack.enter_context(reader_watched())

        def on_event(event: Event) -> None:
            files.event(core_of(bus), event)
            reporter.event(event)
            lines.event(event)

        bus = Bus(config, on_event=on_event)
        plant = _simulated_plant(bus, args)
        reporter = Reporter(bus, json=args.json)
        lines = causes.CauseLines(bus)
        if bus.searching:
            reporter.searching()
        service = stack.enter_context(ServiceReport(partial(_service_state, bus, args)))
        # `dpstack ctl` also works while the bus searches its rate or joins the ring; a held port is reported once
        feed = run_feed(bus)
        control = control_run(bus, config.port, feed, stop=stop.stop)
        # before a bus process is started
        suspension = stack.enter_context(Suspension(bus, partial(_ctl_name, bus, control)))
        async with reachable(control, quiet=True) as unreachable, _connectors(bus, stop):
            if report is not None:
                report.begin(bus, feed)
            await stop.or_done(_open(bus, control))
            if unreachable is not None:
                output.warn(unreachable)
            if not bus.is_open:
                output.warn(f"ended before the {'baud rate was found' if bus.searching else 'token ring was joined'}")
                return 1
            reporter.start()
            async with _screen(bus, stop, reporter, suspension, args):
                try:
                    if files.recording is not None:
                        bus.record(files.recording)
                    if plant is not None:
                        plant.start(core_of(bus).started_ns)
                    if not (args.clear or config.bus.read_only):
                        await bus.operate()
                    if report is not None:
                        report.opened()
                    # a busy computer orders Operate late: all N rotations are in the mode of the run
                    end = None if args.rotations is None else bus.stats.rotations + args.rotations
                    await stop.or_done(_limit(bus, args.seconds, end))
                    stats, missing, held = bus.stats, not_exchanging(bus), clear_since(core_of(bus))
                    stories = await lines.stories()
                    if report is not None:
                        report.look()
                        await stop.or_done(report.rest())
                finally:
                    service.end()
                    if plant is not None:
                        plant.close()
                    if report is not None:
                        report.end()
                    await bus.close()
                    written = report is None or stop.hurried or _write(report)
        if stop.hurried:
            return INTERRUPTED
    recorded = {} if files.recording is None else {"recording": files.recording.as_dict()}
    reporter.summary(stats, **({"clear": held} if held else {}), **recorded, **causes.as_json(stories))
    if not args.json:
        causes.show(stories)
    if files.recording is not None and not args.json:
        output.line(files.summary())
    for text in files.troubles:
        output.warn(text)
    if report is not None and written and not args.json:
        output.line(f"report: {args.report}")
    if args.scenario is None:
        missing += causes.flapping(stories)
    if held:
        missing = [clear_text(held), *missing]
    for text in missing:
        output.warn(text)
    failed = plant is not None and plant.failed_steps
    return 1 if missing or reporter.stalled or bus.end_failed or failed else 0


def _report(config: Config, args: argparse.Namespace) -> RunReport | None:
    """The report that ``args`` ask for."""
    if args.report is None:
        return None
    from dpstack.api.listen.report_file import RunReport  # here, as most runs write none

    return RunReport(args.report, config)


@contextlib.asynccontextmanager
async def _connectors(bus: Bus, stop: StopSignal) -> AsyncIterator[None]:
    """The connectors that the configuration names. They begin before the bus, and end after it."""
    if not bus.config.connectors:
        yield
        return
    from dpstack.api.connectors.publishing import Publishing  # here, as most runs have none

    publishing = Publishing(bus, bus.config.connectors, hurried=lambda: stop.hurried)
    try:
        async with publishing:
            yield
    finally:
        for text in publishing.remarks:
            output.warn(text)


def _screen(
    bus: Bus, stop: StopSignal, reporter: Reporter, suspension: Suspension, args: argparse.Namespace
) -> contextlib.AbstractAsyncContextManager[None]:
    """The live screen of the run, if ``args`` want it and standard output is a terminal."""
    if args.json or args.plain or not output.redraws():
        return contextlib.nullcontext()
    from dpstack.cli.terminal.live_screen import live_screen  # here, as it needs a terminal

    return live_screen(bus, stop, reporter, suspension)


def _simulated_plant(bus: Bus, args: argparse.Namespace) -> SimulatedPlant | None:
    """Scenario and inputs of the simulated slaves of ``bus``; None on a real bus. Raises ConfigError."""
    bench = None if bus.searching else core_of(bus).bench
    if bench is None:
        return None
    from dpstack.api.control.scenario import SimulatedPlant  # these here, as a run on a real bus simulates nothing
    from dpstack.api.control.simulation_handlers import slave_handlers

    handlers = slave_handlers(bench)
    return SimulatedPlant(bench, core_of(bus).publish, handlers, scenario=args.scenario, allow_code=args.allow_code)


def _write(report: RunReport) -> bool:
    """Write the report. A failure is a warning: the bus has run as it has run."""
    why = report.write()
    if why is not None:
        output.warn(why)
    return why is None


async def _open(bus: Bus, control: ControlServer) -> None:
    await bus.open()
    if bus.config.port == PTY:
        control.move_to(core_of(bus).runtime.port_name)


def _ctl_name(bus: Bus, control: ControlServer) -> str:
    """The name by which ``dpstack ctl`` finds this run, also if there are others on "virtual"."""
    return control.name if bus.config.virtual else core_of(bus).runtime.port_name


def _service_state(bus: Bus, args: argparse.Namespace) -> BusState:
    """The state of ``bus`` for the service manager. The counters stand still if a bus process is dead or stopped."""
    if not bus.is_open:
        return BusState(ready=False, beat=0, status="looks for the baud rate" if bus.searching else "opens the port")
    tokens, mode = core_of(bus).view.link.tokens, bus.mode.name.lower()
    if bus.config.bus.read_only:
        ready, mode = tokens > 0, "read-only"
    else:
        ready = mode == ("clear" if args.clear else "operate")
    served = [slave for slave in bus.slaves if not slave.deactivated]
    missing = [f"{slave.name} ({slave.address})" for slave in served if not slave.ready_now]
    text = f"{mode}, {len(served) - len(missing)} of {len(served)} slaves in data exchange"
    return BusState(ready, tokens, f"{text}; not: {some_of(missing)}" if missing else text)


async def _limit(bus: Bus, seconds: float | None, rotations: int | None) -> None:
    """Wait until the first of the limits: ``seconds`` in the ring, ``rotations`` of the bus in all; None: no limit."""
    try:
        await bus.rotated(rotations, None if seconds is None else max(0.0, seconds - core_of(bus).seconds_in_ring))
    except TimeoutError:
        return


class RunFiles:
    """The files of ``dpstack run``: a recording, and a log of events. Leaving closes the log.

    Making it makes the files. Raises UsageError as :class:`BusRecording` and :class:`EventLog` do.
    """

    def __init__(
        self,
        record: str | None,
        log: str | None,
        *,
        on_change: bool = False,
        rotate: str | None = None,
        quality: bool = False,
    ) -> None:
        if record is None and (on_change or quality or rotate is not None):
            option = "--on-change" if on_change else "--quality" if quality else "--rotate"
            raise UsageError(f"{option} is about a recording: add --record FILE, or leave it out")
        self.recording: BusRecording | None = None
        self._log: EventLog | None = None
        self._bus: BusCore | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        if record is not None:
            from dpstack.api.bus.recording import BusRecording  # these here, as a run without files needs none of them

            self.recording = BusRecording(record, on_change=on_change, rotate=rotate, quality=quality)
        if log is not None:
            from dpstack.api.recording.event_log import EventLog

            try:
                self._log = EventLog(log, self._tell)
            except UsageError:
                if self.recording is not None:
                    self.recording.discard()
                raise
        self._log_troubles: list[str] = []

    def __enter__(self) -> RunFiles:
        return self

    def __exit__(self, *_: object) -> None:
        self._bus = None
        if self.recording is not None:
            self.recording.discard()
        if self._log is not None:
            self._log.close()

    @property
    def troubles(self) -> list[str]:
        """Lines about troubles with all files."""
        return [*([] if self.recording is None else self.recording.troubles), *self._log_troubles]

    def event(self, bus: BusCore, event: Event) -> None:
        """Write ``event`` into the log."""
        if self._log is None:
            return
        if self._loop is None:
            self._bus, self._loop = bus, asyncio.get_running_loop()
        line = event_json(event, ns_to_s(event.t_ns - bus.started_ns))
        if line is not None:
            self._log.put({**line, "severity": event.severity.value, "text": event.text})

    def _tell(self, text: str) -> None:
        """From the thread of the log."""
        self._log_troubles.append(text)
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._notice, text)

    def _notice(self, text: str) -> None:
        if self._bus is not None:
            self._bus.notice("log", text, Severity.WARNING)

    def summary(self) -> str:
        """One line on the recording; empty without one."""
        found = self.recording
        if found is None:
            return ""
        files = str(found.paths[-1]) if len(found.paths) == 1 else f"{len(found.paths)} files of {found.path}"
        return f"recording: {files}, {found.rows} rows" + (f", {found.lost} rounds lost" if found.lost else "")
