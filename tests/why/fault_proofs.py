"""Proofs that a plant of ``fault_table`` is troubled as it claims to be.

The facts are those of the simulated devices (state, counters, events) and of the wire log, not of the user's master and
not of a diagnosis.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Final

from faults.devices import DpV0Only, NeedsDpV1, Picky, RefusesService

from dpstack.dp.slave.application import SlaveAppState
from dpstack.params import BusParams
from dpstack.profile import DriveDevice
from tests.why.fault_plants import Plant, Unit

Proof = Callable[[Plant], None]
PROOFS: Final[dict[str, Proof]] = {}


def proves(*faults: str) -> Callable[[Proof], Proof]:
    def add(proof: Proof) -> Proof:
        PROOFS.update(dict.fromkeys(faults, proof))
        return proof

    return add


def asked(plant: Plant) -> Unit:
    assert plant.asked is not None
    return plant.asked


def runs(plant: Plant, unit: Unit) -> bool:
    """Whether the user's master exchanges data with ``unit``."""
    return unit.app.state is SlaveAppState.DATA_EXCH and unit.app.master == plant.address


def neighbours_run(plant: Plant) -> None:
    """One neighbour at least exchanges data, so the bus as a whole works."""
    assert any(runs(plant, unit) for unit in plant.units if unit is not plant.asked)


def idle(plant: Plant) -> Unit:
    """The unit asked about, which does not exchange data; a neighbour does."""
    unit = asked(plant)
    assert not runs(plant, unit)
    assert not unit.app.stats.exchanges or unit.app.master != plant.address
    neighbours_run(plant)
    return unit


def diagnoses(plant: Plant, unit: Unit) -> Iterator[bytes]:
    """The Slave_Diag answers of ``unit``, by their octets."""
    for entry in plant.sent(unit):
        octets = entry.octets
        if octets[0] == 0x68 and octets[4] & octets[5] & 0x80 and octets[8] == 60:
            yield octets[9:-2]


@proves("no_power", "wires_open")
def nobody_there(plant: Plant) -> None:
    assert plant.asked is None
    assert plant.at not in {unit.address for unit in plant.units}
    assert plant.asked_for(plant.at)
    assert not [entry for entry in plant.world.log if entry.sender == f"slave {plant.at}"]
    neighbours_run(plant)
    if plant.fault == "wires_open":
        assert any(not runs(plant, unit) for unit in plant.units)


@proves("deaf_at_rate")
def hears_nothing(plant: Plant) -> None:
    unit = idle(plant)
    assert unit.address == plant.at
    assert unit.station.baud != plant.baud
    assert unit.requests == 0
    assert plant.asked_for(plant.at)


@proves("other_address")
def stands_elsewhere(plant: Plant) -> None:
    unit = idle(plant)
    assert unit.address not in {table["address"] for table in plant.tables}
    assert unit.app.device.ident == plant.slave.params.ident
    assert unit.app.state is SlaveAppState.WAIT_PRM
    assert plant.at not in {one.address for one in plant.units}


@proves("rate_mismatch")
def all_at_another_rate(plant: Plant) -> None:
    slaves = [unit for unit in plant.units if unit.address in {table["address"] for table in plant.tables}]
    assert len(slaves) == len(plant.tables) >= 3
    assert all(unit.station.baud != plant.baud and unit.requests == 0 for unit in slaves)


@proves("sister_ident", "locked_sister", "sister_with_another_rack")
def another_ident(plant: Plant) -> None:
    unit = asked(plant)
    assert not runs(plant, unit)
    assert unit.app.device.ident != plant.slave.params.ident
    assert any(diagnosis[4:6] == unit.app.device.ident.to_bytes(2, "big") for diagnosis in diagnoses(plant, unit))
    if plant.fault == "locked_sister":
        assert unit.app.master not in (None, plant.address)
    if plant.fault == "sister_with_another_rack":
        assert unit.app.device.configs[0] != plant.slave.params.config


@proves("module_order", "module_missing", "module_extra", "module_type")
def another_rack(plant: Plant) -> None:
    unit = idle(plant)
    assert unit.app.diag.cfg_fault
    assert "Chk_Cfg" in unit.texts()
    wanted, real = plant.slave.params.config, unit.app.device.configs[0]
    assert wanted != real
    assert unit.app.device.ident == plant.slave.params.ident
    match plant.fault:
        case "module_order":
            assert sorted(wanted) == sorted(real)
        case "module_missing":
            assert len(real) < len(wanted)
        case "module_extra":
            assert len(real) > len(wanted)
        case "module_type":
            assert sorted(wanted) != sorted(real)


@proves("user_parameter", "user_parameter_length", "stub_and_parameter", "parameter_and_module")
def parameters_refused(plant: Plant) -> None:
    unit = asked(plant)
    device, sent = unit.app.device, plant.slave.params.user_prm
    assert isinstance(device, Picky)
    assert not runs(plant, unit)
    assert unit.app.diag.prm_fault
    assert "Set_Prm" in unit.texts()
    if plant.fault == "user_parameter_length":
        assert len(sent) != len(device.wanted)
        assert "are needed" in unit.texts()
    else:
        assert sum(one != other for one, other in zip(sent, device.wanted, strict=True)) == 1
    if plant.fault == "parameter_and_module":
        assert device.configs[0] != plant.slave.params.config
    if plant.fault == "stub_and_parameter":
        damaged_at_the_stub(plant)


@proves("dpv1_mismatch")
def dpv1_refused(plant: Plant) -> None:
    unit = idle(plant)
    assert isinstance(unit.app.device, (DpV0Only, NeedsDpV1))
    assert unit.app.diag.prm_fault
    assert "DPV1_Enable" in unit.texts()


@proves("not_supported")
def function_refused(plant: Plant) -> None:
    unit = idle(plant)
    assert unit.app.diag.not_supported
    assert "is not supported" in unit.texts()


@proves("locked")
def has_another_master(plant: Plant) -> None:
    unit = idle(plant)
    assert unit.app.master is not None
    assert unit.app.master != plant.address
    assert plant.asked_for(plant.at)


@proves("watchdog_short")
def watchdog_expires(plant: Plant) -> None:
    unit = asked(plant)
    assert unit.app.stats.watchdogs >= 2
    assert "nothing from master" in unit.texts()


@proves("duplicate_address")
def two_answer(plant: Plant) -> None:
    both = [unit for unit in plant.units if unit.address == plant.at]
    assert len(both) == 2
    assert all(unit.requests for unit in both)
    senders = {entry.sender for entry in plant.world.log}
    assert {f"slave {plant.at}", "twin"} <= senders


@proves("noise_on_stub")
def damaged_at_the_stub(plant: Plant) -> None:
    label = f"slave {plant.at}"
    damaged = {entry.sender for entry in plant.world.log if "damaged" in entry.note}
    lost = [entry for entry in plant.world.log if entry.note in ("damaged", "dropped")]
    assert damaged <= {label}
    assert all(entry.sender == label or entry.octets[4] & 0x7F == plant.at for entry in lost if entry.octets[0] == 0x68)
    assert len(lost) >= 3
    neighbours_run(plant)


@proves("noise_on_segment")
def damaged_everywhere(plant: Plant) -> None:
    damaged = [entry.sender for entry in plant.world.log if "damaged" in entry.note]
    assert len(damaged) >= 10
    assert len(set(damaged)) >= 2


@proves("noise_and_module")
def damaged_and_another_rack(plant: Plant) -> None:
    damaged_everywhere(plant)
    unit = asked(plant)
    assert not runs(plant, unit)
    assert unit.app.device.configs[0] != plant.slave.params.config
    assert "Chk_Cfg" in unit.texts()


@proves("bus_jammed")
def no_silence(plant: Plant) -> None:
    entries = list(plant.world.log)
    first = next(number for number, entry in enumerate(entries) if entry.sender == "babbler")
    jam = [entry for entry in entries[first:] if entry.sender == "babbler"]
    assert len(jam) > 10
    assert all(after.start_ns - before.end_ns <= 1_000 for before, after in itertools.pairwise(jam))
    others = [entry for entry in entries[first + 1 :] if entry.sender != "babbler"]
    assert all("collision" in entry.note for entry in others)


@proves("answers_late")
def later_than_the_slot_time(plant: Plant) -> None:
    unit = asked(plant)
    answers = plant.sent(unit)
    late = [entry for entry in answers if "delayed" in entry.note]
    assert len(late) > len(answers) / 3
    assert len([entry for entry in late if "collision" not in entry.note]) >= 2


@proves("answers_too_soon")
def sooner_than_min_tsdr(plant: Plant) -> None:
    unit = idle(plant)
    entries = list(plant.world.log)
    label = f"slave {plant.at}"
    gaps = [entry.start_ns - before.end_ns for before, entry in itertools.pairwise(entries) if entry.sender == label]
    assert gaps
    assert max(gaps) < BusParams.preset(plant.baud).ns(11)
    assert unit.requests


@proves("reboots")
def starts_again(plant: Plant) -> None:
    unit = asked(plant)
    assert unit.plugged >= 4
    assert unit.app.stats.exchanges or unit.app.stats.services


@proves("not_ready")
def never_ready(plant: Plant) -> None:
    unit = idle(plant)
    last = list(diagnoses(plant, unit))[-1]
    assert last[0] & 0x46 == 0x02  # Station_Not_Ready, no Prm_Fault, no Cfg_Fault
    assert not last[1] & 0x01  # no Prm_Req
    assert unit.app.master == plant.address


@proves("static_diagnosis")
def stat_diag(plant: Plant) -> None:
    unit = asked(plant)
    assert unit.app.stats.exchanges == 0
    last = list(diagnoses(plant, unit))[-1]
    assert last[1] & 0x03 == 0x02  # Stat_Diag, no Prm_Req
    neighbours_run(plant)


@proves("data_length")
def other_length(plant: Plant) -> None:
    unit = asked(plant)
    assert unit.app.stats.exchanges >= 1
    wanted = plant.slave.params.input_len
    answers = [entry.octets for entry in plant.sent(unit)]
    lengths = {octets[1] - 3 for octets in answers if octets[0] == 0x68 and not octets[4] & 0x80}
    assert lengths
    assert wanted not in lengths
    neighbours_run(plant)


@proves("service_refused")
def answers_rs(plant: Plant) -> None:
    unit = asked(plant)
    assert isinstance(unit.app, RefusesService)
    assert unit.app.refused_service
    assert any(entry.octets[0] == 0x10 and entry.octets[3] & 0x0F == 0x03 for entry in plant.sent(unit))
    assert unit.app.stats.exchanges == 0
    neighbours_run(plant)


@proves("no_token")
def never_sends(plant: Plant) -> None:
    (other,) = plant.masters
    assert plant.sent_by_master(other.station.address)
    assert not plant.sent_by_master(plant.address)
    assert asked(plant).requests == 0


@proves("second_master_same_address")
def two_masters(plant: Plant) -> None:
    if plant.masters:
        (other,) = plant.masters
        assert other.station.address == plant.address
        assert plant.sent_by_master(plant.address)
        assert not runs(plant, asked(plant))
        return
    theirs = [entry.octets for entry in plant.world.log if entry.sender == "rude master"]
    assert len(theirs) >= 3
    assert all(octets[5] & 0x7F == plant.address for octets in theirs)


@proves("deactivated")
def left_alone(plant: Plant) -> None:
    unit = asked(plant)
    assert unit.app.state is SlaveAppState.WAIT_PRM
    neighbours_run(plant)


@proves(
    "healthy_alone", "healthy_beside_a_master", "healthy_beside_a_fault", "healthy_drive", "healthy_after_a_restart"
)
def well(plant: Plant) -> None:
    unit = asked(plant)
    assert runs(plant, unit)
    assert unit.app.stats.exchanges >= 3
    assert unit.app.stats.watchdogs == 0
    diagnosis = unit.app.diagnosis(plant.world.now)
    assert not diagnosis.status1 & 0x4E
    assert not diagnosis.status2 & 0x03
    if plant.fault == "healthy_drive":
        assert isinstance(unit.app.device, DriveDevice)
        assert unit.app.device.motor.speed > 0
