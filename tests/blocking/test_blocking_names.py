"""Buses, slaves, drives and servers by the names of ``dpstack.blocking``; the types of the stub; the session in
docs/how-to/blocking.md, line by line."""

from __future__ import annotations

import ast
import contextlib
import inspect
import re
import threading
import weakref
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path

import pytest
from far_ends import eventually
from process_kit import LAMPS, LAMPS_SPEC, SPEC, UNHURRIED, VALVES, octet_slaves
from support_responder import Responder

import dpstack
from dpstack import blocking
from dpstack.api.bus.bus import core_of
from dpstack.api.bus.statistics import BusStats
from dpstack.trace import Event
from tests.blocking.blocking_kit import interrupted, target_of, waits
from tools import make_blocking_stub


@pytest.fixture(scope="module")
def plant() -> Iterator[tuple[blocking.Bus, Responder]]:
    """A bus in Operate; at the other end slaves that know octets only."""
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there):
        bus = blocking.open_bus(port=path, baud=1_500_000, slaves=[VALVES, LAMPS], driver="asyncio", **UNHURRIED)
        assert bus.driver == "asyncio"
        with bus:
            bus.ready(60)
            bus.operate()
            yield bus, there
        eventually(lambda: there.slaves[4].control == b"\x02\x00", "Clear")


@pytest.fixture
def fan() -> Iterator[blocking.Drive]:
    """A simulated drive, in real time."""
    slave: dict[str, object] = {"name": "fan", "address": 4, "drive": "fuji-frenic"}
    with blocking.open_bus(port="virtual", baud=93_750, slaves=[slave]) as bus:
        assert bus.driver == "virtual"
        bus.ready(60)
        bus.operate()
        yield bus.drive("fan")


def test_process_data(plant: tuple[blocking.Bus, Responder]) -> None:
    bus, there = plant
    valves = bus.slave("valves")
    valves.outputs = b"\x12\x34"
    bus.outputs_taken()
    eventually(lambda: there.slaves[4].outputs == b"\x12\x34", "outputs at the slave")
    valves["target"] = 0x55
    eventually(lambda: there.slaves[4].outputs == b"\x00\x55", "outputs at the slave")
    eventually(lambda: valves["level"] == 0x55, "inputs, which the slave copies")
    assert "level" in valves
    assert list(valves) == ["level", "target"]


def test_objects_are_wrapped_and_data_are_not(plant: tuple[blocking.Bus, Responder]) -> None:
    bus, _ = plant
    valves, lamps = bus.slaves
    assert (type(valves), type(bus.class2), type(bus.group(1))) == (blocking.Slave, blocking.Class2, blocking.Group)
    assert valves == bus.slave(4)
    assert valves != lamps
    assert {valves: 1}[bus.slave("valves")] == 1
    assert bus.group(1).members == (valves, lamps)
    assert bus.class2.diagnosis(valves).ident == 0x1234
    assert type(bus.stats) is BusStats
    assert repr(bus) == f"<Bus {bus.config.port} 1.5 Mbit/s operate, 2 of 2 slaves>"
    assert repr(valves) == "<Slave 4 'valves' data_exchange>"


def test_classes_show_what_the_asynchronous_ones_do(plant: tuple[blocking.Bus, Responder]) -> None:
    bus, _ = plant
    public = {name for name in dir(dpstack.Bus) if not name.startswith("_")}
    assert public <= set(dir(bus))
    assert not [name for name in dir(bus) if name.startswith("__a")]
    assert blocking.Bus.operate.__doc__ == dpstack.Bus.operate.__doc__
    assert not inspect.iscoroutinefunction(blocking.Bus.operate)
    assert str(inspect.signature(blocking.Bus.ready)) == "(self, timeout: 'float | None' = 5.0) -> 'None'"
    assert str(inspect.signature(blocking.Bus.cycles)) == "(self, *, timeout: 'float | None' = None) -> 'Items[Cycle]'"
    assert "Open a class 2 connection" in (blocking.Class2.connect.__doc__ or "")
    with pytest.raises(dpstack.UnknownAttribute, match="did you mean outputs"):
        bus.slave(4).output = b""  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        bus.nonsense  # type: ignore[attr-defined]  # noqa: B018


def test_ctrl_c_in_a_waiting_call(plant: tuple[blocking.Bus, Responder]) -> None:
    bus, there = plant
    asked = 0

    def never() -> bool:
        nonlocal asked
        asked += 1
        return False

    with interrupted(until=lambda: asked > 0):
        bus.until(never)
    before, exchanges = asked, there.slaves[4].exchanges
    bus.clear()  # an event, after which conditions are evaluated
    bus.operate()
    bus.rotated(bus.stats.rotations + 3, 60)
    assert asked == before  # nobody waits for it any more
    assert there.slaves[4].exchanges > exchanges
    with pytest.raises(TimeoutError):
        bus.until(never, 0.001)


def test_items_with_a_timeout(plant: tuple[blocking.Bus, Responder]) -> None:
    bus, _ = plant
    events = bus.events(timeout=0.01)
    with pytest.raises(TimeoutError):
        for _ in events:
            pass
    events = bus.events()
    while next(events) != core_of(target_of(bus))._events.past[-1]:
        pass
    with interrupted(until=lambda: waits(events)):
        next(events)
    bus.clear()  # the wait that was left has its event: none is lost
    texts = [next(events).text]
    bus.operate()
    texts.append(next(events).text)
    assert texts == ["master: clear", "master: operate"]
    events.close()
    assert list(events) == []


def test_an_iterator_of_a_generator_goes_on_after_a_timeout(fan: blocking.Drive) -> None:
    statuses = fan.statuses(timeout=0.01)
    with pytest.raises(TimeoutError):
        for _ in statuses:
            pass
    fan.start(60)

    def is_told() -> bool:
        try:
            return next(statuses).running
        except TimeoutError:
            return False

    eventually(is_told, "the status of the drive that runs")
    endless = fan.statuses()
    next(endless)
    endless.close()
    assert list(endless) == []


def test_an_abandoned_iterator_is_forgotten(plant: tuple[blocking.Bus, Responder]) -> None:
    bus, _ = plant
    events = bus.events(timeout=0.01)
    with contextlib.suppress(TimeoutError):
        for _ in events:
            pass
    reader = weakref.ref(target_of(events))
    assert reader() is not None
    del events
    eventually(lambda: reader() is None, "the end of the reader")


def test_calls_from_several_threads(plant: tuple[blocking.Bus, Responder]) -> None:
    bus, _ = plant

    def work(_: int) -> int:
        bus.rotated(bus.stats.rotations + 2, 60)
        return bus.slave("lamps").address

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(work, range(8))) == [5] * 8


def test_functions_of_the_program_run_in_the_thread_of_the_bus() -> None:
    """They may read; waiting there is refused."""
    told: list[object] = []

    def on_event(event: Event) -> None:
        try:
            told.append((threading.current_thread().name, bus.slaves[0].address))
            bus.operate()
        except dpstack.UsageError as error:
            told.append(str(error))

    bus = blocking.open_bus(port="virtual", baud=93_750, slaves=[VALVES], on_event=on_event)
    with bus:
        pass
    assert told[0] == ("dpstack.blocking", 4)
    assert str(told[1]).startswith("operate was called in the thread of the bus (by on_event")


@pytest.mark.parametrize(("given", "driver"), [({}, "process"), ({"driver": "asyncio"}, "asyncio")])
def test_a_line_gets_a_bus_process(given: dict[str, object], driver: str) -> None:
    def slaves() -> Iterator[dict[str, object]]:
        yield VALVES

    with octet_slaves(SPEC) as (path, _):
        bus = blocking.open_bus(port=path, baud=500_000, slaves=slaves(), **given)  # type: ignore[arg-type]
        assert bus.driver == driver
        assert [slave.name for slave in bus.slaves] == ["valves"]


def test_errors_are_those_of_the_asynchronous_names() -> None:
    with pytest.raises(dpstack.ConfigError, match="no baud"):
        blocking.open_bus()
    with pytest.raises(dpstack.ConfigError, match="virtual"):
        blocking.find_baud("virtual")


def test_a_served_slave_and_a_class_2_connection() -> None:
    kind = dpstack.slave.SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="mixer")
    device = dpstack.slave.DpSlave(kind, lambda outputs, elapsed: outputs)
    with blocking.serve_slave(device, port="pty", baud=1_500_000, address=7) as server:
        assert server.slave.device is device
        assert type(server.slave) is blocking.ServedSlave
        table: dict[str, object] = {"name": "mixer", "address": 7, "ident": 0x1234, "config": kind.configs[0].hex()}
        with blocking.open_bus(port=server.port_name, baud=1_500_000, slaves=[table], driver="asyncio") as bus:
            server.slave.reached(dpstack.slave.SlaveAppState.DATA_EXCH, 60)
            with pytest.raises(dpstack.ServiceRefused, match="Initiate"):
                bus.class2.connect(7)


def test_time_stamped_events_of_a_record() -> None:
    # ET 200M operating instructions, tables 8-6 and 8-8: slot 4, channel 15, incoming
    record = bytes.fromhex("04 0F 80 00 C355F7A6 80000000")

    async def read(slot: int, index: int) -> bytes:
        assert (slot, index) == (0, 103)
        return record

    kind = dpstack.slave.SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rack", dpv1=True)
    device = dpstack.slave.DpSlave(kind, lambda outputs, elapsed: outputs, on_read=read)
    table: dict[str, object] = {"name": "rack", "address": 7, "ident": 0x1234, "config": kind.configs[0].hex()}
    table |= {"user_prm": "80 00 00", "watchdog_ms": 0}
    with (
        blocking.serve_slave(device, port="pty", baud=1_500_000, address=7) as server,
        blocking.open_bus(port=server.port_name, baud=1_500_000, slaves=[table], driver="asyncio") as bus,
    ):
        bus.slave(7).ready(60)
        (event,) = bus.slave(7).read_time_stamps(103, timeout=60)
        assert (event.slot, event.signal, event.state_text) == (4, 15, "active")
        assert event.time_text == "2003-11-07 10:51:18.500"


# --- types ------------------------------------------------------------------------------------------------------------


@pytest.mark.check
def test_the_stub_is_what_the_classes_say() -> None:
    text = make_blocking_stub.TARGET.read_text(encoding="utf-8")
    assert text == make_blocking_stub.stub(), "run: python -m tools.make_blocking_stub"


def test_every_class_with_something_to_await_is_wrapped() -> None:
    """The stub names, beside the proxies, plain data only, and classes that a program itself makes."""
    stub = make_blocking_stub.Stub()
    str(stub)
    awaited = []
    for module, name in stub.imports.names:
        kind = getattr(import_module(module), name)
        if module.startswith("dpstack") and isinstance(kind, type):
            members = [inspect.getattr_static(kind, member) for member in dir(kind)]
            if any(map(inspect.iscoroutinefunction, members)) or hasattr(kind, "__await__"):
                awaited.append(name)
    assert awaited == ["BusBase"]  # an argument of BusRecording.start, which the bus calls


ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "how-to" / "blocking.md"
_SESSION = re.compile(r"<!-- session -->\n```text\n(.*?)^```", re.DOTALL | re.MULTILINE)
_CELL = re.compile(r"^In \[(\d+)\]: (.*)\n(?:Out\[\1\]: (.*)\n)?", re.MULTILINE)


def cells() -> list[tuple[str, str]]:
    """Input and output of each cell; the output of a cell without one is empty."""
    (session,) = _SESSION.findall(PAGE.read_text(encoding="utf-8"))
    found = _CELL.findall(session)
    assert [int(number) for number, _, _ in found] == list(range(1, len(found) + 1))
    return [(given, shown) for _, given, shown in found]


def test_the_session_shows_what_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT / "examples")
    shell: dict[str, object] = {}
    for given, shown in cells():
        *before, last = ast.parse(given).body
        exec(compile(ast.Module(before, []), "<cell>", "exec"), shell)
        value = None
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "<cell>", "eval"), shell)
        else:
            exec(compile(ast.Module([last], []), "<cell>", "exec"), shell)
        assert ("" if value is None else repr(value)) == shown, given
