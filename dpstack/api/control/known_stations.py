"""The stations of a running bus as its master knows them already: live list and readings without a telegram."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.picture import picture_of
from dpstack.api.slave.station_report import UNASKED, StationReading, no_octets
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.scanner import Found
from dpstack.dp.pdu.diagnosis import SlaveView, view_of
from dpstack.errors import UsageError
from dpstack.fdl.telegram import StationType

if TYPE_CHECKING:
    from dpstack.api.slave.slave import Slave

_UNANSWERED: Final = (SlaveState.OFFLINE, SlaveState.DEACTIVATED)
_NOTE: Final = "as the run knows the bus already: no station was asked for this list"


def known_stations(bus: Bus) -> dict[str, Any]:
    """The answer to ``scan unasked``, with the keys of ``scan``: masters of the token ring, slaves that answer this
    master, stations that its GAP polls have found."""
    core, own = core_of(bus), bus.params.address
    snapshot = bus.snapshot
    found = {one: Found(address=one, kind=StationType.MASTER_IN_RING) for one in snapshot.las if one != own}
    found |= {one: Found(address=one, kind=StationType.SLAVE) for one in core.gap_slaves}
    found |= snapshot.found or {}
    names = {slave.address: slave.name for slave in bus.slaves}
    notes = [_NOTE]
    for slave in bus.slaves:
        if (why := _not_asking(bus)) is not None:
            notes.append(f"slave {slave.address} is not asked now: {why}")
        elif slave.state in _UNANSWERED:
            notes.append(f"slave {slave.address} of the configuration is {slave.state.value}")
        else:
            found[slave.address] = _found(bus, slave)
    return {
        "baud": bus.params.baud,
        "address": own,
        "stations": [{"config": None, **found[one].as_dict(), "name": names.get(one)} for one in sorted(found)],
        "unreadable": [],
        "notes": notes,
    }


def known_reading(bus: Bus, address: int) -> StationReading:
    """The reading of the slave at ``address`` from its last diagnosis and the process image. Raises UsageError for a
    station that the configuration does not have."""
    slave = next((one for one in bus.slaves if one.address == address), None)
    if slave is None:
        raise UsageError(f"station {address} is no slave of this configuration: nothing is known of it without asking")
    own = bus.params.address
    exchanging = slave.state is SlaveState.DATA_EXCHANGE
    why, values = _not_asking(bus), picture_of(core_of(bus), slave)
    found = no_octets()
    if why is not None:
        return StationReading(slave.address, own, "run", UNASKED, **found, errors={"Slave_Diag": f"not asked: {why}"})
    if slave.state in _UNANSWERED or slave.diagnosis is None:
        status = UNASKED if slave.state is SlaveState.DEACTIVATED else ""
        return StationReading(
            slave.address, own, "run", status, **found, errors={"Slave_Diag": f"the slave is {slave.state.value}"}
        )
    found["diagnosis"] = slave.diagnosis.build().hex()
    errors = {}
    if exchanging:
        found["config"] = slave.setup.config.hex()  # which it has accepted in Chk_Cfg
        found["outputs"] = values.outputs
        found["inputs"] = values.inputs if values.inputs_valid else None
        if not values.inputs_valid:
            errors["RD_Inp"] = "the run has no valid inputs at this moment"
    return StationReading(slave.address, own, "run", "", **found, errors=errors)


def _found(bus: Bus, slave: Slave) -> Found:
    """``slave``, which answers this master."""
    diagnosis = slave.diagnosis
    exchanging = slave.state is SlaveState.DATA_EXCHANGE
    state = SlaveView.DATA_EXCHANGE if exchanging else view_of(diagnosis)
    return Found(
        address=slave.address,
        kind=StationType.SLAVE,
        state=state,
        ident=None if diagnosis is None else diagnosis.ident,
        master=None if diagnosis is None else diagnosis.master,
        config=slave.setup.config if exchanging else None,
        diagnosis=diagnosis,
    )


def _not_asking(bus: Bus) -> str | None:
    """Why the master asks no slave at this moment, so that nobody knows their state; None if it does."""
    why = core_of(bus).runtime.not_running
    if why is not None:
        return str(why)
    snapshot = bus.snapshot
    if not snapshot.in_ring:
        return "the master is not in the token ring"
    if not core_of(bus).view.read_only and snapshot.mode < Mode.CLEAR:
        return f"the master is in {snapshot.mode.name.lower()}"
    return None
