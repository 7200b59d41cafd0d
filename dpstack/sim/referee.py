"""The referee: watches every transmission and fails a run on broken timing or token rules.

It knows only the wire and the bus parameters of the masters passed to :meth:`Referee.know`. A fault that the test
injects (octets, a delayed transmission) is no violation; the stations' reactions to it can be.

Checks of the token rules: one token, only its holder sends requests, it goes to the next higher address.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from typing import Final, NamedTuple

from msgspec import Struct

from dpstack.errors import DpError
from dpstack.fdl.codec import decode
from dpstack.fdl.telegram import FC_FUNCTION, FC_REQUEST, SHORT_ACK, UNANSWERED, Kind, Req, Telegram
from dpstack.params import BROADCAST, T_SYN, BusParams
from dpstack.sim.nodes import Node
from dpstack.sim.transmission import Transmission, receive
from dpstack.trace import WireEntry, WireLog
from dpstack.units import NEVER, bits_to_ns, ns_to_bits

#: first attempt and two repetitions before the successor counts as absent
PASS_ATTEMPTS: Final = 3
_CIRCLE: Final = 128
_NOBODY: Final = -1


class Rule(Enum):
    """The rules that the referee checks."""

    COLLISION = "collision"  # two transmissions overlap
    EARLY = "answer too early"  # before min T_SDR
    LATE = "answer too late"  # after T_SL: the master may have moved on
    UNASKED = "answer nobody asked for"
    IDLE = "missing idle time"  # T_SYN, T_ID1, T_ID2
    SLOT = "slot time cut short"  # the next request or token before T_SL, and nobody had answered
    RIGHT = "sent without the token"
    TWO_TOKENS = "two tokens"
    CLAIM = "token claimed too early"  # before T_TO
    ORDER = "token out of order"  # a member of the ring passed over
    BROKEN = "broken telegram"  # octets that are no telegram, or gaps inside one


class Finding(NamedTuple):
    """A rule that was broken, and how."""

    rule: Rule
    text: str


@dataclass(slots=True)
class _Offer:
    """A token that ``sa`` has sent ``tries`` times and that ``da`` has not used yet."""

    sa: int
    da: int
    tries: int


class TokenWatch:
    """The token rules of one wire. ``ring``: the stations that have used the token and still get it."""

    def __init__(self) -> None:
        self.holder: int | None = None
        self.ring: set[int] = set()
        #: of the holder: two stations may have one address
        self.node: Node | None = None
        #: the token that was passed and not used yet
        self.offer: _Offer | None = None

    @property
    def offered_by(self) -> int | None:
        """The station that has passed the token and waits for its successor to use it."""
        return None if self.offer is None else self.offer.sa

    def request(self, sa: int, node: Node | None) -> Finding | None:
        offer = self.offer
        if offer is not None and sa == offer.sa and self.holder == sa:
            self.offer = None
            return Finding(Rule.RIGHT, f"station {sa} sends a request after it passed the token to {offer.da}")
        finding = self._check_holder(sa, node, "sends a request")
        if finding is not None:
            self._set_holder(sa, node)
        return finding

    def token(self, sa: int, da: int, node: Node | None, lacks: str | None = None) -> Finding | None:
        """``sa`` sends the token to ``da``.

        ``lacks``: the reason why ``sa`` may not claim the token; "" after a silence of T_TO, None if T_TO is unknown.
        """
        finding = None
        if sa == da and lacks == "":
            self._claim(sa, node)
        else:
            finding = self._check_holder(sa, node, f"passes the token to {da}")
        if finding is not None:
            if sa != da:
                finding = Finding(Rule.TWO_TOKENS, finding.text)
            elif finding.rule is Rule.RIGHT:
                finding = Finding(Rule.CLAIM, f"station {sa} claims the token {lacks}") if lacks else None
            self._claim(sa, node)
        order = self._check_order(sa, da)
        tries = 1 + (self.offer.tries if self.offer is not None and self.offer.da == da else 0)
        self.offer = None if sa == da else _Offer(sa, da, tries)
        return finding or order

    def _claim(self, sa: int, node: Node | None) -> None:
        self._set_holder(sa, node)
        self.ring = {sa}

    def _check_holder(self, sa: int, node: Node | None, does: str) -> Finding | None:
        """Check that ``sa`` may send; its sending confirms that it has received the token."""
        offer = self.offer
        if offer is not None and sa == offer.da:
            self._set_holder(sa, node)
            self.ring |= {offer.sa, sa}
            return None
        if sa != self.holder:
            holds = "nobody has it" if self.holder is None else f"{self.holder} has it"
            return Finding(Rule.RIGHT, f"station {sa} {does} without having the token ({holds})")
        if self.node is not node and node is not None and self.node is not None:
            return Finding(
                Rule.TWO_TOKENS, f"a second station {sa} {does}; another one with this address has the token"
            )
        return None

    def _set_holder(self, sa: int, node: Node | None) -> None:
        self.holder = sa
        self.node = node
        self.offer = None

    def _check_order(self, sa: int, da: int) -> Finding | None:
        offer = self.offer
        if offer is not None and offer.da != da:
            self.ring.discard(offer.da)
            if offer.tries < PASS_ATTEMPTS:
                return Finding(
                    Rule.ORDER, f"station {sa} gave up on {offer.da} after {offer.tries} of {PASS_ATTEMPTS} attempts"
                )
        reach = _distance(sa, da)
        skipped = sorted(m for m in self.ring if m != sa and _distance(sa, m) < reach)
        if not skipped:
            return None
        self.ring -= set(skipped)
        return Finding(Rule.ORDER, f"station {sa} passes the token to {da}, over {', '.join(map(str, skipped))}")


def _distance(start: int, end: int) -> int:
    """Steps upwards in the ring; 128 from a station to itself."""
    return (end - start - 1) % _CIRCLE + 1


MIN_TSDR: Final = 11
#: T_TO of the highest address in slot times: after this a ring with two tokens has settled
_DISORDER: Final = 6 + 2 * 126
_SHOWN_VIOLATIONS: Final = 20
_SHOWN_ENTRIES: Final = 60
_SD4: Final = Kind.SD4
_MSRD: Final = int(Req.MSRD)
#: called with the same few times for every transmission
_ns: Final = lru_cache(256)(bits_to_ns)


class RefereeError(DpError):
    """A station broke a rule. The text has the violations and the decoded wire log."""


@dataclass(frozen=True, slots=True)
class Violation:
    """Rule ``rule`` was broken by ``sender`` with the transmission that began at ``t_ns``."""

    t_ns: int
    rule: Rule
    sender: str
    text: str

    def __str__(self) -> str:
        return f"{self.t_ns / 1000:.3f} us, {self.sender}: {self.rule.value}: {self.text}"


#: A whole telegram of one station that nothing has disturbed: the fields of its :class:`WireEntry`, the telegram, its
#: sender, the rate.
Plain = tuple[int, int, bytes, str, str, Telegram, Node, int]

#: SRD low and high differ in bit 0 of the function; bit 6 is that of a request
_SRD_MASK: Final = 0x4E
_SRD: Final = 0x4C
_NO_REQUEST: Final = (_NOBODY, _NOBODY, 0)
#: the kind of the last transmission; plain integers, because an enum's member costs ten times as much to look up
_NOTHING: Final = 0
_REQUEST: Final = 1  # the requester waits for its answer
_QUIET: Final = 2  # a request without answer
_ANSWER: Final = 3
_TOKEN: Final = 4
_GARBAGE: Final = 5  # octets that are no telegram


class _Times(Struct, frozen=True, eq=False):
    """A master's own times in bit times. Two are never equal: as a key of a cache they cost no hash of their values."""

    t_sl: int
    t_id1: int
    t_id2: int
    t_to: int


class _Idle(NamedTuple):
    """A silence that must come before a request or token, its rule and its name."""

    ns: int
    rule: Rule
    name: str
    bits: int


@lru_cache(256)
def _idle_time(times: _Times | None, after: int, waiting: bool, baud: int) -> _Idle:
    """The silence before a request or token of a master with ``times`` (None: not known) that follows ``after``.

    ``waiting``: the same master sent that, and has waited since.
    """
    rule, bits, name = Rule.IDLE, T_SYN, "T_SYN"
    if after == _NOTHING:
        bits = 0
    elif times is not None:
        if waiting and after in (_REQUEST, _TOKEN):  # for an answer, or for its successor to use the token
            rule, bits, name = Rule.SLOT, times.t_sl, "T_SL"
        elif after in (_ANSWER, _TOKEN):
            bits, name = times.t_id1, "T_ID1"
        elif waiting and after == _QUIET:
            bits, name = times.t_id2, "T_ID2"
    return _Idle(bits_to_ns(bits, baud), rule, name, bits)


@lru_cache(256)
def _answer_window(times: _Times | None, baud: int) -> tuple[int, int]:
    """The time in ns after a request before which no answer may begin, and from which on it is late.

    ``times``: of the master that waits; None: not known.
    """
    return bits_to_ns(MIN_TSDR, baud), NEVER if times is None else bits_to_ns(times.t_sl, baud)


class Referee:
    """The referee of one wire. ``violations``: those that the test has not allowed; ``allowed``: the others.

    ``token_rules`` False: it judges no rule about the token (for a scripted master without a ring).

    It judges plain transmissions (:data:`Plain`) in batches, all others as they end. Whoever looks at it or at the log
    finds everything judged.
    """

    def __init__(self, log: WireLog, start_ns: int = 0) -> None:
        self._violations: list[Violation] = []
        self._allowed: list[Violation] = []
        self._token_rules = True
        self._tokens = TokenWatch()
        self._log = log
        self._judged: tuple[list[Plain], int] = [], 0  # a batch, and how many in it are judged
        self._masters: dict[int, _Times] = {}
        self._allow: dict[Rule, int | None] = {}
        self._expect: set[Rule] = set()
        self._after = _NOTHING
        self._last_end = start_ns
        self._waiting = _NOBODY  # the master that sent the last request, or passed the token and waits for its use
        self._pending: tuple[int, int, int] | None = None  # the request that is open: SA, DA, its end in ns
        self._msrd_end = NEVER  # the end of the last MSRD request, in ns
        self._baud = 0
        self._excerpt: list[WireEntry] = []
        self._excused_until = 0
        log.judged_by(self._judge)

    # --- for tests ---
    @property
    def violations(self) -> list[Violation]:
        self._log.settle()
        return self._violations

    @property
    def allowed(self) -> list[Violation]:
        self._log.settle()
        return self._allowed

    @property
    def tokens(self) -> TokenWatch:
        """The token, as far as the wire shows it."""
        self._log.settle()
        return self._tokens

    @property
    def token_rules(self) -> bool:
        return self._token_rules

    @token_rules.setter
    def token_rules(self, judged: bool) -> None:
        self._log.settle()
        self._token_rules = judged

    def know(self, params: BusParams) -> None:
        """Judge the master ``params.address`` by its own T_SL, T_ID1, T_ID2 and T_TO."""
        self._log.settle()
        self._masters[params.address] = _Times(params.t_sl, params.t_id1, params.t_id2, params.t_to)

    def allow(self, *rules: Rule, times: int | None = None) -> None:
        """Allow each of ``rules`` to be broken the next ``times`` times (None = always)."""
        self._log.settle()
        for rule in rules:
            self._allow[rule] = times

    def expect(self, *rules: Rule) -> None:
        """Each of ``rules`` must be broken at least once: :meth:`check` fails otherwise."""
        self.allow(*rules)
        self._expect.update(rules)

    def check(self) -> None:
        """Raises RefereeError when a rule was broken, or an expected violation did not happen."""
        missing = self._expect - {violation.rule for violation in self.allowed}
        if not self.violations and not missing:
            return
        from dpstack.decode.wire_log import render  # here, because only a failing run needs the decoder

        lines = [f"{len(self.violations)} violations on the wire:"] if self.violations else []
        lines += [f"  {violation}" for violation in self.violations[:_SHOWN_VIOLATIONS]]
        if len(self.violations) > _SHOWN_VIOLATIONS:
            lines.append(f"  ... and {len(self.violations) - _SHOWN_VIOLATIONS} more")
        lines += [f"expected, but never happened: {rule.value}" for rule in sorted(missing, key=lambda r: r.name)]
        last = list(self._log)[-_SHOWN_ENTRIES:]
        if self._excerpt and (not last or self._excerpt[-1].start_ns < last[0].start_ns):
            lines += ["the wire up to the first violation:", render(self._excerpt, self._baud)]
        if last:
            lines += ["the last of the wire:", render(last, self._baud)]
        raise RefereeError("\n".join(lines))

    # --- for the medium ---
    def collision(self, late: Transmission, early: Transmission, heard_ns: int) -> None:
        """``late`` began while ``early`` was on the wire, whose last readable octet ended at ``heard_ns``."""
        self._log.settle()
        if late.forced or early.forced or late.start_ns - heard_ns >= bits_to_ns(T_SYN, late.baud):
            return
        overlap = ns_to_bits(early.end_ns - late.start_ns, late.baud)
        self._add_violation(late, Rule.COLLISION, f"begins {overlap} bits before {early.sender} ends")

    def ended(self, tx: Transmission) -> None:
        """``tx`` has ended; every transmission before it is judged."""
        telegram = tx.telegram
        whole = tx.whole
        self._baud = tx.baud
        if telegram is None or (not whole and (tx.collided or tx.cut)):
            if telegram is None and not (tx.collided or tx.cut or tx.forced):
                self._add_violation(tx, Rule.BROKEN, "the octets are not one telegram without gaps")
            self._pending = None
            after = _GARBAGE
        elif telegram.fc >= 0:
            after = self._request(tx, telegram) if telegram.fc & FC_REQUEST else self._answer(tx, telegram)
        else:
            after = self._token(tx, telegram) if telegram.kind is _SD4 else self._answer(tx, telegram)
        if whole:
            self._after = after
            self._last_end = tx.end_ns
            return
        if tx.flips:
            after = _GARBAGE
            self._excuse_forged_token(tx)
        self._after = after
        if tx.heard_ns > self._last_end:
            self._last_end = tx.heard_ns

    def _judge(self, batch: list[Plain]) -> None:
        """Judge ``batch``. A data request of the only token holder and its answer are the rule, judged here as by
        :meth:`_request` and :meth:`_answer`; everything else goes to :meth:`ended`."""
        after, last_end, waiting = self._after, self._last_end, self._waiting
        sa, da, _ = self._pending or _NO_REQUEST
        holder, its_node, rate, id1_ns, least, until = self._lone_holder(batch[0][7])
        for number, plain in enumerate(batch):
            start, end, octets, sender, _, telegram, node, baud = plain
            if baud == rate:
                if after == _REQUEST:
                    if (
                        sa == holder
                        and least <= start - last_end < until
                        and (
                            telegram is SHORT_ACK
                            or (telegram.sa == da and telegram.da == sa and not telegram.fc & FC_REQUEST)
                        )
                    ):
                        after = _ANSWER
                        last_end = end
                        continue
                elif (
                    telegram.fc & _SRD_MASK == _SRD
                    and telegram.sa == holder
                    and node is its_node
                    and start - last_end >= id1_ns
                    and (after == _ANSWER or (after == _TOKEN and waiting != holder))
                    and (da := telegram.da) != BROADCAST
                ):
                    after = _REQUEST
                    last_end = end
                    sa = waiting = holder
                    continue
            self._after, self._last_end, self._waiting = after, last_end, waiting
            self._pending = (sa, da, last_end) if after == _REQUEST else None
            self._judged = batch, number
            tx = Transmission(node, sender, octets, baud, start, end, telegram, whole=True)
            self.ended(tx)
            if tx.notes:
                batch[number] = (*plain[:4], "; ".join(tx.notes), *plain[5:])
            after, last_end, waiting = self._after, self._last_end, self._waiting
            sa, da, _ = self._pending or _NO_REQUEST
            holder, its_node, rate, id1_ns, least, until = self._lone_holder(baud)
        self._after, self._last_end, self._waiting = after, last_end, waiting
        self._pending = (sa, da, last_end) if after == _REQUEST else None
        self._judged = [], 0
        self._baud = batch[-1][7]

    def _lone_holder(self, baud: int) -> tuple[int, Node | None, int, int, int, int]:
        """The station that has the token and has not passed it, its node, and at ``baud``, which follows, its T_ID1 and
        the time for its answers in ns. Nobody if the rules about the token are not judged or its times not known."""
        tokens = self._tokens
        sa = tokens.holder
        times = None if sa is None else self._masters.get(sa)
        if times is None or sa is None or tokens.offer is not None or not self._token_rules:
            return _NOBODY, None, baud, 0, 0, 0
        return sa, tokens.node, baud, _ns(times.t_id1, baud), *_answer_window(times, baud)

    # --- rules ---
    def _request(self, tx: Transmission, telegram: Telegram) -> int:
        sa = telegram.sa
        idle = _idle_time(self._masters.get(sa), self._after, sa == self._waiting, tx.baud)
        if tx.start_ns - self._last_end < idle.ns:
            self._add_idle_violation(tx, idle)
        self._waiting = sa
        tokens = self._tokens
        if self._token_rules and not (sa == tokens.holder and tx.node is tokens.node and tokens.offer is None):
            finding = tokens.request(sa, tx.node)
            if finding is not None:
                self._add_violation(tx, *finding)
        da = telegram.da
        if da == BROADCAST or telegram.fc & FC_FUNCTION in UNANSWERED:
            self._pending = None
            return _QUIET
        self._pending = (sa, da, tx.end_ns)
        if telegram.fc & FC_FUNCTION == _MSRD:
            self._msrd_end = tx.end_ns
        return _REQUEST

    def _token(self, tx: Transmission, telegram: Telegram) -> int:
        sa = telegram.sa
        times = self._masters.get(sa)
        lacks = None
        if times is not None:
            silence = tx.start_ns - self._last_end
            lacks = ""
            if silence < _ns(times.t_to, tx.baud):
                lacks = f"after {ns_to_bits(silence, tx.baud)} bits of silence; its T_TO is {times.t_to}"
        idle = _idle_time(times, self._after, sa == self._waiting, tx.baud)
        if tx.start_ns - self._last_end < idle.ns:
            self._add_idle_violation(tx, idle)
        if self._token_rules and (finding := self._tokens.token(sa, telegram.da, tx.node, lacks)) is not None:
            self._add_violation(tx, *finding)
        self._waiting = sa if self._tokens.offered_by == sa else _NOBODY
        self._pending = None
        return _TOKEN

    def _answer(self, tx: Transmission, telegram: Telegram) -> int:
        pending = self._pending
        self._pending = None
        if pending is None:
            self._add_violation(tx, Rule.UNASKED, "no request is open")
            return _ANSWER
        sa, da, end_ns = pending
        # only the answer to MSRD goes to all stations
        to = BROADCAST if telegram.da == BROADCAST and end_ns == self._msrd_end else sa
        if telegram.fc >= 0 and (telegram.sa != da or telegram.da != to):
            text = f"station {telegram.sa} answers {telegram.da}, the request was {sa} -> {da}"
            self._add_violation(tx, Rule.UNASKED, text)
            return _ANSWER
        waited = tx.start_ns - end_ns
        times = self._masters.get(sa)
        least, until = _answer_window(times, tx.baud)
        if waited < least:
            text = f"{ns_to_bits(waited, tx.baud)} bits after the request; min T_SDR is {MIN_TSDR}"
            self._add_violation(tx, Rule.EARLY, text)
        if times is not None and waited >= until:
            text = f"{ns_to_bits(waited, tx.baud)} bits after the request; T_SL of {sa} is {times.t_sl}"
            self._add_violation(tx, Rule.LATE, text)
        return _ANSWER

    def _add_idle_violation(self, tx: Transmission, idle: _Idle) -> None:
        silence = ns_to_bits(tx.start_ns - self._last_end, tx.baud)
        text = f"begins after {silence} bits of silence; {idle.name} is {idle.bits}"
        self._add_violation(tx, idle.rule, text)

    def _excuse_forged_token(self, tx: Transmission) -> None:
        """A token has no check sum: noise can turn it into another token. Excuse the violations that follow."""
        octets = bytes(octet for _, octet in receive(tx.octets, tx.baud, tx.flips))
        heard = decode(octets)
        if heard is not None and heard.kind is Kind.SD4 and heard != tx.telegram:
            t_sl = max((times.t_sl for times in self._masters.values()), default=1_000)
            self._excused_until = tx.end_ns + bits_to_ns(_DISORDER * t_sl, tx.baud)
            tx.notes.append(f"heard as the token {heard.sa} -> {heard.da}")

    def _add_violation(self, tx: Transmission, rule: Rule, text: str) -> None:
        if tx.forced or tx.start_ns < self._excused_until:
            return
        violation = Violation(tx.start_ns, rule, tx.sender, text)
        tx.notes.append(rule.value.upper())
        left = self._allow.get(rule, 0)
        if left is None or left:
            if left is not None:
                self._allow[rule] = left - 1
            self._allowed.append(violation)
            return
        if not self._violations:
            mine = WireEntry(tx.start_ns, tx.end_ns, tx.octets, tx.sender, rule.value.upper())
            batch, judged = self._judged
            before = [*self._log, *(WireEntry(*plain[:5]) for plain in batch[:judged])]
            self._excerpt = [*before[-_SHOWN_ENTRIES // 2 :], mine]
        self._violations.append(violation)
