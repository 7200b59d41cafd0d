"""The status of a segment: what it says, when it is due, its bounds, and its reader."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from edge_node_rig import Rig
from hypothesis import given
from hypothesis import strategies as st

from dpstack.bridge.mqtt.status import (
    EXPIRY_S,
    MOST_LOST,
    MOST_OCTETS,
    MOST_REASONS,
    LostSlave,
    Status,
    StatusSource,
    content_of,
    read_status,
)
from dpstack.plant.state import end_of
from dpstack.plant.tree import Change, PlantTree
from dpstack.plant.verdicts import Judge

VERSIONS = {"dpstack": "0.1.0", "python": "3.11.2"}
PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "segment-status.md"


class Gateway(Rig):
    """A gateway of a bus that has run for a while, with the source of its status."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.source = StatusSource(self.tree, VERSIONS)
        self.values = {address: one | {"telegrams": 0} for address, one in self.values.items()}
        self.seen: list[tuple[float, Status]] = []

    def take(self, changes: list[Change]) -> None:
        super().take(changes)
        self.source.take(changes)

    def wait(self, seconds: float, *, stream: bool = True) -> None:
        for one in self.values.values():
            one["telegrams"] += round(400 * seconds) if one["state"] == "data_exchange" else 0
        super().wait(seconds, stream=stream)
        payload = self.source.next(self.clock, self.wall)
        if payload is not None:
            self.seen.append((round(self.clock - 1000, 1), read_status(payload)))

    def run(self, seconds: float) -> Status:
        """Time passes; returns the last status."""
        for _ in range(round(seconds / 0.2)):
            self.wait(0.2)
        return self.seen[-1][1]


@pytest.fixture
def rig(tmp_path: Path) -> Any:
    made = Gateway(tmp_path)
    made.give_plant()
    made.run(8)
    yield made
    made.close()


def test_it_is_due_at_the_begin_on_a_change_and_every_10_s(rig: Gateway) -> None:
    rig.source.begin(7)
    rig.seen.clear()
    for step in range(300):
        if step == 123:
            rig.values["8"]["state"] = "offline"
        if step == 126:
            rig.values["8"]["state"] = "data_exchange"
        rig.wait(0.1)
    assert {one.session for _, one in rig.seen} == {7}
    assert [at - 8 for at, _ in rig.seen] == pytest.approx([0.1, 10.1, 12.4, 13.4, 23.4], abs=0.15)
    # the verdict remembers the loss, the number of lost slaves is that of the moment
    found = [(one.verdict, one.lost_count) for _, one in rig.seen]
    assert found == [("good", 0), ("good", 0), ("warning", 1), ("warning", 0), ("warning", 0)]
    rig.source.begin(8)
    assert rig.source.due(rig.clock) <= rig.clock
    assert json.loads(rig.source.last(rig.wall))["state"] == "ended"
    assert EXPIRY_S == 30


def test_verdicts(rig: Gateway) -> None:
    tree = PlantTree()
    assert content_of(tree, Judge(tree))["verdict"] == "unknown"
    assert {one.verdict for _, one in rig.seen} == {"unknown", "good"}
    rig.values["3"]["drive"]["warnings"] = ["brake hot"]
    status = rig.run(1)
    assert (status.verdict, status.lost) == ("warning", ())
    assert status.reasons == ("slave 3 (hoist): hoist: drive warning: brake hot",)
    rig.values["8"]["state"] = "fault"
    status = rig.run(1)
    assert status.lost == (LostSlave(8, "valves", "fault"),)
    assert "slave 8 (valves): it left data exchange once" in status.reasons
    status = rig.run(12)
    assert status.verdict == "critical"
    assert status.reasons[0] == "slave 8 (valves): it is not in data exchange: fault"
    rig.values["8"]["state"] = "deactivated"
    assert rig.run(1.2).lost == ()
    for _ in range(6):
        rig.wait(0.5, stream=False)
    status = rig.seen[-1][1]
    assert (status.state, status.verdict, status.lost) == ("running", "critical", ())


def test_slaves_that_are_back_are_not_lost_and_the_verdict_remembers_them(rig: Gateway) -> None:
    for _ in range(3):
        rig.values["8"]["state"] = "offline"
        assert rig.run(1.2).lost_count == 1
        rig.values["8"]["state"] = "data_exchange"
        assert rig.run(1.2).lost_count == 0
    status = rig.seen[-1][1]
    assert (status.verdict, status.reasons) == ("critical", ("slave 8 (valves): it left data exchange 3 times",))


def test_slaves_that_begin_are_lost_after_10_s(tmp_path: Path) -> None:
    rig = Gateway(tmp_path)
    rig.values["8"]["state"] = "wait_ready"
    rig.give_plant()
    rig.run(9.8)
    assert {(one.verdict, one.lost_count) for _, one in rig.seen} <= {("unknown", 0), ("good", 0)}
    status = rig.run(1.4)
    assert (status.verdict, status.lost) == ("critical", (LostSlave(8, "valves", "wait_ready"),))
    rig.close()


@pytest.mark.parametrize(("failed", "state", "verdict"), [(False, "ended", "unknown"), (True, "failed", "critical")])
def test_an_end_in_order_and_one_by_a_fault(rig: Gateway, failed: bool, state: str, verdict: str) -> None:
    rig.take(rig.tree.apply(end_of("over", failed=failed), rig.clock))
    rig.wait(1, stream=False)
    for status in (rig.seen[-1][1], read_status(rig.source.last(rig.wall))):
        assert (status.state, status.verdict, status.lost) == (state, verdict, ())
        assert "over" in status.reasons[0]


def test_the_example_of_the_page(rig: Gateway) -> None:
    rig.values["8"]["state"] = "set_prm"
    rig.run(11)
    rig.source.begin(3)
    payload = rig.source.next(rig.clock, 1_700_000_000.25)
    assert payload is not None
    text = PAGE.read_text()
    shown = text.partition("```json\n")[2].partition("```")[0]
    assert json.loads(shown) == json.loads(payload)


def test_it_is_bounded(tmp_path: Path) -> None:
    rig = Gateway(tmp_path)
    name = "\U0001f600\\" * 100
    rig.plant["slaves"] = {str(at): {"name": f"{at}{name}", "watchdog_ms": 0} for at in range(1, 127)}
    fault = {"state": "wait_ready", "fault": {"kind": name, "text": name}, "telegrams": 0}
    rig.values = {str(at): dict(fault) for at in range(1, 127)}
    rig.give_plant()
    rig.clock += 11
    rig.stream += 11
    rig.give_values()
    payload = rig.source.next(rig.clock, rig.wall)
    assert payload is not None
    assert len(payload) <= MOST_OCTETS
    status = read_status(payload)
    assert (len(status.lost), status.lost_count) == (MOST_LOST, 126)
    assert len(status.reasons) == MOST_REASONS
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
    assert "nested too deeply" in refused(b"[" * MOST_OCTETS)
    assert "not UTF-8" in refused(b"\xff")
    assert "a number of the payload is too great" in refused(b"9" * 5000)
    assert "stands twice" in refused(b'{"verdict": "good", "verdict": "critical"}')
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
