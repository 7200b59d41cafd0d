"""A simulated rack of modules at its master, whose diagnosis a test sets."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from typing import Any

from api_kit import serving

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.slave_side.slave_server import ServedSlave
from dpstack.dp.slot_map import slot_map
from dpstack.slave import DpSlave, SlaveDescription, channel_block

#: 8 DI, empty, 2 AI, 8 DO, 1 word in and out
CONFIG = bytes.fromhex("10 00 51 20 70")
NAMES = {
    "inputs": {"door": "slot 1 channel 3 bool", "level": "slot 3 channel 0 i16", "flow": "slot 3 channel 1 i16"},
    "outputs": {"valve": "slot 4 channel 0 bool", "setpoint": "slot 5 channel 0 i16"},
}
RACK = SlaveDescription(ident=0x1234, name="rack", configs=(CONFIG,))
Rack = tuple[dpstack.Bus, dpstack.Slave, ServedSlave]
LINE_BREAK = channel_block(2, 0, 6, size=5, input=True)


@contextlib.asynccontextmanager
async def rack(description: SlaveDescription = RACK, **keys: Any) -> AsyncIterator[Rack]:
    """The rack at its master, with valid inputs. ``keys``: of its table; ``events``: the list that gets the events of
    both."""
    inputs = sum(slot.inputs.octets for slot in slot_map(description.configs[0]).slots)
    rack = DpSlave(description, lambda outputs, elapsed: outputs[:inputs].ljust(inputs, b"\0"))
    events = keys.pop("events", None)
    async with serving(rack, None, events, **{**NAMES, **keys}) as (bus, served):
        (slave,) = bus.slaves
        await core_of(bus).until_round(lambda: slave.inputs_valid, timeout=1)
        yield bus, slave, served


def device(served: ServedSlave) -> DpSlave:
    assert isinstance(served.device, DpSlave)
    return served.device
