"""A whole slave on its line, octet by octet: nothing of ours at the other end."""

from __future__ import annotations

import pytest
from faults.slaves import (
    SilentRefusal,
    WrongLength,
)
from octet_wire import BIT, PARAMS, Wire, framed
from slave_kit import CFG, MS, OTHER, PRM, Bench, Recorder, make_slave

from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.events import AddressChanged, DeviceFailed, Report, RequestRefused, SlaveAppStateChanged
from dpstack.dp.slave.extension import SlaveService
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.interface import RS_REPLY, SC_REPLY
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.fdl.passive.station import PassiveStation
from dpstack.machine import pump


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


# --- Set_Slave_Add (docs/reference/protocol.md#set_slave_add) --------------------------------------------------------
# literal octets, when it is open, what is kept, what masters see


#: new address 9, ident 0A35, No_Add_Chg 0
ADD = bytes.fromhex("09 0A 35 00")
FIX = bytes.fromhex("09 0A 35 01")


class Addressed(Recorder):
    set_slave_add = True


def fresh(keeps: bool = False) -> tuple[Bench, PassiveStation]:
    """As delivered: address 126."""
    device = Addressed()
    device.keeps = keeps
    bench = Bench(device, SlaveApp(device, address=126))
    return bench, PassiveStation(126, bench.app, PARAMS)


def test_the_address_changes_on_the_wire() -> None:
    """From 126 by master 2: SC from 126; afterwards silence there, and a slave that waits for parameters at 9."""
    wire = Wire(make_slave(126, MirrorDevice(0x0A35, CFG), PARAMS))
    assert wire.ask("10 7E 02 49 C9 16") == "10 02 7E 00 80 16"  # FDL status
    assert wire.ask(framed(0xFE, 0x82, 0x6D, "37 3E 09 0A 35 00")) == "E5"
    assert wire.ask("10 7E 02 49 C9 16") == ""
    assert wire.ask("10 09 02 49 54 16") == "10 02 09 00 0B 16"
    assert wire.ask(framed(0x89, 0x82, 0x6D, "3C 3E")) == "68 0B 0B 68 82 89 08 3E 3C 02 05 00 FF 0A 35 D2 16"
    # back again, and the repetition of a request whose acknowledgement was lost meets nobody
    assert wire.ask(framed(0x89, 0x82, 0x5D, "37 3E 05 0A 35 00")) == "E5"
    assert wire.ask(framed(0x89, 0x82, 0x5D, "37 3E 05 0A 35 00")) == ""
    assert wire.ask("10 05 02 49 50 16") == "10 02 05 00 07 16"


@pytest.mark.parametrize("address", [0, 3, 125])
def test_every_address_of_a_station(address: int) -> None:
    bench, station = fresh()
    assert bench.ask(55, bytes([address]) + ADD[1:]) == SC_REPLY
    assert station.address == bench.app.address == address


def test_the_call_and_the_event_of_a_new_address() -> None:
    bench, station = fresh(keeps=True)
    assert bench.ask(55, FIX + b"\xca\xfe", sa=OTHER) == SC_REPLY
    assert bench.recorder.take() == ["address_set 9 True cafe"]
    assert (station.address, bench.app.address_fixed) == (9, True)
    (event,) = bench.app.take_events()
    assert isinstance(event, AddressChanged)
    assert event.text == "slave 9 (recorder): address 126 became 9 by master 9, fixed"


def test_services_of_the_old_address_end() -> None:
    """Connections of class 2 masters, for example."""

    class Watched(SlaveService):
        def __init__(self) -> None:
            self.calls: list[tuple[str, int]] = []

        def end(self, why: str, now: int) -> None:
            self.calls.append((why, now))

    class WithService(Addressed):
        service = Watched()

        def services(self, report: Report) -> tuple[SlaveService, ...]:
            return (self.service,)

    device = WithService()
    bench = Bench(device, SlaveApp(device, address=126))
    PassiveStation(126, bench.app, PARAMS)
    bench.ask(55, bytes.fromhex("09 0A 36 00"))  # another ident
    assert device.service.calls == []
    bench.ask(55, ADD)
    assert device.service.calls == [("the slave has another address", bench.now)]
    bench.app.restart(77)
    assert device.service.calls[1:] == [("the slave was switched off", 77)]


@pytest.mark.parametrize(
    ("octets", "reason"),
    [
        ("", "octet 1"),
        ("09", "octet 2"),
        ("09 0A 35", "octet 4"),
        ("09 0C DA 00", "octets 2-3: ident number 0x0CDA, this device is 0x0A35"),
        ("7E 0A 35 00", "octet 1: address 126 is outside 0..125"),
        ("7F 0A 35 00", "octet 1: address 127"),
        ("FF 0A 35 00", "octet 1: address 255"),
    ],
)
def test_requests_that_leave_the_address(octets: str, reason: str) -> None:
    """The acknowledgement says nothing about it (Acromag): the master looks for the slave at the new address."""
    bench, station = fresh()
    assert bench.ask(55, bytes.fromhex(octets)) == SC_REPLY
    assert station.address == 126
    assert bench.recorder.take() == []
    (event,) = bench.app.take_events()
    assert isinstance(event, RequestRefused)
    assert reason in event.text


@pytest.mark.parametrize("state", [SlaveAppState.WAIT_CFG, SlaveAppState.DATA_EXCH])
def test_closed_once_parameterised(state: SlaveAppState) -> None:
    """docs/reference/protocol.md#services-by-state: Set_Slave_Add only in Wait_Prm, of nobody else either."""
    bench, station = fresh()
    bench.prm(PRM)
    if state is SlaveAppState.DATA_EXCH:
        bench.cfg(CFG)
    for sa in (2, OTHER):
        assert bench.ask(55, ADD, sa) == RS_REPLY
    assert (bench.app.state, station.address) == (state, 126)


def test_closed_on_a_device_that_does_not_have_it() -> None:
    bench = Bench()
    assert bench.ask(55, ADD) == RS_REPLY
    assert bench.app.address == 8


def test_no_add_chg_closes_set_slave_add_until_an_initial_reset() -> None:
    bench, station = fresh(keeps=True)
    bench.ask(55, FIX)
    assert bench.ask(55, b"\x05" + ADD[1:]) == RS_REPLY
    bench.app.restart(1)  # switching it off and on does not help
    assert bench.ask(55, b"\x05" + ADD[1:]) == RS_REPLY
    assert station.address == 9
    bench.app.take_events()
    bench.recorder.take()
    bench.app.initial_reset(2)
    assert bench.recorder.take() == ["address_set 126 False"]
    assert (station.address, bench.app.address_fixed) == (126, False)
    assert bench.texts() == ["slave 126 (recorder): address 9 became 126 by an initial reset"]
    assert bench.ask(55, b"\x05" + ADD[1:]) == SC_REPLY
    assert station.address == 5


@pytest.mark.parametrize(("keeps", "after"), [(True, 9), (False, 126)])
def test_kept_over_a_restart_if_the_application_wants(keeps: bool, after: int) -> None:
    bench, station = fresh(keeps)
    bench.ask(55, ADD)
    assert station.address == 9
    assert bench.texts()[0].endswith("by master 2" if keeps else "by master 2, until the next restart")
    bench.app.restart(5)
    assert (station.address, bench.app.address) == (after, after)
    bench.app.restart(6)
    assert station.address == after


def test_no_add_chg_that_was_not_kept_is_forgotten() -> None:
    bench, _ = fresh(keeps=False)
    bench.ask(55, FIX)
    bench.app.restart(5)
    assert bench.ask(55, ADD) == SC_REPLY


def test_an_address_from_before_that_is_fixed() -> None:
    """The application hands in the address and No_Add_Chg that it kept."""
    device = Addressed()
    bench = Bench(device, SlaveApp(device, address=9, address_fixed=True))
    assert bench.ask(55, ADD) == RS_REPLY


def test_the_address_stays_when_the_device_fails_to_keep_it() -> None:
    bench, station = fresh()
    bench.recorder.broken = "address_set"
    assert bench.ask(55, ADD) == SC_REPLY
    assert station.address == 126
    (event,) = bench.app.take_events()
    assert isinstance(event, DeviceFailed)
    assert event.during == "Set_Slave_Add"
    bench.app.initial_reset(1)
    assert "during an initial reset" in bench.texts()[0]
    assert bench.app.failure is not None


def test_initial_reset_in_data_exchange_leaves_it_first() -> None:
    bench, station = fresh(keeps=True)
    bench.ask(55, ADD)
    bench.up()
    bench.dx(b"\x11")
    bench.recorder.take()
    bench.app.initial_reset(9)
    assert bench.recorder.take() == ["leave power off", "address_set 126 False"]
    assert (bench.app.state, bench.app.outputs, station.address) == (SlaveAppState.WAIT_PRM, b"", 126)


def test_an_application_without_a_station() -> None:
    device = Addressed()
    bench = Bench(device, SlaveApp(device))
    bench.ask(55, ADD)
    assert bench.app.address == 9
    bench.app.restart(1)
    assert bench.app.address == 9  # it never stood anywhere else


def test_on_a_port_with_several_slaves_it_is_found_at_once() -> None:
    stations = [make_slave(at, MirrorDevice(0x0A35, CFG), PARAMS) for at in (126, 3)]
    line = Multidrop(stations, PARAMS)
    out: list[bytes] = []

    def transmit(octets: bytes, now: int) -> int:
        out.append(octets)
        return now + 1

    def ask(octets: str, now: int) -> list[bytes]:
        out.clear()
        pump(line, bytes.fromhex(octets), now, transmit)
        pump(line, b"", now + 400_000, transmit)
        return out

    assert ask(framed(0xFE, 0x82, 0x6D, "37 3E 09 0A 35 00"), 1_000_000) == [b"\xe5"]
    assert ask("10 7E 02 49 C9 16", 2_000_000) == []
    assert ask("10 09 02 49 54 16", 3_000_000) == [bytes.fromhex("10 02 09 00 0B 16")]
    assert [station.address for station in line.stations] == [3, 9]
