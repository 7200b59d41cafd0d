"""References to the documents: each names a file and an anchor that exist, in the sources and between the documents."""

from __future__ import annotations

import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SOURCES = sorted(
    path
    for room in ("dpstack", "drives", "tests", "bench", "tools", "examples")
    for path in (ROOT / room).rglob("*")
    if path.suffix in {".py", ".toml", ".gsd"} and path != Path(__file__).resolve()
)
_CITATION = re.compile(r"docs/[\w/-]+\.md(?:#[\w-]+)?")
_LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]*)#([^)\s]+)\)")
_HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
_CODE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def slug(heading: str) -> str:
    """The anchor that GitHub makes of a heading: "RD_Inp, RD_Outp" -> rd_inp-rd_outp."""
    return re.sub(r"[^\w -]", "", heading.strip().lower()).replace(" ", "-")


@cache
def anchors(page: Path) -> frozenset[str]:
    """Of headings and of ``<a id="...">``. Two headings of the same text would share one: refused."""
    text = _CODE.sub("", page.read_text(encoding="utf-8"))
    names = [slug(heading) for heading in _HEADING.findall(text)] + re.findall(r'<a id="([^"]+)">', text)
    doubled = [name for name, times in Counter(names).items() if times > 1]
    assert not doubled, f"{page.name}: {doubled}"
    return frozenset(names)


def missing(text: str) -> list[str]:
    """The citations in ``text`` that lead nowhere."""
    found = (citation.partition("#") for citation in _CITATION.findall(text))
    return [
        f"{file}#{anchor}"
        for file, _, anchor in found
        if not (ROOT / file).is_file() or (anchor and anchor not in anchors(ROOT / file))
    ]


def test_citations_in_the_sources_lead_to_an_anchor() -> None:
    wrong = {
        str(path.relative_to(ROOT)): missing(path.read_text(encoding="utf-8", errors="replace")) for path in SOURCES
    }
    assert {path: found for path, found in wrong.items() if found} == {}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_between_documents_lead_to_an_anchor(page: Path) -> None:
    text = _CODE.sub("", page.read_text(encoding="utf-8"))
    links = [
        (page.parent / file if file else page, anchor) for file, anchor in _LINK.findall(text) if "://" not in file
    ]
    assert [(str(file), anchor) for file, anchor in links if anchor not in anchors(file.resolve())] == []


def test_a_citation_of_nothing_is_found() -> None:
    assert missing("docs/protocol.md#t-sl, docs/protocol.md") == []
    assert missing("docs/protocol.md#nothing and docs/nothing.md") == ["docs/protocol.md#nothing", "docs/nothing.md#"]
