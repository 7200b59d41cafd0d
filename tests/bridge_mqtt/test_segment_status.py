"""The status of a segment: what it says, when it is due, its bounds, and its reader."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from edge_node_rig import Rig
from hypothesis import given
from hypothesis import strategies as st

from dpstack.bridge.mqtt.status import EXPIRY_S, MOST_LOST, MOST_OCTETS, StatusSource, content_of, read_status
from dpstack.bridge.tree import PlantTree

VERSIONS = {"dpstack": "0.1.0", "python": "3.11.2"}
PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "segment-status.md"


@pytest.fixture
def rig(tmp_path: Path) -> Any:
    made = Rig(tmp_path)
    made.give_plant()
    yield made
    made.close()


def test_it_is_due_at_the_begin_on_a_change_and_every_10_s(rig: Rig) -> None:
    source = StatusSource(rig.tree, VERSIONS)
    source.begin(7)
    times: list[tuple[float, str]] = []
    began = rig.clock
    for step in range(300):
        if step == 123:
            rig.values["8"]["state"] = "offline"
        if step == 126:
            rig.values["8"]["state"] = "data_exchange"
        rig.wait(0.1)
        source.changed()  # as the face does for each change of the tree
        payload = source.next(rig.clock, rig.wall)
        if payload is not None:
            status = read_status(payload)
            assert status.session == 7
            times.append((round(rig.clock - began, 1), status.verdict))
    assert times == [(0.1, "good"), (10.1, "good"), (12.4, "critical"), (13.4, "good"), (23.4, "good")]
    source.begin(8)
    assert source.due(rig.clock) <= rig.clock
    assert json.loads(source.last(rig.wall))["state"] == "ended"
    assert EXPIRY_S == 30


def test_verdicts(rig: Rig) -> None:
    assert content_of(PlantTree())["verdict"] == "unknown"
    good = {"state": "running", "verdict": "good", "reasons": [], "slaves": 2, "lost": [], "more_lost": 0}
    assert content_of(rig.tree) == good
    rig.values["3"]["drive"]["warnings"] = ["brake hot"]
    rig.wait(0.1)
    found = content_of(rig.tree)
    assert found["verdict"] == "warning"
    assert "slave 3" in found["reasons"][0]
    assert "brake hot" in found["reasons"][0]
    rig.values["8"]["state"] = "fault"
    rig.wait(0.1)
    found = content_of(rig.tree)
    assert found["verdict"] == "critical"
    assert found["lost"] == [{"address": 8, "name": "valves", "state": "fault"}]
    assert found["reasons"][0] == "1 of 2 slaves are not in data exchange"
    rig.values["8"]["state"] = "deactivated"
    rig.wait(0.1)
    assert content_of(rig.tree)["lost"] == []
    for _ in range(6):
        rig.wait(0.5, stream=False)
    found = content_of(rig.tree)
    assert found["verdict"] == "critical"
    assert found["lost"] == []
    rig.take(rig.tree.apply({"end": {"text": "the run has ended"}}, rig.clock))
    assert content_of(rig.tree)["state"] == "ended"


def test_the_example_of_the_page(rig: Rig) -> None:
    rig.values["8"]["state"] = "set_prm"
    rig.wait(0.1)
    source = StatusSource(rig.tree, VERSIONS)
    source.begin(3)
    payload = source.next(rig.clock, 1_700_000_000.25)
    assert payload is not None
    text = PAGE.read_text()
    shown = text.partition("```json\n")[2].partition("```")[0]
    assert json.loads(shown) == json.loads(payload)


def test_it_is_bounded(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    name = "\U0001f600\\" * 100
    rig.plant["slaves"] = {str(at): {"name": f"{at}{name}", "watchdog_ms": 0} for at in range(1, 127)}
    rig.values = {str(at): {"state": "wait_ready", "fault": {"kind": name, "text": name}} for at in range(1, 127)}
    rig.give_plant()
    payload = StatusSource(rig.tree, VERSIONS).next(rig.clock, rig.wall)
    assert payload is not None
    assert len(payload) <= MOST_OCTETS
    status = read_status(payload)
    assert (len(status.lost), status.lost_count) == (MOST_LOST, 126)
    rig.close()


def refused(payload: bytes) -> str:
    with pytest.raises(ValueError, match=r".") as error:
        read_status(payload)
    return str(error.value)


GOOD: dict[str, Any] = {
    "version": 1, "sent": 1.0, "session": 0, "versions": {}, "state": "running", "verdict": "good", "reasons": [],
    "slaves": 0, "lost": [], "more_lost": 0,
}  # fmt: skip


def test_wrong_payloads_are_refused_with_the_reason() -> None:
    assert read_status(json.dumps(GOOD | {"other": 1}).encode()).verdict == "good"
    assert "octets" in refused(b" " * 1_000_000)
    assert "no JSON" in refused(b"[" * MOST_OCTETS)
    assert "no JSON" in refused(b"\xff")
    assert "no JSON" in refused(b"9" * 5000)
    assert "no JSON object" in refused(b"[]")
    for key in GOOD.keys() - {"sent"}:
        for wrong in (None, [[1]], True, -1, 1e400, "\x1b"):
            if (key, wrong) not in (("version", True), ("reasons", [[1]])):
                refused(json.dumps(GOOD | {key: wrong}).encode())


def test_texts_are_printable() -> None:
    evil = "\x1b]0;x\x07\u202e" + "y" * 1000
    given_ = GOOD | {"lost": [{"address": 1, "name": evil, "state": evil}], "reasons": [evil], "versions": {evil: evil}}
    status = read_status(json.dumps(given_).encode())
    texts = [*status.reasons, status.lost[0].name, status.lost[0].state, *status.versions, *status.versions.values()]
    assert all(text.isprintable() and len(text) <= 120 for text in texts)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inside: st.lists(inside, max_size=3) | st.dictionaries(st.text(max_size=4), inside, max_size=3),
    max_leaves=6,
)


@given(st.dictionaries(st.sampled_from(sorted(GOOD)), JSON, max_size=4))
def test_any_json_gives_a_status_or_a_reason(changes: dict[str, Any]) -> None:
    try:
        status = read_status(json.dumps(GOOD | changes).encode())
    except ValueError:
        return
    assert 0 <= status.lost_count <= 127 + MOST_LOST + 127
