"""The way of an order from a connector to the image of its slave: no text is made of it, and none is parsed."""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, Final, cast

import pytest
from api_kit import in_virtual_time
from asyncua import ua
from opcua_rig import id_of
from probe_connector import ProbeConnector

import dpstack
from dpstack.bridge.opcua.connector import OpcUaConnector, OpcUaSettings
from dpstack.bridge.opcua.sessions import LimitedSession
from dpstack.bridge.opcua.users import Account
from dpstack.plant.tree import NodesChanged

VALVES: Final[dict[str, Any]] = {
    "name": "valves",
    "address": 9,
    "ident": 0x1234,
    "config": "22 11",
    "outputs": {"lamp": "bool@0.1", "flow": "u16@1"},
}
PUMP: Final[dict[str, Any]] = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "PPO1"}
#: its digits, decimal and hex, are in no name, address or time
FLOW: Final = 54321
SPEED: Final = 0.40404
#: calls of functions of dpstack from the connector to the image of an output; with texts there were 159
MOST_CALLS: Final = 116


pytestmark = pytest.mark.usefixtures("probe", "no_collection")


class Walk:
    """The functions of dpstack that ``work`` calls in its task up to the first call of ``end``, and the texts in the
    variables and results of all functions that hold one of ``signs``."""

    def __init__(self, end: str, *signs: str) -> None:
        self.calls: list[str] = []
        self.texts: list[str] = []
        self._end = end
        self._signs = signs
        self._task: asyncio.Task[Any] | None = None

    async def follow(self, work: Callable[[], Awaitable[Any]]) -> Any:
        self._task = asyncio.current_task()
        sys.setprofile(self._hook)
        try:
            return await work()
        finally:
            sys.setprofile(None)
            assert self._task is None, f"nothing came to {self._end}: {self.calls}"

    def _hook(self, frame: FrameType, event: str, result: object) -> None:
        if self._task is None or asyncio.current_task() is not self._task or event not in ("call", "return"):
            return
        if event == "call" and str(frame.f_globals["__name__"]).startswith("dpstack"):
            self.calls.append(frame.f_code.co_qualname)
        for text in texts_in((*frame.f_locals.values(), result)):
            if any(sign in text for sign in self._signs):
                self.texts.append(f"{frame.f_code.co_qualname}: {text}")
        if event == "call" and frame.f_code.co_qualname == self._end:
            self._task = None


def texts_in(found: object) -> Iterator[str]:
    """The texts in a value, and in the lists, tuples and dictionaries that it holds."""
    if isinstance(found, str):
        yield found
    elif isinstance(found, (list, tuple)):
        for one in found:
            yield from texts_in(one)
    elif type(found) is dict:
        yield from texts_in((*found.keys(), *found.values()))


async def served(folder: Path) -> OpcUaConnector:
    """The OPC UA connector of the plant, with its nodes, and no client."""
    [probe] = ProbeConnector.made
    settings = OpcUaSettings("127.0.0.1:0", "plant", folder / "c.der", folder / "k.pem", anonymous=True)
    connector = OpcUaConnector(probe.tree, lambda *_: None, settings, probe.orders)
    await connector.open()
    connector.take([NodesChanged()])
    await connector.write_changes()
    return connector


@in_virtual_time
async def test_no_text_is_made_of_an_order_between_connector_and_image(tmp_path: Path) -> None:
    async with (
        dpstack.open_bus(port="virtual", baud=500_000, slaves=[VALVES, PUMP]) as bus,
        dpstack.publish(bus, probe={"allow_commands": ["valves.*", "pump.*"]}),
    ):
        await bus.operate()
        await bus.ready()
        await asyncio.sleep(1)
        connector, anna = await served(tmp_path), Account("anna", True, "")
        session = cast("LimitedSession", None)  # an order needs none

        def written(value: int) -> Awaitable[list[ua.StatusCode]]:
            given = ua.DataValue(ua.Variant(value, ua.VariantType.UInt16))
            return connector.write(
                [ua.WriteValue(id_of("slave/9/output/flow"), ua.AttributeIds.Value, None, given)], anna
            )

        def called(value: float) -> Awaitable[list[ua.CallMethodResult]]:
            drive, method = id_of("slave/6/drive"), id_of("slave/6/drive/method/speed")
            return connector.call([ua.CallMethodRequest(drive, method, [ua.Variant(value)])], anna, session)

        await written(1)  # so that modules which are loaded at their first use are there
        output = Walk("Stack.set_outputs", str(FLOW), f"{FLOW:x}")
        [status] = await output.follow(lambda: written(FLOW))
        assert status.value == 0
        assert bus.slave("valves").outputs == b"\0" + FLOW.to_bytes(2, "big")
        drive = Walk("VirtualRuntime.command", str(SPEED))
        [result] = await drive.follow(lambda: called(SPEED))
        assert result.StatusCode.value == 0
        assert bus.drive("pump").status.setpoint == pytest.approx(SPEED, abs=1e-3)
        # MQTT gives its orders by name
        [probe] = ProbeConnector.made
        named = Walk("Stack.set_outputs", str(FLOW + 1), f"{FLOW + 1:x}")
        done = await named.follow(lambda: probe.orders.give("valves.flow", FLOW + 1, made_at=time.time()))
        assert done.reason == ""
        connector.close()
    assert [*output.texts, *drive.texts, *named.texts] == []
    assert len(output.calls) <= MOST_CALLS, output.calls
    # the slave is looked up once, and its field where it is set, without a call
    assert [output.calls.count(name) for name in ("Bus.slave", "Slave.output_field")] == [1, 0]
    print(f"calls: {len(output.calls)} output, {len(drive.calls)} drive, {len(named.calls)} output by its name")
