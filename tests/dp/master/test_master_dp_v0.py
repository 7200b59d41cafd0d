"""The bring-up for every bit of the diagnosis, and what the master makes of it in data exchange, in literal octets."""

from __future__ import annotations

from typing import Any

import pytest
from scripted_link import (
    CHK_CFG,
    DIAG,
    DIAG_FREE,
    DIAG_LOCKED,
    DIAG_NOT_READY,
    DIAG_PRM_FAULT,
    DIAG_READY,
    DIAG_STATIC,
    MS,
    RUN,
    SET_PRM,
    Entry,
    ScriptedLink,
    ScriptedSlave,
    exchanging,
    high,
    link,
    link_to,
    operating,
    refuses,
    says,
    setup,
    silent,
    squeezed,
    wire,
)
from support import present

from dpstack.dp.master.commands import ActivateSlave, DeactivateSlave
from dpstack.dp.master.events import SlaveDiagnosis, SlaveRemark, SlaveState
from dpstack.dp.master.slave_states import TABLE, Row, Trigger, table
from dpstack.dp.pdu.diag_bits import FLAGS, Reaction, SetBy
from dpstack.dp.slave_params import IsochronousDemand
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.model import Device, Diagnosis, DiagText, Module
from dpstack.phy.patience import Lateness


def inputs_valid(bus: ScriptedLink) -> bool:
    return bus.image.valid


_GET: Entry = (59, "")
_UP = [DIAG, SET_PRM, CHK_CFG, DIAG]
_DX: Entry = (None, "00 00 00 00")
#: bit -> the diagnosis after Chk_Cfg, what the master sends in the first second, where it ends, the fault's kind
TRANSCRIPTS: dict[str, tuple[str, list[Entry], str, str]] = {
    "station_not_ready": ("02 0C 00 02 06 96", _UP, "wait_ready", ""),
    "cfg_fault": ("06 0D 00 FF 06 96", [*_UP, _GET], "fault", "cfg_fault"),
    "ext_diag": ("08 0C 00 02 06 96 03 11 22", [*_UP, _DX], "data_exchange", ""),
    "not_supported": ("12 05 00 FF 06 96", _UP, "fault", "not_supported"),
    "prm_fault": ("42 05 00 FF 06 96", _UP, "fault", "prm_fault"),
    "prm_req": ("02 05 00 FF 06 96", [*_UP, *(_UP[1:] * 3), _GET], "fault", "not_ready"),
    "stat_diag": ("00 0E 00 02 06 96", _UP, "wait_ready", ""),
    "wd_on": ("00 0C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "freeze_mode": ("00 1C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "sync_mode": ("00 2C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "ext_diag_overflow": ("00 0C 80 02 06 96", [*_UP, _DX], "data_exchange", ""),
    # the master's own bits: from a slave they mean nothing, and are told once
    "station_non_existent": ("01 0C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "invalid_slave_response": ("20 0C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "master_lock": ("80 0C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "not_present": ("00 4C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "deactivated": ("00 8C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
}


@pytest.mark.parametrize("name", list(TRANSCRIPTS))
def test_transcript_of_the_bring_up_for_each_bit(name: str) -> None:
    octets, expected, state, kind = TRANSCRIPTS[name]
    bus = link(setup())
    slave = bus.slave
    slave.ready = bytes.fromhex(octets)
    slave.answers[59] = says(b"\xf1")
    bus.run(900 * MS)
    made = wire(bus)
    if state == "wait_ready":  # asked again and again
        assert made[: len(expected)] == expected
        assert set(made[len(expected) :]) == {DIAG}
    else:
        assert squeezed(made)[: len(expected)] == squeezed(expected)
        assert set(made[len(expected) :]) <= {_DX}
    handler = bus.master.handlers[3]
    assert handler.state.value == state
    assert (handler.fault.kind.value if handler.fault else "") == kind
    ours = next(flag for flag in FLAGS if flag.name == name).set_by is SetBy.MASTER
    assert any("which only a master may" in text for text in bus.remarks(3)) == ours


def test_the_transcripts_are_of_every_bit() -> None:
    assert set(TRANSCRIPTS) == {flag.name for flag in FLAGS}


@pytest.mark.parametrize("flag", [f for f in FLAGS if f.set_by is SetBy.SLAVE], ids=lambda f: f.name)
def test_each_bit_in_data_exchange(flag: Any) -> None:
    """By a diagnosis after a high-priority answer; the table says what follows."""
    bus = operating(setup())
    octets = bytearray.fromhex("00 0C 00 02 06 96")
    octets[flag.octet - 1] |= flag.mask
    bus.slave.ready = bytes(octets)
    bus.high_answer()
    made = bus.hold()
    assert [r.dsap for r in made if r.da == 3] == [None, 60]  # at once
    state, valid = bus.state(3), bus.image.valid
    wanted: tuple[SlaveState, bool] = {
        Reaction.REPORTS: (SlaveState.DATA_EXCHANGE, True),
        Reaction.WAITS: (SlaveState.DATA_EXCHANGE, False),
        Reaction.PARAMETERISES: (SlaveState.DIAGNOSIS, False),
        Reaction.REFUSES: (SlaveState.FAULT, False),
    }[flag.exchange]
    assert (state, valid) == wanted
    diagnosis = present(bus.master.handlers[3].diagnosis)
    assert flag.name in diagnosis.flags


def test_stat_diag_is_polled_until_it_is_gone_and_outputs_go_on() -> None:
    bus = operating(setup(initial=RUN))
    bus.slave.ready = DIAG_STATIC
    bus.high_answer()
    bus.run_anew(1_000 * MS)
    assert 9 <= sum(dsap == 60 for dsap, _ in wire(bus)) <= 12
    assert not inputs_valid(bus)
    assert {octets for dsap, octets in wire(bus) if dsap is None} == {RUN.hex(" ").upper()}
    bus.slave.ready = DIAG_READY
    bus.run(200 * MS)
    bus.run_anew(500 * MS)
    assert inputs_valid(bus)
    assert not any(dsap == 60 for dsap, _ in wire(bus))


def test_a_slave_that_always_has_a_diagnosis_takes_every_other_turn_at_most() -> None:
    bus = operating(setup(3), setup(4))
    bus.slave.answers[None] = high
    bus.slaves[4].configured = False
    bus.run(1_500 * MS)
    assert bus.state(4) is SlaveState.DATA_EXCHANGE


def test_a_slave_that_does_not_watch_its_master_is_told() -> None:
    bus = link(setup(), setup(4, watchdog_ms=0))
    for slave in bus.slaves.values():
        slave.ready = bytes.fromhex("00 04 00 02 06 96")
    bus.run(50 * MS)
    assert any("WD_On is 0" in text for text in bus.remarks(3))
    assert bus.remarks(4) == []


# --- extended diagnosis ---------------------------------------------------------------------------------------------


#: of a GSD file with Modul_Offset = 4
TEXTS = DiagTexts(
    Device(
        modul_offset=4,
        diagnosis=Diagnosis(
            (
                DiagText("bit", 0, 0, 1, "24 V is missing", ""),
                DiagText("channel", None, None, 16, "sensor dirty", ""),
            )
        ),
    ),
)


def test_extended_diagnosis_is_told_in_words() -> None:
    bus = link(setup(3, texts=TEXTS), setup(4))
    for slave in bus.slaves.values():
        slave.ready = bytes.fromhex("08 0C 00 02 06 96 03 01 00 42 05 82 43 B0 C7")
    bus.run(20 * MS)
    told = {e.address: e.texts for e in bus.events_of(SlaveDiagnosis)}
    channel = "input channel 3 (word)"
    assert told[3] == ("24 V is missing", "slots with a diagnosis: 4, 6", f"slot 6, {channel}: sensor dirty")
    assert told[4] == ("device: 01 00", "slots with a diagnosis: 1, 3", f"slot 3, {channel}: error 16")


def test_slots_with_a_diagnosis_have_the_names_of_their_modules() -> None:
    texts = DiagTexts(Device(modul_offset=4), (Module("AI 4", b"\x10"), None, Module("DO 8", b"\x20")))
    bus = link(setup(3, texts=texts))
    bus.slave.ready = bytes.fromhex("08 0C 00 02 06 96 42 07")
    bus.run(20 * MS)
    (told,) = (event.texts for event in bus.events_of(SlaveDiagnosis) if event.texts)
    assert told == ("slots with a diagnosis: 4 (AI 4), 5, 6 (DO 8)",)


def test_a_module_has_texts_of_its_own_for_errors_of_its_channels() -> None:
    def dirty(text: str) -> Diagnosis:
        return Diagnosis((DiagText("channel", None, None, 16, text, ""),))

    modules = (Module("AI 4", b"\x10"), Module("AI 8", b"\x11", diagnosis=dirty("cell dirty")))
    bus = link(setup(3, texts=DiagTexts(Device(diagnosis=dirty("sensor dirty")), modules)))
    bus.slave.ready = bytes.fromhex("08 0C 00 02 06 96 80 40 B0 81 40 B0")
    bus.run(20 * MS)
    (told,) = (event.texts for event in bus.events_of(SlaveDiagnosis) if event.texts)
    assert [text.split(": ")[-1] for text in told] == ["sensor dirty", "cell dirty"]


def test_lengths_that_lie_are_a_finding_and_nothing_more() -> None:
    bus = link(setup())
    bus.slave.ready = bytes.fromhex("08 0C 00 02 06 96 C7 48 05")
    bus.run(20 * MS)
    handler = bus.master.handlers[3]
    assert handler.state is SlaveState.DATA_EXCHANGE
    assert any("octet 8 announces a block of 8 octets, 2 are left" in text for text in bus.remarks(3))
    bus.slave.ready = bytes.fromhex("08 0C 00 02 06 96 C7 40 05")
    assert present(handler.diagnosis).ext == b"\xc7\x48\x05"


# --- the master's own bits ------------------------------------------------------------------------------------------


def test_the_bits_a_master_sets() -> None:
    bus = link(setup(3), setup(4), setup(5), setup(6))
    del bus.slaves[3]
    bus.slaves[4].free = DIAG_LOCKED
    bus.slaves[5].inputs = b"\x01"
    bus.run(1_000 * MS)
    bus.send(DeactivateSlave(6))
    seen = {a: h.diagnosis for a, h in bus.master.handlers.items()}
    assert {a: d.flags for a, d in seen.items() if d is not None} == {
        3: ("station_non_existent",),
        4: ("master_lock", "wd_on"),
        5: ("invalid_slave_response", "wd_on"),
        6: ("wd_on", "deactivated"),
    }


# --- The table of the bring-up: every row has its clause and is exercised -------------------------------------------


def test_states_of_the_table_are_reachable_and_named() -> None:
    assert {state for state, _ in TABLE} == set(SlaveState)
    assert all(row.clause for row in TABLE.values())


def test_a_pair_has_one_row() -> None:
    silent_row = ((SlaveState.FAULT, SlaveState.OFFLINE), Trigger.SILENT, SlaveState.OFFLINE, "clause")
    other = ((SlaveState.OFFLINE,), Trigger.SILENT, SlaveState.FAULT, "another clause")
    assert table((silent_row,))[SlaveState.FAULT, Trigger.SILENT] == Row(SlaveState.OFFLINE, "clause")
    for second in (silent_row, other):
        with pytest.raises(ValueError, match="two rows for SILENT in "):
            table((silent_row, second))


def test_a_pair_without_a_row_is_a_remark(monkeypatch: pytest.MonkeyPatch) -> None:
    from dpstack.dp.master import slave_handler

    rows = {pair: row for pair, row in TABLE.items() if pair != (SlaveState.DATA_EXCHANGE, Trigger.DIAG_PRM_REQ)}
    monkeypatch.setattr(slave_handler, "TABLE", rows)
    bus = exchanging(setup())
    bus.slave.answers = {None: high, 60: says(DIAG_FREE)}
    bus.run_long(1_500 * MS)
    assert [event.message for event in bus.events_of(SlaveRemark)] == [
        "ignored in data_exchange: 'diagnosis: wants parameters'; the table of states has no row for it, please report "
        "this to the makers of dpstack"
    ]
    assert bus.state(3) is SlaveState.DATA_EXCHANGE


def test_a_second_order_to_leave_service_is_no_remark() -> None:
    bus = exchanging(setup())
    for _ in range(2):
        bus.send(DeactivateSlave(3), 50 * MS)
    assert bus.state(3) is SlaveState.DEACTIVATED
    assert bus.events_of(SlaveRemark) == []


class _Recorder(dict[Any, Any]):
    """The table, remembering which rows were used."""

    def __init__(self) -> None:
        super().__init__(TABLE)
        self.used: set[Any] = set()

    def get(self, key: Any, default: Any = None) -> Any:
        self.used.add(key)
        return super().get(key, default)


_RS = refuses(0x03)
_OTHER = bytes.fromhex("02 05 00 FF 12 34")


def test_every_row_of_the_table_is_exercised(monkeypatch: pytest.MonkeyPatch) -> None:
    from dpstack.dp.master import slave_handler

    rows = _Recorder()
    monkeypatch.setattr(slave_handler, "TABLE", rows)
    # one service of the bring-up has another answer
    link_to().run_long(3_000 * MS)
    for sap, answer in (
        (60, _RS),
        (60, says(_OTHER)),
        (60, says(DIAG_LOCKED)),
        (61, silent),
        (61, _RS),
        (62, silent),
        (62, _RS),
    ):
        link_to(answers={sap: answer}).run_long(3_000 * MS)
    link(setup(), slaves={}).run(500 * MS)
    for ready in (DIAG_FREE, DIAG_PRM_FAULT, DIAG_LOCKED, _OTHER):
        link_to(ready=ready).run_long(3_000 * MS)
    link_to(ready=DIAG_NOT_READY).run_long(12_000 * MS)
    half = link_to(answers={61: silent})
    half.hold()
    half.hold()
    half.slave.free = DIAG_NOT_READY
    half.run(5 * MS)
    # in WAIT_READY: silence and refusals of Slave_Diag
    for answer in (silent, _RS):
        bus = link(setup())
        while bus.state(3) is not SlaveState.WAIT_READY:
            bus.hold()
        bus.slave.answers[60] = answer
        bus.run(500 * MS)
    # in data exchange: every kind of trouble, then trouble with the diagnosis that follows
    for trouble in (_RS, refuses(0x02), says(b"\x01")):
        for later in ({}, {60: _RS}, {60: says(DIAG_LOCKED)}, {60: says(_OTHER)}, {60: silent}):
            bus = exchanging(setup())
            bus.run_long(1_100 * MS)
            bus.slave.configured = False
            bus.slave.answers |= {None: trouble} | later
            bus.run_long(2_500 * MS)
    for ready in (DIAG_STATIC, DIAG_FREE, DIAG_PRM_FAULT, DIAG_LOCKED, _OTHER, DIAG_READY):
        bus = exchanging(setup())
        bus.slave.answers = {None: high, 60: says(ready)}
        bus.run_long(1_500 * MS)
    gone = exchanging(setup())
    gone.slaves.clear()
    gone.run(500 * MS)
    # it demands isochronous mode: refused at once, or when the port is measured
    demanding = setup(isochronous=IsochronousDemand("its GSD file"))
    link(demanding).run_long(3_000 * MS)
    late = [Lateness(MS)]
    measuring = link(demanding)
    measuring.master.context.lateness = lambda: late[0]
    measuring.run(20 * MS)
    assert measuring.state(3) is SlaveState.DIAGNOSIS
    late[0] = Lateness(MS, answers=1_000)
    measuring.run(20 * MS)
    assert measuring.state(3) is SlaveState.FAULT
    # out of service from every state, and back
    for slave in (ScriptedSlave(), ScriptedSlave(ready=DIAG_PRM_FAULT), ScriptedSlave(answers={None: _RS})):
        for state in {state for state, _ in TABLE} - {SlaveState.DEACTIVATED}:
            bus = link(setup(), slaves={3: slave})
            handler = bus.master.handlers[3]
            for _ in range(20):
                if handler.state is state:
                    break
                bus.hold()
            bus.send(DeactivateSlave(3))
            bus.hold()
            bus.send(ActivateSlave(3))
            slave.configured = False
    assert set(TABLE) - rows.used == set()
