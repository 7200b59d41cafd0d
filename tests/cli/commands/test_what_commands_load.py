"""A command loads what it needs: counted by modules, for times say more of the computer than of the program."""

from __future__ import annotations

import importlib
import json
import os
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from api_kit import HOIST
from gsd_kit import FILES
from plant_files import plant_file

import dpstack
from dpstack.api.bus import opening
from dpstack.capture.pcapng import Writer
from dpstack.cli.main import _COMMANDS, _ROOMS

_PROGRAM = """
import sys
before = set(sys.modules)
from dpstack.cli.main import main
try:
    main(sys.argv[1:])
except SystemExit:
    pass
print("loaded", *(name for name in sys.modules if name not in before))
"""
ROOT = Path(__file__).parents[3]
HEAVY = {"asyncio", "construct", "msgspec", "rich"}


def loaded(program: str, *args: str) -> tuple[set[str], set[str]]:
    """Modules of dpstack that ``program`` has loaded at its end, and those of HEAVY."""
    told = subprocess.run([sys.executable, "-c", program, *args], capture_output=True, text=True, check=True).stdout
    names = set(told.splitlines()[-1].split()[1:])
    return {name for name in names if name.partition(".")[0] == "dpstack"}, names & HEAVY


@pytest.mark.parametrize("args", [["--version"], ["--help"], ["nonsense"], []], ids=" ".join)
def test_help_and_wrong_commands_load_no_command(args: list[str]) -> None:
    ours, heavy = loaded(_PROGRAM, *args)
    assert len(ours) <= 9
    assert heavy == set()


#: modules of Python that take long to load, measured by the 15 ms that a plain command may last
_SLOW = {
    "asyncio",
    "ctypes",
    "dataclasses",
    "difflib",
    "hashlib",
    "inspect",
    "pathlib",
    "shutil",
    "tempfile",
    "traceback",
}


def loaded_without_site(*args: str) -> set[str]:
    """The modules that a command has loaded, in an interpreter whose site-packages have loaded none before."""
    command = [sys.executable, "-S", "-c", _PROGRAM, *args]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split()[1:])


def test_the_version_is_told_without_slow_modules_of_python() -> None:
    assert loaded_without_site("--version") & _SLOW == set()


def test_ctl_asks_a_program_without_slow_modules_of_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder = tmp_path / "dpstack"
    folder.mkdir(mode=0o700)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(folder / "virtual-4711.sock"))
        listening.listen()
        threading.Thread(target=_answer, args=(listening,), daemon=True).start()
        assert loaded_without_site("ctl", "virtual", "status") & _SLOW == set()


def _answer(listening: socket.socket) -> None:
    """Answer one request; a client that only looks who is there asks nothing."""
    line = b""
    while not line:
        connection, _ = listening.accept()
        with connection:
            line = connection.recv(1000)
            if line:
                connection.sendall(b'{"ok": true, "result": {"mode": "operate"}}\n')


def test_the_control_client_is_all_that_ctl_loads() -> None:
    ours, heavy = loaded(_PROGRAM, "ctl", "no/such/port")
    assert len(ours) <= 21
    assert heavy == set()
    assert {name for name in ours if name.startswith("dpstack.api.bus")} == set()


#: modules behind the device file of a drive for its master's end
_OF_DEMAG = {"demag", "demag.outpzd", "demag.plugin", "demag.table", "demag.trace"}
#: modules behind those of dpstack.late_imports, of which a command has only the names
_SPARED = {"ast", "dis", "tokenize", "typing_extensions"}
#: slow modules of Python, of which a drive needs none
_SLOWEST = {"asyncio", "ctypes", "importlib.metadata", "socket", "subprocess"}


@pytest.mark.parametrize(
    ("words", "most", "none_of"),
    [
        ("gsd show GSD", 32, _SLOW - {"pathlib", "inspect"} | _SPARED),
        ("gsd check GSD", 32, _SLOW - {"pathlib", "inspect"} | _SPARED),
        ("decode DC 02 02", 56, _SLOW - {"inspect"} | _SPARED),
        ("gsd show demag-dedrive", 63, _SLOWEST),
        ("plan CONFIG", 106, _SLOWEST),
    ],
)
def test_a_command_loads_what_it_shows(tmp_path: Path, words: str, most: int, none_of: set[str]) -> None:
    """None has a bus; a drive's GSD file needs no drive's Python, a plan the masters' ends of its drives alone."""
    places = {"CONFIG": str(plant_file(tmp_path, HOIST)), "GSD": str(FILES / "whole.gsd")}
    command = [sys.executable, "-c", _PROGRAM, *(places.get(word, word) for word in words.split())]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    names = set(done.stdout.splitlines()[-1].split()[1:])
    ours = {name for name in names if name.partition(".")[0] == "dpstack"}
    assert len(ours) <= most
    assert names & none_of == set()
    assert not {name for name in ours if "simulator" in name}
    drives = {name.partition(".")[2] for name in names if name.startswith("dpstack_drives.")}
    assert drives == (_OF_DEMAG if words == "plan CONFIG" else set())


def test_captures_are_explained_and_judged_without_ports_drives_and_an_event_loop(tmp_path: Path) -> None:
    path = tmp_path / "bus.pcapng"
    with path.open("wb") as file:
        writer = Writer(file, "a test")
        writer.packet(writer.interface("p", 500_000, ""), 1_790_000_000_000_000_000, b"\xdc\2\2")
    for args, most in ((["decode", str(path)], 59), (["monitor", str(path)], 60)):
        ours, heavy = loaded(_PROGRAM, *args)
        assert len(ours) <= most
        assert heavy == {"msgspec"}
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
    room = next((room for room, inside in _ROOMS.items() if name in inside), "commands")
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


def test_a_run_loads_what_it_uses(tmp_path: Path) -> None:
    """Neither the live screen nor reports, recordings, simulated slaves, drives and causes of faults."""
    ours, heavy = loaded(_PROGRAM, "run", str(tmp_path / "there-is-none.toml"))
    assert len(ours) <= 147
    assert heavy == {"asyncio", "msgspec"}
    rooms = {".".join(name.split(".")[1:2]) for name in ours}
    assert rooms.isdisjoint(
        {"bridge", "capture", "decode", "live", "monitor", "profile", "record", "screen", "sim", "web", "why"}
    )


_IN_DATA_EXCHANGE = """
import sys, dpstack
async def main():
    slaves = [{"address": address, "ident": 1, "config": "20 10"} for address in (8, 9)]
    async with dpstack.open_bus(port="virtual", baud=500_000, slaves=slaves) as bus:
        await bus.operate()
        await bus.ready()
dpstack.run_virtual(main())
print(*sys.modules)
"""


def test_slaves_come_up_without_construct() -> None:
    """It takes 10 ms to load, and 0.1 ms and more a PDU."""
    done = subprocess.run([sys.executable, "-c", _IN_DATA_EXCHANGE], capture_output=True, text=True, check=True)
    assert "construct" not in done.stdout.split()


_SERVICE = """
import asyncio, os, pty, sys, threading
import dpstack
class Recorder:
    threads = []
    def find_spec(self, name, *others):
        if name == "construct":
            self.threads.append(threading.current_thread() is threading.main_thread())
sys.meta_path.insert(0, Recorder())
async def main():
    slaves = [{"address": 9, "ident": 1, "config": "20"}]
    if sys.argv[1:]:
        slaves[0] |= {"user_prm": "00 00 00", "dpv1": {}}
    port = os.ttyname(pty.openpty()[1])
    async with dpstack.open_bus(port=port, driver="asyncio", baud=500_000, slaves=slaves) as bus:
        print(*Recorder.threads)
        try:
            await bus.class2.diagnosis(9, timeout=0.01)
        except dpstack.SlaveTimeout:
            print(*Recorder.threads)
asyncio.run(main())
"""


@pytest.mark.parametrize(("alarms", "printed"), [([], ["", "False"]), (["1"], ["True", "True"])], ids=["none", "some"])
def test_construct_is_loaded_beside_the_bus_or_with_alarms_before_it_begins(
    alarms: list[str], printed: list[str]
) -> None:
    done = subprocess.run([sys.executable, "-c", _SERVICE, *alarms], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == printed


_SERVER = """
import asyncio, os, pty, sys
import dpstack.slave
from dpstack.dpv1.slave.loopback_device import MirrorDevice
async def main():
    print("construct" in sys.modules)
    device = MirrorDevice(1, bytes([0x20]))
    async with dpstack.slave.serve_slave(device, port=os.ttyname(pty.openpty()[1]), baud=500_000, address=9):
        print("construct" in sys.modules)
asyncio.run(main())
"""


def test_slaves_on_a_port_load_construct_before_they_answer() -> None:
    done = subprocess.run([sys.executable, "-c", _SERVER], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]


_YOUNG_OBJECTS = """
import gc, os, pty, sys
import dpstack
if sys.argv[1:]:
    gc.freeze()
frozen = gc.get_freeze_count()
slave = {"address": 9, "ident": 1, "config": "20"}
dpstack.open_bus(port=os.ttyname(pty.openpty()[1]), driver="asyncio", baud=500_000, slaves=[slave])
print(gc.isenabled(), frozen, gc.get_freeze_count(), sum(map(len, map(gc.get_objects, (0, 1)))))
"""


def test_no_collection_of_young_objects_looks_at_the_modules_of_a_bus() -> None:
    done = subprocess.run([sys.executable, "-c", _YOUNG_OBJECTS], capture_output=True, text=True, check=True)
    is_enabled, *frozen, young = done.stdout.split()
    assert (is_enabled, frozen) == ("True", ["0", "0"])
    assert int(young) < 1000


def test_objects_that_a_program_has_frozen_stay_frozen() -> None:
    done = subprocess.run([sys.executable, "-c", _YOUNG_OBJECTS, "1"], capture_output=True, text=True, check=True)
    is_enabled, before, after, _ = done.stdout.split()
    assert is_enabled == "True"
    assert int(after) > int(before) - 100 > 1000  # some end with their last reference


def test_a_bus_that_imports_nothing_looks_at_no_old_objects(monkeypatch: pytest.MonkeyPatch) -> None:
    dpstack.open_bus(port="virtual", baud=500_000)  # imports, where no test has had a bus before
    looks: list[None] = []
    monkeypatch.setattr(opening, "_make_old", lambda: looks.append(None))
    dpstack.open_bus(port="virtual", baud=500_000)
    assert not looks


_WITH_A_BUS_PROCESS = """
import asyncio, json, os, pty, sys
import dpstack
async def main():
    port = os.ttyname(pty.openpty()[1])
    async with dpstack.open_bus(port=port, driver="process", baud=500_000, slaves=[json.loads(sys.argv[1])]):
        pass
asyncio.run(main())
"""
#: of each of the two programs: its modules at its end, in a file
_TELLS = """
import atexit, os, sys
def tell():
    name = "bus" if "dpstack.drivers.process" in sys.orig_argv else "application"
    with open(os.path.join(os.environ["TOLD"], name), "w") as file:
        print(*(name for name, module in sys.modules.items() if vars(module)), file=file)
atexit.register(tell)
"""
_PLAIN_SLAVE: dict[str, object] = {"address": 9, "ident": 1, "config": "20 10"}


@pytest.mark.parametrize(
    ("slave", "most", "loads"),
    [
        (_PLAIN_SLAVE, 128, set()),
        ({"address": 9, "drive": "demag-dedrive"}, 168, {"dpstack_drives"}),
    ],
    ids=["plain", "drive"],
)
def test_a_bus_process_loads_what_its_configuration_needs(
    slave: dict[str, object], most: int, loads: set[str], tmp_path: Path
) -> None:
    """And its application has no machines."""
    (tmp_path / "sitecustomize.py").write_text(_TELLS, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "TOLD": str(tmp_path)}
    command = [sys.executable, "-c", _WITH_A_BUS_PROCESS, json.dumps(slave)]
    subprocess.run(command, env=environment, cwd=ROOT, check=True)
    bus, application = (set((tmp_path / name).read_text("utf-8").split()) for name in ("bus", "application"))
    assert {"construct", "dpstack_drives"} & bus == loads
    assert len({name for name in bus if name.startswith("dpstack.")}) <= most
    assert not bus & {"asyncio", "ast", "dis", "dpstack.api", "typing_extensions", "unicodedata"} or loads
    assert {name.split(".")[1] for name in bus if name.startswith("dpstack_drives.")} <= {"demag"}
    machines = "fdl.active.station dp.master.master dpv1.master.ms1 drivers.stack drivers.line.line_runtime"
    assert application.isdisjoint(f"dpstack.{name}" for name in machines.split())
    if not loads:
        services = {"dpstack.dp.acyclic.class2", "dpstack.dpv1.master.ms1", "dpstack.dpv1.pdu.read_write"}
        assert (bus | application).isdisjoint(services)
        ours = {name for name in application if name.startswith("dpstack.")}
        assert len(ours) <= 135
        assert ours.isdisjoint({"dpstack.profile", "dpstack.devices", "dpstack.sim", "dpstack.fdl.codec"})


def test_the_first_bus_loads_nothing_of_gsd_files_drives_and_recordings() -> None:
    """A module costs about 0.3 ms of the processor, a dataclass as much again: a bus loads only what it has."""
    done = subprocess.run([sys.executable, "-c", _FIRST_BUS], capture_output=True, text=True, check=True)
    dataclasses, *names = done.stdout.split()
    ours = {name.removeprefix("dpstack.") for name in names if name.startswith("dpstack.")}
    assert int(dataclasses) <= 1
    assert len(ours) <= 186
    assert {name.partition(".")[0] for name in ours}.isdisjoint({"bridge", "sim", "profile", "record", "live", "why"})
    late = "gsd.parser gsd.model api.slave.drive api.bus.live api.bus.recording drivers.process.client api.config.dpv1"
    late += " api.config.simulate api.config.field_names api.slave.typed dp.process_data dp.pdu.prm_contents"
    assert ours.isdisjoint(late.split())
