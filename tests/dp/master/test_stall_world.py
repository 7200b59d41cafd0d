"""A stall on a simulated bus with a referee: the slaves' watchdogs run out, and nothing old goes out afterwards."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import pytest
from bus_kit import SimBus
from ends.telegrams import table
from scripted_link import MS, RUN, SAFE, ScriptedLink, mode_of, operating, setup, wire
from support import present

from dpstack.api.bus.events_json import event_json
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import ForcedClear, Stalled
from dpstack.dp.slave.events import WatchdogExpired
from dpstack.machine import HeldUp, LineDown, LineUp
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event, WireEntry

TURNS = bytes(8) + b"\x04\x7f\x40\x00"


def outputs(entries: list[WireEntry], address: int) -> set[bytes]:
    """The data of Data_Exchange (SD2 without SAPs) to ``address``, from the octets on the wire."""
    found = [e.octets for e in entries if e.octets[:1] == b"\x68" and e.octets[4] == address and e.octets[6] & 0x40]
    return {octets[7:-2] for octets in found}


@pytest.mark.parametrize(("away_ms", "clear"), [(900, True), (100, False)])
def test_a_master_that_was_away(away_ms: int, clear: bool) -> None:
    """Nobody runs it for a while, as after SIGSTOP, and everything else goes on."""
    world = World()
    bus = SimBus(world, BusParams.preset(500_000, address=2), [3, 4]).until_exchanging()
    for image in bus.master.images.values():
        image.outputs = TURNS
    world.run_for(50 * MS)
    entries: list[WireEntry] = []
    world.log.listener = entries.append
    world.run_for(20 * MS)
    assert outputs(entries, 3) == outputs(entries, 4) == {TURNS}
    world.remove(bus.station)
    entries.clear()
    world.run_for(away_ms * MS)
    world.add(bus.station, on_events=bus.events.extend)
    world.run_for(2_000 * MS)
    assert bus.exchanging
    stalls = [event for event in bus.events if isinstance(event, Stalled)]
    if not clear:
        assert (bus.master.mode, stalls) == (Mode.OPERATE, [])
        assert outputs(entries, 3) == outputs(entries, 4) == {TURNS}
        return
    assert bus.master.mode is Mode.CLEAR
    assert outputs(entries, 3) == outputs(entries, 4) == {bytes(12)}
    (stall,) = stalls
    assert stall.blocked is None  # nobody told the master
    assert present(stall.gap_ns) >= away_ms * MS
    world.command(bus.station, SetMode(Mode.OPERATE))
    world.run_for(50 * MS)
    assert TURNS in outputs(entries, 3) & outputs(entries, 4)
    present(world.referee).check()  # (after a short absence it takes the master that comes back for a second one)


def test_a_slave_says_that_its_watchdog_ran_out() -> None:
    """What the master takes for a stall is what the slave tells."""
    world = World()
    bus = SimBus(world, BusParams.preset(500_000, address=2), [3]).until_exchanging()
    world.remove(bus.station)
    told: list[Event] = []
    world.remove(bus.slaves[3])
    world.add(bus.slaves[3], on_events=told.extend)
    world.run_for(300 * MS)
    assert [type(event) for event in told if isinstance(event, WatchdogExpired)] == [WatchdogExpired]


# --- docs/explanation/ends.md, "While the bus goes on", row by row: what the slaves are given next, and what is told


GAP: Final = 500 * MS
OUTPUTS: Final = {"04 7F 40 00": "live outputs", "04 7E 00 00": "safe values", "00 00 00 00": "zeros"}


def stopped(bus: ScriptedLink) -> None:
    bus.now += GAP
    bus.send(HeldUp(GAP, "the process was stopped for 500 ms"))


def suspended(bus: ScriptedLink) -> None:
    bus.send(HeldUp(GAP, "the computer was suspended for 500 ms", suspended=True))


def port(bus: ScriptedLink) -> None:
    bus.send(LineDown("pulled"))
    bus.now += GAP
    bus.send(LineUp())


def unsent(bus: ScriptedLink) -> None:
    bus.send(HeldUp(GAP, "the port took no octets for 500 ms", unsent=True))


def token(bus: ScriptedLink) -> None:
    bus.now += GAP


def prm_req(bus: ScriptedLink) -> None:
    for slave in bus.slaves.values():
        slave.configured = False


def short(bus: ScriptedLink) -> None:
    bus.now += 150 * MS
    bus.send(HeldUp(150 * MS, "the process was stopped for 150 ms"))


def restart(bus: ScriptedLink) -> None:
    with bus.without(3):
        bus.run(GAP)


def no_watchdog(bus: ScriptedLink) -> None:
    bus.now += 10 * GAP


def silent(bus: ScriptedLink) -> None:
    bus.run(GAP)


def missing(bus: ScriptedLink) -> None:
    del bus.slaves[3]


CASES: Final[dict[str, Callable[[ScriptedLink], None]]] = {
    case.__name__: case
    for case in (stopped, suspended, port, unsent, token, prm_req, short, restart, no_watchdog, silent, missing)
}
OPTIONS: Final[dict[str, dict[str, Any]]] = {
    "silent": {"application_watchdog_ns": 400 * MS},
    "missing": {"auto_clear": True},
}


@dataclass(frozen=True)
class Row:
    """One row of the table."""

    outputs: list[str]
    mode: str
    told: list[str]


#: by case and ``after_stall``
TABLE: Final = {
    (case, after_stall): Row(outputs.split(", "), mode.lower(), re.findall(r"`([^`]+)`", told))
    for case, (_, after_stall, outputs, mode, told, _back) in table("While the bus goes on", "what happens")
}


def test_the_table_has_every_case_with_both_settings() -> None:
    assert list(TABLE) == [(case, setting) for case in CASES for setting in ("safe", "resume")]


@pytest.mark.parametrize(("case", "after_stall"), list(TABLE))
def test_row(case: str, after_stall: str) -> None:
    row = TABLE[case, after_stall]
    watchdog = 0 if case == "no_watchdog" else None
    slaves = [setup(address, initial=RUN, safe=SAFE, watchdog_ms=watchdog) for address in (3, 4)]
    bus = operating(*slaves, safe_after_stall=after_stall == "safe", **OPTIONS.get(case, {}))
    CASES[case](bus)
    bus.run_long(4_000 * MS)
    taken = [r for r in bus.requests if r.da == 4 and r.dsap is None]
    if case in ("silent", "missing", "prm_req"):  # the outputs stay live until it is noticed
        live = next((n for n, r in enumerate(taken) if r.data != RUN), 0)
        taken = taken[live:]
    words = dict.fromkeys(OUTPUTS[r.data.hex(" ").upper()] for r in taken)
    assert list(words) == row.outputs
    assert mode_of(bus).name.lower() == row.mode
    told = [line for e in bus.events_of(ForcedClear) if (line := event_json(e, 0)) is not None]
    assert [word for line in told for word in (line["event"], line.get("blocked")) if word is not None] == row.told
    assert wire(bus)
