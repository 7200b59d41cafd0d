"""The keys of a device file: names, types and limits.

The annotations are values, not texts: the reader needs all of them, and to evaluate 200 texts takes 3 ms.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Final, Literal, TypedDict

from dpstack.toml.table import Key, Octets, Table, is_integer

#: a word, an index, a number of a parameter
_WORD: Final = Key(0, 0xFFFF)
_MOST: Final = 1e9


def _texts(table: Table, name: str, _: Key) -> tuple[str, ...]:
    """Reader of a text or a list of texts."""
    value = table.raw(name)
    if isinstance(value, str):
        return (table.text(name),)
    if not isinstance(value, list) or not all(isinstance(one, str) and one.isprintable() for one in value):
        table.fail(name, f"{name} is no list of texts", f'write {name} = ["...", "..."]')
    return tuple(str(one) for one in value)


def _integers(table: Table, name: str, _: Key) -> tuple[int, ...]:
    """Reader of whole numbers in their order."""
    value = table.raw(name)
    if not isinstance(value, list) or not all(map(is_integer, value)):
        table.fail(name, f"{name} is no list of whole numbers", f"write {name} = [1, 2]")
    return tuple(value)


def _as_given(table: Table, name: str, _: Key) -> object:
    return table.raw(name)


_TEXTS: Final = Key(read=_texts)
_GIVEN: Final = Key(read=_as_given)
_INTEGERS: Final = Key(read=_integers)


class DeviceKeys(TypedDict, total=False):
    """The keys in front of all tables.

    format: 1
    name: the name for `drive = "NAME"`: the name of the file without `.toml`
    title: maker and type for people
    base: `profidrive`, `drivecom`, `bits`, `encoder`, `pa`, or another device file, by name or relative to this one
    gsd: the maker's GSD file, relative to this one. Left out: the plant file names one, or `[bus]` has its facts
    source: manual, edition and where it is public
    tried: whether it was tried at the device
    on_loss: what the device does when its master stops
    notes: further facts for people
    address: name of the parameter with the station address. Left out: the drive has none
    machine: the state machine of the simulated drive: `profidrive`, `drivecom` or `table`. Left out: that of the base
    python: the Python of an installed package, by its name in the entry point group `dpstack.devices`. Left out: none
    telegram: the telegram of a plant file that names none. Left out: the first one of this file
    start_hint: what to check when it does not start for no known reason
    lock_hint: why it may ignore an acknowledgement
    acknowledge: how a fault is acknowledged, for the commissioning sheet
    address_acts: when a new station address takes effect, or `at once`. Left out: when it is switched off and on
    by_number: people know its parameters by their numbers. Left out: false
    telegram_parameter: name of the parameter that chooses the telegram by its `number`, from power-on. Left out: the
        drive takes that of its master
    only: names of the telegrams that it has. Left out: all of this file and of its base
    scan_ms: time that it may take to react. Left out: that of the simulation
    missing: why the commissioning sheet has no `warnings`, `leds` ...: `{ leds = "it has none" }`
    coding: with the base `pa` the coding of the status octet as delivered, `classic` or `condensed`; the option
        `coding` of the plant file is before it. Left out: `classic`
    """

    format: Annotated[int, Key(1, 1, hint="this dpstack reads format = 1")]
    name: str
    title: str
    base: str
    gsd: str
    source: str
    tried: str
    on_loss: str
    notes: Annotated[Sequence[str], _TEXTS]
    address: str
    machine: Literal["profidrive", "drivecom", "table"]
    python: str
    telegram: str
    start_hint: str
    lock_hint: str
    acknowledge: str
    address_acts: str
    by_number: bool
    telegram_parameter: str
    only: Annotated[Sequence[str], _TEXTS]
    scan_ms: Annotated[float, Key(0.1, 10_000)]
    missing: Mapping[str, object]
    coding: Literal["classic", "condensed"]
    bus: Mapping[str, object]
    telegrams: Mapping[str, object]
    words: Mapping[str, object]
    derived: Mapping[str, object]
    control: Mapping[str, object]
    status: Mapping[str, object]
    orders: Mapping[str, object]
    obstacles: Mapping[str, object]
    fault: Mapping[str, object]
    warning: Mapping[str, object]
    reference: Mapping[str, object]
    channel: Mapping[str, object]
    parameters: Mapping[str, object]
    settings: Mapping[str, object]
    options: Mapping[str, object]
    map: Mapping[str, object]
    simulate: Mapping[str, object]
    position: Mapping[str, object]
    velocity: Mapping[str, object]
    preset: Mapping[str, object]
    diagnosis: Mapping[str, object]
    modules: Mapping[str, object]
    slots: Mapping[str, object]
    checkback: Mapping[str, object]
    extension: Mapping[str, object]
    profiles: Mapping[str, object]
    step: Annotated[Sequence[object], _GIVEN]
    range: Annotated[Sequence[object], _GIVEN]
    led: Annotated[Sequence[object], _GIVEN]
    example: Annotated[Sequence[object], _GIVEN]


class BusKeys(TypedDict, total=False):
    """`[bus]`: the facts of the GSD file, for a device file without one.

    ident: the ident number
    rates: baud rates in bit/s
    user_prm: user parameters in hex
    max_tsdr: MaxTsdr in bit times by baud rate, `{ 9600 = 60 }`
    min_slave_interval_us: the shortest time between two exchanges
    fail_safe: it understands an empty output frame in Clear
    made_up: ident number and identifiers are in no manual
    made_gsd: a GSD file made from the manual, not the maker's, relative to this file
    rate_option: name of the option with the number of the rate, for a device that does not detect it
    rate_numbers: those numbers, `{ 0 = 9600 }`
    """

    ident: Annotated[int, _WORD]
    rates: Sequence[int]
    user_prm: Octets
    max_tsdr: Mapping[str, object]
    min_slave_interval_us: Annotated[int, Key(0, 6_553_500)]
    fail_safe: bool
    made_up: bool
    made_gsd: str
    rate_option: str
    rate_numbers: Mapping[str, object]


class TelegramKeys(TypedDict, total=False):
    """`[telegrams.NAME]`: the words in their order, each way; a number is a constant word.

    out: words to the device, the control word first
    in: words from the device, the status word first
    pkw: a parameter channel of eight octets leads. Left out: false
    config: identifier octets in hex. Left out: those of `modules` in the GSD file
    made_up: those identifiers are in no manual. Left out: as in `[bus]`
    modules: names of the modules in the GSD file
    clear: bits of the control word that stay 0 with it, until an order of the file's own sets them. Left out: none
    number: value of the drive's parameter that chooses it, for `{telegram}` in `[settings]`. Left out: its name, if
        that is a number
    """

    out: Annotated[Sequence[object], _GIVEN]
    in_: Annotated[Sequence[object], _GIVEN]
    pkw: bool
    config: Octets
    made_up: bool
    modules: Annotated[Sequence[str], _TEXTS]
    clear: Annotated[Sequence[str], _TEXTS]
    number: Annotated[int, _WORD]


class WordKeys(TypedDict, total=False):
    """`[words]`, `NAME = { ... }`: a word of a telegram.

    type: `n2`, `n4` (PROFIdrive: 4000h or 4000 0000h is 100 %), `i16`, `u16`, `i32`, `u32` or `f32`. Left out: `u16`
    full: the counts at `of`. Left out: with `n2` and `n4` theirs, else the value is the count
    of: the value at `full` in `unit`, or the name of the parameter that holds it. Left out: 100
    unit: the unit of the value. Left out: `%` beside a full scale
    low: lowest value that may be set
    high: highest value that may be set
    neutral: the value in the safe outputs. Left out: 0
    as: the part of the word: `setpoint`, `speed`, `current`, `torque`, `fault` or `warning`; with the base `encoder`
        `position`, `velocity` or `preset`. Left out: by its name
    bits: names of its bits by their numbers, `{ line = 1 }`
    title: what it is, for the commissioning sheet. Left out: its name
    width: bits of the number, the lowest ones, for a word with `bits` above it. Left out: all
    """

    type: Literal["n2", "n4", "i16", "u16", "i32", "u32", "f32"]
    full: Annotated[int, Key(1, 0x7FFF_FFFF)]
    of: Annotated[object, _GIVEN]
    unit: str
    low: Annotated[float, Key(-_MOST, _MOST)]
    high: Annotated[float, Key(-_MOST, _MOST)]
    neutral: Annotated[float, Key(-_MOST, _MOST)]
    as_: Literal[
        "control",
        "status",
        "setpoint",
        "speed",
        "current",
        "torque",
        "fault",
        "warning",
        "position",
        "velocity",
        "preset",
    ]
    bits: Mapping[str, object]
    title: str
    width: Annotated[int, Key(1, 32)]


class DerivedKeys(TypedDict, total=False):
    """`[derived]`, `NAME = { ... }`: a value in part of a word.

    of: the word
    shift: bits below it. Left out: 0
    mask: bits of the value, behind the shift. Left out: FFFFh
    when: the value counts only while these bits of the word are set. Left out: always
    """

    of: str
    shift: Annotated[int, Key(0, 31)]
    mask: Annotated[int, Key(1, 0xFFFF_FFFF)]
    when: Annotated[int, Key(0, 0xFFFF_FFFF)]


class ControlKeys(TypedDict, total=False):
    """`[control]`: the control word.

    bits: names of its bits by their numbers
    run: the word that leads on from each state towards running
    goals: the words of `idle`, `stop`, `quick_stop`, `coast`, `ack_high` and `ack_low`
    released: bits of one's own word without which the states of `releasing` are a stop. Left out: none
    releasing: those states
    safe: the control word of the safe outputs. Left out: that of `idle`
    reverse: the bit for the other direction. Left out: the sign of the set point is the direction
    title: its name in the manual. Left out: `control word`
    codes: meaning of its values, for the commissioning sheet. Left out: none
    """

    bits: Mapping[str, object]
    run: Mapping[str, object]
    goals: Mapping[str, object]
    released: Annotated[int, _WORD]
    releasing: Annotated[Sequence[str], _TEXTS]
    safe: Annotated[int, _WORD]
    reverse: str
    title: str
    codes: Mapping[str, object]


class StatusKeys(TypedDict, total=False):
    """`[status]`: the status word.

    bits: names of its bits by their numbers; `reached`, `remote` and `warning` mean what they say
    states: mask and value of each state, `fault = [0x0008, 0x0008]`, or several such pairs. The states are `not_ready`
        (initialising, without mains), `switch_on_inhibited`, `ready_to_switch_on`, `ready` (switched on, the power
        stage blocked; the rest state of a drive with a single bit for it), `running`, `stopping`, `quick_stop`,
        `fault_reaction` and `fault`. A status word that fits none is `unknown`
    reversed: the bit of the other direction. Left out: the sign of the actual value is the direction
    title: its name in the manual. Left out: `status word`
    codes: meaning of its values, for the commissioning sheet. Left out: the states
    """

    bits: Mapping[str, object]
    states: Mapping[str, object]
    reversed: str
    title: str
    codes: Mapping[str, object]


class OrderKeys(TypedDict, total=False):
    """`[orders]`, `NAME = { ... }`: an order of the file's own: `await drive.order("NAME")`, `dpstack drive CONFIG
    DRIVE order NAME`, `dpstack ctl PORT order DRIVE NAME`.

    set: bits of the control word that it sets, until the outputs are safe
    clear: bits that it clears
    """

    set: Annotated[Sequence[str], _TEXTS]
    clear: Annotated[Sequence[str], _TEXTS]


class ObstacleKeys(TypedDict, total=False):
    """`[obstacles]`, `BIT = { ... }`, or `BIT = "text"` for a bit that is 0: why the drive cannot run.

    when: value of the bit, 0 or 1
    state: the name is that of a state. Left out: false
    text: the reason, and what to do
    """

    when: Annotated[int, Key(0, 1)]
    state: bool
    text: str


class MessageKeys(TypedDict, total=False):
    """`[fault]` and `[warning]`.

    word: the word or the derived value. Left out: the word of this name
    kind: `number` or `bits`. Left out: `number` for faults, `bits` for warnings
    parameter: the parameter that holds the numbers where the telegram does not: `{ number = 947, counter = 944 }`
    texts: texts by number or by bit, or tables; or the name of a CSV file with a number and a text in each row
    unknown: text for a number that has none, such as `"F{:05d}"`. Left out: `number {}`
    code: the code in front of each text, such as `"F{number:05d}"`. Left out: none
    sheet: the code on the commissioning sheet, of `{code}`, `{number}`, `{mask}` and `{malfunction}`. Left out: `code`
    source: section of the manual
    """

    word: str
    kind: Literal["number", "bits"]
    parameter: Mapping[str, object]
    texts: Annotated[object, _GIVEN]
    unknown: str
    code: str
    sheet: str
    source: str


class TextKeys(TypedDict, total=False):
    """`texts`, `NUMBER = { ... }`: a fault or warning with more than a text.

    text: the text
    code: its code
    remedy: what to do
    malfunction: its number in PNU 947, where that is another one
    """

    text: str
    code: str
    remedy: str
    malfunction: Annotated[int, _WORD]


class PlaceKeys(TypedDict, total=False):
    """`parameter` of `[fault]` and `[warning]`: the numbers of the messages that stand; 0 ends them.

    number: the number of the parameter
    index: the first element. Left out: 0
    count: elements that are read at most. Left out: 8, and 1 beside `array = false`
    array: whether it is an array. Left out: true
    counter: the parameter that counts changes of the buffer, read before and after. Left out: none is read
    """

    number: Annotated[int, _WORD]
    index: Annotated[int, _WORD]
    count: Annotated[int, Key(1, 64)]
    array: bool
    counter: Annotated[int, _WORD]


class ReferenceKeys(TypedDict, total=False):
    """`[reference]`: what 100 % of the speed is.

    hz: a number, or the name of the parameter that holds it. Left out: not known
    rpm: the same in rpm
    meaning: what it is in the drive, for the commissioning sheet. Left out: the reference
    source: section of the manual
    """

    hz: Annotated[object, _GIVEN]
    rpm: Annotated[object, _GIVEN]
    meaning: str
    source: str


class ChannelKeys(TypedDict, total=False):
    """`[channel]`: the way to parameters.

    dialect: the kind of parameter channel in telegrams with `pkw`: `plain`, `arrays`, `paged` (SINAMICS), `vlt`
        (Danfoss), `movilink` (SEW). Left out: `plain`
    errors: texts of the errors of the parameter channel by number, beside those of PROFIdrive; beside `answers` alone
    answers: positive answers by order, `{ 1 = [1, 2], 2 = [1] }`. Left out: words and double words without indexes
    zero_between: it takes a new order only after it has answered 0 with 0. Left out: true
    busy: errors after which the order is repeated
    source: section of the manual with the errors
    sheet: their code on the commissioning sheet, such as `"{:02X}h"`. Left out: `{}`
    record47: `{ slot = 0, object = 1 }`, for a drive that has record 47. Left out: it has none
    """

    dialect: str
    errors: Mapping[str, object]
    answers: Mapping[str, object]
    zero_between: bool
    busy: Sequence[int]
    source: str
    sheet: str
    record47: Mapping[str, object]


class Record47Keys(TypedDict, total=False):
    """`record47`.

    slot: the slot. Left out: 0
    object: the axis or drive object (DO-ID). Left out: 1
    """

    slot: Annotated[int, Key(0, 254)]
    object: Annotated[int, Key(0, 255)]


class ParameterKeys(TypedDict, total=False):
    """`[parameters]`, `NAME = { ... }`: a parameter.

    number: the number. Left out: the name, if that is a number
    index: a fixed subindex. Left out: 0
    title: what it is
    type: `u8`, `i8`, `u16`, `i16`, `u32`, `i32`, `f32`, PROFIdrive's `n2`, `n4`, `e2`, `c4`, or `text`. Left out: `u16`
    unit: unit of the value
    decimals: the wire carries value x 10^decimals. Left out: 0
    per_unit: counts on the wire that make 1 in `unit`, if that is no power of ten
    low: lowest value. Left out: that of the type
    high: highest value. Left out: that of the type
    factory: value at delivery. Left out: 0
    read_only: it cannot be written
    per_set: it exists in each data set
    by_name: people know it by its name. Left out: true without `by_number`
    volatile: the drive never stores it
    made_up: limits or factory value are in no manual
    use: what the plugin relies on it for: `scale`, `source`, `setting` or `map`. Left out: `setting` beside
        `standstill`, else `none`
    acts: when a write counts: `power-on`, or the name of the parameter whose write makes it count. Left out: at once
    standstill: it can only be written at standstill
    times: so many of them in a row: the number goes up, or the index if one is given, and so do the digits at the end
        of the name and `{}` in the title. Left out: 1
    stride: from one to the next. Left out: 1
    first: the first number for `{}`. Left out: 1
    factories: values at delivery of those in a row, 0 behind the last one
    """

    number: Annotated[int, _WORD]
    index: Annotated[int, _WORD]
    title: str
    type: Literal["u8", "i8", "u16", "i16", "u32", "i32", "f32", "n2", "n4", "e2", "c4", "text"]
    unit: str
    decimals: Annotated[int, Key(0, 9)]
    per_unit: Annotated[float, Key(-_MOST, _MOST)]
    low: Annotated[float, Key(-1e39, 1e39)]
    high: Annotated[float, Key(-1e39, 1e39)]
    factory: Annotated[float, Key(-1e39, 1e39)]
    read_only: bool
    per_set: bool
    by_name: bool
    volatile: bool
    made_up: bool
    use: Literal["none", "scale", "source", "setting", "map"]
    acts: str
    standstill: bool
    times: Annotated[int, Key(1, 1000)]
    stride: Annotated[int, Key(1, 1000)]
    first: Annotated[int, Key(0, 1000)]
    factories: Annotated[Sequence[int], _INTEGERS]


class MapKeys(TypedDict, total=False):
    """`[map]`: the values in the words behind control word and set point, where they can be chosen; beside `python`.

    most: words of a map. Left out: as many as it has codes
    places: their names, such as `PZD2 to PZD12`
    empty: a word that carries nothing, in the text of a map. Left out: `-`
    noun: what a field is called. Left out: `process data of the drive`
    nouns: and many of them. Left out: `process data`
    hint: how a field is written. Left out: by the nearest names
    twice: what the drive does with an output that a map has twice. Left out: nothing, it may
    inputs: `[map.inputs]`
    outputs: `[map.outputs]`
    """

    most: Annotated[int, Key(1, 122)]
    places: str
    empty: str
    noun: str
    nouns: str
    hint: str
    twice: str
    inputs: Mapping[str, object]
    outputs: Mapping[str, object]


class MapWayKeys(TypedDict, total=False):
    """`[map.inputs]` and `[map.outputs]`.

    codes: names of the parameters that hold the map, in the order of its words. Left out: the drive holds it elsewhere
    count: name of the parameter with the number of its words. Left out: all are in use, 0 is an empty one
    default: codes of the fields at delivery. Left out: none
    place: the name of a word with `{}` for its number, for the commissioning sheet. Left out: it has none
    first: number of the first word. Left out: 1
    fields: `NAME = { code = 1 }`
    source: section of the manual
    """

    codes: Annotated[Sequence[str], _TEXTS]
    count: str
    default: Annotated[Sequence[int], _INTEGERS]
    place: str
    first: Annotated[int, Key(0, 1000)]
    fields: Mapping[str, object]
    source: str


class FieldKeys(TypedDict, total=False):
    """`[map.inputs.fields]` and `[map.outputs.fields]`, `NAME = { ... }`.

    code: number of the field in the drive
    type: `u16`, `i16`, `u32` or `i32`. Left out: `u16`
    per_unit: counts that make 1 in `unit`. Left out: 1
    unit: unit of the value
    low: lowest value. Left out: that of the type
    high: highest value. Left out: that of the type
    limit: what the highest value is, for people
    neutral: 0 in it moves and changes nothing; false for a limit or a ramp time. Left out: true
    """

    code: Annotated[int, Key(1, 0xFFFF_FFFF)]
    type: Literal["u16", "i16", "u32", "i32"]
    per_unit: Annotated[float, Key(-_MOST, _MOST)]
    unit: str
    low: Annotated[float, Key(-_MOST, _MOST)]
    high: Annotated[float, Key(-_MOST, _MOST)]
    limit: str
    neutral: bool


class SettingKeys(TypedDict, total=False):
    """`[settings]`, `PARAMETER = { ... }`: a value that the drive must have, compared when it comes and before a start.

    equals: a number, or `"{OPTION}"`; `"{telegram}"` is the number of the telegram
    remedy: what to do otherwise; `{wanted}` is the value, `{}` that of the drive. Left out: to set it
    notice: a difference is reported and refuses no start. Left out: false
    why: the reason, for the commissioning sheet
    source: section of the manual
    """

    equals: Annotated[object, _GIVEN]
    remedy: str
    notice: bool
    why: str
    source: str


class OptionKeys(TypedDict, total=False):
    """`[options]`, `NAME = { ... }`: an option of the plant file.

    default: its value there, which fixes the type
    text: what it is
    low: lowest value
    high: highest value
    choices: the texts that are allowed
    simulated: `true` for one of the simulated drive alone, `simulated = { NAME = ... }` in the plant file; a table for
        one of both, with what differs there. Left out: false
    """

    default: Annotated[object, _GIVEN]
    text: str
    low: Annotated[float, Key(-_MOST, _MOST)]
    high: Annotated[float, Key(-_MOST, _MOST)]
    choices: Annotated[Sequence[str], _TEXTS]
    simulated: Annotated[object, _GIVEN]


class SimulateKeys(TypedDict, total=False):
    """`[simulate]`: how the simulated drive differs from that of the base.

    ramps: parameters with the times of `up`, `down` and `quick` in s, from standstill to 100 %. Left out: 1 s
    lost: what it does without its master: `stop`, `quick_stop`, `coast`, `go_on`, or the number of a fault
    scan_ms: its internal scan time. Left out: 4
    load: load torque of the rated one. Left out: 0.2
    ready: parameters that differ from delivery where it is set up for the bus. Left out: the numbers of `[settings]`
    left_open: those of them that a plant leaves as delivered
    options: options of the drive that only the simulated one knows
    errors: errors of the parameter channel that can be ordered, for reads and writes
    read_errors: those of reads
    write_errors: those of writes
    """

    ramps: Mapping[str, object]
    lost: Annotated[object, _GIVEN]
    scan_ms: Annotated[float, Key(0.1, 1000)]
    load: Annotated[float, Key(0, 2)]
    ready: Mapping[str, object]
    left_open: Mapping[str, object]
    options: Mapping[str, object]
    errors: Sequence[int]
    read_errors: Sequence[int]
    write_errors: Sequence[int]


class PositionKeys(TypedDict, total=False):
    """`[position]`, with the base `encoder`: the meaning of the counts.

    counts_per_turn: a number; or where the user parameters hold it: `"prm:NAME"`, the parameter of this name in the
        GSD file, or its two words `NAME (high)` and `NAME (low)`; or `"u16@4"`, a place in their octets. Of a list the
        first one that is there counts. Left out: not known, so it has neither turns nor degrees
    range: counts after which the position begins again with 0, in the same ways. Left out: all that its bits hold
    only_if: user parameters that must have a value for both to hold, `{ "Scaling function control" = 1 }`
    """

    counts_per_turn: Annotated[object, _GIVEN]
    range: Annotated[object, _GIVEN]
    only_if: Mapping[str, object]


class VelocityKeys(TypedDict, total=False):
    """`[velocity]`, with the base `encoder`: the unit of the word `velocity`.

    unit: `counts/s` or `rpm`. Left out: `counts/s`
    scale: the value of one count in the word. Left out: 1
    by: the user parameter that chooses the unit, `"prm:NAME"`. Left out: none
    units: scale and unit by the value of that parameter, `{ 1 = [10, "counts/s"] }`
    """

    unit: Literal["counts/s", "rpm"]
    scale: Annotated[float, Key(-_MOST, _MOST)]
    by: str
    units: Mapping[str, object]


class PresetKeys(TypedDict, total=False):
    """`[preset]`, with the base `encoder`: the order that gives the present position a value. The highest bit of the
    word `preset` is the strobe, whose rising edge counts; the bits below are the value.

    done: `position`, when the inputs show the value; `time`, for a device that confirms nothing; or the name of a bit
        of the position's word, in telegrams without it `position`. Left out: `position`
    timeout_ms: for the whole order. Left out: 1000
    hold_ms: the strobe stays at least so long. Left out: 50
    """

    done: str
    timeout_ms: Annotated[int, Key(10, 600_000)]
    hold_ms: Annotated[int, Key(0, 60_000)]


class DiagnosisKeys(TypedDict, total=False):
    """`[diagnosis]`, with the base `encoder`: bits of the extended diagnosis with their texts, by `"OCTET.BIT"`. The
    first octet is 7, the length of the block, as the profile for encoders counts.

    alarms: values are bad while one of these bits is set
    warnings: values are uncertain while one of these is set
    octets: octets of the whole diagnosis, for the simulated encoder. Left out: up to the last bit
    """

    alarms: Mapping[str, object]
    warnings: Mapping[str, object]
    octets: Annotated[int, Key(8, 244)]


class PaTables(TypedDict, total=False):
    """`[checkback]`, `[extension]`, `[profiles]`, with the base `pa`: tables of one line an entry.

    checkback: bits of CHECKBACK by name, `fail_safe = 0`; bit 0 of the first octet is 0. Left out: those of the profile
    extension: texts of the bits of DIAGNOSIS_EXTENSION, `"0.3" = "control loop error"`; octet and bit count from 0
    profiles: the modules of a plant file that has an ident number of the profile and no `modules`,
        `"9701" = ["AI", "AI"]`, the number in hex. Left out: those of the profile, in a file without slots
    """

    checkback: Mapping[str, object]
    extension: Mapping[str, object]
    profiles: Mapping[str, object]


class PaModuleKeys(TypedDict, total=False):
    """`[modules]`, `NAME = { ... }`, with the base `pa`: a module that slots may have. The base has those of the
    profile.

    block: the block that it belongs to, as in `[slots.N]`. Left out: none, as of a free place
    config: identifier octets in hex
    in: its inputs in their order: `OUT`, `TOTAL`, `OUT_D`, `READBACK`, `POS_D`, `CHECKBACK`, `RCAS_OUT`, `READBACK_D`,
        `CHECKBACK_D`, `RCAS_OUT_D`, each with the status octet that the profile gives it; `f32`, `u8`, `u16`, `i16`,
        `u24`, `u32`, `i32` without one
    out: its outputs: `SP`, `RCAS_IN`, `SP_D`, `RCAS_IN_D`, `DISPLAY_VALUE` with status; `SET_TOT`, `MODE_TOT`,
        `CONTROL` and those types without one
    """

    block: Literal["AI", "AO", "DI", "DO", "TOT", "display", "control"]
    config: Octets
    in_: Annotated[Sequence[str], _TEXTS]
    out: Annotated[Sequence[str], _TEXTS]


class PaSlotKeys(TypedDict, total=False):
    """`[slots.N]`, with the base `pa`: a slot by its number, from 1 without a gap, and the function block in it.

    block: `AI`, `AO`, `DI`, `DO`, `TOT`; `display` for a value that the device shows, `control` for an octet of
        control. Left out: none, the slot stays a free place
    name: the name of its value; `NAME_readback` and so on are the others. Left out: the kind with its number, `ai1`
    title: what it measures or moves
    unit: the unit of its value until the block was asked. Left out: none
    modules: names of the modules that it may have. Left out: those of its block, and `free`
    module: the module that a plant file without `modules` gets. Left out: the first one
    words: the meaning of its numbers, for a discrete block or a control octet, `{ 2 = "on" }`
    at: slot and index of the block object over acyclic services, `[1, 16]`. Left out: the slot itself, 16
    source: section of the manual
    """

    block: Literal["AI", "AO", "DI", "DO", "TOT", "display", "control"]
    name: str
    title: str
    unit: str
    modules: Annotated[Sequence[str], _TEXTS]
    module: str
    words: Mapping[str, object]
    at: Annotated[object, _GIVEN]
    source: str


class PaParameterKeys(TypedDict, total=False):
    """`[parameters]`, `NAME = { ... }`, with the base `pa`: a parameter of the maker's, beside those of the profile.

    block: the block that has it, `pb`, `ai1`, `tb1` and so on; only beside `relative`
    relative: its index behind that of the block object
    slot: its slot; only beside `index`
    index: its index
    type: its data type: `u8`, `u16`, `u32`, `i8`, `i16`, `f32`, `unit`, `textN` or `octetsN` with the number of octets.
        Left out: `u8`
    unit: the unit of its value
    access: `r` or `rw`. Left out: `r`
    words: the meaning of its numbers, `{ 1 = "opening" }`
    title: what it is
    source: section of the manual
    """

    block: str
    relative: Annotated[int, Key(0, 255)]
    slot: Annotated[int, Key(0, 254)]
    index: Annotated[int, Key(0, 254)]
    type: str
    unit: str
    access: Literal["r", "rw"]
    words: Mapping[str, object]
    title: str
    source: str


class StepKeys(TypedDict, total=False):
    """`[[step]]`: a step of the commissioning. In its texts stand `{address}`, the switches `{tens}` and `{ones}`,
    `{telegram}`, its `{number}`, and options by their names. One with the address is that of the address.

    what: what to do
    why: the reason
    delivered: how it is at delivery
    source: section of the manual
    first: it comes before the settings. Left out: false
    when: options with the value at which it counts, `{ address = [1, 99] }` is a range. Left out: always
    """

    what: str
    why: str
    delivered: str
    source: str
    first: bool
    when: Mapping[str, object]


class RangeKeys(TypedDict, total=False):
    """`[[range]]`: range and scale of a value in the process data, for the commissioning sheet.

    name: the value
    range: its range
    wire: its scale
    source: section of the manual
    """

    name: str
    range: str
    wire: str
    source: str


class LedKeys(TypedDict, total=False):
    """`[[led]]`: what an LED shows.

    name: the LED
    shows: colour and rhythm
    meaning: what that means
    remedy: what to do
    source: section of the manual
    """

    name: str
    shows: str
    meaning: str
    remedy: str
    source: str


class ExampleKeys(TypedDict, total=False):
    """`[[example]]`: octets of the manual with their meaning, run by `dpstack device check`.

    telegram: the telegram. Left out: the default one, beside `parameter` one with a parameter channel
    options: options of the drive
    source: section of the manual
    inputs: process data received, in hex
    after: process data sent before, as far as the state depends on them
    state: the state that they mean
    fault: the fault that stands, by its text, the first word of it, or its number; `""`: none stands
    warning: the warning that stands, likewise; for bits the number is that of the bit
    speed: actual speed in parts of the reference
    values: named values: a word in its unit, a bit as `WORD_BIT`, a derived value
    outputs: process data sent by an order, see [below](#orders): `{ start = "047F 0000", "speed 0.5" = "047E 2000" }`
    parameter: `read NAME` or `write NAME VALUE`, over the parameter channel
    request: its eight octets
    answer: the eight octets of the drive's answer
    value: the value in the answer
    """

    telegram: str
    options: Mapping[str, object]
    source: str
    inputs: Octets
    after: Octets
    state: str
    fault: Annotated[str, _GIVEN]
    warning: Annotated[str, _GIVEN]
    speed: Annotated[float, Key(-100, 100)]
    values: Mapping[str, object]
    outputs: Mapping[str, object]
    parameter: str
    request: Octets
    answer: Octets
    value: Annotated[float, Key(-1e39, 1e39)]
