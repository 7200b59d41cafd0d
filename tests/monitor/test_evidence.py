"""A bus is named PROFIBUS on evidence over time only; M-Bus and IEC 60870-5-101, which have its frames, never are."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from bus_kit import SimBus, setup
from fire_kit import FireRing
from ft12 import CONVERSATIONS, SC, fixed, frame, repeated
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples
from support import MS, S

from dpstack.capture.cutter import Cutter
from dpstack.capture.listener import Listener
from dpstack.capture.timing import LineTiming
from dpstack.capture.transmission import Transmission
from dpstack.fdl.baud_search import BaudFound
from dpstack.fdl.codec import encode_sd1, encode_sd2, encode_token
from dpstack.monitor.evidence import ENOUGH, Naming
from dpstack.monitor.monitor import Monitor
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event
from dpstack.units import BITS_PER_CHAR, chars_to_ns


def heard(telegrams: Iterable[bytes], baud: int = 9600, together: int = 1) -> Naming:
    """What a listener says to these telegrams; ``together``: so many arrive in one piece."""
    cutter, naming = Cutter(baud, chars_to_ns(3, baud)), Naming()
    now, chunk, count = 1_000 * S, b"", 0
    for octets in telegrams:
        now += chars_to_ns(len(octets) + 5, baud)
        chunk += octets
        count += 1
        if count % together:
            continue
        if cutter.stall_at() <= now - chars_to_ns(len(chunk), baud):
            for one in cutter.give_up():
                naming.add(one)
        for one in cutter.feed(chunk, now):
            naming.add(one)
        chunk = b""
    return naming


def test_the_telegrams_of_the_others_are_whole() -> None:
    """Lengths and check sums, in this test's own words."""
    for octets in {octets for telegrams in CONVERSATIONS.values() for octets in telegrams} - {SC}:
        body = octets[1:-2] if octets[0] == 0x10 else octets[4:-2]
        assert octets[-2:] == bytes((sum(body) % 256, 0x16))
        assert octets[0] == 0x10 or octets[:4] == bytes((0x68, len(body), len(body), 0x68))


@pytest.mark.parametrize("together", [1, 2, 40])
@pytest.mark.parametrize("baud", [9600, 19_200])
@pytest.mark.parametrize("name", CONVERSATIONS)
def test_another_protocol_is_never_named_profibus(name: str, baud: int, together: int) -> None:
    naming = heard(repeated(CONVERSATIONS[name], 600), baud, together)
    assert not naming.is_profibus
    assert "M-Bus and IEC 60870-5-101 have too" in naming.text


@examples(20)
@given(
    links=st.lists(st.integers(0, 255), min_size=1, max_size=6),
    wide=st.booleans(),
    steps=st.lists(
        st.tuples(
            st.sampled_from([0x40, 0x44, 0x49, 0x53, 0x5A, 0x5B, 0x73, 0x7A, 0x7B, 0xC0, 0xC9, 0xD3, 0xF3]),
            st.sampled_from([0x00, 0x01, 0x08, 0x09, 0x0B, 0x18, 0x20, 0x28, 0x38, 0x80, 0x8B]),
            st.integers(0, 127),
            st.booleans(),
            st.sampled_from(["sc", "fixed", "frame", "none"]),
        ),
        min_size=1,
        max_size=12,
    ),
)
def test_no_conversation_of_ft12_is_named(
    links: list[int], wide: bool, steps: list[tuple[int, int, int, bool, str]]
) -> None:
    """Any addresses, control fields as the standard has them, any type (below 128, as published), any answers."""
    telegrams = []
    for number in range(25):
        for step, (asks, answers, kind, long, reply) in enumerate(steps):
            at = links[(number + step) % len(links)]
            link = bytes((at, at >> 4)) if wide else bytes((at,))
            telegrams.append(frame(asks, link, bytes((kind, 1, 6, 1, 0, 0, 20))) if long else fixed(asks, link))
            if reply == "frame":
                telegrams.append(frame(answers, link, bytes((kind, 1, 7, 1, 0, 0, 20))))
            elif reply != "none":
                telegrams.append(SC if reply == "sc" else fixed(answers, link))
    assert not heard(telegrams).is_profibus


@pytest.mark.parametrize("baud", [300, 1200, 2400, 4800, 9600, 19_200])
@pytest.mark.parametrize("name", CONVERSATIONS)
def test_a_listener_that_searches_the_rate_names_nothing(name: str, baud: int) -> None:
    """On the bit-accurate medium: rates that PROFIBUS has not are read at wrong rates."""
    world = World(referee=False, keep=10)
    naming, events = Naming(), list[Event]()
    world.add(Listener(0, naming.add), name="listener", on_events=events.extend)
    at = S
    for octets in repeated(CONVERSATIONS[name], 40 if baud < 9600 else 300):
        world.call_at(at, lambda octets=octets: world.inject(octets, baud=baud))  # type: ignore[misc]
        at += (len(octets) * BITS_PER_CHAR + 60) * S // baud
    world.run_until(at + S)
    assert not naming.is_profibus
    rates = {event.baud for event in events if isinstance(event, BaudFound)}
    assert rates <= {baud}
    # frames answered with E5, or fixed frames of six octets, are enough to know the rate
    assert bool(rates) == (baud >= 9600 and name not in ("M-Bus reading", "IEC 101 balanced", "IEC 101 recording"))


# --- what must be named ---


def listen(world: World, ns: int, *, without: tuple[int, ...] = ()) -> Naming:
    """What a listener says after ``ns``; it does not hear telegrams that begin with one of ``without``."""
    naming = Naming()

    def add(one: Transmission) -> None:
        if one.octets[0] not in without:
            naming.add(one)

    world.add(Listener(world.now, add, baud=500_000), name="listener")
    world.run_for(ns)
    return naming


PARAMS = BusParams.preset(500_000, address=2)
TOKEN = 0xDC


def test_a_lone_master_that_only_polls() -> None:
    world = World()
    SimBus(world, PARAMS, [5, 6], silent=[5, 6])
    naming = listen(world, 50 * MS)
    assert naming.is_profibus
    assert naming.text.startswith("PROFIBUS: ")


def test_one_master_with_one_slave() -> None:
    world = World()
    SimBus(world, PARAMS, [5])
    assert listen(world, 50 * MS).is_profibus


def test_a_bus_of_which_no_token_is_heard() -> None:
    world = World()
    bus = SimBus(world, PARAMS, [5, 6])
    bus.until_exchanging()
    assert listen(world, 50 * MS, without=(TOKEN,)).is_profibus


def test_a_slave_that_only_acknowledges_and_no_token() -> None:
    """Outputs only: the frame count bit turns with each request."""
    world = World(keep=50)
    bus = SimBus(world, PARAMS.replace(gap=0), [setup(5, config=bytes.fromhex("20"))])
    bus.until_exchanging()
    world.run_for(50 * MS)
    naming = listen(world, 50 * MS, without=(TOKEN,))
    assert naming.is_profibus
    assert {entry.octets for entry in world.log if entry.sender == "5"} == {SC}


def test_a_ring_of_masters() -> None:
    world = World()
    FireRing(world, PARAMS.replace(hsa=10, gap=1), (2, 3, 4))
    assert listen(world, 200 * MS).is_profibus


def test_a_bus_with_noise() -> None:
    world = World(seed=3, referee=False)
    bus = SimBus(world, PARAMS, [5, 6])
    bus.until_exchanging()
    world.faults.noise(1e-3)
    assert listen(world, 100 * MS).is_profibus


# --- the rule ---


def test_one_telegram_names_nothing_and_what_is_named_stays_named_at_its_rate() -> None:
    naming = Naming()
    assert naming.text == "no telegram of PROFIBUS's form"
    named = []
    times = [(encode_token(2, 2), 500_000)] * (ENOUGH + 1) + [(b"\x00", 500_000), (encode_token(2, 2), 9600)]
    for number, (octets, baud) in enumerate(times):
        naming.add(Transmission(octets, number * MS, baud))
        named.append(naming.is_profibus)
    # the first token was passed on by nobody
    assert named == [False] * ENOUGH + [True, True, False]


def test_evidence_is_weighed_against_what_does_not_fit() -> None:
    """A poll of FDL status and its answer, and as many answers that nobody asked for."""
    asks, answers = encode_sd1(5, 2, 0x49), encode_sd1(2, 5, 0x00)
    assert heard([asks, answers] * ENOUGH).is_profibus
    assert not heard([asks, answers, SC] * 100).is_profibus
    # chance in a long time: one answer that fits among many polls that nobody answers
    assert not heard(([asks] * 120 + [answers]) * ENOUGH * 2).is_profibus
    assert heard(([asks] * 80 + [answers]) * ENOUGH * 2).is_profibus
    assert not heard([encode_sd2(5, 2, 0x6D, b"\1"), SC] * 100).is_profibus  # the frame count bit never turns
    assert heard([encode_sd2(5, 2, 0x5D, b"\1"), SC, encode_sd2(5, 2, 0x7D, b"\1"), SC] * ENOUGH).is_profibus


@pytest.mark.parametrize("name", CONVERSATIONS)
def test_the_monitor_judges_no_bus_that_it_cannot_name(name: str) -> None:
    monitor = Monitor(LineTiming("file", None))
    for number, octets in enumerate(repeated(CONVERSATIONS[name], 4_000)):
        monitor.add(Transmission(octets, 1_000 * S + number * 10 * MS, 9600))
    summary = monitor.summary()
    assert (summary["profibus"], summary["verdict"]) == (False, "unknown")
    assert "M-Bus and IEC 60870-5-101 have too" in str(summary["reasons"])
