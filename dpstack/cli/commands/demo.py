"""``dpstack demo``: every known drive, simulated, under one master in one process."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
from collections import Counter, deque
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.compose import Case
from dpstack.api.bus.opening import open_bus
from dpstack.api.bus.virtual import run_virtual
from dpstack.api.config.config import Config, make_config
from dpstack.api.control.handlers import control_run
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.slave.drive import Drive
from dpstack.cli import options
from dpstack.cli.commands.demo_stories import OTHERS, STORIES
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import drawing, output
from dpstack.cli.terminal.report import Reporter, not_exchanging
from dpstack.cli.terminal.signals import INTERRUPTED, StopSignal
from dpstack.devices import finding
from dpstack.errors import ConfigError, DpError, UsageError
from dpstack.profile import DriveProfile, registry
from dpstack.tcp_address import Listen
from dpstack.text import printable
from dpstack.web import PAGE
from dpstack.web.child import Child

_BAUD = 500_000
_MASTER = 2
#: bus time after which a story that is not at its end has failed, in s
_PATIENCE_S = 120.0
#: measured and planned rotation may differ by this much
_TOLERANCE = 0.02
_REFRESH_S = 0.1
#: pause in s before a drive runs again
_REST_S = 3.0
#: lines of the stories under the live table, at most
_SHOWN = 15
#: half of the speed bar, in characters
_BAR = 6


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack demo --seconds 20\n         dpstack demo --web"
    parser.value("--seconds", "S", "go on for S seconds at least", type=options.seconds)
    parser.value("--baud", "B", f"the rate (default {_BAUD})", type=options.baud, default=_BAUD)
    parser.flag("--fast", "as fast as this computer can, not in real time")
    parser.flag("--web", "serve a page that shows the plant in the browser, and go on until Ctrl-C")
    parser.value("--listen", "HOST:PORT", f"the address of the page (default {PAGE})", default=None)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 0 when every story ended and the measured rotation time is the planned one."""
    if args.web:
        options.require("aiohttp", "dpstack demo --web", "web")
        Listen.parse(args.listen or PAGE)
    if args.listen is not None and not args.web:
        raise UsageError("demo: --listen is the address of the page; add --web")
    if args.web and args.fast:
        raise UsageError("demo: --fast is over before a page is open; leave out one of --web and --fast")
    for name, drive in _drives().items():
        if drive.device_factory is None and not args.json:
            output.line(f"{name} has no simulated drive: left out")
    return run_virtual(_demo(plant(args.baud), args), paced=not args.fast)


def _drives() -> dict[str, DriveProfile]:
    return {name: finding.find(name) for name in STORIES} | registry.known()


def plant(baud: int) -> Config:
    """Every plugin and every drive with a story, if it can be simulated, at an address of its own, called by its maker,
    or by its full name if there are several of that maker. One master alone: GAP is off, the rotation is the shortest.
    """
    drives = {name: drive for name, drive in _drives().items() if drive.device_factory is not None}
    names = sorted(drives)
    if not names:
        raise ConfigError("no drive is known; install dpstack with `pip install .` or `make demo`")
    slaves: list[dict[str, object]] = []
    makers = Counter(name.partition("-")[0] for name in names)
    for address, name in enumerate(names, _MASTER + 1):
        maker = name.partition("-")[0]
        called = maker if makers[maker] == 1 else name
        table: dict[str, object] = {"name": called, "address": address, "drive": name}
        telegram = STORIES.get(name, OTHERS).telegram
        if telegram is not None:
            table["telegram"] = telegram
        setting = drives[name].rate_setting
        if setting is not None:
            value = next((value for value, rate in setting.rates.items() if rate == baud), None)
            table["options"] = {} if value is None else {setting.option: value}
        slaves.append(table)
    return make_config("virtual", baud, _MASTER, slaves, where="demo", bus={"gap": 0})


@dataclass(slots=True)
class _Stage:
    """State of the running stories: their last lines, which ended, which failed."""

    bus: Bus
    json: bool
    live: bool
    lines: deque[str] = field(default_factory=lambda: deque(maxlen=_SHOWN))
    ended: set[int] = field(default_factory=set)
    failures: list[str] = field(default_factory=list)
    #: the address of the page, once it is served
    url: str = ""

    async def play(self, drive: Drive, *, again: bool = False) -> None:
        """Play the story of ``drive``; with ``again`` let it run and stop without end afterwards."""
        address = drive.slave.address
        kind = drive.slave.config.profile
        story = STORIES.get(kind.name if kind else "", OTHERS)
        try:
            async with asyncio.timeout(_PATIENCE_S):
                await drive.slave.ready(_PATIENCE_S)
                self.tell(drive, "in data exchange")
                await story.play(drive, lambda text: self.tell(drive, text), lambda code: self.trip(drive, code))
            self.ended.add(address)
            self.tell(drive, "the end")
            while again:
                await asyncio.sleep(_REST_S)
                async with asyncio.timeout(_PATIENCE_S):
                    await OTHERS.play(drive, lambda _: None, lambda _: None)
        except (DpError, TimeoutError) as error:
            text = str(error) or f"its story did not come to its end in {_PATIENCE_S:g} s"
            self.failures.append(text)
            self.tell(drive, text)

    def trip(self, drive: Drive, code: str) -> None:
        """Inject a fault into the simulated drive, as ``dpstack ctl PORT trip`` does."""
        bench = core_of(self.bus).bench
        assert bench is not None
        slave_handlers(bench)["trip"]([str(drive.slave.address), code])

    def tell(self, drive: Drive, text: str) -> None:
        address, t = drive.slave.address, self.bus.seconds
        line = f"{t:9.3f} s  {drive.name}: {text}"
        self.lines.append(line)
        if self.json:
            output.json_line({"event": "story", "t": round(t, 6), "address": address, "name": drive.name, "text": text})
        elif not self.live:
            output.line(line)

    def picture(self) -> Group:
        """The live table, a row for each drive, and below it as many lines of the stories as fit on the terminal."""
        bus = self.bus
        p50 = core_of(bus).view.counters().rotation.quantile_ns(0.5) / 1e6
        title = f"dpstack demo  {bus.seconds:6.1f} s  rotation {p50:.3f} ms"
        rows = []
        for drive in bus.drives:
            slave, status = drive.slave, drive.status
            state = str(status.state) if slave.ready_now else slave.state.value
            speed = "" if status.speed is None else f"{status.speed:7.1%} {_bar(status.speed)}"
            rows.append((slave.address, drive.name, f"{state:<19}", f"{speed:<21}", slave.exchanges))
        console = Console()
        table = drawing.rich_table(title, ("address", "drive", "state", "speed", "exchanges"), rows, console.width)
        page = [Text(f"the page is at {self.url}")] if self.url else []
        room = min(_SHOWN, max(1, console.height - len(console.render_lines(table)) - 1 - len(page)))
        shown = [line for text in self.lines for line in Text(printable(text)).wrap(console, console.width)][-room:]
        return Group(table, *page, *shown, *[""] * (room - len(shown)))


def _bar(speed: float) -> str:
    """A bar from the middle: reverse to the left, forward to the right. No spaces: rich would wrap it there."""
    length = min(_BAR, round(abs(speed) * _BAR))
    back, forth = ("█" * length, "") if speed < 0 else ("", "█" * length)
    return f"{back:·>{_BAR}}|{forth:·<{_BAR}}"


async def _demo(config: Config, args: argparse.Namespace) -> int:
    live = output.on_terminal() and not args.json
    bus = open_bus(config, on_event=lambda event: reporter.event(event))
    reporter = Reporter(bus, json=args.json, quiet=live)
    stage = _Stage(bus, args.json, live)
    with StopSignal() as stop:
        try:
            await stop.or_done(bus.open())
            reporter.start()
            async with _page(stage, args, stop) if args.web and bus.is_open else contextlib.nullcontext():
                if bus.is_open:
                    await bus.operate()
                    await stop.or_done(_play(stage, args.seconds, again=args.web))
                stats, missing = bus.stats, not_exchanging(bus)
        finally:
            await bus.close()
    if stop.hurried:
        return INTERRUPTED
    planned = bus.plan.rotation_ns(Case.SHORTEST)
    measured = core_of(bus).view.counters().rotation.quantile_ns(0.5)
    off = measured / planned - 1
    extra = {"planned_us": round(planned / 1000, 1), "stories": {"ended": len(stage.ended), "of": len(bus.drives)}}
    reporter.summary(stats, **extra)
    if not args.json:
        output.line(f"planned {planned / 1e6:.3f} ms, measured {measured / 1e6:.3f} ms ({off:+.1%})", "bold")
    problems = list(stage.failures)
    if not (stop.received and args.web):  # the page is closed at any time, also before all drives run
        problems += missing
        if stop.received and len(stage.ended) < len(bus.drives):
            problems.append("interrupted before the stories came to their end")
        if not problems and abs(off) > _TOLERANCE:
            problems.append(f"the rotation is {off:+.1%} off the plan")
    for problem in problems:
        output.warn(problem)
    return 1 if problems else 0


@contextlib.asynccontextmanager
async def _page(stage: _Stage, args: argparse.Namespace, stop: StopSignal) -> AsyncIterator[None]:
    """Within, a web server shows the plant: a process of its own, which joins the demo through its control socket. The
    demo ends if that cannot be."""

    def note(line: str) -> None:
        found = json.loads(line)
        if found.get("event") == "listening":
            stage.url = found["url"]
            if args.json:
                output.json_line(found)
            elif not stage.live:
                output.line(f"the page is at {stage.url}")

    async def watch() -> None:
        await server.wait()
        stage.failures.append(f"the page: {server.last_line}")
        stop.stop()

    async with control_run(stage.bus, stage.bus.config.port, stop=stop.stop, kind="demo") as control:
        words = ("web", "--join", control.name, "--listen", args.listen or PAGE, "--json")
        server = Child(words, lambda _: None, note)
        await server.start()
        watching = asyncio.ensure_future(watch())
        try:
            yield
        finally:
            watching.cancel()
            await server.end()


async def _play(stage: _Stage, seconds: float | None, *, again: bool) -> None:
    stories = [asyncio.ensure_future(stage.play(drive, again=again)) for drive in stage.bus.drives]
    if seconds is not None:
        stories.append(asyncio.ensure_future(asyncio.sleep(max(0.0, seconds - stage.bus.seconds))))
    try:
        if stage.live:
            await _watched(stage, stories)
        else:
            await asyncio.gather(*stories)
    finally:
        for story in stories:
            story.cancel()


async def _watched(stage: _Stage, stories: Sequence[asyncio.Future[None]]) -> None:
    """Redraw the live table every :data:`_REFRESH_S` until all stories have ended."""
    with output.guarded(), Live(stage.picture(), auto_refresh=False) as live:
        pending = set(stories)
        while pending:
            _, pending = await asyncio.wait(pending, timeout=_REFRESH_S)
            live.update(stage.picture(), refresh=True)
    await asyncio.gather(*stories)
