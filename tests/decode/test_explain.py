"""Telegrams explained: recorded ones of real devices, courses made by hand, octets of all kinds."""

from __future__ import annotations

import json

import pytest
from bus_kit import SimBus
from hypothesis import given
from hypothesis import strategies as st
from recordings import IM151_PLC, WHOLE
from support import MS

import dpstack
from dpstack.capture.listener import Listener
from dpstack.capture.transmission import Transmission
from dpstack.decode.filter import parse_filter
from dpstack.decode.telegram import Explained, explain
from dpstack.errors import UsageError
from dpstack.params import BusParams
from dpstack.sim.world import World

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
