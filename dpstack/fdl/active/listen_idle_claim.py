"""Handlers of the states without the token: Offline, Listen_Token, Active_Idle, and Claim_Token."""

from __future__ import annotations

from typing import Final

from dpstack.fdl.active import exchange
from dpstack.fdl.active.context import NONE, Link, classify
from dpstack.fdl.active.las_gap import CLAIM_TOKENS
from dpstack.fdl.active.states import Input, State
from dpstack.fdl.codec import encode_sd1
from dpstack.fdl.events import AddressCollision, TokenLost
from dpstack.fdl.telegram import Kind, Resp, StationType, Telegram
from dpstack.units import NEVER

#: After a collision this station stays silent for so many T_TO since its address was heard last.
_BACK_OFF_T_TO: Final = 10
_TYPE_SHIFT: Final = 4
_UNANSWERED: Final = frozenset({0, 4, 6})  # time event, SDN low, SDN high


# --- Offline ---------------------------------------------------------------------------------------------------------
def go_online(link: Link, _: Telegram, now: int) -> None:
    """Listen for at least T_TO before anything is sent."""
    if link.line_is_down:
        return
    link.line.heard(now)
    link.back_off_until = 0
    link.own_token_at = -NEVER
    link.collision_told = False
    link.go_listening(now)


def stay_offline(link: Link, _: Telegram, now: int) -> None: ...


def line_up(link: Link, _: Telegram, now: int) -> None:
    """The port is back; whatever was known of the bus is old."""
    if link.wanted:
        go_online(link, NONE, now)


def line_down(link: Link, _: Telegram, now: int) -> None:
    """The port is gone; slaves may be others when it returns: fresh FCB for all."""
    for address in range(128):
        link.fcb.restart(address)
    link.go_offline(now, "the line is down")


def go_offline(link: Link, _: Telegram, now: int) -> None:
    """Without the token nothing has to be handed over: the predecessor drops us after three tries."""
    link.go_offline(now, "ordered")


# --- Listen_Token ----------------------------------------------------------------------------------------------------
def learn(link: Link, telegram: Telegram, now: int) -> None:
    """One token between others, or to a station of our address that was there before us."""
    link.tx = None
    stats = link.stats
    if telegram.sa not in stats.token_senders:
        stats.token_senders |= {telegram.sa}
    link.ring.learn(telegram.sa, telegram.da)
    link.heard_token(telegram.sa, now)


def request_listening(link: Link, telegram: Telegram, now: int) -> None:
    """A request of another master: note its sender, which may be one that passes no token."""
    stats = link.stats
    if telegram.sa not in stats.requesters:
        stats.requesters |= {telegram.sa}
    heard(link, telegram, now)


def status_listening(link: Link, telegram: Telegram, now: int) -> None:
    """FDL status: only the predecessor polls us, so its sender will pass the token once it heard 'ready'."""
    if now < link.back_off_until:
        return
    if not link.ring.learned:
        _status(link, telegram, StationType.MASTER_NOT_READY)
        return
    link.enter(State.ACTIVE_IDLE)
    link.await_silence()
    _status(link, telegram, StationType.MASTER_READY)


def silence(link: Link, _: Telegram, now: int) -> None:
    """T_TO may be over; what was heard since it was armed moved it on."""
    quiet_at = link.line.idle_since + link.t_to_ns
    if quiet_at < link.busy_until:
        # an edge of which nothing came has held the deadlines of low addresses to one end: apart again from there
        quiet_at = link.busy_until + link.t_to_ns
    if now < quiet_at:
        link.deadline = quiet_at
    elif link.back_off_until:
        # the silence of a back-off is ours too: afterwards listen for a whole T_TO again
        over = now >= link.back_off_until
        link.deadline = now + link.t_to_ns if over else link.back_off_until
        if over:
            link.back_off_until = 0
    else:
        _claim(link, now)


# --- Active_Idle -----------------------------------------------------------------------------------------------------
def token_to_me(link: Link, telegram: Telegram, now: int) -> None:
    """The token. Only the predecessor may pass it; whoever insists is the new predecessor.

    So is, at its first token, a station that was heard repeating a pass to another one which stayed silent: it has the
    token, and its ring has changed. (A master that leaves cost the others one more T_SL with all the host's slack.)
    """
    link.tx = None
    sa = telegram.sa
    if sa not in (link.ring.ps, link.refused, link.in_vain):
        link.refused = sa
        return
    link.refused = -1
    link.forget_pass()
    link.claimed = False
    link.ring.observe(sa, link.ts)
    link.heard_token(sa, now)
    link.enter(State.USE_TOKEN)
    link.dispatch(Input.HOLD, NONE, now)


def token_seen(link: Link, telegram: Telegram, now: int) -> None:
    """The LAS follows every token. A sender that passes us over has dropped us: only its GAP poll brings us back."""
    link.tx = None
    link.refused = -1
    ring = link.ring
    sa, da = telegram.sa, telegram.da
    link.in_vain = sa if (sa, da) == link.last_pass else -1
    link.last_pass = (sa, da)
    ring.observe(sa, da)
    link.heard_token(sa, now)
    if link.in_ring and ring.skips(sa, da):
        link.leave_ring(now, f"station {sa} passed the token over us to {da}")
        link.go_listening(now)


def status_in_ring(link: Link, telegram: Telegram, now: int) -> None:
    """FDL status while the token is elsewhere."""
    _status(link, telegram, StationType.MASTER_IN_RING if link.in_ring else StationType.MASTER_READY)


def no_service(link: Link, telegram: Telegram, now: int) -> None:
    """A master opens no SAP to others: RS, but never to what is not answered at all (SDN, clock, time)."""
    link.tx = None
    if telegram.fc & 0x80 or telegram.function in _UNANSWERED:
        return
    link.reply(encode_sd1(telegram.sa, link.ts, StationType.MASTER_IN_RING << _TYPE_SHIFT | Resp.RS))


def heard(link: Link, telegram: Telegram, now: int) -> None:
    """Others are talking: an answer that did not go out in time is not wanted any more."""
    link.tx = None
    if telegram is not NONE:
        link.forget_pass()


def late(link: Link, telegram: Telegram, now: int) -> None:
    """An answer to an exchange of a hold that is over, or SC for another master."""
    link.tx = None
    exchange.late(link, telegram, now)


def answered(link: Link, _: Telegram, now: int) -> None:
    """Our status answer is on the line; T_TO counts from its end."""
    link.await_silence()


def own_address(link: Link, telegram: Telegram, now: int) -> None:
    """Somebody sends with our address. A token has no check sequence, so one alone may be a damaged one."""
    window_ns = _BACK_OFF_T_TO * link.t_to_ns
    if telegram.kind == Kind.SD4 and now - link.own_token_at > window_ns:
        link.own_token_at = now
        return
    link.own_token_at = now
    if not link.collision_told:
        link.collision_told = True
        link.events.append(AddressCollision(t_ns=now, address=link.ts))
    link.abandon(now)
    link.leave_ring(now, "another station has the same address")
    if link.leaving:
        link.go_offline(now, "ordered")
        return
    link.back_off_until = now + window_ns
    link.go_listening(now)


# --- Claim_Token -----------------------------------------------------------------------------------------------------
def _claim(link: Link, now: int) -> None:
    """Two tokens to itself. The LAS is kept where there is one: who is still there gets the token next."""
    link.claim_from = link.state
    if link.state is State.ACTIVE_IDLE:
        link.stats.tokens_lost += 1
        link.events.append(TokenLost(t_ns=now, address=link.ts))
    elif not link.ring.learned:
        link.ring.forget()
    link.gap.restart()
    link.enter(State.CLAIM_TOKEN)
    link.claims_left = CLAIM_TOKENS
    link.queue_token(link.ts)


def claim_sent(link: Link, _: Telegram, now: int) -> None:
    """After the second one the token is ours."""
    link.claims_left -= 1
    if link.claims_left:
        link.queue_token(link.ts)
        return
    link.claimed = True
    link.stagger()
    link.enter(State.USE_TOKEN)
    link.dispatch(Input.HOLD, NONE, link.taken_at)


def claim_broken(link: Link, telegram: Telegram, now: int) -> None:
    """Something was heard between the two tokens: somebody else is there, so wait again."""
    link.tx = None
    link.enter(link.claim_from)
    link.await_silence()
    if telegram is not NONE:
        link.dispatch(classify(telegram, link.ts), telegram, now)


def _status(link: Link, telegram: Telegram, kind: StationType) -> None:
    link.reply(encode_sd1(telegram.sa, link.ts, kind << _TYPE_SHIFT | Resp.OK))
