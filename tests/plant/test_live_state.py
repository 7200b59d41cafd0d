"""Items of the live stream: a late reader gets to the same picture as one that reads each item."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import convert
from property_kit import examples

from dpstack.plant.items import (
    BusValues,
    DiagnosisValues,
    FaultValues,
    SlaveValues,
    changes_of,
    check_item,
    merged,
)
from dpstack.plant.pending import SLAVES_A_PORTION, Pending, portions
from dpstack.plant.state import LiveState, end_of
from dpstack.text import json_text

values = st.dictionaries(st.sampled_from(["exchanges", "telegrams", "retries", "late"]), st.integers(0, 3), max_size=4)
slaves = st.dictionaries(st.sampled_from(["3", "4", "8"]), values, max_size=3)


@st.composite
def items(draw: st.DrawFn) -> list[dict[str, Any]]:
    """A stream as a bus gives it: a plant with a whole snapshot, then changes and events, now and then a new plant."""
    found: list[dict[str, Any]] = []
    for t in range(draw(st.integers(1, 30))):
        kind = draw(st.sampled_from(["plant", "snapshot", "snapshot", "event"])) if found else "plant"
        if kind == "plant":
            found.append({"plant": {"slaves": {}, "address": t}})
        if kind == "event":
            found.append({"event": {"event": "notice", "t": t}})
        else:
            snapshot = {"t": t, "whole": kind == "plant", "bus": draw(values), "slaves": draw(slaves)}
            found.append({"snapshot": snapshot})
    return found


def picture(state: LiveState) -> object:
    return state.plant, state.t, state.bus, state.slaves, list(state.events), state.lost, state.end


@given(items(), st.lists(st.booleans(), min_size=70, max_size=70))
def test_a_late_reader_gets_the_same_picture(stream: list[dict[str, Any]], reads: list[bool]) -> None:
    each, late, pending = LiveState(), LiveState(), Pending()
    for item, read in zip([*stream, {"end": {"text": "over"}}], reads, strict=False):
        each.apply(item)
        pending.put(item)
        while read and (found := pending.take()) is not None:
            late.apply(found)
    while (found := pending.take()) is not None:
        late.apply(found)
    assert picture(late) == picture(each)
    assert not pending.waiting


@given(items())
def test_the_picture_is_handed_on_as_items(stream: list[dict[str, Any]]) -> None:
    first, second = LiveState(), LiveState()
    for item in stream:
        first.apply(item)
    for item in first.whole():
        for portion in portions(item):
            second.apply(portion)
    assert picture(second) == picture(first)


def test_events_beyond_the_depth_are_counted_and_the_end_comes_last() -> None:
    pending = Pending(depth=3)
    pending.put({"plant": {"slaves": {}}})
    pending.put({"end": {"text": "over"}})
    for number in range(5):
        pending.put({"event": {"t": number}})
    pending.put({"snapshot": {"t": 1, "whole": True, "bus": {}, "slaves": {}}})
    taken = []
    while (item := pending.take(snapshots=False)) is not None:
        taken.append(item)
    assert [next(iter(item)) for item in taken] == ["plant", "lost", "event", "event", "event", "snapshot", "end"]
    assert taken[1] == {"lost": 2}
    assert [item["event"]["t"] for item in taken[2:5]] == [2, 3, 4]


def test_an_item_of_a_newer_version_is_left_out_and_takes_no_end_away() -> None:
    pending, state = Pending(), LiveState()
    stream: list[dict[str, Any]] = [{"plant": {"slaves": {}}}, {"end": {"text": "over"}}, {"news": 1}, {}]
    for item in stream:
        state.apply(item)
        pending.put(item)
    assert state.end == "over"
    assert [pending.take(), pending.take(), pending.take()] == [
        {"plant": {"slaves": {}}},
        {"end": {"text": "over"}},
        None,
    ]


def test_a_snapshot_of_many_slaves_comes_in_portions() -> None:
    many = {str(address): {"state": "data_exchange"} for address in range(125)}
    found = list(portions({"snapshot": {"t": 1.0, "whole": True, "bus": {"mode": "operate"}, "slaves": many}}))
    assert len(found) == -(-125 // SLAVES_A_PORTION)
    assert [item["snapshot"]["whole"] for item in found] == [True, *[False] * (len(found) - 1)]
    state = LiveState()
    state.apply({"plant": {"slaves": {}}})
    for item in found:
        state.apply(item)
    assert state.slaves == {address: SlaveValues(state="data_exchange") for address in many}
    assert state.bus == BusValues(mode="operate")


def large_plant() -> list[dict[str, Any]]:
    """Plant and whole snapshot of 123 slaves with 224 named values each, as ``bus.live()`` makes them."""

    def field(name: str, number: int) -> dict[str, Any]:
        rest = dict.fromkeys(("scale", "offset", "unit", "dead_band"))
        return {"name": f"{name}{number}", "type": "u16", "at": f"u16@{2 * number}", **rest}

    values = {f"{name}{number}": 40_000 + number for name in ("speed", "wish") for number in range(112)}
    addresses = [str(address) for address in range(3, 126)]
    slave = {"inputs": [field("speed", n) for n in range(112)], "outputs": [field("wish", n) for n in range(112)]}
    now = {"state": "data_exchange", "inputs": "9c40" * 112, "outputs": "9c40" * 112, "fields": values}
    return [
        {"plant": {"port": "COM1", "slaves": {address: {"name": f"s{address}", **slave} for address in addresses}}},
        {"snapshot": {"t": 1.0, "whole": True, "bus": {"mode": "operate"}, "slaves": dict.fromkeys(addresses, now)}},
    ]


def test_the_welcome_of_a_large_plant_comes_in_parts_of_bounded_length() -> None:
    """The plant was one message of 2.5 million octets, of which a page had nothing until it had all."""
    plant, whole = large_plant()
    state = LiveState()
    state.apply(plant)
    state.apply(whole)
    parts = [part for item in state.whole() for part in portions(item)]
    assert max(len(json_text(part).encode()) for part in parts) < 66_000
    plants = [part["plant"] for part in parts if "plant" in part]
    assert [part.get("whole") for part in plants] == [None, *[False] * (len(plants) - 1)]
    assert [part.get("more") for part in plants] == [*[True] * (len(plants) - 1), None]
    assert [len(part["slaves"]) for part in plants] == [2] * 61 + [1]
    late = LiveState()
    for part in parts:
        late.apply(part)
    assert (late.plant, late.slaves, late.bus) == (state.plant, state.slaves, BusValues(mode="operate"))


@given(st.lists(st.booleans(), min_size=70, max_size=70))
@examples(5)
def test_a_reader_that_comes_late_in_the_middle_of_a_plant_gets_it_whole(reads: list[bool]) -> None:
    """Parts are merged while they wait, and divided again: the last one alone ends the plant."""
    plant, whole = large_plant()
    pending, late, more = Pending(), LiveState(), list[object]()

    def read() -> None:
        while (found := pending.take()) is not None:
            for part in portions(found):
                late.apply(part)
                more.extend([part["plant"].get("more")] if "plant" in part else [])

    for part, is_read in zip(portions(plant), reads, strict=False):
        pending.put(part)
        if is_read:
            read()
    pending.put(whole)
    read()
    whole_plant, snapshot = check_item(plant).plant, check_item(whole).snapshot
    assert snapshot is not None
    assert (late.plant, late.slaves) == (whole_plant, snapshot.slaves)
    assert more == [*[True] * (len(more) - 1), None]


@pytest.mark.parametrize(
    "item",
    [
        {"plant": {}},
        {"plant": {"slaves": {}, "whole": 0}},
        {"plant": []},
        {"plant": {"slaves": []}},
        {"snapshot": {}},
        {"snapshot": {"t": "now", "whole": False, "bus": {}, "slaves": {}}},
        {"snapshot": {"t": 1, "whole": False, "bus": {}, "slaves": {"3": 4}}},
        {"snapshot": {"t": 1, "whole": False, "bus": {}, "slaves": []}},
        {"event": 4},
        {"lost": None},
        {"end": "over"},
    ],
)
def test_something_else_is_refused(item: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="this is no item of the stream"):
        LiveState().apply(item)


def test_changes_are_plain_data_and_merge_to_the_later_values() -> None:
    """None is a change, too: what was there is there no more."""
    before = SlaveValues(state="data_exchange", retries=3, fault=FaultValues("lost"))
    now = SlaveValues(state="data_exchange", retries=4, diagnosis=DiagnosisValues(["ext_diag"], []))
    changes = changes_of(before, now)
    assert changes == {"retries": 4, "fault": None, "diagnosis": {"flags": ["ext_diag"], "texts": []}}
    assert merged(before, convert(changes, SlaveValues), changes) == now


@pytest.mark.parametrize(
    "item",
    [
        {"lost": float("inf")},
        {"lost": -1},
        {"snapshot": {"t": 1e300, "whole": False, "bus": {}, "slaves": {}}},
        {"snapshot": {"t": 1, "whole": False, "bus": {"bad": 3}, "slaves": {}}},
        {"snapshot": {"t": 1, "whole": False, "bus": {"histogram": [[1, float("nan")]]}, "slaves": {}}},
        {"snapshot": {"t": 1, "whole": False, "bus": {"clear": {"since": 1}}, "slaves": {}}},
        {"snapshot": {"t": 1, "whole": False, "bus": {}, "slaves": {"3": {"fault": "x"}}}},
        {"snapshot": {"t": 1, "whole": False, "bus": {}, "slaves": {"1000": {}}}},
        {"plant": {"slaves": {"3": {"inputs": [{"unit": "bar"}]}}}},
        {"event": {"text": "x", "address": {}}},
        {"end": {"text": "over"}, "event": {"text": "x"}},
    ],
)
def test_an_item_that_no_connector_could_show_is_refused_and_changes_nothing(item: dict[str, Any]) -> None:
    state = LiveState()
    state.apply({"plant": {"slaves": {}}})
    state.apply({"snapshot": {"t": 1, "whole": True, "bus": {"mode": "clear"}, "slaves": {"3": {"state": "offline"}}}})
    before = picture(state)
    with pytest.raises(ValueError, match="this is no item of the stream"):
        state.apply(item)
    assert picture(state) == before


def test_a_later_reader_learns_whether_a_fault_has_ended_the_bus() -> None:
    for failed in (False, True):
        state, later = LiveState(), LiveState()
        state.apply({"plant": {"slaves": {}}})
        state.apply(end_of("over", failed=failed))
        for item in state.whole():
            later.apply(item)
        assert (later.end, later.failed) == ("over", failed)
        later.apply({"plant": {"slaves": {}}})
        assert (later.end, later.failed) == (None, False)
