"""All segments of a broker: states, silence by the clock of this computer, deaths, bounds; any messages."""

from __future__ import annotations

from fleet_kit import BIRTH, DEATH, LOST, ONLINE, TOPIC, status
from hypothesis import given
from hypothesis import strategies as st

from dpstack.bridge.mqtt.fleet import Fleet, State, rebirth_of
from dpstack.bridge.mqtt.payload import node_death, read_command
from dpstack.bridge.mqtt.status import MOST_OCTETS


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
    assert state_of(fleet) is State.OK
    fleet.receive(DEATH, node_death(5, 1), 502.0)
    assert fleet.receive(TOPIC, status(session=6), 503.0) is not None
    assert state_of(fleet) is State.OK
    fleet.receive(TOPIC, status(session=6, state="ended"), 504.0)
    assert fleet.receive(DEATH, node_death(6, 1), 504.0) is None
    assert state_of(fleet) is State.ENDED


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
        fleet.receive(topic, payload, float(number), expiry=extra, session=extra)
    fleet.tick(len(messages) + 31.0)
    for one in fleet:
        ended = {"ended": State.ENDED, "failed": State.CRITICAL}.get(one.status.state)
        assert one.state is ended if ended else one.state in (State.DEAD, State.SILENT)
