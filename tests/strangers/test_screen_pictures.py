"""Pictures of the live screen, drawn by textual and rendered by chromium.

With DPSTACK_PICTURES=docs/pictures they are written there.
"""

from __future__ import annotations

import asyncio
import html
import os
import re
import struct
import time
from pathlib import Path

import pytest
from screen_kit import DRIVE, Item, event, field, plant, slave_plant, snapshot, values
from svg_pictures import box, render
from textual.pilot import Pilot

from dpstack.screen.app import Plant

pytestmark = pytest.mark.strangers

BOILER = {
    "inputs": [field("pressure", "bar", "i16@0"), field("temperature", "°C", "i16@2"), field("door", at="bool@4.0")],
    "outputs": [field("valve", "%", "i16@0")],
    "gsd": "boiler.gsd",
    "vendor": "Example",
    "model": "Remote I/O",
    "modules": [
        {"name": "2 AI", "config": "51", "inputs": 4, "outputs": 0},
        {"name": "8 DI", "config": "10", "inputs": 1, "outputs": 0},
        {"name": "1 AO", "config": "60", "inputs": 0, "outputs": 2},
    ],
}
SLAVES = {
    "3": slave_plant(3, "hoist", drive={"profile": "demag-dedrive", "telegram": "PPO1", "reference_rpm": 1450}),
    "4": slave_plant(4, "fan", drive={"profile": "fuji-frenic", "telegram": "PPO3", "reference_rpm": None}),
    "8": slave_plant(8, "boiler", **BOILER),
    "9": slave_plant(9, "conveyor"),
    "11": slave_plant(11, "packer"),
    "14": slave_plant(14, "labeller"),
}
RUNNING = DRIVE | {
    "state": "running",
    "running": True,
    "speed": 0.4,
    "setpoint": 0.4,
    "frequency_hz": 20.0,
    "faults": [],
}
TRIPPED = DRIVE | {"faults": ["OC1 overcurrent during acceleration"], "speed": 0.0, "frequency_hz": 0.0}
BREAK = "module 1, channel 2: wire break"
NOW = {
    "3": values(drive=RUNNING, exchanges=81234),
    "4": values(drive=TRIPPED),
    "8": values(
        fields={"pressure": 3.4, "temperature": 71.5, "door": False, "valve": 42},
        retries=2,
        inputs="002202cb00",
        conspicuous=BREAK,
        diagnosis={"flags": ["ext_diag", "wd_on"], "texts": [BREAK]},
    ),
    "9": values(inputs="0103", outputs="07"),
    "11": values(
        state="fault",
        inputs_valid=False,
        inputs_age_ms=41_300.0,
        inputs="",
        fault={"kind": "cfg", "text": "refuses its configuration (Chk_Cfg): other modules are plugged"},
        diagnosis={"flags": ["cfg_fault", "prm_req"], "texts": []},
    ),
    "14": values(state="offline", inputs_valid=False, inputs_age_ms=9_800.0, inputs="00a4", retries=14, timeouts=7),
}
STORY = {
    "slave": "packer", "address": 11, "source": "run", "state": "fault",
    "steps": [
        {"t": 0.012, "text": "Set_Prm 88 01 14 0B 12 34 00: acknowledged"},
        {"t": 0.019, "text": "Chk_Cfg 10 20: acknowledged (the next diagnosis says whether it was accepted)"},
        {"t": 0.025, "text": "Slave_Diag 04 05 00 FF 12 34: configuration refused (octet 1 bit 2, Cfg_Fault)"},
    ],
    "causes": [{
        "cause": "module_order", "confidence": 0.93, "meaning": "the modules are the right ones in another order",
        "for": ["The slave reports the identifier octets 20 10."], "against": [],
        "next": 'Write modules = ["8 DO", "8 DI"] in the table of this slave.',
    }],
}  # fmt: skip


def items() -> list[Item]:
    told = [
        event("master: operate"),
        event("slave 11 (packer): fault: refuses its configuration (Chk_Cfg)", 11, "error"),
        event("slave 8 (boiler): diagnosis module 1, channel 2: wire break", 8, "warning"),
        event("slave 14 (labeller): offline", 14),
        event("drive 4 (fan): fault OC1 overcurrent during acceleration", 4, "error"),
    ]
    classes = [[1000 + 60 * n, count] for n, count in enumerate([4, 40, 210, 380, 220, 90, 30, 12, 6, 0, 2, 0, 1])]
    return [plant(SLAVES), *told, snapshot(NOW, histogram=classes, masters=[1, 2], late=3, telegrams=812_345)]


async def draw(folder: Path) -> None:
    app = Plant(lambda _order: None, clock=lambda: 10.0)
    async with app.run_test(size=(104, 24)) as pilot:
        for item in items():
            app.feed(item)
        app.tell_why("11", STORY)
        await take(app, pilot, folder, "screen", "fan", "wire break", "last events")
        await pilot.press("end", "up", "enter")
        await take(app, pilot, folder, "screen-slave", "module_order (93 %)")
        await pilot.press("escape", "home")
        await pilot.resize_terminal(48, 16)
        await take(app, pilot, folder, "screen-narrow", "hoist")


async def take(app: Plant, pilot: Pilot[None], folder: Path, name: str, *wanted: str) -> None:
    await pilot.pause()
    app.draw_now()
    await pilot.pause(0.2)
    picture = app.export_screenshot(title="dpstack run plant.toml")
    text = "".join(html.unescape(re.sub(r"<[^>]+>", "", picture)).split())
    for one in wanted:
        assert one.replace(" ", "") in text
    (folder / f"{name}.svg").write_text(picture, encoding="utf-8")


def test_pictures_of_the_screen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    try:
        asyncio.run(draw(tmp_path))
    finally:
        monkeypatch.undo()
        time.tzset()
    for name in ("screen", "screen-slave", "screen-narrow"):
        svg, png = tmp_path / f"{name}.svg", Path(os.environ.get("DPSTACK_PICTURES", tmp_path)) / f"{name}.png"
        render(svg, png, tmp_path)
        width, height = struct.unpack(">II", png.read_bytes()[16:24])
        assert (width, height) == box(svg)
