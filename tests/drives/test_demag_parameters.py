"""Demag's parameter channel, the master's end alone, fed with literal octets (docs/reference/drives/demag.md)."""

from __future__ import annotations

import pytest
from demag_kit import ZERO, ppo1, ppo3
from drive_bench import PluginBench


@pytest.fixture
def bench() -> PluginBench:
    return ppo1()


def test_d6_read_400(bench: PluginBench) -> None:
    token = bench.order_and_run(1, "read", number=400)
    assert bench.out() == "11 90 00 00 00 00 00 00 00 00 00 00"
    result = bench.done(token, "11 90 00 00 00 00 00 02 02 40 00 00")
    assert (result["value"], result["unit"], result["name"]) == (2, "kHz", "switching_frequency")
    assert bench.out() == ZERO + "00 00 00 00"


def test_d6_write_480_in_data_set_3(bench: PluginBench) -> None:
    token = bench.order_and_run(1, "write", number=480, value=-300.0, data_set=3)
    assert bench.out() == "81 E0 03 00 FF FF 8A D0 00 00 00 00"
    result = bench.done(token, "51 E0 03 00 FF FF 8A D0 02 40 00 00")
    assert (result["value"], result["raw"], result["data_set"]) == (-300.0, -30000, 3)


def test_d16_value_of_the_example(bench: PluginBench) -> None:
    token = bench.order_and_run(1, "read", number="fixed_frequency_1", data_set=3)
    assert bench.out() == "61 E0 03 00 00 00 00 00 00 00 00 00"
    assert bench.value(token, "51 E0 03 00 FF FF EA 84 02 40 00 00") == -55.0


def test_d3_negative_replies(bench: PluginBench) -> None:
    token = bench.order_and_run(2, "read", number=412)
    result = bench.done(token, "71 9C 00 00 00 00 00 6B 02 40 00 00")
    assert (result["error"], result["number"]) == ("parameter", 107)
    assert "different values" in str(result["text"])
    bench.see(ZERO + "02 40 00 00")
    token = bench.order_and_run(2, "write", number=414, value=2)
    result = bench.done(token, "81 9E 00 00 00 00 00 00 02 40 00 00")
    assert (result["error"], result["number"]) == ("parameter", None)
    assert "no control" in str(result["text"])


def test_a_reply_that_does_not_fit_the_order(bench: PluginBench) -> None:
    token = bench.order_and_run(2, "write", number=414, value=2)
    bench.see("21 9E 00 00 00 00 00 02 02 40 00 00")
    assert "reply 2 does not answer order 2" in bench.text(token)


def test_d4_d17_a_second_request_waits_and_a_silent_drive_times_out(bench: PluginBench) -> None:
    first = bench.order("read", number=400, timeout_s=0.1)
    second = bench.order_and_run(60, "read", number=414)
    result = bench.done(first)
    assert (result["error"], "did not answer" in str(result["text"])) == ("timeout", True)
    assert bench.out().startswith(ZERO)  # the drive may take the first one up yet: three scans and more
    assert bench.out(59).startswith("11 9E 00 00")
    assert bench.value(second, "11 9E 00 00 00 00 00 03 02 40 00 00") == 3


def test_an_answer_for_another_number_is_named() -> None:
    bench = ppo1("11 91 00 00 00 00 00 01 02 40 00 00")
    token = bench.order_and_run(60, "read", number=400, timeout_s=0.05)
    assert "answered for parameter 401" in bench.text(token)


def test_d20_an_unknown_parameter_is_read_raw_and_its_type_found_before_a_write(bench: PluginBench) -> None:
    token = bench.order_and_run(1, "write", number=700, value=-2)
    assert bench.out().startswith("12 BC 00 00 00 00 00 00")
    bench.see("22 BC 00 00 00 00 00 05 02 40 00 00", 2)
    assert bench.see(ZERO + "02 40 00 00", 2).startswith("32 BC 00 00 FF FF FF FE")
    result = bench.done(token, "22 BC 00 00 FF FF FF FE 02 40 00 00")
    assert (result["value"], result["raw"]) == (-2, -2)


def test_d20_a_negative_word_comes_back_as_it_was_written(bench: PluginBench) -> None:
    """303 is in no table: the drive says that it is a word, and takes FFFB. A number without a sign keeps none."""
    for value, octets in ((-5, "FF FB"), (65_531, "FF FB")):
        token = bench.order_and_run(1, "write", number=303, value=value)
        bench.see("11 2F 00 00 00 00 00 05 02 40 00 00", 2)
        assert bench.see(ZERO + "02 40 00 00", 2).startswith(f"21 2F 00 00 00 00 {octets}")
        result = bench.done(token, f"11 2F 00 00 00 00 {octets} 02 40 00 00")
        assert (result["value"], result["raw"]) == (value, value)
        bench.see(ZERO + "02 40 00 00", 2)


@pytest.mark.parametrize(
    ("op", "args", "text"),
    [
        ("write", {"number": 480, "value": 1000.0}, "-999..999 Hz"),
        ("write", {"number": 249, "value": 1}, "read only"),
        ("read", {"number": 281}, "text"),
        ("read", {"number": 1000}, "1..999"),
        ("read", {"number": "fixed_frequency"}, "did you mean fixed_frequency_1"),
        ("read", {"number": 400, "data_set": 2}, "exists once"),
        ("read", {"number": 480, "data_set": 5}, "1..4"),
        ("read", {"number": 1.5}, "number or name"),
        ("read", {"number": 400, "data_set": -1}, "whole number"),
        ("read", {"number": 400, "set": 1}, "unknown argument 'set'"),
        ("write", {"number": 400, "value": "2"}, "value must be a number"),
        ("write", {"number": 400, "value": 2, "ram": 1}, "true or false"),
        ("speed", {}, "value must be a number"),
        ("start", {"timeout_s": -1}, "negative"),
        ("fly", {}, "no order 'fly'"),
    ],
)
def test_misuse_is_refused_before_anything_is_sent(op: str, args: dict[str, object], text: str) -> None:
    bench = ppo1()
    assert text in bench.misuse(op, **args)
    assert bench.out() == ZERO + "00 00 00 00"


def test_ppo3_has_no_parameters() -> None:
    bench = ppo3()
    assert "no parameter channel" in bench.misuse("read", number=400)


def test_d5_eeprom_writes_in_a_loop_are_told(bench: PluginBench) -> None:
    for _ in range(10):
        bench.order_and_run(2, "write", number=414, value=1)
        bench.see("11 9E 00 00 00 00 00 01 02 40 00 00", 2)
        bench.see(ZERO + "02 40 00 00", 2)
    assert sum("10 times" in text for text in bench.notices()) == 1
