"""Records of a slave of another program: the ``run`` that holds the port is asked over its control socket."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from typing import Any

from dpstack.api.acyclic_words import carry_out
from dpstack.api.bus import Bus
from dpstack.api.control.alive import kept_alive
from dpstack.api.control.client import reach
from dpstack.api.parts import SEARCHING
from dpstack.errors import BusError


def acyclic_order(bus: Bus, args: list[str]) -> AsyncIterator[object]:
    """``SLAVE ORDER [ARG]...`` at a slave of a run. A client that hangs up ends the order."""
    if bus.searching:
        raise BusError(f"{SEARCHING}: the slaves are known once it is found")
    name, word, *rest = args
    slave = bus.slave(int(name) if name.isdecimal() else name)
    return kept_alive(carry_out(slave, word, rest), lambda: {"state": slave.state.value})


async def through_run(port: str, slave: int, word: str, args: Sequence[str]) -> dict[str, Any] | None:
    """As :func:`~dpstack.api.acyclic_words.carry_out`, by the run on ``port``; None where no run answers for it.

    Raises what it raises there, UsageError where the run has no such slave, PortError.
    """
    client = reach(port, kind="run")  # at once: there is a socket or there is none
    if client is None:
        return None
    with client:
        return dict(await asyncio.to_thread(client.call, "acyclic", str(slave), word, *args))
