"""One exchange with a station: the request, its answer or the lack of it, repetitions, late answers.

What can be known of an answer, most certain first:

* Another sender, SAPs that are not the request's crosswise, data where the service has none: not ours, counted.
* SC names nobody. It counts for a service that can be acknowledged, and only while we wait.
* Exact lines: what begins before min T_SDR after our request cannot be its answer.
* An exchange that was given up, or needed a repetition, may have left an answer on its way. The first telegram that
  fits both that exchange and the new one is kept back for one slot time: if a second one follows, the first was the
  late one; if nothing follows, it was the answer. (A port's delays exceed the wire's times, so time tells nothing.)
"""

from __future__ import annotations

from typing import Final, NamedTuple

from dpstack.fdl.active.context import NONE, Doubt, Link
from dpstack.fdl.active.states import Input, State
from dpstack.fdl.codec import request_octets
from dpstack.fdl.describe import request_name
from dpstack.fdl.events import le3_notice
from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, Resp, Telegram
from dpstack.params import BROADCAST
from dpstack.trace import Notice, Severity
from dpstack.units import chars_to_ns


class _Service(NamedTuple):
    fc: int
    counted: bool  # FCB and FCV are used
    answered: bool
    acknowledged: bool  # SC is an answer


def _service(function: Req, counted: bool, answered: bool, acknowledged: bool) -> _Service:
    fc = 0xC0 if function is Req.CLOCK_VALUE else 0x40 | function
    return _Service(fc, counted, answered, acknowledged)


# FDL status, ident, LSAP status and SDN carry FCV = 0 and FCB = 0 (docs/protocol.md#frame-count-bit).
_SERVICES: Final[dict[Req, _Service]] = {
    f: _service(
        f,
        f in (Req.SDA_LOW, Req.SDA_HIGH, Req.SRD_LOW, Req.SRD_HIGH, Req.MSRD),
        f not in (Req.SDN_LOW, Req.SDN_HIGH, Req.TIME_EVENT, Req.CLOCK_VALUE),
        f in (Req.SDA_LOW, Req.SDA_HIGH, Req.SRD_LOW, Req.SRD_HIGH, Req.MSRD),
    )
    for f in Req
}
#: octets around the data unit of SD2, those of SD1, and those of two SAPs
_FRAME: Final = 9
_SD1: Final = 6
_SAPS: Final = 2
# An enum's member costs ten times a name of the module: those of every exchange are named here.
_USE_TOKEN: Final = State.USE_TOKEN
_AWAIT_DATA_RESPONSE: Final = State.AWAIT_DATA_RESPONSE
_CHECK_ACCESS_TIME: Final = State.CHECK_ACCESS_TIME
_CHECK: Final = Input.CHECK
_SC: Final = Kind.SC
_FDL_STATUS: Final = Req.FDL_STATUS
#: so many slot times with the port's patience an answer may come late
_OWED_SLOTS: Final = 4
#: so many answers more than requests, or requests with unreadable answers, among so many requests are told
_DOUBLED: Final = 10
_UNREADABLE: Final = 50
_OF_REQUESTS: Final = 100
#: responses that say no or plainly yes
_WITHOUT_DATA: Final = frozenset({int(Resp.OK), int(Resp.UE), int(Resp.RR), int(Resp.RS), int(Resp.NR)})


def ends_at(link: Link, request: Request, now: int) -> int:
    """When ``request``, asked for now, and the idle time after it are over at the latest, in ns: every attempt in vain
    but the last one, whose answer begins at the end of its slot time and has all the octets it may have.

    Where a station that is there is given more slack than its port usually needs, it is taken to answer the first
    attempt within what is usual: its silence costs a service what it costs a Data_Exchange. Nobody known to be there is
    waited for as long as there is room (:func:`in_vain_until`).
    """
    service = _SERVICES[request.function]
    line, baud = link.line, link.params.baud
    begins = max(now, line.idle_since + link.after_ns)
    octets = len(request.data) + (_SAPS if request.dsap is not None else 0)
    sending = chars_to_ns(octets + _FRAME if octets else _SD1, baud) + link.patience.sending_ns
    if not service.answered:
        return begins + sending + line.t_id2_ns
    tries = link.max_retry if request.retry else 0
    if service.counted and (request.restart or not link.fcb.operational[request.da]):
        tries = 0
    patience = link.patience
    if not waits_long(link, request):
        slot = link.slot_ns
    elif patience.known_ns > patience.unknown_ns:
        slot, tries = link.slot_unknown_ns, 0
    else:
        slot = link.slot_known_ns
    # an answer that may be a late one is kept back
    late = any(until >= now and _alike(owed, request) for owed, until in link.owed.values())
    kept = _kept_back_ns(link) if late else 0
    answer = _longest_answer_ns(link, request)
    return begins + (tries + 1) * (sending + slot) + answer + kept + line.t_id1_ns


def _alike(owed: Request, request: Request) -> bool:
    """Whether one telegram can answer both: from the same station, or SC."""
    return owed.da == request.da or (_SERVICES[owed.function].acknowledged and _SERVICES[request.function].acknowledged)


def _longest_answer_ns(link: Link, request: Request) -> int:
    return chars_to_ns(request.answer + _SAPS + _FRAME, link.params.baud)


def _kept_back_ns(link: Link) -> int:
    return link.line.t_sl_ns + link.patience.known_ns // 4


def in_vain_until(link: Link, request: Request, at: int, then_ns: int = 0) -> int:
    """How long the answer of an address where nobody is known is waited for: ``at`` is the last bit of ``request``.

    A port may be late, and one look longer than others (``extra_ns``), but before a fixed cycle ``then_ns`` (what
    follows) and T_ID1 have to fit in: as long as there is room, and never so short that an answer could still be on the
    wire. One that is later than that is recognised.
    """
    longest = at + link.slot_unknown_ns + (_extra_ns(link, request) if request.extra_ns else 0)
    next_at = link.budget.next_at
    if next_at >= longest + then_ns + link.line.t_id1_ns:
        return longest
    shortest = at + link.slot_ns + link.patience.sending_ns + _longest_answer_ns(link, request)
    return min(longest, max(shortest, next_at - then_ns - link.line.t_id1_ns))


def _extra_ns(link: Link, request: Request) -> int:
    """Of ``extra_ns`` what makes nobody wait longer than for a station that is there, and no other master on a wire
    claim the token meanwhile. (Where there is no wire the others are programs with a slack of their own.)
    """
    patience, ring = link.patience, link.ring
    extra = min(request.extra_ns, patience.known_ns - patience.unknown_ns)
    if patience.sending_ns and ring.ns != link.ts:
        lowest = min(address for address in ring.members if address != link.ts)
        t_to_ns = link.params.ns((6 + 2 * lowest) * link.params.t_sl)
        extra = min(extra, t_to_ns - link.slot_unknown_ns - patience.unknown_ns)
    return max(0, extra)


def waits_long(link: Link, request: Request) -> bool:
    """Whether the answer to ``request`` will be given the slack of a station whose silence would be news."""
    return request.patient or request.da in link.slow or link.knows(request.da)


def start(link: Link, user: LinkUser, request: Request) -> None:
    """Make the telegram of a new request and let it wait for its gate."""
    da, function, data, dsap, ssap, patient, retry, restart, _, _, _, _, _ = request
    fc, counted, answered, _ = _SERVICES[function]
    tries = link.max_retry if answered and retry else 0
    if counted:
        fcb = link.fcb
        if restart:
            fcb.restart(da)
        fc |= fcb.bits[da]
        if not fcb.operational[da]:
            tries = 0  # a first request is not repeated (docs/protocol.md#frame-count-bit)
    elif answered and not patient and link.knows(da):
        request = request._replace(patient=True)  # whoever asks: the silence of a station that is there is news
    link.user = user
    link.request = request
    link.tries_left = tries
    link.repeats = 0
    link.wrong = False
    link.frame = link.tx = request_octets(da, link.ts, fc, data, dsap, ssap)
    link.gate_ns = link.after_ns
    link.enter(_USE_TOKEN)


def sent(link: Link, at: int) -> None:
    """The first attempt goes out; its last bit is on the line at ``at``."""
    request, user = link.request, link.user
    asked = link.asked = link.stats.station(request.da)
    asked.requests += 1
    link.garbled = False  # what came before the request is no answer to it
    if user is not None:
        user.started(request, link.taken_at)
    if _SERVICES[request.function].answered:
        _await(link, at)
        return
    link.after_ns = link.line.t_id2_ns
    _finish(link, SHORT_ACK, link.taken_at)


def repeated(link: Link, _: Telegram, at: int) -> None:
    """A repetition goes out."""
    _await(link, at)


def _await(link: Link, at: int) -> None:
    link.enter(_AWAIT_DATA_RESPONSE)
    request = link.request
    patient = request.patient or request.da in link.slow
    link.deadline = at + link.slot_known_ns if patient else in_vain_until(link, request, at)
    if link.exact:
        link.early_until = at + link.early_ns


def response(link: Link, telegram: Telegram, now: int) -> None:
    """A response to us, or SC, while we wait for one."""
    request = link.request
    if not answers(request, telegram) or link.edge_at < link.early_until:
        _not_ours(link, telegram, now)
        return
    if link.owed and _hold_back(link, telegram, now):
        return
    _answered(link, telegram, now)


def answers(request: Request, telegram: Telegram) -> bool:
    """Whether ``telegram``, addressed to us or SC, can answer ``request``."""
    if telegram.kind == _SC:
        return _SERVICES[request.function].acknowledged
    if telegram.sa != request.da:
        return False
    if request.function == _FDL_STATUS:
        return not telegram.data and telegram.dsap is telegram.ssap is None
    if telegram.ssap == request.dsap and telegram.dsap == request.ssap:
        return True
    # refused or plainly acknowledged: SD1 has no room for SAPs
    return not telegram.data and telegram.dsap is telegram.ssap is None and telegram.function in _WITHOUT_DATA


def _hold_back(link: Link, telegram: Telegram, now: int) -> bool:
    """True when ``telegram`` may be a late answer and is kept for one slot time (see above)."""
    first = link.candidate
    if first is NONE:
        owing = _owing(link, telegram, now)
        if owing < 0:
            return False
        link.candidate = telegram
        link.deadline = now + _kept_back_ns(link)
        return True
    link.owed.pop(first.sa if first.sa >= 0 else link.request.da, None)
    _count_late(link, first, now)
    return False


def _owing(link: Link, telegram: Telegram, now: int) -> int:
    """The station that may still owe an answer such as ``telegram``, or -1. Forgets what is too old to come."""
    owed = link.owed
    for address in [a for a, (_, until) in owed.items() if now > until]:
        del owed[address]
    for address, (request, _) in owed.items():
        if answers(request, telegram):
            return address
    return -1


def _owe(link: Link, now: int) -> None:
    """An answer to the present request may still come."""
    link.owed[link.request.da] = (link.request, now + _OWED_SLOTS * link.slot_known_ns)


def owe_status(link: Link, address: int, now: int, slot_ns: int) -> None:
    """A GAP poll was given up after the slot time ``slot_ns``: its answer may come while the next request waits."""
    link.owed[address] = (Request(address, Req.FDL_STATUS), now + _OWED_SLOTS * slot_ns)


def _answered(link: Link, telegram: Telegram, now: int) -> None:
    request = link.request
    da = request.da
    link.asked.answers += 1
    if _SERVICES[request.function].counted and link.fcb.answered(da):
        text = (
            f"station {da} answered a request with FCV = 1 after three silent ones with FCV = 0: "
            "it was switched on just then, its answers came too late, or it does not know the standard's first request"
        )
        link.events.append(Notice(t_ns=now, source="fdl", message=text, severity=Severity.WARNING))
    if not telegram.data and telegram.empty_le3 and da not in link.told_le3:
        link.told_le3.add(da)
        link.events.append(le3_notice("fdl", da, now))
    if link.repeats:
        _owe(link, now)
    elif link.owed:
        link.owed.pop(da, None)
    _finish(link, telegram, now)


def _finish(link: Link, outcome: Telegram | Failure, now: int) -> None:
    user, request = link.user, link.request
    link.end_exchange()
    if user is not None:
        user.result(request, outcome, now)
    link.enter(_CHECK_ACCESS_TIME)
    link.row[_CHECK](link, NONE, now)


def timeout(link: Link, _: Telegram, now: int) -> None:
    """The slot time is over."""
    request = link.request
    candidate = link.candidate
    if candidate is not NONE:
        # nothing followed: what was kept back is the answer, and nothing is owed any more
        link.owed.clear()
        link.repeats = 0
        _answered(link, candidate, now)
        return
    station = link.asked
    _unanswered(link, now)
    if now > link.budget.next_at and not request.cyclic:
        link.budget.silent = f"{request_name(request)} to station {request.da}"
    outdated = False
    if link.tries_left:
        outdated = request.still is not None and not request.still(now)
        if not outdated:
            link.tries_left -= 1
            link.repeats += 1
            station.retries += 1
            link.queue(link.frame)
            return
    link.slow.discard(request.da)
    link.doubted.add(request.da)
    if request.patient or request.function != Req.FDL_STATUS:
        station.timeouts += 1
        _owe(link, now)
    elif not (station.answers or link.garbled):
        # nobody is known there: no fault, and an FDL status that comes late is as true as one in time
        del link.stats.stations[request.da]
    if _SERVICES[request.function].counted:
        link.fcb.given_up(request.da)
    if outdated:
        failure = Failure.ABANDONED
    elif link.wrong:
        failure = Failure.WRONG
    elif link.garbled:
        link.stats.garbled += 1
        failure = Failure.GARBLED
    else:
        failure = Failure.NO_ANSWER
    _finish(link, failure, now)


def is_outdated(link: Link, now: int) -> bool:
    """Whether the request that waits for its gate has data that are too old to be sent."""
    still = link.request.still
    return link.user is not None and still is not None and not still(now)


def drop_outdated(link: Link, now: int) -> None:
    """Do not send the request that waits: its data are too old. A first attempt may have been sent."""
    link.tx = None
    if link.repeats:
        _owe(link, now)
        link.fcb.given_up(link.request.da)
    _finish(link, Failure.ABANDONED, now)


def _not_ours(link: Link, telegram: Telegram, now: int) -> None:
    """A telegram to us that does not answer the request: late, wrong, or from nobody we know."""
    link.garbled = False
    sa = telegram.sa
    if sa == link.request.da and link.edge_at >= link.early_until and _owing(link, telegram, now) < 0:
        link.wrong = True
        link.stats.station(sa).wrong += 1
        _superfluous(link, sa, now)
    else:
        _count_late(link, telegram, now)


def late(link: Link, telegram: Telegram, now: int) -> None:
    """A response to us, or SC, that nobody waits for: the answer to an exchange that is over."""
    _count_late(link, telegram, now)
    link.owed.pop(telegram.sa, None)


def _count_late(link: Link, telegram: Telegram, now: int) -> None:
    """Only an answer of ours can be addressed to us; SC names nobody and counts as stray."""
    if telegram.sa < 0:
        link.stats.stray += 1
        if link.token_at >= 0 and link.state is not State.ACTIVE_IDLE and link.frame:
            # the token is ours, so it answers our last request
            da = link.frame[4 if link.frame[0] == Kind.SD2 else 1] & BROADCAST
            if da != BROADCAST:
                _superfluous(link, da, now)
        return
    link.slow.add(telegram.sa)
    link.stats.late += 1
    link.stats.station(telegram.sa).late += 1
    _superfluous(link, telegram.sa, now)


# --- two stations with one address ---------------------------------------------------------------------------------
# One station gives one answer to each attempt at most. A late answer follows an attempt that was given up.


def _superfluous(link: Link, address: int, now: int) -> None:
    """``address`` gave an answer that nobody waits for. More answers than attempts are those of two stations."""
    doubt = _doubt(link, address)
    doubt.superfluous += 1
    if doubt.superfluous >= _DOUBLED and not doubt.told_doubled:
        doubt.told_doubled = True
        text = (
            f"station {address} gives more answers than it gets requests ({doubt.superfluous} more): two stations have "
            f"address {address}, and what is read may be of either; switch one off, and give it another address"
        )
        link.events.append(Notice(t_ns=now, source="fdl", message=text, severity=Severity.WARNING))


def given_up(link: Link, address: int) -> None:
    """An attempt at ``address`` had no answer in time: one may come late."""
    doubt = link.doubts.get(address)
    if doubt is not None and doubt.superfluous:
        doubt.superfluous -= 1


def _unanswered(link: Link, now: int) -> None:
    """An attempt of the exchange under way had no answer that could be used."""
    da = link.request.da
    if link.doubts:
        given_up(link, da)
    if not link.garbled:
        return
    doubt = _doubt(link, da)
    if link.repeats == 0:
        doubt.unreadable += 1
    if doubt.unreadable >= _UNREADABLE and not doubt.told_unreadable:
        doubt.told_unreadable = True
        text = (
            f"half of the answers of station {da} cannot be read: check its cable, shielding and the termination, and "
            f"look for a second station with address {da}"
        )
        link.events.append(Notice(t_ns=now, source="fdl", message=text, severity=Severity.WARNING))


def _doubt(link: Link, address: int) -> Doubt:
    """What was odd in the last requests to ``address``."""
    requests = link.stats.station(address).requests
    doubt = link.doubts.get(address)
    if doubt is None:
        doubt = link.doubts[address] = Doubt(requests)
    elif requests - doubt.since > _OF_REQUESTS:
        doubt.since, doubt.superfluous, doubt.unreadable = requests, 0, 0
    return doubt
