"""The OPC UA connector with clients of asyncua: values, orders, rights, alarms, history, bad input."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import inspect
import math
import stat
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import pytest
import pytest_asyncio
from asyncua import Client, ua
from asyncua.common.utils import ServiceError
from asyncua.server.address_space import NodeManagementService
from far_ends import beside
from opcua_rig import ANNA, BOB, Rig, id_of, item, subscribed

from dpstack.bridge.opcua import sessions as limits
from dpstack.bridge.opcua.alarms import SERVER, Event, refresh
from dpstack.bridge.opcua.certificate import utc_now
from dpstack.bridge.opcua.connector import OpcUaConnector
from dpstack.bridge.opcua.sessions import MOST_QUEUE
from dpstack.bridge.opcua.space import Space
from dpstack.bridge.opcua.subscriptions import Subscription
from dpstack.bridge.orders import Orders
from dpstack.errors import ConfigError, PortError
from dpstack.plant.conditions import Condition, ConditionBook
from dpstack.plant.nodes import DRIVE_STATES
from dpstack.plant.orders import DriveOrder, SetOutputs
from dpstack.profile.model.states import State
from dpstack.trace import Severity

pytestmark = pytest.mark.asyncio(loop_scope="module")
#: by the numbers of OPC 10000-6, annex A
GOOD: Final = 0
BAD_ACCESS_DENIED, BAD_NOT_WRITABLE, BAD_TYPE, BAD_RANGE = 0x801F0000, 0x803B0000, 0x80740000, 0x803C0000
BAD_STATE, BAD_NO_COMMUNICATION, BAD_NODE = 0x80AF0000, 0x80310000, 0x80340000
UNCERTAIN_NO_COMMUNICATION: Final = 0x408F0000
BAD_PART: Final = 0x80370000


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    """One server for all: its standard nodes take a second."""
    async with Rig(tmp_path_factory.mktemp("opcua")).serving() as rig:
        yield rig


class Seen:
    """The events and values that a subscription got."""

    def __init__(self) -> None:
        self.events: list[Any] = []
        self.values: list[Any] = []

    def event_notification(self, event: Any) -> None:
        self.events.append(event)

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        self.values.append(data.monitored_item.Value)


async def write(client: Client, node: str, value: object, type_: ua.VariantType, age_s: float | None = None) -> int:
    made_at = None if age_s is None else utc_now() - timedelta(seconds=age_s)
    data = ua.DataValue(ua.Variant(value, type_), SourceTimestamp=made_at)
    one = ua.WriteValue(id_of(node), ua.AttributeIds.Value, Value=data)
    [found] = await client.uaclient.write(ua.WriteParameters([one]))
    return int(found.value)


async def call(client: Client, owner: ua.NodeId, method: ua.NodeId, *arguments: ua.Variant) -> int:
    [found] = await client.uaclient.call([ua.CallMethodRequest(owner, method, list(arguments))])
    return int(found.StatusCode.value)


@contextlib.contextmanager
def delayed(client: Client, seconds: float) -> Iterator[None]:
    """The network holds up the requests of ``client``."""
    protocol = client.uaclient.protocol
    assert protocol is not None
    as_before = protocol._setup_request_header

    def set_up(header: ua.RequestHeader, timeout: float = 1) -> None:
        as_before(header, timeout)
        header.Timestamp = utc_now() - timedelta(seconds=seconds)

    protocol._setup_request_header = set_up
    yield
    protocol._setup_request_header = as_before


async def test_values_come_with_type_unit_status_and_source_time(rig: Rig) -> None:
    async with rig.connected() as client:
        level = client.get_node(id_of("slave/8/input/level"))
        read = await level.read_data_value()
        assert (read.Value.Value, read.Value.VariantType, read.StatusCode.value) == (5.5, ua.VariantType.Double, GOOD)
        assert read.SourceTimestamp.timestamp() == pytest.approx(1_700_000_000.099)
        unit = await level.get_child("0:EngineeringUnits")
        assert (await unit.read_value()).DisplayName.Text == "mm"
        assert (await (await level.get_child("0:EURange")).read_value()).High == pytest.approx(3276.7)
        drive = client.get_node(id_of("slave/9/drive"))
        state = await drive.get_child(["2:StateMachine", "0:CurrentState"])
        assert (await state.read_value()).Text == "ready"
        assert (await (await state.get_child("0:Id")).read_value()) == id_of("state/ready")
        names = [await one.read_browse_name() for one in await client.get_node(id_of("slave/8")).get_children()]
        assert {"Inputs", "Outputs", "State", "Statistics"} <= {one.Name for one in names}
    assert tuple(State) == DRIVE_STATES


async def test_a_bad_value_keeps_its_number_beside_its_status_and_its_reason_in_words(rig: Rig) -> None:
    """In values, history and events; the property changes together with the value."""
    fine = rig.values["8"]
    broken = {"quality": "bad", "reason": "channel_fault", "text": "line break: slot 3 (2 AI), input channel 0"}
    doubt = {"quality": "uncertain", "reason": "slot_fault", "text": "has a diagnosis: slot 3"}
    seen = Seen()
    async with rig.connected() as client:
        subscription = await client.create_subscription(100, seen)
        level = client.get_node(id_of("slave/8/input/level"))
        reason = await level.get_child("2:Reason")
        assert reason.nodeid == id_of("property/slave/8/input/level/reason")
        assert await reason.read_data_type() == ua.NodeId(ua.ObjectIds.String)
        await subscription.subscribe_events(SERVER, ua.ObjectIds.OffNormalAlarmType)
        found: list[tuple[int, object, object]] = []
        for quality in (doubt, broken, None):
            values = fine | {"fields": fine["fields"] | {"level": 327.6 if quality is broken else 5.5}}
            rig.show("8", values if quality is None else values | {"qualities": {"level": quality}})
            await rig.until(lambda: not rig.connector._changed)
            read = await level.read_data_value(raise_on_bad_status=False)
            found.append((read.StatusCode.value, read.Value.Value, await reason.read_value()))
            assert found[-1][2] == ("" if quality is None else quality["text"])
        assert [one[:2] for one in found] == [(0x40950000, 5.5), (0x808C0000, 327.6), (GOOD, 5.5)]
        history = await level.read_raw_history(utc_now() - timedelta(days=9999), utc_now(), 1000)
        kept = [one for one in history if one.StatusCode.value != ua.StatusCodes.BadBoundNotFound]
        assert [(one.StatusCode.value, one.Value.Value) for one in kept][-3:] == [one[:2] for one in found]
        # the source time is that of the snapshot, 1 ms before
        assert kept[-2].SourceTimestamp.timestamp() == pytest.approx(1_700_000_000 + rig.t - 0.1 - 0.001)
        await rig.until(lambda: len(seen.events) >= 3)
        assert [(one.Severity, one.Message.Text) for one in seen.events[:2]] == [
            (500, "level: has a diagnosis: slot 3"),
            (800, "level: line break: slot 3 (2 AI), input channel 0"),
        ]
        rig.connector.acknowledge("slave/8/diagnosis")
        # a drive's quantities have theirs, and its type declares it
        for node in ("slave/9/drive/speed", "type/DriveType/value/speed"):
            assert await (await client.get_node(id_of(node)).get_child("2:Reason")).read_value() == ""


async def test_the_first_client_finds_the_whole_plant(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    await rig.connector.open()
    client = rig.client()

    async def read() -> tuple[int, object]:
        await client.set_security_string(rig.security)
        async with client:
            found = await client.get_node(id_of("slave/8/input/level")).read_data_value(raise_on_bad_status=False)
            return found.StatusCode.value, found.Value.Value

    async with beside(rig.connector.serve()):
        reading = asyncio.create_task(read())
        await asyncio.sleep(0.3)
        rig.plant()
        rig.snapshot()
        assert await reading == (GOOD, 5.5)
    rig.connector.close()


CANNOT = "this value cannot be written, or allow_commands does not list it"


async def test_orders_need_the_list_the_user_and_the_type(rig: Rig) -> None:
    lamp, horn, flow = (f"slave/8/output/{name}" for name in ("lamp", "horn", "flow"))
    boolean, u16 = ua.VariantType.Boolean, ua.VariantType.UInt16
    rig.given.clear()
    async with rig.connected() as anonymous, rig.connected(BOB) as bob, rig.connected(ANNA) as anna:
        assert await write(anonymous, lamp, True, boolean) == BAD_ACCESS_DENIED
        assert await write(bob, lamp, True, boolean) == BAD_ACCESS_DENIED
        assert await write(anna, horn, True, boolean) == BAD_NOT_WRITABLE
        assert await write(anna, "slave/8/input/level", 1.0, ua.VariantType.Double) == BAD_NOT_WRITABLE
        assert await write(anna, lamp, 1, u16) == BAD_TYPE
        assert await write(anna, "slave/8/output/none", 1, u16) == BAD_NODE
        assert await write(anna, flow, 4000, u16) == BAD_STATE
        reason = await anna.get_node(id_of("last/Reason")).read_value()
        assert reason == "the run refuses 4000"
        assert rig.given == []
        assert [(one.origin, one.order, one.reason) for one in rig.refused] == [
            ("opcua (anonymous)", "valves.lamp", "this user may give no orders (BadUserAccessDenied)"),
            ("opcua (bob)", "valves.lamp", "this user may give no orders (BadUserAccessDenied)"),
            ("opcua (anna)", "valves.horn", f"{CANNOT} (BadNotWritable)"),
            ("opcua (anna)", "slave/8/input/level", f"{CANNOT} (BadNotWritable)"),
            ("opcua (anna)", "valves.lamp", "its value has another type (BadTypeMismatch)"),
            ("opcua (anna)", "ns=2;s=slave/8/output/none", "there is no such node (BadNodeIdUnknown)"),
            ("opcua (anna)", "valves.flow", "the run refuses 4000"),
        ]
        assert all(one.order_time == "" for one in rig.refused)
        assert await write(anna, lamp, True, boolean) == GOOD
        assert rig.given == [SetOutputs(8, {"lamp": True})]
        for age_s in (60.0, -60.0):
            assert await write(anna, lamp, False, boolean, age_s) == 0x80230000  # BadInvalidTimestamp
            age = datetime.now(UTC) - datetime.fromisoformat(rig.refused[-1].order_time)
            assert age.total_seconds() == pytest.approx(age_s, abs=5)
            assert "set the clocks" in await anna.get_node(id_of("last/Reason")).read_value() or age_s > 0
        assert await write(anna, lamp, False, boolean, 0.0) == GOOD
        assert rig.given == [SetOutputs(8, {"lamp": True}), SetOutputs(8, {"lamp": False})]
        access = [(await one.get_node(id_of(lamp)).read_attribute(ua.AttributeIds.UserAccessLevel)).Value.Value & 2
                  for one in (anonymous, bob, anna)]  # fmt: skip
        assert access == [0, 0, 2]
        assert await anna.get_node(id_of(lamp)).read_value() is False  # the stream tells, never an echo


async def test_outputs_of_one_slave_in_a_write_are_one_order(rig: Rig) -> None:
    async def written(client: Client, *outputs: tuple[str, object, ua.VariantType]) -> list[int]:
        ones = [
            ua.WriteValue(
                id_of(f"slave/8/output/{name}"), ua.AttributeIds.Value, Value=ua.DataValue(ua.Variant(*value))
            )
            for name, *value in outputs
        ]
        return [int(found.value) for found in await client.uaclient.write(ua.WriteParameters(ones))]

    boolean, u16 = ua.VariantType.Boolean, ua.VariantType.UInt16
    rig.given.clear()
    async with rig.connected(ANNA) as anna:
        mixed = (("flow", 9, u16), ("horn", True, boolean), ("lamp", 7, u16), ("lamp", True, boolean))
        assert await written(anna, *mixed) == [GOOD, BAD_NOT_WRITABLE, BAD_TYPE, GOOD]
        assert rig.given == [SetOutputs(8, {"flow": 9, "lamp": True})]
        # the run takes all or none
        assert await written(anna, ("lamp", False, boolean), ("flow", 4000, u16)) == [BAD_STATE] * 2
        assert await anna.get_node(id_of("last/Reason")).read_value() == "the run refuses 4000"
        assert len(rig.given) == 1


async def test_orders_that_nobody_may_give_are_told_at_the_start(tmp_path: Path) -> None:
    rig = Rig(tmp_path, users_file=None)
    await rig.connector.open()
    rig.connector.close()
    assert "nobody may give these orders, as no user has the right control; give a users_file" in rig.told[0]


async def test_a_stop_overtakes_starts_that_take_long(rig: Rig) -> None:
    drive = id_of("slave/9/drive")

    def method(word: str) -> ua.NodeId:
        return id_of(f"slave/9/drive/method/{word}")

    rig.given.clear()
    rig.slow.clear()
    async with rig.connected() as anonymous, rig.connected(ANNA) as anna:
        assert await call(anonymous, drive, method("stop")) == BAD_ACCESS_DENIED
        assert await call(anna, drive, method("coast")) == 0x81110000  # BadNotExecutable
        assert await call(anna, drive, method("speed")) == 0x80760000  # BadArgumentsMissing
        assert await call(anna, drive, method("speed"), ua.Variant("1")) == 0x80AB0000  # BadInvalidArgument
        starting = [asyncio.create_task(call(anna, drive, method("start"))) for _ in range(12)]
        await asyncio.sleep(0)
        async with asyncio.timeout(10):
            assert await call(anna, drive, method("stop")) == GOOD
        assert not any(one.done() for one in starting)
        rig.slow.set()
        assert await asyncio.gather(*starting) == [GOOD] + [BAD_STATE] * 11
        assert await call(anna, drive, method("speed"), ua.Variant(0.5)) == GOOD
        assert rig.given == [DriveOrder(9, "stop"), DriveOrder(9, "start"), DriveOrder(9, "speed", 0.5)]
        assert await call(anna, drive, id_of("type/DriveType/stop")) == GOOD  # by the method of the type
        assert await call(anna, id_of("slave/8"), id_of("type/DriveType/stop")) == 0x80750000  # BadMethodInvalid
        rig.given.clear()
        with delayed(anna, 20.0):
            assert await call(anna, drive, method("start")) == 0x80230000  # BadInvalidTimestamp
            assert await write(anna, "slave/8/output/lamp", True, ua.VariantType.Boolean) == 0x80230000
        assert await call(anna, drive, method("speed"), ua.Variant(float("inf"))) == 0x80AB0000  # BadInvalidArgument
        assert rig.given == []
        executable = [await one.get_node(method("start")).read_attribute(ua.AttributeIds.UserExecutable)
                      for one in (anonymous, anna)]  # fmt: skip
        assert [one.Value.Value for one in executable] == [False, True]


async def test_a_stop_ends_the_orders_behind_it_in_the_request_of_another(rig: Rig) -> None:
    drive = id_of("slave/9/drive")
    start, speed, stop = (id_of(f"slave/9/drive/method/{word}") for word in ("start", "speed", "stop"))
    rig.given.clear()
    rig.slow.clear()
    async with rig.connected(ANNA) as one, rig.connected(ANNA) as other:
        asked = [ua.CallMethodRequest(drive, start, []), ua.CallMethodRequest(drive, speed, [ua.Variant(1.0)])]
        calling = asyncio.create_task(one.uaclient.call(asked))
        await rig.until(lambda: rig.starting)
        assert await call(other, drive, stop) == GOOD
        rig.slow.set()
        assert [result.StatusCode.value for result in await calling] == [GOOD, BAD_STATE]
    assert rig.given == [DriveOrder(9, "stop"), DriveOrder(9, "start")]


async def test_requests_that_name_much_search_nothing(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A request may name a thousand nodes, and the plant may have thousands of orders and conditions."""

    def searched(_: object) -> Any:
        raise AssertionError("a search")

    monkeypatch.setattr(Orders, "allowed", property(searched))
    monkeypatch.setattr(ConditionBook, "__iter__", searched)
    async with rig.connected(BOB) as bob:
        assert await write(bob, "slave/8/output/lamp", True, ua.VariantType.Boolean) == BAD_ACCESS_DENIED
        assert await write(bob, "slave/8/output/horn", True, ua.VariantType.Boolean) == BAD_NOT_WRITABLE
        assert await call(bob, id_of("condition/slave/8/none"), ua.NodeId(9113)) == BAD_NODE


async def test_a_refresh_of_many_conditions_lets_others_have_their_turn(rig: Rig) -> None:
    class Items:
        def __init__(self) -> None:
            self._monitored_events = {SERVER: [5], id_of("bus"): [6]}
            self.seen: list[tuple[str, int]] = []

        async def _trigger_event(self, event: Event, item: int) -> None:
            self.seen.append((event.fields["Message"].Value, item))

    async def pause(begun: float) -> float:
        items.seen.append(("pause", 0))
        return begun

    items: Any = Items()
    begin, one, end = (Event((), {"Message": ua.Variant(text)}, SERVER) for text in ("begin", "one", "end"))
    await refresh(items, 5, begin, lambda: [(one, (SERVER,))] * 60, end, pause)
    assert [text for text, _ in items.seen] == ["begin", *(["one"] * 25 + ["pause"]) * 2, *["one"] * 10, "end"]
    assert {item for _, item in items.seen} == {0, 5}
    async with rig.connected() as client:
        subscription = await client.create_subscription(100, Seen())
        rig.connector._refreshing.add(subscription.subscription_id)
        number = ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
        assert await call(client, ua.NodeId(2782), ua.NodeId(3875), number) == 0x80970000  # BadRefreshInProgress
        rig.connector._refreshing.clear()


async def test_a_slave_that_is_lost_leaves_its_last_value_and_an_alarm_until_it_is_acknowledged(rig: Rig) -> None:
    condition_type, refresh = ua.NodeId(2782), ua.NodeId(3875)
    async with rig.connected(BOB) as bob, rig.connected(ANNA) as anna:
        at_server, at_slave = Seen(), Seen()
        first = await bob.create_subscription(100, at_server)
        await first.subscribe_events(bob.nodes.server, ua.ObjectIds.OffNormalAlarmType)
        second = await bob.create_subscription(100, at_slave)
        await second.subscribe_events(bob.get_node(id_of("slave/8")), ua.ObjectIds.OffNormalAlarmType)
        fine = rig.values["8"]
        rig.show("8", fine | {"state": "fault", "fault": {"text": "no answer"}})
        await rig.until(lambda: at_server.events and at_slave.events)
        one, other = at_server.events[0], at_slave.events[0]
        assert one.EventId == other.EventId
        assert (one.EventType, one.SourceNode, one.SourceName) == (ua.NodeId(10637), id_of("slave/8"), "valves")
        assert one.Message.Text == "no answer"
        assert one.Retain is True
        states = (getattr(other, "ActiveState/Id"), getattr(other, "AckedState/Id"), getattr(other, "EnabledState/Id"))
        assert states == (True, False, True)
        read = await bob.get_node(id_of("slave/8/input/level")).read_data_value(raise_on_bad_status=False)
        assert (read.Value.Value, read.StatusCode.value) == (5.5, UNCERTAIN_NO_COMMUNICATION)
        assert await write(anna, "slave/8/output/lamp", True, ua.VariantType.Boolean) == BAD_NO_COMMUNICATION

        number = ua.Variant(first.subscription_id, ua.VariantType.UInt32)
        assert await call(anna, condition_type, refresh, number) == 0x80280000  # of another session
        at_server.events.clear()
        assert await call(bob, condition_type, refresh, number) == GOOD
        await rig.until(lambda: len(at_server.events) == 3)
        assert [event.EventType.Identifier for event in at_server.events] == [2787, 10637, 2788]
        assert at_server.events[1].EventId == one.EventId

        condition, acknowledge, add_comment = (
            id_of("condition/slave/8/fault"),
            ua.NodeId(9111),
            ua.NodeId(ua.ObjectIds.ConditionType_AddComment),
        )
        assert (
            await call(anna, condition, ua.NodeId(9113), ua.Variant(one.EventId), ua.Variant(ua.LocalizedText("x")))
            == 0x80750000
        )  # Confirm: BadMethodInvalid
        comment = ua.Variant(ua.LocalizedText("seen"))
        assert await call(bob, condition, acknowledge, ua.Variant(one.EventId), comment) == BAD_ACCESS_DENIED
        assert await call(anna, condition, acknowledge, ua.Variant(b"x"), comment) == 0x809A0000  # BadEventIdUnknown
        assert await call(anna, condition, acknowledge, ua.Variant(one.EventId), comment) == GOOD
        await rig.until(lambda: len(at_server.events) == 4)
        acked = at_server.events[3]
        assert (getattr(acked, "AckedState/Id"), acked.ClientUserId, acked.Retain) == (True, "anna", True)
        again = ua.Variant(acked.EventId)
        assert acked.Comment.Text == "seen"
        for event_id in (again, ua.Variant(one.EventId)):
            assert await call(anna, condition, acknowledge, event_id, comment) == 0x80CF0000  # ...BranchAlreadyAcked
        call_it = ua.Variant(ua.LocalizedText("fitter is on his way"))
        assert await call(bob, condition, add_comment, again, call_it) == BAD_ACCESS_DENIED
        assert await call(anna, condition, add_comment, again, call_it) == GOOD
        await rig.until(lambda: len(at_server.events) == 5)
        assert at_server.events[4].Comment.Text == "fitter is on his way"
        rig.show("8", fine)
        await rig.until(lambda: len(at_server.events) == 6)
        assert at_server.events[5].Retain is False
        assert await call(anna, condition, acknowledge, again, comment) == BAD_NODE
        # it comes again: its events are others, and one of before acknowledges nothing
        rig.show("8", fine | {"state": "fault", "fault": {"text": "no answer"}})
        await rig.until(lambda: len(at_server.events) == 7)
        assert at_server.events[6].EventId not in {event.EventId for event in at_server.events[:6]}
        assert await call(anna, condition, acknowledge, again, comment) == 0x809A0000
        rig.connector.acknowledge("slave/8/fault", "mqtt")  # by another connector
        await rig.until(lambda: len(at_server.events) == 8)
        assert (getattr(at_server.events[7], "AckedState/Id"), at_server.events[7].ClientUserId) == (True, "mqtt")
        rig.show("8", fine)
        await rig.until(lambda: len(at_server.events) == 9)


async def test_the_types_declare_what_their_objects_have(rig: Rig) -> None:
    async with rig.connected() as client:

        async def members(node: ua.NodeId, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], str]:
            """Path and modelling rule of each object, variable and method below ``node``, to the next typed object."""
            found: dict[tuple[str, ...], str] = {}
            for one in await client.get_node(node).get_references(ua.ObjectIds.Aggregates, ua.BrowseDirection.Forward):
                own = (*path, str(one.BrowseName.Name))
                rules = await client.get_node(one.NodeId).get_references(ua.ObjectIds.HasModellingRule)
                found[own] = ",".join(rule.BrowseName.Name for rule in rules)
                if one.TypeDefinition == ua.NodeId(ua.ObjectIds.FolderType):
                    found |= await members(one.NodeId, own)
            return found

        for type_, instance in (("BusType", "bus"), ("SlaveType", "slave/8"), ("SlaveType", "slave/9"),
                                ("DriveType", "slave/9/drive")):  # fmt: skip
            declared = await members(id_of(f"type/{type_}"))
            assert set(declared.values()) == {"Mandatory", "Optional"}, type_
            there = set(await members(id_of(instance)))
            if instance == "bus":
                there -= {("valves",), ("hoist",)}
            there = {path for path in there if path[0] not in {"Inputs", "Outputs"} or len(path) == 1}
            assert there <= set(declared), instance
            assert {path for path, rule in declared.items() if rule == "Mandatory"} <= there, instance


async def test_a_drive_shows_its_last_transition(rig: Rig) -> None:
    async with rig.connected() as client:
        last = client.get_node(id_of("slave/9/drive/machine/transition"))
        assert (await last.read_data_value(raise_on_bad_status=False)).StatusCode.value == 0x80320000
        fine = rig.values["9"]
        for state in ("running", "ready"):
            rig.show("9", fine | {"drive": fine["drive"] | {"state": state}})
            await rig.connector.write_changes()
        assert (await last.read_value()).Text == "running to ready"
        transition = client.get_node(await (await last.get_child("0:Id")).read_value())
        [target] = await transition.get_referenced_nodes(ua.ObjectIds.ToState)
        assert target.nodeid == id_of("state/ready")


async def test_what_is_dropped_is_counted_and_told(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    assert rig.told[0] == f"opc.tcp://127.0.0.1:{rig.connector.port}, certificate {rig.connector.settings.cert}"
    rig.told.clear()
    condition = Condition("bus/x", None, "x", "x", Severity.INFO, True, False, 0.0, 0.0)
    before = rig.connector.dropped
    monkeypatch.setattr(rig.connector, "_events", deque(maxlen=4))
    rig.connector.take([condition] * 10)
    await rig.until(lambda: rig.connector.dropped == before + 6)
    assert rig.told == ["6 events were left out; a refresh of the conditions brings them"]
    monkeypatch.setattr(rig.connector.history, "dropped", 3)
    await rig.until(lambda: len(rig.told) > 1)
    assert "give a greater history_values" in rig.told[-1]
    assert rig.connector.dropped == before + 6  # the clients that were there have got them
    monkeypatch.setattr(rig.connector.history, "dropped", 4)
    await rig.connector.write_changes()
    assert len(rig.told) == 2


async def test_a_second_server_needs_another_name_and_port(rig: Rig) -> None:
    lock = rig.folder / "plant.lock"
    for settings, error, why in (
        ({"listen": f"127.0.0.1:{rig.connector.port}", "lock": lock}, PortError, "in use"),
        (
            {"listen": "127.0.0.1:0", "lock": rig.connector.settings.lock},
            ConfigError,
            "is called 'plant'; give this one another",
        ),
    ):
        second = OpcUaConnector(
            rig.tree, rig.connector.tell, dataclasses.replace(rig.connector.settings, **settings), rig.connector._orders
        )
        with pytest.raises(error, match=why):
            await second.open()
        second.close()


async def test_changes_reach_a_subscription_merged_and_the_history_has_them(rig: Rig) -> None:
    async with rig.connected() as client:
        seen = Seen()
        subscription = await client.create_subscription(100, seen)
        level = client.get_node(id_of("slave/8/input/level"))
        await subscription.subscribe_data_change(level)
        await rig.until(lambda: seen.values)
        for value in range(100, 150):
            rig.show("8", rig.values["8"] | {"fields": {"level": float(value), "lamp": False, "flow": 7}})
        await rig.until(lambda: seen.values[-1].Value.Value == 149.0)
        assert len(seen.values) <= 3
        history = await level.read_raw_history()
        assert history[0].Value.Value == 149.0
        assert len(rig.connector.history) < 1000


async def test_a_client_that_reads_nothing_holds_little(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MOST_ITEMS", 300)
    async with rig.connected() as client:
        level = id_of("slave/8/input/level")
        many = (item(level, handle=number, queue=1_000_000) for number in range(400))
        _, results = await subscribed(client, *many)
        assert sum(one.StatusCode.value == 0x80DB0000 for one in results) == 100  # BadTooManyMonitoredItems
        assert all(one.RevisedQueueSize == MOST_QUEUE for one in results if one.StatusCode.is_good())


async def test_sessions_that_ask_together_share_the_items(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MOST_ITEMS", 300)

    async def made_by(client: Client) -> int:
        level = id_of("slave/8/input/level")
        _, results = await subscribed(client, *(item(level, handle=number) for number in range(300)))
        return sum(one.StatusCode.is_good() for one in results)

    async with rig.connected() as one, rig.connected() as other, rig.connected() as third:
        assert 300 <= sum(await asyncio.gather(*map(made_by, (one, other, third)))) <= 300 + 3 * 25


async def test_the_standard_nodes_are_a_whole(rig: Rig) -> None:
    """A part of those of asyncua: no reference leads nowhere, and all that the plant uses has its types."""
    assert rig.connector._server is not None
    nodes = rig.connector._server.aspace._nodes
    lost = {(node, one.NodeId) for node, data in nodes.items() for one in data.references if one.NodeId not in nodes}
    assert not lost
    data_types = {data.attributes[ua.AttributeIds.DataType].value.Value.Value for data in nodes.values()
                  if ua.AttributeIds.DataType in data.attributes}  # fmt: skip
    assert {one for one in data_types if not one.is_null()} <= set(nodes)
    for name in ("OffNormalAlarmType", "RefreshEndEventType", "FiniteStateMachineType", "BaseAnalogType", "Server",
                 "ConditionType_ConditionRefresh2", "Server_ServerStatus_CurrentTime", "EUInformation"):  # fmt: skip
        assert ua.NodeId(getattr(ua.ObjectIds, name)) in nodes, name
    assert 1000 < sum(one.NamespaceIndex == 0 for one in nodes) < 2000


async def test_a_request_for_much_gets_little(rig: Rig) -> None:
    """Without bounds: answers of hundreds of megabytes, searches of half a minute, paths without end."""
    async with rig.connected() as client:
        session = client.uaclient
        assert rig.connector._server is not None
        long, last = ua.DataValue(ua.Variant("x" * 65_536)), id_of("last/Reason")
        await rig.connector._server.aspace.write_attribute_value(last, ua.AttributeIds.Value, long)
        found = await session.read(ua.ReadParameters(NodesToRead=[ua.ReadValueId(last, ua.AttributeIds.Value)] * 1000))
        assert sum(one.Value is not None and one.Value.Value is not None for one in found) == 16
        assert found[-1].StatusCode.value == 0x80B90000  # BadResponseTooLarge
        server, all_ = ua.NodeId(ua.ObjectIds.Server), ua.NodeId(ua.ObjectIds.HierarchicalReferences)

        def asked(node: ua.NodeId, type_: ua.NodeId) -> ua.BrowseDescription:
            return ua.BrowseDescription(node, ua.BrowseDirection.Both, type_, True, 0, 63)

        many = [asked(ua.NodeId(22), all_)] * 999 + [asked(server, ua.NodeId(ua.ObjectIds.BaseObjectType))]
        answers = await session.browse(ua.BrowseParameters(NodesToBrowse=many))
        assert 200 < sum(len(one.References) for one in answers) <= limits.MOST_REFERENCES
        codes = {one.StatusCode.value for one in answers}
        assert codes == {GOOD, 0x804B0000, 0x804C0000}  # BadNoContinuationPoints, BadReferenceTypeIdInvalid
        up, down = ua.QualifiedName("BaseDataType"), ua.QualifiedName("Structure")
        way = [
            ua.RelativePathElement(ua.NodeId(), back, True, name) for back, name in ((False, down), (True, up)) * 100
        ]
        path = ua.BrowsePath(ua.NodeId(ua.ObjectIds.BaseDataType), ua.RelativePath(way))
        [there] = await session.translate_browsepaths_to_nodeids([path])
        assert [one.TargetId for one in there.Targets] == [ua.NodeId(ua.ObjectIds.BaseDataType)]
        with pytest.raises(ua.UaStatusCodeError, match=r"too many operations|BadTooManyOperations"):
            await session.translate_browsepaths_to_nodeids([path] * 6)
        most = client.get_node(ua.NodeId(ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead))
        assert await most.read_value() == limits.MOST_OPERATIONS


async def test_a_session_reaches_nothing_of_others_and_is_one_of_its_connection(rig: Rig) -> None:
    async with rig.connected() as one, rig.connected() as other:
        own, _ = await subscribed(one)
        sessions = rig.connector._server.sessions if rig.connector._server else ()
        tokens = {it.auth_token.Identifier for it in sessions}  # nobody can guess that of another one
        assert [len(token) for token in tokens] == [32, 32]
        stranger = next(it for it in sessions if not it.owns(own))
        with pytest.raises(ua.UaError):  # BadNoSubscription
            stranger.publish([ua.SubscriptionAcknowledgement(own, 1)])
        [moved] = await other.uaclient.transfer_subscriptions(ua.TransferSubscriptionsParameters([own], False))
        assert moved.StatusCode.value == 0x80280000  # BadSubscriptionIdInvalid
        id_: Any = own
        for work in (
            lambda: stranger.modify_subscription(ua.ModifySubscriptionParameters(id_)),
            lambda: stranger.set_publishing_mode(ua.SetPublishingModeParameters(True, [id_])),
            lambda: stranger.create_monitored_items(ua.CreateMonitoredItemsParameters(id_)),
            lambda: stranger.modify_monitored_items(ua.ModifyMonitoredItemsParameters(id_)),
            lambda: stranger.delete_monitored_items(ua.DeleteMonitoredItemsParameters(id_, [1])),
            lambda: stranger.set_monitoring_mode(ua.SetMonitoringModeParameters(id_, MonitoredItemIds=[1])),
            lambda: stranger.republish(ua.RepublishParameters(id_, 1)),
        ):
            with pytest.raises(ServiceError) as refused:
                await asyncio.ensure_future(_awaited(work))
            assert refused.value.code == 0x80280000
        [gone] = await stranger.delete_subscriptions([id_])
        assert gone.value == 0x80280000
        assert rig.connector._server is not None
        assert id_ in rig.connector._server.subscription_service.subscriptions
        count = len(sessions)
        for _ in range(20):
            with pytest.raises(ua.UaStatusCodeError, match=r"session"):
                await other.create_session()
        assert rig.connector._server is not None
        assert len(rig.connector._server.sessions) == count


async def _awaited(work: Callable[[], Any]) -> Any:
    found = work()
    return await found if inspect.isawaitable(found) else found


async def test_a_subscription_is_no_faster_than_its_bound_and_has_the_others(rig: Rig) -> None:
    assert rig.connector._server is not None
    async with rig.connected() as client:
        for asked, given in ((0.001, 100.0), (-1.0, 100.0), (math.nan, 100.0), (250.0, 250.0), (1e9, 3_600_000.0)):
            params = ua.CreateSubscriptionParameters(asked, 600, 10, 0, True)
            made = await client.uaclient.create_subscription(params, lambda _: None)
            assert made.RevisedPublishingInterval == given
            bounded = rig.connector._server.subscription_service.subscriptions[made.SubscriptionId]
            assert isinstance(bounded, Subscription)
            await client.uaclient.delete_subscriptions([made.SubscriptionId])


async def test_the_user_of_a_session_stays(rig: Rig) -> None:
    """Another client with its token would change its rights."""
    assert rig.connector._server is not None
    async with rig.connected(ANNA):
        [session] = rig.connector._server.sessions
        another = ua.ActivateSessionParameters(UserIdentityToken=ua.AnonymousIdentityToken())
        with pytest.raises(ServiceError) as refused:
            session.activate_session(another, None)
        assert refused.value.code == 0x80C60000  # BadIdentityChangeNotSupported
        assert session.user.name == "anna"


async def test_history_of_many_nodes_in_one_request_is_refused(rig: Rig) -> None:
    async with rig.connected() as client:
        level = ua.HistoryReadValueId(id_of("slave/8/input/level"))
        params = ua.HistoryReadParameters(ua.ReadRawModifiedDetails(), NodesToRead=[level] * 11)
        with pytest.raises(ua.UaStatusCodeError, match=r"too many operations|BadTooManyOperations"):
            await client.uaclient.history_read(params)


async def test_filters_that_nobody_can_judge_are_refused(rig: Rig) -> None:
    async with rig.connected() as client:
        level = id_of("slave/8/input/level")
        percent = ua.DataChangeFilter(DeadbandType=ua.DeadbandType.Percent, DeadbandValue=5.0)
        many = ua.EventFilter(SelectClauses=[ua.SimpleAttributeOperand()] * 101)
        events, values = ua.AttributeIds.EventNotifier, ua.AttributeIds.Value
        server = ua.NodeId(ua.ObjectIds.Server)
        wanted = [
            (level, values, percent), (level, values, many), (server, events, None), (server, events, percent),
            (server, events, many), (level, values, None),
        ]  # fmt: skip
        made, results = await subscribed(client, *(item(*one) for one in wanted))
        codes = [0x80440000, 0x80440000, 0x80470000, 0x80450000, 0x80470000, GOOD]
        assert [one.StatusCode.value for one in results] == codes
        last = results[-1].MonitoredItemId
        change = [ua.MonitoredItemModifyRequest(one, ua.MonitoringParameters(1, 0.0, None, 1_000_000))
                  for one in (last, last + 1)]  # fmt: skip
        modify = ua.ModifyMonitoredItemsParameters(made, ua.TimestampsToReturn.Both, change)
        fine, bad = await client.uaclient.modify_monitored_items(modify)
        assert (fine.RevisedQueueSize, bad.StatusCode.value) == (MOST_QUEUE, 0x80420000)
        await rig.until(lambda: rig.connector._server is not None)
        gone = await client.uaclient.delete_monitored_items(ua.DeleteMonitoredItemsParameters(made, [last, last]))
        assert [one.value for one in gone] == [GOOD, 0x80420000]


async def test_a_name_that_is_null_in_a_filter_keeps_no_event_from_others(rig: Rig) -> None:
    fine, seen = rig.values["8"], Seen()
    async with rig.connected() as client:
        await (await client.create_subscription(100, seen)).subscribe_events(client.nodes.server)
        got: list[Any] = []
        fields = [ua.SimpleAttributeOperand(BrowsePath=[ua.QualifiedName(name)]) for name in (None, "SourceName")]
        null = ua.EventFilter(SelectClauses=fields)
        event_item = item(client.nodes.server.nodeid, ua.AttributeIds.EventNotifier, null)
        await subscribed(client, event_item, took=got.append)
        rig.show("8", fine | {"state": "fault", "fault": {"text": "gone"}})
        await rig.until(lambda: any(one.NotificationMessage.NotificationData for one in got) and seen.events)
        [event] = (data for one in got for data in one.NotificationMessage.NotificationData)
        assert [field.Value for field in event.Events[0].EventFields] == [None, "valves"]
        assert seen.events[0].Message.Text == "gone"
    rig.show("8", fine)


async def test_a_deadband_counts_from_the_last_value_and_never_hides_a_status(rig: Rig) -> None:
    fine, seen = rig.values["8"], Seen()

    async def show(value: float) -> None:
        """The value reaches the node: a client without deadband has it."""
        rig.show("8", fine | {"fields": {"level": value, "lamp": False, "flow": 7}})
        await rig.until(lambda: every.values and every.values[-1].Value.Value == value)

    async with rig.connected() as client:
        level, every = client.get_node(id_of("slave/8/input/level")), Seen()
        await (await client.create_subscription(100, every)).subscribe_data_change(level)
        await show(1000.0)
        await (await client.create_subscription(100, seen)).deadband_monitor(level, 10.0)
        await rig.until(lambda: seen.values)
        for value in (1006.0, 1009.0, 1012.0, 1015.0):
            await show(value)
        await rig.until(lambda: len(seen.values) == 2)
        rig.show("8", rig.values["8"] | {"state": "fault", "fault": {"text": "gone"}})
        await rig.until(lambda: seen.values[-1].StatusCode.value == UNCERTAIN_NO_COMMUNICATION)
        assert [one.Value.Value for one in seen.values] == [1000.0, 1012.0, 1015.0]
    rig.show("8", fine)


async def test_a_part_of_a_value_is_refused(rig: Rig) -> None:
    """Instead of the whole value as that part, as asyncua gives it."""
    level = id_of("slave/8/input/level")
    names = ua.NodeId(ua.ObjectIds.Server_NamespaceArray)
    asked = [ua.ReadValueId(node, ua.AttributeIds.Value, part) for node, part in (
        (names, None), (names, "0"), (level, "0"), (level, "1:2"), (ua.NodeId("none", 1), "0"),
    )]  # fmt: skip
    async with rig.connected() as client:
        read = await client.uaclient.read(ua.ReadParameters(NodesToRead=asked))
        assert [one.StatusCode.value for one in read] == [GOOD, *[BAD_PART] * 3, BAD_NODE]
        assert [one.Value.Value for one in read[1:4]] == [None] * 3
        made = await client.create_subscription(100, Seen())
        wanted = [item(level, ua.AttributeIds.Value, None), item(level, ua.AttributeIds.Value, None)]
        wanted[1].ItemToMonitor.IndexRange = "1"
        params = ua.CreateMonitoredItemsParameters(made.subscription_id, ua.TimestampsToReturn.Both, wanted)
        assert [one.StatusCode.value for one in await client.uaclient.create_monitored_items(params)] == [
            GOOD,
            BAD_PART,
        ]


async def test_nodes_follow_the_configuration(rig: Rig) -> None:
    rig.slaves = rig.slaves | {"10": {"name": "valves", "inputs": [{"name": "x", "type": "u8", "at": "u8@0"}]}}
    rig.values = rig.values | {"10": {"state": "data_exchange", "inputs_valid": True, "inputs_age_ms": 1.0,
                                      "fields": {"x": 3}}}  # fmt: skip
    async with rig.connected() as client:
        seen = Seen()
        rig.plant()
        rig.snapshot()
        await rig.until(lambda: "slave/10/input/x" in rig.ids())
        node = client.get_node(id_of("slave/10"))
        assert (await node.read_browse_name()).Name == "valves slave 10"
        x = client.get_node(id_of("slave/10/input/x"))
        await (await client.create_subscription(100, seen)).subscribe_data_change(x)
        del rig.slaves["10"], rig.values["10"]
        rig.plant()
        rig.snapshot()
        await rig.until(lambda: seen.values and seen.values[-1].StatusCode.value == BAD_NODE)
        with pytest.raises(ua.UaStatusCodeError):
            await node.read_browse_name()
        special = [await one.read_browse_name() for one in
                   await client.get_node(id_of("slave/8/folder/Outputs")).get_children()]  # fmt: skip
        assert "a_b_c_d______u202e" in {one.Name for one in special} or len(special) == 4
        assert not any(set(one.Name) & set("/.<>:#!&\u202e") for one in special)


async def test_nodes_are_made_and_removed_in_slices_of_a_few(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bus, or its safe end, has its turn between them; and the time of a node does not depend on those beside it:
    asyncua would compare each with all of its folder."""
    turn, made, compared = 0, Counter[int](), 0
    make, unique = Space._make, NodeManagementService._add_unique_reference

    async def count_turns() -> None:
        nonlocal turn
        while True:
            await asyncio.sleep(0)
            turn += 1

    def counted(space: Space, *args: Any) -> ua.NodeId:
        made[turn] += 1
        return make(space, *args)

    def compare(service: Any, data: Any, reference: Any) -> Any:
        nonlocal compared
        compared += len(data.references)
        return unique(service, data, reference)

    monkeypatch.setattr(Space, "_make", counted)
    monkeypatch.setattr(NodeManagementService, "_add_unique_reference", compare)
    fields = [
        {"name": f"level{n}", "type": "i16", "at": f"i16@{2 * n}", "unit": "mm", "scale": 0.1} for n in range(100)
    ]
    turns = asyncio.create_task(count_turns())
    try:
        rig.slaves = rig.slaves | {"11": {"name": "tanks", "inputs": fields}}
        rig.plant()
        await rig.until(lambda: rig.connector.is_built)
        # a value with unit, range and reason has four nodes
        assert made.total() >= 400
        assert max(made.values()) <= 23
        assert compared <= 3 * made.total()
        gone, made_before = Counter[int](), len(rig.ids())
        values = rig.connector._space.values  # type: ignore[union-attr]
        monkeypatch.setattr(rig.connector._space, "values", Removing(values, lambda: gone.update([turn])))
        del rig.slaves["11"]
        rig.plant()
        await rig.until(lambda: rig.connector.is_built)
        assert made_before - len(rig.ids()) >= 100
        assert max(gone.values()) <= 21
    finally:
        turns.cancel()


class Removing(dict[Any, Any]):
    """A dictionary that tells each time that somebody takes a key out."""

    def __init__(self, values: dict[Any, Any], tell: Callable[[], object]) -> None:
        super().__init__(values)
        self._tell = tell

    def pop(self, *args: Any) -> Any:
        self._tell()
        return super().pop(*args)


async def test_wrong_passwords_certificates_and_channels_are_refused(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    assert rig.connector._server is not None
    monkeypatch.setattr(
        rig.connector._server.losses, "_told_at", -math.inf
    )  # others may have made it tell within a minute
    with pytest.raises(ua.UaStatusCodeError, match=r"BadUserAccessDenied|denied"):
        async with rig.connected(("anna", "wrong password")):
            pass
    await rig.until(lambda: any("as it gave a wrong user or password (last: 127.0.0.1)" in one for one in rig.told))
    with pytest.raises(Exception):  # noqa: B017  the client of asyncua tells a closed connection in several ways
        async with asyncio.timeout(10), rig.connected(ANNA, days=-1):
            pass
    other = rig.client(ANNA)
    await other.set_security_string(rig.security)
    other.application_uri = "urn:another"
    with pytest.raises(ua.UaStatusCodeError, match="URI"):
        await other.connect()
    unsecured = rig.client(ANNA)
    offered = await unsecured.connect_and_get_server_endpoints()
    assert {(one.SecurityPolicyUri.rpartition("#")[2], one.SecurityMode) for one in offered} == {
        ("Basic256Sha256", ua.MessageSecurityMode.SignAndEncrypt)
    }
    with pytest.raises((ua.UaError, ConnectionError, TimeoutError, ValueError)):
        async with asyncio.timeout(10), unsecured:
            pass
    key = rig.folder / "own" / "k.pem"
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    async with rig.connected(ANNA):
        pass


@pytest.mark.parametrize(
    "octets",
    [b"GET / HTTP/1.1\r\n\r\n", b"\xff" * 5000, b"HELF\xff\xff\xff\x7f" + bytes(100), b"MSGF\x20\0\0\0" + bytes(24)],
)
async def test_garbage_ends_its_connection_alone(rig: Rig, octets: bytes) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", rig.connector.port)
    writer.write(octets)
    async with asyncio.timeout(10):
        try:
            while await reader.read(1000):
                pass
        except ConnectionError:
            pass
    writer.close()
    async with rig.connected() as client:
        assert (await client.get_node(id_of("slave/8")).read_browse_name()).Name == "valves"
