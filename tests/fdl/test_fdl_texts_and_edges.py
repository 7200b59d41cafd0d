"""Values and names that the link layer shows, limits of the codec, and edges of the search for the baud rate."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Struct

from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.active.las_gap import Announced, Gap
from dpstack.fdl.active.states import TABLE
from dpstack.fdl.baud_search import AutoBaud, BaudFound, BaudNotFound, Confidence, Evidence, Missing
from dpstack.fdl.codec import claimed, encode, encode_sd1, encode_sd2, encode_token
from dpstack.fdl.events import le3_notice
from dpstack.fdl.interface import DecoderStats, Failure, LinkStats, Request, StationStats
from dpstack.fdl.passive.station import PassiveStats
from dpstack.fdl.service_names import request_name, service
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, StationType, Telegram, token
from dpstack.machine import LineDown, LineUp, RateRefused
from dpstack.params import BusParams
from dpstack.trace import Severity
from dpstack.units import NEVER

MS = 1_000_000
S = 1_000_000_000


def test_values_that_reports_show() -> None:
    assert [each.value for each in Confidence] == ["checked", "token"]
    assert [each.value for each in Missing] == ["silence", "noise"]
    assert le3_notice("fdl", 7, 33).t_ns == 33
    assert le3_notice("fdl", 7, 1).severity is Severity.WARNING
    assert [each.value for each in Failure] == [
        "no answer",
        "garbled answer",
        "wrong answer",
        "abandoned",
        "refused by this station's guard",
        "held back",
    ]
    assert [each.text for each in StationType] == ["slave", "master not ready", "master ready", "master in ring"]
    assert StationStats(requests=1, retries=2, answers=4, late=8, wrong=16, early=32, timeouts=64).telegrams == 31


@pytest.mark.parametrize("made", [StationStats, LinkStats, DecoderStats, PassiveStats])
def test_counters_begin_at_zero(made: type[Struct]) -> None:
    stats = made()
    names = stats.__struct_fields__
    assert {getattr(stats, name) for name in names if name not in ("bad", "stations")} <= {0, frozenset()}
    assert all(type(getattr(stats, name)) in (int, dict, frozenset) for name in names)


def test_every_row_of_the_state_table_is_on_its_page() -> None:
    page = (Path(__file__).parents[2] / "docs" / "reference" / "fdl-states.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines() if line[:1] == "|"]
    texts = {cell for row in rows for cell in row}
    assert {row.does for row in TABLE} <= texts
    assert {row.source for row in TABLE} <= texts | {"rule"}
    assert all(re.fullmatch(r"(idle|hold|exchange|poll|passing)\.[a-z_]+", row.handler) for row in TABLE)


# --- names of services -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("dsap", "ssap", "name"),
    [
        (None, None, "Data_Exchange"),
        (None, 62, "SAP none/62"),
        (49, 50, "MS2 resource manager"),
        (50, 51, "MS1 alarm"),
        (51, 51, "MS1"),
        (53, 62, "Ext_User_Prm"),
        (54, 54, "master-master"),
        (55, 62, "Set_Slave_Add"),
        (56, 62, "RD_Inp"),
        (57, 62, "RD_Outp"),
        (58, 62, "Global_Control"),
        (59, 62, "Get_Cfg"),
        (60, 62, "Slave_Diag"),
        (61, 62, "Set_Prm"),
        (62, 62, "Chk_Cfg"),
        (48, 50, "MS2 connection 48"),
        (0, 50, "MS2 connection 0"),
        (48, 62, "SAP 48"),
        (52, 50, "SAP 52"),
        (63, 62, "SAP 63"),
        (0, 62, "SAP 0"),
        (None, 0, "SAP none/0"),
        (63, None, "SAP 63"),
    ],
)
def test_the_service_of_a_pair_of_saps(dsap: int | None, ssap: int | None, name: str) -> None:
    assert request_name(Request(3, Req.SRD_HIGH, b"\x01", dsap, ssap)) == name
    assert service(Telegram(Kind.SD2, 3, 2, 0x4D, dsap, ssap, b"\x01")) == name
    assert service(Telegram(Kind.SD2, 2, 3, 0x08, ssap, dsap, b"\x01")) == name


@pytest.mark.parametrize(
    ("telegram", "name"),
    [
        (SHORT_ACK, "SC"),
        (token(2, 3), "token"),
        (Telegram(Kind.SD1, 2, 3, 0x40), "Time_Event"),
        (Telegram(Kind.SD2, 2, 3, 0xC0, data=b"\x00"), "Clock_Value"),
        (Telegram(Kind.SD1, 2, 3, 0x47), "MSRD"),
        (Telegram(Kind.SD1, 2, 3, 0x49), "FDL_Status"),
        (Telegram(Kind.SD1, 2, 3, 0x4E), "Ident"),
        (Telegram(Kind.SD1, 2, 3, 0x4F), "LSAP_Status"),
        (Telegram(Kind.SD1, 2, 3, 0x00), "acknowledgement"),
        (Telegram(Kind.SD2, 2, 3, 0x08, data=b"\x00"), "Data_Exchange"),
        (Telegram(Kind.SD2, 2, 3, 0x08, 62, None), "SAP none/62"),
    ],
)
def test_the_service_of_a_telegram(telegram: Telegram, name: str) -> None:
    assert service(telegram) == name


# --- limits of the codec ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: encode_sd1(128, 2, 0), "DA 128, SA 2, FC 0: must be 0..127, 0..126 and 0..255"),
        (lambda: encode_sd2(3, 127, 0, b"x"), "DA 3, SA 127, FC 0: must be 0..127, 0..126 and 0..255"),
        (lambda: encode_sd2(3, 2, 256, b"x"), "DA 3, SA 2, FC 256: must be 0..127, 0..126 and 0..255"),
        (lambda: encode_token(127, 2), "token from 2 to 127: both addresses must be 0..126"),
        (lambda: encode_token(2, -1), "token from -1 to 2: both addresses must be 0..126"),
        (lambda: encode_sd2(3, 2, 0), "an SD2 telegram without a data unit (LE = 3) is never sent: use SD1"),
        (lambda: encode_sd2(3, 2, 0, bytes(247)), "LE = 250: the data unit has 247 octets, 246 fit"),
        (lambda: encode_sd2(3, 2, 0, bytes(245), 1, 2), "LE = 250: the data unit has 247 octets, 246 fit"),
        (lambda: encode_sd2(3, 2, 0, b"x", 64), "SAP 64: must be 0..63"),
        (lambda: encode_sd2(3, 2, 0, b"x", None, -1), "SAP -1: must be 0..63"),
        (
            lambda: encode(Telegram(Kind.SD2, 3, 2, 0, data=b"x", dseg=64)),
            "region/segment address 64: must be 0..63",
        ),
        (lambda: encode(Telegram(Kind.SD1, 3, 2, 0, data=b"x")), "an SD1 telegram carries no data unit: use SD2"),
        (lambda: encode(Telegram(Kind.SD1, 3, 2, 0, sseg=1)), "an SD1 telegram carries no data unit: use SD2"),
        (lambda: encode(Telegram(Kind.SD3, 3, 2, 0)), "SD3 telegrams are accepted but never sent: use SD2"),
    ],
)
def test_the_codec_refuses_values_out_of_range(call: Callable[[], bytes], message: str) -> None:
    with pytest.raises(ValueError) as refused:
        call()
    assert str(refused.value) == message


def test_the_last_values_that_fit() -> None:
    assert encode_token(126, 126) == b"\xdc\x7e\x7e"
    assert encode_sd1(127, 126, 255) == bytes((0x10, 127, 126, 255, (127 + 126 + 255) & 255, 0x16))
    assert encode_sd2(0, 0, 0, b"\x01", 63, 0) == b"\x68\x06\x06\x68\x80\x80\x00\x3f\x00\x01\x40\x16"
    assert encode(Telegram(Kind.SD2, 3, 2, 8, 5, None, b"\x01", 63, 0)) == bytes.fromhex(
        "68 07 07 68 83 82 08 FF 05 40 01 52 16"
    )


@given(st.sampled_from([0x68, 0x68, 0x68, 0x10, 0xA2, 0xDC, 0xE5, 0x00]), st.binary(max_size=5), st.binary(max_size=3))
def test_the_length_that_a_frame_claims(start: int, rest: bytes, before: bytes) -> None:
    """Of two different LE the longer one counts, both within 3..249."""
    octets = bytes((start,)) + rest
    fixed = {0x10: 6, 0xA2: 14, 0xDC: 3}
    if octets[0] != 0x68:
        size = fixed.get(octets[0], 1)
    elif len(octets) == 1:
        size = 2
    else:
        size = min(249, max(3, *octets[1:3])) + 6
    assert claimed(before + octets, len(before), len(before) + len(octets)) == size


# --- the search for the baud rate ------------------------------------------------------------------------------------
CHECKED = bytes.fromhex("10 02 63 49 AE 16")


def evidence(*telegrams: bytes) -> Evidence:
    found = Evidence(1_000_000)
    for octets in telegrams:
        found.receive(octets, 5)
    return found


@pytest.mark.parametrize(
    ("telegrams", "nearly", "confidence", "run"),
    [
        ((), False, None, 0),
        ((b"\xdc\x02\x02",), False, None, 1),
        ((b"\xdc\x02\x02",) * 2, True, None, 2),
        ((b"\xdc\x02\x02",) * 3, True, Confidence.TOKEN, 3),
        ((b"\xdc\x05\x02", b"\xdc\x02\x05"), True, None, 2),
        ((b"\xdc\x05\x02", b"\xdc\x02\x05", b"\xdc\x05\x02", b"\xdc\x02\x05"), True, None, 4),
        ((b"\xdc\x05\x02", b"\xdc\x09\x07"), False, None, 1),  # from a station that had no token
        ((b"\xdc\x05\x02", b"\xdc\x09\x02"), True, None, 2),
        ((CHECKED,), True, None, 1),
        ((CHECKED, CHECKED), True, Confidence.CHECKED, 2),
        ((CHECKED, b"\xe5"), True, None, 2),
        ((b"\xe5", CHECKED), True, None, 2),
        ((CHECKED, b"\xe5", b"\xe5"), False, None, 1),
        ((CHECKED, b"\x00", CHECKED), True, None, 1),
    ],
)
def test_evidence(telegrams: tuple[bytes, ...], nearly: bool, confidence: Confidence | None, run: int) -> None:
    found = evidence(*telegrams)
    assert (found.nearly_recognised, found.confidence, found.run) == (nearly, confidence, run)
    assert found.octets == sum(map(len, telegrams))


def test_octets_of_no_telegram_count_until_the_next_one() -> None:
    found = evidence(bytes(7))
    assert found.unassigned == 7
    found.receive(bytes(3), 6)
    assert found.unassigned == 10
    found.receive(CHECKED, 6)
    assert found.unassigned == 0
    found.receive(b"\x68", 7)
    assert found.stall_at() == 7 + 1_000_000
    found.wake(7 + 999_999)
    assert found.unassigned == 0
    found.wake(7 + 1_000_000)
    assert found.unassigned == 1
    found.receive(b"\x68", 8)
    found.telegram(token(2, 5), 9)
    assert (found.unassigned, found.run, found.stall_at()) == (0, 1, NEVER)
    assert found.octets == 7 + 3 + 6 + 1 + 1 + 1


@pytest.mark.parametrize("rates", [(), (500_001,), (500_000, 1)])
def test_rates_that_are_none(rates: tuple[int, ...]) -> None:
    with pytest.raises(ConfigError) as refused:
        AutoBaud(0, rates=rates)
    assert str(refused.value).startswith(f"rates {list(rates)}: give some of 9600, 19200, ")


def test_whole_telegrams_and_the_time_of_the_result() -> None:
    search = AutoBaud(100, rates=(9_600, 500_000, 500_000))
    assert (search.baud, search.tried) == (500_000, 1)
    search.telegram(Telegram(Kind.SD1, 3, 2, 0x49), 200)
    search.telegram(Telegram(Kind.SD1, 3, 2, 0x49), 350)
    assert search.result == BaudFound(
        t_ns=350, baud=500_000, listened_ns=250, confidence=Confidence.CHECKED, telegrams=2, tried=1
    )
    assert search.take_events() == [search.result]
    assert search.take_events() == []
    assert search.wake_at() == NEVER
    search.telegram(Telegram(Kind.SD1, 3, 2, 0x49), 400)
    search.wake(10**15)
    assert search.take_events() == []


def dwell(baud: int, factor: int = 1) -> int:
    return (12_000 * factor * S + baud // 2) // baud


def test_the_dwells_of_the_sweeps() -> None:
    """12 000 bits in the first sweep, then up to four times as many; the port's slack and settling come on top."""
    search = AutoBaud(0, rates=(9_600, 500_000), slack_ns=3 * MS, settle_ns=2 * MS)
    now, seen = 0, []
    for _ in range(12):
        at = search.wake_at()
        seen.append((search.baud, at - now - 5 * MS))
        now = at
        search.wake(now)
    factors = [(n // 3) + 1 for n in range(1, 13)]  # by the number of dwells
    expected = []
    for n, factor in enumerate(factors):
        baud = 9_600 if n % 2 else 500_000
        expected.append((baud, dwell(baud, min(factor, 4))))
    assert seen == expected


def test_octets_before_the_port_has_settled_do_not_count() -> None:
    search = AutoBaud(0, rates=(500_000,), settle_ns=1_000, silence_ns=5_000)
    search.receive(CHECKED * 2, 999)
    assert search.take_events() == []
    search.receive(CHECKED, 1_000)
    assert search.wake_at() == 6_000  # the silence counts from here
    search.receive(CHECKED, 1_001)
    assert search.result is not None


def test_three_hundred_left_over_octets_end_a_dwell() -> None:
    search = AutoBaud(0, rates=(9_600, 500_000))
    search.receive(bytes(299), 10)
    assert search.baud == 500_000
    search.receive(bytes(1), 20)
    assert (search.baud, search.tried) == (9_600, 2)
    assert search.in_vain(30) == BaudNotFound(
        t_ns=30, why=Missing.NOISE, listened_ns=30, octets=300, slowest=9_600, complete=True
    )


@pytest.mark.parametrize(("rates", "complete"), [((500_000,), True), ((9_600, 500_000), False)])
def test_the_end_of_a_search_in_silence(rates: tuple[int, ...], complete: bool) -> None:
    search = AutoBaud(7, rates=rates, silence_ns=1_000, limit_ns=5_000)
    assert search.wake_at() == 1_007
    search.receive(b"\x00", 907)
    assert search.wake_at() == 1_907
    search.wake(1_906)
    assert search.take_events() == []
    search.wake(1_907)
    assert search.result == BaudNotFound(
        t_ns=1_907, why=Missing.NOISE, listened_ns=1_900, octets=1, slowest=500_000, complete=complete
    )
    other = AutoBaud(7, rates=rates, silence_ns=10_000, limit_ns=5_000)
    other.wake(5_006)
    assert other.take_events() == []
    other.wake(5_007)
    assert isinstance(other.result, BaudNotFound)
    assert other.result.why is Missing.SILENCE


def test_orders_to_a_search() -> None:
    search = AutoBaud(0, rates=(9_600, 187_500, 500_000))
    for order in (LineDown("x"), LineUp()):
        search.command(order, 50)
        assert (search.baud, search.tried, search.wake_at()) == (500_000, 1, 50 + dwell(500_000))
    search.command(RateRefused("x"), 60)
    assert (search.baud, search.tried) == (187_500, 1)
    search.refused(70)
    assert search.baud == 9_600
    with pytest.raises(ConfigError) as refused:
        search.refused(80)
    assert str(refused.value) == "the port knows none of the rates asked for, not even 9.6 kbit/s"
    with pytest.raises(UsageError) as unknown:
        search.command("order", 90)
    assert str(unknown.value) == "a search for the baud rate knows no str"


# --- masters and the GAP ---------------------------------------------------------------------------------------------
def test_a_master_left_only_by_two_tokens_of_the_same_sender() -> None:
    announced = Announced(DecoderStats())
    for master in (4, 7, 9):
        announced.certain(master, True)
    for sender, members, news in (
        (4, {4, 9}, []),  # 7 is missing, 4 says so
        (9, {4, 9}, []),
        (4, {4}, [(7, False)]),  # the second time; 9 is missing for the first time
        (9, {4}, []),
        (4, {4}, [(9, False)]),
    ):
        assert announced.token(sender, frozenset(members)) == news


def test_a_gap_begins_without_anything_known() -> None:
    gap = Gap(BusParams.preset(500_000, address=2, hsa=4, gap=1))
    assert (gap.enabled, gap.skipped, gap.stations) == (True, 0, {})
    gap.skipped = 5
    assert gap.due(2, 0) == 3
    assert not gap.polled(3, None)
    assert gap.skipped == 0
    gap.skipped = 5
    gap.passed(4)
    assert (gap.skipped, gap.due(2, 0)) == (0, 0)
    assert gap.polled(0, StationType.SLAVE)
    assert not gap.polled(0, StationType.SLAVE)
    assert gap.polled(0, StationType.MASTER_READY)
    gap.forget(0)
    gap.forget(0)
    assert not gap.polled(0, None)
