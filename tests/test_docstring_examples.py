"""The examples in docstrings, which the reference of the book shows, run against a simulated plant."""

from __future__ import annotations

import ast
import asyncio
import doctest
import importlib
import inspect
import logging
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

import dpstack
from dpstack.slave import DpSlave, SlaveDescription

ROOT = Path(__file__).resolve().parent.parent
_LITERAL = re.compile(r"::\n\n((?: {4}.*\n|\n)+)")
PLANT = """
[bus]
port = "virtual"
baud = 93750

[[slave]]
name = "mixer"
address = 6
drive = "ls-s100"

[[slave]]
name = "valves"
address = 8
ident = 0x1234
config = "13 20"

[[slave]]
name = "north"
address = 9
ident = 0x1234
config = "10 20"
groups = [1]
sync = true
freeze = true

[[slave]]
name = "south"
address = 10
ident = 0x1234
config = "10 20"
groups = [1]
sync = true
freeze = true
"""


def examples() -> Iterator[tuple[str, str]]:
    """Module and text of every example behind ``::``."""
    for path in sorted((ROOT / "dpstack").rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(source)) if "::\n\n" in source else ():
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                for text in _LITERAL.findall((ast.get_docstring(node) or "") + "\n"):
                    yield path.relative_to(ROOT).as_posix(), textwrap.dedent(text)


EXAMPLES = dict(examples())
_NO_PROGRAM = "dpstack/errors.py"  # a tree of classes


@pytest.fixture(autouse=True)
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plant.toml").write_text(PLANT, encoding="utf-8")
    monkeypatch.chdir(tmp_path)


def run(text: str, names: dict[str, object]) -> None:
    """Run ``text``, whose ``await`` may stand at its top, with ``names``."""
    code = compile(text, "<docstring>", "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT, dont_inherit=True)
    running = eval(code, {"__name__": "docstring", "dpstack": dpstack, **names})
    if inspect.iscoroutine(running):
        dpstack.run_virtual(running)


def test_each_example_has_a_test_here() -> None:
    source = Path(__file__).read_text(encoding="utf-8")
    assert len(EXAMPLES) >= 9
    assert len(list(examples())) == len(EXAMPLES)
    assert [module for module in EXAMPLES if f'"{module}"' not in source] == []


def test_the_first_program(capsys: pytest.CaptureFixture[str]) -> None:
    run(EXAMPLES["dpstack/__init__.py"] + "    print(mixer.status.speed)\n", {})
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
    run(before + EXAMPLES["dpstack/events.py"], names | public)
    assert "valves lost" in capsys.readouterr().out


def test_a_class_of_inputs() -> None:
    before = 'bus = dpstack.open_bus("plant.toml")\nawait bus.open()\nawait bus.ready()\n'
    names = {name: getattr(dpstack, name) for name in ("Bool", "Int", "Scaled", "at")}
    after = "assert (valves.limit, valves.count, valves.level) == (False, 0, 0.0)\nawait bus.close()\n"
    run(before + EXAMPLES["dpstack/api/slave/typed.py"] + after, names)


def test_a_group_of_slaves(capsys: pytest.CaptureFixture[str]) -> None:
    before = 'bus = dpstack.open_bus("plant.toml")\nawait bus.open()\nawait bus.operate()\nawait bus.ready()\n'
    after = "print(picture)\nawait bus.close()\n"
    run(before + EXAMPLES["dpstack/api/bus/sync_freeze.py"] + after, {})
    assert sorted(ast.literal_eval(capsys.readouterr().out)) == ["north", "south"]


def test_a_slave_of_ones_own() -> None:
    """On a simulated bus, and for a second only."""
    text = EXAMPLES["dpstack/slave.py"].replace('port="/dev/ttyUSB0", baud=500_000', "world=world")
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


def test_the_blocking_connector(capsys: pytest.CaptureFixture[str]) -> None:
    text = EXAMPLES["dpstack/blocking/__init__.py"].replace("timeout=5", "timeout=0.1")
    with pytest.raises(TimeoutError):
        run(text, {})
    assert capsys.readouterr().out.startswith("plan: slave 6 (mixer): ")


def test_json_lines(capsys: pytest.CaptureFixture[str]) -> None:
    root = logging.getLogger()
    before = root.level, list(root.handlers)
    root.handlers.clear()
    try:
        run(EXAMPLES["dpstack/logs.py"] + 'logging.getLogger("dpstack").info("hello")\n', {"logging": logging})
    finally:
        root.setLevel(before[0])
        root.handlers[:] = before[1]
    assert '"text":"hello"' in capsys.readouterr().err


def test_a_class_of_conformance_takes_a_drive() -> None:
    names: dict[str, object] = {"DriveConformance": dpstack.testing.DriveConformance}
    run(EXAMPLES["dpstack/testing/drive_conformance.py"] + 'assert TestMyDrive.drive == "my-drive"\n', names)


def test_sessions_show_what_they_show() -> None:
    words = importlib.import_module("dpstack.decode.words")
    failed, tried = doctest.testmod(words)
    assert (failed, tried) == (0, 2)
