"""The page of ``dpstack web`` in chromium over simulated slaves: it shows what ``run --json`` says, and faults at once.

With DPSTACK_PICTURES=docs/pictures the pictures of the pages are written there.
"""

from __future__ import annotations

import contextlib
import json
import signal
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from pictures_kit import PLANT, copy_plant, picture_folder, shows_no_place
from programs import Starter

from dpstack.api.control.client import connect
from tests.strangers.browser_kit import Browser

pytestmark = pytest.mark.strangers

#: of rotations and exchanges: they go on while one looks
_MOVING: Final = ("exchanges", "telegrams")


class Plant:
    """A run of the simulated plant, the web server that has joined it, and commands to it."""

    def __init__(self, start: Starter, folder: Path, *options: str) -> None:
        self.start = start
        self.file = copy_plant(folder)
        with contextlib.chdir(folder):  # what the page shows of the file is its name
            self.run = start("run", self.file.name, "--json")
            self.run.wait_for_slaves(6)
            self.name = f"virtual:{self.run.process.pid}"
            self.web = start("web", self.file.name, "--json", "--listen", "127.0.0.1:0", *options)
        self.web.wait_for('"listening"')
        self.url = str(next(line["url"] for line in self.web.lines if line["event"] == "listening"))

    def ctl(self, *args: str) -> None:
        """``dpstack ctl`` as a program of its own, to its end."""
        done = self.start("ctl", self.name, *args)
        assert done.end() == 0, done.err

    def call(self, command: str, *args: str) -> Any:
        with connect(self.name) as client:
            return client.call(command, *args)


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Starter]:
    starter = Starter(tmp_path_factory.mktemp("programs"))
    yield starter
    starter.close()


@pytest.fixture(scope="module")
def plant(start: Starter, tmp_path_factory: pytest.TempPathFactory) -> Plant:
    return Plant(start, tmp_path_factory.mktemp("plant"), "--control")


@pytest.fixture
def page(browser: Browser, plant: Plant) -> Iterator[Browser]:
    browser.window(1280)
    browser.open(plant.url)
    browser.sees("Live", "#live")
    yield browser
    assert browser.console() == []


def _number(text: str) -> float:
    return float(text.replace("\u202f", "").replace("\u2212", "-").replace("%", "").split()[0])


def _pairs(browser: Browser, css: str) -> dict[str, str]:
    found = browser.js(
        "return [...document.querySelectorAll(`${arguments[0]} dl > div`)].map((one) =>"
        " [one.querySelector('dt').innerText, one.querySelector('dd').innerText])",
        css,
    )
    return {str(term): str(text) for term, text in found}


# --- the same as run --json ------------------------------------------------------------------------------------------


def test_the_plant_is_that_of_run_json(page: Browser, plant: Plant) -> None:
    """States, named values and octets of all slaves; values that move are compared once they stand still."""
    plant.call("set", "valves.full=on", "valves.pressure=4.25", "valves.inlet=on")
    page.sees("4.25", "#row-8")
    stats = plant.call("stats")
    slaves = stats["slaves"]
    assert [int(text.split()[0]) for text in page.texts("table.plant tbody th")] == [int(one) for one in slaves]
    for address, slave in slaves.items():
        row = f"#row-{address}"
        assert slave["state"] == "data_exchange"
        page.sees("Data exchange", row)
        page.sees(slave["name"], row)
        assert _number(page.text(f"{row} td.n")) == slave["retries"]
        if "fields" not in slave and "drive" not in slave:
            shown = [text.replace(" ", "") for text in page.texts(f"{row} code")]
            assert shown == [slave["inputs"], slave["outputs"]]
    values = _pairs(page, "#row-8")
    fields = slaves["8"]["fields"]
    assert set(values) == set(fields)
    for name, value in fields.items():
        wanted = {True: "on", False: "off"}.get(value) if isinstance(value, bool) else None
        if wanted is None:
            assert _number(values[name]) == pytest.approx(value)
            assert values[name].endswith("bar")
        else:
            assert values[name] == wanted


def test_the_counters_are_those_of_run_json(page: Browser, plant: Plant) -> None:
    """Counters go on while one looks: the page lies between what the run said before and says afterwards."""
    for address in ("3", "8"):
        page.go(f"slave/{address}")
        before = plant.call("stats")["slaves"][address]
        shown = _counters_after(page, before["exchanges"])
        after = plant.call("stats")["slaves"][address]
        for name in ("exchanges", "telegrams", "retries", "timeouts", "late", "wrong"):
            assert before[name] <= shown[name.capitalize()] <= after[name], name
        assert _pairs(page, "[aria-labelledby=h-counters]")["Watchdog"] == f"{after['watchdog_ms']} ms"


def _counters_after(browser: Browser, exchanges: int) -> dict[str, float]:
    browser.until(lambda: _counters(browser)["Exchanges"] > exchanges, "more exchanges")
    return _counters(browser)


def _counters(browser: Browser) -> dict[str, float]:
    found = _pairs(browser, "[aria-labelledby=h-counters]")
    return {name: _number(text) for name, text in found.items() if name not in ("Watchdog", "Master")}


def test_a_drive_is_shown_as_its_status_is(page: Browser, plant: Plant) -> None:
    plant.call("drive", "fan", "speed", "40%")
    plant.call("drive", "fan", "start")
    plant.call("drive", "fan", "reached")
    drawn = "return [...document.querySelectorAll(`${arguments[0]} .now text`)].map((one) => one.textContent)"
    card = "article.drive[data-address='4']"
    page.until(lambda: _pairs(page, card).get("At set point") == "yes", "the set point")
    page.until(lambda: page.js(drawn, card) == ["Running"], "the state in the picture")
    status = plant.call("drive", "fan", "status")["status"]
    shown = _pairs(page, card)
    assert _number(page.text(f"{card} .speed .figure")) == pytest.approx(status["speed"] * 100, abs=0.1)
    assert _number(shown["Set point"]) == pytest.approx(status["setpoint"] * 100)
    assert _number(shown["Frequency"]) == pytest.approx(status["frequency_hz"], abs=0.01)
    plant.call("drive", "fan", "stop")
    page.until(lambda: page.js(drawn, card) not in (["Running"], ["Stopping"]), "standstill")


def test_the_bus_is_that_of_run_json(page: Browser, plant: Plant) -> None:
    page.go("bus")
    before = plant.call("stats")
    page.until(lambda: _tile(page, "Rotations") > before["rotations"], "more rotations")
    shown = _tile(page, "Rotations")
    after = plant.call("stats")
    assert before["rotations"] <= shown <= after["rotations"]
    measured = _column(page, "Rotation time", 2)
    assert measured["Shortest"] == pytest.approx(after["rotation_us"]["min"], rel=1e-3)
    assert before["rotation_us"]["max"] <= measured["Longest"] * 1.001
    assert measured["Longest"] <= after["rotation_us"]["max"] * 1.001
    plan = plant.start("plan", str(plant.file), "--json")
    assert plan.end() in (0, 1)
    planned = json.loads(plan.out)["rotation_us"]
    columns = _column(page, "Rotation time", 1)
    for name, key in (("Shortest", "min"), ("Typical, median", "typical"), ("Longest", "max")):
        assert columns[name] == pytest.approx(planned[key], rel=1e-3)
    page.until(lambda: page.count(".histogram .column"), "the histogram")
    page.until(lambda: page.js("return window.dpstack.rotation.columns.length") > 1, "rotations over time")


def _tile(browser: Browser, name: str) -> float:
    return _number(_pairs(browser, "main")[name])


def _column(browser: Browser, caption: str, number: int) -> dict[str, float]:
    """A column of the table with that caption, in us."""
    rows = browser.js(
        "const table = [...document.querySelectorAll('table')].find((one) => one.caption?.innerText === arguments[0]);"
        "return [...table.tBodies[0].rows].map((row) => [row.cells[0].innerText, row.cells[arguments[1]].innerText])",
        caption,
        number,
    )
    scale = {"µs": 1.0, "ms": 1e3, "s": 1e6}
    return {name: float(text.split()[0]) * scale[text.split()[1]] for name, text in rows if text}


# --- faults ----------------------------------------------------------------------------------------------------------


def test_a_fault_made_with_ctl_is_on_the_page(page: Browser, plant: Plant) -> None:
    """The row changes by itself, and the run has told of the fault. A busy computer may take its time."""
    for address, code, shown in ((3, "F2100", "F2100"), (4, "OC1", "without a name")):
        plant.ctl("trip", str(address), code)
        page.sees(shown, f"#row-{address}")
        card = f"article.drive[data-address='{address}']"
        page.sees(shown, f"{card} .fault")
        assert page.count(f"{card} .machine .node.now.bad") == 1
        assert [line for line in plant.run.lines if line.get("address") == address and line.get("faults")]
    plant.call("drive", "fan", "acknowledge")
    page.until(lambda: "without a name" not in page.text("#row-4"), "no fault")


def test_a_slave_without_power_and_back(page: Browser, plant: Plant) -> None:
    plant.ctl("power-off", "12")
    page.until(lambda: "Data exchange" not in page.text("#row-12"), "the loss")
    page.sees("inputs not valid", "#row-12")
    assert page.count(".line a.station.bad[href='#/slave/12']") == 1
    page.sees("5 of 6", ".tiles")
    page.go("slave/12")
    page.click("[aria-labelledby=h-why] button")
    page.sees("not_there", ".causes")
    plant.ctl("power-on", "12")
    page.sees("Data exchange", ".heading")
    page.go("bus")
    page.js("const one = document.querySelector('#filter'); one.value = 'mixer'; one.dispatchEvent(new Event('input'))")
    page.sees("slave 12 (mixer)", ".events")


def test_an_alarm_with_the_texts_of_the_gsd_file(page: Browser, plant: Plant) -> None:
    page.go("slave/8")
    plant.ctl("wire-break", "8", "3", "0", "on")
    page.sees("line break", "[aria-labelledby=h-diagnosis]")
    page.until(lambda: page.text("[aria-labelledby=h-alarms] .events"), "the alarm")
    assert page.text(".bad-slot h3") == "Slot 3"
    assert page.text(".bad-slot .module") == "2 AI"
    assert "line break" in page.text(".bad-slot [data-channel='0'].q-bad .value")
    assert "line break" in page.text("[aria-labelledby=h-history] .error .text:has(.change)")
    plant.ctl("wire-break", "8", "3", "0", "off")
    page.until(lambda: "line break" not in page.text("[aria-labelledby=h-diagnosis]"), "no line break")
    page.until(lambda: not page.count(".bad-slot, .channels > .q-bad"), "the slot is in order")
    assert page.texts("[aria-labelledby=h-history] .change")[0] == "▼ disappears"


# --- asks and orders -------------------------------------------------------------------------------------------------


def test_records_im_and_parameters_are_read_on_demand(page: Browser, plant: Plant) -> None:
    page.go("slave/8")
    page.js("for (const one of document.querySelectorAll('button')) if (one.textContent === 'Read I&M') one.click()")
    im = plant.call("acyclic", "8", "im")["im"]["0"]
    page.sees(str(im["order_id"]), "[aria-labelledby=h-records]")
    page.click("#record-slot")
    page.press("BACKSPACE", "9", "9", "TAB", "1", "ENTER")
    page.sees("refuses", "[aria-labelledby=h-records] .bad")
    page.go("slave/3")
    page.click("#parameter-3")
    page.type("480")
    page.press("ENTER")
    parameter = plant.call("drive", "hoist", "read", "480")["parameter"]
    page.sees(f"480 {parameter['name']}: ", "article.drive .answer")
    shown = page.text("article.drive .answer strong").replace("\u2212", "-")
    assert float(shown) == pytest.approx(parameter["value"])


def test_the_commissioning_sheet_is_that_of_the_command(page: Browser, plant: Plant, tmp_path: Path) -> None:
    """Each row of ``dpstack sheet --json`` is on the page; a slave of a GSD file has its modules."""
    done = plant.start("sheet", str(plant.file), "hoist", "--json")
    assert done.end() == 0, done.err
    (sheet,) = done.lines[-1]["sheets"]
    page.go("slave/3")
    page.click("#h-sheet ~ .buttons button")
    page.sees("F2062", ".sheet")
    shown = page.text(".sheet")
    for step in sheet["device"]["steps"]:
        assert step["what"] in shown
        assert step["why"] in shown
    for fault in sheet["device"]["faults"]:
        assert fault["text"] in shown
    page.picture(tmp_path / "sheet.png")
    page.go("slave/8")
    page.click("#h-sheet ~ .buttons button")
    page.sees("8 DI", ".sheet")


def test_an_output_set_on_the_page_is_on_the_wire(page: Browser, plant: Plant) -> None:
    page.go("slave/8")
    page.js("document.getElementById('set-8-outlet').value = 'on'")
    page.js("document.getElementById('set-8-outlet').closest('form').requestSubmit()")
    page.sees("Set 8.outlet=on.", "#confirm")
    page.click("#confirm-yes")
    page.sees("done", "#said")
    assert plant.call("stats")["slaves"]["8"]["fields"]["outlet"] is True
    assert "set 8.outlet=on" in plant.web.err
    page.go("bus")
    page.sees("order of this computer: set 8.outlet=on: done", ".events")


def test_an_input_forced_in_the_watch_table_is_read_by_the_master(page: Browser, plant: Plant) -> None:
    page.go("watch")
    page.js("location.hash = '#/watch?8.pressure&9.level&3:speed'")
    page.until(lambda: page.count("table.watched form") == 2, "the forms")
    page.click("[data-id='8.pressure'] form input")
    page.type("7.5")
    page.press("ENTER")
    page.sees("Force 8.pressure=7.5.", "#confirm")
    page.click("#confirm-yes")
    page.sees("7.5", "[data-id='8.pressure'] .reading")
    assert plant.call("stats")["slaves"]["8"]["fields"]["pressure"] == 7.5
    assert page.text("[data-id='8.pressure'] .octets") == "1d 4c"


def test_the_oscilloscope_shows_what_happens_between_two_snapshots(page: Browser, plant: Plant) -> None:
    """A value that stands for some rounds only is in the trace, and a trigger finds it."""
    page.go("scope")
    page.js(
        "const { page } = window.dpstack; for (const id of [...page.scope.chosen]) page.choose(id, false);"
        "page.choose('8.pressure', true)"
    )
    page.sees("each round", ".status")
    plant.call("set", "valves.pressure=0")
    page.until(
        lambda: page.js("return window.dpstack.store.roundsOf('8.pressure')?.values.at(-1)") == 0, "the first value"
    )
    page.js(
        "document.querySelector('#trigger-source').value = '8.pressure';"
        "document.querySelector('#trigger-level').value = '25'; document.querySelector('#arm').click()"
    )
    with connect(plant.name) as client:
        client.call("set", "valves.pressure=30")
        time.sleep(0.05)  # some rounds, a quarter of the time between two snapshots
        client.call("set", "valves.pressure=1")
    page.sees("triggered", ".status")
    times, values = page.js("const one = window.dpstack.store.roundsOf('8.pressure'); return [one.times, one.values]")
    high = [t for t, value in zip(times, values, strict=True) if value == 30]
    assert high
    assert high[-1] - high[0] < 0.2
    assert len(times) > 20 * (times[-1] - times[0])  # five a second are those of the snapshots


def test_commissioning_from_the_scan_to_the_file(page: Browser, plant: Plant) -> None:
    page.go("commissioning")
    page.click("#scan")
    page.until(lambda: page.count("article.found") == 6, "six slaves")
    # the parts of a scan by order are no events: they answer the order
    assert [line for line in plant.run.lines if "live list complete" in line.get("text", "")] == []
    page.js(
        "const one = document.getElementById('found-8-name'); one.value = 'island';"
        "one.dispatchEvent(new Event('input', { bubbles: true }))"
    )
    page.click("#make")
    page.until(lambda: page.count("#toml"), "the text")
    data = tomllib.loads(page.js("return document.querySelector('#toml').value"))
    found = {slave["address"]: slave for slave in data["slave"]}
    assert set(found) == {3, 4, 6, 8, 9, 12}
    assert found[8]["name"] == "island"
    assert found[8]["modules"] == ["8 DI", "8 DO", "2 AI"]
    assert found[3]["drive"] == "demag-dedrive"
    page.js("const one = document.querySelector('#toml'); one.value += '\\nwrong = 1\\n'")
    page.js(
        "for (const one of document.querySelectorAll('button')) if (one.textContent === 'Check this text') one.click()"
    )
    page.until(lambda: page.count(".errors li"), "the error")


def test_start_operate_and_stop_on_the_page(browser: Browser, start: Starter, tmp_path: Path) -> None:
    """Without a run nothing is live; start leads to Clear, operate is another order, stop ends the run."""
    file = tmp_path / "plant.toml"
    plant = PLANT.read_text(encoding="utf-8")
    file.write_text(plant.partition("simulate = ")[0] + plant.partition("repeat = true }\n")[2], encoding="utf-8")
    web = start("web", str(file), "--json", "--listen", "127.0.0.1:0", "--control")
    web.wait_for('"listening"')
    browser.open(web.lines[0]["url"])
    browser.sees("There is no run of this configuration", "#banner")
    browser.click("#orders [data-key=start]")
    browser.sees("It starts in Clear", "#confirm")
    browser.click("#confirm-yes")
    browser.sees("Live", "#live")
    browser.sees("Clear", "#badges")
    browser.click("#orders [data-key=operate]")
    browser.sees("Machines can move", "#confirm")
    browser.click("#confirm-yes")
    browser.sees("Operate", "#badges")
    browser.click("#orders [data-key=stop]")
    browser.click("#confirm-yes")
    browser.sees("The program has ended", "#banner")
    browser.until(lambda: browser.count("#orders [data-key=start]"), "start again")
    browser.open("about:blank")
    assert web.end(signal.SIGINT) == 0
    assert browser.console() == []


def test_a_recording_is_replayed_on_the_page(browser: Browser, start: Starter, tmp_path: Path) -> None:
    file = tmp_path / "week.jsonl"
    run = start("run", "examples/plant.toml", "--seconds", "3", "--record", str(file), "--json")
    assert run.end() in (0, 1)
    web = start("web", "--replay", str(file), "--json", "--listen", "127.0.0.1:0")
    web.wait_for('"listening"')
    browser.open(web.lines[0]["url"])
    browser.sees("Replay of a recording", "#badges")
    browser.until(lambda: browser.count("table.plant tbody tr"), "slaves")
    assert browser.count("#orders button") == 0
    browser.sees("The recording is over", "#banner")
    browser.open("about:blank")
    assert web.end(signal.SIGINT) == 0


def test_the_last_values_of_a_run_are_those_of_its_summary(browser: Browser, start: Starter, tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir()
    plant = Plant(start, own)
    browser.open(plant.url)
    browser.sees("Live", "#live")
    browser.go("bus")
    plant.run.end(signal.SIGINT)
    browser.sees("The program has ended", "#banner")
    summary = plant.run.lines[-1]
    assert summary["event"] == "summary"
    shown = {
        int(row[0].split()[0]): [_number(text) for text in row[1:]]
        for row in browser.js(
            "return [...document.querySelectorAll('table.retries tbody tr')].map((row) =>"
            " [row.cells[0], row.cells[3], row.cells[4], row.cells[5]].map((one) => one.innerText))"
        )
    }
    assert shown == {
        int(address): [slave["retries"], slave["timeouts"], slave["late"]]
        for address, slave in summary["slaves"].items()
    }
    assert browser.count("body.dead") == 1


# --- pictures --------------------------------------------------------------------------------------------------------


def test_pictures_of_every_page(page: Browser, plant: Plant, tmp_path: Path) -> None:
    """Each page is drawn, wide and on a telephone. They go to the documentation only where the environment says so."""
    folder = picture_folder(tmp_path)
    plant.call("set", "valves.full=on", "valves.pressure=4.25", "valves.inlet=on")
    for drive, speed in (("hoist", "60%"), ("pump", "-40%"), ("fan", "80%")):
        plant.call("drive", drive, "speed", speed)
    plant.call("drive", "pump", "start")
    plant.call("drive", "fan", "start")
    plant.ctl("trip", "3", "F2100")
    plant.ctl("wire-break", "8", "3", "0", "on")
    plant.ctl("power-off", "12")
    page.until(lambda: page.count(".line a.station:not(.good)"), "the loss of a slave")
    page.js("window.dpstack.scope = undefined")
    page.go("scope")
    for wanted in ("fan: speed", "fan: setpoint", "tank.level", "valves.full"):
        page.js(
            "for (const one of document.querySelectorAll('.signals label')) {"
            " const box = one.querySelector('input');"
            " if (one.querySelector('bdi').textContent === arguments[0] && !box.checked) { box.click(); break; } }",
            wanted,
        )
    steps = ((12, "30%", "off"), (12, "80%", "on"))
    seconds = 0.2 if folder == tmp_path else 1.0
    for ticks, speed, full in steps:
        plant.call("drive", "fan", "speed", speed)
        plant.call("set", f"valves.full={full}")
        begun = page.js("return window.dpstack.live.t")
        page.until(lambda b=begun, n=ticks: page.js("return window.dpstack.live.t") > b + n * seconds)  # type: ignore[misc]
    taken = []
    for width in (1280, 390):
        page.window(width, 860)
        for route, name in (
            ("plant", "plant"), ("slave/12", "slave"), ("slave/8", "rack"), ("watch", "watch"), ("scope", "scope"),
            ("bus", "bus"), ("commissioning", "commissioning"),
        ):  # fmt: skip
            page.go(route)
            if route == "watch":
                page.js(
                    "location.hash = '#/watch?8.pressure&8.full&8.inlet&9.level&9.temperature&4:speed&12/2/input/0'"
                )
                page.until(lambda: page.count("table.watched tbody tr") == 7, "the rows")
            page.js("document.activeElement.blur()")
            if route == "slave/12":
                page.click("[aria-labelledby=h-why] button")
                page.until(lambda: page.count(".causes li"), "causes")
            if route == "bus":
                assert "Masters in the ring, by address\n2 (this one)" in page.text("body").replace("\t", "\n")
            if route == "commissioning":
                page.js("document.querySelector('#scan').click()")
                page.until(lambda: page.count("article.found"), "slaves")
                page.js("document.querySelector('#make').click()")
                page.until(lambda: page.count("#toml"), "the text")
            page.until(lambda: not page.js("return document.querySelector('#said').textContent"), "no message")
            shows_no_place(page.text("body"))
            page.sees("Simulated slaves", "#badges")
            path = folder / f"web-{name}.png" if width == 1280 else tmp_path / f"web-{name}-390.png"
            page.picture(path)
            taken.append(path)
    for path in taken:
        octets = path.read_bytes()
        assert octets.startswith(b"\x89PNG")
        assert len(octets) > 20_000  # something is drawn
        assert int.from_bytes(octets[16:20], "big") == (390 if path.stem.endswith("390") else 1280)
