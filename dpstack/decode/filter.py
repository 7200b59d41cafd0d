"""Filters over explained telegrams: a small language that is parsed, never evaluated as code.

    sa == 3 and service == Slave_Diag
    station 5 and (retry or error)
    not token and data contains "06 00"

Words: ``number``, ``t`` (seconds since 1970), ``sa``, ``da``, ``dsap``, ``ssap``, ``length`` (octets on the wire) and
``response_us`` are numbers; ``kind``, ``service`` and ``function`` are names, ``text`` is the line in words, upper or
lower case; ``octets`` and ``data`` are hex digits. Comparisons are ``==``, ``!=``, ``<``, ``<=``, ``>``, ``>=`` and
``contains``. By themselves stand ``token``, ``request``, ``answer``, ``retry``, ``repeated``, ``unanswered``, ``late``,
``error``, ``damaged``, ``remark``, and ``station N``, which sends or is addressed. They are joined by ``and``, ``or``,
``not`` and parentheses. Nobody knows that a request is ``unanswered`` before the next telegram: :func:`one_later`.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Final

from dpstack.decode.telegram import Explained
from dpstack.errors import UsageError
from dpstack.fdl.telegram import Kind
from dpstack.units import NS_PER_S

Match = Callable[[Explained], bool]

_TOKEN: Final = re.compile(r"\s*(?:(\(|\)|==|!=|<=|>=|<|>)|\"([^\"]*)\"|([\w.]+))")
#: nested parentheses and nots
_DEEPEST: Final = 50

_NUMBERS: Final[Mapping[str, Callable[[Explained], float | None]]] = {
    "number": lambda one: one.number,
    "t": lambda one: None if one.transmission.t_ns is None else one.transmission.t_ns / NS_PER_S,
    "sa": lambda one: None if one.telegram is None or one.telegram.sa < 0 else one.telegram.sa,
    "da": lambda one: None if one.telegram is None or one.telegram.da < 0 else one.telegram.da,
    "dsap": lambda one: None if one.telegram is None else one.telegram.dsap,
    "ssap": lambda one: None if one.telegram is None else one.telegram.ssap,
    "length": lambda one: len(one.transmission.octets),
    "response_us": lambda one: one.step.response_us,
}
_NAMES: Final[Mapping[str, Callable[[Explained], str]]] = {
    "kind": lambda one: "" if one.telegram is None else one.telegram.kind.name,
    "service": lambda one: one.service,
    "function": lambda one: one.function or "",
    "text": lambda one: one.text,
}
_OCTETS: Final[Mapping[str, Callable[[Explained], bytes]]] = {
    "octets": lambda one: one.transmission.octets,
    "data": lambda one: b"" if one.telegram is None else one.telegram.data,
}
_FLAGS: Final[Mapping[str, Match]] = {
    "token": lambda one: one.telegram is not None and one.telegram.kind is Kind.SD4,
    "request": lambda one: one.telegram is not None and one.telegram.is_request,
    "answer": lambda one: one.step.answer_to is not None,
    "retry": lambda one: one.step.retry_of is not None,
    "repeated": lambda one: one.step.repeated_poll_of is not None,
    "unanswered": lambda one: one.unanswered,
    "late": lambda one: one.step.late,
    "error": lambda one: one.error is not None,
    "damaged": lambda one: one.telegram is None or bool(one.transmission.damage),
    "remark": lambda one: bool(one.step.remarks),
}
_COMPARE: Final[Mapping[str, Callable[[float, float], bool]]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_WORDS: Final = (*_NUMBERS, *_NAMES, *_OCTETS, *_FLAGS, "station", "not")


def parse_filter(text: str) -> Match:
    """A function that says whether a telegram passes. Raises UsageError that names the place in ``text``."""
    return _Parser(text).whole()


def one_later(explained: Iterable[Explained]) -> Iterator[Explained]:
    """Each telegram when the next one has been explained, so that a filter knows whether it was answered."""
    before: Explained | None = None
    for one in explained:
        if before is not None:
            yield before
        before = one
    if before is not None:
        yield before


class _Parser:
    def __init__(self, text: str) -> None:
        self._text = text
        self._words: list[tuple[str, bool, int]] = []  # word, in quotes, place
        self._next = 0
        self._deep = 0
        at = 0
        while text[at:].strip():
            found = _TOKEN.match(text, at)
            if found is None:
                rest = text[at:].lstrip()
                raise self._wrong(f"{rest[0]!r} means nothing here", len(text) - len(rest))
            sign, quoted, word = found.groups()
            self._words.append((sign or word or quoted or "", quoted is not None, found.start(found.lastindex or 0)))
            at = found.end()

    def _wrong(self, what: str, at: int | None = None) -> UsageError:
        place = len(self._text) if at is None else at
        return UsageError(f"filter: {what} (character {place + 1} of {self._text!r})")

    def _peek(self) -> str:
        if self._next >= len(self._words):
            return ""
        word, quoted, _ = self._words[self._next]
        return "" if quoted else word

    def _take(self, wanted: str) -> tuple[str, bool, int]:
        if self._next >= len(self._words):
            raise self._wrong(f"{wanted} is missing at the end")
        self._next += 1
        return self._words[self._next - 1]

    def whole(self) -> Match:
        match = self._either()
        if self._next < len(self._words):
            word, _, at = self._words[self._next]
            raise self._wrong(f"{word!r}: 'and' or 'or' is wanted before it", at)
        return match

    def _either(self) -> Match:
        return self._joined("or", self._both, any)

    def _both(self) -> Match:
        return self._joined("and", self._one, all)

    def _joined(self, word: str, inner: Callable[[], Match], hold: Callable[[Iterable[bool]], bool]) -> Match:
        parts = [inner()]
        while self._peek() == word:
            self._next += 1
            parts.append(inner())
        return parts[0] if len(parts) == 1 else lambda one: hold(part(one) for part in parts)

    def _one(self) -> Match:
        word, quoted, at = self._take("a condition")
        self._deep += 1
        if self._deep > _DEEPEST:
            raise self._wrong("too deep, more than 50 parentheses", at)
        match = self._condition(word, at) if not quoted else None
        self._deep -= 1
        if match is None:
            near = get_close_matches(word, _WORDS, 1)
            hint = f"do you mean {near[0]!r}?" if near else f"one of {', '.join(_WORDS)} is wanted"
            raise self._wrong(f"{word!r} is no word of a filter; {hint}", at)
        return match

    def _condition(self, word: str, at: int) -> Match | None:
        if word == "not":
            inner = self._one()
            return lambda one: not inner(one)
        if word == "(":
            inner = self._either()
            closing, _, place = self._take("')'")
            if closing != ")":
                raise self._wrong(f"{closing!r} where ')' is wanted", place)
            return inner
        if word == "station":
            number = self._number("a station address")
            return lambda one: one.telegram is not None and number in (one.telegram.sa, one.telegram.da)
        if word in _FLAGS:
            return _FLAGS[word]
        if word in _NUMBERS:
            return self._compared(word, at)
        if word in _NAMES or word in _OCTETS:
            return self._text_compared(word)
        return None

    def _number(self, what: str) -> float:
        text, _, at = self._take(what)
        try:
            return int(text, 0) if not re.fullmatch(r"\d+\.\d*", text) else float(text)
        except ValueError:
            raise self._wrong(f"{text!r} is no number", at) from None

    def _compared(self, word: str, at: int) -> Match:
        read = _NUMBERS[word]
        sign, _, place = self._take("a comparison (==, !=, <, <=, >, >=)")
        if sign not in _COMPARE:
            raise self._wrong(f"{sign!r} after {word!r} is no comparison: ==, !=, <, <=, >, >=", place)
        compare, value = _COMPARE[sign], self._number("a number")

        def match(one: Explained) -> bool:
            found = read(one)
            return found is not None and compare(found, value)

        return match

    def _text_compared(self, word: str) -> Match:
        sign, _, place = self._take("a comparison (==, !=, contains)")
        if sign not in ("==", "!=", "contains"):
            raise self._wrong(f"{sign!r} after {word!r} is no comparison: ==, !=, contains", place)
        text, _, at = self._take("a name" if word in _NAMES else "hex digits")
        if word in _NAMES:
            name, wanted = _NAMES[word], text.lower()
            if sign == "contains":
                return lambda one: wanted in name(one).lower()
            return lambda one: (name(one).lower() == wanted) is (sign == "==")
        try:
            octets = bytes.fromhex(text)
        except ValueError:
            raise self._wrong(f"{text!r} are no octets in hex, two digits each", at) from None
        read = _OCTETS[word]
        if sign == "contains":
            return lambda one: octets in read(one)
        return lambda one: (read(one) == octets) is (sign == "==")
