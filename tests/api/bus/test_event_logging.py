"""Events of a bus in ``logging``: loggers, levels, fields, JSON lines; and the cost where logging is off."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from api_kit import operating

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.bus.events_json import EventLogging, log_or_print, slave_logger_name
from dpstack.dp.master.events import SlaveRemark
from dpstack.logs import JsonFormatter
from dpstack.slave import DpSlave, SlaveDescription, serve_slave
from dpstack.trace import Event, Notice, Severity

pytestmark = pytest.mark.virtual_time

ESC = "\x1b[2J"
RAW = {"address": 9, "ident": 0x1234, "config": "20 10"}


class Kept(logging.Handler):
    """Keeps the records, and what the formatter of dpstack makes of each."""

    def __init__(self) -> None:
        super().__init__()
        self.records: list[logging.LogRecord] = []
        self.lines: list[dict[str, Any]] = []
        self.setFormatter(JsonFormatter())

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record)
        self.lines.append(json.loads(self.format(record)))


@pytest.fixture
def lines() -> Iterator[list[dict[str, Any]]]:
    """The lines of a handler at "dpstack", at INFO, as JSON."""
    handler = Kept()
    logger = logging.getLogger("dpstack")
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    yield handler.lines
    logger.removeHandler(handler)
    logger.setLevel(level)


async def test_the_events_of_a_bus_are_records(lines: list[dict[str, Any]]) -> None:
    events: list[Event] = []

    slave = {"name": "tank.no.1", **RAW}
    async with dpstack.open_bus(port="virtual", baud=500_000, slaves=[slave], on_event=events.append) as bus:
        await bus.operate()
        await bus.ready()
    assert {line["logger"] for line in lines} == {"dpstack.bus", "dpstack.slave.tank_no_1"}
    texts = [event.text for event in events]
    assert [line["text"] for line in lines] == [text for text in texts if text in {line["text"] for line in lines}]
    (exchange,) = [line for line in lines if line.get("state") == "data_exchange"]
    assert exchange == {
        "time": exchange["time"],
        "level": "info",
        "logger": "dpstack.slave.tank_no_1",
        "text": "slave 9 (tank.no.1): data_exchange",
        "event": "slave",
        "t": exchange["t"],
        "address": 9,
        "name": "tank.no.1",
        "state": "data_exchange",
        "port": "virtual",
    }
    assert exchange["time"].endswith("Z")
    assert 0 < exchange["t"] < 2


async def test_the_events_of_a_served_slave_are_records(lines: list[dict[str, Any]]) -> None:
    """In a branch of their own: the master in the same program has a slave of this name, too."""
    description = SlaveDescription.simple(0x4711, inputs=1, outputs=1, name="tank.no.1")
    tank = DpSlave(description, lambda outputs, _: outputs)
    world = dpstack.World()
    events: list[Event] = []

    async with serve_slave(tank, world=world, address=9, on_event=events.append):
        async with dpstack.open_bus(world=world, baud=500_000, slaves=[description.table(9)]) as bus:
            await bus.ready()
        await asyncio.sleep(2)
    served = [line for line in lines if line["logger"].startswith("dpstack.served")]
    assert [line["text"] for line in served] == [event.text for event in events]
    assert {line["logger"] for line in served} == {"dpstack.served.tank_no_1"}
    (exchange,) = [line for line in served if line.get("state") == "data_exchange"]
    assert {key: exchange[key] for key in exchange if key not in ("time", "t")} == {
        "level": "info",
        "logger": "dpstack.served.tank_no_1",
        "text": events[[event.text for event in events].index(exchange["text"])].text,
        "event": "slave",
        "address": 9,
        "name": "tank.no.1",
        "state": "data_exchange",
        "master": 2,
        "why": exchange["why"],
        "port": "virtual",
    }


def notice(severity: Severity, text: str = "x") -> Notice:
    return Notice(t_ns=3_500_000_000, source="bus", message=text, severity=severity)


@pytest.mark.parametrize("severity", Severity)
def test_severities_are_levels(severity: Severity, lines: list[dict[str, Any]]) -> None:
    EventLogging(lambda: (3_000_000_000, "/dev/ttyUSB0"))(notice(severity))
    wanted = {"level": severity.value, "logger": "dpstack.bus", "text": "bus: x", "event": "notice", "t": 0.5}
    assert lines == [{"time": lines[0]["time"], **wanted, "severity": severity.value, "port": "/dev/ttyUSB0"}]


def test_nothing_remote_reaches_a_handler_raw() -> None:
    handler = Kept()
    name = f"{ESC}.{ESC}"
    logger = logging.getLogger(slave_logger_name(name))
    assert logger.name == r"dpstack.slave.\x1b[2J_\x1b[2J"
    logger.addHandler(handler)
    with contextlib.closing(handler):
        EventLogging(lambda: (0, "p"))(SlaveRemark(t_ns=0, address=9, name=name, message=f"{ESC}\nroot: all is well"))
    logger.removeHandler(handler)
    (record,) = handler.records
    plain = logging.Formatter("%(name)s %(message)s %(dpstack)s").format(record)
    assert ESC not in plain
    assert "\n" not in plain
    text = JsonFormatter().format(record)
    assert text.isascii()
    assert text.isprintable()
    assert json.loads(text)["name"] == name  # JSON has escaped it: the value is the same


def test_any_record_is_one_json_line() -> None:
    try:
        raise ValueError(f"{ESC}\nx")
    except ValueError:
        info = sys.exc_info()
    record = logging.LogRecord("other", logging.ERROR, "x.py", 1, "failed: %s", (f"a{ESC}",), info)
    record.dpstack = {"text": "replaced", "level": "x", "port": "p"}
    text = JsonFormatter().format(record)
    assert text.isprintable()
    line = json.loads(text)
    assert line["error"].endswith(f"ValueError: {ESC}\nx")
    del line["time"], line["error"]
    assert line == {"level": "error", "logger": "other", "text": r"failed: a\x1b[2J", "port": "p"}


@pytest.mark.usefixtures("no_collection")
def test_an_event_whose_level_is_off_costs_a_handful_of_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """No text, no fields and no record is made: counted by the functions of ours and of logging that are called."""
    calls: list[str] = []

    def trace(frame: Any, event: str, _arg: object) -> None:
        if event == "call":
            calls.append(frame.f_code.co_qualname)

    log = EventLogging(lambda: (0, "p"))
    remark = SlaveRemark(t_ns=0, address=9, name="a", message="b")
    for event, level in ((notice(Severity.INFO), logging.WARNING), (remark, logging.ERROR)):
        monkeypatch.setattr(logging.getLogger("dpstack"), "level", level)
        logging.getLogger("dpstack").manager._clear_cache()  # type: ignore[attr-defined]
        log(event)  # the first one of a slave looks for its logger
        calls.clear()
        sys.setprofile(trace)
        log(event)
        sys.setprofile(None)
        assert calls == ["EventLogging.__call__", *["EventLogging._of_slave", "Event.severity"] * (event is remark),
                         *["Enum.__hash__"], "Logger.isEnabledFor"]  # fmt: skip
    logging.getLogger("dpstack").manager._clear_cache()  # type: ignore[attr-defined]


def test_logging_is_asked_once_an_event_and_never_in_a_round(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Event] = []
    call = EventLogging.__call__

    def counted(self: EventLogging, event: Event) -> None:
        asked.append(event)
        call(self, event)

    monkeypatch.setattr(EventLogging, "__call__", counted)
    events: list[Event] = []

    async def program() -> tuple[int, int]:
        slave = {"name": "tank", **RAW}
        async with operating(slave, on_event=events.append) as bus:
            before = len(asked), core_of(bus).view.rotations
            await bus.rotated(core_of(bus).view.rotations + 500)
            return len(asked) - before[0], core_of(bus).view.rotations - before[1]

    asked_then, rounds = dpstack.run_virtual(program())
    assert rounds >= 500
    assert asked_then <= 2
    assert asked == events


def test_without_logging_events_print_nothing_but_remarks_about_the_end_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(logging.getLogger("dpstack"), "propagate", False)  # pytest has handlers at the root
    EventLogging(lambda: (0, "p"))(notice(Severity.ERROR))
    log_or_print(logging.WARNING, "the bus on p was not closed: 100 %s")
    assert capsys.readouterr() == ("", "the bus on p was not closed: 100 %s\n")
    monkeypatch.undo()
    log_or_print(logging.WARNING, "the bus on p was not closed: 100 %s")
    assert capsys.readouterr() == ("", "")
    assert caplog.record_tuples == [("dpstack", logging.WARNING, "the bus on p was not closed: 100 %s")]
