"""Likely causes of slaves that are not in data exchange, in the output of ``dpstack run``.

They follow from what the master has seen; nothing is asked of a slave, and the end of the run waits for nothing.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shlex
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.events_json import Event, SlaveFaulted
from dpstack.api.streams import load_beside
from dpstack.cli.terminal import output
from dpstack.errors import DpError

if TYPE_CHECKING:
    from pathlib import Path

    from dpstack.why.story import Story

#: notices for one slave at most: a slave that is brought up again and again would fill the log
_MOST_LINES: Final = 3
#: time limit in s for the last bring-ups of all slaves: a bus process that does not answer must not delay the end
_LIMIT_S: Final = 0.5
#: instead of an address: all slaves
_ALL: Final = -1
#: where the stories are made; a run without faults never loads them
_WHY: Final = ("dpstack.api.bus.why", "dpstack.why.story")
#: columns of lines that go into a pipe or a file
WIDTH: Final = 100


def columns() -> int:
    """Columns of a line of text."""
    if not output.on_terminal():
        return WIDTH
    import shutil  # here, as only a terminal has a width

    return shutil.get_terminal_size().columns


class CauseLines:
    """Notices of the likeliest cause after faults of slaves, and the stories of those missing at the end of the run."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._told: dict[int, set[str]] = {}
        #: addresses of the slaves that had a fault
        self._faulted: set[int] = set()
        self._tasks: set[asyncio.Task[None]] = set()

    def event(self, event: Event) -> None:
        """Publish a notice after a fault of a slave: its likeliest cause, and the command that says more. So it is on
        the screen, on the page and in the log as well."""
        if not isinstance(event, SlaveFaulted):
            return
        self._faulted.add(event.address)
        if len(self._told.get(event.address, ())) >= _MOST_LINES:
            return
        with contextlib.suppress(RuntimeError):  # no loop: the bus ends by itself
            task = asyncio.get_running_loop().create_task(self._tell(event))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _tell(self, event: SlaveFaulted) -> None:
        with contextlib.suppress(DpError):  # it was removed, or the bus has ended
            story = await self._bus.why(event.address, ask=False)
            from dpstack.why.story import ALL_SILENT, HEALTHY  # here, as a run without faults never needs it

            file = self._bus.config.file
            command = f"dpstack why {'CONFIG' if file is None else shlex.quote(_typed(file))}"
            who, about = event.who, event.address
            if story.first.cause == ALL_SILENT:  # one cause, one notice
                who, about = f"all {sum(not slave.deactivated for slave in self._bus.slaves)} slaves", _ALL
            else:
                command += f" {shlex.quote(event.name)}"
            told = self._told.setdefault(about, set())
            if story.first.cause == HEALTHY or story.first.cause in told:
                return
            told.add(story.first.cause)
            core_of(self._bus).notice("why", f"{who}: likely {story.line}; {command}")

    async def stories(self) -> Mapping[int, Story]:
        """The story of each slave that is not in data exchange, or flaps, by address."""
        for task in self._tasks:
            task.cancel()
        found: dict[int, Story] = {}
        served = [slave for slave in self._bus.slaves if not slave.deactivated]
        missing = [slave for slave in served if not slave.ready_now]
        missing += [slave for slave in served if slave.ready_now and slave.address in self._faulted]
        if missing:
            await load_beside(*_WHY)  # before the time limit
        with contextlib.suppress(TimeoutError, DpError):
            async with asyncio.timeout(_LIMIT_S):
                for slave in missing:
                    exchanging = slave.ready_now
                    story = await self._bus.why(slave, ask=False)
                    if story.flaps or not exchanging:
                        found[slave.address] = story
        return found


def flapping(stories: Mapping[int, Story]) -> list[str]:
    """One line for each slave that is in data exchange at the end by chance."""
    said = "flaps: it is in data exchange at this moment, but has left it several times"
    return [f"slave {story.address} ({story.slave}) {said}" for story in stories.values() if story.flaps]


def show(stories: Mapping[int, Story]) -> None:
    """Write the causes of each story."""
    if not stories:
        return
    from dpstack.why.story import story_lines  # here, as it is needed only if a slave is missing

    for story in stories.values():
        for line in story_lines(story.as_dict(), columns(), steps=False):
            output.line(line)


def as_json(stories: Mapping[int, Story]) -> dict[str, Any]:
    """The key ``why`` of the summary, by address; empty if no slave is missing."""
    return {"why": {str(address): story.as_dict() for address, story in stories.items()}} if stories else {}


def _typed(file: Path) -> str:
    """``file`` as one types it here: below the working directory without that."""
    with contextlib.suppress(OSError, ValueError):  # no working directory, or another drive
        return str(file.relative_to(os.path.realpath(os.curdir)))
    return str(file)
