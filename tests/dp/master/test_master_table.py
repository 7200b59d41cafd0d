"""The table of the bring-up: every row has its clause and is exercised."""

from __future__ import annotations

from typing import Any

import pytest
from scripted_link import (
    DIAG_FREE,
    DIAG_LOCKED,
    DIAG_NOT_READY,
    DIAG_PRM_FAULT,
    DIAG_READY,
    DIAG_STATIC,
    MS,
    ScriptedSlave,
    exchanging,
    high,
    link,
    link_to,
    refuses,
    says,
    setup,
    silent,
)

from dpstack.dp.master.commands import ActivateSlave, DeactivateSlave
from dpstack.dp.master.events import SlaveRemark, SlaveState
from dpstack.dp.master.slave_states import TABLE, Trigger, table


def test_states_of_the_table_are_reachable_and_named() -> None:
    assert {state for state, _ in TABLE} == set(SlaveState)
    assert all(row.clause for row in TABLE.values())


def test_a_pair_has_one_row() -> None:
    silent_row = ((SlaveState.FAULT, SlaveState.OFFLINE), Trigger.SILENT, SlaveState.OFFLINE, "clause")
    other = ((SlaveState.OFFLINE,), Trigger.SILENT, SlaveState.FAULT, "another clause")
    assert table((silent_row,))[SlaveState.FAULT, Trigger.SILENT] == (SlaveState.OFFLINE, "clause")
    for second in (silent_row, other):
        with pytest.raises(ValueError, match="two rows for SILENT in "):
            table((silent_row, second))


def test_a_pair_without_a_row_is_a_remark(monkeypatch: pytest.MonkeyPatch) -> None:
    from dpstack.dp.master import slave_handler

    rows = {pair: row for pair, row in TABLE.items() if pair != (SlaveState.DATA_EXCHANGE, Trigger.DIAG_PRM_REQ)}
    monkeypatch.setattr(slave_handler, "TABLE", rows)
    bus = exchanging(setup())
    bus.slave.answers = {None: high, 60: says(DIAG_FREE)}
    bus.run_long(1_500 * MS)
    assert [event.message for event in bus.events_of(SlaveRemark)] == [
        "ignored in data_exchange: 'diagnosis: wants parameters'; the table of states has no row for it, please report "
        "this to the makers of dpstack"
    ]
    assert bus.state(3) is SlaveState.DATA_EXCHANGE


def test_a_second_order_to_leave_service_is_no_remark() -> None:
    bus = exchanging(setup())
    for _ in range(2):
        bus.send(DeactivateSlave(3), 50 * MS)
    assert bus.state(3) is SlaveState.DEACTIVATED
    assert bus.events_of(SlaveRemark) == []


class _Recorder(dict[Any, Any]):
    """The table, remembering which rows were used."""

    def __init__(self) -> None:
        super().__init__(TABLE)
        self.used: set[Any] = set()

    def get(self, key: Any, default: Any = None) -> Any:
        self.used.add(key)
        return super().get(key, default)


_RS = refuses(0x03)
_OTHER = bytes.fromhex("02 05 00 FF 12 34")


def test_every_row_of_the_table_is_exercised(monkeypatch: pytest.MonkeyPatch) -> None:
    from dpstack.dp.master import slave_handler

    rows = _Recorder()
    monkeypatch.setattr(slave_handler, "TABLE", rows)
    # one service of the bring-up has another answer
    link_to().run_long(3_000 * MS)
    for sap, answer in (
        (60, _RS),
        (60, says(_OTHER)),
        (60, says(DIAG_LOCKED)),
        (61, silent),
        (61, _RS),
        (62, silent),
        (62, _RS),
    ):
        link_to(answers={sap: answer}).run_long(3_000 * MS)
    link(setup(), slaves={}).run(500 * MS)
    for ready in (DIAG_FREE, DIAG_PRM_FAULT, DIAG_LOCKED, _OTHER):
        link_to(ready=ready).run_long(3_000 * MS)
    link_to(ready=DIAG_NOT_READY).run_long(12_000 * MS)
    half = link_to(answers={61: silent})
    half.hold()
    half.hold()
    half.slave.free = DIAG_NOT_READY
    half.run(5 * MS)
    # in WAIT_READY: silence and refusals of Slave_Diag
    for answer in (silent, _RS):
        bus = link(setup())
        while bus.state(3) is not SlaveState.WAIT_READY:
            bus.hold()
        bus.slave.answers[60] = answer
        bus.run(500 * MS)
    # in data exchange: every kind of trouble, then trouble with the diagnosis that follows
    for trouble in (_RS, refuses(0x02), says(b"\x01")):
        for later in ({}, {60: _RS}, {60: says(DIAG_LOCKED)}, {60: says(_OTHER)}, {60: silent}):
            bus = exchanging(setup())
            bus.run_long(1_100 * MS)
            bus.slave.configured = False
            bus.slave.answers |= {None: trouble} | later
            bus.run_long(2_500 * MS)
    for ready in (DIAG_STATIC, DIAG_FREE, DIAG_PRM_FAULT, DIAG_LOCKED, _OTHER, DIAG_READY):
        bus = exchanging(setup())
        bus.slave.answers = {None: high, 60: says(ready)}
        bus.run_long(1_500 * MS)
    gone = exchanging(setup())
    gone.slaves.clear()
    gone.run(500 * MS)
    # out of service from every state, and back
    for slave in (ScriptedSlave(), ScriptedSlave(ready=DIAG_PRM_FAULT), ScriptedSlave(answers={None: _RS})):
        for state in {state for state, _ in TABLE} - {SlaveState.DEACTIVATED}:
            bus = link(setup(), slaves={3: slave})
            handler = bus.master.handlers[3]
            for _ in range(20):
                if handler.state is state:
                    break
                bus.hold()
            bus.send(DeactivateSlave(3))
            bus.hold()
            bus.send(ActivateSlave(3))
            slave.configured = False
    assert set(TABLE) - rows.used == set()
