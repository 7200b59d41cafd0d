"""The table of the bring-up: every row has its clause and is exercised."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from scripted_link import DIAG_FREE, DIAG_READY, MS, ScriptedSlave, data, exchanging, link, setup

from dpstack.dp.master.commands import ActivateSlave, DeactivateSlave
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.slave_states import TABLE
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Kind, Telegram


def test_states_of_the_table_are_reachable_and_named() -> None:
    assert {state for state, _ in TABLE} == set(SlaveState)
    assert all(row.clause for row in TABLE.values())


class _Recorder(dict[Any, Any]):
    """The table, remembering which rows were used."""

    def __init__(self) -> None:
        super().__init__(TABLE)
        self.used: set[Any] = set()

    def get(self, key: Any, default: Any = None) -> Any:
        self.used.add(key)
        return super().get(key, default)


def _diag(text: str) -> Callable[[Request], Telegram]:
    return lambda request: data(request, bytes.fromhex(text))


def _rs(request: Request) -> Telegram:
    return Telegram(Kind.SD1, 2, request.da, 0x03)


#: answers in the state reached (by SAP), to reach each row of the table from a slave that behaves up to there
_OTHER, _LOCKED = "02 05 00 FF 12 34", "00 0C 00 07 06 96"
_WANTS, _BAD_PRM, _STATIC, _WAITS = "02 05 00 FF 06 96", "42 05 00 02 06 96", "00 0E 00 02 06 96", "02 0C 00 02 06 96"


def test_every_row_of_the_table_is_exercised(monkeypatch: pytest.MonkeyPatch) -> None:
    from dpstack.dp.master import slave_handler

    table = _Recorder()
    monkeypatch.setattr(slave_handler, "TABLE", table)
    before: list[dict[int | None, Callable[[Request], Telegram | Failure]]] = [
        {},
        {60: _rs},
        {60: _diag(_OTHER)},
        {60: _diag(_LOCKED)},
        {61: lambda _r: Failure.NO_ANSWER},
        {61: _rs},
        {62: lambda _r: Failure.NO_ANSWER},
        {62: _rs},
    ]
    for answers in before:
        link(setup(), slaves={3: ScriptedSlave(answers=dict(answers))}).run(3_000 * MS)
    link(setup(), slaves={}).run(500 * MS)
    for ready in (_WANTS, _BAD_PRM, _WAITS, _LOCKED, _OTHER):
        long = 12_000 if ready == _WAITS else 3_000  # it is waited for the longest
        link(setup(), slaves={3: ScriptedSlave(ready=bytes.fromhex(ready))}).run(long * MS)
    half = link(setup(), slaves={3: ScriptedSlave(answers={61: lambda _r: Failure.NO_ANSWER}, free=DIAG_FREE)})
    half.hold()
    half.hold()
    half.slaves[3].free = bytes.fromhex(_WAITS)
    half.run(5 * MS)
    # in WAIT_READY: silence and refusals of Slave_Diag
    for answer in (lambda _r: Failure.NO_ANSWER, _rs):
        bus = link(setup())
        while bus.state(3) is not SlaveState.WAIT_READY:
            bus.hold()
        bus.slaves[3].answers[60] = answer
        bus.run(500 * MS)
    # in data exchange: every kind of trouble, then trouble with the diagnosis that follows
    for trouble in (_rs, lambda r: Telegram(Kind.SD1, 2, r.da, 0x02), lambda r: data(r, b"\x01")):
        for later in ({}, {60: _rs}, {60: _diag(_LOCKED)}, {60: _diag(_OTHER)}, {60: lambda _r: Failure.NO_ANSWER}):
            bus = exchanging(setup())
            bus.run(1_100 * MS)
            bus.slaves[3].configured = False
            bus.slaves[3].answers |= {None: trouble} | later
            bus.run(2_500 * MS)
    for diagnosis in (_STATIC, _WANTS, _BAD_PRM, _LOCKED, _OTHER, DIAG_READY.hex()):
        bus = exchanging(setup())
        bus.slaves[3].answers = {None: lambda r: data(r, bytes(4), fc=0x0A), 60: _diag(diagnosis)}
        bus.run(1_500 * MS)
    gone = exchanging(setup())
    gone.slaves.clear()
    gone.run(500 * MS)
    # out of service from every state, and back
    refusing = ScriptedSlave(ready=bytes.fromhex(_BAD_PRM))
    leaving = ScriptedSlave(answers={None: _rs})
    for slave in (ScriptedSlave(), refusing, leaving):
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
    assert set(TABLE) - table.used == set()
