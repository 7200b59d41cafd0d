"""TOML reader with limits and the line of every key (which tomllib does not give), and the writer of tables.

tomllib takes quadratic time for a key of many parts, recurses with every bracket and lets Python's refusal of very long
numbers through. One pass over the tokens refuses such texts before tomllib sees them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from dpstack.errors import ConfigError
from dpstack.text import brief, is_plain, long_escape, printable

if TYPE_CHECKING:
    import tomllib

#: ("bus", "port") or ("slave", 0, "address"); a table itself is ("bus",) or ("slave", 0)
Path = tuple[str | int, ...]

#: a plant of 125 slaves has some 50 kB, a list of 10000 parameters 2 MB
MAX_OCTETS: Final = 4_000_000
MAX_DEPTH: Final = 32
MAX_PARTS: Final = 16
#: characters of a number, a date or a key without quotes
MAX_BARE: Final = 255

#: possessive throughout: every character is looked at once
TOKEN: Final = re.compile(
    r'''(?P<string>"""(?:[^"\\]++|\\.|"(?!""))*+(?:""""{0,2}+)?+
    |\'\'\'(?:[^\']++|\'(?!\'\'))*+(?:\'\'\'\'{0,2}+)?+
    |"(?:[^"\\\n]++|\\[^\n])*+"?+|\'[^\'\n]*+\'?+)
    |(?P<bare>[^\s"\'\#\[\]{}=,.]++)
    |(?P<newline>\n)
    |(?P<nothing>\#[^\n]*+|[^\S\n]++)
    |(?P<mark>.)''',
    re.VERBOSE | re.DOTALL,
)
#: compiled with their first use: to be written, and in files with an error
_BARE_KEY: Final = r"[A-Za-z0-9_-]+"
_PLACE: Final = r"(?s)^(.*?)\s*\(at (?:line (\d+), column (\d+)|end of document)\)$"


class TomlError(ValueError):
    """``what`` is wrong in ``line`` (from 1), at ``column`` if that is known."""

    def __init__(self, line: int, what: str, column: int | None = None) -> None:
        self.line = line
        self.column = column
        self.what = " ".join(what.split())
        super().__init__(f"{self.what} (line {line})")


def read_toml(text: str) -> tuple[dict[str, Any], dict[Path, int]]:
    """The values of ``text``, and the line (from 1) of every table and key. Raises TomlError."""
    if len(text) > MAX_OCTETS:
        raise TomlError(1, f"the file has more than {MAX_OCTETS // 1_000_000} MB")
    lines = line_numbers(text)
    import tomllib  # here, as a bus that a program describes has no file

    try:
        return tomllib.loads(text), lines
    except tomllib.TOMLDecodeError as error:
        raise _located(error, text) from None
    except (ValueError, RecursionError) as error:
        raise TomlError(1, f"a value cannot be read ({error})") from None


def line_numbers(text: str) -> dict[Path, int]:
    """The line (from 1) of every table and key of ``text``. Raises TomlError beyond the limits.

    Keys inside inline tables are not listed: the line of the key that holds them is the nearest there is.
    """
    walk = _Walk()
    for match in TOKEN.finditer(text):
        kind, token = match.lastgroup, match[0]
        if kind == "newline":
            walk.newline()
        elif kind == "mark":
            walk.mark(token)
        elif kind != "nothing":
            if kind == "bare" and len(token) > MAX_BARE:
                raise TomlError(walk.line, f"a number or a key of {len(token)} characters; {MAX_BARE} is the most")
            walk.word(token)
            if kind == "string":
                walk.line += token.count("\n")
    return walk.lines


class _Walk:
    """Token by token: in a header, in a key, or in a value, and how deep."""

    def __init__(self) -> None:
        self.line = 1
        self.lines: dict[Path, int] = {}
        self._counts: dict[Path, int] = {}
        self._prefix: Path = ()
        self._parts: list[str] = []
        self._points = 0
        self._depth = 0
        self._brackets = 0  # of a header
        self._in_value = False

    def newline(self) -> None:
        self.line += 1
        self._points = 0
        if not self._depth:
            self._in_value = False
            self._brackets = 0
            self._parts = []

    def word(self, token: str) -> None:
        """A string, a number or a bare key."""
        # more words are no key: they have no points between them, and tomllib refuses them
        if not self._in_value and len(self._parts) <= MAX_PARTS:
            self._parts.append(unquoted(token))

    def mark(self, mark: str) -> None:
        if mark == ".":
            self._points += 1
            if self._points >= MAX_PARTS:
                raise TomlError(self.line, f"a key of more than {MAX_PARTS} parts")
            return
        self._points = 0
        if self._in_value:
            self._depth = max(0, self._depth + (mark in "[{") - (mark in "]}"))
            if self._depth > MAX_DEPTH:
                raise TomlError(self.line, f"brackets in each other, more than {MAX_DEPTH} deep")
        elif mark == "=":
            path = self._prefix
            for part in self._parts:
                path = (*path, part)
                self.lines.setdefault(path, self.line)
            self._in_value = True
        elif mark == "[" and not self._parts:
            self._brackets += 1
        elif mark == "]" and self._brackets:
            self._header(array=self._brackets > 1)
            self._in_value = True  # the rest of the line belongs to no key

    def _header(self, *, array: bool) -> None:
        """A part that names an array of tables means its last element."""
        path: Path = ()
        for depth, part in enumerate(self._parts):
            path = (*path, part)
            if array and depth == len(self._parts) - 1:
                self._counts[path] = self._counts.get(path, -1) + 1
            if path in self._counts:
                path = (*path, self._counts[path])
        self._prefix = path
        self.lines.setdefault(path, self.line)
        self.lines.setdefault(tuple(part for part in path if isinstance(part, str)), self.line)


def unquoted(token: str) -> str:
    """The part of a key that ``token`` stands for."""
    if not token.startswith('"'):
        return token.strip("'")
    try:
        import json  # here, as most keys are bare

        return str(json.loads(token))
    except ValueError:  # an escape that JSON does not have
        return token.strip('"')


def _located(error: tomllib.TOMLDecodeError, text: str) -> TomlError:
    match = re.match(_PLACE, str(error))
    if match is None:
        return TomlError(1, str(error))
    if match[2]:
        return TomlError(int(match[2]), match[1], int(match[3]))
    return TomlError(text.count("\n", 0, len(text.rstrip("\n"))) + 1, match[1])


def quoted(text: str) -> str:
    """A TOML string; what is not plain stands as its escape. Raises ConfigError for what TOML cannot hold."""
    if any("\ud800" <= letter <= "\udfff" for letter in text):
        raise ConfigError(f"{text!r} is no Unicode text, as a TOML file must be; rename it")
    import json  # here, as a reader writes nothing

    written = json.dumps(text, ensure_ascii=False)
    return "".join(letter if is_plain(letter) else long_escape(letter) for letter in written)


def toml_key(key: str) -> str:
    """``key`` as TOML, in quotes only if it needs them."""
    return key if re.fullmatch(_BARE_KEY, key) else quoted(key)


def toml_value(value: object, depth: int = 1) -> str:
    """``value`` as TOML: a text, a number, true or false, octets as a text of hex, a list, a mapping as inline table.

    Raises ConfigError for anything else, and for brackets deeper than the reader takes; ``depth``: those around it.
    """
    if depth > MAX_DEPTH:
        raise ConfigError(f"brackets in each other, more than {MAX_DEPTH} deep; a configuration needs three")
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return quoted(value)
        case int() | float():
            return repr(value)
        case bytes():
            return quoted(value.hex(" ").upper())
        case Mapping():
            inside = ", ".join(f"{quoted(str(key))} = {toml_value(one, depth + 1)}" for key, one in value.items())
            return f"{{ {inside} }}" if inside else "{}"
        case Sequence():
            return "[" + ", ".join(toml_value(one, depth + 1) for one in value) + "]"
    raise ConfigError(
        f"{brief(value)} cannot stand in a TOML file; give a text, a number, true or false, a list or a table"
    )


def table_lines(header: str, keys: Mapping[str, object], remarks: Mapping[str, str] | None = None) -> list[str]:
    """The lines of a table: ``header`` ("[bus]"), then one key a line; None is left out, ``ident`` stands in hex.

    ``remarks``: by key, the comment behind it. Raises ConfigError as :func:`toml_value`.
    """
    lines = [header]
    for key, value in keys.items():
        if value is None:
            continue
        text = f"0x{value:04X}" if key == "ident" and type(value) is int and value >= 0 else toml_value(value)
        remark = (remarks or {}).get(key)
        lines.append(f"{toml_key(key)} = {text}" + (f"  {comment(remark)}" if remark else ""))
    return lines


def comment(text: str) -> str:
    """``text`` as a comment on one line, whatever it holds."""
    return f"# {printable(text)}"
