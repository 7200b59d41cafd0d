"""The recording of a live stream from a simulated bus, and its replay at real speed, for as long as wanted."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import dpstack
from dpstack.plant.state import LiveState

BAUD: Final = 500_000
#: the Sparkplug group of all gateways
GROUP: Final = "bench"
#: address of the first slave
FIRST: Final = 3
#: s between two snapshots, that of the connectors of a run; s between two changes of all outputs
INTERVAL_S: Final = 0.2
#: s that a slave of the recording has no power
OFF_S: Final = 2.0
#: s of the simulated bus before the recording, so that all slaves are in data exchange
_SETTLE_S: Final = 1.0
#: number of changes until the valve of a slave opens or closes
_VALVE: Final = 40

#: takes the address of a slave that the stream has just declared lost
OnLoss = Callable[[int], object]


def slave_tables(count: int) -> list[dict[str, Any]]:
    """``count`` slaves with eight octets each way, of which four named values each; the inputs are the outputs."""
    inputs = {
        "level": {"at": "i16@0", "scale": 0.1, "unit": "bar"},
        "flow": {"at": "i16@2", "scale": 0.01, "unit": "m3/h"},
        "count": "u16@4",
        "open": "bool@6.0",
    }
    outputs = {"setpoint": {"at": "i16@0", "scale": 0.1, "unit": "bar"}, "valve": "bool@6.0"}
    return [
        {
            "name": device_name(FIRST + number),
            "address": FIRST + number,
            "ident": 0x1234,
            "config": "17 27",
            "inputs": inputs,
            "outputs": outputs,
        }
        for number in range(count)
    ]


def node_name(number: int) -> str:
    """The edge node of the gateway ``number``."""
    return f"gateway-{number:02}"


def device_name(address: int) -> str:
    """The slave with this address, and its device."""
    return f"s{address}"


def octets(number: int, slave: int) -> bytes:
    """The outputs of a slave at the change ``number``: three analog values that always move, a valve that seldom
    does."""
    moving = number + 37 * slave
    return struct.pack(
        ">hhHBB", 3 * (moving % 800) - 1200, 7 * (moving % 900), moving & 0xFFFF, moving // _VALVE & 1, 0
    )


def change_outputs(slaves: Sequence[Any], number: int) -> None:
    """Give all slaves their outputs of the change ``number``."""
    for place, slave in enumerate(slaves):
        slave.outputs = octets(number, place)


@dataclass(frozen=True, slots=True)
class Recording:
    """Items of a stream over ``seconds``; the first ones are plant and whole snapshot at ``t``."""

    items: Sequence[Mapping[str, Any]]
    t: float
    seconds: float

    def losses(self) -> Iterator[tuple[float, int]]:
        """When (``t``) a snapshot says for the first time that a slave is lost, and its address."""
        for at, item in enumerate(self.items):
            for address in lost_of(item) if at > 1 else ():
                yield item["snapshot"]["t"], address


def lost_of(item: Mapping[str, Any]) -> list[int]:
    """The slaves that a snapshot declares lost: their state is new, and ``offline``."""
    slaves = item.get("snapshot", {}).get("slaves", {})
    return [int(address) for address, values in slaves.items() if values.get("state") == "offline"]


def record(slaves: int, seconds: float, losses: int) -> Recording:
    """The live stream of a simulated bus over ``seconds``. All inputs change all the time; ``losses`` times a slave
    loses its power for a moment, the next one each time."""
    return dpstack.run_virtual(_record(slaves, seconds, losses))


async def _record(slaves: int, seconds: float, losses: int) -> Recording:
    tables = slave_tables(slaves)
    world = dpstack.World()
    plant = dpstack.simulate(world, tables, baud=BAUD)
    state, items = LiveState(), list[dict[str, Any]]()
    begin = number = 0
    # each loss in the middle of its part of the recording
    losses_at = [((loss + 0.5) * seconds / losses, tables[loss % slaves]["name"]) for loss in range(losses)]
    power = sorted((at + late, name, on) for at, name in losses_at for late, on in ((0.0, False), (OFF_S, True)))
    async with dpstack.open_bus(world=world, baud=BAUD, slaves=tables) as bus:
        await bus.operate()
        await bus.ready(60)
        async for item in bus.live(INTERVAL_S):
            state.apply(item)
            if "snapshot" not in item:
                if items:
                    items.append(item)
                continue
            number += 1
            change_outputs(bus.slaves, number)
            t = item["snapshot"]["t"]
            if not items:
                if t >= _SETTLE_S:
                    begin = t
                    items = state.whole()[:2]
                continue
            items.append(item)
            if t - begin >= seconds:
                break
            while power and power[0][0] <= t - begin:
                _, name, on = power.pop(0)
                plant.power(name, on)
    # one interval behind the last snapshot it begins again
    return Recording(items, begin, items[-1]["snapshot"]["t"] - begin + INTERVAL_S)


async def replay(recording: Recording, phase: float, on_loss: OnLoss) -> AsyncIterator[dict[str, Any]]:
    """The items of a recording at real speed, without end, as those of a bus that has run for ``phase`` s of it (below
    its length). ``on_loss`` is called just before the snapshot that declares a slave lost."""
    loop = asyncio.get_running_loop()
    state = LiveState()
    at = 0
    for item in recording.items:
        state.apply(item)
        at += 1
        if state.t >= recording.t + phase:
            break
    began, t = loop.time(), state.t
    plant, snapshot = state.whole()[:2]
    yield {"plant": {**plant["plant"], "virtual": False, "started": time.time() - t}}
    yield snapshot
    shift = 0.0
    while True:
        for item in recording.items[at:]:
            kind, body = next(iter(item.items()))
            due = began + body["t"] + shift - t
            if kind == "snapshot":
                await asyncio.sleep(max(0.0, due - loop.time()))
                for address in lost_of(item):
                    on_loss(address)
            yield {kind: {**body, "t": body["t"] + shift}}
        # from the start again: behind the plant, with the whole snapshot, as after a delta of everything
        shift += recording.seconds
        at = 1
