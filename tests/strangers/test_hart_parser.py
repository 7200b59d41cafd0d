"""HART telegrams of both ends against hart-protocol from PyPI, in an environment of its own: it parses the answers of
the simulated transmitters, and its requests are those of the master's end.

What it has wrong stands in findings/hart-protocol.sh: its ``data`` ends with the check octet, its texts keep eight
characters, ``on_error="raise"`` refuses the usual five preambles. It takes command 3 with two variables or more only.
"""

from __future__ import annotations

import json
import struct
import subprocess
from pathlib import Path
from typing import Any, Final

import pytest

from dpstack.hart.commands import Identity, Range, Tag, Variables
from dpstack.hart.tables import pack_ascii
from dpstack.hart.telegram import Answer, Telegram, request
from dpstack.hart.transmitter import Transmitter, pressure, temperature
from tests.strangers.stranger_kit import HANGS_S, environment

pytestmark = pytest.mark.strangers

NUMBERS: Final = (0, 1, 2, 3, 13, 15)
#: reads lines of JSON: telegrams to parse, requests to build, texts to pack
PROGRAM: Final = """
import io, json, sys
import hart_protocol
from hart_protocol import tools

class Port(io.BytesIO):
    @property
    def in_waiting(self):
        return len(self.getbuffer()) - self.tell()

for line in sys.stdin:
    job = json.loads(line)
    if "answer" in job:
        found = next(hart_protocol.Unpacker(Port(bytes.fromhex(job["answer"]))))._asdict()
        print(json.dumps({k: v.hex() if isinstance(v, bytes) else v for k, v in found.items()}))
    elif "text" in job:
        print(json.dumps(tools.pack_ascii(job["text"]).hex()))
    else:
        data = bytes.fromhex(job["data"]) or None
        print(json.dumps(tools.pack_command(bytes.fromhex(job["address"]), job["command"], data).hex()))
"""


@pytest.fixture(scope="module")
def parser(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return environment(tmp_path_factory.mktemp("hart"), "hart-protocol==2023.6.0")


def told(python: Path, *jobs: dict[str, Any]) -> list[Any]:
    done = subprocess.run(
        [python, "-c", PROGRAM],
        input="".join(json.dumps(job) + "\n" for job in jobs),
        capture_output=True,
        text=True,
        timeout=HANGS_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return [json.loads(line) for line in done.stdout.splitlines()]


def answers(transmitter: Transmitter, *numbers: int) -> list[Telegram]:
    transmitter.percent = 37.5
    made = [transmitter.answer_to(request(number, address=transmitter.address)) for number in numbers]
    return [one for one in made if one is not None]


def test_it_reads_an_identity_of_hart_5(parser: Path) -> None:
    (sent,) = answers(temperature(), 0)
    (found,) = told(parser, {"answer": "ff" * 5 + sent.build().hex()})
    known = Identity.parse(Answer.of(sent).data)
    assert (found["manufacturer_id"], found["manufacturer_device_type"]) == (known.manufacturer, known.device_type)
    assert (found["device_id"], found["device_status"]) == (known.device_id, 0x20)


def test_it_reads_what_the_simulated_transmitter_answers(parser: Path) -> None:
    sent = answers(pressure(), *NUMBERS)
    assert len(sent) == len(NUMBERS)
    found = told(parser, *({"answer": "ff" * 5 + one.build().hex()} for one in sent))
    assert [one["command"] for one in found] == list(NUMBERS)
    ours = [Answer.of(one) for one in sent]
    for theirs, own in zip(found, ours, strict=True):
        assert (theirs["response_code"], theirs["device_status"]) == (own.response_code, own.device_status)
        assert theirs["data"][:-2] == own.data.hex()  # behind it stands the check octet
    identity, first, current, variables, tag, limits = found
    known = Identity.parse(ours[0].data)
    assert identity["device_id"] == known.device_id
    assert identity["universal_command_revision_level"] == known.revision
    assert identity["address"] & 0x3FFFFFFFFF == int.from_bytes(known.address, "big")
    read = Variables.parse(ours[3].data)
    assert variables["analog_signal"] == current["analog_signal"] == read.current
    assert first["primary_variable"] == variables["primary_variable"] == read.variables[0].value
    assert variables["primary_variable_units"] == read.variables[0].unit_code
    assert bytes.fromhex(tag["device_tag_name"]) == pack_ascii(Tag.parse(ours[4].data).tag, 8)
    scope = Range.parse(ours[5].data)
    assert {scope.upper, scope.lower} <= {value for value in limits.values() if isinstance(value, float)}


@pytest.mark.parametrize(
    ("number", "data"), [(1, b""), (3, b""), (48, b""), (35, b"\x07" + struct.pack(">ff", 10, 0)), (17, bytes(24))]
)
def test_its_requests_are_ours(parser: Path, number: int, data: bytes) -> None:
    address = pressure().address
    (theirs,) = told(parser, {"address": address.hex(), "command": number, "data": data.hex()})
    assert bytes.fromhex(theirs) == bytes(5 * b"\xff") + request(number, data, address).build()


def test_its_packed_ascii_is_ours_up_to_eight_characters(parser: Path) -> None:
    texts = ["PT-101  ", "FT-JPB01", "82717030", "????    "]
    assert told(parser, *({"text": text} for text in texts)) == [pack_ascii(text, 8).hex() for text in texts]
