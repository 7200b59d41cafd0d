"""Every row of the slave's transition table, driven by what causes it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from slave_kit import CFG, KEEP, MS, OTHER, PRM, UNLOCK, Bench

from dpstack.dp.slave.state_table import TABLE, AppTrigger, SlaveAppState

Cause = Callable[[Bench], object]


def _foreign_cfg(bench: Bench) -> None:
    bench.cfg(CFG, sa=OTHER)


def _break(method: str, then: Cause) -> Cause:
    def cause(bench: Bench) -> None:
        bench.recorder.broken = method
        then(bench)

    return cause


def _held_cfg(bench: Bench) -> None:
    bench.recorder.broken = "check_cfg"
    bench.cfg()
    bench.prm()
    assert bench.app.state is SlaveAppState.WAIT_CFG
    bench.cfg()


def _set_address(bench: Bench) -> None:
    bench.device.set_slave_add = True
    bench.ask(55, bytes.fromhex("09 0A 35 00"))


CAUSES: dict[AppTrigger, Cause] = {
    AppTrigger.PRM_GOOD: lambda bench: bench.prm(),
    AppTrigger.PRM_BAD: lambda bench: bench.prm(b"\x88"),
    AppTrigger.PRM_KEEP: lambda bench: bench.prm(KEEP),
    AppTrigger.UNLOCK: lambda bench: bench.prm(UNLOCK),
    AppTrigger.PRM_FOREIGN: lambda bench: bench.prm(PRM, sa=OTHER),
    AppTrigger.CFG_GOOD: lambda bench: bench.cfg(),
    AppTrigger.CFG_BAD: lambda bench: bench.cfg(b"\x11"),
    AppTrigger.CFG_HELD: _held_cfg,
    AppTrigger.CFG_FOREIGN: _foreign_cfg,
    AppTrigger.ADDRESS: _set_address,
    AppTrigger.LENGTH: lambda bench: bench.dx(b"\x01\x02"),
    AppTrigger.WATCHDOG: lambda bench: bench.pass_time(100 * MS),
    AppTrigger.FAILED: _break("ext_diag", lambda bench: bench.diag()),
    AppTrigger.POWER_ON: lambda bench: bench.app.restart(bench.now),
}


@pytest.mark.parametrize("row", list(TABLE), ids=lambda row: f"{row[0].value}-{row[1].name.lower()}")
def test_every_row(row: tuple[SlaveAppState, AppTrigger], monkeypatch: pytest.MonkeyPatch) -> None:
    start, event = row
    bench = Bench()
    if start is not SlaveAppState.WAIT_PRM:
        bench.prm()
    if start is SlaveAppState.DATA_EXCH:
        bench.cfg()
    assert bench.app.state is start
    taken = Rows()
    monkeypatch.setattr("dpstack.dp.slave.state.TABLE", taken)
    CAUSES[event](bench)
    assert taken.last == row
    assert bench.app.state is TABLE[row].next


class Rows(dict[tuple[SlaveAppState, AppTrigger], object]):
    """The table, remembering the row that was looked up last."""

    def __init__(self) -> None:
        super().__init__(TABLE)
        self.last: tuple[SlaveAppState, AppTrigger] | None = None

    def __getitem__(self, row: tuple[SlaveAppState, AppTrigger]) -> object:
        self.last = row
        return super().__getitem__(row)


def test_every_row_has_a_clause_and_every_event_a_cause() -> None:
    assert all(row.clause for row in TABLE.values())
    assert {event for _, event in TABLE} == set(AppTrigger) == set(CAUSES)
