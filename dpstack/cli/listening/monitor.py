"""``dpstack monitor``: judges a bus by listening, live or from a capture file. Never sends."""

from __future__ import annotations

import argparse
import contextlib
from time import time_ns
from typing import TYPE_CHECKING

from dpstack.capture.timing import FILE, LineTiming
from dpstack.capture.transmission import Transmission
from dpstack.cli import options
from dpstack.cli.listening.capture_set import captures_in, is_pcapng
from dpstack.cli.listening.judged_file import JudgedFiles
from dpstack.cli.listening.monitor_view import event_line, show_summary, write_report
from dpstack.cli.listening.progress import Progress
from dpstack.cli.listening.source_file import UnreadLines, add_channel
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import CaptureFileError, UsageError
from dpstack.monitor.devices import Devices
from dpstack.monitor.monitor import Happening, Monitor
from dpstack.monitor.summary import time_text
from dpstack.monitor.verdict import CRITICAL
from dpstack.text import some_of
from dpstack.units import AUTO, baud_text

if TYPE_CHECKING:
    from dpstack.api.listen.report_file import ReportFile
    from dpstack.cli.listening.file_jobs import FileJobs


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack monitor --port /dev/ttyUSB0; dpstack monitor bus.pcapng --gsd plant/gsd; "
        "dpstack monitor --port /dev/ttyUSB0 --config plant.toml --seconds 600 --json; "
        "dpstack monitor /srv/ring --jobs 4 --json"
    )
    what = (
        "a capture file (pcapng, or of a logic analyser: .sr, VCD, CSV), in place of --port; or several pcapng files "
        "and folders of them, which are judged as one"
    )
    parser.value("file", "FILE|DIR", what, nargs="*")
    parser.value("--port", "P", "the port; also one that a run, sim or segment holds")
    parser.value(
        "--baud", "B|auto", 'rate in bit/s; "auto" (default): finds it', type=options.baud_or_auto, default=AUTO
    )
    add_channel(parser)
    parser.value("--config", "CONFIG", "configuration file: names of the slaves, their GSD files, T_SL")
    parser.value("--gsd", "DIR", "folder of GSD files: models and diagnosis texts by ident number")
    parser.value("--thresholds", "FILE", "TOML file with other thresholds, see docs/how-to/monitor.md")
    jobs = "read pcapng files in so many processes; the result is that of one"
    parser.value("--jobs", "N", jobs, type=options.jobs, default=1)
    parser.value("--seconds", "S", "end after S seconds", type=options.seconds)
    parser.value("--report", "FILE.html", "write an acceptance report, a new file; see docs/how-to/monitor.md")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if the verdict on the bus is critical, the file cannot be read to its end, or the port failed."""
    if bool(args.file) == (args.port is not None):
        raise UsageError("monitor: give either a capture file or --port, for instance --port /dev/ttyUSB0")
    live = not args.file
    monitor = _monitor(args, time_ns() if live else None)
    report = _report(args, monitor)
    with report or contextlib.nullcontext():
        if not live:
            remarks: list[str] = []

            def on_remark(text: str) -> None:
                output.warn(text)
                remarks.append(text)

            names = captures_in(args.file, on_remark)
            with _jobs(names, args.jobs) or contextlib.nullcontext() as jobs:
                return _FromFiles(args, names, remarks, monitor, report, jobs).run()
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


def _jobs(names: list[str], count: int) -> FileJobs | None:
    """The processes that read the files; None for one process, and for a file of another kind than pcapng."""
    if count == 1 or not all(map(is_pcapng, names)):
        return None
    from dpstack.cli.listening.file_jobs import FileJobs  # with the modules for processes

    return FileJobs(count)


class _FromFiles:
    """Judges capture files. ``remarks``: of the choice of the files."""

    def __init__(
        self,
        args: argparse.Namespace,
        names: list[str],
        remarks: list[str],
        monitor: Monitor,
        report: ReportFile | None,
        jobs: FileJobs | None,
    ) -> None:
        self._report = report
        self._names = names
        self._remarks = remarks
        self._json: bool = args.json
        self._seconds: float | None = args.seconds
        self._monitor = monitor
        self._unread = UnreadLines(shown=False)
        self._progress = Progress(names)
        self._files = JudgedFiles(
            names,
            monitor,
            baud=args.baud,
            channel=args.channel,
            on_unread=self._unread.add,
            add_all=None if report is None else report.add_all,
            on_start=self._start,
            on_octets=self._progress.at,
            on_remark=self._remark,
            jobs=jobs,
            is_over=lambda: report is None and output.lost.error is not None,
        )
        monitor.on_event = self._show

    def run(self) -> int:
        damage: list[str] = []
        only: CaptureFileError | None = None
        try:
            self._files.read(self._seconds)
        except CaptureFileError as error:
            only = error
            damage.append(str(error))
        finally:
            self._progress.clear()
        damage += self._files.damage
        self._unread.report()
        summary = self._monitor.summary()
        if damage and not summary["telegrams"]:
            raise only or CaptureFileError("; ".join(damage))
        if self._json:
            output.json_line(summary)
        else:
            show_summary(self._monitor.heard(), summary)
        label = "Capture files" if len(self._names) > 1 else "Capture file"
        write_report(self._report, summary, {label: some_of(self._names)}, [*self._remarks, *damage], json=self._json)
        for line in damage:
            output.warn(line)
        return 1 if damage or summary["verdict"] == CRITICAL else 0

    def _start(self, first: Transmission) -> None:
        """The start line, with the time of the first transmission."""
        time, source, port = time_text(first.t_ns or 0), self._monitor.timing.source, self._files.port
        name, more = self._names[0], len(self._names) - 1
        if self._json:
            start = {"event": "start", "time": time, "file": name, "port": port, "baud": first.baud}
            output.json_line({**start, "source": source, **({"files": self._names} if more else {})})
        else:
            files = f"{name} and {more} more" if more else name
            where = f", port {port}" if port else ""
            output.line(f"{files}{where}, {baud_text(first.baud)}, from {time or 'an unknown time'}", "bold")

    def _remark(self, text: str) -> None:
        self._progress.clear()
        output.warn(text)

    def _show(self, happening: Happening) -> None:
        self._progress.clear()
        if self._json:
            output.json_line(happening.as_dict(self._monitor.begun_ns))
        elif not happening.routine:
            event_line(happening, self._monitor.begun_ns)
