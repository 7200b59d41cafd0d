"""Examples: heads with their commands, a case of the watcher for every event, one line for a missing package."""

from __future__ import annotations

import ast
import logging
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import dpstack
from dpstack.events import FaultKind, SlaveState
from dpstack.trace import Event

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
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


def test_the_watcher_has_a_case_for_every_public_event() -> None:
    public = {
        name
        for name in dpstack.events.__all__
        if isinstance(kind := getattr(dpstack.events, name), type) and issubclass(kind, Event) and kind is not Event
    }
    assert len(public) > 30
    tree = ast.parse(WATCHER.read_text(encoding="utf-8"))
    cases = [case for node in ast.walk(tree) if isinstance(node, ast.Match) for case in node.cases]
    assert {name for case in cases for name in classes_of(case.pattern)} == public


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
