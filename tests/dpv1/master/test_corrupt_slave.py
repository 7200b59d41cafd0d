"""A slave that answers Slave_Diag, MS1 and MS2 with cut, bent, repeated, late, or somebody else's octets.

Every order has exactly one end, and so has every connection that was open. No end keeps anything. The other slave works
on, and the number of remarks about the bad one is limited.
"""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import dataclass, field

from alarm_kit import ALL, MS, AlarmBus, AlarmSlave, block
from hypothesis import given
from hypothesis import strategies as st
from ms2_kit import Ms2Server, connections_of
from octet_slave import DL, RS, SC, sd1, sd2
from property_kit import examples

from dpstack.dp.acyclic.class2 import ReadService, Service, ServiceDone
from dpstack.dp.acyclic.job import CancelService
from dpstack.dp.master.events import SlaveRemark, SlaveState, SlaveStateChanged
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.alarm_orders import AlarmDone, AlarmRaised, CloseConnection, ConnectionOver
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.pdu.read_write import Function
from dpstack.errors import UsageError
from dpstack.fdl.codec import decode

#: answers to another request, or to none
STRANGE = [
    bytes.fromhex(text)
    for text in (
        "5E 01 02 02 01 02",
        "5F 01 02 02",
        "51 01 02 00",
        "DE 80 B5 00",
        "5C 01 02 01",
        "DC 80 B0 00",
        "56 30 00 0A",
        "57 F0 01 00 00 00 00 00 00 02 00 02 00 00 00 00",
        "58 00 13",
        "48 01",
        "D7 80 C3 00",
        "58",
        "00",
    )
]
Done = (RecordDone, InitiateDone, ServiceDone)


def record(data: bytes) -> bytes:
    """The answer to Read and Write; a record holds its slot and index."""
    match data[0]:
        case 0x5E:
            return bytes((0x5E, data[1], data[2], 2, data[1], data[2]))
        case 0x5F:
            return data[:4]
    return bytes((data[0] | 0x80, 0x80, 0xB5, 0))


@dataclass
class EvilSlave(AlarmSlave):
    """Alarms, MS1 and MS2 as they should be, but ``evil`` of its answers (0..1) to all that is acyclic."""

    server: Ms2Server = field(default_factory=Ms2Server)
    random: random.Random = field(default_factory=random.Random)
    evil: float = 0.0
    answers: list[bytes] = field(default_factory=list)
    before: list[bytes] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.ms1 = self.records

    def records(self, data: bytes) -> bytes:
        if data:
            self.answers = [record(data)]
        elif self.answers:
            return sd2(2, self.address, DL, 51, 51, self.answers.pop())
        return SC

    def service(self, octets: bytes) -> bytes | None:
        sa, dsap = octets[5] & 0x7F, octets[7]
        if dsap > 49:
            return super().service(octets)
        answer = self.server.ms2(dsap, octets[9:-2])
        if answer is None:
            return SC
        return sd2(sa, self.address, DL, 50, dsap, answer) if answer else sd1(sa, self.address, RS)

    def __call__(self, octets: bytes, now: int) -> tuple[int, bytes] | None:
        if decode(octets) is None:
            return None  # its own telegrams come back, too
        found = super().__call__(octets, now)
        if found is None or octets[0] == 0x10 or not octets[4] & 0x80 or octets[7] in (61, 62):
            return found
        delay, answer = found
        if answer != SC:
            self.before = [*self.before, answer][-20:]
        return found if self.random.random() >= self.evil else self.bent(octets, delay, answer)

    def bent(self, octets: bytes, delay: int, answer: bytes) -> tuple[int, bytes] | None:
        rnd, sa, dsap, ssap = self.random, octets[5] & 0x7F, octets[7], octets[8]
        data = bytearray(answer[9:-2])
        match rnd.randrange(10):
            case 0:
                return None
            case 1:
                return delay, SC
            case 2:
                return delay, sd1(sa, self.address, rnd.choice((0, 1, 2, 3, 9, 12, 10, 7, 8, 13)))
            case 3 if self.before:
                return delay, rnd.choice(self.before)
            case 4:
                return 180, answer
            case 5 if data:
                return delay, sd2(sa, self.address, DL, ssap, dsap, bytes(data[: rnd.randrange(len(data))]))
            case 6:
                fc = rnd.choice((DL, 0x0A, 0x0C, 0x0D))
                return delay, sd2(sa, self.address, fc, ssap, dsap, rnd.randbytes(rnd.randrange(1, 244)))
            case 7 if data:
                data[rnd.randrange(len(data))] = rnd.choice((0, 255, rnd.randrange(256)))
                return delay, sd2(sa, self.address, answer[6], ssap, dsap, bytes(data))
            case 8:
                return delay, rnd.randbytes(rnd.randrange(1, 12))
            case _:
                return delay, sd2(sa, self.address, DL, ssap, dsap, rnd.choice(STRANGE))


@dataclass
class EvilBus(AlarmBus):
    """Slave 4 is the bad one."""

    addresses: tuple[int, ...] = (4, 5)
    kind: type[AlarmSlave] = EvilSlave


class Attack:
    """Random orders of every kind, and their ends."""

    def __init__(self, seed: int, evil: float, mode: int) -> None:
        self.random = rnd = random.Random(seed)
        self.kit = EvilBus(dpv1=Dpv1(alarms=ALL, alarm_mode=mode, c1_response_timeout_ns=30 * MS))
        slave = self.kit.slaves[4]
        assert isinstance(slave, EvilSlave)
        slave.random, slave.evil, slave.polls = rnd, evil, rnd.choice((0, 0, 1, 3))
        self.bad = slave
        self.mode = mode
        self.ordered: Counter[int] = Counter()
        self.opened: list[int] = []
        #: Reads of slave 5
        self.good: set[int] = set()

    def order(self, command: object, token: int) -> None:
        try:
            self.kit.send(command)
        except UsageError:  # the connection is over, or 32 wait
            return
        self.ordered[token] += 1

    def step(self) -> None:
        kit, rnd = self.kit, self.random
        kit.tokens += 1
        token = kit.tokens
        ref = rnd.choice(self.opened[-6:]) if self.opened else 0
        match rnd.randrange(14):
            case 0 | 1:
                self.order(RecordOrder(token, Function.READ, 1, 2, 8, address=4), token)
            case 2:
                self.order(
                    RecordOrder(
                        token, Function.WRITE, 1, 2, data=b"\1\2", address=4, timeout_ns=rnd.choice((5, 1000)) * MS
                    ),
                    token,
                )
            case 3:
                self.opened.append(token)
                self.order(OpenConnection(token, 4, InitiateReq(200 * MS), 60 * MS, timeout_ns=500 * MS), token)
            case 4:
                self.order(RecordOrder(token, Function.READ, 1, 2, 8, connection=ref, timeout_ns=500 * MS), token)
            case 5:
                self.order(
                    RecordOrder(token, Function.DATA_TRANSPORT, 1, 2, data=b"\1", connection=ref, timeout_ns=500 * MS),
                    token,
                )
            case 6:
                kit.send(CloseConnection(ref))
            case 7:
                cancelled = rnd.randrange(max(1, token - 3), token + 1)
                self.good.discard(cancelled)
                kit.send(CancelService(cancelled))
            case 8:
                sequence = rnd.randrange(32) if self.mode else 0
                self.bad.raises(block(rnd.choice((1, 2, 3, 4, 5, 6, 32)), rnd.randrange(3), 1, sequence))
                del self.bad.queue[5:]
            case 9:
                which = rnd.choice((Service.INPUTS, Service.CONFIG, Service.DIAGNOSIS))
                self.order(ReadService(token, 4, which), token)
            case 10:
                kit.hold(rnd.random() < 0.3)
                kit.acknowledge(rnd.randrange(1, 40))
            case 11:
                self.good.add(token)
                self.order(RecordOrder(token, Function.READ, 1, 2, 8, address=5), token)
            case _:
                kit.run(rnd.choice((1, 3, 10, 20)))

    def finish(self) -> None:
        kit = self.kit
        for ref in self.opened:
            kit.send(CloseConnection(ref))
        kit.hold(False)
        end = kit.bus.now + 15_000 * MS
        while (kit.acyclic.waiting or connections_of(kit.acyclic)) and kit.bus.now < end:
            kit.run(10)
        assert kit.acyclic.waiting == connections_of(kit.acyclic) == 0


@examples(3, soak=300)
@given(st.integers(0, 1 << 32), st.sampled_from((0.1, 0.3, 0.7)), st.sampled_from((0, 3)))
def test_any_octets_from_a_slave(seed: int, evil: float, mode: int) -> None:
    attack = Attack(seed, evil, mode)
    kit = attack.kit
    for _ in range(100):
        attack.step()
    attack.finish()
    done = [event for event in kit.bus.events if isinstance(event, Done)]
    assert Counter(event.token for event in done) == attack.ordered
    were_open = [e.token for e in done if isinstance(e, InitiateDone) and e.outcome.failure is None]
    overs = [event.connection for event in kit.bus.events if isinstance(event, ConnectionOver)]
    assert Counter(overs) == Counter(were_open)
    numbers = [event.number for event in kit.raised]
    assert len(numbers) == len(set(numbers))
    assert len([event for event in kit.bus.events if isinstance(event, SlaveRemark)]) <= 20
    for event in done:
        assert event.outcome.failure is None or f"slave {event.address}" in event.outcome.text
        if event.token in attack.good:
            assert event.outcome.data == b"\1\2", event.text
    left = [e for e in kit.events_of(SlaveStateChanged) if e.address == 5]
    assert [event.state for event in left].count(SlaveState.DATA_EXCHANGE) == 1
    # and when the slave is well again, all is well
    attack.bad.evil = 0.0
    attack.bad.queue.clear()
    attack.bad.left.clear()
    kit.run(500)
    kit.until(lambda: kit.master.handlers[4].state is SlaveState.DATA_EXCHANGE)
    kit.run(500)
    assert kit.read().outcome.data == b"\1\2"
    ended = {e.number for e in kit.ends}
    assert ended == {e.number for e in kit.events_of(AlarmRaised)}
    assert len(kit.events_of(AlarmDone)) == len(ended)
