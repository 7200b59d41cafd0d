"""Search in GSD files by words: ident number, order number, model, vendor, names of modules, name of the file.

Case, blanks and punctuation do not count; a word that begins with a digit does not begin within a number (``4DI`` is
not in ``24DI``). Order numbers in GSD files have placeholders (``6ES7 151-1BA0*-0AB0``,
``6ES7 132-0BL0.-0XB0``, ``6SL3040-0xA00-0xxx``), which fit any character.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import Final, NamedTuple

from dpstack.gsd.model import Device, Module

_PLACEHOLDERS: Final = frozenset("*.?x")
#: characters of an order number that are no placeholders, so that it says something
_LEAST_LITERAL: Final = 4
_IDENT: Final = re.compile(r"(?:0x|(?:W#)?16#)?([0-9a-f]{3,4})h?", re.IGNORECASE)
_DROPPED: Final = re.compile(r"[\W_]+")
_MOST_MODULES: Final = 100


class Field(IntEnum):
    """A field that a word is looked for in; the higher number is the better place."""

    FILE = 1
    MODULE = 2
    VENDOR = 3
    MODEL = 4
    ORDER_NUMBER = 5
    IDENT = 6

    @property
    def title(self) -> str:
        """The field in words."""
        return self.name.lower().replace("_", " ")


class Match(NamedTuple):
    """The text of a field in which a word was found. ``reference``: the number of a module, None without one."""

    field: Field
    text: str
    reference: int | None = None


class Found(NamedTuple):
    """A device in which every word was found. ``score``: the higher, the better it fits."""

    score: int
    matches: tuple[Match, ...]


def compact(text: str) -> str:
    """``text`` for comparisons: lower case, letters and digits only."""
    return _DROPPED.sub("", text.casefold())


def _order_pattern(order_number: str) -> str:
    """An order number for comparisons: ``?`` for each placeholder; an ``X`` is a letter, as in 0XB0."""
    kept = (letter for letter in order_number if letter.isalnum() or letter in _PLACEHOLDERS)
    return "".join("?" if letter in _PLACEHOLDERS else letter.lower() for letter in kept)


def _fits_at(pattern: str, number: str, at: int) -> int:
    """How many characters of ``number`` (:func:`compact`) stand in ``pattern`` from ``at`` on; 0 if one differs."""
    part = pattern[at : at + len(number)]
    pairs = zip(part, number, strict=False)
    if len(part) < len(number) or any(one != other and "?" not in (one, other) for one, other in pairs):
        return 0
    return sum(one == other != "?" for one, other in zip(part, number, strict=True))


def order_number_fits(order_number: str, wanted: str) -> int:
    """How well the ``OrderNumber`` of a GSD file fits the whole order number ``wanted`` of a device.

    0: it does not fit; otherwise the number of characters that are no placeholders. A file may list several numbers
    with ``/`` between them, and end with ``*`` for any further characters. ``?`` in ``wanted`` is any character, too.
    """
    number = "".join(letter.lower() for letter in wanted if letter.isalnum() or letter == "?")
    best = 0
    for one in order_number.split("/"):
        pattern = _order_pattern(one)
        if one.rstrip().endswith("*") and len(pattern) < len(number):
            pattern = pattern.ljust(len(number), "?")
        if len(pattern) == len(number):
            best = max(best, _fits_at(pattern, number, 0))
    return best if best >= _LEAST_LITERAL else 0


def _order_has(order_number: str, word: str) -> bool:
    """Whether ``word`` is a part of the order number, whose placeholders fit any character."""
    pattern = _order_pattern(order_number)
    least = max(min(_LEAST_LITERAL, len(word)), len(word) // 2)
    return any(_fits_at(pattern, word, at) >= least for at in range(len(pattern) - len(word) + 1))


def _is_ident(ident: int | None, word: str) -> bool:
    match = _IDENT.fullmatch(word)
    return ident is not None and match is not None and int(match[1], 16) == ident


class _Word:
    """One word of a query."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.small = compact(text)
        number = "(?<![0-9])" if self.small[0].isdigit() else ""
        self._pattern = re.compile(number + r"[\W_]*".join(map(re.escape, self.small)))

    def is_in(self, text: str) -> bool:
        return self._pattern.search(text.casefold()) is not None

    def score(self, field: Field, text: str) -> int:
        """A better field first, then the whole field before a part of it."""
        return 2 * field + (self.small == compact(text))


class Query:
    """The words of a search, every one of which must be found. Words without letters and digits do not count."""

    def __init__(self, words: Iterable[str]) -> None:
        self._words = tuple(_Word(word) for word in words if compact(word))

    def __bool__(self) -> bool:
        return bool(self._words)

    def may_be_in(self, text: str, ident: int | None, order_number: str, file: str) -> bool:
        """False if :meth:`search` finds nothing in the file with this ``text``: much quicker than to parse it."""
        whole = f"{compact(text)} {compact(file)}"
        return all(
            word.small in whole or _is_ident(ident, word.text) or _order_has(order_number, word.small)
            for word in self._words
        )

    def search(self, device: Device, file: str) -> Found | None:
        """The best place of each word; None if one of them is nowhere. ``file``: the name of its file."""
        texts = {Field.MODEL: device.model, Field.VENDOR: device.vendor, Field.FILE: file}
        matches: dict[Match, None] = {}
        score, of_modules = 0, []
        for word in self._words:
            match = None
            if _is_ident(device.ident, word.text):
                match = Match(Field.IDENT, f"0x{device.ident:04X}")
            elif _order_has(device.order_number, word.small):
                match = Match(Field.ORDER_NUMBER, device.order_number)
            else:
                match = next((Match(*one) for one in texts.items() if word.is_in(one[1])), None)
            if match is not None and match.field is not Field.FILE:
                matches[match] = None
                score += word.score(match.field, match.text)
            elif any(word.is_in(module.name) for module in device.modules):
                of_modules.append(word)
            elif match is not None:
                matches[match] = None
                score += word.score(match.field, match.text)
            else:
                return None
        modules = _modules_with(device.modules, of_modules)
        for module in modules[:_MOST_MODULES]:
            matches[Match(Field.MODULE, module.name, module.reference)] = None
        score += sum(word.score(Field.MODULE, modules[0].name) for word in of_modules)
        return Found(score, tuple(sorted(matches, key=lambda match: -match.field)))


def _modules_with(modules: Sequence[Module], words: Sequence[_Word]) -> list[Module]:
    """The modules whose names have the most of ``words``, shorter names first."""
    counts = [(sum(word.is_in(module.name) for word in words), module) for module in modules] if words else []
    most = max((count for count, _ in counts), default=0)
    return sorted((one for count, one in counts if count and count == most), key=lambda one: len(one.name))
