"""Ctrl-Z and ``fg``: the bus goes to Clear with safe values before the program is stopped.

The terminal's Ctrl-Z sends SIGTSTP to the whole group; this program handles it and stops the group by SIGSTOP when the
outputs are safe. A bus process does not react to SIGTSTP while its application has a handler for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Final, Protocol

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.config.bus import SAFE
from dpstack.cli.terminal import output
from dpstack.errors import DpError

#: s in which the bus must reach Clear; then the group is stopped anyway, and watchdogs make the outputs safe
_CLEAR_S: Final = 3.0
#: rounds in Clear: each slave gets its outputs at least once
_ROUNDS: Final = 2
_POLL_S: Final = 0.01
_OPERATE: Final = "OPERATE"
#: pause between looks whether the program is in the foreground again
_FOREGROUND_S: Final = 0.3


class Screen(Protocol):
    """A user of the terminal that gives it back for the time in which the program is stopped."""

    @property
    def up(self) -> bool:
        """Whether it draws, or would."""

    @property
    def in_foreground(self) -> bool:
        """Whether this program may use its terminal."""

    async def leave(self) -> None:
        """Give the terminal back."""

    def come_back(self) -> None:
        """Take the terminal again."""


class Suspension:
    """Handles SIGTSTP for ``bus`` while in its context; ``screen``: the live screen, or None; ``name``: the program's
    name for ``dpstack ctl``."""

    def __init__(self, bus: Bus, name: Callable[[], str]) -> None:
        self.screen: Screen | None = None
        self.name = name
        self._bus = bus
        self._loop = asyncio.get_running_loop()
        self._task: asyncio.Task[None] | None = None
        self._old: object = None

    def __enter__(self) -> Suspension:
        if hasattr(signal, "SIGTSTP") and signal.getsignal(signal.SIGTSTP) is not signal.SIG_IGN:
            self._old = signal.signal(signal.SIGTSTP, self._caught)
        return self

    def __exit__(self, *_: object) -> None:
        if self._old is not None:
            signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        if self._task is not None:
            self._task.cancel()

    def _caught(self, _number: int, _frame: FrameType | None) -> None:
        self._loop.call_soon_threadsafe(self.begin)

    def begin(self) -> None:
        """Stop the program for a while, unless that has begun already."""
        if self._task is None or self._task.done():
            self._task = self._loop.create_task(self._suspend())

    async def _suspend(self) -> None:
        bus, screen = self._bus, self.screen
        operated = bus.is_open and bus.mode.name == _OPERATE
        if operated:
            await self._clear()
        if screen is not None:
            await screen.leave()
        if _is_orphaned():
            output.warn("not stopped: no shell could continue this program (it has no job control)")
        else:
            await asyncio.sleep(_POLL_S)  # what was printed goes to the terminal first
            os.killpg(0, signal.SIGSTOP)  # here the program stands until `fg` or `bg`
            await asyncio.sleep(0)
        if operated and bus.is_open:
            await self._go_on()
        if screen is not None:
            await _until(lambda: not screen.up or screen.in_foreground, _FOREGROUND_S)
            screen.come_back()

    async def _clear(self) -> None:
        """Clear, with safe values for every slave; at most :data:`_CLEAR_S`."""
        bus = self._bus
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_CLEAR_S):
                try:
                    await bus.clear()
                    await _until(lambda: bus.mode.name != _OPERATE)
                    last = core_of(bus).view.rotations + _ROUNDS
                    await _until(
                        lambda: core_of(bus).view.rotations >= last or not any(s.ready_now for s in bus.slaves)
                    )
                except DpError as error:
                    output.warn(f"the bus did not go to Clear: {error}")
                return
        output.warn(f"the bus did not reach Clear within {_CLEAR_S:g} s: the slaves' watchdogs make the outputs safe")

    async def _go_on(self) -> None:
        bus = self._bus
        if bus.config.bus.after_stall == SAFE:
            output.warn(f"in Clear since it was stopped; dpstack ctl {self.name()} operate lets outputs out again")
            return
        try:
            await bus.operate()
        except DpError as error:
            output.warn(f"the bus did not go to Operate: {error}")


async def _until(condition: Callable[[], bool], pause_s: float = _POLL_S) -> None:
    while not condition():  # noqa: ASYNC110 -- neither the counters nor the terminal's owner have an event
        await asyncio.sleep(pause_s)


def _is_orphaned() -> bool:
    """Whether nobody of this session outside of this process group could continue it (then the system ignores Ctrl-Z,
    too)."""
    group, pid = os.getpgrp(), os.getpid()
    try:
        while os.getpgid(pid) == group:
            pid = int(
                Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rsplit(")", 1)[1].split()[1]
            )
            if not pid:
                return True
        return os.getsid(pid) != os.getsid(0)
    except (OSError, ValueError, IndexError):
        return True
