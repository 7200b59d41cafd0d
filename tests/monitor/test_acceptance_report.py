"""The acceptance report is one whole HTML page with all figures of the summary, and foreign text is only text in it."""

from __future__ import annotations

import re
from functools import cache
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from page_kit import Page
from report_kit import Heard, happened
from support import S

from dpstack.capture.timing import TAP, LineTiming
from dpstack.monitor.monitor import Monitor
from dpstack.text import printable


@cache
def _heard() -> Heard:
    heard = Heard()
    heard.world.run_for(S // 5)
    return heard


@pytest.fixture
def heard() -> Heard:
    return _heard()


@pytest.fixture
def page(heard: Heard) -> Page:
    return Page.of(heard.report().html())


def test_every_tag_is_closed_and_every_name_stands_for_one_thing(page: Page) -> None:
    assert page.faults == []
    ids = [element.attributes["id"] for element in page.elements if "id" in element.attributes]
    assert len(ids) == len(set(ids))
    for element in page.elements:
        for key in ("aria-labelledby", "for"):
            assert element.attributes.get(key, ids[0]) in ids


def test_nothing_comes_from_outside_and_nothing_runs(page: Page, heard: Heard) -> None:
    assert not page.all("script")
    assert not page.all("link")
    assert not page.all("iframe")
    for element in page.elements:
        names = element.attributes.keys()
        assert not names & {"src", "href", "srcset", "action", "data", "style"}
        assert not any(name.startswith("on") for name in names)
    assert "@import" not in page.style
    assert re.findall(r"url\(([^)]*)\)", heard.report().html()) == ["#hatch"]
    policy = next(one for one in page.all("meta") if one.attributes.get("http-equiv") == "Content-Security-Policy")
    assert policy.attributes["content"] == "default-src 'none'; style-src 'unsafe-inline'"


def test_a_screen_reader_finds_language_headings_table_headers_and_words_for_each_drawing(page: Page) -> None:
    assert page.all("html")[0].attributes["lang"] == "en"
    assert [one.text for one in page.all("h1")] == ["PROFIBUS acceptance report"]
    headings = [one.tag for one in page.elements if one.tag in ("h1", "h2", "h3")]
    assert all(int(after[1]) - int(before[1]) <= 1 for before, after in pairwise(headings))
    assert all(one.attributes.get("scope") in ("col", "row") for one in page.all("th"))
    drawings = [one for one in page.all("svg") if one.attributes.get("aria-hidden") != "true"]
    assert len(drawings) > 5
    for drawing in drawings:
        assert drawing.attributes["role"] == "img"
        assert len(drawing.attributes["aria-label"]) > 20
    labelled = {one.attributes["for"]: one.text for one in page.all("label")}
    assert {one.attributes["id"] for one in page.all("input")} == labelled.keys()
    assert {"Customer", "Plant", "Inspector"} <= set(labelled.values())
    assert "Place, date, signature of the customer" in labelled.values()


@pytest.mark.parametrize("timed", [True, False])
def test_every_figure_of_the_summary_is_in_the_report(heard: Heard, *, timed: bool) -> None:
    summary = {**heard.summary(timed=timed), "telegrams_per_s": 8642.5}
    html = heard.report(summary=summary).html()
    text = Page.of(html).text
    numbers: list[str] = []
    words: list[str] = []
    _leaves({key: value for key, value in summary.items() if key not in ("event", "time")}, numbers, words)
    for number in {*numbers, *(word.replace("_", " ") for word in words)}:
        assert re.search(rf"(?<![\w.]){re.escape(number)}(?![\w.]*\d)", text), number
    assert "2026-09-21 14:13:20 UTC" in text
    assert ("n/a" in text) or timed
    assert ("Histogram of T_SDR" in html) == timed


def test_each_key_of_a_summary_has_its_place(heard: Heard) -> None:
    """A new one is to be put into the report, and then here."""
    monitor = Monitor(LineTiming(TAP, None))
    for one in heard.heard:
        monitor.add(one)
    summary: dict[str, Any] = monitor.summary()
    shown = heard.summary()
    assert summary.keys() == shown.keys() | {"telegrams_per_s", "profibus", "thresholds"}
    assert summary["timing"].keys() == shown["timing"].keys()
    assert summary["masters"]["2"].keys() == shown["masters"]["2"].keys() | {"in_ring", "silent", "clock"}
    assert summary["stations"]["3"].keys() == shown["stations"]["3"].keys()


def _leaves(value: Any, numbers: list[str], words: list[str]) -> None:
    match value:
        case dict():
            for inner in value.values():
                _leaves(inner, numbers, words)
        case list():
            for inner in value:
                _leaves(inner, numbers, words)
        case str():
            words.append(value)
        case bool() | None:
            return
        case _:
            numbers.append(str(value))


_HOSTILE = st.one_of(
    st.text(max_size=40),
    st.sampled_from(
        [
            "<script>alert(1)</script>",
            "\"'><img src=x onerror=alert(1)>",
            "</title></style><!--",
            "&lt;&#0;&amp;",
            "\x1b[31m\x00\x9b",
            "\u202eabc\u2066",
            "]]></svg>",
            "a" * 5000,
        ]
    ),
)


def _with_texts(name: str, reason: str, line: str) -> Page:
    heard = _heard()
    summary = heard.summary()
    summary["stations"]["3"] |= {"name": name, "model": name, "reasons": [reason], "diagnosis": reason, "state": line}
    summary["reasons"] = [reason]
    return Page.of(heard.report(summary=summary, changes=[happened(1, "alarm", 3, line)], line={"Port": line}).html())


@given(_HOSTILE, _HOSTILE, _HOSTILE)
@settings(max_examples=8)
def test_foreign_text_is_text_and_nothing_else(name: str, reason: str, line: str) -> None:
    page, plain = (
        _with_texts(*texts)
        for texts in ((name, reason, line), tuple("x" if one else "" for one in (name, reason, line)))
    )
    assert page.faults == []
    assert [one.tag for one in page.elements] == [one.tag for one in plain.elements]
    assert [one.attributes.keys() for one in page.elements] == [one.attributes.keys() for one in plain.elements]
    cells = {one.text.strip(" ") for one in page.elements if one.tag in ("td", "li", "th")}
    assert {printable(one).strip(" ") for one in (name, reason, line)} - {""} <= cells


def test_kinds_and_verdicts_nobody_knows_are_shown(heard: Heard) -> None:
    summary = heard.summary()
    summary["verdict"] = summary["stations"]["3"]["verdict"] = '"><b>'
    page = Page.of(heard.report(summary=summary, changes=[happened(1, '"><b>', None, "x")]).html())
    assert page.faults == []
    assert not page.all("b")
    assert '"><b>' in page.text


def test_a_report_of_nothing(heard: Heard) -> None:
    empty = Heard()
    summary = {"verdict": "unknown", "reasons": ["silence"], "seconds": 5.0, "timing": {}, "baud": None}
    page = Page.of(empty.report(summary=summary).html())
    assert page.faults == []
    assert "No whole rotation was heard." in page.text
    assert "No station was heard." in page.text
    assert "silence" in page.text


def test_a_full_bus_gives_a_bounded_report() -> None:
    heard = Heard(addresses=range(3, 60))
    heard.world.run_for(S // 10)
    changes = [happened(heard.counters.begun_ns or 0, "diagnosis", n % 126, f"change {n}") for n in range(5000)]
    html = heard.report(changes=changes, changes_left_out=7).html()
    page = Page.of(html)
    assert page.faults == []
    assert len(html) < 600_000
    assert "4807 earlier changes are not shown." in page.text
    assert "change 4999" in page.text


def _luminance(colour: str) -> float:
    digits = colour if len(colour) == 6 else "".join(2 * digit for digit in colour)
    parts = [int(digits[n : n + 2], 16) / 255 for n in (0, 2, 4)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_text_has_enough_contrast_in_colour_and_shades_differ_in_grey(page: Page) -> None:
    colours = dict(re.findall(r"--(\w+): #(\w+)", page.style))
    for name in ("ink", "faint", "good", "warning", "critical"):
        for ground in ("fff", colours["soft"]):
            assert (_luminance(ground) + 0.05) / (_luminance(colours[name]) + 0.05) >= 4.5, name
    shades = sorted(_luminance(shade) for shade in ("000000", "1f4e79", "a9cbe8", "ffffff"))
    steps = [(b + 0.05) / (a + 0.05) for a, b in pairwise(shades)]
    assert min(steps) > 1.5
