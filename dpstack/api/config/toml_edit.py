"""Changes of single keys in the text of a TOML file: other lines, comments and the layout stay as they are.

The text must be one that :func:`dpstack.toml.reading.read_toml` accepts. Paths are as there: a table of an array has
its number in them, and so has a member of a list.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from msgspec import Struct

from dpstack.toml.reading import TOKEN, Path, toml_key, unquoted


class _Span(Struct, frozen=True):
    start: int
    end: int


class _Part(Struct, frozen=True):
    """A part of a key. ``path``: of the table or value that the key means up to here."""

    path: Path
    span: _Span


@dataclass(eq=False)
class _Entry:
    """``key = value``. ``table``: path of the table that it stands in; ``inside``: the braces around it, None for a
    line of its own."""

    table: Path
    parts: Sequence[_Part]
    value: _Span
    inside: _Braces | None

    @property
    def path(self) -> Path:
        return self.parts[-1].path

    @property
    def start(self) -> int:
        return self.parts[0].span.start


@dataclass(eq=False)
class _Braces:
    """An inline table. ``gone`` and ``new``: the entries that are taken out, and the texts of those that are added."""

    path: Path
    span: _Span
    entries: list[_Entry] = field(default_factory=list)
    gone: set[_Entry] = field(default_factory=set)
    new: list[str] = field(default_factory=list)


class _Header(Struct, frozen=True):
    """``[table]`` or ``[[table]]``."""

    path: Path
    parts: Sequence[_Part]
    end: int


class _Reader:
    """The places of all keys and values."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.headers: list[_Header] = []
        self.entries: list[_Entry] = []
        self.braces: dict[Path, _Braces] = {}
        self.members: dict[Path, _Span] = {}
        self._tokens = [
            ("" if match.lastgroup == "mark" else match.lastgroup, match.start(), match.end())
            for match in TOKEN.finditer(text)
            if match.lastgroup != "nothing"
        ]
        self._at = 0
        self._counts: dict[Path, int] = {}
        table: Path = ()
        while self._skip_lines():
            if self._is("["):
                table = self._header()
            else:
                self.entries.append(self._entry(table, None))

    def _is(self, mark: str) -> bool:
        if self._at >= len(self._tokens):
            return False
        _, start, end = self._tokens[self._at]
        return self.text[start:end] == mark

    def _next(self) -> _Span:
        _, start, end = self._tokens[self._at]
        self._at += 1
        return _Span(start, end)

    def _take(self, mark: str) -> bool:
        found = self._is(mark)
        self._at += found
        return found

    def _skip_lines(self) -> bool:
        """Past line ends; whether more follows."""
        while self._at < len(self._tokens) and self._tokens[self._at][0] == "newline":
            self._at += 1
        return self._at < len(self._tokens)

    def _key(self) -> list[tuple[str, _Span]]:
        found = []
        while True:
            span = self._next()
            found.append((unquoted(self.text[span.start : span.end]), span))
            if not self._take("."):
                return found

    def _header(self) -> Path:
        self._next()
        is_array = self._take("[")
        parts: list[_Part] = []
        path: Path = ()
        key = self._key()
        for number, (name, span) in enumerate(key):
            path = (*path, name)
            parts.append(_Part(path, span))
            if is_array and number == len(key) - 1:
                self._counts[path] = self._counts.get(path, -1) + 1
            if path in self._counts:
                path = (*path, self._counts[path])
        end = self._next().end
        if is_array:
            end = self._next().end
        self.headers.append(_Header(path, parts, end))
        return path

    def _entry(self, table: Path, inside: _Braces | None) -> _Entry:
        parts: list[_Part] = []
        path = table
        for name, span in self._key():
            path = (*path, name)
            parts.append(_Part(path, span))
        self._next()  # the equals sign
        return _Entry(table, parts, self._value(path), inside)

    def _value(self, path: Path) -> _Span:
        if self._is("{"):
            return self._table(path)
        start = self._tokens[self._at][1]
        if self._take("["):
            number = 0
            while self._skip_lines() and not self._is("]"):
                self.members[*path, number] = self._value((*path, number))
                number += 1
                self._skip_lines()
                self._take(",")
            return _Span(start, self._next().end)
        end = start
        while self._at < len(self._tokens) and self._tokens[self._at][0] != "newline":
            if any(self._is(mark) for mark in ",]}"):
                break
            end = self._next().end
        return _Span(start, end)

    def _table(self, path: Path) -> _Span:
        start = self._next().start
        braces = _Braces(path, _Span(start, start))
        while self._skip_lines() and not self._is("}"):
            braces.entries.append(self._entry(path, braces))
            self._skip_lines()
            self._take(",")
        braces.span = _Span(start, self._next().end)
        self.braces[path] = braces
        self.entries += braces.entries
        return braces.span


class TomlEdit:
    """The changes of a TOML ``text``. All of them refer to the text as it was; :meth:`result` is the new one.

    Values are TOML already (:func:`dpstack.toml.reading.toml_value`).
    """

    def __init__(self, text: str) -> None:
        self._text = text
        self._line_end = "\r\n" if "\r\n" in text else "\n"
        self._read = _Reader(text)
        self._by_path = {entry.path: entry for entry in self._read.entries}
        self._in_table: dict[Path, list[_Entry]] = {}
        self._below: dict[Path, list[_Entry]] = {}
        self._headers: dict[Path, list[_Header]] = {}
        self._parts: dict[Path, list[_Part]] = {}
        for entry in self._read.entries:
            for depth in range(1, len(entry.path) + 1):
                self._below.setdefault(entry.path[:depth], []).append(entry)
            if entry.inside is None:
                self._in_table.setdefault(entry.table, []).append(entry)
        for header in self._read.headers:
            for depth in range(1, len(header.path) + 1):
                self._headers.setdefault(header.path[:depth], []).append(header)
        keys: list[_Entry | _Header] = [*self._read.entries, *self._read.headers]
        for key in keys:
            for part in key.parts:
                self._parts.setdefault(part.path, []).append(part)
        self._changes: list[tuple[_Span, str]] = []
        #: lines behind a place, by the place
        self._added: dict[int, list[str]] = {}
        #: names of tables that are new, with their lines
        self._new_tables: dict[Path, list[str]] = {}

    def value_text(self, path: Path) -> str:
        """The TOML of a key's value, or of a member of a list."""
        span = self._value(path)
        return self._text[span.start : span.end]

    # --- changes --------------------------------------------------------------------------------------------------

    def replace(self, path: Path, value: str) -> None:
        """Another value of a key, or of a member of a list."""
        self._changes.append((self._value(path), value))

    def rename(self, path: Path, name: str) -> None:
        """Another name of the key or table ``path``."""
        self._changes += [(part.span, toml_key(name)) for part in self._parts[path]]

    def remove(self, path: Path) -> None:
        """Take a key or a table out, with the comments in its lines."""
        for entry in self._outermost(path):
            if entry.inside is not None:
                entry.inside.gone.add(entry)
            else:
                self._changes.append((_Span(self._line_start(entry.start), self._next_line(entry.value.end)), ""))
        for header in self._headers.get(path, []):
            start = self._line_start(header.parts[0].span.start)
            self._changes.append((_Span(start, self._next_line(header.end)), ""))

    def split(self, path: Path, keys: Iterable[tuple[str, str]]) -> None:
        """Several keys with their values in place of the one at ``path``."""
        entry = self._by_path[path]
        head = self._text[entry.start : entry.parts[-1].span.start]
        lines = [f"{head}{toml_key(name)} = {value}" for name, value in keys]
        if not lines:
            self.remove(path)
            return
        between = ", " if entry.inside is not None else self._line_end + self._indent(entry.start)
        self._changes.append((_Span(entry.start, entry.value.end), between.join(lines)))

    def add(self, table: Path, name: str, value: str) -> None:
        """A new key at the end of ``table``, which is made if it does not exist."""
        text = f"{toml_key(name)} = {value}"
        if table in self._read.braces:
            self._read.braces[table].new.append(text)
            return
        header = next((header for header in self._headers.get(table, []) if header.path == table), None)
        if header is not None:
            last = self._in_table.get(table, [None])[-1]
            at = header.end if last is None else last.value.end
            start = header.parts[0].span.start if last is None else last.start
            self._add_line(at, self._indent(start) + text)
            return
        dotted = [entry for entry in self._outermost(table) if len(entry.table) < len(table)]
        if dotted:
            last = dotted[-1]
            own_part = len(table) - len(last.table)
            text = self._text[last.start : last.parts[own_part].span.start] + text
            if last.inside is not None:
                last.inside.new.append(text)
            else:
                self._add_line(last.value.end, self._indent(last.start) + text)
            return
        self._new_tables.setdefault(table, []).append(text)

    # --- the new text -----------------------------------------------------------------------------------------------

    def result(self) -> str:
        """The text with all changes."""
        for table, lines in self._new_tables.items():
            self._add_table(table, lines)
        changes = [*self._changes, *((_Span(at, at), "".join(lines)) for at, lines in self._added.items())]
        changes.sort(key=_start_of)
        for braces in sorted(self._read.braces.values(), key=lambda one: one.span.end - one.span.start):
            if braces.gone or braces.new:
                first = bisect_left(changes, braces.span.start, key=_start_of)
                behind = bisect_left(changes, braces.span.end, key=_start_of)
                changes[first:behind] = [(braces.span, self._in_braces(braces, changes[first:behind]))]
        return self._changed(_Span(0, len(self._text)), changes)

    def _in_braces(self, braces: _Braces, changes: Sequence[tuple[_Span, str]]) -> str:
        kept = [
            self._changed(_Span(entry.start, entry.value.end), changes)
            for entry in braces.entries
            if entry not in braces.gone
        ]
        return "{ " + ", ".join([*kept, *braces.new]) + " }" if kept or braces.new else "{}"

    def _changed(self, span: _Span, changes: Iterable[tuple[_Span, str]]) -> str:
        found, at = [], span.start
        for place, text in sorted(changes, key=lambda change: (change[0].start, change[0].end)):
            if _is_within(place, span):
                found += [self._text[at : place.start], text]
                at = place.end
        return "".join([*found, self._text[at : span.end]])

    # --- places -------------------------------------------------------------------------------------------------------

    def _value(self, path: Path) -> _Span:
        entry = self._by_path.get(path)
        return self._read.members[path] if entry is None else entry.value

    def _outermost(self, path: Path) -> list[_Entry]:
        """The entries of ``path``, or of the table ``path``, but none inside the braces of another one of them."""
        return [
            entry
            for entry in self._below.get(path, [])
            if entry.inside is None or entry.inside.path[: len(path)] != path
        ]

    def _line_start(self, at: int) -> int:
        return self._text.rfind("\n", 0, at) + 1

    def _next_line(self, at: int) -> int:
        """The start of the line behind that of ``at``; the end of the text if it is the last one."""
        return self._text.find("\n", at) + 1 or len(self._text)

    def _indent(self, at: int) -> str:
        return self._text[self._line_start(at) : at] if not self._text[self._line_start(at) : at].strip() else ""

    def _add_line(self, at: int, line: str) -> None:
        """A line behind that of ``at``."""
        place = self._next_line(at)
        lines = self._added.setdefault(place, [])
        if not lines and not self._text[:place].endswith("\n"):
            lines.append(self._line_end)
        lines.append(line + self._line_end)

    def _add_table(self, table: Path, lines: Sequence[str]) -> None:
        """A new table behind the keys and tables of the one that it belongs to."""
        parent, name = table[:-1], str(table[-1])
        if parent in self._read.braces:
            self._read.braces[parent].new.append(f"{toml_key(name)} = {{ {', '.join(lines)} }}")
            return
        ends = [entry.value.end for entry in self._below.get(parent, [])]
        ends += [header.end for header in self._headers.get(parent, [])]
        at = self._behind_comments(max(ends))
        head = ".".join(toml_key(part) for part in table if isinstance(part, str))
        self._add_line(at, "")
        for line in (f"[{head}]", *lines):
            self._add_line(at, line)

    def _behind_comments(self, at: int) -> int:
        """``at``, or a place in the last of the comment lines that follow, unless they belong to a header below."""
        last, place = at, self._next_line(at)
        while place < len(self._text):
            line = self._text[place : self._next_line(place)].strip()
            if line.startswith("["):
                return at
            if not line.startswith("#"):
                break
            last, place = place, self._next_line(place)
        return last


def _start_of(change: tuple[_Span, str]) -> int:
    return change[0].start


def _is_within(span: _Span, other: _Span) -> bool:
    return other.start <= span.start and span.end <= other.end
