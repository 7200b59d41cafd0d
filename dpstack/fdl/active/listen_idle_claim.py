"""Handlers of the states without the token: Offline, Listen_Token, Active_Idle, and Claim_Token."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.fdl.active.exchange import Exchange
from dpstack.fdl.active.las_gap import CLAIM_TOKENS
from dpstack.fdl.active.parts import Common, Parts
from dpstack.fdl.active.states import ACTIVE_IDLE, CLAIM_TOKEN, LISTEN_TOKEN, NONE, OFFLINE, State
from dpstack.fdl.codec import encode_sd1
from dpstack.fdl.events import AddressCollision, TokenLost
from dpstack.fdl.interface import ActiveResponder
from dpstack.fdl.telegram import UNANSWERED, Kind, Req, Resp, StationType, Telegram
from dpstack.params import BROADCAST
from dpstack.units import NEVER

#: After a collision this station stays silent for this many T_TO since its address was heard last.
_BACK_OFF_T_TO: Final = 10
_TYPE_SHIFT: Final = 4
_SDN: Final = frozenset((Req.SDN_LOW, Req.SDN_HIGH))
#: FC of a Time_Event and of a Clock_Value
_CLOCK: Final = frozenset((0x40, 0xC0))


class Waiting(Parts):
    """The states without the token."""

    __slots__ = (
        "_back_off_until",
        "_claim_from",
        "_claims_left",
        "_collision_reported",
        "_own_token_at",
        "exchange",
        "hear_clock",
        "responder",
    )

    def __init__(self, common: Common, exchange: Exchange) -> None:
        super().__init__(common)
        self.exchange = exchange
        #: answers the requests of other masters; None: RS to all
        self.responder: ActiveResponder | None = None
        #: gets each Time_Event and Clock_Value of other masters with the time of its end; None: nobody
        self.hear_clock: Callable[[Telegram, int], None] | None = None
        self._back_off_until = 0
        self._own_token_at = -NEVER  # time of the last received token with SA = TS
        self._collision_reported = False
        self._claims_left = 0
        self._claim_from = LISTEN_TOKEN

    # --- entering these states, also from a token hold --------------------------------------------------------------
    def go_idle(self, now: int, telegram: Telegram = NONE) -> None:
        """Another station has the token: enter Active_Idle, or Offline if this was the last hold.

        Active_Idle handles ``telegram`` of that station.
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
        self.membership.leaving = False
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
        """Listen for at least T_TO before the first telegram."""
        self.line.note_activity(now)
        self.line.end_arrival()
        self._back_off_until = 0
        self._own_token_at = -NEVER
        self._collision_reported = False
        self._listen(now)

    def stay_offline(self, _: Telegram, now: int) -> None: ...

    def line_down(self, _: Telegram, now: int) -> None:
        """The port is gone. Other slaves may be there when it returns, so the FCB of all addresses starts anew."""
        for address in range(128):
            self.exchange.fcb.restart(address)
        self.go_offline(now, "the line is down")

    def leave(self, _: Telegram, now: int) -> None:
        """Go offline without the token: after three attempts the predecessor drops this station from its LAS."""
        self.go_offline(now, "ordered")

    # --- Listen_Token -----------------------------------------------------------------------------------------------
    def learn(self, telegram: Telegram, now: int) -> None:
        """A token between other stations, or to an earlier station with the same address."""
        self.line.drop()
        stats = self.stats
        if telegram.sa not in stats.token_senders:
            stats.token_senders |= {telegram.sa}
        self.membership.ring.learn(telegram.sa, telegram.da)
        self.membership.report_token(telegram.sa, now)

    def request_listening(self, telegram: Telegram, now: int) -> None:
        """A request of another master: note its sender, which may be a master that passes no token."""
        stats = self.stats
        if telegram.sa not in stats.requesters:
            stats.requesters |= {telegram.sa}
        self.drop_answer(telegram, now)
        self._pass_clock(telegram, now)

    def status_listening(self, telegram: Telegram, now: int) -> None:
        """FDL status request: only the predecessor polls this address, so after 'ready' it will pass the token."""
        if now < self._back_off_until:
            return
        if not self.membership.ring.learned:
            self._reply_status(telegram, StationType.MASTER_NOT_READY)
            return
        self._wait_in(ACTIVE_IDLE)
        self._reply_status(telegram, StationType.MASTER_READY)

    def silence(self, _: Telegram, now: int) -> None:
        """The deadline of T_TO is over: check it against the activity since it was set."""
        line, t_to_ns = self.line, self.times.t_to_ns
        quiet_at = line.idle_since + t_to_ns
        if quiet_at < line.busy_until:
            # an edge without telegram has delayed the deadlines of all low addresses to the same end: T_TO begins there
            quiet_at = line.busy_until + t_to_ns
        if now < quiet_at:
            self.machine.deadline = quiet_at
        elif not self._back_off_until:
            self._claim(now)
        elif now < self._back_off_until:
            self.machine.deadline = self._back_off_until
        else:
            # this station was part of the silence of its back-off: listen for a whole T_TO again
            self._back_off_until = 0
            self.machine.deadline = now + t_to_ns

    # --- Active_Idle ------------------------------------------------------------------------------------------------
    def token_to_me(self, telegram: Telegram, now: int) -> None:
        """A token to this station: accept it if its sender may pass it (:meth:`Membership.accepts`)."""
        self.line.drop()
        membership, sa = self.membership, telegram.sa
        if membership.accepts(sa):
            self._collision_reported = False
            membership.ring.observe(sa, self.line.ts)
            membership.report_token(sa, now)
            self.machine.hold(now)

    def token_seen(self, telegram: Telegram, now: int) -> None:
        """Update the LAS by a token between others. If it skips this station, wait for a GAP poll to join again."""
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
        """FDL status request while another station has the token."""
        in_ring = self.membership.in_ring
        if self.responder is not None:
            self.responder.forget()
        self._reply_status(telegram, StationType.MASTER_IN_RING if in_ring else StationType.MASTER_READY)

    def request_to_me(self, telegram: Telegram, now: int) -> None:
        """A request of another master: the SAPs of the program answer it. Without them RS, except to SDN, clock value
        and time event."""
        self.line.drop()
        responder = self.responder
        if telegram.fc & 0x80 or telegram.function in UNANSWERED:
            if responder is not None and telegram.function in _SDN:
                responder.indicate(telegram, now)
        elif responder is None:
            self._reply_status(telegram, StationType.MASTER_IN_RING, Resp.RS)
        elif (octets := responder.answer(telegram, now)) is not None:
            self.line.reply(octets)

    def request_seen(self, telegram: Telegram, now: int) -> None:
        """A request to another station or to all: an SDN to all is for the SAPs of the program, too."""
        self.drop_answer(telegram, now)
        if telegram.da != BROADCAST:
            return
        if self.responder is not None and telegram.function in _SDN:
            self.responder.indicate(telegram, now)
        self._pass_clock(telegram, now)

    def _pass_clock(self, telegram: Telegram, now: int) -> None:
        if self.hear_clock is not None and telegram.da == BROADCAST and telegram.fc in _CLOCK:
            self.hear_clock(telegram, now)

    def drop_answer(self, telegram: Telegram, now: int) -> None:
        """Other stations are sending: drop the answer that was not sent in time."""
        self.line.drop()
        if telegram is not NONE:
            self.membership.forget_pass()

    def late(self, telegram: Telegram, now: int) -> None:
        """An answer to an exchange of an earlier hold, or SC for another master."""
        self.line.drop()
        self.exchange.late(telegram, now)

    def answered(self, _: Telegram, now: int) -> None:
        """The status answer of this station is sent; T_TO counts from its end."""
        self.machine.deadline = self.line.idle_since + self.times.t_to_ns

    def own_address(self, telegram: Telegram, now: int) -> None:
        """Another station sends with this address. A single token may be a damaged one: it has no check sequence."""
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
        """Send two tokens to itself. Keep a known LAS: its next member that still answers gets the token."""
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
        """A token of the claim is sent: after the second one this station has the token."""
        self._claims_left -= 1
        if self._claims_left:
            self.line.queue_token(self.line.ts)
            return
        self._collision_reported = False
        self.membership.claim()
        self.machine.hold(self.line.taken_at)

    def claim_broken(self, telegram: Telegram, now: int) -> None:
        """Activity between the two tokens: another station is there, so wait again."""
        self.line.drop()
        self._wait_in(self._claim_from)
        if telegram is not NONE:
            self.machine.telegram(telegram, now)

    def _reply_status(self, telegram: Telegram, kind: StationType, status: Resp = Resp.OK) -> None:
        self.line.reply(encode_sd1(telegram.sa, self.line.ts, kind << _TYPE_SHIFT | status))
