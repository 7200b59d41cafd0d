"""Commands where the standard streams have an encoding that lacks what is to be written, or are no text of it."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from dpstack.cli import main as program
from dpstack.cli.main import main
from dpstack.cli.terminal import output

GSD = """#Profibus_DP
GSD_Revision = 5
Vendor_Name = "Müller \u2013 温度 \u2026"
Model_Name = "Öler\u00a0\U0001f600"
Ident_Number = 0x1234
500_supp = 1
Max_Input_Len = 1
Module = "Ö \u2013 温" 0x10
1
EndModule
"""


@pytest.fixture
def gsd(tmp_path: Path) -> str:
    path = tmp_path / "a.gsd"
    path.write_text(GSD, encoding="utf-8")
    return str(path)


class Streams:
    """The three of them, in one encoding and as strict as PYTHONIOENCODING makes them."""

    def __init__(self, encoding: str, typed: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
        self.encoding = encoding
        self._monkeypatch = monkeypatch
        self._octets = {"stdin": io.BytesIO(typed), "stdout": io.BytesIO(), "stderr": io.BytesIO()}

    def main(self, *argv: str) -> int:
        """The exit code."""
        for name, octets in self._octets.items():
            self._monkeypatch.setattr(sys, name, io.TextIOWrapper(octets, encoding=self.encoding, errors="strict"))
        try:
            return main(argv)
        except SystemExit as end:
            return int(str(end.code))
        finally:
            sys.stdout.flush()
            sys.stderr.flush()

    def written(self, name: str) -> str:
        return self._octets[name].getvalue().decode(self.encoding)


@pytest.fixture(params=["ascii", "latin-1", "cp1252", "cp437"])
def streams(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Streams:
    return Streams(request.param, "\nÖ\n8\ny\nn\n".encode(), monkeypatch)


def test_a_table_is_written_with_what_there_is(streams: Streams, gsd: str) -> None:
    assert streams.main("gsd", "show", gsd) == 0
    shown = streams.written("stdout")
    assert r"ller" in shown
    assert r"\u6e29\u5ea6" in shown
    if streams.encoding != "cp1252":  # which has a dash
        assert r"ller - \u6e29" in shown


def test_rich_draws_with_what_there_is(streams: Streams, gsd: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output, "on_terminal", lambda: True)
    assert streams.main("gsd", "show", gsd) == 0
    assert r"\u6e29\u5ea6" in streams.written("stdout")


def test_json_keeps_its_values(streams: Streams, gsd: str) -> None:
    assert streams.main("gsd", "show", gsd, "--json") == 0
    told = json.loads(streams.written("stdout"))
    assert (told["vendor"], told["modules"][0]["name"]) == ("Müller \u2013 温度 \u2026", "Ö \u2013 温")


def test_toml_keeps_its_values(streams: Streams, gsd: str) -> None:
    """The second answer is UTF-8, which is no ASCII and no address: it is asked for again."""
    assert streams.main("gsd", "configure", gsd) == 0
    (slave,) = tomllib.loads(streams.written("stdout"))["slave"]
    assert slave["name"].startswith("öler")
    assert (slave["address"], slave["modules"]) == (8, ["Ö \u2013 温"])


def test_errors_are_written_with_what_there_is(streams: Streams) -> None:
    assert streams.main("plan", "Ö\u2013温.toml") == 2
    assert r"\u6e29.toml: there is no such file" in streams.written("stderr")


@pytest.mark.parametrize("command", ["", *program._COMMANDS])
def test_help(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    streams = Streams("ascii", b"", monkeypatch)
    assert streams.main(*command.split(), "--help") == 0
    assert "usage: dpstack" in streams.written("stdout")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_program_of_its_own(encoding: str, gsd: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "dpstack.cli.main", "gsd", "show", gsd],
        env={**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"},
        capture_output=True,
        check=True,
    )
    assert rb"\u6e29\u5ea6" in done.stdout
    assert done.stderr == b""
