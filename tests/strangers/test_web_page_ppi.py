"""The page of an S7-200 in chromium: its values with quality, orders for those that its ``allow_commands`` lists."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import pytest
from programs import Starter

from dpstack.api.control.client import connect
from tests.strangers.browser_kit import Browser

pytestmark = pytest.mark.strangers

PLANT: Final = """
[bus]
port = "virtual"
baud = 187500

[[ppi]]
address = 2
name = "press"
values = { level = { at = "VW100", unit = "cm" }, heating = "M0.3", out = "AQW0" }
allow_commands = ["heating"]
"""


def test_the_page_of_a_cpu(browser: Browser, start: Starter, tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_text(PLANT, encoding="utf-8")
    run = start("run", str(file), "--json")
    run.wait_for_slaves(1)
    web = start("web", str(file), "--json", "--listen", "127.0.0.1:0", "--control")
    web.wait_for('"listening"')
    browser.window(1280)
    browser.open(str(next(line["url"] for line in web.lines if line["event"] == "listening")))
    browser.sees("Live", "#live")
    browser.sees("S7-200 (PPI)")
    browser.go("slave/2")
    browser.sees("Values are read; those with a mark are not good.")
    browser.sees("CPU 2 refuses read AQW0: access is not allowed")
    # there is nothing of DP
    heads = browser.texts("section.card > h2")
    assert heads == ["Values of the CPU", "History", "Identity", "Counters"]
    assert browser.count("#set-2-heating") == 1
    assert browser.count("#set-2-level") == 0
    with connect(f"virtual:{run.process.pid}") as client:
        client.call("set", "press.level=250")
        browser.sees("250")
        browser.click("[data-key='set-2-heating-give']")
        browser.click("#confirm-yes")
        browser.until(lambda: client.call("status")["slaves"]["2"]["fields"]["heating"], "the order")
        client.call("power-off", "press")
    browser.sees("CPU 2 does not answer")
    browser.sees("Values are not valid")
    assert browser.console() == []
