"""Faults and settings of simulated slaves, as tables name them: ``do = "late_answers", by_ms = 20``.

A scenario and ``dpstack ctl PORT fault`` read them by :data:`KINDS`. All are checked before they begin.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

from dpstack.api.slave_side import diagnosis_steps
from dpstack.api.slave_side.diagnosis_steps import read_diagnosis
from dpstack.api.slave_side.virtual_bench import Bench, SimulatedSlave
from dpstack.errors import UsageError
from dpstack.fdl.telegram import Resp
from dpstack.profile import DriveDevice
from dpstack.sim.slave_faults import (
    Fault,
    LateAnswers,
    Refusals,
    RepeatedAnswers,
    StubNoise,
    WrongLength,
    fault_text,
)
from dpstack.text import octets_text
from dpstack.toml.table import Key, Table
from dpstack.units import NS_PER_MS

if TYPE_CHECKING:
    from dpstack.api.slave_side.simulated_cpu import SimulatedPlantCpu

#: ends a deed; False: it has ended before, or another one has replaced it
End = Callable[[], bool]


@dataclass(frozen=True, slots=True)
class Deed:
    """Something to be done to a simulated slave. ``text``: for people. ``begin`` does it and returns what ends it, None
    if nothing does. It may raise ValueError or UsageError.
    """

    text: str
    begin: Callable[[], End | None]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of deed: its keys, its reader, and whether it may end after a time."""

    keys: Mapping[str, Key]
    read: Callable[[Table, Mapping[str, Any], Bench, int], Deed]
    lasting: bool = True


def _of_fault(bench: Bench, address: int, fault: Fault) -> Deed:
    def begin() -> End:
        faults = bench.units[address].faults
        faults.begin(fault)
        return lambda: faults.end(fault)

    return Deed(fault_text(fault), begin)


def _late_answers(_table: Table, given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    return _of_fault(bench, address, LateAnswers(round(given.get("by_ms", 20.0) * NS_PER_MS)))


def _rs(_table: Table, given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    return _of_fault(bench, address, Refusals(Resp[given.get("status", "RS")]))


def _wrong_length(table: Table, given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    by, inputs = given.get("by_octets"), bench.units[address].config.params.input_len
    if by is None:
        by = -1 if inputs else 1
    if by == 0 or inputs + by < 0:
        table.fail(
            "by_octets", f"by_octets = {by}, and the slave has {inputs} octets of inputs", "write for instance 1"
        )
    return _of_fault(bench, address, WrongLength(by))


def _noise(_table: Table, given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    return _of_fault(bench, address, StubNoise(given.get("rate", 1e-3), given.get("seed", address)))


def _repeated_answers(_table: Table, _given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    return _of_fault(bench, address, RepeatedAnswers())


def _diagnosis(table: Table, given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    report = read_diagnosis(table, given, bench.units[address])
    if not given.get("over"):
        return _of_fault(bench, address, report)
    if "for" in table:
        table.fail("for", "for, and over ends a diagnosis", "leave for out")

    def end() -> None:
        unit = bench.units[address]
        if not unit.faults.end_alike(report):
            acting = ", ".join(fault_text(fault) for fault in unit.faults.active) or "none"
            raise UsageError(f"{unit.who} has no such diagnosis at this moment; its faults: {acting}")

    return Deed(f"over: {fault_text(report)}", end)


def _silence(_table: Table, _given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    name = bench.station(address).name

    def begin() -> End:
        bench.silence(name)

        def end() -> bool:
            bench.resume(name)
            return True

        return end

    return Deed("silence", begin)


def _power_off(_table: Table, _given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    unit = bench.station(address)

    def begin() -> End:
        bench.power(unit.name, False)

        def end() -> bool:
            was = unit.powered
            bench.power(unit.name, True)
            return not was

        return end

    return Deed("power off", begin)


def _set(table: Table, given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    """Inputs by octets or by names; of an S7-200 values by names."""
    if (cpu := bench.cpus.get(address)) is not None:
        return _set_values(table, given, cpu)
    unit = bench.units[address]
    octets, values = given.get("octets"), given.get("inputs")
    if (octets is None) is (values is None):
        table.fail(None, "neither inputs nor octets" if octets is None else "inputs and octets", "give one of them")
    _check_inputs(table, unit, octets, values)

    def begin() -> End:
        target = bench.units[address]
        before, image = target.held_inputs, target.inputs_with(values or {}) if octets is None else octets
        target.set_inputs(image)

        def end() -> bool:
            if target.held_inputs != image:
                return False
            target.set_inputs(before)
            return True

        return end

    said = ", ".join(f"{name} = {value}" for name, value in (values or {}).items())
    return Deed(f"inputs {said if octets is None else octets.hex().upper()}", begin)


def _set_values(table: Table, given: Mapping[str, Any], cpu: SimulatedPlantCpu) -> Deed:
    values = given.get("inputs")
    if values is None or "octets" in given:
        table.fail(None, f"{cpu.who} has values by names only", "write for instance inputs = { level = 5 }")
    try:
        plain = cpu.plain_values(values)
    except UsageError as error:
        what, _, todo = str(error).partition("; ")
        table.fail("inputs", what, todo or "correct it")

    def begin() -> End:
        memory = cpu.responder.cpu
        before = {address: memory[address] for address in plain}
        cpu.put(plain)

        def end() -> bool:
            if {address: memory[address] for address in plain} != plain:
                return False
            cpu.put(before)
            return True

        return end

    said = ", ".join(f"{name} = {value}" for name, value in values.items())
    return Deed(f"values {said}", begin)


def _check_inputs(
    table: Table, unit: SimulatedSlave, octets: bytes | None, values: Mapping[str, object] | None
) -> None:
    length = unit.config.params.input_len
    try:
        unit.check_settable()
        if octets is not None and len(octets) != length:
            raise UsageError(f"{unit.who} has {octets_text(length)} of inputs, {octets_text(len(octets))} given")
        unit.inputs_with(values or {})
    except (UsageError, ValueError) as error:
        what, _, todo = str(error).partition("; ")
        table.fail("inputs" if octets is None else "octets", what, todo or "correct it")


def _trip(table: Table, given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    unit, code = bench.units[address], given.get("code")
    device = unit.device
    if not isinstance(device, DriveDevice):
        if unit.several is not None:
            table.fail(
                "do", f"{unit.who} has several simulated drives", "trip one by `dpstack ctl PORT trip DRIVE CODE`"
            )
        table.fail("do", f"{unit.who} is no simulated drive", "only a drive trips")
    if code is None:
        table.fail(None, "a trip without code", 'add the code or name of the fault, for instance code = "F2100"')
    try:
        device.fault_code(code)
    except ValueError as error:
        what, _, todo = str(error).partition("; ")
        table.fail("code", what, todo or "correct it")

    def begin() -> None:
        drive = bench.device(address)
        assert isinstance(drive, DriveDevice)
        drive.trip(code)

    return Deed(f"trip {code}", begin)


#: what can be done to a simulated S7-200
OF_CPUS: Final = ("set", "silence", "power_off")
#: what can be done to a simulated slave
KINDS: Final[Mapping[str, Kind]] = {
    "late_answers": Kind({"by_ms": Key(0.01, 10_000, kind=float)}, _late_answers),
    "rs": Kind({"status": Key(kind=Literal["RS", "RR", "UE"])}, _rs),
    "wrong_length": Kind({"by_octets": Key(-244, 244, kind=int)}, _wrong_length),
    "noise": Kind({"rate": Key(1e-9, 0.5, kind=float), "seed": Key(0, 2**31, kind=int)}, _noise),
    "repeated_answers": Kind({}, _repeated_answers),
    "diagnosis": Kind(diagnosis_steps.KEYS, _diagnosis),
    "silence": Kind({}, _silence),
    "power_off": Kind({}, _power_off),
    "set": Kind({"inputs": Key(kind=Mapping), "octets": Key(kind=bytes)}, _set),
    "trip": Kind({"code": Key(kind=str)}, _trip, lasting=False),
}
