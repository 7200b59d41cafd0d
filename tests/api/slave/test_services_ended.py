"""Services of a bus that ends while they are ordered: one error for the caller, none that asyncio reports as lost."""

from __future__ import annotations

import asyncio
import gc
from typing import Any

import pytest

from dpstack.api.slave.services import Services
from dpstack.dp.acyclic.class2 import ReadService, Service, ServiceDone
from dpstack.errors import BusError


async def test_the_end_of_the_bus_while_an_order_is_taken_is_one_error() -> None:
    reported: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: reported.append(context))

    async def order(_order: object) -> None:
        """A bus process that ends before it answers: the pending services end, then the order fails."""
        services.end(BusError("the bus process has ended"))
        raise BusError("the order was not answered")

    async def load_layouts() -> None:
        """They are there."""

    services = Services(lambda _command: None, order, lambda: True, load_layouts)
    with pytest.raises(BusError, match="not answered"):
        await services.answer_to(ReadService(services.token(), 4, Service.DIAGNOSIS, None, 1_000_000), ServiceDone)
    gc.collect()
    assert reported == []
