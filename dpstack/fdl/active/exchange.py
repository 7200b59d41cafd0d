"""Exchange with a station: request, answer, time-out, repetitions, late answers.

Rules that decide whether a telegram is the answer, the most certain first:

* Another sender, SAPs that are not those of the request exchanged, data if the service has none: no answer, counted.
* SC has no addresses. It is the answer to a service that can be acknowledged, and only while the station waits.
* Exact lines: a telegram that begins before min T_SDR after the request is no answer.
* An earlier exchange that ended without answer, or with a repetition, may have a late answer. The station keeps back
  the first telegram that fits both that exchange and the new one for one slot time. If a second telegram follows, the
  first was late; if none follows, the first was the answer. (A port's delays exceed the times on the wire, so the time
  of arrival proves nothing.)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.fdl.active.admission import Admission
from dpstack.fdl.active.fcb import FrameCount
from dpstack.fdl.active.parts import Awaiting, Common
from dpstack.fdl.active.services import SERVICES, answers
from dpstack.fdl.active.states import ACTIVE_IDLE, AWAIT_DATA_RESPONSE, CHECK, CHECK_ACCESS_TIME, NONE, USE_TOKEN
from dpstack.fdl.codec import NO_FRAME, KeptFrame, plain_frame_of, request_octets
from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.standing import Standing
from dpstack.fdl.telegram import FC_FCB, SHORT_ACK, Req, Telegram
from dpstack.params import BROADCAST
from dpstack.units import NEVER

#: stands for "no request"; compared by identity
NO_REQUEST: Final = Request(-1, Req.FDL_STATUS)


def _no_poll(_: int) -> None:
    raise RuntimeError("a telegram is sent that nobody has queued")


class Exchange(Awaiting):
    """The current request of a user. Handlers of Await_Data_Response."""

    __slots__ = (
        "_asked_da",
        "_candidate",
        "_repeats",
        "_standing",
        "_wrong",
        "admission",
        "fcb",
        "made_at",
        "poll_sent",
        "request",
        "user",
    )

    def __init__(self, common: Common, fcb: FrameCount, admission: Admission) -> None:
        super().__init__(common)
        self.fcb = fcb
        self.admission = admission
        #: the user of the last request; None if it is detached
        self.user: LinkUser | None = None
        self.request = NO_REQUEST
        #: called with the time of its last bit when the GAP poll is sent
        #: (:class:`~dpstack.fdl.active.use_token.GapPoll`)
        self.poll_sent: Callable[[int], None] = _no_poll
        #: time at which a user made the last request
        self.made_at = 0
        self._asked_da = BROADCAST
        self._standing: dict[int, Standing] = {}  # by address; their counts are added up when somebody reads them
        self._candidate = NONE  # an answer that is kept back, because it may be late
        self._repeats = 0
        self._wrong = False

    def start(self, user: LinkUser, request: Request, now: int) -> None:
        """Encode a new request and queue it."""
        line, machine, standing = self.line, self.machine, request.standing
        self.user = user
        self.request = request
        self.made_at = now
        self._asked_da = da = request.da
        if standing is None:
            machine.expected = NO_FRAME
            service = SERVICES[request.function]
            if service.counted:
                if request.restart:
                    self.fcb.restart(da)
            elif service.answered and not request.patient and self.peers.knows(da):
                # for every user: the silence of a known station is news
                self.request = request = request.replaced(patient=True)
            line.tx = self._octets(request)
        else:
            machine.expected = standing.answer
            data, bits = request.data, self.fcb.bits[da]
            frame = standing.frames.get(bits)
            if frame is None or frame.size != len(data):
                fc = SERVICES[request.function].fc | bits
                frame = standing.frames[bits] = KeptFrame(da, line.ts, fc, len(data))
                self.add_up()
                self._standing[da] = standing
            line.tx = frame.octets if frame.data == data else frame.encode(data)
        line.gate_ns = line.after_ns
        machine.state = USE_TOKEN  # as enter(); no deadline counts while a telegram waits
        machine.row = machine.using

    def _octets(self, request: Request) -> bytes:
        """The octets of the current request, in all its attempts."""
        service = SERVICES[request.function]
        fc = service.fc | self.fcb.bits[request.da] if service.counted else service.fc
        return request_octets(request.da, self.line.ts, fc, request.data, request.dsap, request.ssap)

    def sent(self, _: Telegram, at: int) -> None:
        """An attempt is sent, or a GAP poll; its last bit is on the line at ``at``."""
        request = self.request
        if request is NO_REQUEST:
            self.poll_sent(at)
            return
        if not self._repeats:
            self.garbled = False  # octets before the request are no part of its answer
            standing = request.standing
            if standing is None:
                self.stats.station(request.da).requests += 1
            else:
                standing.requests += 1
                standing.at = self.line.taken_at
            if standing is None or not standing.quiet:
                if self.user is not None:
                    self.user.started(request, self.line.taken_at)
                if not SERVICES[request.function].answered:
                    self.line.expect_no_answer()
                    self._finish(SHORT_ACK, self.line.taken_at)
                    return
        times = self.times
        if request.patient or self.peers.is_slow(request.da):
            until = at + times.slot_known_ns
        else:
            until = self.admission.in_vain_until(request, at)
        machine = self.machine  # as enter()
        machine.state = AWAIT_DATA_RESPONSE
        machine.row = machine.awaiting_data
        machine.deadline = until
        if times.exact:
            self.early_until = at + times.early_ns

    def response(self, telegram: Telegram, now: int) -> None:
        """A response to this station, or SC, while it waits for an answer."""
        request, expected = self.request, self.machine.expected
        if self.line.edge_at < self.early_until or not (
            telegram is expected.last[1]
            # a telegram that came without octets is another object; with the expected head it is the answer, too
            or (
                len(telegram.data) == expected.data_size
                and telegram.fc == expected.fc
                and telegram.sa == request.da
                and telegram.dsap is telegram.ssap is None
            )
            or self._answers_with_another_head(telegram)
        ):
            self._no_answer_to_request(telegram, now)
            return
        self.answered(telegram, now)

    def answered(self, telegram: Telegram, now: int) -> None:
        """``telegram`` answers the request, unless an earlier one may still have a late answer."""
        request, peers, machine = self.request, self.peers, self.machine
        da = request.da
        if peers.due or self._repeats or self._wrong:
            if peers.due and self._keep_back(telegram, now):
                return
            if self._repeats:
                peers.expect_late(request, now, self.times.slot_known_ns)
            else:
                peers.expect_none(da)
            self._repeats, self._wrong = 0, False
        standing = request.standing
        if standing is None:
            self.stats.station(da).answers += 1
        else:
            standing.answers += 1
        if standing is not None or SERVICES[request.function].counted:
            fcb = self.fcb
            if fcb.operational[da]:
                fcb.bits[da] ^= FC_FCB  # as answered()
            elif fcb.answered(da):
                peers.knows_only_fcv(da, now)
        if not telegram.data and telegram.empty_le3:
            peers.empty_le3(da, now)
        self.request = NO_REQUEST  # as _finish()
        user = self.user
        if (done := request.done) is not None:
            done(telegram, now)
        elif user is not None:
            user.result(request, telegram, now)
        machine.state = CHECK_ACCESS_TIME  # as check(): what it chooses sets the deadline
        machine.row = row = machine.checking
        row[CHECK](NONE, now)

    def response_to_all(self, telegram: Telegram, now: int) -> None:
        """A response to another station, or to all: the answer to MSRD if it is from the station asked."""
        request = self.request
        if telegram.da == BROADCAST and request.function is Req.MSRD and telegram.sa == request.da:
            self.response(telegram, now)
        else:
            self.stray(telegram, now)

    def _answers_with_another_head(self, telegram: Telegram) -> bool:
        """Whether ``telegram`` answers the request. A standing one has probably an answer with the same head next time:
        whether a telegram answers it depends on that only."""
        request = self.request
        if not answers(request, telegram):
            return False
        if telegram.da != BROADCAST and request.standing is not None:
            request.standing.answer = plain_frame_of(telegram)
        return True

    def _keep_back(self, telegram: Telegram, now: int) -> bool:
        """True when ``telegram`` may be a late answer and is kept back for one slot time (see above)."""
        first, peers = self._candidate, self.peers
        if first is NONE:
            if peers.due_from(telegram, now) < 0:
                return False
            self._candidate = telegram
            self.machine.deadline = now + self.admission.kept_back_ns()
            return True
        self._candidate = NONE
        peers.expect_none(self.request.da)  # the candidate answers this request: it is from that station, or SC
        self._count_late(first, now)
        return False

    def _finish(self, outcome: Telegram | Failure, now: int) -> None:
        """Hand the end of the request to its user, and choose the next telegram."""
        user, request = self.user, self.request
        self.request = NO_REQUEST
        self._repeats, self._wrong = 0, False
        if (done := request.done) is not None:
            done(outcome, now)
        elif user is not None:
            user.result(request, outcome, now)
        machine = self.machine  # as check()
        machine.state = CHECK_ACCESS_TIME
        machine.row = row = machine.checking
        machine.deadline = NEVER
        row[CHECK](NONE, now)

    def timeout(self, _: Telegram, now: int) -> None:
        """The slot time is over."""
        request, peers = self.request, self.peers
        candidate = self._candidate
        if candidate is not NONE:
            # no second telegram followed: the one kept back is the answer, and no other answer is due
            self._candidate = NONE
            peers.due.clear()
            self._repeats = 0
            self.response(candidate, now)
            return
        self.add_up()
        asked = self.stats.station(request.da)
        peers.attempt_failed(request.da)
        if self.garbled:
            peers.unreadable(request.da, not self._repeats, now)
        if not request.cyclic:
            self.admission.unanswered(request, now)
        outdated = False
        if self._repeats < self._most_repeats():
            outdated = request.still is not None and not request.still(now)
            if not outdated:
                if not self._repeats:
                    self.garbled = False  # a slave that loses its power may have begun to answer; then it is silent
                self._repeats += 1
                asked.retries += 1
                self.line.queue(self._octets(request))
                return
        peers.silent(request.da)
        if request.patient or request.function != Req.FDL_STATUS:
            asked.timeouts += 1
            peers.expect_late(request, now, self.times.slot_known_ns)
        elif not (asked.answers or asked.timeouts or self.garbled):
            # an unknown address: no fault, and a late FDL status is as true as one in time
            del self.stats.stations[request.da]
        if SERVICES[request.function].counted:
            self.fcb.given_up(request.da)
        if outdated:
            failure = Failure.ABANDONED
        elif self._wrong:
            failure = Failure.WRONG
        elif self.garbled:
            self.stats.garbled += 1
            failure = Failure.GARBLED
        else:
            failure = Failure.NO_ANSWER
        self._finish(failure, now)

    def add_up(self) -> None:
        """Bring the counters of the stations with standing requests up to date."""
        for da, standing in self._standing.items():
            if standing.requests or standing.answers:
                asked = self.stats.station(da)
                asked.requests += standing.requests
                asked.answers += standing.answers
                standing.requests = standing.answers = 0

    def is_outdated(self, now: int) -> bool:
        """Whether the data of the queued request are too old to be sent."""
        still = self.request.still
        return self.user is not None and still is not None and not still(now)

    def drop_outdated(self, now: int) -> None:
        """Do not send the queued request: its data are too old. Earlier attempts may have been sent."""
        self.line.drop()
        if self._repeats:
            self.peers.expect_late(self.request, now, self.times.slot_known_ns)
            self.fcb.given_up(self.request.da)
        self._finish(Failure.ABANDONED, now)

    def _most_repeats(self) -> int:
        request = self.request
        service = SERVICES[request.function]
        if self.membership.leaving or not (service.answered and request.retry):
            return 0
        if service.counted and not self.fcb.operational[request.da]:
            return 0  # a first request is not repeated (docs/reference/protocol.md#frame-count-bit)
        return self.times.max_retry

    def detach(self, user: LinkUser) -> None:
        """Report no more results to ``user``."""
        if self.user is user:
            self.user = None

    def abandon(self, now: int) -> None:
        """Drop the queued telegram and the current request; its user gets ABANDONED."""
        user, request = self.user, self.request
        if request is NO_REQUEST:  # a GAP poll, or the token
            self.line.drop()
            return
        if (self._repeats or self.line.tx is None) and SERVICES[request.function].counted:
            # it was sent, and the station may have it or not: the FCB of a new request is unknown
            self.peers.expect_late(request, now, self.times.slot_known_ns)
            self.fcb.given_up(request.da)
        self.line.drop()
        self.request, self._candidate = NO_REQUEST, NONE
        self._repeats, self._wrong = 0, False
        if user is not None:
            user.result(request, Failure.ABANDONED, now)
            self.users.update_due()

    def _no_answer_to_request(self, telegram: Telegram, now: int) -> None:
        """A telegram to this station that does not answer the request: late, wrong, or from an unknown station."""
        self.add_up()
        self.garbled = False
        sa = telegram.sa
        if sa == self.request.da and self.line.edge_at >= self.early_until and self.peers.due_from(telegram, now) < 0:
            self._wrong = True
            self.stats.station(sa).wrong += 1
            self.peers.superfluous(sa, now)
        else:
            if sa in (self.request.da, -1) and self.line.edge_at < self.early_until:
                self.stats.station(self.request.da).early += 1
            self._count_late(telegram, now)

    def late(self, telegram: Telegram, now: int) -> None:
        """A response to this station, or SC, for which no request waits: the answer to an earlier exchange."""
        self._count_late(telegram, now)
        self.peers.expect_none(telegram.sa)

    def _count_late(self, telegram: Telegram, now: int) -> None:
        """Count a late answer by its sender. SC has no sender and counts as stray."""
        self.add_up()
        if telegram.sa >= 0:
            self.peers.late(telegram.sa, now)
            return
        self.stats.stray += 1
        holding = self.membership.in_ring and self.machine.state is not ACTIVE_IDLE
        if holding and self._asked_da != BROADCAST:
            self.peers.superfluous(self._asked_da, now)  # this station has the token, so SC answers its last request
