"""Device files of encoders read and checked: position, velocity, preset, diagnosis."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

from dpstack.devices import keys as k
from dpstack.devices.model import ENCODER_PARTS, EncoderFile, WordSpec
from dpstack.devices.reader import DeviceFileError, Reader
from dpstack.text import brief
from dpstack.toml.table import Table, is_integer, keys_of

#: tables of drives
_DRIVES_ONLY: Final = (
    "derived", "control", "status", "orders", "obstacles", "fault", "warning", "reference", "channel", "parameters",
    "settings", "simulate", "address", "machine", "python",
)  # fmt: skip
#: where a number stands in the user parameters
PARAMETER: Final = "prm:"
PLACE: Final = re.compile(r"u(8|16|32)@([0-9]{1,3})")
_UNITS: Final = ("counts/s", "rpm")
#: the octet that a diagnosis of the profile for encoders begins its numbers with, the header of the block
_HEADER: Final = 7
_BIT: Final = re.compile(r"([0-9]{1,3})\.([0-7])")
_LAST_OCTET: Final = 244


class EncoderReader(Reader):
    """Reads the file of an encoder."""

    _first_words = ("", "")
    _parts = ENCODER_PARTS
    _given_words = ()

    def _file(self, table: Table, digest: str) -> EncoderFile:
        facts, _ = self._facts(table, digest)
        for key in _DRIVES_ONLY:
            if key in table:
                self.errors.append(table.error(key, f"{key} is for drives", f"leave {key} out"))
        found = {
            **facts,
            **self._position(table),
            **self._velocity(table),
            **self._preset(table, facts["words"]),
            **self._diagnosis(table),
        }
        for name, word in facts["words"].items():
            if word.width > 8 * word.octets:
                self.errors.append(
                    table.error("words", f"{name}: width = {word.width}", f"{word.type} has {8 * word.octets} bits")
                )
        if self.errors:
            raise DeviceFileError(self.errors)
        file = EncoderFile(**found)
        for name, telegram in file.telegrams.items():
            if file.part(name, "position") is None:
                raise table.error("telegrams", f"telegram {name} has no position", 'write in = ["position"]')
            for way in (telegram.inputs, telegram.outputs):
                parts = [file.words[word].part for word in way if isinstance(word, str)]
                twice = next((part for part in ENCODER_PARTS if parts.count(part) > 1), None)
                if twice is not None:
                    raise table.error("telegrams", f"telegram {name} has two words of {twice}", "leave one out")
        return file

    def _position(self, table: Table) -> dict[str, Any]:
        found: dict[str, Any] = {}
        if table.raw("position") is None:
            return found
        with self._collected():
            inside = table.table("position")
            given = inside.read(keys_of(k.PositionKeys))
            for key in ("counts_per_turn", "range"):
                if key in given:
                    found[key] = self._ways_to(inside, key, given[key])
            if "only_if" in given:
                wanted = inside.table("only_if")
                found["only_if"] = {name: wanted.integer(name, -0x8000_0000, 0xFFFF_FFFF) for name in wanted}
        return found

    def _ways_to(self, table: Table, key: str, given: object) -> tuple[int | str, ...]:
        """The ways to a number, as ``counts_per_turn`` has them."""
        ways = given if isinstance(given, list) else [given]
        for one in ways:
            number = isinstance(one, int) and is_integer(one) and 1 <= one <= 1 << 32
            text = isinstance(one, str) and (one.startswith(PARAMETER) or PLACE.fullmatch(one))
            if not number and not text:
                table.fail(key, f"{key} = {brief(one)}", 'give a number above 0, "prm:NAME" or "u16@4"')
        return tuple(ways)

    def _velocity(self, table: Table) -> dict[str, Any]:
        found: dict[str, Any] = {}
        if table.raw("velocity") is None:
            return found
        with self._collected():
            inside = table.table("velocity")
            given = inside.read(keys_of(k.VelocityKeys))
            if not given.get("scale", 1):
                inside.fail("scale", "scale = 0 makes all values equal", "give the value of one count")
            found["velocity"] = (given.get("scale", 1), given.get("unit", _UNITS[0]))
            by = given.get("by", "")
            if by and not by.startswith(PARAMETER):
                inside.fail("by", f"by = {brief(by)} is no user parameter", 'write by = "prm:NAME"')
            if bool(by) is not ("units" in given):
                inside.fail("by", "by and units go together", "give both, or none of them")
            found["velocity_by"] = by.removeprefix(PARAMETER)
            units: dict[int, tuple[float, str]] = {}
            if by:
                rows = inside.table("units")
                for number in rows:
                    row = rows.raw(number)
                    if not number.isdecimal() or not isinstance(row, list) or len(row) != 2 or row[1] not in _UNITS:
                        rows.fail(number, f"{number} = {brief(row)}", 'write scale and unit, 1 = [10, "counts/s"]')
                    if isinstance(row[0], bool) or not isinstance(row[0], (int, float)) or not row[0]:
                        rows.fail(number, f"scale = {brief(row[0])}", "give the value of one count, not 0")
                    units[int(number)] = (row[0], row[1])
            found["velocities"] = units
        return found

    def _preset(self, table: Table, words: Mapping[str, WordSpec]) -> dict[str, Any]:
        if table.raw("preset") is None:
            return {}
        with self._collected():
            inside = table.table("preset")
            given = inside.read(keys_of(k.PresetKeys))
            bits = [bit for word in words.values() if word.part == "position" for bit in word.bits]
            done = given.get("done", "position")
            if done not in ("position", "time", *bits):
                inside.fail("done", f"done = {brief(done)}", f"it must be {', '.join(('position', 'time', *bits))}")
            return {f"preset_{key}": value for key, value in given.items()}
        return {}

    def _diagnosis(self, table: Table) -> dict[str, Any]:
        found: dict[str, Any] = {}
        if table.raw("diagnosis") is None:
            return found
        with self._collected():
            inside = table.table("diagnosis")
            given = inside.read(keys_of(k.DiagnosisKeys))
            for key in ("alarms", "warnings"):
                if key in given:
                    found[key] = self._bit_texts(inside.table(key))
            last = max((bit // 8 for texts in found.values() for bit in texts), default=0)
            found["diagnosis_octets"] = given.get("octets", _HEADER + 1 + last)
            if found["diagnosis_octets"] <= _HEADER + last:
                inside.fail("octets", f"octets = {given['octets']}", f"its bits reach to octet {_HEADER + 1 + last}")
        return found

    def _bit_texts(self, table: Table) -> dict[int, str]:
        texts: dict[int, str] = {}
        for place in table:
            match = _BIT.fullmatch(place)
            if match is None or not _HEADER < int(match[1]) <= _LAST_OCTET:
                table.fail(place, f"{brief(place)} is no bit of the diagnosis", 'write "OCTET.BIT", "8.4" for instance')
            texts[8 * (int(match[1]) - _HEADER - 1) + int(match[2])] = table.text(place)
        return texts
