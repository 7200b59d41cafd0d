"""The connector ends although a library swallows the cancellation of its task; the program ends although a call
blocks."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from pathlib import Path

import aiomqtt
import pytest

from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.client import MqttConnector
from dpstack.bridge.mqtt.connection import cancellations, end_if_cancelled
from dpstack.bridge.mqtt.plant_node import NodeSetup
from dpstack.bridge.mqtt.session_file import SessionFile
from dpstack.plant.tree import PlantTree


async def test_a_swallowed_cancellation_ends_the_task_after_all() -> None:
    async def work() -> None:
        before = cancellations()
        with contextlib.suppress(asyncio.CancelledError):  # as asyncio.wait_for of Python 3.11 now and then
            await asyncio.Event().wait()
        end_if_cancelled(before)
        raise AssertionError("it goes on")

    task = asyncio.create_task(work())
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


async def test_the_farewell_of_a_cancelled_task_goes_on() -> None:
    """It begins when the task is being cancelled already."""

    async def work() -> str:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.Event().wait()
        before = cancellations()
        await asyncio.sleep(0)
        end_if_cancelled(before)
        return "said"

    task = asyncio.create_task(work())
    await asyncio.sleep(0)
    task.cancel()
    assert await task == "said"


@pytest.mark.parametrize("blocked", [(aiomqtt.Client, "_client_connect"), (SessionFile, "next")])
def test_a_network_or_disk_that_blocks_does_not_delay_the_end_of_the_program(
    blocked: tuple[type, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, goes_on, went_on = threading.Event(), threading.Event(), threading.Event()

    def block(_: object) -> int:
        began.set()
        goes_on.wait(2)
        went_on.set()
        return 0

    monkeypatch.setattr(*blocked, block)

    async def program() -> None:
        setup = NodeSetup("g", "n")
        connector = MqttConnector(
            PlantTree(), lambda *_: None, broker=Broker(url="mqtt://a"), setup=setup, folder=tmp_path / "s"
        )
        await connector.open()
        serving = asyncio.create_task(connector.serve())
        async with asyncio.timeout(5):
            while not began.is_set():  # noqa: ASYNC110  told by a thread
                await asyncio.sleep(0.001)
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)
        connector.close()

    asyncio.run(program())
    assert not went_on.is_set()
    goes_on.set()
    assert went_on.wait(5)
