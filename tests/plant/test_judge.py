"""Verdicts on a slave: one judge for screen, page, metrics and replay. On a running bus: levels and limits of the
monitor, about the last minutes, by the counters of the run."""

from __future__ import annotations

from typing import Any

import pytest
from verdicts_kit import verdicts

from dpstack.dp.master.events import SlaveState
from dpstack.monitor.verdict import CRITICAL, GOOD, UNKNOWN, WARNING
from dpstack.plant.items import DriveValues, SlaveValues
from dpstack.plant.judge import STATES, Level, drive_level, judged
from dpstack.plant.state import end_of
from dpstack.plant.tree import PlantTree
from dpstack.plant.verdicts import WINDOW_S, Judge
from dpstack.profile.model.states import State

FINE: dict[str, Any] = {
    "state": "data_exchange", "inputs_valid": True, "fault": None, "conspicuous": "", "drive": None, "injected": [],
    "master": None,
}  # fmt: skip
DRIVE = {"faults": ["F0070 comm link error"], "warnings": ["A0501 current limit"]}
FAULT = {"kind": "lost", "text": "slave 8 (valves) does not answer any more"}
ANNOUNCED = {"quality": "uncertain", "reason": "announced", "text": "diagnosis announced"}
BROKEN = {"slot": 3, "quality": "bad", "reason": "channel_fault", "text": "line break: slot 3, input channel 0"}
LINK = {"publisher": 7, "name": "encoder", "octets": "0:4", "to": 8, "good": False, "text": "no data"}
SENSOR = {"quality": "bad", "reason": "status_sensor_failure", "text": "sensor failure (status 10)"}
#: what differs from a slave that is well; then alive, level, words of its state, remark and its severity
ROWS: dict[str, tuple[dict[str, Any], tuple[bool, str, str, str | None, str | None]]] = {
    "well": ({}, (True, "good", "data exchange", None, None)),
    "a drive fault is worse than a diagnosis": (
        {"conspicuous": "ext_diag", "drive": DRIVE},
        (True, "error", "data exchange", "drive fault: F0070 comm link error", "error"),
    ),
    "a diagnosis": ({"conspicuous": "ext_diag"}, (True, "warning", "data exchange", "ext_diag", "warning")),
    "a diagnosis before a drive warning": (
        {"conspicuous": "ext_diag", "drive": {"faults": [], "warnings": ["A0501"]}},
        (True, "warning", "data exchange", "ext_diag", "warning"),
    ),
    "a bad place before a diagnosis that is announced": (
        {
            "doubts": [ANNOUNCED, BROKEN],
            "qualities": {"level": {key: BROKEN[key] for key in SENSOR}},
            "conspicuous": "ext_diag",
        },
        (True, "error", "data exchange", "line break: slot 3, input channel 0; diagnosis announced", "error"),
    ),
    "a bad value before the flags of a diagnosis": (
        {"qualities": {"level": SENSOR}, "conspicuous": "static_diag"},
        (True, "error", "data exchange", "level: sensor failure (status 10)", "error"),
    ),
    "a bad value besides a doubtful slot": (
        {"qualities": {"level": SENSOR}, "doubts": [{**ANNOUNCED, "reason": "slot_fault", "text": "slot 2"}]},
        (True, "error", "data exchange", "level: sensor failure (status 10); slot 2", "error"),
    ),
    "taken out of service with a bad value": (
        {"state": "deactivated", "inputs_valid": False, "qualities": {"level": SENSOR}},
        (False, "off", "deactivated", None, None),
    ),
    "a link without data": (
        {"links": [LINK, {**LINK, "publisher": 9, "name": "fan", "good": True}]},
        (True, "warning", "data exchange", "no valid data from publisher encoder: no data", "warning"),
    ),
    "a link that is not reported yet": (
        {"links": [{**LINK, "good": None}]},
        (True, "good", "data exchange", None, None),
    ),
    "a link without data of a slave that is not there": (
        {"state": "offline", "inputs_valid": False, "links": [LINK]},
        (False, "off", "offline", None, None),
    ),
    "a drive warning": (
        {"drive": {"faults": [], "warnings": ["A0501", "A0502"]}},
        (True, "warning", "data exchange", "drive warning: A0501, A0502", "warning"),
    ),
    "a simulated fault": (
        {"injected": ["silence"]},
        (True, "warning", "data exchange", "simulated fault: silence", "warning"),
    ),
    "inputs that are too old": (
        {"inputs_valid": False},
        (False, "warning", "not valid", "the inputs are not valid", "warning"),
    ),
    "old inputs and a diagnosis": (
        {"inputs_valid": False, "conspicuous": "static_diag"},
        (False, "warning", "not valid", "static_diag", "warning"),
    ),
    "lost": (
        {"state": "offline", "inputs_valid": False, "fault": FAULT},
        (False, "error", "offline", FAULT["text"], "error"),
    ),
    "inputs that claim to be valid outside of data exchange": (
        {"state": "wait_ready"},
        (False, "busy", "not ready yet", None, None),
    ),
    "brought up with a diagnosis": (
        {"state": "diagnosis", "inputs_valid": False, "conspicuous": "prm_req"},
        (False, "busy", "diagnosis", "prm_req", "warning"),
    ),
    "taken out of service": (
        {"state": "deactivated", "inputs_valid": False},
        (False, "off", "deactivated", None, None),
    ),
    "of another master": (
        {"master": 7},
        (True, "good", "data exchange (master 7)", None, None),
    ),
    "beside another master, which keeps the inputs to itself": (
        {"master": 7, "inputs_valid": False},
        (False, "good", "data exchange (master 7)", None, None),
    ),
    "a state of a newer version": ({"state": "new_state"}, (False, "off", "new state", None, None)),
    "nothing is known": ({"state": None, "inputs_valid": None}, (False, "off", "unknown", None, None)),
}


@pytest.mark.parametrize("case", ROWS)
def test_verdicts(case: str) -> None:
    changes, expected = ROWS[case]
    found = verdicts(FINE | changes)
    remark = found["remark"] or {"text": None, "severity": None}
    assert (found["alive"], found["level"], found["state_text"], remark["text"], remark["severity"]) == expected


def test_every_state_has_words() -> None:
    assert {*STATES} == {*(one.value for one in SlaveState), "unknown"}
    assert {level for _, level in STATES.values()} <= {*Level}


def test_every_state_of_a_drive_has_a_level() -> None:
    found = {state.value: drive_level(state) for state in State}
    on_the_way = ["not_ready", "switch_on_inhibited", "ready_to_switch_on", "ready", "stopping", "quick_stop"]
    assert found == {
        **dict.fromkeys(on_the_way, "busy"),
        "running": "good",
        "fault": "error",
        "fault_reaction": "error",
        "offline": "off",
        "unknown": "off",
    }
    older = judged(SlaveValues(drive=DriveValues(state="running")))
    assert older.drive == DriveValues(state="running", level="good")


STEP_S = 0.5


class Run:
    """A bus with two slaves, each with 100 requests a second."""

    def __init__(self) -> None:
        self.tree = PlantTree()
        self.judge = Judge(self.tree)
        self.t = 0.0
        self.bus: dict[str, Any] = {"stale": False, "mode": "operate", "in_ring": True, "telegrams": 0, "bad": {}}
        self.slaves: dict[str, dict[str, Any]] = {
            str(at): {"state": "data_exchange", "inputs_valid": True, "inputs_age_ms": 1.0, "telegrams": 0}
            for at in (3, 4)
        }
        plant = {
            "started": 1e9,
            "baud": 500_000,
            "read_only": False,
            "slaves": {"3": {"name": "a"}, "4": {"name": "b"}},
        }
        self._give({"plant": plant})

    def _give(self, item: dict[str, Any]) -> None:
        self.judge.take(self.tree.apply(item, self.t))

    def go(self, seconds: float) -> Run:
        for _ in range(round(seconds / STEP_S)):
            self.t += STEP_S
            for one in self.slaves.values():
                one["telegrams"] += int(200 * STEP_S) if one["state"] == "data_exchange" else 0
            self.bus["telegrams"] += int(500 * STEP_S)
            slaves = {at: dict(one) for at, one in self.slaves.items()}
            self._give({"snapshot": {"t": self.t, "whole": True, "bus": dict(self.bus), "slaves": slaves}})
        return self

    @property
    def levels(self) -> tuple[str, str, str]:
        bus, slaves = self.judge.judge()
        return bus.level, slaves[3].level, slaves[4].level

    @property
    def reasons(self) -> tuple[str, ...]:
        return self.judge.judge()[0].reasons


def test_a_bus_is_unknown_at_first_and_then_good() -> None:
    run = Run()
    assert run.levels == (UNKNOWN,) * 3
    assert run.go(2).levels == (UNKNOWN, UNKNOWN, UNKNOWN)
    assert run.go(5).levels == (GOOD,) * 3
    assert run.reasons == ()


@pytest.mark.parametrize(
    ("slave", "bus", "levels", "reason"),
    [
        ({"retries": 20}, {}, (WARNING, WARNING, GOOD), "slave 3 (a): 0.326 % of its requests were repeated"),
        ({"retries": 200}, {}, (CRITICAL, CRITICAL, GOOD), "slave 3 (a): 3.31 % of its requests were repeated"),
        ({"late": 20}, {}, (WARNING, WARNING, GOOD), "slave 3 (a): 0.326 % of its answers came too late"),
        ({"conspicuous": "Ext_Diag\x1b"}, {}, (WARNING, WARNING, GOOD), "slave 3 (a): it has a diagnosis: Ext_Diag"),
        ({"qualities": {"level": SENSOR}}, {}, (WARNING, WARNING, GOOD),
         "slave 3 (a): it has a diagnosis: level: sensor failure (status 10)"),
        ({"doubts": [BROKEN], "conspicuous": "ext_diag"}, {}, (WARNING, WARNING, GOOD),
         "slave 3 (a): it has a diagnosis: line break: slot 3, input channel 0"),
        ({"doubts": [ANNOUNCED]}, {}, (GOOD, GOOD, GOOD), ""),
        ({}, {"bad": {"fcs": 50}}, (WARNING, GOOD, GOOD), "0.162 % of the telegrams are damaged"),
        ({}, {"bad": {"fcs": 500, "x": 9}}, (CRITICAL, GOOD, GOOD), "1.63 % of the telegrams are damaged"),
        ({}, {"tokens_lost": 1}, (WARNING, GOOD, GOOD), "tokens were lost: 1"),
        ({}, {"mode": "clear"}, (WARNING, GOOD, GOOD), "the master is in clear, not in operate"),
        ({}, {"mode": "stop"}, (WARNING, UNKNOWN, UNKNOWN), "the master is in stop, not in operate"),
        ({}, {"in_ring": False}, (CRITICAL, GOOD, GOOD), "the master is not in the token ring"),
        ({}, {"clear": {"since": 1.0, "because": "b"}}, (CRITICAL, GOOD, GOOD), "the master went to Clear by itself"),
        ({"drive": {"faults": ["F 7"]}}, {}, (WARNING, WARNING, GOOD), "slave 3 (a): a: drive fault: F 7"),
        ({"state": "deactivated"}, {}, (GOOD, UNKNOWN, GOOD), ""),
        ({"state": "fault", "fault": {"text": "no answer"}}, {}, (CRITICAL, CRITICAL, GOOD),
         "slave 3 (a): it is not in data exchange: no answer"),
    ],
)  # fmt: skip
def test_a_finding_decides(slave: dict[str, Any], bus: dict[str, Any], levels: tuple[str, ...], reason: str) -> None:
    run = Run().go(50)
    run.slaves["3"] |= slave
    run.bus |= bus
    run.go(12)
    assert run.levels == levels
    assert any(one.startswith(reason) for one in run.reasons) or not reason
    assert all(one.isprintable() for one in run.reasons)


def test_losses_count_and_are_over_after_some_minutes() -> None:
    run = Run().go(10)
    for level in (WARNING, WARNING, CRITICAL):
        run.slaves["4"]["state"] = "offline"
        run.go(1)
        run.slaves["4"]["state"] = "data_exchange"
        assert run.go(1).levels == (level, GOOD, level)
    run.slaves["3"]["retries"] = 100
    assert run.go(1).levels[1] == CRITICAL or run.levels[1] == WARNING
    assert run.go(WINDOW_S + 31).levels == (GOOD,) * 3


def test_a_dead_bus_and_a_new_configuration() -> None:
    run = Run().go(20)
    run.bus["stale"] = True
    assert run.go(1).levels == (CRITICAL, UNKNOWN, UNKNOWN)
    run.bus["stale"] = False
    assert run.go(1).levels[0] == UNKNOWN, "counters of another life are not compared"
    assert run.go(6).levels == (GOOD,) * 3
    run.bus["mode"] = "offline"
    assert run.go(0.5).levels == (UNKNOWN,) * 3, "the end may follow"
    assert run.go(1).levels == (CRITICAL, UNKNOWN, UNKNOWN)
    run._give(end_of("the end", failed=False))
    assert run.levels == (UNKNOWN,) * 3


def test_a_bus_that_a_fault_has_ended_is_critical() -> None:
    run = Run().go(20)
    run._give(end_of("killed", failed=True))
    assert run.levels == (CRITICAL, UNKNOWN, UNKNOWN)
    assert run.reasons == ("a fault has ended the bus: killed",)


@pytest.mark.parametrize("before", [{"mode": "offline", "stale": True}, {"mode": "clear", "in_ring": False}])
def test_a_bus_that_begins_has_no_fault_for_10_s(before: dict[str, Any]) -> None:
    run = Run()
    after = {key: run.bus[key] for key in before}
    run.bus |= before
    assert run.go(9.5).levels[0] == UNKNOWN
    assert run.reasons == ("the bus begins",)
    assert run.go(1).levels[0] == CRITICAL
    run.bus |= after
    assert run.go(6).levels == (GOOD,) * 3
    run.bus |= before
    assert run.go(0.5).levels[0] == CRITICAL, "it has run, and begins no more"


def test_lost_slaves_are_those_of_this_moment() -> None:
    run = Run()
    run.slaves["3"]["state"] = run.slaves["4"]["state"] = "wait_ready"
    assert run.go(9.5).judge.lost() == []
    run.slaves["4"]["state"] = "data_exchange"
    assert run.go(1).judge.lost() == [3], "it has had 10 s"
    run.slaves["3"]["state"] = "data_exchange"
    assert run.go(0.5).judge.lost() == []
    run.slaves["4"]["state"] = "offline"
    assert run.go(0.5).judge.lost() == [4]
    run.slaves["4"]["state"] = "deactivated"
    assert run.go(0.5).judge.lost() == []
    run.slaves["4"]["state"] = "set_prm"
    assert run.go(0.5).judge.lost() == [], "one that is activated begins again"
    run.slaves["3"]["inputs_valid"] = False
    assert run.go(0.5).judge.lost() == []
    run.slaves["3"]["state"] = "offline"
    assert run.go(0.5).judge.lost() == [3]
    run.bus["mode"] = "stop"
    assert run.go(0.5).judge.lost() == [], "the master serves none"
    run.bus["stale"] = True
    assert run.go(0.5).judge.lost() == []
