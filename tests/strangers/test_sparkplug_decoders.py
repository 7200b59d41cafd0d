"""Payloads of a session against two decoders of Sparkplug B from PyPI, each in an environment of its own, and against
sparkplug-payload from npm, the decoder of the Eclipse Tahu project; and commands that they encode."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any, Final

import pytest
from edge_node_rig import GROUP, NODE, Rig
from history_rig import HistoryRig

from dpstack.bridge.mqtt.payload import DATA_TYPES, DataType, MetricKind, Sample, birth, read_command, value_given
from dpstack.plant.quality import LIMITS, Reading, Reason, Value
from tests.strangers.stranger_kit import environment, npm_folder

pytestmark = pytest.mark.strangers

NOW: Final = 1_700_000_000_123
VALUES: Final[list[tuple[str, Value]]] = [
    *((name, limit) for name, limits in LIMITS.items() for limit in limits),
    ("bool", True),
    ("bool", False),
    ("text", "größer als 5 ☃"),
    ("bytes", b"\x00\xff"),
    ("f32", 1.5),
    ("f64", -1e300),
]
#: each line: the kind of the message and its payload as hex; written is a line of JSON with its metrics
PYSPARKPLUG: Final = """
import json, sys
import pysparkplug as spb
births = {}
for line in sys.stdin:
    kind, device, octets = line.split()
    birth = births.get(device)
    found = getattr(spb, kind).decode(bytes.fromhex(octets), birth=None if "Birth" in kind else birth)
    if "Birth" in kind:
        births[device] = found
    metrics = [
        {"name": one.name, "type": one.datatype.name, "value": one.value, "time": one.timestamp,
         "historical": one.is_historical, "null": one.is_null}
        for one in getattr(found, "metrics", ())
    ]
    death = getattr(found, "bd_seq_metric", None)
    number = None if death is None else death.value
    print(json.dumps({"seq": getattr(found, "seq", None), "bdSeq": number, "metrics": metrics}))
"""
ENCODES: Final = """
import json, sys
import pysparkplug as spb
for line in sys.stdin:
    type_, value = json.loads(line)
    metric = spb.Metric(timestamp=%d, name="Outputs/x", datatype=spb.DataType[type_], value=value)
    print(spb.DCmd(timestamp=%d, metrics=(metric,)).encode(include_dtypes=True).hex())
""" % (NOW, NOW)  # noqa: UP031  braces of the program
WRAPPER: Final = """
import json, sys
from mqtt_spb_wrapper import SpbPayloadParser
for line in sys.stdin:
    kind, device, octets = line.split()
    found = SpbPayloadParser().parse_payload(bytes.fromhex(octets))
    metrics = [{key: one.get(key) for key in ("name", "alias", "value", "isNull")} for one in found.get("metrics", ())]
    print(json.dumps({"seq": int(found.get("seq", 0)), "metrics": metrics}))
"""
#: reads payloads as hex, one a line, writes them as JSON; a line that begins with { is a payload to encode. It reads no
#: value without a type, which data have in births only (tck-id-payloads-metric-datatype-not-req): so each metric gets
#: the type that a birth gave to its alias, as a host does it
PAYLOAD: Final = """
const spb = require("sparkplug-payload").get("spBv1.0");
const Payload = require("sparkplug-payload/lib/sparkplugPayloadProto").org.eclipse.tahu.protobuf.Payload;
const types = {};
const typed = (octets) => {
    const payload = Payload.decode(octets);
    for (const metric of payload.metrics) {
        if (metric.datatype) types[metric.alias] = metric.datatype;
        else if (types[metric.alias]) metric.datatype = types[metric.alias];
    }
    return Payload.encode(payload).finish();
};
const plain = (key, value) => value && value.constructor && value.constructor.name === "Long" ? "" + value : value;
const asIs = process.argv.includes("as-is");
for (const line of require("fs").readFileSync(0, "utf8").trim().split("\\n")) {
    if (line.startsWith("{")) {
        console.log(Buffer.from(spb.encodePayload(JSON.parse(line))).toString("hex"));
    } else {
        const octets = Buffer.from(line, "hex");
        const decoded = spb.decodePayload(asIs ? octets : typed(octets));
        console.log(JSON.stringify(decoded, asIs ? undefined : plain));
    }
}
"""


@pytest.fixture(scope="module")
def pysparkplug(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return environment(tmp_path_factory.mktemp("pysparkplug"), "pysparkplug==0.6.1")


@pytest.fixture(scope="module")
def wrapper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return environment(tmp_path_factory.mktemp("wrapper"), "mqtt-spb-wrapper==2.1.2")


@pytest.fixture(scope="module")
def npm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return npm_folder(tmp_path_factory.mktemp("npm"), "sparkplug-payload@1.0.3")


def told(words: list[str | Path], lines: list[str], folder: Path | None = None) -> list[str]:
    """The output of a program for these lines."""
    run = subprocess.run(
        words, input="\n".join(lines), cwd=folder, text=True, capture_output=True, timeout=60, check=False
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


def asked(python: Path, program: str, lines: list[str]) -> list[str]:
    return told([python, "-I", "-c", program], lines)


def asked_npm(folder: Path, lines: list[str], *, as_is: bool = False) -> list[Any]:
    """``as_is``: as a program that hands each payload to the decoder, and shows what it returns."""
    words = ["as-is"] if as_is else []
    return [json.loads(line) for line in told(["node", "-e", PAYLOAD, *words], lines, folder)]


def session(folder: Path, count: int, *, has_types: bool = False) -> list[tuple[str, str, bytes]]:
    """Kind as pysparkplug names it, device and payload of the messages of a session: births, data, deaths."""
    rig = Rig(folder, has_types=has_types)
    rig.values["8"]["fields"]["count"] = count
    rig.give_plant()
    rig.join()
    rig.values["8"]["fields"]["count"] = 100
    rig.values["8"]["inputs_age_ms"] = 500.0
    rig.turn()
    rig.values["8"]["state"] = "offline"
    rig.turn()
    rig.node.end("the end")
    rig.pump()
    rig.close()
    assert rig.sent[0].topic == f"spBv1.0/{GROUP}/NBIRTH/{NODE}"
    found = []
    for one in rig.sent:
        _, _, kind, _, *device = one.topic.split("/")
        found.append((kind[0] + kind[1:].title(), device[0] if device else "-", one.payload))
    return found


def as_lines(messages: list[tuple[str, str, bytes]]) -> list[str]:
    return [f"{kind} {device} {payload.hex()}" for kind, device, payload in messages]


def test_pysparkplug_reads_a_session(pysparkplug: Path, tmp_path: Path) -> None:
    messages = session(tmp_path, 3)
    kinds = [kind for kind, _, _ in messages]
    assert kinds == ["NBirth", "DBirth", "DBirth", "DData", "DDeath", "NDeath"]
    found = [json.loads(line) for line in asked(pysparkplug, PYSPARKPLUG, as_lines(messages))]
    assert [one["seq"] for one in found[:5]] == [0, 1, 2, 3, 4]
    assert {one["name"]: one["value"] for one in found[0]["metrics"]}["bdSeq"] == found[5]["bdSeq"] == 0
    valves = next(n for n, (kind, device, _) in enumerate(messages) if (kind, device) == ("DBirth", "valves"))
    born = {one["name"]: one for one in found[valves]["metrics"]}
    assert (born["Inputs/count"]["type"], born["Inputs/count"]["value"]) == ("INT8", 3)
    data = {one["name"]: one for one in found[3]["metrics"]}
    assert "Inputs/limit" in data, "it finds the name of an alias in the birth"
    assert not any(one["historical"] for one in found[3]["metrics"])


def test_mqtt_spb_wrapper_reads_a_session(wrapper: Path, tmp_path: Path) -> None:
    messages = session(tmp_path, -3)
    found: list[dict[str, Any]] = [json.loads(line) for line in asked(wrapper, WRAPPER, as_lines(messages))]
    assert [one["seq"] for one in found[:5]] == [0, 1, 2, 3, 4]
    valves = next(n for n, (kind, device, _) in enumerate(messages) if (kind, device) == ("DBirth", "valves"))
    born = {one["name"]: one for one in found[valves]["metrics"]}
    assert born["Inputs/count"]["value"] == -3
    assert {int(one["alias"]) for one in found[3]["metrics"]} <= {int(one["alias"]) for one in born.values()}
    (number,) = found[5]["metrics"]
    assert (number["name"], number["value"]) == ("bdSeq", 0)


def test_npm_reads_a_session(npm: Path, tmp_path: Path) -> None:
    messages = session(tmp_path, -3)
    found = asked_npm(npm, [payload.hex() for *_, payload in messages])
    assert [int(one["seq"]) for one in found[:5]] == [0, 1, 2, 3, 4]
    names = {one["name"]: one for one in found[2]["metrics"]}
    assert (names["Inputs/count"]["type"], names["Inputs/count"]["value"]) == ("Int8", -3)
    data = {int(one["alias"]): one for one in found[3]["metrics"]}
    assert data[int(names["Inputs/limit"]["alias"])]["properties"]["Quality"]["value"] == 500
    (number,) = found[5]["metrics"]
    assert (number["name"], int(number["value"])) == ("bdSeq", 0)


@pytest.mark.parametrize("has_types", [False, True])
def test_npm_alone_reads_data_by_the_types_in_them(npm: Path, tmp_path: Path, has_types: bool) -> None:
    """docs/reference/sparkplug.md, readers of others: without the key ``datatypes`` each value of data is null."""
    messages = session(tmp_path, -3, has_types=has_types)
    found = asked_npm(npm, [payload.hex() for *_, payload in messages], as_is=True)
    aliases = {one["alias"]["low"]: one["name"] for one in found[2]["metrics"] if one.get("alias")}
    data = {aliases[one["alias"]["low"]]: one["value"] for one in found[3]["metrics"]}
    assert (data["Inputs/count"], data["Inputs/level"]) == ((-3, 12.5) if has_types else (None, None))
    # a whole number of 64 bits is an object
    exchanges = next(one for one in found[2]["metrics"] if one["name"] == "Statistics/exchanges")
    assert (exchanges["type"], exchanges["value"]) == ("UInt64", {"low": 5, "high": 0, "unsigned": True})


def test_pysparkplug_has_no_quality_and_the_wrapper_writes_state_below_a_group(
    pysparkplug: Path, wrapper: Path
) -> None:
    """The rest of docs/reference/sparkplug.md, readers of others."""
    fields = "import dataclasses, pysparkplug as s; print([one.name for one in dataclasses.fields(s.Metric)])"
    (line,) = asked(pysparkplug, fields, [])
    assert "value" in line
    assert not any(word in line for word in ("propert", "quality"))
    states = """
from unittest import mock
from mqtt_spb_wrapper import MqttSpbEntityScada
host = MqttSpbEntityScada("hall 3", "scada")
host._mqtt = mock.Mock()
host.publish_birth()
print(host._mqtt.publish.call_args)
"""
    (line,) = asked(wrapper, states, [])
    assert "spBv1.0/hall 3/STATE/scada" in line


def values_of_every_type() -> list[tuple[str, str, bytes]]:
    payloads = []
    for number, (type_, value) in enumerate(VALUES):
        kind = MetricKind(f"a/{number}", number + 1, DATA_TYPES[type_], unit="bar")
        payloads.append(("DBirth", f"d{number}", birth([Sample(kind, Reading(value, Reason.GOOD), NOW)], 1, NOW)))
    return payloads


def test_values_of_every_type_for_npm(npm: Path) -> None:
    found_lines = asked_npm(npm, [payload.hex() for *_, payload in values_of_every_type()])
    for (type_, value), line in zip(VALUES, found_lines, strict=True):
        (found,) = line["metrics"]
        shown: Any = found["value"]
        if isinstance(value, int) and not isinstance(value, bool):
            shown = int(shown)
        elif isinstance(value, bytes):
            shown = bytes(shown["data"])
        assert shown == value, (type_, found)
        assert found["type"].upper() == DATA_TYPES[type_].name
        assert found["properties"]["Quality"] == {"type": "Int32", "value": 192}
        assert found["properties"]["engUnit"]["value"] == "bar"


def test_values_of_every_type(pysparkplug: Path, wrapper: Path) -> None:
    lines = as_lines(values_of_every_type())
    plain = [n for n, (type_, _) in enumerate(VALUES) if type_ != "bytes"]
    # pysparkplug ends at negative numbers of 8 and 16 bits that are filled up to 32, as Tahu does it in Java
    some = [n for n in plain if VALUES[n][0] not in ("i8", "i16") or int(VALUES[n][1] or 0) >= 0]
    for program, python, which in ((PYSPARKPLUG, pysparkplug, some), (WRAPPER, wrapper, plain)):
        found_lines = asked(python, program, [lines[n] for n in which])
        for (type_, value), line in zip([VALUES[n] for n in which], found_lines, strict=True):
            (found,) = json.loads(line)["metrics"]
            assert found["value"] == value, (python, type_, found)
            assert found.get("type", DATA_TYPES[type_].name) == DATA_TYPES[type_].name


COMMANDS: Final[list[tuple[str, object]]] = [
    ("BOOLEAN", True),
    ("INT8", -3),
    ("INT16", -300),
    ("INT32", -70_000),
    ("INT64", -(1 << 62)),
    ("UINT8", 200),
    ("UINT16", 60_000),
    ("UINT32", 4_000_000_000),
    ("UINT64", 1 << 63),
    ("FLOAT", 1.5),
    ("DOUBLE", -2.25),
    ("STRING", "on"),
]


def is_read(line: str, type_: str, value: object) -> None:
    command = read_command(bytes.fromhex(line))
    assert command.time_ms == NOW
    (given,) = command.metrics
    assert given.name == "Outputs/x"
    assert value_given(given, DataType[type_]) == value


def test_commands_that_pysparkplug_encodes(pysparkplug: Path) -> None:
    lines = asked(pysparkplug, ENCODES, [json.dumps(one) for one in COMMANDS])
    for (type_, value), line in zip(COMMANDS, lines, strict=True):
        is_read(line, type_, value)


@pytest.mark.parametrize(("type_", "value"), [one for one in COMMANDS if one[0] not in ("INT64", "UINT64")])
def test_commands_that_npm_encodes(npm: Path, type_: str, value: object) -> None:
    named = type_.title().replace("Uint", "UInt")
    text = {"timestamp": NOW, "metrics": [{"name": "Outputs/x", "type": named, "value": value, "timestamp": NOW}]}
    (line,) = told(["node", "-e", PAYLOAD], [json.dumps(text)], npm)
    is_read(line, type_, value)


def test_births_come_first_and_then_history_in_order(npm: Path, tmp_path: Path) -> None:
    """Five values of an outage, and one behind it; the values that the birth has do not come again."""
    rig = HistoryRig(tmp_path)
    rig.give_plant()
    rig.join()
    rig.round_trip()
    rig.cut()
    wall = rig.wall
    for _ in range(5):
        rig.count()
    rig.step_disk()
    rig.connect()
    published = []
    for _ in range(10):
        rig.pump()
        published += [message for message, _ in rig.wire]
        rig.round_trip()
        rig.step_disk()
        rig.wait(0.1)
    rig.count()
    rig.pump()
    published += [message for message, _ in rig.wire]
    rig.close()
    found = asked_npm(npm, [one.payload.hex() for one in published])
    kinds = [one.topic.split("/")[2] for one in published]
    old = [any(metric.get("isHistorical") for metric in one["metrics"]) for one in found]
    assert kinds[:3] == ["NBIRTH", "DBIRTH", "DBIRTH"]
    assert not any(old[:3])
    assert [kind for kind, is_old in zip(kinds, old, strict=True) if is_old] == ["NDATA", "DDATA"]
    assert [int(one["seq"]) for one in found] == list(range(len(found)))
    births = {metric["name"]: metric for metric in found[2]["metrics"]}
    counter = births["Inputs/number"]
    values = [
        (bool(metric.get("isHistorical")), int(metric["value"]), int(metric["timestamp"]) / 1000 - wall)
        for one in found[3:]
        for metric in one["metrics"]
        if metric["alias"] == counter["alias"]
    ]
    assert [(is_old, value) for is_old, value, _ in values] == [(True, n) for n in range(1, 6)] + [(False, 6)]
    assert [at for _, _, at in values[:5]] == pytest.approx([0.25 * n for n in range(1, 6)], abs=0.01)
