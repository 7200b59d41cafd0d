"""The referee finds every fault that scripted stations make, and nothing when all is well; orders are no faults.

Times at 500 kbit/s: a bit is 2 us. Preset there: T_SL 200, T_ID1 37, T_ID2 100, T_TO of station 2 is 10 T_SL = 2000.
"""

from __future__ import annotations

import pytest
from support import Dummy, WorldFactory, present

from dpstack.fdl.codec import encode_sd1, encode_sd2, encode_token
from dpstack.params import BusParams
from dpstack.sim.referee import RefereeError, Rule, TokenWatch
from dpstack.sim.world import World
from dpstack.units import chars_to_ns

BIT = 2_000
T_TO_2 = 2_000
PARAMS = BusParams.preset(500_000, address=2)

TOKEN = bytes.fromhex("DC 02 02")
ASK = bytes.fromhex("10 05 02 49 50 16")
ANSWER = bytes.fromhex("10 02 05 00 07 16")
SDN = bytes.fromhex("68 07 07 68 FF 82 46 3A 3E 00 00 3F 16")
SRD = encode_sd2(5, 2, 0x5D, b"\x01")
CLAIM_4 = encode_token(4, 4)
TO_4, TO_2, TO_9, FROM_9 = encode_token(4, 2), encode_token(2, 4), encode_token(9, 2), encode_token(2, 9)
ASK_OF_3 = encode_sd1(5, 3, 0x49)
E5 = b"\xe5"


#: sender, pause in bits, octets
Sent = tuple[object, int, bytes]


class Script:
    """Transmissions one after another, each ``pause`` bits after the one before has ended; then the verdict."""

    def __init__(self, world: WorldFactory, *, seed: int = 0, know: bool = True) -> None:
        self.world: World = world(seed=seed)
        self.referee = present(self.world.referee)
        self.stations: dict[object, Dummy] = {}
        self.at = 0
        if know:
            self.referee.know(PARAMS)

    def send(self, sender: object, pause: int, octets: bytes) -> None:
        """``sender`` is any name; a name of its own is a station of its own."""
        station = self.stations.get(sender)
        if station is None:
            station = self.stations[sender] = Dummy(octets[2] & 0x7F if len(octets) > 2 else 5)
            self.world.add(station, name=str(sender))
        self.at += pause * BIT
        station.plan.append((self.at, octets))
        self.world.poke(station)
        self.at += chars_to_ns(len(octets), 500_000)
        self.world.run_until(self.at)

    def play(self, *sent: Sent) -> None:
        for one in sent:
            self.send(*one)

    def claim(self, sender: object = "m2") -> None:
        self.send(sender, T_TO_2, TOKEN)

    def verdict(self) -> list[Rule]:
        """The violations found so far; the check of the fixture does not count them again."""
        self.world.run_for(1_000_000)
        found = [violation.rule for violation in self.referee.violations]
        self.referee.violations.clear()
        return found


@pytest.fixture
def script(world: WorldFactory) -> Script:
    return Script(world)


#: name, transmissions after station 2 claimed the token, violations found
SCRIPTS: list[tuple[str, list[Sent], list[Rule]]] = [
    # --- all is well ---
    (
        "a lone master within the rules",
        [
            ("m2", 37, TOKEN),
            ("m2", 37, ASK),
            ("s5", 11, ANSWER),
            ("m2", 37, SDN),
            ("m2", 100, TOKEN),
            ("m2", 37, ASK),  # nobody answers
            ("m2", 200, ASK),
            ("s5", 199, ANSWER),
            ("m2", 37, TOKEN),
        ],
        [],
    ),
    ("a short acknowledgement answers", [("m2", 37, SRD), ("s5", 11, E5), ("m2", 37, TOKEN)], []),
    # --- answers ---
    ("an answer too early", [("m2", 37, ASK), ("s5", 10, ANSWER)], [Rule.EARLY]),
    ("an answer after the slot time", [("m2", 37, ASK), ("s5", 200, ANSWER)], [Rule.LATE]),
    ("an answer nobody asked for", [("s5", 37, ANSWER), ("s5", 37, E5)], [Rule.UNASKED] * 2),
    ("an answer of another station", [("m2", 37, ASK), ("s6", 20, encode_sd1(2, 6, 0x00))], [Rule.UNASKED]),
    ("an answer to another master", [("m2", 37, ASK), ("s5", 20, encode_sd1(3, 5, 0x00))], [Rule.UNASKED]),
    ("a second answer", [("m2", 37, ASK), ("s5", 20, ANSWER), ("s5", 20, ANSWER)], [Rule.UNASKED]),
    ("an answer to an SDN", [("m2", 37, SDN), ("s5", 20, ANSWER)], [Rule.UNASKED]),
    # --- idle times ---
    (
        "T_ID1 before a token and a request",
        [("m2", 36, TOKEN), ("m2", 36, ASK), ("s5", 11, ANSWER), ("m2", 36, ASK)],
        [Rule.IDLE] * 3,
    ),
    ("T_ID2 after an SDN", [("m2", 37, SDN), ("m2", 99, ASK)], [Rule.IDLE]),
    ("a request repeated before the slot time is over", [("m2", 37, ASK), ("m2", 199, ASK)], [Rule.SLOT]),
    ("a token repeated before the slot time is over", [("m2", 37, TO_4), ("m2", 199, TO_4)], [Rule.SLOT]),
    # --- telegrams ---
    ("a gap inside a telegram", [("m2", 37, ASK[:4]), ("m2", 1, ASK[4:])], [Rule.BROKEN] * 2),
    # --- the token ---
    ("a request of a station that has not the token", [("m3", 37, ASK_OF_3)], [Rule.RIGHT]),
    ("a request after the token was passed on", [("m2", 37, TO_4), ("m2", 200, ASK)], [Rule.RIGHT]),
    ("a second token", [("m9", 37, FROM_9)], [Rule.TWO_TOKENS]),
    ("a second station with the holder's address", [("m2", 37, ASK), ("twin", 200, ASK)], [Rule.TWO_TOKENS]),
    ("a claim while another station has the token", [("m2", 37, ASK), ("m4", 500, CLAIM_4)], [Rule.CLAIM]),
    (
        "a claim after the holder fell silent is in order",
        [("m2", 37, ASK), ("m4", (6 + 2 * 4) * 200, CLAIM_4), ("m4", 37, CLAIM_4)],
        [],
    ),
    (
        "the holder that fell silent goes on after the claim",
        [("m2", 37, ASK), ("m4", (6 + 2 * 4) * 200, CLAIM_4), ("m4", 37, CLAIM_4), ("m2", 200, ASK)],
        [Rule.RIGHT],
    ),
    ("a member of the ring passed over", [("m2", 37, TO_4), ("m4", 37, TO_2), ("m2", 37, TO_9)], [Rule.ORDER]),
    (
        "a token to oneself while others are in the ring",
        [("m2", 37, TO_4), ("m4", 37, TO_2), ("m2", 37, TOKEN)],
        [Rule.ORDER],
    ),
    ("a successor given up too soon", [("m2", 37, TO_4), ("m2", 200, TO_4), ("m2", 200, TOKEN)], [Rule.ORDER]),
]


@pytest.mark.parametrize(("sent", "found"), [row[1:] for row in SCRIPTS], ids=[row[0] for row in SCRIPTS])
def test_violations_after_a_claim(script: Script, sent: list[Sent], found: list[Rule]) -> None:
    script.referee.know(PARAMS.replace(address=4))
    script.claim()
    script.play(*sent)
    assert script.verdict() == found


@pytest.mark.parametrize(
    ("sent", "found"),
    [(("m2", 5_000, ASK), Rule.RIGHT), (("m2", T_TO_2 - 1, TOKEN), Rule.CLAIM)],
    ids=["a request before any token", "a claim before T_TO"],
)
def test_violation_before_a_claim(script: Script, sent: Sent, found: Rule) -> None:
    script.play(sent)
    assert script.verdict() == [found]


def test_a_ring_of_three_within_the_rules(script: Script) -> None:
    script.claim()
    script.play(
        ("m2", 37, TOKEN),
        ("m2", 37, TO_4),
        ("m4", 37, TO_2),
        ("m2", 37, TO_4),
        ("m4", 37, encode_token(9, 4)),
        ("m9", 37, encode_sd1(5, 9, 0x49)),
        ("s5", 20, encode_sd1(9, 5, 0x00)),
        ("m9", 37, FROM_9),
        ("m2", 37, TO_4),
    )
    assert script.referee.tokens.ring == {2, 4, 9}
    # 4 is dead: three attempts, then the next one
    script.play(("m2", 200, TO_4), ("m2", 200, TO_4), ("m2", 200, TO_9), ("m9", 37, FROM_9))
    assert script.referee.tokens.ring == {2, 9}
    assert script.verdict() == []


def test_two_transmissions_overlap(world: WorldFactory) -> None:
    w = world(Dummy(2, plan=[(1_000, ASK)]), Dummy(3, plan=[(1_000 + 30 * BIT, ASK)]), token_rules=False)
    w.run_until(1_000_000)
    assert w.referee is not None
    (violation,) = w.referee.violations
    assert violation.rule is Rule.COLLISION
    assert violation.sender == "3"
    assert violation.text == "begins 36 bits before 2 ends"
    w.referee.violations.clear()


def test_t_syn_holds_for_masters_the_referee_does_not_know(world: WorldFactory) -> None:
    script = Script(world, know=False)
    script.claim()
    script.play(("m2", 33, ASK), ("s5", 11, ANSWER), ("m2", 33, SDN), ("m2", 33, TOKEN), ("m2", 32, TOKEN))
    assert script.verdict() == [Rule.IDLE]


def test_extra_idle_time_is_part_of_t_id1(world: WorldFactory) -> None:
    script = Script(world, know=False)
    script.referee.know(PARAMS.replace(extra_idle=100))
    script.claim()
    script.play(("m2", 137, ASK), ("s5", 11, ANSWER), ("m2", 136, ASK))
    assert script.verdict() == [Rule.IDLE]


def test_the_ring_wraps() -> None:
    watch = TokenWatch()
    assert watch.token(100, 100, None) is None
    assert watch.token(100, 3, None) is None
    assert watch.token(3, 100, None) is None
    assert watch.ring == {3, 100}
    finding = present(watch.token(100, 7, None))
    assert finding.text == "station 100 passes the token to 7, over 3"


def test_token_rules_can_be_left_alone(script: Script) -> None:
    script.referee.token_rules = False
    script.play(("m2", 5_000, ASK), ("s5", 11, ANSWER), ("m3", 37, encode_token(9, 3)))
    assert script.verdict() == []


# --- faults that the test ordered ---
def test_injected_octets_are_no_violation_but_count(script: Script) -> None:
    script.claim()
    script.world.run_for(37 * BIT)
    script.world.add(Dummy(9))
    script.world.inject(encode_token(4, 2))
    script.world.run_for(33 * BIT)
    script.at = script.world.now
    script.send("m4", 37, encode_sd1(5, 4, 0x49))
    script.send("s5", 10, encode_sd1(4, 5, 0x00))
    assert script.verdict() == [Rule.EARLY]


def test_a_delayed_transmission_is_no_violation(script: Script) -> None:
    script.claim()
    script.world.faults.delay(lambda tx: tx.sender == "s5", 300 * BIT)
    script.send("m2", 37, ASK)
    script.send("s5", 20, ANSWER)
    script.world.run_for(400 * BIT)
    script.at = script.world.now
    script.send("m2", 300, ASK)
    assert script.verdict() == []


@pytest.mark.parametrize(("pause", "found"), [(22, []), (21, [Rule.IDLE])])
def test_after_damage_silence_counts_from_the_last_readable_octet(
    script: Script, pause: int, found: list[Rule]
) -> None:
    script.claim()
    script.send("m2", 37, ASK)
    script.world.faults.damage(lambda tx: tx.sender == "s5", octet=-1)
    script.send("s5", 20, ANSWER)
    script.send("m2", pause, ASK)
    assert script.verdict() == found


@pytest.mark.parametrize(("bits", "found"), [(22 + 32, [Rule.COLLISION]), (22 + 33, [])])
def test_a_station_may_begin_after_t_syn_without_a_readable_octet(
    world: WorldFactory, bits: int, found: list[Rule]
) -> None:
    w = world(token_rules=False)
    for octet in (2, 3, 4, 5):
        w.faults.damage(lambda tx: tx.sender == "2", octet=octet)
    w.add(Dummy(2, plan=[(1_000, ASK)]))
    w.add(Dummy(3, plan=[(1_000 + bits * BIT, ASK)]))
    w.run_until(1_000_000)
    assert w.referee is not None
    assert [violation.rule for violation in w.referee.violations] == found
    w.referee.violations.clear()


def test_a_token_that_noise_turned_into_another_one_is_no_violation(script: Script) -> None:
    script.claim()
    # 2 -> 2 becomes 2 -> 3: bit 0 of DA and its parity bit
    script.world.faults.damage(lambda tx: tx.octets == TOKEN, octet=1, flips=0x202)
    script.send("m2", 37, TOKEN)
    assert "heard as the token 2 -> 3" in list(script.world.log)[-1].note
    script.send("m3", 37, ASK_OF_3)
    assert script.verdict() == []
    script.at += 258 * 200 * BIT
    script.send("m3", 37, ASK_OF_3)
    assert script.verdict() == []
    script.send("m2", 37, ASK)
    assert script.verdict() == [Rule.RIGHT]


def test_allowed_violations_are_kept_apart(script: Script) -> None:
    script.referee.allow(Rule.RIGHT, times=1)
    script.referee.allow(Rule.EARLY)
    script.send("m2", 5_000, ASK)
    script.send("s5", 5, ANSWER)
    script.send("m3", 37, ASK_OF_3)
    script.send("s5", 5, encode_sd1(3, 5, 0))
    assert [violation.rule for violation in script.referee.allowed] == [Rule.RIGHT, Rule.EARLY, Rule.EARLY]
    assert script.verdict() == [Rule.RIGHT]


def test_check_prints_the_violations_and_the_wire(script: Script) -> None:
    script.claim()
    script.send("m2", 37, ASK)
    script.send("s5", 10, ANSWER)
    with pytest.raises(RefereeError) as caught:
        script.referee.check()
    text = str(caught.value)
    assert "1 violations on the wire" in text
    assert "s5: answer too early: 10 bits after the request; min T_SDR is 11" in text
    assert "FDL_Status request 2 -> 5" in text
    assert "[ANSWER TOO EARLY]" in text
    script.verdict()


def test_check_shows_a_violation_that_fell_out_of_the_log(world: WorldFactory) -> None:
    script = Script(world)
    script.send("m2", 5_000, ASK)
    for _ in range(500):
        script.send("m2", 250, ASK)
    with pytest.raises(RefereeError, match="up to the first violation:"):
        script.referee.check()
    assert script.verdict() == [Rule.RIGHT]


def test_many_violations_are_not_all_printed(script: Script) -> None:
    script.claim()
    for _ in range(30):
        script.send("s5", 37, ANSWER)
    with pytest.raises(RefereeError, match=r"\.\.\. and 10 more"):
        script.referee.check()
    assert script.verdict() == [Rule.UNASKED] * 30


def test_an_expected_violation_must_happen(script: Script) -> None:
    script.referee.expect(Rule.EARLY)
    with pytest.raises(RefereeError, match="expected, but never happened: answer too early"):
        script.referee.check()
    script.claim()
    script.send("m2", 37, ASK)
    script.send("s5", 10, ANSWER)
    script.referee.check()


def test_a_world_without_referee() -> None:
    made = World(referee=False)
    made.add(Dummy(2, plan=[(0, ASK), (500_000, ASK)]))
    made.run_until(1_000_000)
    assert made.referee is None
    assert made.transmissions == len(made.log) == 2
