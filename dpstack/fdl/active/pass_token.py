"""Handlers of Pass_Token and Check_Token_Pass."""

from __future__ import annotations

from typing import Final

from dpstack.fdl.active import exchange
from dpstack.fdl.active.context import NONE, Link, classify
from dpstack.fdl.active.states import Input, State
from dpstack.fdl.telegram import Kind, Telegram

#: the token is sent once and repeated twice before NS is dropped from the LAS
_ATTEMPTS: Final = 3


def start(link: Link, now: int) -> None:
    """The hold is over: the token to NS, which is TS itself when nobody else is in the ring."""
    if link.leaving and link.ring.ns == link.ts:
        link.go_offline(now, "ordered")
        return
    link.attempt = 1
    _pass(link)
    if link.ring.ns != link.ts:
        link.staggered = 0
    elif link.staggered:
        # Two holders in step (both lost the other's tokens) hear nothing of each other: their addresses set them apart.
        link.staggered -= 1
        link.gate_ns += link.params.ns(link.ts)
    if link.fresh and not link.exact and link.ring.ns == link.ts:
        # Alone with nothing to say: on a real port, do not fill line and processor with tokens to ourselves. One slot
        # time is far from anybody's T_TO (six at least).
        link.gate_ns = max(link.gate_ns, link.line.t_sl_ns)


def _pass(link: Link) -> None:
    link.enter(State.PASS_TOKEN)
    link.queue_token(link.ring.ns)


def sent(link: Link, _: Telegram, at: int) -> None:
    """The token is on the line, its last bit at ``at``. A lone master holds it again without waiting."""
    if link.ring.ns == link.ts:
        if link.leaving:
            link.go_offline(link.taken_at, "ordered")
            return
        link.enter(State.USE_TOKEN)
        link.dispatch(Input.HOLD, NONE, link.taken_at)
        return
    link.enter(State.CHECK_TOKEN_PASS)
    link.garbled = False
    link.deadline = at + (link.slot_known_ns if link.attempt == 1 else link.slot_again_ns)


def timeout(link: Link, _: Telegram, now: int) -> None:
    """NS did nothing for T_SL; or something was heard and no telegram came of it, then NS is believed to be active."""
    if link.garbled:
        link.go_idle(now)
        return
    if link.attempt < _ATTEMPTS:
        link.attempt += 1
        link.stats.token_retries += 1
        _pass(link)
        if link.attempt == _ATTEMPTS:
            # Two holders in step (a doubled token) hear nothing of each other: the last repetition tells them apart.
            link.gate_ns = max(link.gate_ns, now - link.line.idle_since + link.params.ns(link.ts))
        return
    gone = link.ring.ns
    link.ring.drop(gone)
    link.slow.discard(gone)
    link.gap.stations.pop(gone, None)  # three tokens in vain: no more slack for its GAP poll than for anybody
    link.tell_master(gone, now)
    if link.ring.ns == link.ts:
        link.stagger()
    start(link, now)


def activity(link: Link, _: Telegram, now: int) -> None:
    """Somebody is active; give a telegram another slot time to become readable."""
    link.garbled = True
    link.deadline = now + link.slot_known_ns


def response(link: Link, telegram: Telegram, now: int) -> None:
    """SC was meant for another master, so there is one; a response to us is late and says nothing about NS."""
    if telegram.kind == Kind.SC:
        link.stats.stray += 1
        link.go_idle(now)
        return
    link.garbled = False
    exchange.late(link, telegram, now)


def confirmed(link: Link, telegram: Telegram, now: int) -> None:
    """A telegram that is not ours: the token is elsewhere. What it says counts in Active_Idle."""
    link.go_idle(now)
    if link.state is State.ACTIVE_IDLE:
        link.dispatch(classify(telegram, link.ts), telegram, now)
