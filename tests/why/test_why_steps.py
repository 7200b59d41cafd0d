"""Steps in words to the octet: the refusals that matter, hostile texts, 60 columns, and no evidence that raises."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from property_kit import examples

from dpstack.dp.master.bring_ups import BringUp, History, Loss, Step
from dpstack.dp.master.events import Fault, FaultKind, SlaveState
from dpstack.dp.master.scanner import Found
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave_params import SlaveParams
from dpstack.fdl.interface import StationStats
from dpstack.fdl.telegram import StationType
from dpstack.gsd.configuration import configure
from dpstack.gsd.parser import load_gsd
from dpstack.why.causes import Cause
from dpstack.why.evidence import Evidence, LineCounters, Neighbour, Ring
from dpstack.why.steps import refused_by, words
from dpstack.why.story import Likely, Story, story_lines, tell

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
DOCS = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "why.md"
SETUP = SlaveParams(address=8, name="valves", ident=0x1234, config=b"\x20\x10", user_prm=b"\x00\x07")
EMPTY = Evidence(
    setup=SETUP, state=SlaveState.OFFLINE, ring=Ring(own=2), line=LineCounters(baud=500_000, slot_bits=200)
)  # fmt: skip


def diag(octets: str, *, t: int = 1) -> Step:
    return Step(t, "Slave_Diag", b"", "DL", bytes.fromhex(octets), last_ns=t)


def story_of(**facts: Any) -> Story:
    """The story of evidence that has nothing but ``facts``."""
    return tell(dataclasses.replace(EMPTY, **facts))


def tried(step: Step) -> History:
    """A bring-up that ended with ``step``."""
    return History((BringUp((step,)),))


SILENT = tried(Step(1, "Slave_Diag", b"", "nothing", times=40))


def first(*steps: Step, **more: Any) -> tuple[str, float]:
    """The first cause after a bring-up of ``steps``."""
    given = {"state": SlaveState.FAULT, **more}
    history = given.pop("history", History((BringUp(steps),), idents=(0x1234,)))
    story = story_of(history=history, **given)
    return story.first.cause, story.first.confidence


PRM = Step(2, "Set_Prm", bytes.fromhex("88 01 14 0B 12 34 00 00 07"), "SC")
CFG = Step(3, "Chk_Cfg", b"\x20\x10", "SC")
#: a bring-up until the diagnosis that tells how it went
TRIED = (diag("02 05 00 FF 12 34"), PRM, CFG)


@pytest.mark.parametrize(
    ("step", "by", "said"),
    [
        (diag("42 05 00 FF 12 34"), "octet 1 bit 6: Prm_Fault", "refuses the parameters (octet 1 bit 6, Prm_Fault)"),
        (diag("06 05 00 02 12 34"), "octet 1 bit 2: Cfg_Fault", "(octet 1 bit 2, Cfg_Fault)"),
        (diag("12 05 00 FF 12 34"), "octet 1 bit 4: Not_Supported", "(octet 1 bit 4, Not_Supported)"),
        (diag("00 0C 00 07 12 34"), "octet 4: master 7", "owned by master 7 (octet 4)"),
        (diag("02 05 00 FF 43 21"), "octets 5-6: ident 0x4321", "(octets 5-6: ident 0x4321, not 0x1234)"),
        (Step(1, "Set_Prm", b"\x88", "RS"), "status RS", "Set_Prm 88: refused with RS"),
        (Step(1, "Slave_Diag", b"", "nothing", times=9), "", "Slave_Diag: no answer (9 times)"),
        (Step(1, "Data_Exchange", b"\x00", "damaged"), "", "an answer that cannot be read"),
        (diag("00 0C 00 02 12 34"), "", "ready, watches its master"),
    ],
)
def test_refusals_to_the_octet(step: Step, by: str, said: str) -> None:
    assert refused_by(step, EMPTY) == by
    assert said in words(step, EMPTY)


@pytest.mark.parametrize(
    ("steps", "more", "cause"),
    [
        ((diag("02 05 00 FF 43 21"),), {}, "ident"),
        ((diag("00 0C 00 07 12 34"),), {}, "locked"),
        ((*TRIED, diag("06 05 00 02 12 34")), {"config": b"\x10\x20"}, "module_order"),
        ((*TRIED, diag("06 05 00 02 12 34")), {"config": b"\x20"}, "module_missing"),
        ((*TRIED, diag("06 05 00 02 12 34")), {"config": b"\x20\x10\x10"}, "module_extra"),
        ((*TRIED, diag("06 05 00 02 12 34")), {"config": b"\x21\x10"}, "module_type"),
        ((*TRIED, diag("42 05 00 FF 12 34")), {}, "user_parameter"),
        ((*TRIED, diag("42 05 00 FF 12 34")), {"expected_prm": b"\x00\x07\x00"}, "user_parameter_length"),
        ((*TRIED, diag("12 05 00 FF 12 34")), {}, "not_supported"),
        (
            (*TRIED, diag("02 0C 00 02 12 34", t=4)),
            {"now_ns": 3_000_000_000, "state": SlaveState.WAIT_READY},
            "not_ready",
        ),
        ((*TRIED, diag("00 0E 00 02 12 34", t=4)), {"state": SlaveState.WAIT_READY}, "static_diagnosis"),
        (
            (Step(1, "Slave_Diag", b"", "RS"),),
            {"fault": Fault(FaultKind.REFUSED, "refuses", "")},
            "service_refused",
        ),
        ((), {"state": SlaveState.DEACTIVATED}, "deactivated"),
    ],
)
def test_refusals_name_their_cause(steps: tuple[Step, ...], more: dict[str, Any], cause: str) -> None:
    assert first(*steps, **more)[0] == cause


TERMINAL = load_gsd(EXAMPLES.joinpath("terminal.gsd").read_bytes()).device
PLUGGED = configure(TERMINAL, ["8 DO", "8 DI", "4 AI"])
SECOND = 10**9


def of_terminal(refusal: str, real: str, **more: Any) -> tuple[Likely, ...]:
    """The causes for a terminal that refuses with the diagnosis ``refusal`` and has the identifier octets ``real``."""
    octets = PLUGGED.user_prm().octets()
    setup = SlaveParams(address=8, name="io", ident=0x1234, config=PLUGGED.config, user_prm=octets, dpv1=Dpv1())
    given = {"history": History((BringUp((*TRIED, diag(refusal))),), idents=(0x1234,))} | more
    evidence = dataclasses.replace(
        EMPTY,
        setup=setup,
        state=SlaveState.FAULT,
        device=TERMINAL,
        modules=PLUGGED.modules,
        expected_prm=setup.user_prm,
        config=bytes.fromhex(real),
        **given,
    )
    return tell(evidence).causes


def test_a_module_cause_says_the_modules_to_write() -> None:
    wrong = of_terminal("06 05 00 FF 12 34", "20 20 43 43 01 02 03")[0]
    assert wrong.cause == "module_type"
    assert wrong.speaks_for[1] == "Slot 2: the configuration has 8 DI (10), the slave has 8 DO (20)."
    assert wrong.next.endswith('slot by slot; the station as it is: modules = ["8 DO", "8 DO", "4 AI"]')


def test_prm_fault_with_other_modules_is_the_modules_and_not_the_parameters() -> None:
    causes = of_terminal("42 05 00 FF 12 34", "20 43 43 01 02 03")
    assert causes[0].cause == "module_missing"
    assert all(one.confidence <= 0.5 for one in causes if one.cause == "user_parameter")
    assert "Prm_Fault" in causes[0].speaks_for[0]
    same = of_terminal("42 05 00 FF 12 34", PLUGGED.config.hex())
    assert same[0].cause == "user_parameter"


def test_restarts_before_a_refusal_do_not_hide_it() -> None:
    """A person switches a station off and on to change a module."""
    losses = tuple(Loss(t * SECOND, SECOND, "nothing", (t + 4) * SECOND, True, True) for t in (10, 60))
    causes = of_terminal(
        "06 05 00 FF 12 34",
        "20 20 43 43 01 02 03",
        history=History((BringUp((*TRIED, diag("06 05 00 FF 12 34"))),), losses, 2, 2, (0x1234,)),
    )
    assert [one.cause for one in causes] == ["module_type", "reboots"]
    assert causes[1].confidence <= 0.4


@pytest.mark.parametrize(("since_s", "cause"), [(1, "reboots"), (200, "healthy")])
def test_a_slave_that_has_run_for_long_since_its_restarts_is_healthy(since_s: int, cause: str) -> None:
    losses = tuple(Loss(t * SECOND, SECOND, "nothing", (t + 4) * SECOND, True, True) for t in (10, 60))
    data = Step(65 * SECOND, "Data_Exchange", b"\x00", "DL", b"\x00")
    up = BringUp((diag("02 05 00 FF 12 34"), PRM, CFG, data), exchanging_ns=65 * SECOND)
    now = (65 + since_s) * SECOND
    more = {"state": SlaveState.DATA_EXCHANGE, "now_ns": now, "exchanged_ns": now}
    assert first(history=History((up,), losses, 2, 3, (0x1234,)), **more)[0] == cause


def test_two_devices_in_each_others_place_have_wrong_addresses() -> None:
    there = Neighbour(20, "io", SlaveState.FAULT, 0x10D5, StationStats(requests=9, answers=9), found_ident=0x1234)
    history = History((BringUp((diag("02 05 00 FF 10 D5"),)),), idents=(0x10D5,))
    story = story_of(state=SlaveState.FAULT, history=history, neighbours=(there,), config=b"0")
    assert story.first.cause == "wrong_address"
    assert story.first.next == "exchange the addresses 8 and 20 (io)"
    assert [one.cause for one in story.causes] == ["wrong_address", "ident"]
    assert story.causes[1].confidence <= 0.6


def test_a_station_that_nobody_has_configured_is_named_where_a_slave_is_missing() -> None:
    story = story_of(history=SILENT, unknown=frozenset({22}))
    assert story.first.cause == "not_there"
    assert (
        "Address 22 answers, and no slave is configured there: has the device that address?" in story.first.speaks_for
    )
    assert story.first.next.startswith("read address 22 with `dpstack diag`")


def test_nobody_answers_is_one_group_and_an_ident_elsewhere_is_the_address() -> None:
    other = Neighbour(3, "hoist", SlaveState.DATA_EXCHANGE, 0x0696, StationStats(requests=900, answers=900))
    found = (Found(address=18, kind=StationType.SLAVE, ident=0x1234),)
    assert first(history=SILENT, neighbours=(other,), found=())[0] == "not_there"
    assert first(history=SILENT, neighbours=(other,), found=found)[0] == "wrong_address"
    gone = dataclasses.replace(other, state=SlaveState.OFFLINE, link=StationStats(requests=40, timeouts=40))
    assert first(history=SILENT, neighbours=(gone,), found=())[0] == "rate_mismatch"


def test_answers_that_the_port_dropped_as_damaged_are_noise_and_no_missing_slave() -> None:
    """FTDI marks whole packets: of a damaged answer no octet is left, and it looks like none."""
    silent = tried(Step(1, "Data_Exchange", b"\x01", "nothing"))
    link = StationStats(requests=20, answers=18, retries=2, timeouts=2)
    clean = Neighbour(3, "hoist", SlaveState.DATA_EXCHANGE, 0x0696, StationStats(requests=90, answers=90))
    line = LineCounters(baud=187_500, slot_bits=200, heard=110, bad={"uart_marked": 52, "uart_parity": 4})
    facts = dataclasses.replace(EMPTY, history=silent, link=link, neighbours=(clean,), line=line)
    story = tell(facts)
    assert story.first.cause == "noise_on_stub"
    said = "The port has dropped 52 octets with a parity or framing error: answers came, damaged."
    assert said in story.first.speaks_for
    failed = dataclasses.replace(clean, link=StationStats(requests=90, answers=86, retries=4))
    assert tell(dataclasses.replace(facts, neighbours=(failed,))).first.cause == "noise_on_segment"
    quiet = dataclasses.replace(line, bad={})
    assert tell(dataclasses.replace(facts, line=quiet)).first.cause == "not_there"


def test_another_program_at_the_port_explains_lost_slaves() -> None:
    silent = tried(Step(1, "Data_Exchange", b"\x01", "nothing", times=40))
    link = StationStats(requests=900, answers=900, timeouts=40, late=9)
    line = LineCounters(baud=187_500, slot_bits=200, heard=900, disturbed="gpsd (pid 41) has it open, too")
    facts = dataclasses.replace(EMPTY, history=silent, link=link, line=line)
    story = tell(facts)
    assert story.first.cause == "another_program"
    assert story.first.speaks_for == ("Seen at the port: gpsd (pid 41) has it open, too.",)
    assert all(one.confidence <= 0.4 for one in story.causes[1:])
    exchanging = dataclasses.replace(facts, state=SlaveState.DATA_EXCHANGE, exchanged_ns=1)
    assert "another_program" not in {one.cause for one in tell(exchanging).causes}


def test_slaves_that_fell_silent_together_are_not_said_to_answer() -> None:
    """Their counters have answers of the past, and their state says that nobody answers now."""
    counters = StationStats(requests=940, answers=900, timeouts=40)
    places = ((3, "hoist"), (5, "valves"))
    others = tuple(Neighbour(n, name, SlaveState.OFFLINE, 0x0696, counters) for n, name in places)
    story = story_of(history=SILENT, link=counters, neighbours=others)
    assert story.first.cause == "all_silent"
    assert "All 3 slaves of the configuration are silent at once." in story.first.speaks_for
    assert story.first.next.startswith("look at all that the slaves share: the cable")
    assert not any("Others answer" in said for one in story.causes for said in one.speaks_for)
    never = story_of(history=SILENT, neighbours=others)
    rate = next(one for one in never.causes if one.cause == "rate_mismatch")
    assert rate.confidence < never.first.confidence
    assert "hoist, valves answered at this rate before." in rate.against
    one_back = (dataclasses.replace(others[0], state=SlaveState.DATA_EXCHANGE), others[1])
    story = story_of(history=SILENT, link=counters, neighbours=one_back)
    assert "Others answer at this rate: hoist." in story.first.speaks_for


def test_hostile_texts_are_printable_and_60_columns_are_kept() -> None:
    name = "v\x1b[31m\u202e<script>" + "x" * 200
    setup = structs.replace(SETUP, name=name)
    evidence = dataclasses.replace(
        EMPTY,
        setup=setup,
        history=History((BringUp((diag("08 0C 00 02 43 21 05 1B 5B 33 31"),)),)),
        neighbours=(Neighbour(3, name, SlaveState.OFFLINE, 0x1234),),
    )
    story = tell(evidence)
    lines = story.lines(60)
    assert all(line.isprintable() for line in lines)
    assert max(map(len, lines)) <= 60
    assert story_lines(story.as_dict(), 60) == lines


def test_every_cause_is_in_the_page() -> None:
    page = DOCS.read_text(encoding="utf-8")
    missing = [
        cause.word
        for cause in Cause
        if f"| `{cause.word}` | {cause.about.meaning} | {cause.about.told} | {cause.about.next} |" not in page
    ]
    assert missing == []


ANSWERS = st.sampled_from(("SC", "DL", "DH", "RS", "RR", "UE", "nothing", "damaged", "wrong", "status 7"))
SERVICES = st.sampled_from(("Slave_Diag", "Set_Prm", "Chk_Cfg", "Get_Cfg", "Data_Exchange"))
OCTETS = st.binary(max_size=12)
TIMES = st.integers(0, 10**11)
COUNTS = st.integers(0, 10**6)
STEPS = st.builds(Step, TIMES, SERVICES, OCTETS, ANSWERS, OCTETS, st.integers(1, 99), TIMES)
LOSSES = st.builds(Loss, TIMES, TIMES, ANSWERS, TIMES, st.booleans(), st.booleans())
STATS = st.builds(
    StationStats, COUNTS, COUNTS, COUNTS, COUNTS, COUNTS, COUNTS, COUNTS, st.dictionaries(st.text(max_size=4), COUNTS)
)
HISTORIES = st.builds(
    History,
    st.lists(st.builds(BringUp, st.lists(STEPS, max_size=6).map(tuple), COUNTS, TIMES), max_size=2).map(tuple),
    st.lists(LOSSES, max_size=3).map(tuple),
    COUNTS,
    COUNTS,
    st.lists(st.integers(0, 0xFFFF), max_size=4).map(tuple),
)
STATES = st.sampled_from(tuple(SlaveState))
FAULTS = st.none() | st.builds(Fault, st.sampled_from(tuple(FaultKind)), st.text(max_size=9), st.text(max_size=9))
IDENTS = st.none() | st.integers(0, 9)
KINDS = st.sampled_from(tuple(StationType))
FOUND = st.builds(Found, address=st.integers(0, 126), kind=KINDS, ident=IDENTS)
NEIGHBOURS = st.builds(Neighbour, st.integers(0, 125), st.text(max_size=4), STATES, IDENTS, STATS, IDENTS)
EVIDENCE = st.builds(
    Evidence,
    setup=st.just(SETUP),
    state=STATES,
    ring=st.builds(
        Ring,
        own=st.integers(0, 125),
        joined=st.booleans(),
        masters=st.frozensets(st.integers(0, 125), max_size=3),
        collision=st.text(max_size=5),
        refused=st.text(max_size=5),
        tokens=COUNTS,
        tokens_lost=COUNTS,
    ),
    line=st.builds(
        LineCounters,
        baud=st.sampled_from((9600, 500_000)),
        slot_bits=st.integers(37, 16_383),
        heard=COUNTS,
        bad=st.dictionaries(st.text(max_size=3), COUNTS),
        longest_ns=TIMES,
        planned_ns=TIMES,
    ),
    source=st.sampled_from(("run", "class2")),
    now_ns=TIMES,
    fault=FAULTS,
    history=HISTORIES,
    link=STATS,
    neighbours=st.lists(NEIGHBOURS, max_size=3).map(tuple),
    watchdog_ns=TIMES,
    expected_prm=st.none() | OCTETS,
    config=st.none() | OCTETS,
    found=st.none() | st.lists(FOUND, max_size=3).map(tuple),
    asked=st.lists(STEPS, max_size=2).map(tuple),
    read_only=st.booleans(),
    unknown=st.frozensets(st.integers(0, 126), max_size=3),
)


@examples(5, soak=200)
@given(EVIDENCE)
def test_any_evidence_gives_a_story(evidence: Evidence) -> None:
    story = tell(evidence)
    assert story.causes
    words = {cause.word for cause in Cause}
    assert all(0 < one.confidence <= 1 and one.next and one.cause in words for one in story.causes)
    confidences = [one.confidence for one in story.causes]
    assert confidences == sorted(confidences, reverse=True)
    assert all(line.isprintable() and len(line) <= 60 for line in story.lines(60))
