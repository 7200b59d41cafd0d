"""Values between two steps of a parameter: no drive and no channel rounds them in silence."""

from __future__ import annotations

import pytest
from acyclic_kit import outcome
from demag_kit import ZERO, ppo1
from drive_bench import Times

from dpstack.errors import ConfigError
from dpstack.profile import CommandError, ParamKey, ParamSpec, ParamTable, ParamType, count_of
from dpstack.profile.record47 import AcyclicAccess, ParameterClient, RecordQueue, WriteReq, plain_places
from dpstack_drives.demag import DRIVE as DEMAG
from tests.drives.fuji_kit import IDLE
from tests.drives.fuji_kit import plugin as fuji
from tests.drives.imo_kit import RUNS, Card
from tests.drives.keb_kit import plugin as keb
from tests.drives.ls_kit import ZERO as LS_ZERO
from tests.drives.ls_kit import plugin as ls

REFUSED = [
    (lambda: fuji("PPO1", IDLE), "F26", 2.5, "the step is 1: give 2 or 3"),
    (lambda: fuji("PPO1", IDLE), "o28", 0.25, "the step is 0.1 s: give 0.2 or 0.3 s"),
    (lambda: ls(LS_ZERO + "02 35 00 00", "PPO1"), "dr-03", 2.55, "the step is 0.1 s: give 2.5 or 2.6 s"),
    (ppo1, 400, 2.5, "the step is 1 kHz: give 2 or 3 kHz"),
    (ppo1, 480, -0.005, "the step is 0.01 Hz: give -0.01 or 0 Hz"),
    (lambda: Card(RUNS), "P00.10", 12.345, "the step is 0.01 Hz: give 12.34 or 12.35 Hz"),
    (keb, "oP.3", 20.01, "the step is 0.0125 Hz: give 20 or 20.0125 Hz"),
]


@pytest.mark.parametrize(("bench", "number", "value", "says"), REFUSED)
def test_a_write_between_two_steps_is_refused_with_both_of_them(
    bench: object, number: str | int, value: float, says: str
) -> None:
    assert callable(bench)
    drive = bench()
    before = drive.out()
    token = drive.order("write", number=number, value=value)
    assert drive.out() == before, "an order went out"
    assert says in drive.text(token, "usage")


def test_rounding_errors_of_decimal_fractions_are_no_step() -> None:
    bench = ppo1()
    bench.order_and_run(1, "write", number=375, value=0.1 + 0.2 + 49.7)
    assert bench.out() == "81 77 00 00 00 00 13 88 00 00 00 00"
    assert count_of("x", 4294967.295, 1000) == 0xFFFF_FFFF


def test_the_values_named_are_taken() -> None:
    for value, per_unit in ((33.3, 2.0**14 / 100), (1 / 3, 2.0**30), (20.01, 80), (2.55, 10)):
        with pytest.raises(ValueError, match="give") as told:
            count_of("x", value, per_unit)
        low, high = (float(one) for one in str(told.value).partition("give ")[2].split(" or "))
        assert count_of("x", high, per_unit) == count_of("x", low, per_unit) + 1


def test_parameters_of_a_simulated_drive_are_not_rounded_either() -> None:
    with pytest.raises(ConfigError, match=r"parameter 400 .* the step is 1 kHz: give 2 or 3 kHz"):
        DEMAG.device("PPO1", {"400": 2.5})


# -- record 47 -----------------------------------------------------------------------------------------------------

TABLE = ParamTable(
    [
        ParamSpec(number=11, name="ramp", title="Ramp time", decimals=1, unit="s", high=600),
        ParamSpec(number=12, name="offset", title="Offset", type=ParamType.I32, low=-100_000, high=100_000),
        ParamSpec(number=13, name="count", title="Count", type=ParamType.U32, high=100_000),
    ]
)


def over_records(name: str | int, value: float | None, *responses: str) -> object:
    """Write, or read where ``value`` is None, answered by ``responses``: the value."""
    queue, times, waiting = RecordQueue(), Times(), list(responses)
    access = AcyclicAccess(ParameterClient(0), queue, plain_places(TABLE, "mixer"), times)
    key = ParamKey(name)
    steps = access.read(key, 10**9) if value is None else access.write(key, value, 10**9)
    try:
        while True:
            next(steps)
            times.now += 10**6
            pending = queue.take()
            if pending is not None:
                read = not isinstance(pending.request, WriteReq)
                pending.outcome = outcome(waiting.pop(0) if read else "")
    except StopIteration as end:
        return end.value["value"]


@pytest.mark.parametrize(
    ("name", "value", "response", "says"),
    [
        ("ramp", 2.55, "", "the step is 0.1 s: give 2.5 or 2.6 s"),
        (2000, 0.1, "01 01 01 01 71 01 00 00", "N2: 0.1 lies between"),  # 0.1 x 4000h is 1638.4
        (2001, 0.00005, "01 01 01 01 7A 01 00 00 00 00", "C4: 5e-05 lies between .* step is 0.0001: give 0 or 0.0001"),
        ("offset", -70_000, "01 01 01 01 42 01 00 00", "more than the drive's format Word can hold"),
        ("offset", 40_000, "01 01 01 01 42 01 00 00", "more than the drive's format Word can hold"),
        ("count", 70_000, "01 01 01 01 06 01 00 00", "Unsigned16 takes whole numbers 0..65535, not 70000"),
        (2002, 16_777_217, "01 01 01 01 08 01 00 00 00 00", "FloatingPoint: .* 16777216 or 16777218"),
    ],
)
def test_record_47_refuses_what_the_format_cannot_hold(name: str | int, value: float, response: str, says: str) -> None:
    with pytest.raises(CommandError, match=says):
        over_records(name, value, response)


@pytest.mark.parametrize(
    ("name", "response", "value"),
    [
        ("ramp", "01 01 01 01 07 01 00 01 00 05", 6554.1),  # a double word where the table has a word
        ("offset", "01 01 01 01 43 01 FF FE FF FF", -65_537),
        ("offset", "01 01 01 01 42 01 FF FF", -1),
    ],
)
def test_record_47_reads_a_value_as_wide_as_the_drive_sends_it(name: str, response: str, value: float) -> None:
    assert over_records(name, None, response) == value


# -- parameter channel: replies of another type ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "data_set", "reply", "value"),
    [
        (400, None, "21 90 00 00 00 01 00 02", 65_538),  # a word in the table, a double word on the wire
        (480, 3, "41 E0 03 00 00 00 FF 9C", -1.0),  # a double word in the table, a word on the wire
        (371, 1, "51 73 01 00 00 01 86 A0", 10_000.0),
    ],
)
def test_a_reply_is_read_as_the_type_that_it_says(number: int, data_set: int | None, reply: str, value: float) -> None:
    bench = ppo1()
    token = bench.order_and_run(2, "read", number=number, data_set=data_set)
    assert bench.value(token, reply + " 02 40 00 00") == value


def test_the_reply_of_an_array_to_a_plain_order_is_an_error() -> None:
    bench = ppo1()
    token = bench.order_and_run(2, "read", number=400)
    bench.see("41 90 00 00 00 00 00 02 02 40 00 00")
    assert "reply 4 does not answer order 1" in bench.text(token)


def test_imo_a_long_response_is_read_whole() -> None:
    bench = Card(RUNS)
    token = bench.order("read", number="P00.10")
    state = "01 03 " + "00 00 " * 11
    bench.see("00 00 00 00 00 00 00 00 " + state, 2)
    assert bench.value(token, "00 02 00 0A 00 01 00 64 " + state, 2) == 656.36


# -- Fuji: set point, busy -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reverse", ["sign", "bit"])
@pytest.mark.parametrize("speed", [1.5, -1.5, 1.0001])
def test_fuji_refuses_a_speed_beyond_4000h(speed: float, reverse: str) -> None:
    bench = fuji("PPO3", "02 31 00 00", reverse=reverse)
    token = bench.order("speed", value=speed)
    limit = "outside -1..1: 100 % is F03 (maximum frequency), 0.5 is 50 %"
    assert bench.text(token, "usage") == f"speed {speed:g} is {limit}"
    assert bench.out()[6:] == "00 00"
    token = bench.order("frequency", value=90)
    assert "outside -1..1" in bench.text(token)
    assert bench.out_after("speed", value=1.0)[6:] == "40 00"


BUSY = "71 04 1A 00 00 00 00 68 02 40 00 00"  # 8.3 table 8.10: error 104


def test_fuji_asks_again_while_the_drive_is_busy() -> None:
    bench = fuji("PPO1", IDLE)
    token = bench.order("write", number="F26", value=15)
    for _ in range(3):
        bench.see(IDLE, 30)  # the order is withdrawn, a pause, and it is there again
        assert bench.out().startswith("21 04 1A 00 00 00 00 0F")
        assert bench.see(BUSY, 2).startswith(ZERO)
        assert bench.result(token) is None
    bench.see(IDLE, 30)
    assert bench.value(token, "11 04 1A 00 00 00 00 0F 02 40 00 00", 2) == 15


def test_fuji_that_stays_busy_tells_it_when_the_time_is_over() -> None:
    bench = fuji("PPO1", IDLE)
    token = bench.order("write", number="F26", value=15, timeout_s=0.3)
    for _ in range(20):
        bench.see(IDLE, 20)
        bench.see(BUSY, 2)
    result = bench.done(token)
    assert (result["error"], result["number"]) == ("parameter", 104)
    assert "busy" in str(result["text"])
