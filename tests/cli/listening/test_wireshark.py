"""``dpstack wireshark`` with the folders of a made-up Wireshark, and its extcap program.

Tests with the real tshark: tests/strangers/test_tshark.py.
"""

from __future__ import annotations

import fnmatch
import os
import subprocess
import sys
import tomllib
from importlib import resources
from pathlib import Path

import pytest
from cli_kit import Cli

from dpstack.errors import DpError
from dpstack.wireshark import extcap, installation
from dpstack.wireshark.installation import EXTCAP_NAME, LUA_NAME, MARK

ROOT = Path(__file__).resolve().parents[3]


class Machine:
    """A home folder, and a program ``tshark`` of some version."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.home = folder / "home"
        self.bin = folder / "bin"
        self.configuration = self.home / ".config" / "wireshark"
        self.lua = self.home / ".local/lib/wireshark/plugins" / LUA_NAME
        self.old_extcap = self.configuration / "extcap" / EXTCAP_NAME
        self.new_extcap = self.home / ".local/lib/wireshark/extcap" / EXTCAP_NAME
        self.home.mkdir()
        self.bin.mkdir()
        monkeypatch.setenv("HOME", str(self.home))
        monkeypatch.setenv("PATH", str(self.bin))
        monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)

    def tshark(self, version: str, *folders: str) -> None:
        """Install tshark of a version that prints these folders besides the usual two; {c} is $XDG_CONFIG_HOME."""
        lines = [
            "Personal configuration:\\t${XDG_CONFIG_HOME:-$HOME/.config}/wireshark",
            "Global configuration:\\t/usr/share/wireshark",
            "Personal Lua Plugins:\\t$HOME/.local/lib/wireshark/plugins",
            *folders,
        ]
        shown = "\n".join(f'printf "{line}\\n"' for line in lines)
        script = f'#!/bin/sh\nif [ "$1" = --version ]; then echo "TShark (Wireshark) {version}."; exit; fi\n{shown}\n'
        path = self.bin / "tshark"
        path.write_text(script)
        path.chmod(0o755)


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    return Machine(tmp_path, monkeypatch)


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if not path.is_dir())


def test_version_4_0_takes_a_personal_extcap_from_its_configuration(machine: Machine, cli: Cli) -> None:
    machine.tshark("4.0.17", "Extcap path:\\t/usr/lib/wireshark/extcap")
    out = cli.out("wireshark", "install")
    assert str(machine.lua) in out
    assert str(machine.old_extcap) in out
    assert _files(machine.home) == sorted([machine.lua, machine.old_extcap])
    assert machine.lua.read_bytes() == resources.files("dpstack.wireshark").joinpath("profibus.lua").read_bytes()
    assert os.access(machine.old_extcap, os.X_OK)
    assert machine.old_extcap.read_text().startswith(f"#!{sys.executable} -P\n")
    where = cli.json("wireshark", "where")
    assert where == {
        "tshark": str(machine.bin / "tshark"),
        "version": "4.0.17",
        "dissector": {"path": str(machine.lua), "state": "current"},
        "extcap": {"path": str(machine.old_extcap), "state": "current"},
    }
    removed = cli.json("wireshark", "remove")
    assert removed == {"removed": [str(machine.lua), str(machine.old_extcap)], "left": []}
    assert _files(machine.home) == []
    assert cli.out("wireshark", "remove") == "nothing of dpstack was there\n"


@pytest.mark.parametrize("named", [True, False])
def test_newer_versions_have_another_folder(machine: Machine, cli: Cli, named: bool) -> None:
    folders = ["Personal Extcap path:\\t$HOME/.local/lib/wireshark/extcap"] if named else []
    machine.tshark("4.4.2", *folders)
    cli.out("wireshark", "install")
    assert _files(machine.home) == sorted([machine.lua, machine.new_extcap])


def test_remove_finds_what_was_installed_for_an_older_version(machine: Machine, cli: Cli) -> None:
    machine.tshark("4.0.17")
    cli.out("wireshark", "install")
    machine.tshark("4.2.0")
    cli.out("wireshark", "install")
    assert machine.old_extcap.exists()
    assert machine.new_extcap.exists()
    assert len(cli.json("wireshark", "remove")["removed"]) == 3
    assert _files(machine.home) == []


def test_the_configuration_folder_of_the_user(
    machine: Machine, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "elsewhere"))
    machine.tshark("4.0.17")
    cli.out("wireshark", "install")
    assert (tmp_path / "elsewhere/wireshark/extcap" / EXTCAP_NAME).exists()


@pytest.mark.parametrize("how", ["file", "link", "folder"])
def test_files_of_others_are_left(machine: Machine, cli: Cli, how: str) -> None:
    machine.tshark("4.0.17")
    machine.old_extcap.parent.mkdir(parents=True)
    match how:
        case "file":
            machine.old_extcap.write_text("#!/bin/sh\n# mine\n")
        case "link":
            machine.old_extcap.symlink_to("/nowhere")
        case _:
            machine.old_extcap.mkdir()
    err = cli.err("wireshark", "install", code=2)
    assert "there is another file of that name" in err
    assert str(machine.old_extcap) in err
    assert not machine.lua.exists()
    assert "there is another file" in cli.out("wireshark", "where")
    out, err = cli("wireshark", "remove")
    assert (out, "left as it is" in err) == ("nothing of dpstack was there\n", True)
    assert os.path.lexists(machine.old_extcap)


def test_an_older_file_of_ours_is_replaced(machine: Machine, cli: Cli) -> None:
    machine.tshark("4.0.17")
    machine.lua.parent.mkdir(parents=True)
    machine.lua.write_bytes(b"-- " + MARK + b"\nold\n")
    assert cli.json("wireshark", "where")["dissector"]["state"] == "old"
    cli.out("wireshark", "install")
    assert cli.json("wireshark", "where")["dissector"]["state"] == "current"


def test_no_tshark_and_one_that_does_not_answer(machine: Machine, cli: Cli) -> None:
    assert "tshark was not found" in cli.err("wireshark", "where", code=1)
    machine.tshark("4.0.17")
    (machine.bin / "tshark").write_text("#!/bin/sh\necho 'cannot open display' >&2\nexit 3\n")
    assert "cannot open display" in cli.err("wireshark", "install", code=1)
    (machine.bin / "tshark").write_text("#!/bin/sh\necho hello\n")
    assert "does not name its folders" in cli.err("wireshark", "install", code=1)


def test_a_folder_that_cannot_be_made(machine: Machine, cli: Cli) -> None:
    machine.tshark("4.0.17")
    (machine.home / ".local").write_text("a file")
    err = cli.err("wireshark", "install", code=1)
    assert LUA_NAME in err
    assert err.count("\n") == 1


def test_both_files_are_in_the_wheel() -> None:
    data = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["dpstack"]
    assert any(fnmatch.fnmatch("wireshark/profibus.lua", pattern) for pattern in data)
    for name in ("profibus.lua", "extcap.py"):
        assert resources.files("dpstack.wireshark").joinpath(name).is_file()
    assert MARK in resources.files("dpstack.wireshark").joinpath("profibus.lua").read_bytes()[:200]


# --- the extcap program ---
def _run(path: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [path, *arguments], capture_output=True, text=True, check=False, env={**os.environ, **environment}, timeout=30
    )


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "dpstack-profibus"
    path.write_bytes(installation.extcap_program())
    path.chmod(0o755)
    return path


def test_it_lists_interfaces_without_the_stack(program: Path, tmp_path: Path) -> None:
    done = _run(
        program,
        "--extcap-interfaces",
        "--extcap-version=4.0",
        XDG_RUNTIME_DIR=str(tmp_path),
        PYTHONPROFILEIMPORTTIME="1",
    )
    assert done.stdout.splitlines()[0] == "extcap {version=1.0}{display=PROFIBUS by dpstack}"
    imported = [line.rpartition("|")[2].strip() for line in done.stderr.splitlines()]
    assert "json" in imported
    assert not [name for name in imported if name.startswith(("dpstack", "asyncio", "construct", "msgspec", "serial"))]


def test_link_type_and_options(program: Path) -> None:
    interface = ("--extcap-interface", "dpstack:/dev/ttyUSB0")
    assert _run(program, "--extcap-dlts", *interface).stdout == "dlt {number=147}{name=USER0}{display=PROFIBUS}\n"
    options = _run(program, "--extcap-config", *interface).stdout.splitlines()
    assert options[0].startswith("arg {number=0}{call=--baud}{display=Baud rate}")
    assert options[1] == "value {arg=0}{value=auto}{display=found by listening}{default=true}"
    assert "value {arg=0}{value=45450}{display=45.45 kbit/s}{default=false}" in options


def test_wrong_calls_have_one_line(program: Path) -> None:
    for arguments in ((), ("--capture",), ("--extcap-interface=dpstack:x", "--extcap-capture-filter=host 3")):
        done = _run(program, *arguments)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
        assert done.stderr.startswith("dpstack: ")


def test_an_interpreter_with_blanks_in_its_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "my programs"
    folder.mkdir()
    python = folder / "it's python"
    python.symlink_to(sys.executable)
    monkeypatch.setattr(sys, "executable", str(python))
    path = tmp_path / "extcap"
    path.write_bytes(installation.extcap_program())
    path.chmod(0o755)
    assert _run(path, "--extcap-dlts").stdout.startswith("dlt {number=147}")
    monkeypatch.setattr(sys, "executable", "")
    with pytest.raises(DpError, match="its own path"):
        installation.extcap_program()


def test_sockets_of_a_folder_that_others_may_write_to_are_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "dpstack"
    folder.mkdir(mode=0o700)
    (folder / "a.sock").write_text("no socket")
    (folder / "b.sock").symlink_to("a.sock")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(extcap, "_serial_ports", lambda: iter([("/dev/ttyUSB0", "a\x1b{b}"), ("/dev/{x}", "y")]))
    assert extcap.interfaces() == [("/dev/ttyUSB0", "a??b?")]
    monkeypatch.setattr(
        extcap, "_help", lambda path: {"kind": "run", "port": "/dev/ttyUSB0", "commands": [{"command": "tap"}]}
    )
    assert extcap.interfaces() == [("/dev/ttyUSB0", "PROFIBUS: run on /dev/ttyUSB0")]
    folder.chmod(0o777)
    assert extcap.interfaces() == [("/dev/ttyUSB0", "a??b?")]


NAMED = """
[bus]
port = "virtual"
baud = 500000
[[slave]]
name = "tank 1"
address = 8
ident = 0x1234
config = "24 17"
inputs = { limit = "bool@0.3", level = { at = "i16@1", scale = 0.1, unit = "°C" }, flow = "f32ws@4", rest = "u4@3.4" }
outputs = { raw = "bytes@0:3" }
"""


def test_names_for_the_dissector(tmp_path: Path, cli: Cli) -> None:
    config = tmp_path / "plant.toml"
    config.write_text(NAMED)
    assert cli.out("wireshark", "names", str(config)).splitlines() == [
        "# names for the PROFIBUS dissector of dpstack",
        "8\tstation\ttank 1",
        "8\tinput\tbool\t0\t1\t3\t1\tbig\t1\t0\t\tlimit",
        "8\tinput\tint\t1\t2\t0\t16\tbig\t0.1\t0\t°C\tlevel",
        "8\tinput\tfloat\t4\t4\t0\t32\tswapped\t1\t0\t\tflow",
        "8\tinput\tuint\t3\t1\t4\t4\tbig\t1\t0\t\trest",
        "8\toutput\tbytes\t0\t3\t0\t24\tbig\t1\t0\t\traw",
    ]
    out = tmp_path / "plant.names"
    assert cli.json("wireshark", "names", str(config), "--out", str(out)) == {
        "out": str(out),
        "stations": 1,
        "names": 5,
    }
    assert out.read_text().endswith("raw\n")
    assert "there is a file of that name" in cli.err("wireshark", "names", str(config), "--out", str(out))
    config.write_text(f'{NAMED}\n[[ppi]]\naddress = 2\nname = "press"\nvalues = {{ level = "VW100" }}\n')
    assert cli.out("wireshark", "names", str(config)).splitlines()[-2:] == [
        "2\tstation\tpress",
        "2\tmemory\tuint\t0\t2\t0\t16\tbig\t1\t0\t\tlevel\t132\t1\t800\t2\t2",
    ]
    assert "name the configuration file of the plant" in cli.err("wireshark", "names")
    assert "only `wireshark names` does" in cli.err("wireshark", "where", str(config))
