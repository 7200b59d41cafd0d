"""Triggers and windows of a capture: by literal telegrams, by what the world did, and by every order of times."""

from __future__ import annotations

import pytest
from bus_kit import SimBus
from hypothesis import given
from hypothesis import strategies as st
from support import S

from dpstack.capture.listener import Listener
from dpstack.capture.transmission import Damage, Transmission
from dpstack.errors import UsageError
from dpstack.monitor.triggers import Triggers, Window, parse_trigger
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.units import NS_PER_MS

TOKEN = bytes.fromhex("DC 02 02")
POLL = bytes.fromhex("68 04 04 68 03 02 5D 07 69 16")
NEXT = bytes.fromhex("68 04 04 68 03 02 7D 07 89 16")
ANSWER = bytes.fromhex("68 04 04 68 02 03 08 AA B7 16")


def fired(*texts: str, octets: tuple[bytes, ...], damage: int = 0) -> list[str]:
    triggers = Triggers([parse_trigger(text) for text in texts])
    return [
        triggers.add(Transmission(one, n * NS_PER_MS, 500_000, "", damage if one == octets[-1] else 0))
        for n, one in enumerate(octets)
    ]


def test_stations_patterns_and_damage() -> None:
    assert fired("station 3", octets=(TOKEN, POLL, ANSWER)) == ["", "station 3", "station 3"]
    assert fired("03 02 5D", "8AA".replace("8", "08"), octets=(TOKEN, POLL, ANSWER)) == ["", "03 02 5d", "08 aa"]
    assert fired("bad fcs", octets=(TOKEN, ANSWER[:-2]), damage=Damage.FCS) == ["", "bad fcs"]
    assert fired("bad fcs", octets=(TOKEN, ANSWER[:-2]), damage=Damage.TOO_SHORT) == ["", ""]
    assert fired("damaged", octets=(TOKEN, ANSWER[:-2]), damage=Damage.TOO_SHORT) == ["", "damaged"]


def test_retries_by_depth() -> None:
    assert fired("retry>2", octets=(POLL,) * 5) == ["", "", "", "retry>2 (repetition 3)", "retry>2 (repetition 4)"]
    assert fired("retry", octets=(POLL, ANSWER, NEXT, NEXT, ANSWER))[3] == "retry (repetition 1)"
    noise = fired("retry>0", octets=(POLL, POLL, b"\x00", POLL))
    assert [bool(reason) for reason in noise] == [False, True, False, True]


def test_a_lost_station_and_its_diagnosis() -> None:
    world = World()
    bus = SimBus(world, BusParams.preset(500_000, address=2), [3, 4])
    triggers = Triggers([parse_trigger("lost"), parse_trigger("diagnosis")])
    reasons: list[str] = []

    def heard(one: Transmission) -> None:
        if reason := triggers.add(one):
            reasons.append(reason)

    world.add(Listener(world.now, heard, baud=500_000), name="listener")
    assert world.run(world.now + 60 * S, lambda: bus.exchanging)
    world.run_for(10 * NS_PER_MS)
    assert {reason.split()[0] for reason in reasons} == {"diagnosis"}
    reasons.clear()
    world.remove(bus.slaves[3])
    assert world.run(world.now + S, lambda: bool(reasons))
    assert reasons == ["lost (station 3 left data exchange)"]


@pytest.mark.parametrize("text", ["", "retry>", "station 128", "station x", "nonsense", "6", "68 0"])
def test_unknown_triggers_name_the_known_ones(text: str) -> None:
    with pytest.raises(UsageError, match=r"retry>2|addresses are 0\.\.127"):
        parse_trigger(text)


@given(st.lists(st.tuples(st.integers(0, 20), st.booleans())), st.integers(0, 30), st.integers(0, 30))
def test_a_window_keeps_what_lies_around_its_triggers(steps: list[tuple[int, bool]], before: int, after: int) -> None:
    window: Window[int] = Window(before, after)
    t = 0
    times: list[int] = []
    triggers: list[int] = []
    kept: list[int] = []
    left_out = 0
    for n, (step, fires) in enumerate(steps):
        t += step
        times.append(t)
        if fires:
            triggers.append(n)
        for one in window.add(t, 10, n, "x" if fires else ""):
            kept.append(one.item)
            if "not kept" in one.remark:
                left_out += int(one.remark.split()[0])
    # a window is open from a trigger on until its time is over, in the order of the items
    wanted = {
        n
        for n, at in enumerate(times)
        for trigger in triggers
        if (n <= trigger and times[trigger] - at <= before) or (n >= trigger and at - times[trigger] <= after)
    }
    assert kept == sorted(wanted)
    if triggers:
        assert left_out == sum(n not in wanted for n in range(max(kept) + 1))


def test_memory_is_bounded_and_a_remark_says_where_it_was_not_enough() -> None:
    window: Window[int] = Window(1_000_000, 0, most=10_000)
    for n in range(1_000):
        assert window.add(n, 250, n, "") == []
    kept = window.add(1_000, 250, 1_000, "lost")
    assert len(kept) == 10_000 // 500 + 1
    assert kept[0].remark.startswith("980 transmissions before this one were not kept (0.001 s before the trigger need")
    assert kept[-1].remark == "trigger: lost"
