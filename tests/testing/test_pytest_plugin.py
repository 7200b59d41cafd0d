"""The pytest plugin in runs of pytest of its own: without other plugins, and beside those for asyncio."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from api_kit import in_operate

import dpstack
from dpstack.testing import BusFactory, VirtualTime

ROOT = Path(__file__).resolve().parents[2]
TESTS = """
import asyncio, dpstack, pytest

FAN = {"name": "fan", "address": 4, "drive": "fuji-frenic", "telegram": "PPO3", "ident": 0xDD04}

def test_time_stands_still_between_runs(dpstack_bus):
    bus = dpstack_bus(slaves=[FAN], baud=19200)
    before = bus.now
    bus.wait(1)
    after = bus.now
    assert 0.99 < after - before < 1.01
    assert bus.now == after
    bus.wire.assert_brought_up("fan")

def test_that_fails(dpstack_bus):
    bus = dpstack_bus(slaves=[FAN], baud=19200)
    bus.faults.silence("fan")
    bus.wait(0.5)
    assert False, "on purpose"
"""
ASYNC = """
@pytest.mark.{mark}
async def test_of_another_plugin(dpstack_bus):
    with pytest.raises(dpstack.UsageError, match="call it from a plain function"):
        dpstack_bus(slaves=[FAN])
    await asyncio.sleep(0)
"""
ASYNCIO = "pytest_asyncio.plugin"
#: pytest-asyncio warns where it is left out
SCOPE = ("-o", "asyncio_default_fixture_loop_scope=function")


def run_pytest(folder: Path, *arguments: str, plugins: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
    """pytest in ``folder`` with our plugin and ``plugins``, every warning an error."""
    chosen = [word for name in ("dpstack.testing.plugin", *plugins) for word in ("-p", name)]
    command = [sys.executable, "-W", "error", "-m", "pytest", "-p", "no:cacheprovider", "-q", "-c", "/dev/null"]
    return subprocess.run(
        [*command, "--rootdir", str(folder), "-o", "filterwarnings=error", *chosen, *arguments, str(folder)],
        capture_output=True,
        text=True,
        timeout=300,
        env={"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PATH": "/usr/bin:/bin", "PYTHONPATH": str(ROOT / "drives")},
        cwd=ROOT,
    )


def test_without_another_plugin_and_the_wire_log_of_a_failure(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(TESTS, encoding="utf-8")
    told = run_pytest(tmp_path, "-o", "dpstack_wire_log=12").stdout
    assert "1 failed, 1 passed" in told, told
    head = told.partition("dpstack bus 1 of 1")[2]
    assert "slave 4 (fan): stopped answering during Data_Exchange" in head
    assert "faults that act: fan: silence" in head
    log = head.partition("the last of the wire (12 lines):")[2].partition("short test summary")[0]
    assert len(re.findall(r"^ +(?:\d+ +\d+\.\d{9}|\.\.\. \d+ telegrams) ", log, re.MULTILINE)) == 12
    assert re.search(r"Data_Exchange request 2 -> 4 \[fan\].*CTW 047E .*set point 0\.0%.*; not answered", log)
    assert "Slave_Diag request 2 -> 4 [fan]" in log


@pytest.mark.soak
@pytest.mark.parametrize(
    ("plugins", "arguments", "mark"),
    [
        ((ASYNCIO,), (*SCOPE, "-o", "asyncio_mode=strict"), "asyncio"),
        ((ASYNCIO,), (*SCOPE, "-o", "asyncio_mode=auto"), "asyncio"),
        (("anyio.pytest_plugin",), (), "anyio"),
        (("anyio.pytest_plugin", ASYNCIO), (*SCOPE, "-o", "asyncio_mode=auto"), "asyncio"),
    ],
    ids=["asyncio strict", "asyncio auto", "anyio", "both"],
)
def test_beside_plugins_for_asyncio(
    tmp_path: Path, plugins: tuple[str, ...], arguments: tuple[str, ...], mark: str
) -> None:
    (tmp_path / "conftest.py").write_text(
        'import pytest\n\n@pytest.fixture\ndef anyio_backend():\n    return "asyncio"\n', encoding="utf-8"
    )
    (tmp_path / "test_it.py").write_text(TESTS + ASYNC.format(mark=mark), encoding="utf-8")
    told = run_pytest(tmp_path, *arguments, plugins=plugins)
    assert "1 failed, 2 passed" in told.stdout, told.stdout + told.stderr


def test_its_entry_point_loads_no_room() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    place = project["entry-points"]["pytest11"]["dpstack"]
    program = f"import sys, {place}; print(*sorted(n for n in sys.modules if n.startswith('dpstack')))"
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert told.stdout.split() == ["dpstack", "dpstack.namespaces", "dpstack.testing", place]


def test_the_example_runs_in_one_command() -> None:
    assert "3 passed" in run_pytest(ROOT / "examples" / "test_bench").stdout


async def nothing() -> None:
    pass


def test_run_virtual_in_a_running_loop_explains_itself() -> None:
    async def outer() -> None:
        with pytest.raises(dpstack.UsageError, match=r"run_virtual\(\) needs an event loop of its own.*await the coro"):
            dpstack.run_virtual(nothing())

    asyncio.run(outer())


def test_a_program_without_end_ends(dpstack_bus: BusFactory) -> None:
    bus = dpstack_bus(slaves=[], baud=9_600)

    async def own() -> None:
        async with asyncio.timeout(1):
            await asyncio.Event().wait()

    with pytest.raises(TimeoutError, match="did not end within 2 s of virtual time"):
        bus.run(asyncio.Event().wait(), timeout=2)
    with pytest.raises(TimeoutError, match=r"^$"):
        bus.run(own())


def test_wrong_calls_say_what_to_do(dpstack_bus: BusFactory) -> None:
    bus = dpstack_bus(slaves=[RAW], baud=19_200)

    async def program() -> None:
        bus.wait(1)

    with pytest.raises(dpstack.UsageError, match=r"call the function: run\(program\(\.\.\.\)\)"):
        bus.run(program)  # type: ignore[arg-type]
    with pytest.raises(dpstack.UsageError, match=r"`await asyncio.sleep\(1\)` for wait\(1\)"):
        bus.run(program())
    for wrong in (bus.slave("raw").ready, bus.master.operate):  # would wait for ever: that loop stands still
        with pytest.raises(dpstack.UsageError, match=r"write bus.run\(program\(\)\) instead of asyncio.run"):
            asyncio.run(wrong())


def test_a_bus_ends_with_its_test() -> None:
    time = VirtualTime()
    bus = BusFactory(time)(slaves=[RAW], baud=19_200)
    bus.close()
    assert bus.device("raw").outputs == b"\x00"  # its test may go on
    time.close()
    for wrong in (lambda: bus.wait(1), lambda: bus.faults.silence("raw"), lambda: bus.device("raw")):
        with pytest.raises(dpstack.UsageError, match="this bus ended with its test: make one in each test"):
            wrong()


RAW = {"name": "raw", "address": 9, "ident": 0x1234, "config": "20 10", "inputs": {"level": "u8@0"}}


def test_faults_by_name_begin_and_end(dpstack_bus: BusFactory) -> None:
    bus = dpstack_bus(slaves=[RAW])
    device, raw = bus.device("raw"), bus.slave("raw")
    raw.outputs = b"\x07"
    bus.wait(0.05)
    assert (device.outputs, raw["level"]) == (b"\x07", 7)
    with bus.faults.silence("raw"):
        bus.wait(0.05)
        assert bus.faults.active == {"raw": ["silence"]}
    assert bus.faults.active == {}
    bus.run(raw.ready())
    fault = bus.faults.power_off("raw", 0.5)
    assert bus.faults.active == {"raw": [f"power off until {fault.until:.6f} s"]}
    bus.wait(0.2)
    assert not raw.ready_now
    bus.run(raw.ready())
    device.set(level=9)
    bus.wait(0.05)
    assert raw.inputs == b"\x09"
    began = bus.now
    bus.faults.silence_master(1)
    bus.wait(0.9)
    assert not device.exchanging
    bus.run(raw.ready())
    bus.wait(0.05)
    bus.wire.assert_brought_up("raw", since=began)
    with pytest.raises(dpstack.ConfigError, match="by_ms"):
        bus.faults.late_answers("raw", 99_999)
    with pytest.raises(dpstack.ConfigError, match="did you mean 'silence'"):
        bus.faults.begin("raw", "silense")
    with pytest.raises(dpstack.UsageError, match=r"no slave 'fan' is simulated here; there are: raw \(9\)"):
        bus.faults.silence("fan")


def test_an_application_that_opens_its_own_bus(dpstack_bus: BusFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """The drive has options that no manual gives: they are those of the simulated drive on any simulated line."""
    bus = dpstack_bus(slaves=[{"name": "fan", "address": 4, "drive": "keb-f5"}], master=None, baud=93_750)
    monkeypatch.setattr(dpstack, "open_bus", bus.open_bus)

    async def application() -> None:
        async with in_operate(dpstack.open_bus()) as own:
            fan = own.drive("fan")
            await fan.start()
            fan.speed = 0.5
            await fan.reached()

    bus.run(application())
    bus.wire.assert_clear()
    bus.wire.assert_last_outputs_safe("fan")
    with pytest.raises(dpstack.UsageError, match="master=None"):
        _ = bus.master
