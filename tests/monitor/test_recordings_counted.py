"""Public recordings of real devices through decoder and counters: each telegram with a valid FCS is named rightly."""

from __future__ import annotations

import pytest
from recordings import (
    ASM754,
    FESTO_CPV,
    FESTO_RS,
    IM151,
    IM151_PLC,
    LOGO_TD,
    TI_SITARA,
    TOIT,
    WHOLE,
    Recording,
    completed,
)
from support import MS, S

from dpstack.capture.cutter import split
from dpstack.capture.transmission import Transmission
from dpstack.decode.telegram import explain
from dpstack.monitor.counters import Counters, State, Station
from dpstack.monitor.evidence import finding

#: service by DSAP, as the standard numbers them
SERVICES = {0x33: "MS1", 0x3A: "Global_Control", 0x3B: "Get_Cfg", 0x3C: "Slave_Diag", 0x3D: "Set_Prm", 0x3E: "Chk_Cfg"}
ALL = {recording.name: recording for recording in (*WHOLE, ASM754)}


def telegrams(recording: Recording) -> list[tuple[bool, bytes]]:
    """Request or not, and the octets; the manual's telegrams get the FCS and the FCB that it leaves out."""
    if recording is not ASM754:
        return recording.lines
    found, fcb = [], 0
    for is_request, octets in recording.lines:
        fcb ^= is_request
        found.append((is_request, octets if octets == b"\xe5" else completed(octets, fcb if is_request else None)))
    return found


def expected(recording: Recording) -> list[str]:
    """The service of each telegram; an answer has that of its request."""
    names = []
    for is_request, octets in telegrams(recording):
        if is_request:
            name = "FDL_Status" if octets[0] == 0x10 and octets[3] == 0x49 else "Data_Exchange"
            if octets[0] == 0x68 and octets[4] & 0x80:
                name = SERVICES[octets[7]]
        names.append(name)
    return names


def counted(octets: list[bytes]) -> Counters:
    counters = Counters()
    for number, one in enumerate(octets):
        counters.add(Transmission(one, S + number * MS, 500_000))
    return counters


@pytest.mark.parametrize("name", ALL)
def test_every_recorded_telegram_is_named(name: str) -> None:
    recording = ALL[name]
    lines = telegrams(recording)
    stream = b"".join(octets for _, octets in lines)
    assert split(stream) == [octets for _, octets in lines]  # whole, though they follow without a pause
    found = list(explain(Transmission(octets, S + number * MS, 500_000) for number, (_, octets) in enumerate(lines)))
    assert [one.service for one in found] == expected(recording)
    assert [one.error for one in found] == [None] * len(lines)
    for one, (is_request, octets) in zip(found, lines, strict=True):
        ends = (recording.master, recording.slave) if is_request else (recording.slave, recording.master)
        broadcast = octets[0] == 0x68 and octets[4] == 0xFF
        telegram = one.telegram
        assert telegram is not None
        if octets == b"\xe5":
            assert one.as_dict()["from"] == recording.slave
        else:
            assert (telegram.sa, telegram.da) == ((ends[0], 127) if broadcast else ends)


@pytest.mark.parametrize("name", ALL)
def test_every_recorded_telegram_is_counted(name: str) -> None:
    recording = ALL[name]
    lines = telegrams(recording)
    counters = counted([octets for _, octets in lines])
    station = counters.stations[recording.slave]
    asked = [octets for is_request, octets in lines if is_request and octets[4:5] != b"\xff"]
    assert (station.requests, station.answers) == (len(asked), len(recording.pairs))
    assert station.requests == station.answers + station.no_answer + (counters.asked is station)
    assert (counters.damaged, counters.unattributed, counters.strays, counters.contradictions) == ({}, 0, 0, 0)
    assert station.repetitions == station.repeated_polls == station.late == 0
    assert set(counters.masters) == {recording.master}


def station_of(recording: Recording, *more: bytes) -> Station:
    return counted([octets for _, octets in telegrams(recording)] + list(more)).stations[recording.slave]


def test_states_and_idents_of_recorded_devices() -> None:
    seen = {one.name: (station_of(one).state, station_of(one).ident) for one in ALL.values()}
    assert seen == {
        IM151_PLC.name: (State.WAIT_READY, 0x80E0),
        IM151.name: (State.WAIT_READY, 0x806A),
        FESTO_CPV.name: (State.WAIT_READY, 0x0A35),
        TI_SITARA.name: (State.SET_PRM, 0x0CDA),
        TOIT.name: (State.DIAGNOSIS, 0x06D1),
        ASM754.name: (State.DATA_EXCHANGE, None),
    }


def test_a_recorded_refusal_is_counted_as_rs() -> None:
    exchange = bytes.fromhex("68 05 05 68 08 02 7D 00 00 87 16")
    station = station_of(FESTO_CPV, exchange, b"\xe5", exchange[:6] + b"\x5d\0\0\x67\x16", FESTO_RS)
    assert (station.rs, station.state, station.syncs) == (1, State.DATA_EXCHANGE, 1)


def test_a_bring_up_is_evidence_for_profibus_and_one_telegram_is_none() -> None:
    for recording, named in ((IM151_PLC, True), (ASM754, True), (TI_SITARA, False)):
        counters = counted([octets for _, octets in telegrams(recording)])
        assert finding(counters).is_profibus == named


def test_a_text_display_is_counted_as_damaged_and_never_named() -> None:
    counters = counted(list(LOGO_TD) * 100)
    assert counters.telegrams == 0
    assert counters.damaged == {"start": 100 * len(LOGO_TD)}
    assert not finding(counters).is_profibus
