"""Store and forward: values that could not be delivered, those that are sent next, and those that are confirmed.

The part that knows no disk, no network and no clock. A value takes this way:

1. The edge node hands it in: it could not be sent (:meth:`History.keep`), or it was sent (:meth:`History.sent`).
2. NDATA and DDATA have QoS 0, so nothing says that the broker has read one. A round trip of MQTT behind it does
   (:meth:`History.begin_round`, :meth:`History.confirm`). Unconfirmed values are kept when the connection ends.
3. Kept values go to the disk (:meth:`History.take_new`; :mod:`dpstack.bridge.mqtt.history_file`). While a broker
   confirms everything, nothing is written.
4. Behind the births of the next session they come back in parts, oldest first (:meth:`History.give`), go out as
   historical, and leave the disk when they are confirmed. So each value arrives at least once, or is counted.

Times of entries are ms since the start of the computer, by a clock that nobody sets, with the offset of the clock of
the computer that was known then. So the right time can be found at sending, if that clock was set meanwhile.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from enum import Enum, auto
from typing import Final, NamedTuple

from dpstack.bridge.mqtt.payload import MetricKind, Sample
from dpstack.plant.quality import Reading, Reason, Value

#: entries in memory that wait for the disk, and those that were sent and are not confirmed
MOST_IN_MEMORY: Final = 20_000
#: entries that are read from the disk at once
CHUNK: Final = 1000
#: s between two messages of history; metrics and octets (about) of one
PACE_S: Final = 0.1
MOST_METRICS: Final = 200
MOST_OCTETS: Final = 16_384
#: ms since 1970 at the begin of 2020: a clock that says less was never set
EARLIEST_MS: Final = 1_577_836_800_000
#: offsets of the clock that differ by less are one: clocks drift, and two computers never agree wholly
_SET_MS: Final = 1000
#: octets of a metric in a payload besides texts and octets: alias, time, value, flag, quality
_METRIC_OCTETS: Final = 64
#: s until the next look if the clock was never set
_HOLD_S: Final = 60.0


class Entry(NamedTuple):
    """A value of a metric, as hosts know it: ``device`` (None: of the edge node), ``metric``, ``type``, ``unit``.

    ``at_ms``: ms since the start of the computer; ``offset_ms``: the clock of the computer less that, as known then.
    """

    device: str | None
    metric: str
    type: int
    unit: str
    at_ms: int
    offset_ms: int
    value: Value
    reason: Reason
    note: str = ""

    @property
    def reading(self) -> Reading:
        """Value and reason, also the number of a bad one; without its time."""
        return Reading(self.value, self.reason, 0.0, self.note)


#: place of an entry on the disk; ascending in time
Place = tuple[int, int, int]


class Kept(NamedTuple):
    """An entry on the disk. ``last_offset_ms``: the last offset known of an earlier start of the computer; None: the
    entry is of this start, so the offset of now holds."""

    place: Place
    entry: Entry
    last_offset_ms: int | None = None

    def time_ms(self, offset_ms: int) -> int | None:
        """The time of the value in ms since 1970, ``offset_ms`` that of now; None: it cannot be known, as the clock of
        the computer was not set before it started again."""
        entry = self.entry
        known = offset_ms if self.last_offset_ms is None else self.last_offset_ms
        offset = known if abs(known - entry.offset_ms) > _SET_MS else entry.offset_ms
        time_ms = entry.at_ms + offset
        return time_ms if time_ms >= EARLIEST_MS else None


class Absent(Enum):
    """Why a metric cannot be published now."""

    #: the device is configured and has had no birth in this session
    WAITING = auto()
    #: no birth of this configuration has the metric
    UNKNOWN = auto()


class History:
    """``most``: entries in memory. Each count is of lost values: ``overflown``, for which there was no room in memory;
    ``unknown``, of metrics that no birth has any more; ``undated``, whose time cannot be known. The owner of the disk
    counts in ``displaced`` (the oldest, for which the store had no room) and ``unreadable``.

    ``due``: the time at which the next message of history may go out.
    """

    def __init__(self, most: int = MOST_IN_MEMORY) -> None:
        self.overflown = self.unknown = self.undated = self.displaced = self.unreadable = 0
        self.due = -math.inf
        #: the last offset of the clock of the computer; None: not known yet
        self.offset_ms: int | None = None
        self._most = most
        # for the disk, by a running number; and the newest one of each metric
        self._new: dict[int, Entry] = {}
        self._newest: dict[tuple[str | None, str], int] = {}
        self._number = 0
        self._writing: dict[int, Entry] = {}
        # sent and not confirmed: each with the round trip that confirms it
        self._round = 0
        self._unconfirmed: deque[tuple[int, Entry]] = deque()
        self._in_flight: deque[tuple[int, Place]] = deque()
        # from the disk, to be sent
        self._chunk: deque[Kept] = deque()
        #: the next part is to be read, without the entries of these devices; None: it is not
        self._read_without: frozenset[str] | None = None
        self._is_reading = False
        self._is_exhausted = False
        self._must_look_again = False
        #: entries that can leave the disk
        self._done: list[Place] = []
        #: metrics that hosts know to be good, of the history of this session
        self._good: set[tuple[str | None, str]] = set()

    @property
    def dropped(self) -> int:
        """Values that were lost."""
        return self.overflown + self.unknown + self.undated + self.displaced + self.unreadable

    @property
    def losses(self) -> str:
        """The reasons of :attr:`dropped`, for people."""
        reasons = (
            (self.displaced, "older than those for which store_mb has room"),
            (self.overflown, "more than fit in memory while the disk could not take them"),
            (self.unknown, "of metrics that the configuration does not have any more"),
            (self.undated, "of a time at which the clock of this computer was not set"),
            (self.unreadable, "not readable"),
        )
        return ", ".join(f"{count} {text}" for count, text in reasons if count)

    # --- the edge node: what was and was not delivered --------------------------------------------------------------

    def keep(self, entry: Entry) -> None:
        """Keep a value that could not be sent."""
        self._number += 1
        self._new[self._number] = entry
        self._newest[entry.device, entry.metric] = self._number
        self._bound()

    def sent(self, entries: Iterable[Entry]) -> None:
        """Take values that were sent: they are kept if the connection ends before it has confirmed them."""
        self._unconfirmed.extend((self._round, entry) for entry in entries)
        while len(self._unconfirmed) > self._most:
            self.keep(self._unconfirmed.popleft()[1])

    def covered(self, device: str | None, metric: str, reading: Reading, at_ms: int | None) -> None:
        """A birth holds the value of a metric. If it is the newest one that waits in memory, it need not be sent as
        history. ``at_ms``: its time, None: any one."""
        number = self._newest.get((device, metric))
        entry = None if number is None else self._new.get(number)
        if number is None or entry is None or (at_ms is not None and entry.at_ms != at_ms):
            return
        if (entry.value, entry.reason, entry.note) == (reading.value, reading.reason, reading.note):
            self.sent((self._new.pop(number),))
            del self._newest[device, metric]

    def session_began(self) -> None:
        """Births begin: the disk is read anew behind them."""
        self._forget_chunk()
        self._good.clear()

    def look_again(self) -> None:
        """A device was born: the disk may hold values of it, also if it is being read without them now."""
        self._is_exhausted = False
        self._must_look_again = self._is_reading

    def session_ended(self) -> None:
        """The connection has ended: what it has not confirmed is kept."""
        unconfirmed, self._unconfirmed = self._unconfirmed, deque()
        for _, entry in unconfirmed:
            self.keep(entry)
        self._forget_chunk()

    def _forget_chunk(self) -> None:
        """Values that were read and not confirmed are on the disk still."""
        self._chunk.clear()
        self._in_flight.clear()
        self._read_without, self._is_exhausted = None, False

    def _bound(self) -> None:
        while len(self._new) + len(self._writing) > self._most and self._new:
            oldest = next(iter(self._new))
            entry = self._new.pop(oldest)
            self.overflown += 1
            if self._newest.get((entry.device, entry.metric)) == oldest:
                del self._newest[entry.device, entry.metric]

    # --- the edge node: history to be sent --------------------------------------------------------------------------

    def next_samples(
        self,
        find: Callable[[Entry], MetricKind | Absent],
        waiting: Callable[[], Collection[str]],
        now_ms: int,
        offset_ms: int,
        clock: float,
    ) -> tuple[str | None, list[Sample]] | None:
        """The values of the next message, all of one device; None without one now.

        ``find``: the metric of an entry in the present births. ``waiting``: devices without a birth: their values stay
        on the disk.
        """
        if clock < self.due:
            return None
        if now_ms < EARLIEST_MS:
            self.due = clock + _HOLD_S  # the clock may be set later
            return None
        device, samples, octets = None, list[Sample](), 0
        rest: list[Kept] = []
        while self._chunk and len(samples) < MOST_METRICS and octets < MOST_OCTETS:
            kept = self._chunk.popleft()
            entry = kept.entry
            if samples and entry.device != device:
                rest.append(kept)
                continue
            kind = find(entry)
            time_ms = kept.time_ms(offset_ms)
            if kind is Absent.WAITING:
                continue  # it is read again when the device is born
            if isinstance(kind, Absent) or time_ms is None:
                self.unknown += isinstance(kind, Absent)
                self.undated += not isinstance(kind, Absent)
                self._done.append(kept.place)
                continue
            device = entry.device
            needs_quality = self._needs_quality(entry)
            samples.append(Sample(kind, entry.reading, min(time_ms, now_ms), needs_quality, historical=True))
            octets += _METRIC_OCTETS + _octets(entry)
            self._in_flight.append((self._round, kept.place))
        self._chunk.extendleft(reversed(rest))
        if samples:
            self.due = clock + PACE_S
            return device, samples
        if not (self._in_flight or self._done or self._is_exhausted or self._is_reading):
            self._read_without = frozenset(waiting())
        return None

    def _needs_quality(self, entry: Entry) -> bool:
        """Whether the quality goes with a good value without a remark: hosts do not know that the metric is good."""
        metric = entry.device, entry.metric
        if entry.reading.has_remark:
            self._good.discard(metric)
        elif metric not in self._good:
            self._good.add(metric)
            return True
        return False

    def next_due(self) -> float:
        """The time at which :meth:`next_samples` has a message; infinite: none."""
        return self.due if self._chunk else math.inf

    # --- the connection: round trips ----------------------------------------------------------------------------------

    @property
    def is_unconfirmed(self) -> bool:
        return bool(self._unconfirmed or self._in_flight)

    @property
    def is_chunk_sent(self) -> bool:
        """All that was read is sent: a round trip now, and the next part comes sooner."""
        return not self._chunk and bool(self._in_flight)

    def begin_round(self) -> int:
        """A round trip begins; returns its number for :meth:`confirm`."""
        self._round += 1
        return self._round - 1

    def confirm(self, number: int) -> None:
        """The round trip has come back: the broker has read all that was sent before it began."""
        while self._unconfirmed and self._unconfirmed[0][0] <= number:
            self._unconfirmed.popleft()
        while self._in_flight and self._in_flight[0][0] <= number:
            self._done.append(self._in_flight.popleft()[1])

    # --- the disk -----------------------------------------------------------------------------------------------------

    @property
    def waiting(self) -> int:
        """Entries in memory that wait for the disk."""
        return len(self._new)

    @property
    def needs_disk(self) -> bool:
        """Something is to be read, or to be taken off the disk: the owner of the disk should not wait."""
        return self._read_without is not None or bool(self._done)

    def take_new(self, most: int = CHUNK) -> Sequence[Entry]:
        """Entries for the disk, oldest first. :meth:`stored` or :meth:`not_stored` comes next."""
        assert not self._writing
        numbers = [number for number, _ in zip(self._new, range(most), strict=False)]
        self._writing = {number: self._new.pop(number) for number in numbers}
        return tuple(self._writing.values())

    def stored(self) -> None:
        """The entries of :meth:`take_new` are on the disk."""
        self._newest = {metric: number for metric, number in self._newest.items() if number in self._new}
        self._is_exhausted = self._is_exhausted and not self._writing
        self._writing = {}

    def not_stored(self) -> None:
        """The entries of :meth:`take_new` could not be written: they wait in memory, the oldest go first."""
        self._new, self._writing = {**self._writing, **self._new}, {}
        self._bound()

    def take_done(self) -> Sequence[Place]:
        """The entries that can leave the disk."""
        done, self._done = self._done, []
        return done

    def take_read_request(self) -> frozenset[str] | None:
        """Devices whose entries are to be left out, if the next part is to be read; :meth:`give` or :meth:`not_read`
        comes next then. None: nothing is to be read."""
        without, self._read_without = self._read_without, None
        self._is_reading = without is not None
        return without

    def give(self, chunk: Iterable[Kept]) -> None:
        """The oldest entries of the disk; none: there are no more."""
        self._chunk = deque(chunk)
        self._is_exhausted = not (self._chunk or self._must_look_again)
        self._is_reading = self._must_look_again = False

    def not_read(self) -> None:
        """The disk could not be read: it is asked again."""
        self._is_reading = self._must_look_again = False


def _octets(entry: Entry) -> int:
    value = len(entry.value) if isinstance(entry.value, (str, bytes)) else 0
    return value + len(entry.note) + len(entry.reason.text)
