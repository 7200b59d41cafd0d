"""Fuji's parameters and words of PCD, each end against literal octets (docs/reference/drives/fuji.md)."""

from __future__ import annotations

import pytest

from dpstack.errors import ConfigError
from dpstack_drives.fuji import DRIVE
from tests.drives.fuji_kit import IDLE, WIDE, ZERO, again, pkw, plugin, sim

REPLIES = [
    ("21 04 1A 00 00 00 00 0F", "11 04 1A 00 00 00 00 0F"),
    ("21 04 1A 00 00 00 00 10", "71 04 1A 00 00 00 00 02"),
    ("11 0F 62 00 00 00 00 00", "11 0F 62 00 00 00 00 03"),
    ("11 0F 64 00 00 00 00 00", "71 0F 64 00 00 00 00 00"),
    ("61 0F 62 00 00 00 00 00", "71 0F 62 00 00 00 00 04"),
    ("13 B3 01 00 00 00 00 00", "73 B3 01 00 00 00 00 03"),
    ("93 B3 00 00 00 00 00 00", "63 B3 00 00 00 00 00 20"),
    ("13 C5 00 00 00 00 00 00", "13 C5 00 00 00 00 00 02"),
    ("23 C5 00 00 00 00 00 01", "73 C5 00 00 00 00 00 01"),
    ("13 C8 00 00 00 00 00 00", "13 C8 00 00 00 00 02 40"),
]


@pytest.mark.parametrize(("order", "reply"), REPLIES)
def test_f6_orders_and_replies(order: str, reply: str) -> None:
    assert pkw(sim("PPO1"), order) == reply


def test_f6_f7_f9_malfunction_history() -> None:
    bench = sim("PPO1")
    bench.device.trip("OC1")
    bench.send(ZERO + "04 00 00 00")
    bench.send(ZERO + "04 80 00 00")
    bench.device.trip("Er5")
    assert pkw(bench, "63 B3 01 00 00 00 00 00") == "43 B3 01 00 00 00 75 11"
    assert pkw(bench, "63 B3 09 00 00 00 00 00") == "43 B3 09 00 00 00 23 01"
    assert pkw(bench, "63 B3 02 00 00 00 00 00") == "43 B3 02 00 00 00 00 00"
    assert pkw(bench, "63 B3 11 00 00 00 00 00") == "43 B3 11 00 00 00 00 00"


def test_f7_927_forbids_every_other_write() -> None:
    bench = sim("PPO1")
    assert pkw(bench, "23 9F 00 00 00 00 00 00") == "13 9F 00 00 00 00 00 00"
    assert pkw(bench, "21 04 1A 00 00 00 00 0F") == "71 04 1A 00 00 00 00 01"
    assert pkw(bench, "23 9F 00 00 00 00 00 01") == "13 9F 00 00 00 00 00 01"
    assert pkw(bench, "21 04 1A 00 00 00 00 0F") == "11 04 1A 00 00 00 00 0F"


def test_f6_the_plugin_to_the_byte() -> None:
    bench = plugin("PPO1", IDLE)
    token = bench.order_and_run(1, "write", number="F26", value=15)
    assert bench.out() == "21 04 1A 00 00 00 00 0F 04 7E 00 00"
    assert bench.value(token, "11 04 1A 00 00 00 00 0F 02 31 00 00") == 15
    token = bench.order("read", number="y98")
    assert bench.see(ZERO + "02 31 00 00", 2).startswith("11 0F 62 00 00 00 00 00")
    assert bench.value(token, "11 0F 62 00 00 00 00 03 02 31 00 00", 2) == 3
    token = bench.order("read", number="y100")
    assert bench.see(ZERO + "02 31 00 00", 2).startswith("11 0F 64 00 00 00 00 00")
    result = bench.done(token, "71 0F 64 00 00 00 00 00 02 31 00 00", 2)
    assert (result["error"], result["number"]) == ("parameter", 0)
    assert "nonexistent" in str(result["text"])
    token = bench.order("read", number=947, index=1)
    assert bench.see(ZERO + "02 31 00 00", 2).startswith("63 B3 01 00 00 00 00 00")
    assert bench.value(token, "43 B3 01 00 00 00 75 11 02 31 00 00", 2) == 0x7511


@pytest.mark.parametrize(
    ("args", "text"),
    [
        ({"number": "F26", "index": 2}, "no index"),
        ({"number": "Q26"}, "neither a function code"),
        ({"number": 2048}, "2047"),
        ({"number": 947, "index": 256}, "0..255"),
    ],
)
def test_misuse_of_parameters(args: dict[str, object], text: str) -> None:
    bench = plugin("PPO1", IDLE)
    assert text in bench.misuse("read", **args)


def test_misuse_of_writes() -> None:
    bench = plugin("PPO1", IDLE)
    for args, text in (
        ({"number": "F26", "value": 1, "ram": True}, "RAM"),
        ({"number": "F26", "value": 16}, "0..15"),
        ({"number": 965, "value": 1}, "read only"),
    ):
        assert text in bench.misuse("write", **args)


def test_f5_words_of_the_plugin() -> None:
    inputs = " 00 0F 00 23 00 00 12 34"
    bench = plugin("PPO2", IDLE + inputs, map_inputs="F26 M16 - W01", map_outputs="S06 F07=6 041A=2")
    bench.order("output", number="f07", value=2.5)
    bench.order("output", number="F26", value=15)
    assert bench.out_after("output", number="S06", value=0x0300) == ZERO + "04 7E 00 00 03 00 00 19 00 0F 00 00"
    assert bench.ok("inputs") == {"F26": 15, "M16": 35, "W01": 0x1234}
    for number, value, says in (
        ("F26", 16, "outside 0..15"),
        ("S06", 1, "bits 0 and 1"),
        ("F08", 1, "is not in the output map (S06 F07 F26)"),
    ):
        assert says in bench.misuse("output", number=number, value=value)
    bench.core.lost(bench.now)
    assert bench.core.cyclic(b"", bench.now).hex(" ").upper() == ZERO + "04 7E 00 00 00 00 00 19 00 0F 00 00"


@pytest.mark.parametrize(
    ("telegram", "options", "says"),
    [
        ("PPO1", {"map_inputs": "F26"}, "PPO1 has no PCD1 to PCD4; take PPO2 or PPO4"),
        ("PPO4", {"map_outputs": "S01"}, "S01 can only be read"),
        ("PPO4", {"map_outputs": "- S05"}, "S05 can only be read"),
        ("PPO4", {"map_outputs": "F26 041A"}, "F26 twice: only the first one would count"),
        ("PPO4", {"map_inputs": "Q9"}, "'Q9' is no function code"),
        ("PPO4", {"map_inputs": "- - - - F26"}, "5 words, there are 4"),
    ],
)
def test_f5_maps_that_cannot_be(telegram: str, options: dict[str, object], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        DRIVE.core("fan", telegram, options)


def test_f5_write_map_on_the_wire() -> None:
    """F26 has the drive's value (2); PNU 916, then 915, indexes 1 to 4; then both are read back, the outputs first."""
    bench = plugin("PPO2", IDLE + WIDE)
    token = bench.order("write_map", inputs="M16", outputs="S06 F26")
    seen: list[str] = []
    stored = {"01 04 1A": "00 00 00 02"}
    for _ in range(250):
        order = bench.out()[:23]
        if order == ZERO.strip():
            bench.inputs = bytes.fromhex(IDLE + WIDE)
        elif not seen or seen[-1] != order:
            seen.append(order)
            place = f"0{order[1:8]}"
            if order[0] == "7":
                stored[place] = order[12:]
            head = "1" if order[0] == "1" else "4"
            bench.inputs = bytes.fromhex(f"{head}{order[1:12]}{stored[place]} 02 40 00 00" + WIDE)
    assert seen == [
        "11 04 1A 00 00 00 00 00",
        "73 94 01 00 00 00 03 10",
        "73 94 02 00 00 00 00 00",
        "73 94 03 00 00 00 00 00",
        "73 94 04 00 00 00 00 00",
        "73 93 01 00 00 00 02 06",
        "73 93 02 00 00 00 04 1A",
        "73 93 03 00 00 00 00 00",
        "73 93 04 00 00 00 00 00",
        *(f"63 93 0{index} 00 00 00 00 00" for index in range(1, 5)),
        *(f"63 94 0{index} 00 00 00 00 00" for index in range(1, 5)),
    ]
    result = bench.done(token)
    assert (result["value"], result["acts"]) == ({"inputs": "M16", "outputs": "S06 F26"}, "after power-on")
    assert "write_map: S01 can only be read" in bench.misuse("write_map", outputs="S01")


def test_f5_the_drive_takes_them_at_power_on() -> None:
    bench = sim("PPO2")
    for order, reply in (
        ("73 93 01 00 00 00 04 1A", "43 93 01 00 00 00 04 1A"),  # PCD1 writes F26
        ("63 93 01 00 00 00 00 00", "43 93 01 00 00 00 04 1A"),
        ("11 0A 28 00 00 00 00 00", "11 0A 28 00 00 00 04 1A"),  # which is o40
        ("73 93 02 00 00 00 04 1A", "43 93 02 00 00 00 04 1A"),  # doubled: PCD1 wins
        ("73 93 03 00 00 00 02 01", "43 93 03 00 00 00 02 01"),  # S01 is ignored
        ("73 93 04 00 00 00 02 06", "43 93 04 00 00 00 02 06"),
        ("21 0A 30 00 00 00 04 1A", "11 0A 30 00 00 00 04 1A"),  # o48: PCD1 reads F26
        ("73 94 02 00 00 00 02 06", "43 94 02 00 00 00 02 06"),
        ("63 93 05 00 00 00 00 00", "73 93 05 00 00 00 00 03"),
    ):
        assert pkw(bench, order) == reply
    assert bench.send(IDLE.replace("02 40", "04 7E") + " 00 05 00 06 00 07 FF FF")[36:] == "00 00 00 00 00 00 00 00"
    bench = again(bench)
    words = bench.send(ZERO + "04 7E 00 00 00 05 00 06 00 07 FF FF")
    assert words == ZERO + "02 31 00 00 00 05 FF FC 00 00 00 00"  # bits 0 and 1 of S06 are ignored
    assert bench.send(ZERO + "04 7E 00 00 00 10 00 06 00 07 FF FF")[36:41] == "00 05"  # beyond F26's range


READS = [
    ({"number": 918}, "13 96 00 00 00 00 00 00", "13 96 00 00 00 00 00 1B", 27),
    ({"number": 963}, "13 C3 00 00 00 00 00 00", "13 C3 00 00 00 00 00 06", 6),
    ({"number": 915, "index": 2}, "63 93 02 00 00 00 00 00", "43 93 02 00 00 00 04 1A", 0x41A),
    ({"number": "o27"}, "11 0A 1B 00 00 00 00 00", "11 0A 1B 00 00 00 00 0A", 10),
    ({"number": "o28"}, "11 0A 1C 00 00 00 00 00", "11 0A 1C 00 00 00 02 58", 60.0),
    ({"number": "o31"}, "11 0A 1F 00 00 00 00 00", "11 0A 1F 00 00 00 00 7D", 125),
    ({"number": "S06"}, "11 02 06 00 00 00 00 00", "11 02 06 00 00 00 00 00", 0),
    ({"number": "M16"}, "11 03 10 00 00 00 00 00", "11 03 10 00 00 00 00 23", 35),
    ({"number": "E31"}, "11 05 1F 00 00 00 00 00", "11 05 1F 00 00 00 00 00", 0),
    ({"number": "C05"}, "11 06 05 00 00 00 00 00", "11 06 05 00 00 00 00 01", 1),
    ({"number": "P01"}, "11 07 01 00 00 00 00 00", "11 07 01 00 00 00 00 04", 4),
    ({"number": "H03"}, "11 08 03 00 00 00 00 00", "11 08 03 00 00 00 00 00", 0),
    ({"number": "J01"}, "11 0E 01 00 00 00 00 00", "11 0E 01 00 00 00 00 00", 0),
    ({"number": "W90"}, "11 10 5A 00 00 00 00 00", "11 10 5A 00 00 00 00 7B", 123),
    ({"number": "X00"}, "11 11 00 00 00 00 00 00", "11 11 00 00 00 00 00 00", 0),
    ({"number": "Z01"}, "11 12 01 00 00 00 00 00", "11 12 01 00 00 00 00 00", 0),
]


@pytest.mark.parametrize(("args", "order", "reply", "value"), READS)
def test_f7_f8_f11_f13_reads_of_the_plugin(args: dict[str, object], order: str, reply: str, value: float) -> None:
    bench = plugin("PPO1", IDLE)
    token = bench.order_and_run(1, "read", **args)
    assert bench.out().startswith(order)
    assert bench.value(token, reply + " 02 40 00 00", 2) == value


@pytest.mark.parametrize(
    ("args", "order"),
    [
        ({"number": 927, "value": 0}, "23 9F 00 00 00 00 00 00"),
        ({"number": 970, "value": 1}, "23 CA 00 00 00 00 00 01"),
        ({"number": "o27", "value": 3}, "21 0A 1B 00 00 00 00 03"),
        ({"number": "o28", "value": 10}, "21 0A 1C 00 00 00 00 64"),
        ({"number": "o31", "value": 99}, "21 0A 1F 00 00 00 00 63"),
        ({"number": "o41", "value": 0x310}, None),
        ({"number": 0x10A, "index": 51, "value": 0x310}, None),
        ({"number": 915, "index": 4, "value": 0x310}, None),
        ({"number": 916, "index": 4, "value": 0x310}, None),
    ],
)
def test_f7_f8_f11_writes_of_the_plugin(args: dict[str, object], order: str | None) -> None:
    """Codes of the map are for write_map."""
    bench = plugin("PPO1", IDLE)
    if order is None:
        assert "use write_map" in bench.misuse("write", **args)
    else:
        bench.order("write", **args)
    assert bench.out(2).startswith(order or ZERO)


@pytest.mark.parametrize(
    ("number", "text"),
    [
        ("00 00", "nonexistent parameter"),
        ("00 01", "writing inhibited"),
        ("00 02", "out of range"),
        ("00 03", "invalid subindex"),
        ("00 04", "no array"),
        ("00 0B", "while running"),
        ("00 11", "cannot be read"),
        ("00 65", "link priority"),
    ],
)
def test_f14_errors_by_their_text(number: str, text: str) -> None:
    bench = plugin("PPO1", IDLE)
    token = bench.order_and_run(2, "write", number="F26", value=1)
    result = bench.done(token, f"71 04 1A 00 00 00 {number} 02 40 00 00", 2)
    assert result["number"] == int(number.replace(" ", ""), 16)
    assert text in str(result["text"])


def test_f13_f14_errors_and_groups_of_the_drive() -> None:
    bench = sim("PPO1")
    for order, reply in (
        ("11 03 10 00 00 00 00 00", "11 03 10 00 00 00 00 00"),  # M16
        ("11 10 5A 00 00 00 00 00", "11 10 5A 00 00 00 00 7B"),  # W90
        ("11 0A 1B 00 00 00 00 00", "11 0A 1B 00 00 00 00 00"),  # o27
        ("11 0F 62 00 00 00 00 00", "11 0F 62 00 00 00 00 03"),  # y98
        ("11 0F 64 00 00 00 00 00", "71 0F 64 00 00 00 00 00"),
        ("21 02 01 00 00 00 00 01", "71 02 01 00 00 00 00 01"),  # S01
        ("21 0A 1B 00 00 00 00 10", "71 0A 1B 00 00 00 00 02"),
        ("63 B3 00 00 00 00 00 00", "73 B3 00 00 00 00 00 03"),
        ("61 0A 1B 00 00 00 00 00", "71 0A 1B 00 00 00 00 04"),
    ):
        assert pkw(bench, order) == reply
    bench.send(ZERO + "04 7E 40 00")
    bench.send(ZERO + "04 7F 40 00", 200)
    assert bench.send("21 08 03 00 00 00 00 01 04 7F 40 00")[:23] == "71 08 03 00 00 00 00 0B"  # H03 while running


def test_f7_970_initialises_when_it_falls() -> None:
    bench = sim("PPO1", F26=15)
    assert pkw(bench, "23 CA 00 00 00 00 00 00") == "13 CA 00 00 00 00 00 00"
    assert pkw(bench, "11 04 1A 00 00 00 00 00") == "11 04 1A 00 00 00 00 0F"
    assert pkw(bench, "23 CA 00 00 00 00 00 01") == "13 CA 00 00 00 00 00 01"
    assert pkw(bench, "11 04 1A 00 00 00 00 00") == "11 04 1A 00 00 00 00 0F"
    assert pkw(bench, "13 CA 00 00 00 00 00 00") == "13 CA 00 00 00 00 00 01"
    assert pkw(bench, "23 CA 00 00 00 00 00 00") == "13 CA 00 00 00 00 00 00"
    assert pkw(bench, "11 04 1A 00 00 00 00 00") == "11 04 1A 00 00 00 00 02"
    assert pkw(bench, "11 0F 62 00 00 00 00 00") == "11 0F 62 00 00 00 00 00"  # y98 as delivered


@pytest.mark.parametrize(
    ("baud", "index"),
    [(None, "00"), (9_600, "01"), (45_450, "03"), (93_750, "04"), (1_500_000, "07"), (12_000_000, "0A")],
)
def test_f7_963_and_918_tell_rate_and_address(baud: int | None, index: str) -> None:
    bench = sim("PPO1")
    bench.device.installed(27, baud)
    assert pkw(bench, "13 C3 00 00 00 00 00 00") == f"13 C3 00 00 00 00 00 {index}"
    assert pkw(bench, "13 96 00 00 00 00 00 00") == "13 96 00 00 00 00 00 1B"


def test_f11_switches_and_o31() -> None:
    bench = sim("PPO2")
    bench.device.installed(27, None)
    assert pkw(bench, "21 0A 1F 00 00 00 00 05") == "11 0A 1F 00 00 00 00 05"
    assert again(bench).device.own_address == 27  # the switches stand at 27
    bench = sim("PPO2")
    bench.device.installed(125, None)  # beyond the switches: o31
    assert pkw(bench, "11 0A 1F 00 00 00 00 00") == "11 0A 1F 00 00 00 00 7D"
    assert pkw(bench, "21 0A 1F 00 00 00 00 05") == "11 0A 1F 00 00 00 00 05"
    assert pkw(bench, "13 96 00 00 00 00 00 00") == "13 96 00 00 00 00 00 7D"  # until power-on
    assert again(bench).device.own_address == 5
    assert pkw(bench, "21 0A 1F 00 00 00 00 7E") == "11 0A 1F 00 00 00 00 7E"
    tripped = again(bench)
    assert tripped.device.own_address is None
    assert pkw(tripped, "63 B3 01 00 00 00 00 00") == "43 B3 01 00 00 00 75 11"  # Er5
    with pytest.raises(ConfigError, match="whole number"):
        DRIVE.device("PPO1", {"switches": 1.5})
