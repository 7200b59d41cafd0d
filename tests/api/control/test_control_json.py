"""JSON on the control socket that is none of ours: an answer or an error of our own, at both ends."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_kit import assert_linear

from dpstack.api.control import client as client_module
from dpstack.api.control.client import ControlClient
from dpstack.api.control.commands import COMMON
from dpstack.api.control.control_server import ControlServer, _parsed
from dpstack.errors import PortError, UsageError

NONE_OF_OURS = [
    b"[" * 30_000,
    b'{"a":' * 12_000,
    b'{"command":' + b"9" * 5000 + b"}",
    b'{"command":"status","args":[' + b"9" * 5000 + b"]}",
    b'{"command":"\xff\xfe"}',
    b"\xff",
    b"null",
    b'{"command":["status"]}',
    b'{"command":"status","args":{}}',
    b'{"command":"status","args":[null]}',
    b'{"command":"status","until_ns":-1' + b"0" * 400 + b"}",
    b'{"command":"status","until_ns":"soon"}',
    b'{"command":"status","until_ns":true}',
]


@pytest.fixture
def pair() -> Iterator[tuple[ControlClient, socket.socket]]:
    """A client, and the octets at the other end."""
    ours, theirs = socket.socketpair()
    with theirs, ControlClient("port", ours) as client:
        yield client, theirs


@pytest.mark.parametrize("line", NONE_OF_OURS, ids=lambda line: repr(line[:20]))
def test_a_request(line: bytes) -> None:
    server = ControlServer("sim", "/dev/nowhere", COMMON, {"status": lambda _args: None})
    with pytest.raises(UsageError, match="a request is one line"):
        server._check_request(_parsed(line))


@given(st.binary(max_size=60))
def test_any_request(line: bytes) -> None:
    server = ControlServer("sim", "/dev/nowhere", COMMON, {"status": lambda _args: None})
    for request in (line, b'{"command":"status","args":[' + line + b"]}", b'{"command":' + line + b"}"):
        try:
            spec, _ = server._check_request(_parsed(request))
        except UsageError:
            continue
        assert spec.name in ("status", "help")


@pytest.mark.parametrize("line", NONE_OF_OURS[:7], ids=lambda line: repr(line[:20]))
def test_an_answer(line: bytes, pair: tuple[ControlClient, socket.socket]) -> None:
    client, theirs = pair
    theirs.sendall(line + b"\n")
    with pytest.raises(PortError, match="the answer is no JSON object; is it another version of dpstack"):
        client.call("status")


def test_an_answer_without_an_end(pair: tuple[ControlClient, socket.socket], monkeypatch: pytest.MonkeyPatch) -> None:
    client, theirs = pair
    monkeypatch.setattr(client_module, "LONGEST_ANSWER", 1000)
    theirs.sendall(b"x" * 1500)
    with pytest.raises(PortError, match=r"an answer of more than 1000 octets; is it dpstack\?"):
        client.call("status")


def test_lines_are_cut_however_they_arrive(
    pair: tuple[ControlClient, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    client, theirs = pair
    monkeypatch.setattr(client_module, "_CHUNK", 3)
    theirs.sendall(b'{"item":{"parameters":[1]}}\n{"item":{"parameters":[2]}}\n{"ok":true,"result":{"slot":3}}\n')
    theirs.sendall(b'{"ok":true,"result":4}\n')
    assert client.call("count") == {"slot": 3, "parameters": [1, 2]}
    assert client.call("count") == 4


class Pieces:
    """A connection that delivers its octets in pieces of 100."""

    def __init__(self, octets: bytes) -> None:
        self._octets = octets
        self._at = 0

    def recv(self, _size: int) -> bytes:
        self._at += 100
        return self._octets[self._at - 100 : self._at]

    def __getattr__(self, _name: str) -> Callable[..., None]:
        return lambda *_args: None


def test_a_long_answer_costs_what_it_is_long() -> None:
    def work_of(n: int) -> Callable[[], object]:
        line = json.dumps({"ok": True, "result": "x" * (1000 * n)}).encode() + b"\n"
        return lambda: ControlClient("port", Pieces(line)).call("status")  # type: ignore[arg-type]

    assert_linear(work_of, 50)
