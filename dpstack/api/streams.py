"""Event streams, waiters and ``on_event`` of the application: no slow reader, and no import, holds up the bus."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import logging
import time
import weakref
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from typing import Final, Self, TypeVar

from msgspec.structs import replace

from dpstack.dp.master.events import DriveEvent, SlaveDiagnosis, SlaveEvent, SlaveFaulted, SlaveStateChanged
from dpstack.drivers.snapshots import View
from dpstack.text import printable
from dpstack.trace import Event, Severity
from dpstack.units import ns_to_s

T = TypeVar("T")

#: Events kept for a reader that does not read, and for one that comes later.
DEPTH: Final = 1000

OnEvent = Callable[[Event], None]

#: The application gets the state changes, faults and diagnoses of a slave one by one, up to this many at once and so
#: many a second.
_BURST: Final = 40
_PER_S: Final = 5
#: After this time a slave that had more of them is reported: how many there were, and the newest of each kind.
_FLAP_REPORT_S: Final = 1.0


class Stream(AsyncIterator[T]):
    """An async iterator over items. It keeps up to ``depth`` of them (None: any number), drops the oldest ones beyond
    and counts them in ``dropped``; with a depth of 1 the latest item wins.
    """

    def __init__(self, depth: int | None, backlog: Iterable[T] = ()) -> None:
        self.dropped = 0
        self._waiting: deque[T] = deque(backlog, depth)
        self._readers: list[asyncio.Future[None]] = []  # they wait for an item
        self._ended = False

    def put(self, item: T) -> None:
        self.dropped += len(self._waiting) == self._waiting.maxlen
        self._waiting.append(item)
        if self._readers:
            self._wake()

    def end(self) -> None:
        """End the iteration after the items that are still kept."""
        self._ended = True
        self._wake()

    def _wake(self) -> None:
        readers, self._readers = self._readers, []
        for reader in readers:
            if not reader.done():  # cancelled
                reader.set_result(None)

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        while not self._waiting:
            if self._ended:
                raise StopAsyncIteration
            reader = asyncio.get_running_loop().create_future()
            self._readers.append(reader)
            await reader
        return self._waiting.popleft()


def when_dropped(owner: object, callback: Callable[..., object], *args: object) -> weakref.finalize[..., object]:
    """Have this event loop call ``callback(*args)`` once nothing refers to ``owner`` any more."""
    loop = asyncio.get_running_loop()

    def call_later() -> None:  # in any thread
        with contextlib.suppress(RuntimeError):  # the loop is over, and the bus with it
            loop.call_soon_threadsafe(callback, *args)

    finalizer = weakref.finalize(owner, call_later)
    finalizer.atexit = False
    return finalizer


class Reader(AsyncIterator[T]):
    """The items of ``stream`` for a program, which may leave its ``async for`` without :meth:`close`.

    The bus holds the stream: so a task that waits for an item stays alive, though event loops hold tasks weakly. Only
    the program holds the reader: when it is gone, ``leave(stream)`` is called, in any thread.
    """

    def __init__(self, stream: Stream[T], leave: Callable[[Stream[T]], object]) -> None:
        self._stream = stream
        self._leave = weakref.finalize(self, leave, stream)
        self._leave.atexit = False

    @property
    def dropped(self) -> int:
        """The number of items lost because they were not read in time."""
        return self._stream.dropped

    def close(self) -> None:
        """Stop receiving items. May be repeated."""
        self._leave()
        self._stream.end()

    async def __anext__(self) -> T:
        return await anext(self._stream)


class EventStream(Reader[Event]):
    """Events of a bus, an async iterator. Ends with the bus."""


class WallClock:
    """The wall clock of events. ``now``: the machine's time in ns; ``virtual``: whether that is the time of a simulated
    bus: then the differences between events are those of bus time, else a clock that is set has its effect at once."""

    def __init__(self, now: Callable[[], int], virtual: Callable[[], bool]) -> None:
        self._now = now
        self._virtual = virtual
        self._offset_ns: int | None = None  # of a simulated bus

    def stamped(self, event: Event) -> Event:
        """``event`` with its wall clock."""
        return replace(event, wall_ns=self.wall_ns(event.t_ns))

    def wall_ns(self, t_ns: int) -> int:
        """The wall clock in ns at ``t_ns`` of the machine."""
        offset_ns = self._offset_ns
        if offset_ns is None:
            offset_ns = time.time_ns() - self._now()
            if self._virtual():
                self._offset_ns = offset_ns
        return t_ns + offset_ns


#: of remarks about the end of a program
ROOT: Final = logging.getLogger("dpstack")
ROOT.addHandler(logging.NullHandler())  # a program that has not configured logging gets nothing printed
LEVELS: Final = {
    Severity.INFO: logging.INFO,
    Severity.WARNING: logging.WARNING,
    Severity.ERROR: logging.ERROR,
}


def logger_below(branch: str, name: str) -> str:
    """The logger of the slave ``name`` below ``dpstack.BRANCH``: one level of the tree, so a dot becomes "_"."""
    return f"dpstack.{branch}.{printable(name).replace('.', '_')}"


def call_on_event(on_event: OnEvent | None, event: Event) -> None:
    """Call ``on_event(event)``. The event loop reports an exception of it, and the bus goes on."""
    if on_event is not None:
        try:
            on_event(event)
        except Exception as error:
            context = {"message": f"on_event raised at {event.text!r}", "exception": error}
            asyncio.get_running_loop().call_exception_handler(context)


class SlaveFlapping(SlaveEvent):
    """The state or the diagnosis of a slave changes too often: ``count`` events about changes were left out.

    The newest state, fault and diagnosis among them follow this event.
    """

    SEVERITY = Severity.WARNING

    #: events about changes that were left out
    count: int
    #: the events that were left out are those of the drive
    drive: bool = False

    def _text(self) -> str:
        if self.drive:
            return (
                f"{self.who}: {self.count} changes of the drive's state, faults or warnings "
                "are not reported one by one; look at the drive"
            )
        return (
            f"{self.who} flaps: {self.count} changes of its state or diagnosis are not reported "
            f"one by one; look at its connector, its supply and its watchdog time"
        )


class Flapping:
    """Limits the events about changes of one slave: holds back those above the rate and reports them once a second."""

    def __init__(self, pass_on: Callable[[Event], None]) -> None:
        self._pass_on = pass_on
        self._allowed = float(_BURST)
        self._at_ns = 0
        self._newest: dict[type[Event], SlaveEvent] = {}
        self._count = 0
        self._report: asyncio.TimerHandle | None = None

    def publish(self, event: SlaveEvent) -> None:
        """Pass ``event`` on, or hold it back for the report."""
        self._allowed = min(_BURST, self._allowed + _PER_S * ns_to_s(event.t_ns - self._at_ns))
        self._at_ns = event.t_ns
        if self._report is None and self._allowed >= 1:
            self._allowed -= 1
            self._pass_on(event)
            return
        self._count += 1
        self._newest.pop(type(event), None)  # the order of the report is that of the events
        self._newest[type(event)] = event
        if self._report is None:
            self._report = asyncio.get_running_loop().call_later(_FLAP_REPORT_S, self.report)

    def report(self) -> None:
        """Report the events that were held back."""
        if self._report is None:
            return
        self._report.cancel()
        self._report = None
        newest, self._newest = list(self._newest.values()), {}
        count, self._count = self._count - len(newest), 0
        last = newest[-1]
        if count:
            drive = isinstance(last, DriveEvent)
            self._pass_on(SlaveFlapping(t_ns=last.t_ns, address=last.address, name=last.name, count=count, drive=drive))
        for event in newest:
            self._pass_on(event)


class Events:
    """Distributes the events of a bus to streams, ``log`` and ``on_event``. A new stream begins with the last ``DEPTH``
    events before it."""

    def __init__(self, on_event: OnEvent | None, clock: WallClock, log: OnEvent) -> None:
        self._on_event = on_event
        self._clock = clock
        self._log = log
        #: called for each event, beside streams and ``on_event``
        self.listener: OnEvent | None = None
        self._history: deque[Event] = deque(maxlen=DEPTH)
        self._streams: set[Stream[Event]] = set()
        self._ended = False
        self._flapping: dict[int, Flapping] = {}

    def publish(self, event: Event) -> None:
        """Distribute ``event``; of a slave that changes too often only the newest events, once a second."""
        if isinstance(event, (SlaveStateChanged, SlaveFaulted, SlaveDiagnosis)):
            flapping = self._flapping.get(event.address)
            if flapping is None:
                flapping = self._flapping[event.address] = Flapping(self._pass_on)
            flapping.publish(event)
        else:
            self._pass_on(event)

    def _pass_on(self, event: Event) -> None:
        if event.wall_ns is None:
            event = self._clock.stamped(event)
        self._history.append(event)
        for stream in tuple(self._streams):  # any allocation may make a reader that was left give up its stream
            stream.put(event)
        if self.listener is not None:
            self.listener(event)
        self._log(event)
        call_on_event(self._on_event, event)

    @property
    def past(self) -> tuple[Event, ...]:
        """The last events, oldest first."""
        return tuple(self._history)

    def stream(self) -> EventStream:
        stream = Stream[Event](DEPTH, self._history)
        self._streams.add(stream)
        if self._ended:
            stream.end()
        return EventStream(stream, self._streams.discard)

    def end(self) -> None:
        """End all streams."""
        for flapping in self._flapping.values():
            flapping.report()
        self._ended = True
        for stream in tuple(self._streams):
            stream.end()


class Waiters:
    """Futures that wait for a condition; :meth:`check` evaluates it."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Callable[[], bool], asyncio.Future[None]]] = []

    def check(self) -> None:
        """Wake every caller whose condition holds, or has raised."""
        for condition, future in tuple(self._waiting):
            if future.done():
                continue
            try:
                if condition():
                    future.set_result(None)
            except Exception as error:
                future.set_exception(error)

    async def until(self, condition: Callable[[], bool], timeout: float | None) -> None:
        """Wait until ``condition()``; what it raises is raised here. Raises TimeoutError."""
        if condition():
            return
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        entry = (condition, future)
        self._waiting.append(entry)
        try:
            async with asyncio.timeout(timeout):
                await future
        finally:
            self._waiting.remove(entry)


class Rounds:
    """Callbacks at the end of every round with data exchange; without watchers the bus makes no calls."""

    def __init__(self, view: View) -> None:
        self._view = view
        self._watchers: list[Callable[[], None]] = []

    @contextlib.contextmanager
    def watched(self, watcher: Callable[[], None]) -> Iterator[None]:
        """Call ``watcher()`` at the end of every round inside the block."""
        self._watchers.append(watcher)
        self._view.watch_rounds(self._on_round)
        try:
            yield
        finally:
            self._watchers.remove(watcher)
            if not self._watchers:
                self._view.watch_rounds(None)

    def _on_round(self) -> None:
        for watcher in tuple(self._watchers):
            watcher()


_loaded_beside: Final[set[str]] = set()


async def load_beside(*modules: str) -> None:
    """Import ``modules`` in a thread: in that of the loop an import, which may take 20 ms, would hold up a bus."""
    if not _loaded_beside.issuperset(modules):  # sys.modules has modules, too, that another task is still loading
        await asyncio.to_thread(lambda: [importlib.import_module(module) for module in modules])
        _loaded_beside.update(modules)
