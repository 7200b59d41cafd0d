"""KEB's parameter channel: each end against the octets of the manual
(docs/reference/drives/keb-f5.md#administration-byte)."""

from __future__ import annotations

from collections.abc import Generator

import pytest
from drive_bench import MS, PluginBench, Times
from hypothesis import given
from hypothesis import strategies as st

from dpstack.profile import CommandError, ParamKey
from dpstack_drives.keb import DRIVE
from dpstack_drives.keb import table as t
from dpstack_drives.keb.channel import KebChannel, KebServer
from tests.drives.keb_kit import IDLE, ZERO, KebBench, device, plugin, sim

WRITE_20_HZ = "72 01 23 03 00 00 06 40"  # oP.3 := 20 Hz with four octets
CONFIRMED = "42 01 23 03 00 00 06 40"


def drive(**presets: object) -> KebBench:
    return sim(presets, "PCH+4/4")


def channel(bench: PluginBench, reply: str, rotations: int = 1) -> str:
    return bench.see(reply + IDLE, rotations)[:23]


def ask(bench: KebBench, request: str) -> str:
    return bench.send(request + IDLE, 6)[:23]


# -- the plugin --------------------------------------------------------------------------------------------------------


@pytest.fixture
def bench() -> PluginBench:
    return plugin()


def test_k3_k4_the_plugin_writes_with_four_octets_and_judges_handshake_and_result_only(bench: PluginBench) -> None:
    token = bench.order("write", number="oP.3", value=20)
    assert bench.out()[:23] == WRITE_20_HZ
    assert channel(bench, ZERO, 5) == WRITE_20_HZ  # held: bit 6 is not yet ours
    assert channel(bench, CONFIRMED) == WRITE_20_HZ  # the request stays; bit 6 says that it is done
    result = bench.done(token)
    assert (result["ok"], result["value"], result["raw"], result["unit"]) == (True, 20.0, 0x640, "Hz")


def test_k4_the_confirmation_of_the_manual_is_one(bench: PluginBench) -> None:
    token = bench.order("write", number="oP.3", value=20)
    channel(bench, ZERO, 2)
    channel(bench, "42 01 23 03 06 40 00 00")
    result = bench.done(token)
    assert (result["ok"], result["value"]) == (True, 20.0)


def test_k3_the_handshake_is_inverted_for_every_new_request(bench: PluginBench) -> None:
    first, second = bench.order("read", number="oP.3"), bench.order("read", number="sy.51", data_set=2)
    assert bench.out()[:23] == "71 01 23 03 00 00 00 00"
    assert channel(bench, "41 01 23 03 00 00 06 40") == "31 04 20 33 00 00 00 00"
    result = bench.done(first)
    assert result["value"] == 20.0
    assert channel(bench, "41 01 23 03 00 00 06 40", 3) == "31 04 20 33 00 00 00 00"
    assert bench.result(second) is None
    channel(bench, "01 04 20 33 00 00 00 05")
    result = bench.done(second)
    assert (result["value"], result["data_set"]) == (5, 2)


@pytest.mark.parametrize(
    ("answer", "number", "text"),
    [
        ("C1 01 23 03 05 04 00 00", 0x05040000, "5/4/0000, read and write asked for at once"),
        ("C1 01 23 03 06 02 00 00", 0x06020000, "6/2/0000, the operator has no connection to the inverter"),
        ("C1 01 23 03 06 03 00 00", 0x06030000, "6/3/0000, the parameter is write protected"),
        ("C1 01 23 03 06 03 00 30", 0x06030030, "6/3/0030, not accessible with the present password"),
        ("C1 01 23 03 06 04 00 00", 0x06040000, "6/4/0000, there is no such parameter"),
        ("C1 01 23 03 06 05 00 00", 0x06050000, "6/5/0000, invalid process data description"),
        ("C1 01 23 03 06 05 00 11", 0x06050011, "6/5/0011, invalid subindex"),
        ("C1 01 23 03 08 00 00 30", 0x08000030, "8/0/0030, the value is outside its range"),
        ("C1 01 23 03 08 00 00 33", 0x08000033, "8/0/0033, there is no such parameter set"),
        ("F1 01 23 03 08 00 00 34", 0x08000034, "8/0/0034, the operation is not possible"),
        ("C1 01 23 03 09 09 12 34", 0x09091234, "9/9/1234, an error without a text in the manual"),
    ],
)
def test_k5_errors_as_texts(bench: PluginBench, answer: str, number: int, text: str) -> None:
    token = bench.order_and_run(1, "read", number="oP.3")
    channel(bench, answer)
    result = bench.done(token)
    assert (result["ok"], result["error"], result["number"]) == (False, "parameter", number)
    assert f"oP.03 (2303h) digital setpoint setting: error {text}" in str(result["text"])


def test_k5_a_busy_inverter_is_asked_again(bench: PluginBench) -> None:
    token = bench.order("read", number="oP.3")
    assert bench.out()[0:2] == "71"
    assert channel(bench, "C1 01 23 03 08 00 00 22")[:2] == "71"
    assert channel(bench, "C1 01 23 03 08 00 00 22", 15)[:2] == "31"  # again, the handshake inverted
    assert bench.result(token) is None
    channel(bench, "01 01 23 03 00 00 00 50")
    assert bench.value(token) == 1.0


def test_k5_busy_up_to_the_time_out_is_told(bench: PluginBench) -> None:
    token = bench.order("read", number="oP.3", timeout_s=0.2)
    for hand in "C8" * 20:
        channel(bench, f"{hand}1 01 23 03 08 00 00 22", 10)
    assert "the inverter is busy" in bench.text(token)


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (ZERO, "did not confirm the request in its parameter channel in time"),
        ("41 01 22 0C 00 00 00 00", "answered for index 220Ch subindex 1 instead"),
    ],
)
def test_a_drive_that_is_silent_or_answers_for_another_parameter(bench: PluginBench, answer: str, says: str) -> None:
    token = bench.order_and_run(1, "read", number="oP.3", timeout_s=0.1)
    channel(bench, answer, 60)
    assert says in bench.text(token, "timeout")


def test_a_request_given_up_keeps_the_channel_until_the_drive_confirms_it(bench: PluginBench) -> None:
    """With the bit inverted under it, a late confirmation would be taken for the next request's."""
    bench.order_and_run(40, "read", number="oP.3", timeout_s=0.05)
    late = bench.order_and_run(40, "read", number="sy.51", timeout_s=0.05)
    assert bench.out()[:23] == "71 01 23 03 00 00 00 00"
    assert "has not yet confirmed the request before it (oP.03" in str(bench.result(late))
    token = bench.order("read", number="sy.51")
    assert channel(bench, "41 01 23 03 00 00 06 40") == "31 01 20 33 00 00 00 00"
    channel(bench, "01 01 20 33 00 00 00 03")
    assert bench.value(token) == 3


def test_after_a_new_start_the_drives_own_handshake_bit_is_taken() -> None:
    """The bit may be 1 from before; after the settling time the plugin takes it as it is."""
    core = KebChannel(Times(settle_ns=100))
    request: Generator[None, None, object] = core.read(ParamKey("oP.3"), 10**9)
    next(request)
    stale = bytes.fromhex("41 01 23 03 00 00 00 07")
    for now in (0, 50, 99):
        core.step(stale, now)
        assert core.octets == bytes(8)
    core.step(stale, 100)
    assert core.octets.hex(" ").upper() == "31 01 23 03 00 00 00 00"
    core.step(stale, 101)
    next(request)
    core.step(bytes.fromhex("01 01 23 03 00 00 06 40"), 102)
    with pytest.raises(StopIteration) as done:
        next(request)
    assert done.value.value["value"] == 20.0


@pytest.mark.parametrize(
    ("args", "request_octets"),
    [
        ({"number": "oP.3"}, "71 01 23 03 00 00 00 00"),
        ({"number": "oP.3", "data_set": 0}, "71 01 23 03 00 00 00 00"),
        ({"number": "oP.3", "data_set": 7}, "71 80 23 03 00 00 00 00"),
        ({"number": "oP.3", "index": 0}, "71 00 23 03 00 00 00 00"),
        ({"number": "oP.3", "index": 3}, "71 03 23 03 00 00 00 00"),
        ({"number": 0x2406}, "71 01 24 06 00 00 00 00"),
        ({"number": "2406h"}, "71 01 24 06 00 00 00 00"),
        ({"number": 0x5FF8}, "71 00 5F F8 00 00 00 00"),
        ({"number": 0x6000, "index": 2}, "71 02 60 00 00 00 00 00"),
    ],
)
def test_k6_sets_by_the_bit_of_the_subindex(bench: PluginBench, args: dict[str, object], request_octets: str) -> None:
    assert bench.out_after("read", **args)[:23] == request_octets


@pytest.mark.parametrize(
    ("args", "says"),
    [
        ({"number": "oP.3", "data_set": 8}, "sets are 0..7"),
        ({"number": "oP.3", "data_set": 1, "index": 1}, "data_set or index"),
        ({"number": "oP.3", "index": 256}, "subindexes are 0..255"),
        ({"number": 0x6000, "data_set": 1}, "has no sets"),
        ({"number": 412}, "inverter parameters begin at 2000h"),
        ({"number": 0x1_0000}, "inverter parameters begin at 2000h"),
        ({"number": "Pn.06"}, "address of its group is not in the manual"),
        ({"number": "speedy"}, "neither a parameter such as oP.3 nor an index in hex"),
    ],
)
def test_k6_wrong_parameters_raise_at_once(bench: PluginBench, args: dict[str, object], says: str) -> None:
    token = bench.order("read", **args)
    assert says in bench.text(token, "usage")
    assert bench.out()[:23] == ZERO


@pytest.mark.parametrize(
    ("args", "says"),
    [
        ({"number": "sy.52", "value": 1.5}, "give the integer on the wire (32 bits)"),
        ({"number": 0x2406, "value": 1 << 32}, "give the integer on the wire"),
        ({"number": "oP.3", "value": 1e12}, "give a number in Hz"),
        ({"number": "oP.3", "value": 1, "ram": True}, "no writes to RAM only"),
    ],
)
def test_values_are_checked_before_anything_is_sent(bench: PluginBench, args: dict[str, object], says: str) -> None:
    assert says in bench.misuse("write", **args)


def test_negative_values_are_32_bits(bench: PluginBench) -> None:
    assert bench.out_after("write", number="oP.3", value=-20)[:23] == "72 01 23 03 FF FF F9 C0"


def test_without_a_channel_there_are_no_parameters() -> None:
    bench = PluginBench(DRIVE.core("hoist", "4/4"), "00 00 00 00")
    assert "4/4 of keb-f5 has no parameter channel" in bench.misuse("read", number="oP.3")
    assert "no parameter channel: take PCH+" in bench.misuse("read_map")


# -- the simulated drive -----------------------------------------------------------------------------------------------


def test_k4_the_example_of_the_manual() -> None:
    bench = drive()
    assert ask(bench, ZERO) == ZERO
    assert ask(bench, "52 01 23 03 06 40 00 00") == "42 01 23 03 06 40 00 00"
    assert bench.device.store.value("oP.03", 1) == 20.0
    assert bench.device.store.value("oP.03", 2) == 0.0


def test_k3_any_parameter_with_four_octets() -> None:
    bench = drive()
    assert ask(bench, WRITE_20_HZ) == CONFIRMED
    assert ask(bench, "31 01 23 03 00 00 00 00") == "01 01 23 03 00 00 06 40"  # read with four
    assert ask(bench, "41 01 23 03 00 00 00 00") == "41 01 23 03 06 40 00 00"  # left-justified by its length
    assert ask(bench, "01 01 23 3B 00 00 00 00") == "01 01 23 3B 00 00 00 42"  # oP.59 is a long


def test_k3_a_request_is_new_when_bit_6_changes() -> None:
    bench = drive()
    assert ask(bench, "32 01 23 03 00 00 06 40") == ZERO  # bit 6 as before: not a request
    assert ask(bench, WRITE_20_HZ) == CONFIRMED
    assert ask(bench, "72 01 23 03 00 00 0C 80") == CONFIRMED
    assert ask(bench, "32 01 23 03 00 00 0C 80") == "02 01 23 03 00 00 0C 80"
    assert bench.device.server.requests == 2
    assert ask(bench, "40 00 00 00 00 00 00 00") == "40 00 00 00 00 00 00 00"  # no service
    assert bench.device.server.requests == 2


def test_k3_both_services_at_once_are_an_error() -> None:
    assert ask(drive(), "73 01 23 03 00 00 06 40") == "C3 01 23 03 05 04 00 00"


@pytest.mark.parametrize(
    ("request_octets", "answer"),
    [
        ("72 01 20 33 00 00 00 01", "C2 01 20 33 06 03 00 00"),  # sy.51 is an actual value
        ("71 01 25 00 00 00 00 00", "C1 01 25 00 06 04 00 00"),
        ("71 12 60 00 00 00 00 00", "C1 12 60 00 06 05 00 11"),
        ("71 00 60 00 00 00 00 00", "C1 00 60 00 06 05 00 11"),
        ("71 01 5F F8 00 00 00 00", "C1 01 5F F8 06 05 00 11"),
        ("72 01 60 00 00 00 00 11", "C2 01 60 00 06 05 00 00"),  # 17 octets of process data
        ("72 01 23 03 00 00 7D 01", "C2 01 23 03 08 00 00 30"),  # 400.0125 Hz
        ("72 02 20 32 00 00 00 01", "C2 02 20 32 08 00 00 33"),  # sy.50 exists once
    ],
)
def test_k5_errors_of_the_drive(request_octets: str, answer: str) -> None:
    assert ask(drive(), request_octets) == answer


def test_k5_no_inverter_busy_and_password() -> None:
    bench = drive()
    bench.device.link(False)
    assert ask(bench, "71 01 23 03 00 00 00 00") == "C1 01 23 03 06 02 00 00"
    assert ask(bench, "31 00 5F F8 00 00 00 00") == "01 00 5F F8 00 00 00 FF"  # the operator's own works on
    bench.device.link(True)
    bench.device.refuse("busy")
    assert ask(bench, "71 01 23 03 00 00 00 00") == "C1 01 23 03 08 00 00 22"
    assert ask(bench, "31 01 23 03 00 00 00 00") == "01 01 23 03 00 00 00 00"
    locked = drive(**{"ud.01": 0})
    assert ask(locked, WRITE_20_HZ) == "C2 01 23 03 06 03 00 30"
    assert ask(locked, "32 01 28 01 00 00 01 B8") == "02 01 28 01 00 00 01 B8"  # ud.01 = 440
    assert ask(locked, WRITE_20_HZ) == CONFIRMED


def test_k6_a_write_goes_to_all_sets_and_unequal_ones_cannot_be_read_together() -> None:
    """The error is a reading."""
    bench = drive()
    assert ask(bench, "72 05 23 03 00 00 06 40") == "42 05 23 03 00 00 06 40"  # sets 0 and 2
    assert [bench.device.store.value("oP.03", n) for n in (1, 2, 3)] == [20.0, 0.0, 20.0]
    assert ask(bench, "31 05 23 03 00 00 00 00") == "01 05 23 03 00 00 06 40"
    assert ask(bench, "71 07 23 03 00 00 00 00") == "C1 07 23 03 08 00 00 34"
    assert ask(bench, "31 00 23 03 00 00 00 00") == "01 00 23 03 00 00 06 40"  # indirect: set 0


# -- anything ----------------------------------------------------------------------------------------------------------


@given(st.lists(st.binary(min_size=8, max_size=8), max_size=30))
def test_any_octets_never_raise(octets: list[bytes]) -> None:
    server = device().server
    times = Times(settle_ns=10)
    client = KebChannel(times)
    jobs = [client.read(ParamKey("oP.3"), 10**9) for _ in range(4)]
    for request in octets:
        assert len(server.step(request)) == 8
        times.now += MS
        client.step(request, times.now)
        assert len(client.octets) == 8
        for job in tuple(jobs):
            try:
                next(job)
            except (StopIteration, CommandError):
                jobs.remove(job)


@given(st.binary(min_size=8, max_size=8))
def test_every_new_request_is_confirmed_with_its_own_bit_and_address(request: bytes) -> None:
    server = KebServer(lambda index, subindex, raw, octets: (raw or 0, octets))
    shown = request[0] & 0x40
    first = bytes([request[0] ^ 0x40]) + request[1:]
    server.step(first)
    reply = server.step(request)
    assert reply[0] & 0x40 == shown
    if request[0] & 0x43:
        assert reply[1:4] == request[1:4]


def test_the_texts_are_all_there() -> None:
    assert len(t.ERRORS) == 11
