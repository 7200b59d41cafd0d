"""Pictures of the live screen: the simulated plant of docs/pictures/plant.toml in virtual time, with faults, drawn by
textual and rendered by chromium.

With DPSTACK_PICTURES=docs/pictures they are written there.
"""

from __future__ import annotations

import asyncio
import html
import re
import struct
from pathlib import Path
from typing import Any

import pytest
from api_kit import bench_of
from pictures_kit import copy_plant, picture_folder, shows_no_place
from textual.pilot import Pilot

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.screen.app import Plant
from tests.strangers.svg_pictures import box, render

pytestmark = pytest.mark.strangers


async def shown(file: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The items of the live stream of a minute with faults, and the story of the slave without power."""
    items: list[dict[str, Any]] = []

    async def read(bus: dpstack.Bus) -> None:
        async for item in bus.live():
            items.append(dict(item))  # noqa: PERF401 - the other task looks on

    async with dpstack.open_bus(file) as bus:
        reading = asyncio.create_task(read(bus))
        await bus.ready()
        await bus.operate()
        order = slave_handlers(bench_of(bus), core_of(bus))
        for name, speed in (("hoist", 0.6), ("fan", 0.8), ("pump", -0.4)):
            drive = bus.drive(name)
            if name == "hoist":
                await drive.write(412, 1)  # control by the bus
            await drive.start()
            drive.speed = speed
        order["set"](["valves.full=on", "valves.pressure=4.25", "tank.level=13.5", "tank.temperature=40"])
        bus.slave("valves")["inlet"] = True
        await asyncio.sleep(40)
        order["wire-break"](["8", "3", "0", "on"])
        await asyncio.sleep(7)
        order["trip"](["3", "F2100"])
        await asyncio.sleep(9)
        order["power-off"](["12"])
        await asyncio.sleep(4)
        seen = list(items)
        story = (await bus.why("mixer")).as_dict()
    await reading
    return seen, story


async def draw(folder: Path, items: list[dict[str, Any]], story: dict[str, Any]) -> None:
    app = Plant(lambda _order: None, clock=lambda: 10.0)
    async with app.run_test(size=(104, 24)) as pilot:
        for item in items:
            app.feed(item)
        app.tell_why("12", story)
        await take(
            app,
            pilot,
            folder,
            "screen",
            "master 2 on virtual",
            "fan",
            "slots with a diagnosis: 3",
            "F2100",
            "last events",
        )
        await pilot.press("end", "enter")
        await take(app, pilot, folder, "screen-slave", "slave 12", "not_there")
        await pilot.press("escape", "home")
        await pilot.resize_terminal(48, 16)
        await take(app, pilot, folder, "screen-narrow", "on virtual", "hoist")


async def take(app: Plant, pilot: Pilot[None], folder: Path, name: str, *wanted: str) -> None:
    await pilot.pause()
    app.draw_now()
    await pilot.pause(0.2)
    picture = app.export_screenshot(title="dpstack run docs/pictures/plant.toml")
    text = html.unescape(re.sub(r"<[^>]+>", "", picture)).replace("\xa0", " ")
    for one in wanted:
        assert one.replace(" ", "") in "".join(text.split())
    shows_no_place(text)
    (folder / f"{name}.svg").write_text(picture, encoding="utf-8")


def test_pictures_of_the_screen(tmp_path: Path) -> None:
    items, story = dpstack.run_virtual(shown(copy_plant(tmp_path)))
    asyncio.run(draw(tmp_path, items, story))
    for name in ("screen", "screen-slave", "screen-narrow"):
        svg, png = tmp_path / f"{name}.svg", picture_folder(tmp_path) / f"{name}.png"
        render(svg, png, tmp_path)
        width, height = struct.unpack(">II", png.read_bytes()[16:24])
        assert (width, height) == box(svg)
