"""``after_return = "safe"``: after a slave was away its outputs stay at their safe values until they are set anew.

Everything is judged by the octets that the master sends; the slaves are scripts of octets.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from property_kit import examples
from scripted_link import (
    DIAG_FREE,
    DIAG_NOT_READY,
    DIAG_PRM_FAULT,
    DIAG_READY,
    MS,
    RUN,
    SAFE,
    ScriptedLink,
    ScriptedPlugin,
    ScriptedSlave,
    link,
    mode_of,
    operating,
    outputs,
    refuses,
    setup,
    silent,
)

from dpstack.dp.master.commands import (
    ActivateSlave,
    DeactivateSlave,
    Mode,
    ReparameteriseSlave,
    SetMode,
)
from dpstack.dp.master.events import ApplicationSilent, OutputsWithheld, SlaveState, Stalled
from dpstack.machine import LineDown, LineUp

ZEROS = bytes(4)
ANEW = b"\x04\x7f\x20\x00"


def waits(**changes: Any) -> Any:
    return setup(after_return="safe", safe=SAFE, **changes)


def running(*addresses: int, **options: Any) -> ScriptedLink:
    """Slaves with the outputs RUN, set before they were there, in Operate."""
    return operating(*(waits(address=address, initial=RUN) for address in addresses or (3,)), **options)


def set_outputs(bus: ScriptedLink, octets: bytes, address: int = 3) -> None:
    bus.master.handlers[address].set_outputs(octets)


def withheld(bus: ScriptedLink) -> list[bytes]:
    return [event.outputs for event in bus.events_of(OutputsWithheld)]


def waiting(bus: ScriptedLink) -> bytes | None:
    return bus.image.withheld


def switched_off(bus: ScriptedLink) -> None:
    with bus.without(3):
        bus.run_long(2_000 * MS)
        assert bus.state(3) is SlaveState.OFFLINE
    bus.run_long(2_000 * MS)


def restarted(bus: ScriptedLink) -> None:
    """It answers the next request with RS, and wants parameters."""
    bus.slave.configured = False
    bus.run_long(1_500 * MS)


def asks_for_parameters(bus: ScriptedLink) -> None:
    """Its diagnosis in data exchange has Prm_Req."""
    bus.slave.ready = DIAG_FREE
    bus.high_answer()
    bus.run(MS)
    bus.slave.ready = DIAG_READY
    bus.run_long(1_500 * MS)


def refused_parameters(bus: ScriptedLink) -> None:
    bus.slave.ready = DIAG_PRM_FAULT
    bus.high_answer()
    bus.run_long(500 * MS)
    assert bus.state(3) is SlaveState.FAULT
    bus.slave.ready = DIAG_READY
    bus.run_long(12_000 * MS)


def busy(bus: ScriptedLink) -> None:
    bus.slave.answers[None] = refuses(0x02)
    bus.run_long(500 * MS)
    del bus.slave.answers[None]
    bus.run_long(2_000 * MS)


def out_of_service(bus: ScriptedLink) -> None:
    bus.send(DeactivateSlave(3), 100 * MS)
    bus.slave.configured = False
    bus.send(ActivateSlave(3), 100 * MS)


def other_parameters(bus: ScriptedLink) -> None:
    bus.send(ReparameteriseSlave(waits(user_prm=b"\x07")), 100 * MS)


def port_lost(bus: ScriptedLink) -> None:
    bus.send(LineDown("unplugged"))
    bus.slave.configured = False
    bus.now += 100 * MS
    bus.send(LineUp(), 100 * MS)


def stopped_and_operated(bus: ScriptedLink) -> None:
    bus.send(SetMode(Mode.STOP), 500 * MS)
    bus.slave.configured = False
    bus.send(SetMode(Mode.OPERATE))
    bus.run_long(1_500 * MS)


def cleared_and_operated(bus: ScriptedLink) -> None:
    """The slave never leaves data exchange: its outputs were safe all the same, and a drive would not go on."""
    bus.send(SetMode(Mode.CLEAR), 100 * MS)
    bus.send(SetMode(Mode.OPERATE), 20 * MS)


def operated_on_its_way_down(bus: ScriptedLink) -> None:
    bus.send(SetMode(Mode.CLEAR), 20 * MS)
    assert mode_of(bus) is Mode.OPERATE
    bus.send(SetMode(Mode.OPERATE), 20 * MS)


def stalled(bus: ScriptedLink) -> None:
    stall(bus)
    bus.slave.configured = False
    bus.run_long(1_500 * MS)
    assert bus.events_of(Stalled)
    bus.send(SetMode(Mode.OPERATE), 20 * MS)


@pytest.mark.parametrize(
    "away",
    [
        switched_off,
        restarted,
        asks_for_parameters,
        refused_parameters,
        busy,
        out_of_service,
        other_parameters,
        port_lost,
        stopped_and_operated,
        cleared_and_operated,
        operated_on_its_way_down,
        stalled,
    ],
)
def test_after_each_way_of_being_away_outputs_are_safe_until_they_are_set_anew(away: Any) -> None:
    bus = running()
    bus.run(20 * MS)
    assert outputs(bus) == [RUN]
    bus.requests.clear()
    bus.run(1)
    away(bus)
    assert (bus.state(3), mode_of(bus)) == (SlaveState.DATA_EXCHANGE, Mode.OPERATE)
    sent = outputs(bus)
    while sent[0] == RUN:  # before it was away
        del sent[0]
    assert RUN not in sent
    assert sent[-1] == SAFE
    assert set(sent) <= {SAFE, ZEROS}  # zeros are those of Clear
    assert withheld(bus) == [RUN]  # reported once
    assert waiting(bus) == RUN
    bus.requests.clear()
    bus.run(100 * MS)
    assert outputs(bus) == [SAFE]
    set_outputs(bus, ANEW)
    bus.requests.clear()
    bus.run(20 * MS)
    assert outputs(bus) == [ANEW]
    assert waiting(bus) is None
    assert withheld(bus) == [RUN]


def test_resume_is_the_default_and_sends_the_old_outputs_at_once() -> None:
    bus = operating(setup(initial=RUN, safe=SAFE))
    bus.requests.clear()
    restarted(bus)
    assert outputs(bus) == [RUN]
    assert withheld(bus) == []


def test_the_event_says_which_slave_waits_and_what_to_do() -> None:
    bus = running()
    restarted(bus)
    (event,) = bus.events_of(OutputsWithheld)
    assert event.text == (
        "slave 3 (s3): it was away, and its outputs stay at their safe values until they are set anew "
        '(after_return = "safe"); 047f4000 is withheld: look at the plant, then set its outputs'
    )


def test_a_slave_that_goes_away_again_meanwhile_is_reported_once() -> None:
    bus = running()
    restarted(bus)
    restarted(bus)
    assert withheld(bus) == [RUN]
    set_outputs(bus, ANEW)
    restarted(bus)
    assert withheld(bus) == [RUN, ANEW]


def test_only_the_slave_that_was_away_waits() -> None:
    bus = running(3, 4)
    restarted(bus)
    bus.requests.clear()
    bus.run(20 * MS)
    assert (outputs(bus, 3), outputs(bus, 4)) == ([SAFE], [RUN])


def test_outputs_that_are_set_while_it_is_away_are_withheld_too() -> None:
    """An order must not act at some later time, when somebody switches the drive on."""
    bus = running()
    bus.requests.clear()
    with bus.without(3):
        bus.run_long(500 * MS)
        set_outputs(bus, ANEW)
        bus.run_long(500 * MS)
    bus.run_long(2_000 * MS)
    assert outputs(bus)[-1] == SAFE
    assert ANEW not in outputs(bus)
    assert withheld(bus) == [ANEW]


def test_a_slave_that_was_reported_as_absent_at_the_start_was_away() -> None:
    bus = link(waits(initial=RUN), slaves={})
    bus.send(SetMode(Mode.OPERATE), 500 * MS)
    assert bus.faults(3) == ["absent"]
    bus.slaves[3] = ScriptedSlave()
    bus.run_long(3_000 * MS)
    assert outputs(bus) == [SAFE]
    assert withheld(bus) == [RUN]


def test_a_slave_that_is_not_ready_yet_at_the_start_was_not_away() -> None:
    bus = link(waits(initial=RUN))
    bus.slave.ready = DIAG_NOT_READY
    bus.send(SetMode(Mode.OPERATE), 500 * MS)
    bus.slave.ready = DIAG_READY
    bus.run(2_000 * MS)
    assert outputs(bus) == [RUN]
    assert withheld(bus) == []


def test_a_repeated_telegram_is_no_absence() -> None:
    bus = running()
    bus.slave.answers[None] = refuses(0x02)
    bus.hold()
    del bus.slave.answers[None]
    bus.requests.clear()
    bus.run(20 * MS)
    assert outputs(bus) == [RUN]


def test_safe_outputs_are_nothing_to_wait_for() -> None:
    bus = running()
    set_outputs(bus, SAFE)
    restarted(bus)
    assert withheld(bus) == []
    assert waiting(bus) is None


def test_one_of_two_values_set_anew_leaves_the_other_one_safe() -> None:
    """The outputs of the process image are the safe ones, so a value is put into those."""
    bus = running()
    restarted(bus)
    octets = bytearray(bus.image.outputs)
    octets[0:2] = b"\x04\x7f"
    set_outputs(bus, bytes(octets))
    bus.requests.clear()
    bus.run(20 * MS)
    assert outputs(bus) == [b"\x04\x7f\x00\x00"]


def test_outputs_set_in_clear_are_those_of_the_next_operate() -> None:
    bus = running()
    bus.send(SetMode(Mode.CLEAR), 100 * MS)
    set_outputs(bus, ANEW)
    bus.requests.clear()
    bus.send(SetMode(Mode.OPERATE), 20 * MS)
    assert outputs(bus) == [ANEW]
    assert withheld(bus) == []


def test_a_slave_that_comes_back_in_clear_is_reported_in_operate() -> None:
    bus = running()
    bus.send(SetMode(Mode.CLEAR), 100 * MS)
    restarted(bus)
    assert withheld(bus) == []
    bus.send(SetMode(Mode.OPERATE), 20 * MS)
    assert withheld(bus) == [RUN]


def test_the_application_watchdog_is_a_way_too() -> None:
    bus = running(application_watchdog_ns=100 * MS)
    bus.run(200 * MS)
    assert bus.events_of(ApplicationSilent)
    bus.requests.clear()
    bus.send(SetMode(Mode.OPERATE), 20 * MS)
    assert outputs(bus) == [SAFE]
    assert withheld(bus) == [RUN]


def test_a_drive_plugin_makes_the_outputs_itself() -> None:
    bus = running()
    bus.image.plugin = plugin = ScriptedPlugin()
    restarted(bus)
    assert plugin.losses == 1
    assert outputs(bus)[-1] == plugin.outputs
    assert withheld(bus) == []


def silence(bus: ScriptedLink) -> None:
    bus.slave.answers.update({None: silent, 60: silent, 61: silent, 62: silent})


def answer_again(bus: ScriptedLink) -> None:
    if bus.slave.answers:
        bus.slave.answers.clear()
        bus.slave.configured = False


def reset(bus: ScriptedLink) -> None:
    bus.slave.configured = False


def stall(bus: ScriptedLink) -> None:
    bus.now += 300 * MS


def port_fails(bus: ScriptedLink) -> None:
    bus.send(LineDown("unplugged"))
    bus.send(LineUp())


def leave_service(bus: ScriptedLink) -> None:
    bus.send(DeactivateSlave(3))
    bus.send(ActivateSlave(3))


#: what may happen to a bus, in any order
_STEPS: dict[str, Callable[[ScriptedLink], object]] = {
    "away": silence,
    "return": answer_again,
    "restart": reset,
    "set": lambda bus: set_outputs(bus, ANEW),
    "stall": stall,
    "operate": lambda bus: bus.send(SetMode(Mode.OPERATE)),
    "clear": lambda bus: bus.send(SetMode(Mode.CLEAR)),
    "stop": lambda bus: bus.send(SetMode(Mode.STOP)),
    "port": port_fails,
    "parameters": lambda bus: bus.send(ReparameteriseSlave(waits(user_prm=b"\x07"))),
    "service": leave_service,
}
_HOLDS = (0, 1, 5, 200)


@examples(20)
@given(st.lists(st.tuples(st.sampled_from(sorted(_STEPS)), st.sampled_from(_HOLDS)), max_size=12))
@example([("clear", 200), ("operate", 5)])
@example([("clear", 1), ("operate", 5)])
@example([("away", 200), ("set", 0)])
@example([("stall", 200), ("set", 0), ("operate", 200)])
@example([("stop", 200), ("set", 200), ("operate", 200)])  # set on the way down is set after the way out
def test_in_any_order_of_events_nothing_but_safe_outputs_until_they_are_set(steps: list[tuple[str, int]]) -> None:
    """The referee knows the wire and the orders: after a bring-up (Set_Prm), and after each way out of Operate, no
    other outputs go out than safe ones and the zeros of Clear before outputs are set."""
    bus = running()
    bus.run(5 * MS)
    may_be_live = True
    ordered_down = False

    def judge() -> None:
        nonlocal may_be_live
        for request in bus.requests:
            if request.dsap == 61:
                may_be_live = False
            elif request.da == 3 and request.dsap is None and request.data not in (SAFE, ZEROS):
                assert may_be_live, request
        bus.requests.clear()

    judge()
    for name, holds in steps:
        before = mode_of(bus)
        if name == "set":
            may_be_live = bus.state(3) is SlaveState.DATA_EXCHANGE
        elif name in ("clear", "stop") and before is Mode.OPERATE:
            may_be_live = False
        if name in ("clear", "stop", "operate"):
            ordered_down = name != "operate"
        _STEPS[name](bus)
        for _ in range(holds):
            bus.hold()
        judge()
        if before is Mode.OPERATE is not mode_of(bus) and not ordered_down:  # by itself
            may_be_live = False
    answer_again(bus)
    bus.hold()  # a stall is found
    bus.send(SetMode(Mode.OPERATE))
    bus.run_long(3_000 * MS)
    judge()
    set_outputs(bus, ANEW)
    bus.run(20 * MS)
    assert outputs(bus)[-1] == ANEW
