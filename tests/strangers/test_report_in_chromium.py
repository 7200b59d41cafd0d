"""The acceptance report in a real browser: it renders without a console message, fits narrow windows and A4 pages."""

from __future__ import annotations

import html
import re
import subprocess
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from report_kit import Heard, happened
from support import S

from tests.strangers.stranger_kit import HANGS_S, program, run_program

pytestmark = pytest.mark.strangers

#: A4 in points, and the margins of the page in points
_A4: Final = (595, 842)
_MARGIN: Final = 14 / 25.4 * 72
_LONG: Final = "a very long name of a remote I/O station in hall 7, column C 12 " * 3
_UNBROKEN: Final = "W" * 90


@pytest.fixture(scope="module")
def heard() -> Heard:
    heard = Heard(addresses=range(3, 40))
    heard.world.run_for(S // 4)
    return heard


@pytest.fixture(scope="module")
def summary(heard: Heard) -> dict[str, Any]:
    summary = heard.summary()
    summary["stations"]["3"] |= {"name": _LONG, "reasons": [_LONG, _LONG]}
    summary["stations"]["4"] |= {"name": _UNBROKEN, "model": _UNBROKEN, "diagnosis": "ab" * 244}
    return summary


@pytest.fixture(scope="module")
def report(heard: Heard, summary: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    begun = heard.counters.begun_ns or 0
    kinds = ("lost", "back", "diagnosis", "alarm", "left", "joined", "mode", "rate", "gap", "unheard of")
    changes = [
        happened(begun + n * S // 4, kinds[n % len(kinds)], None if n % 20 == 8 else 3 + n % 37, f"change {n} {_LONG}")
        for n in range(240)
    ]
    path = tmp_path_factory.mktemp("report") / "report.html"
    text = heard.report(summary=summary, changes=changes).html()
    path.write_text(text, encoding="utf-8")
    return path


def _chromium(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the browser without a window; what pages say on their console is in its standard error."""
    command = [
        program("chromium"), "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run",
        "--disable-dev-shm-usage", "--enable-logging=stderr", f"--user-data-dir={folder / 'profile'}", *arguments,
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANGS_S, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return done


def _console(done: subprocess.CompletedProcess[str]) -> list[str]:
    return [line for line in done.stderr.splitlines() if "CONSOLE" in line or "Refused to" in line]


@pytest.mark.parametrize(("width", "height"), [(1200, 3000), (500, 3000)])
def test_the_page_is_drawn_and_its_console_is_silent(report: Path, tmp_path: Path, width: int, height: int) -> None:
    picture = tmp_path / "page.png"
    size = f"--window-size={width},{height}"
    done = _chromium(size, f"--screenshot={picture}", report.as_uri(), folder=tmp_path)
    assert _console(done) == []
    octets = picture.read_bytes()
    assert (_number(octets[16:20]), _number(octets[20:24])) == (width, height)
    rows = list(_rows(octets))
    drawn = [number for number, row in enumerate(rows) if len(set(row)) > 8]
    assert len(drawn) > height // 8  # text or drawings all over the page
    assert drawn[-1] > height * 0.9


def _number(octets: bytes) -> int:
    return int.from_bytes(octets, "big")


def _rows(png: bytes) -> Iterator[bytes]:
    """The lines of a PNG as they are packed: those of plain paper have few different octets."""
    at, packed = 8, b""
    while at < len(png):
        size = _number(png[at : at + 4])
        if png[at + 4 : at + 8] == b"IDAT":
            packed += png[at + 8 : at + 8 + size]
        at += size + 12
    flat = zlib.decompress(packed)
    wide = len(flat) // _number(png[20:24])
    for number in range(_number(png[20:24])):
        yield flat[number * wide + 1 : (number + 1) * wide]


@pytest.mark.parametrize("width", [400, 768, 1200])
def test_no_window_has_to_be_scrolled_sideways(report: Path, tmp_path: Path, width: int) -> None:
    """Wide tables and drawings scroll within themselves."""
    frame = tmp_path / "frame.html"
    page = html.escape(report.read_text(encoding="utf-8"))
    frame.write_text(
        f'<!DOCTYPE html><iframe style="width:{width}px;height:900px;border:0" srcdoc="{page}"></iframe>'
        '<p id="out"></p>'
        "<script>onload = () => { const page = document.querySelector('iframe').contentDocument;"
        "const wide = [...page.body.querySelectorAll('section, table.pairs, .verdict, .fields, figure')]"
        ".filter(one => one.scrollWidth > one.clientWidth + 1).map(one => one.tagName + '.' + one.className);"
        "document.getElementById('out').textContent ="
        "JSON.stringify([page.documentElement.scrollWidth, wide]); }</script>",
        encoding="utf-8",
    )
    done = _chromium("--dump-dom", "--virtual-time-budget=3000", frame.as_uri(), folder=tmp_path)
    found = re.search(r'<p id="out">(.*?)</p>', done.stdout)
    assert found is not None
    assert html.unescape(found[1]) == f"[{width},[]]"


def test_the_printed_pages_hold_everything(report: Path, summary: dict[str, Any], tmp_path: Path) -> None:
    pdf = tmp_path / "report.pdf"
    done = _chromium("--no-pdf-header-footer", f"--print-to-pdf={pdf}", report.as_uri(), folder=tmp_path)
    assert _console(done) == []
    about = run_program("pdfinfo", [pdf]).stdout
    pages = int(re.findall(r"Pages:\s+(\d+)", about)[0])
    assert 8 < pages < 40
    assert "A4" in about
    assert re.search(r"Tagged:\s+yes", about)  # headings and tables for screen readers
    text = run_program("pdftotext", ["-layout", pdf, "-"]).stdout
    for words in ("Customer", "signature of the inspector", "Schedule of one rotation", "look at its connector"):
        assert words in text
    assert f"page 1 of {pages}" in text
    for station in summary["stations"].values():
        for key in ("requests", "answers"):
            assert re.search(rf"\b{station[key]}\b", text)
    # the head of a long table is on each of its pages
    assert len(re.findall(r"Seconds\s+Address\s+Change\s+Text", text)) > 2
    box = run_program("pdftotext", ["-bbox", pdf, "-"]).stdout
    words_at = re.findall(r'<word xMin="([\d.-]+)" yMin="([\d.-]+)" xMax="([\d.-]+)" yMax="([\d.-]+)"', box)
    assert len(words_at) > 2000
    for left, top, right, bottom in (map(float, word) for word in words_at):
        assert left >= _MARGIN - 2
        assert right <= _A4[0] - _MARGIN + 2
        assert 0 <= top < bottom <= _A4[1]
