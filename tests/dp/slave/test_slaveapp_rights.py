"""Access to the services of a slave application: states, owner, priority."""

from __future__ import annotations

import pytest
from slave_kit import CFG, DATA_EXCH, KEEP, MASTER, OTHER, PRM, UNLOCK, WAIT_PRM, Bench, Recorder, in_state, srd

from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.state_table import ACCESS
from dpstack.dpv1.slave.alarms import AlarmServer, AlarmSupport
from dpstack.dpv1.slave.record_table import RecordTable
from dpstack.fdl.interface import RS_REPLY, SC_REPLY, Reply
from dpstack.fdl.telegram import Req, Resp


class Station:
    """The part of a passive station that its application changes."""

    def __init__(self) -> None:
        self.address = 17
        self.baud = 500_000
        self.min_tsdr: list[int] = []

    def set_address(self, address: int) -> None:
        self.address = address

    def set_min_tsdr(self, bits: int) -> None:
        self.min_tsdr.append(bits)


@pytest.mark.parametrize("sa", [MASTER, OTHER])
@pytest.mark.parametrize("state", list(SlaveAppState))
def test_services_are_open_as_in_the_table(state: SlaveAppState, sa: int) -> None:
    data = {None: b"\x55", 61: PRM, 62: CFG}
    for dsap in [None, *range(64)]:
        if dsap == 58:
            continue  # an SDN, below
        device = Recorder()
        device.set_slave_add = True
        device.records = RecordTable({})
        device.ms2 = 2
        device.alarm_server = AlarmServer(AlarmSupport(extra_sap=True), 63)
        bench = in_state(state, device, PRM + b"\x80\0\0")
        access = ACCESS.get(dsap)
        is_open = access is not None and state in access.states and (sa == MASTER or not access.owner_only)
        reply = bench.ask(dsap, data.get(dsap, b""), sa)
        assert (reply != RS_REPLY) is is_open, (dsap, access)


@pytest.mark.parametrize("function", [f for f in Req if f not in (Req.SRD_LOW, Req.SRD_HIGH, Req.CLOCK_VALUE)])
def test_everything_but_srd_is_refused(bench: Bench, function: Req) -> None:
    for dsap in (None, 60, 61, 62):
        assert bench.app.serve(srd(dsap, b"\x55", function=function), 0) == RS_REPLY
    assert bench.app.state is DATA_EXCH
    assert bench.recorder.calls == []


def test_low_priority_is_served_like_high(bench: Bench) -> None:
    assert bench.app.serve(srd(None, b"\x55", function=Req.SRD_LOW), 0) == Reply(Resp.DL, b"\x01")


def test_the_lock(bench: Bench) -> None:
    """docs/reference/protocol.md#lock-and-unlock: locked to its master; another one's requests change nothing, and are
    told."""
    bench.dx(b"\x11")
    assert bench.prm(sa=OTHER) == SC_REPLY
    assert bench.cfg(sa=OTHER) == SC_REPLY
    assert bench.prm(UNLOCK, sa=OTHER) == SC_REPLY
    assert bench.prm(b"rubbish", sa=OTHER) == SC_REPLY
    assert bench.dx(b"\x22", sa=OTHER) == RS_REPLY
    assert (bench.app.state, bench.app.master, bench.app.outputs) == (DATA_EXCH, MASTER, b"\x11")
    assert bench.diag(sa=OTHER) == bytes.fromhex("00 0C 00 02 0A 35")
    assert bench.app.stats.foreign == 5
    assert bench.texts() == [
        "slave 8 (recorder): Set_Prm of master 9 refused: it is locked by master 2",
        "slave 8 (recorder): Chk_Cfg of master 9 refused: it is locked by master 2",
    ]


def test_unlock_gives_it_to_others(bench: Bench) -> None:
    bench.dx()
    assert bench.prm(UNLOCK) == SC_REPLY
    assert (bench.app.state, bench.app.master) == (WAIT_PRM, None)
    assert bench.recorder.take()[-1] == "leave unlock"
    bench.prm_and_cfg(sa=OTHER)
    assert bench.dx(sa=OTHER).data == b"\x02"
    assert bench.app.master == OTHER


def test_chk_cfg_before_set_prm_changes_nothing() -> None:
    bench = Bench()
    assert bench.cfg() == SC_REPLY
    assert bench.app.state is WAIT_PRM
    assert bench.diag() == bytes.fromhex("02 05 00 FF 0A 35")
    assert "nobody has parameterised the slave" in bench.texts()[0]


def test_min_tsdr_goes_to_the_station() -> None:
    """docs/reference/protocol.md#set_prm: also when Lock_Req = Unlock_Req = 0, with any ident number; not with a
    refused Set_Prm."""
    bench = Bench()
    station = Station()
    bench.app.attached(station)
    assert bench.app.address == 17
    bench.prm(KEEP)
    assert bench.app.state is WAIT_PRM
    bench.prm(PRM[:3] + b"\x99" + b"\x00\x00\x00")
    bench.up()
    bench.dx()
    bench.prm(KEEP)
    assert bench.app.state is DATA_EXCH
    bench.prm(KEEP, sa=OTHER)
    bench.prm(UNLOCK)
    assert station.min_tsdr == [0x37, 0x0B, 0x37]
    assert bench.recorder.calls[-1] == "leave unlock"


def test_texts_without_an_address() -> None:
    app = SlaveApp(Recorder())
    app.serve(srd(61, PRM), 0)
    assert app.take_events()[0].text.startswith("recorder: wait_cfg")
    assert app.take_events() == []
    assert repr(app) == "<SlaveApp recorder at None: wait_cfg>"
