"""The tree under random streams: a value is good only while the rules of docs/explanation/bridge.md hold, told by a
judge of its own."""

from __future__ import annotations

import copy
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_items import HOIST, PLANT, VALVES
from property_kit import examples

from dpstack.plant.conditions import MOST_OF_A_SLAVE, Condition
from dpstack.plant.nodes import Kind, Node, Source
from dpstack.plant.orders import DriveOrder, SetOutputs
from dpstack.plant.quality import Quality, Reading, Reason, value_of
from dpstack.plant.tree import SILENT_S, STATISTICS_S, Born, Change, Changed, Died, NodesChanged, PlantTree, Remark

IDENT = copy.deepcopy(PLANT) | {"slaves": {"3": PLANT["slaves"]["3"] | {"ident": "0x1234"}, "8": PLANT["slaves"]["8"]}}
LONELY = PLANT | {"slaves": {"8": PLANT["slaves"]["8"]}}
AGAIN = PLANT | {"started": 1_700_000_500.0}
SEARCHING = PLANT | {"baud": None, "slaves": {}}


def snapshot(t: float, slaves: dict[str, Any], *, whole: bool = False, bus: dict[str, Any] | None = None) -> Any:
    return {"snapshot": {"t": t, "whole": whole, "bus": {"stale": False} if bus is None else bus, "slaves": slaves}}


def up(tree: PlantTree, now: float = 0.0) -> list[Change]:
    """The plant and a first whole snapshot."""
    whole = snapshot(1.0, {"3": HOIST, "8": VALVES}, whole=True, bus={"stale": False, "mode": "operate"})
    return tree.apply({"plant": PLANT}, now) + tree.apply(whole, now)


@pytest.fixture
def tree() -> PlantTree:
    """The tree of a plant that is well."""
    made = PlantTree()
    up(made)
    return made


def reading(tree: PlantTree, id_: str) -> Reading:
    slave = int(id_.split("/")[1]) if id_.startswith("slave/") else None
    return next(found for node, found in tree.readings(slave) if node.id == id_)


# --- the judge ----------------------------------------------------------------------------------------------------


class Judge:
    """Keeps the facts of a stream in its own way: the last value of every key, and when it was confirmed."""

    def __init__(self) -> None:
        self.plant: dict[str, Any] | None = None
        self.bus: dict[str, Any] = {}
        self.slaves: dict[int, dict[str, Any]] = {}
        self.ended = self.process_silent = False
        self.last_snapshot = -1e9
        #: the next values of the bus are whole
        self.begins = True

    def see(self, item: dict[str, Any], now: float) -> None:
        if "plant" in item:
            run, self.plant = self.plant, item["plant"]
            if run is None or run["started"] != item["plant"]["started"]:
                self.bus, self.slaves, self.last_snapshot = {}, {}, -1e9
            self.slaves = {int(one): self.slaves.get(int(one), {}) for one in item["plant"]["slaves"]}
            self.ended = self.process_silent = False
            self.begins = True
        if "snapshot" in item and self.plant is not None:
            self.last_snapshot = now
            self.begins = self.begins or item["snapshot"]["whole"]
            if item["snapshot"]["bus"]:
                self.bus = ({} if self.begins else self.bus) | item["snapshot"]["bus"]
                self.begins = False
            for address, values in item["snapshot"]["slaves"].items():
                if int(address) in self.slaves:
                    self.slaves[int(address)] |= values
        if "event" in item and item["event"]["event"] == "bus_process":
            self.process_silent = item["event"]["silent"]
        if "lost" in item:
            self.process_silent = False
        if "end" in item:
            self.ended = True

    def may_be_good(self, node: Node, now: float) -> bool:
        """Necessary for a good value, by the rules alone."""
        if self.plant is None or self.ended or self.process_silent or self.plant["baud"] is None:
            return False
        if not 0 <= now - self.last_snapshot <= SILENT_S or self.bus.get("stale") or self.bus.get("mode") == "offline":
            return False
        if node.source is Source.MASTER:
            return True
        assert node.slave is not None
        slave = self.slaves.get(node.slave, {})
        age = slave.get("inputs_age_ms")
        exchanging = slave.get("state") == "data_exchange" and slave.get("inputs_valid") is True
        if not exchanging or age is None or age > slave.get("inputs_limit_ms", 1e9):
            return False
        return node.source is not Source.DRIVE or (slave.get("drive") or {}).get("state") not in (None, "offline")


_values = st.fixed_dictionaries(
    {},
    optional={
        "state": st.sampled_from(["data_exchange", "data_exchange", "offline", "fault"]),
        "inputs_valid": st.sampled_from([True, True, False]),
        "inputs_age_ms": st.sampled_from([None, 0.5, 99.0, 101.0, 5000.0]),
        "inputs_limit_ms": st.just(100.0),
        "fields": st.fixed_dictionaries(
            {}, optional={"level": st.sampled_from([None, 1, 1.5, 40.0, "x", True, 1e300]), "lamp": st.booleans()}
        ),
        "drive": st.sampled_from([None, {"state": "offline"}, HOIST["drive"], {"state": "fault", "faults": ["F1"]}]),
        "fault": st.sampled_from([None, {"text": "slave 3: no answer"}]),
        "conspicuous": st.sampled_from(["", "slot 2: short circuit"]),
        "exchanges": st.integers(0, 3),
    },
)
#: all is well but for one thing
_nearly: st.SearchStrategy[dict[str, Any]] = st.sampled_from(
    [{}, {"inputs_valid": False}, {"inputs_age_ms": 101.0}, {"inputs_age_ms": None}]
)
_slave = _nearly.map(lambda one: VALVES | one) | _nearly.map(lambda one: HOIST | one) | _values
_snapshots = st.builds(
    lambda whole, bus, slaves: {"whole": whole, "bus": bus, "slaves": slaves},
    st.booleans(),
    st.sampled_from(
        [
            *({}, {"stale": False}, {"stale": False}, {"stale": True}, {"mode": "clear", "stale": False}),
            *({"mode": "offline", "stale": False}, {"mode": "operate"}),
        ]
    ),
    st.dictionaries(st.sampled_from(["3", "8", "8", "77", "999"]), _slave),
)
_events = st.sampled_from(
    [
        {"event": "bus_process", "silent": True},
        {"event": "bus_process", "silent": False},
        {"event": "alarm", "address": 8, "type": 1, "slot": 2, "specifier": "appears", "text": "a", "t": 1.0},
        {"event": "alarm", "address": 8, "type": 1, "slot": 2, "specifier": "disappears", "text": "a", "t": 2.0},
        {"event": "alarm", "address": 8, "type": 2, "slot": 2, "specifier": "none", "text": "p", "t": 2.0},
        {"event": "alarm", "address": 8, "type": [], "slot": {}, "specifier": 3, "text": "bad", "t": "x"},
        {"event": "alarm", "address": 77, "type": 1, "slot": 1},
    ]
)
_items = st.one_of(
    _snapshots.map(lambda body: {"snapshot": body}),
    _snapshots.map(lambda body: {"snapshot": body}),
    st.sampled_from([PLANT, PLANT, IDENT, LONELY, AGAIN, SEARCHING]).map(lambda plant: {"plant": plant}),
    _events.map(lambda event: {"event": event}),
    st.just({"lost": 3}),
    st.just({"end": {"text": "stopped"}}),
    st.sampled_from([{"snapshot": 1}, {"plant": {}}, {"snapshot": {}, "end": {}}, {"later": 1}, {"plant": []}]),
)
_whole = {"snapshot": {"whole": True, "bus": {"stale": False}, "slaves": {"3": HOIST, "8": VALVES}}}
_waits = st.sampled_from([0.0, 0.1, 0.1, 0.1, 0.1, 1.0, 2.5])
#: every second stream begins with a plant that is well
_begin = st.sampled_from([[], [(0.0, {"plant": PLANT}), (0.1, _whole)]])
_well = st.just({"plant": PLANT}) | st.just(_whole)
_steps = st.builds(
    list.__add__, _begin, st.lists(st.tuples(_waits, st.none() | _items | _well), min_size=15, max_size=40)
)


class Subscriber:
    """Somebody who sees nothing but the changes."""

    def __init__(self) -> None:
        self.readings: dict[str, Reading] = {}
        self.alive: set[int | None] = set()
        self.conditions: dict[str, Condition] = {}

    def see(self, changes: list[Change], tree: PlantTree) -> None:
        for change in changes:
            match change:
                case NodesChanged():
                    known = {node.id for node in tree.nodes}
                    self.readings = {id_: found for id_, found in self.readings.items() if id_ in known}
                case Changed(node=node, reading=found):
                    self.readings[node.id] = found
                case Born(slave=slave):
                    assert slave not in self.alive
                    self.alive.add(slave)
                case Died(slave=slave):
                    self.alive.remove(slave)
                case Condition(id=id_):
                    known_one = self.conditions.get(id_)
                    assert known_one is None or change.count == known_one.count + 1 or change.count == 1
                    self.conditions[id_] = change
                    if not change.retain:
                        del self.conditions[id_]
                case Remark(text=text):
                    assert text.isprintable()


@examples(150)
@given(_steps)
def test_no_value_is_good_where_the_rules_say_otherwise(steps: list[tuple[float, dict[str, Any] | None]]) -> None:
    tree, judge, subscriber, now = PlantTree(), Judge(), Subscriber(), 0.0
    for wait, given_item in steps:
        now += wait
        item = copy.deepcopy(given_item)
        if item is None:
            changes = tree.tick(now)
        else:
            if isinstance(item.get("snapshot"), dict) and "whole" in item["snapshot"]:
                item["snapshot"]["t"] = now
            changes = tree.apply(item, now)
            if all(isinstance(body, dict | int) and body not in ({}, 1) for body in item.values()):
                judge.see(item, now)
        subscriber.see(changes, tree)
        for slave in (None, *tree.slaves):
            assert tree.is_alive(slave) == (slave in subscriber.alive)
            for node, found in tree.readings(slave):
                assert found.quality is not Quality.GOOD or judge.may_be_good(node, now), (node, found)
                assert (found.value is None) == (found.quality is Quality.BAD), (node, found)
                assert found.quality is Quality.GOOD or found.reason is not Reason.GOOD
                seen = subscriber.readings.get(node.id, Reading())
                assert (seen.reason, seen.note) == (found.reason, found.note)
                if node.kind is not Kind.STATISTIC and not node.dead_band:
                    assert seen.value == found.value
        assert {one.id: one for one in tree.conditions} == subscriber.conditions
        assert all(slave is None or slave in tree.slaves for slave in subscriber.alive)


@given(_steps)
def test_a_stream_that_is_well_again_is_good_again(steps: list[tuple[float, dict[str, Any] | None]]) -> None:
    """The opposite: the tree does not hold back what is good."""
    tree, now = PlantTree(), 0.0
    for wait, item in steps:
        now += wait
        if item is not None and not (isinstance(item.get("snapshot"), dict) and "whole" in item["snapshot"]):
            tree.apply(item, now)
        elif item is not None:
            tree.apply({"snapshot": {**item["snapshot"], "t": now}}, now)
    tree.apply({"plant": PLANT}, now)
    tree.apply(snapshot(now, {"3": HOIST, "8": VALVES}, whole=True), now)
    assert all(tree.is_alive(slave) for slave in (None, 3, 8))
    level = reading(tree, "slave/8/input/level")
    assert level[:2] == (12.5, Reason.GOOD)
    assert level.time == pytest.approx(1_700_000_000 + now - 0.0015)
    assert reading(tree, "slave/3/drive/speed").quality is Quality.GOOD


# --- rules one by one ---------------------------------------------------------------------------------------------


def test_births_come_when_the_values_are_there() -> None:
    tree = PlantTree()
    changes = up(tree)
    births = [change for change in changes if isinstance(change, Born)]
    assert births == [Born(None), Born(3), Born(8)]
    told = {
        change.node.id: change.reading for change in changes[: changes.index(Born(8))] if isinstance(change, Changed)
    }
    assert told["slave/8/input/level"] == Reading(12.5, Reason.GOOD, 1_700_000_001 - 0.0015)
    level = next(node for node in tree.nodes if node.id == "slave/8/input/level")
    assert (level.unit, level.scale, level.type, level.dead_band) == ("bar", 0.5, "f64", 1.0)
    assert (level.low, level.high) == (-16384, 16383.5)


def test_silence_of_the_stream_is_the_death_of_all_and_no_value_looks_fresh(tree: PlantTree) -> None:
    assert tree.tick(SILENT_S) == []
    changes = tree.tick(SILENT_S + 0.01)
    died = [change.slave for change in changes if isinstance(change, Died)]
    assert died == [3, 8, None]
    level = reading(tree, "slave/8/input/level")
    assert level == Reading(12.5, Reason.STREAM_SILENT, 1_700_000_001 - 0.0015)
    assert (level.quality, level.opcua_status) == (Quality.STALE, 0x408F_0000)
    assert [one.id for one in tree.conditions] == ["bus/dead"]
    back = tree.apply(snapshot(4.0, {"3": HOIST, "8": VALVES}), 3.0)
    assert {Born(None), Born(3), Born(8)} <= {one for one in back if isinstance(one, Born)}
    dead = tree.conditions.get("bus/dead")
    assert dead is not None
    assert not dead.active
    assert dead.retain


@pytest.mark.parametrize(
    ("values", "reason", "dies"),
    [
        ({"state": "fault", "fault": {"text": "slave 8: no answer"}}, Reason.NOT_EXCHANGING, True),
        ({"inputs_valid": False}, Reason.NOT_VALID, False),
        ({"inputs_age_ms": 100.5}, Reason.TOO_OLD, False),
        ({"inputs_age_ms": None}, Reason.NOT_VALID, False),
        # another program says that the inputs are valid for ever: the watchdog counts
        ({"inputs_age_ms": 250.0, "inputs_limit_ms": None, "watchdog_ms": 200}, Reason.TOO_OLD, False),
        ({"inputs_age_ms": 1001.0, "inputs_limit_ms": None, "watchdog_ms": 0}, Reason.TOO_OLD, False),
    ],
)
def test_reasons_of_a_slave(tree: PlantTree, values: dict[str, Any], reason: Reason, dies: bool) -> None:
    changes = tree.apply(snapshot(2.0, {"8": values}), 1.0)
    assert reading(tree, "slave/8/input/level")[:2] == (12.5, reason)
    assert reading(tree, "slave/8/output/lamp").reason is reason
    assert reading(tree, "slave/8/state").quality is Quality.GOOD  # the master knows that
    assert [change.slave for change in changes if isinstance(change, Died)] == ([8] if dies else [])
    assert reading(tree, "slave/3/drive/speed").quality is Quality.GOOD


def test_a_bus_that_is_not_open_yet_is_not_born() -> None:
    tree = PlantTree()
    tree.apply({"plant": PLANT}, 0.0)
    changes = tree.apply(snapshot(0.1, {"8": VALVES}, whole=True, bus={"stale": False, "mode": "offline"}), 0.1)
    assert not [one for one in changes if isinstance(one, Born)]
    assert reading(tree, "bus/mode").reason is Reason.BUS_STALE
    changes = tree.apply(snapshot(0.2, {"8": {}}, bus={"mode": "clear"}), 0.2)
    assert [one for one in changes if isinstance(one, Born)] == [Born(None), Born(8)]


def test_a_slave_that_the_stream_leaves_out_gets_stale(tree: PlantTree) -> None:
    for step in range(1, 30):
        tree.apply(snapshot(1 + step / 10, {"3": HOIST}), step / 10)
    assert reading(tree, "slave/8/input/level").reason is Reason.NOT_SENT
    assert not tree.is_alive(8)
    assert tree.is_alive(3)


def test_items_that_have_waited_are_no_fresh_values(tree: PlantTree) -> None:
    """This program was stopped for a minute: what waits for it is a minute old, and comes all at once."""
    tree.apply(snapshot(1.5, {"3": HOIST, "8": VALVES}), 60.0)
    assert reading(tree, "slave/8/input/level").reason is Reason.STREAM_LATE
    tree.apply(snapshot(61.0, {"3": HOIST, "8": VALVES}), 60.0)
    assert reading(tree, "slave/8/input/level").quality is Quality.GOOD


def test_old_items_that_come_together_with_a_fresh_one_kill_nobody(tree: PlantTree) -> None:
    waiting = [snapshot(1 + step / 10, {"3": HOIST, "8": VALVES | {"exchanges": step}}) for step in range(590)]
    alarm = {"event": "alarm", "address": 8, "type": 1, "slot": 2, "specifier": "appears", "text": "gone", "t": 1.2}
    changes = tree.apply_all([*waiting[:300], {"event": alarm}, *waiting[300:]], 59.0)
    assert not [one for one in changes if isinstance(one, (Born, Died))]
    assert [one.reading.value for one in changes if isinstance(one, Changed) and "exch" in one.node.id] == [589]
    assert [one.id for one in changes if isinstance(one, Condition)] == ["slave/8/alarm/1/2"]


def test_the_parts_of_a_whole_snapshot_kill_no_slave(tree: PlantTree) -> None:
    changes = tree.apply({"plant": IDENT}, 0.5) + tree.apply(snapshot(1.5, {}, whole=True), 0.5)
    changes += tree.apply(snapshot(1.5, {"3": HOIST}), 0.5)
    before = reading(tree, "slave/8/input/level")
    assert before.quality is Quality.GOOD
    assert before.time < 1_700_000_001
    changes += tree.apply(snapshot(1.6, {"8": VALVES}), 0.6)
    # the ident number of slave 3 is new: its birth says it
    assert [change for change in changes if isinstance(change, (Born, Died))] == [
        Died(3, "its configuration has changed"),
        Born(3),
    ]


def test_a_change_within_the_dead_band_is_no_news(tree: PlantTree) -> None:
    told = []
    for step, level in enumerate([13.5, 13.6, 14.5, 14.7, 12.5], 1):
        item = snapshot(1 + step / 10, {"3": HOIST, "8": VALVES | {"fields": {"level": level, "limit": True}}})
        told += [one.reading.value for one in tree.apply(item, step / 10) if isinstance(one, Changed) and one.node.unit]
    assert told == [13.6, 14.7, 12.5]


def test_statistics_are_told_now_and_then_and_the_last_count_too() -> None:
    tree = PlantTree(statistics_s=STATISTICS_S)
    up(tree)
    told: list[tuple[int, object]] = []
    for step in range(1, 250):
        valves = {"exchanges": 5 + step} if step < 50 else {"inputs_age_ms": 1.5 + step % 2}
        changes = tree.apply(snapshot(1 + step / 10, {"3": HOIST, "8": valves}), step / 10)
        told += [(step, one.reading.value) for one in changes if isinstance(one, Changed) and "exch" in one.node.id]
    assert told == [(100, 54)]  # since the last 50 steps nothing has been counted


def test_another_run_of_the_bus_begins_with_nothing(tree: PlantTree) -> None:
    changes = tree.apply({"plant": AGAIN}, 1.0)
    assert [change.slave for change in changes if isinstance(change, Died)] == [3, 8, None]
    # the nodes have the same names as before: nobody must go on showing their old values
    assert {one.node.id: one.reading.value for one in changes if isinstance(one, Changed)} == dict.fromkeys(
        node.id for node in tree.nodes
    )
    assert reading(tree, "slave/8/input/level") == Reading()
    assert reading(tree, "slave/8/input/level").opcua_status == 0x8032_0000  # BadWaitingForInitialData


# --- conditions ---------------------------------------------------------------------------------------------------


def test_conditions_of_a_slave(tree: PlantTree) -> None:
    faulty = {"drive": {"state": "fault", "faults": ["F0001"], "warnings": []}, "conspicuous": "slot 2: wire break"}
    alarm = {"event": "alarm", "address": 8, "type": 1, "slot": 2, "specifier": "appears", "text": "gone", "t": 1.2}
    tree.apply(snapshot(1.1, {"3": HOIST | faulty}), 0.1)
    tree.apply({"event": alarm}, 0.2)
    shown = {one.id: (one.text, one.active, one.acked) for one in tree.conditions}
    assert shown == {
        "slave/3/diagnosis": ("slot 2: wire break", True, False),
        "slave/3/drive/faults/F0001": ("F0001", True, False),
        "slave/8/alarm/1/2": ("gone", True, False),
    }
    assert isinstance(tree.acknowledge("slave/8/alarm/1/2", "anna")[0], Condition)
    assert tree.acknowledge("slave/8/alarm/1/2") == tree.acknowledge("nothing") == []
    [ended] = [
        one for one in tree.apply({"event": alarm | {"specifier": "disappears"}}, 0.3) if isinstance(one, Condition)
    ]
    assert (ended.active, ended.acked, ended.retain, ended.said_by) == (False, True, False, "anna")
    # the drive is well again before somebody has acknowledged: retained
    tree.apply(snapshot(1.3, {"3": HOIST | {"conspicuous": ""}}), 0.3)
    assert {one.id: (one.active, one.retain) for one in tree.conditions} == {
        "slave/3/diagnosis": (False, True),
        "slave/3/drive/faults/F0001": (False, True),
    }
    # and again: the same id, not acknowledged
    [again] = [one for one in tree.apply(snapshot(1.4, {"3": HOIST | faulty}), 0.4) if isinstance(one, Condition)][1:]
    assert (again.id, again.count, again.active) == ("slave/3/drive/faults/F0001", 3, True)


def test_a_lost_slave_is_a_condition_but_a_bus_that_starts_is_none() -> None:
    tree = PlantTree()
    tree.apply({"plant": PLANT}, 0.0)
    tree.apply(snapshot(0.1, {"8": {"state": "set_prm"}, "3": {"state": "offline"}}, whole=True), 0.0)
    assert len(tree.conditions) == 0
    up(tree)
    tree.apply(snapshot(1.1, {"8": {"state": "offline", "fault": {"text": "slave 8: no answer"}}}), 0.1)
    assert [(one.id, one.text, one.active) for one in tree.conditions] == [
        ("slave/8/fault", "slave 8: no answer", True)
    ]


def test_a_slave_that_never_repeats_itself_fills_no_memory(tree: PlantTree) -> None:
    changes: list[Change] = []
    for number in range(500):
        faults = [f"F{number}-{place}" for place in range(50)]
        values = {"3": HOIST | {"drive": {"state": "fault", "faults": faults}}, "8": VALVES, str(200 + number): {}}
        changes += tree.apply(snapshot(1 + number / 100, values), number / 100)
        changes += tree.apply({"snapshot": number}, number / 100)
    assert len(tree.conditions.of(3)) <= MOST_OF_A_SLAVE
    assert tree.conditions.left_out > 0
    assert 2 <= sum(isinstance(change, Remark) for change in changes) <= 100


def test_a_plant_that_is_too_large_is_cut_and_told() -> None:
    many = [{"name": f"f{number}", "type": "u8", "at": f"u8@{number}"} for number in range(9000)]
    slaves = {str(address): {"name": "x" * 500, "inputs": many} for address in range(0, 127, 18)} | {"500": {}}
    tree = PlantTree()
    remarks = [one.text for one in tree.apply({"plant": PLANT | {"slaves": slaves}}, 0.0) if isinstance(one, Remark)]
    assert len(list(tree.nodes)) < 60_000
    assert any("named values cannot be shown" in text for text in remarks)
    assert any("addresses above 126" in text for text in remarks)


# --- orders -------------------------------------------------------------------------------------------------------


def test_orders(tree: PlantTree) -> None:
    assert set(tree.orders) == {
        *(f"hoist.{word}" for word in ("start", "stop", "quick_stop", "coast", "acknowledge", "speed")),
        "valves.lamp",
        "valves.speed",
    }
    assert tree.orders["valves.lamp"].typed(True) == SetOutputs(8, {"lamp": True})
    assert tree.orders["hoist.speed"].typed(0.5) == DriveOrder(3, "speed", 0.5)
    assert tree.orders["hoist.stop"].typed() == DriveOrder(3, "stop")
    assert (tree.orders["valves.lamp"].argument(True), tree.orders["hoist.stop"].argument(True)) == (True, None)
    for wrong in ("on", 1, None, 0.0):
        with pytest.raises(ValueError, match=r"valves\.lamp takes bool"):
            tree.orders["valves.lamp"].argument(wrong)


def test_a_run_that_only_reads_takes_no_orders() -> None:
    tree = PlantTree()
    tree.apply({"plant": PLANT | {"read_only": True}}, 0.0)
    assert tree.orders == {}
    assert all(node.order is None for node in tree.nodes)


def test_an_order_that_could_mean_two_drives_is_none() -> None:
    tree = PlantTree()
    slaves = {"3": PLANT["slaves"]["3"], "4": PLANT["slaves"]["3"]}
    changes = tree.apply({"plant": PLANT | {"slaves": slaves}}, 0.0)
    assert tree.orders == {}
    assert Remark("2 orders are called hoist.start: none of them can be given") in changes


def test_a_number_that_its_octets_cannot_hold_is_none() -> None:
    """The encoder of a connector would raise."""
    (most,) = struct.unpack(">f", bytes.fromhex("7f7fffff"))
    for sign in (1, -1):
        assert value_of(sign * most, "f32") == sign * most
        assert value_of(sign * most * 1.0001, "f32") is None
        assert value_of(sign * 1e308, "f64") == sign * 1e308
        for type_ in ("f32", "f64"):
            assert (
                value_of(sign * float("inf"), type_)
                is value_of(10**400, type_)
                is value_of(float("nan"), type_)
                is None
            )


def test_nodes_stay_where_another_run_has_the_same_slaves(tree: PlantTree) -> None:
    """A bus has a plant before it is open, too, with another time of its start: what was made of the nodes stays."""
    before = tree.slaves
    found = tree.apply({"plant": copy.deepcopy(AGAIN)}, 1.0)
    assert [one for one in found if isinstance(one, NodesChanged)] == []
    assert [one.slave for one in found if isinstance(one, Died)] == [3, 8, None]
    assert all(tree.slaves[address] is before[address] for address in (3, 8))
    other = copy.deepcopy(AGAIN)
    other["slaves"]["8"]["inputs"][0]["unit"] = "mbar"
    assert NodesChanged() in tree.apply({"plant": other}, 1.1)
    # orders depend on the right to give them
    assert tree.orders
    assert NodesChanged() in tree.apply({"plant": other | {"started": 1.0, "read_only": True}}, 1.2)
    assert not tree.orders
