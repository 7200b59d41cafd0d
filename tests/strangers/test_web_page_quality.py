"""Qualities of values on the page in chromium: tiles, table, rack of a slave, events that come and go, watch table."""

from __future__ import annotations

import urllib.parse
from collections.abc import Iterator
from typing import Any, Final

import pytest

from tests.strangers.browser_kit import Browser
from tests.strangers.shown_plant import (
    IMAGE,
    Beating,
    ShownPlant,
    drive_of,
    event,
    plant,
    slave_of,
    snapshot,
    values_of,
    whole,
)

pytestmark = pytest.mark.strangers

LINE_BREAK: Final = "line break: slot 11 (2 AI), input channel 0"
BAD: Final = {"quality": "bad", "reason": "line_break", "text": LINE_BREAK, "since": 0.05}
DOUBT: Final = {"slot": 11, "channel": 0, "direction": "input", **BAD}


def _module(slot: int, name: str, config: str, **places: int) -> dict[str, Any]:
    nothing = {
        "inputs": 0, "input_at": 0, "input_width": 0, "outputs": 0, "output_at": 0, "output_width": 0,
    }  # fmt: skip
    return {"slot": slot, "name": name, "config": config, **nothing, **places}


#: 8 modules of 8 inputs, 2 of 8 outputs, 2 with two analogue inputs
MODULES: Final = [
    *(_module(n + 1, "8 DI", "10", inputs=1, input_at=n, input_width=1) for n in range(8)),
    *(_module(n + 9, "8 DO", "20", outputs=1, output_at=n, output_width=1) for n in range(2)),
    *(_module(n + 11, "2 AI", "51", inputs=4, input_at=8 + 4 * n, input_width=16) for n in range(2)),
]
RACK: Final = slave_of(
    "rack", 8, modules=MODULES, input_len=16, output_len=2,
    inputs=[
        {"name": "full", "type": "bool", "at": "bool@0.3", "slot": 1, "unit": ""},
        {"name": "pressure", "type": "i16", "at": "i16@8", "slot": 11, "channel": 0, "unit": "bar"},
        {"name": "flow", "type": "i16", "at": "i16@14", "slot": 12, "channel": 1, "unit": "l/min"},
    ],
    outputs=[{"name": "inlet", "type": "bool", "at": "bool@1.7", "slot": 10, "unit": ""}],
)  # fmt: skip
RACK_VALUES: Final = values_of(
    inputs="08000000000000007fff00010000002a",
    outputs="0080",
    fields={"full": True, "pressure": 32.767, "flow": 42, "inlet": True},
    quality=None,
    qualities=None,
    doubts=None,
)
HOIST: Final = slave_of("hoist", 3, drive={"profile": "demag-dedrive", "telegram": "PPO1"})
BROKEN: Final = {"qualities": {"pressure": BAD}, "doubts": [DOUBT]}


@pytest.fixture
def shown(browser: Browser) -> Iterator[ShownPlant]:
    shown = ShownPlant(control=True)
    shown.put(
        plant({"3": HOIST, "8": RACK}, virtual=True, config=f"/{id(shown)}.toml"),
        whole(0.1, {"3": values_of(drive=drive_of(torque=-0.25), quality=None), "8": RACK_VALUES}),
    )
    beating = Beating(shown)
    browser.window(1280)
    browser.open(shown.url)
    browser.sees("Live", "#live")
    yield shown
    beating.stop()
    browser.open("about:blank")
    shown.close()
    assert [line for line in browser.console() if "WebSocket" not in line] == []


def _break(shown: ShownPlant, **more: Any) -> None:
    """The wire of the first analogue input is broken, as the run says it."""
    verdicts = {"level": "error", "remark": {"text": LINE_BREAK, "severity": "error"}}
    shown.put(snapshot(3.2, {"8": {**BROKEN, **verdicts, **more}}))


def _heal(shown: ShownPlant) -> None:
    shown.put(snapshot(5.2, {"8": {"qualities": None, "doubts": None, "level": "good", "remark": None}}))


def _tiles(browser: Browser) -> dict[str, str]:
    return dict(text.split("\n")[:2] for text in browser.texts(".tiles > div"))


def _struck(browser: Browser, css: str) -> str:
    """How the first element of ``css`` is decorated."""
    return str(browser.js("return getComputedStyle(document.querySelector(arguments[0])).textDecorationLine", css))


def test_a_broken_wire_is_counted_and_its_value_is_marked(browser: Browser, shown: ShownPlant) -> None:
    tiles = _tiles(browser)
    assert (tiles["With a fault"], tiles["With a diagnosis"]) == ("0", "0")
    assert browser.count("#row-8 .q-bad") == 0
    _break(shown)
    browser.sees(LINE_BREAK, "#row-8 .remark")
    tiles = _tiles(browser)
    assert (tiles["With a fault"], tiles["With a diagnosis"]) == ("1", "1")
    assert browser.count(".line .station.bad") == 1
    assert browser.texts("#row-8 .q-bad .figure") == ["32.767"]
    assert _struck(browser, "#row-8 .q-bad .figure") == "line-through"
    assert browser.js("return document.querySelector('#row-8 .q-bad').title") == f"bad: {LINE_BREAK}"
    _heal(shown)
    browser.until(lambda: browser.count("#row-8 .q-bad") == 0, "good again")
    assert _tiles(browser)["With a diagnosis"] == "0"


def test_an_uncertain_slave_is_amber(browser: Browser, shown: ShownPlant) -> None:
    doubt = {"quality": "uncertain", "reason": "announced", "text": "diagnosis announced", "since": 3.0}
    shown.put(snapshot(3.2, {"8": {"quality": doubt, "level": "warning", "doubts": [{"slot": None, **doubt}]}}))
    browser.until(lambda: browser.count(".line .station.warn") == 1, "amber")
    assert _tiles(browser)["With a diagnosis"] == "1"
    assert _tiles(browser)["With a fault"] == "0"
    assert browser.count("#row-8 .q-uncertain") == 4
    assert _struck(browser, "#row-8 .q-uncertain .figure") == "none"
    browser.go("slave/8")
    browser.sees("All values are uncertain: diagnosis announced", "[aria-labelledby=h-rack]")


def test_drives_have_quantities_in_the_table(browser: Browser, shown: ShownPlant) -> None:
    browser.sees("Speed", "#row-3")
    assert browser.text("#row-3 [data-label=Inputs]").split() == [
        "Speed", "50", "%", "Frequency", "25", "Hz", "Current", "40", "%", "Torque", "\u221225", "%",
    ]  # fmt: skip
    assert browser.text("#row-3 [data-label=Outputs]").split() == ["Set", "point", "50", "%"]
    shown.put(snapshot(2.0, {"3": {"drive": drive_of(torque=None, current=None, speed=-0.333)}}))
    browser.sees("\u221233.3", "#row-3")
    assert "Torque" not in browser.text("#row-3")
    bad = {"quality": "bad", "reason": "static", "text": "static diagnosis", "since": 2.0}
    shown.put(snapshot(3.2, {"3": {"quality": bad}}))
    browser.until(lambda: browser.count("#row-3 .q-bad"), "bad")
    assert _struck(browser, "#row-3 .q-bad .figure") == "line-through"


def _channel(browser: Browser, slot: int, channel: int) -> list[str]:
    """Number, raw octets and value of a channel, as a person reads them."""
    return browser.text(f"[data-slot='{slot}'] [data-channel='{channel}']").split("\n")


def test_the_rack_has_modules_channels_and_values(browser: Browser, shown: ShownPlant) -> None:
    """12 modules; octets and bits by hand."""
    browser.go("slave/8")
    heads = browser.texts(".slot > header")
    assert [head.split("\n")[0:2] for head in heads][:2] == [["Slot 1", "8 DI"], ["Slot 2", "8 DI"]]
    assert len(heads) == 12
    raw = [browser.text(f"[data-slot='1'] [data-channel='{n}'] .raw") for n in range(8)]
    assert raw == ["0", "0", "0", "1", "0", "0", "0", "0"]
    assert browser.text("[data-slot='1'] [data-channel='3'] .value").split() == ["full", "on"]
    assert browser.text("[data-slot='10'] [data-channel='7'] .value").split() == ["inlet", "on"]
    assert browser.text("[data-slot='11'] [data-channel='0'] .raw") == "7f ff"
    assert browser.text("[data-slot='11'] [data-channel='0'] .value").split() == ["pressure", "32.767", "bar"]
    assert browser.text("[data-slot='11'] [data-channel='1'] .raw") == "00 01"
    assert browser.text("[data-slot='12'] [data-channel='1'] .raw") == "00 2a"
    assert browser.text("[data-slot='12'] [data-channel='1'] .value").split() == ["flow", "42", "l/min"]
    assert browser.count(".bad-slot, .warn-slot, .channels > .q-bad") == 0
    _break(shown)
    browser.sees(LINE_BREAK, "[data-slot='11']")
    assert browser.count(".bad-slot") == 1
    bad = browser.js(
        "return [...document.querySelectorAll('.channels > .q-bad')].map((one) =>"
        " [one.closest('.slot').dataset.slot, one.dataset.channel])"
    )
    assert bad == [["11", "0"]]
    css = "[data-slot='11'] [data-channel='0'] .value"
    assert "32.767" in browser.text(css)
    assert f"bad: {LINE_BREAK}" in browser.text(css)
    assert _struck(browser, f"{css} .figure") == "line-through"
    assert browser.text("h1 ~ .state") == "Data exchange"
    browser.sees(LINE_BREAK, "main > .fault")


def test_a_diagnosis_without_a_name_or_a_slot_is_in_the_rack(browser: Browser, shown: ShownPlant) -> None:
    elsewhere = {"slot": 33, "quality": "good", "reason": "elsewhere", "text": f"slot 33 {IMAGE}", "since": 1.0}
    unnamed = {**DOUBT, "slot": 12, "text": "over range: slot 12 (2 AI), input channel 0", "quality": "uncertain"}
    browser.go("slave/8")
    shown.put(snapshot(3.2, {"8": {"doubts": [elsewhere, unnamed]}}))
    browser.sees("over range: slot 12", "[data-slot='12'] [data-channel='0']")
    assert browser.count(".channels > .q-uncertain") == 1
    browser.sees(f"slot 33 {IMAGE}", ".rack-view > .doubts")
    assert browser.count("main img") == 0


def test_a_number_has_its_word_beside_it_wherever_it_is_shown(browser: Browser, shown: ShownPlant) -> None:
    """A text of a device file is text: its characters that change the direction are escaped, its markup stays."""
    words = {"1": "open", "42": f"far {IMAGE}\u202e"}
    flow = {**RACK["inputs"][2], "words": words, "unit": ""}
    inlet = {"name": "inlet", "type": "u8", "at": "u8@1", "slot": 10, "unit": "", "words": words}
    rack = {**RACK, "inputs": [*RACK["inputs"][:2], flow], "outputs": [inlet]}
    told = {"quality": "good", "reason": "status_good", "text": "open", "since": 3.0}
    fields = {"full": True, "pressure": 32.767, "flow": 42, "inlet": 1}
    shown.put(
        plant({"3": HOIST, "8": rack}, virtual=True, config=f"/{id(shown)}.toml"),
        whole(3.2, {"3": values_of(drive=drive_of(), quality=None),
                    "8": {**RACK_VALUES, "fields": fields, "qualities": {"inlet": told}, "held_fields": {"inlet": 3}}}),
    )  # fmt: skip
    far = f"42 (far {IMAGE}\\u202e)"
    browser.sees(far, "#row-8 [data-label=Inputs]")
    browser.sees("1 (open)", "#row-8 [data-label=Outputs]")
    held = browser.js("return document.querySelector('#row-8 .held').title")
    assert held == "the application's value, not sent: 3 (no meaning)"
    browser.go("slave/8")
    browser.sees(far, "[data-slot='12'] [data-channel='1'] .value")
    assert browser.count("main img") == 0
    browser.js("location.hash = '#/watch?8.flow&8.inlet'")
    browser.sees(far, "[data-id='8.flow']")
    browser.sees("1 (open)", "[data-id='8.inlet']")
    assert browser.text("[data-id='8.inlet']").count("open") == 1


def test_old_values_have_no_good_quality(browser: Browser, shown: ShownPlant) -> None:
    browser.go("watch")
    browser.js("location.hash = '#/watch?8.flow&8.pressure'")
    browser.sees("good", "table.watched")
    _break(shown)
    browser.sees("bad", "[data-id='8.pressure']")
    shown.put(snapshot(4.0, {}, stale=True))
    browser.sees("Old values", "#live")
    browser.sees("stale", "[data-id='8.flow']")
    assert "bad" in browser.text("[data-id='8.pressure']")  # old, and bad before
    assert "good" not in browser.text("table.watched")
    browser.go("slave/8")
    assert browser.count(".channels > li:not(.q-bad):not(.q-stale)") == 0


def test_events_say_what_appears_and_what_disappears(browser: Browser, shown: ShownPlant) -> None:
    _break(shown)
    browser.sees("▲ appears", "main .events")
    first = browser.texts("main .events li")[0]
    assert first.split("\n")[1:] == ["8", f"▲ appears{LINE_BREAK} (rack)"]
    assert browser.count("main .events li.error .change") == 1
    shown.put(snapshot(4.0, {"8": {"doubts": [DOUBT]}}))  # nothing new
    _heal(shown)
    browser.sees("▼ disappears", "main .events")
    shown.put(
        event("alarm", 6.0, "diagnosis alarm", address=8, specifier="disappears_others"),
        event("alarm", 6.1, "diagnosis alarm", address=8, specifier="none"),
    )
    browser.until(lambda: browser.count("main .events .change") == 3, "three marks")
    marks = browser.texts("main .events .change")
    assert marks == ["▼ disappears, others are left", "▼ disappears", "▲ appears"]
    browser.go("slave/8")
    assert browser.count("[aria-labelledby=h-history] .change") == 3


def test_a_page_that_is_opened_later_knows_since_when_a_diagnosis_stands(browser: Browser, shown: ShownPlant) -> None:
    shown.put(event("notice", 2.0, "before"), event("notice", 9.0, "after"))
    shown.put(snapshot(9.2, {"8": {"doubts": [{**DOUBT, "since": 3.0}]}}))
    browser.sees("▲ appears", "main .events")
    browser.open(shown.url)
    browser.sees("▲ appears", "main .events")
    browser.sees("after", "main .events")
    texts = browser.texts("main .events .text")
    assert [text for text in texts if text in ("before", "after") or LINE_BREAK in text] == [
        "after", f"▲ appears{LINE_BREAK} (rack)", "before",
    ]  # fmt: skip


def test_many_diagnoses_of_a_slave_are_few_events(browser: Browser, shown: ShownPlant) -> None:
    doubts = [{**DOUBT, "channel": n, "text": f"channel {n}"} for n in range(100)]
    shown.put(snapshot(4.0, {"8": {"doubts": doubts}}))
    browser.go("bus")
    browser.sees("92 more diagnoses (rack)", ".events")
    assert browser.count(".events .change") == 9


def test_a_diagnosis_that_flaps_does_not_drive_out_other_events(browser: Browser, shown: ShownPlant) -> None:
    """100 changes in a minute by the clock of the stream, as literal items without a server between."""
    found = browser.module(
        "const { Live } = await import('./live.js'); const live = new Live(); const slaves = { 8: { name: 'rack' } };"
        "live.apply({ plant: { started: 0, slaves } });"
        "const take = (t, doubts) => live.apply({ snapshot: { t, whole: false, bus: {}, slaves: { 8: { doubts } } } });"
        "for (let n = 0; n < 100; n += 1) take(1 + n / 2, n % 2 ? null : [given[0]]);"
        "const first = live.events.length; take(61, [given[0]]);"
        "return [first, live.events.at(-2).text, live.events.at(-1).change];",
        {**DOUBT, "since": None},
    )
    assert found == [
        40, "its diagnoses come and go; further changes of this minute are not listed (rack)", "appears",
    ]  # fmt: skip


def test_a_trace_has_no_bad_values(browser: Browser, shown: ShownPlant) -> None:
    read = "return window.dpstack.store.signals.get(arguments[0]).read(window.dpstack.live)"
    assert browser.js(read, "8.pressure") == 32.767
    _break(shown)
    browser.until_js(None, read, "8.pressure")  # NaN
    assert browser.js(read, "8.flow") == 42


# --- the watch table -------------------------------------------------------------------------------------------------


def _watch(browser: Browser, *ids: str) -> None:
    query = "&".join(urllib.parse.quote(one, safe="") for one in ids)
    browser.js("location.hash = arguments[0]", f"#/watch?{query}")
    browser.until(lambda: browser.count("table.watched tbody tr") == len(ids), "the rows")


def _row(browser: Browser, id: str) -> list[str]:
    return list(
        browser.js(
            'return [...document.querySelector(`[data-id="${arguments[0]}"]`).cells].slice(0, 5)'
            ".map((one) => one.innerText.replaceAll('\\n', ' ').trim())",
            id,
        )
    )


def test_the_watch_table_has_value_unit_quality_and_octets(browser: Browser, shown: ShownPlant) -> None:
    _watch(browser, "8.pressure", "3:speed", "8/12/input/1", "8/1/input/3", "8.none", IMAGE)
    assert _row(browser, "8.pressure") == ["rack.pressure octets 8 to 9", "32.767", "bar", "good", "7f ff"]
    assert _row(browser, "3:speed") == ["hoist: speed", "50", "%", "good", ""]
    assert _row(browser, "8/12/input/1") == [
        "rack: slot 12 (2 AI), input channel 1 octets 14 to 15", "\u2013", "", "good", "00 2a",
    ]  # fmt: skip
    assert _row(browser, "8/1/input/3")[1] == "on"
    browser.sees("This plant has no such value", "[data-id='8.none']")
    assert browser.count("main img") == 0
    _break(shown)
    browser.sees(f"bad\n{LINE_BREAK}", "[data-id='8.pressure'] td:nth-child(4)")
    assert "32.767" in _row(browser, "8.pressure")[1]
    assert _struck(browser, "[data-id='8.pressure'] .octets") == "line-through"


def test_the_choice_is_in_the_address_and_in_the_browser(browser: Browser, shown: ShownPlant) -> None:
    browser.go("watch")
    browser.click("#watch-filter")
    browser.type("rack flow")
    browser.until(lambda: browser.count(".signals label") == 1, "one value")
    browser.click(".signals input")
    browser.until(lambda: browser.count("table.watched tbody tr") == 1, "the row")
    assert browser.driver.current_url.endswith("#/watch?8.flow")
    browser.go("plant")
    browser.go("watch")
    assert browser.driver.current_url.endswith("#/watch?8.flow")
    browser.click("[data-key='remove 8.flow']")
    browser.until(lambda: browser.count("table.watched tbody tr") == 0, "no row")
    assert browser.driver.current_url.endswith("#/watch")
    browser.go("slave/8")
    browser.click(".to-watch")
    browser.until(lambda: browser.count("[data-key='tick 8.flow']"), "the values of the slave")
    assert browser.count("[data-key^='tick 3:']") == 0
    _watch(browser, *(f"8/{n}/input/0" for n in range(1, 101)))
    browser.js("window.dpstack.page.add('8.flow')")
    browser.sees("The table has 100 rows", "#said")


def test_outputs_are_set_and_inputs_of_simulated_slaves_forced(browser: Browser, shown: ShownPlant) -> None:
    _watch(browser, "8.inlet", "8.flow", "3:speed", "8/1/input/3")
    assert browser.texts("table.watched form button") == ["Set …", "Force …"]
    before = len(shown.called)
    browser.click("[data-id='8.flow'] form input")
    browser.type("12")
    browser.press("ENTER")
    browser.sees("Force 8.flow=12.", "#confirm")
    browser.click("#confirm-yes")
    browser.until(lambda: len(shown.called) == before + 1, "the order")
    browser.js("document.querySelector(\"[data-id='8.inlet'] form\").requestSubmit()")
    browser.sees("Set 8.inlet=on.", "#confirm")
    browser.click("#confirm-yes")
    browser.until(lambda: len(shown.called) == before + 2, "the order")
    browser.go("slave/8")
    browser.js("document.querySelector('details.force').open = true")
    browser.click("[data-key=release]")
    browser.sees("The simulated slave 8 makes its inputs itself again", "#confirm")
    browser.click("#confirm-yes")
    browser.until(lambda: len(shown.called) == before + 3, "the order")
    assert shown.called[before:] == [
        ("set", "now", "8.flow=12"), ("set", "now", "8.inlet=on"), ("mirror", "8"),
    ]  # fmt: skip
    shown.put(plant({"8": RACK}, virtual=False), whole(7.0, {"8": RACK_VALUES}))  # real slaves
    browser.until(lambda: not browser.count("details.force"), "no forcing")
    _watch(browser, "8.inlet", "8.flow")
    assert browser.texts("table.watched form button") == ["Set …"]
    browser.open(shown.url.partition("#")[0])  # without the secret
    browser.sees("No orders from this page", "#badges")
    _watch(browser, "8.inlet", "8.flow")
    assert browser.count("table.watched form") == 0


# --- large plants ----------------------------------------------------------------------------------------------------


def test_125_slaves_of_32_channels_stay_usable(browser: Browser) -> None:
    """4000 named values, of each slave eight are bad, and a rack of 12 modules of 32 inputs; all change with each
    snapshot."""
    names = [f"value {n}" for n in range(32)]
    modules = [_module(n + 1, "4 AI", "43", inputs=8, input_at=8 * n, input_width=16) for n in range(8)]
    fields = [{"name": name, "type": "i16", "at": f"i16@{2 * n}", "unit": "bar"} for n, name in enumerate(names)]
    addresses = range(1, 126)
    slaves = {
        str(one): slave_of(f"station {one}", one, modules=modules, inputs=fields, input_len=64) for one in addresses
    }

    def values(n: int) -> dict[str, Any]:
        return {"inputs": f"{n:04x}" * 32, "fields": dict.fromkeys(names, n)}

    broken = {"qualities": {names[n]: BAD for n in range(8)}, "doubts": [{**DOUBT, "slot": 2, "channel": 1}]}
    large = [_module(n + 1, "32 DI", "13", inputs=4, input_at=4 * n, input_width=1) for n in range(12)]
    bits = [{"name": f"bit {n}", "type": "bool", "at": f"bool@{n // 8}.{n % 8}"} for n in range(384)]
    slaves["61"] = slave_of("large", 61, modules=large, inputs=bits, input_len=48)
    shown = ShownPlant()
    shown.put(plant(slaves), whole(0.1, {str(one): values_of(**values(1), **broken) for one in addresses}))
    browser.window(1280)
    browser.open(shown.url)
    browser.sees("125", ".tiles")
    t = 1.0
    figures = {}
    try:
        for route in ("plant", "slave/60", "slave/61", "watch"):
            begun = browser.js("return performance.now()")
            browser.go(route)
            if route == "watch":
                _watch(browser, *(f"{one}.value 7" for one in range(1, 101)))
            figures[f"{route}: built"] = browser.js("return performance.now() - arguments[0]", begun)
            painted = []
            for n in range(2, 12):
                t = round(t + 0.2, 3)
                large_values = {"inputs": f"{n:02x}" * 48, "fields": {one["name"]: n % 2 == 1 for one in bits}}
                all_values = {str(one): values(n) for one in addresses} | {"61": large_values}
                shown.put(snapshot(t, all_values))
                browser.until_js(t, "return window.dpstack.live.t")
                browser.until(lambda: not browser.js("return window.dpstack.pending"), "painted")
                painted.append(browser.js("return window.dpstack.paintMs"))
            figures[f"{route}: painted"] = sorted(painted)[5]
            wanted = {
                "plant": "#row-1",
                "slave/60": ".rack",
                "slave/61": "[data-slot='12'] .value",
                "watch": "table.watched",
            }[route]
            browser.sees("on" if route == "slave/61" else "11", wanted)
        assert all(ms < 100 for key, ms in figures.items() if key.endswith("painted")), figures
    finally:
        browser.open("about:blank")
        shown.close()
