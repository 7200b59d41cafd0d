"""Handlers of the states without the token: Offline, Listen_Token, Active_Idle, and Claim_Token."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.fdl.active.exchange import Exchange
from dpstack.fdl.active.las_gap import CLAIM_TOKENS
from dpstack.fdl.active.parts import Parts
from dpstack.fdl.active.states import ACTIVE_IDLE, CLAIM_TOKEN, LISTEN_TOKEN, NONE, OFFLINE, State
from dpstack.fdl.codec import encode_sd1
from dpstack.fdl.events import AddressCollision, TokenLost
from dpstack.fdl.telegram import UNANSWERED, Kind, Resp, StationType, Telegram
from dpstack.units import NEVER

#: After a collision this station stays silent for so many T_TO since its address was heard last.
_BACK_OFF_T_TO: Final = 10
_TYPE_SHIFT: Final = 4


@dataclass(slots=True, eq=False)
class Waiting(Parts):
    """Out of the ring, or waiting for the token."""

    exchange: Exchange
    _back_off_until: int = 0
    _own_token_at: int = -NEVER  # when a token with SA = TS was seen last
    _collision_reported: bool = False
    _claims_left: int = 0
    _claim_from: State = LISTEN_TOKEN

    # --- ways into these states, also from a token hold -------------------------------------------------------------
    def go_idle(self, now: int, telegram: Telegram = NONE) -> None:
        """Somebody else has the token: Active_Idle, or Offline when this was the last hold.

        ``telegram`` of that station counts in Active_Idle.
        """
        if self.membership.leaving:
            self.go_offline(now, "ordered")
            return
        self._wait_in(ACTIVE_IDLE)
        if telegram is not NONE:
            self.machine.telegram(telegram, now)

    def go_offline(self, now: int, reason: str) -> None:
        self.exchange.abandon(now)
        self.membership.leave(now, reason)
        self.membership.set_leaving(False)
        self.peers.due.clear()
        self.machine.enter(OFFLINE)

    def _listen(self, now: int) -> None:
        self.membership.listen(now)
        self._wait_in(LISTEN_TOKEN)

    def _wait_in(self, state: State) -> None:
        """Enter ``state`` until the line has been silent for T_TO, counted from the last activity."""
        self.machine.enter(state, self.line.idle_since + self.times.t_to_ns)

    # --- Offline ----------------------------------------------------------------------------------------------------
    def go_online(self, _: Telegram, now: int) -> None:
        """Listen for at least T_TO before anything is sent."""
        self.line.note_activity(now)
        self.line.end_arrival()
        self._back_off_until = 0
        self._own_token_at = -NEVER
        self._collision_reported = False
        self._listen(now)

    def stay_offline(self, _: Telegram, now: int) -> None: ...

    def line_down(self, _: Telegram, now: int) -> None:
        """The port is gone; slaves may be others when it returns: fresh FCB for all."""
        for address in range(128):
            self.exchange.fcb.restart(address)
        self.go_offline(now, "the line is down")

    def leave(self, _: Telegram, now: int) -> None:
        """Without the token nothing has to be handed over: the predecessor drops us after three tries."""
        self.go_offline(now, "ordered")

    # --- Listen_Token -----------------------------------------------------------------------------------------------
    def learn(self, telegram: Telegram, now: int) -> None:
        """One token between others, or to a station of our address that was there before us."""
        self.line.drop()
        stats = self.stats
        if telegram.sa not in stats.token_senders:
            stats.token_senders |= {telegram.sa}
        self.membership.ring.learn(telegram.sa, telegram.da)
        self.membership.report_token(telegram.sa, now)

    def request_listening(self, telegram: Telegram, now: int) -> None:
        """A request of another master: note its sender, which may be one that passes no token."""
        stats = self.stats
        if telegram.sa not in stats.requesters:
            stats.requesters |= {telegram.sa}
        self.drop_answer(telegram, now)

    def status_listening(self, telegram: Telegram, now: int) -> None:
        """FDL status: only the predecessor polls us, so its sender will pass the token once it heard 'ready'."""
        if now < self._back_off_until:
            return
        if not self.membership.ring.learned:
            self._status(telegram, StationType.MASTER_NOT_READY)
            return
        self._wait_in(ACTIVE_IDLE)
        self._status(telegram, StationType.MASTER_READY)

    def silence(self, _: Telegram, now: int) -> None:
        """T_TO may be over; what was heard since it was armed moved it on."""
        line, t_to_ns = self.line, self.times.t_to_ns
        quiet_at = line.idle_since + t_to_ns
        if quiet_at < line.busy_until:
            # an edge of which nothing came has held the deadlines of low addresses to one end: apart again from there
            quiet_at = line.busy_until + t_to_ns
        if now < quiet_at:
            self.machine.set_deadline(quiet_at)
        elif not self._back_off_until:
            self._claim(now)
        elif now < self._back_off_until:
            self.machine.set_deadline(self._back_off_until)
        else:
            # the silence of a back-off is ours too: afterwards listen for a whole T_TO again
            self._back_off_until = 0
            self.machine.set_deadline(now + t_to_ns)

    # --- Active_Idle ------------------------------------------------------------------------------------------------
    def token_to_me(self, telegram: Telegram, now: int) -> None:
        """The token, if its sender may pass it (:meth:`Membership.accepts`)."""
        self.line.drop()
        membership, sa = self.membership, telegram.sa
        if membership.accepts(sa):
            self._collision_reported = False
            membership.ring.observe(sa, self.line.ts)
            membership.report_token(sa, now)
            self.machine.hold(now)

    def token_seen(self, telegram: Telegram, now: int) -> None:
        """The LAS follows every token. A sender that passes us over has dropped us: its GAP poll brings us back."""
        self.line.drop()
        membership = self.membership
        sa, da = telegram.sa, telegram.da
        membership.saw_pass(sa, da)
        membership.ring.observe(sa, da)
        membership.report_token(sa, now)
        if membership.in_ring and membership.ring.skips(sa, da):
            membership.leave(now, f"station {sa} passed the token over us to {da}")
            self._listen(now)

    def status_in_ring(self, telegram: Telegram, now: int) -> None:
        """FDL status while the token is elsewhere."""
        in_ring = self.membership.in_ring
        self._status(telegram, StationType.MASTER_IN_RING if in_ring else StationType.MASTER_READY)

    def no_service(self, telegram: Telegram, now: int) -> None:
        """A master opens no SAP to others: RS, but never to what is not answered at all (SDN, clock, time)."""
        self.line.drop()
        if not telegram.fc & 0x80 and telegram.function not in UNANSWERED:
            self._status(telegram, StationType.MASTER_IN_RING, Resp.RS)

    def drop_answer(self, telegram: Telegram, now: int) -> None:
        """Others are talking: an answer that did not go out in time is not wanted any more."""
        self.line.drop()
        if telegram is not NONE:
            self.membership.forget_pass()

    def late(self, telegram: Telegram, now: int) -> None:
        """An answer to an exchange of a hold that is over, or SC for another master."""
        self.line.drop()
        self.exchange.late(telegram, now)

    def answered(self, _: Telegram, now: int) -> None:
        """Our status answer is on the line; T_TO counts from its end."""
        self.machine.set_deadline(self.line.idle_since + self.times.t_to_ns)

    def own_address(self, telegram: Telegram, now: int) -> None:
        """Somebody sends with our address. A token has no check sequence, so one alone may be a damaged one."""
        window_ns = _BACK_OFF_T_TO * self.times.t_to_ns
        before, self._own_token_at = self._own_token_at, now
        if telegram.kind == Kind.SD4 and now - before > window_ns:
            return
        if not self._collision_reported:
            self._collision_reported = True
            self.events.append(AddressCollision(t_ns=now, address=self.line.ts))
        self.exchange.abandon(now)
        self.membership.leave(now, "another station has the same address")
        if self.membership.leaving:
            self.go_offline(now, "ordered")
            return
        self._back_off_until = now + window_ns
        self._listen(now)

    # --- Claim_Token ------------------------------------------------------------------------------------------------
    def _claim(self, now: int) -> None:
        """Two tokens to itself. The LAS is kept where there is one: who is still there gets the token next."""
        machine, membership = self.machine, self.membership
        self._claim_from = machine.state
        if machine.state is ACTIVE_IDLE:
            self.stats.tokens_lost += 1
            self.events.append(TokenLost(t_ns=now, address=self.line.ts))
        elif not membership.ring.learned:
            membership.ring.forget()
        self.peers.gap.restart()
        machine.enter(CLAIM_TOKEN)
        self._claims_left = CLAIM_TOKENS
        self.line.queue_token(self.line.ts)

    def claim_sent(self, _: Telegram, now: int) -> None:
        """After the second one the token is ours."""
        self._claims_left -= 1
        if self._claims_left:
            self.line.queue_token(self.line.ts)
            return
        self._collision_reported = False
        self.membership.claim()
        self.machine.hold(self.line.taken_at)

    def claim_broken(self, telegram: Telegram, now: int) -> None:
        """Something was heard between the two tokens: somebody else is there, so wait again."""
        self.line.drop()
        self._wait_in(self._claim_from)
        if telegram is not NONE:
            self.machine.telegram(telegram, now)

    def _status(self, telegram: Telegram, kind: StationType, status: Resp = Resp.OK) -> None:
        self.line.reply(encode_sd1(telegram.sa, self.line.ts, kind << _TYPE_SHIFT | status))
