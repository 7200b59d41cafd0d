"""A device that shows another ident number until Set_Prm, and takes over the one in it (process devices)."""

from __future__ import annotations

import pytest
from scripted_link import CHK_CFG, DIAG, MS, ScriptedLink, ScriptedSlave, data, link, says, setup

from dpstack.dp.master.events import SlaveState
from dpstack.errors import ConfigError
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SHORT_ACK, Telegram

#: Slave_Diag of a flow meter with the maker's ident 4531: free, free after a refused Set_Prm, and in data exchange
OWN_FREE = bytes.fromhex("02 05 00 FF 45 31")
OWN_PRM_FAULT = bytes.fromhex("42 05 00 FF 45 31")
OWN_READY = bytes.fromhex("00 0C 00 02 45 31")
#: the same one adapted to the profile's ident 9700
ADAPTED_READY = bytes.fromhex("00 0C 00 02 97 00")
ADAPTED_PRM_FAULT = bytes.fromhex("42 05 00 FF 97 00")
#: Set_Prm with lock, watchdog factors 1 and 20, min T_SDR 11, ident 9700
SET_PRM = (61, "88 01 14 0B 97 00 00")
SAYS = "its diagnosis shows ident 0x4531; Set_Prm goes out once with the configured 0x9700, as its ident number adapts"


def meter(ready: bytes = ADAPTED_READY, *, adapts: bool = True) -> ScriptedLink:
    slave = ScriptedSlave(free=OWN_FREE, ready=ready)
    return link(setup(ident=0x9700, ident_adapts=adapts), slaves={3: slave})


def refusing(after_prm: bytes) -> ScriptedLink:
    """The meter's diagnosis is ``after_prm`` once it had a Set_Prm; Chk_Cfg is acknowledged."""
    bus = meter()

    def set_prm(_: Request) -> Telegram:
        bus.slave.answers[60] = says(after_prm)
        return SHORT_ACK

    bus.slave.answers |= {61: set_prm, 62: lambda _: SHORT_ACK}
    return bus


def prms(bus: ScriptedLink) -> int:
    return sum(request.dsap == 61 for request in bus.requests)


@pytest.mark.parametrize("ready", [ADAPTED_READY, OWN_READY])
def test_it_gets_set_prm_once_with_the_configured_number(ready: bytes) -> None:
    """Some devices show the configured number from Set_Prm on, some never."""
    bus = meter(ready)
    bus.run(5 * MS)
    sent = [(request.dsap, request.data.hex(" ").upper()) for request in bus.requests if request.dsap is not None]
    assert [entry for entry in sent if entry[0] in (60, 61, 62)] == [DIAG, SET_PRM, CHK_CFG, DIAG]
    assert bus.state(3) is SlaveState.DATA_EXCHANGE
    assert bus.remarks(3) == [SAYS]
    bus.high_answer()  # its diagnosis is read in data exchange
    bus.run(5 * MS)
    assert (bus.state(3), bus.faults(3), prms(bus)) == (SlaveState.DATA_EXCHANGE, [], 1)


def test_without_the_key_nothing_is_sent_and_the_message_names_it() -> None:
    bus = meter(adapts=False)
    bus.run(5 * MS)
    assert (prms(bus), bus.faults(3)) == (0, ["wrong_ident"])
    assert bus.only_fault().text.endswith(
        "is another device: ident 0x4531 instead of 0x9700; put the right device there, or correct drive, gsd or ident "
        '(ident = "ask" takes what is found); a process device that adapts its ident number needs '
        "ident = { configured = 0x9700, adapts = true }"
    )


@pytest.mark.parametrize(("after", "why"), [(OWN_PRM_FAULT, "Prm_Fault"), (OWN_FREE, "Prm_Req after Set_Prm")])
def test_one_that_refuses_is_another_device(after: bytes, why: str) -> None:
    bus = refusing(after)
    bus.run(500 * MS)
    assert (bus.state(3), bus.faults(3), prms(bus)) == (SlaveState.FAULT, ["wrong_ident"], 1)
    assert bus.only_fault().message == (
        f"is another device: ident 0x4531 instead of 0x9700, and it does not adapt ({why}): "
        "Set_Prm was 88 01 14 0b 97 00 00"
    )
    assert "IDENT_NUMBER_SELECTOR" in bus.only_fault().remedy


def test_one_that_has_adapted_and_refuses_refuses_the_parameters() -> None:
    bus = refusing(ADAPTED_PRM_FAULT)
    bus.run(500 * MS)
    assert bus.faults(3) == ["prm_fault"]


def test_after_a_power_cycle_it_is_brought_up_with_one_set_prm_again() -> None:
    bus = meter()
    bus.run(5 * MS)
    with bus.without(3):
        bus.run(5 * MS)
    bus.run(500 * MS)
    assert (bus.state(3), prms(bus), bus.remarks(3)) == (SlaveState.DATA_EXCHANGE, 2, [SAYS])


def test_a_third_number_in_data_exchange_is_another_device() -> None:
    bus = meter()
    bus.run(5 * MS)
    bus.slave.answers[60] = says(bytes.fromhex("00 0C 00 02 12 34"))
    bus.high_answer()
    bus.run(MS)
    assert bus.faults(3) == ["wrong_ident"]


def test_it_is_never_taken_away_from_another_master() -> None:
    bus = meter()
    bus.slave.answers[60] = lambda request: data(request, bytes.fromhex("00 0C 00 07 45 31"))
    bus.run(5 * MS)
    assert (prms(bus), bus.faults(3)) == (0, ["locked"])


def test_a_device_that_adapts_needs_a_number_to_adapt_to() -> None:
    with pytest.raises(ConfigError, match="needs one to adapt to: give configured"):
        setup(ident=None, ident_adapts=True)
