"""Where in a TOML text a key stands: tomllib tells values only, a message for people needs the line."""

from __future__ import annotations

import re
from typing import Final

#: ("bus", "port") or ("slave", 0, "address"); a table itself is ("bus",) or ("slave", 0)
Path = tuple[str | int, ...]

_HEADER: Final = re.compile(r"\s*(\[\[?)\s*([^\]]+?)\s*\]\]?\s*(?:#.*)?$")
_KEY: Final = re.compile(r"""\s*((?:[\w-]+|"[^"\n]*"|'[^'\n]*')(?:\s*\.\s*(?:[\w-]+|"[^"\n]*"|'[^'\n]*'))*)\s*=""")
_PART: Final = re.compile(r"""[\w-]+|"[^"]*"|'[^']*'""")


def line_numbers(text: str) -> dict[Path, int]:
    """The line (from 1) of every table and key of ``text``, which tomllib has accepted.

    Keys inside inline tables are not listed: the line of the key that holds them is the nearest there is.
    """
    lines: dict[Path, int] = {}
    counts: dict[Path, int] = {}
    prefix: Path = ()
    inside = _Inside()
    for number, line in enumerate(text.splitlines(), 1):
        if inside.continued:
            inside.feed(line)
            continue
        header = _HEADER.match(line)
        if header:
            prefix = _table(_parts(header[2]), header[1] == "[[", counts)
            lines.setdefault(prefix, number)
            lines.setdefault(tuple(part for part in prefix if isinstance(part, str)), number)
            continue
        key = _KEY.match(line)
        if key:
            path = prefix
            for part in _parts(key[1]):
                path = (*path, part)
                lines.setdefault(path, number)
            inside.feed(line[key.end() :])
    return lines


def _parts(dotted: str) -> list[str]:
    return [part.strip("\"'") for part in _PART.findall(dotted)]


def _table(parts: list[str], array: bool, counts: dict[Path, int]) -> Path:
    """The path of a header; a part that names an array of tables means its last element."""
    path: Path = ()
    for depth, part in enumerate(parts):
        path = (*path, part)
        if array and depth == len(parts) - 1:
            counts[path] = counts.get(path, -1) + 1
        if path in counts:
            path = (*path, counts[path])
    return path


class _Inside:
    """Whether a value goes on on the next line: open brackets, or a string of three quotes."""

    def __init__(self) -> None:
        self._depth = 0
        self._quote = ""

    @property
    def continued(self) -> bool:
        return bool(self._quote or self._depth)

    def feed(self, line: str) -> None:
        at = 0
        while at < len(line):
            if self._quote:
                end = line.find(self._quote, at)
                if end < 0:
                    return
                at, self._quote = end + 3, ""
            elif line.startswith(('"""', "'''"), at):
                self._quote = line[at : at + 3]
                at += 3
            elif line[at] in "\"'":
                at = _string_end(line, at)
            elif line[at] == "#":
                return
            else:
                self._depth += (line[at] in "[{") - (line[at] in "]}")
                at += 1


def _string_end(line: str, at: int) -> int:
    quote = line[at]
    at += 1
    while at < len(line) and line[at] != quote:
        at += 2 if quote == '"' and line[at] == "\\" else 1
    return at + 1
