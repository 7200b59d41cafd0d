"""What a baud rate is recognised by: the confidence rule.

A *run* is a sequence of telegrams between which no octet is left over. It breaks at any octet that
belongs to no telegram, at an SC that follows no request, and at a token whose sender is neither the one who got
the token before it nor the one who sent that. A rate is recognised by a run with

* two telegrams with FCS (``CHECKED``), or
* the same token three times (``TOKEN``): the only thing a lone master without GAP says.

What a receiver at another rate gets repeats as the traffic does, so a wrong telegram once read comes again: repetition
proves nothing, that nothing is left over does. From twice the true rate up no start octet can be read at all, since
each has a single bit between two others, and such a receiver samples every bit twice.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from dpstack.fdl.decoder import Decoder
from dpstack.fdl.telegram import Kind, Telegram

_FCS_NEEDED: Final = 2
_TOKENS_NEEDED: Final = 3


class Confidence(Enum):
    """What a rate was recognised by."""

    CHECKED = "checked"  # telegrams with FCS, nothing left over between them
    TOKEN = "token"  # the same token again and again, nothing left over between


class Evidence:
    """What is heard at one rate: octets to telegrams, telegrams to runs. ``stall_ns``: see the decoder."""

    __slots__ = ("_checked", "_decoder", "_last", "_token", "_tokens", "octets", "run", "unexplained")

    def __init__(self, stall_ns: int) -> None:
        self._decoder = Decoder(stall_ns=stall_ns)
        self.octets = 0
        #: octets that belonged to no telegram, since the last one that was
        self.unexplained = 0
        #: telegrams in a row
        self.run = 0
        self._checked = 0
        self._tokens: dict[Telegram, int] = {}  # of the run, how often
        self._token: Telegram | None = None  # the last one of the run
        self._last: Telegram | None = None

    @property
    def confidence(self) -> Confidence | None:
        """What the rate is recognised by; None while it is not."""
        if self._checked >= _FCS_NEEDED:
            return Confidence.CHECKED
        if any(count >= _TOKENS_NEEDED for count in self._tokens.values()):
            return Confidence.TOKEN
        return None

    @property
    def promising(self) -> bool:
        """More of the same would be enough."""
        return self._checked > 0 or len(self._tokens) > 1 or any(count > 1 for count in self._tokens.values())

    def hear(self, chunk: bytes, now: int) -> None:
        decoder = self._decoder
        self.octets += len(chunk)
        for at in range(len(chunk)):
            skipped = decoder.stats.skipped
            found = decoder.feed(chunk[at : at + 1], now)
            self._judge(found, decoder.stats.skipped - skipped)

    def telegram(self, telegram: Telegram, now: int) -> None:
        """A whole telegram, decoded by the medium."""
        self.octets += 1
        self.wake(now, given_up=True)
        self._take(telegram)

    def stall_at(self) -> int:
        """When :meth:`wake` is wanted, in ns."""
        return self._decoder.stall_at()

    def wake(self, now: int, *, given_up: bool = False) -> None:
        """Give up a telegram that has stalled (or surely does not go on: ``given_up``)."""
        decoder = self._decoder
        if given_up or decoder.stall_at() <= now:
            skipped = decoder.stats.skipped
            found = decoder.stalled(now)
            self._judge(found, decoder.stats.skipped - skipped)

    def _judge(self, found: list[Telegram], skipped: int) -> None:
        if skipped:
            # telegrams that come out of the rest of a damaged one are none to rely on
            self.unexplained += skipped
            self._break()
            return
        for telegram in found:
            self._take(telegram)

    def _take(self, telegram: Telegram) -> None:
        if not self._follows(telegram):
            self._break()
        self.run += 1
        self.unexplained = 0
        self._last = telegram
        if telegram.kind is Kind.SD4:
            self._token = telegram
            self._tokens[telegram] = self._tokens.get(telegram, 0) + 1
        elif telegram.kind is not Kind.SC:
            self._checked += 1

    def _follows(self, telegram: Telegram) -> bool:
        """It may stand where it stands in the run."""
        if telegram.kind is Kind.SC:
            return self._last is not None and self._last.is_request
        if telegram.kind is Kind.SD4 and self._token is not None:
            return telegram.sa in (self._token.da, self._token.sa)
        return True

    def _break(self) -> None:
        self.run = self._checked = 0
        self._tokens = {}
        self._token = self._last = None
