"""Moves values that could not be delivered between the memory and the disk, in a thread of its own.

A disk that is slow, full, read-only or damaged delays nobody: the newest values wait in memory meanwhile, a remark
reports it once, and one that has failed is tried again.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

from dpstack.bridge.connector import Tell
from dpstack.bridge.mqtt.history import CHUNK, History
from dpstack.bridge.mqtt.history_file import (
    MOST_IN_BATCH,
    NAME,
    DamagedHistoryError,
    HistoryError,
    HistoryFile,
    boot_id,
    move_aside,
)
from dpstack.bridge.mqtt.worker_thread import WorkerThread
from dpstack.text import printable
from dpstack.trace import Severity

T = TypeVar("T")

#: s between two looks whether something waits for the disk: a SIGKILL or loss of power costs the values of so long
PERIOD_S: Final = 1.0
#: s after which a disk that does not answer is reported
_SLOW_S: Final = 30.0
#: s until a disk that has failed is tried again
_RETRY_S: Final = 30.0
#: s between two remarks about values that were lost
_REMARK_S: Final = 600.0
_MB: Final = 1_000_000


class HistoryKeeper:
    """``folder``: of the edge node; ``most_mb``: MB of the file. ``changed``: called when there may be something to be
    sent. ``retry_s``: see :data:`_RETRY_S`."""

    def __init__(
        self,
        history: History,
        folder: Path,
        most_mb: int,
        tell: Tell,
        changed: Callable[[], object],
        *,
        retry_s: float = _RETRY_S,
    ) -> None:
        self._history = history
        self._folder = folder
        self._most_mb = most_mb
        self._tell = tell
        self._changed = changed
        self._retry_s = retry_s
        self._disk: WorkerThread | None = None
        self._boot = ""
        self._file: HistoryFile | None = None
        self._failed_at: float | None = None
        self._wake = asyncio.Event()
        self._moved_at = -math.inf
        self._written_offset_ms: int | None = None
        self._told_dropped = 0
        self._remark_due = 0.0
        self._one_at_a_time = asyncio.Lock()

    def wake(self) -> None:
        """Something is to be read or taken off the disk."""
        self._wake.set()

    async def serve(self) -> None:
        """Runs until it is cancelled."""
        while True:
            await self.step()
            self._wake.clear()
            if self._history.needs_disk and self._file is not None:
                continue
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(PERIOD_S):
                    await self._wake.wait()

    async def step(self) -> None:
        """One look: write what is new, take off what is done, read what is wanted."""
        async with self._one_at_a_time:
            with self._watched():
                try:
                    file = await self._opened()
                    if file is not None:
                        await self._write(file)
                        await self._read(file)
                except HistoryError as error:
                    await self._fail(error)
            self._tell_losses()

    async def finish(self, limit_s: float) -> None:
        """Write what waits, at the end of the run, within ``limit_s``. Reports what is lost."""
        try:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(limit_s):
                    for _ in range(self._history.waiting // MOST_IN_BATCH + 1):
                        await self.step()
        finally:
            self._remark_due = -math.inf
            self._tell_losses()
            if waiting := self._history.waiting:
                text = (
                    f"{waiting} values that wait in memory are lost: the run ends before {self._place} has taken them"
                )
                self._tell(text, Severity.WARNING)

    def close(self) -> None:
        """Close the file, without waiting for the disk."""
        if self._disk is not None:
            self._disk.run_last(lambda: None if self._file is None else self._file.close())
            self._disk = None

    # --- a look -------------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        """Report a disk that does not answer for long, for instance that of a server that is gone; and the values
        that are lost meanwhile."""
        loop = asyncio.get_running_loop()
        timer: asyncio.TimerHandle

        def look(*, is_first: bool) -> None:
            nonlocal timer
            if is_first:
                text = f"{self._place}: the disk has not answered for {_SLOW_S:g} s; the newest values wait in memory"
                self._tell(text, Severity.ERROR)
            self._tell_losses()
            timer = loop.call_later(_SLOW_S, partial(look, is_first=False))

        timer = loop.call_later(_SLOW_S, partial(look, is_first=True))
        try:
            yield
        finally:
            timer.cancel()

    async def _opened(self) -> HistoryFile | None:
        """The file; None: it is not time for another try."""
        now = asyncio.get_running_loop().time()
        if self._file is not None or (self._failed_at is not None and now < self._failed_at + self._retry_s):
            return self._file
        self._boot = self._boot or await self._call(boot_id)
        # a file that is looked at as a whole takes its time
        file = await self._call(self._open)
        if file.count:
            self._tell(f"{file.count} values of an earlier time wait in {self._place}", Severity.INFO)
        return file

    def _open(self) -> HistoryFile:
        """In the thread: if the caller is cancelled meanwhile, the file is known all the same, and opened once."""
        if self._file is None:
            self._file = HistoryFile(self._folder, self._most_mb * _MB, self._boot)
        return self._file

    async def _write(self, file: HistoryFile) -> None:
        history = self._history
        while entries := history.take_new(MOST_IN_BATCH):
            try:
                await self._call(file.append, entries, history.offset_ms)
            except BaseException:
                # a cancelled call may have written them: twice is better than never
                history.not_stored()
                raise
            history.stored()
            if self._failed_at is not None:
                self._failed_at = None
                self._tell(f"values that cannot be delivered are kept again in {self._place}", Severity.INFO)
            self._written_offset_ms = history.offset_ms
            self._count(file)
            self._changed()
        if file.count and history.offset_ms != self._written_offset_ms:
            await self._call(file.append, (), history.offset_ms)  # the clock was set: it dates those on the disk
            self._written_offset_ms = history.offset_ms

    async def _read(self, file: HistoryFile) -> None:
        history = self._history
        done = history.take_done()
        if done:
            await self._call(file.delete, done)
            self._changed()
            if not file.count:
                self._tell("all values that waited have been delivered", Severity.INFO)
        without = history.take_read_request()
        if without is not None:
            try:
                chunk = await self._call(file.read, CHUNK, without) if file.count else []
            except BaseException:
                history.not_read()
                raise
            history.give(chunk)
            self._count(file)
            if chunk:
                self._changed()

    async def _call(self, function: Callable[..., T], *arguments: Any) -> T:
        if self._disk is None:
            self._disk = WorkerThread("dpstack mqtt: history")
        try:
            return await self._disk.call(function, *arguments)
        except (HistoryError, asyncio.CancelledError):
            raise
        except Exception as error:  # a file that SQLite takes for sound may hold anything
            raise DamagedHistoryError(printable(f"{type(error).__name__}: {error}")) from error

    async def _fail(self, error: HistoryError) -> None:
        """Report it, and do without the file for a while. A damaged file is moved aside."""
        if self._file is not None:
            self._count(self._file)
            await self._call(self._file.close)
            self._file = None
        now = asyncio.get_running_loop().time()
        is_first, self._failed_at = self._failed_at is None, now
        if isinstance(error, DamagedHistoryError):
            try:
                name = await self._call(move_aside, self._folder)
            except HistoryError as another:
                error = another
            else:
                if now > self._moved_at + self._retry_s:
                    self._failed_at, self._moved_at = None, now  # else it waits: the disk itself may be damaged
                text = f"it is {name} now, its values are not sent; a new one begins"
                self._tell(f"{self._place} cannot be read ({error}): {text}", Severity.ERROR)
                return
        if is_first:
            text = (
                f"values that cannot be delivered are not kept on the disk, as {self._place} cannot be used: {error}; "
                f"it is tried again every {self._retry_s:.0f} s"
            )
            self._tell(text, Severity.ERROR)

    @property
    def _place(self) -> Path:
        return self._folder / NAME

    # --- losses -------------------------------------------------------------------------------------------------------

    def _count(self, file: HistoryFile) -> None:
        history = self._history
        history.displaced += file.displaced
        history.unreadable += file.unreadable
        file.displaced = file.unreadable = 0

    def _tell_losses(self) -> None:
        dropped, now = self._history.dropped, asyncio.get_running_loop().time()
        if dropped == self._told_dropped or now < self._remark_due:
            return
        self._told_dropped, self._remark_due = dropped, now + _REMARK_S
        self._tell(f"{dropped} values that could not be delivered are lost: {self._history.losses}", Severity.WARNING)
