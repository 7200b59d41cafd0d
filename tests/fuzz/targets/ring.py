"""An active station in a ring with other masters that send anything: tokens, FDL status, requests, answers, noise.

Stations 1 and 5 are octets. The input chooses when and what they send, with right and wrong addresses, also that of
the station under test. Judged: every telegram that it sends is readable and has its own source address, it answers
at most once and only requests to itself, its list of masters holds addresses only, its counters agree with the
line, texts are printable; and when the others are silent, or behave, it comes (back) into the ring, its user's
requests are answered, and a right master gets the token.
"""

from __future__ import annotations

from collections.abc import Callable

from dpstack.fdl.active.states import State
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.codec import decode
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import Kind, Req, Telegram
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT
from tests.fuzz.frame import Cutter, Target, assert_plain
from tests.fuzz.octet_line import Asked, Line, sd1, sd2

MS = 1_000_000
BAUD = 500_000
OWN, SLAVE, OTHERS = 2, 4, (1, 5)
PARAMS = BusParams.preset(BAUD, address=OWN, hsa=6, gap=1, t_tr=2_000)
#: FDL status of an active station: not ready, ready to enter the ring, in the ring
READY, IN_RING = 0x20, 0x30
ADDRESSES = (1, 2, 3, 4, 5, 6, 126, 127)


class User(LinkUser):
    """One request in each hold."""

    def __init__(self) -> None:
        self.wanted = False
        self.good = 0

    def token_received(self, now: int) -> None:
        self.wanted = True

    def next_request(self, now: int, high_only: bool) -> Request | None:
        if not self.wanted:
            return None
        self.wanted = False
        return Request(SLAVE, Req.SRD_LOW, b"\1", 60, 62)

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        self.good += isinstance(outcome, Telegram) and outcome.data == b"\x07"


class Run:
    """One execution."""

    def __init__(self, octets: bytes) -> None:
        self.script = Cutter(octets)
        self.user = User()
        self.station = ActiveStation(PARAMS, [self.user], patience=EXACT)
        self.line = Line(self.station, BAUD, self.heard)
        #: the master that behaves, once the garbage is over
        self.partner = False
        self.partner_had_token = 0
        self.sent = 0

    def heard(self, octets: bytes, end: int) -> None:
        self.sent += 1
        telegram = decode(octets)
        assert telegram is not None, octets
        assert telegram.kind is Kind.SC or telegram.sa == OWN, octets
        line = self.line
        if octets[0] == 0xDC:
            if self.partner and octets[1] == 5:
                self.partner_had_token += 1
                line.say(bytes((0xDC, OWN, 5)), end, 40)
            return
        if not telegram.is_request:
            return
        asked = Asked(octets)
        if asked.da == SLAVE:
            line.say(sd1(OWN, SLAVE, 0) if asked.status else asked.answer(b"\x07"), end, 11)
        elif asked.da == 5 and self.partner and asked.status:
            line.say(sd1(OWN, 5, IN_RING if self.partner_had_token else READY), end, 11)

    def garbage(self) -> None:
        """One telegram, or what is none, of other stations."""
        script, line = self.script, self.line
        head = script.octet()
        who = OTHERS[head & 1]
        at = line.now
        a, b = ADDRESSES[script.octet() & 7], ADDRESSES[head >> 1 & 7]
        bits = (script.octet() & 15) * 20
        match head >> 4:
            case 0 | 1:
                line.say(bytes((0xDC, OWN, who)), at, bits)
            case 2 | 3:
                line.say(bytes((0xDC, a, who)), at, bits)
            case 4:
                line.say(bytes((0xDC, a, b)), at, bits)
            case 5:
                line.say(sd1(OWN, who, 0x49), at, bits)
            case 6:
                line.say(sd1(a, b, script.octet()), at, bits)
            case 7:
                line.say(
                    sd2(OWN, who, 0x40 | script.octet() & 0x3F, script.take(4), (script.octet() & 63, 62)), at, bits
                )
            case 8:
                line.say(sd2(a, b, script.octet(), script.take(head & 15)), at, bits)
            case 9:
                line.say(script.take(head & 15), at, bits)
            case 10:
                end = line.say(bytes((0xDC, OWN, who)), at, bits)
                line.say(bytes((0xDC, OWN, who)), end, script.octet())
            case 11:
                line.say(bytes((0xDC, who, who)), at, bits)
            case 12:
                line.run(script.octet() * MS // 16)
            case 13:
                for _ in range(3):
                    at = line.say(bytes((0xDC, OTHERS[1 - (head & 1)], who)), at, 40)
            case 14:
                line.say(sd1(who, OWN, script.octet()), at, bits)
            case _:
                self.steps(head & 15, lambda: False)
        self.steps(1 + (script.octet() & 7), lambda: False)

    def steps(self, most: int, done: Callable[[], bool]) -> None:
        line = self.line
        for _ in range(most):
            line.step(line.now + 100 * MS)
            for event in self.station.take_events():
                assert_plain(event.text)
            if done():
                return

    def run(self) -> None:
        station, script = self.station, self.script
        station.command(GoOnline(), self.line.now)
        self.line.pump()
        if script.octet() & 1:
            self.steps(200, lambda: self.user.good > 1)
        while script.at < len(script.octets):
            self.garbage()
            assert set(station.las) <= set(range(127)), station.las
            assert station.stats.sent <= self.sent
        self.line.forget()
        self.steps(3, lambda: False)
        if station.state is State.OFFLINE:
            station.command(GoOnline(), self.line.now)
            self.line.pump()
        good = self.user.good
        self.steps(3_000, lambda: self.user.good > good + 2)
        assert self.user.good > good + 2, station.state
        assert station.in_ring
        self.partner = True
        self.steps(3_000, lambda: self.partner_had_token > 2)
        assert self.partner_had_token > 2, station.las
        assert 5 in station.las


def run(octets: bytes) -> None:
    Run(octets).run()


TARGET = Target(run=run, covers=("dpstack.fdl.active",), executions=100_000, compares=False, max_len=200)
