"""Text of others (GSD files, slaves, masters, other programs, file names) for people and as JSON.

Such text may hold octets that a terminal obeys (escape sequences), that turn the direction of what follows, or that
cannot be seen. :func:`printable` and :func:`json_text` are the only two ways by which text leaves the program. Errors
and events (``DpError``, ``Event.text``) are printable of themselves, also in loggers and in programs of others.
"""

from __future__ import annotations

import json
import traceback
import unicodedata
from typing import Final

_MOST_DIGITS: Final = 9
_SHORT: Final = {"\n": "\\n", "\r": "\\r", "\t": "\\t"}


def is_plain(letter: str) -> bool:
    """False for controls (C0, DEL, C1), format characters (bidi, zero width), line separators, lone surrogates."""
    return letter.isprintable() or unicodedata.category(letter) == "Zs"


def printable(text: str) -> str:
    """``text`` as one line: a character that is not plain stands as its escape, for instance ``\\x1b``, ``\\u202e``.

    A backslash of the text stays as it is: the result is for people, not for a parser.
    """
    if text.isprintable():
        return text
    return "".join(letter if is_plain(letter) else _SHORT.get(letter) or escape(letter) for letter in text)


def traceback_text(error: BaseException) -> str:
    """Where ``error`` comes from, as Python shows it: lines of :func:`printable` text."""
    return "\n".join(map(printable, "".join(traceback.format_exception(error)).split("\n"))).removesuffix("\n")


def escape(letter: str) -> str:
    """``letter`` as Python and TOML write it: ``\\x1b``, ``\\u202e``, ``\\U000e0001``."""
    code = ord(letter)
    return f"\\x{code:02x}" if code < 0x100 else long_escape(letter)


def long_escape(letter: str) -> str:
    """As :func:`escape`, with four digits at least: TOML knows no ``\\x``."""
    code = ord(letter)
    return f"\\u{code:04x}" if code < 0x1_0000 else f"\\U{code:08x}"


def decimal(text: str) -> int | None:
    """The number that ``text`` is, in one to nine decimal digits as every number of ours; None for anything else."""
    return int(text) if len(text) <= _MOST_DIGITS and text.isascii() and text.isdigit() else None


def number_or_name(text: str) -> int | str:
    """What people type for a thing that has both: the number where it is one (:func:`decimal`), else the name."""
    number = decimal(text)
    return text if number is None else number


def octets_text(count: int) -> str:
    """So many octets, for people."""
    return f"{count} octet" + ("" if count == 1 else "s")


def shortened(text: str, most: int = 60) -> str:
    """``text``, of which a message shows ``most`` characters."""
    return text if len(text) <= most else text[: most - 3] + "..."


def json_text(value: object, *, encoding: str = "utf-8", **how: object) -> str:
    """``value`` as JSON on one line. What is not plain, or not in ``encoding``, is escaped: the value is the same.

    ``how``: further arguments of :func:`json.dumps`. Raises TypeError for what is no JSON value.
    """
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, **how)  # type: ignore[arg-type]
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        text = json.dumps(value, separators=(",", ":"), **how)  # type: ignore[arg-type]
    if text.isprintable():
        return text
    return "".join(letter if is_plain(letter) else _in_json(letter) for letter in text)


def _in_json(letter: str) -> str:
    return "\\u007f" if letter == "\x7f" else json.dumps(letter)[1:-1]
