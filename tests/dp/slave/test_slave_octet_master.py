"""Every DP-V0 service at the slave in literal octets on the wire: right, too short, too long, wrong state, SAP, master.

The rows are (what is asked, what is answered, the state afterwards); telegrams are put together by hand. Many in any
order: test_slave_random_octets.
"""

from __future__ import annotations

import pytest
from octet_wire import BIT, framed

from dpstack.dp.slave.application import SlaveAppState
from tests.dp.slave.asked_slave import CFG, DATA_EXCH, PRM, READS, SC, UNLOCK, WAIT_CFG, WAIT_PRM, Slave, answer

#: RS (status 3) from slave 8 to master 2, and to 9
RS = {2: "10 02 08 03 0D 16", 9: "10 09 08 03 14 16"}
NR = "10 02 08 09 13 16"
ANSWERS = {
    ("Slave_Diag", WAIT_PRM): "02 05 00 FF 0A 35",
    ("Slave_Diag", WAIT_CFG): "02 0C 00 02 0A 35",
    ("Slave_Diag", DATA_EXCH): "00 0C 00 02 0A 35",
    ("Get_Cfg", WAIT_PRM): "10 21",
    ("Get_Cfg", WAIT_CFG): "10 21",
    ("Get_Cfg", DATA_EXCH): "10 21",
    ("RD_Inp", DATA_EXCH): "55",
    ("RD_Outp", DATA_EXCH): "AA BB",
}


@pytest.mark.parametrize("sa", [2, 9])
@pytest.mark.parametrize("state", list(SlaveAppState))
@pytest.mark.parametrize("service", list(READS))
def test_reading_services(service: str, state: SlaveAppState, sa: int) -> None:
    """docs/reference/protocol.md#services-by-state: Slave_Diag and Get_Cfg always, RD_Inp and RD_Outp in Data_Exch; of
    any master, also of class 2."""
    slave = Slave().to(state)
    unit = READS[service]
    data = ANSWERS.get((service, state))
    wanted = RS[sa] if data is None else answer(data, f"3E {unit[:2]}", sa)
    assert slave.ask(unit, sa) == wanted
    assert slave.ask(unit, sa) == wanted
    assert slave.app.state is state


@pytest.mark.parametrize(
    ("unit", "answered", "state", "diagnosis"),
    [
        ("3D 3E 88 01 0A 0B 0A 35 02 00", SC, WAIT_CFG, "02 0C 00 02 0A 35"),
        ("3D 3E 80 01 01 0B 0A 35 00 00 00", SC, WAIT_CFG, "02 04 00 02 0A 35"),  # watchdog off
        ("3D 3E 80 00 00 0B 0A 35 00 00", SC, WAIT_CFG, "02 04 00 02 0A 35"),  # factors without WD_On are nothing
        ("3D 3E 87 01 01 0B 0A 35 00 00", SC, WAIT_CFG, "02 04 00 02 0A 35"),  # reserved bits are ignored
        ("3D 3E", SC, WAIT_PRM, "42 05 00 FF 0A 35"),
        ("3D 3E 88 01 0A 0B 0A 35", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # octet 7 is missing
        ("3D 3E 88 01 0A 0B 0A 35 02", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # a user parameter is missing
        ("3D 3E 88 01 0A 0B 0A 35 02 00 00 00", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # one too many
        ("3D 3E 88 01 0A 0B 0A 36 02 00", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # ident number
        ("3D 3E 88 00 0A 0B 0A 35 02 00", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # WD_Fact_1
        ("3D 3E 88 0A 00 0B 0A 35 02 00", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # WD_Fact_2
        ("3D 3E A8 01 0A 0B 0A 35 02 00", SC, WAIT_PRM, "12 05 00 FF 0A 35"),  # Sync_Req: Not_Supported
        ("3D 3E 98 01 0A 0B 0A 35 02 00", SC, WAIT_PRM, "12 05 00 FF 0A 35"),  # Freeze_Req: Not_Supported
        (UNLOCK, SC, WAIT_PRM, "02 05 00 FF 0A 35"),
        ("3D 3E C0 01 01 00 0A 35 00", SC, WAIT_PRM, "02 05 00 FF 0A 35"),  # 11 releases too
        ("3D 3E C8 01 01 00 0A 36 00", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # a release for another device
    ],
)
@pytest.mark.parametrize("start", list(SlaveAppState))
def test_set_prm(start: SlaveAppState, unit: str, answered: str, state: SlaveAppState, diagnosis: str) -> None:
    """docs/reference/protocol.md#refused-parameters-are-acknowledged: acknowledged whatever it is; the diagnosis tells.
    In any state the same comes of it."""
    slave = Slave().to(start)
    assert slave.ask(unit) == answered
    assert slave.app.state is state
    assert slave.diagnosis() == diagnosis


@pytest.mark.parametrize("start", list(SlaveAppState))
def test_set_prm_without_lock_and_unlock_changes_min_tsdr_only(start: SlaveAppState) -> None:
    """docs/reference/protocol.md#set_prm: whatever the ident number. 0 keeps, less than 11 counts as 11."""
    slave = Slave().to(start)
    for octet, bits in (("37", 0x37), ("00", 0x37), ("FF", 0xFF), ("05", 11)):
        assert slave.ask(f"3D 3E 00 00 00 {octet} FF FF 00") == SC
        assert slave.app.state is start
        begin = slave.wire.now + 1000 * BIT
        slave.diagnosis()
        assert slave.wire.out[0][0] - begin == bits * BIT


@pytest.mark.parametrize("octet", ["0B", "64", "00"])
def test_min_tsdr_holds_for_every_kind_of_answer(octet: str) -> None:
    """Octet 4 of Set_Prm: SC, data, RS and FDL status start no earlier."""
    slave = Slave()
    slave.ask(f"3D 3E 88 01 0A {octet} 0A 35 02 00")
    bits = max(int(octet, 16), 11)
    for octets in (
        framed(0x88, 0x82, 0x5D, CFG),
        framed(0x08, 0x02, 0x7D, "01 02"),
        framed(0x88, 0x82, 0x5D, "3C 3E"),
        framed(0x88, 0x82, 0x7D, "37 3E 05 0A 35 00"),
        "10 08 02 49 53 16",
    ):
        begin = slave.wire.now + 1000 * BIT
        assert slave.wire.ask(octets)
        assert slave.wire.out[0][0] - begin == bits * BIT
    slave.app.restart(slave.wire.now)  # as switched on
    begin = slave.wire.now + 1000 * BIT
    slave.wire.ask("10 08 02 49 53 16")
    assert slave.wire.out[0][0] - begin == 11 * BIT


@pytest.mark.parametrize(
    ("unit", "state", "diagnosis"),
    [
        (CFG, DATA_EXCH, "00 0C 00 02 0A 35"),
        ("3E 3E", WAIT_PRM, "06 05 00 FF 0A 35"),
        ("3E 3E 10", WAIT_PRM, "06 05 00 FF 0A 35"),
        ("3E 3E 10 20", WAIT_PRM, "06 05 00 FF 0A 35"),
        ("3E 3E 10 21 00", WAIT_PRM, "06 05 00 FF 0A 35"),
        ("3E 3E C0", WAIT_PRM, "06 05 00 FF 0A 35"),
    ],
)
@pytest.mark.parametrize("start", [WAIT_CFG, DATA_EXCH])
def test_chk_cfg(start: SlaveAppState, unit: str, state: SlaveAppState, diagnosis: str) -> None:
    slave = Slave().to(start)
    assert slave.ask(unit) == SC
    assert slave.app.state is state
    assert slave.diagnosis() == diagnosis


@pytest.mark.parametrize("start", [WAIT_CFG, DATA_EXCH])
@pytest.mark.parametrize("unit", [PRM, UNLOCK, "3D 3E 00 01 01 37 0A 35 00", "3D 3E", CFG, "3E 3E 11"])
def test_requests_of_another_master_change_nothing(unit: str, start: SlaveAppState) -> None:
    """docs/reference/protocol.md#lock-and-unlock: locked; acknowledged, and the diagnosis names the owner."""
    slave = Slave().to(start)
    before = slave.diagnosis(9)
    assert slave.ask(unit, 9) == SC
    assert slave.diagnosis(9) == before
    assert slave.app.state is start
    assert slave.app.master == 2
    assert slave.exchange("01 02", 9) == RS[9]
    begin = slave.wire.now + 1000 * BIT
    slave.diagnosis(9)
    assert slave.wire.out[0][0] - begin == 11 * BIT  # nor min T_SDR


def test_data_exchange() -> None:
    slave = Slave()
    assert slave.exchange("01 02") == RS[2]
    slave.to(WAIT_CFG)
    assert slave.exchange("01 02") == RS[2]
    assert slave.app.state is WAIT_CFG
    slave.ask(CFG)
    assert slave.exchange("01 02") == answer("FE")
    # SRD low is answered as SRD high
    assert slave.wire.ask(framed(0x08, 0x02, slave._fc() - 1, "03 02")) == answer("FC")
    assert slave.seen == [b"\1\2", b"\3\2"]


@pytest.mark.parametrize("outputs", ["", "01", "01 02 03", "00 " * 244])
def test_data_exchange_of_the_wrong_length(outputs: str) -> None:
    """docs/reference/protocol.md#slave-states: Wait_Prm with Cfg_Fault; an empty frame too, the slave is not Fail_Safe.
    Outputs safe."""
    slave = Slave().to(DATA_EXCH)
    assert slave.exchange(outputs) == RS[2]
    assert slave.diagnosis() == "06 05 00 FF 0A 35"
    assert slave.seen == [b"\xaa\xbb", b"\0\0"]


@pytest.mark.parametrize("state", list(SlaveAppState))
@pytest.mark.parametrize("sap", [0, 48, 49, 50, 51, 53, 54, 58, 63])
def test_saps_that_are_not_open(sap: int, state: SlaveAppState) -> None:
    """RS: the SAP is not active (docs/reference/protocol.md#function-code). Global_Control is no SRD."""
    slave = Slave().to(state)
    assert slave.ask(f"{sap:02X} 3E 00 00") == RS[2]
    assert slave.app.state is state


@pytest.mark.parametrize(
    ("unit", "da", "sa", "clear"),
    [
        ("3A 3E 02 00", 127, 2, True),
        ("3A 3E 02 02", 127, 2, True),  # group 2 is the slave's
        ("3A 3E 02 02", 8, 2, True),  # to the slave alone
        ("3A 3E 02 03", 127, 2, True),
        ("3A 3E 02 FF", 127, 2, True),
        ("3A 3E 02 01", 127, 2, False),  # another group
        ("3A 3E 02 FD", 127, 2, False),
        ("3A 3E 00 00", 127, 2, False),
        ("3A 3E C1 00", 127, 2, False),  # reserved bits
        ("3A 3E 02", 127, 2, False),  # one octet
        ("3A 3E 02 00 00", 127, 2, False),  # three
        ("3A 3E", 127, 2, False),
        ("3A 3E 02 00", 127, 9, False),  # not the owner
        ("39 3E 02 00", 127, 2, False),  # another SAP
        ("3A 3E 02 00", 7, 2, False),  # another station
    ],
)
def test_global_control(unit: str, da: int, sa: int, clear: bool) -> None:
    slave = Slave().to(DATA_EXCH)
    assert slave.wire.ask(framed(0x80 | da, 0x80 | sa, 0x46, unit)) == ""
    assert slave.app.clear is clear
    assert slave.seen[1:] == ([b"\0\0"] if clear else [])
    slave.wire.ask(framed(0xFF, 0x82, 0x46, "3A 3E 00 00"))
    assert not slave.app.clear
    assert slave.exchange("01 02") == answer("FE")
