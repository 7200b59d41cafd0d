"""The scripts of ``dpstack completion`` in interactive shells on a pty: bash, zsh and fish complete at TAB."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import subprocess
import termios
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest
from far_ends import HANG_S

from dpstack.cli.commands.completion import SHELLS, parsers_below, script
from dpstack.cli.main import build_parser
from tests.strangers.stranger_kit import program, run_program

pytestmark = pytest.mark.strangers

#: typed until TAB, and the words that the shell has then; DEV stands for the folder of devices
CASES: Final = (
    ("deco", ["decode"]),
    ("--ver", ["--version"]),
    ("gsd sh", ["gsd", "show"]),
    ("gsd show oth", ["gsd", "show", "other.gsd"]),
    ("gsd write valve:V --fo", ["gsd", "write", "valve:V", "--force"]),
    ("run pla", ["run", "plant.toml"]),
    ("run --cle", ["run", "--clear"]),
    ("run --driver pro", ["run", "--driver", "process"]),
    ("run plant.toml --baud 45", ["run", "plant.toml", "--baud", "45450"]),
    ("run --outputs valves=07 --read-o", ["run", "--outputs", "valves=07", "--read-only"]),
    ("sim --drive demag-", ["sim", "--drive", "demag-dedrive"]),
    ("plan plant.toml --baud al", ["plan", "plant.toml", "--baud", "all"]),
    ("scan --port DEV/ttyA", ["scan", "--port", "DEV/ttyACM0"]),
    ("scan --port DEV/bus/on", ["scan", "--port", "DEV/bus/only"]),
    ("ctl virt", ["ctl", "virtual"]),
    ("segment --dir fold", ["segment", "--dir", "folder"]),
    ("web --tls oth", ["web", "--tls", "other.gsd"]),
    ("capture --linktype 2", ["capture", "--linktype", "257"]),
    ("acyclic plant.toml 8 read 1 1 --cla", ["acyclic", "plant.toml", "8", "read", "1", "1", "--class"]),
    ("wireshark ins", ["wireshark", "install"]),
    ("completion zs", ["completion", "zsh"]),
    ("nonsen", ["nonsen"]),
)
_SHOW: Final = "printf '<%s>' \"$@\"; echo 'E''ND'"
#: a key that completes and enters: zsh completes nothing while more keys wait
_BOTH: Final = "both() { zle complete-word; zle accept-line; }; zle -N both; bindkey '^I' both"
_START: Final = {
    "bash": (["--norc", "--noprofile", "-i"], f". ./script; dpstack() {{ {_SHOW}; }}"),
    "zsh": (
        ["-f", "-i"],
        f"fpath=($PWD $fpath); autoload -U compinit; compinit -u -D; {_BOTH}; dpstack() {{ {_SHOW}; }}",
    ),
    "fish": (["--no-config", "-i"], "source ./script; function dpstack; printf '<%s>' $argv; echo 'E''ND'; end"),
}


class Shell:
    """An interactive shell in which ``dpstack`` is a function that shows its arguments."""

    def __init__(self, name: str, folder: Path) -> None:
        arguments, begin = _START[name]
        self._fd, inner = pty.openpty()
        fcntl.ioctl(self._fd, termios.TIOCSWINSZ, b"\x32\0\xc8\0\0\0\0\0")  # 50 lines of 200 columns
        environment = {"PATH": "/usr/bin:/bin", "HOME": str(folder), "TERM": "xterm", "LANG": "C.UTF-8"}
        self._process = subprocess.Popen(
            ["setsid", "--ctty", program(name), *arguments],
            stdin=inner, stdout=inner, stderr=inner, cwd=folder, env=environment,
        )  # fmt: skip
        os.close(inner)
        self._output = ""
        self._tab = "\t" if name == "zsh" else "\t\r"
        self._type(f"{begin}; dpstack ready\r")
        assert self._words() == ["ready"]

    def _type(self, text: str) -> None:
        os.write(self._fd, text.encode())

    def completed(self, typed: str) -> list[str]:
        """The words after ``dpstack`` once TAB and Enter were typed behind ``typed``."""
        self._type(f"dpstack {typed}{self._tab}")
        return self._words()

    def _words(self) -> list[str]:
        """The next arguments that ``dpstack`` gets."""
        end = time.monotonic() + HANG_S
        while "END" not in self._output:
            assert time.monotonic() < end, f"the shell hangs: {self._output[-2000:]!r}"
            if select.select([self._fd], [], [], 1.0)[0]:
                self._output += os.read(self._fd, 65536).decode(errors="replace")
        shown, _, self._output = self._output.partition("END")
        # zsh takes the slash behind a folder away
        return [word.removesuffix("/") for word in re.findall(r"<([^<>]*)>", shown.rpartition("\n")[2])]

    def close(self) -> None:
        os.close(self._fd)  # the shell gets SIGHUP
        self._process.wait(HANG_S)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The working directory of the shell, with files and devices to be completed."""
    for name in ("plant.toml", "plant.txt", "other.gsd", "folder/file", "dev/ttyUSB0", "dev/ttyACM0", "dev/bus/only"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.touch()
    return tmp_path


def write_script(shell: str, folder: Path) -> Path:
    """The script for devices in a folder of the test."""
    path = folder / ("_dpstack" if shell == "zsh" else "script")
    path.write_text(script(shell).replace("/dev/", f"{folder}/dev/"), encoding="utf-8")
    return path


@pytest.fixture(params=SHELLS)
def shell(request: pytest.FixtureRequest, folder: Path) -> Iterator[Shell]:
    write_script(request.param, folder)
    opened = Shell(request.param, folder)
    yield opened
    opened.close()


def test_tab_in_a_shell(shell: Shell, folder: Path) -> None:
    devices = f"{folder}/dev"
    found = {typed: shell.completed(typed.replace("DEV", devices)) for typed, _ in CASES}
    assert found == {typed: [word.replace("DEV", devices) for word in words] for typed, words in CASES}


def all_options() -> dict[str, list[str]]:
    """The options of each command, as the parsers have them."""
    return {
        parser.prog: sorted(
            name for action in parser.actions() for name in action.option_strings if name.startswith("--")
        )
        for parser in parsers_below(build_parser())
    }


def test_fish_offers_every_option_of_every_command(folder: Path) -> None:
    path = write_script("fish", folder)
    wanted = all_options()
    asked = "; ".join(f"echo '[{prog}]'; complete -C '{prog} --'" for prog in wanted)
    told = run_program("fish", ["--no-config", "-c", f"source {path}; {asked}"]).stdout
    sections = dict(re.findall(r"^\[(.*)\]\n((?:-.*\n)*)", told, re.MULTILINE))
    offered = {prog: sorted(line.split("\t")[0] for line in text.splitlines()) for prog, text in sections.items()}
    assert offered == wanted


def test_bash_offers_every_option_of_every_command(folder: Path) -> None:
    path = write_script("bash", folder)
    wanted = all_options()
    asked = "; ".join(
        f'COMP_WORDS=({prog} --); COMP_CWORD={len(prog.split())}; _shtab_dpstack; echo "{prog}:${{COMPREPLY[*]}}"'
        for prog in wanted
    )
    told = run_program("bash", ["--norc", "-c", f". {path}; {asked}"]).stdout
    offered = {line.split(":")[0]: sorted(line.split(":")[1].split()) for line in told.splitlines()}
    assert offered == wanted


@pytest.mark.parametrize("name", SHELLS)
def test_ports_for_an_empty_word(name: str, folder: Path) -> None:
    """The devices that are there, and the simulated bus; no files of the working directory."""
    path = write_script(name, folder)
    call = {
        "bash": f". {path}; COMP_WORDS=(dpstack scan --port ''); COMP_CWORD=3; _shtab_dpstack; "
        "printf '%s\\n' \"${COMPREPLY[@]}\"",
        "zsh": f"compdef() {{ :; }}; compadd() {{ shift; print -l -- $@; }}; . {path}; PREFIX=; _dpstack_port_files",
        "fish": f"source {path}; complete -C 'dpstack scan --port '",
    }[name]
    options = {"bash": "--norc", "zsh": "-f", "fish": "--no-config"}[name]
    told = run_program(name, [options, "-c", call]).stdout
    found = sorted(line.split("\t")[0] for line in told.splitlines())
    assert found == [str(folder / "dev" / port) for port in ("ttyACM0", "ttyUSB0")] + ["virtual"]
