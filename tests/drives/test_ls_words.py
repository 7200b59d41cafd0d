"""LS S100's plugin against literal octets: vendor telegram, maps, parameters."""

from __future__ import annotations

import pytest

from dpstack.errors import ConfigError
from dpstack_drives.ls import DRIVE
from tests.drives.ls_kit import S2, ZERO, plugin

# -- vendor telegram and maps --------------------------------------------------------------------------------------


def test_l11_swapped_words() -> None:
    """COM-68 = 1: the octets of each word change places, those of the parameter channel do not."""
    bench = plugin(ZERO + "37 03 00 F0", "PPO1", swap=True)
    assert bench.core.status().speed == -0.25
    assert bench.core.status().reached
    bench.order("speed", value=0.5)
    bench.order_and_run(1, "read", number=965)
    assert bench.out() == "13 C5 00 00 00 00 00 00 7E 04 00 20"


def test_l1_l7_vendor_words() -> None:
    bench = plugin("00 00 00 01 00 00", "VENDOR 2/3")
    assert not bench.notices()  # no drive profile, so 0005 and 000A are what to use
    bench.order("speed", value=-0.5)
    assert bench.out_after("start") == "0B B8 00 04"
    bench.see("0B B8 10 44 00 00", 3)
    assert bench.core.status().speed == pytest.approx(-0.5)
    assert bench.core.status().reached
    bench.see("00 00 00 09 00 0C", 3)
    assert "000F is 000C" in str(bench.core.status().fault)
    assert bench.out_after("acknowledge") == "0B B8 00 08"
    assert "written by start" in bench.misuse("output", number="0x0006", value=2)


def test_l7_vendor_without_the_words_for_it() -> None:
    bench = plugin("00 00", "VENDOR 1/1", para_control="dr-03=1", para_status="0334")
    assert "0006 (operation command) is not in para_control" in bench.misuse("start")
    assert "0005 (frequency command)" in bench.misuse("speed", value=0.5)
    bench = plugin("00 00", "VENDOR 1/1", para_control="0006", para_status="0334")
    assert "000E (operating status) is not in para_status" in bench.misuse("stop")


def test_l7_mapped_values() -> None:
    bench = plugin(
        "02 35 00 00 00 14 01 00 00 07 00 00", "PPO4", para_status="dr-03 In-90 0x0700", para_control="dr-04=2"
    )
    assert bench.ok("inputs") == {"dr-03": 2.0, "In-90": 0x0100, "0700": 7}
    assert bench.out_after("output", number="dr-04", value=2.5) == "04 7E 00 00 00 19 00 00 00 00 00 00"
    assert "outside 0..600" in bench.misuse("output", number="dr-04", value=601)
    assert "not in para_control (1104)" in bench.misuse("output", number="dr-03", value=1)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"para_status": "1 2"}, "no address"),
        ({"para_status": "dr-03 dr-04 dr-06 dr-07 dr-20"}, "room for 4"),
        ({"para_control": "000A"}, "read only"),
        ({"profil": "ls"}, "did you mean profile"),
    ],
)
def test_l7_maps_are_checked_at_once(options: dict[str, object], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        DRIVE.core("pump", "PPO4", options)


def test_l7_addresses_that_are_advised_against() -> None:
    assert [notice[:12] for notice in plugin(ZERO + S2 + " 00" * 8, "PPO2").notices()] == [
        "address 0005",
        "address 000A",
    ]
    assert not plugin(ZERO + S2, "PPO1").notices()
    bench = plugin(ZERO + S2, "PPO1")
    for number in ("0x0381", 0x0015):
        bench.order("read", number=number)
    bench.run(2)
    assert [notice[:12] for notice in bench.notices()] == ["address 0381", "address 0015"]


def test_l7_write_map_on_the_wire() -> None:
    """COM-31.. and COM-30, COM-51.. and COM-50, then COM-94 = 1; then all is read back."""
    bench = plugin(ZERO + S2 + " 00" * 8, "PPO2", para_status="000E", para_control="dr-04=2")
    token = bench.order("write_map", inputs="dr-03 In-90", outputs="")
    sent = []
    stored: dict[str, str] = {}
    for _ in range(120):
        out = bench.out()[:23]
        if not out.startswith("00"):
            if out not in sent:
                sent.append(out)
            if out[0] == "2":
                stored[out[1:8]] = out[12:]
            bench.see(f"1{out[1:12]}{stored[out[1:8]]} {S2}" + " 00" * 8)
        else:
            bench.see(ZERO + S2 + " 00" * 8)
    assert sent == [
        "20 17 1F 00 00 00 11 03",
        "20 17 20 00 00 00 15 5A",
        "20 17 1E 00 00 00 00 02",
        "20 17 33 00 00 00 00 00",
        "20 17 32 00 00 00 00 01",
        "20 17 5E 00 00 00 00 01",
        "10 17 32 00 00 00 00 00",
        "10 17 33 00 00 00 00 00",
        "10 17 1E 00 00 00 00 00",
        "10 17 1F 00 00 00 00 00",
        "10 17 20 00 00 00 00 00",
    ]
    assert bench.value(token) == {"inputs": "1103 155A", "outputs": ""}
    assert "room for 4" in bench.misuse("write_map", inputs="dr-03 " * 5)
    assert "no address" in bench.misuse("write_map", inputs="speed")
    bench = plugin()
    assert "PPO3 has no parameter channel" in bench.misuse("write_map", inputs="dr-03")


# -- parameters ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("args", "order", "reply", "value"),
    [
        ({"number": 965}, "13 C5 00 00 00 00 00 00", "13 C5 00 00 00 00 03 28", 0x0328),
        ({"number": 964, "index": 1}, "63 C4 01 00 00 00 00 00", "43 C4 01 00 00 00 00 01", 1),
        ({"number": 0x1101}, "10 11 01 00 00 00 00 00", "10 11 01 00 00 00 00 05", 5),
        ({"number": "0h1101"}, "10 11 01 00 00 00 00 00", "10 11 01 00 00 00 00 05", 5),
        ({"number": "dr-03"}, "10 11 03 00 00 00 00 00", "10 11 03 00 00 00 00 0F", 1.5),
        ({"number": "0x03C5"}, "10 03 C5 00 00 00 00 00", "10 03 C5 00 00 00 00 01", 1),
        ({"number": "fault_counter"}, "13 B0 00 00 00 00 00 00", "13 B0 00 00 00 00 00 02", 2),
        ({"number": 0x0316}, "10 03 16 00 00 00 00 00", "10 03 16 00 00 00 00 02", 2),
    ],
)
def test_l6_reads(args: dict[str, object], order: str, reply: str, value: float) -> None:
    bench = plugin(ZERO + S2, "PPO1")
    token = bench.order_and_run(1, "read", **args)
    assert bench.out() == f"{order} 04 7E 00 00"
    assert bench.value(token, f"{reply} {S2}", 2) == value


def test_l6_writes_and_errors() -> None:
    bench = plugin(ZERO + S2, "PPO1")
    token = bench.order_and_run(1, "write", number="dr-03", value=5.0)
    assert bench.out().startswith("20 11 03 00 00 00 00 32")
    bench.see(f"70 11 03 00 00 00 00 11 {S2}", 2)
    assert "not in this operating mode" in bench.text(token)
    assert bench.done(token)["number"] == 0x11
    bench.see(ZERO + S2, 2)
    token = bench.order_and_run(2, "write", number="dr-03", value=5.0)
    bench.see(f"80 11 03 00 00 00 00 00 {S2}", 2)
    assert "no control over the parameters" in bench.text(token)


@pytest.mark.parametrize(
    ("op", "args", "message"),
    [
        ("read", {"number": "Q-26"}, "neither a code such as dr-03"),
        ("read", {"number": "dr-03", "index": 1}, "dr-03 has no index"),
        ("read", {"number": 965, "index": 1}, "it has no index"),
        ("read", {"number": 947, "index": 64}, r"indexes are 0..63"),
        ("read", {"number": 0x10000}, "1..65535"),
        ("write", {"number": "dr-03", "value": 1, "ram": True}, "RAM"),
        ("write", {"number": "dr-03", "value": 601}, "0..600"),
        ("write", {"number": 965, "value": 1}, "read only"),
    ],
)
def test_misuse_of_parameters(op: str, args: dict[str, object], message: str) -> None:
    bench = plugin(ZERO + S2, "PPO1")
    assert message in bench.misuse(op, **args)
