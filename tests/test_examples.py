"""Examples: heads with their commands, the watcher's case for every event, the notebook, a missing package; those in
docstrings, which the reference of the book shows, run against a simulated plant."""

from __future__ import annotations

import ast
import asyncio
import doctest
import importlib
import inspect
import json
import logging
import re
import runpy
import shlex
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from plant_files import plant_file

import dpstack
from dpstack.api.config.config import load_config
from dpstack.api.control.scenario import load_scenario
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.slave_side.virtual_bench import VirtualBench
from dpstack.cli.main import build_parser
from dpstack.events import FaultKind, SlaveState
from dpstack.params import BusParams
from dpstack.slave import DpSlave, SlaveDescription
from dpstack.trace import Event

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
NOTEBOOK = EXAMPLES / "notebook.ipynb"
WATCHER = EXAMPLES / "plant_watcher.py"
#: examples that start on a simulated bus, and on a port that is given as argument
WITH_PORT = ("conveyor_and_pump", "fastapi_service", "parquet_logger", "plant_watcher", "soft_slave")


def classes_of(pattern: ast.pattern) -> Iterator[str]:
    """The classes that a case is for; not those of attributes within it."""
    match pattern:
        case ast.MatchClass(cls=ast.Name(id=name)):
            yield name
        case ast.MatchOr(patterns=patterns):
            for one in patterns:
                yield from classes_of(one)
        case ast.MatchAs(pattern=ast.pattern() as inner):
            yield from classes_of(inner)


def matched_in(example: Path) -> set[str]:
    """The classes for which a ``match`` in ``example`` has a case."""
    tree = ast.parse(example.read_text(encoding="utf-8"))
    cases = [case for node in ast.walk(tree) if isinstance(node, ast.Match) for case in node.cases]
    return {name for case in cases for name in classes_of(case.pattern)}


@pytest.mark.parametrize(
    ("namespace", "example", "least"),
    [(dpstack.events, WATCHER, 30), (dpstack.slave, EXAMPLES / "soft_slave.py", 10)],
    ids=["events of a bus", "events of a served slave"],
)
def test_an_example_has_a_case_for_every_public_event(namespace: ModuleType, example: Path, least: int) -> None:
    public = {
        name
        for name in namespace.__all__
        if isinstance(kind := getattr(namespace, name), type) and issubclass(kind, Event) and kind is not Event
    }
    assert len(public) > least
    assert sorted(public - matched_in(example)) == []


def test_the_watcher_sums_up(caplog: pytest.LogCaptureFixture) -> None:
    watcher = runpy.run_path(str(WATCHER))["Watcher"]()
    fault = dpstack.events.Fault(FaultKind.LOST, "stopped answering", "check its power")
    with caplog.at_level(logging.INFO, "plant.watch"):
        for event in (
            dpstack.events.ModeChanged(t_ns=0, mode=dpstack.Mode.OPERATE),
            dpstack.events.RingJoined(t_ns=0, address=2, claimed=False, masters=(1, 2)),
            dpstack.events.MasterSeen(t_ns=0, address=1, present=False),
            dpstack.events.SlaveStateChanged(t_ns=0, address=8, name="valves", state=SlaveState.OFFLINE),
            dpstack.events.SlaveFaulted(t_ns=0, address=8, name="valves", fault=fault),
            dpstack.events.PortLost(t_ns=0, port="/dev/ttyUSB0", reason="unplugged"),
        ):
            watcher.see(event)
        assert watcher.report() == "operate, missing: valves (lost; check its power); diagnoses: none; masters: [2]"
        assert caplog.messages == ["plug the adapter in again: /dev/ttyUSB0 (unplugged)"]
        watcher.see(dpstack.events.SlaveStateChanged(t_ns=0, address=8, name="valves", state=SlaveState.DATA_EXCHANGE))
    assert "missing: no slave" in watcher.report()


@pytest.mark.parametrize("name", WITH_PORT)
def test_the_head_says_how_to_start_it_with_and_without_a_port(name: str) -> None:
    head = ast.get_docstring(ast.parse((EXAMPLES / f"{name}.py").read_text(encoding="utf-8")))
    assert head is not None
    command = f"python examples/{name}.py"
    assert f"``{command}``" in head
    assert f"``{command} /dev/ttyUSB0" in head


@pytest.mark.parametrize(
    ("name", "package", "says"),
    [
        ("fastapi_service", "fastapi", "this example needs FastAPI and uvicorn: pip install fastapi uvicorn"),
        ("parquet_logger", "pyarrow", "this example needs pyarrow: pip install 'dpstack[parquet]'"),
    ],
)
def test_a_missing_package_is_one_line(name: str, package: str, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    assert ended.value.code == says


class Axes:
    """Stands in for a picture of matplotlib; keeps the curves."""

    def __init__(self) -> None:
        self.curves: list[tuple[list[float], list[float]]] = []

    def plot(self, x: list[float], y: list[float]) -> None:
        self.curves.append((x, y))

    def __getattr__(self, _: str) -> Any:
        return lambda *_, **__: None


def cells_of(notebook: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in found if cell["cell_type"] == "code"]


def test_the_cells_of_the_notebook_run_one_after_the_other(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one namespace, without Jupyter and matplotlib: tests/strangers has those."""
    axes, pyplot = Axes(), ModuleType("matplotlib.pyplot")
    monkeypatch.setattr(pyplot, "subplots", lambda **_: (object(), axes), raising=False)
    matplotlib = ModuleType("matplotlib")
    monkeypatch.setattr(matplotlib, "pyplot", pyplot, raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", matplotlib)
    shell: dict[str, Any] = {"__name__": "__main__"}
    for number, cell in enumerate(cells_of(NOTEBOOK)):
        exec(compile("".join(cell["source"]), f"<cell {number}>", "exec"), shell)
    ((seconds, levels),) = axes.curves
    assert seconds == sorted(seconds)
    assert levels == sorted(levels)
    assert levels[0] < 10 < 60 <= levels[-1] < 70
    lost, bus, fan, cause, todo, back, level = capsys.readouterr().out.splitlines()
    assert lost.startswith("slave 9 (tank): stopped answering during Data_Exchange")
    assert (bus, fan) == ("<Bus virtual 93.75 kbit/s operate, 1 of 2 slaves>", "fan: running")
    assert cause.startswith("not_there (")
    assert todo.startswith("next: look at the device: is its power on")
    assert back == "<Bus virtual 93.75 kbit/s operate, 2 of 2 slaves>"
    assert re.fullmatch(r"level: [67]\d\.\d %", level)  # the water stays in the tank
    assert shell["bus"].is_open is False


def test_the_notebook_is_kept_without_outputs() -> None:
    """A run makes the outputs; kept ones would be those of an earlier version."""
    for cell in cells_of(NOTEBOOK):
        assert (cell["outputs"], cell["execution_count"], cell["metadata"]) == ([], None, {})


ROOT = Path(__file__).resolve().parent.parent
_LITERAL = re.compile(r"::\n\n((?: {4}.*\n|\n)+)")
SLAVE = {"ident": 0x1234, "config": "10 20"}
GROUP: dict[str, object] = {"groups": [1], "sync": True, "freeze": True}
PLANT: list[dict[str, object]] = [
    {"name": "mixer", "address": 6, "drive": "ls-s100"},
    {"name": "valves", "address": 8, "ident": 0x1234, "config": "13 20"},
    {"name": "north", "address": 9, **SLAVE, **GROUP},
    {"name": "south", "address": 10, **SLAVE, **GROUP},
]


def examples() -> Iterator[tuple[str, str]]:
    """Module and text of every example behind ``::``."""
    for path in sorted((ROOT / "dpstack").rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(source)) if "::\n\n" in source else ():
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                for text in _LITERAL.findall((ast.get_docstring(node) or "") + "\n"):
                    yield path.relative_to(ROOT).as_posix(), textwrap.dedent(text)


IN_DOCSTRINGS = dict(examples())
_NO_PROGRAM = "dpstack/errors.py"  # a tree of classes


@pytest.fixture(autouse=True)
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plant_file(tmp_path, *PLANT, baud=93_750)
    monkeypatch.chdir(tmp_path)


def run(text: str, names: dict[str, object]) -> None:
    """Run ``text``, whose ``await`` may stand at its top, with ``names``."""
    code = compile(text, "<docstring>", "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT, dont_inherit=True)
    running = eval(code, {"__name__": "docstring", "dpstack": dpstack, **names})
    if inspect.iscoroutine(running):
        dpstack.run_virtual(running)


def test_each_example_has_a_test_here() -> None:
    source = Path(__file__).read_text(encoding="utf-8")
    assert len(IN_DOCSTRINGS) >= 9
    assert len(list(examples())) == len(IN_DOCSTRINGS)
    assert [module for module in IN_DOCSTRINGS if f'"{module}"' not in source] == []


def test_the_first_program(capsys: pytest.CaptureFixture[str]) -> None:
    run(IN_DOCSTRINGS["dpstack/__init__.py"] + "    print(mixer.status.speed)\n", {})
    assert float(capsys.readouterr().out) == pytest.approx(0.5, abs=0.01)


def test_events_are_matched(capsys: pytest.CaptureFixture[str]) -> None:
    before = """
slaves = [{"name": "valves", "address": 9, "ident": 1, "config": "10"}]
world = dpstack.World()
bench = dpstack.simulate(world, slaves)
bus = dpstack.open_bus(world=world, baud=500_000, slaves=slaves)
await bus.open()
await bus.ready()
async def end():
    bench.power(9, False)
    await asyncio.sleep(1)
    await bus.close()
ending = asyncio.create_task(end())
"""
    names = {"asyncio": asyncio, "events": dpstack.events}
    public = {name: getattr(dpstack.events, name) for name in dpstack.events.__all__}
    run(before + IN_DOCSTRINGS["dpstack/events.py"], names | public)
    assert "valves lost" in capsys.readouterr().out


def test_a_class_of_inputs() -> None:
    before = 'bus = dpstack.open_bus("plant.toml")\nawait bus.open()\nawait bus.ready()\n'
    names = {name: getattr(dpstack, name) for name in ("Bool", "Int", "Scaled", "at")}
    after = "assert (valves.limit, valves.count, valves.level) == (False, 0, 0.0)\nawait bus.close()\n"
    run(before + IN_DOCSTRINGS["dpstack/api/slave/typed.py"] + after, names)


def test_a_group_of_slaves(capsys: pytest.CaptureFixture[str]) -> None:
    before = 'bus = dpstack.open_bus("plant.toml")\nawait bus.open()\nawait bus.operate()\nawait bus.ready()\n'
    after = "print(picture)\nawait bus.close()\n"
    run(before + IN_DOCSTRINGS["dpstack/api/bus/sync_freeze.py"] + after, {})
    assert sorted(ast.literal_eval(capsys.readouterr().out)) == ["north", "south"]


def test_a_slave_of_ones_own() -> None:
    """On a simulated bus, and for a second only."""
    text = IN_DOCSTRINGS["dpstack/slave.py"].replace('port="/dev/ttyUSB0", baud=500_000', "world=world")
    text = text.replace("await server.serve_forever()", "await exchange()")
    assert text.count("world=world") == text.count("exchange()") == 1
    world = dpstack.World()
    asked: list[bytes] = []

    async def exchange() -> None:
        slaves = [{"name": "valves", "address": 5, "ident": 0x4711, "config": "11 20"}]
        async with dpstack.open_bus(world=world, baud=500_000, slaves=slaves) as bus:
            await bus.operate()
            await bus.ready()
            await bus.rotated(bus.stats.rotations + 5)
            asked.append(bus.slave("valves").inputs)

    valves = DpSlave(SlaveDescription.simple(0x4711, inputs=2, outputs=1), lambda outputs, elapsed: b"\x12\x34")
    run(text, {"valves": valves, "world": world, "exchange": exchange})
    assert asked == [b"\x12\x34"]


def test_a_cpu_over_ppi(capsys: pytest.CaptureFixture[str]) -> None:
    """On a simulated bus, beside a simulated CPU."""
    from dpstack.fdl.passive.station import PassiveStation
    from dpstack.ppi import CpuStation

    text = IN_DOCSTRINGS["dpstack/ppi/__init__.py"].replace('port="/dev/ttyUSB0"', "world=world")
    station, world = CpuStation(), dpstack.World()
    station.cpu["VW100"] = 250
    world.add(PassiveStation(2, station, dpstack.BusParams.preset(9600, address=2)))
    run("import dpstack.ppi\n" + text + "    print(level)\n", {"world": world})
    assert capsys.readouterr().out == "250\n"


def test_a_station_without_dp() -> None:
    """On a simulated bus, beside a controller that answers."""
    text = IN_DOCSTRINGS["dpstack/fdl/__init__.py"].replace('port="/dev/ttyUSB0"', "world=world")
    assert text.count("world=world") == 1
    before = """
partner = dpstack.open_fdl(world=world, baud=187_500, address=5)
await partner.open()
await (await partner.sap(16)).update(b"ready")
"""
    after = '    assert answer.data == b"ready"\nawait partner.close()\n'
    run(before + text + after, {"world": dpstack.World()})


def test_the_blocking_connector(capsys: pytest.CaptureFixture[str]) -> None:
    text = IN_DOCSTRINGS["dpstack/blocking/__init__.py"].replace("timeout=5", "timeout=0.1")
    with pytest.raises(TimeoutError):
        run(text, {})
    assert capsys.readouterr().out.startswith("plan: slave 6 (mixer): ")


def test_json_lines(capsys: pytest.CaptureFixture[str]) -> None:
    root = logging.getLogger()
    before = root.level, list(root.handlers)
    root.handlers.clear()
    try:
        run(IN_DOCSTRINGS["dpstack/logs.py"] + 'logging.getLogger("dpstack").info("hello")\n', {"logging": logging})
    finally:
        root.setLevel(before[0])
        root.handlers[:] = before[1]
    assert '"text":"hello"' in capsys.readouterr().err


def test_a_class_of_conformance_takes_a_drive() -> None:
    names: dict[str, object] = {"DriveConformance": dpstack.testing.DriveConformance}
    run(IN_DOCSTRINGS["dpstack/testing/drive_conformance.py"] + 'assert TestMyDrive.drive == "my-drive"\n', names)


def test_sessions_show_what_they_show() -> None:
    words = importlib.import_module("dpstack.decode.words")
    failed, tried = doctest.testmod(words)
    assert (failed, tried) == (0, 1)


#: files that the job for CI leaves
JOB_WRITES = (("--junitxml=", "junit.xml"), ("--log ", "sim.jsonl"), ("sim.jsonl > ", "sim.txt"))


def test_the_jobs_for_ci_run_the_same_and_keep_what_it_leaves() -> None:
    yaml = pytest.importorskip("yaml", reason="it comes with the extra docs")
    folder = EXAMPLES / "ci"
    texts = {name: (folder / name).read_text(encoding="utf-8") for name in ("github.yml", "gitlab-ci.yml")}
    github, gitlab = (yaml.safe_load(text) for text in texts.values())
    job = github["jobs"]["plant"]
    commands = [step["run"] for step in job["steps"] if "run" in step]
    assert commands == gitlab["plant"]["script"] == ["pip install dpstack pytest", "sh ci/job.sh"]
    assert True in github  # "on", which YAML reads as true
    (upload,) = [step for step in job["steps"] if "upload-artifact" in step.get("uses", "")]
    assert upload["if"] == gitlab["plant"]["artifacts"]["when"] + "()" == "always()"
    artifacts = gitlab["plant"]["artifacts"]
    kept = {artifacts["reports"]["junit"], *artifacts["paths"]}
    assert set(upload["with"]["path"].split()) == kept
    script = (folder / "job.sh").read_text(encoding="utf-8")
    assert all(f"{word}{name}" in script for word, name in JOB_WRITES)
    assert kept == {f"ci/{name}" for _, name in JOB_WRITES}
    pages = "".join(page.read_text(encoding="utf-8") for page in sorted((EXAMPLES.parent / "docs").rglob("*.md")))
    assert re.findall(r"^```yaml\n(.*?)^```", pages, re.MULTILINE | re.DOTALL) == [*texts.values()]


def test_the_commands_and_the_scenario_of_the_job_are_right() -> None:
    """Those of job.sh as the program reads them; tests/strangers/test_ci_job.py runs it."""
    script = (EXAMPLES / "ci" / "job.sh").read_text(encoding="utf-8")
    commands = re.findall(r"^dpstack (.*?)(?: >.*)$", script, re.MULTILINE)
    assert [command.split()[0] for command in commands] == ["segment", "sim"]
    for command in commands:
        build_parser().parse_args(shlex.split(command))
    plant = load_config(EXAMPLES / "ci" / "plant.toml")
    bench = VirtualBench(dpstack.World(), BusParams.preset(500_000))
    bench.add(plant.slaves[0])
    assert len(load_scenario(EXAMPLES / "ci" / "faults.toml", bench, slave_handlers(bench)).steps) == 2
