"""Handlers of Pass_Token and Check_Token_Pass."""

from __future__ import annotations

from typing import Final

from dpstack.fdl.active.exchange import Exchange
from dpstack.fdl.active.listen_idle_claim import Waiting
from dpstack.fdl.active.parts import Common, Parts
from dpstack.fdl.active.states import CHECK_TOKEN_PASS, PASS_TOKEN
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.params import BROADCAST

#: the token is sent once and repeated twice before NS is dropped from the LAS
_ATTEMPTS: Final = 3


class TokenPass(Parts):
    """A pass of the token to the next station."""

    __slots__ = ("_activity", "_attempt", "_unused", "exchange", "waiting")

    def __init__(self, common: Common, exchange: Exchange, waiting: Waiting) -> None:
        super().__init__(common)
        self.exchange = exchange
        self.waiting = waiting
        self._attempt = 0
        self._unused = False  # the hold was without a telegram
        self._activity = False  # octets came that form no telegram (yet): a station is active

    def start(self, now: int, unused: bool = False) -> None:
        """The hold is over: pass the token to NS, which is TS itself without other masters in the ring."""
        self._unused = unused
        self._start(now)

    def _start(self, now: int) -> None:
        line, membership = self.line, self.membership
        alone = membership.ring.ns == line.ts
        if membership.leaving and alone:
            self.waiting.go_offline(now, "ordered")
            return
        self._attempt = 1
        self._send()
        line.lengthen_gate(line.after_ns + membership.stagger_ns())
        if alone and self._unused and not self.times.exact:
            # Alone without requests: on a real port tokens to itself must not fill line and processor. One slot time
            # is far below any T_TO (six slot times at least).
            line.lengthen_gate(line.t_sl_ns)

    def _send(self) -> None:
        self.machine.enter(PASS_TOKEN)
        self.line.queue_token(self.membership.ring.ns)

    def sent(self, _: Telegram, at: int) -> None:
        """The token is sent, its last bit is at ``at``. A lone master holds it again at once."""
        line, membership, times = self.line, self.membership, self.times
        if membership.ring.ns == line.ts:
            if membership.leaving:
                self.waiting.go_offline(line.taken_at, "ordered")
            else:
                self.machine.hold(line.taken_at)
            return
        self._activity = False
        slot_ns = times.slot_known_ns if self._attempt == 1 else times.slot_again_ns
        self.machine.enter(CHECK_TOKEN_PASS, at + slot_ns)

    def timeout(self, _: Telegram, now: int) -> None:
        """NS was silent for T_SL: repeat, or drop it. After octets without a telegram NS counts as active."""
        if self._activity:
            self.waiting.go_idle(now)
            return
        line, membership = self.line, self.membership
        if self._attempt < _ATTEMPTS:
            self._attempt += 1
            self.stats.token_retries += 1
            self._send()
            if self._attempt == _ATTEMPTS:
                # Two holders in step (a doubled token) do not hear each other: their addresses set the last repetitions
                # apart.
                line.lengthen_gate(now - line.idle_since + self.times.params.ns(line.ts))
            return
        gone = membership.ring.ns
        membership.ring.drop(gone)
        self.peers.left_ring(gone)
        membership.report_master(gone, now)
        if membership.ring.ns == line.ts:
            membership.stagger()
        self._start(now)

    def activity(self, _: Telegram, now: int) -> None:
        """A station is active: wait for a readable telegram for another slot time."""
        self._activity = True
        self.machine.deadline = now + self.times.slot_known_ns

    def response(self, telegram: Telegram, now: int) -> None:
        """SC is for another master, so that one is active. A response to this station is late: it proves nothing."""
        if telegram.kind == Kind.SC:
            self.stats.stray += 1
            self.waiting.go_idle(now)
            return
        self._activity = False
        self.exchange.late(telegram, now)

    def confirmed(self, telegram: Telegram, now: int) -> None:
        """A telegram of another station: the token is elsewhere. Active_Idle handles the telegram.

        An answer to all (MSRD) may be the late one to this station, which proves nothing.
        """
        if telegram.da == BROADCAST and not telegram.is_request and self.peers.due_from(telegram, now) >= 0:
            self._activity = False
            self.exchange.late(telegram, now)
            return
        self.waiting.go_idle(now, telegram)
