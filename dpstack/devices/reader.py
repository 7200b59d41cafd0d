"""Device files read and checked: every mistake by line, with a remedy. The bases are files of the same form."""

from __future__ import annotations

import csv
import errno
import functools
import hashlib
import os
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeVar

from msgspec import structs

from dpstack.devices import keys as k
from dpstack.devices.maps import MapWay, read_maps
from dpstack.devices.model import (
    NORMALISED,
    PARTS,
    PLACE,
    TYPES,
    WAY,
    BusFacts,
    Channel,
    Derived,
    DeviceFile,
    Example,
    FileFacts,
    Message,
    Messages,
    Obstacle,
    OwnOrder,
    Reference,
    SettingSpec,
    Simulation,
    Step,
    Telegram,
    WordSpec,
    counts_of,
    filled,
)
from dpstack.errors import ConfigError, GsdError
from dpstack.gsd.identifiers import io_lengths
from dpstack.gsd.text import MAX_OCTETS as MAX_GSD
from dpstack.profile.channel.indexed import DIALECTS
from dpstack.profile.channel.pkw import PkwDialect
from dpstack.profile.drive_profile import OptionSpec, RateSetting
from dpstack.profile.master.messages import MessageParameter
from dpstack.profile.model.description import DescribedCode, DescribedLed, DescribedRange, DeviceDescription
from dpstack.profile.model.drive_type import CHANNEL_LEN, TelegramSpec
from dpstack.profile.model.param_types import ParamType
from dpstack.profile.model.params import ParamSpec, ParamTable, Use
from dpstack.profile.model.states import ControlTable, Goal, State, StateRow, StateTable
from dpstack.profile.model.words import Word
from dpstack.text import brief, nearest
from dpstack.toml.reading import TomlError, read_toml
from dpstack.toml.table import Key, Source, Table, is_integer, keys_of
from dpstack.units import BAUD_RATES

if TYPE_CHECKING:
    from dpstack.gsd.model import Device

#: octets of a device file: the largest of the library has a tenth of it
MAX_OCTETS: Final = 1_000_000
#: files that stand on one another
MAX_BASES: Final = 8
#: the bases of encoders and of PROFIBUS PA devices, which are no drives
ENCODER: Final = "encoder"
PA: Final = "pa"
#: rows of a CSV file of texts
_MOST_TEXTS: Final = 10_000
_GOALS: Final = {
    "idle": Goal.IDLE,
    "stop": Goal.STOP,
    "quick_stop": Goal.QUICK_STOP,
    "coast": Goal.COAST,
    "ack_high": Goal.ACK_HIGH,
    "ack_low": Goal.ACK_LOW,
}
_STATES: Final = {str(state): state for state in State if state not in (State.OFFLINE, State.UNKNOWN)}
#: user parameters of a Set_Prm
_MOST_PRM: Final = 237
#: the highest number in a word
_MOST_NUMBER: Final = 0xFFFF_FFFF
#: octets of the data of a frame
MAX_DATA: Final = 244
#: words in one direction of an identifier
_MOST_WORDS: Final = 64
#: bits of a word by their type
_BITS_OF_WORD: Final = 16
T = TypeVar("T")


class DeviceFileError(ConfigError):
    """All mistakes of a device file, in the order of their lines; the text is the first one."""

    def __init__(self, errors: Sequence[ConfigError]) -> None:
        #: the mistakes, in the order of their lines
        self.errors = tuple(errors)
        first = self.errors[0]
        more = len(self.errors) - 1
        text = str(first) if not more else f"{first} (and {more} more: `dpstack device check` shows them)"
        super().__init__(text)
        self.line, self.what, self.todo = first.line, first.what, first.todo


class _Collected:
    """Takes the mistakes of a block into a list."""

    def __init__(self, errors: list[ConfigError]) -> None:
        self._errors = errors

    def __enter__(self) -> None:
        pass

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> bool:
        if not isinstance(error, ConfigError):
            return False
        more = error.errors if isinstance(error, DeviceFileError) else (error,)
        self._errors += [one for one in more if one not in self._errors]
        return True


class Reader:
    """Reads one file over its bases. ``find_base``: the path of a base by its name, for the file at a path."""

    #: words that each telegram begins with, of outputs and inputs
    _first_words: ClassVar[tuple[str, str]] = ("control", "status")
    #: parts that words take by their name, and words that need no declaration
    _parts: ClassVar[tuple[str, ...]] = PARTS
    _given_words: ClassVar[tuple[str, ...]] = ("control", "status", "fault", "warning")

    def __init__(self, path: Path, find_base: Callable[[str, Path], Path]) -> None:
        self.path = path
        self._find_base = find_base
        self.errors: list[ConfigError] = []
        self.options: dict[str, OptionSpec] = {}
        self.device_options: dict[str, OptionSpec] = {}

    # -- the text, its bases and its tables -------------------------------------------------------------------------

    def read(self) -> FileFacts:
        """Raises DeviceFileError with all mistakes."""
        with self._collected():
            merged, digest = self._merged
            return self._file(Table(self._source, (), merged, "the file"), digest)
        raise DeviceFileError(sorted(self.errors, key=_line))

    @property
    def root(self) -> str:
        """The name of the last one of its bases; its own without any. Raises DeviceFileError."""
        with self._collected():
            assert self._merged
            return self._root
        raise DeviceFileError(self.errors)

    @functools.cached_property
    def _merged(self) -> tuple[dict[str, Any], str]:
        """The data of the file over those of its bases, and the digest of the file. Raises ConfigError."""
        text, digest = text_of(self.path)
        self._own, lines = _toml(text, self.path)
        self._source = Source(str(self.path), lines, self.path, digest)
        return self._over_bases(self._own, {self.path.resolve()}), digest

    def _over_bases(self, data: dict[str, Any], seen: set[Path]) -> dict[str, Any]:
        """``data`` over the data of its bases: tables are joined key by key, everything else is replaced.
        False takes out a table of the base: a telegram that the drive does not have."""
        layers, path, at = [data], self.path, data
        while (name := at.get("base")) is not None:
            if not isinstance(name, str):
                raise self._source.error(("base",), f"base = {brief(name)} is no name", 'write base = "profidrive"')
            try:
                path = self._find_base(name, path)
            except ConfigError as error:
                if path != self.path:
                    raise
                raise self._source.error(("base",), error.what or str(error), error.todo or "correct it") from None
            if path.resolve() in seen or len(seen) > MAX_BASES:
                raise self._source.error(
                    ("base",), f"the bases stand on one another in a circle: {path.name}", "take a base of dpstack"
                )
            seen.add(path.resolve())
            at, _ = _toml(text_of(path)[0], path)
            layers.append(_beside(at, path.parent))
        self._root = path.stem if len(layers) > 1 else str(data.get("name", path.stem))
        #: the data of the bases alone
        self._below: dict[str, Any] = {}
        for layer in reversed(layers[1:]):
            self._below = _joined(self._below, layer)
        return _joined(self._below, data)

    def _collected(self) -> _Collected:
        """A mistake inside is noted, and reading goes on behind the block."""
        return _Collected(self.errors)

    def _members(self, table: Table, key: str, read: Callable[[str, Table], None]) -> None:
        """Call ``read`` with each of the tables in the table ``key``; its mistakes are noted."""
        if table.raw(key) is None:
            return
        with self._collected():
            inside = table.table(key)
            for name in inside:
                with self._collected():
                    read(name, inside.table(name, f"a table, for instance {name} = {{ ... }}"))

    # -- the whole file -----------------------------------------------------------------------------------------------

    def _file(self, table: Table, digest: str) -> FileFacts:
        facts, given = self._facts(table, digest)
        words: Mapping[str, WordSpec] = facts["words"]
        derived = self._derived(table, words)
        control, status, states, own = self._control(table)
        run, steady = own["run"], own["goals"]
        named = table.raw("reference")
        self._reference_parameters = (
            {one for one in named.values() if isinstance(one, str)} if isinstance(named, dict) else set()
        )
        self._numbered = given.get("by_number", False)
        parameters = self._parameters(table)
        for word in words.values():
            if isinstance(word.of, str):
                self._parameter_named(table.table("words").table(word.name), "of", word.of, parameters)
        if given.get("machine", "table") == "table" and not self._python:
            self._check_way(table, states, run)
        self._simulate = self._simulation(table, parameters)
        released, releasing = own["released"], own["releasing"]
        idle = steady.get(Goal.IDLE, 0)
        parts: dict[str, Any] = {
            "orders": self._orders(table, control),
            "fault": self._messages(table, "fault", words, derived),
            "warning": self._messages(table, "warning", words, derived),
            "obstacles": self._obstacles(table, status, states),
            "channel": self._channel(table),
            "settings": self._settings(table, parameters),
            "maps": self._maps(table, parameters),
            "reference": self._reference(table, parameters),
            "address_parameter": self._parameter_named(table, "address", given.get("address", ""), parameters),
            "simulate": self._simulate,
            "ranges": self._rows_of(table, "range", k.RangeKeys, DescribedRange),
            "leds": self._rows_of(table, "led", k.LedKeys, DescribedLed),
            "missing": self._missing(table),
            "telegram_parameter": self._parameter_named(
                table, "telegram_parameter", given.get("telegram_parameter", ""), parameters
            ),
        }
        for telegram in facts["telegrams"].values():
            for bit in telegram.clear:
                if control.bits and bit not in control.bits:
                    what = f"clear of telegram {telegram.spec.name}: {brief(bit)} is no bit of the control word"
                    self.errors.append(table.error("telegrams", what, f"it has {', '.join(control.bits)}"))
        if self.errors:
            raise DeviceFileError(self.errors)
        return DeviceFile(
            **facts,
            derived=derived,
            table=ControlTable(
                control=control,
                status=status,
                states=states,
                run=run,
                steady=dict.fromkeys(Goal, idle) | steady,
                released_mask=released,
                releasing=releasing,
            ),
            machine=given.get("machine", "table"),
            run=run,
            steady=steady,
            safe_control=own["safe"] if own["safe"] is not None else idle,
            reverse=own["reverse"],
            reversed=own["reversed"],
            codes=own["codes"],
            parameters=parameters,
            lock_hint=given.get("lock_hint", ""),
            start_hint=given.get("start_hint", ""),
            standstill=self._standstill,
            acknowledge=given.get("acknowledge", ""),
            address_acts=given.get("address_acts", "when it is switched off and on").removeprefix("at once"),
            scan_ms=given.get("scan_ms", self._simulate.scan_ms),
            python=given.get("python", ""),
            **parts,
        )

    def _facts(self, table: Table, digest: str) -> tuple[dict[str, Any], dict[str, Any]]:
        """The fields of :class:`FileFacts`, and the keys in front of all tables. Raises DeviceFileError."""
        given: dict[str, Any] = {}
        with self._collected():
            given = table.read(file_keys(k.DeviceKeys))
        if self.errors:
            raise DeviceFileError(self.errors)
        for key, why in (("format", "write format = 1"), ("name", "give the name of the file"), ("base", "")):
            if key not in given and why:
                self.errors.append(table.error(None, f"no {key}", why))
        name = str(given.get("name", self.path.stem))
        if name != self.path.stem:
            self.errors.append(
                table.error(
                    "name", f"name = {brief(name)}, but the file is {self.path.name}", "give both the same name"
                )
            )
        self._python = "python" in given
        words = self._words(table)
        gsd = self.path.parent / given["gsd"] if "gsd" in given else None
        device = None
        with self._collected():
            device = None if gsd is None else self._device(table, gsd)
        telegrams = self._telegrams(table, words, device, given.get("only", ()))
        self._options(table)
        own = self._own.get("telegrams")
        named = {*(own if isinstance(own, dict) else ()), *given.get("only", ())}
        own_telegrams = tuple(one for one in telegrams if one in named)
        in_file = (one for one in telegrams if isinstance(own, dict) and one in own)
        first = next(in_file, next(iter(telegrams), ""))
        default = str(given.get("telegram", first))
        if telegrams and default not in telegrams and default not in given.get("telegrams", ()):
            self.errors.append(table.error("telegram", f"no telegram {default!r}", f"it has {', '.join(telegrams)}"))
        facts = {
            "path": self.path,
            "digest": digest,
            "name": name,
            "title": given.get("title", name),
            "base": self._root,
            "source": given.get("source", ""),
            "tried": given.get("tried", ""),
            "on_loss": given.get("on_loss", "not in its manual"),
            "notes": tuple(given.get("notes", ())),
            "gsd": gsd,
            "bus": self._bus(table, None if device is None else device.ident),
            "telegrams": telegrams,
            "default_telegram": default,
            "own_telegrams": own_telegrams,
            "words": words,
            "options": self.options,
            "device_options": self.device_options,
            "steps": self._steps(table),
            "examples": self._examples(table),
        }
        return facts, given

    # -- telegrams and words ------------------------------------------------------------------------------------------

    def _words(self, table: Table) -> dict[str, WordSpec]:
        found: dict[str, WordSpec] = {}

        def read(name: str, inside: Table) -> None:
            found[name] = WordSpec(name=name)  # known to telegrams even if it is wrong
            given = inside.read(file_keys(k.WordKeys))
            kind = given.get("type", "u16")
            full = given.get("full", NORMALISED.get(kind, 0))
            of = given.get("of", 100.0)
            if not isinstance(of, (str, int, float)) or isinstance(of, bool) or of == 0:
                inside.fail("of", f"of = {brief(of)}: a scale of zero or no number", "give the value at full")
            bits = self._bits(inside, "bits", 8 * TYPES[kind][0] // 8)
            low, high = given.get("low"), given.get("high")
            if low is not None and high is not None and low > high:
                inside.fail("low", f"low = {low:g} is above high = {high:g}", "correct the limits")
            self._check_width(inside, name, kind)
            part = given.get("as", name if name in self._parts else "")
            if part in ("control", "status") and TYPES[kind][0] != _BITS_OF_WORD:
                inside.fail("type", f"the {part} word has 16 bits, not those of {kind}", 'leave type out, or "u16"')
            if part in ("setpoint", "speed") and not full and not self._python:
                inside.fail(None, f"{name} has no scale", 'give full, the counts at 100 %, or type = "n2" (4000h)')
            found[name] = word = WordSpec(
                name=name,
                type=kind,
                full=full,
                of=of if isinstance(of, str) else float(of),
                unit=given.get("unit", "%" if full and not isinstance(of, str) and "of" not in given else ""),
                low=low,
                high=high,
                neutral=given.get("neutral", 0.0),
                part=part,
                bits=bits,
                title=given.get("title", ""),
                width=given.get("width", 0),
            )
            try:
                counts_of(word, word.neutral)
            except ValueError as error:
                if "neutral" in given:
                    raise inside.error("neutral", f"neutral: {error}", "give a value within the limits") from None

        self._members(table, "words", read)
        derived = table.raw("derived")
        for part in self._given_words:
            if not isinstance(derived, Mapping) or part not in derived:
                found.setdefault(part, WordSpec(name=part, part=part))
        return found

    def _check_width(self, table: Table, name: str, kind: str) -> None:
        """Refuse another width for a word in telegrams of a base."""
        below, words = self._below.get("telegrams"), self._below.get("words")
        base = words.get(name) if isinstance(words, dict) else None
        if not isinstance(base, dict) or not isinstance(below, dict):
            return
        width = TYPES.get(str(base.get("type", "u16")), (0, False))[0]
        users = (one for one in below.values() if isinstance(one, dict))
        if TYPES[kind][0] != width and any(name in (*one.get("out", ()), *one.get("in", ())) for one in users):
            table.fail(
                "type",
                f"{name} has {width} bits in telegrams of the base",
                f"give the word of {TYPES[kind][0]} bits a name of its own, and as = ... for its part",
            )

    def _bits(self, table: Table, key: str, most: int) -> dict[str, int]:
        if table.raw(key) is None:
            return {}
        inside = table.table(key)
        bits = {name: inside.integer(name, 0, most - 1) for name in inside}
        for name, bit in bits.items():
            other = next((one for one, at in bits.items() if at == bit and one != name), None)
            if other is not None:
                inside.fail(name, f"{name} and {other} are both bit {bit}", "give each bit one name")
        return bits

    def _derived(self, table: Table, words: Mapping[str, WordSpec]) -> dict[str, Derived]:
        found = {}

        def read(name: str, inside: Table) -> None:
            given = inside.read(file_keys(k.DerivedKeys))
            if name in words:
                inside.fail(None, f"{name!r} is a word and a derived value", "give one of them another name")
            if given.get("of") not in words:
                inside.fail("of", f"of = {brief(given.get('of'))} is no word", f"it has {', '.join(words)}")
            found[name] = Derived(**given)

        self._members(table, "derived", read)
        return found

    def _device(self, table: Table, gsd: Path) -> Device:
        """The device of the GSD file."""
        from dpstack.gsd.parser import load_gsd  # here, as most device files name no GSD file

        try:
            return load_gsd(_octets_of(gsd, MAX_GSD), gsd.name).device
        except OSError as error:
            raise table.error(
                "gsd", f"gsd: {gsd.name} cannot be read ({error.strerror})", "give the path of the maker's GSD file"
            ) from None
        except GsdError as error:
            what, _, todo = str(error).partition("; ")
            raise table.error("gsd", what, todo or "give the maker's GSD file") from None

    def _telegrams(
        self, table: Table, words: Mapping[str, WordSpec], device: Device | None, only: Sequence[str]
    ) -> dict[str, Telegram]:
        found: dict[str, Telegram] = {}
        bus = table.raw("bus")

        def read(name: str, inside: Table) -> None:
            if only and name not in only:
                return
            given = inside.read(file_keys(k.TelegramKeys))
            ways: list[tuple[str | int, ...]] = []
            for key, first in zip(("out", "in"), self._first_words, strict=True):
                ways.append(self._way(inside, key, given.get(key), words, first))
            outputs, inputs = ways
            pkw = bool(given.get("pkw", False))
            sizes = [sum(2 if is_integer(one) else words[str(one)].octets for one in way) for way in ways]
            modules = tuple(given.get("modules", ()))
            config = given.get("config")
            made_up = given.get("made_up", bool(isinstance(bus, Mapping) and bus.get("made_up")))
            number = given.get("number", int(name) if name.isascii() and name.isdecimal() and len(name) < 9 else None)
            if number is not None and number > 0xFFFF:
                inside.fail(None, f"telegram {name}: numbers of telegrams are 0..65535", "give it another name")
            lead = CHANNEL_LEN if pkw else 0
            if max(sizes) + lead > MAX_DATA:
                inside.fail(None, f"telegram {name} has more than the {MAX_DATA} octets of a frame", "take words out")
            if device is not None:
                lengths = sizes[1] + lead, sizes[0] + lead
                guessed = _identifiers(sizes[0], sizes[1], number, pkw=pkw) if self._first_words[0] else b""
                config = self._config_of(inside, name, device, modules, config, lengths, guessed)
            if config is None and not self._first_words[0]:
                inside.fail("config", f"telegram {name} has no identifiers", 'add config, or gsd and modules = ["..."]')
            if config is None:
                with inside.blaming():
                    config, made_up = _identifiers(sizes[0], sizes[1], number, pkw=pkw), True
            with inside.blaming("config"):
                declared = io_lengths(config)
            if not self.errors and declared != (sizes[1] + lead, sizes[0] + lead):
                inside.fail(
                    "out",
                    f"telegram {name} has {sizes[1] + lead} octets of inputs and {sizes[0] + lead} of outputs, its "
                    f"identifiers {config.hex(' ').upper()} have {declared[0]} and {declared[1]}",
                    "correct the words, or config",
                )
            found[name] = Telegram(
                spec=TelegramSpec(
                    name=name, config=config, outputs=sizes[0], inputs=sizes[1], channel=pkw, made_up=made_up
                ),
                outputs=outputs,
                inputs=inputs,
                modules=modules,
                clear=tuple(given.get("clear", ())),
                number=number,
            )

        self._members(table, "telegrams", read)
        listed = table.raw("telegrams")
        for name in only:
            if not isinstance(listed, Mapping) or name not in listed:
                what = f"only has {brief(name)}, which is no telegram of this file"
                self.errors.append(table.error("only", what, "declare it in [telegrams], or take it out"))
        if not found and not self.errors:
            self.errors.append(table.error("telegrams", "no telegram", "add [telegrams] with 1 = { out = [...], ... }"))
        return found

    def _way(
        self, table: Table, key: str, given: object, words: Mapping[str, WordSpec], first: str
    ) -> tuple[str | int, ...]:
        if given is None and not first:
            return ()
        todo = f'write {key} = ["{first or "position"}", ...]'
        if not isinstance(given, list) or not given:
            table.fail(key, f"{key} is no list of words", todo)
        found: list[str | int] = []
        for one in given:
            if is_integer(one) and 0 <= one <= 0xFFFF:
                found.append(one)
            elif isinstance(one, str) and one in words:
                if one in found:
                    table.fail(key, f"{key} names {one!r} twice", "give each word a name of its own")
                found.append(one)
                part = words[one].part
                other = next((name for name in found[:-1] if isinstance(name, str) and words[name].part == part), None)
                if part and other is not None:
                    what = f"{key}: {other!r} and {one!r} are both the {part}"
                    table.fail(key, what, "leave one out, or give it another part by as")
            elif isinstance(one, str):
                near = nearest(one, words)
                hint = f"did you mean {near!r}?" if near else "declare it in [words]"
                table.fail(key, f"{key}: {brief(one)} is no word of this file", hint)
            else:
                table.fail(key, f"{key} holds {brief(one)}", "a word is a name or a constant of 0..65535")
        if first and found[0] != first and not self._python:
            table.fail(key, f"{key} begins with {brief(found[0])}", f"the first word must be {first!r}")
        return tuple(found)

    def _config_of(
        self,
        table: Table,
        name: str,
        device: Device,
        modules: Sequence[str],
        config: bytes | None,
        lengths: tuple[int, int],
        guessed: bytes,
    ) -> bytes | None:
        """The identifiers of a telegram by the GSD file; None for one of a base that the file does not have.

        ``lengths``: of all inputs and outputs; ``guessed``: the identifiers that it would have without the file.
        """
        from dpstack.gsd.configuration import configuration_like, find_module, modules_of_config, plug

        own = self._own.get("telegrams")
        is_own = isinstance(own, dict) and name in own
        try:
            if modules:
                return plug(device, [find_module(device, one) for one in modules], own_prm=True).config
            if config is not None:
                if is_own and modules_of_config(device, config) is None:
                    raise GsdError(
                        f"config {config.hex(' ').upper()} is in no module of the GSD file; give the modules instead"
                    )
                return config
            return configuration_like(device, guessed, lengths, own_prm=True).config
        except GsdError as error:
            if not is_own:
                return None
            what, _, todo = str(error).partition("; ")
            key = "modules" if modules else "config" if config is not None else None
            raise table.error(key, f"telegram {name}: {what}", todo or "give the names of its modules") from None

    # -- control, status, states --------------------------------------------------------------------------------------

    def _control(self, table: Table) -> tuple[Word, Word, StateTable, dict[str, Any]]:
        own: dict[str, Any] = {
            "run": {},
            "goals": {},
            "released": 0,
            "releasing": frozenset(),
            "safe": None,
            "reverse": None,
            "reversed": None,
            "codes": {},
        }
        control_bits: dict[str, int] = {}
        status_bits: dict[str, int] = {}
        rows: list[StateRow] = []
        titles = {"control": "control word", "status": "status word"}
        with self._collected():
            if table.raw("control") is not None:
                inside = table.table("control")
                given = inside.read(file_keys(k.ControlKeys))
                titles["control"] = given.get("title", titles["control"])
                own["codes"]["control"] = self._codes(inside)
                control_bits = self._bits(inside, "bits", 16)
                own["run"] = self._by_name(inside, "run", _STATES)
                own["goals"] = self._by_name(inside, "goals", _GOALS)
                own["released"] = given.get("released", 0)
                own["releasing"] = frozenset(
                    self._state(inside, "releasing", one) for one in given.get("releasing", ())
                )
                own["safe"] = given.get("safe")
                own["reverse"] = self._bit_of(inside, "reverse", given, control_bits)
        with self._collected():
            if table.raw("status") is not None:
                inside = table.table("status")
                given = inside.read(file_keys(k.StatusKeys))
                titles["status"] = given.get("title", titles["status"])
                own["codes"]["status"] = self._codes(inside)
                status_bits = self._bits(inside, "bits", 16)
                own["reversed"] = self._bit_of(inside, "reversed", given, status_bits)
                rows = self._rows(inside)
        states = StateTable(())
        with self._collected():
            try:
                states = StateTable(rows)
            except ValueError as error:
                raise table.error(
                    "status", str(error), "make masks and values of the states exclude one another"
                ) from None
            if not rows and "base" not in self._own:
                raise table.error(None, "no base", 'write base = "profidrive", "drivecom" or "bits"')
            given_status = table.raw("status")
            if not rows and not (isinstance(given_status, Mapping) and given_status.get("states")):
                raise table.error("status", "no states", "add states = { running = [mask, value], ... }")
        return Word(titles["control"], control_bits), Word(titles["status"], status_bits), states, own

    def _codes(self, table: Table) -> tuple[DescribedCode, ...]:
        if table.raw("codes") is None:
            return ()
        inside = table.table("codes")
        return tuple(DescribedCode(code, inside.text(code)) for code in inside)

    def _check_way(self, table: Table, states: StateTable, run: Mapping[State, int]) -> None:
        """A drive without a state machine of a base: the states and words that a start and a stop need."""
        known = {row.state for row in states.rows}
        lower = [state for state in WAY if state in known and state is not State.RUNNING]
        if known and (State.RUNNING not in known or not lower):
            names = ", ".join(str(state) for state in WAY)
            self.errors.append(
                table.error("status", "states: running and a state below it are needed", f"they are {names}")
            )
        elif known and not any(state in run for state in lower):
            todo = f"write run = {{ {lower[-1]} = 0x..., running = 0x... }} in [control]"
            self.errors.append(table.error("control", "no word leads to running", todo))

    def _bit_of(self, table: Table, key: str, given: Mapping[str, Any], bits: Mapping[str, int]) -> int | None:
        name = given.get(key)
        if name is None:
            return None
        if name not in bits:
            table.fail(key, f"{key} = {brief(name)} is no bit of the word", f"it has {', '.join(bits) or 'none'}")
        return 1 << bits[name]

    def _by_name(self, table: Table, key: str, known: Mapping[str, T]) -> dict[T, int]:
        if table.raw(key) is None:
            return {}
        inside = table.table(key)
        found = {}
        for name in inside:
            if name not in known:
                inside.fail(name, f"unknown {name!r}", f"it must be {', '.join(known)}")
            found[known[name]] = inside.integer(name, 0, 0xFFFF)
        return found

    def _state(self, table: Table, key: str, name: str) -> State:
        if name not in _STATES:
            table.fail(key, f"{brief(name)} is no state", f"it must be {', '.join(_STATES)}")
        return _STATES[name]

    def _rows(self, table: Table) -> list[StateRow]:
        if table.raw("states") is None:
            return []
        inside = table.table("states")
        rows = []
        for name in inside:
            state, pairs = self._state(inside, name, name), inside.raw(name)
            if isinstance(pairs, list) and pairs and all(map(is_integer, pairs)):
                pairs = [pairs]
            if not isinstance(pairs, list) or not all(
                isinstance(pair, list) and len(pair) == 2 and all(is_integer(one) for one in pair) for pair in pairs
            ):
                inside.fail(name, f"{name} = {brief(pairs)}", f"write mask and value: {name} = [0x0008, 0x0008]")
            for mask, value in pairs:
                if not (0 <= mask <= 0xFFFF and 0 <= value <= 0xFFFF):
                    inside.fail(name, f"{name}: mask or value beyond FFFFh", "the status word has 16 bits")
                rows.append(StateRow(state, mask, value))
        return rows

    def _orders(self, table: Table, control: Word) -> dict[str, OwnOrder]:
        found = {}

        def read(name: str, inside: Table) -> None:
            given = inside.read(file_keys(k.OrderKeys))
            masks = {}
            for key in ("set", "clear"):
                for bit in given.get(key, ()):
                    if bit not in control.bits:
                        inside.fail(
                            key, f"{brief(bit)} is no bit of the control word", f"it has {', '.join(control.bits)}"
                        )
                masks[key] = control.mask(*given.get(key, ()))
            if not any(masks.values()):
                inside.fail(None, f"the order {name} changes no bit", "give it set or clear")
            found[name] = OwnOrder(**masks)

        self._members(table, "orders", read)
        return found

    def _obstacles(self, table: Table, status: Word, states: StateTable) -> tuple[Obstacle, ...]:
        if table.raw("obstacles") is None:
            return ()
        found: list[Obstacle] = []
        with self._collected():
            inside = table.table("obstacles")
            rows = {str(row.state): row for row in states.rows}
            for bit in inside:
                given = {}
                if isinstance(inside.raw(bit), Mapping):
                    given = inside.table(bit).read(file_keys(k.ObstacleKeys))
                known: Iterable[str] = rows if given.get("state") else status.bits
                if bit not in known:
                    kind = "state" if given.get("state") else "bit"
                    inside.fail(bit, f"{brief(bit)} is no {kind} of the status word", f"it has {', '.join(known)}")
                text = given.get("text", "") if given else inside.text(bit)
                if not text:
                    inside.fail(bit, f"{bit} has no text", "say why the drive cannot run, and what to do")
                if given.get("state"):
                    mask, value = rows[bit].mask, rows[bit].value
                else:
                    mask = status.mask(bit)
                    value = mask if given.get("when") else 0
                found.append(Obstacle(mask, value, text))
        return tuple(found)

    def _messages(
        self,
        table: Table,
        key: str,
        words: Mapping[str, WordSpec],
        derived: Mapping[str, Derived],
    ) -> Messages:
        default = "number" if key == "fault" else "bits"
        own = next((name for name, word in words.items() if word.part == key), key if key in derived else "")
        if table.raw(key) is None:
            return Messages(word=own, kind=default)
        with self._collected():
            inside = table.table(key)
            given = inside.read(file_keys(k.MessageKeys))
            word = given.get("word", own)
            if word and word not in words and word not in derived:
                inside.fail("word", f"word = {brief(word)} is no word of this file", f"it has {', '.join(words)}")
            place = None
            if "parameter" in given:
                at = inside.table("parameter").read(file_keys(k.PlaceKeys))
                if "number" not in at:
                    todo = "write parameter = { number = 947, counter = 944 }"
                    inside.fail("parameter", "parameter has no number", todo)
                if not at.pop("array", True):
                    at |= {"index": None, "count": 1}
                place = MessageParameter(**at)
            unknown = given.get("unknown", "number {}" if key == "fault" else "{}")
            self._places(inside, "unknown", unknown, ("",), 'write "F{:05d}" or "number {}"')
            for name in ("code", "sheet"):
                self._places(inside, name, given.get(name, ""), ("number", "code", "mask", "malfunction"))
            facts = self._texts(inside, given.get("texts"), given.get("code", ""))
            return Messages(
                word=word,
                kind=given.get("kind", default),
                parameter=place,
                texts={number: f"{one.code} {one.text}".lstrip() for number, one in facts.items()},
                unknown=unknown,
                facts=facts,
                sheet=given.get("sheet", "{code}" if "code" in given else "{number}"),
                source=given.get("source", ""),
            )
        return Messages()

    def _places(self, table: Table, key: str, text: str, names: Sequence[str], todo: str = "") -> None:
        """The places of a text, see ``filled``: all of these names."""
        if any(found[1] not in names for found in PLACE.finditer(text)) or set("{}") & set(PLACE.sub("", text)):
            known = ", ".join(f"{{{name}}}" for name in names)
            table.fail(key, f"{key} = {brief(text)} has another place than {known}", todo or "take it out")

    def _texts(self, table: Table, given: object, code: str) -> dict[int, Message]:
        """Texts by number, from a table or from a CSV file."""
        if given is None:
            return {}
        found: dict[int, Message] = {}
        rows: list[tuple[str, dict[str, Any]]]
        if isinstance(given, str):
            rows = [(number, {"text": text}) for number, text in self._csv(table, given)]
        else:
            inside, rows = table.table("texts"), []
            for name in inside:
                more = inside.table(name).read(file_keys(k.TextKeys)) if isinstance(inside.raw(name), Mapping) else {}
                if "text" not in more and more:
                    inside.fail(name, f"{name} has no text", "add text = ...")
                rows.append((name, more or {"text": inside.text(name)}))
        for name, more in rows:
            try:
                number = int(name, 0)
            except ValueError:
                table.fail("texts", f"{brief(name)} is no number", "write each text behind its number")
            if not 0 <= number <= _MOST_NUMBER:
                table.fail("texts", f"{brief(name)} is beyond every word", "a word has 16 or 32 bits")
            found[number] = Message(**({"code": filled(code, {"number": number})} | more))
        return found

    def _csv(self, table: Table, name: str) -> list[tuple[str, str]]:
        path = self.path.parent / name
        try:
            text, _ = text_of(path)
        except ConfigError as error:
            raise table.error("texts", f"texts: {error.what or error}", "give the path of the CSV file") from None
        separator = ";" if text.partition("\n")[0].count(";") else ","
        rows = [row for row in csv.reader(text.splitlines()[:_MOST_TEXTS], delimiter=separator) if row]
        wrong = next((row for row in rows if len(row) < 2 or not row[1].isprintable()), None)
        if wrong is not None:
            table.fail("texts", f"{name} has a row without number and text: {brief(wrong)}", "write number;text")
        return [(row[0].strip(), row[1].strip()) for row in rows if row[0].strip()[:1].isdigit()]

    # -- parameters ---------------------------------------------------------------------------------------------------

    def _parameters(self, table: Table) -> ParamTable:
        specs: dict[tuple[int, int], ParamSpec] = {}
        names: dict[str, str] = {}
        self._standstill: frozenset[str] = frozenset()

        def read_row(first: str, inside: Table) -> None:
            for name, given in _in_a_row(first, inside.read(file_keys(k.ParameterKeys))):
                read(name, inside, given)

        def read(name: str, inside: Table, given: Mapping[str, Any]) -> None:
            number = given.get("number", int(name) if name.isascii() and name.isdecimal() else None)
            if number is None:
                inside.fail(None, f"parameter {name} has no number", "add number = ...")
            spec = self._parameter(inside, name, number, given)
            other = specs.pop((spec.number, spec.index), None)
            own = self._own.get("parameters", {})
            if other is not None and (other.name in own or name not in own):
                inside.fail(None, f"{spec.label} is declared twice, also as {other.name}", "take one of them out")
            if name.lower() in names:
                inside.fail(None, f"{name} is declared twice", "take one of them out")
            specs[spec.number, spec.index] = spec
            names[name.lower()] = name
            if given.get("standstill"):
                self._standstill |= {name}

        self._members(table, "parameters", read_row)
        return ParamTable(specs.values())

    def _parameter(self, table: Table, name: str, number: int, given: Mapping[str, Any]) -> ParamSpec:
        if "per_unit" in given and not given["per_unit"]:
            table.fail("per_unit", "per_unit = 0: a scale of zero", "give the counts that make 1")
        reference = self._reference_parameters
        use = given.get(
            "use", "scale" if name in reference else "setting" if given.get("standstill") else "none"
        ).replace("none", "")
        rest = {key: given[key] for key in _SPEC_KEYS if key in given}
        try:
            return ParamSpec(
                number,
                name,
                given.get("title", name),
                type=ParamType(given.get("type", "u16")),
                by_name=given.get("by_name", not (self._numbered or name.isdecimal())),
                use=Use(use),
                **rest,
            )
        except ValueError as error:
            raise table.error(None, str(error), "correct type or limits") from None

    def _parameter_named(self, table: Table, key: str, name: object, parameters: ParamTable) -> str:
        if not name:
            return ""
        if not isinstance(name, str) or parameters.named(name) is None:
            near = parameters.hint(str(name))
            self.errors.append(
                table.error(
                    key, f"{key} = {brief(name)} is no parameter of this file{near}", "declare it in [parameters]"
                )
            )
        return str(name)

    def _settings(self, table: Table, parameters: ParamTable) -> tuple[SettingSpec, ...]:
        found = []

        def read(name: str, inside: Table) -> None:
            given = inside.read(file_keys(k.SettingKeys))
            spec = parameters.named(name)
            if spec is None:
                inside.fail(None, f"{brief(name)} is no parameter of this file", "declare it in [parameters]")
            equals = given.get("equals")
            if isinstance(equals, str):
                option = equals.strip("{}")
                if equals != f"{{{option}}}" or option not in ("telegram", *self.options, *_REFERENCES):
                    known = ", ".join(f"{{{one}}}" for one in ("telegram", *self.options))
                    inside.fail("equals", f"equals = {brief(equals)} is no option", f"write a number or one of {known}")
                equals = option
            elif not isinstance(equals, (int, float)) or isinstance(equals, bool):
                inside.fail("equals", f"equals = {brief(equals)}", 'give a number, or "{OPTION}"')
            else:
                _check_value(inside, "equals", spec, equals)
            rest = {key: value for key, value in given.items() if key != "equals"}
            found.append(SettingSpec(parameter=name, equals=equals, unit=spec.unit, **rest))

        self._members(table, "settings", read)
        return tuple(found)

    def _maps(self, table: Table, parameters: ParamTable) -> tuple[MapWay, MapWay] | None:
        with self._collected():
            if table.raw("map") is not None and not self._python:
                table.fail("map", "only Python reads and writes a map", "name it: python = ..., or leave [map] out")
            return read_maps(table, parameters)
        return None

    def _reference(self, table: Table, parameters: ParamTable) -> Reference:
        if table.raw("reference") is None:
            return Reference()
        with self._collected():
            inside = table.table("reference")
            given = inside.read(file_keys(k.ReferenceKeys))
            for key, value in given.items():
                if key in ("meaning", "source"):
                    continue
                if isinstance(value, str):
                    self._parameter_named(inside, key, value, parameters)
                elif isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1e6:
                    inside.fail(key, f"{key} = {brief(value)}", "give a number above 0, or the name of a parameter")
            return Reference(**given)
        return Reference()

    def _channel(self, table: Table) -> Channel:
        if table.raw("channel") is None:
            return Channel()
        with self._collected():
            inside = table.table("channel")
            given = inside.read(file_keys(k.ChannelKeys))
            slot, object_ = None, 1
            if "record47" in given:
                record = inside.table("record47").read(file_keys(k.Record47Keys))
                slot, object_ = record.get("slot", 0), record.get("object", 1)
            dialect = given.get("dialect", "plain")
            if dialect not in DIALECTS:
                inside.fail("dialect", f"unknown dialect {brief(dialect)}", f"it must be {', '.join(DIALECTS)}")
            answers: dict[int, tuple[int, ...]] = {}
            if "answers" in given:
                orders = inside.table("answers")
                for order in orders:
                    numbers = orders.raw(order)
                    if not order.isdecimal() or not isinstance(numbers, list) or not all(map(is_integer, numbers)):
                        orders.fail(order, f"{brief(order)} = {brief(numbers)}", "write 1 = [1, 2]")
                    answers[int(order)] = tuple(numbers)
            errors: dict[int, str] = {}
            if "errors" in given:
                texts = inside.table("errors")
                for number in texts:
                    if not number.isdecimal():
                        texts.fail(number, f"{brief(number)} is no number", "write each text behind its number")
                    errors[int(number)] = texts.text(number)
            pkw = DIALECTS[dialect]
            if isinstance(pkw, PkwDialect):
                pkw = structs.replace(
                    pkw,
                    answers=answers or pkw.answers,
                    errors=errors if answers else {**pkw.errors, **errors},
                    zero_between=given.get("zero_between", pkw.zero_between),
                )
            elif answers or "zero_between" in given:
                inside.fail("dialect", f"{dialect} has neither answers nor zero_between", "leave them out")
            else:
                pkw = structs.replace(pkw, errors={**pkw.errors, **errors})
            pkw = structs.replace(pkw, busy=frozenset(given.get("busy", pkw.busy)))
            self._places(inside, "sheet", given.get("sheet", ""), ("",), 'write "{}" or "{:02X}h"')
            return Channel(
                pkw=pkw,
                source=given.get("source", ""),
                sheet=given.get("sheet", "{}"),
                record_slot=slot,
                record_object=object_,
            )
        return Channel()

    # -- the rest -----------------------------------------------------------------------------------------------------

    def _bus(self, table: Table, ident: int | None) -> BusFacts:
        """``ident``: the ident number in the GSD file."""
        if table.raw("bus") is None:
            return BusFacts(ident=ident)
        with self._collected():
            inside = table.table("bus")
            given = inside.read(file_keys(k.BusKeys))
            times, rates = (self._by_number(inside, key, 0xFFFF_FFFF) for key in ("max_tsdr", "rate_numbers"))
            given.pop("rate_numbers", None)
            option = given.pop("rate_option", "")
            if option and (option not in self.options or not rates):
                inside.fail("rate_option", f"rate_option = {brief(option)}", "name an option, and give rate_numbers")
            setting = RateSetting(option, rates) if option else None
            given["rates"] = given.get("rates") or tuple(rates.values())
            if unknown := {*given["rates"], *times} - {*BAUD_RATES}:
                known = ", ".join(map(str, BAUD_RATES))
                inside.fail("rates", f"{min(unknown)} bit/s is no rate of PROFIBUS", f"they are {known}")
            if len(given.get("user_prm", b"")) > _MOST_PRM:
                inside.fail("user_prm", f"more than the {_MOST_PRM} octets of a Set_Prm", "take octets out")
            return BusFacts(**({"ident": ident} | given | {"max_tsdr": times, "rate_setting": setting}))
        return BusFacts()

    def _by_number(self, table: Table, key: str, most: int) -> dict[int, int]:
        """Numbers by numbers."""
        if table.raw(key) is None:
            return {}
        inside = table.table(key)
        wrong = next((name for name in inside if not name.isdecimal()), None)
        if wrong is not None:
            inside.fail(wrong, f"{key}: {brief(wrong)} is no number", "write for instance 9600 = 60")
        return {int(name): inside.integer(name, 0, most) for name in inside}

    def _option(self, table: Table, given: Mapping[str, Any]) -> OptionSpec:
        default = given.get("default")
        if not isinstance(default, (bool, int, float, str)):
            table.fail("default", f"the option {table.title} has no default", "give true or false, a number or a text")
        if isinstance(default, int) and not isinstance(default, bool):
            default = float(default)
        low, high, choices = given.get("low"), given.get("high"), tuple(given.get("choices", ()))
        if isinstance(default, str):
            fits = not choices or default in choices
        else:
            fits = (low is None or default >= low) and (high is None or default <= high) and default == default
        if not fits:
            table.fail("default", f"default = {brief(default)} is none of its values", "correct it or the limits")
        return OptionSpec(default=default, text=given.get("text", ""), low=low, high=high, choices=choices)

    def _options(self, table: Table) -> None:
        def read(name: str, inside: Table) -> None:
            given = inside.read(file_keys(k.OptionKeys))
            simulated = given.pop("simulated", False)
            if simulated is not True:
                self.options[name] = self._option(inside, given)
            if isinstance(simulated, Mapping):
                given |= inside.table("simulated").read(file_keys(k.OptionKeys))
            elif not isinstance(simulated, bool):
                inside.fail("simulated", f"simulated = {brief(simulated)}", "write true or a table")
            if simulated is not False:
                self.device_options[name] = self._option(inside, given)

        self._members(table, "options", read)

    def _simulation(self, table: Table, parameters: ParamTable) -> Simulation:
        if table.raw("simulate") is None:
            return Simulation()
        with self._collected():
            inside = table.table("simulate")
            given = inside.read(file_keys(k.SimulateKeys))
            ramps: dict[str, str] = {}
            if "ramps" in given:
                named = inside.table("ramps")
                for way in named:
                    if way not in ("up", "down", "quick"):
                        named.fail(way, f"unknown ramp {way!r}", "it must be up, down or quick")
                    ramps[way] = self._parameter_named(named, way, named.text(way), parameters)
            lost = given.get("lost", "quick_stop")
            known = ("stop", "quick_stop", "coast", "go_on")
            if lost not in known and not is_integer(lost):
                inside.fail("lost", f"lost = {brief(lost)}", f"it must be {', '.join(known)} or the number of a fault")
            if is_integer(lost) and not 0 < lost <= 0xFFFF:
                inside.fail("lost", f"lost = {lost} is no number of a fault", "give 1..65535")
            for key in ("ready", "left_open"):
                if key in given:
                    self._presets(inside.table(key), parameters)
            rest = {key: value for key, value in given.items() if key not in ("ramps", "lost")}
            up, down, quick = (ramps.get(way, "") for way in ("up", "down", "quick"))
            return Simulation(lost=str(lost), up=up, down=down, quick=quick, **rest)
        return Simulation()

    def _presets(self, table: Table, parameters: ParamTable) -> None:
        """Parameters with the values of a simulated drive."""
        for name in table:
            spec = parameters.named(name)
            if spec is None:
                table.fail(name, f"{brief(name)} is no parameter of this file", "declare it in [parameters]")
            value = table.raw(name)
            if not isinstance(value, (int, float)) or isinstance(value, bool):
                table.fail(name, f"{name} = {brief(value)}", "give a number")
            _check_value(table, name, spec, value)

    def _each(self, table: Table, key: str, read: Callable[[int, Table], None]) -> None:
        """Call ``read`` with line and table of each of an array of tables; its mistakes are noted."""
        listed = table.raw(key)
        if listed is None:
            return
        if not isinstance(listed, list):
            self.errors.append(table.error(key, f"{key} is no array of tables", f"write [[{key}]]"))
            return
        for number, one in enumerate(listed):
            with self._collected():
                inside = Table(self._source, (key, number), one, f"[[{key}]] {number + 1}")
                read(self._source.line((key, number)), inside)

    def _rows_of(self, table: Table, key: str, keys: type, kind: Callable[..., T]) -> tuple[T, ...]:
        """The tables of an array, each as a ``kind``."""
        found: list[T] = []

        def read(_line: int, inside: Table) -> None:
            try:
                found.append(kind(**inside.read(file_keys(keys))))
            except TypeError as error:
                raise inside.error(None, str(error), "add it") from None

        self._each(table, key, read)
        return tuple(found)

    def _steps(self, table: Table) -> tuple[Step, ...]:
        names = ("address", "tens", "ones", "telegram", "number", "rate", "reference_hz", *self.options)
        steps = self._rows_of(table, "step", k.StepKeys, Step)
        for step in steps:
            with self._collected():
                for text in (step.what, step.why, step.delivered):
                    self._places(table, "step", text, names)
                if unknown := set(step.when) - {"address", *self.options}:
                    table.fail("step", f"when: {brief(unknown.pop())} is no option", f"it has {', '.join(names)}")
        return steps

    def _missing(self, table: Table) -> dict[str, str]:
        if table.raw("missing") is None:
            return {}
        inside = table.table("missing")
        for part in inside:
            if part not in DeviceDescription.__struct_fields__:
                inside.fail(part, f"{brief(part)} is no part of the sheet", "write warnings, leds, faults or errors")
        return {part: inside.text(part) for part in inside}

    def _examples(self, table: Table) -> tuple[Example, ...]:
        found: list[Example] = []

        def read(line: int, inside: Table) -> None:
            given = inside.read(file_keys(k.ExampleKeys))
            if not {"inputs", "outputs", "parameter"} & set(given):
                inside.fail(None, "it has no octets", "give inputs, outputs, or parameter with request and answer")
            for key in ("fault", "warning"):
                if not isinstance(given.get(key, ""), str) and not is_integer(given[key]):
                    inside.fail(key, f"{key} = {brief(given[key])}", "give a text or a number")
            outputs: dict[str, tuple[bytes, ...]] = {}
            if "outputs" in given:
                orders = inside.table("outputs")
                outputs = {order: _octets_in_order(orders, order) for order in orders}
            values: dict[str, float | bool] = {}
            if "values" in given:
                numbers = inside.table("values")
                for name in numbers:
                    value = numbers.raw(name)
                    if not isinstance(value, (bool, int, float)):
                        numbers.fail(name, f"{name} = {brief(value)}", "give a number, or true or false")
                    values[name] = value
            found.append(Example(line=line, **(given | {"outputs": outputs, "values": values})))

        self._each(table, "example", read)
        return tuple(found)


def _check_value(table: Table, key: str, spec: ParamSpec, value: float) -> None:
    try:
        spec.to_raw(value)
    except ValueError as error:
        raise table.error(key, str(error), "give a value that it can have") from None


def _octets_in_order(table: Table, key: str) -> tuple[bytes, ...]:
    """Octets, or a list of octets in hex."""
    if not isinstance(table.raw(key), list):
        return (table.octets(key),)
    each = table.numbered(key)
    return tuple(each.octets(one) for one in each)


def _in_a_row(name: str, given: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Parameters that are declared once for several, each with its name."""
    stem = name.rstrip("0123456789")
    digits = name[len(stem) :]
    counted = "index" if "index" in given else "number"
    factories = given.get("factories", ())
    for place in range(given.get("times", 1)):
        at = place * given.get("stride", 1)
        one = dict(given)
        if "title" in given:
            one["title"] = given["title"].replace("{}", str(given.get("first", 1) + place))
        if counted in given:
            one[counted] = given[counted] + at
        if factories:
            one["factory"] = factories[place] if place < len(factories) else 0
        yield stem + str(int(digits) + at).zfill(len(digits)) if digits and at else name, one


#: keys of a parameter that are fields of its specification
_SPEC_KEYS: Final = (
    "low",
    "high",
    "factory",
    "index",
    "decimals",
    "per_unit",
    "unit",
    "per_set",
    "read_only",
    "made_up",
    "volatile",
    "acts",
)
_REFERENCES: Final = ("reference_hz", "reference_rpm")


def text_of(path: Path) -> tuple[str, str]:
    """The text of a file and the SHA-256 of its octets. Raises ConfigError."""
    try:
        octets = _octets_of(path, MAX_OCTETS)
    except OSError as error:
        raise ConfigError.at(
            str(path), None, f"{path.name} cannot be read ({error.strerror})", "give the path of a file"
        ) from None
    if len(octets) > MAX_OCTETS:
        raise ConfigError.at(
            str(path), 1, f"the file has more than {MAX_OCTETS // 1_000_000} MB", "a device file has some kB"
        )
    try:
        return octets.decode(), hashlib.sha256(octets).hexdigest()
    except UnicodeDecodeError as error:
        line = octets.count(b"\n", 0, error.start) + 1
        raise ConfigError.at(str(path), line, "the file is no UTF-8 text", "save it as UTF-8") from None


def _octets_of(path: Path, most: int) -> bytes:
    """The octets of an ordinary file, at most ``most`` + 1; a pipe or a device is not opened. Raises OSError."""
    try:
        mode = path.stat().st_mode
    except ValueError as error:  # an octet 0 in the name
        raise OSError(errno.EINVAL, str(error)) from None
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "no ordinary file")
    with path.open("rb") as file:
        return file.read(most + 1)


@functools.lru_cache(maxsize=16)  # a file is read for its base and for itself, a base for each file on it
def _toml(text: str, path: Path) -> tuple[dict[str, Any], dict[tuple[str | int, ...], int]]:
    try:
        return read_toml(text)
    except TomlError as error:
        raise ConfigError.at(str(path), error.line, error.what, "correct the line") from None


def _beside(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The data of a base, whose paths are relative to its own ``folder``."""
    found = dict(data)
    if isinstance(found.get("gsd"), str):
        found["gsd"] = str(folder / found["gsd"])
    for name, key in (("bus", "made_gsd"), ("fault", "texts"), ("warning", "texts")):
        table = found.get(name)
        if isinstance(table, dict) and isinstance(table.get(key), str):
            found[name] = table | {key: str(folder / table[key])}
    return found


def _joined(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """``above`` over ``below``, key by key; ``false`` takes away what is no flag."""
    found = dict(below)
    for key, value in above.items():
        under = found.get(key)
        if value is False and under is not None and not isinstance(under, bool):
            del found[key]
        else:
            found[key] = _joined(under, value) if isinstance(under, dict) and isinstance(value, dict) else value
    return found


def file_keys(kind: type) -> Mapping[str, Key]:
    """The keys of ``kind``; a Python keyword has an underscore behind it there."""
    return {name.rstrip("_"): key for name, key in keys_of(kind).items()}


def _line(error: ConfigError) -> int:
    return error.line or 0


def _identifiers(outputs: int, inputs: int, number: int | None, *, pkw: bool) -> bytes:
    """Identifiers of PROFIdrive for a telegram that no GSD file describes, in words: PPO, or the special format.

    Raises ConfigError for more words than an identifier has.
    """
    out, into = outputs // 2, inputs // 2
    if max(out, into) > _MOST_WORDS:
        raise ConfigError(f"more than {_MOST_WORDS} words one way; give config, or modules of a GSD file")
    if pkw or number is None:
        lead = b"\xf3" if pkw else b""
        return lead + (
            bytes((0x70 | out - 1,)) if out == into <= 16 else bytes((0xC0, 0xC0 | out - 1, 0xC0 | into - 1))
        )
    return bytes((0xC3, 0xC0 | out - 1, 0xC0 | into - 1, 0xFD)) + number.to_bytes(2, "big")
