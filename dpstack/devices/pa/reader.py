"""Device files of PA devices read and checked: modules, slots, bits, maker's parameters."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

from dpstack.devices import keys as k
from dpstack.devices.model import Telegram, WordSpec
from dpstack.devices.pa.configurations import telegram_of
from dpstack.devices.pa.layout import INPUTS, OUTPUTS, Part, layout_of
from dpstack.devices.pa.model import FIRST_INDEX, FREE, PaFile, PaModule, PaParameter, PaSlot
from dpstack.devices.reader import DeviceFileError, Reader, file_keys
from dpstack.gsd.identifiers import MAX_IO, io_lengths
from dpstack.gsd.model import Device
from dpstack.text import brief, nearest
from dpstack.toml.table import Table, is_integer

#: tables and keys of drives and of encoders
_OTHERS_ONLY: Final = (
    "telegrams", "telegram", "only", "words", "derived", "control", "status", "orders", "obstacles", "fault", "warning",
    "reference", "channel", "settings", "map", "simulate", "address", "machine", "python", "position", "velocity",
    "preset", "diagnosis",
)  # fmt: skip
#: slots of a device: a Chk_Cfg has no more identifiers
_MOST_SLOTS: Final = 244
#: bits of CHECKBACK, octets of DIAGNOSIS_EXTENSION
_CHECKBACK_BITS: Final = 24
_EXTENSION_OCTETS: Final = 6
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
_BIT: Final = re.compile(r"([0-9]{1,2})\.([0-7])")
_TYPE: Final = re.compile(r"u8|u16|u32|i8|i16|f32|unit|(text|octets)([1-9][0-9]?)")
_BLOCK: Final = re.compile(r"(pb|tb|fb|ai|ao|di|do|tot)([0-9]{0,3})", re.IGNORECASE)
_IDENT: Final = re.compile(r"[0-9A-Fa-f]{4}")
_NUMBER: Final = re.compile(r"-?[0-9]{1,10}")
#: characters of a text and of a unit
_LONGEST: Final = 60
_UNIT: Final = 20


class PaReader(Reader):
    """Reads the file of a PA device."""

    _first_words = ("", "")
    _parts = ()
    _given_words = ()

    def _file(self, table: Table, digest: str) -> PaFile:
        for key in _OTHERS_ONLY:
            if key in table:
                self.errors.append(table.error(key, f"{key} is for drives and encoders", f"leave {key} out"))
        facts, given = self._facts(table, digest)
        found = {
            "coding": given.get("coding", "classic"),
            "modules": self._modules,
            "slots": self._slots,
            "checkback": self._checkback,
            "extension": self._extension(table),
            "profiles": {} if self._slots else self._profiles(table),
            "parameters": self._makers(table),
        }
        if self.errors:
            raise DeviceFileError(self.errors)
        file = PaFile(**facts, **found)
        default = facts["telegrams"][facts["default_telegram"]].spec
        if max(default.inputs, default.outputs) > MAX_IO:
            raise table.error("slots", f"more than the {MAX_IO} octets of a frame", "take slots or modules out")
        self._check_names(table, file)
        return file

    # -- in place of the telegrams of a drive ------------------------------------------------------------------------

    def _words(self, table: Table) -> dict[str, WordSpec]:
        return {}

    def _telegrams(
        self, table: Table, words: Mapping[str, WordSpec], device: Device | None, only: Sequence[str]
    ) -> dict[str, Telegram]:
        """The configuration of a plant file without ``modules``, as the only telegram."""
        self._modules = self._read_modules(table)
        self._slots = self._read_slots(table)
        self._checkback: dict[str, int] = {}
        with self._collected():
            self._checkback = self._bits(table, "checkback", _CHECKBACK_BITS)
        if self.errors:
            raise DeviceFileError(self.errors)
        first = next(iter(self._modules))
        chosen = [slot.module for slot in self._slots] or [first]
        while len(chosen) > 1 and chosen[-1] == FREE:
            chosen.pop()
        with table.blaming("slots"):
            spec = telegram_of([self._modules[name] for name in chosen])
        return {spec.name: Telegram(spec=spec, outputs=(), inputs=())}

    def _read_modules(self, table: Table) -> dict[str, PaModule]:
        found: dict[str, PaModule] = {}

        def read(name: str, inside: Table) -> None:
            given = inside.read(file_keys(k.PaModuleKeys))
            if "," in name or name != name.strip():
                inside.fail(
                    None, f"{brief(name)}: a comma, or a space at an end", "the names stand in a list with commas"
                )
            if not given.get("config"):
                inside.fail("config", f"the module {name} has no identifiers", 'add config = "94"')
            inputs, outputs = (
                tuple(self._part(inside, key, one, known) for one in given.get(key, ()))
                for key, known in (("in", INPUTS), ("out", OUTPUTS))
            )
            with inside.blaming("config"):
                declared = io_lengths(given["config"])
            sizes = tuple(sum(part.octets for part in way) for way in (inputs, outputs))
            if declared != sizes:
                inside.fail(
                    "config",
                    f"the identifiers have {declared[0]} octets of inputs and {declared[1]} of outputs, the parts have "
                    f"{sizes[0]} and {sizes[1]}",
                    "correct config, in or out",
                )
            names = {
                "inputs": tuple(part.name for part in inputs),
                "outputs": tuple(part.name for part in outputs),
            }
            found[name] = PaModule(name=name, block=given.get("block", ""), config=given["config"], **names)

        self._members(table, "modules", read)
        if not found and not self.errors:
            self.errors.append(table.error("modules", "no module", 'write base = "pa", which has those of the profile'))
        return found

    def _part(self, table: Table, key: str, name: str, known: Mapping[str, Part]) -> Part:
        if name not in known:
            near = nearest(name, known)
            hint = f"did you mean {near!r}?" if near else f"it must be {', '.join(known)}"
            table.fail(key, f"{key}: {brief(name)} is no part of a module", hint)
        return known[name]

    def _read_slots(self, table: Table) -> tuple[PaSlot, ...]:
        found: dict[int, PaSlot] = {}

        def read(name: str, inside: Table) -> None:
            if not name.isdecimal() or not 0 < int(name) <= _MOST_SLOTS:
                inside.fail(None, f"slot {brief(name)}", f"slots are numbers of 1..{_MOST_SLOTS}: [slots.1]")
            found[int(name)] = self._slot(inside, int(name))

        self._members(table, "slots", read)
        numbers = sorted(found)
        if numbers and not self.errors and numbers != list(range(1, len(numbers) + 1)):
            missing = next(number for number in range(1, numbers[-1]) if number not in found)
            self.errors.append(
                table.error("slots", f"no slot {missing}", f"add [slots.{missing}]; {{}} is a free place")
            )
        return tuple(found[number] for number in numbers)

    def _slot(self, table: Table, number: int) -> PaSlot:
        given = table.read(file_keys(k.PaSlotKeys))
        block = given.get("block", "")
        name = given.get("name", f"{block.lower() or 'slot'}{number}")
        if not _NAME.fullmatch(name):
            table.fail("name", f"name = {brief(name)}", "write letters, digits and _, a letter first")
        names = given.get("modules")
        if names is None:
            names = [one.name for one in self._modules.values() if one.block == block and one.block]
            names += [FREE] if FREE in self._modules else []
        for one in names:
            if one not in self._modules:
                near = nearest(one, self._modules)
                hint = f"did you mean {near!r}?" if near else f"there are {', '.join(self._modules)}"
                table.fail("modules", f"modules: {brief(one)} is no module", hint)
        if not names:
            table.fail("modules", f"slot {number} has no module", "give modules")
        module = given.get("module", names[0])
        if module not in names:
            table.fail("module", f"module = {brief(module)} is none of its modules", f"it has {', '.join(names)}")
        at = given.get("at", [number, FIRST_INDEX])
        if not isinstance(at, list) or len(at) != 2 or not all(is_integer(one) and 0 <= one <= 254 for one in at):
            table.fail("at", f"at = {brief(at)}", "give slot and index of the block object, [1, 16]")
        if len(unit := given.get("unit", "")) > _UNIT or not unit.isprintable() or set(unit) & set("[]"):
            table.fail("unit", f"unit = {brief(unit)}", f"at most {_UNIT} characters, without brackets")
        return PaSlot(
            number=number,
            block=block,
            name=name,
            title=given.get("title", ""),
            unit=unit,
            modules=tuple(names),
            module=module,
            words=self._numbered_texts(table, "words"),
            block_slot=at[0],
            block_index=at[1],
            source=given.get("source", ""),
        )

    def _check_names(self, table: Table, file: PaFile) -> None:
        """No two slots have values of the same name."""
        named: dict[str, int] = {}
        for slot in file.slots:
            if named.setdefault(slot.name, slot.number) != slot.number:
                raise table.error(
                    "slots", f"slots {named[slot.name]} and {slot.number} are both called {slot.name}", "rename one"
                )
        layout_of(file, [file.modules[slot.module] for slot in file.slots])

    # -- bits, texts and parameters ------------------------------------------------------------------------------------

    def _numbered_texts(self, table: Table, key: str) -> dict[int, str]:
        """Texts by numbers."""
        if table.raw(key) is None:
            return {}
        inside, found = table.table(key), {}
        for number in inside:
            text = inside.text(number)
            if not _NUMBER.fullmatch(number) or not _is_short(text):
                todo = f'write a number and up to {_LONGEST} characters, 1 = "on"'
                inside.fail(number, f"{brief(number)} = {brief(text)}", todo)
            found[int(number)] = text
        return found

    def _extension(self, table: Table) -> dict[int, str]:
        found: dict[int, str] = {}
        if table.raw("extension") is None:
            return found
        with self._collected():
            inside = table.table("extension")
            for place in inside:
                match, text = _BIT.fullmatch(place), inside.text(place)
                if match is None or int(match[1]) >= _EXTENSION_OCTETS or not _is_short(text):
                    inside.fail(
                        place,
                        f"{brief(place)} = {brief(text)} is no bit of DIAGNOSIS_EXTENSION with its text",
                        f'write "OCTET.BIT" from "0.0" to "{_EXTENSION_OCTETS - 1}.7", and up to {_LONGEST} characters',
                    )
                found[8 * int(match[1]) + int(match[2])] = text
        return found

    def _profiles(self, table: Table) -> dict[int, tuple[str, ...]]:
        found: dict[int, tuple[str, ...]] = {}
        if table.raw("profiles") is None:
            return found
        with self._collected():
            inside = table.table("profiles")
            for ident in inside:
                names = inside.raw(ident)
                if not _IDENT.fullmatch(ident) or not isinstance(names, list) or not names:
                    inside.fail(ident, f"{brief(ident)} = {brief(names)}", 'write "9701" = ["AI", "AI"]')
                if wrong := [one for one in names if one not in self._modules]:
                    inside.fail(ident, f"{brief(wrong[0])} is no module", f"there are {', '.join(self._modules)}")
                found[int(ident, 16)] = tuple(names)
        return found

    def _makers(self, table: Table) -> dict[str, PaParameter]:
        found: dict[str, PaParameter] = {}

        def read(name: str, inside: Table) -> None:
            given: dict[str, Any] = inside.read(file_keys(k.PaParameterKeys))
            if not _NAME.fullmatch(name):
                inside.fail(None, f"{brief(name)} is no name", "write letters, digits and _, a letter first")
            by_block, by_slot = ({*pair} & {*given} for pair in (("block", "relative"), ("slot", "index")))
            if (len(by_block), len(by_slot)) not in ((2, 0), (0, 2)):
                inside.fail(None, f"{name} has no place", "give block and relative, or slot and index")
            if "block" in given and not _BLOCK.fullmatch(given["block"]):
                inside.fail("block", f"block = {brief(given['block'])}", 'write "pb", "ai1", "tb1" ...')
            if not _TYPE.fullmatch(given.get("type", "u8")):
                inside.fail("type", f"type = {brief(given['type'])}", 'write u8, u16, f32, "text16", "octets6" ...')
            given["words"] = self._numbered_texts(inside, "words")
            found[name] = PaParameter(name=name, **given)

        self._members(table, "parameters", read)
        return found


def _is_short(text: str) -> bool:
    return bool(text) and len(text) <= _LONGEST and text.isprintable()
