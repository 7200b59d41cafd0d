"""Description of a device for people: what to set at it, its telegrams, words, messages and LEDs.

The commissioning sheet (``dpstack sheet``) is made of it. A drive fills it from its tables
(:meth:`~dpstack.profile.drive_profile.DriveProfile.describe`), a slave of a GSD file from that file. ``source`` is the
section of the manual; a fact of no manual says so there.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Final

from msgspec import Struct, field

from dpstack.profile.model.drive_type import CHANNEL_LEN, TelegramSpec
from dpstack.profile.model.params import ParamSpec, Use
from dpstack.profile.model.states import ControlTable
from dpstack.profile.model.words import Word

#: highest value of a word, which is no limit of a parameter
_WORD: Final = 0xFFFF
#: source of a fact that no manual has and that this project decided
READING: Final = "a reading, in no manual here"
#: source of a fact of the simulated drive
MADE_UP: Final = "made up for the simulated drive"
#: source of a fact of another manual, which this project does not have
OTHER_MANUAL: Final = "a reading: the inverter's own manual has it"


class Check(StrEnum):
    """Reaction of the plugin to a setting that is another one."""

    NONE = ""  # it cannot read the setting
    REFUSED = "start is refused"
    NOTICE = "notice"


class DescribedStep(Struct, frozen=True, kw_only=True):
    """Something that has to be set or wired at the device, and the reason."""

    #: what to set, for instance ``F03 = 60 Hz``
    what: str
    #: reason, for people
    why: str
    #: setting at delivery; empty if no manual gives it
    delivered: str = ""
    #: what the plugin does if it differs
    check: Check = Check.NONE
    #: section of the manual
    source: str


class DescribedBit(Struct, frozen=True):
    """A named bit of a word."""

    #: number, 0 is the lowest
    bit: int
    #: name of the bit
    name: str


class DescribedCode(Struct, frozen=True):
    """A value of a word, or of some of its bits."""

    #: value for people, for instance ``0027h of 006Fh``
    code: str
    #: meaning of the value
    name: str


class DescribedWord(Struct, frozen=True, kw_only=True):
    """A control or status word: its bits by name, and what its values mean."""

    #: name of the word
    name: str
    #: its named bits, lowest first
    bits: tuple[DescribedBit, ...] = ()
    #: values of the word, or of some of its bits
    codes: tuple[DescribedCode, ...] = ()


class DescribedPlace(Struct, frozen=True, kw_only=True):
    """A value in the process data."""

    #: octet at which it begins, from 0
    octet: int
    #: its octets
    length: int
    #: meaning of the value
    name: str


class DescribedTelegram(Struct, frozen=True, kw_only=True):
    """A telegram: its identifier octets and its octets each way."""

    #: name of the telegram
    name: str
    #: identifier octets, hex
    config: str
    #: all octets of the outputs
    outputs: int
    #: all octets of the inputs
    inputs: int
    #: a parameter channel of eight octets leads
    channel: bool = False
    #: the identifiers are in no manual
    made_up: bool = False


class DescribedRange(Struct, frozen=True, kw_only=True):
    """The range of a value in the process data, and its scale."""

    #: name of the value
    name: str
    #: range in words with unit
    range: str
    #: what stands on the wire
    wire: str
    #: section of the manual
    source: str


class DescribedParameter(Struct, frozen=True, kw_only=True):
    """A parameter that the plugin knows. DescribedRange and delivery are empty if no manual gives them."""

    #: number or name
    name: str
    #: title for people
    title: str
    #: lowest and highest value with unit; empty if no manual gives them
    range: str = ""
    #: setting at delivery; empty if no manual gives it
    delivered: str = ""
    #: the drive refuses writes
    read_only: bool = False


class DescribedMessage(Struct, frozen=True, kw_only=True):
    """A fault, a warning or an error. ``remedy`` is empty if its source has none."""

    #: code as the device shows it
    code: str
    #: meaning of the code
    text: str
    #: what to do; empty if the source has nothing
    remedy: str = ""
    #: section of the manual, or file
    source: str


class DescribedLed(Struct, frozen=True, kw_only=True):
    """What an LED shows."""

    #: name of the LED
    name: str
    #: colour and rhythm
    shows: str
    #: state that it shows
    meaning: str
    #: what to do; empty if the source has nothing
    remedy: str = ""
    #: section of the manual
    source: str


class DeviceDescription(Struct, frozen=True, kw_only=True):
    """A device. An empty part has a sentence in ``missing`` by the name of its field, which says why it is empty."""

    #: maker and type
    title: str
    #: manual or file from which the facts come
    manual: str = ""
    #: ident number; None if neither manual nor GSD file gives it
    ident: int | None = None
    #: baud rates in bit/s; empty if they are not known
    rates: tuple[int, ...] = ()
    #: what has to be set or wired, in its order
    steps: tuple[DescribedStep, ...] = ()
    #: what a user should know
    notes: tuple[str, ...] = ()
    #: all telegrams, the one in use first
    telegrams: tuple[DescribedTelegram, ...] = ()
    #: name of the telegram in use
    telegram: str = ""
    #: outputs of the telegram in use, without a gap
    outputs: tuple[DescribedPlace, ...] = ()
    #: inputs of the telegram in use, without a gap
    inputs: tuple[DescribedPlace, ...] = ()
    #: control and status words
    words: tuple[DescribedWord, ...] = ()
    #: ranges and scales of the process data
    ranges: tuple[DescribedRange, ...] = ()
    #: faults, or texts for diagnosis bits
    faults: tuple[DescribedMessage, ...] = ()
    #: warnings
    warnings: tuple[DescribedMessage, ...] = ()
    #: how a fault is acknowledged
    acknowledge: str = ""
    #: errors of the access to parameters
    errors: tuple[DescribedMessage, ...] = ()
    #: what the LEDs show
    leds: tuple[DescribedLed, ...] = ()
    #: what the device does when its master stops
    on_loss: str = ""
    #: parameters that the plugin knows
    parameters: tuple[DescribedParameter, ...] = ()
    #: why a part is empty, by the name of its field
    missing: Mapping[str, str] = field(default_factory=dict)


def described_word(word: Word, codes: Iterable[DescribedCode] = ()) -> DescribedWord:
    """A word by its table."""
    bits = sorted((DescribedBit(bit, name) for name, bit in word.bits.items()), key=lambda one: one.bit)
    return DescribedWord(name=word.name, bits=tuple(bits), codes=tuple(codes))


def states_of(table: ControlTable) -> tuple[DescribedCode, ...]:
    """The states by the status word, as 16 bits of it show them."""
    found = {
        (f"{row.value & 0xFFFF:04X}h of {row.mask & 0xFFFF:04X}h", str(row.state).replace("_", " ")): None
        for row in table.states.rows
    }
    return tuple(DescribedCode(*one) for one in found)


def places(
    telegram: TelegramSpec, *, outputs: bool, names: Iterable[str | tuple[str, int]]
) -> tuple[DescribedPlace, ...]:
    """The process data of one way: ``names`` in their order, each a word, or with its octets; what does not fit into
    the telegram is left out, and a rest without names is one place."""
    length = telegram.output_octets if outputs else telegram.input_octets
    found = [DescribedPlace(octet=0, length=CHANNEL_LEN, name="parameter channel")] if telegram.channel else []
    at = CHANNEL_LEN if telegram.channel else 0
    for one in names:
        name, octets = (one, 2) if isinstance(one, str) else one
        if at + octets > length:
            break
        found.append(DescribedPlace(octet=at, length=octets, name=name))
        at += octets
    if at < length:
        found.append(DescribedPlace(octet=at, length=length - at, name="not used"))
    return tuple(found)


def described_telegram(spec: TelegramSpec) -> DescribedTelegram:
    return DescribedTelegram(
        name=spec.name,
        config=spec.config.hex(" ").upper(),
        outputs=spec.output_octets,
        inputs=spec.input_octets,
        channel=spec.channel,
        made_up=spec.made_up,
    )


def value_text(spec: ParamSpec, value: float) -> str:
    """A value of a parameter with its unit."""
    return f"{value:g} {spec.unit}".rstrip()


def delivered(spec: ParamSpec | None) -> str:
    """The setting at delivery; empty if no manual gives it. An address in a map is hex, as keypads show it."""
    if spec is None or spec.made_up or spec.text or spec.read_only or spec.volatile:
        return ""
    if spec.use is Use.MAP and spec.high == _WORD:
        return f"{int(spec.factory):04X}h"
    return value_text(spec, spec.factory)


def described_parameters(table: Iterable[ParamSpec]) -> tuple[DescribedParameter, ...]:
    """The parameters of a table. Limits and settings at delivery that are made up are left out, as are limits that are
    only those of the type."""
    return tuple(
        DescribedParameter(
            name=spec.name if spec.by_name or spec.index else f"{spec.number} {spec.name}",
            title=spec.title,
            range=""
            if spec.made_up or spec.text or (spec.low, spec.high) == spec.type_limits
            else f"{spec.low:g}..{value_text(spec, spec.high)}",
            delivered=delivered(spec),
            read_only=spec.read_only,
        )
        for spec in table
    )


def messages(texts: Mapping[int, str], code: str, source: str) -> tuple[DescribedMessage, ...]:
    """Messages by number; ``code`` is the format of the number."""
    return tuple(DescribedMessage(code=code.format(number), text=text, source=source) for number, text in texts.items())
