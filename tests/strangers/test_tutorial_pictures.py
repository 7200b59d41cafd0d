"""Pictures of the first page of the tutorial: its plant on the live screen and in the browser, while the motor turns.

With DPSTACK_PICTURES=docs/pictures they are written there.
"""

from __future__ import annotations

import asyncio
import html
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from pictures_kit import picture_folder, shows_no_place
from programs import Starter

import dpstack
from dpstack.screen.app import Plant
from tests.strangers.browser_kit import Browser
from tests.strangers.svg_pictures import render

pytestmark = pytest.mark.strangers

_PAGE: Final = Path(__file__).resolve().parents[2] / "docs" / "tutorial" / "first-motor.md"


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    """The configuration that the page prints."""
    found = re.search(r"<!-- file: motor\.toml -->\n```toml\n(.*?)^```", _PAGE.read_text(), re.DOTALL | re.MULTILINE)
    assert found is not None
    file = tmp_path / "motor.toml"
    file.write_text(found[1], encoding="utf-8")
    return file


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    found = Browser(tmp_path)
    yield found
    found.close()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Starter]:
    starter = Starter(tmp_path)
    yield starter
    starter.close()


async def live_items(plant: Path) -> list[dict[str, Any]]:
    """The items of the live stream until the motor has its speed."""
    items: list[dict[str, Any]] = []

    async def read(bus: dpstack.Bus) -> None:
        async for item in bus.live():
            items.append(dict(item))  # noqa: PERF401 - the other task looks on

    async with dpstack.open_bus(plant) as bus:
        reading = asyncio.create_task(read(bus))
        await bus.operate()
        fan = bus.drive("fan")
        await fan.start()
        fan.speed = 0.5
        await fan.reached()
        await asyncio.sleep(1)
        shown = list(items)
    await reading
    return shown


async def draw(items: list[dict[str, Any]]) -> str:
    app = Plant(lambda _order: None, clock=lambda: 10.0)
    async with app.run_test(size=(104, 14)) as pilot:
        for item in items:
            app.feed(item)
        await pilot.pause()
        app.draw_now()
        await pilot.pause(0.2)
        return app.export_screenshot(title="dpstack run motor.toml")


def test_picture_of_the_screen_of_the_first_motor(plant: Path, tmp_path: Path) -> None:
    picture = asyncio.run(draw(dpstack.run_virtual(live_items(plant))))
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
