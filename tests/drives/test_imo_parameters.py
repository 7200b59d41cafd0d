"""IMO's PKW zone, the plugin's end against literal octets (docs/reference/drives/imo-hd2.md#pkw-zone)."""

from __future__ import annotations

import re

import pytest
from drive_bench import PluginBench

from dpstack.errors import ConfigError
from dpstack_drives.imo import DRIVE
from tests.drives.imo_kit import NOTHING, READY, RUNS, Card

# -- PKW -----------------------------------------------------------------------------------------------------------


def pkw(bench: PluginBench, reply: str) -> str:
    """The request under way while the drive shows ``reply``."""
    return bench.see(reply + " " + READY + NOTHING, 2)[:23]


def quiet() -> PluginBench:
    return Card(RUNS)


@pytest.fixture
def bench() -> PluginBench:
    return quiet()


def test_i3_the_read_of_the_manual(bench: PluginBench) -> None:
    token = bench.order("read", number="P00.10")
    assert pkw(bench, "00 00 00 00 00 00 00 00") == "00 01 00 0A 00 00 00 00"
    assert pkw(bench, "00 01 00 0A 00 00 13 88") == "00 00 00 00 00 00 00 00"
    result = bench.done(token)
    assert (result["value"], result["raw"], result["unit"]) == (50.0, 0x1388, "Hz")
    by_number = bench.order_and_run(60, "read", number=10)
    pkw(bench, "00 00 00 00 00 00 00 00")
    pkw(bench, "00 01 00 0A 00 00 00 64")
    assert bench.value(by_number) == 1.0


def test_i3_a_long_response(bench: PluginBench) -> None:
    token = bench.order("read", number="P07.20")
    assert pkw(bench, "00 00 00 00 00 00 00 00") == "00 01 07 14 00 00 00 00"
    pkw(bench, "00 02 07 14 00 01 E2 40")
    assert bench.value(token) == 123456


def test_i3_a_write_is_request_4_with_cw_bit_8(bench: PluginBench) -> None:
    bench.order("write", number="P00.10", value=12.5)
    assert bench.see("00 00 00 00 00 00 00 00 " + READY + NOTHING, 2)[:29] == "00 04 00 0A 00 00 04 E2 01 05"
    assert bench.see("00 01 00 0A 00 00 04 E2 " + READY + NOTHING, 2)[:29] == "00 00 00 00 00 00 00 00 00 05"
    assert any("request 4" in text for text in bench.notices())


def test_i3_a_negative_value_comes_back_as_it_was_written(bench: PluginBench) -> None:
    """P01.47 (address 303, 012Fh) is not in the manual of the card: its type is not known."""
    token = bench.order("write", number=303, value=-5)
    assert bench.see("00 00 00 00 00 00 00 00 " + READY + NOTHING, 2).startswith("00 04 01 2F 00 00 FF FB")
    result = bench.done(token, "00 01 01 2F 00 00 FF FB " + READY + NOTHING, 2)
    assert (result["value"], result["raw"]) == (-5, -5)


@pytest.mark.parametrize(
    ("reply", "says", "number"),
    [
        ("00 03 00 0A 00 01 00 00", "error 1, invalid command", 1),
        ("00 03 00 0A 00 02 00 00", "error 2, invalid data address", 2),
        ("00 03 00 0A 00 03 00 00", "error 3, invalid data value", 3),
        ("00 03 00 0A 00 04 00 00", "error 4, operation failure", 4),
        ("00 03 00 0A 00 05 00 00", "error 5, password error", 5),
        ("00 03 00 0A 00 06 00 00", "error 6, data frame error", 6),
        ("00 03 00 0A 00 07 00 00", "error 7, the parameter is read only", 7),
        ("00 03 00 0A 00 08 00 00", "error 8, the parameter cannot be changed while the drive runs", 8),
        ("00 03 00 0A 00 09 00 00", "error 9, protected by password", 9),
        ("00 03 00 0A 00 63 00 00", "error 99, error without a text", 99),
        ("00 04 00 0A 00 00 00 00", "no right to change parameters (response 4)", None),
    ],
)
def test_i3_refusals(bench: PluginBench, reply: str, says: str, number: int | None) -> None:
    token = bench.order("write", number="P00.10", value=1)
    pkw(bench, "00 00 00 00 00 00 00 00")
    pkw(bench, reply)
    result = bench.done(token)
    assert (result["error"], result["number"]) == ("parameter", number)
    assert says in str(result["text"])


@pytest.mark.parametrize(
    ("op", "args", "says"),
    [
        ("write", {"number": "P00.10", "value": 1, "ram": True}, "does not support writes to RAM only (request 2)"),
        ("write", {"number": "P07.20", "value": 70_000}, "does not write parameters of two words, request 5"),
        ("write", {"number": "P15.01", "value": 126}, "outside 0..125"),
        ("write", {"number": "P15.02", "value": 1}, "use write_map"),
        ("write", {"number": 0x0F0C, "value": 1}, "use write_map"),
        ("write", {"number": "P15.23", "value": 1}, "use write_map"),
        ("write", {"number": "P15.00", "value": 1}, "read only"),
        ("read", {"number": "412.1"}, "neither a function code such as P15.02 nor an address"),
        ("read", {"number": 65_536}, "0..65535"),
        ("read", {"number": "P15.02", "index": 1}, "neither data sets nor indexes"),
    ],
)
def test_i3_i5_misuse_is_refused_before_anything_is_sent(op: str, args: dict[str, object], says: str) -> None:
    bench = Card(RUNS)
    bench.seen.clear()
    assert says in bench.misuse(op, **args)
    assert bench.seen == ["00 00 00 00 00 00 00 00"]


def test_i3_a_drive_that_is_silent_or_answers_for_another_address(bench: PluginBench) -> None:
    token = bench.order("read", number="P00.10", timeout_s=0.1)
    pkw(bench, "00 01 00 0B 00 00 00 00")
    bench.run(60)
    assert "answered for P00.11 (response 1) instead" in bench.text(token)
    bench = quiet()
    token = bench.order("read", number="P00.10", timeout_s=0.1)
    pkw(bench, "00 00 00 00 00 00 00 00")
    bench.run(60)
    assert "did not answer in its parameter channel in time" in bench.text(token)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"baud_index": 9}, "9 Mbit/s in the card's table, a rate that PROFIBUS does not have"),
        ({"baud_index": 6.5}, "must be a whole number"),
        ({"fault_names": "OC1"}, "write each code once with its name"),
        ({"map_outputs": "speed"}, "no process data of the drive"),
    ],
)
def test_i5_options_that_cannot_be(options: dict[str, object], says: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(says)):
        DRIVE.core("pump", options=options)
