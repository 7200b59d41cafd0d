"""Faults and settings of simulated slaves, as tables name them: ``do = "late_answers", by_ms = 20``.

A scenario and ``dpstack ctl PORT fault`` read them by :data:`KINDS`. All are checked before they begin.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from dpstack.api.config.table import Key, Table
from dpstack.api.slave_side.virtual_bench import Bench, SimulatedSlave
from dpstack.dp.pdu.diag_blocks import CHANNEL_ERRORS, FIRST_SLOT, UserDiag, channel_block, device_block
from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.telegram import Resp
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.model import DiagText
from dpstack.profile import DriveDevice
from dpstack.sim.slave_faults import (
    Fault,
    LateAnswers,
    Refusals,
    RepeatedAnswers,
    ReportedDiagnosis,
    StubNoise,
    WrongLength,
    fault_text,
)
from dpstack.text import did_you_mean, octets_text
from dpstack.units import NS_PER_MS

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
    """A channel related block, octets, or the block with a text of the GSD file."""
    unit = bench.units[address]
    texts = unit.config.params.texts
    first = FIRST_SLOT if texts is None else texts.first_slot
    slot, fault = given.get("slot", first), given.get("fault", True)
    ways = [key for key in ("error", "octets", "text") if key in given]
    if len(ways) != 1:
        table.fail(
            None, "a diagnosis without error, octets or text" if not ways else f"{ways[0]} and {ways[1]}", "give one"
        )
    with table.blaming(ways[0]):
        if "octets" in given:
            return _reports(bench, address, UserDiag(given["octets"], fault), given["octets"].hex(" ").upper())
        if "text" in given:
            found = _text_of(table, given["text"], texts, slot - first)
            if found.kind != "channel":
                diag = UserDiag.of(device_block(_unit_diag(found)), fault=fault)
                return _reports(bench, address, diag, found.text)
            number, cause = found.value, found.text
        else:
            number, cause = _channel_error(table, given["error"], texts, slot - first)
        way = given.get("direction", "input")
        block = channel_block(
            slot - first, given.get("channel", 0), number, size=1, input=way != "output", output=way != "input"
        )
    return _reports(bench, address, UserDiag.of(block, fault=fault), f"{block.place('', first)}: {cause}")


def _reports(bench: Bench, address: int, diag: UserDiag, words: str) -> Deed:
    deed = _of_fault(bench, address, ReportedDiagnosis(diag))
    return Deed(f"diagnosis, {words}", deed.begin)


def _unit_diag(text: DiagText) -> bytes:
    """The octets of a device related block in which ``text`` holds."""
    first, last = text.first or 0, text.last or 0
    return (text.value << first).to_bytes(last // 8 + 1, "little")


def _texts_of(texts: DiagTexts | None, module: int) -> list[DiagText]:
    return [] if texts is None else list(texts.known(module))


def _text_of(table: Table, wanted: str, texts: DiagTexts | None, module: int) -> DiagText:
    known = {text.text: text for text in _texts_of(texts, module)}
    for name, text in known.items():
        if name.lower() == wanted.lower():
            return text
    raise _unknown(table, "text", wanted, list(known), "its GSD file has no texts: give error or octets")


def _channel_error(table: Table, wanted: object, texts: DiagTexts | None, module: int) -> tuple[int, str]:
    """Number and words of a channel error, given by number, by a word of the standard, or by a text of the GSD file."""
    own = {text.text: text.value for text in _texts_of(texts, module) if text.kind == "channel"}
    known = {text: number for number, text in CHANNEL_ERRORS.items()} | own
    if isinstance(wanted, int) and not isinstance(wanted, bool):
        if not 1 <= wanted <= 31:
            table.fail("error", f"error = {wanted}", "numbers of channel errors are 1..31")
        words = {number: text for text, number in known.items()}
        return wanted, words.get(wanted, f"error {wanted}")
    for text, number in known.items():
        if text.lower() == str(wanted).lower():
            return number, text
    raise _unknown(table, "error", str(wanted), list(known), "")


def _unknown(table: Table, key: str, wanted: str, known: list[str], none: str) -> ConfigError:
    hint = f"known: {', '.join(known)}" if known else none
    hint = did_you_mean(wanted.lower(), [text.lower() for text in known], hint, quoted=True)
    return table.error(key, f"unknown {key} {wanted!r}", hint)


def _silence(_table: Table, _given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    name = bench.units[address].name

    def begin() -> End:
        bench.silence(name)

        def end() -> bool:
            bench.resume(name)
            return True

        return end

    return Deed("silence", begin)


def _power_off(_table: Table, _given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    unit = bench.units[address]

    def begin() -> End:
        bench.power(unit.name, False)

        def end() -> bool:
            was = unit.powered
            bench.power(unit.name, True)
            return not was

        return end

    return Deed("power off", begin)


def _set(table: Table, given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    """Inputs by octets or by names."""
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


def _text_or_number(table: Table, name: str, _: Key) -> object:
    value = table.raw(name)
    return value if isinstance(value, int) and not isinstance(value, bool) else table.text(name)


#: what can be done to a simulated slave
KINDS: Final[Mapping[str, Kind]] = {
    "late_answers": Kind({"by_ms": Key(0.01, 10_000, kind=float)}, _late_answers),
    "rs": Kind({"status": Key(kind=Literal["RS", "RR", "UE"])}, _rs),
    "wrong_length": Kind({"by_octets": Key(-244, 244, kind=int)}, _wrong_length),
    "noise": Kind({"rate": Key(1e-9, 0.5, kind=float), "seed": Key(0, 2**31, kind=int)}, _noise),
    "repeated_answers": Kind({}, _repeated_answers),
    "diagnosis": Kind(
        {
            "error": Key(read=_text_or_number, kind=str),
            "text": Key(kind=str),
            "octets": Key(kind=bytes),
            "slot": Key(0, 64, kind=int),
            "channel": Key(0, 63, kind=int),
            "direction": Key(kind=Literal["input", "output", "both"]),
            "fault": Key(kind=bool),
        },
        _diagnosis,
    ),
    "silence": Kind({}, _silence),
    "power_off": Kind({}, _power_off),
    "set": Kind({"inputs": Key(kind=Mapping), "octets": Key(kind=bytes)}, _set),
    "trip": Kind({"code": Key(kind=str)}, _trip, lasting=False),
}
