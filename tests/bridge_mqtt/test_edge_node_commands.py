"""Commands of hosts: what becomes an order, and what is refused with which reason in ``Last command``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from edge_node_rig import GROUP, NODE, Rig, metric
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples
from sparkplug_host import tag

from dpstack.bridge.mqtt.plant_node import OrderWish

LISTED = {"valves.lamp", "valves.speed", "hoist.start", "hoist.speed"}


def listed(name: str) -> bool:
    return name in LISTED


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    made = Rig(tmp_path, may=listed)
    made.give_plant()
    made.connect()
    made.pump()
    yield made
    made.close()


def last(rig: Rig) -> tuple[Any, Any, Any]:
    """``Last command`` as the host shows it."""
    rig.wait(1.0)
    rig.pump()
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
    assert rig.command("valves", [lamp], retained=True) == []
    assert last(rig)[2] == "the broker had kept this command: nobody knows how old it is"


def test_a_device_that_is_dead_takes_no_commands(rig: Rig) -> None:
    rig.values["8"]["state"] = "offline"
    rig.give_values()
    assert rig.command("valves", [metric("Outputs/lamp", boolean=True)]) == []
    assert last(rig)[2] == "this device has had no birth"


def test_no_command_is_taken_before_the_births(tmp_path: Path) -> None:
    rig = Rig(tmp_path, may=listed, primary_host="scada")
    rig.give_plant()
    assert rig.command("valves", [metric("Outputs/lamp", boolean=True)]) == []
    rig.connect()
    assert rig.command("valves", [metric("Outputs/lamp", boolean=True)]) == []
    rig.state(online=True, time_ms=1)
    assert rig.command("valves", [metric("Outputs/lamp", boolean=True)]) == []
    rig.pump()
    assert len(rig.command("valves", [metric("Outputs/lamp", boolean=True)])) == 1
    rig.close()


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
    rig.connect()
    rig.pump()
    yield rig
    rig.close()


def test_an_order_wish_has_the_name_of_the_run(rig: Rig) -> None:
    assert rig.command("valves", [metric("Outputs/lamp", boolean=False)]) == [
        OrderWish("valves.lamp", False, round(rig.wall * 1000) / 1000)
    ]
