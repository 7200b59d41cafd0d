"""The end of ``run``: the bus never waits for the screen, and pays for it in small steps."""

from __future__ import annotations

import asyncio
import json
import os
import pty
import socket
import termios
from collections.abc import Mapping
from typing import Any

from dpstack.plant.pending import Pending
from dpstack.screen.process import ScreenProcess, Terminal
from tests.screen.screen_kit import Item, plant, slave_plant, snapshot, values


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
