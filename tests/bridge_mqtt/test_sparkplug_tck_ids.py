"""The rules of Sparkplug 3.0.0 by their ids (``tck-id-...``, here without this beginning): a test for each that binds
an edge node or a device; the others with the reason why none is here.

The ids are those of the specification: chapters 1, 2, 3 and 10 (25), and chapters 4, 5 and 6 (274).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import pytest
from edge_node_rig import GROUP, NODE, NewRig, Rig, metric
from history_rig import HistoryRig
from plant_items import PLANT
from sparkplug_host import FIELD_OF, Payload, read_payload

from dpstack.bridge.mqtt.plant_node import Disconnect, NodeSetup, Phase
from dpstack.errors import ConfigError

#: ids by the test that shows them
SHOWN: Final[dict[str, tuple[str, ...]]] = {}
#: ids that bind nobody here, by the reason
NOT_HERE: Final[dict[str, str]] = {
    "they bind a host application": """
        intro-sparkplug-host-state components-ph-state conformance-primary-host
        host-topic-phid-birth-message host-topic-phid-birth-payload host-topic-phid-birth-payload-timestamp
        host-topic-phid-birth-qos host-topic-phid-birth-required host-topic-phid-birth-retain
        host-topic-phid-birth-sub-required host-topic-phid-birth-topic host-topic-phid-death-payload
        host-topic-phid-death-payload-timestamp-connect host-topic-phid-death-payload-timestamp-disconnect-clean
        host-topic-phid-death-payload-timestamp-disconnect-with-no-disconnect-packet host-topic-phid-death-qos
        host-topic-phid-death-required host-topic-phid-death-retain host-topic-phid-death-topic
        message-flow-hid-sparkplug-state-message-delivered message-flow-phid-sparkplug-clean-session-311
        message-flow-phid-sparkplug-clean-session-50 message-flow-phid-sparkplug-state-publish
        message-flow-phid-sparkplug-state-publish-payload message-flow-phid-sparkplug-state-publish-payload-timestamp
        message-flow-phid-sparkplug-subscription
        operational-behavior-data-commands-dcmd-metric-name operational-behavior-data-commands-dcmd-metric-value
        operational-behavior-data-commands-dcmd-verb operational-behavior-data-commands-ncmd-metric-name
        operational-behavior-data-commands-ncmd-metric-value operational-behavior-data-commands-ncmd-rebirth-name
        operational-behavior-data-commands-ncmd-rebirth-value operational-behavior-data-commands-ncmd-rebirth-verb
        operational-behavior-data-commands-ncmd-verb
        operational-behavior-edge-node-termination-host-action-ddeath-devices-offline
        operational-behavior-edge-node-termination-host-action-ddeath-devices-tags-stale
        operational-behavior-edge-node-termination-host-action-ndeath-devices-offline
        operational-behavior-edge-node-termination-host-action-ndeath-devices-tags-stale
        operational-behavior-edge-node-termination-host-action-ndeath-node-offline
        operational-behavior-edge-node-termination-host-action-ndeath-node-tags-stale
        operational-behavior-host-application-connect-birth operational-behavior-host-application-connect-birth-payload
        operational-behavior-host-application-connect-birth-qos
        operational-behavior-host-application-connect-birth-retained
        operational-behavior-host-application-connect-birth-topic operational-behavior-host-application-connect-will
        operational-behavior-host-application-connect-will-payload
        operational-behavior-host-application-connect-will-qos
        operational-behavior-host-application-connect-will-retained
        operational-behavior-host-application-connect-will-topic operational-behavior-host-application-death-payload
        operational-behavior-host-application-death-qos operational-behavior-host-application-death-retained
        operational-behavior-host-application-death-topic
        operational-behavior-host-application-disconnect-intentional operational-behavior-host-application-host-id
        operational-behavior-host-application-multi-server-timestamp
        operational-behavior-host-application-termination operational-behavior-host-reordering-param
        operational-behavior-host-reordering-rebirth operational-behavior-host-reordering-start
        operational-behavior-host-reordering-success
        operational-behavior-primary-application-state-with-multiple-servers-state
        payloads-dcmd-qos payloads-dcmd-retain payloads-dcmd-seq payloads-dcmd-timestamp
        payloads-ncmd-qos payloads-ncmd-retain payloads-ncmd-seq payloads-ncmd-timestamp payloads-name-cmd-requirement
        payloads-state-birth payloads-state-birth-payload payloads-state-subscribe payloads-state-will-message
        payloads-state-will-message-payload payloads-state-will-message-qos payloads-state-will-message-retain
        topics-dcmd-mqtt topics-dcmd-payload topics-dcmd-timestamp topics-dcmd-topic
        topics-ncmd-mqtt topics-ncmd-payload topics-ncmd-timestamp topics-ncmd-topic
    """,
    "they bind a broker": """
        conformance-mqtt-qos0 conformance-mqtt-qos1 conformance-mqtt-will-messages conformance-mqtt-retained
        conformance-mqtt-aware-basic conformance-mqtt-aware-store conformance-mqtt-aware-nbirth-mqtt-topic
        conformance-mqtt-aware-nbirth-mqtt-retain conformance-mqtt-aware-dbirth-mqtt-topic
        conformance-mqtt-aware-dbirth-mqtt-retain conformance-mqtt-aware-ndeath-timestamp
    """,
    "dpstack has one broker: there is no next one to go to": """
        operational-behavior-edge-node-termination-host-offline-reconnect
        operational-behavior-primary-application-state-with-multiple-servers-single-server
        operational-behavior-primary-application-state-with-multiple-servers-walk
    """,
    "dpstack sends no templates": """
        topics-nbirth-templates payloads-template-definition-is-definition payloads-template-definition-members
        payloads-template-definition-nbirth payloads-template-definition-nbirth-only
        payloads-template-definition-parameters payloads-template-definition-parameters-default
        payloads-template-definition-ref payloads-template-instance-is-definition payloads-template-instance-members
        payloads-template-instance-members-birth payloads-template-instance-members-data
        payloads-template-instance-parameters payloads-template-instance-ref payloads-template-is-definition
        payloads-template-is-definition-definition payloads-template-is-definition-instance
        payloads-template-parameter-name-required payloads-template-parameter-name-type
        payloads-template-parameter-type-req payloads-template-parameter-type-value payloads-template-parameter-value
        payloads-template-parameter-value-type payloads-template-ref-definition payloads-template-ref-instance
        payloads-template-version
    """,
    "dpstack sends no data sets": """
        payloads-dataset-column-num-headers payloads-dataset-column-size payloads-dataset-parameter-type-req
        payloads-dataset-types-def payloads-dataset-types-num payloads-dataset-types-type payloads-dataset-types-value
        payloads-template-dataset-value
    """,
    "dpstack speaks MQTT 5 only": """
        principles-persistence-clean-session-311 payloads-ndeath-will-message-publisher-disconnect-mqtt311
    """,
    "the configuration gives group and node; a second gateway with the same ones is refused on one computer "
    "(test_history_file.py), and told where a broker shows it (tests/strangers/test_mosquitto.py)": """
        intro-edge-node-id-uniqueness topic-structure-namespace-unique-edge-node-descriptor
        payloads-nbirth-edge-node-descriptor
    """,
    "a permission": "topic-structure-namespace-duplicate-device-id-across-edge-node",
    "they are shown with a broker (test_mqtt_broker.py, tests/strangers/test_mosquitto.py): the properties of CONNECT "
    "and DISCONNECT": """
        principles-persistence-clean-session-50 payloads-ndeath-will-message-publisher-disconnect-mqtt50
        operational-behavior-edge-node-intentional-disconnect-packet
    """,
}


INPUTS: Final = [{"name": name, "type": "u8", "at": "u8@0"} for name in ("A", "a")]


def shows(*ids: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Marks a test with the rules that it shows."""

    def mark(test: Callable[..., None]) -> Callable[..., None]:
        SHOWN[test.__name__] = tuple(one for text in ids for one in text.split())
        return test

    return mark


class Course:
    """A course with births, data, a slave that goes and comes back, a rebirth, and an ordered end."""

    def __init__(self, folder: Path) -> None:
        self.rig = rig = Rig(folder)
        rig.give_plant()
        rig.connect()
        assert rig.connection is not None
        self.connection = rig.connection
        assert rig.pump() == 3
        for level in (30.0, 60.0):
            rig.values["8"]["fields"]["level"] = level
            rig.turn()
        rig.values["8"]["state"] = "offline"
        rig.turn()
        rig.command("valves", [metric("Outputs/lamp", boolean=True)])
        rig.turn()
        self.rebirth_at = len(rig.sent)
        rig.rebirth()
        rig.pump()
        rig.values["8"]["state"] = "data_exchange"
        rig.turn(11.0)
        self.end_at = len(rig.sent)
        rig.node.end("the end")
        rig.pump()
        rig.close()
        self.messages = [(one.topic.split("/"), read_payload(one.payload), one.qos) for one in rig.sent]

    def of(self, *kinds: str) -> Iterator[tuple[list[str], Payload, int]]:
        found = [one for one in self.messages if one[0][2] in kinds]
        assert {one[0][2] for one in found} == set(kinds)
        yield from found

    @property
    def live(self) -> list[Payload]:
        """All but NDEATH."""
        return [payload for topic, payload, _ in self.messages if topic[2] != "NDEATH"]


@pytest.fixture(scope="module")
def course(tmp_path_factory: pytest.TempPathFactory) -> Course:
    return Course(tmp_path_factory.mktemp("course"))


# --- topics -------------------------------------------------------------------------------------------------------


@shows(
    "topic-structure topic-structure-namespace-a intro-group-id-string intro-edge-node-id-string",
    "intro-device-id-string",
    "topics-nbirth-topic topics-ndata-topic topics-dbirth-topic topics-ddata-topic topics-ddeath-topic",
    "message-flow-edge-node-birth-publish-nbirth-topic message-flow-device-birth-publish-dbirth-topic",
    "message-flow-device-birth-publish-dbirth-match-edge-node-topic",
    "topic-structure-namespace-device-id-associated-message-types",
    "topic-structure-namespace-device-id-non-associated-message-types topics-ndeath-topic",
)
def test_topics(course: Course) -> None:
    for kind in ("NBIRTH", "NDATA", "NDEATH"):
        assert all(topic == ["spBv1.0", GROUP, kind, NODE] for topic, _, _ in course.of(kind))
    for kind in ("DBIRTH", "DDATA", "DDEATH"):
        for topic, _, _ in course.of(kind):
            assert topic[:4] == ["spBv1.0", GROUP, kind, NODE]
            assert len(topic) == 5
            assert topic[4] in ("hoist", "valves")


@shows(
    "intro-group-id-chars intro-edge-node-id-chars intro-device-id-chars topic-structure-namespace-valid-group-id",
    "topic-structure-namespace-valid-edge-node-id topic-structure-namespace-valid-device-id",
    "topic-structure-namespace-unique-device-id case-sensitivity-sparkplug-ids case-sensitivity-metric-names",
)
def test_ids_are_valid_and_unique(tmp_path: Path) -> None:
    for wrong in ("", "a/b", "+", "#", "\ud800"):
        for names in ((wrong, NODE), (GROUP, wrong)):
            with pytest.raises(ConfigError, match="MQTT does not permit this name"):
                NodeSetup(*names)
    rig = Rig(tmp_path)
    rig.plant["slaves"] = {
        str(address): PLANT["slaves"]["8"] | {"name": name, "inputs": INPUTS}
        for address, name in ((8, "a/+#"), (9, "A___"), (10, "a___"), (11, "\ud800"))
    }
    rig.values = dict.fromkeys(rig.plant["slaves"], rig.values["8"])
    rig.give_plant()
    rig.connect()
    assert rig.pump() == 5  # the host asserts that the names of metrics are unique
    assert len({one.casefold() for one in rig.host.alive}) == 4
    for one in rig.host.alive:
        one.encode()
        assert not set(one) & set("+/#")
    rig.close()


# --- the connection -----------------------------------------------------------------------------------------------


@shows(
    "message-flow-edge-node-birth-publish-will-message message-flow-edge-node-birth-publish-will-message-payload",
    "message-flow-edge-node-birth-publish-will-message-payload-bdSeq",
    "message-flow-edge-node-birth-publish-will-message-qos message-flow-edge-node-birth-publish-will-message-topic",
    "message-flow-edge-node-birth-publish-will-message-will-retained",
    "payloads-ndeath-will-message payloads-ndeath-will-message-qos payloads-ndeath-will-message-retain",
    "payloads-ndeath-bdseq payloads-ndeath-seq topics-ndeath-payload topics-ndeath-seq",
    "topics-nbirth-bdseq-included topics-nbirth-bdseq-matching topics-nbirth-bdseq-increment",
    "payloads-nbirth-bdseq payloads-nbirth-bdseq-repeat message-flow-edge-node-birth-publish-nbirth-payload-bdSeq",
)
def test_the_will_has_the_number_of_the_births_and_it_rises_by_one(new_rig: NewRig) -> None:
    rig = new_rig()
    for session in range(258):
        rig.connect()
        assert rig.connection is not None
        will = rig.connection.will
        assert will.topic == f"spBv1.0/{GROUP}/NDEATH/{NODE}"
        assert (will.qos, will.retain) == (1, False)
        death = read_payload(will.payload)
        assert death.seq is None
        (number,) = death.metrics
        assert (number.name, number.datatype, number.value(4)) == ("bdSeq", 4, session % 256)
        rig.pump(1)
        (born,) = [one for one in rig.host.messages[-1][2].metrics if one.name == "bdSeq"]
        assert (born.datatype, born.value(4)) == (4, session % 256)
        rig.cut()
        rig.wills.clear()


@shows("message-flow-edge-node-ncmd-subscribe message-flow-device-dcmd-subscribe")
def test_subscriptions(course: Course) -> None:
    """Each is made with QoS 1: tests/strangers/test_mosquitto.py."""
    assert course.connection.subscriptions == (f"spBv1.0/{GROUP}/NCMD/{NODE}", f"spBv1.0/{GROUP}/DCMD/{NODE}/+")


@shows(
    "message-flow-edge-node-birth-publish-connect principles-birth-certificates-order",
    "payloads-dbirth-order payloads-ndata-order payloads-ddata-order message-flow-device-birth-publish-nbirth-wait",
)
def test_births_come_first(course: Course) -> None:
    kinds = [topic[2] for topic, _, _ in course.messages]
    assert kinds[:3] == ["NBIRTH", "DBIRTH", "DBIRTH"]
    assert kinds[course.rebirth_at : course.rebirth_at + 3] == ["NBIRTH", "DBIRTH", "DBIRTH"] or kinds[
        course.rebirth_at : course.rebirth_at + 2
    ] == ["NBIRTH", "DBIRTH"]
    rig = course.rig
    rig.start()
    rig.give_plant()
    assert rig.node.phase is Phase.OFFLINE
    assert rig.node.next(rig.wall, rig.clock) is None
    rig.close()


@shows(
    "operational-behavior-edge-node-intentional-disconnect-ndeath payloads-ndeath-will-message-publisher",
)
def test_an_ordered_end_publishes_ndeath_and_then_disconnects(course: Course) -> None:
    assert [topic[2] for topic, _, _ in course.messages[course.end_at :]] == ["NDEATH"]
    rig = course.rig
    rig.start()
    rig.give_plant()
    rig.node.connect(0, rig.wall)
    rig.node.connected()
    rig.node.end("the end")
    rig.node.next(rig.wall, rig.clock)
    assert isinstance(rig.node.next(rig.wall, rig.clock), Disconnect)
    rig.close()


# --- messages -----------------------------------------------------------------------------------------------------


@shows(
    "topics-nbirth-mqtt topics-ndata-mqtt topics-dbirth-mqtt topics-ddata-mqtt topics-ddeath-mqtt",
    "payloads-nbirth-qos payloads-nbirth-retain payloads-ndata-qos payloads-ndata-retain payloads-dbirth-qos",
    "payloads-dbirth-retain payloads-ddata-qos payloads-ddata-retain",
    "message-flow-edge-node-birth-publish-nbirth-qos message-flow-edge-node-birth-publish-nbirth-retained",
    "message-flow-device-birth-publish-dbirth-qos message-flow-device-birth-publish-dbirth-retained",
)
def test_quality_of_service_is_0_and_nothing_is_retained(course: Course) -> None:
    """A subscriber of a real broker sees the same: tests/strangers/test_mosquitto.py."""
    assert {(one.qos, one.retain) for one in course.rig.sent} == {(0, False)}


@shows(
    "topics-nbirth-seq-num topics-ndata-seq-num topics-dbirth-seq topics-ddata-seq-num topics-ddeath-seq-num",
    "payloads-sequence-num-always-included payloads-sequence-num-incrementing payloads-sequence-num-req-nbirth",
    "payloads-nbirth-seq payloads-ndata-seq payloads-ndata-seq-inc payloads-dbirth-seq payloads-dbirth-seq-inc",
    "payloads-ddata-seq payloads-ddata-seq-inc payloads-ddeath-seq payloads-ddeath-seq-inc payloads-ddeath-seq-number",
    "message-flow-edge-node-birth-publish-nbirth-payload-seq message-flow-device-birth-publish-dbirth-payload-seq",
)
def test_sequence_numbers(course: Course) -> None:
    """They wrap behind 255: test_edge_node_sessions.py."""
    before: int | None = None
    for topic, payload, _ in course.messages:
        if topic[2] == "NDEATH":
            assert payload.seq is None
            continue
        assert payload.seq is not None
        assert payload.seq == (0 if topic[2] == "NBIRTH" or before is None else (before + 1) % 256)
        before = payload.seq


@shows(
    "topics-nbirth-timestamp topics-ndata-timestamp topics-dbirth-timestamp topics-ddata-timestamp",
    "payloads-nbirth-timestamp payloads-ndata-timestamp payloads-dbirth-timestamp payloads-ddata-timestamp",
    "payloads-ddeath-timestamp payloads-timestamp-in-UTC payloads-metric-timestamp-in-UTC",
    "payloads-name-birth-data-requirement",
)
def test_timestamps_are_milliseconds_since_1970_and_in_order(course: Course) -> None:
    for payload in course.live:
        assert payload.timestamp is not None
        assert 1_700_000_000_000 <= payload.timestamp < 1_700_000_100_000
        times = [one.timestamp or 0 for one in payload.metrics]
        assert times == sorted(times)
        assert all(1_699_999_999_000 <= one <= payload.timestamp for one in times)


@shows("operational-behavior-data-publish-nbirth-order operational-behavior-data-publish-dbirth-order")
def test_values_are_in_order_of_time_and_history_is_marked(tmp_path: Path) -> None:
    """The rule binds metrics with is_historical = false; those of history are in order, too."""
    rig = HistoryRig(tmp_path)
    rig.give_plant()
    for _ in range(4):
        rig.count()
    rig.values["8"]["inputs_age_ms"] = 90.0  # older than the facts of the master
    rig.step_disk()
    rig.settle()
    rig.close()
    marked = set()
    for _, _, payload in rig.host.messages:
        for historical in (False, True):
            times = [one.timestamp or 0 for one in payload.metrics if bool(one.historical) is historical]
            assert times == sorted(times)
            marked |= {historical} if times else set()
    assert marked == {False, True}


@shows(
    "message-flow-edge-node-birth-publish-nbirth-payload message-flow-device-birth-publish-dbirth-payload",
    "topics-nbirth-metrics topics-dbirth-metrics payloads-metric-datatype-req payloads-metric-datatype-value",
    "payloads-metric-datatype-value-type payloads-name-requirement payloads-alias-birth-requirement",
    "operational-behavior-data-publish-nbirth-values operational-behavior-data-publish-dbirth-values",
)
def test_metrics_of_births_have_name_type_and_value_or_null(course: Course) -> None:
    nulls = 0
    for _, payload, _ in course.of("NBIRTH", "DBIRTH"):
        for one in payload.metrics:
            assert one.name
            assert one.datatype in FIELD_OF
            assert one.alias is not None or one.name == "Node Control/Rebirth"
            value = one.value(one.datatype)
            nulls += value is None
            assert one.null == (one.raw is None)
    assert nulls


@shows("payloads-alias-uniqueness")
def test_aliases_are_unique_in_the_edge_node(course: Course) -> None:
    births = [payload for topic, payload, _ in course.messages[:3] if topic[2].endswith("BIRTH")]
    aliases = [one.alias for payload in births for one in payload.metrics if one.alias is not None]
    assert len(aliases) == len(set(aliases)) > 50


@shows("payloads-alias-data-cmd-requirement payloads-metric-datatype-not-req")
def test_data_have_aliases_and_neither_names_nor_types(course: Course) -> None:
    for _, payload, _ in course.of("NDATA", "DDATA"):
        assert payload.metrics
        assert {(one.name, one.datatype) for one in payload.metrics} == {(None, None)}
        assert all(one.alias is not None for one in payload.metrics)


@shows(
    "topics-nbirth-metric-reqs topics-dbirth-metric-reqs operational-behavior-data-publish-nbirth",
    "operational-behavior-data-publish-dbirth",
)
def test_births_have_all_metrics_and_no_other_is_published(course: Course) -> None:
    tree = course.rig.tree
    slave_of = {"hoist": 3, "valves": 8}
    for topic, payload, _ in course.of("NBIRTH", "DBIRTH"):
        slave = slave_of[topic[4]] if topic[2] == "DBIRTH" else None
        assert {"/".join(node.path) for node, _ in tree.readings(slave)} <= {one.name for one in payload.metrics}
    born: dict[str, set[int | None]] = {}
    for topic, payload, _ in course.messages:
        owner = "/".join(topic[3:])
        aliases = {one.alias for one in payload.metrics}
        if topic[2].endswith("BIRTH"):
            born[owner] = aliases
        elif topic[2].endswith("DATA"):
            assert aliases <= born[owner]


@shows(
    "principles-rbe-recommended topics-ndata-payload topics-ddata-payload",
    "operational-behavior-data-publish-nbirth-change operational-behavior-data-publish-dbirth-change",
)
def test_data_are_published_when_they_change(new_rig: NewRig) -> None:
    rig = new_rig()
    rig.join()
    for _ in range(20):
        assert rig.turn() == 0
    rig.values["8"]["fields"]["lamp"] = True
    assert rig.turn() == 1
    assert rig.host.metric("Outputs/lamp", "valves").value is True


@shows("operational-behavior-device-ddeath")
def test_a_slave_that_leaves_data_exchange_has_its_ddeath(course: Course) -> None:
    assert [topic[4] for topic, _, _ in course.of("DDEATH")] == ["valves"]


@shows(
    "payloads-propertyset-keys-array-size payloads-propertyset-values-array-size",
    "payloads-propertyset-quality-value-type payloads-propertyset-quality-value-value",
    "payloads-metric-propertyvalue-type-req payloads-metric-propertyvalue-type-type",
    "payloads-metric-propertyvalue-type-value",
)
def test_properties(course: Course, new_rig: NewRig) -> None:
    """The reader asserts that there are as many keys as values, each with a type (tests/kits/sparkplug_host.py)."""
    rig = new_rig()
    rig.join()
    rig.wait(3.0, stream=False)
    rig.pump()
    qualities = set()
    for payload in (*course.live, *(payload for _, _, payload in rig.host.messages)):
        for one in payload.metrics:
            assert set(one.property_types.values()) <= {3, 10, 11, 12}
            if "Quality" in one.properties:
                assert one.property_types["Quality"] == 3
                qualities.add(one.properties["Quality"])
    assert qualities == {0, 192, 500}


# --- rebirth ------------------------------------------------------------------------------------------------------


@shows(
    "topics-nbirth-rebirth-metric payloads-nbirth-rebirth-req operational-behavior-data-commands-rebirth-name",
    "operational-behavior-data-commands-rebirth-name-aliases operational-behavior-data-commands-rebirth-datatype",
    "operational-behavior-data-commands-rebirth-value",
)
def test_the_rebirth_metric(course: Course) -> None:
    for _, payload, _ in course.of("NBIRTH"):
        (one,) = [one for one in payload.metrics if one.name == "Node Control/Rebirth"]
        assert (one.alias, one.datatype, one.value(11)) == (None, 11, False)


@shows(
    "operational-behavior-data-commands-rebirth-action-1 operational-behavior-data-commands-rebirth-action-2",
    "operational-behavior-data-commands-rebirth-action-3",
)
def test_a_rebirth_stops_data_and_gives_all_births_with_the_same_number(new_rig: NewRig) -> None:
    rig = new_rig()
    rig.join()
    number = rig.host.number
    rig.wait(1.0)
    rig.values["8"]["fields"]["level"] = 99.0
    rig.give_values()
    rig.command(None, [metric("Node Control/Rebirth", boolean=True)])
    count = len(rig.sent)
    rig.pump()
    assert [one.topic.split("/")[2] for one in rig.sent[count:]] == ["NBIRTH", "DBIRTH", "DBIRTH"]
    assert rig.host.number == number


# --- the primary host ---------------------------------------------------------------------------------------------


@shows(
    "message-flow-edge-node-birth-publish-phid-wait message-flow-edge-node-birth-publish-phid-wait-id",
    "message-flow-edge-node-birth-publish-phid-wait-online message-flow-edge-node-birth-publish-phid-wait-timestamp",
    "message-flow-edge-node-birth-publish-phid-offline operational-behavior-edge-node-birth-sequence-wait",
    "operational-behavior-edge-node-termination-host-offline",
    "operational-behavior-edge-node-termination-host-offline-timestamp",
    "operational-behavior-primary-application-state-with-multiple-servers-state-subs",
)
def test_births_wait_for_the_primary_host_and_end_with_it(new_rig: NewRig) -> None:
    rig = new_rig(primary_host="scada")
    rig.connect()
    assert rig.connection is not None
    assert "spBv1.0/STATE/scada" in rig.connection.subscriptions
    rig.state(online=True, time_ms=500, host="scada2")
    rig.state(online=False, time_ms=500)
    rig.state(online=True, time_ms=499)
    assert rig.pump() == 0
    rig.state(online=True, time_ms=500)
    assert rig.pump() == 3
    rig.state(online=False, time_ms=499)
    assert rig.pump() == 0
    assert rig.host.online
    rig.state(online=False, time_ms=500)
    rig.pump()
    assert rig.sent[-1].topic.split("/")[2] == "NDEATH"
    assert rig.node.phase is Phase.OFFLINE
    assert rig.host.alive == set()


# --- the table ----------------------------------------------------------------------------------------------------


def test_every_rule_is_shown_or_has_its_reason() -> None:
    shown = [one for ids in SHOWN.values() for one in ids]
    others = [one for ids in NOT_HERE.values() for one in ids.split()]
    both = sorted((*shown, *others))
    assert len(both) == len(set(both))
    assert set(SHOWN) <= set(globals())
    assert len(both) == 299
