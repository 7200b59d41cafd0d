"""The segment in C of ``bench ring`` (needs a C compiler): literal octets from two masters, times by the clock."""

from __future__ import annotations

import json
import os
import select
import subprocess
import termios
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bench import ring
from bench.ring import compiled

pytestmark = pytest.mark.strangers

PRM = bytes.fromhex("680c0c6883826d3d3e8001010b069600")
CFG = bytes.fromhex("6807076883825d3e3ef371")
DIAG = bytes.fromhex("6805056883826d3c3e")
EXCHANGE = bytes.fromhex("680f0f6803027d000102030405060708090a0b")
TOKEN = bytes.fromhex("dc0102")


def whole(telegram: bytes) -> bytes:
    """With check sum and end."""
    return telegram + bytes((sum(telegram[4:]) & 0xFF, 0x16))


class Segment:
    """Two masters' ends of a segment with slave 3 at a rate at which a bit takes 104 us: no scheduler spoils that."""

    def __init__(self, program: Path) -> None:
        words = [str(program), "9600", "37", "100", "11", "100", "2", "2", "3:0696:f371:12:12"]
        self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        ports = json.loads(self.process.stdout.readline())["ports"]
        self.ends = [os.open(port, os.O_RDWR | os.O_NOCTTY) for port in ports]
        for end in self.ends:
            tty.setraw(end)
            termios.tcflush(end, termios.TCIOFLUSH)

    def read(self, end: int, octets: int, seconds: float = 5.0) -> bytes:
        """So many octets, or what there is in time."""
        got, until = b"", time.monotonic() + seconds
        while len(got) < octets and select.select([self.ends[end]], [], [], max(0, until - time.monotonic()))[0]:
            got += os.read(self.ends[end], octets - len(got))
        return got

    def asked(self, request: bytes, octets: int) -> bytes:
        """The answer to the first master's request; the second one hears both."""
        os.write(self.ends[0], request)
        answer = self.read(0, octets)
        assert self.read(1, len(request) + octets) == request + answer
        return answer

    def counted(self) -> dict[str, Any]:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write("end\n")
        self.process.stdin.flush()
        found: dict[str, Any] = json.loads(self.process.stdout.readline())
        return found


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(tmp_path_factory.mktemp("segment"))


@pytest.fixture
def line(program: Path) -> Iterator[Segment]:
    made = Segment(program)
    yield made
    for end in made.ends:
        os.close(end)
    made.process.communicate(timeout=5)  # the end of its input
    assert made.process.returncode == 0


def test_a_slave_comes_up_exchanges_data_and_keeps_its_answer(line: Segment) -> None:
    assert line.asked(whole(DIAG), 17) == whole(bytes.fromhex("680b0b688283083e3c020500ff0696"))
    too_soon = EXCHANGE[:6] + b"\x5d" + EXCHANGE[7:]
    assert line.asked(whole(too_soon), 6) == bytes.fromhex("100203030816")  # no service: it has no parameters
    assert line.asked(whole(PRM), 1) == line.asked(whole(CFG), 1) == b"\xe5"
    for _ in range(2):  # the second time it is a repetition
        assert line.asked(whole(EXCHANGE), 21) == whole(bytes.fromhex("680f0f68020308" + 12 * "03"))
    assert line.asked(whole(DIAG), 17) == whole(bytes.fromhex("680b0b688283083e3c000400020696"))
    taken = line.counted()
    assert (taken["telegrams"], taken["exchanges"], taken["collisions"]) == (7, 1, 0)


def test_octets_take_their_time(line: Segment) -> None:
    status = bytes.fromhex("100302494e16")
    begin = time.monotonic_ns()
    assert line.asked(status, 6) == bytes.fromhex("100203000516")
    # never sooner than 6 octets, min T_SDR and 6 octets; T_ID1 is part of the time by the rules
    assert time.monotonic_ns() - begin > (66 + 11 + 66) * 1e9 / 9_600
    assert line.counted()["ruled_ns"] == pytest.approx((66 + 11 + 66 + 37) * 1e9 / 9_600, abs=10)


def test_a_damaged_request_has_no_answer(line: Segment) -> None:
    os.write(line.ends[0], bytes.fromhex("100302494f16"))
    assert line.read(1, 6) == bytes.fromhex("100302494f16")
    assert line.read(0, 1, seconds=0.1) == b""


def test_two_that_send_at_once_spoil_each_others_octets(line: Segment) -> None:
    long = whole(bytes.fromhex("68f7f76803027d") + bytes(244))  # 290 ms
    for end in line.ends:
        os.write(end, long)
    spoilt = bytes(octet ^ 0xFF for octet in long)
    assert line.read(0, len(long)) == spoilt
    heard = line.read(1, len(long))
    assert heard != long
    assert heard.endswith(spoilt[-20:])
    assert line.counted()["collisions"] == 1
    assert line.read(0, 1, seconds=0.1) == b""  # no slave answers


def test_tokens_and_rotations_are_counted(line: Segment) -> None:
    there, back = bytes.fromhex("dc0201"), bytes.fromhex("dc0102")
    for _ in range(3):
        os.write(line.ends[0], there)
        assert line.read(1, 3) == there
        os.write(line.ends[1], back)
        assert line.read(0, 3) == back
    os.write(line.ends[0], there)
    os.write(line.ends[0], there)  # repeated: nobody answered
    os.write(line.ends[0], bytes.fromhex("dc0101"))  # claimed
    assert line.read(1, 9) == there + there + bytes.fromhex("dc0101")
    taken = line.counted()
    assert (taken["tokens"], taken["token_repeats"], taken["claims"]) == (9, 1, 1)
    assert len(taken["rotations_ns"]) == 3
    assert min(taken["rotations_ns"]) >= 66 * 1e9 / 9_600
    assert len(taken["answers_ns"]) == 6


def test_two_bare_loops_and_two_masters_hold_a_ring() -> None:
    report = ring.run(["--bauds", "500000", "--slaves", "2", "--seconds", "0.3", "--rounds", "1", "--kinds", "asyncio"])
    values = {figure.name: figure.value for figure in report.figures}
    assert values["two bare loops, 500 kbit/s: rotations"] > 0
    if values["highest rate that two bare loops hold"]:  # a busy computer may not
        assert values["ring at 500 kbit/s, asyncio: rotations"] > 0
