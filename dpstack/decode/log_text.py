"""Octets in the lines of logs as people paste them: columns with times, words of direction, hex dumps, lists of code.

A line that is nothing but hex digits is octets. In other lines octets count if they make a telegram with a check
sequence, if a word of direction stands before them (``TX``, ``->``), or if only times and numbers do. The forms
of such lines are listed in docs/how-to/decode.md. Every other line is reported to the caller.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from typing import Final, NamedTuple

from dpstack.capture.cutter import Cutter, split
from dpstack.capture.transmission import Transmission
from dpstack.errors import UsageError
from dpstack.fdl.codec import decode, parse
from dpstack.fdl.telegram import ED, Kind, Telegram
from dpstack.text import printable, shortened

#: what may stand between hex digits
_BETWEEN: Final = re.compile(r"0x|[\s,;:-]+", re.IGNORECASE)
#: values of STEP 7 and TIA: B#16#08, W#16#0C00, 16#08
_STEP7: Final = re.compile(r"(?<![0-9A-Za-z#])(?:(B|W|DW|L)#)?16#_?([0-9A-Fa-f_]+)", re.IGNORECASE)
_STEP7_OCTETS: Final = {"B": 1, "W": 2, "DW": 4, "L": 8}
#: one word of octets: 68, 0x68, 68h, $68, 680505, 68-05-05-68; the digits stand without what is between them
_OCTETS: Final = re.compile(r"(?:0x|&h|\$|\\x)?[0-9a-f]{2}(?:[-:]?(?:0x|\\x)?[0-9a-f]{2})*h?", re.IGNORECASE)
_PREFIX: Final = re.compile(r"0x|&h|\$|\\x|[-:h]", re.IGNORECASE)
_NO_OCTETS: Final = re.compile(
    r"\d{1,2}:\d{2}(:\d{2})?([.,:]\d+)?|\d{4}-\d{2}-\d{2}(T.*)?|\d{1,2}[-./]\d{1,2}[-./]\d{2,4}"  # times, dates
)
_WORD: Final = re.compile(r"[|()\[\]{}]|[^\s,;|()\[\]{}]+")
_AROUND: Final = "<>\"'„“”«»"
#: octets with a sign between all of them: 10|05|02, <10><05><02>
_SPLIT: Final = re.compile(r"[\s|<]*(?:[0-9a-f]{2}\s*(?:\||><)\s*){2,}[0-9a-f]{2}[\s|>]*", re.IGNORECASE)
_SEPARATORS: Final = re.compile(r"[\s,;]+")
#: words and signs of direction; what stands before octets ends with one
_DIRECTIONS: Final = (
    r"(?:(?<![a-z])(?:txd?|rxd?|sends?|sent|sending|srd|sdn|recv|received?|receiv(?:es|ing)|transmit(?:ted)?|"
    r"requests?|req|answers?|responses?|resp|reply|replies|writes?|written|reads?|telegrams?|frames?|fragment|"
    r"data|bytes|octets|hex|diag(?:nos(?:e|is|tics?|tik))?|length \d+|uart(?:-\d)?)(?![a-z])|"
    r"->|<-|=>|<=|(?<!>)>{2,3}(?!>)|(?<!<)<{2,3}(?!<)|[→←⇒⇐])[\s:=()\[\]{}#*.,\"'-]*"
    r"(?:\d+(?: ?(?:bytes|octets))?[)\]][\s:=-]*)?"
)
_DIRECTION: Final = re.compile(_DIRECTIONS, re.IGNORECASE)
_LABEL: Final = re.compile(_DIRECTIONS + "$", re.IGNORECASE)
#: octets after a word of direction, or what should be some
_LABELLED: Final = re.compile(_DIRECTIONS + r"((?:[0-9a-f][\s,;:x-]*){6,})$", re.IGNORECASE)
#: octets to the end of a line, some of them perhaps without a leading zero
_UNPADDED: Final = re.compile(
    f"(?:^|{_DIRECTIONS})" + r"((?:[0-9a-f]{1,2}[\s,;]+){2,}[0-9a-f]{1,2})[\s,;]*$", re.IGNORECASE
)
_ONE_DIGIT: Final = re.compile(r"\b0x([0-9a-f])\b", re.IGNORECASE)
#: times, numbers and signs alone
_COLUMNS: Final = re.compile(r"[\s\d.,:;/|+()\[\]<>#*TZ-]*")
#: what may follow octets at the end of a line: brackets, a remark in parentheses
_AFTER: Final = re.compile(r"[\s\])}>\"'“”»«,;.|]*(?:\(.*\)|//.*)?\s*")
_LITERAL: Final = re.compile(r"""(b?)(["'])((?:\\.|(?!\2)[^\\])*)\2""")
_ESCAPE: Final = re.compile(rb"\\(x[0-9A-Fa-f]{2}|[0-7]{1,3}|.)", re.DOTALL)
_OCTAL: Final = frozenset(b"%d" % digit for digit in range(8))
_NAMED: Final = {b"n": 10, b"r": 13, b"t": 9, b"a": 7, b"b": 8, b"v": 11, b"f": 12}
_DECIMALS: Final = re.compile(r"[\[({]\s*(\d{1,3}(?:\s*,\s*\d{1,3})+)\s*[\])}]")
#: the offset of a hex dump, and the octets after it
_OFFSET: Final = re.compile(r"(?:^|\s)(0x)?([0-9a-f]{1,8})(:?)(?:\s+|(?=0x))(\S.*)$", re.IGNORECASE)
_OFFSET_ALONE: Final = re.compile(r"[0-9a-f]{6,8}", re.IGNORECASE)
_PYPROFIBUS: Final = re.compile(r"FdlTelegram\((.*)\)")
_PYPROFIBUS_FIELD: Final = re.compile(r"(\w+)=(\[[^\]]*\]|[^,]*)")
#: colours of a terminal, which the logs of some programs keep
_COLOURS: Final = re.compile(r"\x1b\[[0-9;]*m")
#: longer lines are hex digits or nothing
_MOST_CHARACTERS: Final = 20_000
#: words of octets that begin with a digit in a line that is not understood, from which on somebody may miss them
_MISSED: Final = 4
#: characters before octets that are looked at
_MOST_PREFIX: Final = 200
_CHECKED: Final = (Kind.SD1, Kind.SD2, Kind.SD3)
_ANY_BAUD: Final = 9600
_NOTE: Final = 60


class Unread(NamedTuple):
    """A line without octets that could be read."""

    #: from 1 on
    number: int
    text: str
    #: why the octets that it seems to have could not be read; empty if it is a line of words
    reason: str


class _Line(NamedTuple):
    """The octets of a line. ``note``: what stands before them; ``offset``: where they stand in a hex dump."""

    octets: bytes
    note: str = ""
    offset: str = ""


def padded(text: str) -> str:
    """``text`` with leading zeros: Arduino's ``print(octet, HEX)`` and ``hex()`` leave them out (``10 5``)."""
    text = _ONE_DIGIT.sub(r"0x0\1", text)
    match = _UNPADDED.search(text)
    if match is None:
        return text
    words = _SEPARATORS.split(match[1])
    return text[: match.start(1)] + " ".join(word.zfill(2) for word in words) if min(map(len, words)) == 1 else text


def from_hex(text: str) -> bytes:
    """Octets from hex digits; blanks, commas, colons, dashes and 0x may stand between. Raises UsageError."""
    digits = _BETWEEN.sub("", text)
    try:
        return bytes.fromhex(digits)
    except ValueError:
        wrong = re.search(r"[^0-9A-Fa-f]", digits)
        why = f"{wrong[0]!r} is no hex digit" if wrong else "an octet has two hex digits, one is missing"
        raise UsageError(f"{why}; octets are written as in 68 05 05 68") from None


class LogReader:
    """Reads the lines of one log, in their order. ``on_unread`` gets each line that has no octets.

    A telegram may stand in several lines: those of a hex dump, whose offsets say so; and a line whose telegram is not
    at its end goes on with the next one of the same direction, if both together make a telegram.
    """

    def __init__(self, on_unread: Callable[[Unread], None]) -> None:
        self._on_unread = on_unread
        self._number = 0
        self._held: list[_Line] = []  # lines of a telegram that is not at its end
        self._dump: _Dump | None = None

    def add(self, text: str) -> Iterator[Transmission]:
        """The transmissions that are whole with the next line, ``text``."""
        self._number += 1
        if not self._held and self._dump is None:  # the fast path: hex digits of one telegram
            try:
                octets = bytes.fromhex(text)
            except ValueError:
                pass
            else:
                if decode(octets) is not None:
                    yield Transmission(octets)
                    return
        text = _COLOURS.sub("", text).strip("\ufeff \t\r\f")
        if not text or text.startswith("#"):
            return
        try:
            lines = self._lines_of(text)
        except UsageError as error:
            self._on_unread(Unread(self._number, printable(text), str(error).partition(";")[0]))
            return
        if lines is None:
            yield from self._end_dump()
            self._on_unread(Unread(self._number, printable(text), ""))
            return
        for line in lines:
            if line.offset:
                yield from self._end_held()
                yield from self._dumped(line)
            else:
                yield from self._end_dump()
                yield from self._whole(line)

    def end(self) -> Iterator[Transmission]:
        """What is left at the end of the log."""
        yield from self._end_dump()
        yield from self._end_held()

    # --- telegrams in several lines ----------------------------------------------------------------------------------
    def _whole(self, line: _Line) -> Iterator[Transmission]:
        held = self._held
        if held and _direction(line.note) in ("", _direction(held[0].note)):
            joined = _Line(b"".join(one.octets for one in (*held, line)), held[0].note)
            found = parse(joined.octets, 0, len(joined.octets))
            if found is None:
                held.append(line)
                return
            if isinstance(found, Telegram):
                held.clear()
                yield from _cut(joined)
                return
        yield from self._end_held()
        *pieces, last = _pieces(line)
        for piece in pieces:
            yield Transmission(piece, note=line.note)
        if parse(last, 0, len(last)) is None:
            self._held.append(_Line(last, line.note))
        else:
            yield Transmission(last, note=line.note)

    def _end_held(self) -> Iterator[Transmission]:
        held, self._held = self._held, []
        for line in held:
            yield from _cut(line)

    def _dumped(self, line: _Line) -> Iterator[Transmission]:
        if self._dump is None or not self._dump.goes_on(line.offset):
            yield from self._end_dump()
            self._dump = _Dump(line.offset, line.note)
        yield from self._dump.add(line.octets)

    def _end_dump(self) -> Iterator[Transmission]:
        dump, self._dump = self._dump, None
        if dump is not None:
            yield from dump.end()

    # --- one line ----------------------------------------------------------------------------------------------------
    def _lines_of(self, text: str) -> list[_Line] | None:
        """The octets in ``text``; None if they are words, an empty list if nothing is missing without them. Raises
        UsageError with the reason if octets cannot be read."""
        if len(text) > _MOST_CHARACTERS:
            return [_Line(octets)] if (octets := from_hex(text)) else None
        if self._dump is not None:
            if _OFFSET_ALONE.fullmatch(text) and self._dump.ends(text):
                return []
            if text == "*":
                raise UsageError("an asterisk stands for lines that were left out: dump with hexdump -v, or xxd")
        dumped = self._of_dump(text)
        if dumped is not None:
            return [dumped]
        if _SPLIT.fullmatch(text):
            text = re.sub("[|<>]", " ", text)
        text = padded(text)
        values, text = step7_octets(text), text if "16#" in text else _without_comment(text)
        if values:
            return [_Line(values)]
        try:
            octets = from_hex(text)
        except UsageError:
            pass
        else:
            return [_Line(octets)] if octets else None  # a row of dashes
        return _of_pyprofibus(text) or _of_code(text) or _runs_in(text)

    def _of_dump(self, text: str) -> _Line | None:
        match = _OFFSET.search(text)
        if match is None:
            return None
        prefix, offset, colon, body = match.groups()
        known = self._dump is not None and self._dump.goes_on(offset)
        begins = not int(offset, 16) and len(offset) > (1 if colon else 3)
        begins |= bool(prefix) and len(offset) > 2
        begins |= bool(colon) and (len(offset) >= 4 or (body[:2].lower() == "0x" and not int(offset, 16)))
        if not (known or begins):
            return None
        words = _SEPARATORS.split(_without_characters(body).strip(" ,;"))
        if not all(map(_octets_of, words)):
            return None
        octets = b"".join(_octets_of(word) or b"" for word in words)
        if len(offset) == 7 and not colon and all(len(word) == 4 for word in words):
            octets = b"".join(
                octets[at : at + 2][::-1] for at in range(0, len(octets), 2)
            )  # words of hexdump and od -x
        return _Line(octets, _note(text[: match.start()]), offset)


class _Dump:
    """The lines of a hex dump; their offsets are in hex (xxd, hexdump), octal (od) or decimal."""

    def __init__(self, offset: str, note: str) -> None:
        self._first = offset
        self._note = note
        self._count = 0
        self._last = b""  # the end of the last line, whose odd octet hexdump fills up
        self._cutter = Cutter(_ANY_BAUD, 0)

    def goes_on(self, offset: str) -> bool:
        return bool(self._count) and self._distance(offset, self._count)

    def ends(self, offset: str) -> bool:
        """Whether this offset without octets is the end of the dump."""
        if self._last and self._distance(offset, self._count - 1):
            self._last = self._last[:-1]
        return self._distance(offset, self._count) or self._distance(offset, self._count - 1)

    def _distance(self, offset: str, count: int) -> bool:
        for base in (16, 8, 10):
            try:
                if int(offset, base) - int(self._first, base) == count:
                    return True
            except ValueError:
                continue
        return False

    def add(self, octets: bytes) -> Iterator[Transmission]:
        yield from (Transmission(one.octets, note=self._note) for one in self._cutter.feed(self._last, 0))
        self._last = octets
        self._count += len(octets)

    def end(self) -> Iterator[Transmission]:
        for one in (*self._cutter.feed(self._last, 0), *self._cutter.give_up()):
            yield Transmission(one.octets, note=self._note)


def _swapped(octets: bytes) -> bytes:
    """Of the words of ``hexdump`` and ``od -x``, which are those of the computer: the low octet first."""
    return b"".join(octets[at : at + 2][::-1] for at in range(0, len(octets), 2))


def _pieces(line: _Line) -> list[bytes]:
    return [line.octets] if decode(line.octets) is not None else split(line.octets)


def _cut(line: _Line) -> Iterator[Transmission]:
    for piece in _pieces(line):
        yield Transmission(piece, note=line.note)


def _direction(note: str) -> str:
    """The words of a note, without its times and numbers."""
    return re.sub(r"[\W\d_]+", " ", note)


def _without_comment(text: str) -> str:
    """Without a comment behind hex digits."""
    before, sign, _ = text.partition("#")
    return before if sign and re.fullmatch(r"[\s0-9A-Fa-fx,;:-]*", before) else text


def _without_characters(body: str) -> str:
    """The octets of a line of a hex dump without the column of their characters."""
    body = body.partition(" |")[0]
    if all(map(_octets_of, body.split())):
        return body
    for match in reversed(list(re.finditer(r"\s{2,}", body))):
        left = body[: match.start()].split()
        octets = [_octets_of(word) for word in left]
        if all(octets) and len(body) - match.end() <= sum(len(one or b"") for one in octets):
            return body[: match.start()]
    return body


def _octets_of(word: str) -> bytes | None:
    """The octets that one word is; None for another word, a time or a date."""
    if _NO_OCTETS.fullmatch(word) or not _OCTETS.fullmatch(word):
        return None
    return bytes.fromhex(_PREFIX.sub("", word))


def step7_octets(text: str) -> bytes:
    """The values in ``text`` that are written as STEP 7 and TIA do (B#16#08, W#16#0C00, 16#08); empty without any."""
    octets = b""
    for size, digits in _STEP7.findall(text):
        digits = digits.replace("_", "")
        count = 2 * _STEP7_OCTETS.get(size.upper(), (len(digits) + 1) // 2)
        octets += bytes.fromhex(digits.zfill(max(count, len(digits) + len(digits) % 2)))
    return octets


def _of_pyprofibus(text: str) -> list[_Line] | None:
    """A telegram as pyprofibus prints its object (its sniffer does): the fields without LE and FCS."""
    match = _PYPROFIBUS.search(text)
    if match is None:
        return None
    raw = {name: "" if value in ("None", "Empty") else value for name, value in _PYPROFIBUS_FIELD.findall(match[1])}
    try:
        field = {name: from_hex(raw[name].strip("[]")) for name in _PARTS}
        kind = Kind[raw["sd"]]
    except (KeyError, UsageError):
        raise UsageError("a telegram of pyprofibus without its fields") from None
    address = [
        bytes(octet | 0x80 * bool(field[extension]) for octet in field[name])
        for name, extension in (("da", "dae"), ("sa", "sae"))
    ]
    unit = b"".join((*address, field["fc"], field["dae"], field["sae"], field["du"]))
    if kind in _CHECKED:
        unit += bytes((sum(unit) & 0xFF, ED))
    head = bytes((kind,))
    if kind is Kind.SD2:
        head = bytes((kind, len(unit) - 2 & 0xFF, len(unit) - 2 & 0xFF, kind))
    return [_Line(head + unit, _note(text[: match.start()]))]


_PARTS: Final = ("da", "sa", "fc", "dae", "sae", "du")


def _of_code(text: str) -> list[_Line] | None:
    """Octets in literals of Python, C and strace (``b"h\\x05\\x05h"``), or in a list of decimal numbers."""
    found = []
    for match in _LITERAL.finditer(text):
        if match[1] or re.search(r"\\(?:x|[0-7])", match[3]):
            try:
                octets = _ESCAPE.sub(_unescaped, match[3].encode("latin-1"))
            except UnicodeEncodeError:
                continue
            if octets:
                found.append(_Line(octets, _note(text[: match.start()])))
    if found:
        return found
    for match in _DECIMALS.finditer(text):
        numbers = [number.strip() for number in match[1].split(",")]
        if any(len(number) != 2 for number in numbers) and max(map(int, numbers)) < 256:
            found.append(_Line(bytes(map(int, numbers)), _note(text[: match.start()])))
    return found or None


def _unescaped(match: re.Match[bytes]) -> bytes:
    what = match[1]
    if what[:1] == b"x" and len(what) == 3:
        return bytes((int(what[1:], 16),))
    if what[:1] in _OCTAL:
        return bytes((int(what, 8) & 0xFF,))
    return bytes((_NAMED[what],)) if what in _NAMED else what


def _runs_in(text: str) -> list[_Line] | None:
    """The octets among words."""
    runs: list[tuple[int, int, bytes, list[int]]] = []  # begin, end, octets, where each word of them begins
    count, broken = 0, True
    for match in _WORD.finditer(text):
        octets = _octets_of(match[0].strip(_AROUND))
        if octets is None:
            broken = True
            continue
        count += match[0][0].isdigit()
        if broken:
            runs.append((match.start(), match.end(), octets, [0]))
        else:
            begin, _, before, places = runs[-1]
            runs[-1] = begin, match.end(), before + octets, [*places, len(before)]
        broken = False
    found = []
    for begin, end, octets, places in runs:
        prefix = text[max(0, begin - _MOST_PREFIX) : begin]
        labelled = _LABEL.search(prefix) is not None
        at = _telegram_in(octets, places)
        alone = labelled or _COLUMNS.fullmatch(_DIRECTION.sub(" ", prefix))
        if at is not None or (alone and _AFTER.fullmatch(_after(text, end, octets))):
            found.append(_Line(octets[0 if at is None or labelled else at :], _note(prefix)))
        elif labelled and len(octets) > 1:
            count = _MISSED
    if found:
        return found
    if (half := _LABELLED.search(text)) is not None:
        octets = from_hex(half[1])
        if decode(octets) is None:
            raise UsageError("no telegram")
        return [_Line(octets, _note(text[: half.start(1)]))]
    if count >= _MISSED:
        words = (match[0].strip(_AROUND) for match in _WORD.finditer(text[runs[0][0] :]))
        wrong = next((word for word in words if word and _octets_of(word) is None), None)
        raise UsageError("no telegram among its words" if wrong is None else f"{shortened(wrong)!r} is no octet")
    return None


def _after(text: str, end: int, octets: bytes) -> str:
    """What follows octets in their line, without a column of their characters."""
    after = text[end:]
    characters = after.strip()
    bars = 2 * (characters[:1] == "|" == characters[-1:])
    return "" if after.startswith("  ") and 0 < len(characters) - bars <= len(octets) else after


def _telegram_in(octets: bytes, places: Iterable[int]) -> int | None:
    """Where a telegram with a check sequence begins: at one of ``places``."""
    for at in places:
        if octets[at] in _CHECKED and isinstance(parse(octets, at, len(octets)), Telegram):
            return at
    return None


def _note(before: str) -> str:
    """What stands before octets: time, direction, names."""
    text = " ".join(before.lstrip(" \t:=,;|>\"'").rstrip(" \t:=,;|>\"'([{-").split())
    return shortened(printable(text), _NOTE) if re.search(r"\w", text) else ""
