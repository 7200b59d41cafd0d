"""Alarms in any order, any request or answer lost: each is delivered and acknowledged once, or ends with leaving.

The master knows octets only. A request of its that nobody answers is followed by one that takes the station up afresh
(FCV 0, FCB 1), after which the slave cannot know whether its last answer arrived.
"""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples
from slave_alarm_kit import KINDS, AlarmBench, prm
from slave_kit import UNLOCK

from dpstack.dp.pdu.alarm_blocks import Alarm, Status, kind_of
from dpstack.dpv1.slave.alarms import AlarmEnd, Raised
from dpstack.errors import AlarmError

LIMITS = {0: 1, 1: 2, 3: 8, 7: 32}
#: what becomes of a request: both ways, never there, never back
_WIRE = st.sampled_from(("good", "good", "good", "request lost", "answer lost"))


class LossyMaster:
    """Polls, fetches, acknowledges; ``delivered`` are blocks without their headers, ``loss`` the fate of requests."""

    def __init__(self, bench: AlarmBench, sap: int, loss: list[str]) -> None:
        self.bench = bench
        self.sap = sap
        self.loss = loss
        self.fresh = False
        self.diagnosis_due = False
        self.delivered: list[bytes] = []
        self.unacknowledged: list[bytes] = []

    def ask(self, dsap: int | None, data: bytes = b"") -> tuple[int, bytes] | None:
        fate = self.loss.pop() if self.loss else "good"
        fresh, self.fresh = self.fresh, fate != "good"
        if fate == "request lost":
            return None
        reply = self.bench.ask(dsap, data, fresh=fresh)
        return None if fate == "answer lost" else (reply.status, reply.data)

    def exchange(self) -> None:
        answer = self.ask(None, b"\x55")
        self.diagnosis_due |= answer is not None and answer[0] == 0x0A  # DH
        if self.diagnosis_due:
            answer = self.ask(60)
            if answer is not None:
                self.diagnosis_due = False
                self.take(answer[1][6:])

    def take(self, ext: bytes) -> None:
        while ext:
            block, ext = ext[: ext[0]], ext[ext[0] :]
            if block[1] & 0x80:
                continue
            key = bytes((block[2], block[1], block[3]))
            if key not in self.unacknowledged:
                self.unacknowledged.append(key)
                self.delivered.append(block[1:])

    def acknowledge(self, which: int) -> None:
        if not self.unacknowledged:
            return
        key = self.unacknowledged[which % len(self.unacknowledged)]
        if self.ask(self.sap, b"\x5c" + key) is None:
            return
        answer = self.ask(self.sap)
        if answer is not None:
            assert answer[1] == b"\x5c" + key, answer
            self.unacknowledged.remove(key)


_steps = st.lists(
    st.one_of(
        st.tuples(st.just("alarm"), st.sampled_from((1, 2, 3, 32, 33))),
        st.tuples(st.just("alarm"), st.sampled_from((1, 2))),
        st.tuples(st.sampled_from(("dx", "dx", "ack", "status", "leave", "withdraw")), st.integers(0, 31)),
    ),
    min_size=10,
    max_size=60,
)


@examples(60)
@given(_steps, st.sampled_from(tuple(LIMITS)), st.sampled_from((50, 51)), st.lists(_WIRE, min_size=20, max_size=80))
def test_each_alarm_ends_once_and_in_order(steps: list[tuple[str, int]], mode: int, sap: int, loss: list[str]) -> None:
    bench = AlarmBench(sequence=32, extra_sap=True).start(prm(mode=mode))
    master = LossyMaster(bench, sap, loss)
    raised: list[Raised] = []
    ends: list[int] = []
    for number, (step, value) in enumerate(steps):
        match step:
            case "alarm":
                alarm = Alarm(value, 1, data=bytes((number,)))
                try:
                    one = bench.alarms.alarm(alarm)
                except AlarmError:
                    assert len(bench.alarms.pending) >= 32
                    continue
                one.ended = lambda number=number: ends.append(number)
                raised.append(one)
            case "status":
                bench.alarms.status(Status(1, 2))
            case "withdraw" if raised:
                bench.alarms.withdraw(raised[value % len(raised)])
            case "ack":
                master.acknowledge(value)
            case "leave" if value < 3:
                bench.ask(61, UNLOCK)
                assert all(one.end is not None for one in raised)
                bench.start(prm(mode=mode))
                master.unacknowledged.clear()
                master.diagnosis_due = False
            case _:
                master.exchange()
        on_its_way = [one for one in bench.alarms.pending if one.offered]
        if mode:
            assert len(on_its_way) <= LIMITS[mode]
        else:
            assert len({min(one.alarm.type, 32) for one in on_its_way}) == len(on_its_way)
    loss.clear()
    for _ in range(3 * len(raised) + 5):
        master.exchange()
        master.acknowledge(0)
    assert all(one.end is not None for one in raised)
    assert len(ends) == len(set(ends)) == len(raised)
    assert not bench.must_fetch
    assert {kind_of(one.alarm.type) for one in raised} <= KINDS
    # what was acknowledged was delivered, and nothing twice
    numbers = [block[3] for block in master.delivered]
    assert len(numbers) == len(set(numbers))
    acknowledged = [one.alarm.data[0] for one in raised if one.end is AlarmEnd.ACKNOWLEDGED]
    assert set(acknowledged) <= set(numbers)
    # in order: all of them in sequence mode, those of one type where each type has its turn
    for kind in range(33):
        row = [block[3] for block in master.delivered if mode or min(block[0], 32) == kind]
        assert row == sorted(row)
