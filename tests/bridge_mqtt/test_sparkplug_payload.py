"""Payloads of Sparkplug B against a reader of the wire format of its own; commands of strangers, also garbage."""

from __future__ import annotations

import contextlib
import struct
from typing import Any

import pytest
from edge_node_rig import metric
from hypothesis import example, given
from hypothesis import strategies as st
from property_kit import examples
from sparkplug_host import read_payload, tag

from dpstack.bridge.mqtt.payload import (
    DATA_TYPES,
    MOST_METRICS,
    MOST_OCTETS,
    DataType,
    Given,
    MetricKind,
    Sample,
    birth,
    data,
    device_death,
    node_death,
    read_command,
    value_given,
)
from dpstack.plant.quality import LIMITS, TYPES, Reading, Reason, Value
from tools import make_sparkplug_proto

NOW = 1_700_000_000_123


def kind(type_: DataType, **more: Any) -> MetricKind:
    return MetricKind("a/b", 7, type_, **more)


@pytest.mark.check
def test_the_module_of_protobuf_is_made_from_our_proto() -> None:
    for name, text in make_sparkplug_proto.made().items():
        assert (make_sparkplug_proto.SOURCE.parent / name).read_text(encoding="utf-8") == text, (
            f"{name} is old: python -m tools.make_sparkplug_proto"
        )


def test_every_type_of_a_node_has_a_type_of_sparkplug() -> None:
    assert set(DATA_TYPES) == TYPES


_values = st.one_of(
    *(st.tuples(st.just(name), st.integers(low, high)) for name, (low, high) in LIMITS.items()),
    st.tuples(st.just("bool"), st.booleans()),
    st.tuples(st.just("text"), st.text(st.characters(exclude_categories=["Cs"]), max_size=40)),
    st.tuples(st.just("bytes"), st.binary(max_size=20)),
    st.tuples(st.just("f32"), st.floats(width=32, allow_nan=False)),
    st.tuples(st.just("f64"), st.floats(allow_nan=False)),
)


@examples(100)
@given(_values, st.integers(0, 255))
@example(("i8", -128), 0)
@example(("u64", 2**64 - 1), 0)
@example(("i64", -(2**63)), 0)
def test_a_value_is_the_same_at_a_host(pair: tuple[str, Value], seq: int) -> None:
    type_, value = pair
    samples = [Sample(kind(DATA_TYPES[type_]), Reading(value, Reason.GOOD), NOW - 5)]
    for octets in (birth(samples, seq, NOW), data(samples, seq, NOW)):
        payload = read_payload(octets)
        assert (payload.timestamp, payload.seq) == (NOW, seq)
        (found,) = payload.metrics
        assert found.value(int(DATA_TYPES[type_])) == value
        assert (found.alias, found.timestamp) == (7, NOW - 5)


def test_a_birth_describes_a_metric() -> None:
    described = kind(DataType.DOUBLE, unit="bar", low=-5, high=7.5, text="pressure", writable=True)
    (found,) = read_payload(birth([Sample(described, Reading(1.5, Reason.GOOD), NOW)], 0, NOW)).metrics
    assert (found.name, found.datatype) == ("a/b", 10)
    assert found.properties == {
        "Quality": 192,
        "Quality word": "good",
        "Quality reason": "",
        "Readonly": False,
        "engUnit": "bar",
        "documentation": "pressure",
        "engLow": -5.0,
        "engHigh": 7.5,
    }


@pytest.mark.parametrize(
    ("reading", "told", "properties"),
    [
        (Reading(3, Reason.GOOD), False, None),
        (Reading(3, Reason.GOOD), True, (192, "good", "")),
        (
            Reading(3, Reason.TOO_OLD, note="limit 100 ms"),
            False,
            (500, "stale", "the inputs are older than the watchdog of the slave: limit 100 ms"),
        ),
        (
            Reading(3, Reason.CHANNEL_LIMIT, note="upper limit value exceeded: slot 3, input channel 0"),
            False,
            (500, "uncertain", "upper limit value exceeded: slot 3, input channel 0"),
        ),
        (
            Reading(3, Reason.CHANNEL_FAULT, note="line break: slot 3, input channel 0"),
            False,
            (0, "bad", "line break: slot 3, input channel 0"),
        ),
        (
            Reading(3, Reason.STATUS_GOOD, note="maintenance required (status A4)"),
            False,
            (192, "good", "maintenance required (status A4)"),
        ),
        (Reading(None, Reason.NO_VALUE), False, (0, "bad", "there is no valid value")),
    ],
)
def test_data_say_the_quality_where_it_is_not_good_or_has_become_good(
    reading: Reading, told: bool, properties: tuple[int, str, str] | None
) -> None:
    (found,) = read_payload(data([Sample(kind(DataType.INT32), reading, NOW, told)], 9, NOW)).metrics
    names = "Quality", "Quality word", "Quality reason"
    assert found.properties == ({} if properties is None else dict(zip(names, properties, strict=True)))
    assert found.null == (reading.value is None)
    assert (found.name, found.datatype) == (None, None)


def test_data_have_the_type_if_the_configuration_says_so() -> None:
    kind = MetricKind("Inputs/level", 7, DataType.INT16)
    sample = Sample(kind, Reading(-2, Reason.GOOD), NOW)
    plain = "08fbd095ffbc31120f100718fbd095ffbc3150feffffff0f1801"
    assert data([sample], 1, NOW).hex() == plain
    typed = data([sample], 1, NOW, has_types=True).hex()
    # field 4, the type: 2 is Int16
    assert typed == plain.replace("120f", "1211").replace("50feff", "200250feff")


def test_historical_values_say_so_and_all_are_in_the_order_of_time() -> None:
    samples = [
        Sample(kind(DataType.INT32), Reading(2, Reason.GOOD), NOW),
        Sample(kind(DataType.INT32), Reading(1, Reason.GOOD), NOW - 9, historical=True),
    ]
    found = read_payload(data(samples, 9, NOW)).metrics
    assert [(one.historical, one.timestamp) for one in found] == [(1, NOW - 9), (False, NOW)]


def test_deaths() -> None:
    death = read_payload(node_death(255, NOW))
    assert death.seq is None
    assert [(one.name, one.value(4)) for one in death.metrics] == [("bdSeq", 255)]
    assert read_payload(device_death(3, NOW)).seq == 3
    assert read_payload(device_death(3, NOW)).metrics == []


# --- commands -----------------------------------------------------------------------------------------------------


def only(octets: bytes) -> Given:
    (found,) = read_command(tag(2, octets)).metrics
    return found


@pytest.mark.parametrize(
    ("octets", "wanted", "value"),
    [
        (metric("x", boolean=True), DataType.BOOLEAN, True),
        (metric("x", double=2.5), DataType.DOUBLE, 2.5),
        (tag(1, b"x") + b"\x65" + struct.pack("<f", 1.5), DataType.DOUBLE, 1.5),
        (metric("x", whole=200), DataType.UINT8, 200),
        (metric("x", whole=2**32 - 3), DataType.INT8, -3),
        (metric("x", long=2**64 - 3), DataType.INT64, -3),
        (metric("x", whole=2**32 - 3, datatype=3), DataType.DOUBLE, -3),
        (metric("x", whole=253, datatype=1), DataType.INT8, -3),  # as Tahu writes it in Python
        (metric("x", whole=2**16 - 3, datatype=2), DataType.INT16, -3),
        (metric("x", whole=200), DataType.INT8, 200),  # out of its range: the order refuses it
        (metric("x", text="on"), DataType.STRING, "on"),
        (metric("x", text="on", datatype=14), DataType.STRING, "on"),
        (metric("x", octets=b"\x01\xff"), DataType.BYTES, b"\x01\xff"),
    ],
)
def test_the_value_of_a_command(octets: bytes, wanted: DataType, value: object) -> None:
    found = value_given(only(octets), wanted)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("octets", "wanted", "text"),
    [
        (metric("x"), DataType.BOOLEAN, "it has no value"),
        (metric("x", boolean=True) + tag(7, 1), DataType.BOOLEAN, "it has no value"),
        (metric("x", whole=1), DataType.BOOLEAN, "its value is no BOOLEAN"),
        (metric("x", boolean=True), DataType.UINT8, "its value is no UINT8"),
        (metric("x", double=1.0), DataType.UINT8, "its value is no UINT8"),
        (metric("x", whole=1), DataType.DOUBLE, "its value is no DOUBLE"),
        (metric("x", boolean=True, datatype=11), DataType.DOUBLE, "its value is a BOOLEAN, the metric is a DOUBLE"),
        (metric("x", boolean=True, datatype=12), DataType.BOOLEAN, "its value is no STRING"),
        (metric("x", boolean=True, datatype=99), DataType.BOOLEAN, "its type 99 is not one that a value can have here"),
        (metric("x") + tag(17, b""), DataType.BOOLEAN, "it has no value"),  # a DataSet
    ],
)
def test_a_value_of_another_type_is_refused(octets: bytes, wanted: DataType, text: str) -> None:
    with pytest.raises(ValueError) as caught:
        value_given(only(octets), wanted)
    assert str(caught.value) == text


@pytest.mark.parametrize(
    ("octets", "text"),
    [
        (bytes(MOST_OCTETS + 1), f"the payload has {MOST_OCTETS + 1} octets, at most {MOST_OCTETS} are taken"),
        (tag(2, b"") * (MOST_METRICS + 1), f"the payload has {MOST_METRICS + 1} metrics, at most 100 are taken"),
        (b"\xff" * 11, "the payload is no Sparkplug B payload"),
        (tag(2, b"")[:-1] + b"\x05", "the payload is no Sparkplug B payload"),
        (tag(2, tag(1, b"\xff\xfe")), "a text of the payload is not UTF-8"),
        (tag(2, tag(15, b"\xff\xfe")), "a text of the payload is not UTF-8"),
    ],
)
def test_a_payload_that_is_none_or_too_large_is_refused(octets: bytes, text: str) -> None:
    with pytest.raises(ValueError) as caught:
        read_command(octets)
    assert str(caught.value) == text


@examples(80)
@given(st.binary(max_size=200) | st.binary(max_size=60).map(lambda one: tag(2, one)))
def test_garbage_is_a_command_or_refused(octets: bytes) -> None:
    command = None
    with contextlib.suppress(ValueError):
        command = read_command(octets)
    for given_ in () if command is None else command.metrics:
        assert given_.text.isprintable()
        for wanted in DataType:
            with contextlib.suppress(ValueError):
                assert isinstance(value_given(given_, wanted), (bool, int, float, str, bytes))


def test_the_page_has_every_type() -> None:
    page = (make_sparkplug_proto.ROOT / "docs" / "reference" / "sparkplug.md").read_text(encoding="utf-8")
    written: dict[str, str] = {}
    for line in page.partition("| type of Sparkplug |")[2].partition("\n\n")[0].splitlines()[2:]:
        ours, theirs = (cell.strip().removesuffix(", scaled values").split(", ") for cell in line.strip("|").split("|"))
        written |= dict(zip(ours, theirs, strict=True))
    assert written == {name: type_.name.title().replace("Uint", "UInt") for name, type_ in DATA_TYPES.items()}
