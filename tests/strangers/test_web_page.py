"""The page of ``dpstack web`` in chromium over literal items: hostile texts, old values, orders, keyboard, looks."""

from __future__ import annotations

import csv
import io
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from datetime import datetime
from itertools import pairwise
from typing import Any, Final

import pytest

from dpstack.devices import finding
from dpstack.profile.model.states import State
from tests.strangers.browser_kit import Browser
from tests.strangers.shown_plant import (
    EMOJI,
    IMAGE,
    LONG,
    SCRIPT,
    SECRET,
    STARTED,
    TURNED,
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
from tests.strangers.stranger_kit import HANGS_S

pytestmark = pytest.mark.strangers

PAGES: Final = ("plant", "scope", "bus", "commissioning", "watch", "slave/3", "slave/8", "slave/14", "slave/12")
EVENTS: Final = (
    event("fault", 0.05, f"slave 12: {IMAGE}", address=12, name=SCRIPT, severity="error"),
    event("diagnosis", 0.06, "diagnosis", address=12, name=SCRIPT, flags=["ext_diag"], texts=[IMAGE, LONG]),
    event("notice", 0.07, f"{TURNED} {SCRIPT}", severity="warning"),
)


@pytest.fixture
def shown(browser: Browser) -> Iterator[ShownPlant]:
    """A run with orders allowed, and a page that is open and alive."""
    shown = ShownPlant(control=True)
    shown.show(EVENTS)
    beating = Beating(shown)
    browser.window(1280)
    browser.open(shown.url)
    browser.sees("Live", "#live")
    yield shown
    beating.stop()
    browser.open("about:blank")
    shown.close()
    assert [line for line in browser.console() if "WebSocket" not in line] == []


def test_texts_from_outside_are_never_markup(browser: Browser, shown: ShownPlant) -> None:
    for page in PAGES:
        browser.go(page)
        for button in ("Ask why", "Read record", "Read I&M", "Read the device"):
            browser.js(
                "[...document.querySelectorAll('button')].find((one) => one.textContent === arguments[0])?.click()",
                button,
            )
        assert browser.count("script") == 1  # that of the page itself
        assert browser.count("img, iframe, object, embed, style, [style*=url], [onerror]") == 0
    browser.sees("module_order (92 %)")
    browser.sees(f"the slave says {SCRIPT}")
    browser.sees(f"Order id\n{IMAGE}")
    browser.sees(f"it says {SCRIPT}")
    browser.sees(f"maker: {SCRIPT}")
    browser.sees(f"7 {SCRIPT}")
    assert SCRIPT in browser.text("h1")
    browser.go("plant")
    browser.sees(f"module 3: {IMAGE}", "#row-12")
    browser.sees(SCRIPT, "#row-12")
    browser.sees(EMOJI, "#row-14")
    browser.go("bus")
    browser.sees("\\u202etxt.exe", ".events")
    assert "\u202e" not in browser.text("body")
    browser.go("scope")
    browser.sees(f"valves.{IMAGE}", ".signals")
    assert browser.js("return typeof window.alerted") == "undefined"


@pytest.mark.parametrize("page", PAGES)
def test_390_pixels_are_enough(browser: Browser, shown: ShownPlant, page: str) -> None:
    browser.window(390, 844)
    browser.go(page)
    browser.until(lambda: browser.js("return innerWidth") == 390)
    assert browser.js("return document.documentElement.scrollWidth") == 390
    wide = browser.js(
        "return [...document.querySelectorAll('main *')].filter((one) => !one.closest('.scroll, svg, .u-wrap, pre')"
        " && !one.closest('.visually-hidden') && one.getBoundingClientRect().right > innerWidth + 0.5)"
        ".filter((one) => { for (let up = one.parentElement; up; up = up.parentElement)"
        " if (getComputedStyle(up).overflowX !== 'visible') return false; return true; })"
        ".map((one) => one.tagName + '.' + one.className)"
    )
    assert wide == []


@pytest.mark.parametrize("dark", [False, True])
def test_every_text_has_enough_contrast(browser: Browser, shown: ShownPlant, dark: bool) -> None:
    """WCAG 2.2, 1.4.3: 4.5 to 1, and 3 to 1 for large texts."""
    browser.window(1280, dark=dark)
    poor = []
    for page in PAGES:
        browser.go(page)
        browser.js("for (const one of document.querySelectorAll('details')) one.open = true")
        seen = browser.seen_texts()
        assert len(seen) > 20
        for text, colour, behind, size, weight in seen:
            ratio = _contrast(colour, behind)
            large = size >= 24 or (size >= 18.66 and weight >= 700)
            if ratio < (3.0 if large else 4.5):
                poor.append((page, text, round(ratio, 2)))
    assert poor == []


@pytest.mark.parametrize("dark", [False, True])
def test_controls_and_marks_have_enough_contrast(browser: Browser, shown: ShownPlant, dark: bool) -> None:
    """WCAG 2.2, 1.4.11: 3 to 1 for what a control or a mark is recognised by."""
    browser.window(1280, dark=dark)
    names = ("control", "accent", "good", "busy", "warn", "bad", "off", *(f"trace-{n}" for n in range(8)))
    for name in names:
        for ground in ("card", "paper"):
            pair = [_variable(browser, one) for one in (name, ground)]
            assert _contrast(pair[0], [pair[1]]) >= 3.0, (name, ground)


def _variable(browser: Browser, name: str) -> str:
    return str(
        browser.js(
            "const one = document.createElement('i'); one.style.color = `var(--${arguments[0]})`;"
            "document.body.append(one);"
            "const found = getComputedStyle(one).color; one.remove(); return found;",
            name,
        )
    )


def _contrast(colour: str, behind: list[str] | tuple[str, ...] | Any) -> float:
    """The ratio of WCAG for a text of ``colour`` on the first opaque one of ``behind``, the others laid over it."""
    layers: list[tuple[float, ...]] = []
    for one in behind:
        layers.append(_rgba(one))
        if layers[-1][3] == 1:
            break
    ground: tuple[float, ...] = (255, 255, 255, 1)
    for layer in reversed([*layers]):
        ground = _over(layer, ground)
    light, dim = sorted((_luminance(_over(_rgba(colour), ground)), _luminance(ground)), reverse=True)
    return (light + 0.05) / (dim + 0.05)


def _rgba(text: str) -> tuple[float, ...]:
    numbers = [float(one) for one in re.findall(r"[\d.]+", text)]
    assert text.startswith("rgb"), text
    return (*numbers[:3], numbers[3] if len(numbers) > 3 else 1.0)


def _over(above: tuple[float, ...], below: tuple[float, ...]) -> tuple[float, ...]:
    part = above[3]
    return (*(part * a + (1 - part) * b for a, b in zip(above[:3], below[:3], strict=True)), 1.0)


def _luminance(colour: tuple[float, ...]) -> float:
    linear = [c / 12.92 if (c := one / 255) <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for one in colour[:3]]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


# --- nothing dead is shown as alive ----------------------------------------------------------------------------------


def test_without_snapshots_the_page_says_that_its_values_are_old(browser: Browser) -> None:
    shown = ShownPlant(control=True)
    try:
        shown.show()
        browser.open(shown.url)
        browser.sees("Live", "#live")
        assert browser.count("#orders button:not(:disabled)") > 0
        browser.sees("The server has sent no values for more than 2 s", "#banner")
        browser.sees("Old values", "#live")
        assert browser.count("body.dead") == 1
        assert browser.js("return getComputedStyle(document.querySelector('#row-8 .figure')).textDecorationLine") == (
            "line-through"
        )
        assert browser.count("#orders button") == browser.count("#orders button:disabled")
        shown.put(snapshot(5.0, {}))
        browser.sees("Live", "#live")
        assert browser.text("#banner") == ""
        shown.put(snapshot(5.2, {}, stale=True))
        browser.sees("stale", "#banner")
        shown.put(snapshot(5.4, {}, stale=False), {"end": {"text": "closed by Ctrl-C"}})
        browser.sees("The program has ended: closed by Ctrl-C", "#banner")
        shown.put(plant(), whole(0.1))  # the next run
        browser.sees("Live", "#live")
        browser.go("slave/8")
        browser.sees("Inputs are valid")
        shown.put({"end": {"text": "killed"}})
        browser.sees("These inputs are old")
    finally:
        shown.close()
    browser.until(lambda: browser.text("#banner"), "a banner")
    browser.until(lambda: browser.count("body.dead"))
    browser.open("about:blank")


def test_old_and_invalid_inputs_are_marked(browser: Browser, shown: ShownPlant) -> None:
    browser.sees("12.5", "#row-8")
    assert browser.count("#row-8 .old") == 0
    shown.put(snapshot(3.0, {"8": {"state": "offline", "inputs_valid": False, "inputs_age_ms": 900.0}}))
    browser.sees("Offline", "#row-8")
    browser.sees("inputs not valid", "#row-8")
    assert browser.count("#row-8 .values.old") == 1
    browser.go("slave/8")
    browser.sees("Inputs are not valid; the last ones are 900 ms old")


@pytest.mark.parametrize(("kind", "words"), [("replay", "Replay of a recording"), ("read-only", "Read-only")])
def test_a_replay_and_a_bus_that_is_only_read_are_marked(browser: Browser, kind: Any, words: str) -> None:
    shown = ShownPlant(kind=kind, control=kind == "replay")
    shown.put(plant(read_only=kind == "read-only"), whole())
    browser.open(shown.url)
    browser.sees(words, "#badges")
    assert browser.count("#orders button") == 0
    browser.go("slave/8")
    assert browser.count(".orders-box button, .drive-orders button") == 0
    browser.open("about:blank")
    shown.close()


def test_a_new_configuration_of_the_running_bus_is_shown_at_once(browser: Browser, shown: ShownPlant) -> None:
    shown.put(
        plant({"8": slave_of("valves", 8), "21": slave_of("mixer", 21)}),
        whole(4.0, {"8": values_of(), "21": values_of()}),
    )
    browser.sees("mixer", "#row-21")
    assert browser.count("tbody tr[data-address]") == 2


def test_other_masters_stand_on_the_line(browser: Browser, shown: ShownPlant) -> None:
    assert browser.count(".line .master.other") == 0
    shown.put(snapshot(3.0, {}, masters=[2, 5, 40]))
    browser.until(lambda: browser.count(".line .master.other") == 2, "two masters")
    on_the_line = browser.js(
        "return [...document.querySelectorAll('.line .number')].map((one) => Number(one.textContent))"
    )
    assert on_the_line == [2, 3, 4, 5, 8, 12, 13, 14, 15, 40]


# --- orders ----------------------------------------------------------------------------------------------------------


def test_the_secret_leaves_the_address_bar_and_orders_need_a_confirmation(browser: Browser, shown: ShownPlant) -> None:
    assert SECRET not in browser.driver.current_url
    assert SECRET not in browser.js("return JSON.stringify([history.state, document.cookie, {...localStorage}])")
    before = len(shown.called)
    browser.click("#orders [data-key=clear]")
    browser.sees("The master sends safe values to all 7 slaves", "#confirm")
    browser.press("ENTER")  # the focus is on Cancel
    browser.until(lambda: not browser.count("dialog[open]"))
    browser.click("#orders [data-key=clear]")
    browser.press("ESCAPE")
    browser.until(lambda: not browser.count("dialog[open]"))
    assert shown.called[before:] == []
    browser.click("#orders [data-key=clear]")
    browser.click("#confirm-yes")
    browser.sees("Clear: done.", "#said")
    assert shown.called[before:] == [("clear",)]
    browser.go("slave/8")
    browser.click(".orders-box form button")
    browser.sees("Set 8.limit=on.", "#confirm")
    browser.click("#confirm-yes")
    browser.sees("done", "#said")
    browser.go("slave/3")
    browser.click(".drive-orders [data-key=speed-input]")
    browser.type("12,5")
    browser.press("ENTER")
    browser.sees("The set point of hoist becomes 12.5% of the reference", "#confirm")
    browser.click("#confirm-yes")
    browser.until(lambda: len(shown.called) == before + 3)
    assert shown.called[before + 1 :] == [("set", "now", "8.limit=on"), ("drive", "now", "hoist", "speed", "12.5%")]


def test_without_the_secret_there_are_no_orders(browser: Browser, shown: ShownPlant) -> None:
    browser.open(shown.url.partition("#")[0])
    browser.sees("Live", "#live")
    browser.sees("No orders from this page", "#badges")
    assert browser.count("#orders button") == 0
    browser.js("location.hash = arguments[0]", SECRET)  # the whole address, put into the open page
    browser.until(lambda: browser.count("#orders button"), "orders")
    assert SECRET not in browser.driver.current_url


def test_a_token_is_asked_for_and_kept_out_of_the_address(browser: Browser) -> None:
    shown = ShownPlant(tokens={"0123456789abcdef": "anna"})
    shown.show()
    browser.open(shown.url)
    browser.sees("a token is needed", "#token")
    browser.type("not the right token")
    browser.press("ENTER")
    browser.sees("the token is wrong", "#token")
    browser.until(lambda: browser.js("return document.activeElement.id") == "token-input")
    browser.type("0123456789abcdef")
    browser.press("ENTER")
    browser.sees("Token: anna", "#badges")
    assert browser.count("dialog[open]") == 0
    assert "0123456789" not in browser.driver.current_url
    browser.open("about:blank")
    shown.close()


# --- keyboard and structure ------------------------------------------------------------------------------------------


def test_a_keyboard_is_enough(browser: Browser, shown: ShownPlant) -> None:
    browser.press("TAB")
    assert browser.js("return document.activeElement.className") == "skip"
    for page in ("plant", "scope", "bus", "commissioning", "watch", "slave/8"):
        browser.go(page)
        wanted = browser.js(
            "return [...document.querySelectorAll('a[href], button, input, select, textarea, summary, [tabindex]')]"
            ".filter((one) => !one.disabled && one.tabIndex >= 0 && one.checkVisibility()"
            " && !one.closest('dialog')).length"
        )
        browser.js("document.activeElement.blur(); window.reached = new Set(); document.querySelector('.skip').focus()")
        for _ in range(wanted):
            browser.js("window.reached.add(document.activeElement)")
            outline = browser.js(
                "const one = document.activeElement;"
                "const shown = one.closest('svg') ? one.querySelector('rect') : one;"
                "const style = getComputedStyle(shown); return [style.outlineStyle, style.strokeWidth, one.className]"
            )
            assert outline[0] != "none" or outline[1] == "3px", outline
            browser.press("TAB")
        assert browser.js("return window.reached.size") == wanted, page
    browser.js("document.activeElement.blur()")
    for key, page in (("o", "scope"), ("w", "watch"), ("b", "bus"), ("c", "commissioning"), ("p", "plant")):
        browser.press(key)
        browser.until_js(f"{page}/", "return window.dpstack.path")
    browser.press("/")
    browser.type("12")
    browser.until(lambda: browser.count("table.plant tbody tr:not([hidden])") == 1)
    browser.press("TAB", "?")
    browser.sees("keys of one letter are on", "#help")
    browser.press("ESCAPE")
    browser.go("slave/3")
    browser.press("j")
    browser.sees("fan", "h1")


def test_structure_for_screen_readers(browser: Browser, shown: ShownPlant) -> None:
    assert browser.js("return document.documentElement.lang") == "en"
    for page in PAGES:
        browser.go(page)
        assert browser.count("h1") == 1
        assert browser.count("main") == browser.count("header.top") == browser.count("nav[aria-label]") == 1
        levels = browser.js(
            "return [...document.querySelectorAll('main :is(h1,h2,h3,h4)')].map((one) => Number(one.tagName[1]))"
        )
        assert all(after <= before + 1 for before, after in pairwise(levels)), (page, levels)
        unnamed = browser.js(
            "return [...document.querySelectorAll('input, select, textarea')].filter((one) => !one.closest('dialog')"
            " && !one.labels?.length && !one.getAttribute('aria-label')).map((one) => one.outerHTML)"
        )
        assert unnamed == []
        assert browser.count("button:empty") == 0
        doubled = browser.js(
            "const ids = [...document.querySelectorAll('[id]')].map((one) => one.id);"
            "return ids.filter((one, n) => ids.indexOf(one) !== n)"
        )
        assert doubled == []
    assert browser.js("return document.querySelector('#banner').getAttribute('role')") == "alert"


def test_less_motion_where_it_is_wanted(browser: Browser, shown: ShownPlant) -> None:
    browser.window(1280, calm=True)
    moving = browser.js(
        "return [...document.querySelectorAll('*')].filter((one) => { const style = getComputedStyle(one);"
        " return style.animationName !== 'none' || parseFloat(style.transitionDuration) > 0; }).length"
    )
    assert moving == 0


def test_everything_comes_from_this_server(browser: Browser, shown: ShownPlant) -> None:
    for page in PAGES:
        browser.go(page)
    origins = browser.js(
        "return [...new Set(performance.getEntriesByType('resource').map((one) => new URL(one.name).origin))]"
    )
    assert origins == [shown.url.partition("/#")[0]]


# --- the oscilloscope ------------------------------------------------------------------------------------------------


def _choose(browser: Browser, *labels: str) -> None:
    browser.js(
        "const all = () => [...document.querySelectorAll('.signals label')];"
        "const name = (one) => one.querySelector('bdi').textContent;"
        "for (const label of all().map(name)) {"
        " const box = all().find((one) => name(one) === label).querySelector('input');"
        " if (box.checked !== arguments[0].includes(label)) box.click(); }",
        labels,
    )


def test_a_trigger_holds_the_picture_and_csv_has_its_samples(browser: Browser) -> None:
    shown = ShownPlant()
    shown.show()
    browser.open(shown.url)
    browser.sees("Live", "#live")
    browser.go("scope")
    _choose(browser, "valves.level", "hoist: speed")
    browser.js("const one = document.querySelector('#window'); one.value = '5'; one.dispatchEvent(new Event('change'))")
    browser.js("const one = document.querySelector('#trigger-source'); one.value = '8.level'")
    browser.js("document.querySelector('#trigger-level').value = '20'")
    browser.click("#arm")
    browser.sees("trigger armed", ".status")
    levels = [12.5, 12.5, 19.0, 21.0, *range(22, 44)]
    for n, level in enumerate(levels):
        t = round(1.0 + n * 0.2, 3)
        shown.put(
            snapshot(t, {"8": {"fields": {"level": level, "limit": False}}, "3": {"drive": drive_of(speed=n / 1000)}})
        )
        browser.until_js(t, "return window.dpstack.live.t")
    browser.sees("Picture of", ".status")
    hold = browser.js("return window.dpstack.scope.hold")
    assert hold["trigger"] == 1.6  # the first sample at or above 20
    assert (hold["from"], hold["to"]) == (pytest.approx(0.1), pytest.approx(5.1))
    browser.click("#csv")
    browser.until(lambda: list(browser.downloads.glob("*.csv")), "a file")
    found = next(iter(browser.downloads.glob("*.csv")))
    head, *rows = csv.reader(io.StringIO(found.read_text(encoding="utf-8")))
    assert head == ["time", "t_s", "hoist: speed [%]", "valves.level [bar]"]
    assert [(float(row[1]), row[3]) for row in rows[:5]] == [
        (0.1, "12.5"), (1.0, "12.5"), (1.2, "12.5"), (1.4, "19"), (1.6, "21"),
    ]  # fmt: skip
    assert float(rows[4][2]) == pytest.approx(0.3)
    assert datetime.fromisoformat(rows[0][0]).timestamp() == pytest.approx(STARTED + 0.1)
    browser.open("about:blank")
    shown.close()
    assert browser.console() == []


def test_a_trigger_on_an_event(browser: Browser, shown: ShownPlant) -> None:
    browser.go("scope")
    browser.js(
        "const one = document.querySelector('#trigger-kind'); one.value = 'event';"
        "one.dispatchEvent(new Event('change'));"
        "document.querySelector('#trigger-event').value = 'alarm';"
        "const two = document.querySelector('#window'); two.value = '5'; two.dispatchEvent(new Event('change'))"
    )
    browser.click("#arm")
    now = browser.js("return window.dpstack.live.t")
    shown.put(event("diagnosis", now, "no alarm"), event("alarm", now + 0.05, "an alarm", address=8))
    browser.sees("Picture of", ".status")
    assert browser.js("return window.dpstack.scope.hold.trigger") == pytest.approx(now + 0.05)


@pytest.mark.parametrize(
    ("kind", "values", "at"),
    [
        ("rising", [1, 3, 5, 7], 2), ("rising", [6, 7, 4, 5], 3), ("rising", [4, None, 6, 7], None),
        ("falling", [6, 5, 4], 1),
        ("falling", [4, 3, 2], None), ("above", [1, 5, 6], 2), ("below", [9, 4], 1), ("rising", [5, 5, 5], None),
    ],
)  # fmt: skip
def test_edges_and_levels(browser: Browser, shown: ShownPlant, kind: str, values: list[Any], at: int | None) -> None:
    found = browser.module(
        "const { Trigger } = await import('./scope_data.js');"
        "const trigger = new Trigger({ kind: given[0], id: 'x', level: 5 });"
        "given[1].forEach((one, n) => trigger.sample(n, one)); return trigger.at;",
        kind,
        values,
    )
    assert found == at


def test_a_snapshot_in_portions_is_one_sample(browser: Browser, shown: ShownPlant) -> None:
    found = browser.module(
        "const { Store } = await import('./scope_data.js'); const store = new Store(); let n = 0;"
        "store.signals = new Map([['x', { id: 'x', read: () => n }]]); store.keep('x');"
        "for (const t of [1, 1, 2]) { n += 1; store.sample({ t }); }"
        "return [store.times, store.signals.get('x').values];"
    )
    assert found == [[1, 2], [2, 3]]


def test_rounds_stand_between_the_snapshots(browser: Browser, shown: ShownPlant) -> None:
    """Snapshots before and after the rounds; a drive's speed in percent; a gap where rounds are missing."""
    found = browser.module(
        "const { Store } = await import('./scope_data.js'); const store = new Store(); store.times = [1, 2, 3, 4];"
        "const signal = (id, values, rounds) => store.signals.set(id, { id, values, rounds });"
        "signal('8.level', [10, 20, 30, 40], 1); signal('3:speed', [50, 50, 50, 50], 100);"
        "signal('8:retries', [0, 1, 2, 3]);"
        "const rounds = store.follow(['8.level', '3:speed']);"
        "store.takeRounds(rounds, { rounds: [[7, 2.1, 21, 0.5], [8, 2.2, true, null]], lost: 0 });"
        "store.takeRounds(rounds, { rounds: [[12, 3.2, 32, 0.25]], lost: 3 });"
        "const all = store.slice(['8.level', '8:retries', '3:speed'], 0, 5);"
        "return [all, rounds.lost, rounds.after, store.follow(['8.level', '3:speed']) === rounds,"
        " store.slice(['8:retries'], 0, 5)];"
    )
    merged, lost, after, same, other = found
    assert merged == [
        [1, 2, 2.1, 2.2, pytest.approx(2.7), 3.2, 4],
        [10, 20, 21, 1, None, 32, 40],
        [0, 1, 1, 1, 1, 2, 3],
        [50, 50, 50, None, None, 25, 50],
    ]
    assert (lost, after, same) == (3, 12, True)
    assert other == [[1, 2, 3, 4], [0, 1, 2, 3]]


def test_csv_has_no_formulas(browser: Browser, shown: ShownPlant) -> None:
    found = browser.module(
        "const { csvField } = await import('./scope_data.js'); return given[0].map(csvField);",
        ["=1+1", "@x", "a,b", 'a"b', "plain", "-x", "a\nb"],
    )
    assert found == ["'=1+1", "'@x", '"a,b"', '"a""b"', "plain", "'-x", '"a\nb"']


# --- the rest --------------------------------------------------------------------------------------------------------


def test_times_between_two_histograms(browser: Browser, shown: ShownPlant) -> None:
    """Independent end: counts made by hand; the classes move when a longer rotation comes."""
    found = browser.module(
        "const { added, quantile } = await import('./rotation.js');"
        "const two = added([[10, 5], [20, 1]], [[10, 8], [20, 1], [30, 1]]);"
        "return [two, quantile(two, 0.5), quantile(two, 0.99), added([[10, 5], [12, 2]], [[15, 9], [40, 1]])];"
    )
    assert found == [[[10, 3], [30, 1]], 10, 30, [[15, 2], [40, 1]]]


@pytest.fixture(scope="module")
def states_told() -> dict[str, set[str]]:
    """The states that each simulated drive of the demo went through, by profile."""
    done = subprocess.run(
        [sys.executable, "-m", "dpstack.cli.main", "demo", "--fast", "--json", "--seconds", "20"],
        capture_output=True, text=True, check=True, timeout=HANGS_S,
    )  # fmt: skip
    kinds = {"demag": "demag-dedrive", "fuji": "fuji-frenic", "imo": "imo-hd2", "keb": "keb-f5", "ls": "ls-s100"}
    told: dict[str, set[str]] = {kind: set() for kind in kinds.values()}
    for line in map(json.loads, done.stdout.splitlines()):
        if line["event"] == "drive" and "state" in line:
            told[kinds[line["name"]]].add(line["state"])
    return told


@pytest.mark.parametrize("profile", ["demag-dedrive", "fuji-frenic", "imo-hd2", "keb-f5", "ls-s100"])
def test_each_state_of_a_drive_has_its_place_in_the_picture(
    browser: Browser, shown: ShownPlant, states_told: dict[str, set[str]], profile: str
) -> None:
    """Those that the demo goes through, and those that the table of its status word has."""
    core = finding.known()[profile].core("x", simulated=True)
    told = states_told[profile] | {row.state.value for row in core.table.states.rows}
    assert "running" in told
    drawn = browser.module(
        "const { MACHINES, familyOf } = await import('./marks.js');"
        "return Object.keys(MACHINES[familyOf(given[0])].at);",
        profile,
    )
    assert told - {"offline", "unknown"} <= set(drawn)
    assert set(drawn) <= {state.value for state in State}


def test_125_slaves_with_244_octets_each(browser: Browser) -> None:
    """A snapshot paints the rows in the window and eight others: that bounds its work."""
    addresses = range(1, 126)
    slaves = {str(one): slave_of(f"station {one}", one, input_len=244, output_len=244) for one in addresses}
    shown = ShownPlant()
    shown.put(
        plant(slaves), whole(0.1, {str(one): values_of(inputs="00" * 244, outputs="00" * 244) for one in addresses})
    )
    browser.window(1280)
    browser.open(shown.url)
    browser.sees("125 of 125", ".tiles")
    browser.until(lambda: browser.js("return window.dpstack.page.visible.size") > 0)
    browser.js(
        "window.touched = new Set(); new MutationObserver((all) => { for (const one of all) {"
        " const row = (one.target.closest ? one.target : one.target.parentElement).closest('tr');"
        " if (row) window.touched.add(row.id); } })"
        ".observe(document.querySelector('table.plant tbody'), { subtree: true, childList: true, characterData: true })"
    )
    browser.js(
        "const { page } = window.dpstack; const { update } = page; window.updates = 0;"
        "page.update = (...given) => { window.updates += 1; update.apply(page, given); }"
    )
    shown.put(snapshot(1.0, {str(one): {"inputs": f"{one:02x}" * 244, "retries": one} for one in addresses}))
    browser.until(lambda: browser.js("return window.touched.size") > 0)
    in_window = browser.js("return [...window.dpstack.page.visible].map((one) => `row-${one}`)")
    touched, updates = browser.js("return [[...window.touched], window.updates]")
    assert len(set(touched) - set(in_window)) <= 8 * updates
    assert updates <= 3  # the snapshot, and whether the page is alive
    assert len(in_window) < 60
    browser.js("document.querySelector('#row-125').scrollIntoView()")
    browser.until(lambda: "7d 7d 7d" in browser.text("#row-125"), "the last row")
    browser.open("about:blank")
    shown.close()
