"""A whole slave on its line, octet by octet: nothing of ours at the other end."""

from __future__ import annotations

import pytest
from faults.slaves import (
    SilentRefusal,
    WrongLength,
)
from octet_wire import BIT, PARAMS, Wire, framed
from slave_kit import CFG, MS, PRM, Bench, make_slave

from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.events import SlaveAppStateChanged
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.interface import SC_REPLY


def test_the_telegrams_of_real_logs() -> None:
    """pyprofibus#7: Slave_Diag 99 -> 2 and its answer, FDL status (to 2 here), Set_Prm with what the slave needs."""
    device = MirrorDevice(0x0CDA, bytes.fromhex("21"))
    wire = Wire(make_slave(2, device, PARAMS))
    assert wire.ask("68 05 05 68 82 E3 6D 3C 3E 4C 16") == "68 0B 0B 68 E3 82 08 3E 3C 02 05 00 FF 0C DA D3 16"
    assert wire.ask("10 02 63 49 AE 16") == "10 63 02 00 65 16"
    assert wire.ask("68 0F 0F 68 82 E3 5D 3D 3E B8 05 01 00 0C DA 01 40 00 00 22 16") == "E5"
    assert isinstance(wire.station.responder, SlaveApp)
    assert wire.station.responder.state is SlaveAppState.WAIT_CFG
    assert wire.station.responder.master == 99


def test_the_whole_bring_up() -> None:
    """Addresses, ident number and diagnosis of pyprofibus#19 (8, master 2, 0A35)."""
    wire = Wire(make_slave(8, MirrorDevice(0x0A35, bytes.fromhex("10 20")), PARAMS))
    assert wire.ask("68 05 05 68 88 82 6D 3C 3E F1 16") == "68 0B 0B 68 82 88 08 3E 3C 02 05 00 FF 0A 35 D1 16"
    assert wire.ask(framed(0x88, 0x82, 0x5D, "3D 3E 88 01 0A 0B 0A 35 02")) == "E5"
    assert wire.ask(framed(0x88, 0x82, 0x7D, "3E 3E 10 20")) == "E5"
    # the log of #19: ready, watchdog on, locked to master 2
    assert wire.ask("68 05 05 68 88 82 5D 3C 3E E1 16") == "68 0B 0B 68 82 88 08 3E 3C 00 0C 00 02 0A 35 D9 16"
    assert wire.ask("68 04 04 68 08 02 7D 55 DC 16") == "68 04 04 68 02 08 08 55 67 16"
    # a repetition: the kept answer, nothing is done twice
    assert wire.ask("68 04 04 68 08 02 7D 55 DC 16") == "68 04 04 68 02 08 08 55 67 16"
    assert wire.ask("68 04 04 68 08 02 5D 66 CD 16") == "68 04 04 68 02 08 08 66 78 16"
    app = wire.station.responder
    assert isinstance(app, SlaveApp)
    assert app.stats.exchanges == 2
    # Global_Control Clear to all: no answer, then zeros
    assert wire.ask(framed(0xFF, 0x82, 0x46, "3A 3E 02 00")) == ""
    assert app.clear
    assert wire.ask("68 04 04 68 08 02 7D 55 DC 16") == "68 04 04 68 02 08 08 00 12 16"
    # Set_Slave_Add is closed in data exchange: RS
    assert wire.ask(framed(0x88, 0x82, 0x5D, "37 3E 09 0A 35 00")) == "10 02 08 03 0D 16"
    changes = [event.state for event in wire.station.take_events() if isinstance(event, SlaveAppStateChanged)]
    assert changes == [SlaveAppState.WAIT_CFG, SlaveAppState.DATA_EXCH]
    # the watchdog of 100 ms
    wire.pass_time(100 * MS)
    assert wire.ask("68 05 05 68 88 82 7D 3C 3E 01 16") == "68 0B 0B 68 82 88 08 3E 3C 02 05 00 FF 0A 35 D1 16"


def test_min_tsdr_of_set_prm_is_kept() -> None:
    station = make_slave(8, MirrorDevice(0x0A35, bytes.fromhex("10 20")), PARAMS)
    wire = Wire(station)
    start = wire.now + 1000 * BIT
    wire.ask("68 05 05 68 88 82 6D 3C 3E F1 16")
    assert wire.out[0][0] - start == 11 * BIT
    wire.ask(framed(0x88, 0x82, 0x5D, "3D 3E 80 01 01 37 0A 35 00"))
    start = wire.now + 1000 * BIT
    wire.ask("68 05 05 68 88 82 7D 3C 3E 01 16")
    assert wire.out[0][0] - start == 0x37 * BIT


def test_a_slave_without_inputs_and_one_without_outputs() -> None:
    wire = Wire(make_slave(8, MirrorDevice(0x0A35, b"\x20"), PARAMS))
    wire.ask(framed(0x88, 0x82, 0x6D, "3D 3E 80 01 01 0B 0A 35 00"))
    wire.ask(framed(0x88, 0x82, 0x5D, "3E 3E 20"))
    assert wire.ask("68 04 04 68 08 02 7D 55 DC 16") == "E5"
    wire = Wire(make_slave(8, MirrorDevice(0x0A35, b"\x10"), PARAMS))
    wire.ask(framed(0x88, 0x82, 0x6D, "3D 3E 80 01 01 0B 0A 35 00"))
    wire.ask(framed(0x88, 0x82, 0x5D, "3E 3E 10"))
    assert wire.ask("10 08 02 7D 87 16") == "68 04 04 68 02 08 08 00 12 16"  # inputs only: an SD1 request


# --- faulty slaves for tests of masters; the others: test_slave_with_master -----------------------------------------


def bench_of(app: SlaveApp) -> Bench:
    return Bench(app.device, app)


@pytest.mark.parametrize(("extra", "length"), [(1, 2), (-5, 1), (3, 4)])
def test_wrong_length(extra: int, length: int) -> None:
    bench = bench_of(WrongLength(MirrorDevice(0x0A35, CFG), extra)).up()
    assert len(bench.dx().data) == length


def test_silent_refusal() -> None:
    bench = bench_of(SilentRefusal(MirrorDevice(0x0A35, CFG)))
    with pytest.raises(AssertionError):
        bench.prm(PRM[:6])
    assert bench.prm() == SC_REPLY
