"""Handlers of a token hold: Use_Token, Check_Access_Time, the GAP poll; withdrawing from a token that is not ours."""

from __future__ import annotations

from typing import Final

from dpstack.fdl.active import exchange
from dpstack.fdl.active import pass_token as passing
from dpstack.fdl.active.context import NONE, Link, classify
from dpstack.fdl.active.states import Input, State
from dpstack.fdl.codec import encode_sd1
from dpstack.fdl.describe import request_name
from dpstack.fdl.events import DoesNotFit, RingJoined, StationFound
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import FC_REQUEST, Kind, Req, StationType, Telegram
from dpstack.units import NEVER

# asked in every exchange: an enum's member costs ten times a name of the module
_CHECK: Final = Input.CHECK
_CHECK_ACCESS_TIME: Final = State.CHECK_ACCESS_TIME
_STATUS_FC: Final = FC_REQUEST | Req.FDL_STATUS
#: after so many holds without time for a GAP poll that was due, low-priority service stands back once
_GAP_PATIENCE: Final = 8


def begin(link: Link, _: Telegram, now: int) -> None:
    """The token is ours: T_TH = T_TR - T_RR, so it ends one T_TR after the receipt before
    (docs/protocol.md#token-rotation)."""
    before = link.token_at
    link.token_at = now
    if before >= 0:
        rotation = now - before
        link.last_rotation = rotation
        link.token_rotation.add(rotation)
        link.until = before + link.t_tr_ns
    else:
        link.until = now + link.t_tr_ns
    link.fresh = True
    link.budget.alone = link.ring.ns == link.ts
    link.gap_turn = link.gap.skipped >= _GAP_PATIENCE
    link.stats.tokens += 1
    if not link.in_ring:
        _joined(link, now)
    _tell_users(link, now)
    _go_on(link, now)


def _joined(link: Link, now: int) -> None:
    link.in_ring = True
    link.collision_told = False
    link.gap.restart()
    masters = tuple(sorted(link.ring.members))
    link.events.append(RingJoined(t_ns=now, address=link.ts, claimed=link.claimed, masters=masters))


def check(link: Link, _: Telegram, now: int) -> None:
    """What comes next: high priority once even when T_TH is over, everything while time is left, GAP, token."""
    if not link.leaving:
        budget = link.budget
        over = now >= link.until
        if not over or link.fresh:
            high_only = over or link.gap_turn
            for user in link.users:
                request = user.next_request(now, high_only)
                if request is not None:
                    if not (request.cyclic or budget.next_at == NEVER or _admitted(link, request, now)):
                        user.result(request, Failure.HELD_BACK, now)
                        continue
                    link.fresh = False
                    link.made_at = now
                    exchange.start(link, user, request)
                    return
        if link.gap.enabled and _poll(link, now):
            return
        if now < budget.next_at != NEVER and (not over or link.fresh):
            keep_ns = link.keep_alone_ns if budget.alone else link.keep_ns
            # the result of an SDN comes before its end: the token could not go on sooner than this
            free_at = max(now, link.line.idle_since + link.after_ns)
            if budget.next_at - free_at <= keep_ns:
                link.enter(State.USE_TOKEN)  # the next cycle begins with this token: silent until then
                link.deadline = budget.next_at
                return
    passing.start(link, now)


def resume(link: Link, _: Telegram, now: int) -> None:
    """The cycle for which the token was kept is due: for the users it is as if the token had come for it. (Where hardly
    any time is left between two cycles it never leaves for as long as T_TH lasts.)
    """
    _tell_users(link, now)
    _go_on(link, now)


def let_go(link: Link, now: int) -> None:
    """A user was ordered something: where the token is kept for a cycle, ask whether that still stands."""
    if link.state is State.USE_TOKEN and link.tx is None and link.deadline != NEVER:
        _go_on(link, now)


def _tell_users(link: Link, now: int) -> None:
    for user in link.users:
        user.token_received(now)
    link.ask_times()


def _go_on(link: Link, now: int) -> None:
    link.enter(_CHECK_ACCESS_TIME)
    link.row[_CHECK](link, NONE, now)


def _admitted(link: Link, request: Request, now: int, then_ns: int = 0) -> bool:
    """Whether a request that is no part of the cycle may be sent now; what never fits in is told, once for each.

    ``then_ns``: what has to follow it.
    """
    budget = link.budget
    until = exchange.ends_at(link, request, now) + then_ns
    if not budget.admits((request.function, request.da, request.dsap), until):
        return False
    if until > budget.next_at:
        name = request_name(request)
        budget.overdrawn = f"{name} to station {request.da}"
        if request.dsap not in link.told_forced:
            link.told_forced.add(request.dsap)
            slack_ns = link.patience.unknown_ns if exchange.waits_long(link, request) else 0
            link.events.append(
                DoesNotFit(t_ns=now, service=name, address=request.da, takes_ns=until - now, slack_ns=slack_ns)
            )
    return True


def _poll_request(address: int) -> Request:
    return Request(address, Req.FDL_STATUS, retry=False, answer=0)


def _poll(link: Link, now: int) -> bool:
    """One GAP poll a hold, when it is due, fits into T_TH and into what silent polls may take."""
    gap = link.gap
    address = gap.due(link.ring.ns, now)
    if address < 0:
        return False
    if now >= link.until:
        gap.skipped += 1
        return False
    if not link.knows(address) and not gap.allowance.allows(now):
        return False
    if link.budget.next_at != NEVER and not _admitted(link, _poll_request(address), now, link.pass_ns):
        return False
    link.polling = address
    link.fresh = False
    link.enter(State.USE_TOKEN)
    link.queue(encode_sd1(address, link.ts, _STATUS_FC))
    return True


def sent(link: Link, _: Telegram, at: int) -> None:
    """A request or a GAP poll is on the line; its last bit at ``at``."""
    if link.polling < 0:
        exchange.sent(link, at)
        return
    link.stats.gap_polls += 1
    link.garbled = False  # what came before the poll is no answer to it
    link.enter(State.AWAIT_STATUS_RESPONSE)
    if link.knows(link.polling):
        link.deadline = at + link.slot_known_ns
    else:
        link.deadline = exchange.in_vain_until(link, _poll_request(link.polling), at, link.pass_ns)
    if link.exact:
        link.early_until = at + link.early_ns


def status(link: Link, telegram: Telegram, now: int) -> None:
    """The answer of the address polled: a ready master becomes NS (docs/protocol.md#gap-update)."""
    address = link.polling
    plain = not telegram.data and telegram.dsap is telegram.ssap is None and telegram.kind != Kind.SC
    if telegram.sa != address or not plain or link.edge_at < link.early_until:
        link.garbled = False
        exchange.late(link, telegram, now)
        return
    kind = telegram.station_type
    link.polling = -1
    link.doubted.discard(address)
    if link.gap.polled(address, kind):
        _tell_found(link, StationFound(t_ns=now, address=address, kind=kind))
    # 'in ring' of a station that is not in our LAS: it lost its token as we did, take it in
    if kind >= StationType.MASTER_READY and link.ring.add(address):
        link.tell_master(address, now)
    passing.start(link, now)


def _tell_found(link: Link, news: StationFound) -> None:
    """The application is told, and the users, which may have something to do at once."""
    link.events.append(news)
    for user in link.users:
        user.command(news, news.t_ns)
    link.ask_times()


def status_timeout(link: Link, _: Telegram, now: int) -> None:
    """Nobody answered the GAP poll. Octets that could not be read prove nothing either way."""
    address = link.polling
    link.polling = -1
    known = link.knows(address)
    link.slow.discard(address)
    link.doubted.discard(address)
    exchange.given_up(link, address)
    if link.garbled:
        link.gap.passed(address)
    elif link.gap.polled(address, None):
        _tell_found(link, StationFound(t_ns=now, address=address, kind=None))
    if known:
        exchange.owe_status(link, address, now, link.slot_known_ns)
        if now > link.budget.next_at:
            link.budget.silent = f"{request_name(_poll_request(address))} to station {address}"
    else:
        link.gap.allowance.charge(link.slot_unknown_ns)
        if link.budget.next_at != NEVER and not link.exact:  # it may have had less than that
            exchange.owe_status(link, address, now, link.slot_unknown_ns)
    passing.start(link, now)


def withdraw(link: Link, telegram: Telegram, now: int) -> None:
    """Another station sends as only a token holder does: it is not us. What it sent counts in Active_Idle."""
    repeated = telegram.kind == Kind.SD4 and telegram.da == link.ts and telegram.sa == link.ring.ps
    if repeated and link.state is State.USE_TOKEN:
        return  # the predecessor did not see us start in time; the token is still ours
    link.stats.withdrawn += 1
    link.abandon(now)
    link.go_idle(now)
    if link.state is State.ACTIVE_IDLE:
        link.dispatch(classify(telegram, link.ts), telegram, now)


def stray(link: Link, _: Telegram, now: int) -> None:
    """A response to somebody else while we hold the token."""
    link.garbled = False
    link.stats.stray += 1


def noise(link: Link, _: Telegram, now: int) -> None:
    """An edge or octets: a telegram may follow; if none does, the answer was garbled."""
    link.garbled = True


def leave(link: Link, _: Telegram, now: int) -> None:
    """Go offline after what is under way; nothing is repeated."""
    link.leaving = True
    link.tries_left = 0


def leave_now(link: Link, _: Telegram, now: int) -> None:
    """Nothing is under way: what waits is not sent any more, the token goes on."""
    link.leaving = True
    link.abandon(now)
    passing.start(link, now)
