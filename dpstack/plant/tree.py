"""The tree of a plant: items of its live stream in; changed values, births, deaths and conditions out.

A value is good while all of this holds; else the tree says which part does not:

- the stream comes, and comes in time; the bus runs, and has not ended
- for process data and drives: the slave is in data exchange, its inputs are valid by the rule of the master
  (:func:`dpstack.dp.process_image.inputs_are_valid`), and no older than their limit: the watchdog of the slave, 1 s
  without one, two poll intervals at least
- the value has the type of its node, and the snapshot says of no diagnosis that is about it
  (:mod:`dpstack.plant.value_quality`)

The caller gives the time in s by a clock that nobody sets (that of the event loop). :meth:`PlantTree.tick` finds out
that nothing comes any more, so it must be called at least once in ``silent_s``.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from dpstack.plant.conditions import Condition, ConditionBook
from dpstack.plant.items import (
    BusValues,
    EventValues,
    FaultValues,
    Held,
    Plant,
    SlavePlant,
    SlaveValues,
    Snapshot,
    check_item,
    merged,
)
from dpstack.plant.judge import diagnosis_remark, exchanging
from dpstack.plant.nodes import MOST_NODES, Described, Kind, Node, OfferedOrder, Source, bus_of, slave_of
from dpstack.plant.quality import FLOAT, TEXT, Quality, Reading, Reason, Value, clean, is_news, value_of
from dpstack.plant.value_quality import GOOD, Judged, read_back, trouble_of, worse
from dpstack.text import printable, shortened
from dpstack.trace import Severity

#: s without a snapshot, and of delay, after which values are stale. The stream comes every 0.5 s at the latest, or at
#: the interval that its reader has asked for
SILENT_S: Final = 2.0
#: s between two changes of a statistic
STATISTICS_S: Final = 10.0
#: the smallest delay of the stream rises by this much a second: clocks of two computers differ by less
_DRIFT: Final = 1e-3
#: s since 1970 at the end of the year 9999
_LATEST: Final = 253_402_300_799.0
#: age of valid inputs of a slave without watchdog in ms, if the stream does not say more
_UNWATCHED_MS: Final = 1000.0
#: faults, warnings or diagnoses of one slave that are conditions
_MOST_TEXTS: Final = 16
#: slaves of a bus
_MOST_SLAVES: Final = 127
#: remarks that wait for the caller
_MOST_REMARKS: Final = 100

#: troubles of the values of a slave that is there
_OF_VALUES: Final = frozenset({Reason.NOT_VALID, Reason.TOO_OLD})
#: states of a slave, as the live stream has them


class Changed(NamedTuple):
    """A node has another value, quality or reason."""

    node: Node
    reading: Reading


class Born(NamedTuple):
    """The bus (``slave`` None) or a slave has come: publish all its nodes (:meth:`PlantTree.readings`)."""

    slave: int | None


class Died(NamedTuple):
    """The bus (``slave`` None) or a slave has gone. Values of its nodes that have become stale come behind it."""

    slave: int | None
    why: str


class NodesChanged(NamedTuple):
    """The nodes of the bus and of its slaves are others than before."""


class Remark(NamedTuple):
    """Something that a person should know, once; printable."""

    text: str


class ClockSet(NamedTuple):
    """The clock of the computer minus that of the stream is now ``offset`` s (0 before the first one): times that were
    published before are wrong by the difference. The tree does not give this out, as it has no clock; a gateway does.
    """

    offset: float


Change = Changed | Born | Died | Condition | Remark | NodesChanged | ClockSet


#: the reason why nothing is good, with a note; None: nothing is in the way
Trouble = tuple[Reason, str] | None


class _Branch:
    """The bus, or one slave: its nodes and the values that they have."""

    def __init__(self, slave: int | None, described: Described) -> None:
        self.slave = slave
        self.described = described
        #: of a slave: its part of the plant, and the nodes for which there was room; ``described`` was made of these
        self.plant: SlavePlant | None = None
        self.room = 0
        #: the values of the stream, merged, and the keys that have come; None before the first
        self.values: BusValues | SlaveValues | None = None
        self.there: set[str] = set()
        #: time of the stream, and of the caller, when they came
        self.t = 0.0
        self.heard = -math.inf
        #: a plant or whole snapshot has come since, at this time of the caller: the next values replace them
        self.awaited: float | None = None
        self.exchanged = False
        self.born = False
        #: the values have changed since they were compared; or a statistic waits for this time of the caller
        self.is_new = True
        self.due = math.inf
        #: the trouble at that comparison
        self.trouble: tuple[Trouble, Trouble] = (None, None)
        self.now: dict[str, Reading] = {}
        #: the last reading of nodes that are bad now, before they became so
        self.usable: dict[str, Reading] = {}
        #: as given out; None: nothing yet of these nodes, so that values of nodes of the same name are replaced
        self.told: dict[str, Reading | None] = {}
        self.told_at: dict[str, float] = {}

    @property
    def slave_values(self) -> SlaveValues:
        return self.values if isinstance(self.values, SlaveValues) else _NO_SLAVE


_NO_BUS: Final = BusValues()
_NO_SLAVE: Final = SlaveValues()


class PlantTree:
    """``silent_s``: see :data:`SILENT_S`. ``statistics_s``: a statistic changes no more often.

    ``conditions``: all that are retained. ``lost``: events that did not arrive.
    """

    def __init__(self, *, silent_s: float = SILENT_S, statistics_s: float = STATISTICS_S) -> None:
        self.conditions = ConditionBook()
        self.lost = 0
        self._silent_s = silent_s
        self._statistics_s = statistics_s
        self._plant: Plant | None = None
        self._started = 0.0
        self._bus = _Branch(None, Described("", ()))
        self._slaves: dict[int, _Branch] = {}
        self._t = 0.0
        #: the caller's time at the last snapshot; None before the first one behind a plant
        self._heard: float | None = None
        self._delay: float | None = None
        self._late = False
        self._silent_process = False
        #: text of the end; and whether a fault has ended the bus
        self._end: str | None = None
        self._failed = False
        self._orders: dict[str, OfferedOrder] = {}
        self._told: set[str] = set()
        self._forgotten = 0

    # --- reading the tree -----------------------------------------------------------------------------------------

    @property
    def plant(self) -> Plant | None:
        """The item ``plant``; None before the first."""
        return self._plant

    @property
    def slaves(self) -> Mapping[int, Described]:
        """The slaves by address, ascending."""
        return {address: branch.described for address, branch in self._slaves.items()}

    @property
    def nodes(self) -> Iterator[Node]:
        """All nodes: those of the bus, then those of the slaves by address."""
        for branch in self._branches():
            yield from branch.described.nodes

    @property
    def orders(self) -> Mapping[str, OfferedOrder]:
        """The orders that the plant takes, by name. Two with the same name are left out: they are ambiguous."""
        return self._orders

    @property
    def has_ended(self) -> bool:
        """Whether the bus has said that it ended, in order or by a fault."""
        return self._end is not None

    @property
    def has_failed(self) -> bool:
        """Whether a fault has ended the bus, for instance SIGKILL of its process."""
        return self._end is not None and self._failed

    @property
    def t(self) -> float:
        """The time of the last snapshot in s since the start of the stream."""
        return self._t

    def time_at(self, now: float) -> float | None:
        """The time of the stream at ``now`` in s since 1970. None while it is not known: the bus is not alive, or its
        stream goes by a clock of its own (a simulated bus, a recording)."""
        return self._started + now - self._delay if self._bus.born and self._delay is not None else None

    def is_alive(self, slave: int | None) -> bool:
        """Whether the bus (None) or the slave was born and has not died."""
        branch = self._branch(slave)
        return branch is not None and branch.born

    def trouble(self, slave: int | None) -> Trouble:
        """The reason why values of the bus (None), or process data of a slave, are not good, as judged last."""
        branch = self._branch(slave)
        if branch is None or self._plant is None:
            return Reason.WAITING, ""
        return branch.trouble[0] if slave is None else branch.trouble[0] or branch.trouble[1]

    def readings(self, slave: int | None) -> list[tuple[Node, Reading]]:
        """All nodes of the bus (None) or of a slave with their values: the content of a birth."""
        branch = self._branch(slave)
        return [] if branch is None else [(node, branch.now[node.id]) for node in branch.described.nodes]

    @property
    def bus_values(self) -> BusValues:
        """The values of the bus in the stream; None in each before the first."""
        values = self._bus.values
        return values if isinstance(values, BusValues) else _NO_BUS

    def slave_values(self, address: int) -> SlaveValues:
        """The values of a slave in the stream; None in each before the first."""
        branch = self._slaves.get(address)
        return _NO_SLAVE if branch is None else branch.slave_values

    # --- changing it ----------------------------------------------------------------------------------------------

    def apply(self, item: Mapping[str, Any], now: float) -> list[Change]:
        """Take the next item, which came at ``now``. An invalid item changes nothing and is reported once."""
        return self.apply_all((item,), now)

    def apply_all(self, items: Iterable[Mapping[str, Any]], now: float) -> list[Change]:
        """Take items that were there together at ``now``. They are judged once, behind the last one: if a program
        that was stopped finds old items, nobody dies of them to be born again at once."""
        return [change for part in self.apply_in_parts(items, now) for change in part]

    def apply_in_parts(self, items: Iterable[Mapping[str, Any]], now: float) -> Iterator[list[Change]]:
        """As :meth:`apply_all`, in a part for each slave: a caller whose loop drives a bus lets others have their turn
        between them. Nothing else may be applied before the last part."""
        yield [change for item in items for change in self._take(item, now)]
        yield from self._tick(now)

    def _take(self, item: Mapping[str, Any], now: float) -> list[Change]:
        found: list[Change] = []
        try:
            checked = check_item(item)
        except ValueError as error:
            return self._remark(str(error))
        if checked.plant is not None:
            found += self._take_plant(checked.plant, now)
        elif checked.snapshot is not None:
            found += self._take_snapshot(item["snapshot"], checked.snapshot, now)
        elif checked.event is not None:
            found += self._take_event(item["event"], checked.event)
        elif checked.lost is not None:
            self.lost += checked.lost
            self._silent_process = False  # its end may be among them; the counters show it, too
            found += self._remark("events of the bus were lost: alarms among them are not shown")
        elif checked.end is not None:
            self._end = clean(checked.end.text) or "the bus has ended"
            self._failed = checked.end.failed
        return found

    def tick(self, now: float) -> list[Change]:
        """The changes since the last call that came with the passing of time, or with the items taken."""
        return [change for part in self._tick(now) for change in part]

    def _tick(self, now: float) -> Iterator[list[Change]]:
        """The bus is born before its slaves, and dies behind them."""
        if self._plant is None:
            return
        trouble = self._bus_trouble(now)
        dies = self._bus.born and trouble is not None
        if not dies:
            bus = [*self._compare(self._bus, (trouble, None), now)]
            if not self._bus.born and trouble is None:
                self._bus.born = True
                bus.append(Born(None))
            yield bus
        for branch in tuple(self._slaves.values()):
            yield self._judge(branch, trouble, now)
        found = self._bus_conditions(trouble)
        if dies and trouble is not None:
            self._bus.born = False
            died = Died(None, Reason.with_note(*trouble))
            found = [died, *self._compare(self._bus, (trouble, None), now), *found]
        if self.conditions.left_out > self._forgotten:
            self._forgotten = self.conditions.left_out
            found += self._remark("there are more conditions than can be kept: the oldest are forgotten")
        yield found

    def acknowledge(self, id_: str, by: str = "", comment: str | None = None) -> list[Change]:
        """Acknowledge a condition. Nothing changes if it is not there, or acknowledged already. ``comment`` None
        leaves the one that it has."""
        said = None if comment is None else clean(comment)
        found = self.conditions.acknowledge(id_, self._time(self._t), clean(by), said)
        return [] if found is None else [found]

    def comment(self, id_: str, by: str, comment: str) -> list[Change]:
        """Give a condition another comment. Nothing changes if it is not there."""
        found = self.conditions.comment(id_, self._time(self._t), clean(by), clean(comment))
        return [] if found is None else [found]

    # --- items ----------------------------------------------------------------------------------------------------

    def _take_plant(self, plant: Plant, now: float) -> list[Change]:
        found: list[Change] = []
        started = min(max(0.0, plant.started), _LATEST)
        other_run = self._plant is None or started != self._started
        writable = plant.read_only is False
        # orders depend on it
        is_as_before = self._plant is not None and (self._plant.read_only is False) is writable
        self._plant, self._started, self._end = plant, started, None
        self._silent_process = False
        changed = False
        before, self._slaves = self._slaves, {}
        if other_run:
            found += self._end_branches(before, "another run of the bus has begun")
            self._t, self._heard, self._delay, self._late = 0.0, None, None, False
            bus = bus_of(plant)
            changed = not is_as_before or bus != self._bus.described
            self._bus = _Branch(None, bus)
            self._fill(self._bus)
            found += self._end_alarms("another run of the bus has begun")
        room = MOST_NODES
        given = sorted((int(address), one) for address, one in plant.slaves.items() if int(address) < _MOST_SLAVES)
        for address, one in given:
            branch = before.pop(address, None)
            if branch is not None and is_as_before and room == branch.room and one == branch.plant:
                described = branch.described
            else:
                described = slave_of(address, one, writable=writable, room=room)
            is_same = branch is not None and branch.described == described
            if branch is None or other_run or not is_same:
                if branch is not None:
                    found += self._end_branch(branch, "its configuration has changed")
                branch = _Branch(address, described)
                self._fill(branch)
                changed = changed or not is_same
            branch.plant, branch.room = one, room
            room -= len(described.nodes)
            if described.left_out:
                found += self._remark(f"slave {address}: {described.left_out} named values cannot be shown")
            self._slaves[address] = branch
        for address, branch in before.items():
            found += self._end_branch(branch, "it was removed from the configuration")
            found += self._end_of_slave(address, "removed from the configuration")
            changed = True
        if len(given) < len(plant.slaves):
            found += self._remark("the stream has slaves with addresses above 126: they are left out")
        self._await_all(now)
        if changed:
            found += [*self._name_orders(), NodesChanged()]
        return found

    def _name_orders(self) -> list[Change]:
        all_of = [order for branch in self._slaves.values() for order in branch.described.orders]
        times = Counter(order.name for order in all_of)
        self._orders = {order.name: order for order in all_of if times[order.name] == 1}
        found: list[Change] = []
        for name, count in times.items():
            if count > 1:
                found += self._remark(f"{count} orders are called {name}: none of them can be given")
        return found

    def _await_all(self, now: float) -> None:
        for branch in self._branches():
            branch.awaited = now if branch.awaited is None else branch.awaited

    def _take_snapshot(self, given: Mapping[str, Any], snapshot: Snapshot, now: float) -> list[Change]:
        if self._plant is None:
            return self._remark("a snapshot came before the plant: it is left out")
        self._measure_delay(snapshot.t, now)
        self._t, self._heard = snapshot.t, now
        if snapshot.whole:
            self._await_all(now)
        if given["bus"]:
            self._merge(self._bus, snapshot.bus, given["bus"], now)
        found: list[Change] = []
        for address, values in snapshot.slaves.items():
            branch = self._slaves.get(int(address))
            if branch is None:
                found += self._remark(f"the stream has values of slave {int(address)}, which is not in the plant")
                continue
            self._merge(branch, values, given["slaves"][address], now)
            found += self._slave_conditions(branch)
        return found

    def _merge(self, branch: _Branch, values: BusValues | SlaveValues, keys: Iterable[str], now: float) -> None:
        """The first values behind a plant or a whole snapshot replace the earlier ones: they are whole."""
        if branch.values is None or branch.awaited is not None:
            branch.values, branch.there = values, set(keys)
            branch.awaited = None
        else:
            branch.values = merged(branch.values, values, keys)
            branch.there.update(keys)
        branch.t, branch.heard, branch.is_new = self._t, now, True

    def _measure_delay(self, t: float, now: float) -> None:
        """Find out whether the stream arrives late: its items may have waited, while this program did not run."""
        assert self._plant is not None
        if self._plant.virtual is True or self._plant.is_replay:
            return  # they go by clocks of their own
        delay = now - t
        if self._heard is None or self._delay is None or t < self._t:
            self._delay = delay
        else:
            self._delay = min(self._delay + _DRIFT * max(0.0, now - self._heard), delay)
        self._late = delay - self._delay > self._silent_s

    def _take_event(self, given: Mapping[str, Any], event: EventValues) -> list[Change]:
        if event.event == "bus_process":
            self._silent_process = event.silent is True
        if event.event == "alarm" and event.address in self._slaves:
            return self._alarm(event.address, given)
        return []

    # --- quality --------------------------------------------------------------------------------------------------

    def _bus_trouble(self, now: float) -> Trouble:
        """The reason why no value of the bus is good; None: nothing is in the way."""
        assert self._plant is not None
        if self._end is not None:
            return Reason.FAILED if self._failed else Reason.ENDED, self._end
        if self._heard is None:
            return Reason.WAITING, ""
        if now - self._heard > self._silent_s or now < self._heard:
            return Reason.STREAM_SILENT, ""
        if self._late:
            return Reason.STREAM_LATE, ""
        if self._plant.baud is None and not self._plant.is_replay:
            return Reason.SEARCHING, ""
        if self._bus.values is None:
            return Reason.WAITING, ""
        # a bus that is not open yet is offline, too
        if self._silent_process or self.bus_values.stale is True or self.bus_values.mode == "offline":
            return Reason.BUS_STALE, ""
        if self._bus.awaited is not None and now - self._bus.awaited > self._silent_s:
            return Reason.STREAM_SILENT, ""
        return None

    def _slave_trouble(self, branch: _Branch, now: float) -> Trouble:
        """The reason why neither process data nor drive of a slave is good, while the bus is."""
        if branch.values is None:
            return Reason.WAITING, ""
        values = branch.slave_values
        waited = max(now - branch.heard, 0.0 if branch.awaited is None else now - branch.awaited)
        replay = self._plant is not None and self._plant.is_replay  # a recording of named values has no ages
        trouble = trouble_of(values, self._limit_ms(branch), has_ages=not replay)
        if waited > self._silent_s and (trouble is None or trouble[0] is not Reason.NOT_EXCHANGING):
            return Reason.NOT_SENT, ""  # the counters of a slave in data exchange never stand still
        return trouble

    def _limit_ms(self, branch: _Branch) -> float:
        values = branch.slave_values
        given = values.watchdog_ms if values.inputs_limit_ms is None else values.inputs_limit_ms
        return given or branch.described.watchdog_ms or _UNWATCHED_MS

    # --- values ---------------------------------------------------------------------------------------------------

    def _judge(self, branch: _Branch, trouble: Trouble, now: float) -> list[Change]:
        """Values, birth and death of a slave."""
        own = trouble or self._slave_trouble(branch, now)
        found: list[Change] = []
        if branch.born and own is not None and own[0] not in _OF_VALUES:
            branch.born = False
            found.append(Died(branch.slave, Reason.with_note(*own)))
        found += self._compare(branch, (trouble, own), now)
        if not branch.born and own is None:
            branch.born = True
            found.append(Born(branch.slave))
        return found

    def _compare(self, branch: _Branch, trouble: tuple[Trouble, Trouble], now: float) -> Iterator[Change]:
        """The nodes with news. ``trouble``: that of the bus; and that of process data and drive."""
        if not branch.is_new and branch.trouble == trouble and now < branch.due:
            return
        branch.is_new, branch.trouble, branch.due = False, trouble, math.inf
        for node in branch.described.nodes:
            before, here = branch.now[node.id], self._read(node, branch, trouble)
            if here.quality is Quality.BAD and before.quality is not Quality.BAD:
                branch.usable[node.id] = before
            branch.now[node.id] = here
            told = branch.told[node.id]
            if told is not None and here.reason is told.reason and here.note == told.note:
                if not is_news(told.value, here.value, node.dead_band):
                    continue
                due = branch.told_at[node.id] + self._statistics_s
                if node.kind is Kind.STATISTIC and now < due:
                    branch.due = min(branch.due, due)
                    continue
            branch.told[node.id] = here
            branch.told_at[node.id] = now
            yield Changed(node, here)

    def _read(self, node: Node, branch: _Branch, trouble: tuple[Trouble, Trouble]) -> Reading:
        values, before, by_master = branch.values, branch.now[node.id], node.source is Source.MASTER
        because = trouble[0 if by_master else 1]
        if because is not None:
            return _old(node, branch, *because)
        if values is None:
            return _old(node, branch, Reason.WAITING)
        if branch.awaited is not None:
            return before  # the next part of the snapshot brings it; until then nothing is known of this moment
        if node.source is Source.DRIVE:
            drive = branch.slave_values.drive
            if drive is None or drive.state == "offline":
                return _old(node, branch, Reason.DRIVE_OFFLINE)
        given, is_there = _look_up(branch, node)
        time = self._time(branch.t - (0 if by_master else (branch.slave_values.inputs_age_ms or 0) / 1000))
        if given is None and by_master and is_there and node.type == TEXT:
            return Reading("", Reason.GOOD, time)  # no fault, no diagnosis, no Clear
        if given is None and node.source in (Source.MASTER, Source.DRIVE):
            return Reading(None, Reason.NOT_THERE, time)
        value = value_of(given, node.type)
        judged = GOOD if by_master else _judged(branch.slave_values, node)
        if judged.quality is Quality.STALE:
            return _old(node, branch, judged.reason, judged.note)
        if value is None and judged.quality is not Quality.BAD:
            return Reading(None, Reason.NO_VALUE, time)
        return Reading(value, judged.reason, time, judged.note)

    def _time(self, t: float) -> float:
        return min(max(0.0, self._started + t), _LATEST)

    # --- branches -------------------------------------------------------------------------------------------------

    def _branches(self) -> Iterator[_Branch]:
        yield self._bus
        yield from self._slaves.values()

    def _branch(self, slave: int | None) -> _Branch | None:
        return self._bus if slave is None else self._slaves.get(slave)

    def _fill(self, branch: _Branch) -> None:
        branch.now = {node.id: Reading() for node in branch.described.nodes}
        branch.usable.clear()
        branch.told = dict.fromkeys(branch.now)
        branch.told_at = dict.fromkeys(branch.now, -math.inf)

    def _end_branch(self, branch: _Branch, why: str) -> Iterable[Change]:
        if branch.born:
            branch.born = False
            yield Died(branch.slave, why)

    def _end_branches(self, slaves: Mapping[int, _Branch], why: str) -> Iterator[Change]:
        """Deaths of ``slaves``, and of the bus."""
        for branch in slaves.values():
            yield from self._end_branch(branch, why)
        yield from self._end_branch(self._bus, why)

    # --- conditions -----------------------------------------------------------------------------------------------

    def _slave_conditions(self, branch: _Branch) -> list[Change]:
        values, address = branch.slave_values, branch.slave
        own, time = f"slave/{address}", self._time(self._t)
        name, exchanges = branch.described.name, exchanging(values)
        said = "" if values.fault is None else clean(values.fault.text)
        found: list[Condition | None] = []
        branch.exchanged = branch.exchanged or exchanges
        if said or (branch.exchanged and not exchanges):
            text = said or f"not in data exchange: {clean(values.state) or 'unknown'}"
            found.append(
                self.conditions.show(f"{own}/fault", address, f"{name}: data exchange", text, Severity.ERROR, time)
            )
        else:
            found.append(self.conditions.end(f"{own}/fault", time))
        found.append(self._diagnosis_condition(branch, time))
        if not exchanges:
            found += self._end_alarms_of(branch, "the slave left data exchange")
        drive = values.drive
        if exchanges and drive is not None and drive.state != "offline":
            for key, said_by, title, level in (
                ("faults", drive.faults, "fault", Severity.ERROR),
                ("warnings", drive.warnings, "warning", Severity.WARNING),
            ):
                texts = [clean(one)[:120] for one in (said_by or ())[:_MOST_TEXTS]]
                prefix = f"{own}/drive/{key}/"
                shown = {f"{prefix}{text}": (f"{name}: drive {title}", text, level) for text in texts if text}
                found += self.conditions.show_only(prefix, address, shown, time)
        return [one for one in found if one is not None]

    def _diagnosis_condition(self, branch: _Branch, time: float) -> Condition | None:
        """The diagnosis of the slave, and its values that are bad or uncertain: the words of the fault first, then all
        that the diagnosis has. One that is announced only makes no condition: the next snapshot has its words."""
        values, id_ = branch.slave_values, f"slave/{branch.slave}/diagnosis"
        remark = diagnosis_remark(values, announced=False)
        if remark is None:
            return self.conditions.end(id_, time)
        texts = dict.fromkeys((remark.text, values.conspicuous or ""))
        level, text = Severity(remark.severity), clean("; ".join(filter(None, texts)))
        return self.conditions.show(id_, branch.slave, f"{branch.described.name}: diagnosis", text, level, time)

    def _alarm(self, address: int, event: Mapping[str, Any]) -> list[Change]:
        """An alarm of DP-V1. One that appears is active until one of its type and slot disappears; any other is an
        event that does not last."""
        type_, slot = event.get("type"), event.get("slot")
        if not _is_small(type_) or not _is_small(slot):
            return self._remark(f"slave {address}: an alarm without type or slot")
        id_ = f"slave/{address}/alarm/{type_}/{slot}"
        time = self._time(_float(event.get("t"), self._t))
        text, specifier = clean(event.get("text")) or clean(event.get("title")), event.get("specifier")
        if specifier == "disappears":
            found = self.conditions.end(id_, time, text)
        else:
            lasts = specifier in ("appears", "disappears_others")
            title = f"{self._slaves[address].described.name}: {clean(event.get('title')) or f'alarm {type_}'}"
            found = self.conditions.show(id_, address, title, text, Severity.WARNING, time, active=lasts)
        return [] if found is None else [found]

    def _end_alarms_of(self, branch: _Branch, why: str) -> list[Condition | None]:
        """A slave that comes back raises its alarms again."""
        time = self._time(self._t)
        return [
            self.conditions.end(one.id, time, f"{one.text} ({why})")
            for one in self.conditions.of(branch.slave)
            if one.active and one.id.startswith(f"slave/{branch.slave}/alarm/")
        ]

    def _end_of_slave(self, address: int, why: str) -> list[Change]:
        time = self._time(self._t)
        found = [self.conditions.end(one.id, time, f"{one.text} ({why})") for one in self.conditions.of(address)]
        return [one for one in found if one is not None]

    def _end_alarms(self, why: str) -> list[Change]:
        slaves = {one.slave for one in self.conditions if one.slave is not None}
        return [change for address in sorted(slaves) for change in self._end_of_slave(address, why)]

    def _bus_conditions(self, trouble: Trouble) -> list[Change]:
        time = self._time(self._t)
        found: list[Condition | None] = []
        if trouble is not None and trouble[0] is not Reason.WAITING:
            level = Severity.WARNING if trouble[0] in (Reason.SEARCHING, Reason.ENDED) else Severity.ERROR
            found.append(self.conditions.show("bus/dead", None, "bus", Reason.with_note(*trouble), level, time))
        elif trouble is None:
            found.append(self.conditions.end("bus/dead", time))
        if trouble is None:
            clear = self.bus_values.clear
            if clear is not None:
                because = clean(clear.because)
                found.append(self.conditions.show("bus/clear", None, "bus in Clear", because, Severity.ERROR, time))
            else:
                found.append(self.conditions.end("bus/clear", time))
        return [one for one in found if one is not None]

    def _remark(self, text: str) -> list[Change]:
        """Report ``text`` once, and only the first ones."""
        text = shortened(printable(text), 300)
        if text in self._told or len(self._told) >= _MOST_REMARKS:
            return []
        self._told.add(text)
        return [Remark(text)]


def _old(node: Node, branch: _Branch, reason: Reason, note: str = "") -> Reading:
    """The last value of ``node`` that was not bad, which is old for this reason."""
    before = branch.now[node.id]
    if before.quality is Quality.BAD:
        before = branch.usable.get(node.id, before._replace(value=None))
    return before._replace(reason=reason, note=note)


def _judged(values: SlaveValues, node: Node) -> Judged:
    """The quality that the snapshot gives to process data and drive."""
    found = read_back(values.quality) or GOOD
    if node.kind is Kind.VALUE and values.qualities:
        found = worse(read_back(values.qualities.get(node.keys[-1])) or GOOD, found)
    return found


def _look_up(branch: _Branch, node: Node) -> tuple[object, bool]:
    """The value of ``node`` in the stream, and whether it is there."""
    if node.keys[0] not in branch.there:
        return None, False
    found: object = branch.values
    for key in node.keys:
        if isinstance(found, Mapping):
            if key not in found:
                return None, False
            found = found[key]
        elif hasattr(found, key):
            found = getattr(found, key)
        else:
            return None, False
    if isinstance(found, list) and node.type == TEXT:
        found = ", ".join(str(one) for one in found[: _MOST_TEXTS * 8] if isinstance(one, (str, int)))
    elif isinstance(found, Held):
        found = found.because
    elif isinstance(found, FaultValues):
        found = found.text
    return found, True


def _float(given: object, default: float = 0.0) -> float:
    found: Value = value_of(given, FLOAT)
    return found if isinstance(found, float) else default


def _is_small(given: object) -> bool:
    return isinstance(given, int) and not isinstance(given, bool) and 0 <= given <= 255
