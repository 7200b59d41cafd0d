"""The reader of a fleet at a broker that the test holds: it publishes nothing, and takes whatever comes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

import aiomqtt
import pytest
from fake_broker import CONNECT, DISCONNECT, PINGREQ, PUBLISH, SUBSCRIBE, FakeBroker, publish, user_property
from fleet_kit import DEATH, LOST, ONLINE, TOPIC, status

from dpstack.boottime import boottime_s
from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.fleet import Fleet, Segment, State
from dpstack.bridge.mqtt.fleet_reader import FleetReader
from dpstack.bridge.mqtt.payload import node_death
from dpstack.errors import UsageError


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

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        task = asyncio.create_task(self.reader.run())
        try:
            yield
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await asyncio.wait_for(task, 5)

    async def until(self, found: Callable[[], object]) -> None:
        async with asyncio.timeout(10):
            while not found():  # noqa: ASYNC110  tells nobody of its changes
                await asyncio.sleep(0.005)


async def test_it_publishes_nothing_and_comes_back() -> None:
    broker = FakeBroker(
        retained=[publish(TOPIC, status(), expiry=20, retain=True), publish("dpstack/g/n/status", b"{")]
    )
    async with broker:
        seen = Seen(broker)
        async with seen.running():
            await seen.until(lambda: seen.fleet.broken)
            assert seen.changes == [("line 7", State.OK)]
            broker.send(publish(DEATH, node_death(5, 1)) + publish("spBv1.0/x/NBIRTH/y", b"\xff" * 1000))
            await seen.until(lambda: seen.changes[-1][1] is State.DEAD)
            broker.cut()
            await seen.until(lambda: any("it is tried again" in text for text in seen.told))
            broker.retained[0] = publish(TOPIC, status(**LOST, session=6), expiry=20, retain=True)
            await seen.until(lambda: seen.changes[-1][1] is State.LOST)
            assert seen.reader.connected
        assert broker.kinds() <= {CONNECT, SUBSCRIBE, PINGREQ, DISCONNECT}
        flags = {body[7] for kind, body in broker.received if kind == CONNECT}
        assert flags == {2}  # Clean Start, and no will


async def test_after_a_sleep_of_the_computer_an_old_status_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    async with FakeBroker(retained=[publish(TOPIC, status(), expiry=20, retain=True)]) as broker:
        seen = Seen(broker)
        async with seen.running():
            await seen.until(lambda: seen.changes)
            monkeypatch.setattr("dpstack.bridge.mqtt.fleet_reader.boottime_s", lambda: boottime_s() + 3600)
            await seen.until(lambda: len(seen.changes) > 1)
    assert seen.changes == [("line 7", State.OK), ("line 7", State.SILENT)]


async def test_a_kept_status_without_expiry_is_judged_by_its_own_time() -> None:
    kept = {"young": time.time() - 5, "old": time.time() - 3600, "ahead": time.time() + 3600}
    packets = [publish(f"dpstack/g/{node}/status", status(sent=sent), retain=True) for node, sent in kept.items()]
    async with FakeBroker(retained=packets) as broker:
        seen = Seen(broker)
        async with seen.running():
            await seen.until(lambda: len(seen.changes) == 3)
            broker.send(publish("dpstack/g/old/status", status()))
            await seen.until(lambda: len(seen.changes) == 4)
    assert seen.changes == [
        ("young", State.OK), ("old", State.UNKNOWN), ("ahead", State.UNKNOWN), ("old", State.OK)
    ]  # fmt: skip


async def test_a_will_in_json_is_known_by_its_user_property() -> None:
    async with FakeBroker(retained=[publish(TOPIC, status(), expiry=20, retain=True)]) as broker:
        seen = Seen(broker)
        async with seen.running():
            await seen.until(lambda: seen.changes)
            for name, value in (("session", "4"), ("session", "5" * 90), ("session", "\u0665"), ("other", "5")):
                broker.send(publish(ONLINE, b"false", user=user_property(name, value)))
            broker.send(publish(ONLINE, b"false"))
            broker.send(publish(ONLINE, b"false", user=user_property("other", "x") + user_property("session", "5")))
            await seen.until(lambda: len(seen.changes) > 1)
    assert seen.changes == [("line 7", State.OK), ("line 7", State.DEAD)]


@pytest.mark.parametrize("rebirth", ["all", ("hall 3", "line 7")])
async def test_it_asks_for_births_once(rebirth: str | tuple[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dpstack.bridge.mqtt.fleet_reader._LEARNING_S", 0.05)
    async with FakeBroker(retained=[publish(TOPIC, status())]) as broker:
        seen = Seen(broker, rebirth)
        async with seen.running():
            await seen.until(lambda: "asked for births: 1 gateway" in seen.told)
            await seen.until(lambda: PUBLISH in [kind for kind, _ in broker.received])
            broker.cut()
            await seen.until(lambda: len([kind for kind, _ in broker.received if kind == 1]) == 2)
            await seen.until(lambda: seen.reader.connected)
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
        async with seen.running():
            await seen.until(lambda: "only 0 of 1 gateways were asked for births: the connection is lost" in seen.told)


async def test_a_wrong_password_is_an_error_at_once() -> None:
    async with FakeBroker(refuses=0x86) as broker:
        seen = Seen(broker)
        with pytest.raises(UsageError, match="refuses user or password"):
            await asyncio.wait_for(seen.reader.run(), 10)


async def test_many_retained_statuses_at_once() -> None:
    retained = [publish(f"dpstack/g/{number}/status", status(), expiry=30, retain=True) for number in range(1500)]
    async with FakeBroker(retained=retained) as broker:
        seen = Seen(broker)
        async with seen.running():
            await seen.until(lambda: len(seen.fleet) + seen.reader.lost == 1500)
            assert seen.reader.lost == 0
