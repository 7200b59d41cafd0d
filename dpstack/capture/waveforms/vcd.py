"""Value Change Dump (``.vcd``, IEEE 1364 clause 18): scalar variables as channels, as PulseView, sigrok-cli and Saleae
Logic write them. Vectors and real numbers are ignored."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import BinaryIO, Final

from dpstack.capture.waveforms.levels import (
    KEPT,
    MOST_CHANNELS,
    MOST_RATE,
    Change,
    Piece,
    Waveform,
    before_damage,
    estimated_rate,
    parse_rate,
    pieces_of,
)
from dpstack.units import NS_PER_S

_BLOCK: Final = 1 << 20
#: octets of the definitions
_MOST_HEAD: Final = 1 << 20
_SCALE: Final = re.compile(r"(1|10|100)\s*(s|ms|us|ns|ps|fs)$")
_UNIT_NS: Final = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0, "ps": 1e-3, "fs": 1e-6}
#: changes from which the period of the samples is estimated
_ESTIMATED: Final = 4000
#: the comment that libsigrok writes
_RATE: Final = re.compile(r"Acquisition with \d+/\d+ channels at ([\d.]+ ?[kMG]?Hz)")


class ValueChanges(Waveform):
    """Raises CaptureFileError for definitions that are not whole."""

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        self.file.seek(0)
        head = self.file.read(_MOST_HEAD)
        before, _, after = head.partition(b"$enddefinitions")
        closed = after.find(b"$end")
        if closed < 0:
            raise self.wrong("the file ends before the end of its definitions, so it has no changes")
        self._body = len(head) - len(after) + closed + len(b"$end")
        self._tick_ns = 0.0
        self._ids: list[bytes] = []
        try:
            text, self._encoding = before.decode(), "utf-8"
        except UnicodeDecodeError:
            text, self._encoding = before.decode("latin-1"), "latin-1"
        self.channels = self._definitions(text)
        if not self.channels:
            raise self.wrong("no scalar variable ($var wire 1 ...); export single channels")
        if not self._tick_ns:
            raise self.wrong("no $timescale that is known here, such as 1 ns")
        ticks = self._look()
        self._first = ticks[0] if ticks else 0
        self.begin_ns = round(self._first * self._tick_ns)
        stated = _RATE.search(text)
        self.rate = parse_rate(stated[1]) if stated else 0
        self.stated = 0 < self.rate <= MOST_RATE
        if not self.stated:
            self.rate, self.period_ns = estimated_rate(ticks, self._tick_ns)

    def _definitions(self, text: str) -> tuple[str, ...]:
        scopes: list[str] = []
        names: list[tuple[str, str]] = []
        ignored = 0
        for words in (block.split() for block in text.split("$end")):
            match words:
                case ["$timescale", *scale] if found := _SCALE.match(" ".join(scale)):
                    self._tick_ns = int(found[1]) * _UNIT_NS[found[2]]
                case ["$scope", _, scope]:
                    scopes.append(scope)
                case ["$upscope"] if scopes:
                    scopes.pop()
                case ["$var", _, "1", identifier, *name] if len(names) < MOST_CHANNELS:
                    self._ids.append(identifier.encode(self._encoding))
                    names.append((".".join(scopes), " ".join(name)))
                case ["$var", *_]:
                    ignored += 1
        if ignored:
            self.remarks.append(f"{ignored} variables that are no single bits are ignored")
        short = [name for _, name in names]
        return tuple(f"{scope}.{name}" if short.count(name) > 1 else name for scope, name in names)

    def _look(self) -> list[int]:
        """The times of the first changes."""
        return [one.at for one in before_damage(islice(self._changes(range(len(self.channels))), _ESTIMATED))]

    def pieces(self, channels: Sequence[int]) -> Iterator[Piece]:
        per_tick = self._tick_ns * self.rate / NS_PER_S
        first = self._first
        changes = self._changes(channels)
        yield from pieces_of((Change(round((at - first) * per_tick), *what) for at, *what in changes), self.rate)

    def _changes(self, channels: Sequence[int]) -> Iterator[Change]:
        """Changes with their times in ticks."""
        levels = {level + self._ids[n]: (n, int(level)) for n in channels for level in (b"0", b"1")}
        single = {self._ids[n]: n for n in channels}
        known = levels.get
        now = 0
        for words in self._words():
            for word in words:
                change = known(word)
                if change is not None:
                    yield Change(now, *change)
                elif word[0] == 0x23:  # "#"
                    now = self._time(word, now)
                elif word[0] in b"bB":  # a vector of one bit
                    channel = single.get(next(words, b""))
                    if channel is not None and word[-1:] in b"01":
                        yield Change(now, channel, word[-1] - 48)
                elif word[0] in b"rRsS":
                    next(words, b"")
        yield Change(now, channels[0], KEPT)  # sigrok ends a file with the time of its end

    def _time(self, word: bytes, before: int) -> int:
        if not word[1:].isdigit() or len(word) > 20:
            raise self.wrong(f"{word[:30].decode('latin-1')!r} is no time")
        now = int(word[1:])
        if now < before:
            raise self.wrong(f"the time {now} comes after {before}")
        return now

    def _words(self) -> Iterator[Iterator[bytes]]:
        """The words behind the definitions, in blocks of whole lines."""
        self.file.seek(self._body)
        rest = b""
        while block := self.file.read(_BLOCK):
            lines, newline, rest_of = (rest + block).rpartition(b"\n")
            if len(rest_of) > _BLOCK:
                raise self.wrong(f"a line has more than {_BLOCK} characters")
            rest = rest_of
            if newline:
                yield iter(lines.split())
        yield iter(rest.split())
