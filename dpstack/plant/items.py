"""The items of the live stream as types, and the check of items from other programs (docs/reference/live.md).

A program that reads the stream of another one, or replays a recording, gets items that somebody else made. Keys that
are not named here are allowed: a newer version may have them.

A change of values is the same struct with the keys that have changed: :func:`merged` takes them over. None stands for
what is not there or not known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Final, TypeVar

import msgspec
from msgspec import Struct, structs

from dpstack.plant.quality import NO_MEANING

#: a finite number
Number = Annotated[float, msgspec.Meta(ge=-1e15, le=1e15)]
Count = Annotated[int, msgspec.Meta(ge=0, le=(1 << 63) - 1)]
#: a slave's address as text
Address = Annotated[str, msgspec.Meta(pattern=r"^[0-9]{1,3}\Z")]
#: ``protocol`` of an S7-200, whose values are read over PPI, in stream and statistics, where DP slaves have none
PPI: Final = "ppi"
#: a plain value
Cell = str | int | float | bool | None
#: an item of the stream: a dict with one key
Item = dict[str, Any]

S = TypeVar("S", bound=Struct)


class Times(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Durations in us."""

    min: Number | None = None
    p50: Number
    p99: Number
    p999: Number | None = None
    max: Number


class Classes(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Durations in classes: ``counts`` has one more number than ``limits_us``, that above the last limit."""

    limits_us: list[Number]
    counts: list[Count]
    sum_us: Number = 0


class Held(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A Clear that the master went to by itself: ``since`` s after the start."""

    since: Number
    because: str


# --- plant ------------------------------------------------------------------------------------------------------------


class FieldPlant(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A named value. ``at``: type and place in the octets; ``slot``: the slot that has its first octet; ``channel``: as
    the configuration names it."""

    name: str
    at: str
    slot: int | None = None
    channel: int | None = None
    type: str | None = None
    scale: Number | None = None
    offset: Number | None = None
    unit: str | None = None
    dead_band: Number | None = None
    #: the meaning of its numbers, by the number as text; None: they mean themselves
    words: dict[str, str] | None = None

    def word(self, value: object) -> str:
        """The meaning of ``value``; empty if it means itself, and without a value."""
        if not self.words or type(value) is not int:
            return ""
        return self.words.get(str(value), NO_MEANING)


class ModulePlant(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A slot. ``name``: of its module; ``config``: its identifier octets in hex; ``inputs``, ``outputs``: numbers of
    octets; ``input_at``, ``output_at``: the first of them in the image; ``input_width``, ``output_width``: bits of a
    channel, 0: not known."""

    slot: int | None = None
    name: str | None = None
    config: Cell = None
    inputs: Cell = None
    outputs: Cell = None
    input_at: int | None = None
    output_at: int | None = None
    input_width: int | None = None
    output_width: int | None = None


class DrivePlant(Struct, frozen=True, kw_only=True, omit_defaults=True):
    profile: str | None = None
    telegram: str | None = None
    reference_hz: Number | None = None
    reference_rpm: Number | None = None


class SlavePlant(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A slave as configured. ``safe``: its safe outputs in hex."""

    name: str = ""
    address: int | None = None
    ident: Cell = None
    vendor: str | None = None
    model: str | None = None
    gsd: str | None = None
    modules: list[ModulePlant] | None = None
    input_len: Count | None = None
    output_len: Count | None = None
    safe: str | None = None
    watchdog_ms: Number | None = None
    groups: list[int] | None = None
    dpv1: bool | None = None
    every: int | None = None
    inputs: list[FieldPlant] | None = None
    outputs: list[FieldPlant] | None = None
    drive: DrivePlant | None = None
    #: by their names those of a slave with several, whose ``drive`` is None
    drives: dict[str, DrivePlant] | None = None
    #: :data:`PPI`; None: a DP slave
    protocol: str | None = None


class Rotations(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Planned rotation times in us."""

    min: Number | None = None
    typical: Number | None = None
    max: Number | None = None


class PlanPlant(Struct, frozen=True, kw_only=True, omit_defaults=True):
    rotation_us: Rotations | None = None
    cycle_us: Number | None = None


class Plant(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A bus and its slaves as configured. ``started``: s since 1970, -1: not known; ``source``: "replay" of a
    recording. ``whole`` false: further slaves of the plant before; ``more``: others follow."""

    version: int | None = None
    source: str | None = None
    whole: bool = True
    more: bool = False
    started: float = -1.0
    port: str | None = None
    #: name of the program for ``dpstack ctl``
    ctl: str | None = None
    baud: Count | None = None
    driver: str | None = None
    address: int | None = None
    read_only: bool | None = None
    virtual: bool | None = None
    paced: bool | None = None
    config: str | None = None
    config_digest: str | None = None
    parameters: dict[str, Any] | None = None
    plan: PlanPlant | None = None
    slaves: dict[Address, SlavePlant]

    @property
    def is_replay(self) -> bool:
        return self.source == "replay"


# --- values -----------------------------------------------------------------------------------------------------------


class Remark(Struct, frozen=True):
    """``severity``: info, warning or error."""

    text: str
    severity: str


class SentClockValues(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The last time that a class 3 master has sent: ``time`` in UTC, ``at`` in s since the start."""

    address: int
    time: str
    resolution_ms: int | None = None
    synchronised: bool | None = None
    summer_time: bool | None = None
    at: Number | None = None
    values: Count | None = None


class ClockValues(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The time on the bus. ``interval_s``: in which this master sends it, None: it sends none; ``late_ms``: lateness of
    the port that its resolution holds, ``late_measured``: whether it was measured. ``masters``: the other masters that
    send the time. ``remark``: what to say about it."""

    interval_s: Number | None = None
    sent: SentClockValues | None = None
    late_ms: Number | None = None
    late_measured: bool | None = None
    trouble: str | None = None
    masters: list[SentClockValues] | None = None
    remark: Remark | None = None


class SlaveClockValues(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The clock of a simulated slave. ``master``: the one that it follows."""

    master: int | None = None
    synchronised: bool | None = None
    resolution_ms: int | None = None
    corrected_ms: Number | None = None
    text: str = ""


class BusValues(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """State and counters of a bus, as the summary of ``dpstack run --json`` has them."""

    mode: str | None = None
    in_ring: bool | None = None
    masters: list[int] | None = None
    clear: Held | None = None
    seconds: Number | None = None
    paced: bool | None = None
    rotations: Count | None = None
    rotation_us: Times | None = None
    token_us: Times | None = None
    cycle_us: Number | None = None
    cycles: Count | None = None
    late_us: Times | None = None
    missed: Count | None = None
    left_out: Count | None = None
    missed_by: dict[str, Count] | None = None
    held_back: Count | None = None
    forced: Count | None = None
    tokens: Count | None = None
    tokens_lost: Count | None = None
    telegrams: Count | None = None
    sent: Count | None = None
    retries: Count | None = None
    timeouts: Count | None = None
    late: Count | None = None
    stray: Count | None = None
    garbled: Count | None = None
    token_retries: Count | None = None
    gap_polls: Count | None = None
    bad: dict[str, Count] | None = None
    host_us: Times | None = None
    host_slack_ms: Number | None = None
    age_ms: Number | None = None
    stale: bool | None = None
    behind_ms: Number | None = None
    histogram: list[tuple[Number, Number]] | None = None
    histograms: dict[str, Classes | None] | None = None
    #: the time on the bus (DP-V2); None: nobody sends it
    clock: ClockValues | None = None


class FaultValues(Struct, frozen=True):
    text: str = "fault"
    kind: str | None = None


class DiagnosisValues(Struct, frozen=True):
    flags: list[str] = []
    texts: list[str] = []


class DriveNotice(Struct, frozen=True):
    """``t``: s since the start."""

    t: Number
    text: str


class DriveValues(Struct, frozen=True, kw_only=True):
    """The status of a drive, as :class:`dpstack.profile.DriveStatus` has it; words as four hex digits."""

    state: str | None = None
    running: bool | None = None
    reached: bool | None = None
    remote: bool | None = None
    setpoint: Number | None = None
    speed: Number | None = None
    frequency_hz: Number | None = None
    speed_rpm: Number | None = None
    current: Number | None = None
    torque: Number | None = None
    warnings: list[str] | None = None
    faults: list[str] | None = None
    words: list[str] | None = None
    bits: list[str] | None = None
    settings: str | None = None
    settings_texts: list[str] | None = None
    notices: list[DriveNotice] | None = None
    #: the verdict on ``state``: good, busy, off or error
    level: str | None = None


class QualityValues(Struct, frozen=True):
    """The quality of a value that is not good. ``quality``: uncertain, stale or bad; ``reason``: the name of a
    :class:`dpstack.plant.quality.Reason`; ``since``: s after the start, None: not known; ``remedy``: what to do."""

    quality: str
    reason: str
    text: str
    since: Number | None = None
    remedy: str = ""


class DoubtValues(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A place that the slave's diagnosis throws doubt on. ``direction``: input or output; None: both."""

    slot: int | None = None
    channel: int | None = None
    direction: str | None = None
    quality: str
    reason: str
    text: str
    #: what to do; empty if it is not known
    remedy: str = ""
    since: Number | None = None


class LinkValues(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A link of a slave to a publisher: ``octets`` of its inputs; ``to``: first octet of the outputs that they act
    as. ``good``: valid data come, None: not known."""

    publisher: int
    name: str
    octets: str
    to: int | None = None
    good: bool | None = None
    text: str


class SlaveValues(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """State and values of a slave. ``inputs``, ``outputs``, ``held``: octets in hex; see docs/reference/live.md.

    ``quality``: that of all its values and of its drive, None while it is good; ``qualities``: those of named values
    that are worse.
    """

    state: str | None = None
    inputs: str | None = None
    outputs: str | None = None
    held: str | None = None
    inputs_valid: bool | None = None
    inputs_age_ms: Number | None = None
    inputs_limit_ms: Number | None = None
    fields: dict[str, Any] | None = None
    held_fields: dict[str, Any] | None = None
    withheld: bool | None = None
    quality: QualityValues | None = None
    qualities: dict[str, QualityValues] | None = None
    doubts: list[DoubtValues] | None = None
    fault: FaultValues | None = None
    diagnosis: DiagnosisValues | None = None
    conspicuous: str | None = None
    alarms: dict[str, Count] | None = None
    #: what it takes from publishers (data exchange broadcast)
    links: list[LinkValues] | None = None
    #: the clock of a simulated slave that follows a class 3 master; None: not known
    clock: SlaveClockValues | None = None
    drive: DriveValues | None = None
    #: by their names those of a slave with several, whose ``drive`` is None
    drives: dict[str, DriveValues] | None = None
    exchanges: Count | None = None
    retries: Count | None = None
    timeouts: Count | None = None
    telegrams: Count | None = None
    late: Count | None = None
    wrong: Count | None = None
    bad: dict[str, Count] | None = None
    watchdog_ms: Number | None = None
    master: int | None = None
    injected: list[str] | None = None
    #: the verdicts of :mod:`dpstack.plant.judge`
    alive: bool | None = None
    level: str | None = None
    state_text: str | None = None
    remark: Remark | None = None


def merged(values: S, later: S, keys: Iterable[str]) -> S:
    """``values`` with those of ``later`` that ``keys`` name; further keys are left out."""
    known = type(values).__struct_fields__
    return structs.replace(values, **{key: getattr(later, key) for key in keys if key in known})


def changes_of(before: S, now: S) -> dict[str, Any]:
    """The keys whose values in ``now`` differ from ``before``, as plain data."""
    pairs = zip(type(now).__struct_fields__, structs.astuple(before), structs.astuple(now), strict=True)
    return {key: msgspec.to_builtins(new) for key, old, new in pairs if old is not new and old != new}


def all_of(values: Struct) -> dict[str, Any]:
    """All keys of ``values``, as plain data: of a whole snapshot."""
    pairs = zip(type(values).__struct_fields__, structs.astuple(values), strict=True)
    return {key: msgspec.to_builtins(value) for key, value in pairs}


# --- items ------------------------------------------------------------------------------------------------------------


class Snapshot(Struct, frozen=True, kw_only=True, omit_defaults=True):
    t: Number
    whole: bool
    bus: BusValues
    slaves: dict[Address, SlaveValues]


class EventValues(Struct, frozen=True):
    """The keys of an event that tree and screen look at; the item has more."""

    event: str | None = None
    time: str | None = None
    severity: str | None = None
    text: str | None = None
    address: int | None = None
    silent: bool | None = None


class End(Struct, frozen=True, kw_only=True, omit_defaults=True):
    text: str
    failed: bool = False


class _AnyItem(Struct, frozen=True):
    plant: Plant | None = None
    snapshot: Snapshot | None = None
    event: EventValues | None = None
    lost: Count | None = None
    end: End | None = None


class CheckedItem(Struct, frozen=True):
    """An item that was checked. ``item``: as it came, without further keys; ``kind``: its key, None for an item that
    only a newer version knows. One of the others has its content by type."""

    item: Item
    kind: str | None
    plant: Plant | None = None
    snapshot: Snapshot | None = None
    event: EventValues | None = None
    lost: int | None = None
    end: End | None = None


#: kinds of items, each the key of its item
KINDS: Final = _AnyItem.__struct_fields__


def check_item(item: Mapping[str, Any]) -> CheckedItem:
    """The content of ``item`` by type.

    Raises ValueError if ``item`` is no item of the stream, or has the keys of several: readers would not agree on it.
    """
    try:
        found = msgspec.convert(item, _AnyItem)
    except (msgspec.ValidationError, UnicodeError, RecursionError) as error:
        raise ValueError(f"this is no item of the stream: {error}; is the other program another version?") from None
    kinds = sorted(kind for kind in KINDS if kind in item)
    if len(kinds) > 1:
        raise ValueError(f"this is no item of the stream: it is {' and '.join(kinds)} at the same time")
    if not kinds:
        return CheckedItem({}, None)
    if item[kinds[0]] is None:
        raise ValueError(f"this is no item of the stream: {kinds[0]} has no content")
    return CheckedItem({kinds[0]: item[kinds[0]]}, kinds[0], *structs.astuple(found))
