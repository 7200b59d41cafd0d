"""Types of the items of the live stream, and the check of items from other programs (docs/reference/live.md).

A program that reads the stream of another one, or replays a recording, gets items that somebody else made. Keys that
are not named here are allowed: a newer version may have them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Required, TypedDict

import msgspec

#: a finite number
Number = Annotated[float, msgspec.Meta(ge=-1e15, le=1e15)]
Count = Annotated[int, msgspec.Meta(ge=0, le=(1 << 63) - 1)]
#: a slave's address as text
Address = Annotated[str, msgspec.Meta(pattern=r"^[0-9]{1,3}\Z")]
#: a plain value
Cell = str | int | float | bool | None
Texts = list[str] | None


class Times(TypedDict, total=False):
    min: Number
    p50: Required[Number]
    p99: Required[Number]
    p999: Number
    max: Required[Number]


class Classes(TypedDict, total=False):
    limits_us: Required[list[Number]]
    counts: Required[list[Count]]
    sum_us: Number


class Held(TypedDict):
    since: Number
    because: str


class FieldPlant(TypedDict, total=False):
    name: Required[str]
    at: Required[str]
    type: str | None
    scale: Number | None
    offset: Number | None
    unit: str | None
    dead_band: Number | None


class Module(TypedDict, total=False):
    name: str | None
    config: Cell
    inputs: Cell
    outputs: Cell


class DrivePlant(TypedDict, total=False):
    profile: str | None
    telegram: str | None
    reference_hz: Number | None
    reference_rpm: Number | None


class SlavePlant(TypedDict, total=False):
    name: str
    address: int | None
    ident: Cell
    vendor: str | None
    model: str | None
    gsd: str | None
    modules: list[Module] | None
    safe: str | None
    watchdog_ms: Number | None
    groups: list[int] | None
    every: int | None
    inputs: list[FieldPlant] | None
    outputs: list[FieldPlant] | None
    drive: DrivePlant | None


class PlantBody(TypedDict, total=False):
    whole: bool
    more: bool
    started: float
    port: str | None
    ctl: str | None
    baud: Count | None
    address: int | None
    config: str | None
    slaves: Required[dict[Address, SlavePlant]]


class BusValues(TypedDict, total=False):
    mode: str | None
    in_ring: bool | None
    masters: list[int] | None
    clear: Held | None
    rotation_us: Times | None
    telegrams: Count | None
    retries: Count | None
    timeouts: Count | None
    late: Count | None
    stray: Count | None
    bad: dict[str, Count] | None
    stale: bool | None
    age_ms: Number | None
    histogram: list[tuple[Number, Number]] | None
    histograms: dict[str, Classes | None] | None


class Remark(TypedDict):
    text: str
    severity: str


class FaultValues(TypedDict, total=False):
    text: str


class DiagnosisValues(TypedDict, total=False):
    flags: list[str]
    texts: list[str]


class DriveNotice(TypedDict):
    t: Number
    text: str


class DriveValues(TypedDict, total=False):
    state: Cell
    running: bool | None
    setpoint: Number | None
    speed: Number | None
    frequency_hz: Number | None
    current: Number | None
    torque: Number | None
    warnings: list[Cell] | None
    faults: list[Cell] | None
    bits: Texts
    settings: Cell
    settings_texts: Texts
    notices: list[DriveNotice] | None


class SlaveValues(TypedDict, total=False):
    state: Cell
    inputs: str | None
    outputs: str | None
    held: str | None
    inputs_valid: bool | None
    inputs_age_ms: Number | None
    inputs_limit_ms: Number | None
    fields: dict[str, Any] | None
    held_fields: dict[str, Any] | None
    fault: FaultValues | None
    diagnosis: DiagnosisValues | None
    conspicuous: str | None
    alarms: dict[str, Any] | None
    drive: DriveValues | None
    exchanges: Count | None
    retries: Count | None
    timeouts: Count | None
    telegrams: Count | None
    late: Count | None
    wrong: Count | None
    bad: dict[str, Count] | None
    watchdog_ms: Number | None
    master: int | None
    injected: Texts
    alive: bool
    level: str
    state_text: str
    remark: Remark | None


class SnapshotBody(TypedDict):
    t: Number
    whole: bool
    bus: BusValues
    slaves: dict[Address, SlaveValues]


class EventBody(TypedDict, total=False):
    event: str
    time: str
    severity: str
    text: str
    address: int | None
    silent: bool


class EndBody(TypedDict, total=False):
    text: Required[str]
    failed: bool


class AnyItem(TypedDict, total=False):
    plant: PlantBody
    snapshot: SnapshotBody
    event: EventBody
    lost: Count
    end: EndBody


#: kinds of items, each the key of its item
_KINDS: Final = frozenset(AnyItem.__annotations__)


def check_item(item: Mapping[str, Any]) -> str | None:
    """Return the kind of ``item``: its key, for instance ``plant``; None for an item that only a newer version knows.

    Raises ValueError if ``item`` is no item of the stream, or has the keys of several: readers would not agree on it.
    """
    try:
        msgspec.convert(item, AnyItem)
    except (msgspec.ValidationError, UnicodeError, RecursionError) as error:
        raise ValueError(f"this is no item of the stream: {error}; is the other program another version?") from None
    kinds = sorted(_KINDS & item.keys())
    if len(kinds) > 1:
        raise ValueError(f"this is no item of the stream: it is {' and '.join(kinds)} at the same time")
    return kinds[0] if kinds else None
