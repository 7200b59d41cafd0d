"""Search for the baud rate by listening only, and the rule that recognises a rate.

The station tries the rates from the fastest to the slowest: a dwell at a rate above the true one is shorter than the
telegrams on the bus, a dwell below it is not. It recognises a rate by whole telegrams in a row, never by octets without
errors alone: at twice the true rate half of the received octets have neither framing nor parity error.

A *run* is a sequence of telegrams between which no octet is left over. It breaks at any octet that
belongs to no telegram, at an SC that follows no request, and at a token whose sender is neither the one who got
the token before it nor the one who sent that. A rate is recognised by a run with

* two telegrams with FCS (``CHECKED``), or
* the same token three times (``TOKEN``): the only telegram that a lone master without GAP polls sends.

The traffic repeats, so a receiver at a wrong rate reads the same wrong telegram again and again. Therefore repetition
proves nothing; only a run without left-over octets proves the rate. From twice the true rate on the receiver can read
no start octet, because each start octet has a single bit between two others and the receiver samples every bit twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Final

from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.decoder import Decoder
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.machine import LineDown, LineUp, RateRefused
from dpstack.params import T_SYN
from dpstack.trace import Event
from dpstack.units import BAUD_RATES, NEVER, NOW, baud_text, bits_to_ns, ns_to_s

#: A dwell in bit times: three of the longest telegrams with their answers' slot times (3 x (255 x 11 + 1000)) and some.
DWELL_BITS: Final = 12_000
#: This many octets in a row that belong to no telegram mean a wrong rate: the longest telegram has 255 octets.
_TOO_MANY: Final = 300
#: After each sweep over all rates without result the dwells become longer, up to this factor: a slot time may have
#: 16383 bits.
_LONGEST: Final = 4
_FCS_NEEDED: Final = 2
_TOKENS_NEEDED: Final = 3


class Confidence(Enum):
    """The kind of telegrams by which a rate was recognised."""

    CHECKED = "checked"  # telegrams with FCS, nothing left over between them
    TOKEN = "token"  # the same token again and again, nothing left over between


class Evidence:
    """Octets and telegrams received at one rate. ``run``: number of telegrams in a row; ``stall_ns``: see Decoder."""

    def __init__(self, stall_ns: int) -> None:
        self._decoder = Decoder(stall_ns=stall_ns)
        self.octets = 0
        #: octets since the last telegram that belong to no telegram
        self.unassigned = 0
        self._skipped = 0  # octets skipped by the decoder up to the last call
        self._begin_run()

    def _begin_run(self) -> None:
        self.run = self._checked = 0
        self._tokens: dict[Telegram, int] = {}  # tokens of the run with their numbers
        self._token: Telegram | None = None  # the last one of the run
        self._last: Telegram | None = None

    @property
    def confidence(self) -> Confidence | None:
        """The telegrams by which the rate is recognised; None while it is not."""
        if self._checked >= _FCS_NEEDED:
            return Confidence.CHECKED
        if any(count >= _TOKENS_NEEDED for count in self._tokens.values()):
            return Confidence.TOKEN
        return None

    @property
    def nearly_recognised(self) -> bool:
        """Whether the run would be enough if it went on with the same telegrams."""
        return self._checked > 0 or len(self._tokens) > 1 or any(count > 1 for count in self._tokens.values())

    def receive(self, chunk: bytes, now: int) -> None:
        self.octets += len(chunk)
        for at in range(len(chunk)):
            self._judge(self._decoder.feed(chunk[at : at + 1], now))

    def telegram(self, telegram: Telegram, now: int) -> None:
        """A whole telegram, decoded by the medium."""
        self.octets += 1
        self.wake(now, given_up=True)
        self._add_to_run(telegram)

    def stall_at(self) -> int:
        """Deadline for :meth:`wake` in ns: the unfinished telegram stalls then."""
        return self._decoder.stall_at()

    def wake(self, now: int, *, given_up: bool = False) -> None:
        """Give up the unfinished telegram if it has stalled. ``given_up``: in any case."""
        if given_up or self._decoder.stall_at() <= now:
            self._judge(self._decoder.stalled(now))

    def _judge(self, found: list[Telegram]) -> None:
        skipped = self._decoder.stats.skipped - self._skipped
        if skipped:
            # telegrams found in the rest of a damaged one prove nothing
            self._skipped += skipped
            self.unassigned += skipped
            self._begin_run()
            return
        for telegram in found:
            self._add_to_run(telegram)

    def _add_to_run(self, telegram: Telegram) -> None:
        if not self._follows(telegram):
            self._begin_run()
        self.run += 1
        self.unassigned = 0
        self._last = telegram
        if telegram.kind is Kind.SD4:
            self._token = telegram
            self._tokens[telegram] = self._tokens.get(telegram, 0) + 1
        elif telegram.kind is not Kind.SC:
            self._checked += 1

    def _follows(self, telegram: Telegram) -> bool:
        """Whether ``telegram`` may stand at this place of the run."""
        if telegram.kind is Kind.SC:
            return self._last is not None and self._last.is_request
        if telegram.kind is Kind.SD4 and self._token is not None:
            return telegram.sa in (self._token.da, self._token.sa)
        return True


class Missing(Enum):
    """Why no rate was recognised."""

    SILENCE = "silence"
    NOISE = "noise"


class BaudFound(Event):
    """The bus runs at ``baud`` bit/s. ``telegrams``: length of the run; ``tried``: number of dwells."""

    baud: int
    listened_ns: int
    confidence: Confidence
    telegrams: int
    tried: int

    def _text(self) -> str:
        by = "telegrams with check sum" if self.confidence is Confidence.CHECKED else "the same token again and again"
        return f"the bus runs at {baud_text(self.baud)}, recognised by {by}"


class BaudNotFound(Event):
    """No rate was recognised within ``listened_ns``. ``octets``: received at all rates together; ``slowest``: the last
    rate tried; ``complete``: every rate was tried.
    """

    why: Missing
    listened_ns: int
    octets: int
    slowest: int
    complete: bool

    def _text(self) -> str:
        seconds = f"{ns_to_s(self.listened_ns):.1f} s"
        if self.why is Missing.SILENCE:
            text = (
                f"silence: no octet in {seconds}; is a master running, is the cable plugged in, are its two data lines "
                "perhaps reversed?"
            )
        else:
            text = (
                f"noise: {self.octets} octets in {seconds} and no telegram among them; are the two data lines of the "
                "cable reversed, is the bus terminated at both ends?"
            )
        if not self.complete:
            text += f" (the rates below {baud_text(self.slowest)} had no turn: listen longer)"
        return text


class AutoBaud:
    """A station that only listens. It changes its rate ``baud`` until it has a ``result``; the driver sets the port.

    ``rates`` in bit/s. It gives up ``silence_ns`` after the start or the last octet, in all cases ``limit_ns`` after
    the start (NEVER: never). ``slack_ns``: delay of the port, added to every dwell. Octets that arrive within
    ``settle_ns`` after a change of the rate are ignored, because they may have been sent before it. ``now`` is the
    start. Raises ConfigError.
    """

    #: a listening station has no address
    address: Final = -1
    #: every telegram is evidence of the rate
    hears_all: Final = True
    held_up: Final = None

    def __init__(
        self,
        now: int,
        *,
        rates: Sequence[int] = BAUD_RATES,
        silence_ns: int = NEVER,
        limit_ns: int = NEVER,
        slack_ns: int = 0,
        settle_ns: int = 0,
    ) -> None:
        if not rates or not set(rates) <= set(BAUD_RATES):
            raise ConfigError(f"rates {list(rates)}: give some of {', '.join(map(str, BAUD_RATES))}")
        self._rates = sorted(set(rates), reverse=True)
        self._silence_ns = silence_ns
        self._limit_ns = limit_ns
        self._slack_ns = slack_ns
        self._settle_ns = settle_ns
        self._start = now
        self._heard_at = now
        self._octets = 0  # received in earlier dwells
        self._at = 0
        self._complete = False
        self._extended = False  # the dwell is extended, because the run was nearly long enough
        self._settled_at = self._dwell_until = now
        self._evidence = Evidence(0)
        self._events: list[Event] = []
        self.result: BaudFound | BaudNotFound | None = None
        #: number of dwells, the present one included
        self.tried = 0
        self._begin(now)

    @property
    def baud(self) -> int:
        """The rate to listen at now, in bit/s; the one found once there is a result."""
        return self._rates[self._at]

    def receive(self, chunk: bytes, now: int) -> int:
        """Octets received at :attr:`baud`."""
        if self._counts(now):
            self._evidence.receive(chunk, now)
            self._decide(now)
        return self.wake_at()

    def telegram(self, telegram: Telegram, now: int) -> None:
        """A whole telegram received at :attr:`baud`."""
        if self._counts(now):
            self._evidence.telegram(telegram, now)
            self._decide(now)

    def _counts(self, now: int) -> bool:
        """Whether octets received now count: they were sent after the last change of the rate of a running search."""
        if self.result is not None or now < self._settled_at:
            return False
        self._heard_at = now
        return True

    def activity(self, now: int) -> None:
        """Ignored: a start edge is no evidence of the rate."""

    def refused(self, now: int) -> None:
        """The port refuses :attr:`baud`: leave this rate out. Raises ConfigError when no rate is left."""
        rate = self._rates.pop(self._at)
        if not self._rates:
            raise ConfigError(f"the port knows none of the rates asked for, not even {baud_text(rate)}")
        self.tried -= 1
        self._at -= 1
        self._next(now)

    def wake(self, now: int) -> None:
        """Give up a stalled telegram, end the dwell or the search."""
        if self.result is not None:
            return
        self._evidence.wake(now)
        if self._decide(now):
            return
        if now >= self._end():
            self._finish(self.in_vain(now))
        elif now >= self._dwell_until:
            if self._evidence.nearly_recognised and not self._extended:
                self._extended = True
                self._dwell_until = now + self._dwell_ns()
            else:
                self._next(now)

    def wake_at(self) -> int:
        """The earliest of: stall of a telegram, end of the dwell, end of the search."""
        if self.result is not None:
            return NEVER
        return min(self._dwell_until, self._evidence.stall_at(), self._end())

    def sent(self, at: int) -> int:
        """Never called, because the search sends nothing."""
        return NOW

    def take_tx(self, now: int) -> None:
        """:meth:`wake`; it sends nothing."""
        self.wake(now)

    def take_events(self) -> list[Event]:
        events, self._events = self._events, []
        return events

    def command(self, command: object, now: int) -> None:
        """:class:`LineDown` and :class:`LineUp` begin the dwell anew, :class:`RateRefused` ends it.

        Raises ConfigError when no rate is left, UsageError on anything else.
        """
        match command:
            case RateRefused():
                self.refused(now)
            case LineDown() | LineUp():
                self.tried -= 1
                self._begin(now)
            case _:
                raise UsageError(f"a search for the baud rate knows no {type(command).__name__}")

    # --- inside ---
    def _begin(self, now: int) -> None:
        """Begin to listen at the present rate."""
        baud = self.baud
        self.tried += 1
        self._extended = False
        self._evidence = Evidence(bits_to_ns(T_SYN, baud) + self._slack_ns)
        self._settled_at = now + self._settle_ns
        self._dwell_until = self._settled_at + self._dwell_ns()

    def _dwell_ns(self) -> int:
        sweep = self.tried // (len(self._rates) + 1) + 1
        return bits_to_ns(DWELL_BITS * min(sweep, _LONGEST), self.baud) + self._slack_ns

    def _next(self, now: int) -> None:
        self._octets += self._evidence.octets
        self._at += 1
        if self._at >= len(self._rates):
            self._at = 0
            self._complete = True
        self._begin(now)

    def _decide(self, now: int) -> bool:
        """Whether the octets received are enough to accept or reject this rate."""
        evidence = self._evidence
        confidence = evidence.confidence
        if confidence is not None:
            self._finish(
                BaudFound(
                    t_ns=now,
                    baud=self.baud,
                    listened_ns=now - self._start,
                    confidence=confidence,
                    telegrams=evidence.run,
                    tried=self.tried,
                )
            )
            return True
        if evidence.unassigned < _TOO_MANY:
            return False
        self._next(now)
        return True

    def _end(self) -> int:
        return min(self._heard_at + self._silence_ns, self._start + self._limit_ns)

    def _finish(self, result: BaudFound | BaudNotFound) -> None:
        self.result = result
        self._events.append(result)

    def in_vain(self, now: int) -> BaudNotFound:
        """The result of a search without success: why no rate was recognised until now."""
        octets = self._octets + self._evidence.octets
        return BaudNotFound(
            t_ns=now,
            why=Missing.NOISE if octets else Missing.SILENCE,
            listened_ns=now - self._start,
            octets=octets,
            slowest=self.baud,
            complete=self._complete or self._at == len(self._rates) - 1,
        )
