"""Payloads of births and data against sparkplug-payload from npm, the decoder of the Eclipse Tahu project; and commands
that it encodes."""

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
from tests.strangers.stranger_kit import program

pytestmark = pytest.mark.strangers

VERSION: Final = "1.0.3"
NOW: Final = 1_700_000_000_123
#: reads payloads as hex, one a line, writes them as JSON; a line that begins with { is a payload to encode. It reads no
#: value without a type, which data have in births only (tck-id-payloads-metric-datatype-not-req): so each metric gets
#: the type that a birth gave to its alias, as a host does it
PROGRAM: Final = """
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
for (const line of require("fs").readFileSync(0, "utf8").trim().split("\\n")) {
    if (line.startsWith("{")) {
        console.log(Buffer.from(spb.encodePayload(JSON.parse(line))).toString("hex"));
    } else {
        console.log(JSON.stringify(spb.decodePayload(typed(Buffer.from(line, "hex"))), plain));
    }
}
"""
VALUES: Final[list[tuple[str, Value]]] = [
    *((name, limit) for name, limits in LIMITS.items() for limit in limits),
    ("bool", True),
    ("bool", False),
    ("text", "größer als 5 ☃"),
    ("bytes", b"\x00\xff"),
    ("f32", 1.5),
    ("f64", -1e300),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("npm")
    subprocess.run(
        [program("npm"), "install", "--no-audit", "--no-fund", "--silent", "--ignore-scripts",
         f"sparkplug-payload@{VERSION}"],
        cwd=made,
        check=True,
        timeout=300,
    )  # fmt: skip
    return made


def asked(folder: Path, lines: list[str]) -> list[str]:
    run = subprocess.run(
        ["node", "-e", PROGRAM],
        cwd=folder,
        input="\n".join(lines),
        text=True,
        capture_output=True,
        timeout=60,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


def test_values_of_every_type(folder: Path) -> None:
    payloads = []
    for number, (type_, value) in enumerate(VALUES):
        kind = MetricKind(f"a/{number}", number + 1, DATA_TYPES[type_], unit="bar")
        payloads.append(birth([Sample(kind, Reading(value, Reason.GOOD), NOW)], number, NOW).hex())
    for (type_, value), line in zip(VALUES, asked(folder, payloads), strict=True):
        (found,) = json.loads(line)["metrics"]
        shown: Any = found["value"]
        if isinstance(value, int) and not isinstance(value, bool):
            shown = int(shown)
        elif isinstance(value, bytes):
            shown = bytes(shown["data"])
        assert shown == value, (type_, found)
        assert found["type"].upper() == DATA_TYPES[type_].name
        assert found["properties"]["Quality"] == {"type": "Int32", "value": 192}
        assert found["properties"]["engUnit"]["value"] == "bar"


def test_the_messages_of_a_session(folder: Path, tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.give_plant()
    rig.connect()
    rig.pump()
    rig.values["8"]["fields"]["count"] = -100
    rig.values["8"]["inputs_age_ms"] = 500.0
    rig.wait(1.0)
    rig.values["8"]["state"] = "offline"
    rig.pump()
    rig.wait(1.0)
    rig.node.end("the end")
    rig.pump()
    rig.close()
    found = [json.loads(line) for line in asked(folder, [one.payload.hex() for one in rig.sent])]
    kinds = [one.topic.split("/")[2] for one in rig.sent]
    assert kinds == ["NBIRTH", "DBIRTH", "DBIRTH", "DDATA", "NDEATH"]
    assert [int(one["seq"]) for one in found[:4]] == [0, 1, 2, 3]
    names = {one["name"]: one for one in found[2]["metrics"]}
    assert (names["Inputs/count"]["type"], names["Inputs/count"]["value"]) == ("Int8", -3)
    data = {int(one["alias"]): one for one in found[3]["metrics"]}
    assert data[int(names["Inputs/limit"]["alias"])]["properties"]["Quality"]["value"] == 500
    (number,) = found[4]["metrics"]
    assert (number["name"], int(number["value"])) == ("bdSeq", 0)
    assert rig.sent[0].topic == f"spBv1.0/{GROUP}/NBIRTH/{NODE}"


def test_births_come_first_and_then_history_in_order(folder: Path, tmp_path: Path) -> None:
    """Five values of an outage, and one behind it; the values that the birth has do not come again."""
    rig = HistoryRig(tmp_path)
    rig.give_plant()
    rig.connect()
    rig.pump()
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
    found = [json.loads(line) for line in asked(folder, [one.payload.hex() for one in published])]
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


@pytest.mark.parametrize(
    ("type_", "value"),
    [
        ("Boolean", True),
        ("Int8", -3),
        ("Int16", -300),
        ("Int32", -70_000),
        ("UInt8", 200),
        ("UInt16", 60_000),
        ("UInt32", 4_000_000_000),
        ("Float", 1.5),
        ("Double", -2.25),
        ("String", "on"),
    ],
)
def test_commands_that_it_encodes(folder: Path, type_: str, value: object) -> None:
    text = {"timestamp": NOW, "metrics": [{"name": "Outputs/x", "type": type_, "value": value, "timestamp": NOW}]}
    (line,) = asked(folder, [json.dumps(text)])
    command = read_command(bytes.fromhex(line))
    assert command.time_ms == NOW
    (given,) = command.metrics
    assert given.name == "Outputs/x"
    assert value_given(given, DataType[type_.upper()]) == value
