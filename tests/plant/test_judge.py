"""Verdicts on a slave: one judge for screen, page, metrics and replay."""

from __future__ import annotations

from typing import Any

import pytest
from verdicts_kit import verdicts

from dpstack.dp.master.events import SlaveState
from dpstack.plant.items import DriveValues, SlaveValues
from dpstack.plant.judge import STATES, Level, drive_level, judged
from dpstack.profile.model.states import State

GOOD: dict[str, Any] = {
    "state": "data_exchange", "inputs_valid": True, "fault": None, "conspicuous": "", "drive": None, "injected": [],
    "master": None,
}  # fmt: skip
DRIVE = {"faults": ["F0070 comm link error"], "warnings": ["A0501 current limit"]}
FAULT = {"kind": "lost", "text": "slave 8 (valves) does not answer any more"}
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
    "a state of a newer version": ({"state": "new_state"}, (False, "off", "new state", None, None)),
    "nothing is known": ({"state": None, "inputs_valid": None}, (False, "off", "unknown", None, None)),
}


@pytest.mark.parametrize("case", ROWS)
def test_verdicts(case: str) -> None:
    changes, expected = ROWS[case]
    found = verdicts(GOOD | changes)
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
