"""Things that listening did not hear, in literal telegrams of master 2 and slave 5: a verdict that is good is good as
far as heard."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import pytest
from support import MS, S

from dpstack.capture.timing import timing_of
from dpstack.capture.transmission import Transmission
from dpstack.monitor.devices import Devices, KnownDevice
from dpstack.monitor.monitor import Monitor

EPOCH = 1_800_000_000 * S
TOKEN = "DC 02 02"
DX_0, DX_1 = "10 05 02 5D 64 16", "10 05 02 7D 84 16"
INPUTS = "68 04 04 68 02 05 08 33 42 16"
#: the same inputs, and "a diagnosis is there" (DH)
ANNOUNCES = "68 04 04 68 02 05 0A 33 44 16"
ASKS = "68 05 05 68 85 82 7D 3C 3E FE 16"
#: in data exchange with master 2, nothing to report
HEALTHY = "68 0B 0B 68 82 85 08 3E 3C 00 0C 00 02 80 6A 81 16"
#: Ext_Diag; slot 3, input channel 0: line break
BREAK = "68 0E 0E 68 82 85 08 3E 3C 08 0C 00 02 80 6A 82 40 A6 F1 16"
SET_PRM = "68 0C 0C 68 85 82 5D 3D 3E 88 14 14 0B 80 6A 00 84 16"
OPERATE = "68 07 07 68 FF 82 46 3A 3E 00 00 3F 16"
SC = "E5"
#: an answer without its end
PIECE = "68 0B 0B 68 82 85"

NEVER = "standing diagnoses of 5 (level): no Slave_Diag was on the wire"
NO_PRM = "parameters of 5 (level) (watchdog, groups, user parameters): no Set_Prm was on the wire"
NO_MODE = "the mode of master 2: no Global_Control was on the wire"


def rounds(count: int) -> list[str]:
    polls = cycle((DX_0, DX_1))
    return [octets for _ in range(count) for octets in (TOKEN, next(polls), INPUTS)]


def heard(*telegrams: str) -> dict[str, Any]:
    """The summary of 6 s of data exchange, and then of ``telegrams``; "gap" stands for missed octets."""
    monitor = Monitor(timing_of("tap", 500_000, exact=True), devices=Devices({5: KnownDevice("level")}), begun_ns=EPOCH)
    for number, octets in enumerate([*rounds(1000), *telegrams]):
        t_ns = EPOCH + number * 2 * MS
        if octets == "gap":
            monitor.gap(t_ns, "octets were lost")
        else:
            monitor.add(Transmission(bytes.fromhex(octets), t_ns, 500_000))
    return monitor.summary()


@pytest.mark.parametrize(
    ("telegrams", "things", "lines", "texts"),
    [
        ((), ["diagnosis", "parameters"], [NEVER, NO_PRM, NO_MODE], None),
        ((ASKS, HEALTHY), ["parameters"], [NO_PRM, NO_MODE], []),
        ((ASKS, HEALTHY, OPERATE), ["parameters"], [NO_PRM], []),
        ((ASKS, HEALTHY, SET_PRM, SC, OPERATE), [], [], []),
        ((ASKS, PIECE, TOKEN), ["diagnosis", "parameters"], [NEVER, NO_PRM, NO_MODE], None),
        (
            (ASKS, HEALTHY, TOKEN, ASKS, PIECE, TOKEN),
            ["diagnosis", "parameters"],
            ["the last diagnosis of 5 (level): nobody could read the answer to Slave_Diag", NO_PRM, NO_MODE],
            [],
        ),
        (
            (ASKS, HEALTHY, DX_0, ANNOUNCES),
            ["diagnosis", "parameters"],
            ["the announced diagnosis of 5 (level): its master has not asked for it", NO_PRM, NO_MODE],
            [],
        ),
        ((DX_0, ANNOUNCES, ASKS, HEALTHY), ["parameters"], [NO_PRM, NO_MODE], []),
        (
            (ASKS, HEALTHY, "gap", TOKEN),
            ["diagnosis", "parameters"],
            [
                "diagnoses of 5 (level) since octets were missed: a Slave_Diag may be among them",
                NO_PRM,
                NO_MODE,
            ],
            [],
        ),
    ],
)
def test_each_thing_that_no_telegram_carried(
    telegrams: tuple[str, ...], things: list[str], lines: list[str], texts: list[str] | None
) -> None:
    summary = heard(*telegrams)
    station = summary["stations"]["5"]
    assert station["not_heard"] == things
    assert summary["not_heard"] == lines
    assert summary["stations"]["2"]["not_heard"] == (["mode"] if NO_MODE in lines else [])
    assert station["diagnosis_texts"] == texts


def test_the_content_of_a_diagnosis_that_was_heard() -> None:
    station = heard(ASKS, BREAK)["stations"]["5"]
    assert (station["verdict"], station["not_heard"]) == ("warning", ["parameters"])
    assert station["diagnosis_texts"] == ["slot 3, input channel 0 (word): line break"]


def test_nothing_is_missing_of_a_line_that_is_no_profibus() -> None:
    monitor = Monitor(timing_of("tap", 500_000, exact=True))
    monitor.add(Transmission(bytes.fromhex(DX_0), EPOCH, 500_000))
    summary: dict[str, Any] = monitor.summary()
    assert (summary["profibus"], summary["not_heard"]) == (False, [])
