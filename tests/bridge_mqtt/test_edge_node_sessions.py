"""Sessions of the edge node, case by case: numbers, births, intervals, names, clocks; commands of hosts: what becomes
an order, and what is refused with which reason in ``Last command``."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from edge_node_rig import GROUP, NODE, NewRig, Rig, metric
from hypothesis import given
from hypothesis import strategies as st
from plant_items import PLANT, VALVES
from property_kit import examples
from sparkplug_host import tag

from dpstack.bridge.mqtt.plant_node import NodeSetup, OrderWish, Phase
from dpstack.errors import ConfigError


def kinds(rig: Rig) -> list[tuple[str, str | None]]:
    return [(kind, device) for kind, device, _ in rig.host.messages]


def phase(rig: Rig) -> Phase:
    return rig.node.phase


def test_births_come_in_order_and_data_when_they_change(rig: Rig) -> None:
    assert kinds(rig) == [("NBIRTH", None), ("DBIRTH", "hoist"), ("DBIRTH", "valves")]
    rig.values["8"]["fields"]["level"] = 20.0
    rig.turn()
    assert kinds(rig)[3:] == [("DDATA", "valves")]
    (found,) = rig.host.messages[-1][2].metrics
    assert found.value(10) == 20.0
    rig.turn(5.0)
    assert len(rig.host.messages) == 4


def test_a_change_goes_out_at_once_and_the_next_ones_an_interval_later(rig: Rig) -> None:
    rig.turn()
    count = len(rig.host.messages)
    for level in (20.0, 30.0, 40.0):
        rig.values["8"]["fields"]["level"] = level
        rig.turn(0.1)
    assert [one[2].metrics[0].value(10) for one in rig.host.messages[count:]] == [20.0]
    assert rig.node.due(rig.clock) == pytest.approx(rig.clock + 0.8)
    rig.turn(0.8)
    assert [one[2].metrics[0].value(10) for one in rig.host.messages[count:]] == [20.0, 40.0]
    assert rig.node.due(rig.clock) == math.inf


def test_the_sequence_wraps_behind_255(rig: Rig) -> None:
    for number in range(600):
        rig.values["8"]["fields"]["count"] = number % 100
        assert rig.turn() == 1
    seqs = [payload.seq for _, _, payload in rig.host.messages]
    assert seqs == [number % 256 for number in range(603)]


def test_a_host_that_asks_for_births_without_end_gets_those_of_all_devices(rig: Rig) -> None:
    rig.wait(1.0)
    rig.host.messages.clear()
    for _ in range(30):
        rig.rebirth()
        rig.pump(1)
        rig.wait(0.1)
    assert kinds(rig) == [("NBIRTH", None), ("DBIRTH", "hoist"), ("DBIRTH", "valves")] * 3
    assert rig.host.alive == {"hoist", "valves"}


def test_a_host_that_asks_for_births_without_end_holds_no_data_back(new_rig: NewRig) -> None:
    rig = new_rig(interval_s=0.2)
    rig.join()
    rig.host.messages.clear()
    for number in range(30):
        rig.rebirth()
        rig.values["8"]["fields"]["count"] = number
        rig.turn(0.1)
        # by data or births, as the interval permits
        assert number < 3 or rig.host.metric("Inputs/count", "valves").value >= number - 2
    sent = kinds(rig)
    assert sent.count(("NBIRTH", None)) == 3
    assert sent.count(("DDATA", "valves")) >= 10
    rig.check()


def test_a_rebirth_has_the_same_session_number_and_comes_at_most_once_a_second(rig: Rig) -> None:
    first = rig.host.number
    count = len(rig.host.messages)
    for _ in range(50):
        rig.rebirth()
    rig.values["8"]["fields"]["level"] = 77.0
    rig.give_values()
    rig.pump()
    assert len(rig.host.messages) == count  # no data meanwhile
    rig.turn()
    assert kinds(rig)[count:] == [("NBIRTH", None), ("DBIRTH", "hoist"), ("DBIRTH", "valves")]
    assert rig.host.number == first
    assert rig.host.metric("Inputs/level", "valves").value == 77.0


def test_a_new_session_has_the_next_number_also_behind_a_restart(rig: Rig) -> None:
    assert rig.host.number == 0
    rig.cut()
    rig.join()
    assert rig.host.number == 1
    rig.kill()
    rig.join()
    assert rig.host.number == 2
    rig.check()


def test_without_a_known_number_the_first_session_has_no_births(new_rig: NewRig, tmp_path: Path) -> None:
    """It makes the broker publish the will of the last session, whatever its number was, before there are births."""
    (tmp_path / "bdseq").write_text("?")
    rig = new_rig()
    old = Rig(tmp_path / "old")
    will = old.node.connect(1, old.wall).will  # the number of the first births here
    rig.wills.append(will)
    rig.join()
    assert kinds(rig) == [("NDEATH", None)] * 3  # the old will; ours; that of the broker
    assert rig.node.phase is Phase.OFFLINE
    rig.join()
    assert rig.host.number == 1
    rig.check()
    old.close()


def test_nothing_is_sent_before_the_plant_is_known(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    assert rig.join() == 0
    rig.give_plant()
    rig.pump()
    rig.check()
    rig.close()


def test_an_ordered_end_publishes_the_death(rig: Rig) -> None:
    count = len(rig.host.messages)
    rig.node.end("stopped")
    rig.pump()
    assert kinds(rig)[count:] == [("NDEATH", None), ("NDEATH", None)]  # the broker publishes the will, too
    assert not rig.host.online


def test_the_primary_host_stops_and_starts_births(new_rig: NewRig) -> None:
    rig = new_rig(primary_host="scada")
    rig.connect()
    assert rig.connection is not None
    assert rig.connection.subscriptions[-1] == "spBv1.0/STATE/scada"
    rig.pump()
    assert rig.host.messages == []
    rig.state(online=False, time_ms=1000)
    rig.pump()
    assert rig.connection is not None  # it waits in this connection
    rig.state(online=True, time_ms=1000)
    rig.pump()
    rig.check()
    rig.state(online=False, time_ms=999)
    assert phase(rig) is Phase.ONLINE
    assert "older than the last one" in rig.told[-1]
    rig.state(online=False, time_ms=1000)
    rig.pump()
    assert kinds(rig)[-2:] == [("NDEATH", None), ("NDEATH", None)]
    assert "primary host scada is offline" in rig.told[-1]
    rig.join()
    assert phase(rig) is Phase.WAITING
    rig.state(online=True, time_ms=2000)
    rig.pump()
    assert rig.host.number == 1
    rig.check()


def test_state_that_comes_before_the_subscription_is_confirmed_counts(new_rig: NewRig) -> None:
    rig = new_rig(primary_host="scada")
    rig.node.connect(0, rig.wall)
    rig.receive("spBv1.0/STATE/scada", b'{"online": true, "timestamp": 5}')
    rig.node.connected()
    assert rig.node.phase is Phase.ONLINE


@pytest.mark.parametrize("comes", ["offline", "end", "time", "cut"])
def test_births_wait_a_moment_behind_the_return_of_the_primary_host(new_rig: NewRig, comes: str) -> None:
    rig = new_rig(primary_host="scada", pause=lambda: 1.5)
    rig.connect()
    rig.state(online=True, time_ms=1000)
    assert rig.node.due(rig.clock) == rig.clock + 1.5
    rig.wait(1.4)
    rig.state(online=True, time_ms=1001)  # once more: it begins no other pause
    rig.pump()
    assert rig.host.messages == []
    if comes == "time":
        rig.turn(0.1)
        rig.check()
        assert rig.host.online
        assert rig.node.due(rig.clock) > rig.clock
    elif comes == "cut":
        rig.cut()
        rig.connect()
        rig.state(online=True, time_ms=1002, retained=True)  # it comes to this gateway alone
        rig.pump()
        rig.check()
    else:
        if comes == "offline":
            rig.state(online=False, time_ms=1002)
        else:
            rig.node.end("the test wants it")
        assert rig.node.due(rig.clock) == rig.clock
        rig.pump()
        assert kinds(rig) == [("NDEATH", None), ("NDEATH", None)]  # its own, and the will
        assert rig.connection is None


def test_what_a_host_said_in_an_earlier_connection_does_not_count(new_rig: NewRig) -> None:
    rig = new_rig(primary_host="scada")
    rig.connect()
    rig.state(online=True, time_ms=1000)
    rig.pump()
    rig.cut()
    rig.join()
    assert phase(rig) is Phase.WAITING
    rig.state(online=True, time_ms=1000)  # the broker keeps it
    rig.pump()
    rig.check()


def test_other_nodes_of_the_bus_give_a_new_birth_of_the_edge_node(rig: Rig) -> None:
    """A fixed cycle has statistics of its own."""
    count = len(rig.host.messages)
    rig.plant["plan"] = {"cycle_us": 2000}
    rig.plant["started"] += 500.0
    rig.stream = 0.0
    rig.give_plant()
    rig.pump()
    assert kinds(rig)[count:][-3:] == [("NBIRTH", None), ("DBIRTH", "hoist"), ("DBIRTH", "valves")]
    assert rig.host.metric("Statistics/missed").value is None
    rig.check()


def test_a_slave_that_dies_before_its_birth_is_published_has_neither(rig: Rig) -> None:
    for state in ("offline", "data_exchange", "offline"):
        rig.values["8"]["state"] = state
        rig.give_values()
    count = len(rig.host.messages)
    rig.pump()
    assert kinds(rig)[count:][:1] == [("DDEATH", "valves")]
    assert ("DBIRTH", "valves") not in kinds(rig)[count:]


# --- names --------------------------------------------------------------------------------------------------------


def test_names_that_mqtt_does_not_permit_are_changed_and_told(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    valves = copy.deepcopy(PLANT["slaves"]["8"])
    valves["name"] = "valves/+#."
    valves["inputs"][0]["name"] = "level/#1"
    rig.plant["slaves"] = {"8": valves, "9": valves | {"name": "VALVES___."}}
    rig.values = {"8": VALVES | {"fields": {"level/#1": 1.0}}, "9": VALVES}
    rig.give_plant()
    rig.join()
    assert rig.host.alive == {"valves___.", "VALVES___. slave 9"}
    assert rig.host.metric("Inputs/level__1", "valves___.").value == 1.0
    assert any("Sparkplug does not permit this name" in one for one in rig.told)
    assert any("another one has this name" in one for one in rig.told)
    rig.close()


@pytest.mark.parametrize(("key", "name"), [("group", "a/b"), ("node", "+"), ("group", ""), ("primary_host", "#")])
def test_a_group_node_or_host_that_mqtt_does_not_permit_is_refused(key: str, name: str) -> None:
    group, node, host = (name if one == key else "x" for one in ("group", "node", "primary_host"))
    with pytest.raises(ConfigError, match=f"{key} .*MQTT does not permit this name; take"):
        NodeSetup(group, node, host)


def test_an_error_about_a_name_does_not_repeat_all_of_a_long_one() -> None:
    with pytest.raises(ConfigError) as found:
        NodeSetup("g" * 100_000, "x")
    assert len(str(found.value)) < 300


def test_devices_take_turns_where_the_broker_is_slower_than_their_interval(rig: Rig) -> None:
    rig.turn()
    count = len(rig.host.messages)
    for number in range(6):
        rig.values["3"]["drive"]["speed"] = 0.1 + number / 10
        rig.values["8"]["fields"]["level"] = 20.0 + 10 * number
        rig.wait(1.1)
        rig.pump(1)
    assert {device for _, device in kinds(rig)[count:]} == {"hoist", "valves"}
    assert [device for _, device in kinds(rig)[count:]].count("valves") == 3


def test_a_new_configuration_gives_births_to_what_is_new_and_to_nothing_else(rig: Rig) -> None:
    aliases = {one.name: alias for alias, one in rig.host.devices["hoist"].items()}
    count = len(rig.host.messages)
    rig.plant["slaves"]["8"]["inputs"].append({"name": "flow", "type": "u16", "at": "u16@4"})
    rig.plant["slaves"]["11"] = {"name": "pump", "watchdog_ms": 10}
    rig.values["11"] = rig.values["8"]
    rig.give_plant()
    rig.pump()
    assert kinds(rig)[count:] == [("DDEATH", "valves"), ("DBIRTH", "valves"), ("DBIRTH", "pump")]
    assert {one.name: alias for alias, one in rig.host.devices["hoist"].items()} == aliases
    rig.settle()
    rig.check()


def test_a_slave_that_gets_the_name_of_another_dies_and_is_born_under_the_new_one(rig: Rig) -> None:
    rig.plant["slaves"]["1"] = {"name": "valves", "watchdog_ms": 10}
    rig.values["1"] = rig.values["8"]
    rig.give_plant()
    rig.pump()
    assert rig.host.alive == {"hoist", "valves", "valves slave 8"}


# --- clocks -------------------------------------------------------------------------------------------------------


def test_a_clock_that_is_set_gives_new_births_with_the_right_times(rig: Rig) -> None:
    """As a computer that begins in 1970 and hears the time later."""
    stream_began = rig.wall
    rig.turn()
    count = len(rig.host.messages)
    for seconds in (10_000.0, -20_000.0):
        rig.offset += seconds
        rig.turn()
        assert kinds(rig)[count:].count(("NBIRTH", None)) == 1
        count = len(rig.host.messages)
        shown = rig.host.metric("Inputs/limit", "valves").timestamp
        assert 0 <= rig.wall * 1000 - shown < 1100
    assert rig.wall < stream_began
    assert "the clock of this computer was set" in rig.told[-1]


LISTED = {"valves.lamp", "valves.speed", "hoist.start", "hoist.speed"}


def listed(name: str) -> bool:
    return name in LISTED


@pytest.fixture
def rig(new_rig: NewRig) -> Rig:
    made = new_rig(may=listed)
    made.join()
    return made


def last(rig: Rig) -> tuple[Any, Any, Any]:
    """``Last command`` as the host shows it."""
    rig.turn()
    name, result, reason = (rig.host.metric(f"Last command/{key}").value for key in ("name", "result", "reason"))
    return name, result, reason


def test_an_output_that_is_listed_becomes_an_order_and_its_value_comes_by_the_stream(rig: Rig) -> None:
    (wish,) = rig.command("valves", [metric("Outputs/lamp", boolean=True)], age=0.5)
    assert (wish.name, wish.value) == ("valves.lamp", True)
    assert wish.made_at == pytest.approx(rig.wall - 0.5, abs=0.001)
    rig.pump()
    assert rig.host.metric("Outputs/lamp", "valves").value is False
    rig.values["8"]["fields"]["lamp"] = True
    rig.node.answer(wish, "done", "", rig.wall)
    assert last(rig) == ("valves.lamp", "done", "")
    assert rig.host.metric("Outputs/lamp", "valves").value is True


def test_a_metric_is_named_by_its_alias_too(rig: Rig) -> None:
    alias = rig.host.alias("Outputs/speed", "valves")
    (wish,) = rig.command("valves", [metric(alias=alias, whole=200)])
    assert wish[:2] == ("valves.speed", 200)
    (wish,) = rig.command("valves", [metric("Outputs/speed", alias=alias, whole=7, datatype=5)], age=0.1)
    assert wish[:2] == ("valves.speed", 7)


def test_orders_to_a_drive(rig: Rig) -> None:
    """An order without argument is a metric that is false, and takes true; the set point takes the speed."""
    assert rig.host.metric("Commands/start", "hoist").value is False
    assert "Commands/stop" not in [one.name for one in rig.host.devices["hoist"].values()]
    assert rig.command("hoist", [metric("Commands/start", boolean=True)])[0][:2] == ("hoist.start", True)
    assert rig.command("hoist", [metric("Drive/setpoint", double=0.25)])[0][:2] == ("hoist.speed", 0.25)


def test_a_host_sees_which_metrics_can_be_written(rig: Rig) -> None:
    found = {
        (device, one.name)
        for device in rig.host.devices
        for one in rig.host.devices[device].values()
        if not one.properties["Readonly"]
    }
    assert found == {
        ("valves", "Outputs/lamp"),
        ("valves", "Outputs/speed"),
        ("hoist", "Commands/start"),
        ("hoist", "Drive/setpoint"),
    }


@pytest.mark.parametrize(
    ("device", "octets", "name", "reason"),
    [
        ("valves", metric("Outputs/pump", boolean=True), "valves: 'Outputs/pump'", "there is no such metric"),
        ("valves", metric(alias=9999, boolean=True), "valves: alias 9999", "there is no such metric"),
        ("valves", metric(boolean=True), "valves: alias None", "it has neither name nor alias"),
        ("pump", metric("Outputs/lamp", boolean=True), "pump: 'Outputs/lamp'", "this device has had no birth"),
        ("valves", metric("Inputs/limit", boolean=True), "valves: 'Inputs/limit'", "this metric cannot be written"),
        ("hoist", metric("Commands/stop", boolean=True), "hoist: 'Commands/stop'", "there is no such metric"),
        ("valves", metric("Outputs/lamp", text="on"), "valves: 'Outputs/lamp'", "its value is no BOOLEAN"),
        ("valves", metric("Outputs/lamp"), "valves: 'Outputs/lamp'", "it has no value"),
        ("valves", metric("\x1b[2J\n", boolean=True), "valves: '\\x1b[2J\\n'", "there is no such metric"),
        (None, metric("Bus running", boolean=False), "'Bus running'", "this metric cannot be written"),
        (None, metric("Node Control/Reboot", boolean=True), "'Node Control/Reboot'", "there is no such metric"),
    ],
)  # fmt: skip
def test_a_command_that_cannot_be_is_refused_with_its_reason(
    rig: Rig, device: str | None, octets: bytes, name: str, reason: str
) -> None:
    assert rig.command(device, [octets]) == []
    assert last(rig) == (name, "refused", reason)
    assert rig.refused == [(name, reason, "2023-11-14T22:13:20.000Z")]


def test_name_and_alias_of_two_metrics_are_refused(rig: Rig) -> None:
    alias = rig.host.alias("Outputs/speed", "valves")
    assert rig.command("valves", [metric("Outputs/lamp", alias=alias, boolean=True)]) == []
    assert last(rig)[2] == "name and alias are not those of one metric"


def test_an_alias_of_another_device_is_refused(rig: Rig) -> None:
    assert rig.command("hoist", [metric(alias=rig.host.alias("Outputs/lamp", "valves"), boolean=True)]) == []
    assert last(rig)[2] == "there is no such metric"


def test_a_command_without_a_timestamp_or_one_that_the_broker_kept_is_refused(rig: Rig) -> None:
    lamp = metric("Outputs/lamp", boolean=True)
    assert rig.command("valves", [lamp], time=False) == []
    assert last(rig)[2] == "it has no timestamp"
    assert rig.refused == [("valves: 'Outputs/lamp'", "it has no timestamp", "")]
    assert rig.command("valves", [lamp], retained=True) == []
    assert last(rig)[2] == "the broker had kept this command: nobody knows how old it is"


def test_a_device_that_is_dead_takes_no_commands(rig: Rig) -> None:
    rig.values["8"]["state"] = "offline"
    rig.give_values()
    assert rig.command("valves", [metric("Outputs/lamp", boolean=True)]) == []
    assert last(rig)[2] == "this device has had no birth"


def test_no_command_is_taken_before_the_births(new_rig: NewRig) -> None:
    rig = new_rig(may=listed, primary_host="scada")
    assert rig.command("valves", [metric("Outputs/lamp", boolean=True)]) == []
    rig.connect()
    assert rig.command("valves", [metric("Outputs/lamp", boolean=True)]) == []
    rig.state(online=True, time_ms=1)
    assert rig.command("valves", [metric("Outputs/lamp", boolean=True)]) == []
    assert rig.refused == [("valves", "this node has had no birth", "")] * 3
    rig.pump()
    assert len(rig.command("valves", [metric("Outputs/lamp", boolean=True)])) == 1


def test_a_payload_of_a_megabyte_is_refused_and_told(rig: Rig) -> None:
    topic = f"spBv1.0/{GROUP}/DCMD/{NODE}/valves"
    assert rig.receive(topic, bytes(1_000_000)) == []
    assert last(rig) == ("unknown", "refused", "the payload has 1000000 octets, at most 65536 are taken")


@examples(50)
@given(
    st.sampled_from([f"spBv1.0/{GROUP}/DCMD/{NODE}/valves", f"spBv1.0/{GROUP}/NCMD/{NODE}", "x", f"spBv1.0/{GROUP}"]),
    st.binary(max_size=100) | st.binary(max_size=60).map(lambda one: tag(2, tag(1, b"Outputs/lamp") + one)),
)
def test_garbage_is_no_order(garbage_rig: Rig, topic: str, payload: bytes) -> None:
    """Its timestamp would have to be that of now."""
    assert garbage_rig.receive(topic, payload) == []
    garbage_rig.wait(1.0)
    garbage_rig.pump()


@pytest.fixture(scope="module")
def garbage_rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """One for all examples: what came before may be anything."""
    rig = Rig(tmp_path_factory.mktemp("garbage"), may=listed)
    rig.give_plant()
    rig.join()
    yield rig
    rig.close()


def test_an_order_wish_has_the_name_of_the_run(rig: Rig) -> None:
    assert rig.command("valves", [metric("Outputs/lamp", boolean=False)]) == [
        OrderWish("valves.lamp", False, round(rig.wall * 1000) / 1000)
    ]
