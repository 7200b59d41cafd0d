"""Malformed answers on the control socket: the client refuses them in one line."""

from __future__ import annotations

import contextlib
import copy
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from api_kit import HOIST, RAW
from plant_files import plant_file

from dpstack.api.config.config import load_config
from dpstack.api.control import client as client_module
from dpstack.api.control.client import ControlClient
from dpstack.cli.commands import acyclic, drive
from dpstack.cli.main import main

STATUS = {
    "state": "ready",
    "running": False,
    "reached": False,
    "remote": True,
    "setpoint": 0.5,
    "speed": 0.25,
    "frequency_hz": 12.5,
    "current": None,
    "torque": None,
    "warnings": ["w"],
    "faults": [],
    "words": ["0231"],
    "bits": ["ready"],
    "settings": "match",
    "settings_texts": ["t"],
}
DRIVE = {"order": "status", "drive": "hoist", "address": 3, "type": "demag-dedrive"}
SLAVE = {"slave": "valves", "address": 8, "slot": 1}
LISTED = {"name": "412", "number": 412, "title": "control", "data_set": 1, "unit": "", "per_unit": 1}
VALUE = {"number": 412, "name": "412", "value": 1, "raw": 1, "unit": "", "data_set": 1}
HELP = {"kind": "run", "port": "/dev/plant", "pid": 4711, "name": "/dev/plant", "config": "PLANT", "commands": []}
#: command line, request, answer to it, and the items before the answer
ORDERS: dict[str, tuple[list[str], str, Any, list[Any]]] = {
    "help": (
        ["ctl", "/dev/plant"], "help", {**HELP, "commands": [{"command": "status", "args": "", "text": "t"}]}, [],
    ),
    "drive status": (["drive", "PLANT", "hoist", "status"], "status", {**DRIVE, "status": STATUS}, []),
    "drive start": (["drive", "PLANT", "hoist", "start"], "start", {**DRIVE, "status": STATUS}, []),
    "drive read": (["drive", "PLANT", "hoist", "read", "412"], "read", {**DRIVE, "parameter": VALUE}, []),
    "drive dump, its list": (
        ["drive", "PLANT", "hoist", "dump", "DUMP"], "parameters", {**DRIVE, "per_request": 1, "parameters": [LISTED]},
        [],
    ),
    "drive dump, its values": (
        ["drive", "PLANT", "hoist", "dump", "DUMP"], "read_many", {**DRIVE, "parameters": [VALUE]}, [],
    ),
    "read": (["acyclic", "PLANT", "8", "read", "1", "2"], "read", {**SLAVE, "index": 2, "data": "1b5d"}, []),
    "write": (
        ["acyclic", "PLANT", "8", "write", "1", "2", "00"], "write", {**SLAVE, "index": 2, "length": 1},
        [{"state": "data_exchange"}],
    ),
    "im": (
        ["acyclic", "PLANT", "8", "im"], "im",
        {**SLAVE, "im": {"0": {"version": [1, 1], "supported": 2, "serial": "x"}}}, [],
    ),
    "hart": (
        ["acyclic", "PLANT", "8", "hart", "1", "0"], "hart",
        {**SLAVE, "channel": 0, "command": None, "rows": [["tag", "PT-101"]]}, [],
    ),
    "parameters": (
        ["acyclic", "PLANT", "8", "parameters"], "parameters", {**SLAVE, "object": 1, "ident": 0x1234},
        [{"progress": ["values", 1, 2]}, {"parameters": [{"number": 1, "format": "I2", "values": [5]}]}],
    ),
    "diag": (
        ["diag", "PLANT", "8"], "diag",
        {"reading": {
            "address": 8, "own": 2, "source": "run", "status": "", "diagnosis": "000c00021234", "config": "2010",
            "inputs": "00", "outputs": "00", "errors": {"RD_Inp": "x"},
        }}, [],
    ),
}  # fmt: skip
ORDERS["read"][2]["length"] = 2
#: values in the place of the right one
STRANGE: list[Any] = [None, "x\x1b]0;owned\x07\ud800", 10**400, []]


class Peer:
    """A connection to a program that answers as told: ``answers`` by command and order, ``items`` before them."""

    def __init__(self) -> None:
        self.answers: dict[str, Any] = {}
        self.items: dict[str, list[Any]] = {}
        self.lines = b""

    def sendall(self, octets: bytes) -> None:
        request = json.loads(octets)
        asked = [word for word in (*request["args"][1:2], request["command"]) if word in self.answers]
        said = [{"item": item} for item in self.items.get(asked[0], ())]
        said.append({"ok": True, "result": self.answers[asked[0]]})
        self.lines = b"".join(json.dumps(one).encode() + b"\n" for one in said)

    def recv(self, _size: int) -> bytes:
        lines, self.lines = self.lines, b""
        return lines

    def gettimeout(self) -> float:
        return 1.0

    def shutdown(self, _how: int) -> None:
        pass

    def close(self) -> None:
        pass


@pytest.fixture
def peer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Peer:
    """The program that holds the port of ``plant.toml``."""
    valves = {**RAW, "name": "valves", "address": 8, "user_prm": "00 00 00", "dpv1": True}
    config = load_config(plant_file(tmp_path, HOIST, valves, port="/dev/plant"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(drive, "load_config", lambda _path: config)
    monkeypatch.setattr(acyclic, "load_config", lambda _path: config)
    peer = Peer()
    monkeypatch.setattr(client_module, "_open_directory", lambda: contextlib.nullcontext(object()))
    monkeypatch.setattr(client_module, "_connect_first", lambda *_: ControlClient("/dev/plant", peer))  # type: ignore[arg-type]
    peer.answers = {
        "help": HELP | {"config": str(config.file)},
        "status": {**DRIVE, "status": STATUS},
        "parameters": {**DRIVE, "per_request": 1, "parameters": [LISTED]},
        "read_many": {**DRIVE, "parameters": [VALUE]},
    }
    return peer


def run(argv: list[str]) -> tuple[int, str, str]:
    """Exit code and output. An error is one line; text of the peer never reaches a terminal unescaped."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([{"PLANT": "plant.toml", "DUMP": "dump.toml"}.get(arg, arg) for arg in argv])
    printed = out.getvalue() + err.getvalue()
    assert all(letter.isprintable() for letter in printed.replace("\n", "")), printed
    return code, out.getvalue(), err.getvalue()


def places(value: Any) -> Iterator[tuple[Any, ...]]:
    """The path of every member, and that of ``value`` itself."""
    yield ()
    members = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, member in members:
        yield from ((key, *path) for path in places(member))


def changed(value: Any, path: tuple[Any, ...], strange: Any) -> Any:
    """``value`` with something else at ``path``; without that member where it is Ellipsis."""
    if not path:
        return None if strange is ... else strange
    value = copy.copy(value)
    if len(path) == 1 and strange is ...:
        del value[path[0]]
    else:
        value[path[0]] = changed(value[path[0]], path[1:], strange)
    return value


@pytest.mark.parametrize("order", ORDERS)
def test_a_member_is_missing_or_something_else(order: str, peer: Peer) -> None:
    argv, asked, answer, items = ORDERS[order]
    if asked == "help":
        answer = {**peer.answers["help"], **answer, "config": peer.answers["help"]["config"]}
    peer.answers[asked], peer.items[asked] = answer, items
    code, _, err = run(argv)
    assert (code, err) == (0, "")
    codes = set()
    for whole, put in ((answer, peer.answers), (items, peer.items)):
        for path in [path for path in places(whole) if path or whole is answer]:
            for strange in (..., *STRANGE):
                put[asked] = changed(whole, path, strange)
                code, out, err = run(argv)
                codes.add(code)
                refused = err.startswith("dpstack: ") and err.count("\n") == 1
                assert code == 0 or refused or "finding: " in out, (path, strange, err)
        put[asked] = whole
    assert {0, 1} <= codes <= {0, 1, 2}


def test_it_is_said_what_is_strange(peer: Peer) -> None:
    peer.answers["status"] = {**DRIVE, "status": {**STATUS, "setpoint": "half"}}
    code, _, err = run(["drive", "PLANT", "hoist", "status"])
    assert code == 1
    assert "/dev/plant: the answer to 'drive' is not as dpstack writes it (Expected `float`, got `str`" in err
    assert "$.status.setpoint" in err
    assert "is it another version?" in err


def test_a_newer_program_may_say_more(peer: Peer) -> None:
    more = {"since": [1], "order": "status"}
    peer.answers["status"] = {**DRIVE, **more, "status": {**STATUS, **more}}
    peer.answers["parameters"] = {**DRIVE, **more, "per_request": 1, "parameters": [{**LISTED, **more}]}
    peer.answers["read_many"] = {**DRIVE, "parameters": [{**VALUE, **more}]}
    for words in (["status"], ["dump", "DUMP"]):
        code, _, err = run(["drive", "PLANT", "hoist", *words])
        assert (code, err) == (0, "")
    peer.answers["parameters"] = {**SLAVE, "object": 1, "ident": 1, **more}
    peer.items["parameters"] = [{"parameters": [{"number": 1, "format": "I2", "values": [5], **more}], **more}]
    code, _, err = run(["acyclic", "PLANT", "8", "parameters"])
    assert (code, err) == (0, "")


def test_an_earlier_program_does_not_compare_settings(peer: Peer) -> None:
    status = {key: value for key, value in STATUS.items() if not key.startswith("settings")}
    peer.answers["status"] = {**DRIVE, "status": status}
    code, out, err = run(["drive", "PLANT", "hoist", "status"])
    assert (code, err) == (0, "")
    assert "not known" in out


@pytest.mark.parametrize("bracket", ["[", '{"a":'], ids=["lists", "objects"])
@pytest.mark.parametrize("json_or_not", [[], ["--json"]], ids=["people", "json"])
def test_brackets_too_deep_in_each_other(bracket: str, json_or_not: list[str], peer: Peer) -> None:
    deep = json.loads(bracket * 400 + "0" + ("]" if bracket == "[" else "}") * 400)
    peer.answers["status"] = {"seconds": deep}
    code, _, err = run(["ctl", "/dev/plant", "status", *json_or_not])
    assert code == 1
    assert "the answer is no JSON object; is it another version of dpstack?" in err
