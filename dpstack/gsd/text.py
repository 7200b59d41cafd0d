"""From the octets of a file to its logical lines: decoding, line ends, continuations.

``\\`` at the end of a line (blanks or a comment may follow) joins the next one to it, also inside a string. At such a
seam inside a string several blanks become one: they belong to the layout of the file, not to the text.

CR CR LF ends one line. In a file with other line ends it counts as two, as editors have it: a program that rewrites
line ends makes two of it, and the lines of such a copy have the same numbers.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from typing import Final

from msgspec import Struct

#: Limits far above every known GSD file (the largest one has 9372 lines). The parser refuses larger files.
MAX_OCTETS: Final = 8_000_000
MAX_LINES: Final = 200_000
MAX_LOGICAL: Final = 65_536

_CP1252: Final = "".join(
    bytes((n,)).decode("cp1252", "replace").replace("\ufffd", chr(n)) for n in range(256)
)  # the five holes of CP1252 as Latin-1 has them
#: the part of a line before its comment or its closing backslash: strings whole, an open one to its end
_PLAIN: Final = re.compile(r'(?:[^"\\;]++|"[^"]*+"|\\(?![ \t]*(?:;|$)))*+')
_SEAM: Final = re.compile(r"\\[ \t]*(?:;.*)?$")
#: stands for the empty line between CR and CR LF
_HALF: Final = "\f"


class Text(Struct, frozen=True):
    """Decoded text. ``lines``: logical lines, from the file's first. ``numbers``: the physical line (from 1) where each
    of them begins. ``cut``: a physical line that had to be left incomplete, 0 for none.
    """

    lines: list[str]
    numbers: Sequence[int]
    encoding: str
    cut: int = 0


def decode(octets: bytes) -> tuple[str, str]:
    """(text, encoding): UTF-8 with BOM, UTF-16 with BOM, strict UTF-8, else CP1252. Never fails."""
    if octets.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return octets.decode("utf-16", "replace"), "utf-16"
    if octets.isascii():
        return octets.decode("ascii"), "ascii"
    encoding = "utf-8-sig" if octets.startswith(codecs.BOM_UTF8) else "utf-8"
    try:
        return octets.decode(encoding), encoding
    except UnicodeDecodeError:
        return codecs.charmap_decode(octets.removeprefix(codecs.BOM_UTF8), "strict", _CP1252)[0], "cp1252"


def read_text(octets: bytes) -> Text:
    """Logical lines of ``octets`` (at most :data:`MAX_OCTETS`)."""
    text, encoding = decode(octets)
    text = text.rstrip("\0\x1a")  # DOS ended files with these
    strays = text.count("\r\r\n") < text.count("\n")
    for end, by in (
        ("\v", "\n"),
        ("\f", "\n"),
        ("\r\r\n", f"\n{_HALF}\n" if strays else "\n"),
        ("\r\n", "\n"),
        ("\r", "\n"),
    ):
        text = text.replace(end, by)
    physical = text.split("\n")
    numbers: Sequence[int] = range(1, len(physical) + 1)
    if _HALF in text:
        numbers = [number for number, line in enumerate(physical, 1) if line != _HALF]
        physical = [line for line in physical if line != _HALF]
    if "\\" not in text:
        return Text(physical, numbers, encoding)
    return _joined(physical, numbers, encoding)


def _joined(physical: list[str], physical_numbers: Sequence[int], encoding: str) -> Text:
    lines: list[str] = []
    numbers: list[int] = []
    cut = at = 0
    for first in [at for at, line in enumerate(physical) if "\\" in line]:
        if first < at:
            continue  # joined already
        lines += physical[at:first]
        numbers += physical_numbers[at : first + 1]
        parts: list[str] = []
        length = 0
        inside = False  # a string is open at the end of parts
        listing = False  # parts end in the middle of a list
        goes_on = True
        at = first
        while goes_on and at < len(physical):
            line = physical[at]
            at += 1
            if listing and line.lstrip(" \t").startswith(";"):
                continue  # a comment between the lines of a list that goes on
            head, inside, goes_on = _split(line, inside)
            parts.append(_behind_seam(head, parts[-1]) if parts else head)
            length += len(head)
            listing = not inside and parts[-1].rstrip().endswith((",", "="))
            if length > MAX_LOGICAL:
                cut, goes_on = cut or physical_numbers[at - 1], False
        lines.append("".join(parts))
    return Text(lines + physical[at:], [*numbers, *physical_numbers[at:]], encoding, cut)


def _behind_seam(head: str, before: str) -> str:
    bare = head.lstrip(" \t")
    return bare if bare == head or before.endswith(" ") else " " + bare


def _split(line: str, inside: bool) -> tuple[str, bool, bool]:
    """(text that this line adds, whether a string is open behind it, whether the next line belongs to it)."""
    at = 0
    if inside:
        close = line.find('"')
        if close < 0:
            return _open_string(line, 0)
        at = close + 1
    plain = _PLAIN.match(line, at)
    end = plain.end() if plain else at
    if end < len(line) and line[end] == '"':
        return _open_string(line, end)
    if end < len(line) and line[end] == "\\":
        return line[:end] + " ", False, True
    return line, False, False


def _open_string(line: str, start: int) -> tuple[str, bool, bool]:
    """Split a line whose string is open at ``start``; it goes on in the next line if a backslash ends this one."""
    slash = line.rfind("\\")
    if slash < start or not _SEAM.match(line, slash):
        # a comment with a backslash of its own behind the seam
        slash = next((m.start() for m in re.finditer(r"\\[ \t]*;", line[start:])), -1)
        if slash < 0:
            return line, False, False
        slash += start
    head = line[:slash]
    kept = head.rstrip(" \t")
    return (kept + " " if kept != head else kept), True, True
