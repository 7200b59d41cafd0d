"""Writes docs/development/book.md: commands that tests only parse, and links to other sites with their date."""

from __future__ import annotations

import datetime
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from tools.book_commands import commands

ROOT: Final = Path(__file__).resolve().parent.parent
TARGET: Final = ROOT / "docs" / "development" / "book.md"
_PARSED: Final = re.compile(r"<!-- parsed: ([^>]*?) -->\n```(console|toml)\n(.*?)^```", re.DOTALL | re.MULTILINE)
#: not the addresses of this computer
_LINK: Final = re.compile(r"https?://(?!127\.0\.0\.1|localhost)(?:[^\s()>`\"|,]|\([^\s()]*\))+")
_ROW: Final = re.compile(r"^\| (\d{4}-\d\d-\d\d) \| <(\S+)> \|", re.MULTILINE)
_HEAD: Final = """# The book

Made by `python -m tools.make_book_docs`; the text is in that file, do not edit it here.

`make docs` builds the book with Sphinx and serves it on this computer; `make check` builds it with warnings as errors.
The pages are Markdown for plain viewers too. An index page (`README.md` of a folder) is a list of links, and the tree
of the book follows from these links: a page that no index names is an error. Pages that are made from the program have
a tool each: `tools/make_*_docs.py` and `tools/make_pictures.py`. A new public namespace is added to `NAMESPACES` in
`tools/make_reference_docs.py`.

Every block of code has a kind, and each kind its test. `make check` runs two kinds with sybil, in the order of the page
and in a folder of the page's own (`tools/book_blocks.py` and `tools/book_commands.py` list the marks of a block):

- `python`: a program in virtual time; its output stands below it
- `console`: commands, with `/dev/ttyUSB0` on a simulated segment; what they print may stand below them

`make test` has the others:

- `console`: each command is parsed (`tests/test_docs.py`)
- `toml`: loads as a configuration, or as its mark says: scenario, thresholds, list of parameters, device file
  (`tests/test_docs.py`)
- `json`: each line is JSON (`tests/test_docs.py`)
- `yaml`: is a file of `examples/`, which parses (`tests/test_examples.py`)
- `text` marked `<!-- decode -->`: telegrams decode as printed (`tests/cli/listening/test_decode.py`)
- `text` marked `<!-- filters -->`: filters of `dpstack decode` (the same file)
- `text` marked `<!-- syntax -->`: the commands have these options (`tests/test_docs.py`)
- `text` marked `<!-- session -->`: a shell shows it (`tests/blocking/test_blocking_names.py`)
- `text` marked `<!-- symptom -->`: `dpstack why` says it of a plant with that fault (`tests/why/test_symptoms.py`)
- `sql` and `python` marked `<!-- readers -->`: DuckDB, polars and Dask give the `text` with that mark below them
  (`tests/strangers/test_recordings_in_readers.py` and `test_many_captures.py`, in `make strangers`)
- examples in docstrings, which the reference shows: they run (`tests/test_examples.py`)

Links inside the book lead to a page and a heading that exist (`tests/test_docs.py`).

## Pictures

Pictures of screens and pages are taken by tests from a simulated plant, `docs/pictures/plant.toml` or the one that the
page prints; the page says so. None shows a folder or a port of the computer that took it. Those of one test anew:

<!-- parsed: it installs a browser and writes into the sources -->
```console
$ DPSTACK_PICTURES=docs/pictures make strangers TESTS=tests/strangers/test_pictures.py
```

`tests/kits/pictures_kit.py` lists them with their tests. Drawings of states and rooms: `tools/make_pictures.py`.
"""


def pages() -> list[Path]:
    found = [ROOT / "README.md", ROOT / "SECURITY.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in found if page != TARGET]


def parsed_only() -> Iterator[tuple[str, Path, str]]:
    """Command, page and reason of the commands that no test runs; of a block of TOML its first line."""
    for page in pages():
        for reason, kind, text in _PARSED.findall(page.read_text(encoding="utf-8")):
            lines = commands(text) if kind == "console" else [text.partition("\n")[0] + " ..."]
            yield from ((re.sub(r" +#.*", "", line), page, reason) for line in lines)


def outside() -> dict[str, list[Path]]:
    """The links to other sites, each with its pages."""
    found: dict[str, list[Path]] = {}
    for page in pages():
        for link in dict.fromkeys(_LINK.findall(page.read_text(encoding="utf-8"))):
            found.setdefault(link, []).append(page)
    return dict(sorted(found.items()))


def _code(text: str) -> str:
    """Code in a cell of a table."""
    return "`" + text.replace("|", "\\|") + "`"


def _page_link(page: Path) -> str:
    name = page.stem if page.stem != "README" else f"{page.parent.name}/README" if page.parent != ROOT else "README"
    return f"[{name}]({os.path.relpath(page, TARGET.parent)})"


def render(old: str) -> str:
    """The page; links that are in ``old`` keep their date, new ones get that of today."""
    since = {link: date for date, link in _ROW.findall(old)}
    today = datetime.date.today().isoformat()
    parsed = [f"| {_code(command)} | {_page_link(page)} | {reason} |" for command, page, reason in parsed_only()]
    links = [
        f"| {since.get(link, today)} | <{link}> | {', '.join(map(_page_link, where))} |"
        for link, where in outside().items()
    ]
    return "\n".join(
        [
            _HEAD,
            "## Commands and blocks that are parsed only\n",
            "The examples of `--help` in [options](../reference/options.md), because of their files, and these:\n",
            "| command | page | reason |\n|---|---|---|",
            *parsed,
            "\n## Links to other sites\n",
            "The date is the day on which the link came into the book. No test asks these sites.\n",
            "| since | link | on |\n|---|---|---|",
            *links,
            "",
        ]
    )


if __name__ == "__main__":
    before = TARGET.read_text(encoding="utf-8") if TARGET.exists() else ""
    TARGET.write_text(render(before), encoding="utf-8")
