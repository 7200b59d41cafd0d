"""Remarks are reported once each, and at most so many of them."""

from __future__ import annotations

from dpstack.dp.master.events import SlaveRemark
from dpstack.dp.master.slave_reports import SlaveReports
from dpstack.dp.slave_params import SlaveParams
from dpstack.report_once import Novelty, ReportOnce
from dpstack.trace import Event


def test_up_to_a_limit() -> None:
    once = ReportOnce(3)
    assert [once.novelty(what) for what in "aabacbd"] == [
        Novelty.NEW,
        Novelty.KNOWN,
        Novelty.NEW,
        Novelty.KNOWN,
        Novelty.LAST,
        Novelty.KNOWN,
        Novelty.KNOWN,
    ]


def test_a_slave_that_deviates_in_another_way_each_time_fills_no_log() -> None:
    told: list[Event] = []
    reports = SlaveReports(SlaveParams(address=4, name="s4", ident=None, config=b"\x10"), told.append, 2, set())
    for number in range(1000):
        reports.remark(f"answers Slave_Diag with {number % 500} octets", number)
    texts = [event.message for event in told if isinstance(event, SlaveRemark)]
    assert len(texts) == len(set(texts)) == 20
    assert texts[-1] == "answers Slave_Diag with 19 octets; further deviations are not reported"
    assert texts[-2] == "answers Slave_Diag with 18 octets"
