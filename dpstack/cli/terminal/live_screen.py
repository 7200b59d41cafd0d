"""The live screen of ``dpstack run``: when there is one, its orders, and the lines that wait for its end."""

from __future__ import annotations

import asyncio
import contextlib
import io
import os
import signal
import sys
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Mapping
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.control.commands import NOW
from dpstack.api.control.handlers import set_values
from dpstack.cli.terminal import output
from dpstack.cli.terminal.report import Reporter
from dpstack.cli.terminal.signals import StopSignal, before_leaving
from dpstack.cli.terminal.suspension import Suspension
from dpstack.errors import DpError, UsageError
from dpstack.plant.orders import RefusedOrder
from dpstack.screen.process import GONE, ScreenProcess, Terminal, is_installed
from dpstack.trace import Severity

#: lines of standard error that are kept until the screen has ended
_LINES: Final = 200
#: seconds between two snapshots: as fast as eyes follow, and half the cost of the stream's default
_INTERVAL_S: Final = 0.2
#: of orders, in log and events
_ORIGIN: Final = "screen"
_HINT: Final = "for a live screen instead of these lines: pip install 'dpstack[screen]'"


def terminal_for_screen() -> Terminal | None:
    """The terminal of this program, if a live screen can be drawn on it; None: plain lines."""
    if not output.redraws() or (sys.stdout.encoding or "").lower().replace("-", "") != "utf8":
        return None
    try:
        fd = sys.stdout.fileno()
        if os.ttyname(sys.stdin.fileno()) != os.ttyname(fd):
            return None
        terminal = Terminal(fd)
    except (OSError, ValueError, AttributeError, DpError):  # no terminal, or a system without its functions
        return None
    if not terminal.in_foreground:
        return None
    if not is_installed():
        output.line(_HINT)
        return None
    return terminal


class LiveScreen:
    """The screen of ``bus``, whose program ``dpstack ctl`` knows by ``name``; ``suspend`` is called for Ctrl-Z after
    the person's yes.

    Use it as an async context manager. While it is up, ``reporter`` is quiet, and lines of both standard streams go
    to the events of the screen; those of standard error are printed after its end. If its process ends by itself, plain
    lines go on.
    """

    def __init__(
        self, terminal: Terminal, bus: Bus, stop: StopSignal, reporter: Reporter, name: Callable[[], str]
    ) -> None:
        self.suspend: Callable[[], None] = lambda: None
        self._name = name
        self._terminal = terminal
        self._bus = bus
        self._stop = stop
        self._reporter = reporter
        self._process = ScreenProcess(terminal, self._take)
        self._showing: asyncio.Task[None] | None = None
        self._answers: set[asyncio.Task[None]] = set()
        self._streams = sys.stdout, sys.stderr
        self._held = _HeldLines(partial(self._told, "info")), _HeldLines(partial(self._told, "warning"))
        self._ended = False

    @property
    def up(self) -> bool:
        return self._showing is not None and not self._ended

    @property
    def in_foreground(self) -> bool:
        return self._terminal.in_foreground

    async def __aenter__(self) -> LiveScreen:
        try:
            await self._process.start()
        except OSError as error:
            output.warn(f"no live screen: {error.strerror}")
            self._ended = True
            return self
        self._hush()
        before_leaving.append(self._process.kill)
        self._showing = asyncio.create_task(self._show())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._showing is not None and not self._ended:
            self._showing.cancel()
            await asyncio.gather(self._showing, return_exceptions=True)
            await self._over()
        for task in self._answers:
            task.cancel()

    def note(self, text: str) -> None:
        """One line at the head of the screen."""
        self._process.tell({"screen": "note", "text": text})

    async def leave(self) -> None:
        """Give the terminal back for a while; lines go to it until :meth:`come_back`."""
        if self.up:
            await self._process.leave()
            self._speak()

    def come_back(self) -> None:
        if self.up:
            self._hush()
            self._process.come_back()

    async def _show(self) -> None:
        await self._process.show(self._bus.live(_INTERVAL_S), self._name)
        code = await self._over()
        if code == GONE:
            self._terminal_lost()
        else:
            how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended (exit code {code})"
            output.warn(f"the live screen {how}: plain lines from here on")

    async def _over(self) -> int:
        self._ended = True
        code = await self._process.end()
        before_leaving.remove(self._process.kill)
        self._speak()
        return code

    def _hush(self) -> None:
        """Nothing but the screen writes to the terminal."""
        self._reporter.quiet = True
        self._streams = sys.stdout, sys.stderr
        sys.stdout, sys.stderr = self._held

    def _speak(self) -> None:
        """Standard error and the lines of the bus go to the terminal again."""
        if sys.stderr is self._held[1]:
            sys.stdout, sys.stderr = self._streams
        self._reporter.quiet = False
        self._held[0].take()
        for line in self._held[1].take():
            with contextlib.suppress(OSError):
                print(line, file=sys.stderr, flush=True)

    def _terminal_lost(self) -> None:
        """The terminal's end is the ordered end, as SIGHUP is; not if that is ignored (nohup)."""
        if not output.hangup_is_ignored():
            self._stop.stop()

    def _told(self, severity: str, line: str) -> None:
        """A line of a standard stream, for the events of the screen."""
        event = {"event": "notice", "severity": severity, "text": line.removeprefix("dpstack: ").strip()}
        self._process.tell({"event": event | {"time": datetime.now(UTC).isoformat(timespec="milliseconds")}})

    # --- orders ---------------------------------------------------------------------------------------------------

    def _take(self, order: Mapping[str, Any]) -> None:
        match order:
            case {"order": "interrupt"}:
                self.note("the run ends: outputs go to their safe values")
                signal.raise_signal(signal.SIGINT)
            case {"order": "suspend"}:
                self.suspend()
            case {"order": "why", "slave": int(address)}:
                self._begin(self._answer_why(address))
            case {"order": "set", "text": str(text)}:
                self._begin(self._carry_out(f"set {text}", lambda: set_values(self._bus, [NOW, text])))
            case {"order": "release", "slave": int(address)}:
                self._begin(self._carry_out(f"mirror {address}", lambda: self._release(address)))

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._answers.add(task)
        task.add_done_callback(self._answers.discard)

    async def _carry_out(self, order: str, act: Callable[[], Awaitable[object]]) -> None:
        """Carry out an order of the person at the keys. The run's log has it, and its reason if it is refused."""
        core = core_of(self._bus)
        try:
            result = await act()
        except DpError as error:
            core.refused_orders.add(RefusedOrder(order, str(error), _ORIGIN))
            answer = {"text": f"{order}: refused: {error}", "severity": "warning"}
        else:
            core.notice(_ORIGIN, f"order {order}", Severity.INFO)
            answer = {"text": f"{order}: {'done' if result is None else result}", "severity": "info"}
        self._process.tell({"answer": answer})

    async def _release(self, address: int) -> object:
        """Let a simulated slave make its inputs itself again. Raises UsageError on a real bus."""
        core = core_of(self._bus)
        if core.bench is None:
            raise UsageError("this run simulates no slaves")
        from dpstack.api.control.simulation_handlers import slave_handlers  # here, as a real bus simulates no slaves

        return slave_handlers(core.bench, core)["mirror"]([str(address)])

    async def _answer_why(self, address: int) -> None:
        answer: dict[str, Any] = {"slave": address}
        try:
            answer["story"] = (await self._bus.why(address)).as_dict()
        except DpError as error:
            answer["error"] = str(error)
        self._process.tell({"why": answer})


class _HeldLines(io.TextIOBase):
    """Takes the place of a standard stream: keeps whole lines, the last ones, and hands on each."""

    def __init__(self, told: Callable[[str], None]) -> None:
        self._told = told
        self._lines: deque[str] = deque(maxlen=_LINES)
        self._begun = ""

    def write(self, text: str) -> int:
        *lines, self._begun = (self._begun + text).split("\n")
        self._begun = self._begun[-10_000:]
        for line in lines:
            self._lines.append(line)
            self._told(line)
        return len(text)

    def writable(self) -> bool:
        return True

    def take(self) -> list[str]:
        """The kept lines; they are not kept any more."""
        lines = list(self._lines) + ([self._begun] if self._begun else [])
        self._lines.clear()
        self._begun = ""
        return lines


@contextlib.asynccontextmanager
async def live_screen(bus: Bus, stop: StopSignal, reporter: Reporter, suspension: Suspension) -> AsyncIterator[None]:
    """Within, the screen is up, if the terminal can show it."""
    terminal = terminal_for_screen()
    if terminal is None:
        yield
        return
    screen = LiveScreen(terminal, bus, stop, reporter, suspension.name)
    async with screen:
        screen.suspend, suspension.screen = suspension.begin, screen
        yield
    suspension.screen = None
