"""Answers that wait at the slave after their service was given up, and services with less time than the slave needs.

The next service fetches such an answer first; the slave's own time decides how long, however many services come
meanwhile. The slaves are octets.
"""

from __future__ import annotations

from alarm_kit import ALL, AlarmBus, block
from ms1_kit import Ms1Bus, answer, first_an_old_one
from ms2_kit import DL, MS, RS, SC, Ms2Bus, connected, sd1, sd2
from octet_slave import RR

from dpstack.dp.acyclic.job import ServiceFailure
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.alarm_orders import ConnectionOver
from dpstack.dpv1.master.orders import RecordOrder
from dpstack.dpv1.pdu.read_write import Function


def test_services_with_less_time_than_the_slave_do_not_fetch_for_ever() -> None:
    """A request that the slave has taken and forgotten: it has had its time after 1 s, whoever asks."""
    kit = Ms1Bus(dpv1=Dpv1(c1_response_timeout_ns=1_000 * MS))
    assert kit.slave.ms1(b"") == SC
    assert short_read(kit) is ServiceFailure.LATE
    kit.slave.ms1 = lambda data: answer(4, "5E 01 02 01 22") if data else SC
    ends = [short_read(kit) for _ in range(5)]
    assert ends[0] is ends[1] is ServiceFailure.LATE  # its answer may still come
    assert ends[-1] is None


def short_read(kit: Ms1Bus) -> ServiceFailure | None:
    kit.tokens += 1
    kit.send(RecordOrder(kit.tokens, Function.READ, 1, 2, 240, timeout_ns=300 * MS, address=4))
    return kit.end(kit.tokens).outcome.failure


def test_an_answer_that_is_there_is_fetched_though_the_slave_has_had_its_time() -> None:
    """Nobody asked for a while: one look is due all the same."""
    kit = Ms1Bus(dpv1=Dpv1(c1_response_timeout_ns=1_000 * MS))
    assert short_read(kit) is short_read(kit) is ServiceFailure.LATE
    kit.bus.run(1_000 * MS)
    old = first_an_old_one(kit.slave)
    done = kit.read()
    assert (done.outcome.data, done.stale, old) == (b"\x22", 1, [])


def test_over_a_connection_it_ends_with_the_slaves_time() -> None:
    """The same; there the connection ends with it."""
    kit = Ms2Bus()
    connection = kit.open(send_timeout_ns=1_000 * MS).token
    kit.slave.says[48] = lambda octets: SC
    begun = kit.bus.now
    for _ in range(3):
        assert kit.read(connection, timeout_ns=300 * MS).outcome.failure is ServiceFailure.LATE
    late = kit.read(connection, timeout_ns=300 * MS)
    assert late.outcome.failure is not None
    over = kit.over(connection, 200 * MS)
    assert over.reason == "a service that was given up had no answer in time"
    assert 1_000 * MS <= over.t_ns - begun < 1_100 * MS


def test_requests_of_the_station_itself_wait_as_long_as_a_programs_service() -> None:
    """A slave that may work for more than 10 s at a service."""
    alarms = AlarmBus(dpv1=Dpv1(alarms=ALL, c1_response_timeout_ns=15_000 * MS))
    alarms.alarm_slave.says[51] = lambda octets: SC
    alarms.alarm_slave.raises(block(2, 3))
    alarms.run(50)
    assert len(alarms.alarm_slave.open) == alarms.acyclic.waiting == 1
    assert alarms.acyclic.wake_at() - alarms.bus.now > 15_500 * MS

    kit = Ms2Bus()
    connection = kit.open(send_timeout_ns=30_000 * MS).token
    kit.slave.says[48] = lambda octets: SC
    assert kit.read(connection, timeout_ns=30 * MS).outcome.failure is ServiceFailure.LATE
    kit.bus.run(5 * MS)
    assert kit.acyclic.waiting == 1  # its answer is fetched
    assert kit.acyclic.wake_at() - kit.bus.now > 29_500 * MS


def test_an_idle_that_is_sent_again_is_not_taken_at_once() -> None:
    """Lost with every attempt, and "not now" when it comes again."""
    kit = connected(send_timeout_ns=600 * MS)
    idles = 0

    def say(octets: bytes) -> bytes | None:
        nonlocal idles
        if octets[9:-2] == b"\x48\x01":
            idles += 1
            if idles <= 3:  # the first one with its repetition
                return None if idles < 3 else sd1(2, 4, RR)
        answer = kit.slave.ms2(48, octets[9:-2])
        if answer is None:
            return SC
        return sd2(2, 4, DL, 50, 48, answer) if answer else sd1(2, 4, RS)

    kit.slave.says[48] = say
    kit.bus.run(3_000 * MS)
    assert kit.events_of(ConnectionOver) == []
    assert idles > 5
