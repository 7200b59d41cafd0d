"""The live list of a running bus."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterable

from dpstack.api.bus.parts import BusBase
from dpstack.api.slave.slave import Slave
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.scanner import Found, ScanDone, SlaveView, SurveyOrder, view_of
from dpstack.errors import DpError
from dpstack.fdl.commands import DetachUser
from dpstack.fdl.telegram import StationType


async def scan_on(bus: BusBase, *, configs: bool, addresses: Iterable[int], quick: bool | None) -> tuple[Found, ...]:
    if quick is None:
        quick = not any(slave.ready_now for slave in bus.slaves if not bus.view.read_only)
    own = bus.params.address
    mine = {} if bus.view.read_only else {slave.address: slave for slave in bus.slaves}
    token = bus.services.token()
    order = SurveyOrder(token, tuple(addresses), tuple(mine), configs=configs, quick=quick)
    try:
        result = await bus.services.answer_to(order, ScanDone)
    finally:
        with contextlib.suppress(DpError):  # the bus may have ended meanwhile
            bus.command(DetachUser(token))
    bus.unreadable = frozenset(result.unreadable)
    return tuple(_of_ours(found, mine.get(found.address), own) for found in result.found)


def _of_ours(found: Found, slave: Slave | None, own: int) -> Found:
    """``found`` with the master's knowledge of its own slave. A request would take a diagnosis from it."""
    if slave is None or found.kind is not StationType.SLAVE:
        return found
    exchanging = slave.state is SlaveState.DATA_EXCHANGE
    return dataclasses.replace(
        found,
        state=SlaveView.DATA_EXCHANGE if exchanging else view_of(slave.diagnosis),
        ident=None if slave.diagnosis is None else slave.diagnosis.ident,
        master=own if exchanging else None,
        config=slave.setup.config if exchanging else None,
        diagnosis=slave.diagnosis,
    )
