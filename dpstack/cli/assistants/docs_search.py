"""The documentation of dpstack for the tools ``search_docs`` and ``read_docs``: its sections and their words."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Annotated, Final, NamedTuple

from msgspec import Meta, Struct

import dpstack
from dpstack.cli.assistants import answers
from dpstack.errors import UsageError
from dpstack.text import did_you_mean

#: the folders of the documentation that the wheel has
SHIPPED: Final = ("tutorial", "how-to", "reference", "explanation")
_INSTALLED: Final = "share/dpstack/docs/"
_HEADING: Final = re.compile(r"^#{1,4} +(.+?)\s*$", re.MULTILINE)
_WORD: Final = re.compile(r"[\w.-]+")
_PART: Final = 8000
_SHOWN: Final = 600


class SearchDocs(Struct, kw_only=True, forbid_unknown_fields=True):
    words: Annotated[str, Meta(min_length=1, max_length=200, description="words to look for")]
    limit: Annotated[int, Meta(ge=1, le=20)] = 6


class ReadDocs(Struct, kw_only=True, forbid_unknown_fields=True):
    page: Annotated[str, Meta(max_length=200, description="a page of search_docs, for instance how-to/why.md")]
    offset: Annotated[int, Meta(ge=0, description="characters to leave out")] = 0


class Section(NamedTuple):
    page: str
    heading: str
    text: str


def docs_folder() -> Path | None:
    """The folder of the documentation: of the source tree, or as the wheel has installed it; None without one."""
    tree = Path(dpstack.__file__).parent.parent / "docs"
    if (tree / SHIPPED[0]).is_dir():
        return tree
    try:
        files = metadata.files("dpstack") or []
    except metadata.PackageNotFoundError:
        return None
    for file in files:
        before, found, after = file.as_posix().partition(_INSTALLED)
        if found and after.startswith(f"{SHIPPED[0]}/"):
            folder = Path(str(metadata.distribution("dpstack").locate_file(before + found))).resolve()
            return folder if folder.is_dir() else None
    return None


@functools.cache
def pages() -> dict[str, str]:
    """The text of each page by its name. Raises UsageError if no documentation is installed."""
    folder = docs_folder()
    if folder is None:
        raise UsageError(
            "the documentation is not installed with this dpstack: install it from its wheel (pip install dpstack), or "
            "run it from its source tree"
        )
    found = {}
    for name in SHIPPED:
        for path in sorted((folder / name).rglob("*.md")):
            found[path.relative_to(folder).as_posix()] = path.read_text(encoding="utf-8")
    return found


@functools.cache
def sections() -> tuple[Section, ...]:
    """The pages, cut at their headings."""
    return tuple(section for page, text in pages().items() for section in _cut(page, text))


def _cut(page: str, text: str) -> Iterator[Section]:
    marks = [*_HEADING.finditer(text)]
    for number, mark in enumerate(marks):
        end = marks[number + 1].start() if number + 1 < len(marks) else len(text)
        yield Section(page, mark[1], text[mark.end() : end].strip())


def search_docs(given: SearchDocs) -> answers.SearchAnswer:
    """The sections that fit the words best."""
    words = [word.lower() for word in _WORD.findall(given.words)][:20]
    every = sections()
    texts = [f"{one.page} {one.heading} {one.text}".lower() for one in every]
    rare = {word: math.log(1 + len(every) / (1 + sum(word in text for text in texts))) for word in words}
    scores = []
    for number, (one, text) in enumerate(zip(every, texts, strict=True)):
        title = f"{one.page} {one.heading}".lower()
        score = sum(
            rare[word] * (min(text.count(word), 5) ** 0.5 + 2 * (word in title)) for word in words if word in text
        )
        if score:
            scores.append((-score * (1 + all(word in text for word in words)), number))
    best = [every[number] for _, number in sorted(scores)[: given.limit]]
    return answers.SearchAnswer(
        version=dpstack.__version__,
        passages=[
            answers.Passage(page=one.page, heading=one.heading[:200], text=_excerpt(one.text, words)) for one in best
        ],
    )


def _excerpt(text: str, words: list[str]) -> str:
    """The part of ``text`` around the first word that is found."""
    if len(text) <= _SHOWN:
        return text
    places = [at for word in words if (at := text.lower().find(word)) >= 0]
    begin = max(0, min(places, default=0) - _SHOWN // 4)
    return ("..." if begin else "") + text[begin : begin + _SHOWN] + ("..." if begin + _SHOWN < len(text) else "")


def read_docs(given: ReadDocs) -> answers.PageAnswer:
    """A part of a page."""
    every = pages()
    if given.page not in every:
        raise UsageError(f"no page {given.page!r}; " + did_you_mean(given.page, every, "search_docs names the pages"))
    text = every[given.page][given.offset : given.offset + _PART]
    end = given.offset + _PART
    return answers.PageAnswer(page=given.page, text=text, next=end if end < len(every[given.page]) else None)
