"""Every way a slave can be missing, refuse, fall silent or lie, and what the master says of it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from msgspec import structs
from scripted_link import (
    DIAG_FREE,
    DIAG_LOCKED,
    DIAG_NOT_READY,
    DIAG_PRM_FAULT,
    DIAG_READY,
    DIAG_STATIC,
    MS,
    Answer,
    ScriptedSlave,
    data,
    exchanging,
    high,
    link,
    link_to,
    refuses,
    says,
    setup,
    silent,
)
from support import instance, present

from dpstack.dp.master import fault_texts
from dpstack.dp.master.events import SlaveFaulted, SlaveState
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.process.client import worded
from dpstack.fdl.events import StationFound
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Kind, StationType, Telegram
from dpstack.gsd.configuration import configure
from dpstack.gsd.parser import load_gsd

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def test_absent_slave_backs_off_is_told_once_and_the_other_goes_on() -> None:
    bus = link(setup(3), setup(4), slaves={4: ScriptedSlave()})
    bus.run_long(10_000 * MS)
    polls = [r for r in bus.requests if r.da == 3]
    # 0.1, 0.2, 0.4, 0.8, 1, 1 ... seconds
    assert 11 <= len(polls) <= 13
    assert bus.faults(3) == ["absent"]
    assert bus.state(4) is SlaveState.DATA_EXCHANGE
    assert "no answer from address 3 at 500 kbit/s" in bus.only_fault().text
    assert "check power" in bus.only_fault().text


def test_a_slave_that_answers_and_is_lost_in_its_bring_up_is_asked_again_as_soon_as_the_first_time() -> None:
    """It is there: the pause, which doubles while nobody answers, begins anew after every answer."""
    bus = link_to(answers={61: silent})
    waiting: list[int] = []

    def diagnosis(request: Request) -> Telegram | Failure:
        """The first diagnosis of a bring-up has its answer, the one after Set_Prm has none."""
        if bus.state(3) is not SlaveState.OFFLINE:
            return Failure.NO_ANSWER
        waiting.append(bus.now)
        return data(request, DIAG_FREE)

    bus.slave.answers[60] = diagnosis
    bus.run(2_000 * MS)
    pauses = [later - earlier for earlier, later in pairwise(waiting)]
    assert len(pauses) > 15
    assert all(100 * MS <= pause < 105 * MS for pause in pauses)


def test_absent_polls_keep_their_share_of_the_bus() -> None:
    bus = link(*(setup(a) for a in range(3, 20)), slaves={3: ScriptedSlave()}, absent_divisor=100)
    bus.run(20 * MS)
    bus.run_anew(2000 * MS)
    silent = sum(r.da != 3 and r.da != 127 for r in bus.requests)
    assert silent * bus.step <= 2000 * MS / 100 + 2 * bus.step


def test_wrong_ident_names_both() -> None:
    bus = link(setup(ident=0x1234))
    bus.run(5 * MS)
    assert bus.fault(3).kind.value == "wrong_ident"
    assert "0x0696 instead of 0x1234" in bus.fault(3).message
    assert not any(r.dsap == 61 for r in bus.requests)


def test_ident_ask_takes_and_tells_what_is_found() -> None:
    bus = exchanging(setup(ident=None))
    assert bus.remarks(3) == ["its ident number is 0x0696 (taken from its diagnosis)"]
    assert next(r for r in bus.requests if r.dsap == 61).data[4:6] == b"\x06\x96"


@pytest.mark.parametrize("news", ["GAP", "diagnosis"])
def test_another_device_in_place_of_a_wrong_one_is_taken_up_at_once(news: str) -> None:
    bus = link(setup(ident=0x0696), slaves={3: ScriptedSlave(free=bytes.fromhex("02 05 00 FF 43 21"))})
    bus.run_long(20_000 * MS)  # its back-off is 10 s by now
    handler = bus.master.handlers[3]
    assert bus.fault(3).kind.value == "wrong_ident"
    asked = [r for r in bus.requests if r.da == 3]
    assert len(asked) < 8
    bus.slaves[3] = ScriptedSlave()
    if news == "GAP":
        bus.send(StationFound(t_ns=bus.now, address=3, kind=None), 10 * MS)
        assert [r for r in bus.requests if r.da == 3] == asked  # nobody is there
        bus.send(StationFound(t_ns=bus.now, address=3, kind=StationType.SLAVE))
    else:  # read by a program, as a class 2 service
        handler.diagnosis_seen(bytes.fromhex("02 05 00 FF 43 21"), bus.now)
        bus.run(10 * MS)
        assert [r for r in bus.requests if r.da == 3] == asked  # it is the same device
        handler.diagnosis_seen(DIAG_FREE, bus.now)
    bus.run(10 * MS)
    assert handler.state is SlaveState.DATA_EXCHANGE


def test_slave_of_another_master_is_never_parameterised() -> None:
    bus = link_to(free=DIAG_LOCKED)
    bus.run_long(30_000 * MS)
    assert bus.faults(3) == ["locked"]
    assert not any(r.dsap in (61, 62, None) for r in bus.requests if r.da == 3)
    assert "owned by master 7" in bus.fault(3).message


@pytest.mark.parametrize(
    ("octet_2", "words"), [("0C", "wait: its watchdog is on and gives it free"), ("04", "its watchdog is off: switch")]
)
def test_slave_that_a_master_left_locked_which_is_gone(octet_2: str, words: str) -> None:
    bus = link_to(free=bytes.fromhex(f"00 {octet_2} 00 07 06 96"))
    bus.master.context.ring = lambda: {2}
    bus.run(1_000 * MS)
    fault = bus.fault(3)
    assert fault.kind.value == "locked"
    assert fault.message == "is still locked by master 7, which is not in the token ring (any more)"
    assert fault.remedy.startswith(words)
    bus.master.context.ring = lambda: {2, 7}
    bus.run_long(12_000 * MS)
    assert "owned by master 7" in bus.fault(3).message


@pytest.mark.parametrize("why", [Failure.GARBLED, Failure.WRONG])
def test_a_slave_whose_answers_cannot_be_read_is_lost_by_noise(why: Failure) -> None:
    bus = exchanging(setup(3), setup(4))
    bus.slaves[3] = ScriptedSlave(answers={None: lambda _: why, 60: lambda _: why})
    bus.run_long(5_000 * MS)
    told = bus.only_fault()
    assert told.kind.value == "lost"
    assert told.message == "its answers to Data_Exchange cannot be read any more"
    assert "noise" in told.remedy
    assert "second station" in told.remedy


def test_an_address_whose_answers_were_never_readable() -> None:
    bus = link_to(answers={60: lambda _: Failure.GARBLED})
    bus.run(1_000 * MS)
    told = bus.only_fault()
    assert told.kind.value == "absent"
    assert told.message == "address 3 answers at 500 kbit/s, but not readably"
    assert "noise" in told.remedy


def test_own_address_plus_128_is_no_other_master() -> None:
    bus = exchanging(setup(), slaves={3: ScriptedSlave(ready=bytes.fromhex("00 0C 00 82 06 96"))})
    assert bus.remarks(3) == ["its diagnosis gives the master address as 130; tolerated"]


@pytest.mark.parametrize(
    ("status", "kind", "words"),
    [
        ("42 05 00 FF 06 96", "prm_fault", "Set_Prm was 88 01 14 0b 06 96 00"),
        ("06 05 00 FF 06 96", "cfg_fault", "Chk_Cfg was 71, it has f1: octet 1 differs"),
        ("12 05 00 FF 06 96", "not_supported", "Not_Supported"),
    ],
)
def test_refusals_name_the_reason_and_are_retried_with_back_off(status: str, kind: str, words: str) -> None:
    bus = link_to(ready=bytes.fromhex(status), answers={59: says(b"\xf1")})
    bus.run(500 * MS)
    fault = bus.only_fault()
    assert fault.kind.value == kind
    assert words in fault.message
    assert fault.remedy
    bus.run_long(40_000 * MS)
    attempts = sum(r.dsap == 61 for r in bus.requests)
    assert 5 <= attempts <= 8  # after 1, 2, 4, 8, 10, 10 s
    assert bus.only_fault() is fault  # reported once
    bus.slave.ready = DIAG_READY
    bus.run_long(11_000 * MS)
    assert bus.state(3) is SlaveState.DATA_EXCHANGE


@pytest.mark.parametrize(
    ("fault", "message", "remedy"),
    [
        (
            fault_texts.cfg_fault,
            "refuses the configuration (Cfg_Fault): slot 2 has 8 DO, the configuration 8 DI; Chk_Cfg was 20 10",
            'plug 8 DI into slot 2; or, if the station is right, write modules = ["8 DO", "8 DO"]',
        ),
        (
            lambda setup: fault_texts.not_ready(setup, 10),
            "accepted parameters and configuration but is not ready after 10 s (Station_Not_Ready): slot 2 has 8 DO",
            'write modules = ["8 DO", "8 DO"]; or look at the device: it may wait for its own start-up or for modules',
        ),
    ],
)
def test_a_difference_is_named_by_the_modules_of_the_gsd_file_in_either_process(
    fault: Callable[[SlaveParams], fault_texts.CfgFault], message: str, remedy: str
) -> None:
    plugged = configure(load_gsd((EXAMPLES / "terminal.gsd").read_bytes()).device, ["8 DO", "8 DI"])
    known = SlaveParams(address=3, name="io", ident=1, config=plugged.config, texts=plugged.texts())
    there = structs.replace(known, texts=None)  # the bus process has no GSD file
    told = fault(known).compared(b"\x20\x20")
    assert message in told.message
    assert told.remedy.endswith(remedy)
    bare = fault(there).compared(b"\x20\x20")
    assert "change the telegram set in the device" in bare.remedy
    assert fault_texts.in_words(bare, known) == told
    foreign = instance(worded(SlaveFaulted(t_ns=1, address=3, name="io", fault=bare), known), SlaveFaulted)
    assert foreign.fault == told
    assert fault_texts.in_words(fault(known).compared(None), known).actual == b""


def test_fault_shown_in_one_diagnosis_only_is_kept() -> None:
    bus = link_to(ready=DIAG_PRM_FAULT)
    bus.run(2 * MS)
    bus.slave.configured, bus.slave.ready = False, DIAG_READY
    assert bus.master.handlers[3].fault is not None


@pytest.mark.parametrize("sap", [61, 62])
def test_silence_to_set_prm_or_chk_cfg_asks_the_diagnosis_first(sap: int) -> None:
    bus = link_to(answers={sap: silent})
    bus.slave.answers[60] = lambda r: data(r, DIAG_PRM_FAULT if any(q.dsap == sap for q in bus.requests) else DIAG_FREE)
    bus.run(2 * MS)
    made = [r.dsap for r in bus.requests if r.da == 3]
    assert made[made.index(sap) + 1] == 60
    assert bus.faults(3) == ["prm_fault"]


def test_silence_that_is_never_explained() -> None:
    bus = link_to(answers={61: silent})
    bus.run(500 * MS)
    assert bus.only_fault().kind.value == "refused"
    assert "does not acknowledge Set_Prm" in bus.only_fault().message


def test_lost_acknowledgement_of_set_prm_goes_on_with_chk_cfg() -> None:
    bus = link_to(answers={61: silent})

    def diagnosis(request: Request) -> Telegram:
        before_chk_cfg = DIAG_NOT_READY if any(r.dsap == 61 for r in bus.requests) else DIAG_FREE
        return data(request, DIAG_READY if bus.slave.configured else before_chk_cfg)

    bus.slave.answers[60] = diagnosis
    bus.run(5 * MS)
    assert bus.states(3) == ["set_prm", "wait_ready", "chk_cfg", "wait_ready", "data_exchange"]


#: what the slave answers to Get_Cfg, None: RS; and what the fault says of it
_GET_CFG = pytest.mark.parametrize(
    ("actual", "words", "remedy"),
    [
        (b"\xf1", "Chk_Cfg was 71, it has f1: octet 1 differs", 'configure config = "F1"'),
        (b"\x71\x11", "Chk_Cfg was 71, it has 71 11: octet 2 differs", 'configure config = "71 11"'),
        (b"\x71", "Chk_Cfg was 71, although Get_Cfg names the same", ""),
        (None, "Chk_Cfg was 71", ""),
    ],
    ids=["octet 1 differs", "one octet more", "the same", "refused"],
)


def _get_cfg(actual: bytes | None) -> dict[int | None, Answer]:
    return {59: refuses(0x03) if actual is None else says(actual)}


@_GET_CFG
def test_a_slave_that_is_never_ready_is_asked_for_its_configuration(
    actual: bytes | None, words: str, remedy: str
) -> None:
    bus = link_to(ready=DIAG_NOT_READY, answers=_get_cfg(actual))
    bus.run_long(10_500 * MS)
    told = bus.only_fault()
    assert told.kind.value == "not_ready"
    assert told.message.endswith(f"is not ready after 10 s (Station_Not_Ready): {words}")
    assert told.remedy.startswith(remedy)
    assert "it may wait for its own start-up or for modules" in told.remedy
    assert [r.dsap for r in bus.requests if r.dsap in (59, 61)] == [61, 59]  # asked once
    assert bus.states(3)[-2:] == ["wait_ready", "fault"]


@_GET_CFG
def test_a_slave_that_never_acknowledges_chk_cfg_is_asked_for_its_configuration(
    actual: bytes | None, words: str, remedy: str
) -> None:
    bus = link_to(answers={60: says(DIAG_NOT_READY), 62: silent} | _get_cfg(actual))
    bus.run(1_500 * MS)
    told = bus.only_fault()
    assert told.message == f"does not acknowledge Chk_Cfg although it answers Slave_Diag: {words}"
    assert told.remedy.startswith(remedy)


@_GET_CFG
def test_wrong_length_asks_for_the_configuration_after_safe_outputs_and_unlock(
    actual: bytes | None, words: str, remedy: str
) -> None:
    bus = exchanging(setup(), slaves={3: ScriptedSlave(answers=_get_cfg(actual))})
    bus.slave.inputs = b"\x01\x02"
    bus.run_anew(200 * MS)
    told = bus.only_fault()
    assert told.kind.value == "wrong_length"
    assert told.message == f"answers Data_Exchange with 2 octets instead of 4: {words}"
    assert told.remedy.startswith(remedy)
    assert bus.image.inputs == bytes(4)
    asked = [r.dsap for r in bus.requests if r.da == 3 and r.dsap is not None]
    assert asked == [61, 59]  # Unlock, then Get_Cfg
    assert next(r for r in bus.requests if r.dsap == 61).data[0] == 0x40
    bus.slave.inputs = bytes(4)
    bus.slave.configured = False
    bus.run(1_500 * MS)
    assert bus.state(3) is SlaveState.DATA_EXCHANGE


def test_cfg_fault_in_data_exchange_names_the_octet_that_differs() -> None:
    bus = exchanging(setup(), slaves={3: ScriptedSlave(answers=_get_cfg(b"\xf1"))})
    bus.slave.ready = bytes.fromhex("04 0C 00 02 06 96")
    bus.slave.answers[None] = high
    bus.run(200 * MS)
    assert (
        bus.only_fault().message == "refuses the configuration (Cfg_Fault): Chk_Cfg was 71, it has f1: octet 1 differs"
    )


@pytest.mark.parametrize(
    ("status", "name", "words"),
    [(0x02, "RR", "no resources"), (0x01, "UE", "its fault display"), (0x03, "RS", "although its diagnosis wants no")],
)
def test_a_slave_that_refuses_data_exchange_and_wants_no_parameters(status: int, name: str, words: str) -> None:
    bus = exchanging(setup())
    bus.slave.answers[None] = refuses(status)
    bus.run(30 * MS)
    told = bus.only_fault()
    assert told.kind.value == "refused"
    assert told.message == f"refuses Data_Exchange ({name})"
    assert words in told.remedy
    assert "watchdog" not in told.text


def test_a_slave_that_refuses_data_exchange_and_wants_parameters_has_left_it() -> None:
    bus = exchanging(setup())
    bus.slave.answers[None] = refuses(0x02)
    bus.slave.ready = bytes.fromhex("02 0D 00 FF 06 96")
    bus.run(30 * MS)
    assert bus.only_fault().message == "left data exchange by itself and wants parameters again (its watchdog was on)"


def test_prm_fault_names_the_octets_that_were_sent_and_the_other_reading() -> None:
    note = "its GSD file can be read otherwise"
    bus = link(
        setup(user_prm=bytes.fromhex("05 00 00"), fail_safe_told=True, fail_safe=True, dpv1=Dpv1(), prm_note=note),
        slaves={3: ScriptedSlave(ready=DIAG_PRM_FAULT)},
    )
    bus.run(20 * MS)
    (sent,) = {r.data.hex(" ") for r in bus.requests if r.dsap == 61}
    assert sent == "88 01 14 0b 06 96 00 c5 00 00"  # DPV1_Enable and Fail_Safe are set in the first user octet
    assert bus.fault(3).text == (
        "refuses the parameters (Prm_Fault): Set_Prm was 88 01 14 0b 06 96 00 c5 00 00; octets 5-6 are the ident, "
        f"from octet 8 the user parameters (c5 00 00): compare them with its GSD file; {note}"
    )


def test_slave_dies_and_comes_back_with_a_fresh_start() -> None:
    bus = exchanging(setup(3), setup(4))
    with bus.without(3):
        bus.run(300 * MS)
    assert bus.faults(3) == ["lost"]
    assert bus.state(4) is SlaveState.DATA_EXCHANGE
    assert not bus.image.valid
    bus.run_anew(1500 * MS)
    first = next(r for r in bus.requests if r.da == 3)
    assert (first.dsap, first.restart) == (60, False) or first.restart
    assert bus.state(3) is SlaveState.DATA_EXCHANGE


def test_slave_that_was_reset_is_taken_up_afresh() -> None:
    bus = exchanging(setup())
    bus.run(1500 * MS)
    bus.slave.configured = False
    bus.run_anew(20 * MS)
    assert bus.faults(3) == ["left"]
    made = [r for r in bus.requests if r.da == 3]
    assert [r.dsap for r in made[:5]] == [None, 60, 61, 62, 60]
    assert made[1].restart
    assert bus.state(3) is SlaveState.DATA_EXCHANGE


def test_slave_that_flaps_is_not_reinitialised_for_ever() -> None:
    slave = ScriptedSlave()

    def refuse(request: Request) -> Telegram | Failure:
        slave.configured = False
        return Telegram(Kind.SD1, 2, request.da, 0x03)

    slave.answers[None] = refuse
    bus = link(setup(), slaves={3: slave})
    bus.run_long(30_000 * MS)
    assert 4 <= sum(r.dsap == 61 for r in bus.requests) <= 7


def test_high_priority_answer_fetches_the_diagnosis_in_the_same_round() -> None:
    bus = exchanging(setup())
    bus.slave.answers[None] = high
    bus.slave.ready = bytes.fromhex("08 0C 00 02 06 96 07 0A")
    bus.hold()
    bus.slave.answers.clear()
    made = [r.dsap for r in bus.hold() if r.da == 3]
    assert made == [None, 60]
    assert present(bus.master.handlers[3].diagnosis).ext == b"\x07\x0a"
    assert [r.dsap for r in bus.hold() if r.da == 3] == [None]


def test_static_diagnosis_makes_inputs_invalid_until_it_is_over() -> None:
    bus = exchanging(setup())
    bus.slave.ready = DIAG_STATIC
    bus.high_answer()
    bus.run(20 * MS)
    assert not bus.image.valid
    bus.slave.ready = DIAG_READY
    bus.run(200 * MS)
    assert bus.image.valid


def test_garbage_in_answers_never_raises() -> None:
    for junk in (b"", b"\x00", bytes(5), bytes(244)):
        for sap in (60, 61, 62, None):
            link_to(answers={sap: says(junk)}).run(100 * MS)
