"""``Gateway``: a live stream becomes the tree of a plant, and its changes go to the connectors."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterable, Callable, Mapping, Sequence
from typing import Any, Final

from dpstack.bridge.connector import Connector, Tell
from dpstack.errors import DpError
from dpstack.plant.quality import clean
from dpstack.plant.state import end_of
from dpstack.plant.tree import Change, ClockSet, PlantTree, Remark
from dpstack.text import printable, shortened, traceback_text
from dpstack.trace import Severity

#: s between two looks at the time
TICK_S: Final = 0.5
#: s between two looks whether the connectors have made their nodes
_LOOK_S: Final = 0.01
#: s that the connectors have for their end, all together
END_S: Final = 3.0
#: s until a connector that goes on in spite of its cancellation is left
_LAST_S: Final = 0.5
#: changes after which those of further slaves wait until others had their turn, some 20 us each
MOST_CHANGES: Final = 500
#: items that wait to be applied together
MOST_ITEMS: Final = 1000
#: s by which the clock of the computer may differ from that of the stream
_SET_S: Final = 1.0
_LOG: Final = logging.getLogger("dpstack.bridge")


class Gateway:
    """Feeds ``connectors`` from ``items``, the live stream of a running bus or a recorded one.

    Nothing that a connector does reaches another connector or the bus: one that raises ends alone, and is reported.
    ``tell``: takes remarks, each with its severity. ``tree``: that of the connectors. ``now``: the clock of the
    computer in s since 1970, which may be set; times of the tree count by the clock of the stream. ``on_loss``: called
    with each connector that ends by a fault or by itself, before the end of all.
    """

    def __init__(
        self,
        items: AsyncIterable[Mapping[str, Any]],
        connectors: Sequence[Connector],
        *,
        tree: PlantTree,
        tell: Tell,
        now: Callable[[], float] = time.time,
        on_loss: Callable[[Connector], object] = lambda _: None,
    ) -> None:
        self.tree = tree
        #: the clock of the computer minus that of the stream in s, as given out
        self.offset = 0.0
        self._items = items
        self._connectors = list(connectors)
        #: the connectors that have ended by a fault or by themselves, before the end of all
        self.failed: list[Connector] = []
        for connector in self._connectors:
            connector.spread = self._spread
        self._tell = tell
        self._now = now
        self._on_loss = on_loss
        #: time of the loop of its last sign of life
        self.beat = 0.0
        self._serving: dict[asyncio.Task[None], Connector] = {}
        self._waiting: asyncio.Queue[Mapping[str, Any]] = asyncio.Queue(MOST_ITEMS)

    @property
    def connectors(self) -> tuple[Connector, ...]:
        """The connectors that have not ended."""
        return tuple(self._connectors)

    async def built(self) -> None:
        """Wait until the tree has the plant of a bus whose rate is known, and each connector its nodes, or has
        ended."""

        def is_built() -> bool:
            return (
                self.tree.plant is not None
                and self.tree.plant.baud is not None
                and all(connector.is_built for connector in self._connectors)
            )

        while not is_built():  # noqa: ASYNC110  neither the tree nor the connectors report it
            await asyncio.sleep(_LOOK_S)

    async def run(self) -> None:
        """Feed the connectors until the stream ends; then end them, within about :data:`END_S`.

        A cancellation ends them in the same way; a second one at once. Raises what the stream raises, behind that.
        """
        loop = asyncio.get_running_loop()
        for connector in self._connectors:
            task = loop.create_task(connector.serve(), name=f"dpstack {connector.name}")
            self._serving[task] = connector
            task.add_done_callback(self._served)
        reading = loop.create_task(self._read(), name="dpstack gateway: the live stream")
        try:
            while not (reading.done() and self._waiting.empty()):
                self.beat = loop.time()
                await self._step(await self._next_items(reading))
            why, error = "the live stream has ended", None if reading.cancelled() else reading.exception()
            if error is not None:
                why = f"the live stream has ended by an error: {clean(str(error))}"
            # a bus that has ended has said so itself
            await self._step([] if self.tree.has_ended else [end_of(why, failed=error is not None)])
            await reading
        finally:
            reading.cancel()
            if reading.done() and not reading.cancelled():
                reading.exception()  # asyncio reports one that nobody has asked for
            await self._end()

    # --- the stream -----------------------------------------------------------------------------------------------

    async def _read(self) -> None:
        async for item in self._items:
            await self._waiting.put(item)

    async def _next_items(self, reading: asyncio.Task[None]) -> list[Mapping[str, Any]]:
        """All items that are there; none after :data:`TICK_S` without one."""
        found: list[Mapping[str, Any]] = []
        getting = asyncio.ensure_future(self._waiting.get())
        try:
            await asyncio.wait((getting, reading), timeout=TICK_S, return_when=asyncio.FIRST_COMPLETED)
        finally:
            if not getting.cancel():
                found.append(getting.result())
        while not self._waiting.empty():
            found.append(self._waiting.get_nowait())
        return found

    async def _step(self, items: Sequence[Mapping[str, Any]]) -> None:
        """Apply ``items``. The loop may drive a bus, which has its turn behind some :data:`MOST_CHANGES`."""
        now = asyncio.get_running_loop().time()
        changes: list[Change] = []
        for part in self.tree.apply_in_parts(items, now):
            changes += part
            if len(changes) >= MOST_CHANGES:
                self._give_out(changes)
                changes = []
                await asyncio.sleep(0)
                self.beat = asyncio.get_running_loop().time()
        self._give_out(changes + self._compare_clocks(now))

    def _give_out(self, changes: Sequence[Change]) -> None:
        for change in changes:
            if isinstance(change, Remark):
                self._tell(change.text, Severity.WARNING)
        if changes:
            self._spread(changes)

    def _spread(self, changes: Sequence[Change]) -> None:
        for connector in tuple(self._connectors):
            self._hand_over(connector, changes)

    def _hand_over(self, connector: Connector, changes: Sequence[Change]) -> None:
        try:
            connector.take(changes)
        except Exception as error:
            self._report(connector, error)
            self._drop(connector)
            for task, served in self._serving.items():
                if served is connector:
                    task.cancel()

    def _compare_clocks(self, now: float) -> list[Change]:
        """Compare the clock of the computer with that of the stream: a computer may begin in 1970, and be set later."""
        stream = self.tree.time_at(now)
        if stream is None:
            return []
        offset = self._now() - stream
        if abs(offset - self.offset) <= _SET_S:
            return []
        self.offset = offset
        return [ClockSet(offset)]

    # --- the connectors
    # ------------------------------------------------------------------------------------------------

    def _served(self, task: asyncio.Task[None]) -> None:
        """A connector has ended, by itself or with the gateway."""
        connector = self._serving.pop(task)
        error = None if task.cancelled() else task.exception()
        serving = connector in self._connectors
        self._drop(connector)
        if error is not None:
            self._report(connector, error)
        elif serving:
            self._tell(f"{connector.name}: it has ended by itself; the bus goes on without it", Severity.ERROR)

    def _drop(self, connector: Connector) -> None:
        if connector in self._connectors:
            self._connectors.remove(connector)
            self.failed.append(connector)
            self._on_loss(connector)

    def _report(self, connector: Connector, error: BaseException) -> None:
        if isinstance(error, DpError):
            self._tell(f"{connector.name}: {error}", Severity.ERROR)
            return
        _LOG.error("%s has ended by a fault\n%s", connector.name, traceback_text(error))
        why = shortened(printable(f"{type(error).__name__}: {error}"), 200)
        text = f"{connector.name}: it has ended by a fault of its program ({why}); the bus goes on without it"
        self._tell(text, Severity.ERROR)

    async def _end(self) -> None:
        """Cancel the connectors, and wait until they have ended."""
        self._connectors.clear()
        for limit_s in (END_S, _LAST_S):
            ending = dict(self._serving)
            for task in ending:
                task.cancel()
            if ending:
                await asyncio.wait(ending, timeout=limit_s)
        for connector in self._serving.values():
            self._tell(f"{connector.name}: it did not end in time, and was left", Severity.WARNING)
