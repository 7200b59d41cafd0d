"""Refused orders from outside are in the log of the run: reason, origin, time of the sender; a flood is counted."""

from __future__ import annotations

import asyncio
import itertools
import json
from pathlib import Path
from typing import Any

import pytest
from api_kit import HOIST, RAW, bus_of, in_virtual_time

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.bus.events_json import event_json
from dpstack.api.control.control_server import ControlServer
from dpstack.api.control.handlers import control_run
from dpstack.cli.commands.run import RunFiles
from dpstack.events import OrdersRefused
from dpstack.plant.orders import RefusedOrder

SENT = "2026-11-28T10:00:00.5+01:00"
LAMP = RefusedOrder("valves.lamp", "it is not in allow_commands", "mqtt", SENT)
VALVES = {**RAW, "outputs": {"speed": "u8@0"}}


class Refused(list[OrdersRefused]):
    """The events of refused orders."""

    def take(self, event: dpstack.Event) -> None:
        if isinstance(event, OrdersRefused):
            self.append(event)


class Run:
    """A bus with the log of `dpstack run --log`."""

    def __init__(self, log: Path, *slaves: dict[str, object]) -> None:
        self.files = RunFiles(None, str(log))
        self._log = log
        self.bus = bus_of(*(slaves or (RAW,)), baud=45_450, on_event=self._on_event)

    def _on_event(self, event: dpstack.Event) -> None:
        self.files.event(core_of(self.bus), event)

    def add(self, order: RefusedOrder) -> None:
        core_of(self.bus).refused_orders.add(order)

    @property
    def lines(self) -> list[dict[str, Any]]:
        """The lines about refused orders, after the end."""
        found = [json.loads(line) for line in self._log.read_text(encoding="utf-8").splitlines()]
        return [line for line in found if "refused" in line]

    @property
    def server(self) -> ControlServer:
        return control_run(self.bus, "pty")


def test_three_orders_that_are_not_a_flood_have_a_line_each(tmp_path: Path) -> None:
    async def program() -> Run:
        run = Run(tmp_path / "bus.jsonl")
        with run.files:
            async with run.bus:
                for _ in range(3):
                    run.add(LAMP)
                    await asyncio.sleep(1.3)
        return run

    lines = dpstack.run_virtual(program()).lines
    assert [line["text"] for line in lines] == [
        f"orders: mqtt: order valves.lamp refused: it is not in allow_commands; order_time {SENT}"
    ] * 3
    assert lines[0] | {"time": "", "t": 0} == {
        "time": "",
        "event": "notice",
        "t": 0,
        "severity": "warning",
        "text": lines[0]["text"],
        "count": 1,
        "refused": [
            {"order": "valves.lamp", "reason": "it is not in allow_commands", "origin": "mqtt", "order_time": SENT}
        ],
    }


@in_virtual_time
async def test_a_flood_is_counted_and_has_one_line_a_second() -> None:
    events = Refused()
    async with bus_of(RAW, baud=45_450, on_event=events.take) as bus:
        for number in range(2_500):
            core_of(bus).refused_orders.add(RefusedOrder(f"valves.o{number}", "no", "opcua (anna)"))
            await asyncio.sleep(0.001)
        await asyncio.sleep(2.0)
        assert sum(event.count for event in events) == 2_500
        assert len(events) == 4
        times = [event.t_ns for event in events]
        assert all(b - a >= 999_000_000 for a, b in itertools.pairwise(times))
        assert [order.order for order in events[1].orders] == [f"valves.o{number}" for number in range(1, 6)]
        assert events[1].text.startswith("orders: ")
        assert events[1].text.endswith(f"; and {events[1].count - 5} more")
        # at the end those that wait are not lost
        core_of(bus).refused_orders.add(LAMP)
        core_of(bus).refused_orders.add(LAMP)
        core_of(bus).refused_orders.add(LAMP)
    assert sum(event.count for event in events) == 2_503
    assert events[-1].text.startswith("orders: 2 orders were refused: mqtt: order valves.lamp refused")


@in_virtual_time
async def test_texts_of_strangers_are_cleaned_and_short() -> None:
    events = Refused()
    async with bus_of(RAW, baud=45_450, on_event=events.take) as bus:
        evil = "\x1b[2J\n\u202e" + "x" * 5_000
        core_of(bus).refused_orders.add(RefusedOrder(evil, evil, evil, evil))
    (event,) = events
    line = event_json(event, 1.0)
    assert line is not None
    assert event.text.isprintable()
    assert len(event.text) < 1_000
    (order,) = event.orders
    assert all(text.isprintable() and len(text) <= 200 for text in (order.order, order.reason, order.origin))


async def told(server: ControlServer, **request: Any) -> dict[str, Any]:
    """The answer to ``request``."""
    sent: list[dict[str, Any]] = []

    async def send(_writer: object, answer: dict[str, Any]) -> None:
        sent.append(answer)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(server, "_send", send)
        await server._answer(json.dumps(request).encode(), None)  # type: ignore[arg-type]
    return sent[0]


def test_orders_of_a_page_and_with_now_are_from_outside(tmp_path: Path) -> None:
    async def program() -> Run:
        run = Run(tmp_path / "bus.jsonl", VALVES, HOIST)
        with run.files:
            async with run.bus:
                server, by = run.server, {"origin": "page (anna)"}
                await run.bus.ready()
                requests: list[dict[str, Any]] = [
                    {"command": "set", "args": ["raw.speed=3"]},
                    {"command": "set", "args": ["raw.speed=x"]},  # the user beside the plant sees the answer
                    {"command": "set", "args": ["now", "raw.speed=x"]},
                    {"command": "set", "args": ["now", "raw.speed=300"], **by},
                    {"command": "drive", "args": ["now", "hoist", "fly"], **by},
                    {"command": "explode", **by},
                    {"command": "operate", "args": ["x\x1b[2J"], **by},
                    {"command": "refused", "args": ["page (eve)", "operate", "this page may look only"]},
                    {"command": "operate", **by},
                ]
                answers = []
                for request in requests:
                    answers.append((await told(server, **request))["ok"])
                    await asyncio.sleep(1.1)
                assert answers == [True, False, False, False, False, False, False, True, True]
        return run

    lines = dpstack.run_virtual(program()).lines
    found = [(one["origin"], one["order"]) for line in lines for one in line["refused"]]
    assert found == [
        ("control socket", "set raw.speed=x"),
        ("page (anna)", "set raw.speed=300"),
        ("page (anna)", "drive hoist fly"),
        ("page (anna)", "explode"),
        ("page (anna)", "operate x\\x1b[2J"),
        ("page (eve)", "operate"),
    ]
    assert all(one["reason"] for line in lines for one in line["refused"])
