"""The end of ``run`` at which the screen is: the bus never waits for it, and pays for it in small steps; pages and
keys in textual's own test driver, one start for all, because each takes its time."""

from __future__ import annotations

import asyncio
import json
import os
import pty
import socket
import termios
import time
from collections.abc import Callable, Mapping
from typing import Any

from far_ends import HANG_S
from textual import events
from textual.widgets import Input

from dpstack.plant.pending import Pending
from dpstack.screen.app import Events, Help, OneSlave, Overview, Plant
from dpstack.screen.pages import Lines, Question
from dpstack.screen.process import ScreenProcess, Terminal
from dpstack.screen.watch_page import Choose, Watch
from tests.screen.screen_kit import Item, plant, slave_plant, snapshot, some_plant, values


class Stream:
    """Snapshots of 125 slaves with 244 octets each, as fast as they are read."""

    def __init__(self, items: int) -> None:
        self.read = 0
        self._left = items
        self._pending = Pending()
        self._pending.put(plant({str(address): slave_plant(address, "s") for address in range(1, 126)}))

    async def wait(self) -> None:
        await asyncio.Event().wait()

    def take(self) -> Item | None:
        item = self._pending.take()
        if item is None:
            if not self._left:
                return None
            self._left -= 1
            octets = values(inputs="ab" * 244, outputs="cd" * 244)
            item = snapshot({str(address): octets for address in range(1, 126)})
        self.read += 1
        return item

    def close(self) -> None:
        self._left = 0


def screen_on(orders: list[Mapping[str, Any]]) -> tuple[ScreenProcess, int, int]:
    master, slave = pty.openpty()
    return ScreenProcess(Terminal(slave), orders.append), master, slave


def test_a_screen_that_does_not_read_is_not_waited_for() -> None:
    asyncio.run(unread())


async def unread() -> None:
    screen, *fds = screen_on([])
    ours, theirs = socket.socketpair()
    await screen.connect(ours)
    stream = Stream(1000)
    task = asyncio.create_task(screen.show(stream, lambda: "virtual:4711"))
    for _ in range(3000):
        await asyncio.sleep(0)
    # the plant, and as many snapshots (0.2 MB each) as the system and 64 KiB of our own take
    assert stream.read < 20
    writer = screen._writer
    assert writer is not None
    assert writer.transport.get_write_buffer_size() < 200_000
    theirs.close()
    await task
    await screen.end()
    for fd in fds:
        os.close(fd)


def test_many_slaves_go_in_small_steps_with_turns_of_the_loop_between() -> None:
    asyncio.run(small_steps())


async def small_steps() -> None:
    orders: list[Mapping[str, Any]] = []
    screen, *fds = screen_on(orders)
    ours, theirs = socket.socketpair()
    await screen.connect(ours)
    sent: list[tuple[int, int]] = []
    turns = 0
    tell = screen.tell

    def told(message: Mapping[str, Any]) -> None:
        sent.append((turns, len(message.get("snapshot", {}).get("slaves", ()))))
        tell(message)

    screen.tell = told  # type: ignore[method-assign]
    reader, writer = await asyncio.open_connection(sock=theirs, limit=1 << 24)
    task = asyncio.create_task(screen.show(Stream(1), lambda: "virtual:4711"))
    writer.write(b'{"order":"why","slave":4}\n"nothing"\n')
    slaves: set[str] = set()
    reading = asyncio.create_task(reader.readline())
    while len(slaves) < 125:
        turns += 1
        await asyncio.sleep(0)
        if reading.done():
            slaves |= set(json.loads(reading.result()).get("snapshot", {}).get("slaves", ()))
            reading = asyncio.create_task(reader.readline())
    assert max(count for _, count in sent) <= 8
    assert len({turn for turn, _ in sent}) == len(sent)
    assert orders == [{"order": "why", "slave": 4}]
    reading.cancel()
    writer.close()
    await task
    await screen.end()
    for fd in fds:
        os.close(fd)


def test_the_terminal_is_restored_without_the_screen() -> None:
    screen, master, slave = screen_on([])
    before = termios.tcgetattr(slave)
    changed = termios.tcgetattr(slave)
    changed[3] &= ~(termios.ECHO | termios.ICANON)
    termios.tcsetattr(slave, termios.TCSANOW, changed)
    screen.kill()
    assert termios.tcgetattr(slave) == before
    octets = os.read(master, 1000)
    for code in (b"\x1b[?1049l", b"\x1b[?25h", b"\x1b[?2004l"):
        assert code in octets
    os.close(master)
    os.close(slave)


def seen(app: Plant, selector: str = "#rows") -> str:
    """The text of a part of the page that is on top."""
    parts = app.screen.query(selector).results(Lines)  # none while the page is being made
    return "\n".join(part.render_line(y).text.rstrip() for part in parts for y in range(part.size.height))


async def until(app: Plant, condition: Callable[[], bool]) -> None:
    """Wait until the page is so: a key goes through the queues of some widgets, and the layout follows later."""
    end = time.monotonic() + HANG_S
    while not condition():
        assert time.monotonic() < end, seen(app, "#keys")
        await asyncio.sleep(0.002)
        app.draw_now()


def test_pages_keys_and_orders() -> None:
    asyncio.run(pages_keys_and_orders())


async def watch_table(app: Plant, orders: list[dict[str, Any]]) -> None:
    """Choose two values of a slave, and order an output."""
    orders.clear()
    app.simulate_key("home")
    app.simulate_key("enter")
    await until(app, lambda: isinstance(app.screen, OneSlave))
    app.simulate_key("t")
    await until(app, lambda: isinstance(app.screen, Choose) and "[ ] valves.level" in seen(app))
    assert "tank" not in seen(app)
    for key in ("enter", "down", "down", "enter", "up", "enter", "enter"):
        app.simulate_key(key)
    await until(app, lambda: "2 chosen" in seen(app, "#columns"))
    assert seen(app).splitlines()[:3] == [
        "[x] valves.level  octet 2", "[ ] valves.limit  octet 0", "[x] valves.target  octet 0",
    ]  # fmt: skip
    app.simulate_key("escape")
    await until(app, lambda: isinstance(app.screen, Watch) and "99.5 bar" in seen(app))
    assert [line.split()[:2] for line in seen(app).splitlines()[:2]] == [
        ["valves.level", "99.5"],
        ["valves.target", "5"],
    ]
    app.simulate_key("enter")
    await until(app, lambda: "orders are for named outputs" in seen(app, "#head"))  # this bus is real
    app.simulate_key("r")
    app.simulate_key("down")
    for key, answer in (("7", "n"), ("8", "y")):
        app.simulate_key("enter")
        await until(app, lambda: isinstance(app.focused, Input))
        app.simulate_key(key)
        app.simulate_key("enter")
        await until(app, lambda: "Set the output target of slave 3 (valves) to" in seen(app, "#text"))
        app.simulate_key(answer)
        await until(app, lambda: isinstance(app.screen, Watch))
    assert orders == [{"order": "set", "text": "3.target=8"}]
    app.tell_answer("set 3.target=8: refused: \x1b[2J", "warn")
    await until(app, lambda: "refused: \\x1b[2J" in seen(app, "#head"))
    app.simulate_key("enter")
    await until(app, lambda: isinstance(app.focused, Input))
    app.simulate_key("escape")  # the field first, then the page
    await until(app, lambda: app.focused is None and isinstance(app.screen, Watch))
    app.simulate_key("d")
    await until(app, lambda: "target" not in seen(app))
    app.simulate_key("a")
    await until(app, lambda: isinstance(app.screen, Choose) and "tank.level" in seen(app))
    for page in (Watch, OneSlave, Overview):
        app.simulate_key("escape")
        await until(app, lambda page=page: isinstance(app.screen, page))  # type: ignore[misc]


async def pages_keys_and_orders() -> None:
    orders: list[dict[str, Any]] = []
    now = 10.0
    app = Plant(orders.append, clock=lambda: now)
    async with app.run_test(size=(100, 24)) as pilot:
        for item in some_plant():
            app.feed(item)
        await until(app, lambda: "slave 125 ([bold red]x[/] <b>" in seen(app, "#events"))
        assert "Operate" in seen(app, "#head")
        assert "level 3.4 bar" in seen(app)
        assert "hoist" in seen(app)

        # the page of a slave, and its story
        app.simulate_key("down")
        app.simulate_key("down")
        app.simulate_key("enter")
        await until(app, lambda: isinstance(app.screen, OneSlave) and "slave 8  tank" in seen(app, "#body"))
        assert "module 2 [red]missing[/]" in seen(app, "#body")
        app.simulate_key("w")
        await until(app, lambda: orders == [{"order": "why", "slave": 8}])
        app.tell_why("8", "cannot be asked: [b]")
        await until(app, lambda: "cannot be asked: [b]" in seen(app, "#body"))
        app.simulate_key("escape")
        await until(app, lambda: isinstance(app.screen, Overview))

        # pause: the bus goes on, the page does not
        app.simulate_key("space")
        await until(app, lambda: "PAUSED" in seen(app, "#head"))
        app.feed(snapshot({"3": {"fields": {"level": 99.5, "limit": True, "target": 5}}}, whole=False))
        app.draw_now()
        assert "level 3.4 bar" in seen(app)
        app.simulate_key("space")
        await until(app, lambda: "level 99.5 bar" in seen(app))
        assert "PAUSED" not in seen(app, "#head")

        # filter
        app.simulate_key("slash")
        await until(app, lambda: isinstance(app.focused, Input))
        for key in "tank":
            app.simulate_key(key)
        app.simulate_key("enter")
        await until(app, lambda: 'filter "tank"' in seen(app, "#columns") and app.focused is None)
        assert "valves" not in seen(app)
        assert "tank" in seen(app)
        app.simulate_key("escape")
        await until(app, lambda: "valves" in seen(app))
        app.simulate_key("slash")
        await until(app, lambda: isinstance(app.focused, Input))
        assert isinstance(app.focused, Input)
        app.focused.post_message(events.Paste("\x1b[2J\u202e"))
        await until(app, lambda: 'filter "\\x1b[2J\\u202e"' in seen(app, "#columns"))
        assert app.focused.value == "\\x1b[2J\\u202e"
        app.simulate_key("enter")
        await until(app, lambda: app.focused is None)
        app.simulate_key("escape")
        await until(app, lambda: "valves" in seen(app))
        app.simulate_key("f")
        await until(app, lambda: "valves" not in seen(app))
        assert "hoist" in seen(app)
        app.simulate_key("f")

        # nothing raw reaches the terminal, whoever made the line
        columns = app.screen.query_one("#columns", Lines)
        columns.show_lines([[("\x1b[2J\u202e", "bad")]])
        assert columns.render_line(0).text.rstrip() == "\\x1b[2J\\u202e"

        await watch_table(app, orders)

        # a narrow terminal of a few lines
        await pilot.resize_terminal(40, 10)
        await until(app, lambda: app.screen.size.width == 40 and "valves" in seen(app))
        await pilot.resize_terminal(100, 24)

        # 125 slaves with 244 octets each
        addresses = [str(address) for address in range(1, 126)]
        app.feed(plant({address: slave_plant(int(address), f"s{address}") for address in addresses}))
        octets = {address: values(inputs="ab" * 244, outputs="cd" * 244) for address in addresses}
        app.feed(snapshot(octets, t=9.0))
        await until(app, lambda: "s1 " in seen(app))
        app.simulate_key("end")
        await until(app, lambda: "s125" in seen(app))
        app.simulate_key("e")
        await until(app, lambda: isinstance(app.screen, Events) and "master: operate" in seen(app, "#body"))
        app.simulate_key("escape")
        await until(app, lambda: isinstance(app.screen, Overview))
        app.simulate_key("question_mark")
        await until(app, lambda: isinstance(app.screen, Help) and "pick a slave" in seen(app, "#body"))
        app.simulate_key("escape")
        await until(app, lambda: isinstance(app.screen, Overview))

        # nothing comes any more: nothing is shown as alive
        now += 3
        await until(app, lambda: "no values from the bus for 3 s" in seen(app, "#head"))
        assert all(line.startswith("-") for line in seen(app).splitlines())

        # orders; each question is answered by y alone
        orders.clear()
        for key, answer in (("ctrl+z", "n"), ("ctrl+z", "y"), ("q", "x"), ("ctrl+q", "n"), ("q", "y")):
            app.simulate_key(key)
            await until(app, lambda: isinstance(app.screen, Question))
            app.simulate_key(answer)
            await until(app, lambda: isinstance(app.screen, Overview))
        app.simulate_key("ctrl+c")
        await until(app, lambda: len(orders) == 3)
        assert orders == [{"order": "suspend"}, {"order": "interrupt"}, {"order": "interrupt"}]
        app.feed({"nonsense": 1})
        app.feed({"snapshot": 7})
        await until(app, lambda: "no item of the stream" in seen(app, "#head"))
