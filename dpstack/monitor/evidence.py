"""Evidence that the telegrams on a line are PROFIBUS and not another protocol of the same form.

M-Bus (EN 13757-2) and IEC 60870-5-101 use the frames of IEC 60870-5-1, FT1.2, as PROFIBUS does: start octet 68, the
length twice, a sum as check sequence, the end octet 16, and E5 for an acknowledgement. So one telegram can only be
called a telegram of this form. PROFIBUS is what only PROFIBUS does, again and again
(docs/reference/protocol.md#is-it-profibus):

* a token is passed on: its sender is the receiver of the token before,
* an answer fits its request: both addresses and SAPs exchanged. In FT1.2 the octet at DA's place is the control field,
  whose bit 6 is set in every request and in no answer, so an answer there never has the addresses of its request,
* SC answers a request whose frame count bit was turned since the answered one before.

Against it stand functions without a meaning, answers that nobody asked for and tokens of a station without the token.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from dpstack.capture.transmission import Transmission
from dpstack.monitor.counters import Counters

#: This many tokens passed on and answers that fit name a bus (our choice): one by chance names none.
ENOUGH: Final = 6
#: They must be more than this many times what stands against it (our choice).
OUTWEIGHS: Final = 4
#: One in this many telegrams must be such (our choice): chance makes some in weeks. A master without tokens that
#: polls 45 absent slaves twice, and one that is there, is just above.
ONE_IN: Final = 100


class Finding(NamedTuple):
    """``is_profibus``: the evidence is enough. ``text``: the reason, for people."""

    is_profibus: bool
    text: str


def finding(counters: Counters) -> Finding:
    """The protocol of the bus that ``counters`` counted, by all that was heard at the present rate."""
    tokens, answers = counters.passed_tokens, counters.fitting_answers
    against = counters.contradictions
    seen = f"{_many(tokens, 'token')} passed on, {_many(answers, 'answer')} that fit requests"
    least = max(ENOUGH, OUTWEIGHS * against + 1, counters.telegrams_at_rate // ONE_IN)
    if tokens + answers >= least:
        return Finding(True, f"PROFIBUS: {seen}")
    if not counters.telegrams:
        return Finding(False, "no telegram of PROFIBUS's form")
    if against:
        seen += f", but {_many(against, 'telegram')} that PROFIBUS has no place for"
    return Finding(False, f"{_FORM}; too little that only PROFIBUS does: {seen}")


_FORM: Final = "telegrams of PROFIBUS's form, which M-Bus and IEC 60870-5-101 have too"


class Naming:
    """Follows a line until there is evidence for PROFIBUS. The evidence is not taken back at the same rate."""

    def __init__(self) -> None:
        self._counters = Counters()
        self._baud = 0
        #: PROFIBUS is proven at the present rate
        self.is_profibus = False

    def add(self, one: Transmission) -> None:
        """One transmission, in the order of their times. Costs nearly nothing once the bus is named."""
        if self.is_profibus and one.baud == self._baud:
            return
        if one.baud != self._baud:
            self._baud = one.baud
            self._counters = Counters()
            self.is_profibus = False
        self._counters.add(one)
        self.is_profibus = finding(self._counters).is_profibus

    @property
    def text(self) -> str:
        """The finding with its reason; of the transmissions up to the naming."""
        return finding(self._counters).text


def _many(count: int, noun: str) -> str:
    return f"{count or 'no'} {noun}{'s' * (count != 1)}"
