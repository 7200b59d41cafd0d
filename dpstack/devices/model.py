"""A device file as data: telegrams, words, states, faults, parameters, settings, examples.

The keys are in :mod:`dpstack.devices.keys`. Everything here is checked by the reader.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from msgspec import Struct, field

from dpstack.devices.maps import MapWay
from dpstack.profile.channel.indexed import IndexedDialect
from dpstack.profile.channel.pkw import PLAIN_PKW, PkwDialect
from dpstack.profile.drive_profile import OptionSpec, RateSetting
from dpstack.profile.master.messages import MessageParameter
from dpstack.profile.model.description import DescribedCode, DescribedLed, DescribedRange
from dpstack.profile.model.drive_type import TelegramSpec
from dpstack.profile.model.params import ParamTable
from dpstack.profile.model.states import ControlTable, Goal, State
from dpstack.profile.model.words import Scale

#: the types of words: bits, and whether the number has a sign
TYPES: Final[Mapping[str, tuple[int, bool]]] = {
    "n2": (16, True),
    "n4": (32, True),
    "i16": (16, True),
    "u16": (16, False),
    "i32": (32, True),
    "u32": (32, False),
    "f32": (32, True),
}
#: PROFIdrive's normalised values: counts at 100 %
NORMALISED: Final = {"n2": 0x4000, "n4": 0x4000_0000}

#: `{name}` in a text, or `{name:04X}`
PLACE: Final = re.compile(r"\{(\w*)(?::(0?\d?[dX]))?\}")


def filled(text: str, facts: Mapping[str, object]) -> str:
    """``text`` with the facts in their places; one that is not there stays as it is."""
    return PLACE.sub(lambda found: format(facts[found[1]], found[2] or "") if found[1] in facts else found[0], text)


#: the way up, lowest first
WAY: Final[tuple[State, ...]] = (
    State.NOT_READY,
    State.SWITCH_ON_INHIBITED,
    State.READY_TO_SWITCH_ON,
    State.READY,
    State.RUNNING,
)
#: the words that the state machine and the status of a drive use; a word takes one of these parts by its name or `as`
PARTS: Final = ("control", "status", "setpoint", "speed", "current", "torque", "fault", "warning")
#: the same of an encoder
ENCODER_PARTS: Final = ("position", "velocity", "preset")


class WordSpec(Struct, frozen=True, kw_only=True):
    """A word of a telegram, 16 or 32 bits.

    ``full``: the counts at ``of``; ``of``: a value in ``unit``, or the name of the parameter that holds it. ``part``:
    one of :data:`PARTS`, "" for a value of its own.
    """

    name: str
    type: str = "u16"
    #: counts at ``of``; 0: the value is the count
    full: int = 0
    of: float | str = 100.0
    unit: str = ""
    #: lowest and highest value that may be set, in ``unit``; None: what the octets can hold
    low: float | None = None
    high: float | None = None
    #: value in the safe outputs, in ``unit``
    neutral: float = 0.0
    part: str = ""
    #: bits by name
    bits: Mapping[str, int] = field(default_factory=dict)
    title: str = ""
    #: bits of the number, the lowest ones; 0: all
    width: int = 0

    @property
    def octets(self) -> int:
        return TYPES[self.type][0] // 8

    @property
    def signed(self) -> bool:
        return TYPES[self.type][1]

    @property
    def step(self) -> float:
        """The value of one count in :attr:`unit`; in per cent while only the drive knows the value at ``full``."""
        if not self.full:
            return 1.0
        return (self.of if isinstance(self.of, (int, float)) else 100.0) / self.full

    @property
    def shown_unit(self) -> str:
        """The unit of :attr:`step`."""
        return "%" if self.full and isinstance(self.of, str) else self.unit

    @property
    def is_part_of_reference(self) -> bool:
        """Whether :attr:`scale` gives a part of the reference or of the rated value: not one in ampere, nor a count."""
        return bool(self.full) and (
            self.part in ("setpoint", "speed") or isinstance(self.of, str) or self.unit in ("", "%")
        )

    @property
    def scale(self) -> Scale:
        """In parts of the reference, for set point and actual values."""
        return Scale(self.name, full=self.full or NORMALISED["n2"], bits=8 * self.octets)


def counts_of(word: WordSpec, value: float) -> int:
    """The unsigned integer in the octets of ``value``. Raises ValueError with the range."""
    if word.type == "f32":
        return int.from_bytes(struct.pack(">f", value), "big")
    bits = 8 * word.octets
    lowest, highest = (-(1 << bits - 1), (1 << bits - 1) - 1) if word.signed else (0, (1 << bits) - 1)
    low = lowest * word.step if word.low is None else word.low
    high = highest * word.step if word.high is None else word.high
    if not low <= value <= high:
        unit = f" {word.shown_unit}" if word.shown_unit else ""
        raise ValueError(f"{word.name} {value:g}{unit} is outside {low:g}..{high:g}{unit}")
    return min(max(round(value / word.step), lowest), highest) & (1 << bits) - 1


def value_of(word: WordSpec, counts: int) -> float | int:
    """The value of an unsigned integer in the octets."""
    if word.type == "f32":
        return float(struct.unpack(">f", counts.to_bytes(4, "big"))[0])
    half = 1 << 8 * word.octets - 1
    signed = (counts ^ half) - half if word.signed else counts
    return signed * word.step if word.full else signed


class Telegram(Struct, frozen=True, kw_only=True):
    """A telegram: its words by name in their order, each way; an integer is a constant of 16 bits."""

    spec: TelegramSpec
    outputs: tuple[str | int, ...]
    inputs: tuple[str | int, ...]
    #: the modules in the GSD file that it is made of
    modules: tuple[str, ...] = ()
    #: value of the setting that chooses it in the drive, see ``settings``
    number: int | None = None
    #: bits of the control word that stay 0 unless an order of the file's own sets them
    clear: tuple[str, ...] = ()


class Derived(Struct, frozen=True, kw_only=True):
    """A value in part of a word: ``(word >> shift) & mask`` while a bit of ``when`` is set in the word."""

    of: str
    shift: int = 0
    mask: int = 0xFFFF
    #: bits that must be set; 0: always
    when: int = 0


class Message(Struct, frozen=True, kw_only=True):
    """The facts of the manual about a fault or a warning."""

    text: str
    code: str = ""
    remedy: str = ""
    #: its number in PNU 947
    malfunction: int | None = None


class Messages(Struct, frozen=True, kw_only=True):
    """Faults or warnings: where the number or the bits stand, and the texts by number or bit."""

    #: the word, or the name of a derived value; "": none in the telegram
    word: str = ""
    #: "number" or "bits"
    kind: str = "number"
    #: the parameter that holds the numbers, where no word has them; None: none does
    parameter: MessageParameter | None = None
    #: code and text
    texts: Mapping[int, str] = field(default_factory=dict)
    #: text for a number that has none, with ``{}`` for it
    unknown: str = "number {}"
    facts: Mapping[int, Message] = field(default_factory=dict)
    #: the code on the commissioning sheet
    sheet: str = ""
    source: str = ""


class Obstacle(Struct, frozen=True):
    """``text`` says why the drive cannot run while the status word has ``value`` in the bits of ``mask``."""

    mask: int
    value: int
    text: str


class OwnOrder(Struct, frozen=True, kw_only=True):
    """An order of the file's own: bits of the control word that it sets and clears, until the outputs are safe."""

    set: int = 0
    clear: int = 0


class SettingSpec(Struct, frozen=True, kw_only=True):
    """A parameter that must have a value: a number, or ``{option}`` for the value of an option or ``{telegram}``."""

    parameter: str
    equals: float | str
    unit: str = ""
    remedy: str = ""
    #: a difference is a notice only, it refuses no start
    notice: bool = False
    why: str = ""
    source: str = ""


class Channel(Struct, frozen=True, kw_only=True):
    """The ways to parameters: the PKW area, and slot and object of record 47 (None: it has none)."""

    pkw: PkwDialect | IndexedDialect = PLAIN_PKW
    source: str = ""
    sheet: str = "{}"
    record_slot: int | None = None
    record_object: int = 1

    @property
    def of_pkw(self) -> PkwDialect:
        """The channel of a drive that has PKW."""
        assert isinstance(self.pkw, PkwDialect)
        return self.pkw


class Reference(Struct, frozen=True, kw_only=True):
    """What 100 % of the speed is: a number, or the name of the parameter that holds it; 0: not known."""

    hz: float | str = 0.0
    rpm: float | str = 0.0
    meaning: str = ""
    source: str = ""


class Simulation(Struct, frozen=True, kw_only=True):
    """How the simulated drive differs from that of its base."""

    #: names of the parameters with the ramp times
    up: str = ""
    down: str = ""
    quick: str = ""
    #: what it does when it loses its master: "stop", "quick_stop", "coast", "go_on" or the number of a fault
    lost: str = "quick_stop"
    scan_ms: float = 4.0
    load: float = 0.2
    ready: Mapping[str, object] | None = None
    left_open: Mapping[str, object] = field(default_factory=dict)
    options: Mapping[str, object] = field(default_factory=dict)
    #: numbers of the parameter channel's errors: of all accesses, of reads, of writes
    errors: tuple[int, ...] = ()
    read_errors: tuple[int, ...] = ()
    write_errors: tuple[int, ...] = ()


class Step(Struct, frozen=True, kw_only=True):
    """A step of the commissioning; its texts have places, see :func:`filled`."""

    what: str
    why: str = ""
    delivered: str = ""
    source: str = "the device file"
    first: bool = False
    when: Mapping[str, object] = field(default_factory=dict)


class Example(Struct, frozen=True, kw_only=True):
    """Octets of the manual with their meaning; ``line``: of the file."""

    line: int
    telegram: str | None = None
    source: str = ""
    #: octets of the process data received, and what they mean
    inputs: bytes | None = None
    #: octets sent before, as far as the meaning of the inputs depends on them
    after: bytes | None = None
    state: str = ""
    #: text or number of the message; "": none stands; None: not said
    fault: str | int | None = None
    warning: str | int | None = None
    speed: float | None = None
    values: Mapping[str, float | bool] = field(default_factory=dict)
    #: octets sent by an order, such as "start" or "speed 0.5", in their order
    outputs: Mapping[str, tuple[bytes, ...]] = field(default_factory=dict)
    #: options of the drive
    options: Mapping[str, object] = field(default_factory=dict)
    #: a request and its answer in the parameter channel: "read NAME" or "write NAME VALUE", request, answer, value
    parameter: str = ""
    request: bytes | None = None
    answer: bytes | None = None
    value: float | None = None


class BusFacts(Struct, frozen=True, kw_only=True):
    """The facts of the GSD file, where none comes with the device file."""

    ident: int | None = None
    rates: tuple[int, ...] = ()
    user_prm: bytes = b""
    max_tsdr: Mapping[int, int] = field(default_factory=dict)
    min_slave_interval_us: int = 0
    fail_safe: bool = False
    made_up: bool = False
    made_gsd: str = ""
    #: the option with the number of the rate, and the rates by their numbers; None: it detects the rate
    rate_setting: RateSetting | None = None


class FileFacts(Struct, frozen=True, kw_only=True):
    """The part of a device file that files of drives and of other devices share."""

    path: Path
    #: SHA-256 of its text, hex
    digest: str
    name: str
    title: str
    base: str
    #: manual and edition
    source: str = ""
    #: whether it was tried at the device, for people
    tried: str = ""
    on_loss: str = ""
    notes: tuple[str, ...] = ()
    gsd: Path | None = None
    bus: BusFacts = BusFacts()
    telegrams: Mapping[str, Telegram]
    default_telegram: str
    #: names of the telegrams that are in the file itself, not in a base
    own_telegrams: tuple[str, ...] = ()
    words: Mapping[str, WordSpec] = field(default_factory=dict)
    options: Mapping[str, OptionSpec] = field(default_factory=dict)
    #: options of the simulated device
    device_options: Mapping[str, OptionSpec] = field(default_factory=dict)
    steps: tuple[Step, ...] = ()
    examples: tuple[Example, ...] = ()


class DeviceFile(FileFacts, frozen=True, kw_only=True):
    """The device file of a drive, read and checked."""

    derived: Mapping[str, Derived] = field(default_factory=dict)
    table: ControlTable
    #: the state machine of the simulated drive: "profidrive", "drivecom" or "table"
    machine: str = "table"
    #: the states and goals as the file or its base has them, for the simulation
    run: Mapping[State, int] = field(default_factory=dict)
    steady: Mapping[Goal, int] = field(default_factory=dict)
    safe_control: int = 0
    #: the bit of the control word for the other direction; None: the sign of the set point is the direction
    reverse: int | None = None
    #: and that of the status word
    reversed: int | None = None
    #: meaning of values of "control" and "status", for the sheet
    codes: Mapping[str, tuple[DescribedCode, ...]] = field(default_factory=dict)
    orders: Mapping[str, OwnOrder] = field(default_factory=dict)
    fault: Messages = Messages()
    warning: Messages = Messages(kind="bits")
    obstacles: tuple[Obstacle, ...] = ()
    channel: Channel = Channel()
    parameters: ParamTable
    settings: tuple[SettingSpec, ...] = ()
    #: the maps of inputs and outputs; None: it has none
    maps: tuple[MapWay, MapWay] | None = None
    reference: Reference = Reference()
    address_parameter: str = ""
    lock_hint: str = ""
    start_hint: str = ""
    simulate: Simulation = Simulation()
    #: names of the parameters that are written at standstill only
    standstill: frozenset[str] = frozenset()
    ranges: tuple[DescribedRange, ...] = ()
    leds: tuple[DescribedLed, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)
    acknowledge: str = ""
    address_acts: str = "when it is switched off and on"
    #: name of the parameter that chooses the telegram; "": none does
    telegram_parameter: str = ""
    scan_ms: float = 4.0
    #: name of the Python of a package, in the entry point group ``dpstack.devices``
    python: str = ""


class EncoderFile(FileFacts, frozen=True, kw_only=True):
    """The device file of an encoder, read and checked. See :mod:`dpstack.devices.keys` for the meaning."""

    #: numbers, ``prm:NAME`` or a place in the user parameters; the first that is there counts
    counts_per_turn: tuple[int | str, ...] = ()
    range: tuple[int | str, ...] = ()
    #: user parameters by name, and the value for which both hold
    only_if: Mapping[str, int] = field(default_factory=dict)
    #: scale and unit of the velocity, or those by the value of the user parameter ``velocity_by``
    velocity: tuple[float, str] = (1, "counts/s")
    velocity_by: str = ""
    velocities: Mapping[int, tuple[float, str]] = field(default_factory=dict)
    #: "position", "time", or the name of a bit
    preset_done: str = "position"
    preset_timeout_ms: int = 1000
    preset_hold_ms: int = 50
    #: texts by bit, counted from 0 at the first octet behind the block's header
    alarms: Mapping[int, str] = field(default_factory=dict)
    warnings: Mapping[int, str] = field(default_factory=dict)
    #: octets of the simulated diagnosis
    diagnosis_octets: int = 0

    def part(self, telegram: str, part: str, *, outputs: bool = False) -> tuple[WordSpec, int] | None:
        """The word with this ``part`` in the telegram, and its first octet; None if it has none."""
        at, found = 0, self.telegrams[telegram]
        for name in found.outputs if outputs else found.inputs:
            word = None if isinstance(name, int) else self.words[name]
            if word is not None and word.part == part:
                return word, at
            at += 2 if word is None else word.octets
        return None
