"""Payloads of a session against two decoders of Sparkplug B from PyPI, each in an environment of its own; and commands
that one of them encodes."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any, Final

import pytest
from edge_node_rig import Rig

from dpstack.bridge.mqtt.payload import DATA_TYPES, DataType, MetricKind, Sample, birth, read_command, value_given
from dpstack.plant.quality import LIMITS, Reading, Reason, Value
from tests.strangers.stranger_kit import environment

pytestmark = pytest.mark.strangers

NOW: Final = 1_700_000_000_123
VALUES: Final[list[tuple[str, Value]]] = [
    *((name, limit) for name, limits in LIMITS.items() for limit in limits),
    ("bool", True),
    ("bool", False),
    ("text", "größer als 5 ☃"),
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


@pytest.fixture(scope="module")
def pysparkplug(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return environment(tmp_path_factory.mktemp("pysparkplug"), "pysparkplug==0.6.1")


@pytest.fixture(scope="module")
def wrapper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return environment(tmp_path_factory.mktemp("wrapper"), "mqtt-spb-wrapper==2.1.2")


def asked(python: Path, program: str, lines: list[str]) -> list[str]:
    run = subprocess.run(
        [python, "-I", "-c", program], input="\n".join(lines), text=True, capture_output=True, timeout=60, check=False
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


def session(folder: Path, count: int) -> list[tuple[str, str, bytes]]:
    """Kind as pysparkplug names it, device and payload of the messages of a session: births, data, deaths."""
    rig = Rig(folder)
    rig.values["8"]["fields"]["count"] = count
    rig.give_plant()
    rig.connect()
    rig.pump()
    rig.values["8"]["fields"]["count"] = 100
    rig.values["8"]["inputs_age_ms"] = 500.0
    rig.wait(1.0)
    rig.pump()
    rig.values["8"]["state"] = "offline"
    rig.wait(1.0)
    rig.pump()
    rig.node.end("the end")
    rig.pump()
    rig.close()
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


def values_of_every_type() -> list[tuple[str, str, bytes]]:
    payloads = []
    for number, (type_, value) in enumerate(VALUES):
        kind = MetricKind(f"a/{number}", number + 1, DATA_TYPES[type_], unit="bar")
        payloads.append(("DBirth", f"d{number}", birth([Sample(kind, Reading(value, Reason.GOOD), NOW)], 1, NOW)))
    return payloads


def test_values_of_every_type(pysparkplug: Path, wrapper: Path) -> None:
    lines = as_lines(values_of_every_type())
    # pysparkplug ends at negative numbers of 8 and 16 bits that are filled up to 32, as Tahu does it in Java
    narrow = [n for n, (type_, value) in enumerate(VALUES) if type_ in ("i8", "i16") and int(value or 0) < 0]
    some = [n for n in range(len(VALUES)) if n not in narrow]
    for program, python, which in ((PYSPARKPLUG, pysparkplug, some), (WRAPPER, wrapper, range(len(VALUES)))):
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


def test_commands_that_pysparkplug_encodes(pysparkplug: Path) -> None:
    lines = asked(pysparkplug, ENCODES, [json.dumps(one) for one in COMMANDS])
    for (type_, value), line in zip(COMMANDS, lines, strict=True):
        command = read_command(bytes.fromhex(line))
        assert command.time_ms == NOW
        (given,) = command.metrics
        assert given.name == "Outputs/x"
        assert value_given(given, DataType[type_]) == value
