"""Auto-clear, slaves out of service, slaves parameterised anew."""

from __future__ import annotations

import pytest
from scripted_link import CHK_CFG, DIAG, MS, RUN, SAFE, SET_PRM, data, link, mode_of, operating, setup, squeezed, wire

from dpstack.dp.master.commands import ActivateSlave, DeactivateSlave, Mode, ReparameteriseSlave, SetMode
from dpstack.dp.master.events import AutoCleared, OperateWaits, SlaveState
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SHORT_ACK, Telegram

# --- auto-clear -----------------------------------------------------------------------------------------------------


def test_operate_with_auto_clear_waits_for_all_slaves() -> None:
    bus = link(setup(3), setup(4), auto_clear=True)
    with bus.without(4):
        bus.send(SetMode(Mode.OPERATE), 500 * MS)
        assert mode_of(bus) is Mode.CLEAR
        (waits,) = bus.events_of(OperateWaits)
        assert waits.slaves == (3, 4)
    bus.run(1_500 * MS)
    assert mode_of(bus) is Mode.OPERATE


def test_auto_clear_after_the_data_control_time_and_back_by_order_only() -> None:
    bus = operating(setup(3), setup(4, safe=SAFE, initial=RUN), auto_clear=True, data_control_ns=300 * MS)
    began = bus.now
    with bus.without(3):
        while bus.master.mode is Mode.OPERATE:
            bus.hold()
    (cleared,) = bus.events_of(AutoCleared)
    assert 299 * MS <= cleared.t_ns - began <= 310 * MS
    assert cleared.slaves == (3,)
    assert "slave 3 (s3) had no data exchange for 300 ms (stopped answering during Data_Exchange)" in cleared.text
    assert squeezed([e for e in wire(bus, 4) if e[0] is None])[1] == (None, "04 7E 00 00")  # safe values first
    bus.run(2_000 * MS)
    assert bus.state(3) is SlaveState.DATA_EXCHANGE
    assert mode_of(bus) is Mode.CLEAR
    bus.send(SetMode(Mode.OPERATE), 5 * MS)
    assert mode_of(bus) is Mode.OPERATE


@pytest.mark.parametrize("how", ["off", "ignored", "deactivated"])
def test_no_auto_clear_for_a_slave_that_does_not_count(how: str) -> None:
    bus = operating(setup(3), setup(4, ignore_auto_clear=how == "ignored"), auto_clear=how != "off")
    if how == "deactivated":
        bus.send(DeactivateSlave(4), 100 * MS)
    del bus.slaves[4]
    bus.run(3_000 * MS)
    assert mode_of(bus) is Mode.OPERATE


# --- out of service, parameterised anew -----------------------------------------------------------------------------


def test_deactivate_and_activate() -> None:
    bus = operating(setup(3, safe=SAFE, initial=RUN), setup(4))
    bus.send(DeactivateSlave(3))
    assert bus.state(3) is SlaveState.DEACTIVATED
    bus.run(2_000 * MS)
    assert squeezed(wire(bus)) == [(None, "04 7E 00 00"), (61, "40 01 01 0B 06 96 00")]
    assert not bus.image.valid
    bus.slave.configured = False
    bus.send_anew(ActivateSlave(3), 20 * MS)
    assert squeezed(wire(bus))[:5] == [DIAG, SET_PRM, CHK_CFG, DIAG, (None, "04 7F 40 00")]
    assert bus.states(3)[0] == "deactivated"


def test_parameterised_anew_while_the_bus_runs() -> None:
    bus = operating(setup(3, safe=SAFE, initial=RUN), setup(4))
    image = bus.image
    slave = bus.slave

    def unlocked(request: Request) -> Telegram:
        slave.configured = False
        return SHORT_ACK

    slave.answers[61] = unlocked
    others = bus.master.handlers[4].exchanges
    order = ReparameteriseSlave(setup(3, user_prm=b"\xaa", groups=(2,), watchdog_ms=500, safe=SAFE))
    bus.send(order, 100 * MS)
    assert squeezed(wire(bus))[:7] == [
        (None, "04 7E 00 00"),
        (61, "40 01 01 0B 06 96 00"),
        DIAG,
        (61, "88 01 32 0B 06 96 02 AA"),
        CHK_CFG,
        DIAG,
        (None, "04 7F 40 00"),
    ]
    assert bus.image is image
    assert bus.master.handlers[4].exchanges - others > 100  # nobody else noticed


def test_other_lengths_make_a_new_image() -> None:
    bus = operating(setup(3))
    bus.send(ReparameteriseSlave(setup(3, config=b"\x20\x10")))
    image = bus.image
    assert (image.inputs, image.outputs) == (b"\x00", b"\x00")


def test_an_answer_to_the_old_parameters_is_nobodys() -> None:
    bus = operating(setup(3))
    request = bus.next_request()
    bus.send(DeactivateSlave(3))
    bus.master.result(request, data(request, b"\xff" * 4), bus.now)
    assert not bus.image.valid
    assert bus.image.inputs == bytes(4)
