"""``dpstack capture``: listens and keeps what it hears in a pcapng file, or explains it on the screen. Never sends."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
from collections.abc import Mapping
from itertools import chain
from time import monotonic_ns, time, time_ns
from typing import Final, NamedTuple

from dpstack import __version__
from dpstack.api.bus.events_json import PortLost, event_json
from dpstack.api.listen.capture_file import STDOUT, CaptureFile, Ring
from dpstack.api.listen.listening import BaudFound, ListenedLine, OctetsLost
from dpstack.capture.pcapng import PROFIBUS_DL, USER0, Interface
from dpstack.capture.recording import Gaps, PortAbout, Recording
from dpstack.capture.timing import FILE, LineTiming
from dpstack.capture.transmission import Transmission
from dpstack.cli import options
from dpstack.cli.listening.port_listener import PortListener, start_json, start_text
from dpstack.cli.listening.source_file import add_channel, bus_in
from dpstack.cli.listening.telegram_lines import add_names_and_filter, names_of, show
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.nonblocking_stdout import run_unhurried
from dpstack.cli.terminal.signals import INTERRUPTED, StopSignal, first_of
from dpstack.decode.filter import Match
from dpstack.decode.telegram import Explained, Explainer
from dpstack.errors import CaptureFileError, DpError, UsageError
from dpstack.monitor.evidence import finding
from dpstack.monitor.triggers import Triggers, Window, parse_trigger
from dpstack.text import decimal, iso_time, some_of
from dpstack.trace import Event
from dpstack.units import AUTO, NEVER, baud_text, ns_to_s, s_to_ns

#: pause between two writes to the file, in s
_FLUSH_S: Final = 0.1
#: what is kept around a trigger, in s
_BEFORE_S: Final = 5.0
_AFTER_S: Final = 2.0
_OCTETS_ONLY: Final = (
    "link type 257 is PROFIBUS as registered, but tshark and Wireshark 4.0 have no dissector for it and show only "
    "octets; 147 works with `dpstack wireshark install`"
)
#: pause between two looks at the counters of the port, in s
_WATCH_S: Final = 1.0
#: transmissions of a file between two turns of the loop: 1 MB of blocks at most
_TURN: Final = 1000
#: memory of an explained telegram in octets, about
_EXPLAINED: Final = 2_000
_files = options.number(decimal, 2, 100_000, "number of files from 2 on")
_megabytes = options.number(float, 0.001, 1e6, "size in MB, 0.001 at least")
_period = options.number(float, 0, 3600, "number of seconds, below 3600")


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack capture --port /dev/ttyUSB0; dpstack capture --port /dev/ttyUSB0 --write bus.pcapng "
        "--seconds 60; dpstack capture --port /dev/ttyUSB0 --filter 'station 5 and retry'; "
        "dpstack capture --from bus.sr --write bus.pcapng"
    )
    parser.value("--port", "P", "the port; also one that a run, sim or segment holds")
    parser.value(
        "--from", "FILE", "a file in place of the port: of a logic analyser (.sr, VCD, CSV), or pcapng", dest="source"
    )
    add_channel(parser)
    parser.value(
        "--baud", "B|auto", 'rate in bit/s; "auto" (default): finds it', type=options.baud_or_auto, default=AUTO
    )
    parser.value("--write", "FILE", "a new pcapng file; - for standard output (default: explain on the screen)")
    parser.value(
        "--linktype",
        "147|257",
        "147 (default): USER0; 257: PROFIBUS, which Wireshark 4.0 shows as octets only",
        type=int,
        choices=(USER0, PROFIBUS_DL),
        default=USER0,
    )
    add_names_and_filter(parser)
    parser.value("--ring", "N", "keep N files at most, the oldest goes; needs --write and --size", type=_files)
    parser.value("--size", "MB", "of each file of the ring, in 10^6 octets", type=_megabytes)
    parser.value(
        "--trigger",
        "COND",
        'keep only what lies around it: lost, diagnosis, "retry>2", "bad fcs", "station 5", octets in hex (see '
        "docs/how-to/capture.md); may be given several times",
        type=options.parsed(parse_trigger),
        action="append",
        default=[],
    )
    parser.value("--before", "S", f"seconds to keep before a trigger (default {_BEFORE_S:g})", type=_period)
    parser.value("--after", "S", f"seconds to keep after a trigger (default {_AFTER_S:g})", type=_period)
    parser.value("--seconds", "S", "end after S seconds", type=options.seconds)
    parser.run_by(execute)


def _check(args: argparse.Namespace) -> None:
    """Raises UsageError for options that do not go together."""
    if (args.port is None) == (args.source is None):
        raise UsageError("capture: give either --port, for instance --port /dev/ttyUSB0, or --from FILE")
    if args.channel and args.source is None:
        raise UsageError("--channel is of a file: it needs --from FILE")
    if (args.ring is None) != (args.size is None):
        raise UsageError("--ring and --size belong together: number of files, and size of each in MB")
    if args.ring is not None and args.write in (None, STDOUT):
        raise UsageError("--ring needs --write FILE, by which its files are named")
    if not args.trigger and (args.before, args.after) != (None, None):
        raise UsageError("--before and --after need a --trigger")
    args.before = _BEFORE_S if args.before is None else args.before
    args.after = _AFTER_S if args.after is None else args.after


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if the file cannot be written, or the port is lost for good."""
    _check(args)
    if args.linktype == PROFIBUS_DL:
        output.warn(_OCTETS_ONLY)
    capture = _Capture(args) if args.source is None else _FileCapture(args)
    return run_unhurried(capture.run(), json=args.json)


class _Capture(PortListener):
    """One capture: from the port through filter and triggers to the file or the screen, and the summary."""

    def __init__(self, args: argparse.Namespace) -> None:
        super().__init__(args)
        names = names_of(args)
        self._filter: Match | None = args.filter
        #: standard output carries the file
        self._quiet = args.write == STDOUT
        ring = None if args.ring is None else Ring(args.ring, args.size)
        self._file = None if args.write is None else CaptureFile(args.write, ring)
        self._recording: Recording | None = None
        self._about: PortAbout | None = None
        self._triggers = Triggers(args.trigger)
        self._window: Window[_Heard] | None = None
        if args.trigger:
            self._window = Window(s_to_ns(args.before), s_to_ns(args.after))
        self._explainer = Explainer(names) if self._file is None or self._filter is not None else None
        self._gaps = Gaps()
        #: the last transmission, which the filter has not judged yet, with the reason of a trigger
        self._unjudged: tuple[Transmission, Explained, str] | None = None
        self._kept = 0
        self._too_slow = 0  # transmissions since the last flush that the disk was too slow for
        self._began = self._now()

    async def run(self) -> int:
        failure: DpError | None = None
        with StopSignal() as stop, self._file or contextlib.nullcontext():
            try:
                await stop.or_done(self._work())
            except DpError as error:
                if self._line is None:  # it never began
                    raise
                failure = error
            if stop.hurried:
                return INTERRUPTED
            if self._unjudged is not None:
                self._judge(*self._unjudged)
            self._look_at_port(_WATCH_S)
            failure = await self._close() or failure
            self._summary(whole=failure is None)
        if failure is not None:
            raise failure
        return 0

    async def _work(self) -> None:
        """Listen until the time is over. Raises the errors of the port and of the file."""
        works = [self._listen(self._on_transmission), self._watch_port()]
        if self._file is not None:
            works.append(self._write(self._file))
        await first_of(*works, timeout=self._args.seconds)

    def _interrupted(self, reason: str) -> None:
        self._lost(reason)
        self._say(self._now(), "notice", "waiting until a program holds the port again")

    async def _watch_port(self) -> None:
        while True:
            await asyncio.sleep(_WATCH_S)
            self._look_at_port(_WATCH_S)

    def _lost(self, text: str) -> None:
        self._gap(self._now(), text)

    async def _write(self, file: CaptureFile) -> None:
        while True:
            await asyncio.sleep(_FLUSH_S)
            await file.flush()
            if self._too_slow and file.has_room:
                count, self._too_slow = self._too_slow, 0
                self._gap(self._now(), f"the disk was too slow: {count} transmissions were not written", count)

    # --- what is heard ---
    def _is_back(self, line: ListenedLine, text: str) -> None:
        self._say(self._now(), "port", text, lost=False)

    def _started(self, line: ListenedLine) -> None:
        self._about = PortAbout(line.port, line.source, line.paced, line.exact, line.damaged)
        if self._json and not self._quiet:
            output.json_line({**start_json(line), "paced": line.paced})
        else:
            self._print(f"{start_text(line, 'the rate is searched')}; nothing is sent (Ctrl-C ends)", "bold")

    def _on_transmission(self, one: Transmission) -> None:
        reason = self._triggers.add(one)
        explained = None if self._explainer is None else self._explainer.add(one)
        if self._filter is None or explained is None:
            self._take(one, explained, reason)
            return
        before, self._unjudged = self._unjudged, (one, explained, reason)
        if before is not None:
            self._judge(*before)

    def _judge(self, one: Transmission, explained: Explained, reason: str) -> None:
        """Take what passes the filter. It knows whether a request was answered when the next telegram has come."""
        if self._filter is None or self._filter(explained):
            self._take(one, explained, reason)

    def _take(self, one: Transmission, explained: Explained | None, reason: str) -> None:
        heard = _Heard(one, explained, self._gaps.take())
        if self._window is None:
            self._keep(heard, "")
            return
        count = self._window.count
        size = len(one.octets) + (0 if explained is None else _EXPLAINED)
        keep = self._window.add(one.t_ns or 0, size, heard, reason)
        if self._window.count != count:
            self._say(self._now(), "trigger", f"trigger {count + 1}: {reason}", number=count + 1)
        for kept in keep:
            self._keep(kept.item, kept.remark)

    def _keep(self, heard: _Heard, remark: str) -> None:
        one, explained, gap = heard
        if self._file is None:
            self._kept += 1
            if explained is not None:
                show(explained, json=self._json)
        elif self._too_slow or not self._file.has_room:
            self._too_slow += 1
        else:
            self._kept += 1
            self._recording_for(one, self._file).add(one, remark, gap)

    def _recording_for(self, one: Transmission, file: CaptureFile) -> Recording:
        """The recording that ``one`` belongs to: a new one in a new file of a ring."""
        recording = self._recording
        if recording is not None and not file.is_full:
            return recording
        t_ns = one.t_ns or 0
        if recording is not None:
            recording.close(t_ns)
        if self._args.ring is not None:
            file.begin(t_ns)
        assert self._about is not None
        self._recording = Recording(
            file, f"dpstack {__version__}", self._about, self._gaps, linktype=self._args.linktype
        )
        return self._recording

    def _on_event(self, event: Event) -> None:
        match event:
            case OctetsLost(count=count):
                self._gap(event.t_ns, event.text, count)
            case PortLost():
                self._gap(event.t_ns, event.text)
            case BaudFound() if self._triggers.counters.octets:
                self._gap(event.t_ns, f"{event.text}; what was sent during the search for the rate is missing")
            case _:
                line = event_json(event, self._seconds(event.t_ns)) or {}
                kind = str(line.pop("event", "notice"))
                self._say(event.t_ns, kind, event.text, **{k: v for k, v in line.items() if k not in ("t", "text")})

    def _gap(self, t_ns: int, cause: str, chunks: int = 0) -> None:
        self._gaps.add(cause, chunks)
        self._say(t_ns, "gap", cause, lost_chunks=chunks)

    # --- the screen ---
    def _say(self, t_ns: int, kind: str, text: str, **fields: object) -> None:
        t = self._seconds(t_ns)
        if self._json and not self._quiet:
            output.json_line({"event": kind, "t": round(t, 6), **fields, "text": text})
        else:
            self._print(f"{t:9.3f} s  {text}", "yellow")

    def _print(self, text: str, style: str = "") -> None:
        if self._quiet:
            output.warn(text)
        else:
            output.line(text, style)

    def _now(self) -> int:
        """The time of what is heard now, in ns, as ``t`` of the lines counts it."""
        return monotonic_ns()

    def _end_ns(self) -> int:
        """The time of the end, in ns since 1970 as the transmissions have it."""
        return time_ns()

    def _seconds(self, t_ns: int) -> float:
        return ns_to_s(t_ns - self._began)

    async def _close(self) -> DpError | None:
        """Complete the file. Returns the error if it cannot be written."""
        if self._file is None:
            return None
        if self._too_slow:
            self._gaps.add(f"the disk was too slow: {self._too_slow} transmissions were not written", self._too_slow)
        try:
            if self._recording is not None:
                self._recording.close(self._end_ns())
            await self._file.flush(last=True)
        except CaptureFileError as error:
            return error
        return None

    def _summary(self, *, whole: bool) -> None:
        """``whole``: all that was kept is in the file."""
        counters, line, gaps = self._triggers.counters, self._line, self._gaps
        if line is None:
            return
        baud = counters.baud or line.baud
        seconds = self._seconds(self._now())
        found = finding(counters)
        windows = None if self._window is None else self._window.count
        files = [] if self._file is None else [str(path) for path in self._file.paths]
        if self._json and not self._quiet:
            summary: dict[str, object] = {
                "event": "summary",
                "time": iso_time(time()),
                "port": line.port,
                "baud": baud,
                "seconds": round(seconds, 3),
                "telegrams": counters.telegrams,
                "octets": counters.octets,
                "damaged": counters.damaged,
                "port_damage": self._port_damage,
                "profibus": found.is_profibus,
                "evidence": found.text,
                "lost_chunks": gaps.chunks,
                "gaps": gaps.count,
                "kept": self._kept if whole else None,
                "files": files,
                "windows": windows,
                "triggers": self._triggers.fired,
            }
            output.json_line(summary)
            return
        damaged = _counts(counters.damaged) or "none"
        by_port = f"; counted by the port: {_counts(self._port_damage)}" if self._port_damage else ""
        self._print(
            f"{counters.telegrams} telegrams in {seconds:.1f} s; damaged: {damaged}{by_port}; "
            f"lost chunks: {gaps.chunks}, gaps: {gaps.count}"
        )
        if counters.telegrams and not found.is_profibus:
            self._print(found.text, "yellow")
        if windows is not None:
            self._print(f"triggers: {_counts(self._triggers.fired)}; {windows} windows")
        if self._file is not None and whole:
            places = some_of(files) if files else self._file.name
            self._print(f"{self._kept} transmissions kept in {places}" if self._kept else "nothing was kept")


class _FileCapture(_Capture):
    """A file in place of a port. All times are those of the file."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._t_ns = 0
        super().__init__(args)

    async def _work(self) -> None:
        args, file = self._args, self._file
        limit_ns = NEVER if args.seconds is None else s_to_ns(args.seconds)
        batches = bus_in(args.source, self._interface, baud=args.baud, channel=args.channel)
        for number, one in enumerate(chain.from_iterable(batches)):
            self._t_ns = one.t_ns or 0
            if not number:
                self._begin_file(one)
            if self._t_ns - self._began >= limit_ns:
                break
            self._on_transmission(one)
            if number % _TURN == 0:
                await asyncio.sleep(0)  # Ctrl-C
                if file is not None:
                    await file.flush()
        if self._line is None:
            output.warn(f"{args.source}: no transmissions")

    def _interface(self, interface: Interface) -> None:
        timing = LineTiming.parse(interface.description)
        self._about = PortAbout(interface.name, timing.source, paced=True, timing=timing)

    def _begin_file(self, first: Transmission) -> None:
        about = self._about or PortAbout(self._args.source, FILE, paced=True, timing=LineTiming(FILE, None))
        self._about, self._began = about, self._t_ns
        self._line = ListenedLine(self._args.source, about.source, None, first.baud, paced=True)
        if self._json and not self._quiet:
            output.json_line({**start_json(self._line), "paced": True})
        else:
            self._print(f"reading {self._args.source}, {about.name}, {baud_text(first.baud)}", "bold")

    def _now(self) -> int:
        return self._t_ns

    _end_ns = _now


class _Heard(NamedTuple):
    """A transmission; ``explained`` if the screen or the filter needs it; ``gap``: what is missing before it."""

    one: Transmission
    explained: Explained | None
    gap: str


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items())
