"""Parameters by 16-bit index with a handshake bit: SEW's MOVILINK, each end against octets.

Management octet (SEW, page "Management byte" of manual 31960413; MOVI-PLC basic DHP11B p53): bits 0-3 service (1 read,
2 write, 3 write volatile), bits 4-5 length (3: four octets), bit 6 handshake, bit 7 an error. Index 8300 (206Ch) is
the firmware; error 08h 00h 00h 15h is a value that is too large (page "Additional code"). KEB's manual judges the same
class in tests/drives/test_keb_channel.py.
"""

from __future__ import annotations

import pytest
from acyclic_kit import octets
from drive_bench import PluginBench
from profidrive_kit import DRIVE, NO_REPLY, PPO1, READY, Core, Device, over_pkw

from dpstack.profile import DIALECTS, MOVILINK, PAGED_PKW, ParamSpec, ParamTable, ParamType
from dpstack.profile.core_description import describe_core

TABLE = ParamTable(
    (
        ParamSpec(8300, "firmware", "Firmware", type=ParamType.U32, read_only=True, factory=821_0001),
        ParamSpec(8470, "ramp", "Ramp t11 up", 0, 2000, 1, type=ParamType.U32, decimals=3, unit="s"),
        ParamSpec(8489, "offset", "Offset", -100, 100, type=ParamType.I16),
    )
)


class Sew(Core):
    parameter_table = TABLE
    dialect = DIALECTS["movilink"]


class SewDevice(Device):
    parameter_table = TABLE
    dialect = MOVILINK


@pytest.fixture
def bench() -> PluginBench:
    return over_pkw(Sew)


def channel(bench: PluginBench, reply: str, rotations: int = 1) -> str:
    return bench.see(f"{reply} {READY}", rotations)[:23]


def test_a_read_and_a_write_with_the_handshake_bit(bench: PluginBench) -> None:
    token = bench.order("read", number="firmware")
    assert bench.out()[:23] == "71 00 20 6C 00 00 00 00"
    assert channel(bench, NO_REPLY.strip(), 5) == "71 00 20 6C 00 00 00 00"  # held: bit 6 is not yet ours
    channel(bench, "71 00 20 6C 00 7D 46 E1")
    assert bench.value(token) == 8_210_145
    token = bench.order("write", number=8470, value=2.5)
    assert channel(bench, "71 00 20 6C 00 7D 46 E1") == "32 00 21 16 00 00 09 C4"
    channel(bench, "32 00 21 16 00 00 09 C4")
    assert bench.value(token) == 2.5
    token = bench.order("write", number="offset", value=-2, ram=True)  # a volatile write
    assert channel(bench, "32 00 21 16 00 00 09 C4") == "73 00 21 29 FF FF FF FE"
    channel(bench, "73 00 21 29 FF FF FF FE")
    assert bench.value(token) == -2


def test_an_error_has_class_code_and_text(bench: PluginBench) -> None:
    token = bench.order_and_run(2, "write", number="ramp", value=2000)
    channel(bench, "F2 00 21 16 08 00 00 15")
    result = bench.done(token)
    assert (result["error"], result["number"]) == ("parameter", 0x08000015)
    assert result["text"] == "parameter 8470 (Ramp t11 up): error 8/0/0015, the value is too large"


def test_a_number_without_an_entry_is_the_integer_on_the_wire(bench: PluginBench) -> None:
    token = bench.order_and_run(2, "read", number=40_000)
    assert bench.out()[:23] == "71 00 9C 40 00 00 00 00"
    channel(bench, "71 00 9C 40 FF FF FF FF")
    assert bench.value(token) == -1
    assert "give the 32-bit integer on the wire" in bench.misuse("write", number=40_000, value=1.5)
    assert "parameter numbers are 1..65535" in bench.misuse("read", number=65_536)
    assert "neither data sets nor indexes" in bench.misuse("read", number=8300, index=1)


def test_the_simulated_drive_answers_in_the_same_layout() -> None:
    drive = SewDevice(DRIVE, PPO1, {}, {"offset": -2})
    for request, confirmation in (
        ("31 00 20 6C 00 00 00 00", "00 00 00 00 00 00 00 00"),  # the handshake bit has not changed
        ("71 00 20 6C 00 00 00 00", "41 00 20 6C 00 7D 46 51"),
        ("32 00 21 16 00 00 09 C4", "02 00 21 16 00 00 09 C4"),
        ("73 00 21 29 FF FF FF 9B", "C3 00 21 29 08 00 00 1D"),  # -101 is beyond its limits
        ("31 00 21 29 00 00 00 00", "01 00 21 29 FF FF FF FE"),
        ("72 00 20 6C 00 00 00 00", "C2 00 20 6C 08 00 00 12"),  # read only
        ("31 00 20 6D 00 00 00 00", "81 00 20 6D 08 00 00 10"),
        ("74 00 20 6C 00 00 00 00", "C4 00 20 6C 05 04 00 00"),  # a service that it does not have
    ):
        assert drive.channel.step(octets(request)) == octets(confirmation), request
    assert drive.store.value("ramp") == 2.5


def test_an_error_that_was_ordered_is_the_next_answer() -> None:
    drive = SewDevice(DRIVE, PPO1, {}, {})
    drive.parameter_errors = {0x08000013: "locked"}
    drive.refuse("locked")
    assert drive.channel.step(octets("71 00 20 6C 00 00 00 00")) == octets("C1 00 20 6C 08 00 00 13")


def test_the_layouts_have_names() -> None:
    assert (DIALECTS["paged"], DIALECTS["movilink"]) == (PAGED_PKW, MOVILINK)
    assert DIALECTS["plain"].most == 2047


def test_a_listener_and_the_sheet_have_its_words(bench: PluginBench) -> None:
    access = bench.core.access
    assert access is not None
    heard = access.fields(octets("72 00 21 16 00 00 09 C4"), order=True, find=bench.core.parameter)
    assert heard["text"] == "write ramp:0 = 2.5"
    heard = access.fields(octets("F2 00 21 16 08 00 00 15"), order=False, find=bench.core.parameter)
    assert heard["text"] == "write ramp:0: error 8/0/0015, the value is too large"
    assert "8/0/0015" in {one.code for one in describe_core(Sew(DRIVE, "belt", PPO1, {}), 5, "kit", {}).errors}
