"""All segments of a broker: states, silence by the clock of this computer, deaths, bounds; any messages. Their
reader publishes nothing, and takes whatever comes."""

from __future__ import annotations

import asyncio
import time

import aiomqtt
import pytest
from fake_broker import CONNECT, DISCONNECT, PINGREQ, PUBLISH, SUBSCRIBE, FakeBroker, publish, user_property
from far_ends import beside, until
from fleet_kit import BIRTH, DEATH, LOST, ONLINE, TOPIC, status
from hypothesis import given
from hypothesis import strategies as st

from dpstack.boottime import boottime_s
from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.fleet import Fleet, Segment, State, rebirth_of
from dpstack.bridge.mqtt.fleet_reader import FleetReader
from dpstack.bridge.mqtt.payload import node_death, read_command
from dpstack.bridge.mqtt.status import MOST_OCTETS
from dpstack.errors import UsageError


def state_of(fleet: Fleet) -> State:
    segment = fleet.get("hall 3", "line 7")
    assert segment is not None
    return segment.state


def test_each_change_is_told_once() -> None:
    fleet = Fleet()
    assert fleet.receive(TOPIC, status(), 100.0) is not None
    assert state_of(fleet) is State.OK
    assert fleet.receive(TOPIC, status(sent=1.0), 110.0) is None
    assert fleet.receive(TOPIC, status(**LOST), 111.0) is not None
    assert state_of(fleet) is State.LOST
    assert fleet.receive(TOPIC, status(**LOST, more_lost=2), 112.0) is not None  # the same state, another text
    # the slaves are back, and the verdict remembers them
    assert fleet.receive(TOPIC, status(verdict="critical", reasons=["gone"]), 113.0) is not None
    assert state_of(fleet) is State.CRITICAL
    assert fleet.receive(TOPIC, status(verdict="warning"), 114.0) is not None
    assert fleet.receive(TOPIC, status(verdict="unknown"), 115.0) is not None
    assert fleet.counts() == {State.UNKNOWN: 1}
    assert fleet.receive(TOPIC, status(state="ended"), 116.0) is not None
    assert fleet.tick(1000.0) == []  # one that has ended is not silent
    assert state_of(fleet) is State.ENDED
    assert fleet.receive(TOPIC, status(state="failed", verdict="critical"), 1001.0) is not None
    assert fleet.receive(DEATH, node_death(5, 1), 1002.0) is None
    assert fleet.tick(2000.0) == []
    assert state_of(fleet) is State.CRITICAL
    # lost slaves come before what the last minutes were
    assert fleet.receive(TOPIC, status(**LOST | {"verdict": "warning"}), 2001.0) is not None
    assert state_of(fleet) is State.LOST


@pytest.mark.parametrize("other", [17, 5, 200])
def test_a_segment_whose_session_flips_is_not_ok(other: int) -> None:
    """Two gateways of one group and node: each takes the connection over from the other, with numbers of its own."""
    fleet = Fleet()
    fleet.receive(TOPIC, status(session=5), 100.0)
    states = []
    for at, (dies, comes) in enumerate(((5, other), (other, 6), (6, other + 1), (other + 1, 7)), 2):
        fleet.receive(DEATH, node_death(dies, 1), 60.0 * at)
        states.append(state_of(fleet))
        fleet.receive(BIRTH, node_death(comes, 1), 60.0 * at + 1)
        fleet.receive(TOPIC, status(session=comes), 60.0 * at + 2)
        states.append(state_of(fleet))
    # the first change may be one gateway whose network was away
    assert states[:2] == [State.DEAD, State.OK if other == 17 else State.WARNING]
    assert states[2:] == [State.DEAD, State.WARNING] * 3
    segment = fleet.get("hall 3", "line 7")
    assert segment is not None
    assert segment.reasons == (
        "its session has gone back: another gateway uses this node's name, or its state folder was lost",
    )
    fleet.receive(TOPIC, status(session=7, verdict="critical"), 310.0)
    assert state_of(fleet) is State.CRITICAL
    # 300 s later the other one is gone
    for at in range(320, 620, 10):
        fleet.receive(TOPIC, status(session=7), float(at))
    assert state_of(fleet) is State.OK
    assert not segment.reasons


def test_a_gateway_whose_number_goes_up_does_not_flip() -> None:
    fleet = Fleet()
    for turn, session in enumerate((5, 6, 40, 150, 255, 0, 1)):  # each try to connect takes one
        at = 100.0 + 10 * turn
        fleet.receive(BIRTH, node_death(session, 1), at)
        fleet.receive(TOPIC, status(session=session), at + 1)
        assert state_of(fleet) is State.OK
        fleet.receive(DEATH, node_death(session, 1), at + 3)


def test_silence_is_measured_here_with_the_rest_of_the_expiry() -> None:
    fleet = Fleet()
    fleet.receive(TOPIC, status(), 100.0, expiry=12)  # published 18 s ago
    assert fleet.tick(111.9) == []
    (segment,) = fleet.tick(112.0)
    assert (segment.state, segment.since, segment.heard) == (State.SILENT, 82.0, 82.0)
    assert fleet.tick(112.5) == []
    assert fleet.receive(TOPIC, status(), 200.0, expiry=4_294_967_295) is segment
    assert state_of(fleet) is State.OK
    assert fleet.tick(229.9) == []
    assert fleet.tick(230.0) == [segment]


def test_a_death_counts_for_its_session_only() -> None:
    fleet = Fleet()
    fleet.receive(DEATH, node_death(5, 1), 99.0)
    fleet.receive(TOPIC, status(), 100.0)
    assert fleet.receive(DEATH, node_death(4, 1), 101.0) is None
    assert fleet.receive(DEATH, b"\xff\xff", 101.0) is None
    assert fleet.receive(DEATH, node_death(5, 1), 102.0) is not None
    assert state_of(fleet) is State.DEAD
    assert fleet.tick(500.0) == []
    assert fleet.receive(BIRTH, b"", 501.0) is not None
    assert state_of(fleet) is State.UNKNOWN
    fleet.receive(DEATH, node_death(5, 1), 502.0)
    assert fleet.receive(TOPIC, status(session=6), 503.0) is not None
    assert state_of(fleet) is State.OK
    fleet.receive(TOPIC, status(session=6, state="ended"), 504.0)
    assert fleet.receive(DEATH, node_death(6, 1), 504.0) is None
    assert state_of(fleet) is State.ENDED


def test_after_a_birth_nothing_is_known_until_the_next_status() -> None:
    fleet = Fleet()
    fleet.receive(TOPIC, status(**LOST), 100.0)
    assert fleet.receive(BIRTH, node_death(5, 1), 101.0) is None  # a host has asked for births
    assert fleet.receive(BIRTH, b"\xff\xff", 101.0) is None
    assert state_of(fleet) is State.LOST
    # of a session whose beginning nobody has seen
    segment = fleet.receive(BIRTH, node_death(6, 1), 102.0)
    assert segment is not None
    assert (segment.state, segment.status.verdict, segment.status.lost_count) == (State.UNKNOWN, "unknown", 0)
    assert segment.status.reasons == ("its gateway has begun anew; no status has come since",)
    assert fleet.receive(BIRTH, node_death(6, 1), 103.0) is None
    assert fleet.receive(DEATH, node_death(5, 1), 103.0) is None
    assert fleet.receive(DEATH, node_death(6, 1), 104.0) is segment  # before its first status
    assert state_of(fleet) is State.DEAD
    assert fleet.receive(BIRTH, node_death(7, 1), 105.0) is segment
    assert fleet.receive(TOPIC, status(session=7), 106.0) is segment
    assert state_of(fleet) is State.OK
    assert fleet.receive(BIRTH, node_death(7, 1), 107.0) is None  # its status came first
    fleet.receive(TOPIC, status(session=7, state="ended"), 108.0)
    assert fleet.receive(BIRTH, node_death(8, 1), 109.0) is segment
    assert state_of(fleet) is State.UNKNOWN
    assert fleet.tick(139.0) == [segment]
    assert state_of(fleet) is State.SILENT


def test_an_end_that_is_told_after_a_death_hides_no_death() -> None:
    fleet = Fleet()
    fleet.receive(TOPIC, status(), 100.0)
    fleet.receive(DEATH, node_death(5, 1), 101.0)
    for number in (5, 6, 6):  # in no order that a gateway has
        fleet.receive(TOPIC, status(session=number, state="ended", reasons=["x"]), 102.0)
        segment = fleet.get("hall 3", "line 7")
        assert segment is not None
        assert segment.state is State.DEAD
        assert segment.status.reasons == ("after its death came a status that says: ended", "x")
    assert fleet.receive(TOPIC, status(session=7), 103.0) is segment
    # another connection of this program: the gateway has begun and ended meanwhile
    fleet.receive(DEATH, node_death(7, 1), 104.0)
    fleet.receive(TOPIC, status(session=8, state="ended"), 105.0, expiry=20, retained=True)
    assert state_of(fleet) is State.ENDED


def test_a_status_that_the_broker_kept_does_not_take_a_death_back() -> None:
    fleet = Fleet()
    fleet.receive(TOPIC, status(), 100.0)
    fleet.receive(DEATH, node_death(5, 1), 101.0)
    assert fleet.receive(TOPIC, status(), 103.0, expiry=27, retained=True) is None
    assert state_of(fleet) is State.DEAD
    assert fleet.receive(TOPIC, status(session=6), 104.0, expiry=29, retained=True) is not None
    assert state_of(fleet) is State.OK


def test_a_kept_status_without_expiry_is_as_old_as_it_says_where_the_clocks_agree() -> None:
    wall = 1_700_000_000.0
    for sent, expiry, state, silent_at in (
        (wall - 8, None, State.OK, 104.0),
        (wall - 8, 4_294_967_295, State.OK, 104.0),  # not an expiry that a gateway gives
        (wall + 1.5, None, State.OK, 112.0),
        (wall + 5, None, State.UNKNOWN, 112.0),
        (wall - 30, None, State.UNKNOWN, 112.0),
        ("x", None, State.UNKNOWN, 112.0),
    ):
        fleet = Fleet()
        segment = fleet.receive(TOPIC, status(sent=sent), 100.0,
                                expiry=expiry, retained=True, wall=wall)  # fmt: skip
        assert segment is not None
        assert segment.state is state
        assert (segment.status.reasons != ()) is (state is State.UNKNOWN)
        assert fleet.tick(silent_at - 0.1) == []
        assert fleet.tick(silent_at) == [segment]
    # the same one again, at the next connection of this program: it is no younger
    fleet.receive(TOPIC, status(sent=0), 200.0, retained=True, wall=wall)
    assert state_of(fleet) is State.SILENT
    fleet.receive(TOPIC, status(sent=5, state="ended"), 201.0, retained=True, wall=wall)
    assert state_of(fleet) is State.ENDED


@pytest.mark.parametrize("is_dated_by_expiry", [True, False])
def test_a_kept_status_that_its_gateway_should_have_renewed_is_silent(is_dated_by_expiry: bool) -> None:
    """The gateway died before this program began, and its death is not kept."""
    wall = 1_700_000_000.0
    fleet = Fleet()
    fleet.receive(TOPIC, status(sent=wall - 14), 100.0,
                  expiry=16 if is_dated_by_expiry else None, retained=True, wall=wall)  # fmt: skip
    assert state_of(fleet) is State.SILENT
    fleet.receive(TOPIC, status(sent=wall + 1), 101.0, expiry=30, wall=wall + 1)
    assert state_of(fleet) is State.OK
    assert fleet.tick(130.9) == []
    assert len(fleet.tick(131.0)) == 1


def test_a_will_in_json_counts_for_its_session_only() -> None:
    fleet = Fleet()
    assert fleet.receive(ONLINE, b"false", 99.0, session=5) is None  # nothing is known of this gateway
    fleet.receive(TOPIC, status(), 100.0)
    assert fleet.receive(ONLINE, b"false", 101.0) is None  # its bus is gone, it says so itself
    assert fleet.receive(ONLINE, b"false", 101.0, session=4) is None
    assert state_of(fleet) is State.OK
    assert fleet.receive(ONLINE, b"false", 102.0, session=5) is not None
    assert state_of(fleet) is State.DEAD
    assert fleet.receive(ONLINE, b"false", 102.0, session=5) is None
    assert fleet.receive(TOPIC, status(session=6), 103.0) is not None
    assert fleet.receive(ONLINE, b"false", 103.0, session=5) is None  # the broker had kept it
    assert fleet.receive(ONLINE, b"true", 104.0) is None
    assert state_of(fleet) is State.OK
    fleet.receive(TOPIC, status(session=6, state="ended"), 105.0)
    assert fleet.receive(ONLINE, b"false", 105.0, session=6) is None
    assert state_of(fleet) is State.ENDED


def test_the_worst_come_first() -> None:
    fleet = Fleet()
    for node, changes in (("a", {}), ("b", {"state": "ended"}), ("c", LOST), ("d", {}), ("e", {"verdict": "warning"})):
        fleet.receive(f"dpstack/g/{node}/status", status(**changes), 0.0)
    fleet.receive("spBv1.0/g/NDEATH/d", node_death(5, 1), 1.0)
    assert [one.node for one in fleet] == ["d", "c", "e", "b", "a"]
    fleet.receive("dpstack/g/b/status", status(**LOST), 2.0)
    assert [one.node for one in fleet] == ["d", "b", "c", "e", "a"]
    fleet.receive("dpstack/f/z/status", status(), 3.0)
    assert [one.node for one in fleet] == ["d", "b", "c", "e", "z", "a"]
    assert fleet.counts() == {State.DEAD: 1, State.LOST: 2, State.WARNING: 1, State.OK: 2}
    fleet.tick(31.5)
    assert [one.node for one in fleet] == ["d", "a", "c", "e", "b", "z"]
    assert fleet.counts() == {State.DEAD: 1, State.SILENT: 3, State.LOST: 1, State.OK: 1}


def test_bounds() -> None:
    fleet = Fleet(most=2)
    for number in range(5):
        fleet.receive(f"dpstack/g/{number}/status", status(), 0.0)
    assert (len(fleet), fleet.left_out) == (2, 3)
    assert fleet.receive("dpstack/g/0/status", status(**LOST), 1.0) is not None  # those that fit go on
    for topic, payload in (
        ("dpstack/g/0/status", b" " * (MOST_OCTETS + 1)),
        ("dpstack/g/0/status", b"{"),
        (f"dpstack/{'g' * 60_000}/0/status", status()),
        ("dpstack/g/\x1b[2J/status", status()),
        ("dpstack//x/status", status()),
    ):
        assert fleet.receive(topic, payload, 2.0) is None
        assert fleet.why_broken.isprintable()
    assert fleet.broken == 5
    assert fleet.receive("dpstack/g/0/status", b"", 3.0) is None  # its retained message was removed
    assert Fleet("other").receive(TOPIC, status(), 0.0) is None
    assert Fleet("other").subscriptions[2] == "dpstack/other/+/status"


def test_a_rebirth_is_the_command_of_sparkplug() -> None:
    topic, payload = rebirth_of("g", "n", 1_700_000_000_000)
    assert topic == "spBv1.0/g/NCMD/n"
    (metric,) = read_command(payload).metrics
    assert (metric.name, metric.value, metric.datatype) == ("Node Control/Rebirth", True, 11)


TOPICS = st.sampled_from([TOPIC, DEATH, BIRTH, ONLINE, "dpstack/a/b", "dpstack/a/b/status/c", "", "spBv1.0/a/NDEATH"])
PAYLOADS = st.binary(max_size=40) | st.sampled_from([status(), status(**LOST), status(state="ended"), node_death(5, 1)])
PAYLOADS |= st.just(status(state="failed"))


@given(st.lists(st.tuples(TOPICS | st.text(max_size=12), PAYLOADS, st.none() | st.integers()), max_size=20))
def test_no_message_raises_and_an_old_status_is_never_shown_as_alive(
    messages: list[tuple[str, bytes, int | None]],
) -> None:
    fleet = Fleet()
    for number, (topic, payload, extra) in enumerate(messages):
        kept = number % 2 == 1
        fleet.receive(topic, payload, float(number), expiry=extra, session=extra, retained=kept, wall=4e9)
    fleet.tick(len(messages) + 31.0)
    for one in fleet:
        ended = {"ended": State.ENDED, "failed": State.CRITICAL}.get(one.status.state)
        assert one.state is ended if ended else one.state in (State.DEAD, State.SILENT)


class Seen:
    """``changes``: node and state of each change; ``told``: remarks."""

    def __init__(self, broker: FakeBroker, rebirth: str | tuple[str, str] | None = None) -> None:
        self.fleet = Fleet()
        self.changes: list[tuple[str, State]] = []
        self.told: list[str] = []
        self.reader = FleetReader(
            Broker(url=broker.url),
            self.fleet,
            changed=self.change,
            told=self.told.append,
            rebirth=rebirth,
            again_s=0.02,
        )

    def change(self, segment: Segment) -> None:
        self.changes.append((segment.node, segment.state))


async def test_it_publishes_nothing_and_comes_back() -> None:
    broker = FakeBroker(
        retained=[publish(TOPIC, status(), expiry=20, retain=True), publish("dpstack/g/n/status", b"{")]
    )
    async with broker:
        seen = Seen(broker)
        async with beside(seen.reader.run()):
            await until(lambda: seen.fleet.broken)
            assert seen.changes == [("line 7", State.OK)]
            broker.send(publish(DEATH, node_death(5, 1)) + publish("spBv1.0/x/NBIRTH/y", b"\xff" * 1000))
            await until(lambda: seen.changes[-1][1] is State.DEAD)
            broker.cut()
            await until(lambda: any("it is tried again" in text for text in seen.told))
            broker.retained[0] = publish(TOPIC, status(**LOST, session=6), expiry=20, retain=True)
            await until(lambda: seen.changes[-1][1] is State.LOST)
            assert seen.reader.connected
        assert broker.kinds() <= {CONNECT, SUBSCRIBE, PINGREQ, DISCONNECT}
        flags = {body[7] for kind, body in broker.received if kind == CONNECT}
        assert flags == {2}  # Clean Start, and no will


async def test_after_a_sleep_of_the_computer_an_old_status_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    async with FakeBroker(retained=[publish(TOPIC, status(), expiry=20, retain=True)]) as broker:
        seen = Seen(broker)
        async with beside(seen.reader.run()):
            await until(lambda: seen.changes)
            monkeypatch.setattr("dpstack.bridge.mqtt.fleet_reader.boottime_s", lambda: boottime_s() + 3600)
            await until(lambda: len(seen.changes) > 1)
    assert seen.changes == [("line 7", State.OK), ("line 7", State.SILENT)]


async def test_a_kept_status_without_expiry_is_judged_by_its_own_time() -> None:
    kept = {"young": time.time() - 5, "old": time.time() - 3600, "ahead": time.time() + 3600}
    packets = [publish(f"dpstack/g/{node}/status", status(sent=sent), retain=True) for node, sent in kept.items()]
    async with FakeBroker(retained=packets) as broker:
        seen = Seen(broker)
        async with beside(seen.reader.run()):
            await until(lambda: len(seen.changes) == 3)
            broker.send(publish("dpstack/g/old/status", status()))
            await until(lambda: len(seen.changes) == 4)
    assert seen.changes == [
        ("young", State.OK), ("old", State.UNKNOWN), ("ahead", State.UNKNOWN), ("old", State.OK)
    ]  # fmt: skip


async def test_a_will_in_json_is_known_by_its_user_property() -> None:
    async with FakeBroker(retained=[publish(TOPIC, status(), expiry=20, retain=True)]) as broker:
        seen = Seen(broker)
        async with beside(seen.reader.run()):
            await until(lambda: seen.changes)
            for name, value in (("session", "4"), ("session", "5" * 90), ("session", "\u0665"), ("other", "5")):
                broker.send(publish(ONLINE, b"false", user=user_property(name, value)))
            broker.send(publish(ONLINE, b"false"))
            broker.send(publish(ONLINE, b"false", user=user_property("other", "x") + user_property("session", "5")))
            await until(lambda: len(seen.changes) > 1)
    assert seen.changes == [("line 7", State.OK), ("line 7", State.DEAD)]


@pytest.mark.parametrize("rebirth", ["all", ("hall 3", "line 7")])
async def test_it_asks_for_births_once(rebirth: str | tuple[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dpstack.bridge.mqtt.fleet_reader._LEARNING_S", 0.05)
    async with FakeBroker(retained=[publish(TOPIC, status())]) as broker:
        seen = Seen(broker, rebirth)
        async with beside(seen.reader.run()):
            await until(lambda: "asked for births: 1 gateway" in seen.told)
            await until(lambda: PUBLISH in [kind for kind, _ in broker.received])
            broker.cut()
            await until(lambda: len([kind for kind, _ in broker.received if kind == 1]) == 2)
            await until(lambda: seen.reader.connected)
    asked = [body for kind, body in broker.received if kind == PUBLISH]
    assert len(asked) == 1
    assert b"spBv1.0/hall 3/NCMD/line 7" in asked[0]
    assert b"Node Control/Rebirth" in asked[0]


async def test_births_that_could_not_be_asked_for_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    async def publish_nothing(*_: object) -> None:
        raise aiomqtt.MqttError("the connection is lost")

    monkeypatch.setattr(aiomqtt.Client, "publish", publish_nothing)
    async with FakeBroker() as broker:
        seen = Seen(broker, ("hall 3", "line 7"))
        async with beside(seen.reader.run()):
            await until(lambda: "only 0 of 1 gateways were asked for births: the connection is lost" in seen.told)


async def test_a_wrong_password_is_an_error_at_once() -> None:
    async with FakeBroker(refuses=0x86) as broker:
        seen = Seen(broker)
        with pytest.raises(UsageError, match="refuses user or password"):
            await asyncio.wait_for(seen.reader.run(), 10)


async def test_many_retained_statuses_at_once() -> None:
    retained = [publish(f"dpstack/g/{number}/status", status(), expiry=30, retain=True) for number in range(1500)]
    async with FakeBroker(retained=retained) as broker:
        seen = Seen(broker)
        async with beside(seen.reader.run()):
            await until(lambda: len(seen.fleet) + seen.reader.lost == 1500)
            assert seen.reader.lost == 0
