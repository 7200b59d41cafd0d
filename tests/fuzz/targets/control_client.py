"""A client of the control socket with a program that answers anything: bent answers, cut lines, an early end.

Judged: the client raises only dpstack's own errors, with printable texts in one line; what it returns has the
fields that it promises; its buffer has a limit; and right lines give the right result.
"""

from __future__ import annotations

import socket
from typing import Any, Final, cast

from dpstack.api.control.answers import Command, Help
from dpstack.api.control.client import LONGEST_ANSWER, ControlClient
from dpstack.errors import DpError
from tests.fuzz.bent_json import bent, text_of
from tests.fuzz.frame import Cutter, Target, assert_plain

_HELP: Final[dict[str, Any]] = {
    "kind": "run", "port": "/dev/ttyUSB0", "pid": 4, "name": "x", "config": None,
    "commands": [{"command": "status", "args": "", "text": "what it is doing", "example": ""}],
}  # fmt: skip
_RIGHT: Final[tuple[Any, ...]] = (
    {"ok": True, "result": _HELP},
    {"ok": True, "result": {"slot": 3}},
    {"ok": True, "result": None},
    {"item": {"progress": ["reading", 1, 2]}},
    {"item": {"parameters": [1, {"number": 3, "value": 4}]}},
    {"item": {}},
    {"ok": False, "error": "no such slave", "usage": True},
    {"ok": False, "error": "refused", "kind": "SlaveFault", "address": 3},
    {"ok": False, "error": "x", "kind": "AcyclicError", "address": 3, "error_class": 1, "error_code": 2},
    {"ok": False, "error": "x", "kind": "ParameterError", "name": "fan", "number": 3, "code": 4},
    {"ok": False, "error": "x", "kind": "DriveFault", "name": "fan"},
)


class Answers:
    """The connection: a request is swallowed, octets come in pieces, then the end or a time-out."""

    def __init__(self, octets: bytes, piece: int, *, silent: bool) -> None:
        self.octets = octets
        self.piece = piece
        self.silent = silent

    def recv(self, size: int) -> bytes:
        taken, self.octets = self.octets[: min(size, self.piece)], self.octets[min(size, self.piece) :]
        if not taken and self.silent:
            raise TimeoutError
        return taken

    def sendall(self, octets: bytes) -> None:
        assert octets.endswith(b"\n")
        assert octets.count(b"\n") == 1

    def gettimeout(self) -> float:
        return 1.0

    def shutdown(self, _how: int) -> None:
        raise OSError

    def close(self) -> None:
        self.octets = b""


def run(octets: bytes) -> None:
    script = Cutter(octets)
    head = script.octet()
    lines = b""
    for _ in range(1 + (head & 3)):
        how = script.octet()
        match how >> 5:
            case 0 | 1 | 2 | 3:
                lines += text_of(bent(_RIGHT[how % len(_RIGHT)], script)).encode() + b"\n"
            case 4:
                whole = text_of(_RIGHT[how % len(_RIGHT)]).encode()
                lines += whole[: script.octet()] + b"\n"
            case 5:
                lines += script.take(script.octet())
            case 6:
                lines += script.take(script.octet()) + b"\n"
            case _:
                lines += b"[" * (script.octet() << 4) + b"\n"
    connection = Answers(lines, 1 + (script.octet() << (head >> 4 & 7)), silent=bool(head & 8))
    client = ControlClient("/dev/ttyUSB0", cast(socket.socket, connection))
    seen: list[tuple[str, int, int]] = []
    for _ in range(2):
        try:
            if head & 4:
                found = client.help()
                assert isinstance(found["pid"], int)
                assert isinstance(found["kind"], str)
                command: Command
                for command in cast(Help, found)["commands"]:
                    assert isinstance(command["text"], str)
            else:
                client.call("read", "3", progress=lambda what, at, most: seen.append((what, at, most)))
        except DpError as error:
            assert_plain(str(error))
        assert len(client._rest) <= LONGEST_ANSWER + 65_536
    for what, at, most in seen:
        assert isinstance(what, str)
        assert isinstance(at, int)
        assert isinstance(most, int)
    right = b'{"item":{"parameters":[1]}}\n{"ok":true,"result":{"slot":3}}\n'
    good = ControlClient("x", cast(socket.socket, Answers(right, connection.piece, silent=False)))
    assert good.call("list") == {"slot": 3, "parameters": [1]}


TARGET = Target(
    run=run,
    covers=("dpstack.api.control.client", "dpstack.api.control.errors", "dpstack.errors"),
    executions=100_000,
    max_len=300,
)
