"""Incremental decoder from octets to telegrams: driven by length, resynchronising octet by octet.

Real ports show neither the 33-bit pause nor gaps between characters, so a telegram ends where its length says so, and
the decoder gives up an unfinished one after the stall time that the caller sets. When octets are no telegram, the
decoder skips the first one and tries again from the next one.

SC and the token have no check sequence: an 0xE5 in the data of a damaged telegram would look like an acknowledgement.
So the decoder accepts only telegrams with FCS within the length that the LE of a rejected frame claims. It counts an SC
or a token there as *doubtful*. The same rule applies if the first octet of the frame was lost and the decoder finds the
second SD. The rule ends with the first telegram with FCS, at the end of the length, or after silence for the stall
time.

A station that sends garbage without end must not use up the processor time: the decoder skips a run of octets that
cannot begin a telegram in one step, found by a regular expression.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

from dpstack.fdl.codec import EMPTY_LE, NO_FRAME, Flaw, PlainFrame, claimed, decode, parse
from dpstack.fdl.interface import DecoderStats
from dpstack.fdl.telegram import MAX_LE, Kind, Telegram
from dpstack.units import NEVER

#: kinds without FCS
_UNCHECKED: Final = frozenset((int(Kind.SC), int(Kind.SD4)))
#: octets that are no start octet
_NO_START: Final = re.compile(rb"[^\x10\x68\xa2\xdc\xe5]+")
#: Octets at which no telegram with FCS begins: no SD1, SD2 or SD3, or one whose ED would be another octet. An SD2 says
#: with LE where its ED is; only in a run of 0x68 that is longer than LE = 0x68 claims it is known to be 0x68 as well.
_NO_CHECKED_START: Final = re.compile(
    rb"(?:[^\x10\x68\xa2]|\x10(?=[\x00-\xff]{4}[^\x16])|\xa2(?=[\x00-\xff]{12}[^\x16])|(?<=\x68\x68)\x68(?=\x68{109}))+"
)
#: a run of one start octet that is longer than two telegrams, from a station that is stuck
_STUCK: Final = re.compile(rb"\x10{12,}|\xa2{28,}|\xdc{6,}")
_SC_RUN: Final = re.compile(rb"\xe5+")
#: no other telegram has this length
_LE3_SIZE: Final = EMPTY_LE + 6


class Decoder:
    """The decoder of a receiver. ``stall_ns``: it gives up an unfinished telegram after this pause.

    It accepts an SD2 with LE = 3 as a telegram without data and SAPs (``Telegram.empty_le3``) and counts it.
    """

    def __init__(self, *, stall_ns: int) -> None:
        self.stall_ns = stall_ns
        self._stats = DecoderStats()
        #: the two counters that every telegram changes
        self._octets = self._telegrams = 0
        #: callback with a counter's name and the number of damaged telegrams, for a caller that knows their sender
        self.on_bad: Callable[[str, int], None] | None = None
        #: octets of an unfinished telegram; other classes only read whether it is empty
        self.pending = bytearray()
        self._doubt = 0  # number of octets, pending or future, inside a rejected frame
        self._tail = b""  # the last two skipped octets: LE and LEr, if a second SD follows
        self._last = 0  # time of the last octets, valid only while octets are pending or in doubt
        self._between = True  # the last telegram is over: nothing is pending or in doubt

    @property
    def stats(self) -> DecoderStats:
        """The counters up to now, always the same object."""
        stats = self._stats
        stats.octets, stats.telegrams = self._octets, self._telegrams
        return stats

    def whole(self, chunk: bytes, likely: PlainFrame = NO_FRAME) -> Telegram | None:
        """The telegram that ``chunk`` is, as most reads are; None: :meth:`feed` it. ``likely``: as :func:`decode`."""
        if not self._between:
            return None
        last = likely.last
        telegram = last[1] if chunk == last[0] else decode(chunk, likely)
        if telegram is None:
            return None
        size = len(chunk)
        self._octets += size
        self._telegrams += 1
        if size == _LE3_SIZE:
            self._stats.empty_le3 += 1
        return telegram

    def feed(self, chunk: bytes, now: int) -> list[Telegram]:
        """The telegrams that end within ``chunk``, in order; ``now`` in ns. Never raises."""
        telegram = self.whole(chunk)
        return self.feed_pieces(chunk, now) if telegram is None else [telegram]

    def stall_at(self) -> int:
        """Time in ns at which the pending telegram stalls; NEVER without one."""
        return self._last + self.stall_ns if self.pending else NEVER

    def stalled(self, now: int) -> list[Telegram]:
        """Give up the pending telegram; returns the telegrams in the rest of its octets (``now`` in ns)."""
        held = self.pending
        if not held:
            return []
        if not self._doubt:  # else a start inside a damaged frame, which is counted already
            self._count("stalled")
        # the silence has ended any telegram: search the octets without waiting for more
        self._doubt = len(held)
        found: list[Telegram] = []
        at = 0
        while at < len(held):
            at = self._scan(at + 1, found)
            self._stats.skipped += 1
        self.reset()
        return found

    def reset(self) -> None:
        """Forget the pending octets, because the line went down; counters stay."""
        self.pending.clear()
        self._doubt = 0
        self._tail = b""
        self._between = True

    def feed_pieces(self, chunk: bytes, now: int) -> list[Telegram]:
        """The same for a chunk that :meth:`whole` refused."""
        held = self.pending
        if not held and now - self._last >= self.stall_ns:
            self._doubt = 0
            self._tail = b""
        self._last = now
        self._octets += len(chunk)
        held += chunk
        found: list[Telegram] = []
        at = self._scan(0, found)
        del held[:at]
        self._doubt = max(0, self._doubt - at)
        self._between = not (held or self._doubt or self._tail)
        return found

    def _scan(self, at: int, found: list[Telegram]) -> int:
        """Find telegrams from ``at`` on; returns where the first unfinished one begins (or the end)."""
        held = self.pending
        stats = self._stats
        end = len(held)
        clear_to = at  # no telegram with FCS begins before this
        while at < end:
            in_doubt = at < self._doubt
            if in_doubt:
                if at >= clear_to:
                    run = _NO_CHECKED_START.match(held, at)
                    clear_to = at if run is None else run.end()
                if at < clear_to:
                    at = self._skip_in_doubt(at, min(clear_to, self._doubt))
                    continue
            else:
                run = _NO_START.match(held, at)
                if run is not None:
                    self._count(Flaw.BAD_START.value, run.end() - at)
                    at = self._skip(at, run.end())
                    continue
            telegram = parse(held, at, end)
            if telegram is None:
                return at
            if isinstance(telegram, Telegram):
                size = claimed(held, at, end)
                count = 1
                if size == 1:
                    run = _SC_RUN.match(held, at)
                    count = run.end() - at if run is not None else 1
                    found += [telegram] * count
                else:
                    found.append(telegram)
                    if size == _LE3_SIZE:
                        stats.empty_le3 += 1
                self._telegrams += count
                if held[at] not in _UNCHECKED:
                    self._doubt = 0
                self._tail = b""
                at += size * count
                continue
            if not in_doubt:
                run = _STUCK.match(held, at)
                if run is not None:
                    at = self._stuck(telegram, at, run.end())
                    continue
                self._reject(telegram, at)
            if held[at] == Kind.SD2:
                self._doubt = max(self._doubt, at + self._headless(in_doubt))
            at = self._skip(at, at + 1)
        return at

    def _stuck(self, flaw: Flaw, at: int, stop: int) -> int:
        """Skip a run of one start octet as damaged telegrams in a row; returns the begin of the last one."""
        held = self.pending
        size = claimed(held, at, stop)
        times = (stop - at) // size - 1
        self._count(flaw.value, times)
        if held[at] in _UNCHECKED:
            self._stats.doubtful += times * (size - 1)
        return self._skip(at, at + times * size)

    def _skip_in_doubt(self, at: int, stop: int) -> int:
        """Skip a run inside a rejected frame in which no telegram with FCS begins; SC and tokens in it are doubtful."""
        held = self.pending
        self._stats.doubtful += held.count(Kind.SC, at, stop) + held.count(Kind.SD4, at, stop)
        if held[stop - 1] == Kind.SD2:  # in a run of 0x68 each one is a second SD to those before it
            self._doubt = max(self._doubt, stop + int(Kind.SD2) + 2)
        return self._skip(at, stop)

    def _skip(self, at: int, stop: int) -> int:
        """Skip the octets up to ``stop``, which belong to no telegram; returns ``stop``."""
        self._tail = (self._tail + self.pending[max(at, stop - 2) : stop])[-2:]
        self._stats.skipped += stop - at
        return stop

    def _headless(self, in_doubt: bool) -> int:
        """Octets to the end of a telegram whose first SD was lost, if this is its second SD; 0: it is not."""
        tail = self._tail
        if not tail or not EMPTY_LE <= tail[-1] <= MAX_LE:
            return 0
        if in_doubt and tail[:1] != tail[1:]:  # inside another damaged frame it takes both LE to believe it
            return 0
        return tail[-1] + 3

    def _reject(self, flaw: Flaw, at: int) -> None:
        self._count(flaw.value)
        if flaw is not Flaw.BAD_START:
            self._doubt = at + claimed(self.pending, at, len(self.pending))

    def _count(self, name: str, times: int = 1) -> None:
        stats = self._stats
        setattr(stats, name, getattr(stats, name) + times)
        if self.on_bad is not None:
            self.on_bad(name, times)
