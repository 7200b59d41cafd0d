"""A bus process starts beside the imports of the first bus, and only where that bus is going to use it; of programs
that are started in their own ways: isolated, packed, replaced; and of a full bus."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from far_ends import eventually, until
from process_kit import SPEC, bus_on, octet_slaves

import dpstack
import dpstack_drives

#: notes each program that is started, and the modules loaded by then; a pty's other end is silent
PROGRAM = """
import json, os, pty, sys, threading
started = []
def hook(name, args):
    if name == "subprocess.Popen":
        started.append([list(args[1]), list(sys.modules)])
sys.addaudithook(hook)
def children():
    with open(f"/proc/self/task/{threading.get_native_id()}/children") as file:
        return file.read().split()
master, line = pty.openpty()
port = os.ttyname(line)
slave = {"name": "valves", "address": 9, "ident": 0x1234, "config": "20 10"}
given = {"port": port, "baud": 500_000, "slaves": [slave]}
"""


def run(text: str, *arguments: str, cwd: Path | None = None) -> tuple[dict[str, object], str]:
    words = [sys.executable, "-X", "dev", "-P", "-c", PROGRAM + text, *arguments]
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60, cwd=cwd)
    found: dict[str, object] = json.loads(done.stdout)
    return found, done.stderr


_OPENED = """
import asyncio, dpstack
bus = dpstack.open_bus(**given, driver="process")
early = children()
CHANGE
async def main():
    asyncio.get_running_loop().slow_callback_duration = 60  # -X dev reports a busy computer
    async with bus:
        print(json.dumps({"early": early, "running": children(), "started": len(started),
                          "modules": [name for name in started[0][1] if name.startswith(("dpstack", "msgspec"))]}))
asyncio.run(main())
"""


def test_it_is_started_before_the_imports_and_used_for_the_bus() -> None:
    found, errors = run(_OPENED.replace("CHANGE", ""))
    assert found["started"] == 1
    assert found["running"] == found["early"] != []
    assert set(found["modules"]) == {  # type: ignore[call-overload]
        "dpstack",
        "dpstack.namespaces",
        "dpstack.api",
        "dpstack.api.bus",
        "dpstack.api.bus.opening",
        "dpstack.drivers",
        "dpstack.drivers.process",
        "dpstack.drivers.process.early_start",
    }
    assert errors == ""


@pytest.mark.parametrize(
    "change",
    [
        "os.chdir('/')",
        "os.environ['LANG'] = 'C'",
        "os.nice(1)",
        "sys.path.append('/')",
        "os.kill(int(early[0]), 9); os.waitid(os.P_PID, int(early[0]), os.WEXITED | os.WNOWAIT)",
        "from dpstack.drivers.process import early_start; early_start.WAIT_S = 0.0",
    ],
)
def test_a_program_that_has_changed_since_gets_a_new_one(change: str) -> None:
    """A process takes directory, environment, rights and processors over from the program that starts it."""
    found, errors = run(_OPENED.replace("CHANGE", change))
    assert found["started"] == 2
    assert len(found["running"]) == 1  # type: ignore[arg-type]
    assert found["running"] != found["early"]
    assert errors == ""


def test_the_child_of_a_fork_does_not_take_its_parents_process() -> None:
    change = "if os.fork(): print(os.wait()[1], file=sys.stderr); os.close(1); os._exit(int(children() != early))"
    found, errors = run(_OPENED.replace("CHANGE", change).replace("asyncio.run", "sys.stderr.flush(); asyncio.run"))
    assert found["started"] == 2
    assert found["running"] != found["early"]
    assert errors.splitlines()[-1] == "0"


@pytest.mark.parametrize(
    "call",
    [
        'dpstack.open_bus(**given, driver="asyncio")',
        "dpstack.open_bus(**given)",
        'dpstack.open_bus(**given | {"port": "virtual"})',
        "import dpstack.drivers.process.client; dpstack.open_bus(**given, driver='process')",
        "t = threading.Thread(target=lambda: dpstack.open_bus(**given, driver='process')); t.start(); t.join()",
    ],
)
def test_none_is_started_where_none_is_used_or_no_imports_are_left(call: str) -> None:
    text = f"import dpstack\n{call}\nprint(json.dumps({{'started': started}}))"
    assert run(text) == ({"started": []}, "")


def test_a_refused_configuration_leaves_none() -> None:
    text = """
import dpstack
try:
    dpstack.open_bus(**given, driver="process", address=9)
except dpstack.ConfigError as error:
    import gc
    print(json.dumps({"started": len(started), "children": children(), "error": str(error), "gc": gc.isenabled()}))
"""
    found, errors = run(text)
    assert (found["started"], found["children"], found["gc"]) == (1, [], True)
    assert "9" in str(found["error"])
    assert errors == ""


def test_a_bus_that_is_never_opened_leaves_none() -> None:
    text = "import dpstack\nbus = dpstack.open_bus(**given, driver='process')\nprint(json.dumps(children()))"
    words = [sys.executable, "-X", "dev", "-P", "-c", PROGRAM + text]
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60)
    (pid,) = json.loads(done.stdout)
    assert not Path(f"/proc/{pid}").exists()
    assert done.stderr == ""


_COMMAND = """
sys.argv[1:] = WORDS
import atexit
atexit.register(lambda: print(json.dumps([[words[-1].isdigit(), len(modules)] for words, modules in started])))
from dpstack.cli.main import main
raise SystemExit(main())
"""


@pytest.mark.parametrize(
    ("bus", "words", "wanted"),
    [
        ('driver = "process"', ["run", "plant.toml"], 1),
        ('driver = "process"', ["run", "--driver", "asyncio", "plant.toml"], 0),
        ('driver = "process"', ["run", "--driver=asyncio", "plant.toml"], 0),
        ("", ["run", "plant.toml", "--driver=process"], 1),
        ("", ["run", "plant.toml"], 0),
        ('driver = "process"', ["plan", "plant.toml"], 0),
        ('name = "process"', ["run", "plant.toml"], 0),
    ],
)
def test_a_run_starts_it_before_its_imports(bus: str, words: list[str], wanted: int, tmp_path: Path) -> None:
    """The configuration is refused later (its slave has the master's address), and the process has gone by then."""
    slave = '[[slave]]\nname = "a"\naddress = 2\nident = 1\nconfig = "20"\n'
    tmp_path.joinpath("plant.toml").write_text(f'[bus]\nport = "/dev/null"\nbaud = 500000\n{bus}\n{slave}')
    text = PROGRAM + _COMMAND.replace("WORDS", repr(words))
    program = [sys.executable, "-X", "dev", "-P", "-c", text]
    done = subprocess.run(program, capture_output=True, text=True, check=False, timeout=60, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") <= 3
    assert "Traceback" not in done.stderr
    assert "still running" not in done.stderr
    begun = json.loads(done.stdout.splitlines()[-1])
    assert len(begun) == wanted
    assert all(ours for ours, _ in begun)


PLANT = """
import asyncio, os, sys
import dpstack
VALVES = {{"name": "valves", "address": 4, "ident": 0x1234, "config": "21 11"}}
async def main():
    bus = dpstack.open_bus(port={path!r}, baud=1_500_000, slaves=[VALVES], gap=0, driver="process", host_slack_ms=200)
    async with bus:
        await bus.ready()
        await bus.operate()
        bus.slave("valves").outputs = b"\\x11\\x22"
        while bus.slave("valves").inputs != b"\\x11\\x22":
            await asyncio.sleep(0.005)
        {then}
    print(sys.flags.isolated, dpstack.__file__)
if __name__ == "__main__":
    asyncio.run(main())
"""


def words_of(*command: str) -> list[str]:
    """The words that a program prints."""
    return subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, timeout=100, check=True
    ).stdout.split()


@pytest.mark.soak
def test_an_isolated_interpreter(tmp_path: Path) -> None:
    """``python -I``: nothing of the environment counts, and the bus process finds everything all the same."""
    with octet_slaves(SPEC) as (path, there):
        (tmp_path / "plant.py").write_text(PLANT.format(path=path, then=""))
        assert words_of("-I", str(tmp_path / "plant.py"))[0] == "1"
        eventually(lambda: there.slaves[4].outputs == bytes(2), "its last octets read")


@pytest.mark.soak
def test_a_zipapp(tmp_path: Path) -> None:
    """``python -m zipapp``: dpstack is in the archive, what is compiled beside it."""
    packed = tmp_path / "plant.pyz"
    with octet_slaves(SPEC) as (path, there):
        with zipfile.ZipFile(packed, "w") as archive:
            for package in (dpstack, dpstack_drives):
                assert package.__file__ is not None
                root = Path(package.__file__).parent
                for file in [*root.rglob("*.py"), *root.rglob("*.gsd")]:
                    archive.write(file, file.relative_to(root.parent))
            archive.writestr("__main__.py", PLANT.format(path=path, then=""))
        assert words_of(str(packed))[1].startswith(str(packed))
        eventually(lambda: there.slaves[4].outputs == bytes(2), "its last octets read")


@pytest.mark.soak
def test_a_program_that_another_one_takes_the_place_of(tmp_path: Path) -> None:
    """``exec``: the bus process notices it, ends in order, and the next one has the port."""
    with octet_slaves(SPEC) as (path, there):
        again = "if len(sys.argv) == 1: os.execv(sys.executable, [sys.executable, *sys.argv, 'again'])"
        (tmp_path / "plant.py").write_text(PLANT.format(path=path, then=again))
        assert words_of(str(tmp_path / "plant.py"))[0] == "0"
        eventually(lambda: there.slaves[4].outputs == bytes(2), "its last octets read")


@pytest.mark.soak
async def test_a_hundred_slaves() -> None:
    addresses = range(3, 103)
    slaves: list[dict[str, object]] = [
        {"name": f"s{address}", "address": address, "ident": 0x1234, "config": "20 10"} for address in addresses
    ]
    with octet_slaves(*(f"{address}:1234:2010:1:1" for address in addresses)) as (path, there):
        async with bus_on(path, "process", *slaves, host_slack_ms=200) as bus:
            await bus.ready(100)
            await bus.operate()
            for slave in bus.slaves:
                slave.outputs = bytes((slave.address,))
            await until(lambda: all(slave.inputs == bytes((slave.address,)) for slave in bus.slaves), "all mirrors")
        await until(lambda: all(slave.outputs == bytes(1) for slave in there.slaves.values()), "Clear")
