"""History of an edge node, case by case; tests/bridge_mqtt/test_machines.py has the course of any of them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from history_rig import HistoryRig
from sparkplug_host import Metric

from dpstack.bridge.mqtt.history import MOST_METRICS, PACE_S


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[HistoryRig]:
    made = HistoryRig(tmp_path)
    made.give_plant()
    made.connect()
    made.pump()
    made.round_trip()
    yield made
    made.close()


def history(rig: HistoryRig, device: str | None = "valves") -> list[Metric]:
    return [
        one for kind, at, payload in rig.host.messages for one in payload.metrics if one.historical and at == device
    ]


def outage(rig: HistoryRig, times: int) -> None:
    rig.cut()
    for _ in range(times):
        rig.count()
    rig.step_disk()
    rig.publish_wills()
    rig.host.messages.clear()


def test_births_come_first_then_history_by_the_aliases_of_these_births(rig: HistoryRig) -> None:
    outage(rig, 5)
    rig.settle()
    kinds = [(kind, any(one.historical for one in payload.metrics)) for kind, _, payload in rig.host.messages]
    assert kinds[:3] == [("NBIRTH", False), ("DBIRTH", False), ("DBIRTH", False)]
    assert [kind for kind, old in kinds if old] == ["NDATA", "DDATA"]
    alias = rig.host.alias("Inputs/number", "valves")
    found = [(one.value(8), (one.timestamp or 0) / 1000) for one in history(rig) if one.alias == alias]
    assert [number for number, _ in found] == [1, 2, 3, 4, 5]
    steps = [later[1] - earlier[1] for earlier, later in pairwise(found)]
    assert steps == pytest.approx([0.25] * 4, abs=0.002)
    rig.check_numbers()
    assert rig.history is not None
    assert rig.history.dropped == 0


def test_a_host_that_asks_for_births_without_end_holds_no_history_back(rig: HistoryRig) -> None:
    outage(rig, 5)
    rig.connect()
    for _ in range(200):
        rig.rebirth()  # again before each message, the births too
        rig.pump(1)
        rig.step_disk()
        rig.round_trip()
        rig.wait(0.02)
    alias = rig.host.alias("Inputs/number", "valves")
    assert [one.value(8) for one in history(rig) if one.alias == alias] == [1, 2, 3, 4, 5]


def test_a_value_that_waited_when_the_connection_was_cut_comes_in_the_birth_alone(rig: HistoryRig) -> None:
    rig.count()
    rig.pump()  # sent, and not confirmed
    rig.count()  # not sent
    rig.cut()
    rig.publish_wills()
    rig.host.messages.clear()
    rig.settle()
    alias = rig.host.alias("Inputs/number", "valves")
    assert [one.value(8) for one in history(rig) if one.alias == alias] == [1]


def test_the_gap_of_a_slave_that_was_lost_meanwhile_is_there_when_it_is_back(rig: HistoryRig) -> None:
    outage(rig, 1)
    rig.values["8"]["state"] = "offline"
    rig.count()
    rig.connect()
    for _ in range(6):
        rig.pump()
        rig.round_trip()
        rig.step_disk()
        rig.clock += 0.1
    assert rig.host.alive == {"hoist"}
    assert history(rig) == []  # no data of a device that has had no birth
    rig.values["8"]["state"] = "data_exchange"
    rig.settle()
    alias = rig.host.alias("Inputs/number", "valves")
    found = [one for one in history(rig) if one.alias == alias]
    assert [(one.value(8), one.properties.get("Quality")) for one in found][:2] == [(1, 192), (1, 500)]
    assert found[1].properties["Quality reason"].startswith("the slave is not in data exchange")


def test_the_history_of_a_broken_wire_has_its_numbers_beside_their_quality_and_reason(rig: HistoryRig) -> None:
    outage(rig, 1)
    broken = {"quality": "bad", "reason": "channel_fault", "text": "line break: slot 3, input channel 0"}
    limit = {"quality": "uncertain", "reason": "channel_limit", "text": "upper limit value exceeded: slot 3"}
    remark = {"quality": "good", "reason": "status_good", "text": "maintenance required (status A4)"}
    for quality in (broken, broken, limit, remark, None):
        rig.values["8"]["qualities"] = None if quality is None else {"number": quality}
        rig.count()
    rig.settle()
    alias = rig.host.alias("Inputs/number", "valves")
    found = [one for one in history(rig) if one.alias == alias]
    # the newest one is in the birth
    assert [one.value(8) for one in found] == [1, 2, 3, 4, 5]
    assert [[one.properties.get(f"Quality{key}") for key in ("", " word", " reason")] for one in found] == [
        [192, "good", ""],
        [0, "bad", "line break: slot 3, input channel 0"],
        [0, "bad", "line break: slot 3, input channel 0"],
        [500, "uncertain", "upper limit value exceeded: slot 3"],
        [192, "good", "maintenance required (status A4)"],
    ]


def test_a_good_value_with_a_remark_takes_it_back_in_data(rig: HistoryRig) -> None:
    rig.settle()
    alias, found = rig.host.alias("Inputs/number", "valves"), []
    remark = {"quality": "good", "reason": "status_good", "text": "maintenance required (status A4)"}
    for quality in (remark, None, None):
        rig.values["8"]["qualities"] = None if quality is None else {"number": quality}
        rig.count()
        rig.pump()
        rig.deliver()
        [message] = [one for kind, _, payload in rig.host.messages if kind == "DDATA" for one in payload.metrics
                     if one.alias == alias][-1:]  # fmt: skip
        found.append(message.properties.get("Quality reason"))
    assert found == ["maintenance required (status A4)", "", None]


def test_values_of_a_device_that_is_back_before_its_death_was_sent_are_not_lost(rig: HistoryRig) -> None:
    rig.values["8"]["state"] = "offline"
    rig.count()
    rig.values["8"]["state"] = "data_exchange"
    for _ in range(3):
        rig.count()
    rig.settle()
    assert rig.host.alive == {"hoist", "valves"}
    rig.check_numbers()


def test_metrics_that_the_configuration_has_no_more_are_dropped_and_counted(rig: HistoryRig) -> None:
    outage(rig, 3)
    rig.plant["slaves"]["8"]["inputs"][-1] = rig.plant["slaves"]["8"]["inputs"][-1] | {"unit": "kg"}
    rig.give_plant()
    rig.unsafe.clear()
    rig.settle()
    assert rig.history is not None
    assert rig.history.unknown == 3
    assert "3 of metrics that the configuration does not have any more" in rig.history.losses


def test_history_waits_while_the_clock_was_never_set_and_has_the_right_times_then(rig: HistoryRig) -> None:
    rig.reboot(off_s=10.0, wall=5.0)  # no battery: 1970
    rig.count()
    rig.host.messages.clear()
    rig.connect()
    for _ in range(5):
        rig.pump()
        rig.round_trip()
        rig.step_disk()
        rig.wait(0.1)
    rig.cut()
    rig.count()
    rig.step_disk()
    assert history(rig) == []
    rig.publish_wills()
    rig.offset = 1_800_000_000.0
    rig.wait(61.0)
    rig.settle()
    assert [one.value(8) for one in history(rig) if one.alias == rig.alias_of_number][-1] == 2
    rig.check_numbers()


def test_history_keeps_a_pace_and_leaves_room_for_the_values_of_now(rig: HistoryRig) -> None:
    outage(rig, 2 * MOST_METRICS + 10)
    rig.connect()
    rig.pump()  # births
    rig.step_disk()
    rig.count()
    assert rig.pump() == 2  # the value of now, then history
    for _ in range(2):
        assert rig.pump() == 0
        assert rig.node.due(rig.clock) == pytest.approx(rig.clock + PACE_S)
        rig.clock += PACE_S
        assert rig.pump() == 1
    rig.deliver()
    sizes = [len(payload.metrics) for kind, _, payload in rig.host.messages[3:] if kind == "DDATA"]
    assert sizes == [1, MOST_METRICS, MOST_METRICS]
    assert not rig.host.messages[3][2].metrics[0].historical


def test_what_the_broker_has_not_confirmed_comes_again(rig: HistoryRig) -> None:
    rig.count()
    rig.pump()
    rig.round_trip(comes_back=False)  # it has arrived, and nobody knows
    rig.count()
    rig.pump()
    rig.cut()  # this one was lost on its way
    rig.publish_wills()
    rig.step_disk()
    rig.settle()
    assert [one.value(8) for one in history(rig) if one.alias == rig.alias_of_number] == [1, 2]


def test_a_round_trip_does_not_confirm_history_that_was_sent_behind_its_request(rig: HistoryRig) -> None:
    outage(rig, 3)
    rig.join()
    rig.step_disk()
    assert rig.file is not None
    before = rig.file.count
    number = rig.begin_round()
    assert rig.pump() == 1
    rig.end_round(number)
    rig.step_disk()
    assert rig.file.count == before
    rig.cut()  # it was lost on its way
    rig.publish_wills()
    rig.settle()
    rig.check_numbers()


def test_a_connection_that_confirms_everything_writes_nothing(rig: HistoryRig) -> None:
    assert rig.file is not None
    rig.settle()
    before = rig.file._last_id
    for _ in range(5):
        rig.count()
        rig.pump()
        rig.round_trip()
        rig.step_disk()
    assert rig.file._last_id == before
    assert history(rig) == []
