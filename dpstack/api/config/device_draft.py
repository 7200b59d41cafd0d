"""A first device file, written from a GSD file: the telegrams that its modules make, with hints for the rest."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from msgspec import Struct, field

from dpstack.api.config.gsd_choice import module_key
from dpstack.devices import finding
from dpstack.devices.model import TYPES
from dpstack.errors import ConfigError, GsdError, UsageError
from dpstack.gsd.configuration import Configuration, fixed_modules, is_fixed, plug
from dpstack.gsd.identifiers import parse_identifiers
from dpstack.gsd.model import Device, Module
from dpstack.profile.model.drive_type import CHANNEL_LEN
from dpstack.toml.reading import comment, quoted, toml_key, toml_value

PROFIDRIVE: Final = finding.DRIVE_BASES[0]
#: first octet of the manufacturer's octets that hold the number of a telegram
_NUMBERED: Final = 0xFD
#: octets and words of a telegram of a drive: control word and set point at least
_LEAST, _MOST_WORDS = 4, 64

#: names of modules that are a parameter channel alone
_CHANNEL_ONLY: Final = re.compile(r"[\d\W]*(PKW|PCV)\W*(\(.*\))?", re.IGNORECASE)
#: words that need no table: of every base, and of the base PROFIDRIVE
_BROUGHT: Final = ("control", "setpoint", "status", "speed", "setpoint_b", "speed_b")
#: words of 32 bits of the base PROFIDRIVE
_OF_BASE: Final = {"setpoint:n4": "setpoint_b", "speed:n4": "speed_b"}


class TelegramDraft(Struct, kw_only=True):
    """A telegram that modules make. ``known``: its words are those of the base. ``outputs``, ``inputs``: octets behind
    the parameter channel (``pkw``)."""

    name: str
    modules: tuple[Module, ...]
    outputs: int
    inputs: int
    pkw: bool
    known: bool
    #: the words, if they are not those of the base: names, ``NAME:TYPE``, or constants
    out: list[str] = field(default_factory=list)
    in_: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        modules = " and ".join(one.title for one in self.modules)
        behind = "parameter channel, then " if self.pkw else ""
        return f"{modules}: {behind}{self.outputs // 2} words to the drive, {self.inputs // 2} from it"


def single_modules(device: Device) -> list[TelegramDraft]:
    """The telegrams that a single module makes behind the fixed presets; the first one of a name."""
    found: dict[str, TelegramDraft] = {}
    for module in device.modules:
        if module.complete and not is_fixed(device, module) and not _CHANNEL_ONLY.fullmatch(module.name):
            with contextlib.suppress(ConfigError):
                one = telegram_of(device, [module])
                found.setdefault(one.name, one)
    return list(found.values())


def telegram_of(device: Device, modules: Sequence[Module]) -> TelegramDraft:
    """The telegram of ``modules``. Raises GsdError if they make no telegram of a drive."""
    row = [*(one for one in fixed_modules(device) if one not in modules), *modules]
    configuration = plug(device, row, own_prm=True)
    pkw = _has_channel(configuration)
    lead = CHANNEL_LEN if pkw else 0
    outputs, inputs = configuration.outputs - lead, configuration.inputs - lead
    title = " and ".join(one.title for one in modules)
    if min(outputs, inputs) < _LEAST or outputs % 2 or inputs % 2 or max(outputs, inputs) > 2 * _MOST_WORDS:
        raise GsdError(
            f"{title}: {inputs} octets of inputs and {outputs} of outputs are no telegram of a drive; "
            "control word and set point, status word and speed are its least"
        )
    name, known = _name(configuration, title, outputs, inputs, pkw=pkw)
    draft = TelegramDraft(name=name, modules=tuple(row), outputs=outputs, inputs=inputs, pkw=pkw, known=known)
    draft.out = default_words(draft, outputs=True)
    draft.in_ = default_words(draft, outputs=False)
    return draft


def _has_channel(configuration: Configuration) -> bool:
    """Whether the first identifier with data has the eight octets of a parameter channel each way, with more behind."""
    first, *rest = (one for one in parse_identifiers(configuration.config) if not one.empty)
    return (first.inputs, first.outputs) == (CHANNEL_LEN, CHANNEL_LEN) and bool(rest)


def _name(configuration: Configuration, title: str, outputs: int, inputs: int, *, pkw: bool) -> tuple[str, bool]:
    """The name, and whether the base PROFIdrive has a telegram of this name and these lengths."""
    base = _of_base()
    sizes = (outputs, inputs, pkw)
    for identifier in parse_identifiers(configuration.config):
        if identifier.manufacturer[:1] == bytes((_NUMBERED,)) and len(identifier.manufacturer) == 3:
            number = str(int.from_bytes(identifier.manufacturer[1:], "big"))
            return number, base.get(number) == sizes
    said = re.search(r"\bPPO[ -]?(\d)\b", title, re.IGNORECASE)
    names = [f"PPO{said[1]}"] if said else [name for name in base if name.startswith("PPO")]
    for name in names:
        if base.get(name) == sizes:
            return name, True
    return "_".join(re.findall(r"\w+", title, re.ASCII))[:40] or "telegram", False


def _of_base() -> dict[str, tuple[int, int, bool]]:
    """Octets and parameter channel of the telegrams of PROFIdrive."""
    path = finding.path_of(PROFIDRIVE)
    assert path is not None
    telegrams = finding.file_at(path).telegrams
    return {name: (one.spec.outputs, one.spec.inputs, one.spec.channel) for name, one in telegrams.items()}


def default_words(telegram: TelegramDraft, *, outputs: bool) -> list[str]:
    """Words of 16 bits: control and set point with zeros behind, or status and speed with words by number."""
    if outputs:
        return ["control", "setpoint", *["0"] * (telegram.outputs // 2 - 2)]
    return ["status", "speed", *(f"word_{number}" for number in range(3, telegram.inputs // 2 + 1))]


def check_words(telegram: TelegramDraft, words: Sequence[str], *, outputs: bool) -> list[str]:
    """``words`` as they were given. Raises UsageError if they are not those of the telegram's length."""
    octets = telegram.outputs if outputs else telegram.inputs
    first = "control" if outputs else "status"
    way = "to the drive" if outputs else "from the drive"
    if not words or words[0] != first:
        raise UsageError(f"the first word {way} is {first!r}; write it in front")
    total = 0
    for word in words:
        name, _, kind = word.partition(":")
        number = _constant(word)
        if number is None and not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII):
            raise UsageError(f"{word!r} is neither a name nor a constant of 0..0xFFFF; write for instance torque or 0")
        if kind and kind not in TYPES:
            raise UsageError(f"{word!r}: there is no type {kind!r}; it must be {', '.join(TYPES)}")
        if number is None and sum(name == one.partition(":")[0] for one in words) > 1:
            raise UsageError(f"the word {name!r} is there twice; give each a name of its own")
        total += TYPES[kind or "u16"][0] // 8
    if total != octets:
        raise UsageError(
            f"the words {way} have {total} octets, the telegram has {octets}; "
            "a word has two octets, one like speed:i32 four, 0 is a constant"
        )
    return list(words)


def _constant(word: str) -> int | None:
    with contextlib.suppress(ValueError):
        number = int(word, 0)
        return number if 0 <= number <= 0xFFFF else None
    return None


# --- the text ---------------------------------------------------------------------------------------------------------
_HEAD_HINTS: Final = """\
# source = "manual, edition, where it is public"
# tried = "from the manual, not tried at the device"
# on_loss = "what the device does when its master stops"
"""
_WORD_HINTS: Final = """\
# A word with scale and unit: `full` are the counts at `of`; n2 and n4 have 100 % at 4000h and 4000 0000h. One to the
# drive besides control and setpoint is settable, `neutral` is its value in the safe outputs.
# current = { full = 0x4000, of = 25, unit = "A" }
# torque_limit = { type = "n2", neutral = 100, low = 0, high = 100 }
# namur = { bits = { fault = 0, line = 1 } }
"""
_STATE_HINTS: Final = """\
# [control]
# bits = { start = 0, no_quick_stop = 2, reverse = 15 }
# the word that leads on from each state towards running, and the words of the goals:
# run = { ready = 0x047C, running = 0x047F }
# goals = { idle = 0x043C, stop = 0x043C, quick_stop = 0x042C, coast = 0x0434, ack_high = 0x04BC, ack_low = 0x043C }
# [status]
# bits = { warning = 7, reached = 8, remote = 9 }
# mask and value of each state; no status word may fit two of them:
# states = { fault = [0x0008, 0x0008], running = [0x0808, 0x0800], ready = [0x0808, 0x0000] }
"""
_BIT_HINTS: Final = """\
# [control]
# bits = { reverse = 11, mop_up = 13 }
# [status]
# bits = { torque_free = 11 }
"""
_HINTS: Final = """\
# [fault]
# texts = { 7011 = "F07011 motor overtemperature" }
# unknown = "F{:05d}"
# [warning]
# kind = "number"
# texts = { 7910 = "A07910 motor overtemperature" }

# [parameters]
# p1120 = { number = 1120, type = "f32", unit = "s", low = 0, high = 999, factory = 10, title = "Ramp-up time" }
# p0922 = { number = 922, title = "Telegram" }
# [settings]
# p0922 = { equals = "{telegram}", remedy = "set p0922 to the number of the telegram" }

# Octets that the manual prints, with their meaning: `dpstack device check` runs them.
# [[example]]
# source = "manual, section"
# inputs = "EB31 0000"
# state = "ready_to_switch_on"
# outputs = { start = "047F 0000", stop = "047E 0000" }
"""


def draft_text(device: Device, gsd: str, name: str, title: str, base: str, telegrams: Iterable[TelegramDraft]) -> str:
    """The text of the file. ``gsd``: the path of the GSD file as the device file names it. Raises GsdError."""
    telegrams = list(telegrams)
    ident = "" if device.ident is None else f" (ident number 0x{device.ident:04X})"
    lines = [
        comment(f"Begun by `dpstack device new` from {Path(gsd).name}{ident}: its manual has the rest."),
        comment(f"`dpstack device check {name}.toml` reports what is wrong or missing."),
        "format = 1",
        f"name = {quoted(name)}",
        f"title = {quoted(title)}",
        f"base = {quoted(base)}",
        f"gsd = {quoted(gsd)}",
        _HEAD_HINTS,
        "[telegrams]",
    ]
    declared: dict[str, str] = {}
    for one in telegrams:
        known = one.known and base == PROFIDRIVE
        if base == PROFIDRIVE:
            one.out, one.in_ = ([_OF_BASE.get(word, word) for word in way] for way in (one.out, one.in_))
        lines += [
            comment(f"{one.text}{'' if known else '; name the words by their meaning'}"),
            _telegram(device, one, known),
        ]
        if not known:
            declared |= _declared(one, scaled=base != "bits")
    lines += ["", "[words]", *(f"{toml_key(word)} = {kind}" for word, kind in declared.items())]
    lines += [_WORD_HINTS, _STATE_HINTS if base == "bits" else _BIT_HINTS, _HINTS]
    return "\n".join(lines)


def _telegram(device: Device, one: TelegramDraft, known: bool) -> str:
    keys: dict[str, object] = {"modules": [module_key(device, module) for module in one.modules]}
    if not known:
        keys |= {"pkw": True} if one.pkw else {}
        keys |= {"out": [*_listed(one.out)], "in": [*_listed(one.in_)]}
    inside = ", ".join(f"{key} = {toml_value(value)}" for key, value in keys.items())
    return f"{toml_key(one.name)} = {{ {inside} }}"


def _listed(words: Iterable[str]) -> Iterator[str | int]:
    for word in words:
        number = _constant(word)
        yield word.partition(":")[0] if number is None else number


def _declared(one: TelegramDraft, *, scaled: bool) -> Mapping[str, str]:
    """The words that the base does not have, and those with a type. ``scaled``: the base has set point and speed."""
    found = {}
    for word in (*one.out, *one.in_):
        name, _, kind = word.partition(":")
        if _constant(word) is None and (kind or name not in _BROUGHT or (not scaled and name in ("setpoint", "speed"))):
            found[name] = f'{{ type = "{kind}" }}' if kind else "{}"
    return found
