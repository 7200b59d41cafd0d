"""The page of ``dpstack web`` in chromium: the time on the bus, and time-stamped events of an alarm."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import pytest

from tests.strangers.browser_kit import Browser
from tests.strangers.shown_plant import IMAGE, SCRIPT, Beating, ShownPlant, event, plant, slave_of, snapshot, whole

pytestmark = pytest.mark.strangers

SENT: Final[dict[str, Any]] = {
    "address": 2,
    "time": "2026-11-29T02:30:00.000Z",
    "resolution_ms": 10,
    "synchronised": True,
    "summer_time": False,
    "at": 1.0,
    "values": 7,
}
CLOCK: Final[dict[str, Any]] = {
    "interval_s": 10.0,
    "sent": SENT,
    "late_ms": 3.2,
    "late_measured": True,
    "trouble": None,
    "masters": [],
    "remark": {"text": "this master sends the time every 10 s, resolution 10 ms, synchronised", "severity": "info"},
}
OTHER: Final = {**SENT, "address": 5, "synchronised": False, "resolution_ms": 1000, "values": 2}
ALARM: Final = event(
    "alarm",
    0.3,
    "slave 8 (valves): process alarm, slot 2, 3 time-stamped events in record 103",
    address=8,
    name="valves",
    specifier="none",
    time_stamps={"buffer_overrun": True, "restarted": False, "index": 103, "events": 3},
)


@pytest.fixture
def shown(browser: Browser) -> Iterator[ShownPlant]:
    shown = ShownPlant()
    shown.put(plant({"8": slave_of("valves", 8)}), whole(0.1, clock=CLOCK), ALARM)
    beating = Beating(shown)
    browser.window(1280)
    browser.open(shown.url)
    browser.sees("Live", "#live")
    yield shown
    beating.stop()
    browser.open("about:blank")
    shown.close()


def test_the_bus_page_shows_its_clock_and_a_second_clock_master(browser: Browser, shown: ShownPlant) -> None:
    browser.go("bus")
    browser.sees("this master sends the time every 10 s")
    browser.sees("3200 µs, measured")
    browser.sees("2026-11-29 02:30:00.000 UTC")
    remark = {"text": f"this master and master 5 send the time: {SCRIPT}", "severity": "warning"}
    shown.put(snapshot(1.0, {}, clock={**CLOCK, "masters": [OTHER], "remark": remark}))
    browser.sees(f"this master and master 5 send the time: {SCRIPT}")
    browser.sees("not synchronised (SYF)")
    browser.window(400, 844)
    browser.until(lambda: browser.js("return innerWidth") == 400)
    assert browser.js("return document.documentElement.scrollWidth") == 400
    shown.put(snapshot(2.0, {}, clock=None))
    browser.until(lambda: browser.js("return document.querySelector('#h-clock').parentElement.hidden"), "no clock")


def test_an_alarm_announces_its_events_and_they_are_read(browser: Browser, shown: ShownPlant) -> None:
    shown.put(snapshot(1.0, {"8": {"clock": {"master": 2, "synchronised": True, "text": f"follows {IMAGE}"}}}))
    browser.go("slave/8")
    browser.sees("events were lost: its buffer was full", "#h-alarms ~ ol")
    browser.sees(f"follows {IMAGE}")
    browser.js(
        "[...document.querySelectorAll('button')].find((one) => one.textContent === arguments[0]).click()",
        "Read 3 events of record 103",
    )
    browser.sees("2026-11-29 02:30:00.120", ".stamped")
    browser.sees("buffer overrun \\u202etxt.exe")
    browser.sees(SCRIPT, ".stamped")
    assert browser.count("img, iframe, object, embed") == 0
    assert ("acyclic", "8", "stamps", "103") in shown.called
    browser.window(400, 844)
    browser.until(lambda: browser.js("return innerWidth") == 400)
    assert browser.js("return document.documentElement.scrollWidth") == 400
    browser.js("document.querySelector('#stamps-index').value = '116'")
    browser.js("document.querySelector('#stamps-index').form.requestSubmit()")
    browser.sees("Records of time-stamped events are 100 to 115.")
