"""Blocks of isochronous mode, redundancy and clock in `dpstack decode`: contents, demands, what is wrong in them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from octet_slave import frame

from dpstack.capture.transmission import Transmission
from dpstack.decode.telegram import explain
from dpstack.decode.words import describe_octets
from dpstack.dp.pdu.prm_checks import block_text, blocks_of, clock_interval_s, findings, isochronous_demand

PRM_HEAD = bytes.fromhex("89 82 5D 3D 3E 88 01 14 0B 12 34 00")
#: VPC3+S manual, figure 7-22: length 1Ch, type 4, slot, reserved, version 1, T_BASE_DP 1500, T_DP 16, T_MAPC 1,
#: T_BASE_IO 1500, T_I 1, T_O 2, T_DX 4800, T_PLL_W 12 (default), T_PLL_D 0 (default)
ISOM = "1C 04 00 00 01 000005DC 0010 01 000005DC 0001 0002 000012C0 000C 0000"
#: AUMA AC 01.2, table 36 (octets 5 and 6 in 10 ms), and VPC3+S, figure 7-27: the delay can be omitted
CLOCK = "06 08 00 00 03E8"
#: AUMA AC 01.2, p 46: PrmCmd, sequence number 3, Primary Request and Start MSAC1S, output hold time 500 ms
COMMAND = "08 02 00 18 0A 03 0032"


def fields(status: str, *blocks: str) -> dict[str, object]:
    octets = frame(PRM_HEAD + bytes.fromhex("".join((status, *blocks))))
    (one,) = explain([Transmission(octets, 0, 500_000)])
    found = one.as_dict()["fields"]
    assert isinstance(found, dict)
    return found


def words(status: str, *blocks: str) -> str:
    return describe_octets(frame(PRM_HEAD + bytes.fromhex("".join((status, *blocks)))))


def test_the_blocks_in_words() -> None:
    said = words("80 00 98", ISOM, COMMAND, CLOCK)
    assert (
        "isochronous mode: T_DP 2 ms, T_MAPC 1, T_I 125 us, T_O 250 us, T_DX 400 us, T_PLL_W 1 us, T_PLL_D 0 us" in said
    )
    assert "PrmCmd, sequence number 3: primary request, start ms1; output hold time 500 ms" in said
    assert "clock: monitored for 10 s, delay 0 s" in said
    assert "demands isochronous mode (its Set_Prm has a block of type 4 (isochronous))" in said


def test_the_blocks_as_fields() -> None:
    found = fields("80 00 98", ISOM, COMMAND)
    assert found["IsoM_Req"] is True
    assert "findings" not in found
    blocks = found["Blocks"]
    assert isinstance(blocks, list)
    assert blocks[0]["content"] == {
        "version": 1,
        "t_base_dp": 1500,
        "t_dp": 16,
        "t_mapc": 1,
        "t_base_io": 1500,
        "t_i": 1,
        "t_o": 2,
        "t_dx": 4800,
        "t_pll_w": 12,
        "t_pll_d": 0,
    }
    assert blocks[1]["content"] == {"function": 0x0A, "properties": 3, "output_hold_time": 50}


def test_what_is_wrong_is_said() -> None:
    late = ISOM.replace("000012C0", "00010000")
    assert fields("80 00 08", late)["findings"] == [
        "block of type 4 (isochronous): T_DX 5.46133 ms is longer than the DP cycle of 2000 us",
        "a block of type 4 (isochronous), but IsoM_Req (DPV1_Status_3, bit 4) is not set",
    ]
    assert fields("80 00 88", "08 02 00 1B 81 F3 0032")["findings"] == [
        "block of type 2 (prm_cmd): reserved bits 0x81 in its function",
        "block of type 2 (prm_cmd): reserved bits 0xF0 in its properties",
        "block of type 2 (prm_cmd): reserved bits 0x03 beside its sequence number",
    ]
    assert fields("80 00 88", COMMAND, COMMAND)["findings"] == ["2 blocks of type 2: one is possible"]
    assert "demands isochronous mode (IsoM_Req is set in DPV1_Status_3)" in words("80 00 10").replace("its ", "")


def test_parameters_without_blocks_have_no_more_words() -> None:
    assert words("80 00 00").endswith("(SRD high, FCV=1 FCB=0)")


_BLOCK = st.tuples(st.sampled_from((2, 3, 4, 7, 8, 0x81)), st.integers(0, 255), st.binary(max_size=28)).map(
    lambda one: bytes((4 + len(one[2]), one[0], 0, one[1])) + one[2]
)


@given(st.binary(max_size=3), st.lists(_BLOCK, max_size=3), st.binary(max_size=5))
def test_any_parameters_are_judged(status: bytes, blocks: list[bytes], rest: bytes) -> None:
    user = status + b"".join(blocks) + rest
    lines = findings(user)
    assert all(line.isprintable() for line in lines)
    demand = isochronous_demand(user)
    assert demand is None or demand[1] >= 0
    interval = clock_interval_s(user)
    assert interval is None or 0 <= interval <= 655.35
    assert all(block_text(block).isprintable() for block in blocks_of(user))
