"""Diagnoses of simulated slaves, as tables name them: ``what = "slot 3 channel 0 line break"``, or by keys."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final, Literal

from dpstack.api.slave_side.virtual_bench import SimulatedSlave
from dpstack.dp.pdu.alarm_blocks import ModuleState
from dpstack.dp.pdu.diag_blocks import CHANNEL_ERRORS, SIZES, UserDiag, channel_block
from dpstack.dp.pdu.diag_texts import first_slot_of
from dpstack.dp.slot_map import Slot, slot_map
from dpstack.errors import ConfigError
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.model import DiagText
from dpstack.sim.reported_diagnosis import Reported, ReportedOctets, SlotDiagnosis, TextDiagnosis
from dpstack.text import did_you_mean
from dpstack.toml.table import Key, Table

#: "slot 3 channel 0 line break", also as a diagnosis is shown: "slot 3 (2 AI), input channel 0 (word): line break"
_WHAT: Final = re.compile(
    r"slot\s+(?P<slot>\d{1,4})(\s*\([^)]*\))?[\s,:]+"
    r"((?P<direction>in/output|input|output)\s+)?(channel\s+(?P<channel>\d{1,4})(\s*\((?P<size>[\w ]+)\))?[\s,:]+)?"
    r"(?P<cause>.+)",
    re.IGNORECASE,
)
_NUMBER: Final = re.compile(r"(?:error\s+)?(\d{1,4})", re.IGNORECASE)
_STATES: Final = {state.text: state for state in ModuleState}
#: the size of a channel by its bits; 0: not known
_SIZE_OF: Final = {0: "unspecific", 1: "bit", 16: "word"}


def _text_or_number(table: Table, name: str, _: Key) -> object:
    value = table.raw(name)
    return value if isinstance(value, int) and not isinstance(value, bool) else table.text(name)


KEYS: Final[Mapping[str, Key]] = {
    "what": Key(kind=str),
    "error": Key(read=_text_or_number, kind=str),
    "text": Key(kind=str),
    "octets": Key(kind=bytes),
    "slot": Key(0, 244, kind=int),
    "channel": Key(0, 63, kind=int),
    "direction": Key(kind=Literal["input", "output", "both"]),
    "size": Key(kind=Literal["unspecific", "bit", "2 bits", "4 bits", "byte", "word", "2 words"]),
    "state": Key(kind=Literal["ok", "data invalid", "wrong module", "no module"]),
    "fault": Key(kind=bool),
    "alarm": Key(kind=bool),
    "over": Key(kind=bool),
}
#: keys that say what is wrong, and those that go with a slot only
_WAYS: Final = ("what", "error", "text", "octets", "state")
_OF_SLOT: Final = ("slot", "channel", "direction", "size", "state", "alarm")
_OF_CHANNEL: Final = ("channel", "direction", "size")


def read_diagnosis(table: Table, given: Mapping[str, Any], unit: SimulatedSlave) -> Reported:
    """The diagnosis of the keys ``given``. Raises ConfigError."""
    keys = dict(given)
    ways = [key for key in _WAYS if key in keys and not (key == "state" and len(keys.keys() & set(_WAYS)) > 1)]
    if len(ways) != 1:
        what = f"{ways[0]} and {ways[1]}" if ways else "a diagnosis without what, error, text, octets or state"
        table.fail(None, what, 'give one, for instance what = "slot 3 channel 0 line break"')
    way: str = ways[0]
    texts = unit.config.params.texts
    if way == "octets":
        _leave_out(table, keys, _OF_SLOT, "octets are sent as they are")
        return ReportedOctets(UserDiag(keys["octets"], keys.get("fault", True)))
    if way == "what":
        way, keys = _said(table, keys)
    first = first_slot_of(texts)
    plan = slot_map(unit.config.params.config, texts)
    slot = keys.get("slot", first)
    place = plan.slot(slot)
    if place is None:
        what = f"{unit.who} has no slot {slot}"
        table.fail("slot" if "slot" in table else ways[0], what, f"it has {plan.range_text}; octets can say others")
    number = slot - first
    with table.blaming(ways[0]):
        if way == "text":
            found, kind = _text_of(table, ways[0], keys["text"], texts, number)
            if found.kind != "channel":
                _leave_out(table, keys, _OF_SLOT, f"{found.text!r} is a text of the device, not of a channel")
                assert texts is not None
                return _device_text(table, ways[0], TextDiagnosis(found.text, found, texts, kind), unit, keys)
            keys["error"] = found.value
        if "error" in keys:
            error, cause = _channel_error(table, ways[0], keys["error"], texts, number)
            direction, size = _channel(place, keys)
            block = channel_block(
                number,
                keys.get("channel", 0),
                error,
                size=SIZES.index(size),
                input=direction != "output",
                output=direction != "input",
            )
            words, state = f"{block.place('', first)}: {cause}", keys.get("state", ModuleState.INVALID.text)
        else:
            _leave_out(table, keys, _OF_CHANNEL, "a state is that of a module: add an error, or leave it out")
            block, state = None, keys["state"]
            words = f"slot {slot}: {state}"
    if keys.get("alarm") and unit.device.alarm_server is None:
        table.fail("alarm", f"{unit.who} raises no alarms: its device has no DP-V1", "leave alarm out")
    return SlotDiagnosis(
        words,
        slot,
        number,
        len(plan.slots),
        state=_STATES[state],
        channel=block,
        fault=keys.get("fault", True),
        alarm=keys.get("alarm", False),
    )


def _leave_out(table: Table, keys: Mapping[str, Any], names: tuple[str, ...], why: str) -> None:
    for name in names:
        if name in keys:
            table.fail(name, f"{name}, and {why}", f"leave {name} out")


def _said(table: Table, given: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """The keys that the words of ``what`` stand for, and which of them says what is wrong."""
    _leave_out(table, given, ("slot", "channel"), "what says it")
    text = given.pop("what")
    found = _WHAT.fullmatch(text.strip())
    if found is None:
        return "text", given | {"text": text}
    keys = given | {"slot": int(found["slot"])}
    if found["direction"]:
        keys["direction"] = {"in/output": "both"}.get(found["direction"].lower(), found["direction"].lower())
    if found["size"]:
        keys["size"] = found["size"].lower()
        if keys["size"] not in SIZES:
            table.fail("what", f"unknown size {found['size']!r}", f"it is one of {', '.join(SIZES)}")
    cause = found["cause"].strip()
    if found["channel"] is not None:
        channel = int(found["channel"])
        if channel > 63:
            table.fail("what", f"channel {channel}", "channels are 0..63")
        return "error", keys | {"channel": channel, "error": cause}
    if cause.lower() not in _STATES:
        known = ", ".join(_STATES)
        todo = did_you_mean(cause.lower(), list(_STATES), f"known: {known}; or slot 3 channel 0 {cause}", quoted=True)
        table.fail("what", f"unknown state {cause!r} of a module", todo)
    return "state", keys | {"state": cause.lower()}


def _channel(slot: Slot, keys: Mapping[str, Any]) -> tuple[str, str]:
    """Direction and size of a channel: as given, or as the slot has them."""
    ins, outs = slot.inputs, slot.outputs
    direction = keys.get("direction") or (
        "output" if outs.octets and not ins.octets else "both" if outs.octets else "input"
    )
    area = outs if direction == "output" else ins
    return direction, keys.get("size") or _SIZE_OF[area.width]


def _device_text(
    table: Table, key: str, report: TextDiagnosis, unit: SimulatedSlave, keys: Mapping[str, Any]
) -> TextDiagnosis:
    if unit.config.params.dpv1 is not None and not report.fits_dpv1:
        table.fail(
            key,
            f"{report.words!r} is said by bits that no alarm and no status of DP-V1 can have",
            "give dpv1 = false to the slave, or take another text",
        )
    return TextDiagnosis(report.words, report.wanted, report.texts, report.type, keys.get("fault", True))


def _text_of(table: Table, key: str, wanted: str, texts: DiagTexts | None, module: int) -> tuple[DiagText, int | None]:
    """The text of the GSD file, and the UnitDiagType that it belongs to."""
    known = {} if texts is None else {text.text: (text, kind) for text, kind in texts.all_known(module)}
    for name, found in known.items():
        if name.lower() == wanted.lower():
            return found
    raise _unknown(table, key, "text", wanted, list(known), "its GSD file has no texts: give error or octets")


def _channel_error(table: Table, key: str, wanted: object, texts: DiagTexts | None, module: int) -> tuple[int, str]:
    """Number and words of a channel error, given by number, by a word of the standard, or by a text of the GSD file."""
    found = () if texts is None else texts.known(module)
    own = {text.text: text.value for text in found if text.kind == "channel"}
    known = {text: number for number, text in CHANNEL_ERRORS.items()} | own
    digits = _NUMBER.fullmatch(wanted.strip()) if isinstance(wanted, str) else None
    if digits is not None:
        wanted = int(digits[1])
    if isinstance(wanted, int) and not isinstance(wanted, bool):
        if not 1 <= wanted <= 31:
            table.fail(key, f"error = {wanted}", "numbers of channel errors are 1..31")
        words = {number: text for text, number in known.items()}
        return wanted, words.get(wanted, f"error {wanted}")
    for text, number in known.items():
        if text.lower() == str(wanted).lower():
            return number, text
    raise _unknown(table, key, "error", str(wanted), list(known), "")


def _unknown(table: Table, key: str, what: str, wanted: str, known: list[str], none: str) -> ConfigError:
    hint = f"known: {', '.join(known)}" if known else none
    hint = did_you_mean(wanted.lower(), [text.lower() for text in known], hint, quoted=True)
    return table.error(key, f"unknown {what} {wanted!r}", hint)
