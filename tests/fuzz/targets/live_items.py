"""Items of the live stream, whatever they hold, for the merged state, late readers, the screen and the page.

The input bends the items of a plant (other types, keys that are missing, doubled or foreign) and their order. Judged:
an item is taken or refused by ValueError, and a refused one changes nothing; every page of the screen can be drawn in
any width, printable (behind some items, as the input says, at the end, and after right items); no slave is shown as
alive whose snapshot does not say so, nothing is shown as fresh after the end or a silence; a late reader gets
to the same state; queues have limits; and right items afterwards are shown as ever.
"""

from __future__ import annotations

import contextlib
import functools
import json
from typing import Any

from dpstack.plant.items import check_item
from dpstack.plant.pending import Pending, portions
from dpstack.plant.state import DEPTH, LiveState
from dpstack.screen import one_slave, overview, watch
from dpstack.screen.lines import Line, width_of
from dpstack.screen.view import SILENT_S, View
from dpstack.web.fan_out import FanOut, Reader
from tests.fuzz.bent_json import bent, text_of
from tests.fuzz.frame import Cutter, Target, assert_plain
from tests.screen.screen_kit import DRIVE, field, judged, plant, slave_plant, snapshot, values

_FAULT = {"state": "fault", "fault": {"kind": "cfg", "text": "Chk_Cfg refused"}}

#: the screen is drawn behind an item whose first octet has these bits: one in four, as drawing takes most of the time
_DRAWN = 0x0C


@functools.cache
def right_items() -> tuple[Any, ...]:
    """A plant, snapshots and events, as a run sends them."""
    named = {"inputs": [field("level", "bar", "i16@2")]}
    slaves = {
        "3": slave_plant(3, "valves", **named),
        "4": slave_plant(4, "hoist", **named, drive={"profile": "x", "telegram": "PPO1"}),
    }
    fields = {"level": 3.4}
    told = {"t": 1.0, "time": "2026-01-31T12:00:01.000Z", "text": "x"}
    return (
        plant(slaves),
        snapshot({"3": values(fields=fields), "4": values(fields=fields, drive=DRIVE)}),
        snapshot({"3": {"fields": {"level": 4.0}}}, t=5.1, whole=False, rotations=501),
        snapshot({"4": judged(**_FAULT)}, t=5.2, whole=False),
        {"event": {"event": "notice", "severity": "info", **told}},
        {"event": {"event": "slave", "severity": "warning", "address": 3, "name": "valves", **told}},
        {"event": {"event": "bus_process", "silent": True, "severity": "error", **told}},
        {"lost": 3},
        snapshot({}, t=5.3, whole=False, clear={"since": 3, "because": "b"}, stale=True),
        {"end": {"text": "over"}},
    )


def picture(state: LiveState) -> str:
    return repr([state.plant, state.t, state.bus, state.slaves, list(state.events), state.lost, state.end])


def judge_alive(view: View) -> None:
    """No slave is shown as alive whose snapshot does not say so."""
    for address in view.addresses():
        if view.alive(address):
            assert view.values(address).alive
            assert view.fresh
        else:
            assert view.mark(address)[0] != "*"


def draw(view: View, width: int) -> None:
    """All pages of the screen."""
    lines: list[Line] = [*overview.head(view, width), overview.slaves_head(width)]
    for address in view.addresses()[:8]:
        lines += overview.slave_lines(view, address, width, 6)
        lines += one_slave.page(view, address, width)
    for point in list(watch.points_of(view).values())[:20]:
        lines += watch.watch_lines(view, point, width)
        point.order(view)
    view.addresses("data 3", conspicuous=True)
    lines += [overview.event_line(event) for event in view.events_of()[-5:]]
    lines += [overview.event_line(event) for event in view.events_of("3")[-5:]]
    for line in [*lines, overview.notices(view, note="x")]:
        for text, _ in line:
            assert_plain(text)
    assert all(width_of(line) <= width for line in lines[:3])


def texts_for(reader: Reader) -> list[str]:
    """The messages that wait for a page. It has not read any: nothing is to be waited for."""
    with contextlib.closing(reader.take()) as taking:
        try:
            taking.send(None)
        except StopIteration as done:
            found: list[str] = done.value
            return found
    raise AssertionError("the reader waits, and never was given its plant")


def run(octets: bytes) -> None:
    script = Cutter(octets)
    items = right_items()
    view, fan_out, late, pending = View(), FanOut(), LiveState(), Pending()
    reader = fan_out.join()
    now, width = 1.0, 20 + script.octet() % 140
    how = script.octet()
    order = list(items) if how & 1 else []
    before = picture(view.state)
    while script.at < len(octets) or order:
        head = script.octet()
        right = order.pop(0) if order else items[head % len(items)]
        item = bent(right, script) if head & 0xC0 else right
        now += (head >> 4 & 3) * 0.9
        if not isinstance(item, dict):
            continue
        item = json.loads(text_of(item))
        try:
            view.apply(item, now)
            taken = True
        except ValueError as error:
            taken = False
            assert_plain(str(error))
            assert picture(view.state) == before
        else:
            before = picture(view.state)
        if taken:
            fan_out.put(check_item(item))
            pending.put(item)
        if head & 1:
            while (found := pending.take()) is not None:
                for part in portions(found):
                    late.apply(part)
            fan_out.hand_out()
        judge_alive(view)
        if head & _DRAWN == _DRAWN:
            draw(view, width)
        assert len(view.state.events) <= DEPTH
    while (found := pending.take()) is not None:
        late.apply(found)
    if view.state.plant is not None:
        assert picture(late) == before
    fan_out.hand_out()
    for item in view.state.whole():
        LiveState().apply(item)
    assert all(isinstance(text, str) for text in texts_for(reader))
    if how & 2:
        draw(view, width)
    view.now = now + SILENT_S + 1
    assert not any(view.alive(address) for address in view.state.slaves)
    if not how & 2:
        draw(view, width)
    for item in items[:2]:
        view.apply(item, now + 10)
    view.process_silent = False
    draw(view, width)
    assert view.alive("3")


TARGET = Target(
    run=run,
    covers=(
        "dpstack.plant",
        "dpstack.screen.view",
        "dpstack.screen.overview",
        "dpstack.screen.one_slave",
        "dpstack.screen.places",
        "dpstack.screen.rack",
        "dpstack.screen.watch",
        "dpstack.web.fan_out",
    ),
    executions=100_000,
    compares=False,
    max_len=200,
)
