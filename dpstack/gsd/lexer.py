"""Lexer of GSD files: one logical line to one statement, ``keyword(index) = value`` without comment, and its values.

The pattern is possessive throughout, so that a hostile line costs time in proportion to its length. A file repeats many
of its lines (references to parameters above all). So the parser calls :func:`lex` once for each text, and a statement
keeps its parsed value.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final, TypeVar

from msgspec import Struct

from dpstack.gsd.model import Ranges

#: keyword (of several words only in front of "=" or "("), index, equals sign, value
_LINE: Final = re.compile(
    r'[ \t]*+([^\s=(";]++(?:(?:[ \t]++[^\s=(";]++)++(?=[ \t]*+[=(]))?+)?+[ \t]*+'
    r'(?:\(([^()";=]*+)\)[ \t]*+)?+'
    r"(=)?+[ \t]*+"
    r'((?:[^";]++|"[^"]*+"?+)*+)'
)
_NUMBER: Final = r"[+-]?(?:0[xX][0-9a-fA-F]{1,16}|[0-9]{1,20})"
_ONE: Final = re.compile(rf"{_NUMBER}\Z")
_RANGE: Final = re.compile(rf"({_NUMBER})[ \t]*+-[ \t]*+({_NUMBER})\Z")
#: a minus behind a blank belongs to the number behind it, unless a blank follows
_RANGE_IN_FRONT: Final = re.compile(rf"{_NUMBER}(?:-[ \t]*+|[ \t]++-[ \t]++){_NUMBER}[ \t]*+(?:,|\Z)")
_FIRST: Final = re.compile(rf"({_NUMBER})(?![\w.])[ \t,]*+")
_STRING: Final = re.compile(r'"([^"]*+)("?)[ \t]*+')
#: blanks between a value and a comment that lacks its semicolon; behind a comma a list goes on
_BEFORE_REMARK: Final = re.compile(r"""(?<=[^\s,])[ \t]++(?=[^\W\d_]|["'(/*#!])""")
#: most numbers in GSD files are written like this
_COMMON: Final[dict[str, int]] = {
    **{str(n): n for n in range(1000)},
    **{f"0x{n:02x}": n for n in range(256)},
    **{f"0x{n:02X}": n for n in range(256)},
}


class Statement(Struct):
    """One statement. ``keyword`` in lower case, ``written`` as in the file; ``index`` and ``value`` are stripped.

    ``line``: the number of the physical line; the parser sets it anew for each occurrence of the same text. ``item``:
    the parsed value, kept for the next occurrence; False if a block cannot parse it. ``remark``: a comment behind
    the value that lacks its semicolon, see :func:`without_remark`.
    """

    written: str
    keyword: str
    index: str | None
    equals: bool
    value: str
    text: str
    line: int = 0
    item: object = None
    remark: str = ""

    @property
    def column(self) -> int:
        """Column of the value in its logical line, from 1."""
        match = _LINE.match(self.text)
        return 1 if match is None else match.start(4) + 1


def lex(line: str) -> Statement | None:
    """The statement of a logical line; None if it holds blanks or a comment only."""
    match = _LINE.match(line)
    if match is None:  # impossible: every part of the pattern is optional
        return None
    written, index, equals, value = match.groups()
    if written is None:
        if index is None and not equals and not value:
            return None
        written = ""
    index = None if index is None else index.strip()
    return Statement(written, written.lower(), index, equals is not None, value.rstrip(), line)


def number(text: str) -> int | None:
    """A decimal or hexadecimal integer, None for anything else."""
    known = _COMMON.get(text)
    if known is not None:
        return known
    text = text.strip()
    if not _ONE.match(text):
        return None
    return _int(text)


def _int(text: str) -> int:
    return int(text, 16 if "x" in text or "X" in text else 10)


def numbers(text: str) -> list[int] | None:
    """Numbers with commas (or only blanks) between; None if one of them is no number. Empty text: an empty list."""
    try:
        return [_COMMON[part] for part in text.split(",")]
    except KeyError:
        pass
    found: list[int] = []
    for word in text.replace(",", " ").split():
        value = number(word)
        if value is None:
            return None
        found.append(value)
    return found


def ranges(text: str) -> Ranges | None:
    """``0-3``, ``0,1,5``, ``-32768-32767``, ``24 - 24``, or a mix; None for anything else of these."""
    found: list[tuple[int, int]] = []
    for part in text.split(","):
        piece = part.strip()
        if not piece:
            continue
        value = number(piece)
        if value is not None:
            found.append((value, value))
            continue
        match = _RANGE.match(piece)
        if match is None:
            return None
        found.append((_int(match[1]), _int(match[2])))
    return tuple(found)


def first_number(text: str) -> tuple[int | None, str]:
    """(the number in front, the rest behind it); None if no number stands in front."""
    match = _FIRST.match(text)
    return (None, text) if match is None else (_int(match[1]), text[match.end() :])


def ranges_only(text: str) -> Ranges | None:
    """``0-1``, ``5 - 9, 12``: a list of values that begins with a range, so that no number stands in front of it;
    None for anything else. ``0 -1`` is a number and a value.
    """
    match = _RANGE_IN_FRONT.match(text)
    return None if match is None else ranges(text)


_T = TypeVar("_T")


def without_remark(statement: Statement, parse: Callable[[str], _T | None], text: str | None = None) -> _T | None:
    """``parse`` of the statement's value (or of ``text``, a part of it); None if it cannot be parsed.

    Numbers with a text behind them are read without it: it is a comment whose semicolon is missing. The statement keeps
    it as ``remark``, for a warning.
    """
    text = statement.value if text is None else text
    found = parse(text)
    seam = _BEFORE_REMARK.search(text) if found is None else None
    if seam is not None:
        found = parse(text[: seam.start()])
        statement.remark = text[seam.end() :] if found is not None else ""
    return found


def string(text: str) -> tuple[str | None, str, bool]:
    """(the string in front, the rest behind it, its end is there); None if no string stands in front."""
    match = _STRING.match(text)
    if match is None:
        return None, text, True
    return match[1], text[match.end() :], bool(match[2])
