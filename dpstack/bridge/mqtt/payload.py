"""Payloads of Sparkplug B (Sparkplug 3.0.0, chapter 6): nodes of the tree as metrics, and the metrics of commands.

Times are whole milliseconds since 1970, UTC.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from google.protobuf.message import DecodeError

from dpstack.bridge.mqtt import sparkplug_pb2 as pb
from dpstack.plant.quality import BOOL, BYTES, COUNT, FLOAT, TEXT, Reading, Value
from dpstack.text import printable, shortened

#: octets of a command from a stranger, and metrics in it
MOST_OCTETS: Final = 65_536
MOST_METRICS: Final = 100
#: characters of a text in properties
_MOST_TEXT: Final = 200
#: the last millisecond of the year 9999
LATEST_MS: Final = 253_402_300_799_999


class DataType(IntEnum):
    """Types of metrics and properties (6.4.16), those that dpstack uses."""

    INT8 = 1
    INT16 = 2
    INT32 = 3
    INT64 = 4
    UINT8 = 5
    UINT16 = 6
    UINT32 = 7
    UINT64 = 8
    FLOAT = 9
    DOUBLE = 10
    BOOLEAN = 11
    STRING = 12
    DATE_TIME = 13
    TEXT = 14
    BYTES = 17


#: the type of a metric by the type of a node
DATA_TYPES: Final[Mapping[str, DataType]] = {
    BOOL: DataType.BOOLEAN,
    TEXT: DataType.STRING,
    BYTES: DataType.BYTES,
    "f32": DataType.FLOAT,
    FLOAT: DataType.DOUBLE,
    COUNT: DataType.UINT64,
    **{f"i{bits}": DataType[f"INT{bits}"] for bits in (8, 16, 32, 64)},
    "u8": DataType.UINT8,
    "u16": DataType.UINT16,
    # UInt32 is int_value by the specification, and long_value for many hosts, the libraries of Tahu among them: one of
    # both would read nothing or another number. All read UInt64
    "u32": DataType.UINT64,
    "u64": DataType.UINT64,
}
_SIGNED: Final = frozenset({DataType.INT8, DataType.INT16, DataType.INT32, DataType.INT64})
_WHOLE: Final = _SIGNED | {DataType.UINT8, DataType.UINT16, DataType.UINT32, DataType.UINT64}
_LONG: Final = frozenset({DataType.INT64, DataType.UINT64, DataType.DATE_TIME})
_MASK_32: Final = (1 << 32) - 1
_MASK_64: Final = (1 << 64) - 1


@dataclass(frozen=True, slots=True)
class MetricKind:
    """A metric as a birth describes it. ``alias`` None: it has none (6.4.5)."""

    name: str
    alias: int | None
    type: DataType
    writable: bool = False
    unit: str = ""
    low: float | None = None
    high: float | None = None
    text: str = ""


@dataclass(frozen=True, slots=True)
class Sample:
    """One value of a metric. ``reading``: value, quality, reason; ``time_ms``: source time. ``with_quality``:
    with the quality, even if it is good and has no remark."""

    kind: MetricKind
    reading: Reading
    time_ms: int
    with_quality: bool = False
    historical: bool = False


def birth(samples: Iterable[Sample], seq: int, now_ms: int) -> bytes:
    """The payload of NBIRTH or DBIRTH: names, aliases, types, properties and values."""
    payload = pb.Payload(timestamp=now_ms, seq=seq)
    for sample in _in_order(samples):
        kind = sample.kind
        metric = _add(payload, sample)
        metric.name = kind.name
        metric.datatype = kind.type
        properties = metric.properties
        _add_quality(properties, sample.reading)
        _add_property(properties, "Readonly", DataType.BOOLEAN, not kind.writable)
        for key, text in (("engUnit", kind.unit), ("documentation", kind.text)):
            if text:
                _add_property(properties, key, DataType.STRING, _short(text))
        for key, number in (("engLow", kind.low), ("engHigh", kind.high)):
            if number is not None:
                _add_property(properties, key, DataType.DOUBLE, float(number))
    return payload.SerializeToString()


def data(samples: Iterable[Sample], seq: int, now_ms: int, *, has_types: bool = False) -> bytes:
    """The payload of NDATA or DDATA: aliases and values; names of the metrics that have no alias; with ``has_types``
    the type of each (6.4.6: it may be there)."""
    payload = pb.Payload(timestamp=now_ms, seq=seq)
    for sample in _in_order(samples):
        metric = _add(payload, sample)
        if sample.kind.alias is None:
            metric.name = sample.kind.name
        if has_types:
            metric.datatype = sample.kind.type
        if sample.historical:
            metric.is_historical = True
        if sample.with_quality or sample.reading.has_remark:
            _add_quality(metric.properties, sample.reading)
    return payload.SerializeToString()


def device_death(seq: int, now_ms: int) -> bytes:
    """The payload of DDEATH."""
    return pb.Payload(timestamp=now_ms, seq=seq).SerializeToString()


def node_death(number: int, now_ms: int) -> bytes:
    """The payload of NDEATH: the bdSeq number alone, without a sequence number."""
    payload = pb.Payload(timestamp=now_ms)
    metric = payload.metrics.add(name=BDSEQ.name, datatype=BDSEQ.type, timestamp=now_ms)
    _put(metric, BDSEQ.type, number)
    return payload.SerializeToString()


def rebirth_command(now_ms: int) -> bytes:
    """The payload of an NCMD that asks an edge node for all births."""
    payload = pb.Payload(timestamp=now_ms)
    payload.metrics.add(name=REBIRTH, datatype=DataType.BOOLEAN, timestamp=now_ms, boolean_value=True)
    return payload.SerializeToString()


#: the metric by which a host asks for all births
REBIRTH: Final = "Node Control/Rebirth"
#: the number of a session, 0 to 255, in NBIRTH and NDEATH. Its type is INT64 in all rules of 5.4
BDSEQ: Final = MetricKind("bdSeq", None, DataType.INT64, text="number of this MQTT session")


@dataclass(frozen=True, slots=True)
class Given:
    """One metric of a command as it came."""

    name: str | None
    alias: int | None
    datatype: int | None
    value: Value

    @property
    def text(self) -> str:
        """The metric for people."""
        return f"alias {self.alias}" if self.name is None else f"'{_short(printable(self.name))}'"


@dataclass(frozen=True, slots=True)
class Command:
    """A command as it came. ``time_ms`` None: it has no timestamp."""

    time_ms: int | None
    metrics: tuple[Given, ...]


def read_command(octets: bytes) -> Command:
    """The metrics of NCMD or DCMD. Raises ValueError with a reason; ``octets`` may be anything."""
    if len(octets) > MOST_OCTETS:
        raise ValueError(f"the payload has {len(octets)} octets, at most {MOST_OCTETS} are taken")
    try:
        payload = pb.Payload.FromString(octets)
    except DecodeError:
        raise ValueError("the payload is no Sparkplug B payload") from None
    if len(payload.metrics) > MOST_METRICS:
        raise ValueError(f"the payload has {len(payload.metrics)} metrics, at most {MOST_METRICS} are taken")
    time_ms = payload.timestamp if payload.HasField("timestamp") else None
    return Command(time_ms, tuple(_given(metric) for metric in payload.metrics))


def _given(metric: pb.Metric) -> Given:
    field = metric.WhichOneof("value")
    value: Value = None if field is None or metric.is_null else getattr(metric, field)
    # protobuf gives a text that is not UTF-8 as bytes
    if not isinstance(metric.name, str) or (field == "string_value" and isinstance(value, bytes)):
        raise ValueError("a text of the payload is not UTF-8")
    return Given(
        metric.name if metric.HasField("name") else None,
        metric.alias if metric.HasField("alias") else None,
        metric.datatype if metric.HasField("datatype") else None,
        value,
    )


def value_given(given: Given, wanted: DataType) -> bool | int | float | str | bytes:
    """The value of a metric in a command for a metric of type ``wanted``. Raises ValueError with a reason.

    Numbers of 8 to 32 bits are one field on the wire, as uint32 in two's complement; so the type decides. Senders that
    name the type may fill up to 32 bits (Tahu in Java and JavaScript) or not (Tahu in Python, pysparkplug). A sender
    may name another type that fits.
    """
    value = given.value
    if value is None:
        raise ValueError("it has no value")
    try:
        type_ = wanted if given.datatype is None else DataType(given.datatype)
    except ValueError:
        raise ValueError(f"its type {given.datatype} is not one that a value can have here") from None
    if isinstance(value, int) and not isinstance(value, bool) and type_ in _WHOLE:
        if type_ in _SIGNED:
            value = _signed(value, _width(value, type_, is_named=given.datatype is not None))
    elif not _fits(value, type_):
        raise ValueError(f"its value is no {type_.name}")
    if wanted in _WHOLE:
        fits = isinstance(value, int) and not isinstance(value, bool)
    elif wanted in (DataType.FLOAT, DataType.DOUBLE):
        fits = isinstance(value, (int, float)) and not isinstance(value, bool)
    else:
        fits = _fits(value, wanted)
    if not fits:
        raise ValueError(f"its value is a {type_.name}, the metric is a {wanted.name}")
    return value


def _fits(value: object, type_: DataType) -> bool:
    if type_ in (DataType.STRING, DataType.TEXT):
        return isinstance(value, str)
    if type_ in (DataType.FLOAT, DataType.DOUBLE):
        return isinstance(value, float)
    return isinstance(value, {DataType.BOOLEAN: bool, DataType.BYTES: bytes}.get(type_, ()))


def _width(value: int, type_: DataType, *, is_named: bool) -> int:
    """Bits of the two's complement of ``value``."""
    if value > _MASK_32 or type_ in _LONG:
        return 64
    bits = {DataType.INT8: 8, DataType.INT16: 16}.get(type_, 32)
    return bits if is_named and value < 1 << bits else 32


def _signed(value: int, bits: int) -> int:
    return value - (1 << bits) if value >> (bits - 1) else value


def _in_order(samples: Iterable[Sample]) -> list[Sample]:
    """By time: those of one payload are in chronological order (5.18)."""
    return sorted(samples, key=lambda sample: sample.time_ms)


def _add(payload: pb.Payload, sample: Sample) -> pb.Metric:
    metric = payload.metrics.add(timestamp=sample.time_ms)
    if sample.kind.alias is not None:
        metric.alias = sample.kind.alias
    if sample.reading.value is None:
        metric.is_null = True
    else:
        _put(metric, sample.kind.type, sample.reading.value)
    return metric


def _put(metric: pb.Metric | pb.PropertyValue, type_: DataType, value: bool | int | float | str | bytes) -> None:
    match value:
        case bool():
            metric.boolean_value = value
        case int() if type_ in _LONG:
            metric.long_value = value & _MASK_64
        case int() if type_ in _WHOLE:
            metric.int_value = value & _MASK_32
        case int() | float() if type_ is DataType.FLOAT:
            metric.float_value = value
        case int() | float():
            metric.double_value = value
        case str():
            metric.string_value = value
        case bytes():
            assert isinstance(metric, pb.Metric), "properties have no octets"
            metric.bytes_value = value


def _add_quality(properties: pb.PropertySet, reading: Reading) -> None:
    """Quality (6.4.9), its word, as the number does not distinguish uncertain and stale, and its reason, which is empty
    for a good value, so that it replaces an earlier one."""
    _add_property(properties, "Quality", DataType.INT32, reading.quality.sparkplug)
    _add_property(properties, "Quality word", DataType.STRING, reading.quality.value)
    _add_property(properties, "Quality reason", DataType.STRING, _short(reading.text))


def _add_property(properties: pb.PropertySet, key: str, type_: DataType, value: bool | int | float | str) -> None:
    properties.keys.append(key)
    _put(properties.values.add(type=type_), type_, value)


def _short(text: str) -> str:
    return shortened(printable(text), _MOST_TEXT)
