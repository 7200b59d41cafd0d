"""A host of Sparkplug B that knows only the specification (3.0.0): octets in; metrics with values and quality out.

It reads the wire format of protobuf by itself, and asserts the rules that bind an edge node. Tests use it as judge.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final

GOOD, STALE, BAD = 192, 500, 0
#: Sparkplug types of whole numbers, with their bits
SIGNED: Final = {1: 8, 2: 16, 3: 32, 4: 64}
UNSIGNED: Final = {5: 8, 6: 16, 7: 32, 8: 64}
FLOAT, DOUBLE, BOOLEAN, STRING, BYTES = 9, 10, 11, 12, 17
#: the field of a metric that holds a value of a type (6.4.16)
FIELD_OF: Final = {
    **dict.fromkeys((1, 2, 3, 5, 6, 7), 10),
    4: 11,
    8: 11,
    FLOAT: 12,
    DOUBLE: 13,
    BOOLEAN: 14,
    STRING: 15,
    BYTES: 16,
}


# --- the wire format ----------------------------------------------------------------------------------------------


def fields(octets: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Field number and raw value of each field of a message of protobuf."""
    at = 0
    while at < len(octets):
        key, at = varint(octets, at)
        number, wire = key >> 3, key & 7
        if wire == 0:
            value, at = varint(octets, at)
            yield number, value
            continue
        if wire == 2:
            length, at = varint(octets, at)
        else:
            length = {1: 8, 5: 4}[wire]
        assert at + length <= len(octets)
        yield number, octets[at : at + length]
        at += length


def varint(octets: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        octet = octets[at]
        value |= (octet & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if octet < 0x80:
            return value, at


def tag(number: int, value: int | bytes | float) -> bytes:
    """One field for a message that a test makes: varint, octets or double."""
    if isinstance(value, float):
        return _varint(number << 3 | 1) + struct.pack("<d", value)
    if isinstance(value, bytes):
        return _varint(number << 3 | 2) + _varint(len(value)) + value
    return _varint(number << 3) + _varint(value)


def _varint(value: int) -> bytes:
    made = bytearray()
    while value >= 0x80:
        made.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*made, value])


@dataclass
class Metric:
    """A metric as it came. ``raw``: the number of the field of its value, and its content."""

    name: str | None = None
    alias: int | None = None
    timestamp: int | None = None
    datatype: int | None = None
    historical: bool = False
    null: bool = False
    raw: tuple[int, int | bytes] | None = None
    properties: dict[str, Any] = field(default_factory=dict)
    property_types: dict[str, int] = field(default_factory=dict)

    def value(self, datatype: int) -> Any:
        if self.null:
            assert self.raw is None, "a metric that is null has no value (5.18)"
            return None
        assert self.raw is not None, self
        number, raw = self.raw
        assert number == FIELD_OF[datatype], (self, datatype)
        return _value(raw, datatype)


def _value(raw: int | bytes, datatype: int) -> Any:
    if isinstance(raw, int):
        if datatype == BOOLEAN:
            assert raw in (0, 1)
            return bool(raw)
        if datatype in SIGNED:
            bits = 64 if datatype == 4 else 32
            value = raw - (1 << bits) if raw >> (bits - 1) else raw
            assert -1 << (SIGNED[datatype] - 1) <= value < 1 << (SIGNED[datatype] - 1)
            return value
        assert raw < 1 << UNSIGNED[datatype]
        return raw
    if datatype == FLOAT:
        return struct.unpack("<f", raw)[0]
    if datatype == DOUBLE:
        return struct.unpack("<d", raw)[0]
    return raw.decode() if datatype == STRING else raw


@dataclass
class Payload:
    timestamp: int | None = None
    seq: int | None = None
    metrics: list[Metric] = field(default_factory=list)


def read_payload(octets: bytes) -> Payload:
    payload = Payload()
    for number, value in fields(octets):
        if number == 1:
            assert isinstance(value, int)
            payload.timestamp = value
        elif number == 2:
            assert isinstance(value, bytes)
            payload.metrics.append(_metric(value))
        elif number == 3:
            assert isinstance(value, int)
            payload.seq = value
        else:
            raise AssertionError(f"field {number} of a payload")
    return payload


def _metric(octets: bytes) -> Metric:
    metric = Metric()
    for number, value in fields(octets):
        if number == 1:
            assert isinstance(value, bytes)
            metric.name = value.decode()
        elif number in (2, 3, 4, 5, 7):
            assert isinstance(value, int)
            setattr(metric, {2: "alias", 3: "timestamp", 4: "datatype", 5: "historical", 7: "null"}[number], value)
        elif number == 9:
            assert isinstance(value, bytes)
            metric.properties, metric.property_types = _properties(value)
        else:
            assert 10 <= number <= 16, f"field {number} of a metric"
            assert metric.raw is None
            metric.raw = number, value
    return metric


def _properties(octets: bytes) -> tuple[dict[str, Any], dict[str, int]]:
    keys: list[str] = []
    values: list[tuple[int, Any]] = []
    for number, value in fields(octets):
        assert isinstance(value, bytes)
        if number == 1:
            keys.append(value.decode())
            continue
        assert number == 2
        found = dict(fields(value))
        type_ = found.pop(1)
        assert isinstance(type_, int)
        (where, raw), *more = found.items()
        assert not more
        # as of a metric, without its octets: 3 to 8
        assert where == FIELD_OF[type_] - 7
        values.append((type_, _value(raw, type_)))
    assert len(keys) == len(values) == len(set(keys))  # tck-id-payloads-propertyset-keys-array-size
    return dict(zip(keys, (value for _, value in values), strict=True)), dict(
        zip(keys, (type_ for type_, _ in values), strict=True)
    )


# --- the host -----------------------------------------------------------------------------------------------------


@dataclass
class Known:
    """A metric as a host shows it."""

    name: str
    datatype: int
    value: Any
    quality: int
    timestamp: int
    properties: dict[str, Any]


class Host:
    """Follows one edge node. ``node`` and ``devices``: metrics by alias; those of a death stay, and are stale.

    ``messages``: kind, device and payload of everything that came.
    """

    def __init__(self, group: str, node: str, *, has_types: bool = False) -> None:
        self.has_types = has_types
        self.group, self.id = group, node
        self.online = False
        self.number: int | None = None
        self.seq = 0
        self.node: dict[int, Known] = {}
        self.devices: dict[str, dict[int, Known]] = {}
        self.alive: set[str] = set()
        self.messages: list[tuple[str, str | None, Payload]] = []

    def metric(self, name: str, device: str | None = None) -> Known:
        metrics = self.node if device is None else self.devices[device]
        return next(one for one in metrics.values() if one.name == name)

    def alias(self, name: str, device: str | None = None) -> int:
        metrics = self.node if device is None else self.devices[device]
        return next(alias for alias, one in metrics.items() if one.name == name)

    def lose_broker(self) -> None:
        """The host itself has lost its connection: nothing is known (5.3)."""
        self._die()

    def feed(self, topic: str, octets: bytes, *, qos: int = 0, retain: bool = False) -> None:
        namespace, group, kind, node, *rest = topic.split("/")
        assert (namespace, group, node) == ("spBv1.0", self.group, self.id)
        device = rest[0] if rest else None
        assert len(rest) == (kind in ("DBIRTH", "DDATA", "DDEATH"))
        assert retain is False
        payload = read_payload(octets)
        self.messages.append((kind, device, payload))
        if kind == "NDEATH":
            self._node_death(payload)
            return
        assert qos == 0
        assert payload.timestamp is not None
        assert payload.seq is not None
        if kind == "NBIRTH":
            assert payload.seq == 0
        else:
            assert self.online, f"{kind} of an edge node that is offline"
            assert payload.seq == (self.seq + 1) % 256
        self.seq = payload.seq
        for metric in payload.metrics:
            assert metric.timestamp is not None  # tck-id-payloads-name-birth-data-requirement
            assert metric.timestamp <= payload.timestamp
        times = [metric.timestamp or 0 for metric in payload.metrics if not metric.historical]
        assert times == sorted(times)  # tck-id-operational-behavior-data-publish-nbirth-order
        match kind:
            case "NBIRTH":
                self._node_birth(payload)
            case "DBIRTH":
                assert device is not None
                self.devices[device] = self._birth(payload, without_alias=())
                self.alive.add(device)
            case "NDATA":
                self._data(self.node, payload)
            case "DDATA":
                assert device in self.alive, f"DDATA of {device}, which is offline"
                self._data(self.devices[device], payload)
            case "DDEATH":
                assert device in self.alive, f"DDEATH of {device}, which is offline"
                assert not payload.metrics
                self.alive.discard(device)
                _make_stale(self.devices[device])
            case _:
                raise AssertionError(f"an edge node never sends {kind}")

    def _node_birth(self, payload: Payload) -> None:
        self._die()
        self.online = True
        self.devices = {}
        self.node = {}
        self.node = self._birth(payload, without_alias=("Node Control/Rebirth",))
        (rebirth,) = [one for one in payload.metrics if one.name == "Node Control/Rebirth"]
        assert rebirth.alias is None
        assert rebirth.datatype == BOOLEAN
        assert rebirth.value(BOOLEAN) is False
        (number,) = [one for one in payload.metrics if one.name == "bdSeq"]
        assert number.datatype == 4
        self.number = number.value(4)
        assert self.number in range(256)

    def _node_death(self, payload: Payload) -> None:
        assert payload.seq is None
        (metric,) = payload.metrics
        assert metric.name == "bdSeq"
        assert metric.datatype == 4
        if metric.value(4) == self.number:
            self._die()

    def _die(self) -> None:
        self.online = False
        self.alive.clear()
        _make_stale(self.node)
        for metrics in self.devices.values():
            _make_stale(metrics)

    def _birth(self, payload: Payload, *, without_alias: tuple[str, ...]) -> dict[int, Known]:
        taken = {alias for metrics in (self.node, *self.devices.values()) for alias in metrics}
        names: set[str] = set()
        found: dict[int, Known] = {}
        mine = [self.devices[one] for one in self.devices if one == self.messages[-1][1]]
        taken -= {alias for metrics in mine for alias in metrics}
        for metric in payload.metrics:
            assert metric.name
            assert metric.name.casefold() not in names  # tck-id-case-sensitivity-metric-names
            names.add(metric.name.casefold())
            assert metric.datatype in FIELD_OF
            assert metric.timestamp is not None
            value = metric.value(metric.datatype)
            assert (metric.alias is None) == (metric.name in without_alias)
            quality = _quality(metric)
            assert quality is not None
            assert value is not None or quality == BAD
            if metric.alias is not None:
                assert metric.alias not in taken
                assert metric.alias not in found
                found[metric.alias] = Known(
                    metric.name, metric.datatype, value, quality, metric.timestamp, metric.properties
                )
        return found

    def _data(self, metrics: dict[int, Known], payload: Payload) -> None:
        assert payload.metrics
        for metric in payload.metrics:
            assert metric.name is None  # tck-id-payloads-alias-data-cmd-requirement
            assert metric.alias is not None
            known = metrics[metric.alias]
            assert metric.datatype == (known.datatype if self.has_types else None)
            value = metric.value(known.datatype)
            quality = _quality(metric)
            if metric.historical:
                continue
            known.value = value
            known.quality = known.quality if quality is None else quality
            known.timestamp = metric.timestamp or 0
            known.properties |= metric.properties
            assert value is not None or known.quality == BAD


def _quality(metric: Metric) -> int | None:
    quality = metric.properties.get("Quality")
    if quality is not None:
        assert metric.property_types["Quality"] == 3
        assert quality in (BAD, GOOD, STALE)
    return quality


def _make_stale(metrics: dict[int, Known]) -> None:
    for known in metrics.values():
        known.quality = STALE
