"""The run of a configuration as a source: it joins the run that is there, waits for the next one, or starts one.

- A run of somebody else is joined. When it ends, the source waits for the next one; it does not take the port itself.
- No run, no orders: the source starts ``dpstack run CONFIG --read-only``, and again when that ends.
- No run, with orders: the source waits. :meth:`RunSource.start` starts ``dpstack run CONFIG --clear``.

All that it has started ends with it, in order.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable, Sequence
from pathlib import Path
from typing import Final

from dpstack.api.config.config import Config, file_digest
from dpstack.api.control.client import ControlClient, connect, find_run
from dpstack.errors import BusError, DpError, PortError, UsageError
from dpstack.plant.items import Plant, check_item
from dpstack.plant.state import end_of
from dpstack.web.child import Child
from dpstack.web.run_link import Find, RunLink
from dpstack.web.source import Kind, KindChanged, Note, Source, SourceItem

#: makes the process of a run from its arguments; the function gets the lines of its standard error
MakeChild = Callable[[Sequence[str], Callable[[str], None]], Child]

#: seconds between two looks for a run, for one that was started, and at the file of the configuration
_LOOK_S: Final = 0.5
_SOON_S: Final = 0.1
_FILE_S: Final = 2.0
#: seconds before the run that only reads is started again, from the first time on
_AGAIN_S: Final = (1.0, 5.0, 15.0, 60.0)
#: seconds in which a run has to take note of an order that was refused
_REFUSED_S: Final = 1.0
#: seconds in which a run that was started has to answer
_START_S: Final = 20.0


class RunSource(Source):
    """The run that ``find`` finds. ``file``: that of its configuration; None: nothing can be started. ``control``:
    pages may give orders; ``options``: further arguments for a run that is started, which ``make_child`` makes."""

    def __init__(
        self,
        find: Find,
        file: Path | None,
        *,
        control: bool = False,
        options: Sequence[str] = (),
        make_child: MakeChild = Child,
    ) -> None:
        self._find = find
        self._file = file
        self._control = control
        self._options = options
        self._make_child = make_child
        self._queue: asyncio.Queue[SourceItem | BaseException] = asyncio.Queue()
        self._link: RunLink | None = None
        self._child: Child | None = None
        self._starting = asyncio.Lock()
        self._joined_another = False  # a run that somebody else has started
        self._failures = 0  # of the run that only reads, one after the other
        self._again_at = 0.0  # time of the loop at which it may be started
        self._told = ""
        #: path of the configuration of the run that is joined, and the digest of its text as the run has read it
        self._read: tuple[str | None, str | None] = (None, None)

    @classmethod
    def of(cls, config: Config, *, control: bool = False, options: Sequence[str] = ()) -> RunSource:
        """The run with ``config``, which is from a file."""

        def find() -> ControlClient | None:
            return find_run(config.port, config.file)

        return cls(find, config.file, control=control, options=options)

    @classmethod
    def named(cls, name: str) -> RunSource:
        """The program ``name``, as ``dpstack ctl`` names it."""

        def find() -> ControlClient | None:
            try:
                return connect(name)
            except PortError:
                return None

        return cls(find, None)

    async def items(self) -> AsyncGenerator[SourceItem]:
        tasks = [asyncio.ensure_future(work) for work in (self._follow(), self._watch_file())]
        for task in tasks:
            task.add_done_callback(self._failed)
        try:
            while True:
                item = await self._queue.get()
                if isinstance(item, BaseException):
                    raise item
                yield item
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def call(self, command: str, *args: str) -> object:
        link = self._link
        if link is None:
            raise UsageError(f"{command}: there is no run{': start it first' if self._control else ''}")
        return await link.call(command, *args)

    async def order(self, who: str, command: str, *args: str) -> object:
        link = self._link
        if link is None:
            return await self.call(command, *args)
        return await link.call(command, *args, origin=_origin(who))

    async def refused(self, who: str, order: str, reason: str) -> None:
        link = self._link
        if link is not None:
            with contextlib.suppress(
                DpError, TimeoutError
            ):  # it has ended meanwhile, or hangs: the page gets its answer
                async with asyncio.timeout(_REFUSED_S):
                    await link.call("refused", _origin(who), order, reason)

    async def start(self) -> object:
        async with self._starting:
            if self._is_joined() or self._child is not None:
                raise UsageError("start: the run is there already")
            child = await self._start_child("--clear")
            ended = asyncio.ensure_future(child.wait())
            try:
                async with asyncio.timeout(_START_S):
                    while not self._is_joined():
                        if child.code is not None:
                            raise BusError(f"start: {child.last_line}")
                        await asyncio.wait({ended}, timeout=_SOON_S)
            except TimeoutError:
                raise BusError(f"start: {child.text} does not answer within {_START_S:g} s") from None
            finally:
                ended.cancel()
            return {"started": child.text, "mode": "clear"}

    async def close(self) -> None:
        child, self._child = self._child, None
        if child is not None:
            await child.end()

    # --- following the run ----------------------------------------------------------------------------------------

    async def _follow(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                link = await RunLink.join(self._find)
                if link is not None:
                    await self._follow_link(link)
                    continue
                if self._file is None:
                    self._note("no program of this name is there: waiting for one")
                if self._child is None and self._reads_only and loop.time() >= self._again_at:
                    await self._start_child("--read-only")
            except DpError as error:
                self._note(str(error), "warning")
            await self._reap()
            await asyncio.sleep(_LOOK_S if self._child is None else _SOON_S)

    def _is_joined(self) -> bool:
        return self._link is not None

    @property
    def _reads_only(self) -> bool:
        """Whether the source starts a run that only reads if none exists."""
        return self._file is not None and not self._control and not self._joined_another

    async def _follow_link(self, link: RunLink) -> None:
        self._joined_another = self._joined_another or self._child is None
        self._failures = 0
        self._note(f"joined the {link.text}")
        end: str | None = "the run has ended"
        silent = False
        self._link = link
        try:
            async with contextlib.aclosing(link.items()) as items:
                async for item in items:
                    if item is None:
                        if not silent:
                            self._note("the run has sent nothing for 10 s: is it stopped, or busy?", "warning")
                        silent = True
                        continue
                    silent = False
                    try:
                        checked = check_item(item)
                    except ValueError as error:
                        self._note(str(error), "error")
                        continue
                    if checked.kind is None:
                        continue
                    if checked.plant is not None and checked.plant.whole:
                        self._set_kind(_kind_of(link, checked.plant))
                        self._read = checked.plant.config, checked.plant.config_digest
                    if checked.end is not None:
                        end = self._link = None  # it takes no more commands
                    self._put(checked)
        except DpError as error:
            end = end and str(error)
        finally:
            self._link, self._read = None, (None, None)
            link.close()
        if end is not None:
            self._put(check_item(end_of(end, failed=False)))
        self._set_kind("none")
        self._note(f"the {link.text} has ended")
        if self._child is not None:
            await self._child.wait()
            await self._reap()

    async def _reap(self) -> None:
        """Report a run that was started and has ended."""
        child = self._child
        if child is None or child.code is None:
            return
        await child.wait()
        self._child = None
        if child.code:
            self._note(f"{child.text} has ended with exit code {child.code}: {child.last_line}", "error")
        self._again_at = asyncio.get_running_loop().time() + _AGAIN_S[min(self._failures, len(_AGAIN_S) - 1)]
        self._failures += 1

    async def _start_child(self, how: str) -> Child:
        if self._file is None:
            raise UsageError("start: this server has no configuration file, so it can start nothing")
        args = ("run", str(self._file), how, *self._options, "--json")
        child = self._make_child(args, lambda line: self._note(f"run: {line}", "warning"))
        self._note(f"starts {child.text}")
        try:
            await child.start()
        except OSError as exc:
            raise BusError(f"{child.text} cannot be started: {exc.strerror or exc}") from None
        self._child = child
        return child

    # --- items of its own -----------------------------------------------------------------------------------------

    def _put(self, item: SourceItem) -> None:
        self._queue.put_nowait(item)

    def _note(self, text: str, severity: str = "info") -> None:
        """Inform pages and log, each text once in a row."""
        if text != self._told:
            self._told = text
            self._put(Note(text, severity))

    def _set_kind(self, kind: Kind) -> None:
        if kind != self.kind:
            self.kind = kind
            self._put(KindChanged())

    def _failed(self, task: asyncio.Future[None]) -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self._queue.put_nowait(error)

    async def _watch_file(self) -> None:
        """Report when the file of the configuration is no longer the one that the run has read."""
        told: tuple[str | None, str | None, str | None] = (None, None, None)
        while True:
            await asyncio.sleep(_FILE_S)
            file, digest = self._read
            if file is None or digest is None:
                continue
            now = await asyncio.to_thread(file_digest, file)
            differs = now != digest
            before, told = told, (file, digest, now)
            if told == before or (not differs and before[:2] != (file, digest)):
                continue  # reported already, or a run that has just begun with this file
            if now is None:
                self._note(f"{file} cannot be read any more; the run keeps what it has read", "warning")
            elif differs:
                text = "has changed since this run began; the run keeps what it has read: end it and start it again"
                self._note(f"{file} {text}", "warning")
            else:
                self._note(f"{file} is again as this run has read it")


def _kind_of(link: RunLink, plant: Plant) -> Kind:
    if link.about["kind"] == "demo":
        return "demo"
    return "read-only" if plant.read_only else "run"


def _origin(who: str) -> str:
    """The origin of an order in the log of the run."""
    return f"page ({who})"
