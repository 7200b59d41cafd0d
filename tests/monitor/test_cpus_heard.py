"""S7-200 CPUs on a bus that a monitor hears: PDUs of real CPUs (tests/decode/test_decode_ppi.py), beside a DP slave."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from changed_traffic import in_columns
from hypothesis import given
from hypothesis import strategies as st
from support import MS, S

from dpstack.capture.timing import FILE, LineTiming
from dpstack.capture.transmission import Transmission
from dpstack.fdl.codec import encode_sd1, encode_sd2, encode_token
from dpstack.monitor.devices import Devices, KnownDevice
from dpstack.monitor.monitor import Monitor
from tests.decode.test_decode_ppi import TWELVE, TWELVE_OCTETS, WRITE, WRITTEN
from tests.monitor.test_counted_at_once import counted

BAUD = 187_500
EPOCH = 1_790_000_000 * S
SC = b"\xe5"
#: data units of a request and its answer
TALKS = [tuple(bytes.fromhex(one)[7:-2] for one in talk) for talk in ((TWELVE, TWELVE_OCTETS), (WRITE, WRITTEN))]


def rounds(count: int, *, slave: bytes = b"\x01\x02", cpu_until: int = 1_000_000) -> Iterator[bytes]:
    """Rounds of master 0: the token, Data_Exchange with slave 5, a request to CPU 2, which has its answer at the second
    poll."""
    fcb = 0
    for number in range(count):
        asks, tells = TALKS[number % 2]
        yield encode_token(0, 0)
        yield encode_sd2(5, 0, 0x5D if number % 2 else 0x7D, slave)
        yield encode_sd2(0, 5, 8, b"\x07")
        here = number < cpu_until
        for data, answer in ((asks, SC), (b"", encode_sd1(0, 2, 2)), (b"", encode_sd2(0, 2, 8, tells))):
            yield encode_sd2(2, 0, 0x5C | fcb, data) if data else encode_sd1(2, 0, 0x5C | fcb)
            fcb ^= 0x20 if here else 0
            if here:
                yield answer


def heard(octets: Iterator[bytes] | list[bytes]) -> list[Transmission]:
    sent, at = [], EPOCH
    for one in octets:
        sent.append(Transmission(one, at, BAUD))
        at += len(one) * 58_667 + 2 * MS
    return sent


def summary(sent: list[Transmission], names: dict[int, KnownDevice] | None = None) -> dict[str, Any]:
    monitor = Monitor(LineTiming(FILE, 1), devices=Devices(names or {}))
    for one in sent:
        monitor.add(one)
    return monitor.summary()


def test_a_cpu_is_no_slave_and_its_not_yet_is_no_refusal() -> None:
    found = summary(heard(rounds(300)), {2: KnownDevice("press")})
    cpu = found["stations"]["2"]
    assert (cpu["role"], cpu["name"], cpu["model"], cpu["state"]) == ("cpu", "press", "S7-200", "data_exchange")
    assert (cpu["requests"], cpu["answers"], cpu["rr"], cpu["lost"]) == (900, 900, 300, 0)
    assert (cpu["verdict"], cpu["reasons"], cpu["not_heard"]) == ("good", [], [])
    assert found["stations"]["5"]["role"] == "slave"
    assert found["masters"]["0"]["slaves"] == [5]
    assert found["verdict"] == "good"
    assert not any("2 (press)" in line for line in found["not_heard"])


def test_a_round_begins_with_a_slave_also_if_a_cpu_was_heard_first() -> None:
    """A capture that begins with a poll of a CPU: rotations are those of the slave."""
    sent = heard([encode_sd1(2, 0, 0x5C), encode_sd2(0, 2, 8, TALKS[0][1]), *rounds(20)])
    counters = Monitor(LineTiming(FILE, 1)).counters
    for one in sent:
        counters.add(one)
    assert counters.stations[2].is_cpu
    assert (counters.masters[0].reference, counters.masters[0].slaves) == (5, {5})
    assert counters.masters[0].rotation_ns.count == 18


def test_a_cpu_that_answers_no_more_is_reported() -> None:
    found = summary(heard(rounds(300, cpu_until=150)))
    cpu = found["stations"]["2"]
    assert (cpu["role"], cpu["state"], cpu["verdict"]) == ("cpu", "offline", "warning")
    assert cpu["reasons"][0].startswith("left data exchange once, is not back")
    assert found["stations"]["5"]["verdict"] == "good"


@pytest.mark.parametrize("heard_bring_up", [True, False])
def test_outputs_like_a_pdu_do_not_make_a_cpu_of_a_slave_whose_parameters_were_heard(heard_bring_up: bool) -> None:
    set_prm = encode_sd2(5, 0, 0x6D, bytes.fromhex("80 00 00 0B 12 34 00"), 61, 62)
    bring_up = [set_prm, SC] if heard_bring_up else []
    found = summary(heard([*bring_up, *rounds(20, slave=TALKS[0][0])]))
    assert found["stations"]["5"]["role"] == ("slave" if heard_bring_up else "cpu")
    assert found["masters"]["0"]["slaves"] == ([5] if heard_bring_up else [])
    # it is brought up later
    later = summary(heard([*rounds(20, slave=TALKS[0][0]), set_prm, SC, *rounds(20, slave=TALKS[0][0])]))
    assert (later["stations"]["5"]["role"], later["masters"]["0"]["slaves"]) == ("slave", [5])


@given(st.lists(st.tuples(st.integers(0, 500), st.sampled_from(["lost", "twice", "SC", "poll"])), max_size=12))
def test_cpus_at_once_count_as_one_after_the_other(changes: list[tuple[int, str]]) -> None:
    octets = [[one] for one in rounds(60)]
    for place, change in changes:
        (one, *_) = octets[place] or [SC]
        octets[place] = {"lost": [], "twice": [one, one], "SC": [SC], "poll": [encode_sd1(2, 0, 0x5C)]}[change]
    sent = heard([one for some in octets for one in some])
    assert list(in_columns(sent))
    assert counted([sent], add_all=True) == counted([sent], add_all=False)
