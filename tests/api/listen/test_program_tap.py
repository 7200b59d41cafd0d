"""The tap of a program as ``dpstack capture`` reads it; the program is lines of octets that a thread writes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import threading
from pathlib import Path
from typing import Any

import pytest
from control_kit import socket_of
from far_ends import until

from dpstack.api.control import stream
from dpstack.api.control.socket_path import Sockets
from dpstack.api.listen.listening import Listening, OctetsLost
from dpstack.capture.transmission import Damage, Transmission
from dpstack.drivers.runtime import PortBack, PortLost
from dpstack.errors import BusError, PortError, UsageError
from dpstack.trace import Event, Notice
from dpstack.units import chars_to_ns

PORT = "COM3"
HELP = {"kind": "run", "port": PORT, "pid": 7, "commands": [{"command": "tap", "args": "", "text": ""}]}
ABOUT = {"epoch_ns": 10**18, "baud": 500_000, "paced": True}
TOKEN = "dc0202"
REQUEST = "6805056883826d3c3eec16"
ANSWER = "100203000516"


class Program:
    """Answers ``help``, then each request with the ``lines``; stays connected while ``stays``."""

    def __init__(self, lines: list[bytes], help_: object = HELP, *, stays: bool = False) -> None:
        self.requests: list[Any] = []
        self._lines = lines
        self._help = help_
        self._stays = stays
        self.more = threading.Event()
        self.later: list[bytes] = []
        with Sockets(make=True):
            pass
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.bind(str(socket_of(PORT)))
        self._socket.listen()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            connection, _ = self._socket.accept()
            with connection, connection.makefile("rb") as requests:
                self.requests.append(json.loads(requests.readline()))
                connection.sendall(json.dumps({"ok": True, "result": self._help}).encode() + b"\n")
                line = requests.readline()
                if not line:
                    return
                self.requests.append(json.loads(line))
                connection.sendall(b"".join(self._lines))
                if self._stays:
                    self.more.wait(20)
                    connection.sendall(b"".join(self.later))
                    requests.read()

    def end(self) -> None:
        self.more.set()
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._thread.join()
        socket_of(PORT).unlink()


@pytest.fixture(autouse=True)
def alone(runtime_directory: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = Path(runtime_directory) / "tap"
    folder.mkdir(exist_ok=True)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))


def item(**fields: object) -> bytes:
    return json.dumps({"item": fields}).encode() + b"\n"


def octets(*entries: list[object], lost: int = 0) -> bytes:
    return item(octets=entries, lost=lost)


async def heard(*lines: bytes, help_: object = HELP) -> tuple[list[Transmission], list[Event], str]:
    """The transmissions and events of a tap with these ``lines``, and the text of its end."""
    transmissions: list[Transmission] = []
    events: list[Event] = []
    program = Program(list(lines), help_)
    try:
        with pytest.raises((PortError, BusError, UsageError)) as ended:
            async with Listening(PORT, None, transmissions.append, events.append, own=False) as listening:
                await asyncio.wait_for(listening.ended(), 20)
    finally:
        program.end()
    return transmissions, events, f"{type(ended.value).__name__}: {ended.value}"


def start(end_ns: int, text: str, baud: int = 500_000) -> int:
    return 10**18 + end_ns - chars_to_ns(len(text) // 2, baud)


async def test_transmissions_with_their_times_and_what_happened_to_the_line() -> None:
    ms = 1_000_000
    found, events, end = await heard(
        item(**ABOUT, exact=True),
        octets([1 * ms, 500_000, REQUEST, True], [2 * ms, 500_000, ANSWER[:6], False]),
        octets([3 * ms, 500_000, ANSWER[6:], False], [4 * ms, 500_000, REQUEST[:8], False]),
        octets([5 * ms, 500_000, TOKEN, True]),  # what the program sends begins a transmission
        octets([6 * ms, 500_000, TOKEN, True], lost=7),
        octets([7 * ms, 0, "", False], [99 * ms, 1_500_000, "", False], [100 * ms, 1_500_000, TOKEN, True]),
        octets(),
    )
    assert end == "PortError: COM3: the program ended"
    assert [(one.octets.hex(), one.baud, one.damage) for one in found] == [
        (REQUEST, 500_000, 0),
        (ANSWER, 500_000, 0),
        (REQUEST[:8], 500_000, Damage.TOO_SHORT),
        (TOKEN, 500_000, 0),
        (TOKEN, 500_000, 0),
        (TOKEN, 1_500_000, 0),
    ]
    assert [one.t_ns for one in found] == [
        start(1 * ms, REQUEST), start(3 * ms, ANSWER), start(4 * ms, REQUEST[:8]), start(5 * ms, TOKEN),
        start(6 * ms, TOKEN), start(100 * ms, TOKEN, 1_500_000),
    ]  # fmt: skip
    assert [type(event) for event in events] == [OctetsLost, PortLost, PortBack]
    assert isinstance(events[0], OctetsLost)
    assert events[0].count == 7
    assert "run that holds it" in events[1].text


async def test_a_program_that_searches_its_rate() -> None:
    events: list[Event] = []
    program = Program([item(**ABOUT | {"baud": None})], stays=True)
    program.later = [item(**ABOUT | {"baud": 19_200})]
    try:
        async with Listening(PORT, None, lambda one: None, events.append, own=False) as listening:
            assert (listening.line.baud, listening.line.program) == (None, "run")
            program.more.set()
            await until(lambda: listening.line.baud == 19_200, "the rate")
    finally:
        program.end()
    assert [event.text for event in events] == [
        "COM3: the run searches for the baud rate of the bus",
        "COM3: the run has found the bus at 19.2 kbit/s",
    ]
    assert program.requests[1] == {"command": "tap", "args": []}


async def test_a_program_that_is_silent_is_told_once_and_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "TIMEOUT_S", 0.02)
    events: list[Event] = []
    found: list[Transmission] = []
    program = Program([item(**ABOUT)], stays=True)
    program.later = [octets([5, 500_000, TOKEN, True])]
    try:
        async with Listening(PORT, None, found.append, events.append, own=False):
            await until(lambda: bool(events), "the notice")
            await asyncio.sleep(0.05)
            program.more.set()
            await until(lambda: bool(found), "the octets")
    finally:
        program.end()
    assert all(isinstance(event, Notice) for event in events)
    texts = [event.text for event in events][:2]
    assert "has sent nothing for 10 s: is it stopped, or busy?" in texts[0]
    assert "goes on" in texts[1]


STRANGE = {
    "no JSON": b"tap\n",
    "no object": b"[1]\n",
    "nothing in it": b"{}\n",
    "an item of another kind": item(octets=5, lost=0),
    "an entry that is too short": octets([1, 500_000, TOKEN]),
    "no hex": octets([1, 500_000, "xy", True]),
    "half an octet": octets([1, 500_000, "dc0", True]),
    "a time that is none": octets(["now", 500_000, TOKEN, True]),
    "a time without bounds": octets([10**30, 500_000, TOKEN, True]),
    "an epoch without bounds": item(**ABOUT | {"epoch_ns": 10**30}),
    "losses below zero": item(octets=[], lost=-1),
    "no UTF-8": b'{"item":{"octets":[[1,2,"\xff\xfe",true]]}}\n',
    "nested without end": b'{"item":' + b"[" * 100_000 + b"\n",
}


@pytest.mark.parametrize("line", STRANGE.values(), ids=STRANGE.keys())
async def test_lines_that_dpstack_does_not_write_are_one_clear_error(line: bytes) -> None:
    found, _, end = await heard(item(**ABOUT), octets([1, 500_000, TOKEN, True]), line)
    assert len(found) == 1
    assert end.startswith("PortError: COM3: ")
    assert end.endswith(("is it another version?", "is it another version of dpstack?"))
    assert "\n" not in end


async def test_a_rate_that_profibus_does_not_have() -> None:
    for baud in (0, 7, 10**9):
        entry: list[object] = [1, baud, TOKEN, True]
        _, _, end = await heard(item(**ABOUT), octets(entry), octets([2, 1, TOKEN, True]))
        assert "which is no PROFIBUS rate: is it dpstack?" in end


async def test_a_program_without_a_tap_that_refuses_it_or_ends() -> None:
    _, _, end = await heard(help_=HELP | {"commands": []})
    assert "the run that holds it (pid 7) has no tap" in end
    _, _, end = await heard(b'{"ok":false,"error":"not now","usage":true}\n')
    assert end == "UsageError: not now"
    _, _, end = await heard(b'{"ok":true,"result":null}\n')
    assert "does not begin its tap" in end
    _, _, end = await heard()
    assert "does not begin its tap" in end
    _, _, end = await heard(octets())
    assert "does not begin its tap" in end
    _, _, end = await heard(item(**ABOUT), b'{"ok":false,"error":"it is over","kind":"BusError"}\n')
    assert end == "BusError: it is over"
    _, _, end = await heard(item(**ABOUT), b'{"item":{"octets":[')
    assert end == "PortError: COM3: the program ended"
