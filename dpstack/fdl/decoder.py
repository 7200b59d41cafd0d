"""Octets as they arrive to telegrams: incremental, driven by length, resynchronising octet by octet.

Real ports show neither the 33-bit pause nor gaps between characters, so a telegram ends where its length says so, and
an unfinished one is given up after the stall time that the caller sets. What is no telegram loses its first octet, and
the rest is looked at again.

SC and the token carry no check sequence: an 0xE5 among the data of a damaged telegram would pass for an
acknowledgement. So within the length that a rejected frame claimed for itself (also where its own first octet was lost
and its second SD is met) only telegrams with FCS count (a *doubtful* SC or token is counted instead), until one of them
is found, the length is over, or the line was silent for the stall time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Final

from dpstack.fdl.codec import EMPTY_LE, Flaw, claimed, decode, parse
from dpstack.fdl.telegram import MAX_LE, Kind, Telegram
from dpstack.units import NEVER

#: kinds without FCS
_UNCHECKED: Final = frozenset((int(Kind.SC), int(Kind.SD4)))
#: no other telegram has this length
_LE3_SIZE: Final = EMPTY_LE + 6


@dataclass(slots=True)
class DecoderStats:
    """Counters of one decoder, always on. A damaged telegram counts once, by the first thing found wrong."""

    octets: int = 0
    telegrams: int = 0
    empty_le3: int = 0  # SD2 with LE = 3, taken as an empty data unit
    skipped: int = 0  # octets that belonged to no telegram
    bad_start: int = 0  # octets outside of any frame that are no start octet
    le_mismatch: int = 0
    le_range: int = 0
    bad_second_sd: int = 0
    bad_ed: int = 0
    bad_fcs: int = 0
    bad_address: int = 0
    bad_extension: int = 0
    bad_fc: int = 0
    stalled: int = 0  # telegrams whose rest did not come
    doubtful: int = 0  # octets inside a damaged frame that begin an SC or a token, not taken

    @property
    def bad(self) -> int:
        """Damaged frames and octets outside of frames, of every kind."""
        counters = self.as_dict()
        return sum(counters[flaw.value] for flaw in Flaw) + self.stalled

    def by_cause(self) -> dict[str, int]:
        """What was damaged or belonged to no telegram, zeros left out."""
        return {name: n for name, n in self.as_dict().items() if n and name not in ("octets", "telegrams")}

    def as_dict(self) -> dict[str, int]:
        """All counters by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


class Decoder:
    """One receiver's decoder. ``stall_ns``: the pause after which a telegram that has begun is given up.

    An SD2 with LE = 3 comes out as a telegram without data and SAPs (``Telegram.empty_le3`` tells it) and is counted.
    """

    __slots__ = ("_doubt", "_last", "_tail", "on_bad", "pending", "stall_ns", "stats")

    def __init__(self, *, stall_ns: int) -> None:
        self.stall_ns = stall_ns
        self.stats = DecoderStats()
        #: told the counter's name of every damaged telegram, for whoever knows whose it may have been
        self.on_bad: Callable[[str], None] | None = None
        #: octets of an unfinished telegram; for others to look whether there are any
        self.pending = bytearray()
        self._doubt = 0  # so many of the octets held or to come lie inside a rejected frame
        self._tail = b""  # of the octets skipped just before: LE and LEr, if a second SD follows
        self._last = 0  # when octets came last; kept only while octets are held or in doubt

    def feed(self, chunk: bytes, now: int) -> list[Telegram]:
        """The telegrams that end within ``chunk``, in order; ``now`` in ns. Never raises."""
        if not self.pending and not self._doubt and not self._tail:
            # the fast path: one read, one telegram
            telegram = decode(chunk)
            if telegram is not None:
                size = len(chunk)
                stats = self.stats
                stats.octets += size
                stats.telegrams += 1
                if size == _LE3_SIZE:
                    stats.empty_le3 += 1
                return [telegram]
        return self._feed_slowly(chunk, now)

    def stall_at(self) -> int:
        """When the pending telegram counts as stalled, in ns; NEVER when nothing is pending."""
        return self._last + self.stall_ns if self.pending else NEVER

    def stalled(self, now: int) -> list[Telegram]:
        """Give up the pending telegram; returns those found in the rest of its octets (``now`` in ns)."""
        held = self.pending
        if not held:
            return []
        if not self._doubt:  # else a start inside a damaged frame, which is counted already
            self._count("stalled")
        # silence has ended whatever these octets are: none of them waits for more
        self._doubt = len(held)
        found: list[Telegram] = []
        at = 0
        while at < len(held):
            at = self._scan(at + 1, found)
            self.stats.skipped += 1
        held.clear()
        self._doubt = 0
        self._tail = b""
        return found

    def reset(self) -> None:
        """Forget what is pending (the line went away); counters stay."""
        self.pending.clear()
        self._doubt = 0
        self._tail = b""

    def _feed_slowly(self, chunk: bytes, now: int) -> list[Telegram]:
        held = self.pending
        if not held and now - self._last >= self.stall_ns:
            self._doubt = 0
            self._tail = b""
        self._last = now
        self.stats.octets += len(chunk)
        held += chunk
        found: list[Telegram] = []
        at = self._scan(0, found)
        del held[:at]
        self._doubt = max(0, self._doubt - at)
        return found

    def _scan(self, at: int, found: list[Telegram]) -> int:
        """Find telegrams from ``at`` on; returns where the first unfinished one begins (or the end)."""
        held = self.pending
        stats = self.stats
        end = len(held)
        while at < end:
            in_doubt = at < self._doubt
            if in_doubt and held[at] in _UNCHECKED:
                stats.doubtful += 1
                stats.skipped += 1
                at += 1
                continue
            telegram = parse(held, at, end)
            if telegram is None:
                return at
            if isinstance(telegram, Telegram):
                found.append(telegram)
                stats.telegrams += 1
                size = claimed(held, at, end)
                if size == _LE3_SIZE:
                    stats.empty_le3 += 1
                if held[at] not in _UNCHECKED:
                    self._doubt = 0
                self._tail = b""
                at += size
                continue
            if not in_doubt:
                self._reject(telegram, at)
            if held[at] == Kind.SD2:
                self._doubt = max(self._doubt, at + self._headless(in_doubt))
            self._tail = (self._tail + held[at : at + 1])[-2:]
            stats.skipped += 1
            at += 1
        return at

    def _headless(self, in_doubt: bool) -> int:
        """What is left of the telegram of which this SD may be the second one, the first being lost; 0: of none."""
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

    def _count(self, name: str) -> None:
        stats = self.stats
        setattr(stats, name, getattr(stats, name) + 1)
        if self.on_bad is not None:
            self.on_bad(name)
