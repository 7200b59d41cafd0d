"""Pictures of simulated plants in virtual time: the live screen with faults, drawn by textual and rendered by chromium;
the first page of the tutorial, its plant also in the browser; a recording by ``dpstack plot``.

With DPSTACK_PICTURES=docs/pictures they are written there.
"""

from __future__ import annotations

import asyncio
import contextlib
import html
import math
import re
import signal
import struct
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Final

import pytest
from api_kit import bench_of
from pictures_kit import copy_plant, picture_folder, shows_no_place
from programs import Starter
from textual.pilot import Pilot

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.cli.main import main
from dpstack.screen.app import Plant
from tests.strangers.browser_kit import Browser
from tests.strangers.svg_pictures import box, render

pytestmark = pytest.mark.strangers


@contextlib.asynccontextmanager
async def watched(file: Path) -> AsyncIterator[tuple[dpstack.Bus, list[dict[str, Any]]]]:
    """The bus of ``file``, and the items of its live stream as they come."""
    items: list[dict[str, Any]] = []

    async def read(bus: dpstack.Bus) -> None:
        async for item in bus.live():
            items.append(dict(item))  # noqa: PERF401 - others look on

    async with dpstack.open_bus(file) as bus:
        reading = asyncio.create_task(read(bus))
        yield bus, items
    await reading


async def shown(file: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The items of the live stream of a minute with faults, and the story of the slave without power."""
    async with watched(file) as (bus, items):
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
        return seen, (await bus.why("mixer")).as_dict()


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
            "line break",
            "F2100",
            "last events",
        )
        await pilot.press("end", "enter")
        await take(app, pilot, folder, "screen-slave", "slave 12", "not_there")
        await pilot.press("escape", "home", "down", "down", "down", "enter")
        await take(app, pilot, folder, "screen-rack", "slot 3", "line break", "pressure")
        await pilot.press("escape", "home")
        app.watched += ["8.pressure", "8.full", "8.inlet", "9.level", "4:speed", "8/1/input/4"]
        await pilot.press("t")
        await pilot.resize_terminal(104, 14)
        await take(app, pilot, folder, "screen-watch", "valves.pressure", "line break", "fan: speed")
        await pilot.press("escape")
        await pilot.resize_terminal(48, 24)
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
    for name in ("screen", "screen-slave", "screen-rack", "screen-watch", "screen-narrow"):
        svg, png = tmp_path / f"{name}.svg", picture_folder(tmp_path) / f"{name}.png"
        render(svg, png, tmp_path)
        width, height = struct.unpack(">II", png.read_bytes()[16:24])
        assert (width, height) == box(svg)


_PAGE: Final = Path(__file__).resolve().parents[2] / "docs" / "tutorial" / "first-motor.md"


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    """The configuration that the page prints."""
    found = re.search(r"<!-- file: motor\.toml -->\n```toml\n(.*?)^```", _PAGE.read_text(), re.DOTALL | re.MULTILINE)
    assert found is not None
    file = tmp_path / "motor.toml"
    file.write_text(found[1], encoding="utf-8")
    return file


async def live_items(plant: Path) -> list[dict[str, Any]]:
    """The items of the live stream until the motor has its speed."""
    async with watched(plant) as (bus, items):
        await bus.operate()
        fan = bus.drive("fan")
        await fan.start()
        fan.speed = 0.5
        await fan.reached()
        await asyncio.sleep(1)
        return list(items)


async def draw_motor(items: list[dict[str, Any]]) -> str:
    app = Plant(lambda _order: None, clock=lambda: 10.0)
    async with app.run_test(size=(104, 14)) as pilot:
        for item in items:
            app.feed(item)
        await pilot.pause()
        app.draw_now()
        await pilot.pause(0.2)
        return app.export_screenshot(title="dpstack run motor.toml")


def test_picture_of_the_screen_of_the_first_motor(plant: Path, tmp_path: Path) -> None:
    picture = asyncio.run(draw_motor(dpstack.run_virtual(live_items(plant))))
    text = "".join(html.unescape(re.sub(r"<[^>]+>", "", picture)).split())
    shows_no_place(text)
    for wanted in ("fan", "running", "operate", "onvirtual"):
        assert wanted in text.lower()
    svg = tmp_path / "screen.svg"
    svg.write_text(picture, encoding="utf-8")
    png = picture_folder(tmp_path) / "tutorial-screen.png"
    render(svg, png, tmp_path)
    assert png.read_bytes().startswith(b"\x89PNG")


def test_picture_of_the_page_of_the_first_motor(plant: Path, browser: Browser, start: Starter, tmp_path: Path) -> None:
    run = start("run", str(plant), "--json")
    run.wait_for_slaves(1)
    web = start("web", str(plant), "--json", "--listen", "127.0.0.1:0")
    web.wait_for('"listening"')
    ordered = start("drive", str(plant), "fan", "start", "speed", "0.5", "reached", "--json")
    assert ordered.end() == 0, ordered.err
    browser.open(str(next(line["url"] for line in web.lines if line["event"] == "listening")))
    browser.sees("Live", "#live")
    browser.sees("running")
    browser.sees("Simulated slaves", "#badges")
    shows_no_place(browser.text("body"))
    browser.window(1280, 860)
    png = picture_folder(tmp_path) / "tutorial-page.png"
    browser.picture(png)
    assert png.read_bytes().startswith(b"\x89PNG")
    browser.open("about:blank")
    assert web.end(signal.SIGINT) == 0
    assert run.end(signal.SIGINT) == 0


#: the shown slaves and columns
SHOWN = ("fan.setpoint", "fan.speed", "fan.frequency_hz", "tank.level", "mixer.state", "fan.drive_state", "valves.full")


async def record(file: Path, recording: Path) -> None:
    """Twelve seconds: the fan ramps twice, the level goes up and down, the mixer loses its power for 1.5 s."""
    async with dpstack.open_bus(file) as bus:
        await bus.ready()
        await bus.operate()
        order = slave_handlers(bench_of(bus), core_of(bus))
        fan = bus.drive("fan")
        async with bus.record(recording, on_change=True):
            for tenth in range(120):
                level = round(16 + 12 * math.sin(tenth / 24)) / 2
                order["set"]([f"tank.level={level}", "tank.temperature=40"])
                match tenth:
                    case 10:
                        await fan.start()
                    case 20:
                        fan.speed = 0.6
                    case 60:
                        order["power-off"](["mixer"])
                    case 75:
                        order["power-on"](["mixer"])
                    case 90:
                        fan.speed = 0.2
                if tenth % 30 == 15:
                    order["set"]([f"valves.full={'on' if tenth % 60 == 15 else 'off'}"])
                await asyncio.sleep(0.1)


def test_picture_of_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = picture_folder(tmp_path)
    monkeypatch.chdir(tmp_path)
    # the title has the name of the file
    dpstack.run_virtual(record(copy_plant(tmp_path), tmp_path / "simulated.csv"))
    png = tmp_path / "picture.png"
    assert main(["plot", "simulated.csv", *SHOWN, "--write", str(png)]) == 0
    octets = png.read_bytes()
    assert octets.startswith(b"\x89PNG")
    assert len(octets) > 20_000
    (target / "plot.png").write_bytes(octets)
