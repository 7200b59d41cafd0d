"""A command loads what it needs: counted by modules, for times say more of the computer than of the program."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from dpstack.capture.pcapng import Writer
from dpstack.cli.main import _COMMANDS, _LISTENING, _LOOKING

_PROGRAM = """
import sys
from dpstack.cli.main import main
try:
    main(sys.argv[1:])
except SystemExit:
    pass
print("loaded", *sys.modules)
"""
HEAVY = {"asyncio", "construct", "msgspec", "rich"}


def loaded(program: str, *args: str) -> tuple[set[str], set[str]]:
    """Modules of dpstack that ``program`` has loaded at its end, and those of HEAVY."""
    told = subprocess.run([sys.executable, "-c", program, *args], capture_output=True, text=True, check=True).stdout
    names = set(told.splitlines()[-1].split()[1:])
    return {name for name in names if name.partition(".")[0] == "dpstack"}, names & HEAVY


@pytest.mark.parametrize("args", [["--version"], ["--help"], ["nonsense"], []], ids=" ".join)
def test_help_and_wrong_commands_load_no_command(args: list[str]) -> None:
    ours, heavy = loaded(_PROGRAM, *args)
    assert len(ours) <= 12
    assert heavy == set()


def test_the_control_client_is_all_that_ctl_loads() -> None:
    ours, heavy = loaded(_PROGRAM, "ctl", "no/such/port")
    assert len(ours) <= 32
    assert heavy == set()
    assert {name for name in ours if name.startswith("dpstack.api.bus")} == set()


def test_captures_are_explained_and_judged_without_ports_drives_and_an_event_loop(tmp_path: Path) -> None:
    path = tmp_path / "bus.pcapng"
    with path.open("wb") as file:
        writer = Writer(file, "a test")
        writer.packet(writer.interface("p", 500_000, ""), 1_790_000_000_000_000_000, b"\xdc\2\2")
    for args, most in ((["decode", "DC", "02", "02"], 70), (["decode", str(path)], 70), (["monitor", str(path)], 65)):
        ours, heavy = loaded(_PROGRAM, *args)
        assert len(ours) <= most
        assert heavy == {"construct", "msgspec"}
        rooms = {".".join(name.split(".")[:2]) for name in ours}
        assert rooms.isdisjoint({"dpstack.drivers", "dpstack.ports", "dpstack.sim", "dpstack.profile"})


def test_the_module_dpstack_is_the_program() -> None:
    """``python -m dpstack`` from any directory, with the program's name in its errors, and its exit code."""
    command = [sys.executable, "-P", "-m", "dpstack"]
    done = subprocess.run([*command, "decode", "nonsense"], cwd="/", capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("dpstack: ")
    assert done.stderr.count("\n") == 1


def test_the_package_loads_nothing_of_itself() -> None:
    assert loaded("import sys, dpstack; print('loaded', *sys.modules)") == ({"dpstack", "dpstack.namespaces"}, set())


@pytest.mark.parametrize("name", _COMMANDS)
def test_a_command_is_the_module_of_its_name(name: str) -> None:
    room = "listening" if name in _LISTENING else "looking" if name in _LOOKING else "commands"
    assert callable(importlib.import_module(f"dpstack.cli.{room}.{name}").add_to)


_FIRST_BUS = """
import dataclasses, os, pty, sys
made, process_class = [], dataclasses._process_class
dataclasses._process_class = lambda *args: made.append(1) or process_class(*args)
import dpstack
slave = {"address": 9, "ident": 1, "config": "20"}
dpstack.open_bus(port=os.ttyname(pty.openpty()[1]), driver="asyncio", baud=500_000, slaves=[slave])
print(len(made), *sys.modules)
"""


def test_the_first_bus_loads_nothing_of_gsd_files_drives_and_recordings() -> None:
    """A module costs about 0.3 ms of the processor, a dataclass as much again: a bus loads only what it has."""
    done = subprocess.run([sys.executable, "-c", _FIRST_BUS], capture_output=True, text=True, check=True)
    dataclasses, *names = done.stdout.split()
    ours = {name.removeprefix("dpstack.") for name in names if name.startswith("dpstack.")}
    assert int(dataclasses) <= 62
    assert len(ours) <= 186
    assert {name.partition(".")[0] for name in ours}.isdisjoint({"sim", "profile", "record", "live", "why"})
    late = "gsd.parser gsd.model api.slave.drive api.bus.live api.bus.recording drivers.process.client"
    assert ours.isdisjoint(late.split())
