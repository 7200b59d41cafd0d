"""MSRD: the station sends its answer to all (127). At the octets of a Data_Exchange with a publisher."""

from __future__ import annotations

import pytest
from ring_bus import ListUser, RingBus, Sent

from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Req, Telegram
from tests.fdl.active.exchange_kit import DX, DX_ANSWER, Slave, bus_with

MSRD = Request(3, Req.MSRD, b"\x01\x02", patient=True)
#: as in a capture of a publisher: 68 05 05 68 7F 05 08 .., with the addresses of this bus
TO_ALL = bytes.fromhex("68 05 05 68 7F 03 08 AA BB EF 16")


def octets(bus: RingBus) -> list[str]:
    return [sent.octets.hex(" ").upper() for sent in bus.log if sent.sender == 2 and sent.octets[0] == 0x68]


@pytest.mark.parametrize("mode", ["whole", "octets", "chunk"])
def test_the_answer_to_all_is_the_answer(mode: str) -> None:
    slave = Slave(answer=TO_ALL)
    bus, user, station = bus_with(slave, MSRD, MSRD, MSRD, mode=mode, run_ms=20)
    assert [type(outcome) for outcome in user.outcomes] == [Telegram] * 3
    assert all(isinstance(one, Telegram) and one.data == b"\xaa\xbb" for one in user.outcomes)
    assert octets(bus) == [
        "68 05 05 68 03 02 67 01 02 6F 16",
        "68 05 05 68 03 02 57 01 02 5F 16",
        "68 05 05 68 03 02 77 01 02 7F 16",
    ]
    assert station.stats.stray == 0


def test_a_repetition_has_its_fcb() -> None:
    slave = Slave(TO_ALL, None, TO_ALL, answer=TO_ALL)
    _, user, station = bus_with(slave, MSRD, MSRD, MSRD, run_ms=20)
    assert slave.fcs == ["67", "57", "57", "77"]
    assert [type(outcome) for outcome in user.outcomes] == [Telegram] * 3
    assert station.stats.stations[3].retries == 1


def test_an_answer_to_this_station_only_counts_too() -> None:
    _, user, _ = bus_with(Slave(answer=DX_ANSWER), MSRD, run_ms=20)
    assert isinstance(user.outcomes[0], Telegram)


def test_data_exchange_between_two_msrd() -> None:
    """What the link layer has learned of one answer is not taken for the other's."""
    slave = Slave(TO_ALL, DX_ANSWER, TO_ALL, DX_ANSWER, DX_ANSWER)
    _, user, station = bus_with(slave, MSRD, DX, MSRD, DX, DX, run_ms=20)
    found = [one.da if isinstance(one, Telegram) else one for one in user.outcomes]
    assert found == [127, 2, 127, 2, 2]
    assert station.stats.stray == 0


def test_an_answer_to_all_to_another_request_is_none() -> None:
    _, user, station = bus_with(Slave(TO_ALL, TO_ALL), DX.replaced(retry=False), run_ms=5)
    assert user.outcomes == [Failure.NO_ANSWER]
    assert station.stats.stray == 1


def test_an_answer_to_all_of_another_station_is_none() -> None:
    foreign = bytes.fromhex("68 05 05 68 7F 04 08 AA BB F0 16")
    _, user, station = bus_with(Slave(foreign), MSRD.replaced(retry=False), run_ms=5)
    assert user.outcomes == [Failure.NO_ANSWER]
    assert station.stats.stray == 1


def test_a_damaged_answer_to_all_is_repeated() -> None:
    slave = Slave(answer=TO_ALL)
    bus, user, _ = bus_with(slave, MSRD, MSRD)
    damaged = iter((False, True))

    def drop(sent: Sent) -> bool:
        return sent.octets == TO_ALL and next(damaged, False)

    bus.drop = drop
    bus.run_bits(10_000)
    assert slave.fcs == ["67", "57", "57"]
    assert [type(outcome) for outcome in user.outcomes] == [Telegram] * 2


def test_a_late_answer_to_all_is_no_sign_of_the_next_master() -> None:
    """The next master does not take the token. The publisher answers after its slot time, while it is passed."""
    user = ListUser()
    bus = RingBus()
    station = bus.master(2, user, gap=1, hsa=5)
    other = bus.master(5, gap=1, hsa=5)
    bus.run_ms(300)
    assert station.las == other.las == {2, 5}

    def late(octets: bytes, now: int) -> tuple[int, bytes]:
        bus.deaf.add(other)
        return 300, TO_ALL

    bus.slaves[3] = late
    user.high.append(MSRD.replaced(retry=False))
    bus.run_ms(3)
    assert user.outcomes == [Failure.NO_ANSWER]
    assert station.stats.late == 1
    assert station.stats.token_retries >= 2
    tokens = [sent.octets.hex() for sent in bus.log if sent.sender == 2 and sent.octets[0] == 0xDC]
    assert tokens[-1] == "dc0202"  # alone, after three attempts
