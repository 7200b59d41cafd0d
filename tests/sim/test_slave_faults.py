"""Faults of one simulated slave, as a master in literal octets sees them."""

from __future__ import annotations

import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from octet_wire import BIT, MS, PARAMS
from property_kit import examples
from simulated_kit import SC, VALVES, Asked

from dpstack.api.config.config import slave_config
from dpstack.api.slave_side.virtual_bench import VirtualBench
from dpstack.dp.pdu.diag_blocks import UserDiag
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.fdl.telegram import Resp
from dpstack.sim.reported_diagnosis import ReportedOctets
from dpstack.sim.slave_faults import (
    Fault,
    LateAnswers,
    Refusals,
    RepeatedAnswers,
    StubNoise,
    WrongLength,
)
from dpstack.sim.world import World

#: the answer to Data_Exchange of slave 8 with inputs 12 34
GOOD = "68 05 05 68 02 08 08 12 34 58 16"
#: its FDL status request
STATUS = "10 08 02 49 53 16"


def late(asked: Asked) -> list[tuple[int, str]]:
    """The octets that the slave sends by itself, with their times."""
    sent: list[tuple[int, str]] = []
    asked.unit.faults.connect(lambda octets, at: sent.append((at, octets.hex(" ").upper())))
    return sent


@pytest.fixture
def asked() -> Asked:
    return Asked()


def test_a_late_answer_comes_at_its_time_and_the_slave_is_deaf_until_then(asked: Asked) -> None:
    sent = late(asked)
    fault = LateAnswers(3_000_000)
    asked.unit.faults.begin(fault)
    assert asked.exchange("12 34") == ""
    ((at, octets),) = sent
    asked_at = at - 3_000_000 - asked.unit.station.t_sdr_ns
    assert octets == GOOD
    assert asked_at + 500 * BIT < asked.wire.now + 1000 * BIT < at  # the next request of the master is not heard
    assert asked.wire.ask(STATUS) == ""
    assert len(sent) == 1
    asked.wire.pass_time(3_000_000)
    assert asked.wire.ask(STATUS) == ""
    assert [octets for _, octets in sent] == [GOOD, "10 02 08 00 0A 16"]
    assert asked.unit.faults.end(fault)
    assert not asked.unit.faults.end(fault)
    assert asked.wire.ask(STATUS) == "10 02 08 00 0A 16"
    assert asked.unit.station.stub is None  # nothing is in the way of a slave without faults
    assert asked.unit.station.responder is asked.unit.app


@pytest.mark.parametrize(("status", "octets"), [("RS", "10 02 08 03 0D 16"), ("UE", "10 02 08 01 0B 16")])
def test_data_exchange_is_refused_and_nothing_else(asked: Asked, status: str, octets: str) -> None:
    assert asked.exchange("12 34") == GOOD
    fault = Refusals(Resp[status])
    asked.unit.faults.begin(fault)
    assert asked.exchange("56 78") == octets
    assert asked.unit.app.outputs == b"\x12\x34"
    assert asked.ask("3C 3E").split()[4:9] == ["82", "88", "08", "3E", "3C"]  # it answers Slave_Diag
    asked.unit.faults.end(fault)
    assert asked.inputs("9A BC") == "9A BC"


@pytest.mark.parametrize(
    ("by", "octets"),
    [
        (-1, "68 04 04 68 02 08 08 12 24 16"),
        (-2, SC),
        (1, "68 06 06 68 02 08 08 12 34 00 58 16"),
    ],
)
def test_inputs_of_the_wrong_length(asked: Asked, by: int, octets: str) -> None:
    asked.unit.faults.begin(WrongLength(by))
    assert asked.exchange("12 34") == octets


def test_every_answer_is_sent_twice(asked: Asked) -> None:
    sent = late(asked)
    asked.unit.faults.begin(RepeatedAnswers())
    assert asked.exchange("12 34") == GOOD
    ((at, octets),) = sent
    begun, first = asked.wire.out[0]
    assert octets == GOOD == first.hex(" ").upper()
    assert at == begun + 11 * 11 * BIT + 11 * BIT  # eleven octets of eleven bits, and the gap


def test_a_diagnosis_is_offered_and_taken_back(asked: Asked) -> None:
    asked.exchange("12 34")
    fault = ReportedOctets(UserDiag(bytes.fromhex("80 43 26"), fault=True))
    asked.unit.faults.begin(fault)
    assert asked.exchange("12 34").split()[6] == "0A"  # DH: fetch the diagnosis
    assert asked.ask("3C 3E").split()[9:-2] == ["08", "04", "00", "02", "12", "34", "80", "43", "26"]
    assert asked.exchange("12 34").split()[6] == "08"
    asked.bench.power(8, False)
    asked.bench.power(8, True)
    asked.bring_up()
    assert asked.ask("3C 3E").split()[9:-2] == [
        "08",
        "04",
        "00",
        "02",
        "12",
        "34",
        "80",
        "43",
        "26",
    ]  # it is still there
    asked.unit.faults.end(fault)
    assert asked.exchange("12 34").split()[6] == "0A"
    assert asked.ask("3C 3E").split()[9:-2] == ["00", "04", "00", "02", "12", "34"]


def test_noise_on_its_stub_damages_what_it_hears_and_sends() -> None:
    answers = [_noisy(seed) for seed in (1, 1, 2)]
    assert answers[0] == answers[1] != answers[2]
    kinds = {"" if not one else "good" if one == GOOD else "damaged" for one in answers[0]}
    assert kinds == {"", "good", "damaged"}


def _noisy(seed: int) -> list[str]:
    asked = Asked()
    asked.unit.faults.begin(StubNoise(5e-3, seed))
    found = []
    for _ in range(40):
        found.append(asked.exchange("12 34"))
        asked.wire.ask("10 08 02 49 53 16")  # another request: the next one is new, also after a lost one
    return found


def test_behind_a_port_late_answers_come_at_their_time_unless_the_slave_is_off(asked: Asked) -> None:
    """All slaves of a port are one machine, which sends the late answer by itself."""
    unit = asked.unit
    port = Multidrop([unit.station], PARAMS)
    unit.faults.connect(lambda octets, at: port.send_at(unit.station, octets, at))
    asked.wire.station = port  # type: ignore[assignment]
    asked.unit.faults.begin(LateAnswers(400 * BIT))
    assert asked.exchange("12 34") == GOOD  # the wire waits for 500 bits
    begun, _ = asked.wire.out[0]
    assert begun == asked.wire.now >= 400 * BIT
    asked.unit.faults.begin(LateAnswers(2_000_000))
    assert asked.exchange("12 34") == ""
    port.silence(unit.station)
    asked.wire.pass_time(3_000_000)
    assert asked.wire.out == []
    port.resume(unit.station)
    assert asked.exchange("56 78") == ""
    asked.wire.pass_time(3_000_000)
    assert [octets.hex(" ").upper() for _, octets in asked.wire.out] == ["68 05 05 68 02 08 08 56 78 E0 16"]


@pytest.mark.parametrize("cut", ["power", "silence"])
def test_a_late_answer_is_not_sent_after_a_cut_that_is_over(cut: str) -> None:
    world = World(referee=False)
    bench = VirtualBench(world, PARAMS)
    bench.add(slave_config(VALVES))
    bench.units[8].faults.begin(LateAnswers(50 * MS))
    world.inject(bytes.fromhex(STATUS))
    world.run_for(10 * MS)
    if cut == "power":
        bench.power(8, False)
        bench.power(8, True)
    else:
        bench.silence(8)
        bench.resume(8)
    world.run_for(100 * MS)
    assert [entry[2].hex(" ").upper() for entry in world.log] == [STATUS]
    world.inject(bytes.fromhex(STATUS))
    world.run_for(100 * MS)
    assert [entry[2].hex(" ").upper() for entry in world.log][1:] == [STATUS, "10 02 08 00 0A 16"]


def calls_of(asked: Asked) -> int:
    """Python calls of one exchange, with the telegram of the master read octet by octet."""
    asked.exchange("12 34")
    count = 0

    def counted(_frame: object, event: str, _argument: object) -> None:
        nonlocal count
        count += event == "call"

    sys.setprofile(counted)
    try:
        asked.exchange("12 34")
    finally:
        sys.setprofile(None)
    return count


@pytest.mark.usefixtures("no_collection")
def test_a_slave_without_faults_costs_no_call_more() -> None:
    calls_of(Asked())  # the first one of a process has caches to fill
    plain = calls_of(Asked())
    assert plain <= 33
    asked = Asked()
    late(asked)
    for fault in (LateAnswers(1), Refusals(), StubNoise(1e-9)):
        asked.unit.faults.begin(fault)
        asked.exchange("12 34")
        asked.unit.faults.end(fault)
    assert calls_of(asked) == plain


@examples(10)
@given(
    st.lists(
        st.sampled_from(
            (LateAnswers(1_000_000), Refusals(), WrongLength(2), StubNoise(0.1, 5), RepeatedAnswers()),
        ),
        max_size=6,
    )
)
def test_a_slave_whose_faults_are_over_is_as_before(faults: list[Fault]) -> None:
    asked = Asked(VALVES)
    late(asked)
    for fault in faults:
        asked.unit.faults.begin(fault)
        asked.exchange("00 00")
    for fault in faults:
        asked.unit.faults.end(fault)
    asked.wire.pass_time(10_000_000)
    asked.wire.ask(STATUS)
    assert asked.exchange("12 34") == GOOD
    assert asked.unit.faults.active == ()
