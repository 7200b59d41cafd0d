"""Telegrams explained, and in words: recorded ones of real devices, courses made by hand, literal telegrams, wire
logs, octets of all kinds."""

from __future__ import annotations

import doctest
import json

import pytest
from bus_kit import SimBus
from hypothesis import given
from hypothesis import strategies as st
from octet_slave import DL, sd2
from property_kit import examples
from recordings import IM151_PLC, WHOLE
from support import MS, present

import dpstack
import dpstack.decode.words as module
from dpstack.capture.listener import Listener
from dpstack.capture.transmission import Transmission
from dpstack.decode.filter import parse_filter
from dpstack.decode.telegram import Explained, explain
from dpstack.decode.wire_log import render
from dpstack.decode.words import describe, describe_octets
from dpstack.errors import UsageError
from dpstack.fdl.codec import decode
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import WireEntry, WireLog

pytestmark = pytest.mark.virtual_time

POLL = bytes.fromhex("68 04 04 68 03 02 5D 07 69 16")  # Data_Exchange 2 -> 3, FCV=1 FCB=0
TURNED = bytes.fromhex("68 04 04 68 03 02 7D 07 89 16")  # FCB=1
ANSWER = bytes.fromhex("68 04 04 68 02 03 08 AA B7 16")
TOKEN = bytes.fromhex("DC 02 02")
OTHER = bytes.fromhex("68 04 04 68 03 02 5D 08 6A 16")  # as POLL, with other data
FIRST = bytes.fromhex("10 03 02 6D 72 16")  # FCV=0 FCB=1
BAD_ANSWER = bytes.fromhex("68 04 04 68 02 03 08 AB B7 16")
BAD_POLL = bytes.fromhex("68 04 04 68 03 02 7D 08 89 16")
TO_FIVE = bytes.fromhex("DC 05 02")
TO_SIX = bytes.fromhex("DC 06 02")
BAUD = 500_000
OCTET_NS = 22_000


def _log(*octets: bytes, gap_ns: int = 100_000) -> list[Explained]:
    """Explained, each ``gap_ns`` after the end of the one before."""
    at, sent = 0, []
    for one in octets:
        sent.append(Transmission(one, at, BAUD))
        at += len(one) * OCTET_NS + gap_ns
    return list(explain(sent))


def _of(name: str) -> list[Explained]:
    (recording,) = (one for one in WHOLE if one.name == name)
    return list(explain(Transmission(octets) for _, octets in recording.lines))


@pytest.mark.parametrize("recording", WHOLE, ids=lambda recording: recording.name)
def test_every_recorded_telegram_is_explained_without_an_error(recording: object) -> None:
    for one in _of(recording.name):  # type: ignore[attr-defined]
        assert one.telegram is not None
        assert one.error is None
        assert one.service
        json.dumps(one.as_dict())


def test_a_recorded_bring_up_field_by_field() -> None:
    log = _of(IM151_PLC.name)
    diag, cfg, prm = log[2].fields, log[4].fields, log[5].fields
    assert diag == {"flags": ["station_not_ready", "prm_req"], "Master_Add": None, "Ident_Number": "0x80e0"}
    assert [module["identifier"] for module in cfg["Cfg_Data"]] == ["00", "10", "10"]  # type: ignore[attr-defined]
    assert prm["watchdog_ms"] == 13 * 15 * 10  # WD_Base_1ms is 0
    assert (prm["Lock_Req"], prm["Unlock_Req"], prm["Ident_Number"]) == (True, False, "0x80e0")
    assert (prm["DPV1_Enable"], prm["Fail_Safe"], prm["WD_Base_1ms"]) == (True, True, False)
    # the acknowledgements are of the services that they answer, and of the station that was asked
    assert [(log[n].service, log[n].as_dict()["from"]) for n in (6, 8)] == [("Set_Prm", 8), ("Chk_Cfg", 8)]
    assert all(one.step.remarks == () for one in log)


def test_an_answer_has_its_request_and_its_time() -> None:
    _, _, answer = _log(TOKEN, POLL, ANSWER, gap_ns=30_000)
    assert (answer.step.answer_to, answer.step.response_us) == (2, 30.0)
    assert (answer.service, answer.as_dict()["data"]) == ("Data_Exchange", "aa")


def test_without_times_there_are_no_durations() -> None:
    _, answer = explain([Transmission(POLL), Transmission(ANSWER)])
    assert (answer.step.answer_to, answer.step.response_us, answer.as_dict()["t"]) == (1, None, None)


@pytest.mark.parametrize(
    ("octets", "number", "expected"),
    [
        ((POLL, POLL), 2, {"retry_of": 1, "unanswered": 1}),
        ((POLL, ANSWER, POLL), 3, {"retry_of": None, "remarks": "the frame count bit was not turned"}),
        ((POLL, ANSWER, TURNED), 3, {"retry_of": None, "remarks": ""}),
        ((POLL, TURNED), 2, {"unanswered": 1, "remarks": "though the one before was not answered"}),
        ((POLL, TOKEN, ANSWER), 3, {"late": True, "answer_to": 1, "remarks": "when nobody waited for it"}),
        ((ANSWER,), 1, {"answer_to": None, "remarks": ""}),
        ((POLL, ANSWER, ANSWER), 3, {"answer_to": None, "remarks": "that no request before it asked for"}),
        ((bytes.fromhex("DC 05 02"), POLL), 2, {"remarks": "station 2 sends without the token, which station 5 holds"}),
        ((TOKEN, POLL, TOKEN), 3, {"unanswered": 2, "remarks": ""}),
        ((POLL, ANSWER, TURNED), 3, {"fcb_turned": True}),
        ((POLL, POLL), 2, {"fcb_turned": False}),
        ((POLL,), 1, {"fcb_turned": None}),
        ((FIRST, FIRST), 2, {"retry_of": None, "repeated_poll_of": 1, "fcb_turned": None}),
        ((POLL, OTHER), 2, {"retry_of": None, "remarks": "with the same frame count bit, though"}),
        # the token: passed again to a silent station, to the one after it, claimed, and used after it was passed on
        ((TO_FIVE, TO_FIVE), 2, {"remarks": "the token again: station 5 did not take it"}),
        ((TO_FIVE, TO_SIX), 2, {"remarks": "the token to another station: station 5 did not take it"}),
        ((TO_FIVE, bytes.fromhex("DC 04 04")), 2, {"remarks": "station 4 claims the token, which station 5 held"}),
        ((TO_FIVE, bytes.fromhex("DC 06 05"), TO_FIVE), 3, {"remarks": "station 2 sends without the token"}),
        # damaged octets: what was due may have been among them, so that nothing after them is called wrong
        ((POLL, BAD_ANSWER), 2, {"probably_answers": 1, "remarks": "probably the answer to telegram 1, as its addr"}),
        ((POLL, b"\xaa\xbb"), 2, {"probably_answers": 1, "remarks": "probably the answer to telegram 1"}),
        ((POLL, ANSWER, BAD_POLL), 3, {"probably_answers": None, "remarks": "probably a request 2 -> 3"}),
        ((POLL, BAD_ANSWER, TURNED), 3, {"unanswered": None, "fcb_turned": None, "remarks": ""}),
        ((POLL, BAD_ANSWER, POLL), 3, {"retry_of": 1, "unanswered": None, "remarks": ""}),
        ((POLL, ANSWER, BAD_POLL, POLL), 4, {"retry_of": None, "fcb_turned": None, "remarks": ""}),
        ((TO_FIVE, b"\xdc\x06", TOKEN), 3, {"remarks": ""}),
    ],
)
def test_the_course_of_a_bus(octets: tuple[bytes, ...], number: int, expected: dict[str, object]) -> None:
    course = _log(*octets)[number - 1].as_dict()["course"]
    assert isinstance(course, dict)
    remarks = "; ".join(course.pop("remarks"))
    wanted = str(expected.pop("remarks", ""))
    assert wanted in remarks
    assert bool(wanted) == bool(remarks)
    assert {key: course[key] for key in expected} == expected


@pytest.mark.parametrize(
    ("octets", "text"),
    [
        ("", "no octets"),
        ("AA BB", "no telegram: no start octet"),
        ("68 04 04 68 03 02 5D 07 6A 16", "no telegram: wrong check sequence"),
        ("68 04 04 68 03 02", "no telegram: cut off"),
        ("E5 E5", "a telegram with other octets after it"),
        ("68 06 06 68 83 82 5D 3D 3E 80 5D 16", "Set_Prm ends after 1 octet"),
    ],
)
def test_octets_that_cannot_be_read_have_a_reason(octets: str, text: str) -> None:
    (one,) = explain([Transmission(bytes.fromhex(octets))])
    assert text in one.text
    assert one.error is not None


@given(st.lists(st.one_of(st.binary(max_size=30), st.sampled_from([POLL, TURNED, ANSWER, TOKEN, b"\xe5"])), max_size=8))
def test_nothing_fails_on_any_octets(octets: list[bytes]) -> None:
    for one in explain(Transmission(sent) for sent in octets):
        json.dumps(one.as_dict())
        assert one.text


async def test_a_simulated_bus_is_in_order_and_its_times_are_those_of_the_wire() -> None:
    world = dpstack.World(keep=100_000)
    valves = dpstack.slave.SlaveDescription.simple(0x4711, inputs=2, outputs=1, name="valves", dpv1=True)
    slave = dpstack.slave.DpSlave(valves, lambda outputs, elapsed: bytes(2), im=[dpstack.Im0(order_id="V-8")])

    async with (
        dpstack.slave.serve_slave(slave, world=world, address=9),
        dpstack.open_bus(world=world, baud=BAUD, slaves=[valves.table(9)]) as bus,
    ):
        await bus.ready()
        await bus.slave("valves").im(0)
    wire = list(world.log)
    log = list(explain(Transmission(entry.octets, entry.start_ns, BAUD) for entry in wire))
    assert [one.text for one in log if one.error is not None or one.step.remarks] == []
    assert {"Set_Prm", "Chk_Cfg", "Slave_Diag", "Data_Exchange", "MS1", "token", "Global_Control"} <= {
        one.service for one in log
    }
    answers = [one for one in log if one.step.answer_to is not None]
    assert len(answers) == sum(entry.sender == "9" for entry in wire)
    for one in answers:
        request = wire[(one.step.answer_to or 0) - 1]
        assert one.step.response_us == (wire[one.number - 1].start_ns - request.end_ns) / 1000
    assert any(one.step.unanswered is not None for one in log)  # GAP polls


def test_nobody_is_accused_on_a_noisy_bus_whose_masters_keep_the_rules() -> None:
    """Two masters in a ring; the listener hears damaged octets, and says only what these probably were."""
    world = World(seed=1, referee=False)
    heard: list[Transmission] = []
    world.add(Listener(world.now, heard.append, baud=BAUD), name="listener")
    for address, slave in ((2, 20), (4, 21)):
        SimBus(world, BusParams.preset(BAUD, address=address, hsa=10), [slave], watchdog_ms=2000)
    world.run_for(200 * MS)
    world.faults.noise(1e-3)
    world.run_for(300 * MS)
    log = list(explain(heard))
    damaged = [one for one in log if one.telegram is None]
    assert len(damaged) > 20
    assert any(one.step.probably_answers is not None for one in damaged)
    assert any(one.step.retry_of is not None for one in log)
    remarks = {remark for one in log for remark in one.step.remarks}
    assert all(remark.startswith("probably ") for remark in remarks)


# --- filters ---------------------------------------------------------------------------------------------------------

LOG = (TOKEN, POLL, POLL, ANSWER, b"\xaa")


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("token", [1]),
        ("sa == 2 and da == 0x03", [2, 3]),
        ("service == data_exchange and not request", [4]),
        ("retry or error", [3, 5]),
        ("station 3 and (answer or unanswered)", [2, 4]),
        ("number >= 2 and number < 4", [2, 3]),
        ("data contains AA", [4]),
        ('octets == "DC 02 02"', [1]),
        ("length <= 3", [1, 5]),
        ("response_us > 99.5", [4]),
        ("function contains srd and kind != SD1", [2, 3]),
        ("not not token", [1]),
        ("damaged or repeated", [5]),
        ('text contains "retry of 2"', [3]),
    ],
)
def test_filters(text: str, numbers: list[int]) -> None:
    match = parse_filter(text)
    assert [one.number for one in _log(*LOG) if match(one)] == numbers


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "a condition is missing at the end (character 1 of '')"),
        ("sa = 3", "'=' means nothing here (character 4"),
        ("sa == ", "a number is missing at the end"),
        ("sa == three", "'three' is no number (character 7"),
        ("sa contains 3", "'contains' after 'sa' is no comparison: ==, !=, <"),
        ("servce == x", "'servce' is no word of a filter; do you mean 'service'?"),
        ("token token", "'token': 'and' or 'or' is wanted before it (character 7"),
        ("(token", "')' is missing at the end"),
        ("(token or)", "')' is no word of a filter"),
        ("data == 0", "'0' are no octets in hex"),
        ("kind < SD1", "'<' after 'kind' is no comparison"),
        ("not " * 60 + "token", "too deep"),
        ("__import__('os')", '"\'" means nothing here'),
        ("__import__ (os)", "'__import__' is no word"),
    ],
)
def test_a_wrong_filter_is_refused_with_its_place(text: str, error: str) -> None:
    with pytest.raises(UsageError) as refused:
        parse_filter(text)
    assert error in str(refused.value)


@given(st.text(max_size=40))
def test_no_text_does_anything_but_match_or_be_refused(text: str) -> None:
    try:
        match = parse_filter(text)
    except UsageError:
        return
    for one in _log(*LOG):
        assert match(one) in (True, False)


LINES = [
    ("68 05 05 68 82 E3 6D 3C 3E 4C 16", "Slave_Diag request 99 -> 2 (SRD high, FCV=0 FCB=1)"),
    ("68 0B 0B 68 E3 82 08 3E 3C 02 05 00 FF 0C DA D3 16", "Slave_Diag answer 2 -> 99, 6 octets (DL, slave)"),
    (
        "68 0F 0F 68 82 E3 5D 3D 3E B8 05 01 00 0C DA 01 40 00 00 22 16",
        "Set_Prm request 99 -> 2, 10 octets (SRD high, FCV=1 FCB=0)",
    ),
    ("68 06 06 68 88 82 7D 3E 3E 21 24 16", "Chk_Cfg request 2 -> 8, 1 octet (SRD high, FCV=1 FCB=1)"),
    ("10 02 63 49 AE 16", "FDL_Status request 99 -> 2 (FC 0x49)"),
    ("10 63 02 00 65 16", "acknowledgement 2 -> 99 (OK, slave)"),
    ("10 63 02 03 68 16", "acknowledgement 2 -> 99 (RS, slave)"),
    ("10 63 02 30 95 16", "acknowledgement 2 -> 99 (OK, master in ring)"),
    ("10 63 02 0F 74 16", "acknowledgement 2 -> 99 (status 15, slave)"),
    ("DC 03 02", "token 2 -> 3"),
    ("DC 02 02", "token 2 -> 2 (to itself)"),
    ("E5", "SC"),
    ("68 04 04 68 03 02 5D 11 73 16", "Data_Exchange request 2 -> 3, 1 octet (SRD high, FCV=1 FCB=0)"),
    ("10 03 02 7D 82 16", "Data_Exchange request 2 -> 3 (SRD high, FCV=1 FCB=1)"),
    ("68 04 04 68 02 03 0A 99 A8 16", "Data_Exchange answer 3 -> 2, 1 octet (DH, slave)"),
    ("68 03 03 68 02 03 08 0D 16", "acknowledgement 3 -> 2, LE = 3 (DL, slave)"),
    ("10 03 02 41 46 16", "Data_Exchange request 2 -> 3 (function 1)"),
    ("68 07 07 68 FF 82 46 3A 3E 00 00 3F 16", "Global_Control 2 -> all, Operate, all groups (SDN high)"),
    ("68 07 07 68 FF 82 46 3A 3E 02 00 41 16", "Global_Control 2 -> all, Clear, all groups (SDN high)"),
    ("68 07 07 68 FF 82 46 3A 3E 28 05 6C 16", "Global_Control 2 -> all, Operate Freeze Sync, group 1, 3 (SDN high)"),
    (
        "68 07 07 68 FF 82 46 3A 3E 55 80 14 16",
        "Global_Control 2 -> all, Operate Unfreeze Unsync reserved bits 0x41, group 8 (SDN high)",
    ),
    (
        "68 06 06 68 FF 82 46 3A 3E 00 3F 16",
        "Global_Control 2 -> all, 1 octet: cannot be read (Global_Control ends after 1 octet: octet 2 (group_select) "
        "is missing) (SDN high)",
    ),
    ("00 12", "no telegram: no start octet (10, 68, A2, DC, E5): octet 1 is 00"),
    ("68 05 05 68 82", "no telegram: cut off after 5 octets of 11"),
    ("68 05 06 68 82", "no telegram: LE and LEr differ: octets 2 and 3 are 05 and 06"),
    ("68 02 02", "no telegram: LE outside of 3..249: octet 2 is 02"),
    ("68 05 05 67", "no telegram: the second start octet is not 68: octet 4 is 67"),
    ("10 02 63 49 AE 17", "no telegram: the end octet is not 16: octet 6 is 17"),
    ("10 02 63 49 AF 16", "no telegram: wrong check sequence (FCS): octet 5 is af, the sum is ae"),
    ("68 05 05 68 82 E3 6D 3C 3E 4D 16", "no telegram: wrong check sequence (FCS): octet 10 is 4d, the sum is 4c"),
    ("E5 E5", "a telegram with other octets after it, from octet 2 on"),
    ("", "no octets"),
]


@pytest.mark.parametrize(("octets", "text"), LINES)
def test_one_line_each(octets: str, text: str) -> None:
    assert describe_octets(bytes.fromhex(octets)) == text


def test_segments_are_shown() -> None:
    text = describe(Telegram(Kind.SD2, 3, 2, 0x6D, 60, 62, dseg=1, sseg=2))
    assert text == "Slave_Diag request 2 -> 3, DSEG 1, SSEG 2 (SRD high, FCV=0 FCB=1)"


def test_the_wire_log_to_the_character() -> None:
    log = WireLog()
    log.add(WireEntry(1_000_000, 1_066_000, bytes.fromhex("DC 02 02"), "2"))
    log.add(WireEntry(1_140_000, 1_140_000 + 132_000, bytes.fromhex("10 03 02 49 4E 16"), "master"))
    log.add(WireEntry(1_294_500, 1_400_000, bytes.fromhex("10 02 03 00 05 16"), None, "too early"))
    log.add(WireEntry(1_390_000, 1_700_000, bytes(40), "3"))
    hexed = "00 " * 24 + "... 00 00 00 00 (40 octets)"
    pad = len(hexed)
    expected = [
        f"  no.       start us  gap bits  sender     {'octets':<{pad}}  telegram",
        f"    1       1000.000            2          {'dc 02 02':<{pad}}  token 2 -> 2 (to itself)",
        f"    2       1140.000        37  master     {'10 03 02 49 4e 16':<{pad}}  FDL_Status request 2 -> 3 (FC 0x49)",
        f"    3       1294.500        11  ?          {'10 02 03 00 05 16':<{pad}}  acknowledgement 3 -> 2 (OK, slave)"
        "  [too early]",
        f"    4       1390.000        -5  3          {hexed}  no telegram: no start octet (10, 68, A2, DC, E5)"
        ": octet 1 is 00",
    ]
    assert render(log, 500_000).splitlines() == expected


def test_an_empty_log_is_a_heading() -> None:
    assert render([], 500_000).split() == ["no.", "start", "us", "gap", "bits", "sender", "octets", "telegram"]


@given(st.lists(st.binary(max_size=300), max_size=5))
def test_anything_can_be_shown(parts: list[bytes]) -> None:
    entries = [WireEntry(n * 1_000, n * 1_000 + 500, octets) for n, octets in enumerate(parts)]
    assert len(render(entries, 9_600).splitlines()) == len(parts) + 1


@given(st.integers(-1, 255), st.none() | st.integers(0, 63), st.none() | st.integers(0, 63), st.binary(max_size=4))
def test_every_telegram_has_a_line(fc: int, dsap: int | None, ssap: int | None, data: bytes) -> None:
    kind = Kind.SD2 if fc >= 0 else Kind.SC
    text = describe(Telegram(kind, 3, 2, fc, dsap, ssap, data))
    assert text
    assert "\n" not in text


def test_the_example_in_the_docstring() -> None:
    assert doctest.testmod(module).failed == 0


# --- contents: DP-V1 and diagnosis ---

DIAG = "00 0C 00 02 12 34 "


def _telegram(sap: int, master: int, unit: str, *, request: bool) -> bytes:
    """Between master 2 and slave 4."""
    octets = bytes.fromhex(unit)
    return sd2(4, 2, 0x5D, sap, master, octets) if request else sd2(2, 4, DL, master, sap, octets)


@pytest.mark.parametrize(
    ("sap", "master", "way", "unit", "text"),
    [
        (51, 51, "->", "5E 01 2F F0", "Read of slot 1, index 47, up to 240"),
        (51, 51, "<-", "5E 01 2F 02 AA BB", "Read of slot 1, index 47, data 2"),
        (51, 51, "->", "5F 00 FF 04 08 00 FD E8", "Write of slot 0, index 255, data 4"),
        (51, 51, "<-", "5F 00 FF 04", "Write of slot 0, index 255, data 4"),
        (51, 51, "<-", "DE 80 B5 00", "Read refused: state conflict (80 B5 00: class access, code 5)"),
        (51, 51, "->", "5C 02 03 28", "Alarm_Ack of pull alarm, slot 2, sequence number 5"),
        (50, 51, "<-", "5C 02 03 28", "Alarm_Ack of pull alarm, slot 2, sequence number 5"),
        (51, 51, "->", "5E 01", "cannot be read (DP-V1 service ends after 2 octets"),
        (51, 51, "->", "4A", "cannot be read (octet 1: no service 0x4A)"),
        (51, 51, "<-", "5E 01 2F 05 AA", "cannot be read (Read response: octet 4 says 5 octets of data, 1 came)"),
        (
            49,
            50,
            "->",
            "57 00 00 00 00 C8 01 00 00 00 00 00 00 02 00 02 00 00 00 00",
            "Initiate, send time-out 2 s",
        ),
        (49, 50, "<-", "56 30 00 64", "server SAP 48, send time-out 1 s"),
        (48, 50, "<-", "57 F0 01 00 00 00 00 00 00 02 00 02 00 00 00 00", "Initiate, up to 240 octets of data"),
        (48, 50, "<-", "D7 80 C3 00", "Initiate refused: resource unavailable"),
        (0, 50, "->", "51 03 04 02 AA BB", "Data_Transport of slot 3, index 4, data 2"),
        (0, 50, "->", "48 01", "Idle"),
        (17, 50, "<-", "58 02 13", "Abort: nothing was heard from the other end in time (ABT_TO in a remote subnet)"),
        (17, 50, "->", "58 00 25", "Abort: its user, reason 5"),
        (
            60,
            62,
            "<-",
            DIAG + "06 01 02 29 AA BB",
            "diagnosis alarm, slot 2, appears, slot disturbed, sequence number 5",
        ),
        (60, 62, "<-", DIAG + "05 82 00 00 30 04 83 01 02", "module status: slot 3 no module; DXB link status, slot 1"),
        # of the maker, and of modules: slots count from 1, as the texts of a running bus do
        (60, 62, "<-", DIAG + "03 AA BB 42 02", "device: aa bb; slots with a diagnosis: 2"),
        (60, 62, "<-", DIAG + "09 00 46 75 73 65 20 46 31", 'device: "Fuse F1" (00 46 75 73 65 20 46 31)'),
        (60, 62, "<-", DIAG + "82 41 66", "slot 3, input channel 1 (4 bits): line break"),
        (60, 62, "<-", "00 0C", "cannot be read (Slave_Diag has 2 octets"),
        (60, 62, "->", "AA", ""),
        (61, 62, "->", "88 01 01 0B 12 34 00", ""),
        (17, 62, "->", "58 00 25", ""),  # no class 2 connection
    ],
)
def test_texts_of_telegrams(sap: int, master: int, way: str, unit: str, text: str) -> None:
    octets = _telegram(sap, master, unit, request=way == "->")
    telegram = present(decode(octets))
    count = len(bytes.fromhex(unit))
    line = describe(telegram)
    assert f", {count} octet{'s' if count > 1 else ''}{': ' if text else ' ('}{text}" in line
    assert line in render([WireEntry(0, 1_000_000, octets, "2")], 500_000)


@examples(300)
@given(st.sampled_from((0x48, 0x51, 0x56, 0x57, 0x58, 0x5C, 0x5E, 0x5F)), st.binary(max_size=30), st.booleans())
def test_there_is_a_text_for_everything(function: int, rest: bytes, request: bool) -> None:
    for first in (function, function | 0x80, function ^ 0x04):
        telegram = present(decode(sd2(4, 2, 0x5D if request else DL, 51, 51, bytes((first,)) + rest)))
        assert ": " in describe(telegram)


@examples(200)
@given(st.binary(max_size=60), st.sampled_from((0, 48, 49, 50, 51, 60)), st.booleans())
def test_any_telegram_has_a_text(unit: bytes, sap: int, request: bool) -> None:
    telegram = present(decode(_telegram(sap, 50, unit.hex(), request=request)))
    assert describe(telegram)
