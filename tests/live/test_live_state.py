"""Items of the live stream: a late reader gets to the same picture as one that reads each item."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.live.pending import SLAVES_A_PORTION, Pending, portions
from dpstack.live.state import LiveState, difference, end_of

values = st.dictionaries(st.sampled_from(["exchanges", "telegrams", "retries", "late"]), st.integers(0, 3), max_size=4)
slaves = st.dictionaries(st.sampled_from(["3", "4", "8"]), values, max_size=3)


@st.composite
def items(draw: st.DrawFn) -> list[dict[str, Any]]:
    """A stream as a bus gives it: a plant with a whole snapshot, then changes and events, now and then a new plant."""
    found: list[dict[str, Any]] = []
    for t in range(draw(st.integers(1, 30))):
        kind = draw(st.sampled_from(["plant", "snapshot", "snapshot", "event"])) if found else "plant"
        if kind == "plant":
            found.append({"plant": {"slaves": {}, "number": t}})
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
    assert state.slaves == many
    assert state.bus == {"mode": "operate"}


@pytest.mark.parametrize(
    "item",
    [
        {"plant": {}},
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


def test_the_difference_has_new_and_changed_keys() -> None:
    assert difference({"a": 1, "b": 2}, {"a": 1, "b": 3, "c": None}) == {"b": 3, "c": None}


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
def test_an_item_that_no_face_could_show_is_refused_and_changes_nothing(item: dict[str, Any]) -> None:
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
