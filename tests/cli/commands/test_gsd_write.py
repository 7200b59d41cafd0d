"""`dpstack gsd write`: a GSD file of a slave in a module of the user."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_kit import Cli

PROGRAM = """
from dpstack.slave import DpSlave, SlaveDescription

TYPE = SlaveDescription.simple(0x4711, inputs=2, outputs=1, name="tank", dpv1=True)
SLAVE = DpSlave(TYPE, lambda outputs, elapsed: bytes(2))

class Tank(DpSlave):
    def __init__(self):
        super().__init__(TYPE, lambda outputs, elapsed: bytes(2))

def broken():
    raise ValueError("no")
"""


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli) -> None:
    (tmp_path / "own_tank.py").write_text(PROGRAM, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in ("own_tank:TYPE", "own_tank.py:SLAVE", "own_tank:Tank"):
        cli.out("gsd", "write", name, "tank.gsd", *(["--force"] if name != "own_tank:TYPE" else []))
        shown = cli.json("gsd", "show", "tank.gsd")
        assert (shown["ident"], shown["model"]) == ("0x4711", "tank")
        assert cli.out("gsd", "check", "tank.gsd")
    before = (tmp_path / "tank.gsd").read_bytes()
    assert "there is a file of that name" in cli.err("gsd", "write", "own_tank:TYPE", "tank.gsd")
    assert (tmp_path / "tank.gsd").read_bytes() == before
    for name, says in (
        ("own_tank", "names no slave; write MODULE:NAME"),
        ("own_tank:NONE", "own_tank has no description 'NONE'"),
        ("own_tonk:TYPE", "'own_tonk:TYPE' cannot be loaded (ModuleNotFoundError"),
        ("own_tank:broken", "cannot be made without arguments (ValueError: no)"),
        ("math:pi", "math:pi is a float; name a SlaveDescription or a DpSlave"),
    ):
        assert says in cli.err("gsd", "write", name, "other.gsd")
    assert not (tmp_path / "other.gsd").exists()
