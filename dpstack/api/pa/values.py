"""Parameters of a device with value, unit, quality and words; values as users type them."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Final, NamedTuple

from msgspec import Struct, structs

from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.errors import PduError, UsageError
from dpstack.pa.datatypes import ParameterValue, Scalar, datatype, encode_value, parse_value
from dpstack.pa.diagnosis import checkback_words, diagnosis_words, extension_words
from dpstack.pa.parameters import Group, Target, channel_target
from dpstack.pa.units import find_unit, unit_name
from dpstack.pa.walk import Layout
from dpstack.pa.words import (
    CODES,
    alarm_words,
    code_hint,
    code_word,
    feature_words,
    find_code,
    find_mode,
    maker_name,
    mode_words,
)
from dpstack.plant.quality import Quality, Reason
from dpstack.plant.status_octet import CLASSIC, read_status
from dpstack.text import brief, octets_in_words

#: digits that tell any two floating point numbers of 32 bits apart
_MOST_DIGITS: Final = 9
#: those that people see: 32 bits hold no more
_SHOWN_DIGITS: Final = 7
_NO_NUMBER: Final = "not a number"


class PaValue(Struct, frozen=True):
    """A parameter of a device as read. ``name``: ``ai1.out``; ``octets``: as the device sent them.

    ``value``: a number, a text, octets, or the elements of a structure by name; None if it cannot be read:
    ``unreadable`` is the reason then. ``unit``: its symbol, empty without one. ``text``: value, unit, and the status
    in words. ``quality``: by its status octet; None without one.
    """

    name: str
    slot: int
    index: int
    type: str
    access: str
    group: Group
    value: ParameterValue | None = None
    unit: str = ""
    text: str = ""
    quality: Quality | None = None
    octets: bytes = b""
    unreadable: str | None = None

    def as_dict(self) -> dict[str, object]:
        """Plain data for JSON: octets as hex, NaN and infinity as null."""
        plain: dict[str, object] = {
            "name": self.name,
            "slot": self.slot,
            "index": self.index,
            "type": self.type,
            "access": self.access,
            "group": self.group.value,
        }
        if self.unreadable is not None:
            return plain | {"unreadable": self.unreadable}
        quality = {} if self.quality is None else {"quality": self.quality.value}
        return plain | {"value": _plain(self.value), "unit": self.unit, "text": self.text} | quality


def _plain(value: ParameterValue | None) -> object:
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float):
        return shortest(value) if math.isfinite(value) else None
    return value


def shortest(number: float) -> float:
    """``number``, read from 32 bits, with as few digits as these have: 0.1 in place of 0.10000000149."""
    if not math.isfinite(number):
        return number
    for digits in range(6, _MOST_DIGITS):
        rounded = float(f"{number:.{digits}g}")
        if _is_f32(rounded, number):
            return rounded
    return number


def _is_f32(number: float, same: float) -> bool:
    try:
        return struct.pack(">f", number) == struct.pack(">f", same)
    except OverflowError:
        return False


class Meaning(NamedTuple):
    """Facts about the device that the words of its values need.

    ``coding``: of its status octets, one of :data:`dpstack.plant.status_octet.TABLES`; ``extension``: texts of the
    bits of DIAGNOSIS_EXTENSION, from 1.
    """

    layout: Layout
    coding: str = CLASSIC
    extension: Mapping[int, str] = {}


def value_of(target: Target, octets: bytes, meaning: Meaning, unit: str = "") -> PaValue:
    """The parameter ``target``, which the device sends as ``octets``; of an element that element alone.

    A parameter with another number of octets than its type has is unreadable, with that reason.
    """
    head = (target.name, target.slot, target.index, target.kind or "octets", target.access, target.group)
    try:
        whole = parse_value(target.kind, octets) if target.kind else octets
    except PduError as error:
        return PaValue(*head, octets=octets, unreadable=f"{error} ({octets.hex(' ') or 'empty'})")
    value, shown = whole, target
    if target.element is not None:
        assert isinstance(whole, Mapping)
        value = whole[target.element]
        kind = dict(datatype(target.kind).elements)[target.element]
        head = (*head[:3], kind, *head[4:])
        shown = structs.replace(target, kind=kind)
    quality, text = _in_words(shown, value, meaning, unit)
    return PaValue(*head, value=value, unit=unit, text=text, quality=quality, octets=octets)


def missing(target: Target, why: str) -> PaValue:
    """``target``, which cannot be read: ``why``."""
    return PaValue(
        target.name, target.slot, target.index, target.kind or "octets", target.access, target.group, unreadable=why
    )


# --- in words -------------------------------------------------------------------------------------------------------


def _in_words(target: Target, value: ParameterValue, meaning: Meaning, unit: str) -> tuple[Quality | None, str]:
    """Quality and words of a value."""
    if isinstance(value, Mapping):
        return _structure(target, value, meaning, unit)
    if isinstance(value, bytes):
        return None, _octets_in_words(target, value, meaning)
    return None, _scalar(target, value, meaning, unit)


def _scalar(target: Target, value: Scalar, meaning: Meaning, unit: str) -> str:
    if isinstance(value, str):
        return value
    if target.kind == "unit" and isinstance(value, int):
        return unit_name(value) or f"no unit ({value})"
    if isinstance(value, int):
        return _whole(target, value, meaning) + (f" {unit}" if unit else "")
    assert isinstance(value, float)
    return with_unit(value, unit)


def with_unit(value: float, unit: str) -> str:
    """``23.5 °C``."""
    if not math.isfinite(value):
        return _NO_NUMBER
    return f"{value:.{_SHOWN_DIGITS}g}" + (f" {unit}" if unit else "")


def _whole(target: Target, value: int, meaning: Meaning) -> str:
    if target.makers is not None:
        word = target.makers.words.get(value)
        return str(value) if word is None else f"{word} ({value})"
    match target.parameter:
        case "target_mode":
            return mode_words(value)
        case "device_man_id":
            return f"{maker_name(value)} ({value})"
        case "channel":
            source = channel_target(meaning.layout, value)
            return str(value) if source is None else f"{source.name} ({value})"
    name = code_name(target)
    return f"{code_word(name, value)} ({value})" if name in CODES else str(value)


def code_name(target: Target) -> str:
    """The enumeration of a parameter, as :data:`dpstack.pa.words.CODES` calls it."""
    if target.parameter == "fsafe_type" and target.block is not None and target.block.short in ("AO", "DO"):
        return "FSAFE_TYPE_OUTPUT"
    if target.parameter in ("simulate", "pos_d"):
        return "POS_D" if target.parameter == "pos_d" else "SIMULATE_ENABLED" if target.element == "enabled" else ""
    return target.parameter.upper()


def _octets_in_words(target: Target, value: bytes, meaning: Meaning) -> str:
    match target.parameter:
        case "diagnosis":
            return "; ".join(diagnosis_words(value)) or "nothing to report"
        case "diagnosis_extension":
            return "; ".join(extension_words(value, meaning.extension)) or "nothing to report"
        case "check_back":
            return "; ".join(checkback_words(value)) or "nothing to report"
        case "supported" | "enabled":
            return "; ".join(feature_words(value)) or "none"
    if len(value) >= MAX_RECORD:
        return f"{octets_in_words(value)} ({len(value)} octets, as many as a read carries: it may go on)"
    return octets_in_words(value) if value else "empty"


def _structure(target: Target, value: Mapping[str, Scalar], meaning: Meaning, unit: str) -> tuple[Quality | None, str]:
    match target.kind:
        case "block" if target.block is not None:
            one = target.block.object
            return None, f"{target.block.kind.words}; profile {one.revision}, {one.parameters} parameters"
        case "alarm" if not value["state"] and not value["unacknowledged"]:
            return None, "none"
        case "value" | "value_d":
            return _with_status(target, value, meaning, unit)
        case "range":
            return None, _range(value, unit)
        case "scaling":
            return None, _range(value, unit_name(int(value["unit"])))
        case "mode":
            actual, permitted, normal = (mode_words(int(one)) for one in value.values())
            return None, f"{actual} (normal {normal}; permitted {permitted})"
        case "alarm_sum":
            current = value["current"]
            assert isinstance(current, bytes)
            return None, "; ".join(alarm_words(current)) or "none"
        case "simulate" | "simulate_d":
            if not value["enabled"]:
                return None, "off"
            _, text = _with_status(target, value, meaning, unit)
            return None, f"on: {text}"
        case "feature":
            enabled, supported = value["enabled"], value["supported"]
            assert isinstance(enabled, bytes)
            assert isinstance(supported, bytes)
            on, able = feature_words(enabled), feature_words(supported)
            more = "; ".join(one for one in able if one not in on)
            return None, f"{'; '.join(on) or 'none'} in force" + (f" (possible: {more})" if more else "")
    return None, ", ".join(f"{name} {_element(one)}" for name, one in value.items())


def _element(value: Scalar) -> str:
    if isinstance(value, bytes):
        return value.hex(" ")
    return with_unit(value, "") if isinstance(value, float) else str(value)


def _range(value: Mapping[str, Scalar], unit: str) -> str:
    low, high = (with_unit(float(value[name]), "") for name in ("eu_0", "eu_100"))
    return f"{low} to {high}" + (f" {unit}" if unit else "")


def _with_status(target: Target, value: Mapping[str, Scalar], meaning: Meaning, unit: str) -> tuple[Quality, str]:
    number, status = value["value"], int(value["status"])
    shown = _scalar(structs.replace(target, kind="u8" if isinstance(number, int) else "f32"), number, meaning, unit)
    found = read_status(meaning.coding, status)
    reason = Reason.NOT_A_NUMBER if isinstance(number, float) and not math.isfinite(number) else found.reason
    if reason is Reason.GOOD:
        return Quality.GOOD, shown
    why, quality = found.text or reason.text, reason.quality.value
    return reason.quality, f"{shown}, {why}" if why.startswith(quality) else f"{shown}, {quality}: {why}"


# --- as typed -------------------------------------------------------------------------------------------------------


def octets_to_write(target: Target, given: object, before: bytes) -> bytes:
    """The octets of ``target`` with ``given``: a value of its type, or as somebody types it.

    Words stand for codes, modes and units; a structure may be given as a mapping of some of its elements, the others
    are kept as in ``before``, the octets of the parameter now. Raises UsageError if it does not fit.
    """
    if not target.kind:
        return _hex(target, given, len(before))
    kind = datatype(target.kind)
    try:
        if target.element is not None:
            old = _elements_of(target, before)
            element = dict(kind.elements)[target.element]
            return encode_value(target.kind, {**old, target.element: _scalar_of(target, element, given)})
        if not kind.elements:
            return encode_value(target.kind, _scalar_of(target, target.kind, given))
        changes = _changes(target, given)
        old = _elements_of(target, before)
        kinds = dict(kind.elements)
        for name, one in changes.items():
            if name not in kinds:
                raise UsageError(f"no element {brief(name)}: it has {', '.join(kinds)}")
            old[name] = _scalar_of(structs.replace(target, element=name), kinds[name], one)
        return encode_value(target.kind, old)
    except UsageError as error:
        raise UsageError(f"{target.name} = {_given_text(given)}: {error}") from None


def _given_text(given: object) -> str:
    return given if isinstance(given, str) and given.isprintable() and len(given) < 40 else brief(given)


def _elements_of(target: Target, before: bytes) -> dict[str, Scalar]:
    try:
        old = parse_value(target.kind, before)
    except PduError as error:
        raise UsageError(f"its other elements cannot be kept: the device sends {error}") from None
    assert isinstance(old, Mapping)
    return dict(old)


def _changes(target: Target, given: object) -> Mapping[str, object]:
    if isinstance(given, Mapping):
        return given
    names = [name for name, _ in datatype(target.kind).elements]
    if isinstance(given, str):
        parts = [part.partition("=") for part in given.split()]
        if parts and all(equals for _, equals, _ in parts):
            return {name.strip().lower(): value for name, _, value in parts}
    example = " ".join(f"{name}=..." for name in names[:2])
    raise UsageError(f"it has the elements {', '.join(names)}: write {example}, or {target.name}.{names[0]} alone")


def _hex(target: Target, given: object, length: int) -> bytes:
    data = given
    if isinstance(given, str):
        try:
            data = bytes.fromhex(given)
        except ValueError:
            data = None
    if not isinstance(data, bytes) or not data:
        raise UsageError(f"{target.name} has no known type: write its octets as 00FF")
    if len(data) != length:
        raise UsageError(f"{target.name} has {length} octets, {len(data)} are given")
    return data


def _scalar_of(target: Target, kind: str, given: object) -> Scalar:
    """``given`` as data type ``kind``; texts are words, numbers, hex digits. Raises UsageError."""
    if not isinstance(given, str):
        if isinstance(given, bool) or not isinstance(given, int | float | bytes):
            raise UsageError(f"{brief(given)} is neither a number nor a text nor octets")
        return given
    if kind.startswith("text"):
        return given
    if kind.startswith("octets"):
        try:
            return bytes.fromhex(given)
        except ValueError:
            raise UsageError("octets are written as 00FF") from None
    if kind == "f32":
        return _float(given)
    return _whole_of(target, kind, given)


def _float(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise UsageError("a number is wanted, for instance 2.5") from None


def _whole_of(target: Target, kind: str, text: str) -> int:
    try:
        return int(text, 0)
    except ValueError:
        pass
    found, hint = None, "a whole number is wanted"
    if kind == "unit":
        found, hint = find_unit(text), "no unit of the profile: write its symbol, for instance mbar, or its code"
    elif target.parameter == "target_mode":
        found, hint = find_mode(text), "no mode: write AUTO, MAN, O/S, CAS or RCAS"
    elif target.makers is not None:
        words = {word.lower(): code for code, word in target.makers.words.items()}
        found, hint = (
            words.get(text.strip().lower()),
            f"possible: {', '.join(target.makers.words.values()) or 'numbers'}",
        )
    elif code_name(target) in CODES:
        found, hint = find_code(code_name(target), text), code_hint(code_name(target), text)
    if found is None:
        raise UsageError(hint)
    return found
