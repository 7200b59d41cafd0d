"""``dpstack capture``: listens and keeps what it hears in a pcapng file, or explains it on the screen. Never sends."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
from datetime import UTC, datetime
from time import monotonic_ns, time_ns
from typing import Final

from dpstack import __version__
from dpstack.api.bus.events_json import PortLost, event_json
from dpstack.api.config.bus import AUTO
from dpstack.api.listen.capture_file import STDOUT, CaptureFile
from dpstack.api.listen.listening import Line, Listening, OctetsLost
from dpstack.capture.pcapng import PROFIBUS_DL, USER0
from dpstack.capture.recording import PortAbout, Recording
from dpstack.capture.transmission import Transmission
from dpstack.cli import options
from dpstack.cli.listening.telegram_lines import filter_argument, show
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.nonblocking_stdout import run_unhurried
from dpstack.cli.terminal.signals import INTERRUPTED, StopSignal
from dpstack.decode.filter import Match
from dpstack.decode.telegram import Explainer
from dpstack.errors import CaptureFileError, DpError, PortError
from dpstack.monitor.counters import Counters
from dpstack.monitor.evidence import finding
from dpstack.trace import Event
from dpstack.units import baud_text, ns_to_s

#: pause between two writes to the file, in s
_FLUSH_S: Final = 0.1
_OCTETS_ONLY: Final = (
    "link type 257 is PROFIBUS as registered, but tshark and Wireshark 4.0 have no dissector for it and show only "
    "octets; 147 works with `dpstack wireshark install`"
)
#: pause before the next look for a program that holds the port, in s
_AGAIN_S: Final = 0.5


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack capture --port /dev/ttyUSB0; dpstack capture --port /dev/ttyUSB0 --write bus.pcapng "
        "--seconds 60; dpstack capture --port /dev/ttyUSB0 --filter 'station 5 and retry'"
    )
    parser.value("--port", "P", "the port; also one that a run, sim or segment holds", required=True)
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
    parser.value("--filter", "EXPR", "only telegrams that it fits, see docs/decode.md", type=filter_argument)
    parser.value("--seconds", "S", "end after so many seconds", type=options.seconds)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 where the file cannot be written, or the port is lost for good."""
    if args.linktype == PROFIBUS_DL:
        output.warn(_OCTETS_ONLY)
    return run_unhurried(_Capture(args).run(), json=args.json)


class _Capture:
    """One capture: from the port to the file or the screen, and the summary."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._args = args
        self._json: bool = args.json
        self._filter: Match | None = args.filter
        #: standard output carries the file
        self._quiet = args.write == STDOUT
        self._file = None if args.write is None else CaptureFile(args.write)
        self._recording: Recording | None = None
        self._listening: Listening | None = None
        self._line: Line | None = None
        self._counters = Counters()
        self._explainer = Explainer()
        self._explains = self._file is None or self._filter is not None
        self._early: list[Event] = []  # before the start line
        self._kept = 0
        self._lost_chunks = 0
        self._gaps = 0
        self._too_slow = 0  # transmissions since the last flush that the disk was too slow for
        self._began = monotonic_ns()

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
            failure = await self._close() or failure
            self._summary()
        if failure is not None:
            raise failure
        return 0

    async def _work(self) -> None:
        """Listen until the time is over. Raises the errors of the port and of the file."""
        tasks = {asyncio.create_task(self._listen())}
        if self._file is not None:
            tasks.add(asyncio.create_task(self._write(self._file)))
        try:
            done, _ = await asyncio.wait(tasks, timeout=self._args.seconds, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _listen(self) -> None:
        """Listen to the port; where a program that held it ends, wait until one is there again."""
        baud = None if self._args.baud == AUTO else self._args.baud
        while True:
            own = self._line is None
            self._listening = None
            listening = Listening(self._args.port, baud, self._on_transmission, self._on_event, own=own)
            try:
                async with listening:
                    self._listening = listening
                    self._start(listening.line)
                    await listening.ended()
            except PortError as error:
                if self._line is None or self._line.program is None:
                    raise
                if self._listening is not None:
                    self._gap(monotonic_ns(), f"{error}; waiting until a program holds the port again")
            await asyncio.sleep(_AGAIN_S)

    async def _write(self, file: CaptureFile) -> None:
        while True:
            await asyncio.sleep(_FLUSH_S)
            await file.flush()
            if self._too_slow and file.has_room:
                count, self._too_slow = self._too_slow, 0
                self._gap(monotonic_ns(), f"the disk was too slow: {count} transmissions were not written", count)

    # --- what is heard ---
    def _start(self, line: Line) -> None:
        again = self._line is not None
        self._line = line
        if again:
            self._say(monotonic_ns(), "port", f"the {line.program} on {line.port} is back", lost=False)
            return
        if self._file is not None:
            about = PortAbout(line.port, line.source, line.paced, line.exact)
            self._recording = Recording(self._file, f"dpstack {__version__}", about, self._args.linktype)
        if self._json and not self._quiet:
            start = {"event": "start", "time": _now(), "port": line.port, "baud": line.baud}
            output.json_line({**start, "source": line.source, "program": line.program, "paced": line.paced})
        else:
            through = f" through the {line.program} that holds it" if line.program else ""
            rate = "the rate is searched" if line.baud is None else baud_text(line.baud)
            self._line_of_text(f"listening on {line.port}{through}, {rate}; nothing is sent (Ctrl-C ends)", "bold")
        early, self._early = self._early, []
        for event in early:
            self._on_event(event)

    def _on_transmission(self, one: Transmission) -> None:
        self._counters.add(one)
        if self._explains:
            explained = self._explainer.add(one)
            if self._filter is not None and not self._filter(explained):
                return
            if self._file is None:
                self._kept += 1
                show(explained, json=self._json)
                return
        if self._recording is None or self._file is None:
            return
        if self._too_slow or not self._file.has_room:
            self._too_slow += 1
        else:
            self._kept += 1
            self._recording.add(one)

    def _on_event(self, event: Event) -> None:
        if self._line is None:
            self._early.append(event)
            return
        match event:
            case OctetsLost(count=count):
                self._gap(event.t_ns, event.text, count)
            case PortLost():
                self._gap(event.t_ns, event.text)
            case _:
                line = event_json(event, self._seconds(event.t_ns)) or {}
                kind = str(line.pop("event", "notice"))
                self._say(event.t_ns, kind, event.text, **{k: v for k, v in line.items() if k not in ("t", "text")})

    def _gap(self, t_ns: int, cause: str, chunks: int = 0) -> None:
        self._gaps += 1
        self._lost_chunks += chunks
        if self._recording is not None:
            self._recording.gap(cause, chunks)
        self._say(t_ns, "gap", cause, lost_chunks=chunks)

    # --- the screen ---
    def _say(self, t_ns: int, kind: str, text: str, **fields: object) -> None:
        t = self._seconds(t_ns)
        if self._json and not self._quiet:
            output.json_line({"event": kind, "t": round(t, 6), **fields, "text": text})
        else:
            self._line_of_text(f"{t:9.3f} s  {text}", "yellow")

    def _line_of_text(self, text: str, style: str = "") -> None:
        if self._quiet:
            output.warn(text)
        else:
            output.line(text, style)

    def _seconds(self, t_ns: int) -> float:
        return ns_to_s(t_ns - self._began)

    async def _close(self) -> DpError | None:
        """Complete the file. Returns the error where it cannot be written."""
        if self._recording is None or self._file is None:
            return None
        if self._too_slow:
            self._recording.gap(f"the disk was too slow: {self._too_slow} transmissions were not written")
        self._recording.close(time_ns())
        try:
            await self._file.flush()
        except CaptureFileError as error:
            return error
        return None

    def _summary(self) -> None:
        counters, line = self._counters, self._line
        if line is None:
            return
        baud = counters.baud or line.baud
        seconds = self._seconds(monotonic_ns())
        if self._json and not self._quiet:
            summary: dict[str, object] = {
                "event": "summary",
                "time": _now(),
                "port": line.port,
                "baud": baud,
                "seconds": round(seconds, 3),
                "telegrams": counters.telegrams,
                "profibus": finding(counters).is_profibus,
                "octets": counters.octets,
                "damaged": counters.damaged,
                "lost_chunks": self._lost_chunks,
                "gaps": self._gaps,
                "kept": self._kept,
                "file": self._args.write,
            }
            output.json_line(summary)
            return
        damaged = ", ".join(f"{count} {cause}" for cause, count in counters.damaged.items()) or "none"
        kept = f"; {self._kept} kept in {self._args.write}" if self._file is not None else ""
        self._line_of_text(
            f"{counters.telegrams} telegrams in {seconds:.1f} s; damaged: {damaged}; lost chunks: {self._lost_chunks}, "
            f"gaps: {self._gaps}{kept}"
        )
        if counters.telegrams and not finding(counters).is_profibus:
            self._line_of_text(finding(counters).text, "yellow")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
