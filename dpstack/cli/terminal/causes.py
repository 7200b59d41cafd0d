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
        self._tasks: set[asyncio.Task[None]] = set()

    def event(self, event: Event) -> None:
        """Publish a notice after a fault of a slave: its likeliest cause, and the command that says more. So it is on
        the screen, on the page and in the log as well."""
        if not isinstance(event, SlaveFaulted) or len(self._told.get(event.address, ())) >= _MOST_LINES:
            return
        with contextlib.suppress(RuntimeError):  # no loop: the bus ends by itself
            task = asyncio.get_running_loop().create_task(self._tell(event))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _tell(self, event: SlaveFaulted) -> None:
        with contextlib.suppress(DpError):  # it was removed, or the bus has ended
            story = await self._bus.why(event.address, ask=False)
            from dpstack.why.story import HEALTHY  # here, as a run without faults never needs it

            told = self._told.setdefault(event.address, set())
            if story.first.cause == HEALTHY or story.first.cause in told:
                return
            told.add(story.first.cause)
            file = self._bus.config.file
            config = "CONFIG" if file is None else shlex.quote(_typed(file))
            likely = f"{story.first.cause} ({round(100 * story.first.confidence)} %)"
            core_of(self._bus).notice(
                "why", f"{event.who}: likely {likely}; dpstack why {config} {shlex.quote(event.name)}"
            )

    async def stories(self) -> Mapping[int, Story]:
        """The story of each slave that is not in data exchange, by address."""
        for task in self._tasks:
            task.cancel()
        found: dict[int, Story] = {}
        missing = [slave for slave in self._bus.slaves if not (slave.ready_now or slave.deactivated)]
        if missing:
            await load_beside(*_WHY)  # before the time limit
        with contextlib.suppress(TimeoutError, DpError):
            async with asyncio.timeout(_LIMIT_S):
                for slave in missing:
                    found[slave.address] = await self._bus.why(slave, ask=False)
        return found


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
