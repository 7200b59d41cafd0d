"""Texts of the events of a DP master, word for word, and those that must reach the application."""

from __future__ import annotations

from typing import Any

import pytest

from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import (
    ApplicationSilent,
    AutoCleared,
    Blocked,
    ControlFailed,
    ControlSent,
    CyclesMissed,
    DriveEvent,
    Fault,
    FaultKind,
    ForcedClear,
    MasterStopped,
    ModeChanged,
    OperateWaits,
    PictureTaken,
    SlaveDiagnosis,
    SlaveFaulted,
    SlaveRemark,
    SlaveState,
    SlaveStateChanged,
    Stalled,
)
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.trace import Event

AT_3: dict[str, Any] = {"t_ns": 1, "address": 3, "name": "pump"}


def drive(**payload: object) -> DriveEvent:
    return DriveEvent(t_ns=1, address=3, name="pump", payload=payload)


@pytest.mark.parametrize(
    ("event", "text"),
    [
        (drive(type="result", ok=True), "drive 3 (pump): order done"),
        (drive(type="result", ok=True, value="running"), "drive 3 (pump): order done: running"),
        (drive(type="result", ok=True, value={"speed": 1}), "drive 3 (pump): order done"),
        (drive(type="result", ok=False, text="no"), "drive 3 (pump): order failed: no"),
        (drive(type="result", ok=False, text=None), "drive 3 (pump): order failed"),
        (drive(type="failed", text="ValueError: no"), "drive 3 (pump): its plugin failed: ValueError: no"),
        (
            drive(type="failed", text="ValueError: no", where="f(), a.py line 1"),
            "drive 3 (pump): its plugin failed: ValueError: no, in f(), a.py line 1",
        ),
        (drive(type="failed"), "drive 3 (pump): its plugin failed: failed"),
        (drive(type="status", state="running", text="x"), "drive 3 (pump): running"),
        (drive(type="status"), "drive 3 (pump): None"),
        (drive(type="status", state="fault", faults=[]), "drive 3 (pump): fault"),
        (drive(type="status", state="fault", faults=["F1", "F2"]), "drive 3 (pump): fault: F1, F2"),
        (
            drive(type="status", state="fault", faults=("F1",), warnings=["A1", "A2"]),
            "drive 3 (pump): fault: F1, warning A1, warning A2",
        ),
        (drive(type="status", state="ready", faults=["F1", 2]), "drive 3 (pump): ready, fault F1, fault 2"),
        (drive(type="status", state="ready", faults="F1", warnings="A1"), "drive 3 (pump): ready"),
        (SlaveStateChanged(**AT_3, state=SlaveState.DATA_EXCHANGE), "slave 3 (pump): data_exchange"),
        (
            SlaveFaulted(**AT_3, fault=Fault(FaultKind.ABSENT, "does not answer", "switch it on")),
            "slave 3 (pump): does not answer; switch it on",
        ),
        (SlaveRemark(**AT_3, message="is odd"), "slave 3 (pump): is odd"),
        (
            SlaveDiagnosis(**AT_3, diagnosis=Diagnosis(0, 4, 0, None, 1)),
            "slave 3 (pump): diagnosis without findings",
        ),
        (
            SlaveDiagnosis(**AT_3, diagnosis=Diagnosis(0, 4, 0, None, 1), texts=("hot", "cold")),
            "slave 3 (pump): diagnosis without findings; hot; cold",
        ),
        (ModeChanged(t_ns=1, mode=Mode.CLEAR), "master: clear"),
        (MasterStopped(t_ns=1), "master: stopped: safe values and Clear were sent"),
        (
            MasterStopped(t_ns=1, cleared=False),
            "master: stopped: it had no token to send safe values and Clear",
        ),
        (
            OperateWaits(t_ns=1, slaves=(3, 4), reasons=("3 is away", "4 too")),
            "master: auto_clear: stays in Clear until all slaves are in data exchange: 3 is away; 4 too",
        ),
        (
            AutoCleared(t_ns=1, slaves=(3, 4), reasons=("3 is away", "4 too")),
            "master: auto_clear: outputs become safe: 3 is away; 4 too; operate() again when it is back",
        ),
        (
            Stalled(t_ns=1, gap_ns=5, slaves=(3,), blocked=Blocked.PORT, reason="3 got nothing"),
            "master: stall: outputs become safe: 3 got nothing; look at the plant, then operate() "
            '(after_stall = "resume" sends the old outputs again unasked)',
        ),
        (
            ApplicationSilent(t_ns=1, limit_ns=250_000_000),
            "master: outputs become safe: application watchdog: alive() was not called for 250 ms; "
            "operate() when the application works again",
        ),
        (
            CyclesMissed(t_ns=1, count=1, missed=7, number=99, late_ns=1_500_000, reason="a reason"),
            "deadline miss 7: cycle 99 was 1.5 ms late: a reason",
        ),
        (
            CyclesMissed(t_ns=1, count=3, missed=7, number=99, late_ns=1_500_000, reason="a reason"),
            "deadline misses 5 to 7: cycle 99 was 1.5 ms late: a reason",
        ),
        (ControlSent(t_ns=1, token=2), "master: Global_Control was sent"),
        (
            ControlSent(t_ns=1, token=2, missed=(3, 4)),
            "master: Global_Control was sent; not taken by slaves 3, 4",
        ),
        (
            PictureTaken(t_ns=1, token=2, inputs={3: b"", 4: b""}),
            "master: inputs of one moment from slaves 3, 4",
        ),
        (
            ControlFailed(t_ns=1, token=2, reason="nobody is there"),
            "master: Global_Control was not carried out: nobody is there",
        ),
    ],
)
def test_text(event: Event, text: str) -> None:
    assert event.text == text


def test_reasons_without_what_to_do() -> None:
    cleared: list[ForcedClear] = [
        AutoCleared(t_ns=1, slaves=(3, 4), reasons=("3 is away", "4 too")),
        Stalled(t_ns=1, gap_ns=None, slaves=(3,), blocked=None, reason="3 got nothing"),
        ApplicationSilent(t_ns=1, limit_ns=2_500_000),
    ]
    assert [event.why for event in cleared] == [
        "auto_clear: 3 is away; 4 too",
        "stall: 3 got nothing",
        "application watchdog: alive() was not called for 2.5 ms",
    ]


def test_the_application_cannot_miss_the_end_of_an_order_nor_a_clear_of_the_masters_own() -> None:
    assert drive(type="result").must_arrive
    assert not drive(type="status").must_arrive
    assert not drive(type="failed").must_arrive
    must: list[type[Event]] = [AutoCleared, Stalled, ApplicationSilent, ControlSent, ControlFailed, PictureTaken]
    assert [kind for kind in must if not kind.MUST_ARRIVE] == []
    may: list[type[Event]] = [SlaveStateChanged, SlaveDiagnosis, ModeChanged, CyclesMissed]
    assert [kind for kind in may if kind.MUST_ARRIVE] == []
