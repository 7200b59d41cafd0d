"""FDL services without await, in real time; functions of a program in their thread."""

from __future__ import annotations

import asyncio
import threading

import pytest
from far_ends import eventually, until

import dpstack
from dpstack import blocking
from dpstack.api.fdl.sap import Sap, SapQueue
from dpstack.errors import UsageError
from dpstack.fdl import Confirmation, FdlError, FdlIndicated, FdlService


def test_two_stations_without_await() -> None:
    seen: list[bytes] = []
    world = dpstack.World()
    first = blocking.open_fdl(world=world, baud=187_500, address=1, hsa=5)
    second = blocking.open_fdl(world=world, baud=187_500, address=2, hsa=5)
    with first, second:
        with second.sap(20) as sap:
            sap.update(b"\x01")
            assert first.srd(2, b"\x02", dsap=20, timeout=60).status is Confirmation.DL
            assert sap.receive(timeout=60).data == b"\x02"
            first.sda(2, b"\x03", dsap=20, timeout=60)
            assert next(sap.indications(timeout=60)).data == b"\x03"
        with second.sap(21, on_receive=lambda indication: seen.append(indication.data)):
            first.sda(2, b"\x04", dsap=21, timeout=60)
            eventually(lambda: seen == [b"\x04"], "the handler")
        with pytest.raises(FdlError) as error:
            first.sda(2, b"\x05", dsap=20, timeout=60)
        assert error.value.status == "RS"
    assert not first.is_open


class Link:
    """The inside of FDL services on a real port."""

    is_virtual = False

    def __init__(self) -> None:
        self.orders: list[object] = []
        self.reports: list[str] = []

    def command(self, order: object) -> None:
        self.orders.append(order)

    async def order(self, order: object) -> None:
        self.orders.append(order)

    async def close_sap(self, queue: SapQueue) -> None:
        self.orders.append(queue.number)

    def report(self, text: str, error: Exception) -> None:
        self.reports.append(text)


async def test_a_plain_function_runs_in_a_thread_and_may_hang() -> None:
    """The loop goes on, what comes meanwhile waits, and an exception is reported."""
    goes_on = threading.Event()
    threads: list[bool] = []

    def on_receive(indication: FdlIndicated) -> None:
        threads.append(threading.current_thread() is threading.main_thread())
        if indication.data == b"hang":
            goes_on.wait(60)
        if indication.data == b"raise":
            raise ValueError("no")

    link, inside = Link(), SapQueue(20)
    sap = Sap(link, inside, on_receive)
    for octets in (b"hang", b"raise", b"last"):
        inside.take(
            FdlIndicated(t_ns=0, sap=20, service=FdlService.SDA, source=1, source_sap=1, data=octets, high=False)
        )
    await until(lambda: bool(threads), "the first call")
    await asyncio.sleep(0.01)
    assert (sap.waiting, link.orders) == (3, [])
    goes_on.set()
    await until(lambda: len(link.orders) == 3, "the last call")
    assert threads == [False] * 3
    assert link.reports == ["on_receive of SAP 20 raised ValueError: no"]
    with pytest.raises(UsageError, match="leave that out to receive"):
        await sap.receive()
    await sap.close()
    assert link.orders[-1] == 20
