"""A gateway between a live stream and connectors that fail in every way: the others get every change, and the end
comes."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Sequence
from typing import Any, ClassVar

import pytest
from api_kit import in_virtual_time

from dpstack.bridge.connector import Connector, RemarkReporter, Tell
from dpstack.bridge.gateway import END_S, MOST_CHANGES, MOST_ITEMS, TICK_S, Gateway
from dpstack.errors import ConfigError
from dpstack.plant.conditions import Condition
from dpstack.plant.quality import Quality
from dpstack.plant.tree import SILENT_S, Born, Change, Changed, ClockSet, Died, PlantTree
from dpstack.trace import Severity

FINE: dict[str, Any] = {"state": "data_exchange", "inputs_valid": True, "inputs_age_ms": 1.0, "inputs_limit_ms": 100.0}


def plant(started: float = 1_700_000_000.0) -> dict[str, Any]:
    valves = {"name": "valves", "inputs": [{"name": "level", "type": "i16", "at": "i16@0"}]}
    return {"plant": {"started": started, "baud": 500_000, "read_only": False, "slaves": {"8": valves}}}


def snapshot(t: float, level: int) -> dict[str, Any]:
    slave = FINE | {"fields": {"level": level}}
    return {"snapshot": {"t": t, "whole": True, "bus": {"stale": False}, "slaves": {"8": slave}}}


ALARM = {"event": "alarm", "address": 8, "type": 1, "slot": 2, "specifier": "appears", "text": "gone", "t": 0.1}


async def nothing() -> AsyncIterator[dict[str, Any]]:
    none: list[dict[str, Any]] = []
    for item in none:
        yield item


class Recorder(Connector):
    """Keeps all changes, and what it was asked for."""

    name: ClassVar[str] = "recorder"

    def __init__(self, tree: PlantTree, tell: Tell) -> None:
        super().__init__(tree, tell)
        self.changes: list[Change] = []
        self.batches = 0
        self.ended_at: float | None = None

    def take(self, changes: Sequence[Change]) -> None:
        self.changes += changes
        self.batches += 1

    async def serve(self) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            self.ended_at = asyncio.get_running_loop().time()

    @property
    def lives(self) -> list[Born | Died]:
        return [one for one in self.changes if isinstance(one, (Born, Died))]

    @property
    def levels(self) -> list[object]:
        return [one.reading.value for one in self.changes if isinstance(one, Changed) and one.node.unit == ""
                and one.node.path[-1] == "level" and one.reading.quality is Quality.GOOD]  # fmt: skip


class Raising(Recorder):
    name = "raising"

    def take(self, changes: Sequence[Change]) -> None:
        super().take(changes)
        if self.levels:
            raise ZeroDivisionError("no \x1b[31m colour")


class Wrong(Recorder):
    name = "wrong"

    async def serve(self) -> None:
        raise ConfigError("url: no such scheme; write mqtt://host")


class Leaving(Recorder):
    name = "leaving"

    async def serve(self) -> None:
        await asyncio.sleep(0.3)


class Cancelled(Recorder):
    name = "cancelled"

    async def serve(self) -> None:
        raise asyncio.CancelledError


class Deaf(Recorder):
    """Takes a long time for its farewell, and does not care for a first cancellation."""

    name = "deaf"

    async def serve(self) -> None:
        try:
            await super().serve()
        finally:
            await asyncio.sleep(3600)


class Stubborn(Recorder):
    """Goes on whatever happens, until the test lets it go."""

    name = "stubborn"

    def __init__(self, tree: PlantTree, tell: Tell) -> None:
        super().__init__(tree, tell)
        self.may_end = asyncio.Event()

    async def serve(self) -> None:
        while not self.may_end.is_set():
            with contextlib.suppress(asyncio.CancelledError):
                await self.may_end.wait()
        self.ended_at = asyncio.get_running_loop().time()


class World:
    """A gateway with connectors, fed by hand."""

    def __init__(self, *kinds: type[Recorder], wall: float = 1_700_000_000.0) -> None:
        self.told: list[tuple[str, Severity]] = []
        self.tree = PlantTree()
        self.connectors = [kind(self.tree, RemarkReporter(kind.name, self.tell)) for kind in kinds]
        self.items: asyncio.Queue[dict[str, Any] | Exception | None] = asyncio.Queue()
        self.begun = asyncio.get_running_loop().time()
        self.wall = wall
        self.gateway = Gateway(self._stream(), self.connectors, tree=self.tree, tell=self.tell, now=self._now)
        self.running = asyncio.ensure_future(self.gateway.run())

    def tell(self, text: str, severity: Severity) -> None:
        self.told.append((text, severity))

    @property
    def t(self) -> float:
        return asyncio.get_running_loop().time() - self.begun

    def _now(self) -> float:
        return self.wall + self.t

    async def _stream(self) -> AsyncIterator[dict[str, Any]]:
        while (item := await self.items.get()) is not None:
            if isinstance(item, Exception):
                raise item
            yield item

    async def play(self, seconds: float, *, first: int = 0) -> None:
        """Snapshots every 0.1 s, each with another level."""
        for step in range(round(seconds * 10)):
            self.items.put_nowait(snapshot(self.t, first + step))
            await asyncio.sleep(0.1)

    async def up(self) -> None:
        self.items.put_nowait(plant())
        await self.play(0.5)


@in_virtual_time
async def test_connectors_that_fail_in_every_way_end_alone() -> None:
    world = World(Raising, Wrong, Recorder, Leaving, Cancelled)
    await world.up()
    raising, wrong, recorder, leaving, cancelled = world.connectors
    assert world.gateway.connectors == (recorder,)
    assert recorder.levels == [0, 1, 2, 3, 4]
    assert raising.levels == [0]
    assert raising.ended_at is not None
    assert dict(world.told) == {
        "wrong: url: no such scheme; write mqtt://host": Severity.ERROR,
        "raising: it has ended by a fault of its program (ZeroDivisionError: no \\x1b[31m colour); "
        "the bus goes on without it": Severity.ERROR,
        "leaving: it has ended by itself; the bus goes on without it": Severity.ERROR,
        "cancelled: it has ended by itself; the bus goes on without it": Severity.ERROR,
    }
    world.items.put_nowait({"end": {"text": "stopped"}})
    world.items.put_nowait(None)
    await world.running
    assert recorder.lives[-2:] == [Died(8, "the bus has ended: stopped"), Died(None, "the bus has ended: stopped")]
    assert recorder.ended_at == pytest.approx(world.begun + world.t)
    assert len(world.told) == 4
    assert (wrong.changes, leaving.batches > 0, cancelled.changes) == ([], True, [])


@in_virtual_time
async def test_a_connector_that_does_not_end_holds_up_nobody_for_long() -> None:
    world = World(Deaf, Recorder)
    await world.up()
    deaf, recorder = world.connectors
    begun = world.t
    world.running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await world.running
    assert recorder.ended_at == pytest.approx(world.begun + begun)
    assert END_S <= world.t - begun < END_S + 1
    assert deaf.ended_at is not None
    # its second cancellation ended it
    assert world.told == []


@in_virtual_time
async def test_a_connector_that_never_ends_is_left() -> None:
    world = World(Stubborn, Recorder)
    await world.up()
    begun = world.t
    world.items.put_nowait(None)
    await world.running
    assert END_S < world.t - begun < END_S + 1
    assert world.told == [("stubborn: it did not end in time, and was left", Severity.WARNING)]
    stubborn = world.connectors[0]
    assert isinstance(stubborn, Stubborn)
    stubborn.may_end.set()
    await asyncio.sleep(0.1)
    assert stubborn.ended_at is not None


@in_virtual_time
async def test_a_second_cancellation_waits_for_nobody() -> None:
    world = World(Deaf)
    await world.up()
    world.running.cancel()
    await asyncio.sleep(0.1)
    begun = world.t
    world.running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await world.running
    assert world.t == begun


@in_virtual_time
async def test_a_stream_that_stops_kills_within_its_limit() -> None:
    world = World(Recorder)
    await world.up()
    [recorder] = world.connectors
    silent_since = world.t - 0.1
    while recorder.lives == [Born(None), Born(8)]:  # noqa: ASYNC110  virtual time
        await asyncio.sleep(0.05)
    assert SILENT_S < world.t - silent_since <= SILENT_S + TICK_S + 0.1
    assert [one.slave for one in recorder.lives[2:]] == [8, None]
    await world.play(0.1, first=77)
    assert recorder.lives[4:] == [Born(None), Born(8)]
    assert recorder.levels[-1] == 77
    world.running.cancel()


@in_virtual_time
async def test_the_loop_has_its_turn_between_two_slaves() -> None:
    """All values of a large plant come at once, and the loop may drive its bus."""
    turn = 0
    by_turn: dict[int, set[int | None]] = {}

    class Turns(Recorder):
        def take(self, changes: Sequence[Change]) -> None:
            super().take(changes)
            values = {one.node.slave for one in changes if isinstance(one, Changed)}
            by_turn[turn] = by_turn.get(turn, set()) | values

    async def count() -> None:
        nonlocal turn
        for turn in range(100_000):  # noqa: B007
            await asyncio.sleep(0)

    world = World(Turns)
    given, fields = plant(), snapshot(0.0, 5)
    level = {"type": "i16", "at": "i16@0"}
    given["plant"]["slaves"]["8"]["inputs"] = [level | {"name": f"level{n}"} for n in range(MOST_CHANGES)]
    fields["snapshot"]["slaves"]["8"]["fields"] = {f"level{n}": n for n in range(MOST_CHANGES)}
    for address in ("9", "10", "11"):
        given["plant"]["slaves"][address] = given["plant"]["slaves"]["8"] | {"name": f"valves {address}"}
        fields["snapshot"]["slaves"][address] = fields["snapshot"]["slaves"]["8"]
    counting = asyncio.create_task(count())
    world.items.put_nowait(given)
    world.items.put_nowait(fields)
    await asyncio.sleep(0.1)
    counting.cancel()
    world.running.cancel()
    assert set().union(*by_turn.values()) == {None, 8, 9, 10, 11}
    assert max(len(slaves - {None}) for slaves in by_turn.values()) == 1


@pytest.mark.parametrize("broken", [False, True])
def test_a_stream_that_ends_without_a_word_is_the_death_of_all(broken: bool) -> None:
    @in_virtual_time
    async def run() -> None:
        world = World(Recorder)
        await world.up()
        [recorder] = world.connectors
        world.items.put_nowait(OSError("cut") if broken else None)
        if broken:
            with pytest.raises(OSError, match="cut"):
                await world.running
        else:
            await world.running
        why = "the bus has ended: the live stream has ended"
        if broken:
            why = "a fault has ended the bus: the live stream has ended by an error: cut"
        assert recorder.lives[2:] == [Died(8, why), Died(None, why)]
        assert recorder.ended_at is not None

    run()


@in_virtual_time
async def test_a_burst_of_old_items_is_no_storm_of_deaths_and_births() -> None:
    """The program was stopped for a minute; 800 items wait, and the bus is well."""
    world = World(Recorder)
    await world.up()
    [recorder] = world.connectors
    batches = recorder.batches
    world.wall -= 60  # both clocks went on, only this loop did not
    world.begun -= 60
    for step in range(800):
        world.items.put_nowait(snapshot(world.t - 60 + step * 0.075, 1000 + step))
    await asyncio.sleep(0.01)
    assert recorder.batches == batches + 1
    assert recorder.levels[5:] == [1799]
    assert recorder.lives == [Born(None), Born(8)]
    world.running.cancel()


@in_virtual_time
async def test_a_source_that_never_waits_fills_no_memory() -> None:
    made: list[int] = []

    async def endless() -> AsyncIterator[dict[str, Any]]:
        yield plant()
        for number in range(100_000_000):
            made[:] = [number]
            yield snapshot(number / 1e6, number)

    tree = PlantTree()
    recorder = Recorder(tree, lambda *_: None)
    running = asyncio.ensure_future(Gateway(endless(), [recorder], tree=tree, tell=lambda *_: None).run())
    while not recorder.levels:  # noqa: ASYNC110  one turn of the loop
        await asyncio.sleep(0)
    assert made[0] <= 2 * MOST_ITEMS
    running.cancel()


def test_an_acknowledgement_by_one_connector_reaches_all() -> None:
    tree = PlantTree()
    first, second = (Recorder(tree, lambda text, severity: None) for _ in range(2))
    gateway = Gateway(nothing(), [first, second], tree=tree, tell=lambda text, severity: None)
    assert gateway.connectors == (first, second)
    for item in (plant(), snapshot(0.1, 5), {"event": ALARM}):
        tree.apply(item, 0.1)
    [condition] = tree.conditions
    assert first.acknowledge(condition.id, "anna", "seen")
    assert not second.acknowledge(condition.id, "bob")
    assert second.comment(condition.id, "bob", "mended")
    assert first.changes == second.changes
    said = [(one.acked, one.said_by, one.comment) for one in first.changes if isinstance(one, Condition)]
    assert said == [(True, "anna", "seen"), (True, "bob", "mended")]


@in_virtual_time
async def test_a_clock_that_is_set_is_given_out_once() -> None:
    """The computer began in 1970, the network sets its clock later; then it is set back a little, and once by hours."""
    world = World(Recorder, wall=5.0)
    [recorder] = world.connectors
    world.items.put_nowait(plant(started=5.0))
    await world.play(0.5)
    for moved in (1_700_000_000.0, -0.4, -7200.0):
        world.wall += moved
        await world.play(1.0)
    offsets = [one.offset for one in recorder.changes if isinstance(one, ClockSet)]
    assert offsets == [pytest.approx(1_700_000_000.0), pytest.approx(1_700_000_000.0 - 7200.4)]
    assert world.gateway.offset == offsets[-1]
    world.running.cancel()


def test_a_remark_that_repeats_the_last_one_is_left_out() -> None:
    told: list[str] = []
    tell = RemarkReporter("mqtt", lambda text, _: told.append(text))
    for text in ("no answer", "no answer", "connected", "no answer", "\x1b[2J", "x" * 999):
        tell(text, Severity.INFO)
    assert told[:4] == ["mqtt: no answer", "mqtt: connected", "mqtt: no answer", "mqtt: \\x1b[2J"]
    assert len(told[4]) <= 310
