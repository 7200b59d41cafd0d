"""The record of the last bring-ups: every service with its answer, bounded, and no cost in data exchange."""

from __future__ import annotations

from typing import Any

import pytest
from scripted_link import MS, exchanging, setup

from dpstack.dp.master.bring_ups import MOST_BRING_UPS, MOST_LOSSES, MOST_STEPS, BringUps
from dpstack.dp.master.events import SlaveState
from dpstack.fdl.interface import Failure
from dpstack.fdl.telegram import Kind, Resp, Telegram


def diagnosis(octets: str) -> Telegram:
    return Telegram(Kind.SD2, 2, 3, int(Resp.DL), 62, 60, bytes.fromhex(octets))


SC = Telegram(Kind.SC, -1, -1, -1)
WAITS = "02 05 00 FF 12 34"


def asked(ups: BringUps, state: SlaveState, service: str, outcome: Any, now: int, sent: bytes = b"") -> None:
    ups.answered(state, service, sent, outcome, now)


def test_a_bring_up_step_by_step_to_the_octet() -> None:
    bus = exchanging(setup(3))
    history = bus.master.handlers[3].bring_ups.history()
    (up,) = history.bring_ups
    assert [(step.asked, step.answered) for step in up.steps] == [
        ("Slave_Diag", "DL"),
        ("Set_Prm", "SC"),
        ("Chk_Cfg", "SC"),
        ("Slave_Diag", "DL"),
        ("Data_Exchange", "DL"),
    ]
    prm = bus.master.handlers[3].setup
    assert up.steps[1].sent[4:6] == (prm.ident or 0).to_bytes(2, "big")
    assert up.steps[2].sent == prm.config
    assert up.steps[4].received == bytes(prm.input_len)
    assert up.exchanging_ns == up.steps[4].t_ns
    assert (history.lost, history.brought_up, history.losses) == (0, 1, ())


def test_data_exchange_records_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand rounds of a slave in data exchange call the record never."""
    bus = exchanging(setup(3))
    calls: list[str] = []

    def count(name: str) -> None:
        original = getattr(BringUps, name)

        def counted(*args: Any, **kwargs: Any) -> object:
            calls.append(name)
            return original(*args, **kwargs)

        monkeypatch.setattr(BringUps, name, counted)

    for name in ("answered", "first_exchange", "left_exchange", "entered_exchange", "history"):
        count(name)
    before = bus.master.handlers[3].exchanges
    for _ in range(1000):
        bus.hold()
    assert bus.master.handlers[3].exchanges - before >= 1000
    assert calls == []
    bus.slaves.clear()
    bus.run(500 * MS)
    assert calls[:2] == ["answered", "left_exchange"]
    (loss,) = bus.master.handlers[3].bring_ups.history().losses
    assert (loss.how, loss.back_ns) == ("nothing", 0)


def test_the_record_is_bounded() -> None:
    ups = BringUps()
    for round_ in range(5):
        for number in range(60):  # never twice the same answer
            asked(ups, SlaveState.WAIT_READY, "Slave_Diag", diagnosis(f"02 05 00 FF 12 34 {number:02X}"), number)
        asked(ups, SlaveState.SET_PRM, "Set_Prm", SC, 100, bytes([round_]))
        asked(ups, SlaveState.OFFLINE, "Slave_Diag", Failure.NO_ANSWER, 101)
        ups.entered_exchange()
        ups.left_exchange(110, 5)
        ups.left_exchange(111, 5)
    history = ups.history()
    assert len(history.bring_ups) == MOST_BRING_UPS
    assert all(len(up.steps) <= MOST_STEPS for up in history.bring_ups)
    assert history.bring_ups[0].left_out > 30
    assert len(history.losses) == MOST_LOSSES
    assert history.lost == 10


def test_equal_steps_are_counted_and_a_new_bring_up_begins_after_a_refusal() -> None:
    ups = BringUps()
    for now in range(7):
        asked(ups, SlaveState.OFFLINE, "Slave_Diag", Failure.NO_ANSWER, now)
    asked(ups, SlaveState.OFFLINE, "Slave_Diag", Failure.GARBLED, 8)
    asked(ups, SlaveState.OFFLINE, "Slave_Diag", diagnosis(WAITS), 9)
    asked(ups, SlaveState.SET_PRM, "Set_Prm", SC, 10, b"\x88")
    asked(ups, SlaveState.FAULT, "Slave_Diag", diagnosis(WAITS), 20)
    first, second = ups.history().bring_ups
    assert [(step.answered, step.times, step.last_ns) for step in first.steps] == [
        ("nothing", 7, 6),
        ("damaged", 1, 8),
        ("DL", 1, 9),
        ("SC", 1, 10),
    ]
    assert [step.t_ns for step in second.steps] == [20]
    assert ups.history().idents == (0x1234,)


def test_the_way_back_after_a_loss() -> None:
    ups = BringUps()
    asked(ups, SlaveState.DATA_EXCHANGE, "Data_Exchange", Failure.NO_ANSWER, 50)
    ups.left_exchange(50, 40)
    asked(ups, SlaveState.OFFLINE, "Slave_Diag", Failure.NO_ANSWER, 60)
    asked(ups, SlaveState.OFFLINE, "Slave_Diag", diagnosis(WAITS), 90)
    asked(ups, SlaveState.OFFLINE, "Slave_Diag", diagnosis("00 0C 00 02 12 34"), 95)
    (loss,) = ups.history().losses
    assert (loss.t_ns, loss.stayed_ns, loss.how, loss.back_ns) == (50, 40, "nothing", 90)
    assert loss.prm_req
    assert loss.free
