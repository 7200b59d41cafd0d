"""``dpstack monitor``: judges a bus by listening, live or from a capture file. Never sends."""

from __future__ import annotations

import argparse
import contextlib
from time import time_ns
from typing import TYPE_CHECKING

from dpstack.capture.timing import FILE, LineTiming
from dpstack.capture.transmission import Transmission
from dpstack.cli import options
from dpstack.cli.listening.judged_file import JudgedFile
from dpstack.cli.listening.monitor_view import event_line, show_summary, write_report
from dpstack.cli.listening.source_file import UnreadLines, add_channel
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import CaptureFileError, UsageError
from dpstack.monitor.devices import Devices
from dpstack.monitor.monitor import Happening, Monitor
from dpstack.monitor.summary import time_text
from dpstack.monitor.verdict import CRITICAL
from dpstack.units import AUTO, baud_text

if TYPE_CHECKING:
    from dpstack.api.listen.report_file import ReportFile


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack monitor --port /dev/ttyUSB0; dpstack monitor bus.pcapng --gsd plant/gsd; "
        "dpstack monitor --port /dev/ttyUSB0 --config plant.toml --seconds 600 --json"
    )
    parser.value(
        "file", "FILE", "a capture file (pcapng, or of a logic analyser: .sr, VCD, CSV), in place of --port", nargs="?"
    )
    parser.value("--port", "P", "the port; also one that a run, sim or segment holds")
    parser.value(
        "--baud", "B|auto", 'rate in bit/s; "auto" (default): finds it', type=options.baud_or_auto, default=AUTO
    )
    add_channel(parser)
    parser.value("--config", "CONFIG", "configuration file: names of the slaves, their GSD files, T_SL")
    parser.value("--gsd", "DIR", "folder of GSD files: models and diagnosis texts by ident number")
    parser.value("--thresholds", "FILE", "TOML file with other thresholds, see docs/how-to/monitor.md")
    parser.value("--seconds", "S", "end after S seconds", type=options.seconds)
    parser.value("--report", "FILE.html", "write an acceptance report, a new file; see docs/how-to/monitor.md")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if the verdict on the bus is critical, the file cannot be read to its end, or the port failed."""
    if (args.file is None) == (args.port is None):
        raise UsageError("monitor: give either a capture file or --port, for instance --port /dev/ttyUSB0")
    live = args.file is None
    monitor = _monitor(args, time_ns() if live else None)
    report = _report(args, monitor)
    with report or contextlib.nullcontext():
        if not live:
            return _FromFile(args, monitor, report).run()
        # a capture file needs none of the modules of ports
        from dpstack.cli.listening.monitor_live import LiveMonitor
        from dpstack.cli.terminal.nonblocking_stdout import run_unhurried

        return run_unhurried(LiveMonitor(args, monitor, report).run(), json=args.json)


def _monitor(args: argparse.Namespace, begun_ns: int | None) -> Monitor:
    """The monitor with what the options say about the plant. Raises ConfigError."""
    devices, thresholds = Devices(), None
    if args.config is not None or args.gsd is not None or args.thresholds is not None:
        from dpstack.api.config.config import load_config
        from dpstack.api.listen.plant_files import load_devices, load_thresholds

        config = None if args.config is None else load_config(args.config)
        devices = load_devices(config, args.gsd, output.warn)
        thresholds = None if args.thresholds is None else load_thresholds(args.thresholds)
    return Monitor(LineTiming(FILE, None), devices=devices, thresholds=thresholds, begun_ns=begun_ns)


def _report(args: argparse.Namespace, monitor: Monitor) -> ReportFile | None:
    if args.report is None:
        return None
    from dpstack.api.listen.report_file import ReportFile

    return ReportFile(args.report, monitor)


class _FromFile:
    """Judges a capture file."""

    def __init__(self, args: argparse.Namespace, monitor: Monitor, report: ReportFile | None) -> None:
        self._report = report
        self._name: str = args.file
        self._json: bool = args.json
        self._seconds: float | None = args.seconds
        self._monitor = monitor
        self._unread = UnreadLines(shown=False)
        self._file = JudgedFile(
            args.file,
            monitor,
            baud=args.baud,
            channel=args.channel,
            on_unread=self._unread.add,
            add=None if report is None else report.add,
            on_start=self._start,
        )
        monitor.on_event = self._show

    def run(self) -> int:
        damage = None
        try:
            self._file.read(self._seconds)
        except CaptureFileError as error:
            damage = error
        self._unread.report()
        summary = self._monitor.summary()
        if damage is not None and not summary["telegrams"]:
            raise damage
        if self._json:
            output.json_line(summary)
        else:
            show_summary(self._monitor.heard(), summary)
        write_report(self._report, summary, {"Capture file": self._name}, json=self._json)
        if damage is not None:
            output.warn(str(damage))
        return 1 if damage is not None or summary["verdict"] == CRITICAL else 0

    def _start(self, first: Transmission) -> None:
        """The start line, with the time of the first transmission."""
        time, source, port = time_text(first.t_ns or 0), self._monitor.timing.source, self._file.port
        if self._json:
            start = {"event": "start", "time": time, "file": self._name, "port": port, "baud": first.baud}
            output.json_line({**start, "source": source})
        else:
            where = f", port {port}" if port else ""
            output.line(f"{self._name}{where}, {baud_text(first.baud)}, from {time or 'an unknown time'}", "bold")

    def _show(self, happening: Happening) -> None:
        if self._json:
            output.json_line(happening.as_dict(self._monitor.begun_ns))
        elif not happening.routine:
            event_line(happening, self._monitor.begun_ns)
