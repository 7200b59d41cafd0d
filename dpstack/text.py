"""Escaping of foreign text (GSD files, slaves, masters, other programs, file names) for people and in JSON.

Such text may hold escape sequences of terminals, characters that change the direction of writing, or invisible ones.
All text leaves the program through :func:`printable` or :func:`json_text`. The texts of errors and events (``DpError``,
``Event.text``) are always printable, also in loggers and in other programs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from enum import Enum, IntEnum
from functools import cache
from typing import Final, Self

_MOST_DIGITS: Final = 9
_OF_NUMBERS: Final = "0123456789."
_SEPARATORS: Final = (",", ":")
#: the characters of Unicode's category Zs; to Python only U+0020 of them is printable
_BLANKS: Final = frozenset("\xa0\u1680\u202f\u205f\u3000") | {chr(code) for code in range(0x2000, 0x200B)}
#: a piece of text in octets of a device: ASCII, and the letters of Latin-1; compiled with the first block of octets
_PIECE: Final = rb"[\x20-\x7e\xc0-\xff]{4,}"
_LETTER: Final = rb"[A-Za-z]"
_IN_WORDS: Final = rb"[A-Za-z0-9 ]"
#: from this many octets on, a block of nothing but characters is shown without its octets in hex
_SURELY_TEXT: Final = 8
_SHORT: Final = {"\n": "\\n", "\r": "\\r", "\t": "\\t"}


class NamedInt(IntEnum):
    """Numbers of a standard with names: as text ``Mode.OPERATE``, in calculations and with ``:02X`` the number."""

    def __str__(self) -> str:
        return f"{type(self).__name__}.{self.name}"

    def __format__(self, spec: str) -> str:
        return int.__format__(self, spec) if spec else str(self)


class TextEnum(Enum):
    """An enum whose members have a text for people behind their value: ``LATE = "late", "by this computer"``."""

    text: str

    def __new__(cls, value: str, text: str) -> Self:
        member = object.__new__(cls)
        member._value_ = value
        member.text = text
        return member


def is_plain(letter: str) -> bool:
    """False for controls (C0, DEL, C1), format characters (bidi, zero width), line separators, lone surrogates."""
    return letter.isprintable() or letter in _BLANKS


def printable(text: str) -> str:
    """``text`` as one line: a character that is not plain stands as its escape, for instance ``\\x1b``, ``\\u202e``.

    A backslash of the text stays as it is: the result is for people, not for a parser.
    """
    if text.isprintable():
        return text
    return "".join(letter if is_plain(letter) else _SHORT.get(letter) or escape(letter) for letter in text)


def traceback_text(error: BaseException) -> str:
    """The traceback of ``error`` in lines of :func:`printable` text."""
    import traceback  # here, as most programs have none to show

    return "\n".join(map(printable, "".join(traceback.format_exception(error)).split("\n"))).removesuffix("\n")


def escape(letter: str) -> str:
    """``letter`` as Python and TOML write it: ``\\x1b``, ``\\u202e``, ``\\U000e0001``."""
    code = ord(letter)
    return f"\\x{code:02x}" if code < 0x100 else long_escape(letter)


def long_escape(letter: str) -> str:
    """Like :func:`escape`, with at least four digits: TOML has no ``\\x``."""
    code = ord(letter)
    return f"\\u{code:04x}" if code < 0x1_0000 else f"\\U{code:08x}"


def decimal(text: str) -> int | None:
    """The number of one to nine decimal digits in ``text``; None for anything else."""
    return int(text) if len(text) <= _MOST_DIGITS and text.isascii() and text.isdigit() else None


def number_or_name(text: str) -> int | str:
    """The user's input for a thing with number and name: the number (:func:`decimal`) or the name."""
    number = decimal(text)
    return text if number is None else number


def octets_text(count: int) -> str:
    """``1 octet``, ``5 octets``."""
    return f"{count} octet" + ("" if count == 1 else "s")


def runs_of(numbers: Iterable[int]) -> list[tuple[int, int]]:
    """The first and the last of the runs of ``numbers``: of 4, 1, 2, 3, 6 they are (1, 4) and (6, 6)."""
    runs: list[tuple[int, int]] = []
    for number in sorted(set(numbers)):
        if runs and number == runs[-1][1] + 1:
            runs[-1] = runs[-1][0], number
        else:
            runs.append((number, number))
    return runs


def readable(octets: bytes) -> str:
    """The text that a device put into ``octets``, as one printable line; empty if they hold none.

    A piece has four characters or more, two of them letters of ASCII, and most of them such letters, digits and blanks.
    """
    pieces = (piece for piece in re.findall(_PIECE, octets) if _is_text(piece))
    return " ... ".join(printable(piece.decode("latin-1").strip()) for piece in pieces)


def _is_text(piece: bytes) -> bool:
    return len(re.findall(_LETTER, piece)) >= 2 and 2 * len(re.findall(_IN_WORDS, piece)) > len(piece)


def octets_in_words(octets: bytes) -> str:
    """Octets of a device for people: in hex; text in them in quotes before that, and alone if there is nothing else."""
    text = readable(octets)
    if not text:
        return octets.hex(" ")
    rest = octets.rstrip(b"\0 ").lstrip(b" ")
    if len(rest) >= _SURELY_TEXT and rest == text.encode("latin-1", "replace"):
        return f'"{text}"'
    return f'"{text}" ({octets.hex(" ")})'


def times_text(count: int) -> str:
    """``once``, ``5 times``."""
    return "once" if count == 1 else f"{count} times"


def some_of(labels: Iterable[str], shown: int = 3) -> str:
    """The first ``shown`` labels, and the number of the others."""
    listed = list(labels)
    more = len(listed) - shown
    return ", ".join(listed[:shown]) + (f" and {more} more" if more > 0 else "")


def shortened(text: str, most: int = 60) -> str:
    """``text`` cut to ``most`` characters, but not within a number, which would become another one."""
    if len(text) <= most:
        return text
    kept = text[: most - 3]
    if text[most - 3] in _OF_NUMBERS:
        kept = kept.rstrip(_OF_NUMBERS) or kept
    return f"{kept}..."


def brief(value: object) -> str:
    """``value`` in a message about it: its representation, cut if it would hide what follows."""
    return shortened(repr(value))


def nearest(word: str, known: Iterable[str], cutoff: float = 0.5) -> str | None:
    """The one of ``known`` that ``word`` may mean; None if no word comes near (``cutoff``, 1: the same)."""
    import difflib  # here, as most names are right

    return next(iter(difflib.get_close_matches(word, list(known), n=1, cutoff=cutoff)), None)


def did_you_mean(word: str, known: Iterable[str], otherwise: str, *, quoted: bool = False) -> str:
    """``did you mean speed?`` where one of ``known`` comes near to ``word``, ``otherwise`` where none does."""
    near = nearest(word, known)
    return otherwise if near is None else f"did you mean {near!r}?" if quoted else f"did you mean {near}?"


def iso_time(wall_s: float) -> str:
    """A time since 1970 in s as ISO text with ms and Z."""
    return datetime.fromtimestamp(wall_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def json_text(value: object, *, encoding: str = "utf-8", **how: object) -> str:
    """``value`` as JSON on one line. Characters that are not plain, or not in ``encoding``, are escaped.

    ``how``: further arguments of :func:`json.dumps`. Raises TypeError for values that JSON does not have.
    """
    if not how:
        text = _to_json()(value)
        if text.isascii() and "\x7f" not in text:  # JSON has escaped the other controls
            return text
    import json

    if how:
        text = json.dumps(value, separators=_SEPARATORS, ensure_ascii=False, **how)  # type: ignore[arg-type]
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        text = json.dumps(value, separators=_SEPARATORS, **how)  # type: ignore[arg-type]
    if text.isprintable():
        return text
    return "".join(letter if is_plain(letter) else _in_json(letter) for letter in text)


@cache  # json.dumps makes an encoder a call
def _to_json() -> Callable[[object], str]:
    import json  # here, as a bus process writes none

    return json.JSONEncoder(separators=_SEPARATORS, ensure_ascii=False, check_circular=False).encode


def _in_json(letter: str) -> str:
    import json

    return "\\u007f" if letter == "\x7f" else json.dumps(letter)[1:-1]
