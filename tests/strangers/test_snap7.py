"""The S7-200 against python-snap7 from PyPI, in an environment of its own: its PPI client reads and writes the
simulated CPU of a plant file, its frames and PDUs read and make those of our master."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any, Final

import pytest
from programs import Starter

from dpstack.api.control.client import connect
from dpstack.fdl.codec import encode
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.ppi.addresses import parse_address
from dpstack.ppi.cpu import SimulatedCpu
from dpstack.ppi.pdu import read_request, write_request
from tests.strangers.stranger_kit import HANGS_S, environment

pytestmark = pytest.mark.strangers

PLANT: Final = """
[bus]
port = "virtual"
baud = 9600

[[ppi]]
address = 2
name = "press"
values = { level = "VW100", speed = "VD8:real", on = "M0.3", limit = "AIW4" }
"""
#: one line of JSON for each step
CLIENT: Final = """
import json, sys
from snap7.ppi import PPIArea, PPIClient

def step(name, act):
    try:
        found = act()
        found = found.hex() if isinstance(found, (bytes, bytearray)) else found
    except Exception as error:
        found = str(error)
    print(json.dumps({name: found}))

with PPIClient(sys.argv[1], timeout=5) as client:
    step("length", lambda: client.pdu_length)
    step("level", lambda: client.v_read(100, 2))
    step("speed", lambda: client.v_read(8, 4))
    step("flags", lambda: client.read_area(PPIArea.M, 0, 1))
    step("limit", lambda: client.read_area(PPIArea.AI, 4, 1))
    step("output", lambda: client.read_area(PPIArea.AQ, 0, 1))
    step("far", lambda: client.v_read(10300, 1))
    step("write", lambda: client.v_write(100, bytes.fromhex("0102")))
    step("again", lambda: client.v_read(100, 2))
"""
#: frames of ours to read, requests to build, answers to read
PDUS: Final = """
import json, sys
from snap7.datatypes import S7Area, S7WordLen
from snap7.ppi import decode_frame
from snap7.s7protocol import S7Protocol

job = json.loads(sys.stdin.read())
frame = decode_frame(bytes.fromhex(job["frame"]))
s7 = S7Protocol()
print(json.dumps({
    "frame": [int(frame.frame_type), frame.destination, frame.source, frame.control, frame.payload.hex()],
    "read": s7.build_read_request(S7Area.DB, 1, 100, S7WordLen.BYTE, 2).hex(),
    "write": s7.build_write_request(S7Area.MK, 0, 4, S7WordLen.BYTE, b"\\x2a").hex(),
    "answer": bytes(s7.extract_read_data(s7.parse_response(bytes.fromhex(job["answer"])), S7WordLen.BYTE, 2)).hex(),
}))
"""


@pytest.fixture(scope="module")
def snap7(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return environment(tmp_path_factory.mktemp("snap7"), "python-snap7==3.3.0", "pyserial==3.5")


def run(python: Path, program: str, *arguments: str, given: str = "") -> str:
    done = subprocess.run(
        [python, "-c", program, *arguments],
        input=given,
        capture_output=True,
        text=True,
        timeout=HANGS_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_its_client_reads_and_writes_a_simulated_cpu(snap7: Path, tmp_path: Path, start: Starter) -> None:
    (tmp_path / "plant.toml").write_text(PLANT)
    sim = start("sim", str(tmp_path / "plant.toml"), "--port", "pty", "--json")
    sim.wait_for('"port"')
    port = sim.lines[0]["port"]
    with connect(port) as client:
        client.call("set", "press.level=4711", "press.speed=2.5", "press.on=on", "press.limit=-7")
    found: dict[str, Any] = {}
    for line in run(snap7, CLIENT, port).splitlines():
        found |= json.loads(line)
    assert found["length"] == 240
    assert (found["level"], found["speed"], found["flags"]) == ("1267", "40200000", "08")
    assert found["limit"] == "fff9"
    assert "0x03" in found["output"] or "not available" in found["output"].lower()
    assert found["far"] != ""
    assert (found["write"], found["again"]) == (None, "0102")


def test_it_reads_our_frames_and_builds_our_requests(snap7: Path) -> None:
    cpu = SimulatedCpu()
    cpu["VW100"] = 258
    request = read_request(1, [parse_address("VB100[2]")])
    job = {
        "frame": encode(Telegram(Kind.SD2, 2, 0, 0x6C, data=request.octets)).hex(),
        "answer": cpu.answer(request.octets, 0).hex(),
    }
    found = json.loads(run(snap7, PDUS, given=json.dumps(job)))
    assert found["frame"] == [0x68, 2, 0, 0x6C, request.octets.hex()]
    assert found["answer"] == "0102"
    # behind the sequence number, in which the two count on their own
    ours = write_request(2, parse_address("MB4"), 42).octets.hex()
    assert found["read"][12:] == request.octets.hex()[12:]
    assert found["write"][12:] == ours[12:]
