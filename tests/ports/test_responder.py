"""The tests' own responder, on literal octets: it must not be taught by our stack."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from far_ends import PtyFarEnd
from support_responder import Responder

SPEC = "3:0696:f3f1:12:12"
DIAG = bytes.fromhex("68 05 05 68 83 82 6D 3C 3E EC 16")
PRM = bytes.fromhex("68 0C 0C 68 83 82 5D 3D 3E 88 02 0A 0B 06 96 00 18 16")
CFG = bytes.fromhex("68 07 07 68 83 82 7D 3E 3E F3 F1 E2 16")
SC = b"\xe5"


@pytest.fixture
def responder(far: PtyFarEnd) -> Iterator[Responder]:
    """The responder with slave 3, fed by the test."""
    made = Responder(far.path, [SPEC])
    yield made
    made.stop()


def test_bring_up_exchange_and_repeat(responder: Responder) -> None:
    slave = responder.slaves[3]
    assert responder.feed(bytes.fromhex("10 03 02 49 4E 16")) == bytes.fromhex("10 02 03 00 05 16")
    assert responder.feed(bytes.fromhex("DC 02 02")) == b""
    assert responder.tokens == 1
    # before parameters: not ready, parameters wanted, no master
    assert responder.feed(DIAG).hex(" ") == "68 0b 0b 68 82 83 08 3e 3c 02 05 00 ff 06 96 29 16"
    assert responder.feed(PRM) == SC
    assert slave.user_prm == b""
    assert responder.feed(CFG) == SC
    assert responder.feed(DIAG).hex(" ") == "68 0b 0b 68 82 83 08 3e 3c 00 0c 00 02 06 96 31 16"
    exchange = bytes.fromhex("68 0F 0F 68 03 02 5D") + bytes(range(12)) + bytes.fromhex("A4 16")
    answer = bytes.fromhex("68 0F 0F 68 02 03 08") + bytes(range(12)) + bytes.fromhex("4F 16")
    for cut in range(len(exchange)):
        slave.kept_fcb = -1
        assert responder.feed(exchange[:cut]) == b""
        assert responder.feed(exchange[cut:]) == answer
    executed = slave.exchanges
    assert responder.feed(exchange) == answer  # the same FCB: not executed again
    assert (slave.exchanges, slave.repeats) == (executed, 1)
    assert responder.feed(bytes.fromhex("68 07 07 68 FF 82 46 3A 3E 00 00 3F 16")) == b""
    assert slave.control == b"\x00\x00"


@pytest.mark.parametrize(
    ("keys", "status"),
    [("refuse=prm", "42 05 00 ff"), ("refuse=cfg", "06 0d 00 ff"), ("owner=7", "00 04 00 07")],
)
def test_refused_parameters_and_configurations_show_in_the_diagnosis(far: PtyFarEnd, keys: str, status: str) -> None:
    responder = Responder(far.path, [f"{SPEC},{keys}"])
    assert responder.feed(PRM) == SC
    assert responder.feed(CFG) == SC
    assert responder.feed(DIAG)[9:13].hex(" ") == status
    responder.stop()


def test_garbage_and_foreign_telegrams_are_passed_over(responder: Responder) -> None:
    status = bytes.fromhex("10 03 02 49 4E 16")
    assert responder.feed(b"\x00\x68\x05\x06\x68" + status[:-1] + b"\x17" + status)[:3] == b"\x10\x02\x03"
    assert responder.feed(bytes.fromhex("10 04 02 49 4F 16")) == b""


async def test_as_a_script_on_a_tty(far: PtyFarEnd) -> None:
    script = str(Path(__file__).parents[1] / "kits" / "support_responder.py")
    lost = await asyncio.create_subprocess_exec(sys.executable, script, stderr=subprocess.DEVNULL)
    assert await lost.wait() == 2
    process = await asyncio.create_subprocess_exec(sys.executable, script, far.path, SPEC, stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert await process.stdout.readline() == b"ready\n"
    far.send(bytes.fromhex("10 03 02 49 4E 16"))
    assert await far.recv(6) == bytes.fromhex("10 02 03 00 05 16")
    far.hang_up()
    assert await process.wait() == 0


async def test_in_a_thread(far: PtyFarEnd) -> None:
    with Responder(far.path, [SPEC]):
        far.send(bytes.fromhex("10 03 02 49 4E 16"))
        assert await far.recv(6) == bytes.fromhex("10 02 03 00 05 16")
